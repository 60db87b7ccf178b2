"""Finding what can be seen: the same as looking at every object at every moment."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sgp4.api import Satrec

from pipeline.errors import BadInput
from pipeline.observe.observe import observe
from pipeline.physics.positions.orbit import two_body
from pipeline.physics.positions.orbit_screen import WHOLE, states_together
from pipeline.physics.positions.orbit_sgp4 import since_epochs_s
from pipeline.physics.vectors import from_angles, unit
from pipeline.spec.load import load_scene, parse_scene
from pipeline.spec.scene import Scene
from pipeline.spec.study import FieldOfRegard, Synthetic
from pipeline.survey.elements import Elements, synthetic_elements
from pipeline.survey.find import (
    STREAKED,
    FindOptions,
    FoundObjects,
    _described,
    _offsets,
    find,
)
from pipeline.survey.search import make_search
from pipeline.survey.sights import Sights, sights_of
from pipeline.survey.watch import MOST_LIFT_RAD, PROBE, Watcher, make_watcher
from tests.command import nightglass
from tests.observe.conftest import from_file_and_state
from tests.survey.conftest import EPOCH, sections, watcher

ROOT = Path(__file__).resolve().parents[2]


def same_as_every_moment(w: Watcher, at: np.ndarray, objects: Elements) -> set[tuple[int, int]]:
    """What a search finds, object and moment, after it was found at each moment without one."""
    found, failed = make_search(w, at, 5.0).of(objects)
    assert failed == 0
    watch, satellites = w.watch(at), objects.satellites()
    place, speed, codes = states_together(satellites, since_epochs_s(satellites, EPOCH), at)
    assert (codes == WHOLE).all()
    who, when = (i.ravel() for i in np.indices(place.shape[:2]))
    flat = place.reshape(-1, 3), speed.reshape(-1, 3)
    every = sights_of(w, watch, when, who, *flat, objects.reflecting_m2[who], objects.shaded[who])
    every = every.take(every.snr >= 5.0)
    assert len(every) > 200
    wanted = set(zip(every.object.tolist(), every.moment.tolist(), strict=True))
    assert set(zip(found.object.tolist(), found.moment.tolist(), strict=True)) == wanted
    return wanted


@pytest.mark.parametrize("tracks", [True, False])
def test_against_brute_force(objects: Elements, tracks: bool) -> None:
    """Every object at every moment, without a screen: nothing missed, nothing more; night falls
    within a step of the screen, after its middle."""
    w = watcher(tracks, lowest_elevation_deg=15.0, twilight_deg=-14.0)
    at = 10.0 * np.arange(-124, 600)
    first = int(np.argmax(w.watch(at).works))
    assert first % 6 in (3, 4)
    assert any(first <= k < first // 6 * 6 + 6 for _, k in same_as_every_moment(w, at, objects))


@pytest.mark.usefixtures("coarse_signal")
def test_what_the_air_lifts_above_the_least_elevation_against_brute_force() -> None:
    """High objects, which rise and set slowly: some are seen only as the air bends their light."""
    w = watcher(True, refraction=True, lowest_elevation_deg=3.0)
    far = synthetic_elements(Synthetic(objects=600, seed=5, smallest_m=3.0), EPOCH)
    far, at = far.take(far.mean_altitude_km > 1e4), 20.0 * np.arange(600)
    same_as_every_moment(w, at, far)
    search = make_search(w, at, 5.0)
    s, _ = search.of(far)
    sine = np.sum(s.geometric * search.watch.up[s.moment], axis=-1)
    assert (sine < np.sin(np.radians(3.0))).sum() > 10


def test_from_an_orbit_against_brute_force() -> None:
    """There the horizon turns by 4 degrees in a step of the screen, and lifts what hardly moves."""
    orbit = {"kind": "keplerian", "semi_major_axis_m": 7e6, "eccentricity": 0.0,
             "inclination_deg": 30.0, "true_anomaly_deg": 10.0}  # fmt: skip
    observer = sections(observer={"kind": "orbit", "orbit": orbit})
    w = make_watcher(observer, FieldOfRegard(earth_exclusion_deg=10.0), EPOCH, True)
    far = synthetic_elements(Synthetic(objects=600, seed=5, smallest_m=3.0), EPOCH)
    far = far.take(far.mean_altitude_km > 3e4)
    same_as_every_moment(w, 10.0 * np.arange(600), far)


def test_a_watcher_whose_orbit_is_a_file(tmp_path: Path) -> None:
    """It stands where the file has it until the last moment that is looked at."""
    orbit, state = from_file_and_state(tmp_path, "a", 7e6, np.arange(-100.0, 3700.0, 10.0))
    asked = sections(observer={"kind": "orbit", "orbit": orbit})
    places = [
        make_watcher(asked | {"observer": {"kind": "orbit", "orbit": one}}, FieldOfRegard(), EPOCH,
                     True, until_s=3600.0).watch(np.array([0.0, 1800.0, 3600.0])).observer_m
        for one in (orbit, state)
    ]  # fmt: skip
    assert np.allclose(*places, rtol=0.0, atol=1e-3)
    with pytest.raises(BadInput, match="rows over all times"):
        make_watcher(asked, FieldOfRegard(), EPOCH, True, until_s=4000.0)


@pytest.mark.usefixtures("coarse_signal")
def test_a_step_is_screened_by_the_lowest_of_all_of_its_moments() -> None:
    """On an eccentric orbit the limb sinks and rises within a step; so does the limit."""
    orbit = {"kind": "keplerian", "semi_major_axis_m": 1.4e7, "eccentricity": 0.5,
             "inclination_deg": 50.0, "true_anomaly_deg": 0.0}  # fmt: skip
    observer = sections(observer={"kind": "orbit", "orbit": orbit})
    w = make_watcher(observer, FieldOfRegard(), EPOCH, True, "sensors.0")
    search = make_search(w, 10.0 * np.arange(301), 5.0)
    step = np.arange(301) // search.stride
    assert search.stride > 2
    below = search.watch.lowest - search.coarse.lowest[step]
    assert np.ptp(search.watch.lowest) > 0.3
    assert below.min() >= MOST_LIFT_RAD - 1e-12
    assert max(below[step == k].min() for k in step) <= MOST_LIFT_RAD + 1e-12


def test_a_night_is_found_and_where_to_point() -> None:
    """The best object of a night stands in the middle of a frame that is pointed as told."""
    path = ROOT / "examples" / "population.yaml"
    found = find(load_scene(path), FindOptions(night=True, step_s=60.0))
    assert found.start == "2019-04-20T05:35:00Z"
    best = found.objects[0]
    assert [o["snr"] for o in found.objects] == sorted(o["snr"] for o in found.objects)[::-1]
    from pipeline.execute.truth import target_truth
    from pipeline.plan.pointing.geometry import plan_geometry
    from pipeline.route.prepare import prepare

    half = "2019-04-20T" + best["best"][11:-1]
    at = np.datetime64(half) - np.timedelta64(1, "s")  # the middle of a frame of 2 s
    turned = [
        f"epoch={at}Z",
        f"pointing.boresight_ra_deg={best['ra_deg']}",
        f"pointing.boresight_dec_deg={best['dec_deg']}",
        "exposure.frames=1",
        "accuracy.check_cells=0",
    ]
    plan = prepare(load_scene(path, turned)).plan
    truth = target_truth(plan, plan_geometry(plan.scene, np.array([0]), plan.dut1_s))
    i = truth["object_name"].index(best["name"])
    assert abs(truth["x_px"][i] - 255.5) < 0.05
    assert abs(truth["y_px"][i] - 255.5) < 0.05
    assert truth["v_mag"][i] == pytest.approx(best["v_mag"], abs=0.01)
    assert truth["electrons"][i] == pytest.approx(best["electrons"], rel=0.01)
    assert truth["snr"][i] == pytest.approx(best["snr"], rel=0.02)


def test_an_empty_field_says_where_to_look() -> None:
    from pipeline.route.prepare import plan_scene

    scene = load_scene(
        ROOT / "examples" / "population.yaml",
        ["sensor.focal_length_m=5.0", "exposure.frames=1", "accuracy.check_cells=0"],
    )
    told = [d["reason"] for d in plan_scene(scene)["decisions"] if "crowd" in d["component"]]
    assert "`nightglass find SCENE`" in told[0]


@pytest.mark.parametrize(
    ("wish", "text"),
    [
        (FindOptions(at="yesterday"), "--at: 'yesterday' is not accepted"),
        (FindOptions(step_s=0.0), "--step: 0.0 is not accepted; allowed: a number above 0"),
        (FindOptions(step_s=float("nan")), "--step: nan"),
        (FindOptions(least_snr=float("nan")), "--snr: nan"),
        (FindOptions(hours=-1.0), "--hours: -1.0"),
        (FindOptions(hours=1e4), "--hours: 10000.0"),
        (FindOptions(hours=5.0, night=True), "--hours: '5 with --night' is not .*: one of the two"),
        (FindOptions(hours=50.0, step_s=1.0), "--step: 1.0"),
        (FindOptions(hours=1e300), "--hours: 1e.300 .* 0 to 72"),
        (FindOptions(hours="3"), "--hours: '3'"),  # type: ignore[arg-type]
        (FindOptions(step_s="3"), "--step: '3'"),  # type: ignore[arg-type]
        (FindOptions(least_snr=None), "--snr: None"),  # type: ignore[arg-type]
        (FindOptions(at="2100-12-31T23:59:00Z", hours=3.0), "--at: '10800 s after the epoch'"),
        (FindOptions(at="1900-01-01T00:00:00Z", night=True), "--at: '-43200 s after the epoch'"),
    ],
)
def test_bad_input_is_one_line(wish: FindOptions, text: str) -> None:
    with pytest.raises(BadInput, match=text) as told:
        find(load_scene(ROOT / "examples" / "population.yaml"), wish)
    assert "\n" not in str(told.value)


def test_limits_of_the_moments_are_included() -> None:
    """50,000 moments, the first at 0 and the last at the end; and 72 hours, not a second more."""
    w, most = watcher(), FindOptions(hours=49_999 / 3600.0, step_s=1.0)
    offsets = _offsets(w, most)
    np.testing.assert_array_equal(offsets, np.arange(50_000))
    with pytest.raises(BadInput, match="these: 50001"):
        _offsets(w, replace(most, hours=50_000 / 3600.0))
    assert _offsets(w, FindOptions(hours=72.0, step_s=600.0))[-1] == 72.0 * 3600.0
    with pytest.raises(BadInput, match="--hours"):
        _offsets(w, FindOptions(hours=72.001, step_s=600.0))
    assert _offsets(w, FindOptions(hours=0.0)).tolist() == [0.0]


@pytest.mark.usefixtures("coarse_signal")
def test_no_night_and_no_population_are_refused() -> None:
    path = ROOT / "examples" / "population.yaml"
    north = load_scene(path, ["observer.latitude_deg=80", "epoch=2019-06-21T00:00:00Z"])
    with pytest.raises(BadInput, match="--night: 'no darkness'"):
        find(north, FindOptions(night=True))
    with pytest.raises(BadInput, match="populations: 'none'"):
        find(load_scene(ROOT / "examples" / "site-at-night.yaml"), FindOptions())


@pytest.mark.usefixtures("coarse_signal")
def test_a_night_is_that_of_a_site_and_a_sensor_is_near_the_earth() -> None:
    orbit = {"kind": "state", "position_m": [7e6, 0, 0], "velocity_m_s": [0, 7.5e3, 0]}
    data = load_scene(ROOT / "examples" / "population.yaml").as_dict()
    data["observer"] = {"kind": "orbit", "orbit": orbit}
    with pytest.raises(BadInput, match=r"--night: 'an orbit' .*; for a satellite give --hours"):
        find(parse_scene(data), FindOptions(night=True))
    data["observer"] = {"kind": "fixed", "position_au": [1, 0, 0]}
    with pytest.raises(BadInput, match=r"observer\.kind: 'fixed' is .*allowed: ground or orbit"):
        find(parse_scene(data), FindOptions())


@pytest.mark.usefixtures("coarse_signal")
def test_objects_that_no_shadow_dims_are_found_beside_those_that_it_does(
    objects: Elements,
) -> None:
    """Deep in the night, when low objects stand in the shadow: half of them stay bright there."""
    mixed = replace(objects, shaded=np.arange(len(objects.shaded)) % 2 == 0)
    w, at = watcher(lowest_elevation_deg=15.0), 30.0 * np.arange(240, 400)
    bright = same_as_every_moment(w, at, mixed)
    dim, _ = make_search(w, at, 5.0).of(objects)
    assert len(bright) > len(dim) + 20


def test_an_object_is_described_at_its_best_moment() -> None:
    """In the middle of three, whose axes alone are turned by 90 degrees; the Earth moves there at
    1e-4 of light's speed across the line of sight, and the place among the stars is behind it."""
    plain = dict.fromkeys(Sights.__dataclass_fields__, np.array([0.001, 0.002, 0.004]))
    s = Sights(**plain | {
        "moment": np.array([2, 3, 5]), "object": np.array([1, 1, 1]),
        "geometric": np.tile([1.0, 0.0, 0.0], (3, 1)), "snr": np.array([5.0, 9.0, 6.0]),
    })  # fmt: skip
    turns, speeds = np.tile(np.eye(3), (6, 1, 1)), np.full((6, 3), 1e7)
    turns[3], speeds[3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.0, 29979.2458, 0.0]
    moments = SimpleNamespace(earth_m_s=speeds, to_gcrs=turns, offset_s=60.0 * np.arange(6.0))
    search: Any = SimpleNamespace(watch=moments, watcher=SimpleNamespace(epoch=EPOCH))
    elements: Any = SimpleNamespace(name=["a", "b"], number=[7, 8])
    told = _described(search, elements, s)
    assert (told["name"], told["number"], told["moments"]) == ("b", 8, 3)
    assert [told[k][11:16] for k in ("first", "best", "last")] == ["06:02", "06:03", "06:05"]
    assert told["ra_deg"] == pytest.approx(90.0 - np.degrees(1e-4), abs=1e-7)
    assert told["dec_deg"] == pytest.approx(0.0, abs=1e-9)
    assert told["range_km"] == pytest.approx(2e-6)
    assert (told["elevation_deg"], told["phase_deg"]) == pytest.approx((np.degrees(0.002),) * 2)
    assert told["rate_arcsec_s"] == pytest.approx(np.degrees(0.002) * 3600.0)
    assert [told[k] for k in ("sunlit_fraction", "electrons", "streak_px")] == [0.002] * 3
    assert told["snr"] == 9.0


