"""Refraction against ERFA's own routine, and its inverse."""

from __future__ import annotations

import erfa
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics.constants import ARCSEC_RAD
from pipeline.physics.positions.refraction import (
    refract,
    refraction_terms,
    squeeze,
    standard_air,
    unrefract,
)
from pipeline.physics.vectors import separation, unit

A, B = refraction_terms(1005.0, 7.0, 0.8, 574e-9)
ZENITH = unit(np.array([0.3, -0.5, 0.6]))
AIR = np.array([*ZENITH, A, B])
EAST = unit(np.cross(ZENITH, [0.0, 0.0, 1.0]))


def at_height(height_deg):
    h = np.radians(np.atleast_1d(height_deg))
    return np.cos(h)[:, None] * EAST + np.sin(h)[:, None] * ZENITH


def test_against_erfa():
    """eraAtioq with refa, refb and nothing else: observed zenith distance of a CIRS direction."""
    astrom = np.zeros((), erfa.dt_eraASTROM)
    astrom["phi"], astrom["refa"], astrom["refb"] = np.pi / 2, A, B
    astrom["sphi"], astrom["cphi"] = 1.0, 0.0
    for height in (89.9, 60.0, 30.0, 15.0, 8.0, 4.0, 1.0):
        _, zob, *_ = erfa.atioq(0.0, np.radians(height), astrom)
        seen = refract(at_height(height), AIR)
        off = 3e-8 if height > 5.0 else 3e-6  # its turn is a series in the bending
        assert float(separation(seen, ZENITH)[0]) == pytest.approx(float(zob), abs=off)


def test_against_published_ray_tracing():
    """The table in ERFA's notes for refco (574 nm, 1005 hPa, 7 C, 80%): observed zenith distances
    and arcseconds by ray tracing."""
    for zenith_deg, arcsec in ((10, 10.27), (30, 33.61), (50, 69.28), (70, 158.63), (76, 229.45)):
        seen = at_height(90.0 - zenith_deg)
        bent = separation(seen, unrefract(seen, AIR)) / ARCSEC_RAD
        assert bent[0] == pytest.approx(arcsec, abs=0.1)


@given(st.floats(-89.0, 90.0), st.floats(0.0, 6.28))
def test_inverse_to_rounding(height_deg, azimuth):
    north = np.cross(ZENITH, EAST)
    h = np.radians(height_deg)
    u = np.cos(h) * (np.cos(azimuth) * EAST + np.sin(azimuth) * north) + np.sin(h) * ZENITH
    seen = refract(u[None], AIR)
    assert np.sum(seen**2) == pytest.approx(1.0, abs=4e-15)
    np.testing.assert_allclose(unrefract(seen, AIR)[0], u, atol=2e-15)
    assert seen @ ZENITH >= u @ ZENITH - 1e-15


def test_limits():
    assert refract(ZENITH[None], AIR) == pytest.approx(ZENITH[None], abs=1e-16)
    none = np.array([*ZENITH, 0.0, 0.0])
    np.testing.assert_allclose(refract(at_height(20.0), none), at_height(20.0), atol=1e-16)
    assert refract(at_height(20.0), None) is not None
    assert standard_air(0.0) == pytest.approx((1013.25, 15.0))
    assert standard_air(5000.0) == pytest.approx((540.2, -17.5), rel=1e-3)
    assert standard_air(20_000.0)[0] == pytest.approx(54.75, rel=0.01)
    blue, red = (refraction_terms(1013.25, 15.0, 0.0, nm * 1e-9)[0] for nm in (400, 800))
    assert blue / red == pytest.approx(282.76 / 274.90, rel=2e-3)  # n - 1 of air (Edlen 1966)


@given(st.floats(4.0, 88.0), st.floats(0.01, 1.0))
def test_squeeze_is_a_bound(height_deg, apart_deg):
    seen = at_height([height_deg, height_deg + apart_deg])
    true = unrefract(seen, AIR)
    ratio = separation(true[0], true[1]) / separation(seen[0], seen[1])
    assert ratio <= squeeze(np.sin(np.radians(height_deg)), AIR)
