"""Stray light: a point-source transmittance curve, and which bodies shine through it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.strict import FilePath, Strict


class TablePst(Strict):
    """A curve from a CSV file: angle_deg, pst; both above 0, angles ascending to 180 at most.

    holds_transmission : the curve already holds the optics' transmission, as a measured or traced
        one does; else it is multiplied by `sensor.transmission`. The band and the quantum
        efficiency always are.
    beyond : what holds past its last row: `zero`, `clip` (its last value) or `refuse`. Default:
        zero where it reaches 90 degrees, else refuse.
    """

    kind: Literal["table"]
    path: FilePath
    holds_transmission: bool = True
    beyond: Literal["refuse", "zero", "clip"] | None = None


class HarveyPst(Strict):
    """Scatter by N mirrors with a Harvey BSDF b0 [1 + (sin(angle) / l)^2]^(s/2), up to 90 degrees.

    The curve is N pi / (4 F^2) cos(angle) times that; F is the sensor's focal length over aperture.
    """

    kind: Literal["harvey"]
    b0_per_sr: float = Field(gt=0, le=1e9)
    shoulder: float = Field(gt=0, le=1, description="l: sine of the angle where it begins to fall")
    slope: float = Field(lt=0, ge=-6, description="s: how steeply it falls")
    mirrors: int = Field(1, ge=1, le=20)


Pst = Annotated[TablePst | HarveyPst, Field(discriminator="kind")]


class StrayLight(Strict):
    """Light of bodies outside the field that the optics scatter onto the focal plane.

    earth : the Earth's sunlit disc; a site on the ground sees none
    earth_albedo : albedo of a Lambertian Earth: a number, or the path of a map (CSV or NPY: rows
        from -90 to 90 degrees of latitude, columns from -180 to 180 of longitude, equal cells, each
        value that of its cell's middle)
    exclusion_deg : least angle from a line of sight to a lit body; to the Earth's limb.
        Default, and never less: the first angle of the curve's table; without a table 0
    inside : what happens at smaller angles: `refuse` the scene, `extrapolate` the curve, or `clip`
        it there
    """

    pst: Pst
    sun: bool = True
    moon: bool = True
    earth: bool = True
    earth_albedo: Annotated[float, Field(ge=0, le=1)] | FilePath = 0.3
    exclusion_deg: Annotated[float, Field(ge=0, le=90)] | None = None
    inside: Literal["refuse", "extrapolate", "clip"] = "refuse"

    @model_validator(mode="after")
    def _some_source(self) -> StrayLight:
        if not (self.sun or self.moon or self.earth):
            raise PydanticCustomError("sources", "allowed: at least one of sun, moon and earth")
        return self
