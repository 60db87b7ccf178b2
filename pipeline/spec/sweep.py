"""The sweep file: a base scene, axes over its fields, a design, and what is measured."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.spec.strict import Strict

SCHEMA = "nightglass/sweep/1"
METRICS = ("snr", "background", "limiting_magnitude", "saturation", "detection", "timing")
MOST_POINTS, MOST_AXES, MOST_VALUES = 10_000_000, 32, 100_000
MOST_WHOLE = 2**50  # of an axis of whole numbers: doubles and their shares hold these exactly
MOST_DRAWN = 40_000_000  # numbers of a Latin hypercube: it is drawn whole
FIXED = ("schema", "name", "output")  # what every point has in common

DottedField = Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*$", max_length=200)]


class ListAxis(Strict):
    """The values of one field, as they would stand in the scene."""

    kind: Literal["list"] = "list"
    field: DottedField
    values: tuple[Any, ...] = Field(min_length=1, max_length=MOST_VALUES)

    @field_validator("values", mode="before")
    @classmethod
    def _any_values(cls, value: object) -> object:
        return value

    @property
    def fields(self) -> tuple[str, ...]:
        return (self.field,)


class TableAxis(Strict):
    """Several fields that change together: a value of each in every row."""

    kind: Literal["table"]
    fields: tuple[DottedField, ...] = Field(min_length=1, max_length=MOST_AXES)
    rows: tuple[tuple[Any, ...], ...] = Field(min_length=1, max_length=MOST_VALUES)

    @model_validator(mode="after")
    def _rows_are_full(self) -> TableAxis:
        for i, row in enumerate(self.rows):
            if len(row) != len(self.fields):
                raise PydanticCustomError(
                    "row",
                    "allowed: rows of {n} values, one for each of the fields; row {i} has {m}",
                    {"n": len(self.fields), "m": len(row), "i": i, "field": "rows"},
                )
        return self


class RangeAxis(Strict):
    """Numbers from start to stop, both included: evenly, or evenly in the logarithm.

    count : how many; for a quasi-random design none is given
    integer : whole numbers only (the nearest ones)
    """

    kind: Literal["range", "log_range"]
    field: DottedField
    start: float
    stop: float
    count: int | None = Field(None, ge=1, le=MOST_VALUES)
    integer: bool = False

    @model_validator(mode="after")
    def _whole_numbers_are_exact(self) -> RangeAxis:
        for name in ("start", "stop") if self.integer else ():
            if abs(getattr(self, name)) > MOST_WHOLE:
                raise PydanticCustomError(
                    "whole",
                    f"allowed: {-MOST_WHOLE} to {MOST_WHOLE}; list larger ones",
                    {"field": name},
                )
        return self

    @model_validator(mode="after")
    def _logarithms_are_of_positives(self) -> RangeAxis:
        if self.kind == "log_range":
            for name in ("start", "stop"):
                if getattr(self, name) <= 0:
                    raise PydanticCustomError("log", "allowed: above 0", {"field": name})
        return self

    @property
    def fields(self) -> tuple[str, ...]:
        return (self.field,)

    def at(self, share: float) -> float | int:
        """The value a share (0 to 1) of the way from start to stop."""
        if self.kind == "log_range":
            value = math.exp((1 - share) * math.log(self.start) + share * math.log(self.stop))
        else:
            value = (1 - share) * self.start + share * self.stop
        value = {0.0: self.start, 1.0: self.stop}.get(share, value)
        return round(value) if self.integer else value


class Grid(Strict):
    """Every combination of the axes' values; the last axis changes fastest."""

    kind: Literal["grid"]


class Zip(Strict):
    """The first values of all axes, then the second ones: axes of equal length."""

    kind: Literal["zip"]


class QuasiRandom(Strict):
    """Points spread evenly over all axes at once: a scrambled Sobol sequence, a Latin hypercube."""

    kind: Literal["sobol", "latin_hypercube"]
    points: int = Field(ge=1, le=MOST_POINTS)
    seed: int = Field(0, ge=0, lt=2**63)


Axis = Annotated[ListAxis | TableAxis | RangeAxis, Field(discriminator="kind")]
DesignWish = Annotated[Grid | Zip | QuasiRandom, Field(discriminator="kind")]


class Detection(Strict):
    """The built-in matched filter: how high its peak must be, how far from the truth."""

    threshold_sigma: float = Field(5.0, gt=0, le=1000)
    search_px: float = Field(3.0, ge=0, le=64)


