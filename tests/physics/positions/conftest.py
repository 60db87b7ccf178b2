"""Astropy without its downloads."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _offline_astropy() -> None:
    from astropy.utils import iers

    iers.conf.auto_download = False
    iers.conf.auto_max_age = None
