"""Eclipses beyond the plain case: limb darkening, the oblate Earth, and the Moon before the Sun."""

from __future__ import annotations

import erfa.ufunc as era
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.constants import (
    ASTRONOMICAL_UNIT_M,
    EARTH_EQUATORIAL_RADIUS_M,
    EARTH_FLATTENING,
    SUN_RADIUS_M,
)
from pipeline.physics.vectors import angular_radius, separation, unit

Array = NDArray[np.float64]

MOON_RADIUS_M = 1_737_400.0  # mean radius, IAU WGCCRE 2015 (Archinal et al. 2018)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)
# Nodes z on 0 to 1, crowded at 1, where the covered arc and the limb's light have roots.
_Z = 1.0 - 0.25 * np.square(1.0 - _NODES)
_SHARE = 0.5 * (1.0 - _NODES) * _WEIGHTS * _Z


def uncovered_fraction(
    sun_radius_rad: ArrayLike,
    body_radius_rad: ArrayLike,
    distance_rad: ArrayLike,
    limb_darkening: float = 0.0,
) -> Array:
    """Share (n,) of the Sun's light that passes a round body before it, in [0, 1].

    Rings about the Sun's centre: the half arc t of a ring of radius q behind the body obeys
    cos b = cos c cos q + sin c sin q cos t (exact on the sphere), and the surface shines like
    1 - u (1 - mu), mu^2 = 1 - (q/a)^2 (linear limb darkening; u about 0.6 in V). Rings wholly
    behind or free are added in closed form, the rest by 32 nodes: error below 1e-6.

    sun_radius_rad a, body_radius_rad b, distance_rad c of the centres, as seen from the target
    """
    a, b, c = (
        np.atleast_1d(np.asarray(v, float)) for v in (sun_radius_rad, body_radius_rad, distance_rad)
    )
    a, b, c = np.broadcast_arrays(a, b, c)
    inner, outer = np.minimum(np.abs(c - b), a), np.minimum(c + b, a)
    whole = np.where(c < b, _light_within(inner / a, limb_darkening), 0.0)
    # q^2 even in z: the arc is smooth in z where it begins, however near the Sun's centre
    span = outer * outer - inner * inner
    q = np.sqrt((inner * inner)[..., None] + span[..., None] * _Z * _Z)
    b_, c_ = b[..., None], c[..., None]
    # 1 - cos t = [cos(c - q) - cos b] / (sin c sin q), the difference as a product
    apart = np.abs(c_ - q)
    rise = 2.0 * np.sin(0.5 * (b_ + apart)) * np.sin(0.5 * (b_ - apart))
    half = 0.5 * rise / np.maximum(np.sin(c_) * np.sin(q), 1e-300)
    arc = 2.0 * np.arcsin(np.sqrt(np.clip(half, 0.0, 1.0)))
    x = q / a[..., None]
    mu = np.sqrt(np.clip(1.0 - x * x, 0.0, 1.0))
    shine = (1.0 - limb_darkening * (1.0 - mu)) * arc / np.pi
    partly = np.sum(shine * _SHARE, axis=-1) * span / (a * a)
    covered = (whole + partly) / _light_within(np.ones(1), limb_darkening)
    lit = np.where(c >= a + b, 1.0, np.clip(1.0 - covered, 0.0, 1.0))
    return np.where(c <= b - a, 0.0, lit)


def _light_within(x: Array, u: float) -> Array:
    """Light within a share x of the Sun's radius: the integral of (1 - u + u mu) x dx from 0."""
    return 0.5 * (1.0 - u) * x * x + u / 3.0 * (1.0 - np.clip(1.0 - x * x, 0.0, 1.0) ** 1.5)


def sunlit_past_earth(
    target_geocentric_m: Array,
    sun_from_earth_m: Array,
    limb_darkening: float = 0.0,
    oblate: bool = False,
) -> Array:
    """Fraction (n,) of sunlight that passes the Earth, with limb darkening and flattening.

    oblate : the limb is that of the WGS 84 ellipsoid where it is nearest to the Sun (exact in
        the plane of target, Sun and Earth's centre), taken for the round limb of that radius; its
        slant and curvature change the fraction by less than 1e-4. GCRS z stands for the Earth's
        axis (precession: 0.3 degree by 2050, 60 m of the limb).
    Places as in `eclipse.sunlit_fraction`.
    """
    target = np.atleast_2d(np.asarray(target_geocentric_m, float))
    to_sun = np.asarray(sun_from_earth_m, float) - target
    a = angular_radius(SUN_RADIUS_M, to_sun)
    b = angular_radius(EARTH_EQUATORIAL_RADIUS_M, target)
    if oblate:
        b = _limb_angle(target, to_sun)
    return uncovered_fraction(a, b, separation(to_sun, -target), limb_darkening)


def _limb_angle(target: Array, to_sun: Array) -> Array:
    """Angle (n,) from the Earth's centre to the ellipsoid's limb on the side of the Sun.

    With z over 1 - f the ellipsoid is a sphere. Directions are d = cos b (-r) + sin b t; the ray
    grazes where (r.d)^2 = d.d (r.r - R^2): a quadratic for tan b.
    """
    down = unit(-target)
    across = to_sun - np.sum(to_sun * down, -1, keepdims=True) * down
    scale = np.array([1.0, 1.0, 1.0 / (1.0 - EARTH_FLATTENING)])
    r, p, t = target * scale, down * scale, unit(across) * scale
    rr = np.sum(r * r, -1) - EARTH_EQUATORIAL_RADIUS_M**2
    rp, rt = np.sum(r * p, -1), np.sum(r * t, -1)
    two = rt * rt - rr * np.sum(t * t, -1)
    one = rp * rt - rr * np.sum(p * t, -1)
    zero = rp * rp - rr * np.sum(p * p, -1)
    root = np.sqrt(np.maximum(one * one - two * zero, 0.0))
    # two < 0 < zero outside the Earth: one positive root
    inside = (rr <= 0.0) | (two >= 0.0)
    tangent = (-one - root) / np.where(inside, -1.0, two)
    return np.where(inside, 0.5 * np.pi, np.arctan(tangent))


def sunlit_past_moon(
    target_geocentric_m: Array,
    sun_from_earth_m: Array,
    moon_from_earth_m: Array,
    limb_darkening: float = 0.0,
) -> Array:
    """Fraction (n,) of sunlight that passes the Moon; 1 with the Moon elsewhere.

    A round Moon of 1737.4 km. With `moon_m` (good to some 20 km) contacts are off by up to 20 s.
    """
    target = np.atleast_2d(np.asarray(target_geocentric_m, float))
    to_sun = np.asarray(sun_from_earth_m, float) - target
    to_moon = np.asarray(moon_from_earth_m, float) - target
    a, b = angular_radius(SUN_RADIUS_M, to_sun), angular_radius(MOON_RADIUS_M, to_moon)
    behind = np.sum(to_moon * to_moon, -1) > np.sum(to_sun * to_sun, -1)
    free = uncovered_fraction(a, b, separation(to_sun, to_moon), limb_darkening)
    return np.where(behind, 1.0, free)


def moon_m(tt1: ArrayLike, tt2: ArrayLike) -> Array:
    """Geocentric Moon (n, 3) [m], GCRS axes: ERFA moon98 (Meeus 1998 after ELP-2000/82)."""
    return np.asarray(era.moon98(np.atleast_1d(tt1), np.atleast_1d(tt2))["p"]) * ASTRONOMICAL_UNIT_M
