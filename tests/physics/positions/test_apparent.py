"""Apparent places against ERFA, astropy and hand-made chains of light paths."""

from __future__ import annotations

import astropy.units as au
import erfa
import numpy as np
import pytest
from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics.constants import (
    ARCSEC_RAD,
    ASTRONOMICAL_UNIT_M,
    DEG_RAD,
    MAS_RAD,
    SPEED_OF_LIGHT_M_S,
    SUN_RADIUS_M,
)
from pipeline.physics.positions.apparent import (
    aberrate,
    apparent_sun_m,
    proper_to_astrometric,
    star_astrometric,
    star_proper,
    target_apparent,
    unaberrate,
    unaberrated_caps,
)
from pipeline.physics.positions.earth import EarthState, earth_and_sun, site_state
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.vectors import from_angles, separation, to_angles, unit

AT = instants(parse_utc("2019-04-20T03:00:00Z"), np.array([0.0]))
EARTH = earth_and_sun(AT.tt1, AT.tt2)
LEO_POSITION, LEO_VELOCITY = np.array([6.9e6, 1e5, 2e5]), np.array([-200.0, 6000.0, 4600.0])
OBSERVER = EARTH.position_m[0] + LEO_POSITION
VELOCITY = EARTH.velocity_m_s[0] + LEO_VELOCITY
SUN = EARTH.position_m[0] + EARTH.sun_from_earth_m[0]
NAN = np.nan

# ra deg, dec deg, pmra*, pmdec mas/yr, parallax mas, rv km/s
STARS = np.array(
    [
        [269.452, 4.6934, -798.58, 10328.12, 546.98, -110.5],  # Barnard's star
        [219.9, -60.83, -3679.25, 473.67, 754.8, -22.4],  # alpha Centauri
        [0.0, 0.0, 1.0, -1.0, 5.0, 30.0],
        [359.9999999999, 1e-9, -300.0, 200.0, 20.0, 400.0],
        [123.0, 90.0, 400.0, 300.0, 10.0, 0.0],
        [77.0, -90.0, 400.0, -300.0, 10.0, 0.0],
        [45.0, 89.9999, 900.0, 900.0, 100.0, -50.0],
        [28.0, 11.3, 0.0, 0.0, 0.0, 0.0],  # 1 degree from the Sun on that day
        [207.0, -11.3, 0.0, 0.0, 0.0, 0.0],
    ]
)


def columns(rows: np.ndarray) -> list[np.ndarray]:
    ra, dec, pmra, pmdec, plx, rv = rows.T
    return [
        ra * DEG_RAD, dec * DEG_RAD, pmra * MAS_RAD, pmdec * MAS_RAD, plx * MAS_RAD, rv * 1e3
    ]  # fmt: skip


def random_sky(n: int, seed: int = 3) -> np.ndarray:
    return unit(np.random.Generator(np.random.SFC64(seed)).normal(size=(n, 3)))


def test_against_erfa_pmpx() -> None:
    rows = STARS[np.abs(STARS[:, 1]) < 89]
    ra, dec, pmra, pmdec, plx, rv = columns(rows)
    years = ((AT.tt1[0] - 2451545.0) + AT.tt2[0]) / 365.25 - 15.5
    theirs = erfa.pmpx(
        ra, dec, pmra / np.cos(dec), pmdec, plx / ARCSEC_RAD, rv / 1e3, years,
        OBSERVER / ASTRONOMICAL_UNIT_M,
    )  # fmt: skip
    ours = star_astrometric(*columns(rows), 2015.5, AT.tt1[0], AT.tt2[0], OBSERVER)
    assert np.max(np.abs(ours - theirs)) < 1e-15


