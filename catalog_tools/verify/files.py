"""Prove the files beside the shards: tables, accounts, HATS files; none missing, none extra."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from astropy.io import fits

from ..catalogue import MANIFEST_NAME, REJECTS_NAME, SOURCES_NAME, Catalogue, open_catalogue
from ..columns import HEALPIX_COLUMN, HEALPIX_ORDER, STORED
from ..coverage import from_json, of_rows
from ..errors import BadInput, Damaged, Incomplete
from ..partition import COUNT_ORDER, Pixels
from ..query.starlight import STARLIGHT_NAME, read_starlight
from ..storage.stores import Unreachable
from .shards import Finding

PARTITIONS_NAME = "partition_info.csv"
SCHEMA_NAME = "dataset/_common_metadata"
MAP_NAMES = ("skymap.fits", "point_map.fits")
PROPERTIES_NAMES = ("hats.properties", "properties")
HATS_NAMES = (PARTITIONS_NAME, SCHEMA_NAME, *MAP_NAMES, *PROPERTIES_NAMES)


def check_tables(catalogue: Catalogue) -> list[Finding]:
    """The manifest as it is now, and its counts and bounds among themselves."""
    wrong: list[Finding] = []
    try:
        if open_catalogue(catalogue.path).digest != catalogue.digest:
            wrong.append(Finding(MANIFEST_NAME, "was changed since the catalogue was opened"))
    except Damaged as error:
        wrong.append(Finding(_relative(catalogue, error.path), error.reason))
    except BadInput as error:
        wrong.append(Finding(MANIFEST_NAME, f"needs {error.allowed}"))
    leaves, groups = catalogue.leaf_table, catalogue.row_group_table
    of_leaf = np.repeat(np.arange(leaves.size), leaves["row_groups"])
    in_groups = np.bincount(of_leaf, groups["rows"], leaves.size).astype(np.int64)
    first = leaves["pixel"] << (2 * (HEALPIX_ORDER - leaves["order"].astype(np.int64)))
    end = (leaves["pixel"] + 1) << (2 * (HEALPIX_ORDER - leaves["order"].astype(np.int64)))
    rejected = sum(catalogue.rejected.values())
    checks = {
        "rows of the row groups do not add up to the leaves'": (in_groups != leaves["rows"]).any(),
        "rows of the leaves do not add up to the catalogue's": int(leaves["rows"].sum())
        != catalogue.rows,
        "rows kept and rejected do not add up to the rows read": catalogue.rows + rejected
        != catalogue.rows_in,
        "leaves overlap or are out of order": (first[1:] < end[:-1]).any(),
        "a row group moves faster than its leaf": any(
            (groups[key] > leaves[key][of_leaf]).any()
            for key in ("max_proper_motion_mas_yr", "max_parallax_mas", "faintest_g_mag")
        ),
    }
    return wrong + [Finding(MANIFEST_NAME, what) for what, bad in checks.items() if bad]


def check_files(catalogue: Catalogue) -> tuple[list[Finding], list[str]]:
    """Files that the manifest names by digest, their rows, and files missing or extra.

    Returns findings, and notes on what could not be looked at.
    """
    wrong = []
    for name, sha256 in sorted(catalogue.files.items()):
        data = _read(catalogue, name)
        if data is None:
            wrong.append(Finding(name, "is missing or cannot be read"))
        elif hashlib.sha256(data).hexdigest() != sha256:
            wrong.append(Finding(name, "its content does not match the manifest's digest"))
        elif name in (SOURCES_NAME, REJECTS_NAME):
            wrong += _check_accounts(catalogue, name, data)
    try:
        read_starlight(catalogue)  # made after the catalogue: it carries digests of its own
    except Damaged as error:
        wrong.append(Finding(STARLIGHT_NAME, error.reason))
    names = _names(catalogue)
    if names is None:
        return wrong, ["extra files were not looked for: a web server gives no list"]
    shards = {leaf.path for leaf in catalogue.leaves}
    expected = {MANIFEST_NAME, STARLIGHT_NAME, *catalogue.files, *HATS_NAMES, *shards}
    wrong += [Finding(name, "is no part of the catalogue") for name in sorted(names - expected)]
    return wrong, []


def check_hats(catalogue: Catalogue, counts: Pixels, *, all_rows: bool) -> list[Finding]:
    """The HATS files against the manifest and the rows.

    counts : (12 * 4**COUNT_ORDER,) rows by nested pixel; all_rows : whether every shard could be
    read, without which the maps can't be compared.
    """
    checks: dict[str, Callable[[bytes], list[str]]] = {
        PARTITIONS_NAME: partial(_check_partitions, catalogue),
        SCHEMA_NAME: _check_schema,
        **dict.fromkeys(MAP_NAMES, lambda data: _check_map(data, counts) if all_rows else []),
        **dict.fromkeys(PROPERTIES_NAMES, partial(_check_properties, catalogue)),
    }
    wrong = []
    for name, check in checks.items():
        data = _read(catalogue, name)
        if data is None:
            wrong.append(Finding(name, "is missing or cannot be read"))
            continue
        try:
            what = check(data)
        except (ValueError, LookupError, OSError, TypeError, Warning) as error:
            what = [f"cannot be understood ({type(error).__name__}: {error})"]
        wrong += [Finding(name, text) for text in what]
    pair = [_read(catalogue, name) for name in PROPERTIES_NAMES]
    if None not in pair and pair[0] != pair[1]:
        wrong.append(Finding(PROPERTIES_NAMES[0], f"differs from {PROPERTIES_NAMES[1]}"))
    return wrong


def check_coverage(catalogue: Catalogue, counts: Pixels, *, all_rows: bool) -> list[Finding]:
    """What the manifest says of coverage: that it is understood, and follows from the rows if it
    claims so. counts, all_rows : as in `check_hats`."""
    if catalogue.coverage is None:
        return []
    try:
        said = from_json(catalogue.coverage)
    except ValueError as error:
        return [Finding(MANIFEST_NAME, f"its coverage cannot be understood ({error})")]
    if said.from_rows and all_rows and of_rows(counts).to_json() != said.to_json():
        return [Finding(MANIFEST_NAME, "its coverage is not that of its rows")]
    return []


def _check_accounts(catalogue: Catalogue, name: str, data: bytes) -> list[Finding]:
    """The tables of sources and of rejected rows against the manifest's counts."""
    table = pq.read_table(pa.BufferReader(data), page_checksum_verification=True)
    if name == SOURCES_NAME:
        found = (table.num_rows, pc.sum(table["rows"]).as_py() or 0)
        if found != (catalogue.sources, catalogue.rows_in):
            return [
                Finding(
                    name,
                    f"has {found[0]} sources of {found[1]} rows; the manifest has "
                    f"{catalogue.sources} of {catalogue.rows_in}",
                )
            ]
        return []
    pairs = table["reason"].value_counts().to_pylist()
    if {pair["values"]: pair["counts"] for pair in pairs} != catalogue.rejected:
        return [Finding(name, "its rows are not those that the manifest counts")]
    return []


