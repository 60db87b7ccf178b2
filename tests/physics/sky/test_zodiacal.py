"""Zodiacal light: the published table to rounding, colours, distances, and what lies between."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.inputs.band.curves import solar_spectrum
from pipeline.inputs.reference import zodiacal as published
from pipeline.physics.radiometry import box
from pipeline.physics.sky import zodiacal as z

LON, LAT = np.array(published.LONGITUDE_DEG, float), np.array(published.LATITUDE_DEG, float)
RADIANCE = np.array(published.RADIANCE, float)
TABLE = z.zodiacal_table(LON, LAT, RADIANCE)
KNOWN = np.isfinite(RADIANCE)


def radiance_1e8(lon_deg, lat_deg, table=TABLE):
    lon, lat = np.broadcast_arrays(np.radians(lon_deg), np.radians(lat_deg))
    return z.radiance_500(table, lon.ravel(), lat.ravel()).reshape(lon.shape) * 1e8


def test_against_the_table_to_rounding():
    lon, lat = np.meshgrid(LON, LAT, indexing="ij")
    for sign_lon in (1, -1):
        for sign_lat in (1, -1):
            got = radiance_1e8(sign_lon * lon, sign_lat * lat)
            np.testing.assert_allclose(got[KNOWN], RADIANCE[KNOWN], rtol=1e-13)
    np.testing.assert_allclose(radiance_1e8(lon + 360.0, lat)[KNOWN], RADIANCE[KNOWN], rtol=1e-11)
    assert radiance_1e8(180.0, 0.0) == pytest.approx(230.0)  # the gegenschein
    assert radiance_1e8(np.array([7.0, 123.0]), 90.0) == pytest.approx(77.0)


def test_against_copies_of_the_table(shared_data):
    """Table 17 as another simulator has it, and table 16 in S10 (1 S10 = 1.28e-8)."""
    folder = shared_data / "zodiacal_light"
    other = np.loadtxt(folder / "Leinert98_table17_exosims.txt")
    np.testing.assert_array_equal(np.isnan(RADIANCE), other == 1e6)
    np.testing.assert_array_equal(RADIANCE[KNOWN], other[other != 1e6])
    s10 = np.loadtxt(folder / "Leinert98_table16_dorado.txt", skiprows=3)[:, 1:]
    both = KNOWN[:, :10] & np.isfinite(s10)
    ratio = RADIANCE[:, :10][both] / s10[both]
    assert both.sum() > 180
    assert np.all((ratio > 1.26) & (ratio < 1.30))


@given(st.floats(-180.0, 180.0), st.floats(-90.0, 90.0))
def test_between_its_neighbours(lon_deg, lat_deg):
    """Positive, symmetric, and near the range of the cell's corners where all are known."""
    got = float(radiance_1e8(lon_deg, lat_deg))
    assert got == pytest.approx(float(radiance_1e8(-lon_deg, -lat_deg)), rel=1e-12)
    assert np.isfinite(got)
    assert got > 60.0
    i = min(np.searchsorted(LON, abs(lon_deg), "right") - 1, LON.size - 2)
    j = min(np.searchsorted(LAT, abs(lat_deg), "right") - 1, LAT.size - 2)
    corners = RADIANCE[i : i + 2, j : j + 2]
    if np.isfinite(corners).all():
        assert 0.97 * corners.min() <= got <= 1.03 * corners.max()


def test_interpolation_error_by_leaving_half_of_the_table_out():
    """Twice the step errs by 9% at most where 15 degrees from the Sun are kept, 2% in the mean."""
    some = [0, 2, 4, 6, 7, 8, 9, 10]
    for table in (
        z.zodiacal_table(LON[::2], LAT, RADIANCE[::2]),
        z.zodiacal_table(LON, LAT[some], RADIANCE[:, some]),
    ):
        part = np.s_[5:, :]
        got = radiance_1e8(*np.meshgrid(LON, LAT, indexing="ij"), table)
        off = np.abs(got[part] / RADIANCE[part] - 1.0)
        assert off.max() < 0.09
        assert off.mean() < 0.02


