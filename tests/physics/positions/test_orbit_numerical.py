"""Numerical propagation: forces against closed forms and potentials, orbits against themselves."""

from __future__ import annotations

import erfa
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import eval_legendre

from pipeline.errors import BadInput
from pipeline.physics.constants import (
    ASTRONOMICAL_UNIT_M,
    EARTH_EQUATORIAL_RADIUS_M,
    EARTH_GM_M3_S2,
)
from pipeline.physics.positions.orbit_forces import (
    _J,
    MOON_GM_M3_S2,
    SUN_GM_M3_S2,
    Forces,
    acceleration,
    density_kg_m3,
    sunlit,
    zonal_acceleration,
)
from pipeline.physics.positions.orbit_numerical import Trajectory
from pipeline.physics.positions.orbit_two_body import two_body
from pipeline.physics.targets.eclipse import sunlit_fraction

TT = (2_458_593.5, 0.1)
START = np.array([7e6, 0.0, 0.0, 0.0, 5300.0, 5400.0])
POLE = np.array([0.0, 0.0, 1.0])
SUN = np.array([ASTRONOMICAL_UNIT_M, 0.0, 0.0])
NONE = np.zeros(3)


def potential(r: np.ndarray, highest: int) -> float:
    length = np.linalg.norm(r)
    s, ratio = r[2] / length, EARTH_EQUATORIAL_RADIUS_M / length
    terms = sum(_J[n] * ratio**n * eval_legendre(n, s) for n in range(2, highest + 1))
    return float(EARTH_GM_M3_S2 / length * (1.0 - terms))


@pytest.mark.parametrize("highest", [0, 2, 3, 4, 5, 6])
def test_zonals_are_the_slope_of_the_potential(highest: int) -> None:
    r, step = np.array([3.1e6, -4.2e6, 5.0e6]), 50.0
    slope = [
        (potential(r + step * e, highest) - potential(r - step * e, highest)) / (2 * step)
        for e in np.eye(3)
    ]
    assert np.allclose(zonal_acceleration(r, POLE, highest), slope, rtol=1e-9, atol=1e-9)


def test_without_forces_it_is_two_body() -> None:
    t = np.linspace(-7_200.0, 14_400.0, 200)
    place, speed = Trajectory(START, TT, Forces(zonals=0), 1e-12).states(t)
    exact, exact_speed = two_body(START[:3], START[3:], t)
    assert np.abs(place - exact).max() < 1e-3
    assert np.abs(speed - exact_speed).max() < 1e-6


def test_against_radau_with_j2_written_out() -> None:
    def rate(_: float, y: np.ndarray) -> np.ndarray:
        r = y[:3]
        d = np.linalg.norm(r)
        k = 1.5 * _J[2] * EARTH_GM_M3_S2 * EARTH_EQUATORIAL_RADIUS_M**2 / d**5
        z = 5 * (r @ pole) ** 2 / d**2
        pull = -EARTH_GM_M3_S2 / d**3 * r + k * ((z - 1) * r - 2 * (r @ pole) * pole)
        return np.concatenate([y[3:], pull])

    way = Trajectory(START, TT, Forces(zonals=2), 1e-11)
    pole = way._pole
    end = solve_ivp(rate, (0, 20_000), START, method="LSODA", rtol=1e-13, atol=1e-6).y[:, -1]
    place, _ = way.states([20_000.0])
    assert np.linalg.norm(place[0] - end[:3]) < 0.05


@pytest.mark.parametrize(("height_m", "least_m", "most_m"), [(5e5, 2e4, 8e4), (3.5786e7, 40, 60)])
def test_what_two_body_motion_leaves_out(height_m: float, least_m: float, most_m: float) -> None:
    """The oblateness after an hour, as the plan states it: the largest of three inclinations."""
    radius = EARTH_EQUATORIAL_RADIUS_M + height_m
    speed, missed = np.sqrt(EARTH_GM_M3_S2 / radius), []
    for tilt in np.radians([30.0, 60.0, 98.0]):
        start = np.array([radius, 0, 0, 0, speed * np.cos(tilt), speed * np.sin(tilt)])
        place, _ = Trajectory(start, TT, Forces(zonals=6), 1e-10).states([3600.0])
        plain, _ = two_body(start[:3], start[3:], [3600.0])
        missed.append(np.linalg.norm(place - plain))
    assert least_m < max(missed) <= most_m


