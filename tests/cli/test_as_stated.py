"""A product that errs by more than its plan stated says so first, and ends with exit code 5."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline.execute import check
from pipeline.store.cube import open_cube
from tests.command import nightglass

SCENE = {
    "schema": "nightglass/scene/1", "name": "one-target", "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "fixed", "position_au": [0.9, 0.3, 0.1]},
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 9.0, "focal_length_m": 1.0, "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0,
    },
    "pointing": {"mode": "target", "target": "one"}, "exposure": {"integration_s": 1.0},
    "targets": [{
        "name": "one", "eclipse": False,
        "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3075, 0]},
        "body": {"kind": "light_curve", "times_s": [0.0, 9.0], "magnitudes": [-9.0, -9.0],
                 "range_m": 4e7, "period_s": 9.0},
    }],
}  # fmt: skip


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(SCENE))
    return path


def test_an_error_above_the_bound_is_exit_5(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reference finds a tenth less light than was drawn: far more than the plan allows."""
    exact = check.reference

    def dimmer(*args, **more):
        image, sources = exact(*args, **more)
        return 0.9 * image, sources

    monkeypatch.setattr(check, "reference", dimmer)
    alone = "--scheduler", "synchronous"
    part = nightglass("render", scene, "-o", tmp_path / "part", *alone, "--part", "1/1")
    assert part.returncode == 5
    assert "and with it the product" in part.stdout
    said = nightglass("render", scene, "-o", tmp_path / "run", *alone)
    assert said.returncode == 5
    assert said.stdout.startswith("WARNING: pixels were found to err by")
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert not report["errors"]["as_stated"]
    assert "found to err" in report["warnings"][0]
    assert open_cube(tmp_path / "run").attrs["warnings"] == report["warnings"]


def test_as_stated_is_exit_0(scene: Path, tmp_path: Path) -> None:
    said = nightglass("render", scene, "-o", tmp_path / "run", "--scheduler", "synchronous")
    assert said.returncode == 0
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["errors"]["as_stated"]
    assert report["errors"]["windows"] == 2
    assert not any("err" in warning for warning in report["warnings"])


def test_windows_that_take_too_long_are_told(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing was found there, and that is said."""
    monkeypatch.setattr(check, "reference", lambda *args: (None, 7))
    said = nightglass("render", scene, "-o", tmp_path / "run", "--scheduler", "synchronous")
    assert said.returncode == 0
    assert "error not looked for in 2 more window(s): their sources take too long" in said.stdout
    assert "windows again" not in said.stdout


def test_more_error_than_asked_needs_accepting(scene: Path, tmp_path: Path) -> None:
    """Straight lines between the points of a bent response err by more than so little."""
    detector = {"nonlinearity": {"kind": "polynomial", "coefficients": [-0.3]}}
    data = SCENE | {"accuracy": {"noise_fraction": 1e-7}}
    data["sensor"] = SCENE["sensor"] | {"full_well_e": 1e6, "detector": detector}
    scene.write_text(json.dumps(data))
    refused = nightglass("render", scene, "-o", tmp_path / "run")
    assert refused.returncode == 2
    assert "accuracy.noise_fraction" in refused.stderr
    assert "--accept error" in refused.stderr
    assert not (tmp_path / "run").exists()
    said = nightglass("plan", scene, "--accept-error")
    assert said.returncode == 0
    assert said.stdout.startswith("WARNING: pixels may err by")
