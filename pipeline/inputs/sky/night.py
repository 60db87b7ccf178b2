"""What airglow, moonlight and twilight need: the published airglow, Sun and Moon in the band."""

from __future__ import annotations

import numpy as np

from pipeline.errors import BadInput
from pipeline.inputs.band.curves import solar_spectrum
from pipeline.inputs.reference import airglow as published
from pipeline.inputs.sky.air import gather_extinction
from pipeline.physics.radiometry import ResponseCurve
from pipeline.physics.sky.extinction import BandExtinction
from pipeline.physics.sky.moon import spectrum
from pipeline.physics.sky.night import (
    NightBand,
    airglow_pieces,
    gathered_lines,
    pieces_of,
    solar_activity,
)
from pipeline.plan.sky.inputs import SkyInputs
from pipeline.plan.sky.undrawn import UndrawnNight
from pipeline.spec.scene import Scene
from pipeline.spec.sky.atmosphere import Atmosphere, Extinction
from pipeline.spec.sky.background import Airglow, Background


def gather_night(request: Background, response: ResponseCurve) -> NightBand:
    """Light of the air in a band. Raises BadInput for airglow where its table has no values."""
    wavelength, irradiance, _, _ = solar_spectrum()
    sun = pieces_of(wavelength, irradiance, response)
    moon = pieces_of(wavelength, spectrum(wavelength, irradiance), response)
    glow, gathered = np.zeros(len(sun)), 1.0
    if isinstance(request.airglow, Airglow):
        edges = np.array(published.EDGES_NM, float)
        ends = response.wavelength_m[[0, -1]] * 1e9
        if ends[0] < edges[0] - 1e-6 or ends[1] > edges[-1] + 1e-6:
            raise BadInput(
                "background.airglow",
                f"a band from {ends[0]:g} to {ends[1]:g} nm",
                f"a band within {edges[0]:g} to {edges[-1]:g} nm, where airglow is known",
            )
        activity = solar_activity(request.airglow.solar_flux_sfu, published.SOLAR_FLUX_SFU)
        table = edges * 1e-9, np.array(published.ZENITH), response
        glow, gathered = airglow_pieces(*table, activity), gathered_lines(*table)
    return NightBand(glow, sun, moon, gathered)


def gather_undrawn(
    scene: Scene, response: ResponseCurve, extinction: BandExtinction | None, dut1_s: float
) -> UndrawnNight:
    """What moonlight and twilight in a band follow from, above a site that need not ask for any.

    extinction : of its air; where the scene has none, that of a standard atmosphere scatters
    """
    band = gather_night(Background(starlight="none"), response)
    if extinction is None:
        air = Atmosphere(extinction=Extinction())
        observer = scene.observer.model_copy(update={"atmosphere": air})
        extinction = gather_extinction(scene.model_copy(update={"observer": observer}), response)
    return UndrawnNight(scene, SkyInputs(extinction=extinction, night=band), dut1_s)
