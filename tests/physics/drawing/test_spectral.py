"""The spectral engine against quadrature, exact stamps and its own stated bounds."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import erf, ndtr

from pipeline.errors import BadInput
from pipeline.physics.drawing.spectral import Sources, draw_points, draw_spectral, transfer_table
from pipeline.physics.drawing.spectral_band import peak_light
from pipeline.physics.drawing.spectral_plan import (
    CROWD_PX,
    SpectralPlan,
    brightest_for,
    plan_spectral,
)
from pipeline.physics.drawing.spectral_spread import Kernel, spread_onto
from pipeline.physics.drawing.stamps import draw_stamps
from pipeline.physics.motion.streak import POINT, Path, path_through, transfer
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import (
    Core,
    compact_core,
    core_spectrum,
    frequencies,
    phase_table,
    stamp_at,
    window,
)

HOLDS = 1e-8  # light that a Gaussian core may leave out


def gaussian_core(sigma: float, fill: float = 1.0) -> Core:
    return compact_core(Blur(Gaussian(sigma), fill_factor=fill), 6.1 * sigma)


CORES = {
    "gaussian": gaussian_core(0.8),
    "airy": compact_core(Blur(Airy(1.0, 0.3)), 12.0),
}


def line(length: float, angle: float = 0.6435) -> Path:
    x, y = 0.5 * length * np.cos(angle), 0.5 * length * np.sin(angle)
    return Path(np.array([-x, x]), np.array([-y, y]), np.ones(1))


def one(x: float, y: float, light: float = 1.0, path: Path = POINT) -> list[Sources]:
    return [Sources(np.array([x]), np.array([y]), np.array([light]), path)]


def draw(
    plan: SpectralPlan, core: Core, sources: list[Sources], origin: tuple[int, int] = (0, 0)
) -> np.ndarray:
    return draw_spectral(plan, transfer_table(core, plan), sources, origin).astype(float)


def gaussian_pixels(
    shape: tuple[int, int], x: float, y: float, sigma: float, path: Path, side: float = 1.0
) -> np.ndarray:
    """A moving Gaussian in square pixels: Gauss-Legendre in time, erf in space."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    out = np.zeros(shape)
    for k in range(path.segments):
        ends = path.x_px[k : k + 2], path.y_px[k : k + 2]
        parts = int(np.ceil(np.hypot(*(np.diff(e)[0] for e in ends)) / (2.0 * sigma))) + 1
        t = ((np.arange(parts)[:, None] + 0.5 + 0.5 * nodes) / parts).ravel()
        w = np.tile(0.5 * weights / parts, parts) * path.weight[k]
        at_x, at_y = (e[0] + t * (e[1] - e[0]) for e in ends)
        across, down = (
            0.5
            * (
                erf((np.arange(n) + 0.5 * side - a[:, None]) / (sigma * np.sqrt(2)))
                - erf((np.arange(n) - 0.5 * side - a[:, None]) / (sigma * np.sqrt(2)))
            )
            for n, a in ((shape[1], x + at_x), (shape[0], y + at_y))
        )
        out += (w[:, None] * down).T @ across
    return out


def exact_stamp(core: Core, path: Path, shape: tuple[int, int], x: float, y: float) -> np.ndarray:
    """A source of unit light in an image, from the core's samples by the shift theorem."""
    half_y, half_x, *period = window(core, np.abs(path.y_px).max(), np.abs(path.x_px).max())
    swept = transfer(*frequencies(core, *period), path.x_px, path.y_px, path.weight)
    spectrum = core_spectrum(core, *period) * swept
    row, column, stamp = stamp_at(core, spectrum, (half_y, half_x), tuple(period), y, x)
    image = np.zeros(shape)
    r0, r1 = max(0, -row), min(stamp.shape[0], shape[0] - row)
    c0, c1 = max(0, -column), min(stamp.shape[1], shape[1] - column)
    if r1 > r0 and c1 > c0:
        image[row + r0 : row + r1, column + c0 : column + c1] = stamp[r0:r1, c0:c1]
    return image


