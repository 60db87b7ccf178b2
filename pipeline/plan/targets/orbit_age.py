"""Orbits far from what they are good for: old elements, coarse tables, far beyond the Earth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.physics.constants import (
    ARCSEC_RAD,
    ASTRONOMICAL_UNIT_M,
    DAY_S,
    DEG_RAD,
    EARTH_EQUATORIAL_RADIUS_M,
    EARTH_GM_M3_S2,
)
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.positions.times import parse_utc
from pipeline.plan.bodies.orbits import elements_epoch
from pipeline.plan.targets.bounds import (
    J2,
    ellipse_of,
    geocentric_m,
    longest_from_elements_s,
    table_error_m,
    two_body_off_m,
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

Array = NDArray[np.float64]

SUN_GM_M3_S2 = 1.327_124_400_18e20
INFLUENCE_M = 9.24e8  # (GM_earth / GM_sun)^(2/5) au: beyond it the Sun's pull decides
FRESH_DAYS, MOST_NAMED = 3.0, 20
ASKED_FOR = "the times asked for"
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


def elements_error_m(age_days: Array | float, rev_day: Array | float) -> Array:
    """Expected error (n,) [m] of SGP4 with elements so old: a rule of thumb, along the track.

    About 1 km at the epoch, then 1 to 3 km a day in low orbits (Vallado & Cefola 2012, "Two-line
    element sets: practice and use", IAC-12; Levit & Marshall 2011, Adv. Space Res. 47, 1107,
    doi:10.1016/j.asr.2010.10.017), and some 0.5 km a day in high ones; at most the orbit's
    diameter. With changing drag, or after a manoeuvre, errors grow with the square of time.
    """
    axis_m = np.cbrt(EARTH_GM_M3_S2 / (2.0 * np.pi * np.asarray(rev_day) / DAY_S) ** 2)
    per_day = np.where(np.asarray(rev_day) > LOW_REV_DAY, LOW_KM_DAY, HIGH_KM_DAY)
    return np.minimum(1e3 * (AT_EPOCH_KM + per_day * np.abs(age_days)), 2.0 * axis_m)


def sensor_remarks(scene: Scene, first_s: float, last_s: float) -> list[str]:
    """What is to be said of the observer's own orbit between two times after the epoch."""
    orbit: Orbit | None = getattr(scene.observer, "orbit", None)
    if orbit is None:
        return []
    told = _aged(scene, orbit, first_s, last_s) or _unturned(scene, orbit, first_s, last_s)
    return [] if told is None else [f"its own orbit: {told[1]}"]


def oldest_remarks(scene: Scene, first_s: float, last_s: float) -> list[str]:
    """How many targets have old elements between two times after the epoch, and the worst."""
    mean = [t for t in scene.targets if isinstance(t.orbit, TleOrbit | OmmOrbit)]
    known = [_since_days(scene, t.orbit) for t in mean]  # type: ignore[arg-type]
    days, rev_day = np.array(known, float).reshape(-1, 2).T
    return old_elements([t.name for t in mean], days, rev_day, (first_s, last_s), "targets")


def old_elements(
    names: Sequence[str],
    since_days: Array,
    rev_day: Array,
    span_s: tuple[float, float],
    what: str,
) -> list[str]:
    """How many of n objects have old elements in a span of time, and the worst.

    since_days : (n,) from the elements' epoch to the instant from which the span counts
    """
    age = _farther_days(since_days, *span_s)
    old = np.flatnonzero(np.abs(age) > FRESH_DAYS)
    if not len(old):
        return []
    error = elements_error_m(age[old], rev_day[old])
    worst = int(np.argmax(error))
    k = old[worst]
    told = f"{names[k]}: {_age_told(float(age[k]), float(error[worst]), ASKED_FOR)}"
    return [f"{len(old)} of the {what} have old elements, the worst {told}"]


def _farther_days(since_days: Array | float, first_s: float, last_s: float) -> Array:
    """Age (n,) [days] of elements at the end of a span that is the farther from their epoch."""
    first, last = since_days + first_s / DAY_S, since_days + last_s / DAY_S
    return np.where(np.abs(first) >= np.abs(last), first, last)


