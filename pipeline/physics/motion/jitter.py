"""Jitter from one-sided power spectra: the slow part as a sum of waves, the fast part as blur."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PER_OCTAVE, FEWEST = 24, 32  # bins of the frequency axis; in a narrow band
MOST_OCTAVES = 60.0
TAIL = 1e4  # a resonance is followed up to this many times its frequency: 1e-12 of its power
_GAUSS = np.polynomial.legendre.leggauss(8)
TOGETHER = 4096  # times of which waves are summed at once


@dataclass(frozen=True, eq=False)
class Spectrum:
    """One-sided spectral density s(f) [rad^2 / Hz] of each axis between low_hz and high_hz.

    rms_rad : what the density is scaled to over its band; None leaves it as it is
    knots_hz : places where it bends, which become edges of bins
    """

    density: Callable[[Array], Array]
    low_hz: float
    high_hz: float
    rms_rad: float | None = None
    knots_hz: tuple[float, ...] = ()


def white(rms_rad: float, low_hz: float, high_hz: float) -> Spectrum:
    """Constant density over a band."""
    return power_law(rms_rad, 0.0, low_hz, high_hz)


def power_law(rms_rad: float, exponent: float, low_hz: float, high_hz: float) -> Spectrum:
    """Density proportional to f^-exponent over a band."""
    return Spectrum(lambda f: (f / low_hz) ** -exponent, low_hz, high_hz, rms_rad)


def resonance(rms_rad: float, frequency_hz: float, damping: float) -> Spectrum:
    """Density of a damped mode driven by white noise: (4 z f0^3 / pi) / ((f0^2-f^2)^2+(2 z f0 f)^2)

    times the variance; its integral over all frequencies is one.
    """
    f0, z = frequency_hz, damping

    def density(f: Array) -> Array:
        r = f / f0
        return (4.0 * z / np.pi) / f0 / (((1.0 - r) * (1.0 + r)) ** 2 + (2.0 * z * r) ** 2)

    around = np.concatenate([[0.0], np.geomspace(0.1, 30.0, 24)]) * z
    knots = f0 * np.concatenate([1.0 - around[around < 0.9], 1.0 + around])
    scaled = Spectrum(lambda f: rms_rad**2 * density(f), f0 * 1e-6, f0 * TAIL, None)
    return Spectrum(scaled.density, scaled.low_hz, scaled.high_hz, None, tuple(np.unique(knots)))


def table(frequency_hz: Array, density: Array) -> Spectrum:
    """Power laws between the points of a table, constant where a value is 0; 0 outside."""
    f, s = np.asarray(frequency_hz, float), np.asarray(density, float)
    floor = s[s > 0].min() * 1e-30 if (s > 0).any() else 1.0

    def at(x: Array) -> Array:
        logs = np.interp(np.log(x), np.log(f), np.log(np.maximum(s, floor)))
        return np.where(np.any(s > 0), np.exp(logs), 0.0)

    return Spectrum(at, float(f[0]), float(f[-1]), None, tuple(float(v) for v in f))


@dataclass(frozen=True, eq=False)
class SpectrumBins:
    """A spectrum in bins of frequency: edges (n + 1,) [Hz], variance (n,) [rad^2] of each."""

    edge_hz: Array
    variance: Array

    @property
    def middle_hz(self) -> Array:
        return 0.5 * (self.edge_hz[1:] + self.edge_hz[:-1])


def bins_of(spectrum: Spectrum, split_hz: float) -> SpectrumBins:
    """Bins of a spectrum, `split_hz` among their edges; variances by 8-point Gauss-Legendre."""
    low, high = spectrum.low_hz, spectrum.high_hz
    octaves = np.log2(high / low)
    count = max(FEWEST, int(np.ceil(PER_OCTAVE * min(octaves, MOST_OCTAVES))))
    inner = [*spectrum.knots_hz, split_hz]
    edge = np.concatenate([np.geomspace(low, high, count + 1)[1:-1], inner])
    edge = np.unique(np.concatenate([[low], edge[(edge > low) & (edge < high)], [high]]))
    half, middle = 0.5 * np.diff(edge), 0.5 * (edge[1:] + edge[:-1])
    node, weight = _GAUSS
    variance = half * (spectrum.density(middle[:, None] + half[:, None] * node) @ weight)
    if spectrum.rms_rad is not None:
        variance = variance * (spectrum.rms_rad**2 / variance.sum())
    return SpectrumBins(edge, variance)


@dataclass(frozen=True)
class FastPart:
    """What is faster than the split, as blur.

    variance : of each axis [rad^2]; mean_variance : of its mean over an exposure, which blur
    leaves out; scatter : relative rms change of the blur's variance from exposure to exposure
    """

    variance: float
    mean_variance: float
    scatter: float


def fast_part(bins: SpectrumBins, split_hz: float, exposure_s: float) -> FastPart:
    """The part of a spectrum above `split_hz`, for exposures of `exposure_s`.

    The mean of a wave over T is at most 1 / (pi f T) of it (half of that squared on average over
    phases is not used: an upper bound). Var[mean of x^2] = int s^2 df / T for a Gaussian process.
    """
    fast = bins.edge_hz[:-1] >= split_hz
    f, v, width = bins.middle_hz[fast], bins.variance[fast], np.diff(bins.edge_hz)[fast]
    total = float(v.sum())
    if total <= 0.0:
        return FastPart(0.0, 0.0, 0.0)
    mean = float((v * np.minimum(1.0, 1.0 / (np.pi * f * exposure_s)) ** 2).sum())
    square = float((v**2 / width).sum()) / exposure_s
    return FastPart(total, mean, float(np.sqrt(square)) / total)


@dataclass(frozen=True, eq=False)
class Waves:
    """Slow jitter: sum of cosine cos(w t) + sine sin(w t) for x and y.

    frequency_hz : (n,); cosine, sine : (n, 2) [rad]
    """

    frequency_hz: Array
    cosine: Array
    sine: Array

    def at(self, t_s: Array) -> Array:
        """Displacements (n, 2) [rad] at times (n,), in a fixed order of sums."""
        out = np.zeros((2, len(t_s)))
        for first in range(0, len(t_s), TOGETHER):  # as many as stay in a processor's cache
            some, part = t_s[first : first + TOGETHER], out[:, first : first + TOGETHER]
            for f, c, s in zip(self.frequency_hz, self.cosine, self.sine, strict=True):
                turns = f * some
                angle = 2.0 * np.pi * (turns - np.floor(turns))
                cosine, sine = np.cos(angle), np.sin(angle)
                part[0] += cosine * c[0] + sine * s[0]
                part[1] += cosine * c[1] + sine * s[1]
        return out.T


def waves(bins: SpectrumBins, split_hz: float, normals: Array, shares: Array) -> Waves:
    """A random run of the part below `split_hz`: one wave a bin, of its variance and random phase.

    So each run has the spectrum and the rms that were asked for, and at any moment a sum of many
    waves, near to Gaussian (Shinozuka & Deodatis 1991, Appl. Mech. Rev. 44, 191).

    normals : (bins, 4) standard normal draws, whose directions (0 with 2, 1 with 3) are the phases
    shares : (bins,) in (0, 1), where in its bin a wave lies, so that no period repeats
    """
    slow = bins.edge_hz[:-1] < split_hz
    f = bins.edge_hz[:-1] + shares[: len(bins.variance)] * np.diff(bins.edge_hz)
    keep = slow & (bins.variance > 0.0)
    cosine, sine = normals[: len(keep)][keep, :2], normals[: len(keep)][keep, 2:]
    size = np.sqrt(2.0 * bins.variance[keep])[:, None] / np.hypot(cosine, sine)
    return Waves(f[keep], size * cosine, size * sine)


def bend_variance(bins: SpectrumBins, split_hz: float, step_s: float) -> float:
    """Mean square [rad^2] of how far the slow part is from straight lines between nodes h apart.

    Of a wave (w h)^4 / 120 of its variance, less in higher orders: the mean square of the parabola
    x'' t (h - t) / 2.
    """
    slow = bins.edge_hz[:-1] < split_hz
    f, v = bins.middle_hz[slow], bins.variance[slow]
    return float((v * (2.0 * np.pi * f * step_s) ** 4 / 120.0).sum())
