"""Stray light: the Earth's disc against a brute-force sum, the curves, the Moon's law."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, DEG_RAD
from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M as R
from pipeline.physics.sky.earth_disc import earth_stray
from pipeline.physics.sky.moon import COLOUR, COLOUR_NM, MEAN_DISTANCE_M, irradiance_share
from pipeline.physics.sky.pst import PstHarvey, PstTable
from pipeline.physics.targets.earthshine import earth_lamps
from pipeline.physics.vectors import separation, unit

ANGLES = np.array([0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 60.0, 90.0, 120.0]) * DEG_RAD
BUMPY = 1e-3 * (ANGLES / ANGLES[0]) ** -2.2 * [1, 1.3, 0.8, 1, 1.2, 0.7, 0.5, 0.1, 0.01]
TABLE = PstTable(ANGLES, BUMPY, ANGLES[0], "extrapolate", "zero")
HARVEY = PstHarvey(0.1, 0.01, -1.5, 3, 4.0, 0.0, "extrapolate")
FLAT = PstTable(np.array([0.1, 3.1415927]), np.ones(2), 0.1, "clip", "clip")
ONE = np.array([[0.3]])
UP = unit(np.array([0.2, -0.5, 0.8]))
EAST = unit(np.cross(UP, [1.0, 0.0, 0.0]))
NORTH = np.cross(UP, EAST)
SIDES = 1500


def brute_force(line, place, sun, pst, albedo):
    """Sum over patches of the surface, crowded at the limb and below the line of sight."""
    place = place / R
    up = unit(place)
    e1 = unit(line - (line @ up) * up)
    e2 = np.cross(up, e1)
    most = np.arccos(1.0 / np.sqrt(place @ place))
    t = (np.arange(SIDES) + 0.5) / SIDES
    down, width = most * (1 - (1 - t) ** 4), most * 4 * (1 - t) ** 3 / SIDES
    x, k = 2.0 * t - 1.0, 8.0
    around = np.pi * np.sinh(k * x) / np.sinh(k)
    step = np.pi * k * np.cosh(k * x) / np.sinh(k) * 2.0 / SIDES
    ring = np.cos(around)[:, None] * e1 + np.sin(around)[:, None] * e2
    total = 0.0
    for angle, wide in zip(down, width, strict=True):
        n = np.cos(angle) * up + np.sin(angle) * ring
        way = n - place
        squared = (way * way).sum(1)
        u = way / np.sqrt(squared)[:, None]
        light = np.maximum(n @ sun, 0.0) * np.maximum(-(n * u).sum(1), 0.0) / squared
        patch = np.sin(angle) * wide * step
        total += float(np.sum(light * albedo(n) * patch * pst.value(separation(u, line[None]))))
    return total / np.pi


def beside_limb(height_m, off_deg, azimuth):
    """A line of sight so far off the limb, and the observer's place."""
    place = UP * (R + height_m)
    t = np.arcsin(R / (R + height_m)) + off_deg * DEG_RAD
    side = np.cos(azimuth) * EAST + np.sin(azimuth) * NORTH
    return -np.cos(t) * UP + np.sin(t) * side, place


OVERHEAD, LOW, BEHIND = unit(UP + 0.3 * EAST), unit(EAST + 0.05 * UP), unit(EAST - 0.15 * UP)


@pytest.mark.parametrize(
    ("height_m", "off_deg", "azimuth", "sun", "pst"),
    [
        (300e3, 0.02, 0.4, OVERHEAD, TABLE),
        (300e3, 0.5, 2.0, LOW, TABLE),
        (300e3, 30.0, 1.0, BEHIND, HARVEY),
        (800e3, 5.0, 4.0, LOW, TABLE),
        (35_786e3, 0.02, 5.0, LOW, TABLE),
        (35_786e3, 5.0, 0.2, unit(EAST - 0.7 * UP), TABLE),
        (35_786e3, 30.0, 3.0, OVERHEAD, HARVEY),
    ],
    ids=["leo-limb", "leo-terminator", "leo-night", "800km", "geo-limb", "geo-crescent", "geo"],
)
def test_against_brute_force(height_m, off_deg, azimuth, sun, pst):
    line, place = beside_limb(height_m, off_deg, azimuth)
    expected = brute_force(line, place, sun, pst, lambda n: 0.3)
    found = earth_stray(line[None], place, sun * 1.5e11, pst, ONE, np.eye(3))[0]
    assert expected > 0.0
    assert found == pytest.approx(expected, rel=1e-4, abs=0.0)


