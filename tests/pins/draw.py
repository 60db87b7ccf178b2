"""Draw a pinned scene or sweep: every array that comes out of it, and the numbers of its plan."""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.route.run import Options, render
from pipeline.spec.dotted import changed
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene
from pipeline.spec.sweep_load import parse_sweep
from tests.pins.scenes import AFTERWARDS, BASE, SCENES, SWEEPS

ONE = Options("synchronous")
# What of a plan is no property of the scene: time, memory, bytes, and words.
NOT_PINNED = {
    "predicted", "seconds_saved", "bytes_to_read", "row_groups", "shards", "catalogue", "layers",
    "table_mb",
}  # fmt: skip
# Of a table of points: time, and digests, which hold on one kind of processor only.
NOT_OF_POINTS = ("seconds", "light_s", "content_digest")
NOT_OF_HEADERS = ("CHECKSUM", "DATASUM", "DATE", "CREATOR", "COMMENT", "HISTORY")


@dataclass(frozen=True)
class Drawn:
    """What came out.

    arrays : by name, as `cube/dn` or `truth/stars/x_px`; of a stored pin, `thinned`
    plan : numbers of plan.json by dotted names
    sigma_e : noise of a pixel that holds no source; gain_e_per_dn : typical
    """

    arrays: dict[str, np.ndarray]
    plan: dict[str, Any] = field(default_factory=dict)
    sigma_e: float = 1.0
    gain_e_per_dn: float = 1.0


def scene_data(name: str, files: Path, changes: dict[str, Any] | None = None) -> dict[str, Any]:
    """A pinned scene as plain data, with the paths of its files; `changes` of it are dotted."""
    return _placed(changed(changed(BASE, SCENES[name]), changes or {}), files)


def scene_of(name: str, files: Path = Path("files")) -> Scene:
    return parse_scene(scene_data(name, files))


def sweep_data(name: str, files: Path) -> dict[str, Any]:
    wish = copy.deepcopy(SWEEPS[name])
    scene = scene_data(wish.pop("scene"), files)
    return {"schema": "nightglass/sweep/1", "name": name, "scene": scene} | wish


def _placed(data: Any, files: Path) -> Any:
    """Plain data with `@name` as a path in the folder of files."""
    if isinstance(data, dict):
        return {key: _placed(value, files) for key, value in data.items()}
    if isinstance(data, list):
        return [_placed(value, files) for value in data]
    if isinstance(data, str) and data.startswith("@"):
        return str(files / data[1:])
    return data


def draw(name: str, files: Path, folder: Path) -> Drawn:
    """Draw a pinned scene or sweep in an empty folder, with the files of files.py."""
    with embedded_spectra():
        if name in SWEEPS:
            return _swept(name, files, folder)
        return _rendered(name, files, folder)


@contextmanager
def embedded_spectra() -> Iterator[None]:
    """The spectra that come with the product, whatever library this machine has."""
    kept = os.environ.pop("NIGHTGLASS_DATA", None)
    try:
        yield
    finally:
        if kept is not None:
            os.environ["NIGHTGLASS_DATA"] = kept


def _rendered(name: str, files: Path, folder: Path) -> Drawn:
    scene, product = scene_of(name, files), folder / "product"
    render(scene, product, ONE)
    arrays = {f"cube/{k}": v for k, v in _cube(product).items()}
    arrays |= {f"truth/{k}": v for k, v in _truth(product).items()}
    for kind in AFTERWARDS.get(name, ()):
        found = _calibrated(product, folder) if kind == "calibrated" else _exported(product, kind)
        arrays |= {f"{kind}/{k}": v for k, v in found.items()}
    plan = json.loads((product / "plan.json").read_text())
    gain = scene.sensor.gain_e_per_dn
    return Drawn(
        arrays, plan_numbers(plan), float(plan["noise_floor_e"]),
        gain if isinstance(gain, float) else 1.0,
    )  # fmt: skip


def _cube(product: Path) -> dict[str, np.ndarray]:
    """Every layer and coordinate of a cube; times as whole nanoseconds."""
    from pipeline.store.cube import open_cube

    cube = open_cube(product)
    found = {str(n): np.asarray(cube[n].values) for n in sorted(map(str, cube.variables))}
    return {n: v.astype(np.int64) if v.dtype.kind in "mM" else v for n, v in found.items()}


def _truth(product: Path) -> dict[str, np.ndarray]:
    import pyarrow.parquet as pq

    out: dict[str, np.ndarray] = {}
    for path in sorted((product / "truth").glob("*.parquet")):
        out |= {f"{path.stem}/{k}": v for k, v in _columns(pq.read_table(path)).items()}
    return out


