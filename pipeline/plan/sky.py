"""The sky of a scene: its light on a small grid for each frame, and the stars left to it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.errors import BadInput
from pipeline.physics.colour import ColourFit
from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, DEG_RAD, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.apparent import unaberrate
from pipeline.physics.positions.focal_plane import Camera, deproject, ifov_rad
from pipeline.physics.sky import zodiacal as z
from pipeline.physics.sky.galactic import RELATIVE_ERROR, diffuse_light
from pipeline.physics.sky.grid import FrameGrid, at_nodes, refine, tile_light
from pipeline.physics.sky.starlight import band_light
from pipeline.plan.decisions import Decision
from pipeline.plan.facts import APPROXIMATIONS, Facts
from pipeline.plan.faint_stars import (
    FaintLimit,
    faint_limit,
    limits_g_mag,
    peak_share,
    zero_electrons,
)
from pipeline.plan.geometry import plan_geometry
from pipeline.plan.tiles import Tile
from pipeline.plan.timing import integration_range_s
from pipeline.spec.background import Background, Galactic, Zodiacal
from pipeline.spec.scene import Scene

Array = NDArray[np.float64]

GRID_SHARE = 0.125  # of one approximation's budget: the grid in a frame, and between frames
MOST_KNOTS = 1025
MOST_VALUES = 4_000_000
ALL_G_MAG = -99.0  # brighter than any star
MOVED = 1e-5  # radians by which a boresight turns in an exposure before its ends are looked at too


class LightLike(Protocol):
    """Summed light of stars per sr, as `catalog_tools.starlight.Light`."""

    @property
    def g(self) -> Array: ...
    @property
    def g_colour(self) -> Array: ...
    @property
    def g_colour_squared(self) -> Array: ...
    @property
    def g_without_colour(self) -> Array: ...
    @property
    def g_squared(self) -> Array: ...
    @property
    def g_error(self) -> Array: ...


class StarlightLike(Protocol):
    """A source of the summed light of stars beyond a magnitude."""

    @property
    def source(self) -> str: ...
    def fainter(self, limit_g_mag: float, directions: Array) -> LightLike: ...


@dataclass(frozen=True, eq=False)
class SkyInputs:
    """What was read for the sky; None for a part that the scene does not ask for.

    zodiacal_rates : of `physics.sky.zodiacal.band_rates`
    undrawn : stars that are left to the sky; every : all stars of the sky, for the Galaxy's dust
    """

    zodiacal: z.ZodiacalTable | None = None
    zodiacal_rates: tuple[float, float] = (0.0, 0.0)
    undrawn: StarlightLike | None = None
    every: StarlightLike | None = None
    fit: ColourFit | None = None


@dataclass(frozen=True, eq=False)
class SkyPlan:
    """Light of the sky in every frame, the uniform part included.

    knots : (k,) frames, ascending; grids : (k, ny, nx) e-/s and pixel at nodes over the frame (see
        `physics.sky.grid`), linear between knots
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

    geometry : of `sampled_frames`; facts : of the uniform background alone. The limit rests on the
    noise of the darkest place of the sky without the undrawn stars. Raises BadInput for a field too
    near the Sun, and an observer where the zodiacal light's distance law was not measured.
    """
    t = integration_range_s(scene)[1]
    light = _Light(scene, camera, facts, inputs, None)
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
    grid = refine(light.at(geometry), camera.rows, camera.columns, tolerance)
    knots, grids, between = _over_time(light, geometry, grid, tolerance, dut1_s)
    error = (grid.error + between) * t
    sigma = _noise(facts, scene, float(grids.min()))[0]
    told = (
        *_parts_told(light, geometry),
        *_limit_told(limit, _background(scene).starlight != "none", sigma),
        _grid_told(grid, between, error, sigma, tolerance),
    )
    return SkyPlan(
        (camera.rows, camera.columns), knots, grids, float(grids.min()), error,
        limit.g_mag if limit else None, told,
    )  # fmt: skip


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


@dataclass(frozen=True)
class _Light:
    """The light of a sky as a function of place: what the grids are made from.

    limit_g_mag : stars beyond it are left to the sky; None while that is not known: no star is
    """

    scene: Scene
    camera: Camera
    facts: Facts
    inputs: SkyInputs
    limit_g_mag: float | None

    def at(self, g: Geometry) -> Callable[[Array, Array], Array]:
        """Light (F, n) [e-/s and pixel] of the frames of a geometry, at x, y (n,) [px]."""
        return lambda x, y: np.stack([self._frame(g, f, x, y) for f in range(len(g.frame))])

    def _frame(self, g: Geometry, f: int, x: Array, y: Array) -> Array:
        """The mean over an exposure: Simpson's rule over its start, middle and end."""
        turned = np.abs(g.attitude[f, 0, 2] - g.attitude[f, -1, 2]).max()
        nodes = {g.middle: 1.0}
        if turned > MOVED:
            nodes = {0: 1.0 / 6.0, g.middle: 4.0 / 6.0, g.nodes - 1: 1.0 / 6.0}
        total = sum(w * sum(self.parts(g, f, k, x, y).values()) for k, w in nodes.items())
        return total * self._pixel_m2_sr(x, y) + self.facts.background_e_s

    def parts(self, g: Geometry, f: int, node: int, x: Array, y: Array) -> dict[str, Array]:
        """Each part's electrons/s per m2 of pupil and sr (n,)."""
        u = self.directions(g, f, node, x, y)
        out = {"none": np.zeros(len(u))}
        if self.inputs.zodiacal is not None:
            out["zodiacal"] = self._zodiacal(u, g.sun_m[f, node] - g.observer_m[f, node])
        galactic = _background(self.scene).galactic
        if self.inputs.every is not None and isinstance(galactic, Galactic):
            stars = self._stars(self.inputs.every, ALL_G_MAG, u)
            out["galactic"] = diffuse_light(stars, galactic.share)
        undrawn, limit = self.inputs.undrawn, self.limit_g_mag
        wanted = _background(self.scene).starlight != "none"
        if wanted and undrawn is not None and limit is not None:
            out["starlight"] = self._stars(undrawn, limit, u)
        return out

    def directions(self, g: Geometry, f: int, node: int, x: Array, y: Array) -> Array:
        """Unit vectors (n, 3) of the sky before aberration."""
        seen = deproject(self.camera, g.attitude[f, node], x, y)
        if not self.scene.star_effects["aberration"]:
            return seen
        return unaberrate(seen, g.observer_m_s[f, node] / SPEED_OF_LIGHT_M_S)

    def _zodiacal(self, u: Array, sun_m: Array) -> Array:
        assert self.inputs.zodiacal is not None
        distance = float(np.sqrt(sun_m @ sun_m)) / ASTRONOMICAL_UNIT_M
        if not z.LEAST_AU <= distance <= z.MOST_AU:
            raise BadInput(
                "observer", f"{distance:.3g} au from the Sun",
                f"{z.LEAST_AU:g} to {z.MOST_AU:g} au for zodiacal light, whose fall with distance "
                "is known there (or leave background.zodiacal out)",
            )  # fmt: skip
        lon, lat, elongation = z.sun_coordinates(u, sun_m)
        _check_elongation(float(elongation.min()), _background(self.scene).zodiacal)
        radiance = z.radiance_500(self.inputs.zodiacal, lon, lat) * z.distance_factor(distance)
        return z.band_radiance(radiance, elongation, self.inputs.zodiacal_rates)

    def _stars(self, source: StarlightLike, limit_g_mag: float, u: Array) -> Array:
        assert self.inputs.fit is not None
        found = source.fainter(limit_g_mag, u)
        moments = (found.g, found.g_colour, found.g_colour_squared)
        return band_light(moments, found.g_without_colour, self.inputs.fit)

    def _pixel_m2_sr(self, x: Array, y: Array) -> Array:
        """Pupil area times the solid angle that a pixel at x, y (n,) collects from."""
        x0, y0 = self.camera.centre_px
        u, v = x - x0, y - y0
        jacobian = np.ones(len(u))
        if self.camera.distortion is not None:
            from pipeline.physics.positions.distortion import scale_matrices, to_plane

            jacobian = np.linalg.det(scale_matrices(self.camera.distortion, u, v))
            u, v = to_plane(self.camera.distortion, u, v)
        tangent = np.hypot(u, v) * ifov_rad(self.camera)
        solid = ifov_rad(self.camera) ** 2 * jacobian / (1.0 + tangent**2) ** 1.5
        return self.facts.area_m2 * self.scene.sensor.fill_factor * solid


