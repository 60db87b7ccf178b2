"""The response of a scene's sensor, and what of it the scene's sources need."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.inputs.band.colour_fit_files import colour_fit_of
from pipeline.inputs.band.curves import filter_facts, resolve_response, solar_spectrum
from pipeline.physics.colour import ColourFit
from pipeline.physics.radiometry import ResponseCurve, band_photon_irradiance_sun
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.sensor import NamedBand

REDDER = "0.4% of Gaia's, M giants and late dwarfs; "  # than the library's spectra that are fitted


@dataclass(frozen=True)
class BandLight:
    """What a band makes of starlight and sunlight.

    colour : the stars' colour fit, None without stars; sun_rate_e_s_m2 : electrons of sunlight, 0
    without targets; remarks : where both are from, and what a published band holds already
    """

    colour: ColourFit | None
    sun_rate_e_s_m2: float
    remarks: tuple[str, ...]


def gather_response(scene: Scene) -> tuple[ResponseCurve, str, str]:
    """Bandpass x optics x quantum efficiency of a scene's sensor, its name and digest."""
    s = scene.sensor
    return resolve_response(s.bandpass.model_dump(), s.transmission, s.quantum_efficiency)


def gather_band_light(scene: Scene, response: ResponseCurve, band: str, digest: str) -> BandLight:
    """The colour fit if there are stars and the Sun's electron rate if there are targets."""
    colour, sun, remarks = None, 0.0, _held_by_the_band(scene)
    if scene.stars is not None:
        colour = colour_fit_of(scene, response, band, digest)
        remarks.append(
            f"star colours: {colour.source}; fit of {colour.spectra_count} with a residual of "
            f"{colour.residual_rms_mag:.3f} mag rms; stars redder than BP-RP = "
            f"{colour.colour_range[1]:.2f} ({'' if colour.digest else REDDER}colour_flag 2) are "
            f"drawn with that colour{_off(colour)}"
        )
    if scene.targets or scene.populations:
        wavelength, irradiance, source, error = solar_spectrum()
        sun = band_photon_irradiance_sun(wavelength, irradiance, response)
        remarks.append(f"solar spectrum: {source}; {error}")
    return BandLight(colour, sun, tuple(remarks))


def _off(fit: ColourFit) -> str:
    """How far off stars redder than a fit are; of fewer spectra than there are, in V."""
    if fit.redder_error_mag:
        return f", up to {fit.redder_error_mag:.2f} mag off"
    return "" if fit.digest else ", up to 1.1 mag off in V"


def _held_by_the_band(scene: Scene) -> list[str]:
    """What a published band holds already, and the scene puts on it once more."""
    s, o = scene.sensor, scene.observer
    if not isinstance(s.bandpass, NamedBand):
        return []
    told, name = [], s.bandpass.name
    most, air_masses = filter_facts(name)
    if most < 1.0 and (s.transmission, s.quantum_efficiency) != (1.0, 1.0):
        told.append(
            f"sensor.bandpass: {name} is the response of a whole instrument, at most {most:.2g}; "
            "transmission and quantum_efficiency multiply it"
        )
    again = "the observer is above it"
    if isinstance(o, GroundObserver):
        dims = o.atmosphere and o.atmosphere.extinction
        again = "extinction dims all light once more" if dims else ""
    if air_masses and again:
        told.append(f"sensor.bandpass: {name} holds the air of {air_masses:g} air masses; {again}")
    return told