def shown(*options: str) -> dict[str, Any]:
    """What the command finds of the example as JSON."""
    result = nightglass("find", ROOT / "examples" / "population.yaml", "--json", *options)
    assert result.returncode == 0, result.stderr
    return dict(json.loads(result.stdout))


def test_the_list_shows_the_best_and_how_many_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    """One time or two; what is beyond `--most` is counted, and how to see it all is told."""
    from pipeline.commands.observe import _print_finding

    numbers = ("ra_deg", "dec_deg", "elevation_deg", "range_km", "v_mag", "streak_px", "snr")
    seen = [
        {"name": name, "number": 7, "best": "2019-04-20T09:08:07Z"} | dict.fromkeys(numbers, 1.0)
        for name in ("one", "two", "three")
    ]
    for end, most, span, left in (
        ("09:00", 1, "09:00", ["2 more: --most 3, or --json"]),
        ("10:00", 2, "09:00 to 10:00", ["1 more: --most 3, or --json"]),
        ("10:00", 3, "09:00 to 10:00", []),
    ):
        _print_finding(FoundObjects(seen, 5, "09:00", end, ["a note"]), most)
        first, _, *rows = [line.strip() for line in capsys.readouterr().out.splitlines()]
        assert first == f"3 of 5 objects can be seen, {span}"
        assert [row.split()[:3] for row in rows[:most]] == [
            [o["name"], "7", "09:08:07"] for o in seen[:most]
        ]
        assert rows[most:] == [*left, "note: a note"]


