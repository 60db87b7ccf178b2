"""Spectral reflectance: its mean over the sensor's band in sunlight."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import BadInput
from pipeline.physics.radiometry import ResponseCurve, combine, photon_integral

Array = NDArray[np.float64]


def band_reflectance(
    table: ArrayLike,
    sun_wavelength_m: Array,
    sun_irradiance_w_m3: Array,
    response: ResponseCurve,
    field: str = "albedo",
) -> float:
    """Reflectance of a table [nm, 0..1] (m, 2), averaged over the band's solar electrons.

    int rho E lambda R dlambda / int E lambda R dlambda: the light of a body with this table is
    that of a grey one with this mean. Linear between the points. BadInput, naming `field`, where
    the table does not cover the band.
    """
    nm, value = np.asarray(table, float).T
    used = np.flatnonzero(response.value > 0.0)
    first = response.wavelength_m[max(used[0] - 1, 0)] * 1e9
    last = response.wavelength_m[min(used[-1] + 1, response.wavelength_m.size - 1)] * 1e9
    if nm[0] > first * (1 + 1e-12) or nm[-1] < last * (1 - 1e-12):
        raise BadInput(
            field,
            f"a table from {nm[0]:g} to {nm[-1]:g} nm",
            f"reflectance over the sensor's whole band, {first:g} to {last:g} nm",
        )
    if np.all(value == value[0]):
        return float(value[0])
    metres = nm * 1e-9
    metres[0], metres[-1] = min(metres[0], first * 1e-9), max(metres[-1], last * 1e-9)
    reflected = combine(response, ResponseCurve(metres, value))
    sun = (sun_wavelength_m, sun_irradiance_w_m3)
    return photon_integral(*sun, reflected) / photon_integral(*sun, response)
