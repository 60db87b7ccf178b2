"""What a study is made of: its seed, its cameras, what may be left out, what it takes."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.capacity.candidates import find_candidates, path_of
from pipeline.capacity.course import make_course
from pipeline.capacity.run import forecast_of
from pipeline.errors import BadInput
from pipeline.physics.detection import threshold_sigma
from tests.observe.test_against_others import tle

pytestmark = pytest.mark.usefixtures("coarse_signal")
Data = dict[str, Any]


def test_weather_comes_by_the_studys_seed(data: Data, tmp_path: Path) -> None:
    data["sensors"][0]["field_of_regard"] = {"clear_fraction": 0.5, "weather_h": 0.5}
    at, clear = np.arange(0.0, 28_800.0, 60.0), []
    for seed in (3, 3, 4):
        clear.append(make_course(data | {"seed": seed}, tmp_path).watchers[0].watch(at).works)
    assert (clear[0] == clear[1]).all()
    assert (clear[0] != clear[2]).any()


@pytest.mark.parametrize(("hours", "more"), [(4824.0, {}), (8766.0, {"clear_fraction": 0.005})])
def test_a_sensor_that_works_now_and_then_is_no_idle_one(
    hours: float, more: Data, data: Data, tmp_path: Path
) -> None:
    """By moments at all hours of the day: 200 of 201 days are not all at noon; and by many, where
    it is clear for a few hours of a year."""
    data |= {"start": "2019-04-20T22:00:00Z", "duration_h": hours, "step_s": 600}
    data["sensors"] = data["sensors"][:1]
    data["sensors"][0]["field_of_regard"] = {"twilight_deg": -12.0} | more
    assert make_course(data, tmp_path).idle == ()


def rows_of(data: Data, folder: Path, least_snr: float | None = None) -> list[tuple[Any, ...]]:
    """The candidates of a study's first window, and how likely each is in one frame."""
    course = make_course(data, folder)
    if least_snr is not None:
        course.__dict__["least_snr"] = least_snr
    (folder / "parts").mkdir(parents=True)
    find_candidates(course, (0, 0))
    names = ("step", "sensor", "object", "snr", "probability")
    table = pq.read_table(path_of(folder, (0, 0)))
    return list(zip(*(table[n].to_pylist() for n in names), strict=True))


def test_none_of_the_least_probability_is_left_out(data: Data, tmp_path: Path) -> None:
    """Many frames, of which one has to show an object: faint ones have a chance, too; whatever
    other cameras there are."""
    few = copy.deepcopy(data["cameras"][0]) | {"name": "few"}
    data["cameras"][0]["exposure"] |= {"frames": 12}
    data["cameras"].insert(0, few)
    data["sensors"] = [one | {"camera": data["cameras"][1]["name"]} for one in data["sensors"]]
    data["catalogue"]["synthetic"] |= {"objects": 150, "smallest_m": 0.05, "largest_m": 0.5}
    data |= {"duration_h": 3.0, "detection": {"least_probability": 0.4}}
    found = rows_of(data, tmp_path / "a")
    assert found == rows_of(data, tmp_path / "b", -20.0)
    one = threshold_sigma(1e-6) + threshold_sigma(1.0 - 0.4)  # of 0.4 in a single frame
    assert sum(row[3] < one for row in found) > 10
    assert min(row[4] for row in found) >= 0.4


def test_sensors_have_their_own_cameras(data: Data, tmp_path: Path) -> None:
    data["cameras"].append(data["cameras"][0] | {"name": "other", "tracking": "sidereal"})
    data["sensors"][0] |= {"camera": "other"}
    course = make_course(data, tmp_path)
    assert [w.tracks for w in course.watchers] == [False, True]
    assert course.units.tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    ("hours", "step_s", "steps"), [(1.0, 60.0, 60), (1.0, 500.0, 8), (1.1, 60.0, 66)]
)
def test_steps_hold_all_of_the_period(
    data: Data, tmp_path: Path, hours: float, step_s: float, steps: int
) -> None:
    course = make_course(data | {"duration_h": hours, "step_s": step_s}, tmp_path)
    assert course.steps == steps
    assert course.hours == pytest.approx(steps * step_s / 3600.0)


def test_a_period_that_is_no_whole_number_of_steps_is_told(data: Data, tmp_path: Path) -> None:
    """0.25 h in steps of 600 s are 1200 s."""
    told = [
        make_course(data | {"duration_h": hours, "step_s": step_s}, tmp_path).census.lines()
        for hours, step_s in ((0.25, 600.0), (8.0, 60.0), (1.5, 600.0))
    ]
    assert told == [["duration_h: 0.25; 0.3333 h are simulated: whole steps of 600 s"], [], []]


