"""The study end to end on little work: what is written, and that errors fall along the ladders."""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict, fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.errors import BadInput
from pipeline.studies.accuracy import figure, report, study
from pipeline.studies.accuracy.engines import EngineCase, our_settings
from pipeline.studies.accuracy.probes import make_probes, probe_count
from pipeline.studies.accuracy.reference import (
    AiryStar,
    GaussianStar,
    Track,
    exact_pixels,
    straight,
)
from pipeline.studies.accuracy.report import report_accuracy
from pipeline.studies.accuracy.study import SHAPES, Record, _record, with_pareto
from pipeline.studies.accuracy.tables import cells

pytest.importorskip("matplotlib", reason="matplotlib is not installed")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], list[Any]]:
    out = tmp_path_factory.mktemp("accuracy") / "new" / "folder"
    seen: list[Any] = []
    study = report_accuracy(
        out, quick=True, peers=False, progress=lambda *state: seen.append(state)
    )
    return out, study, seen


def ladder(study: dict[str, Any], psf: str, streak_px: float, engine: str) -> list[float]:
    return [
        r["error_of_peak"]
        for r in study["records"]
        if r["psf"] == psf and r["streak_px"] == streak_px and r["engine"] == engine
    ]


def test_files_hold_the_study(written: tuple[Path, dict[str, Any], list[Any]]) -> None:
    out, study, seen = written
    assert json.loads((out / "accuracy.json").read_text()) == study
    assert study["schema"] == "nightglass/accuracy/1"
    assert set(study) == {
        "schema", "stars", "frame", "quick", "noise", "peers", "failed", "notes", "records",
    }  # fmt: skip
    for r in study["records"]:
        assert set(r) == {f.name for f in fields(Record)}
        assert r["cpu_s"] > 0
        assert all(math.isfinite(v) for v in r.values() if isinstance(v, float))
    text = (out / "accuracy.md").read_text()
    assert all(r["setting"] in text for r in study["records"])
    assert (out / "accuracy.png").read_bytes().startswith(b"\x89PNG")
    assert seen[-1][1] == seen[-1][2] == len(seen)


@pytest.mark.parametrize(
    ("psf", "streak_px", "engine", "last"),
    [
        ("gaussian 0.8 px", 0.0, "stamps, linear", 1e-3),
        ("gaussian 0.8 px", 0.0, "stamps, cubic", 1e-5),
        ("gaussian 0.8 px", 0.0, "spectral", 1e-5),
        ("gaussian 0.8 px", 60.0, "stamps, cubic", 1e-6),
        ("gaussian 0.8 px", 60.0, "streak as points", 1e-2),
        ("gaussian 0.8 px", 60.0, "path", 2e-2),
        ("airy Q=1", 0.0, "stamps, cubic", 3e-5),
        ("airy Q=1", 0.0, "spectral", 1e-4),
        ("airy Q=1", 0.0, "core radius", 3e-5),
    ],
)
def test_errors_fall_along_each_ladder(
    written: tuple[Path, dict[str, Any], list[Any]],
    psf: str,
    streak_px: float,
    engine: str,
    last: float,
) -> None:
    errors = ladder(written[1], psf, streak_px, engine)
    assert len(errors) >= 2
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < last


def test_spectral_keeps_to_what_was_asked(
    written: tuple[Path, dict[str, Any], list[Any]],
) -> None:
    for r in written[1]["records"]:
        if "asked" in r["setting"]:
            assert r["error_of_peak"] <= float(r["setting"].split()[-1])


def test_same_error_whatever_the_tiles(
    written: tuple[Path, dict[str, Any], list[Any]],
) -> None:
    assert len(set(ladder(written[1], "gaussian 0.8 px", 0.0, "tiles"))) == 1


def record(cpu_s: float, error: float) -> Record:
    return Record("e", "s", True, "p", 0.0, False, 1, 1, cpu_s, cpu_s, 0.0, None, error, error, 0.0)


