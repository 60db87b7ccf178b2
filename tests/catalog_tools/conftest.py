"""Fixtures of the catalogue tests: one catalogue of random stars, in many leaves and row groups."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from star_rows import random_stars, write_csv

from catalog_tools.ingest import shards
from catalog_tools.ingest.ingest import ingest


@pytest.fixture(scope="session")
def stars():
    return random_stars(20_000)


@pytest.fixture(scope="session")
def make_catalogue():
    """Make a catalogue of stars in small leaves, each of several bands and more row groups."""

    def make(folder: Path, stars, rows_per_leaf: int = 1500):
        source = write_csv(folder / "stars.csv", stars)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(shards, "MIN_BAND_ROWS", 80)
            patch.setattr(shards, "MAX_ROW_GROUP_ROWS", 40)
            return ingest([source], folder / "made", rows_per_leaf=rows_per_leaf).catalogue

    return make


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory, make_catalogue, stars):
    made = make_catalogue(tmp_path_factory.mktemp("catalogue"), stars)
    assert made.leaf_table.size > 40, made.leaf_table.size
    assert made.row_group_table.size > 5 * made.leaf_table.size
    return made
