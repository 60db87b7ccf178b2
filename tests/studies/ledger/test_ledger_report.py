"""The ledger's study: each rule has a probe, most are measured anew; mistakes are one message."""

from __future__ import annotations

import json
from dataclasses import make_dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.errors import BadInput
from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.targets.shadow import sunlit_past_earth
from pipeline.physics.vectors import unit
from pipeline.plan.ledger import LEDGER, rule_of
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.studies.ledger.probe import PROBES, ProbeResult
from pipeline.studies.ledger.report import report_ledger
from pipeline.studies.ledger.study import checked_rules, run_ledger
from pipeline.studies.ledger.targets import _rastered
from pipeline.studies.scenes.stage import open_stage

ROOT = Path(__file__).resolve().parents[3]
AGAIN = ("adc", "targets.perturbations")
# Rules whose probes take a second of CPU time and more; `test_all_rules_hold` measures them too.
DEAR = (
    "pointing_motion", "monochromatic_psf", "stray_light.*", "phase_interpolation",
    "wings_on_a_coarse_grid", "targets.point_sources", "targets.eclipse",
    "targets.earthshine_on_meshes",
)  # fmt: skip
QUICK = tuple(n for n in (r.components[0] for r in LEDGER) if n not in DEAR)


def test_every_rule_has_a_probe():
    assert set(PROBES) == {rule.components[0] for rule in LEDGER}


def test_two_rules_measured_anew(tmp_path):
    pytest.importorskip("trimesh")
    done = CliRunner().invoke(
        app, ["report", "ledger", "-o", str(tmp_path / "out"), "--json",
              *(word for name in AGAIN for word in ("--rule", name))],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "ledger.json").read_text())
    assert json.loads(done.stdout) == found  # and nothing else
    assert [row["rule"] for row in found["rules"]] == ["adc", "targets.forces"]
    for row in found["rules"]:
        assert row["holds"]
        assert 0.0 < row["error"] <= row["bound"]
        assert len(row["all"]) > 1
    assert "| targets.perturbations |" in (tmp_path / "out" / "ledger.md").read_text()


@pytest.mark.parametrize("frame", [0, 3])
def test_a_stage_is_of_the_frame_asked_for(frame):
    scene = {
        "schema": "nightglass/scene/1", "name": "stage", "epoch": "2019-07-20T09:00:00Z",
        "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3},
        "sensor": {
            "shape": [64, 64], "pixel_pitch_um": 9.0, "focal_length_m": 1.0, "aperture_m": 0.2,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "psf": {"kind": "gaussian", "sigma_px": 1.0},
        },
        "pointing": {"mode": "local", "azimuth_deg": 120.0, "elevation_deg": 50.0},
        "exposure": {"integration_s": 1.0, "frames": 4, "cadence_s": 60.0},
    }  # fmt: skip
    stage = open_stage(scene, frame=frame)
    g = plan_geometry(stage.plan.scene, np.arange(4), stage.plan.dut1_s).frame_slice(frame)
    assert stage.g.frame.tolist() == [frame]
    np.testing.assert_array_equal(stage.g.attitude, g.attitude)


def test_a_broken_bound_is_told():
    assert ProbeResult("x", "", 1.0, 0.9, "px", 0.0, 0.0).holds
    assert not ProbeResult("x", "", 1.0, 1.1, "px", 0.0, 0.0).holds
    assert not ProbeResult("x", "", 1.0, float("nan"), "px", 0.0, 0.0).holds


def test_streaks_are_probed_for_all_that_their_rule_decides(monkeypatch):
    from pipeline.studies.ledger import drawing

    crowd, asked = SimpleNamespace(component="crowds_by_transforms"), []
    monkeypatch.setattr(drawing, "_switched", lambda _, wanted, __: asked.extend(wanted) or ())
    monkeypatch.setattr(drawing, "_crowd", lambda _: crowd)
    found = [result.component for result in drawing.engines(SimpleNamespace(catalogue="none"))]
    ruled = rule_of("phase_interpolation").components
    assert {*asked, *found} == {*ruled} - {"star_engines"}  # which only tells what draws


def test_of_a_rolling_shutter_the_farthest_star_counts(monkeypatch):
    """Not the last one that is looked at."""
    from pipeline.studies.ledger import pointing

    ids, place = np.arange(3), np.array([20.0, 50.0, 80.0])
    camera = SimpleNamespace(rows=100, columns=100)
    stars = SimpleNamespace(x_px=place, y_px=place, source_id=ids)
    stage = SimpleNamespace(stars=stars, plan=SimpleNamespace(camera=camera))
    off_px = iter([0.1, 0.7, 0.3])

    def seen(_):
        return SimpleNamespace(x_px=place + next(off_px), y_px=place, source_id=ids)

    monkeypatch.setattr(pointing, "open_stage", lambda _: stage)
    monkeypatch.setattr(pointing, "_second_frame", seen)
    monkeypatch.setattr(pointing, "stated", lambda *_: (1.0, "px"))
    (found,) = pointing.rolling(SimpleNamespace(catalogue="none"))
    assert found.error == pytest.approx(0.7)


