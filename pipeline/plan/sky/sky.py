"""The sky of a scene: its light on a small grid for each frame, and the stars left to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.physics.colour import brightest_electrons
from pipeline.physics.positions.focal_plane import Camera, ifov_rad
from pipeline.physics.sky.galactic import RELATIVE_ERROR
from pipeline.physics.sky.grid import FrameGrid, at_nodes, light_at, refine, tile_light
from pipeline.plan.decision import Decision
from pipeline.plan.facts import Facts, error_budget_e, light_floor_e
from pipeline.plan.pointing.geometry import plan_geometry, with_frames
from pipeline.plan.pointing.turns import turning_frames
from pipeline.plan.sky.inputs import SkyInputs
from pipeline.plan.sky.light import ALL_G_MAG, LightOfSky, background_of, off_plane_remarks
from pipeline.plan.stars.faint import (
    FaintLimit,
    faint_limit,
    limits_g_mag,
    peak_share,
)
from pipeline.plan.tiles import Tile
from pipeline.plan.timing import integration_range_s
from pipeline.spec.scene import Scene

Array = NDArray[np.float64]

GRID_SHARE = 0.125  # of one approximation's budget: the grid in a frame, and between frames
MOST_KNOTS, MOST_FIELDS = 1025, 2049
MOST_EXPOSURES, MOMENTS = 33, (3, 5, 9, 17, 33, 65)  # in which it is looked at how it changes
MOST_VALUES = 4_000_000
CORNERS_SPREAD = 0.5  # of the corners' mean, up to which simulators commonly take that mean
_Light = LightOfSky


@dataclass(frozen=True, eq=False)
class SkyPlan:
    """Light of the sky in every frame.

    knots : (k,) frames, ascending; grids : (k, ny, nx) e-/s and pixel at nodes over the frame (see
        `physics.sky.grid`), linear between knots; one knot where all frames are the same
    least_e_s : smallest of all; error_e : of the interpolation, in an exposure
    faintest_g_mag : the limit that was chosen from the noise; None where the scene gave it
    """

    shape: tuple[int, int]
    knots: NDArray[np.int64]
    grids: Array
    least_e_s: float
    error_e: float
    faintest_g_mag: float | None
    decisions: tuple[Decision, ...]
    remarks: tuple[str, ...] = ()

    @property
    def even(self) -> bool:
        """Whether one value serves all pixels of a frame."""
        return self.grids.shape[-2:] == (1, 1)

    def e_s_at(self, frame: int, x_px: Array, y_px: Array) -> Array:
        """Light (n,) at places in a frame, e-/s and pixel, before the flat."""
        return light_at(sky_grid(self, frame), self.shape, x_px, y_px)


def plan_sky(
    scene: Scene,
    camera: Camera,
    geometry: Geometry,
    facts: Facts,
    inputs: SkyInputs,
    dut1_s: float,
    limit_from_noise: bool = False,
) -> SkyPlan:
    """The sky's light in all frames, and the limiting magnitude if the noise is to choose it.

    geometry : of `sampled_frames`; facts : of `gather_facts`. The limit rests on the noise of the
    darkest place of the sky without the undrawn stars. Raises BadInput for a field too near the
    Sun, and an observer where the zodiacal light's distance law was not measured.
    """
    t = integration_range_s(scene)[1]
    light = LightOfSky(scene, camera, facts, inputs, None, dut1_s)
    if light.even and not limit_from_noise:
        geometry = geometry.frame_slice(0)
    else:
        geometry = _of_every_field(scene, geometry, dut1_s)
    limit = None
    if limit_from_noise:
        least = float(light.at(geometry)(*_field(camera)).min())
        limit = _limit(light, geometry, _noise(facts, scene, least)[1])
        light = replace(light, limit_g_mag=limit.g_mag)
    else:
        given = scene.stars.faintest_g_mag if scene.stars is not None else None
        light = replace(light, limit_g_mag=ALL_G_MAG if given is None else given)
    least = float(light.at(geometry)(*_field(camera)).min())
    tolerance = GRID_SHARE * _noise(facts, scene, least)[1] / t
    light, within = _over_exposures(light, geometry, tolerance, dut1_s)
    if light.moments > geometry.nodes:
        geometry = plan_geometry(scene, geometry.frame, dut1_s, light.moments)
    grid = refine(light.at(geometry), camera.rows, camera.columns, tolerance)
    knots, grids, between = _over_time(light, geometry, grid, tolerance, dut1_s)
    error = (grid.error + between + within) * t
    corners = light.at(geometry)(*_corners(camera))
    sigma = light_floor_e(_noise(facts, scene, float(grids.min()))[0], facts.flat)
    told = (
        *_parts_told(light, geometry),
        *_limit_told(limit, background_of(scene).starlight != "none", sigma),
        _grid_told(grid, between, error, sigma, tolerance, corners * t),
    )
    return SkyPlan(
        (camera.rows, camera.columns),
        knots,
        grids,
        float(grids.min()),
        error,
        limit.g_mag if limit else None,
        told,
        tuple(off_plane_remarks(scene, geometry)),
    )


def _of_every_field(scene: Scene, g: Geometry, dut1_s: float) -> Geometry:
    """The geometry with as many more frames as leave no field out, MOST_FIELDS at most: of more,
    some, and what lies between them is found as everything between frames is."""
    turning = turning_frames(scene, dut1_s)
    if len(turning) > MOST_FIELDS:
        turning = turning[np.linspace(0, len(turning) - 1, MOST_FIELDS).round().astype(int)]
    return with_frames(scene, g, turning, dut1_s)


def facts_with_sky(facts: Facts, scene: Scene, sky: SkyPlan) -> Facts:
    """The facts with the sky's darkest place as background: the least noise that a pixel has."""
    sigma, budget = _noise(facts, scene, sky.least_e_s)
    return replace(
        facts,
        background_e_s=sky.least_e_s,
        background_e=sky.least_e_s * integration_range_s(scene)[0],
        sigma_floor_e=sigma,
        budget_e=budget,
    )


