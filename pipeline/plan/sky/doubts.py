"""Skies that are not drawn: Sun, Moon, Earth and planets in the field or near it, a site by day."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.physics.constants import DEG_RAD
from pipeline.physics.positions.planets import OFF_RAD
from pipeline.physics.radiometry import ResponseCurve, surface_brightness_electron_rate
from pipeline.plan.acceptance import accept_or_refuse
from pipeline.plan.facts import Facts
from pipeline.plan.pointing.lamps import Lamp, LampGeometry, look
from pipeline.plan.timing import integration_range_s
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.sky.background import Background

if TYPE_CHECKING:
    from pipeline.plan.sky.undrawn import UndrawnNight

Array = np.ndarray

# Elevations of the Sun at a site: the night sky's parts are those of a dark night. At -12 degrees
# twilight is V = 19.7 at the zenith, 7 times a dark sky; from -18 on it is below 0.03 of one there.
HIGHEST_WITH_TWILIGHT_RAD = 0.0  # where the formula of twilight ends
HIGHEST_OF_NIGHT_RAD = -12.0 * DEG_RAD
DARK_RAD = -18.0 * DEG_RAD
# V of a Lambertian surface of albedo 0.3 under the Sun: -26.76 - 2.5 log10(0.3 / pi arcsec^2).
SUNLIT_EARTH_V_MAG = 2.4
# Within which telescopes in low orbits keep from the sunlit limb and the Moon (Hubble: 20 and 9).
EARTH_RAD, MOON_RAD = 20.0 * DEG_RAD, 9.0 * DEG_RAD
SMALL_RAD = 0.1 * DEG_RAD  # radius of a disc below which, far away, it is one star of many


@dataclass(frozen=True)
class Doubts:
    """What a scene accepts of a sky that is not drawn (`warnings`), and notes (`remarks`)."""

    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Skies:
    """Sun, Moon and Earth in the exposures of a scene that refuses none of it.

    nearest : the moment nearest to each doubt; sure : none was missed between the moments
    daylight, bodies : the warnings of what the scene accepts
    """

    seen: LampGeometry
    nearest: dict[str, int]
    sure: bool
    daylight: tuple[str, ...]
    bodies: tuple[str, ...]


def accepted_skies(scene: Scene, dut1_s: float) -> Skies:
    """Refuse skies that would be wrong in silence.

    All exposures are looked at, at moments between which nothing turns past a limit (`look`).
    Raises BadInput that names the angle or the elevation, unless `accept` names the word.
    """
    seen, sure = look(scene, dut1_s, lambda at: np.min([*_margins(scene, at).values()], axis=0))
    nearest = {name: int(np.argmin(m)) for name, m in _margins(scene, seen).items()}
    daylight = _daylight(scene, seen, nearest["day"])
    sun_undrawn = "neither its disc nor its light is"
    bodies = _in_field(scene, seen, "sun", nearest["sun"], sun_undrawn) or _sun_near(
        scene, seen, nearest["near the sun"]
    )
    moon_undrawn = "its disc and the glare around it are not"
    bodies += _in_field(scene, seen, "moon", nearest["moon"], moon_undrawn) or _moon_near(
        scene, seen, nearest["near the moon"]
    )
    return Skies(seen, nearest, sure, tuple(daylight), tuple(bodies))


def sky_doubts(
    scene: Scene,
    facts: Facts,
    response: ResponseCurve,
    dut1_s: float,
    night: UndrawnNight | None = None,
) -> Doubts:
    """Refuse skies that would be wrong in silence (`accepted_skies`); say what the scene accepts
    of them, and what is not drawn.

    night : what a site's sky lacks, where it `lacks_night`
    """
    skies = accepted_skies(scene, dut1_s)
    seen, nearest, sure = skies.seen, skies.nearest, skies.sure
    warnings = list(skies.daylight)
    remarks: list[str] = []
    if isinstance(scene.observer, GroundObserver):
        remarks = _own_value(scene, seen)
    if night is not None:
        warnings += _little_twilight(scene, facts, seen, night)
        warnings += _no_moonlight(scene, facts, seen, night)
    warnings += skies.bodies
    warnings += _earth_in_field(scene, facts, response, seen, nearest["earth"])
    warnings += _planets_in_field(seen, nearest)
    remarks += _no_stray_light(scene, seen)
    if not sure:
        remarks.append(
            f"Sun, Moon and Earth were looked for at {len(seen.tick)} moments of the exposures; "
            "the boresight turns so far between some of them that it may pass one unnoticed"
        )
    return Doubts(tuple(warnings), tuple(remarks))


def _margins(scene: Scene, at: LampGeometry) -> dict[str, Array]:
    """How far [rad] moments (n,) are from each doubt: daylight, Sun and Moon in the field or near
    it, the Earth in it; at or below 0 where there is one."""
    highest = highest_sun_rad(scene)
    day = np.full(len(at.tick), np.pi) if highest is None else highest - at.sun.elevation
    margins = {"day": day} | lamp_margins(scene, at.sun, at.moon) | {"earth": _off_field(at.earth)}
    planets = at.planets.items()
    return margins | {n: np.maximum(_off_field(lamp), lamp.hidden) for n, (lamp, _) in planets}


def lamp_margins(scene: Scene, sun: Lamp, moon: Lamp) -> dict[str, Array]:
    """How far [rad] Sun and Moon are from being in the field, and near it; shapes as theirs."""
    near_sun, near_moon = sun_exclusion_rad(scene), _moonlight_rad(scene)
    return {
        "sun": np.maximum(_off_field(sun), sun.hidden),
        "near the sun": np.maximum(sun.off_axis - near_sun, sun.hidden),
        "moon": np.maximum(_off_field(moon), moon.hidden),
        "near the moon": np.maximum(moon.off_frame - near_moon, moon.hidden),
    }


def _off_field(lamp: Lamp) -> Array:
    """How far a disc is from the frame [rad]; 0 and below where it touches it."""
    return np.asarray(lamp.off_frame - lamp.radius)


def sun_exclusion_rad(scene: Scene) -> float:
    """Angle from the boresight within which the Sun is in doubt: none where its stray light is
    drawn, which has an angle of its own."""
    b = scene.background
    if b is not None and b.stray_light is not None and b.stray_light.sun:
        return -np.pi
    return scene.sensor.sun_exclusion_deg * DEG_RAD


def _moonlight_rad(scene: Scene) -> float:
    """Angle from the frame within which moonlight is not known."""
    b = scene.background
    if b is None or not b.moonlight:
        return -np.pi
    return float(_night().NEAREST_MOON_RAD)


def _night() -> Any:
    """Light of the night sky; only scenes that need it load it."""
    from pipeline.physics.sky import night

    return night


def highest_sun_rad(scene: Scene) -> float | None:
    """Highest elevation of the Sun [rad] at which the sky of a site is drawn; None: at any.

    A sky that is the scene's own number, with nothing of the air, is taken for measured.
    """
    b = scene.background
    if not isinstance(scene.observer, GroundObserver) or _own_sky(b):
        return None
    return HIGHEST_WITH_TWILIGHT_RAD if b is not None and b.twilight else HIGHEST_OF_NIGHT_RAD


def lacks_night(scene: Scene) -> bool:
    """Whether a site's sky is drawn without its moonlight or its twilight."""
    b = scene.background
    if not isinstance(scene.observer, GroundObserver) or _own_sky(b):
        return False
    return b is None or not (b.moonlight and b.twilight)