@pytest.mark.usefixtures("coarse_signal")
def test_objects_too_faint_to_be_looked_at_are_no_failures() -> None:
    """All are left out by their bounds: none is seen, and SGP4 is not said to have failed."""
    scene = load_scene(ROOT / "examples" / "population.yaml")
    wish = FindOptions(at="2019-04-20T09:00:00Z", hours=0.1, step_s=60.0, least_snr=1e12)
    found = find(scene, wish)
    assert (found.objects, found.looked_at) == ([], 600)
    assert not [note for note in found.notes if "SGP4" in note]


@pytest.mark.usefixtures("coarse_signal")
def test_batches_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor do the parts of a batch that are looked at in one go."""
    scene = load_scene(ROOT / "examples" / "population.yaml")
    wish = FindOptions(at="2019-04-20T09:00:00Z", hours=1.0, step_s=60.0)
    whole = find(scene, wish)
    assert len(whole.objects) > 20
    monkeypatch.setattr("pipeline.survey.find.BATCH", 23)
    monkeypatch.setattr("pipeline.survey.search.MOST_STATES", 5 * 61)
    assert find(scene, wish, 2).objects == whole.objects


@pytest.mark.usefixtures("coarse_signal")
def test_objects_that_sgp4_cannot_follow_are_counted_in_all_parts(
    objects: Elements, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of those looked at in one go or in several: as many, and none of them is seen."""

    def ends(satellites: list[Satrec], *more: Any) -> tuple[np.ndarray, ...]:
        place, speed, codes = states_together(satellites, *more)
        lost = [s.inclo > 1.0 for s in satellites]
        looked_at.extend(lost)
        return place, speed, np.where(np.array(lost)[:, None], 6, codes)

    w, at = watcher(lowest_elevation_deg=15.0), 60.0 * np.arange(60)
    monkeypatch.setattr("pipeline.survey.search.states_together", ends)
    for most in (400_000, 16 * 60):
        looked_at: list[bool] = []
        monkeypatch.setattr("pipeline.survey.search.MOST_STATES", most)
        sights, failed = make_search(w, at, 5.0).of(objects)
        assert failed == sum(looked_at) > 20
        assert (np.array([s.inclo for s in objects.satellites()])[sights.object] <= 1.0).all()