@pytest.mark.parametrize(
    ("sigma", "fill", "length"),
    [
        (0.3, 1.0, 0.0), (0.3, 1.0, 60.0), (0.8, 0.5, 0.0), (0.8, 0.5, 1e-9), (0.8, 1.0, 0.1),
        (0.8, 0.5, 60.0), (2.5, 1.0, 7.0), (10.0, 1.0, 0.0), (10.0, 1.0, 90.0),
    ],
)  # fmt: skip
def test_against_quadrature_of_a_moving_gaussian(sigma: float, fill: float, length: float) -> None:
    """Isolated sources at random phases: the stated error holds, whatever was asked."""
    core, path = gaussian_core(sigma, fill), line(length)
    n = int(6 * sigma + length) + 24
    peak = peak_light(core, path)
    rng = np.random.default_rng(1)
    for asked in (1e-3, 1e-5, 1e-7):
        plan = plan_spectral((n, n), core, path, asked * peak)
        assert plan.error <= asked * peak
        table = transfer_table(core, plan)
        for _ in range(3):
            x, y = n / 2 + rng.uniform(-1, 1, 2)
            image = draw_spectral(plan, table, one(x, y, 1.0, path), (0, 0))
            exact = gaussian_pixels((n, n), x, y, sigma, path, np.sqrt(fill))
            assert exact.max() < 1.02 * peak
            assert np.abs(image - exact).max() <= plan.error + HOLDS * peak


@pytest.mark.parametrize("asked", [1e-3, 1e-6])
@pytest.mark.parametrize(("q", "radius"), [(0.5, 10.0), (1.0, 12.0), (2.0, 24.0)])
def test_stated_error_holds_for_airy_cores(q: float, radius: float, asked: float) -> None:
    core, path = compact_core(Blur(Airy(q, 0.3)), radius), line(9.0, 2.0)
    rng = np.random.default_rng(2)
    for streak in (POINT, path):
        plan = plan_spectral((48, 64), core, streak, asked * peak_light(core, streak))
        table = transfer_table(core, plan)
        for _ in range(8):
            x, y = rng.uniform(-8, 72), rng.uniform(-8, 56)
            image = draw_spectral(plan, table, one(x, y, 1.0, streak), (0, 0))
            exact = exact_stamp(core, streak, (48, 64), x, y)
            assert np.abs(image - exact).max() <= plan.error


def test_same_as_a_sum_over_sources_at_edges_corners_and_outside() -> None:
    core, path = compact_core(Blur(Airy(1.0, 0.3)), 12.0), line(41.0)
    shape, origin = (70, 90), (-1000, 3000)
    plan = plan_spectral(shape, core, path, 1e-5 * peak_light(core, path))
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-80, 170, 60), rng.uniform(-70, 140, 60)
    x[:8], y[:8] = [0, 89, 0, 89, -0.5, 89.5, 45, 45], [0, 69, 69, 0, 20, 20, -0.5, 69.5]
    light = rng.uniform(0.5, 2.0, 60)
    exact = sum(
        e * exact_stamp(core, path, shape, a, b) for a, b, e in zip(x, y, light, strict=True)
    )
    many = [Sources(x + origin[1], y + origin[0], light, path)]
    assert np.abs(draw(plan, core, many, origin) - exact).max() <= 4 * plan.error


@pytest.mark.parametrize("beside", ["left", "right", "above", "below"])
def test_nothing_comes_round_from_outside(beside: str) -> None:
    """A source just out of reach leaves nothing, one within reach only what is its own."""
    core, path = gaussian_core(1.0), line(300.0, 0.3)
    plan = plan_spectral((128, 128), core, path, 1e-5 * peak_light(core, path))
    half = {"left": 143.3, "right": 143.3, "above": 44.4, "below": 44.4}[beside]
    for off in (0.2, 0.9, 1.0, 1.1):
        d = off * half + 6.0
        x, y = {
            "left": (-d, 64.0), "right": (127 + d, 64.0), "above": (64.0, -d),
            "below": (64.0, 127 + d),
        }[beside]  # fmt: skip
        exact = gaussian_pixels((128, 128), x, y, 1.0, path)
        image = draw(plan, core, one(x, y, 1.0, path))
        assert np.abs(image - exact).max() <= plan.error


