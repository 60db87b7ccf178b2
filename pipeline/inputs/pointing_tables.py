"""Tables of attitudes and of jitter spectra from files: CSV, FITS, NPY and Parquet."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.inputs.npy import read_npy
from pipeline.lazily import arrow, fits
from pipeline.physics.constants import ARCSEC_RAD
from pipeline.physics.motion.attitude_table import table_error_rad
from pipeline.physics.positions.times import elapsed_s, parse_utc
from pipeline.plan.pointing.pointing import check_rows, pointing_field, quaternion_table
from pipeline.plan.timing import DwellPlan, dwell_plans, last_row_late_s
from pipeline.spec.load import parse_scene
from pipeline.spec.pointing.attitude import MOST_POINTS, TableJitter
from pipeline.spec.pointing.pointing import MOST_ROWS, TablePointing
from pipeline.spec.scene import Scene

LARGEST_BYTES = 500_000_000
SPARE_ROWS = 8  # on either side of the exposures
NAMED = ("qx", "qy", "qz", "qw")
NUMBERED = (("q1", "q2", "q3", "q4"), ("q0", "q1", "q2", "q3"))
USED = ("time_s", "time_utc", *NAMED, "q0", *NUMBERED[0], "frequency_hz", "arcsec2_per_hz")
Columns = list[tuple[str, object]]  # of a file, by their names
COLUMNS = "time_s or time_utc, then qx, qy, qz, qw (or q1 to q4, or q0 to q3, with `scalar`)"


def gather_pointing(scene: Scene) -> Scene:
    """The scene with its tables of attitudes and spectra written out.

    Of attitudes the rows around the exposures are kept, as seconds after the scene's epoch, with
    the error measured on left-out rows. A scene without tables comes back as it is. BadInput where
    a file cannot be used or does not cover the exposures.
    """
    spectra = _spectra(scene)
    plans = [(p, p.pointing) for p in dwell_plans(scene) if isinstance(p.pointing, TablePointing)]
    if not plans and not spectra:
        return scene
    data, read = scene.as_dict(), dict[Path, JsonObject]()
    dwells = dwell_plans(scene)
    for plan, pointing in plans:
        own = plan.dwell is not None and plan.dwell.pointing is not None
        holder = data["dwells"][plan.index] if own else data
        whole = not own and scene.dwells is not None
        span = (0.0, dwells[-1].end_s) if whole else _asked_s(plan, dwells[plan.index + 1 :])
        late = span[0], span[1] + last_row_late_s(scene)
        holder["pointing"] |= _table(scene, plan, pointing, late, read)
    for i, path in spectra.items():
        name = f"pointing.attitude.jitter.{i}.path"
        data["pointing"]["attitude"]["jitter"][i] |= _spectrum(Path(path), name)
    return parse_scene(data)


def _asked_s(plan: DwellPlan, later: Sequence[DwellPlan]) -> tuple[float, float]:
    """The times at which a dwell's own table is asked: from the slew to it until its exposures end,
    and while frames of the next dwell fall into the slew from it."""
    begin = plan.start_s if plan.slew_s is None else plan.slew_s[0]
    after = next(iter(later), None)
    if after is None or after.slew_s is None:
        return begin, plan.end_s
    return begin, max(plan.end_s, min(after.slew_s[1], after.end_s))


def _spectra(scene: Scene) -> dict[int, str]:
    """The files of spectra by the number of their part of the jitter."""
    model = scene.pointing.attitude
    tables = () if model is None else enumerate(model.jitter)
    return {i: p.path for i, p in tables if isinstance(p, TableJitter) and p.path is not None}


def _table(
    scene: Scene,
    plan: DwellPlan,
    p: TablePointing,
    span_s: tuple[float, float],
    read: dict[Path, JsonObject],
) -> JsonObject:
    """What a pointing's table becomes: rows in the scene, and the error between them."""
    begin, end = span_s
    field = pointing_field(plan, "rows" if p.path is None else "path")
    made: dict[str, object] = {}
    if p.path is not None:
        made = _kept(scene, plan, p, (begin, end), read)
        p = TablePointing.model_validate(p.model_dump() | made)
    table = quaternion_table(p, field)
    shift = 0.0
    if p.epoch is not None:
        shift = float(elapsed_s(parse_utc(p.epoch), *parse_utc(scene.epoch)))
    used = (table.time_s >= begin + shift) & (table.time_s <= end + shift)
    used[1:] |= used[:-1]
    used[:-1] |= used[1:]
    error = table_error_rad(table, used)
    return made | {"error_arcsec": None if error is None else error / ARCSEC_RAD}


