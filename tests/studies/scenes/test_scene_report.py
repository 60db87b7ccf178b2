"""The report on whole scenes: bounds hold, nothing lacks, the page stands alone; refusals."""

from __future__ import annotations

import io
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.errors import BadInput
from pipeline.physics.constants import ARCSEC_RAD
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.responses import CoreClass
from pipeline.plan.tiles import Tile, cut_up
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.studies.scenes import level, scenes, stage, study, switches
from pipeline.studies.scenes.exact import _below, _bright_places, _on
from pipeline.studies.scenes.figure import ladder_figure
from pipeline.studies.scenes.report import report_scenes, write
from pipeline.studies.scenes.switches import LARGEST_DOUBLED_PX, _finer_wings
from pipeline.studies.scenes.tables import print_study

NAMES, LEVELS = ("earth-limb",), "0.05"
ROW = {
    "noise_fraction", "flux_fraction", "cpu_s", "wall_s", "again_cpu_s", "again_wall_s", "peak_mb",
    "before_mb", "stars", "targets", "engine", "noise_floor_e", "light_left_out", "max_sigma",
    "rms_sigma", "max_e", "bias", "bound_sigma", "of_bound", "windows",
}  # fmt: skip


@pytest.fixture(scope="module")
def small(monkeypatch_module):
    """The same scenes on a tenth of the pixels, from shallow catalogues."""
    for name in NAMES:
        make = scenes.MAKERS[name]

        def smaller(quick, make=make):
            wish = make(quick)
            wish.data["sensor"]["shape"] = [160, 160]
            return wish

        monkeypatch_module.setitem(scenes.MAKERS, name, smaller)
    monkeypatch_module.setattr(study, "QUICK_ALL_SKY_G_MAG", 8.0)
    monkeypatch_module.setattr(study, "QUICK_WINDOWS", 3)


@pytest.fixture(scope="module")
def monkeypatch_module():
    with pytest.MonkeyPatch.context() as patch:
        yield patch


