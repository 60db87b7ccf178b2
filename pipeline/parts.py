"""Array mode: a product rendered in parts by processes that need no scheduler, then joined."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

from catalog_tools.schedulers import open_scheduler
from pipeline.errors import BadInput, Incomplete, TryLater
from pipeline.finish import finish, stored_report
from pipeline.prepare import Prepared, catalogue_facts_of, prepare, summary_of
from pipeline.run import Listener, Options, draw, times_of, unseal
from pipeline.shares import WHOLE, Share, lacking
from pipeline.spec.load import load_scene
from pipeline.spec.scene import Scene
from pipeline.store import layout
from pipeline.store.markers import markers_present
from pipeline.store.product import begin, is_sealed, make_together

MOST_PARTS = 1_000_000


def parse_part(text: str) -> Share:
    """`k/n` as part k of n, counted from 1."""
    found = re.fullmatch(r"([0-9]{1,7})/([0-9]{1,7})", text)
    if not found or not 1 <= int(found[1]) <= int(found[2]) <= MOST_PARTS:
        raise BadInput("--part", text, f"k/n, with 1 <= k <= n <= {MOST_PARTS}, such as 3/16")
    return Share(int(found[1]), int(found[2]))


def render_part(
    scene: Scene, product: Path, share: Share, options: Options | None = None,
    listen: Listener | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Render one part into a product that other processes may be writing too.

    A part that was cut off goes on when it is run again; others are not touched. The one that
    ends last finishes the product and returns its report; else `complete` is false.
    """
    options, started = options or Options(), time.perf_counter()
    prepared = prepare(scene)
    with layout.full_disk(product):
        return _render_share(prepared, product, share, options, listen, started)


def _render_share(
    prepared: Prepared, product: Path, share: Share, options: Options, listen: Listener | None,
    started: float,
) -> dict[str, Any]:  # fmt: skip
    """A part, prepared: drawn, and the product finished where it was the last."""
    plan, digest = prepared.plan, prepared.catalogue_digest
    make_together(product, plan, digest)
    with layout.only_writer(product, share.name, options.wait_s):
        begun = begin(product, plan, digest, True, share.mine(plan))
        if is_sealed(begun, share.tiles(plan)):
            return stored_report(begun)
        unseal(product)
        if not (product / layout.PLAN).is_file():
            summary = layout.to_json(summary_of(prepared))
            layout.write_atomically(product / layout.PLAN, summary)
        drawing = time.perf_counter()
        with open_scheduler(options.scheduler, options.workers) as scheduler:
            draw(prepared, begun, scheduler, listen, share)
            workers = scheduler.workers
    times = times_of(options, started, drawing, workers)
    if WHOLE.tiles(plan) > sum(1 for _ in markers_present(product)):
        return share.told(plan, times)
    try:
        return _finish(prepared, product, times)
    except TryLater:  # another part is still at work, or is finishing it
        return share.told(plan, times)


def join(product: Path, scene: Path | None = None, wait_s: float = 0.0) -> dict[str, Any]:
    """Finish a product whose parts are all done, and return its report.

    scene : default the one in the product; wait_s : for whoever writes it now
    Raises Incomplete where tiles are missing.
    """
    if not (product / layout.BEGUN).is_file():
        raise BadInput("PRODUCT", str(product), "a product that parts were rendered into")
    prepared = prepare(load_scene(scene or product / layout.SCENE))
    times = {"plan_s": 0.0, "draw_s": 0.0, "workers": 0, "scheduler": "parts"}
    return _finish(prepared, product, times, wait_s)


def _finish(
    prepared: Prepared, product: Path, times: dict[str, Any], wait_s: float = 0.0
) -> dict[str, Any]:
    plan = prepared.plan
    with layout.full_disk(product), layout.only_writer(product, wait_s=wait_s):
        # Every chunk against its marker.
        begun = begin(product, plan, prepared.catalogue_digest, resume=True)
        if is_sealed(begun, WHOLE.tiles(plan)):
            return stored_report(begun)
        unseal(product)
        if lacks := lacking(plan, begun.done, begun.truth_done):
            locks = (path.name for path in product.glob(f"{layout.LOCK}-*"))
            raise Incomplete(lacks.told(str(product), plan, locks, begun.redrawn))
        return finish(plan, catalogue_facts_of(prepared), begun, times)
