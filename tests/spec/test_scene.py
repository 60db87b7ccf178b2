"""The scene format: every mistake is one BadInput with field, value and what is allowed."""

from __future__ import annotations

import copy
import json
import pickle
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import BadInput, exit_code
from pipeline.spec.load import parse_scene, scene_yaml
from pipeline.spec.scene import Scene

Data = dict[str, Any]


def with_value(data: Data, key: str, value: Any) -> Data:
    """A copy of the data with one dotted key set."""
    out: Any = copy.deepcopy(data)
    *parents, last = key.split(".")
    holder = out
    for part in parents:
        holder = holder[int(part) if part.isdigit() else part]
    holder[int(last) if last.isdigit() else last] = value
    return out


def numbers(data: Any, path: str = "") -> list[str]:
    """Dotted keys of all numbers in plain data."""
    if isinstance(data, dict):
        return [k for name, v in data.items() for k in numbers(v, f"{path}.{name}".strip("."))]
    if isinstance(data, list):
        return [k for i, v in enumerate(data) for k in numbers(v, f"{path}.{i}".strip("."))]
    return [path] if isinstance(data, float | int) and not isinstance(data, bool) else []


def refusal(data: Any) -> BadInput:
    with pytest.raises(BadInput) as caught:
        parse_scene(data)
    assert exit_code(caught.value) == 2
    assert len(str(caught.value)) < 20_000
    return caught.value


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("sensor.adc_bits", 0, "1"),
        ("sensor.adc_bits", 64, "63"),
        ("sensor.adc_bits", 16.5, "whole number"),
        ("sensor.shape.0", 0, "1"),
        ("sensor.shape.1", -5, "1"),
        ("sensor.shape.1", 60_001, "60000"),
        ("sensor.focal_length_m", 0.0, "greater than"),
        ("sensor.aperture_m", -0.4, "greater than"),
        ("sensor.pixel_pitch_um", "13.5 um", "number"),
        ("sensor.obscuration", 1.0, "less than 1"),
        ("sensor.fill_factor", 0.0, "greater than"),
        ("sensor.transmission", 1.2, "1"),
        ("sensor.quantum_efficiency", -0.1, "0"),
        ("sensor.gain_e_per_dn", 0.0, "greater than"),
        ("sensor.read_noise_e", -1.0, "0"),
        ("sensor.dark_e_per_s", -1.0, "0"),
        ("sensor.flat", -0.5, "0"),
        ("sensor.full_well_e", 0.0, "greater than"),
        ("sensor.adc_rounding", "up", "half_even"),
        ("sensor.psf.sigma_px", 0.01, "0.05"),
        ("sensor.psf.sigma_px", 51.0, "50"),
        ("sensor.psf.jitter_px", -0.1, "0"),
        ("sensor.psf.jitter_px", 1e9, "50"),
        ("sensor.psf.kind", "lorentz", "'gaussian', 'airy'"),
        ("sensor.bandpass.long_nm", 300.0, "400"),
        ("sensor.bandpass.short_nm", 10.0, "100"),
        ("observer.latitude_deg", 91.0, "90"),
        ("observer.height_m", 1e6, "100000"),
        ("observer.kind", "balloon", "'ground', 'orbit', 'fixed'"),
        ("pointing.mode", "stare", "'sidereal', 'rate', 'target'"),
        ("pointing.boresight_dec_deg", -90.5, "-90"),
        ("exposure.integration_s", -1.0, "equal to 0"),
        ("exposure.integration_s", "2 min", "number"),
        ("exposure.integration_s", None, "number"),
        ("exposure.frames", 0, "1"),
        ("exposure.cadence_s", 1.0, "integration_s = 2.0"),
        ("accuracy.noise_fraction", 0.0, "greater than"),
        ("accuracy.flux_fraction", 0.5, "0.1"),
        ("seed", -1, "0"),
        ("seed", 2**63, "9223372036854775808"),
        ("stars.catalogue", "", "1"),
        ("stars.catalogue", [], "a list of 1 to 8"),
        ("stars.catalogue", ["a"] * 9, "a list of 1 to 8"),
        ("stars.catalogue", {"main": "a"}, "a list of 1 to 8"),
        ("stars.catalogue", 3, "a list of 1 to 8"),
        ("stars.catalogue", ["a", True], "not true or false"),
        ("stars.faintest_g_mag", 99.0, "30"),
        ("targets.0.body.albedo", 1.5, "1"),
        ("targets.0.body.diameter_m", 0.0, "greater than"),
        ("targets.0.name", "../etc", "A-Za-z0-9"),
        ("targets.0.orbit.position_m", [1.0, 2.0], "given"),
        ("targets.0.orbit.kind", "sgp8", "'tle', 'state'"),
        ("name", "a/b", "A-Za-z0-9"),
        ("name", "", "A-Za-z0-9"),
        ("schema", "nightglass/scene/2", "nightglass/scene/1"),
        ("output.layers", ["dn", "raw"], "mean_e"),
        ("output.layers", ["dn", "dn"], "once"),
        ("output.compression", "gzip", "zstd"),
        ("output.tile_shape", [100, 768], "256"),
        ("output.tile_shape", [1024, 768], "512"),
        ("output.tile_shape", [0, 768], "1"),
        ("background.uniform_e_per_s", 1.0, "exactly one"),
    ],
)
def test_bad_values_name_field_value_and_remedy(
    full: Data, key: str, value: Any, allowed: str
) -> None:
    text = str(refusal(with_value(full, key, value)))
    field = {"background.uniform_e_per_s": "background"}.get(key, key)
    assert field in text
    assert allowed in text
    if isinstance(value, float | int | str) and value != "" and field == key:
        assert repr(value) in text


