"""Bodies in scene files: every kind is read, and mistakes are named."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.spec.load import InvalidScene, parse_scene
from pipeline.spec.targets.body import LightCurveBody

ATTITUDES = [
    {"kind": "inertial", "quaternion": [0, 0, 0, 2]},
    {"kind": "sun"},
    {"kind": "velocity"},
    {"kind": "nadir", "quaternion": [1, 1, 0, 0]},
    {"kind": "spin", "rate_deg_s": 3.0, "axis": [1, 0, 0], "phase_deg": 20},
    {"kind": "sun_tracking", "bus": "nadir", "axis": [0, 1, 0]},
    {"kind": "table", "times_s": [0, 100], "quaternions": [[1, 0, 0, 0], [0, 1, 0, 0]]},
]
SHAPES = [
    {"kind": "sphere", "diameter_m": 1.0},
    {"kind": "plate", "area_m2": 4.0, "two_sided": True},
    {"kind": "box", "size_m": [1, 2, 3]},
    {"kind": "cube", "edge_m": 2},
    {"kind": "cylinder", "diameter_m": 1, "length_m": 5, "closed": "base"},
    {"kind": "cone", "diameter_m": 1, "length_m": 5},
    {"kind": "frustum", "base_diameter_m": 1, "top_diameter_m": 2, "length_m": 5},
]
TABLE = [[300, 0.1], [700, 0.3], [1200, 0.2]]
CURVE = {"kind": "light_curve", "times_s": [0, 60], "magnitudes": [5.0, 6.0]}


def load(full: dict[str, Any], body: Any, **more: Any) -> Any:
    return parse_scene(full | {"targets": [full["targets"][0] | {"body": body} | more]})


def test_every_shape_and_law_is_read_and_written_back(full) -> None:
    for shape in SHAPES:
        for albedo in (0.2, TABLE):
            body = shape | {"albedo": albedo}
            laws = [None] if shape["kind"] == "sphere" else ATTITUDES
            for law in laws:
                scene = load(full, body | ({"attitude": law} if law else {}))
                assert parse_scene(scene.as_dict()) == scene
    parts = [s | {"albedo": 0.1} for s in SHAPES]
    scene = load(full, {"kind": "composite", "parts": parts, "attitude": ATTITUDES[3]})
    assert len(scene.targets[0].body.parts) == len(SHAPES)
    assert parse_scene(scene.as_dict()) == scene
    assert isinstance(load(full, CURVE).targets[0].body, LightCurveBody)
    finer = {"oblate_earth": True, "limb_darkening": 0.6, "moon": True, "earthshine_albedo": 0.3}
    assert load(full, parts[0], lighting=finer).targets[0].lighting.moon


PLATE = {"kind": "plate", "area_m2": 1.0, "albedo": 0.5}


@pytest.mark.parametrize(
    ("body", "field", "allowed"),
    [
        (PLATE | {"area_m2": 0}, "body.area_m2", "greater than 0"),
        (PLATE | {"area_m": 1}, "body.area_m", "did you mean 'area_m2'"),
        (PLATE | {"kind": "disc"}, "body.kind", "'cylinder'"),
        (PLATE | {"albedo": [[500, 0.1]]}, "body.albedo", "at least 2"),
        (PLATE | {"albedo": [[500, 0.1], [500, 0.2]]}, "body.albedo", "wavelengths that rise"),
        (PLATE | {"albedo": [[500, 0.1], [600, 1.2]]}, "body.albedo.1.1", "less than or"),
        (PLATE | {"albedo": True}, "body.albedo", "not true or false"),
        (PLATE | {"attitude": {"kind": "nadir", "quaternion": [0, 0, 0, 0]}}, "quaternion", "zero"),
        (PLATE | {"attitude": {"kind": "spin"}}, "body.attitude.rate_deg_s", "must be given"),
        (PLATE | {"attitude": {"kind": "spin", "rate_deg_s": 1, "axis": [0, 0, 0]}}, "axis", "not"),
        (PLATE | {"attitude": {"kind": "tumbling"}}, "body.attitude.kind", "'spin'"),
        (PLATE | {"attitude": ATTITUDES[-1] | {"times_s": [5, 5]}}, "times_s", "values that rise"),
        (PLATE | {"attitude": ATTITUDES[-1] | {"times_s": [1, 2, 3]}}, "quaternions", "as many"),
        (PLATE | {"attitude": ATTITUDES[-1] | {"quaternions": [[1, 0, 0, 0]] * 9}}, "quaternions",
         "as many"),
        ({"kind": "composite", "parts": []}, "body.parts", "at least 1"),
        ({"kind": "composite", "parts": [PLATE, PLATE | {"albedo": 2}]}, "parts.1.albedo", "1"),
        ({"kind": "composite", "parts": [{"kind": "composite", "parts": [PLATE]}]}, "kind", "box"),
        (CURVE | {"magnitudes": [1]}, "body.magnitudes", "as many"),
        (CURVE | {"intensities_m2_sr": [1, 2]}, "body", "exactly one"),
        (CURVE | {"period_s": 30}, "body.period_s", "span"),
        (CURVE | {"mag_per_deg": 0.02}, "body.mag_per_deg", "phase_law: linear"),
        (CURVE | {"phase_deg": 60}, "body.phase_deg", "phase_law: lambert or linear"),
        (CURVE | {"magnitudes": None, "intensities_m2_sr": [1, 2], "range_m": 4e7}, "body.range_m",
         "with magnitudes"),
        (CURVE | {"magnitudes": None, "intensities_m2_sr": [1, 2], "sun_mag": -27}, "body.sun_mag",
         "with magnitudes"),
        (CURVE | {"times_s": [1, float("nan")]}, "times_s", "finite"),
        ({"kind": "cone", "diameter_m": 1, "length_m": 1, "albedo": 0.1, "closed": "top"},
         "body.closed", "'base'"),
    ],
)  # fmt: skip
def test_mistakes_are_named(full, body, field, allowed) -> None:
    with pytest.raises(InvalidScene) as caught:
        load(full, body)
    assert field in str(caught.value)
    assert allowed in str(caught.value)
