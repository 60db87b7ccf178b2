"""Point-spread functions over a band: a few wavelengths by Gauss quadrature, and their error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pipeline.physics.psf.aperture import Pupil
from pipeline.physics.psf.pupil import Airy, Blur, Optics, Transfer
from pipeline.physics.psf.radial import look_up, radial_table
from pipeline.physics.psf.seeing import Kolmogorov

Array = NDArray[np.float64]
Chromatic = Airy | Pupil | Kolmogorov

COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 12)  # of wavelengths, tried in this order
REFERENCE = 20  # wavelengths that stand for all of them
SAMPLES = 1024  # across, of responses that are compared
BAND_CELLS = 500  # that a response curve is cut into, besides its own points


@dataclass(frozen=True)
class Mixture:
    """Light of several wavelengths: the weighted sum of their point-spread functions."""

    parts: tuple[Chromatic, ...]
    weights: tuple[float, ...]

    def radial(self, f: Array) -> Array:
        """The round part of the transfer function along a radius."""
        both = zip(self.parts, self.weights, strict=True)
        return np.sum([w * p.radial(f) for p, w in both], axis=0)

    def transfer(self, fy: Array, fx: Array) -> Transfer:
        """Sum of the transfer functions; the round parts from one common table."""
        fy, fx = np.broadcast_arrays(np.asarray(fy, float), np.asarray(fx, float))
        top, values = radial_table(self)
        out: Transfer = look_up(np.hypot(fy, fx).ravel(), top, values).reshape(fy.shape)
        for part, weight in zip(self.parts, self.weights, strict=True):
            if isinstance(part, Pupil):
                out = out + weight * part.rest(fy, fx)
        return out

    def band_limit(self, floor: float) -> float:
        """The widest band of the parts."""
        return max(p.band_limit(floor) for p in self.parts)

    def light_beyond(self, radius_px: float) -> float:
        """Fraction of the light farther than `radius_px`."""
        both = zip(self.parts, self.weights, strict=True)
        return float(sum(w * p.light_beyond(radius_px) for p, w in both))

    @property
    def scale_px(self) -> float:
        return float(sum(w * p.scale_px for p, w in zip(self.parts, self.weights, strict=True)))

    @property
    def has_wings(self) -> bool:
        return any(p.has_wings for p in self.parts)

    @property
    def core_px(self) -> float:
        return max(p.core_px for p in self.parts)

    def wing_fall(self, radius_px: float) -> float:
        """Somewhat less than of one wavelength, for their rings beat (measured: 3.8 to 8)."""
        return max(1.0, 0.75 * min(p.wing_fall(radius_px) for p in self.parts))


@dataclass(frozen=True)
class BandOptics:
    """Optics for a band, and what was left out.

    optics : of one wavelength, or a Mixture
    wavelengths_m, weights : used
    error : largest difference of any pixel of a star to that of REFERENCE wavelengths, over its
        light; error_of_one : the same for the mean wavelength alone
    """

    optics: Optics
    wavelengths_m: tuple[float, ...]
    weights: tuple[float, ...]
    error: float
    error_of_one: float


def band_wavelengths(wavelength_m: Array, value: Array, count: int) -> tuple[Array, Array]:
    """Gauss quadrature of a band: (wavelengths (count,) [m], weights (count,) that sum to 1).

    wavelength_m, value : (n,) response per photon, linear in between. Exact for polynomials of
    the wavelength up to degree 2 count - 1 (Golub and Welsch 1969, by Stieltjes' recurrence on
    the response cut into BAND_CELLS). One wavelength is the mean.
    """
    even = np.linspace(wavelength_m[0], wavelength_m[-1], BAND_CELLS + 1)
    edges = np.union1d(even, wavelength_m)
    step, three = np.polynomial.legendre.leggauss(3)
    widths = 0.5 * np.diff(edges)[:, None]
    at = (0.5 * (edges[1:] + edges[:-1])[:, None] + widths * step).ravel()
    mass = np.interp(at, wavelength_m, value) * (widths * three).ravel()
    if not mass.sum() > 0.0:
        mass = (widths * three).ravel()
    mass = mass / mass.sum()
    middle, half = 0.5 * (edges[0] + edges[-1]), 0.5 * (edges[-1] - edges[0])
    x = (at - middle) / half
    count = min(count, int(np.count_nonzero(mass)))
    a, b = np.zeros(count), np.zeros(count)
    before, now, norm = np.zeros(x.size), np.ones(x.size), 1.0
    for k in range(count):
        a[k] = (mass * x * now * now).sum() / norm
        following = (x - a[k]) * now - b[k] * before
        new_norm = float((mass * following * following).sum())
        if k + 1 < count:
            b[k + 1] = new_norm / norm
        before, now, norm = now, following, new_norm
    off = np.sqrt(b[1:])
    nodes, vectors = np.linalg.eigh(np.diag(a) + np.diag(off, 1) + np.diag(off, -1))
    weights = vectors[0] ** 2
    return middle + half * nodes, weights / weights.sum()


def choose_wavelengths(
    make: Callable[[float], Chromatic],
    blur: Blur,
    wavelength_m: Array,
    value: Array,
    tolerance: float,
    count: int | None = None,
) -> BandOptics:
    """Fewest wavelengths whose star differs from the whole band's by at most `tolerance`.

    make : optics at a wavelength [m]; blur : what else blurs (its own optics are not looked at)
    tolerance : in any pixel, over the star's light
    count : use so many in any case

    The error is measured with the round parts of the optics, whose size is what the wavelength
    changes most.
    """

    def mixed(n: int, round_only: bool) -> tuple[Optics, Array, Array]:
        nodes, weights = band_wavelengths(wavelength_m, value, n)
        parts = tuple(make(float(w)) for w in nodes)
        if round_only:
            parts = tuple(p.annulus if isinstance(p, Pupil) else p for p in parts)
        optics = parts[0] if len(parts) == 1 else Mixture(parts, tuple(map(float, weights)))
        return optics, nodes, weights

    whole = replace(blur, optics=mixed(REFERENCE, True)[0])

    def error(n: int) -> float:
        return response_difference(replace(blur, optics=mixed(n, True)[0]), whole)

    errors = {1: error(1)}
    if count is None:
        for count in COUNTS:
            if errors.setdefault(count, errors.get(count) or error(count)) <= tolerance:
                break
    assert count is not None
    optics, nodes, weights = mixed(count, False)
    kept = errors.get(count)
    return BandOptics(
        optics, tuple(map(float, nodes)), tuple(map(float, weights)),
        error(count) if kept is None else kept, errors[1],
    )  # fmt: skip


def response_difference(one: Blur, other: Blur) -> float:
    """Largest difference of any pixel at any sub-pixel place, over the source's light.

    Both responses are sampled so finely that what lies between is within two percent (six times
    as finely as pixels, where that takes no more than SAMPLES); the light near the core decides,
    so that a field of some widths is enough.
    """
    band = max(one.band_limit(1e-3), other.band_limit(1e-3))
    scale = max(one.optics.scale_px, other.optics.scale_px, one.jitter_px, one.diffusion_px)
    period = int(np.ceil(10.0 * scale)) + 12
    finer = max(band, min(1.0, SAMPLES / (6.0 * period)))
    n = scipy.fft.next_fast_len(int(np.ceil(period * 6.0 * finer)))
    fy, fx = scipy.fft.fftfreq(n, period / n)[:, None], scipy.fft.rfftfreq(n, period / n)[None, :]
    difference = one.transfer(fy, fx) - other.transfer(fy, fx)
    return float(np.abs(scipy.fft.irfft2(difference, s=(n, n))).max()) * (n / period) ** 2
