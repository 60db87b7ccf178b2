"""Regions as geometry: what lies within, and how far off the rest is."""

from __future__ import annotations

import erfa
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from catalog_tools.errors import BadInput
from catalog_tools.geometry.regions import Cone, Polygon, cone_of, polygon_of
from catalog_tools.geometry.sphere import directions

ARCSEC_RAD = np.pi / 648_000.0


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def around(centre, radii_rad, angles_rad):
    """Directions at distances and position angles from a centre (3,)."""
    centre = np.asarray(centre)
    x = unit(np.cross(np.eye(3)[np.argmin(np.abs(centre))], centre))
    y = np.cross(centre, x)
    side = np.cos(angles_rad)[:, None] * x + np.sin(angles_rad)[:, None] * y
    return np.cos(radii_rad)[:, None] * centre + np.sin(radii_rad)[:, None] * side


def polygon_around(centre, radius_rad, shares, angles_rad):
    return Polygon(tuple(map(tuple, around(centre, radius_rad * shares, angles_rad).tolist())))


def winding(v, corners):
    """Turns (n,) of a polygon's outline around directions (n, 3): another rule than the tested."""
    total = np.zeros(len(v))
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        to_a, to_b = (c - (v @ c)[:, None] * v for c in (a, b))
        total += np.arctan2(
            np.einsum("ij,ij->i", np.cross(to_a, to_b), v), np.einsum("ij,ij->i", to_a, to_b)
        )
    return np.rint(total / (2 * np.pi)).astype(int)


CENTRES = [(0, 0), (359.9999, 10), (123, 90), (40, -90), (77, 89.9), (200, -45)]


@pytest.mark.parametrize("where", CENTRES)
@pytest.mark.parametrize("radius_rad", [0.01 * ARCSEC_RAD, 1e-4, 0.3, 2.0, np.pi])
def test_against_erfa_cone(where, radius_rad):
    rng = np.random.default_rng(1)
    centre = directions(*where)
    v = unit(around(centre, rng.uniform(0, min(2 * radius_rad, np.pi), 500),
                    rng.uniform(0, 6.3, 500)))  # fmt: skip
    region = Cone(tuple(centre.tolist()), radius_rad)
    apart = erfa.sepp(v, np.broadcast_to(centre, v.shape))
    assert np.abs(region.outside_rad(v) - (apart - radius_rad)).max() < 1e-15 + 4e-16 * 4
    assert (region.holds(v) == (region.outside_rad(v) <= 0.0)).all()


@settings(max_examples=80)
@given(
    ra=st.floats(0, 360), dec=st.floats(-90, 90), seed=st.integers(0, 2**32),
    log_radius=st.floats(np.log(0.01 * ARCSEC_RAD), np.log(1.5)), corners=st.integers(3, 12),
    star=st.booleans(), turned=st.booleans(),
)  # fmt: skip
def test_against_winding_number(ra, dec, seed, log_radius, corners, star, turned):
    """Polygons seen from their centre in order of position angle, convex or not, at any scale."""
    rng, radius = np.random.default_rng(seed), float(np.exp(log_radius))
    angles = 2 * np.pi * (np.arange(corners) + rng.uniform(0.05, 0.6, corners)) / corners
    assume(np.diff([*angles, angles[0] + 2 * np.pi]).max() < 3.0)
    shares = rng.uniform(0.3, 1.0, corners) if star else np.ones(corners)
    centre = directions(ra, dec)
    region = polygon_around(centre, radius, shares, -angles if turned else angles)
    v = np.concatenate([
        unit(around(centre, rng.uniform(0, 1.3 * radius, 300), rng.uniform(0, 6.3, 300))),
        unit(rng.normal(size=(50, 3))), -centre[None],
    ])  # fmt: skip
    off = region.outside_rad(v)
    clear = np.abs(off) > 1e-14 + 1e-9 * radius
    ahead = v @ np.array(region.centre) > 0.0  # an outline winds about the antipodes as well
    within = ahead & (winding(v, np.array(region.corners)) != 0)
    assert (region.holds(v) == within)[clear].all()
    assert (region.holds(v) == (off < 0.0)).all()