def _kept(
    scene: Scene,
    plan: DwellPlan,
    p: TablePointing,
    span_s: tuple[float, float],
    read: dict[Path, JsonObject],
) -> JsonObject:
    """The rows of a pointing's file that are kept, as the scene holds them."""
    field, path = pointing_field(plan, "path"), Path(str(p.path))
    if path not in read:
        read[path] = _read(path, field)
    rows, scalar = _rows(read[path], p, scene.epoch, path, field)
    check_rows(rows, field)
    begin, end = np.searchsorted(rows[:, 0], span_s).tolist()
    kept = rows[max(begin - SPARE_ROWS, 0) : end + SPARE_ROWS]
    if rows[0, 0] > plan.start_s or rows[-1, 0] < plan.end_s:
        raise BadInput(
            field,
            f"{path.name} from {rows[0, 0]:.6g} to {rows[-1, 0]:.6g} s after the epoch",
            f"rows over all exposures, {plan.start_s:.6g} to {plan.end_s:.6g} s after it",
        )
    if len(kept) > MOST_ROWS:
        allowed = f"at most {MOST_ROWS} rows around the exposures"
        raise BadInput(field, f"{len(kept)} rows of {path.name}", allowed)
    mounting = p.mounting
    if mounting is not None and (p.scalar, scalar) == ("first", "last"):  # by the file's names
        mounting = (*mounting[1:], mounting[0])
    return {
        "path": None,
        "rows": kept.tolist(),
        "scalar": scalar,
        "mounting": mounting,
        "epoch": None,
        "source": path.name[:200],
    }


def _rows(
    columns: JsonObject, p: TablePointing, epoch: str, path: Path, field: str
) -> tuple[Array, str]:
    """Rows (n, 5) of seconds after the scene's epoch and quaternion, and where the scalar is."""
    times = [name for name in columns if name in ("time_s", "time_utc")]
    names = next((n for n in (NAMED, *NUMBERED) if all(k in columns for k in n)), None)
    if len(times) != 1 or names is None:
        value = f"columns {', '.join(columns)} of {path.name}"
        raise BadInput(field, value[:200], f"columns {COLUMNS}")
    scalar = "last" if names == NAMED else p.scalar
    if scalar is None:
        name = field.rsplit(".", 1)[0] + ".scalar"
        raise BadInput(name, None, f"first or last: {path.name} numbers its columns")
    q = np.stack([_floats(columns[k], path, field) for k in names], axis=-1)
    seconds = _seconds(columns, p, epoch, path, field)
    if len(seconds) < 2:
        raise BadInput(field, f"{len(seconds)} rows in {path.name}", "two rows or more")
    return np.column_stack([seconds, q]), scalar


def _seconds(columns: JsonObject, p: TablePointing, epoch: str, path: Path, field: str) -> Array:
    """Times (n,) of rows, in seconds after the scene's epoch."""
    zero = parse_utc(epoch)
    if "time_s" not in columns:
        utc = np.array([_utc(t, path, field) for t in columns["time_utc"]])
        return elapsed_s(zero, utc[:, 0], utc[:, 1])
    seconds = _floats(columns["time_s"], path, field)
    if p.epoch is None:
        return seconds
    name = field.rsplit(".", 1)[0] + ".epoch"
    return seconds - float(elapsed_s(parse_utc(p.epoch, name), *zero))


def _utc(value: object, path: Path, field: str) -> tuple[float, float]:
    text = value.decode() if isinstance(value, bytes) else str(value)
    try:
        return parse_utc(text.strip().replace(" ", "T", 1), field)
    except BadInput as error:
        raise BadInput(field, f"time {text[:40]!r} in {path.name}", error.allowed) from None


