"""A ground site as the Earth turns it: its place and axes, with the pole where the scene has it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import ARCSEC_RAD, DEG_RAD
from pipeline.physics.positions.earth import site_axes, site_state
from pipeline.physics.positions.times import Instants
from pipeline.spec.pointing.observer import GroundObserver

Array = NDArray[np.float64]


def place_of(o: GroundObserver, times: Instants) -> tuple[Array, Array]:
    """Geocentric place [m] and velocity [m/s] (n, 3) of a site, GCRS axes."""
    return site_state(
        o.latitude_deg * DEG_RAD, o.longitude_deg * DEG_RAD, o.height_m, times, *_pole_rad(o)
    )


def axes_of(o: GroundObserver, times: Instants) -> Array:
    """North, east and zenith (n, 3, 3: rows) of a site in GCRS axes; zenith of the ellipsoid."""
    return site_axes(o.latitude_deg * DEG_RAD, o.longitude_deg * DEG_RAD, times, *_pole_rad(o))


def _pole_rad(o: GroundObserver) -> tuple[float, float]:
    """Where the pole is, x and y [rad]; at the origin where no table covers the epoch."""
    x, y = o.polar_motion_arcsec or (0.0, 0.0)
    return x * ARCSEC_RAD, y * ARCSEC_RAD
