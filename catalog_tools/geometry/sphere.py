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
    v = np.empty((*np.broadcast_shapes(ra.shape, dec.shape), 3))
    v[..., 0], v[..., 1], v[..., 2] = c * np.cos(ra), c * np.sin(ra), np.sin(dec)
    return v


def angles_deg(v: Floats) -> tuple[Floats, Floats]:
    """Right ascension in [0, 360) and declination [deg] of vectors (..., 3) of any length."""
    ra = np.degrees(np.arctan2(v[..., 1], v[..., 0])) % 360.0
    dec = np.degrees(np.arctan2(v[..., 2], np.hypot(v[..., 0], v[..., 1])))
    return np.where(ra >= 360.0, 0.0, ra), dec


def separation_rad(a: Floats, b: Floats) -> Floats:
    """Angle between vectors (..., 3) [rad], exact from 0 to pi: atan2(|a x b|, a.b)."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return np.arctan2(np.sqrt(x * x + y * y + z * z), ax * bx + ay * by + az * bz)


def cap_of(v: Floats) -> tuple[Floats, float]:
    """Centre (3,) and radius [rad] of a cap that holds all unit vectors (n, 3), n >= 1.

    The centre is the direction of the mean, not the smallest cap's; 1e-9 rad (0.2 mas) is added
    to the radius so that rounding can't put a member outside.
    """
    centre = _mean_direction(v, np.ones(len(v)))
    chord = v - centre
    half = 0.5 * float(np.sqrt(np.einsum("ij,ij->i", chord, chord).max()))
    # Past a right angle the arcsine loses digits: there the whole sky costs nothing.
    radius = np.pi if half > 0.9 else 2.0 * float(np.arcsin(half)) + 1e-9
    return centre, radius


def cap_of_caps(centres: Floats, radii_rad: Floats, weights: Floats) -> tuple[Floats, float]:
    """Centre (3,) and radius [rad] of a cap that holds caps (n, 3), (n,)."""
    centre = _mean_direction(centres, weights)
    return centre, min(float((separation_rad(centres, centre) + radii_rad).max()), np.pi)


def _mean_direction(v: Floats, weights: Floats) -> Floats:
    """Direction of the weighted mean of unit vectors (n, 3); the pole where they cancel out."""
    mean = np.average(v, axis=0, weights=weights)
    length = float(np.sqrt(mean @ mean))
    return mean / length if length > 1e-12 else np.array([0.0, 0.0, 1.0])


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
