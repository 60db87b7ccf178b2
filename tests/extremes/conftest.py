"""The files that random scenes name, made once."""

from __future__ import annotations

import pytest

from tests.extremes.stock import Stock, make_stock


@pytest.fixture(scope="session")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Stock:
    return make_stock(tmp_path_factory.mktemp("stock"))
