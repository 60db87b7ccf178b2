"""Limiting cases of light: grazing penumbrae, phases of 0 and 180 degrees, plates edge-on."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M, SUN_RADIUS_M
from pipeline.physics.targets.eclipse import sunlit_fraction
from pipeline.physics.targets.frustum import frustum_area_function
from pipeline.physics.targets.plate import box_area_function, plate_area_function
from pipeline.physics.targets.shadow import uncovered_fraction
from pipeline.physics.targets.sphere import sphere_area_function
from pipeline.studies.selftest.case import CaseResult, case
from pipeline.studies.worst import worst_of

SUN_M = 1.495978707e11


def _behind(distance_m: float, apart_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """A target behind the Earth whose Sun stands an angle from the Earth's centre, and the Sun."""
    target = np.array([[-distance_m, 0.0, 0.0]])
    away = SUN_M * np.array([np.cos(apart_rad), np.sin(apart_rad), 0.0])
    return target, target[0] + away


@case(
    "light/grazing-penumbra",
    "a GEO satellite as the Earth begins to touch the Sun, 1e-9 rad deep",
    "area of a thin lens: (4 sqrt 2/3) sqrt(a b/(a + b)) d^1.5",
    1e-3,
)
def grazing_penumbra(_: Path) -> CaseResult:
    distance, depth = 4.2164e7, 1e-9
    b = np.arcsin(EARTH_EQUATORIAL_RADIUS_M / distance)
    a = np.arcsin(SUN_RADIUS_M / SUN_M)
    lit = sunlit_fraction(*_behind(distance, a + b - depth))[0]
    wide = np.tan(b)  # the limb's curvature in the plane of the sky
    right = 4.0 * np.sqrt(2.0) / 3.0 * np.sqrt(a * wide / (a + wide)) * depth**1.5 / (np.pi * a**2)
    error = abs((1.0 - lit) / right - 1.0)
    return CaseResult(f"1 - {right:.6g}", f"1 - {1.0 - lit:.6g}", float(error))


@case(
    "light/penumbra",
    "half covered, nearly covered and annular eclipses by a round body",
    "a grid of 4 million points on the Sun's disc",
    2e-4,
    "of the sunlight",
)
def penumbra(_: Path) -> CaseResult:
    a = 4.65e-3
    grid = (np.arange(2000) + 0.5) / 1000.0 - 1.0
    x, y = np.meshgrid(a * grid, a * grid)
    sun = x * x + y * y < a * a
    worst = 0.0
    for b, c in ((0.15, 0.15), (0.15, 0.146), (0.002, 0.001), (1.2, 1.2)):
        # from the body's centre, straight on the sphere: cos r = cos(c + x) cos y
        free = np.cos(c + x) * np.cos(y) < np.cos(b)
        right = np.count_nonzero(sun & free) / np.count_nonzero(sun)
        worst = worst_of(worst, abs(float(uncovered_fraction(a, b, c)[0]) - right))
    return CaseResult("as counted", f"within {worst:.2g}", worst)


@case(
    "light/phase-0-and-180",
    "a sphere at phase 0, 180 degrees and 1e-5 rad before",
    "2 pi r^2/3; 0; (2/9) r^2 e^3 (the first term of Lambert's law in e = pi - a)",
    1e-9,
)
def sphere_phases(_: Path) -> CaseResult:
    e = 1e-5
    full, dark, thin = sphere_area_function(np.array([0.0, np.pi, np.pi - e]), 2.0)
    right = (2.0 * np.pi / 3.0, 2.0 / 9.0 * e**3)
    error = worst_of(abs(full / right[0] - 1.0), abs(thin / right[1] - 1.0), abs(dark))
    return CaseResult(
        f"{right[0]:.6g}, 0, {right[1]:.6g} m2",
        f"{full:.6g}, {dark:.3g}, {thin:.6g} m2",
        float(error),
    )


@case(
    "light/edge-on",
    "a plate and a box edge-on to the Sun, to the observer, and to both",
    "no light: n.s = 0 or n.o = 0",
    0.0,
    "m2",
)
def edge_on(_: Path) -> CaseResult:
    x, z = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    plates = [plate_area_function(*pair, 1.0, True) for pair in ((x, z), (z, x), (x, x), (z, -z))]
    box = box_area_function(x, z, np.array([1.0, 2.0, 3.0]))
    most = float(np.max(np.abs([*plates, box])))
    return CaseResult("0", f"{most:.3g}", most if np.isfinite(most) else np.inf)


@case(
    "light/needle-and-disc",
    "a cylinder of 1e-6 m by 1 m, and one of 1 m by 1e-6 m",
    "its side seen along the sunlight: pi r h/2; its end: pi r^2",
    1e-5,
)
def needle_and_disc(_: Path) -> CaseResult:
    x, z = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    needle = float(frustum_area_function(x, x, 1e-6, 1e-6, 1.0))
    disc = float(frustum_area_function(z, z, 1.0, 1.0, 1e-6))
    right = 0.5 * np.pi * 1e-6, np.pi
    error = worst_of(abs(needle / right[0] - 1.0), abs(disc / right[1] - 1.0))
    return CaseResult(f"{right[0]:.6g}, {right[1]:.6g} m2", f"{needle:.6g}, {disc:.6g} m2", error)
