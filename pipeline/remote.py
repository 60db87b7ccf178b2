"""Products at s3 URLs: rendered straight into an object store, in parts, gone on with, verified."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from catalog_tools.objects import Objects, is_url, open_objects
from catalog_tools.schedulers import open_scheduler
from catalog_tools.stores import Unreachable
from pipeline.errors import BadInput, Incomplete, NightglassError, TryLater
from pipeline.finish import finish
from pipeline.prepare import Prepared, catalogue_facts_of, prepare, summary_of
from pipeline.run import Listener, Options, Progress, draw, how_to_go_on, times_of
from pipeline.shares import WHOLE, Share, lacking
from pipeline.spec.load import load_scene, parse_text
from pipeline.spec.scene import Scene
from pipeline.store import layout
from pipeline.store import remote as store
from pipeline.store.lease import Lease, only_writer_of
from pipeline.store.product import Begun, Verdict

JOIN_TRIES, JOIN_AGAIN_S = 10, 1.0

__all__ = ["check_url", "is_url", "join_url", "render_to_url"]


def render_to_url(
    scene: Scene, url: str, options: Options | None = None, listen: Listener | None = None,
    share: Share = WHOLE,
) -> dict[str, Any]:  # fmt: skip
    """Render a scene, or a share of it, into a product below an s3 URL and return its report.

    The bits are those of a product in a folder. Of parts the one that ends last finishes the
    product; before that `complete` is false. Raises as `pipeline.run.render` does; Incomplete also
    where the store is not reached any more.
    """
    options, started = options or Options(), time.perf_counter()
    objects = open_objects(url)
    store.reached(objects, "-o")
    prepared = prepare(scene)
    whole = share.parts == 1
    with _held(objects, None if whole else share.name, options.wait_s) as (stage, lease):
        if options.replace:
            store.remove_remote(objects)
        resume = (options.resume if not options.replace else False) if whole else None
        begun = _begun(objects, stage, prepared, resume, share)
        if _is_sealed(objects, begun, share.tiles(prepared.plan)):
            return _stored_report(objects)
        store.unseal_remote(objects)
        objects.put(layout.PLAN, layout.to_json(summary_of(prepared)))
        drawing = time.perf_counter()
        with (
            _nothing_left_behind(objects, whole, lease),
            open_scheduler(options.scheduler, options.workers) as scheduler,
        ):
            draw(prepared, begun, scheduler, _watched(lease, listen), share)
            workers = scheduler.workers
        times = times_of(options, started, drawing, workers)
        if whole:
            return _finished(objects, stage, prepared, begun, times, lease)
    if lacking(prepared.plan, *store.present(objects, prepared.plan)):
        return share.told(prepared.plan, times)
    for _ in range(JOIN_TRIES):
        try:
            return join_url(url, prepared, times)
        except TryLater:  # another part is closing, or is finishing it
            time.sleep(JOIN_AGAIN_S)
    return share.told(prepared.plan, times)


def _watched(lease: Lease, listen: Listener | None) -> Listener:
    """Ends a drawing whose lease was lost, at the next tile."""

    def heard(progress: Progress) -> None:
        lease.check()
        if listen is not None:
            listen(progress)

    return heard


def join_url(
    url: str, prepared: Prepared | None = None, times: dict[str, Any] | None = None,
    scene: Path | None = None, wait_s: float = 0.0,
) -> dict[str, Any]:  # fmt: skip
    """Finish a product below an s3 URL whose parts are all done, and return its report.

    scene : default the one in the product; wait_s : for whoever writes it now
    Raises Incomplete where tiles are missing.
    """
    objects = open_objects(url, "PRODUCT")
    store.reached(objects, "PRODUCT")
    if prepared is None:
        with _explained(objects):
            prepared = prepare(load_scene(scene) if scene else _scene_of(objects))
    times = times or {"plan_s": 0.0, "draw_s": 0.0, "workers": 0, "scheduler": "parts"}
    with _held(objects, None, wait_s) as (stage, lease):
        begun = _begun(objects, stage, prepared, True, WHOLE)
        if _is_sealed(objects, begun, WHOLE.tiles(prepared.plan)):
            return _stored_report(objects)
        store.unseal_remote(objects)
        if lacks := lacking(prepared.plan, *store.present(objects, prepared.plan)):
            locks = objects.names(f"{layout.LOCK}-")
            raise Incomplete(lacks.told(url, prepared.plan, locks, begun.redrawn))
        return _finished(objects, stage, prepared, begun, times, lease)


def check_url(url: str) -> Verdict:
    """Verify a product below an s3 URL, as `pipeline.store.product.check` does one in a folder."""
    objects = open_objects(url, "PRODUCT")
    store.reached(objects, "PRODUCT")
    with TemporaryDirectory(prefix="nightglass-") as folder, _explained(objects):
        return store.check_remote(objects, Path(folder) / "product")


@contextmanager
def _held(objects: Objects, part: str | None, wait_s: float) -> Iterator[tuple[Path, Lease]]:
    """The product's lease, and a folder for its small files."""
    with (
        _explained(objects),
        TemporaryDirectory(prefix="nightglass-") as folder,
        only_writer_of(objects, part, wait_s) as lease,
    ):
        yield Path(folder) / "product", lease


@contextmanager
def _nothing_left_behind(objects: Objects, whole: bool, lease: Lease) -> Iterator[None]:
    """Remove a product of which nothing was finished when its drawing failed."""
    try:
        yield
    except NightglassError as error:
        kept = not whole or bool(objects.names(f"{layout.MARKERS}/"))
        if not kept and not lease.lost:
            store.remove_remote(objects)
        raise how_to_go_on(error, kept) from None


@contextmanager
def _explained(objects: Objects) -> Iterator[None]:
    try:
        yield
    except Unreachable as error:
        raise Incomplete(f"{error}; what is finished is kept (--resume)") from None
    except FileNotFoundError as error:  # an object or the bucket went while we worked
        raise Incomplete(f"{objects.url}: not found: {error}; what is finished is kept") from None


def _begun(
    objects: Objects, stage: Path, prepared: Prepared, resume: bool | None, share: Share
) -> Begun:
    plan, digest = prepared.plan, prepared.catalogue_digest
    return store.begin_remote(objects, stage, plan, digest, resume, share.mine(plan))


def _finished(
    objects: Objects, stage: Path, prepared: Prepared, begun: Begun, times: dict[str, Any],
    lease: Lease,
) -> dict[str, Any]:  # fmt: skip
    """Finish a product in a folder that holds all but most of its chunks, and put what it made."""
    lease.check()
    store.bring(objects, stage)
    report = finish(prepared.plan, catalogue_facts_of(prepared), begun, times)
    lease.check()
    store.publish(objects, stage)
    return report


def _is_sealed(objects: Objects, begun: Begun, tiles: int) -> bool:
    """Whether a product taken up is complete: sealed, and its `tiles` whole."""
    return objects.get(layout.COMPLETE) is not None and len(begun.done) == tiles


def _stored_report(objects: Objects) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(objects.get(layout.REPORT) or b"{}")
    return found | {"drawn_before": True}


def _scene_of(objects: Objects) -> Scene:
    from pipeline.spec.load import parse_scene

    content = objects.get(layout.SCENE)
    if content is None:
        raise BadInput("PRODUCT", objects.url, "a product begun by `nightglass render`")
    return parse_scene(parse_text(content, f"{objects.url}/{layout.SCENE}"))
