"""The Earth's shadow against caps on the sphere, and its grazing ends."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics.constants import (
    ASTRONOMICAL_UNIT_M,
    EARTH_EQUATORIAL_RADIUS_M,
    SUN_RADIUS_M,
)
from pipeline.physics.targets.eclipse import sunlit_fraction

SUN = np.array([ASTRONOMICAL_UNIT_M, 0.0, 0.0])
LEO, GEO = 6.878e6, 4.2164e7


def place(radius_m: float, depression: np.ndarray | float) -> np.ndarray:
    """Targets behind the Earth at an angle from the axis of the shadow."""
    d = np.atleast_1d(depression)
    return radius_m * np.stack([-np.cos(d), np.sin(d), 0 * d], axis=-1)


def contact_angles(radius_m: float) -> tuple[float, float]:
    """Angles from the axis where the umbra ends and the penumbra ends, about."""
    b, a = np.arcsin(EARTH_EQUATORIAL_RADIUS_M / radius_m), SUN_RADIUS_M / ASTRONOMICAL_UNIT_M
    return b - a, b + a


def brute_fraction(target: np.ndarray, rings: int = 40_000) -> float:
    """Solar cap cut into rings about the Sun's centre; each ring's arc behind the Earth's cap."""
    to_sun = SUN - target
    a = np.arcsin(SUN_RADIUS_M / np.linalg.norm(to_sun))
    b = np.arcsin(EARTH_EQUATORIAL_RADIUS_M / np.linalg.norm(target))
    cross = np.linalg.norm(np.cross(to_sun, -target))
    c = np.arctan2(cross, to_sun @ -target)
    height = (np.arange(rings) + 0.5) / rings * 2 * np.sin(a / 2) ** 2  # equal solid angles
    rho = 2 * np.arcsin(np.sqrt(height / 2))
    x = (np.cos(b) - np.cos(c) * np.cos(rho)) / (np.sin(c) * np.sin(rho))
    return float(1 - np.mean(np.arccos(np.clip(x, -1, 1))) / np.pi)


@pytest.mark.parametrize(("radius", "bound"), [(6.5e6, 2e-6), (LEO, 2e-6), (2e7, 2e-6),
                                               (GEO, 2e-6), (4e8, 2e-6), (2e9, 5e-6)])  # fmt: skip
def test_against_caps_on_the_sphere(radius: float, bound: float) -> None:
    lo, hi = contact_angles(radius)
    targets = place(radius, np.linspace(max(lo, 0.02 * hi), hi, 23))
    ours = sunlit_fraction(targets, SUN)
    theirs = np.array([brute_fraction(t) for t in targets])
    assert np.max(np.abs(ours - theirs)) < bound
    assert ours.min() < 0.9
    assert ours.max() > 0.999


def test_limits_day_side_umbra_and_annular() -> None:
    for radius in (LEO, GEO, 3.8e8):
        assert sunlit_fraction(-place(radius, 0.1), SUN)[0] == 1.0
        assert sunlit_fraction(place(radius, np.pi / 2), SUN)[0] == 1.0
    assert sunlit_fraction(place(GEO, 0.0), SUN)[0] == 0.0
    tip_m = 1.384e9 / (1 + 0)  # length of the umbra at 1 au
    assert sunlit_fraction(place(0.999 * tip_m, 0.0), SUN)[0] == 0.0
    assert 0 < sunlit_fraction(place(1.001 * tip_m, 0.0), SUN)[0] < 0.005
    far = sunlit_fraction(place(4e9, 0.0), SUN)[0]  # annular: 1 - (b/a)^2
    b, a = EARTH_EQUATORIAL_RADIUS_M / 4e9, SUN_RADIUS_M / (ASTRONOMICAL_UNIT_M + 4e9)
    assert far == pytest.approx(1 - (b / a) ** 2, abs=1e-4)


def test_limits_grazing_follows_the_power_law() -> None:
    """Lost fraction (4 sqrt2/3 pi) x^1.5 sqrt(b/(a+b)), x the depth in solar radii."""
    target = place(GEO, 0.0)[0]
    a = np.arcsin(SUN_RADIUS_M / np.linalg.norm(SUN - target))
    b = np.arcsin(EARTH_EQUATORIAL_RADIUS_M / GEO)
    for x in (1e-6, 1e-4, 1e-3):
        sun_angle = a + b - x * a
        to_sun = np.linalg.norm(SUN) * np.array([np.cos(sun_angle), np.sin(sun_angle), 0.0])
        sun = target + to_sun
        a_here = np.arcsin(SUN_RADIUS_M / np.linalg.norm(to_sun))
        depth = (a_here + b - sun_angle) / a_here
        lost = 1 - sunlit_fraction(target[None], sun)[0]
        law = 4 * np.sqrt(2) / (3 * np.pi) * depth**1.5 * np.sqrt(np.tan(b) / (a + np.tan(b)))
        assert lost == pytest.approx(law, rel=2e-3, abs=1e-15)


@pytest.mark.parametrize("radius", [LEO, GEO, 1.3836e9, 4e9])
def test_smooth_and_monotone_through_the_shadow(radius: float) -> None:
    _, hi = contact_angles(radius)
    f = sunlit_fraction(place(radius, np.linspace(0, 1.2 * hi, 20_001)), SUN)
    assert np.all((f >= 0) & (f <= 1))
    assert np.all(np.diff(f) >= -1e-11)
    assert f[-1] == 1.0


@given(st.floats(1e3, 1e10), st.floats(0, 3.1415), st.floats(0, 6.28))
def test_limits_never_outside_zero_to_one(radius: float, angle: float, around: float) -> None:
    y, z = np.cos(around) * np.sin(angle), np.sin(around) * np.sin(angle)
    f = sunlit_fraction(radius * np.array([[-np.cos(angle), y, z]]), SUN)
    assert 0 <= f[0] <= 1


def test_known_durations_of_the_penumbra() -> None:
    """GEO about 2 minutes, LEO 8 to 10 s."""
    for radius, rate, low, high in ((GEO, 7.292e-5, 120, 135), (LEO, 1.107e-3, 7.5, 10)):
        lo, hi = contact_angles(radius)
        angles = np.linspace(lo - 0.002, hi + 0.002, 20_001)
        f = sunlit_fraction(place(radius, angles), SUN)
        inside = angles[(f > 0) & (f < 1)]
        assert low < (inside[-1] - inside[0]) / rate < high


def test_larger_earth_darkens_more() -> None:
    edge = place(GEO, contact_angles(GEO)[1] * 0.98)
    assert sunlit_fraction(edge, SUN, EARTH_EQUATORIAL_RADIUS_M + 8e4)[0] < sunlit_fraction(
        edge, SUN
    )
