"""Point-spread functions over a band: a few wavelengths by Gauss quadrature, and their error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.physics.constants import BOLTZMANN_J_K, PLANCK_J_S, SPEED_OF_LIGHT_M_S
from pipeline.physics.fast_sizes import fast_size
from pipeline.physics.psf.aperture import Pupil
from pipeline.physics.psf.pupil import Airy, Blur, Optics, Transfer
from pipeline.physics.psf.radial import look_up, radial_table
from pipeline.physics.psf.seeing import Kolmogorov

Array = NDArray[np.float64]
Chromatic = Airy | Pupil | Kolmogorov

COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20)  # of wavelengths, tried in this order
MANY = (40, 80, 160, 320)  # and of round optics, which cost a table along a radius alone
REFERENCE = 32  # wavelengths that stand for all of them; for more, twice as many
PANEL = 8  # of many wavelengths: nodes of Gauss and Legendre in each of as many even panels
WIDTHS, MOST_WIDTHS = 10.0, 80.0  # of the response: the field over which two are compared
SAMPLES = 1024  # across, of responses that are compared
COLOURS_K = (3000.0, 12000.0)  # of M5 and B8 stars: redder and bluer ones are few
BAND_CELLS = 500  # that a response curve is cut into, besides its own points


@dataclass(frozen=True)
class Mixture:
    """Light of several wavelengths: the weighted sum of their point-spread functions."""

    parts: tuple[Chromatic, ...]
    weights: tuple[float, ...]

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """Worked out once: responses are the keys of many caches."""
        return hash((self.parts, self.weights))

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


def mixture(parts: tuple[Chromatic, ...], weights: tuple[float, ...]) -> Optics:
    """The optics of a band from those of its wavelengths."""
    return parts[0] if len(parts) == 1 else Mixture(parts, weights)


@dataclass(frozen=True)
class NoiseLimit:
    """The error that a pixel may have beside a source, in units of that pixel's noise.

    light_e : of the brightest source; floor_e : noise of a pixel without sources; sigma : the error
    that is allowed, over the noise of floor and light together, or (not photons) of floor alone
    """

    light_e: float
    floor_e: float
    sigma: float
    photons: bool = True

    def error_sigma(self, difference: Array, response: Array) -> float:
        """Largest error in units of noise where responses per unit light differ so much."""
        light_e = self.light_e if self.photons else 0.0
        noise_e = np.sqrt(self.floor_e**2 + light_e * np.maximum(response, 0.0))
        return float((self.light_e * np.abs(difference) / noise_e).max())

    @property
    def widths(self) -> float:
        """How many of its widths from a source on a pixel's light is lost in the noise.

        Diffraction's light falls as the cube of the distance, a tenth of it or less at one width.
        """
        seen = 0.1 * self.light_e / max(self.sigma * self.floor_e, 1e-30)
        return 2.0 * min(seen, MOST_WIDTHS**3) ** (1.0 / 3.0)


@dataclass(frozen=True)
class BandOptics:
    """Optics for a band, and what was omitted.

    optics : of one wavelength, or a Mixture
    wavelengths_m, weights : used
    error : largest difference of any pixel of a star to that of REFERENCE wavelengths, over its
        light; error_of_one : the same for the mean wavelength alone
    error_sigma : largest error beside the brightest source of a NoiseLimit, over the noise there
    error_of_colours : of stars as black bodies of the temperatures COLOURS_K, drawn as one whose
        photons are spread evenly over the band: over their light, as `error`
    """

    optics: Optics
    wavelengths_m: tuple[float, ...]
    weights: tuple[float, ...]
    error: float
    error_of_one: float
    error_sigma: float = 0.0
    error_of_colours: tuple[float, ...] = (0.0, 0.0)


def band_wavelengths(wavelength_m: Array, value: Array, count: int) -> tuple[Array, Array]:
    """Gauss quadrature of a band: (wavelengths (count,) [m], weights (count,) that sum to 1).

    wavelength_m, value : (n,) response per photon, linear in between. Exact for polynomials of
    the wavelength up to degree 2 count - 1 (Golub and Welsch 1969, by Stieltjes' recurrence on
    the response cut into BAND_CELLS). One wavelength is the mean.
    """
    edges = _cells(wavelength_m)
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
    if count > REFERENCE:
        return _in_panels(wavelength_m, value, count)
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


def _cells(wavelength_m: Array) -> Array:
    """The edges of so small parts of a band that a curve and a spectrum are straight in each."""
    even = np.linspace(wavelength_m[0], wavelength_m[-1], BAND_CELLS + 1)
    edges: Array = np.union1d(even, wavelength_m)
    return edges


def _in_panels(wavelength_m: Array, value: Array, count: int) -> tuple[Array, Array]:
    """Many wavelengths: PANEL nodes in each of count / PANEL panels, for recurrences that long
    lose their digits."""
    edges = np.linspace(wavelength_m[0], wavelength_m[-1], count // PANEL + 1)
    step, weight = np.polynomial.legendre.leggauss(PANEL)
    half = 0.5 * np.diff(edges)[:, None]
    at = (0.5 * (edges[1:] + edges[:-1])[:, None] + half * step).ravel()
    mass = np.interp(at, wavelength_m, value) * (half * weight).ravel()
    kept = mass > 0.0
    return at[kept], mass[kept] / mass[kept].sum()


def choose_wavelengths(
    make: Callable[[float], Chromatic],
    blur: Blur,
    wavelength_m: Array,
    value: Array,
    tolerance: float,
    count: int | None = None,
    limit: NoiseLimit | None = None,
) -> BandOptics:
    """Fewest wavelengths whose star differs from the whole band's by at most `tolerance`.

    make : optics at a wavelength [m]; blur : what else blurs (its own optics are not looked at)
    tolerance : in any pixel, over the star's light
    count : use so many in any case
    limit : what the brightest source may err by; None where nothing is known of it

    The error is measured with the round parts of the optics, whose size is what the wavelength
    changes most.
    """
    mixed = partial(_mixed, make, wavelength_m, value)
    round_ = not isinstance(make(float(wavelength_m[0])), Pupil)
    counts = COUNTS + MANY if round_ and limit is not None else COUNTS
    widths = WIDTHS if limit is None else min(max(WIDTHS, limit.widths), MOST_WIDTHS)

    @cache
    def field(n: int) -> _Field:
        """The whole band's light, by n wavelengths."""
        return _Field(replace(blur, optics=mixed(n, True)[0]), widths)

    @cache
    def errors(n: int) -> tuple[float, float]:
        """Of n wavelengths: over the light, and beside the brightest source over the noise."""
        whole = field(2 * n if n in MANY else REFERENCE)
        difference = whole.difference(replace(blur, optics=mixed(n, True)[0]))
        light = whole.light
        beside = 0.0 if limit is None else limit.error_sigma(difference, light)
        return float(np.abs(difference).max()), beside

    def of_colour(kelvin: float) -> float:
        """How far the response of a black body is from the whole band's, over the light."""
        at = _cells(wavelength_m)
        photons = np.interp(at, wavelength_m, value) * black_body_photons(at, kelvin)
        parts = _mixed(make, at, photons, REFERENCE, True)[0]
        return float(np.abs(field(REFERENCE).difference(replace(blur, optics=parts))).max())

    def enough(n: int) -> bool:
        of_light, of_noise = errors(n)
        return of_light <= tolerance and (limit is None or of_noise <= limit.sigma)

    if count is None:
        count = counts[_first(lambda i: enough(counts[i]), len(counts) - 1)]
    optics, nodes, weights = mixed(count, False)
    error, error_sigma = errors(count)
    return BandOptics(
        optics,
        tuple(map(float, nodes)),
        tuple(map(float, weights)),
        error,
        errors(1)[0],
        error_sigma,
        tuple(of_colour(kelvin) for kelvin in COLOURS_K),
    )


