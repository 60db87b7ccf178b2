"""Extinction by the air: mass of air on a slanted path, coefficients, transmission of a band."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.constants import DEG_RAD
from pipeline.physics.radiometry import ResponseCurve, photon_integral

Array = NDArray[np.float64]

PIECES = 48  # of a band; its transmission errs by less than 1e-4 up to 10 air masses (tests)
RAYLEIGH_SCALE_M, AEROSOL_SCALE_M = 7996.0, 1500.0
DOBSON_PER_M2 = 2.6867e20  # molecules
# Ozone, 1e-25 m2 a molecule, means of 10 nm from 290 nm on: at 233 K by Serdyuchenko et al. 2014
# (Atmos. Meas. Tech. 7, 625); below 360 nm rounded from Sander et al. 2006 (JPL 06-2), 218 K.
OZONE_FROM_NM, OZONE_STEP_NM = 290.0, 10.0
OZONE_1E25_M2 = (
    790.0, 200.0, 50.0, 15.0, 4.0, 1.0, 0.15,
    0.0118, 0.002182, 0.002818, 0.006636, 0.01527, 0.02763, 0.0552, 0.08451, 0.1582, 0.2316, 0.3669,
    0.4924, 0.7752, 0.9016, 1.48, 1.602, 2.139, 2.755, 3.091, 3.5, 4.266, 4.672, 4.398, 4.701,
    5.019, 4.305, 3.74, 3.215, 2.662, 2.238, 1.852, 1.473, 1.209, 0.9423, 0.7455, 0.6566, 0.5105,
    0.415, 0.4228, 0.3237, 0.2451, 0.2801, 0.2534, 0.1624, 0.1465, 0.2078, 0.1383, 0.07105,
)  # fmt: skip
MAG = 2.5 / np.log(10.0)
V_M = 550e-9


def air_mass(sine: ArrayLike) -> Array:
    """Air on a path over that to the zenith, from the sine of the apparent elevation.

    Kasten & Young 1989, Applied Optics 28, 4735: 1 / (sin h + 0.50572 (h + 6.07995)^-1.6364), h in
    degrees, within 0.5% of the standard atmosphere from the zenith (0.9997) to the horizon (37.92),
    whose value holds below it too.
    """
    s = np.clip(np.asarray(sine, float), 0.0, 1.0)
    height_deg = np.arcsin(s) / DEG_RAD
    return 1.0 / (s + 0.50572 * (height_deg + 6.07995) ** -1.6364)


def coefficients(
    wavelength_m: ArrayLike,
    height_m: float,
    aerosol_mag: float,
    aerosol_slope: float,
    ozone_dobson: float,
) -> tuple[Array, Array, Array]:
    """Rayleigh, aerosol and ozone extinction (n,) each [mag per air mass] above a site.

    Hayes & Latham 1975, ApJ 197, 593: 0.0094977 n^2 / lambda^4 exp(-H / 7.996 km), with
    n = 0.23465 + 107.6 / (146 - 1/lambda^2) + 0.93161 / (41 - 1/lambda^2), lambda in um; aerosols
    fall as lambda^-slope and with a scale height of 1.5 km; ozone as its cross-section. Omitted:
    lines of water and oxygen (a few percent of red bands, most of 930 to 970 nm), clouds.
    """
    um = np.asarray(wavelength_m, float) * 1e6
    inverse = um**-2
    n = 0.23465 + 107.6 / (146.0 - inverse) + 0.93161 / (41.0 - inverse)
    rayleigh = 0.0094977 * inverse**2 * n**2 * np.exp(-height_m / RAYLEIGH_SCALE_M)
    aerosol = aerosol_mag * (um / 0.55) ** -aerosol_slope * np.exp(-height_m / AEROSOL_SCALE_M)
    middles = OZONE_FROM_NM + OZONE_STEP_NM * (np.arange(len(OZONE_1E25_M2)) + 0.5)
    section = np.interp(um * 1e3, middles, OZONE_1E25_M2, right=0.0) * 1e-25
    ozone = MAG * section * ozone_dobson * DOBSON_PER_M2
    return rayleigh, aerosol, ozone


@dataclass(frozen=True, eq=False)
class BandExtinction:
    """Extinction of a band in pieces.

    wavelength_m (k,) : of each piece; scattered_mag, absorbed_mag (k,) : mag per air mass by
        scattering and by absorption; share (k,) : of the band's electrons from the Sun's light;
        extremes (m, k) : from other lights, of the bluest and the reddest stars
    v_mag : mag per air mass in V, within the band or not
    """

    wavelength_m: Array
    scattered_mag: Array
    absorbed_mag: Array
    share: Array
    extremes: Array
    v_mag: float

    def with_extremes(self, extremes: Array) -> BandExtinction:
        """The same with the shares of other lights."""
        return replace(self, extremes=extremes)

    @property
    def mag(self) -> Array:
        """Mag per air mass (k,)."""
        return self.scattered_mag + self.absorbed_mag

    def transmission(self, sine: ArrayLike, part: float = 1.0) -> Array:
        """Share (...) of a band's light that comes down, of sunlike colour; 0 below the horizon.

        sine : (...) of the apparent elevation; part : of the extinction that acts
        """
        x = air_mass(sine)
        passed = 10.0 ** (-0.4 * part * self.mag * x[..., None])
        return np.where(np.asarray(sine) < 0.0, 0.0, passed @ self.share)

    def colour_error_mag(self, sine: float) -> float:
        """Most by which stars of any colour differ from the Sun at an elevation [mag]."""
        passed = 10.0 ** (-0.4 * self.mag * air_mass(sine))
        ratio = (self.extremes @ passed) / (self.share @ passed)
        return float(np.max(np.abs(2.5 * np.log10(ratio)), initial=0.0))


def band_extinction(
    wavelength_m: Array,
    f_lambda: Array,
    response: ResponseCurve,
    mag: float | tuple[float, float, float, float],
) -> BandExtinction:
    """Extinction over a response for light of some spectrum.

    wavelength_m, f_lambda : (n,) spectrum; mag : one coefficient, or what `coefficients` takes
    """
    parts = band_pieces(response)
    share = np.array([photon_integral(wavelength_m, f_lambda, part) for part in parts])
    middle = np.array([0.5 * (p.wavelength_m[0] + p.wavelength_m[-1]) for p in parts])
    share, none = share / share.sum(), np.empty((0, PIECES))
    if isinstance(mag, tuple):
        rayleigh, aerosol, ozone = coefficients(middle, *mag)
        v_mag = float(sum(coefficients(V_M, *mag)))
        return BandExtinction(middle, rayleigh + aerosol, ozone, share, none, v_mag)
    return BandExtinction(middle, np.full(PIECES, mag), np.zeros(PIECES), share, none, mag)


def band_pieces(response: ResponseCurve) -> list[ResponseCurve]:
    """A response cut into PIECES of equal width."""
    w, v = response.wavelength_m, response.value
    edges = np.linspace(w[0], w[-1], PIECES + 1)
    grids = [np.concatenate([[a], w[(w > a) & (w < b)], [b]]) for a, b in pairwise(edges)]
    return [ResponseCurve(grid, np.interp(grid, w, v)) for grid in grids]
