"""Rows of what is observed: windows of times, files of noise, light, and what a table shows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.execute.sources import place_targets
from pipeline.observe.centroid import centroid_covariance_px2
from pipeline.observe.observe import Observed, observe
from pipeline.observe.on_axis import on_axis_light_e
from pipeline.observe.times import times_of
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.resolve.resolve import resolve
from pipeline.spec.load import parse_scene
from tests.command import nightglass
from tests.observe.conftest import BALL, in_high_orbit, night
from tests.physics.positions.test_orbit_skyfield import tle
from tests.physics.targets.test_off_axis import scene_of

ALONE: dict[str, Any] = {"targets": night()["targets"][:1]}


def test_windows_of_times_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows, noise of centroids and their order; every exposure draws its own noise."""
    scene, times = parse_scene(night()), np.arange(7) * 3.0
    whole = observe(scene, times, 1.0, None, 7).table
    monkeypatch.setattr("pipeline.observe.observe.SAMPLES", 6)  # two times of three targets
    told: list[tuple[int, int | None]] = []
    cut = observe(scene, times, 1.0, lambda _, done, of: told.append((done, of)), 7).table
    assert told == [(6, 21), (12, 21), (18, 21), (21, 21)]
    for name in whole.column_names:
        a, b = whole[name].to_numpy(), cut[name].to_numpy()
        if whole[name].type == "double":
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=name)
        else:
            assert (a == b).all(), name
    ball = cut.slice(0, 21).to_pylist()[::3]
    noise = [(row["ra_measured_deg"] - row["ra_deg"]) * 3600.0 for row in ball]
    assert len({round(n, 4) for n in noise}) == 7


def test_more_rows_than_may_be_are_refused_by_what_asks_for_them() -> None:
    scene, rows = parse_scene(night()), len(night()["targets"]) * 25
    times = np.arange(25.0)
    assert observe(scene, times, most_rows=rows).table.num_rows == rows
    allowed = f"at most {rows - 1} rows (times x targets); here {rows}"
    with pytest.raises(BadInput) as caught:
        observe(scene, times, most_rows=rows - 1)
    assert str(caught.value) == f"times: 25 is not accepted; allowed: {allowed}"
    exposed = parse_scene(night(exposure={"integration_s": 1.0, "frames": 25, "cadence_s": 2.0}))
    with pytest.raises(BadInput) as caught:
        observe(exposed, most_rows=rows - 1)
    assert str(caught.value) == f"exposure.frames: 25 is not accepted; allowed: {allowed}"


def test_noise_is_of_each_target() -> None:
    """Two like each other at one place have noises of their own."""
    twins = [{"name": n, "orbit": in_high_orbit(150.0), "body": BALL} for n in ("ball", "twin")]
    table = observe(parse_scene(night(targets=twins)), None, 1.0, None, 7).table.to_pylist()
    assert table[0]["ra_deg"] == table[1]["ra_deg"]
    assert table[0]["ra_measured_deg"] != table[1]["ra_measured_deg"]


def test_what_is_not_seen_has_no_measured_place() -> None:
    """Though it stands in the field: here all are asked for an SNR that none has."""
    for least_snr, seen, measured in ((1.0, "yes", True), (1e9, "too faint", False)):
        row = observe(parse_scene(night() | ALONE), None, least_snr, None, 7).table.to_pylist()[0]
        assert row["seen"] == seen
        for name in ("ra_measured_deg", "dec_measured_deg", "centroid_sigma_arcsec"):
            value = row[name]
            assert (value is not None and bool(np.isfinite(value))) == measured, name


def test_a_bright_centroid_has_the_noise_of_its_own_photons() -> None:
    """s / SNR of a Gaussian response of s pixels, the pixel's own width in it."""
    sensor = night()["sensor"] | {"read_noise_e": 0.1, "psf": {"kind": "gaussian", "sigma_px": 3}}
    bright = [{"name": "ball", "orbit": in_high_orbit(150.0), "body": BALL | {"diameter_m": 60.0}}]
    found = resolve(parse_scene(night(sensor=sensor, targets=bright, background=None))).scene
    g = plan_geometry(found.scene, np.array([0]), found.dut1_s)
    target = place_targets(found, g)[0]
    sigma = np.sqrt(np.diag(centroid_covariance_px2(found, target, 0)))
    snr = np.sqrt(float(target.light_e))
    np.testing.assert_allclose(sigma, np.sqrt(9.0 + 1.0 / 12.0) / snr, rtol=0.02)


