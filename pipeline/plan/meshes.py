"""Bodies from meshes: their attitude, and the light they send, for the plan's geometry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.meshes.model import MeshModel, model_light
from pipeline.physics.targets.attitude import in_body_axes
from pipeline.plan.body_attitudes import UPRIGHT, View, attitudes
from pipeline.spec.mesh import MeshBody

Array = NDArray[np.float64]

SUN_RADIUS_RAD = 4.652e-3  # 695,700 km at 1 au
STEP_RAD = 0.01  # between moments that are worked out, of bodies without sharp highlights


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
    spin = max((abs(p.joint.rate_rad_s) for p in body.model.parts if p.joint is not None),
               default=0.0)  # fmt: skip
    turn = np.concatenate([[0.0], np.cumsum(steps + spin * np.abs(np.diff(view.time_s[0])))])
    return pose, turn


def mesh_m2_sr(
    body: MeshBody, epoch: tuple[float, float], view: View, field: str = "body"
) -> Array:
    """Radiant intensity over solar irradiance (n,) [m2/sr]; view : T = 1.

    BadInput for a body whose files have not been read (`pipeline.inputs.meshes.gather_meshes`).
    """
    model: MeshModel | None = body.model
    if model is None or body.error is None:
        raise BadInput(f"{field}.path", body.path, "a mesh that has been read")
    law = body.attitude or UPRIGHT
    attitude = attitudes([law], epoch, view, [field])[0]
    sun = in_body_axes(attitude, view.sun[0])
    observer = in_body_axes(attitude, view.observer[0])
    sharp = any(surface.sun_rings for surface in model.surfaces)
    step = 0.0 if sharp else STEP_RAD
    times = view.time_s[0]
    return model_light(model, sun, observer, times, body.error, SUN_RADIUS_RAD, step)[0]
