"""Probes of targets: discs, shadow, earthshine, orbits, light between moments, populations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from pipeline.arrays import Array
from pipeline.physics.constants import (
    EARTH_EQUATORIAL_RADIUS_M,
    EARTH_FLATTENING,
    EARTH_GM_M3_S2,
    SUN_RADIUS_M,
)
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.targets.shadow import sunlit_past_earth
from pipeline.physics.vectors import unit as normal
from pipeline.plan.bodies.orbits import orbit_states
from pipeline.plan.pointing.geometry import _geometry, plan_geometry
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.studies.ledger.probe import Bench, ProbeResult, most, probe, stated, timed
from pipeline.studies.ledger.scenes import ORBIT, SPHERE, before, mean_e, scene
from pipeline.studies.scenes.stage import open_stage
from pipeline.studies.selftest.many import screened

J2 = 1.0826267e-3
GEO_M, GEO_M_S = [4407338.1, -41933021.2, 0.0], [3057.8229, 321.3901, 0.0]
TOWARDS = [-2724520.7, -41120448.5, 0.0]  # of the geostationary body, from ORBIT
FRAME = np.zeros(1, np.int64)


def followed(*targets: dict, **changes: object) -> dict:
    """A scene that follows the first of some targets from ORBIT."""
    return scene(
        {
            "observer": ORBIT,
            "epoch": "2019-05-12T09:00:00Z",
            "pointing": {"mode": "target", "target": targets[0]["name"]},
            "targets": list(targets),
        }
        | changes
    )


@probe("targets.point_sources")
def sizes(_: Bench) -> Iterator[ProbeResult]:
    """Spheres drawn as points beside the same with their discs; a plate beside its own mesh."""
    sizes_m = np.geomspace(0.02, 2.0, 24)
    side = normal(np.cross(TOWARDS, [0.0, 0.0, 1.0])) * np.sqrt(np.sum(np.square(TOWARDS)))
    step = 5.0 * 4.5e-5  # five pixels
    balls = [
        before(
            TOWARDS + (k % 5 - 2) * step * side + (k // 5 - 2) * step * np.array([0, 0, 4.1e7]),
            5e3,
            f"b{k}",
            body=SPHERE | {"diameter_m": float(d), "albedo": 0.02},
        )
        for k, d in enumerate(sizes_m)
    ]
    balls.insert(0, before(TOWARDS, 3e4, "a", body=SPHERE | {"diameter_m": 1e-3}))
    stage = open_stage(followed(*balls, **{"exposure.integration_s": 1e-4}))
    discs = replace(stage.plan, responses=replace(stage.plan.responses, budget_e=0.0))
    out_s, points = timed(lambda: mean_e(stage), 2)
    in_s, seen = timed(lambda: mean_e(stage, discs), 2)
    bound, unit = stated(stage.plan, "targets.point_sources")
    noise = np.sqrt(seen + 25.0) / stage.plan.facts.sigma_floor_e
    yield ProbeResult(
        "targets.point_sources",
        "spheres of 2 cm to 2 m at 5 km, and all with discs",
        bound,
        most((points - seen) / noise),
        unit,
        out_s,
        in_s,
    )


@probe("targets.eclipse")
def shadow(_: Bench) -> Iterator[ProbeResult]:
    """Sunlight past a flattened Earth, limb-darkened, beside a fine raster of the Sun's disc."""
    sun = 1.496e11 * normal(np.array([1.0, 0.1, 0.15]))
    side = normal(np.cross(sun, [0.0, 0.3, 1.0]))
    edge = EARTH_EQUATORIAL_RADIUS_M * 0.997
    along = -4.2e7 * normal(sun)
    place = np.array([along + (edge + d) * side for d in np.linspace(-2.2e5, 2.2e5, 9)])
    target = before(TOWARDS, 2e4, "a", lighting={"oblate_earth": True, "limb_darkening": 0.6})
    out_s, ours = timed(lambda: sunlit_past_earth(place, sun, 0.6, True), 3)
    in_s, true = timed(lambda: np.array([_rastered(p, sun) for p in place]))
    bound, unit = stated(prepare(parse_scene(followed(target))).plan, "targets.eclipse")
    yield ProbeResult(
        "targets.eclipse",
        "nine places at the edge of the shadow at GEO, against a raster of the Sun's disc",
        bound,
        most(ours - true),
        unit,
        out_s,
        in_s,
    )