def test_limits_long_streaks_are_cut_and_stay_exact() -> None:
    """Closed form across a horizontal streak; its end is where it should be."""
    length, most_bytes = 3000.0, 6e6
    core, path = gaussian_core(1.0), line(length, 0.0)
    peak = peak_light(core, path)
    plan = plan_spectral((64, 256), core, path, 1e-4 * peak, most_bytes=most_bytes)
    assert plan.longest_px <= 1024.0
    assert plan.bytes <= most_bytes
    x, y = 128.0 - length / 2 + 0.3, 31.7  # its end lies in the block
    edges = np.arange(257) - 0.5 - x

    def held(z: np.ndarray) -> np.ndarray:
        return z * ndtr(z) + np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)

    along = np.diff(held(edges + length / 2) - held(edges - length / 2)) / length
    across = np.diff(ndtr(np.arange(65) - 0.5 - y))
    image = draw(plan, core, one(x, y, 1.0, path))
    assert np.abs(image - across[:, None] * along).max() <= plan.error
    assert peak == pytest.approx(erf(0.5 / np.sqrt(2)) / length, rel=1e-3)


def test_curved_and_fading_path() -> None:
    """Many segments of unequal light, with the centroid off the middle: against time quadrature."""
    t = np.linspace(0, 1, 65)
    light = np.linspace(2.0, 0.5, 64)
    path = path_through(40 * np.sin(2 * t) - 9, 30 * t * t, light / light.sum(), 1e-3)
    assert path.segments > 8
    core = gaussian_core(0.8)
    plan = plan_spectral((80, 90), core, path, 1e-5 * peak_light(core, path))
    image = draw(plan, core, one(30.2, 20.6, 1.0, path))
    exact = gaussian_pixels((80, 90), 30.2, 20.6, 0.8, path)
    assert np.abs(image - exact).max() <= plan.error
    assert image.sum() == pytest.approx(1.0, abs=2e-6)


def test_streaks_of_several_groups_add_up() -> None:
    core = gaussian_core(0.8)
    paths = [POINT, line(20.0), line(20.0, 2.0)]
    plan = plan_spectral((64, 64), core, paths[1], 1e-6)
    groups = [one(20.0 + 9 * k, 30.3, 2.0, p)[0] for k, p in enumerate(paths)]
    apart = sum(draw(plan, core, [g]) for g in groups)
    assert np.abs(draw(plan, core, groups) - apart).max() <= 6e-7


def test_points_that_come_in_parts_are_those_that_come_at_once() -> None:
    core, rng = gaussian_core(0.8), np.random.default_rng(4)
    x, y, light = *rng.uniform(-9.0, 73.0, (2, 300)), rng.uniform(1.0, 9.0, 300)
    plan = plan_spectral((64, 48), core, POINT, 1e-6, single=False)
    table, origin = transfer_table(core, plan), (3, -5)
    whole = draw_spectral(plan, table, [Sources(x, y, light, POINT)], origin)
    parts = ((x[k : k + 70], y[k : k + 70], light[k : k + 70]) for k in range(0, 300, 70))
    assert np.abs(draw_points(plan, table, parts, origin) - whole).max() <= 1e-12 * whole.max()
    assert not draw_points(plan, table, [], origin).any()


def test_pixels_alias_what_they_cannot_hold() -> None:
    """Undersampled light: frequencies beyond the pixels' own are folded, not cut."""
    core = gaussian_core(0.25)
    plan = plan_spectral((24, 24), core, POINT, 1e-5)
    assert plan.limit > 1.5
    centred, between = draw(plan, core, one(12.0, 12.0)), draw(plan, core, one(12.5, 12.5))
    assert centred.max() == pytest.approx(erf(0.5 / (0.25 * np.sqrt(2))) ** 2, abs=2e-5)
    a_pixel = 0.5 * erf(1.0 / (0.25 * np.sqrt(2)))
    assert between.max() == pytest.approx(a_pixel**2, abs=2e-5)