@pytest.fixture(scope="module")
def report(small, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("report") / "out"
    report_scenes(out, NAMES, LEVELS, quick=True)
    return out


def test_bounds_hold_and_nothing_lacks(report):
    found = json.loads((report / "report.json").read_text())
    assert [s["scene"] for s in found["scenes"]] == list(NAMES)
    for scene in found["scenes"]:
        assert [r["noise_fraction"] for r in scene["levels"]] == [0.05]
        for row in scene["levels"]:
            assert set(row) >= ROW
            assert row["of_bound"] <= 1.0
            assert row["max_sigma"] <= row["bound_sigma"][1]
            assert abs(row["bias"]) < row["flux_fraction"]
            assert row["cpu_s"] > 0
            assert 50 < row["peak_mb"] < 4000
        for one in scene["switches"]:
            assert one["holds"], one
    names = {s["component"] for scene in found["scenes"] for s in scene["switches"]}
    assert names >= {"background.grid", "wings_on_a_coarse_grid", "wings_cut_off", "common_streak"}
    assert "phase_interpolation" not in names  # so few stars need no tables


def test_sources_just_below_a_limit_are_looked_at():
    """The brightest ones that stand on the tiles, and so far beside them; dark ones never."""
    tiles = (Tile(0, 0, 0, 0, 50, 50), Tile(0, 0, 0, 100, 50, 50))
    x, y = np.array([10.0, 20.0, 70.0, 120.0, 30.0, 149.5]), np.full(6, 25.0)
    light_e = np.array([5.0, 7.0, 8.0, 9.0, 0.0, 6.0])
    assert _below([(8.5, 3.0)], x, y, light_e, tiles) == [
        (20.0, 25.0), (23.0, 25.0), (10.0, 25.0), (13.0, 25.0)
    ]  # fmt: skip
    assert _below([(math.inf, 0.0)], x, y, light_e, tiles)[0] == (120.0, 25.0)
    assert _below([(1.0, 0.0)], x, y, light_e, tiles) == []
    assert _below([(1.0, 0.0), (5.0, 2.0), (6.5, 4.0)], x, y, light_e, tiles) == [
        (10.0, 25.0), (12.0, 25.0), (10.0, 25.0), (14.0, 25.0)
    ]  # fmt: skip


def test_stars_stand_on_a_frame_by_their_own_column_and_row():
    plan = SimpleNamespace(camera=SimpleNamespace(columns=200, rows=100))
    x, y = np.array([150.0, 50.0, 150.0, -1.0, 50.0]), np.array([50.0, 150.0, -1.0, 50.0, 50.0])
    stars = SimpleNamespace(x_px=x, y_px=y)
    assert [_on(plan, stars, i) for i in range(5)] == [True, False, False, False, True]


def test_the_end_of_the_brightest_streak_is_looked_at():
    """Half its length beside the star, along the row: the field moves eastward, without roll."""
    data = scenes.with_accuracy(scenes.MAKERS["earth-limb"](True), 0.05, 1e-3, "none")
    across = {"mode": "rate", "boresight_ra_deg": 192.0, "boresight_dec_deg": 0.0}
    data |= {"stars": None, "targets": [], "pointing": across | {
        "rate_ra_arcsec_s": 100.0, "rate_dec_arcsec_s": 0.0}}  # fmt: skip
    plan = prepare(parse_scene(data)).plan
    g = plan_geometry(plan.scene, np.array([0]), plan.dut1_s)
    x, y = plan.camera.centre_px
    stars = SimpleNamespace(x_px=np.array([x]), y_px=np.array([y]), light_e=np.ones(1))
    middle, end = _bright_places(SimpleNamespace(plan=plan, g=g, stars=stars))
    assert middle == (x, y)
    half_px = 50.0 * plan.integration_s(0) * ARCSEC_RAD / plan.facts.ifov_rad
    assert abs(end[0] - x) == pytest.approx(half_px, rel=1e-2)
    assert end[1] == pytest.approx(y, abs=0.01 * half_px)


@pytest.mark.parametrize(("spacing_px", "finer_px"), [(16, 8), (3, 2), (2, 2), (0, 0)])
def test_finer_wings_have_wider_cores_and_half_the_grid(spacing_px, finer_px):
    data = scenes.with_accuracy(scenes.MAKERS["earth-limb"](True), 0.05, 1e-3, "none")
    plan = prepare(parse_scene(data | {"stars": None})).plan
    classes = tuple(CoreClass(r, math.inf, math.inf, 0.0, 0.0, 8) for r in (12.0, 40.0, 90.0))
    coarse = replace(plan.responses, spacing_px=spacing_px, classes=classes)
    fine = _finer_wings(replace(plan, responses=coarse)).responses
    assert fine.spacing_px == finer_px
    assert [c.radius_px for c in fine.classes] == [24.0, LARGEST_DOUBLED_PX, 90.0]


def test_page_stands_alone(report):
    text = (report / "report.html").read_text()
    body = ElementTree.fromstring(text.replace("<!DOCTYPE html>", "", 1))
    assert body.tag == "html"
    assert len(body.findall(".//img")) == 2
    assert all(i.get("src").startswith("data:image/png;base64,") for i in body.findall(".//img"))
    links = re.findall(r'(?:src|href|url)\s*[=(]\s*"?([^"\s>)]*)', text)
    assert not [link for link in links if not link.startswith("data:")]
    rows = body.findall(".//tbody/tr")
    found = json.loads((report / "report.json").read_text())
    kinds = ("levels", "switches")
    assert len(rows) == sum(len(s[kind]) for s in found["scenes"] for kind in kinds)
    assert (report / "report.png").read_bytes().startswith(b"\x89PNG")


def test_both_tables_are_printed(report, capsys):
    """A row for each level, and one for each approximation, after what it is of."""
    found = json.loads((report / "report.json").read_text())
    print_study(found)
    rows = capsys.readouterr().out.splitlines()
    for scene in found["scenes"]:
        names = [f"{r['noise_fraction']:g}" for r in scene["levels"]]
        names += [s["component"] for s in scene["switches"]]
        assert not {f"{scene['title']}, {name}" for name in names} - set(rows)


def test_figure_of_one_level(report):
    """A ladder of one level, and errors of exactly zero, are drawn too."""
    found = json.loads((report / "report.json").read_text())
    for scene in found["scenes"]:
        scene["levels"] = [scene["levels"][0] | {"max_sigma": 0.0, "rms_sigma": 0.0}]
    assert ladder_figure(found).startswith(b"\x89PNG")
    found["scenes"] = 3 * found["scenes"]  # side by side
    width, height = Image.open(io.BytesIO(ladder_figure(found))).size
    assert width > 2 * height


@pytest.mark.parametrize("quick", [True, False])
@pytest.mark.parametrize("name", scenes.MAKERS)
def test_scenes_are_scenes(name, quick):
    wish = scenes.MAKERS[name](quick)
    made = parse_scene(scenes.with_accuracy(wish, 0.05, 1e-3, "none"))
    assert made.name == name
    assert 1 <= wish.share[0] <= wish.share[1]
    assert np.prod(made.sensor.shape) <= 9e8


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--scene", "no-such"], "--scene"),
        (["--levels", "0.5,x"], "--levels"),
        (["--levels", "0"], "--levels"),
        (["--levels", "2"], "--levels"),
        (["--levels", "nan"], "--levels"),
        (["--levels", ","], "--levels"),
        (["--catalog", "/no/such/catalogue"], "/no/such/catalogue"),
    ],
)
def test_bad_input_is_one_message(options, said, tmp_path):
    done = CliRunner().invoke(app, ["report", "scenes", "-o", str(tmp_path / "new"), *options])
    assert isinstance(done.exception, BadInput)
    assert said in str(done.exception)
    assert not (tmp_path / "new").exists()


