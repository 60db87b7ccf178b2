"""Whether targets are seen, and else the first reason why not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.observe.angles import Angles
from pipeline.plan.pointing.geometry import aimed, sampled_frames
from pipeline.plan.pointing.lamps import Lamp, sun_and_moon
from pipeline.plan.pointing.occultation import hidden_by
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.sky.doubts import HIGHEST_OF_NIGHT_RAD, highest_sun_rad, lamp_margins
from pipeline.plan.timing import frame_times
from pipeline.spec.pointing.observer import GroundObserver

HIDDEN = {"horizon": "below horizon", "earth": "behind the Earth"}
REASONS = ("yes", *HIDDEN.values(), "in shadow", "Sun", "Moon", "daylight", "out of field",
           "sky fills the pixels", "too faint")  # fmt: skip


def seen_of(
    plan: ResolvedScene,
    g: Geometry,
    angles: Angles,
    columns: dict[str, Array],
    in_field: NDArray[np.bool_],
    least_snr: float,
) -> NDArray[np.str_]:
    """`yes`, or the first reason (F, T) in the order of REASONS.

    Sun, Moon and daylight are what a render of the frame would refuse (`plan.sky.doubts`); of a
    target out of the field, what one would that is pointed at it.
    in_field : whose path touches the frame
    """
    frame, there = (lamp_margins(plan.scene, *lamps) for lamps in (angles.lamps, angles.turned))
    near = {k: np.where(in_field, frame[k][:, None], there[k]) <= 0.0 for k in there}
    tests = {
        HIDDEN[hidden_by(plan.scene)]: columns["visible_fraction"] <= 0.0,
        "in shadow": np.isnan(columns["v_mag"]),  # where no light is sent
        "Sun": near["sun"] | near["near the sun"],
        "Moon": near["moon"] | near["near the moon"],
        "daylight": _by_day(plan, angles.lamps[0])[:, None] & np.ones_like(in_field),
        "out of field": ~in_field,
        "sky fills the pixels": _filled(plan, g, columns, in_field),
        "too faint": ~(columns["snr"] >= least_snr),
    }
    return np.select(list(tests.values()), list(tests), "yes")


def _filled(
    plan: ResolvedScene, g: Geometry, columns: dict[str, Array], in_field: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Whether sky and dark alone fill the pixels (F, T) behind targets; of those out of the field,
    the pixels in the middle."""
    places = zip(columns["x_px"], columns["y_px"], in_field, strict=True)
    x_px, y_px = plan.camera.centre_px
    return np.array([
        plan.filled(int(frame), np.where(inside, x, x_px), np.where(inside, y, y_px))
        for frame, (x, y, inside) in zip(g.frame, places, strict=True)
    ]).reshape(in_field.shape)  # fmt: skip


def _by_day(plan: ResolvedScene, sun: Lamp) -> NDArray[np.bool_]:
    """Exposures (F,) with a Sun too high for the sky of a site.

    A uniform sky of the scene's own is taken for measured: under the Sun of its own exposures.
    """
    scene = plan.scene
    if not isinstance(scene.observer, GroundObserver):
        return np.zeros(sun.elevation.shape, bool)
    highest = highest_sun_rad(scene)
    if highest is None:
        start, exposed_s = frame_times(scene, sampled_frames(scene))
        own, _ = sun_and_moon(scene, *aimed(scene, start + 0.5 * exposed_s, plan.dut1_s))
        highest = max(HIGHEST_OF_NIGHT_RAD, float(own.elevation.max()) + 1e-9)
    return np.asarray(sun.elevation > highest)