def _rastered(place: Array, sun: Array, u: float = 0.6, lines: int = 1200) -> float:
    """Share of sunlight that passes the ellipsoid, ray by ray."""
    to_sun = sun - place
    distance = np.sqrt(to_sun @ to_sun)
    z = to_sun / distance
    x = normal(np.cross(z, [0.0, 0.0, 1.0]))
    y = np.cross(z, x)
    radius = np.arcsin(SUN_RADIUS_M / distance)
    a, b = np.meshgrid(*[(np.arange(lines) + 0.5) / lines * 2.0 - 1.0] * 2)
    q = np.hypot(a, b)
    on = q < 1.0
    light = 1.0 - u + u * np.sqrt(1.0 - q[on] ** 2)
    d = z + np.tan(radius * a[on])[:, None] * x + np.tan(radius * b[on])[:, None] * y
    scale = np.array([1.0, 1.0, 1.0 / (1.0 - EARTH_FLATTENING)])
    p, d = place * scale, d * scale
    dd, pd = np.einsum("ij,ij->i", d, d), d @ p
    hit = (pd**2 - dd * (p @ p - EARTH_EQUATORIAL_RADIUS_M**2) > 0.0) & (pd < 0.0)
    return float(light[~hit].sum() / light.sum())


@probe("targets.earthshine")
def earthshine(_: Bench) -> Iterator[ProbeResult]:
    """Light of a sphere with the Earth as a lamp and without, over a sunlit plate's."""
    ball = before(TOWARDS, 2e4, "a", body=SPHERE)
    lit = ball | {"lighting": {"earthshine_albedo": 0.3}}
    dark = parse_scene(followed(ball))
    out_s, plan = timed(lambda: prepare(dark).plan)
    in_s, other = timed(lambda: prepare(parse_scene(followed(lit))).plan)
    light = [plan_geometry(p.scene, FRAME, p.dut1_s) for p in (plan, other)]
    extra = (light[1].target_light - light[0].target_light)[0, 0, light[0].middle]
    distance = light[0].target_range_m[0, 0, light[0].middle]
    full = 0.3 * 2.0 / 3.0 * 0.25 / distance**2  # a full sphere of 1 m: 2/3 a r^2 (per irradiance)
    bound, unit = stated(plan, "targets.earthshine")
    yield ProbeResult(
        "targets.earthshine",
        "a sphere at 800 km, over what it sends when fully sunlit",
        bound,
        float(extra / full),
        unit,
        out_s,
        in_s,
    )


@probe("targets.light_between_nodes")
def moments(_: Bench) -> Iterator[ProbeResult]:
    """A tumbling plate's light by the nodes of an exposure, beside 64 times as many."""
    spin = {"kind": "spin", "rate_deg_s": 40.0, "axis": [1, 0.2, 0.1]}
    plate = {"kind": "plate", "area_m2": 2.0, "albedo": 0.3, "two_sided": True, "attitude": spin}
    data = followed(before(TOWARDS, 2e5, "a", body=plate))
    prepared = prepare(parse_scene(data))
    plan = prepared.plan
    out_s, g = timed(lambda: plan_geometry(plan.scene, FRAME, plan.dut1_s))
    in_s, fine = timed(lambda: _geometry(plan.scene, FRAME, 8 * (g.nodes - 1) + 1, plan.dut1_s))
    ours, true = (np.trapezoid(v.target_light[0, 0]) / (v.nodes - 1) for v in (g, fine))
    bound, unit = stated(plan, "targets.light_between_nodes")
    yield ProbeResult(
        "targets.light_between_nodes",
        f"a plate that turns by 200 degrees, {g.nodes} nodes beside eight times as many",
        bound,
        float(abs(ours / true - 1.0)),
        unit,
        out_s,
        in_s,
    )


def _pulled(_: float, state: Array) -> Array:
    """Two-body motion with the Earth's flattening (Vallado 2013, equation 8-30)."""
    r = state[:3]
    distance = np.sqrt(r @ r)
    z2 = (r[2] / distance) ** 2
    flat = 1.5 * J2 * EARTH_GM_M3_S2 * EARTH_EQUATORIAL_RADIUS_M**2 / distance**5
    bent = flat * r * (5.0 * z2 - np.array([1.0, 1.0, 3.0]))
    return np.concatenate([state[3:], -EARTH_GM_M3_S2 * r / distance**3 + bent])


