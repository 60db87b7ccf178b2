"""The optics that a scene asks for: one of the kinds of point-spread function, over its band."""

from __future__ import annotations

import math
from dataclasses import asdict, fields, replace

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.arrays import Geometry
from pipeline.errors import BadInput
from pipeline.kept import kept
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.psf.aperture import Pupil, SpiderVanes
from pipeline.physics.psf.band import (
    BandOptics,
    Chromatic,
    NoiseLimit,
    choose_wavelengths,
    mixture,
)
from pipeline.physics.psf.pupil import Airy, Blur, EllipticalGaussian, Gaussian, Optics
from pipeline.physics.psf.response import oversampling_for
from pipeline.physics.psf.sampled import Sampled
from pipeline.physics.psf.seeing import Kolmogorov, Moffat, r0_at, r0_m
from pipeline.physics.psf.von_karman import LEAST_ALONE_R0, LEAST_OUTER_R0, VonKarman
from pipeline.physics.psf.zernike import defocus_rms
from pipeline.physics.radiometry import ResponseCurve
from pipeline.plan.pointing.attitude_motion import fast_blur_px
from pipeline.plan.timing import longest_s
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.detector import TimeDelay
from pipeline.spec.sensor.sensor import (
    FWHM_PX,
    AiryPsf,
    GaussianPsf,
    KolmogorovPsf,
    MoffatPsf,
    OnePsf,
    Sensor,
    TablePsf,
    Vanes,
)

ARCSEC_RAD = math.radians(1.0 / 3600.0)
SMALLEST_Q, LARGEST_Q = 0.02, 64.0
LARGEST_CORE_PX = 256.0
LARGEST_CORE_SAMPLES = 1024  # radius times samples a pixel: what one transform may hold
LARGEST_WHOLE_SAMPLES = 2048  # the same without wings, where nothing else draws what is beyond
FASTEST_F_NUMBER = 0.5
LOWEST_SINE, NOTICED = 0.05, 1.02  # of elevation, for the airmass; what seeing may be wider unsaid
MOST_BLUR_PX = 50.0  # rms per axis, of fast motion of the pointing and of charge diffusion


def blur_of(
    scene: Scene,
    psf: OnePsf,
    response: ResponseCurve,
    mean_m: float,
    table: Sampled | None,
    limit: NoiseLimit | None = None,
) -> tuple[Blur, BandOptics | None]:
    """All that blurs a star, and how its band was resolved (None where nothing depends on it).

    psf : the scene's, or one of its field's; table : its table of light, where it names one
    limit : what the brightest source may err by where the band is resolved
    """
    s = scene.sensor
    diffusion = psf.diffusion_px(s.pixel_pitch_um)
    if diffusion > MOST_BLUR_PX:
        raise BadInput(
            "sensor.psf.charge_diffusion_um", f"{diffusion:.4g} px rms", f"{MOST_BLUR_PX:g} px"
        )
    rest = Blur(
        Gaussian(1.0),
        _jitter_px(scene, psf),
        diffusion,
        s.fill_factor,
        isinstance(psf, TablePsf) and psf.includes_pixel,
        clock_step_px(scene),
    )
    if isinstance(psf, AiryPsf | KolmogorovPsf):
        band = _band(scene, psf, rest, response, mean_m, limit)
        return _with(rest, band.optics), band
    return _with(rest, _fixed(s, psf, table)), None


def _jitter_px(scene: Scene, psf: OnePsf) -> float:
    """Rms per axis of all motion that is drawn as blur: the PSF's own and fast pointing."""
    fast = check_motion(scene)
    return math.hypot(psf.jitter_px, fast) if fast else psf.jitter_px


def check_motion(scene: Scene) -> float:
    """Rms per axis [px] of the motion that is drawn as blur. BadInput where it is too wide."""
    fast = fast_blur_px(scene)
    if fast > MOST_BLUR_PX:
        raise BadInput(
            "pointing.attitude",
            f"motion that blurs by {fast:.4g} px rms",
            f"at most {MOST_BLUR_PX:g} px: weaker or slower motion, or larger pixels",
        )
    return fast


