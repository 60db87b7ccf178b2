"""Stray light of a scene: what Sun, Moon and Earth scatter onto the focal plane, per pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.errors import BadInput
from pipeline.physics.constants import (
    ASTRONOMICAL_UNIT_M,
    DEG_RAD,
    EARTH_EQUATORIAL_RADIUS_M,
    SUN_RADIUS_M,
)
from pipeline.physics.positions.earth import earth_and_sun, gcrs_to_itrs
from pipeline.physics.positions.focal_plane import ifov_rad, project
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.sky.earth_disc import earth_stray
from pipeline.physics.sky.moon import irradiance_share
from pipeline.physics.sky.pst import Pst
from pipeline.physics.targets.eclipse import sunlit_fraction
from pipeline.physics.targets.lighting import phase_angle
from pipeline.physics.targets.shadow import MOON_RADIUS_M, moon_m, sunlit_past_earth
from pipeline.physics.vectors import angular_radius, separation
from pipeline.plan.decision import Decision
from pipeline.plan.pointing.geometry import camera_of
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.sky.stray_light import StrayLight

if TYPE_CHECKING:
    from pipeline.physics.sky.extinction import BandExtinction

Array = NDArray[np.float64]

FIELD = "background.stray_light"
OVER_ENDS = 1.02  # a part of the frame or a moment between those looked at may get so much more


@dataclass(frozen=True, eq=False)
class StrayInputs:
    """What was read: the curve, and electrons/s/m2 of the Sun at 1 au and of moonlight that is as
    strong in V; albedo : (rows, columns) of `physics.sky.earth_disc`."""

    pst: Pst
    sun_rate: float
    moon_rate: float
    albedo: Array


@dataclass(frozen=True)
class _Body:
    """A body as a lamp: unit vector and distance to its middle, its radius on the sky [rad], and
    its irradiance [electrons/s/m2]."""

    towards: Array
    radius_rad: float
    irradiance: float


def stray_parts(
    scene: Scene,
    request: StrayLight,
    inputs: StrayInputs,
    g: Geometry,
    f: int,
    node: int,
    u: Array,
    dut1_s: float,
    extinction: BandExtinction | None = None,
    checked: bool = True,
) -> dict[str, Array]:
    """Electrons/s and pixel (n,) of each body at one instant; u : (n, 3) lines of sight.

    A body behind the Earth gives none, and one half behind it half. Raises BadInput for a body
    within the exclusion angle, or in a line of sight, or where the curve does not reach; unless
    checked is False: of lines of sight that are no frame of the scene's.
    """
    tt = g.tt1[f, node], g.tt2[f, node]
    earth = earth_and_sun(*tt)
    place = g.observer_m[f, node] - earth.position_m[0]
    sun = earth.sun_from_earth_m[0]
    pixel_m2 = (scene.sensor.pixel_pitch_um * 1e-6) ** 2 * scene.sensor.fill_factor
    out: dict[str, Array] = {}
    for name, lamp in _lamps(request, inputs, place, sun, tt).items():
        if extinction is not None and g.has_air:
            passed = extinction.transmission(lamp.towards @ g.air[f, node, :3])
            lamp = replace(lamp, irradiance=lamp.irradiance * float(passed))
        if lamp.irradiance > 0.0 and checked:
            _check_frame(scene, g.attitude[f, node], name, lamp)
            _check(request, inputs.pst, name, separation(u, lamp.towards[None]))
        out[name.lower()] = _lamp(inputs, lamp, u) * pixel_m2
    if request.earth and not isinstance(scene.observer, GroundObserver):
        turn = np.eye(3)
        if inputs.albedo.size > 1:
            turn = gcrs_to_itrs(instants(parse_utc(scene.epoch), g.offset_s[f, node], dut1_s))[0]
        out["earth"] = _earth(request, inputs, turn, place, sun, u, checked) * pixel_m2
    return out


def _lamps(
    request: StrayLight, inputs: StrayInputs, place: Array, sun: Array, tt: tuple[Array, Array]
) -> dict[str, _Body]:
    """Sun and Moon, where they are asked for."""
    lamps = {}
    if request.sun:
        lamps["Sun"] = _sun(inputs, place, sun)
    if request.moon:
        lamps["Moon"] = _moon(inputs, place, sun, moon_m(*tt)[0])
    return lamps


def _sun(inputs: StrayInputs, place: Array, sun: Array) -> _Body:
    to_sun = sun - place
    distance = float(np.sqrt(to_sun @ to_sun))
    lit = float(sunlit_fraction(place[None], sun)[0])
    rate = inputs.sun_rate * lit * (ASTRONOMICAL_UNIT_M / distance) ** 2
    radius = float(angular_radius(SUN_RADIUS_M, to_sun))
    return _Body(to_sun / distance, radius, rate)


def _moon(inputs: StrayInputs, place: Array, sun: Array, moon: Array) -> _Body:
    to_moon, to_sun = moon - place, sun - moon
    distance, from_sun = float(np.sqrt(to_moon @ to_moon)), float(np.sqrt(to_sun @ to_sun))
    share = irradiance_share(phase_angle(moon, sun, place), np.array(from_sun), np.array(distance))
    # The Earth before the Moon's disc, and its shadow on the Moon.
    lit = _seen_past_earth(place, to_moon, MOON_RADIUS_M)
    lit *= float(sunlit_past_earth(moon[None], sun)[0])
    radius = float(angular_radius(MOON_RADIUS_M, to_moon))
    return _Body(to_moon / distance, radius, float(share) * inputs.moon_rate * lit)


def _seen_past_earth(place: Array, to_body: Array, radius_m: float) -> float:
    """Share of a round body's disc that stands beside the Earth's, as linear in its height."""
    distance = float(np.sqrt(place @ place))
    limb = float(angular_radius(EARTH_EQUATORIAL_RADIUS_M, place))
    range_m = float(np.sqrt(to_body @ to_body))
    if range_m < distance:
        return 1.0  # nearer than the Earth
    radius = float(angular_radius(radius_m, to_body))
    above = float(separation(to_body, -place)) - limb
    return float(np.clip(0.5 + 0.5 * above / radius, 0.0, 1.0))


def _lamp(inputs: StrayInputs, body: _Body, u: Array) -> Array:
    """Electrons/s/m2 of focal plane (n,) of a lamp."""
    if body.irradiance <= 0.0:
        return np.zeros(len(u))
    return inputs.pst.value(separation(u, body.towards[None])) * body.irradiance


def _earth(
    request: StrayLight,
    inputs: StrayInputs,
    turn: Array,
    place: Array,
    sun: Array,
    u: Array,
    checked: bool,
) -> Array:
    """Electrons/s/m2 of focal plane (n,) of the Earth's disc; turn : (3, 3) to its own axes."""
    distance = float(np.sqrt(sun @ sun))
    radius = float(angular_radius(EARTH_EQUATORIAL_RADIUS_M, place))
    from_limb = separation(u, -place[None]) - radius
    beside, light = from_limb > 0.0, np.zeros(len(u))
    if beside.any():
        light[beside] = earth_stray(u[beside], place, sun, inputs.pst, inputs.albedo, turn)
    if checked and (light.any() or not beside.all()):  # else all that is seen of it is dark
        _check(request, inputs.pst, "Earth's limb", from_limb, 2.0 * radius)
    return light * (inputs.sun_rate * (ASTRONOMICAL_UNIT_M / distance) ** 2)


