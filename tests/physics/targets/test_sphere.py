"""The sphere's closed form against long decimals and quadrature."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest

from pipeline.physics.targets.sphere import (
    sphere_area_function,
    sphere_intensity_per_irradiance,
)

PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899")


def exact_bracket(phase: float) -> Decimal:
    """sin e - e cos e with e = pi - phase, in 70 digits from the power series."""
    with localcontext() as context:
        context.prec = 70
        e = PI - Decimal(phase)
        total, term, k = Decimal(0), e * e * e / 3, 1
        while abs(term) > abs(total) * Decimal(10) ** -60 or k < 3:
            total += term
            term *= -e * e * (k + 1) / k / ((2 * k + 2) * (2 * k + 3))
            k += 1
        return total


PHASES = [0.0, 1e-9, 0.5, np.pi / 2, np.pi - 1, np.pi - 0.999, np.pi - 0.3, np.pi - 1e-2,
          np.pi - 1e-5, np.pi - 1e-8, np.nextafter(np.pi, 0), np.pi]  # fmt: skip


@pytest.mark.parametrize("phase", PHASES)
def test_against_long_decimals(phase: float) -> None:
    expected = float(Decimal(2) / 3 * exact_bracket(phase)) * 1.5**2
    assert float(sphere_area_function(phase, 3.0)) == pytest.approx(expected, rel=1e-14, abs=0)


def test_against_surface_integral() -> None:
    """Gauss-Legendre over the lune that is lit and seen: 1e-12."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for phase in (0.0, 0.4, 1.5, 2.8):
        half = 0.5 * (np.pi - phase)  # longitudes seen and lit: (phase - pi/2, pi/2)
        lon, w_lon = (phase - np.pi / 2) + half * (nodes + 1), half * weights
        lat, w_lat = 0.5 * np.pi * nodes, 0.5 * np.pi * weights
        east_west = np.sum(w_lon * np.cos(lon) * np.cos(lon - phase))
        expected = east_west * np.sum(w_lat * np.cos(lat) ** 3)
        assert float(sphere_area_function(phase, 2.0)) == pytest.approx(expected, rel=1e-12)


def test_full_phase_intensity() -> None:
    """I = albedo E A 2/(3 pi) at full phase, with A the cross-section."""
    value = sphere_intensity_per_irradiance(0.0, 2.0, 0.2)
    assert float(value) == pytest.approx(0.2 * np.pi * 2 / (3 * np.pi), rel=1e-15)


def test_limits_monotone_positive_and_nan() -> None:
    phase = np.concatenate([np.linspace(0, np.pi, 4001), np.pi - np.logspace(-15, -1, 300)[::-1]])
    g = sphere_area_function(np.sort(phase), 1.0)
    assert np.all(g > 0)
    assert np.all(np.diff(g) <= 0)
    assert np.isnan(sphere_area_function(np.nan, 1.0))
    assert sphere_area_function(-1e-16, 1.0) == sphere_area_function(0.0, 1.0)
