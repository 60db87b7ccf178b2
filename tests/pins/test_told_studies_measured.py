"""What the studies measure on their smallest settings; times are masked."""

from __future__ import annotations

import dataclasses
import io
import json
import re
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from tests.pins.files import _library
from tests.pins.test_told_studies import coarse, pictured, printed, tell, told_lines, tools
from tests.pins.told import check_told

SLOW = ("gaussian_for_poisson", "shared_frames", "targets.earthshine_on_meshes")
SLOW += ("targets.light_between_nodes", "targets.light_table", "phase_interpolation")
SLOW += ("one_noise_draw", "stray_light.*", "rolling_shutter", "stars.faint")
SLOW += ("precession_nutation",)  # by tables that are published anew
STATED = """
probe.decision(plan, "no")
probe.stated(plan, "targets")
probe.stated(plan, "stars")
"""
PROCESSES = """
real(["sh", "-c", "echo a >&2; echo b >&2; echo >&2; exit 3"], folder)
real(["sh", "-c", "exit 4"], folder)
real(["true"], folder) >= 0.0
"""
PEERS = (
    "galsim",
    "tensorflow",
    "photutils",
    "photutils.datasets",
    "photutils.psf",
    "satsim",
    "satsim.image",
    "satsim.image.epsf",
    "satsim.image.render",
    "satsim.image.psf",
)
SELFTESTS = (
    "places/ attitude/stiff-n light/g light/ph light/e light/n frames/6 frames/sat frames/o "
    "frames/n frames/h many/"
)
TURN = {"mode": "rate", "boresight_ra_deg": 80.0, "boresight_dec_deg": 20.0}
TURN |= {"rate_ra_arcsec_s": 9.0, "rate_dec_arcsec_s": 12.0}


@pytest.fixture(scope="module")
def stars(tmp_path_factory: pytest.TempPathFactory) -> str:
    from pipeline.studies.ledger.scenes import make_stars

    return make_stars(tmp_path_factory.mktemp("stars"))


def pin(name: str, *parts: Any, **places: Any) -> None:
    check_told(f"studies/{name}", "\n".join(map(tell, parts)), **places)


def test_selftests(tmp_path: Path) -> None:
    from pipeline.studies.selftest.case import run_case
    from pipeline.studies.selftest.report import all_cases

    ran = [
        run_case(c, tmp_path / c.name)
        for c in all_cases()
        if c.name.startswith(tuple(SELFTESTS.split()))
    ]
    rows = [coarse(o.as_dict(), 0.01 * o.case.allowed) for o in ran]
    pin("selftests", re.sub(r"within \S+|\S+ px (?=wide|narrow)", "", tell(rows, 5)), noise=1e-10)


