"""Sections of a scene in the plan: an absent one costs no import, no task and no read."""

from __future__ import annotations

from pipeline.plan.decision import Decision
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene


def _sections(basis: PlanBasis) -> list[Decision]:
    """Of each section of the scene whether it is there."""
    scene, facts = basis.scene, basis.facts
    stars, targets, sky = scene.stars, scene.targets, scene.background
    absent = "the scene has no such section"
    return [
        Decision("stars", True, f"catalogue {', under '.join(stars.catalogues)}")
        if stars
        else Decision("stars", False, absent, 0.0, 0.0),
        Decision("targets", True, f"{len(targets)} named in the scene")
        if targets
        else Decision("targets", False, absent, 0.0, 0.0),
        Decision("background", True, f"{facts.background_e_s:.4g} e-/s per pixel, or more")
        if sky
        else Decision("background", False, absent, 0.0, 0.0),
        _cosmic_rays(scene),
    ]


def _cosmic_rays(scene: Scene) -> Decision:
    """What cosmic rays are, and how far they go from real ones."""
    rays = scene.cosmic_rays
    if rays is None:
        return Decision("cosmic_rays", False, "the scene has no such section", 0.0, 0.0)
    flat = "the flat does not act on it" if rays.after_flat else "the flat acts on it"
    if rays.kind == "library":
        if rays.rate_scale == 0.0:
            return Decision("cosmic_rays", False, "rate_scale is 0", 0.0, 0.0)
        how = {
            "poisson": "a Poisson number of recorded events at random places",
            "frames": "whole recorded frames, cut out or tiled: no Poisson number",
        }[rays.arrival]
        return Decision(
            "cosmic_rays",
            True,
            f"{how}, {rays.rate_scale:g} times the recorded rate; charge pixel by pixel as "
            f"recorded, whatever the size of its pixels, and without its faint edges below the "
            f"threshold of the extraction; {flat}",
        )
    if rays.rate_per_cm2_s == 0.0:
        return Decision("cosmic_rays", False, "rate_per_cm2_s is 0", 0.0, 0.0)
    here, place = (
        ("ground", "on the ground")
        if isinstance(scene.observer, GroundObserver)
        else ("space", "in space")
    )
    elsewhere = f"{rays.source}, though the observer is {place}: source: {here}"
    where = rays.source if rays.source == here else elsewhere
    return Decision(
        "cosmic_rays",
        True,
        f"straight tracks of fast nuclei ({where}) through {rays.thickness_um:g} um of "
        "silicon, Poisson arrival, Landau straggling; no slow or stopping particles, no curved "
        f"electron tracks, no showers; {flat}",
    )


RULES = (
    Rule(
        ("stars", "targets", "background", "cosmic_rays"),
        "kept where the scene has such a section; else no import, no task, no read",
        "tests/rules/test_only_what_the_scene_needs.py::test_imports",
        _sections,
    ),
)