def _own_sky(b: Background | None) -> bool:
    given = b is not None and (b.uniform_mag_arcsec2 is not None or b.uniform_e_per_s is not None)
    return given and b is not None and not b.of_the_air


def _daylight(scene: Scene, seen: LampGeometry, k: int) -> list[str]:
    """The Sun too high above a site for the sky that is drawn."""
    highest = highest_sun_rad(scene)
    up, where = _elevation(seen, k)
    if highest is None or up <= highest:
        return []
    b = scene.background
    names = [n for n in ("twilight", "airglow", "moonlight") if b is not None and getattr(b, n)]
    field = f"background.{names[0]}" if names else "epoch"
    more = "" if "twilight" in names else " (to 0 degrees with background.twilight)"
    size = "some 4 magnitudes per square arcsecond in V by day" if up > 0.0 else _size(up)
    return [
        accept_or_refuse(
            scene,
            "daylight",
            field,
            where,
            f"a Sun at or below {highest / DEG_RAD:g} degrees of elevation during all exposures"
            f"{more}, or a sky of your own, uniform_mag_arcsec2",
            f"{where}: the sky drawn is that of a night; the Sun's light in the air, {size}, "
            "is not",
        )
    ]


def _own_value(scene: Scene, seen: LampGeometry) -> list[str]:
    """What is said of the Sun where a site's sky is the scene's own number."""
    up, where = _elevation(seen, int(np.argmax(seen.sun.elevation)))
    if highest_sun_rad(scene) is not None or up <= DARK_RAD:
        return []
    return [f"{where}: the sky is the scene's own uniform value, whatever the Sun's light"]


