"""Scene text: YAML 1.2 and JSON, strict about duplicates, aliases, size, depth and encoding."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.spec.load import (
    MAX_BYTES,
    InvalidScene,
    apply_override,
    load_scene,
    parse_scene,
    parse_text,
    place_paths,
    scene_yaml,
)


def test_yaml_1_2_numbers_and_text() -> None:
    data = parse_text(
        b"a: 1e5\nb: 12:30:00\nc: 2019-04-20T03:00:00Z\nd: 2019-04-20\ne: yes\nf: 0.5\ng: 010\n"
    )
    assert data == {
        "a": 1e5, "b": "12:30:00", "c": "2019-04-20T03:00:00Z", "d": "2019-04-20", "e": "yes",
        "f": 0.5, "g": 10,
    }  # fmt: skip
    assert isinstance(data["a"], float)
    assert type(data["c"]) is str


def test_epoch_text_is_kept(full: dict[str, Any]) -> None:
    for epoch in ("2019-04-20T03:00:00Z", "2016-12-31T23:59:60.5Z", "2019-04-20"):
        text = scene_yaml(parse_scene({**full, "epoch": epoch}))
        assert parse_scene(parse_text(text.encode())).epoch == epoch


def test_json_is_read(full: dict[str, Any]) -> None:
    assert parse_text(json.dumps(full).encode()) == full
    assert parse_scene(parse_text(json.dumps(full, indent=2).encode())).seed == 7


@pytest.mark.parametrize(
    ("raw", "says"),
    [
        (b"a: 1\na: 2\n", "duplicate"),
        (b'{"a": 1, "a": 2}', "duplicate"),
        (b"a: &x [1]\nb: *x\n", "alias"),
        (b"\xff\xfea", "UTF-8"),
        (b"a: [1", "line 1"),
        (b"a: 1\n b: 2\n", "line 2"),
        (b"\x00", "YAML"),
        (b"a: !!python/object/apply:os.system [x]", "tag"),
        (b"a: 1\n---\nb: 2\n", "document"),
        (b"a: " + b"1" * 10_000, "digits"),
        (b"[" * 40, "levels"),
        (b"[" * 200_000, "levels"),
        (b"{a: " * 20_000, "levels"),
        (b"- " * 20_000, "levels"),
        (b"".join(b" " * i + b"a:\n" for i in range(900)), "levels"),
        (b'{"a": ' * 100_001, "levels"),
    ],
)
def test_refused_texts(raw: bytes, says: str) -> None:
    with pytest.raises(BadInput) as caught:
        parse_text(raw, "scene.yaml")
    assert says in str(caught.value)
    assert "scene.yaml" in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_billion_laughs_is_refused() -> None:
    lines = ["a0: &a0 [x, x]"] + [f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 40)]
    with pytest.raises(BadInput, match="alias"):
        parse_text("\n".join(lines).encode())


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60) | st.text(max_size=60).map(lambda t: t.encode("utf-8", "replace")))
@example(b"a: !!int x")
@example(b"? {a: 1}\n: 3")
@example(b"!!set {a, b}")
@example(b"a: !!omap [a, b]")
@example(b"!!timestamp [a]")
@example(b"!!map x")
@example(b"!!binary [x]")
@example(b"!!float {}")
@example(b"!!bool maybe")
@example(b"!!null x")
@example(b"%YAML 9.9\n---\na: 1")
@example(b"<<: 1")
@example(b"!!float ''")
@example(b"!!int ''")
@example(b"0x")
@example(b"0o")
@example(b"+")
def test_random_bytes_are_data_or_bad_input(raw: bytes) -> None:
    with suppress(BadInput):  # any other exception fails the test
        parse_scene(parse_text(raw))


def test_load_scene_and_paths(tmp_path: Path, full: dict[str, Any]) -> None:
    file = tmp_path / "scene.json"
    full["sensor"]["flat"] = "maps/flat.fits"
    full["sensor"]["bandpass"] = {"kind": "table", "path": "band.csv"}
    file.write_text(json.dumps(full))
    scene = load_scene(file, ["seed=9", "targets.0.body.albedo=0.5", "exposure.frames=2"])
    assert (scene.seed, scene.targets[0].body.albedo, scene.exposure.frames) == (9, 0.5, 2)
    assert scene.sensor.flat == str(tmp_path / "maps" / "flat.fits")
    assert scene.stars is not None
    assert scene.stars.catalogue == str(tmp_path / "gaia_dr2")
    assert scene.as_dict()["sensor"]["bandpass"]["path"] == str(tmp_path / "band.csv")


def test_catalogues_in_layers(tmp_path: Path, full: dict[str, Any]) -> None:
    """Relative paths are resolved one by one, URLs stay; a list of one is a path."""
    file = tmp_path / "scene.json"
    for asked, wanted in (
        (["gaia", "~/hip"], (str(tmp_path / "gaia"), str(Path("~/hip").expanduser()))),
        (["s3://b/c", "http://h/c"], ("s3://b/c", "http://h/c")),
        (["gaia", "file:///c"], (str(tmp_path / "gaia"), "file:///c")),
        (["gaia"], (str(tmp_path / "gaia"),)),
        ("s3://b/c", ("s3://b/c",)),
    ):
        full["stars"]["catalogue"] = asked
        file.write_text(json.dumps(full))
        stars = load_scene(file).stars
        assert stars is not None
        assert stars.catalogues == wanted
        assert stars.catalogue == (wanted[0] if len(wanted) == 1 else wanted)
    stars = load_scene(file, ["stars.catalogue=[a, b]", "stars.catalogue.1=c"]).stars
    assert stars is not None
    assert stars.catalogues == (str(tmp_path / "a"), str(tmp_path / "c"))
    with pytest.raises(BadInput, match=r"stars\.catalogue\[1\].*each catalogue once"):
        load_scene(file, ["stars.catalogue=[a, ./x/../a]"])


def test_paths_that_are_none_are_refused_by_their_fields(
    tmp_path: Path, full: dict[str, Any]
) -> None:
    """Of users that are not there, with a null byte; what is no text is left."""
    file = tmp_path / "scene.json"
    for wrong in ("~no-such-user/x.csv", "a\0b.csv"):
        full["sensor"]["quantum_efficiency"] = wrong
        file.write_text(json.dumps(full))
        with pytest.raises(BadInput, match=r"^sensor\.quantum_efficiency: .*a path; "):
            load_scene(file)
    data: dict[str, Any] = {"sensor": {"quantum_efficiency": [0.5, "x"]}}
    place_paths(data, tmp_path)
    assert data["sensor"]["quantum_efficiency"] == [0.5, str(tmp_path / "x")]


def test_missing_large_and_strange_files(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(BadInput, match="existing scene file"):
            load_scene(path)
    big = tmp_path / "big.yaml"
    big.write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(BadInput, match=str(MAX_BYTES)):
        load_scene(big)
    empty = tmp_path / "empty.yaml"
    empty.write_bytes(b"")
    with pytest.raises(BadInput, match="mapping"):
        load_scene(empty)


def test_a_file_as_large_as_may_be_is_read(tmp_path: Path, full: dict[str, Any]) -> None:
    file, text = tmp_path / "scene.json", json.dumps(full).encode()
    file.write_bytes(text + b" " * (MAX_BYTES - len(text)))
    assert load_scene(file) == parse_scene(full, base=tmp_path)


def test_data_nested_beyond_all_measure_is_refused(full: dict[str, Any]) -> None:
    """Given from Python, where no reader has counted the levels."""
    deep: Any = {}
    for _ in range(100_000):
        deep = {"a": deep}
    full["stars"] = {"catalogue": deep}
    with pytest.raises(BadInput):
        parse_scene(full)
    while deep:
        deep = deep.pop("a")  # one by one: the interpreter's stack would not do


@pytest.mark.parametrize("data", [b"", b"[1, 2]", b"text"])
def test_overrides_of_what_is_no_scene(tmp_path: Path, data: bytes) -> None:
    file = tmp_path / "scene.yaml"
    file.write_bytes(data)
    with pytest.raises(BadInput):
        load_scene(file, ["seed=1"])


@pytest.mark.parametrize(
    "override",
    ["seed", "=3", "a b=1", "seed.x=1", "targets.9.name=a", "targets.x=1", "sensor..flat=1",
     "name.0=1", "seed=[1", "seed=*a"],
)  # fmt: skip
def test_bad_overrides(full: dict[str, Any], override: str) -> None:
    with pytest.raises(BadInput, match="--set"):
        apply_override(full, override)


def test_overrides_set_values(full: dict[str, Any]) -> None:
    for text in (
        "sensor.read_noise_e=3", "background=null", "stars.parallax=false", "name=other",
        "output.layers=[dn, stars_e]", "sensor.adc_bits=1e1", "accuracy.noise_fraction=1e-2",
        "exposure.cadence_s=",
    ):  # fmt: skip
        apply_override(full, text)
    scene = parse_scene(full)
    assert scene.sensor.read_noise_e == 3.0
    assert scene.background is None
    assert scene.stars is not None
    assert scene.stars.parallax is False
    assert (scene.name, scene.output.layers) == ("other", ("dn", "stars_e"))
    assert (scene.sensor.adc_bits, scene.exposure.cadence_s) == (10, None)
    apply_override(full, "background.uniform_mag_arcsec2=21.5")  # of a section written as null
    background = parse_scene(full).background
    assert background is not None
    assert background.uniform_mag_arcsec2 == 21.5


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=30))
def test_random_overrides_never_trace_back(text: str) -> None:
    data = {"sensor": {"shape": [1, 2]}, "targets": [{"name": "a"}], "seed": None}
    for override in (text, f"sensor.shape.0={text}"):
        with suppress(BadInput):
            apply_override(data, override)


@pytest.mark.parametrize("opening", ["", "# a comment, so that YAML reads it\n"])
def test_yaml_and_json_nest_equally_deep(opening: str) -> None:
    """32 levels, in brackets or by indentation."""

    def nested(depth: int) -> str:
        return opening + '{"a": ' * depth + "1" + "}" * depth

    indented = "".join(f"{'  ' * i}k:\n" for i in range(32)) + "  " * 32 + "1\n"
    assert parse_text(nested(32).encode()) == json.loads('{"a": ' * 32 + "1" + "}" * 32)
    assert parse_text(indented.encode())
    with pytest.raises(BadInput, match="at most 32 levels"):
        parse_text(nested(33).encode())


@pytest.mark.parametrize(
    ("pointing", "field"),
    [({"roll_deg": "x"}, "pointing.roll_deg"), ({"roll_deg": True}, "pointing.roll_deg"),
     ({"target": 5}, "pointing.target"), ({"rol": 1.0}, "pointing.rol"),
     ({"target": None}, "pointing.target")],
)  # fmt: skip
def test_a_mode_that_is_a_key_too(
    full: dict[str, Any], pointing: dict[str, Any], field: str
) -> None:
    """`mode: target` and the key `target`: the field that is wrong is named, and nothing else."""
    full["pointing"] = {"mode": "target", "target": "t"} | pointing
    with pytest.raises(InvalidScene) as caught:
        parse_scene(full)
    assert [mistake[0] for mistake in caught.value.mistakes] == [field]


def test_true_is_no_number_in_lists_of_lists(full: dict[str, Any]) -> None:
    full["pointing"] = {"mode": "table", "rows": [[0, True, 0, 0, 0], [1, 1, 0, 0, 0]]}
    with pytest.raises(InvalidScene, match="true"):
        parse_scene(full)


@pytest.mark.parametrize(
    ("key", "value"), [("airglow", {"solar_flux_sfu": "x"}), ("zodiacal", {"nothing": 1})]
)
def test_a_mistake_inside_is_the_only_one_told(
    full: dict[str, Any], key: str, value: dict[str, Any]
) -> None:
    """Not also that a mapping is no mapping."""
    full["background"] = {key: value}
    with pytest.raises(InvalidScene) as caught:
        parse_scene(full)
    inside = f"background.{key}.{next(iter(value))}"
    assert [mistake[0] for mistake in caught.value.mistakes] == [inside]
