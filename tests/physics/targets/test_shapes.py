"""Plates, boxes, cylinders, cones and frusta against meshes, long decimals, limits, symmetry."""

from __future__ import annotations

import itertools

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.physics.targets.frustum import (
    cone_area_function,
    cylinder_area_function,
    frustum_area_function,
)
from pipeline.physics.targets.plate import box_area_function, plate_area_function
from pipeline.physics.targets.sphere import sphere_area_function
from pipeline.physics.vectors import from_angles, unit

COUNT = 2000
SIZES = st.floats(0.01, 10.0)
SEEDS = st.integers(0, 2**32 - 1)


def directions(seed: int, count: int = COUNT) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return tuple(unit(rng.normal(size=(count, 3))) for _ in range(2))  # type: ignore[return-value]


def by_mesh(s, o, r0, r1, h, facets=20_000):
    """A prism of many facets: midpoints in azimuth (its error falls with their square)."""
    p = (np.arange(facets) + 0.5) / facets * 2 * np.pi
    slant = np.hypot(h, r0 - r1)
    normal = np.stack([h * np.cos(p), h * np.sin(p), (r0 - r1) + 0 * p], -1) / slant
    lit, seen = np.maximum(normal @ s, 0), np.maximum(normal @ o, 0)
    side = np.mean(lit * seen) * np.pi * (r0 + r1) * slant
    lids = r1**2 * max(s[2], 0) * max(o[2], 0) + r0**2 * max(-s[2], 0) * max(-o[2], 0)
    return side + np.pi * lids


@pytest.mark.parametrize("shape", [(1, 1, 2), (1, 0, 0.7), (0.3, 1.2, 0.5), (2, 0.1, 0.05)])
def test_against_fine_meshes(shape) -> None:
    sun, observer = directions(3, 150)
    ours = frustum_area_function(sun, observer, *shape)
    theirs = [by_mesh(s, o, *shape) for s, o in zip(sun, observer, strict=True)]
    assert np.max(np.abs(ours - theirs)) < 3e-7


def exact_side(s, o, r0, r1, h) -> float:
    """The side in 40 digits: roots and integral of the same rounded directions."""
    with mp.workdps(40):
        s, o = ([mp.mpf(float(x)) for x in v] for v in (s, o))
        r0, r1, h = (mp.mpf(x) for x in (r0, r1, h))
        slant = mp.hypot(h, r0 - r1)
        terms, ends = [], [-mp.pi, mp.pi]
        for d in (s, o):
            a, b = (r0 - r1) / slant * d[2], h / slant * mp.hypot(d[0], d[1])
            place = mp.atan2(d[1], d[0])
            terms.append((a, b, place))
            if b > abs(a):
                w = mp.acos(-a / b)
                ends += [mp.fmod(x + 5 * mp.pi, 2 * mp.pi) - mp.pi for x in (place - w, place + w)]
        ends = sorted(ends)
        total = mp.mpf(0)
        for low, high in itertools.pairwise(ends):
            middle = (low + high) / 2
            (a, b, p), (c, d, q) = terms
            if a + b * mp.cos(middle - p) <= 0 or c + d * mp.cos(middle - q) <= 0:
                continue

            def primitive(x, a=a, b=b, p=p, c=c, d=d, q=q):
                wave = x * mp.cos(p - q) + mp.sin(2 * x - p - q) / 2
                lines = a * d * mp.sin(x - q) + b * c * mp.sin(x - p)
                return a * c * x + lines + b * d * wave / 2

            total += primitive(high) - primitive(low)
        return float(total * (r0 + r1) / 2 * slant)


HARD = [  # Sun's and observer's (azimuth, elevation) in degrees
    ((0, 0), (0, 0)), ((0, 0), (180 - 1e-6, 0)), ((0, 10), (179.9, -5)), ((10, 60), (190, 60)),
    ((0, 89.999), (180, 20)), ((0, 26.6), (180, 26.5)), ((0, 1e-7), (90, 1e-9)),
    ((5, -63.4), (5, -63.43)), ((0, 40), (170, 35)), ((33, -20), (33 + 1e-9, -20)),
    ((0, 63.4), (180, 63.44)), ((0, -26), (150, 70)), ((0, 45), (180 - 1e-4, 5)),
]  # fmt: skip


@pytest.mark.parametrize("shape", [(1, 1, 2), (1, 0, 2), (1, 0.5, 1), (0.2, 1.5, 0.4)])
@pytest.mark.parametrize(("sun", "observer"), HARD)
def test_against_long_decimals(sun, observer, shape) -> None:
    """Thin, grazing, opposite and two-piece arcs: every digit but the directions' own rounding."""
    s, o = (from_angles(*(np.radians(float(x)) for x in d)) for d in (sun, observer))
    ours = float(frustum_area_function(s, o, *shape, False, False))
    assert ours == pytest.approx(exact_side(s, o, *shape), rel=2e-12, abs=1e-30)


def test_against_long_decimals_at_random() -> None:
    rng = np.random.default_rng(5)
    sun, observer = directions(6, 150)
    for s, o in zip(sun, observer, strict=True):
        shape = rng.uniform(0.01, 2, 3)
        ours = float(frustum_area_function(s, o, *shape, False, False))
        assert ours == pytest.approx(exact_side(s, o, *shape), rel=2e-13, abs=1e-18)


def test_limits_two_arcs_on_a_cone() -> None:
    """Sun and observer ahead of a blunt cone on opposite sides: light from both flanks."""
    s = from_angles(np.zeros(1), np.array([0.87]))
    o = from_angles(np.full(1, np.pi), np.array([0.9]))
    both = float(cone_area_function(s, o, 1.0, 2.0, closed=False)[0])
    assert both == pytest.approx(by_mesh(s[0], o[0], 1, 0, 2), rel=1e-6)
    assert both > 0


