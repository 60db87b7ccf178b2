"""Plans of the spectral engine: kernels, bounds, memory, what is refused."""

from __future__ import annotations

import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.physics.drawing.spectral import Sources, draw_spectral, transfer_table
from pipeline.physics.drawing.spectral_band import band_of, peak_light, sweep_bound
from pipeline.physics.drawing.spectral_plan import _grid_errors, plan_spectral
from pipeline.physics.drawing.spectral_spread import Kernel, spread_onto
from pipeline.physics.motion.streak import POINT, Path, pieces, transfer
from pipeline.physics.psf.pupil import Airy, Blur, EllipticalGaussian, Gaussian
from pipeline.physics.psf.response import (
    Core,
    compact_core,
    core_spectrum,
    frequencies,
    stamp_at,
    window,
)
from tests.slow import slow

KERNELS = [Kernel(w, b * w) for w in (4, 5, 6, 8, 12) for b in (1.6, 2.1, 2.6)]


def gaussian_core(sigma: float) -> Core:
    return compact_core(Blur(Gaussian(sigma)), 6.1 * sigma)


def line(length: float, angle: float = 0.6435) -> Path:
    x, y = 0.5 * length * np.cos(angle), 0.5 * length * np.sin(angle)
    return Path(np.array([-x, x]), np.array([-y, y]), np.ones(1))


@pytest.mark.parametrize("kernel", KERNELS)
def test_kernel_transform_is_its_integral(kernel: Kernel) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(200)
    u = 0.5 * kernel.width * nodes
    for turns in (0.0, 0.2, 0.5, 0.9, 1.7):
        integral = 0.5 * kernel.width * weights @ (kernel.value(u) * np.cos(2 * np.pi * turns * u))
        assert kernel.transform(np.array(turns)) == pytest.approx(integral, abs=1e-12)


@pytest.mark.parametrize("kernel", KERNELS)
def test_alias_bound_holds_at_every_place_in_a_cell(kernel: Kernel) -> None:
    """Sums over grid points against the kernel's transform: the worst of 200 places."""
    turns = np.linspace(0.0, 0.49, 50)
    places = np.concatenate([[0.0, 1e-9, 1 - 1e-9], np.linspace(0.001, 0.999, 197)])
    u = np.arange(-8, 9) - places[:, None]
    sums = np.einsum("pu,puf->pf", kernel.value(u), np.exp(-2j * np.pi * turns * u[:, :, None]))
    worst = np.abs(sums - kernel.transform(turns)).max(axis=0) / kernel.transform(turns)
    stated = kernel.alias_ratio(turns, single=False)
    assert (worst <= stated).all()
    assert (stated <= 60 * worst).all()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("width", [4, 5, 8, 11])
def test_spreading_is_the_kernel_at_every_source(width: int, kind: type) -> None:
    kernel = Kernel(width, 2.2 * width)
    rng = np.random.default_rng(1)
    x, y, light = rng.uniform(-5, 210, 700), rng.uniform(-5, 105, 700), rng.uniform(0, 2, 700)
    grid, exact = np.zeros((100, 204), kind), np.zeros((100, 200))
    spread_onto(grid, 200, kernel, y, x, light)
    half = width / 2
    inside = (x - half > -1) & (x + half < 200) & (y - half > -1) & (y + half < 100)
    for a, b, e in zip(x[inside], y[inside], light[inside], strict=True):
        exact += e * np.outer(kernel.value(np.arange(100) - b), kernel.value(np.arange(200) - a))
    assert not grid[:, 200:].any()
    middle = slice(width, -width)  # sources on the border may be omitted
    off = np.abs(grid[:, :200] - exact)[middle, middle].max()
    assert off < 12 * kernel.weight_error(kind is np.float32)


def test_sweep_bound_is_above_the_mean_of_the_streak() -> None:
    """Cells wider than the lobes of the sinc: against its mean over fine samples of each cell."""
    fy, fx, step = np.linspace(0, 1, 11), np.linspace(0, 1, 11), 0.1
    for path in (line(3.0), line(60.0), line(300.0, 0.0), line(200.0, 2.2)):
        stated = sweep_bound(fy, fx, step, path, np.inf)
        fine = (np.arange(40) + 0.5) / 40 * step - 0.5 * step
        for i in range(0, 11, 2):
            for j in range(0, 11, 2):
                one = transfer(fy[i] + fine, fx[j] + fine, path.x_px, path.y_px, path.weight)
                assert np.abs(one).mean() <= 1.01 * stated[i, j] + 1e-12


def test_band_holds_all_of_a_positive_response() -> None:
    """The integral of |transfer| of a Gaussian is its value at the centre."""
    core = gaussian_core(1.3)
    band = band_of(core, POINT, np.inf)
    centre = core.samples[core.samples.shape[0] // 2, core.samples.shape[0] // 2]
    assert band.weight.sum() == pytest.approx(centre, rel=1e-6)
    assert band.cut(band.limit_for(1e-4, 0.0)) <= 1e-4
    assert peak_light(core, POINT) == pytest.approx(centre)


@pytest.mark.parametrize(
    ("sigma", "length"),
    [(0.8, 0.0), (0.8, 300.0), (0.8, 3000.0), slow(30.0, 300.0)],
)
def test_memory_is_bounded_and_foretold(sigma: float, length: float) -> None:
    core, path = gaussian_core(sigma), line(length)
    error = 1e-3 * peak_light(core, path)
    plan = plan_spectral((512, 512), core, path, error, most_bytes=100e6)
    assert plan.bytes <= 100e6
    table = transfer_table(core, plan)
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, 512, (2, 1000))
    sources = [Sources(x, y, np.ones(1000), path)]
    draw_spectral(plan, table, sources, (0, 0))
    tracemalloc.start()
    draw_spectral(plan, table, sources, (0, 0))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    per_piece = 150 * 1000 * len(pieces(path, plan.longest_px))
    assert peak + table.nbytes <= 1.1 * plan.bytes + per_piece + 2e6


