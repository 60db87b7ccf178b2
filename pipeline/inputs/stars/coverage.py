"""Which fraction of the sampled frames the main catalogue covers, by directions over each frame."""

from __future__ import annotations

import numpy as np

from catalog_tools.catalogue import Catalogue
from catalog_tools.coverage import Coverage, coverage_of
from catalog_tools.geometry.sphere import angles_deg
from pipeline.arrays import Array, Geometry
from pipeline.physics.positions.apparent import proper_to_astrometric
from pipeline.physics.positions.focal_plane import Camera, deproject
from pipeline.physics.positions.refraction import unrefract
from pipeline.plan.acceptance import accept_or_refuse
from pipeline.plan.coverage import FieldCoverage
from pipeline.plan.pointing.geometry import camera_of
from pipeline.spec.scene import Scene

FIELD = "stars.catalogue"
SIDE = 17  # directions along each side of a frame, corners included


def gather_coverage(scene: Scene, catalogue: Catalogue, g: Geometry) -> FieldCoverage:
    """The main catalogue's coverage of the frames of a geometry; nothing is read but its manifest.

    A layer over it adds stars, not coverage: a list of bright stars does not make a field complete.
    """
    coverage = coverage_of(catalogue)
    if not coverage.known:
        return FieldCoverage(catalogue.name, None, 1.0, 1.0, int(g.frame[0]))
    camera, limits = camera_of(scene), []
    for index in range(len(g.frame)):
        limits.append(_limits_g_mag(coverage, _directions(scene, camera, g, index)))
    fractions = np.array([np.mean(~np.isneginf(each)) for each in limits])
    worst = int(np.argmin(fractions))
    least = np.concatenate(limits)
    least = least[np.isfinite(least)]
    return FieldCoverage(
        catalogue.name,
        coverage.source,
        float(fractions[worst]),
        float(fractions.mean()),
        int(g.frame[worst]),
        float(least.min()) if least.size else None,
        coverage.from_rows,
    )


def coverage_sentences(
    scene: Scene, catalogue: Catalogue, coverage: FieldCoverage
) -> tuple[list[str], list[str]]:
    """Warnings and remarks; BadInput where a frame is not covered at all, unless accepted."""
    warning = coverage.warning()
    if warning is not None and coverage.worst == 0.0:
        allowed = (
            f"a catalogue that covers the field: {coverage.catalogue}, by {coverage.source}, "
            f"covers nothing of frame {coverage.worst_frame}"
        )
        warning = accept_or_refuse(scene, "coverage", FIELD, coverage.catalogue, allowed, warning)
    limit = scene.stars.faintest_g_mag if scene.stars is not None else None
    remark = coverage.remark(limit, catalogue.faintest_g_mag)
    return [warning] if warning else [], [remark] if remark else []


def _limits_g_mag(coverage: Coverage, v: Array) -> Array:
    """G to which directions (n, 3) are covered; those that are none are omitted."""
    return coverage.limits_g_mag(*angles_deg(v[np.isfinite(v).all(axis=-1)]))


def _directions(scene: Scene, camera: Camera, g: Geometry, index: int) -> Array:
    """Astrometric directions (n, 3) of SIDE x SIDE places, corner to corner, at mid-exposure."""
    rows, columns = camera.rows, camera.columns
    y_px, x_px = np.meshgrid(
        np.linspace(-0.5, rows - 0.5, SIDE), np.linspace(-0.5, columns - 0.5, SIDE)
    )
    middle = g.middle
    seen = deproject(camera, g.attitude[index, middle], x_px.ravel(), y_px.ravel())
    proper = unrefract(seen, g.air_at(index, middle))
    return proper_to_astrometric(proper, g.observer_at(index, middle), **scene.star_effects)
