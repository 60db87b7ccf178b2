"""Pixels by quadrature: against scipy's adaptive integration and the error function."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erfc, i0e

from pipeline.physics.drawing import quadrature
from pipeline.physics.drawing.quadrature import (
    RELATIVE,
    affordable,
    draw_quadrature,
    has_profile,
)
from pipeline.physics.motion.streak import POINT, Path
from pipeline.physics.psf.band import Mixture
from pipeline.physics.psf.pupil import Airy, Blur, EllipticalGaussian, Gaussian
from pipeline.physics.psf.seeing import Kolmogorov, Moffat

SIDE, Y, X = 64, 30.3, 27.8
AIRY, MOFFAT = Airy(1.2, 0.35), Moffat(2.0, 2.5)
SHARP = Moffat(0.4, 1.6)
TWO = Mixture((Airy(1.0, 0.3), Airy(1.3, 0.3)), (0.4, 0.6))
PIXELS = ((30, 28), (31, 27), (33, 30), (30, 35), (45, 20), (3, 60), (63, 0))


def two(r: np.ndarray) -> np.ndarray:
    return np.sum([w * p.intensity(r) for p, w in zip(TWO.parts, TWO.weights, strict=True)], axis=0)


def pixel(intensity: Callable, y: float, x: float, side: float = 1.0) -> float:
    """Integral over a square by panels of Gauss-Legendre, none of them shared with the engine."""
    at, weight = np.polynomial.legendre.leggauss(40)
    edges = np.linspace(-0.5, 0.5, 6) * side
    nodes = (0.5 * (edges[1:] + edges[:-1])[:, None] + 0.1 * side * at).ravel()
    w = np.tile(weight, 5) * 0.1 * side
    return float(w @ intensity(np.hypot(y + nodes[:, None], x + nodes)) @ w)


@pytest.mark.parametrize(
    ("optics", "intensity"),
    [(AIRY, AIRY.intensity), (Airy(0.4), Airy(0.4).intensity), (MOFFAT, MOFFAT.intensity),
     (SHARP, SHARP.intensity), (TWO, two)],
)  # fmt: skip
def test_pixels_at_rest(optics: object, intensity: Callable) -> None:
    """Near and far: to 1e-12 of each pixel's own light."""
    seen = draw_quadrature(Blur(optics, fill_factor=0.8), POINT, (SIDE, SIDE), (0, 0), Y, X)
    for row, column in PIXELS:
        exact = pixel(intensity, row - Y, column - X, 0.8**0.5)
        assert seen[row, column] == pytest.approx(exact, rel=RELATIVE)


@pytest.mark.parametrize(("fwhm_px", "beta"), [(0.1, 1.5), (0.05, 3.0)])
def test_light_far_narrower_than_a_pixel(fwhm_px: float, beta: float) -> None:
    """In the middle of its pixel: by the share of the light within each direction's edge."""
    wide = 0.5 * fwhm_px / (2.0 ** (1.0 / beta) - 1.0) ** 0.5

    def within(angle: float) -> float:
        return 1.0 - (1.0 + (0.5 / math.cos(angle) / wide) ** 2) ** (1.0 - beta)

    seen = draw_quadrature(Blur(Moffat(fwhm_px, beta)), POINT, (5, 5), (0, 0), 2.0, 2.0)
    exact = quad(within, 0.0, math.pi / 4, epsabs=1e-14)[0] * 4.0 / math.pi
    assert seen[2, 2] == pytest.approx(exact, rel=RELATIVE)


@pytest.mark.parametrize("y", [2.3, 61.1])
@pytest.mark.parametrize("x", [1.9, 60.8])
def test_the_corner_farthest_from_a_source_has_its_light(y: float, x: float) -> None:
    seen = draw_quadrature(Blur(MOFFAT), POINT, (SIDE, SIDE), (0, 0), y, x)
    for row in (0, SIDE - 1):
        for column in (0, SIDE - 1):
            exact = pixel(MOFFAT.intensity, row - y, column - x)
            assert seen[row, column] == pytest.approx(exact, rel=RELATIVE)


def test_a_gaussian_is_the_error_function() -> None:
    """Until it is less than 1e-25 of the light, also where it is blurred and elliptical."""

    def side(sigma: float, at: float) -> np.ndarray:
        x = np.abs(np.arange(SIDE) - at)
        return 0.5 * (erfc((x - 0.5) / sigma / 2**0.5) - erfc((x + 0.5) / sigma / 2**0.5))

    wide = math.hypot(1.6, 0.3)
    flat = EllipticalGaussian(1.6, 0.7)
    for optics, narrow in ((Gaussian(1.6), wide), (flat, math.hypot(0.7, 0.3))):
        seen = draw_quadrature(Blur(optics, 0.3), POINT, (SIDE, SIDE), (0, 0), Y, X)
        exact = np.outer(side(narrow, Y), side(wide, X))
        assert (np.abs(seen - exact) <= RELATIVE * exact + 1e-25).all()