@pytest.mark.parametrize(
    ("catalogues", "field", "allowed"),
    [
        (["a", "b", "a "], "stars.catalogue[2]: 'a '", "once"),
        (["a", ""], "stars.catalogue[1]: ''", "1 to 1024"),
        ([["a"], "b"], "stars.catalogue[0]: ['a']", "1 to 1024"),
        (["a", "x" * 1025], "stars.catalogue[1]: 'x", "1 to 1024"),
    ],
)
def test_bad_catalogues_name_their_place(
    full: Data, catalogues: list[Any], field: str, allowed: str
) -> None:
    text = str(refusal(with_value(full, "stars.catalogue", catalogues)))
    assert text.startswith(field)
    assert allowed in text


@pytest.mark.parametrize(
    ("key", "near"),
    [
        ("nmae", "name"), ("sensor.aperture", "aperture_m"), ("sensor.adcbits", "adc_bits"),
        ("exposure.integration", "integration_s"), ("observer.latitude", "latitude_deg"),
        ("targets.0.body.diameter", "diameter_m"), ("sensor.psf.sigma", "sigma_px"),
        ("pointing.roll", "roll_deg"), ("stars.catalog", "catalogue"),
        ("output.tileshape", "tile_shape"), ("accuracy.noise_fracion", "noise_fraction"),
        ("sensor.bandpass.longnm", "long_nm"), ("targets.0.orbit.position", "position_m"),
    ],
)  # fmt: skip
def test_unknown_keys_suggest_the_nearest(full: Data, key: str, near: str) -> None:
    text = str(refusal(with_value(full, key, 1)))
    assert key in text
    assert f"did you mean {near!r}" in text


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf")])
def test_no_number_may_be_nan_or_infinite(full: Data, bad: float) -> None:
    keys = numbers(full)
    assert len(keys) > 40
    for key in keys:
        error = refusal(with_value(full, key, bad))
        assert key in str(error)


def test_no_number_may_be_true(full: Data) -> None:
    """Python takes true for 1; a scene that says `adc_bits: true` is a mistake."""
    for key in numbers(full):
        if not key.startswith(("targets.0.orbit.position", "targets.0.orbit.velocity")):
            error = refusal(with_value(full, key, True))
            assert key.split(".")[0] in str(error)
    assert parse_scene(with_value(full, "sensor.photon_noise", False)).sensor.photon_noise is False


@pytest.mark.parametrize(
    "section", ["observer", "sensor", "pointing", "exposure", "epoch", "schema"]
)
def test_missing_sections_are_named(full: Data, section: str) -> None:
    del full[section]
    error = refusal(full)
    assert error.field == section
    assert "must be given" in str(error)


