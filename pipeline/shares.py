"""Parts of a product: which tiles each of several processes draws, and what it tells of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pipeline.plan.scene_plan import Plan


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

    def told(self, plan: Plan, times: dict[str, Any]) -> dict[str, Any]:
        """The report of a part that is done while others are not."""
        return {
            "part": f"{self.part}/{self.parts}", "tiles": self.tiles(plan), "complete": False,
            "seconds": times,
        }  # fmt: skip


WHOLE = Share(1, 1)


def still_missing(product: str, tiles: int, truth: int, redrawn: tuple[str, ...]) -> str:
    """Message of a join whose parts are not all there; redrawn : what was found damaged."""
    damaged = f"; damaged: {'; '.join(redrawn[:5])}" if redrawn else ""
    return (
        f"{product}: {tiles} tile(s) and {truth} truth part(s) are missing: run the parts "
        f"that were cut off again, then `nightglass join`{damaged}"
    )
