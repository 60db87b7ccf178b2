"""Where the sensor points and how it tracks."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pipeline.spec.strict import Strict

RightAscension = Annotated[float, Field(ge=-360, le=360)]
Declination = Annotated[float, Field(ge=-90, le=90)]


class SiderealPointing(Strict):
    """Hold an ICRS direction at the centre of the frame, as a guided telescope does."""

    mode: Literal["sidereal"]
    boresight_ra_deg: RightAscension
    boresight_dec_deg: Declination
    roll_deg: float = Field(0.0, description="position angle of +y, from north through east")


class RatePointing(Strict):
    """Drift along a great circle at a constant rate, from the boresight at the epoch on."""

    mode: Literal["rate"]
    boresight_ra_deg: RightAscension
    boresight_dec_deg: Declination
    rate_ra_arcsec_s: float = Field(description="on the sky: includes cos dec")
    rate_dec_arcsec_s: float
    roll_deg: float = 0.0


class TargetPointing(Strict):
    """Keep a target at the centre of the frame (rate track)."""

    mode: Literal["target"]
    target: str
    roll_deg: float = 0.0


Pointing = Annotated[SiderealPointing | RatePointing | TargetPointing, Field(discriminator="mode")]
