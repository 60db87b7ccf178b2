"""Files that are read: each accepted form by its numbers, each bad file by its refusal.

The stored texts ask, in lines of Python, and hold what came, further in, under each line.
"""

from __future__ import annotations

import gzip
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from astropy.io import fits
from astropy.table import Table
from pydantic import TypeAdapter

import pipeline.inputs
from catalog_tools.coverage import of_pixels
from pipeline.errors import NightglassError
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.spec.dotted import changed
from pipeline.spec.load import InvalidScene, parse_scene
from pipeline.spec.targets.mesh import MeshBody, Reflecting
from tests.pins import files
from tests.pins.scenes import AT_FIELD, BASE, IN_ORBIT, SITE, SPHERE
from tests.pins.told import TOLD, check_told

MANY, BRIEF, DIGITS = 8, 40, 9
NOISE, ROUNDING = 1e-12, 1e-15  # of the largest of an array: what is 0, the finest digit told
NOT_TOLD = ("digest", "sha256")  # of numbers, whose last bits are another processor's
REFUSALS = (NightglassError, InvalidScene, ValueError, AssertionError)
# What other packages say of a file is theirs.
DEFINES = re.compile(r"\((\w+ := |monkeypatch).*\)")
OURS = r"(?!\w* ?\.\w+ table; (?:it |row |an array))"
THEIRS = re.compile(rf"(readable {OURS}[^;\n]*; |triangles; |or XML; |Pickles library \().*")


class Told(str):
    """What is told already, in lines."""


def shown(value: Any, pad: str = "    ") -> str:
    """A value in words and numbers: arrays by their sums and some of their values."""
    if is_dataclass(value) and not isinstance(value, type):
        return shown({f.name: getattr(value, f.name) for f in fields(value)}, pad)
    if isinstance(value, partial):
        return value.func.__name__ + shown(value.keywords, pad)
    if isinstance(value, Mapping):
        every = sorted(((str(k), v) for k, v in value.items()), key=lambda pair: pair[0])
        told = [f"{k}: {shown(v, pad + '  ')}" for k, v in every if k not in NOT_TOLD]
        brief = ", ".join(one for one in told if len(one) <= BRIEF)
        lines = ([brief] if brief else []) + [one for one in told if len(one) > BRIEF]
        return "".join(f"\n{pad}{one}" for one in lines) or "{}"
    if isinstance(value, list | tuple):
        leaves = [*_leaves(value)]
        if leaves and all(type(v) in (int, float) for v in leaves):
            with suppress(ValueError):
                return shown(np.array(value))
        return "(" + ", ".join(shown(v, pad + "  ") for v in value) + ")"
    if isinstance(value, np.ndarray) and value.ndim:
        return _array(value)
    if isinstance(value, complex | np.complexfloating):
        return f"{value.real:.{DIGITS}g} + {value.imag:.{DIGITS}g}i"
    if isinstance(value, float | np.floating | np.ndarray):
        return f"{float(value):.{DIGITS}g}"
    if isinstance(value, str) and not isinstance(value, Told) and "\n" in value:
        return repr(value[:BRIEF])
    plain = value is None or isinstance(value, bool | int | str | Path | np.generic)
    return str(value) if plain else getattr(value, "__name__", type(value).__name__)


def _leaves(value: list[Any] | tuple[Any, ...]) -> Iterator[Any]:
    for one in value:
        yield from _leaves(one) if isinstance(one, list | tuple) else (one,)


