"""A catalogue on disk: its manifest, its leaves (shards), and their row groups.

The manifest `nightglass.json` lies beside the HATS files. Two numpy tables, named in it by their
sha256, hold what a planner needs (where leaves and row groups lie, how bright their rows are, how
far they move) so that planning reads no star; and what a reader needs to prove what it reads
(lengths and crc32c of files, footers, row groups and their columns).
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .documents import JsonObject
from .errors import BadInput, Damaged
from .storage.durable import save_array
from .storage.stores import LocalStore, Store, Unreachable, open_store

MANIFEST_NAME = "nightglass.json"
FORMAT = "nightglass/catalogue"
VERSION = 4
READABLE = (3, 4)  # 3 says neither what is covered nor which stars have a colour
LEAVES_NAME = "nightglass/leaves.npy"
ROW_GROUPS_NAME = "nightglass/row_groups.npy"
SOURCES_NAME = "nightglass/sources.parquet"
REJECTS_NAME = "nightglass/rejects.parquet"
# HATS files that the manifest proves; the two properties files name its digest, and come after it.
HATS_NAMES = ("partition_info.csv", "skymap.fits", "point_map.fits", "dataset/_common_metadata")
MAKE_ONE = (
    "a catalogue; make one with `nightglass catalog demo -o PATH` or `nightglass catalog ingest`"
)

STORED_COLUMNS = 11  # of `columns.STORED`

# Both tables: a cap (centre, radius) that bounds the rows, and the fastest and nearest of them.
_BOUNDS = [
    ("centre", "<f8", (3,)),
    ("radius_rad", "<f8"),
    ("max_proper_motion_mas_yr", "<f8"),
    ("max_parallax_mas", "<f8"),
    ("brightest_g_mag", "<f4"),
    ("faintest_g_mag", "<f4"),
]
LEAVES_DTYPE = np.dtype(
    [
        ("order", "<i4"),
        ("pixel", "<i8"),
        ("rows", "<i8"),
        ("bytes", "<i8"),
        ("crc32c", "<u4"),
        ("footer_bytes", "<i4"),
        ("footer_crc32c", "<u4"),
        ("row_groups", "<i4"),
        *_BOUNDS,
    ]
)
ROW_GROUPS_DTYPE = np.dtype(
    [
        ("offset", "<i8"),
        ("bytes", "<i8"),
        ("crc32c", "<u4"),
        ("rows", "<i4"),
        *_BOUNDS,
        ("column_bytes", "<u4", (STORED_COLUMNS,)),
        ("column_crc32c", "<u4", (STORED_COLUMNS,)),
    ]
)


class RowGroup(NamedTuple):
    """A run of rows of a shard: one magnitude band, one stretch of the HEALPix curve.

    column_bytes, column_crc32c : of each of STORED_COLUMNS, which follow each other from `offset`.
    """

    row_group: int
    rows: int
    bytes: int
    offset: int
    crc32c: int
    brightest_g_mag: float
    faintest_g_mag: float
    column_bytes: tuple[int, ...]
    column_crc32c: tuple[int, ...]


class Leaf(NamedTuple):
    """One shard: a nested HEALPix pixel with rows; with all its row groups, or those wanted.

    The cap (centre, radius) and the largest motions are of all rows of the shard.
    """

    order: int
    pixel: int
    rows: int
    bytes: int
    crc32c: int
    footer_bytes: int
    footer_crc32c: int
    row_group_count: int
    centre: tuple[float, float, float]
    radius_rad: float
    max_proper_motion_mas_yr: float
    max_parallax_mas: float
    row_groups: tuple[RowGroup, ...]

    @property
    def path(self) -> str:
        """Where the shard lies, relative to the catalogue."""
        return shard_name(self.order, self.pixel)


@dataclass(frozen=True)
class Catalogue:
    """What the manifest says. `digest` (sha256 of its content) names the catalogue's exact bits.

    leaf_table, row_group_table : structured arrays (LEAVES_DTYPE, ROW_GROUPS_DTYPE), leaves by
    their place on the nested HEALPix curve, the row groups of each after those of the last.
    coverage : which part of the sky it covers, for `coverage.coverage_of`; without_colour : rows
    without a BP or RP magnitude. Both None where an older manifest does not say.
    """

    path: str
    name: str
    description: str
    ref_epoch_jyear: float
    synthetic: bool
    rows: int
    brightest_g_mag: float | None
    faintest_g_mag: float | None
    sources: int
    rows_in: int
    rejected: dict[str, int]
    facts: JsonObject
    files: dict[str, str]
    digest: str
    leaf_table: np.ndarray
    row_group_table: np.ndarray
    coverage: JsonObject | None = None
    without_colour: int | None = None

    @cached_property
    def first_row_groups(self) -> np.ndarray:
        """(leaves + 1,) where the row groups of each leaf begin in `row_group_table`."""
        return np.concatenate([[0], np.cumsum(self.leaf_table["row_groups"], dtype=np.int64)])

    @property
    def store(self) -> Store:
        """Where its files are read from."""
        return open_store(self.path)

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        """All leaves with all their row groups."""
        return tuple(self.leaf(i) for i in range(self.leaf_table.size))

    def leaf(self, index: int, row_groups: Sequence[int] | None = None) -> Leaf:
        """One leaf by its place in `leaf_table`, with the row groups wanted (all by default)."""
        row = self.leaf_table[index]
        first, end = (int(i) for i in self.first_row_groups[index : index + 2])
        wanted = np.arange(end - first) if row_groups is None else np.asarray(row_groups, int)
        table = self.row_group_table[first + wanted]
        columns = [table[name].tolist() for name in RowGroup._fields[1:]]
        columns[-2:] = (map(tuple, values) for values in columns[-2:])
        groups = tuple(map(RowGroup, wanted.tolist(), *columns))
        x, y, z = row["centre"].tolist()
        return Leaf(
            order=int(row["order"]),
            pixel=int(row["pixel"]),
            rows=int(row["rows"]),
            bytes=int(row["bytes"]),
            crc32c=int(row["crc32c"]),
            footer_bytes=int(row["footer_bytes"]),
            footer_crc32c=int(row["footer_crc32c"]),
            row_group_count=int(row["row_groups"]),
            centre=(x, y, z),
            radius_rad=float(row["radius_rad"]),
            max_proper_motion_mas_yr=float(row["max_proper_motion_mas_yr"]),
            max_parallax_mas=float(row["max_parallax_mas"]),
            row_groups=groups,
        )


def shard_name(order: int, pixel: int) -> str:
    """A leaf's place in the HATS layout, relative to the catalogue."""
    folder = pixel // 10_000 * 10_000
    return f"dataset/Norder={order}/Dir={folder}/Npix={pixel}.parquet"