@pytest.mark.usefixtures("coarse_signal")
def test_options_of_the_command() -> None:
    """Each limit leaves a part of what is found without it, and steps are as long as asked."""
    asked = ("--at", "2019-04-20T05:20:00Z", "--hours", "1.5")
    every = shown(*asked, "--step", "60", "--twilight=-6")
    assert (every["start"], every["end"]) == ("2019-04-20T05:20:00Z", "2019-04-20T06:50:00Z")
    objects = {o["name"]: o for o in every["objects"]}
    bright = shown(*asked, "--step", "60", "--twilight=-6", "--snr", "12")["objects"]
    kept = [n for n, o in objects.items() if o["snr"] >= 12.0]
    assert 0 < len(bright) < len(objects)
    assert [o["name"] for o in bright] == kept
    high = shown(*asked, "--step", "60", "--twilight=-6", "--elevation", "50")["objects"]
    assert 0 < len(high) < len(objects)
    assert all(o["elevation_deg"] >= 50.0 for o in high)
    assert min(o["first"] for o in every["objects"]) < "2019-04-20T05:30:00Z"  # by -6 degrees
    dark = shown(*asked, "--step", "60")["objects"]
    assert min(o["first"] for o in dark) == "2019-04-20T05:35:00Z"
    for o in every["objects"]:
        assert o["first"] <= o["best"] <= o["last"]
        span = np.datetime64(o["last"][:-1]) - np.datetime64(o["first"][:-1])
        assert 1 <= o["moments"] <= span.astype(int) // 60 + 1
    assert any(o["first"] < o["best"] < o["last"] for o in every["objects"])
    one = shown("--at", "2019-04-20T06:00:00Z")
    assert one["start"] == one["end"] == "2019-04-20T06:00:00Z"
    assert all(o["moments"] == 1 for o in one["objects"])


