"""What a product is, finished or not, as plain values: read from its small files alone."""

from __future__ import annotations

from pathlib import Path

from catalog_tools.documents import JsonObject
from pipeline.spec.load import load_scene
from pipeline.store import layout
from pipeline.store.markers import markers_present
from pipeline.store.product import begun_tiles
from pipeline.store.seal import check_complete


def tiles_done(product: Path) -> tuple[int, int]:
    """How many tiles of a product are kept, and of how many. BadInput where there is none."""
    if not (product / layout.BEGUN).is_file():
        raise layout.no_product(product)
    return len(list(markers_present(product))), begun_tiles(product)


def describe(product: Path) -> JsonObject:
    """State, size, content, origin of a product; what only a finished one has is None before.

    Raises BadInput where there is none, Damaged.
    """
    done, total = tiles_done(product)
    complete = (product / layout.COMPLETE).is_file()
    if complete:
        check_complete(product)
    plan = _read(product / layout.PLAN)
    report = _read(product / layout.REPORT) if complete else {}
    scene = _scene(product)
    return {
        "scene": scene.get("name"),
        "state": "complete" if complete else "not complete",
        "tiles": done,
        "tiles_expected": total,
        "epoch": scene.get("epoch"),
        "seed": scene.get("seed"),
        "frames": plan.get("frames"),
        "shape": plan.get("shape"),
        "field_deg": plan.get("field_deg"),
        "layers": layout.layers_in(product),
        "targets": plan.get("targets"),
        "catalogue": (plan.get("catalogue") or {}).get("name"),
        "warnings": plan.get("warnings", []),
        "truth_rows": report.get("truth_rows"),
        "bytes": sum(p.stat().st_size for p in product.rglob("*") if p.is_file()),
        "version": report.get("versions", {}).get("nightglass"),
        "content_digest": report.get("content_digest"),
    }


def _read(path: Path) -> JsonObject:
    return layout.read_json(path) if path.is_file() else {}


def _scene(product: Path) -> JsonObject:
    path = product / layout.SCENE
    return load_scene(path).as_dict() if path.is_file() else {}
