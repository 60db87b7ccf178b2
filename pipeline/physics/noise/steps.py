"""What a detector does to light and charge: one tuple of steps, in the order of the hardware.

Light passes the first two, layer by layer; what a frame holds is read out a few rows at a time.
Calibration undoes the same steps from the last to the first. A step whose term is absent changes
nothing. The full well clips before the read noise; cosmic rays are drawn charge, so that no photon
noise is drawn from them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.noise.converter import digitise
from pipeline.physics.noise.streams import poisson_image, standard_normals
from pipeline.physics.noise.terms import Array, Chain, Readout
from pipeline.physics.noise.transfer import lagged_e, smear_e
from pipeline.physics.noise.wells import bloom, collected_e, measured_e


class Step(NamedTuple):
    """One effect of the detector.

    apply : (ny, nx) light, charge [e-] or level [DN] to the same after it, in place where it may;
    undo : what calibration does in return, None where nothing can be done
    """

    name: str
    apply: Callable[[Array, Readout], NDArray]
    undo: Callable[[Array, Chain], Array] | None = None


def _flat(light_e: Array, of: Readout) -> Array:
    flat = of.chain.flat
    return light_e if np.ndim(flat) == 0 and flat == 1.0 else light_e * flat


def _without_flat(signal_e: Array, chain: Chain) -> Array:
    """NaN where no light comes through."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.asarray(chain.flat) > 0, signal_e / chain.flat, np.nan)


def _smear(light_e: Array, of: Readout) -> Array:
    return light_e if of.chain.smear is None else light_e + smear_e(light_e, *of.chain.smear)


def _dark(mean_e: Array, of: Readout) -> Array:
    return mean_e + of.chain.dark_e


def _without_dark(signal_e: Array, chain: Chain) -> Array:
    return signal_e - chain.dark_e


def _lag(mean_e: Array, of: Readout) -> Array:
    return lagged_e([*of.before_e, mean_e], of.chain.lag) if of.chain.lag else mean_e


def _photon_noise(mean_e: Array, of: Readout) -> Array:
    if not of.chain.photon_noise:
        return mean_e.copy()
    return poisson_image(np.ascontiguousarray(mean_e), *of.at.first, *of.at.photon_key)


def _cosmic_rays(charge_e: Array, of: Readout) -> Array:
    read_e = of.read_e
    if read_e is not None:
        charge_e += read_e
    return charge_e


def _blooming(charge_e: Array, of: Readout) -> Array:
    if of.chain.blooming:
        bloom(charge_e, np.broadcast_to(np.asarray(of.chain.well_e, float), charge_e.shape))
    return charge_e


def _full_well(charge_e: Array, of: Readout) -> Array:
    return np.minimum(charge_e, of.chain.well_e, out=charge_e)


def _nonlinearity(charge_e: Array, of: Readout) -> Array:
    linearity = of.chain.linearity
    return charge_e if linearity is None else measured_e(charge_e, *linearity)


def _linear(signal_e: Array, chain: Chain) -> Array:
    return signal_e if chain.linearity is None else collected_e(signal_e, *chain.linearity)


def _read_noise(charge_e: Array, of: Readout) -> Array:
    if of.chain.is_noisy:
        rows, columns = charge_e.shape
        draws = standard_normals(rows, columns, *of.at.first, *of.at.read_key)
        charge_e += draws * of.chain.read_noise_e
    return charge_e


def _row_noise(charge_e: Array, of: Readout) -> Array:
    place, sigma_e = of.at, of.chain.row_noise_e
    if place.row_key is not None and sigma_e > 0:
        draws = standard_normals(len(charge_e), 1, place.y0, 0, place.frame, *place.row_key)
        charge_e += draws * sigma_e
    return charge_e


def _column_noise(charge_e: Array, of: Readout) -> Array:
    if of.column_e is not None:
        charge_e += of.column_e
    return charge_e


def _gain(charge_e: Array, of: Readout) -> Array:
    charge_e /= of.chain.gain_e_per_dn
    return charge_e


def _without_gain(signal_dn: Array, chain: Chain) -> Array:
    return signal_dn * chain.gain_e_per_dn


def _converter(signal_dn: Array, of: Readout) -> NDArray[np.integer]:
    return digitise(signal_dn, of.chain.bias_dn, of.chain.adc_bits, of.chain.rounding)


def _without_bias(dn: Array, chain: Chain) -> Array:
    """Half a DN is added where the converter rounds down."""
    half = 0.5 if chain.rounding == "floor" else 0.0
    return dn.astype(np.float64) + half - chain.bias_dn


def _bad_pixels(dn: Array, of: Readout) -> Array:
    if of.chain.bad is not None:
        y, x, value = of.chain.bad
        dn[y, x] = value.astype(dn.dtype)
    return dn


def _masked(dn: Array, chain: Chain) -> Array:
    out = dn.astype(np.float64)
    if chain.bad is not None:
        out[chain.bad[0], chain.bad[1]] = np.nan
    return out


FLAT, SMEAR, LAG = Step("flat", _flat, _without_flat), Step("smear", _smear), Step("lag", _lag)
DARK = Step("dark", _dark, _without_dark)
READ_NOISE = Step("read_noise", _read_noise)
DETECTOR = (
    FLAT,
    SMEAR,
    DARK,
    LAG,
    Step("photon_noise", _photon_noise),
    Step("cosmic_rays", _cosmic_rays),
    Step("blooming", _blooming),
    Step("full_well", _full_well),
    Step("nonlinearity", _nonlinearity, _linear),
    READ_NOISE,
    Step("row_noise", _row_noise),
    Step("column_noise", _column_noise),
    Step("gain", _gain, _without_gain),
    Step("converter", _converter, _without_bias),
    Step("bad_pixels", _bad_pixels, _masked),
)
READ_OUT = DETECTOR[DETECTOR.index(LAG) + 1 :]  # from the mean of what a frame holds
AFTER_NOISE = DETECTOR[DETECTOR.index(READ_NOISE) + 1 :]
