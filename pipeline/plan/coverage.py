"""How much of the frames the catalogue covers: a number, and the sentences that say it."""

from __future__ import annotations

from dataclasses import dataclass

from catalog_tools.documents import JsonObject

COVERED = 0.99  # less of a frame is a warning
GAP_G_MAG = 0.5  # a shallower part of the field is worth a remark


@dataclass(frozen=True)
class FieldCoverage:
    """Of the frames that the plan looks at: which fraction of each the main catalogue covers.

    catalogue : its name; source : what says so, None where nothing can; worst, mean : fractions,
    of the frame `worst_frame` and of all; complete_to_g_mag : the least G to which a covered part
    is complete, None without a known limit; from_rows : whether only the rows say so.
    """

    catalogue: str
    source: str | None
    worst: float
    mean: float
    worst_frame: int
    complete_to_g_mag: float | None = None
    from_rows: bool = False

    def as_dict(self) -> JsonObject:
        """Plain values for plan.json, report.json and the truth's metadata."""
        known = self.source is not None
        return {
            "catalogue": self.catalogue,
            "source": self.source,
            "worst_frame_fraction": self.worst if known else None,
            "mean_fraction": self.mean if known else None,
            "worst_frame": self.worst_frame if known else None,
            "complete_to_g_mag": self.complete_to_g_mag,
        }

    def warning(self) -> str | None:
        """What is missing from the product; None where it is covered, or unknown."""
        if self.source is None or self.worst >= COVERED:
            return None
        part = f"{100.0 * self.worst:.3g}%" if self.worst else "nothing"
        return (
            f"the catalogue {self.catalogue} covers {part} of frame {self.worst_frame} and "
            f"{100.0 * self.mean:.3g}% of all frames (by {self.source}): elsewhere in them no star "
            "of it is drawn"
        )

    def warning_of_no_star(self, stars_per_frame: int) -> str | None:
        """That frames without a star may lie beside the catalogue, where its rows alone tell."""
        if not self.from_rows or self.worst == 0.0 or stars_per_frame > 0:
            return None
        return (
            f"no star of {self.catalogue} lies in any frame looked at; that it covers them is "
            "judged from the rows around alone: the field may end before them"
        )

    def remark(self, faintest_g_mag: float | None, deepest_g_mag: float | None) -> str | None:
        """That nothing can be told, or that the field is shallower than catalogue and scene."""
        if self.source is None:
            return f"what {self.catalogue} covers cannot be found from its few rows"
        limit = self.complete_to_g_mag
        asked = deepest_g_mag if faintest_g_mag is None else faintest_g_mag
        if limit is None or asked is None or deepest_g_mag is None:
            return None
        if min(asked, deepest_g_mag) <= limit + GAP_G_MAG:
            return None
        return (
            f"parts of the field are covered to G = {limit:g} only (by {self.source}); "
            f"{self.catalogue} holds stars to {deepest_g_mag:.1f} elsewhere"
        )