def test_the_bound_of_crowds_is_in_units_of_the_noise(monkeypatch):
    from pipeline.studies.ledger import drawing

    responses = make_dataclass("Responses", ["budget_e", "spectral_from"])(3.0, 5)
    facts = make_dataclass("Facts", ["sigma_floor_e"])(12.0)
    plan = make_dataclass("Plan", ["responses", "facts"])(responses, facts)
    monkeypatch.setattr(drawing, "open_stage", lambda _: SimpleNamespace(plan=plan, stars=[1, 2]))
    monkeypatch.setattr(drawing, "whole", lambda _: None)
    monkeypatch.setattr(drawing, "light_by", lambda _, one: lambda _: one.responses.spectral_from)
    monkeypatch.setattr(drawing, "mean_of", lambda _, light, tile: np.array([light + 40.0]))
    monkeypatch.setattr(drawing, "timed", lambda work, _: (0.0, work()))
    monkeypatch.setattr(drawing, "noise_of", lambda *_: np.array([10.0]))
    found = drawing._crowd(SimpleNamespace(catalogue="none"))
    assert (found.bound, found.error, found.unit) == (0.25, pytest.approx(0.1), "sigma")


def test_seconds_of_fewer_stars_and_of_all_stand_where_they_belong(monkeypatch):
    from pipeline.studies.ledger import stars

    def staged(data):
        limit = data["stars"]["faintest_g_mag"]
        few = limit == "auto"
        section = SimpleNamespace(faintest_g_mag=15.0 if few else limit)
        plan = SimpleNamespace(scene=SimpleNamespace(stars=section))
        return SimpleNamespace(plan=plan, stars=[0] * (2 if few else 7), few=few)

    monkeypatch.setattr(stars, "open_stage", staged)
    drawn = {True: (1.0, np.zeros(3)), False: (9.0, np.ones(3))}
    monkeypatch.setattr(stars, "mean_e", lambda stage: drawn[stage.few])
    monkeypatch.setattr(stars, "timed", lambda work, _: work())
    monkeypatch.setattr(stars, "stated", lambda *_: (2.0, "e-"))
    [found] = stars.faint(SimpleNamespace(catalogue="none"))
    assert (found.seconds_out, found.seconds_in, found.error) == (1.0, 9.0, 1.0)
    assert found.how.startswith("5 stars beyond G = 15 ")


def test_stars_are_compared_in_the_last_frame_that_shares_them(monkeypatch):
    """In the next one they stand where they are again, and nothing is off."""
    from pipeline.studies.ledger import stars

    plan = SimpleNamespace(shared_frames=5)

    def staged(data, frame=0):
        return SimpleNamespace(plan=plan, stars=[0] * 3, frame=frame)

    monkeypatch.setattr(stars, "open_stage", staged)
    monkeypatch.setattr(stars, "mean_e", lambda stage: np.array([stage.frame % 5 / 10.0]))
    monkeypatch.setattr(stars, "stated", lambda *_: (1.0, "e-"))
    [found] = stars.standing(SimpleNamespace(catalogue="none"))
    assert found.error == pytest.approx(0.4)


def test_the_worst_window_counts(monkeypatch):
    """Not the last one that is looked at."""
    from pipeline.studies.ledger import drawing

    facts = SimpleNamespace(sigma_floor_e=2.0)
    stage = SimpleNamespace(plan=SimpleNamespace(facts=facts))
    found = {"one": 0.1, "two": 0.7, "three": 0.3}
    switch = SimpleNamespace(
        on=lambda: found.get, off=lambda: lambda _: 0.0, of_light=False, bound_e=3.0, component="x"
    )
    monkeypatch.setattr(drawing, "mean_of", lambda _, light, window: np.array([light]))
    monkeypatch.setattr(drawing, "noise_of", lambda *_: np.array([0.5]))
    measured = drawing._measured(stage, switch, tuple(found), "")
    assert (measured.bound, measured.error, measured.unit) == (1.5, pytest.approx(1.4), "sigma")


@pytest.fixture(scope="module")
def measured():
    """The quick rules measured anew, by name."""
    return {row["rule"]: row for row in run_ledger(QUICK)["rules"]}


@pytest.mark.parametrize("name", QUICK)
def test_a_rule_holds_and_is_what_is_published(name, measured):
    """Each measurement is within its bound, and is the one that docs/measured.json shows."""
    stored = json.loads((ROOT / "docs" / "measured.json").read_text())["rules"]
    told = next(row for row in stored if row["rule"] == name)["all"]
    assert len(told) == len(measured[name]["all"])
    for new, old in zip(measured[name]["all"], told, strict=True):
        assert new["holds"], new
        assert (new["component"], new["unit"]) == (old["component"], old["unit"])
        assert new["bound"] == pytest.approx(old["bound"], rel=0.02)
        assert new["error"] == pytest.approx(old["error"], abs=0.05 * max(old["bound"], 1e-300))


