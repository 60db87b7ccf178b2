"""Sources too bright for transforms: the light of each pixel by quadrature of the profile itself.

A transform errs by a fraction of the whole light in every pixel, a quadrature of the (positive)
profile by a fraction of the light of that pixel, which its noise hides however bright the source.

What falls on a pixel away from the source is what flows through its four sides (Gauss's theorem):
a round profile f is the divergence of -(p / r^2) E(r), where E is the integral of f s ds from r on,
the light beyond over 2 pi. One integral along each side stands for that over the area.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.drawing.wings import CUT_FROM
from pipeline.physics.motion.points import points_along, points_per_px
from pipeline.physics.motion.streak import Path
from pipeline.physics.psf.band import Mixture
from pipeline.physics.psf.pupil import Airy, Blur, EllipticalGaussian, Gaussian, Optics
from pipeline.physics.psf.seeing import Moffat

Array = NDArray[np.float64]

RELATIVE = 1e-12  # error of a pixel over its light, and FAINTEST of the source's; of one with a
# share p of the light, far off or in a dark ring, over sqrt(p): less than this of its noise (tests)
FAINTEST = 1e-25
NODES = 12  # of a panel of the profile
PANELS = 4.0  # to the scale of the optics
BLOCK = 4  # panels that are blurred together
NARROW, HERMITE = 0.02, 7  # of the optics' scale: a blur whose mean is that of few places
BLUR_SIGMA = 9.0  # a Gaussian blur reaches so far
FEWEST, MOST, MORE = 6, 1024, 4  # nodes across a pixel, and how many more are tried next
CONVERGED = 1e-12
PLACES_PX = ((0.0, 0.0), (0.5, 0.5), (1.3, 0.6), (2.7, 3.4))  # where pixels must converge
NEAR_PX = 2.5  # from a source, beyond which pixels are integrated along their sides
MOST_VALUES = 1e8  # pixels times points of a path that one source may cost: half a minute
BAND_FLOOR = 1e-12
NODE_S, VALUE_S = 3e-8, 8e-9  # of a node of a blur, of a value of a profile: one core
SIDE_S = 1.3e-8  # and of a node of a side
FAR_SIGMA = 14.0  # a Gaussian holds all but 1e-42 of its light within it
SPARE_PX = 4.0
RADIUS_STEP = 2.0  # sources whose farthest pixels are so far apart share a profile


@dataclass(frozen=True, eq=False)
class Profile:
    """Light per px^2 over the distance from a source, per unit light.

    coefficients : (panels, NODES) powers of a panel's own coordinate, -1 to 1, lowest last
    beyond : (panels, NODES) the same of E(r), by which light flows through sides
    width_px : of a panel
    rounded : (2, 2) matrix that takes (y, x) to where light of one level is a circle
    reach_px : distance beyond which there is no light, or none is asked for
    """

    coefficients: Array
    beyond: Array
    width_px: float
    rounded: Array
    reach_px: float

    @property
    def numbers(self) -> tuple[Array, float, Array, float]:
        """What the integral over an area takes, for compiled loops."""
        return self.coefficients, self.width_px, self.rounded, self.reach_px


def has_profile(blur: Blur) -> bool:
    """Whether the profile of a response is known in closed form."""
    optics = blur.optics
    if isinstance(optics, Mixture):
        return all(isinstance(p, Airy) for p in optics.parts)
    return isinstance(optics, Gaussian | EllipticalGaussian | Airy | Moffat)


def affordable(blur: Blur, path: Path, shape: tuple[int, int]) -> bool:
    """Whether a source with such a path can be drawn by quadrature in a frame."""
    if not has_profile(blur):
        return False
    most = MOST_VALUES / math.prod(shape)
    if _over_areas(blur):
        most /= nodes_of(blur) ** 2 // 16
    if points_per_px(blur.band_limit(BAND_FLOOR)) * path.length_px > 2.0 * most:
        return False  # runs of segments may take fewer
    return len(points_of(blur, path)) <= most


def points_of(blur: Blur, path: Path, finer: bool = False) -> Array:
    """(points, 3) y, x and share of the light along a path, and of the steps of a charge, that each
    pixel sums. finer : for a band half as wide again, on each segment by itself
    """
    band, n = blur.band_limit(BAND_FLOOR), nodes_of(blur)
    if finer:
        path, band, n = replace(path, off_px=0.0), 1.5 * band, n * 3 // 2
    x, y, share = points_along(path, band, BAND_FLOOR)
    points = np.stack([y, x, share], axis=1)
    if not blur.clock_px:
        return points
    at, weight = _unit(n)
    stepped = np.repeat(points, n, axis=0)
    stepped[:, 0] += blur.clock_px * np.tile(at, len(points))
    stepped[:, 2] *= np.tile(weight, len(points))
    return stepped


def profile_s(blur: Blur, radius_px: float) -> float:
    """About the CPU seconds of making what sources up to so far from a pixel are drawn with."""
    optics, _, spread = _round(blur)
    if isinstance(optics, Gaussian):
        return 0.0
    parts = len(optics.parts) if isinstance(optics, Mixture) else 1
    nodes = HERMITE**2 if spread else 1.0
    if spread >= NARROW * _scale(optics):
        nodes = NODES * (2.0 * BLUR_SIGMA * spread / min(_scale(optics), 2.0 * spread) + BLOCK)
    values = radius_px * NODES * PANELS / _scale(optics)
    return values * (NODE_S * nodes + VALUE_S * parts)


def drawn_s(blur: Blur, path: Path, pixels: int, near: float = 1.0) -> float:
    """About the CPU seconds of drawing a source in so many pixels.

    near : share of such sources whose path crosses them; the others' passes by
    """
    n, around = nodes_of(blur), math.pi * NEAR_PX**2 * near
    far_s = VALUE_S * n if _over_areas(blur) else 2.0 * SIDE_S
    return len(points_of(blur, path)) * n * (far_s * pixels + VALUE_S * around * n)


def draw_quadrature(
    blur: Blur,
    path: Path,
    shape: tuple[int, int],
    origin: tuple[int, int],
    y_px: float,
    x_px: float,
    reach_px: float = math.inf,
    finer: bool = False,
    frame: tuple[int, int] = (1, 1),
) -> Array:
    """Light of a source at (y, x) in each pixel, per unit light: (rows, columns) float64.

    origin : frame pixel (y, x) of the first; every pixel is its own, whatever the window is in
        a frame of that shape
    reach_px : of the light, which fades out over its last tenth as wings do (drawing/wings.py)
    finer : with half as many nodes more, and every pixel over its area
    """
    n = nodes_of(blur) * 3 // 2 if finer else nodes_of(blur)
    points = points_of(blur, path, finer) + [y_px, x_px, 0.0]
    first, last = np.minimum(0, origin), np.maximum(frame, np.add(origin, shape))
    far = np.maximum(points[:, :2] - first, last - points[:, :2])
    farthest = float(np.hypot(*far.T).max()) + 2.0
    profile = profile_of(blur, min(_at_least(farthest), max(reach_px, 16.0)) + SPARE_PX)
    near_px = math.inf if finer or _over_areas(blur) else NEAR_PX
    rule = points, *_pixel(blur, n), math.sqrt(blur.fill_factor), near_px
    out = np.zeros(shape)
    _integrate(out, *origin, *rule, profile.beyond, *profile.numbers, CUT_FROM * reach_px, reach_px)
    return out


def _over_areas(blur: Blur) -> bool:
    """Whether all pixels are integrated over areas: what crosses a side of an ellipse is sharper
    than the ellipse."""
    return isinstance(blur.optics, EllipticalGaussian)


@lru_cache(maxsize=64)
def nodes_of(blur: Blur) -> int:
    """Nodes across a pixel from which on more of them change nothing."""
    n, before = FEWEST, _pixels(blur, PLACES_PX, FEWEST)
    while n < MOST:
        n += max(MORE, n // 16)
        now = _pixels(blur, PLACES_PX, n)
        if (np.abs(now - before) <= CONVERGED * now + FAINTEST).all():
            return n
        before = now
    return MOST


def _pixels(blur: Blur, places_px: Sequence[tuple[float, float]], n: int) -> Array:
    """Light of the pixels (k,) whose centres are at (y, x) (k, 2) from a source at rest."""
    places = np.asarray(places_px, float)
    farthest = float(np.hypot(*places.T).max()) + 2.0
    numbers = profile_of(blur, _at_least(farthest) + SPARE_PX).numbers
    return np.array([_pixel_at(y, x, *_pixel(blur, n), *numbers) for y, x in places])


def _at_least(radius_px: float) -> float:
    """A radius rounded up, so that sources share their profiles."""
    return 16.0 * RADIUS_STEP ** math.ceil(math.log(max(radius_px, 16.0) / 16.0, RADIUS_STEP))


def _pixel(blur: Blur, n: int) -> tuple[Array, Array, Array]:
    """Nodes across the square that collects light, and weights along y and along x."""
    at, weight = _unit(n)
    return math.sqrt(blur.fill_factor) * at, blur.fill_factor * weight, weight


@lru_cache(maxsize=8)
def profile_of(blur: Blur, radius_px: float) -> Profile:
    """The profile of a response up to a radius; `beyond` counts from its end."""
    optics, rounded, spread = _round(blur)
    width = _scale(optics) / PANELS
    if isinstance(optics, Gaussian):  # wherever it is asked for, it ends where its light does
        widest = float(np.abs(np.linalg.inv(rounded)).max()) * 1.5 * optics.sigma_px
        radius_px = FAR_SIGMA * widest + SPARE_PX
    count = math.ceil(radius_px * float(np.linalg.norm(rounded, 2)) / width) + 1
    r = (np.arange(count)[:, None] + 0.5 * (_panel() + 1.0)) * width
    values = _blurred(optics, spread, r, width) if spread else _intensity(optics, r)
    light = _powers(values * abs(float(np.linalg.det(rounded))))
    return Profile(light, _powers(_beyond(values * r, width)), width, rounded, radius_px - 2.0)


def _beyond(values: Array, width_px: float) -> Array:
    """E at the nodes (panels, NODES): the integral of these values from there to the end of all."""
    power = np.arange(NODES, 0, -1)
    mean = 0.5 * width_px * _powers(values) / power
    after = np.cumsum((mean @ (1.0 - (-1.0) ** power))[::-1])[::-1]
    to_end = mean @ (1.0 - _panel() ** power[:, None])
    return np.asarray(to_end + np.append(after[1:], 0.0)[:, None])


def _round(blur: Blur) -> tuple[Optics, Array, float]:
    """Round optics, the matrix (y, x) is multiplied by for them, and what blurs them yet."""
    spread, optics = math.hypot(blur.jitter_px, blur.diffusion_px), blur.optics
    if isinstance(optics, Gaussian):
        return Gaussian(math.hypot(optics.sigma_px, spread)), np.eye(2), 0.0
    if not isinstance(optics, EllipticalGaussian):
        return optics, np.eye(2), spread
    c, s = math.cos(optics.angle_rad), math.sin(optics.angle_rad)
    major, minor = (math.hypot(v, spread) for v in (optics.sigma_major_px, optics.sigma_minor_px))
    return Gaussian(1.0), np.array([[s / major, c / major], [-c / minor, s / minor]]), 0.0


def _scale(optics: Optics) -> float:
    """Length over which a profile changes [px]."""
    if isinstance(optics, Mixture):
        return min(_scale(p) for p in optics.parts)
    return 0.5 * optics.scale_px if isinstance(optics, Moffat) else optics.scale_px


def _intensity(optics: Optics, r_px: Array) -> Array:
    """Light per px^2 at a radius, per unit light."""
    if isinstance(optics, Mixture):
        both = zip(optics.parts, optics.weights, strict=True)
        return np.sum([w * _intensity(p, r_px) for p, w in both], axis=0)
    assert isinstance(optics, Gaussian | Airy | Moffat)
    return np.asarray(optics.intensity(r_px))


def _blurred(optics: Optics, sigma_px: float, r_px: Array, width_px: float) -> Array:
    """A round profile after a Gaussian blur: the mean over rings (Rice's distribution).

    r_px : (panels, NODES) radii, panel by panel
    """
    if sigma_px < NARROW * _scale(optics):
        return _mean_around(optics, sigma_px, r_px)
    at, weight = np.polynomial.legendre.leggauss(NODES)
    wide, beyond = min(_scale(optics), 2.0 * sigma_px), BLUR_SIGMA * sigma_px
    count = math.ceil((len(r_px) * width_px + beyond) / wide) + 1
    s = (np.arange(count)[:, None] + 0.5 * (at + 1.0)) * wide
    light = _intensity(optics, s) * s * (0.5 * wide * weight) / sigma_px**2
    out = np.empty(r_px.shape)
    for k in range(0, len(r_px), BLOCK):
        r = r_px[k : k + BLOCK]
        first = max(0, math.floor((k * width_px - beyond) / wide))
        part = slice(first, math.ceil(((k + BLOCK) * width_px + beyond) / wide))
        near = s[part].ravel()[None, :]
        kernel = np.exp(-0.5 * ((r.ravel()[:, None] - near) / sigma_px) ** 2)
        kernel *= scipy.special.i0e(r.ravel()[:, None] * near / sigma_px**2)
        out[k : k + BLOCK] = (kernel * light[part].ravel()).sum(axis=1).reshape(r.shape)
    return out


def _mean_around(optics: Optics, sigma_px: float, r_px: Array) -> Array:
    """The same where the profile hardly changes over the blur: HERMITE by HERMITE places of it."""
    at, weight = np.polynomial.hermite_e.hermegauss(HERMITE)
    out = np.zeros(r_px.shape)
    for x, share in zip(sigma_px * at, weight / weight.sum(), strict=True):
        for y, other in zip(sigma_px * at, weight / weight.sum(), strict=True):
            out += share * other * _intensity(optics, np.hypot(r_px + x, y))
    return out


def _panel() -> Array:
    """Chebyshev nodes (NODES,) of a panel."""
    return np.asarray(np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES))


def _powers(values: Array) -> Array:
    """Powers (panels, NODES), highest first, of what has these values at the nodes: by way of
    Chebyshev's polynomials, which keeps all their digits."""
    k = np.arange(NODES)
    found = values @ np.cos(np.outer(np.arccos(_panel()), k)) * (2.0 / NODES)
    found[:, 0] *= 0.5
    to_powers = [np.polynomial.chebyshev.cheb2poly(np.eye(NODES)[i]) for i in k]
    table = np.array([np.append(p, np.zeros(NODES - p.size)) for p in to_powers])
    return np.ascontiguousarray((found @ table)[:, ::-1])


def _unit(n: int) -> tuple[Array, Array]:
    """Gauss-Legendre nodes on -1/2 ... 1/2, and weights of sum one."""
    at, weight = np.polynomial.legendre.leggauss(n)
    return 0.5 * at, 0.5 * weight


@njit(cache=True, nogil=True)
def _pixel_at(y, x, at, down, along, coefficients, width, rounded, reach):
    """Integral of the profile over the pixel whose centre is at (y, x) from the source."""
    total = 0.0
    if y * y + x * x >= reach * reach:
        return total
    for i in range(at.size):
        v, line = y + at[i], 0.0
        for j in range(at.size):
            u = x + at[j]
            a, b = rounded[0, 0] * v + rounded[0, 1] * u, rounded[1, 0] * v + rounded[1, 1] * u
            t = np.sqrt(a * a + b * b) / width
            k = int(t)
            t = 2.0 * (t - k) - 1.0
            value = coefficients[k, 0]
            for m in range(1, NODES):
                value = value * t + coefficients[k, m]
            line += along[j] * value
        total += down[i] * line
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _side(y, x, down, right, at, weights, beyond, width):
    """What flows across a pixel's side, whose middle is at (y, x) from the source: of one that runs
    `down` to the right, of one that runs `right` upwards."""
    total = 0.0
    for i in range(at.size):
        v, u = y + at[i] * down, x + at[i] * right
        square = v * v + u * u
        t = np.sqrt(square) / width
        k = int(t)
        t = 2.0 * (t - k) - 1.0
        value = beyond[k, 0]
        for m in range(1, NODES):
            value = value * t + beyond[k, m]
        total += weights[i] * value / square
    return (x * down - y * right) * total


@njit(cache=True, nogil=True)
def _left(square, fades, ends):
    """Part of light that is left at a distance, given its square."""
    if square <= fades * fades:
        return 1.0
    t = min(1.0, max(0.0, (ends - np.sqrt(square)) / (ends - fades)))
    return t * t * t * (10.0 + t * (6.0 * t - 15.0))


@njit(cache=True, nogil=True)
def _integrate(
    out,
    row,
    column,
    points,
    at,
    down,
    along,
    side,
    near_px,
    beyond,
    coefficients,
    width,
    rounded,
    reach,
    fades,
    ends,
):
    """Adds the light of each pixel (the first is in row and column), of a source at points (P, 3).

    Neighbours whose squares touch share the side between them.
    """
    half, touch, last = 0.5 * side, side == 1.0, min(reach, ends) ** 2  # the tables end there
    table = at, side * along, beyond, width
    below, found = np.empty(out.shape[1]), np.empty(out.shape[1], np.int64)
    for p in range(points.shape[0]):
        found[:] = -1
        for r in range(out.shape[0]):
            y, beside, right = row + r - points[p, 0], -1, 0.0
            for c in range(out.shape[1]):
                x = column + c - points[p, 1]
                square = y * y + x * x
                if square >= last:
                    continue
                if square < near_px * near_px:
                    value = _pixel_at(y, x, at, down, along, coefficients, width, rounded, reach)
                else:
                    x0, x1 = column + c - half - points[p, 1], column + c + half - points[p, 1]
                    y0, y1 = row + r - half - points[p, 0], row + r + half - points[p, 0]
                    left = right if touch and beside == c else _side(y, x0, 1.0, 0.0, *table)
                    above = below[c] if touch and found[c] == r else _side(y0, x, 0.0, 1.0, *table)
                    right, below[c] = _side(y, x1, 1.0, 0.0, *table), _side(y1, x, 0.0, 1.0, *table)
                    beside, found[c] = c + 1, r + 1
                    value = left - right + below[c] - above
                out[r, c] += points[p, 2] * value * _left(square, fades, ends)
