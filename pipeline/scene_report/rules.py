"""The measured row of each rule of the ledger: bound, error caused, seconds saved; or why not."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import Any

from pipeline.plan.ledger import LEDGER, Rule

Row = dict[str, Any]

# Rules of which no switch tells the error, by their first component.
WHY = {
    "adc": "never left out: a frame without it has no digital numbers",
    "detector_extras": "asked for by the scene: what is not asked for has no value to compare with",
    "stars.doppler": "nothing draws it; the plan states 3 v/c of a star's light",
    "stars.faint": "the stars beyond the limit are not in every catalogue; the test draws them",
    "precession_nutation": "always on; polar motion is in no path of the code (10 m of a site)",
    "atmosphere": "asked for by the scene; without the section there is no air",
    "earth_occultation": "never done off the boresight: nothing to compare with",
    "distortion": "asked for by the scene: it is exact to rounding, or absent",
    "dwells": "asked for by the scene: the same frames, in stretches",
    "pointing_table": "the plan measures it anew for each table, by leaving its rows out",
    "pointing_motion": "random: the test compares the variance of many runs with the spectrum's",
    "pointing_refraction": "a choice of what a pointing names, no approximation",
    "one_psf": "asked for by the scene: one response, or those it gives for places",
    "stray_light.*": "asked for by the scene, body by body",
    "targets.eclipse": "asked for by the scene, target by target",
    "targets.earthshine": "asked for by the scene; the plan states what its absence is worth",
    "targets.ephemeris": "the plan measures it anew for each table, by leaving its rows out",
    "targets.forces": "asked for by the orbit; the test takes the forces one by one",
    "targets.light_between_nodes": "the plan adds moments until halving them changes nothing",
    "targets.light_between_facets": "shadows always; light between facets in no path of the code",
    "populations.*": "none is missed: the test looks at every object, moment by moment",
}


def measured_rules(study: Row) -> list[Row]:
    """A row for each rule of the ledger, from a study's switches and effects.

    Of several measurements that with the largest share of its bound. Every row has `rule` and
    `test`, and either component, scene, bound, error, unit, seconds_saved, holds; or `why`.
    """
    found = list(_records(study))
    return [_row(rule, found) for rule in LEDGER]


def _records(study: Row) -> Any:
    for scene in study["scenes"]:
        for s in scene["switches"]:
            of_light = s["of_light"]
            unit = "e-" if of_light else "sigma"
            bound, error = (
                (s["bound_e"], s["error_e"]) if of_light else (s["bound_sigma"], s["error_sigma"])
            )
            yield _record(scene, s, bound, error, unit)
        for e in scene["effects"]:
            yield _record(scene, e, e["bound"], e["error"], e["unit"])


def _record(scene: Row, one: Row, bound: float, error: float, unit: str) -> Row:
    return {
        "component": one["component"], "scene": scene["scene"], "bound": bound, "error": error,
        "unit": unit, "seconds_saved": one["seconds_off"] - one["seconds_on"],
        "holds": one["holds"],
    }  # fmt: skip


def _row(rule: Rule, found: list[Row]) -> Row:
    mine = [r for r in found if any(fnmatchcase(r["component"], c) for c in rule.components)]
    head = {"rule": rule.components[0], "test": rule.test}
    if mine:
        return head | max(mine, key=lambda r: r["error"] / r["bound"] if r["bound"] else r["error"])
    return head | {"why": WHY.get(rule.components[0], "not in the scenes that were measured")}