def _background(scene: Scene) -> Background:
    return scene.background or Background(starlight="auto")


def _check_elongation(least_rad: float, wish: Zodiacal | bool | None) -> None:
    extrapolate = isinstance(wish, Zodiacal) and wish.near_sun == "extrapolate"
    end = z.NEAREST_RAD if extrapolate else z.TABLE_ENDS_RAD
    if least_rad < end:
        hint = "" if extrapolate else "; near_sun: extrapolate goes to 2"
        raise BadInput(
            "background.zodiacal", f"{least_rad / DEG_RAD:.3g} deg from the Sun in the field",
            f"{end / DEG_RAD:.0f} degrees or more{hint}",
        )  # fmt: skip


def _noise(facts: Facts, scene: Scene, sky_e_s: float) -> tuple[float, float]:
    """Noise of a pixel under a sky of this light [e-], and one approximation's budget there."""
    more = (sky_e_s - facts.background_e_s) * integration_range_s(scene)[0]
    sigma = math.sqrt(facts.sigma_floor_e**2 + max(more, 0.0))
    return sigma, scene.accuracy.noise_fraction * sigma / APPROXIMATIONS


def _field(camera: Camera) -> tuple[Array, Array]:
    """Places on a 5 x 5 grid over the frame [px]."""
    x, y = np.meshgrid(
        np.linspace(-0.5, camera.columns - 0.5, 5), np.linspace(-0.5, camera.rows - 0.5, 5)
    )
    return x.ravel(), y.ravel()


