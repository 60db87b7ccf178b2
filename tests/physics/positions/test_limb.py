"""Lines of sight past the Earth's ellipsoid against its quadratic, and visible parts of time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics.positions.earth import site_axes, site_state
from pipeline.physics.positions.limb import (
    FINER,
    crossings,
    finer,
    height_of_line_m,
    limb_angle,
    pole_at,
    upright,
    visible_fraction,
    zenith_of,
)
from pipeline.physics.positions.times import instants
from pipeline.physics.vectors import separation

A_M = 6_378_137.0
B_M = A_M * (1.0 - 1.0 / 298.257_223_563)
AXIS = np.array([0.0, 0.0, 1.0])
ANGLES = st.tuples(st.floats(-np.pi, np.pi), st.floats(-1.57, 1.57))


def vector(angles: tuple[float, float]) -> np.ndarray:
    lon, lat = angles
    return np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def crosses(place: np.ndarray, u: np.ndarray, range_m: float) -> tuple[bool, float]:
    """Whether a segment from outside meets the ellipsoid, by the roots of its quadratic in
    extended precision, and how near to a double root (its discriminant over b^2)."""
    shape = np.array([A_M, A_M, B_M], np.longdouble)
    o, d = place.astype(np.longdouble) / shape, u.astype(np.longdouble) / shape
    a, b, c = d @ d, o @ d, o @ o - 1
    disc = b * b - a * c
    if disc < 0:
        return False, float(disc / (b * b + a * abs(c)))
    first = (-b - np.sqrt(disc)) / a
    return bool(0 < first < range_m), float(disc / (b * b + a * abs(c)))


@settings(max_examples=400, deadline=None)
@given(where=ANGLES, look=ANGLES, height_m=st.floats(1e4, 1e9), log_range=st.floats(4.0, 10.0))
def test_against_the_quadratic(where, look, height_m, log_range):
    place, u, range_m = (A_M + height_m) * vector(where), vector(look), 10.0**log_range
    target = place + range_m * u
    if np.sum((target / [A_M, A_M, B_M]) ** 2) <= 1.0:
        return  # inside the Earth: no target is
    for far in (range_m, np.inf):
        hit, close = crosses(place, u, far)
        if abs(close) > 1e-9:
            assert (height_of_line_m(place, u, AXIS, far) < 0.0) == hit


def test_limits_heights_are_those_of_the_ground():
    """A line along the horizon of a place has its height; radial ones end at observer or centre."""
    for lat, radius in ((0.0, A_M), (np.pi / 2, B_M)):
        up = np.array([np.cos(lat), 0.0, np.sin(lat)])
        level = np.array([0.0, 1.0, 0.0])
        h = float(height_of_line_m((radius + 5e3) * up - 1e6 * level, level, AXIS))
        assert h == pytest.approx(5e3, rel=0.0034)
    assert height_of_line_m(A_M * 1.1 * up, up, AXIS) > 0.0
    assert height_of_line_m(A_M * 1.1 * up, -up, AXIS) == pytest.approx(-A_M)


def test_a_target_before_the_disc_over_the_pole_has_its_own_height():
    """The line ends at the target, where the stretched axis makes it longer than its range: its
    height is that of the target above the pole, which is stretched by 1 / (1 - f)."""
    place, below_m = (B_M + 1e6) * AXIS, np.array([9e5, 9.99e5, 1.001e6])
    found = height_of_line_m(place, -AXIS, AXIS, below_m)
    np.testing.assert_allclose(found, (1e6 - below_m) * A_M / B_M, atol=1e-6)


def test_it_is_continuous_as_a_target_comes_down_before_the_disc():
    place, u = np.array([4.2e7, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])
    near = height_of_line_m(place, u, AXIS, np.array([1e6, 3.55e7, 3.56e7]))
    assert near[0] == pytest.approx(4.1e7 - A_M)
    assert near[1] > 0.0
    assert near[2] == pytest.approx(4.2e7 - 3.56e7 - A_M, abs=1.0)


def test_zenith_against_the_site_axes():
    at = instants((2458593.5, 0.3), [0.0, 500.0])
    for lat in (-89.0, -20.0, 0.0, 60.0):
        site, _ = site_state(np.radians(lat), 1.0, 3000.0, at)
        up = site_axes(np.radians(lat), 1.0, at)[:, 2]
        ours = zenith_of(site, pole_at((2458593.5, 0.3)), np.radians(lat))
        np.testing.assert_allclose(ours, up, atol=1e-8)


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 90.0])
def test_limb_angle_has_the_sign_of_the_ellipsoid(tilt_deg):
    """Seen from over the equator towards it, in between, and towards the poles: its size against
    where the limb is found by halving."""
    place, tilt = np.array([7e6, 0.0, 0.0]), np.radians(tilt_deg)

    def to(angle):
        side = np.sin(angle)
        return np.stack([-np.cos(angle), np.cos(tilt) * side, np.sin(tilt) * side], -1)

    angle = np.linspace(0.0, np.pi, 2001)
    found = limb_angle(place, to(angle), AXIS)
    before = angle < 0.5 * np.pi  # lines of sight away from the Earth begin above it
    hidden = height_of_line_m(place, to(angle), AXIS) < 0.0
    assert ((found < 0.0) == hidden)[before].all()
    low, high = 0.0, 0.5 * np.pi
    for _ in range(60):
        middle = 0.5 * (low + high)
        inside = height_of_line_m(place, to(middle), AXIS) < 0.0
        low, high = (middle, high) if inside else (low, middle)
    np.testing.assert_allclose(found, angle - low, rtol=4e-3, atol=1e-9)
    below = limb_angle(0.9 * place, to(angle), AXIS)
    clear = np.abs(angle - 0.5 * np.pi) > 1e-6
    assert (np.sign(below) == np.sign(angle - 0.5 * np.pi))[clear].all()


def test_uprights_are_the_sites_zenith():
    """Geodetic, not geocentric: they differ by 0.19 degrees at 45 degrees."""
    at = instants((2458593.5, 0.3), [0.0, 500.0])
    for lat in (-89.0, -45.0, 0.0, 60.0):
        site, _ = site_state(np.radians(lat), 1.0, 3000.0, at)
        up = site_axes(np.radians(lat), 1.0, at)[:, 2]
        assert np.degrees(separation(upright(site), up)).max() < 2e-3


@pytest.mark.parametrize("offset", [-0.9, -0.2, 0.05, 0.5])
def test_visible_parts_of_a_smooth_curve(offset):
    """A parabola that dips below zero: the cubic holds it, crossings are those of its roots."""
    t = np.linspace(-1.0, 1.0, 9)
    fine = finer(t * t + offset * t - 0.1)
    roots = 0.5 * (-offset + np.array([-1, 1]) * np.sqrt(offset**2 + 0.4))
    roots = roots[np.abs(roots) < 1.0]
    at = crossings(fine) / (FINER * 8) * 2.0 - 1.0
    np.testing.assert_allclose(at, roots, atol=2e-5 + 1.0 / FINER / 8 / 50)
    dense = np.linspace(-1.0, 1.0, 200_001)
    exact = np.mean(dense**2 + offset * dense - 0.1 >= 0.0)
    assert visible_fraction(fine) == pytest.approx(exact, abs=1e-3)


def test_stated_error_holds_for_one_that_grazes():
    """The bound of the plan is one fine step: found for dips between two of them, never more."""
    t, worst = np.linspace(0.0, 1.0, 9), 0.0
    dense = np.linspace(0.0, 1.0, 400_001)
    for middle in np.linspace(0.49, 0.51, 21):
        for depth in np.geomspace(1e-8, 1e-3, 26):
            exact = np.mean((dense - middle) ** 2 >= depth)
            ours = float(visible_fraction(finer((t - middle) ** 2 - depth)))
            worst = max(worst, abs(ours - exact))
    step = 1.0 / (FINER * 8)
    assert 0.1 * step < worst < step
