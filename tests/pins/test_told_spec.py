"""Scenes and sweeps as understood, the rules between their fields, texts, files and overrides."""

from __future__ import annotations

import json
import pickle
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from pipeline.errors import BadInput, shorten
from pipeline.spec.dotted import NoFieldError, add_dotted, changed, set_dotted
from pipeline.spec.load import (
    InvalidScene,
    apply_override,
    load_scene,
    parse_scene,
    parse_text,
    path_holders,
    resolve_paths,
    scene_yaml,
)
from pipeline.spec.sweep import RangeAxis, axis_length
from pipeline.spec.sweep_load import load_sweep, parse_sweep
from pipeline.spec.wording import range_of, words_of
from tests.pins.draw import scene_data, sweep_data
from tests.pins.files import elements
from tests.pins.scenes import SCENES, SWEEPS
from tests.pins.told import check_told

FILES = Path("files")
# A scene or sweep, then changes of it: what one field allows of another, on the edge and beyond.
RULES = """
stars sensor:
    exposure={integration_s: 0, frames: 2} |
    exposure={integration_s: 0, frames: 2, cadence_s: 0.1} | exposure.cadence_s=0.99 |
    exposure.cadence_s=1.0 | stars.limit_from_noise=true; stars.faintest_g_mag=3 |
    stars.catalogue=[a, 'a '] | stars.catalogue=[a, ''] |
    stars.catalogue=[a, b, c, d, e, f, g, h, i] | stars.catalogue=[' a '] | epoch=' 2019-12-01 ' |
    pst=1 | .aperture=1 | schema=nightglass/sweep/1 | schema=nightglass/scene/2 | schema=own |
    seed=-1; exposure.frames=0; .psf.sigma_px=wide; targets=[1] | seed=9223372036854775808 |
    output.layers=[dn, dn] | output.tile_shape=[256, 32] | output.tile_shape=[32, 32] |
    accept=[sun, sun] | pointing={mode: target, target: t} | background={} |
    background={starlight: auto} | background={uniform_e_per_s: 1, uniform_mag_arcsec2: 20} |
    background={airglow: true, uniform_e_per_s: 1} |
    background={airglow: false, zodiacal: false, galactic: true, starlight: true} |
    background={twilight: true} | .bandpass={kind: box, short_nm: 500, long_nm: 500} |
    .psf.charge_diffusion_px=0.1; .psf.charge_diffusion_um=1 |
    .psf.charge_diffusion_px=0; .psf.charge_diffusion_um=1 | .psf.sigma_minor_px=0.91 |
    .psf.sigma_minor_px=0.9 | .bias_dn=131073 | .bias_dn=131072 | .bias_dn=-65537 |
    .bias_dn=-65536 | .dark_scale=2 | .pupil_projection=; .flat=a.npy |
    .pupil_projection=true; .flat=a.npy
sphere:
    targets.1={} |
    targets+={name: t, orbit: {kind: tle, line1: a, line2: b},
    body: {kind: cube, edge_m: 1, albedo: 1}} |
    pointing.target=u | dwells=[{}, {pointing: {mode: target, target: u}}] |
    dwells=[{}, {pointing: {mode: target, target: t}}]
moonlight-and-twilight observer:
    .atmosphere= | .atmosphere={refraction: true}; background.twilight=false | .atmosphere={} |
    .atmosphere={extinction: false, refraction: false} | .atmosphere=; background={airglow: true}
two-tiles output:
    .tile_shape=[16, 100] | .tile_shape=[16, 512] | .tile_shape=[8, 300] | .tile_shape=[16, 300] |
    sensor.detector={blooming: true}; sensor.full_well_e=9; sensor.shape=[300, 16];
    .tile_shape=[256, 16] |
    sensor.detector={readout: {kind: frame_transfer, transfer_s: 1}}; sensor.shape=[300, 16];
    .tile_shape=[256, 16] |
    sensor.detector={readout: {kind: rolling, line_s: 1}}; sensor.shape=[300, 16];
    .tile_shape=[256, 16]
airy-with-vanes sensor.psf:
    .wavelengths=2 | .wavelengths=1 | .aberrations.1.noll=7 | .aberrations.1.rms_nm=7
moffat sensor.psf:
    .fwhm_px=2 | .fwhm_arcsec=
kolmogorov sensor.psf:
    .r0_m=0.1 | .fwhm_arcsec=
table-of-light:
    sensor.psf.sample_um=1
field-of-psfs sensor.psf:
    .rows_px=[0, 0.9] | .rows_px=[0, 1] | .columns_px=[4, 3] | .columns_px=[4, 27, 30] |
    .rows_px=[4] | .psfs.1.0.includes_pixel=true
field-of-tables sensor.psf.psfs.0.2:
    .vanes={count: 3, width_m: 0.01} | .kind=field
pixels-that-fail sensor.detector:
    .bad.reads_dn=65536 | .bad.reads_dn=65535 | .bad.pixels=[[0, 0], [32, 0]] |
    .dead.pixels=[[31, 32]] | .dead.pixels=[[31, 31]] | .hot.pixels=[[0, 32, 1]] |
    .bad.rows=[0, 32]; sensor.shape=[32, 40] | .dead.columns=[33]; sensor.shape=[40, 33] |
    .dead.columns=[32]; sensor.shape=[40, 33]
patterns sensor.detector.amplifiers:
    .0.rows=[0, 33] | .1.columns=[16, 33] | .1.columns=[15, 32] | .1.columns=[9, 9] |
    .0.rows=[9, 8] | .0.rows=[16, 32]; .1.columns=[0, 32]
blooming sensor.detector.nonlinearity:
    sensor.full_well_e= |
    sensor.detector.readout={kind: tdi, rows_per_s: 1}; sensor.detector.nonlinearity= |
    sensor.detector.blooming=false; sensor.full_well_e= | .coefficients=[-0.5] |
    .coefficients=[-0.49] | .coefficients=[-2.0, 1.2] | .coefficients=[-1.7, 1.2] |
    .coefficients=[0, -1, 0.5]
bent-response-and-lag sensor.detector:
    sensor.full_well_e=; .nonlinearity= | .readout={kind: tdi, rows_per_s: 1} |
    sensor.full_well_e=3000.5 | .nonlinearity.read_e=[0, 1] | .nonlinearity.read_e=[0, 1, 1] |
    .nonlinearity.true_e=[1, 500, 3000]
distortion-sip sensor.distortion:
    .a={A_2_0: 1, 2_1: 1} | .a={A_2_0: 1, '0_3': 2, B_9_0: 1} | .a={A_2_0: 1, '2_0': 1} |
    .b={'5_5': 1} | .b={x: 1} | .b={'1_1': true} | .b={'1_1': 1e31}
distortion-tpv sensor.distortion:
    .pv1={PV1_4: 1, 39: 2, '7': 3} | .pv1={40: 1} | .pv1={4: 1, PV1_4: 2} | .pv2={4: false} |
    .pv2={true: 1}
dwells dwells:
    .0.cadence_s=0.79 | .0.cadence_s=0.8 | .0={integration_s: 3, cadence_s: 2} | .1.wait_s=1 |
    .1.wait_s=0 |
    .1.pointing.attitude={jitter: [{kind: white, rms_arcsec: 1, low_hz: 1, high_hz: 2}]} |
    .1.pointing.attitude={modes: [{kind: random_walk, axis: x, arcsec_rts: 1}]}
attitude-of-rows pointing:
    .scalar= | .path=a.csv
attitude-of-a-table:
    pointing.path=
attitude-that-wanders pointing.attitude.jitter:
    .0.high_hz=0.5 | .1.low_hz=20.0 | .3.frequency_hz=[1, 2] | .4.path=a | .4.frequency_hz=[1, 2] |
    .4.frequency_hz=[1, 2, 2]
attitude-that-bends pointing.attitude.modes:
    .0.rms_arcsec= | .1.rms_arcsec=2 | .2.rms_arcsec= | .6.a=[[1, 2]] | .6.b=[[1], [1, 2]] |
    .6.b=[[1]] | .6.c=[[1, 0], [0, 1]]
orbits-of-messages targets.0.orbit:
    .elements={epoch: a} | .path=
orbits-of-kepler targets.0.orbit:
    .semi_major_axis_m=1 | .true_anomaly_deg=1 | .mean_anomaly_deg= | .eccentricity=1 |
    observer.orbit.semi_major_axis_m=-7.2e6 |
    observer.orbit.semi_major_axis_m=-7.2e6; observer.orbit.eccentricity=1.01 |
    observer.orbit.eccentricity=1.0
orbits-of-tables targets.0.orbit:
    .rows=[[0, 1, 2, 3], [1, 1, 2, 3, 4]] | .rows=[[0, 1, 2], [1, 1, 2]] |
    .rows=[[0, 1, 2, 3], [0, 1, 2, 3]] | .rows=[[0, 1, 2, 3], [1, 1, 2, 1.1e13]] |
    .rows=[[0, 1, 2, 3, 4, 5, 6], [1, 1, 2, 3, 4, 5, 1e13]]
plate targets.0.body:
    .albedo=[[350, 0.2], [350, 0.5]] | .albedo=[[350, 0.2]] | .attitude.quaternion=[0, 0, 0, 0]
cylinder:
    targets.0.body.attitude.axis=[0, 0, 1e-10]
composite:
    targets.0.body.parts.1.attitude.axis=[0, 0, 0]
frustum targets.0.body.attitude:
    .times_s=[0, 0, 1] | .times_s=[0, 1] | .quaternions.1=[0, 0, 0, 0]
light-curves targets.0.body:
    .intensities_m2_sr=[1, 1, 1, 1] | .magnitudes= | .magnitudes=[1, 1] | .times_s=[0, 0, 1, 2] |
    .phase_law=lambert | targets.1.body.period_s=199 | targets.1.body.mag_per_deg=0.1
mesh targets.0.body:
    .materials.paint.specular=0.71 | .materials.paint.specular=0.7 |
    .surface.refractive_index=[1, 1] | .surface.normal_reflectance= |
    .materials.cells.grain=[0, 0, 0] | .parts.0.joint.face=[2, 0, 0] |
    .parts.0.joint.axis=[0, 0, 0] | .parts.0.quaternion=[0, 0, 0, 0] | .parts.0.objects=
mesh-of-some-size targets.0.body.parts:
    .1.name=arm | .1.on=foot | .0.on=arm | .0.path=; .1.path=; .1.objects=[Bus]
population populations:
    .0.body={kind: cube, edge_m: 1, albedo: 1} | .1.body={kind: cube, edge_m: 1, albedo: 1}
stray-light-of-mirrors background:
    .stray_light={pst: {kind: table, path: a}, sun: false, moon: false, earth: false} |
    .stray_light={pst: {kind: table, path: a}, sun: false, moon: false}
sweep-of-a-grid axes:
    schema=nightglass/scene/1 | .0.field=name | .0.field=output.layers |
    .0.field=targets.0.body.albedo | .0.field=targets.0 | .0.field=targets.0.body.albedo.x |
    .0.field=targets.0.body.alb | .1.count= | .0={field: seed} | design={kind: zip} |
    design={kind: zip}; .0.values=[1, 2, 3] | design={kind: sobol, points: 3} | cubes=[8] |
    cubes=[7] | seeds=100000; .1.count=51 | seeds=100000; .1.count=50
sweep-in-step axes:
    .0.rows=[[1, 2], [3]] | .1.start=0 | .1.stop=-1
sweep-of-sobol design:
    axes.0.count=3 | .points=10000001 | seeds=3; .points=4000000
sweep-of-a-latin-square design:
    .points=10000000 | .points=9000000; axes={}
"""
# Texts of scene files, as they are written.
TEXTS = [
    "a: 1e5\nb: 12:30:00\nc: 2019-04-20T03:00:00Z\nd: 2019-04-20\ne: yes\nf: on\ng: 010\nh: 0o10",
    "a: 1_000\nb: .inf\nc: ~\nd: +1\ne: 0x1F\nf: !!str 1\ng: 1.\nh: null",
    '{"a": 1e5, "b": "x"}',
    '{"a": 1, "a": 2}',
    "{a: 1}",
    "a: 1\na: 2",
    "a: &x [1]\nb: *x",
    "a: [1",
    "a: 1\n b: 2",
    "\x00",
    "a: !!python/object:x [x]",
    "a: 1\n---\nb: 2",
    "[" * 34,
    "[" * 33 + "]" * 33,
    '{"a": 1} x',
    "[" * 32 + "]" * 32,
    '{"a": ' * 33 + "1" + "}" * 33,
    '{"a": ' * 32 + "1" + "}" * 32,
    "",
    "%YAML 1.1\n---\na: 1",
    "%YAML 1.2\n---\na: 1",
    "? {a: 1}\n: 3",
    "!!map x",
    "!!float ''",
    "<<: 1",
    "a: !!timestamp [1]",
    "x",
    "a: '1",
    "%YAML 9.9\n---\na: 1",
    "a: " + "1" * 5000,
]
OVERRIDES = (
    "seed=9 | seed | =3 | a b=1 | seed.x=1 | targets.9.name=a | targets.x=1 | a..b=1 | name.0=1 |"
    " seed=[1 | seed=*a | background=null | exposure.cadence_s= | accept+=sun | accept+=moon |"
    " accept+=sun | seed+=1 | a.b.c=1 | targets.0.name=b | targets.0.a.b+=x | sensor.shape.1=4 |"
    " sensor.shape.2=4 | sensor.shape.0+=1 | x= 1e3  | y=a=b | list+="
)


