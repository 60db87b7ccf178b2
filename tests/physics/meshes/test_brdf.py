"""Surfaces: no more light goes out than comes in, both ways alike, and known values."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.physics.meshes import brdf
from pipeline.physics.meshes.brdf_table import brdf_table, reciprocity_error
from pipeline.physics.vectors import unit

UP = np.array([0.0, 0.0, 1.0])

MODELS = {
    "lambert": lambda n, s, o: brdf.lambert(n, s, o, 1.0),
    "phong": lambda n, s, o: brdf.phong(n, s, o, 0.4, 0.6, 30.0),
    "phong_wide": lambda n, s, o: brdf.phong(n, s, o, 0.0, 1.0, 0.0),
    "paint": lambda n, s, o: brdf.cook_torrance(n, s, o, 1.0, 0.3, None, 0.04),
    "foil": lambda n, s, o: brdf.cook_torrance(n, s, o, 0.0, 0.1, None, 1.0),
    "rough": lambda n, s, o: brdf.cook_torrance(n, s, o, 1.0, 1.0, None, 0.5),
    "aluminium": lambda n, s, o: brdf.cook_torrance(n, s, o, 0.2, 0.4, 1.0 + 6.7j),
    "glass": lambda n, s, o: brdf.cook_torrance(n, s, o, 1.0, 0.2, 1.5 + 0j),
    "cell": lambda n, s, o: brdf.ashikhmin_shirley(n, s, o, 1.0, 0.1, 200.0, 200.0),
    "brushed": lambda n, s, o: brdf.ashikhmin_shirley(n, s, o, 0.3, 0.7, 10.0, 150.0),
}


def _direction(theta, phi):
    sine = np.sin(theta)
    return np.stack(
        np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)), axis=-1
    )


def _albedo(model, sun):
    """Light reflected over the hemisphere, by a fine rule in theta and phi about the mirror."""
    nodes, weights = np.polynomial.legendre.leggauss(160)
    theta, dt = np.pi / 4 * (nodes + 1), np.pi / 4 * weights
    phi = (np.arange(360) + 0.5) / 360 * 2 * np.pi
    o = _direction(theta[:, None], phi[None, :])
    f = model(UP, sun, o)
    weight = (np.sin(theta) * np.cos(theta) * dt)[:, None] * (2 * np.pi / 360)
    return float(np.sum(f * weight))


@pytest.mark.parametrize("name", MODELS)
def test_no_surface_reflects_more_light_than_falls_on_it(name):
    for theta in (0.0, 0.4, 0.9, 1.3, 1.5):
        assert _albedo(MODELS[name], _direction(theta, 0.3)) <= 1.0 + 1e-6


def test_matt_and_phong_reflect_just_what_they_say_at_normal_incidence():
    assert _albedo(MODELS["lambert"], UP) == pytest.approx(1.0, abs=1e-9)
    assert _albedo(MODELS["phong"], UP) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(("exponent", "wanted"), [(0.5, 0.281349), (2.5, 0.126607), (3, 0.099472)])
def test_a_lobe_of_phong_falls_by_whole_and_broken_powers(exponent, wanted):
    """60 deg from the mirror: (n + 2) / (2 pi) / 2**n (Lafortune & Willems 1994, eq. 10)."""
    observer = _direction(np.pi / 3, 0.3)
    assert brdf.phong(UP, UP, observer, 0.0, 1.0, exponent) == pytest.approx(wanted, rel=1e-5)


def test_a_smooth_ggx_mirror_keeps_nearly_all_its_light():
    # what bounces twice between the microfacets is lost; for alpha = 0.1 about 1%
    assert 0.98 < _albedo(MODELS["foil"], UP) < 1.0


@given(
    name=st.sampled_from(sorted(MODELS)),
    angles=st.tuples(*[st.floats(0.0, 1.55), st.floats(0, 6.3)] * 2),
)
def test_same_when_sun_and_observer_change_places(name, angles):
    a, b = _direction(angles[0], angles[1]), _direction(angles[2], angles[3])
    there, back = MODELS[name](UP, a, b), MODELS[name](UP, b, a)
    assert there == pytest.approx(back, rel=1e-9)
    assert there >= 0.0


@pytest.mark.parametrize("name", MODELS)
def test_limits_from_behind_nothing(name):
    model, below = MODELS[name], np.array([0.6, 0.0, -0.8])
    assert model(UP, UP, below) == 0.0
    assert model(UP, below, UP) == 0.0
    assert np.isfinite(model(UP, np.array([1.0, 0.0, 0.0]), UP))


def test_against_published_reflectances():
    # Born & Wolf: glass n = 1.5 reflects 4% at normal incidence, all of it grazing
    assert brdf.fresnel(1.0, 1.5) == pytest.approx(0.04)
    assert brdf.fresnel(0.0, 1.5) == pytest.approx(1.0)
    # Brewster's angle: half of s-polarised light, ((n^2 - 1)/(n^2 + 1))^2 / 2
    assert brdf.fresnel(np.cos(np.arctan(1.5)), 1.5) == pytest.approx(0.5 * (1.25 / 3.25) ** 2)
    # aluminium at 550 nm, n = 0.958 + 6.69i (Rakic 1995): 92%
    assert brdf.fresnel(1.0, 0.958 + 6.69j) == pytest.approx(0.92, abs=0.005)


def _table(f, n=19, m=25):
    t, p = np.linspace(0, np.pi / 2, n), np.linspace(0, np.pi, m)
    s, o = _direction(t[:, None, None], 0.0), _direction(t[None, :, None], p[None, None, :])
    return t, t, p, np.broadcast_to(f(UP, s, o), (n, n, m))


def test_a_table_gives_its_own_values_and_those_between():
    model = MODELS["rough"]
    t, _, p, value = _table(model, 91, 91)
    value = np.where(np.isfinite(value), value, 0.0)
    table = brdf_table(t, t, p, value)
    assert table(UP, _direction(t[20], 0.7), _direction(t[33], 0.7 + p[50])) == pytest.approx(
        value[20, 33, 50]
    )
    rng = np.random.default_rng(4)
    a, b = (_direction(rng.uniform(0, 1.2, 200), rng.uniform(0, 6.3, 200)) for _ in "ab")
    np.testing.assert_allclose(table(UP, a, b), model(UP, a, b), rtol=5e-3)
    assert reciprocity_error(value) < 1e-12


def test_a_table_is_made_the_same_both_ways():
    t = np.deg2rad([0.0, 45.0, 90.0])
    value = np.full((3, 3, 1), 0.2)
    value[0, 1] = 0.1
    table = brdf_table(t, t, [0.0], value)
    a, b = _direction(0.1, 0.0), _direction(0.7, 2.0)
    assert table(UP, a, b) == pytest.approx(table(UP, b, a))


@pytest.mark.parametrize(
    ("t", "value", "word"),
    [
        ([0.0, 0.5], np.full((2, 2, 1), 0.5), "at most all"),
        ([0.0, 0.5], np.full((2, 2, 1), -0.1), ">= 0"),
        ([0.0, 0.5], np.full((2, 2, 1), np.nan), ">= 0"),
        ([0.5, 0.0], np.full((2, 2, 1), 0.1), "rise"),
        ([0.0, 3.0], np.full((2, 2, 1), 0.1), "<= 90"),
        ([0.0, 0.5], np.full((2, 3, 1), 0.1), "direction"),
        ([], np.full((0, 0, 1), 0.1), "rise"),
    ],
)
def test_bad_tables_are_refused(t, value, word):
    with pytest.raises(BadInput, match=word):
        brdf_table(t, t, [0.0], value)


def _random_frames(seed, n=200):
    """Normals, grains along them, and the Sun's and the observer's directions above them."""
    rng = np.random.default_rng(seed)
    normal, hint, *other = (unit(rng.normal(size=(n, 3))) for _ in range(4))
    grain = unit(hint - np.sum(hint * normal, -1, keepdims=True) * normal)
    up = [v * np.sign(np.sum(v * normal, -1, keepdims=True)) for v in other]
    return normal, grain, *up


def test_against_the_published_formula_of_ashikhmin_and_shirley():
    """Their equations 4 and 5 by the half vector's azimuth from the grain, in any frame."""
    n, u, s, o = _random_frames(1)
    h = unit(s + o)
    dot = lambda a, b: np.sum(a * b, -1)  # noqa: E731
    turn = np.arctan2(dot(np.cross(n, u), h), dot(u, h))
    power = 12.0 * np.cos(turn) ** 2 + 90.0 * np.sin(turn) ** 2
    gloss = np.sqrt(13.0 * 91.0) / (8.0 * np.pi) * dot(n, h) ** power
    gloss /= dot(h, s) * np.maximum(dot(n, s), dot(n, o))
    gloss *= 0.3 + 0.7 * (1.0 - dot(h, s)) ** 5
    matt = 28.0 * 0.5 / (23.0 * np.pi) * 0.7
    for v in (s, o):
        matt = matt * (1.0 - (1.0 - dot(n, v) / 2.0) ** 5)
    found = brdf.ashikhmin_shirley(n, s, o, 0.5, 0.3, 12.0, 90.0, u + 0.7 * n)
    np.testing.assert_allclose(found, gloss + matt, rtol=1e-9)