def sky_grid(sky: SkyPlan, frame: int) -> Array:
    """Light (ny, nx) at the nodes of a frame, e-/s and pixel."""
    i = int(np.clip(np.searchsorted(sky.knots, frame, side="right") - 1, 0, len(sky.knots) - 1))
    if sky.knots[i] == frame or i + 1 == len(sky.knots):
        return sky.grids[i]
    share = (frame - sky.knots[i]) / (sky.knots[i + 1] - sky.knots[i])
    return (1.0 - share) * sky.grids[i] + share * sky.grids[i + 1]


def sky_tile(sky: SkyPlan, frame: int, tile: Tile) -> Array:
    """Light (rows, columns) in a tile of a frame, e-/s and pixel, before the flat.

    A pixel's value depends on the frame and its place alone.
    """
    corner, size = (tile.y0, tile.x0), (tile.rows, tile.columns)
    return tile_light(sky_grid(sky, frame), sky.shape, corner, size)


def _noise(facts: Facts, scene: Scene, sky_e_s: float) -> tuple[float, float]:
    """Noise of a pixel under a sky of this light [e-], and one approximation's budget there."""
    more = (sky_e_s - facts.background_e_s) * integration_range_s(scene)[0]
    if not scene.sensor.photon_noise:
        more = 0.0
    sigma = math.sqrt(max(facts.sigma_floor_e**2 + more, 0.0))
    return sigma, error_budget_e(scene, light_floor_e(sigma, facts.flat))


def _field(camera: Camera) -> tuple[Array, Array]:
    """Places on a 5 x 5 grid over the frame [px]."""
    x, y = np.meshgrid(
        np.linspace(-0.5, camera.columns - 0.5, 5), np.linspace(-0.5, camera.rows - 0.5, 5)
    )
    return x.ravel(), y.ravel()


def _corners(camera: Camera) -> tuple[Array, Array]:
    """The four corners of the frame [px]."""
    x, y = camera.columns - 0.5, camera.rows - 0.5
    return np.array([-0.5, x, -0.5, x]), np.array([-0.5, -0.5, y, y])


