"""Decisions about targets: what lights and hides them, how they move, how they are drawn."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from pipeline.arrays import Geometry
from pipeline.plan.bodies.sizes import limb_px, radius_m
from pipeline.plan.decision import Decision
from pipeline.plan.facts import Facts
from pipeline.plan.pointing.geometry import bend_px
from pipeline.plan.pointing.paths import near_frame
from pipeline.plan.pointing.timescales import light_off
from pipeline.plan.response.responses import point_slope
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.plan.targets.bounds import (
    between_facets,
    earthshine_share,
    table_told,
    two_body_m,
)
from pipeline.plan.targets.umbra import decide_umbra
from pipeline.spec.scene import Scene, Target
from pipeline.spec.targets.body import CompositeBody, SphereBody
from pipeline.spec.targets.mesh import MeshBody
from pipeline.spec.targets.orbit import KeplerianOrbit, NumericalOrbit, StateOrbit, TableOrbit

FINER_SHADOW = 1.5e-4  # of sunlight: shadows with an ellipsoid, limb darkening, the Moon
LAMPS_ERROR = 5e-4  # of earthshine, in 256 lamps


def _populations(basis: PlanBasis) -> list[Decision]:
    """How many objects of each population are drawn."""
    if not basis.scene.populations:
        return []
    from pipeline.plan.targets.populations import population_decisions

    return population_decisions(basis.scene)


def _between_nodes(basis: PlanBasis) -> list[Decision]:
    """How a target's light changes in an exposure."""
    ends = basis.frames
    if not basis.scene.targets:
        return []
    off = light_off(basis.scene, ends, near_frame(basis.scene, ends))
    return [
        Decision(
            "targets.light_between_nodes",
            True,
            f"linear between {ends.nodes} nodes of an exposure: off by at most {off:.2g} of the "
            "light of a target in or beside the frame, of the frames looked at; paths are off by "
            f"at most {bend_px(basis.scene, ends, basis.resolved.dut1_s):.2g} px",
            bound=off,
            unit="of a target's light",
        )
    ]


def mesh_notices(scene: Scene) -> list[str]:
    """What the meshes of a scene have to say of themselves: holes, mended normals."""
    return [
        f"{t.name}: {notice}"
        for t in scene.targets
        if isinstance(t.body, MeshBody) and t.body.model is not None
        for notice in t.body.model.notices
    ]


def _names(targets: list[Target]) -> str:
    shown = ", ".join(t.name for t in targets[:5])
    return shown + (f" and {len(targets) - 5} more" if len(targets) > 5 else "")


def _meshes(scene: Scene) -> list[Target]:
    return [t for t in scene.targets if isinstance(t.body, MeshBody)]


def _lamps(targets: Iterable[Target]) -> list[Target]:
    """Those that ask for earthshine."""
    return [t for t in targets if t.lighting and t.lighting.earthshine_albedo]


def _shadows(basis: PlanBasis) -> Iterator[Decision]:
    """The Earth's shadow, and what still lights targets in it."""
    if basis.scene.targets:
        yield _eclipse(list(basis.scene.targets))
        yield from decide_umbra(basis)


def _eclipse(targets: list[Target]) -> Decision:
    """Of the Earth's shadow."""
    dark = [t for t in targets if not t.eclipse]
    finer = [t for t in targets if t.lighting is not None]
    return Decision(
        "targets.eclipse",
        len(dark) < len(targets),
        "umbra and penumbra of a spherical Earth without air, uniform solar disc"
        + (f"; switched off for {_names(dark)}" if dark else "")
        + (
            f"; ellipsoid, limb darkening or Moon as asked for {_names(finer)}, to 1.5e-4 of "
            "sunlight"
            if finer
            else ""
        ),
        bound=1.0 if dark else FINER_SHADOW if finer else None,
        unit="of sunlight",
    )


def _earthshine(basis: PlanBasis) -> Iterator[Decision]:
    """Of the Earth's light on the targets that ask for it."""
    if not basis.scene.targets:
        return
    lamps = _lamps(basis.scene.targets)
    yield Decision(
        "targets.earthshine",
        bool(lamps),
        f"Lambertian Earth without clouds or seasons for {_names(lamps)}, as 256 lights: to "
        "5e-4 of albedo (R/r)^2 of direct sunlight"
        if lamps
        else "not asked for: at most albedo (R/r)^2 of direct sunlight on a surface that faces the "
        "Earth, 0.7% at GEO, 26% at 500 km (albedo 0.3), all of it in the shadow of the body",
        bound=(LAMPS_ERROR if lamps else 1.0) * earthshine_share(lamps, basis.frames),
        unit="of direct sunlight",
    )


