"""SGP4 against its published verification states, malformed elements, two-body motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from sgp4.api import WGS72, Satrec

from pipeline.errors import BadInput
from pipeline.physics.constants import EARTH_GM_M3_S2
from pipeline.physics.positions.earth import teme_to_gcrs
from pipeline.physics.positions.orbit import (
    check_above_earth,
    check_tle,
    tle_states,
    tle_states_teme,
    two_body,
)
from pipeline.physics.positions.orbit_bounds import brouwer_axis, drag_terms, shrinking
from pipeline.physics.positions.orbit_screen import states_apart, states_together
from pipeline.physics.positions.orbit_sgp4 import (
    many_states,
    mean_satellite,
    satellite_states,
    since_epochs_s,
)
from pipeline.physics.positions.times import instants, parse_utc

LINE1 = "1 25544U 98067A   19110.12345678  .00001000  00000-0  23000-4 0  9990"
LINE2 = "2 25544  51.6400 100.0000 0002000  80.0000 280.0000 15.52000000166009"


def with_checksum(line: str) -> str:
    return line[:68] + str(sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10)


LINE1, LINE2 = with_checksum(LINE1), with_checksum(LINE2)


def verification(folder: Path) -> list[tuple[str, str, np.ndarray]]:
    """(line 1, line 2, rows of minutes, x y z km, vx vy vz km/s) of every satellite."""
    lines = (folder / "sgp4_elements.txt").read_text().splitlines()
    table = np.loadtxt(folder / "sgp4_states.csv", delimiter=",", skiprows=1)
    return [
        (a, b, table[table[:, 0] == k, 1:])
        for k, (a, b) in enumerate(zip(lines[::2], lines[1::2], strict=True))
    ]


def test_against_the_sgp4_verification_set(published: Path) -> None:
    """Vallado et al. 2006, AIAA 2006-6753 (tests/data/SOURCE.txt)."""
    count, worst_km, worst_km_s = 0, 0.0, 0.0
    sets = verification(published)
    assert len(sets) == 33
    for line1, line2, rows in sets:
        satellite = Satrec.twoline2rv(line1, line2, WGS72)
        day = np.full(len(rows), satellite.jdsatepoch)
        p, v, _ = tle_states_teme(line1, line2, day, satellite.jdsatepochF + rows[:, 0] / 1440)
        worst_km = max(worst_km, float(np.max(np.abs(p - rows[:, 1:4]))))
        worst_km_s = max(worst_km_s, float(np.max(np.abs(v - rows[:, 4:7]))))
        count += len(rows)
    assert count == 667
    assert worst_km < 2e-6
    assert worst_km_s < 2e-8


def test_real_elements_are_accepted(shared_data: Path) -> None:
    for name in ("geo", "visual", "molniya", "analyst"):
        text = (shared_data / "tle" / f"celestrak_2019-04_{name}.txt").read_text()
        lines = [t for t in text.splitlines() if t[:2] in ("1 ", "2 ")]
        for line1, line2 in zip(lines[::2], lines[1::2], strict=True):
            check_tle(line1, line2)


def test_same_states_as_teme_turned() -> None:
    at = instants(parse_utc("2019-04-21T03:00:00Z"), np.array([0.0, 60.0, 3600.0]))
    p, v = tle_states(LINE1, LINE2, at)
    q, w, _ = tle_states_teme(LINE1, LINE2, at.utc1, at.utc2)
    m = teme_to_gcrs(at)
    assert np.allclose(p, np.einsum("nij,nj->ni", m, q) * 1e3, atol=1e-2)
    assert np.allclose(v, np.einsum("nij,nj->ni", m, w) * 1e3, atol=1e-5)


def test_velocity_is_the_derivative() -> None:
    at = instants(parse_utc("2019-04-21T03:00:00Z"), np.array([-0.5, 0.0, 0.5]))
    p, v = tle_states(LINE1, LINE2, at)
    assert np.allclose(p[2] - p[0], v[1], atol=0.05)


def test_limits_a_leap_second_does_not_move_the_satellite() -> None:
    line1 = with_checksum(LINE1[:18] + "16366.50000000" + LINE1[32:])
    at = instants(parse_utc("2016-12-31T23:59:58Z"), np.arange(6.0))
    p, v = tle_states(line1, LINE2, at)
    steps = np.linalg.norm(np.diff(p, axis=0), axis=1)
    assert np.allclose(steps, np.linalg.norm(v[0]), rtol=1e-4)


@pytest.mark.parametrize(
    ("line1", "line2", "words"),
    [
        (LINE1[:68] + str((int(LINE1[68]) + 1) % 10), LINE2, ["line1", "checksum"]),
        (LINE1, LINE2[:30] + "9" + LINE2[31:], ["line2", "checksum"]),
        (LINE2, LINE1, ["line1", "starting '1 '"]),
        (LINE1, LINE1, ["line2", "starting '2 '"]),
        (LINE1, with_checksum(LINE2.replace("25544", "25545")), ["line2", "25544"]),
        (LINE1[:60], LINE2, ["line1", "69 characters"]),
        ("", LINE2, ["line1"]),
        (LINE1.replace(" ", "\u00a0", 1), LINE2, ["line1", "ASCII"]),
        (LINE1, with_checksum(LINE2[:26] + "zzzzzzz" + LINE2[33:]), ["line2", "eccentricity"]),
        (with_checksum(LINE1[:18] + "x" + LINE1[19:]), LINE2, ["line1", "epoch"]),
        (with_checksum(LINE1[:23] + " " + LINE1[24:]), LINE2, ["line1", "epoch"]),
        (None, LINE2, ["line1"]),
        (with_checksum(LINE1[:62] + "4" + LINE1[63:]), LINE2, ["line1", "SGP4", "column 63"]),
        (with_checksum(LINE1[:18] + "19366.00000000" + LINE1[32:]), LINE2, ["line1", "365 days"]),
        (with_checksum(LINE1[:18] + "20367.50000000" + LINE1[32:]), LINE2, ["line1", "366 days"]),
        (with_checksum(LINE1[:18] + "19000.50000000" + LINE1[32:]), LINE2, ["line1", "365 days"]),
        (with_checksum(LINE1.replace("25544", "I5544", 1)), LINE2, ["line1", "satellite number"]),
        (with_checksum(LINE1.replace("25544", "O5544", 1)), LINE2, ["line1", "satellite number"]),
    ],
)
def test_limits_malformed_elements(line1: str, line2: str, words: list[str]) -> None:
    with pytest.raises(BadInput) as error:
        check_tle(line1, line2, "targets.0.orbit")
    assert all(word in str(error.value) for word in words), str(error.value)
    assert error.value.field.startswith("targets.0.orbit")


@pytest.mark.parametrize(
    ("epoch", "kind"),
    [("19365.99999999", "0"), ("20366.99999999", "2"), ("00366.50000000", "3"),
     ("57  1.00000000", " "), (" 4 60.50000000", "0")],
)  # fmt: skip
def test_ephemeris_types_and_days_that_are_taken(epoch: str, kind: str) -> None:
    """All types that an OMM may have; the first and the last day of common and leap years."""
    check_tle(with_checksum(LINE1[:18] + epoch + LINE1[32:62] + kind + LINE1[63:]), LINE2)


@settings(max_examples=300, deadline=None)
@given(st.integers(1, 2), st.integers(2, 67), st.text(" 0123456789.+-", min_size=1, max_size=9))
@example(1, 18, "191 3")  # a day with a blank among its digits
def test_limits_mangled_elements_end_in_one_message(line: int, at: int, text: str) -> None:
    """Any characters in any column, with a good checksum: states or BadInput, never a crash."""
    lines = [LINE1, LINE2]
    old = lines[line - 1]
    lines[line - 1] = with_checksum((old[:at] + text + old[at + len(text) :])[:68] + "0")
    try:
        p, v = tle_states(*lines, instants(parse_utc("2019-04-21T03:00:00Z"), np.array([0.0])))
    except BadInput:
        return
    assert np.all(np.isfinite(np.concatenate([p, v])))


def test_limits_decayed_orbit_says_so() -> None:
    low = with_checksum(LINE2[:52] + "16.70000000" + LINE2[63:])
    drag = with_checksum(LINE1[:53] + " 99999-1" + LINE1[61:])
    with pytest.raises(BadInput, match="SGP4 code"):
        tle_states(drag, low, instants(parse_utc("2019-05-20T00:00:00Z"), np.array([0.0])))


def test_the_shrinking_of_orbits_is_that_of_sgp4(published: Path) -> None:
    """Mean semi-major axes of the verification set, hours to months from their epochs; of deep
    orbits, which Sun and Moon move, not those."""
    count = 0
    for line1, line2, _ in verification(published):
        one = Satrec.twoline2rv(line1, line2, WGS72)
        mean = [np.array([v]) for v in (one.bstar, one.ecco, one.inclo)]
        axis = brouwer_axis(np.array([one.no_kozai]), *mean[1:])
        assert axis == pytest.approx(one.a, rel=1e-15)
        for minutes in (-5000.0, 0.0, 600.0, 10_000.0, 100_000.0):
            f = shrinking(drag_terms(*mean, axis), np.array([minutes]))[0]
            if one.sgp4_tsince(minutes)[0] == 0 and one.method == "n" and f > 0.5:
                assert one.am / one.a == pytest.approx(f**2, rel=1e-12)
                count += 1
    assert count > 30


def test_limits_an_orbit_does_not_rise_again_from_the_ground() -> None:
    """SGP4 alone gives places to one that came down weeks ago: ten times as far, and more."""
    one = mean_satellite(ELEMENTS | {"bstar": 0.02, "eccentricity": 1e-4})
    days = np.arange(0.0, 75.0, 0.01)
    codes, place, _ = one.sgp4_array(np.full(days.size, one.jdsatepoch), one.jdsatepochF + days)
    down = days[np.argmax(codes != 0)]
    assert 15.0 < down < 20.0
    assert codes[-1] == 0
    assert np.linalg.norm(place[-1]) > 7e4
    epoch = parse_utc(ELEMENTS["epoch"])
    whole = mean_satellite(ELEMENTS)
    for day in (down + 0.5, 45.0, 65.0, 75.0, 5000.0):
        after_s, since = day * 86_400.0, np.zeros(2)
        at = instants(epoch, [after_s])
        with pytest.raises(BadInput, match=r"orbit: 'x' .* \(SGP4 code 6: .* has decayed\)"):
            satellite_states(one, "x", at)
        with pytest.raises(BadInput, match=r"b: 'y' .* \(SGP4 code 6"):
            many_states([whole, one], ["x", "y"], ["a", "b"], since, np.full((2, 1), after_s),
                        teme_to_gcrs(at))  # fmt: skip
        *_, codes = states_together([whole, one], since, np.array([0.0, after_s]))
        assert codes.tolist() == [[-1, -1], [-1, 6]]
        *_, codes = states_apart([whole, one], since, np.array([1, 0]), np.full(2, after_s))
        assert codes.tolist() == [6, -1]


def test_limits_below_the_ground() -> None:
    check_above_earth(np.array([[0.0, 0.0, 6.4e6]]), "observer.position")
    for bad in (6.3e6, 0.0, np.nan):
        with pytest.raises(BadInput, match="surface"):
            check_above_earth(np.array([bad, 0.0, 0.0]), "observer.position")


def integrate(r: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    def rate(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:], -EARTH_GM_M3_S2 * y[:3] / np.linalg.norm(y[:3]) ** 3])

    y0 = np.concatenate([r, v])
    scale = np.repeat([1e-6, 1e-9], 3)
    return solve_ivp(rate, (0, t), y0, method="DOP853", rtol=1e-13, atol=scale).y[:, -1]


@pytest.mark.parametrize("factor", [1.0, 1.2, np.sqrt(2) * (1 - 1e-9), np.sqrt(2), 1.4142136, 2.5])
@pytest.mark.parametrize("inward", [0.0, -0.6, 0.4])
def test_against_dop853(factor: float, inward: float) -> None:
    """Circle, ellipse, both sides of the parabola, hyperbola; ahead and back in time."""
    r = np.array([7.0e6, 1.0e6, -2.0e6])
    direction = np.cross([0.1, 0.3, 1.0], r)
    direction = direction / np.linalg.norm(direction) + inward * r / np.linalg.norm(r)
    speed = factor * np.sqrt(EARTH_GM_M3_S2 / np.linalg.norm(r))
    v = direction / np.linalg.norm(direction) * speed
    times = np.array([-5000.0, -10.0, 0.0, 3.0, 20000.0])
    p, w = two_body(r, v, times)
    for i in (0, 1, 3, 4):
        y = integrate(r, v, times[i])
        size = np.linalg.norm(y[:3])
        assert np.linalg.norm(p[i] - y[:3]) < 3e-10 * size + 1e-3
        assert np.linalg.norm(w[i] - y[3:]) < 3e-10 * np.linalg.norm(y[3:]) + 1e-6
    assert np.allclose(p[2], r, rtol=1e-14)


@settings(max_examples=150, deadline=None)
@given(
    st.floats(0.05, 4.0), st.floats(-1.55, 1.55), st.floats(6.5e6, 4e8), st.floats(-3e6, 3e6)
)  # fmt: skip
def test_two_body_keeps_energy_and_momentum(
    factor: float, angle: float, r0: float, dt: float
) -> None:
    r = np.array([r0, 0.0, 0.0])
    circular = np.sqrt(EARTH_GM_M3_S2 / r0)
    v = factor * circular * np.array([np.sin(angle), 0.8 * np.cos(angle), 0.6 * np.cos(angle)])
    p, w = two_body(r, v, np.array([dt]))
    size, back = np.linalg.norm(p[0]), np.linalg.norm(w[0])
    kinetic = 0.5 * back**2
    energy = kinetic - EARTH_GM_M3_S2 / size
    assert abs(energy - (0.5 * v @ v - EARTH_GM_M3_S2 / r0)) < 1e-10 * (kinetic + circular**2)
    assert np.linalg.norm(np.cross(p[0], w[0]) - np.cross(r, v)) < 1e-9 * size * back + 1e-3
    home, _ = two_body(p[0], w[0], np.array([-dt]))
    assert np.linalg.norm(home[0] - r) < 1e-6 * max(r0, size)


@pytest.mark.parametrize("ecc", [0.01, 0.4, 0.95])
def test_eccentric_orbits_from_any_place_to_any_other(ecc: float) -> None:
    """Against Kepler's equation, half a period either way: by more than half a turn of the
    eccentric anomaly where that leads through perigee."""
    axis_m = 2.6e7
    rate = np.sqrt(EARTH_GM_M3_S2 / axis_m**3)
    height = np.sqrt(1.0 - ecc**2)

    def state(anomaly: Any) -> tuple[Any, Any]:
        c, s = np.cos(anomaly), np.sin(anomaly)
        speed = rate * axis_m / (1.0 - ecc * c)
        zero = np.zeros_like(c)
        place = axis_m * np.stack([c - ecc, height * s, zero], -1)
        return place, speed[..., None] * np.stack([-s, height * c, zero], -1)

    for begin in np.linspace(0.0, 2.0 * np.pi, 17):
        r, v = state(np.array(begin))
        to = begin + np.linspace(-6.0, 6.0, 49)
        times = (to - ecc * np.sin(to) - begin + ecc * np.sin(begin)) / rate
        p, w = two_body(r, v, times)
        place, speed = state(to)
        assert np.abs(p - place).max() < 1e-2
        assert np.abs(w - speed).max() < 1e-5


def test_limits_whole_periods_and_free_fall() -> None:
    r, v = np.array([7e6, 0.0, 0.0]), np.array([0.0, 7800.0, 1000.0])
    a = 1 / (2 / 7e6 - v @ v / EARTH_GM_M3_S2)
    period = 2 * np.pi * np.sqrt(a**3 / EARTH_GM_M3_S2)
    p, _ = two_body(r, v, period * np.array([-1.0, 1.0, 1000.0]))
    assert np.allclose(p, r, atol=1e-2)
    fall, speed = two_body(np.array([4e7, 0, 0]), np.zeros(3), np.array([100.0, 5000.0]))
    assert np.allclose(fall[:, 1:], 0)
    assert fall[0, 0] == pytest.approx(4e7 - 0.5 * EARTH_GM_M3_S2 / 16e14 * 1e4, rel=1e-9)
    assert np.all(np.isfinite(speed))


ELEMENTS = {
    "epoch": "2019-04-20T02:57:46.665792Z", "mean_motion_rev_day": 15.52, "eccentricity": 0.0002,
    "inclination_deg": 51.64, "raan_deg": 100.0, "argument_of_perigee_deg": 80.0,
    "mean_anomaly_deg": 280.0, "bstar": 0.23e-4,
}  # fmt: skip


def test_mean_elements_are_those_of_the_lines() -> None:
    """Three days on, by drag and all: the same place to a few metres of the lines' rounding."""
    at = instants(parse_utc("2019-04-23T00:00:00Z"), np.array([0.0, 700.0]))
    p, v = satellite_states(mean_satellite(ELEMENTS), "made", at)
    q, w = tle_states(LINE1, LINE2, at)
    assert np.abs(p - q).max() < 5.0
    assert np.abs(v - w).max() < 5e-3


def test_many_satellites_at_times_of_their_own() -> None:
    epoch = parse_utc("2019-04-21T03:00:00Z")
    satellites = [mean_satellite(ELEMENTS | {"epoch": e}) for e in
                  ("2019-04-20T12:00:00Z", "2019-04-18T07:30:00Z")]  # fmt: skip
    offsets = np.array([[0.0, 40.0, 500.0], [-0.3, 39.9, 499.0]])
    matrices = teme_to_gcrs(instants(epoch, [0.0, 40.0, 500.0]))
    found = many_states(satellites, ["a", "b"], ["f", "g"], since_epochs_s(satellites, epoch),
                        offsets, matrices)  # fmt: skip
    for k, satellite in enumerate(satellites):
        alone = satellite_states(satellite, "x", instants(epoch, offsets[k]))
        assert np.abs(found[0][k] - alone[0]).max() < 0.05
        assert np.abs(found[1][k] - alone[1]).max() < 1e-4
