"""What a catalogue holds, as plain values for people and machines."""

from __future__ import annotations

import numpy as np

from .catalogue import Catalogue
from .coverage import coverage_of
from .documents import JsonObject


def info(catalogue: Catalogue) -> JsonObject:
    """Facts of a catalogue from its manifest alone, ready for JSON."""
    leaves, groups = catalogue.leaf_table, catalogue.row_group_table
    size = int(leaves["bytes"].sum())
    orders, counts = np.unique(leaves["order"], return_counts=True)
    some = leaves.size > 0
    return {
        "name": catalogue.name,
        "path": catalogue.path,
        "description": catalogue.description,
        "synthetic": catalogue.synthetic,
        "ref_epoch_jyear": catalogue.ref_epoch_jyear,
        "rows": catalogue.rows,
        "leaves": leaves.size,
        "leaves_by_order": dict(zip(map(str, orders.tolist()), counts.tolist(), strict=True)),
        "row_groups": groups.size,
        "bytes": size,
        "bytes_per_row": round(size / catalogue.rows, 2) if catalogue.rows else None,
        "brightest_g_mag": catalogue.brightest_g_mag,
        "faintest_g_mag": catalogue.faintest_g_mag,
        "max_proper_motion_mas_yr": (
            float(leaves["max_proper_motion_mas_yr"].max()) if some else None
        ),
        "max_parallax_mas": float(leaves["max_parallax_mas"].max()) if some else None,
        "coverage": coverage_of(catalogue).describe(),
        "without_colour": (
            "unknown: it was ingested before this was counted"
            if catalogue.without_colour is None
            else catalogue.without_colour
        ),
        "sources": catalogue.sources,
        "rows_in": catalogue.rows_in,
        "rejected": dict(catalogue.rejected),
        "facts": dict(catalogue.facts),
        "digest": catalogue.digest,
    }