@pytest.mark.parametrize(
    "section", ["stars", "targets", "background", "accuracy", "output", "seed"]
)
def test_other_sections_may_be_absent(full: Data, section: str) -> None:
    del full[section]
    parse_scene(full)


def test_a_union_without_its_kind_says_so(full: Data) -> None:
    for key in ("sensor.psf.kind", "observer.kind", "pointing.mode", "sensor.bandpass.kind"):
        data = copy.deepcopy(full)
        holder: Any = data
        *parents, last = key.split(".")
        for part in parents:
            holder = holder[part]
        del holder[last]
        text = str(refusal(data))
        assert key in text
        assert "must be given" in text


def test_names_must_differ_and_be_known(full: Data) -> None:
    full["targets"].append(copy.deepcopy(full["targets"][0]))
    assert "sat-1" in str(refusal(full))
    full["targets"].pop()
    full["pointing"] = {"mode": "target", "target": "sat-2"}
    text = str(refusal(full))
    assert "pointing.target" in text
    assert "sat-1" in text


def test_errors_survive_the_way_between_processes(full: Data) -> None:
    error = refusal(with_value(full, "seed", -1))
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_all_mistakes_come_at_once(full: Data) -> None:
    full["seed"] = -1
    full["exposure"]["frames"] = 0
    text = str(refusal(full))
    assert "seed" in text
    assert "exposure.frames" in text


@pytest.mark.parametrize("data", [None, [], "x", 5, True, b"x", {}, {1: 2}, {None: None}])
def test_not_a_scene(data: Any) -> None:
    refusal(data)


def test_values_are_never_echoed_whole(full: Data) -> None:
    assert len(str(refusal(with_value(full, "name", "x" * 1_000_000)))) < 2000
    assert len(str(refusal(with_value(full, "seed", 1 << 1_000_000)))) < 2000
    assert len(str(refusal(with_value(full, "sensor.shape", list(range(100_000)))))) < 5000


def test_round_trip_and_frozen(full: Data) -> None:
    scene = parse_scene(full)
    assert parse_scene(scene.as_dict()) == scene
    assert parse_scene(json.loads(json.dumps(scene.as_dict()))) == scene
    from pipeline.spec.load import parse_text

    assert parse_scene(parse_text(scene_yaml(scene).encode())) == scene
    with pytest.raises(ValueError, match="frozen"):
        scene.seed = 3  # type: ignore[misc]


def test_schema_has_every_section() -> None:
    schema = Scene.model_json_schema(by_alias=True)
    sections = set(schema["properties"])
    assert {
        "schema", "name", "epoch", "seed", "accuracy", "observer", "sensor", "pointing",
        "exposure", "stars", "targets", "background", "output",
    } <= sections  # fmt: skip
    assert schema["additionalProperties"] is False
    assert set(schema["required"]) >= {"schema", "observer", "sensor", "pointing", "exposure"}
    json.dumps(schema, allow_nan=False)


scalars = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
    | st.sampled_from(["gaussian", "airy", "ground", "orbit", "tle", "state", "target", "sat-1"])
)  # fmt: skip
names = st.sampled_from(
    ["kind", "mode", "shape", "psf", "orbit", "sigma_px", "name", "target", "path", "epoch"]
) | st.text(max_size=4) | st.integers(0, 3)  # fmt: skip
garbage = st.recursive(
    scalars,
    lambda part: st.lists(part, max_size=4) | st.dictionaries(names, part, max_size=5),
    max_leaves=12,
)


@settings(
    max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(where=st.data(), value=garbage)
def test_garbage_is_refused_or_taken_never_a_traceback(
    full: Data, where: st.DataObject, value: Any
) -> None:
    keys = [k.rsplit(".", cut)[0] for k in numbers(full) for cut in range(min(3, k.count(".") + 1))]
    key = where.draw(st.sampled_from(sorted({*keys, *full, "sensor.psf", "pointing"})))
    with suppress(BadInput):  # any other exception fails the test
        parse_scene(with_value(full, key, value))
