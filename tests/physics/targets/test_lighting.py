"""Phase angles at their ends and the chain from sunlight to the aperture."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.constants import ASTRONOMICAL_UNIT_M
from pipeline.physics.targets.lighting import (
    phase_angle,
    photon_rate_at_aperture,
    solar_distance_factor,
    sun_distance,
)
from pipeline.physics.targets.sphere import sphere_intensity_per_irradiance

SUN = np.array([ASTRONOMICAL_UNIT_M, 0.0, 0.0])


def test_limits_phase_angle() -> None:
    target = np.array([4e7, 0.0, 0.0])
    ahead = target + np.array([1e6, 0.0, 0.0])
    behind = target - np.array([1e6, 0.0, 0.0])
    assert phase_angle(target, SUN, ahead) == 0
    assert phase_angle(target, SUN, behind) == pytest.approx(np.pi, abs=1e-15)
    aside = target + np.array([1e6, 1e-3, 0.0])
    assert phase_angle(target, SUN, aside) == pytest.approx(1e-9, rel=1e-6, abs=0.0)


def test_sphere_at_geo_by_hand() -> None:
    """E rho A 2/(3 pi)/R^2 at full phase, 1 au from the Sun, and an inverse square in each."""
    body = sphere_intensity_per_irradiance(0.0, 3.0, 0.2)
    rate = photon_rate_at_aperture(2.36e21, ASTRONOMICAL_UNIT_M, 1.0, body, 4e7)
    by_hand = 2.36e21 * 0.2 * np.pi * 1.5**2 * 2 / (3 * np.pi) / 4e7**2
    assert float(rate) == pytest.approx(by_hand, rel=1e-14)
    half = photon_rate_at_aperture(2.36e21, 2 * ASTRONOMICAL_UNIT_M, 0.5, body, 8e7)
    assert float(half) == pytest.approx(by_hand / 32, rel=1e-14)


def test_distance_factor() -> None:
    assert float(solar_distance_factor(2 * ASTRONOMICAL_UNIT_M)) == 0.25
    assert sun_distance(np.zeros((2, 3)), SUN) == pytest.approx(ASTRONOMICAL_UNIT_M)
