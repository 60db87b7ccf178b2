"""Energy that a fast particle leaves in silicon: Landau's law, shared out along its track.

A particle of charge number z and speed near that of light loses in a chord of length x
    Delta = xi (lambda + ln(2 m c^2 xi / (hbar omega_p)^2) + 1 - gamma),  xi = 17.8 eV/um z^2 x
with lambda of Landau's distribution (Landau 1944, J. Phys. USSR 8, 201; Particle Data Group,
"Passage of particles through matter", most probable loss with the density effect saturated).
Landau's law is stable: the losses of the chords of a track add up to the law of the whole track, so
each pixel draws its own. The most probable loss is 72 e-/um in 100 um and 77 e-/um in 300 um.

Binding of the inner electrons widens the law by a Gaussian of variance 6.29 keV xi (Shulek et al.
1967, Sov. J. Nucl. Phys. 4, 400); it is drawn once a track, so single pixels vary too little.
Omitted: the dependence on speed (5% around minimum ionisation, large below 0.5 GeV a nucleon),
and the Fano noise of the pairs (0.3 sqrt(n) electrons).
"""

from __future__ import annotations

import math

from numba import njit

ELECTRON_EV = 510_998.95  # rest energy
PLASMA_EV = 31.05  # hbar omega_p of silicon (Particle Data Group)
XI_EV_UM = 0.5 * 0.307075e6 * (14.0 / 28.0855) * 2.329e-4  # z = 1, beta = 1
PAIR_EV = 3.65  # energy of one electron-hole pair in silicon
BINDING_EV = 6290.0  # variance over xi: 8/3 sum of I f ln(2 m c^2 / I), shells 1840, 125, 17 eV
EULER = 0.5772156649015329
DELTA_LEAST_EV = 30e3  # what one collision gives beyond it becomes a track of its own (9 um)
DELTA_MOST_EV = 500e3  # the cap of the tail; such an electron goes 700 um
DENSITY_MG_CM2_UM = 0.2329


@njit(cache=True, nogil=True)
def landau(u, v):
    """Landau's lambda from two uniforms in (0, 1), exactly.

    It is the stable law of index 1 and skewness 1: Chambers, Mallows & Stuck 1976, JASA 71, 340.
    """
    angle = math.pi * (u - 0.5)
    sector = 0.5 * math.pi + angle
    return sector * math.tan(angle) - math.log(-math.log(v) * math.cos(angle) / sector)


@njit(cache=True, nogil=True)
def scale_ev(chord_um, charge_number):
    """xi of a chord [eV]."""
    return XI_EV_UM * charge_number * charge_number * chord_um


@njit(cache=True, nogil=True)
def loss_ev(xi_ev, value):
    """Energy loss [eV] at one value of lambda; -0.22278 gives the most probable one."""
    if xi_ev <= 0.0:
        return 0.0
    shift = math.log(2.0 * ELECTRON_EV * xi_ev / PLASMA_EV**2) + 1.0 - EULER
    return max(xi_ev * (value + shift), 0.0)


@njit(cache=True, nogil=True)
def electron_range_um(energy_ev):
    """Range of an electron of 10 keV to 2.5 MeV (Katz & Penfold 1952, Rev. Mod. Phys. 24, 28)."""
    mev = energy_ev * 1e-6
    return 412.0 * mev ** (1.265 - 0.0954 * math.log(mev)) / DENSITY_MG_CM2_UM


def restricted_loss_ev_um(most_ev: float, charge_number: int = 1) -> float:
    """Mean loss [eV/um] by collisions of at most `most_ev` each (PDG, on the Fermi plateau).

    Valid where `most_ev` is far below the largest possible transfer.
    """
    return XI_EV_UM * charge_number**2 * math.log(2.0 * ELECTRON_EV * most_ev / PLASMA_EV**2)
