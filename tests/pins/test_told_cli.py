"""What the command line tells of scenes, products, exports, catalogues and servers, pinned."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.main import get_command

from pipeline.export.formats import FORMATS
from pipeline.spec.dotted import changed
from pipeline.spec.load import parse_yaml
from tests.command import nightglass
from tests.pins.draw import _cube, _fits, _leaves, _picture, _placed, _truth, scene_data
from tests.pins.files import DEC_DEG, RA_DEG, write_files
from tests.pins.scenes import BASE, CURVE, IN_ORBIT, LIGHTS, PLACE_M, SPEED_M_S, SPHERE
from tests.pins.told import check_told

HERE = Path()
ONE = ("--scheduler", "synchronous")
MASKS = {  # what differs from run to run, and from machine to machine
    r"(?<![\w.])[0-9a-f]{16,}(?!\w)": "<hex>",
    r"(tile\(s\)|points) in [\d.]+ s\b": r"\1 in # s",
    r"[\d.e+-]+ s of one core": "# s of one core",
    r"ightglass \d[\w.]*": "ightglass #",
    r"[\d.e+-]+ s if nothing": "# s if nothing",
    r"size  [\d.e+-]+ MB": "size  # MB",
    r"(plan|light|point) [\d.e+-]+ s\b": r"\1 # s",
    r"[\d.]+ MB\)": "# MB)",
    r"(bytes(_per_row|_read)?)([ =]+)[\d.]+": r"\1\3#",
    r"failed, [\d.]+ s\.": "failed, # s.",
    r"(seconds|light_s)  [\d.e+-]+ \.\. [\d.e+-]+": r"\1  #",
}
VARY = re.compile(
    r"metrics\.seconds|.*\b(versions|light_s)\b|(.*\.)?((alone_)?cpu_s|(plan|draw|finish)_s|seconds|"
    r"peak_driver_mb|bytes(_to_read|_per_row)?|seconds_saved|light|plan|table_mb)$"
)
SHAKY = re.compile(r".*(error_(e|rms_e|sigma)|_residual_px|(streak|spread)_px)$")  # but rounding
OF_PLANS = re.compile(r"decisions.([5-9]|\d\d|.*(reason:|rule:|_by:|saved:|None$))")  # pages do


def masked(text: str) -> str:
    for pattern, word in MASKS.items():
        text = re.sub(pattern, word, text)
    return text


def ran(*arguments: str | Path) -> str:
    """A command, its exit code, what it printed (JSON by its leaves), and its errors."""
    done = nightglass(*arguments)
    out = done.stdout
    if "--json" in arguments and done.stdout.startswith(("{", "[")):
        out = "\n".join(x for x in leaves(json.loads(done.stdout)) if not OF_PLANS.match(x))
    error = "".join(f"! {line}\n" for line in done.stderr.splitlines())
    told = f"$ {' '.join(map(str, arguments))}\n[{done.returncode}]\n{out}\n{error}"
    return masked(re.sub(r"\n+", "\n", told))


def runs(*commands: str) -> str:
    """Commands, one a line."""
    lines = (line for text in commands for line in text.strip().splitlines())
    return "".join(ran(*line.split()) for line in lines)


def number(value: Any, digits: int = 12) -> str:
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def leaves(value: Any) -> Iterator[str]:
    """Nested plain data, a line for each value; times and sizes are masked."""
    for name, one in _leaves(value):
        told = number(one, 1 if SHAKY.match(name) else 12)
        yield masked(f"{name}: {'#' if VARY.match(name) else told}")


def array(values: Any) -> str:
    """An array by its shape and a few sums, among them one along each axis; of few, all values."""
    a = np.asarray(values)
    told = f"{a.dtype.kind}{a.shape}"
    if a.dtype.kind not in "biuf":
        return masked(f"{told} {[*map(str, a.ravel()[:6])]}")
    v = np.nan_to_num(a.astype(float), posinf=0.0, neginf=0.0)
    least = 1e-9 * float(np.abs(v).sum())  # less is rounding
    if a.size <= 6:
        return f"{told} {[number(x) if not abs(x) < least else '0' for x in a.ravel().tolist()]}"
    sums = [v.sum(), (v * v).sum()]
    for k, size in enumerate(a.shape):
        weight = np.arange(1.0, size + 1.0).reshape([-1 if i == k else 1 for i in range(a.ndim)])
        sums.append((v * weight).sum())
    sums += [v.min(), v.max()]
    digits = 4 if a.dtype.kind in "bui" else 8
    lost = f" {a.size - np.isfinite(a).sum()} not finite" if not np.isfinite(a).all() else ""
    return f"{told} {' '.join(f'{s:.{digits}e}' if abs(s) > least else '0' for s in sums)}{lost}"


def arrays(found: dict[str, Any]) -> str:
    """Arrays by name, without those that are but rounding."""
    shaky = ("wcs_residual_px", "wcs_sip_a", "wcs_sip_b")
    return "".join(f"{k}: {array(v)}\n" for k, v in sorted(found.items()) if k not in shaky)


def ahead(body: Any, name: str, range_m: float, off_deg: float = 0.0, **more: Any) -> Any:
    """A target in the pinned field of stars as IN_ORBIT sees it, faster than that."""
    ra, dec = np.radians([RA_DEG + off_deg, DEC_DEG - 0.3 * off_deg])
    u = [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]
    place = [float(round(p + range_m * v, 3)) for p, v in zip(PLACE_M, u, strict=True)]
    speed = [SPEED_M_S[0] + 3e-4 * range_m, SPEED_M_S[1], SPEED_M_S[2] + 1e-4 * range_m]
    orbit = {"kind": "state", "position_m": place, "velocity_m_s": speed}
    return {"name": name, "orbit": orbit, "body": body, "eclipse": False} | more


RICH = parse_yaml("""
accept: [coverage, error]
background.uniform_e_per_s: 50.0
stars: {catalogue: ["@stars", "@layer"], faintest_g_mag: 13.0}
sensor.shape: [40, 300]
sensor.full_well_e: 30000.0
sensor.flat: 0.9
sensor.fill_factor: 0.8
sensor.dark_e_per_s: 3.0
sensor.detector: {bad: {pixels: [[3, 40]]}, hot: {pixels: [[20, 150, 900.0]]}, row_noise_e: 2.0}
exposure: {integration_s: 1.0, frames: 2, cadence_s: 2.0}
cosmic_rays: {kind: generated, rate_per_cm2_s: 300.0}
output: {tile_shape: [40, 256], compression: zstd}
""")
RICH["observer"] = IN_ORBIT
RICH["output"]["layers"] = [*LIGHTS, "calibrated_e", "cosmic_rays_e"]
FADING = CURVE | {"magnitudes": [6.0, 6.0, 7.5, 7.5], "range_m": 4e6}
RICH["targets"] = [
    ahead(SPHERE, "t", 1e6, 0.02),
    ahead(SPHERE | {"diameter_m": 40.0, "albedo": 2e-6}, "big", 2e5),
    ahead(FADING, "u", 4e6, -0.1),
    ahead(SPHERE, "dark", 4e6, 0.05, eclipse=True),
    ahead(SPHERE, "out", 4e6, 30.0),
]
SMALL = {
    "epoch": "2019-12-01T08:07:59.25Z",
    "sensor.shape": [16, 24],
    "exposure": {"integration_s": 0.5, "frames": 3},
}


def write_scene(name: str, changes: dict[str, Any] | None = None) -> str:
    """A scene file of changes to the base, or a pinned scene; its name."""
    files = HERE.resolve()
    data = scene_data(name, files) if changes is None else _placed(changed(BASE, changes), files)
    Path(f"{name}.json").write_text(json.dumps(data))
    return f"{name}.json"


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.getbasetemp() / "told-cli"
    if not folder.is_dir():
        folder.mkdir()
        write_files(folder)
    return folder


@cache
def built(app: Any) -> Any:
    """The commands, made once: that takes longer than most of them."""
    return get_command(app)


@pytest.fixture(autouse=True)
def here(files: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the files, and lines of 80 columns."""
    monkeypatch.chdir(files)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("typer.main.get_command", built)
    for name in ("NIGHTGLASS_DATA", "NIGHTGLASS_DEBUG", "NIGHTGLASS_SERVER", "NIGHTGLASS_KEY"):
        monkeypatch.delenv(name, raising=False)
    return files