def test_a_centroid_counts_the_flat() -> None:
    """A flat of 0.25 sees what a quantum efficiency of a quarter sees: source and sky."""
    found = []
    for wish in ({"flat": 0.25}, {"quantum_efficiency": 0.25}):
        one = night(sensor=night()["sensor"] | wish, background={"uniform_mag_arcsec2": 18.0})
        row = observe(parse_scene(one | ALONE), None, 0.1, None, 7).table.to_pylist()[0]
        found.append(row["centroid_sigma_arcsec"])
    assert found[0] == pytest.approx(found[1], rel=1e-3)


def test_a_message_with_noise(tmp_path: Path) -> None:
    """Its angles are the measured ones, its comments tell their sigma and the object, its date is
    that of the last row."""
    path, scene = tmp_path / "seen.tdm", tmp_path / "scene.json"
    scene.write_text(json.dumps(night()))
    asked = ("observe", scene, "--centroid-noise", "7", "-o", path, "--json")
    rows = [r for r in json.loads(nightglass(*asked).stdout)["rows"] if r["seen"] == "yes"]
    lines = path.read_text().splitlines()
    for row in rows:
        time = row["utc"].rstrip("Z")
        assert f"ANGLE_1 = {time} {row['ra_measured_deg']:.9f}" in lines
        assert f"ANGLE_2 = {time} {row['dec_measured_deg']:.9f}" in lines
    assert f"CREATION_DATE = {max(r['utc'] for r in rows).rstrip('Z')}" in lines
    assert "COMMENT ball is A BALL" in lines
    sigma = [r["centroid_sigma_arcsec"] for r in rows if r["name"] == "ball"]
    told = f"sigma {min(sigma):.4g} to {max(sigma):.4g} arcsec"
    assert f"COMMENT Angles with the noise of centroids, {told}" in lines
    assert [r["object_name"] for r in rows if r["name"] == "ball"] == ["A BALL"] * 3
    assert nightglass(*asked).returncode == 2  # a path that exists
    assert path.read_text().splitlines() == lines
    path.unlink()
    other = json.loads(nightglass(*asked[:3], "8", *asked[4:]).stdout)["rows"]
    assert other[0]["ra_measured_deg"] != rows[0]["ra_measured_deg"]


def test_electrons_per_second() -> None:
    for integration_s in (0.5, 2.0):
        exposure = {"integration_s": integration_s, "frames": 1}
        for row in observe(parse_scene(night(exposure=exposure))).table.to_pylist():
            assert row["electrons_per_s"] == pytest.approx(row["electrons"] / integration_s)


def test_times_and_the_frames_that_they_are_like() -> None:
    """Both ends count; each time is like the exposure whose middle is nearest: 1, 21 and 41 s."""
    scene = parse_scene(night())
    asked = times_of(scene, "0,40,5")
    assert asked.middle_s.tolist() == [0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0]
    assert asked.frame.tolist() == [0, 0, 0, 1, 1, 1, 1, 2, 2]
    np.testing.assert_allclose(asked.late_s, asked.middle_s - [1, 1, 1, 21, 21, 21, 21, 41, 41])
    assert times_of(scene, "0,1,0.1").middle_s[-1] == pytest.approx(1.0)
    rounded = times_of(scene, "0,0.3,0.1").middle_s  # 0.3 / 0.1 is less than 3
    assert rounded == pytest.approx([0.0, 0.1, 0.2, 0.3])
    mixed = times_of(scene, "2019-04-20T10:00:30Z,60,20").middle_s
    np.testing.assert_allclose(mixed, [30.0, 50.0])
    exposed = times_of(scene, None)
    assert (exposed.middle_s.tolist(), exposed.as_exposed) == ([1.0, 21.0, 41.0], True)


@pytest.mark.parametrize("step", ["inf", "-inf", "nan", "0", "-5", "soon"])
def test_steps_that_are_none(step: str) -> None:
    """Refused before anything is worked out with them (a RuntimeWarning fails the test)."""
    with pytest.raises(BadInput, match="a step above 0 s"):
        times_of(parse_scene(night()), f"0,10,{step}")


