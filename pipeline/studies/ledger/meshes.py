"""Probes of meshes: pictures, shadows, light between facets, earthshine, tables of light."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array
from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.meshes import brdf
from pipeline.physics.meshes.facets import Facets
from pipeline.physics.meshes.intensity import FacetSurface, mesh_intensity
from pipeline.physics.meshes.lamps import wide_lamp_intensity
from pipeline.physics.targets.earthshine import earth_lamps
from pipeline.physics.vectors import unit as normal
from pipeline.plan.bodies import mesh_tables
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.studies.ledger.probe import Bench, ProbeResult, most, probe, stated, timed
from pipeline.studies.ledger.scenes import before, mean_e
from pipeline.studies.ledger.targets import TOWARDS, followed
from pipeline.studies.scenes.stage import open_stage

ALBEDO, CELLS, ERROR = 0.5, 24, 1e-3


def quad(*corners: object) -> Array:
    """Two triangles (2, 3, 3) of four corners in turn."""
    a = np.array(corners, float)
    return a[[[0, 1, 2], [0, 2, 3]]]


def groove() -> Array:
    """Two squares of 1 m at a right angle: a corner that lights itself."""
    return np.concatenate(
        [
            quad([0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]),
            quad([0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]),
        ]
    )


def write_obj(path: Path, triangles: Array) -> str:
    """Triangles (F, 3, 3) as an OBJ file; its path."""
    lines = [f"v {x} {y} {z}" for x, y, z in triangles.reshape(-1, 3)]
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(triangles))]
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def body(path: str, albedo: float = ALBEDO, **more: object) -> JsonObject:
    """A matt body of a file, both sides of its sheets alike."""
    surface = {"kind": "lambert", "albedo": albedo, "two_sided": True}
    return {"kind": "mesh", "path": path, "unit": "m", "surface": surface} | more


def _sheets(triangles: Array) -> Facets:
    n = len(triangles)
    return Facets(triangles, np.zeros(n, np.int64), np.zeros(n, bool), False)


def _grey(albedo: float = ALBEDO) -> FacetSurface:
    return FacetSurface(partial(brdf.lambert, albedo=albedo), True)


@probe("targets.light_between_facets")
def between(bench: Bench) -> Iterator[ProbeResult]:
    """A corner of two matt squares: all reflections between them, beside one alone; its shadows."""
    path = write_obj(bench.folder / "groove.obj", groove())
    plan = prepare(parse_scene(followed(before(TOWARDS, 2e5, "a", body=body(path))))).plan
    sun, observer = normal(np.array([1.0, 0.1, 1.1])), normal(np.array([0.9, -0.2, 1.0]))
    mesh, surfaces = _sheets(groove()), [_grey()]
    out_s, ours = timed(lambda: mesh_intensity(mesh, surfaces, sun, observer, ERROR), 3)
    in_s, lit = timed(lambda: _between(sun, observer))
    outline = float(np.sum(np.abs(mesh.cross_m2 @ observer)) * 0.5)
    plate = ALBEDO * outline / np.pi
    bound, unit = stated(plan, "targets.light_between_facets")
    yield ProbeResult(
        "targets.light_between_facets",
        f"a right corner of albedo {ALBEDO:g}, {CELLS} x "
        f"{CELLS} cells a side that light each other",
        bound,
        float(lit / plate),
        unit,
        out_s,
        in_s,
    )
    slanted = normal(np.array([-0.4, 0.3, 1.0]))
    out_s, rough = timed(lambda: mesh_intensity(mesh, surfaces, slanted, observer, ERROR), 3)
    in_s, fine = timed(lambda: mesh_intensity(mesh, surfaces, slanted, observer, 1e-5))
    bound, unit = stated(plan, "targets.mesh_shadows")
    off = abs(rough.intensity_m2_sr / fine.intensity_m2_sr - 1.0)
    assert ours.intensity_m2_sr > 0.0
    yield ProbeResult(
        "targets.mesh_shadows",
        "the same corner, one side in the other's shadow, beside an error of 1e-5",
        bound,
        float(off),
        unit,
        out_s,
        in_s,
    )


def _between(sun: Array, observer: Array) -> float:
    """What a groove sends beyond one reflection [m2/sr over the irradiance]: radiosity.

    B = a (E + F B), F the form factors of cells by their middles; both squares see Sun and observer
    whole.
    """
    c = (np.arange(CELLS) + 0.5) / CELLS
    u, v = (w.ravel() for w in np.meshgrid(c, c))
    floor, wall = np.stack([u, v, 0 * u], -1), np.stack([0 * u, v, u], -1)
    place = np.concatenate([floor, wall])
    facing = np.repeat([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], len(u), axis=0)
    apart = place[None] - place[:, None]
    square = np.sum(apart**2, -1) + np.eye(len(place))
    one = np.einsum("ijk,ik->ij", apart, facing)
    other = -np.einsum("ijk,jk->ij", apart, facing)
    area = 1.0 / CELLS**2
    form = np.clip(one, 0, None) * np.clip(other, 0, None) / (np.pi * square**2) * area
    form *= np.minimum(1.0, 1.0 / np.maximum(form.sum(axis=1, keepdims=True), 1e-9))
    straight = facing @ sun
    sent = np.linalg.solve(np.eye(len(place)) - ALBEDO * form, ALBEDO * straight)
    return float(np.sum((sent - ALBEDO * straight) * (facing @ observer)) * area / np.pi)


@probe("targets.earthshine_on_meshes")
def earthshine(bench: Bench) -> Iterator[ProbeResult]:
    """The groove in the light of a large Earth: 256 parts of it, each with its own shadows."""
    path = write_obj(bench.folder / "groove.obj", groove())
    lighting = {"earthshine_albedo": 0.3}
    target = before(TOWARDS, 2e5, "a", body=body(path, error=4e-3), lighting=lighting)
    plan = prepare(parse_scene(followed(target))).plan
    mesh, surfaces = _sheets(groove()), [_grey()]
    place = (EARTH_EQUATORIAL_RADIUS_M + 4e5) * normal(np.array([0.5, 0.3, -1.0]))
    sun = 1.5e11 * normal(np.array([0.3, 0.5, -0.9]))
    observer = normal(np.array([0.8, -0.3, 0.9]))

    def lamp(n: int) -> tuple[Array, Array]:
        directions, light = earth_lamps(place, sun, 0.3, n)
        return directions[0], light[0]

    in_s, every = timed(
        lambda: sum(
            e * mesh_intensity(mesh, surfaces, d, observer, 1e-4).intensity_m2_sr
            for d, e in zip(*lamp(16), strict=True)
        )
    )
    out_s, (ours, _off) = timed(lambda: wide_lamp_intensity(mesh, surfaces, lamp, observer, 4e-3))
    bound, unit = stated(plan, "targets.earthshine_on_meshes")
    yield ProbeResult(
        "targets.earthshine_on_meshes",
        "a right corner at 400 km, beside 256 parts of the Earth traced one by one",
        bound,
        float(abs(ours / every - 1.0)),
        unit,
        out_s,
        in_s,
    )


@probe("targets.light_table")
def table(bench: Bench) -> Iterator[ProbeResult]:
    """Four of 900 frames from a table of light, beside the same worked out one by one."""
    path = write_obj(bench.folder / "groove.obj", groove())
    law = {"kind": "nadir", "quaternion": [-0.5, 0.5, 0.3, 0.8]}
    exposure = {"integration_s": 0.5, "frames": 900, "cadence_s": 1.0}
    target = before(TOWARDS, 2e5, "a", body=body(path, attitude=law))
    data = followed(target, exposure=exposure)
    plan = prepare(parse_scene(data)).plan
    frames = np.array([0, 7, 211, 430])
    out_s, ours = timed(lambda: plan_geometry(plan.scene, frames, plan.dut1_s).target_light)
    worth = mesh_tables.WORTH
    try:
        mesh_tables.WORTH = 10**9
        in_s, true = timed(lambda: plan_geometry(plan.scene, frames, plan.dut1_s).target_light)
    finally:
        mesh_tables.WORTH = worth
    bound, unit = stated(plan, "targets.light_table")
    yield ProbeResult(
        "targets.light_table",
        "a corner that turns in orbit, 4 of 900 frames",
        bound,
        most(ours - true) / most(true),
        unit,
        out_s,
        in_s,
    )


@probe("targets.point_sources")
def shapes(bench: Bench) -> Iterator[ProbeResult]:
    """A square plate as a point, and as a mesh with its picture: the same light, spread out."""
    side = 2.0
    square = quad(
        *(
            side * (np.array(c) - [0.5, 0.5, 0.0])
            for c in ([0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0])
        )
    )
    path = write_obj(bench.folder / "square.obj", square)
    law = {"kind": "inertial", "quaternion": [0.7, 0.7, 0.0, 0.0]}
    plate = {
        "kind": "plate",
        "area_m2": side**2,
        "albedo": ALBEDO,
        "two_sided": True,
        "attitude": law,
    }
    scenes = [
        followed(before(TOWARDS, 1e5, "a", body=b), **{"exposure.integration_s": 0.01})
        for b in (plate, body(path, attitude=law))
    ]
    point, mesh = (open_stage(s) for s in scenes)
    out_s, a = timed(lambda: mean_e(point))
    in_s, b = timed(lambda: mean_e(mesh))
    light = float((a - np.median(a)).sum())
    bound, unit = stated(point.plan, "targets.shapes_as_points")
    yield ProbeResult(
        "targets.shapes_as_points",
        "a plate of 2 m at 100 km, beside its picture",
        bound,
        most(a - b) / light,
        unit,
        out_s,
        in_s,
    )
