"""The last stage: coordinates, WCS, truth tables, preview, report, and the seal."""

from __future__ import annotations

import json
import math
import resource
import time
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.arrays import FrameStars, concatenate
from pipeline.execute.check import summary
from pipeline.execute.coordinates import frame_coordinates
from pipeline.execute.truth import star_truth, target_truth
from pipeline.export.picture import write_preview
from pipeline.inputs.sensor.detector import gather_faults
from pipeline.lazily import arrow
from pipeline.plan.accuracy import doubts_of, for_sources, total_e, total_sigma
from pipeline.plan.described import colour_facts
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.responses import ResponsePlan
from pipeline.plan.response.sources import (
    TABLES,
    WINGS,
    SourceBounds,
    of_stars,
    of_targets,
    stars_known,
    targets_known,
)
from pipeline.plan.timing import longest_s
from pipeline.spec.load import scene_yaml
from pipeline.store import layout
from pipeline.store.clock import UNITS
from pipeline.store.cube import finish_cube
from pipeline.store.markers import markers_present, read_marker
from pipeline.store.product import Begun, Cell, cells_digest, cells_of, seal, truth_kinds
from pipeline.store.truth import drop_parts, join_parts, write_whole

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow as pa

WINDOW = 256
SAME = 1e-3  # of the noise of an empty pixel, up to which frames share one number
DTYPES = {"wcs_sip_order": np.int16, "dwell": np.int32}  # else float64, or int64
LIBRARIES = ("numpy", "numba", "scipy", "astropy", "pyerfa", "sgp4", "dask", "zarr", "pyarrow")
SOURCES = ("stars", "targets")  # tables of truth whose light is drawn as such
COLUMNS = ("frame", "x_px", "y_px", "electrons")
COLUMNS_OF_TARGETS = (
    "x_start_px", "y_start_px", "x_end_px", "y_end_px", "radius_px", "extended"
)  # fmt: skip
COVERAGE_KEY = "nightglass:coverage"  # in the schema's metadata of truth/stars.parquet
Coordinates = dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]


def finish(plan: Plan, catalogues: list[JsonObject], begun: Begun, times: JsonObject) -> JsonObject:
    """Turn finished tiles into a complete product; returns the report.

    catalogues : name, digest and what else the report tells of each, the main one first
    """
    product, started = begun.path, time.perf_counter()
    rows = {
        kind: join_parts(product, kind, plan.frames, _empty(plan, kind))
        for kind in truth_kinds(plan)
    }
    rows |= _faults(plan, product)
    gathered = gather_markers(plan, product)
    errors = _errors(plan, begun, gathered.checks)
    doubts = _doubts(plan, errors)
    plan = replace(plan, warnings=(*doubts, *plan.warnings))
    finish_cube(product, gathered.coordinates, _attributes(plan, catalogues))
    write_preview(product, plan)
    residual = float(gathered.coordinates["wcs_residual_px"][1].max())
    errors = {"wcs_residual_px": residual} | errors
    report = _report(plan, catalogues, begun, rows, errors, gathered.digest)
    report["errors"]["as_stated"] = not doubts
    report["seconds"] = times | {"finish_s": time.perf_counter() - started}
    layout.write_atomically(product / layout.REPORT, layout.to_json(report))
    seal(product, gathered.digest)
    drop_parts(product)  # after the seal: one that is killed here needs no part again
    return report


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
            "source": f"Nightglass {version('nightglass')}",
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
    usage = resource.getrusage(resource.RUSAGE_SELF)
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
        "memory": {"peak_driver_mb": usage.ru_maxrss / 1024.0},
        "versions": {"nightglass": version("nightglass")} | {n: version(n) for n in LIBRARIES},
    }


