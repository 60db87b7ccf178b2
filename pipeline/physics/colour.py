"""Gaia magnitudes to electron rates in the sensor's band, by a colour polynomial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.errors import BadInput

Array = NDArray[np.float64]

MEASURED_COLOUR, DEFAULT_COLOUR, CLAMPED_COLOUR = 0, 1, 2


@dataclass(frozen=True)
class ColourFit:
    """Band magnitude minus G as a polynomial in BP-RP, and the rate that belongs to zero.

    The band's magnitude is normalised so that band - G of an A0V star is zero; BP-RP is as Gaia
    publishes it.

    coefficients : (k,) ascending powers of BP-RP, magnitudes
    colour_range : smallest and largest BP-RP of the spectra that were fitted
    residual_rms_mag, residual_max_mag : of the fitted spectra, equal weights
    redder_error_mag : largest of spectra redder than those, drawn as if they were as blue
    default_colour : BP-RP taken for stars without colours
    default_colour_scatter : half of the 16 to 84% range of BP-RP that it stands for
    default_error_mag : what that scatter makes of the band's magnitude
    zero_electrons_s_m2 : electrons/s per m2 of pupil from an A0V star of G = 0
    source, spectra_count : which spectra were fitted, and how many
    digest : SHA-256 of the file that the fit was read from; None for one that was not
    """

    band_name: str
    coefficients: Array
    colour_range: tuple[float, float]
    residual_rms_mag: float
    residual_max_mag: float
    redder_error_mag: float
    default_colour: float
    default_colour_scatter: float
    default_error_mag: float
    zero_electrons_s_m2: float
    source: str
    spectra_count: int
    digest: str | None = None


def fit_colour(bp_rp: Array, band_minus_g: Array, degree: int, a0v_bp_rp: float = 0.0) -> Array:
    """Least-squares polynomial that is 0 for an A0V star.

    bp_rp, band_minus_g : (n,) magnitudes over those of A0V; a0v_bp_rp : its BP-RP
    Returns coefficients (degree+1,) in ascending powers of BP-RP itself.
    """
    powers = np.vander(bp_rp, degree + 1, increasing=True)[:, 1:]
    solution = np.linalg.lstsq(powers, band_minus_g, rcond=None)[0]
    over = np.polynomial.Polynomial(np.concatenate([[0.0], solution]))
    return np.asarray(over(np.polynomial.Polynomial([-a0v_bp_rp, 1.0])).coef)


def cross_validated_rms_mag(bp_rp: Array, band_minus_g: Array, degree: int) -> float:
    """Rms of each spectrum's residual against the fit of all the others, in magnitudes.

    The leave-one-out residual of a linear fit is r_i / (1 - h_i), h the diagonal of its hat
    matrix (Allen 1974, Technometrics 16, 125): one fit does for all.
    """
    basis = np.linalg.qr(np.vander(bp_rp, degree + 1, increasing=True)[:, 1:])[0]
    residual = band_minus_g - basis @ (basis.T @ band_minus_g)
    left_out = residual / (1.0 - np.sum(basis**2, axis=1))
    return float(np.sqrt(np.mean(left_out**2)))


def choose_degree(
    bp_rp: Array, band_minus_g: Array, degrees: tuple[int, ...] = (2, 3, 4, 5)
) -> int:
    """Smallest degree whose cross-validated rms is within 3% of the best one's.

    Degrees above 5 gain under 0.005 mag rms on the Pickles library and swing at its sparse red end.
    """
    rms = [cross_validated_rms_mag(bp_rp, band_minus_g, degree) for degree in degrees]
    return next(d for d, r in zip(degrees, rms, strict=True) if r <= 1.03 * min(rms) + 1e-12)


def colour_correction_mag(bp_rp: Array, fit: ColourFit) -> Array:
    """Band magnitude minus G for colours (n,) of BP-RP, clamped to the fitted range."""
    inside = np.clip(bp_rp, *fit.colour_range)
    return np.asarray(np.polynomial.polynomial.polyval(inside, fit.coefficients), np.float64)


def star_electron_rate(
    g_mag: Array, bp_mag: Array, rp_mag: Array, fit: ColourFit
) -> tuple[Array, NDArray[np.uint8]]:
    """Electron rates of stars in the sensor's band: zero 10^(-0.4 (G + correction(BP-RP))).

    g_mag, bp_mag, rp_mag : (n,) Gaia magnitudes; NaN in BP or RP means absent
    Returns electrons/s per m2 of pupil (n,) float64, and a flag (n,) uint8: 0 measured colour,
    1 default colour (BP or RP absent), 2 colour clamped to the range of the fit.
    BadInput where a G magnitude is not finite.

    Limits: the fit is of unreddened stars; what dust does beyond the change of BP-RP is omitted.
    """
    g = np.ascontiguousarray(g_mag, dtype=np.float64)
    bp = np.ascontiguousarray(bp_mag, dtype=np.float64)
    rp = np.ascontiguousarray(rp_mag, dtype=np.float64)
    if not g.shape == bp.shape == rp.shape:
        raise BadInput("magnitudes", (g.shape, bp.shape, rp.shape), "three columns of one length")
    rate, flag = np.empty(g.shape), np.empty(g.shape, dtype=np.uint8)
    bad = _rates(
        g,
        bp,
        rp,
        np.ascontiguousarray(fit.coefficients, dtype=np.float64),
        fit.colour_range[0],
        fit.colour_range[1],
        fit.default_colour,
        fit.zero_electrons_s_m2,
        rate,
        flag,
    )
    if bad >= 0:
        raise BadInput("phot_g_mean_mag", float(g[bad]), "a finite magnitude in every row")
    return rate, flag


@njit(cache=True, nogil=True)
def _rates(g, bp, rp, coefficients, low, high, default, zero, rate, flag):
    """Fill `rate` and `flag`; the index of the last star without a finite G, or -1."""
    bad = -1
    for i in range(g.size):
        colour = bp[i] - rp[i]
        if np.isfinite(colour):
            flag[i] = MEASURED_COLOUR
            if colour < low:
                colour, flag[i] = low, CLAMPED_COLOUR
            elif colour > high:
                colour, flag[i] = high, CLAMPED_COLOUR
        else:
            colour, flag[i] = default, DEFAULT_COLOUR
        correction = 0.0
        for k in range(coefficients.size - 1, -1, -1):
            correction = correction * colour + coefficients[k]
        rate[i] = zero * 10.0 ** (-0.4 * (g[i] + correction))
        if not np.isfinite(g[i]):
            bad = i
    return bad


def brightest_electrons(fit: ColourFit, area_m2: float, integration_s: float) -> float:
    """Electrons in the exposure of a star of G = 0, of the colour that gives most."""
    colours = np.linspace(*fit.colour_range, 257)
    most = float(10.0 ** (-0.4 * colour_correction_mag(colours, fit).min()))
    return fit.zero_electrons_s_m2 * area_m2 * integration_s * most
