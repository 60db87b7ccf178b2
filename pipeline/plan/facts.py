"""Facts of a scene: numbers that follow from it at once and on which decisions rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import Array
from pipeline.physics.psf.band import BandOptics, NoiseLimit
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.sampled import Sampled
from pipeline.physics.radiometry import (
    ResponseCurve,
    ab_photon_rate,
    collecting_area_m2,
    pixel_solid_angle_sr,
    surface_brightness_electron_rate,
)
from pipeline.plan.accuracy import part_sigma
from pipeline.plan.optics.optics import blur_of, open_fraction, open_past_vanes
from pipeline.plan.timing import integration_range_s
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.sensor import FieldPsf

if TYPE_CHECKING:
    from pipeline.plan.optics.psf_field import PsfField


Terms = tuple[float, float, float]  # of a pixel: dark [e-/s], noise of reading [e-], gain [e-/DN]


@dataclass(frozen=True)
class Facts:
    """What the plan knows of a scene before any star is read.

    area_m2 : collecting area; ifov_rad : side of a pixel on the sky
    mean_wavelength_m : of the response, photon-weighted for a flat photon spectrum; ends_m : its
        shortest and its longest wavelength
    blur : the response of optics, jitter, diffusion and pixel; of a field, the sharpest
    band : how the optics' band was resolved; None where the optics do not follow the wavelength;
        of a field, the one that errs most
    background_e_s : sky of the darkest pixel, per second; of `gather_facts` alone the uniform sky
        in the central pixel; background_e : the same in an exposure
    dark_e, read_noise_e : typical values (medians)
    sigma_floor_e : noise of a quiet pixel that holds no source: photon noise of sky and dark where
        the scene draws it, read noise, quantisation
    quieter_e2 : how much less variance that is than a typical pixel's [e-^2]
    budget_e : error of the light that one approximation may make in such a pixel
    field : the responses over the field; None where one serves it all
    brightest_e : light of the brightest source in the longest exposure; 0 where not known
    flat : typical response to light (median), which SNR counts
    ab_rate_e_s_m2 : electrons of a source of AB magnitude 0 in the band, above the air
    top_e : signal at which the converter of a typical pixel ends (median)
    """

    area_m2: float
    ifov_rad: float
    mean_wavelength_m: float
    ends_m: tuple[float, float]
    blur: Blur
    band: BandOptics | None
    background_e_s: float
    background_e: float
    dark_e: float
    read_noise_e: float
    sigma_floor_e: float
    budget_e: float
    field: PsfField | None = None
    brightest_e: float = 0.0
    flat: float = 1.0
    ab_rate_e_s_m2: float = math.nan
    quieter_e2: float = 0.0
    top_e: float = math.inf

    @property
    def light_floor_e(self) -> float:
        """`sigma_floor_e` as errors of the light count against it, which a flat above 1 raises."""
        return light_floor_e(self.sigma_floor_e, self.flat)


def light_floor_e(sigma_e: float, flat: float) -> float:
    """Noise of a pixel [e-] in terms of the light before its flat; at most as it is after it."""
    return sigma_e / max(1.0, flat)


def gather_facts(
    scene: Scene,
    response: ResponseCurve,
    dark_e_s: float,
    read_noise_e: float,
    gain_e_per_dn: float,
    table: Sampled | tuple[Sampled | None, ...] | None = None,
    brightest_e: float = 0.0,
    flat: float = 1.0,
    quiet: Terms | None = None,
    top_e: float = math.inf,
) -> Facts:
    """Facts from the scene, its response curve and the typical values of its sensor maps.

    Of several integration times the shortest: its frames have the least noise to hide errors in.

    table : the point-spread function that the scene names as a table, read; of a field, one for
        each of its places, row by row (None for those that are no table)
    brightest_e : light of the brightest source in the longest exposure, as far as it is known
    flat : typical response to light (median); top_e : of the Facts
    quiet : terms of a quiet pixel; default: the typical ones
    """
    s, t = scene.sensor, integration_range_s(scene)[0]
    pitch = s.pixel_pitch_um * 1e-6
    wavelength = mean_wavelength_m(response)
    dark, typical = dark_e_s * t, (dark_e_s, read_noise_e, gain_e_per_dn)
    quiet = quiet or typical
    annulus_m2 = collecting_area_m2(s.aperture_m, s.obscuration)

    def noise_e(area_m2: float) -> tuple[float, float]:
        """Light of the sky [e-/s], and the noise of a pixel without sources [e-]."""
        sky = background_rate_e_s(scene, response, area_m2, pitch)
        return sky, noise_floor_e(scene, sky * t, quiet)

    floor_e = noise_e(annulus_m2 * open_past_vanes(s))[1]
    limit = None
    if brightest_e > 0.0:
        floor_e = planned_floor_e(scene, light_floor_e(floor_e, flat))
        limit = NoiseLimit(brightest_e, floor_e, part_sigma(scene), s.photon_noise)
    field = None
    if isinstance(s.psf, FieldPsf):
        from pipeline.plan.optics.psf_field import plan_psf_field

        tables = table if isinstance(table, tuple) else ()
        field, blur, band = plan_psf_field(scene, s.psf, response, wavelength, tables, limit)
    else:
        assert not isinstance(table, tuple)
        blur, band = blur_of(scene, s.psf, response, wavelength, table, limit)
    area = annulus_m2 * open_fraction(blur.optics, band)
    sky, sigma = noise_e(area)
    return Facts(
        area_m2=area,
        ifov_rad=pitch / s.focal_length_m,
        mean_wavelength_m=wavelength,
        ends_m=ends_m(response),
        blur=blur,
        band=band,
        background_e_s=sky,
        background_e=sky * t,
        dark_e=dark,
        read_noise_e=read_noise_e,
        sigma_floor_e=sigma,
        budget_e=error_budget_e(scene, light_floor_e(sigma, flat)),
        field=field,
        brightest_e=brightest_e,
        flat=flat,
        ab_rate_e_s_m2=ab_photon_rate(0.0, response),
        quieter_e2=quieter_e2(scene, typical, quiet),
        top_e=top_e,
    )


def noise_floor_e(scene: Scene, sky_e: float, terms: Terms) -> float:
    """Noise [e-] of a pixel of these terms, under so much sky in the shortest exposure: of photons,
    unless the scene draws none; of reading; of rounding, which is never nothing."""
    return math.sqrt(floor_e2(scene, sky_e, terms))


def floor_e2(scene: Scene, sky_e: float, terms: Sequence[Array | float]) -> Array:
    """Its square, the variance; of many pixels, too."""
    dark_e_s, read_noise_e, gain_e_per_dn = map(np.asarray, terms)
    charge_e = sky_e + dark_e_s * integration_range_s(scene)[0]
    photons_e2 = charge_e if scene.sensor.photon_noise else 0.0
    return np.asarray(photons_e2 + read_noise_e**2 + gain_e_per_dn**2 / 12.0)


def quieter_e2(scene: Scene, typical: Terms, quiet: Terms) -> float:
    """How much less variance a pixel of quiet terms has than a typical one [e-^2]."""
    return float(floor_e2(scene, 0.0, typical) - floor_e2(scene, 0.0, quiet))


def error_budget_e(scene: Scene, sigma_e: float) -> float:
    """Error that one approximation may make of the light in a pixel of this noise [e-]."""
    return part_sigma(scene) * planned_floor_e(scene, sigma_e)


def planned_floor_e(scene: Scene, sigma_e: float) -> float:
    """Noise of a pixel without sources that drawing is planned for [e-]."""
    floor = scene.accuracy.noise_floor_e
    return sigma_e if floor is None else min(sigma_e, floor)


def mean_wavelength_m(response: ResponseCurve) -> float:
    """Mean wavelength of the response [m], by the trapezium rule on its own points."""
    w, v = response.wavelength_m, response.value
    total = float(np.trapezoid(v, w))
    return float(np.trapezoid(v * w, w)) / total if total > 0 else float(0.5 * (w[0] + w[-1]))


def ends_m(response: ResponseCurve) -> tuple[float, float]:
    """Shortest and longest wavelength [m] between which the response is not zero throughout."""
    lit = np.flatnonzero(response.value > 0.0)
    if not lit.size:
        return float(response.wavelength_m[0]), float(response.wavelength_m[-1])
    last = min(lit[-1] + 1, response.wavelength_m.size - 1)
    return float(response.wavelength_m[max(lit[0] - 1, 0)]), float(response.wavelength_m[last])


def background_rate_e_s(
    scene: Scene, response: ResponseCurve, area_m2: float, pitch_m: float
) -> float:
    """Electrons per second of the uniform part of the sky in the central pixel; 0 where there is
    none."""
    b = scene.background
    if b is None:
        return 0.0
    if b.uniform_e_per_s is not None:
        return b.uniform_e_per_s
    if b.uniform_mag_arcsec2 is None:
        return 0.0
    solid_angle = pixel_solid_angle_sr(pitch_m, scene.sensor.focal_length_m)
    rate = surface_brightness_electron_rate(b.uniform_mag_arcsec2, response, area_m2, solid_angle)
    return rate * scene.sensor.fill_factor
