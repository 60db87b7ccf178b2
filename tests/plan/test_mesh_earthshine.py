"""Earthshine on meshes: against the simple shapes, and against each lamp traced by itself."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from pipeline.errors import BadInput
from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.meshes import brdf
from pipeline.physics.meshes.facets import Facets
from pipeline.physics.meshes.intensity import FacetSurface, mesh_intensity, seen_areas
from pipeline.physics.meshes.lamps import wide_lamp_intensity
from pipeline.physics.meshes.model import MeshModel, RigidPart
from pipeline.physics.positions.times import parse_utc
from pipeline.physics.targets.earthshine import earth_lamps
from pipeline.physics.vectors import unit
from pipeline.plan.bodies import meshes
from pipeline.plan.bodies.attitudes import View
from pipeline.plan.bodies.bodies import earthshine_m2_sr
from pipeline.spec.targets.body import Body
from pipeline.spec.targets.mesh import MeshBody
from tests.slow import slow

EPOCH = parse_utc("2019-07-20T09:00:00Z")
ALBEDO, ERROR = 0.3, 1e-3
TURNED = {"kind": "nadir", "quaternion": [0.9, 0.3, -0.2, 0.1]}


def grey(two_sided: bool = False) -> FacetSurface:
    return FacetSurface(partial(brdf.lambert, albedo=ALBEDO), two_sided)


def square(side: float, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    v = 0.5 * side * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]) + centre
    return v[[[0, 1, 2], [0, 2, 3]]]


def ball(rows: int) -> np.ndarray:
    """Triangles of a sphere of 1 m diameter."""
    lat = np.linspace(-np.pi / 2, np.pi / 2, rows + 1)
    lon = np.linspace(0, 2 * np.pi, 2 * rows + 1)
    x, y = (np.cos(lat)[:, None] * f(lon) for f in (np.cos, np.sin))
    p = 0.5 * np.stack([x, y, np.broadcast_to(np.sin(lat)[:, None], x.shape)], -1)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]
    lower, upper = np.stack([a, b, c], -2), np.stack([a, c, d], -2)
    return np.concatenate([lower[1:].reshape(-1, 3, 3), upper[:-1].reshape(-1, 3, 3)])


def facets(corners: np.ndarray, closed: bool = False, convex: bool = False) -> Facets:
    n = len(corners)
    return Facets(corners, np.zeros(n, np.int64), np.full(n, closed), convex)


def mesh_body(corners: np.ndarray, convex: bool, two_sided: bool = False) -> MeshBody:
    model = MeshModel((RigidPart(facets(corners, convex, convex)),), (grey(two_sided),), "x")
    wish = {"kind": "mesh", "path": "x.obj", "unit": "m", "attitude": TURNED}
    return MeshBody.model_validate(wish).with_model(model, ERROR)


def view(height_m: float, moments: int = 5) -> View:
    """A body on a circular orbit over the lit side and the dark one, a site beneath it."""
    angle = np.linspace(0.2, 2.2, moments)[:, None]
    a, b = np.array([1.0, 0, 0]), unit(np.array([0.0, 1, 1]))
    place = (EARTH_EQUATORIAL_RADIUS_M + height_m) * (np.cos(angle) * a + np.sin(angle) * b)
    speed = 7e3 * (np.cos(angle) * b - np.sin(angle) * a)
    sun = np.broadcast_to(1.5e11 * unit(np.array([1.0, 0.2, 0.4])), place.shape)
    site = 0.9 * place + 3e5
    rows = (np.linspace(0.0, 1e3, moments), place, speed, sun, site)
    return View(*(np.array(v)[None] for v in rows))


def shape(**values: Any) -> Any:
    return TypeAdapter(Body).validate_python({"albedo": ALBEDO} | values)


@pytest.mark.parametrize("height_m", [5e5, 3.6e7])
@pytest.mark.parametrize("what", ["sphere", "plate", slow("two-sided plate")])
def test_against_simple_shapes(what: str, height_m: float) -> None:
    at = view(height_m)
    if what == "sphere":
        mesh, plain, room = mesh_body(ball(32), True), {"kind": "sphere", "diameter_m": 1.0}, 7e-3
    else:
        both = what != "plate"
        mesh, room = mesh_body(square(2.0), False, both), ERROR
        plain = {"kind": "plate", "area_m2": 4.0, "two_sided": both, "attitude": TURNED}
    ours = earthshine_m2_sr(mesh, EPOCH, at, 0.3)
    true = earthshine_m2_sr(shape(**plain), EPOCH, at, 0.3)
    assert true.max() > 0.0
    # both err by up to 5e-4 of the light of a full Earth on a body that faces it
    most = 5e-4 * 0.3 * (EARTH_EQUATORIAL_RADIUS_M / np.linalg.norm(at.place_m[0, 0])) ** 2
    most *= ALBEDO / np.pi * (0.8 if what == "sphere" else 4.0)
    np.testing.assert_allclose(ours, true, rtol=room, atol=2.0 * most)


def test_against_every_lamp_traced() -> None:
    """A plate under a canopy and beside a wall: 256 lamps, each with its own shadows."""
    wall = square(2.0)[..., [2, 1, 0]] + [1.0, 0.0, 1.0]
    body = facets(np.concatenate([square(2.0), square(1.0, (0.2, 0.3, 0.6)), wall]))
    surfaces, rng = [grey(two_sided=True)], np.random.default_rng(5)
    for height in (4e5, 3.6e7):
        place = (EARTH_EQUATORIAL_RADIUS_M + height) * unit(rng.normal(size=3))
        sun = 1.5e11 * unit(place / np.linalg.norm(place) + 0.6 * rng.normal(size=3))
        observer = unit(rng.normal(size=3) - 1.5 * unit(place))

        def lamp(n: int, place: Any = place, sun: Any = sun) -> tuple[np.ndarray, np.ndarray]:
            directions, light = earth_lamps(place, sun, 0.3, n)
            return directions[0], light[0]

        every = [
            e * mesh_intensity(body, surfaces, d, observer, 1e-4).intensity_m2_sr
            for d, e in zip(*lamp(16), strict=True)
        ]
        bare = [
            e * mesh_intensity(facets(body.corners_m, convex=True), surfaces, d, observer)
            .intensity_m2_sr for d, e in zip(*lamp(16), strict=True)
        ]  # fmt: skip
        ours, off = wide_lamp_intensity(body, surfaces, lamp, observer, 4e-3)
        assert sum(every) < 0.97 * sum(bare)  # shadows count here
        assert ours == pytest.approx(sum(every), abs=max(off, 4e-3 * ours))
        assert off < 0.06 * ours  # a bound: the last change of 64 parts
        # beside much sunlight less is needed: shadows from few lamps, still within the share
        much = 50.0 * ours
        rough, room = wide_lamp_intensity(body, surfaces, lamp, observer, 4e-3, much)
        assert rough == pytest.approx(sum(every), abs=4e-3 * (much + ours))
        # each lamp's shadows are traced to 2% of its light then: that is told, too
        assert room > 0.0198 * sum(bare)


def test_seen_areas_against_light_from_the_observer() -> None:
    """With the Sun behind the observer a white surface sends area x (n.o) / pi."""
    body = facets(np.concatenate([square(2.0), square(1.0, (0.2, 0.3, 0.6))]))
    for direction in ([0.3, 0.2, 0.9], [0.5, -0.6, -0.4]):
        o = unit(np.array(direction))
        area, off = seen_areas(body, o, 1e-6)
        white = FacetSurface(partial(brdf.lambert, albedo=1.0), two_sided=True)
        light = mesh_intensity(body, [white], o, o, 1e-6).facet_m2_sr
        np.testing.assert_allclose(area * np.abs(body.normal @ o) / np.pi, light, rtol=1e-5)
        assert off <= 1e-6 * area.sum()


def test_a_plate_seen_edge_on_sends_nothing() -> None:
    def lamp(n: int) -> tuple[np.ndarray, np.ndarray]:
        return np.array([[0.0, 0.6, 0.8]]), np.ones(1)

    body, surfaces = facets(square(2.0)), [grey(two_sided=True)]
    assert wide_lamp_intensity(body, surfaces, lamp, [0.0, 1.0, 0.0]) == (0.0, 0.0)
    assert wide_lamp_intensity(body, surfaces, lamp, [0.0, 0.6, 0.8])[0] > 0.1


def test_limits_and_refusals() -> None:
    at = view(5e5)
    night = View(at.time_s, at.place_m, at.velocity_m_s, -at.place_m * 2e4, at.observer_m)
    assert np.all(earthshine_m2_sr(mesh_body(square(2.0), False), EPOCH, night, 0.3) == 0.0)
    curve = TypeAdapter(Body).validate_python(
        {"kind": "light_curve", "times_s": [0, 1e4], "magnitudes": [5, 6]}
    )
    with pytest.raises(BadInput, match="earthshine on a body of shapes or a mesh"):
        earthshine_m2_sr(curve, EPOCH, at, 0.3)
    unread = MeshBody.model_validate({"kind": "mesh", "path": "x.obj", "unit": "m"})
    with pytest.raises(BadInput, match="a mesh that has been read"):
        earthshine_m2_sr(unread, EPOCH, at, 0.3)


def test_a_glint_is_that_of_the_suns_disc_at_its_distance() -> None:
    """A mirror whose highlight is as narrow as the disc, at 1 au, 2 au and 1 au: GGX over a disc of
    radius r, the half vector turning by r / 2, is 1 / (1 + (r / 2 alpha)^2) of that of a point."""
    alpha, sun = 0.002, 4.652e-3
    mirror = FacetSurface(
        partial(brdf.cook_torrance, diffuse=0.0, roughness=alpha, normal_reflectance=1.0),
        sun_rings=12,
    )
    model = MeshModel((RigidPart(facets(square(1.0))),), (mirror,), "x")
    wish = {"kind": "mesh", "path": "x.obj", "unit": "m",
            "attitude": {"kind": "inertial", "quaternion": [0.0, 0.0, 0.0, 1.0]}}  # fmt: skip
    body = MeshBody.model_validate(wish).with_model(model, ERROR)
    up, place = np.array([0.0, 0.0, 1.0]), np.array([7e6, 0.0, 0.0])
    au = 149_597_870_700.0
    suns = np.array([[place + far * au * up for far in (1.0, 2.0, 1.0)]])
    still = np.broadcast_to(place, (1, 3, 3))
    at = View(np.zeros((1, 3)), still, np.zeros((1, 3, 3)), suns, still + 1e7 * up)
    found = meshes.mesh_m2_sr(body, EPOCH, at, frames=3)
    point = 1.0 / (4.0 * np.pi * alpha**2)  # m2/sr of 1 m2, seen and lit from above
    wanted = [point / (1.0 + (sun / far / (2.0 * alpha)) ** 2) for far in (1.0, 2.0, 1.0)]
    assert found == pytest.approx(wanted, rel=0.02)
    assert found[1] > 1.4 * found[0]


@pytest.mark.parametrize("sharp", [(0,), (3,), (3, 0), (0, 3)])
def test_one_surface_with_a_glint_is_enough_for_finer_steps(
    sharp: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In sunlight every moment counts then; in earthshine as many as matt ones have in sunlight."""
    surfaces = tuple(replace(grey(), sun_rings=rings) for rings in sharp)
    model = MeshModel((RigidPart(facets(square(2.0))),), surfaces, "x")
    wish = {"kind": "mesh", "path": "x.obj", "unit": "m", "attitude": TURNED}
    body = MeshBody.model_validate(wish).with_model(model, ERROR)
    at = view(5e5, 400)
    looked: list[Any] = []
    steps: list[float] = []

    def lit(*given: Any) -> tuple[float, float]:
        looked.append(given)
        return 1.0, 0.0

    def light(model: Any, sun: Any, observer: Any, times: Any, *rest: Any) -> tuple[Any, float]:
        steps.append(rest[-1])
        return np.ones(len(times)), 0.0

    monkeypatch.setattr(meshes, "wide_lamp_intensity", lit)
    monkeypatch.setattr(meshes, "model_light", light)
    meshes.mesh_m2_sr(body, EPOCH, at)
    earthshine_m2_sr(body, EPOCH, at, 0.3)
    assert set(steps) == {0.0 if any(sharp) else meshes.STEP_RAD}
    assert len(looked) == 400 if any(sharp) else 50 < len(looked) < 300