def test_rules_that_name_no_object_are_told(data: Data, tmp_path: Path) -> None:
    """Made-up objects are MADE 1 DEB and so on, numbered from 900000001."""
    rules: list[Data] = [
        {"numbers": [25631, 900_000_001], "priority": 9},
        {"numbers": [25631], "priority": 9},
        {"name_contains": "made 7 "},
        {"name_contains": "jcsta", "priority": 0},
        {},
    ]
    tasking = data["tasking"] | {"rules": rules}
    course = make_course(data | {"tasking": tasking}, tmp_path)
    words = "names no object of the catalogue"
    assert course.census.lines() == [f"tasking.rules.{i} {words}" for i in (1, 3)]


def test_elements_of_another_time_are_omitted(data: Data, tmp_path: Path) -> None:
    """By their days before the period's start or after its end (2019-04-20 06:00, two days)."""
    lines = []
    for k, day in enumerate((107.25, 109.25, 110.25, 112.0, 113.25, 115.3)):
        one, two = tle(k + 1, 51.6, 10.0, 0.001, 20.0, 30.0, 15.0)
        one = one[:18] + f"19{day:012.8f}" + one[32:68]
        lines += [one + str(sum(int(c) if c.isdigit() else c == "-" for c in one) % 10), two]
    (tmp_path / "days.tle").write_text("\n".join(lines))
    body = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}
    population = {"name": "days", "path": str(tmp_path / "days.tle"), "body": body}
    data["catalogue"] = {"populations": [population], "most_age_days": 1.5}
    course = make_course(data | {"duration_h": 48.0}, tmp_path)
    assert course.elements.number.tolist() == [2, 3, 4, 5]
    assert "2 of 6 element sets omitted: their epoch is more than 1.5 days" in (
        "".join(course.census.lines())
    )


def test_a_forecast_is_of_all_points(data: Data, tmp_path: Path) -> None:
    one = forecast_of(data, tmp_path)
    axis = {"field": "sensors.0.observer.latitude_deg", "values": [0.0, 20.7, 30.0]}
    three = forecast_of(data | {"axes": [axis], "seeds": 2}, tmp_path)
    assert (one["points"], three["points"]) == (1, 6)
    assert three["cpu_s"] == pytest.approx(6 * one["cpu_s"])
    hours = [6.0, 30.0, 12.0]
    alone = [forecast_of(data | {"duration_h": h}, tmp_path)["cpu_s"] for h in hours]
    together = data | {"axes": [{"field": "duration_h", "values": hours}]}
    assert forecast_of(together, tmp_path)["cpu_s"] == pytest.approx(sum(alone))


def test_an_orbit_of_a_sensor_is_doubted(data: Data, tmp_path: Path) -> None:
    """In the forecast, by the sensor's name; at the end of the period."""
    assert forecast_of(data, tmp_path)["remarks"] == []
    elements = {"semi_major_axis_m": 7.158e6, "eccentricity": 0.001, "inclination_deg": 98.6}
    orbit = {"kind": "keplerian", "true_anomaly_deg": 0.0, **elements}
    data["sensors"].append({"name": "sat", "observer": {"kind": "orbit", "orbit": orbit}})
    (told,) = forecast_of(data | {"duration_h": 720.0}, tmp_path)["remarks"]
    assert told.startswith("sat: its own orbit: two-body motion")
    assert "in 30 days from its elements turns the node by 29." in told  # sun-synchronous


def test_a_sensor_of_the_catalogue_does_not_look_for_itself(data: Data, tmp_path: Path) -> None:
    """Another sensor does; the study says it."""
    lines = [tle(k, 51.6, 10.0, 0.001, 20.0, 30.0 + k, 15.0) for k in (1, 2)]
    (tmp_path / "two.tle").write_text("\n".join(line for both in lines for line in both))
    body = {"kind": "sphere", "diameter_m": 5.0, "albedo": 0.2}
    two = {"name": "two", "path": str(tmp_path / "two.tle"), "body": body}
    data["catalogue"] = {"populations": [two], "most_age_days": 100.0}
    data["sensors"] = [
        {"name": f"sat-{k}", "observer": {"kind": "orbit", "orbit": {
            "kind": "tle", "line1": line1, "line2": line2}}}
        for k, (line1, line2) in enumerate(lines)
    ]  # fmt: skip
    rows = rows_of(data, tmp_path)
    assert {(sensor, object_) for _, sensor, object_, *_ in rows} == {(0, 1), (1, 0)}
    told = "sat-0: it is 1 of the catalogue, and does not look for itself"
    assert told in make_course(data, tmp_path).remarks


def test_frames_needed_are_those_of_every_dwell(data: Data, tmp_path: Path) -> None:
    other = data["cameras"][0] | {"name": "other", "exposure": {"integration_s": 1.0, "frames": 5}}
    data |= {"cameras": [data["cameras"][0], other], "detection": {"frames_needed": 4}}
    with pytest.raises(BadInput, match=r"detection.frames_needed: 4 .*frames of a dwell, 3"):
        make_course(data, tmp_path)
