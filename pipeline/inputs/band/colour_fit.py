"""Fit the colour correction of a band once, keep it on disk, describe it."""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from typing import NamedTuple

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.inputs.band.curves import named_filter, stellar_library, stellar_library_digest
from pipeline.kept import kept
from pipeline.physics.colour import ColourFit, choose_degree, colour_correction_mag, fit_colour
from pipeline.physics.radiometry import Array, ResponseCurve, photon_integral

FORMAT = "nightglass/colour-fit/3"

# Of the published DR2 magnitudes: measured on real rows as mag + 2.5 log10(flux), 25.6884 with a
# scatter of 5e-7 (Evans et al. 2018, A&A 616, A4). The revised passbands' own 25.6914 belongs to
# magnitudes that DR2 does not publish; it would make every star 0.28% brighter.
GAIA_G_ZERO_POINT_MAG = 25.6883657251
GAIA_BP_RP_ZERO_POINT_MAG = 25.3513881707 - 24.7619199882  # of those of BP and RP, as published
GAIA_PUPIL_M2 = 0.7278  # Gaia Collaboration, Prusti et al. 2016, A&A 595, A1

# Redder spectra (M6V, M7III...) leave the common relation: 0.4% of DR2's stars, which are clamped.
REDDEST_BP_RP_MAG = 3.43

# Median and half of the 16 to 84% range of BP-RP of 727 random DR2 rows with G > 18.
DEFAULT_BP_RP_MAG, DEFAULT_SCATTER_MAG = 1.44, 0.50


# Of 921 random stars of DR2 with colours, G 12 to 21: BP-RP at 5, 15 ... 95%, and of all.
TYPICAL_BP_RP_MAG = (0.81, 1.01, 1.13, 1.24, 1.37, 1.50, 1.66, 1.83, 2.04, 2.58)
BLUEST_AND_REDDEST_MAG = (-0.47, 4.09)


class ColourPoints(NamedTuple):
    """Synthetic colours of the library: names, BP-RP (n,) as DR2 publishes it, and band - G (n,)
    over that of its A0V, whose BP-RP is `a0v_bp_rp`."""

    names: tuple[str, ...]
    bp_rp: Array
    band_minus_g: Array
    a0v_bp_rp: float
    a0v_band_over_g: float
    source: str


def gather_colour_points(response: ResponseCurve) -> ColourPoints:
    """Colours of every spectrum of the stellar library through a response, sorted by BP-RP.

    Photon-counting synthetic photometry with the revised DR2 passbands (photon responses) and the
    zero points of the published magnitudes (Evans et al. 2018, A&A 616, A4): by them an A0V star is
    0.047 mag redder than 0.
    `a0v_band_over_g` is the ratio of A0V's electrons in the band to those in Gaia's G.
    """
    library, source = stellar_library()
    bands = [named_filter(f"gaiadr2-{band}") for band in ("G", "BP", "RP")] + [response]
    rates = np.array([[photon_integral(w, f, band) for band in bands] for _, w, f in library])
    names = [name for name, _, _ in library]
    a0v = rates[names.index("A0V")]
    with np.errstate(divide="ignore"):
        g, bp, rp, band = -2.5 * np.log10(rates / a0v).T
    white = GAIA_BP_RP_ZERO_POINT_MAG - 2.5 * math.log10(a0v[1] / a0v[2])
    order = [i for i in np.argsort(bp - rp) if math.isfinite(band[i])]
    return ColourPoints(
        tuple(names[i] for i in order),
        (bp - rp)[order] + white,
        (band - g)[order],
        white,
        float(a0v[3] / a0v[0]),
        source,
    )


