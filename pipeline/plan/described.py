"""The plan as plain data: for plan.json, `nightglass plan` and the service."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict

from catalog_tools.documents import JsonObject
from pipeline.physics.constants import ARCSEC_RAD
from pipeline.plan.decision import Decision
from pipeline.plan.ledger import rule_of
from pipeline.plan.needs import NOTHING_READ, NOTHING_SPENT, Spent, StarForecast, predict
from pipeline.plan.optics.optics import describe
from pipeline.plan.plan import Plan
from pipeline.plan.response.responses import CoreClass, ResponsePlan
from pipeline.plan.tiles import tile_shape


def plan_dict(
    plan: Plan,
    forecast: StarForecast | None,
    catalogues: Sequence[JsonObject] = (),
    spent: Spent = NOTHING_SPENT,
) -> JsonObject:
    """The plan as plain data, for plan.json and `nightglass plan`.

    catalogues : name, digest and what else is told of each, the main one first
    spent : what planning took, and how far its stars move
    """
    f, r, read = plan.facts, plan.responses, forecast or NOTHING_READ
    needs = predict(plan, forecast, spent)
    return {
        "scene": plan.scene.name,
        "warnings": list(plan.warnings),
        "frames": plan.frames,
        "shape": list(plan.scene.sensor.shape),
        "tile_shape": list(tile_shape(plan.scene)),
        "tiles": len(plan.tiles) * plan.frames,
        "shards": read.shards,
        "row_groups": read.row_groups,
        "star_rows_to_read": read.rows_to_read,
        "bytes_to_read": read.bytes_to_read,
        "stars_per_frame": read.stars_per_frame,
        "catalogue": catalogues[0] if catalogues else None,
        "layers": list(catalogues[1:]),
        "coverage": plan.coverage.as_dict() if plan.coverage else None,
        "targets": len(plan.scene.targets),
        "engine": _engine(r),
        "predicted": needs,
        "checked_cells": [asdict(c) for c in plan.checks],
        "noise_floor_e": f.sigma_floor_e,
        "background_e": f.background_e,
        "field_deg": [n * math.degrees(f.ifov_rad) for n in plan.scene.sensor.shape],
        "ifov_arcsec": f.ifov_rad / ARCSEC_RAD,
        "response": {
            "optics": describe(r.blur.optics),
            "field": None if r.field is None else r.field.describe(),
            "core_classes": [_core_class(c) for c in r.classes],
            "wing_grid_px": r.spacing_px,
            "reach_px": r.reach_px,
            "light_left_out": r.lost_light,
            "streak_zones": r.streaks.zones,
            "streak_pieces": r.streaks.pieces,
            "streak_spread_px": r.streaks.spread_px,
            "spectral_from_stars": r.spectral_from,
        },
        "colour_fit": colour_facts(plan),
        "decisions": [_finite(asdict(d)) | _rule(d) for d in plan.decisions],
        "remarks": list(plan.remarks),
    }


def colour_facts(plan: Plan) -> JsonObject | None:
    """Which colour fit the stars are drawn with; None for a scene without stars."""
    fit = plan.colour
    if fit is None:
        return None
    return {
        "band": fit.band_name,
        "source": fit.source,
        "digest": fit.digest,
        "residual_rms_mag": fit.residual_rms_mag,
        "residual_max_mag": fit.residual_max_mag,
        "redder_error_mag": fit.redder_error_mag,
    }


def _engine(r: ResponsePlan) -> str:
    if not r.classes:
        return "none: no sources"
    engine = "stamps + wings" if r.spacing_px else "stamps"
    if r.spectral_from:
        engine += f"; transforms where {r.spectral_from} stars or more light a block"
    return engine


def _core_class(core: CoreClass) -> JsonObject:
    """A core class; of how its stars are drawn together only where they are."""
    together = {} if core.together_from else {"together_from": 0, "together_e": 0.0}
    return {k: v for k, v in _finite(asdict(core)).items() if k not in together}


def _rule(decision: Decision) -> JsonObject:
    """What the ledger of omissions says of a decision."""
    rule = rule_of(decision.component)
    return {"rule": rule.rule, "measured_by": rule.test} if rule else {}


def _finite(values: JsonObject) -> JsonObject:
    """Infinite numbers as None: plain JSON has none."""
    return {
        k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()
    }
