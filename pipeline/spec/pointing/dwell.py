"""Dwells: several stretches of frames, each with its own pointing and exposures."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.pointing.pointing import Pointing
from pipeline.spec.strict import Strict

MOST_DWELLS = 1000
Cadence_s = Annotated[float, Field(gt=0, le=1e9)]
Wait_s = Annotated[float, Field(ge=0, le=1e9)]
Exposure_s = Annotated[float, Field(ge=0, le=1e5)]


class Slew(Strict):
    """The turn from the dwell before; it starts when that one's last exposure ends.

    profile : minimum_jerk, 10 s^3 - 15 s^4 + 6 s^5; bang_bang, constant acceleration then braking
    """

    duration_s: Annotated[float, Field(gt=0, le=1e6)]
    profile: Literal["minimum_jerk", "bang_bang"] = "minimum_jerk"


class Settle(Strict):
    """An oscillation after the slew: amplitude exp(-zeta w t) sin(w sqrt(1 - zeta^2) t).

    direction_deg : direction of its motion in the frame, from +x towards +y
    """

    amplitude_arcsec: Annotated[float, Field(ge=0, le=1e6)]
    frequency_hz: Annotated[float, Field(gt=0, le=1e6)]
    damping: Annotated[float, Field(ge=0, lt=1)] = 0.02
    direction_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0


class Dwell(Strict):
    """One dwell; what it does not say is taken from the scene's `pointing` and `exposure`.

    start_s : start of its first exposure after the epoch [s]; default: when the slew is over and
        `wait_s` has passed. Given earlier than that, its first frames fall into the slew.
    integration_s : exposure time, or several that its frames take in turn; 0: bias frames
    """

    pointing: Pointing | None = None
    integration_s: (
        Exposure_s | Annotated[tuple[Exposure_s, ...], Field(min_length=1, max_length=1000)] | None
    ) = None
    frames: Annotated[int, Field(ge=1, le=100_000)] | None = None
    cadence_s: Cadence_s | None = Field(
        None, description="time from frame to frame [s]; default: each follows the one before"
    )
    start_s: Wait_s | None = None
    wait_s: Wait_s = 0.0
    slew: Slew | None = None
    settle: Settle | None = None

    @model_validator(mode="after")
    def _cadence_holds_exposures(self) -> Dwell:
        times = self.integration_s
        longest = max(times) if isinstance(times, tuple) else times
        if self.cadence_s is not None and longest is not None and self.cadence_s < longest:
            raise PydanticCustomError(
                "cadence",
                "allowed: at least integration_s = {t}",
                {"t": longest, "field": "cadence_s"},
            )
        if self.start_s is not None and self.wait_s:
            raise PydanticCustomError(
                "wait", "allowed: 0 where start_s is given", {"field": "wait_s"}
            )
        random = self.pointing is not None and self.pointing.attitude is not None
        if random and self.pointing.attitude.random:  # type: ignore[union-attr]
            raise PydanticCustomError(
                "attitude",
                "allowed in a dwell: drift; jitter and modes belong to the scene's own pointing",
                {"field": "pointing.attitude"},
            )
        return self


Dwells = Annotated[tuple[Dwell, ...], Field(min_length=1, max_length=MOST_DWELLS)]
