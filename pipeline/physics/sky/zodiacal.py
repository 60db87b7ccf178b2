"""Zodiacal light with the gegenschein: a published table, its colour, its fall with distance.

Leinert et al. 1998, A&AS 127, 1: table 17 (500 nm, seen from 1 au), equation 22 (colour). What the
table's authors say of its error: about 10%. Omitted: the tilt of the dust's plane of symmetry (up
to 3 degrees; it swings the brightness at the ecliptic poles by 10% over the year), dust bands, and
the small seasonal change of the Earth's distance but for the factor below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import ARCSEC_RAD, DEG_RAD
from pipeline.physics.radiometry import ResponseCurve, photon_integral
from pipeline.physics.vectors import separation, to_angles, unit

Array = NDArray[np.float64]

TABLE_ENDS_RAD = 15.0 * DEG_RAD  # from the Sun; nearer, the table has no values
INNERMOST_RAD = 14.1 * DEG_RAD  # its innermost value stands at 14.11 degrees: 10 in both axes
NEAREST_RAD = 2.0 * DEG_RAD  # where the extrapolation ends: the Sun's corona begins
FALL = 2.3  # towards the Sun in angle (fits the table's inner values), and with distance
LEAST_AU, MOST_AU = 0.3, 3.0  # where the distance law was measured (Helios, Pioneer 10)
# Above or below the dust's plane, as seen from the Sun: up to where the light differs by no more
# than the table's own error, and up to where it is drawn at all.
IN_PLANE_RAD, MOST_OFF_PLANE_RAD = 3.0 * DEG_RAD, 30.0 * DEG_RAD
OFF_PLANE_FALL = 2.1  # dust falls as exp(-2.1 |sin|): Leinert et al. 1981
OBLIQUITY_RAD = 84_381.406 * ARCSEC_RAD  # J2000.0, IAU 2006
_S, _C = np.sin(OBLIQUITY_RAD), np.cos(OBLIQUITY_RAD)
ECLIPTIC = np.array([[1.0, 0.0, 0.0], [0.0, _C, _S], [0.0, -_S, _C]])  # its axes in ICRS
REFERENCE_M, REFERENCE_HALF_M = 500e-9, 10e-9
BLUE_NEAR, BLUE_FAR, RED_NEAR, RED_FAR = 1.2, 0.9, 0.8, 0.6  # slopes of equation 22
NEAR_RAD, FAR_RAD = 30.0 * DEG_RAD, 90.0 * DEG_RAD  # elongations where they hold


@dataclass(frozen=True, eq=False)
class ZodiacalTable:
    """A table over |longitude from the Sun| (rows) and |latitude| (columns), made smooth.

    longitude_rad (n,), latitude_rad (m,), ascending from 0
    smooth : (n, m) ln(W m-2 sr-1 um-1) + FALL ln sin(elongation / 2); finite also where the table
        has no value, so that interpolation beside those cells does not break
    """

    longitude_rad: Array
    latitude_rad: Array
    smooth: Array


def zodiacal_table(longitude_deg: Array, latitude_deg: Array, radiance_1e8: Array) -> ZodiacalTable:
    """From published values (n, m) in 1e-8 W m-2 sr-1 um-1, NaN where there is none.

    Near the Sun the missing ones take `smooth` from the innermost published values around it, at
    the same position angle.
    """
    lon, lat = np.asarray(longitude_deg) * DEG_RAD, np.asarray(latitude_deg) * DEG_RAD
    x, y = np.meshgrid(lon, lat, indexing="ij")
    half = np.sin(0.5 * elongation(x, y))
    with np.errstate(divide="ignore", invalid="ignore"):
        smooth = np.log(np.asarray(radiance_1e8) * 1e-8) + FALL * np.log(half)
    known = np.isfinite(smooth)
    missing = ~known
    beside = np.zeros_like(known)
    beside[1:] |= missing[:-1]
    beside[:, 1:] |= missing[:, :-1]
    beside &= known
    angle = np.arctan2(y, x)
    order = np.argsort(angle[beside])
    smooth[missing] = np.interp(angle[missing], angle[beside][order], smooth[beside][order])
    return ZodiacalTable(lon, lat, smooth)


def elongation(longitude_rad: Array, latitude_rad: Array) -> Array:
    """Angle from the Sun [rad] of a longitude from the Sun and a latitude; exact from 0 to pi."""
    across = np.hypot(np.sin(latitude_rad), np.cos(latitude_rad) * np.sin(longitude_rad))
    return np.arctan2(across, np.cos(latitude_rad) * np.cos(longitude_rad))


def sun_coordinates(directions: Array, sun: Array) -> tuple[Array, Array, Array]:
    """Ecliptic longitude from the Sun, ecliptic latitude, and angle from the Sun [rad], (n,) each.

    directions : (n, 3) unit vectors, ICRS; sun : (3,) vector from the observer to the Sun
    """
    lon, lat = to_angles(directions @ ECLIPTIC.T)
    sun_lon, _ = to_angles(ECLIPTIC @ sun)
    return lon - sun_lon, lat, separation(directions, unit(sun)[None])


def off_plane_rad(sun: Array) -> float:
    """Angle of an observer above or below the ecliptic, as the Sun sees it; sun : (3,) likewise."""
    return abs(float(to_angles(ECLIPTIC @ sun)[1]))


def radiance_500(table: ZodiacalTable, longitude_rad: Array, latitude_rad: Array) -> Array:
    """Radiance (n,) at 500 nm from 1 au, W m-2 sr-1 um-1: the table's values to rounding.

    Between them ln(radiance) + 2.3 ln sin(elongation / 2) is bilinear in both coordinates. Leaving
    every second row and column out changes values from 15 degrees on by 9% at most, so that between
    neighbours it errs by about 2% (tests). Nearer to the Sun than the innermost value (14 degrees)
    it falls as sin(elongation / 2)^-2.3 from there on, at each position angle.
    """
    lon = np.abs(np.arctan2(np.sin(longitude_rad), np.cos(longitude_rad)))
    lat = np.abs(latitude_rad)
    from_sun = elongation(lon, lat)
    half = np.sin(0.5 * from_sun)
    lon, lat = _outside(lon, lat, from_sun < INNERMOST_RAD)
    i, u = place_between(table.longitude_rad, lon)
    j, v = place_between(table.latitude_rad, lat)
    low = (1.0 - v) * table.smooth[i, j] + v * table.smooth[i, j + 1]
    high = (1.0 - v) * table.smooth[i + 1, j] + v * table.smooth[i + 1, j + 1]
    return np.exp((1.0 - u) * low + u * high) / np.maximum(half, 1e-3) ** FALL


def distance_factor(distance_au: Array | float) -> Array:
    """Radiance at a distance from the Sun over that at 1 au, the same angles from it: R^-2.3.

    Leinert et al. 1981, A&A 103, 177: -2.3 +- 0.05 from 0.3 to 1 au (Helios), the steeper at large
    elongations; beyond 1 au it is extrapolated. For observers near the dust's plane.
    """
    return np.asarray(distance_au, float) ** -FALL


def colour(wavelength_m: Array, far: bool) -> Array:
    """Ratio (n,) of zodiacal to solar spectrum, 1 at 500 nm (equation 22, 220 to 2500 nm).

    far : at 90 degrees from the Sun and beyond, else at 30 degrees and nearer
    """
    blue, red = (BLUE_FAR, RED_FAR) if far else (BLUE_NEAR, RED_NEAR)
    log = np.log10(np.asarray(wavelength_m) / REFERENCE_M)
    return 1.0 + np.where(log < 0.0, blue, red) * log


def band_rates(
    wavelength_m: Array, sun_w_m3: Array, response: ResponseCurve
) -> tuple[float, float]:
    """Electrons/s/m2/sr for a radiance of 1 W m-2 sr-1 um-1 at 500 nm: near the Sun, and far.

    wavelength_m, sun_w_m3 : (n,) solar spectrum at 1 au, W/m2/m. Its own level at 500 nm is its
    mean from 490 to 510 nm: the table stands for a smooth spectrum, not for a line.
    """
    edges = REFERENCE_M + REFERENCE_HALF_M * np.array([-1.0, 1.0])
    inside = wavelength_m[(wavelength_m > edges[0]) & (wavelength_m < edges[1])]
    grid = np.concatenate([edges[:1], inside, edges[1:]])
    level = np.trapezoid(np.interp(grid, wavelength_m, sun_w_m3), grid) / (edges[1] - edges[0])
    shape = sun_w_m3 / level * 1e6  # W m-2 sr-1 um-1 to W m-2 sr-1 m-1
    near, far = (
        photon_integral(wavelength_m, shape * colour(wavelength_m, f), response)
        for f in (False, True)
    )
    return near, far


def band_radiance(radiance: Array, elongation_rad: Array, rates: tuple[float, float]) -> Array:
    """Electrons/s/m2/sr (n,) of a radiance at 500 nm; the colour is linear in elongation between
    30 and 90 degrees."""
    share = np.clip((elongation_rad - NEAR_RAD) / (FAR_RAD - NEAR_RAD), 0.0, 1.0)
    return radiance * ((1.0 - share) * rates[0] + share * rates[1])


def _outside(lon: Array, lat: Array, inside: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Longitude and latitude, moved away from the Sun to INNERMOST_RAD where they are inside."""
    angle = np.arctan2(np.sin(lat), np.cos(lat) * np.sin(lon))
    s, c = np.sin(INNERMOST_RAD), np.cos(INNERMOST_RAD)
    out_lat = np.arctan2(s * np.sin(angle), np.hypot(c, s * np.cos(angle)))
    out_lon = np.arctan2(s * np.cos(angle), c)
    return np.where(inside, out_lon, lon), np.where(inside, out_lat, lat)


def place_between(nodes: Array, value: Array) -> tuple[NDArray[np.intp], Array]:
    """The interval of each value (n,), and where in it: 0 to 1."""
    i = np.clip(np.searchsorted(nodes, value, side="right") - 1, 0, nodes.size - 2)
    return i, np.clip((value - nodes[i]) / (nodes[i + 1] - nodes[i]), 0.0, 1.0)
