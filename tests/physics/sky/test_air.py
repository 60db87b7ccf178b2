"""The air's extinction and its own light against published values and formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.inputs.band.curves import named_filter, solar_spectrum
from pipeline.inputs.reference import airglow as published
from pipeline.inputs.sky.night import gather_night
from pipeline.physics.constants import ARCSEC2_SR, DEG_RAD
from pipeline.physics.radiometry import ab_photon_rate, box, photon_integral
from pipeline.physics.sky.extinction import (
    BandExtinction,
    air_mass,
    band_extinction,
    coefficients,
)
from pipeline.physics.sky.moon import (
    COLOUR,
    COLOUR_NM,
    band_rate,
    irradiance_share,
    spectrum,
)
from pipeline.physics.sky.night import (
    NightBand,
    airglow,
    airglow_pieces,
    gathered_lines,
    moonlight,
    pieces_of,
    solar_activity,
    twilight,
    twilight_zenith_v_mag,
)
from pipeline.spec.sky.background import Background

SUN_W, SUN_E, *_ = solar_spectrum()
PARANAL = (2635.0, 0.12, 1.3, 260.0)


def test_air_mass_against_published_values():
    """Kasten & Young's ends, and Pickering 2002 (DIO 12, 3) to 0.5% from 10 degrees on."""
    assert air_mass(0.0) == pytest.approx(37.92, abs=0.01)
    assert air_mass(1.0) == pytest.approx(0.9997, abs=1e-4)
    h = np.linspace(10.0, 90.0, 33)
    pickering = 1.0 / np.sin((h + 244.0 / (165.0 + 47.0 * h**1.1)) * DEG_RAD)
    assert air_mass(np.sin(h * DEG_RAD)) == pytest.approx(pickering, rel=5e-3)
    assert air_mass(-0.3) == air_mass(0.0)


def test_coefficients_against_published_ones():
    """Rayleigh at sea level in V as Schaefer 1998 has it; Paranal's mean curve (Patat et al. 2011,
    A&A 527, A91) in B, V, R and I."""
    assert coefficients(550e-9, 0.0, 0.1, 1.3, 300.0)[0] == pytest.approx(0.1066, abs=2e-4)
    assert coefficients(550e-9, 0.0, 0.1, 1.3, 300.0)[2] == pytest.approx(0.031, abs=3e-3)
    for nm, mag, tolerance in ((440, 0.22, 0.02), (550, 0.13, 0.02), (640, 0.09, 0.02),
                               (790, 0.04, 0.015)):  # fmt: skip
        assert sum(coefficients(nm * 1e-9, *PARANAL)) == pytest.approx(mag, abs=tolerance)


@pytest.mark.parametrize("mass", [1.0, 3.0, 10.0])
def test_band_against_direct_integration(mass):
    """Pieces of the band against the spectrum dimmed wavelength by wavelength."""
    response = box(400e-9, 900e-9)
    extinction = band_extinction(SUN_W, SUN_E, response, PARANAL)
    grid = np.union1d(np.linspace(400e-9, 900e-9, 20_001), SUN_W)
    sun = np.interp(grid, SUN_W, SUN_E)
    passed = 10.0 ** (-0.4 * mass * sum(coefficients(grid, *PARANAL)))
    exact = photon_integral(grid, sun * passed, response) / photon_integral(grid, sun, response)
    found = (10.0 ** (-0.4 * mass * extinction.mag)) @ extinction.share
    assert found == pytest.approx(exact, rel=2e-4)


def test_one_coefficient_is_exact_and_the_ground_hides():
    extinction = band_extinction(SUN_W, SUN_E, box(500e-9, 600e-9), 0.17)
    sine = np.array([1.0, 0.5, 1e-9, -1e-9])
    expected = 10.0 ** (-0.4 * 0.17 * air_mass(sine))
    assert extinction.transmission(sine)[:3] == pytest.approx(expected[:3], rel=1e-12)
    assert extinction.transmission(sine)[3] == 0.0
    assert extinction.transmission(sine[:1], 0.0) == pytest.approx(1.0)
    assert extinction.colour_error_mag(0.1) == 0.0


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_lower_is_dimmer(a, b):
    extinction = band_extinction(SUN_W, SUN_E, box(450e-9, 700e-9), PARANAL)
    low, high = extinction.transmission(np.sort([a, b]))
    assert 0.0 < low <= high <= 1.0


