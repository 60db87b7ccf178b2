"""The sensor's terms with what its detector adds: faults, patterns, amplifiers, a bent response."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, SensorMaps, Value
from pipeline.inputs.sensor.images import gather_image
from pipeline.physics.noise.patterns import bias_pattern_dn, chosen, hot_dark_e_s, prnu
from pipeline.plan.sensor.detector import linearity
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.detector import (
    Detector,
    Failing,
    HotPixels,
)


def with_detector(maps: SensorMaps, scene: Scene) -> SensorMaps:
    """The maps with all that is fixed about the detector put in; what is off costs no image.

    Order: the sensor's own images, then amplifiers, then patterns, then faults.
    """
    d, shape, seed = scene.sensor.detector, scene.sensor.shape, scene.seed
    assert d is not None
    maps = _amplified(maps, d, shape)
    if d.bias_structure is not None:
        pattern = bias_pattern_dn(shape, seed, **d.bias_structure.model_dump())
        maps = replace(maps, bias_dn=maps.bias_dn + pattern)
    if d.prnu > 0:
        maps = replace(maps, flat=maps.flat * prnu(shape, seed, d.prnu))
    if d.hot is not None:
        maps = replace(maps, dark_e_per_s=maps.dark_e_per_s + _hot(d.hot, shape, seed))
    if d.dead is not None:
        failing = gather_failing(d.dead, "dead", shape, seed)
        maps = replace(maps, flat=np.where(failing, 0.0, maps.flat))
    if d.nonlinearity is not None:
        maps = replace(maps, linearity=linearity(d, float(scene.sensor.full_well_e or 0.0)))
    if d.bad is not None:
        y, x = np.nonzero(gather_failing(d.bad, "bad", shape, seed))
        maps = replace(maps, bad=(y, x, np.full(y.shape, d.bad.reads_dn, np.int64)))
    return maps


def gather_faults(scene: Scene) -> dict[str, Array] | None:
    """Which pixels fail, as columns of a table; None where no fault is asked for.

    row, column (n,); fault : bad, dead or hot, a row for each that a pixel has; reads_dn : of bad
    ones, else -1; dark_e_per_s : of hot ones beyond the sensor's own, else 0. Sorted by place.
    In TDI a pixel is a place of the array: dead and hot ones act on all charge that passes them.
    """
    d, shape, seed = scene.sensor.detector, scene.sensor.shape, scene.seed
    if d is None:
        return None
    parts = []
    for name in ("bad", "dead"):
        found = getattr(d, name)
        if found is not None:
            y, x = np.nonzero(gather_failing(found, name, shape, seed))
            parts.append((y, x, name, getattr(found, "reads_dn", -1), np.zeros(y.shape)))
    if d.hot is not None:
        extra = _hot(d.hot, shape, seed)
        y, x = np.nonzero(extra)
        parts.append((y, x, "hot", -1, extra[y, x]))
    if not parts:
        return None
    *places, names, reads_dn, dark_e_per_s = zip(*parts, strict=True)
    rows, columns = (np.concatenate(place).astype(np.int32) for place in places)
    order, many = np.lexsort((columns, rows)), list(map(len, dark_e_per_s))
    return {
        "row": rows[order],
        "column": columns[order],
        "fault": np.repeat(names, many)[order],
        "reads_dn": np.repeat(np.array(reads_dn, np.int64), many)[order],
        "dark_e_per_s": np.concatenate(dark_e_per_s)[order],
    }


def gather_failing(
    found: Failing, name: str, shape: tuple[int, int], seed: int
) -> NDArray[np.bool_]:
    """Which pixels (ny, nx) have a fault: listed, in rows and columns, in the image, by chance."""
    out = np.zeros(shape, bool)
    if found.pixels:
        y, x = np.array(found.pixels).T
        out[y, x] = True
    out[list(found.rows)] = True
    out[:, list(found.columns)] = True
    if found.map is not None:
        out |= gather_image(found.map, f"sensor.detector.{name}.map", shape) != 0
    if found.fraction > 0:
        out |= chosen(shape, seed, f"{name}_pixels", found.fraction)
    return out


def _hot(hot: HotPixels, shape: tuple[int, int], seed: int) -> Array:
    out = np.zeros(shape)
    if hot.fraction > 0:
        out += hot_dark_e_s(shape, seed, hot.fraction, hot.median_e_per_s, hot.sigma_dex)
    for y, x, dark_e_s in hot.pixels:
        out[y, x] += dark_e_s
    return out


def _amplified(maps: SensorMaps, d: Detector, shape: tuple[int, int]) -> SensorMaps:
    """Gain, bias and read noise with each amplifier's own in its rectangle."""
    if not d.amplifiers:
        return maps

    def image(value: Value) -> Array:
        return np.array(np.broadcast_to(value, shape), float)

    gain, bias, read = (image(v) for v in (maps.gain_e_per_dn, maps.bias_dn, maps.read_noise_e))
    for a in d.amplifiers:
        part = slice(*a.rows), slice(*a.columns)
        if a.gain_e_per_dn is not None:
            gain[part] = a.gain_e_per_dn
        if a.read_noise_e is not None:
            read[part] = a.read_noise_e
        bias[part] += a.offset_dn
    return replace(maps, gain_e_per_dn=gain, bias_dn=bias, read_noise_e=read)