@pytest.mark.usefixtures("coarse_signal")
def test_the_best_moment_is_that_of_the_highest_snr() -> None:
    """Against each moment looked at alone."""
    singles: dict[str, dict[str, float]] = {}
    for minute in (0, 4, 8, 12):
        at = f"2019-04-20T07:{minute:02d}:00Z"
        for o in shown("--at", at)["objects"]:
            singles.setdefault(o["name"], {})[at] = o["snr"]
    found = shown("--at", "2019-04-20T07:00:00Z", "--hours", "0.2", "--step", "240")["objects"]
    assert {o["name"] for o in found} == set(singles)
    assert max(len(of) for of in singles.values()) > 2
    for o in found:
        of = singles[o["name"]]
        assert (o["first"], o["last"], o["moments"]) == (min(of), max(of), len(of))
        assert o["best"] == max(of, key=lambda at: of[at])
        assert o["snr"] == pytest.approx(max(of.values()))


@pytest.mark.usefixtures("coarse_signal")
def test_the_night_that_it_is() -> None:
    """At ten in the evening the night has begun already; at noon the next one is meant."""
    path = ROOT / "examples" / "population.yaml"
    scene, wish = load_scene(path), FindOptions(night=True, step_s=600.0, least_snr=1e6)
    now, noon = (find(scene, replace(wish, at=at)) for at in (
        "2019-04-20T08:00:00Z", "2019-04-20T22:00:00Z"))  # fmt: skip
    assert now.start < "2019-04-20T08:00:00Z" < now.end < "2019-04-20T15:30:00Z"
    assert "2019-04-21T05:00:00Z" < noon.start < "2019-04-21T06:00:00Z"


@pytest.mark.usefixtures("coarse_signal")
def test_what_sgp4_cannot_follow_is_told(tmp_path: Path) -> None:
    from tests.observe.test_against_others import tle

    lines = [tle(1, 51.6, 10.0, 0.001, 20.0, 30.0, 15.0), tle(2, 51.6, 10.0, 0.6, 20.0, 30.0, 15.0)]
    (tmp_path / "two.tle").write_text("\n".join(line for both in lines for line in both))
    told = shown("--night", "--step", "600", "--set", f"populations.0.path={tmp_path}/two.tle")
    assert "1 of 2 element sets omitted: SGP4 cannot follow them" in told["notes"]


