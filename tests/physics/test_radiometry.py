"""Radiometry against closed forms and quadrature."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from pipeline.physics import radiometry as rm
from pipeline.physics.constants import ARCSEC2_SR, PLANCK_J_S, SPEED_OF_LIGHT_M_S

HC = PLANCK_J_S * SPEED_OF_LIGHT_M_S

heights = st.lists(st.floats(0.0, 1e3), min_size=5, max_size=5)
wavelengths_nm = st.lists(st.integers(300, 2400), min_size=5, max_size=5, unique=True)


def curve(nm: list[int], value: list[float]) -> rm.ResponseCurve:
    return rm.ResponseCurve(np.sort(np.array(nm, float)) * 1e-9, np.array(value))


@given(wavelengths_nm, heights, wavelengths_nm, heights)
def test_against_quadrature_on_every_linear_piece(nm, value, spectrum_nm, flux):
    response = curve(nm, value)
    spectrum = np.sort(np.array(spectrum_nm, float)) * 1e-9
    got = rm.photon_integral(spectrum, np.array(flux), response)
    knots = np.union1d(spectrum, response.wavelength_m)
    node, weight = np.polynomial.legendre.leggauss(4)
    expected = 0.0
    for a, b in itertools.pairwise(knots):
        w = 0.5 * (a + b) + 0.5 * (b - a) * node
        f = np.interp(w, spectrum, flux, left=0.0, right=0.0)
        r = np.interp(w, response.wavelength_m, response.value, left=0.0, right=0.0)
        expected += 0.5 * (b - a) * np.sum(weight * f * r * w) / HC
    assert got == pytest.approx(expected, rel=1e-12, abs=1e-300)


@given(heights, heights, st.floats(0.0, 10.0), st.integers(451, 899))
def test_same_sum_of_spectra_and_of_neighbouring_bands(first, second, factor, split):
    grid = np.array([300.0, 430.0, 610.0, 880.0, 1100.0]) * 1e-9
    a, b = np.array(first), np.array(second)
    band = rm.box(450e-9, 900e-9)
    whole = rm.photon_integral(grid, a, band)
    linear = rm.photon_integral(grid, factor * a + b, band)
    both = factor * whole + rm.photon_integral(grid, b, band)
    assert linear == pytest.approx(both, rel=1e-12, abs=1e-300)
    parts = [rm.box(450e-9, split * 1e-9), rm.box(split * 1e-9, 900e-9)]
    halves = sum(rm.photon_integral(grid, a, part) for part in parts)
    assert halves == pytest.approx(whole, rel=1e-12, abs=1e-300)
    assert rm.photon_integral(grid, a, rm.scale(band, 0.72)) == pytest.approx(0.72 * whole)


def test_against_ab_closed_form_for_a_box():
    # 3631 Jy / h = 5.4798e10 photons/s/m2 per unit of ln(wavelength).
    for short, long in ((400, 900), (550, 551), (300, 2500)):
        rate = rm.ab_photon_rate(0.0, rm.box(short * 1e-9, long * 1e-9))
        assert rate == pytest.approx(5.4798e10 * math.log(long / short), rel=2e-5)
        assert rm.ab_photon_rate(21.5, rm.box(short * 1e-9, long * 1e-9)) == pytest.approx(
            rate * 10 ** (-8.6), rel=1e-14
        )


def test_against_quadrature_ab_rate_of_a_table():
    response = curve([400, 450, 500, 750, 760], [0.0, 0.8, 0.3, 0.9, 0.0])

    def integrand(w: float) -> float:
        return float(np.interp(w, response.wavelength_m, response.value)) / w

    expected = quad(integrand, 400e-9, 760e-9, points=[450e-9, 500e-9, 750e-9], epsabs=0)[0]
    got = rm.ab_photon_rate(0.0, response)
    assert got == pytest.approx(3631e-26 / PLANCK_J_S * expected, rel=1e-12)


def test_limits_ab_rate_of_a_very_narrow_band():
    response = rm.ResponseCurve(np.array([500e-9, 500e-9 * (1 + 1e-9)]), np.array([0.2, 0.4]))
    width = np.diff(response.wavelength_m)[0] / 500e-9
    expected = 3631e-26 / PLANCK_J_S * 0.3 * width
    assert rm.ab_photon_rate(0.0, response) == pytest.approx(expected, rel=1e-6)


def test_against_surface_brightness_by_hand():
    # 13.5 um at 1 m is a pixel of 2.78462 arcsec.
    omega = rm.pixel_solid_angle_sr(13.5e-6, 1.0)
    assert omega / ARCSEC2_SR == pytest.approx((13.5e-6 * 206264.806247) ** 2, rel=1e-9)
    band, area = rm.box(400e-9, 900e-9), rm.collecting_area_m2(0.4, 0.3)
    assert area == pytest.approx(math.pi / 4 * (0.4**2 - 0.12**2), rel=1e-14)
    rate = rm.surface_brightness_electron_rate(21.5, band, area, omega)
    expected = 5.4798e10 * math.log(2.25) * 10 ** (-0.4 * 21.5) * area * omega / ARCSEC2_SR
    assert rate == pytest.approx(expected, rel=2e-5)
    assert rm.pixel_solid_angle_sr(1e-5, 1.0, 0.5) == pytest.approx(
        1e-10 * math.cos(0.5) ** 3, rel=1e-12, abs=0.0
    )


@given(wavelengths_nm, st.lists(st.floats(0.01, 1.0), min_size=5, max_size=5))
def test_same_combined_curve_as_the_product_everywhere(nm, value):
    first = curve(nm, value)
    second = curve([310, 800, 1200, 1900, 2300], [0.0, 1.0, 0.2, 0.9, 0.1])
    if first.wavelength_m[0] >= 2300e-9 or first.wavelength_m[-1] <= 310e-9:
        with pytest.raises(ValueError):
            rm.combine(first, second)
        return
    product = rm.combine(first, second)
    assert np.all(np.diff(product.wavelength_m) > 0)
    w = np.linspace(product.wavelength_m[0], product.wavelength_m[-1], 3001)
    exact = np.interp(w, first.wavelength_m, first.value) * np.interp(
        w, second.wavelength_m, second.value
    )
    got = np.interp(w, product.wavelength_m, product.value)
    assert np.max(np.abs(got - exact)) <= 1.1e-6 * product.value.max()


def test_limits_curves_that_are_no_curves():
    good = np.array([400e-9, 500e-9])
    for wavelength, value in (
        (good[::-1], [1, 1]),
        (good, [1, -1e-9]),
        (good, [1, math.nan]),
        (good, [1, 1, 1]),
        (good[:1], [1]),
        (good * 1e9, [1, 1]),
        ([0.0, 500e-9], [1, 1]),
    ):
        with pytest.raises(ValueError):
            rm.ResponseCurve(np.array(wavelength), np.array(value, float))
    with pytest.raises(ValueError):
        rm.combine(rm.box(400e-9, 500e-9), rm.box(600e-9, 700e-9))
    assert rm.photon_integral(good, np.ones(2), rm.box(600e-9, 700e-9)) == 0.0


@given(st.lists(st.just(0.0) | st.floats(1e-3, 1e3), min_size=6, max_size=6))
def test_same_box_means_after_smoothing(means):
    edges = np.array([300.0, 340.0, 400.0, 420.0, 600.0, 800.0, 1000.0]) * 1e-9
    w, value = rm.spectrum_from_box_means(edges, np.array(means), 1e-9)
    assert np.all(value >= 0.0)
    assert np.all(np.diff(w) > 0)
    for low, high, mean in zip(edges[:-1], edges[1:], means, strict=True):
        got = rm.energy_integral(w, value, rm.box(low, high)) / (high - low)
        assert got == pytest.approx(mean, rel=2e-2, abs=4e-3 * max(means) + 1e-12)