def _array(a: np.ndarray, of: np.ndarray | None = None) -> str:
    """An array in numbers, none finer than what rounding leaves of the largest; of : the sizes of
    complex numbers of which it is a part."""
    if a.dtype.kind not in "biufc":
        return f"{a.shape} {a.ravel()[:MANY].tolist()}"
    if a.dtype.kind == "c":
        return f"{_array(a.real, np.abs(a))} + i {_array(a.imag, np.abs(a))}"
    a = a.astype(float)
    known = np.where(np.isfinite(a), a, 0.0)
    size = np.abs(known)
    whole = size if of is None else np.where(np.isfinite(of), of, 0.0)
    largest = float(whole.max(initial=0.0))
    known[size < NOISE * largest] = 0.0
    size = np.abs(known)
    every = np.where(np.isfinite(a), known, a).ravel().tolist()
    numbers = [_number(v, ROUNDING * largest) for v in every]
    if a.size <= MANY:
        return f"{a.shape if a.ndim > 1 else ''}[{', '.join(numbers)}]"
    total = max(float(size.sum()), 1e-300)
    middle = ", ".join(
        f"{(np.indices(a.shape)[k] * size).sum() / total:.7g}" for k in range(a.ndim)
    )
    signed = known.sum() if abs(known.sum()) > 1e-9 * total else 0.0
    words = f"sum {signed:.{DIGITS}g}, rms {np.sqrt(np.mean(known**2)):.{DIGITS}g}, at {middle}"
    lost = f", {(~np.isfinite(a)).sum()} not finite" if not np.isfinite(a).all() else ""
    return f"{a.shape} {words}{lost}: {', '.join(numbers[k * (a.size - 1) // 3] for k in range(4))}"


def _number(v: float, least: float) -> str:
    """A number of up to DIGITS digits, none of them below `least`."""
    if not (np.isfinite(v) and v and least):
        return f"{v:.{DIGITS}g}"
    above = math.floor(math.log10(abs(v))) - math.floor(math.log10(least))
    return f"{v:.{min(DIGITS, max(1, above))}g}"


def told_of(task: Callable[[], Any], pad: str) -> str:
    """What a task gives, or the refusal it ends with."""
    try:
        found = shown(task(), pad)
    except REFUSALS as error:
        said = f"{type(error).__name__}: {error}".removeprefix("BadInput: ")
        found = said.replace(" is not accepted; allowed: ", " - ").replace("\n", f"\n{pad}")
    return THEIRS.sub(r"\1...", found)


def every(function: Callable[..., Any], *inputs: Any) -> Told:
    """What a function of one input gives for each, or refuses it with, a line for each."""
    each = [told_of(partial(function, one), " " * 8) for one in inputs]
    return Told("".join(f"\n      {k}: {found}" for k, found in enumerate(each, 1)))


def answered(name: str, asked: int, names: dict[str, Any], noise: float = 0.0) -> None:
    """Hold each line of Python of a stored text against what stands under it, what it gives.

    A line that only gives values to names, in brackets, has no answer. A new case is a new line of
    the text, made with `make pins`; what stands further in is not asked.
    """
    stored = (TOLD / f"{name}.txt").read_text().splitlines()
    lines = [line for line in stored if line and not line[0].isspace()]
    assert len(lines) == asked
    out = []
    for line in lines:
        if DEFINES.fullmatch(line):
            eval(line, names)
            out.append(line)
            continue
        found = told_of(partial(eval, line, names), " " * 4)
        out.append(line + ("" if found.startswith("\n") else "\n    ") + found)
    check_told(name, "\n".join(out), noise=noise)


def put(name: str, content: Any) -> Path:
    """A file of text, bytes, an array (.npy, .fits), columns (.fits, .parquet), or JSON."""
    path = Path(name)
    if isinstance(content, str):
        path.write_text(content, encoding="utf-8")
    elif isinstance(content, bytes):
        path.write_bytes(content)
    elif path.suffix == ".npy":
        np.save(path, content)
    elif path.suffix == ".parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table(content), path)
    elif path.suffix == ".fits" and isinstance(content, Mapping):
        Table(dict(content)).write(path, overwrite=True)
    elif path.suffix == ".fits":
        fits.writeto(path, content, overwrite=True)
    else:
        path.write_text(json.dumps(content))
    return path


