"""Where an observer or a target moves: two-line elements or a state vector."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pipeline.spec.strict import Strict

Metres = Annotated[float, Field(ge=-1e13, le=1e13)]
MetresPerSecond = Annotated[float, Field(ge=-1e9, le=1e9)]
Place = tuple[Metres, Metres, Metres]
Speed = tuple[MetresPerSecond, MetresPerSecond, MetresPerSecond]


class TleOrbit(Strict):
    """A NORAD two-line element set, propagated by SGP4 (WGS 72)."""

    kind: Literal["tle"]
    line1: str = Field(max_length=80)
    line2: str = Field(max_length=80)


class StateOrbit(Strict):
    """A geocentric position and velocity in GCRS axes at `epoch` (default: the scene's epoch)."""

    kind: Literal["state"]
    position_m: Place
    velocity_m_s: Speed
    epoch: str | None = Field(None, max_length=40)


Orbit = Annotated[TleOrbit | StateOrbit, Field(discriminator="kind")]
