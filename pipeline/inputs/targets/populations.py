"""Populations of a scene: their files read batch by batch, screened, the kept made targets."""

from __future__ import annotations

from pathlib import Path

from catalog_tools.storage.durable import file_digest
from pipeline.inputs.targets.population_files import element_sets, read_sizes
from pipeline.plan.targets.populations import (
    SearchView,
    Sieve,
    Sizes,
    look_of,
    nearest_of_all,
    with_members,
)
from pipeline.spec.scene import Scene, Target
from pipeline.spec.targets.population import Population


def gather_populations(scene: Scene, halo_px: float, dut1_s: float) -> Scene:
    """The scene with the objects of its populations that come into the field among its targets.

    halo_px : how far off the frame a source may be and still be drawn. A population that has been
    screened is not read again: its targets stand in the scene. BadInput where a file cannot be used
    """
    if all(p.screened is not None for p in scene.populations):
        return scene
    return screened(scene, look_of(scene, halo_px, dut1_s))


def screened(scene: Scene, look: SearchView) -> Scene:
    """The same of the objects that a look finds: an object that several populations have once."""
    sieves = {
        i: _sifted(population, look, f"populations.{i}")
        for i, population in enumerate(scene.populations)
        if population.screened is None
    }
    counts = dict(zip(sieves, nearest_of_all([*sieves.values()]), strict=True))
    found: list[tuple[list[Target], Population]] = []
    for i, population in enumerate(scene.populations):
        if i in sieves:
            found.append(sieves[i].close(file_digest(Path(population.path)), counts[i]))
        else:
            found.append(([], population))
    return with_members(scene, found)


def _sifted(population: Population, look: SearchView, place: str) -> Sieve:
    """A population's file, looked through; `place` names it in messages."""
    sizes: Sizes = {}
    if population.sizes is not None:
        sizes = read_sizes(Path(population.sizes), f"{place}.sizes")
    sieve = Sieve(population, look, sizes, place)
    for batch in element_sets(Path(population.path), f"{place}.path"):
        sieve.take(batch)
    sieve.check_read()
    return sieve
