"""Scenes at an edge: how they are refused, warned of or remarked on, in words and figures.

Each line at the margin of a stored text is a pinned scene and changes of it in YAML; what is told
of it, and not of the pinned scene itself, stands under it. A new case is a new line, made with
`make pins`.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from pipeline.errors import NightglassError
from pipeline.route.prepare import plan_scene
from pipeline.spec.load import parse_scene
from tests.pins.draw import embedded_spectra, scene_data
from tests.pins.told import TOLD, check_told

# How many scenes each stored text has: one that is lost is a fault.
SCENES_AT = {"sky": 47, "pointing": 39, "targets": 37, "sensor": 38, "decisions": 34}


@cache
def plan_of(name: str, changes: str, files: Path) -> dict[str, Any] | NightglassError:
    """The plan of a pinned scene with changes, or its refusal."""
    with embedded_spectra():
        try:
            data = scene_data(name, files, YAML(typ="safe").load(changes))
            return plan_scene(parse_scene(data))
        except NightglassError as error:
            return error


def told_of(group: str, name: str, changes: str, files: Path) -> tuple[str, ...]:
    """The refusal of a pinned scene with changes, or its warnings and remarks, or decisions."""
    plan = plan_of(name, changes, files)
    if isinstance(plan, NightglassError):
        return (f"! {plan}",)
    told = [*(f"* {w}" for w in plan["warnings"]), *(f"- {r}" for r in plan["remarks"])]
    if group == "decisions":
        told = [_decided(d) for d in plan["decisions"]]
    return tuple(told)


def _decided(d: dict[str, Any]) -> str:
    """A decision in one line, its bound to four digits."""
    bound = "no bound" if d["error_bound_e"] is None else f"{d['error_bound_e']:.4g} e-"
    return f"{'+' if d['kept'] else '-'} {d['component']}: {d['reason']} [{bound}]"


@pytest.mark.parametrize("group", SCENES_AT)
def test_edges(group: str, files: Path) -> None:
    stored = (TOLD / f"edges/{group}.txt").read_text().splitlines()
    lines = [line for line in stored if line and not line[0].isspace()]
    assert len(lines) == SCENES_AT[group]
    out = []
    for line in lines:
        name, _, changes = line.partition(" ")
        always, told = (told_of(group, name, c, files) for c in ("{}", changes))
        out += [line, *(f"    {t}" for t in told if t not in always)]
    check_told(f"edges/{group}", "\n".join(out), files=files)
