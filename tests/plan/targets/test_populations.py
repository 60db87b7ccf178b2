"""Populations: none that crosses the field is missed, every kind of file, faults told."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from sgp4 import exporter
from sgp4.api import Satrec

from benchmarks.targets import EPOCH, population
from pipeline.errors import BadInput
from pipeline.inputs.targets import population_files
from pipeline.inputs.targets.populations import gather_populations, screened
from pipeline.physics.positions import orbit_screen
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.positions.refraction import refract
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.vectors import separation, unit
from pipeline.plan.bodies.paths import target_paths
from pipeline.plan.bodies.sights import Moments
from pipeline.plan.pointing.air import air_of
from pipeline.plan.pointing.geometry import _observer, _vantage, camera_of, plan_geometry
from pipeline.plan.pointing.pointing import attitudes
from pipeline.plan.targets.populations import Sieve, look_of, whole_sky, with_members
from pipeline.plan.timing import dwell_plans
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import load_scene, parse_scene
from pipeline.spec.scene import Scene, Target
from pipeline.spec.targets.orbit import TleOrbit
from pipeline.store.cube import open_cube
from pipeline.survey.elements import gather_elements

COUNT = 1200
BALL = {"kind": "sphere", "diameter_m": 2.0, "albedo": 0.2}
SITE = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055}
ORBIT: Any = TleOrbit.model_construct(kind="tle", line1="", line2="")
LOW = {"kind": "orbit", "orbit": {
    "kind": "keplerian", "perigee_radius_m": 6.9e6, "eccentricity": 0.001, "inclination_deg": 60,
    "true_anomaly_deg": 40.0}}  # fmt: skip


@pytest.fixture(scope="module")
def lines() -> list[list[str]]:
    """Two-line elements of many satellites, each after its name."""
    out = []
    for i, satellite in enumerate(population(COUNT, seed=5)):
        satellite.classification, satellite.intldesg = "U", "00001A"
        out.append([f"OBJECT {i} {'DEB' if i % 3 else 'R/B'}", *exporter.export_tle(satellite)])
    return out


@pytest.fixture(scope="module")
def tle(lines: list[list[str]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("population") / "many.tle"
    path.write_text("\n".join(line for three in lines for line in three) + "\n")
    return path


def scene(path: Path, **more: Any) -> Scene:
    """A wide field over a site (or what is given), one population."""
    extra = more.pop("population", {})
    return parse_scene({
        "schema": "nightglass/scene/1", "name": "crowd", "epoch": EPOCH, "observer": SITE,
        "accept": ["sun", "daylight"],
        "sensor": {
            "shape": [256, 256], "pixel_pitch_um": 20.0, "focal_length_m": 0.008, "aperture_m": 0.1,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0,
        },
        "pointing": {"mode": "sidereal", "boresight_ra_deg": 95.0, "boresight_dec_deg": 20.0},
        "exposure": {"integration_s": 5.0, "frames": 3, "cadence_s": 40.0},
        "populations": [
            {"name": "crowd", "path": str(path),
             "body": BALL} | extra
        ],
    } | more)  # fmt: skip


def kept(s: Scene) -> set[str]:
    return {t.name for t in prepare(s).plan.scene.targets}


POINTINGS: dict[str, dict[str, Any]] = {
    "sidereal": {},
    "rate": {"pointing": {
        "mode": "rate", "boresight_ra_deg": 95.0, "boresight_dec_deg": 20.0,
        "rate_ra_arcsec_s": 400.0, "rate_dec_arcsec_s": 200.0}},
    "low orbit": {"observer": LOW, "pointing": {
        "mode": "sidereal", "boresight_ra_deg": 60.0, "boresight_dec_deg": 70.0}},
    "follows a low one": {
        "pointing": {"mode": "target", "target": "t"},
        "targets": [{
            "name": "t", "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.5},
            "orbit": {"kind": "state", "position_m": [1.5e5, 6.95e6, 2.6e6],
                      "velocity_m_s": [-7.2e3, 0.2e3, 1.9e3]},
        }],
    },
    "dwells": {"dwells": [
        {"frames": 3},
        {"frames": 2, "start_s": 5000.0, "pointing": {
            "mode": "sidereal", "boresight_ra_deg": 130.0, "boresight_dec_deg": 5.0}},
    ]},
}  # fmt: skip


@pytest.mark.parametrize("pointing", POINTINGS)
def test_none_is_missed(pointing: str, tle: Path) -> None:
    """Against every satellite of the file followed in steps of a second."""
    s = scene(tle, **POINTINGS[pointing])
    found = kept(s)
    every = []
    for batch in population_files.element_sets(tle, "path"):
        every += [
            {"name": f"crowd-{one.number}", "orbit": one.orbit.model_dump(), "body": BALL}
            for one in batch
        ]
    named = [t.model_dump() for t in s.targets]
    whole = parse_scene(s.as_dict() | {"populations": [], "targets": [*named, *every]})
    epoch, dwells = parse_utc(s.epoch), dwell_plans(s)
    spans = [np.arange(d.start_s, d.end_s + 0.01, 1.0) for d in dwells]
    offsets, which = np.concatenate(spans), np.repeat(np.arange(len(spans)), [*map(len, spans)])
    times = instants(epoch, offsets)
    earth = earth_and_sun(times.tt1, times.tt2)
    place, speed = _observer(whole, epoch, offsets, times, earth)
    at = Moments(epoch, offsets, times, earth, place, speed)
    attitude = attitudes(whole, which, _vantage(whole, at))
    paths = target_paths(whole, camera_of(whole), attitude, at)
    with np.errstate(invalid="ignore"):
        inside = (np.abs(paths.x_px - 127.5) <= 128.0) & (np.abs(paths.y_px - 127.5) <= 128.0)
    crossing = {t.name for t, hit in zip(whole.targets, inside.any(axis=1), strict=True) if hit}
    assert crossing <= found
    of_each = [(inside & (which == k)).any(axis=1).sum() for k in range(len(spans))]
    assert min(of_each) >= 2
    assert len(found) < 3 * len(crossing) + 8 * len(spans)  # a circle about a square


def test_none_is_missed_where_the_pointing_wanders(
    tle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By ten degrees: against every satellite of the file as a target of its own."""
    wanders = {"modes": [
        {"kind": "markov", "axis": axis, "time_constant_s": 1e4, "rms_arcsec": 36_000.0}
        for axis in "xy"
    ]}  # fmt: skip
    aim = {"mode": "sidereal", "boresight_ra_deg": 95.0, "boresight_dec_deg": 20.0}
    s = scene(tle, pointing=aim | {"attitude": wanders}, accept=["sun", "daylight", "error"])
    every = [
        {"name": f"crowd-{one.number}", "orbit": one.orbit.model_dump(), "body": BALL}
        for batch in population_files.element_sets(tle, "path") for one in batch
    ]  # fmt: skip
    whole = parse_scene(s.as_dict() | {"populations": [], "targets": every})
    g = plan_geometry(whole, np.arange(3), 0.0)
    with np.errstate(invalid="ignore"):
        off = np.maximum(np.abs(g.target_x_px - 127.5), np.abs(g.target_y_px - 127.5))
        inside = (off <= 128.0).any(axis=(1, 2))
    crossing = {t.name for t, hit in zip(whole.targets, inside, strict=True) if hit}
    assert crossing <= kept(s)
    monkeypatch.setattr("pipeline.plan.targets.populations.farthest_rad", lambda scene: 0.0)
    assert not crossing <= kept(s)


