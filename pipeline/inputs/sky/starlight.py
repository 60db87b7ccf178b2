"""Light of the stars that are not drawn: the catalogue's own map, or the published star counts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from catalog_tools.catalogue import Catalogue
from pipeline.plan.sky.light import background_of
from pipeline.spec.scene import Scene, Stars

if TYPE_CHECKING:
    from catalog_tools.query.starlight import Starlight

COUNTS_BEGIN_G_MAG, COUNTS_END_G_MAG = 3.0, 21.0


def gather_starlight(
    scene: Scene, catalogues: Sequence[Catalogue], limit_from_noise: bool
) -> Starlight | None:
    """Where the light of undrawn stars comes from; None where the scene asks for none of it.

    Of the main catalogue's stars beyond the limit, its map, else the star counts to its end; where
    `starlight: all` is asked for, the star counts from its end on (all, without a catalogue). The
    layers' own fainter stars are not in it. Raises Damaged for a map that cannot be trusted.
    """
    request = background_of(scene).starlight
    if request != "all" and not limit_from_noise:
        return None
    from catalog_tools.query.starlight import AddedLight, CountedLight, read_starlight

    if scene.stars is None:
        return CountedLight()
    main = catalogues[0]
    parts: list[Starlight] = []
    end = -math.inf if main.faintest_g_mag is None else main.faintest_g_mag
    if _limit_g_mag(scene.stars, limit_from_noise) < end:
        counted = CountedLight(faintest_g_mag=min(end, COUNTS_END_G_MAG))
        parts.append(read_starlight(main) or counted)
    if request == "all" and end < COUNTS_END_G_MAG:
        parts.append(CountedLight(max(end, COUNTS_BEGIN_G_MAG), in_no_catalogue=True))
    return AddedLight(tuple(parts)) if parts else None


def _limit_g_mag(stars: Stars, limit_from_noise: bool) -> float:
    """Magnitude that stars which are not drawn may begin at; infinite where all are drawn."""
    if limit_from_noise:
        return -math.inf
    return math.inf if stars.faintest_g_mag is None else stars.faintest_g_mag