def cases() -> Iterator[tuple[str, str, str]]:
    """Of RULES: a scene, the key before those that begin with a point, changes."""
    for block in RULES.strip().replace("\n    ", " ").splitlines():
        head, _, rest = block.partition(": ")
        scene, _, before = head.partition(" ")
        yield from ((scene, before, one) for one in rest.split(" | "))


def told(run: Callable[[], Any]) -> str:
    """What a call gives, or its refusal, a long value in it shortened."""
    try:
        found = run()
    except InvalidScene as error:
        said = [f"{f}: {shorten(v, 30)}: {a}" for f, v, a in error.mistakes]
        return " / ".join(one.replace(": allowed: ", ": ") for one in said)
    except (BadInput, NoFieldError) as error:
        return f"{type(error).__name__}: {error}"
    return json.dumps(found.as_dict() if isinstance(found, BaseModel) else found, default=repr)


def parsed(name: str, asked: list[str]) -> Any:
    """The scene or sweep of this name with these overrides."""
    data = sweep_data(name, FILES) if name in SWEEPS else scene_data(name, FILES)
    for one in asked:
        apply_override(data, one)
    return (parse_sweep if name in SWEEPS else parse_scene)(data)


def test_rules_between_fields() -> None:
    """The refusal, or nothing where it is taken."""
    lines, last = [], ""
    for name, before, wish in cases():
        asked = [f"{before}{c}" if c.startswith(".") else c for c in wish.split("; ")]
        text = told(lambda n=name, a=asked: parsed(n, a))  # type: ignore[misc]
        lines += [f"-- {name} {before}"] * (name != last)
        lines += [wish if text[0] == "{" else f"{wish} -> {text}"]
        last = name
    check_told("spec/rules", "\n".join(lines))


