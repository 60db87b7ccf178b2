"""The plan: a resolved scene, and everything that was decided of how it is drawn."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.plan.checks import CheckCell
from pipeline.plan.coverage import FieldCoverage
from pipeline.plan.decision import Decision
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.tiles import Tile


@dataclass(frozen=True)
class Plan(ResolvedScene):
    """What is rendered and how; a value, made before anything is drawn.

    responses : with the engines that were chosen for the stars
    decisions : each with its reason and its bound; warnings : what the scene accepts though the
        product is wrong there, the sum of the bounds first; remarks : what else is reported
    coverage : of the frames by the main catalogue; None without stars
    stars_per_frame : that light the fullest, of a few
    shared_frames : so many frames in a row share one drawing of their stars
    brightest_e : light of the brightest source that the bounds are for; 0 where none is known
    """

    tiles: tuple[Tile, ...]
    checks: tuple[CheckCell, ...]
    decisions: tuple[Decision, ...]
    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    coverage: FieldCoverage | None = None
    stars_per_frame: int = 0
    shared_frames: int = 1
    brightest_e: float = 0.0

    def drawn_frame(self, frame: int) -> int:
        """The frame where the stars of a frame stand as they are drawn in it."""
        return frame - frame % self.shared_frames
