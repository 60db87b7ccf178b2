"""Rows of the Hipparcos main catalogue in the columns of a catalogue, read by hand.

Columns after the catalogue's own description (ESA SP-1200, 1997); G from V and V-I after Evans et
al. 2018 (A&A 616, A4, table A.2): G - V = -0.01746 + 0.008092 x - 0.2810 x^2 + 0.03655 x^3.
"""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa

from catalog_tools.columns import INCOMING

FIELDS = {"source_id": 1, "v": 5, "ra": 8, "dec": 9, "parallax": 11, "pmra": 12, "pmdec": 13,
          "vi": 40}  # fmt: skip


def hipparcos_rows(shared_data: Path) -> pa.Table:
    """The bright entries that have a place and V; source_id is the HIP number."""
    with gzip.open(shared_data / "bright_stars" / "hip_main_bright.dat.gz", "rt") as lines:
        fields = [line.split("|") for line in lines]
    columns = {
        name: np.array([float(f[at]) if f[at].strip() else np.nan for f in fields])
        for name, at in FIELDS.items()
    }
    x = np.clip(np.nan_to_num(columns.pop("vi"), nan=0.7), -0.3, 2.7)
    v = columns.pop("v")
    columns["phot_g_mean_mag"] = v - 0.01746 + 0.008092 * x - 0.2810 * x**2 + 0.03655 * x**3
    kept = np.isfinite(columns["ra"]) & np.isfinite(v)
    arrays = [
        pa.array(columns.get(f.name, np.full(len(v), np.nan))[kept], from_pandas=True).cast(f.type)
        for f in INCOMING
    ]
    return pa.table(arrays, schema=INCOMING)
