"""Limiting cases of places: poles, antipode, near light speed, close passages, extreme orbits."""

from __future__ import annotations

from pathlib import Path

import erfa.ufunc as era
import numpy as np
from scipy.integrate import solve_ivp

from pipeline.physics.constants import EARTH_GM_M3_S2, SPEED_OF_LIGHT_M_S
from pipeline.physics.motion.pointing import boresight_frame
from pipeline.physics.positions.apparent import aberrate, target_apparent
from pipeline.physics.positions.earth import EarthState, earth_and_sun, site_state
from pipeline.physics.positions.focal_plane import Camera, ifov_rad, project
from pipeline.physics.positions.orbit_elements import keplerian_states
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.vectors import from_angles, separation
from pipeline.studies.selftest.case import CaseResult, case
from pipeline.studies.worst import worst_of

Array = np.ndarray


def _off_px(camera: Camera, ra0: float, dec0: float, ra: Array, dec: Array) -> float:
    """Largest distance of our pixels from ERFA's tangent plane [px]."""
    attitude = boresight_frame(from_angles(np.array([ra0]), np.array([dec0])))[0]
    x, y = project(camera, attitude, from_angles(ra, dec))
    xi, eta, behind = era.tpxes(ra, dec, ra0, dec0)
    assert not np.any(behind)
    x0, y0 = camera.centre_px
    return float(np.hypot(x - x0 + xi / ifov_rad(camera), y - y0 - eta / ifov_rad(camera)).max())


@case(
    "places/pole",
    "stars around the pole, the pole 0.36 arcsec from the boresight",
    "ERFA tpxes (tangent plane)",
    1e-6,
    "px",
)
def pole(_: Path) -> CaseResult:
    ra = np.linspace(0.0, 2.0 * np.pi, 721)
    dec = np.radians(90.0 - np.geomspace(1e-9, 0.5, 721))
    off = _off_px(Camera(4096, 4096, 1e-5, 1.0), 0.3, np.radians(90.0 - 1e-4), ra, dec)
    return CaseResult("as ERFA", f"{ra.size} stars within {off:.2g} px", off)


@case(
    "places/ra-wrap",
    "stars on both sides of right ascension 0, boresight at 360 deg",
    "ERFA tpxes",
    1e-6,
    "px",
)
def ra_wrap(_: Path) -> CaseResult:
    ra = np.radians(np.concatenate([np.linspace(359.5, 360.0, 99), np.linspace(0.0, 0.5, 99)]))
    off = _off_px(Camera(4096, 4096, 1e-5, 1.0), 2.0 * np.pi, 0.2, ra, np.full(ra.size, 0.2))
    return CaseResult("as ERFA", f"{ra.size} stars within {off:.2g} px", off)


@case("places/wide-and-narrow", "fields of 20 degrees and of 0.01 arcsec", "ERFA tpxes", 1e-4, "px")
def wide_and_narrow(_: Path) -> CaseResult:
    offs = []
    for field in (np.radians(20.0), np.radians(0.01 / 3600.0)):
        camera = Camera(1001, 1001, 1e-5, 1e-5 / (2.0 * np.tan(0.5 * field) / 1001))
        step = np.linspace(-0.5, 0.5, 41) * field
        ra, dec = (g.ravel() for g in np.meshgrid(0.1 + step, 0.1 + step))
        offs.append(_off_px(camera, 0.1, 0.1, ra, dec))
    return CaseResult("as ERFA", f"{offs[0]:.2g} px wide, {offs[1]:.2g} px narrow", worst_of(*offs))


@case(
    "places/antipode",
    "stars 90 to 180 degrees from the boresight must not be seen",
    "geometry",
    0.0,
    "stars seen",
)
def antipode(_: Path) -> CaseResult:
    angle = np.concatenate([[0.5 * np.pi, np.pi], np.linspace(np.pi / 2, np.pi, 181)])
    u = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    x, y = project(Camera(64, 64, 1e-5, 1e-3), boresight_frame(np.array([[1.0, 0, 0]]))[0], u)
    inside = np.isfinite(x) & np.isfinite(y) & (np.hypot(x, y) < 1e6)
    return CaseResult("0 stars", f"{inside.sum()} stars", float(inside.sum()))


@case(
    "places/0.99c",
    "aberration for an observer at 0.99 c, all angles from 0 to 180 degrees",
    "tan(t'/2) = sqrt((1 - b)/(1 + b)) tan(t/2) (Einstein 1905)",
    1e-12,
    "rad",
)
def near_light_speed(_: Path) -> CaseResult:
    b = 0.99
    angle = np.linspace(0.0, np.pi, 1801)
    u = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    seen = aberrate(u, np.array([b, 0.0, 0.0]))
    right = 2.0 * np.arctan2(
        np.sqrt(1.0 - b) * np.sin(0.5 * angle), np.sqrt(1.0 + b) * np.cos(0.5 * angle)
    )
    error = np.abs(np.arctan2(seen[:, 1], seen[:, 0]) - right).max()
    return CaseResult("90 deg -> 8.109614 deg", f"within {error:.2g} rad", float(error))


