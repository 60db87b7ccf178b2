"""Pictures of bodies: coarser ones, and how far the cells of one may be from the body itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.psf.pupil import Blur
from pipeline.physics.targets.disc import Picture, picture

Array = NDArray[np.float64]

BAND_FLOOR = 1e-6
STEPS = 48  # of the frequency integral, along each half axis


def coarser(fine: Picture) -> Picture:
    """The same body in cells of twice the side."""
    rows, columns = fine.shares.shape
    padded = np.pad(fine.shares, ((0, rows % 2), (0, columns % 2)))
    r, c = padded.shape
    cells = padded.reshape(r // 2, 2, c // 2, 2).sum(axis=(1, 3))
    centre = (0.5 * (fine.centre[0] - 0.5), 0.5 * (fine.centre[1] - 0.5))
    return picture(cells, 2.0 * fine.side_px, centre)


def cell_error(blur: Blur, fine: Picture) -> float:
    """What a pixel may err by, per unit light, because cells of a picture are even.

    Taken for it is what cells of twice the side make: the integral of |T| |S - S'|, S and S' the
    transforms of both pictures. Finer cells err by half of it or less.
    """
    band = blur.band_limit(BAND_FLOOR)
    step = band / STEPS
    fy = np.linspace(-band + 0.5 * step, band - 0.5 * step, 2 * STEPS)
    fx = fy[STEPS:]
    apart = np.abs(_transform(fine, fy, fx) - _transform(coarser(fine), fy, fx))
    size = np.abs(blur.transfer(fy[:, None], fx[None, :]))
    return float(2.0 * step * step * np.sum(size * apart))


def _transform(body: Picture, fy: Array, fx: Array) -> NDArray[np.complex128]:
    """Fourier transform of a picture at frequencies [cycles/px]: (len(fy), len(fx))."""
    h = body.side_px
    y, x = ((np.arange(n) - c) * h for n, c in zip(body.shares.shape, body.centre, strict=True))
    down, along = (np.exp(-2j * np.pi * np.outer(f, at)) for f, at in ((fy, y), (fx, x)))
    even = np.sinc(fy * h)[:, None] * np.sinc(fx * h)[None, :]
    return np.asarray((down @ body.shares @ along.T) * even)