def _limit(light: LightOfSky, g: Geometry, budget_e: float) -> FaintLimit:
    """The limit that a budget allows, at the field's most crowded place."""
    scene, fit = light.scene, light.inputs.fit
    assert fit is not None
    u = np.concatenate(
        [light.directions(g, f, g.middle, *_field(light.camera)) for f in range(len(g.frame))]
    )
    squared = np.zeros(limits_g_mag().size)
    if light.inputs.undrawn is not None:
        found = [light.inputs.undrawn.fainter(m, u).g_squared.max() for m in limits_g_mag()]
        squared = np.array(found)
    peak = peak_share(light.facts.blur, light.camera, g, scene.star_effects["aberration"])
    zero = brightest_electrons(fit, light.facts.area_m2, integration_range_s(scene)[1])
    return faint_limit(squared, zero, peak, ifov_rad(light.camera) ** 2, budget_e)


def _over_exposures(
    light: LightOfSky, g: Geometry, tolerance: float, dut1_s: float
) -> tuple[LightOfSky, float]:
    """The light with as many moments as its mean over an exposure asks for, and what that errs by
    [e-/s and pixel], as found with more of them."""
    off = 0.0
    if light.even or not np.ptp(g.offset_s):
        return light, off
    some = np.unique(np.linspace(0, len(g.frame) - 1, MOST_EXPOSURES).round().astype(int))
    found = _means(light, g, some, dut1_s)
    for moments in MOMENTS:
        finer = replace(light, moments=moments)
        means = _means(finer, g, some, dut1_s)
        off = float(np.abs(means - found).max())
        if off <= tolerance and (off or moments > 3):  # 3 are taken anyway where cameras turn
            break
        light, found = finer, means
    return light, off


def _means(light: LightOfSky, g: Geometry, some: NDArray[np.int64], dut1_s: float) -> Array:
    """Means (frames, places) over the exposures of some frames of a geometry."""
    if light.moments > g.nodes:
        fine = plan_geometry(light.scene, g.frame[some], dut1_s, light.moments)
        return np.asarray(light.at(fine)(*_field(light.camera)))
    each = [light.at(g.frame_slice(int(k)))(*_field(light.camera)) for k in some]
    return np.concatenate(each)


def _over_time(
    light: LightOfSky, g: Geometry, grid: FrameGrid, tolerance: float, dut1_s: float
) -> tuple[NDArray[np.int64], Array, float]:
    """Knots of frames, their grids, and how far linear change between them was found to err.

    Knots are halved where the frame between two errs, until none does or there are MOST_KNOTS.
    """
    knots, grids = g.frame, grid.values
    ny, nx = grids.shape[-2:]
    error, settled, doubtful = 0.0, 0.0, np.diff(knots) > 1
    while doubtful.any():
        left, right = knots[:-1][doubtful], knots[1:][doubtful]
        middle = (left + right) // 2
        fresh = plan_geometry(light.scene, middle, dut1_s, light.moments)
        found = at_nodes(light.at(fresh), light.camera.rows, light.camera.columns, ny, nx)
        share = ((middle - left) / (right - left))[:, None, None]
        guess = (1.0 - share) * grids[:-1][doubtful] + share * grids[1:][doubtful]
        off = np.abs(found - guess).max(axis=(1, 2))
        bad = set(middle[off > tolerance].tolist())
        error = float(off.max())
        settled = max(settled, float(off[off <= tolerance].max(initial=0.0)))
        if not bad or len(knots) >= max(MOST_KNOTS, 2 * len(g.frame)) or grids.size > MOST_VALUES:
            break
        order = np.argsort(np.concatenate([knots, middle]), kind="stable")
        knots = np.concatenate([knots, middle])[order]
        grids = np.concatenate([grids, found])[order]
        near = np.isin(knots, list(bad))
        doubtful = (near[:-1] | near[1:]) & (np.diff(knots) > 1)
        error = 0.0
    return knots, grids, max(error, settled)


def _parts_told(light: LightOfSky, g: Geometry) -> list[Decision]:
    """What each part gives, and how well it is known."""
    x, y = _field(light.camera)
    frames, b, inputs = (0, len(g.frame) - 1), background_of(light.scene), light.inputs
    area = light.pixel_m2_sr(x, y)
    ends = [{k: v * area for k, v in light.parts(g, f, g.middle, x, y).items()} for f in frames]
    out = _published_told(light, ends)
    if inputs.uniform_e_s is not None:
        how = "the same in every pixel, as the scene gives it of a pixel: no solid angle, no pupil"
        out.append(Decision("background.uniform", True, f"{inputs.uniform_e_s:.4g} e-/s: {how}"))
    if inputs.stray is not None and b.stray_light is not None:
        from pipeline.plan.sky.stray_light import stray_told

        stray = [light.stray(g, f, g.middle, x, y) for f in frames]
        out += stray_told(b.stray_light, stray)
    if g.has_air:
        from pipeline.plan.sky.night import night_told

        out += night_told(light.scene, ends, inputs.night.gathered if inputs.night else 1.0)
    return out


