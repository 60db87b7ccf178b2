"""What the plan of a site's air needs from the band: its mean wavelength, its extinction."""

from __future__ import annotations

import numpy as np

from pipeline.inputs.band.curves import solar_spectrum, stellar_library
from pipeline.physics.radiometry import ResponseCurve
from pipeline.physics.sky.extinction import BandExtinction, band_extinction
from pipeline.plan.facts import mean_wavelength_m
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.sky.atmosphere import Extinction, Refraction

BLUEST, REDDEST = "O5V", "M5III"


def with_wavelength(scene: Scene, response: ResponseCurve) -> Scene:
    """The scene whose refraction is that of its band's mean wavelength, where it names none."""
    o = scene.observer
    assert isinstance(o, GroundObserver)
    assert o.atmosphere is not None
    request = o.atmosphere.refraction
    if not isinstance(request, Refraction) or request.wavelength_nm is not None:
        return scene
    request = request.model_copy(update={"wavelength_nm": mean_wavelength_m(response) * 1e9})
    air = o.atmosphere.model_copy(update={"refraction": request})
    return scene.model_copy(update={"observer": o.model_copy(update={"atmosphere": air})})


def gather_extinction(scene: Scene, response: ResponseCurve) -> BandExtinction | None:
    """Extinction of the band for sunlight, and how far stars of other colours differ; None where
    the scene asks for none."""
    o = scene.observer
    if not isinstance(o, GroundObserver) or o.atmosphere is None:
        return None
    request = o.atmosphere.extinction
    if not isinstance(request, Extinction):
        return None
    mag: float | tuple[float, float, float, float] = (
        (o.height_m, request.aerosol_mag, request.aerosol_slope, request.ozone_dobson)
        if request.mag_per_airmass is None
        else request.mag_per_airmass
    )
    wavelength, irradiance, _, _ = solar_spectrum()
    library, _ = stellar_library()
    spectra = {name: (w, f) for name, w, f in library}
    ends = [spectra[name] for name in (BLUEST, REDDEST) if name in spectra]
    whole = band_extinction(wavelength, irradiance, response, mag)
    extremes = [band_extinction(w, f, response, mag) for w, f in ends]
    return whole.with_extremes(np.array([e.share for e in extremes]))