def clock_step_px(scene: Scene) -> float:
    """Length of the steps in which charge follows a moving image; 0 where it does not.

    In exposures of less than one step the image moves by no more than the charge is meant to.
    """
    readout = scene.sensor.detector.readout if scene.sensor.detector else None
    if not isinstance(readout, TimeDelay) or readout.rows_per_s == 0:
        return 0.0
    return min(1.0 / readout.clock_phases, abs(readout.rows_per_s) * longest_s(scene))


def _with(rest: Blur, optics: Optics) -> Blur:
    return replace(rest, optics=optics)


def _fixed(s: Sensor, psf: OnePsf, table: Sampled | None) -> Optics:
    """Optics whose size does not follow the wavelength."""
    if isinstance(psf, GaussianPsf):
        if psf.sigma_minor_px is None:
            return Gaussian(psf.sigma_px)
        angle = math.radians(psf.angle_deg)
        return EllipticalGaussian(psf.sigma_px, psf.sigma_minor_px, angle)
    if isinstance(psf, MoffatPsf):
        return Moffat(_moffat_px(s, psf), psf.beta)
    assert table is not None
    return table


def _moffat_px(s: Sensor, psf: MoffatPsf) -> float:
    """Full width at half maximum [px]. BadInput where one in arcsec is none that is taken in px."""
    if psf.fwhm_px is not None:
        return psf.fwhm_px
    assert psf.fwhm_arcsec is not None
    width_px = psf.fwhm_arcsec * ARCSEC_RAD / s.ifov_rad
    if not FWHM_PX[0] <= width_px <= FWHM_PX[1]:
        ends = " to ".join(f"{px * s.ifov_rad / ARCSEC_RAD:.4g}" for px in FWHM_PX)
        raise BadInput(
            "sensor.psf.fwhm_arcsec",
            psf.fwhm_arcsec,
            f"{ends} arcsec, {FWHM_PX[0]:g} to {FWHM_PX[1]:g} px",
        )
    return width_px


def _band(
    scene: Scene,
    psf: AiryPsf | KolmogorovPsf,
    rest: Blur,
    response: ResponseCurve,
    mean_m: float,
    limit: NoiseLimit | None,
) -> BandOptics:
    """Optics of one wavelength where one is asked for, else as many as the accuracy asks for."""
    wave_m = mean_m if psf.wavelength_nm is None else psf.wavelength_nm * 1e-9

    def make(wavelength_m: float) -> Chromatic:
        return _chromatic(scene.sensor, psf, wavelength_m, wave_m)

    if psf.wavelength_nm is not None or psf.wavelengths == 1:
        return BandOptics(make(wave_m), (wave_m,), (1.0,), 0.0, 0.0)
    if not (scene.stars or scene.targets or scene.populations):  # nothing is drawn with it
        return BandOptics(make(mean_m), (mean_m,), (1.0,), 0.0, 0.0)
    curve = (response.wavelength_m, response.value)
    reddest = make(float(curve[0][-1]))  # first: what is refused there may be taken elsewhere
    check_scale(psf.kind, _with(rest, make(wave_m)))  # before work that grows with it
    most = scene.accuracy.flux_fraction

    def choose() -> JsonObject:
        chosen = choose_wavelengths(make, rest, *curve, most, psf.wavelengths, limit)
        return {f.name: getattr(chosen, f.name) for f in fields(chosen)[1:]}

    of = make(float(curve[0][0])), reddest
    found = kept(("wavelengths of a band", of, rest, curve, most, psf.wavelengths, limit), choose)
    waves, weights = tuple(found["wavelengths_m"].tolist()), tuple(found["weights"].tolist())
    if len(waves) == 1:  # the mean, to the last bit
        waves, weights = (mean_m,), (1.0,)
    error, of_one, sigma = (float(found[k]) for k in ("error", "error_of_one", "error_sigma"))
    of_colours = tuple(found["error_of_colours"].tolist())
    optics = mixture(tuple(map(make, waves)), weights)
    return BandOptics(optics, waves, weights, error, of_one, sigma, of_colours)


