"""The Earth's place, rotation and sites against astropy."""

from __future__ import annotations

import astropy.units as au
import numpy as np
import pytest
from astropy.coordinates import (
    GCRS,
    ITRS,
    TEME,
    CartesianDifferential,
    CartesianRepresentation,
    EarthLocation,
    get_body_barycentric_posvel,
)
from astropy.coordinates.builtin_frames.utils import get_polar_motion
from astropy.time import Time

from pipeline.physics.positions.earth import (
    earth_and_sun,
    gcrs_to_itrs,
    site_axes,
    site_state,
    teme_to_gcrs,
)
from pipeline.physics.positions.times import Instants, instants, parse_utc
from pipeline.physics.vectors import unit

EPOCHS = ["1995-03-01T12:00:00", "2019-04-20T03:00:00", "2026-01-15T07:30:00"]


def both(text: str) -> tuple[Instants, Time, float, float]:
    t = Time(text, scale="utc")
    dut1 = float(t.get_delta_ut1_utc().to_value(au.s))
    xp, yp = get_polar_motion(t)
    return instants(parse_utc(text + "Z"), np.array([0.0]), dut1), t, float(xp), float(yp)


@pytest.mark.parametrize("text", EPOCHS)
def test_against_astropy_earth_and_sun(text: str) -> None:
    at, t, _, _ = both(text)
    ours = earth_and_sun(at.tt1, at.tt2)
    p, v = get_body_barycentric_posvel("earth", t, ephemeris="builtin")
    sun = get_body_barycentric_posvel("sun", t, ephemeris="builtin")[0]
    # astropy gives epv00 true TDB: up to 2 ms, 60 m of the Earth's way
    assert np.linalg.norm(ours.position_m[0] - p.xyz.to_value(au.m)) < 100
    assert np.linalg.norm(ours.velocity_m_s[0] - v.xyz.to_value(au.m / au.s)) < 1e-4
    assert np.linalg.norm(ours.sun_from_earth_m[0] - (sun - p).xyz.to_value(au.m)) < 1e5


@pytest.mark.parametrize("text", EPOCHS)
@pytest.mark.parametrize(("lat", "lon", "height"), [(20.7, -156.3, 3055), (-89.99, 10, 2800),
                                                    (0.0, 179.999, -50)])  # fmt: skip
def test_against_astropy_site(text: str, lat: float, lon: float, height: float) -> None:
    at, t, xp, yp = both(text)
    p, v = site_state(np.radians(lat), np.radians(lon), height, at, xp, yp)
    place = EarthLocation.from_geodetic(lon * au.deg, lat * au.deg, height * au.m)
    q, w = place.get_gcrs_posvel(t)
    assert np.linalg.norm(p[0] - q.xyz.to_value(au.m)) < 1e-3
    assert np.linalg.norm(v[0] - w.xyz.to_value(au.m / au.s)) < 1e-6


def test_site_velocity_is_the_derivative_and_has_the_known_size() -> None:
    site = (np.radians(20.7), np.radians(-156.3), 3055.0)
    at = instants(parse_utc("2019-04-20T03:00:00Z"), np.array([-1.0, 0.0, 1.0]))
    p, v = site_state(*site, at)
    assert np.allclose((p[2] - p[0]) / 2, v[1], atol=1e-4)
    assert np.linalg.norm(v[1]) == pytest.approx(435.4, abs=0.1)  # 0.30 arcsec
    fixed = np.einsum("nij,nj->ni", gcrs_to_itrs(at), p)
    assert np.allclose(fixed, fixed[0], atol=1e-6)


@pytest.mark.parametrize("text", EPOCHS)
def test_against_astropy_rotation(text: str) -> None:
    at, t, xp, yp = both(text)
    r = np.array([4.2e7, 1e6, -3e6])
    there = GCRS(CartesianRepresentation(r * au.m), obstime=t).transform_to(ITRS(obstime=t))
    ours = gcrs_to_itrs(at, xp, yp)[0] @ r
    assert np.linalg.norm(ours - there.cartesian.xyz.to_value(au.m)) < 2e-2


@pytest.mark.parametrize("text", EPOCHS)
def test_against_astropy_teme(text: str) -> None:
    at, t, _, _ = both(text)
    r = np.array([-7000e3, 41000e3, 300e3])
    frame = TEME(
        CartesianRepresentation(
            r * au.m, differentials=CartesianDifferential(np.zeros(3) * au.m / au.s)
        ),
        obstime=t,
    )
    theirs = frame.transform_to(GCRS(obstime=t)).cartesian.xyz.to_value(au.m)
    ours = teme_to_gcrs(at)[0] @ r
    assert np.linalg.norm(ours - theirs) < 5e-3
    if text.startswith("2026"):
        assert np.linalg.norm(ours - r) > 1e5  # TEME is no GCRS


def test_matrices_are_rotations() -> None:
    at = instants(parse_utc("2019-04-20T03:00:00Z"), np.linspace(0, 86400, 7))
    for m in (gcrs_to_itrs(at, 1e-6, 2e-6), teme_to_gcrs(at)):
        assert np.allclose(m @ np.swapaxes(m, 1, 2), np.eye(3), atol=1e-14)
        assert np.allclose(np.linalg.det(m), 1)


def test_site_axes_are_the_ways_that_a_site_moves() -> None:
    """North, east and up by small steps of latitude, longitude and height, the pole far moved."""
    at = instants(parse_utc("2019-04-20T03:00:00Z"), np.array([0.0, 20_000.0]))
    lat, lon, pole = np.radians(35.0), np.radians(-120.0), (3e-3, -2e-3)

    def moved(north: float, east: float, up: float) -> np.ndarray:
        return site_state(lat + north, lon + east, 2000.0 + up, at, *pole)[0]

    steps = [(1e-5, 0.0, 0.0), (0.0, 1e-5, 0.0), (0.0, 0.0, 60.0)]
    expected = np.stack([unit(moved(*s) - moved(*(-v for v in s))) for s in steps], axis=1)
    np.testing.assert_allclose(site_axes(lat, lon, at, *pole), expected, atol=1e-7)
