"""Scene files of SatSim and SImSiT: the scenes that they become, what is said of them, refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.importers.imported import Fields, Imported, scene_name
from pipeline.importers.satsim import read_satsim
from pipeline.importers.satsim_values import Chance, settled
from pipeline.importers.simsit import SITES, read_simsit
from pipeline.spec.load import apply_override, parse_yaml
from tests.pins.told import check_told

PEERS = Path(__file__).parents[1] / "data" / "peers"
EPOCHS = {"satsim": "2019-07-20T09:00:00Z", "simsit": "2010-07-01T05:00:00Z"}
# Changes of the files in tests/data/peers, taken or refused; % for `$sample: random.`.
SATSIM = """
name=all
sim=; fpa.extra.deep=1; geometry.more=[]; background.stray.mode=model; background.galactic=
fpa.num_frames=1; fpa.time={exposure: 2}; fpa.y_fov=0.21; fpa.bias=; fpa.a2d.dtype=uint8
geometry.stars={motion: {mode: affine, rotation: 0.1}}; fpa.noise=; fpa.psf={eod: 0.9}
geometry.stars=; geometry.obs.list=; background=; fpa.a2d.bias=-3; fpa.a2d.dtype=uint32
geometry.stars.motion.mode=affine-polar; geometry.obs.list=[{mode: none}, {mode: arc, more: 1}]
geometry.obs.list=[{mode: line, origin: [0.5, 0.25], velocity: [1, -2], model: {mode:
 lambertian_sphere, diameter: 2, albedo: 0.3, phase_angle: 40, distance: 900}, pe: }]
fpa.dark_current={%uniform, low: -9, high: 9, size: [80, 120], seed: 5}; fpa.gain={%normal,
 loc: 1, scale: 0.1, size: [80, 120]}; fpa.bias={%poisson, lam: 9}; geometry.stars.mv={}
geometry.obs.list={%list, length: {%randint, low: 2, high: 4}, value: {mode: line, origin:
 [{%uniform, low: 0, high: 1}, 0.5], velocity: [0, 0], mv: {%choice, choices: [12, 13, 14]}}}