def _tables(basis: PlanBasis) -> list[Decision]:
    """Tables of the light of meshes."""
    if not _meshes(basis.scene):
        return []
    from pipeline.plan.bodies.mesh_tables import decide_tables

    return decide_tables(basis.scene)


def _between_parts(basis: PlanBasis) -> Iterator[Decision]:
    """What the facets of meshes and the parts of composites do to each other."""
    if meshes := _meshes(basis.scene):
        yield _mesh_shadows(meshes)
        yield between_facets(meshes)
    composite = [t for t in basis.scene.targets if isinstance(t.body, CompositeBody)]
    if composite:
        yield Decision(
            "targets.mutual_shadowing",
            False,
            f"parts of {_names(composite)} neither shade nor hide each other: their light is "
            "an upper bound; as much as all of it may be in excess",
            bound=1.0,
            unit="of the light drawn",
        )


def _mesh_shadows(meshes: list[Target]) -> Decision:
    """Of what the facets of meshes hide from the Sun and from the observer."""
    errors = (t.body.error or 0.0 for t in meshes if isinstance(t.body, MeshBody))
    error = max(errors, default=0.0)
    return Decision(
        "targets.mesh_shadows",
        True,
        f"{_names(meshes)}: self-shadowing and mutual occlusion, areas to within "
        f"{error:.2g} of the light; a convex body needs none",
        bound=error,
        unit="of the light",
    )


def _earthshine_on_meshes(basis: PlanBasis) -> Iterator[Decision]:
    """How the Earth's light falls on meshes, and what is omitted of it."""
    glowing = _lamps(_meshes(basis.scene))
    if not glowing:
        return
    share = max(t.body.error or 0.0 for t in glowing if isinstance(t.body, MeshBody))
    yield Decision(
        "targets.earthshine_on_meshes",
        True,
        f"{_names(glowing)}: the Earth in ever smaller parts until the light of the body changes "
        f"by less than {0.5 * share:.2g}, at most 1024 parts; its self-shadowing likewise, each of "
        "at most 1024 parts traced (highlights and shadows finer than 1/32 of the Earth's disc "
        "may be resolved less well). Straight lines in time, off by at most "
        "3e-4 of earthshine. A body larger than a point is drawn with the picture that it has in "
        "sunlight or, where there is none, as a point; its brightness with earthshine",
        bound=share,
        unit="of the light",
    )


def _sizes(basis: PlanBasis) -> list[Decision]:
    """Which bodies are points, and which have a size."""
    out = []
    scene, facts, ends = basis.scene, basis.facts, basis.frames
    others = [t for t in scene.targets if not isinstance(t.body, SphereBody | MeshBody)]
    meshes = _meshes(scene)
    if meshes:
        out.append(_resolved_meshes(scene, facts, ends))
    if len(others) + len(meshes) < len(scene.targets):
        out.append(
            Decision(
                "targets.point_sources",
                True,
                "a sphere is a point, at the centre of its light, where that errs by at most the "
                "bound in a pixel; else its disc and lit side at mid-exposure are drawn, off the "
                "axis through the camera's perspective there, with the distortion of its middle",
                *basis.within_budget("targets.point_sources"),
            )
        )
    if others:
        largest = _largest_px(scene, facts, ends)
        out.append(
            Decision(
                "targets.shapes_as_points",
                True,
                f"{_names(others)}: points at any size, up to {largest:.3g} px in radius here: "
                "only spheres and meshes have pictures, as parts of composites have no places",
                bound=min(1.0, point_slope(basis.resolved.responses.blur) * largest),
                unit="of the target's light",
            )
        )
    return out


def _largest_px(scene: Scene, facts: Facts, ends: Geometry) -> float:
    """Radius [px] of the largest simple shape, or part of one, in the frames looked at."""
    drawn = (SphereBody, MeshBody)
    which = [i for i, t in enumerate(scene.targets) if not isinstance(t.body, drawn)]
    size_m = np.array([radius_m(scene.targets[i].body) for i in which])
    nearest_m = ends.target_range_m[which].min(axis=(1, 2))
    return float(limb_px(size_m, nearest_m, facts.ifov_rad).max(initial=0.0))


def _mesh(target: Target) -> Any:
    """The model of a target that is a mesh."""
    return target.body.model if isinstance(target.body, MeshBody) else None


