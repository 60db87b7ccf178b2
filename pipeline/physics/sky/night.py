"""Light of the air above a site: airglow, moonlight and twilight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.physics.constants import ARCSEC2_SR, DEG_RAD, PLANCK_J_S, SPEED_OF_LIGHT_M_S
from pipeline.physics.radiometry import ResponseCurve, photon_integral
from pipeline.physics.sky.extinction import PIECES, BandExtinction, air_mass, band_pieces
from pipeline.physics.sky.moon import SUN_V_MAG

Array = NDArray[np.float64]

LAYER = 6371.0 / (6371.0 + 90.0)  # the Earth's radius over that of the glowing layer
V_ZERO_ERG = 3.63e-5  # erg/s/cm2/um of V = 0 (Bessell 1979)
# exp(20.7233 - 0.92104 V) = B / 34.08, in nanolambert (Krisciunas & Schaefer 1991, equation 1)
PER_NANOLAMBERT = np.exp(-20.7233) / 34.08 * 10.0 ** (-0.4 * -SUN_V_MAG) / ARCSEC2_SR
PER_ERG = 10.0 ** (-0.4 * -SUN_V_MAG) / V_ZERO_ERG / ARCSEC2_SR
FOOT_CANDLE = 10.0 ** (-0.4 * (16.57 + SUN_V_MAG))  # of sunlight at 1 au, likewise
TWILIGHT_V = -26.74 + 11.05 + 32.5  # the Sun's V, the unit's zero point, a fit
USUAL_V_MAG = 0.2  # of extinction at the zenith, where a site's own is not known
NEAREST_MOON_RAD = 5.0 * DEG_RAD
AUREOLE_DEG = 8.449078007953648  # where equation 21 meets equation 20; published: 10


@dataclass(frozen=True, eq=False)
class NightBand:
    """What the air's light needs of a band, in the pieces of its extinction (k,).

    airglow : electrons/s/m2/sr at the zenith; sun, moon : electrons/s/m2 of sunlight at 1 au, and
    of moonlight as strong in V
    gathered : times that the band's airglow may be brighter, where lines within it hold all the
        light of the table's boxes that it touches
    """

    airglow: Array
    sun: Array
    moon: Array
    gathered: float = 1.0


def airglow_pieces(
    edges_m: Array, zenith: Array, response: ResponseCurve, activity: float
) -> Array:
    """Electrons/s/m2/sr (k,) of airglow at the zenith, in the pieces of a response's extinction.

    edges_m (n+1,), zenith (n,) : photons/s/m2/um/arcsec2 in boxes, none beyond them; activity :
        brightness relative to the table's (`solar_activity`)
    """
    per_m = zenith * (1e6 / ARCSEC2_SR) * activity
    # steps as a spectrum of photons: two points at each inner edge
    w = np.repeat(edges_m, 2)[1:-1]
    w[1::2] -= 1e-13 * (w[1::2] > 0)
    energy = np.repeat(per_m, 2) / w  # photon_integral multiplies by lambda / (h c)
    energy *= PLANCK_J_S * SPEED_OF_LIGHT_M_S
    return np.array([photon_integral(w, energy, part) for part in band_pieces(response)])


def gathered_lines(edges_m: Array, zenith: Array, response: ResponseCurve) -> float:
    """Most light of boxes (as of `airglow_pieces`) in a response over what their means have there:
    all of each box that it touches, through its peak."""
    ends = response.wavelength_m[[0, -1]]
    touched = (edges_m[1:] > ends[0]) & (edges_m[:-1] < ends[1])
    most = response.value.max() * float(np.sum((zenith * np.diff(edges_m) * 1e6)[touched]))
    return most / (ARCSEC2_SR * float(airglow_pieces(edges_m, zenith, response, 1.0).sum()))


def solar_activity(flux_sfu: float, reference_sfu: float) -> float:
    """Airglow at a solar radio flux over that at another: 0.2 + 0.00614 S, one law for all of it.

    A choice, near the slope of the visible continuum in published fits; the lines of sodium and OH
    follow the Sun less. Good to some 30%.
    """
    return (0.2 + 0.00614 * flux_sfu) / (0.2 + 0.00614 * reference_sfu)


def airglow(band: NightBand, extinction: BandExtinction | None, sine: ArrayLike) -> Array:
    """Electrons/s/m2/sr (n,) towards elevations of a sine (n,).

    A thin layer at 90 km: 1 / sqrt(1 - (R sin z / (R + h))^2) (van Rhijn 1921). Of the extinction a
    part f = 1.669 log10(X) - 0.146 of the scattering acts, X the layer's thickness on the path,
    relative to that at the zenith (Noll et al. 2012, equations 23 and 24), and all absorption. Of
    no more than all: the fit passes 1 some 8 degrees above the horizon.
    """
    s = np.clip(np.asarray(sine, float), 0.0, 1.0)
    layer = 1.0 / np.sqrt(1.0 - LAYER**2 * (1.0 - s * s))
    if extinction is None:
        return np.asarray(layer * band.airglow.sum())
    part = np.minimum(1.669 * np.log10(layer) - 0.146, 1.0)[..., None]
    mass = air_mass(s)[..., None]
    more = extinction.scattered_mag * (part * mass + 0.146)
    more = more + extinction.absorbed_mag * (mass - 1.0)
    return np.asarray(layer * (10.0 ** (-0.4 * more) @ band.airglow))


def moonlight(
    band: NightBand,
    extinction: BandExtinction,
    sine: Array,
    moon_sine: float,
    apart_rad: Array,
    irradiance_share: float,
) -> Array:
    """Electrons/s/m2/sr (n,) of moonlight that the air scatters; none with the Moon set.

    Krisciunas & Schaefer 1991, PASP 103, 1033, equations 3, 15, 18, 20 and 21, wavelength by
    wavelength with the band's own extinction: their formula in V, 8 to 23% from measurements there;
    for a band that scatters otherwise a fair guess. On the Moon's own path the air mass is Kasten &
    Young's, so that it fades at the horizon. Their aureole (equation 21, published for less than 10
    degrees) would be a step of 22% there: it begins at AUREOLE_DEG, where both laws agree. It grows
    without end towards the Moon: it is held within NEAREST_MOON_RAD. Both are choices.

    sine (n,), apart_rad (n,) : of lines of sight: sine of the elevation, angle from the Moon
    irradiance_share : of the Moon above the air, over the solar irradiance at 1 au, in V
    """
    if moon_sine <= 0.0:
        return np.zeros(np.shape(sine))
    scatter = _scatter(np.asarray(apart_rad))
    candle = FOOT_CANDLE * irradiance_share  # 10^(-0.4 (V + 16.57))
    mass = 1.0 / np.sqrt(1.0 - 0.96 * (1.0 - np.square(np.clip(sine, 0.0, 1.0))))
    scattered = 1.0 - 10.0 ** (-0.4 * extinction.scattered_mag * mass[..., None])
    lamp = band.moon * 10.0 ** (-0.4 * extinction.mag * air_mass(moon_sine))
    return PER_NANOLAMBERT * scatter * candle * (scattered @ lamp)


def _scatter(apart_rad: Array) -> Array:
    """How much air scatters by angles (n,) from the Moon: equations 20, 21 and Rayleigh's."""
    apart = apart_rad / DEG_RAD
    nearest = np.maximum(apart, NEAREST_MOON_RAD / DEG_RAD)
    mie = np.where(apart >= AUREOLE_DEG, 10.0 ** (6.15 - apart / 40.0), 6.2e7 / nearest**2)
    return np.asarray(10.0**5.36 * (1.06 + np.cos(apart_rad) ** 2) + mie)