def _flown(place: object, speed: object, at_s: Array) -> Array:
    start = np.concatenate([place, speed]).astype(float)
    found = solve_ivp(_pulled, (0.0, float(at_s[-1])), start, "DOP853", at_s, rtol=1e-12, atol=1e-6)
    return np.asarray(found.y.T)


@probe("targets.forces")
def forces(_: Bench) -> Iterator[ProbeResult]:
    """Two-body motion for 600 s and for an hour, beside the same with the flattening."""
    low = [6.878e6, 0.0, 0.0], [0.0, 4.0e3, 6.47e3]
    for (place, speed), since in ((low, 600.0), (low, 3600.0), ((GEO_M, GEO_M_S), 3600.0)):
        body = {
            "name": "a",
            "body": SPHERE,
            "orbit": {
                "kind": "state",
                "position_m": place,
                "velocity_m_s": speed,
                "epoch": "2019-05-12T09:00:00Z",
            },
        }
        hour, minute = divmod(int(since), 3600)
        data = scene(
            {
                "epoch": f"2019-05-12T{9 + hour:02d}:{minute // 60:02d}:00Z",
                "targets": [body],
                "exposure.integration_s": 1.0,
            }
        )
        plan = prepare(parse_scene(data)).plan
        epoch, zero = parse_utc(plan.scene.epoch), np.zeros(1)
        orbit = plan.scene.targets[0].orbit
        start, at = (place, speed), np.array([0.0, since])
        out_s, told = timed(partial(orbit_states, orbit, "t", epoch, zero, instants(epoch, zero)))
        in_s, true = timed(partial(_flown, *start, at))
        bound, unit = stated(plan, "targets.perturbations")
        height = np.sqrt(np.sum(np.square(place))) - EARTH_EQUATORIAL_RADIUS_M
        yield ProbeResult(
            "targets.perturbations",
            f"{since:g} s after a state at {height / 1e3:.0f} km, "
            "against scipy with the flattening",
            bound,
            float(np.linalg.norm(told[0][0] - true[-1, :3])),
            unit,
            out_s,
            in_s,
        )


@probe("targets.ephemeris")
def ephemeris(_: Bench) -> Iterator[ProbeResult]:
    """Places of a flight around a flattened Earth, beside the flight between them.

    So far apart that the flight's own error, which no two processors share, is no part of it.
    """
    place, speed = [6.878e6, 0.0, 0.0], [0.0, 4.0e3, 6.47e3]
    at = np.arange(0.0, 5401.0, 240.0)
    flown = _flown(place, speed, at)
    rows = [[float(t), *map(float, s[:3])] for t, s in zip(at, flown, strict=True)]
    orbit = {"kind": "table", "epoch": "2019-05-12T09:00:00Z", "rows": rows}
    data = scene(
        {
            "epoch": "2019-05-12T09:40:00Z",
            "targets": [{"name": "a", "orbit": orbit, "body": SPHERE}],
        }
    )
    plan = prepare(parse_scene(data)).plan
    between = np.linspace(600.0, 4800.0, 500)
    made = plan.scene.targets[0].orbit
    moment = parse_utc(plan.scene.epoch)
    offsets = between - 2400.0
    out_s, told = timed(
        lambda: orbit_states(made, "t", moment, offsets, instants(moment, offsets))[0]
    )
    in_s, true = timed(lambda: _flown(place, speed, np.append(0.0, between))[1:, :3])
    bound, unit = stated(plan, "targets.ephemeris")
    off = np.sqrt(np.sum((told - true) ** 2, axis=-1))
    yield ProbeResult(
        "targets.ephemeris",
        f"{len(rows)} rows four minutes apart, at 500 moments between",
        bound,
        most(off),
        unit,
        out_s,
        in_s,
    )


@probe("populations.*")
def populations(_: Bench) -> Iterator[ProbeResult]:
    """A screen of 3,000 satellites, beside every one of them moment by moment."""
    seconds, (kept, inside, missed) = timed(lambda: screened(3000))
    yield ProbeResult(
        "populations.screen",
        f"{inside} of 3,000 come into the field, {kept} are kept",
        0.0,
        float(missed if inside else np.inf),
        "missed",
        0.0,
        seconds,
    )