@pytest.mark.parametrize("sigma", [0.05, 30.0])
def test_limits_of_sharp_and_broad_responses(sigma: float) -> None:
    """Refused where no grid holds it; else right."""
    core = gaussian_core(sigma) if sigma > 1 else compact_core(Blur(Gaussian(sigma)), 2.0)
    with pytest.raises(BadInput, match="stamps"):
        plan_spectral((2048, 2048), gaussian_core(0.05), POINT, 1e-3)
    plan = plan_spectral((32, 40), core, line(5.0), 1e-3 * peak_light(core, line(5.0)))
    image = draw(plan, core, one(15.8, 17.3, 1.0, line(5.0)))
    exact = gaussian_pixels((32, 40), 15.8, 17.3, sigma, line(5.0))
    assert np.abs(image - exact).max() <= plan.error + HOLDS * exact.max()


@pytest.mark.parametrize("sigma", [0.8, 14.5, 30.0])
@pytest.mark.parametrize("part", [0.01, 0.5, 1e6])
def test_any_error_may_be_asked_for(sigma: float, part: float) -> None:
    """Also one above the light of a source's brightest pixel: a coarse grid, whose bound holds."""
    core = gaussian_core(sigma)
    plan = plan_spectral((82, 52), core, POINT, part * peak_light(core, POINT))
    image = draw(plan, core, one(25.3, 40.2))
    exact = gaussian_pixels((82, 52), 25.3, 40.2, sigma, POINT)
    assert np.abs(image - exact).max() <= plan.error + HOLDS * exact.max()
    assert plan.error <= part * exact.max()


def test_light_is_conserved() -> None:
    rng = np.random.default_rng(4)
    for core, path in (
        (gaussian_core(0.7), POINT),
        (gaussian_core(3.0), line(25.0)),
        (compact_core(Blur(Airy(1.0, 0.3)), 12.0), line(25.0)),
    ):
        plan = plan_spectral((160, 160), core, path, 1e-4 * peak_light(core, path))
        table = transfer_table(core, plan)
        for x, y in rng.uniform(79, 81, (5, 2)):
            total = draw_spectral(plan, table, one(x, y, 1.0, path), (0, 0)).sum(dtype=float)
            assert total == pytest.approx(core.light, abs=1e-6 + HOLDS)


def test_no_source_and_impossible_ones() -> None:
    core = gaussian_core(1.0)
    plan = plan_spectral((20, 30), core, POINT, 1e-4)
    table = transfer_table(core, plan)
    for groups in ([], [Sources(np.empty(0), np.empty(0), np.empty(0), POINT)], one(1e12, -1e12)):
        image = draw_spectral(plan, table, groups, (0, 0))
        assert image.shape == (20, 30)
        assert not image.any()
    for bad in (np.nan, np.inf, -np.inf):
        with pytest.raises(BadInput, match="light_e"):
            draw_spectral(plan, table, one(5.0, 5.0, bad), (0, 0))
        with pytest.raises(BadInput, match="x_px"):
            draw_spectral(plan, table, one(bad, 5.0), (0, 0))
    for error in (0.0, -1.0, np.nan):
        with pytest.raises(BadInput, match="positive"):
            plan_spectral((20, 30), core, POINT, error)


@pytest.mark.parametrize("light", [1e-12, 1e-3, 1.0, 1e9, 1e15])
def test_limits_of_light(light: float) -> None:
    core = gaussian_core(1.0)
    plan = plan_spectral((40, 40), core, POINT, 1e-5)
    unit = draw(plan, core, one(20.3, 19.6))
    image = draw(plan, core, one(20.3, 19.6, light))
    assert np.abs(image / light - unit).max() < 1e-7