def test_airglow_in_the_band(shared_data):
    """Boxes against the model's full spectrum; airglow alone is somewhat fainter than V = 21.8."""
    path = shared_data / "sky_spectra" / "eso_skycalc_airglow_130sfu.dat"
    nm, photons = np.loadtxt(path).T
    edges = np.array(published.EDGES_NM) * 1e-9
    for response, tolerance in ((box(400e-9, 900e-9), 2e-3), (named_filter("bessell-V"), 0.05)):
        found = airglow_pieces(edges, np.array(published.ZENITH), response, 1.0).sum()
        ends = response.wavelength_m[[0, -1]] * 1e9
        values = np.interp(nm * 1e-9, response.wavelength_m, response.value)
        values[(nm < ends[0] - 1e-6) | (nm > ends[1] + 1e-6)] = 0.0
        lit = values > 0.0
        exact = np.trapezoid(photons[lit] * 1e6 * values[lit], nm[lit] * 1e-9) / ARCSEC2_SR
        assert found == pytest.approx(exact, rel=tolerance)
    v = named_filter("bessell-V")
    light = airglow_pieces(edges, np.array(published.ZENITH), v, 1.0).sum() * ARCSEC2_SR
    assert -2.5 * np.log10(light / ab_photon_rate(0.0, v)) == pytest.approx(22.2, abs=0.4)


def test_narrow_bands_of_airglow_are_told_by_how_much_lines_may_gather():
    """Of a box of 8 nm that holds a line, 1.5 nm; a wide band holds all of its boxes."""
    edges, zenith = np.array([500.0, 554.0, 562.0, 600.0]) * 1e-9, np.array([80.0, 625.0, 120.0])
    gathered = [gathered_lines(edges, zenith, box(a * 1e-9, b * 1e-9))
                for a, b in ((557.0, 558.5), (500.0, 600.0), (550.0, 555.0))]  # fmt: skip
    assert gathered == pytest.approx([8 / 1.5, 1.0, (80 * 54 + 625 * 8) / (80 * 4 + 625)], rel=2e-3)


def test_lines_of_airglow_gather_by_no_more_than_is_told(shared_data):
    path = shared_data / "sky_spectra" / "eso_skycalc_airglow_130sfu.dat"
    nm, photons = np.loadtxt(path).T
    edges, zenith = np.array(published.EDGES_NM) * 1e-9, np.array(published.ZENITH)
    for a, b in ((557.0, 558.5), (629.0, 631.0), (588.5, 590.0), (860.0, 870.0), (500.0, 600.0)):
        response = box(a * 1e-9, b * 1e-9)
        fine = np.union1d(nm[(nm > a) & (nm < b)], [a, b])
        exact = np.trapezoid(np.interp(fine, nm, photons), fine) * 1e-3
        found = airglow_pieces(edges, zenith, response, 1.0).sum() * ARCSEC2_SR
        assert exact <= 1.03 * found * gathered_lines(edges, zenith, response)


def test_airglow_brightens_towards_the_horizon():
    """van Rhijn's factor at 60 degrees from the zenith, by hand; dimmed near the horizon."""
    band = gather_night(Background.model_validate({"airglow": True}), box(500e-9, 600e-9))
    sine = np.array([1.0, 0.5, 0.1])
    clear = airglow(band, None, sine) / band.airglow.sum()
    by_hand = 1.0 / np.sqrt(1.0 - (6371.0 / 6461.0 * np.sin(60.0 * DEG_RAD)) ** 2)
    assert clear[:2] == pytest.approx([1.0, by_hand], rel=1e-12)
    extinction = band_extinction(SUN_W, SUN_E, box(500e-9, 600e-9), PARANAL)
    through = airglow(band, extinction, sine) / band.airglow.sum()
    assert through[0] == pytest.approx(1.0, rel=1e-3)
    assert 0.85 < through[1] / clear[1] < 1.0
    assert through[2] < 0.75 * clear[2]


