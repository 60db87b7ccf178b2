"""Resolved bodies against quadrature, closed transforms and point stars; same bits in any tile."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft
from scipy.integrate import dblquad, quad
from scipy.special import erf, spherical_jn

from pipeline.physics.drawing.extended import (
    block_side,
    block_spectrum,
    body_blocks,
    draw_body,
    point_error,
    spread_body,
)
from pipeline.physics.drawing.pictures import cell_error, coarser
from pipeline.physics.drawing.wings import (
    add_wings,
    convolve,
    spread,
    wing_error,
    wing_grid,
    wing_kernel,
)
from pipeline.physics.motion.streak import POINT, Path
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import (
    Core,
    compact_core,
    core_spectrum,
    frequencies,
    stamp_at,
    window,
)
from pipeline.physics.targets.disc import Appearance, Sphere, photocentre_offset, picture

AIRY = Blur(Airy(1.5, 0.3), 0.1)
SHARP = Blur(Gaussian(0.5))


def drawn(
    size: int, body: Appearance, core: Core, y: float, x: float, path: Path = POINT,
    side: int | None = None,
) -> np.ndarray:  # fmt: skip
    image = np.zeros((size, size))
    draw_body(image, (0, 0), body, core, (y, x), 1.0, path, side)
    return image


def star(size: int, core: Core, y: float, x: float) -> np.ndarray:
    half_y, half_x, *period = window(core, 0.0, 0.0)
    spectrum = core_spectrum(core, *period)
    row, column, stamp = stamp_at(core, spectrum, (half_y, half_x), tuple(period), y, x)
    image = np.zeros((size, size))
    image[row : row + stamp.shape[0], column : column + stamp.shape[1]] = stamp
    return image


def box_gaussian(at: np.ndarray | float, sigma: float) -> np.ndarray | float:
    """Light of a unit Gaussian that a pixel `at` px away collects, one axis."""
    s = np.sqrt(2.0) * sigma
    return 0.5 * (erf((at + 0.5) / s) - erf((at - 0.5) / s))


@pytest.mark.parametrize("phase", [0.0, 1.2, 2.7])
def test_against_quadrature_of_the_lit_disc(phase: float) -> None:
    """Integral of mu0 in the image plane times the response, pixel by pixel."""
    radius, sun, y, x = 2.3, 0.6, 9.3, 9.8
    image = drawn(20, Sphere(radius, phase, sun), compact_core(SHARP, 3.2), y, x)

    def light(u: float, v: float) -> float:
        w = np.sqrt(max(0.0, 1.0 - u * u - v * v))
        return max(0.0, u * np.sin(phase) + w * np.cos(phase))

    def integral(response) -> float:
        def limb(v: float) -> float:
            return np.sqrt(1.0 - v * v)

        return dblquad(
            lambda u, v: light(u, v) * response(u * radius, v * radius),
            -1.0, 1.0, lambda v: -limb(v) * np.cos(phase), limb, epsabs=1e-8, epsrel=1e-8,
        )[0]  # fmt: skip

    total = integral(lambda u, v: 1.0)
    c, s = np.cos(sun), np.sin(sun)
    for row, column in ((9, 10), (11, 11), (8, 8), (10, 12)):

        def response(u: float, v: float, row: int = row, column: int = column) -> float:
            down = box_gaussian(row - y - (u * s + v * c), 0.5)
            return down * box_gaussian(column - x - (u * c - v * s), 0.5)

        assert abs(image[row, column] - integral(response) / total) < 1e-6


@pytest.mark.parametrize("side", [0.3, 2.5, 40.0])
def test_against_quadrature_of_a_square(side: float) -> None:
    """One even cell: the product of two one-dimensional integrals."""
    y, x = 30.2, 29.6
    image = drawn(60, picture(np.ones((1, 1)), side), compact_core(SHARP, 3.2), y, x)

    def along(at: float) -> float:
        edges = [-side / 2, side / 2]
        middle = [p for p in (at,) if abs(p) < side / 2]
        value = quad(
            lambda t: box_gaussian(at - t, 0.5), *edges, points=middle or None, epsabs=1e-12
        )
        return value[0] / side

    for row, column in ((30, 30), (29, 31), (40, 20), (50, 49)):
        assert abs(image[row, column] - along(row - y) * along(column - x)) < 1e-7


@pytest.mark.parametrize(("blur", "radius"), [(SHARP, 3.2), (AIRY, 18.0), (Blur(Airy(4.0)), 48.0)])
@pytest.mark.parametrize("body", [Sphere(1e-3, 0.0), Sphere(0.7, np.pi), Sphere(25.0, 2.0, 4.0)])
def test_no_light_is_lost(blur: Blur, radius: float, body: Sphere) -> None:
    core = compact_core(blur, radius)
    image = drawn(170, body, core, 85.4, 84.7)
    assert image.sum() == pytest.approx(core.light, abs=1e-7)
    assert image.min() > -1e-7


@pytest.mark.parametrize("blur", [SHARP, AIRY, Blur(Gaussian(0.1))])
def test_limits_a_small_sphere_is_a_point(blur: Blur) -> None:
    core = compact_core(blur, 18.0 if blur.has_wings else blur.core_px)
    point = star(60, core, 30.3, 29.9)
    off = np.abs(drawn(60, Sphere(1e-3, 1.0, 0.4), core, 30.3, 29.9) - point).max()
    assert off < point_error(blur, 1e-3, float(photocentre_offset(1e-3, 1.0))) + 3e-8
    off = np.abs(drawn(60, Sphere(1e-6), core, 30.3, 29.9) - point).max()
    assert off < 2e-8 * point.max()


@pytest.mark.parametrize("blur", [SHARP, AIRY])
@pytest.mark.parametrize("phase", [0.0, 1.0, 2.8])
def test_point_error_bounds_what_is_left_out(blur: Blur, phase: float) -> None:
    core = compact_core(blur, 18.0 if blur.has_wings else 3.2)
    for radius in (0.03, 0.2, 1.0, 6.0):
        body = drawn(80, Sphere(radius, phase, 0.0), core, 40.3, 39.9)
        shift = float(photocentre_offset(radius, phase))
        off = np.abs(body - star(80, core, 40.3, 39.9 + shift)).max()
        assert off <= point_error(blur, radius)
        off_centre = np.abs(body - star(80, core, 40.3, 39.9)).max()
        assert off_centre <= point_error(blur, radius, shift)
        if phase == 0.0 and radius <= 0.2:
            assert point_error(blur, radius) < 4.0 * off
    assert point_error(blur, 1e4) <= 2.1 * point_error(blur, 20.0)


@pytest.mark.parametrize(("blur", "radius"), [(SHARP, 3.2), (AIRY, 18.0)])
def test_same_whole_or_in_blocks(blur: Blur, radius: float) -> None:
    core = compact_core(blur, radius)
    body = Sphere(22.0, 1.9, 2.2)
    assert len(body_blocks(body, block_side(core))) == 1
    assert len(body_blocks(body, 8)) == 36
    whole = drawn(100, body, core, 50.4, 48.9)
    assert np.abs(drawn(100, body, core, 50.4, 48.9, side=8) - whole).max() < 1e-8 * 0.01


@pytest.mark.parametrize("body", [Sphere(40.0, 1.1, 0.3), picture(np.eye(30) + 0.5, 1.7)])
def test_same_bits_in_every_tile(body: Appearance) -> None:
    core = compact_core(AIRY, 18.0)
    path = Path(np.array([-60.0, 10.0, 75.0]), np.array([0.0, 3.0, 40.0]), np.array([0.4, 0.6]))
    place = (61.3, 70.1)
    whole = np.full((128, 144), 3.3)
    draw_body(whole, (0, 0), body, core, place, 1e5, path, 16)
    for y, x, rows, columns in ((0, 0, 31, 50), (31, 50, 64, 64), (100, 3, 28, 141)):
        tile = np.full((rows, columns), 3.3)
        draw_body(tile, (y, x), body, core, place, 1e5, path, 16)
        assert tile.tobytes() == whole[y : y + rows, x : x + columns].tobytes()


def test_same_as_many_bodies_along_the_path() -> None:
    core = compact_core(SHARP, 3.2)
    body = Sphere(3.0, 1.0, 0.4)
    path = Path(np.array([-2.0, 4.0]), np.array([1.0, -1.5]), np.ones(1))
    nodes, weights = np.polynomial.legendre.leggauss(40)
    steps = sum(
        0.5 * w * drawn(40, body, core, 20.0 - 0.25 - 1.25 * t, 20.3 + 1.0 + 3.0 * t)
        for t, w in zip(nodes, weights, strict=True)
    )
    assert np.abs(drawn(40, body, core, 20.0, 20.3, path) - steps).max() < 1e-9


@pytest.mark.parametrize("radius", [2000.0, 1e5])
def test_limits_a_body_that_covers_the_frame(radius: float) -> None:
    """A full sphere of any size: a pixel holds 3/2 cos / (pi R^2), as its brightness is even."""
    core = compact_core(Blur(Gaussian(1.0)), 6.2)
    image = np.zeros((24, 24))
    draw_body(image, (1000, 200), Sphere(radius), core, (300.0, 0.0), 1e9)
    r = np.hypot(np.arange(24)[:, None] + 700.0, np.arange(24)[None, :] + 200.0) / radius
    expected = 1e9 * 1.5 / (np.pi * radius**2) * np.sqrt(1.0 - r * r)
    np.testing.assert_allclose(image, expected, rtol=2e-6)


def test_limits_bodies_beside_the_frame_and_dark_blocks() -> None:
    core = compact_core(SHARP, 3.2)
    image = np.zeros((16, 16))
    draw_body(image, (0, 0), Sphere(20.0), core, (8.0, -200.0), 1.0)
    assert not image.any()
    crescent = Sphere(60.0, 3.0, 0.0)
    dark = body_blocks(crescent, 8)[0]
    assert block_spectrum(crescent, dark, 2, (30, 30), 1.0) is None


@pytest.mark.parametrize("radius", [0.5, 9.0])
def test_against_the_whole_response_core_and_wing(radius: float) -> None:
    """Full sphere of closed transform times the whole response, on a period of 500 px."""
    core, reach, n, os = compact_core(AIRY, 18.0), 240.0, 500, 2
    y, x, size = 30.2, 29.6, 61
    body = Sphere(radius)
    image = drawn(size, body, core, y, x)
    grid = wing_grid((size, size), (0, 0), 2, reach)
    light = scipy.fft.rfft2(spread_body(grid, body, (y, x), 1.0))
    add_wings(image, (0, 0), grid, convolve(light * wing_kernel(AIRY, core, grid, reach), grid))
    fy, fx = scipy.fft.fftfreq(n * os, 1 / os)[:, None], scipy.fft.rfftfreq(n * os, 1 / os)[None]
    k = np.maximum(2.0 * np.pi * radius * np.hypot(fy, fx), 1e-9)
    spectrum = AIRY.transfer(fy, fx) * 3.0 * spherical_jn(1, k) / k
    spectrum = spectrum * np.exp(-2j * np.pi * (fy * y + fx * x))
    exact = scipy.fft.irfft2(spectrum, s=(n * os, n * os))[: size * os : os, : size * os : os]
    assert np.abs(image - exact * os**2).max() < wing_error(AIRY, core, 2) + 1e-7


def test_wings_of_a_small_sphere_and_of_a_star_are_alike() -> None:
    grid = wing_grid((64, 64), (0, 0), 2, 60.0)
    points = spread_body(grid, Sphere(1e-6), (20.3, 40.9), 7.0)
    alone = spread(grid, np.array([40.9]), np.array([20.3]), np.array([7.0]))
    assert np.abs(points - alone).max() < 1e-5
    assert points.sum() == pytest.approx(7.0, rel=1e-12)


def test_spectrum_of_a_picture_and_of_the_sphere_it_shows() -> None:
    """A picture in fine cells converges to the body itself."""
    body, core = Sphere(4.0, 1.3, 0.8), compact_core(SHARP, 3.2)
    y, x, share = body.points(40.0)
    h = 1.0 / 16.0
    table = np.histogram2d(y, x, bins=np.arange(-66, 67) * h, weights=share)[0]
    off = drawn(30, picture(table, h), core, 14.2, 15.1) - drawn(30, body, core, 14.2, 15.1)
    assert np.abs(off).max() < 3e-5


def test_against_the_points_one_by_one() -> None:
    """A block's transform at the core's frequencies is what its points give one by one."""
    core, body, period = compact_core(AIRY, 18.0), Sphere(2.0, 2.0, 1.0), (20, 16)
    block = body_blocks(body, 128)[0]
    spectrum = block_spectrum(body, block, core.oversampling, period, 1.0)
    fy, fx = frequencies(core, *period)
    y, x, share = body.points(3.0)
    turn = fy[:, None, None] * (y - block.middle[0]) + fx[:, None] * (x - block.middle[1])
    exact = (share * np.exp(-2j * np.pi * turn)).sum(axis=-1)
    inside = np.hypot(fy[:, None], fx) <= 0.97
    assert spectrum is not None
    assert np.abs(spectrum - exact)[inside].max() < 1e-8


def test_what_the_cells_of_a_picture_are_wrong_by() -> None:
    """The integral of |T| |S - S'|, S' of cells twice as wide; none where light is even in them."""
    rng, f = np.random.default_rng(6), (np.arange(-120, 120) + 0.5) * 0.01
    blur = Blur(Gaussian(0.7))
    size = np.abs(blur.transfer(f[:, None], f[None, :])) * 1e-4
    even = np.kron(rng.uniform(size=(3, 5)), np.ones((2, 2)))
    for table in (even, rng.uniform(size=(7, 10)) ** 3):
        fine = picture(table, 0.8, (1.5, 6.25))
        assert coarser(fine).shares.shape == ((len(table) + 1) // 2, 5)
        transforms = []
        for body in (fine, coarser(fine)):
            y, x, share = body.points(2.0)
            down, along = (np.exp(-2j * np.pi * np.outer(f, v)) for v in (y, x))
            transforms.append((down * share) @ along.T)
        exact = float(np.sum(size * np.abs(transforms[0] - transforms[1])))
        assert cell_error(blur, fine) == pytest.approx(exact, rel=0.02, abs=1e-9)
        assert (exact < 1e-9) == (table is even)