def _elevation(seen: LampGeometry, k: int) -> tuple[float, str]:
    """The Sun's elevation [rad] at moment k, in numbers and words."""
    up = float(seen.sun.elevation[k])
    return up, f"the Sun at {up / DEG_RAD:.2f} deg of elevation (frame {seen.frame(k)})"


def _size(sun_elevation_rad: float) -> str:
    mag = _night().twilight_zenith_v_mag(sun_elevation_rad)
    return f"V = {mag:.1f} per square arcsecond at the zenith"


def _little_twilight(
    scene: Scene, facts: Facts, seen: LampGeometry, night: UndrawnNight
) -> list[str]:
    """What is said of twilight that is not asked for, where it is more than the accuracy; of a Sun
    that is too high `_daylight` speaks."""
    b, highest = scene.background, highest_sun_rad(scene)
    if (b is not None and b.twilight) or (highest is None or seen.sun.elevation.max() > highest):
        return []
    k, light = night.most("twilight", seen)
    size = _undrawn_size(scene, facts, light)
    if size is None:
        return []
    return [f"{_elevation(seen, k)[1]}: twilight, {size} (background.twilight draws it)"]


def _no_moonlight(scene: Scene, facts: Facts, seen: LampGeometry, night: UndrawnNight) -> list[str]:
    """What is said of moonlight that is not asked for, where it is more than the accuracy."""
    b = scene.background
    if b is not None and b.moonlight:
        return []
    k, light = night.most("moonlight", seen)
    size = _undrawn_size(scene, facts, light)
    if size is None:
        return []
    return [
        f"the Moon at {float(seen.moon.elevation[k]) / DEG_RAD:.2f} deg of elevation (frame "
        f"{seen.frame(k)}): moonlight, {size} (background.moonlight draws it)"
    ]


def _undrawn_size(scene: Scene, facts: Facts, light: float) -> str | None:
    """How much light of electrons per m2 and sr in an exposure is; None below the accuracy."""
    light_e = light * facts.area_m2 * facts.ifov_rad**2 * scene.sensor.fill_factor
    if light_e <= scene.accuracy.noise_fraction * facts.light_floor_e:
        return None
    return f"{light_e:.3g} e- per pixel in the middle of the frame, is not drawn"


def _light_e(scene: Scene, facts: Facts, response: ResponseCurve, mag: float) -> float:
    """Electrons in a pixel and the longest exposure of a sky of V mag per square arcsecond, which
    is an AB magnitude within 0.02."""
    solid_sr = facts.ifov_rad**2 * scene.sensor.fill_factor
    rate = surface_brightness_electron_rate(mag, response, facts.area_m2, solid_sr)
    return rate * integration_range_s(scene)[1]


def _earth_in_field(
    scene: Scene, facts: Facts, response: ResponseCurve, seen: LampGeometry, k: int
) -> list[str]:
    """What is said of a frame across the Earth's limb or a site's horizon (a boresight inside is
    refused)."""
    inside = -float(_off_field(seen.earth)[k])
    if inside < 0.0:
        return []
    if isinstance(scene.observer, GroundObserver):
        return [
            f"the horizon is in the field, {inside / DEG_RAD:.2f} deg above its lowest corner "
            f"(frame {seen.frame(k)}): the ground is not drawn, and the sky is drawn across it"
        ]
    light_e = _light_e(scene, facts, response, SUNLIT_EARTH_V_MAG)
    return [
        f"the Earth is in the field, its limb {inside / DEG_RAD:.2f} deg inside the frame (frame "
        f"{seen.frame(k)}): its disc, about V = {SUNLIT_EARTH_V_MAG:g} per square arcsecond or "
        f"{light_e:.3g} e- per pixel where the Sun is high, is not drawn, and the sky is drawn "
        "across it"
    ]