def narrow(k):
    """A band about 550 nm with one coefficient, and its Sun and Moon."""
    response = box(545e-9, 555e-9)
    extinction = band_extinction(SUN_W, SUN_E, response, k)
    sun = pieces_of(SUN_W, SUN_E, response)
    moon = pieces_of(SUN_W, spectrum(SUN_W, SUN_E), response)
    return NightBand(np.zeros(len(sun)), sun, moon), extinction


def test_moonlight_has_no_step():
    """From hundredth to hundredth of a degree it changes little, also where its two laws meet."""
    band, extinction = narrow(0.172)
    apart = np.radians(np.arange(5.5, 15.0, 0.01))
    light = moonlight(band, extinction, np.full(len(apart), 0.9), 0.7, apart, 1e-6)
    change = np.abs(np.diff(light)) / light[:-1]
    assert change.max() < 0.005


@pytest.mark.parametrize(
    ("phase", "apart", "zenith", "moon_zenith"),
    [(0.0, 30.0, 20.0, 40.0), (60.0, 90.0, 60.0, 50.0), (30.0, 5.0, 35.0, 40.0)],
)
def test_moonlight_is_the_published_formula(phase, apart, zenith, moon_zenith):
    """Krisciunas & Schaefer 1991 in nanolamberts and V, their k = 0.172."""
    k = 0.172
    band, extinction = narrow(k)
    mag = -12.73 + 0.026 * phase + 4e-9 * phase**4
    mie = 10 ** (6.15 - apart / 40) if apart >= 8.45 else 6.2e7 / apart**2
    f = 10**5.36 * (1.06 + np.cos(np.radians(apart)) ** 2) + mie
    x, xm = ((1 - 0.96 * np.sin(np.radians(z)) ** 2) ** -0.5 for z in (zenith, moon_zenith))
    bright = f * 10 ** (-0.4 * (mag + 16.57)) * 10 ** (-0.4 * k * xm) * (1 - 10 ** (-0.4 * k * x))
    v = (20.7233 - np.log(bright / 34.08)) / 0.92104
    share = irradiance_share(np.radians(phase), np.array(149_597_870_700.0), np.array(384.4e6))
    found = moonlight(
        band, extinction, np.cos(np.radians([zenith])), float(np.cos(np.radians(moon_zenith))),
        np.radians([apart]), float(share),
    )  # fmt: skip
    sun_v = -26.76 - 2.5 * np.log10(found[0] * ARCSEC2_SR / band.sun.sum())
    assert sun_v == pytest.approx(v, abs=0.02)
    assert moonlight(band, extinction, np.array([1.0]), -0.01, np.array([1.0]), 1e-6)[0] == 0.0


def test_twilight_fades_as_measured():
    """Zenith in V from 5 to 14 degrees of depression: Patat et al. 2006 (A&A 455, 385), quadratic
    fit; and a magnitude a degree."""
    band, extinction = narrow(0.13)
    depression = np.arange(5.0, 15.0)
    seen = [
        twilight(band, extinction, np.ones(1), -np.sin(d * DEG_RAD), np.array([(90 + d) * DEG_RAD]))
        for d in depression
    ]
    v = -26.76 - 2.5 * np.log10(np.concatenate(seen) * ARCSEC2_SR / band.sun.sum())
    x = depression - 5.0
    assert np.abs(v - (11.84 + 1.411 * x - 0.041 * x**2)).max() < 1.6
    assert np.diff(v) == pytest.approx(np.ones(9), abs=0.05)


def test_twilight_is_brightest_above_the_sun():
    band, extinction = narrow(0.2)
    low = np.sin(20.0 * DEG_RAD) * np.ones(2)
    apart = np.array([30.0, 150.0]) * DEG_RAD
    near, far = twilight(band, extinction, low, -np.sin(8.0 * DEG_RAD), apart)
    assert near == pytest.approx(5.0 * far, rel=1e-9)


