"""Tabulated pixel responses against closed forms: values, sums, centroids, stated errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erfc

from pipeline.physics.drawing.stamps import draw_stamps
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import (
    Core,
    PixelResponse,
    compact_core,
    core_spectrum,
    oversampling_for,
    phase_table,
    stamp_at,
    taper,
    window,
)


def table(blur: Blur, radius: float, phases: int) -> tuple[Core, PixelResponse]:
    core = compact_core(blur, radius)
    half_y, half_x, period_y, period_x = window(core, 0.0, 0.0)
    spectrum = core_spectrum(core, period_y, period_x)
    return core, phase_table(core, spectrum, (half_y, half_x), (period_y, period_x), phases)


def draw(response: PixelResponse, size: int, x: float, y: float, cubic: bool) -> np.ndarray:
    image = np.zeros((size, size))
    place = (np.array([x]), np.array([y]), np.ones(1), np.array([cubic]))
    draw_stamps(image, (0, 0), response, *place)
    return image


def box(lower: np.ndarray, upper: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian probability between two limits, without cancellation in the tails."""
    a, b = lower / sigma / np.sqrt(2.0), upper / sigma / np.sqrt(2.0)
    return np.where(a > 0, 0.5 * (erfc(a) - erfc(b)), 0.5 * (erfc(-b) - erfc(-a)))


def gaussian_image(size: int, x: float, y: float, sigma: float, side: float = 1.0) -> np.ndarray:
    at, half = np.arange(size), side / 2.0
    column = box(at - x - half, at - x + half, sigma)
    row = box(at - y - half, at - y + half, sigma)
    return row[:, None] * column[None, :]


@pytest.mark.parametrize("sigma", [0.05, 0.1, 0.3, 0.5, 1.0, 2.5])
def test_against_erf_products_exact_stamps(sigma: float) -> None:
    radius = 6.2 * sigma
    core = compact_core(Blur(Gaussian(sigma)), radius)
    half_y, half_x, period_y, period_x = window(core, 0.0, 0.0)
    spectrum = core_spectrum(core, period_y, period_x)
    rng = np.random.default_rng(5)
    for x, y in [(0.0, 0.0), (0.5, -0.5), *rng.uniform(-0.5, 0.5, (6, 2))]:
        place = (y + 40, x + 40)
        row, column, stamp = stamp_at(
            core, spectrum, (half_y, half_x), (period_y, period_x), *place
        )
        whole = gaussian_image(81, x + 40, y + 40, sigma)
        part = whole[row : row + stamp.shape[0], column : column + stamp.shape[1]]
        assert np.abs(stamp - part).max() < 1e-6


@pytest.mark.parametrize(
    ("sigma", "phases"), [(0.3, 128), (0.5, 32), (0.5, 64), (1.0, 32), (2.5, 32)]
)
def test_against_erf_products_tables(sigma: float, phases: int) -> None:
    _, response = table(Blur(Gaussian(sigma)), 6.2 * sigma, phases)
    rng = np.random.default_rng(6)
    for x, y in rng.uniform(24.0, 25.0, (20, 2)):
        exact = gaussian_image(49, x, y, sigma)
        for cubic, bound in ((False, response.linear_error), (True, response.cubic_error)):
            off = np.abs(draw(response, 49, x, y, cubic) - exact).max()
            assert off <= bound + 1e-7 * exact.max()
        assert off < 2e-6


def test_limits_broad_gaussian_of_50_px() -> None:
    core, response = table(Blur(Gaussian(50.0)), 300.0, 8)
    image = draw(response, 625, 312.3, 312.6, True)
    assert np.abs(image - gaussian_image(625, 312.3, 312.6, 50.0)).max() < 1e-6 * image.max()
    assert core.light == pytest.approx(1.0 - np.exp(-18.0), abs=1e-8)


@pytest.mark.parametrize(
    "blur",
    [Blur(Gaussian(0.9)), Blur(Airy(1.0, 0.3)), Blur(Airy(2.0), 0.3, 0.2), Blur(Airy(0.3), 0.9)],
)
def test_same_sum_and_centroid_at_every_phase(blur: Blur) -> None:
    """No half-sample offset: the centroid is the position; the sum is the core's light.

    Holds for responses without power at 1 cycle/px; sharper ones have a sub-pixel S-curve.
    """
    core, response = table(blur, 12.0 if blur.has_wings else 5.6, 64)
    at = np.arange(61)
    rng = np.random.default_rng(8)
    places = [(30.0, 30.0), (30.5, 30.5), (30.25, 30.75), *rng.uniform(30, 31, (12, 2))]
    for x, y in places:
        for cubic in (False, True):
            image = draw(response, 61, x, y, cubic)
            assert image.sum() == pytest.approx(core.light, abs=1e-6)
            assert (image.sum(axis=0) @ at) / image.sum() == pytest.approx(x, abs=1e-3)
            assert (image.sum(axis=1) @ at) / image.sum() == pytest.approx(y, abs=1e-3)