def _age_told(age_days: float, error_m: float, end: str) -> str:
    when = "before" if age_days > 0 else "after"
    return (
        f"elements of {abs(age_days):.4g} days {when} {end}: SGP4 is expected to be "
        f"{error_m / 1e3:.3g} km off"
    )


def _since_days(scene: Scene, orbit: TleOrbit | OmmOrbit) -> tuple[float, float]:
    """Days from the elements' epoch to the scene's, and revolutions a day."""
    (utc1, utc2), rev_day = elements_epoch(orbit)
    start = parse_utc(scene.epoch)
    return (start[0] - utc1) + (start[1] - utc2), rev_day


def two_body_remarks(scene: Scene, first_s: float, last_s: float) -> list[str]:
    """How many targets move as two bodies, and how far the worst may be off between two times
    after the epoch."""
    off = [
        (*_two_body(scene, t.orbit, first_s, last_s), t.name)
        for t in scene.targets
        if isinstance(t.orbit, StateOrbit | KeplerianOrbit)
    ]
    error_m, words, name = max(off, default=(0.0, "", ""))
    if error_m < SAID_M:
        return []
    return [f"{len(off)} of the targets move as two bodies, the worst {name}: {words}"]


def _two_body(
    scene: Scene, orbit: StateOrbit | KeplerianOrbit, first_s: float, last_s: float
) -> tuple[float, str]:
    """Error and words of two-body motion between two times: from a revolution on by secular rates,
    before by its bound."""
    told = _unturned(scene, orbit, first_s, last_s)
    if told is not None:
        return told
    error_m = two_body_off_m(scene, orbit, first_s, last_s)
    return error_m, (
        "two-body motion, without the Earth's oblateness, Moon and Sun, is up to "
        f"{error_m / 1e3:.3g} km off at {ASKED_FOR}"
    )


def _aged(
    scene: Scene, orbit: Orbit, first_s: float = 0.0, last_s: float | None = None
) -> tuple[float, str] | None:
    """Error and words of mean elements of another time; None of fresh ones, and of other orbits.

    first_s, last_s : the times that count, after the epoch; default: of the scene's frames
    """
    if not isinstance(orbit, TleOrbit | OmmOrbit):
        return None
    since, rev_day = _since_days(scene, orbit)
    age = float(_farther_days(since, first_s, end_s(scene) if last_s is None else last_s))
    if abs(age) <= FRESH_DAYS:
        return None
    error = float(elements_error_m(age, rev_day))
    return error, _age_told(age, error, "the scene's end" if last_s is None else ASKED_FOR)


def _unturned(
    scene: Scene, orbit: Orbit, first_s: float, last_s: float
) -> tuple[float, str] | None:
    """Error and words of two-body motion up to a time, by the first-order secular rates of J2
    (Vallado 2013, eq. 9-37, 9-39, 9-41), which tell it from one revolution on; None before, and
    where they are worth less than AT_EPOCH_KM."""
    if not isinstance(orbit, StateOrbit | KeplerianOrbit):
        return None
    perigee, ecc, cosine = ellipse_of(orbit)
    if not ecc < 1.0:
        return None
    parameter = perigee * (1.0 + ecc)
    axis = perigee / (1.0 - ecc)
    time_s = longest_from_elements_s(scene, orbit, first_s, last_s)
    motion = float(np.sqrt(EARTH_GM_M3_S2 / axis**3))
    if motion * time_s < 2.0 * np.pi:
        return None
    rate = 1.5 * J2 * (EARTH_EQUATORIAL_RADIUS_M / parameter) ** 2 * motion
    square = 1.0 - cosine**2
    node = -rate * cosine * time_s
    of_mean = np.sqrt(1.0 - ecc**2) * (1.0 - 1.5 * square)
    along = float(rate * (2.0 - 2.5 * square + of_mean) * time_s)
    sideways_m, along_m = (2.0 * axis * np.sin(0.5 * min(abs(v), np.pi)) for v in (node, along))
    error = float(max(sideways_m, along_m))
    if error < 1e3 * AT_EPOCH_KM:
        return None
    return error, (
        f"two-body motion, without the Earth's oblateness, which in {time_s / DAY_S:.3g} days from "
        f"its elements turns the node by {node / DEG_RAD:.3g} deg, up to {sideways_m / 1e3:.3g} km,"
        f" and moves it along by about {along_m / 1e3:.3g} km"
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