@pytest.mark.parametrize("sigma", [0.1, 0.5])
def test_a_blurred_pattern(sigma: float) -> None:
    """Jitter: the mean over rings by adaptive quadrature, to 1e-11."""
    blur = Blur(AIRY, sigma)

    def ring(r: float) -> float:
        def part(s: float) -> float:
            near = math.exp(-0.5 * ((r - s) / sigma) ** 2) * i0e(r * s / sigma**2)
            return float(AIRY.intensity(np.array(s))) * s / sigma**2 * near

        ends = max(0.0, r - 9.0 * sigma), r + 9.0 * sigma
        return float(quad(part, *ends, epsrel=1e-13, epsabs=0.0, limit=200)[0])

    seen = draw_quadrature(blur, POINT, (SIDE, SIDE), (0, 0), Y, X)
    at, weight = np.polynomial.legendre.leggauss(12)
    for row, column in ((30, 28), (36, 33)):
        r = np.hypot(row - Y + 0.5 * at[:, None], column - X + 0.5 * at)
        light = np.array([ring(v) for v in r.ravel()]).reshape(r.shape)
        exact = 0.25 * weight @ light @ weight
        assert seen[row, column] == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize("optics", [AIRY, MOFFAT, Gaussian(0.9)])
def test_a_streak_is_the_sum_of_its_points(optics: object) -> None:
    """A bent path, whatever the window is: against ten times as many points, midpoint rule."""
    blur = Blur(optics)
    path = Path(np.array([-9.0, 1.0, 4.0]), np.array([-2.0, 2.0, -1.0]), np.array([0.7, 0.3]))
    seen = draw_quadrature(blur, path, (SIDE, SIDE), (0, 0), Y, X)
    part = draw_quadrature(blur, path, (9, 7), (25, 20), Y, X, frame=(SIDE, SIDE))
    assert np.array_equal(part, seen[25:34, 20:27])
    finer = draw_quadrature(blur, path, (9, 7), (25, 20), Y, X, finer=True)
    assert np.abs(finer / part - 1.0).max() < 10.0 * RELATIVE
    step = (np.arange(4000) + 0.5) / 4000
    for row, column in ((30, 20), (45, 40)):
        total = 0.0
        for k, w in enumerate(path.weight):
            ends = (path.y_px[k], path.y_px[k + 1], path.x_px[k], path.x_px[k + 1])
            y, x = (a + step * (b - a) for a, b in (ends[:2], ends[2:]))
            at, weight = np.polynomial.legendre.leggauss(16)
            nodes = np.meshgrid(0.5 * at, 0.5 * at, indexing="ij")
            area = 0.25 * np.outer(weight, weight)
            y, x = (v[:, None, None] for v in (row - Y - y, column - X - x))
            r = np.hypot(y + nodes[0], x + nodes[1])
            total += w * float((optics.intensity(r) * area).sum(axis=(1, 2)).mean())
        assert seen[row, column] == pytest.approx(total, rel=1e-6, abs=1e-20)


def test_where_light_ends() -> None:
    """As wings do: over the last tenth of the reach."""
    blur, place = Blur(AIRY), (POINT, (1, 80), (0, 0), 0.0, 0.0)
    whole, cut = draw_quadrature(blur, *place), draw_quadrature(blur, *place, 50.0)
    r = np.arange(80)
    assert cut[0, r <= 45] == pytest.approx(whole[0, r <= 45], rel=RELATIVE, abs=0.0)
    assert (cut[0, r >= 50] == 0.0).all()
    assert cut[0, 47] / whole[0, 47] == pytest.approx(0.6**3 * (10 + 0.6 * (6 * 0.6 - 15)))


