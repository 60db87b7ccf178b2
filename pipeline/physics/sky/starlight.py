"""Summed light of stars in Gaia's bands to electrons in the sensor's, by its colour polynomial."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.colour import ColourFit, colour_correction_mag

Array = NDArray[np.float64]


def band_light(
    moments: tuple[Array, Array, Array], g_without_colour: Array, fit: ColourFit
) -> Array:
    """Electrons/s per m2 of pupil (n,) of summed light; a star of G = 0 is 1.

    moments : G light (n,) of stars with a colour; times BP-RP; times its square
    g_without_colour : (n,) G light of the others, which take the fit's default colour

    The mean of the polynomial's light over the stars' colours is taken at their mean plus and minus
    their scatter, half each (exact to third order for a symmetric distribution). Against each star
    with its own colour: 0.5% in 400 to 900 nm, 2% in V and I, 5% in B and 900 to 1700 nm (tests).
    """
    g = np.asarray(moments[0], float)
    mean, square = (
        np.divide(m, g, out=np.zeros_like(g), where=g > 0) for m in (moments[1], moments[2])
    )
    scatter = np.sqrt(np.maximum(square - mean**2, 0.0))
    two = (colour_correction_mag(mean + side * scatter, fit) for side in (-1.0, 1.0))
    coloured = 0.5 * g * sum(10.0 ** (-0.4 * correction) for correction in two)
    plain = colour_correction_mag(np.array([fit.default_colour]), fit)[0]
    light = coloured + g_without_colour * 10.0 ** (-0.4 * plain)
    return np.asarray(fit.zero_electrons_s_m2 * light, float)
