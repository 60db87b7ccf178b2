"""Populations: whole files of element sets with one default body; those in the field are drawn."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.strict import FilePath, Fraction, Strict
from pipeline.spec.targets.body import Body, Size, SphereBody

MOST_POPULATIONS, MOST_RULES, MOST_TOLD = 16, 100, 50

Count = Annotated[int, Field(ge=0)]


class SizeRule(Strict):
    """The sphere of objects whose name holds a text, in whatever case: `DEB`, `R/B`."""

    name_contains: str = Field(min_length=1, max_length=40)
    diameter_m: Size
    albedo: Fraction | None = Field(None, description="albedo; default: the body's")


class Screened(Strict):
    """What the screen of a file found; written by the program, and then the file is not read again.

    read : element sets; kept : of them, those that stand among the targets
    superseded : sets of objects that have another set nearer to the scene's epoch
    elsewhere : sets of objects that another population has: nearer to the epoch, or named before
    unreadable : sets that are malformed; failed : pairs of SGP4's error code and how many sets end
    left_out : the first of the unreadable and the failed, by name and reason
    unmet : rules that name no object of the file, a table of sizes with none of them
    """

    digest: str = Field(max_length=64, description="sha256 of the file")
    read: Count
    kept: Count
    superseded: Count
    elsewhere: Count = 0
    unreadable: Count
    failed: tuple[tuple[Count, Count], ...] = Field((), max_length=256)
    left_out: tuple[Annotated[str, Field(max_length=400)], ...] = Field((), max_length=MOST_TOLD)
    unmet: tuple[Annotated[str, Field(max_length=400)], ...] = Field((), max_length=2)
    half_angle_deg: float = Field(
        ge=0, le=180, description="half angle of the cone about the boresight [deg]"
    )
    dwell_s: float = Field(ge=0, description="length of all dwells together")


class Population(Strict):
    """A file of two-line elements, or of OMM as JSON, CSV, KVN or XML: each object a target.

    The body is that of all; a sphere's size follows the first rule whose text is in the object's
    name, and before that the table `sizes`: CSV with the columns norad_id and diameter_m, albedo or
    both (empty cells: the default). Targets are named after the population and the catalogue number
    """

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,39}$")
    path: FilePath
    body: Body
    rules: tuple[SizeRule, ...] = Field((), max_length=MOST_RULES)
    sizes: FilePath | None = None
    eclipse: bool = Field(True, description="dim them in the Earth's shadow")
    screened: Screened | None = None

    @model_validator(mode="after")
    def _sizes_are_of_spheres(self) -> Population:
        if (self.rules or self.sizes) and not isinstance(self.body, SphereBody):
            raise PydanticCustomError(
                "sphere", "allowed: sphere, where there are rules or sizes", {"field": "body.kind"}
            )
        return self
