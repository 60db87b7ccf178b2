"""What a sweep leaves on disk: parts while it runs, one table of points at its end."""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject, JsonValue
from catalog_tools.engine.code import code_digest
from catalog_tools.storage.durable import file_digest, whole_file, write_atomically
from pipeline.errors import NO_ROOM, BadInput, Damaged
from pipeline.spec.sweep import Sweep
from pipeline.sweep.design import Design

FORMAT = "nightglass/sweep-product/1"
BEGUN, PARTS, TABLE, COMPLETE = ".begun.json", "parts", "points.parquet", "_COMPLETE"
SWEEP, REPORT, PAGE, FIGURE = "sweep.json", "report.json", "summary.html", "summary.svg"
PART_ROWS, PART_S = 1024, 5.0
JOIN_POINTS = 65_536
OPTIONS: JsonObject = {
    "compression": "zstd",
    "compression_level": 3,
    "write_page_checksum": True,
}
TEXT = ("status", "message", "content_digest")
WHOLE = ("point", "seed")


def schema_of(sweep: Sweep, names: tuple[str, ...]) -> pa.Schema:
    """The columns of the table of points. names : of the targets whose metrics are told."""
    columns: list[tuple[str, pa.DataType]] = [("point", pa.int64()), ("seed", pa.int64())]
    columns += [(name, kind) for name, kind in kinds_of(Design(sweep)).items() if name != "seed"]
    columns += [("status", pa.string()), ("message", pa.string())]
    columns += [("content_digest", pa.string())]
    told = {
        "background": ("background_e", "sky_e", "noise_floor_e"),
        "limiting_magnitude": ("limiting_light_e", "limiting_g_mag"),
        "saturation": ("saturated_fraction",),
        "timing": ("seconds", "light_s", "error_bound_sigma", "achieved_error_sigma"),
    }
    columns += [(c, pa.float64()) for m, cs in told.items() if m in sweep.metrics for c in cs]
    of_target = {
        "snr": ("snr",),
        "detection": ("peak_sigma", "frames_in_view", "detected_fraction"),
    }
    for name in names:
        for metric, stems in of_target.items():
            if metric in sweep.metrics:
                columns += [(f"{stem}.{name}", pa.float64()) for stem in stems]
    return pa.schema(columns)


def kinds_of(design: Design) -> dict[str, pa.DataType]:
    """The columns' types of the fields that the axes vary."""
    names = (name for axis in design.axes for name in axis.fields)
    return {name: _type_of(design.extremes(name)) for name in names}


def _type_of(values: list[object]) -> pa.DataType:
    """A column's type: numbers, true and false, or text (JSON where the values are mixed)."""
    kinds = {type(v) for v in values if v is not None}
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int}:
        return pa.int64()
    return pa.float64() if kinds and kinds <= {int, float} else pa.string()


class PointLedger:
    """Rows of points that are done, in parts that are there whole or not at all."""

    def __init__(self, out: Path, schema: pa.Schema, size: int) -> None:
        self.out, self.schema, self.size = out, schema, size
        self.done = np.zeros(size, bool)
        self.failed = np.zeros(size, bool)
        self.removed: list[str] = []
        self._rows: list[JsonObject] = []
        self._since = time.monotonic()
        self._next = 0

    def take_up(self, retry_failed: bool) -> None:
        """Learn what is done from the parts; a damaged one is removed, its points done again."""
        for path in self._parts():
            self._next = max(self._next, int(path.stem.split("-")[1]) + 1)
            try:
                table = pq.read_table(  # to Arrow a relative `a:b` is a kind of URL
                    path.absolute(), columns=["point", "status"], page_checksum_verification=True
                )
                point, failed = table["point"].to_numpy(), table["status"].to_numpy() == "failed"
                if point.size and not (point.min() >= 0 and point.max() < self.size):
                    raise ValueError("points that the sweep does not have")
            except MemoryError:
                raise  # of Arrow, too: no damage
            except (pa.ArrowException, OSError, ValueError, KeyError) as error:
                told = str(error).splitlines()[0].replace(str(path.absolute()), str(path))
                self.removed.append(f"{path.name}: {told[:200]}")
                path.unlink()
                continue
            self.done[point] = True
            self.failed[point] = failed
        if retry_failed:
            self.done &= ~self.failed
            self.failed[:] = False

    def add(self, rows: list[JsonObject]) -> None:
        """Rows of finished points; they are durable within PART_S, or with `flush`."""
        self._rows += rows
        for row in rows:
            self.done[row["point"]] = True
            self.failed[row["point"]] = row["status"] == "failed"
        if len(self._rows) >= PART_ROWS or time.monotonic() - self._since >= PART_S:
            self.flush()

    def flush(self) -> None:
        """Make all rows durable."""
        self._since = time.monotonic()
        if not self._rows:
            return
        rows = [{f.name: fit(row.get(f.name), f.type) for f in self.schema} for row in self._rows]
        folder = self.out / PARTS
        with whole_file(folder / f"part-{self._next:07d}.parquet") as own:
            pq.write_table(pa.Table.from_pylist(rows, self.schema), own, **OPTIONS)
        self._next += 1
        self._rows = []

    def join(self) -> None:
        """Join the parts into the table of points, in order, a bounded number of them at a time.

        Where a point stands in several parts the newest counts.
        """
        parts = self._parts()
        spans = [_span(path) for path in parts]
        with (
            whole_file(self.out / TABLE) as own,
            pq.ParquetWriter(own, self.schema, **OPTIONS) as writer,
        ):
            for first in range(0, self.size, JOIN_POINTS):
                end = min(first + JOIN_POINTS, self.size)
                near = [
                    str(path.absolute())
                    for path, (low, high) in zip(parts, spans, strict=True)
                    if low < end and high >= first
                ]
                inside = (ds.field("point") >= first) & (ds.field("point") < end)
                table = ds.dataset(near, schema=self.schema).to_table(filter=inside)
                points = table["point"].to_numpy()
                _, newest = np.unique(points[::-1], return_index=True)
                writer.write_table(table.take(pa.array(points.size - 1 - newest)))

    def drop_parts(self) -> None:
        """Remove the parts once the table stands and is sealed."""
        for path in self._parts():
            path.unlink()

    def _parts(self) -> list[Path]:
        return sorted((self.out / PARTS).glob("part-*.parquet"))


