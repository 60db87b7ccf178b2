"""Decisions: which components and approximations a scene gets, why, and what each may cost."""

from __future__ import annotations

import math

from pipeline.physics.noise.joint import ABOVE_E, ANY_READ_E, DISTANCE, REACH, READ_E
from pipeline.physics.positions.focal_plane import stretch
from pipeline.physics.psf.band import BandOptics
from pipeline.physics.psf.product import PHASES
from pipeline.plan.accuracy import by_wavelength
from pipeline.plan.decision import Decision
from pipeline.plan.facts import Facts, planned_floor_e
from pipeline.plan.pointing.geometry import camera_of
from pipeline.plan.response.responses import ResponsePlan, cut_share, table_error
from pipeline.plan.star_decisions import decide_star_effects
from pipeline.plan.tiles import BLOCK_PX
from pipeline.spec.scene import Scene

ROUNDING_PX = 1e-8  # of a distorted place, or back from it


def decide(scene: Scene, facts: Facts, responses: ResponsePlan) -> tuple[Decision, ...]:
    """Every decision of a scene, components first, then effects, then approximations."""
    return (
        *_components(scene, facts),
        *_noise_terms(scene),
        *decide_star_effects(scene, facts),
        *_optics(scene),
        *_approximations(scene, facts, responses),
    )


def _components(scene: Scene, facts: Facts) -> list[Decision]:
    stars, targets, sky = scene.stars, scene.targets, scene.background
    absent = "the scene has no such section"
    return [
        Decision("stars", True, f"catalogue {', under '.join(stars.catalogues)}")
        if stars
        else Decision("stars", False, absent, 0.0, 0.0),
        Decision("targets", True, f"{len(targets)} named in the scene")
        if targets
        else Decision("targets", False, absent, 0.0, 0.0),
        Decision("background", True, f"{facts.background_e_s:.4g} e-/s per pixel, or more")
        if sky
        else Decision("background", False, absent, 0.0, 0.0),
        _cosmic_rays(scene),
    ]


def _cosmic_rays(scene: Scene) -> Decision:
    """What cosmic rays are, and how far they go from real ones."""
    rays = scene.cosmic_rays
    if rays is None:
        return Decision("cosmic_rays", False, "the scene has no such section", 0.0, 0.0)
    flat = "the flat does not act on it" if rays.after_flat else "the flat acts on it"
    if rays.kind == "library":
        if rays.rate_scale == 0.0:
            return Decision("cosmic_rays", False, "rate_scale is 0", 0.0, 0.0)
        how = {
            "poisson": "a Poisson number of recorded events at random places",
            "frames": "whole recorded frames, cut out or tiled: no Poisson number",
        }[rays.arrival]
        return Decision(
            "cosmic_rays",
            True,
            f"{how}, {rays.rate_scale:g} times the recorded rate; charge pixel by pixel as "
            f"recorded, whatever the size of its pixels, and without its faint edges below the "
            f"threshold of the extraction; {flat}",
        )
    if rays.rate_per_cm2_s == 0.0:
        return Decision("cosmic_rays", False, "rate_per_cm2_s is 0", 0.0, 0.0)
    return Decision(
        "cosmic_rays",
        True,
        f"straight tracks of fast nuclei ({rays.source}) through {rays.thickness_um:g} um of "
        "silicon, Poisson arrival, Landau straggling; no slow or stopping particles, no curved "
        f"electron tracks, no showers; {flat}",
    )


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
    given = "given in the scene"
    why = {
        "flat": f"{given}; it acts on light, not on the dark",
        "full_well": f"{given}; clips the charge after photon noise and before read noise; no "
        "blooming",
    }
    out = []
    for name, kept, why_not in terms:
        bound = None if kept or name == "photon_noise" else 0.0
        out.append(Decision(name, kept, why.get(name, given) if kept else why_not, bound, bound))
    out.append(
        Decision(
            "adc",
            True,
            f"{s.adc_bits} bits, rounding {s.adc_rounding}, clipped at both ends"
            + (" (floor lowers the mean by 0.5 DN)" if s.adc_rounding == "floor" else ""),
            bound=1.0 if s.adc_rounding == "floor" else 0.5,
            unit="DN",
        )
    )
    if s.photon_noise:
        out.append(
            Decision(
                "gaussian_for_poisson",
                True,
                "means above 1e8 e- are drawn as a rounded Gaussian; its distribution function "
                "differs by less than 7e-6",
                bound=7e-6,
                unit="of the distribution function",
            )
        )
    if _one_draw(scene):
        out.append(
            Decision(
                "one_noise_draw",
                True,
                f"pixels of {ANY_READ_E:g} e- of read noise or more ({READ_E:g} at means above "
                f"{ABOVE_E:g} e-), the full well {REACH:g} deviations away, take photon and read "
                "noise in one draw, by its quantile to third order; the mean is exact",
                bound=DISTANCE,
                unit="of the distribution function",
            )
        )
    return out


