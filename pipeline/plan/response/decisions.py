"""Responses in the plan: wavelengths, tables, streaks, wings, and the engines that draw stars."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.physics.psf.band import COLOURS_K, BandOptics
from pipeline.physics.psf.product import PHASES
from pipeline.plan.accuracy import by_wavelength
from pipeline.plan.decision import Decision
from pipeline.plan.facts import planned_floor_e
from pipeline.plan.pointing.geometry import bend_px
from pipeline.plan.response.responses import (
    CoreClass,
    ResponsePlan,
    core_end_e,
    cut_share,
    end_share_of,
    table_error,
)
from pipeline.plan.response.streaks import StreakPlan
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.plan.tiles import BLOCK_PX

MOST_TOLD = 20  # wavelengths that are named one by one


def _responses(basis: PlanBasis) -> Iterator[Decision]:
    """One response or several, and what becomes of the spectra of tables."""
    scene, r = basis.scene, basis.resolved.responses
    yield _over_the_field(r)
    table = max(map(table_error, r.blurs))
    if table and (scene.stars or scene.targets):
        reason = (
            "spectra of tables are cut where little is left; the product says what that is beside "
            "its brightest source where it is more than its part"
        )
        yield Decision("table_band", True, reason, bound=table, unit="of a source's light")


def _over_the_field(r: ResponsePlan) -> Decision:
    """One response for the focal plane, or several, which bilinear mixtures lie between."""
    if r.field is None:
        return Decision("one_psf", True, "one point-spread function for the whole focal plane")
    known = [e for e in r.field.error if e is not None]
    bound = sum(known) if len(known) == len(r.field.error) else None
    unit = "of a source's light, from a response that varies smoothly between the places"
    return Decision("psf_over_the_field", True, r.field.reason(r.table_mb), bound=bound, unit=unit)


def _band(basis: PlanBasis) -> Iterator[Decision]:
    """The wavelengths that stand for the band."""
    if basis.facts.band is not None:
        yield _wavelengths(basis, basis.facts.band)


def _wavelengths(basis: PlanBasis, band: BandOptics) -> Decision:
    """A few wavelengths, or one, for the whole band.

    The error beside the brightest source expected is known over its noise; beside one k times as
    bright it is at most sqrt(k) of that if k < 1 and light has noise of its own, else k.
    """
    scene, facts, brightest_e = basis.scene, basis.facts, basis.brightest_e
    nm = _in_nm([w * 1e9 for w in band.wavelengths_m])
    name = "monochromatic_psf" if len(band.wavelengths_m) == 1 else "few_wavelengths"
    if not by_wavelength(scene):
        return Decision(name, True, f"drawn at {nm} nm: as asked")
    reason = (
        f"drawn at {nm} nm: a pixel differs by up to {band.error:.2g} of its source's light from "
        f"the whole band ({band.error_of_one:.2g} with the mean wavelength alone), whose photons "
        f"are spread evenly for sources of all colours: a pixel of a star is off by up to "
        f"{_of_colours(band)}, which no bound counts. The bound is beside a source of "
        f"{brightest_e:.3g} e-"
    )
    floor_e = facts.light_floor_e
    sigma = band.error * brightest_e / floor_e
    if facts.brightest_e:
        ratio = brightest_e / facts.brightest_e
        hidden = scene.sensor.photon_noise and ratio < 1.0
        expected = band.error_sigma * planned_floor_e(scene, floor_e) / floor_e
        sigma = min(sigma, expected * (math.sqrt(ratio) if hidden else ratio))
    return Decision(name, True, reason, band.error * brightest_e, sigma)


def _in_nm(wavelengths_nm: Sequence[float]) -> str:
    """Wavelengths in whole nanometres, in a row; of many their number and their ends."""
    if len(wavelengths_nm) <= MOST_TOLD:
        return ", ".join(dict.fromkeys(f"{w:.0f}" for w in wavelengths_nm))
    ends = min(wavelengths_nm), max(wavelengths_nm)
    return f"{len(wavelengths_nm)} wavelengths from {ends[0]:.0f} to {ends[1]:.0f}"


def _of_colours(band: BandOptics) -> str:
    """By how much the pixels of cool and hot stars are off, of their light."""
    each = zip(COLOURS_K, band.error_of_colours, strict=True)
    return " and ".join(f"{off:.2g} ({kelvin:.0f} K)" for kelvin, off in each)


def _stars(basis: PlanBasis) -> Iterator[Decision]:
    """How stars are drawn."""
    if basis.scene.stars is None:
        return
    yield _phases(basis)
    yield from _streaks(basis)
    if basis.engines is not None:
        ways = "; ".join(basis.engines.ways) or "stamps from tables"
        reason = "the cheapest for the stars of the fullest frame; the bounds are the same"
        yield Decision("star_engines", True, f"{ways}: {reason}")


def _phases(basis: PlanBasis) -> Decision:
    """Tables of responses between whose phases stars lie."""
    if basis.engines is not None and not basis.engines.tables:
        why = "each star at its exact place: no tables are made"
        return Decision("phase_interpolation", False, why)
    r, budget_e = basis.resolved.responses, basis.resolved.responses.budget_e
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
        *basis.within_budget("phase_interpolation"),
    )


def _streaks(basis: PlanBasis) -> list[Decision]:
    """How the stars' streaks and crowds are drawn."""
    r, facts = basis.resolved.responses, basis.facts
    s, sigma_e, ends = r.streaks, facts.light_floor_e, basis.frames
    if s.at_rest < math.inf:
        reason = (
            f"stars move by at most {s.longest_px:.2g} px in an exposure and are drawn as points, "
            "each at the centroid of its light"
        )
    else:
        reason = (
            f"{s.zones} x {s.zones} zone(s) and {s.pieces} segment(s) of the exposure, each with "
            "one shape for all its stars, set where each star's own light is. Ends are off by at "
            f"most {s.off_px:.2g} px, {s.spread_px:.2g} px of it the field's{_of_responses(s)}: "
            "about that fraction of the light of a pixel there. Paths are straight between "
            f"{ends.nodes} nodes, off by at most "
            f"{bend_px(basis.scene, ends, basis.resolved.dut1_s):.2g} px in the frames looked at"
        )
    bound = min(s.error_e(basis.brightest_e or math.inf), basis.within_budget("common_streak")[0])
    if s.own_from_e_px < math.inf:
        reason += (
            f". Stars of more than {s.own_from_e_px:.3g} e- a px of their path, of which that "
            "would be more than the bound, are drawn along their own path, one by one"
        )
        if s.finer is not None:
            reason += (
                f"; where they are many, those of up to {s.finer.own_from_e_px:.3g} e- a px in "
                f"{s.finer.pieces} segments"
            )
        reason += ". The bound grows with a pixel's noise"
    out = [Decision("common_streak", True, reason, bound, bound / sigma_e)]
    chosen = basis.engines.responses if basis.engines else r
    own = [core for core in chosen.classes if core.together_from]
    if r.spectral_from or own:
        errs = r.budget_e, r.budget_e / sigma_e
        out.append(Decision("crowds_by_transforms", True, _crowds_said(r, own), *errs))
    return out


