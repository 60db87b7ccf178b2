"""Bodies from CAD files: their units, what their surfaces reflect, their joints and attitude."""

from __future__ import annotations

import math
from itertools import chain
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, field_validator, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.strict import Fraction, Strict
from pipeline.spec.targets.body import UPRIGHT, Attitude, Axis, Component, Quaternion, _has_length

MAX_PARTS, MAX_MATERIALS = 100, 1000
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}

Unit = Literal["m", "cm", "mm", "in", "ft"]
Path = Annotated[str, Field(min_length=1, max_length=4096)]
Name = Annotated[str, Field(min_length=1, max_length=200)]
Place = tuple[Component, Component, Component]
Exponent = Annotated[float, Field(ge=0, le=1e6)]


class MeshSurface(Strict):
    """What all surfaces share; a facet's back is black unless it is two-sided (thin sheets)."""

    two_sided: bool = False

    @property
    def highlight_rad(self) -> float:
        """How far a body turns while a highlight of it brightens by e^(1/2); inf where all is matt,
        and of a table, which says so once it is read."""
        return math.inf


class LambertSurface(MeshSurface):
    """Matt: equally bright from everywhere."""

    kind: Literal["lambert"]
    albedo: Fraction


class PhongSurface(MeshSurface):
    """Matt with a round highlight about the mirror's direction, cos^exponent wide."""

    kind: Literal["phong"]
    diffuse: Fraction
    specular: Fraction
    exponent: Exponent

    @property
    def highlight_rad(self) -> float:
        return 0.5 / math.sqrt(max(self.exponent, 1.0)) if self.specular else math.inf

    @model_validator(mode="after")
    def _not_more_than_all(self) -> PhongSurface:
        if self.diffuse + self.specular > 1.0 + 1e-12:
            raise PydanticCustomError(
                "energy", "allowed: diffuse + specular <= 1", {"field": "specular"}
            )
        return self


class CookTorranceSurface(MeshSurface):
    """Microfacets (GGX) over a matt base: paint, metal, foil.

    roughness : width alpha of the facets' slopes, 0.005 (polished) to 1
    refractive_index : complex index (n, k); or normal_reflectance : reflectance at normal incidence
    (Schlick's formula)
    """

    kind: Literal["cook_torrance"]
    diffuse: Fraction = 0.0
    roughness: float = Field(ge=0.005, le=1)
    refractive_index: (
        tuple[Annotated[float, Field(gt=0, le=100)], Annotated[float, Field(ge=0, le=1000)]] | None
    ) = None
    normal_reflectance: Fraction | None = None

    @property
    def highlight_rad(self) -> float:
        return 0.5 * self.roughness

    @model_validator(mode="after")
    def _one_of_two(self) -> CookTorranceSurface:
        if (self.refractive_index is None) == (self.normal_reflectance is None):
            raise PydanticCustomError(
                "one_of", "allowed: exactly one of refractive_index and normal_reflectance"
            )
        return self


class AshikhminShirleySurface(MeshSurface):
    """Glossy or brushed over a matt base (solar cells, brushed metal).

    exponent_u : exponent along the grain; larger is sharper; grain : a direction in the part's
    frame, laid onto each facet
    """

    kind: Literal["ashikhmin_shirley"]
    diffuse: Fraction = 0.0
    specular: Fraction
    exponent_u: Exponent
    exponent_v: Exponent | None = Field(
        None, description="exponent across the grain; default: as exponent_u (not brushed)"
    )
    grain: Axis = (1.0, 0.0, 0.0)

    @property
    def highlight_rad(self) -> float:
        sharpest = max(self.exponent_u, self.exponent_v or 0.0, 1.0)
        return 1.0 / math.sqrt(sharpest) if self.specular else math.inf

    @field_validator("grain")
    @classmethod
    def _points(cls, value: Axis) -> tuple[float, ...]:
        return _has_length(value, "a direction")


class TableSurface(MeshSurface):
    """A measured isotropic BRDF.

    path : CSV with the columns theta_i_deg, theta_o_deg, phi_deg (0 back, 180 forward), brdf_per_sr
    on a full grid in any order; or NPY (n, 4) of the same
    """

    kind: Literal["table"]
    path: Path
    scale: float = Field(1.0, gt=0, le=1e6, description="the values are multiplied by it")


Reflecting = Annotated[
    LambertSurface | PhongSurface | CookTorranceSurface | AshikhminShirleySurface | TableSurface,
    Field(discriminator="kind"),
]


class Hinge(Strict):
    """What all joints share: an axis through a point, in the part's frame."""

    axis: Axis
    pivot_m: Place = (0.0, 0.0, 0.0)
    angle_deg: float = Field(0.0, ge=-1e6, le=1e6, description="right-handed; for all laws")

    @field_validator("axis")
    @classmethod
    def _points(cls, value: Axis) -> tuple[float, ...]:
        return _has_length(value, "an axis")


