"""What is observed as files and as a table; measured places; one line for each mistake."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import BadInput
from pipeline.execute.sources import place_targets
from pipeline.observe.centroid import centroid_covariance_px2
from pipeline.observe.files import tdm_text, write
from pipeline.observe.observe import observe
from pipeline.plan.pointing.geometry import plan_geometry, sampled_frames
from pipeline.resolve.resolve import resolve
from pipeline.route.prepare import plan_scene
from pipeline.spec.load import parse_scene
from tests.command import nightglass
from tests.observe.conftest import night


@pytest.fixture
def scene(tmp_path: Path, population: dict[str, Any]) -> Path:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(night(populations=[population])))
    return path


def test_files_hold_the_same_rows(scene: Path, tmp_path: Path) -> None:
    for name in ("seen.parquet", "seen.csv", "seen.json"):
        result = nightglass("observe", scene, "-o", tmp_path / name)
        assert result.returncode == 0, result.stderr
        lines = [line for line in result.stdout.splitlines() if str(tmp_path) not in line]
        assert max(map(len, lines)) <= 80
    table = pq.read_table(tmp_path / "seen.parquet")
    rows = table.to_pylist()
    assert json.loads(table.schema.metadata[b"notes"])
    from_json = json.loads((tmp_path / "seen.json").read_text())
    from_csv = list(csv.DictReader((tmp_path / "seen.csv").open()))
    assert len(rows) == len(from_json["rows"]) == len(from_csv) == 3 * 603
    for row, other, text in zip(rows, from_json["rows"], from_csv, strict=True):
        for key, value in row.items():
            if isinstance(value, float) and np.isnan(value):
                assert other[key] is None
                assert text[key] == ""
            else:
                assert other[key] == value
        assert float(text["ra_deg"]) == row["ra_deg"]
        assert text["seen"] == row["seen"]
    printed = json.loads(nightglass("observe", scene, "--json").stdout)
    assert printed == from_json


def test_endings_in_capitals_are_the_same_forms(scene: Path, tmp_path: Path) -> None:
    for name, held, said in (
        ("A.CSV", '"frame"', "all rows"),
        ("B.Json", "{", "all rows"),
        ("C.TDM", "CCSDS_TDM", "what is seen"),
    ):
        result = nightglass("observe", scene, "--snr", "1", "-o", tmp_path / name)
        assert result.returncode == 0, result.stderr
        assert f"{name}: {said}" in result.stdout
        assert (tmp_path / name).read_text().startswith(held)


def tdm(path: Path) -> list[tuple[dict[str, str], list[tuple[str, str, float]]]]:
    """The segments of a message: metadata, and (keyword, time, value) of its data."""
    segments: list[Any] = []
    for line in path.read_text().splitlines():
        if line == "META_START":
            segments.append(({}, []))
        elif " = " in line and segments:
            key, value = line.split(" = ")
            if key in ("ANGLE_1", "ANGLE_2", "MAG"):
                time, number = value.split()
                segments[-1][1].append((key, time, float(number)))
            else:
                segments[-1][0][key] = value
    return segments


def test_a_tracking_data_message_read_back(scene: Path, tmp_path: Path) -> None:
    path = tmp_path / "seen.tdm"
    assert nightglass("observe", scene, "--snr", "1", "-o", path).returncode == 0
    rows = [r for r in observe(parse_scene(json.loads(scene.read_text())), None, 1.0)
            .table.to_pylist() if r["seen"] == "yes"]  # fmt: skip
    found = {
        (meta["PARTICIPANT_2"], time, key): value
        for meta, data in tdm(path)
        for key, time, value in data
    }
    assert len(found) == 3 * len(rows) > 0
    for row in rows:
        at = row["name"], row["utc"].rstrip("Z")
        assert found[*at, "ANGLE_1"] == pytest.approx(row["ra_deg"], abs=1e-9)
        assert found[*at, "ANGLE_2"] == pytest.approx(row["dec_deg"], abs=1e-9)
        assert found[*at, "MAG"] == pytest.approx(row["v_mag"], abs=1e-4)
    names = [meta["PARTICIPANT_2"] for meta, _ in tdm(path)]
    assert names == sorted({row["name"] for row in rows})  # a segment for each, though they take
    assert len(names) < len(rows)  # turns, frame by frame
    meta, data = tdm(path)[0]
    assert (meta["TIME_SYSTEM"], meta["ANGLE_TYPE"], meta["PATH"]) == ("UTC", "RADEC", "2,1")
    assert (meta["START_TIME"], meta["STOP_TIME"]) == (data[0][1], data[-1][1])


@pytest.mark.parametrize("last", ["a", "b"])
def test_the_date_of_a_message_is_that_of_its_latest_row(last: str) -> None:
    """Whichever target is seen last, of two in order of their names."""
    whole = observe(parse_scene(night(targets=night()["targets"][:1])), np.arange(3.0), 0.1)
    first, _, latest = whole.table.to_pylist()
    assert first["seen"] == latest["seen"] == "yes"
    other = "b" if last == "a" else "a"
    rows = [first | {"name": other}, latest | {"name": last}]
    table = pa.Table.from_pylist(rows, whole.table.schema)
    text = tdm_text(replace(whole, table=table))
    assert f"CREATION_DATE = {latest['utc'].rstrip('Z')}\n" in text


def test_a_centroid_is_as_good_as_the_bound() -> None:
    """Of a Gaussian response under sky noise 2^(1/2) s / SNR an axis; s with its pixel."""
    sensor = night()["sensor"] | {"photon_noise": False, "psf": {"kind": "gaussian", "sigma_px": 3}}
    found = resolve(parse_scene(night(sensor=sensor)))
    g = plan_geometry(found.scene.scene, np.array([0]), found.scene.dut1_s)
    ball = place_targets(found.scene, g)[0]
    covariance = centroid_covariance_px2(found.scene, ball, 0)
    snr = observe(parse_scene(night(sensor=sensor))).table["snr"][0].as_py()
    wide = np.sqrt(9.0 + 1.0 / 12.0)  # of the Gaussian and the pixel
    wanted = np.eye(2) * 2.0 * (wide / snr) ** 2
    np.testing.assert_allclose(covariance, wanted, rtol=5e-3, atol=1e-6)


@pytest.mark.parametrize("sigma_px", [0.05, 0.1])
def test_a_place_within_a_pixel_is_as_well_known_as_the_pixel(sigma_px: float) -> None:
    """Of an image whose slopes tell nothing: 12^(-1/2) px an axis."""
    sensor = night()["sensor"] | {"psf": {"kind": "gaussian", "sigma_px": sigma_px}}
    row = observe(parse_scene(night(sensor=sensor)), None, 0.1, None, 7).table.to_pylist()[0]
    pixel_arcsec = np.degrees(20e-6 / 0.1) * 3600.0
    assert row["centroid_sigma_arcsec"] == pytest.approx(pixel_arcsec / 12**0.5, rel=2e-3)
    assert np.isfinite(row["ra_measured_deg"])


def test_noise_of_centroids_has_the_bounds_sigma() -> None:
    """200 exposures: the scatter of measured places is the sigma, and a seed repeats it."""
    scene = parse_scene(night(targets=night()["targets"][:1]))
    times = np.arange(200) * 0.25
    table = observe(scene, times, 0.1, None, 7).table
    row = {name: table[name].to_numpy() for name in table.column_names}
    off = np.stack([
        (row["ra_measured_deg"] - row["ra_deg"]) * np.cos(np.radians(row["dec_deg"])),
        row["dec_measured_deg"] - row["dec_deg"],
    ]) * 3600.0 / row["centroid_sigma_arcsec"]  # fmt: skip
    assert np.abs(off.mean(axis=1)).max() < 5 / np.sqrt(200)
    assert off.std(axis=1) == pytest.approx([1.0, 1.0], abs=5 / np.sqrt(400))
    fewer = [observe(scene, times[:3], 0.1, None, seed).table for seed in (7, 8)]
    assert [t.equals(table.slice(0, 3)) for t in fewer] == [True, False]


def test_a_moving_place_is_measured_at_mid_exposure() -> None:
    """Of a streak of 3 px, whose ends are many sigma from its middle."""
    tracked = observe(parse_scene(night())).table.to_pylist()[0]
    held = {f"boresight_{name}": tracked[name] for name in ("ra_deg", "dec_deg")}
    scene = parse_scene(night(
        targets=night()["targets"][:1], pointing={"mode": "sidereal"} | held,
        exposure={"integration_s": 8.0, "frames": 1},
    ))  # fmt: skip
    (row,) = observe(scene, None, 0.1, None, 7).table.to_pylist()
    for name in ("ra", "dec"):
        off_arcsec = abs(row[f"{name}_measured_deg"] - row[f"{name}_deg"]) * 3600.0
        assert off_arcsec < 5.0 * row["centroid_sigma_arcsec"]
    assert row["streak_px"] > 2.0
    assert row["centroid_sigma_arcsec"] < 5.0


BAD = {
    "--times=0,10": "times: 0,10 is not accepted; allowed: START,STOP,STEP",
    "--times=0,10,0": "times: 0,10,0 is not accepted; allowed: a step above 0 s",
    "--times=0,10,-1": "times: 0,10,-1 is not accepted; allowed: a step above 0 s",
    "--times=10,0,1": "times: 10,0,1 is not accepted; allowed: a step above 0 s and a stop after",
    "--times=0,inf,1": "times: inf is not accepted; allowed: a finite time",
    "--times=0,1e9,1": "times: 0,1e9,1 is not accepted; allowed: a step above 0 s",
    "--times=now,10,1": "times: now is not accepted; allowed: ",
    "--times=0,86400,0.01": "times: ",
    "--snr=0": "snr: 0.0 is not accepted; allowed: a signal-to-noise ratio above 0",
    "--snr=nan": "snr: nan is not accepted",
    "--set=targets=[]": "targets: none is not accepted; allowed: a target or a population",
    "--output=seen.xls": "-o: seen.xls is not accepted; allowed: a name that ends in .parquet",
    "--output=no/where.csv": "-o: no/where.csv is not accepted; allowed: a file in a folder",
}


@pytest.mark.parametrize("option", BAD)
def test_one_line_for_a_mistake(option: str, scene: Path, tmp_path: Path) -> None:
    more = ["--set", "populations=[]"]
    if option.startswith("--set"):
        more += ["--set", 'pointing={"mode": "sidereal", "boresight_ra_deg": 1, '
                          '"boresight_dec_deg": 1}']  # fmt: skip
    result = nightglass("observe", scene, *more, option)
    assert result.returncode == 2
    assert BAD[option] in result.stderr.replace("'", "")
    assert len(result.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("fault", "why"), [(OSError(5, "Input/output error"), "Input/output error"),
                       (OSError("closed by the library"), "closed by the library")],
)  # fmt: skip
def test_a_file_that_cannot_be_written_is_told(
    fault: OSError, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the system's words, or those of a library that gives no code."""
    observed = observe(parse_scene(night()), [0.0])
    monkeypatch.setattr("pyarrow.csv.write_csv", Mock(side_effect=fault))
    with pytest.raises(BadInput) as caught:
        write(observed, tmp_path / "a.csv")
    assert caught.value.field == "-o"
    assert caught.value.allowed == f"a file that can be written; {why}"
    assert not list(tmp_path.iterdir())


