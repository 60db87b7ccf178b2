"""What a catalogue holds, as plain values for people and machines."""

from __future__ import annotations

from typing import Any

from .catalogue import Catalogue


def info(catalogue: Catalogue) -> dict[str, Any]:
    """Facts of a catalogue from its manifest alone, ready for JSON."""
    size = sum(leaf.bytes for leaf in catalogue.leaves)
    return {
        "name": catalogue.name,
        "path": catalogue.path,
        "description": catalogue.description,
        "synthetic": catalogue.synthetic,
        "ref_epoch_jyear": catalogue.ref_epoch_jyear,
        "rows": catalogue.rows,
        "leaves": len(catalogue.leaves),
        "leaves_by_order": _by_order(catalogue),
        "bytes": size,
        "bytes_per_row": round(size / catalogue.rows, 2) if catalogue.rows else None,
        "brightest_g_mag": catalogue.brightest_g_mag,
        "faintest_g_mag": catalogue.faintest_g_mag,
        "row_groups": sum(len(leaf.bands) for leaf in catalogue.leaves),
        "max_proper_motion_mas_yr": max(
            (leaf.max_proper_motion_mas_yr for leaf in catalogue.leaves), default=None
        ),
        "max_parallax_mas": max((leaf.max_parallax_mas for leaf in catalogue.leaves), default=None),
        "sources": len(catalogue.sources),
        "rows_in": sum(source["rows"] for source in catalogue.sources),
        "rejected": dict(catalogue.rejected),
        "facts": dict(catalogue.facts),
        "digest": catalogue.digest,
    }


def _by_order(catalogue: Catalogue) -> dict[str, int]:
    orders = sorted({leaf.order for leaf in catalogue.leaves})
    return {str(k): sum(leaf.order == k for leaf in catalogue.leaves) for k in orders}