def _planets_in_field(seen: LampGeometry, nearest: dict[str, int]) -> list[str]:
    """What is said of planets, which no catalogue of stars holds."""
    return [
        f"{name} is in the field, or within {OFF_RAD / DEG_RAD:.2f} deg of it, in frame "
        f"{seen.frame(nearest[name])}: it is not drawn, V = {v_mag[nearest[name]]:.1f} if fully lit"
        for name, (lamp, v_mag) in seen.planets.items()
        if _touches(lamp, nearest[name])
    ]


def _no_stray_light(scene: Scene, seen: LampGeometry) -> list[str]:
    """Notes on bodies that baffles are made to be pointed away from, where none of their light is
    drawn."""
    request = scene.background.stray_light if scene.background is not None else None
    if isinstance(scene.observer, GroundObserver):
        return []
    found = []
    for name, lamp, within, drawn in (
        ("Earth's limb", seen.earth, EARTH_RAD, request is not None and request.earth),
        ("Moon's limb", seen.moon, MOON_RAD, request is not None and request.moon),
    ):
        off = lamp.off_axis - lamp.radius
        off = np.where((lamp.hidden <= 0.0) & (lamp.radius > SMALL_RAD), off, np.pi)
        if off.min() < within and not drawn:
            found.append(f"the {name} {float(off.min()) / DEG_RAD:.2f} deg from the boresight")
    ending = "stray light of what is sunlit there is not drawn (background.stray_light draws it)"
    return [f"{' and '.join(found)}: {ending}"] if found else []


def _in_field(
    scene: Scene, seen: LampGeometry, name: Literal["sun", "moon"], k: int, undrawn: str
) -> list[str]:
    """The Sun or the Moon in the field, which is refused unless the scene accepts it."""
    lamp: Lamp = getattr(seen, name)
    if not _touches(lamp, k):
        return []
    body, where = name.capitalize(), f"{_off_axis_deg(lamp, k):.2f} deg from the boresight"
    return [
        accept_or_refuse(
            scene,
            name,
            "pointing",
            f"the {body} in the field, {where} (frame {seen.frame(k)})",
            f"a field beside the {body}",
            f"the {body} is in the field, {where} in frame {seen.frame(k)}: {undrawn} drawn",
        )
    ]


def _sun_near(scene: Scene, seen: LampGeometry, k: int) -> list[str]:
    """The Sun so near that its light would show, where none of it is drawn."""
    if seen.sun.hidden[k] > 0.0 or seen.sun.off_axis[k] > sun_exclusion_rad(scene):
        return []
    least = scene.sensor.sun_exclusion_deg
    where = f"{_off_axis_deg(seen.sun, k):.2f} deg from the boresight"
    return [
        accept_or_refuse(
            scene,
            "sun",
            "pointing",
            f"the Sun {where} (frame {seen.frame(k)})",
            f"more than {least:g} degrees (sensor.sun_exclusion_deg), or its light drawn by "
            "background.stray_light",
            f"the Sun is {where} in frame {seen.frame(k)}, within {least:g} degrees "
            "(sensor.sun_exclusion_deg): its stray light is not drawn",
        )
    ]


def _moon_near(scene: Scene, seen: LampGeometry, k: int) -> list[str]:
    """The Moon so near that moonlight in the air is not known, where it is asked for."""
    if seen.moon.hidden[k] > 0.0 or seen.moon.off_frame[k] > _moonlight_rad(scene):
        return []
    least = _moonlight_rad(scene) / DEG_RAD
    where = f"{float(seen.moon.off_frame[k]) / DEG_RAD:.2f} deg from the frame"
    return [
        accept_or_refuse(
            scene,
            "moon",
            "background.moonlight",
            f"the Moon {where} (frame {seen.frame(k)})",
            f"more than {least:g} degrees, where scattered moonlight is known",
            f"the Moon is {where} in frame {seen.frame(k)}: within {least:g} degrees moonlight "
            "in the air is held at what it is there, below the real aureole",
        )
    ]


def _touches(lamp: Lamp, k: int) -> bool:
    """Whether the disc touches the frame at moment k, and is not behind the Earth."""
    return bool(lamp.hidden[k] <= 0.0 and _off_field(lamp)[k] <= 0.0)


def _off_axis_deg(lamp: Lamp, k: int) -> float:
    return float(lamp.off_axis[k]) / DEG_RAD
