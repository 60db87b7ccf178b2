"""Photons through a response: spectral integrals, collecting area, AB surface brightness."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.physics.constants import (
    AB_ZERO_FLUX_W_M2_HZ,
    ARCSEC2_SR,
    PLANCK_J_S,
    SPEED_OF_LIGHT_M_S,
)

Array = NDArray[np.float64]

COMBINE_TOLERANCE = 1e-6  # largest error of a combined curve, relative to its peak


@dataclass(frozen=True)
class ResponseCurve:
    """Electrons per photon that enters the pupil, as a function of wavelength.

    The product of bandpass, optics transmission and quantum efficiency; linear between the
    points and zero outside of them, so that a box is two points.

    wavelength_m : (n,) float64, metres, strictly ascending, n >= 2
    value : (n,) float64, electrons per photon, not negative
    """

    wavelength_m: Array
    value: Array

    def __post_init__(self) -> None:
        wavelength = np.array(self.wavelength_m, dtype=np.float64)
        value = np.array(self.value, dtype=np.float64)
        if wavelength.ndim != 1 or wavelength.shape != value.shape or wavelength.size < 2:
            raise ValueError("a response needs two equally long columns of at least two points")
        if not (np.all(np.diff(wavelength) > 0.0) and 0.0 < wavelength[0] < wavelength[-1] < 1.0):
            raise ValueError("wavelengths must ascend strictly, in metres")
        if not (np.all(np.isfinite(value)) and np.all(value >= 0.0)):
            raise ValueError("responses must be finite and not negative")
        wavelength.flags.writeable = value.flags.writeable = False
        object.__setattr__(self, "wavelength_m", wavelength)
        object.__setattr__(self, "value", value)


def box(short_m: float, long_m: float) -> ResponseCurve:
    """A response of one between two wavelengths in metres, zero elsewhere."""
    return ResponseCurve(np.array([short_m, long_m]), np.ones(2))


def scale(curve: ResponseCurve, factor: float) -> ResponseCurve:
    """The curve times a dimensionless factor that is not negative."""
    return ResponseCurve(curve.wavelength_m, curve.value * factor)


def combine(*curves: ResponseCurve) -> ResponseCurve:
    """Product of curves on the union of their points, zero where any of them is zero.

    The product of two linear pieces is a parabola, at most |da db|/4 above its chord; an
    interval is divided until that is below `COMBINE_TOLERANCE` of the peak.
    ValueError where the curves have no wavelength in common.
    """
    product = curves[0]
    for curve in curves[1:]:
        product = _product(product, curve)
    return product


def _product(first: ResponseCurve, second: ResponseCurve) -> ResponseCurve:
    grid = _merged(first.wavelength_m, second.wavelength_m)
    if grid.size < 2:
        raise ValueError("the response curves have no wavelength in common")
    a = np.interp(grid, first.wavelength_m, first.value)
    b = np.interp(grid, second.wavelength_m, second.value)
    bound = COMBINE_TOLERANCE * max(float(np.max(a * b)), np.finfo(float).tiny)
    bend = np.abs(np.diff(a) * np.diff(b)) / 4.0
    # At most 1000 parts: curves that barely overlap cannot ask for endless points.
    parts = np.minimum(np.ceil(np.sqrt(bend / bound)), 1000).astype(int).clip(min=1)
    start = np.repeat(grid[:-1], parts)
    step = np.repeat(np.diff(grid) / parts, parts)
    index = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    fine = np.unique(np.append(start + index * step, grid[-1]))
    value = np.interp(fine, grid, a) * np.interp(fine, grid, b)
    return ResponseCurve(fine, value)


def _merged(first_m: Array, second_m: Array) -> Array:
    """Points of both grids that lie within both, (k,) ascending; k = 0 or 1 without overlap."""
    union = np.union1d(first_m, second_m)
    inside = (union >= max(first_m[0], second_m[0])) & (union <= min(first_m[-1], second_m[-1]))
    return union[inside]


def photon_integral(wavelength_m: Array, f_lambda: Array, response: ResponseCurve) -> float:
    """Electron rate of a spectrum: int F_lambda lambda/(h c) R dlambda.

    Both curves are linear between their points and zero outside of them. On the merged grid the
    integrand is a cubic, which Simpson's rule integrates exactly: no error beyond rounding.

    wavelength_m : (n,) metres, ascending; f_lambda : (n,) W/m2/m
    Returns electrons/s/m2 (for a radiance in W/m2/m/sr: electrons/s/m2/sr).
    """
    return _weighted_integral(wavelength_m, f_lambda, response, 1) / (
        PLANCK_J_S * SPEED_OF_LIGHT_M_S
    )


def energy_integral(wavelength_m: Array, f_lambda: Array, response: ResponseCurve) -> float:
    """int F_lambda R dlambda in W/m2, exact for linear pieces like `photon_integral`."""
    return _weighted_integral(wavelength_m, f_lambda, response, 0)


def _weighted_integral(
    wavelength_m: Array, f_lambda: Array, response: ResponseCurve, power: int
) -> float:
    grid = _merged(wavelength_m, response.wavelength_m)
    if grid.size < 2:
        return 0.0
    flux = np.interp(grid, wavelength_m, f_lambda)
    value = np.interp(grid, response.wavelength_m, response.value)
    middle = 0.5 * (grid[1:] + grid[:-1])
    at_middle = 0.25 * (flux[1:] + flux[:-1]) * (value[1:] + value[:-1]) * middle**power
    at_points = flux * value * grid**power
    simpson = (at_points[:-1] + 4.0 * at_middle + at_points[1:]) / 6.0
    return math.fsum(simpson * np.diff(grid))


def band_photon_irradiance_sun(
    wavelength_m: Array, irradiance_w_m3: Array, response: ResponseCurve
) -> float:
    """Electrons/s/m2 of pupil from direct sunlight at 1 au.

    wavelength_m : (n,) metres; irradiance_w_m3 : (n,) solar spectral irradiance at 1 au, W/m2/m
    """
    return photon_integral(wavelength_m, irradiance_w_m3, response)


def collecting_area_m2(aperture_m: float, obscuration: float) -> float:
    """Area of an annular pupil, pi/4 D^2 (1 - eps^2), in m2; eps is the ratio of diameters."""
    return 0.25 * math.pi * aperture_m**2 * (1.0 - obscuration) * (1.0 + obscuration)


def pixel_solid_angle_sr(
    pixel_pitch_m: float, focal_length_m: float, off_axis_rad: float = 0.0
) -> float:
    """Solid angle of a square pixel of a gnomonic camera: (pitch/f)^2 cos^3(theta), steradians."""
    return (pixel_pitch_m / focal_length_m) ** 2 * math.cos(off_axis_rad) ** 3


def ab_photon_rate(mag_ab: float, response: ResponseCurve) -> float:
    """Electrons/s/m2 of a source that is flat in f_nu with this AB magnitude in any band.

    3631 Jy 10^(-0.4 m) / h int R dlambda/lambda (Oke & Gunn 1983, ApJ 266, 713), exact for the
    linear pieces; 5.4798e10 ln(l2/l1) for a box and m = 0.
    """
    short, long = response.wavelength_m[:-1], response.wavelength_m[1:]
    width = long - short
    log_ratio = np.log1p(width / short)
    slope = np.diff(response.value) / width
    pieces = response.value[:-1] * log_ratio + slope * (width - short * log_ratio)
    return AB_ZERO_FLUX_W_M2_HZ * 10.0 ** (-0.4 * mag_ab) / PLANCK_J_S * math.fsum(pieces)


def surface_brightness_electron_rate(
    mag_ab_arcsec2: float, response: ResponseCurve, area_m2: float, pixel_solid_angle_sr: float
) -> float:
    """Electrons/s/pixel of a uniform sky.

    mag_ab_arcsec2 : AB magnitude per square arcsecond in the sensor's own band (the scene's
    `uniform_mag_arcsec2`), of a sky that is flat in f_nu over the band.
    area_m2 : collecting area; pixel_solid_angle_sr : steradians, fill factor included.
    """
    return ab_photon_rate(mag_ab_arcsec2, response) * area_m2 * pixel_solid_angle_sr / ARCSEC2_SR


def spectrum_from_box_means(edges_m: Array, means: Array, step_m: float) -> tuple[Array, Array]:
    """Smooth, not negative spectrum with the given means over neighbouring boxes.

    The derivative of the monotone cubic (Fritsch & Carlson 1980) through the cumulative
    integral: it keeps every box's integral and rings nowhere. It is sampled at about `step_m`
    and at the edges; the samples, joined linearly, keep the integrals to second order in the
    step.

    edges_m : (n+1,) ascending, metres; means : (n,) not negative, any unit
    Returns wavelength_m (k,) and values (k,) in the unit of `means`.
    """
    cumulative = np.concatenate([[0.0], np.cumsum(means * np.diff(edges_m))])
    slope = scipy.interpolate.PchipInterpolator(edges_m, cumulative).derivative()
    counts = np.maximum(1, np.rint(np.diff(edges_m) / step_m)).astype(int)
    boxes = zip(edges_m[:-1], edges_m[1:], counts, strict=True)
    pieces = [np.linspace(low, high, count, endpoint=False) for low, high, count in boxes]
    wavelength = np.append(np.concatenate(pieces), edges_m[-1])
    return wavelength, np.maximum(slope(wavelength), 0.0)
