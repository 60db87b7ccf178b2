"""No scene is silently wrong: what is not drawn but would show is refused, or told with its size.

A body in the field, daylight, a limb or a horizon, a field that no catalogue covers, lost colours,
stale elements, error beyond what was asked. What would make a frame wrong as a whole stops the
render unless the scene accepts it by name; accepted, it stands first in the plan, the report and
the product. A scene of which nothing of the kind is true is drawn without a word.
"""

# Deeper, elsewhere: tests/plan/sky/test_sky_doubts.py (all bodies, in all exposures),
# tests/acceptance/test_coverage.py, test_behind_the_earth.py and test_site_with_air.py,
# tests/plan/test_target_remarks.py (orbits, shadows), tests/catalog_tools/test_coverage.py,
# tests/inputs/stars/test_catalogues.py (colours), tests/plan/test_accuracy.py,
# tests/spec and tests/cli (values that cannot be).

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from catalog_tools.ingest.ingest import ingest
from pipeline.errors import BadInput
from pipeline.route.prepare import plan_scene
from pipeline.route.run import Options, render
from pipeline.spec.accept import ACCEPTABLE
from pipeline.spec.load import parse_scene, scene_yaml
from pipeline.spec.scene import Scene
from pipeline.store.cube import open_cube
from tests.command import nightglass
from tests.plan.sky.test_sky_doubts import AU_M, HALF_DEG, HIGH, SCENE, SITE, beside, body, scene_of
from tests.rules.conftest import GEO_TLE, SIDEREAL
from tests.rules.test_accuracy_is_kept import TOO_MUCH

NUMBER = r"-?\d+(\.\d+)?(e[+-]?\d+)?"
HERE = np.array(SCENE["observer"]["position_au"]) * AU_M
FROM_HIGH = np.array(HIGH["orbit"]["position_m"])
AIR = {"observer": SITE | {"atmosphere": {"extinction": {"mag_per_airmass": 0.3}}}}
UP = {"pointing": {"mode": "local", "azimuth_deg": 90.0, "elevation_deg": 80.0}}
WEST = {"pointing": {"mode": "local", "azimuth_deg": 270.0, "elevation_deg": 30.0}}
UNIFORM = {"background": {"uniform_mag_arcsec2": 23.0}}

# Of each doubt that stops a render: the word that accepts it, a scene, and its size as it is told.
REFUSED: dict[str, tuple[str, Callable[[Any], Scene], str]] = {
    "the Sun in the field": (
        "sun", lambda _: scene_of(beside(body("sun") - HERE, 0.3)), f"{NUMBER} deg"),
    "the Sun beside it": (
        "sun", lambda _: scene_of(beside(body("sun") - HERE, 20.0)), "20.00 deg"),
    "the Moon in the field": (
        "moon", lambda _: scene_of(
            {"observer": HIGH}, beside(body("moon") - body("earth") - FROM_HIGH, 0.3)),
        f"{NUMBER} deg"),
    "daylight": (
        "daylight", lambda _: scene_of(AIR, WEST, {"epoch": "2019-04-20T20:00:00Z"}),
        f"the Sun at {NUMBER} deg of elevation"),
    "a field without coverage": (
        "coverage", lambda scene: scene({
            "pointing": SIDEREAL | {"boresight_ra_deg": 90.0}, "targets": None}),
        "covers nothing of frame 0"),
    "more error than asked for": (
        "error", lambda scene: scene(TOO_MUCH | {"sensor.shape": [256, 256]}),
        f"{NUMBER}"),
}  # fmt: skip


def accepting(scene: Scene, *words: str) -> Scene:
    return parse_scene(scene.as_dict() | {"accept": list(words)})


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_be_wrong_is_refused_unless_accepted(name, scene):
    """By each other word it is not accepted; by its own it is told first, with its size."""
    word, make, size = REFUSED[name]
    wrong = make(scene)
    others = [other for other in ACCEPTABLE if other != word]
    for words in ([], others):
        with pytest.raises(BadInput, match=rf"accept: \[{word}\] \(--accept {word}\)") as told:
            plan_scene(accepting(wrong, *words))
        assert re.search(size, str(told.value))
    warnings = plan_scene(accepting(wrong, word))["warnings"]
    assert re.search(size, warnings[0])


def test_every_word_that_accepts_has_its_doubt():
    assert {word for word, _, _ in REFUSED.values()} == set(ACCEPTABLE)


def test_nothing_is_made_of_a_refused_scene_and_accepted_it_is_told_everywhere(tmp_path):
    """Exit code 2 and no product; then the first line of the page, the report and the cube."""
    wrong = scene_of(beside(body("sun") - HERE, 20.0))
    (tmp_path / "scene.yaml").write_text(scene_yaml(wrong))
    for verb in (("plan",), ("render", "-o", tmp_path / "run")):
        said = nightglass(verb[0], tmp_path / "scene.yaml", *verb[1:])
        assert said.returncode == 2
        assert "--accept sun" in said.stderr
    assert not (tmp_path / "run").exists()
    page = nightglass("plan", tmp_path / "scene.yaml", "--accept", "sun")
    assert page.stdout.startswith("WARNING: the Sun is 20")
    render(accepting(wrong, "sun"), tmp_path / "run", Options("synchronous"))
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["warnings"][0].startswith("the Sun is 20")
    assert open_cube(tmp_path / "run").attrs["warnings"] == report["warnings"]


