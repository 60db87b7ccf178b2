"""Orbits that put targets on given pixels with a given light, found by asking the geometry."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.arrays import Geometry
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
LIT = 9  # frames at most whose light is set
EVEN = 1e-5  # light that differs by less is the same in all


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

    Between them as well where the camera rests, else as `astray` says; the light is that wanted in
    LIT of the frames.
    data : a scene with a `far_observer` and without targets; not changed
    """
    data = copy.deepcopy(data)
    if not wanted:
        return data
    camera = camera_of(parse_scene(data))
    views = _views(data)
    at = _straight_px(wanted, np.array([0.0, views.seconds]))
    wanted_e_s = np.array([[w.rate_e_s] for w in wanted])
    intensities = np.ones((len(wanted), _frames(data).size))
    aimed = at.copy()
    for _ in range(TURNS):
        data["targets"] = [
            _target(data, w, camera, views, aim, light)
            for w, aim, light in zip(wanted, aimed, intensities, strict=True)
        ]
        seen, rates = _seen(_geometry(data), data["sensor"])
        if not np.isfinite(seen).all():
            raise BadInput("geometry.obs", "a target", "targets in front of the camera")
        aimed += at - seen[:, [0, -1]]
        share = np.divide(wanted_e_s, rates, out=np.ones_like(rates), where=rates > 0.0)
        intensities = intensities * share
    return data


def astray(data: JsonObject, wanted: list[Wanted]) -> float:
    """How far at most the targets of a placed scene are off their straight paths in its field
    [px]."""
    if not wanted:
        return 0.0
    g = _geometry(data)
    paths = _straight_px(wanted, (g.offset_s[:, [0, -1]] - g.offset_s[0, 0]).ravel())
    inside = (paths > -0.5) & (paths < np.array(data["sensor"]["shape"])[::-1] - 0.5)
    off_px = np.abs(_seen(g, data["sensor"])[0] - paths).max(axis=-1)
    return float(off_px.max(initial=0.0, where=inside.all(axis=-1)))


def _straight_px(wanted: list[Wanted], after_s: Array) -> Array:
    """Where targets are to be at times (k,) after the first exposure begins: (n, k, 2)."""
    return np.array([after_s[:, None] * (w.x_px_s, w.y_px_s) + (w.x_px, w.y_px) for w in wanted])


def _geometry(data: JsonObject) -> Geometry:
    """Of a scene's `_frames`."""
    return plan_geometry(parse_scene(data), _frames(data), 0.0)


def _frames(data: JsonObject) -> NDArray[np.int64]:
    """The first frame, the last, and some between, evenly."""
    return np.unique(np.linspace(0, data["exposure"]["frames"] - 1, LIT).round()).astype(np.int64)


@dataclass(frozen=True)
class _Views:
    """Attitudes at the first exposure's start and the last one's end, the time between, and the
    middles of `_frames` [s after the epoch]."""

    ends: tuple[Array, Array]
    seconds: float
    middles_s: Array


def _views(data: JsonObject) -> _Views:
    g = _geometry(data)
    seconds = float(g.offset_s[-1, -1] - g.offset_s[0, 0])
    return _Views((g.attitude[0, 0], g.attitude[-1, -1]), seconds, g.offset_s[:, g.middle])


def _target(
    data: JsonObject, w: Wanted, camera: Camera, views: _Views, aim: Array, intensities_m2_sr: Array
) -> JsonObject:
    """A target that moves evenly between two aimed pixels on a plane that the camera looks at.

    There equal steps are equal steps on pixels; its light makes up for its range.
    """
    observer = data["observer"]["orbit"]
    first, last = (
        _on_plane_m(camera, attitude, x, y)
        for attitude, (x, y) in zip(views.ends, aim, strict=True)
    )
    speed_m_s = (last - first) / views.seconds
    times_s, light = views.middles_s, intensities_m2_sr
    if np.ptp(light) < EVEN * light.max():
        times_s, light = times_s[:0], light[:1]
    return {
        "name": w.name,
        "orbit": {
            "kind": "state",
            "position_m": [float(v) for v in observer["position_m"] + first],
            "velocity_m_s": [float(v) for v in observer["velocity_m_s"] + speed_m_s],
        },
        "body": {
            "kind": "light_curve",
            "times_s": [-LONG_S, *times_s.tolist(), LONG_S],
            "intensities_m2_sr": [
                float(light[0]),
                *light[: times_s.size].tolist(),
                float(light[-1]),
            ],
        },
        "eclipse": False,
    }


def _on_plane_m(camera: Camera, attitude: Array, x_px: float, y_px: float) -> Array:
    """A place that is seen on a pixel, APART_M from the camera along its axis."""
    middle = 0.5 * (camera.columns - 1), 0.5 * (camera.rows - 1)
    sight, axis = deproject(camera, attitude, *np.transpose([(x_px, y_px), middle]))
    return np.asarray(sight / (sight @ axis) * APART_M)


def _seen(g: Geometry, sensor: JsonObject) -> tuple[Array, Array]:
    """Of `_frames`: where the targets are at their ends [px] (n, 2 frames, 2), and their electrons
    a second amid each (n, frames)."""
    ends = np.stack([g.target_x_px[..., [0, -1]], g.target_y_px[..., [0, -1]]], -1)
    rate = electrons_of_sunlight(sensor) * g.target_light[..., g.middle]
    return ends.reshape(ends.shape[0], -1, 2), rate


def electrons_of_sunlight(sensor: JsonObject) -> float:
    """Electrons a second that a sensor (as plain data) collects from direct sunlight at 1 au."""
    response, *_ = resolve_response(
        sensor["bandpass"], sensor.get("transmission", 1.0), sensor.get("quantum_efficiency", 1.0)
    )
    wavelength, irradiance, *_ = solar_spectrum()
    area = collecting_area_m2(sensor["aperture_m"], sensor.get("obscuration", 0.0))
    return band_photon_irradiance_sun(wavelength, irradiance, response) * area
