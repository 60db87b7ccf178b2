"""The noise chain, in the paper's order: from mean electrons to digital numbers.

flat (light only) -> dark -> Poisson -> + cosmic rays -> full well -> read noise -> gain -> bias
-> ADC (paper section 3.8; the full well has no step there and is clipped before the read noise;
cosmic rays are drawn charge, so no photon noise is drawn from them).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.noise.streams import poisson_image, standard_normals

Array = NDArray[np.float64]
Value = float | Array

_INT64 = np.iinfo(np.int64)
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


def to_dn(
    mean_e: Array, chain: Chain, place: StreamPlace, drawn_e: Array | None = None
) -> NDArray[np.integer]:
    """Digital numbers of a tile from its mean electrons (ny, nx).

    drawn_e : (ny, nx) charge that is drawn already and has no photon noise (cosmic rays); it joins
    the photons' before the full well.

    Raises ValueError on a mean that is not finite or is negative: no such frame is ever drawn.
    """
    if not np.isfinite(mean_e).all() or (mean_e < 0).any():
        raise ValueError("mean electrons must be finite and not negative")
    charge = mean_e
    if chain.photon_noise:
        k0, k1 = place.photon_key
        charge = poisson_image(mean_e, place.y0, place.x0, place.frame, k0, k1)
    if drawn_e is not None:
        charge = charge + drawn_e
    if chain.full_well_e is not None:
        charge = np.minimum(charge, chain.full_well_e)
    if np.any(np.asarray(chain.read_noise_e) > 0):
        (rows, columns), (k0, k1) = mean_e.shape, place.read_key
        draws = standard_normals(rows, columns, place.y0, place.x0, place.frame, k0, k1)
        charge = charge + draws * chain.read_noise_e
    return digitise(charge / chain.gain_e_per_dn, chain.bias_dn, chain.adc_bits, chain.rounding)


def digitise(
    signal_dn: Array, bias_dn: Value, adc_bits: int, rounding: str = "half_even"
) -> NDArray[np.integer]:
    """Add the bias, round and clip to 0 ... 2^N - 1; the smallest unsigned type that holds it.

    Above 53 bits whole parts are added as integers and fractions apart, because float64 holds no
    whole numbers there: 2^63 - 1 would round up to 2^63 and come back negative.
    """
    top = (1 << adc_bits) - 1
    if adc_bits <= EXACT_BITS:
        whole = np.rint if rounding == "half_even" else np.floor
        levels = np.clip(whole(signal_dn + bias_dn), 0.0, float(top))
        return levels.astype(dn_type(adc_bits))
    signal, signal_rest = _whole_and_rest(signal_dn)
    bias, bias_rest = _whole_and_rest(np.broadcast_to(bias_dn, np.shape(signal_dn)))
    total, rest = _saturated_sum(signal, bias), signal_rest + bias_rest
    odd = (total & 1).astype(float)
    more = np.rint(odd + rest) - odd if rounding == "half_even" else np.floor(rest)
    total = np.where(total > _INT64.max - 2, total, total + more.astype(np.int64))
    full = signal_dn + bias_dn >= 2.0**63
    return np.where(full, top, np.clip(total, 0, top)).astype(dn_type(adc_bits))


def dn_type(adc_bits: int) -> np.dtype[np.unsignedinteger]:
    """The smallest unsigned integer type that holds `adc_bits` bits."""
    size = next(s for s in (8, 16, 32, 64) if s >= adc_bits)
    return np.dtype(f"uint{size}")


def _whole_and_rest(value: Array) -> tuple[NDArray[np.int64], Array]:
    """Largest whole number below, saturating at both ends of int64, and what is above it."""
    limit = 2.0**63
    inside = np.clip(np.asarray(value, float), -limit, limit)
    whole = np.floor(inside)
    safe = np.minimum(whole, np.nextafter(limit, 0.0)).astype(np.int64)
    return np.where(whole >= limit, _INT64.max, safe), inside - whole


def _saturated_sum(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """a + b, held at the ends of int64 instead of wrapping."""
    low, high = _INT64.min - np.minimum(b, 0), _INT64.max - np.maximum(b, 0)
    return np.clip(a, low, high) + b
