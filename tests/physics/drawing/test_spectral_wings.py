"""Wings by the spectral engine: core and wing against quadrature of the Airy pattern."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j1

from pipeline.physics.drawing.spectral import Sources, draw_spectral, transfer_table
from pipeline.physics.drawing.spectral_plan import plan_spectral
from pipeline.physics.drawing.spectral_wings import wing_response
from pipeline.physics.drawing.wings import wing_error
from pipeline.physics.motion.streak import POINT
from pipeline.physics.psf.pupil import Airy, Blur
from pipeline.physics.psf.response import compact_core, core_spectrum, stamp_at, window


def pixel_light(dx: float, dy: float, q: float, eps: float) -> float:
    """Light of an obscured Airy pattern in the pixel (dx, dy) off its centre, by Gauss-Legendre."""
    parts = int(max(4, np.ceil(3.0 / q)))
    nodes, weights = np.polynomial.legendre.leggauss(10)
    at = ((np.arange(parts)[:, None] + 0.5 + nodes / 2) / parts).ravel() - 0.5
    w = np.tile(weights / (2 * parts), parts)
    x = np.pi / q * np.maximum(np.hypot(dx + at, dy + at[:, None]), 1e-9)
    amplitude = 2.0 * j1(x) / x - eps * 2.0 * j1(eps * x) / x
    return float(w @ amplitude**2 @ w) * np.pi / (4.0 * q**2 * (1.0 - eps**2))


@pytest.mark.parametrize(
    ("q", "eps", "radius"), [(0.5, 0.3, 20.0), (1.0, 0.3, 24.0), (2.0, 0.0, 48.0)]
)
def test_core_and_wing_against_quadrature(q: float, eps: float, radius: float) -> None:
    """The stated error holds far below what a coarse grid makes; the cut-off stays out of view."""
    blur, reach = Blur(Airy(q, eps)), 6.0 * radius
    core = compact_core(blur, radius)
    wing = wing_response(blur, core, reach)
    peak, size = float(core.samples.max()), int(3 * radius)
    coarse = wing_error(blur, core, int(2 ** max(1, np.floor(np.log2(radius / 5.0)))))
    plan = plan_spectral((size, size), wing, POINT, 2e-8 * peak)
    assert plan.error < 0.05 * coarse
    x, y = size / 2 + np.array([0.31, -0.22])
    source = [Sources(np.array([x]), np.array([y]), np.ones(1), POINT)]
    image = draw_spectral(plan, transfer_table(wing, plan), source, (0, 0)).astype(float)
    half_y, half_x, *period = window(core, 0.0, 0.0)
    spectrum = core_spectrum(core, None, *period)
    row, column, stamp = stamp_at(core, spectrum, (half_y, half_x), tuple(period), y, x)
    image[row : row + stamp.shape[0], column : column + stamp.shape[1]] += stamp
    rng = np.random.default_rng(1)
    for r in np.concatenate([[0.0, 1.0], rng.uniform(0.4, 2.0, 60) * radius]):
        angle = rng.uniform(0, 2 * np.pi)
        j, i = round(x + r * np.cos(angle)), round(y + r * np.sin(angle))
        if 0 <= i < size and 0 <= j < size:
            assert abs(image[i, j] - pixel_light(j - x, i - y, q, eps)) <= plan.error + 1e-8 * peak


@pytest.mark.parametrize(
    ("q", "radius", "reach"), [(0.5, 12.0, 80.0), (1.0, 12.0, 160.0), (4.0, 96.0, 400.0)]
)
def test_light_of_core_and_wing(q: float, radius: float, reach: float) -> None:
    blur = Blur(Airy(q, 0.3))
    core = compact_core(blur, radius)
    wing = wing_response(blur, core, reach)
    assert core.light + wing.light == pytest.approx(1.0 - blur.light_beyond(0.95 * reach), abs=2e-3)
    assert wing.samples.sum() / wing.oversampling**2 == pytest.approx(wing.light, abs=1e-6)
    assert wing.oversampling <= core.oversampling