def test_files_of_times(scene: Path, tmp_path: Path) -> None:
    times = tmp_path / "times.txt"
    times.write_text("# middles\n2019-04-20T10:00:01Z\n\n21  # s\n")
    few = nightglass("observe", scene, "--times", times, "--json", "--set", "populations=[]")
    assert [row["utc"][11:19] for row in json.loads(few.stdout)["rows"]][::3] == [
        "10:00:01", "10:00:21"
    ]  # fmt: skip
    for text, word in (("21\n1\n", "times that rise"), ("", "0 times"), ("x\n", "allowed")):
        times.write_text(text)
        result = nightglass("observe", scene, "--times", times)
        assert (result.returncode, word in result.stderr) == (2, True)


def test_decayed_and_faulty_elements_are_reported(tmp_path: Path, scene: Path) -> None:
    """A day after their epoch all of a file can be carried; 30 years later some cannot."""
    result = nightglass("observe", scene, "--json", "--times", "9e8,9e8,1")
    found = json.loads(result.stdout)
    assert any("element sets omitted" in note for note in found["notes"])
    assert any("old elements, the worst" in note for note in found["notes"])
    assert 3 < len(found["rows"]) < 603
    long = nightglass("observe", scene, "--json", "--times", "0,9e8,4.5e8")  # 28 years: no grid
    assert 0 < len(json.loads(long.stdout)["rows"]) <= 3 * len(found["rows"])