def test_scenes_and_levels_of_the_command(monkeypatch, tmp_path):
    """They reach the study, where a scene that is named twice is one."""
    asked = []
    monkeypatch.setattr("pipeline.commands.studies.scenes.scenes.report_scenes",
                        lambda *given: asked.append(given[:5]) or {"sigma": math.nan})  # fmt: skip
    words = ["--scene", "wide-field", "--scene", "earth-limb", "--levels", "0.5,0.05", "--json"]
    done = CliRunner().invoke(app, ["report", "scenes", "-o", str(tmp_path), *words])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout) == {"sigma": None}
    names = ("wide-field", "earth-limb")
    assert asked == [(tmp_path, names, "0.5,0.05", False, None)]
    assert [r.name for r in scenes.requests((*names, "wide-field"), True)] == list(names)


def test_a_folder_that_is_not_empty_is_refused(tmp_path):
    (tmp_path / "old.txt").write_text("kept")
    with pytest.raises(BadInput, match="new or empty"):
        report_scenes(tmp_path, quick=True)
    with pytest.raises(BadInput, match="new or empty"):
        report_scenes(tmp_path / "old.txt", quick=True)
    with pytest.raises(BadInput, match="a folder that can be made"):
        report_scenes(tmp_path / "old.txt" / "in", quick=True,
                      progress=lambda *_: pytest.fail("measured"))  # fmt: skip


def test_levels_that_are_nearly_one_have_folders_of_their_own(monkeypatch, tmp_path) -> None:
    folders = []

    def measured(order):
        folders.append(order["folder"])
        return {"stars": 0, "targets": 0, "windows": 0, "sources": 0, "switches": []}

    monkeypatch.setattr(study, "run_child", measured)
    levels = study.checked_levels("0.1234567,0.1234568", True)
    study.run_study(("earth-limb",), levels, True, tmp_path, tmp_path)
    assert len(set(folders)) == 3


def test_the_catalogue_is_deep_where_the_usual_scenes_look(monkeypatch, tmp_path) -> None:
    """Whether they were named or not."""
    asked = []

    def stop(names, quick, folder):
        asked.append(names)
        raise BadInput("catalogue", "made", "enough")

    monkeypatch.setattr(study, "make_catalogue", stop)
    for names, quick in (((), True), ((), False), (("earth-limb",), True)):
        with pytest.raises(BadInput):
            study.run_study(names, (0.5,), quick, None, tmp_path)
    assert asked == [study.QUICK_SCENES, tuple(scenes.MAKERS), ("earth-limb",)]