def _chromatic(
    s: Sensor, psf: AiryPsf | KolmogorovPsf, wavelength_m: float, wave_m: float
) -> Chromatic:
    """Optics at a wavelength; `wave_m` is the wave that aberrations in waves are counted in."""
    pitch = s.pixel_pitch_um * 1e-6
    q = wavelength_m * s.focal_length_m / (s.aperture_m * pitch)
    if isinstance(psf, KolmogorovPsf):
        telescope = Airy(q, s.obscuration) if psf.diffraction else None
        return _seeing(s, psf, telescope, wavelength_m)
    terms: dict[int, float] = {}
    for a in psf.aberrations:
        rms = a.rms_nm * 1e-9 if a.rms_nm is not None else (a.rms_waves or 0.0) * wave_m
        terms[a.noll] = rms / wavelength_m
    if psf.defocus_um:
        rms = defocus_rms(psf.defocus_um * 1e-6, s.focal_length_m / s.aperture_m)
        terms[4] = terms.get(4, 0.0) + rms / wavelength_m
    if psf.vanes is None and not terms:
        return Airy(q, s.obscuration)
    vanes = None if psf.vanes is None else _vanes(s, psf.vanes)
    return Pupil(q, s.obscuration, vanes, tuple(sorted(terms.items())))


def _seeing(
    s: Sensor, psf: KolmogorovPsf, telescope: Airy | None, wavelength_m: float
) -> Kolmogorov:
    """Turbulent air before a telescope, at a wavelength."""
    pitch = s.pixel_pitch_um * 1e-6
    scale = wavelength_m / _fried_m(psf, wavelength_m) * s.focal_length_m / pitch
    if psf.outer_scale_m is None:
        return Kolmogorov(scale, telescope)
    outer = _outer_scale_r0(psf, psf.outer_scale_m, wavelength_m)
    return VonKarman(scale, telescope, outer_scale_r0=outer)


def _fried_m(psf: KolmogorovPsf, wavelength_m: float) -> float:
    """Fried's parameter at a wavelength."""
    reference, r0 = psf.reference_nm * 1e-9, psf.r0_m
    if r0 is None:
        assert psf.fwhm_arcsec is not None
        r0 = r0_m(psf.fwhm_arcsec * ARCSEC_RAD, reference)
    return r0_at(r0, reference, wavelength_m)


def _outer_scale_r0(psf: KolmogorovPsf, outer_scale_m: float, wavelength_m: float) -> float:
    """The outer scale over Fried's parameter at a wavelength. BadInput where it is too small."""
    r0 = _fried_m(psf, wavelength_m)
    least = LEAST_OUTER_R0 if psf.diffraction else LEAST_ALONE_R0
    if outer_scale_m < least * r0:
        raise BadInput(
            "sensor.psf.outer_scale_m",
            outer_scale_m,
            f"{1.0005 * least * r0:.4g} or more: {least:g} times Fried's parameter at "
            f"{wavelength_m * 1e9:.0f} nm",
        )
    return outer_scale_m / r0


def check_scale(kind: str, blur: Blur) -> None:
    """BadInput for a response with wings that is too sharp or too wide for the pixels."""
    optics = blur.optics
    if not optics.has_wings:
        return
    q, core = optics.scale_px, optics.core_px
    most = LARGEST_CORE_PX
    if SMALLEST_Q <= q <= LARGEST_Q:
        most = min(most, LARGEST_CORE_SAMPLES / oversampling_for(blur))
        if core <= most:
            return
    raise BadInput(
        "sensor.psf",
        f"{kind} of a scale (Q = lambda F / (D pitch), or FWHM) of {q:.4g} px and a core of "
        f"{core:.4g} px",
        f"{SMALLEST_Q} px to {LARGEST_Q:g} px, a core of at most {most:.4g} px: another pitch, "
        "focal length or wavelength, weaker aberrations, or a gaussian",
    )


def check_core(blur: Blur, radius_px: float) -> None:
    """BadInput for a response without wings whose core, of a radius, takes too many samples."""
    per_px = oversampling_for(blur)
    if radius_px * per_px > LARGEST_WHOLE_SAMPLES:
        raise BadInput(
            "sensor.psf",
            f"{per_px} samples a pixel over {radius_px:.4g} px around",
            f"at most {LARGEST_WHOLE_SAMPLES / per_px:.4g} px of details so sharp: an image less "
            "elongated, or smaller",
        )


