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
