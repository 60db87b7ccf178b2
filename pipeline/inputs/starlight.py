"""Light of the stars that are not drawn: the catalogue's own map, or the published star counts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from catalog_tools.catalogue import Catalogue
from pipeline.spec.background import Background
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from catalog_tools.starlight import Starlight

COUNTS_BEGIN_G_MAG, COUNTS_END_G_MAG = 3.0, 21.0


def gather_starlight(
    scene: Scene, catalogues: Sequence[Catalogue], limit_from_noise: bool
) -> Starlight | None:
    """Where the light of undrawn stars comes from; None where the scene asks for none of it.

    Of the main catalogue's stars beyond the limit, its map, else the star counts to its end; where
    `starlight: all` is asked for, the star counts from its end on (all, without a catalogue). The
    layers' own fainter stars are not in it. Raises Damaged for a map that cannot be trusted.
    """
    wish = (scene.background or Background(starlight="auto")).starlight
    if wish != "all" and not limit_from_noise:
        return None
    from catalog_tools.starlight import AddedLight, CountedLight, read_starlight

    if scene.stars is None:
        return CountedLight()
    main, limit = catalogues[0], scene.stars.faintest_g_mag
    end = main.faintest_g_mag
    parts: list[Starlight] = []
    if end is not None and (limit_from_noise or (limit is not None and limit < end)):
        counted = CountedLight(faintest_g_mag=min(end, COUNTS_END_G_MAG))
        parts.append(read_starlight(main) or counted)
    if wish == "all" and (end is None or end < COUNTS_END_G_MAG):
        begin = COUNTS_BEGIN_G_MAG if end is None else max(end, COUNTS_BEGIN_G_MAG)
        parts.append(CountedLight(begin, in_no_catalogue=True))
    return AddedLight(tuple(parts)) if parts else None
