"""Stars drawn as column times row, against products of erf; the same bits however it is cut."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr

from pipeline.physics.drawing.products import draw_products
from pipeline.physics.drawing.stamps import draw_stamps
from pipeline.physics.psf.product import is_product, product_table
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import compact_core

SIZE = 48


def exact(x: float, y: float, sigma: float, side: float) -> np.ndarray:
    """Light of a unit Gaussian in squares of `side` px about the pixels' centres."""
    edges = np.arange(SIZE)[:, None] + np.array([-0.5, 0.5]) * side
    column, row = (np.diff(ndtr((edges - at) / sigma), axis=1)[:, 0] for at in (y, x))
    return np.outer(column, row)


@given(
    st.floats(0.15, 3.0), st.floats(10.0, 37.0), st.floats(-2.0, 50.0),
    st.sampled_from([1.0, 0.64]), st.sampled_from([8, 16, 64]),
)  # fmt: skip
def test_within_the_stated_error(sigma: float, x: float, y: float, fill: float, n: int) -> None:
    core = compact_core(Blur(Gaussian(sigma), fill_factor=fill), 6.2 * sigma)
    table = product_table(core, n)
    image = np.zeros((SIZE, SIZE))
    draw_products(image, (0, 0), table, np.array([x]), np.array([y]), np.ones(1))
    off = np.abs(image - exact(x, y, sigma, np.sqrt(fill))).max()
    assert off <= table.cubic_error + 4e-8 * table.peak  # spans and the circle's edge


def test_many_phases_err_by_a_billionth() -> None:
    table = product_table(compact_core(Blur(Gaussian(0.8)), 6.2 * 0.8))
    assert table.cubic_error < 3e-8 * table.peak


def test_whole_light_and_jitter_in_quadrature() -> None:
    blur = Blur(Gaussian(0.6), 0.8, 1.2)
    table = product_table(compact_core(blur, 10.0))
    image = np.zeros((SIZE, SIZE))
    draw_stamps(image, (0, 0), table, *np.full((2, 1), 20.3), np.ones(1), np.zeros(1, bool))
    assert image.sum() == pytest.approx(1.0, abs=1e-6)
    sigma = np.sqrt(0.6**2 + 0.8**2 + 1.2**2)
    assert np.abs(image - exact(20.3, 20.3, sigma, 1.0)).max() < 1e-8


def test_same_bits_when_the_frame_is_cut() -> None:
    table = product_table(compact_core(Blur(Gaussian(1.3)), 8.0))
    rng = np.random.default_rng(1)
    x, y, light = rng.uniform(-30, 158, 500), rng.uniform(-30, 126, 500), rng.uniform(1, 1e5, 500)
    whole = np.zeros((96, 128))
    draw_products(whole, (0, 0), table, x, y, light)
    for rows, columns in ((48, 64), (5, 128), (96, 3), (1, 1)):
        joined = np.zeros_like(whole)
        for y0 in range(0, 96, rows):
            for x0 in range(0, 128, columns):
                part = np.zeros((min(rows, 96 - y0), min(columns, 128 - x0)))
                draw_products(part, (y0, x0), table, x, y, light)
                joined[y0 : y0 + rows, x0 : x0 + columns] = part
        assert (joined == whole).all()


def test_only_gaussians_at_rest() -> None:
    assert is_product(Blur(Gaussian(1.0)), 0.0)
    assert not is_product(Blur(Gaussian(1.0)), 1.0)
    assert not is_product(Blur(Airy(1.0)), 0.0)
