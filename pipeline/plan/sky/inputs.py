"""What is read for the sky of a scene; a part that it does not ask for is None."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.colour import ColourFit
from pipeline.physics.sky import zodiacal as z

if TYPE_CHECKING:
    from pipeline.physics.sky.extinction import BandExtinction
    from pipeline.physics.sky.night import NightBand
    from pipeline.plan.sky.stray_light import StrayInputs

Array = NDArray[np.float64]


class LightLike(Protocol):
    """Summed light of stars per sr, as `catalog_tools.query.starlight.Light`."""

    @property
    def g(self) -> Array: ...
    @property
    def g_colour(self) -> Array: ...
    @property
    def g_colour_squared(self) -> Array: ...
    @property
    def g_without_colour(self) -> Array: ...
    @property
    def g_squared(self) -> Array: ...
    @property
    def g_error(self) -> Array: ...


class StarlightLike(Protocol):
    """A source of the summed light of stars beyond a magnitude."""

    @property
    def source(self) -> str: ...
    def fainter(self, limit_g_mag: float, directions: Array) -> LightLike: ...


@dataclass(frozen=True, eq=False)
class SkyInputs:
    """What was read for the sky; None for a part that the scene does not ask for.

    uniform_m2_sr : electrons/s per m2 of pupil and sr of a uniform sky; uniform_e_s : electrons/s
        of each pixel, where the scene gives that
    zodiacal_rates : of `physics.sky.zodiacal.band_rates`
    undrawn : stars that are left to the sky; every : all stars of the sky, for the Galaxy's dust
    """

    uniform_m2_sr: float | None = None
    uniform_e_s: float | None = None
    zodiacal: z.ZodiacalTable | None = None
    zodiacal_rates: tuple[float, float] = (0.0, 0.0)
    undrawn: StarlightLike | None = None
    every: StarlightLike | None = None
    fit: ColourFit | None = None
    stray: StrayInputs | None = None
    extinction: BandExtinction | None = None
    night: NightBand | None = None
