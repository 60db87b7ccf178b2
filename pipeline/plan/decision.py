"""One line of the plan: something kept or omitted, why, and what it may cost."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Decision:
    """One component or approximation, kept or omitted.

    error_bound_e : upper bound of what it may change in a pixel [e-]; None where it is no
        approximation or no bound is known (the reason then says so)
    error_bound_sigma : the same over the noise of a pixel that holds no source
    seconds_saved : estimated, per frame; None where nothing is saved
    bound, unit : upper bound of what it may change where that is no pixel's charge: a place, a
        share of light, a length
    """

    component: str
    kept: bool
    reason: str
    error_bound_e: float | None = None
    error_bound_sigma: float | None = None
    seconds_saved: float | None = None
    bound: float | None = None
    unit: str | None = None
