"""The Magellanic Clouds and rich clusters: where the sky's densest crowds lie, star by pixel.

- Clouds: centres and numbers of stars to G = 21 from Luri et al. (2021, A&A 649, A7, their samples
  of 11.2 and 1.7 million); round exponential discs with the scale lengths of van der Marel (2001,
  AJ 122, 1827) and Nidever et al. (2011, ApJ 733, L10).
- Globular clusters: centres, distances, members in Gaia DR2 and cut-off radii of Vasiliev (2019,
  MNRAS 484, 2832; a lower limit, as crowded cores fail his cuts); half-light radii of Harris (1996,
  AJ 112, 1487, edition of 2010). Brightest star: the tip of the giant branch, at M = -2.5.
- Open clusters: members in DR2 of Babusiaux et al. (2018, A&A 616, A10); centres, and half of
  the apparent radii as half-number radii, of Dias et al. (2002, A&A 389, 871).

Clusters follow Plummer's surface density (1 + r^2/a^2)^-2, where half of the stars lie within a.
Numbers rise by 0.35 dex in a magnitude, in open clusters by 0.18. Members differ from the field
only in place and magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..columns import HEALPIX_ORDER
from ..geometry.sphere import directions, separation_rad
from ..partition import positions_of
from ..star_counts import EDGES_G_MAG

PIXEL_DEG = 58.632  # side of the one pixel of order 0, sqrt(4 pi / 12) rad
FINEST_ORDER = 12
SLOPE_DEX_MAG, OPEN_SLOPE_DEX_MAG = 0.35, 0.18
CUT_OFF_SCALES = 5.0


@dataclass(frozen=True)
class Crowd:
    """A cluster or galaxy: `stars` of it are in DR2, of G from `brightest_g_mag` to 21.

    radius_deg : that holds half of the stars (cluster), or the scale length (cloud).
    """

    name: str
    ra_deg: float
    dec_deg: float
    radius_deg: float
    edge_deg: float
    stars: float
    brightest_g_mag: float
    slope_dex_mag: float = SLOPE_DEX_MAG
    cloud: bool = False


def _globular(
    name: str,
    ra_deg: float,
    dec_deg: float,
    half_arcmin: float,
    edge_arcmin: float,
    stars: float,
    distance_kpc: float,
) -> Crowd:
    tip_g_mag = 5.0 * float(np.log10(distance_kpc * 100.0)) - 2.5
    return Crowd(name, ra_deg, dec_deg, half_arcmin / 60, edge_arcmin / 60, stars, tip_g_mag)


def _open(
    name: str, ra_deg: float, dec_deg: float, diameter_arcmin: float, stars: float, g_mag: float
) -> Crowd:
    radius_deg = diameter_arcmin / 240.0
    edge_deg, slope = CUT_OFF_SCALES * radius_deg, OPEN_SLOPE_DEX_MAG
    return Crowd(name, ra_deg, dec_deg, radius_deg, edge_deg, stars, g_mag, slope)


CROWDS = (
    Crowd("LMC", 81.28, -69.78, 1.6, 8.0, 11.2e6, 10.0, cloud=True),
    Crowd("SMC", 12.80, -73.15, 1.0, 5.0, 1.7e6, 11.0, cloud=True),
    _globular("NGC 104 (47 Tuc)", 6.0236, -72.0813, 3.17, 40.0, 53233, 4.50),
    _globular("NGC 3201", 154.4034, -46.4125, 3.10, 25.0, 17255, 4.70),
    _globular("NGC 5139 (omega Cen)", 201.6968, -47.4796, 5.00, 40.0, 71875, 5.49),
    _globular("NGC 5272 (M 3)", 205.5484, 28.3773, 2.31, 30.0, 12385, 10.20),
    _globular("NGC 5904 (M 5)", 229.6384, 2.0810, 1.77, 25.0, 12561, 7.49),
    _globular("NGC 6121 (M 4)", 245.8967, -26.5257, 4.33, 30.0, 15878, 1.86),
    _globular("NGC 6205 (M 13)", 250.4218, 36.4599, 1.69, 25.0, 13115, 7.53),
    _globular("NGC 6397", 265.1754, -53.6743, 2.90, 25.0, 19783, 2.53),
    _globular("NGC 6656 (M 22)", 279.0998, -23.9047, 3.36, 20.0, 11141, 3.30),
    _globular("NGC 6752", 287.7171, -59.9846, 1.91, 25.0, 21165, 4.21),
    _open("Pleiades", 56.75, 24.12, 120.0, 1326, 3.0),
    _open("Praesepe", 130.10, 19.67, 70.0, 938, 6.0),
    _open("NGC 2516", 119.52, -60.75, 30.0, 2518, 5.5),
    _open("NGC 3532", 166.41, -58.75, 50.0, 1879, 6.0),
)


@lru_cache(maxsize=64)
def pixels_of(crowd: Crowd) -> tuple[int, NDArray[np.int64], NDArray[np.float64]]:
    """Where a crowd's stars lie: HEALPix order, nested pixels ascending, share of its stars in it.

    The order is the first whose pixels are a quarter of the radius or smaller, at most 12; inside a
    pixel the density is constant.
    """
    import healpy

    order = int(np.ceil(np.log2(4.0 * PIXEL_DEG / crowd.radius_deg)))
    order = min(order, FINEST_ORDER)
    centre = directions(crowd.ra_deg, crowd.dec_deg)
    pixels = healpy.query_disc(1 << order, centre, np.radians(crowd.edge_deg), nest=True)
    pixels = np.sort(pixels).astype(np.int64)
    below = 2 * (HEALPIX_ORDER - order)
    places = directions(*positions_of((pixels << below) + (3 << (below - 2))))
    scaled = np.degrees(separation_rad(places, centre)) / crowd.radius_deg
    density = np.exp(-scaled) if crowd.cloud else (1.0 + scaled**2) ** -2
    return order, pixels, density / density.sum()


def interval_shares(crowd: Crowd) -> NDArray[np.float64]:
    """Share of a crowd's stars in each interval of EDGES_G_MAG."""
    edges = np.maximum(EDGES_G_MAG, crowd.brightest_g_mag)
    brighter = 10 ** (crowd.slope_dex_mag * (edges - EDGES_G_MAG[-1]))
    shares = np.diff(brighter)
    return np.asarray(shares / shares.sum())
