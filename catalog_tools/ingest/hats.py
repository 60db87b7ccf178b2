"""The HATS files beside the shards, so that `hats` and LSDB open the catalogue.

HATS: IVOA Note 1.0 (2025), "Hierarchical Adaptive Tiling Scheme". The properties come last: a
reader that finds them finds everything else.
"""

from __future__ import annotations

import io
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from astropy.io import fits

from ..columns import HEALPIX_COLUMN, HEALPIX_ORDER, STORED
from ..documents import JsonObject

MAX_SKYMAP_ORDER = 8


def write_hats_files(root: Path, leaves: np.ndarray, counts: np.ndarray) -> JsonObject:
    """Write partition_info.csv, _common_metadata and the two maps below `root`, before the manifest
    that proves them; returns what the properties say of them.

    leaves : the manifest's table (LEAVES_DTYPE); counts : (12 * 4**order,) rows by nested pixel of
    some order, at least MAX_SKYMAP_ORDER.
    """
    columns = (leaves[name].tolist() for name in ("order", "pixel", "rows"))
    lines = [",".join(map(str, row)) for row in zip(*columns, strict=True)]
    (root / "partition_info.csv").write_text("\n".join(["Norder,Npix,num_rows", *lines]) + "\n")
    (root / "dataset").mkdir(exist_ok=True)
    pq.write_metadata(STORED, root / "dataset" / "_common_metadata", store_schema=False)
    deepest = int(leaves["order"].max()) if leaves.size else 0
    order = min(MAX_SKYMAP_ORDER, deepest + 3)
    rows = counts.reshape(12 * 4**order, -1).sum(axis=1)
    for name in ("skymap.fits", "point_map.fits"):
        _write_map(root / name, rows)
    return {
        "hats_order": deepest,
        "hats_skymap_order": order,
        "moc_sky_fraction": f"{np.count_nonzero(rows) / rows.size:.5f}",
        "hats_estsize": int(leaves["bytes"].sum()) // 1024 + 1,
    }


def write_properties(
    root: Path, content: JsonObject, digest: str, rows_per_leaf: int, shape: JsonObject
) -> None:
    """Write both properties files, the last of all: they name the manifest's digest.

    content, digest : what the manifest says; shape : what `write_hats_files` returned.
    """
    about = {
        "obs_collection": content["name"],
        "obs_description": content["description"].replace("\n", " "),
        "hats_nrows": content["rows"],
        "hats_max_rows": rows_per_leaf,
        **shape,
        "nightglass_ref_epoch_jyear": content["ref_epoch_jyear"],
        "nightglass_synthetic": str(content["synthetic"]).lower(),
        "nightglass_digest": digest,
    }
    text = _properties(about)
    for name in ("properties", "hats.properties"):
        (root / name).write_text(text, encoding="utf-8")


def _write_map(path: Path, rows: np.ndarray) -> None:
    """A full-sky nested HEALPix map as FITS (what healpy writes, without importing it)."""
    width = min(rows.size, 1024)
    values = rows.astype(">i8").reshape(-1, width)
    table = fits.BinTableHDU.from_columns(
        [fits.Column("T", f"{width if width > 1 else ''}K", array=values)]
    )
    table.header.update(
        PIXTYPE="HEALPIX",
        ORDERING="NESTED",
        INDXSCHM="IMPLICIT",
        OBJECT="FULLSKY",
        NSIDE=int((rows.size // 12) ** 0.5),
        FIRSTPIX=0,
        LASTPIX=rows.size - 1,
    )
    held = io.BytesIO()  # on a real file astropy's error of a full disk has no number
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(held)
    path.write_bytes(held.getbuffer())


def _properties(about: JsonObject) -> str:
    items = {
        **about,
        "dataproduct_type": "object",
        "hats_col_ra": "ra",
        "hats_col_dec": "dec",
        "hats_col_healpix": HEALPIX_COLUMN,
        "hats_col_healpix_order": HEALPIX_ORDER,
        "hats_npix_suffix": ".parquet",
        "hats_builder": "nightglass",
        "hats_creation_date": f"{datetime.now(UTC):%Y-%m-%dT%H:%MUTC}",
        "hats_release_date": "2025-08-22",
        "hats_version": "v1.0",
    }
    return "#HATS catalog\n" + "".join(f"{key}={value}\n" for key, value in items.items())
