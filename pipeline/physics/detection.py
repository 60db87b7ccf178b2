"""Detection by a matched filter: how far a known response stands out of a noisy image."""

from __future__ import annotations

import math

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SIGMA_OF_MAD = 1.4826022185056018  # of a Gaussian's standard deviation, per median deviation
CLIP = 3.0
CLIPPED = 0.9865783925  # standard deviation of a unit Gaussian cut off at 3


def robust_noise(image_e: Array, step_e: float = 0.0) -> tuple[float, float]:
    """Mean [e-] and standard deviation [e-] of an image's pixels, bright sources omitted.

    Both are those of the pixels within CLIP sigma of the median, the deviation made whole again for
    the Gaussian tails omitted; sigma at first is the median deviation, or the digitiser's `step_e`
    where that hides it. A mean, as the median of whole numbers is one of them. At least the step's
    own rounding counts as noise, step / sqrt(12). Sources that cover a small share of the pixels do
    not matter.
    """
    away = np.abs(image_e - np.median(image_e))
    first = max(SIGMA_OF_MAD * float(np.median(away)), step_e)
    near = image_e[away <= CLIP * first]
    if not near.size:
        return 0.0, 0.0
    return float(near.mean()), max(float(near.std()) / CLIPPED, step_e / math.sqrt(12.0))


def filtered(image_e: Array, response: Array, step_e: float = 0.0) -> Array:
    """Matched-filter statistic of a response at every place that it fits in, in sigma.

    image_e : (ny, nx) electrons; response : (my, mx), the share of a source's light in each pixel.
    Pixel (i, j) of the result, (ny - my + 1, nx - mx + 1), is for the response's corner there. For
    white Gaussian noise it has mean 0 and variance 1, and a source of light F raises it by
    F sqrt(sum(response^2)) / sigma (Turin 1960). Background and noise are the image's own
    (`robust_noise`); without noise it is 0.
    """
    middle, sigma = robust_noise(image_e, step_e)
    norm = float(np.sqrt(np.sum(response**2)))
    shape = tuple(n - m + 1 for n, m in zip(image_e.shape, response.shape, strict=True))
    if sigma <= 0.0 or norm <= 0.0:
        return np.zeros(shape)
    out = scipy.signal.fftconvolve(image_e - middle, response[::-1, ::-1], mode="valid")
    return np.asarray(out) / (sigma * norm)


def peak_near(statistic: Array, row: int, column: int, within_px: float) -> tuple[float, int, int]:
    """Highest statistic within a distance of a place: (sigma, row offset, column offset)."""
    rows, columns = np.indices(statistic.shape)
    far = np.hypot(rows - row, columns - column) > within_px
    at = int(np.argmax(np.where(far, -np.inf, statistic)))
    y, x = np.unravel_index(at, statistic.shape)
    return float(statistic[y, x]), int(y) - row, int(x) - column


def threshold_sigma(false_alarm_rate: float) -> float:
    """Threshold [sigma] that Gaussian noise passes at a rate: Q^-1(rate) (Kay 1998, 3.3)."""
    return float(-scipy.special.ndtri(false_alarm_rate))


def detection_probability(
    snr: Array, threshold: float, frames: ArrayLike = 1, needed: int = 1
) -> Array:
    """Probability (...) that `needed` or more of `frames` alike show a source of SNR (...).

    Each by Q(threshold - snr): the matched filter's statistic is Gaussian of variance 1 and mean
    snr (Kay 1998, eq. 3.9); frames are independent. 0 of fewer frames than are needed.
    """
    one, tries = scipy.special.ndtr(np.asarray(snr, float) - threshold), np.asarray(frames)
    enough = tries >= needed
    return np.where(
        enough, scipy.special.bdtrc(needed - 1, np.where(enough, tries, needed), one), 0.0
    )


def snr_of(probability: float, threshold: float, frames: int = 1, needed: int = 1) -> float:
    """The SNR of a frame at which `detection_probability` is a probability in (0, 1)."""
    one = scipy.special.bdtri(needed - 1, frames, 1.0 - probability)
    return threshold + float(scipy.special.ndtri(one))
