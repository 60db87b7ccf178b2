"""From digital numbers back to electrons of light: less bias and dark, divided by the flat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.noise.chain import Chain
from pipeline.physics.noise.wells import collected_e

Array = NDArray[np.float64]


def calibrated_e(dn: NDArray[np.integer], chain: Chain) -> Array:
    """Electrons (ny, nx) that light left in each pixel, as the chain's own maps give them back.

    (dn - bias) x gain, the non-linearity undone, less the dark, over the flat; half a DN is added
    where the converter rounds down. The maps are the true ones, without noise of their own. NaN
    where nothing comes back: bad pixels and a flat of 0. Saturation, lag and smear stay.
    """
    half = 0.5 if chain.rounding == "floor" else 0.0
    signal = (dn.astype(np.float64) + half - chain.bias_dn) * chain.gain_e_per_dn
    if chain.linearity is not None:
        signal = collected_e(signal, *chain.linearity)
    signal = signal - chain.dark_e
    with np.errstate(divide="ignore", invalid="ignore"):
        out = np.where(np.asarray(chain.flat) > 0, signal / chain.flat, np.nan)
    if chain.bad is not None:
        out[chain.bad[0], chain.bad[1]] = np.nan
    return out
