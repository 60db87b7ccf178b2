"""Objects that a sensor never sees: never above its horizon, or too faint at their best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, DAY_S, DEG_RAD
from pipeline.physics.positions.orbit_bounds import (
    latitude_bound_rad,
    least_range_m,
    never_rises,
    radius_bounds_m,
)
from pipeline.physics.positions.times import elapsed_s
from pipeline.physics.targets.lighting import photon_rate_at_aperture
from pipeline.physics.targets.sphere import sphere_intensity_per_irradiance
from pipeline.plan.bodies.orbits import satellite_of
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.targets.orbit import OmmOrbit, TleOrbit
from pipeline.survey.elements import Elements, mean_of
from pipeline.survey.watch import MOST_LIFT_RAD, Watcher, WatchMoments

Array = NDArray[np.float64]

NEAREST_SUN_M = 0.98 * ASTRONOMICAL_UNIT_M
SAME_EPOCH_S = 1e-3
SHARE = 0.98  # of the SNR asked for: the table's own error


def never_seen(
    watcher: Watcher, watch: WatchMoments, elements: Elements, least_snr: float
) -> NDArray[np.bool_]:
    """Which objects (n,) are certainly not seen at an SNR during the moments of a watch.

    By bounds of their orbits alone (`orbit_bounds`): a site's cap of sky does not reach them, or
    fully lit at their least distance, standing still at the zenith (before no light where
    the sky changes), they are fainter than that. Nor does a satellite see itself.
    """
    days = _days(watcher, watch, elements)
    bstar, ecc, _, tilt, _, motion, _ = elements.mean.T
    low, high = radius_bounds_m(motion, ecc, tilt, bstar, days)
    radius = np.sqrt(np.sum(watch.observer_m**2, axis=-1))
    nearest = np.maximum(1.0, least_range_m(radius.min(), radius.max(), low, high))
    reflected = sphere_intensity_per_irradiance(0.0, 1.0, 1.0) * elements.reflecting_m2
    light = photon_rate_at_aperture(1.0, NEAREST_SUN_M, 1.0, reflected, nearest)
    light_e = watcher.light_e(light, np.ones(1))
    faint = watcher.snr(light_e, np.zeros_like(light_e), 0.0) < SHARE * least_snr
    o = watcher.observer
    if not isinstance(o, GroundObserver):
        return faint | itself(watcher, elements)
    lowest = watcher.regard.lowest_elevation_deg * DEG_RAD - MOST_LIFT_RAD
    reach = latitude_bound_rad(tilt, motion, days)
    return faint | never_rises(o.latitude_deg * DEG_RAD, o.height_m, lowest, high, reach)


def itself(watcher: Watcher, elements: Elements) -> NDArray[np.bool_]:
    """Which objects (n,) are the satellite that looks: of its catalogue number, or its elements."""
    orbit = getattr(watcher.observer, "orbit", None)
    if not isinstance(orbit, TleOrbit | OmmOrbit):
        return np.zeros(len(elements), bool)
    own = satellite_of(orbit, f"{watcher.field}observer.orbit")
    after_s = elapsed_s((own.jdsatepoch, own.jdsatepochF), elements.jd1, elements.jd2)
    same = np.isclose(elements.mean, mean_of(own), rtol=1e-9, atol=1e-9).all(axis=1)
    same &= np.abs(after_s) < SAME_EPOCH_S
    return same | ((elements.number == own.satnum) & (own.satnum > 0))


def _days(watcher: Watcher, watch: WatchMoments, elements: Elements) -> Array:
    """Days (n,) from each object's elements to the farther end of the watch."""
    at = elapsed_s(watcher.epoch, elements.jd1, elements.jd2)
    first, last = watch.offset_s[0], watch.offset_s[-1]
    return np.maximum(np.abs(at - first), np.abs(at - last)) / DAY_S