def test_bright_sources_are_told_apart() -> None:
    """Beside the brightest source that the plan may draw, a faint one is right to the budget."""
    core, budget_e = gaussian_core(0.8), 0.1
    for asked in (1e-4, 1e-6, 3e-8):
        plan = plan_spectral((256, 256), core, POINT, asked)
        bright = brightest_for(plan, budget_e)
        assert bright >= budget_e / asked
        both = one(60.3, 61.4, bright) + one(64.9, 63.2)
        exact = bright * gaussian_pixels((256, 256), 60.3, 61.4, 0.8, POINT)
        exact += gaussian_pixels((256, 256), 64.9, 63.2, 0.8, POINT)
        off = np.abs(draw(plan, core, both) - exact)
        assert off.max() <= budget_e * (1.0 + HOLDS / asked)
        assert off[120:].max() <= 0.1 * budget_e  # and it dies out with the distance


def test_a_faint_neighbour_of_a_very_bright_source_is_right() -> None:
    """1e9 and 1 electrons, 5 px apart: `brightest_for` sends the bright one to the stamps."""
    core, budget_e = compact_core(Blur(Gaussian(0.8)), 7.2), 0.01
    plan = plan_spectral((96, 128), core, POINT, 1e-3)
    places = [(60.3, 61.4, 1e9), (64.9, 63.2, 1.0), (66.1, 64.8, 3.0), (20.5, 90.0, 9.0)]
    image, exact = np.zeros((2, 96, 128))
    for x, y, light in places:
        exact += light * gaussian_pixels((96, 128), x, y, 0.8, POINT)
        if light > brightest_for(plan, budget_e):
            image += light * exact_stamp(core, POINT, (96, 128), x, y)
    faint = [one(*p)[0] for p in places if p[2] <= brightest_for(plan, budget_e)]
    assert len(faint) == 3
    image += draw(plan, core, faint)
    assert np.abs(image - exact)[60:68, 63:69].max() <= 2 * budget_e


def test_errors_of_a_crowd_add_up_like_noise() -> None:
    rng = np.random.default_rng(6)
    x, y = rng.uniform(-30, 286, (2, 20000))
    light = rng.exponential(10.0, 20000)
    for core, path, asked in (
        (gaussian_core(0.8), POINT, 1e-3),
        (CORES["airy"], POINT, 1e-3),
        (CORES["airy"], line(40.0), 1e-5),
    ):
        fine, coarse = (
            plan_spectral((256, 256), core, path, e * peak_light(core, path), sources=2e4)
            for e in (1e-7, asked)
        )
        many = [Sources(x, y, light, path)]
        off = draw(coarse, core, many) - draw(fine, core, many)
        together = coarse.error * np.sqrt(CROWD_PX * np.square(light).sum() / 316.0**2)
        assert 0.1 <= off.std() / together <= 1.0


def test_float32_keeps_far_pixels_dark() -> None:
    """1e9 electrons in float32: the arithmetic's error is within its bound all over the block."""
    core = gaussian_core(0.8)
    plan = plan_spectral((512, 512), core, POINT, 3e-6, single=True)
    image = draw(plan, core, one(200.2, 300.7, 1e9))
    image[280:320, 180:220] = 0.0
    assert np.abs(image).max() <= 1e9 * plan.rounding
    assert image.std() < 1e9 * 1e-9


def test_asymmetric_response() -> None:
    """A response without symmetry has a complex table: a comet of three Gaussians."""
    even = gaussian_core(0.9)
    samples = even.samples.copy()
    for k, shift in enumerate((3, 7)):
        samples += 0.3 * np.roll(even.samples, (shift, 2 * shift * k), axis=(0, 1))
    core = Core(even.oversampling, even.radius_px + 5.0, samples, 1.6)
    plan = plan_spectral((40, 50), core, line(8.0), 1e-6)
    table = transfer_table(core, plan)
    assert np.iscomplexobj(table)
    for x, y in ((25.3, 19.8), (2.1, 38.9)):
        image = draw_spectral(plan, table, one(x, y, 1.0, line(8.0)), (0, 0))
        assert np.abs(image - exact_stamp(core, line(8.0), (40, 50), x, y)).max() <= plan.error


