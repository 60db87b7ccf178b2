"""Which stars are too faint to be drawn one by one: the limiting magnitude that the noise sets."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.physics.positions.focal_plane import Camera
from pipeline.physics.psf.pupil import Blur
from pipeline.plan.pointing.star_paths import star_paths

Array = NDArray[np.float64]

STEP_G_MAG = 0.5  # limits are edges of the bins of a starlight map, where it is exact
BRIGHTEST_G_MAG, FAINTEST_G_MAG = 3.0, 22.0
FREQUENCIES = 129  # of each axis, in the integral of a transfer function
BAND_FLOOR = 1e-3
STRAIGHT = 0.9  # a path whose ends are this share of its length apart is not taken twice


@dataclass(frozen=True)
class FaintLimit:
    """The limit, and what leaving the fainter stars out of the drawing does to a pixel.

    star_e : most that one star beyond the limit puts into a pixel; grain_e : rms of all of them
    around their mean; beyond FAINTEST_G_MAG nothing is omitted
    """

    g_mag: float
    star_e: float
    grain_e: float


def faint_limit(
    squared_sr: Array, zero_e: float, peak: float, pixel_sr: float, budget_e: float
) -> FaintLimit:
    """The brightest limit at which neither one star nor the crowd's graininess exceeds a budget.

    squared_sr : (n,) largest summed squared G light per sr of stars beyond each of `limits_g_mag`
    zero_e : electrons in the exposure of a star of G = 0 of the brightest colour; peak : largest
    share of a star's light in a pixel. The variance of Poisson-scattered stars in a pixel is
    pixel_sr sum(light^2 share^2), and the sum of share^2 over pixels is at most `peak`.
    """
    limits = limits_g_mag()
    star = zero_e * peak * 10.0 ** (-0.4 * limits)
    grain = zero_e * np.sqrt(pixel_sr * peak * squared_sr)
    star[squared_sr == 0.0] = 0.0  # there is no star beyond
    fine = (star <= budget_e) & (grain <= budget_e)
    at = int(np.argmax(fine)) if fine.any() else limits.size - 1
    return FaintLimit(float(limits[at]), float(star[at]), float(grain[at]))


def limits_g_mag() -> Array:
    """All limits that are tried, bright first."""
    return np.arange(BRIGHTEST_G_MAG, FAINTEST_G_MAG + 0.01, STEP_G_MAG)


def peak_share(blur: Blur, camera: Camera, g: Geometry, aberration: bool) -> float:
    """Upper bound of the share of a star's light that one pixel takes, in all frames looked at.

    At rest: the integral of the modulus of the transfer function, and at most all of it, also of a
    pixel that collects on a part of its area: a sharp star may stand in the middle of that. On a
    straight streak that moves at least L pixels an exposure everywhere, at most sqrt(2) / L, a
    pixel's diagonal.
    """
    end = blur.band_limit(BAND_FLOOR)
    f = np.linspace(-end, end, FREQUENCIES)
    transfer = np.abs(blur.transfer(f[:, None], f[None, :]))
    share = min(float(np.trapezoid(np.trapezoid(transfer, f), f)), 1.0)
    (x0, y0), x1, y1 = camera.centre_px, camera.columns - 1.0, camera.rows - 1.0
    x, y = np.array([x0, 0.0, x1, 0.0, x1]), np.array([y0, 0.0, 0.0, y1, y1])
    paths = star_paths(camera, g, x, y, aberration)
    steps = np.hypot(*np.diff(paths, axis=-1))
    ends = np.hypot(*(paths[..., -1] - paths[..., 0]))
    slowest = float(steps.min()) * steps.shape[-1]
    if slowest > math.sqrt(2.0) / share and np.all(ends >= STRAIGHT * steps.sum(axis=-1)):
        share = math.sqrt(2.0) / slowest
    return share
