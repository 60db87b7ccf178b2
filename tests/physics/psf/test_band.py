"""A few wavelengths against very many; quadrature rules against polynomials; error estimates."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from astropy import units as u
from astropy.modeling.models import BlackBody
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics.psf.aperture import Pupil, SpiderVanes
from pipeline.physics.psf.band import (
    COLOURS_K,
    Chromatic,
    Mixture,
    NoiseLimit,
    _Field,
    _first,
    band_wavelengths,
    choose_wavelengths,
)
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.seeing import Kolmogorov
from tests.slow import slow

BOX = (np.array([400e-9, 900e-9]), np.ones(2))
TRIANGLE = (np.array([400e-9, 500e-9, 900e-9]), np.array([0.0, 1.0, 0.2]))
MEAN = 650e-9


@lru_cache(2)
def transfer_of(blur: Blur, period: float, n: int) -> np.ndarray:
    fy, fx = np.fft.fftfreq(n, period / n)[:, None], np.fft.rfftfreq(n, period / n)[None, :]
    return np.asarray(blur.transfer(fy, fx))


def response_difference(one: Blur, other: Blur) -> float:
    """Largest difference of two responses anywhere within some widths, over the light: by sums of
    waves over all frequencies, at places a sixth of a pixel or of their finest wave apart."""
    period = 24.0 * max(1.0, one.optics.scale_px, other.optics.scale_px) + 12.0
    finer = 6.0 * max(1.0, one.band_limit(1e-3), other.band_limit(1e-3))
    n = round(finer * period)
    transfer = transfer_of(one, period, n) - transfer_of(other, period, n)
    return float((n / period) ** 2 * np.abs(np.fft.irfft2(transfer, s=(n, n))).max())


def mixture(make, band, count: int) -> Mixture:  # type: ignore[no-untyped-def]
    nodes, weights = band_wavelengths(*band, count)
    return Mixture(tuple(make(w) for w in nodes), tuple(float(w) for w in weights))


@given(st.integers(0, 14), st.integers(0, 20))
def test_limits_the_first_that_holds_is_found_with_few_looks(last, first):
    looked = []

    def holds(i):
        looked.append(i)
        return i >= first

    assert _first(holds, last) == min(first, last)
    assert len(looked) <= 7


def hundred(make, band) -> Mixture:  # type: ignore[no-untyped-def]
    """The sum over 100 wavelengths in equal steps, by the midpoint rule."""
    edges = np.linspace(band[0][0], band[0][-1], 101)
    at = 0.5 * (edges[1:] + edges[:-1])
    weights = np.interp(at, *band)
    return Mixture(tuple(make(w) for w in at), tuple(weights / weights.sum()))


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 12])
def test_against_legendre_for_a_box(count: int) -> None:
    nodes, weights = band_wavelengths(*BOX, count)
    x, w = np.polynomial.legendre.leggauss(count)
    assert nodes == pytest.approx(650e-9 + 250e-9 * x, rel=1e-12)
    assert weights == pytest.approx(0.5 * w, rel=1e-10)


@settings(max_examples=30)
@given(st.lists(st.floats(0.0, 1.0), min_size=3, max_size=9), st.integers(1, 6))
def test_quadrature_is_exact_for_polynomials(values: list[float], count: int) -> None:
    response = np.array(values)
    response[1] += 0.1
    wavelength = np.linspace(0.4e-6, 0.9e-6, response.size)
    nodes, weights = band_wavelengths(wavelength, response, count)
    fine = np.linspace(0.4e-6, 0.9e-6, 40_001)
    mass = np.interp(fine, wavelength, response)
    for degree in range(2 * count):
        power = ((fine - MEAN) / 0.25e-6) ** degree
        exact = np.trapezoid(power * mass, fine) / np.trapezoid(mass, fine)
        assert weights @ ((nodes - MEAN) / 0.25e-6) ** degree == pytest.approx(exact, abs=1e-6)
    assert (weights > 0).all()
    assert weights.sum() == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("band", [BOX, TRIANGLE])
@pytest.mark.parametrize("q", [1.0, 8.0, *(slow(q) for q in (0.1, 0.5, 4.0))])
def test_against_a_hundred_wavelengths(q: float, band: tuple[np.ndarray, np.ndarray]) -> None:
    def make(wavelength_m: float) -> Airy:
        return Airy(q * wavelength_m / MEAN, 0.3)

    whole = Blur(hundred(make, band))
    mean = response_difference(Blur(make(float(band_wavelengths(*band, 1)[0][0]))), whole)
    for tolerance in (3e-3, 1e-3, 1e-4):
        chosen = choose_wavelengths(make, Blur(Gaussian(1.0)), *band, tolerance)
        exact = response_difference(Blur(chosen.optics), whole)
        assert exact <= 1.03 * tolerance + 1e-5
        assert chosen.error == pytest.approx(exact, rel=3e-2, abs=1e-5)
        assert chosen.error_of_one == pytest.approx(mean, rel=3e-2)
    assert chosen.error_of_one > 1e-3  # one wavelength is not enough in so wide a band


def test_a_narrow_band_needs_one_wavelength() -> None:
    band = (np.array([648e-9, 652e-9]), np.ones(2))
    chosen = choose_wavelengths(lambda w: Airy(w / MEAN), Blur(Airy(1.0)), *band, 1e-3)
    assert isinstance(chosen.optics, Airy)
    assert chosen.wavelengths_m == pytest.approx((650e-9,))
    forced = choose_wavelengths(lambda w: Airy(w / MEAN), Blur(Airy(1.0)), *band, 1e-3, 3)
    assert len(forced.wavelengths_m) == 3
    assert forced.error <= chosen.error_of_one


def test_how_far_the_responses_of_cool_and_hot_stars_are() -> None:
    """Beside astropy's black bodies in 100 wavelengths; they move the peak by several percent."""

    def make(wavelength_m: float) -> Airy:
        return Airy(2.0 * wavelength_m / MEAN)

    chosen = choose_wavelengths(make, Blur(Gaussian(1.0)), *BOX, 1e-3)
    fine = np.linspace(400e-9, 900e-9, 501)
    for kelvin, told in zip(COLOURS_K, chosen.error_of_colours, strict=True):
        light = BlackBody(kelvin * u.K)(fine * u.m).to_value("erg/(s cm2 Hz sr)")
        photons = light / fine  # per wavelength: B_nu c / l^2 over h c / l
        star = Blur(hundred(make, (fine, photons)))
        assert told == pytest.approx(response_difference(star, Blur(hundred(make, BOX))), rel=0.03)


