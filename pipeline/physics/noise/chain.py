"""The detector's steps as a frame takes them: its layers, what it holds, its digital numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.noise.converter import dn_type
from pipeline.physics.noise.joint import measured_image
from pipeline.physics.noise.steps import AFTER_NOISE, DARK, DETECTOR, FLAT, LAG, READ_OUT, SMEAR
from pipeline.physics.noise.streams import standard_normals
from pipeline.physics.noise.terms import Array, Chain, Readout, StreamPlace, Value

BAND_PX = 1 << 15  # pixels that go through the whole chain while they are in the cache


def layers_e(light_e: dict[str, Array], chain: Chain, shape: tuple[int, int]) -> dict[str, Array]:
    """Mean charge by layer [e-], each of a tile's `shape`: of the light (an image, or one for all
    pixels) after flat and smear, and of the dark current where there is any."""
    of, layers = Readout(chain), {}
    for name, light in light_e.items():
        layers[name] = SMEAR.apply(np.broadcast_to(FLAT.apply(light, of), shape), of)
    if np.any(chain.dark_e):
        layers["dark_e"] = np.broadcast_to(DARK.apply(np.zeros(()), of), shape)
    return layers


def read_mean_e(mean_e: Array, before_e: Sequence[Array], chain: Chain) -> Array:
    """Mean of what is read of a frame (ny, nx) [e-]: less than it holds, and some of the frames
    before (`held_e`, the earliest first)."""
    return LAG.apply(mean_e, Readout(chain, before_e=before_e))


def held_e(mean_e: Array, drawn_e: Array | None, chain: Chain) -> Array:
    """What the pixels of a frame hold when it is read [e-], as the frames after see it."""
    charge = mean_e if drawn_e is None else mean_e + drawn_e
    return charge if chain.full_well_e is None else np.minimum(charge, chain.full_well_e)


def to_dn(
    mean_e: Array, chain: Chain, place: StreamPlace, drawn_e: Array | None = None
) -> NDArray[np.integer]:
    """Digital numbers of a tile from its mean electrons (ny, nx).

    drawn_e : (ny, nx) charge that is drawn already and has no photon noise (cosmic rays); it joins
    the photons' before the full well.

    Raises ValueError on a mean that is not finite or is negative: no such frame is ever drawn.
    """
    rows, columns = mean_e.shape
    step = rows if chain.blooming else max(1, BAND_PX // max(1, columns))
    out = np.empty(mean_e.shape, dn_type(chain.adc_bits))
    column_e = _column_noise_e(chain, place, columns)
    for start in range(0, rows, step):
        part = slice(start, min(start + step, rows))
        if not (mean_e[part].min(initial=0.0) >= 0.0 and mean_e[part].max(initial=0.0) < np.inf):
            raise ValueError("mean electrons must be finite and not negative")
        drawn = None if drawn_e is None else drawn_e[part]
        of = Readout(chain.of_rows(part), replace(place, y0=place.y0 + start), drawn, column_e)
        out[part] = _read_out(mean_e[part], of)
    return out


def _read_out(mean_e: Array, of: Readout) -> NDArray:
    """The steps of the read-out; photon and read noise in one draw where nothing is between."""
    signal, steps = mean_e, READ_OUT
    if of.chain.is_joint:
        signal, steps = _measured_e(mean_e, of), AFTER_NOISE
    for step in steps:
        signal = step.apply(signal, of)
    return signal


def _measured_e(mean_e: Array, of: Readout) -> Array:
    """The steps from photon to read noise as one compiled pass [e-]."""
    columns, at = mean_e.shape[1], of.at
    read_e = of.read_e
    terms = (0.0 if read_e is None else read_e, of.chain.well_e, of.chain.read_noise_e)
    drawn, well, read = (_row_wise(term, columns) for term in terms)
    keys = at.joint_key, at.photon_key, at.read_key
    mean = np.ascontiguousarray(mean_e)
    return np.asarray(measured_image(mean, drawn, well, read, *at.first, *keys))


def _row_wise(value: Value, columns: int) -> Array:
    """An image, or one row (1, columns) that serves them all."""
    cut = np.asarray(value, float)
    return np.ascontiguousarray(cut) if cut.ndim else np.full((1, columns), cut)


def _column_noise_e(chain: Chain, place: StreamPlace, columns: int) -> Array | None:
    """Column noise (1, columns) of a tile [e-], the same in all its rows."""
    if place.column_key is None or not chain.column_noise_e > 0:
        return None
    draws = standard_normals(1, columns, 0, place.x0, place.frame, *place.column_key)
    return np.asarray(draws * chain.column_noise_e)


def calibrated_e(dn: NDArray[np.integer], chain: Chain) -> Array:
    """Electrons (ny, nx) that light left in each pixel, as the chain's own terms give them back.

    The steps undone, from the last to the first: (dn - bias) x gain, the non-linearity, less the
    dark, over the flat. The terms are the true ones, without noise of their own. NaN where nothing
    comes back: bad pixels and a flat of 0. Saturation, lag and smear stay.
    """
    signal: NDArray = dn
    for step in reversed(DETECTOR):
        signal = signal if step.undo is None else step.undo(signal, chain)
    return signal


def noise_e(mean_e: Array, chain: Chain, part: tuple[slice, slice]) -> Array:
    """Noise of some pixels of a tile: of photons, of reading, of rounding [e-]."""

    def squared(value: float | Array) -> float | Array:
        return np.square(value[part] if isinstance(value, np.ndarray) else value)

    photons = mean_e[part] if chain.photon_noise else np.zeros_like(mean_e[part])
    floor = squared(chain.read_noise_e) + squared(chain.gain_e_per_dn) / 12.0
    floor += chain.row_noise_e**2 + chain.column_noise_e**2
    return np.sqrt(photons + floor)
