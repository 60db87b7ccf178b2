"""Cores and wings together against quadrature of the analytic Airy pattern; stated bounds."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft
from scipy.special import j1

from pipeline.physics.drawing.wings import (
    _core_columns,
    _smoothed,
    add_wings,
    convolve,
    grid_frequencies,
    spread,
    swept_apart,
    wing_error,
    wing_grid,
    wing_kernel,
    wing_slope,
)
from pipeline.physics.motion.streak import POINT, Path, transfer
from pipeline.physics.psf.pupil import Airy, Blur
from pipeline.physics.psf.response import compact_core, core_spectrum, stamp_at, window
from tests.slow import slow

REACH_PX = 700.0


def airy_intensity(r_px: np.ndarray, q_px: float, eps: float) -> np.ndarray:
    """Obscured Airy pattern per unit total flux, per px^2."""
    x = np.pi * np.maximum(r_px, 1e-9) / q_px
    inner = eps * 2.0 * j1(eps * x) / x if eps else 0.0
    return np.pi / (4.0 * q_px**2 * (1.0 - eps**2)) * (2.0 * j1(x) / x - inner) ** 2


def pixel_light(dx: float, dy: float, q: float, eps: float, side: float = 1.0) -> float:
    """Light in a square pixel whose centre is (dx, dy) from the source, by Gauss-Legendre."""
    parts = int(max(4, np.ceil(3.0 / q)))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    at = side * (((np.arange(parts)[:, None] + 0.5 + nodes / 2) / parts).ravel() - 0.5)
    w = side * np.tile(weights / (2 * parts), parts)
    return float(w @ airy_intensity(np.hypot(dx + at, dy + at[:, None]), q, eps) @ w)


def radius_and_spacing(q: float) -> tuple[float, int]:
    """The first core class of the plan (pipeline/plan/response/responses.py)."""
    radius = 12.0 * max(q, min(1.0, q) ** (1.0 / 3.0), 0.5)
    return radius, int(2 ** max(1, np.floor(np.log2(radius / 5.0))))


@pytest.mark.parametrize(
    ("q", "radius_px", "n", "spacing"),
    [(2.0, 40.0, 500, 2), (0.7, 30.0, 600, 4), (2.0, 20.0, 801, 1)],
)
@pytest.mark.parametrize("most", [1, 2, 8])
def test_core_transfer_is_the_sum_of_its_definition(q, radius_px, n, spacing, most):
    core = compact_core(Blur(Airy(q), 0.1), radius_px)
    fy, fx = scipy.fft.fftfreq(n, spacing), scipy.fft.rfftfreq(n, spacing)
    samples, at, per_px = _smoothed(core, most)
    left, right = (np.exp(-2j * np.pi * np.outer(f, at)) for f in (fy, fx))
    want = left @ samples @ right.T / per_px**2
    parts = list(_core_columns(core, fy, fx, most))
    assert np.concatenate([np.arange(fx.size)[part] for part, _ in parts]).size == fx.size
    found = np.concatenate([columns for _, columns in parts], axis=1)
    np.testing.assert_allclose(found, want, atol=1e-14)


class Drawer:
    """Draws isolated sources of unit light: core by its exact stamp, wing by the grid."""

    def __init__(self, blur: Blur, radius: float, spacing: int, size: int, reach: float) -> None:
        self.size, self.core = size, compact_core(blur, radius)
        half_y, half_x, *period = window(self.core, 0.0, 0.0)
        spectrum = core_spectrum(self.core, *period)
        self.swept = (self.core, spectrum, (half_y, half_x), tuple(period))
        self.grid = wing_grid((size, size), (0, 0), spacing, reach)
        self.kernel = wing_kernel(blur, self.core, self.grid, reach)

    def wing(self, x: float, y: float) -> np.ndarray:
        image = np.zeros((self.size, self.size))
        light = spread(self.grid, np.array([x]), np.array([y]), np.ones(1))
        field = convolve(scipy.fft.rfft2(light) * self.kernel, self.grid)
        add_wings(image, (0, 0), self.grid, field)
        return image

    @property
    def light(self) -> float:
        """Light that core and kernel together say they draw of one unit."""
        return self.core.light + float(self.kernel[0, 0].real) * self.grid.spacing_px**2

    def __call__(self, x: float, y: float) -> np.ndarray:
        image = self.wing(x, y)
        row, column, stamp = stamp_at(*self.swept, y, x)
        image[row : row + stamp.shape[0], column : column + stamp.shape[1]] += stamp
        return image


@pytest.mark.parametrize("eps", [0.0, 0.3])
@pytest.mark.parametrize("q", [0.12, 0.5, 1.0, 2.0, 4.0])
def test_against_quadrature_of_the_airy_pattern(q: float, eps: float) -> None:
    """Measured: within 1.2e-4 of the peak everywhere (at the ring of the core's edge), 200 px."""
    radius, spacing = radius_and_spacing(q)
    draw = Drawer(Blur(Airy(q, eps)), radius, spacing, 441, REACH_PX)
    rng = np.random.default_rng(12)
    peak = pixel_light(0.0, 0.0, q, eps)
    for _ in range(3):
        x, y = 220.0 + rng.uniform(-0.5, 0.5, 2)
        image = draw(x, y)
        for r in np.concatenate([[0.0, 1.0, 1.5], 10 ** rng.uniform(0, np.log10(200.0), 24)]):
            angle = rng.uniform(0, 2 * np.pi)
            column, row = round(x + r * np.cos(angle)), round(y + r * np.sin(angle))
            exact = pixel_light(column - x, row - y, q, eps)
            off = abs(image[row, column] - exact)
            assert off < (1.2e-4 if r < 2 * radius else 5e-5) * peak, (r, off / peak)


@pytest.mark.parametrize("fill", [0.5, 1.0])
def test_against_quadrature_with_fill_factor(fill: float) -> None:
    draw = Drawer(Blur(Airy(1.0, 0.3), fill_factor=fill), 12.0, 2, 121, 300.0)
    image = draw(60.2, 59.7)
    peak = pixel_light(0.0, 0.0, 1.0, 0.3)
    for column, row in ((60, 60), (61, 59), (60, 64), (70, 60), (95, 40)):
        exact = pixel_light(column - 60.2, row - 59.7, 1.0, 0.3, np.sqrt(fill))
        assert abs(image[row, column] - exact) < 1e-4 * peak


@pytest.mark.parametrize(("q", "eps"), [(0.12, 0.3), (0.5, 0.0), (1.0, 0.3), (2.0, 0.3)])
def test_light_is_conserved_at_every_phase(q: float, eps: float) -> None:
    """core.light + wing sum is what the kernel says, at each sub-pixel and sub-grid phase."""
    radius, spacing = radius_and_spacing(q)
    reach = 160.0
    draw = Drawer(Blur(Airy(q, eps)), radius, spacing, 401, reach)
    stated = draw.light
    assert stated == pytest.approx(1.0 - Airy(q, eps).light_beyond(0.95 * reach), abs=1e-3)
    assert stated <= 1.0
    sums = []
    for x, y in np.random.default_rng(3).uniform(196, 204, (6, 2)):
        sums.append(draw(x, y).sum())
        assert sums[-1] == pytest.approx(stated, abs=1e-6)
    assert np.ptp(sums) < 1e-6


def test_light_beyond_the_reach_falls_with_the_reach() -> None:
    blur = Blur(Airy(1.0, 0.3))
    lost = []
    for reach in (60.0, 120.0, 240.0, 480.0):
        draw = Drawer(blur, 12.0, 2, 64, reach)
        lost.append(1.0 - draw.light)
        assert 0.4 * blur.light_beyond(reach) < lost[-1] < 1.15 * blur.light_beyond(0.9 * reach)
    assert (np.array(lost[:-1]) > 1.8 * np.array(lost[1:])).all()


@pytest.mark.parametrize(
    ("q", "eps", "doubling"),
    [
        (0.12, 0.3, 1), (0.5, 0.3, 1), (0.5, 0.3, 2), (1.0, 0.0, 1), (1.0, 0.0, 2), (1.0, 0.3, 1),
        (1.0, 0.3, 2), (2.0, 0.3, 1), (2.0, 0.3, 2),
    ],
)  # fmt: skip
def test_stated_wing_error_holds(q: float, eps: float, doubling: int) -> None:
    """At random places the drawn wing differs from the exact one by no more than is stated."""
    blur = Blur(Airy(q, eps))
    radius, spacing = radius_and_spacing(q)
    radius *= doubling
    size = int(4 * radius) + 41
    draw = Drawer(blur, radius, spacing, size, 6.0 * radius)
    stated = wing_error(blur, draw.core, spacing)
    rng = np.random.default_rng(4)
    worst = 0.0
    for _ in range(4):
        x, y = size / 2 + rng.uniform(0, spacing, 2)
        image = draw(x, y)
        for _ in range(40):
            r, angle = rng.uniform(0, 2 * radius), rng.uniform(0, 2 * np.pi)
            column, row = round(x + r * np.cos(angle)), round(y + r * np.sin(angle))
            exact = pixel_light(column - x, row - y, q, eps)
            worst = max(worst, abs(image[row, column] - exact))
    # Past a tenth of the reach the cut-off itself is part of the wing; 1e-9 is the band's floor.
    assert worst <= 1.02 * stated + 1e-7 * pixel_light(0, 0, q, eps)


@pytest.mark.parametrize(
    ("q", "doublings"),
    [(0.5, 1), (1.0, 2), *(slow(*p) for p in ((2.0, 2), (4.0, 1)))],
)
def test_wing_error_falls_fast_with_the_radius(q: float, doublings: int) -> None:
    """The plan counts on a factor of 4 for each doubling of the radius."""
    blur = Blur(Airy(q, 0.3))
    radius, spacing = radius_and_spacing(q)
    errors = [
        wing_error(blur, compact_core(blur, radius * 2**k), spacing) for k in range(doublings + 1)
    ]
    assert (np.array(errors[:-1]) > 4.0 * np.array(errors[1:])).all()


def test_same_bits_when_the_block_is_read_in_parts() -> None:
    draw = Drawer(Blur(Airy(1.0, 0.3)), 12.0, 2, 96, 120.0)
    x, y, electrons = np.array([[31.2, -20.0], [40.7, 110.3], [1e5, 7.0]])
    light = spread(draw.grid, x, y, electrons)
    field = convolve(scipy.fft.rfft2(light) * draw.kernel, draw.grid)
    whole, joined = np.zeros((96, 96)), np.zeros((96, 96))
    add_wings(whole, (0, 0), draw.grid, field)
    for y0, y1 in ((0, 32), (32, 33), (33, 96)):
        for x0, x1 in ((0, 50), (50, 96)):
            part = np.zeros((y1 - y0, x1 - x0))
            add_wings(part, (y0, x0), draw.grid, field)
            joined[y0:y1, x0:x1] = part
    assert (joined == whole).all()


def test_sources_off_the_grid_are_left_out_and_none_wraps() -> None:
    draw = Drawer(Blur(Airy(1.0)), 12.0, 2, 64, 100.0)
    far = spread(draw.grid, np.array([-1e4, 1e5, 32.0]), np.array([32.0, 32.0, 1e9]), np.ones(3))
    assert far.sum() == 0.0
    beyond = draw.wing(64 + 98.0, 32.0)
    assert np.abs(beyond[:, :-4]).max() < 1e-9 + 2.5 * pixel_light(100.0, 0.0, 1.0, 0.0)


def test_streaked_wing_is_the_time_average_of_still_ones() -> None:
    blur = Blur(Airy(1.0, 0.3))
    draw = Drawer(blur, 12.0, 2, 160, 200.0)
    path = Path(np.array([-20.0, 20.0]), np.array([-9.0, 9.0]), np.ones(1))
    sweep = transfer(*grid_frequencies(draw.grid), path.x_px, path.y_px, path.weight)
    light = spread(draw.grid, np.array([80.3]), np.array([79.1]), np.ones(1))
    image = np.zeros((160, 160))
    field = convolve(scipy.fft.rfft2(light) * draw.kernel * sweep, draw.grid)
    add_wings(image, (0, 0), draw.grid, field)
    fine = Drawer(blur, 12.0, 1, 160, 200.0)
    t = (np.arange(160) + 0.5) / 160 - 0.5
    light = spread(fine.grid, 80.3 + 40 * t, 79.1 + 18 * t, np.full(160, 1 / 160))
    average = np.zeros((160, 160))
    field = convolve(scipy.fft.rfft2(light) * fine.kernel, fine.grid)
    add_wings(average, (0, 0), fine.grid, field)
    stated = wing_error(blur, draw.core, 2, path)
    assert stated < 0.3 * average.max()
    assert np.abs(image - average).max() < stated + 1e-3 * average.max()


@pytest.mark.parametrize("length", [1, 6, 30])
def test_a_wing_swept_as_its_neighbours_is_off_by_what_is_stated(length: int) -> None:
    """One star at rest, the other on a straight path: against a mean of shifted responses."""
    blur, radius, n, os = Blur(Airy(1.6, 0.3)), 16.0, 160, 8
    path = Path(np.array([-0.5, 0.5]) * length, np.zeros(2), np.ones(1))
    core = compact_core(blur, radius)
    stated = swept_apart(blur, core, POINT, path)
    f, half = scipy.fft.fftfreq(n * os, 1.0 / os), scipy.fft.rfftfreq(n * os, 1.0 / os)
    whole = scipy.fft.irfft2(blur.transfer(f[:, None], half[None, :]), s=(n * os, n * os)) * os**2
    draw = Drawer(blur, radius, 2, n, 6.0 * radius)

    def wing(samples: int) -> np.ndarray:
        """Of a star so many eighths of a pixel from the middle."""
        middle = n * os // 2
        image = np.roll(whole, (middle, middle + samples), axis=(0, 1))[::os, ::os].copy()
        iy, ix, stamp = stamp_at(*draw.swept, n / 2.0, n / 2.0 + samples / os)
        image[iy : iy + stamp.shape[0], ix : ix + stamp.shape[1]] -= stamp
        return image

    ends = length * os // 2
    weight = np.ones(2 * ends + 1)
    weight[[0, -1]] = 0.5
    shifted = (w * wing(k) for k, w in zip(range(-ends, ends + 1), weight, strict=True))
    found = float(np.abs(sum(shifted) / weight.sum() - wing(0)).max())
    assert found <= 1.05 * stated
    assert stated <= 1.5 * found  # between the pixels' middles it may be more
    assert stated <= wing_slope(blur, core) * 0.25 * length
