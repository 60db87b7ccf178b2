"""Parts of a product: which tiles each of several processes draws, and what it tells of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.plan.plan import Plan
from pipeline.store.product import truth_parts

MOST_PARTS = 1_000_000


@dataclass(frozen=True)
class Share:
    """The tiles of part k of n: of all tiles, frame by frame, an even and unbroken share."""

    part: int
    parts: int

    @property
    def name(self) -> str:
        """Of the lock or lease of the one process that draws it."""
        return f"part-{self.part}-of-{self.parts}"

    def span(self, plan: Plan) -> tuple[int, int]:
        """Number of the first tile, and of the one after the last."""
        total = len(plan.tiles) * plan.frames
        return (self.part - 1) * total // self.parts, self.part * total // self.parts

    def tiles(self, plan: Plan) -> int:
        """How many tiles it has."""
        first, end = self.span(plan)
        return end - first

    def holds(self, plan: Plan, frame: int, tile: int) -> bool:
        """Whether tile number `tile` of a frame is in it."""
        first, end = self.span(plan)
        return first <= frame * len(plan.tiles) + tile < end

    def mine(self, plan: Plan) -> Callable[[int, int, int], bool]:
        """Whether a tile (frame, row, column) is in it."""
        numbers = {(t.row, t.column): i for i, t in enumerate(plan.tiles)}
        return lambda frame, row, column: self.holds(plan, frame, numbers.get((row, column), -1))

    def told(self, plan: Plan, times: JsonObject) -> JsonObject:
        """The report of a part that is done while others are not."""
        return {
            "part": f"{self.part}/{self.parts}",
            "tiles": self.tiles(plan),
            "complete": False,
            "seconds": times,
        }


WHOLE = Share(1, 1)


def parse_part(text: str) -> Share:
    """`k/n` as part k of n, counted from 1."""
    found = re.fullmatch(r"([0-9]{1,7})/([0-9]{1,7})", text)
    if not found or not 1 <= int(found[1]) <= int(found[2]) <= MOST_PARTS:
        raise BadInput("--part", text, f"k/n, with 1 <= k <= n <= {MOST_PARTS}, such as 3/16")
    return Share(int(found[1]), int(found[2]))


@dataclass(frozen=True)
class Lacking:
    """What a product lacks: places of tiles (frame, row, column) and of truth (kind, frame)."""

    tiles: frozenset[tuple[int, int, int]]
    truth: frozenset[tuple[str, int]]

    def __bool__(self) -> bool:
        return bool(self.tiles or self.truth)

    def told(self, product: str, plan: Plan, locks: Iterable[str], redrawn: Iterable[str]) -> str:
        """The message of a join; locks : names of the parts' locks, redrawn : what was damaged."""
        damaged = "; ".join(tuple(redrawn)[:5])
        return (
            f"{product}: {len(self.tiles)} tile(s) and {len(self.truth)} truth part(s) are "
            f"missing: run {self._whose(plan, locks)} again, then `nightglass join`"
            + (f"; damaged: {damaged}" if damaged else "")
        )

    def _whose(self, plan: Plan, locks: Iterable[str]) -> str:
        """The parts that lack something; the frames, where parts of one number are not known."""
        counts = {found[1] for lock in locks if (found := re.search(r"part-\d+-of-(\d+)", lock))}
        frames = sorted({t[0] for t in self.tiles} | {t[1] for t in self.truth})
        if len(counts) != 1:
            return f"the parts of frame(s) {_first(frames)}"
        numbers = {(t.row, t.column): i for i, t in enumerate(plan.tiles)}
        count, each = int(counts.pop()), len(plan.tiles)
        places = {frame * each + numbers[row, column] for frame, row, column in self.tiles}
        places |= {frame * each for _, frame in self.truth}
        total = each * plan.frames
        parts = sorted({-(-(place + 1) * count // total) for place in places})
        return f"part(s) {_first([f'{part}/{count}' for part in parts])}"


def _first(names: Sequence[object]) -> str:
    shown = ", ".join(map(str, names[:20]))
    return shown if len(names) <= 20 else f"{shown} and {len(names) - 20} more"


def lacking(plan: Plan, tiles: Container[object], truth: Container[object]) -> Lacking:
    """What a product lacks that has these tiles and parts of truth."""
    places = ((frame, t.row, t.column) for frame in range(plan.frames) for t in plan.tiles)
    return Lacking(
        frozenset(p for p in places if p not in tiles),
        frozenset(p for p in truth_parts(plan) if p not in truth),
    )
