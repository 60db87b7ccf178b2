"""The 94 columns of Gaia DR2's `gaia_source` for synthetic stars: names, types, plausible values.

The ten columns that a catalogue keeps come from `synthetic_stars`. Those that follow from them do
follow: fluxes, colours, ratios, galactic and ecliptic places. The others have the size, the digits
and the nulls of random DR2 rows (medians against G), but no meaning: fit counts, correlations,
flags, astrophysical parameters.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..star_counts import galactic_rad
from .stars import (
    BP_ZERO_POINT,
    G_ZERO_POINT,
    PARALLAX_ERROR_MAS,
    PARALLAX_G_MAG,
    RP_ZERO_POINT,
)
from .text import DOUBLE, NAME, NO_WHOLE, SINGLE, TEXT, WHOLE

Values = np.ndarray
Floats = NDArray[np.float64]
Columns = dict[str, Values]

# Published order. After the name: D double, F float, I integer, T text or flag, N designation.
SCHEMA = """
solution_id I, designation N, source_id I, random_index I, ref_epoch D, ra D, ra_error D, dec D,
dec_error D, parallax D, parallax_error D, parallax_over_error F, pmra D, pmra_error D, pmdec D,
pmdec_error D, ra_dec_corr F, ra_parallax_corr F, ra_pmra_corr F, ra_pmdec_corr F,
dec_parallax_corr F, dec_pmra_corr F, dec_pmdec_corr F, parallax_pmra_corr F, parallax_pmdec_corr F,
pmra_pmdec_corr F, astrometric_n_obs_al I, astrometric_n_obs_ac I, astrometric_n_good_obs_al I,
astrometric_n_bad_obs_al I, astrometric_gof_al F, astrometric_chi2_al F, astrometric_excess_noise D,
astrometric_excess_noise_sig D, astrometric_params_solved I, astrometric_primary_flag T,
astrometric_weight_al F, astrometric_pseudo_colour D, astrometric_pseudo_colour_error D,
mean_varpi_factor_al F, astrometric_matched_observations I, visibility_periods_used I,
astrometric_sigma5d_max F, frame_rotator_object_type I, matched_observations I, duplicated_source T,
phot_g_n_obs I, phot_g_mean_flux D, phot_g_mean_flux_error D, phot_g_mean_flux_over_error F,
phot_g_mean_mag F, phot_bp_n_obs I, phot_bp_mean_flux D, phot_bp_mean_flux_error D,
phot_bp_mean_flux_over_error F, phot_bp_mean_mag F, phot_rp_n_obs I, phot_rp_mean_flux D,
phot_rp_mean_flux_error D, phot_rp_mean_flux_over_error F, phot_rp_mean_mag F,
phot_bp_rp_excess_factor F, phot_proc_mode I, bp_rp F, bp_g F, g_rp F, radial_velocity D,
radial_velocity_error D, rv_nb_transits I, rv_template_teff F, rv_template_logg F,
rv_template_fe_h F, phot_variable_flag T, l D, b D, ecl_lon D, ecl_lat D, priam_flags I, teff_val F,
teff_percentile_lower F, teff_percentile_upper F, a_g_val F, a_g_percentile_lower F,
a_g_percentile_upper F, e_bp_min_rp_val F, e_bp_min_rp_percentile_lower F,
e_bp_min_rp_percentile_upper F, flame_flags I, radius_val F, radius_percentile_lower F,
radius_percentile_upper F, lum_val F, lum_percentile_lower F, lum_percentile_upper F
"""
PAIRS = [pair.split() for pair in SCHEMA.replace("\n", " ").split(",")]
HEADER: tuple[str, ...] = tuple(name for name, _ in PAIRS)
KINDS: tuple[int, ...] = tuple(
    {"D": DOUBLE, "F": SINGLE, "I": WHOLE, "T": TEXT, "N": NAME}[kind] for _, kind in PAIRS
)
TEXTS = ("Gaia DR2 ", "false", "true", "NOT_AVAILABLE", "VARIABLE")
FALSE, TRUE, NOT_AVAILABLE, VARIABLE = range(1, 5)

SOLUTION_ID = 1635721458409799680
REF_EPOCH_JYEAR = 2015.5
OBLIQUITY_RAD = np.radians(84381.41100 / 3600.0)  # of the ecliptic that DR2 uses (ICRS axes)
CORRELATIONS = tuple(name for name in HEADER if name.endswith("_corr"))


def all_columns(
    rng: np.random.Generator, stars: Columns, v: Floats, random_index: NDArray[np.int64]
) -> list[Values]:
    """All columns of stars in the order of HEADER, each (n,); NaN or NO_WHOLE for absent.

    stars : the ten columns of a catalogue; v : (n, 3) unit vectors of their places.
    """
    columns: Columns = {
        **stars,
        "designation": stars["source_id"],
        "random_index": random_index,
        **_astrometry(rng, stars),
        **_photometry(rng, stars),
        **_spectroscopy(rng, stars),
        **_angles(v),
        **_astrophysics(rng, stars),
    }
    n = random_index.size
    fixed = {
        "solution_id": np.full(n, SOLUTION_ID),
        "ref_epoch": np.full(n, REF_EPOCH_JYEAR),
        "frame_rotator_object_type": np.zeros(n, np.int64),
    }
    columns |= fixed
    return [columns[name] for name in HEADER]


def _log_normal(rng: np.random.Generator, median: Floats | float, spread: float, n: int) -> Floats:
    """Positive numbers (n,): the natural logarithm has this spread about the median's."""
    return np.asarray(median * np.exp(spread * rng.standard_normal(n, np.float32).astype(float)))


