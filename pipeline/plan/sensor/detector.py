"""Numbers of a detector on which a plan rests: its noise, and how far back its lag reaches."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pipeline.arrays import Array, SensorMaps
from pipeline.physics.noise.transfer import lag_frames
from pipeline.physics.noise.wells import collected_e, measured_e
from pipeline.plan.accuracy import SMALL, part_sigma
from pipeline.plan.facts import Terms, floor_e2
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.detector import Detector, PolynomialResponse
from pipeline.spec.sensor.sensor import Sensor

QUIET = 0.01  # of the pixels: whose noise drawing is planned for
LOOKED_AT = 4_000_000  # pixels of a large sensor
REACH = 8.0  # standard deviations of the photons that are looked at
KINDS = 1000.0  # between numbers of pixels as noisy, to half an octave: more than 20 REACH
SMALL_E = 1e4  # charge below which Poisson's law is summed, not a normal one
LINEARITY_POINTS = 4097  # of a polynomial; straight between them


def typical_read_noise_e(scene: Scene, maps: SensorMaps) -> float:
    """Noise of reading a pixel, with that of its row and its column [e-]."""
    return _with_lines_e(scene, maps.typical("read_noise_e"))


def _with_lines_e(scene: Scene, read_noise_e: float) -> float:
    d = scene.sensor.detector
    if d is None:
        return read_noise_e
    return math.hypot(read_noise_e, d.row_noise_e, d.column_noise_e)


def quiet_terms(scene: Scene, maps: SensorMaps) -> Terms:
    """Dark current [e-/s], noise of reading [e-] and gain of a pixel that is among the QUIET ones
    in the shortest exposure; the typical ones where their noise is less."""
    names = ("dark_e_per_s", "read_noise_e", "gain_e_per_dn")
    alone = [maps.typical(name) for name in names]
    typical = alone[0], typical_read_noise_e(scene, maps), alone[2]
    if not any(np.ndim(getattr(maps, name)) for name in names):
        return typical
    dark_e_s, read_e, gain = np.broadcast_arrays(*_some(scene, maps, names))
    each = floor_e2(scene, 0.0, (dark_e_s, read_e, gain))
    rank = int(QUIET * (each.size - 1))
    at = np.argpartition(each, rank)[rank]
    if each[at] >= floor_e2(scene, 0.0, alone):
        return typical
    return float(dark_e_s[at]), _with_lines_e(scene, float(read_e[at])), float(gain[at])


def converter_top_e(scene: Scene, maps: SensorMaps) -> float:
    """Signal of a typical pixel [e-] at the top of its converter (median)."""
    gain, bias = _some(scene, maps, ("gain_e_per_dn", "bias_dn"))
    return float(np.median((2.0**scene.sensor.adc_bits - 1.0 - bias) * gain))


def full_e(sensor: Sensor, gain_e_per_dn: Array | float, bias_dn: Array | float) -> Array:
    """Charge [e-] from which pixels are full: of their well, or at the converter's top."""
    top_e = (2.0**sensor.adc_bits - 1.0 - bias_dn) * gain_e_per_dn
    return np.minimum(collected_for(sensor, top_e), sensor.full_well_e or math.inf)


def full_share(scene: Scene, maps: SensorMaps, sky_e_s: float, time_s: float) -> float:
    """Which part of the pixels sky [e-/s] and dark current alone fill in an exposure."""
    names = ("flat", "dark_e_per_s", "gain_e_per_dn", "bias_dn")
    flat, dark, gain, bias = _some(scene, maps, names)
    return float(np.mean((flat * sky_e_s + dark) * time_s >= full_e(scene.sensor, gain, bias)))


def cut_off(scene: Scene, maps: SensorMaps, sky_e_s: float, time_s: float) -> tuple[float, float]:
    """Which part of the pixels the converter cuts off at 0 DN under sky [e-/s] and dark current
    alone in an exposure, and by how much that raises the mean signal of all [e-].

    Pixels as many standard deviations above 0 DN, to a tenth, and as noisy, to half an octave,
    count as one of their mean terms.
    """
    s, d = scene.sensor, scene.sensor.detector
    names = ("flat", "dark_e_per_s", "read_noise_e", "gain_e_per_dn", "bias_dn")
    flat, dark, read, gain, bias = map(np.atleast_1d, _some(scene, maps, names))
    if d is not None:
        read = np.hypot(read, math.hypot(d.row_noise_e, d.column_noise_e))
    half = 0.5 * gain * (s.adc_rounding == "half_even")  # less far below 0 DN is rounded to it
    charge, zero = (flat * sky_e_s + dark) * time_s, -bias * gain - half
    sigma = np.maximum(np.sqrt(charge * s.photon_noise + np.square(read)), 1e-9)
    above = np.clip((_signal_e(s, charge) - zero) / sigma, -REACH, REACH)
    kinds = np.rint(10.0 * above), np.rint(2.0 * np.log2(sigma))
    every = np.broadcast_arrays(*kinds, charge, np.square(read), zero, half)
    cut = every[0] < 10.0 * REACH  # of those REACH above none is
    tenths, octaves, *terms = (term[cut] for term in every)
    _, kind, count = np.unique(tenths + KINDS * octaves, return_inverse=True, return_counts=True)
    mean = [np.bincount(kind, term) / count for term in terms]
    share = more_e = 0.0
    for n, of_mean_e, read_e2, zero_e, half_e in np.stack([count, *mean], axis=1).tolist():
        below, cut_e = below_zero(s, of_mean_e, math.sqrt(read_e2), zero_e)
        share += below * n / cut.size
        more_e += (cut_e + half_e * below) * n / cut.size
    return share, more_e


