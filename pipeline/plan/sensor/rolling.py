"""Rolling shutters in the plan: how far sources shift from row to row, and what that leaves out."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.errors import BadInput
from pipeline.physics.motion.rolling import later
from pipeline.physics.psf.response import compact_core
from pipeline.plan.pointing.attitude_motion import motion_plan
from pipeline.plan.pointing.geometry import camera_of, late_geometry, with_frames
from pipeline.plan.pointing.paths import near_frame
from pipeline.plan.pointing.star_paths import field_points, paths_of_those_at, still_paths
from pipeline.plan.timing import dwell_plans, last_row_late_s
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.detector import RollingShutter

if TYPE_CHECKING:
    from pipeline.plan.resolved import ResolvedScene

Array = NDArray[np.float64]

FIELD = "sensor.detector.readout.line_s"
MOST_SHEAR = 0.05  # px that a source may move in the time from one row to the next
MOST_OFF_PX = 0.1  # that the parabola of its motion may be off at the last row


def check_rolling(scene: Scene) -> None:
    """BadInput where a scene holds what no rolling shutter can be drawn with."""
    detector = scene.sensor.detector
    if detector is None or not isinstance(detector.readout, RollingShutter):
        return
    if motion_plan(scene) is not None:
        raise BadInput(
            "sensor.detector.readout",
            "rolling",
            "a readout without rows in turn, or a pointing without random motion (its course after "
            "an exposure is not known)",
        )
    if scene.populations:
        raise BadInput(
            "sensor.detector.readout",
            "rolling",
            "a readout without rows in turn, or targets of their own: populations are screened for "
            "the time of the first row",
        )


def rolling_shutter(
    scene: Scene, r: RollingShutter, ends: Geometry, dut1_s: float
) -> tuple[str, float]:
    """What a rolling shutter does to a scene, and how far places are off by it [px].

    BadInput where it cannot be drawn rightly.
    """
    lit, readout_s = _exposed(_of_every_dwell(scene, ends, dut1_s)), last_row_late_s(scene)
    speed = max((_fastest_px_s(scene, g) for g in lit), default=0.0)
    shear = speed * r.line_s
    if shear > MOST_SHEAR:
        raise BadInput(
            FIELD,
            r.line_s,
            f"at most {MOST_SHEAR / speed:.3g} s here, where a source moves {speed:.3g} px/s: "
            f"{MOST_SHEAR:g} px from row to row",
        )
    off = max((_off_px(scene, g, dut1_s, readout_s) for g in lit), default=0.0)
    if off > MOST_OFF_PX:
        raise BadInput(
            FIELD,
            r.line_s,
            f"a shorter readout: in {readout_s:.3g} s a source comes {off:.3g} px off the parabola "
            f"through its exposure ({MOST_OFF_PX:g} px are allowed)",
        )
    told = (
        f"row by row in {readout_s:.4g} s, {r.line_s:.3g} s each; a frame's times are those of its "
        f"first row. The fastest source moves {speed:.3g} px/s, {speed * readout_s:.3g} px in the "
        "readout: each is drawn with the path and light of its own row's exposure, by a "
        f"parabola from its path in the first row's, {off:.2g} px off at most. Its image is drawn "
        f"as of one row: a shear of {shear:.2g} px for each row from its middle is omitted, less "
        "than that fraction of its brightest pixel. Sky, ranges and the WCS are of the first row's "
        "time"
    )
    return told, off


def shear_warnings(plan: ResolvedScene, g: Geometry) -> list[str]:
    """That images are drawn as of one row, where that shows in the brightest source.

    A Gaussian image that moves by s px from row to row errs by s y dp/dy at most, 2 / e of s times
    its brightest pixel; g : some of the frames.
    """
    scene, r = plan.scene, plan.responses
    readout = None if scene.sensor.detector is None else scene.sensor.detector.readout
    if not isinstance(readout, RollingShutter) or not r.classes:
        return []
    speed = max((_fastest_px_s(scene, one) for one in _exposed(g)), default=0.0)
    length_px = 0.0 if scene.targets else r.streaks.shortest_px
    peak = max(float(compact_core(b, r.usual_px).samples.max()) for b in r.blurs)
    peak_e = plan.facts.brightest_e * min(peak, 1.0 / max(length_px, 1.0))
    off_e = 2.0 / math.e * speed * readout.line_s * peak_e
    noise_e = math.sqrt(plan.facts.light_floor_e**2 + scene.sensor.photon_noise * peak_e)
    if off_e <= scene.accuracy.noise_fraction * noise_e:
        return []
    return [
        f"sensor.detector.readout: images are drawn as of one row: the shear that is omitted makes "
        f"a pixel of the brightest source err by up to {off_e:.2g} e-, {off_e / noise_e:.2g} of "
        f"its noise (asked: {scene.accuracy.noise_fraction:g})"
    ]


def _of_every_dwell(scene: Scene, g: Geometry, dut1_s: float) -> Geometry:
    """The geometry with the first and the last frame of each dwell."""
    edges = [k for p in dwell_plans(scene) for k in (p.first, p.first + p.frames - 1)]
    return with_frames(scene, g, np.array(edges), dut1_s)


def _exposed(g: Geometry) -> list[Geometry]:
    """The frames of a geometry without bias frames, in which nothing is seen to move."""
    took = g.offset_s[:, -1] - g.offset_s[:, 0]
    if (took > 0.0).all():
        return [g]
    return [g.frame_slice(int(k)) for k in np.flatnonzero(took > 0.0)]


def _fastest_px_s(scene: Scene, g: Geometry) -> float:
    """The fastest motion of stars over the field, and of targets in or beside the frame."""
    camera, took = camera_of(scene), g.offset_s[:, -1] - g.offset_s[:, 0]
    step_s = took[:, None] / (g.nodes - 1)
    speeds = [0.0]
    if scene.stars is not None or not scene.targets:
        paths = still_paths(camera, g, *field_points(camera), scene.star_effects["aberration"])
        speeds.append(float((np.hypot(*np.diff(paths, axis=-1)) / step_s).max()))
    if scene.targets:
        with np.errstate(invalid="ignore"):
            steps = np.hypot(np.diff(g.target_x_px, axis=-1), np.diff(g.target_y_px, axis=-1))
            found = (steps / step_s)[near_frame(scene, g)]
        speeds.append(float(np.nanmax(found, initial=0.0)))
    return max(speeds)


def _off_px(scene: Scene, g: Geometry, dut1_s: float, readout_s: float) -> float:
    """How far sources at the last row are from where the parabola has them."""
    camera, d = camera_of(scene), scene.sensor.detector
    assert d is not None
    plain = d.model_copy(update={"readout": None})
    sensor = scene.sensor.model_copy(update={"detector": plain})
    scene = scene.model_copy(update={"sensor": sensor})
    now, late = (late_geometry(scene, g, dut1_s, s) for s in (0.0, readout_s))
    times, aberration = now.offset_s - now.offset_s[:, [0]], scene.star_effects["aberration"]
    off = [0.0]
    if scene.stars is not None:
        x, y = field_points(camera)
        told = later(still_paths(camera, now, x, y, aberration), times, readout_s)
        true = paths_of_those_at(camera, now, late, x, y, aberration)
        off.append(float(np.abs(told - true).max()))
    if scene.targets:
        near = near_frame(scene, now)
        for name in ("target_x_px", "target_y_px"):
            with np.errstate(invalid="ignore"):
                apart = later(getattr(now, name), times, readout_s) - getattr(late, name)
            off.append(float(np.nanmax(np.abs(apart[near]), initial=0.0)))
    return max(off)