def check_ringing(share: float, most: float) -> None:
    """BadInput where so much of the light lies between and beyond the samples of a table."""
    if share > most:
        raise BadInput(
            "sensor.psf",
            f"a table with {share:.2g} of its light beyond its samples",
            f"at most {most:g} (accuracy.flux_fraction), as band-limited samples ring on: more "
            "samples_per_px, or a table that falls to 0 at its edges",
        )


def open_fraction(optics: Optics, band: BandOptics | None) -> float:
    """Share of the annular aperture that vanes leave open."""
    parts = getattr(optics, "parts", (optics,)) if band else ()
    return min((p.open_fraction for p in parts if isinstance(p, Pupil)), default=1.0)


def open_past_vanes(s: Sensor) -> float:
    """Fraction of the annular aperture that the vanes leave open, whatever the wavefront."""
    vanes = {p.vanes for p in s.every_psf if isinstance(p, AiryPsf) and p.vanes is not None}
    return min((Pupil(1.0, s.obscuration, _vanes(s, v)).open_fraction for v in vanes), default=1.0)


def _vanes(s: Sensor, given: Vanes) -> SpiderVanes:
    """Vanes in units of the aperture and radians."""
    return SpiderVanes(given.count, given.width_m / s.aperture_m, math.radians(given.angle_deg))


def optics_remarks(scene: Scene) -> list[str]:
    """What is said of a pupil that sends its light from more than half the sky (sine condition)."""
    s = scene.sensor
    f_number = s.focal_length_m / s.aperture_m
    if f_number >= FASTEST_F_NUMBER:
        return []
    return [
        f"sensor.aperture_m: {s.aperture_m:g} m over a focal length of {s.focal_length_m:g} m is "
        f"F/{f_number:.2g}; no optics in air is faster than F/{FASTEST_F_NUMBER:g}: a sky gives "
        f"{(FASTEST_F_NUMBER / f_number) ** 2:.3g} times what any could collect"
    ]


def seeing_remarks(scene: Scene, g: Geometry) -> list[str]:
    """What is said of seeing away from the zenith: it is drawn as it is given.

    Seeing of one turbulent air grows as the airmass to 0.6 (Fried 1966, JOSA 56, 1372).
    """
    ground = isinstance(scene.observer, GroundObserver)
    if not (ground and isinstance(scene.sensor.psf, KolmogorovPsf)):
        return []
    middle = g.middle
    up = g.observer_m[:, middle] - earth_and_sun(g.tt1[:, middle], g.tt2[:, middle]).position_m
    sines = np.sum(g.attitude[:, middle, 2] * up, axis=-1) / np.sqrt(np.sum(up**2, axis=-1))
    lowest = int(np.argmin(sines))
    wider = max(float(sines[lowest]), LOWEST_SINE) ** -0.6
    if wider < NOTICED:
        return []
    return [
        "sensor.psf: seeing is that along the line of sight, the same at all elevations; what is "
        f"told for the zenith is {wider:.2g} times as wide at "
        f"{math.degrees(math.asin(sines[lowest])):.2g} deg (frame {g.frame[lowest]})"
    ]


def missing_light(optics: Optics) -> float:
    """Share of a source's light that the optics do not hold at all (outside of a table)."""
    return 1.0 - optics.light if isinstance(optics, Sampled) else 0.0


def describe(optics: Optics) -> JsonObject:
    """The optics as plain values, for the plan."""
    if isinstance(optics, Sampled):
        band = optics.band
        return {
            "kind": "table",
            "shape": list(optics.samples.shape),
            "light": optics.light,
            "spacing_px": optics.spacing_px,
            "centre": list(optics.centre),
            "digest": optics.digest,
            "band_cycles_px": band.limit,
            "left_out": band.left_out,
            "at_highest_frequency": band.nyquist,
        }
    return asdict(optics) | {"kind": type(optics).__name__.lower()}
