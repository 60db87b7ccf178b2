"""What a target is: Lambertian shapes, composites, light curves; how it stands and is lit."""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.strict import Fraction, Positive, Strict

MAX_PARTS, MAX_POINTS = 1000, 20_000

Size = Annotated[float, Field(gt=0, le=1e6)]
Number = Annotated[float, Field(ge=-1e12, le=1e12)]
Component = Annotated[float, Field(ge=-1e6, le=1e6)]
Axis = tuple[Component, Component, Component]
Quaternion = tuple[Component, Component, Component, Component]
Times = Annotated[tuple[Number, ...], Field(min_length=2, max_length=MAX_POINTS)]
Reflectances = Annotated[
    tuple[tuple[Positive, Fraction], ...], Field(min_length=2, max_length=MAX_POINTS)
]
Albedo = Annotated[
    Fraction | Reflectances,
    Field(
        description="diffuse (hemispherical) reflectance: a number, or ascending pairs of "
        "[wavelength_nm, reflectance] that cover the sensor's band"
    ),
]
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def _ascending(values: tuple[float, ...], field: str) -> None:
    if any(b <= a for a, b in itertools.pairwise(values)):
        raise PydanticCustomError("ascending", "allowed: values that rise", {"field": field})


def _has_length(value: tuple[float, ...], what: str) -> tuple[float, ...]:
    if not math.hypot(*value) > 1e-9:
        raise PydanticCustomError("length", "allowed: {what} that is not zero", {"what": what})
    return value


class Oriented(Strict):
    """What all attitude laws share.

    quaternion : (w, x, y, z), scalar first, of any length: turns the body's axes into those of
        the law; default: they are the same
    """

    quaternion: Quaternion = UPRIGHT

    @field_validator("quaternion")
    @classmethod
    def _turns(cls, value: Quaternion) -> tuple[float, ...]:
        return _has_length(value, "a quaternion (w, x, y, z)")


class InertialAttitude(Oriented):
    """Fixed in space: the law's frame is GCRS (ICRS axes)."""

    kind: Literal["inertial"]


class SunAttitude(Oriented):
    """+z to the Sun, +y as near as can be to the orbit's normal r x v."""

    kind: Literal["sun"]


class VelocityAttitude(Oriented):
    """+z along the inertial velocity, +y along the orbit's normal r x v."""

    kind: Literal["velocity"]


class NadirAttitude(Oriented):
    """+z to the Earth's centre, +y against the orbit's normal, +x forward."""

    kind: Literal["nadir"]


class SpinAttitude(Oriented):
    """Turning evenly about an axis fixed in the body; `quaternion` is its attitude at phase 0.

    The phase is that at `epoch` (default: the scene's); a positive rate is right-handed.
    """

    kind: Literal["spin"]
    rate_deg_s: float = Field(ge=-1e5, le=1e5)
    axis: Axis = (0.0, 0.0, 1.0)
    phase_deg: float = Field(0.0, ge=-1e6, le=1e6)
    epoch: str | None = Field(None, max_length=40)

    @field_validator("axis")
    @classmethod
    def _points(cls, value: Axis) -> tuple[float, ...]:
        return _has_length(value, "an axis")


class TrackingAttitude(Oriented):
    """A panel on a hinge of its bus that follows the Sun: +y on the hinge, +z nearest the Sun.

    bus : attitude law of the bus, in which `quaternion` turns it
    axis : direction of the hinge, in the bus's axes
    """

    kind: Literal["sun_tracking"]
    bus: Literal["nadir", "velocity", "inertial"] = "nadir"
    axis: Axis = (0.0, 1.0, 0.0)

    @field_validator("axis")
    @classmethod
    def _points(cls, value: Axis) -> tuple[float, ...]:
        return _has_length(value, "an axis")


class TableAttitude(Oriented):
    """Quaternions (w, x, y, z), body to GCRS, at times after `epoch`; the shortest turn between.

    `quaternion` turns the body's axes into the table's.
    """

    kind: Literal["table"]
    times_s: Times
    quaternions: Annotated[tuple[Quaternion, ...], Field(min_length=2, max_length=MAX_POINTS)]
    epoch: str | None = Field(None, max_length=40)

    @model_validator(mode="after")
    def _table_is_whole(self) -> TableAttitude:
        _ascending(self.times_s, "times_s")
        if len(self.times_s) != len(self.quaternions):
            raise PydanticCustomError(
                "length",
                "allowed: as many as times_s ({n})",
                {"n": len(self.times_s), "field": "quaternions"},
            )
        if any(not math.hypot(*q) > 1e-9 for q in self.quaternions):
            raise PydanticCustomError(
                "length", "allowed: quaternions that are not zero", {"field": "quaternions"}
            )
        return self


Attitude = Annotated[
    InertialAttitude
    | SunAttitude
    | VelocityAttitude
    | NadirAttitude
    | SpinAttitude
    | TrackingAttitude
    | TableAttitude,
    Field(discriminator="kind"),
]


class Surface(Strict):
    """A grey Lambertian surface; a table of reflectance stands for its mean over the band."""

    albedo: Albedo

    @field_validator("albedo")
    @classmethod
    def _wavelengths_rise(cls, value: Albedo) -> Albedo:
        if isinstance(value, tuple) and any(b[0] <= a[0] for a, b in itertools.pairwise(value)):
            raise PydanticCustomError("ascending", "allowed: wavelengths that rise")
        return value


class SphereBody(Surface):
    """A diffuse (grey Lambertian) sphere."""

    kind: Literal["sphere"]
    diameter_m: Size


class Shaped(Surface):
    """A shape with an attitude: its own law, else the composite's, else `inertial`."""

    attitude: Attitude | None = None


