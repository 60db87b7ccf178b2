"""Orbits far from what they are good for: old elements, coarse tables, far beyond the Earth."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import Geometry
from pipeline.physics.constants import (
    ARCSEC_RAD,
    ASTRONOMICAL_UNIT_M,
    DAY_S,
    EARTH_GM_M3_S2,
)
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.positions.times import parse_utc
from pipeline.plan.bodies.orbits import elements_epoch
from pipeline.plan.targets.bounds import (
    geocentric_m,
    longest_from_elements_s,
    table_error_m,
    two_body_drift_m,
)
from pipeline.plan.timing import end_s
from pipeline.spec.scene import Scene
from pipeline.spec.targets.orbit import (
    KeplerianOrbit,
    NumericalOrbit,
    OmmOrbit,
    Orbit,
    StateOrbit,
    TableOrbit,
    TleOrbit,
)

SUN_GM_M3_S2 = 1.327_124_400_18e20
INFLUENCE_M = 9.24e8  # (GM_earth / GM_sun)^(2/5) au: beyond it the Sun's pull decides
FRESH_DAYS, MOST_NAMED = 3.0, 20
LOW_REV_DAY = 6.4  # of orbits of less than 225 minutes: SGP4's near-Earth theory
SAID_M = 10.0  # from which two-body motion at other times is told
LOW_KM_DAY, HIGH_KM_DAY, AT_EPOCH_KM = 3.0, 0.5, 1.0


def orbit_remarks(scene: Scene, g: Geometry, ifov_rad: float) -> list[str]:
    """What is to be said of old elements and of orbits beyond the Earth's reach, one by one."""
    found = []
    for name, orbit, geocentric, range_m in _movers(scene, g):
        told = _aged(scene, orbit) or _far(scene, orbit, geocentric)
        if told is not None:
            error_m, why = told
            found.append((error_m, f"{name}: {why}{_on_the_sensor(error_m, range_m, ifov_rad)}"))
    found.sort(key=lambda one: -one[0])
    out = [words for _, words in found[:MOST_NAMED]]
    left = len(found) - len(out)
    return out + ([f"{left} more orbits are old or far like these, by less"] if left else [])


def table_warnings(scene: Scene, g: Geometry, ifov_rad: float) -> list[str]:
    """Which tables of places may be off by more than a pixel between rows, the worst first."""
    found = []
    for name, orbit, _, range_m in _movers(scene, g):
        if not isinstance(orbit, TableOrbit):
            continue
        _, error_m, known = table_error_m(orbit)
        if range_m > 0.0 and error_m > ifov_rad * range_m:
            why = "may be" if known else "are too few to judge by; if it is a free orbit it may be"
            told = f"{name}: the rows of its table {why} {error_m:.2g} m off between them"
            found.append((error_m, f"{told}{_on_the_sensor(error_m, range_m, ifov_rad)}"))
    found.sort(key=lambda one: -one[0])
    return [words for _, words in found[:MOST_NAMED]]


def _movers(scene: Scene, g: Geometry) -> list[tuple[str, Orbit, float, float]]:
    """Names and orbits of targets and of the observer; how far from the Earth's middle [m] each
    comes at most, and how near the other [m]."""
    nearest = g.target_range_m.min(axis=(1, 2)) if len(scene.targets) else np.zeros(0)
    earth = earth_and_sun(g.tt1[:, g.middle], g.tt2[:, g.middle]).position_m
    here = float(np.sqrt(np.sum((g.observer_m[:, g.middle] - earth) ** 2, axis=-1)).max())
    places = geocentric_m(g).max(axis=-1) if len(scene.targets) else np.zeros(0)
    movers: list[tuple[str, Orbit, float, float]] = [
        (t.name, t.orbit, float(places[i]), float(nearest[i])) for i, t in enumerate(scene.targets)
    ]
    observer: Orbit | None = getattr(scene.observer, "orbit", None)
    if observer is not None:
        movers.append(("the observer", observer, here, float(nearest.min(initial=np.inf))))
    return movers


def elements_error_m(age_days: float, rev_day: float) -> float:
    """Expected error [m] of SGP4 with elements so old: a rule of thumb, along the track.

    About 1 km at the epoch, then 1 to 3 km a day in low orbits (Vallado & Cefola 2012, "Two-line
    element sets: practice and use", IAC-12; Levit & Marshall 2011, Adv. Space Res. 47, 1107,
    doi:10.1016/j.asr.2010.10.017), and some 0.5 km a day in high ones; at most the orbit's
    diameter. With changing drag, or after a manoeuvre, errors grow with the square of time.
    """
    axis_m = (EARTH_GM_M3_S2 / (2.0 * np.pi * rev_day / DAY_S) ** 2) ** (1.0 / 3.0)
    per_day = LOW_KM_DAY if rev_day > LOW_REV_DAY else HIGH_KM_DAY
    return float(min(1e3 * (AT_EPOCH_KM + per_day * abs(age_days)), 2.0 * axis_m))


