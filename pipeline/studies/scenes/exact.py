"""What the pixels of small windows hold when nothing is approximated: the judge of the report."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import Array, FrameStars
from pipeline.errors import NightglassError
from pipeline.execute.check import WINDOW_PX, reference
from pipeline.execute.sources import place_targets, streaks
from pipeline.execute.tables import table_of
from pipeline.inputs.band.response import gather_response
from pipeline.inputs.sky.sky import gather_sky
from pipeline.plan.plan import Plan
from pipeline.plan.response.streaks import exact_path
from pipeline.plan.sky.light import ALL_G_MAG, LightOfSky
from pipeline.plan.tiles import Tile
from pipeline.studies.scenes.stage import Stage, mean_of, noise_of

OWN_PATHS = 400  # of the brightest stars that pass a window: all, but in the densest fields
MOST_S = 60.0
SEED = 5
BELOW = 3  # sources just below each limit: how much one errs is up to its sub-pixel place


@dataclass(frozen=True, eq=False)
class Exact:
    """Windows, and what belongs in them.

    windows : parts of the frame; mean_e, noise_e : of their pixels, each (rows, columns)
    sources : drawn one by one for them
    """

    windows: tuple[Tile, ...]
    mean_e: tuple[Array, ...]
    noise_e: tuple[Array, ...]
    sources: int

    def save(self, path: Path) -> None:
        """Write it where another process reads it."""
        place = np.array([(w.y0, w.x0, w.rows, w.columns) for w in self.windows])
        parts: dict[str, np.ndarray] = {f"mean{i}": m for i, m in enumerate(self.mean_e)}
        parts |= {f"noise{i}": n for i, n in enumerate(self.noise_e)}
        parts |= {"windows": place, "sources": np.array(self.sources)}
        np.savez(path, **parts)  # type: ignore[arg-type]


def load_exact(path: Path) -> Exact:
    """What `Exact.save` wrote."""
    with np.load(path) as held:
        windows = tuple(Tile(0, 0, *(int(v) for v in row)) for row in held["windows"])
        each = range(len(windows))
        mean = tuple(held[f"mean{i}"] for i in each)
        return Exact(windows, mean, tuple(held[f"noise{i}"] for i in each), int(held["sources"]))


def find_exact(
    stage: Stage, tiles: tuple[Tile, ...], count: int, levels: Iterable[Stage] = ()
) -> Exact:
    """Windows in some tiles of the frame, and what belongs in them.

    count : of windows wherever the scene is bright, and by chance; levels : the scene as it is to
    be judged, whose windows are where each errs most
    """
    sky = exact_sky(stage)
    kept, means, noises, sources = [], [], [], 0
    chosen = [*choose_windows(stage, tiles, count)]
    for level in levels:
        chosen += windows_of_limits(level, tiles)
    for window in dict.fromkeys(chosen):
        image, drawn = reference(stage.plan, stage.g, window, stage.stars, OWN_PATHS, MOST_S)
        if image is None:  # too many sources for it
            continue
        mean = mean_of(stage, {"background_e": sky(window), "sources_e": image}, window)
        kept.append(window)
        means.append(mean)
        noises.append(noise_of(stage, mean, window))
        sources += drawn
    if not kept:
        raise NightglassError(f"{stage.plan.scene.name}: too many sources for the reference path")
    return Exact(tuple(kept), tuple(means), tuple(noises), sources)


def choose_windows(stage: Stage, tiles: tuple[Tile, ...], count: int) -> tuple[Tile, ...]:
    """Windows around the brightest stars and targets, at an end of a streak, and at random."""
    rng = np.random.default_rng(SEED)
    inside = [_within(tiles, x, y) for x, y in _bright_places(stage)]
    found = [w for w in inside if w is not None][: max(1, 2 * count // 3)]
    while len(found) < count:
        tile = tiles[int(rng.integers(len(tiles)))]
        x = tile.x0 + rng.uniform(0, tile.columns)
        y = tile.y0 + rng.uniform(0, tile.rows)
        window = _within(tiles, x, y)
        if window is not None:
            found.append(window)
    return tuple(dict.fromkeys(found))


def windows_of_limits(stage: Stage, tiles: tuple[Tile, ...]) -> list[Tile]:
    """Windows where sources err most: those that are just faint enough for a way of drawing.

    On the brightest stars below each limit of light, and where their cores end; likewise targets,
    and those that err most by being points.
    """
    s = stage.stars
    places = _below(_star_limits(stage), s.x_px, s.y_px, s.light_e, tiles)
    targets, classes = place_targets(stage.plan, stage.g), stage.plan.responses.classes
    sizes = [t.radius_px if t.body is None else 0.0 for t in targets]
    x, y, light_e = np.array([(t.x_px, t.y_px, t.light_e) for t in targets]).reshape(-1, 3).T
    limits = [(core.target_e, core.radius_px) for core in classes]
    limits += [(math.inf, core.radius_px) for core in classes[-1:]]  # which draws bodies above it
    places += _below(limits, x, y, light_e, tiles)
    places += _below([(math.inf, 0.0)], x, y, light_e * np.square(sizes), tiles)
    found = (_within(tiles, *place) for place in places)
    return [w for w in found if w is not None]


def _star_limits(stage: Stage) -> list[tuple[float, float]]:
    """Light [e-] above which stars are drawn more finely, and how far off that shows [px]."""
    plan, limits = stage.plan, []
    r, paths = plan.responses, streaks(plan, stage.g) if len(stage.stars) else []
    for core in r.classes:
        limits.append((core.brightest_e, core.radius_px))
        if core.phases and paths:
            table = table_of(r.blur, core.radius_px, paths[0].pieces[0].path, core.phases)
            limits += [(r.budget_e / e, 0.0) for e in (table.linear_error, table.cubic_error)]
    return [*limits, (paths[len(paths) // 2].own_from_e, 0.0)] if paths else limits


def _below(
    limits: list[tuple[float, float]],
    x_px: Array,
    y_px: Array,
    light_e: Array,
    tiles: tuple[Tile, ...],
) -> list[tuple[float, float]]:
    """Places of the brightest sources in some tiles below each limit, and so far beside them."""
    inside = np.zeros(len(x_px), bool)
    for t in tiles:
        across = (x_px >= t.x0) & (x_px < t.x0 + t.columns - 1)
        inside |= across & (y_px >= t.y0) & (y_px < t.y0 + t.rows - 1)
    out: list[tuple[float, float]] = []
    for limit_e, beside_px in limits:
        below = np.flatnonzero(inside & (light_e > 0.0) & (light_e <= limit_e))
        for at in below[np.argsort(-light_e[below], kind="stable")][:BELOW]:
            x, y = float(x_px[at]), float(y_px[at])
            out += [(x, y), (x + beside_px, y)]
    return out


def _bright_places(stage: Stage) -> list[tuple[float, float]]:
    """Places of the brightest sources (x, y): middles, and where the first star's streak ends."""
    s, plan = stage.stars, stage.plan
    order = [int(i) for i in np.argsort(-s.light_e, kind="stable") if _on(plan, s, int(i))][:4]
    stars = [(float(s.x_px[i]), float(s.y_px[i])) for i in order]
    if stars:
        aberration = plan.scene.star_effects["aberration"]
        path = exact_path(plan.camera, stage.g, *stars[0], aberration)
        end = stars[0][0] + float(path.x_px[-1]), stars[0][1] + float(path.y_px[-1])
        stars.insert(1, end)
    targets = sorted(place_targets(plan, stage.g), key=lambda t: -t.light_e)
    shown = [(t.x_px, t.y_px) for t in targets[:2]] + [(t.x_px, t.y_px) for t in targets[-1:]]
    return [p for pair in zip(stars, shown, strict=False) for p in pair] + (
        stars[len(shown) :] + shown[len(stars) :]
    )