def rays(name: str = "COSMIC_RAYS", drop: str = "", **other: Any) -> Path:
    """A library of three events: one over two rows, one of a single pixel, one beyond."""
    spans = np.empty(4, dtype=object)
    charges = ([10, 20], other.get("charge", [5]), [7, 8, 9], [1])
    spans[:] = [np.array(s, np.float32) for s in charges]
    columns = {"fp_id": [3, 3, 9, 4], "x0": [2, 3, 0, 6], "y0": [1, 2, 4, 5], "frame": [0, 0, 2, 1]}
    columns |= {k: v for k, v in other.items() if k in columns}
    made = [fits.Column(k, "J", array=np.array(v)) for k, v in columns.items() if k != drop]
    if drop != "pixel_values":
        made.append(fits.Column("pixel_values", "PE()", array=spans))
    table = fits.BinTableHDU.from_columns(made, name=name)
    keys = {"EXPTIME": 30.0, "NUM_PIX": 64, "ROWS": 8, "COLUMNS": 8, "FRAMES": 3, "PITCH_UM": 12.0}
    keys |= {k: v for k, v in other.items() if k.isupper()}
    table.header.update({k: v for k, v in keys.items() if v is not None})
    fits.HDUList([fits.PrimaryHDU(), table]).writeto("rays.fits", overwrite=True)
    return Path("rays.fits")


def light(side: int, row: float, column: float) -> np.ndarray:
    """A lopsided spot of light."""
    y, x = np.arange(side) - row, np.arange(side) - column
    return np.exp(-0.05 * (y[:, None] ** 2 + (x[None, :] + 0.3 * y[:, None]) ** 2))


def listing(kind: str = "FFT", unit: str = "µm", values: str = "not normalized") -> str:
    """An optical design program's listing of a spot."""
    rows = "\n".join("\t".join(f"{v:.3E}" for v in row) for row in light(3, 2.0, 1.0))
    place = "row 3, column 2" if kind == "FFT" else "3, 2"
    return (
        f"Listing of {kind} PSF Data\n\nFile : a.zmx\nData spacing is 2.5 {unit}.\n"
        f"Image grid size: 3 by 3\nCenter point is: {place}\nValues are {values}.\n\n{rows}\n"
    )


def header(**cards: Any) -> str:
    """A FITS header as text: TAN with what is given."""
    base = {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRPIX1": 20.5, "CRPIX2": -3.25}
    return fits.Header(base | cards).tostring(sep="\n") + "\nEND     \n"


def scene(**wish: Any) -> Any:
    """The pins' base scene with dotted changes, `__` for a dot."""
    return parse_scene(changed(BASE, {k.replace("__", "."): v for k, v in wish.items()}))


KNOWN = (every, put, rays, light, listing, header, scene, np, gzip, json, Path, files, fits, zarr)
KNOWN += (of_pixels, replace, TypeAdapter, MeshBody, plan_geometry)


@pytest.fixture
def names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What a line may use: what makes files, and constants; its folder is empty."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NIGHTGLASS_DATA", raising=False)
    known = {one.__name__.rpartition(".")[2]: one for one in KNOWN} | {"np": np}
    known |= {"AT": AT_FIELD, "SITE": SITE, "ORBIT": IN_ORBIT, "SPHERE": SPHERE}
    return known | {"monkeypatch": monkeypatch, "Reflecting": Reflecting}


# How many lines each stored text asks: one that is lost is a fault.
ASKED = {
    "curves": 17,
    "spectra": 12,
    "psf_tables": 29,
    "colour_fits": 20,
    "cosmic_rays": 20,
    "detector": 11,
    "distortion": 9,
    "earth_orientation": 6,
    "ephemerides": 28,
    "omm": 10,
    "populations": 16,
    "meshes": 23,
    "surfaces": 7,
    "pointing": 20,
    "images": 10,
    "stray_light": 8,
    "sky": 12,
    "catalogues": 21,
}


@pytest.mark.parametrize("group", ASKED)
def test_read_as_pinned(group: str, names: dict[str, Any]) -> None:
    root = Path(pipeline.inputs.__path__[0])
    for path in sorted(root.glob("*.py")) + sorted(root.glob("[!r]*/[!_]*.py")):
        name = ".".join(path.relative_to(root).with_suffix("").parts)
        names[path.stem] = import_module(f"pipeline.inputs.{name}")
    answered(f"inputs/{group}", ASKED[group], names)
