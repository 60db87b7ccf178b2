"""The apparent WCS of a frame: TAN, or TPV where it stands beside SIP terms of another WCS."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.positions.distortion import TPV_TERMS
from pipeline.physics.positions.focal_plane import (
    Camera,
    TangentPlane,
    deproject,
    frame_grid,
    ifov_rad,
    tan_keywords,
)
from pipeline.physics.vectors import to_angles

Array = NDArray[np.float64]
Header = dict[str, str | int | float]

LARGEST_RESIDUAL_PX = 1e-3
_LEAST_TERM_PX = 1e-8  # terms that move no pixel by more are omitted
_IDENTITY = {(1, 1): 1.0, (2, 1): 1.0}


def apparent_wcs_header(camera: Camera, attitude: Array, beside_sip: bool = False) -> Header | None:
    """FITS keywords (without suffix) of the map to apparent directions on ICRS axes.

    Exactly TAN about the boresight for a camera without distortion. A header has one set of SIP
    terms, in pixels, which astropy applies to every WCS of the header unless its CTYPE names
    another distortion. So an alternate `beside_sip` is written as TPV (FITS registry of
    conventions), whose PV terms belong to one WCS alone: identity, or the camera's distortion.

    None where TPV's terms up to degree 7 leave over 1e-3 px.
    """
    a = np.asarray(attitude, float)
    lon, lat = to_angles(a[2])
    plane = TangentPlane(float(lon), float(lat))
    cd_rad = ifov_rad(camera) * (np.stack([plane.east, plane.north]) @ a[:2].T)
    terms: dict[tuple[int, int], float] = _IDENTITY if beside_sip else {}
    if camera.distortion is not None:
        found, residual_px = _fit_tpv(camera, a, plane, np.degrees(cd_rad))
        if residual_px > LARGEST_RESIDUAL_PX:
            return None
        terms = found
    x0, y0 = camera.centre_px
    header = tan_keywords(
        np.degrees([float(lon), float(lat)]),
        np.array([x0 + 1.0, y0 + 1.0]),
        np.degrees(cd_rad),
        "TPV" if terms else "TAN",
    )
    header |= {f"PV{axis}_{k}": value for (axis, k), value in terms.items()}
    header["WCSNAME"] = "APPARENT"
    return header


def _fit_tpv(
    camera: Camera, attitude: Array, plane: TangentPlane, cd_deg: Array
) -> tuple[dict[tuple[int, int], float], float]:
    """TPV terms by (axis, number), and their largest error on another grid [px].

    Least squares of all 40 terms, those odd in r included, over the frame.
    """
    x0, y0 = camera.centre_px

    def at(side: int, shift: float) -> tuple[Array, Array]:
        u, v = frame_grid(camera, side, shift)
        seen = np.degrees(plane.project(deproject(camera, attitude, x0 + u, y0 + v)))
        return np.stack([u, v], -1) @ cd_deg.T, seen

    inner, seen = at(29, 0.0)
    scale = float(np.abs(inner).max())
    powers = np.array([p + max(q, 0) for p, q in TPV_TERMS])
    designs = [_design(w) for w in (inner / scale, inner[:, ::-1] / scale)]
    fits = [np.linalg.lstsq(d, seen[:, i], rcond=None)[0] for i, d in enumerate(designs)]
    least = _LEAST_TERM_PX * np.degrees(ifov_rad(camera))
    fits = [np.where((np.abs(f) > least) | (powers == 1), f, 0.0) for f in fits]
    terms = {
        (axis, k): float(value)
        for axis, fit in enumerate(fits, start=1)
        for k, value in enumerate(fit / scale**powers)
        if value
    }
    check, there = at(24, 0.02)
    back = [
        _design(w) @ f for w, f in zip((check / scale, check[:, ::-1] / scale), fits, strict=True)
    ]
    error_px = (np.stack(back, -1) - there) @ np.linalg.inv(cd_deg).T
    return terms, float(np.hypot(error_px[:, 0], error_px[:, 1]).max())


def _design(w: Array) -> Array:
    """All TPV terms (n, 40) of intermediate coordinates (n, 2), the own axis first."""
    r = np.hypot(w[:, 0], w[:, 1])
    return np.stack([r**p if q < 0 else w[:, 0] ** p * w[:, 1] ** q for p, q in TPV_TERMS], axis=-1)
