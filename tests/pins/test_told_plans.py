"""What the plan of each pinned scene tells: its page, its reasons and bounds, its forecasts."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.commands.pages import print_plan
from pipeline.route.prepare import plan_scene
from tests.pins.draw import embedded_spectra, scene_of
from tests.pins.scenes import SCENES
from tests.pins.told import check_told


@pytest.mark.parametrize("name", SCENES)
def test_plan_as_told(
    name: str, files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The forecast is that of a machine on which planning takes no time."""
    still = SimpleNamespace(thread_time=lambda: 0.0)
    monkeypatch.setattr("pipeline.route.prepare.time", still)
    monkeypatch.setattr("pipeline.resolve.resolve.time", still)
    monkeypatch.setenv("COLUMNS", "80")
    with embedded_spectra():
        plan = plan_scene(scene_of(name, files))
    print_plan(plan)
    print_plan(plan, everything=True)
    told = [f"\n{'predicted':>10} {_short(plan['predicted'])}"]
    told += [f"{'outlook':>10} {_short(plan['outlook'])}"]
    saved = [d for d in plan["decisions"] if d["seconds_saved"]]
    told += [f"{'saved':>10} {d['component']} {d['seconds_saved']:.6g} s" for d in saved]
    check_told(f"plans/{name}", capsys.readouterr().out + "\n".join(told), files=files)


def _short(value: Any) -> str:
    """Nested data in one line, numbers to nine digits."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_short(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_short, value)) + "]"
    return f"{value:.9g}" if isinstance(value, float) else json.dumps(value)
