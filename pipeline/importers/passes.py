"""A satellite that passes the zenith of a site in the middle of an exposure."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.importers.placing import EARTH_MU_M3_S2, electrons_of_sunlight
from pipeline.inputs.band.curves import resolve_response
from pipeline.inputs.earth_orientation import gather_dut1_s, gather_pole_arcsec, with_pole
from pipeline.physics.positions.apparent import proper_to_astrometric
from pipeline.physics.positions.times import format_utc, instants, parse_utc
from pipeline.physics.radiometry import ab_photon_rate, collecting_area_m2
from pipeline.physics.vectors import to_angles
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.pointing.site import place_of
from pipeline.spec.load import parse_scene
from pipeline.spec.pointing.observer import GroundObserver

LONG_S = 1e9
MOMENT_S = 1e-3  # an exposure so short that nothing moves far


@dataclass(frozen=True)
class Pass:
    """height_m : above the site; heading_rad : of its motion, from north through east
    magnitude : AB in the sensor's band, None for no light; tracked : the sensor follows it
    """

    height_m: float
    heading_rad: float
    magnitude: float | None
    tracked: bool


def zenith_pass(data: JsonObject, request: Pass) -> tuple[JsonObject, str | None]:
    """The scene with the satellite `sat` at the zenith, on a circular orbit, and its pointing.

    data : a scene with a ground observer, without pointing and targets; not changed. Where the
    satellite is not followed, the sensor holds the direction that it has at mid-exposure; one that
    streaks farther than a scene takes is omitted, and the second value says so.
    """
    data = copy.deepcopy(data)
    first, second = parse_utc(data["epoch"])
    epoch = (first, second + 0.5 * data["exposure"]["integration_s"] / 86_400.0)
    dut1_s, _ = gather_dut1_s(*epoch)
    pole = {"polar_motion_arcsec": gather_pole_arcsec(*epoch)}
    observer = GroundObserver.model_validate(data["observer"] | pole)
    site, _ = place_of(observer, instants(epoch, np.zeros(1), dut1_s))
    up = site[0] / np.linalg.norm(site[0])
    east = np.cross([0.0, 0.0, 1.0], up)
    east /= np.linalg.norm(east)
    along = (
        math.cos(request.heading_rad) * np.cross(up, east) + math.sin(request.heading_rad) * east
    )
    place = site[0] + request.height_m * up
    speed = math.sqrt(EARTH_MU_M3_S2 / float(np.linalg.norm(place)))
    state = {
        "kind": "state",
        "position_m": [float(v) for v in place],
        "velocity_m_s": [float(v) for v in speed * along],
        "epoch": format_utc(*epoch),
    }
    body: JsonObject = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.0}
    data["targets"] = [{"name": "sat", "orbit": state, "body": body, "eclipse": False}]
    data["pointing"] = {"mode": "target", "target": "sat"}
    just_before = format_utc(epoch[0], epoch[1] - 0.5 * MOMENT_S / 86_400.0)
    moment = data | {"epoch": just_before, "exposure": {"integration_s": MOMENT_S}}
    if request.magnitude is not None:
        data["targets"][0]["body"] = _light(moment, request.magnitude, dut1_s)
    if request.tracked:
        return data, None
    data["pointing"] = _held(moment, dut1_s)
    try:
        plan_geometry(with_pole(parse_scene(data)), np.zeros(1, np.int64), dut1_s)
    except BadInput as error:
        return data | {"targets": []}, f"the satellite: {error.allowed}"
    return data, None


def _light(data: JsonObject, magnitude: float, dut1_s: float) -> JsonObject:
    """A steady light curve of the electrons that the magnitude gives."""
    curve: JsonObject = {
        "kind": "light_curve",
        "times_s": [-LONG_S, LONG_S],
        "intensities_m2_sr": [1.0, 1.0],
    }
    data = copy.deepcopy(data)
    data["targets"][0]["body"] = curve
    g = plan_geometry(with_pole(parse_scene(data)), np.zeros(1, np.int64), dut1_s)
    s = data["sensor"]
    response, *_ = resolve_response(s["bandpass"], s["transmission"], 1.0)
    area = collecting_area_m2(s["aperture_m"], s["obscuration"])
    wanted = ab_photon_rate(magnitude, response) * area
    value = wanted / (electrons_of_sunlight(s) * float(g.target_light[0, 0, g.middle]))
    return curve | {"intensities_m2_sr": [value, value]}


def _held(data: JsonObject, dut1_s: float) -> JsonObject:
    """The sidereal pointing that has the target at its centre at mid-exposure."""
    g = plan_geometry(with_pole(parse_scene(data)), np.zeros(1, np.int64), dut1_s)
    seen = g.observer_at(0, g.middle)
    ra, dec = to_angles(proper_to_astrometric(g.target_direction[:, 0], seen))
    return {
        "mode": "sidereal",
        "boresight_ra_deg": float(np.degrees(ra[0]) % 360.0),
        "boresight_dec_deg": float(np.degrees(dec[0])),
    }
