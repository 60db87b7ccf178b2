"""What was found of populations, and objects that several hold: each is drawn once."""

from __future__ import annotations

from pipeline.spec.scene import Scene
from pipeline.spec.targets.population import Screened


def screens_of(scene: Scene) -> list[tuple[str, Screened]]:
    """Names of the populations that were looked through, and what was found."""
    return [(p.name, p.screened) for p in scene.populations if p.screened is not None]


def shared_remarks(scene: Scene) -> list[str]:
    """How many objects of each population are left out, as another one has them."""
    return [f"populations.{name}: {shared_told(s)}" for name, s in screens_of(scene) if s.elsewhere]


def shared_told(s: Screened) -> str:
    """What is said of the objects of a population that another one has."""
    return (
        f"{s.elsewhere} of {s.read} element sets omitted: another population has the same object, "
        "with elements nearer to the epoch, or as near and named before"
    )