def write_manifest(
    folder: Path, content: JsonObject, leaves: np.ndarray, row_groups: np.ndarray
) -> str:
    """Write both tables and the manifest below `folder`; returns the digest.

    content : the fields of a Catalogue from `name` to `facts`. The digests of all files in the
    folder `nightglass` and of HATS_NAMES become part of it.
    """
    (folder / LEAVES_NAME).parent.mkdir(exist_ok=True)
    save_array(folder / LEAVES_NAME, leaves)
    save_array(folder / ROW_GROUPS_NAME, row_groups)
    beside = [folder / name for name in HATS_NAMES if (folder / name).is_file()]
    files = {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted([*(folder / LEAVES_NAME).parent.iterdir(), *beside])
    }
    content = json.loads(json.dumps({**content, "files": files}, allow_nan=False))
    digest = _digest(content)
    head = {"format": FORMAT, "version": VERSION, "sha256": digest}
    text = json.dumps({**head, "catalogue": content}, indent=1, sort_keys=True)
    (folder / MANIFEST_NAME).write_text(text + "\n", encoding="utf-8")
    return digest


def open_catalogue(path: str | os.PathLike[str], *, field: str = "catalogue") -> Catalogue:
    """Read a catalogue's manifest and its two tables: no star.

    path : a folder, or an fsspec URL. Raises BadInput (naming `field`) where there is no
    catalogue, one of another format or of another version, and Damaged where something read does
    not match its digest.
    """
    store = open_store(path, field)
    document = _manifest(store, field)
    content = document["catalogue"]
    try:
        tables = [
            _table(store, name, content["files"].get(name), dtype)
            for name, dtype in ((LEAVES_NAME, LEAVES_DTYPE), (ROW_GROUPS_NAME, ROW_GROUPS_DTYPE))
        ]
    except Unreachable as error:
        raise BadInput(field, store.root, f"a place that can be read ({error})") from None
    return Catalogue(
        store.root,
        **content,
        digest=document["sha256"],
        leaf_table=tables[0],
        row_group_table=tables[1],
    )


def _manifest(store: Store, field: str) -> JsonObject:
    """The document of a manifest of a readable version, its content proved by its digest."""
    where = f"{store.root}/{MANIFEST_NAME}"
    try:
        text = store.read(MANIFEST_NAME).decode("utf-8")
    except (FileNotFoundError, NotADirectoryError):
        raise BadInput(field, store.root, _what_is_there(store)) from None
    except (PermissionError, Unreachable) as error:
        raise BadInput(field, store.root, f"a place that can be read ({error})") from None
    except (UnicodeDecodeError, OSError) as error:
        raise Damaged(where, f"cannot be read ({error})") from None
    try:
        document = json.loads(text)
    except ValueError as error:
        raise Damaged(where, f"is not JSON ({error})") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise BadInput(field, store.root, f"a manifest of format {FORMAT!r}")
    if document.get("version") not in READABLE:
        allowed = (
            f"manifest version {' or '.join(map(str, READABLE))} (this program is older or newer "
            "than the catalogue; ingest its sources again, or use the program that wrote it)"
        )
        raise BadInput(field, document.get("version"), allowed)
    content = document.get("catalogue")
    if not isinstance(content, dict) or _digest(content) != document.get("sha256"):
        raise Damaged(where, "its content does not match its digest")
    return document


def _table(store: Store, name: str, sha256: str | None, dtype: np.dtype) -> np.ndarray:
    """One of the numpy tables, proved by its digest."""
    where = f"{store.root}/{name}"
    try:
        data = store.read(name)
    except Unreachable:
        raise
    except OSError as error:
        raise Damaged(where, f"cannot be read ({error})") from None
    if hashlib.sha256(data).hexdigest() != sha256:
        raise Damaged(where, "its content does not match the manifest's digest")
    table: np.ndarray = np.load(io.BytesIO(data), allow_pickle=False)
    if table.dtype != dtype:
        raise Damaged(where, "holds other columns than this program's")
    return table


def _digest(content: JsonObject) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _what_is_there(store: Store) -> str:
    """Why a place without a manifest is no catalogue, in the words of the error."""
    folder = Path(store.root)
    if isinstance(store, LocalStore) and not folder.is_dir():
        there = "that is a file, not a folder" if folder.exists() else "there is nothing"
        return f"{MAKE_ONE} ({there})"
    for name in ("hats.properties", "properties"):
        try:
            store.read(name)
        except OSError:
            continue
        return (
            f"a catalogue with {MANIFEST_NAME}: this is a HATS catalogue of another program; "
            "ingest its source files with `nightglass catalog ingest`"
        )
    return f"{MAKE_ONE} (it holds no {MANIFEST_NAME})"
