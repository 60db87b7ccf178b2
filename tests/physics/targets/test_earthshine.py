"""Earthshine against sums over a fine Earth, and its known values at full Earth."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.targets.earthshine import earth_lamps
from pipeline.physics.vectors import unit

R = EARTH_EQUATORIAL_RADIUS_M
SUN = ASTRONOMICAL_UNIT_M * unit(np.array([0.8, 0.3, 0.4]))


def on_plate(target, normals, sun, albedo=0.3, rows=500):
    """Irradiance on plates from small cells of the part in view, over the Sun's."""
    up = unit(target)
    east = unit(np.cross(up, [0.2, 0.5, 0.7]))
    limb = np.arccos(R / np.linalg.norm(target))
    away = limb * ((np.arange(rows) + 0.5) / rows)[:, None, None]
    round_ = (2 * np.pi * (np.arange(rows) + 0.5) / rows)[:, None]
    aside = np.cos(round_) * east + np.sin(round_) * np.cross(up, east)
    n = np.cos(away) * up + np.sin(away) * aside
    to = R * n - target
    d2 = np.sum(to * to, -1)
    rise = np.maximum(np.sum(-to * n, -1), 0) / np.sqrt(d2)
    light = np.maximum(n @ unit(sun), 0) * rise / d2 * np.sin(away[..., 0])
    cell = R**2 * (limb / rows) * (2 * np.pi / rows)
    return [
        albedo / np.pi * cell * np.sum(light * np.maximum(to @ normal, 0) / np.sqrt(d2))
        for normal in normals
    ]


@pytest.mark.parametrize("phase", [0.0, 0.5, 1.2, 1.6, 2.4, 3.0])
@pytest.mark.parametrize("radius", [R + 5e5, R + 2e6, 4.2164e7, 3.8e8])
def test_against_a_fine_earth(radius, phase) -> None:
    across = unit(np.cross(SUN, [0.0, 0.0, 1.0]))
    target = radius * (np.cos(phase) * unit(SUN) + np.sin(phase) * across)
    directions, light = earth_lamps(target, SUN, 0.3)
    full = 0.3 * (R / radius) ** 2
    normals = (-unit(target), unit(SUN), unit(unit(SUN) - 2 * unit(target)), across)
    for normal, theirs in zip(normals, on_plate(target, normals, SUN), strict=True):
        ours = np.sum(light[0] * np.maximum(directions[0] @ normal, 0))
        bound = 1e-3 if normal is normals[0] else 6e-3  # the plate's own edge crosses the Earth
        assert abs(ours - theirs) < bound * full


def test_limits_full_earth_and_night() -> None:
    """At GEO 2/3 x 1.114 x albedo (R/r)^2, at 500 km 2.17 times the far field; night is dark."""
    for radius, ratio in ((4.2164e7, 1.114), (3.8e8, 1.0116)):
        _, light = earth_lamps(radius * unit(SUN), SUN, 0.3)
        assert light.sum() == pytest.approx(0.3 * (R / radius) ** 2 * 2 / 3 * ratio, rel=2e-3)
    _, light = earth_lamps(-(R + 5e5) * unit(SUN), SUN, 0.3)
    assert np.all(light == 0)
    directions, light = earth_lamps(np.stack([R * unit(SUN), 1.0001 * R * unit(SUN)]), SUN, 0.3)
    assert np.all(np.isfinite(directions))
    assert np.all(np.isfinite(light))
    assert np.all(light >= 0)
