"""Truth tables of a product: joined, and its light judged, while frames are still being drawn."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import FrameStars, concatenate, seen_ends
from pipeline.execute.truth import star_truth, target_truth
from pipeline.lazily import arrow
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.responses import ResponsePlan
from pipeline.plan.response.sources import (
    SourceBounds,
    of_stars,
    of_targets,
    stars_known,
    targets_known,
)
from pipeline.store.product import truth_kinds
from pipeline.store.truth import TruthTable

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow as pa

SOURCES = ("stars", "targets")  # tables of truth whose light is drawn as such
COLUMNS = ("frame", "x_px", "y_px", "electrons")
COLUMNS_OF_TARGETS = (
    "x_start_px", "y_start_px", "x_end_px", "y_end_px", "radius_px", "extended"
)  # fmt: skip
COVERAGE_KEY = "nightglass:coverage"  # in the schema's metadata of truth/stars.parquet


class Truths:
    """The truth tables of a product, joined from the frames' parts, and what its sources err by."""

    def __init__(self, plan: Plan, product: Path, files: ExitStack) -> None:
        self._plan, self._product, self._files = plan, product, files
        self._found = {kind: SourceBounds() for kind in SOURCES}

    @cached_property
    def _tables(self) -> dict[str, TruthTable]:
        plan, product = self._plan, self._product
        return {
            kind: TruthTable(product, kind, plan.frames, _empty(plan, kind), self._files)
            for kind in truth_kinds(plan)
        }

    @contextmanager
    def meanwhile(self) -> Iterator[Callable[[], None]]:
        """Within it tables are joined by a thread, as far as parts are there when the function
        that it yields is called. What fails is told when they are ended."""
        last: Future[None] = Future()
        last.set_result(None)

        def look() -> None:
            nonlocal last
            if last.done() and last.exception() is None:
                last = thread.submit(self._take)

        with ThreadPoolExecutor(1) as thread:
            yield look
        last.result()

    def end(self) -> tuple[dict[str, int], SourceBounds]:
        """Close the tables; rows of each, and what drawing errs by at most, for all sources that
        were drawn: some frames after the other. Raises Damaged for parts that are not whole."""
        for kind, table in self._tables.items():
            table.end(partial(self._hear, kind))
        self._files.close()
        rows = {kind: table.rows for kind, table in self._tables.items()}
        return rows, self._found["stars"].together(self._found["targets"])

    def _take(self) -> None:
        for kind, table in self._tables.items():
            table.take(partial(self._hear, kind))

    def _hear(self, kind: str, rows: pa.Table) -> None:
        if kind in SOURCES:
            self._found[kind] = self._found[kind].worst(_bounds(self._plan, kind, rows))


@contextmanager
def truths_of(plan: Plan, product: Path) -> Iterator[Truths]:
    """The truth tables of a product; where the block ends with an error, nothing stays of them."""
    with ExitStack() as files:
        yield Truths(plan, product, files)


def _bounds(plan: Plan, kind: str, rows: pa.Table) -> SourceBounds:
    """What drawing the sources of some frames errs by at most.

    Truth has what pixels collect of a source, bounds are of the light that falls.
    """
    names = COLUMNS if kind == "stars" else (*COLUMNS, *COLUMNS_OF_TARGETS)
    c = {name: rows[name].to_numpy() for name in names}
    c["electrons"] = c["electrons"] / plan.responses.blur.fill_factor
    return _of_stars(plan.responses, c) if kind == "stars" else _of_targets(plan, c)


def _of_stars(r: ResponsePlan, c: dict[str, np.ndarray]) -> SourceBounds:
    return of_stars(r, stars_known(r, c["frame"], c["x_px"], c["y_px"], c["electrons"]))


def _of_targets(plan: Plan, c: dict[str, np.ndarray]) -> SourceBounds:
    """Of the targets whose light reaches the frame; truth has the others, too."""
    r, (rows, columns) = plan.responses, plan.scene.sensor.shape
    x, y = (seen_ends(*(c[f"{a}_{at}px"] for at in ("start_", "", "end_"))) for a in "xy")
    ends = np.array([x[0], y[0], x[1], y[1]])
    size = np.nan_to_num(c["radius_px"])
    beyond = plan.halo_px + r.reach_core_px + size
    with np.errstate(invalid="ignore"):
        (x0, x1), (y0, y1) = (np.sort(ends[i::2], axis=0) for i in (0, 1))
        near = (x1 > -beyond) & (x0 < columns + beyond) & (y1 > -beyond) & (y0 < rows + beyond)
    near &= c["electrons"] > 0.0
    light_e, size, extended = (v[near] for v in (c["electrons"], size, c["extended"]))
    known = c["frame"][near], ends[:, near], light_e, size, extended
    return of_targets(r, targets_known(r, (rows, columns), *known))


def _empty(plan: Plan, kind: str) -> pa.Table:
    """A truth table without rows, for its schema."""
    pa = arrow()
    if kind == "cosmic_rays":
        from pipeline.physics.cosmic_rays.frame import no_truth

        return pa.table(no_truth())
    g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
    if kind == "targets":
        return pa.table(target_truth(plan, g)).slice(0, 0)
    stars = pa.table(star_truth(plan, g, concatenate([], FrameStars)))
    if plan.coverage is None:
        return stars
    return stars.replace_schema_metadata({COVERAGE_KEY: json.dumps(plan.coverage.as_dict())})
