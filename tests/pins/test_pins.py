"""What is drawn is what is pinned: to the bit on the pins' kind of processor, else by value."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pins.compare import differences, kind_here, load
from tests.pins.draw import draw
from tests.pins.files import write_files
from tests.pins.scenes import NAMES


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the scenes name, made anew."""
    return write_files(tmp_path_factory.mktemp("pins"))


@pytest.mark.parametrize("name", NAMES)
def test_as_pinned(name: str, files: Path, tmp_path: Path) -> None:
    """On purpose otherwise: `make pins`, and a line in CHANGELOG.md (docs/pins.md)."""
    found = differences(load(name), draw(name, files, tmp_path), kind_here())
    assert not found, "\n".join(map(str, found))
