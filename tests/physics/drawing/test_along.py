"""One source along its own path: the same stamp as from its whole spectrum, step by step."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.drawing.along import (
    NO_LIGHT,
    lit_columns,
    stamp_along,
    swept_spectrum,
)
from pipeline.physics.motion.streak import POINT, Path, transfer
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import (
    compact_core,
    core_spectrum,
    frequencies,
    stamp_at,
    window,
)

BENT = Path(np.array([-9.0, 1.0, 6.5]), np.array([4.0, -3.0, -2.5]), np.array([0.7, 0.3]))
STRAIGHT = Path(np.array([-12.3, 12.3]), np.array([5.1, -5.1]), np.ones(1))


@pytest.mark.parametrize("path", [POINT, STRAIGHT, BENT], ids=["point", "straight", "bent"])
@pytest.mark.parametrize("optics", [Gaussian(0.6), Airy(1.0, 0.3)], ids=["gaussian", "airy"])
def test_against_the_whole_spectrum(optics, path):
    blur = Blur(optics)
    core = compact_core(blur, 9.0)
    half_y, half_x, *period = window(core, np.abs(path.y_px).max(), np.abs(path.x_px).max())
    fy, fx = frequencies(core, *period)
    still = core_spectrum(core, *period)
    swept = still * transfer(fy, fx, path.x_px, path.y_px, path.weight)
    of_core = core, still, lit_columns(still), (half_y, half_x), tuple(period)
    for y, x in ((0.0, 0.0), (17.25, -3.61), (-0.001, 250.999)):
        row, column, stamp = stamp_along(*of_core, path, y, x)
        expected = stamp_at(core, swept, (half_y, half_x), tuple(period), y, x)
        assert (row, column) == expected[:2]
        np.testing.assert_allclose(stamp, expected[2], rtol=0.0, atol=1e-12)
        assert stamp.sum() == pytest.approx(core.light, abs=1e-6)


@pytest.mark.parametrize("path", [STRAIGHT, BENT], ids=["straight", "bent"])
@pytest.mark.parametrize("optics", [Gaussian(0.6), Airy(1.0, 0.3)], ids=["gaussian", "airy"])
def test_a_swept_spectrum_is_the_product_wherever_there_is_light(optics, path):
    core = compact_core(Blur(optics), 9.0)
    *_, rows, columns = window(core, np.abs(path.y_px).max(), np.abs(path.x_px).max())
    fy, fx = frequencies(core, rows, columns)
    still = core_spectrum(core, rows, columns)
    whole = still * transfer(fy, fx, path.x_px, path.y_px, path.weight)
    swept = swept_spectrum(core, path, (rows, columns))
    off = np.abs(swept - whole).max()
    assert off <= NO_LIGHT * core.oversampling**2 * core.light
    empty = np.abs(still) < 0.5 * NO_LIGHT * core.light
    assert (swept[empty.all(axis=1)] == 0.0).all()


def test_a_core_at_rest_is_not_swept():
    core = compact_core(Blur(Gaussian(0.6)), 9.0)
    *_, rows, columns = window(core, 0.0, 0.0)
    still = core_spectrum(core, rows, columns)
    np.testing.assert_array_equal(swept_spectrum(core, POINT, (rows, columns)), still)
    moved = Path(POINT.x_px + 2.0, POINT.y_px, POINT.weight)
    _, fx = frequencies(core, rows, columns)
    whole = still * np.exp(-2j * np.pi * 2.0 * fx)[None, :]
    np.testing.assert_allclose(swept_spectrum(core, moved, (rows, columns)), whole, atol=1e-10)
