"""What a sensor sees of objects row by row: place, light, signal, and whether it may look there."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import (
    ARCSEC_RAD,
    DEG_RAD,
    EARTH_ROTATION_RAD_S,
    SPEED_OF_LIGHT_M_S,
)
from pipeline.physics.positions.apparent import aberrate
from pipeline.physics.positions.refraction import refract
from pipeline.physics.sky.moon import SUN_V_MAG
from pipeline.physics.targets.eclipse import sunlit_fraction
from pipeline.physics.targets.lighting import phase_angle, photon_rate_at_aperture, sun_distance
from pipeline.physics.targets.sphere import sphere_intensity_per_irradiance
from pipeline.physics.vectors import unit
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.pointing.pointing import LocalPointing, RatePointing
from pipeline.survey.watch import Watcher, WatchMoments

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Sights:
    """Rows of what is seen, (r,) and (r, 3) each.

    row : which of those asked for; moment, object : indices; geometric, observed : directions in
    TEME axes, without aberration and as the camera sees it; range_m : from emission; elevation :
    observed [rad] (of a satellite: above its horizontal plane); rate : against the stars [rad/s];
    phase [rad], sunlit; light : of that of the Sun at 1 au, above the air; light_e : electrons of
    an exposure; streak_px; snr : of a frame
    """

    row: Index
    moment: Index
    object: Index
    geometric: Array
    observed: Array
    range_m: Array
    elevation: Array
    rate: Array
    phase: Array
    sunlit: Array
    light: Array
    light_e: Array
    streak_px: Array
    sky_e_s: Array
    snr: Array

    def __len__(self) -> int:
        return len(self.moment)

    @property
    def v_mag(self) -> Array:
        """Magnitude in V above the air (r,)."""
        return SUN_V_MAG - 2.5 * np.log10(self.light)

    @property
    def rate_arcsec_s(self) -> Array:
        """Rate against the stars (r,)."""
        return self.rate / ARCSEC_RAD

    def take(self, which: NDArray[np.bool_] | Index) -> Sights:
        """Some of the rows."""
        return Sights(*(getattr(self, f.name)[which] for f in fields(self)))


def sights_of(
    watcher: Watcher,
    watch: WatchMoments,
    moment: Index,
    object_: Index,
    place_m: Array,
    speed_m_s: Array,
    reflecting_m2: Array,
    shaded: NDArray[np.bool_],
) -> Sights:
    """Sights of objects at places (r, 3) [m] with velocities (r, 3) [m/s], TEME, at moments (r,):
    of those that may be looked at.

    The light path is solved with the velocity at reception (0.5 a t^2: 2 mm off at GEO); aberration
    is the observer's about the Earth's centre: the annual one is shared with the stars.
    reflecting_m2, shaded : (r,) of the objects (`Elements`)
    """
    emitted, path, range_m = _light_path(place_m, speed_m_s, watch.observer_m[moment])
    geometric = path / range_m[:, None]
    observed, elevation = _observed(watcher, watch, moment, geometric)
    row = np.flatnonzero(allowed(watcher, watch, moment, geometric, elevation))
    moment, object_, shaded = moment[row], object_[row], shaded[row]
    emitted, speed_m_s, reflecting_m2 = emitted[row], speed_m_s[row], reflecting_m2[row]
    geometric, range_m = geometric[row], range_m[row]
    observed, elevation = observed[row], elevation[row]
    observer, motion = watch.observer_m[moment], watch.motion_m_s[moment]
    sun = watch.sun_m[moment]
    phase = phase_angle(emitted, sun, observer)
    sunlit = np.where(shaded, sunlit_fraction(emitted, sun), 1.0)
    reflected = sphere_intensity_per_irradiance(phase, 1.0, 1.0) * reflecting_m2
    light = photon_rate_at_aperture(1.0, sun_distance(emitted, sun), sunlit, reflected, range_m)
    relative = speed_m_s - motion
    rate = past = _rate(geometric, relative, range_m)
    led = _led(watcher, watch, moment, geometric)
    if led is not None:
        past = _rate(geometric, relative - led * range_m[:, None], range_m)
    light_e, streak = watcher.light_e(light, np.sin(elevation)), watcher.streak_px(past)
    sky_e_s = watcher.sky_e_s(watch, moment, observed)
    snr = watcher.snr(light_e, streak, sky_e_s)
    return Sights(
        row, moment, object_, geometric, observed, range_m, elevation, rate, phase, sunlit, light,
        light_e, streak, sky_e_s, snr,
    )  # fmt: skip


def _light_path(place: Array, speed: Array, observer: Array) -> tuple[Array, Array, Array]:
    """Place at emission, path from the observer to it (r, 3) and its length (r,) [m]."""
    range_m = np.sqrt(np.sum((place - observer) ** 2, axis=-1))
    emitted = path = place
    for _ in range(2):
        emitted = place - speed * (range_m / SPEED_OF_LIGHT_M_S)[:, None]
        path = emitted - observer
        range_m = np.sqrt(np.sum(path**2, axis=-1))
    return emitted, path, range_m


def _observed(
    watcher: Watcher, watch: WatchMoments, moment: Index, geometric: Array
) -> tuple[Array, Array]:
    """Directions (r, 3) as the camera sees them, and their elevation (r,)."""
    up = watch.up[moment]
    seen = aberrate(geometric, watch.beta[moment])
    if any(watcher.air_terms):
        terms = np.broadcast_to(watcher.air_terms, (len(up), 2))
        seen = refract(seen, np.concatenate([up, terms], axis=1))
    sine = np.clip(np.sum(seen * up, axis=-1), -1.0, 1.0)
    return seen, np.arcsin(sine)


def _rate(direction: Array, speed: Array, range_m: Array) -> Array:
    """Angular rate (r,) [rad/s] of objects of a speed (r, 3) against the observer."""
    across = speed - np.sum(speed * direction, axis=-1, keepdims=True) * direction
    return np.sqrt(np.sum(across**2, axis=-1)) / range_m


def _led(watcher: Watcher, watch: WatchMoments, moment: Index, direction: Array) -> Array | None:
    """Motion (r, 3) [rad/s] against the stars of a camera that looks into these directions, as the
    pointing leads it; None where it follows the stars, or its object."""
    p = watcher.pointing
    if isinstance(p, RatePointing):
        east = unit(np.cross(watch.to_gcrs[moment, 2], direction))
        north = np.cross(direction, east)
        return (p.rate_ra_arcsec_s * east + p.rate_dec_arcsec_s * north) * ARCSEC_RAD
    if not isinstance(p, LocalPointing):
        return None
    if isinstance(watcher.observer, GroundObserver):
        return np.cross([0.0, 0.0, EARTH_ROTATION_RAD_S], direction)
    place = watch.observer_m[moment]
    turn = np.cross(place, watch.motion_m_s[moment]) / np.sum(place**2, axis=-1, keepdims=True)
    return np.cross(turn, direction)


def allowed(
    watcher: Watcher, watch: WatchMoments, k: Index, geometric: Array, elevation: Array
) -> NDArray[np.bool_]:
    """Which directions (r, 3) the field of regard allows at moments k (r,), and the camera:
    elevation, Sun, Moon, Galaxy."""
    r = watcher.regard
    good = watch.works[k] & (elevation >= watch.lowest[k])
    if isinstance(watcher.observer, GroundObserver):
        good &= elevation <= r.highest_elevation_deg * DEG_RAD
    observer = watch.observer_m[k]
    for body, least in ((watch.sun_m, watch.sun_least[k]), (watch.moon_m, watch.moon_least[k])):
        if (least > 0.0).any():
            cosine = np.sum(unit(body[k] - observer) * geometric, axis=-1)
            good &= (cosine <= np.cos(least)) | (least <= 0.0)
    if r.galactic_exclusion_deg > 0.0:
        sine = np.abs(np.sum(watch.pole[k] * geometric, axis=-1))
        good &= sine >= np.sin(r.galactic_exclusion_deg * DEG_RAD)
    return good