def test_a_grain_is_laid_on_its_surface_or_any_direction_of_it_where_it_is_normal():
    """As near as can be to the grain; one along the normal, to rounding, gives no noise."""
    n, u, *_ = _random_frames(3)
    for length in (1e-12, 1.0, 1e6):
        np.testing.assert_allclose(brdf._laid_on(n, length * (u + 3.0 * n)), u, rtol=0, atol=1e-12)
        along = brdf._laid_on(n, length * n)
        np.testing.assert_allclose(np.sum(along * along, -1), 1.0, rtol=1e-12)
        assert np.abs(np.sum(along * n, -1)).max() < 1e-12


def test_against_the_published_formula_of_ggx():
    """D and Smith's correlated G as Heitz 2014 writes them, with tangents; Schlick's F."""
    n, _, s, o = _random_frames(2)
    h = unit(s + o)
    dot = lambda a, b: np.sum(a * b, -1)  # noqa: E731
    cosines = (dot(n, s), dot(n, o), dot(n, h))
    tan2 = [1.0 / c**2 - 1.0 for c in cosines]
    alpha = 0.35
    d = 1.0 / (np.pi * alpha**2 * cosines[2] ** 4 * (1.0 + tan2[2] / alpha**2) ** 2)
    g = 1.0 / (1.0 + sum(0.5 * (np.sqrt(1.0 + alpha**2 * t) - 1.0) for t in tan2[:2]))
    f = [0.1 + 0.9 * (1.0 - c) ** 5 for c in (dot(s, h), *cosines[:2])]
    expected = f[0] * d * g / (4.0 * cosines[0] * cosines[1])
    expected += 0.6 / np.pi * (1.0 - f[1]) * (1.0 - f[2])
    found = brdf.cook_torrance(n, s, o, 0.6, alpha, None, 0.1)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_table_with_axes_of_its_own_is_read_along_each():
    """A product of three lines, which a trilinear table holds on any grid; and its whole light."""
    t, p, q = np.array([0.0, 0.2, 0.9, 1.5]), np.array([0.0, 1.1, 1.5]), np.array([0.0, 1.0, np.pi])
    lines = lambda a, b, c: 0.1 * (1 + 0.3 * a) * (1 + 0.5 * b) * (1 + 0.2 * c)  # noqa: E731
    table = brdf_table(t, p, q, lines(t[:, None, None], p[:, None], q))
    n, _, s, o = _random_frames(3)
    a, b = (np.arccos(np.clip(np.sum(n * v, -1), -1, 1)) for v in (s, o))
    level = [unit(v - np.sum(n * v, -1, keepdims=True) * n) for v in (s, o)]
    c = np.arccos(np.clip(np.sum(level[0] * level[1], -1), -1, 1))
    np.testing.assert_allclose(table(n, s, o), lines(*np.minimum([a, b], 1.5), c), rtol=1e-6)
    x, w = np.polynomial.legendre.leggauss(400)
    b = np.pi / 4 * (x + 1)
    light = np.pi / 4 * w @ (lines(0.7, np.minimum(b, 1.5), 0.0) * np.sin(2 * b))
    assert table.reflected_share([0.7])[0] == pytest.approx(light * np.pi * (1 + 0.1 * np.pi),
                                                            rel=1e-3)  # fmt: skip
