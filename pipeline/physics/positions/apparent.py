"""Apparent directions of stars and targets: space motion, light time, deflection, aberration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import erfa.ufunc as era
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.constants import (
    ASTRONOMICAL_UNIT_M,
    JULIAN_YEAR_DAYS,
    SPEED_OF_LIGHT_M_S,
)
from pipeline.physics.positions.earth import EarthState
from pipeline.physics.vectors import separation, unit

Array = NDArray[np.float64]

_J2000_JD, _JULIAN_YEAR_S = 2_451_545.0, JULIAN_YEAR_DAYS * 86_400.0
_SUN_GM_M3_S2 = 1.327_124_400_18e20  # IAU / DE405
_MAX_ITERATIONS = 60


def aberrate(u: Array, beta: ArrayLike) -> Array:
    """Directions seen by a moving observer, exactly (special relativity), any |beta| < 1.

    u' = [u/g + b + g/(1+g) (u.b) b] / (1 + u.b), g = 1/sqrt(1 - b^2)
    (Explanatory Supplement, 3rd ed., 7.40, divided by its length).

    Parameters
    ----------
    u : (..., 3) unit vectors towards the sources, in the frame in which the observer moves.
    beta : (3,) or (..., 3) velocity of the observer over c.
    """
    u, b = np.asarray(u, float), np.asarray(beta, float)
    speed = np.sqrt(np.sum(b * b, axis=-1, keepdims=True))
    inverse_gamma = np.sqrt((1.0 - speed) * (1.0 + speed))
    along = u[..., 0:1] * b[..., 0:1] + u[..., 1:2] * b[..., 1:2] + u[..., 2:3] * b[..., 2:3]
    return unit(u * inverse_gamma + b * (1.0 + along / (1.0 + inverse_gamma)))


def unaberrate(u_proper: Array, beta: ArrayLike) -> Array:
    """The exact inverse of `aberrate`: the boost by -beta. Shapes as there."""
    return aberrate(u_proper, -np.asarray(beta, float))


def unaberrated_caps(centres: Array, radii_rad: Array, beta: Array) -> tuple[Array, Array]:
    """Caps of the sky before aberration that hold all that is seen in caps after it.

    A boost maps circles to circles. Along the great circle through the direction of motion an angle
    t from it becomes p with tan(p/2) = sqrt((1+b)/(1-b)) tan(t/2), and the rim points there are the
    farthest from the image of the centre.

    Parameters
    ----------
    centres : (n, 3) proper directions; radii_rad : (n,); beta : (n, 3) observer's velocity over c.

    Returns centres (n, 3) and radii (n,) [rad], the whole sky (pi) for caps beyond a hemisphere.
    """
    speed = np.sqrt(np.sum(beta * beta, axis=-1))
    stretch = np.sqrt((1.0 + speed) / (1.0 - speed))
    from_motion = separation(beta, centres)

    def before(angle: Array) -> Array:
        return 2.0 * np.arctan2(stretch * np.sin(0.5 * angle), np.cos(0.5 * angle))

    middle = before(from_motion)
    outer = before(from_motion + radii_rad) - middle
    inner = middle - before(from_motion - radii_rad)
    whole = np.asarray(radii_rad) >= 0.5 * np.pi
    widest = np.where(whole, np.pi, np.minimum(np.maximum(outer, inner), np.pi))
    return unaberrate(centres, beta), widest


def star_astrometric(
    ra_rad: Array,
    dec_rad: Array,
    pmra_cosdec_rad_yr: Array,
    pmdec_rad_yr: Array,
    parallax_rad: Array,
    rv_m_s: Array,
    ref_epoch_jyear: float,
    tt1: float,
    tt2: float,
    observer_position_m: Array,
    displaced: bool = True,
) -> Array:
    """Astrometric directions (n, 3) of stars, ICRS: space motion and parallax, no aberration.

    Straight-line motion u = r + dt (mu + r mu_r) - parallax * observer, with the light time across
    the observer's orbit, as ERFA pmpx (Kaplan & Bangert 2010, NOVAS, section 3); mu as a tangent
    vector, so that it holds at the poles. NaN (not known) acts as 0 for motion, parallax and radial
    velocity; a negative parallax acts as 0. Omitted: light time along the star's own path (below
    1 mas a century for Barnard's star).

    Parameters
    ----------
    ra_rad, dec_rad, ... : (n,) ICRS place at `ref_epoch_jyear` [Julian year, TCB taken as TT];
        proper motion in right ascension with cos(dec) included [rad/yr]; radial velocity [m/s].
    tt1, tt2 : two-part Julian date of the observation, TT.
    observer_position_m : (3,) barycentric ICRS position of the observer.
    displaced : whether parallax moves the stars; if not, it still says how near they are, by which
        their radial velocity changes their motion
    """
    years = ((tt1 - _J2000_JD) + tt2) / JULIAN_YEAR_DAYS - (ref_epoch_jyear - 2000.0)
    observer_au = np.asarray(observer_position_m, float) / ASTRONOMICAL_UNIT_M
    columns = (ra_rad, dec_rad, pmra_cosdec_rad_yr, pmdec_rad_yr, parallax_rad, rv_m_s)
    ra, dec, pmra, pmdec, plx, rv = (np.ascontiguousarray(c, dtype=np.float64) for c in columns)
    return _space_motion(ra, dec, pmra, pmdec, plx, rv, years, observer_au, float(displaced))


_AU_YR_PER_M_S = _JULIAN_YEAR_S / ASTRONOMICAL_UNIT_M
_AU_LIGHT_YR = ASTRONOMICAL_UNIT_M / SPEED_OF_LIGHT_M_S / _JULIAN_YEAR_S


@njit(cache=True, nogil=True)
def _space_motion(ra, dec, pmra, pmdec, plx, rv, years, observer_au, displaced):
    """Kernel of `star_astrometric`: (n,) columns, years since the epoch, (3,) au -> (n, 3)."""
    out = np.empty((ra.size, 3))
    for i in range(ra.size):
        sa, ca, sd, cd = np.sin(ra[i]), np.cos(ra[i]), np.sin(dec[i]), np.cos(dec[i])
        x, y, z = cd * ca, cd * sa, sd
        mu_a = 0.0 if np.isnan(pmra[i]) else pmra[i]
        mu_d = 0.0 if np.isnan(pmdec[i]) else pmdec[i]
        parallax = plx[i] if plx[i] > 0.0 else 0.0  # NaN compares false
        mu_r = 0.0 if np.isnan(rv[i]) else rv[i] * _AU_YR_PER_M_S * parallax
        toward = x * observer_au[0] + y * observer_au[1] + z * observer_au[2]
        dt = years + toward * _AU_LIGHT_YR
        parallax *= displaced
        px = x + dt * (-mu_a * sa - mu_d * sd * ca + mu_r * x) - parallax * observer_au[0]
        py = y + dt * (mu_a * ca - mu_d * sd * sa + mu_r * y) - parallax * observer_au[1]
        pz = z + dt * (mu_d * cd + mu_r * z) - parallax * observer_au[2]
        scale = 1.0 / np.sqrt(px * px + py * py + pz * pz)
        out[i, 0], out[i, 1], out[i, 2] = px * scale, py * scale, pz * scale
    return out


def star_proper(
    astrometric: Array,
    observer_position_m: Array,
    observer_velocity_m_s: Array,
    sun_position_m: Array,
    deflection: bool = True,
    aberration: bool = True,
) -> Array:
    """Proper directions (n, 3) of sources at infinity: deflection by the Sun, then aberration.

    ERFA ldsun and ab (Klioner 2003): the first bends light by the Sun's mass, limited inside the
    solar disc; the second is the exact boost with the Sun's potential (0.4 microarcsec), and holds
    for any speed below that of light.

    Parameters
    ----------
    astrometric : (n, 3) unit vectors.
    observer_position_m, observer_velocity_m_s, sun_position_m : barycentric ICRS, (3,) or of each
        source (n, 3).
    """
    # "C": each row is summed as one alone, to the bit
    to_observer_m = np.subtract(observer_position_m, sun_position_m, order="C", dtype=float)
    distance_au = np.sqrt(np.sum(to_observer_m**2, axis=-1)) / ASTRONOMICAL_UNIT_M
    beta = np.divide(observer_velocity_m_s, SPEED_OF_LIGHT_M_S, order="C")
    u = np.ascontiguousarray(astrometric, dtype=np.float64)
    if deflection:
        u = unit(era.ldsun(u, unit(to_observer_m), distance_au))  # ERFA leaves 1e-10 at the limb
    if aberration:
        speed = np.sqrt(np.sum(beta**2, axis=-1))
        u = era.ab(u, beta, distance_au, np.sqrt((1.0 - speed) * (1.0 + speed)))
    return u


def proper_to_astrometric(
    u_proper: Array,
    observer: tuple[Array, Array, Array],
    deflection: bool = True,
    aberration: bool = True,
) -> Array:
    """The inverse of `star_proper` to 1e-14 rad (fixed point, outside the solar disc).

    observer : its position and velocity and the Sun's position, as `star_proper` takes them; of
        each direction, each is found by itself
    """
    beta = np.divide(observer[1], SPEED_OF_LIGHT_M_S, order="C")
    bent = np.array(u_proper, dtype=np.float64)
    if aberration:  # the exact boost, then the small part that `ab` adds to it
        sought = bent
        for _ in range(3):
            natural = unaberrate(bent, beta)
            error = star_proper(natural, *observer, deflection=False) - sought
            bent = unit(bent - error)
        bent = unaberrate(bent, beta)
    if not deflection:
        return bent
    u, together = bent, None if beta.ndim == 1 else -1
    found = np.zeros((), bool)
    for _ in range(_MAX_ITERATIONS):
        step = star_proper(u, *observer, aberration=False) - bent
        u = np.where(found, u, unit(u - step))
        off = np.nanmax(np.abs(step), together, initial=0.0, keepdims=True)
        found = found | (off < 1e-15)
        if found.all():
            break
    return u


@dataclass(frozen=True)
class TargetSight:
    """How an observer sees a target at n instants.

    direction_proper : (n, 3) unit vectors comparable with `star_proper` of the same observer.
    direction_geometric : (n, 3) unit vectors from the observer to the target where it was when the
        light left, in the Earth's frame (no aberration): for phase angles.
    range_m, light_time_s : (n,) between emission and reception, in the Earth's frame.
    target_geocentric_m : (n, 3) the target at emission, GCRS.
    """

    direction_proper: Array
    direction_geometric: Array
    range_m: Array
    light_time_s: Array
    target_geocentric_m: Array


def target_apparent(
    target_state: Callable[[Array], Array],
    observer_geocentric_m: Array,
    observer_velocity_m_s: Array,
    earth: EarthState,
    offsets_s: Array,
) -> TargetSight:
    """Proper directions of a target that moves with the Earth, in the frame of the stars.

    The light path is solved between geocentric places, which keeps 1e-9 rad at 1 km, and its
    direction is taken out of the Earth's moving frame by the exact boost with the Earth's velocity;
    then the observer's TOTAL barycentric velocity aberrates it as it does the stars. That equals
    the barycentric chain (retarded target including the Earth's way during the light time) with its
    Lorentz terms; without them that chain errs by 1 mas. For an observer near the Earth the two
    boosts leave only the geocentric velocity (and 0.3 mas of Thomas rotation, which the stars of
    the same observer share): satellites do not get the annual 20.5 arcsec. The Earth's acceleration
    during the light time is included, for observers far away.

    Parameters
    ----------
    target_state : offsets [s] (n,) -> geocentric GCRS positions [m] (n, 3); of m targets at once,
        (m, n) -> (m, n, 3).
    observer_geocentric_m : (n, 3) GCRS.
    observer_velocity_m_s : (n, 3) BARYCENTRIC velocity, ICRS axes.
    earth : state of the Earth at the instants, from `earth_and_sun`.
    offsets_s : (n,) times of reception, or (m, n).
    """
    offsets = np.asarray(offsets_s, float)
    sun = earth.sun_from_earth_m
    pull = _SUN_GM_M3_S2 * sun / np.sum(sun**2, -1, keepdims=True) ** 1.5
    light_time, found = np.zeros_like(offsets), np.zeros(offsets.shape, bool)
    target = path = np.zeros((*offsets.shape, 3))
    distance = light_time
    for _ in range(_MAX_ITERATIONS):
        # what is found stays as it is, so that it does not depend on the others
        held, place = found[..., None], target_state(offsets - light_time)
        way = place - observer_geocentric_m + 0.5 * pull * light_time[..., None] ** 2
        target, path = np.where(held, target, place), np.where(held, path, way)
        distance = np.sqrt(np.sum(path**2, axis=-1))
        previous, light_time = light_time, distance / SPEED_OF_LIGHT_M_S
        found = found | (np.abs(light_time - previous) <= 1e-15 + 4e-16 * light_time)
        if found.all():
            break
    geometric = unit(path)
    in_space = unaberrate(geometric, earth.velocity_m_s / SPEED_OF_LIGHT_M_S)
    proper = aberrate(in_space, np.asarray(observer_velocity_m_s, float) / SPEED_OF_LIGHT_M_S)
    return TargetSight(proper, geometric, distance, light_time, target)


def apparent_sun_m(earth: EarthState) -> Array:
    """Vector (n, 3) to the Sun as the moving Earth sees it, aberrated by 20.5 arcsec [m].

    The Sun's rays and the Earth's shadow lie along this line in the Earth's frame: use it for
    eclipses and phases. Omitted: the Sun's own way in 8 minutes (8 mas).
    """
    distance = np.sqrt(np.sum(earth.sun_from_earth_m**2, -1, keepdims=True))
    beta = earth.velocity_m_s / SPEED_OF_LIGHT_M_S
    return aberrate(earth.sun_from_earth_m / distance, beta) * distance