def _resolved_meshes(scene: Scene, facts: Facts, ends: Geometry) -> Decision:
    """How meshes are drawn, and what their turning in an exposure is worth."""
    which = [i for i, t in enumerate(scene.targets) if isinstance(t.body, MeshBody)]
    size_m = np.array([_mesh(scene.targets[i]).radius_m for i in which])
    distance = ends.target_range_m[which]
    radius_px = limb_px(size_m[:, None], distance.min(axis=-1), facts.ifov_rad)
    turned = float((radius_px * ends.target_turn_rad).max(initial=0.0))
    grown = float((np.ptp(distance, axis=-1) / distance.min(axis=-1) * radius_px).max(initial=0.0))
    return Decision(
        "targets.resolved_meshes",
        True,
        f"{_names([scene.targets[i] for i in which])}: a point at the centre of its light where "
        "that errs by at most the bound in a pixel; else its picture at mid-exposure, up to "
        f"{radius_px.max(initial=0.0):.3g} px in radius. In an exposure the body turns so that its "
        f"edge moves by up to {turned:.2g} px, and its radius changes by up to {grown:.2g} px: "
        "neither is drawn. The picture keeps scale and axes of the middle of the field, and has "
        "at most 512 cells across: of a body too bright for that the bound does not hold",
        facts.budget_e,
        facts.budget_e / facts.light_floor_e,
    )


def _forces(basis: PlanBasis) -> list[Decision]:
    """What the kinds of orbit leave out."""
    found, scene = [], basis.scene
    plain = [t for t in scene.targets if isinstance(t.orbit, StateOrbit | KeplerianOrbit)]
    if plain:
        found.append(
            Decision(
                "targets.perturbations",
                False,
                f"two-body motion for {_names(plain)}: the Earth's oblateness is omitted, up to "
                "80 km an hour after the state at 500 km, 60 m at GEO, and all smaller forces (the "
                "bound is without drag)",
                bound=two_body_m(plain, scene, basis.frames),
                unit="m",
            )
        )
    forced = [t for t in scene.targets if isinstance(t.orbit, NumericalOrbit)]
    if forced:
        found.append(
            Decision(
                "targets.forces",
                True,
                f"as asked for {_names(forced)}: zonal harmonics, a static atmosphere, sunlight, "
                "Sun and Moon; tesseral harmonics are omitted: degree 2 and 3 of EGM96 are worth "
                "0.4 to 2.2 km in a day at 500 km, 0.1 to 0.4 km at GEO",
            )
        )
    return found


def _ephemerides(basis: PlanBasis) -> list[Decision]:
    """How well tables tell orbits between their rows."""
    return [table_told(t) for t in basis.scene.targets if isinstance(t.orbit, TableOrbit)]


RULES = (
    Rule(
        ("populations.*",),
        "objects that come near the field in the dwell; none is missed",
        "tests/plan/targets/test_populations.py",
        _populations,
    ),
    Rule(
        ("targets.eclipse", "targets.umbra_light"),
        "where eclipse is on; a disc's overlap, or the options of lighting; light that the air "
        "sends into the umbra never",
        "tests/physics/targets/test_eclipse.py::test_against_caps_on_the_sphere",
        _shadows,
    ),
    Rule(
        ("targets.earthshine",),
        "where lighting asks for it",
        "tests/physics/targets/test_earthshine.py::test_against_a_fine_earth",
        _earthshine,
    ),
    Rule(
        ("targets.light_table",),
        "where the frames need many moments of a mesh's light, and a table within the error asked "
        "for takes at most a third of them",
        "tests/plan/bodies/test_mesh_tables.py::test_the_stated_error_holds",
        _tables,
    ),
    Rule(
        ("targets.earthshine_on_meshes",),
        "where lighting asks for it on a mesh",
        "tests/plan/test_mesh_earthshine.py::test_against_every_lamp_traced",
        _earthshine_on_meshes,
    ),
    Rule(
        ("targets.light_between_facets", "targets.mesh_shadows", "targets.mutual_shadowing"),
        "shadows within a mesh always, to the error asked for; between facets and between the "
        "parts of composites never",
        "tests/physics/meshes/test_intensity.py::test_the_error_asked_for_is_met",
        _between_parts,
    ),
    Rule(
        ("targets.forces", "targets.perturbations"),
        "the forces that the orbit names; sizes of the others are said",
        "tests/physics/positions/test_orbit_numerical.py::test_forces_one_by_one",
        _forces,
    ),
    Rule(
        ("targets.ephemeris",),
        "tables are interpolated; the error is measured by leaving rows out",
        "tests/physics/positions/test_orbit_table.py::test_stated_error_holds",
        _ephemerides,
    ),
    Rule(
        ("targets.point_sources", "targets.shapes_as_points", "targets.resolved_meshes"),
        "a point where its size changes no pixel by more than the budget",
        "tests/physics/drawing/test_extended.py::test_point_error_bounds_what_is_left_out",
        _sizes,
    ),
    Rule(
        ("targets.light_between_nodes",),
        "as many moments as keep the light within accuracy.flux_fraction",
        "tests/plan/bodies/test_bodies.py::test_flicker_bounds_the_error_at_the_edge_of_the_shadow",
        _between_nodes,
    ),
)
