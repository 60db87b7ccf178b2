"""A ground site as the Earth turns it: its place and axes, with the pole where the scene has it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.physics.constants import ARCSEC_RAD, DAY_S, DEG_RAD, EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.positions.earth import site_axes, site_state
from pipeline.physics.positions.times import Instants
from pipeline.plan.timing import dwell_plans, end_s
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene

Array = NDArray[np.float64]

MOST_PX = 0.05  # that the Earth's turn is off by at the end of a scene, in silence


def place_of(o: GroundObserver, times: Instants) -> tuple[Array, Array]:
    """Geocentric place [m] and velocity [m/s] (n, 3) of a site, GCRS axes."""
    return site_state(
        o.latitude_deg * DEG_RAD, o.longitude_deg * DEG_RAD, o.height_m, times, *_pole_rad(o)
    )


def axes_of(o: GroundObserver, times: Instants) -> Array:
    """North, east and zenith (n, 3, 3: rows) of a site in GCRS axes; zenith of the ellipsoid."""
    return site_axes(o.latitude_deg * DEG_RAD, o.longitude_deg * DEG_RAD, times, *_pole_rad(o))


def turn_warnings(scene: Scene, g: Geometry, ifov_rad: float, off_rad: float) -> list[str]:
    """That frames of a long scene see a site which UT1 and the pole of the epoch turn wrongly.

    off_rad : by how much at most. What is pointed over the ground is as far off, a target as the
    site's place is; stars that are pointed at are not.
    """
    place_m = off_rad * EARTH_EQUATORIAL_RADIUS_M
    ways = [off_rad] if any(p.pointing.mode == "local" for p in dwell_plans(scene)) else []
    ways += [place_m / float(g.target_range_m.min())] if len(scene.targets) else []
    seen_px = max(ways, default=0.0) / ifov_rad
    if seen_px <= MOST_PX:
        return []
    days = end_s(scene) / DAY_S
    return [
        "the Earth's turn (UT1) and pole are those of the epoch in all frames: within "
        f"{days:.3g} days the site is turned up to {off_rad / ARCSEC_RAD:.2g} arcsec, "
        f"{place_m:.3g} m, wrongly, which is {seen_px:.2g} px; split the scene into parts of "
        f"{days * MOST_PX / seen_px:.2g} days, each with its own epoch"
    ]


def _pole_rad(o: GroundObserver) -> tuple[float, float]:
    """Where the pole is, x and y [rad]; at the origin where no table covers the epoch."""
    x, y = o.polar_motion_arcsec or (0.0, 0.0)
    return x * ARCSEC_RAD, y * ARCSEC_RAD