def _columns(table: Any) -> dict[str, np.ndarray]:
    """Columns of an Arrow table as arrays; text, and what is a list, as text."""
    out = {}
    for name in table.column_names:
        values = table[name].to_numpy()
        out[name] = np.array([str(v) for v in values]) if values.dtype == object else values
    return out


def _calibrated(product: Path, folder: Path) -> dict[str, np.ndarray]:
    from pipeline.calibrate import calibrate

    calibrate(product, folder / "calibrated")
    return {"calibrated_e": _cube(folder / "calibrated")["calibrated_e"]}


def _exported(product: Path, kind: str) -> dict[str, np.ndarray]:
    """Every number in the files of an export."""
    from pipeline.export.formats import ExportRequest, export_product

    out: dict[str, np.ndarray] = {}
    target = product.with_name(f"{kind}.gif" if kind == "gif" else kind)
    for path in export_product(product, kind, target, ExportRequest(stars_snr=5.0)):
        read = {".fits": _fits, ".json": _json}.get(path.suffix, _picture)
        out |= {f"{path.name}/{k}": v for k, v in read(path).items()}
    return out


def _fits(path: Path) -> dict[str, np.ndarray]:
    from astropy.io import fits

    out: dict[str, np.ndarray] = {}
    with fits.open(path) as hdus:
        for i, hdu in enumerate(hdus):
            cards = [c for c in hdu.header.cards if c.keyword not in NOT_OF_HEADERS]
            numbers = [c for c in cards if isinstance(c.value, float | int)]
            out[f"{i}/keys"] = np.array([c.keyword for c in numbers])
            out[f"{i}/numbers"] = np.array([float(c.value) for c in numbers])
            if hdu.data is None:
                continue
            if hdu.data.dtype.names is None:
                out[f"{i}/data"] = np.array(hdu.data, hdu.data.dtype.newbyteorder("="))
                continue
            for name in hdu.data.dtype.names:
                values = np.asarray(hdu.data[name])
                out[f"{i}/{name}"] = values.astype(values.dtype.newbyteorder("="))
    return out


def _json(path: Path) -> dict[str, np.ndarray]:
    found = dict(_leaves(json.loads(path.read_text())))
    numbers = {k: v for k, v in found.items() if isinstance(v, float | int)}
    return {
        "keys": np.array([*numbers] or [""]),
        "numbers": np.array([*map(float, numbers.values())]),
    }


def _picture(path: Path) -> dict[str, np.ndarray]:
    from PIL import Image

    with Image.open(path) as image:
        count, frames = getattr(image, "n_frames", 1), []
        for k in range(count):
            image.seek(k)
            frames.append(np.asarray(image if image.mode != "P" else image.convert("RGB")))
    return {"pixels": np.stack(frames)}


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Plain values of nested data by dotted names."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, one in items:
            yield from _leaves(one, f"{name}.{key}" if name else str(key))
    else:
        yield name, value


def plan_numbers(plan: dict[str, Any]) -> dict[str, Any]:
    """Numbers of a plan: facts, bounds, classes; of each decision whether it is kept."""
    told = {key: value for key, value in plan.items() if key not in NOT_PINNED}
    decisions: dict[str, Any] = {}
    for one in told.pop("decisions"):
        name, n = one["component"].replace(".", "/"), 1
        while name in decisions:
            n += 1
            name = f"{one['component'].replace('.', '/')}#{n}"
        decisions[name] = {k: v for k, v in one.items() if k not in NOT_PINNED and v is not None}
    told["decisions"] = decisions
    return {k: v for k, v in _leaves(told) if isinstance(v, bool | int | float)}


def _swept(name: str, files: Path, folder: Path) -> Drawn:
    """A sweep's table of points, and the frames that it keeps."""
    import pyarrow.parquet as pq

    from pipeline.sweep.run import sweep

    data = sweep_data(name, files)
    parse_sweep(data)
    path, out = folder / "sweep.json", folder / "swept"
    path.write_text(json.dumps(data))
    sweep(path, out, ONE)
    table = _columns(pq.read_table(out / "points.parquet"))
    arrays = {f"points/{k}": v for k, v in table.items() if k not in NOT_OF_POINTS}
    for kept in sorted(out.glob("cubes/*")):
        arrays[f"cubes/{kept.name}/dn"] = _cube(kept)["dn"]
    return Drawn(arrays)
