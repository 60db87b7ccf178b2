"""Orbits of a scene, of every kind, to places at instants; satellites of SGP4 seen together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.constants import DEG_RAD, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.apparent import TargetSight, target_apparent
from pipeline.physics.positions.earth import EarthState, teme_to_gcrs
from pipeline.physics.positions.orbit import check_above_earth, tle_states, two_body
from pipeline.physics.positions.orbit_sgp4 import (
    many_positions,
    mean_satellite,
    satellite_states,
    since_epochs_s,
    tle_satellite,
)
from pipeline.physics.positions.times import Instants, elapsed_s, instants, parse_utc
from pipeline.spec.orbit import (
    EphemerisOrbit,
    KeplerianOrbit,
    NumericalOrbit,
    OmmOrbit,
    Orbit,
    StateOrbit,
    TableOrbit,
    TleOrbit,
)

if TYPE_CHECKING:
    from sgp4.api import Satrec

Array = NDArray[np.float64]
TOGETHER = 1000  # satellites whose light is followed in one go


def orbit_states(
    orbit: Orbit, field: str, epoch: tuple[float, float], offsets: Array, times: Instants
) -> tuple[Array, Array]:
    """Geocentric GCRS place [m] and velocity [m/s] (n, 3) along an orbit, refused inside the Earth.

    offsets : seconds (n,) from `epoch`; times : the same instants
    """
    if isinstance(orbit, TleOrbit):
        place, speed = tle_states(orbit.line1, orbit.line2, times, field)
    elif isinstance(orbit, OmmOrbit):
        place, speed = satellite_states(_satellite(orbit, field), _label(orbit), times, field)
    elif isinstance(orbit, KeplerianOrbit):
        place, speed = _keplerian(orbit, field, epoch, offsets)
    elif isinstance(orbit, NumericalOrbit):
        place, speed = _numerical(orbit, field, epoch, offsets)
    elif isinstance(orbit, TableOrbit):
        place, speed = _table(orbit, field, epoch, offsets)
    elif isinstance(orbit, StateOrbit):
        start = _start(orbit, field)
        since = _since_s(orbit.epoch, field, epoch)
        place, speed = two_body(start, np.array(orbit.velocity_m_s, float), offsets + since)
    else:
        raise _unread(orbit, field)
    check_above_earth(place, field)
    return place, speed


def mean_sights(
    orbits: Mapping[int, Orbit],
    epoch: tuple[float, float],
    offsets: Array,
    times: Instants,
    earth: EarthState,
    observer_m: Array,
    observer_m_s: Array,
) -> dict[int, TargetSight]:
    """How the observer sees those targets at n instants that SGP4 carries on, by their index.

    As one by one with less to do: the turn from TEME to GCRS is that of the instants of reception
    (1e-12 rad off at emission).
    """
    mean = {i: o for i, o in orbits.items() if isinstance(o, TleOrbit | OmmOrbit)}
    if not mean:
        return {}
    matrices, indices = teme_to_gcrs(times), list(mean)
    out: dict[int, TargetSight] = {}
    for start in range(0, len(mean), TOGETHER):
        some = indices[start : start + TOGETHER]
        fleet = _Fleet({i: mean[i] for i in some}, epoch, matrices)
        of = np.tile(np.arange(len(offsets)), len(some))
        seen = target_apparent(
            fleet.places,
            observer_m[of],
            observer_m_s[of],
            EarthState(earth.position_m[of], earth.velocity_m_s[of], earth.sun_from_earth_m[of]),
            offsets[of],
        )
        out |= {i: _part(seen, k * len(offsets), len(offsets)) for k, i in enumerate(some)}
    return out


class _Fleet:
    """Targets of SGP4 at times of their own."""

    def __init__(
        self,
        orbits: Mapping[int, TleOrbit | OmmOrbit],
        epoch: tuple[float, float],
        matrices: Array,
    ) -> None:
        self._fields = [f"targets.{i}.orbit" for i in orbits]
        self._labels = [_label(o) for o in orbits.values()]
        self._satellites = [
            _satellite(o, f) for o, f in zip(orbits.values(), self._fields, strict=True)
        ]
        self._since_s, self._matrices = since_epochs_s(self._satellites, epoch), matrices

    def places(self, at_s: Array) -> Array:
        """Places (m * n, 3) of m satellites at n times each, refused inside the Earth."""
        found = many_positions(
            self._satellites, self._labels, self._fields, self._since_s,
            at_s.reshape(len(self._satellites), -1), self._matrices,
        )  # fmt: skip
        lowest = int(np.argmin(np.sum(found**2, axis=-1).min(axis=1)))
        check_above_earth(found[lowest], self._fields[lowest])
        return found.reshape(-1, 3)


def _part(seen: TargetSight, start: int, count: int) -> TargetSight:
    some = slice(start, start + count)
    return TargetSight(
        seen.direction_proper[some], seen.direction_geometric[some], seen.range_m[some],
        seen.light_time_s[some], seen.target_geocentric_m[some],
    )  # fmt: skip


def _satellite(orbit: TleOrbit | OmmOrbit, field: str) -> Satrec:
    if isinstance(orbit, TleOrbit):
        return tle_satellite(orbit.line1, orbit.line2, field)
    if orbit.elements is None:
        raise _unread(orbit, field)
    return mean_satellite(orbit.elements.model_dump(), f"{field}.elements")


def _label(orbit: TleOrbit | OmmOrbit) -> str:
    if isinstance(orbit, TleOrbit):
        return orbit.line1.rstrip()
    return f"elements of {orbit.elements.epoch if orbit.elements else '?'}"


def _keplerian(
    o: KeplerianOrbit, field: str, epoch: tuple[float, float], offsets: Array
) -> tuple[Array, Array]:
    from pipeline.physics.positions import orbit_elements as el

    e = o.eccentricity
    radius = o.perigee_radius_m
    if radius is None:
        assert o.semi_major_axis_m is not None
        radius = el.perigee_radius(o.semi_major_axis_m, e)
    if o.time_of_perigee is not None:
        since = _since_s(o.time_of_perigee, f"{field}.time_of_perigee", epoch, whole_name=True)
    elif o.true_anomaly_deg is not None:
        since = el.since_perigee_by_true_anomaly(o.true_anomaly_deg * DEG_RAD, radius, e, field)
        since += _since_s(o.epoch, field, epoch)
    else:
        assert o.mean_anomaly_deg is not None
        mean = el.mean_anomaly_rad(o.mean_anomaly_deg, e)
        since = el.since_perigee_by_mean_anomaly(mean, radius, e)
        since += _since_s(o.epoch, field, epoch)
    tilt, node, perigee = (
        a * DEG_RAD for a in (o.inclination_deg, o.raan_deg, o.argument_of_perigee_deg)
    )
    place, speed = el.keplerian_states(radius, e, tilt, node, perigee, offsets + since)
    fastest = float(np.sqrt(np.sum(speed**2, axis=-1)).max())
    if not fastest < SPEED_OF_LIGHT_M_S:
        raise BadInput(f"{field}.eccentricity", e, "a speed below that of light")
    return place, speed


def _numerical(
    o: NumericalOrbit, field: str, epoch: tuple[float, float], offsets: Array
) -> tuple[Array, Array]:
    from pipeline.physics.positions.orbit_forces import Forces
    from pipeline.physics.positions.orbit_numerical import trajectory

    _start(o, field)
    begins = epoch if o.epoch is None else parse_utc(o.epoch, f"{field}.epoch")
    at = instants(begins, [0.0])
    forces = Forces(
        o.zonals, o.drag_m2_kg, o.radiation_m2_kg, o.shadow == "conical",
        "sun" in o.third_bodies, "moon" in o.third_bodies,
    )  # fmt: skip
    way = trajectory(
        o.position_m, o.velocity_m_s, (float(at.tt1[0]), float(at.tt2[0])), forces,
        o.relative_tolerance,
    )  # fmt: skip
    return way.states(offsets + _since_s(o.epoch, field, epoch), field)


def _table(
    o: TableOrbit, field: str, epoch: tuple[float, float], offsets: Array
) -> tuple[Array, Array]:
    from pipeline.physics.positions import orbit_table as table

    rows = np.array(o.rows, float)
    at = offsets + _since_s(o.epoch, field, epoch)
    table.check_covered(rows[0, 0], rows[-1, 0], at, field, o.epoch)
    speeds = rows[:, 4:] if rows.shape[1] == 7 else None
    nodes = o.nodes
    if nodes is None:
        nodes, _ = table.best_nodes(rows[:, 0], rows[:, 1:4], speeds)
    return table.interpolate(rows[:, 0], rows[:, 1:4], speeds, at, nodes)


def _start(orbit: StateOrbit | NumericalOrbit, field: str) -> Array:
    """The place of a state, checked with its velocity."""
    start = np.array(orbit.position_m, float)
    check_above_earth(start, f"{field}.position_m")
    if not math.hypot(*orbit.velocity_m_s) < SPEED_OF_LIGHT_M_S:
        raise BadInput(f"{field}.velocity_m_s", orbit.velocity_m_s, "a speed below that of light")
    return start


def _since_s(
    text: str | None, field: str, epoch: tuple[float, float], whole_name: bool = False
) -> float:
    """Seconds from an orbit's epoch to the scene's; 0 where it has none of its own."""
    if text is None:
        return 0.0
    return float(elapsed_s(parse_utc(text, field if whole_name else f"{field}.epoch"), *epoch))


def _unread(orbit: EphemerisOrbit | OmmOrbit, field: str) -> BadInput:
    return BadInput(f"{field}.path", orbit.path, "a file that was read when the scene was prepared")
