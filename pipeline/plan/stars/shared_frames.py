"""Frames in a row whose stars stand still: one drawing of their light serves them all."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry, Refined
from pipeline.physics.constants import ARCSEC_RAD, ASTRONOMICAL_UNIT_M
from pipeline.physics.positions.apparent import proper_to_astrometric, star_proper
from pipeline.physics.positions.focal_plane import deproject, project, stretch
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.targets.disc import SPHERE_VARIANCE
from pipeline.plan.accuracy import may_share_frames, total_sigma
from pipeline.plan.decision import Decision
from pipeline.plan.pointing.geometry import epochs_jyear, plan_geometry
from pipeline.plan.pointing.occultation import limb_in_reach
from pipeline.plan.pointing.star_paths import field_points, still_paths
from pipeline.plan.response.responses import point_curvature, point_slope
from pipeline.plan.stars.field_stars import OwnMotion

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene

PART = 0.9  # of what other approximations leave of the accuracy
BETWEEN = 1.2  # times what centre and corners of the field move, for stars between them
MOST_FRAMES = 1 << 12
LOOKS = 32  # frames that are looked at besides: those of equal steps may all be of one orbit phase


def share_frames(
    plan: ResolvedScene,
    decisions: tuple[Decision, ...],
    sampled: NDArray[np.int64],
    own: OwnMotion,
    seconds: float,
) -> tuple[int, tuple[Decision, ...]]:
    """As many frames to a drawing of stars as the accuracy leaves room for, and the decision on
    that where it is more than one.

    decisions : all others; sampled : the frames that are looked at; own : of the stars around
    them; seconds : that a drawing of stars takes
    """
    if not may_share_frames(plan.scene):
        return 1, ()
    golden = np.arange(LOOKS) * (math.sqrt(5.0) - 1.0) / 2.0 % 1.0  # of no period's step
    sampled = np.union1d(sampled, (golden * plan.frames).astype(np.int64))
    left = PART * (plan.scene.accuracy.noise_fraction - total_sigma(decisions))
    together, moved_px = 1, _moved_px(plan, sampled, own, 2)
    if bound_sigma(plan, moved_px) <= left:
        most = min(plan.frames, MOST_FRAMES)
        rate = bound_sigma(plan, moved_px)
        together = most if rate == 0.0 else int(min(most, max(2.0, left / rate)))
        moved_px = _moved_px(plan, sampled, own, together)
        while together > 1 and bound_sigma(plan, moved_px) > left:
            together //= 2
            moved_px = _moved_px(plan, sampled, own, together)
    if together == 1:
        return 1, ()
    decision = Decision(
        "shared_frames",
        True,
        f"the stars of {together} frames in a row are drawn once, where they stand in the first: "
        f"in the others they are at most {moved_px:.2g} px beside it",
        error_bound_e=_bound_e(plan, moved_px),
        error_bound_sigma=bound_sigma(plan, moved_px),
        seconds_saved=seconds * (1.0 - 1.0 / together),
    )
    return together, (decision,)


def _moved_px(
    plan: ResolvedScene, sampled: NDArray[np.int64], own: OwnMotion, together: int
) -> float:
    """How far a star is at most from where it stands in the first of its frames; infinite where
    the Earth's limb is in the way."""
    first = sampled - sampled % together
    last = np.minimum(first + together, plan.frames) - 1
    first, last = first[first < last], last[first < last]
    if not len(first):
        return 0.0
    g = plan_geometry(plan.scene, np.concatenate([first, last]), plan.dut1_s)
    if isinstance(g, Refined) or limb_in_reach(plan.scene, plan.camera, g, plan.halo_px):
        return math.inf
    return max(_apart_px(plan, g, own, i, i + len(first)) for i in range(len(first)))


def _apart_px(plan: ResolvedScene, g: Geometry, own: OwnMotion, a: int, b: int) -> float:
    """Farthest that a star of frame b of a geometry is from its place in frame a, at any node."""
    x, y = field_points(plan.camera)
    middle, effects = g.middle, plan.scene.star_effects
    proper = deproject(plan.camera, g.attitude[a, middle], x, y)
    sky = proper_to_astrometric(proper, g.observer_at(a, middle), **effects)
    place_m, velocity_m_s, sun_m = g.observer_at(b, middle)
    seen = star_proper(sky, place_m, velocity_m_s, sun_m, **effects)
    bx, by = project(plan.camera, g.attitude[b, middle], seen)
    before, after = (
        still_paths(plan.camera, g.frame_slice(k), *at, effects["aberration"])[:, :, 0]
        for k, at in ((a, (x, y)), (b, (bx, by)))
    )
    request = plan.scene.stars
    assert request is not None
    years = float(np.ptp(epochs_jyear(g)[[a, b]])) * request.space_motion
    far_m = float(np.linalg.norm(g.observer_m[b, middle] - g.observer_m[a, middle]))
    far_au = far_m / ASTRONOMICAL_UNIT_M * request.parallax
    own_mas = own.proper_motion_mas_yr * years + own.parallax_mas * far_au
    own_px = 1e-3 * ARCSEC_RAD * own_mas / plan.facts.ifov_rad
    return BETWEEN * float(np.hypot(*(after - before)).max()) + own_px * stretch(plan.camera)


def bound_sigma(plan: ResolvedScene, moved_px: float) -> float:
    """What a pixel errs by at most beside the brightest source, in units of its noise, where all
    sources stand so far beside their places.

    A response R >= 0 whose second derivative is at most M has a slope of at most sqrt(2 M R), so
    that the photon noise sqrt(L R) of the source itself hides all but sqrt(2 M L) a pixel.
    """
    if not moved_px:
        return 0.0
    light_e, floor_e = plan.facts.brightest_e, plan.facts.light_floor_e
    bent = max(_curvature(b) for b in plan.responses.blurs)
    steep_sigma = _bound_e(plan, moved_px) / floor_e
    if not plan.scene.sensor.photon_noise:
        return steep_sigma
    hidden = math.sqrt(2.0 * bent * light_e) * moved_px
    return min(steep_sigma, hidden + 0.5 * bent * light_e * moved_px**2 / floor_e)


def _bound_e(plan: ResolvedScene, moved_px: float) -> float:
    return max(point_slope(b) for b in plan.responses.blurs) * moved_px * plan.facts.brightest_e


def _curvature(blur: Blur) -> float:
    """Most that the second derivative of a response along a line is, per unit light [px^-2]."""
    return 2.0 * point_curvature(blur) / SPHERE_VARIANCE