def leaves(value: Any, name: str = "") -> dict[str, Any]:
    """Plain values of nested data by dotted names."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    out: dict[str, Any] = {}
    for key, one in items:
        at = f"{name}.{key}" if name else str(key)
        out |= leaves(one, at) if one and isinstance(one, dict | list | tuple) else {at: one}
    return out


def test_scenes_as_understood() -> None:
    """A digest of each, how many values, their sum, how many letters; what is not as given.

    Of that only what no scene before has.
    """
    lines, seen = [], set[str]()
    for name in (*SCENES, *SWEEPS):
        scene = parsed(name, [])
        raw = sweep_data(name, FILES) if name in SWEEPS else scene_data(name, FILES)
        given, found = leaves(raw), leaves(scene.as_dict())
        assert type(scene).model_validate(scene.as_dict()) == scene
        letters = sum(len(v) for v in found.values() if isinstance(v, str))
        total = sum(v for v in found.values() if isinstance(v, int | float))
        names = {k: k.rpartition(".")[2] for k, v in found.items() if given.get(k, "") != v}
        own = [*dict.fromkeys(f"{short} {found[k]}" for k, short in names.items())]
        lines.append(f"{name}: {len(found)} values, {total:.12g}, {letters} letters")
        lines += ["    " + ", ".join(one for one in own if one not in seen)]
        seen |= {*own}
    lines.append(scene_yaml(parsed("stars", [])))
    check_told("spec/scenes", "\n".join(lines))


def test_texts_and_overrides() -> None:
    lines = [f"{text[:60]!r}: {told(lambda t=text: parse_text(t.encode(), 'f'))}" for text in TEXTS]
    lines.append(told(lambda: parse_text(b"\xff\xfea")))
    data: Any = {"seed": 1, "name": "a", "targets": [{"name": "a"}], "sensor": {"shape": [1, 2]}}
    lines += [
        f"{one}: {told(lambda o=one: apply_override(data, o))}" for one in OVERRIDES.split(" | ")
    ]
    lines += [json.dumps(data), told(lambda: apply_override([1], "0=2"))]
    small: Any = {"a": {"b": 1}, "c": [{"d": 2}, [3]]}
    for name in ("a.b.x", "c.2", "a.e", "c.1.0", "c.1.x", "c.0.d.e.f", "c.0.g.h", "c.1"):
        for change in (set_dotted, add_dotted, lambda d, n, v: changed(d, {n: v})):
            copy = json.loads(json.dumps(small))
            text = told(lambda c=change, n=name, d=copy: c(d, n, 5) or d)
            lines.append(f"{name}: {text}")
    lines.append(json.dumps([changed(small, {"a.b": None, "c.0": None, "z": None}), small]))
    for data in ("x", {}, None, [1], b"x"):
        lines += [told(lambda d=data: parse_scene(d)), told(lambda d=data: parse_sweep(d))]
    wrong = scene_data("stars", FILES) | {"seed": -1, "name": "?", "epoch": "x" * 500, "a": 1}
    for many in (wrong, wrong | {"targets": [1] * 19}):
        many.pop("a", None)
        with pytest.raises(InvalidScene) as caught:
            parse_scene(many)
        again = pickle.loads(pickle.dumps(caught.value))
        assert str(again) == str(caught.value)
        lines += [str(again), repr((again.field, again.value, again.allowed))]
    check_told("spec/texts", "\n".join(lines))


def test_files_and_their_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which fields may name files, and to what their paths are made; which files are refused."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    lines, fields, moves = [], set[str](), dict[str, Any]()
    for name in SCENES:
        scene = parse_scene(scene_data(name, Path("../files")))
        before = scene.as_dict()
        fields |= {re.sub(r"\.\d+", ".*", field) for field, _, _ in path_holders(before)}
        after, old = leaves(resolve_paths(scene, tmp_path / "deep").as_dict()), leaves(before)
        moves |= {k: v for k, v in after.items() if old.get(k) != v}
    lines += [*sorted(fields), *(f"{k}: {v}" for k, v in sorted(moves.items()))]
    monkeypatch.chdir(tmp_path)  # messages cut long paths
    file = Path("deep/f.yaml")
    file.parent.mkdir()
    stars = scene_data("stars", Path("files"))
    for catalogue in ("~/a", "s3://a/b", "/a/../b", ["a", "./b", "http://c"]):
        file.write_text(json.dumps(changed(stars, {"stars.catalogue": catalogue})))
        text = told(lambda: load_scene(file, ["seed=3"]).as_dict()["stars"]["catalogue"])
        lines.append(f"{catalogue}: {text}")
    tle = "".join(f"{line}\n" for line in elements(100, 40.0))
    for content in (
        tle,
        "A\n" + tle,
        tle[:69],
        "#" * (1 << 20),
        "#" * ((1 << 20) + 1),
        "x",
        "a: [",
        "",
    ):
        file.write_text(content)
        lines += [f"{content[:20]!r}: {told(lambda: load_scene(file))}"]
        lines += [told(lambda: load_sweep(file))]
    lines += [told(lambda: load_scene(file.parent)), told(lambda: load_sweep(file.parent))]
    file.write_text(json.dumps(sweep_data("sweep-in-step", FILES)))
    lines.append(str(load_sweep(file).points))
    check_told("spec/files", "\n".join(lines), folder=tmp_path)


def test_words_and_numbers_of_the_format() -> None:
    lines, by = [], dict[str, list[str]]()
    for kind in ("range", "log_range"):
        for integer in (False, True):
            axis = RangeAxis(kind=kind, field="a", start=0.3, stop=9.6, count=3, integer=integer)
            lines.append(f"{kind} {integer}: {[f'{axis.at(k / 7):.12g}' for k in range(8)]}")
    for name in SWEEPS:
        found = parsed(name, [])
        axes = [(axis.kind, axis.fields, axis_length(axis)) for axis in found.axes]
        lines.append(f"{name}: {found.points} points, {axes}")
    fields = "shape.0 pixel_pitch_um bandpass.short_nm aperture_m sun_exclusion_deg psf.jitter_px "
    fields += (
        "psf.fwhm_arcsec read_noise_e bias_dn adc_bits flat dark_e_per_s psf.kind distortion.a.x"
    )
    every = [f"sensor.{field}" for field in fields.split()]
    every += ["exposure.cadence_s", "stars.faintest_g_mag", "a.b", "targets.9.orbit.rows.0.3", ""]
    for field in every:
        names = field.split(".")
        lines.append(f"{field}: {words_of(names)!r}, {range_of(names)!r}")
    for name in SCENES:
        scene = parsed(name, [])
        s, b = scene.sensor, scene.background
        text = f"{s.top_dn} {len(s.every_psf)} {s.detector and s.detector.whole_columns}"
        text += f" {[one.diffusion_px(s.pixel_pitch_um) for one in s.every_psf]}"
        text += f" {[*scene.star_effects.values()]} {scene.exposure.step_s}"
        text += f" {b and (b.varies, b.of_the_air)} {scene.stars and len(scene.stars.catalogues)}"
        held = scene.pointing.attitude
        by.setdefault(f"{text} {held and held.random}", []).append(name)
    lines += [f"{text}: {', '.join(names)}" for text, names in by.items()]
    lines.append(parsed("field-of-psfs", []).sensor.psf.name_of("sensor.psf.jitter_px", 3))
    check_told("spec/numbers-of-scenes", "\n".join(lines))
