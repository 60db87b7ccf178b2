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
from pipeline.spec.dotted import changed
from pipeline.spec.load import InvalidScene, parse_scene, scene_yaml
from pipeline.spec.scene import Scene
from pipeline.spec.sweep_load import parse_sweep

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


def test_a_file_of_another_kind_is_told_by_its_schema(full: Data) -> None:
    """Not by the first key that a sweep has more, or a scene."""
    axes = [{"field": "seed", "values": [1]}]
    sweep = {"schema": "nightglass/sweep/1", "name": "d", "scene": "s.yaml", "axes": axes}
    parse_sweep(sweep)
    for parse, data, other in ((parse_scene, sweep, "sweep"), (parse_sweep, full, "scene")):
        with pytest.raises(InvalidScene) as told:
            parse(data)
        (mistake,) = told.value.mistakes
        assert mistake[:2] == ("schema", data["schema"])
        assert mistake[2].endswith(f"; this is a {other}")


def test_both_ends_of_a_range_are_told(full: Data) -> None:
    for value in (91.0, -91.0):
        full["observer"] = {"kind": "ground", "latitude_deg": value, "longitude_deg": 0.0}
        with pytest.raises(InvalidScene, match=r"observer\.latitude_deg.*\(-90 to 90\)"):
            parse_scene(full)


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


OSCILLATOR = {"kind": "oscillator", "axis": "x", "frequency_hz": 1.0, "damping": 0.1}
GROUND = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3}
HELD = {"mode": "sidereal", "boresight_ra_deg": 1.0, "boresight_dec_deg": 2.0}
ROWS = [[0, 0, 0, 0, 1], [99, 0, 0, 0, 1]]
LAMPS = ("sun", "moon", "earth")
PSF, DETECTOR, POINTING = "sensor.psf", "sensor.detector", "pointing"
WHOLE = {"output.tile_shape": None}
BENT = {"kind": "table", "read_e": [0, 8e4]}
HARVEY = {"kind": "harvey", "b0_per_sr": 1.0, "shoulder": 0.1, "slope": -1.0}


def moved(**attitude: Any) -> Data:
    return {POINTING: HELD | {"attitude": attitude}}


def band(low: float, high: float) -> Data:
    part = {"kind": "white", "rms_arcsec": 1.0, "low_hz": low, "high_hz": high}
    return moved(jitter=[part])


def spectrum(hertz: list[float], density: list[float]) -> Data:
    return moved(jitter=[{"kind": "table", "frequency_hz": hertz, "arcsec2_per_hz": density}])


def system(b: list[list[float]], c: list[list[float]]) -> Data:
    return moved(modes=[{"kind": "system", "a": [[-1.0, 0.0], [0.0, -2.0]], "b": b, "c": c}])


def amplifiers(*areas: tuple[list[int], list[int]]) -> Data:
    return {DETECTOR: {"amplifiers": [{"rows": r, "columns": c} for r, c in areas]}}


def curve_over(seconds: float) -> Data:
    curve = {"kind": "light_curve", "times_s": [10, 70], "magnitudes": [5.0, 6.0]}
    return {"targets.0.body": curve | {"period_s": seconds}}


def air(**parts: Any) -> Data:
    return {"observer": GROUND | {"atmosphere": parts}, "background": {"moonlight": True}}


def bent(*coefficients: float) -> Data:
    return {DETECTOR: {"nonlinearity": {"kind": "polynomial", "coefficients": coefficients}}}


