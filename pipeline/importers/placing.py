"""Orbits that put targets on given pixels with a given light, found by asking the geometry."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.inputs.band.curves import resolve_response, solar_spectrum
from pipeline.physics.positions.focal_plane import Camera, deproject
from pipeline.physics.radiometry import band_photon_irradiance_sun, collecting_area_m2
from pipeline.plan.pointing.geometry import camera_of, plan_geometry
from pipeline.spec.load import parse_scene

Array = NDArray[np.float64]

EARTH_MU_M3_S2 = 3.986004418e14  # of the EGM96 gravity model
FAR_M, APART_M = 1e9, 4e7  # observer from the Earth, targets from the observer
TURNS = 4  # of the correction: the first moves by aberration, each next errs a thousandth
LONG_S = 1e9


@dataclass(frozen=True)
class Wanted:
    """A point of light: its pixel at the start of the first exposure, its motion, its rate.

    x_px, y_px : pixel (0, 0) is the centre of the first; x_px_s, y_px_s; rate_e_s : electrons
    """

    name: str
    x_px: float
    y_px: float
    x_px_s: float
    y_px_s: float
    rate_e_s: float


def far_observer(ra_deg: float, dec_deg: float) -> JsonObject:
    """An observer far from the Earth that has it at its back: targets near it move straight."""
    ra, dec = math.radians(ra_deg), math.radians(dec_deg)
    out = np.array([math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)])
    side = np.array([-math.sin(ra), math.cos(ra), 0.0])
    speed = math.sqrt(EARTH_MU_M3_S2 / FAR_M)
    state = {
        "position_m": [float(v) for v in FAR_M * out],
        "velocity_m_s": [float(v) for v in speed * side],
    }
    return {"kind": "orbit", "orbit": {"kind": "state", **state}}


def place(data: JsonObject, wanted: list[Wanted]) -> JsonObject:
    """The scene with targets that cross the pixels as wanted, to about 1e-4 px at both ends.

    data : a scene with a `far_observer` and without targets; not changed
    """
    data = copy.deepcopy(data)
    if not wanted:
        return data
    camera = camera_of(parse_scene(data))
    ends, seconds = _views(data)
    at = np.array(
        [
            [(w.x_px, w.y_px), (w.x_px + seconds * w.x_px_s, w.y_px + seconds * w.y_px_s)]
            for w in wanted
        ]
    )
    intensities = np.ones(len(wanted))
    aimed = at.copy()
    for _ in range(TURNS):
        data["targets"] = [
            _target(data, w, camera, ends, seconds, aim, light)
            for w, aim, light in zip(wanted, aimed, intensities, strict=True)
        ]
        seen, rates = _seen(data)
        if not np.isfinite(seen).all():
            raise BadInput("geometry.obs", "a target", "targets in front of the camera")
        aimed += at - seen
        intensities = np.array(
            [
                light * w.rate_e_s / rate if rate > 0 else light
                for light, w, rate in zip(intensities, wanted, rates, strict=True)
            ]
        )
    return data


def _views(data: JsonObject) -> tuple[tuple[Array, Array], float]:
    """Attitudes at the first exposure's start and the last one's end, and the time between."""
    scene = parse_scene(data)
    frames = np.unique([0, scene.exposure.frames - 1]).astype(np.int64)
    g = plan_geometry(scene, frames, 0.0)
    return (g.attitude[0, 0], g.attitude[-1, -1]), float(g.offset_s[-1, -1] - g.offset_s[0, 0])


def _target(
    data: JsonObject,
    w: Wanted,
    camera: Camera,
    ends: tuple[Array, Array],
    seconds: float,
    aim: Array,
    intensity_m2_sr: float,
) -> JsonObject:
    """A target that moves evenly between the directions of two aimed pixels."""
    observer = data["observer"]["orbit"]
    first, last = (
        deproject(camera, attitude, np.array([x]), np.array([y]))[0] * APART_M
        for attitude, (x, y) in zip(ends, aim, strict=True)
    )
    return {
        "name": w.name,
        "orbit": {
            "kind": "state",
            "position_m": [float(v) for v in observer["position_m"] + first],
            "velocity_m_s": [float(v) for v in observer["velocity_m_s"] + (last - first) / seconds],
        },
        "body": {
            "kind": "light_curve",
            "times_s": [-LONG_S, LONG_S],
            "intensities_m2_sr": [float(intensity_m2_sr)] * 2,
        },
        "eclipse": False,
    }


def _seen(data: JsonObject) -> tuple[Array, Array]:
    """Where the targets are at both ends [px] (n, 2, 2), and their electrons a second (n,)."""
    scene = parse_scene(data)
    frames = np.unique([0, scene.exposure.frames - 1]).astype(np.int64)
    g = plan_geometry(scene, frames, 0.0)
    first = np.stack([g.target_x_px[:, 0, 0], g.target_y_px[:, 0, 0]], -1)
    last = np.stack([g.target_x_px[:, -1, -1], g.target_y_px[:, -1, -1]], -1)
    rate = electrons_of_sunlight(data["sensor"]) * g.target_light[:, 0, g.middle]
    return np.stack([first, last], axis=1), rate


def electrons_of_sunlight(sensor: JsonObject) -> float:
    """Electrons a second that a sensor (as plain data) collects from direct sunlight at 1 au."""
    response, *_ = resolve_response(
        sensor["bandpass"], sensor.get("transmission", 1.0), sensor.get("quantum_efficiency", 1.0)
    )
    wavelength, irradiance, *_ = solar_spectrum()
    area = collecting_area_m2(sensor["aperture_m"], sensor.get("obscuration", 0.0))
    return band_photon_irradiance_sun(wavelength, irradiance, response) * area