def _on(plan: Plan, stars: FrameStars, i: int) -> bool:
    """Whether a star stands on the frame at mid-exposure."""
    x, y = float(stars.x_px[i]), float(stars.y_px[i])
    return 0.0 <= x < plan.camera.columns - 1 and 0.0 <= y < plan.camera.rows - 1


def _within(tiles: tuple[Tile, ...], x_px: float, y_px: float) -> Tile | None:
    """A window about a place, wholly in one of the tiles; None where the place is in none."""
    for t in tiles:
        if t.y0 - 0.5 <= y_px < t.y0 + t.rows - 0.5 and t.x0 - 0.5 <= x_px < t.x0 + t.columns - 0.5:
            rows, columns = min(WINDOW_PX, t.rows), min(WINDOW_PX, t.columns)
            y0 = int(np.clip(int(y_px) - rows // 2, t.y0, t.y0 + t.rows - rows))
            x0 = int(np.clip(int(x_px) - columns // 2, t.x0, t.x0 + t.columns - columns))
            return Tile(0, 0, y0, x0, rows, columns)
    return None


def exact_sky(stage: Stage) -> Callable[[Tile], Array]:
    """The sky's light [e-] in a tile's pixels, each at its own place: a function of the tile."""
    plan, light = stage.plan, None
    seconds = plan.integration_s(0)
    if plan.sky is not None:
        light = sky_light(stage)

    def sky(tile: Tile) -> Array:
        y, x = np.mgrid[tile.y0 : tile.y0 + tile.rows, tile.x0 : tile.x0 + tile.columns]
        if light is not None:
            rate = light.at(stage.g)(x.ravel().astype(float), y.ravel().astype(float))[0]
            return np.asarray(rate.reshape(x.shape) * seconds)
        return np.zeros(x.shape)

    return sky


def sky_light(stage: Stage) -> LightOfSky:
    """The light that the plan's grids are made from, as a function of place."""
    scene, plan = stage.plan.scene, stage.plan
    response, band, digest = gather_response(scene)
    catalogues, colour = stage.prepared.catalogues, plan.colour
    inputs = gather_sky(scene, response, band, digest, catalogues, colour, False, plan.extinction)
    given = scene.stars.faintest_g_mag if scene.stars is not None else None
    limit = ALL_G_MAG if given is None else given
    return LightOfSky(scene, plan.camera, plan.facts, inputs, limit, plan.dut1_s)