def test_against_erfa_whole_chain() -> None:
    """Catalogue to proper directions as ERFA atciq with a satellite observer: 1e-14 rad."""
    ebpv = np.zeros((), dtype=erfa.dt_pv)
    ebpv["p"] = EARTH.position_m[0] / ASTRONOMICAL_UNIT_M
    ebpv["v"] = EARTH.velocity_m_s[0] / ASTRONOMICAL_UNIT_M * 86400
    pv = np.zeros((), dtype=erfa.dt_pv)
    pv["p"], pv["v"] = LEO_POSITION, LEO_VELOCITY
    astrom = erfa.apcs(
        AT.tt1[0], AT.tt2[0], pv, ebpv, -EARTH.sun_from_earth_m[0] / ASTRONOMICAL_UNIT_M
    )
    rows = STARS[np.abs(STARS[:, 1]) < 89]
    ra, dec, pmra, pmdec, plx, rv = columns(rows)
    theirs = from_angles(
        *erfa.atciq(ra, dec, pmra / np.cos(dec), pmdec, plx / ARCSEC_RAD, rv / 1e3, astrom)
    )
    straight = star_astrometric(*columns(rows), 2000.0, AT.tt1[0], AT.tt2[0], OBSERVER)
    ours = star_proper(straight, OBSERVER, VELOCITY, SUN)
    assert np.max(separation(ours, theirs)) < 2e-15 + 1e-14


def test_against_astropy_gcrs() -> None:
    """Faint far stars ICRS -> GCRS through SkyCoord: 1e-9 rad (its Earth differs by 2 ms)."""
    u = random_sky(200)
    u = u[separation(u, unit(SUN - OBSERVER)) > 0.02]
    t = Time("2019-04-20T03:00:00", scale="utc")
    frame = GCRS(
        obstime=t,
        obsgeoloc=CartesianRepresentation(LEO_POSITION * au.m),
        obsgeovel=CartesianRepresentation(LEO_VELOCITY * au.m / au.s),
    )
    ra, dec = to_angles(u)
    there = SkyCoord(ra * au.rad, dec * au.rad, frame="icrs").transform_to(frame)
    ours = star_proper(u, OBSERVER, VELOCITY, SUN)
    theirs = there.cartesian.xyz.value.T
    assert np.max(separation(ours, unit(theirs))) < 1e-10


def test_barnard_epochs_and_rigorous_motion() -> None:
    row = columns(STARS[:1])
    years = np.array([1950.0, 2026.0, 2100.0])
    jd = 2451545.0 + (years - 2000.0) * 365.25
    still = np.zeros(3)
    here = from_angles(row[0], row[1])
    at = [star_astrometric(*row, 2015.5, j, 0.0, still)[0] for j in jd]
    wrong = star_astrometric(*row, 2000.0, jd[1], 0.0, still)[0]
    assert separation(wrong, at[1]) / ARCSEC_RAD == pytest.approx(161, abs=1)
    for j, ours in zip(jd, at, strict=True):
        ra, dec, pmra, pmdec, plx, rv = row
        moved = erfa.pmsafe(
            ra, dec, pmra / np.cos(dec), pmdec, plx / ARCSEC_RAD, rv / 1e3,
            2451545.0, 15.5 * 365.25, j, 0.0,
        )  # fmt: skip
        assert separation(ours, from_angles(moved[0][0], moved[1][0])) < 1 * MAS_RAD
    assert separation(here[0], at[1]) / ARCSEC_RAD == pytest.approx(10.36 * 10.5, rel=0.01)


def test_limits_unknown_values_act_as_zero() -> None:
    plain = columns(np.array([[10.0, 20.0, 0.0, 0.0, 0.0, 0.0]]))
    expected = star_astrometric(*plain, 2015.5, AT.tt1[0], AT.tt2[0], OBSERVER)
    for row in ([10.0, 20.0, NAN, NAN, NAN, NAN], [10.0, 20.0, 0.0, NAN, -0.8, 50.0]):
        got = star_astrometric(*columns(np.array([row])), 2015.5, AT.tt1[0], AT.tt2[0], OBSERVER)
        assert np.array_equal(got, expected)