def test_each_tile_is_drawn_from_the_blocks_that_it_touches(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two rows of three blocks: a tile in one, one across the border of two, all; each once."""
    places, drawn = cut_up((20, 30), (10, 10)), []
    monkeypatch.setattr(stage, "plan_blocks", lambda *_: places)
    monkeypatch.setattr(stage, "render_block", lambda *given: drawn.append(given[2]) or given[2])
    around = stage.blocks_by(SimpleNamespace(rows=0, g=None, stars=None), None)  # type: ignore
    assert around(Tile(0, 0, 12, 21, 5, 5)) == [places[5]]
    assert around(Tile(0, 0, 2, 8, 5, 5)) == [places[0], places[1]]
    assert around(Tile(0, 0, 0, 0, 20, 30)) == list(places)
    assert sorted(drawn, key=places.index) == list(places)


def test_seconds_count_the_blocks_once_and_the_rest_as_often_as_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A drawing that takes 5 s for its block, and 1 s for each part of it, by its own clock."""
    clock = SimpleNamespace(now=0.0, process_time=lambda: clock.now)
    monkeypatch.setattr(switches, "time", clock)

    def drawing() -> Any:
        left = [5.0]

        def light(_: Tile) -> None:
            clock.now += (left.pop() if left else 0.0) + 1.0

        return light

    tiles = (Tile(0, 0, 0, 0, 64, 64), Tile(0, 1, 0, 64, 64, 64))
    assert switches._seconds(drawing, tiles) == 5.0 + 2.0 + 2.0
    assert switches._seconds(drawing, tiles[:1], 30.0) == 5.0 + 1.0 + 30.0


def test_an_image_that_is_no_number_does_not_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    tile = Tile(0, 0, 0, 0, 4, 4)
    one, nothing = ({"stars_e": np.full((4, 4), value)} for value in (1.0, np.nan))
    monkeypatch.setattr(switches, "mean_of", lambda _, light, __: light["stars_e"])
    monkeypatch.setattr(switches, "light_by", lambda *_: lambda _: one)
    of_noise = SimpleNamespace(windows=(tile, tile), noise_e=(1.0, 1.0))
    facts = SimpleNamespace(sigma_floor_e=1.0)
    of_plan: Any = SimpleNamespace(plan=SimpleNamespace(facts=facts))
    for off, holds in ((one, True), (nothing, False)):
        switch = switches.Switch("sky", lambda: lambda _: one, lambda off=off: lambda _: off, 0.5)  # type: ignore[misc]
        found = switches._measured(of_plan, (tile,), of_noise, switch)  # type: ignore[arg-type]
        assert found["holds"] is holds


def test_the_sky_at_each_pixels_own_place_takes_that_of_the_grids(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(switches, "exact_sky", lambda _: lambda _: "exact")
    drawing: Any = switches._with_exact_sky(None, lambda: lambda _: {"a": 1, "background_e": 2})  # type: ignore
    assert drawing()(None) == {"a": 1, "background_e": "exact"}


def test_a_study_with_errors_that_are_no_numbers_is_written(report: Path, tmp_path: Path) -> None:
    found = json.loads((report / "report.json").read_text())
    level = found["scenes"][0]["levels"][0]
    level |= {"max_sigma": math.nan, "rms_sigma": math.inf, "windows": 7}
    write(found, tmp_path)
    told = json.loads((tmp_path / "report.json").read_text())["scenes"][0]["levels"][0]
    assert (told["max_sigma"], told["rms_sigma"], told["windows"]) == (None, None, 7)
    assert "nan" in (tmp_path / "report.md").read_text()


def test_the_largest_error_of_windows_is_no_number_where_one_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    means = iter([np.full((2, 2), 3.0), np.full((2, 2), np.nan)])
    monkeypatch.setattr(level, "mean_of", lambda *_: next(means))
    monkeypatch.setattr(level, "allowed_e", lambda _, noise, *__: noise)
    monkeypatch.setattr(level, "lights_near", lambda *_: ([], []))
    monkeypatch.setattr(level, "total_sigma", lambda _: 0.0)
    none = np.zeros((2, 2))
    exact: Any = SimpleNamespace(windows=(0, 1), mean_e=(none, none), noise_e=(none + 1, none + 1))
    of: Any = SimpleNamespace(plan=SimpleNamespace(decisions=()))
    assert math.isnan(level.errors_against(of, lambda _: {}, exact)["max_e"])
