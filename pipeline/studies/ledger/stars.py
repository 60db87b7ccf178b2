"""Probes of stars: effects on places and light, polar motion, faint ones, the Earth before them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from astropy.time import Time
from astropy.utils import iers

from pipeline.arrays import Array
from pipeline.execute.graph import read_shard
from pipeline.execute.sources import place_stars
from pipeline.inputs.band.response import gather_response
from pipeline.physics.constants import (
    ARCSEC_RAD,
    BOLTZMANN_J_K,
    DEG_RAD,
    PLANCK_J_S,
    SPEED_OF_LIGHT_M_S,
)
from pipeline.physics.positions.apparent import unaberrate
from pipeline.physics.positions.earth import site_state
from pipeline.physics.positions.focal_plane import deproject
from pipeline.physics.positions.limb import (
    finer,
    height_of_line_m,
    pole_at,
    visible_fraction,
)
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.plan.pointing.geometry import epochs_jyear, moments_at, plan_geometry
from pipeline.plan.pointing.occultation import stars_clear
from pipeline.resolve.stars import shards_of
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.store.cube import CubeWriter
from pipeline.studies.ledger.probe import Bench, ProbeResult, most, probe, stated, timed
from pipeline.studies.ledger.scenes import DEC_DEG, RA_DEG, SIDE, SITE, mean_e, scene
from pipeline.studies.scenes.stage import Stage, open_stage

EFFECTS = ("space_motion", "parallax", "aberration", "deflection")
COLD_K, HOT_K = 2500.0, 50_000.0
GRAZING, FINE_NODES = 2000, 1 + 8 * 256


@probe("stars.space_motion")
def effects(bench: Bench) -> Iterator[ProbeResult]:
    """How far stars of a small frame are displaced where an effect on directions is omitted."""
    stage = open_stage(scene({"stars": {"catalogue": bench.catalogue}}))
    years = float(np.abs(epochs_jyear(stage.g)[0] - stage.prepared.catalogues[0].ref_epoch_jyear))
    in_s, full = timed(lambda: _places(stage, None), 2)
    for name in EFFECTS:
        out_s, less = timed(lambda name=name: _places(stage, name), 2)  # type: ignore[misc]
        off = np.array([np.hypot(*(full[i] - p)) for i, p in less.items() if i in full])
        arcsec = most(off) * stage.plan.facts.ifov_rad / ARCSEC_RAD
        per = years if name == "space_motion" else 1.0
        bound, unit = stated(stage.plan, f"stars.{name}")
        yield ProbeResult(
            f"stars.{name}",
            f"{len(off)} stars, one like Barnard's, with and without",
            bound,
            arcsec / per,
            unit,
            out_s,
            in_s,
        )


def _places(stage: Stage, without: str | None) -> dict[int, Array]:
    """Places [px] of the frame's stars by their source_id; one effect omitted.

    What aberration does to all of the field alike goes with the boresight, which is guided.
    """
    prepared, plan = stage.prepared, stage.plan
    assert plan.scene.stars is not None
    if without is not None:
        stars = plan.scene.stars.model_copy(update={without: False})
        plan = replace(plan, scene=plan.scene.model_copy(update={"stars": stars}))
    inputs = prepared.inputs(CubeWriter("nowhere", ("dn",)), plan)
    g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
    found: dict[int, Array] = {}
    for shard in shards_of(plan, prepared.catalogues, g):
        epoch = prepared.catalogues[shard.catalogue].ref_epoch_jyear
        placed = place_stars(plan, read_shard(inputs, shard), g, epoch, shard.catalogue)
        pairs = np.stack([placed.x_px, placed.y_px], axis=1)
        found.update(zip(placed.source_id.tolist(), pairs, strict=True))
    return found


@probe("stars.doppler")
def doppler(bench: Bench) -> Iterator[ProbeResult]:
    """Electrons of black bodies that come towards a fast observer, by the band's own response."""
    speed = 3e5
    data = scene(
        {"stars": {"catalogue": bench.catalogue}, "observer.velocity_m_s": [0.0, 0.0, speed]}
    )
    parsed = parse_scene(data)
    plan, curve = prepare(parsed).plan, gather_response(parsed)[0]
    beta = speed / SPEED_OF_LIGHT_M_S
    factor = np.sqrt((1.0 + beta) / (1.0 - beta))
    at = np.linspace(curve.wavelength_m[0], curve.wavelength_m[-1], 4001)
    taken = np.interp(at, curve.wavelength_m, curve.value)

    def electrons(kelvin: float, d: float) -> float:
        x = PLANCK_J_S * SPEED_OF_LIGHT_M_S / (BOLTZMANN_J_K * kelvin * at * d)
        return float(np.trapezoid(taken * d**2 / (at * d) ** 4 / np.expm1(x), at))

    kelvins = np.geomspace(COLD_K, HOT_K, 30)
    out_s, rest = timed(lambda: [electrons(k, 1.0) for k in kelvins], 3)
    in_s, moved = timed(lambda: [electrons(k, factor) for k in kelvins], 3)
    bound, unit = stated(plan, "stars.doppler")
    off = most(np.array(moved) / np.array(rest) - 1.0)
    yield ProbeResult(
        "stars.doppler",
        f"an observer at {speed:g} m/s, black bodies of {COLD_K:g} to {HOT_K:g} K",
        bound,
        off,
        unit,
        out_s,
        in_s,
    )