@case(
    "places/fly-by",
    "light time and direction of a body that passes at 1 km with 10 km/s",
    "the quadratic for the time of emission on a straight line",
    1e-9,
    "rad",
)
def fly_by(_: Path) -> CaseResult:
    c, far, speed = SPEED_OF_LIGHT_M_S, 1e3, 1e4
    t = np.linspace(-1.0, 1.0, 2001)
    nowhere = np.zeros((t.size, 3))
    still = EarthState(nowhere, nowhere, np.full((t.size, 3), 1e16))
    state = lambda s: np.stack([np.full_like(s, far), speed * s, np.zeros_like(s)], -1)  # noqa: E731
    sight = target_apparent(state, np.zeros((t.size, 3)), np.zeros((t.size, 3)), still, t)
    # c (t - e) = sqrt(far^2 + (speed e)^2)
    a, half, rest = c**2 - speed**2, c**2 * t, c**2 * t**2 - far**2
    late = rest / (half + np.sqrt(half**2 - a * rest))
    early = (half - np.sqrt(half**2 - a * rest)) / a
    emitted = np.where(half > 0, early, np.where(t > 0, late, early))
    right = np.arctan2(speed * emitted, far)
    error = np.abs(
        np.arctan2(sight.direction_geometric[:, 1], sight.direction_geometric[:, 0]) - right
    ).max()
    return CaseResult("closest at 1000 m", f"{sight.range_m.min():.6f} m", float(error))


def _by_integration(q: float, e: float, seconds: float) -> tuple[Array, Array]:
    """The state after a time since perigee by an adaptive Runge-Kutta method of order 8."""
    speed = np.sqrt(EARTH_GM_M3_S2 * (1.0 + e) / q)

    def pull(_: float, s: Array) -> Array:
        r = s[:2]
        return np.concatenate([s[2:], -EARTH_GM_M3_S2 * r / np.sum(r * r) ** 1.5])

    run = solve_ivp(pull, (0.0, seconds), [q, 0, 0, speed], "DOP853", rtol=1e-13, atol=1e-6)
    return run.y[:2, -1], run.y[2:, -1]


@case(
    "places/orbits",
    "e = 0.999999, 1 and 1.5 from perigee at 7000 km over an hour and ten days",
    "DOP853 integration of the equation of motion (scipy)",
    1e-9,
)
def orbits(_: Path) -> CaseResult:
    worst = 0.0
    for e in (0.999999, 1.0, 1.5):
        for seconds in (3600.0, 864_000.0):
            place, _v = keplerian_states(7e6, e, 0.0, 0.0, 0.0, np.array([seconds]))
            right, _v = _by_integration(7e6, e, seconds)
            worst = worst_of(worst, np.hypot(*(place[0, :2] - right)) / np.hypot(*right))
    return CaseResult("as integrated", f"within {worst:.2g} of the distance", worst)


@case(
    "places/1950-2100",
    "a site's place in GCRS in 1950 and 2100; the Sun finite",
    "the equinox route: ERFA gd2gc, gst06a, pnm06a (ours goes by the CIO)",
    1e-2,
    "m",
)
def far_dates(_: Path) -> CaseResult:
    worst = 0.0
    lon, lat = np.radians(-156.3), np.radians(20.7)
    for date in ("1950-01-01T00:00:00Z", "2100-01-01T00:00:00Z"):
        when = instants(parse_utc(date), [0.0, 43_200.0])
        place = site_state(lat, lon, 3000.0, when)[0]
        spin = era.gst06a(when.ut11, when.ut12, when.tt1, when.tt2)
        itrs, _ok = era.gd2gc(1, lon, lat, 3000.0)
        cos, sin = np.cos(spin), np.sin(spin)
        x, y = itrs[0] * cos - itrs[1] * sin, itrs[0] * sin + itrs[1] * cos
        of_date = np.stack([x, y, np.full_like(x, itrs[2])], -1)
        turned = era.trxp(era.pnm06a(when.tt1, when.tt2), of_date)
        earth = earth_and_sun(when.tt1, when.tt2)
        worst = worst_of(worst, np.abs(place - turned).max())
        assert np.isfinite(earth.sun_from_earth_m).all()
    return CaseResult("as ERFA", f"within {worst:.2g} m", worst)


@case(
    "places/opposite-boresight",
    "separations of 0, 1e-12 and 180 degrees - 1e-12 rad",
    "the angles that the directions were made from",
    1e-15,
    "rad",
)
def separations(_: Path) -> CaseResult:
    e = 1e-12
    one = np.array([[1.0, 0, 0]] * 3)
    two = np.array([[1.0, 0, 0], [1.0, e, 0], [-1.0, e, 0]])
    off = np.abs(separation(one, two) - np.array([0.0, e, np.pi - e]))
    return CaseResult("0, 1e-12, pi - 1e-12", f"within {off.max():.2g} rad", float(off.max()))
