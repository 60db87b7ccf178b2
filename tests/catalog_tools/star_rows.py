"""Rows for the tests: random stars with every hard case, and files that hold them."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa

from catalog_tools.columns import INCOMING, NAMES, STEPS


def random_stars(n: int, seed: int = 1, *, around: tuple[float, float, float] | None = None):
    """n stars (schema INCOMING) all over the sky, or within a box of half-width `around[2]` deg.

    A tenth lacks colours, a tenth motions; a hundredth moves by tens of arcsec a year.
    """
    rng = np.random.default_rng(seed)
    if around is None:
        ra, dec = rng.uniform(0, 360, n), np.degrees(np.arcsin(rng.uniform(-1, 1, n)))
    else:
        ra = (around[0] + rng.uniform(-around[2], around[2], n)) % 360
        dec = np.clip(around[1] + rng.uniform(-around[2], around[2], n), -90, 90)
    fast = np.where(rng.random(n) < 0.01, 2000.0, 1.0)
    columns = {
        "source_id": rng.permutation(n).astype(np.int64) * 1_000_003 + 17,
        "ra": ra,
        "dec": dec,
        "pmra": rng.normal(0, 10, n) * fast,
        "pmdec": rng.normal(0, 10, n) * fast,
        "parallax": rng.normal(1, 2, n),
        "radial_velocity": np.where(rng.random(n) < 0.1, rng.normal(0, 50, n), np.nan),
        "phot_g_mean_mag": rng.uniform(3, 21, n),
        "phot_bp_mean_mag": rng.uniform(3, 21, n),
        "phot_rp_mean_mag": rng.uniform(3, 21, n),
    }
    for names in (("phot_bp_mean_mag", "phot_rp_mean_mag"), ("pmra", "pmdec", "parallax")):
        absent = rng.random(n) < 0.1
        for name in names:
            columns[name] = np.where(absent, np.nan, columns[name])
    for name, step in STEPS.items():  # as a catalogue stores them, so that rows compare equal
        columns[name] = np.rint(columns[name] / step) * step
    arrays = [pa.array(columns[f.name], from_pandas=True).cast(f.type) for f in INCOMING]
    return pa.table(arrays, schema=INCOMING)


def write_csv(path: Path, stars: pa.Table, *, end: str = "\n", header: str | None = None) -> Path:
    """Stars as a CSV file of DR2's form; gzipped where the name ends in .gz."""
    lines = [",".join(NAMES) if header is None else header]
    for row in stars.to_pylist():
        lines.append(",".join("" if row[name] is None else repr(row[name]) for name in NAMES))
    data = (end.join(lines) + end).encode()
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)
    return path


def same_rows(left: pa.Table, right: pa.Table) -> bool:
    """Equal content, whatever the order of the rows."""
    sort = [(name, "ascending") for name in left.column_names]
    left, right = (
        t.select(left.column_names).sort_by(sort).combine_chunks() for t in (left, right)
    )
    return left.to_pydict() == right.to_pydict()
