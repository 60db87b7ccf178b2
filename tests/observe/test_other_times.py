"""Times far from a scene's epoch: the Earth as it is turned then, and what is said of orbits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from astropy.time import Time, TimeDelta
from astropy.utils import iers
from scipy.integrate import solve_ivp
from sgp4.api import Satrec

from pipeline.observe.groups import groups_of
from pipeline.observe.observe import observe
from pipeline.observe.times import times_of
from pipeline.plan.targets.orbit_age import _two_body
from pipeline.spec.load import parse_scene
from tests.observe.conftest import BALL, night
from tests.physics.positions.test_orbit_skyfield import tle, with_checksum

GM, RADIUS_M, J2 = 3.986004418e14, 6378137.0, 1.0826267e-3
DAY_S = 86400.0
ASIDE = {"mode": "sidereal", "boresight_ra_deg": 180.0, "boresight_dec_deg": 70.0}


@pytest.mark.parametrize("days", [250.0, -250.0])
def test_the_earth_is_turned_as_it_is_at_the_times_asked_for(days: float) -> None:
    """UT1 and the pole against astropy's own reading of the IERS tables, long after and before."""
    scene = parse_scene(night())
    first, last = days * DAY_S, (days + 0.01) * DAY_S
    [group], notes = groups_of(scene, times_of(scene, [first, last]))
    then = Time("2019-04-20T10:00:00", scale="utc") + TimeDelta(days + 0.005, format="jd")
    table = iers.IERS_B.open()
    pole = [v.to_value("arcsec") for v in table.pm_xy(then)]
    assert group.resolved.dut1_s == pytest.approx(table.ut1_utc(then).to_value("s"), abs=1e-4)
    observer = group.resolved.scene.observer
    assert observer.polar_motion_arcsec == pytest.approx(pole, abs=1e-3)
    assert not any("UT1" in note for note in notes)
    [group], notes = groups_of(scene, times_of(scene, sorted([0.0, last])))
    [told] = [note for note in notes if "UT1" in note]
    off_s = np.ptp(table.ut1_utc(Time([2458593.9166667, then.jd], format="jd", scale="utc")).value)
    assert float(told.split("up to ")[1].split()[0]) > 0.4 * off_s * 15.0


def test_within_a_day_the_earth_is_as_in_the_scene() -> None:
    scene = parse_scene(night())
    own, _ = groups_of(scene, times_of(scene, None))
    other, _ = groups_of(scene, times_of(scene, [0.5 * DAY_S]))
    assert own[0].resolved.dut1_s == other[0].resolved.dut1_s


def flattened(_: float, state: np.ndarray) -> np.ndarray:
    """Pull of a flattened Earth (Vallado 2013, eq. 8-30)."""
    place, r = state[:3], float(np.sqrt(state[:3] @ state[:3]))
    z2 = 5.0 * place[2] ** 2 / r**2
    more = 1.5 * J2 * (RADIUS_M / r) ** 2 * np.array([1.0 - z2, 1.0 - z2, 3.0 - z2])
    return np.concatenate([state[3:], -GM / r**3 * place * (1.0 + more)])


@pytest.mark.parametrize("hours", [1.0, 7.0, 30.0])
@pytest.mark.parametrize("height_m", [5e5, 1.2e6])
def test_two_body_motion_is_off_by_about_what_is_told(height_m: float, hours: float) -> None:
    """Against an integration with the Earth's oblateness, for some inclinations."""
    r, off_m, told_m = RADIUS_M + height_m, [], []
    for inclination_deg in (10.0, 51.6, 97.6):
        tilt = np.radians(inclination_deg)
        v = np.sqrt(GM / r) * np.array([0.0, np.cos(tilt), np.sin(tilt)])
        start = np.array([r, 0.0, 0.0, *v])
        orbit = {"kind": "state", "position_m": start[:3].tolist(), "velocity_m_s": v.tolist()}
        scene = parse_scene(night(targets=[night()["targets"][0] | {"orbit": orbit}]))
        time_s = hours * 3600.0
        ends = solve_ivp(flattened, (0.0, time_s), start, rtol=1e-10, atol=1e-4, t_eval=[time_s])
        angle = np.sqrt(GM / r**3) * time_s
        alone = np.cos(angle) * start[:3] + np.sin(angle) * r * v / np.sqrt(GM / r)
        off_m.append(float(np.hypot.reduce(ends.y[:3, 0] - alone)))
        told_m.append(_two_body(scene, scene.targets[0].orbit, 0.0, time_s)[0])
    ratio = np.array(told_m) / off_m
    if hours < 1.5:  # less than a revolution: a bound
        assert (ratio >= 1.0).all()
    else:
        assert (ratio >= 0.5).all()
        assert (ratio <= 2.0).all()


def test_old_orbits_are_told_at_the_times_asked_for() -> None:
    """Of targets, and of the observer, whom nobody else looks at."""
    state = {"kind": "state", "position_m": [7e6, 0.0, 0.0], "velocity_m_s": [0.0, 7546.0, 0.0]}
    seen_from = {"kind": "orbit", "orbit": state}
    scene = parse_scene(night(observer=seen_from, background=None))
    notes = observe(scene, [0.0, 10.0 * 3600.0]).notes
    assert any(note.startswith("the observer: its own orbit: two-body") for note in notes)
    assert any(note.startswith("3 of the targets move as two bodies") for note in notes)
    line1, line2 = tle(7, 51.6, 10.0, 0.001, 20.0, 30.0, 15.2)
    mean = {"name": "mean", "orbit": {"kind": "tle", "line1": line1, "line2": line2}, "body": BALL}
    one = parse_scene(night(targets=[night()["targets"][0], mean], background=None))
    notes = observe(one, [0.0, 10.0 * 3600.0]).notes
    assert any(note.startswith("1 of the targets move as two bodies") for note in notes)
    assert not any("two-body motion" in note for note in observe(scene, [0.0, 10.0]).notes)


