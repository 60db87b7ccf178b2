"""Drawn stars and streaks against quadrature; the same bits however the frame is cut."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import erf, ndtr

from pipeline.physics.drawing.stamps import draw_stamps
from pipeline.physics.motion.streak import Path, path_through, pieces, transfer
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import (
    Core,
    PixelResponse,
    compact_core,
    core_spectrum,
    frequencies,
    phase_table,
    stamp_at,
    window,
)

Swept = tuple[Core, np.ndarray, tuple[int, int], tuple[int, int]]


def swept(core: Core, path: Path) -> Swept:
    half_y, half_x, period_y, period_x = window(
        core, float(np.abs(path.y_px).max()), float(np.abs(path.x_px).max())
    )
    fy, fx = frequencies(core, period_y, period_x)
    streak = transfer(fy, fx, path.x_px, path.y_px, path.weight)
    spectrum = core_spectrum(core, period_y, period_x) * streak
    return core, spectrum, (half_y, half_x), (period_y, period_x)


def tabulated(core: Core, path: Path, phases: int) -> PixelResponse:
    return phase_table(*swept(core, path), phases)


def draw_path(
    core: Core, path: Path, shape: tuple[int, int], x: float, y: float, phases: int = 32
) -> np.ndarray:
    """A source drawn piece by piece: from tables, or exactly where phases is 0."""
    image = np.zeros(shape)
    tables: dict = {}
    for x0, y0, piece, share in pieces(path):
        if phases:
            if piece not in tables:
                tables[piece] = tabulated(core, piece, phases)
            place = np.array([x + x0]), np.array([y + y0]), np.array([share])
            draw_stamps(image, (0, 0), tables[piece], *place, np.ones(1, bool))
            continue
        row, column, stamp = stamp_at(*swept(core, piece), y + y0, x + x0)
        r0, c0 = max(0, -row), max(0, -column)
        part = stamp[r0 : shape[0] - row, c0 : shape[1] - column]
        image[row + r0 : row + r0 + part.shape[0], column + c0 : column + c0 + part.shape[1]] += (
            share * part
        )
    return image


def time_average(
    at: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    shape: tuple[int, int],
    sigma: float,
    steps: int,
) -> np.ndarray:
    """Mean over the exposure of the pixel-integrated Gaussian at (x, y)(t), t in [0, 1]."""
    t = (np.arange(steps) + 0.5) / steps
    x, y = at(t)
    scale = sigma * np.sqrt(2.0)
    rows, columns = np.arange(shape[0] + 1) - 0.5, np.arange(shape[1] + 1) - 0.5
    across = 0.5 * np.diff(erf((columns - x[:, None]) / scale), axis=1)
    down = 0.5 * np.diff(erf((rows - y[:, None]) / scale), axis=1)
    return down.T @ across / steps


def gaussian_streak(edges: np.ndarray, x: float, length: float, sigma: float) -> np.ndarray:
    """Light between edges of a Gaussian that moves evenly over `length` about x: closed form."""

    def held(z: np.ndarray) -> np.ndarray:  # integral of the normal distribution function
        return z * ndtr(z / sigma) + sigma * np.exp(-0.5 * (z / sigma) ** 2) / np.sqrt(2 * np.pi)

    if length < 1e-3:
        return np.diff(ndtr((edges - x) / sigma))
    return np.diff(held(edges - x + length / 2) - held(edges - x - length / 2)) / length


def motion(kind: str) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    def at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s = t - 0.5
        if kind == "straight":
            return 41.3 * s + 50.2, -13.1 * s + 40.7
        if kind == "curved":
            return 30.0 * np.sin(2.4 * s) + 50.2, 30.0 * (1 - np.cos(2.4 * s)) + 30.1
        if kind == "accelerating":
            return 24.0 * s + 40.0 * s * s + 45.3, 7.0 * s + 40.4
        return 20.0 * np.abs(s) + 44.6, 7.0 * np.abs(s) + 39.9  # comes in and goes back

    return at


@pytest.mark.parametrize("kind", ["straight", "curved", "accelerating", "retraced"])
def test_against_time_average_of_a_gaussian(kind: str) -> None:
    sigma, shape = 0.8, (81, 101)
    core = compact_core(Blur(Gaussian(sigma)), 6.2 * sigma)
    at = motion(kind)
    x, y = at(np.linspace(0, 1, 513))
    path = path_through(x - 50.0, y - 40.0, np.full(512, 1 / 512), 1e-4)
    exact = time_average(at, shape, sigma, 6000)
    for phases in (32, 0):
        image = draw_path(core, path, shape, 50.0, 40.0, phases)
        assert np.abs(image - exact).max() < 2e-4 * exact.max()
        assert image.sum() == pytest.approx(1.0, abs=1e-6)
        t = (np.arange(6000) + 0.5) / 6000
        columns, rows = np.arange(shape[1]), np.arange(shape[0])
        assert image.sum(axis=0) @ columns == pytest.approx(at(t)[0].mean(), abs=1e-3)
        assert image.sum(axis=1) @ rows == pytest.approx(at(t)[1].mean(), abs=1e-3)


@pytest.mark.parametrize("length", [0.0, 1e-9, 0.1, 60.0, 300.0, 3000.0])
def test_limits_ends_and_light_of_every_length(length: float) -> None:
    """A streak of length L is L long: no sample too many, none too few, at each end."""
    sigma = 0.7
    core = compact_core(Blur(Gaussian(sigma)), 6.2 * sigma)
    path = Path(np.array([-0.5, 0.5]) * length, np.zeros(2), np.ones(1))
    columns = int(length) + 60
    x = (columns - 1) / 2 + 0.3
    image = draw_path(core, path, (33, columns), x, 16.2)
    assert image.sum() == pytest.approx(1.0, abs=1e-6)
    down = gaussian_streak(np.arange(34) - 0.5, 16.2, 0.0, sigma)
    exact = down[:, None] * gaussian_streak(np.arange(columns + 1) - 0.5, x, length, sigma)
    assert np.abs(image - exact).max() < 2e-4 * exact.max()
    along, at = image.sum(axis=0), np.arange(columns)
    mean = along @ at
    assert mean == pytest.approx(x, abs=1e-3)
    spread = along @ (at - mean) ** 2  # uniform motion: L^2 / 12, + sigma^2 + pixel 1/12
    assert spread == pytest.approx(length**2 / 12 + sigma**2 + 1 / 12, rel=1e-5, abs=1e-4)


def test_unequal_light_moves_the_centroid() -> None:
    """A target that fades during the exposure: centroid at the light-weighted mean."""
    core = compact_core(Blur(Gaussian(1.0)), 6.2)
    weight = np.linspace(2.0, 0.0, 65)[:-1] + 1 / 64
    weight /= weight.sum()
    x = np.linspace(-20, 20, 65)
    image = draw_path(core, path_through(x, 0.5 * x, weight, 1e-3), (61, 81), 40.0, 30.0)
    expected = weight @ (0.5 * (x[1:] + x[:-1]))
    assert image.sum(axis=0) @ np.arange(81) == pytest.approx(40.0 + expected, abs=1e-3)
    assert image.sum(axis=1) @ np.arange(61) == pytest.approx(30.0 + 0.5 * expected, abs=1e-3)


@pytest.mark.parametrize("cubic", [False, True])
@pytest.mark.parametrize("sweep", [0.0, 37.0])
def test_same_bits_when_the_frame_is_cut(cubic: bool, sweep: float) -> None:
    core = compact_core(Blur(Airy(1.0, 0.3)), 12.0)
    path = Path(np.array([-0.5, 0.5]) * sweep, np.array([-0.3, 0.3]) * sweep, np.ones(1))
    response = tabulated(core, path, 16)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-40, 168, 300), rng.uniform(-40, 136, 300)
    light, how = rng.uniform(1, 1e5, 300), np.full(300, cubic)
    whole = np.zeros((96, 128))
    draw_stamps(whole, (0, 0), response, x, y, light, how)
    for rows, columns in ((48, 64), (96, 32), (7, 128), (1, 1)):
        joined = np.zeros_like(whole)
        for y0 in range(0, 96, rows):
            for x0 in range(0, 128, columns) if rows > 1 else (0, 63, 127):
                part = np.zeros((min(rows, 96 - y0), min(columns, 128 - x0)))
                draw_stamps(part, (y0, x0), response, x, y, light, how)
                joined[y0 : y0 + rows, x0 : x0 + columns] = part
        if rows > 1:
            assert (joined == whole).all()
        else:
            assert (joined[:, [0, 63, 127]] == whole[:, [0, 63, 127]]).all()


def test_source_on_a_corner_of_four_images_keeps_its_light() -> None:
    core = compact_core(Blur(Airy(0.5, 0.3)), 10.0)
    response = tabulated(core, Path(np.zeros(2), np.zeros(2), np.ones(1)), 32)
    star = (np.array([49.5]), np.array([49.5]), np.array([1e6]), np.ones(1, bool))
    total = 0.0
    for origin in ((0, 0), (0, 50), (50, 0), (50, 50)):
        part = np.zeros((50, 50))
        draw_stamps(part, origin, response, *star)
        assert part.sum() > 1e5
        total += part.sum()
    assert total == pytest.approx(1e6 * core.light, rel=1e-6)


def test_far_and_edge_positions_are_safe() -> None:
    core = compact_core(Blur(Gaussian(1.0)), 6.2)
    response = tabulated(core, Path(np.zeros(2), np.zeros(2), np.ones(1)), 32)
    image = np.zeros((20, 20))
    x = np.array([-1e6, 1e6, 5.0, 5.0, 1e12, np.nextafter(5.0, 0), -7.01])
    y = np.array([5.0, 5.0, -1e6, 1e6, -1e12, np.nextafter(9.0, 0), 5.0])
    draw_stamps(image, (0, 0), response, x, y, np.ones(7), np.ones(7, bool))
    assert image.sum() == pytest.approx(1.0, abs=2e-4)
    draw_stamps(image, (0, 0), response, x[:0], y[:0], x[:0], np.ones(0, bool))


def test_interpolation_across_a_pixel_border_is_continuous() -> None:
    core = compact_core(Blur(Airy(1.0)), 12.0)
    response = tabulated(core, Path(np.zeros(2), np.zeros(2), np.ones(1)), 32)
    for cubic in (False, True):
        images = []
        for x in (np.nextafter(20.0, 0), 20.0):
            image = np.zeros((41, 41))
            place = np.array([x]), np.array([20.0]), np.ones(1), np.array([cubic])
            draw_stamps(image, (0, 0), response, *place)
            images.append(image)
        assert np.abs(images[0] - images[1]).max() < 1e-8