def test_truth_lists_them_and_the_product_needs_no_file(
    lines: list[list[str]], tmp_path: Path
) -> None:
    file = tmp_path / "few.tle"
    file.write_text("\n".join(line for three in lines[:400] for line in three))
    s = scene(file)
    render(s, tmp_path / "a", Options("synchronous"))
    truth = pq.read_table(tmp_path / "a" / "truth" / "targets.parquet").to_pydict()
    assert set(truth["name"]) == kept(s)
    assert np.sum(truth["in_frame"]) > 0
    file.unlink()
    again = load_scene(tmp_path / "a" / "scene.yaml")
    assert again.populations[0].screened is not None
    render(again, tmp_path / "b", Options("threads", 2))
    first, second = (open_cube(tmp_path / name)["dn"].values for name in "ab")
    assert np.array_equal(first, second)


def test_same_whatever_the_batches(tle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = prepare(scene(tle)).plan.scene
    monkeypatch.setattr(population_files, "BATCH", 97)
    assert prepare(scene(tle)).plan.scene == whole


def test_against_other_kinds_of_file(lines: list[list[str]], tle: Path, tmp_path: Path) -> None:
    """OMM as JSON, CSV and KVN, and lines without names, keep what the lines with names keep.

    So do those that begin with a byte order mark, as spreadsheets save them.
    """
    sets = [exporter.export_omm(Satrec.twoline2rv(a, b), name) for name, a, b in lines]
    (tmp_path / "a.json").write_text(json.dumps(sets, indent=1))
    with (tmp_path / "b.csv").open("w", newline="") as stream:
        table = csv.DictWriter(stream, list(sets[0]))
        table.writeheader()
        table.writerows(sets)
    (tmp_path / "c.kvn").write_text(
        "".join("CCSDS_OMM_VERS = 2.0\n" + "".join(f"{k} = {v}\n" for k, v in s.items())
                for s in sets))  # fmt: skip
    (tmp_path / "d.txt").write_text("\r\n".join(x for _, a, b in lines for x in (a, b)))
    for name in ("a.json", "b.csv"):
        text = (tmp_path / name).read_text(encoding="utf-8")
        (tmp_path / f"marked-{name}").write_text(text, encoding="utf-8-sig")
    (tmp_path / "told-b.csv").write_text("# of a survey\n" + (tmp_path / "b.csv").read_text())
    wanted = kept(scene(tle))
    for name in ("a.json", "b.csv", "c.kvn", "d.txt", "marked-a.json", "marked-b.csv",
                 "told-b.csv"):  # fmt: skip
        assert kept(scene(tmp_path / name)) == wanted, name


def test_a_name_with_the_sign_between_names_stays_whole(
    lines: list[list[str]], tmp_path: Path
) -> None:
    """Its catalogue number too, whatever kind of file it stands in."""
    _, a, b = lines[0]
    omm = exporter.export_omm(Satrec.twoline2rv(a, b), "ONE | TWO")
    (tmp_path / "a.json").write_text(json.dumps([omm]))
    (tmp_path / "c.kvn").write_text("".join(f"{k} = {v}\n" for k, v in omm.items()))
    for file in ("a.json", "c.kvn"):
        [[found]] = population_files.element_sets(tmp_path / file, "f")
        assert (found.name, found.number) == ("ONE | TWO", int(a[2:7]))


@pytest.mark.parametrize("read", [1200, 1201, 5000, 1_000_000])
def test_json_is_read_in_parts(
    read: int, lines: list[list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An object may begin in one part and end in the next; one longer than a part is refused."""
    sets = [exporter.export_omm(Satrec.twoline2rv(a, b), name) for name, a, b in lines[:40]]
    (tmp_path / "a.json").write_text(json.dumps(sets, indent=1))
    assert max(len(json.dumps(s, indent=1)) for s in sets) < 1200
    monkeypatch.setattr(population_files, "LONGEST_OBJECT", read)
    found = [s for batch in population_files.element_sets(tmp_path / "a.json", "f") for s in batch]
    assert [s.name for s in found] == [name for name, _, _ in lines[:40]]
    assert all(s.orbit is not None for s in found)
    monkeypatch.setattr(population_files, "LONGEST_OBJECT", 100)
    with pytest.raises(BadInput, match="whole OMMs"):
        list(population_files.element_sets(tmp_path / "a.json", "f"))


def test_more_objects_in_the_field_than_may_be_are_refused(
    tle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    many = len(kept(scene(tle)))
    monkeypatch.setattr("pipeline.plan.targets.populations.MOST_TARGETS", many - 1)
    with pytest.raises(BadInput) as told:
        kept(scene(tle))
    assert f"populations.0.path: '{many} objects that cross the field'" in str(told.value)
    assert f"at most {many - 1}: a smaller field, a shorter dwell" in str(told.value)


def test_the_history_of_an_object_is_one_object(
    tle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of its sets one counts, however many come into the field."""
    wanted = kept(scene(tle))
    history = tmp_path / "history.tle"
    history.write_text(tle.read_text() * 7)
    monkeypatch.setattr("pipeline.plan.targets.populations.MOST_TARGETS", len(wanted))
    assert kept(scene(history)) == wanted


@pytest.mark.parametrize("number", ["inf", "nan", "1e30", "-5", "5.5", "T0001"])
def test_a_catalogue_number_that_cannot_be_is_told(
    number: str, lines: list[list[str]], tmp_path: Path
) -> None:
    """The set is unreadable; the others of the file are used."""
    sets = [exporter.export_omm(Satrec.twoline2rv(a, b), name) for name, a, b in lines[:2]]
    sets[0]["NORAD_CAT_ID"] = number
    (tmp_path / "a.json").write_text(json.dumps(sets))
    [[bad, good]] = population_files.element_sets(tmp_path / "a.json", "f")
    assert (bad.orbit, good.orbit is not None) == (None, True)
    assert f"NORAD_CAT_ID: {number!r} is not accepted; allowed: a whole number" in bad.fault


def segment(omm: dict[str, Any]) -> str:
    """An element set as part of an OMM in XML."""
    told = {k: f"<{k}>{v}</{k}>" for k, v in omm.items()}
    of_lines = "".join(told.pop(k) for k in ("NORAD_CAT_ID", "BSTAR"))
    names = "".join(told.pop(k) for k in ("OBJECT_NAME", "OBJECT_ID"))
    return (
        f"<segment><metadata>{names}</metadata><data><meanElements>{''.join(told.values())}"
        f"</meanElements><tleParameters>{of_lines}</tleParameters></data></segment>"
    )


@pytest.mark.parametrize("first", ["# epoch = 2026-01-01", "\n# of [2026]", "A = B", "[DEB] X"])
def test_lines_before_the_first_set_do_not_tell_the_kind(
    first: str, lines: list[list[str]], tmp_path: Path
) -> None:
    path = tmp_path / "a.tle"
    path.write_text("\n".join([first, *lines[0][1:]]) + "\n")
    [[found]] = population_files.element_sets(path, "f")
    assert (found.number, found.fault) == (int(lines[0][1][2:7]), "")


@pytest.mark.parametrize("form", ["kvn", "xml", "json"])
def test_one_malformed_set_leaves_the_others(
    form: str, lines: list[list[str]], tmp_path: Path
) -> None:
    """Without BSTAR; one that stands twice is the same object, of which one counts."""
    sets = [exporter.export_omm(Satrec.twoline2rv(a, b), name) for name, a, b in lines[:2]]
    sets = [sets[0] | {"BSTAR": ""}, sets[1], sets[1]]
    path = tmp_path / f"a.{form}"
    if form == "json":
        path.write_text(json.dumps(sets))
    elif form == "kvn":
        path.write_text("".join("CCSDS_OMM_VERS = 2.0\n" + "".join(
            f"{k} = {v}\n" for k, v in s.items()) for s in sets))  # fmt: skip
    else:
        path.write_text(f"<ndm><omm><body>{''.join(map(segment, sets))}</body></omm></ndm>")
    [[bad, good, again]] = population_files.element_sets(path, "f")
    assert (bad.orbit, "no BSTAR" in bad.fault) == (None, True)
    assert (good.name, good.number, good.fault) == (lines[1][0], int(lines[1][1][2:7]), "")
    assert (good.orbit, good.number) == (again.orbit, again.number)


def test_an_element_too_large_for_any_number_is_told(
    lines: list[list[str]], tmp_path: Path
) -> None:
    name, a, b = lines[0]
    omm = exporter.export_omm(Satrec.twoline2rv(a, b), name) | {"MEAN_MOTION": 10**400}
    (tmp_path / "a.json").write_text(json.dumps([omm]))
    [[found]] = population_files.element_sets(tmp_path / "a.json", "f")
    assert "elements: 'MEAN_MOTION = 1000" in found.fault
    assert "allowed: a number" in found.fault


@pytest.mark.parametrize("bad", [b"caf\xe9", b'"' + b"x" * 200_000], ids=["latin-1", "no end"])
def test_a_csv_file_that_is_no_text_is_refused(
    bad: bytes, lines: list[list[str]], tmp_path: Path
) -> None:
    omm = exporter.export_omm(Satrec.twoline2rv(*lines[0][1:]), "A")
    head, row = ",".join(omm), ",".join(map(str, omm.values()))
    (tmp_path / "a.csv").write_bytes(f"{head}\n{row}\n".encode() + bad)
    with pytest.raises(BadInput, match=r"f: 'a\.csv' .* OMM as CSV or JSON \(UTF-8\); "):
        list(population_files.element_sets(tmp_path / "a.csv", "f"))


def test_a_table_of_sizes_of_too_many_rows_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(population_files, "MOST_ROWS", 2)
    (tmp_path / "sizes.csv").write_text("norad_id,albedo\n1,0.1\n2,0.1\n")
    assert len(population_files.read_sizes(tmp_path / "sizes.csv", "sizes")) == 2
    (tmp_path / "sizes.csv").write_text("norad_id,albedo\n1,0.1\n2,0.1\n3,0.1\n")
    with pytest.raises(BadInput, match=r"sizes: 'sizes\.csv' is not .* at most 2 rows"):
        population_files.read_sizes(tmp_path / "sizes.csv", "sizes")


def test_sizes_by_rule_and_table(tle: Path, tmp_path: Path) -> None:
    names = sorted(kept(scene(tle)))
    number = int(names[0].rpartition("-")[2])
    table = tmp_path / "sizes.csv"
    table.write_text(f"norad_id,diameter_m,albedo\n{number},7.5,\n999999,1,0.1\n")
    rules = [{"name_contains": "r/b", "diameter_m": 5.0, "albedo": 0.6},
             {"name_contains": "DEB", "diameter_m": 0.1}]  # fmt: skip
    more = {"population": {"rules": rules, "sizes": str(table)}}
    made = {t.name: t.body for t in prepare(scene(tle, **more)).plan.scene.targets}
    for name, body in made.items():
        one: Any = body
        rocket = int(name.rpartition("-")[2]) % 3 == 0
        assert one.albedo == (0.6 if rocket else 0.2)
        assert one.diameter_m == (7.5 if name == names[0] else 5.0 if rocket else 0.1)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_sizes_are_read_as_spreadsheets_write_them(tmp_path: Path, encoding: str) -> None:
    """With a mark of the encoding before the first name, or without; lines may end in both ways."""
    text = "norad_id,diameter_m,albedo\r\n7,7.5,\r\n8,,0.1\r\n"
    (tmp_path / "sizes.csv").write_bytes(text.encode(encoding))
    sizes = population_files.read_sizes(tmp_path / "sizes.csv", "sizes")
    assert sizes == {7: (7.5, None), 8: (None, 0.1)}


def test_sizes_of_no_object_are_told(tle: Path, tmp_path: Path) -> None:
    """By plan and product, as by studies; what meets one object is not."""
    table = tmp_path / "sizes.csv"
    table.write_text("norad_id,diameter_m\n999999,1\n999998,2\n")
    rules = [{"name_contains": word, "diameter_m": 5.0} for word in ("r/b", "NOSUCH")]
    made = prepare(scene(tle, population={"rules": rules, "sizes": str(table)})).plan
    (found,) = [d.reason for d in made.decisions if d.component.startswith("populations.")]
    assert "rules: no object's name contains 'NOSUCH'" in found
    assert "sizes: none of its 2 numbers is of an object of the file" in found
    made = prepare(scene(tle, population={"rules": rules[:1]})).plan
    assert made.scene.populations[0].screened.unmet == ()


def test_left_out_ones_are_told(lines: list[list[str]], tmp_path: Path) -> None:
    """Decayed elements with SGP4's code, malformed lines with what is wrong, older sets counted."""
    a = "1 99999U 98067A   19090.12345678  .00001000  00000-0  99999-1 0  999"
    b = "2 99999  51.6400 100.0000 0002000  80.0000 280.0000 16.7000000016600"
    a, b = (x + str(sum(int(c) if c.isdigit() else c == "-" for c in x) % 10) for x in (a, b))
    text = [x for three in lines for x in three] + ["FALLEN", a, b, "TORN", lines[0][1][:50]]
    text += [lines[1][0], lines[1][1][:-1] + "x", lines[1][2]]  # a wrong checksum
    text += lines[2]  # once more: as old as the other, so that it counts once
    file = tmp_path / "odd.tle"
    file.write_text("\n".join(text))
    s = prepare(scene(file)).plan.scene
    told = s.populations[0].screened
    assert told is not None
    assert (told.read, told.unreadable, told.superseded) == (COUNT + 4, 2, 1)
    assert sum(n for _, n in told.failed) == 1
    assert any("FALLEN (99999): SGP4 code" in line for line in told.left_out)
    assert any("without its other line" in line for line in told.left_out)
    assert any("checksum" in line for line in told.left_out), told.left_out
    reasons = [d["reason"] for d in plan_scene(scene(file))["decisions"]
               if d["component"] == "populations.crowd"]  # fmt: skip
    assert f"{told.kept} of {COUNT + 4} element sets come within" in reasons[0]
    assert "1 omitted: SGP4 code" in reasons[0]
    assert re.search(r"\b1 set has a younger one of the same object", reasons[0])
    assert f"2 omitted: not readable ({told.left_out[0]})" in reasons[0]


def test_sets_of_another_theory_are_omitted(lines: list[list[str]], tmp_path: Path) -> None:
    """SGP4-XP in column 63: as an OMM of that theory, told with the reason."""
    name, line1, line2 = lines[0]
    body = f"{line1[:62]}4{line1[63:68]}"
    checksum = sum(int(c) if c.isdigit() else c == "-" for c in body) % 10
    text = [x for three in lines[1:9] for x in three] + [name, f"{body}{checksum}", line2]
    (tmp_path / "xp.tle").write_text("\n".join(text))
    told = prepare(scene(tmp_path / "xp.tle")).plan.scene.populations[0].screened
    assert told is not None
    assert (told.read, told.unreadable) == (9, 1)
    assert name in told.left_out[0]
    assert "that of SGP4, in column 63" in told.left_out[0]


BAD_FILES: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "not empty"),
    "zip": (b"PK\x03\x04rest", "not an archive"),
    "gzip": (b"\x1f\x8brest", "not an archive"),
    "text": (b"hello\nworld\n", "two-line elements, or OMM"),
    "binary": (b"1 \xff\xfe\xfd" * 30, "UTF-8"),
    "json without elements": (b'[{"OBJECT_NAME": "X"}]', "can be read"),
    "broken json": (b'[{"OBJECT_NAME": "X"', "whole OMMs"),
    "long line": (b"1 " + b"x" * 100_000, "under 4096"),
    "csv of another code page": (
        b"OBJECT_NAME,NORAD_CAT_ID,EPOCH,MEAN_MOTION\n" + b"A,1,2019-01-01T00:00:00,15\n" * 4000
        + b"\xff\n", "OMM as CSV or JSON .UTF-8.; 'utf-8' codec can't decode byte 0xff"),
    "json with a number of too many digits": (
        b'[{"EPOCH": "x", "MEAN_MOTION": ' + b"1" * 5000 + b"}]", "whole OMMs"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files(name: str, tmp_path: Path) -> None:
    content, allowed = BAD_FILES[name]
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(BadInput, match=allowed):
        prepare(scene(tmp_path / "x"))


@pytest.mark.parametrize(
    ("text", "allowed"),
    [("", "columns norad_id"), ("norad_id\n1\n", "columns norad_id"),
     ("norad_id,diameter_m\n1,-2\n", "line 2"), ("norad_id,diameter_m\n1,nan\n", "line 2"),
     ("norad_id,albedo\n1,0.1\n1,0.2\n", "once"), ("norad_id,albedo\n1.5,0.1\n", "whole number"),
     ("norad_id,albedo,albedo\n1,0.1,0.2\n", "each once"),
     ("norad_id,albedo\n1,1.2\n", "from 0 to 1"), ("norad_id,diameter_m\n1,0\n", "above 0")],
    ids=["empty", "columns", "negative", "nan", "twice", "number", "doubled", "albedo", "point"],
)  # fmt: skip
def test_bad_sizes(text: str, allowed: str, tle: Path, tmp_path: Path) -> None:
    (tmp_path / "sizes.csv").write_text(text)
    with pytest.raises(BadInput, match=allowed):
        prepare(scene(tle, population={"sizes": str(tmp_path / "sizes.csv")}))


def test_names_must_not_clash(tle: Path) -> None:
    twice = scene(tle).as_dict()["populations"] * 2
    with pytest.raises(BadInput, match="do not clash"):
        prepare(scene(tle, populations=twice))
    some = scene(tle)
    target, population = prepare(some).plan.scene.targets[0], some.populations[0]
    with pytest.raises(BadInput, match=f"populations: '{target.name}'"):
        with_members(some, [([target], population), ([target], population)])
    with pytest.raises(BadInput, match="sphere"):
        scene(tle, population={
            "body": {"kind": "cube", "edge_m": 1, "albedo": 0.1},
            "rules": [{"name_contains": "X", "diameter_m": 1}]})  # fmt: skip


def test_more_objects_than_a_scene_may_have_are_refused(
    tle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one population as it is read, of several together at the end."""
    members = len(kept(scene(tle)))
    assert members > 2
    monkeypatch.setattr("pipeline.plan.targets.populations.MOST_TARGETS", members - 1)
    with pytest.raises(BadInput) as caught:
        prepare(scene(tle))
    assert caught.value.field == "populations.0.path"
    told = rf"'\d+ objects that cross the field' .*at most {members - 1}: a smaller field"
    assert re.search(told, str(caught.value))
    some = scene(tle)
    targets, population = [], some.populations[0]
    for k in range(members):
        targets.append(Target.model_construct(name=f"t-{k}", orbit=ORBIT, body=BALL))
    with pytest.raises(BadInput) as caught:
        with_members(some, [(targets, population)])
    assert str(caught.value) == (
        f"populations: '{members} targets' is not accepted; allowed: at most {members - 1} in all"
    )


def test_a_screened_population_is_not_read_again(tle: Path) -> None:
    s = prepare(scene(tle)).plan.scene
    assert gather_populations(s, 10.0, 0.0) is s


def test_a_younger_set_beside_the_field_outdates_one_inside(tle: Path) -> None:
    """Three objects with two sets each: what the older one says of the field does not count."""
    crowd = scene(tle).populations[0]
    look: Any = SimpleNamespace(half_angle_rad=0.1, length_s=85.0)
    sieve = Sieve(crowd, look, {}, "populations.0", read=6)
    sieve.numbers, sieve.ages_s = [np.array([7, 8, 9]), np.array([7, 8, 9])], [
        np.array([5000.0, 100.0, 50.0]), np.array([100.0, 5000.0, 900.0])]  # fmt: skip
    made = {n: Target.model_construct(name=n) for n in ("old 7", "young 8", "old 9", "young 9")}
    sieve.kept = [
        (0, made["old 7"]), (1, made["young 8"]), (5, made["old 9"]), (2, made["young 9"])
    ]  # fmt: skip
    targets, population = sieve.close("0" * 64)
    assert [t.name for t in targets] == ["young 8", "young 9"]
    assert population.screened is not None
    assert (population.screened.kept, population.screened.superseded) == (2, 3)


@pytest.mark.parametrize("order", [1, -1])
def test_of_several_sets_the_nearest_in_time_counts(order: int, tle: Path) -> None:
    """Whether it is of before the epoch or of after it, and in any order of the file."""
    day, fraction = parse_utc(EPOCH)
    look: Any = SimpleNamespace(
        epoch=(day, fraction), near_s=0.0, half_angle_rad=0.1, length_s=85.0,
        screen=lambda satellites: (list(range(len(satellites))), {}),
    )  # fmt: skip
    sets = []
    for number, days in ((7, (-9.0, -0.02, 0.03, 4.0)), (8, (-5.0, 0.5, 3.0)), (9, (-8.0, -2.0))):
        for at in days[::order]:
            at_jd = SimpleNamespace(jdsatepoch=day, jdsatepochF=fraction + at)
            sets.append(population_files.ElementSet(f"{number}: {at:g}", number, ORBIT, at_jd))
    sieve = Sieve(scene(tle).populations[0], look, {}, "populations.0")
    sieve.take(sets)
    targets, _ = sieve.close("0" * 64)
    assert {t.object_name for t in targets} == {"7: -0.02", "8: 0.5", "9: -2"}


def test_sets_without_a_number_are_objects_of_their_own(tle: Path) -> None:
    """None of them outdates another, and each is called by its row, in batches or at once."""
    day, fraction = parse_utc(EPOCH)
    look: Any = SimpleNamespace(
        epoch=(day, fraction), near_s=0.0, half_angle_rad=0.1, length_s=85.0,
        screen=lambda satellites: (list(range(len(satellites))), {}),
    )  # fmt: skip
    sets = [
        population_files.ElementSet(
            f"{k}", number, ORBIT, SimpleNamespace(jdsatepoch=day, jdsatepochF=fraction - k)
        )
        for k, number in enumerate((0, 7, 0, 7, 0))
    ]
    sets.insert(1, population_files.ElementSet("", 0, None, None, "broken"))
    for size in (6, 2):
        sieve = Sieve(scene(tle).populations[0], look, {}, "populations.0")
        for first in range(0, 6, size):
            sieve.take(sets[first : first + size])
        targets, population = sieve.close("0" * 64)
        assert [(t.name, t.object_name) for t in targets] == [
            ("crowd-0-1", "0"), ("crowd-7", "1"), ("crowd-0-4", "2"), ("crowd-0-6", "4"),
        ]  # fmt: skip
        assert population.screened is not None
        assert (population.screened.kept, population.screened.superseded) == (4, 1)


def test_the_cone_holds_what_the_air_lifts_into_the_field(tle: Path) -> None:
    """Wider by more than refraction bends anywhere above the horizon, as ERFA has it."""
    airy = {"observer": SITE | {"atmosphere": {"refraction": True}}}
    plain, through = (look_of(scene(tle, **more), 10.0, 0.0) for more in ({}, airy))
    air = air_of(through.scene, instants(parse_utc(EPOCH), [0.0]))
    assert air is not None
    zenith = air[0, :3]
    across = unit(np.cross(zenith, [0.3, 0.5, 0.8]))
    low = np.radians(np.linspace(0.0, 90.0, 200))[:, None]
    true = np.cos(low) * across + np.sin(low) * zenith
    bent = separation(refract(true, np.broadcast_to(air[0], (200, 5))), true).max()
    assert bent > 1e-3
    assert through.half_angle_rad >= plain.half_angle_rad + bent


def test_a_single_bias_frame_has_a_look(tle: Path) -> None:
    bias = scene(tle, exposure={"integration_s": 0.0, "frames": 1})
    look = look_of(bias, 10.0, 0.0)
    assert (look.length_s, look.turns_rad_s) == (0.0, (0.0,))
    assert kept(bias) <= kept(scene(tle))


def test_a_set_without_a_name_has_none(lines: list[list[str]], tmp_path: Path) -> None:
    """Not that of the set before it, in a file that names some."""
    mixed = [line for k, three in enumerate(lines[:6]) for line in three[k % 3 == 1 :]]
    (tmp_path / "mixed.tle").write_text("\n".join(mixed) + "\n")
    (found,) = population_files.element_sets(tmp_path / "mixed.tle", "path")
    assert [one.name for one in found] == [
        "" if k % 3 == 1 else three[0] for k, three in enumerate(lines[:6])
    ]


def test_objects_keep_the_names_of_their_file(lines: list[list[str]], tle: Path) -> None:
    """Truth and labels say what the file calls an object, beside its catalogue number."""
    named = {int(line1[2:7]): name for name, line1, _ in lines}
    targets = prepare(scene(tle)).plan.scene.targets
    assert targets
    for target in targets:
        assert target.object_name == named[int(target.name.removeprefix("crowd-"))]


@pytest.mark.parametrize("eclipse", [True, False])
def test_members_are_in_the_earths_shadow_as_their_population_says(
    eclipse: bool, tle: Path
) -> None:
    members = prepare(scene(tle, population={"eclipse": eclipse})).plan.scene.targets
    assert members
    assert {member.eclipse for member in members} == {eclipse}


def test_one_that_fails_in_any_dwell_is_in_none(tle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SGP4 carries 3 through the first dwell alone: its code is told, and it is not drawn."""
    look = look_of(scene(tle, **POINTINGS["dwells"]), 10.0, 0.0)
    each = [
        SimpleNamespace(inside=np.array([1, 3]), failed=np.array([5]), codes=np.array([1])),
        SimpleNamespace(inside=np.array([0, 1]), failed=np.array([3]), codes=np.array([6])),
    ]
    monkeypatch.setattr(type(look), "_screen", lambda self, satellites, k: each[k])
    assert look.screen([]) == ([0, 1], {3: 6, 5: 1})


def test_a_set_that_fails_outdates_none(tle: Path) -> None:
    """Of two sets of an object the younger one has decayed: the older one is drawn."""
    day, fraction = parse_utc(EPOCH)
    look: Any = SimpleNamespace(
        epoch=(day, fraction), near_s=0.0, half_angle_rad=0.1, length_s=85.0,
        screen=lambda satellites: ([0], {1: 6}),
    )  # fmt: skip
    sets = [
        population_files.ElementSet(
            f"{days:g}", 7, ORBIT, SimpleNamespace(jdsatepoch=day, jdsatepochF=fraction + days)
        )
        for days in (-9.0, -1.0)
    ]
    sieve = Sieve(scene(tle).populations[0], look, {}, "populations.0")
    sieve.take(sets)
    targets, population = sieve.close("0" * 64)
    assert [t.object_name for t in targets] == ["-9"]
    assert population.screened is not None
    assert (population.screened.superseded, population.screened.failed) == (0, ((6, 1),))


def test_an_object_of_two_populations_is_drawn_once(lines: list[list[str]], tmp_path: Path) -> None:
    """By the one whose elements are nearest to the epoch, of such the first, as studies have it;
    what is left out of which population is told."""

    def of_day(day: int, name: str, line1: str, line2: str) -> str:
        body = f"{line1[:20]}{day}{line1[23:68]}"
        checksum = sum(int(c) if c.isdigit() else c == "-" for c in body) % 10
        return f"{name}\n{body}{checksum}\n{line2}\n"

    (tmp_path / "a").write_text("".join(of_day(108, *x) for x in lines[1:61]))
    (tmp_path / "b").write_text(  # every other one is younger
        "".join(of_day(109 if k % 2 else 108, *x) for k, x in enumerate(lines[31:91]))
    )
    both = [{"name": name, "path": str(tmp_path / name), "body": BALL} for name in "ab"]
    crowd = scene(tmp_path / "a", populations=both)
    found = screened(crowd, whole_sky(crowd, 0.0, 1.0, 0.0))
    numbers = [int(line1[2:7]) for _, line1, _ in lines[1:91]]
    assert {t.name for t in found.targets} == {
        f"{'b' if k >= 60 or (k >= 30 and k % 2) else 'a'}-{n}" for k, n in enumerate(numbers)
    }
    told = [p.screened for p in found.populations if p.screened is not None]
    assert [(s.read, s.superseded, s.elsewhere) for s in told] == [(60, 0, 15), (60, 0, 15)]
    _, census = gather_elements(crowd.populations, parse_utc(EPOCH))
    assert sum(s.elsewhere for s in told) == sum(census.values())
    plan = prepare(crowd).plan
    assert len({t.name.partition("-")[2] for t in plan.scene.targets}) == len(plan.scene.targets)
    first, second = (r for r in plan.remarks if r.startswith("populations."))
    for remark, name in ((first, "a"), (second, "b")):
        assert remark.startswith(f"populations.{name}: 15 of 60 element sets omitted: another popu")
    reasons = {d.component: d.reason for d in plan.decisions}
    assert all("; 15 of 60 element sets omitted: a" in reasons[f"populations.{n}"] for n in "ab")


def test_members_may_have_a_table_of_reflectance(tle: Path) -> None:
    """An even one of 0.2 is an albedo of 0.2."""
    even = BALL | {"albedo": [[300.0, 0.2], [1100.0, 0.2]]}
    members = prepare(scene(tle, population={"body": even})).plan.scene.targets
    assert members
    assert [t.body.albedo for t in members] == pytest.approx([0.2] * len(members))  # type: ignore[union-attr]


def test_all_of_the_sky_is_looked_at_from_before_the_first_time_to_past_the_last(
    tle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Light from as far as the Moon, which left 1.3 s before; no two looks far apart."""
    asked: list[np.ndarray] = []
    monkeypatch.setattr(orbit_screen, "sgp4_codes", lambda *given: asked.append(given[2]) or {})
    look = whole_sky(scene(tle), 100.0, 700.0, 300.0)
    assert (look.screen([]), look.near_s) == (([], {}), 300.0)
    assert asked[0][0] < 100.0 - 1.3
    assert asked[0][-1] > 700.0
    assert np.diff(asked[0]).max() < 1.1 * orbit_screen.FIRST_STEP_S