@pytest.fixture(scope="session")
def rich(files: Path) -> str:
    """A product of all that a scene may have, rendered once; what was printed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(files)
        patch.setenv("COLUMNS", "80")
        patch.setattr(
            "PIL.ImageDraw.ImageDraw.text", lambda self, at, _, fill: self.point(at, fill)
        )
        return ran("render", write_scene("rich", RICH), "-o", "rich", *ONE)


def test_rich_product(rich: str, here: Path) -> None:
    """What a render leaves: files, cube, truth, plan, report."""
    import pyarrow.parquet as pq
    import zarr

    product = Path("rich")
    names = sorted(p.relative_to(product).as_posix() for p in product.rglob("*") if p.is_file())
    told = rich + "".join(f"{name}\n" for name in names if name.count("/") < 2)
    root = zarr.open_group(product / "cube.zarr", mode="r")
    told += "\n".join(leaves({k: v for k, v in root.attrs.items() if k != "scene"})) + "\n"
    for name, one in sorted(root.arrays()):
        m = one.metadata
        told += f"{name}: {one.dtype} {one.shape} {one.chunks} {m.dimension_names} "
        told += masked(
            f"{dict(one.attrs)} {[c.to_dict()['name'] for c in m.codecs]} {m.fill_value!r}\n"
        )
    told += arrays(_cube(product) | _truth(product)) + arrays(_picture(product / "preview.png"))
    for path in sorted(product.glob("truth/*.parquet")):
        file = pq.ParquetFile(path)
        notes = {k: v for k, v in (file.schema_arrow.metadata or {}).items() if b"night" in k}
        told += f"{path.name}: {file.metadata.num_row_groups} row groups, {notes}\n"
        told += "".join(f"  {f.name}: {f.type}\n" for f in file.schema_arrow)
    check_told("cli/product", told, folder=here)
    told = "".join((product / "scene.yaml").read_text().splitlines(keepends=True)[:40])
    for name in ("report.json", "plan.json", ".begun.json"):
        lines = leaves(json.loads((product / name).read_text()))
        twice = ("catalogue.", "layers.", "warnings.", "remarks.", "coverage.", "colour_fit.")
        lines = (x for x in lines if not OF_PLANS.match(x))
        lines = (x for x in lines if name == "report.json" or not x.startswith(twice))
        told += f"{name}\n" + "\n".join(lines) + "\n"
    sealed = json.loads((product / "_COMPLETE").read_text())
    told += f"{sorted(sealed['files'])} {sorted(sealed)} {sealed['format']}\n"
    marker = json.loads((product / "markers/f000000_r000_c001.json").read_text())
    kept = json.loads(marker["marker"])
    for layer, (path, *_) in sorted(kept["chunks"].items()):
        told += f"{layer}: {path} {[cell[:2] for cell in kept['cells'][layer]]}\n"
    told += f"{sorted(kept)} {kept['frame']} {kept['row']} {kept['column']}\n"
    check_told("cli/records", told, folder=here)


def test_exports(rich: str, here: Path) -> None:
    """Every format: files, numbers, labels whole; and what is refused."""
    for name in (*FORMATS, "layers"):
        shutil.rmtree(f"x-{name}", ignore_errors=True)
    for name in ("x.gif", "x.mp4", "one.fits"):
        Path(name).unlink(missing_ok=True)
    told = runs("""
        export rich --to fits -o x-fits --layer mean_e --frame 1
        export rich --to fits -o one.fits --frame 0
        export rich --to png -o x-png
        export rich --to gif -o x.gif --fps 3
        export rich --to mp4 -o x.mp4 --layer targets_e
        export rich --to satnet -o x-satnet --stars-snr 267 --frame 1
        export rich --to coco -o x-coco --stars-snr 267 --threshold 2
        export rich --to masks -o x-masks --stars-snr 200 --layer mean_e
        export rich --to masks --light layers --threshold 9 -o x-layers
    """)
    seen: set[str] = set()
    for path in (
        "x-fits/frame-00001.fits",
        "one.fits",
        "x-layers/frame-00000.fits",
        "x-masks/frame-00000.fits",
        "x-masks/frame-00001.fits",
    ):
        found = {k: v for k, v in _fits(Path(path)).items() if k[2:] not in ("keys", "numbers")}
        told += f"{path}\n{headers(Path(path), seen)}{arrays(found)}"
    for path in ("x-png/frame-00000.png", "x.gif", "x-coco/images/frame-00001.png"):
        told += arrays({path: _picture(Path(path))["pixels"]})
    from PIL import Image

    with Image.open("x.gif") as gif:
        told += f"{gif.n_frames} frames of {gif.info['duration']} ms, loop {gif.info['loop']}\n"
    for path in ("x-satnet/Annotations/pin.0001.json", "x-coco/annotations.json"):
        lines = leaves(json.loads(Path(path).read_text()))
        lines = (x for x in lines if not re.match(r"\w+\.?\w+\.[12467]\.", x))
        told += f"{path}\n" + "\n".join(lines) + "\n"
    check_told("cli/exports", told, folder=here)
    told = runs("""
        export rich --to jpeg -o y
        export rich --to fits -o y --layer e
        export rich --to fits -o y --frame 2
        export rich --to png -o y.png
        export rich --to fits -o one.fits --frame 1
        export rich --to gif -o y.mp4
        export rich --to mp4 -o y
        export rich --to gif -o y.gif --fps 0
        export rich --to gif -o y.gif --fps 101
        export rich --to masks -o y --threshold 0
        export rich --to coco -o y --threshold 1e6
        export rich --to masks -o y --light sun
        export rich --to coco -o x-coco
        export rich --to coco -o y --layer e
        export rich --to satnet -o y --frame 2
        export rich --to satnet -o y --stars-snr -1
        export none --to png -o y
        export stars --to coco -o y
        export rich --to png -o s3://b/n
    """)
    assert {"y", "y.png", "y.gif"}.isdisjoint(p.name for p in here.iterdir() if not p.is_dir())
    shutil.rmtree("y", ignore_errors=True)
    check_told("cli/exports-refused", told, folder=here)


def headers(path: Path, seen: set[str]) -> str:
    """The cards of a FITS file that were not seen before."""
    from astropy.io import fits

    lines: list[str] = []
    with fits.open(path) as hdus:
        for card in (c for hdu in hdus for c in hdu.header.cards):
            tiny = isinstance(card.value, float) and abs(card.value) < 1e-8
            value = "tiny" if tiny else number(card.value)
            lines.append(masked(f"  {card.keyword} = {value} / {card.comment}\n"))
    fresh = [x for x in lines if x not in seen and not re.match("  (CHECK|DATA)SUM", x)]
    seen.update(lines)
    return "".join(fresh)


PAGES = """
plan sphere.json
plan nothing-but-noise.json --explain
plan dwells.json
plan nothing-but-noise.json --json
plan population.json
plan stars-through-air.json
plan plate.json
plan held-to-a-site.json
plan stars.json --set stars.faintest_g_mag=auto
plan stars.json --set pointing.boresight_dec_deg=80
plan stars.json --set pointing.boresight_dec_deg=80 --accept coverage
plan bias-frame.json --accept-error
plan sun.json
plan sun.json --accept sun
plan rough.json
plan rough.json --accept-error
plan none.json
plan .
plan
plan sphere.json --set nothing=3
plan sphere.json --set seed
plan sphere.json --wrong
plan sphere.json --set sensor.shape=[0,4]
plan bad.yaml
plan sphere.json --accept rain
plan sphere.json --server ftp://x
info rich
info rich --json
info stars
info none
color-fit stars.json
color-fit stars.json --json -o fit.json
color-fit stars.json -o fit.json
color-fit sphere.json --set seed=-1
color-fit stars.json --set stars.colour_fit=fit.json
"""


def test_pages(rich: str, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The plan in all its forms, what a product is, colour fits; wide where a path is folded."""
    for name in (
        "sphere",
        "dwells",
        "nothing-but-noise",
        "population",
        "held-to-a-site",
        "stars",
        "bias-frame",
        "stars-through-air",
        "plate",
    ):
        write_scene(name)
    write_scene("sun", {"pointing.boresight_ra_deg": 240.0, "pointing.boresight_dec_deg": -20.0})
    write_scene(
        "rough",
        {
            "stars": {"catalogue": "@stars"},
            "sensor.psf": {"kind": "airy"},
            "accuracy": {"noise_fraction": 1e-6},
        },
    )
    Path("bad.yaml").write_text("sensor: [1\n")
    Path("fit.json").unlink(missing_ok=True)
    told = ""
    with monkeypatch.context() as patch:
        patch.setattr("pipeline.lines.width", lambda: 9999)
        pages = [runs("plan rich.json --all")]
    for page in [*pages, *map(runs, PAGES.strip().splitlines())]:
        lines = page.splitlines(keepends=True)
        told += "".join(lines if len(lines) < 60 else lines[:35] + lines[-5:])
    told += "\n".join(leaves(json.loads(Path("fit.json").read_text())))
    for columns, page in (("40", "info rich"), ("60", "plan sphere.json"), ("130", "info rich")):
        monkeypatch.setenv("COLUMNS", columns)
        told += runs(page)
    check_told("cli/pages", told, folder=here)


