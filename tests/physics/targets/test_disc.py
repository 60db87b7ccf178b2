"""Points of resolved bodies against closed forms and quadrature in the image plane."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad
from scipy.special import spherical_jn

from pipeline.errors import BadInput
from pipeline.physics.targets.disc import (
    SPHERE_VARIANCE,
    Appearance,
    Points,
    Sphere,
    photocentre_offset,
    picture,
)
from pipeline.physics.targets.sphere import sphere_area_function

PHASES = [0.0, 0.4, np.pi / 2, 2.5, np.pi - 1e-3, np.pi - 1e-8, np.pi]


def transform(points: Points, fy: float, fx: float) -> complex:
    y, x, share = points
    return complex(np.sum(share * np.exp(-2j * np.pi * (fy * y + fx * x))))


def moments(sphere: Sphere) -> tuple[float, float, float, float]:
    """Mean and variance of the light towards the Sun and across it, over the radius."""
    y, x, share = sphere.points(1.0)
    c, s = np.cos(sphere.sun_angle_rad), np.sin(sphere.sun_angle_rad)
    u, v = (x * c + y * s) / sphere.radius_px, (y * c - x * s) / sphere.radius_px
    mu, mv = share @ u, share @ v
    return mu, mv, share @ (u - mu) ** 2, share @ (v - mv) ** 2


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("radius", [1e-3, 0.3, 5.0, 60.0])
def test_limits_all_light_is_there_and_positive(phase: float, radius: float) -> None:
    y, x, share = Sphere(radius, phase, 0.7).points(1.0)
    assert share.sum() == pytest.approx(1.0, abs=1e-13)
    assert share.min() >= 0.0
    assert np.hypot(y, x).max() <= radius * (1.0 + 1e-12)


@pytest.mark.parametrize("phase", PHASES)
def test_against_photocentre_and_largest_variance(phase: float) -> None:
    mu, mv, vu, vv = moments(Sphere(7.0, phase, 2.0))
    assert mu == pytest.approx(float(photocentre_offset(1.0, phase)), abs=1e-13)
    assert mv == pytest.approx(0.0, abs=1e-13)
    assert vv == pytest.approx(SPHERE_VARIANCE, abs=1e-12)
    assert vu <= SPHERE_VARIANCE + 1e-12


def test_limits_photocentre() -> None:
    """Full: none. Half: 3 pi / 16. The thinnest crescent: 9 pi / 32 (a meridian's cos^3 light)."""
    offsets = photocentre_offset(2.0, np.array([0.0, np.pi / 2, np.pi - 1e-7, np.pi]))
    expected = 2.0 * np.array([0.0, 3 * np.pi / 16, 9 * np.pi / 32, 9 * np.pi / 32])
    np.testing.assert_allclose(offsets, expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize("radius", [0.01, 1.0, 2.0, 3.0, 4.1, 5.0, 8.0, 120.0, 6.2])
def test_against_hemisphere_transform(radius: float) -> None:
    """At full phase the light is sqrt(1 - r^2), whose transform is 3 j1(k) / k. 6.2 px are 2.997
    panels along the equator."""
    points = Sphere(radius).points(1.0)
    for f in (0.01, 0.2, 0.55, 1.0):
        k = 2.0 * np.pi * f * radius
        expected = 3.0 * spherical_jn(1, k) / k
        for fy, fx in ((0.6, 0.8), (1.0, 0.0), (0.0, 1.0)):
            assert abs(transform(points, fy * f, fx * f) - expected) < 1e-9


@pytest.mark.parametrize("phase", [0.3, np.pi / 2, 2.6])
def test_against_quadrature_of_mu0_in_the_image(phase: float) -> None:
    """mu0 = u sin a + w cos a over the lit part of the disc, u from -c cos a to c."""
    sun, fy, fx = 0.9, 0.23, -0.11
    gu = fx * np.cos(sun) + fy * np.sin(sun)
    gv = fy * np.cos(sun) - fx * np.sin(sun)

    def light(u: float, v: float) -> float:
        w = np.sqrt(max(0.0, 1.0 - u * u - v * v))
        return max(0.0, u * np.sin(phase) + w * np.cos(phase))

    def integral(wave) -> float:
        def limb(v: float) -> float:
            return np.sqrt(1.0 - v * v)

        return dblquad(
            lambda u, v: light(u, v) * wave(2.0 * np.pi * 2.0 * (gu * u + gv * v)),
            -1.0, 1.0, lambda v: -limb(v) * np.cos(phase), limb, epsabs=1e-9,
        )[0]  # fmt: skip

    total = integral(lambda _: 1.0)
    assert total == pytest.approx(float(sphere_area_function(phase, 2.0)), rel=1e-6)
    found = transform(Sphere(2.0, phase, sun).points(0.5), fy, fx)
    assert abs(found - complex(integral(np.cos), -integral(np.sin)) / total) < 1e-6


def shuffled_cells() -> Appearance:
    return picture(np.random.default_rng(3).uniform(size=(23, 31)), 0.4, (10.0, 4.5))


@settings(max_examples=40, deadline=None)
@given(
    cut_y=st.floats(-8.0, 8.0), cut_x=st.floats(-8.0, 8.0), sun=st.floats(-4.0, 4.0),
    phase=st.sampled_from([0.0, 0.9, 2.2, 3.0, np.pi - 1e-4, np.pi - 1e-8, np.pi]),
    radius=st.sampled_from([0.0, 1e-3, 0.5, 6.0, 70.0]),
)  # fmt: skip
def test_same_points_however_cut(
    cut_y: float, cut_x: float, sun: float, phase: float, radius: float
) -> None:
    body = Sphere(radius, phase, sun) if radius else shuffled_cells()
    ys, xs = (-np.inf, cut_y, np.inf), (-np.inf, cut_x, np.inf)
    parts = [
        np.stack(body.points(2.0, (ys[i], ys[i + 1], xs[j], xs[j + 1])))
        for i in range(2)
        for j in range(2)
    ]
    cut, whole = np.concatenate(parts, axis=1), np.stack(body.points(2.0))
    assert cut[:, np.lexsort(cut)].tobytes() == whole[:, np.lexsort(whole)].tobytes()


def test_against_sinc_transform_of_a_cell() -> None:
    table = np.zeros((5, 4))
    table[1, 3] = 7.0
    body = picture(table, 2.0, (2.0, 1.0))
    assert body.box == (-3.0, -1.0, 3.0, 5.0)
    for fy, fx in ((0.0, 0.0), (0.3, 0.1), (-0.9, 0.7)):
        expected = np.sinc(2 * fy) * np.sinc(2 * fx) * np.exp(-2j * np.pi * (fy * -2.0 + fx * 4.0))
        assert abs(transform(body.points(1.0), fy, fx) - expected) < 1e-7


def test_pictures_of_one_content_are_one_key() -> None:
    one, other = (picture(np.eye(4) * k, 0.5) for k in (1.0, 2.0))
    assert one == other
    assert hash(one) == hash(other)
    assert one != picture(np.eye(4), 0.25)
    assert one != picture(np.eye(4), 0.5, (0.0, 0.0))
    assert one != picture(np.eye(4)[::-1], 0.5)
    light = np.arange(1.0, 7.0)
    assert picture(light.reshape(2, 3), 0.5, (0, 0)) != picture(light.reshape(3, 2), 0.5, (0, 0))


@pytest.mark.parametrize(
    "table", [np.zeros((3, 3)), -np.ones((3, 3)), np.full((3, 3), np.nan), np.ones(3)]
)
def test_limits_pictures_without_light(table: np.ndarray) -> None:
    with pytest.raises(BadInput):
        picture(table, 1.0)


@pytest.mark.parametrize(
    ("radius", "phase"), [(0.0, 0.0), (-1.0, 0.0), (np.inf, 0.0), (1.0, 3.2), (1.0, np.nan)]
)
def test_limits_spheres_that_cannot_be(radius: float, phase: float) -> None:
    with pytest.raises(BadInput):
        Sphere(radius, phase)
