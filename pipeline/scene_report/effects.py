"""Components left out: what the frame lacks then, its bound, and the seconds that it saves."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.arrays import Array
from pipeline.execute.graph import Inputs, read_shard
from pipeline.execute.sources import place_stars
from pipeline.execute.tile import tile_light
from pipeline.physics.constants import ARCSEC_RAD, ASTRONOMICAL_UNIT_M, SPEED_OF_LIGHT_M_S
from pipeline.physics.noise.chain import Chain, StreamPlace, to_dn
from pipeline.physics.noise.streams import poisson_image
from pipeline.physics.positions.focal_plane import corner_radius
from pipeline.physics.vectors import separation
from pipeline.plan.geometry import epochs_jyear, plan_geometry
from pipeline.plan.tiles import Tile
from pipeline.run import shards_of
from pipeline.scene_report.stage import Stage, blocks_by
from pipeline.store.cube import CubeWriter

SIDE = 512
FASTEST_ARCSEC_YR, NEAREST_ARCSEC = 10.4, 0.77  # Barnard's star, Proxima
SUN_DEFLECTION_ARCSEC = 4.07e-3  # 2 G M / (c^2 au): at 90 degrees from the Sun
LARGE_MEAN_E, POISSON_BOUND = 1e8, 7e-6
Record = dict[str, Any]


def measure_effects(stage: Stage) -> list[Record]:
    """A record for each component that can be left out: error, bound, unit, seconds."""
    return [*_star_effects(stage), _sections(stage), _neutral_terms(), _poisson()]


def _record(
    component: str, error: float, bound: float, unit: str, seconds: tuple[float, float]
) -> Record:
    """seconds : of CPU, without the component (or with its approximation), and with it."""
    return {
        "component": component, "error": error, "bound": bound, "unit": unit,
        "seconds_on": seconds[0], "seconds_off": seconds[1], "holds": error <= bound,
    }  # fmt: skip


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """CPU seconds of the quickest of three, and the result."""
    best, out = np.inf, None
    for _ in range(3):
        began = time.process_time()
        out = work()
        best = min(best, time.process_time() - began)
    return best, out


def _star_effects(stage: Stage) -> Iterator[Record]:
    """How far stars of the frame are displaced where an effect on directions is left out."""
    scene, g = stage.plan.scene, stage.g
    if scene.stars is None:
        return
    sun = g.sun_m[0, g.middle] - g.observer_m[0, g.middle]
    speed = float(np.linalg.norm(g.observer_m_s[0, g.middle]))
    field = 2.0 * corner_radius(stage.plan.camera)
    from_sun = float(separation(g.attitude[0, g.middle, 2], sun / np.linalg.norm(sun)))
    years = float(np.abs(epochs_jyear(g)[0] - stage.prepared.catalogues[0].ref_epoch_jyear))
    distance = float(np.linalg.norm(g.observer_m[0, g.middle])) / ASTRONOMICAL_UNIT_M
    bounds = {
        "space_motion": FASTEST_ARCSEC_YR * years, "parallax": NEAREST_ARCSEC * distance,
        "aberration": 2.0 * speed / SPEED_OF_LIGHT_M_S * field / ARCSEC_RAD,
        "deflection": SUN_DEFLECTION_ARCSEC / np.tan(0.5 * max(from_sun - field, 1e-3)) / distance,
    }  # fmt: skip
    full_s, full = _timed(lambda: _places(stage, None))
    for name, bound in bounds.items():
        less_s, less = _timed(lambda name=name: _places(stage, name))  # type: ignore[misc]
        off = np.array([np.hypot(*(full[i] - p)) for i, p in less.items() if i in full])
        arcsec = float(off.max(initial=0.0)) * stage.plan.facts.ifov_rad / ARCSEC_RAD
        yield _record(f"stars.{name}", arcsec, float(bound), "arcsec", (less_s, full_s))


def _places(stage: Stage, without: str | None) -> dict[int, Array]:
    """Places [px] of the frame's stars by their source_id; one effect left out.

    What aberration does to all of the field alike goes with the boresight, which is guided.
    """
    prepared, plan = stage.prepared, stage.plan
    assert plan.scene.stars is not None
    if without is not None:
        stars = plan.scene.stars.model_copy(update={without: False})
        plan = replace(plan, scene=plan.scene.model_copy(update={"stars": stars}))
    writer = CubeWriter("nowhere", ("dn",))
    inputs = Inputs(plan, prepared.maps, prepared.catalogues, prepared.left_out, writer)
    g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
    found: dict[int, Array] = {}
    for shard in shards_of(plan, prepared.catalogues, g):
        epoch = prepared.catalogues[shard.catalogue].ref_epoch_jyear
        placed = place_stars(plan, read_shard(inputs, shard), g, epoch, shard.catalogue)
        pairs = np.stack([placed.x_px, placed.y_px], axis=1)
        found.update(zip(placed.source_id.tolist(), pairs, strict=True))
    return found


def _sections(stage: Stage) -> Record:
    """The stars' light of a scene that has only stars, beside the same among everything else."""
    rows, columns = (min(SIDE, n) for n in stage.plan.scene.sensor.shape)
    tile = Tile(0, 0, 0, 0, rows, columns)
    blocks = blocks_by(stage, stage.plan)(tile)

    def light(which: tuple[str, ...]) -> Array:
        drawn = tile_light(stage.plan, stage.g, tile, [stage.stars], blocks, which)
        return drawn["stars_e"]

    whole_s, whole = _timed(lambda: light(("stars", "targets", "sky")))
    alone_s, alone = _timed(lambda: light(("stars",)))
    return _record("stars", float(np.abs(whole - alone).max()), 0.0, "e-", (alone_s, whole_s))


def _neutral_terms() -> Record:
    """Digital numbers of a chain of numbers, and of one with images of neutral values."""
    rng = np.random.default_rng(2)
    mean = rng.uniform(10.0, 1e4, (SIDE, SIDE))
    ones, none = np.ones((SIDE, SIDE)), np.zeros((SIDE, SIDE))
    place = StreamPlace(0, 0, 0, (1, 2), (3, 4))
    plain = Chain(1.0, 0.0, None, 5.0, 1.5, 0.0, 32)
    full = Chain(ones, none, 1e300, 5.0 * ones, 1.5 * ones, none, 32, bad=(
        np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64)))  # fmt: skip
    plain_s, a = _timed(lambda: to_dn(mean * plain.flat + plain.dark_e, plain, place))
    full_s, b = _timed(lambda: to_dn(mean * full.flat + full.dark_e, full, place))
    off = float(np.abs(a.astype(float) - b.astype(float)).max())
    return _record("flat", off, 0.0, "DN", (plain_s, full_s))


def _poisson() -> Record:
    """The rounded Gaussian for a Poisson number of a mean of 1e8: their distribution functions."""
    from scipy.stats import norm, poisson

    sigma = np.sqrt(LARGE_MEAN_E)
    k = np.round(LARGE_MEAN_E + sigma * np.linspace(-6.0, 6.0, 4001))
    off = np.abs(poisson.cdf(k, LARGE_MEAN_E) - norm.cdf((k + 0.5 - LARGE_MEAN_E) / sigma))
    mean = np.full((SIDE, SIDE), 2.0 * LARGE_MEAN_E)
    ours_s, _ = _timed(lambda: poisson_image(mean, 0, 0, 0, 1, 2))
    rng = np.random.default_rng(3)
    exact_s, _ = _timed(lambda: rng.poisson(mean))
    unit = "of the distribution function"
    return _record("gaussian_for_poisson", float(off.max()), POISSON_BOUND, unit, (ours_s, exact_s))