def test_a_curve_that_is_clipped_and_ends_before_the_disc_does():
    """Its kink and its end are no places that the rule may run over."""
    short = PstTable(ANGLES[3:6], BUMPY[3:6], 5.0 * DEG_RAD, "clip", "zero")
    line, place = beside_limb(300e3, 2.0, 0.4)
    expected = brute_force(line, place, OVERHEAD, short, lambda n: 0.3)
    found = earth_stray(line[None], place, OVERHEAD, short, ONE, np.eye(3))[0]
    assert found == pytest.approx(expected, rel=5e-4, abs=0.0)


def test_a_map_has_no_seam():
    """A map and its axes turned together, so that the date line is elsewhere, give the same."""
    albedo = np.random.default_rng(4).uniform(0.1, 0.7, (18, 36))
    line, place = beside_limb(35_786e3, 3.0, 1.0)
    found = []
    for columns in (0, 9, 18, 25):
        turn = 2.0 * np.pi * columns / 36
        c, s = np.cos(turn), np.sin(turn)
        axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        rolled = np.roll(albedo, columns, axis=1)
        found.append(earth_stray(line[None], place, OVERHEAD, HARVEY, rolled, axes)[0])
    assert found == pytest.approx([found[0]] * 4, rel=1e-9, abs=0.0)


def test_against_brute_force_with_a_map():
    """Cells of 10 degrees, bilinear, turned by some rotation."""
    rng = np.random.default_rng(3)
    albedo = rng.uniform(0.1, 0.7, (18, 36))
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    def at(n):
        from scipy.interpolate import RegularGridInterpolator

        wide = np.pad(np.pad(albedo, ((0, 0), (1, 1)), "wrap"), ((1, 1), (0, 0)), "edge")
        lat, lon = np.arange(-95, 96, 10.0), np.arange(-185, 186, 10.0)
        look = RegularGridInterpolator((lat, lon), wide)
        x, y, z = turn @ n.T
        place = np.degrees([np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x)])
        return look(place.T)

    line, place = beside_limb(35_786e3, 3.0, 1.0)
    expected = brute_force(line, place, OVERHEAD, HARVEY, at)
    found = earth_stray(line[None], place, OVERHEAD, HARVEY, albedo, turn)[0]
    assert found == pytest.approx(expected, rel=3e-3, abs=0.0)
    flat = earth_stray(line[None], place, OVERHEAD, HARVEY, np.full((18, 36), 0.3), turn)[0]
    plain = earth_stray(line[None], place, OVERHEAD, HARVEY, ONE, turn)[0]
    assert flat == pytest.approx(plain, rel=1e-6, abs=0.0)


def test_a_real_map_against_many_more_nodes(shared_data, monkeypatch):
    """The clouds of a year in cells of 5 degrees."""
    from pipeline.physics.sky import earth_disc

    path = shared_data / "earth_albedo" / "Earth_ALB_2018_CERES_All_5x5.csv"
    albedo = np.loadtxt(path, delimiter=",")
    for height_m, off in ((500e3, 0.1), (35_786e3, 3.0)):
        line, place = beside_limb(height_m, off, 1.0)
        found = earth_stray(line[None], place, OVERHEAD, TABLE, albedo, np.eye(3))
        with monkeypatch.context() as finer:
            finer.setattr(earth_disc, "AROUND_A_MAP", 300)
            finer.setattr(earth_disc, "INTERVALS_OF_A_MAP", 150)
            exact = earth_stray(line[None], place, OVERHEAD, TABLE, albedo, np.eye(3))
        assert found == pytest.approx(exact, rel=1e-4, abs=0.0)


def test_against_the_lamps_of_earthshine():
    """A curve of one everywhere: the Earth's whole irradiance, by another quadrature."""
    for height_m, tolerance in ((400e3, 1e-3), (35_786e3, 1e-5)):
        line, place = beside_limb(height_m, 20.0, 0.3)
        found = earth_stray(line[None], place, LOW * 1.5e11, FLAT, ONE, np.eye(3))[0]
        _, light = earth_lamps(place[None], LOW * 1.5e11, 0.3, 48)
        assert found == pytest.approx(light.sum(), rel=tolerance, abs=0.0)


def test_limits_far_away_it_is_a_point():
    """Full phase: 2/3 albedo (R/d)^2 of the Sun's irradiance, through the curve at its place."""
    place = UP * 400.0 * R
    line = unit(-UP + 0.3 * EAST)
    found = earth_stray(line[None], place, UP, TABLE, ONE, np.eye(3))[0]
    point = 2.0 / 3.0 * 0.3 / 400.0**2 * TABLE.value(separation(line, -UP))
    assert found == pytest.approx(float(point), rel=1e-2, abs=0.0)


