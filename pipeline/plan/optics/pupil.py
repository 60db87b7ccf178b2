"""The projected pupil in the plan: light falls with the cosine of its angle off axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.physics.positions.focal_plane import Camera, off_axis_cosine
from pipeline.spec.scene import Scene

Array = NDArray[np.float64]


def pupil_fraction(scene: Scene, camera: Camera, x_px: Array, y_px: Array) -> Array:
    """Fraction (...) of their light that the pupil takes in from sources at pixels x, y (...).

    The entrance pupil is a flat disc at right angles to the axis: from off axis its area is seen
    foreshortened by the cosine (the fourth one of cos^4 illumination, beside the three of a
    gnomonic pixel's solid angle; Born & Wolf 1999, section 4.8.3). Vignetting and aberrations of
    the pupil are not in it. Ones where the sensor does not ask for it.
    """
    if not scene.sensor.pupil_projection:
        return np.ones(np.shape(x_px))
    return off_axis_cosine(camera, x_px, y_px)


def mean_pupil_fraction(scene: Scene, g: Geometry, observed: Array) -> Array:
    """Mean fraction (n,) of the one exposure of `g`, of stars seen in directions (n, 3)."""
    if not scene.sensor.pupil_projection:
        return np.ones(len(observed))
    axis = g.attitude[0, :, 2]
    mean = 0.5 * (axis[1:] + axis[:-1]).mean(axis=0)
    return np.maximum(observed @ mean, 0.0)


def pupil_along(scene: Scene, camera: Camera, offset_s: Array, x_px: Array, y_px: Array) -> Array:
    """The same of places x, y (..., K) at the K nodes of exposures at offset_s (K,) or (F, K).

    Under TDI a place moves with the charge: the light falls where the charge stands then.
    """
    middle = offset_s[..., [offset_s.shape[-1] // 2]]
    return pupil_fraction(scene, camera, x_px, y_px + camera.charge_px_s * (offset_s - middle))