def _some(scene: Scene, maps: SensorMaps, names: Sequence[str]) -> list[Array]:
    """Values of some maps in the same pixels, not all of a large sensor's; numbers as they are."""
    step = max(1, math.prod(scene.sensor.shape) // LOOKED_AT) | 1  # odd: no column by itself
    values = (np.asarray(getattr(maps, name)) for name in names)
    return [v.ravel()[::step] if v.ndim else v for v in values]


def below_zero(
    sensor: Sensor, mean_e: float, read_noise_e: float, zero_e: float
) -> tuple[float, float]:
    """Which part of the pixels of a mean charge the converter cuts off at 0 DN, and by how much
    that raises their mean signal [e-].

    read_noise_e : of a pixel, with row and column; zero_e : signal that reads 0
    """
    spread = REACH * math.sqrt(mean_e) * sensor.photon_noise
    low = max(0.0, mean_e - spread)
    if spread and mean_e < SMALL_E:
        charge = np.arange(math.floor(low), math.ceil(mean_e + spread) + REACH)
        factorial = np.array([math.lgamma(n + 1.0) for n in charge.tolist()])
        weight = np.exp(charge * math.log(mean_e) - mean_e - factorial)
    else:
        off = np.linspace(-1.0, 1.0, 401)
        charge, weight = mean_e + off * (mean_e - low), np.exp(-0.5 * (REACH * off) ** 2)
    signal = _signal_e(sensor, charge.astype(float))
    above = (signal - zero_e + 1e-6) / max(read_noise_e, 1e-9)  # a pixel at 0 DN lies not below
    share = np.array([0.5 * math.erfc(a / math.sqrt(2.0)) for a in above.tolist()])
    density = np.exp(-0.5 * above**2) / math.sqrt(2.0 * math.pi)
    cut_e = read_noise_e * density - (signal - zero_e) * share
    weight = weight / weight.sum()
    return float(weight @ share), float(weight @ cut_e)


def lag_depth(scene: Scene, sigma_e: float) -> int:
    """How many frames before leave charge in a frame that is worth drawing."""
    d = scene.sensor.detector
    if d is None or d.lag is None:
        return 0
    full_well_e = float(scene.sensor.full_well_e or 0.0)
    return lag_frames(d.lag.fraction, full_well_e, SMALL * part_sigma(scene) * sigma_e)


def _signal_e(sensor: Sensor, charge_e: Array) -> Array:
    """What is measured of charges (n,) [e-]."""
    d = sensor.detector
    if d is None or d.nonlinearity is None:
        return charge_e
    return measured_e(charge_e, *linearity(d, float(sensor.full_well_e or 0.0)))


def linearity(d: Detector, full_well_e: float) -> tuple[Array, Array]:
    """Tables of charge collected and charge measured [e-], from 0 to the full well or beyond."""
    given = d.nonlinearity
    if not isinstance(given, PolynomialResponse):
        assert given is not None
        return np.array(given.true_e), np.array(given.read_e)
    x = np.linspace(0.0, 1.0, LINEARITY_POINTS)
    bend = np.polynomial.Polynomial([0.0, 1.0, *given.coefficients])
    return full_well_e * x, full_well_e * bend(x)


def collected_for(sensor: Sensor, signal_e: Array | float) -> Array:
    """Charge (...) that is measured as signals (...) [e-]; infinite where none is."""
    signal = np.asarray(signal_e, float)
    d = sensor.detector
    if d is None or d.nonlinearity is None:
        return signal
    true_e, read_e = linearity(d, float(sensor.full_well_e or 0.0))
    charge = collected_e(np.atleast_1d(signal), true_e, read_e).reshape(signal.shape)
    return np.where(signal <= read_e[-1], charge, math.inf)
