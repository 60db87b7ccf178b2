"""Streaks, found by matched filters: lines of a known drift, or blindly of all directions."""

from __future__ import annotations

import math

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import grey_opening, maximum_filter
from scipy.spatial import cKDTree

from pipeline.studies.detection.points import Detections

Array = NDArray[np.float64]
Line = tuple[float, float]  # length [px], angle [rad] from +x towards +y

LENGTHS_PX = (0.0, 8.0, 16.0, 32.0, 64.0)
WIDTH_PX = 1.2  # rms across a line
BRIGHTEST_SIGMA = 30.0  # a pixel counts at most so much: one bright star is no streak
PEAK_PX = 3  # half side of the square in which a detection is the largest
MOST = 200_000
EVEN, BRIGHT_SIGMA, PLACES = 0.4, 5.0, 21
SAMPLE = 100_003  # pixels that tell the scatter of a filtered image
OPENING_PX = 11  # what is shorter than that along the drift is no star's streak


def all_lines() -> list[Line]:
    """Lines of LENGTHS_PX in directions so fine that an end is WIDTH_PX from the nearest one."""
    out: list[Line] = []
    for length in LENGTHS_PX:
        count = max(4, math.ceil(math.pi * length / (4.0 * WIDTH_PX))) if length else 1
        out += [(length, k * math.pi / count) for k in range(count)]
    return out


def find_lines(image: Array, noise: float, threshold_sigma: float, lines: list[Line]) -> Detections:
    """Lines above a threshold of signal-to-noise, those that one another explain counted once.

    image, noise : from `points.flattened`. Each pixel, in units of the noise, is filtered by each
    line with a width of WIDTH_PX; where the best filter peaks and is no point (length 0), a streak
    is reported with its length and angle. The unit of signal-to-noise is the scatter of the
    filtered image where that is more than the noise: crowds count as noise. Lines that single
    points make are omitted, and neighbours along the same line are left to the brighter one. The
    frame is taken as periodic.
    """
    scaled = np.minimum(image / noise, BRIGHTEST_SIGMA).astype(np.float32)
    best, which = _best(scaled, lines)
    length, angle = (np.array([line[i] for line in lines])[which] for i in (0, 1))
    peak = (best == maximum_filter(best, size=2 * PEAK_PX + 1)) & (best >= threshold_sigma)
    y, x = np.nonzero(peak & (length > 0))
    order = np.argsort(-best[y, x], kind="stable")[:MOST]
    y, x = y[order], x[order]
    even = _even(_best(scaled, [(0.0, 0.0)])[0], x, y, length[y, x], angle[y, x])
    y, x = y[even], x[even]
    kept = _own_peaks(x.astype(float), y.astype(float), length[y, x], angle[y, x])
    y, x = y[kept], x[kept]
    return Detections(
        x.astype(float), y.astype(float), best[y, x].astype(float), length[y, x], angle[y, x]
    )


