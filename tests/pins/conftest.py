"""The files that pinned scenes name, made once for all tests that only read them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pins.files import write_files


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_files(tmp_path_factory.mktemp("told"))
