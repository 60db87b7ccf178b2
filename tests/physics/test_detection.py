"""Matched filter against its theory: unit noise, the SNR of known light, robust noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.physics.detection import (
    detection_probability,
    filtered,
    peak_near,
    robust_noise,
    snr_of,
)

y, x = np.mgrid[-6:7, -6:7]
RESPONSE = np.exp(-(x**2 + y**2) / (2 * 1.3**2))
RESPONSE /= RESPONSE.sum()


def test_noise_alone_has_unit_variance():
    image = np.random.default_rng(1).normal(100.0, 7.0, (400, 400))
    statistic = filtered(image, RESPONSE)
    assert statistic.shape == (388, 388)
    assert statistic.mean() == pytest.approx(0.0, abs=0.05)
    assert statistic.std() == pytest.approx(1.0, rel=0.05)


def test_against_the_snr_of_known_light():
    """Mean over many noises of the statistic at the source is F sqrt(sum p^2) / sigma."""
    rng, light, found = np.random.default_rng(2), 300.0, []
    for _ in range(200):
        image = rng.normal(50.0, 5.0, (80, 80))
        image[30:43, 20:33] += light * RESPONSE
        found.append(filtered(image, RESPONSE)[30, 20])
    wanted = light * np.sqrt(np.sum(RESPONSE**2)) / 5.0
    assert np.mean(found) == pytest.approx(wanted, abs=4 / np.sqrt(200) + 0.02 * wanted)
    assert np.std(found) == pytest.approx(1.0, rel=0.25)


def test_peak_near_finds_the_offset():
    image = np.random.default_rng(3).normal(0.0, 1.0, (60, 60))
    image[22:35, 24:37] += 400.0 * RESPONSE
    sigma, row, column = peak_near(filtered(image, RESPONSE), 20, 25, 4.0)
    assert (row, column) == (2, -1)
    assert sigma > 20
    assert peak_near(filtered(image, RESPONSE), 20, 25, 1.0)[0] < sigma


@pytest.mark.parametrize("sigma", [0.05, 0.3, 1.0, 30.0])
def test_robust_noise_of_rounded_numbers(sigma):
    """Also where most pixels round to one number; a few bright pixels do not matter."""
    rng = np.random.default_rng(4)
    image = np.rint(rng.normal(200.5, sigma, (300, 300)))
    image[:4] += 5000.0
    _, found = robust_noise(image, 1.0)
    assert found == pytest.approx(np.std(image[4:]), rel=0.03)


@pytest.mark.parametrize("step", [1.5, 4.0, 8.0, 12.0, 20.0])
def test_a_coarse_converter_makes_no_detections(step):
    """Of noise alone, 3.5 e- about 8.14: the median is a whole number, by up to half a step off."""
    rng, peaks, off = np.random.default_rng(3), [], []
    for _ in range(60):
        image = step * np.rint(rng.normal(8.14, 3.5, (80, 80)) / step)
        off.append(robust_noise(image, step)[0] - image.mean())
        peaks.append(peak_near(filtered(image, RESPONSE, step), 33, 33, 4.0)[0])
    assert abs(np.mean(off)) < 0.01
    assert max(peaks) < 5.0
    assert np.mean(peaks) == pytest.approx(1.65, abs=0.3)


def test_limits_nothing_to_see():
    assert np.all(filtered(np.full((40, 40), 7.0), RESPONSE) == 0.0)
    assert np.all(filtered(np.random.default_rng(0).normal(size=(20, 20)), 0 * RESPONSE) == 0.0)


def test_a_lopsided_response_is_not_turned() -> None:
    """A comet's head at one corner of its tail: highest, and of the right height, at its place."""
    response = np.zeros((5, 9))
    response[0, 0], response[1, 1:4], response[3, 5:] = 0.5, 0.1, 0.05
    image = np.random.Generator(np.random.SFC64(2)).normal(50.0, 3.0, (120, 140))
    image[40:45, 60:69] += 900.0 * response
    statistic = filtered(image, response)
    assert np.unravel_index(np.argmax(statistic), statistic.shape) == (40, 60)
    expected = 900.0 * np.sqrt(np.sum(response**2)) / 3.0
    assert statistic[40, 60] == pytest.approx(expected, abs=4.0)


def test_the_cut_tails_are_put_back() -> None:
    """A million pixels of plain noise: to a part in 400, three of its standard errors."""
    image = np.random.Generator(np.random.SFC64(5)).normal(20.0, 4.0, (1000, 1000))
    middle, sigma = robust_noise(image)
    assert middle == pytest.approx(20.0, abs=0.02)
    assert sigma == pytest.approx(4.0, rel=2.5e-3)


@pytest.mark.parametrize(("frames", "needed"), [(1, 1), (5, 1), (5, 3), (5, 5)])
def test_the_snr_of_a_probability(frames: int, needed: int) -> None:
    """By the sum of the binomial's tail, and back."""
    for wanted in (0.01, 0.05, 0.5, 0.99):
        snr = snr_of(wanted, 4.75, frames, needed)
        one = 0.5 * math.erfc((4.75 - snr) / math.sqrt(2.0))
        tail = sum(math.comb(frames, k) * one**k * (1.0 - one) ** (frames - k)
                   for k in range(needed, frames + 1))  # fmt: skip
        assert tail == pytest.approx(wanted, rel=1e-9)
        told = detection_probability(np.array([snr]), 4.75, frames, needed)[0]
        assert told == pytest.approx(wanted, rel=1e-9)
