"""Fixtures of the fetch tests: an archive of small files on a local web server."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from archive_server import ArchiveServer, small_archive

from catalog_tools.fetch.patience import Patience


@pytest.fixture
def archive():
    """Five files of random bytes, 30 to 70 kB, with MD5SUM.txt, as DR2 lays them out."""
    with ArchiveServer(small_archive()) as server:
        yield server


@pytest.fixture
def hasty():
    """Short delays."""
    return Patience(
        tries=6, first_delay_s=0.002, longest_delay_s=0.01, connect_s=2.0, silence_s=20.0
    )