def _one_draw(scene: Scene) -> bool:
    """Whether some pixels may take photon and read noise in one draw."""
    s, d = scene.sensor, scene.sensor.detector
    enough = not isinstance(s.read_noise_e, float) or s.read_noise_e >= READ_E
    bent = d is not None and (d.blooming or d.nonlinearity is not None)
    return s.photon_noise and enough and not bent


def _optics(scene: Scene) -> list[Decision]:
    """What the optics do to places."""
    if scene.sensor.distortion is None:
        return []
    camera = camera_of(scene)
    return [
        Decision(
            "distortion",
            True,
            f"{scene.sensor.distortion.kind} terms, exact to rounding; lengths change by at most "
            f"{100.0 * (stretch(camera) - 1.0):.3g}%",
            bound=ROUNDING_PX,
            unit="px",
        )
    ]


def _approximations(scene: Scene, facts: Facts, r: ResponsePlan) -> list[Decision]:
    out = [_over_the_field(r)]
    if facts.band is not None:
        out.append(_wavelengths(scene, facts, facts.band))
    if not (scene.stars or scene.targets):
        return out
    table = max(map(table_error, r.blurs))
    if table:
        reason = (
            "spectra of tables are cut where little is left; the product says what that is beside "
            "its brightest source where it is more than its part"
        )
        out.append(Decision("table_band", True, reason, bound=table, unit="of a source's light"))
    if scene.stars is not None:
        out.append(_phases(r, r.budget_e, facts.sigma_floor_e))
    if r.spacing_px:
        out += _wings(r, facts, bool(scene.targets or scene.populations))
    elif scene.stars is None:
        out.append(core_ends(r, facts))
    if scene.stars is not None:
        out += _streaks(r, facts)
    return out


def _phases(r: ResponsePlan, budget_e: float, sigma_e: float) -> Decision:
    """Tables of responses between whose phases stars lie."""
    how = (
        f"column times row, interpolated cubically between {PHASES} phases a pixel"
        if r.products
        else f"interpolated between {r.classes[0].phases} phases a pixel, linearly where that errs "
        f"by at most {budget_e:.3g} e-, else cubically"
    )
    return Decision(
        "phase_interpolation",
        True,
        f"stars are {how}; the bound holds for a pixel at the noise floor and grows with the "
        "noise of a pixel that holds more light",
        error_bound_e=budget_e,
        error_bound_sigma=budget_e / sigma_e,
    )


def _over_the_field(r: ResponsePlan) -> Decision:
    """One response for the focal plane, or several, which bilinear mixtures lie between."""
    if r.field is None:
        return Decision("one_psf", True, "one point-spread function for the whole focal plane")
    known = [e for e in r.field.error if e is not None]
    bound = sum(known) if len(known) == len(r.field.error) else None
    unit = "of a source's light, from a response that varies smoothly between the places"
    return Decision("psf_over_the_field", True, r.field.reason(r.table_mb), bound=bound, unit=unit)


def _wavelengths(scene: Scene, facts: Facts, band: BandOptics) -> Decision:
    """A few wavelengths, or one, for the whole band."""
    nm = ", ".join(f"{w * 1e9:.0f}" for w in band.wavelengths_m)
    name = "monochromatic_psf" if len(band.wavelengths_m) == 1 else "few_wavelengths"
    if not by_wavelength(scene):
        return Decision(name, True, f"drawn at {nm} nm: as asked")
    reason = (
        f"drawn at {nm} nm: a pixel differs by up to {band.error:.2g} of its source's light from "
        f"the whole band ({band.error_of_one:.2g} with the mean wavelength alone); the same for "
        f"sources of all colours. The bound is beside a source of {facts.brightest_e:.3g} e-"
    )
    sigma = band.error_sigma * planned_floor_e(scene, facts.sigma_floor_e) / facts.sigma_floor_e
    return Decision(name, True, reason, band.error * facts.brightest_e, sigma)