@pytest.mark.parametrize("q_px", [0.5, 1.0, 4.0])
def test_cores_of_airy_stars_are_as_wide_as_their_rings(q_px: float) -> None:
    """In units of Q: of any star, a core of either ladder holds as much of the light."""
    case = EngineCase(AiryStar(q_px, 0.3), straight(0.0, 0.0), 0.0, (256, 256))
    found: dict[str, list[tuple[float, int]]] = {"core radius": [], "wing grid": []}
    for level in our_settings(case, False):
        if level.engine in found:
            radius, spacing = re.findall(r"[\d.]+", level.setting)
            found[level.engine].append((float(radius) / q_px, int(spacing)))
    assert found["core radius"] == [(6.0, 2), (12.0, 2), (24.0, 2), (48.0, 2)]
    assert found["wing grid"] == [(24.0, 16), (24.0, 8), (24.0, 4), (24.0, 2)]


def test_pareto_front() -> None:
    marked = with_pareto([record(1.0, 1.0), record(2.0, 0.5), record(3.0, 0.7), record(2.0, 0.5)])
    assert [r.pareto for r in marked] == [True, True, False, True]


def test_time_of_fewer_stars_stands_for_all() -> None:
    """100 stars, of which 10 took 2 s: 20 s."""
    case = EngineCase(SHAPES[0], straight(0.0, 0.0), 0.0, (256, 256))
    probes = make_probes(case, 1)
    made = _record(case, "peer", "", False, probes, [(1e-3, 1e-4)], 100, 10, 2.0, 0.5, None)
    assert (made.stars, made.stars_timed) == (100, 10)
    assert (made.cpu_s, made.cpu_s_per_star, made.table_s) == (20.0, 0.2, 0.5)


def test_light_that_is_added_up_nowhere_has_no_error() -> None:
    """A streak of 300 px in a frame of 256: no square about it lies in the frame."""
    track = straight(300.0, 0.6435)
    probes = make_probes(EngineCase(SHAPES[0], track, 300.0, (256, 256)), 2)
    errors = [probes.errors(k, np.zeros((256, 256))) for k in range(probes.x_px.size)]
    made = _record(EngineCase(SHAPES[0], track, 300.0, (256, 256)), "peer", "", False, probes,
                   errors, 1, 1, 1.0, 0.0, None)  # fmt: skip
    assert made.flux_error is None
    assert cells(asdict(made))[-1] == "-"
    case = EngineCase(SHAPES[0], straight(0.0, 0.0), 0.0, (256, 256))
    both = [(1e-3, 1e-4), (float("nan"), None), (1e-3, 2e-4)]
    made = _record(case, "peer", "", False, probes, both, 1, 1, 1.0, 0.0, None)
    assert np.isnan(made.error_of_peak)
    assert made.flux_error == 2e-4