def test_the_elements_nearest_to_the_middle_of_the_search_are_followed(tmp_path: Path) -> None:
    """The night of day 111, asked for at noon before it, is from about 5.5 to 15.3 h UTC; the sets
    are of 4.8, 10.3 and 15.8 h."""
    from tests.survey.test_elements import lines_of

    sets = ((111.2, "EARLY"), (111.43, "MIDDLE"), (111.66, "LATE"))
    path = tmp_path / "three.tle"
    path.write_text("".join(lines_of(1, day, name, n=5.0) for day, name in sets))
    data = load_scene(ROOT / "examples" / "population.yaml").as_dict()
    data["populations"][0] |= {"path": str(path), "rules": []}
    wish = FindOptions(at="2019-04-20T22:00:00Z", night=True, step_s=300.0, least_snr=0.01)
    assert [row["name"] for row in find(parse_scene(data), wish).objects] == ["MIDDLE"]


def test_old_elements_are_told(tmp_path: Path) -> None:
    """How many are more than three days old when the search ends, and the worst by 1 km and 3 km a
    day (low) or 0.5 km a day (high); of the sensor's own as well."""
    from tests.observe.test_against_others import tle

    lines = []  # the search ends on day 113.75; the last is the sensor's
    for k, day in enumerate((106.0, 110.5, 112.9, 110.5)):
        one, two = tle(k + 1, 51.6, 10.0 * k, 0.001, 20.0, 30.0, (1.0, 15.0, 15.0, 15.0)[k])
        one = one[:18] + f"19{day:012.8f}" + one[32:68]
        lines += [one + str(sum(int(c) if c.isdigit() else c == "-" for c in one) % 10), two]
    (tmp_path / "three.tle").write_text("\n".join(lines[:6]))
    orbit = {"kind": "tle", "line1": lines[6], "line2": lines[7]}
    asked = ("--at", "2019-04-23T12:00:00Z", "--hours", "6", "--step", "600")
    asked += ("--set", f"populations.0.path={tmp_path}/three.tle")
    observer = json.dumps({"kind": "orbit", "orbit": orbit})
    ground, space = shown(*asked), shown(*asked, "--set", f"observer={observer}")
    worst = "elements of 3.25 days before the times asked for: SGP4 is expected to be 10.8 km off"
    assert ground["notes"][-1] == (f"2 of the objects have old elements, the worst 2: {worst}")
    assert f"the sensor: its own orbit: {worst}" in space["notes"]


@pytest.mark.parametrize("kind", ["tle", "omm", "older", "no number"])
def test_a_sensor_does_not_find_itself(kind: str, tmp_path: Path) -> None:
    """Nor does it end the search of the others; by its number, whatever its elements, or by the
    elements."""
    from tests.observe.test_against_others import tle

    first, second = (0, 0) if kind == "no number" else (1, 2)
    both = [tle(n, 51.6, 10.0, 0.001, 20.0, 30.0 + k, 15.0) for k, n in enumerate((first, second))]
    (tmp_path / "two.tle").write_text("\n".join(line for lines in both for line in lines))
    own = tle(first, 51.6, 10.0, 0.001, 20.0, 30.1 if kind == "older" else 30.0, 15.0)
    orbit: dict[str, Any] = {"kind": "tle", "line1": own[0], "line2": own[1]}
    if kind == "omm":
        orbit = {"kind": "omm", "elements": {
            "epoch": as_utc(own[0]), "mean_motion_rev_day": 15.0, "eccentricity": 0.001,
            "inclination_deg": 51.6, "raan_deg": 10.0, "argument_of_perigee_deg": 20.0,
            "mean_anomaly_deg": 30.0, "bstar": Satrec.twoline2rv(*own).bstar}}  # fmt: skip
    observer = json.dumps({"kind": "orbit", "orbit": orbit})
    found = shown("--at", as_utc(own[0]), "--hours", "1", "--step", "60", "--snr", "0.01",
                  "--set", f"populations.0.path={tmp_path}/two.tle",
                  "--set", f"observer={observer}")  # fmt: skip
    assert [o["number"] for o in found["objects"]] == [second]
    assert "1 of 2 element sets omitted: the sensor itself" in found["notes"]


def test_observing_itself_is_refused_by_the_populations_name(tmp_path: Path) -> None:
    """Not by a target, which the scene does not have."""
    from tests.observe.test_against_others import tle

    line1, line2 = tle(1, 51.6, 10.0, 0.001, 20.0, 30.0, 15.0)
    (tmp_path / "one.tle").write_text(f"{line1}\n{line2}\n")
    orbit = {"kind": "tle", "line1": line1, "line2": line2}
    changes = [f"populations.0.path={tmp_path}/one.tle", f"epoch={as_utc(line1)}",
               f"observer={json.dumps({'kind': 'orbit', 'orbit': orbit})}"]  # fmt: skip
    with pytest.raises(BadInput, match=r"^populations\.0\.path: 'the observer at one place with"):
        observe(load_scene(ROOT / "examples" / "population.yaml", changes))


