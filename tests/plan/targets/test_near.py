"""Bodies near by: warned of from where their light is farther off than the scene's accuracy."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.plan.targets.near import near_warnings, off_by
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from tests.physics.targets.test_off_axis import scene_of


def light_from(distance: float, phase_rad: float) -> float:
    """Light of a Lambertian sphere of radius 1 at a distance, times its square, by quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    turn = (np.arange(400) + 0.5) / 400 * 2.0 * np.pi
    ring = np.sqrt(1.0 - nodes**2)[:, None]
    normal = np.stack([ring * np.cos(turn), ring * np.sin(turn), nodes[:, None] + 0.0 * turn], -1)
    sun = np.array([math.sin(phase_rad), 0.0, math.cos(phase_rad)])
    to = np.array([0.0, 0.0, distance]) - normal
    square = (to**2).sum(axis=-1)
    seen = np.maximum((normal * to).sum(axis=-1) / np.sqrt(square), 0.0)
    light = np.maximum(normal @ sun, 0.0) * seen / square * weights[:, None]
    return float(light.sum() * distance**2 * 2.0 * np.pi / 400)


@pytest.mark.parametrize("distance", [6.6, 20.0, 100.0])
@pytest.mark.parametrize("phase_deg", [0.0, 35.0, 90.0, 120.0, 121.0, 145.0, 165.0, 178.0])
def test_the_size_that_is_told_holds(distance: float, phase_deg: float) -> None:
    phase = math.radians(phase_deg)
    off = abs(light_from(distance, phase) / light_from(1e6, phase) - 1.0)
    assert off <= off_by(np.array(1.0 / distance), np.array(phase))


def test_those_that_are_nearer_than_the_accuracy_allows_are_named() -> None:
    """A sphere of 100 m at 2.5 km, and of 1 m: 2.2 R / d is 4.4% and 0.044%."""
    large, small = (prepare(parse_scene(scene_of(0.0, False, size))) for size in (100.0, 1.0))
    (told,) = [w for w in large.plan.warnings if "seen from afar" in w]
    assert told.startswith("t: as near as 2.5e+03 m, with a radius of 50 m")
    assert "up to some 4.4% off (asked: 0.1%)" in told
    assert not [w for w in small.plan.warnings if "seen from afar" in w]
    scene = parse_scene(scene_of(0.0, False) | {"targets": []})
    assert near_warnings(scene, None) == []  # type: ignore[arg-type]


def test_the_largest_phase_of_all_exposures_tells_the_size() -> None:
    """A sphere 50 radii away, first near full phase, then a thin crescent: it is 25% off there."""
    scene, late = parse_scene(scene_of(0.0, False, 100.0)), 2.9
    phase = np.array([[[0.5, 0.5], [late, late]]])
    g = SimpleNamespace(target_range_m=np.full(phase.shape, 2500.0), target_phase_rad=phase)
    (told,) = near_warnings(scene, g)  # type: ignore[arg-type]
    percent = float(told.split("up to some ")[1].split("%")[0])
    off = 100.0 * abs(light_from(50.0, late) / light_from(1e6, late) - 1.0)
    assert 10.0 < off <= percent < 1.5 * off