FULL = Forces(6, 0.02, 0.02, True, True, True)


@pytest.mark.parametrize("forces", [Forces(), FULL, Forces(6, 0.0, 0.02, False)])
def test_tolerance_holds_through_shadows(forces: Forces) -> None:
    """Within 1 cm over 8 h of what a tolerance 100 times smaller gives."""
    t = np.linspace(0.0, 28_800.0, 97)
    coarse, _ = Trajectory(START, TT, forces, 1e-11).states(t)
    fine, _ = Trajectory(START, TT, forces, 1e-13).states(t)
    assert np.abs(coarse - fine).max() < 1e-2


def test_same_bits_whatever_is_asked_first() -> None:
    t = np.linspace(-9000.0, 9000.0, 13)
    whole, _ = Trajectory(START, TT, FULL, 1e-11).states(t)
    way = Trajectory(START, TT, FULL, 1e-11)
    alone = np.concatenate([way.states([x])[0] for x in t[::-1]])[::-1]
    assert np.array_equal(whole, alone)


def test_drag_shrinks_a_circle_at_the_known_rate() -> None:
    """da/dt = -rho B sqrt(GM a) for a polar circle, but for the air's turning with the Earth."""
    a, b = EARTH_EQUATORIAL_RADIUS_M + 400e3, 0.01
    speed = np.sqrt(EARTH_GM_M3_S2 / a)
    start = np.array([a, 0, 0, 0, speed, 0.0])
    way = Trajectory(start, TT, Forces(zonals=0, drag_m2_kg=b), 1e-12)
    place, v = way.states([0.0, 86_400.0])
    axis = 1.0 / (2.0 / np.linalg.norm(place, axis=1) - np.sum(v**2, axis=1) / EARTH_GM_M3_S2)
    wind = 1.0 - 7.292e-5 * a / speed
    rate = -density_kg_m3(400e3) * b * np.sqrt(EARTH_GM_M3_S2 * a) * wind**2
    assert axis[1] - axis[0] == pytest.approx(86_400.0 * rate, rel=0.02)


def test_density_is_the_tabled_one() -> None:
    assert density_kg_m3(400e3) == pytest.approx(3.725e-12, rel=1e-6, abs=0.0)
    middle = np.sqrt(6.967e-13 * 1.454e-13)
    assert density_kg_m3(550e3) == pytest.approx(middle, rel=1e-6, abs=0.0)
    assert density_kg_m3(1268e3) == pytest.approx(3.019e-15 / np.e, rel=1e-6, abs=0.0)
    assert density_kg_m3(175e3) == pytest.approx(8.484e-10, rel=0.2)  # smooth between tabled ones


def test_densities_fall_by_the_scale_heights_printed_beside_them() -> None:
    """Vallado 2013, table 8-4: of a row's scale height [km] follows the density of the next."""
    low_km = [*range(100, 151, 10), 180, 200, *range(250, 501, 50)]
    height_km = np.array([*low_km, *range(600, 1001, 100)])
    scale_km = np.array([
        5.877, 7.263, 9.473, 12.636, 16.149, 22.523, 29.740, 37.105, 45.546, 53.628, 53.298,
        58.515, 60.828, 63.822, 71.835, 88.667, 124.64, 181.05,
    ])  # fmt: skip
    density = np.array([density_kg_m3(1e3 * h) for h in height_km])
    assert density[0] == pytest.approx(5.297e-7, rel=1e-6)
    falls = np.exp(-np.diff(height_km) / scale_km)
    np.testing.assert_allclose(density[1:] / density[:-1], falls, rtol=2e-4)


