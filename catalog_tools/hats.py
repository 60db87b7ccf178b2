"""The HATS files beside the shards, so that `hats` and LSDB open the catalogue.

HATS: IVOA Note 1.0 (2025), "Hierarchical Adaptive Tiling Scheme". The properties come last: a
reader that finds them finds everything else.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from .catalogue import Catalogue
from .columns import HEALPIX_COLUMN, HEALPIX_ORDER, STORED

MAX_SKYMAP_ORDER = 8


def write_hats_files(root: Path, catalogue: Catalogue, counts: np.ndarray, per_leaf: int) -> None:
    """Write partition_info.csv, _common_metadata, the two maps, and the properties below `root`.

    counts : (12 * 4**order,) rows by nested pixel of some order >= the leaves' order.
    """
    lines = [f"{leaf.order},{leaf.pixel},{leaf.rows}" for leaf in catalogue.leaves]
    (root / "partition_info.csv").write_text("\n".join(["Norder,Npix,num_rows", *lines]) + "\n")
    (root / "dataset").mkdir(exist_ok=True)
    pq.write_metadata(STORED, root / "dataset" / "_common_metadata", store_schema=False)
    order = _skymap_order(catalogue)
    rows = counts.reshape(12 * 4**order, -1).sum(axis=1)
    for name in ("skymap.fits", "point_map.fits"):
        _write_map(root / name, rows)
    text = _properties(catalogue, order, int(np.count_nonzero(rows)), per_leaf)
    for name in ("properties", "hats.properties"):
        (root / name).write_text(text, encoding="utf-8")


def _skymap_order(catalogue: Catalogue) -> int:
    return min(MAX_SKYMAP_ORDER, max((leaf.order for leaf in catalogue.leaves), default=0) + 3)


def _write_map(path: Path, rows: np.ndarray) -> None:
    import healpy

    healpy.write_map(str(path), rows.astype(np.int64), nest=True, dtype=np.int64)


def _properties(catalogue: Catalogue, order: int, pixels: int, per_leaf: int) -> str:
    size_kib = sum(leaf.bytes for leaf in catalogue.leaves) // 1024 + 1
    now = datetime.now(UTC)
    items = {
        "obs_collection": catalogue.name,
        "obs_description": catalogue.description.replace("\n", " "),
        "dataproduct_type": "object",
        "hats_nrows": catalogue.rows,
        "hats_col_ra": "ra",
        "hats_col_dec": "dec",
        "hats_col_healpix": HEALPIX_COLUMN,
        "hats_col_healpix_order": HEALPIX_ORDER,
        "hats_max_rows": per_leaf,
        "hats_order": max((leaf.order for leaf in catalogue.leaves), default=0),
        "hats_skymap_order": order,
        "hats_npix_suffix": ".parquet",
        "moc_sky_fraction": f"{pixels / (12 * 4**order):.5f}",
        "hats_builder": "nightglass",
        "hats_creation_date": f"{now:%Y-%m-%dT%H:%MUTC}",
        "hats_estsize": size_kib,
        "hats_release_date": "2025-08-22",
        "hats_version": "v1.0",
        "nightglass_ref_epoch_jyear": catalogue.ref_epoch_jyear,
        "nightglass_synthetic": str(catalogue.synthetic).lower(),
        "nightglass_digest": catalogue.digest,
    }
    return "#HATS catalog\n" + "".join(f"{key}={value}\n" for key, value in items.items())
