"""The scene's catalogues: opened, their common stars told, and what the plan says of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from catalog_tools.catalogue import Catalogue, open_catalogue
from catalog_tools.documents import JsonObject
from catalog_tools.star_counts import all_sky_count
from pipeline.errors import BadInput
from pipeline.inputs.band.colour_fit import default_colour_error_mag
from pipeline.physics.colour import colour_correction_mag
from pipeline.plan.decision import Decision
from pipeline.plan.facts import Facts
from pipeline.plan.timing import integration_range_s
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from catalog_tools.geometry.regions import Cone
    from pipeline.physics.colour import ColourFit

FIELD = "stars.catalogue"
BRIGHT_END_G_MAG = 2.0
MANY = 0.5  # of a catalogue's stars without a colour are a warning
COUNTS_END_G_MAG = 21.0
GAP_G_MAG = 0.5  # stars missing over a smaller range are not worth a remark


def open_catalogues(paths: Sequence[str]) -> tuple[Catalogue, ...]:
    """The main catalogue and the layers over it. Raises BadInput naming the place in the list."""
    opened: list[Catalogue] = []
    for i, path in enumerate(paths):
        field = FIELD if len(paths) == 1 else f"{FIELD}[{i}]"
        found = open_catalogue(path, field=field)
        for k, other in enumerate(opened):
            if found.digest == other.digest:
                raise BadInput(field, path, f"another catalogue than that of {FIELD}[{k}]")
        opened.append(found)
    return tuple(opened)


def gather_left_out(
    catalogues: Sequence[Catalogue], cones: Sequence[Cone], faintest_g_mag: float | None
) -> tuple[np.ndarray, ...]:
    """Of each catalogue, the sorted source_ids of stars that an earlier one holds (none of 0)."""
    nothing = np.empty(0, np.int64)
    if len(catalogues) < 2:
        return (nothing,) * len(catalogues)
    from catalog_tools.query.layers import already_in

    return nothing, *(
        np.unique(
            np.concatenate([already_in(m, layer, cones, faintest_g_mag) for m in catalogues[:i]])
        )
        for i, layer in enumerate(catalogues[1:], start=1)
    )


def layer_decisions(
    catalogues: Sequence[Catalogue], left_out: Sequence[np.ndarray]
) -> tuple[Decision, ...]:
    """For each layer: how many of its stars are omitted, and by which rule."""
    return tuple(
        Decision(
            f"stars.layer_{i}",
            True,
            f"{layer.name}, epoch J{layer.ref_epoch_jyear:g}: {left_out[i].size} of its stars in "
            f"the field are omitted, {_rule(catalogues[:i], layer)}",
        )
        for i, layer in enumerate(catalogues[1:], start=1)
    )


def _rule(earlier: Sequence[Catalogue], layer: Catalogue) -> str:
    from catalog_tools.query.layers import TOLERANCE_G_MAG, tolerance_arcsec

    apart = max(tolerance_arcsec(main, layer) for main in earlier)
    return (
        f"within {apart:.2f} arcsec of a star of an earlier catalogue, both carried by their "
        f"motions to the epoch midway, and within {TOLERANCE_G_MAG:g} mag of its G"
    )


def catalogue_facts(
    catalogues: Sequence[Catalogue], left_out: Sequence[np.ndarray]
) -> list[JsonObject]:
    """The catalogues as the plan and the report name them, the main one first."""
    return [
        {
            "name": c.name,
            "digest": c.digest,
            "synthetic": c.synthetic,
            "ref_epoch_jyear": c.ref_epoch_jyear,
            "left_out": int(ids.size),
            "rows": c.rows,
            "without_colour": c.without_colour,
        }
        for c, ids in zip(catalogues, left_out, strict=True)
    ]


def colour_sentences(
    catalogues: Sequence[Catalogue], fit: ColourFit
) -> tuple[list[str], list[str]]:
    """Warnings and remarks: how many stars have no colour, and what that may cost in the band."""
    rms, most = default_colour_error_mag(fit)
    cost = (
        f"drawn with BP-RP = {fit.default_colour:g}, which errs by {rms:.2f} mag rms of typical "
        f"stars in {fit.band_name}, at most {most:.2f}"
    )
    warnings: list[str] = []
    remarks: list[str] = []
    for c in catalogues:
        many = c.without_colour is not None and c.without_colour > MANY * c.rows
        if c.without_colour is None:
            remarks.append(f"it is unknown how many of {c.name} have no colour; they are {cost}")
        elif c.without_colour:
            part = f"{c.without_colour} of {c.rows} ({100.0 * c.without_colour / c.rows:.3g}%)"
            (warnings if many else remarks).append(
                f"{part} stars of {c.name} have no colour: {cost}"
            )
    return warnings, remarks


def catalogue_remarks(
    catalogues: Sequence[Catalogue], faintest_g_mag: float | None
) -> tuple[str, ...]:
    """What is not real, and which magnitudes none of the catalogues reaches."""
    made_up = [c.name for c in catalogues if c.synthetic]
    out = []
    if made_up and len(made_up) == len(catalogues):
        out.append("SYNTHETIC CATALOGUE: no star of this product is a real star")
    elif made_up:
        out.append(f"SYNTHETIC CATALOGUE {', '.join(made_up)}: no star of it is a real star")
    spans = sorted(
        (c.brightest_g_mag, c.faintest_g_mag)
        for c in catalogues
        if c.brightest_g_mag is not None and c.faintest_g_mag is not None
    )
    if spans:
        who = "the catalogue {}s" if len(catalogues) == 1 else "the catalogues {}"
        out += _gaps(who, spans, faintest_g_mag)
    return tuple(out)


def _undrawn_from(
    scene: Scene, limit_g_mag: float, catalogues: Sequence[Catalogue]
) -> tuple[float, str]:
    """G beyond which stars are neither drawn nor in the sky, infinity where none are, and by what;
    arguments as of `undrawn_remarks`."""
    ends = [math.inf if c.faintest_g_mag is None else c.faintest_g_mag for c in catalogues]
    end, b = max(ends, default=math.inf), scene.background
    to_end = scene.stars is not None and scene.stars.limit_from_noise
    to_end &= b is None or b.starlight != "none"  # the sky holds what the catalogues have
    limit = end if to_end else min(limit_g_mag, end)
    return limit, "where the catalogues end" if limit == end else "stars.faintest_g_mag"


def undrawn_remarks(
    scene: Scene,
    limit_g_mag: float | None,
    catalogues: Sequence[Catalogue],
    facts: Facts,
    fit: ColourFit | None,
) -> list[str]:
    """What is said of stars beyond a limit or the catalogues' end, whose light the scene does not
    ask for, where that is more than the accuracy.

    scene : as asked; limit_g_mag : that it gives, or that the noise set; facts : with its sky
    """
    b = scene.background
    if limit_g_mag is None or fit is None or (b is not None and b.starlight == "all"):
        return []
    limit, which = _undrawn_from(scene, limit_g_mag, catalogues)
    if limit == math.inf:
        return []
    mag = float(colour_correction_mag(np.array([fit.default_colour]), fit)[0])
    pixel_m2_sr = facts.area_m2 * facts.ifov_rad**2 * scene.sensor.fill_factor
    rate = fit.zero_electrons_s_m2 * 10.0 ** (-0.4 * mag) * mean_light(limit) * pixel_m2_sr
    light_e = rate * integration_range_s(scene)[1]
    if light_e <= scene.accuracy.noise_fraction * facts.light_floor_e:
        return []
    return [
        f"stars beyond G = {limit:.3g} ({which}) are neither drawn nor in the sky: "
        f"{light_e:.3g} e- per pixel on the mean of the whole sky, some 3 times that in the Milky "
        "Way (background.starlight: all adds them)"
    ]


def mean_light(limit_g_mag: float) -> float:
    """Light per sr of the stars beyond a limit, the mean of the whole sky; a star of G = 0 is 1."""
    g = np.linspace(limit_g_mag, max(limit_g_mag, COUNTS_END_G_MAG), 401)
    middle = 0.5 * (g[1:] + g[:-1])
    return float(np.diff(all_sky_count(g)) @ 10.0 ** (-0.4 * middle)) / (4.0 * math.pi)


def _gaps(who: str, spans: list[tuple[float, float]], faintest_g_mag: float | None) -> list[str]:
    """Magnitudes up to the asked limit that none of the spans (brightest, faintest) reaches."""
    out, limit = [], math.inf if faintest_g_mag is None else faintest_g_mag
    if spans[0][0] > BRIGHT_END_G_MAG:
        out.append(
            f"{who.format('begin')} at G = {spans[0][0]:.1f}: brighter real stars are missing "
            "(Gaia DR2 lacks about 250 above G = 3; a bright list in a layer over it has them)"
        )
    reached = spans[0][1]
    for brightest, faintest in spans[1:]:
        if brightest > reached + GAP_G_MAG and reached < limit:
            out.append(f"no catalogue holds stars of G = {reached:.1f} to {brightest:.1f}")
        reached = max(reached, faintest)
    if reached < limit - GAP_G_MAG < math.inf:
        out.append(f"{who.format('end')} at G = {reached:.1f}, the scene asks for {faintest_g_mag}")
    return out
