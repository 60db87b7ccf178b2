"""How well the place of a target's light can be measured: the Cramer-Rao bound, and its noise."""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.execute.sources import FrameTarget, place_targets
from pipeline.execute.truth import lit_pixels, rows_and_columns, snr_of, world_of
from pipeline.physics.constants import ARCSEC_RAD
from pipeline.physics.motion.points import in_fewer_points
from pipeline.physics.targets.disc import Appearance
from pipeline.physics.vectors import to_angles
from pipeline.plan.resolved import ResolvedScene

STEP_PX = 0.02  # of the derivatives of a response


def measured(
    plan: ResolvedScene, g: Geometry, which: NDArray[np.int64], seed: int, moment: int
) -> dict[str, Array]:
    """Places (m,) of targets `which` in the one frame of `g` as a centroid would give them.

    Noise of the covariance of `centroid_covariance_px2`, drawn by (seed, moment, name) and put on
    the focal plane; from there the frame's WCS leads to the sky, as a plate solution would.
    """
    at = {t.index: t for t in place_targets(plan, g)}
    x, y = g.target_x_px[which, 0, g.middle], g.target_y_px[which, 0, g.middle]
    shape = [centroid_covariance_px2(plan, at[int(i)], int(g.frame[0])) for i in which]
    names = [plan.scene.targets[int(i)].name for i in which]
    off = np.array([_drawn(c, seed, moment, n) for c, n in zip(shape, names, strict=True)])
    ra, dec = to_angles(world_of(plan, g)(x + off[:, 0], y + off[:, 1]))
    sigma_px = np.sqrt(0.5 * np.trace(np.array(shape), axis1=1, axis2=2))
    return {
        "ra_measured_deg": np.degrees(ra),
        "dec_measured_deg": np.degrees(dec),
        "centroid_sigma_arcsec": sigma_px * plan.facts.ifov_rad / ARCSEC_RAD,
    }


def centroid_covariance_px2(plan: ResolvedScene, target: FrameTarget, frame: int) -> Array:
    """Least covariance (2, 2) of the place x, y of a source along its path [px^2].

    The inverse of Fisher's information sum (F p_a)(F p_b) / (sigma0^2 + F p) over pixels, whose
    noise is that of `matched_snr`; F light, p the response of a pixel, p_a its slope with x or y
    (Winick 1986, JOSA A 3, 1809, doi:10.1364/JOSAA.3.001809). A Gaussian response of s px gives
    2^(1/2) s / SNR against the sky alone, s / SNR where the source's own photons are the noise. It
    is reached at high SNR; near the threshold centroids are worse. An image within one pixel tells
    nothing by its slopes: no place is less known than by the width of the image with its pixel.
    Of a body that shows its size it grows from a point's as the width of the image does over its
    SNR, as if it were a Gaussian: an upper bound, as a limb is steeper.
    """
    point_px2, wide_px2 = _of_point(plan, target, frame)
    if target.body is None:
        return point_px2
    found, point = (snr_of(plan, t, frame) for t in (target, replace(target, body=None)))
    share = np.trace(point_px2) / np.trace(wide_px2) * (point / found) ** 2 if found else 1.0
    return np.asarray((wide_px2 + _covariance_px2(target.body)) * min(1.0, share))


def _of_point(plan: ResolvedScene, target: FrameTarget, frame: int) -> tuple[Array, Array]:
    """The covariance (2, 2) of the place of a target as a point, and that of its image [px^2]."""
    y, x = target.y_px, target.x_px
    blur = plan.responses.near(y, y, x, x)[0]
    shifts = ((0.0, 0.0), (STEP_PX, 0.0), (-STEP_PX, 0.0), (0.0, STEP_PX), (0.0, -STEP_PX))
    path = in_fewer_points(target.path, plan.responses.band)
    images = [lit_pixels(plan, blur, path, *shift) for shift in shifts]
    places = np.unique(np.concatenate([place for place, _ in images]))
    p, right, left, up, down = (_spread(places, *image) for image in images)
    slopes = np.stack([right - left, up - down]) / (2.0 * STEP_PX)
    light = plan.facts.flat * target.light_e
    own = light * p if plan.scene.sensor.photon_noise else 0.0
    floor_e2 = plan.snr_floor_e2(frame, np.array([x]), np.array([y]))
    information = light**2 * (slopes / (floor_e2 + own)) @ slopes.T
    known, axes = np.linalg.eigh(information)
    row, column = rows_and_columns(places)
    wide_px2 = np.cov(column, row, aweights=p, ddof=0)
    at = np.stack([column, row], axis=-1) @ axes
    off = at - np.average(at, axis=0, weights=p)
    widest_px2 = np.average(off**2, axis=0, weights=p) + 1.0 / 12.0
    if (known * widest_px2 >= 1.0).all():
        return np.asarray(np.linalg.inv(information)), wide_px2
    return (axes / np.maximum(known, 1.0 / widest_px2)) @ axes.T, wide_px2


def _covariance_px2(body: Appearance) -> Array:
    """Covariance (2, 2) of the light of a body in x and y."""
    y0, y1, x0, x1 = body.box
    y, x, share = body.points(1.0 / max(y1 - y0, x1 - x0, 1.0))
    return np.asarray(np.cov(x, y, aweights=share, ddof=0))


def _spread(places: NDArray[np.int64], place: NDArray[np.int64], value: Array) -> Array:
    out = np.zeros(len(places))
    out[np.searchsorted(places, place)] = value
    return out


def _drawn(covariance: Array, seed: int, moment: int, name: str) -> Array:
    turn = np.random.default_rng((seed, moment, zlib.crc32(name.encode())))
    return np.asarray(np.linalg.cholesky(covariance) @ turn.standard_normal(2))