@pytest.mark.parametrize(("zenith", "k"), [(30.0, 0.13), (60.0, 0.2), (75.0, 0.4)])
def test_twilight_off_the_zenith_is_the_published_formula(zenith, k):
    """Schaefer 1993: 10^(0.4 z / (360 k)) and the extinction's factor, against the zenith's."""
    band, extinction = narrow(k)
    z = np.radians(np.array([zenith, 0.0]))
    apart = np.full(2, 100.0) * DEG_RAD
    off, up = twilight(band, extinction, np.cos(z), -np.sin(9.0 * DEG_RAD), apart)
    mass = 1.0 / (np.cos(z) + 0.025 * np.exp(-11.0 * np.cos(z)))
    scattered = 1.0 - 10.0 ** (-0.4 * k * mass)
    by_hand = 10.0 ** (0.4 * zenith / (360.0 * k)) * scattered[0] / scattered[1]
    assert off / up == pytest.approx(by_hand, rel=1e-6)


def test_twilight_of_a_band_is_that_of_its_halves():
    """Its level is one of V, also where the band does not hold V: electrons of bands add up."""
    low, apart = np.array([0.5]), np.array([1.0])

    def light(short_nm, long_nm):
        response = box(short_nm * 1e-9, long_nm * 1e-9)
        extinction = band_extinction(SUN_W, SUN_E, response, (3055.0, 0.12, 1.3, 300.0))
        sun = pieces_of(SUN_W, SUN_E, response)
        return twilight(NightBand(0.0 * sun, sun, sun), extinction, low, -0.15, apart)[0]

    assert light(500, 900) == pytest.approx(light(500, 700) + light(700, 900), rel=1e-3)


def test_aerosols_dim_blue_more_and_high_sites_less():
    """k (lambda / 0.55 um)^-slope exp(-H / 1.5 km)."""
    aerosol = (sum(coefficients(440e-9, 2000.0, mag, 1.3, 0.0)) for mag in (0.2, 0.0))
    by_hand = 0.2 * (0.44 / 0.55) ** -1.3 * np.exp(-2000.0 / 1500.0)
    assert next(aerosol) - next(aerosol) == pytest.approx(by_hand, rel=1e-9)


def test_aerosols_scatter_and_ozone_absorbs():
    """Of one and not of the other: what the night's lights take for scattering and absorption."""
    for aerosol, ozone in ((0.3, 0.0), (0.0, 300.0)):
        band = band_extinction(SUN_W, SUN_E, box(500e-9, 700e-9), (0.0, aerosol, 1.3, ozone))
        clean = band_extinction(SUN_W, SUN_E, box(500e-9, 700e-9), (0.0, 0.0, 1.3, 0.0))
        assert np.all((band.scattered_mag > clean.scattered_mag) == (aerosol > 0.0))
        assert np.all((band.absorbed_mag > 0.0) == (ozone > 0.0))


def test_ozone_absorbs_nothing_beyond_its_bands():
    """The table ends at 840 nm, on a slope; in the middle of the Chappuis bands 0.04 mag."""
    *_, ozone = coefficients([605e-9, 870e-9, 1.6e-6], 0.0, 0.0, 1.3, 300.0)
    by_hand = 2.5 / np.log(10.0) * 5.019e-25 * 300.0 * 2.6867e20
    assert ozone == pytest.approx([by_hand, 0.0, 0.0])


def test_stars_of_another_colour_are_dimmed_otherwise():
    """Two pieces: the largest difference in magnitude from the Sun's own loss, of two lights."""
    two = np.array([1.0, 1.0])
    light = BandExtinction(two, np.array([0.5, 0.1]), 0.05 * two, 0.5 * two, np.empty((0, 2)), 0.3)
    light = light.with_extremes(np.array([[0.9, 0.1], [0.3, 0.7]]))
    passed = 10.0 ** (-0.4 * np.array([0.55, 0.15]) * float(air_mass(0.5)))
    sun = passed.mean()
    by_hand = max(abs(2.5 * np.log10(e @ passed / sun)) for e in light.extremes)
    assert light.colour_error_mag(0.5) == pytest.approx(by_hand, rel=1e-12)


