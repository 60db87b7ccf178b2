"""Wings for the spectral engine: what a core leaves out of a response, with its rings.

Diffraction rings reach as far as the wings do, with 1/Q cycles per pixel; a coarse grid
(physics/drawing/wings.py) drops them, and errs by about the wing's own level at the core's edge.
Here they are kept, so that a very bright source may be the stamp of its core plus this wing, with
the error that `plan_spectral` says. For Q well below 1 the grid that the rings need does not fit in
memory, and `plan_spectral` refuses.
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


def wing_response(blur: Blur, core: Core, reach_px: float) -> Core:
    """Response less its core, cut off smoothly at `reach_px`, as a core of its own.

    blur, core : core is `compact_core(blur, ...)`; light beyond `reach_px` is left out
    The samples are as dense as rings and the core's edge need, at most as the core's. Core and wing
    add up to the response: their light to what falls within the reach.
    """
    edge_px = (1.0 - TAPER_FROM) * core.radius_px
    needed = 2.0 * (blur.band_limit(1e-9) + EDGE_CYCLES / edge_px)
    os = core.oversampling
    while os > 1 and 0.5 * os >= needed:
        os //= 2
    step = core.oversampling // os
    half, inner = int(np.ceil(reach_px)) + 2, core.samples.shape[0] // 2 // step
    n = scipy.fft.next_fast_len(2 * half + 8) * os
    fy, fx = scipy.fft.fftfreq(n, 1.0 / os)[:, None], scipy.fft.rfftfreq(n, 1.0 / os)[None, :]
    at = scipy.fft.fftfreq(n, 1.0 / n) / os
    image = scipy.fft.irfft2(blur.image(fy, fx), s=(n, n), workers=1)
    image *= taper(np.hypot(at[:, None], at[None, :]), CUT_FROM * reach_px, reach_px)
    whole = scipy.fft.irfft2(
        scipy.fft.rfft2(image, workers=1) * blur.pixel(fy, fx), s=(n, n), workers=1
    )
    index = np.arange(-half * os, half * os + 1)
    samples = whole[np.ix_(index, index)] * os**2
    middle = slice(half * os - inner, half * os + inner + 1)
    offset = core.samples.shape[0] // 2 - inner * step
    part = slice(offset, offset + 2 * inner * step + 1, step)
    samples[middle, middle] -= core.samples[part, part]
    light = float(image.sum()) * blur.fill_factor - core.light
    return Core(samples, os, reach_px, light)
