"""Decisions: which components and approximations a scene gets, why, and what each may cost."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pipeline.physics.psf.pupil import Airy
from pipeline.plan.facts import Facts
from pipeline.plan.responses import BLOCK_PX, MERGE_TOLERANCE_PX, PATH_STEP_PX, ResponsePlan
from pipeline.spec.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.sensor import AiryPsf


@dataclass(frozen=True)
class Decision:
    """One component or approximation, kept or left out.

    error_bound_e : upper bound of what it may change in a pixel [e-]; None where it is no
        approximation or no bound is known (the reason then says so)
    error_bound_sigma : the same over the noise of a pixel that holds no source
    seconds_saved : estimated, per frame; None where nothing is saved
    """

    component: str
    kept: bool
    reason: str
    error_bound_e: float | None = None
    error_bound_sigma: float | None = None
    seconds_saved: float | None = None


def decide(scene: Scene, facts: Facts, responses: ResponsePlan) -> tuple[Decision, ...]:
    """Every decision of a scene, components first, then effects, then approximations."""
    return (
        *_components(scene, facts),
        *_noise_terms(scene),
        *_star_effects(scene),
        *_approximations(scene, facts, responses),
    )


def _components(scene: Scene, facts: Facts) -> list[Decision]:
    stars, targets, sky = scene.stars, scene.targets, scene.background
    absent = "the scene has no such section"
    return [
        Decision("stars", True, f"catalogue {stars.catalogue}")
        if stars
        else Decision("stars", False, absent, 0.0, 0.0),
        Decision("targets", True, f"{len(targets)} named in the scene")
        if targets
        else Decision("targets", False, absent, 0.0, 0.0),
        Decision("background", True, f"uniform, {facts.background_e_s:.4g} e-/s per pixel")
        if sky
        else Decision("background", False, absent, 0.0, 0.0),
        Decision("cosmic_rays", False, absent, 0.0, 0.0),
    ]


def _noise_terms(scene: Scene) -> list[Decision]:
    s = scene.sensor
    terms = [
        ("flat", s.flat != 1.0, "unity everywhere"),
        ("dark", s.dark_e_per_s != 0.0, "0 e-/s"),
        ("photon_noise", s.photon_noise, "switched off in the scene"),
        ("full_well", s.full_well_e is not None, "no full well given"),
        ("read_noise", s.read_noise_e != 0.0, "0 e-"),
        ("bias", s.bias_dn != 0.0, "0 DN"),
    ]
    out = []
    for name, kept, why_not in terms:
        bound = None if kept or name == "photon_noise" else 0.0
        out.append(Decision(name, kept, "given in the scene" if kept else why_not, bound, bound))
    if s.photon_noise:
        out.append(
            Decision(
                "gaussian_for_poisson", True,
                "means above 1e8 e- are drawn as a rounded Gaussian; its distribution function "
                "differs by less than 7e-6",
            )
        )  # fmt: skip
    return out


def _star_effects(scene: Scene) -> list[Decision]:
    out = []
    if scene.stars is not None:
        bounds = {
            "space_motion": "up to 10.4 arcsec a year (Barnard's star)",
            "parallax": "up to 0.77 arcsec (Proxima) for an observer near 1 au",
            "aberration": "common 20.5 arcsec stay with the boresight; differences in the field go",
            "deflection": "4 mas at 90 deg from the Sun, 1.75 arcsec at its limb",
        }
        for name, size in bounds.items():
            kept = getattr(scene.stars, name)
            reason = "applied to each star" if kept else f"switched off in the scene: {size}"
            out.append(Decision(f"stars.{name}", kept, reason))
    if isinstance(scene.observer, GroundObserver):
        out += [
            Decision(
                "precession_nutation", True,
                "IAU 2006/2000A turns the site into the stars' frame; the stars of an image whose "
                "boresight is given in ICRS do not move by it",
            ),
            Decision(
                "atmosphere", False,
                "extinction, refraction and seeing are not in this version: about 0.15 mag per "
                "airmass in V, and refraction's differences over the field, are missing",
            ),
        ]  # fmt: skip
    return out


def _approximations(scene: Scene, facts: Facts, r: ResponsePlan) -> list[Decision]:
    sigma, budget = facts.sigma_floor_e, r.budget_e

    def bound(e: float) -> dict[str, float]:
        return {"error_bound_e": e, "error_bound_sigma": e / sigma}

    out = [
        Decision(
            "one_psf", True, "one point-spread function for the whole focal plane, as in the paper"
        )
    ]
    if isinstance(scene.sensor.psf, AiryPsf):
        out.append(
            Decision(
                "monochromatic_psf", True,
                f"drawn at one wavelength, {facts.mean_wavelength_m * 1e9:.0f} nm unless given; no "
                "bound is known before issue C's polychromatic response",
            )
        )  # fmt: skip
    if not (scene.stars or scene.targets):
        return out
    out.append(
        Decision(
            "phase_interpolation", True,
            f"stars are interpolated between {r.classes[0].phases} phases a pixel, linearly where "
            f"that errs by at most {budget:.3g} e-, else cubically; the bound holds for a pixel at "
            "the noise floor and grows with the noise of a pixel that holds more light",
            **bound(budget),
        )
    )  # fmt: skip
    if isinstance(r.blur.optics, Airy):
        lowest = min(c.brightest_e for c in r.classes)
        out += [
            Decision(
                "wings_on_a_coarse_grid", True,
                f"light beyond {r.classes[0].radius_px:.0f} px of a source is drawn on a grid of "
                f"{r.spacing_px} px, swept by one streak for each block of {BLOCK_PX} px; sources "
                f"above {lowest:.3g} e- get larger cores",
                **bound(budget),
            ),
            Decision(
                "wings_cut_off", True,
                f"light beyond {r.reach_px:.0f} px of a source is left out: {r.lost_light:.2g} of "
                "its light; the bound is that of a source of the first core class",
                **bound(_cut_bound(r)),
            ),
        ]  # fmt: skip
    if scene.stars is not None:
        out.append(
            Decision(
                "common_streak", True,
                f"{r.zones} x {r.zones} zone(s), each with one streak for all its stars, which "
                f"differs from a star's own by at most {r.spread_px:.2g} px at its ends, and by "
                f"{PATH_STEP_PX / 2 + MERGE_TOLERANCE_PX:.2g} px from rounding: at most about that "
                "share of a star's peak there; centroids do not move by the rounding",
            )
        )  # fmt: skip
    return out


def _cut_bound(r: ResponsePlan) -> float:
    """Light per pixel left out beyond the reach, of the brightest source of the first class [e-].

    A power-law wing of index -3 that holds `lost_light` beyond R has the surface brightness
    lost_light / (2 pi R^2) at R.
    """
    brightest = r.classes[0].brightest_e if math.isfinite(r.classes[0].brightest_e) else 0.0
    return brightest * r.lost_light / (2.0 * math.pi * r.reach_px**2)