@settings(max_examples=40)
@given(
    st.floats(2e5, 1e8), st.floats(0.01, 80.0), st.floats(0.0, 6.28), st.floats(-1.0, 1.0),
    st.floats(0.0, 6.28),
)  # fmt: skip
def test_bounds_hold_everywhere(height_m, off_deg, azimuth, z, turn):
    """Between none and the whole lit disc at its nearest point; the night side gives none."""
    line, place = beside_limb(height_m, off_deg, azimuth)
    sun = z * UP + np.sqrt(1 - z * z) * (np.cos(turn) * EAST + np.sin(turn) * NORTH)
    found = earth_stray(line[None], place, sun, HARVEY, ONE, np.eye(3))[0]
    whole = earth_stray(line[None], place, sun, FLAT, ONE, np.eye(3))[0]
    assert 0.0 <= found <= whole * HARVEY.value(np.array(off_deg * DEG_RAD)) * (1 + 1e-4)


def test_table_returns_its_values_and_its_ends():
    assert TABLE.value(ANGLES) == pytest.approx(BUMPY, rel=1e-12)
    middle = TABLE.value(np.sqrt(ANGLES[2:3] * ANGLES[3:4]))
    assert middle == pytest.approx(np.sqrt(BUMPY[2] * BUMPY[3]), rel=1e-12)
    clip = PstTable(ANGLES, BUMPY, 1.0 * DEG_RAD, "clip", "clip")
    assert clip.value(np.array([0.1 * DEG_RAD])) == pytest.approx(BUMPY[2])
    assert clip.value(np.array([3.0])) == pytest.approx(BUMPY[-1])
    slope = np.log(BUMPY[1] / BUMPY[0]) / np.log(3.0)
    assert TABLE.value(ANGLES[:1] / 10.0) == pytest.approx(BUMPY[0] * 10.0**-slope)
    assert TABLE.value(np.array([2.2])) == 0.0


def test_harvey_by_hand():
    """At the shoulder the BSDF is 2^(s/2) of b0; no light from behind."""
    at = np.array([0.0, np.arcsin(0.01), 1.58])
    pst = 3 * np.pi / 64.0 * 0.1 * np.array([1.0, np.cos(at[1]) * 2.0**-0.75, 0.0])
    assert HARVEY.value(at) == pytest.approx(pst, rel=1e-12)


def test_moon_against_published_reflectances(shared_data):
    """Kieffer & Stone 2005, table 4, with its terms of phase alone (c1 = 0.00034115)."""
    rows = (shared_data / "lunar" / "rolo_kieffer_stone_2005.dat").read_text().splitlines()
    table = np.array([r.split(",") for r in rows if r and r[0] != "#"], float)

    def reflectance(g):
        surge = 0.000_341_15 * np.exp(-g / (4.06054 * DEG_RAD))
        powers = table[:, 1:5] * g ** np.arange(4)
        return np.exp(powers.sum(1) + surge)

    solid = 6.4177e-5
    green = np.abs(table[:, 0] - 549.0) < 6.0
    for phase_deg in (10.0, 30.0, 60.0, 90.0):
        g = phase_deg * DEG_RAD
        expected = reflectance(g)[green].mean() * solid / np.pi
        found = irradiance_share(g, np.array(ASTRONOMICAL_UNIT_M), np.array(MEAN_DISTANCE_M))
        assert 1.03 < found / expected < 1.09
    seen = reflectance(45.0 * DEG_RAD)
    ratio = np.interp(table[:, 0], COLOUR_NM, COLOUR) / (seen / seen[green].mean())
    assert np.abs(ratio - 1.0).max() < 0.07


def test_moonlight_falls_with_both_distances_and_is_held_beyond_150_degrees():
    sun, moon = np.array(1.2 * ASTRONOMICAL_UNIT_M), np.array(0.9 * MEAN_DISTANCE_M)
    near = irradiance_share(0.4, sun / 1.2, moon / 0.9)
    assert irradiance_share(-0.4, sun, moon) / near == pytest.approx((1.2 * 0.9) ** -2)
    late = irradiance_share(np.radians([149.0, 150.0, 175.0]), sun, moon)
    assert late[0] > late[1] == late[2]


def test_harvey_is_clipped_within_its_exclusion():
    at = np.array([0.2, 1.0, 3.0]) * DEG_RAD
    clip = PstHarvey(0.1, 0.01, -1.5, 3, 4.0, 1.0 * DEG_RAD, "clip")
    assert clip.value(at) == pytest.approx(HARVEY.value(at[[1, 1, 2]]), rel=1e-12)