class Sweep(Strict):
    """A sweep file, version 1."""

    schema_: Literal["nightglass/sweep/1"] = Field(alias="schema")
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}$")
    scene: str | JsonObject = Field(description="the base: path of a scene file, or a scene")
    axes: tuple[Axis, ...] = Field(min_length=1, max_length=MOST_AXES)
    design: DesignWish = Grid(kind="grid")
    seeds: int = Field(
        1, ge=1, le=100_000, description="number of seeds of each point: seed, seed + 1, ..."
    )
    metrics: tuple[Literal[METRICS], ...] = METRICS  # type: ignore[valid-type]
    targets: tuple[str, ...] | None = Field(
        None,
        max_length=64,
        description="names of targets whose SNR and detection are reported; default: all",
    )
    detection: Detection = Detection()
    cubes: Literal["none", "all"] | tuple[Annotated[int, Field(ge=0)], ...] = Field(
        "none", description="points whose whole product is kept"
    )

    @field_validator("axes", mode="before")
    @classmethod
    def _kind_may_be_left_out(cls, value: object) -> object:
        return axes_with_kinds(value)

    @field_validator("targets")
    @classmethod
    def _each_once(cls, value: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if value is not None and len(set(value)) < len(value):
            raise PydanticCustomError("targets", "allowed: each name once")
        return value

    @model_validator(mode="after")
    def _axes_fit(self) -> Sweep:
        check_fields(self.axes, FIXED)
        check_lengths(self.axes, self.design)
        return self

    @model_validator(mode="after")
    def _points_are_few_enough(self) -> Sweep:
        design = self.design if isinstance(self.design, QuasiRandom) else None
        latin = design is not None and design.kind == "latin_hypercube"
        if latin and design is not None and design.points * len(self.axes) > MOST_DRAWN:
            raise PydanticCustomError(
                "points",
                "allowed: points x axes up to {n}; or sobol",
                {"n": MOST_DRAWN, "field": "design.points"},
            )
        if self.points > MOST_POINTS:
            raise PydanticCustomError(
                "points",
                "allowed: up to {n} points in all; these are {m}",
                {"n": MOST_POINTS, "m": self.points, "field": "axes"},
            )
        if isinstance(self.cubes, tuple) and any(p >= self.points for p in self.cubes):
            raise PydanticCustomError(
                "cubes",
                "allowed: none, all, or numbers of points below {n}",
                {"n": self.points, "field": "cubes"},
            )
        return self

    @property
    def points(self) -> int:
        """How many points there are, seeds counted."""
        return points_of(self.axes, self.design, self.seeds)

    def as_dict(self) -> JsonObject:
        """The sweep with all defaults filled in, as plain data."""
        return self.model_dump(mode="json", by_alias=True)


def axes_with_kinds(value: Any) -> Any:
    """Axes as given, each that has `values` named a list."""
    if not isinstance(value, list | tuple):
        return value
    return [
        {"kind": "list", **axis} if isinstance(axis, dict) and "values" in axis else axis
        for axis in value
    ]


def check_fields(axes: tuple[Axis, ...], fixed: tuple[str, ...]) -> None:
    """Refuse axes over what all points have in common, and fields that are varied twice."""
    seen: list[str] = []
    for i, axis in enumerate(axes):
        for name in axis.fields:
            if name.split(".")[0] in fixed:
                allowed = f"allowed: a field that points may differ in, not {name}"
            elif name in seen:
                allowed = f"allowed: each field in one axis; twice: {name}"
            elif any(name.startswith(f"{s}.") or s.startswith(f"{name}.") for s in seen):
                allowed = f"allowed: fields that hold none of the others; {name} does"
            else:
                seen.append(name)
                continue
            raise PydanticCustomError(
                "axis", "{allowed}", {"allowed": allowed, "field": f"axes.{i}"}
            )


def check_lengths(axes: tuple[Axis, ...], design: DesignWish) -> None:
    """Refuse axes that have not as many values as their design asks for."""
    random = isinstance(design, QuasiRandom)
    if random and not axes:
        raise PydanticCustomError("axes", "allowed: axes, or no design", {"field": "design"})
    for i, axis in enumerate(axes):
        if isinstance(axis, RangeAxis) and random != (axis.count is None):
            raise PydanticCustomError(
                "count",
                "allowed: no count where the design is quasi-random, a count elsewhere",
                {"field": f"axes.{i}.count"},
            )
    lengths = [axis_length(axis) for axis in axes]
    if isinstance(design, Zip) and len(set(lengths)) > 1:
        raise PydanticCustomError(
            "zip",
            "allowed: axes of one length; these have {n}",
            {"n": ", ".join(map(str, lengths)), "field": "axes"},
        )


def points_of(axes: tuple[Axis, ...], design: DesignWish, seeds: int) -> int:
    """How many points a design makes of axes, seeds counted."""
    if isinstance(design, QuasiRandom):
        return design.points * seeds
    lengths = [axis_length(axis) for axis in axes]
    return (lengths[0] if isinstance(design, Zip) and axes else math.prod(lengths)) * seeds


def axis_length(axis: ListAxis | TableAxis | RangeAxis) -> int:
    """How many values an axis has (1 for a range of a quasi-random design)."""
    if isinstance(axis, ListAxis):
        return len(axis.values)
    return len(axis.rows) if isinstance(axis, TableAxis) else axis.count or 1


def check_overrides(
    overrides: Iterable[str], axes: tuple[Axis, ...], of: str, at: str = ""
) -> None:
    """BadInput for an override of a field that an axis changes, where it would have no effect.

    of : what has the axes; at : where it holds the fields
    """
    changed = {at + name for axis in axes for name in axis.fields}
    for override in overrides:
        key = override.partition("=")[0].removesuffix("+")
        if any(f"{key}.".startswith(f"{name}.") for name in changed):
            raise BadInput("--set", override, f"a field that no axis of the {of} changes")
