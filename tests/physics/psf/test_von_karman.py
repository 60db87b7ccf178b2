"""Seeing with an outer scale against the integral of its spectrum, its limits and GalSim."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import gamma, j0

from pipeline.physics.psf.pupil import Airy
from pipeline.physics.psf.seeing import KOLMOGOROV_EXPONENT, Kolmogorov
from pipeline.physics.psf.von_karman import (
    LEAST_ALONE_R0,
    SATURATES,
    SERIES_UP_TO,
    VonKarman,
    levelled,
)

# GalSim 2.8.5: VonKarman(lam=500, r0=0.1, L0=5) at 0.1, 0.3, 0.6, 1 cycles per arcsec.
GALSIM = (0.9386520857020589, 0.7015828638165365, 0.36193719334379043, 0.1160842252574117)
LAMBDA_OVER_R0 = 500e-9 / 0.1 / np.radians(1.0 / 3600.0)


def structure(rho_r0: float, outer_r0: float) -> float:
    """4 pi int W(k) (1 - J0(2 pi k rho)) k dk of W = 0.0229 r0^(-5/3) (k^2 + L0^-2)^(-11/6)."""

    def rings(log_k: float) -> float:
        k = np.exp(log_k)
        bend = float(1.0 - j0(2 * np.pi * k * rho_r0))
        return 4 * np.pi * 0.022896 * (k**2 + outer_r0**-2) ** (-11 / 6) * bend * k**2

    edges = np.linspace(np.log(1e-6 / outer_r0), np.log(300.0 / rho_r0), 400)
    return sum(quad(rings, a, b)[0] for a, b in pairwise(edges))


def test_constants_are_those_of_their_formulas() -> None:
    assert pytest.approx((24 * gamma(6 / 5) / 5) ** (5 / 6), rel=1e-15) == KOLMOGOROV_EXPONENT
    share = gamma(11 / 6) * gamma(5 / 6) / (2 * np.pi ** (8 / 3))
    assert pytest.approx(share * KOLMOGOROV_EXPONENT, rel=1e-15) == SATURATES


@pytest.mark.parametrize("outer_r0", [20.0, 150.0, 3000.0])
@pytest.mark.parametrize("rho_r0", [0.05, 0.6, 2.0])
def test_against_the_integral_of_the_spectrum(rho_r0: float, outer_r0: float) -> None:
    air = VonKarman(1.0, outer_scale_r0=outer_r0).air(np.array([rho_r0]))
    assert float(-2 * np.log(air)[0]) == pytest.approx(structure(rho_r0, outer_r0), rel=2e-4)


def test_against_galsim() -> None:
    f = np.array([0.1, 0.3, 0.6, 1.0])
    seeing = VonKarman(LAMBDA_OVER_R0, outer_scale_r0=50.0)
    assert seeing.radial(f) == pytest.approx(GALSIM, abs=1e-6)
    galsim = pytest.importorskip("galsim")
    theirs = galsim.VonKarman(lam=500, r0=0.1, L0=5.0)
    f = np.linspace(0.0, 1.5, 40)
    wanted = [theirs.kValue(2 * np.pi * a, 0.0).real for a in f]
    assert np.abs(seeing.radial(f) - wanted).max() < 1e-6


def test_limits_without_end_and_far_beyond() -> None:
    """Kolmogorov's but for 1.485 (rho / L0)^(1/3) where the outer scale is far; level beyond it."""
    f = np.array([0.05, 0.3, 1.0])
    kolmogorov = -np.log(Kolmogorov(1.0).air(f))
    for outer in (1e5, 1e8):
        ratio = -np.log(VonKarman(1.0, outer_scale_r0=outer).air(f)) / kolmogorov
        assert 1.0 - ratio == pytest.approx(1.485 * (f / outer) ** (1 / 3), rel=5e-3)
    x = np.concatenate([[0.0, 1e-300, 1e-12], np.geomspace(1e-9, 1e6, 500)])
    assert levelled(x)[0] == 0.0
    assert levelled(x)[-1] == 1.0
    assert (np.diff(levelled(x)) >= 0).all()
    beside = np.array([SERIES_UP_TO * (1 - 1e-12), SERIES_UP_TO])
    assert float(np.diff(levelled(beside))[0]) == pytest.approx(0.0, abs=2e-12)


@pytest.mark.parametrize("outer_r0", [LEAST_ALONE_R0, 100.0, 250.0, 2000.0])
def test_width_of_its_own_light(outer_r0: float) -> None:
    seeing = VonKarman(3.0, outer_scale_r0=outer_r0)
    centre = float(seeing.intensity(np.array([0.0]))[0])
    half = brentq(lambda r: float(seeing.intensity(np.array([r]))[0]) - centre / 2, 0.1, 4.0)
    assert 2.0 * half == pytest.approx(seeing.fwhm_px, rel=0.012)
    assert seeing.fwhm_px < Kolmogorov(3.0).fwhm_px


def test_it_multiplies_the_telescope_and_is_a_response_of_its_own() -> None:
    f = np.linspace(0.0, 2.2, 200)
    seeing = VonKarman(2.0, Airy(0.5, 0.4), outer_scale_r0=80.0)
    air = VonKarman(2.0, outer_scale_r0=80.0).radial(f)
    assert np.allclose(seeing.radial(f), air * Airy(0.5, 0.4).radial(f), rtol=1e-14, atol=0)
    assert seeing != Kolmogorov(2.0, Airy(0.5, 0.4))
    assert np.abs(seeing.transfer(np.zeros(200), f) - seeing.radial(f)).max() < 1e-6
