"""One source along its own path: the same stamp as from its whole spectrum, step by step."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.drawing.along import stamp_along
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
    still = core_spectrum(core, None, *period)
    swept = still * transfer(fy, fx, path.x_px, path.y_px, path.weight)
    for y, x in ((0.0, 0.0), (17.25, -3.61), (-0.001, 250.999)):
        row, column, stamp = stamp_along(core, still, (half_y, half_x), tuple(period), path, y, x)
        expected = stamp_at(core, swept, (half_y, half_x), tuple(period), y, x)
        assert (row, column) == expected[:2]
        np.testing.assert_allclose(stamp, expected[2], rtol=0.0, atol=1e-13)
        assert stamp.sum() == pytest.approx(core.light, abs=1e-6)
