"""How many stars of which magnitude lie where: published star counts, as one density function.

Above 20 degrees of galactic latitude: the fit of Bahcall & Soneira (1980, ApJS 44, 73, equation
B1) to their model of the Galaxy, 5 < V < 30, good to 15% there. Below 20 degrees it does not hold.
There the density at 20 degrees is raised by 1 + A r: r grows as ((20 - |b|) / 20)^2 towards the
plane, there towards the galactic centre, with a bulge on top and a gap for the dust lane. A is
chosen for each magnitude interval so that the whole sky holds the published number of stars:

- Tycho-2 to V = 10 and UCAC4 to 15, as counted in http://hnsky.org/star_count.htm (H. Kleijn);
- Gaia DR2: 161 million to G = 17 (Andrae et al. 2018, A&A 616, A8), 285 million to G = 18 (Anders
  et al. 2019, A&A 628, A94), 1,692,919,135 in all (Brown et al. 2018, A&A 616, A1), taken
  at G = 21.

Between these, log N is interpolated. V is taken as G + 0.2 (Evans et al. 2018, A&A 616, A4, table
A.2, at BP-RP = 1). Against a random 1/65536 sample of DR2 the totals agree to 12% and the densities
by latitude to 35%, and with a complete field at latitude -61 at every magnitude to G = 21 to 35%
(tests); the run with longitude was chosen by eye on the same sample. Single dust clouds are absent;
clusters and the Magellanic Clouds are in synthetic_clusters.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

V_MINUS_G_MAG = 0.2
PLANE_DEG = 20.0
ALL_SKY_DEG2 = 41252.96

# (G, stars brighter than G in the whole sky); the first rows are V counts, shifted.
ALL_SKY_COUNTS = (
    (2.8, 191.0),
    (3.8, 558.0),
    (4.8, 1744.0),
    (5.8, 5326.0),
    (6.8, 16503.0),
    (7.8, 48559.0),
    (8.8, 139375.0),
    (9.8, 382925.0),
    (12.0, 2955951.0),
    (13.0, 7346735.0),
    (14.0, 17214116.0),
    (15.0, 39387795.0),
    (17.0, 161e6),
    (18.0, 285e6),
    (21.0, 1692919135.0),
)

# Edges of the magnitude intervals in which densities are given.
EDGES_G_MAG = np.arange(3.0, 21.01, 0.5)

# Rows: galactic x, y, z axes in ICRS (Hipparcos catalogue, ESA SP-1200 vol. 1, equation 1.5.11).
GALACTIC = np.array(
    [
        [-0.0548755604, -0.8734370902, -0.4838350155],
        [0.4941094279, -0.4448296300, 0.7469822445],
        [-0.8676661490, -0.1980763734, 0.4559837762],
    ]
)


def galactic_rad(directions: Floats) -> tuple[Floats, Floats]:
    """Galactic longitude and latitude [rad] of ICRS unit vectors (..., 3)."""
    x = directions @ GALACTIC.T
    return np.arctan2(x[..., 1], x[..., 0]), np.arctan2(x[..., 2], np.hypot(x[..., 0], x[..., 1]))


def all_sky_count(g_mag: ArrayLike) -> Floats:
    """Stars brighter than G in the whole sky."""
    magnitudes, counts = np.array(ALL_SKY_COUNTS).T
    return np.exp(np.interp(np.asarray(g_mag, float), magnitudes, np.log(counts)))


def bahcall_soneira(v_mag: float, lon_rad: Floats, lat_rad: Floats) -> Floats:
    """Stars brighter than V in a square degree, at |latitude| >= 20 degrees (equation B1)."""
    cos_cos, sin_b = np.cos(lat_rad) * np.cos(lon_rad), np.abs(np.sin(lat_rad))
    share = np.clip((v_mag - 12.0) / 8.0, 0.0, 1.0)
    mu, gamma = 0.03 + 0.06 * share, 0.36 - 0.32 * share
    sigma = 1.45 - 0.20 * cos_cos
    disc = 925.0 * 10 ** (0.035 * (v_mag - 15.75)) / (1 + 10 ** (-0.132 * (v_mag - 15.75))) ** 3.0
    halo = 1050.0 * 10 ** (0.087 * (v_mag - 17.5)) / (1 + 10 ** (-0.180 * (v_mag - 17.5))) ** 2.5
    return disc / (sin_b - mu * cos_cos) ** (3 - 5 * gamma) + halo / (1 - cos_cos) ** sigma


def interval_density(interval: int, directions: Floats) -> Floats:
    """Stars in a square degree, in one interval of EDGES_G_MAG, at ICRS unit vectors (n, 3)."""
    lon, lat = galactic_rad(directions)
    base, rise = _base(interval, lon, lat), _towards_plane(lon, lat)
    return base * (1.0 + _plane_strength(interval) * rise)


def _base(interval: int, lon_rad: Floats, lat_rad: Floats) -> Floats:
    """Bahcall & Soneira in one interval, with the latitude kept above 20 degrees."""
    lat = np.maximum(np.abs(lat_rad), np.radians(PLANE_DEG))
    bright, faint = EDGES_G_MAG[interval : interval + 2] + V_MINUS_G_MAG
    return bahcall_soneira(faint, lon_rad, lat) - bahcall_soneira(bright, lon_rad, lat)


def _towards_plane(lon_rad: Floats, lat_rad: Floats) -> Floats:
    """The rise r below 20 degrees: 0 there, about 1 at the plane but for the dust lane's gap."""
    lon_deg = np.degrees(np.arctan2(np.sin(lon_rad), np.cos(lon_rad)))
    lat_deg = np.degrees(np.abs(lat_rad))
    near = np.maximum(1.0 - lat_deg / PLANE_DEG, 0.0)
    disc = near**2 * (0.3 + 0.7 * np.exp(0.5 * (np.cos(lon_rad) - 1.0)))
    bulge = 0.4 * np.exp(-0.5 * ((lon_deg / 8.0) ** 2 + (lat_deg / 5.0) ** 2)) * (near > 0.0)
    return (disc + bulge) * (1.0 - 0.6 * np.exp(-((lat_deg / 2.0) ** 2)))


@lru_cache(maxsize=64)
def _plane_strength(interval: int) -> float:
    """The factor A that makes the whole sky hold the published number of stars."""
    lon = np.radians(np.arange(1.0, 360.0, 2.0))[:, None]
    sin_lat = (np.arange(-999.0, 1000.0, 2.0) / 1000.0)[None, :]
    lat = np.arcsin(sin_lat)
    base = _base(interval, lon, lat)
    bright, faint = all_sky_count(EDGES_G_MAG[interval : interval + 2])
    wanted = (faint - bright) / ALL_SKY_DEG2
    return max(0.0, float((wanted - base.mean()) / (base * _towards_plane(lon, lat)).mean()))