def _errors(plan: Plan, begun: Begun, checks: list[JsonObject]) -> JsonObject:
    """What the product may err by, for the sources that were drawn, and what was found."""
    drawn, floor_e = _drawn(plan, begun), plan.facts.sigma_floor_e
    brighter = drawn.brightest_e / (plan.brightest_e or math.inf)
    decisions = for_sources(plan.decisions, drawn.errors_e, floor_e, brighter)
    over_e = max(0.0, drawn.errors_e.get(TABLES, 0.0) - plan.responses.budget_e)
    return {
        "noise_floor_e": floor_e,
        "bound_of_all_approximations_e": total_e(decisions) + over_e,
        "bound_of_all_approximations_sigma": total_sigma(decisions) + over_e / floor_e,
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


def _doubts(plan: Plan, errors: JsonObject) -> list[str]:
    return doubts_of(
        errors["asked_sigma"],
        errors["bound_of_all_approximations_sigma"],
        errors["achieved_error_sigma"],
        "error" in plan.scene.accept,
    )


def _drawn(plan: Plan, begun: Begun) -> SourceBounds:
    """What drawing errs by at most, for all sources that were drawn: some frames after the other.

    Truth has what pixels collect of a source, bounds are of the light that falls.
    """
    r, fill = plan.responses, plan.responses.blur.fill_factor
    found = {kind: SourceBounds() for kind in SOURCES}
    for kind in (k for k in truth_kinds(plan) if k in SOURCES):
        file = arrow().parquet.ParquetFile(begun.path / layout.TRUTH / f"{kind}.parquet")
        for group in range(file.num_row_groups):
            names = COLUMNS if kind == "stars" else (*COLUMNS, *COLUMNS_OF_TARGETS)
            rows = file.read_row_group(group, columns=names)
            c = {name: rows[name].to_numpy() for name in names}
            c["electrons"] = c["electrons"] / fill
            one = _of_stars(r, c) if kind == "stars" else _of_targets(plan, c)
            found[kind] = found[kind].worst(one)
    return found["stars"].together(found["targets"])


def _of_stars(r: ResponsePlan, c: dict[str, np.ndarray]) -> SourceBounds:
    return of_stars(r, stars_known(r, c["frame"], c["x_px"], c["y_px"], c["electrons"]))


def _of_targets(plan: Plan, c: dict[str, np.ndarray]) -> SourceBounds:
    """Of the targets whose light reaches the frame; truth has the others, too."""
    r, (rows, columns) = plan.responses, plan.scene.sensor.shape
    ends = np.array([c[f"{axis}_{end}_px"] for end in ("start", "end") for axis in "xy"])
    size = np.nan_to_num(c["radius_px"])
    beyond = plan.halo_px + r.reach_core_px + size
    with np.errstate(invalid="ignore"):
        (x0, x1), (y0, y1) = (np.sort(ends[i::2], axis=0) for i in (0, 1))
        near = (x1 > -beyond) & (x0 < columns + beyond) & (y1 > -beyond) & (y0 < rows + beyond)
    near &= c["electrons"] > 0.0
    light_e, size, extended = (v[near] for v in (c["electrons"], size, c["extended"]))
    known = c["frame"][near], ends[:, near], light_e, size, extended
    return of_targets(r, targets_known(r, (rows, columns), *known))


def _achieved(checks: list[JsonObject]) -> JsonObject:
    """What the reference path found in the cells that were drawn again."""
    records = sorted(checks, key=lambda c: (c["frame"], c["y0"], c["x0"]))
    return summary(records) | {"checked": records}


def _empty(plan: Plan, kind: str) -> pa.Table:
    """A truth table without rows, for its schema."""
    pa = arrow()
    if kind == "cosmic_rays":
        from pipeline.physics.cosmic_rays.frame import no_truth

        return pa.table(no_truth())
    g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
    if kind == "targets":
        return pa.table(target_truth(plan, g)).slice(0, 0)
    stars = pa.table(star_truth(plan, g, concatenate([], FrameStars)))
    if plan.coverage is None:
        return stars
    return stars.replace_schema_metadata({COVERAGE_KEY: json.dumps(plan.coverage.as_dict())})
