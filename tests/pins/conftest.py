"""The files that pinned scenes name, made once for all tests that only read them."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.pins.files import write_files

PREFIX = "files-that-pinned-scenes-name--"


@pytest.fixture(scope="session")
def files() -> Iterator[Path]:
    """A path of 44 letters wherever tests run: lines that name it fold at the same words."""
    with tempfile.TemporaryDirectory(prefix=PREFIX, dir="/tmp") as folder:
        yield write_files(Path(folder))
