"""Where stars go on the focal plane during exposures, and how far they come."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry, Refined
from pipeline.physics.constants import DEG_RAD, SPEED_OF_LIGHT_M_S
from pipeline.physics.motion.rolling import exposed_longer, rolled
from pipeline.physics.positions.apparent import aberrate, unaberrate
from pipeline.physics.positions.focal_plane import (
    Camera,
    corner_radius,
    deproject,
    project,
    stretch,
)
from pipeline.physics.positions.refraction import refract, unrefract

Array = NDArray[np.float64]

AT_ONCE = 4096  # places that are worked out together
WIDE_RAD = 1.0 * DEG_RAD  # from the axis to a corner, from where on turns beside a field differ
UNROLLED = 3  # turns of the search for where a star stands in the first row's time


def excursions_px(camera: Camera, g: Geometry, aberration: bool = True) -> Array:
    """Farthest (F,) that a star of each frame moves from its place at mid-exposure, in whole 16 px.

    Told from the centre and the corners of the field.
    """
    paths = star_paths(camera, g, *field_points(camera), aberration)
    worst = np.hypot(*(paths - paths[..., [g.middle]])).max(axis=(0, 2))
    for k, finer in (g.finer if isinstance(g, Refined) else {}).items():
        paths = star_paths(camera, finer, *field_points(camera), aberration)
        worst[k] = max(worst[k], np.hypot(*(paths - paths[..., [finer.middle]])).max())
    if camera.line_s:  # from where a star is in the first row's time
        took = g.offset_s[:, -1] - g.offset_s[:, 0]
        took = np.where(took > 0.0, took, np.inf)  # bias frames: no light, no motion
        worst += worst / (0.5 * took) * abs(camera.line_s) * 1.5 * camera.rows
    worst *= stretch(camera) ** 2  # between the points looked at
    if corner_radius(camera) > WIDE_RAD:
        worst = np.fmax(worst, _entered_px(camera, g, aberration))
    return np.where(worst > 1e-3, 16.0 * np.ceil(worst / 16.0), 0.0)


def _entered_px(camera: Camera, g: Geometry, aberration: bool) -> Array:
    """The same (F,) of stars that are in the centre and the corners at either end of an exposure:
    beside a wide field, where they come from, a turn moves places farther than in it."""
    middle, found = at_nodes(g, np.array([g.middle])), np.zeros(len(g.frame))
    for end in (0, g.nodes - 1):
        x, y = field_points(camera)
        then = at_nodes(g, np.array([end]))
        back = paths_of_those_at(camera, then, middle, x, y, aberration)[..., 0]
        moved = np.hypot(back[0] - x[:, None], back[1] - y[:, None])
        found = np.fmax(found, np.fmax.reduce(moved, axis=0))  # NaN: behind the camera
    return np.where(np.isfinite(found), found, 0.0)


def star_paths(
    camera: Camera, g: Geometry, x_px: Array, y_px: Array, aberration: bool = True
) -> Array:
    """Pixel places (2, n, F, K) of the stars that stand at (x, y) at mid-exposure of each frame.

    Of a rolling shutter: at mid-exposure of their own row, and followed during its exposure.
    """
    if not camera.line_s:
        return still_paths(camera, g, x_px, y_px, aberration)
    frames = (Geometry.frame_slice(g, f) for f in range(len(g.frame)))
    return np.concatenate(
        [_rolled_paths(camera, one, x_px, y_px, aberration) for one in frames], axis=2
    )


def rolled_stars(
    camera: Camera, g: Geometry, x_px: Array, y_px: Array, aberration: bool
) -> tuple[Array, Array, Array]:
    """Where stars (n,) that stand at (x, y) at mid-exposure of a frame's first row are at that of
    their own row, and how much longer than a row they are exposed (n,). g : one frame."""
    ends = at_nodes(g, np.array([0, g.middle, g.nodes - 1]))
    still = still_paths(camera, ends, x_px, y_px, aberration)[:, :, 0]
    times = ends.offset_s[0] - ends.offset_s[0, 0]
    x, y, delay = rolled(still[0], still[1], times, camera.line_s, camera.rows)
    return x[:, 1], y[:, 1], exposed_longer(delay, times)


def at_nodes(g: Geometry, nodes: NDArray[np.int64]) -> Geometry:
    """The geometry at some of its nodes, in what star paths follow from."""
    return replace(g, **{name: getattr(g, name)[:, nodes] for name in _NODEWISE})


_NODEWISE = ("offset_s", "observer_m_s", "attitude", "air")  # all that star paths follow from


def _rolled_paths(camera: Camera, g: Geometry, x: Array, y: Array, aberration: bool) -> Array:
    """The same of one frame of a rolling shutter."""
    x0, y0, times = x, y, g.offset_s - g.offset_s[:, [0]]
    for _ in range(UNROLLED):
        still = still_paths(camera, g, x0, y0, aberration)
        found = rolled(still[0], still[1], times, camera.line_s, camera.rows)
        moved = np.stack(found[:2])
        off_x, off_y = moved[:, :, 0, g.middle] - (x, y)
        x0, y0 = x0 - off_x, y0 - off_y
    return moved


def still_paths(
    camera: Camera, g: Geometry, x_px: Array, y_px: Array, aberration: bool = True
) -> Array:
    """The same where all rows are exposed together, or in the time of the first one."""
    return paths_of_those_at(camera, g, g, x_px, y_px, aberration)


def paths_of_those_at(
    camera: Camera, now: Geometry, g: Geometry, x_px: Array, y_px: Array, aberration: bool
) -> Array:
    """Pixel places (2, n, F, K) at the nodes of `g` of the stars that stand at (x, y) at
    mid-exposure of the same frames of `now`."""
    out = np.empty((2, len(x_px), *g.offset_s.shape))
    whole = 1.0 if aberration else 0.0
    beta_now, beta = (of.observer_m_s / SPEED_OF_LIGHT_M_S * whole for of in (now, g))
    step = max(1, AT_ONCE // max(1, len(x_px)))
    for f in range(len(g.frame)):
        seen = deproject(camera, now.attitude[f, now.middle], x_px, y_px)
        stars = unaberrate(unrefract(seen, now.air_at(f, now.middle)), beta_now[f, now.middle])
        for k in range(0, g.nodes, step):
            some = slice(k, k + step)
            u = refract(aberrate(stars[:, None], beta[f, some]), g.air_at(f, some))
            out[:, :, f, some] = project(camera, np.moveaxis(g.attitude[f, some], 0, -1), u)
        if camera.charge_px_s:
            out[1, :, f] -= camera.charge_px_s * (g.offset_s[f] - g.offset_s[f, g.middle])
    return out


def field_points(camera: Camera) -> tuple[Array, Array]:
    """Centre and corners of the frame [px]."""
    columns, rows = camera.columns - 1.0, camera.rows - 1.0
    return (
        np.array([columns / 2, 0.0, columns, 0.0, columns]),
        np.array([rows / 2, 0.0, 0.0, rows, rows]),
    )
