"""Directions on the sky as unit vectors: angles, separations, straight-line space motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

MAS_RAD = np.pi / 648_000_000.0
AU_KM_YR_S = 4.740470446  # one au a Julian year in km/s (IAU 2012 B2 au, 365.25 days)


def directions(ra_deg: ArrayLike, dec_deg: ArrayLike) -> Floats:
    """Unit vectors (..., 3) of right ascension and declination [deg], ICRS."""
    ra, dec = np.radians(np.asarray(ra_deg, float)), np.radians(np.asarray(dec_deg, float))
    c = np.cos(dec)
    return np.stack([c * np.cos(ra), c * np.sin(ra), np.sin(dec)], axis=-1)


def angles_deg(v: Floats) -> tuple[Floats, Floats]:
    """Right ascension in [0, 360) and declination [deg] of vectors (..., 3) of any length."""
    ra = np.degrees(np.arctan2(v[..., 1], v[..., 0])) % 360.0
    dec = np.degrees(np.arctan2(v[..., 2], np.hypot(v[..., 0], v[..., 1])))
    return np.where(ra >= 360.0, 0.0, ra), dec


def separation_rad(a: Floats, b: Floats) -> Floats:
    """Angle between vectors (..., 3) [rad], exact from 0 to pi: atan2(|a x b|, a.b)."""
    cross = np.cross(a, b)
    return np.arctan2(np.sqrt(np.sum(cross * cross, axis=-1)), np.sum(a * b, axis=-1))


def cap_of(v: Floats) -> tuple[tuple[float, float, float], float]:
    """Centre and radius [rad] of a cap that holds all unit vectors (n, 3), n >= 1.

    The centre is the direction of the mean, not the smallest cap's; 1e-9 rad (0.2 mas) is added
    to the radius so that rounding can't put a member outside.
    """
    mean = v.mean(axis=0)
    length = float(np.sqrt(mean @ mean))
    centre = mean / length if length > 1e-12 else np.array([0.0, 0.0, 1.0])
    radius = float(separation_rad(v, centre).max()) + 1e-9
    return (float(centre[0]), float(centre[1]), float(centre[2])), min(radius, np.pi)


def moved(
    ra_deg: Floats,
    dec_deg: Floats,
    pmra_mas_yr: Floats,
    pmdec_mas_yr: Floats,
    years: float,
    parallax_mas: Floats | None = None,
    radial_velocity_km_s: Floats | None = None,
) -> Floats:
    """Barycentric directions (n, 3) after `years` of straight, uniform space motion.

    u = r + t (p mu_a* + q mu_d + r mu_r), normalised, with p east, q north and
    mu_r = v_r plx / A_v (SOFA starpm without its light-time terms; under 1 mas for Barnard's star
    over a century). `pmra_mas_yr` includes cos(dec), as Gaia gives it. Motions that are NaN count
    as zero; the radial term needs a positive parallax and a radial velocity.
    """
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    east = np.stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)], axis=-1)
    north = np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)], axis=-1)
    r = directions(ra_deg, dec_deg)
    mu_east = np.nan_to_num(np.asarray(pmra_mas_yr, float)) * MAS_RAD * years
    mu_north = np.nan_to_num(np.asarray(pmdec_mas_yr, float)) * MAS_RAD * years
    radial = np.ones_like(ra)
    if parallax_mas is not None and radial_velocity_km_s is not None:
        plx = np.maximum(np.nan_to_num(np.asarray(parallax_mas, float)), 0.0) * MAS_RAD
        radial += np.nan_to_num(np.asarray(radial_velocity_km_s, float)) / AU_KM_YR_S * plx * years
    u = radial[:, None] * r + mu_east[:, None] * east + mu_north[:, None] * north
    length: Floats = np.sqrt(np.sum(u * u, axis=-1, keepdims=True))
    return u / length
