"""Wings for the spectral engine: what a core leaves out of a response, with its rings.

Diffraction rings reach as far as the wings do, with 1/Q cycles per pixel; a coarse grid
(physics/drawing/wings.py) drops them, and errs by about the wing's own level at the core's edge.
Here they are kept, so that a very bright source may be the stamp of its core plus this wing, with
the error that `plan_spectral` says. The smaller Q is, the finer the grid that the rings need, and
the smaller the block that fits in memory.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import TAPER_FROM, Core, taper

Array = NDArray[np.float64]

CUT_FROM = 0.9  # of the reach: where the wing's cut-off begins, as in physics/drawing/wings.py
EDGE_CYCLES = 4.0  # that the core's edge adds to the band, over its width (1e-9 of the peak beyond)
COARSE_PX = 4  # grid of the light of far copies, which is smooth
COPIES = 4  # periods on each axis whose copies are taken away


def wing_response(blur: Blur, core: Core, reach_px: float) -> Core:
    """Response less its core, cut off smoothly at `reach_px`, as a core of its own.

    core : `compact_core(blur, radius)`; light beyond `reach_px` is left out
    The samples are as dense as rings and the core's edge need, at most as the core's. Core and wing
    add up to the response: their light to what falls within the reach.
    """
    os = _samples_needed(blur, core)
    step, half = core.oversampling // os, int(np.ceil(reach_px)) + 2
    inner = core.samples.shape[0] // 2 // step
    period = 2 * COARSE_PX * scipy.fft.next_fast_len((2 * half + 8) // (2 * COARSE_PX) + 1)
    n = period * os
    fy, fx = scipy.fft.fftfreq(n, 1.0 / os)[:, None], scipy.fft.rfftfreq(n, 1.0 / os)[None, :]
    at = scipy.fft.fftfreq(n, 1.0 / n) / os
    image = scipy.fft.irfft2(blur.image(fy, fx), s=(n, n), workers=1)
    image -= _copies(blur, period, at) / os**2
    image *= taper(np.hypot(at[:, None], at[None, :]), CUT_FROM * reach_px, reach_px)
    light = float(image.sum()) * blur.fill_factor - core.light
    spectrum = scipy.fft.rfft2(image, workers=1)
    spectrum *= blur.pixel(fy, fx)
    index = np.arange(-half * os, half * os + 1)
    samples = scipy.fft.irfft2(spectrum, s=(n, n), workers=1)[np.ix_(index, index)] * os**2
    middle = slice(half * os - inner, half * os + inner + 1)
    offset = core.samples.shape[0] // 2 - inner * step
    part = slice(offset, offset + 2 * inner * step + 1, step)
    samples[middle, middle] -= core.samples[part, part]
    return Core(samples, os, reach_px, light)


def _samples_needed(blur: Blur, core: Core) -> int:
    """Samples per pixel that hold the rings and what the core's edge adds to their band."""
    edge_px = (1.0 - TAPER_FROM) * core.radius_px
    needed = 2.0 * (blur.band_limit(1e-9) + EDGE_CYCLES / edge_px)
    os = core.oversampling
    while os > 1 and 0.5 * os >= needed:
        os //= 2
    return os


def _copies(blur: Blur, period: int, at_px: Array) -> Array:
    """Light per px^2 that copies of a source, one period apart, leave at (at_px, at_px).

    A Fourier sum holds them all. Far from their source they are smooth, so the nearest
    COPIES x COPIES are summed on a coarse grid, COPIES periods wide, and interpolated.
    """
    from scipy.interpolate import RectBivariateSpline

    m, h = period // COARSE_PX, float(COARSE_PX)
    n = COPIES * m
    fy, fx = scipy.fft.fftfreq(n, h)[:, None], scipy.fft.rfftfreq(n, h)[None, :]
    smooth = taper(np.hypot(fy, fx), 0.25 / h, 0.5 / h)
    far = scipy.fft.irfft2(blur.image(fy, fx) * smooth, s=(n, n), workers=1) / h**2
    own = np.arange(-(m // 2), m - m // 2)  # the source's own copy, about the origin
    summed = far.reshape(COPIES, m, COPIES, m).sum(axis=(0, 2))
    others = summed[np.ix_(own, own)] - far[np.ix_(own, own)]
    order = np.argsort(at_px, kind="stable")
    spline = RectBivariateSpline(own * h, own * h, others)
    values = np.empty((at_px.size, at_px.size))
    values[np.ix_(order, order)] = spline(at_px[order], at_px[order])
    return values