def test_limits_pole_moves_as_a_tangent_vector() -> None:
    """At dec 90 proper motion runs along the axes of the meridian given by the right ascension."""
    for dec in (90.0, -90.0):
        row = columns(np.array([[30.0, dec, 1000.0, 2000.0, 0.0, 0.0]]))
        at = star_astrometric(*row, 2015.5, 2451545.0, 25.5 * 365.25, np.zeros(3))[0]
        ca, sa = np.cos(30 * DEG_RAD), np.sin(30 * DEG_RAD)
        sign = np.sign(dec)
        east, north = np.array([-sa, ca, 0]), np.array([-sign * ca, -sign * sa, 0])
        step = 10 * MAS_RAD * (1000 * east + 2000 * north)
        assert np.allclose(at[:2], step[:2], rtol=1e-6)


def test_same_star_alone_and_among_others() -> None:
    all_of = star_astrometric(*columns(STARS), 2015.5, AT.tt1[0], AT.tt2[0], OBSERVER)
    proper = star_proper(all_of, OBSERVER, VELOCITY, SUN)
    for i in range(len(STARS)):
        one = star_astrometric(*columns(STARS[i : i + 1]), 2015.5, AT.tt1[0], AT.tt2[0], OBSERVER)
        assert np.array_equal(one[0], all_of[i])
        assert np.array_equal(star_proper(one, OBSERVER, VELOCITY, SUN)[0], proper[i])


betas = st.tuples(st.floats(0, 0.99), st.floats(0, 6.28), st.floats(-1.57, 1.57)).map(
    lambda t: t[0] * from_angles(np.array(t[1]), np.array(t[2]))
)


@given(betas, st.integers(0, 10_000))
def test_aberration_inverse_and_invariant(beta: np.ndarray, seed: int) -> None:
    u = random_sky(5, seed)
    seen = aberrate(u, beta)
    assert np.max(separation(unaberrate(seen, beta), u)) < 1e-12
    # a boost is conformal: the invariant (1 - cos) D D' of two rays (Terrell 1959)
    g2 = 1 / (1 - beta @ beta)
    for i in range(4):
        before = 1 - u[i] @ u[i + 1]
        doppler = g2 * (1 + u[i] @ beta) * (1 + u[i + 1] @ beta)
        assert 1 - seen[i] @ seen[i + 1] == pytest.approx(before / doppler, abs=1e-12)


def test_against_textbook_aberration_angle() -> None:
    """cos t' = (cos t + b)/(1 + b cos t) at any speed."""
    for speed in (1e-8, 1e-4, 0.1, 0.9, 0.99):
        t = np.linspace(0.01, 3.13, 50)
        u = np.stack([np.cos(t), np.sin(t), 0 * t], -1)
        seen = aberrate(u, np.array([speed, 0.0, 0.0]))
        half = np.sqrt((1 - speed) / (1 + speed)) * np.tan(t / 2)
        assert np.max(np.abs(np.arctan2(seen[:, 1], seen[:, 0]) - 2 * np.arctan(half))) < 1e-13


def test_sizes_of_aberration_and_deflection() -> None:
    u = random_sky(4000)
    bent = separation(star_proper(u, OBSERVER, VELOCITY, SUN, deflection=False), u) / ARCSEC_RAD
    speed = np.linalg.norm(VELOCITY) / SPEED_OF_LIGHT_M_S
    assert bent.max() == pytest.approx(speed / ARCSEC_RAD, rel=1e-3)
    toward = unit(SUN - OBSERVER)
    across = unit(np.cross(toward, [0.0, 0.0, 1.0]))
    limb = SUN_RADIUS_M / np.linalg.norm(SUN - OBSERVER)
    for angle, mas, tol in ((np.pi / 2, 4.07, 0.05), (30 * DEG_RAD, 15.2, 0.2), (limb, 1750, 15)):
        v = np.cos(angle) * toward + np.sin(angle) * across
        moved = star_proper(v[None], OBSERVER, VELOCITY, SUN, aberration=False)[0]
        assert separation(moved, v) / MAS_RAD == pytest.approx(mas, abs=tol)
        assert separation(moved, toward) > separation(v, toward)
    same = star_proper(u, OBSERVER, VELOCITY, SUN, deflection=False, aberration=False)
    assert np.array_equal(same, u)


