"""Bodies from meshes: their attitude, and the light they send, for the plan's geometry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, SUN_RADIUS_RAD
from pipeline.physics.meshes.lamps import Lamps, wide_lamp_intensity
from pipeline.physics.meshes.model import MeshModel, knots_of, model_light, posed, way_rad
from pipeline.physics.targets.attitude import in_body_axes
from pipeline.physics.targets.earthshine import earth_lamps
from pipeline.plan.bodies.attitudes import UPRIGHT, View, attitudes
from pipeline.spec.targets.mesh import MeshBody

Array = NDArray[np.float64]

STEP_RAD = 0.01  # between moments that are worked out, of bodies without sharp highlights, or
STEP_OF_HIGHLIGHT = 0.05  # of the narrowest, if less: lines between are off by 3e-4 of its peak
EARTH_STEP_RAD = 0.05  # the same for the Earth's light, which is wide; with highlights STEP_RAD


def mesh_poses(
    body: MeshBody, epoch: tuple[float, float], view: View, camera: Array, field: str = "body"
) -> tuple[Array, Array]:
    """Directions (n, 4, 3) of Sun, observer and the focal plane's +x and +y in the body's axes, and
    the turn (n,) [rad] of all of them together since the first moment.

    view : T = 1; camera : (n, 3, 3) proper attitudes of the focal plane
    The last two are laid across the line of sight, at right angles to each other.
    """
    attitude = attitudes([body.attitude or UPRIGHT], epoch, view, [field])[0]
    observer = view.observer[0]
    x = camera[:, 0] - np.sum(camera[:, 0] * observer, -1, keepdims=True) * observer
    x = x / np.sqrt(np.sum(x * x, -1, keepdims=True))
    y = np.cross(observer, x)
    y = y * np.sign(np.sum(y * camera[:, 1], -1, keepdims=True))
    seen = np.stack([view.sun[0], observer, x, y], axis=1)
    pose = np.stack([in_body_axes(attitude, seen[:, k]) for k in range(4)], axis=1)
    steps = np.sqrt(np.sum(np.square(np.diff(pose, axis=0)), -1)).max(axis=1)
    spin = max(
        (abs(p.joint.rate_rad_s) for p in body.model.parts if p.joint is not None), default=0.0
    )
    turn = np.concatenate([[0.0], np.cumsum(steps + spin * np.abs(np.diff(view.time_s[0])))])
    return pose, turn


def mesh_m2_sr(
    body: MeshBody, epoch: tuple[float, float], view: View, field: str = "body", frames: int = 1
) -> Array:
    """Radiant intensity over solar irradiance (n,) [m2/sr]; view : T = 1.

    frames : of which the moments are the nodes, one after another; each is worked out by itself

    BadInput for a body whose files have not been read
    (`pipeline.inputs.targets.meshes.gather_meshes`).
    """
    model, error = _read(body, field)
    attitude = attitudes([body.attitude or UPRIGHT], epoch, view, [field])[0]
    sun = in_body_axes(attitude, view.sun[0])
    observer = in_body_axes(attitude, view.observer[0])
    sharp = any(surface.sun_rings for surface in model.surfaces)
    step = 0.0 if sharp else min(STEP_RAD, STEP_OF_HIGHLIGHT * body.highlight_rad)
    shape = (frames, -1)
    suns, observers = (v.reshape(frames, -1, 3) for v in (sun, observer))
    every = zip(suns, observers, view.time_s[0].reshape(shape), strict=True)
    far_m = np.linalg.norm(view.sun_m[0] - view.place_m[0], axis=-1).reshape(shape)[:, 0]
    radii = (SUN_RADIUS_RAD * ASTRONOMICAL_UNIT_M / far_m).tolist()  # each frame's own Sun
    each = [
        model_light(model, *moments, error, radius, step)[0]
        for moments, radius in zip(every, radii, strict=True)
    ]
    return np.concatenate(each)


def mesh_earthshine_m2_sr(
    body: MeshBody,
    epoch: tuple[float, float],
    view: View,
    albedo: float,
    besides_m2_sr: Array,
    field: str = "body",
    frames: int = 1,
) -> Array:
    """Radiant intensity (n,) in earthshine over the solar irradiance at the Earth [m2/sr].

    view : T = 1; besides_m2_sr : (n,) what the body sends besides, in that unit: the share that may
    err is of both together. Worked out EARTH_STEP_RAD apart (of Sun, observer, Earth and joints
    together), straight lines between: off by about step^2 / 8 of this light, 3e-4.
    """
    model, error = _read(body, field)
    attitude = attitudes([body.attitude or UPRIGHT], epoch, view, [field])[0]
    place, sun_m, times = view.place_m[0], view.sun_m[0], view.time_s[0]
    turn = np.broadcast_to(attitude, (len(times), 3, 3))
    sun, observer = in_body_axes(turn, view.sun[0]), in_body_axes(turn, view.observer[0])
    down = in_body_axes(turn, -place / np.sqrt(np.sum(place * place, -1, keepdims=True)))
    sharp = any(surface.sun_rings for surface in model.surfaces)

    def one(i: int) -> float:
        def lamp(n: int) -> Lamps:
            directions, light = earth_lamps(place[i], sun_m[i], albedo, n)
            return in_body_axes(turn[i], directions[0]), light[0]

        facets, rest = posed(model, sun[i], float(times[i])), float(besides_m2_sr[i])
        return wide_lamp_intensity(facets, model.surfaces, lamp, observer[i], error, rest)[0]

    each = []
    for of in np.arange(len(times)).reshape(frames, -1):
        way = way_rad(model, (sun[of], observer[of], down[of]), times[of])
        knots = knots_of(way, STEP_RAD if sharp else EARTH_STEP_RAD)
        each.append(np.interp(way, way[knots], [one(int(of[k])) for k in knots]))
    return np.concatenate(each)


def _read(body: MeshBody, field: str) -> tuple[MeshModel, float]:
    """A body's model and its shadows' error; BadInput where its files have not been read."""
    if body.model is None or body.error is None:
        raise BadInput(f"{field}.path", body.path, "a mesh that has been read")
    return body.model, body.error
