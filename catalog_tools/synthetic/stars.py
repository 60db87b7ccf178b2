"""Synthetic stars of one magnitude interval in one cell of the sky, drawn from statistics.

Colours: percentiles of BP-RP against G of random Gaia DR2 rows (G > 12) and of bright-star B-V
(times 1.2, G < 9). BP and RP follow from G and BP-RP by the flux excess 1.15 + 0.05 (BP-RP)^2
(between the limits of Lindegren et al. 2018, A&A 616, A2, equation C.2) and DR2's zero points.
Parallaxes and motions: log-normal about the medians of random DR2 rows, with DR2's errors added
(Lindegren et al. 2018, table B.1). Absent values at DR2's rates (Brown et al. 2018, table 3): no
colour 18.4%, no parallax and motion 21.3%, 7.2 million radial velocities; nearly all of the first
two at the faint end.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..columns import HEALPIX_ORDER
from ..geometry.sphere import AU_KM_YR_S
from ..star_counts import EDGES_G_MAG, all_sky_count

Floats = NDArray[np.float64]
Intervals = int | NDArray[np.int64]

COLOUR_PERCENTILES = (0.0, 1.0, 10.0, 25.0, 50.0, 75.0, 90.0, 99.0, 100.0)
COLOURS_G_MAG = (6.0, 9.0, 13.0, 16.0, 18.0, 20.0, 21.0)
COLOURS = np.array(  # BP-RP [mag]: a row for each G
    [
        (-0.40, -0.20, 0.06, 0.40, 0.85, 1.30, 1.75, 2.40, 4.00),
        (-0.35, -0.10, 0.25, 0.52, 0.85, 1.35, 1.75, 2.50, 4.20),
        (-0.20, 0.45, 0.72, 0.88, 1.20, 1.60, 2.00, 3.00, 4.50),
        (-0.30, 0.66, 0.88, 1.04, 1.30, 1.75, 2.24, 3.50, 5.00),
        (-0.40, 0.80, 0.97, 1.14, 1.42, 1.82, 2.33, 3.40, 4.50),
        (-0.50, 0.40, 0.90, 1.14, 1.43, 1.86, 2.20, 2.85, 4.00),
        (-0.60, 0.22, 0.70, 1.00, 1.40, 1.80, 2.20, 2.70, 3.80),
    ]
)

# Against G: true parallax [mas, median], its error [mas], tangential speed [km/s, median].
PARALLAX_G_MAG = (3.0, 8.0, 10.0, 11.0, 13.0, 15.0, 17.0, 19.0, 21.0)
PARALLAX_MAS = (12.0, 4.5, 2.0, 1.2, 0.86, 0.55, 0.36, 0.28, 0.24)
PARALLAX_ERROR_MAS = (0.10, 0.05, 0.04, 0.04, 0.03, 0.04, 0.10, 0.30, 1.60)
SPEED_KM_S = (22.0, 28.0, 34.0, 37.0, 45.0, 58.0, 75.0, 90.0, 100.0)
PARALLAX_SPREAD = 0.95  # of the natural logarithm
SPEED_SPREAD = 0.60
FASTEST_KM_S = 600.0
NEAREST_MAS = 700.0

# Where half of the stars have no colour, no parallax, no radial velocity; and the width [mag].
NO_COLOUR_G_MAG, NO_PARALLAX_G_MAG, NO_VELOCITY_G_MAG = (20.772, 0.4), (20.668, 0.4), (13.02, 0.25)
VELOCITY_SHARE = 0.9
VELOCITY_SPREAD_KM_S = 35.0

G_ZERO_POINT, BP_ZERO_POINT, RP_ZERO_POINT = 25.6883657251, 25.3513881707, 24.7619199882  # DR2


@lru_cache(maxsize=1)
def _slopes() -> Floats:
    """How steeply the logarithm of the counts rises in each interval of EDGES_G_MAG [1/mag]."""
    return np.asarray(np.diff(np.log(all_sky_count(EDGES_G_MAG))) / np.diff(EDGES_G_MAG))


def magnitudes(rng: np.random.Generator, interval: Intervals, n: int) -> Floats:
    """G magnitudes (n,) in intervals of EDGES_G_MAG, exponential as the counts rise across each."""
    interval = np.asarray(interval)
    bright, width_mag = EDGES_G_MAG[interval], np.diff(EDGES_G_MAG)[interval]
    slope = _slopes()[interval]
    drawn = bright + np.log1p(rng.random(n) * np.expm1(slope * width_mag)) / slope
    return np.asarray(drawn)


def colours(rng: np.random.Generator, g_mag: Floats) -> Floats:
    """BP-RP (n,) by inverting the percentiles, interpolated in G."""
    share = rng.random(g_mag.size) * 100.0
    by_row = np.array([np.interp(share, COLOUR_PERCENTILES, row) for row in COLOURS])
    at = np.interp(g_mag, COLOURS_G_MAG, np.arange(len(COLOURS)))
    low = np.minimum(at.astype(int), len(COLOURS) - 2)
    weight, i = at - low, np.arange(g_mag.size)
    return (1.0 - weight) * by_row[low, i] + weight * by_row[low + 1, i]


def bp_rp_mags(g_mag: Floats, bp_rp: Floats) -> tuple[Floats, Floats]:
    """BP and RP magnitudes with the given colour whose electrons add up to the excess times G's."""
    excess = 1.15 + 0.05 * bp_rp**2
    per_rp = 10 ** (0.4 * (BP_ZERO_POINT - bp_rp)) + 10 ** (0.4 * RP_ZERO_POINT)
    rp_mag = g_mag - G_ZERO_POINT - 2.5 * np.log10(excess / per_rp)
    return rp_mag + bp_rp, rp_mag