@probe("shared_frames")
def standing(bench: Bench) -> Iterator[ProbeResult]:
    """Stars where they stand in the first of the frames that share them, and in the last."""
    data = scene(
        {
            "stars": {"catalogue": bench.catalogue},
            "observer": SITE,
            "exposure": {"integration_s": 0.2, "frames": 500, "cadence_s": 0.3},
        }
    )
    plan = open_stage(data).plan
    first, last = (open_stage(data, frame=k) for k in (0, plan.shared_frames - 1))
    in_s, a = timed(lambda: mean_e(first))
    _, b = timed(lambda: mean_e(last))
    bound, unit = stated(plan, "shared_frames")
    how = f"{len(first.stars)} stars over a site, {plan.shared_frames} frames after 0.3 s each"
    yield ProbeResult("shared_frames", how, bound, most(a - b), unit, 0.0, in_s)


@probe("precession_nutation")
def polar_motion(_: Bench) -> Iterator[ProbeResult]:
    """A site with the pole where the Earth-orientation tables have it, two weeks later."""
    table = iers.IERS_B.open()
    mjd = np.arange(41_700.0, 58_800.0, 14.0)
    x, y = (v.to_value("rad") for v in table.pm_xy(Time(mjd, format="mjd")))
    plan = prepare(
        parse_scene(
            scene(
                {
                    "observer": SITE,
                    "pointing": {"mode": "local", "azimuth_deg": 90.0, "elevation_deg": 60.0},
                    "stars": None,
                }
            )
        )
    ).plan
    at = instants(parse_utc("2019-12-01T08:00:00Z"), [0.0])
    args = SITE["longitude_deg"] * DEG_RAD, SITE["height_m"]
    lats = np.radians([-60.0, 20.7, 80.0])
    in_s, places = timed(
        lambda: np.array(
            [
                [site_state(lat, *args, at, a, b)[0][0] for a, b in zip(x, y, strict=True)]
                for lat in lats
            ]
        )
    )
    off = np.linalg.norm(np.diff(places, axis=1), axis=-1).max()
    bound, unit = stated(plan, "polar_motion")
    yield ProbeResult(
        "polar_motion",
        f"three sites, the pole of IERS B in {len(x)} fortnights since "
        "1973, and that of the one before",
        bound,
        float(off),
        unit,
        0.0,
        in_s / len(x),
    )


