"""Decisions about the air above a site: what is applied, what is omitted, and its size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pipeline.physics.constants import ARCSEC_RAD
from pipeline.physics.positions.refraction import refraction_terms
from pipeline.plan.decision import Decision
from pipeline.plan.facts import Facts
from pipeline.plan.pointing.air import frame_sines, needs_air, terms_of, weather_of
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from pipeline.physics.sky.extinction import BandExtinction

KNOWN_ARCSEC, LOW_SINE = 0.06, 0.2588  # ERFA's own account of its refraction, above 15 degrees
FINITE_M = 2.3  # of (refractivity at sea level) x (scale height): how far a bent ray is displaced


def _air(basis: PlanBasis) -> list[Decision]:
    """Refraction and extinction of a site's air; nothing for other observers."""
    scene, ends = basis.scene, basis.frames
    o = scene.observer
    if not isinstance(o, GroundObserver):
        return []
    if not ends.has_air or not needs_air(scene) or o.atmosphere is None:
        return [
            Decision(
                "atmosphere",
                False,
                "not asked for (observer.atmosphere): about 0.15 mag per airmass in V, and "
                "refraction's differences over the field, are missing; seeing is in sensor.psf",
            )
        ]
    middle = ends.middle
    camera, air = basis.resolved.camera, ends.air[:, middle]
    lowest = float(frame_sines(camera, ends.attitude[:, middle], air[:, :3]).min())
    return [
        *_refraction(scene, basis.facts, lowest),
        *_extinction(basis.resolved.extinction, lowest),
    ]


def _refraction(scene: Scene, facts: Facts, sine: float) -> list[Decision]:
    a, b = terms_of(scene)
    tangent = np.sqrt(1.0 - sine**2) / sine
    if a == 0.0:
        return [
            Decision(
                "atmosphere.refraction",
                False,
                f"not asked for: up to {60.0 * tangent:.3g} arcsec at the frame's lowest place, "
                "the same for all but its differences over the field",
            )
        ]
    bent = (a * tangent + b * tangent**3) / ARCSEC_RAD
    known = f"{KNOWN_ARCSEC:g} arcsec" if sine > LOW_SINE else "a few arcsec and more this low"
    near = FINITE_M * tangent / sine
    blue, red = (refraction_terms(*weather_of(scene), end_m)[0] for end_m in facts.ends_m)
    band = " to ".join(f"{end_m * 1e9:.0f}" for end_m in facts.ends_m)
    return [
        Decision(
            "atmosphere.refraction",
            True,
            f"ERFA refco at {facts.mean_wavelength_m * 1e9:.0f} nm: {bent:.4g} arcsec at the "
            f"frame's lowest place ({np.degrees(np.arcsin(sine)):.1f} deg up), good to {known} "
            "in the weather given; stars, targets, sky and WCS go through the same; a pointing "
            "names the true place, which the camera holds where the air lifts it to",
            bound=KNOWN_ARCSEC if sine > LOW_SINE else None,
            unit="arcsec",
        ),
        Decision(
            "atmosphere.dispersion",
            False,
            "one refraction for the whole band: from its blue to its red end a star is "
            f"drawn out: by {(blue - red) * tangent / ARCSEC_RAD:.2g} arcsec from {band} nm",
            bound=float(1.02 * (blue - red) * tangent / ARCSEC_RAD),
            unit="arcsec",
        ),
        Decision(
            "atmosphere.finite_distance",
            False,
            f"targets are lifted as stars are: {near:.2g} m of their path, "
            f"{near / 500e3 / ARCSEC_RAD:.2g} arcsec at 500 km",
            bound=float(near),
            unit="m",
        ),
    ]


def _extinction(extinction: BandExtinction | None, sine: float) -> list[Decision]:
    if extinction is None:
        return [
            Decision(
                "atmosphere.extinction",
                False,
                "not asked for: about 0.15 mag in V "
                f"times {float(1.0 / max(sine, 0.03)):.3g} air masses",
            )
        ]
    passed = float(extinction.transmission(np.array(sine)))
    mag = -2.5 * np.log10(passed)
    top = -2.5 * np.log10(float(extinction.transmission(np.array(1.0))))
    return [
        Decision(
            "atmosphere.extinction",
            True,
            f"{top:.3g} mag at the zenith, {mag:.3g} mag at the frame's lowest place (air mass of "
            "Kasten & Young 1989); of a sunlike colour, also for stars: from the bluest to the "
            f"reddest they differ by up to {extinction.colour_error_mag(sine):.2g} mag; magnitudes "
            "in the truth are above the air, electrons below it",
        )
    ]


RULES = (
    Rule(
        ("atmosphere", "atmosphere.*"),
        "each part where observer.atmosphere asks for it",
        "tests/acceptance/test_site_with_air.py::test_elevations_against_astropy",
        _air,
    ),
)
