"""Surfaces: no more light goes out than comes in, both ways alike, and known values."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.physics.meshes import brdf
from pipeline.physics.meshes.brdf_table import brdf_table, reciprocity_error

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
    ],
)
def test_bad_tables_are_refused(t, value, word):
    with pytest.raises(BadInput, match=word):
        brdf_table(t, t, [0.0], value)