def test_near_the_sun_it_rises_smoothly():
    e = np.arange(2.0, 40.0, 0.1)
    for angle in np.radians([0.0, 20.0, 45.0, 70.0, 90.0]):
        # places at an elongation e and a position angle around the Sun
        lat = np.degrees(np.arcsin(np.sin(np.radians(e)) * np.sin(angle)))
        lon = np.degrees(np.arctan2(np.sin(np.radians(e)) * np.cos(angle), np.cos(np.radians(e))))
        found = radiance_1e8(lon, lat)
        assert np.all(np.diff(found) < 0)
        slope = np.diff(np.log(found)) / np.diff(np.log(e))
        assert np.all((slope > -3.5) & (slope < -1.0))
        np.testing.assert_allclose(slope[e[1:] < 14.0], -z.FALL, atol=0.02)
    assert 1e5 < radiance_1e8(4.0, 0.0) < 1e6  # of the order of 1e-3 W m-2 sr-1 um-1


def test_against_table_19_spectrum(shared_data):
    """Brightness at 90 degrees in the ecliptic, 0.4 to 2.2 um, with the Sun's own spectrum."""
    with (shared_data / "zodiacal_light" / "Leinert98_table19_spectrum.csv").open() as file:
        rows = [r for r in csv.reader(file) if not r[0].startswith(("#", "wavelength"))]
    table = {float(um): float(b) for um, b in rows}
    wavelength, sun, _, _ = solar_spectrum()
    for um in (0.5, 0.7, 0.9, 1.0, 1.2, 2.2):
        narrow = box((um - 0.02) * 1e-6, (um + 0.02) * 1e-6)
        _, far = z.band_rates(wavelength, sun, narrow)
        per_photon = 6.62607015e-34 * 299792458.0 / (um * 1e-6)
        got = far * 259e-8 * per_photon / 0.04  # W m-2 sr-1 um-1
        assert got == pytest.approx(table[um], rel=0.12), um


def test_against_v_magnitude_of_the_pole():
    """60 S10 at the ecliptic pole are 23.3 mag per square arcsecond in V."""
    wavelength, sun, _, _ = solar_spectrum()
    _, far = z.band_rates(wavelength, sun, box(505e-9, 595e-9))
    rate = far * 77e-8 * (np.pi / 648000.0) ** 2
    vega = 3.44e-8 * 0.09 * 550e-9 / (6.62607015e-34 * 299792458.0)  # W/m2/um x um: photons
    assert -2.5 * np.log10(rate / vega) == pytest.approx(23.3, abs=0.1)


def test_colour_of_equation_22():
    um = np.array([300e-9, 500e-9, 1000e-9])
    for far, blue, red in ((True, 0.9, 0.6), (False, 1.2, 0.8)):
        expected = [1 + blue * np.log10(0.6), 1.0, 1 + red * np.log10(2)]
        np.testing.assert_allclose(z.colour(um, far=far), expected)
    e = np.radians([0.0, 30.0, 60.0, 90.0, 180.0])
    got = z.band_radiance(np.ones(5), e, (1.0, 2.0))
    np.testing.assert_allclose(got, [1.0, 1.0, 1.5, 2.0, 2.0])


def test_against_astropy_ecliptic():
    from astropy import units as u
    from astropy.coordinates import BarycentricMeanEcliptic, SkyCoord

    rng = np.random.default_rng(3)
    v = rng.normal(size=(50, 3))
    v /= np.sqrt(np.sum(v**2, axis=1))[:, None]
    sun = np.array([0.3, -0.9, -0.39])
    lon, lat, elongation = z.sun_coordinates(v, sun)

    def ecliptic(w):
        at = SkyCoord(*w.T, representation_type="cartesian", frame="icrs")
        at = at.transform_to(BarycentricMeanEcliptic(equinox="J2000"))
        return at.lon.to_value(u.rad), at.lat.to_value(u.rad)

    ref_lon, ref_lat = ecliptic(v)
    sun_lon, sun_lat = ecliptic(sun[None])
    turn = np.angle(np.exp(1j * (lon - (ref_lon - sun_lon))))
    assert np.abs(turn * np.cos(lat)).max() < 1e-6  # frame bias: 0.02 arcsec
    assert np.abs(lat - ref_lat).max() < 1e-6
    cosine = v @ sun / np.sqrt(sun @ sun)
    np.testing.assert_allclose(np.cos(elongation), cosine, atol=1e-12)
    assert abs(sun_lat[0]) < 0.1


def test_distance_law():
    np.testing.assert_allclose(z.distance_factor(np.array([0.5, 1.0, 2.0])), [2**2.3, 1.0, 2**-2.3])