def without_streaks(image: Array, drift: Line) -> Array:
    """The image less all that is longer along the drift than OPENING_PX: a grey top-hat.

    Points stay, and streaks in other directions; the noise keeps a bias of some of its sigmas,
    which is taken off by the median.
    """
    half = 0.5 * (min(OPENING_PX, max(3, int(drift[0]) // 2)) - 1)
    steps = np.linspace(-half, half, 4 * OPENING_PX)
    rows, columns = (np.round(steps * f(drift[1])).astype(int) for f in (math.sin, math.cos))
    size = math.ceil(half)
    footprint = np.zeros((2 * size + 1, 2 * size + 1), bool)
    footprint[rows + size, columns + size] = True
    left = image - grey_opening(image, footprint=footprint)
    return np.asarray(left - np.median(left))


def _best(
    scaled: NDArray[np.float32], lines: list[Line]
) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """Largest filtered signal-to-noise of each pixel, and the number of its line."""
    shape = scaled.shape
    spectrum = scipy.fft.rfft2(scaled)
    fy = scipy.fft.fftfreq(shape[0])[:, None].astype(np.float32)
    fx = scipy.fft.rfftfreq(shape[1])[None, :].astype(np.float32)
    across = np.exp(-2.0 * (np.pi * WIDTH_PX) ** 2 * (fx * fx + fy * fy))
    best, which = np.full(shape, -np.inf, np.float32), np.zeros(shape, np.int16)
    # Large arrays that come and go cost more than what is done in them: these stay.
    line, spare = np.empty_like(across), np.empty_like(across)
    product = np.empty_like(spectrum)
    for number, (length, angle) in enumerate(lines):
        x, y = fx * np.float32(length * math.cos(angle)), fy * np.float32(length * math.sin(angle))
        _sinc(np.add(x, y, out=line), spare)
        line *= across
        # The noise of the filtered image, by Parseval: both halves of the spectrum.
        power = -float(np.sum(line[:, 0] ** 2))
        np.multiply(spectrum, line, out=product)
        power += 2.0 * float(np.sum(np.square(line, out=line)))
        filtered = scipy.fft.irfft2(product, s=shape, overwrite_x=True)
        filtered /= np.float32(math.sqrt(power / scaled.size))
        sample = filtered.ravel()[:: max(1, filtered.size // SAMPLE)]
        middle = np.median(sample)
        scatter = 1.4826 * float(np.median(np.abs(sample - middle)))
        _keep_best(filtered, middle, np.float32(max(1.0, scatter)), number, best, which)
    return best, which


def _sinc(x: NDArray[np.float32], spare: NDArray[np.float32]) -> None:
    """sin(pi x) / (pi x) in place of x; spare : as large."""
    x *= np.float32(np.pi)
    x[x == 0] = np.finfo(np.float32).eps
    np.divide(np.sin(x, out=spare), x, out=x)


@njit(cache=True, nogil=True)
def _keep_best(filtered, middle, scatter, number, best, which):
    """Where a filter's image exceeds the best so far, that and its number take its place."""
    for y in range(filtered.shape[0]):
        for x in range(filtered.shape[1]):
            snr = (filtered[y, x] - middle) / scatter
            if snr > best[y, x]:
                best[y, x], which[y, x] = snr, number


def _even(
    points: NDArray[np.float32],
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    length: Array,
    angle: Array,
) -> NDArray[np.bool_]:
    """Lines that are lit all along: no single point, nor two of them, makes one.

    points : the image filtered by a point. Of PLACES along the line the median must reach
    EVEN of the brightest, unless none of them is above BRIGHT_SIGMA.
    """
    steps = np.linspace(-0.5, 0.5, PLACES)[:, None] * length
    rows = np.clip(np.round(y + steps * np.sin(angle)).astype(int), 0, points.shape[0] - 1)
    columns = np.clip(np.round(x + steps * np.cos(angle)).astype(int), 0, points.shape[1] - 1)
    light = points[rows, columns]
    brightest = light.max(axis=0, initial=0.0)
    if not len(x):
        return np.zeros(0, bool)
    return np.asarray((brightest < BRIGHT_SIGMA) | (np.median(light, axis=0) >= EVEN * brightest))


def _own_peaks(x: Array, y: Array, length: Array, angle: Array) -> NDArray[np.bool_]:
    """Peaks, brightest first, that no brighter line runs through."""
    kept = np.ones(len(x), bool)
    if not len(x):
        return kept
    tree = cKDTree(np.stack([x, y], axis=-1))
    for i in range(len(x)):
        if not kept[i]:
            continue
        near = np.array(tree.query_ball_point((x[i], y[i]), 0.75 * length[i] + 4.0))
        later = near[near > i]
        dx, dy = x[later] - x[i], y[later] - y[i]
        along = dx * math.cos(angle[i]) + dy * math.sin(angle[i])
        across = -dx * math.sin(angle[i]) + dy * math.cos(angle[i])
        kept[later[(np.abs(along) < 0.75 * length[i] + 3.0) & (np.abs(across) < 3.0)]] = False
    return kept
