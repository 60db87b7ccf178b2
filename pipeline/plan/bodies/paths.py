"""Where all targets are seen during some frames, and the light that they send: many together."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import DEG_RAD
from pipeline.physics.positions.apparent import TargetSight
from pipeline.physics.positions.focal_plane import Camera, project
from pipeline.physics.positions.limb import height_of_line_m, pole_at, zenith_of
from pipeline.physics.positions.refraction import refract
from pipeline.plan.bodies.attitudes import View
from pipeline.plan.bodies.bodies import target_lights
from pipeline.plan.bodies.changes import (
    CLOSE,
    has_means,
    is_changing,
    looks_asked,
    looks_for_means,
    mean_light,
)
from pipeline.plan.bodies.sights import Moments, sights
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene, Target
from pipeline.spec.targets.mesh import MeshBody

Array = NDArray[np.float64]

TOGETHER, SAMPLES = 1000, 200_000  # targets, and their moments, that are worked out in one go


@dataclass(frozen=True)
class TargetPaths:
    """Of T targets at n moments (T, n): pixels, light over the Sun's at 1 au, phase [rad], sunlit
    share, range [m], how clear of the Earth (`Geometry.target_clear`); direction (T, F, 3), proper,
    at mid-exposure of F frames; and of M meshes pose (M, F, 4, 3), pose_s and turn_rad (M, F), as
    in `Geometry`."""

    x_px: Array
    y_px: Array
    light: Array
    phase_rad: Array
    sunlit: Array
    range_m: Array
    clear: Array
    direction: Array
    pose: Array
    pose_s: Array
    turn_rad: Array


def target_paths(
    scene: Scene,
    camera: Camera,
    attitude: Array,
    at: Moments,
    frames: int = 1,
    air: Array | None = None,
) -> TargetPaths:
    """Paths and light of all targets, as observed through the air where there is any.

    attitude : (n, 3, 3) observed; air : (n, 5) of `air_of`
    The moments are the nodes of `frames` exposures, one after another.
    """
    count, moments = len(scene.targets), len(at.offset_s)
    nodes = moments // frames
    middles = np.arange(frames) * nodes + nodes // 2
    seven = np.zeros((7, count, moments))
    direction = np.zeros((count, frames, 3))
    poses: list[tuple[Array, Array, Array]] = []
    by_row = np.moveaxis(attitude, 0, -1)  # (3, 3, n): rows of numbers, one for each moment
    for which in batches(count, moments):
        seen, view = sights(scene, which, at)
        some = slice(which[0], which[-1] + 1)
        names = [f"targets.{i}.body" for i in which]
        light = target_lights(
            [scene.targets[i] for i in which],
            names,
            at.epoch,
            view,
            at.earth.sun_from_earth_m,
            (at.times.tt1, at.times.tt2),
            seen.range_m,
            frames,
            _tabled(scene, which, at, view),
        )
        _average(scene, which, at, seen, view, frames, light[0])
        observed = refract(seen.direction_proper, air)
        clear = clear_of_earth(scene, at, seen, observed)
        seven[:, some] = *project(camera, by_row, observed), *light, seen.range_m, clear
        direction[some] = observed[:, middles]
        for k, i in enumerate(which):
            body = scene.targets[i].body
            if isinstance(body, MeshBody):
                from pipeline.plan.bodies.meshes import (
                    mesh_poses,  # only scenes with meshes need it
                )

                one = view.of(np.array([k]))
                pose, turn = mesh_poses(body, at.epoch, one, attitude, names[k])
                turn = turn.reshape(frames, nodes)
                poses.append((pose[middles], one.time_s[0, middles], turn[:, -1] - turn[:, 0]))
    x, y, bright, phase, lit, distance, clear = seven
    if not poses:
        poses_, pose_s, turned = np.zeros((0, frames, 4, 3)), *np.zeros((2, 0, frames))
    else:
        poses_, pose_s, turned = (np.stack(column) for column in zip(*poses, strict=True))
    return TargetPaths(x, y, bright, phase, lit, distance, clear, direction, poses_, pose_s, turned)


def _average(
    scene: Scene,
    which: range,
    at: Moments,
    seen: TargetSight,
    view: View,
    frames: int,
    light: Array,
) -> None:
    """Light (m, n) at the nodes becomes its mean around each, of targets that flicker, in place.

    Between the nodes, places are straight lines; tables and turns are looked at as often as they
    ask for (`changes`).
    """
    nodes = len(at.offset_s) // frames
    for k, i in enumerate(which):
        target, field = scene.targets[i], f"targets.{i}.body"
        if nodes == 1 or not is_changing(target.body, at.epoch):
            continue
        left_s, offset_s = (v.reshape(frames, nodes) for v in (view.time_s[k], at.offset_s))
        first, last = left_s.min(axis=-1), left_s.max(axis=-1)
        span = offset_s[:, -1] - offset_s[:, 0]
        asked = looks_asked(target.body, at.epoch, first, last, span)
        for f in np.flatnonzero(has_means(target.body, asked)):
            some = slice(f * nodes, (f + 1) * nodes)
            one = View(*(getattr(view, v.name)[k : k + 1, some] for v in fields(View)))
            known = (one, at.earth.sun_from_earth_m[some], seen.range_m[k : k + 1, some])
            tt = at.times.tt1[some], at.times.tt2[some]
            table = _tabled_light(scene, i, at), at.offset_s[some]
            between = partial(_light_between, target, field, at.epoch, *known, tt, *table)
            often = looks_for_means(target.body, float(asked[f]))
            share = CLOSE * scene.accuracy.flux_fraction
            light[k, some] = mean_light(between, nodes, *often, share)


def _light_between(
    target: Target,
    field: str,
    epoch: tuple[float, float],
    view: View,
    sun_from_earth_m: Array,
    range_m: Array,
    tt: tuple[Array, Array],
    table: Callable[[Array, View], Array] | None,
    offset_s: Array,
    places: Array,
) -> Array:
    """Light (n,) of one target at places (n,) between the nodes (K) of an exposure, 0 to 1."""
    out, last = np.empty(len(places)), range_m.shape[1] - 1
    for some in (slice(k, k + TOGETHER) for k in range(0, len(places), TOGETHER)):
        begin = np.minimum((places[some] * last).astype(np.int64), last - 1)
        on = partial(_on_lines, begin, places[some] * last - begin)
        one = View(*(on(getattr(view, v.name)) for v in fields(View)))
        sun, tts = on(sun_from_earth_m[None])[0], (on(tt[0][None])[0], on(tt[1][None])[0])
        tabled = {} if table is None else {0: table(on(offset_s[None])[0], one)}
        known = sun, tts, on(range_m), 1, tabled
        out[some] = target_lights([target], [field], epoch, one, *known)[0][0]
    return out


def _on_lines(begin: NDArray[np.int64], part: Array, values: Array) -> Array:
    """Values (1, K, ...) on straight lines between nodes, `part` of the way beyond `begin` (n,)."""
    a, b = values[:, begin], values[:, begin + 1]
    return np.asarray(a + (b - a) * part.reshape(1, -1, *(1,) * (values.ndim - 2)))


def clear_of_earth(scene: Scene, at: Moments, seen: TargetSight, observed: Array) -> Array:
    """How clear of the Earth targets (m, n) are: positive where they are seen.

    From space the least height [m] of the line of sight above the ellipsoid, of a site the sine of
    the apparent elevation. observed : (m, n, 3) apparent directions
    """
    pole = pole_at(at.epoch)
    if isinstance(scene.observer, GroundObserver):
        up = zenith_of(at.observer_m, pole, scene.observer.latitude_deg * DEG_RAD)
        return np.asarray(np.sum(observed * up, axis=-1))
    return height_of_line_m(at.observer_m, seen.direction_geometric, pole, seen.range_m)


def _tabled(scene: Scene, which: range, at: Moments, view: View) -> dict[int, Array]:
    """Lights (n, C) of meshes whose light was worked out beforehand, by their place in `which`."""
    tables = ((k, _tabled_light(scene, i, at)) for k, i in enumerate(which))
    return {k: light(at.offset_s, view.of(np.array([k]))) for k, light in tables if light}


def _tabled_light(scene: Scene, index: int, at: Moments) -> Callable[[Array, View], Array] | None:
    """Lights (n, C) of a mesh that were worked out beforehand, by seconds after the epoch and its
    view; None of what has no table."""
    if not isinstance(scene.targets[index].body, MeshBody):
        return None
    from pipeline.plan.bodies.mesh_tables import table_of, table_phase

    table = table_of(scene, index, at)
    if table is None:
        return None
    return lambda offset_s, view: table.at(offset_s, table_phase(scene, index, view))


def batches(count: int, moments: int) -> Iterator[range]:
    """Targets that are worked out together: so many that their arrays stay small."""
    step = max(1, min(TOGETHER, SAMPLES // max(1, moments)))
    for first in range(0, count, step):
        yield range(first, min(first + step, count))