def test_vanes_and_wavefronts_of_a_band_against_a_hundred_wavelengths() -> None:
    def make(wavelength_m: float) -> Chromatic:
        return Pupil(0.8 * wavelength_m / MEAN, 0.3, SpiderVanes(4, 0.03, 0.2))

    chosen = choose_wavelengths(make, Blur(Airy(1.0)), *BOX, 5e-4)
    assert isinstance(chosen.optics, Mixture)
    exact = response_difference(Blur(chosen.optics), Blur(hundred(make, BOX)))
    assert exact < 1.2e-3
    f = np.random.default_rng(1).uniform(-1.5, 1.5, (300, 2))
    parts = zip(chosen.optics.parts, chosen.optics.weights, strict=True)
    total = sum(w * p.transfer(f[:, 0], f[:, 1]) for p, w in parts)
    assert np.abs(chosen.optics.transfer(f[:, 0], f[:, 1]) - total).max() < 2e-6


def test_the_error_of_wavelengths_is_that_of_the_round_parts() -> None:
    """Vanes and a wavefront change nothing of it: as many wavelengths as of the annulus alone."""

    def make(wavelength_m: float) -> Pupil:
        q = 0.8 * wavelength_m / MEAN
        return Pupil(q, 0.3, SpiderVanes(3, 0.1, 0.2), ((5, 0.4 * MEAN / wavelength_m),))

    of_pupil, of_annulus = (
        choose_wavelengths(of, Blur(Airy(1.0)), *BOX, 5e-4)
        for of in (make, lambda w: make(w).annulus)
    )
    assert 1 < len(of_pupil.weights) == len(of_annulus.weights)
    assert of_pupil.error == pytest.approx(of_annulus.error, rel=1e-12)


