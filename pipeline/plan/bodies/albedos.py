"""Albedos of bodies: tables of reflectance become their means over the sensor's band."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.radiometry import ResponseCurve
from pipeline.physics.targets.reflectance import band_reflectance
from pipeline.spec.scene import Scene
from pipeline.spec.targets.body import CompositeBody, Part

Array = NDArray[np.float64]


def albedo_of(part: Part, field: str) -> float:
    """A part's albedo as a number. BadInput where a table has not met its band yet."""
    if isinstance(part.albedo, tuple):
        raise BadInput(f"{field}.albedo", "a table", "a number here: see with_band_albedos")
    return part.albedo


def with_band_albedos(
    scene: Scene, sun_wavelength_m: Array, sun_irradiance_w_m3: Array, response: ResponseCurve
) -> Scene:
    """The scene with each table of reflectance replaced by its mean over the sensor's band.

    The same scene where there is none. BadInput where a table does not cover the band.
    """
    sun = (sun_wavelength_m, sun_irradiance_w_m3, response)

    def grey(part: Any, field: str) -> Any:
        if not isinstance(getattr(part, "albedo", None), tuple):
            return part
        mean = band_reflectance(part.albedo, *sun, f"{field}.albedo")
        return part.model_copy(update={"albedo": mean})

    targets = []
    for i, target in enumerate(scene.targets):
        body, field = target.body, f"targets.{i}.body"
        if isinstance(body, CompositeBody):
            parts = tuple(grey(p, f"{field}.parts.{k}") for k, p in enumerate(body.parts))
            same = all(a is b for a, b in zip(parts, body.parts, strict=True))
            made: Any = body if same else body.model_copy(update={"parts": parts})
        else:
            made = grey(body, field)
        targets.append(target if made is body else target.model_copy(update={"body": made}))
    if all(a is b for a, b in zip(targets, scene.targets, strict=True)):
        return scene
    return scene.model_copy(update={"targets": tuple(targets)})


def has_band_albedos(scene: Scene) -> bool:
    """True where a body of the scene has a table of reflectance."""
    return any(
        isinstance(getattr(part, "albedo", None), tuple)
        for target in scene.targets
        for part in getattr(target.body, "parts", (target.body,))
    )