def test_airglow_is_dimmed_by_the_published_part_of_scattering():
    """Noll et al. 2012, equations 23 and 24: 1.669 log10 X - 0.146 of it, and all absorption."""
    band, extinction = narrow(0.3)
    band = replace(band, airglow=np.ones_like(band.sun))
    extinction = replace(extinction, absorbed_mag=np.full(band.sun.size, 0.2))
    low, high = airglow(band, extinction, np.array([0.3, 1.0]))
    layer = 1.0 / np.sqrt(1.0 - (6371.0 / 6461.0) ** 2 * (1.0 - 0.3**2))
    mass = float(air_mass(0.3))
    mags = 0.3 * ((1.669 * np.log10(layer) - 0.146) * mass + 0.146) + 0.2 * (mass - 1.0)
    assert low / high == pytest.approx(layer * 10.0 ** (-0.4 * mags), rel=2e-4)
    assert solar_activity(200.0, 130.0) == pytest.approx(1.428 / 0.9982)


def test_near_the_horizon_airglow_is_dimmed_by_no_more_than_a_star_is():
    """The published part of scattering passes all of it there, by 15 % at 1 degree; of what the
    layer sends to the zenith, the part there (-0.146) has been added by the air already."""
    band, extinction = narrow(0.3)
    band = replace(band, airglow=np.ones_like(band.sun))
    low = np.sin(np.radians([1.0, 3.0, 6.0, 12.0]))
    stars = 10.0 ** (-0.4 * 0.3 * air_mass(low))
    sent = 10.0 ** (-0.4 * 0.3 * 0.146) * airglow(band, None, low)
    passed = airglow(band, extinction, low) / sent
    assert passed[:3] == pytest.approx(stars[:3], rel=1e-3)
    assert passed[3] > 1.1 * stars[3]


def test_the_aureole_is_held_within_5_degrees():
    band, extinction = narrow(0.172)
    apart = np.radians([1.0, 5.0])
    one, five = moonlight(band, extinction, np.full(2, 0.8), 0.7, apart, 1e-6)
    air = 10**5.36 * (1.06 + np.cos(apart) ** 2) + 6.2e7 / 25.0
    assert one / five == pytest.approx(air[0] / air[1], rel=1e-9)


@pytest.mark.parametrize("degrees", [6.0, 12.0])
def test_magnitudes_of_the_zenith_are_those_of_the_light_there(degrees):
    """What a refusal tells of twilight, by the light that the frames hold."""
    band, extinction = narrow(0.2)
    up, away = np.ones(1), np.radians(degrees)
    seen = twilight(band, extinction, up, -np.sin(away), np.array([0.5 * np.pi + away]))
    found = twilight_zenith_v_mag(-away)
    v = -26.76 - 2.5 * np.log10(seen[0] * ARCSEC2_SR / band.sun.sum())
    assert found == pytest.approx(v, abs=0.02)


def test_what_the_air_absorbs_is_lost_on_the_moons_own_path():
    """Absorption dims the lamp (equation 15) and scatters nothing; of twilight it dims nothing."""
    band, plain = narrow(0.3)
    extinction = replace(plain, absorbed_mag=np.full(band.sun.size, 0.2))
    place = np.array([0.6]), 0.5, np.array([1.2]), 1e-6
    ratio = moonlight(band, extinction, *place) / moonlight(band, plain, *place)
    assert ratio[0] == pytest.approx(10.0 ** (-0.4 * 0.2 * float(air_mass(0.5))), rel=1e-12)
    dusk = [twilight(band, e, np.ones(1), -0.15, np.array([1.7])) for e in (plain, extinction)]
    assert dusk[0] == pytest.approx(dusk[1], rel=1e-12)


@pytest.mark.parametrize("nm", [(400, 450), (900, 1300)])
def test_moonlight_is_redder_than_sunlight(nm):
    """By the disc's reflectance at 45 degrees of phase, straight between its bands, held beyond."""
    response = box(nm[0] * 1e-9, nm[1] * 1e-9)
    grid = np.union1d(np.linspace(nm[0], nm[1], 40_001) * 1e-9, SUN_W)
    sun = np.interp(grid, SUN_W, SUN_E)
    redder = np.interp(grid, np.array(COLOUR_NM) * 1e-9, COLOUR)
    expected = photon_integral(grid, sun * redder, response)
    assert band_rate(SUN_W, SUN_E, response) == pytest.approx(expected, rel=1e-4)