def _published_told(light: LightOfSky, ends: list[dict[str, Array]]) -> list[Decision]:
    """Of parts that follow published tables and maps; ends : e-/s per pixel in some frames."""
    b, out = background_of(light.scene), []
    dim = "" if light.inputs.extinction is None else "; dimmed by the air (observer.atmosphere)"
    for name, how in _sources_of(light).items():
        if name in ends[0]:
            values = np.concatenate([e[name] for e in ends])
            span = f"{values.min():.4g} to {values.max():.4g} e-/s per pixel"
            how += dim if name != "uniform" else ""
            out.append(Decision(f"background.{name}", True, f"{span}: {how}"))
        elif name != "uniform" and (name != "starlight" or b.starlight == "none"):
            out.append(Decision(f"background.{name}", False, "not asked for"))
    return out


def _sources_of(light: LightOfSky) -> dict[str, str]:
    """Where what is known of each part comes from, and how well it is known."""
    inputs, stars = light.inputs, light.scene.stars
    known = {
        "uniform": "as bright in all directions; each pixel sees it through its own solid angle"
        + (" and the pupil's cosine" if light.scene.sensor.pupil_projection else ""),
        "zodiacal": "Leinert et al. 1998, table 17 (good to 10%; bilinear in the logarithm, 2%), "
        "the Sun's spectrum with their colour, R^-2.3 with distance from the Sun",
        "galactic": "a fraction of all starlight (Leinert et al. 1998), of the stars' own colour; "
        f"good to {RELATIVE_ERROR:.0%}; {inputs.every.source if inputs.every else ''}",
        "starlight": f"stars that are not drawn: {inputs.undrawn.source if inputs.undrawn else ''}",
    }
    if stars and len(stars.catalogues) > 1:
        known["starlight"] += "; of the main catalogue alone: stars that only the layers hold, and "
        known["starlight"] += "that are beyond the limit, are in no map and omitted"
    return known


def _limit_told(limit: FaintLimit | None, in_sky: bool, sigma_e: float) -> list[Decision]:
    if limit is None:
        return []
    bound = max(limit.star_e, limit.grain_e)
    if bound == 0.0:
        return [
            Decision("stars.faint", True, "all stars are drawn: none is below the noise's limit")
        ]
    return [
        Decision(
            "stars.faint",
            False,
            f"stars beyond G = {limit.g_mag:g} are not drawn one by one: each sends at most "
            f"{limit.star_e:.3g} e- into a pixel; all together they vary about their mean, which "
            f"{'the sky holds' if in_sky else 'is OMITTED'}, by {limit.grain_e:.3g} e- rms at the "
            "most crowded place",
            bound,
            bound / sigma_e,
        )
    ]


def _grid_told(
    grid: FrameGrid,
    between: float,
    error_e: float,
    sigma_e: float,
    tolerance: float,
    corners_e: Array,
) -> Decision:
    """How the grid was chosen, beside what the common rule of four corners would do."""
    mean = corners_e.mean(axis=1)
    spread = np.ptp(corners_e, axis=1) / np.where(mean > 0.0, mean, 1.0)
    off = float(np.abs(corners_e - mean[:, None]).max())
    corners = f"four corners differ by up to {spread.max():.2g} of their mean"
    if spread.max() < CORNERS_SPREAD:
        corners += f": that mean taken for the frame would err by {off:.3g} e- there"
    ny, nx = grid.values.shape[-2:]
    how = "uniform" if ny * nx == 1 else f"bilinear between {ny} x {nx} nodes"
    missed = "" if grid.met and between <= tolerance else "; the finest that is tried, above target"
    return Decision(
        "background.grid",
        True,
        f"{how}, linear between frames: measured half way between the nodes{missed}; {corners}",
        error_e,
        error_e / sigma_e,
    )
