"""The detector's terms as the scene gives them: numbers, or images, each in its range."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import SensorMaps, Value
from pipeline.errors import BadInput
from pipeline.inputs.sensor.detector import with_detector
from pipeline.inputs.sensor.images import declared_unit, gather_image
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.sensor import NumberOrImage

LIMITS = {  # least and largest value of a pixel, both allowed; a flat's dead pixels are 0
    "flat": (0.0, 1e3),
    "dark_e_per_s": (0.0, 1e12),
    "read_noise_e": (0.0, 1e9),
    "gain_e_per_dn": (1e-9, 1e6),
    "bias_dn": (-1e19, 2e19),
}


USUAL_FLAT = (0.2, 2.0)  # mean of an image; others are likely in counts or percent


def flat_remarks(scene: Scene, maps: SensorMaps) -> list[str]:
    """What an image of the flat does to all light, where its mean is far from 1."""
    mean = float(np.mean(maps.flat))
    if not isinstance(scene.sensor.flat, str) or USUAL_FLAT[0] <= mean <= USUAL_FLAT[1]:
        return []
    return [
        f"sensor.flat: the mean of {scene.sensor.flat} is {mean:.3g}: all light is multiplied by "
        "it; an image in counts or percent is to be divided by its mean"
    ]


UNITS = {  # of the images, the first as it is said; in these spellings, as `_plain` has them
    "dark_e_per_s": ("e-/s", "electron/s", "electron s-1", "electron s**-1", "electron/sec", "e/s"),
    "read_noise_e": ("e-", "electron", "e"),
    "gain_e_per_dn": ("e-/DN", "electron/adu", "e/adu"),
    "bias_dn": ("DN", "count", "counts", "ct"),
}


def unit_warnings(scene: Scene) -> list[str]:
    """Images whose file declares another unit than that in which they are read (BUNIT)."""
    out = []
    for name, meant in UNITS.items():
        given = getattr(scene.sensor, name)
        scaled = name == "dark_e_per_s" and scene.sensor.dark_scale != 1.0
        declared = declared_unit(given) if isinstance(given, str) and not scaled else ""
        if declared and _plain(declared) not in map(_plain, meant):
            more = ", or sensor.dark_scale converts it" if name == "dark_e_per_s" else ""
            out.append(
                f"sensor.{name}: {given} says that its unit is {declared!r} (BUNIT); its values "
                f"are taken as {meant[0]}: remove BUNIT where they are{more}"
            )
    return out


def _plain(unit: str) -> str:
    """A unit without case, spaces and the ways to write a quotient."""
    return "".join(unit.lower().split()).replace("dn", "adu").replace("electrons", "electron")


def gather_sensor_maps(scene: Scene) -> SensorMaps:
    """Read the images that the sensor names and check shape, finiteness and range."""
    values = {name: _gather(scene, name) for name in LIMITS}
    maps = SensorMaps(
        values["flat"],
        values["dark_e_per_s"],
        values["read_noise_e"],
        values["gain_e_per_dn"],
        values["bias_dn"],
    )
    if scene.sensor.detector is None:
        return maps
    return with_detector(maps, scene)


def _gather(scene: Scene, name: str) -> Value:
    given: NumberOrImage = getattr(scene.sensor, name)
    if not isinstance(given, str):
        return float(given)
    field = f"sensor.{name}"
    image = gather_image(given, field, scene.sensor.shape)
    least, most = LIMITS[name]
    if name == "dark_e_per_s":
        image = image * scene.sensor.dark_scale
    for value in (float(image.min()), float(image.max())):
        if not least <= value <= most:
            found = f"{given} with a pixel of {value:g}"
            raise BadInput(field, found, f"pixels from {least:g} to {most:g}")
    if name == "flat" and not image.any():
        raise BadInput(field, f"{given} of zeros", "an image with a pixel above 0")
    return image