def _check_frame(scene: Scene, attitude: Array, name: str, body: _Body) -> None:
    """Refuse a body whose disc touches the frame."""
    camera = camera_of(scene)
    x, y = (float(v[0]) for v in project(camera, attitude, body.towards[None]))
    margin = 0.5 + body.radius_rad / ifov_rad(camera)
    if -margin <= x <= camera.columns - 1 + margin and -margin <= y <= camera.rows - 1 + margin:
        raise _in_field(name)


def _in_field(name: str) -> BadInput:
    return BadInput(
        FIELD,
        f"the {name} in the field",
        f"a field beside the {name}: light that comes straight in is no stray light",
    )


def _check(request: StrayLight, pst: Pst, name: str, angle: Array, across: float = 0.0) -> None:
    """Refuse a body in a line of sight, inside the exclusion angle, or beyond the curve's end.

    angle : (n,) from lines of sight to its nearest point, whose farthest is so far `across` [rad]
    """
    nearest, farthest = float(angle.min()), min(float(angle.max()) + across, np.pi)
    if nearest <= 0.0:
        raise _in_field(name)
    if request.inside == "refuse" and nearest < pst.exclusion_rad:
        raise BadInput(
            FIELD,
            f"{nearest / DEG_RAD:.4g} deg from the field to the {name}",
            f"{pst.exclusion_rad / DEG_RAD:g} degrees or more (exclusion_deg, or where the "
            "curve begins), or inside: extrapolate or clip",
        )
    _check_end(
        pst, farthest, f"angles up to {farthest / DEG_RAD:.4g} degrees, where the {name} stands"
    )


def _check_end(pst: Pst, farthest_rad: float, allowed: str) -> None:
    """Refuse angles beyond the end of a curve that says nothing of what is there."""
    if getattr(pst, "beyond", None) == "refuse" and farthest_rad > pst.end_rad:
        told = f"a curve that ends at {pst.end_rad / DEG_RAD:g} deg"
        raise BadInput(FIELD + ".pst.path", told, f"{allowed}; or pst.beyond: zero or clip")


def check_all_round(pst: Pst) -> None:
    """Refuse a curve that ends before 180 degrees for a sensor that may look anywhere."""
    _check_end(pst, np.pi, "180 degrees, as a sensor may look anywhere")


def stray_told(request: StrayLight, ends: list[dict[str, Array]]) -> list[Decision]:
    """What each body gives, and how well it is known; ends : parts in the first and last frame."""
    told = {
        "sun": "a point; the fraction of it that the Earth leaves free (uniform disc)",
        "moon": "a point; phase law of Krisciunas & Schaefer 1991 (8% from Kieffer & Stone 2005 "
        "beyond 10 degrees, up to 35% fainter than a full Moon), their colours",
        "earth": "a Lambertian sphere, integrated over its visible sunlit disc to 1e-4; clouds, "
        "sea glints and air at the terminator are not in it: tens of percent at times",
    }
    out = []
    for name, how in told.items():
        component = f"stray_light.{name}"
        if name in ends[0]:
            values = np.concatenate([e[name] for e in ends])
            span = f"{values.min():.4g} to {values.max():.4g} e-/s per pixel"
            most, unit = OVER_ENDS * float(values.max()), "e-/s per pixel"
            out.append(Decision(component, True, f"{span}: {how}", bound=most, unit=unit))
        elif name == "earth" and request.earth:
            out.append(Decision(component, False, "a site on the ground sees no disc", 0.0, 0.0))
        else:
            out.append(Decision(component, False, "switched off in the scene"))
    curve = (
        request.pst.kind
        if request.inside == "refuse"
        else f"{request.pst.kind}, {request.inside} inside"
    )
    out.append(
        Decision(
            "stray_light.pst",
            True,
            f"{curve}; the angle of each pixel's own line of sight; its azimuth plays no part",
        )
    )
    return out