def _streaks(r: ResponsePlan, facts: Facts) -> list[Decision]:
    """How the stars' streaks and crowds are drawn."""
    s, sigma_e = r.streaks, facts.sigma_floor_e
    if s.at_rest < math.inf:
        reason = (
            f"stars move by at most {s.longest_px:.2g} px in an exposure and are drawn as points, "
            "each at the centroid of its light"
        )
    else:
        reason = (
            f"{s.zones} x {s.zones} zone(s) and {s.pieces} piece(s) of the exposure, each with one "
            "shape for all its stars, set where each star's own light is. Ends are off by at most "
            f"{s.off_px:.2g} px, {s.spread_px:.2g} px of it the field's: about that share of the "
            "light of a pixel there"
        )
    bound = s.error_e(facts.brightest_e or math.inf)
    if s.mixed_from_e_px < math.inf:
        reason += (
            f". Stars of more than {s.mixed_from_e_px:.3g} e- a px of their path, of which that "
            "would be more than the bound, get a mixture of three shapes, off by at most "
            f"{s.mixed_px:.2g} px, and the brightest are drawn along their own path, one by one. "
            "The bound grows with a pixel's noise"
        )
    out = [Decision("common_streak", True, reason, bound, bound / sigma_e)]
    if r.spectral_from:
        out.append(
            Decision(
                "crowds_by_transforms",
                True,
                f"where {r.spectral_from} stars or more light a block of {BLOCK_PX} px, those of "
                "the first class are drawn together by a non-uniform FFT; a pixel errs by at most "
                "the bound for each star near it, and brighter stars are stamps",
                r.budget_e,
                r.budget_e / sigma_e,
            )
        )
    return out


def core_ends(r: ResponsePlan, facts: Facts) -> Decision:
    """Where sources end whose response has no wings; with tables it is part of their bound."""
    usual, whole = r.classes
    brightest = facts.brightest_e or usual.target_e
    largest = whole.wing_error * min(brightest, whole.target_e)  # brighter ones by quadrature
    bound = max(min(r.lost_light * brightest, r.budget_e), largest)
    reason = (
        f"light beyond {usual.radius_px:.3g} px of a source is omitted, {r.lost_light:.2g} of it; "
        f"beyond {whole.radius_px:.3g} px for sources above {usual.target_e:.3g} e-; the bound is "
        f"beside a source of {brightest:.3g} e-"
    )
    return Decision("core_ends", True, reason, bound, bound / facts.sigma_floor_e)


def _wings(r: ResponsePlan, facts: Facts, targets_there: bool) -> list[Decision]:
    budget, last, sigma_e = r.budget_e, r.classes[-1], facts.sigma_floor_e
    limits = [c.brightest_e for c in r.classes[:-1]]
    limits = limits or [budget / last.wing_error]
    brightest = facts.brightest_e or max(limits)
    share, first, targets = cut_share(r.blurs, r.reach_px), r.classes[0], ""
    cut = share * brightest
    if first.target_e != first.brightest_e and targets_there:
        targets = (
            f". For targets, which may stand still among streaked stars, these are "
            f"{first.target_e:.3g} e-, {budget / last.target_error:.3g} e- and "
            f"{last.target_error:.2g}"
        )
    return [
        Decision(
            "wings_on_a_coarse_grid",
            True,
            f"light beyond {r.classes[0].radius_px:.0f} px of a source is drawn on a grid of "
            f"{r.spacing_px} px, swept by one streak for each block of {BLOCK_PX} px, which the "
            f"limits of cores take into account; sources "
            f"above {min(limits):.3g} e- get larger cores. The bound holds up to "
            f"{budget / last.wing_error:.3g} e-; above, sources are integrated over each pixel "
            "where their profile is known and their path is short; else a pixel errs by up to "
            f"{last.wing_error:.2g} of its source's light, and the product says so{targets}",
            budget,
            budget / sigma_e,
        ),
        Decision(
            "wings_cut_off",
            True,
            f"light beyond {r.reach_px:.0f} px of a source is omitted: {r.lost_light:.2g} of its "
            f"light, and at most {share:.2g} of it in a pixel (the spikes of vanes apart); the "
            f"bound is beside a source of {brightest:.3g} e-",
            cut,
            cut / sigma_e,
        ),
    ]