@pytest.mark.parametrize("speed", [1e-4, 0.3, 0.99])
@pytest.mark.parametrize("switches", [(True, True), (True, False), (False, True)])
def test_inverse_of_the_star_chain(speed: float, switches: tuple[bool, bool]) -> None:
    velocity = speed * SPEED_OF_LIGHT_M_S * unit(np.array([1.0, -2.0, 0.7]))
    toward = unit(SUN - OBSERVER)
    near = unit(toward + np.array([[0.005, 0, 0.0], [0.0, 0.02, 0.01]]))
    u = np.concatenate([random_sky(500), near, -toward[None]])
    seen = star_proper(u, OBSERVER, velocity, SUN, *switches)
    back = proper_to_astrometric(seen, (OBSERVER, velocity, SUN), *switches)
    assert np.max(separation(back, u)) < (1e-12 if speed < 0.5 else 1e-11)


def orbit(radius_m: float, tilt: float, phase: float) -> object:
    rate = np.sqrt(3.986004418e14 / radius_m**3)

    def at(t: np.ndarray) -> np.ndarray:
        a = phase + rate * np.asarray(t)
        return radius_m * np.stack(
            [np.cos(a), np.sin(a) * np.cos(tilt), np.sin(a) * np.sin(tilt)], -1
        )

    return at


@pytest.mark.parametrize(("radius", "tilt", "phase"), [(6.9e6, 0.9, 0.2), (4.2164e7, 0.0, 2.0),
                                                       (2.66e7, 1.1, -2.5)])  # fmt: skip
def test_target_against_both_chains(radius: float, tilt: float, phase: float) -> None:
    t = np.array([0.0, 40.0])
    at = instants(parse_utc("2019-04-20T03:00:00Z"), t)
    earth = earth_and_sun(at.tt1, at.tt2)
    site, site_v = site_state(0.36, -2.7, 3055.0, at)
    state = orbit(radius, tilt, phase)
    total = earth.velocity_m_s + site_v
    sight = target_apparent(state, site, total, earth, t)
    c = SPEED_OF_LIGHT_M_S
    # geocentric chain: retarded in the Earth's frame, aberrated by the site's own velocity
    geocentric = aberrate(sight.direction_geometric, site_v / c)
    assert np.max(separation(sight.direction_proper, geocentric)) < 0.4 * MAS_RAD
    # barycentric chain: the Earth from the ephemeris at emission and at reception, and then with
    # the Lorentz terms of the geocentric coordinates and the Earth's way as a short series
    later, sooner = (earth_and_sun(at.tt1, at.tt2 + s).velocity_m_s for s in (0.01, -0.01))
    pull = (later - sooner) / (0.02 * 86400)
    for lorentz, bound in ((False, 1.0 * MAS_RAD), (True, 2e-12)):
        delay = np.zeros(2)
        for _ in range(20):
            own = state(t - delay)
            v = earth.velocity_m_s
            shift = np.sum(v * (own - site), -1) / c**2 if lorentz else np.zeros(2)
            if lorentz:
                way = (0.5 * pull * (delay - shift)[:, None] - v) * (delay - shift)[:, None]
                way = way - 0.5 * v * np.sum(v * (own - site), -1)[:, None] / c**2
            else:  # rounding inside the ephemeris leaves some mm
                past = earth_and_sun(at.tt1, at.tt2 - delay / 86400)
                way = past.position_m - earth.position_m
            path = own - site + way
            delay = np.linalg.norm(path, axis=1) / c + shift
        seen = aberrate(unit(path), total / c)
        assert np.max(separation(sight.direction_proper, seen)) < bound
    assert np.allclose(sight.light_time_s * c, sight.range_m, rtol=1e-12)
    assert np.allclose(sight.target_geocentric_m, state(t - sight.light_time_s), rtol=1e-14)
    # against the catalogue's directions the satellite seems displaced by the annual aberration
    sun = earth.position_m + earth.sun_from_earth_m
    args = (earth.position_m[0] + site[0], total[0], sun[0])
    there = proper_to_astrometric(sight.direction_proper[:1], args)
    assert 3 < separation(there[0], sight.direction_geometric[0]) / ARCSEC_RAD < 21