def _astrometry(rng: np.random.Generator, stars: Columns) -> Columns:
    g_mag, parallax = stars["phot_g_mean_mag"], stars["parallax"]
    n = g_mag.size
    solved = np.isfinite(parallax)  # else two parameters
    absent = np.where(solved, 0.0, np.nan)
    error = np.exp(np.interp(g_mag, PARALLAX_G_MAG, np.log(PARALLAX_ERROR_MAS)))
    error *= _log_normal(rng, 1.0, 0.25, n)
    columns: Columns = {}
    factors = {"ra": 0.8, "dec": 0.75, "parallax": 1.0, "pmra": 1.75, "pmdec": 1.6}
    for name, factor in factors.items():
        spread = factor * error * (0.85 + 0.3 * rng.random(n))
        columns[f"{name}_error"] = spread if name in ("ra", "dec") else spread + absent
    columns["parallax_over_error"] = parallax / columns["parallax_error"]
    for name in CORRELATIONS:
        value = 1.8 * rng.random(n) - 0.9
        columns[name] = value if name == "ra_dec_corr" else value + absent
    visits = rng.integers(8, 42, n)
    observations = visits * 9 - rng.integers(0, 9, n)
    bad = rng.integers(0, 4, n)
    good = observations - bad
    noise = np.maximum(error * (2.5 * rng.random(n) - 1.2), 0.0)
    columns |= {
        "astrometric_n_obs_al": observations,
        "astrometric_n_obs_ac": np.where(g_mag < 13.0, observations, 0),
        "astrometric_n_good_obs_al": good,
        "astrometric_n_bad_obs_al": bad,
        "astrometric_gof_al": 1.3 + 2.0 * (rng.random(n) + rng.random(n) - 1.0),
        "astrometric_chi2_al": good * _log_normal(rng, 1.1, 0.3, n),
        "astrometric_excess_noise": noise,
        "astrometric_excess_noise_sig": np.where(noise > 0.0, 3.0 * rng.random(n), 0.0),
        "astrometric_params_solved": np.where(solved, 31, 3),
        "astrometric_primary_flag": np.where(rng.random(n) < 0.007, TRUE, FALSE),
        "astrometric_weight_al": 0.03 / error**2,
        "astrometric_pseudo_colour": 1.1 + 0.7 * rng.random(n) + absent,
        "astrometric_pseudo_colour_error": 0.2 * error + absent,
        "mean_varpi_factor_al": 0.6 * rng.random(n) - 0.3,
        "astrometric_matched_observations": visits,
        "visibility_periods_used": rng.integers(6, 20, n),
        "astrometric_sigma5d_max": 1.8 * error,
        "matched_observations": visits + rng.integers(0, 3, n),
        "duplicated_source": np.where(rng.random(n) < 0.02, TRUE, FALSE),
    }
    return columns