def test_against_dense_outline():
    """Distances to a polygon are those to the nearest of many points along its arcs."""
    rng = np.random.default_rng(3)
    for radius in (1e-6, 0.02, 1.2):
        centre = unit(rng.normal(size=3))
        angles = np.sort(rng.uniform(0, 2 * np.pi, 5))
        region = polygon_around(centre, radius, rng.uniform(0.4, 1.0, 5), angles)
        corners = np.array(region.corners)
        t = np.linspace(0, 1, 4001)[:, None]
        outline = np.concatenate([
            unit(a + t * (b - a)) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)
        ])  # fmt: skip
        v = unit(around(centre, rng.uniform(0, 2 * radius, 60), rng.uniform(0, 6.3, 60)))
        v = np.concatenate([v, unit(rng.normal(size=(20, 3)))])
        nearest = np.array([erfa.sepp(np.broadcast_to(p, outline.shape), outline).min() for p in v])
        assert np.abs(np.abs(region.outside_rad(v)) - nearest).max() < 1e-3 * radius
        assert (np.array(region.centre) @ corners.T).min() > np.cos(region.radius_rad) - 1e-15


def test_limits_polygon_over_the_pole_and_over_ra_zero():
    pole = polygon_of([(0, 80), (90, 80), (180, 80), (270, 80)])
    inside = directions(np.array([0.0, 45.0, 200.0]), np.array([90.0, 83.0, 82.5]))
    assert pole.holds(inside).tolist() == [True, True, True]
    assert not pole.holds(directions(np.array([45.0]), np.array([80.5])))[0]  # beyond the chord
    wrap = polygon_of([(359, -1), (1, -1), (1, 1), (359, 1)])
    at = directions(np.array([0.0, 359.5, 0.5, 180.0]), np.array([0.0, 0.5, -0.5, 0.0]))
    assert wrap.holds(at).tolist() == [True, True, True, False]


def test_limits_nearly_a_hemisphere():
    ring = [(ra, 0.5) for ra in range(0, 360, 10)]
    nearly = polygon_of(ring)
    assert nearly.radius_rad == pytest.approx(np.radians(89.5), abs=1e-9)
    assert nearly.holds(directions(np.array([5.0]), np.array([1.0])))[0]
    assert not nearly.holds(directions(np.array([5.0]), np.array([0.0])))[0]
    corner = polygon_of([(0, 0), (89, 0), (45, 89)])  # its corners' mean is no bad centre either
    assert corner.radius_rad < np.radians(60)


@pytest.mark.parametrize(
    ("corners", "what"),
    [
        ([(0, 0), (1, 0)], "corners"),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], "differ"),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], "cross"),
        ([(ra, -1.0) for ra in range(0, 360, 90)] + [(45, 80)], "hemisphere|cross"),
        ([(0, 0), (120, 0), (240, 0)], "hemisphere"),
        ([(0, 0), (1, 91), (0, 1)], "declinations"),
        ([(0, 0), (1, -91), (0, -1)], "declinations"),
        ([(0, 0), (1, float("nan")), (0, 1)], "finite"),
        ([1, 2, 3], "pairs"),
        ([(i, 0.01 * (i % 2)) for i in range(1001)], "corners"),
    ],
)
def test_bad_polygons(corners, what):
    with pytest.raises(BadInput, match=what) as caught:
        polygon_of(corners)
    assert caught.value.field == "polygon"


def test_bad_cones():
    for values, field in (((0, 91, 1), "dec_deg"), ((0, 0, 0), "radius_deg")):
        with pytest.raises(BadInput) as caught:
            cone_of(*values)
        assert caught.value.field == field


def test_a_cap_within_a_polygon_holds_nothing_from_outside():
    """Of a square to its sides; of a hook whose cap's centre is beside it: none."""
    square = polygon_of([(-3, -3), (3, -3), (3, 3), (-3, 3)])
    assert square.inner_radius_rad == pytest.approx(np.radians(3.0), rel=0.01)
    hook = polygon_of([(0, 0), (20, 0), (20, 1), (1, 1), (1, 20), (0, 20)])
    assert not hook.holds(np.array([hook.centre]))[0]
    assert hook.inner_radius_rad == 0.0