def oldest_remarks(scene: Scene, first_s: float, last_s: float) -> list[str]:
    """How many targets have old elements between two times after the epoch, and the worst; and
    what is to be said of the observer's own."""
    found = [(t.name, _aged(scene, t.orbit, first_s, last_s)) for t in scene.targets]
    old = [(told[0], f"{name}: {told[1]}") for name, told in found if told is not None]
    out = [f"{len(old)} of the targets have old elements, the worst {max(old)[1]}"] if old else []
    observer = getattr(scene.observer, "orbit", None)
    own = None if observer is None else _aged(scene, observer, first_s, last_s)
    return out if own is None else [*out, f"the observer: {own[1]}"]


def two_body_remarks(scene: Scene, first_s: float, last_s: float) -> list[str]:
    """How far orbits of two bodies may be off between two times after the epoch, the worst."""
    movers: list[tuple[str, object]] = [(t.name, t.orbit) for t in scene.targets]
    movers.append(("the observer", getattr(scene.observer, "orbit", None)))
    plain = [(name, o) for name, o in movers if isinstance(o, StateOrbit | KeplerianOrbit)]
    off = [(two_body_drift_m(scene, o, first_s, last_s), name) for name, o in plain]
    error_m, worst = max(off, default=(0.0, ""))
    if error_m < SAID_M:
        return []
    return [
        f"two-body motion of {len(off)} orbits: the Earth's oblateness, Moon and Sun are omitted; "
        f"at the times asked for {worst} is expected to be up to {error_m / 1e3:.3g} km off"
    ]


def _aged(
    scene: Scene, orbit: Orbit, first_s: float = 0.0, last_s: float | None = None
) -> tuple[float, str] | None:
    """Error and words of mean elements of another time; None of fresh ones, and of other orbits.

    first_s, last_s : the times that count, after the epoch; default: of the scene's frames
    """
    if not isinstance(orbit, TleOrbit | OmmOrbit):
        return None
    (utc1, utc2), rev_day = elements_epoch(orbit)
    start = parse_utc(scene.epoch)
    since = (start[0] - utc1) + (start[1] - utc2)
    last = end_s(scene) if last_s is None else last_s
    age = max(since + first_s / DAY_S, since + last / DAY_S, key=abs)
    if abs(age) <= FRESH_DAYS:
        return None
    error = elements_error_m(age, rev_day)
    when = "before" if age > 0 else "after"
    end = "the scene's end" if last_s is None else "the times asked for"
    return error, (
        f"elements of {abs(age):.4g} days {when} {end}: SGP4 is expected to be "
        f"{error / 1e3:.3g} km off"
    )


def _far(scene: Scene, orbit: Orbit, geocentric_m: float) -> tuple[float, str] | None:
    """Error and words of an orbit about the Earth where the Sun's pull decides; None nearer."""
    if geocentric_m < INFLUENCE_M or not isinstance(
        orbit, StateOrbit | KeplerianOrbit | NumericalOrbit
    ):
        return None
    if isinstance(orbit, NumericalOrbit) and "sun" in orbit.third_bodies:
        return None
    time_s = longest_from_elements_s(scene, orbit)
    tide = 2.0 * SUN_GM_M3_S2 * geocentric_m / ASTRONOMICAL_UNIT_M**3
    error = 0.5 * tide * time_s**2
    return error, (
        f"{geocentric_m / 1e9:.3g} million km from the Earth, beyond its sphere of influence of "
        f"0.92: motion about the Earth alone neglects the Sun's pull, {error / 1e3:.3g} km after "
        f"{time_s / DAY_S:.3g} days"
    )


def _on_the_sensor(error_m: float, range_m: float, ifov_rad: float) -> str:
    """The same as it may be seen, across the line of sight."""
    if not (np.isfinite(range_m) and range_m > 0.0):
        return ""
    angle = float(np.arctan2(error_m, range_m))
    return f", up to {angle / ARCSEC_RAD:.3g} arcsec = {angle / ifov_rad:.3g} px at {range_m:.3g} m"
