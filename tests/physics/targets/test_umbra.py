"""Sunlight in the umbra: its bound against rays through bending air, and the eclipsed Moon."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.targets.umbra import DEEPEST_RAD, SCALE_M, SCATTERED, umbra_fraction

R_M, SUN_M = 6_378_137.0, 1.496e11
SUN_RAD = np.arcsin(6.957e8 / SUN_M)


def place(r_m: float, from_axis_rad: float) -> np.ndarray:
    """A target whose Earth's middle is so far from the Sun's on its sky."""
    return r_m * np.array([-np.cos(from_axis_rad), np.sin(from_axis_rad), 0.0])


def by_rays(r_m: float, c_rad: float) -> float:
    """Solid angle of the Sun's image at the limb over the Sun's own: a grid of lines that pass the
    ground at heights up to 150 km, bent towards the Earth's middle, no extinction."""
    height = np.linspace(0.0, 1.5e5, 2001)
    theta = np.arcsin((R_M + height) / r_m)
    bend = DEEPEST_RAD * np.exp(-height / SCALE_M)
    turn = np.linspace(-np.pi, np.pi, 2001)
    from_middle = (theta - bend)[:, None]  # where the line comes from, as an angle and a side
    x, y = from_middle * np.cos(turn), from_middle * np.sin(turn)
    seen = np.hypot(x - c_rad, y) < SUN_RAD
    weight = np.sin(theta) * np.gradient(theta)
    return float((seen.mean(axis=1) * 2.0 * np.pi * weight).sum() / (np.pi * SUN_RAD**2))


@pytest.mark.parametrize("r_m", [6.9e6, 8e6, 2.66e7, 4.2164e7, 3.84e8])
@pytest.mark.parametrize("depth_rad", [0.005, 0.007, 0.01, 0.015, 0.02])
def test_bound_against_bent_rays(r_m, depth_rad):
    b = np.arcsin(R_M / r_m)
    c = b - depth_rad
    if c < 0.0:
        return
    bound = float(umbra_fraction(place(r_m, c)[None], np.array([SUN_M, 0.0, 0.0]))[0])
    traced = by_rays(r_m, c)
    assert traced <= bound
    if traced > SCATTERED:
        assert bound < 10.0 * traced


def test_limits_nothing_beside_the_umbra_and_little_deep_in_it():
    sun = np.array([SUN_M, 0.0, 0.0])
    b = np.arcsin(R_M / 4.2164e7)
    at = np.array([place(4.2164e7, c) for c in (0.0, 0.05, b - 0.004, b + 0.01, 1.0)])
    at = np.vstack([at, [[4.2164e7, 0.0, 0.0]]])
    found = umbra_fraction(at, sun)
    np.testing.assert_allclose(found[:2], SCATTERED)
    np.testing.assert_array_equal(found[2:], 0.0)


def test_the_eclipsed_moon_is_fainter_than_the_bound():
    """10 to 14 magnitudes fainter than the full Moon, over the umbra."""
    sun = np.array([SUN_M, 0.0, 0.0])
    b = np.arcsin(R_M / 3.84e8)
    at = np.array([place(3.84e8, c) for c in np.linspace(0.0, b - SUN_RAD, 50)])
    assert (umbra_fraction(at, sun) >= 10.0 ** (-0.4 * 10.0)).all()