def _photometry(rng: np.random.Generator, stars: Columns) -> Columns:
    n = stars["phot_g_mean_mag"].size
    columns: Columns = {}
    bands = (("g", G_ZERO_POINT, 0.009), ("bp", BP_ZERO_POINT, 0.06), ("rp", RP_ZERO_POINT, 0.04))
    flux = {}
    for band, zero_point, noise in bands:
        magnitude = stars[f"phot_{band}_mean_mag"]
        flux[band] = 10 ** (-0.4 * (magnitude - zero_point))
        error = np.hypot(noise * np.sqrt(flux[band]) * 12.0, 8e-4 * flux[band])
        error *= _log_normal(rng, 1.0, 0.3, n)
        seen = rng.integers(8, 42, n)
        columns |= {
            f"phot_{band}_n_obs": seen * 9 if band == "g" else np.where(error > 0.0, seen, 0),
            f"phot_{band}_mean_flux": flux[band],
            f"phot_{band}_mean_flux_error": error,
            f"phot_{band}_mean_flux_over_error": flux[band] / error,
        }
    g_mag, bp_mag, rp_mag = (stars[f"phot_{band}_mean_mag"] for band, _, _ in bands)
    return columns | {
        "phot_bp_rp_excess_factor": (flux["bp"] + flux["rp"]) / flux["g"],
        "phot_proc_mode": np.where(np.isfinite(bp_mag), 0, 2),
        "bp_rp": bp_mag - rp_mag,
        "bp_g": bp_mag - g_mag,
        "g_rp": g_mag - rp_mag,
        "phot_variable_flag": np.where(rng.random(n) < 3e-4, VARIABLE, NOT_AVAILABLE),
    }


def _spectroscopy(rng: np.random.Generator, stars: Columns) -> Columns:
    velocity = stars["radial_velocity"]
    n = velocity.size
    has = np.isfinite(velocity)
    return {
        "radial_velocity_error": np.where(has, _log_normal(rng, 1.0, 0.6, n), np.nan),
        "rv_nb_transits": np.where(has, rng.integers(2, 20, n), 0),
        "rv_template_teff": np.where(has, 250.0 * rng.integers(14, 28, n), np.nan),
        "rv_template_logg": np.where(has, 0.5 * rng.integers(2, 10, n), np.nan),
        "rv_template_fe_h": np.where(has, 0.25 * rng.integers(-6, 2, n), np.nan),
    }


def _angles(v: Floats) -> Columns:
    """Galactic and ecliptic longitude and latitude [deg], longitudes from 0 to 360."""
    lon, lat = galactic_rad(v)
    c, s = np.cos(OBLIQUITY_RAD), np.sin(OBLIQUITY_RAD)
    y, z = c * v[:, 1] + s * v[:, 2], c * v[:, 2] - s * v[:, 1]
    return {
        "l": np.degrees(lon) % 360.0,
        "b": np.degrees(lat),
        "ecl_lon": np.degrees(np.arctan2(y, v[:, 0])) % 360.0,
        "ecl_lat": np.degrees(np.arcsin(np.clip(z, -1.0, 1.0))),
    }


def _astrophysics(rng: np.random.Generator, stars: Columns) -> Columns:
    """Temperatures for stars to G = 17, the rest for half of these (Brown et al. 2018, table 3)."""
    g_mag, bp_mag = stars["phot_g_mean_mag"], stars["phot_bp_mean_mag"]
    n = g_mag.size
    lot = rng.random(n)
    cool = (g_mag < 17.0) & np.isfinite(bp_mag)
    medians = {
        "teff": (4900.0, 0.12, cool),
        "a_g": (0.6, 0.5, cool & (lot < 0.55)),
        "e_bp_min_rp": (0.3, 0.5, cool & (lot < 0.55)),
        "radius": (1.4, 0.6, cool & (lot > 0.52)),
        "lum": (1.2, 1.0, cool & (lot > 0.52)),
    }
    columns: Columns = {
        "priam_flags": np.where(cool, 100001, NO_WHOLE),
        "flame_flags": np.where(cool & (lot > 0.52), 200111, NO_WHOLE),
    }
    ends = (("val", 1.0), ("percentile_lower", 0.93), ("percentile_upper", 1.08))
    for name, (median, spread, has) in medians.items():
        rows = np.flatnonzero(has)
        value = _log_normal(rng, median, spread, rows.size)
        for end, factor in ends:
            column = np.full(n, np.nan)
            column[rows] = factor * value
            columns[f"{name}_{end}"] = column
    return columns
