"""What the sky's light is made from: the published tables, the Sun's spectrum, the stars' light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from catalog_tools.catalogue import Catalogue
from pipeline.inputs.band.colour_fit_files import colour_fit_of
from pipeline.inputs.band.curves import solar_spectrum
from pipeline.physics.colour import ColourFit
from pipeline.physics.radiometry import ResponseCurve, surface_brightness_electron_rate
from pipeline.plan.sky.inputs import SkyInputs, StarlightLike
from pipeline.plan.sky.light import background_of
from pipeline.spec.scene import Scene
from pipeline.spec.sky.background import Background

if TYPE_CHECKING:
    from pipeline.physics.sky.extinction import BandExtinction


def gather_sky(
    scene: Scene,
    response: ResponseCurve,
    band: str,
    digest: str,
    catalogues: Sequence[Catalogue],
    fit: ColourFit | None,
    limit_from_noise: bool,
    extinction: BandExtinction | None = None,
) -> SkyInputs:
    """Read what the parts of the scene's background need, and no more.

    response, band, digest : of `run.gather_response`; fit : the stars' colour fit, where there is
    one already; extinction : of the air above the site. Raises Damaged for a damaged map of
    starlight.
    """
    b = background_of(scene)
    table, rates, every = None, (0.0, 0.0), None
    if b.zodiacal:
        from pipeline.inputs.reference import zodiacal as published
        from pipeline.physics.sky.zodiacal import band_rates, zodiacal_table

        table = zodiacal_table(
            np.array(published.LONGITUDE_DEG, float),
            np.array(published.LATITUDE_DEG, float),
            np.array(published.RADIANCE, float),
        )
        wavelength, irradiance, _, _ = solar_spectrum()
        rates = band_rates(wavelength, irradiance, response)
    if b.galactic:
        from catalog_tools.query.starlight import CountedLight

        every = CountedLight()
    undrawn = _undrawn(scene, catalogues, limit_from_noise)
    if fit is None and (every is not None or undrawn is not None or limit_from_noise):
        fit = colour_fit_of(scene, response, band, digest)
    stray = None
    if b.stray_light is not None:
        from pipeline.inputs.sky.stray_light import gather_stray_light

        stray = gather_stray_light(scene, b.stray_light)
    air = None
    if b.of_the_air:
        from pipeline.inputs.sky.night import gather_night

        air = gather_night(b, response)
    return SkyInputs(
        *_uniform(b, response),
        zodiacal=table,
        zodiacal_rates=rates,
        undrawn=undrawn,
        every=every,
        fit=fit,
        stray=stray,
        extinction=extinction,
        night=air,
    )


def _undrawn(
    scene: Scene, catalogues: Sequence[Catalogue], limit_from_noise: bool
) -> StarlightLike | None:
    """Light of the stars that are not drawn; nothing is imported for a scene without."""
    if not limit_from_noise and background_of(scene).starlight != "all":
        return None
    from pipeline.inputs.sky.starlight import gather_starlight

    return gather_starlight(scene, catalogues, limit_from_noise)


def _uniform(b: Background, response: ResponseCurve) -> tuple[float | None, float | None]:
    """A uniform sky: electrons/s per m2 of pupil and sr, and electrons/s of each pixel."""
    if b.uniform_mag_arcsec2 is None:
        return None, b.uniform_e_per_s
    return surface_brightness_electron_rate(b.uniform_mag_arcsec2, response, 1.0, 1.0), None
