"""Whatever JSON comes as a scene, the answer is a scene or a named mistake, never a fault."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.spec.load import path_holders
from service.http.bodies import parse_json
from service.problems import NightglassError, NotAllowed, mistake_dict, pointer
from service.scenes.scenes import accept_scene
from service.settings import Settings

LEAVES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20),
    st.sampled_from([10**400, 1e308, -0.0, 5e-324, "1e400", "nan", "/etc/passwd", "../x", "tiny"]),
)  # fmt: skip
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=8,
)


def places(node: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place in a scene."""
    inner = node.items() if isinstance(node, dict) else enumerate(node)
    out = [here] if here else []
    for key, value in inner if isinstance(node, dict | list) else ():
        out += places(value, (*here, key)) if isinstance(value, dict | list) else [(*here, key)]
    return out


@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_any_value_anywhere(scene: dict[str, Any], tmp_path: Path, data: st.DataObject) -> None:
    (tmp_path / "catalogues").mkdir(exist_ok=True)
    changed = copy.deepcopy(scene)
    *parents, last = data.draw(st.sampled_from([*places(scene), ("stars",), ("sensor", "flat")]))
    holder: Any = changed
    for part in parents:
        holder = holder[part]
    holder[last] = data.draw(VALUES)
    try:
        accepted = accept_scene(parse_json(json.dumps(changed).encode()), Settings(tmp_path))
    except BadInput as error:
        told = mistake_dict((error.field, error.value, error.allowed))
        assert len(json.dumps(told, allow_nan=False)) < 5000
    except NightglassError:
        pass  # refused by parse_json or by name or size: each is a message of its own
    else:
        found = accepted.as_dict()
        for _, holder, key in path_holders(found):
            assert not isinstance(holder.get(key), str | list)


def test_only_registered_names_are_catalogues(scene: dict[str, Any], tmp_path: Path) -> None:
    service = Settings(tmp_path)
    service.make_folders()
    for name in ("whole", "no_manifest", ".hidden"):
        (service.catalogues / name).mkdir()
        if name != "no_manifest":
            (service.catalogues / name / "nightglass.json").write_text("{}")
    scene["stars"] = {"catalogue": "whole"}
    accepted = accept_scene(scene, service)
    assert accepted.stars is not None
    assert accepted.stars.catalogue == "whole"
    for name in ("no_manifest", ".hidden", "./whole", "whole/", "WHOLE", str(service.catalogues)):
        scene["stars"] = {"catalogue": name}
        with pytest.raises(NotAllowed):
            accept_scene(scene, service)


def test_each_name_of_a_list_is_registered(scene: dict[str, Any], tmp_path: Path) -> None:
    """Layers are names too: each is looked at, and each mistake is told by its place."""
    service = Settings(tmp_path)
    service.make_folders()
    for name in ("deep", "bright"):
        (service.catalogues / name).mkdir()
        (service.catalogues / name / "nightglass.json").write_text("{}")
    scene["stars"] = {"catalogue": ["deep", "bright"]}
    accepted = accept_scene(scene, service)
    assert accepted.stars is not None
    assert accepted.stars.catalogues == ("deep", "bright")
    wrong = ("/etc", "../catalogues/deep", "./deep", str(service.catalogues / "deep"),
             "s3://bucket/deep", "http://127.0.0.1/deep", "file:///etc", "nothing")  # fmt: skip
    for name in wrong:
        for names, at in ((["deep", name], 1), ([name, "deep"], 0)):
            scene["stars"] = {"catalogue": names}
            with pytest.raises(NotAllowed) as caught:
                accept_scene(scene, service)
            [told] = caught.value.errors
            assert told["pointer"] == f"/stars/catalogue/{at}"
            assert "bright, deep" in told["allowed"]
    scene["stars"] = {"catalogue": list(wrong[:3])}
    with pytest.raises(NotAllowed) as caught:
        accept_scene(scene, service)
    assert len(caught.value.errors) == 3
    for names in ([], ["deep", "deep"], ["deep", 3], ["deep"] * 9):
        scene["stars"] = {"catalogue": names}
        with pytest.raises(BadInput):
            accept_scene(scene, service)


@pytest.mark.parametrize("more", ["", "/../x"])
def test_only_what_an_upload_may_be_called_is_looked_for(
    scene: dict[str, Any], tmp_path: Path, more: str
) -> None:
    """32 hexadecimal digits and an ending; with more behind it, it is no file of anybody's."""
    asked: list[str] = []
    file_id = f"{'0' * 31}a.npy"
    scene["sensor"]["flat"] = f"upload:{file_id}{more}"
    said = "no path or URL" if more else "no such file"
    with pytest.raises(NotAllowed, match=said):
        accept_scene(scene, Settings(tmp_path), lambda named: bool(asked.append(named)))
    assert asked == [file_id] * (not more)


def test_a_product_may_not_be_too_large(tmp_path: Path, scene: dict[str, Any]) -> None:
    """Frames x pixels of each layer: 2 bytes of dn (1 to 8 by its bits), 4 of any other; dn is
    stored where it is not asked for, too."""
    for bits, each, layers in (
        (16, 6, ["dn", "mean_e"]),
        (8, 5, ["dn", "mean_e"]),
        (17, 8, ["dn", "mean_e"]),
        (40, 12, ["dn", "mean_e"]),
        (63, 12, ["mean_e"]),
    ):
        scene["sensor"]["adc_bits"] = bits
        scene["output"] = {"layers": layers}
        most = each * 2 * 64 * 64
        accept_scene(scene, Settings(tmp_path, product_bytes=most))
        with pytest.raises(NotAllowed) as caught:
            accept_scene(scene, Settings(tmp_path, product_bytes=most - 1))
        [told] = caught.value.errors
        assert (told["pointer"], str(most) in told["allowed"]) == ("/output/layers", True)


def test_a_sky_that_cannot_be_judged_is_left_to_the_engine(
    tmp_path: Path,
    scene: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A fault of the service's own refuses nobody's scene; it is on the log."""
    monkeypatch.setattr("pipeline.route.judge.judge", lambda _: 1 / 0)
    found = accept_scene(scene, Settings(tmp_path))
    assert found.name == scene["name"]
    (record,) = caplog.records
    assert record.getMessage() == "a scene could not be judged; it is taken"
    assert "ZeroDivisionError" in str(record.exc_info)


def test_pointers() -> None:
    assert pointer("sensor.shape.0") == "/sensor/shape/0"
    assert pointer("stars.catalogue[1]") == "/stars/catalogue/1"
    assert pointer("a/b.c~d") == "/a~1b/c~0d"
    assert pointer("scene") == ""
    assert pointer("?limit") == "?limit"


def test_a_scene_may_not_take_too_long(tmp_path: Path, scene: dict[str, Any]) -> None:
    """By its frames and pixels alone, before it is queued; the field that says how many is told."""
    from pipeline.plan.cost import least_cpu_s

    scene["exposure"]["frames"] = 8000
    asked = least_cpu_s(accept_scene(scene, Settings(tmp_path)))
    assert asked > 100
    accept_scene(scene, Settings(tmp_path, job_cpu_s=asked + 1))
    with pytest.raises(NotAllowed) as caught:
        accept_scene(scene, Settings(tmp_path, job_cpu_s=asked - 1))
    [told] = caught.value.errors
    assert told["pointer"] == "/exposure/frames"
    assert told["value"] == "8000"
    assert f"(forecast: {asked:.0f})" in told["allowed"]
    scene["sensor"]["shape"] = [256, 2048]
    assert least_cpu_s(accept_scene(scene, Settings(tmp_path))) > 2 * asked