@probe("stars.faint")
def faint(bench: Bench) -> Iterator[ProbeResult]:
    """A frame without the stars beyond the limit that the noise sets, beside one of all stars."""
    sky = {"uniform_e_per_s": 4e5, "starlight": "all"}
    auto = scene(
        {
            "stars": {"catalogue": bench.catalogue, "faintest_g_mag": "auto"},
            "background": sky,
            "sensor.read_noise_e": 100.0,
            "sensor.aperture_m": 0.02,
        }
    )
    every = scene({"stars.faintest_g_mag": 21.0}, auto)
    few, many = open_stage(auto), open_stage(every)
    out_s, less = timed(lambda: mean_e(few), 2)
    in_s, all_of_them = timed(lambda: mean_e(many), 2)
    bound, unit = stated(few.plan, "stars.faint")
    assert few.plan.scene.stars is not None
    limit = few.plan.scene.stars.faintest_g_mag
    yield ProbeResult(
        "stars.faint",
        f"{len(many.stars) - len(few.stars)} stars beyond G = {limit:g} as "
        "smooth light, beside all stars drawn",
        bound,
        most(all_of_them - less),
        unit,
        out_s,
        in_s,
    )


@probe("earth_occultation")
def hidden(bench: Bench) -> Iterator[ProbeResult]:
    """Parts of the exposure in which stars at the limb are seen, beside many more moments."""
    middle = np.array(
        [
            np.cos(DEC_DEG * DEG_RAD) * np.cos(RA_DEG * DEG_RAD),
            np.cos(DEC_DEG * DEG_RAD) * np.sin(RA_DEG * DEG_RAD),
            np.sin(DEC_DEG * DEG_RAD),
        ]
    )
    across = np.cross(middle, [0.0, 0.0, 1.0])
    across /= np.sqrt(across @ across)
    radius = 4.2164e7
    limb = np.arcsin(6_378_137.0 / radius) + 0.0008
    place = -radius * (np.cos(limb) * middle + np.sin(limb) * across)
    speed = 3075.0 * np.cross(across, middle)  # along the limb: lines there graze it
    observer = {
        "kind": "orbit",
        "orbit": {"kind": "state", "position_m": place.tolist(), "velocity_m_s": speed.tolist()},
    }
    stage = open_stage(
        scene(
            {
                "observer": observer,
                "stars": {"catalogue": bench.catalogue},
                "exposure.integration_s": 400.0,
            }
        )
    )
    args = stage.plan.scene, stage.plan.camera, stage.g
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0.0, SIDE, (2, GRAZING))
    u = deproject(stage.plan.camera, stage.g.attitude[0, stage.g.middle], x, y)
    in_s, clear = timed(lambda: stars_clear(*args, u, y))
    exact = _seen_by_rays(stage, u)
    seen = visible_fraction(finer(clear))
    partly = int(((exact > 0.0) & (exact < 1.0)).sum())
    bound, unit = stated(stage.plan, "earth_occultation")
    yield ProbeResult(
        "earth_occultation",
        f"{partly} of {GRAZING} lines that a limb crosses in an "
        f"exposure of 400 s, beside {FINE_NODES} moments",
        bound,
        float(np.abs(seen - exact).max()),
        unit,
        0.0,
        in_s,
    )


def _seen_by_rays(stage: Stage, u: Array) -> Array:
    """Parts (n,) of the exposure in which proper directions (n, 3) miss the Earth, of many moments.

    The observer's geocentric velocity turns them by 2 arcsec at GEO.
    """
    p, g = stage.plan, stage.g
    times = np.linspace(g.offset_s[0, 0], g.offset_s[0, -1], FINE_NODES)
    at, pole = moments_at(p.scene, p.dut1_s, times), pole_at(parse_utc(p.scene.epoch))
    v = at.observer_m_s[FINE_NODES // 2] - at.earth.velocity_m_s[FINE_NODES // 2]
    still = unaberrate(u, v / SPEED_OF_LIGHT_M_S)
    return np.mean([height_of_line_m(place, still, pole) >= 0.0 for place in at.observer_m], axis=0)