@pytest.mark.parametrize("blur", [Blur(Gaussian(0.05)), Blur(Airy(0.12, 0.3)), Blur(Airy(0.5))])
def test_same_sum_and_mean_centroid_of_sharp_responses(blur: Blur) -> None:
    """The S-curve of an undersampled centroid is odd: over evenly spaced phases its mean is 0."""
    core, response = table(blur, 6.0 if blur.has_wings else 1.0, 64)
    at, off = np.arange(41), []
    for k in range(32):
        x, y = 20.0 + (k + 0.5) / 32, 20.0 + ((7 * k) % 32 + 0.5) / 32
        image = draw(response, 41, x, y, True)
        assert image.sum() == pytest.approx(core.light, abs=1e-6)
        centre = np.array([image.sum(axis=0) @ at, image.sum(axis=1) @ at]) / image.sum()
        off.append(centre - (x, y))
    assert np.abs(np.mean(off, axis=0)).max() < 1e-3


@pytest.mark.parametrize("fill", [1.0, 0.81, 0.5])
def test_fill_factor_loses_the_light_between_pixels(fill: float) -> None:
    blur = Blur(Gaussian(1.5), fill_factor=fill)
    core, response = table(blur, 9.5, 32)
    assert core.light == pytest.approx(fill, abs=2e-8)
    image = draw(response, 41, 20.3, 20.8, True)
    assert np.abs(image - gaussian_image(41, 20.3, 20.8, 1.5, np.sqrt(fill))).max() < 1e-6
    assert image.sum() == pytest.approx(fill, abs=1e-4)  # the gaps are seen at each phase


def test_jitter_and_diffusion_widen_the_drawn_star_in_quadrature() -> None:
    _, response = table(Blur(Gaussian(0.6), 0.8, 1.2), 10.0, 32)
    sigma = np.sqrt(0.6**2 + 0.8**2 + 1.2**2)
    image = draw(response, 41, 20.2, 19.7, True)
    assert np.abs(image - gaussian_image(41, 20.2, 19.7, sigma)).max() < 1e-6


@pytest.mark.parametrize("blur", [Blur(Airy(0.5, 0.3)), Blur(Airy(1.0)), Blur(Airy(2.0, 0.3))])
@pytest.mark.parametrize("phases", [16, 32])
def test_stated_interpolation_errors_hold(blur: Blur, phases: int) -> None:
    core, response = table(blur, 12.0, phases)
    half_y, half_x, period_y, period_x = window(core, 0.0, 0.0)
    spectrum = core_spectrum(core, period_y, period_x)
    worst = {False: 0.0, True: 0.0}
    for x, y in np.random.default_rng(9).uniform(40, 41, (24, 2)):
        row, column, stamp = stamp_at(core, spectrum, (half_y, half_x), (period_y, period_x), y, x)
        for cubic in worst:
            image = draw(response, 81, x, y, cubic)
            part = image[row : row + stamp.shape[0], column : column + stamp.shape[1]]
            worst[cubic] = max(worst[cubic], float(np.abs(part - stamp).max()))
    cut = 1.01e-8 * response.peak  # what SPAN_FLOOR may leave out of a stamp
    assert worst[False] <= response.linear_error + cut
    assert worst[True] <= response.cubic_error + cut
    assert worst[False] > 0.2 * response.linear_error  # a bound that says something


def test_taper_is_a_smooth_step() -> None:
    r = np.linspace(0, 12, 1201)
    t = taper(r, 7.0, 10.0)
    assert (t[r <= 7.0] == 1.0).all()
    assert (t[r >= 10.0] == 0.0).all()
    assert (np.diff(t) <= 0).all()
    assert np.abs(np.diff(t, 2)).max() < 1e-4
    assert taper(np.array([1.0, 1.1]), 1.0, 1.0).tolist() == [1.0, 0.0]


@pytest.mark.parametrize(
    "blur", [Blur(Gaussian(0.05)), Blur(Airy(0.12)), Blur(Airy(4.0)), Blur(Gaussian(50.0))]
)
def test_oversampling_holds_the_band(blur: Blur) -> None:
    os = oversampling_for(blur)
    assert os >= 2
    assert os & (os - 1) == 0
    edge = np.array(os / 2.0)
    assert abs(float(blur.image(edge, np.array(0.0)))) < 1e-8
