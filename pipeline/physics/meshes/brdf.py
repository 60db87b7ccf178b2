"""Reflection of surfaces: Lambert, Phong, Cook-Torrance and Ashikhmin-Shirley as BRDFs [1/sr].

All functions take unit vectors (..., 3) in one frame: `normal`, `sun` (towards the light) and
`observer`, and give the ratio of reflected radiance to irradiance, (...,) in 1/sr; 0 where Sun or
observer stand behind the surface. All are reciprocal (sun and observer may be exchanged), and none
reflects more light than falls on it as long as its weights sum to at most 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.vectors import unit

Array = NDArray[np.float64]


def lambert(normal: ArrayLike, sun: ArrayLike, observer: ArrayLike, albedo: ArrayLike) -> Array:
    """albedo / pi: the same brightness from everywhere (Lambert 1760)."""
    mu_i, mu_o = _cosines(normal, sun, observer)
    return _front(mu_i, mu_o, np.asarray(albedo, float) / np.pi)


def phong(
    normal: ArrayLike,
    sun: ArrayLike,
    observer: ArrayLike,
    diffuse: ArrayLike,
    specular: ArrayLike,
    exponent: ArrayLike,
) -> Array:
    """diffuse/pi + specular (n + 2)/(2 pi) cos^n(a), a the angle from the mirror's direction.

    The normalised form of Lafortune & Willems (1994, CW 197, eq. 10): at most diffuse + specular
    of the light is reflected, and at normal incidence exactly so.
    """
    mu_i, mu_o = _cosines(normal, sun, observer)
    n = np.asarray(exponent, float)
    # mirror direction 2 (n.s) n - s, dotted with the observer's
    mirror = np.maximum(2.0 * mu_i * mu_o - _dot(sun, observer), 0.0)
    lobe = (n + 2.0) / (2.0 * np.pi) * np.minimum(mirror, 1.0) ** n
    return _front(mu_i, mu_o, np.asarray(diffuse) / np.pi + np.asarray(specular) * lobe)


def cook_torrance(
    normal: ArrayLike,
    sun: ArrayLike,
    observer: ArrayLike,
    diffuse: ArrayLike,
    roughness: ArrayLike,
    index: complex | None = None,
    normal_reflectance: ArrayLike = 0.04,
) -> Array:
    """Microfacets: F D G / (4 mu_i mu_o), over a diffuse base that gets what F lets through.

    D : GGX of width `roughness` (alpha), G : Smith's, correlated in height (Walter et al. 2007,
    EGSR, eq. 33; Heitz 2014, JCGT 3(2), eq. 99); Cook & Torrance 1982, ACM ToG 1, 7. F : Fresnel's
    formula of unpolarised light for a refractive index n + ik where it is given, else
    Schlick's with the reflectance at normal incidence. Base: diffuse/pi (1 - F(mu_i))(1 - F(mu_o)).
    """
    n, s, o = (np.asarray(v, float) for v in (normal, sun, observer))
    mu_i, mu_o = _cosines(n, s, o)
    half = unit(s + o)
    mu_h, mu_d = np.clip(_dot(n, half), 0.0, 1.0), np.clip(_dot(s, half), 0.0, 1.0)
    a2 = np.square(np.asarray(roughness, float))
    sine2 = np.maximum(1.0 - mu_h * mu_h, 0.0)
    spread = a2 / (np.pi * np.square(sine2 + a2 * mu_h * mu_h))
    ci, co = np.maximum(mu_i, 1e-12), np.maximum(mu_o, 1e-12)
    # G / (4 mu_i mu_o) = 1 / (2 (mu_o root_i + mu_i root_o))
    root_i, root_o = (np.sqrt(a2 + (1.0 - a2) * c * c) for c in (ci, co))
    gloss = spread / (2.0 * (co * root_i + ci * root_o))

    def mirror(cosine: Array) -> Array:
        if index is not None:
            return fresnel(cosine, index)
        return schlick(cosine, normal_reflectance)

    base = np.asarray(diffuse) / np.pi * (1.0 - mirror(ci)) * (1.0 - mirror(co))
    return _front(mu_i, mu_o, mirror(mu_d) * gloss + base)


def ashikhmin_shirley(
    normal: ArrayLike,
    sun: ArrayLike,
    observer: ArrayLike,
    diffuse: ArrayLike,
    specular: ArrayLike,
    exponent_u: ArrayLike,
    exponent_v: ArrayLike,
    grain: ArrayLike = (1.0, 0.0, 0.0),
) -> Array:
    """Brushed and glossy surfaces: Ashikhmin & Shirley 2000, J. Graphics Tools 5(2), eqs. 4, 5.

    grain : (..., 3) direction u; it is laid onto the surface. exponent_u widens the highlight
    along it, exponent_v across it.
    """
    n, s, o = (np.asarray(v, float) for v in (normal, sun, observer))
    mu_i, mu_o = _cosines(n, s, o)
    half = unit(s + o)
    mu_h, mu_d = np.clip(_dot(n, half), 0.0, 1.0), np.clip(_dot(s, half), 1e-12, 1.0)
    nu, nv = np.asarray(exponent_u, float), np.asarray(exponent_v, float)
    u = _laid_on(n, np.asarray(grain, float))
    hu2 = np.square(_dot(u, half))
    hv2 = np.square(_dot(np.cross(n, u), half))
    sine2 = hu2 + hv2
    power = np.where(sine2 > 0.0, (nu * hu2 + nv * hv2) / np.where(sine2 > 0.0, sine2, 1.0), 0.0)
    top = np.maximum(np.maximum(mu_i, mu_o), 1e-12)
    rs = np.asarray(specular, float)
    gloss = np.sqrt((nu + 1.0) * (nv + 1.0)) / (8.0 * np.pi) * mu_h**power / (mu_d * top)
    gloss = gloss * schlick(mu_d, rs)
    ci, co = np.clip(mu_i, 0.0, 1.0), np.clip(mu_o, 0.0, 1.0)
    base = 28.0 * np.asarray(diffuse) / (23.0 * np.pi) * (1.0 - rs)
    base = base * (1.0 - (1.0 - 0.5 * ci) ** 5) * (1.0 - (1.0 - 0.5 * co) ** 5)
    return _front(mu_i, mu_o, gloss + base)


def schlick(cosine: ArrayLike, normal_reflectance: ArrayLike) -> Array:
    """Reflectance F0 + (1 - F0)(1 - cos)^5 of a smooth surface (Schlick 1994, CGF 13, 233)."""
    low = np.asarray(normal_reflectance, float)
    return np.asarray(low + (1.0 - low) * (1.0 - np.asarray(cosine, float)) ** 5)


def fresnel(cosine: ArrayLike, index: complex) -> Array:
    """Reflectance of unpolarised light from a smooth surface of refractive index n + ik in vacuum.

    Born & Wolf, Principles of Optics, section 1.5.2, with a complex index (14.2 for metals).
    """
    c = np.asarray(cosine, float)
    m = complex(index)
    inside = np.sqrt(1.0 - (1.0 - c * c) / (m * m) + 0j)
    rs = (c - m * inside) / (c + m * inside)
    rp = (m * c - inside) / (m * c + inside)
    return np.asarray(0.5 * (np.abs(rs) ** 2 + np.abs(rp) ** 2))


def _dot(a: ArrayLike, b: ArrayLike) -> Array:
    return np.asarray(np.sum(np.asarray(a, float) * np.asarray(b, float), axis=-1))


def _cosines(normal: ArrayLike, sun: ArrayLike, observer: ArrayLike) -> tuple[Array, Array]:
    return _dot(normal, sun), _dot(normal, observer)


def _front(mu_i: Array, mu_o: Array, value: ArrayLike) -> Array:
    return np.where((mu_i > 0.0) & (mu_o > 0.0), value, 0.0)


def _laid_on(normal: Array, grain: Array) -> Array:
    """Unit directions on surfaces, as near as can be to the grain; any one where it is normal."""
    n, g = np.broadcast_arrays(normal, grain)
    flat = g - _dot(n, g)[..., None] * n
    lost = np.sum(flat * flat, -1) < 1e-18 * np.maximum(np.sum(g * g, -1), 1e-300)
    if np.any(lost):
        other = np.eye(3)[np.argmin(np.abs(n), axis=-1)]
        flat = np.where(lost[..., None], other - _dot(n, other)[..., None] * n, flat)
    return unit(flat)
