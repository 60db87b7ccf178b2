"""A case of a test that `make test` leaves out."""

from __future__ import annotations

from typing import Any

import pytest


def slow(*values: Any, id: str | None = None) -> Any:
    """Values of a parametrized test whose case is a longer study: run by `make test-slow`."""
    return pytest.param(*values, id=id, marks=pytest.mark.slow)