def options(command: Any, name: str) -> Iterator[str]:
    """A command, its help and its options, and so its commands."""
    yield f"{name}: {command.help}"
    for p in command.params:
        kind = getattr(p.type_descriptor.annotation, "__name__", "")
        limits = f"{p.min} to {p.max}" if (p.min, p.max) != (None, None) else ""
        words = [w for w in ("required", "multiple", "hidden") if getattr(p, w, False)]
        names = " ".join([*p.opts, *p.secondary_opts])
        about = [kind, limits, *words, f"= {p.default}", p.envvar or "", p.metavar or ""]
        yield f"  {names}: {' '.join(filter(None, about))}: {p.help or ''}"
    for one, inner in sorted(getattr(command, "commands", {}).items()):
        yield from options(inner, f"{name} {one}")


def test_help() -> None:
    from pipeline.cli import app

    check_told("cli/help", "\n".join(options(get_command(app), "nightglass")))


def bent(path: str, change: Callable[[bytes], bytes | None]) -> Callable[[], None]:
    """A change of a file: its content, or None to remove it."""

    def do() -> None:
        new = change(Path("small", path).read_bytes())
        Path("small", path).unlink() if new is None else Path("small", path).write_bytes(new)

    return do


CHUNK, MARKER = "cube.zarr/dn/c/1/0/0", "markers/f000001_r000_c000.json"
DAMAGE: dict[str, tuple[Callable[[], None], ...]] = {
    "a bit of a chunk": (bent(CHUNK, lambda b: b[:-1] + bytes([b[-1] ^ 1])),),
    "a short chunk": (bent(CHUNK, lambda b: b[:-3]),),
    "no chunk, a marker of nothing": (
        bent("cube.zarr/mean_e/c/0/0/0", lambda _: None),
        bent(MARKER, lambda _: b"{}"),
    ),
    "a marker with another sum": (bent(MARKER, lambda b: b.replace(b"frame", b"fname")),),
    "no marker, no preview": (bent(MARKER, lambda _: None), bent("preview.png", lambda _: None)),
    "another report": (bent("report.json", lambda b: b + b" "),),
    "a seal of nothing": (bent("_COMPLETE", lambda _: b"[]"),),
    "no seal, no cube": (
        bent("_COMPLETE", lambda _: None),
        bent("cube.zarr/zarr.json", lambda _: None),
    ),
    "a record of nothing": (bent(".begun.json", lambda _: b"{}"),),
    "no record": (bent(".begun.json", lambda _: None),),
}