def test_a_slow_peer_is_timed_with_fewer_stars(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.05 s a star: in 2 s some 40 of 100, from which the time of all is reckoned."""
    case = EngineCase(SHAPES[0], straight(0.0, 0.0), 0.0, (256, 256))
    clock = [0.0]

    def draw(x: Any, y: Any, light: Any) -> np.ndarray:
        clock[0] += 0.05 * len(x)
        return np.zeros(case.frame)

    made = SimpleNamespace(draw=draw, table_bytes=7)
    peer: Any = SimpleNamespace(engine="peer", setting="slow", ours=False, make=lambda _: made)
    monkeypatch.setattr(study, "time", SimpleNamespace(process_time=lambda: clock[0]))
    x = np.linspace(0.0, 255.0, 100)
    found = study._one(case, peer, make_probes(case, 1), x, x, study.Effort(1, 1.0, 2.0))
    assert (found.stars, found.stars_timed, found.table_bytes) == (100, 40, 7)
    assert (found.cpu_s, found.cpu_s_per_star) == (pytest.approx(5.0), pytest.approx(0.05))


@pytest.mark.parametrize("kwargs", [{"stars": 0}, {"frame": (64, 1024)}])
def test_limits_of_the_work(kwargs: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(BadInput):
        report_accuracy(tmp_path, **kwargs)
    assert not any(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "in"):
        with pytest.raises(BadInput, match=r"-o: .*allowed: a folder that can be made and written"):
            report_accuracy(out, progress=lambda *_: pytest.fail("a case was measured"))


@pytest.mark.parametrize("frame", [(256, 384), (400, 256)])
@pytest.mark.parametrize("curved", [False, True])
def test_probes_of_an_exact_image_of_an_oblong_frame_find_no_error(
    frame: tuple[int, int], curved: bool
) -> None:
    """Stars drawn by quadrature over the whole frame; half of the light or a shift is seen."""
    track = straight(20.0, 0.7)
    if curved:  # two parts of unequal light
        track = Track(np.array([[-9.0, 3.0], [3.0, 5.0]]), np.array([[2.0, 2.0], [2.0, -8.0]]),
                      np.array([0.7, 0.3]))  # fmt: skip
    case = EngineCase(GaussianStar(0.9), track, 20.0, frame, curved)
    probes = make_probes(case, 3)
    rows, columns = (np.arange(float(n)) for n in frame)
    assert np.isfinite(probes.boxed[:-2]).all()
    assert np.isnan(probes.boxed[-2:]).all()
    for k in range(probes.x_px.size):
        x, y = float(probes.x_px[k]), float(probes.y_px[k])
        assert -2.0 < x < frame[1] + 1.0
        assert -2.0 < y < frame[0] + 1.0
        image = exact_pixels(case.shape, track, x, y, columns, rows)
        pixel, light = probes.errors(k, image)
        assert max(pixel, light or 0.0) < 1e-9
        assert (light is None) == (k >= 3)
        assert probes.errors(k, 0.5 * image)[0] > 0.1
        assert probes.errors(k, np.roll(image, 1, axis=1))[0] > 0.1
        if k < 3:
            assert probes.errors(k, 0.5 * image)[1] == pytest.approx(0.5, rel=1e-6)
    fine = np.arange(-3.0, 4.0)
    (dx, dy) = (0.0, 0.0) if not curved else (-9.0 + 12.0 * 0.5 / 0.7, 2.0)
    at_middle = exact_pixels(case.shape, track, -dx, -dy, fine, fine)
    assert probes.peak == pytest.approx(at_middle.max(), rel=1e-9)


def test_the_front_runs_through_the_points_as_they_are_drawn() -> None:
    """Errors too small for the axis stand on its lower edge: their rings and the staircase too."""
    from matplotlib.figure import Figure

    ax = Figure().subplots()
    row = {"psf": "a", "streak_px": 0.0, "engine": "spectral", "pareto": True, "error_sigma": 1.0}
    errors = {1.0: 1e-3, 2.0: 1e-6, 3.0: 1e-14, 4.0: 0.0}
    rows = [row | {"cpu_s": cpu, "error_of_peak": error} for cpu, error in errors.items()]
    figure._panel(ax, rows, "a", 0.0)
    stairs, rings, points, _ = (line.get_xydata().tolist() for line in ax.get_lines())
    assert stairs == rings == points == [[1, 1e-3], [2, 1e-6], [3, 1e-10], [4, 1e-10]]


@pytest.mark.parametrize("peers", [True, False])
def test_options_of_the_command(monkeypatch: pytest.MonkeyPatch, peers: bool) -> None:
    asked: list[Any] = []
    monkeypatch.setattr("pipeline.commands.studies.accuracy.accuracy.report_accuracy",
                        lambda *given, **named: asked.append((given, named)) or {})  # fmt: skip
    words = "report accuracy -o x --stars 9 --quick --satsim-python y --json --"
    done = CliRunner().invoke(app, (words + ("peers" if peers else "no-peers")).split())
    assert done.exit_code == 0, done.output
    [(given, named)] = asked
    assert given == (Path("x"), 9)
    assert (named["quick"], named["peers"], named["satsim_python"]) == (True, peers, "y")


@pytest.mark.parametrize(("asked", "taken"), [(7, 7), (20_000, report.QUICK_STARS)])
def test_a_quick_study_takes_no_more_stars_than_are_asked_for(
    asked: int, taken: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def told(*work: Any) -> None:
        raise LookupError(work[:3])

    monkeypatch.setattr(report, "run_study", told)
    with pytest.raises(LookupError) as seen:
        report_accuracy(tmp_path, asked, (1024, 2048), quick=True)
    assert seen.value.args == ((taken, (report.QUICK_PX, report.QUICK_PX), True),)


def test_fewer_probes_where_exact_values_take_long() -> None:
    def count(kind: type, quick: bool) -> int:
        case: Any = SimpleNamespace(shape=kind.__new__(kind))
        return probe_count(case, quick)

    assert count(AiryStar, True) == count(GaussianStar, True) < count(AiryStar, False)
    assert count(AiryStar, False) < count(GaussianStar, False)