fpa.dark_current={%uniform, low: 0, high: 9, size: [80, 121]}
fpa.height=0
fpa.height=60001
fpa.height=true
fpa.height=79.5
fpa.width=wide
fpa.y_fov=61
fpa.x_fov=0
fpa.psf.eod=1
fpa.psf.mode=airy
fpa.a2d.response=bent
fpa.a2d.dtype=float32
fpa.a2d.gain=0
fpa.a2d.fwc=0.5
fpa.a2d.bias=1e10
fpa.zeropoint=
fpa.zeropoint=61
fpa.zeropoint=-9; geometry.obs.list=
fpa.zeropoint=-11
fpa.time.exposure=-1
fpa.time.gap=-1
fpa.num_frames=1.5
fpa.num_frames=0
fpa.noise.read=-1
fpa.gain=x
fpa.gain=true
background.galactic=70
geometry.stars.motion.mode=spin
geometry.stars.motion.rotation=fast
geometry.stars.motion.translation=[1]
geometry.stars.motion.translation=[1, .nan]
geometry.obs.list={a: 1}
geometry.obs.list=[1]
geometry.obs.list=[{mode: line, origin: [0], velocity: [0, 0], mv: 1}]
geometry.obs.list=[{mode: line, origin: [0, 2000], velocity: [0, 0], mv: 1}]
geometry.obs.list=[{mode: line, origin: [0, 0], velocity: [0, 0]}]
geometry.obs.list=[{mode: line, origin: [0, 0], velocity: [0, 0], mv: 61}]
geometry.obs.list=[{mode: line, origin: [0, 0], velocity: [0, 0], pe: -1}]
geometry.obs.list=[{mode: line, origin: [0, 1000], velocity: [0, 0], mv: 10}]
fpa.dark_current={%magic}
fpa.gain={$generator: x}
fpa=1
"""
SIMSIT = """
seed=31
seed=32; tracker.type=orbit; sat.mag_range=; instrument.vignetting=; tracker.rot_sky_pos0=0
seed=33; instrument.distortion.dthdr=[0.061, 0.061, 0.061, 0.061]; instrument.image_shape=[64, 48]
seed=34; n_sat=2; filter=r; tracker.error=1; tracker.jitter=2; more.deep=1; conditions.x=1
seed=35; n_sat=1; instrument.obscuration=; cadence.exptime=[50]; instrument.pixel_scale=15.5
instrument.image_shape=[4096, 4096]; tracker.type=orbit
instrument.image_shape=[4097, 2048]; tracker.type=orbit; n_obs=; n_demo=; meta=; sites=[LaPalma]
instrument.image_shape=[0, 256]
instrument.image_shape=[320, 256, 1]
instrument.image_shape=[48.7, 32]; instrument.distortion.dthdr=[0.061, 0.061, 0.061, 0.061]
instrument.pixel_scale=wide
instrument.aperture=0
instrument.obscuration=1
instrument.gain=.nan
instrument.read_noise=-1
instrument.distortion.dthdr=[1, 2]
instrument.distortion.dthdr=[1, 2, 3, x]
instrument.distortion.dthdr=[0.06, 0.06, 0.06, 0]
instrument.distortion.th=[0.1, 0.2, 0.3, 0.4]
instrument.distortion.th=[0, 0.2, 0.2, 0.4]
instrument.vignetting.unvig=
conditions.psf_fwhm_range=[5, 2]
conditions.psf_fwhm_range=[0, 2]
conditions.sky_range=[18, 41]
conditions.zp_range=[-9, 3]
conditions.zp_range=[0]
cadence.exptime=[]
cadence.exptime=[-1]
sites=[]
sites=[moon]
sat.mag_range=[61, 62]
tracker.type=stare
tracker.rot_sky_pos0=1
seed=-1
seed=1.5
"""
# What a SatSim file leaves to chance or to small programs.
VALUES = """
{$pipeline: [{function: constant, kwargs: {value: 9}}, {function: poly, kwargs: {coef: [2, 5]}}]}
{$pipeline: {function: constant, kwargs: {}}}
{$pipeline: [sine]}
{$pipeline: {function: poly, kwargs: {coef: [x]}}}
{%choice, choices: [1, 2, 3], probabilities: [0.2, 0.3, 0.5]}
{%choice, choices: []}
{%choice, choices: [1], probabilities: [0.5]}
{%normal, loc: 5.0, scale: 1.0}
{%normal, loc: 5.0, scale: -1.0}
{%uniform, low: 1, high: 9}
{%uniform, low: a, high: 9}
{%randint, low: 3, high: 40}
{%randint, low: 4, high: 3}
{%lognormal, mean: 1.0, sigma: 0.5}
{%poisson, lam: 1e3}
{%exponential, scale: 2.0, seed: 3}
{%exponential, scale: 2.0, size: 3}
{%uniform, low: 1, high: 9, size: [2, 3]}
{%uniform, low: 1, high: 9, size: [0]}
{%uniform, low: 1, high: 9, size: [100001, 1000]}
{%uniform, low: 1, high: 9, size: [x]}
{%list, length: 10001}
{%list, length: 1.5}
{%list, length: 2, value: {a: [{$sample: poisson, lam: 9}]}}
{%list, length: 0}
{%nothing}
{a: {$b: 1}}
[[1, x, null]]
{a: {b: [{$sample: x}]}}
"""


def number(value: Any) -> Any:
    """Numbers to nine digits, vectors to a thousandth at most."""
    if isinstance(value, dict):
        return {key: number(one) for key, one in value.items()}
    if isinstance(value, list):
        vector = len(value) == 3 and all(isinstance(v, float) for v in value)
        return [number(round(one, 3) + 0.0 if vector else one) for one in value]
    if isinstance(value, np.ndarray):
        return [
            value.shape,
            *number([float(v) for v in (value.mean(), value.std(), value.flat[-1])]),
        ]
    return float(f"{value:.9g}") if isinstance(value, float) else value


def leaves(value: Any, name: str) -> dict[str, str]:
    """Plain values of nested data by dotted names; a list of plain values is one."""
    if isinstance(value, list) and not any(isinstance(v, dict) for v in value):
        return {name: json.dumps(value)}
    if not isinstance(value, dict | list):
        return {name: json.dumps(value)}
    items = value.items() if isinstance(value, dict) else enumerate(value)
    return {k: v for key, one in items for k, v in leaves(one, f"{name}.{key}").items()}


def told(call: Callable[[], Any]) -> Any:
    try:
        return call()
    except BadInput as error:
        return str(error).partition(". See")[0]


def lines_of(found: Any, before: dict[str, str]) -> list[str]:
    """A refusal; or what of a scene, its images and its notes is not as in those before."""
    if not isinstance(found, Imported):
        return [f"    {found}"]
    parts = leaves(number(found.data), "data")
    parts |= {f"image {k}": f"{v.dtype} {number(v)}" for k, v in found.images.items()}
    new = {k: v for k, v in parts.items() if before.get(k) != v}
    notes = [line for line in found.lines() if line not in before]
    before |= new | dict.fromkeys(notes, "")
    return [
        f"    {len(parts)} values",
        *(f"    {k[5:]}: {v}" for k, v in new.items()),
        *(f"  {line}" for line in notes),
    ]


@pytest.mark.parametrize("peer", ["satsim", "simsit"])
def test_scenes_of_peers(peer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NIGHTGLASS_DATA", raising=False)
    lines, before = [], dict[str, str]()
    wishes = (SATSIM if peer == "satsim" else SIMSIT).strip().replace("\n ", " ").splitlines()
    for i, wish in enumerate(wishes):
        data, file = given(peer), Path(f"{peer} {min(i, 1)}.x")
        if peer == "satsim" and i:
            del data["geometry"]["obs"]["list"][1:]
        for one in wish.replace("%", "$sample: random.").split("; "):
            apply_override(data, one)
        file.write_text(json.dumps(data))
        read = read_satsim if peer == "satsim" else read_simsit
        extra = {"catalogue": "gaia", "seed": 9} if i == 2 else {}
        found = told(lambda r=read, f=file, e=extra: r(f, EPOCHS[peer], **e))
        lines += [wish, *lines_of(found, before)]
    for text in ("", "[1]", "{", "\x00", "a: &x 1\nb: *x", "%"):
        file.write_text(text)
        lines.append(f"{text[:9]!r}: {told(lambda r=read, f=file: r(f, EPOCHS[peer]))}")
    check_told(f"spec/{peer}", "\n".join(lines))


def given(peer: str) -> Any:
    """A peer's file as plain data."""
    if peer == "satsim":
        return json.loads((PEERS / "satsim.json").read_text())
    from ruamel.yaml import YAML

    return json.loads(json.dumps(YAML(typ="safe", pure=True).load(PEERS / "simsit.yaml")))


