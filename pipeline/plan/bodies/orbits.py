"""Orbits of a scene, of every kind, to places at instants; satellites of SGP4 seen together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.constants import DEG_RAD, EARTH_EQUATORIAL_RADIUS_M, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions import orbit_elements as el
from pipeline.physics.positions import orbit_table as table
from pipeline.physics.positions.earth import teme_to_gcrs
from pipeline.physics.positions.orbit import check_above_earth, tle_states, two_body
from pipeline.physics.positions.orbit_sgp4 import (
    many_states,
    mean_satellite,
    satellite_states,
    since_epochs_s,
    tle_satellite,
)
from pipeline.physics.positions.times import Instants, elapsed_s, instants, parse_utc
from pipeline.spec.targets.orbit import (
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


def orbit_states(
    orbit: Orbit, field: str, epoch: tuple[float, float], offsets: Array, times: Instants
) -> tuple[Array, Array]:
    """Geocentric GCRS place [m] and velocity [m/s] (n, 3) along an orbit, refused inside the Earth.

    offsets : seconds (n,) from `epoch`; times : the same instants
    """
    if isinstance(orbit, TleOrbit):
        place, speed = tle_states(orbit.line1, orbit.line2, times, field)
    elif isinstance(orbit, OmmOrbit):
        place, speed = satellite_states(satellite_of(orbit, field), _label(orbit), times, field)
    else:
        return Movers([orbit], [field], epoch, times).states(offsets[None], single=True)
    check_above_earth(place, field)
    return place, speed


class Movers:
    """Targets at n times of their own each, those of one kind of orbit together.

    orbits, fields : m of each; fields name them in messages
    times : n instants near those asked for: TEME is turned as at them (1e-12 rad off at emission)
    """

    def __init__(
        self,
        orbits: Sequence[Orbit],
        fields: Sequence[str],
        epoch: tuple[float, float],
        times: Instants,
    ) -> None:
        self._orbits, self._fields, self._epoch = list(orbits), list(fields), epoch
        kinds: dict[str, list[int]] = {"mean": [], "two-body": [], "other": []}
        for i, orbit in enumerate(orbits):
            mean = isinstance(orbit, TleOrbit | OmmOrbit)
            plain = isinstance(orbit, StateOrbit | KeplerianOrbit)
            kinds["mean" if mean else "two-body" if plain else "other"].append(i)
        self._mean, self._plain, self._other = kinds.values()
        if self._mean:
            named = [(self._orbits[i], self._fields[i]) for i in self._mean]
            self._satellites = [satellite_of(o, f) for o, f in named]  # type: ignore[arg-type]
            self._since_s = since_epochs_s(self._satellites, epoch)
            self._matrices = teme_to_gcrs(times)
        if self._plain:
            starts = [_two_body_start(self._orbits[i], self._fields[i], epoch) for i in self._plain]
            self._starts = [np.array(column) for column in zip(*starts, strict=True)]

    def states(self, at_s: Array, single: bool = False) -> tuple[Array, Array]:
        """Geocentric GCRS places [m] and velocities [m/s] (m, n, 3), refused inside the Earth.

        at_s : seconds (m, n) from the epoch
        """
        place, speed = np.empty((2, *at_s.shape, 3))
        if self._mean:
            labels = [_label(self._orbits[i]) for i in self._mean]  # type: ignore[arg-type]
            place[self._mean], speed[self._mean] = many_states(
                self._satellites,
                labels,
                [self._fields[i] for i in self._mean],
                self._since_s,
                at_s[self._mean],
                self._matrices,
            )
        if self._plain:
            place[self._plain], speed[self._plain] = self._two_body(at_s[self._plain])
        for i in self._other:
            place[i], speed[i] = _carried(self._orbits[i], self._fields[i], self._epoch, at_s[i])
        lowest = int(np.argmin(np.sum(place**2, axis=-1).min(axis=1)))
        check_above_earth(place[lowest], self._fields[lowest])
        return (place[0], speed[0]) if single else (place, speed)

    def _two_body(self, at_s: Array) -> tuple[Array, Array]:
        start, velocity, since_s, inverse_axis = self._starts
        moved = two_body(start, velocity, at_s + since_s[:, None], inverse_axis_m=inverse_axis)
        fastest = np.sqrt(np.sum(moved[1] ** 2, axis=-1)).max(axis=1)
        k = int(np.argmax(fastest))
        orbit, field = self._orbits[self._plain[k]], self._fields[self._plain[k]]
        if not fastest[k] < SPEED_OF_LIGHT_M_S:
            if isinstance(orbit, StateOrbit):
                allowed = "a speed that stays below that of light"
                raise BadInput(f"{field}.velocity_m_s", orbit.velocity_m_s, allowed)
            e = getattr(orbit, "eccentricity", None)
            raise BadInput(f"{field}.eccentricity", e, "a speed below that of light")
        return moved


def _carried(
    orbit: Orbit, field: str, epoch: tuple[float, float], offsets: Array
) -> tuple[Array, Array]:
    """Places and velocities (n, 3) of the kinds of orbit that are followed one by one."""
    if isinstance(orbit, NumericalOrbit):
        return _numerical(orbit, field, epoch, offsets)
    if isinstance(orbit, TableOrbit):
        return _table(orbit, field, epoch, offsets)
    raise _unread(orbit, field)  # type: ignore[arg-type]


def satellite_of(orbit: TleOrbit | OmmOrbit, field: str) -> Satrec:
    """The SGP4 satellite of mean elements."""
    if isinstance(orbit, TleOrbit):
        return tle_satellite(orbit.line1, orbit.line2, field)
    if orbit.elements is None:
        raise _unread(orbit, field)
    return mean_satellite(orbit.elements.model_dump(), f"{field}.elements")


def elements_epoch(orbit: TleOrbit | OmmOrbit) -> tuple[tuple[float, float], float]:
    """Two-part UTC date of mean elements, and revolutions a day."""
    satellite = satellite_of(orbit, "orbit")
    rev_day = satellite.no_kozai * 1440.0 / (2.0 * math.pi)
    return (satellite.jdsatepoch, satellite.jdsatepochF), rev_day


def _label(orbit: TleOrbit | OmmOrbit) -> str:
    if isinstance(orbit, TleOrbit):
        return orbit.line1.rstrip()
    return f"elements of {orbit.elements.epoch if orbit.elements else '?'}"


def _two_body_start(
    orbit: Orbit, field: str, epoch: tuple[float, float]
) -> tuple[Array, Array, float, float]:
    """Place, velocity (3,), seconds from there to the scene's epoch, and 1/a (NaN: not given)."""
    if isinstance(orbit, StateOrbit):
        since = _since_s(orbit.epoch, field, epoch)
        return _start(orbit, field), np.array(orbit.velocity_m_s, float), since, math.nan
    assert isinstance(orbit, KeplerianOrbit)
    return _keplerian(orbit, field, epoch)