def _check_partitions(catalogue: Catalogue, data: bytes) -> list[str]:
    rows = list(csv.DictReader(io.StringIO(data.decode("utf-8")), strict=True))
    found = {(int(r["Norder"]), int(r["Npix"])): int(r["num_rows"]) for r in rows}
    columns = (catalogue.leaf_table[name].tolist() for name in ("order", "pixel", "rows"))
    said = {(order, pixel): count for order, pixel, count in zip(*columns, strict=True)}
    wrong = [f"has no leaf {key}" for key in sorted(said.keys() - found.keys())]
    wrong += [f"has a leaf {key} that is not there" for key in sorted(found.keys() - said.keys())]
    wrong += [
        f"says {found[key]} rows for the leaf {key}; the manifest says {said[key]}"
        for key in sorted(said.keys() & found.keys())
        if found[key] != said[key]
    ]
    return wrong + (["has a leaf twice"] if len(found) != len(rows) else [])


def _check_schema(data: bytes) -> list[str]:
    same = pq.read_schema(pa.BufferReader(data)).equals(STORED)
    return [] if same else ["its columns are not those of the catalogue"]


def _check_map(data: bytes, counts: Pixels) -> list[str]:
    """A FITS map of rows by pixel against the rows counted."""
    with warnings.catch_warnings(), fits.open(io.BytesIO(data)) as hdus:
        warnings.simplefilter("error")  # a file cut short is no more than a warning
        header, table = hdus[1].header, hdus[1].data
        held = np.asarray(table[table.names[0]]).ravel().astype(np.int64)
    order = int(header["NSIDE"]).bit_length() - 1
    if header["ORDERING"] != "NESTED" or held.size != 12 * 4**order or order > COUNT_ORDER:
        return [f"is no nested map of order {COUNT_ORDER} or below"]
    different = np.count_nonzero(counts.reshape(held.size, -1).sum(axis=1) != held)
    return [f"has other counts than the shards in {different} pixels"] if different else []


def _check_properties(catalogue: Catalogue, data: bytes) -> list[str]:
    lines = [line.partition("=") for line in data.decode("utf-8").splitlines() if line[:1] != "#"]
    found = {key.strip(): value.strip() for key, _, value in lines}
    orders = catalogue.leaf_table["order"]
    said = {
        "obs_collection": catalogue.name,
        "obs_description": catalogue.description.replace("\n", " "),
        "dataproduct_type": "object",
        "hats_nrows": str(catalogue.rows),
        "hats_col_ra": "ra",
        "hats_col_dec": "dec",
        "hats_col_healpix": HEALPIX_COLUMN,
        "hats_col_healpix_order": str(HEALPIX_ORDER),
        "hats_order": str(int(orders.max()) if orders.size else 0),
        "hats_npix_suffix": ".parquet",
        "nightglass_ref_epoch_jyear": json.dumps(catalogue.ref_epoch_jyear),
        "nightglass_synthetic": json.dumps(catalogue.synthetic),
        "nightglass_digest": catalogue.digest,
    }
    return [
        f"says {key}={found.get(key, '')}; the manifest says {value}"
        for key, value in said.items()
        if found.get(key) != value
    ]


def _names(catalogue: Catalogue) -> frozenset[str] | None:
    try:
        return catalogue.store.names()
    except Unreachable as error:
        raise Incomplete(f"{catalogue.path}: could not be listed ({error})") from None


def _read(catalogue: Catalogue, name: str) -> bytes | None:
    """A small file; None where it can't be read."""
    try:
        return catalogue.store.read(name)
    except Unreachable as error:
        raise Incomplete(f"{catalogue.path}/{name}: could not be read ({error})") from None
    except OSError:
        return None


def _relative(catalogue: Catalogue, path: str) -> str:
    return path.removeprefix(f"{catalogue.store.root}/")
