"""Every part of the sky that a scene may ask for is drawn, and stands in the plan."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.plan.sky.sky import SkyPlan
from pipeline.route.prepare import prepare
from pipeline.spec.dotted import changed
from pipeline.spec.load import parse_scene
from pipeline.spec.sky.background import UNIFORM, Background
from tests.pins.scenes import BASE, SCENES, SITE

# What each field is asked for with, and the decisions that tell of it.
ASKED: dict[str, tuple[Any, str]] = {
    "zodiacal": (True, "background.zodiacal"),
    "galactic": (True, "background.galactic"),
    "starlight": ("all", "background.starlight"),
    "stray_light": (
        SCENES["stray-light-of-mirrors"]["background"]["stray_light"],
        "stray_light.sun",
    ),
    "airglow": (True, "background.airglow"),
    "moonlight": (True, "background.moonlight"),
    "twilight": (True, "background.twilight"),
    "uniform_mag_arcsec2": (21.0, "background.uniform"),
    "uniform_e_per_s": (3.0, "background.uniform"),
}
OF_THE_AIR = ("airglow", "moonlight", "twilight")


def sky_of(name: str) -> tuple[SkyPlan, dict[str, bool]]:
    """A wide field with one part of the sky, and which decisions of its plan are kept."""
    base = changed(BASE, SCENES["stray-light-of-mirrors"])
    if name in OF_THE_AIR:
        base = changed(BASE, SCENES["moonlight-and-twilight"])
        assert base["observer"]["kind"] == SITE["kind"]
    plan = prepare(parse_scene(base | {"background": {name: ASKED[name][0]}})).plan
    assert plan.sky is not None
    return plan.sky, {d.component: d.kept for d in plan.decisions}


def test_every_field_is_asked() -> None:
    assert set(ASKED) == set(Background.model_fields)


@pytest.mark.parametrize("name", ASKED)
def test_a_part_is_drawn_and_stands_in_the_plan(name: str) -> None:
    """Alone it gives light, and the plan names it and no other."""
    sky, kept = sky_of(name)
    assert kept[ASKED[name][1]]
    assert sky.least_e_s > 0.0
    others = {of for field, (_, of) in ASKED.items() if field != name} - {ASKED[name][1]}
    assert not any(kept.get(of, False) for of in others)


@pytest.mark.parametrize("name", ASKED)
def test_what_differs_over_the_sky_is_known_to(name: str) -> None:
    part = Background.model_validate({name: ASKED[name][0]})
    assert part.varies == (name not in UNIFORM)