def _keplerian(
    o: KeplerianOrbit, field: str, epoch: tuple[float, float]
) -> tuple[Array, Array, float, float]:
    """The same from elements: the state is that at perigee."""
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
    place, speed, inverse_axis = el.perigee_state(radius, e, tilt, node, perigee)
    return place, speed, since, inverse_axis


def _numerical(
    o: NumericalOrbit, field: str, epoch: tuple[float, float], offsets: Array
) -> tuple[Array, Array]:
    from pipeline.physics.positions.orbit_forces import Forces
    from pipeline.physics.positions.orbit_numerical import trajectory

    _start(o, field)
    begins = epoch if o.epoch is None else parse_utc(o.epoch, f"{field}.epoch")
    at = instants(begins, [0.0])
    forces = Forces(
        o.zonals,
        o.drag_m2_kg,
        o.radiation_m2_kg,
        o.shadow == "conical",
        "sun" in o.third_bodies,
        "moon" in o.third_bodies,
    )
    way = trajectory(
        o.position_m,
        o.velocity_m_s,
        (float(at.tt1[0]), float(at.tt2[0])),
        forces,
        o.relative_tolerance,
    )
    return way.states(offsets + _since_s(o.epoch, field, epoch), field)


def _table(
    o: TableOrbit, field: str, epoch: tuple[float, float], offsets: Array
) -> tuple[Array, Array]:
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
    if not math.hypot(*orbit.position_m) > EARTH_EQUATORIAL_RADIUS_M:  # the quick look
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
