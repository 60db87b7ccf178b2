"""The last stage: coordinates, WCS, truth tables, preview, report, and the seal."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from catalog_tools.documents import JsonObject
from catalog_tools.engine.code import own_version
from catalog_tools.engine.heap import peak_mb
from pipeline.execute.check import summary
from pipeline.execute.coordinates import frame_coordinates
from pipeline.export.picture import write_preview
from pipeline.inputs.sensor.detector import gather_faults
from pipeline.lazily import arrow
from pipeline.plan.accuracy import (
    doubts_of,
    doubts_of_light,
    for_sources,
    total_e,
    total_sigma,
)
from pipeline.plan.described import colour_facts
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.sources import TABLES, WINGS, SourceBounds
from pipeline.plan.timing import longest_s
from pipeline.route.truths import Truths
from pipeline.spec.load import scene_yaml
from pipeline.store import layout
from pipeline.store.clock import UNITS
from pipeline.store.cube import finish_cube
from pipeline.store.markers import markers_present, read_marker
from pipeline.store.product import Begun, Cell, cells_digest, cells_of
from pipeline.store.seal import seal
from pipeline.store.truth import drop_parts, write_whole

if TYPE_CHECKING:
    from pathlib import Path

WINDOW = 256
SAME = 1e-3  # of the noise of an empty pixel, up to which frames share one number
DTYPES = {"wcs_sip_order": np.int16, "dwell": np.int32}  # else float64, or int64
LIBRARIES = ("numpy", "numba", "scipy", "astropy", "pyerfa", "sgp4", "dask", "zarr", "pyarrow")
Coordinates = dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]


def finish(
    plan: Plan, catalogues: list[JsonObject], begun: Begun, truths: Truths, times: JsonObject
) -> JsonObject:
    """Turn finished tiles into a complete product; returns the report.

    catalogues : name, digest and what else the report tells of each, the main one first
    """
    product, started = begun.path, time.perf_counter()
    rows, drawn = truths.end()
    rows |= _faults(plan, product)
    gathered = gather_markers(plan, product)
    errors = _errors(plan, drawn, gathered.checks)
    of_light = _doubts_of_light(plan, errors)
    doubts = _doubts(errors)
    plan = replace(plan, warnings=(*doubts, *of_light, *plan.warnings))
    finish_cube(product, gathered.coordinates, _attributes(plan, catalogues))
    write_preview(product, plan)
    residual = float(gathered.coordinates["wcs_residual_px"][1].max())
    errors = {"wcs_residual_px": residual} | errors
    report = _report(plan, catalogues, begun, rows, errors, gathered.digest)
    accepted = not of_light or "error" in plan.scene.accept
    report["errors"]["as_stated"] = (
        None if _unseen(errors) and accepted else not doubts and accepted
    )
    report["seconds"] = times | {"finish_s": time.perf_counter() - started}
    layout.write_atomically(product / layout.REPORT, layout.to_json(report))
    seal(product, gathered.digest)
    drop_parts(product)  # after the seal: one that is killed here needs no part again
    return report


def _unseen(errors: JsonObject) -> bool:
    """Whether no window could be drawn again, of those that were to be: nothing is known."""
    return not errors.get("windows") and bool(errors.get("windows_skipped"))


def _faults(plan: Plan, product: Path) -> dict[str, int]:
    """Write the table of pixels that fail, where the scene has any; its rows."""
    detector = plan.scene.sensor.detector
    if detector is None or (detector.bad, detector.dead, detector.hot) == (None, None, None):
        return {}
    return {
        "pixels": write_whole(product, "pixels", arrow().table(gather_faults(plan.scene) or {}))
    }


@dataclass(frozen=True)
class Gathered:
    """What the markers of a product hold: its coordinates, what was checked, its digest."""

    coordinates: Coordinates
    checks: list[JsonObject]
    digest: str


def gather_markers(plan: Plan, product: Path) -> Gathered:
    """Read every marker once. Coordinates that none holds (of sweeps, and of products that were
    begun before markers held any) are worked out."""
    rows, columns = plan.scene.sensor.shape
    found: dict[str, np.ndarray] = {}
    lacking = np.ones(plan.frames, bool)
    cells: list[Cell] = []
    checks: list[JsonObject] = []

    def keep(frame: int, values: JsonObject) -> None:
        lacking[frame] = False
        for name, value in values.items():
            if name not in found:
                dtype = DTYPES.get(name, np.asarray(value).dtype)
                found[name] = np.empty((plan.frames, *np.shape(value)), dtype)
            found[name][frame] = value

    for marker in map(read_marker, markers_present(product)):
        cells += cells_of(marker)
        checks += marker.checks
        if marker.coordinates is not None:
            keep(marker.frame, marker.coordinates)
    frames = np.flatnonzero(lacking)
    for start in range(0, len(frames), WINDOW):
        g = plan_geometry(plan.scene, frames[start : start + WINDOW], plan.dut1_s)
        for i, frame in enumerate(g.frame):
            keep(int(frame), frame_coordinates(plan, g.frame_slice(i)))
    out: Coordinates = {
        "y": (("y",), np.arange(rows), {"long_name": "row", "units": "pixel"}),
        "x": (("x",), np.arange(columns), {"long_name": "column", "units": "pixel"}),
        "frame": (("frame",), np.arange(plan.frames), {"long_name": "frame number"}),
    }
    for name, (dimensions, attrs) in FRAME_COLUMNS.items():
        if name in found:
            out[name] = (dimensions, found[name], attrs)
    return Gathered(out, checks, cells_digest(cells))


_TIME = {"units": UNITS, "calendar": "proleptic_gregorian"}
FRAME_COLUMNS: dict[str, tuple[tuple[str, ...], dict[str, str]]] = {
    "time_start": (("frame",), {"long_name": "UTC at the start of the exposure"} | _TIME),
    "time_mid": (("frame",), {"long_name": "UTC at the middle of the exposure"} | _TIME),
    "time_end": (("frame",), {"long_name": "UTC at the end of the exposure"} | _TIME),
    "integration_s": (("frame",), {"long_name": "integration time", "units": "s"}),
    "dwell": (("frame",), {"long_name": "which dwell a frame belongs to, from 0"}),
    "wcs_crval_deg": (
        ("frame", "world"),
        {"long_name": "ICRS place of the reference pixel", "units": "degree"},
    ),
    "wcs_crpix_px": (
        ("frame", "world"),
        {"long_name": "reference pixel, 1-based (FITS)", "units": "pixel"},
    ),
    "wcs_cd_deg": (("frame", "world", "axis"), {"long_name": "CD matrix", "units": "degree/pixel"}),
    "wcs_sip_order": (("frame",), {"long_name": "SIP order, 0 for plain TAN"}),
    "wcs_sip_a": (("frame", "power_u", "power_v"), {"long_name": "SIP A coefficients"}),
    "wcs_sip_b": (("frame", "power_u", "power_v"), {"long_name": "SIP B coefficients"}),
    "wcs_residual_px": (
        ("frame",),
        {"long_name": "largest error of the WCS over the frame", "units": "pixel"},
    ),
    "attitude": (
        ("frame", "camera_axis", "icrs_axis"),
        {"long_name": "camera axes +x, +y, boresight at mid-exposure, apparent ICRS directions"},
    ),
}


def _attributes(plan: Plan, catalogues: list[JsonObject]) -> JsonObject:
    """Provenance, on the cube itself."""
    main, layers = catalogues[0] if catalogues else {}, catalogues[1:]
    over = {
        "layers": [layer["name"] for layer in layers],
        "layer_digests": [layer["digest"] for layer in layers],
    }
    return (
        {
            "title": plan.scene.name,
            "Conventions": "CF-1.11",
            "complete": True,
            "source": f"Nightglass {own_version()}",
            "scene": scene_yaml(plan.scene),
            "seed": plan.scene.seed,
            "ifov_rad": plan.facts.ifov_rad,
            "integration_s": longest_s(plan.scene),
            "catalogue": main.get("name"),
            "catalogue_digest": main.get("digest"),
            "synthetic_stars": any(c["synthetic"] for c in catalogues),
            "pixel_convention": "pixel (0, 0) is the centre of the first pixel; axes (y, x)",
            "warnings": list(plan.warnings),
        }
        | (over if layers else {})
        | ({"distorted": True} if plan.camera.distortion else {})
    )


def _report(
    plan: Plan,
    catalogues: list[JsonObject],
    begun: Begun,
    rows: dict[str, int],
    errors: JsonObject,
    digest: str,
) -> JsonObject:
    return {
        "scene": plan.scene.name,
        "warnings": list(plan.warnings),
        "complete": True,
        "content_digest": digest,
        "frames": plan.frames,
        "tiles": len(plan.tiles) * plan.frames,
        "tiles_resumed": len(begun.done),
        "redrawn": list(begun.redrawn),
        "truth_rows": rows,
        "catalogue": catalogues[0] if catalogues else None,
        "layers": catalogues[1:],
        "colour_fit": colour_facts(plan),
        "coverage": plan.coverage.as_dict() if plan.coverage else None,
        "errors": errors,
        **_empty_noise(plan),
        "remarks": list(plan.remarks),
        "memory": {"peak_driver_mb": peak_mb()},
        "versions": _versions(),
    }


@cache
def _versions() -> dict[str, str]:
    return {"nightglass": own_version()} | {name: version(name) for name in LIBRARIES}


def _errors(plan: Plan, drawn: SourceBounds, checks: list[JsonObject]) -> JsonObject:
    """What the product may err by, for the sources that were drawn, and what was found."""
    floor_e = plan.facts.sigma_floor_e
    brighter = drawn.brightest_e / (plan.brightest_e or math.inf)
    light_floor_e = plan.facts.light_floor_e
    decisions = for_sources(plan.decisions, drawn.errors_e, light_floor_e, brighter)
    over_e = max(0.0, drawn.errors_e.get(TABLES, 0.0) - plan.responses.budget_e)
    return {
        "noise_floor_e": floor_e,
        "bound_of_all_approximations_e": total_e(decisions) + over_e,
        "bound_of_all_approximations_sigma": total_sigma(decisions) + over_e / light_floor_e,
        "asked_sigma": plan.scene.accuracy.noise_fraction,
        "light_left_out": plan.responses.lost_light,
        "common_streak_px": plan.responses.streaks.spread_px,
        "brightest_source_e": drawn.brightest_e,
        "wing_error_of_brightest_e": drawn.errors_e.get(WINGS, 0.0),
    } | _achieved(checks)


def _empty_noise(plan: Plan) -> JsonObject:
    """`empty_noise_e`, the noise of a pixel without a source in the middle of each frame; nothing
    where `noise_floor_e`, of the darkest place and the shortest exposure, serves all to SAME."""
    noise_e, floor_e = plan.empty_noise_e(), plan.facts.sigma_floor_e
    if (np.abs(noise_e - floor_e) <= SAME * floor_e).all():
        return {}
    return {"empty_noise_e": [float(f"{v:.6g}") for v in noise_e]}


def _doubts(errors: JsonObject) -> list[str]:
    return doubts_of(errors["bound_of_all_approximations_sigma"], errors["achieved_error_sigma"])


def _doubts_of_light(plan: Plan, errors: JsonObject) -> list[str]:
    promised = max(errors["asked_sigma"], total_sigma(plan.decisions))
    return doubts_of_light(promised, errors["bound_of_all_approximations_sigma"])


def _achieved(checks: list[JsonObject]) -> JsonObject:
    """What the reference path found in the cells that were drawn again."""
    records = sorted(checks, key=lambda c: (c["frame"], c["y0"], c["x0"]))
    return summary(records) | {"checked": records}