def test_out_of_the_field_streaks_along_the_columns_charge() -> None:
    """Past a camera whose charge moves down the columns, as one that looks at it has them."""
    sensor = night()["sensor"] | {"detector": {"readout": {"kind": "tdi", "rows_per_s": 2.0}}}
    rows = []
    for off_deg in (0.0, 30.0):
        far = observe(parse_scene(night(**ALONE))).table.to_pylist()[0]
        pointing = {"mode": "sidereal", "boresight_ra_deg": far["ra_deg"],
                    "boresight_dec_deg": far["dec_deg"] + off_deg}  # fmt: skip
        scene = night(sensor=sensor, pointing=pointing, exposure={"integration_s": 2.0}, **ALONE)
        rows.append(observe(parse_scene(scene)).table.to_pylist()[0])
    assert [row["snr_at"] for row in rows] == ["frame", "boresight"]
    assert rows[1]["streak_px"] == pytest.approx(rows[0]["streak_px"], rel=1e-2)


def test_light_counts_while_the_earth_does_not_hide_it() -> None:
    """Out of the field as on it: a quarter of the exposure, a quarter of the light."""
    found = resolve(parse_scene(night())).scene
    g = plan_geometry(found.scene, np.arange(3), found.dut1_s)
    whole = on_axis_light_e(found, g, np.ones((3, 3)))
    part = on_axis_light_e(found, g, np.full((3, 3), 0.25))
    assert whole.min() > 0.0
    np.testing.assert_allclose(part, 0.25 * whole)


def test_out_of_the_field_of_a_camera_that_follows_another() -> None:
    """Both are near the geostationary ring: turned onto the far one the camera follows it, too."""
    exposure = {"integration_s": 10.0}
    sidereal = {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 80.0}
    rows = []
    for pointing in (night()["pointing"], sidereal):
        table = observe(parse_scene(night(exposure=exposure, pointing=pointing))).table.to_pylist()
        rows.append(next(row for row in table if row["name"] == "far"))
    followed, passed = rows
    assert (followed["snr_at"], passed["snr_at"]) == ("boresight", "boresight")
    ifov_arcsec = np.degrees(20e-6 / 0.1) * 3600.0
    assert passed["streak_px"] == pytest.approx(passed["rate_arcsec_s"] * 10.0 / ifov_arcsec, 1e-3)
    assert followed["streak_px"] < 0.15 * passed["streak_px"]


@pytest.mark.parametrize("where", ["frame", "beside", "other times"])
def test_a_spinning_plate_shines_as_in_the_mean_of_its_turns(where: str) -> None:
    """Of whole turns in an exposure the light is that of one turn, however many there are.

    Nine looks in an exposure, each at the same face, saw a dark plate or one twice too bright.
    """
    quaternion = {"quaternion": [0.8, 0.3, -0.4, 0.33]}
    plates = [
        {"name": f"{turns}", "orbit": in_high_orbit(150.0),
         "body": {"kind": "plate", "area_m2": 30.0, "albedo": 0.3,
                  "attitude": {"kind": "spin", "rate_deg_s": 36.0 * turns, "axis": [1, 0, 0]}
                  | quaternion}}
        for turns in (1, 4, 8)
    ]  # fmt: skip
    pointing = {"mode": "target", "target": "1"}
    if where == "beside":
        pointing = {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 80.0}
    exposure = {"integration_s": 10.0, "frames": 1}
    scene = parse_scene(night(targets=plates, pointing=pointing, exposure=exposure))
    rows = observe(scene, [5.0, 40.0] if where == "other times" else None).table.to_pylist()
    assert {row["snr_at"] for row in rows} == {"boresight" if where == "beside" else "frame"}
    for first in range(0, len(rows), 3):
        light = np.array([row["electrons"] for row in rows[first : first + 3]])
        mags = np.array([row["v_mag"] for row in rows[first : first + 3]])
        np.testing.assert_allclose(light, light[0], rtol=3e-3)
        np.testing.assert_allclose(mags, mags[0], atol=3e-3)


def test_out_of_the_field_each_exposure_has_its_own_time_and_noise() -> None:
    """Of two dwells the second is four times as long: as much light a second, and twice the SNR
    under a bright sky."""
    away = {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 80.0}
    scene = night(pointing=away, background={"uniform_e_per_s": 1e9}, **ALONE) | {
        "exposure": {"integration_s": 1.0},
        "dwells": [{"integration_s": 1.0}, {"integration_s": 4.0, "start_s": 5.0}],
        "sensor": night()["sensor"] | {"focal_length_m": 0.01},
    }
    first, second = observe(parse_scene(scene)).table.to_pylist()
    assert (first["snr_at"], second["snr_at"]) == ("boresight", "boresight")
    assert second["electrons_per_s"] == pytest.approx(first["electrons_per_s"], rel=1e-3)
    assert second["snr"] == pytest.approx(2.0 * first["snr"], rel=0.03)


