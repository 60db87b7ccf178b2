"""What a streak through a field of responses loses by the one mixture that it is drawn with."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import Array, Geometry
from pipeline.plan.tiles import distance_px

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene


def field_streak_warnings(plan: ResolvedScene, g: Geometry) -> list[str]:
    """That streaks are drawn with the responses of their middle, where that shows.

    A response R changes by dR/dy from pixel to pixel of the field. At an end of a streak of L px it
    is L/2 dR/dy off; of light F / L on each px of the streak a pixel sums F/2 of the changes
    along a line, or, of a short streak, F L/2 of the largest.
    """
    field = plan.responses.field
    if field is None or not (length_px := longest_px(plan, g)) > 0.0:
        return []
    from pipeline.plan.optics.psf_field import SAMPLES, changes_of, images_of

    scene, light_e = plan.scene, plan.facts.brightest_e
    changes = changes_of(field)
    off = max((_of_streak(np.abs(c), length_px, SAMPLES) for c in changes), default=0.0)
    off_e = 0.5 * length_px * off * light_e
    photons_e = _of_streak(images_of(field), length_px, SAMPLES) * light_e
    photons_e *= scene.sensor.photon_noise
    photons_e /= max(1.0, plan.facts.flat)
    sigma = off_e / math.sqrt(plan.facts.light_floor_e**2 + photons_e)
    if sigma <= scene.accuracy.noise_fraction:
        return []
    return [
        f"sensor.psf: streaks (up to {length_px:.3g} px) are drawn with the responses of their "
        f"middle all along: at their ends a pixel of the brightest source is some {off_e:.2g} e- "
        f"off, {sigma:.2g} of its noise (asked: {scene.accuracy.noise_fraction:g})"
    ]


def _of_streak(images: Array, length_px: float, samples: int) -> float:
    """The most that a pixel sums of images (..., n, n), so many samples a pixel and axis, drawn
    along a streak: per unit light."""
    line = max(float(images.sum(axis=axis).max()) for axis in (-2, -1)) / samples
    return min(float(images.max()), line / length_px)


def longest_px(plan: ResolvedScene, g: Geometry) -> float:
    """The longest streak of stars, or of a target that comes into the frame."""
    longest = 0.0 if plan.scene.stars is None else plan.responses.streaks.longest_px
    x, y = g.target_x_px, g.target_y_px
    inside = distance_px(x, y, 0, 0, plan.camera.rows, plan.camera.columns) <= 0.0
    lengths = np.hypot(np.diff(x, axis=-1), np.diff(y, axis=-1)).sum(axis=-1)
    return max(longest, float(np.nan_to_num(lengths)[inside.any(axis=-1)].max(initial=0.0)))
