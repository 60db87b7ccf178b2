"""Meshes against closed forms, exact overlaps, ray casting, and themselves."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.physics.meshes import brdf
from pipeline.physics.meshes.facets import Facets, is_convex, together
from pipeline.physics.meshes.intensity import (
    FacetSurface,
    mesh_intensity,
    mesh_picture,
    sun_points,
)
from pipeline.physics.meshes.shells import closed_shells, shell_volumes
from pipeline.physics.targets.disc import picture
from pipeline.physics.targets.plate import box_area_function
from pipeline.physics.targets.sphere import sphere_area_function
from pipeline.physics.vectors import separation, unit

WHITE = FacetSurface(partial(brdf.lambert, albedo=1.0))
SHEET = FacetSurface(partial(brdf.lambert, albedo=1.0), two_sided=True)
UP = np.array([0.0, 0.0, 1.0])


def facets(corners, closed=False, convex=False, surface=0):
    n = len(corners)
    return Facets(np.asarray(corners, float), np.full(n, surface), np.full(n, closed), convex)


def square(side, centre=(0.0, 0.0, 0.0), wide=None):
    h, w = 0.5 * side, 0.5 * (side if wide is None else wide)
    v = np.array([[-w, -h, 0], [w, -h, 0], [w, h, 0], [-w, h, 0]]) + centre
    return v[[[0, 1, 2], [0, 2, 3]]]


def box(size, centre=(0.0, 0.0, 0.0)):
    """A closed box, outward normals."""
    out = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (-0.5, 0.5):
            q = np.zeros((4, 3))
            q[:, axis] = side
            q[:, u] = np.array([-0.5, 0.5, 0.5, -0.5]) * np.sign(side)
            q[:, v] = [-0.5, -0.5, 0.5, 0.5]
            out.append(q[[0, 1, 2]] * size + centre)
            out.append(q[[0, 2, 3]] * size + centre)
    return np.array(out)


def sphere(rows, columns, radius=1.0):
    lat = np.linspace(-np.pi / 2, np.pi / 2, rows + 1)
    lon = np.linspace(0, 2 * np.pi, columns + 1)
    x = np.cos(lat)[:, None] * np.cos(lon)
    y = np.cos(lat)[:, None] * np.sin(lon)
    p = radius * np.stack([x, y, np.broadcast_to(np.sin(lat)[:, None], x.shape)], -1)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]
    lower, upper = np.stack([a, b, c], -2), np.stack([a, c, d], -2)
    return np.concatenate([lower[1:].reshape(-1, 3, 3), upper[:-1].reshape(-1, 3, 3)])


def direction(rng):
    return unit(rng.normal(size=3))


def g_of(mesh, sun, observer, error=1e-3, surfaces=(WHITE,)):
    return mesh_intensity(mesh, surfaces, sun, observer, error).intensity_m2_sr * np.pi


def test_against_sphere_within_facet_error():
    rng = np.random.default_rng(2)
    worst = []
    for rows in (24, 48):
        mesh = facets(sphere(rows, 2 * rows), closed=True)
        off = []
        for _ in range(12):
            s, o = direction(rng), direction(rng)
            true = float(sphere_area_function(separation(s, o), 2.0))
            off.append(abs(g_of(mesh, s, o) - true) / (2 * np.pi / 3))
        worst.append(max(off))
    assert worst[0] < 1.5 * (np.pi / 24) ** 2
    assert worst[1] < 0.5 * worst[0]  # second order in the facets' size


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60)
def test_against_box_exact_for_every_direction(seed):
    rng = np.random.default_rng(seed)
    s, o, size = direction(rng), direction(rng), rng.uniform(0.1, 3.0, 3)
    true = float(box_area_function(s, o, size))
    for closed in (False, True):
        found = g_of(facets(box(size), closed), s, o)
        assert found == pytest.approx(true, rel=1e-9, abs=1e-9 * np.prod(size) ** (2 / 3))


def _overlap(a0, a1, b0, b1):
    return max(0.0, min(a1, b1) - max(a0, b0))


@given(
    sun=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)),
    seen=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)),
    side=st.floats(0.3, 3.0),
)
@settings(max_examples=60)
@example(sun=(1.140625, 1.14453125), seen=(0.0, 0.0), side=0.3046875)  # a sliver of shadow
def test_against_exact_overlap_of_two_plates(sun, seen, side):
    """A square plate above another: shadow and covered part are shifted squares."""
    s, o = unit(np.array([*sun, 1.0])), unit(np.array([*seen, 1.0]))
    mesh = facets(np.concatenate([square(2.0), square(side, (0.0, 0.0, 1.0))]))
    light = mesh_intensity(mesh, [WHITE], s, o, 1e-5)
    half = 0.5 * side
    gone, both = 0.0, 1.0
    for d in (sun, seen):
        gone += _overlap(-1, 1, -d[0] - half, -d[0] + half) * _overlap(
            -1, 1, -d[1] - half, -d[1] + half
        )
    for k in range(2):
        low, high = max(-sun[k], -seen[k]) - half, min(-sun[k], -seen[k]) + half
        both *= _overlap(-1, 1, low, max(low, high))
    true = s[2] * o[2] * (side**2 + 4.0 - gone + both)
    assert light.intensity_m2_sr * np.pi == pytest.approx(true, rel=2e-5)
    assert abs(light.intensity_m2_sr * np.pi - true) <= np.pi * light.error_m2_sr + 1e-6 * true


def test_against_exact_overlap_between_lines_through_the_corners() -> None:
    """There free lengths are straight and areas exact, though a tenth may be off."""
    sun, seen, side = (0.31, 0.17), (-0.2, 0.4), 0.8
    s, o = unit(np.array([*sun, 1.0])), unit(np.array([*seen, 1.0]))
    mesh = facets(np.concatenate([square(2.0), square(side, (0.0, 0.0, 1.0))]))
    # shadow and cover lie within the plate below, and share a rectangle
    both = np.prod([side - abs(a - b) for a, b in zip(sun, seen, strict=True)])
    true = s[2] * o[2] * (4.0 - side**2 + both)
    assert g_of(mesh, s, o, 0.1) == pytest.approx(true, rel=1e-9)


@pytest.mark.parametrize("sun", [(1.6, 0.1), (1.57, 0.13)])
def test_against_exact_overlap_what_is_looked_at_again_lies_in_the_same_shadow(sun):
    """Of a plate that does not cover it. Forty plates below, which nobody sees, let the first look
    be too coarse for what is left."""
    side, x, y, z = 1.3, 6.0, 0.4, 4.0
    hidden = [square(1.9, (0.0, 0.0, -1e-4 * (k + 1))) for k in range(40)]
    mesh = facets(np.concatenate([*hidden, square(side, (x, y, z)), square(2.0)]))
    s = unit(np.array([*sun, 1.0]))
    light = mesh_intensity(mesh, [WHITE], s, UP, 0.3)
    off = x - z * sun[0], y - z * sun[1]
    shadow = np.prod([_overlap(-1, 1, c - 0.5 * side, c + 0.5 * side) for c in off])
    true = s[2] * (side**2 + 4.0 - shadow) / np.pi
    assert light.error_m2_sr <= 0.3 * light.intensity_m2_sr
    assert abs(light.intensity_m2_sr - true) <= light.error_m2_sr


def test_the_error_asked_for_is_met():
    rng = np.random.default_rng(5)
    mesh = facets(np.concatenate([sphere(10, 16) + rng.uniform(-2, 2, 3) for _ in range(8)]), True)
    for _ in range(6):
        s, o = direction(rng), direction(rng)
        s = s if s @ o > -0.3 else -s
        true = mesh_intensity(mesh, [WHITE], s, o, 1e-8).intensity_m2_sr
        for error in (1e-2, 1e-3, 1e-4):
            light = mesh_intensity(mesh, [WHITE], s, o, error)
            assert light.error_m2_sr <= error * light.intensity_m2_sr
            assert abs(light.intensity_m2_sr - true) <= error * true


def test_same_with_and_without_the_backs_of_closed_shells():
    rng = np.random.default_rng(6)
    corners = np.concatenate([box(rng.uniform(0.3, 2, 3), rng.uniform(-1, 1, 3)) for _ in "abcd"])
    for _ in range(8):
        s, o = direction(rng), direction(rng)
        a, b = (g_of(facets(corners, c), s, o, 1e-6) for c in (True, False))
        assert a == pytest.approx(b, rel=1e-5, abs=1e-6)


def test_same_when_sun_and_observer_change_places():
    rng = np.random.default_rng(7)
    gloss = FacetSurface(partial(brdf.cook_torrance, diffuse=0.3, roughness=0.3, index=1.5))
    corners = np.concatenate([box(rng.uniform(0.3, 2, 3), rng.uniform(-1, 1, 3)) for _ in "abc"])
    mesh = facets(corners, True)
    for _ in range(8):
        s, o = direction(rng), direction(rng)
        there = mesh_intensity(mesh, [gloss], s, o, 1e-6).intensity_m2_sr
        back = mesh_intensity(mesh, [gloss], o, s, 1e-6).intensity_m2_sr
        assert there == pytest.approx(back, rel=1e-5, abs=1e-7)


def test_same_when_all_is_turned_and_moved():
    rng = np.random.default_rng(8)
    mesh = facets(np.concatenate([box((1, 2, 1)), box((3, 0.5, 0.2), (0, 0, 1.4))]), True)
    s, o = unit(np.array([0.3, 0.2, 1.0])), unit(np.array([-0.4, 0.3, 1.0]))
    here = g_of(mesh, s, o, 1e-6)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    there = g_of(mesh.moved(turn, (3.0, -2.0, 1.0)), turn @ s, turn @ o, 1e-6)
    assert there == pytest.approx(here, rel=1e-5)


def test_same_bits_twice():
    mesh = facets(np.concatenate([sphere(8, 12), box((3, 0.5, 0.2), (0, 0, 1.4))]), True)
    s, o = unit(np.array([0.3, 0.2, 1.0])), unit(np.array([-0.4, 0.3, 1.0]))
    a, b = (mesh_intensity(mesh, [WHITE], s, o) for _ in "ab")
    assert np.array_equal(a.facet_m2_sr, b.facet_m2_sr)


def test_a_thin_boom_casts_its_shadow():
    """A boom far thinner than the plate below: lost between coarse lines, kept by exact ones."""
    boom = square(2.0, (0.1, 0.0, 1.0), wide=1e-3)
    mesh = facets(np.concatenate([square(2.0), boom]))
    s = unit(np.array([0.2, 0.0, 1.0]))
    assert g_of(mesh, s, UP) == pytest.approx(s[2] * (4.0 - 2e-3 - 2e-3 + 2e-3), rel=1e-6)


def test_sheets_are_black_behind_unless_two_sided():
    s, o = unit(np.array([0.1, 0.0, -1.0])), unit(np.array([0.0, 0.2, -1.0]))
    mesh = facets(square(1.0))
    assert g_of(mesh, s, o) == 0.0
    assert g_of(mesh, s, o, surfaces=(SHEET,)) == pytest.approx(s[2] * o[2])
    assert g_of(mesh, -s, o, surfaces=(SHEET,)) == 0.0  # sun and observer on opposite sides


def test_sheets_in_one_plane_that_overlap_count_once():
    mesh = facets(np.concatenate([square(1.0), square(1.0, (0.5, 0.0, 0.0))]))
    assert g_of(mesh, UP, UP, 1e-6) == pytest.approx(1.5)


def test_limits_opposition_and_edge_on():
    mesh = facets(np.concatenate([square(2.0), square(1.0, (0.0, 0.0, 1.0))]))
    assert g_of(mesh, UP, UP) == pytest.approx(4.0)
    assert g_of(mesh, np.array([1.0, 0.0, 0.0]), UP) == 0.0
    assert g_of(mesh, -UP, UP) == 0.0
    assert len(facets(np.zeros((0, 3, 3)))) == 0
    assert mesh_intensity(facets(np.zeros((0, 3, 3))), [WHITE], UP, UP).intensity_m2_sr == 0.0


def test_directions_are_checked():
    with pytest.raises(BadInput, match="unit vector"):
        mesh_intensity(facets(square(1.0)), [WHITE], (0.0, 0.0, 2.0), UP)


def test_convex_bodies_skip_the_search():
    mesh = sphere(12, 24)
    assert is_convex(mesh)
    assert not is_convex(np.concatenate([box((1, 1, 1)), box((1, 1, 1), (3, 0, 0))]))
    s, o = unit(np.array([1.0, 0.2, 0.3])), unit(np.array([0.1, 1.0, 0.3]))
    quick = g_of(facets(mesh, True, convex=True), s, o)
    assert quick == pytest.approx(g_of(facets(mesh, True), s, o), rel=1e-12)
    assert not together([facets(mesh, True, True)] * 2).convex


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_dent_is_told_from_rounding_by_the_size_of_the_body(size):
    """3e-7 of it: files round."""
    for dent, convex in ((0.0, True), (1e-8, True), (1e-6, False), (1e-2, False)):
        cube = box((1.0, 1.0, 1.0))
        rest = cube[(cube[..., 2] < 0.5).any(axis=1)]
        ring = 0.5 * np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1.0]])
        low = [0.0, 0.0, 0.5 - dent]
        lid = [[ring[k - 1], ring[k], low] for k in range(4)]
        assert is_convex(size * np.concatenate([rest, lid])) == convex, dent


def test_shells_are_told_apart_and_measured():
    cube, hole = box((1.0, 2.0, 3.0)), box((1.0, 1.0, 1.0), (5.0, 0.0, 0.0))[1:]
    inside_out = box((1.0, 1.0, 1.0), (9.0, 0.0, 0.0))[:, ::-1]
    corners = np.concatenate([cube, hole, inside_out])
    _, faces = np.unique(corners.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    shell, shut = closed_shells(faces.reshape(-1, 3))
    assert list(shut[shell[[0, 12, -1]]]) == [True, False, True]
    volume = shell_volumes(corners, shell, shut.size)
    assert volume[shell[0]] == pytest.approx(6.0)
    assert volume[shell[-1]] == pytest.approx(-1.0)


def test_the_suns_disc_widens_a_sharp_highlight():
    radius = 0.00465
    points = sun_points(UP, radius, 3)
    np.testing.assert_allclose(points.mean(axis=0)[:2], 0.0, atol=1e-9)
    across = np.sum(points[:, :2] ** 2, axis=1)
    assert across.max() < radius**2
    assert across.mean() == pytest.approx(0.5 * radius**2, rel=1e-4)  # of an even disc
    mirror = FacetSurface(
        partial(brdf.cook_torrance, diffuse=0.0, roughness=0.005, normal_reflectance=1.0),
        sun_rings=3,
    )
    mesh = facets(square(1.0))
    sharp, wide = (
        mesh_intensity(mesh, [mirror], UP, UP, sun_radius_rad=r).intensity_m2_sr
        for r in (0.0, radius)
    )
    # GGX over a disc of angles r, the half vector turning by r/2: 1 / (1 + (r / 2 alpha)^2)
    assert wide / sharp == pytest.approx(1 / (1 + (radius / 0.01) ** 2), rel=0.02)


def test_a_picture_holds_the_light_where_it_is():
    mesh = facets(np.concatenate([square(2.0), square(1.0, (2.5, 0.0, 0.0))]))
    s = unit(np.array([0.3, 0.2, 1.0]))
    light = mesh_intensity(mesh, [WHITE], s, UP)
    axes = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    image, centre = mesh_picture(mesh, light, s, UP, *axes, cell_m=0.25)
    assert image.sum() == pytest.approx(light.intensity_m2_sr, rel=1e-12)
    made = picture(image, 1.0, centre)
    np.testing.assert_allclose(made.box, [-4, 4, -4, 12])  # cells of 0.25 m about the origin
    rows, columns = np.indices(image.shape)
    x = np.sum((columns - centre[1]) * 0.25 * image) / image.sum()
    y = np.sum((rows - centre[0]) * 0.25 * image) / image.sum()
    assert x == pytest.approx(2.5 * 1.0 / 5.0, abs=1e-6)
    assert y == pytest.approx(0.0, abs=1e-6)
    even = image[image > 0.0]
    np.testing.assert_allclose(even, even[0], rtol=1e-6)
    with pytest.raises(BadInput, match="cells"):
        mesh_picture(mesh, light, s, UP, *axes, cell_m=1e-5)
    with pytest.raises(BadInput, match="across"):
        mesh_picture(mesh, light, s, UP, axes[0], UP, cell_m=0.1)


def test_a_picture_leaves_shadows_dark():
    mesh = facets(np.concatenate([square(2.0), square(0.5, (0.0, 0.0, 0.5))]))
    s = unit(np.array([1.0, 0.0, 1.0]))
    light = mesh_intensity(mesh, [WHITE], s, UP, 1e-6)
    image, _ = mesh_picture(
        mesh, light, s, UP, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), cell_m=0.125
    )
    dark = np.argwhere(image[1:-1, 1:-1] == 0.0) + 1
    assert len(dark) == 16  # the shadow, 0.5 m square, 0.5 m to the side
    assert dark[:, 1].max() < image.shape[1] // 2


def test_the_inside_of_a_convex_shell_sends_nothing():
    """Surfaces that reflect on both sides: the backs of a closed convex body stay in the dark."""
    mesh = sphere(12, 24)
    s, o = unit(np.array([1.0, 0.2, 0.1])), unit(np.array([0.1, 1.0, -0.3]))
    for convex in (True, False):
        closed = facets(mesh, True, convex)
        once = g_of(closed, s, o)
        assert g_of(closed, s, o, surfaces=(SHEET,)) == pytest.approx(once, rel=1e-9)


@pytest.mark.parametrize("apart", [1.5, 0.75])
def test_each_facet_has_its_own_surface(apart):
    """Two plates side by side or one before the other, one of them white on both sides."""
    grey = FacetSurface(partial(brdf.lambert, albedo=0.2))
    both = np.concatenate([square(1.0), square(1.0, (apart, 0.0, 0.5))])
    mesh = Facets(both, np.array([0, 0, 1, 1]), np.zeros(4, bool))
    hidden = max(0.0, 1.0 - apart)
    for surfaces, front, back in (((grey, SHEET), 0.2 * (1 - hidden) + 1.0, 1.0),
                                  ((SHEET, grey), 1.0 - hidden + 0.2, 1.0)):  # fmt: skip
        assert g_of(mesh, UP, UP, 1e-6, surfaces) == pytest.approx(front, rel=1e-6)
        seen = back - (hidden if surfaces[1] is SHEET else 0.0)
        assert g_of(mesh, -UP, -UP, 1e-6, surfaces) == pytest.approx(seen, rel=1e-6)


def test_a_facet_thinner_than_the_lines_of_a_picture_is_drawn_in_its_cell():
    speck = square(1e-3, (2.302, 1.302, 0.0))
    mesh = facets(np.concatenate([square(0.5), speck]))
    light = mesh_intensity(mesh, [WHITE], UP, UP)
    axes = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    image, centre = mesh_picture(mesh, light, UP, UP, *axes, cell_m=0.25)
    row, column = (round(v / 0.25 + c) for v, c in zip((1.302, 2.302), centre, strict=True))
    assert image[row, column] == pytest.approx(light.facet_m2_sr[2:].sum(), rel=1e-9)
