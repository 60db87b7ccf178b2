"""Meshes with shadows: CPU milliseconds of a point of a light curve, against the error asked for.

Run: python -m benchmarks.meshes [FILE.obj ...]. Without files: a synthetic spacecraft of 10,000
facets (a ball of tiles between two panels, a boom and a dish). Each row: medians and largest of 16
random directions of Sun and observer (phase angle below 120 degrees), one core; errors against
the same with 1e-5 asked for. The first call compiles and is omitted.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.physics.meshes import brdf
from pipeline.physics.meshes.facets import Facets
from pipeline.physics.meshes.intensity import FacetSurface, mesh_intensity
from pipeline.physics.vectors import unit

Array = np.ndarray
DIRECTIONS, ERRORS = 16, (1e-2, 1e-3, 1e-4)
WHITE = FacetSurface(partial(brdf.lambert, albedo=1.0))


def main(paths: list[str]) -> None:
    """Print a table: facets, CPU milliseconds, errors and their bounds, by error asked for."""
    bodies = [("synthetic", spacecraft())] if not paths else [load(Path(p)) for p in paths]
    print("body                   facets   asked   ms median   ms most  error median  error most")
    for name, facets in bodies:
        every = list(directions())
        true = [mesh_intensity(facets, [WHITE], s, o, 1e-5).intensity_m2_sr for s, o in every]
        for asked in ERRORS:
            times, errors = [], []
            for (s, o), right in zip(every, true, strict=True):
                start = time.process_time()
                light = mesh_intensity(facets, [WHITE], s, o, asked)
                times.append(1e3 * (time.process_time() - start))
                errors.append(abs(light.intensity_m2_sr / right - 1.0))
            print(
                f"{name:20} {len(facets):8d}  {asked:6.0e}  {np.median(times):10.1f}"
                f"{max(times):10.1f}  {np.median(errors):12.1e}{max(errors):12.1e}"
            )


def directions() -> list[tuple[Array, Array]]:
    """Directions of Sun and observer."""
    rng, out = np.random.default_rng(1), []
    for _ in range(DIRECTIONS):
        s, o = unit(rng.normal(size=3)), unit(rng.normal(size=3))
        out.append((s, o if s @ o > -0.5 else -o))
    return out


def spacecraft(rows: int = 50, columns: int = 96) -> Facets:
    """A ball of 2 (rows - 1) columns facets, panels of 2 x 8 tiles, a boom, a dish."""
    lat, lon = np.linspace(-np.pi / 2, np.pi / 2, rows + 1), np.linspace(0, 2 * np.pi, columns + 1)
    p = np.stack(np.broadcast_arrays(
        np.cos(lat)[:, None] * np.cos(lon), np.cos(lat)[:, None] * np.sin(lon),
        np.sin(lat)[:, None]), -1)  # fmt: skip
    parts = [_tiles(p)]
    for side in (-1.0, 1.0):
        x, y = np.meshgrid(np.linspace(-0.8, 0.8, 5), side * np.linspace(1.3, 5.0, 33))
        parts.append(_tiles(np.stack([x, y, np.zeros_like(x)], -1)))
    x, z = np.meshgrid(np.linspace(-0.02, 0.02, 2), np.linspace(1.0, 4.0, 9))
    parts.append(_tiles(np.stack([x, np.zeros_like(x), z], -1)))
    r, a = np.meshgrid(np.linspace(0.05, 0.7, 5), np.linspace(0, 2 * np.pi, 25))
    parts.append(_tiles(np.stack([1.2 + 0.4 * r**2, r * np.cos(a), r * np.sin(a)], -1)))
    corners = np.concatenate(parts)
    closed = np.arange(len(corners)) < len(parts[0])
    return Facets(corners, np.zeros(len(corners), np.int64), closed)


def _tiles(grid: Array) -> Array:
    """Two triangles for each tile of a grid of points (n, m, 3); none without area."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    corners = np.concatenate([np.stack(t, -2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))])
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return corners[np.sum(np.square(np.cross(u, v)), -1) > 1e-18]


def load(path: Path) -> tuple[str, Facets]:
    """A file in metres as white facets."""
    from pipeline.inputs.targets.meshes import read_mesh

    mesh = read_mesh(path, "m")
    return path.stem, Facets(mesh.corners_m, np.zeros(len(mesh.corners_m), np.int64), mesh.closed)


if __name__ == "__main__":
    main(sys.argv[1:])