def test_forces_one_by_one() -> None:
    """Radiation 4.54 uN/m2 times C_R A/m at 1 au; tides of Moon and Sun by their definition."""
    y = np.array([7e6, 0, 0, 0, 7.5e3, 0.0])
    moon = np.array([0.0, 3.844e8, 0.0])
    base = acceleration(y, POLE, SUN, moon, Forces(0))
    light = acceleration(y, POLE, SUN, moon, Forces(0, 0.0, 0.02)) - base
    assert np.allclose(light, [-4.5398e-6 * 0.02, 0, 0], rtol=2e-4, atol=1e-15)
    for body, gm, forces in (
        (SUN, SUN_GM_M3_S2, Forces(0, sun=True)),
        (moon, MOON_GM_M3_S2, Forces(0, moon=True)),
    ):
        tide = acceleration(y, POLE, SUN, moon, forces) - base
        path = body - y[:3]
        wanted = gm * (path / np.linalg.norm(path) ** 3 - body / np.linalg.norm(body) ** 3)
        assert np.allclose(tide, wanted, rtol=1e-6, atol=1e-14)


def test_shadow_is_that_of_the_eclipses() -> None:
    across = np.linspace(6.2e6, 6.6e6, 41)
    places = np.stack([np.full(41, -3e6), across, np.zeros(41)], axis=1)
    ours = [sunlit(p, SUN) for p in places]
    assert np.allclose(ours, sunlit_fraction(places, np.tile(SUN, (41, 1))), atol=1e-3)
    assert sunlit(places[0], SUN, conical=False) == 0.0
    assert sunlit(places[-1], SUN, conical=False) == 1.0


def test_limits_reentry_is_told() -> None:
    a = EARTH_EQUATORIAL_RADIUS_M + 160e3
    start = np.array([a, 0, 0, 0, np.sqrt(EARTH_GM_M3_S2 / a), 0.0])
    way = Trajectory(start, TT, Forces(drag_m2_kg=0.05), 1e-10)
    assert np.isfinite(way.states([600.0])[0]).all()
    for moments in ([400_000.0], [600.0, 400_000.0]):
        with pytest.raises(BadInput, match="re-entry"):
            way.states(moments, "targets.0.orbit")


def test_limits_straight_into_the_centre_is_refused() -> None:
    way = Trajectory(np.array([7e6, 0, 0, 0, 0, 0.0]), TT, Forces(zonals=6), 1e-11)
    with pytest.raises(BadInput, match="integration stopped"):
        way.states([20_000.0])


def test_sunlight_falls_with_the_square_of_the_distance() -> None:
    y = np.array([7e6, 0, 0, 0, 7.5e3, 0.0])
    push = [
        acceleration(y, POLE, far * SUN, NONE, forces)[0]
        for far in (1.0, 2.0) for forces in (Forces(0, 0.0, 10.0), Forces(0))
    ]  # fmt: skip
    assert (push[2] - push[3]) / (push[0] - push[1]) == pytest.approx(0.25, rel=1e-3)
    # 1361 W/m2 (IAU 2015 resolution B3) over the speed of light, on 10 m2/kg of area over mass.
    away_m = np.linalg.norm(SUN - y[:3]) / ASTRONOMICAL_UNIT_M
    assert abs(push[0] - push[1]) == pytest.approx(10.0 * 4.5398e-6 / away_m**2, rel=1e-4)


def test_sun_and_moon_move_while_the_satellite_does() -> None:
    """Two days of a high orbit against another integrator, with ERFA's bodies at each moment."""
    start = np.array([4.2e7, 0.0, 3e6, 0.0, 3.0e3, 500.0])

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        tt = TT[0], TT[1] + t / 86_400.0
        sun = -erfa.epv00(*tt)[0]["p"] * ASTRONOMICAL_UNIT_M
        moon = erfa.moon98(*tt)["p"] * ASTRONOMICAL_UNIT_M
        pull = -EARTH_GM_M3_S2 * y[:3] / np.linalg.norm(y[:3]) ** 3
        for body, gm in ((sun, SUN_GM_M3_S2), (moon, MOON_GM_M3_S2)):
            path = body - y[:3]
            pull += gm * (path / np.linalg.norm(path) ** 3 - body / np.linalg.norm(body) ** 3)
        return np.concatenate([y[3:], pull])

    way = Trajectory(start, TT, Forces(zonals=0, sun=True, moon=True), 1e-11)
    end = solve_ivp(rate, (0, 172_800), start, method="LSODA", rtol=1e-11, atol=1e-4).y[:, -1]
    assert np.linalg.norm(way.states([172_800.0])[0][0] - end[:3]) < 1.0