def test_light_time_holds_the_pull_of_the_sun_on_the_earth() -> None:
    """Seen from 1 au away: while light travels for 8 minutes the Earth falls 740 m sunwards.

    By hand, for an Earth at rest when the light comes in: at emission it was a t^2 / 2 nearer to
    the Sun than where a straight way leads back to, and the target with it.
    """
    au, pull = ASTRONOMICAL_UNIT_M, 1.327_124_400_18e20 / ASTRONOMICAL_UNIT_M**2
    earth = EarthState(np.zeros((1, 3)), np.zeros((1, 3)), np.array([[au, 0.0, 0.0]]))
    own = np.array([[0.0, 0.0, 4.2e7]])
    away = au * np.array([[0.0, 0.8, 0.6]])
    sight = target_apparent(lambda _: own, away, np.zeros((1, 3)), earth, np.zeros(1))
    delay = np.linalg.norm(own - away) / SPEED_OF_LIGHT_M_S
    fallen = np.array([[0.5 * pull * delay**2, 0.0, 0.0]])
    assert fallen[0, 0] == pytest.approx(740.0, rel=0.01)
    expected = unit(own + fallen - away)
    assert separation(sight.direction_proper, expected)[0] < 1e-14
    assert separation(unit(own - away), expected)[0] == pytest.approx(1.02 * MAS_RAD, rel=0.01)


def test_light_time_from_far_away_against_the_ephemeris() -> None:
    """The Earth's place at emission from ERFA, seen from a spacecraft a fifth of an au away.

    Both chains see the target where the Earth was; what is left is the Lorentz contraction of the
    way in the Earth's frame (second order in v/c), added here as in the test above.
    """
    t = np.zeros(1)
    at = instants(parse_utc("2019-04-20T03:00:00Z"), t)
    earth = earth_and_sun(at.tt1, at.tt2)
    away = 0.2 * ASTRONOMICAL_UNIT_M * unit(np.array([[0.3, -0.8, 0.5]]))
    own, c = np.array([[4.2e7, 0.0, 0.0]]), SPEED_OF_LIGHT_M_S
    sight = target_apparent(lambda _: own, away, earth.velocity_m_s, earth, t)
    v, delay = earth.velocity_m_s, np.zeros(1)
    for _ in range(20):
        shift = np.sum(v * (own - away), -1) / c**2
        past = earth_and_sun(at.tt1, at.tt2 - (delay - shift) / 86400)
        way = past.position_m - earth.position_m
        path = own - away + way - 0.5 * v * shift[:, None]
        delay = np.linalg.norm(path, axis=1) / c + shift
    seen = aberrate(unit(path), v / c)
    fell = 0.5 * (earth_and_sun(at.tt1, at.tt2 + 0.01).velocity_m_s - v) / 864.0 * delay**2
    assert np.linalg.norm(fell) / np.linalg.norm(away) > 8e-10
    assert separation(sight.direction_proper, seen)[0] < 1e-10


def test_limits_one_kilometre_away() -> None:
    """Two satellites in formation: light time and aberration cancel, and 1e-9 rad remain."""
    t = np.array([0.0, 100.0])
    at = instants(parse_utc("2019-04-20T03:00:00Z"), t)
    earth = earth_and_sun(at.tt1, at.tt2)
    v = np.array([0.0, 7500.0, 0.0])
    place = np.array([6.9e6, 0.0, 0.0]) + t[:, None] * v
    gap = np.array([600.0, 0.0, 800.0])

    def target(s: np.ndarray) -> np.ndarray:
        return np.array([6.9e6, 0.0, 0.0]) + gap + np.asarray(s)[:, None] * v

    sight = target_apparent(target, place, earth.velocity_m_s + v, earth, t)
    assert np.max(separation(sight.direction_proper, unit(gap))) < 1.7e-9  # Thomas rotation
    assert np.allclose(sight.range_m, 1000.0, atol=1e-6)
    still = target_apparent(
        lambda s: np.broadcast_to(place[0] + gap, (2, 3)), place[:1].repeat(2, 0),
        earth.velocity_m_s, earth, t,
    )  # fmt: skip
    assert np.max(separation(still.direction_proper, unit(gap))) < 1e-11