def _span(path: Path) -> tuple[int, int]:
    """The least and largest number of a point in a part."""
    table = pq.read_table(path.absolute(), columns=["point"])
    column: NDArray[np.int64] = table["point"].to_numpy()
    return int(column.min()), int(column.max())


def fit(value: JsonValue, kind: pa.DataType) -> JsonValue:
    """A value as its column takes it."""
    if value is None:
        return None
    if pa.types.is_string(kind):
        return value if isinstance(value, str) else json.dumps(value, sort_keys=True)
    return float(value) if pa.types.is_floating(kind) else value


def begin(out: Path, identity: JsonObject, resume: bool, what: str = "sweep") -> None:
    """Make the folder of a sweep (or a study), or take up one that was begun with the same.

    A folder without a record and without content is what a process leaves that was killed as it
    began: `resume` begins it. What other code or libraries began is not taken up, as its bits may
    differ.
    """
    identity = identity | {"code": code_digest()}
    if resume and not out.is_dir():
        raise BadInput("--resume", str(out), f"a {what} that was begun before")
    if not out.exists() or (resume and _is_bare_beginning(out)):
        _make(out, identity)
        return
    if not resume:
        raise BadInput("-o", str(out), "a path that does not exist yet; or give --resume")
    begun = _begun(out, what)
    for key, wanted in identity.items():
        if not _as_begun(key, begun.get(key), wanted):
            told = " (it was begun by other code or libraries)" if key == "code" else ""
            raise BadInput("--resume", str(out), f"a {what} of the same {key}{told}")
    if begun != identity:  # with files that were not there before
        write_atomically(out / BEGUN, json.dumps(identity, indent=2, sort_keys=True))
    (out / PARTS).mkdir(exist_ok=True)


def _make(out: Path, identity: JsonObject) -> None:
    """The folder and its record. BadInput where it can't be made."""
    try:
        (out / PARTS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if error.errno in NO_ROOM:
            raise
        allowed = f"a path that can be written; {error.strerror}"
        raise BadInput("-o", str(out), allowed) from None
    write_atomically(out / BEGUN, json.dumps(identity, indent=2, sort_keys=True))


def _is_bare_beginning(out: Path) -> bool:
    """Whether a folder holds nothing but what is made before its record is whole."""
    return out.is_dir() and all(
        path == out / PARTS or path.name.startswith(f".{BEGUN}.") for path in out.rglob("*")
    )


def _begun(out: Path, what: str) -> JsonObject:
    """The identity that a folder was begun with. BadInput, Damaged where there is none."""
    try:
        found: JsonObject = json.loads((out / BEGUN).read_text())
    except FileNotFoundError:
        raise BadInput("--resume", str(out), f"a {what} begun by `nightglass {what}`") from None
    except (ValueError, OSError) as error:
        raise Damaged(str(out / BEGUN), f"not what was written ({error})") from None
    return found


def _as_begun(key: str, begun: JsonValue, now: JsonValue) -> bool:
    """Whether a part of the identity is that of the beginning; files that were missing then, so
    that their points failed, may be there now. An older record knows of no files."""
    if key == "files" and begun is not None:
        return all(one in now for one in begun)
    return bool(begun == now) or (key == "files" and not now)


def identity_of(
    sweep: Sweep, data: JsonObject, digests: list[str], files: list[list[str]]
) -> JsonObject:
    """What makes two sweeps the same: their points, base scene, catalogues, files and metrics."""
    plain = sweep.as_dict()
    return {
        "format": FORMAT,
        "axes": _sha([plain["axes"], plain["design"], plain["seeds"]]),
        "scene": _sha(data),
        "metrics": _sha([plain["metrics"], plain["targets"], plain["detection"], plain["cubes"]]),
        "catalogues": digests,
        "files": files,
    }


def _sha(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def is_complete(out: Path, table: str = TABLE) -> bool:
    """Whether a sweep's (or a study's) table stands sealed."""
    return (out / COMPLETE).is_file() and (out / table).is_file()


def seal(out: Path, names: tuple[str, ...] = (TABLE, SWEEP, REPORT, PAGE, FIGURE)) -> None:
    """Write _COMPLETE, last of all, with the digests of the files."""
    files = {name: file_digest(out / name) for name in names if (out / name).is_file()}
    write_atomically(out / COMPLETE, json.dumps({"format": FORMAT, "files": files}, indent=2))