# What is just right, what is just wrong, and the field that is named. The frame is 512 x 768.
EDGES: list[tuple[Data, Data, str]] = [
    ({"exposure.cadence_s": 2.0}, {"exposure.cadence_s": 1.999}, "exposure.cadence_s"),
    ({"dwells": [{"integration_s": [1, 5], "cadence_s": 5}]},
     {"dwells": [{"integration_s": [1, 5], "cadence_s": 4.99}]}, "dwells.0.cadence_s"),
    ({"dwells": [{"start_s": 0.0}]}, {"dwells": [{"start_s": 0.0, "wait_s": 0.1}]},
     "dwells.0.wait_s"),
    ({"sensor.bandpass.long_nm": 400.1}, {"sensor.bandpass.long_nm": 400.0},
     "sensor.bandpass.long_nm"),
    ({f"{PSF}.sigma_minor_px": 0.8}, {f"{PSF}.sigma_minor_px": 0.81}, f"{PSF}.sigma_minor_px"),
    ({PSF: {"kind": "airy", "wavelength_nm": 500, "wavelengths": 1}},
     {PSF: {"kind": "airy", "wavelength_nm": 500, "wavelengths": 2}}, f"{PSF}.wavelengths"),
    ({"sensor.bias_dn": 131_072}, {"sensor.bias_dn": 131_073}, "sensor.bias_dn"),
    ({"sensor.bias_dn": -65_536}, {"sensor.bias_dn": -65_537}, "sensor.bias_dn"),
    ({DETECTOR: {"bad": {"reads_dn": 65_535}}}, {DETECTOR: {"bad": {"reads_dn": 65_536}}},
     f"{DETECTOR}.bad.reads_dn"),
    ({DETECTOR: {"bad": {"pixels": [[511, 767]]}}}, {DETECTOR: {"bad": {"pixels": [[512, 0]]}}},
     f"{DETECTOR}.bad.pixels"),
    ({DETECTOR: {"dead": {"rows": [511]}}}, {DETECTOR: {"dead": {"rows": [0, 512]}}},
     f"{DETECTOR}.dead.rows"),
    ({DETECTOR: {"dead": {"columns": [767]}}}, {DETECTOR: {"dead": {"columns": [768]}}},
     f"{DETECTOR}.dead.columns"),
    ({DETECTOR: {"hot": {"pixels": [[511, 767, 1]]}}},
     {DETECTOR: {"hot": {"pixels": [[0, 0, 1], [0, 768, 1]]}}}, f"{DETECTOR}.hot.pixels"),
    (amplifiers(([0, 512], [0, 768])), amplifiers(([0, 513], [0, 5])), f"{DETECTOR}.amplifiers"),
    (amplifiers(([0, 5], [0, 768])), amplifiers(([0, 5], [0, 769])), f"{DETECTOR}.amplifiers"),
    (amplifiers(([0, 256], [0, 9]), ([256, 512], [0, 9])),
     amplifiers(([0, 257], [0, 9]), ([256, 512], [0, 9])), f"{DETECTOR}.amplifiers"),
    (amplifiers(([0, 9], [300, 768]), ([0, 9], [0, 300])),
     amplifiers(([0, 9], [299, 768]), ([0, 9], [0, 300])), f"{DETECTOR}.amplifiers"),
    (amplifiers(([3, 4], [5, 6])), amplifiers(([3, 3], [5, 6])), f"{DETECTOR}.amplifiers.0.rows"),
    *((WHOLE | {DETECTOR: wish}, WHOLE | {DETECTOR: wish, "sensor.full_well_e": None},
       f"{DETECTOR}.{name}")
      for name, wish in (("blooming", {"blooming": True}),
                         ("lag", {"lag": {"fraction": 0.1}}),
                         ("nonlinearity", bent(0.1)[DETECTOR]))),
    *((WHOLE | {DETECTOR: wish | {"readout": {"kind": "rolling", "line_s": 1e-3}}},
       WHOLE | {DETECTOR: wish | {"readout": {"kind": "tdi", "rows_per_s": 1.0}}},
       f"{DETECTOR}.{name}")
      for name, wish in (("blooming", {"blooming": True}), ("lag", {"lag": {"fraction": 0.1}}))),
    ({DETECTOR: {"nonlinearity": BENT | {"true_e": [0, 9e4]}}},
     {DETECTOR: {"nonlinearity": BENT | {"true_e": [0, 8.99e4]}}},
     f"{DETECTOR}.nonlinearity.true_e"),
    (bent(-0.499), bent(-0.5), f"{DETECTOR}.nonlinearity.coefficients"),  # flat at the full well
    (bent(-1.7, 1.2), bent(-2.0, 1.2), f"{DETECTOR}.nonlinearity.coefficients"),  # falls between
    ({DETECTOR: {"blooming": True}, "output.tile_shape": [512, 256]},
     {DETECTOR: {"blooming": True}, "output.tile_shape": [256, 256]}, "output.tile_shape"),
    ({"stars.limit_from_noise": True, "stars.faintest_g_mag": None},
     {"stars.limit_from_noise": True}, "stars.faintest_g_mag"),
    (air(extinction=True), air(refraction=True), "background.moonlight"),
    ({"background": {"airglow": True}},
     {"background": {"airglow": True}, "observer": {"kind": "fixed", "position_au": [1, 0, 0]}},
     "background.airglow"),
    (air(extinction=True), {"observer": GROUND | {"atmosphere": {"extinction": False}}},
     "observer.atmosphere"),
    ({"background": {"airglow": True}, "observer": GROUND | {"height_m": 50_000}},
     {"background": {"airglow": True}, "observer": GROUND | {"height_m": 50_001}},
     "background.airglow"),
    *((air(extinction={"mag_per_airmass": 0.2, "diffuse_share": 0.4}),
       air(extinction={"mag_per_airmass": 0.2, name: 1.0}),
       f"observer.atmosphere.extinction.{name}")
      for name in ("aerosol_mag", "aerosol_slope", "ozone_dobson")),
    *(({"background": {"stray_light": {"pst": HARVEY} | {n: n == name for n in LAMPS}}},
       {"background": {"stray_light": {"pst": HARVEY} | dict.fromkeys(LAMPS, False)}},
       "background.stray_light")
      for name in LAMPS),
    ({POINTING: {"mode": "table", "frame": "gcrs", "rows": ROWS, "scalar": "last"}},
     {POINTING: {"mode": "table", "frame": "gcrs", "rows": ROWS}}, "pointing.scalar"),
    ({POINTING: {"mode": "table", "frame": "gcrs", "path": "a.csv"}},
     {POINTING: {"mode": "table", "frame": "gcrs", "path": "a.csv", "rows": ROWS,
                 "scalar": "last"}}, "pointing"),
    (band(1.0, 1.001), band(1.0, 1.0), "pointing.attitude.jitter.0.high_hz"),
    (spectrum([1, 2], [3, 4]), spectrum([1, 1], [3, 4]),
     "pointing.attitude.jitter.0.frequency_hz"),
    (spectrum([1, 2, 3], [3, 4, 5]), spectrum([1, 2, 3], [3, 4]),
     "pointing.attitude.jitter.0.arcsec2_per_hz"),
    (moved(modes=[OSCILLATOR | {"rms_arcsec": 1}]), moved(modes=[OSCILLATOR]),
     "pointing.attitude.modes.0.rms_arcsec"),
    (system([[1.0], [0.0]], [[1, 0]] * 3), system([[1.0]], [[1, 0]] * 3),
     "pointing.attitude.modes.0.b"),
    (system([[1.0, 2, 3], [0.0, 1, 0]], [[1, 0]] * 3), system([[1.0], [0.0]], [[1, 0]] * 2),
     "pointing.attitude.modes.0.c"),
    (curve_over(60.0), curve_over(59.9), "targets.0.body.period_s"),
    ({"populations": [{"name": "p", "path": "a", "sizes": "b", "body": {
        "kind": "sphere", "diameter_m": 1, "albedo": 0.2}}]},
     {"populations": [{"name": "p", "path": "a", "sizes": "b", "body": {
         "kind": "cube", "edge_m": 1, "albedo": 0.2}}]}, "populations.0.body.kind"),
]  # fmt: skip


