"""Requests that hypothesis draws: what the OpenAPI document tells of, scenes near to good ones."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from hypothesis import strategies as st

from pipeline.spec.load import parse_scene, parse_text, path_holders
from tests.service.conftest import SCENE
from tests.tls_cluster import ROOT

UPLOAD = "upload:@"  # and N.: the Nth file of the examples, or what is drawn; sent before the scene
CATALOGUE = "demo"
SHORT = {"sensor": {"shape": [256, 320]}, "exposure": {"frames": 2}}  # so that a server takes them


def _samples() -> Iterator[dict[str, Any]]:
    """The examples, small, with files and a catalogue that the server has."""
    yield SCENE
    for path in sorted((ROOT / "examples").glob("*.yaml")):
        scene = parse_scene(parse_text(path.read_bytes())).as_dict()
        for name, holder, key in path_holders(scene):
            if name == "stars.catalogue" and holder.get(key):
                holder[key] = CATALOGUE
            elif isinstance(holder.get(key), str):
                FILES.append(ROOT / "examples" / holder[key])
                holder[key] = f"{UPLOAD}{len(FILES)}."
        for name, keys in SHORT.items():
            scene[name] |= {k: v for k, v in keys.items() if k in scene[name]}
        for key in ("bad", "amplifiers"):  # of a larger sensor
            (scene["sensor"].get("detector") or {}).pop(key, None)
        yield scene


FILES: list[Path] = []  # that the examples name
SAMPLES = list(_samples())
ENDINGS = ("csv", "npy", "fits", "ecsv", "obj", "stl", "glb", "oem", "tle", "zip")
TABLE = "wavelength_nm,value\n400,0.5\n900,0.7\n"
FACET = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3"
CONTENTS = st.one_of(
    st.binary(max_size=300),
    st.sampled_from(["", TABLE, "{}", "solid a\nendsolid a\n", FACET])
    .flatmap(lambda text: st.tuples(st.just(text.encode()), st.binary(max_size=8)))
    .map(b"".join),
)  # fmt: skip
UPLOADS = st.tuples(st.sampled_from(ENDINGS).map("a.{}".format) | st.text(max_size=9), CONTENTS)
TEXTS = st.sampled_from(
    ["", "a", "sat-1", "2019-04-20T03:00:00Z", "9999-12-31T23:59:60Z", "-0001-01-01", "\0",
     "\x7f", "é\u202e", "../../etc/passwd", f"{UPLOAD}0.", "s3://a/b"]
) | st.text(max_size=12)  # fmt: skip
NUMBERS = st.sampled_from(
    [0, -0.0, 1, -1, 0.5, 2, 90, 360, -90.1, 64, 1e-320, 1e-9, 1e9, 2**31, 2**53 + 1, 2**64,
     -(2**63) - 1, 10**30, 1e160, 1.7e308, -1.7e308]
)  # fmt: skip
ANYTHING = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.floats(allow_nan=False, allow_infinity=False) | TEXTS,
    lambda deeper: st.lists(deeper, max_size=3) | st.dictionaries(TEXTS, deeper, max_size=3),
    max_leaves=5,
)


@st.composite
def scenes(draw: st.DrawFn, schema: dict[str, Any]) -> dict[str, Any]:
    """A good scene with a few keys drawn anew: mostly as the JSON Schema has them."""
    return _object(draw, schema, schema["$defs"], draw(st.sampled_from(SAMPLES)), 0)


def _object(draw: Any, schema: dict[str, Any], defs: Any, near: Any, depth: int) -> Any:
    properties = schema.get("properties", {})
    value = {k: v for k, v in near.items() if k in properties} if isinstance(near, dict) else {}
    anew = {name for name in schema.get("required", ()) if name not in value}
    anew |= {name for name, told in properties.items() if "const" in told}
    if properties and depth < 6:
        most = 2 if depth < 2 else 1
        names = st.sampled_from(sorted(properties))
        anew |= draw(st.sets(names, min_size=depth == 0, max_size=most))
    for name in sorted(anew):
        value[name] = _like(draw, properties[name], defs, value.get(name), depth + 1)
    return value


def _like(draw: Any, schema: dict[str, Any], defs: Any, near: Any, depth: int) -> Any:
    """A value that a JSON Schema describes, near to one that is there; now and then any other."""
    if "$ref" in schema:
        schema = defs[schema["$ref"].rpartition("/")[2]]
    if "const" in schema:
        return schema["const"]
    if draw(st.integers(0, 60)) == 0:
        return draw(ANYTHING)
    if "enum" in schema:
        return draw(st.sampled_from(schema["enum"]))
    choices = schema.get("anyOf") or schema.get("oneOf")
    if choices:
        return _like(draw, draw(st.sampled_from(choices)), defs, near, depth)
    kind = schema.get("type")
    if kind == "object":
        return _object(draw, schema, defs, near, depth)
    if kind == "array":
        return _array(draw, schema, defs, near, depth)
    if kind in ("number", "integer"):
        return draw(_numbers(schema, kind))
    if "pattern" in schema and draw(st.integers(0, 3)):
        return "a"
    plain = {"string": TEXTS, "boolean": st.booleans(), "null": st.none()}
    return draw(plain.get(kind, ANYTHING))


def _array(draw: Any, schema: dict[str, Any], defs: Any, near: Any, depth: int) -> Any:
    items = schema.get("prefixItems")
    if items is None:
        least = schema.get("minItems", 0)
        count = draw(st.integers(least, min(least + 2, schema.get("maxItems", least + 2))))
        items = [schema.get("items", {})] * count
    if isinstance(near, list) and near and draw(st.integers(0, 3)):
        at = draw(st.integers(0, len(near) - 1))
        item = items[at % len(items)] if items else {}
        return [*near[:at], _like(draw, item, defs, near[at], depth + 1), *near[at + 1 :]]
    return [_like(draw, item, defs, None, depth + 1) for item in items]


def _numbers(schema: dict[str, Any], kind: str) -> st.SearchStrategy[Any]:
    low = schema.get("minimum", schema.get("exclusiveMinimum", -1e9))
    high = schema.get("maximum", schema.get("exclusiveMaximum", max(1e9, 2.0 * low)))
    if kind == "integer":
        near = min(low + 3, high)
        return st.sampled_from([low, near, high]) | st.integers(math.ceil(low), math.floor(high))
    usual = st.sampled_from([x for x in (0, 0.1, 0.5, 1, 3, 10, 60) if low < x < high] or [low])
    return usual | st.sampled_from([low, high]) | st.floats(low, high) | usual | NUMBERS


@st.composite
def scene_requests(draw: st.DrawFn, schema: dict[str, Any]) -> tuple[str, str, bytes]:
    """(path, media type, body): a scene by every way that one may come, JSON or YAML."""
    scene = draw(scenes(schema))
    way = draw(st.sampled_from(["/v1/jobs", "/v1/jobs?dry_run=1", "/v1/sweeps?dry_run=1",
                                "/v1/sweeps", "/v1/schema/scene/read", "/uws/async",
                                "/ogc/processes/plan/execution",
                                "/ogc/processes/render/execution"]))  # fmt: skip
    if way == "/uws/async":
        form = {"SCENE": json.dumps(scene), "PHASE": draw(st.sampled_from(["RUN", ""]))}
        return way, "application/x-www-form-urlencoded", urlencode(form, safe=":@").encode()
    data: Any = scene
    if way.startswith("/ogc"):
        data = {"inputs": {"scene": scene}}
    elif way.startswith("/v1/sweeps"):
        data = {"schema": "nightglass/sweep/1", "name": "s", "scene": scene,
                "axes": [{"field": draw(_fields(scene)), "values": draw(_values())}]}  # fmt: skip
    kind = draw(st.sampled_from(["json", "yaml"]))
    kind = "json" if way.startswith("/ogc") else kind
    return way, f"application/{kind}", json.dumps(data, ensure_ascii=kind == "yaml").encode()


def _fields(scene: dict[str, Any]) -> st.SearchStrategy[str]:
    deeper = [f"{k}.{n}" for k, v in scene.items() if isinstance(v, dict) for n in v]
    return st.sampled_from(["seed", *deeper]) | TEXTS


def _values() -> st.SearchStrategy[list[Any]]:
    return st.lists(NUMBERS | ANYTHING, max_size=3)


HEADERS = st.dictionaries(
    st.sampled_from(
        ["range", "if-range", "if-none-match", "last-event-id", "accept", "idempotency-key",
         "content-type", "content-encoding", "authorization", "x-forwarded-for", "cookie"]
    ),
    st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=40).map(str.strip),
    max_size=5,
)  # fmt: skip