class PlateBody(Shaped):
    """A flat plate whose front looks along +z; its back is black unless it is two-sided."""

    kind: Literal["plate"]
    area_m2: float = Field(gt=0, le=1e12)
    two_sided: bool = False


class BoxBody(Shaped):
    """A closed box with edges along x, y and z."""

    kind: Literal["box"]
    size_m: tuple[Size, Size, Size]


class CubeBody(Shaped):
    """A closed cube."""

    kind: Literal["cube"]
    edge_m: Size


class CylinderBody(Shaped):
    """A cylinder about z; an open end shows nothing."""

    kind: Literal["cylinder"]
    diameter_m: Size
    length_m: Size
    closed: Literal["both", "base", "top", "none"] = Field(
        "both", description="ends with a lid: base at -z, top at +z"
    )


class ConeBody(Shaped):
    """A cone about z, apex towards +z."""

    kind: Literal["cone"]
    diameter_m: Size
    length_m: Size
    closed: Literal["base", "none"] = "base"


class FrustumBody(Shaped):
    """A truncated cone about z: one diameter at the base (-z), another at the top (+z)."""

    kind: Literal["frustum"]
    base_diameter_m: Size
    top_diameter_m: Size
    length_m: Size
    closed: Literal["both", "base", "top", "none"] = "both"


Part = Annotated[
    SphereBody | PlateBody | BoxBody | CubeBody | CylinderBody | ConeBody | FrustumBody,
    Field(discriminator="kind"),
]


class CompositeBody(Strict):
    """Shapes that shine together; they neither shade nor hide each other."""

    kind: Literal["composite"]
    parts: Annotated[tuple[Part, ...], Field(min_length=1, max_length=MAX_PARTS)]
    attitude: Attitude | None = Field(
        None, description="attitude law of parts that have none of their own"
    )


class LightCurveBody(Strict):
    """A measured or computed light curve, grey like the Sun.

    magnitudes : at `range_m` and 1 au from the Sun, in a band where the Sun has `sun_mag` (-26.76:
    V, Vega); or intensities_m2_sr : radiant intensity over solar irradiance
    phase_law : `as_given` the table holds the phase's effect; `lambert` and `linear` (magnitudes
    per degree) carry values from `phase_deg` to the phase of each moment
    """

    kind: Literal["light_curve"]
    times_s: Times = Field(description="times after `epoch` at which the light departs [s]")
    magnitudes: tuple[Annotated[float, Field(ge=-60, le=60)], ...] | None = None
    intensities_m2_sr: tuple[Annotated[float, Field(ge=0, le=1e15)], ...] | None = None
    range_m: float = Field(1e6, gt=0, le=1e15)
    sun_mag: float = Field(-26.76, ge=-40, le=0)
    phase_law: Literal["as_given", "lambert", "linear"] = "as_given"
    phase_deg: float = Field(0.0, ge=0, lt=180)
    mag_per_deg: float = Field(0.0, ge=-1, le=1)
    period_s: Positive | None = Field(
        None,
        description="the table repeats with this period, at least its span [s]; straight from its "
        "last row to the first of the next period, a jump where both are at one time",
    )
    epoch: str | None = Field(None, max_length=40)

    @model_validator(mode="after")
    def _table_is_whole(self) -> LightCurveBody:
        _ascending(self.times_s, "times_s")
        given = {"magnitudes": self.magnitudes, "intensities_m2_sr": self.intensities_m2_sr}
        present = [name for name, values in given.items() if values is not None]
        if len(present) != 1:
            raise PydanticCustomError(
                "one_of", "allowed: exactly one of magnitudes and intensities_m2_sr"
            )
        if len(given[present[0]] or ()) != len(self.times_s):
            raise PydanticCustomError(
                "length",
                "allowed: as many as times_s ({n})",
                {"n": len(self.times_s), "field": present[0]},
            )
        if self.mag_per_deg and self.phase_law != "linear":
            raise PydanticCustomError(
                "law", "allowed: only with phase_law: linear", {"field": "mag_per_deg"}
            )
        span = self.times_s[-1] - self.times_s[0]
        if self.period_s is not None and self.period_s < span * (1 - 1e-12):
            raise PydanticCustomError(
                "period",
                "allowed: at least the table's span, {span} s",
                {"span": span, "field": "period_s"},
            )
        return self

    @model_validator(mode="after")
    def _nothing_is_idle(self) -> LightCurveBody:
        idle = {}
        if self.magnitudes is None:
            idle = dict.fromkeys(("range_m", "sun_mag"), "allowed: with magnitudes")
        if self.phase_law == "as_given":
            idle["phase_deg"] = "allowed: with phase_law: lambert or linear"
        for name, allowed in idle.items():
            if getattr(self, name) != type(self).model_fields[name].default:
                raise PydanticCustomError("idle", "{allowed}", {"field": name, "allowed": allowed})
        return self


Body = Annotated[
    SphereBody
    | PlateBody
    | BoxBody
    | CubeBody
    | CylinderBody
    | ConeBody
    | FrustumBody
    | CompositeBody
    | LightCurveBody,
    Field(discriminator="kind"),
]


class Lighting(Strict):
    """Finer lighting of a target than direct sunlight past a round Earth.

    oblate_earth : the shadow is that of the WGS 84 ellipsoid
    limb_darkening : linear coefficient of the Sun's disc (about 0.6 in V, 0.3 near 1 um)
    moon : eclipses by the Moon
    earthshine_albedo : sunlight from a Lambertian Earth of this albedo (0.3 is its mean)
    """

    oblate_earth: bool = False
    limb_darkening: Fraction = 0.0
    moon: bool = False
    earthshine_albedo: Fraction | None = None
