"""The one route: a scene prepared, its missing tiles drawn, the product finished.

A whole render, one part of several and a join differ in their share; a folder and an s3 URL in
their place.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from catalog_tools.documents import JsonObject
from catalog_tools.engine.addresses import check_scheduler
from catalog_tools.engine.ahead import cores
from catalog_tools.engine.schedulers import Scheduler, open_scheduler
from pipeline.errors import BadInput, Incomplete, NightglassError, TryLater
from pipeline.route.draw import Listener, Progress, draw
from pipeline.route.finish import finish
from pipeline.route.prepare import (
    Prepared,
    catalogue_facts_of,
    check_cost,
    check_room,
    prepare,
    summary_of,
)
from pipeline.route.shares import WHOLE, Share, lacking
from pipeline.route.truths import Truths, truths_of
from pipeline.spec.load import load_scene
from pipeline.spec.scene import Scene
from pipeline.store import layout
from pipeline.store.place import Claim, Place, Writing
from pipeline.store.places import place_for
from pipeline.store.product import Verdict

JOIN_AGAIN_S = 1.0
NOT_DRAWN = {"plan_s": 0.0, "draw_s": 0.0, "workers": 0, "scheduler": "parts"}


@dataclass(frozen=True)
class Options:
    """How to render; none of it changes a bit of the result.

    scheduler : threads, synchronous, processes, or an address; workers : None for all cores
    resume : go on with an unfinished product; replace : remove what stands at the path first
    wait_s : how long another render of the same product is waited for
    most_cpu_s : a scene or sweep predicted to take more is refused before anything is drawn
    most_memory_mb : likewise of memory; None: what this machine has free, unless others draw
    """

    scheduler: str = "threads"
    workers: int | None = None
    resume: bool = False
    replace: bool = False
    wait_s: float = 0.0
    most_cpu_s: float | None = None
    most_memory_mb: float | None = None

    @property
    def processes(self) -> int:
        """How many processes of this machine draw; 0 where those of others do."""
        own = {"threads": 1, "synchronous": 1, "processes": self.workers or cores()}
        return own.get(self.scheduler, 0)

    @property
    def threads(self) -> int:
        """How many threads of each of them draw."""
        return (self.workers or cores()) if self.scheduler == "threads" else 1


def render(
    scene: Scene,
    product: Path | str,
    options: Options | None = None,
    listen: Listener | None = None,
    share: Share | None = None,
) -> JsonObject:
    """Render a scene, or a part of it, into a product and return its report.

    product : a folder, or an s3 URL
    share : the part to draw beside other processes, which draw the others; None for all of it.
        One that was cut off goes on when it is run again. The one that ends last finishes the
        product and returns its report; before that `complete` is false.
    Raises BadInput for a scene or path that cannot be used, Damaged for a damaged catalogue,
    Incomplete where work stopped before everything was done (what is done is kept) or the store is
    not reached any more, DiskFull where there was no room, TryLater where another render
    is writing the product.
    """
    options, mine, started = options or Options(), share or WHOLE, time.perf_counter()
    _check_options(options)
    place = place_for(product, "-o")
    with place.explained():
        if share is None:
            place.check_free(options.resume, options.replace)
        prepared = prepare(scene)
        summary = summary_of(prepared)
        check_cost(scene, summary, options.most_cpu_s)
        if options.processes or options.most_memory_mb:
            check_room(prepared, options.most_memory_mb, options.processes, options.threads)
        times: JsonObject = {"plan_s": time.perf_counter() - started}
        with ExitStack() as drawing:
            # Before an old product is removed; else not before there is something to draw.
            early = _opened(options, place, share, drawing) if options.replace else None
            with place.written(_claim(prepared, options, share)) as writing:
                if writing.is_sealed(mine.tiles(prepared.plan)):
                    return writing.report()
                writing.unseal()
                writing.put_plan(layout.to_json(summary))
                begun = Progress(len(writing.begun.done), mine.tiles(prepared.plan), "wait")
                with truths_of(prepared.plan, writing.begun.path) as truths:
                    with _explained(place, writing, share), drawing:
                        look = drawing.enter_context(_joining(truths, share))
                        heard = partial(_heard, writing, look, listen)
                        scheduler = early or drawing.enter_context(_awaited(options, begun, heard))
                        draw(prepared, writing.begun, scheduler, heard, mine)
                    times["draw_s"] = time.perf_counter() - started - times["plan_s"]
                    times |= {"workers": scheduler.workers, "scheduler": options.scheduler}
                    if share is None:
                        return _finished(prepared, writing, truths, times)
        return _joined_by_the_last(place, prepared, share, times)


def _check_options(options: Options) -> None:
    """Raise BadInput for options that cannot be used, before an old product is removed."""
    if options.resume and options.replace:
        raise BadInput("--replace", "with --resume", "one of the two")
    workers = options.workers
    if workers is not None and not (isinstance(workers, int) and workers >= 1):
        raise BadInput("--workers", workers, "a whole number from 1")
    check_scheduler(str(options.scheduler))


def join(product: Path | str, scene: Path | None = None, wait_s: float = 0.0) -> JsonObject:
    """Finish a product whose parts are all done, and return its report.

    scene : default the one in the product; wait_s : for whoever writes it now
    Raises Incomplete where tiles are missing, TryLater where a part is still at work.
    """
    place = place_for(product, "PRODUCT")
    with place.explained():
        place.check_begun()
        prepared = prepare(load_scene(scene) if scene else place.scene())
        return _joined(place, prepared, NOT_DRAWN, wait_s)


def check(product: Path | str) -> Verdict:
    """Verify a product, in a folder or below an s3 URL: every tile by its marker, every table."""
    place = place_for(product, "PRODUCT")
    with place.explained():
        return place.verdict()


def _claim(prepared: Prepared, options: Options, share: Share | None) -> Claim:
    plan, digest = prepared.plan, prepared.catalogue_digest
    if share is None:
        return Claim(plan, digest, options.resume, options.replace, options.wait_s)
    return Claim(
        plan,
        digest,
        wait_s=options.wait_s,
        replace=options.replace,
        part=share.name,
        mine=share.mine(plan),
    )


def _scheduler(options: Options) -> AbstractContextManager[Scheduler]:
    return open_scheduler(options.scheduler, options.workers)


def _awaited(
    options: Options, begun: Progress, heard: Listener
) -> AbstractContextManager[Scheduler]:
    """The scheduler; where its workers may be in a queue, maybe for hours, that is told."""
    if not options.processes:
        heard(begun)
    return _scheduler(options)


def _opened(options: Options, place: Place, share: Share | None, stack: ExitStack) -> Scheduler:
    """The scheduler, open as long as the stack; where none answers, how to go on."""
    try:
        return stack.enter_context(_scheduler(options))
    except NightglassError as error:
        raise _how_to_go_on(error, _is_kept(place, share), share is None) from None


def _joining(truths: Truths, share: Share | None) -> AbstractContextManager[Callable[[], None]]:
    """The truth of a whole render is joined meanwhile; that of parts by the last of them."""
    return truths.meanwhile() if share is None else nullcontext(lambda: None)


def _heard(
    writing: Writing,
    look: Callable[[], None],
    listen: Listener | None,
    progress: Progress,
) -> None:
    """The place is still ours, what is there is joined, and whoever listens hears of it."""
    writing.check()
    look()
    if listen is not None:
        listen(progress)


@contextmanager
def _explained(place: Place, writing: Writing, share: Share | None) -> Iterator[None]:
    """Of an error that ends the drawing: what it leaves behind, and how to go on."""
    try:
        yield
    except (NightglassError, MemoryError, RuntimeError) as error:  # the last: of threads
        kept = _is_kept(place, share)
        if not kept:
            writing.discard()  # nothing was finished, so nothing is left behind
        raise _how_to_go_on(error, kept, share is None) from None


def _is_kept(place: Place, share: Share | None) -> bool:
    """Whether what is at a place stays there after an error; a part's may be others'."""
    return share is not None or place.tiles() > 0


def _how_to_go_on(error: Exception, kept: bool, whole: bool) -> Exception:
    """An error that ended the drawing; where it says to try later, also by which command."""
    if not isinstance(error, TryLater):
        return error
    again = "go on with --resume" if whole else "run the part again"
    told = f"what is finished is kept: {again}" if kept else "nothing was finished yet"
    return TryLater(f"{error}; {told}")


def _finished(
    prepared: Prepared, writing: Writing, truths: Truths, times: JsonObject
) -> JsonObject:
    facts = catalogue_facts_of(prepared)
    with writing.finishing():
        return finish(prepared.plan, facts, writing.begun, truths, times)


def _joined_by_the_last(
    place: Place, prepared: Prepared, share: Share, times: JsonObject
) -> JsonObject:
    """The product's report where this part was the last, else what is told of the part."""
    plan = prepared.plan
    for left in reversed(range(place.join_tries)):
        if place.tiles() < WHOLE.tiles(plan):
            break
        try:
            return _joined(place, prepared, times)
        except TryLater:  # another part is closing, or is finishing it
            time.sleep(JOIN_AGAIN_S if left else 0.0)
    return share.told(plan, times)


def _joined(place: Place, prepared: Prepared, times: JsonObject, wait_s: float = 0.0) -> JsonObject:
    plan = prepared.plan
    claim = Claim(plan, prepared.catalogue_digest, resume=True, wait_s=wait_s)
    with place.written(claim) as writing:  # every chunk against its marker
        begun = writing.begun
        if writing.is_sealed(WHOLE.tiles(plan)):
            return writing.report()
        if lacks := lacking(plan, begun.done, begun.truth_done):
            if begun.redrawn:  # else a seal may hold: a file system may show others' files late
                writing.unseal()
            told = lacks.told(place.name, plan, writing.locks(), begun.redrawn)
            raise Incomplete(told)
        writing.unseal()
        with truths_of(plan, begun.path) as truths:
            return _finished(prepared, writing, truths, times)
