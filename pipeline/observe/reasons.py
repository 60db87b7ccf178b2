"""Whether targets are seen, and else the first reason why not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.observe.angles import Angles
from pipeline.physics.positions.focal_plane import corner_radius
from pipeline.plan.pointing.lamps import Lamp
from pipeline.plan.pointing.occultation import hidden_by
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.sky.doubts import (
    HIGHEST_OF_NIGHT_RAD,
    day_margin,
    highest_sun_rad,
    lamp_margins,
)
from pipeline.spec.pointing.observer import GroundObserver

HIDDEN = {"horizon": "below horizon", "earth": "behind the Earth"}
SHADOW, SUN, MOON, DAYLIGHT, FIELD, FAINT = (
    "in shadow", "Sun", "Moon", "daylight", "out of field", "too faint",
)  # fmt: skip
REASONS = ("yes", *HIDDEN.values(), SHADOW, SUN, MOON, DAYLIGHT, FIELD, FAINT)


def seen_of(
    plan: ResolvedScene,
    angles: Angles,
    columns: dict[str, Array],
    in_field: NDArray[np.bool_],
    least_snr: float,
    measured_sun_rad: float,
) -> NDArray[np.str_]:
    """`yes`, or the first reason (F, T) in the order of REASONS.

    Sun, Moon and daylight are what a render of the frame would refuse (`plan.sky.doubts`); of a
    target out of the field, what one would that is pointed at it.
    in_field : whose path touches the frame; measured_sun_rad : highest Sun of the exposures, to
        which a site's own uniform sky is taken for measured
    """
    frame = {k: v[:, None] for k, v in lamp_margins(plan.scene, angles.sun, angles.moon).items()}
    there = lamp_margins(plan.scene, *angles.seen_from(corner_radius(plan.camera)))
    near = {k: np.where(in_field, frame[k], there[k]) <= 0.0 for k in there}
    day = _by_day(plan, angles.sun, measured_sun_rad)[:, None] & np.ones_like(in_field)
    tests = (
        (columns["visible_fraction"] <= 0.0, HIDDEN[hidden_by(plan.scene)]),
        ((columns["sunlit_fraction"] <= 0.0) & ~(columns["electrons"] > 0.0), SHADOW),
        (near["sun"] | near["near the sun"], SUN),
        (near["moon"] | near["near the moon"], MOON),
        (day, DAYLIGHT),
        (~in_field, FIELD),
        (~(columns["snr"] >= least_snr), FAINT),
    )
    return np.select([test for test, _ in tests], [why for _, why in tests], "yes")


def _by_day(plan: ResolvedScene, sun: Lamp, measured_sun_rad: float) -> NDArray[np.bool_]:
    """Exposures (F,) with a Sun too high for the sky of a site."""
    if not isinstance(plan.scene.observer, GroundObserver):
        return np.zeros(sun.elevation.shape, bool)
    highest = highest_sun_rad(plan.scene)
    if highest is None:
        highest = max(HIGHEST_OF_NIGHT_RAD, measured_sun_rad)
    return np.asarray(day_margin(sun, highest) < 0.0)
