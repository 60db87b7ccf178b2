"""Moffat and Kolmogorov profiles against closed forms, quadrature, published figures and GalSim."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import gamma, j0

from pipeline.physics.psf.pupil import Airy
from pipeline.physics.psf.radial import Radial, light_beyond
from pipeline.physics.psf.seeing import KOLMOGOROV_FWHM, Kolmogorov, Moffat, r0_at, r0_m

BETAS = [1.5, 2.0, 2.5, 4.765, 12.0, 50.0]


def hankel(intensity, f: float, scale: float) -> float:  # type: ignore[no-untyped-def]
    """2 pi int I(r) J0(2 pi f r) r dr by Gauss-Legendre in pieces of a quarter wave or less."""
    nodes, weights = np.polynomial.legendre.leggauss(10)
    edges = np.concatenate([[0.0], np.geomspace(1e-3, 3e3, 4000) * scale])
    edges = np.unique(np.concatenate([edges, np.arange(0.0, 3e3 * scale, 0.5 / max(f, 1e-3))]))
    half = 0.5 * np.diff(edges)[:, None]
    r = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * nodes
    return float((half * weights * 2 * np.pi * r * intensity(r) * j0(2 * np.pi * f * r)).sum())


@pytest.mark.parametrize("beta", BETAS[2:])
def test_against_hankel_transform_moffat(beta: float) -> None:
    m = Moffat(3.0, beta)
    for f in (1e-4, 0.02, 0.1, 0.2):
        assert float(m.radial(np.array(f))) == pytest.approx(hankel(m.intensity, f, 3.0), abs=2e-6)


@pytest.mark.parametrize("beta", BETAS)
def test_moffat_width_light_and_wings(beta: float) -> None:
    m = Moffat(2.6, beta)
    assert m.intensity(np.array(1.3)) == pytest.approx(0.5 * m.intensity(np.array(0.0)), rel=1e-12)
    for r in (0.5, 3.0, 20.0):
        inside = quad(lambda a: 2 * np.pi * a * float(m.intensity(np.array(a))), 0.0, r)[0]
        assert m.light_beyond(r) == pytest.approx(1.0 - inside, abs=1e-9)
        top = m.band_limit(1e-14)
        assert light_beyond(m.radial, top, r) == pytest.approx(m.light_beyond(r), abs=1e-9)
    assert m.has_wings == (m.light_beyond(24 * 2.6) > 1e-8)


@pytest.mark.parametrize("optics", [Moffat(0.1, 1.5), Moffat(100.0, 50.0), Kolmogorov(0.05),
                                    Kolmogorov(120.0), Kolmogorov(120.0, Airy(0.1, 0.95)),
                                    Kolmogorov(0.01, Airy(8.0))])  # fmt: skip
def test_limits_seeing_is_finite_and_falls(optics: Radial) -> None:
    f = np.concatenate([[0.0, 1e-300, 1e-12], np.geomspace(1e-9, 1e3, 400)])
    values = optics.radial(f)
    assert values[0] == pytest.approx(1.0, abs=1e-12)
    assert np.isfinite(values).all()
    assert (np.diff(values) <= 2e-8).all()  # the annulus' lenses round by 1e-8 at f of 1e-9
    light = [optics.light_beyond(r) for r in np.geomspace(1e-4, 1e6, 200)]
    assert light[0] == pytest.approx(1.0, abs=1e-3)
    assert (np.diff(light) <= 0).all()
    assert light[-1] < 1e-2


@pytest.mark.parametrize("optics", [Moffat(3.0, 1.5), Moffat(1.0, 2.5), Moffat(2.0, 4.765),
                                    Kolmogorov(3.0), Kolmogorov(4.0, Airy(0.7, 0.3))])  # fmt: skip
def test_the_radial_table_errs_by_less_than_stated(optics: Radial) -> None:
    rng = np.random.default_rng(1)
    f = rng.uniform(0, 1.2 * optics.band_limit(1e-12), 20_000)
    angle = rng.uniform(0, 2 * np.pi, f.size)
    looked_up = optics.transfer(f * np.sin(angle), f * np.cos(angle))
    assert np.abs(looked_up - optics.radial(f)).max() < 1e-6


@settings(max_examples=40)
@given(st.floats(0.2, 100.0), st.floats(1.5, 50.0), st.floats(1e-9, 0.1))
def test_band_limit_is_where_the_transfer_reaches_the_floor(
    fwhm: float, beta: float, floor: float
) -> None:
    m = Moffat(fwhm, beta)
    assert float(m.radial(np.array([m.band_limit(floor)]))[0]) == pytest.approx(floor, rel=1e-6)


def test_against_published_kolmogorov_width() -> None:
    """FWHM = 0.976 lambda / r0 (Fried 1966; 0.98 in textbooks); one arcsec is r0 = 10.1 cm."""
    k = Kolmogorov(5.0)
    assert pytest.approx(0.976, abs=5e-4) == KOLMOGOROV_FWHM
    centre, half = k.intensity(np.array([0.0, 0.5 * k.fwhm_px]))
    assert half == pytest.approx(0.5 * centre, rel=2e-6)
    assert r0_m(np.radians(1.0 / 3600), 500e-9) == pytest.approx(0.101, abs=5e-4)
    wider = r0_m(1.0, 500e-9) / r0_at(r0_m(1.0, 500e-9), 500e-9, 1000e-9)
    assert wider == pytest.approx(2.0**-1.2)  # so that the FWHM goes with lambda^(-1/5)


def test_against_closed_forms_of_kolmogorov() -> None:
    """Central intensity pi s^2 Gamma(11/5), far light 2^(5/3) Gamma(11/6) / Gamma(1/6)."""
    k = Kolmogorov(3.0)
    f0 = 1.0 / (3.0 * float((4.8 * gamma(1.2)) ** 0.5))  # exp(-(f / f0)^(5/3))
    centre = float(k.intensity(np.array([0.0]))[0])
    assert centre == pytest.approx(np.pi * f0**2 * gamma(2.2), rel=1e-9)
    for r, within in ((150.0, 1e-2), (3000.0, 2e-3), (1e5, 2e-2)):
        tail = (np.pi * f0 * r) ** (-5 / 3) * gamma(11 / 6) / gamma(1 / 6)
        assert k.light_beyond(r) == pytest.approx(tail, rel=within)


@pytest.mark.parametrize("r", [1.0, 4.0, 20.0, 300.0, 1500.0])
def test_against_quadrature_light_beyond_seeing_and_telescope(r: float) -> None:
    k = Kolmogorov(3.0, Airy(0.7, 0.3))
    exact = light_beyond(k.radial, 1.0 / 0.7, r)
    assert k.light_beyond(r) == pytest.approx(exact, rel=2e-2)
    # Far out the far light of both causes adds up.
    if r >= 300.0:
        both = Kolmogorov(3.0).light_beyond(r) + Airy(0.7, 0.3).light_beyond(r)
        assert exact == pytest.approx(both, rel=5e-2)


def test_seeing_multiplies_the_telescope() -> None:
    air, telescope = Kolmogorov(2.0), Airy(0.5, 0.4)
    f = np.linspace(0.0, 2.5, 300)
    both = Kolmogorov(2.0, telescope).radial(f)
    assert np.allclose(both, air.radial(f) * telescope.radial(f), rtol=1e-14, atol=0)
    assert Kolmogorov(2.0, telescope).band_limit(1e-9) <= 2.0 + 1e-9


@pytest.mark.parametrize("beta", [1.6, 2.5, 4.765])
def test_against_galsim_moffat(beta: float) -> None:
    galsim = pytest.importorskip("galsim")
    g, m = galsim.Moffat(beta=beta, fwhm=2.2), Moffat(2.2, beta)
    f = np.linspace(0.0, 0.9, 60)
    theirs = np.array([g.kValue(2 * np.pi * a, 0.0).real for a in f])
    assert np.abs(m.radial(f) - theirs).max() < 1e-12
    r = np.array([0.0, 0.7, 3.0, 8.0])
    assert m.intensity(r) == pytest.approx([g.xValue(a, 0.0) for a in r], rel=1e-9)


def test_against_galsim_kolmogorov() -> None:
    galsim = pytest.importorskip("galsim")
    g, k = galsim.Kolmogorov(lam_over_r0=2.5), Kolmogorov(2.5)
    f = np.linspace(0.0, 0.8, 60)
    theirs = np.array([g.kValue(2 * np.pi * a, 0.0).real for a in f])
    assert np.abs(k.radial(f) - theirs).max() < 1e-5
    assert k.fwhm_px == pytest.approx(g.fwhm, rel=1e-5)
    r = np.array([0.0, 1.0, 3.0, 12.0, 60.0])
    assert k.intensity(r) == pytest.approx([g.xValue(a, 0.0) for a in r], rel=1e-4)