def motions(rng: np.random.Generator, g_mag: Floats) -> tuple[Floats, Floats, Floats]:
    """Parallax [mas], pmra (with cos dec) and pmdec [mas/yr], each (n,), errors included."""
    n = g_mag.size
    median = np.exp(np.interp(g_mag, PARALLAX_G_MAG, np.log(PARALLAX_MAS)))
    error = np.exp(np.interp(g_mag, PARALLAX_G_MAG, np.log(PARALLAX_ERROR_MAS)))
    parallax = median * np.exp(PARALLAX_SPREAD * rng.standard_normal(n))
    parallax = np.minimum(parallax, NEAREST_MAS)
    speed = np.interp(g_mag, PARALLAX_G_MAG, SPEED_KM_S)
    speed = np.minimum(speed * np.exp(SPEED_SPREAD * rng.standard_normal(n)), FASTEST_KM_S)
    proper_motion, angle = speed * parallax / AU_KM_YR_S, rng.random(n) * 2.0 * np.pi
    noise = rng.standard_normal((3, n)) * error
    return (
        parallax + noise[0],
        proper_motion * np.sin(angle) + 1.8 * noise[1],
        proper_motion * np.cos(angle) + 1.8 * noise[2],
    )


def share_absent(g_mag: Floats, half_g_mag: float, width_mag: float) -> Floats:
    """Logistic share of stars of each magnitude without a value."""
    return 1.0 / (1.0 + np.exp(-(g_mag - half_g_mag) / width_mag))


def draw_stars(
    rng: np.random.Generator, interval: Intervals, pixels_29: NDArray[np.int64]
) -> dict[str, Floats | NDArray[np.int64]]:
    """Columns of synthetic stars at given order-29 pixels (n,); NaN stands for an absent value.

    interval : of EDGES_G_MAG, one for all stars or (n,). source_id follows DR2's rule: its
    level-12 nested pixel stands above bit 35; below it the place inside that pixel, which makes it
    unique wherever the pixels are.
    """
    n = pixels_29.size
    g_mag = magnitudes(rng, interval, n)
    bp_mag, rp_mag = bp_rp_mags(g_mag, colours(rng, g_mag))
    parallax, pmra, pmdec = motions(rng, g_mag)
    lot = rng.random((3, n))
    velocity = rng.standard_normal(n) * VELOCITY_SPREAD_KM_S
    colourless = lot[0] < share_absent(g_mag, *NO_COLOUR_G_MAG)
    motionless = lot[1] < share_absent(g_mag, *NO_PARALLAX_G_MAG)
    silent = lot[2] < 1.0 - VELOCITY_SHARE * (1.0 - share_absent(g_mag, *NO_VELOCITY_G_MAG))
    inside = 2 * (HEALPIX_ORDER - 12)
    ids = (pixels_29 >> inside << 35) | ((pixels_29 & ((1 << inside) - 1)) << 1)
    return {
        "source_id": ids,
        "pmra": np.where(motionless, np.nan, pmra),
        "pmdec": np.where(motionless, np.nan, pmdec),
        "parallax": np.where(motionless, np.nan, parallax),
        "radial_velocity": np.where(motionless | silent, np.nan, velocity),
        "phot_g_mean_mag": g_mag,
        "phot_bp_mean_mag": np.where(colourless, np.nan, bp_mag),
        "phot_rp_mean_mag": np.where(colourless, np.nan, rp_mag),
    }