def test_six_notes_are_shown_and_the_others_counted(
    scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = observe(parse_scene(night()))
    for many, left in ((6, None), (7, "and 1 more notes (--json)")):
        told = replace(real, notes=tuple(f"note {k}" for k in range(many)))
        monkeypatch.setattr("pipeline.commands.observe.look", lambda *_, told=told: told)
        lines = [line.strip() for line in nightglass("observe", scene).stdout.splitlines()]
        assert lines[-6 - bool(left) :] == [
            *(f"note: note {k}" for k in range(many - 6, many)), *([left] if left else ())
        ]  # fmt: skip


def test_no_message_of_nothing(scene: Path, tmp_path: Path) -> None:
    result = nightglass("observe", scene, "--snr", "1e9", "-o", tmp_path / "no.tdm")
    assert result.returncode == 2
    assert "no target that is seen" in result.stderr
    assert not (tmp_path / "no.tdm").exists()


def test_a_sky_that_fills_the_pixels_hides_all() -> None:
    """Nothing is seen before it, and the plan says so; a render is not refused."""
    for full_well_e, seen in ((1e5, "yes"), (10.0, "sky fills the pixels")):
        sensor = night()["sensor"] | {"full_well_e": full_well_e}
        data = night(sensor=sensor, background={"uniform_e_per_s": 100.0})
        assert observe(parse_scene(data)).table["seen"][0].as_py() == seen
        warned = [w for w in plan_scene(parse_scene(data))["warnings"] if "no source shows" in w]
        assert bool(warned) == (seen != "yes")


def test_each_frame_is_full_or_not_by_its_own_time() -> None:
    """A first frame that its dark current fills, beside one of a hundredth of its time."""
    for times_s in ([2.0, 0.02], [0.02, 2.0], [0.02, 2.0, 0.02, 2.0, 2.0]):
        sensor = night()["sensor"] | {"full_well_e": 5e4, "dark_e_per_s": 3e4}
        dwell = {"integration_s": times_s, "frames": len(times_s), "cadence_s": 20.0}
        scene = parse_scene(night(sensor=sensor, exposure={"integration_s": 1.0}, dwells=[dwell]))
        full = times_s.index(2.0)
        seen = [r["seen"] for r in observe(scene).table.to_pylist() if r["name"] == "ball"]
        assert seen[full] == "sky fills the pixels"
        assert seen[1 - full] == "too faint"  # in so short a time
        others = times_s.count(2.0) - 1
        [warned] = [w for w in plan_scene(scene)["warnings"] if "no source shows" in w]
        assert f"in frame {full}," in warned
        assert "6.69e+04 e-" in warned  # 6e4 of them dark charge
        more = f"there, and in {others} more of {len(times_s)} frames looked at"
        assert (more in warned, "more of" in warned) == (others > 0, others > 0)


def test_one_frame_of_each_integration_time_is_looked_at() -> None:
    """Of twelve frames the sixth alone is long, and between those that are looked at anyway."""
    times_s = [0.02] * 5 + [2.0] + [0.02] * 6
    sensor = night()["sensor"] | {"full_well_e": 5e4, "dark_e_per_s": 3e4}
    dwell = {"integration_s": times_s, "frames": len(times_s), "cadence_s": 20.0}
    plain = {"exposure": {"integration_s": 1.0}, "background": {"uniform_e_per_s": 10.0}}
    scene = parse_scene(night(sensor=sensor, dwells=[dwell], **plain))
    assert 5 not in sampled_frames(scene)
    [warned] = [w for w in plan_scene(scene)["warnings"] if "no source shows" in w]
    assert "in frame 5," in warned
    assert "more of" not in warned


@pytest.mark.parametrize("bend", [0.3, -0.3])
def test_the_converters_top_is_of_what_is_measured(bend: float) -> None:
    """A response that bends up fills the converter with less charge; one that bends down, never."""
    sensor = night()["sensor"] | {
        "full_well_e": 4e4, "adc_bits": 15, "gain_e_per_dn": 1.0, "bias_dn": 0.0,
        "detector": {"nonlinearity": {"kind": "polynomial", "coefficients": [bend]}},
    }  # fmt: skip
    full_e = resolve(parse_scene(night(sensor=sensor))).scene.full_e
    if bend < 0.0:
        assert full_e == pytest.approx(4e4)  # its well is full before
    else:
        x = full_e / 4e4
        assert 4e4 * (x + bend * x**2) == pytest.approx(32767.0, rel=1e-6)
