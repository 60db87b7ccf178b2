"""JSON Schemas of scenes, sweeps and studies, for editors and for those who write them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.spec.json_schemas import FORMATS
from pipeline.spec.pointing.dwell import Dwell
from pipeline.spec.sensor.detector import Amplifier
from tests.command import nightglass

EXAMPLES = Path(__file__).parents[2] / "examples"
FILES = {
    "scene": sorted(EXAMPLES.glob("*.yaml")),
    "sweep": sorted(EXAMPLES.glob("sweeps/*.yaml")),
    "study": sorted(EXAMPLES.glob("studies/*.yaml")),
}


def unknown(node: Any, data: Any, schema: Any) -> list[str]:
    """Keys of data that a node of a schema does not have, through references and lists."""
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].removeprefix("#/$defs/")]
    if isinstance(data, list):
        return [key for one in data for key in unknown(node.get("items", {}), one, schema)]
    if not isinstance(data, dict) or "properties" not in node:
        return []
    lost = [key for key in data if key not in node["properties"]]
    lost += [key for key in node.get("required", []) if key not in data]
    known = [(node["properties"][key], value) for key, value in data.items() if key not in lost]
    return lost + [key for inner, value in known for key in unknown(inner, value, schema)]


@pytest.mark.parametrize("of", FORMATS)
def test_examples_have_the_keys_of_their_format(of: str) -> None:
    assert FILES[of]
    schema = json.loads(nightglass("schema", of).stdout)
    for path in FILES[of]:
        data = yaml.safe_load(path.read_text())
        assert unknown(schema, data, schema) == [], path.name
        assert unknown(schema, data | {"sensorz": 1}, schema) == ["sensorz"]


def test_a_scenes_schema_is_printed_without_a_word_and_others_are_refused() -> None:
    assert "pointing" in json.loads(nightglass("schema").stdout)["properties"]
    refused = nightglass("schema", "sweeps")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "FORMAT: 'sweeps' is not accepted; allowed: one of scene, sweep, study" in refused.stderr


def test_what_is_nearest_to_a_key_says_what_it_means() -> None:
    """Its field before the tables; of these its model's line before that of any model."""
    amplifier, dwell = (m.model_json_schema()["properties"] for m in (Amplifier, Dwell))
    assert amplifier["gain_e_per_dn"]["description"] == "instead of the sensor's"
    assert dwell["frames"]["description"].endswith("default: the scene's exposure.frames")