@pytest.mark.parametrize(("right", "wrong", "field"), EDGES)
def test_edges_between_fields(full: Data, right: Data, wrong: Data, field: str) -> None:
    """What one field allows of another: on the edge it is taken, beyond it one line names it."""
    parse_scene(changed(full, right))
    told = str(refusal(changed(full, wrong)))
    assert told.startswith(f"{field}: ")
    assert "\n" not in told


@pytest.mark.parametrize("others", [1, 30, 2500])
def test_names_of_targets_differ(full: Data, others: int) -> None:
    """However many targets there are; the names that occur twice are told."""
    one = full["targets"][0]
    names = [*(f"t{i}" for i in range(others)), "same", "same"]
    data = full | {"targets": [one | {"name": name} for name in names]}
    assert "different names; twice: same" in str(refusal(data))


@pytest.mark.parametrize(
    ("shape", "tile_shape", "allowed"),
    [
        ([128, 512], [64, 512], "all 128 rows"),
        ([512, 256], [256, 128], "all 256 columns"),
        ([512, 257], [256, 128], "on each axis a multiple of 256 px up to 257, or 257"),
    ],
)
def test_tiles_of_small_frames_are_told_what_there_is(
    full: Data, shape: list[int], tile_shape: list[int], allowed: str
) -> None:
    small = with_value(full, "sensor.shape", shape)
    told = str(refusal(with_value(small, "output.tile_shape", tile_shape)))
    assert told == f"output.tile_shape: {tile_shape} is not accepted; allowed: {allowed}"