def test_values_left_to_chance_and_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draws, keys of a file, names, and what is written."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NIGHTGLASS_DATA", raising=False)
    lines = []
    for wish in VALUES.strip().splitlines():
        value, said = parse_yaml(wish.replace("%", "$sample: random.")), list[str]()
        found = told(lambda v=value, s=said: settled(v, Chance(np.random.default_rng(4), s), "at"))
        lines += [f"{wish}: {number(found)}", *(f"    {one}" for one in said)]
    deep: Any = 1
    for _ in range(34):
        deep = {"a": deep}
    lines.append(str(told(lambda: settled(deep, Chance(np.random.default_rng(4))))))
    f = Fields({"a": {"b": 2, "c": {}, "d": [1, "x"], "e": None}, "f": 1.5, "g": True}, "top")
    for call in (
        lambda: f.has("a.b"),
        lambda: f.has("a.e"),
        lambda: f.has("f.x"),
        lambda: f.unused(),
        lambda: f.get("a.e", 7),
        lambda: f.number("a.b", 2, 2),
        lambda: f.number("g", 0, 1),
        lambda: f.number("a.z", 0, 9),
        lambda: f.number("a.z", 0, 9, 9),
        lambda: f.whole("f", 0, 9),
        lambda: f.whole("a.z", 0, 9, 9),
        lambda: f.pair("a.d"),
        lambda: f.pair("a.d", 3),
        lambda: f.unused(),
        lambda: f.get("a"),
        lambda: f.unused(),
        lambda: Fields(3),
    ):
        lines.append(repr(told(call)))
    names = ("a b.json", "._-x.y.z", "é", "n" * 200, "-", "A_1.b-2")
    lines += [scene_name(Path(name)) for name in names]
    lines += [f"{name}: {place}" for name, place in SITES.items()]
    found = read_simsit(PEERS / "simsit.yaml", EPOCHS["simsit"], "cat", 5)
    lines += [f"{key}: {len(told)}" for key, told in found.as_dict().items()]
    found.write(Path("new/s.yaml"))
    wrote = sorted(path.name for path in Path("new").iterdir())
    head = (Path("new/s.yaml")).read_text().splitlines()
    lines += [*wrote, *head[:3], *(line for line in head if line.startswith("# not"))]
    lines += [str(told(lambda: found.write(Path("new/s.yaml"))))]
    lines += [str(told(lambda: found.write(Path("new/t.yaml"))))]
    lines += [str(told(lambda: read_satsim(Path("none"), "x")))]
    Path("big").write_bytes(b" " * ((1 << 20) + 1))
    lines += [str(told(lambda: read_simsit(Path("big"), "x")))]
    check_told("spec/peers", "\n".join(lines))
