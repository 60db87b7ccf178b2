"""The noise chain, in the order of the hardware: from mean electrons to digital numbers.

flat (light only) -> dark -> Poisson -> + cosmic rays -> blooming -> full well -> non-linearity ->
read noise -> row and column noise -> gain -> bias -> ADC -> bad pixels. The full
well clips before the read noise; cosmic rays are drawn charge, so no photon noise is drawn from
them. What a chain does not have costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.noise.joint import measured_image
from pipeline.physics.noise.streams import poisson_image, standard_normals
from pipeline.physics.noise.wells import bloom, measured_e

Array = NDArray[np.float64]
Value = float | Array

_INT64 = np.iinfo(np.int64)
BAND_PX = 1 << 15  # pixels that go through the whole chain while they are in the cache
EXACT_BITS = 40  # above, a float64 holds too few binary places beside the whole number


@dataclass(frozen=True)
class Chain:
    """The detector's terms for one tile: each a number or a (ny, nx) image of that tile.

    flat : response to light, dimensionless; dark_e : electrons in the integration time;
    full_well_e : None for no limit; read_noise_e : standard deviation, electrons;
    gain_e_per_dn : electrons per digital number; bias_dn : added before digitising;
    adc_bits : 1 to 63; rounding : "half_even" or "floor"; photon_noise : draw Poisson or not
    linearity : charge collected and charge measured [e-], increasing tables, straight between;
    blooming : charge above the full well runs along its column; the tile must hold whole columns
    row_noise_e, column_noise_e : one draw for a row or column of a frame, electrons
    bad : rows, columns (in the tile) and the DN of pixels that read the same in every frame
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
    linearity: tuple[Array, Array] | None = None
    blooming: bool = False
    row_noise_e: float = 0.0
    column_noise_e: float = 0.0
    bad: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]] | None = None

    @property
    def is_joint(self) -> bool:
        """Whether nothing but the full well is between photon and read noise."""
        return self.photon_noise and self.linearity is None and not self.blooming


@dataclass(frozen=True)
class StreamPlace:
    """Where in the random streams a tile stands: its first pixel, its frame, and the keys.

    row_key, column_key : of the row and the column noise; None where there is none
    """

    y0: int
    x0: int
    frame: int
    photon_key: tuple[int, int]
    read_key: tuple[int, int]
    joint_key: tuple[int, int]
    row_key: tuple[int, int] | None = None
    column_key: tuple[int, int] | None = None


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
    low, high = mean_e.min(initial=0.0), mean_e.max(initial=0.0)
    if not (low >= 0.0 and high < np.inf):
        raise ValueError("mean electrons must be finite and not negative")
    rows, columns = mean_e.shape
    step = rows if chain.blooming else max(1, BAND_PX // max(1, columns))
    out = np.empty(mean_e.shape, dn_type(chain.adc_bits))
    offsets = _offsets_e(chain, place, rows, columns)
    for start in range(0, rows, step):
        part = slice(start, min(start + step, rows))
        signal = _measured_e(
            mean_e[part],
            None if drawn_e is None else drawn_e[part],
            chain,
            replace(place, y0=place.y0 + start),
            part,
        )
        for offset in offsets:
            signal += offset if offset.shape[0] == 1 else offset[part]
        signal /= _cut_value(chain.gain_e_per_dn, part)
        bias = _cut_value(chain.bias_dn, part)
        out[part] = digitise(signal, bias, chain.adc_bits, chain.rounding)
    if chain.bad is not None:
        out[chain.bad[0], chain.bad[1]] = chain.bad[2].astype(out.dtype)
    return out


def _cut_value(value: Value, rows: slice) -> Value:
    return value[rows] if isinstance(value, np.ndarray) else value


def _measured_e(
    mean_e: Array, drawn_e: Array | None, chain: Chain, place: StreamPlace, part: slice
) -> Array:
    """What the read-out makes of rows `part` of a tile: photon noise, full well, non-linearity and
    read noise; `place` of their first pixel."""
    mean_e = np.ascontiguousarray(mean_e)  # one compiled form is enough
    (rows, columns), at = mean_e.shape, (place.y0, place.x0, place.frame)
    read_e = _cut_value(chain.read_noise_e, part)
    well_e = _cut_value(np.inf if chain.full_well_e is None else chain.full_well_e, part)
    noisy = bool(np.any(np.asarray(read_e) > 0))
    if noisy and chain.is_joint:
        drawn = _row_wise(0.0 if drawn_e is None else drawn_e, columns)
        well, read = _row_wise(well_e, columns), _row_wise(read_e, columns)
        keys = place.joint_key, place.photon_key, place.read_key
        return np.asarray(measured_image(mean_e, drawn, well, read, *at, *keys))
    charge = poisson_image(mean_e, *at, *place.photon_key) if chain.photon_noise else mean_e.copy()
    if drawn_e is not None:
        charge += drawn_e
    if chain.blooming:
        bloom(charge, np.broadcast_to(np.asarray(well_e, float), charge.shape))
    np.minimum(charge, well_e, out=charge)
    if chain.linearity is not None:
        charge = measured_e(charge, *chain.linearity)
    if noisy:
        charge += standard_normals(rows, columns, *at, *place.read_key) * read_e
    return charge


def _row_wise(value: Value, columns: int) -> Array:
    """An image, or one row (1, columns) that serves them all."""
    cut = np.asarray(value, float)
    return np.ascontiguousarray(cut) if cut.ndim else np.full((1, columns), cut)


def _offsets_e(chain: Chain, place: StreamPlace, rows: int, columns: int) -> list[Array]:
    """Row noise (rows, 1) and column noise (1, columns) of a tile [e-], where there is any."""
    out = []
    if place.row_key is not None and chain.row_noise_e > 0:
        draws = standard_normals(rows, 1, place.y0, 0, place.frame, *place.row_key)
        out.append(draws * chain.row_noise_e)
    if place.column_key is not None and chain.column_noise_e > 0:
        draws = standard_normals(1, columns, 0, place.x0, place.frame, *place.column_key)
        out.append(draws * chain.column_noise_e)
    return out


def digitise(
    signal_dn: Array, bias_dn: Value, adc_bits: int, rounding: str = "half_even"
) -> NDArray[np.integer]:
    """Add the bias, round and clip to 0 ... 2^N - 1; the smallest unsigned type that holds it.

    Above 40 bits whole parts are added as integers and fractions apart: a float64 holds too few
    binary places beside such numbers, and 2^63 - 1 would round up to 2^63 and come back negative.
    """
    top = (1 << adc_bits) - 1
    if adc_bits <= EXACT_BITS:
        levels = np.asarray(signal_dn + bias_dn)
        (np.rint if rounding == "half_even" else np.floor)(levels, out=levels)
        np.clip(levels, 0.0, float(top), out=levels)
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