def test_costs_grow_as_they_should() -> None:
    core, path = gaussian_core(0.8), line(60.0)
    peak = peak_light(core, path)
    plans = [plan_spectral((2048, 2048), core, path, e * peak) for e in (1e-2, 1e-3, 1e-5)]
    seconds = [p.seconds(1e5) for p in plans]
    assert seconds == sorted(seconds)
    assert all(p.single and p.bytes < 250e6 and p.light_error <= 1e-6 for p in plans)
    assert all(p.seconds(1e6) > p.seconds(1e4) for p in plans)
    few = plan_spectral((2048, 2048), core, path, 1e-3 * peak, sources=1e3)
    many = plan_spectral((2048, 2048), core, path, 1e-3 * peak, sources=1e7)
    assert many.kernel.width <= few.kernel.width


def test_precision_follows_the_error_and_the_crowd() -> None:
    core = gaussian_core(0.8)
    peak = peak_light(core, POINT)
    assert plan_spectral((128, 128), core, POINT, 1e-3 * peak).single
    assert not plan_spectral((128, 128), core, POINT, 1e-7 * peak).single
    assert not plan_spectral((128, 128), core, POINT, 1e-3 * peak, sources=1e7).single
    assert plan_spectral((128, 128), core, POINT, 1e-3 * peak, single=True, sources=1e7).single


def test_a_wide_block_and_a_high_one_have_one_plan() -> None:
    core = gaussian_core(0.8)
    error = 1e-3 * peak_light(core, POINT)
    wide, high = (plan_spectral(shape, core, POINT, error) for shape in ((64, 512), (512, 64)))
    assert (wide.keep, wide.points) == (high.keep[::-1], high.points[::-1])
    assert wide.error == pytest.approx(high.error, rel=0.1)
    assert wide.keep[1] / wide.period[1] == pytest.approx(wide.keep[0] / wide.period[0], rel=0.03)


def test_what_no_grid_reaches_is_refused() -> None:
    sharp = compact_core(Blur(Airy(0.1)), 4.0)
    with pytest.raises(BadInput, match="a larger one, a smaller block"):
        plan_spectral((2048, 2048), sharp, POINT, 1e-4)
    assert plan_spectral((64, 64), sharp, POINT, 1e-4).limit > 5.0
    with pytest.raises(BadInput):
        plan_spectral((64, 64), gaussian_core(0.8), POINT, 1e-13)


def test_same_plan_for_alike_streaks() -> None:
    """Pads are rounded, so that streaks that differ by little share plan and table."""
    core = gaussian_core(0.8)
    first, second = (plan_spectral((256, 256), core, line(n), 1e-6) for n in (60.0, 60.2))
    assert (first.period, first.pad) == (second.period, second.pad)


def test_peak_of_a_bent_streak_is_that_of_its_stamps() -> None:
    """The light of a pixel at the middle of a segment, from the transform of path and core."""
    core = compact_core(Blur(EllipticalGaussian(1.3, 0.7, 0.4)), 8.0)
    path = Path(np.array([-6.0, 1.0, 3.0]), np.array([2.0, 1.0, -7.0]), np.array([0.35, 0.65]))
    half_y, half_x, *period = window(core, 9.0, 8.0)
    f = frequencies(core, *period)
    swept = core_spectrum(core, *period) * transfer(*f, path.x_px, path.y_px, path.weight)
    at = []
    for k in (0, 1):
        y, x = (-0.5 * (v[k] + v[k + 1]) for v in (path.y_px, path.x_px))
        row, column, stamp = stamp_at(core, swept, (half_y, half_x), tuple(period), y, x)
        at.append(stamp[-row, -column])
    assert peak_light(core, path) == pytest.approx(max(at), rel=5e-3)
    other = Path(path.x_px, path.y_px, path.weight[::-1])
    assert abs(peak_light(core, other) / max(at) - 1.0) > 0.05


def test_errors_of_both_axes_of_a_grid_are_multiplied() -> None:
    """A tenth on each: 0.21 of what is kept, and of all light."""
    kept = np.array([1.0, 0.5]), np.array([1.0, 0.25])
    zeros, unit = np.zeros(2), SimpleNamespace(alias_ratio=lambda turns, _: 0.1 + 0.0 * turns)
    band = SimpleNamespace(fy=zeros, fx=zeros, integral=lambda a, b: float(np.outer(a, b).sum()))
    need = SimpleNamespace(band=band, single=False)
    found = _grid_errors(need, unit, (1.0, 1.0), kept)
    assert found == pytest.approx((0.21 * 1.5 * 1.25, 0.21))
