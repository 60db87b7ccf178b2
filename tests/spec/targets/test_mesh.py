"""Bodies from CAD files as a scene describes them: what is understood, what is refused."""

from __future__ import annotations

import math

import pytest
from pydantic import TypeAdapter, ValidationError

from pipeline.spec.targets.mesh import MeshBody, Reflecting

MATT = {"kind": "lambert", "albedo": 0.3}


def body(**more):
    return {"kind": "mesh", "path": "a.obj", "unit": "m", "surface": MATT} | more


def test_a_body_with_panels_and_a_dish():
    made = MeshBody.model_validate(
        body(
            materials={"CELL": {"kind": "ashikhmin_shirley", "specular": 0.1, "exponent_u": 500}},
            attitude={"kind": "nadir"},
            parts=[
                {
                    "name": "panel",
                    "path": "panel.stl",
                    "unit": "mm",
                    "place_m": [0, 2, 0],
                    "joint": {"kind": "sun_tracking", "axis": [0, 1, 0]},
                },
                {"name": "dish", "objects": ["Dish"], "on": "panel"},
            ],
        )
    )
    assert made.parts[0].joint.face == (0, 0, 1)
    assert made.parts[1].unit is None
    again = MeshBody.model_validate(made.model_dump())
    assert again == made


def test_the_sharpest_highlight_is_that_of_any_part():
    """Of a surface or a material, of the body or of a part: moments are as near as it asks for."""
    gloss = {"kind": "cook_torrance", "roughness": 0.02, "normal_reflectance": 0.1}
    part = {"name": "panel", "path": "panel.stl"}
    assert MeshBody.model_validate(body(parts=[part])).highlight_rad == math.inf
    for glossy in (
        body(surface=gloss),
        body(materials={"CELL": gloss}),
        body(parts=[part, part | {"name": "dish", "surface": gloss}]),
        body(parts=[part | {"materials": {"CELL": gloss}}]),
    ):
        assert MeshBody.model_validate(glossy).highlight_rad == pytest.approx(0.01)


def refused(word, **more):
    with pytest.raises(ValidationError, match=word):
        MeshBody.model_validate(body(**more))


def test_mistakes_are_named():
    refused("unit", unit="parsec")
    refused("known keys|did you mean", units="m")
    refused("not zero", parts=[{"name": "a", "path": "p", "quaternion": [0, 0, 0, 0]}])
    refused(
        "not zero",
        parts=[{"name": "a", "path": "p", "joint": {"kind": "fixed", "axis": [0, 0, 0]}}],
    )
    along = {"kind": "sun_tracking", "axis": [0, 0, 2]}
    refused("along the axis", parts=[{"name": "a", "path": "p", "joint": along}])
    refused("earlier part", parts=[{"name": "a", "path": "p", "on": "b"}])
    refused("of its own", parts=[{"name": "a", "path": "p"}] * 2)
    refused("path, or objects", parts=[{"name": "a"}])
    refused("in one part", parts=[{"name": n, "objects": ["x"]} for n in "ab"])


@pytest.mark.parametrize(
    ("surface", "word"),
    [
        ({"kind": "phong", "diffuse": 0.7, "specular": 0.7, "exponent": 10}, "<= 1"),
        ({"kind": "phong", "diffuse": 0.1, "specular": 0.1, "exponent": -1}, "greater"),
        ({"kind": "cook_torrance", "roughness": 0.3}, "exactly one"),
        ({"kind": "cook_torrance", "roughness": 0.0, "normal_reflectance": 0.1}, "roughness"),
        ({"kind": "lambert", "albedo": 1.5}, "albedo"),
        ({"kind": "lambert", "albedo": float("nan")}, "albedo"),
        ({"kind": "velvet"}, "velvet"),
    ],
)
def test_surfaces_out_of_range_are_refused(surface, word):
    with pytest.raises(ValidationError, match=word):
        TypeAdapter(Reflecting).validate_python(surface)
