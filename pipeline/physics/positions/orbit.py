"""Orbits of all kinds: the names that the plan uses, and what no orbit may do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M, EARTH_FLATTENING
from pipeline.physics.positions.orbit_sgp4 import check_tle, tle_states, tle_states_teme
from pipeline.physics.positions.orbit_two_body import two_body

Array = NDArray[np.float64]

__all__ = ["check_above_earth", "check_tle", "tle_states", "tle_states_teme", "two_body"]


def check_above_earth(position_m: Array, field: str) -> None:
    """BadInput if any position (..., 3) lies inside the Earth's polar radius (6357 km)."""
    polar_radius_m = EARTH_EQUATORIAL_RADIUS_M * (1.0 - EARTH_FLATTENING)
    radius = np.sqrt(np.sum(np.square(np.atleast_2d(position_m)), axis=-1))
    lowest = float(np.min(radius))
    if not lowest >= polar_radius_m:
        raise BadInput(
            field,
            f"{lowest / 1e3:.1f} km from the Earth's centre",
            f"a position above the Earth's surface (over {polar_radius_m / 1e3:.1f} km)",
        )