def as_utc(line1: str) -> str:
    """The epoch of elements of 2019."""
    day = np.timedelta64(round((float(line1[20:32]) - 1.0) * 86_400_000), "ms")
    return f"{np.datetime64('2019-01-01T00:00:00.000') + day}Z"


@pytest.mark.usefixtures("coarse_signal")
def test_objects_that_the_shadow_does_not_dim() -> None:
    """`eclipse: false`: they are found in the Earth's shadow, too."""
    dark = ("--night", "--step", "600", "--elevation", "60")
    lit, both = (shown(*dark, "--set", f"populations.0.eclipse={e}") for e in ("true", "false"))
    assert len(both["objects"]) > len(lit["objects"]) + 10
    assert all(o["sunlit_fraction"] == 1.0 for o in both["objects"])


def test_a_camera_that_tracks_sees_no_streaks() -> None:
    """At a higher SNR for it; one with a fixed pointing sees the streaks of its exposure."""
    moment = ("--at", "2019-04-20T06:00:00Z")
    ball = {"name": "ball", "orbit": PROBE["orbit"], "body": PROBE["body"]}
    target = ("--set", f"targets={json.dumps([ball])}",
              "--set", 'pointing={"mode": "target", "target": "ball"}')  # fmt: skip
    still, streaks = shown(*moment, *target), shown(*moment)
    assert {o["streak_px"] for o in still["objects"]} == {0.0}
    held = {o["name"]: o["snr"] for o in still["objects"]}
    assert streaks["objects"]
    for o in streaks["objects"]:  # 2 s, 20 um, 20 mm
        assert o["snr"] < held[o["name"]]
        wanted = np.radians(o["rate_arcsec_s"] / 3600.0) * 2.0 / 1e-3
        assert o["streak_px"] == pytest.approx(wanted, rel=1e-6)


BEFORE = "2019-04-20T03:00:00Z"
PLACE, SPEED = [-3.6e6, 6.2e6, 0.0], [-0.97e3, -0.56e3, 7.38e3]
AROUND = {
    "keplerian": {"semi_major_axis_m": 7.158e6, "eccentricity": 0.001, "inclination_deg": 98.6,
                  "raan_deg": 120.0, "true_anomaly_deg": 0.0},
    "state": {"position_m": PLACE, "velocity_m_s": SPEED},
    "numerical": {"position_m": PLACE, "velocity_m_s": SPEED},
    "ephemeris": {"frame": "gcrs"},
}  # fmt: skip


@pytest.mark.usefixtures("coarse_signal")
@pytest.mark.parametrize("kind", AROUND)
def test_an_orbit_without_an_epoch_begins_at_the_scenes(kind: str, tmp_path: Path) -> None:
    """Half an hour later, by --at, a satellite that looks is half an hour on its way."""
    orbit = {"kind": kind, **AROUND[kind]}
    if kind == "ephemeris":
        at = np.arange(0.0, 3600.0, 30.0)
        place, _ = two_body(np.array(PLACE), np.array(SPEED), at)
        rows = [f"{t},{x},{y},{z}" for t, (x, y, z) in zip(at, place, strict=True)]
        orbit["path"] = str(tmp_path / "way.csv")
        Path(orbit["path"]).write_text("\n".join(["time_s,x_m,y_m,z_m", *rows]))
    found = []
    for own in (None, BEFORE):
        observer = {"kind": "orbit", "orbit": orbit | {"epoch": own}}
        scene = load_scene(
            ROOT / "examples" / "population.yaml", [f"observer={json.dumps(observer)}"]
        )
        assert scene.epoch == BEFORE
        found.append(find(scene, FindOptions(at="2019-04-20T03:30:00Z")).objects)
    assert len(found[0]) > 50
    assert found[0] == found[1]


@pytest.mark.usefixtures("coarse_signal")
def test_a_day_at_a_site_is_told() -> None:
    """22:00 UTC in Hawaii is noon; by night there is nothing to say."""
    path = ROOT / "examples" / "population.yaml"
    epoch = load_scene(path).epoch[:10]
    dark = [
        any("never dark" in note for note in find(load_scene(path), FindOptions(at=at)).notes)
        for at in (f"{epoch}T22:00:00Z", f"{epoch}T09:00:00Z")
    ]
    assert dark == [True, False]