def fit_band(points: ColourPoints, band_name: str, degree: int | None = None) -> ColourFit:
    """Fit the colour polynomial to the library's points; degree None is cross-validated."""
    used = points.bp_rp <= REDDEST_BP_RP_MAG
    x, y = points.bp_rp[used], points.band_minus_g[used]
    over = x - points.a0v_bp_rp
    degree = degree if degree is not None else choose_degree(over, y)
    coefficients = fit_colour(over, y, degree, points.a0v_bp_rp)
    residual = y - np.polynomial.polynomial.polyval(x, coefficients)
    redder = points.band_minus_g[~used] - np.polynomial.polynomial.polyval(x[-1], coefficients)
    around = DEFAULT_BP_RP_MAG + DEFAULT_SCATTER_MAG * np.array([-1.0, 0.0, 1.0])
    blue, middle, red = np.polynomial.polynomial.polyval(around, coefficients)
    zero_g = 10.0 ** (0.4 * GAIA_G_ZERO_POINT_MAG) / GAIA_PUPIL_M2
    return ColourFit(
        band_name=band_name,
        coefficients=coefficients,
        colour_range=(float(x[0]), float(x[-1])),
        residual_rms_mag=float(np.sqrt(np.mean(residual**2))),
        residual_max_mag=float(np.max(np.abs(residual))),
        redder_error_mag=float(np.max(np.abs(redder), initial=0.0)),
        default_colour=DEFAULT_BP_RP_MAG,
        default_colour_scatter=DEFAULT_SCATTER_MAG,
        default_error_mag=float(max(abs(blue - middle), abs(red - middle))),
        zero_electrons_s_m2=zero_g * points.a0v_band_over_g,
        source=points.source,
        spectra_count=int(x.size),
    )


def default_colour_error_mag(fit: ColourFit) -> tuple[float, float]:
    """What the default colour may cost a star's magnitude in the band: rms and largest.

    From the fit at the colours of typical stars, against that at the default one.
    """
    taken = colour_correction_mag(np.array([fit.default_colour]), fit)
    typical = colour_correction_mag(np.array(TYPICAL_BP_RP_MAG), fit) - taken
    extreme = colour_correction_mag(np.array(BLUEST_AND_REDDEST_MAG), fit) - taken
    return float(np.sqrt(np.mean(typical**2))), float(np.abs([*typical, *extreme]).max())


def gather_colour_fit(
    response: ResponseCurve, band_name: str, digest: str, degree: int | None = None
) -> ColourFit:
    """The colour fit of a band, kept on disk by the response's digest (`resolve_response`) and the
    library's content."""

    def make() -> JsonObject:
        content = plain_fit(fit_band(gather_colour_points(response), band_name, degree))
        return {name: value for name, value in content.items() if name != "digest"}

    made = kept((FORMAT, digest, band_name, stellar_library_digest(), degree), make)
    return fit_of({name: values.tolist() for name, values in made.items()})


def fit_of(content: JsonObject) -> ColourFit:
    """A fit from its plain data. KeyError, TypeError or ValueError for what is none."""
    low, high = content["colour_range"]
    arrays = {
        "coefficients": np.array(content["coefficients"], dtype=np.float64),
        "colour_range": (float(low), float(high)),
        "digest": None,
    }
    return ColourFit(**{f.name: ({**content, **arrays})[f.name] for f in fields(ColourFit)})


def plain_fit(fit: ColourFit) -> JsonObject:
    """A fit as plain data."""
    return asdict(fit) | {
        "coefficients": [float(c) for c in fit.coefficients],
        "colour_range": list(fit.colour_range),
    }


def describe(fit: ColourFit, points: ColourPoints | None = None) -> JsonObject:
    """What `nightglass color-fit` shows: the fit and, with points, each spectrum's residual."""
    described = plain_fit(fit)
    described["formula"] = "band - G = sum of coefficients[k] (BP-RP)^k; 0 at A0V"
    if points is not None:
        residual = points.band_minus_g - colour_correction_mag(points.bp_rp, fit)
        described["spectra"] = [
            {"name": n, "bp_rp": float(x), "band_minus_g": float(y), "residual_mag": float(r)}
            for n, x, y, r in zip(*points[:3], residual, strict=True)
        ]
    return described