def shown(*options: Any) -> list[str]:
    result = nightglass("observe", *options)
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


def test_the_table_shows_each_targets_best_time(tmp_path: Path) -> None:
    """With more than 20 rows: of each target the highest SNR of those that are seen."""
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps(night()))
    found: Observed = observe(parse_scene(night()), "0,7200,300")
    rows = found.table.to_pylist()
    lines = shown(scene, "--times", "0,7200,300")
    assert lines[0].startswith(f"{len(rows)} rows (times x targets): {found.counts()['yes']} seen")
    ball = max((r for r in rows if r["name"] == "ball" and r["seen"] == "yes"),
               key=lambda r: r["snr"])  # fmt: skip
    (line,) = [line for line in lines if "A BALL" in line]
    for word in (ball["utc"][11:19], f"{ball['range_m'] / 1e3:.0f}", f"{ball['v_mag']:.1f}",
                 f"{ball['azimuth_deg']:.1f}", f"{ball['elevation_deg']:.1f}"):  # fmt: skip
        assert word in line.split()
    assert line.split()[-1] == (f"{ball['snr']:.3g}" if ball["snr"] < 100 else f"{ball['snr']:.0f}")


def test_a_population_none_of_which_is_drawn(tmp_path: Path, population: dict[str, Any]) -> None:
    """All are out of the field, as at other times; and where none can be followed, none is told."""
    aside = {"mode": "sidereal", "boresight_ra_deg": 180.0, "boresight_dec_deg": 70.0}
    scene = night(targets=[], populations=[population], pointing=aside, background=None)
    scene["sensor"] = night()["sensor"] | {"focal_length_m": 1.0}
    read = parse_scene(scene)
    rows, alike = (observe(read, times).table.to_pylist() for times in (None, [1.0, 21.0, 41.0]))
    assert len(rows) == len(alike) == 3 * 600
    assert not any(row["in_frame"] or row["snr_at"] == "frame" for row in rows)
    assert [(r["name"], r["seen"]) for r in rows] == [(r["name"], r["seen"]) for r in alike]
    drawn = resolve(read).scene.scene  # its population has been looked through
    assert not drawn.targets
    assert observe(drawn).table.num_rows == 0
    (tmp_path / "one.tle").write_text("\n".join(tle(2, 51.6, 10.0, 0.001, 20.0, 30.0, 16.2)))
    scene["populations"] = [population | {"path": str(tmp_path / "one.tle")}]
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    told = shown(tmp_path / "scene.json", "--times", "9e8,9e8,1")  # it has decayed
    assert told[0] == "0 rows (times x targets): no target to observe"


@pytest.mark.parametrize("albedo", [1e-6, 1e-5])
def test_a_disc_is_measured_as_a_disc_in_the_frame_and_beside_it(albedo: float) -> None:
    """SNR of a sphere of 30 px is that of its pixels wherever the camera looks; and its place is
    known worse than by a point's image, as its limb alone moves."""
    data = scene_of(0.0, False, 12.0)
    data["sensor"] |= {"focal_length_m": 0.125, "psf": {"kind": "gaussian", "sigma_px": 1.5}}
    data["background"] = {"uniform_mag_arcsec2": 20.0}
    data["targets"][0]["body"]["albedo"] = albedo
    data["exposure"]["integration_s"] = 0.02
    rows = []
    for ra_deg in (270.0, 300.0):
        data["pointing"] |= {"boresight_ra_deg": ra_deg, "boresight_dec_deg": 0.0}
        (row,) = observe(parse_scene(data), centroid_seed=1).table.to_pylist()
        rows.append(row)
    assert [row["snr_at"] for row in rows] == ["frame", "boresight"]
    assert rows[0]["snr"] == pytest.approx(rows[1]["snr"], rel=0.02)
    sigma_px = rows[0]["centroid_sigma_arcsec"] / np.degrees(10e-6 / 0.125) / 3600.0
    point = np.sqrt(2.0) * 1.5 / rows[0]["snr"]
    assert 4.0 * point < sigma_px < 20.0 * point