DISC_DEG = np.degrees(np.arcsin(6378.137 / 42164.0))
PLANET = beside(body("jupiter") - HERE, 0.5)["pointing"]


def at_limb(away_deg: float) -> dict[str, Any]:
    """A pointing from geostationary height, so far beside the Earth's limb."""
    return {"mode": "sidereal", "boresight_dec_deg": 0.0, "roll_deg": 0.0,
            "boresight_ra_deg": 180.0 - DISC_DEG - away_deg}  # fmt: skip


def level(up_deg: float) -> dict[str, Any]:
    return {"mode": "local", "azimuth_deg": 77.0, "elevation_deg": up_deg}


# Told though nothing is refused: a scene, the same without the fault, and what is said of it.
TOLD: dict[str, tuple[Callable[[], Scene], Callable[[], Scene], str]] = {
    "the Earth's limb": (
        lambda: scene_of({"observer": HIGH, "pointing": at_limb(0.3)}),
        lambda: scene_of({"observer": HIGH, "pointing": at_limb(HALF_DEG + 0.1)}),
        rf"^the Earth is in the field.*limb {NUMBER} deg"),
    "the horizon": (
        lambda: scene_of({"observer": SITE, "pointing": level(0.3)}, UNIFORM),
        lambda: scene_of({"observer": SITE, "pointing": level(HALF_DEG + 0.1)}, UNIFORM),
        rf"^the horizon is in the field, {NUMBER} deg"),
    "a planet": (
        lambda: scene_of({"pointing": PLANET}),
        lambda: scene_of(beside(body("jupiter") - HERE, HALF_DEG + 0.5)),
        rf"^Jupiter is in the field.*{NUMBER}"),
    "the Moon's light": (
        lambda: scene_of(AIR, UP), lambda: scene_of(AIR, UP, {"epoch": "2019-04-27T09:00:00Z"}),
        rf"moonlight.*V = {NUMBER}|at {NUMBER} deg.*moonlight"),
}  # fmt: skip


@pytest.mark.parametrize("name", TOLD)
def test_what_is_not_drawn_is_told_with_its_size(name):
    """And is not where it is not so."""
    wrong, right, said = TOLD[name]
    assert [w for w in plan_scene(wrong())["warnings"] if re.search(said, w)]
    assert plan_scene(right())["warnings"] == []


@given(angle=st.floats(0.0, 40.0), turn=st.floats(0.0, 6.3))
@settings(max_examples=25)
def test_the_sun_is_never_near_in_silence(angle, turn):
    """At any angle: within the 30 degrees where its light would show it is refused."""
    near = scene_of(beside(body("sun") - HERE, angle, turn))
    if angle < 30.0 - 1e-3:
        with pytest.raises(BadInput, match="--accept sun"):
            plan_scene(near)
    elif angle > 30.0 + 1e-3:
        assert plan_scene(near)["warnings"] == []


def test_a_field_covered_in_part_is_told(scene):
    """By how much: the catalogue ends in the frame."""
    half = scene({"pointing": SIDEREAL | {"boresight_ra_deg": 1.45}, "targets": None})
    plan = plan_scene(half)
    assert 0.1 < plan["coverage"]["worst_frame_fraction"] < 0.9
    assert re.search(rf"covers {NUMBER}% ", plan["warnings"][0])
    assert plan_scene(scene())["warnings"] == []


def test_lost_colours_are_told(scene, catalogue, tmp_path):
    """How many stars have none, and what that costs in the band."""
    rows = (Path(catalogue).parent / "stars.csv").read_text().splitlines()
    csv = tmp_path / "grey.csv"
    csv.write_text("\n".join(row.rsplit(",", 2)[0] for row in rows) + "\n")
    ingest([csv], tmp_path / "grey", form="gaia_dr2", workers=1, rows_per_leaf=300)
    grey = scene({"stars": {"catalogue": str(tmp_path / "grey")}})
    (warning,) = plan_scene(grey)["warnings"]
    assert re.search(rf"1500 of 1500 \(100%\) stars of \S+ have no colour.*{NUMBER} mag", warning)


@pytest.mark.parametrize("days", [0, 2, 10, 400])
def test_stale_elements_are_told(scene, days):
    """Their age, and how far off the object is expected to be, on the ground and on the sensor."""
    epoch = str(np.datetime64("2019-04-09T17:25:00") + np.timedelta64(days, "D")) + "Z"
    plan = plan_scene(scene({"epoch": epoch, "accept": ["sun", "moon", "daylight", "coverage"]}))
    told = [said for said in plan["remarks"] if said.startswith("geo: elements of")]
    assert GEO_TLE[0].split()[3].startswith("19099.72")
    assert bool(told) == (days > 3)
    for said in told:
        age = float(re.search(r"elements of (\d+(\.\d+)?) days", said)[1])
        assert age == pytest.approx(days, abs=0.2)
        assert re.search(rf"{NUMBER} km off, up to {NUMBER} arcsec = {NUMBER} px", said)
