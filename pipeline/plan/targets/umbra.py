"""Targets in the Earth's shadow: what of sunlight may still reach them, and who gets none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.physics.targets.umbra import umbra_fraction
from pipeline.plan.bodies.bodies import target_lights
from pipeline.plan.bodies.sights import sights
from pipeline.plan.decision import Decision
from pipeline.plan.pointing.geometry import moments_at
from pipeline.plan.rule import PlanBasis
from pipeline.plan.timing import integration_s
from pipeline.spec.scene import Scene

Indices = NDArray[np.int64]

MOST_NAMED = 5


def decide_umbra(basis: PlanBasis) -> list[Decision]:
    """The light omitted from targets in the umbra; nothing where none is in it."""
    scene, ends = basis.scene, basis.frames
    which = np.flatnonzero((ends.target_sunlit <= 0.0).any(axis=(1, 2)))
    if not len(which):
        return []
    electrons, share = _most_light(basis, which[:MOST_NAMED])
    names = _names(scene, which)
    more = "" if len(which) <= MOST_NAMED else f" (worked out for the first {MOST_NAMED})"
    return [
        Decision(
            "targets.umbra_light",
            False,
            f"{names} in the Earth's shadow: sunlight that its air bends (by up to 70 arcmin) and "
            f"scatters into the umbra is not drawn: at most {share:.2g} of full sunlight, "
            f"{electrons:.3g} e- in an exposure{more}. Satellites were seen there at magnitudes of "
            "8.5 to 10",
            bound=electrons,
            unit="e- of a target in an exposure",
        )
    ]


def umbra_remarks(scene: Scene, ends: Geometry) -> list[str]:
    """Who has no light at all in the frames looked at."""
    dark = (ends.target_sunlit <= 0.0).all(axis=(1, 2)) if ends.target_sunlit.size else np.zeros(0)
    which = np.flatnonzero(dark)
    if not len(which):
        return []
    return [
        f"{_names(scene, which)}: in the Earth's shadow during all frames looked at "
        f"({len(ends.frame)}): no light (see targets.umbra_light)"
    ]


def _most_light(basis: PlanBasis, which: Indices) -> tuple[float, float]:
    """Most electrons in an exposure, and of full sunlight, at mid-exposure of the frames."""
    scene, ends = basis.scene, basis.frames
    bare = scene.model_copy(
        update={"targets": [t.model_copy(update={"eclipse": False}) for t in scene.targets]}
    )
    some = [int(i) for i in which]
    at = moments_at(bare, basis.resolved.dut1_s, ends.offset_s[:, ends.middle])
    seen, view = sights(bare, some, at)
    light, _, _ = target_lights(
        [bare.targets[i] for i in some],
        [f"targets.{i}.body" for i in some],
        at.epoch,
        view,
        at.earth.sun_from_earth_m,
        (at.times.tt1, at.times.tt2),
        seen.range_m,
        len(ends.frame),
    )
    share = umbra_fraction(view.place_m, view.sun_m)
    exposed_s = np.array([integration_s(scene, int(f)) for f in ends.frame])
    sun_rate_e_s_m2, area_m2 = basis.resolved.sun_rate_e_s_m2, basis.facts.area_m2
    electrons = light * share * exposed_s * sun_rate_e_s_m2 * area_m2
    return float(electrons.max()), float(share.max())


def _names(scene: Scene, which: Indices) -> str:
    shown = ", ".join(scene.targets[int(i)].name for i in which[:MOST_NAMED])
    left = len(which) - MOST_NAMED
    return shown + (f" and {left} more" if left > 0 else "")