def test_of_several_sets_the_one_nearest_to_the_times_counts(tmp_path: Path) -> None:
    """Whatever the scene's epoch is, and whatever else the file holds."""
    early = tle(7, 51.6, 10.0, 0.001, 20.0, 30.0, 15.2)
    first, second = early[0].replace("19110.", "19140."), tle(7, 51.6, 20.0, 0.0, 0.0, 0.0, 15.0)[1]
    late = (with_checksum(first), second)
    (tmp_path / "both.tle").write_text("\n".join((*early, *late)) + "\n")
    (tmp_path / "late.tle").write_text("\n".join(late) + "\n")
    rows = {}
    for name in ("both", "late"):
        crowd = {"name": "crowd", "path": str(tmp_path / f"{name}.tle"), "body": BALL}
        scene = parse_scene(night(targets=[], populations=[crowd], pointing=ASIDE))
        rows[name] = [
            observe(scene, times).table.select(["range_m", "ra_deg", "dec_deg"]).to_pylist()
            for times in ([30.0 * DAY_S], None)
        ]
    assert rows["both"][0] == rows["late"][0]
    assert rows["both"][1] != rows["late"][1]


def test_what_is_said_of_the_scenes_own_exposures_is_named_so() -> None:
    """A shadow that a target is in then says nothing of other times."""
    behind = [-7.0e6, 0.0, 0.0]
    scene = parse_scene(night(epoch="2020-03-20T04:00:00Z", targets=[
        night()["targets"][0] | {"orbit": {"kind": "state", "position_m": behind,
                                           "velocity_m_s": [0.0, 7546.0, 0.0]}}
    ]))  # fmt: skip
    own = [note for note in observe(scene).notes if "in the Earth's shadow" in note]
    assert len(own) == 1
    half = observe(scene, [2900.0])
    [told] = [note for note in half.notes if "in the Earth's shadow" in note]
    assert told == f"of the scene's own exposures: {own[0]}"
    assert half.table["sunlit_fraction"].to_pylist() == [1.0]


def test_random_motion_is_told_where_it_is_not_counted() -> None:
    """All of it below what an exposure resolves, so that its rms is that of the path."""
    jitter = {"kind": "white", "rms_arcsec": 3.0, "low_hz": 0.001, "high_hz": 0.01}
    data = night(pointing=ASIDE | {"attitude": {"jitter": [jitter]}})
    scene = parse_scene(data)
    [told] = [note for note in observe(scene, [1000.0]).notes if "random motion" in note]
    assert f"({3.0 / 3600.0 / np.degrees(scene.sensor.ifov_rad):.2g} px rms)" in told
    assert not any("random motion" in note for note in observe(scene).notes)
    steady = observe(parse_scene(night(pointing=ASIDE)), [1000.0])
    assert not any("random motion" in note for note in steady.notes)


def test_an_object_that_decays_while_it_is_exposed_is_omitted_and_told(tmp_path: Path) -> None:
    """The middle of the exposure, which is asked for, is some minutes before its end."""
    first, second = tle(7, 51.6, 10.0, 0.001, 20.0, 30.0, 16.2)
    first = with_checksum(first.replace("23000-4", "90000-2"))
    (tmp_path / "low.tle").write_text(f"{first}\n{second}\n")
    low, day = Satrec.twoline2rv(first, second), 2458593.5
    fraction = np.arange(0.4, 3.0, 10.0 / DAY_S)
    failed = low.sgp4_array(np.full(len(fraction), day), fraction)[0] != 0
    assert not failed[0]
    decay_s = (fraction[np.argmax(failed)] - 10.0 / 24.0) * DAY_S  # after 2019-04-20 10:00
    crowd = {"name": "crowd", "path": str(tmp_path / "low.tle"), "body": BALL}
    exposure = {"integration_s": 900.0, "frames": 1}
    scene = parse_scene(night(targets=[], populations=[crowd], pointing=ASIDE, exposure=exposure))
    assert observe(scene, [decay_s - 3600.0]).table.num_rows == 1
    during = observe(scene, [decay_s - 200.0])
    assert during.table.num_rows == 0
    assert any("1 of 1 element sets omitted" in note for note in during.notes)


def test_the_observers_elements_are_as_old_as_the_first_time_too() -> None:
    """Ten days before the scene they are not known yet; at its own time they are fresh."""
    line1, line2 = tle(7, 51.6, 10.0, 0.001, 20.0, 30.0, 15.2)
    orbit = {"kind": "tle", "line1": line1, "line2": line2}
    air = {"background": {"zodiacal": True}, "observer": {"kind": "orbit", "orbit": orbit}}
    scene = parse_scene(night(pointing=ASIDE, **air))
    for first, told in ((-10.0 * DAY_S, True), (0.0, False)):
        _, notes = groups_of(scene, times_of(scene, [first, 60.0]))
        assert any("observer: its own orbit: elements of 9.707 days" in n for n in notes) == told