def test_damage(here: Path) -> None:
    """Products damaged in each way: checked, looked at, calibrated, gone on with."""
    write_scene("small", SMALL)
    for folder in ("small", "small-calibrated", "small-png"):
        shutil.rmtree(folder, ignore_errors=True)
    told = runs("render small.json -o small --json --scheduler synchronous")
    shutil.rmtree("whole", ignore_errors=True)
    shutil.copytree("small", "whole")
    told += runs("""
        check small
        check small --json
        render small.json -o small
        render small.json -o small --resume
        check none
    """)
    for name, changes in DAMAGE.items():
        for change in changes:
            change()
        told += f"--- {name}\n" + runs("check small")
        if name in ("a bit of a chunk", "another report", "no seal, no cube"):
            told += runs("""
                check small --json
                info small --json
                calibrate small -o small-calibrated
                export small --to png -o small-png
            """)
        if name not in ("a marker with another sum", "another report"):
            told += runs("render small.json -o small --resume --scheduler synchronous")
        for folder in ("small", "small-calibrated", "small-png"):
            shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree("whole", "small")
    check_told("cli/damage", told, folder=here)


REFUSED = """
other
other --resume
other --replace
empty --resume
go/plan.json/x
ftp://host/x
s3://
https://u:p@host/x
s3://b/*
at-none --scheduler none
go --workers 0
go --wait -1
go --part 1/2 --replace
go --part 3/2
go --part 0/2
go --part 1/x
go --server http://h --resume
go --server http://h --part 1/2
go --server http://h
s3://b/n --server http://h
x --set sensor.shape=[100000000,100000000]
x --set epoch=2019-13-01T00:00:00Z
"""


