"""Hankel transforms and look-ups of round blurs against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j0, j1

from pipeline.physics.psf.band import mixture
from pipeline.physics.psf.pupil import Airy, EllipticalGaussian, Gaussian
from pipeline.physics.psf.radial import (
    _light_table,
    falling_to,
    intensity,
    light_beyond,
    light_table,
    look_up,
    mean_over_directions,
)
from pipeline.physics.psf.seeing import Kolmogorov


@pytest.mark.parametrize("q", [0.1, 1.0, 8.0])
@pytest.mark.parametrize("times", [0.3, 1.22, 5.0, 60.0])
def test_against_rayleigh_light_beyond_in_the_airy_pattern(q: float, times: float) -> None:
    x = np.pi * times
    closed = j0(x) ** 2 + j1(x) ** 2
    assert light_beyond(Airy(q).radial, 1.0 / q, times * q) == pytest.approx(closed, abs=1e-8)


@pytest.mark.parametrize("sigma", [0.05, 1.0, 50.0])
def test_against_closed_form_light_beyond_a_gaussian(sigma: float) -> None:
    g = Gaussian(sigma)
    mtf = lambda f: g.transfer(np.zeros_like(f), f)  # noqa: E731
    for times in (0.1, 1.0, 3.0, 5.0):
        exact = g.light_beyond(times * sigma)
        assert light_beyond(mtf, g.band_limit(1e-14), times * sigma) == pytest.approx(
            exact, abs=1e-10
        )


@pytest.mark.parametrize(("q", "eps"), [(1.0, 0.0), (0.1, 0.3), (8.0, 0.95)])
def test_against_closed_form_intensity(q: float, eps: float) -> None:
    airy = Airy(q, eps)
    r = q * np.array([0.0, 0.4, 1.1, 3.7, 20.3])
    got = intensity(airy.radial, 1.0 / q, r)
    peak = float(airy.intensity(np.zeros(1))[0])
    assert got == pytest.approx(airy.intensity(r), abs=3e-6 * peak)
    g = Gaussian(2.0)
    at = np.array([0.0, 3.0])
    mtf = lambda f: g.transfer(np.zeros_like(f), f)  # noqa: E731
    assert intensity(mtf, g.band_limit(1e-14), at) == pytest.approx(g.intensity(at), rel=1e-10)


@pytest.mark.parametrize("nodes", [5, 40])
def test_against_cubics_a_table_is_read_exactly_up_to_both_ends(nodes: int) -> None:
    """Also before the second node and after the last but one, where no node lies beyond."""
    cubic, top = np.polynomial.Polynomial([2.0, -0.3, 0.05, 0.004]), 3.7
    n = nodes - 1
    t = np.append(np.linspace(0.0, n, 9 * n, endpoint=False), [1e-9, n - 1e-6])
    read = look_up(top * (t / n) ** 2, top, cubic(np.arange(nodes)))
    np.testing.assert_allclose(read, cubic(t), rtol=1e-11)
    assert look_up(np.array([top, 2.0 * top]), top, cubic(np.arange(nodes))).tolist() == [0.0, 0.0]


def test_intensity_of_the_airy_pattern_holds_all_light() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(12)
    edges = np.linspace(0.0, 40.0, 400)
    half = 0.5 * np.diff(edges)[:, None]
    r = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * nodes
    for eps in (0.0, 0.5):
        held = float((half * weights * 2 * np.pi * r * Airy(1.0, eps).intensity(r)).sum())
        assert 1.0 - held == pytest.approx(Airy(1.0, eps).light_beyond(40.0), rel=2e-2)


def test_mean_over_directions_of_an_uneven_blur() -> None:
    """Light beyond r of an elliptical Gaussian, by quadrature over the angle."""
    e = EllipticalGaussian(2.0, 0.8, 0.7)
    angle = np.pi * (np.arange(4000) + 0.5) / 4000
    inverse = (np.cos(angle) / 2.0) ** 2 + (np.sin(angle) / 0.8) ** 2
    for r in (0.5, 1.5, 4.0):
        exact = float(np.mean(np.exp(-0.5 * r**2 * inverse) / inverse)) / (2.0 * 0.8)
        got = light_beyond(mean_over_directions(e.transfer), e.band_limit(1e-13), r)
        assert got == pytest.approx(exact, abs=1e-9)
        assert exact <= e.light_beyond(r)


def test_light_table_follows_the_rings() -> None:
    airy = Airy(1.0, 0.3)
    table = light_table(airy.radial, 1.0, 1.0, 200.0)
    for r in (0.05, 0.7, 3.3, 19.0, 150.0, 3000.0):
        exact = light_beyond(airy.radial, 1.0, r)
        assert table(r) == pytest.approx(exact, rel=4e-2)
    radii = np.geomspace(0.001, 1e4, 500)
    assert (np.diff([table(r) for r in radii]) <= 0).all()


def test_falling_to_finds_the_floor() -> None:
    assert falling_to(lambda f: np.exp(-f), 1e-3, 0.01) == pytest.approx(np.log(1e3), rel=1e-12)


def test_light_of_a_band_of_many_wavelengths_is_tabulated_once() -> None:
    """A table takes 20 ms; a search for a radius asks all of them 70 times."""
    seen = tuple(Kolmogorov(0.05, Airy(0.1 + 0.003 * k)) for k in range(40))
    band = mixture(seen, (1.0 / 40.0,) * 40)
    before = _light_table.cache_info().misses
    beyond = [band.light_beyond(r) for r in (3.0, 7.0, 20.0)]
    assert _light_table.cache_info().misses - before == 40
    assert beyond[0] > beyond[1] > beyond[2] > 0.0