def black_body_photons(wavelength_m: Array, kelvin: float) -> Array:
    """Photons of a black body by wavelength, not scaled (Planck's law over the photon's energy)."""
    x = PLANCK_J_S * SPEED_OF_LIGHT_M_S / (BOLTZMANN_J_K * kelvin * wavelength_m)
    photons: Array = np.exp(x.min() - x) / wavelength_m**4 / -np.expm1(-x)
    return photons / photons.max()


def _mixed(
    make: Callable[[float], Chromatic], wavelength_m: Array, value: Array, n: int, round_only: bool
) -> tuple[Optics, Array, Array]:
    """The optics of n wavelengths of a band, the wavelengths [m] and their weights."""
    nodes, weights = band_wavelengths(wavelength_m, value, n)
    parts = tuple(make(float(w)) for w in nodes)
    if round_only:
        parts = tuple(p.annulus if isinstance(p, Pupil) else p for p in parts)
    return mixture(parts, tuple(map(float, weights))), nodes, weights


def _first(holds: Callable[[int], bool], last: int) -> int:
    """The least i from 0 for which something holds that then goes on to hold; else `last`.

    Steps that double, then halves: few of many are looked at.
    """
    low, high = -1, 0
    while high < last and not holds(high):
        low, high = high, min(last, 2 * high + 2)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


class _Field:
    """The light of a round response per unit light, over a quarter of a field of some widths.

    Sampled so finely that what lies between is within two percent (six times as finely as pixels,
    where that takes no more than SAMPLES). Round optics, jitter and pixels are even along both
    axes, so that a cosine transform of a quarter of the frequencies holds all.
    """

    def __init__(self, blur: Blur, widths: float) -> None:
        scale = max(blur.optics.scale_px, blur.jitter_px, blur.diffusion_px)
        period = int(np.ceil(widths * scale)) + 12
        finer = max(blur.band_limit(1e-3), min(1.0, SAMPLES / (6.0 * period)))
        half = fast_size(int(np.ceil(3.0 * period * finer)))
        self._f, self._over_area = np.arange(half + 1) / period, 1.0 / period**2
        self._transfer = self._of(blur)
        self.light = self._image(self._transfer)

    def difference(self, blur: Blur) -> Array:
        """Of another response's light from this one's."""
        return self._image(self._of(blur) - self._transfer)

    def _of(self, blur: Blur) -> Array:
        return np.real(blur.transfer(self._f[:, None], self._f[None, :]))

    def _image(self, transfer: Array) -> Array:
        found: Array = scipy.fft.dctn(transfer, type=1) * self._over_area
        return found