def test_limits_phases_0_and_180_and_edge_on() -> None:
    sun, _ = directions(1)
    solids = (
        lambda s, o: frustum_area_function(s, o, 1.0, 0.4, 2.0),
        lambda s, o: box_area_function(s, o, [1.0, 2.0, 3.0]),
        lambda s, o: plate_area_function(s, o, 2.0, True),
    )
    for area in solids:
        assert np.all(area(sun, sun) > 0)
        assert np.all(area(sun, -sun) <= 1e-28)  # new: nothing but rounding of the arcs, cubed
    x, z = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    assert plate_area_function(x, z, 1.0, True) == 0
    assert plate_area_function(z, -z, 1.0, True) == 0
    assert plate_area_function(-z, -z, 1.0, True) == 1
    assert plate_area_function(-z, -z, 1.0) == 0
    assert cylinder_area_function(z, z, 1.0, 5.0) == pytest.approx(np.pi, rel=1e-15)
    assert cylinder_area_function(z, z, 1.0, 5.0, closed=False) == 0
    assert cylinder_area_function(x, x, 1.0, 5.0) == pytest.approx(5 * np.pi / 2, rel=1e-15)
    assert np.isnan(frustum_area_function(np.full(3, np.nan), z, 1.0, 0.5, 1.0))


@settings(max_examples=40, deadline=None)
@given(SEEDS, SIZES, SIZES, SIZES)
def test_same_with_sun_and_observer_exchanged(seed, r0, r1, h) -> None:
    s, o = directions(seed)
    for area in (
        lambda a, b: frustum_area_function(a, b, r0, r1, h),
        lambda a, b: box_area_function(a, b, [r0, r1, h]),
        lambda a, b: plate_area_function(a, b, r0, True),
    ):
        there, back = area(s, o), area(o, s)
        np.testing.assert_allclose(there, back, rtol=1e-11, atol=1e-15)
        assert np.all(there >= 0)


@settings(max_examples=30, deadline=None)
@given(SEEDS, SIZES, SIZES, st.floats(0, 2 * np.pi))
def test_same_turned_about_the_axis_and_in_the_limits(seed, r, h, angle) -> None:
    s, o = directions(seed)
    c, n = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -n, 0], [n, c, 0], [0, 0, 1]])
    cylinder = cylinder_area_function(s, o, r, h)
    scale = r * (r + h)
    turned = cylinder_area_function(s @ turn.T, o @ turn.T, r, h)
    np.testing.assert_allclose(turned, cylinder, atol=1e-14 * scale)
    near = frustum_area_function(s, o, r, r * (1 - 1e-9), h)
    np.testing.assert_allclose(near, cylinder, atol=1e-7 * scale)
    pointed = frustum_area_function(s, o, r, r * 1e-9, h)
    np.testing.assert_allclose(pointed, cone_area_function(s, o, r, h), atol=1e-7 * scale)
    flat = frustum_area_function(s, o, r, r * 0.5, 1e-9, True, False)
    disc = np.pi * r * r
    ring = plate_area_function(s, o, 0.75 * disc) + plate_area_function(-s, -o, disc)
    np.testing.assert_allclose(flat, ring, atol=1e-7 * scale + 1e-7)


@settings(max_examples=30, deadline=None)
@given(SEEDS, SIZES, arrays(float, 3, elements=SIZES))
def test_same_cube_box_and_plates(seed, edge, size) -> None:
    s, o = directions(seed)
    for lengths in ([edge] * 3, size):
        total = 0.0
        for axis in range(3):
            face = lengths[(axis + 1) % 3] * lengths[(axis + 2) % 3]
            order = [(axis + 1) % 3, (axis + 2) % 3, axis]
            for sign in (1, -1):
                total = total + plate_area_function(sign * s[:, order], sign * o[:, order], face)
        np.testing.assert_allclose(box_area_function(s, o, lengths), total, rtol=1e-14)


@pytest.mark.parametrize("shape", [(1, 1, 2), (1, 0, 0.7), (0.3, 1.2, 0.5), (2, 0.1, 5)])
def test_same_mean_cross_section_is_a_quarter_of_the_surface(shape) -> None:
    """Cauchy. The mean of G over observers is a quarter of the cross-section that the Sun sees."""
    u, w = np.polynomial.legendre.leggauss(36)
    elevation, weight = 0.5 * np.pi * u, 0.25 * np.pi * w * np.cos(0.5 * np.pi * u)
    azimuth = 2 * np.pi * (np.arange(48) + 0.5) / 48
    s = from_angles(np.zeros(36), elevation)[:, None, None]
    o = from_angles(*np.meshgrid(azimuth, elevation))[None]
    mean = np.einsum("i,j,ijk->", weight, weight, frustum_area_function(s, o, *shape)) / 48
    r0, r1, h = shape
    surface = np.pi * (r0**2 + r1**2 + (r0 + r1) * np.hypot(h, r0 - r1))
    assert 4 * mean == pytest.approx(surface / 4, rel=2e-3)


def test_against_the_sphere_by_slices() -> None:
    """A sphere of thin open frusta has the sphere's area function at every phase."""
    edges = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2001)
    r, z = np.cos(edges), np.sin(edges)
    for phase in (0.0, 0.6, 1.9, 3.0):
        for tilt in (0.0, 0.8):
            s = np.array([np.cos(tilt), 0, np.sin(tilt)])
            o = np.array([np.cos(tilt + phase), 0, np.sin(tilt + phase)])
            total = frustum_area_function(s, o, r[:-1], r[1:], np.diff(z), False, False).sum()
            assert total == pytest.approx(float(sphere_area_function(phase, 2.0)), abs=3e-6)