class FixedJoint(Hinge):
    """Turned by an angle and left there."""

    kind: Literal["fixed"]


class SpinJoint(Hinge):
    """Turning evenly; `angle_deg` is that at the scene's epoch."""

    kind: Literal["spin"]
    rate_deg_s: float = Field(ge=-1e5, le=1e5)


class SunTrackingJoint(Hinge):
    """Follows the Sun: `face` as near to it as the axis allows, then `angle_deg` on."""

    kind: Literal["sun_tracking"]
    face: Axis = (0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _face_turns(self) -> SunTrackingJoint:
        a, f = self.axis, self.face
        across = (a[1] * f[2] - a[2] * f[1], a[2] * f[0] - a[0] * f[2], a[0] * f[1] - a[1] * f[0])
        _has_length(across, "a face that does not lie along the axis")
        return self


Jointed = Annotated[FixedJoint | SpinJoint | SunTrackingJoint, Field(discriminator="kind")]


class Meshed(Strict):
    """A file and what its surfaces reflect.

    surface : reflectance of all facets whose material is not in `materials`
    materials : reflectances by the file's names of materials; colours and gloss that a file gives
        are for display and not used
    """

    surface: Reflecting | None = None
    materials: Annotated[dict[Name, Reflecting], Field(max_length=MAX_MATERIALS)] = Field(
        default_factory=dict
    )


class MeshPart(Meshed):
    """A part with a frame of its own: another file, or objects of the body's file.

    on : name of the part (an earlier one) that carries it; default: the body
    place_m : origin of its frame, in the carrier's [m]; quaternion : (w, x, y, z), turns its axes
    into the carrier's
    surface : default: the body's; materials : reflectances by the file's names of materials;
    default: the body's
    """

    name: Name
    path: Path | None = None
    unit: Unit | None = Field(None, description="unit of the file's lengths; default: the body's")
    objects: Annotated[tuple[Name, ...], Field(min_length=1, max_length=MAX_PARTS)] | None = Field(
        None, description="only these objects of the file"
    )
    on: Name | None = None
    place_m: Place = (0.0, 0.0, 0.0)
    quaternion: Quaternion = UPRIGHT
    joint: Jointed | None = None

    @field_validator("quaternion")
    @classmethod
    def _turns(cls, value: Quaternion) -> tuple[float, ...]:
        return _has_length(value, "a quaternion (w, x, y, z)")

    @model_validator(mode="after")
    def _has_facets(self) -> MeshPart:
        if self.path is None and self.objects is None:
            raise PydanticCustomError(
                "source", "allowed: path, or objects of the body's file, or both"
            )
        return self


class MeshBody(Meshed):
    """A body from an OBJ, STL, GLB or PLY file, opaque; it shades and hides itself.

    unit : unit of the file's lengths
    error : fraction of the light that shadows may err by; default: from the scene's accuracy
    digest : checksum of the files and of all that shapes the light; a body read from others is
    refused
    """

    kind: Literal["mesh"]
    path: Path
    unit: Unit
    parts: Annotated[tuple[MeshPart, ...], Field(max_length=MAX_PARTS)] = ()
    attitude: Attitude | None = None
    error: Annotated[float, Field(ge=1e-8, le=0.1)] | None = None
    digest: Annotated[str, Field(max_length=64)] | None = None
    _model: Any = PrivateAttr(None)

    @property
    def highlight_rad(self) -> float:
        """The narrowest highlight of its surfaces; see `MeshSurface`."""
        owners: tuple[Meshed, ...] = (self, *self.parts)
        surfaces = chain(*((owner.surface, *owner.materials.values()) for owner in owners))
        of_tables = math.inf if self._model is None else float(self._model.highlight_rad)
        return min([of_tables, *(s.highlight_rad for s in surfaces if s is not None)])

    @property
    def model(self) -> Any:
        """The facets, surfaces and joints that were read for it
        (pipeline/inputs/targets/meshes.py).
        """
        return self._model

    def with_model(self, model: Any, error: float) -> MeshBody:
        """The body with what was read for it, and the error that its shadows may make."""
        read = self.model_copy(update={"digest": model.digest, "error": self.error or error})
        read._model = model
        return read

    @model_validator(mode="after")
    def _parts_hang_together(self) -> MeshBody:
        names: list[str] = []
        taken: list[str] = []
        for part in self.parts:
            if part.name in names:
                raise PydanticCustomError(
                    "name", "part {name}: allowed: a name of its own", {"name": part.name}
                )
            if part.on is not None and part.on not in names:
                raise PydanticCustomError(
                    "on",
                    "part {name} on {on}: allowed: an earlier part ({names}), or none: the body",
                    {"name": part.name, "on": part.on, "names": ", ".join(names)},
                )
            if part.path is None:
                for one in part.objects or ():
                    if one in taken:
                        raise PydanticCustomError(
                            "objects", "object {one}: allowed: in one part", {"one": one}
                        )
                    taken.append(one)
            names.append(part.name)
        return self
