"""Apparent directions of satellites against Skyfield, an independent library; light time exact."""

from __future__ import annotations

from typing import Any

import mpmath as mp
import numpy as np
import pytest

from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, DAY_S, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.apparent import target_apparent
from pipeline.physics.positions.earth import EarthState, earth_and_sun, site_state
from pipeline.physics.positions.orbit_sgp4 import satellite_states, tle_satellite
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.vectors import separation, unit
from pipeline.plan.bodies.orbits import Movers
from pipeline.spec.targets.orbit import TleOrbit

skyfield = pytest.importorskip("skyfield.api")
from skyfield.vectorlib import VectorFunction  # noqa: E402

EPOCH = "2019-04-20T03:00:00Z"
ARCSEC = np.degrees(1.0) * 3600.0


def with_checksum(line: str) -> str:
    return line[:68] + str(sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10)


def tle(number: int, incl: float, node: float, e: float, arg: float, m: float, n: float) -> Any:
    return (
        with_checksum(
            f"1 {number:05d}U 98067A   19110.12345678  .00000100  00000-0  23000-4 0  9990"
        ),
        with_checksum(
            f"2 {number:05d} {incl:8.4f} {node:8.4f} {round(e * 1e7):07d} {arg:8.4f} {m:8.4f} "
            f"{n:11.8f}16600 "
        ),
    )


ORBITS = {
    "leo": tle(1, 51.64, 100.0, 0.0002, 80.0, 280.0, 15.52),
    "geo": tle(2, 0.05, 30.0, 0.0003, 90.0, 200.0, 1.0027),
    "heo": tle(3, 63.4, 200.0, 0.72, 270.0, 30.0, 2.0061),
}
WATCHER = tle(9, 97.5, 60.0, 0.001, 10.0, 20.0, 14.8)


class ErfaEarth(VectorFunction):
    """The Earth of our own ephemeris as a Skyfield vector: no kernel has to be downloaded."""

    center, target, ephemeris = 0, 399, None

    def _at(self, t: Any) -> Any:
        earth = earth_and_sun(np.atleast_1d(t.whole), np.atleast_1d(t.tt_fraction))
        shape = (3,) + np.shape(t.tt_fraction)
        place = (earth.position_m / ASTRONOMICAL_UNIT_M).T.reshape(shape)
        return place, (earth.velocity_m_s / ASTRONOMICAL_UNIT_M * DAY_S).T.reshape(shape), None, ""


def skyfield_directions(lines: Any, observer: Any, seconds: np.ndarray) -> tuple[Any, float]:
    scale = skyfield.load.timescale(builtin=True)
    t = scale.utc(2019, 4, 20, 3, 0, seconds)
    earth = ErfaEarth()
    if observer == "ground":
        place = skyfield.wgs84.latlon(20.7, -156.3, 3055.0)
    else:
        place = skyfield.EarthSatellite(*observer, "w", scale)
    seen = (earth + place).at(t).observe(earth + skyfield.EarthSatellite(*lines, "s", scale))
    return unit(seen.apparent(deflectors=()).xyz.au.T), float(np.mean(t.dut1))


@pytest.mark.parametrize("watcher", ["ground", "space"])
@pytest.mark.parametrize("name", ORBITS)
def test_against_skyfield(name: str, watcher: str) -> None:
    """To 0.01 arcsec; what is left is the Earth's pull on light and Lorentz terms of 1 mas."""
    seconds = np.linspace(0.0, 5400.0, 19)
    observer = "ground" if watcher == "ground" else WATCHER
    theirs, dut1_s = skyfield_directions(ORBITS[name], observer, seconds)
    epoch = parse_utc(EPOCH)
    at = instants(epoch, seconds, dut1_s)
    earth = earth_and_sun(at.tt1, at.tt2)
    if watcher == "ground":
        place, speed = site_state(np.radians(20.7), np.radians(-156.3), 3055.0, at)
    else:
        place, speed = satellite_states(tle_satellite(*WATCHER), "watcher", at)
    line1, line2 = ORBITS[name]
    orbit = TleOrbit(kind="tle", line1=line1, line2=line2)
    movers = Movers([orbit], ["targets.0.orbit"], epoch, at)
    sight = target_apparent(
        lambda when: movers.states(when)[0], place, speed + earth.velocity_m_s, earth, seconds[None]
    )
    difference = separation(sight.direction_proper[0], theirs) * ARCSEC
    assert difference.max() < 0.01


def still(n: int) -> EarthState:
    """An Earth without motion, and a Sun so far that it does not pull."""
    return EarthState(np.zeros((n, 3)), np.zeros((n, 3)), np.tile([1e30, 0.0, 0.0], (n, 1)))


@pytest.mark.parametrize("range_m", [1e3, 0.1 * ASTRONOMICAL_UNIT_M])
@pytest.mark.parametrize("speed", [(10e3, 0.0, 0.0), (0.0, 7e3, -7e3), (-6e3, 8e3, 0.0)])
def test_light_time_is_exact(range_m: float, speed: tuple[float, float, float]) -> None:
    """Against the root of c tau = |r(t - tau)| in 50 digits, then aberrated exactly."""
    mp.mp.dps = 50
    start, observer = np.array([7e6, 0.0, 0.0]), np.array([7e6 - range_m, 0.0, 0.0])
    v = np.array(speed)
    watch = np.array([3e3, -5e3, 2e3])
    sight = target_apparent(
        lambda at: start + v * at[:, None], observer[None], watch[None], still(1), np.zeros(1)
    )
    first = [mp.mpf(float(a)) - mp.mpf(float(b)) for a, b in zip(start, observer, strict=True)]
    c = mp.mpf(SPEED_OF_LIGHT_M_S)

    def path(tau: Any) -> list[Any]:
        return [a - mp.mpf(float(b)) * tau for a, b in zip(first, v, strict=True)]

    def length(x: list[Any]) -> Any:
        return mp.sqrt(sum(y * y for y in x))

    tau = mp.findroot(lambda t: c * t - length(path(t)), length(first) / c)
    assert abs(sight.light_time_s[0] - float(tau)) <= 4e-16 * float(tau) + 4e-18
    u = [x / length(path(tau)) for x in path(tau)]
    b = [mp.mpf(float(w)) / c for w in watch]
    gamma = 1 / mp.sqrt(1 - sum(x * x for x in b))
    dot = sum(x * y for x, y in zip(u, b, strict=True))
    seen = [
        (x / gamma + y + gamma / (1 + gamma) * dot * y) / (1 + dot)
        for x, y in zip(u, b, strict=True)
    ]
    wanted = np.array([float(x) for x in seen])
    assert separation(sight.direction_proper, wanted[None])[0] < 5e-16 * 7e6 / range_m + 2e-15