@pytest.mark.usefixtures("coarse_signal")
def test_notes_say_which_limits_hold() -> None:
    """Those of the field of regard, and the camera's own where it is the larger."""
    path, wish = ROOT / "examples" / "population.yaml", FindOptions(at="2019-04-20T06:00:00Z")
    observer = {"kind": "orbit", "orbit": {"kind": "state", **AROUND["state"]}}
    space = [f"observer={json.dumps(observer)}"]
    moon = ", 10 deg or more from the Moon"
    wide = "80 deg or more from the Sun (the camera's own limit; 30 deg while the Earth hides it)"
    for changes, told in (
        ([], "above 20 deg, the Sun below -12 deg, 30 deg or more from the Sun"),
        (space, "5 deg or more from the Earth's limb, 30 deg or more from the Sun"),
        ([*space, "sensor.sun_exclusion_deg=80"], f"5 deg or more from the Earth's limb, {wide}"),
    ):
        assert find(load_scene(path, changes), wish).notes[1] == told + moon


def test_a_pointing_that_is_not_held_is_told_with_its_size() -> None:
    """Fast jitter is all blur: its rms over what a pixel sees. Of a held camera nothing is said."""
    attitude = {"drift": {"x_arcsec_s": 3.0, "y_arcsec_s": -4.0},
                "jitter": [{"kind": "white", "rms_arcsec": 5.0, "low_hz": 1e5, "high_hz": 2e5}]}
    path, wish = ROOT / "examples" / "population.yaml", FindOptions(at="2019-04-20T06:00:00Z")
    steady, moving = (
        load_scene(path, [f"pointing.attitude={json.dumps(model)}"]) for model in (None, attitude)
    )
    assert not any("attitude" in note for note in find(steady, wish).notes)
    [told] = [note for note in find(moving, wish).notes if "attitude" in note]
    blur_px = 5.0 / 3600.0 / np.degrees(moving.sensor.ifov_rad)
    assert f"0 px rms at random, {blur_px:.2g} px of blur, a drift of 5 arcsec/s" in told


def along_orbit(o: dict[str, Any]) -> dict[str, float]:
    """Where an object stands in the local frame of a state at the epoch, 1 s later."""
    (place,), (motion,) = two_body(np.array(PLACE), np.array(SPEED), np.array([1.0]))
    up, right = unit(place), unit(np.cross(motion, place))
    there = from_angles(*np.radians([o["ra_deg"], o["dec_deg"]]))
    azimuth = np.degrees(np.arctan2(there @ right, there @ np.cross(up, right)))
    return {"azimuth_deg": azimuth, "elevation_deg": np.degrees(np.arcsin(there @ up))}


@pytest.mark.parametrize("kind", ["ground", "orbit", "rate", "sidereal"])
def test_objects_streak_past_a_camera_that_moves_as_it_is_pointed(kind: str) -> None:
    """As in a frame that is pointed at them; a note says how the camera moves."""
    path, changes = ROOT / "examples" / "population.yaml", [
        "epoch=2019-04-20T06:00:00Z", "sensor.focal_length_m=0.2", "exposure.frames=1"
    ]  # fmt: skip
    if kind == "orbit":
        observer = {"kind": "orbit", "orbit": {"kind": "state", **AROUND["state"]}}
        changes.append(f"observer={json.dumps(observer)}")
    own = {"rate_ra_arcsec_s": 300.0, "rate_dec_arcsec_s": -200.0} if kind == "rate" else {}
    own |= {"mode": "local" if kind in ("ground", "orbit") else kind}

    def aimed(**where: float) -> Scene:
        return load_scene(path, [*changes, f"pointing={json.dumps(own | where)}"])

    angles = ("azimuth_deg", "elevation_deg")
    some = angles if own["mode"] == "local" else ("boresight_ra_deg", "boresight_dec_deg")
    start = aimed(**dict.fromkeys(some, 45.0))
    found = find(start, FindOptions(at="2019-04-20T06:00:01Z"))
    assert STREAKED[own["mode"]] in found.notes[0]
    rows = {r["object_name"]: r for r in observe(start).table.to_pylist()}
    checked = [o for o in found.objects if o["streak_px"] < 400.0][:3]
    assert len(checked) == 3
    for o in checked:
        if kind == "orbit":
            where = along_orbit(o)
        elif kind == "ground":
            where = {name: rows[o["name"]][name] for name in angles}
        else:
            where = {"boresight_ra_deg": o["ra_deg"], "boresight_dec_deg": o["dec_deg"]}
        seen = observe(aimed(**where)).table.to_pylist()
        (one,) = [r for r in seen if r["object_name"] == o["name"]]
        assert one["in_frame"]
        assert o["streak_px"] == pytest.approx(one["streak_px"], rel=0.01, abs=0.05)
        assert o["snr"] == pytest.approx(one["snr"], rel=0.02)
