"""The noise chain, in the paper's order: from mean electrons to digital numbers.

flat (light only) -> dark -> Poisson -> full well -> read noise -> gain -> bias -> ADC
(paper section 3.8; the full well has no step there and is clipped before the read noise).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.noise.streams import poisson_image, standard_normals

Array = NDArray[np.float64]
Value = float | Array

EXACT_BITS = 53  # digital numbers above 2^53 - 1 are counted in integers, not in float64


@dataclass(frozen=True)
class Chain:
    """The detector's terms for one tile: each a number or a (ny, nx) image of that tile.

    flat : response to light, dimensionless; dark_e : electrons in the integration time;
    full_well_e : None for no limit; read_noise_e : standard deviation, electrons;
    gain_e_per_dn : electrons per digital number; bias_dn : added before digitising;
    adc_bits : 1 to 63; rounding : "half_even" or "floor"; photon_noise : draw Poisson or not
    """

    flat: Value
    dark_e: Value
    full_well_e: Value | None
    read_noise_e: Value
    gain_e_per_dn: Value
    bias_dn: Value
    adc_bits: int
    rounding: str = "half_even"
    photon_noise: bool = True


@dataclass(frozen=True)
class StreamPlace:
    """Where in the random streams a tile stands: its first pixel, its frame, and the keys."""

    y0: int
    x0: int
    frame: int
    photon_key: tuple[int, int]
    read_key: tuple[int, int]


def mean_electrons(light_e: Array, chain: Chain) -> Array:
    """flat x light + dark: the mean that photon noise is drawn from [e-]."""
    return light_e * chain.flat + chain.dark_e


def to_dn(mean_e: Array, chain: Chain, place: StreamPlace) -> NDArray[np.integer]:
    """Digital numbers of a tile from its mean electrons (ny, nx).

    Raises ValueError on a mean that is not finite or is negative: no such frame is ever drawn.
    """
    if not np.isfinite(mean_e).all() or (mean_e < 0).any():
        raise ValueError("mean electrons must be finite and not negative")
    charge = mean_e
    if chain.photon_noise:
        charge = poisson_image(mean_e, place.y0, place.x0, place.frame, *place.photon_key)
    if chain.full_well_e is not None:
        charge = np.minimum(charge, chain.full_well_e)
    if np.any(np.asarray(chain.read_noise_e) > 0):
        draws = standard_normals(*mean_e.shape, place.y0, place.x0, place.frame, *place.read_key)
        charge = charge + draws * chain.read_noise_e
    return digitise(charge / chain.gain_e_per_dn, chain.bias_dn, chain.adc_bits, chain.rounding)


def digitise(
    signal_dn: Array, bias_dn: Value, adc_bits: int, rounding: str = "half_even"
) -> NDArray[np.integer]:
    """Add the bias, round and clip to 0 ... 2^N - 1; the smallest unsigned type that holds it.

    Above 53 bits the signal and the bias are rounded apart and added as integers, because float64
    holds no whole numbers there: 2^63 - 1 would round up to 2^63 and come back negative.
    """
    whole = np.rint if rounding == "half_even" else np.floor
    top = (1 << adc_bits) - 1
    if adc_bits <= EXACT_BITS:
        levels = np.clip(whole(signal_dn + bias_dn), 0.0, float(top))
        return levels.astype(dn_type(adc_bits))
    bias = np.broadcast_to(_to_integer(whole(np.asarray(bias_dn, float))), signal_dn.shape)
    total = _to_integer(whole(signal_dn))
    room = np.int64(np.iinfo(np.int64).max) - np.maximum(bias, 0)
    total = np.where(total > room, np.iinfo(np.int64).max, np.minimum(total, room) + bias)
    return np.clip(total, 0, top).astype(dn_type(adc_bits))


def dn_type(adc_bits: int) -> np.dtype[np.unsignedinteger]:
    """The smallest unsigned integer type that holds `adc_bits` bits."""
    size = next(s for s in (8, 16, 32, 64) if s >= adc_bits)
    return np.dtype(f"uint{size}")


def _to_integer(value: Array) -> NDArray[np.int64]:
    """float64 whole numbers as int64, saturating at both ends instead of wrapping."""
    limit = 2.0**63
    inside = np.clip(value, -limit, np.nextafter(limit, 0.0))
    return np.where(value >= limit, np.iinfo(np.int64).max, inside.astype(np.int64))