def test_ways_to_go_on(here: Path) -> None:
    """Renders where something is already: another scene, another file, a bare beginning, a lock."""
    import fcntl

    np.save("map.npy", np.full((16, 24), 0.5))
    write_scene("go", SMALL | {"sensor.flat": "@map.npy"})
    for folder in ("go", "other", "empty", "bare"):
        shutil.rmtree(folder, ignore_errors=True)
    resume, again = "render go.json -o go --resume --scheduler synchronous", "render go.json -o"
    told = runs(
        resume,
        f"{again} go --scheduler synchronous",
        f"{resume} --set seed=8",
        f"{resume} --set name=b --set output.compression=none",
        f"{resume} --set output.layers=[dn]",
    )
    np.save("map.npy", np.full((16, 24), 0.6))
    told += runs(resume, f"{again} go --replace --scheduler synchronous", "check go")
    Path("other").mkdir()
    Path("other/mine.txt").write_text("mine")
    Path("empty").mkdir()
    shutil.copytree("go", "bare")
    for name in (
        ".begun.json",
        "_COMPLETE",
        "plan.json",
        "report.json",
        "preview.png",
        "cube.zarr/zarr.json",
    ):
        Path("bare", name).unlink()
    told += runs(f"""
        info bare
        {again} bare --resume
    """)
    shutil.rmtree("bare/markers")
    told += runs(f"""
        {again} bare --resume --json --scheduler synchronous
        check bare
    """)
    told += runs("".join(f"{again} {there}\n" for there in REFUSED.strip().splitlines()))
    with Path("go/.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        told += runs(f"""
            {resume}
            {again} go --replace --wait 0.02
            join go
            {again} go --part 1/2
        """)
    check_told("cli/going-on", told, folder=here)


def test_parts(here: Path) -> None:
    """Parts, joined when all are done; what a join lacks before."""
    stars = {"catalogue": "@stars", "faintest_g_mag": 11.0}
    write_scene("small", SMALL | {"exposure.frames": 5, "stars": stars, "accuracy.check_cells": 0})
    shutil.rmtree("parts", ignore_errors=True)
    part = "render small.json -o parts --scheduler synchronous --part"
    told = runs(f"""
        join parts
        {part} 2/3
        join parts
        {part} 2/3 --json
        {part} 1/4
        join parts
        {part} 2/3 --set seed=8
        info parts
        check parts --json
    """)
    Path("parts/.lock-part-1-of-4").unlink()
    Path("parts/truth/.parts/stars-000001.arrow").write_bytes(b"worse")
    Path("parts/cube.zarr/dn/c/2/0/0").write_bytes(b"worse")
    told += runs(f"""
        join parts small.json
        {part} 1/3
        {part} 2/3
        {part} 3/3
        join parts
        {part} 1/3
        check parts
        join none
    """)
    told += arrays(_cube(Path("parts")) | _truth(Path("parts")))
    check_told("cli/parts", told, folder=here)