def test_same_bits_in_threads_and_whatever_is_out_of_reach() -> None:
    core, path = gaussian_core(0.8), line(30.0)
    plan = plan_spectral((200, 220), core, path, 1e-5)
    table = transfer_table(core, plan)
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-90, 310, 4000), rng.uniform(-90, 290, 4000)
    light = rng.uniform(1, 100, 4000)
    first = draw_spectral(plan, table, [Sources(x, y, light, path)], (0, 0))
    again = [
        draw_spectral(plan, table, [Sources(x, y, light, path)], (0, 0), threads=n)
        for n in (2, 3, 5)
    ]
    with ThreadPoolExecutor(4) as pool:
        again += pool.map(
            lambda _: draw_spectral(plan, table, [Sources(x, y, light, path)], (0, 0)), range(4)
        )
    half = 0.5 * 30.0
    near = np.maximum(np.abs(x - 109.5) - 110, np.abs(y - 99.5) - 100) <= plan.halo_px + half
    inner = Sources(x[near], y[near], light[near], path)
    again.append(draw_spectral(plan, table, [inner], (0, 0)))
    far = Sources(np.append(x, 9e3), np.append(y, 9e3), np.append(light, 1e9), path)
    again.append(draw_spectral(plan, table, [far], (0, 0)))
    moved = Sources(x + 4096.0, y - 2048.0, light, path)
    shifted = draw_spectral(plan, table, [moved], (-2048, 4096))
    assert all((image == first).all() for image in again)
    assert np.abs(shifted - first).max() <= 1e-6 * first.max()


@settings(max_examples=12, deadline=None)
@given(
    name=st.sampled_from(sorted(CORES)),
    place=st.tuples(st.floats(-30, 100), st.floats(-30, 90)),
    motion=st.tuples(st.floats(-25, 25), st.floats(-25, 25)),
    light=st.floats(1e-3, 1e6),
    asked=st.sampled_from([1e-3, 1e-5]),
)
def test_same_as_stamps_within_the_bounds(
    name: str,
    place: tuple[float, float],
    motion: tuple[float, float],
    light: float,
    asked: float,
) -> None:
    core = CORES[name]
    dx, dy = motion
    path = Path(np.array([-dx, dx]) / 2, np.array([-dy, dy]) / 2, np.ones(1))
    half_y, half_x, *period = window(core, abs(dy) / 2, abs(dx) / 2)
    swept = transfer(*frequencies(core, *period), path.x_px, path.y_px, path.weight)
    spectrum = core_spectrum(core, *period) * swept
    stamps = phase_table(core, spectrum, (half_y, half_x), tuple(period), 16)
    by_stamps = np.zeros((60, 70))
    at = np.array([place[0]]), np.array([place[1]]), np.array([light])
    draw_stamps(by_stamps, (0, 0), stamps, *at, np.ones(1, bool))
    plan = plan_spectral((60, 70), core, path, asked * peak_light(core, path))
    off = np.abs(draw(plan, core, one(*place, light, path)) - by_stamps)
    assert off.max() <= light * (plan.error + stamps.cubic_error + 1e-8 * stamps.peak)


@pytest.mark.parametrize("ny", [32, 40, 48, 64, 70])
@pytest.mark.parametrize("threads", [1, 2])
def test_sources_in_every_row_of_bins_are_spread(ny: int, threads: int) -> None:
    """An even or odd number of them, the last whole or not: each as the kernel has it."""
    kernel, grid = Kernel(6, 13.0), np.zeros((ny, 40))
    y = np.arange(4.0, ny - 4.0) + 0.3
    x = 12.0 + 0.25 * np.arange(y.size) % 16.0
    light = 1.0 + np.arange(y.size)
    spread_onto(grid, 40, kernel, y, x, light, threads)
    wanted = np.zeros_like(grid)
    rows, columns = np.arange(ny), np.arange(40)
    for k in range(y.size):
        wanted += light[k] * np.outer(kernel.value(rows - y[k]), kernel.value(columns - x[k]))
    assert np.abs(grid - wanted).max() < 1e-4 * wanted.max()