def test_fast_fixed_observer_sees_targets_and_stars_alike() -> None:
    """At 0.99 c a far target standing still among the stars is seen where they are."""
    c = SPEED_OF_LIGHT_M_S
    earth = EarthState(np.zeros((1, 3)), np.zeros((1, 3)), np.array([[1e30, 0.0, 0.0]]))
    u = random_sky(1)
    velocity = 0.99 * c * unit(np.array([[1.0, 1.0, 0.2]]))
    sight = target_apparent(lambda s: u * 1e9, np.zeros((1, 3)), velocity, earth, np.zeros(1))
    assert np.max(separation(sight.direction_proper, aberrate(u, velocity / c))) < 1e-13


def test_apparent_sun_is_turned_by_the_annual_aberration() -> None:
    seen = apparent_sun_m(EARTH)
    turned = separation(seen, EARTH.sun_from_earth_m)[0] / ARCSEC_RAD
    assert 20.1 < turned < 20.9
    assert np.allclose(np.linalg.norm(seen), np.linalg.norm(EARTH.sun_from_earth_m))


@pytest.mark.parametrize("speed", [0.0, 1e-4, 0.1, 0.5, 0.97])
def test_caps_before_aberration_hold_all_that_is_seen(speed: float) -> None:
    """Random directions inside apparent caps come from inside the caps given, and fill them."""
    rng = np.random.default_rng(4)
    for radius in (1e-4, 0.05, 0.6, 1.5):
        centre, motion = unit(rng.normal(size=3)), unit(rng.normal(size=3))
        beta = speed * motion
        caps, radii = unaberrated_caps(centre[None], np.array([radius]), beta[None])
        across = unit(np.cross(centre, rng.normal(size=3)))
        turn = np.linspace(0, 2 * np.pi, 2001)[:, None]
        rim = np.cos(radius) * centre + np.sin(radius) * (
            np.cos(turn) * across + np.sin(turn) * np.cross(centre, across)
        )
        came_from = separation(unaberrate(rim, beta), caps)
        assert came_from.max() <= radii[0] + 1e-12
        if radii[0] < np.pi / 2:
            assert came_from.max() > 0.999 * radii[0]


@pytest.mark.parametrize("year", [1915.5, 2115.5])
def test_without_parallax_near_stars_still_hasten(year: float) -> None:
    """Their motion is that of astropy for one far from the Sun's neighbourhood in nothing else."""
    near = STARS[:2]
    tt = Time(year, format="jyear", scale="tt")
    found = star_astrometric(*columns(near), 2015.5, tt.jd1, tt.jd2, OBSERVER, displaced=False)
    ra, dec, pmra, pmdec, parallax, rv = near.T
    there = SkyCoord(
        ra * au.deg, dec * au.deg, pm_ra_cosdec=pmra * au.mas / au.yr,
        pm_dec=pmdec * au.mas / au.yr, distance=1e3 / parallax * au.pc,
        radial_velocity=rv * au.km / au.s, obstime=Time(2015.5, format="jyear", scale="tt"),
    ).apply_space_motion(new_obstime=tt)  # fmt: skip
    expected = from_angles(there.ra.rad, there.dec.rad)
    assert separation(found, expected).max() < 0.03 * ARCSEC_RAD  # 4.5 arcsec without distances


def test_a_cap_beyond_a_hemisphere_is_the_whole_sky() -> None:
    """And one that is not, is not: of an observer at rest, itself."""
    centres, still = np.tile([0.0, 0.6, 0.8], (3, 1)), np.tile([1e-9, 0.0, 0.0], (3, 1))
    _, radii = unaberrated_caps(centres, np.array([1.5, 1.6, 3.0]), still)
    np.testing.assert_allclose(radii, [1.5, np.pi, np.pi], atol=1e-8)
