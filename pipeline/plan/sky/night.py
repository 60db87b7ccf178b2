"""A site's night sky in the plan: light of the air, and what the air takes from other light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.positions.refraction import refract
from pipeline.physics.sky.moon import irradiance_share
from pipeline.physics.sky.night import airglow, moonlight, twilight
from pipeline.physics.targets.lighting import phase_angle
from pipeline.physics.targets.shadow import moon_m, sunlit_past_earth
from pipeline.physics.vectors import separation, unit
from pipeline.plan.decision import Decision
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.sky.atmosphere import Extinction
from pipeline.spec.sky.background import Airglow, Background

if TYPE_CHECKING:
    from pipeline.physics.sky.extinction import BandExtinction
    from pipeline.plan.sky.inputs import SkyInputs

Array = NDArray[np.float64]

MOST_GATHERED = 1.5  # as a night differs from another


def dimmed(
    scene: Scene,
    extinction: BandExtinction | None,
    air: Array,
    observed: Array,
    parts: dict[str, Array],
) -> dict[str, Array]:
    """Light from beyond the air, less the part of the extinction that diffuse light suffers.

    Undrawn stars are dimmed as drawn ones are, so that a limiting magnitude changes no sum.

    air : (5,) of the Geometry; observed : (n, 3)
    """
    o = scene.observer
    if extinction is None or not isinstance(o, GroundObserver) or o.atmosphere is None:
        return parts
    request = o.atmosphere.extinction
    assert isinstance(request, Extinction)
    sine = observed @ air[:3]
    diffuse = extinction.transmission(sine, request.diffuse_share)
    stars = extinction.transmission(sine)
    return {n: light * (stars if n == "starlight" else diffuse) for n, light in parts.items()}


def night_parts(
    scene: Scene, inputs: SkyInputs, g: Geometry, f: int, node: int, observed: Array
) -> dict[str, Array]:
    """Electrons/s per m2 of pupil and sr (n,) of the light of the air; observed : (n, 3).

    Twilight of a Sun above the horizon (`plan.sky_doubts`) is that of one at the horizon.
    """
    b, band, out = scene.background or Background(starlight="none"), inputs.night, {}
    if band is None or not b.of_the_air:
        return {}
    air = g.air[f, node]
    if b.airglow:
        out["airglow"] = airglow(band, inputs.extinction, observed @ air[:3])
    if not (b.moonlight or b.twilight):
        return out
    tt = g.tt1[f, node], g.tt2[f, node]
    earth = earth_and_sun(*tt)
    place, sun = g.observer_m[f, node] - earth.position_m[0], earth.sun_from_earth_m[0]
    return out | scattered_parts(b, inputs, air, observed, place, sun, moon_m(*tt)[0])


def scattered_parts(
    b: Background,
    inputs: SkyInputs,
    air: Array,
    observed: Array,
    place: Array,
    sun: Array,
    moon: Array,
) -> dict[str, Array]:
    """Of these the moonlight and the twilight, where they are asked for.

    air : (5,) of the Geometry; place, sun, moon : (3,) of the site and of both bodies, from the
        Earth's centre
    """
    band, extinction, out = inputs.night, inputs.extinction, {}
    assert band is not None
    assert extinction is not None
    sine = observed @ air[:3]
    if b.moonlight:
        seen = refract(unit(moon - place), air)
        out["moonlight"] = moonlight(
            band,
            extinction,
            sine,
            float(seen @ air[:3]),
            separation(observed, seen[None]),
            _moon_share(place, sun, moon),
        )
    if b.twilight:
        up = unit(sun - place)
        apart = separation(observed, up[None])
        sun_sine = min(float(up @ air[:3]), 0.0)
        out["twilight"] = twilight(band, extinction, sine, sun_sine, apart)
    return out


def _moon_share(place: Array, sun: Array, moon: Array) -> float:
    """The Moon's irradiance above the air over the Sun's at 1 au, eclipses included."""
    to_moon, to_sun = moon - place, sun - moon
    far, from_sun = np.sqrt(to_moon @ to_moon), np.sqrt(to_sun @ to_sun)
    share = float(irradiance_share(phase_angle(moon, sun, place), from_sun, far))
    return share * float(sunlit_past_earth(moon[None], sun)[0])


def _flux_sfu(scene: Scene) -> float:
    """The Sun's radio flux that the airglow is for."""
    asked = None if scene.background is None else scene.background.airglow
    return (asked if isinstance(asked, Airglow) else Airglow()).solar_flux_sfu


def night_told(scene: Scene, ends: list[dict[str, Array]], gathered: float) -> list[Decision]:
    """What the air sends, and how well it is known; ends : e-/s and pixel of two frames;
    gathered : of the NightBand."""
    narrow = (
        "; lines are spread over boxes of 8 to 100 nm: with one in so narrow a band it is up to "
        f"{gathered:.2g} times as bright, without it fainter"
    )
    known = {
        "airglow": "zenith of the Paranal sky model (Noll et al. 2012) in the band, a layer at 90 "
        f"km (van Rhijn), for a Sun of {_flux_sfu(scene):g} sfu at 10.7 cm; a night differs by 50%"
        + (narrow if gathered > MOST_GATHERED else ""),
        "moonlight": "Krisciunas & Schaefer 1991 with the band's own extinction (23% in V); one "
        "scattering law for all wavelengths",
        "twilight": "Schaefer 1993 (a magnitude); fainter than the night sky beyond 18 degrees",
    }
    out = []
    for name, how in known.items():
        wanted = scene.background is not None and getattr(scene.background, name)
        if wanted:
            values = np.concatenate([e[name] for e in ends])
            span = f"{values.min():.4g} to {values.max():.4g} e-/s per pixel"
            out.append(Decision(f"background.{name}", True, f"{span}: {how}"))
        else:
            out.append(Decision(f"background.{name}", False, "not asked for"))
    return out
