"""The path of each star by itself: exact, or interpolated across its zone of the focal plane."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pipeline.arrays import Array, Geometry
from pipeline.errors import BadInput
from pipeline.physics.motion.streak import Path, curve_through
from pipeline.physics.positions.focal_plane import Camera
from pipeline.plan.pointing.star_light import ChangingLight
from pipeline.plan.pointing.star_paths import star_paths
from pipeline.plan.response.zones import Zone, biquadratic

EXACT_MERGE_PX = 1e-6  # of paths worked out star by star; those of bright stars may be off less
FINEST_MERGE_PX = 1e-12  # of the brightest: places are rounded to about that
TOGETHER = 1000  # stars whose paths are worked out in one go


def star_offsets(
    camera: Camera,
    g: Geometry,
    x: Array,
    y: Array,
    aberration: bool,
    light: ChangingLight | None = None,
) -> Array:
    """(2, n, F, K) paths of the stars at (x, y) relative to their places at mid-exposure.

    At the nodes of `g`, or, where their light changes, at more steps of equal light: so that what
    lies evenly along a path is its star's light.
    """
    paths = star_paths(camera, g, x, y, aberration)
    if not np.isfinite(paths).all():
        raise BadInput(
            "exposure.integration_s",
            "a boresight that turns away from its field in one exposure",
            "a shorter exposure or a slower pointing",
        )
    offsets = paths - paths[..., [g.middle]]
    return offsets if light is None else light.at_equal_light(g, x, y, offsets)


def exact_path(camera: Camera, g: Geometry, x: float, y: float, aberration: bool) -> Path:
    """Path of the star at (x, y) at mid-exposure of the one frame of `g`, to EXACT_MERGE_PX."""
    [path] = exact_paths(camera, g, np.array([x]), np.array([y]), aberration)
    return path


def exact_paths(
    camera: Camera,
    g: Geometry,
    x_px: Array,
    y_px: Array,
    aberration: bool,
    merge_px: Array | float = EXACT_MERGE_PX,
    light: ChangingLight | None = None,
) -> Iterator[Path]:
    """The same of many stars (n,), worked out together: each as by itself, to the last bit.

    merge_px : (n,), or of all: as of `paths_through`; light : as of `star_offsets`
    """
    merge_px = np.broadcast_to(merge_px, x_px.shape)
    for some, offsets in offsets_in_parts(camera, g, x_px, y_px, aberration, light):
        yield from paths_through(offsets, merge_px[some])


def offsets_in_parts(
    camera: Camera,
    g: Geometry,
    x_px: Array,
    y_px: Array,
    aberration: bool,
    light: ChangingLight | None = None,
) -> Iterator[tuple[slice, Array]]:
    """`star_offsets` of many stars in the one frame of `g`, TOGETHER at a time: which, and their
    offsets (2, m, K)."""
    for first in range(0, len(x_px), TOGETHER):
        some = slice(first, first + TOGETHER)
        yield some, star_offsets(camera, g, x_px[some], y_px[some], aberration, light)[:, :, 0]


def paths_through(offsets: Array, merge_px: Array) -> Iterator[Path]:
    """Paths of stars through offsets (2, n, K) at equal steps; merge_px : (n,) how far the nodes
    of straight runs that become one segment may be off."""
    steps = offsets.shape[2] - 1
    weight = np.full(steps, 1.0 / steps)
    for dx, dy, merge in zip(*offsets, merge_px, strict=True):
        yield curve_through(dx, dy, weight, float(merge))


def own_paths(
    camera: Camera,
    g: Geometry,
    zone: Zone,
    followed: Array,
    off_px: float,
    x_px: Array,
    y_px: Array,
    merge_px: Array,
    aberration: bool,
    light: ChangingLight | None = None,
) -> list[Path]:
    """The path of each of the stars (n,) of a zone in the one frame of `g`.

    followed : (K, 2, 3, 3) places at equal times of stars at the zone's NODES; off_px : error of
        interpolating between them
    merge_px : (n,) how far the nodes of straight runs that become one segment may be off; where
        interpolation is farther off, and outside of the zone, each star is followed by itself,
        to EXACT_MERGE_PX or better
    The numbers of a star do not depend on which others are asked for.
    """
    if not len(x_px):
        return []
    u, v = zone.uv(x_px, y_px)
    near = (np.maximum(np.abs(u), np.abs(v)) <= 1.0) & (off_px <= merge_px)
    places = np.array([biquadratic(table, u, v) for table in followed])
    between = paths_through(places.transpose(1, 2, 0)[:, near], merge_px[near])
    finer_px = np.minimum(merge_px[~near], EXACT_MERGE_PX)
    exact = exact_paths(camera, g, x_px[~near], y_px[~near], aberration, finer_px, light)
    return [next(between if inside else exact) for inside in near]
