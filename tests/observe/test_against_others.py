"""Places, rates and angles over 1,000 cases against Skyfield and astropy, independent libraries."""

from __future__ import annotations

import math
from typing import Any

import astropy.coordinates as coord
import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time

from pipeline.observe.observe import observe
from pipeline.physics.vectors import from_angles, separation
from pipeline.spec.load import parse_scene
from tests.observe.conftest import BALL, SITE, night
from tests.physics.positions.test_orbit_skyfield import ErfaEarth, tle

skyfield = pytest.importorskip("skyfield.api")

ARCSEC = np.degrees(1.0) * 3600.0
EPOCH = (2019, 4, 20, 10, 0)
ORBITS, TIMES = 20, 50


@pytest.fixture(scope="module")
def cases() -> tuple[list[Any], np.ndarray]:
    """20 orbits of all kinds and 50 times in two days."""
    turn = np.random.default_rng(20)
    motion = [*turn.uniform(11.5, 15.5, 12), *turn.uniform(1.0, 4.0, 8)]  # low, and high
    lines = []
    for k, rev_day in enumerate(motion):
        e = 0.01 * turn.random() if rev_day > 4.0 else 0.6 * turn.random()
        angles = turn.uniform(0.0, [90.0, 360.0, 360.0, 360.0])
        lines.append(tle(k + 1, angles[0], angles[1], e, angles[2], angles[3], rev_day))
    return lines, np.sort(turn.uniform(0.0, 2 * 86400.0, TIMES))


def observed(cases: Any, refraction: Any) -> dict[str, np.ndarray]:
    air = {"extinction": False, "refraction": refraction} if refraction else None
    site = SITE | {"polar_motion_arcsec": [0.0, 0.0], "atmosphere": air}
    targets = [
        {"name": f"t{k}", "body": BALL, "orbit": {"kind": "tle", "line1": a, "line2": b}}
        for k, (a, b) in enumerate(cases[0])
    ]
    pointing = {"mode": "sidereal", "boresight_ra_deg": 200.0, "boresight_dec_deg": 4.0}
    scene = night(observer=site, targets=targets, pointing=pointing, background=None)
    table = observe(parse_scene(scene), cases[1]).table
    assert table.num_rows == ORBITS * TIMES
    return {
        name: np.array(table[name].to_pylist()).reshape(TIMES, ORBITS).T
        for name in table.column_names
    }


@pytest.fixture(scope="module")
def ours(cases: Any) -> dict[str, np.ndarray]:
    return observed(cases, False)


@pytest.fixture(scope="module")
def theirs(cases: Any) -> list[Any]:
    """Apparent places by Skyfield, an array of times for each orbit."""
    scale = skyfield.load.timescale(builtin=True)
    t = scale.utc(*EPOCH, cases[1])
    earth, site = ErfaEarth(), skyfield.wgs84.latlon(20.7, -156.3, 3055.0)
    return [
        (earth + site).at(t).observe(earth + skyfield.EarthSatellite(*lines, "s", scale))
        for lines in cases[0]
    ]


def apart(a: Any, b: Any, c: Any, d: Any) -> np.ndarray:
    """Angles [arcsec] between places (a, b) and (c, d) [deg]."""
    at = [from_angles(np.radians(x), np.radians(y)) for x, y in ((a, b), (c, d))]
    return separation(*at) * ARCSEC


def test_apparent_places_and_ranges(cases: Any, ours: Any, theirs: Any) -> None:
    """To 0.2 arcsec: what is left is UT1, which each library has its own table of."""
    for k, place in enumerate(theirs):
        ra, dec, _ = place.apparent(deflectors=()).radec()
        own = ours["apparent_ra_deg"][k], ours["apparent_dec_deg"][k]
        assert apart(*own, ra._degrees, dec.degrees).max() < 0.2
    scale, site = skyfield.load.timescale(builtin=True), skyfield.wgs84.latlon(20.7, -156.3, 3055.0)
    here = site.at(scale.utc(*EPOCH, cases[1])).xyz.m
    for k, lines in enumerate(cases[0]):
        left = scale.utc(*EPOCH, cases[1] - ours["range_m"][k] / 299_792_458.0)
        there = skyfield.EarthSatellite(*lines, "s", scale).at(left).xyz.m
        far = np.sqrt(np.sum((there - here) ** 2, axis=0))
        assert np.abs(ours["range_m"][k] - far).max() < 2.0


def test_azimuth_and_elevation(ours: Any, theirs: Any) -> None:
    for k, place in enumerate(theirs):
        up, azimuth, _ = place.apparent(deflectors=()).altaz()
        own = ours["azimuth_deg"][k], ours["elevation_deg"][k]
        assert apart(*own, azimuth.degrees, up.degrees).max() < 0.3