def _limit(light: _Light, g: Geometry, budget_e: float) -> FaintLimit:
    """The limit that a budget allows, at the field's most crowded place."""
    scene, fit = light.scene, light.inputs.fit
    assert fit is not None
    u = np.concatenate([
        light.directions(g, f, g.middle, *_field(light.camera)) for f in range(len(g.frame))
    ])  # fmt: skip
    squared = np.zeros(limits_g_mag().size)
    if light.inputs.undrawn is not None:
        found = [light.inputs.undrawn.fainter(m, u).g_squared.max() for m in limits_g_mag()]
        squared = np.array(found)
    peak = peak_share(light.facts.blur, light.camera, g, scene.star_effects["aberration"])
    zero = zero_electrons(fit, light.facts.area_m2, integration_range_s(scene)[1])
    return faint_limit(squared, zero, peak, ifov_rad(light.camera) ** 2, budget_e)


def _over_time(
    light: _Light, g: Geometry, grid: FrameGrid, tolerance: float, dut1_s: float
) -> tuple[NDArray[np.int64], Array, float]:
    """Knots of frames, their grids, and how far linear change between them was found to err.

    Knots are halved where the frame between two errs, until none does or there are MOST_KNOTS.
    """
    knots, grids = g.frame, grid.values
    ny, nx = grids.shape[-2:]
    error, doubtful = 0.0, np.diff(knots) > 1
    while doubtful.any():
        left, right = knots[:-1][doubtful], knots[1:][doubtful]
        middle = (left + right) // 2
        fresh = plan_geometry(light.scene, middle, dut1_s)
        found = at_nodes(light.at(fresh), light.camera.rows, light.camera.columns, ny, nx)
        share = ((middle - left) / (right - left))[:, None, None]
        guess = (1.0 - share) * grids[:-1][doubtful] + share * grids[1:][doubtful]
        off = np.abs(found - guess).max(axis=(1, 2))
        bad = set(middle[off > tolerance].tolist())
        error = float(off.max())
        if not bad or len(knots) >= MOST_KNOTS or grids.size > MOST_VALUES:
            break
        order = np.argsort(np.concatenate([knots, middle]), kind="stable")
        knots = np.concatenate([knots, middle])[order]
        grids = np.concatenate([grids, found])[order]
        near = np.isin(knots, list(bad))
        doubtful = (near[:-1] | near[1:]) & (np.diff(knots) > 1)
        error = 0.0
    return knots, grids, error


def _parts_told(light: _Light, g: Geometry) -> list[Decision]:
    """What each part gives, and how well it is known."""
    x, y = _field(light.camera)
    ends = [light.parts(g, f, g.middle, x, y) for f in (0, len(g.frame) - 1)]
    area = light._pixel_m2_sr(x, y)
    b, inputs, out = _background(light.scene), light.inputs, []
    known = {
        "zodiacal": "Leinert et al. 1998, table 17 (good to 10%; bilinear in the logarithm, 2%), "
        "the Sun's spectrum with their colour, R^-2.3 with distance from the Sun",
        "galactic": "a share of all starlight (Leinert et al. 1998), of the stars' own colour; "
        f"good to {RELATIVE_ERROR:.0%}; {inputs.every.source if inputs.every else ''}",
        "starlight": f"stars that are not drawn: {inputs.undrawn.source if inputs.undrawn else ''}",
    }
    for name, how in known.items():
        if name in ends[0]:
            values = np.concatenate([e[name] * area for e in ends])
            span = f"{values.min():.4g} to {values.max():.4g} e-/s per pixel"
            out.append(Decision(f"background.{name}", True, f"{span}: {how}"))
        elif name != "starlight" or b.starlight == "none":
            out.append(Decision(f"background.{name}", False, "not asked for", 0.0, 0.0))
    return out


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
            "stars.faint", False,
            f"stars beyond G = {limit.g_mag:g} are not drawn one by one: each sends at most "
            f"{limit.star_e:.3g} e- into a pixel; all together they stray from their mean, which "
            f"{'the sky holds' if in_sky else 'is LEFT OUT'}, by {limit.grain_e:.3g} e- rms at the "
            "most crowded place",
            bound, bound / sigma_e,
        )
    ]  # fmt: skip


def _grid_told(
    grid: FrameGrid, between: float, error_e: float, sigma_e: float, tolerance: float
) -> Decision:
    ny, nx = grid.values.shape[-2:]
    how = "uniform" if ny * nx == 1 else f"bilinear between {ny} x {nx} nodes"
    missed = "" if grid.met and between <= tolerance else "; the finest that is tried, above target"
    return Decision(
        "background.grid", True,
        f"{how}, linear between frames: measured half way between the nodes{missed}",
        error_e, error_e / sigma_e,
    )  # fmt: skip
