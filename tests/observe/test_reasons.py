"""Each reason why a target is not seen, the first one of several, and cameras that see nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import astropy.coordinates as coord
import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time

from pipeline.errors import BadInput
from pipeline.observe.observe import observe
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.targets.shadow import moon_m
from pipeline.physics.vectors import to_angles, unit
from pipeline.plan.pointing.site import place_of
from pipeline.spec.load import parse_scene
from tests.observe.conftest import BALL, SITE, from_file_and_state, in_high_orbit, night

EPOCH = "2019-04-20T10:00:00Z"
DATE = parse_utc(EPOCH)
SUN = unit(earth_and_sun(*DATE).sun_from_earth_m[0])
ACROSS = unit(np.cross(SUN, [0.0, 0.0, 1.0]))


def ball_at(place_m: Any, diameter_m: float = 3.0) -> dict[str, Any]:
    orbit = {"kind": "state", "position_m": [float(v) for v in place_m],
             "velocity_m_s": [0.0, 0.0, 0.0]}  # fmt: skip
    return {"name": "ball", "orbit": orbit, "body": BALL | {"diameter_m": diameter_m}}


def from_space(observer_m: Any, target_m: Any, diameter_m: float = 3.0, **more: Any) -> str:
    """What is said of a target that the camera is pointed at, at the first exposure."""
    towards = to_angles(np.asarray(target_m) - observer_m)
    return seen_from(
        {"kind": "orbit", "orbit": ball_at(observer_m)["orbit"]},
        [ball_at(target_m, diameter_m)],
        *(float(np.degrees(v)) for v in towards),
        **more,
    )


def seen_from(observer: Any, targets: Any, ra_deg: float, dec_deg: float, **more: Any) -> str:
    pointing = {"mode": "sidereal", "boresight_ra_deg": ra_deg, "boresight_dec_deg": dec_deg}
    scene = {"observer": observer, "targets": targets, "pointing": pointing,
             "exposure": {"integration_s": 1.0}, "background": {"uniform_e_per_s": 1.0},
             }  # fmt: skip
    return str(observe(parse_scene(night(**scene | more))).table["seen"][0])


NIGHT_SIDE, BESIDE = -2e7 * SUN, 2e7 * ACROSS


def test_seen_and_not_seen_from_space() -> None:
    beside = BESIDE + 1e6 * ACROSS
    assert from_space(BESIDE, beside) == "yes"
    assert from_space(BESIDE, beside, 1e-6) == "too faint"
    assert from_space(NIGHT_SIDE, 3e7 * SUN + 1e6 * ACROSS) == "behind the Earth"
    shadow = -8e6 * SUN
    assert from_space(shadow + 3e6 * ACROSS, shadow) == "in shadow"
    assert from_space(BESIDE, BESIDE + 1e6 * SUN) == "Sun"
    moon = unit(moon_m(*DATE)[0] - BESIDE)
    assert from_space(BESIDE, BESIDE + 1e5 * moon) == "Moon"


def test_first_of_several_reasons() -> None:
    """A tiny ball behind the Earth, in its shadow, or beside the Sun is not called faint."""
    assert from_space(NIGHT_SIDE, 3e7 * SUN, 1e-6) == "behind the Earth"
    assert from_space(BESIDE, BESIDE + 1e6 * SUN, 1e-6) == "Sun"


def test_out_of_field_and_its_edge() -> None:
    """A camera turned half a field less or more than to the edge: its width is 1.47 deg."""
    target = BESIDE + 1e6 * ACROSS
    ra, dec = (float(np.degrees(v)) for v in to_angles(target - BESIDE))
    space = {"kind": "orbit", "orbit": ball_at(BESIDE)["orbit"]}
    for off, word in ((0.70, "yes"), (0.77, "out of field")):
        assert seen_from(space, [ball_at(target)], ra, dec - off) == word


def test_streaks_that_cross_the_edge_are_seen_in_their_own_exposure() -> None:
    """At 2 km/s and 100 km away, into a field of 2.5 km: one comes in with the second exposure, one
    is gone after the first; the middle of neither streak is ever in the frame."""
    towards = unit(ACROSS)
    side = unit(np.cross(towards, SUN))
    targets = []
    for name, middle_m in (("leaves", 1600.0), ("comes", -1600.0 - 2.0 * 2000.0)):
        start_m = BESIDE + 1e5 * towards + (middle_m - 0.5 * 2000.0) * side
        targets.append(ball_at(start_m) | {"name": name})
        targets[-1]["orbit"]["velocity_m_s"] = [float(v) for v in 2000.0 * side]
    ra, dec = (float(np.degrees(v)) for v in to_angles(towards))
    scene = night(
        observer={"kind": "orbit", "orbit": ball_at(BESIDE)["orbit"]}, targets=targets,
        pointing={"mode": "sidereal", "boresight_ra_deg": ra, "boresight_dec_deg": dec},
        exposure={"integration_s": 1.0, "frames": 2, "cadence_s": 2.0}, background=None,
    )  # fmt: skip
    seen = observe(parse_scene(scene)).table["seen"].to_pylist()
    assert seen == ["yes", "out of field", "out of field", "yes"]


GEO = [{"name": "ball", "orbit": in_high_orbit(150.0), "body": BALL}]
TRACK = {"mode": "target", "target": "ball"}


def by_hours(*hours: float, **more: Any) -> list[str]:
    scene = night(targets=GEO, pointing=TRACK, **more)
    return observe(parse_scene(scene), [3600.0 * h for h in hours], 1.0).table["seen"].to_pylist()


def test_a_site_by_day_and_night() -> None:
    """Midnight and ten in the morning, also where the scene gives its own sky."""
    for background in ({"airglow": True}, {"uniform_e_per_s": 3.0}):
        assert by_hours(0.0, 10.0, background=background) == ["yes", "daylight"]


def test_a_measured_sky_holds_by_day_in_its_own_exposures() -> None:
    """A render takes a uniform sky for measured: the rising Sun of its frames is no daylight."""
    west = [{"name": "ball", "orbit": in_high_orbit(250.0), "body": BALL}]
    scene = night(targets=west, pointing=TRACK, epoch="2019-04-20T17:00:00Z",
                  background={"uniform_e_per_s": 3.0})  # fmt: skip
    assert observe(parse_scene(scene)).counts() == {"yes": 3}


def test_a_camera_that_looks_at_the_ground() -> None:
    """A tracked target that has set is below the horizon: no refusal, but a note."""
    low = {"kind": "state", "position_m": [7e6, 0, 0], "velocity_m_s": [0, 7546.0, 0]}
    scene = night(targets=[{"name": "ball", "orbit": low, "body": BALL}], pointing=TRACK)
    seen = observe(parse_scene(scene))
    assert seen.counts() == {"below horizon": 3}
    assert "where refraction is known" in seen.notes[0]
    later = observe(parse_scene(scene), "0,86400,300").counts()
    assert later["below horizon"] > 200
    assert later["in shadow"] > 3


@pytest.mark.parametrize("times", [None, "-600,3000,400"])
def test_a_camera_from_a_file(times: str | None, tmp_path: Path) -> None:
    """As from the states themselves: of rows a second apart, over exposures of a minute in which
    it looks at the ground, and at other times that the rows cover."""
    step_s, ends_s = (1.0, (-5.0, 71.0)) if times is None else (10.0, (-650.0, 3050.0))
    rows_s = np.arange(*ends_s, step_s)
    camera = from_file_and_state(tmp_path, "camera", 7.2e6, rows_s)
    low = from_file_and_state(tmp_path, "low", 7.0e6, rows_s)
    tables = []
    for k in (0, 1):
        scene = night(
            observer={"kind": "orbit", "orbit": camera[k]},
            targets=[{"name": "ball", "orbit": low[k], "body": BALL}],
            pointing=TRACK, background=None,
            exposure={"integration_s": 1.0, "frames": 7, "cadence_s": 10.0},
        )  # fmt: skip
        tables.append(observe(parse_scene(scene), times).table.to_pydict())
    assert tables[0]["seen"] == tables[1]["seen"]
    for name, within in (("ra_deg", 1e-7), ("dec_deg", 1e-7), ("range_m", 1e-3)):
        assert np.allclose(tables[0][name], tables[1][name], rtol=0.0, atol=within), name


@pytest.mark.parametrize("far", [[0.0, 1e10], [-1e10, 0.0]])
def test_times_beyond_all_dates_are_named(far: list[float]) -> None:
    with pytest.raises(BadInput, match=r"times: .*s after the epoch.*1900 to 2100"):
        observe(parse_scene(night()), far)


def test_times_that_a_file_does_not_cover_are_named(tmp_path: Path) -> None:
    of_file, _ = from_file_and_state(tmp_path, "low", 7.0e6, np.arange(-50.0, 1000.0, 10.0))
    scene = parse_scene(night(targets=[{"name": "ball", "orbit": of_file, "body": BALL}]))
    with pytest.raises(BadInput, match="one stretch of rows over all times") as refused:
        observe(scene, "0,2000,400")
    assert refused.value.field == "targets.0.orbit.path"


def test_the_sun_in_the_field_is_no_refusal() -> None:
    ra, dec = (float(np.degrees(v)) for v in to_angles(SUN))
    space = {"kind": "orbit", "orbit": ball_at(BESIDE)["orbit"]}
    assert seen_from(space, [ball_at(BESIDE + 1e6 * SUN)], ra, dec) == "Sun"
    pointing = {"mode": "sidereal", "boresight_ra_deg": 95.0, "boresight_dec_deg": 20.0}
    day = night(epoch="2019-04-20T01:00:00Z", pointing=pointing)
    assert {"daylight", "below horizon"} & set(observe(parse_scene(day)).counts())


def test_threshold() -> None:
    scene = parse_scene(night(exposure={"integration_s": 1.0}))
    row = observe(scene).table.to_pylist()[0]
    above, below = (observe(scene, None, row["snr"] * f).table["seen"][0].as_py()
                    for f in (0.999, 1.001))  # fmt: skip
    assert (above, below) == ("yes", "too faint")


def test_a_target_behind_the_camera() -> None:
    """Its numbers are those before the camera: the pointing is turned onto it."""
    target = BESIDE + 1e6 * ACROSS
    ra, dec = (float(np.degrees(v)) for v in to_angles(target - BESIDE))
    rows = []
    for place in ((ra, dec), ((ra + 180.0) % 360.0, -dec)):
        pointing = {"mode": "sidereal", "boresight_ra_deg": place[0], "boresight_dec_deg": place[1]}
        scene = night(observer={"kind": "orbit", "orbit": ball_at(BESIDE)["orbit"]},
                      targets=[ball_at(target)], pointing=pointing, background=None)  # fmt: skip
        rows.append(observe(parse_scene(scene)).table.to_pylist()[0])
    assert [row["seen"] for row in rows] == ["yes", "out of field"]
    assert [row["snr_at"] for row in rows] == ["frame", "boresight"]
    assert rows[1]["snr"] == pytest.approx(rows[0]["snr"], rel=0.01)


@pytest.mark.parametrize("off_deg", [0.0, 0.1, 30.0])
def test_a_streak_behind_the_camera_is_as_long(off_deg: float) -> None:
    """500 m/s across, 1,000 km away, for 2 s: five pixels of 0.2 mrad, before the camera or
    exactly, nearly or half behind it."""
    side = unit(np.cross(ACROSS, SUN))
    target = ball_at(BESIDE + 1e6 * ACROSS - 500.0 * side)
    target["orbit"]["velocity_m_s"] = [float(v) for v in 500.0 * side]
    ra, dec = (float(np.degrees(v)) for v in to_angles(ACROSS))
    for place in ((ra, dec), ((ra + 180.0) % 360.0, off_deg - dec)):
        pointing = {"mode": "sidereal", "boresight_ra_deg": place[0], "boresight_dec_deg": place[1]}
        scene = night(observer={"kind": "orbit", "orbit": ball_at(BESIDE)["orbit"]},
                      targets=[target], pointing=pointing, background=None)  # fmt: skip
        row = observe(parse_scene(scene)).table.to_pylist()[0]
        assert row["streak_px"] == pytest.approx(5.0, abs=1e-3)


def test_a_black_back_sends_no_light() -> None:
    """A plate that looks down at the Earth, the Sun on its front, seen from above: dark, if lit."""
    down = unit(ACROSS - 0.5 * SUN)
    target = ball_at(2e7 * down) | {"body": {
        "kind": "plate", "area_m2": 9.0, "albedo": 0.3, "attitude": {"kind": "nadir"}}}  # fmt: skip
    for far, word in ((1.05, "in shadow"), (0.95, "yes")):
        space = {"kind": "orbit", "orbit": ball_at(2e7 * far * down)["orbit"]}
        ra, dec = (float(np.degrees(v)) for v in to_angles((1.0 - far) * down))
        assert seen_from(space, [target], ra, dec) == word


def test_lamps_of_what_is_out_of_the_field() -> None:
    """They are those of a frame that is pointed at the target: as far from its middle as a render
    wants the Sun, whose limb (0.27 degrees) may not touch its corner (1.04) either."""
    space = {"kind": "orbit", "orbit": ball_at(BESIDE)["orbit"]}
    at_sun = [float(np.degrees(v)) for v in to_angles(SUN)]
    for limit_deg, off_deg, word in ((20.0, 19.9, "Sun"), (20.0, 20.1, "out of field"),
                                     (0.0, 1.2, "Sun"), (0.0, 1.4, "out of field")):  # fmt: skip
        sensor = night()["sensor"] | {"sun_exclusion_deg": limit_deg}
        off = np.radians(off_deg)
        target = ball_at(BESIDE + 1e6 * (np.cos(off) * SUN + np.sin(off) * ACROSS))
        for ra, dec in (at_sun, [at_sun[0], at_sun[1] - 60.0]):
            assert seen_from(space, [target], ra, dec, sensor=sensor) == word


@pytest.mark.parametrize(("moonlight", "words"), [(True, ("Moon", "yes")), (False, ("yes", "yes"))])
def test_near_the_moon_where_its_light_is_asked_for(
    moonlight: bool, words: tuple[str, ...]
) -> None:
    """Its light is known from 5 degrees beside it on; the corner of the field is 1.04 from it."""
    times = instants(DATE, np.array([0.5]))
    site = parse_scene(night()).observer
    here = place_of(site, times)[0][0]
    moon = unit(moon_m(*DATE)[0] - here)
    side = unit(np.cross(moon, here))
    for off_deg, word in zip((5.5, 7.0), words, strict=True):
        off = np.radians(off_deg)
        towards = np.cos(off) * moon + np.sin(off) * side
        ra, dec = (float(np.degrees(v)) for v in to_angles(towards))
        sky = {"uniform_e_per_s": 1.0, "moonlight": moonlight}
        target = ball_at(here + 1e8 * towards, 90.0)
        assert seen_from(SITE, [target], ra, dec, background=sky) == word


def test_daylight_begins_where_the_sky_is_not_known() -> None:
    """With airglow and no twilight: at the Sun's -12 degrees, by astropy."""
    hours = np.arange(0.0, 6.0, 1.0 / 30.0)
    when = Time("2019-04-20T10:00:00") + hours * u.hour
    site = coord.EarthLocation.from_geodetic(-156.3, 20.7, 3055.0)
    up = coord.get_sun(when).transform_to(coord.AltAz(obstime=when, location=site)).alt.deg
    assert ((up > -12.0) & (up < -3.0)).sum() > 5
    found = [word == "daylight" for word in by_hours(*hours, background={"airglow": True})]
    assert found == (up > -12.0).tolist()


@pytest.mark.parametrize(
    "wrong",
    [{"least_snr": 0.0}, {"least_snr": "5"}, {"centroid_seed": -1}, {"centroid_seed": 1.5}],
)
def test_limits_and_seeds_of_python_are_checked(wrong: dict[str, Any]) -> None:
    ball = {"name": "ball", "orbit": in_high_orbit(250.0), "body": BALL}
    scene = parse_scene(night(targets=[ball], pointing=TRACK))
    with pytest.raises(BadInput, match=f"{next(iter(wrong)).removeprefix('least_')}: "):
        observe(scene, **wrong)
    assert observe(scene, least_snr=np.float32(5.0), centroid_seed=np.int64(3)).table.num_rows == 3  # type: ignore[arg-type]