def test_no_table_is_read_beyond_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pixels farther than the light reaches, but nearer than the profile: each index is checked."""
    for name in ("_pixel_at", "_side", "_left", "_integrate"):
        monkeypatch.setattr(quadrature, name, getattr(quadrature, name).py_func)
    blur, reach = Blur(Airy(1.3), 0.4), 31.0
    for first in range(24, 44, 2):
        drawn = draw_quadrature(blur, POINT, (1, 2), (0, first), 0.0, 0.0, reach)
        assert (drawn[0] > 0.0).tolist() == [first < reach, first + 1 < reach]


def test_what_it_serves() -> None:
    frame = (2048, 2048)
    assert has_profile(Blur(TWO))
    assert not has_profile(Blur(Kolmogorov(2.0)))
    assert affordable(Blur(AIRY), POINT, frame)
    long = Path(np.array([0.0, 300.0]), np.zeros(2), np.ones(1))
    assert not affordable(Blur(AIRY), long, frame)
    assert affordable(Blur(AIRY), long, (256, 256))


@pytest.mark.parametrize("angle", [0.5, -1.1, 2.4])
def test_a_turned_ellipse(angle: float) -> None:
    """Major axis from +x towards +y, jitter in both; also away from the axes."""
    optics = EllipticalGaussian(1.6, 0.7, angle)
    seen = draw_quadrature(Blur(optics, 0.3), POINT, (SIDE, SIDE), (0, 0), Y, X)
    major, minor = math.hypot(1.6, 0.3), math.hypot(0.7, 0.3)
    at, weight = np.polynomial.legendre.leggauss(30)
    for row, column in ((30, 28), (31, 30), (28, 31), (33, 26), (34, 31)):
        v, u = row - Y + 0.5 * at[:, None], column - X + 0.5 * at
        along, across = u * np.cos(angle) + v * np.sin(angle), v * np.cos(angle) - u * np.sin(angle)
        light = np.exp(-0.5 * ((along / major) ** 2 + (across / minor) ** 2))
        exact = 0.25 * weight @ light @ weight / (2.0 * np.pi * major * minor)
        assert seen[row, column] == pytest.approx(exact, rel=1e-9)


def test_clocked_charge_is_a_streak_along_its_columns() -> None:
    step = Path(np.zeros(2), np.array([-0.65, 0.65]), np.ones(1))
    frame = (20, 16), (22, 20), Y, X
    clocked = draw_quadrature(Blur(MOFFAT, clock_px=1.3), POINT, *frame)
    swept = draw_quadrature(Blur(MOFFAT), step, *frame)
    assert clocked == pytest.approx(swept, rel=1e-10)
    most = (7000, 7000)
    assert affordable(Blur(MOFFAT), POINT, most)
    assert not affordable(Blur(MOFFAT, clock_px=1.3), POINT, most)


@pytest.mark.parametrize("optics", [Airy(1.0, 0.3), Moffat(2.5, 2.5)], ids=["airy", "moffat"])
def test_a_narrow_blur_is_the_mean_of_few_places(optics):
    """Against Rice's distribution where both serve; of next to nothing it asks for no more memory,
    and changes next to nothing."""
    width_px = quadrature._scale(optics) / quadrature.PANELS
    r_px = (np.arange(200)[:, None] + 0.5 * (quadrature._panel() + 1.0)) * width_px
    least_px = quadrature.NARROW * quadrature._scale(optics)
    rings = quadrature._blurred(optics, 1.001 * least_px, r_px, width_px)
    places = quadrature._mean_around(optics, 1.001 * least_px, r_px)
    np.testing.assert_allclose(places, rings, rtol=1e-12)
    tiny = quadrature._blurred(optics, 1e-8, r_px, width_px)
    np.testing.assert_allclose(tiny, optics.intensity(r_px), rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize(("shape", "y", "x"), [((80, 8), 2.3, 60.8), ((8, 80), 60.8, 2.3)])
def test_a_narrow_window_beside_a_source_has_all_its_light(
    shape: tuple[int, int], y: float, x: float
) -> None:
    seen = draw_quadrature(Blur(MOFFAT), POINT, shape, (0, 0), y, x)
    for row in (0, shape[0] - 1):
        for column in (0, shape[1] - 1):
            exact = pixel(MOFFAT.intensity, row - y, column - x)
            assert seen[row, column] == pytest.approx(exact, rel=RELATIVE)


@pytest.mark.parametrize(
    ("optics", "first"),
    [(Airy(3.0, 0.3), 0), (Airy(30.0), 0), (Airy(0.1), 0), (AIRY, 1000), (MOFFAT, 2000),
     (SHARP, 300), (Airy(1.0, 0.2), 100)],
)  # fmt: skip
def test_sides_and_areas_agree(optics: object, first: int) -> None:
    """Dark rings, and far away: what flows through a pixel's sides is what falls on it."""
    place = Blur(optics), POINT, (24, 24), (first, first // 2), 3.3, 2.2, 4000.0
    sides, areas = (draw_quadrature(*place, finer, (first + 24, 1)) for finer in (False, True))
    assert (areas > 0.0).all()
    assert (np.abs(sides - areas) <= RELATIVE * np.sqrt(areas)).all()


@pytest.mark.parametrize(("major_px", "minor_px"), [(5.0, 1.0), (10.0, 0.3), (20.0, 1.0)])
def test_long_ellipses_are_integrated_over_areas(major_px: float, minor_px: float) -> None:
    """Along a side what flows is far sharper than the ellipse."""
    blur = Blur(EllipticalGaussian(major_px, minor_px, 0.5))
    drawn, finer = (
        draw_quadrature(blur, POINT, (33, 33), (0, 0), 15.8, 16.3, finer=more)
        for more in (False, True)
    )
    assert (np.abs(drawn - finer) <= 1e-11 * finer + 1e-24).all()


@pytest.mark.parametrize("half_px", [0.15, 1.0, 3.65])
@pytest.mark.parametrize("optics", [Airy(6.0), Airy(3.0, 0.3), AIRY, MOFFAT, Gaussian(3.0)])
def test_few_points_stand_for_a_short_path(optics: object, half_px: float) -> None:
    """Against twice as many as any rule asks for, to what pixels may err by."""
    ends = np.array([-half_px, half_px])
    place = Blur(optics), Path(ends, 0.4 * ends, np.ones(1)), (24, 24), (0, 0), 9.3, 8.2
    seen, finer = (draw_quadrature(*place, 200.0, more, (24, 24)) for more in (False, True))
    assert (np.abs(seen - finer) <= RELATIVE * np.sqrt(finer)).all()
