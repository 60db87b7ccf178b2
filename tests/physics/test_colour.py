"""The colour polynomial: A0V at zero, absent colours, clamping, the degree."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.physics import colour


def made_fit(**changes) -> colour.ColourFit:
    values = {
        "band_name": "test",
        "coefficients": np.array([0.0, -0.5, 0.1, 0.02]),
        "colour_range": (-0.6, 3.4),
        "residual_rms_mag": 0.0,
        "residual_max_mag": 0.0,
        "redder_error_mag": 0.0,
        "default_colour": 1.44,
        "default_colour_scatter": 0.5,
        "default_error_mag": 0.2,
        "zero_electrons_s_m2": 2.5e10,
        "source": "made up",
        "spectra_count": 3,
    }
    return colour.ColourFit(**(values | changes))


def test_limits_a0v_has_no_correction():
    rate, flag = colour.star_electron_rate(np.zeros(1), np.zeros(1), np.zeros(1), made_fit())
    assert rate[0] == 2.5e10
    assert flag[0] == 0


def test_against_the_formula_star_by_star():
    rng = np.random.default_rng(3)
    g = rng.uniform(3, 21, 1000)
    x = rng.uniform(-0.6, 3.4, 1000)
    rate, flag = colour.star_electron_rate(g, g + 0.6 * x, g - 0.4 * x, made_fit())
    correction = -0.5 * x + 0.1 * x**2 + 0.02 * x**3
    np.testing.assert_allclose(rate, 2.5e10 * 10 ** (-0.4 * (g + correction)), rtol=1e-13)
    assert not flag.any()
    np.testing.assert_allclose(colour.colour_correction_mag(x, made_fit()), correction, atol=1e-12)


def test_limits_absent_and_clamped_colours_are_flagged():
    nan = np.nan
    bp = np.array([nan, 15.0, nan, 20.0, 10.0, 15.7])
    rp = np.array([15.0, nan, nan, 15.0, 11.0, 15.0])
    fit = made_fit()
    rate, flag = colour.star_electron_rate(np.full(6, 15.0), bp, rp, fit)
    assert flag.dtype == np.uint8
    assert flag.tolist() == [1, 1, 1, 2, 2, 0]
    as_if = np.array([1.44, 1.44, 1.44, 3.4, -0.6, 0.7])
    expected = 2.5e10 * 10 ** (-0.4 * (15.0 + colour.colour_correction_mag(as_if, fit)))
    np.testing.assert_allclose(rate, expected, rtol=1e-13)


def test_limits_no_stars_and_a_bad_magnitude():
    empty = np.empty(0)
    rate, flag = colour.star_electron_rate(empty, empty, empty, made_fit())
    assert rate.size == flag.size == 0
    for bad in (np.nan, np.inf):
        with pytest.raises(BadInput, match="phot_g_mean_mag"):
            colour.star_electron_rate(np.array([bad]), np.ones(1), np.ones(1), made_fit())
    with pytest.raises(BadInput):
        colour.star_electron_rate(np.ones(2), np.ones(1), np.ones(2), made_fit())


def test_against_a_known_polynomial():
    x = np.linspace(-0.6, 3.0, 60)
    y = 0.4 * x - 0.2 * x**2 + 0.03 * x**3
    c = colour.fit_colour(x, y, 3)
    np.testing.assert_allclose(c, [0, 0.4, -0.2, 0.03], atol=1e-12)
    assert c[0] == 0.0
    noisy = y + np.random.default_rng(1).normal(0, 0.01, x.size)
    assert colour.choose_degree(x, noisy) == 3


def test_against_leaving_each_point_out():
    rng = np.random.default_rng(5)
    x = np.sort(rng.uniform(-0.5, 3.0, 25))
    y = 0.3 * x**2 + rng.normal(0, 0.05, 25)
    left_out = []
    for i in range(25):
        c = colour.fit_colour(np.delete(x, i), np.delete(y, i), 3)
        left_out.append(y[i] - np.polynomial.polynomial.polyval(x[i], c))
    expected = np.sqrt(np.mean(np.square(left_out)))
    assert colour.cross_validated_rms_mag(x, y, 3) == pytest.approx(expected, rel=1e-10)


def test_brightest_star_by_area_and_time():
    """Of the colour that gives most: here the bluest, 0.3624 mag brighter than A0V."""
    fit = made_fit(coefficients=np.array([0.0, 0.6, 0.01]), colour_range=(-0.6, 3.4))
    by_hand = 2.5e10 * 0.3 * 7.0 * 10 ** (0.4 * (0.36 - 0.0036))
    assert colour.brightest_electrons(fit, 0.3, 7.0) == pytest.approx(by_hand, rel=1e-9)


@pytest.mark.parametrize(("cubic", "degree"), [(0.001, 2), (0.005, 3)])
def test_a_degree_more_is_taken_where_it_gains_three_percent(cubic, degree):
    x = np.linspace(-0.6, 3.4, 400)
    y = 0.4 * x - 0.2 * x**2 + cubic * x**3 + np.random.default_rng(2).normal(0, 0.01, 400)
    rms = [colour.cross_validated_rms_mag(x, y, d) for d in (2, 3, 4, 5)]
    assert (rms[0] / min(rms) > 1.03) == (degree == 3)
    assert rms[0] / min(rms) < 1.25
    assert colour.choose_degree(x, y) == degree
