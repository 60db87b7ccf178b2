"""Who looks: a site on the ground, a satellite, or a fixed place in the solar system."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pipeline.spec.sky.atmosphere import Atmosphere
from pipeline.spec.strict import Strict
from pipeline.spec.targets.orbit import Orbit, Speed

PoleOffset = Annotated[float, Field(ge=-2.0, le=2.0)]


class GroundObserver(Strict):
    """A geodetic site (WGS 84)."""

    kind: Literal["ground"]
    latitude_deg: float = Field(ge=-90, le=90)
    longitude_deg: float = Field(ge=-360, le=360, description="east positive")
    height_m: float = Field(0.0, ge=-500, le=100_000)
    polar_motion_arcsec: tuple[PoleOffset, PoleOffset] | None = Field(
        None, description="x, y of the pole; absent: of the IERS tables at the epoch"
    )
    atmosphere: Atmosphere | None = Field(None, description="absent: none is in the way")


class OrbitObserver(Strict):
    """A satellite on an orbit of its own."""

    kind: Literal["orbit"]
    orbit: Orbit


Distance = Annotated[float, Field(ge=-1e5, le=1e5)]


class FixedObserver(Strict):
    """A place and velocity relative to the solar-system barycentre, ICRS axes, both constant."""

    kind: Literal["fixed"]
    position_au: tuple[Distance, Distance, Distance]
    velocity_m_s: Speed = (0.0, 0.0, 0.0)


Observer = Annotated[GroundObserver | OrbitObserver | FixedObserver, Field(discriminator="kind")]
