"""Fixtures of the catalogue tests: one catalogue of random stars, in many leaves and bands."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from star_rows import random_stars, write_csv

from catalog_tools import shards
from catalog_tools.ingest import ingest


@pytest.fixture(scope="session")
def stars():
    return random_stars(20_000)


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory, stars):
    folder = tmp_path_factory.mktemp("catalogue")
    source = write_csv(folder / "stars.csv", stars)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shards, "MIN_BAND_ROWS", 150)
        return ingest([source], folder / "made", rows_per_leaf=1500, workers=1).catalogue