def test_elevation_through_the_air(cases: Any, ours: Any, theirs: Any) -> None:
    """Bennett's formula, which Skyfield has, is good to 0.07 arcmin (1982, J. Navig. 35, 255)."""
    air = {"pressure_hpa": 700.0, "temperature_c": 5.0, "humidity": 0.0, "wavelength_nm": 550}
    bent, compared = observed(cases, air), 0
    for k, place in enumerate(theirs):
        up, _, _ = place.apparent(deflectors=()).altaz(temperature_C=5.0, pressure_mbar=700.0)
        high = up.degrees > 10.0
        compared += high.sum()
        off = bent["elevation_deg"][k] - up.degrees
        assert np.abs(off[high]).max(initial=0.0) * 60.0 < 0.1
        lifted = bent["elevation_deg"][k] - ours["elevation_deg"][k]
        assert (lifted[high] > 0.0).all()
    assert compared > 100


def test_rates(cases: Any, ours: Any) -> None:
    """Against differences of places and ranges a second apart, with the times' own spacing."""
    later = observed((cases[0], cases[1] + 0.5), False)
    before = observed((cases[0], cases[1] - 0.5), False)
    at = [
        from_angles(np.radians(o["apparent_ra_deg"]), np.radians(o["apparent_dec_deg"]))
        for o in (before, later)
    ]
    np.testing.assert_allclose(ours["rate_arcsec_s"], separation(*at) * ARCSEC, rtol=1e-3)
    np.testing.assert_allclose(
        ours["range_rate_m_s"], later["range_m"] - before["range_m"], rtol=1e-3, atol=0.1
    )
    a, b = (coord.SkyCoord(o["apparent_ra_deg"], o["apparent_dec_deg"], unit="deg")
            for o in (before, later))  # fmt: skip
    middle = coord.SkyCoord(ours["apparent_ra_deg"], ours["apparent_dec_deg"], unit="deg")
    angle = 0.5 * (a.position_angle(middle) + middle.position_angle(b)).to_value(u.deg)
    off = (ours["position_angle_deg"] - angle + 90.0) % 180.0 - 90.0  # means over 360 turn by 180
    assert np.abs(off).max() < 0.2


@pytest.mark.parametrize("nearest_m", [1e5, 1e3, 100.0])
def test_rates_of_a_pass_at_10_km_a_second(nearest_m: float) -> None:
    """Closed forms of an even pass, at its nearest and where it is seen under 45 degrees; a time
    when it is far and slow, asked for beside them, takes nothing from them."""
    camera = {"kind": "state", "position_m": [7e6, 0, 0], "velocity_m_s": [0, 7546.0, 0]}
    passing = {"kind": "state", "position_m": [7e6, 0, nearest_m], "velocity_m_s": [0, -2454.0, 0]}
    scene = night(
        observer={"kind": "orbit", "orbit": camera}, background=None,
        targets=[{"name": "ball", "orbit": passing, "body": BALL | {"diameter_m": 0.01}}],
        pointing={"mode": "sidereal", "boresight_ra_deg": 90.0, "boresight_dec_deg": 0.0},
        exposure={"integration_s": 1e-6, "frames": 1},
    )  # fmt: skip
    told = observe(parse_scene(scene), [0.0, nearest_m / 1e4, 60.0]).table.slice(0, 2).to_pydict()
    rate = 1e4 / nearest_m * ARCSEC
    assert told["rate_arcsec_s"] == pytest.approx([rate, rate / 2.0], rel=1e-3)
    slowly = [0.0, 1e4 / math.sqrt(2.0)]
    assert told["range_rate_m_s"] == pytest.approx(slowly, rel=1e-3, abs=10.0)


@pytest.mark.parametrize(
    ("name", "column", "limit"),
    [("sun", "solar_elongation_deg", 2.0), ("moon", "moon_separation_deg", 11.0)],
)
def test_angles_to_sun_and_moon(
    cases: Any, ours: Any, name: str, column: str, limit: float
) -> None:
    """The Moon's place is good to 10 arcsec, and its own light time is omitted (0.7)."""
    site = coord.EarthLocation.from_geodetic(-156.3, 20.7, 3055.0)
    when = Time("2019-04-20T10:00:00") + cases[1] * u.s
    body = coord.get_body(name, when, site, ephemeris="builtin")
    place = from_angles(body.ra.rad, body.dec.rad)
    own = from_angles(np.radians(ours["apparent_ra_deg"]), np.radians(ours["apparent_dec_deg"]))
    off = np.radians(ours[column]) - separation(own, place)
    assert np.abs(off).max() * ARCSEC < limit
