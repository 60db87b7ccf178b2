"""How a scene says its distortion: powers as FITS writes them, each mistake by its field."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

from pipeline.errors import BadInput
from pipeline.plan.pointing.geometry import camera_of
from pipeline.spec.load import parse_scene, parse_text, scene_yaml


def scene(full: dict[str, Any], distortion: Any) -> Any:
    full["sensor"]["distortion"] = distortion
    return parse_scene(full)


def test_absent_is_none(full):
    assert parse_scene(full).sensor.distortion is None
    assert camera_of(parse_scene(full)).distortion is None


def test_absent_loads_nothing(full):
    """A scene without distortion does not even import it."""
    code = (
        "import json, sys\n"
        "from pipeline.plan.pointing.geometry import camera_of\n"
        "from pipeline.spec.load import parse_scene\n"
        "camera_of(parse_scene(json.loads(sys.argv[1])))\n"
        "print('pipeline.physics.positions.distortion' in sys.modules)\n"
    )
    command = [sys.executable, "-c", code, json.dumps(full)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["False"]


def test_yaml_of_all_kinds(full):
    text = b"""
sip: {kind: sip, a: {A_2_0: 1e-6, '1_1': 2e-7}, b: {B_0_2: -1e-6}, reference_px: [300, 200.5]}
tpv: {kind: tpv, pv1: {1: 1.01, 4: 2e-3, PV1_39: 1e-9}, pv2: {'7': 1e-4},
  cd_deg: [[-1e-3, 0], [0, 1e-3]]}
radial: {kind: radial, k1: -0.1, p2: 1e-4}
"""
    data = parse_text(text)
    found = scene(full, data["sip"])
    assert found.sensor.distortion.a == {"2_0": 1e-6, "1_1": 2e-7}
    assert camera_of(found).distortion.origin_px == (-83.5, -55.0)
    found = scene(full, data["tpv"])
    assert found.sensor.distortion.pv1 == {1: 1.01, 4: 2e-3, 39: 1e-9}
    assert parse_scene(parse_text(scene_yaml(found).encode())) == found
    assert camera_of(found).distortion.matrix == (-1e-3, 0.0, 0.0, 1e-3)
    found = scene(full, data["radial"])
    assert (found.sensor.distortion.k2, found.sensor.distortion.p2) == (0.0, 1e-4)
    for kind in data.values():
        again = scene(full, kind)
        assert camera_of(again) == camera_of(parse_scene(again.as_dict()))
        assert camera_of(again).distortion is not None


@pytest.mark.parametrize(
    ("distortion", "field", "told"),
    [
        ({"kind": "sip", "a": {20: 1e-6}}, "sensor.distortion.a", "'2_0' in quotes or A_2_0"),
        ({"kind": "sip", "a": {"9_1": 1e-6}}, "sensor.distortion.a", "order 0 to 9"),
        ({"kind": "sip", "a": {"2_0": 1, "A_2_0": 1}}, "sensor.distortion.a", "once"),
        ({"kind": "sip", "b": {"2_0": True}}, "sensor.distortion.b", "not true"),
        ({"kind": "sip", "b": {"2_0": "x"}}, "sensor.distortion.b.2_0", "number"),
        ({"kind": "sip", "b": {"2_0": float("nan")}}, "sensor.distortion.b.2_0", ""),
        ({"kind": "tpv", "pv1": {40: 1.0}}, "sensor.distortion.pv1", "0 to 39"),
        ({"kind": "tpv", "pv1": {True: 1.0}}, "sensor.distortion.pv1", "0 to 39"),
        ({"kind": "radial", "k4": 1.0}, "sensor.distortion.k4", "known keys"),
        ({"kind": "fisheye"}, "sensor.distortion.kind", "sip"),
        ({"kind": "file"}, "sensor.distortion.path", "must be given"),
    ],
)
def test_mistakes_are_named(full, distortion, field, told):
    with pytest.raises(BadInput) as caught:
        scene(full, distortion)
    assert caught.value.field == field
    assert told in str(caught.value)


def test_refused_when_the_camera_is_made(full):
    with pytest.raises(BadInput) as caught:
        camera_of(scene(full, {"kind": "sip", "a": {"2_0": 1.0}}))
    assert caught.value.field == "sensor.distortion"
    with pytest.raises(BadInput) as caught:
        camera_of(scene(full, {"kind": "tpv", "cd_deg": [[1, 1], [1, 1]]}))
    assert caught.value.field == "sensor.distortion.cd_deg"
    with pytest.raises(BadInput) as caught:
        camera_of(scene(full, {"kind": "file", "path": "x.fits"}))
    assert caught.value.field == "sensor.distortion.kind"