@pytest.mark.slow
def test_all_rules_hold():
    """Minutes: every rule of the ledger measured anew, with the bounds that are published."""
    rows = run_ledger()["rules"]
    assert not [row for row in rows if not row["holds"]]
    stored = json.loads((ROOT / "docs" / "measured.json").read_text())["rules"]
    for new, old in zip(rows, stored, strict=True):
        bounds = [[one["bound"] for one in row["all"]] for row in (new, old)]
        assert bounds[0] == pytest.approx(bounds[1], rel=0.02), new["rule"]


def test_every_probe_is_run():
    """Also where two of them serve one rule."""
    checked_rules(())
    folder = ROOT / "pipeline" / "studies" / "ledger"
    written = sum(path.read_text().count("\n@probe(") for path in folder.glob("*.py"))
    assert sum(len(probes) for probes in PROBES.values()) == written > 20


def test_mistakes(tmp_path):
    with pytest.raises(BadInput, match="no such rule"):
        checked_rules(("no such rule",))
    (tmp_path / "old.txt").write_text("kept")
    with pytest.raises(BadInput, match="new or empty"):
        report_ledger(tmp_path)
    with pytest.raises(BadInput, match="a folder that can be made"):
        report_ledger(tmp_path / "old.txt" / "in", progress=lambda *_: pytest.fail("measured"))


def test_an_error_without_end_is_written_as_none(monkeypatch, tmp_path):
    """It does not hold; the other rules are not lost by it."""
    found = ProbeResult("adc", "", 1.0, float("inf"), "px", 0.0, 0.0)
    monkeypatch.setitem(PROBES, "adc", [lambda _: [found]])
    report_ledger(tmp_path / "out", ("adc",))
    (row,) = json.loads((tmp_path / "out" / "ledger.json").read_text())["rules"]
    assert (row["error"], row["holds"]) == (None, False)
    assert "| - | 0 | NO |" in (tmp_path / "out" / "ledger.md").read_text()


@pytest.mark.parametrize("depth_m", [-6e4, 2e4, 9e4])
def test_the_raster_of_the_sun_is_darker_at_its_limb(depth_m):
    """A seventh of the raster's lines: as the share worked out by arcs, to what so few can tell."""
    sun = 1.496e11 * unit(np.array([1.0, 0.1, 0.15]))
    side = unit(np.cross(sun, [0.0, 0.3, 1.0]))
    place = -4.2e7 * unit(sun) + (EARTH_EQUATORIAL_RADIUS_M * 0.997 + depth_m) * side
    for u in (0.0, 0.9):
        share = float(sunlit_past_earth(place[None], sun, u, True)[0])
        assert _rastered(place, sun, u, 170) == pytest.approx(share, abs=0.004)


def test_stars_alone_are_drawn_by_the_plan_of_stars_alone(monkeypatch):
    """Beside the plan of everything else: the same image by two plans."""
    from pipeline.studies.ledger import sections

    drawn = []

    def staged(data):
        return SimpleNamespace(plan="among" if "targets" in data else "alone", g=None, stars=None)

    def light(plan, *rest):
        drawn.append((plan, rest[-1]))
        return {"stars_e": np.ones(1)}

    monkeypatch.setattr(sections, "open_stage", staged)
    monkeypatch.setattr(sections, "whole", lambda _: None)
    monkeypatch.setattr(sections, "blocks_by", lambda *_: lambda _: None)
    monkeypatch.setattr(sections, "tile_light", light)
    monkeypatch.setattr(sections, "timed", lambda work, _: (0.0, work()))
    monkeypatch.setattr(sections, "stated", lambda *_: (0.0, "e-"))
    assert [f.error for f in sections.sections(SimpleNamespace(catalogue="none"))] == [0.0] * 3
    assert drawn == [("alone", ("stars",)), ("among", ("stars", "targets", "sky"))]


def test_light_between_facets_is_set_against_that_of_all_their_outline(tmp_path, monkeypatch):
    """Of a corner of two squares of 1 m2, in the plane across the line of sight."""
    from pipeline.studies.ledger import meshes

    monkeypatch.setattr(meshes, "_between", lambda *_: 0.125)
    found, _ = meshes.between(SimpleNamespace(folder=tmp_path))
    observer = unit(np.array([0.9, -0.2, 1.0]))
    outline_m2 = observer[0] + observer[2]
    assert found.error == pytest.approx(0.125 / (meshes.ALBEDO * outline_m2 / np.pi), rel=1e-9)