def twilight(
    band: NightBand, extinction: BandExtinction, sine: Array, sun_sine: float, apart_rad: Array
) -> Array:
    """Electrons/s/m2/sr (n,) of twilight, the Sun at or below the horizon.

    Schaefer 1993, Vistas in Astronomy 36, 311, as in his program of 1998 (Sky & Telescope, May):
    in V, erg/s/cm2/um/arcsec2,
    10^(-0.4 (Vsun - M0 + 32.5 - h - z / (360 k))) (100 / apart) (1 - 10^(-0.4 k X)), angles in
    degrees, h the Sun's elevation, X of Rozenberg 1966. In other wavelengths the Sun's light with
    the last factor of each. Against zenith measurements in V (Patat et al. 2006) within 1 mag from
    5 to 14 degrees of depression (tests); colours, the afterglow's shape and volcanic years are
    not in it.

    sine, apart_rad : (n,) lines of sight: sine of the elevation, angle from the Sun
    """
    s = np.clip(np.asarray(sine, float), 0.0, 1.0)
    height_deg = np.arcsin(sun_sine) / DEG_RAD
    zenith_deg = np.arccos(s) / DEG_RAD
    mass = 1.0 / (s + 0.025 * np.exp(-11.0 * s))
    exponent = TWILIGHT_V - height_deg - zenith_deg / (360.0 * max(extinction.v_mag, 0.05))
    level = 10.0 ** (-0.4 * exponent) * 100.0 / np.maximum(apart_rad / DEG_RAD, 1.0)
    scattered = 1.0 - 10.0 ** (-0.4 * extinction.scattered_mag * mass[..., None])
    return PER_ERG * level * (scattered @ band.sun)


def twilight_zenith_v_mag(sun_elevation_rad: float) -> float:
    """V magnitudes per square arcsecond of twilight at the zenith, the Sun below the horizon.

    The same formula, with USUAL_V_MAG of extinction: 19.7 at 12 degrees of depression, and fainter
    than a dark sky from 15 on.
    """
    h = sun_elevation_rad / DEG_RAD
    light = 10.0 ** (-0.4 * (TWILIGHT_V - h)) * 100.0 / (90.0 - h)
    light *= 1.0 - 10.0 ** (-0.4 * USUAL_V_MAG)
    return float(-2.5 * np.log10(light / V_ZERO_ERG))


def pieces_of(wavelength_m: Array, f_lambda: Array, response: ResponseCurve) -> Array:
    """Electrons/s/m2 (PIECES,) of a spectrum in the pieces of a response's extinction."""
    found = [photon_integral(wavelength_m, f_lambda, part) for part in band_pieces(response)]
    assert len(found) == PIECES
    return np.array(found)
