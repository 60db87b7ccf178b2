"""The fields of a search pattern: how large they are, and where they look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.constants import DEG_RAD
from pipeline.physics.positions.earth import gcrs_to_itrs
from pipeline.physics.positions.times import instants
from pipeline.physics.vectors import from_angles, separation, to_angles, unit
from pipeline.plan.pointing.site import axes_of
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.study import SearchPattern, Slewing
from pipeline.survey.watch import Watcher, WatchMoments

Array = NDArray[np.float64]

RING_M = 42_164_172.0  # radius of the geostationary ring
RING_PLACES = 721  # at which its distance is looked at
MOST_FIELDS = 1_000_000  # of a pattern


@dataclass(frozen=True)
class Round:
    """How a sensor goes through the fields of a search, again and again.

    at_deg : (n,) where they are along the pattern; each_s : from one to the next, with the slew,
    its settling and the dwell; back_s : what the way back to the first takes longer
    """

    at_deg: Array
    each_s: float
    back_s: float

    @property
    def fields(self) -> int:
        return len(self.at_deg)

    @property
    def dwells_s(self) -> float:
        """Dwells in a second."""
        return self.fields / (self.fields * self.each_s + self.back_s)


def round_of(watcher: Watcher, pattern: SearchPattern, slew: Slewing) -> Round:
    """The round of one sensor: fields as near to each other as its overlap asks for."""
    height, width = field_rad(watcher)
    stride = min(height, width) * (1.0 - pattern.overlap)
    span_deg = pattern.to_deg - pattern.from_deg
    seen = span_deg * DEG_RAD * _seen_share(watcher, pattern, height)
    if not (wished := seen / stride) <= MOST_FIELDS:
        told = f"{wished:.3g} fields of {watcher.name}, {stride / DEG_RAD:.3g} deg apart"
        raise BadInput("tasking", told, f"at most {MOST_FIELDS}: a larger field, a shorter pattern")
    count = max(1, int(np.ceil(wished)))
    step, rate = seen / count if count > 1 else 0.0, slew.rate_deg_s * DEG_RAD
    at_deg = pattern.from_deg + (np.arange(count) + 0.5) * span_deg / count
    ends = axes_of_fields(watcher, watcher.watch(np.zeros(2)), pattern, at_deg[[0, -1]])[:, 2]
    back_s = max(0.0, float(separation(*ends)) - step) / rate
    return Round(at_deg, step / rate + slew.settle_s + watcher.dwell_s, back_s)


def _seen_share(watcher: Watcher, pattern: SearchPattern, height: float) -> float:
    """Angle that the sensor sees between fields, over that of the pattern's own, where it is
    largest: on a strip at the side of its fields (of this height [rad]) next to the equator, on the
    ring at what is nearest at the start."""
    if pattern.pattern == "fence":
        return 1.0
    if pattern.pattern == "strip":
        side = abs(pattern.declination_deg) * DEG_RAD - 0.5 * height
        return float(np.cos(max(0.0, side)))
    at_deg, step_deg = np.linspace(pattern.from_deg, pattern.to_deg, RING_PLACES, retstep=True)
    along = axes_of_fields(watcher, watcher.watch(np.zeros(RING_PLACES)), pattern, at_deg)[:, 2]
    return float(separation(along[1:], along[:-1]).max() / (step_deg * DEG_RAD))


def field_rad(watcher: Watcher) -> tuple[float, float]:
    """Height and width of a sensor's field [rad]."""
    camera, ifov = watcher.resolved.camera, watcher.resolved.facts.ifov_rad
    return 2.0 * np.arctan(camera.rows * ifov / 2), 2.0 * np.arctan(camera.columns * ifov / 2)


def axes_of_fields(
    watcher: Watcher, watch: WatchMoments, pattern: SearchPattern, at_deg: Array
) -> Array:
    """Axes (q, 3, 3: across, up, along) of fields, TEME: up is towards the pole or the zenith."""
    at = at_deg * DEG_RAD
    pole = np.einsum("nji,j->ni", watch.to_gcrs, np.array([0.0, 0.0, 1.0]))
    if pattern.pattern == "fence":
        north, east = _level(watcher, watch)
        azimuth = pattern.azimuth_deg * DEG_RAD
        level = np.cos(azimuth) * north + np.sin(azimuth) * east
        along, up = np.cos(at)[:, None] * level + np.sin(at)[:, None] * watch.up, watch.up
    elif pattern.pattern == "belt":
        times = instants(watcher.epoch, watch.offset_s, watcher.resolved.dut1_s)
        ring = RING_M * from_angles(at, np.zeros_like(at))
        to_teme = np.einsum("nki,njk->nij", watch.to_gcrs, gcrs_to_itrs(times))
        along, up = unit(np.einsum("nij,nj->ni", to_teme, ring) - watch.observer_m), pole
    else:
        sun = to_angles(np.einsum("nij,nj->ni", watch.to_gcrs, watch.sun_m))[0]
        strip = from_angles(sun + np.pi + at, np.full(len(at), pattern.declination_deg * DEG_RAD))
        along, up = np.einsum("nji,nj->ni", watch.to_gcrs, strip), pole
    across = unit(np.cross(along, up))
    return np.stack([across, np.cross(across, along), along], axis=1)


def _level(watcher: Watcher, watch: WatchMoments) -> tuple[Array, Array]:
    """North and east (q, 3), TEME: a site's own; of a satellite by TEME's axis."""
    site = watcher.observer
    if isinstance(site, GroundObserver):
        times = instants(watcher.epoch, watch.offset_s, watcher.resolved.dut1_s)
        north, east, _ = np.einsum("nji,nkj->kni", watch.to_gcrs, axes_of(site, times))
        return north, east
    east = unit(np.cross([0.0, 0.0, 1.0], watch.up))
    return np.cross(watch.up, east), east