def test_seeing_of_a_band() -> None:
    def make(wavelength_m: float) -> Chromatic:
        q = 0.5 * wavelength_m / MEAN
        return Kolmogorov(3.0 * (wavelength_m / MEAN) ** -0.2, Airy(q, 0.3))

    chosen = choose_wavelengths(make, Blur(Airy(1.0)), *BOX, 1e-4)
    assert response_difference(Blur(chosen.optics), Blur(hundred(make, BOX))) < 1.1e-4
    assert len(chosen.wavelengths_m) <= 4


def test_a_mixture_keeps_the_light_and_its_rules() -> None:
    m = mixture(lambda w: Airy(w / MEAN, 0.3), BOX, 5)
    zero = np.zeros(1)
    assert m.transfer(zero, zero)[0] == pytest.approx(1.0, abs=1e-12)
    shortest = min(p.q_px for p in m.parts)  # type: ignore[union-attr]
    assert m.band_limit(1e-9) == pytest.approx(1.0 / shortest)
    beyond = sum(w * p.light_beyond(50.0) for p, w in zip(m.parts, m.weights, strict=True))
    assert m.light_beyond(50.0) == pytest.approx(beyond)
    assert m.has_wings
    assert hash(m) == hash(mixture(lambda w: Airy(w / MEAN, 0.3), BOX, 5))


def test_difference_of_two_gaussians_against_closed_form() -> None:
    """Two responses of the same centre differ most at it: products of error functions."""
    from scipy.special import erf

    one, other = Blur(Gaussian(1.0)), Blur(Gaussian(1.1))
    peaks = [erf(0.5 / (s * np.sqrt(2.0))) ** 2 for s in (1.0, 1.1)]
    assert response_difference(one, other) == pytest.approx(peaks[0] - peaks[1], rel=1e-3)
    assert response_difference(one, one) == 0.0


def test_a_field_is_as_wide_as_what_charge_diffusion_makes_of_a_narrow_response() -> None:
    """The difference of two wide Gaussians by hand, s^2 = optics^2 + diffusion^2: at their middle
    the most, and none of it from what comes round again beyond the edge."""
    from scipy.special import erf

    field = _Field(Blur(Gaussian(0.5), 0.0, 10.0), 10.0)
    found = field.difference(Blur(Gaussian(1.5), 0.0, 10.0))
    peaks = [erf(0.5 / np.sqrt(2.0 * (s**2 + 100.0))) ** 2 for s in (0.5, 1.5)]
    assert np.abs(found).max() == pytest.approx(peaks[0] - peaks[1], rel=0.02)


def test_errors_beside_the_brightest_source_are_over_the_noise_there() -> None:
    """Photons of floor and source, or the floor's alone where the source has none."""
    off, light = np.array([1e-6, -3e-6, 2e-6]), np.array([0.1, 4e-5, -1e-9])
    by_hand = 1e8 * np.array([1e-6, 3e-6, 2e-6])
    noise = np.sqrt(20.0**2 + 1e8 * np.array([0.1, 4e-5, 0.0]))
    assert NoiseLimit(1e8, 20.0, 0.05).error_sigma(off, light) == pytest.approx(
        (by_hand / noise).max(), rel=1e-12
    )
    floor = NoiseLimit(1e8, 20.0, 0.05, photons=False)
    assert floor.error_sigma(off, light) == pytest.approx(15.0, rel=1e-12)