@pytest.mark.slow
def test_ledger(stars: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from pipeline.route.prepare import prepare
    from pipeline.spec.load import parse_scene
    from pipeline.studies.ledger import drawing, meshes, pointing, probe, scenes, study, targets
    from pipeline.studies.ledger import stars as of_stars

    monkeypatch.setitem(scenes.SCENE["sensor"], "shape", [48, 48])
    small = partial(targets._rastered, lines=150)
    for module, name, value in (
        (drawing, "SIDE", 48),
        (of_stars, "SIDE", 48),
        (drawing, "WINDOWS", 1),
        (pointing, "RUNS", 20),
        (meshes, "CELLS", 8),
        (of_stars, "GRAZING", 200),
        (study, "make_stars", lambda _: stars),
        (targets, "_rastered", small),
    ):
        monkeypatch.setattr(module, name, value)
    left = [r for r in study.LEDGER if r.components[0] not in SLOW]
    monkeypatch.setattr(study, "LEDGER", left)
    monkeypatch.setitem(probe.PROBES, "targets.point_sources", [targets.sizes])
    heard: list[Any] = []
    found = study.run_ledger((), lambda *at: heard.append(at))
    found["rules"] = [[r["rule"], r["how"], *r["all"]] for r in found["rules"]]
    plan = prepare(parse_scene(scenes.scene())).plan
    said = told_lines(STATED, {"plan": plan, "probe": probe})
    # An orbit's rows and what lies between them: 3e-4 of the error found is the processor's.
    pin("ledger", tell(coarse(found), 6), heard[:2], heard[-1], said, relative=1e-3)


def _tiny(name: str, quick: bool) -> Any:
    """A scene of the report on few pixels: stars that streak, or targets in two tiles."""
    from pipeline.studies.ledger.scenes import ORBIT, before, scene
    from pipeline.studies.scenes.scenes import ReportScene

    base: dict[str, Any] = {"name": name, "sensor.dark_e_per_s": 3.0}
    if name == "streaks":
        base |= {
            "stars": {"faintest_g_mag": 15.0},
            "pointing": TURN,
            "background.zodiacal": True,
            "sensor.psf": {"kind": "airy", "jitter_px": 0.5, "wavelengths": 2},
            "sensor.shape": [48, 64],
        }
        return ReportScene(name, "stars", scene(base))
    near = [before([-2724520.7, -41120448.5, y], 2e4, f"n{y:g}") for y in (0.0, 2e4, -3e4)]
    base |= {
        "observer": ORBIT,
        "epoch": "2019-05-12T09:00:00Z",
        "targets": near,
        "exposure.integration_s": 0.01,
        "pointing": {"mode": "target", "target": "n0"},
        "sensor.shape": [32, 512],
        "output.tile_shape": [32, 256],
    }
    return ReportScene(name, "targets", scene(base), (1, 2))


@pytest.mark.slow
def test_scenes(stars: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from pipeline.studies.scenes import child, level, scenes, study

    def here(_: Any, input: str, **__: Any) -> Any:
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdin", io.StringIO(input))
            return subprocess.CompletedProcess([], 0, printed(child.main), "")

    names, heard = ("streaks", "targets"), []
    monkeypatch.setattr(scenes, "MAKERS", {n: partial(_tiny, n) for n in names})
    monkeypatch.setattr(study, "QUICK_WINDOWS", 3)
    monkeypatch.setattr(study, "subprocess", SimpleNamespace(run=here))
    found = study.run_study(
        names, (0.05,), True, Path(stars), tmp_path, lambda *at: heard.append(at)
    )
    bad = {"work": "level", "scene": {"name": "x"}, "share": [1, 1], "folder": "f"}
    said = told_lines("study.run_child(bad)\nstudy.run_child(bad | {'work': 'no'})", locals())
    pin("scenes", tell(coarse(found, 1e-5), 5), heard, said, level.peak_mb() > 10.0)


def test_accuracy(monkeypatch: pytest.MonkeyPatch) -> None:
    from pipeline.studies.accuracy import engines, external, probes, reference, study

    cases = [c for c in study.cases((50, 120), True) if isinstance(c.shape, study.GaussianStar)]
    cases.append(
        engines.EngineCase(study.AiryStar(1.0, 0.3), study.straight(5.0, 0.6435), 5.0, (30, 34))
    )
    at, rows = np.array([3.0, 20.4]), []
    made = [probes.make_probes(case, 2) for case in cases]
    for case, seen in zip(cases, made, strict=True):
        rows += [
            study._one(case, s, seen, at, at, study.QUICK) for s in engines.our_settings(case, True)
        ]
    peer = engines._product(8)._replace(ours=False)
    rows.append(study._one(cases[0], peer, made[0], at, at, study.Effort()))
    exact = [
        reference.exact_pixels(c.shape, c.track, 3.3, 2.1, at, at / 2, w)
        for c in cases
        for w in (1.0, 2.5)
    ]
    shifts, radii = np.array([0, 0.2, 0.5, 0.7, 1.1, 1.3, 1.99, 2]), np.array([0.0, 0.3, 1.2, 9.0])
    exact += [reference.annulus_transfer(shifts, e) for e in (0.0, 0.3, 0.9)]
    exact += [reference.airy_intensity(study.AiryStar(2.0, e), radii) for e in (0.0, 0.3)]

    def external_settings(case: Any, *_: Any) -> Any:
        image = np.full(case.frame, 1e-3)
        return [
            ("A", "1", lambda *_: external._run(["x"], ".")),
            ("B", "2", lambda *_: external.External(image, 4.0, 0.5)),
        ]

    def fails(*_: Any, **__: Any) -> Any:
        raise subprocess.TimeoutExpired("x", 1.0)

    monkeypatch.setattr(external.subprocess, "run", fails)
    monkeypatch.setattr(study, "cases", lambda *_: cases[:2])
    monkeypatch.setattr(study, "our_settings", lambda *_: [engines._product(8)])
    monkeypatch.setattr(study, "peer_settings", lambda *_: [peer])
    monkeypatch.setattr(study, "external_settings", external_settings)
    heard: list[Any] = []
    found = study.run_study(30, (50, 120), False, True, "no/python", lambda *at: heard.append(at))
    found["peers"] = [p["name"] for p in found["peers"]]
    pin(
        "accuracy",
        tell(coarse([vars(r) for r in rows]), 5),
        made,
        exact,
        tell(coarse(found), 5),
        heard,
    )


def test_peers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What the adapters ask of other simulators, told by stand-ins that note every call."""
    from astropy.io import fits

    from pipeline.studies.accuracy import engines, external, peers, study

    for name in ("CUDA_VISIBLE_DEVICES", "TF_CPP_MIN_LOG_LEVEL", "TF_NUM_INTRAOP_THREADS"):
        monkeypatch.setenv(name, "1")
    monkeypatch.setenv("TF_NUM_INTEROP_THREADS", "1")  # else the worker's import would set them
    from pipeline.studies.accuracy import satsim_worker

    lib, said = MagicMock(), []
    for name in PEERS:
        monkeypatch.setitem(sys.modules, name, getattr(lib, name.split(".")[-1]))

    def run(command: list[str], folder: str) -> float:
        here = Path(folder)
        if command[0] == "sky":
            listed = (here / "stars.list").read_text().splitlines()
            said.extend([" ".join(command), *listed, fits.getdata(here / "psf.fits").astype(float)])
            fits.writeto(here / "sky.fits", np.full((9, 12), 2e3), overwrite=True)
            return 1.0 + len(listed)
        said.append([Path(c).name for c in command])
        with np.load(command[-2]) as job:
            said.append(" ".join(f"{k} {tell(job[k])};" for k in job))
        satsim_worker.main(*command[-2:])
        return 2.0

    real, at = external._run, (np.array([3.0, 20.4]), np.array([5.0, 6.6]))
    space = tools(real=real, folder=str(tmp_path))
    said.append(told_lines(PROCESSES, space))
    monkeypatch.setattr(external, "_run", run)
    monkeypatch.setattr(external, "SKY_HALF_PX", 2)
    monkeypatch.setattr(peers, "TABLE_HALF_PX", 5)
    monkeypatch.setattr(peers, "_version", lambda _: "1")
    monkeypatch.setattr(peers, "shutil", SimpleNamespace(which=lambda name: name))
    cases = [
        engines.EngineCase(shape, study.straight(n, 0.5), n, (9, 12))
        for shape in study.SHAPES
        for n in (0.0, 6.0)
    ][:4:3]
    for case in cases:
        said.append(f"== {case.name}")
        said += [external.run_satsim(case, at, at, "py", 3, table).image for table in (False, True)]
        said.append(external.run_skymaker(case, at, at, 3))
        for s in peers.peer_settings(case, False):
            if s.setting in ("default", "5 px stamps", "table 2 x"):
                s.make(case).draw(*at, np.array([1.0, 2.0]))
    for case in (*cases, *study.cases((256, 256), False)[2::4]):
        for quick in (True, False):
            said.append([(e, n) for e, n, _ in peers.external_settings(case, quick, "py")])
            said.append([x.setting for x in peers.peer_settings(case, quick)])
    calls = [re.sub(r" id='\d+'|np\.float64", "", str(c)) for c in lib.mock_calls]
    pin("peers", peers.installed_peers("py"), *said, *(c for c in calls if "__" not in c))


def _labels(*rows: tuple[float, ...]) -> Any:
    """Sources: kind, x, y, length, angle [deg], snr."""
    from pipeline.export.labels import Labels

    kind, x, y, length, turn, snr = np.array(rows, float).reshape(-1, 6).T
    dx, dy = 0.5 * length * np.cos(np.radians(turn)), 0.5 * length * np.sin(np.radians(turn))
    named = {"kind": kind.astype(int), "name": np.array([f"n{i}" for i in range(len(kind))], str)}
    named |= {"x_px": x, "y_px": y, "x_light_px": x + 0.1, "y_light_px": y, "snr": snr}
    named |= {"x_start_px": x - dx, "y_start_px": y - dy, "x_end_px": x + dx, "y_end_px": y + dy}
    named["g_mag"] = np.where(kind == 2, 14.0 - 2.5 * np.log10(np.maximum(snr, 1.0)), np.nan)
    return Labels(**{f.name: named.get(f.name, 0 * x) for f in dataclasses.fields(Labels)})


def _sky(labels: Any) -> np.ndarray:
    """A frame with those sources, noise, and a background that slopes."""
    y, x = np.mgrid[:96, :128]
    image = np.random.default_rng(5).normal(100.0, 3.0, (96, 128)) + 0.05 * x
    for i in range(len(labels)):
        for s in (np.arange(60) + 0.5) / 60:
            px = labels.x_start_px[i] + s * (labels.x_end_px - labels.x_start_px)[i]
            py = labels.y_start_px[i] + s * (labels.y_end_px - labels.y_start_px)[i]
            image += labels.snr[i] / 6 * np.exp(-((x - px) ** 2 + (y - py) ** 2) / 3.0)
    return image


def test_detection(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from pipeline.studies.detection import finders, judge, points, streaks, study, tables

    still = _labels(
        (1, 60, 50, 24, 30, 300),
        (1, 100, 20, 0, 0, 40),
        (2, 20, 20, 0, 0, 400),
        (2, 108, 45, 0, 0, 399),
        (2, 40, 70, 0, 0, 90),
        (2, 2, 60, 0, 0, 50),
        (2, 110, 80, 0, 0, 2),
        (2, 90, 60, 1, 0, 30),
    )
    moving = _labels(
        (1, 60, 50, 0, 0, 60),
        (1, 30, 70, 20, 100, 300),
        (2, 30, 20, 16, 20, 400),
        (2, 90, 70, 16, 20, 200),
        (2, 100, 30, 16, 20, 9),
    )
    frames, sizes = [still, moving], {"frame": 2, "y": 96, "x": 128}
    monkeypatch.setattr(study, "open_raw_cube", lambda _: SimpleNamespace(sizes=sizes))
    monkeypatch.setattr(study, "frame_labels", lambda _, k, *__: frames[k])
    monkeypatch.setattr(study, "read_layer", lambda _, __, k: np.rint(_sky(frames[k])))
    heard: list[Any] = []
    out = tmp_path / "out"
    drawn = pictured(
        lambda: study.report_detection(tmp_path / "p", out, progress=lambda *at: heard.append(at))
    )
    told = json.loads((out / "detection.json").read_text())
    found: list[Any] = []
    for labels in (*frames, _labels()):
        image, noise = points.flattened(_sky(labels))
        found += [image, noise, finders.drift_of(labels)]
        for task in finders.tasks(labels, image):
            seen = task.find(task.image, noise, 4.0)
            found += [
                task.kind,
                task.sought.astype(int),
                seen,
                judge.judge(labels, task.sought, seen),
            ]
    x, y = (20, 22.4, 20, 60, 70, 72, 118, 200, 2), (20, 20, 23.5, 50, 56, 50, 80, 50, 60)
    spots = points.Detections(*(np.array(v, float) for v in (x, y, range(9, 0, -1), x, y)))
    every = np.ones(len(still), bool)
    verdicts = [judge.judge(still, w, spots) for w in (every, ~every, still.length_px > 3)]
    found += [(v, v.fragments, v.false) for v in verdicts]
    found += judge.by_magnitude(still, every, verdicts[0].found, np.arange(6.0, 16.0, 2.0))
    found += [np.array(streaks.all_lines()), points.find_points(0 * image + 1e-9, noise, 3.0)]
    line = "study.report_detection(folder, folder"
    said = told_lines(
        f"{line}, 0.99)\n{line}, 1.1e4)\n{line}, 5.0, 0)", tools(study=study, folder=tmp_path)
    )
    pin(
        "detection",
        tell(told, 6),
        heard,
        (out / "detection.md").read_text(),
        tables.markdown(told | {"targets": []}),
        printed(lambda: tables.print_study(told)),
        drawn,
        *found,
        said,
    )


def test_cosmic_rays_and_the_demo(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from pipeline import demo
    from pipeline.studies import cosmic_rays as figure
    from pipeline.studies.scenes import study

    monkeypatch.setattr(figure, "FRAME_PX", 150)
    made = figure.compare_library(_library(), 9.0, 100.0, 3.0, 300.0, 60)
    said: list[Any] = []

    def render(scene: Any, product: Path, options: Any, _: Any) -> Any:
        said.append((scene.name, product.name, options.resume, options.replace))
        return {"a": 1}

    def make_demo(folder: Path, **more: Any) -> Any:
        said.append((folder.name, more))
        folder.mkdir(parents=True)
        return SimpleNamespace(catalogue=SimpleNamespace(rows=12))

    monkeypatch.setattr(demo, "render", render)
    monkeypatch.setattr(demo, "make_demo", make_demo)
    monkeypatch.setattr(study, "make_demo", make_demo)
    for again in (False, True, False, True):
        said.append(demo.run_demo(tmp_path / "d", again, None, said.append))
        (tmp_path / "d" / "product").mkdir(exist_ok=True)
    for quick in (True, False):
        study.make_catalogue(("rate-track", "large-focal-plane"), quick, tmp_path / f"s{quick}")
    said.append(told_lines("demo.run_demo(tmp_path, False, None, print)", locals()))
    drawn = pictured(lambda: figure.draw_comparison(made, tmp_path / "x.svg"))
    events = {n: vars(e) | {"images": np.array(e.images)} for n, e in made.pop("events").items()}
    peaks = [figure._peak(np.array(v)) for v in ((1.0,), (1, 2, 9.0, 9.1, 9.2, 20), (5, 1, 3, 4.0))]
    pin(
        "cosmic-rays-and-demo",
        tell(made, 6),
        tell(events, 6),
        drawn,
        peaks,
        *said,
        figure._percentiles(np.zeros(0)),
        folder=tmp_path,
    )
