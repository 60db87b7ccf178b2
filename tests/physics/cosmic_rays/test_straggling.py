"""Energy loss: Landau's law against SciPy, its most probable and mean values against PDG."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from scipy import integrate, stats

from pipeline.physics.cosmic_rays.straggling import (
    BINDING_EV,
    ELECTRON_EV,
    PAIR_EV,
    PLASMA_EV,
    electron_range_um,
    landau,
    loss_ev,
    restricted_loss_ev_um,
    scale_ev,
)

LANDAU = stats.landau(loc=np.log(np.pi / 2), scale=np.pi / 2)  # SciPy's, in Landau's lambda


@njit
def draws(u, v):
    out = np.empty_like(u)
    for i in range(u.size):
        out[i] = landau(u[i], v[i])
    return out


@pytest.fixture(scope="module")
def lambdas():
    return draws(*np.random.default_rng(3).random((2, 200_000)))


def test_against_scipy_landau(lambdas):
    assert stats.kstest(lambdas, LANDAU.cdf).pvalue > 1e-3
    assert LANDAU.median() == pytest.approx(1.35578, abs=1e-4)  # Landau's published median


def test_against_pdg_most_probable_loss():
    """PDG's 320 um of silicon: about 90 keV for fast particles; 72 to 80 pairs a micrometre."""
    per_um = {t: loss_ev(scale_ev(float(t), 1.0), -0.22278) / t for t in (80, 320, 640)}
    assert 0.85 < per_um[320] * 320 / 90e3 < 1.05
    assert 70 < per_um[80] / PAIR_EV < per_um[640] / PAIR_EV < 85
    xi = scale_ev(300.0, 1.0)
    j_form = xi * (np.log(2 * ELECTRON_EV * xi / PLASMA_EV**2) + 0.200)  # PDG, j = 0.200
    assert loss_ev(xi, -0.22278) == pytest.approx(j_form, rel=1e-5)


def test_chords_add_up_to_the_track():
    """A track cut into unequal chords loses energy by the same law as a whole one."""
    rng = np.random.default_rng(5)
    total = np.zeros(40_000)
    for chord in (3.0, 11.0, 0.5, 40.0, 45.5):
        xi = scale_ev(chord, 1.0)
        lam = draws(*rng.random((2, total.size)))
        total += [loss_ev(xi, one) for one in lam]
    xi = scale_ev(100.0, 1.0)
    shift = loss_ev(xi, 0.0) / xi
    assert stats.kstest(total / xi - shift, LANDAU.cdf).pvalue > 1e-3


@pytest.mark.parametrize("most_ev", [30e3, 300e3])
def test_mean_below_a_cut_against_the_restricted_formula(most_ev):
    """Landau's law up to a cut has PDG's restricted mean, to the correction of the cut itself.

    The mean of lambda below L is the integral of 1 - F minus L (1 - F(L)); beyond L the tail falls
    as 1 / lambda, which is the free collisions' spectrum.
    """
    chord = 10.0
    xi = scale_ev(chord, 1.0)
    shift = loss_ev(xi, 0.0) / xi
    cut = most_ev / xi
    low = -5.0
    grid = np.unique(np.concatenate([np.linspace(low, 50, 4001), np.geomspace(50, cut, 2001)]))
    mean = low + integrate.simpson(LANDAU.sf(grid), x=grid)  # of min(lambda, cut)
    mean -= cut * LANDAU.sf(cut)  # collisions above the cut omitted
    assert (mean + shift) * xi / chord == pytest.approx(restricted_loss_ev_um(most_ev), rel=0.01)


def stopping_ev_um(energy_ev):
    """Collision stopping power of electrons in silicon by Berger & Seltzer's formula."""
    tau = energy_ev / ELECTRON_EV
    beta2 = tau * (tau + 2) / (tau + 1) ** 2
    f = (1 - beta2) * (1 + tau**2 / 8 - (2 * tau + 1) * np.log(2))
    bracket = 2 * np.log(energy_ev / 173.0) + np.log1p(tau / 2) + f
    return scale_ev(1.0, 1.0) / beta2 * bracket


@pytest.mark.parametrize("energy_ev", [3e4, 1e5, 5e5])
def test_ranges_of_electrons(energy_ev):
    """Practical ranges are 0.6 to 0.9 of the winding path of a slowing electron."""
    path_um, _ = integrate.quad(lambda e: 1 / stopping_ev_um(e), 1e3, energy_ev)
    assert 0.6 < electron_range_um(energy_ev) / path_um < 0.9


def test_binding_against_shulek():
    shells = ((1840, 2), (125, 8), (17, 4))  # eV, electrons
    variance = 8 / 3 * sum(i * f / 14 * np.log(2 * ELECTRON_EV / i) for i, f in shells)
    assert pytest.approx(variance, rel=0.01) == BINDING_EV
