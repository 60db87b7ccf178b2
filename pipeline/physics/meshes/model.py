"""A body of rigid parts with joints: where its facets stand at a moment, and what it sends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.meshes.brdf_table import BrdfTable
from pipeline.physics.meshes.facets import Facets, together
from pipeline.physics.meshes.intensity import FacetSurface, mesh_intensity
from pipeline.physics.vectors import rotate_about, unit

Array = NDArray[np.float64]

_ON_AXIS = 1e-9  # sine of an angle below which the Sun on an axis gives no direction


@dataclass(frozen=True, eq=False)
class Joint:
    """How a part turns about an axis of its own.

    law : `fixed` at angle_rad; `spin`: angle_rad + rate_rad_s x time; `sun`: `face` as near to the
        Sun as the axis lets it, then angle_rad on
    axis, face : (3,) unit vectors and pivot_m : (3,) a point of the axis, all in the part's frame
    """

    law: Literal["fixed", "spin", "sun"]
    axis: Array
    pivot_m: Array
    face: Array
    angle_rad: float = 0.0
    rate_rad_s: float = 0.0


@dataclass(frozen=True, eq=False)
class RigidPart:
    """A rigid part: x_parent = rotation x_part + place_m, x_part after the joint's turn.

    on : number of the part that carries it, an earlier one; None: the body's frame
    """

    facets: Facets
    on: int | None = None
    rotation: Array | None = None
    place_m: Array | None = None
    joint: Joint | None = None


@dataclass(frozen=True, eq=False)
class MeshModel:
    """A body as read: its parts, the surfaces that their facets name, what there is to say of it.

    digest : of the files and everything else that shapes the light
    """

    parts: tuple[RigidPart, ...]
    surfaces: tuple[FacetSurface, ...]
    digest: str = ""
    notices: tuple[str, ...] = ()

    @property
    def highlight_rad(self) -> float:
        """The narrowest highlight of the measured tables among its surfaces."""
        tables = (s.brdf for s in self.surfaces if isinstance(s.brdf, BrdfTable))
        return min((table.highlight_rad for table in tables), default=np.inf)

    @property
    def radius_m(self) -> float:
        """Radius about the origin that no corner leaves, however the joints turn."""
        reach: list[float] = []
        for part in self.parts:
            pivot = 0.0 if part.joint is None else 2.0 * float(np.linalg.norm(part.joint.pivot_m))
            place = 0.0 if part.place_m is None else float(np.linalg.norm(part.place_m))
            # a chain of carriers: add up, an upper bound
            own = pivot + place
            reach.append(own + (reach[part.on] if part.on is not None else 0.0))
        sizes = [p.facets.radius_m + r for p, r in zip(self.parts, reach, strict=True)]
        return max(sizes, default=0.0)


def tracking_angle(axis: ArrayLike, face: ArrayLike, sun: ArrayLike) -> Array:
    """Right-handed turn (...,) [rad] about `axis` that brings `face` nearest to the Sun.

    axis, face, sun : (..., 3) unit vectors in one frame. 0 where the Sun or the face stands on
    the axis: never NaN.
    """
    a, w, s = (np.asarray(v, float) for v in (axis, face, sun))
    across = w - np.sum(w * a, -1, keepdims=True) * a
    side, ahead = np.sum(np.cross(a, across) * s, -1), np.sum(across * s, -1)
    return np.where(np.hypot(side, ahead) > _ON_AXIS, np.arctan2(side, ahead), 0.0)


def posed(model: MeshModel, sun: ArrayLike, time_s: float = 0.0) -> Facets:
    """All facets in the body's frame, for the Sun in a direction (3,) of it and a moment."""
    frames: list[tuple[Array, Array]] = []
    placed = []
    for part in model.parts:
        rotation, place = np.eye(3), np.zeros(3)
        if part.on is not None:
            rotation, place = frames[part.on]
        if part.place_m is not None:
            place = place + rotation @ part.place_m
        if part.rotation is not None:
            rotation = rotation @ part.rotation
        if part.joint is not None:
            turn = _turn(part.joint, rotation.T @ np.asarray(sun, float), time_s)
            pivot = part.joint.pivot_m
            place = place + rotation @ (pivot - turn @ pivot)
            rotation = rotation @ turn
        frames.append((rotation, place))
        placed.append(part.facets.moved(rotation, place))
    return together(placed)


def _turn(joint: Joint, sun: Array, time_s: float) -> Array:
    angle = joint.angle_rad
    if joint.law == "spin":
        angle += float(np.fmod(joint.rate_rad_s * time_s, 2.0 * np.pi))
    elif joint.law == "sun":
        angle += float(tracking_angle(joint.axis, joint.face, sun))
    return rotate_about(joint.axis, angle)


def model_light(
    model: MeshModel,
    sun: ArrayLike,
    observer: ArrayLike,
    time_s: ArrayLike,
    error: float = 1e-3,
    sun_radius_rad: float = 0.0,
    step_rad: float = 0.0,
) -> tuple[Array, Array]:
    """Intensity over irradiance [m2/sr] and the bound on its error, both (n,), moment by moment.

    sun, observer : (n, 3) directions in the body's axes; time_s : (n,) since the joints' epoch.
    step_rad : angle (of Sun, observer and spinning joints together) that may lie between moments
        worked out; those between are straight lines, not in the bound. They err by about
        step^2/8 over the square of the highlights' width (1 rad where all is matt), and by the
        light times the step where a shadow sets in. 0: each is worked out, equal ones once.
    """
    suns, observers = unit(np.asarray(sun, float)), unit(np.asarray(observer, float))
    moments = np.asarray(time_s, float)
    if not len(moments):
        return np.zeros(0), np.zeros(0)
    way = way_rad(model, (suns, observers), moments)
    knots = knots_of(way, step_rad)
    out = np.zeros((2, len(knots)))
    for k, i in enumerate(knots):
        facets = posed(model, suns[i], float(moments[i]))
        light = mesh_intensity(facets, model.surfaces, suns[i], observers[i], error, sun_radius_rad)
        out[:, k] = light.intensity_m2_sr, light.error_m2_sr
    if step_rad <= 0.0:
        which = np.searchsorted(knots, np.arange(len(way)), side="right") - 1
        return out[0][which], out[1][which]
    light_m2_sr, bound = (np.interp(way, way[knots], row) for row in out)
    return light_m2_sr, bound


def knots_of(way: Array, step_rad: float) -> NDArray[np.int64]:
    """Moments that are worked out: `step_rad` of the way apart; all that differ where it is 0."""
    if step_rad <= 0.0:
        return np.unique(np.concatenate([[0], np.flatnonzero(np.diff(way) > 0.0) + 1]))
    knots = np.flatnonzero(np.diff(np.floor(way / step_rad), prepend=-1.0) > 0.0)
    return np.unique(np.concatenate([knots, np.maximum(knots - 1, 0), [len(way) - 1]]))


def way_rad(model: MeshModel, looks: Sequence[Array], time_s: Array) -> Array:
    """Angle (n,) [rad] that directions (n, 3) and spinning joints turned by since the first."""
    steps = np.zeros(len(time_s))
    for directions in looks:
        steps[1:] += np.sqrt(np.sum(np.square(np.diff(directions, axis=0)), axis=-1))
    for part in model.parts:
        if part.joint is not None and part.joint.law == "spin":
            steps[1:] += np.abs(part.joint.rate_rad_s * np.diff(time_s))
    return np.cumsum(steps)