def _floats(values: object, path: Path, field: str) -> Array:
    try:
        numbers = np.asarray(values, dtype=np.float64)
        if numbers.ndim != 1:
            raise ValueError(f"each row holds {numbers.shape[1:]}")
        return numbers
    except (ValueError, TypeError) as error:
        raise BadInput(field, path.name, f"numbers in every column; {error}"[:200]) from None


def _read(path: Path, field: str) -> JsonObject:
    """The columns of a file by their names in lower case."""
    if not path.is_file():
        raise BadInput(field, str(path), "an existing file: .csv, .fits, .npy or .parquet")
    if path.stat().st_size > LARGEST_BYTES:
        raise BadInput(field, path.name, f"a file of at most {LARGEST_BYTES} bytes")
    kinds = {
        ".csv": _csv,
        ".txt": _csv,
        ".npy": _npy,
        ".parquet": _parquet,
        ".fits": _fits,
        ".fit": _fits,
    }
    kind = kinds.get(path.suffix.lower())
    if kind is None:
        raise BadInput(field, path.name, "a file that ends in .csv, .fits, .npy or .parquet")
    try:
        found = kind(path)
    except Exception as error:
        reason = " ".join(str(error).split())[:120]
        raise BadInput(field, path.name, f"a readable {path.suffix} table; {reason}") from None
    names = [str(name).strip().lower() for name, _ in found]
    if twice := [name for name in USED if names.count(name) > 1]:
        raise BadInput(field, f"{twice[0]} twice in {path.name}", "each column once")
    return dict(zip(names, (values for _, values in found), strict=True))


def _csv(path: Path) -> Columns:
    with path.open(newline="", encoding="utf-8-sig") as lines:
        rows = [r for r in csv.reader(lines) if r and not r[0].lstrip().startswith("#")]
    if not rows:
        raise ValueError("it is empty")
    head, body = rows[0], rows[1:]
    uneven = next((k for k, r in enumerate(body) if len(r) != len(head)), None)
    if uneven is not None:
        raise ValueError(f"row {uneven + 1} has {len(body[uneven])} values, not {len(head)}")
    return [(name, [r[i] for r in body]) for i, name in enumerate(head)]


def _npy(path: Path) -> Columns:
    """A structured array by its field names, or (n, 5): time_s and four numbers."""
    array = read_npy(path)
    if array.dtype.names:
        return [(name, array[name]) for name in array.dtype.names]
    if array.ndim != 2 or array.shape[1] != 5:
        raise ValueError(f"an array of shape {array.shape}; (n, 5) is time_s and the quaternion")
    return list(zip(("time_s", "q1", "q2", "q3", "q4"), array.T, strict=True))


def _parquet(path: Path) -> Columns:
    table = arrow().parquet.read_table(path.absolute())
    return [(name, table[name].to_pylist()) for name in table.column_names]


def _fits(path: Path) -> Columns:
    with fits().open(path) as units:
        table = next((u for u in units if isinstance(u, fits().BinTableHDU)), None)
        if table is None:
            raise ValueError("it holds no binary table")
        return [(name, np.array(table.data[name])) for name in table.columns.names]


def _spectrum(path: Path, field: str) -> JsonObject:
    """A spectrum's columns: frequency_hz and arcsec2_per_hz."""
    columns = _read(path, field)
    names = ("frequency_hz", "arcsec2_per_hz")
    if any(n not in columns for n in names):
        value = f"columns {', '.join(columns)} of {path.name}"
        raise BadInput(field, value[:200], f"columns {' and '.join(names)}")
    f, s = (_floats(columns[n], path, field) for n in names)
    if not 2 <= len(f) <= MOST_POINTS:
        raise BadInput(field, f"{len(f)} rows of {path.name}", f"2 to {MOST_POINTS} rows")
    if not (np.isfinite(f).all() and np.isfinite(s).all() and (s >= 0).all() and (f > 0).all()):
        raise BadInput(field, path.name, "finite frequencies above 0 and densities of 0 or more")
    if (np.diff(f) <= 0).any():
        k = int(np.argmax(np.diff(f) <= 0)) + 1
        raise BadInput(field, f"row {k + 1} of {path.name}", "increasing frequencies")
    return {"path": None, "frequency_hz": f.tolist(), "arcsec2_per_hz": s.tolist()}