def _of_responses(s: StreakPlan) -> str:
    """What responses that change over the field have of how far off ends are."""
    return f", {s.field_px:.2g} px its responses' changes" if s.field_px else ""


def _crowds_said(r: ResponsePlan, own: list[CoreClass]) -> str:
    """Which stars are drawn together; own : the classes of those that are along their own paths."""
    alike = (
        f"where {r.spectral_from} stars or more light a block of {BLOCK_PX} px, those of the first "
        "class are drawn together by a non-uniform FFT"
    )
    apart = "; ".join(
        f"where {core.together_from} stars or more with cores of {core.radius_px:.0f} px light a "
        f"block of {BLOCK_PX} px, they are points along their own paths, drawn together by a "
        "non-uniform FFT"
        for core in own
    )
    said = [alike] * (r.spectral_from > 0) + [apart] * bool(own)
    errs = "a pixel errs by at most the bound for each star near it, and brighter stars are stamps"
    return "; ".join([*said, errs])


def _far_light(basis: PlanBasis) -> Iterator[Decision]:
    """Light far from its source; where there are wings, or tables, cores are part of these."""
    scene, r, engines = basis.scene, basis.resolved.responses, basis.engines
    if not (scene.stars or scene.targets):
        return
    if r.spacing_px:
        yield from _wings(basis, bool(scene.targets or scene.populations))
    elif scene.stars is None or (engines is not None and not engines.tables):
        yield core_ends(r, basis.brightest_e, basis.facts.light_floor_e)


def core_ends(r: ResponsePlan, brightest_e: float, floor_e: float) -> Decision:
    """Where sources end whose response has no wings; with tables it is part of their bound.

    brightest_e : light of the brightest source, 0 where not known; floor_e : noise of a pixel
    """
    usual, whole = r.classes
    brightest, share = brightest_e or usual.target_e, end_share_of(r)
    bound = float(core_end_e(r, np.array([brightest]))[0])
    bound += max(map(table_error, r.blurs)) * brightest
    reason = (
        f"light beyond {usual.radius_px:.3g} px of a source is omitted, {r.lost_light:.2g} of it, "
        f"at most {share:.2g} in a pixel; beyond {whole.radius_px:.3g} px for sources above "
        f"{usual.target_e:.3g} e-; the bound is beside a source of {brightest:.3g} e-"
    )
    return Decision("core_ends", True, reason, bound, bound / floor_e)


def _wings(basis: PlanBasis, targets_there: bool) -> list[Decision]:
    r, sigma_e = basis.resolved.responses, basis.facts.light_floor_e
    budget, last = r.budget_e, r.classes[-1]
    limits = [c.brightest_e for c in r.classes[:-1]]
    limits = limits or [budget / last.wing_error]
    brightest = basis.brightest_e or max(limits)
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
            *basis.within_budget("wings_on_a_coarse_grid"),
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


RULES = (
    Rule(
        ("one_psf", "psf_over_the_field", "table_band"),
        "one response, or mixtures of those the scene gives for places of the field; a table's "
        "spectrum is cut where at most 1e-5 of its light is left",
        "tests/execute/test_psf_field.py::"
        "test_a_star_at_a_place_is_its_own_and_between_two_their_mean",
        _responses,
    ),
    Rule(
        ("monochromatic_psf", "few_wavelengths"),
        "as few wavelengths as keep a pixel within a fraction of its source's light",
        "tests/physics/psf/test_band.py::test_against_a_hundred_wavelengths",
        _band,
    ),
    Rule(
        ("phase_interpolation", "common_streak", "crowds_by_transforms", "star_engines"),
        "the cheapest drawing whose bound is within its part of accuracy.noise_fraction",
        "tests/execute/test_engines.py::test_engines_agree_within_the_sum_of_their_bounds",
        _stars,
    ),
    Rule(
        ("wings_on_a_coarse_grid", "wings_cut_off", "core_ends"),
        "light far from a source on a coarse grid, up to a radius beyond which less than "
        "accuracy.flux_fraction is left, 1e-8 where a response has no wings",
        "tests/physics/drawing/test_wings.py::test_stated_wing_error_holds",
        _far_light,
    ),
)
