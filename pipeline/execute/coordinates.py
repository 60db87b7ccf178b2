"""Where and when a frame was taken: its times, WCS and attitude, as plain numbers."""

from __future__ import annotations

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.arrays import Geometry
from pipeline.execute.truth import world_of
from pipeline.physics.positions.focal_plane import fit_wcs
from pipeline.plan.plan import Plan
from pipeline.plan.timing import dwell_of, dwell_plans, frame_times
from pipeline.store.clock import utc_microseconds

SIP_SIZE = 5  # SIP polynomials up to order 4
SIP_SIZE_DISTORTED = 10  # and up to order 9


def frame_coordinates(plan: Plan, g: Geometry) -> JsonObject:
    """The values along `frame` of the one frame of a geometry, by name; nested lists of numbers."""
    fit = fit_wcs(plan.camera, world_of(plan, g))
    size = SIP_SIZE if plan.camera.distortion is None else SIP_SIZE_DISTORTED
    values = {
        name: utc_microseconds(g.utc1[:, k], g.utc2[:, k])[0]
        for name, k in (("time_start", 0), ("time_mid", g.middle), ("time_end", -1))
    } | {
        "wcs_crval_deg": fit.crval_deg,
        "wcs_crpix_px": fit.crpix,
        "wcs_cd_deg": fit.cd_deg,
        "wcs_sip_order": np.int64(fit.sip_order),
        "wcs_sip_a": _padded(fit.sip_a, size if fit.sip_order else 0, size),
        "wcs_sip_b": _padded(fit.sip_b, size if fit.sip_order else 0, size),
        "wcs_residual_px": np.float64(fit.residual_px),
        "attitude": g.attitude[0, g.middle],
    }
    if plan.scene.dwells is not None:
        frames = g.frame[:1]
        values["integration_s"] = frame_times(plan.scene, frames)[1][0]
        values["dwell"] = dwell_of(dwell_plans(plan.scene), frames)[0]
    return {name: value.tolist() for name, value in values.items()}


def _padded(table: np.ndarray, most: int, size: int) -> np.ndarray:
    """SIP coefficients up to `most` a side in a table of fixed size, else zero."""
    out, kept = np.zeros((size, size)), table[:most, :most]
    out[: kept.shape[0], : kept.shape[1]] = kept
    return out
