"""Patterns that a detector keeps from frame to frame, drawn by the seed: PRNU, hot pixels, bias.

Each is keyed by the pixel, as the noise is, so that it is the same in every tile and frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.noise.streams import standard_normals, stream_key, uniforms

Array = NDArray[np.float64]


def prnu(shape: tuple[int, int], seed: int, rms: float) -> Array:
    """Factors (ny, nx) on the flat: normal about 1 with standard deviation `rms`, never below 0."""
    factors = 1.0 + rms * standard_normals(*shape, 0, 0, 0, *stream_key(seed, "prnu"))
    return np.maximum(factors, 0.0)


def chosen(shape: tuple[int, int], seed: int, component: str, fraction: float) -> NDArray[np.bool_]:
    """Pixels (ny, nx) that are chosen, each with the chance `fraction`, by itself."""
    return uniforms(*shape, 0, 0, 0, *stream_key(seed, component)) < fraction


def hot_dark_e_s(
    shape: tuple[int, int], seed: int, fraction: float, median_e_s: float, sigma_dex: float
) -> Array:
    """Dark current (ny, nx) [e-/s] that hot pixels add: log-normal in a share of them, else 0."""
    y, x = np.nonzero(chosen(shape, seed, "hot_pixels", fraction))
    out = np.zeros(shape)
    draws = standard_normals(*shape, 0, 0, 0, *stream_key(seed, "hot_levels"))[y, x]
    out[y, x] = median_e_s * 10.0 ** (sigma_dex * draws)
    return out


def bias_pattern_dn(
    shape: tuple[int, int],
    seed: int,
    row_rms_dn: float,
    column_rms_dn: float,
    pixel_rms_dn: float,
    row_slope_dn: float,
    column_slope_dn: float,
) -> Array:
    """Fixed pattern (ny, nx) [DN] about the bias: offsets of rows, columns, pixels, and a plane.

    The slopes are from the first row or column to the last, 0 in the middle.
    """
    (rows, columns), out = shape, np.zeros(shape)
    for name, rms, sides in (
        ("bias_rows", row_rms_dn, (rows, 1)),
        ("bias_columns", column_rms_dn, (1, columns)),
        ("bias_pixels", pixel_rms_dn, (rows, columns)),
    ):
        if rms > 0:
            out += rms * standard_normals(*sides, 0, 0, 0, *stream_key(seed, name))
    out += row_slope_dn * _ramp(rows)[:, None] + column_slope_dn * _ramp(columns)
    return out


def _ramp(n: int) -> Array:
    """-1/2 to 1/2 in n equal steps; 0 for one."""
    return np.linspace(-0.5, 0.5, n) if n > 1 else np.zeros(1)
