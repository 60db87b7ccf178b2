"""Sources too bright for transforms: the light of each pixel by quadrature of the profile itself.

A transform errs by a fraction of the whole light in every pixel, a quadrature of the (positive)
profile by a fraction of the light of that pixel, which its noise hides however bright the source.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.drawing.wings import CUT_FROM
from pipeline.physics.motion.streak import Path
from pipeline.physics.psf.band import Mixture
from pipeline.physics.psf.pupil import Airy, Blur, EllipticalGaussian, Gaussian, Optics
from pipeline.physics.psf.seeing import Moffat

Array = NDArray[np.float64]

RELATIVE = 1e-12  # error of a pixel over its light, and FAINTEST of the source's (tests)
FAINTEST = 1e-25
NODES = 12  # of a panel of the profile
PANELS = 4.0  # to the scale of the optics
BLOCK = 4  # panels that are blurred together
NARROW, HERMITE = 0.02, 7  # of the optics' scale: a blur whose mean is that of few places
BLUR_SIGMA = 9.0  # a Gaussian blur reaches so far
FEWEST, MOST, MORE = 6, 1024, 4  # nodes across a pixel, and how many more are tried next
CONVERGED = 1e-12
PLACES_PX = ((0.0, 0.0), (0.5, 0.5), (1.3, 0.6), (2.7, 3.4))  # where pixels must converge
FAR_NODES, FAR_WIDTH_PX = 10, 0.5  # of pixels beyond NEAR_PX, and of their panels: of seeing
NEAR_PX = 12.0  # from a source, beyond which the angle's few harmonics are interpolated
MOST_VALUES = 1e8  # pixels times points of a path that one source may cost: half a minute
BAND_FLOOR = 1e-12
NODE_S, VALUE_S = 3e-8, 8e-9  # of a node of a blur, of a value of a profile: one core
FAR_S = 2e-7  # of a pixel far from a point of a path
FAR_SIGMA = 14.0  # a Gaussian holds all but 1e-42 of its light within it
SPARE_PX = 4.0
RADIUS_STEP = 2.0  # sources whose farthest pixels are so far apart share a profile
LONGEST_PX = 96.0  # of a path, that one rule goes along


@dataclass(frozen=True, eq=False)
class Profile:
    """Light per px^2 over the distance from a source, per unit light.

    coefficients : (panels, NODES) powers of a panel's own coordinate, -1 to 1, lowest last
    width_px : of a panel
    rounded : (2, 2) matrix that takes (y, x) to where light of one level is a circle
    reach_px : distance beyond which there is no light, or none is asked for
    """

    coefficients: Array
    width_px: float
    rounded: Array
    reach_px: float

    @property
    def numbers(self) -> tuple[Array, float, Array, float]:
        """All of it, for compiled loops."""
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
    along = points_along(blur, path)
    if isinstance(blur.optics, EllipticalGaussian):
        along *= nodes_of(blur) ** 2 // 16
    return math.prod(shape) * along <= MOST_VALUES


def points_along(blur: Blur, path: Path) -> int:
    """Points of a path, and of the steps of a charge, that each pixel sums."""
    lengths = np.hypot(np.diff(path.x_px), np.diff(path.y_px))
    count = int(_counts(blur, lengths).sum())
    return count * (nodes_of(blur) if blur.clock_px else 1)


def profile_s(blur: Blur, radius_px: float) -> float:
    """About the CPU seconds of making what sources up to so far from a pixel are drawn with."""
    (optics, _, spread), (n, width_px) = _round(blur), _far_rule(blur)
    if isinstance(optics, Gaussian):
        return 0.0
    nodes = HERMITE**2 * float(spread > 0.0)
    if spread >= NARROW * _scale(optics):
        nodes = NODES * (2.0 * BLUR_SIGMA * spread / min(_scale(optics), 2.0 * spread) + BLOCK)
    far = (n // 2 + 2) * n * n / width_px
    return radius_px * NODES * (NODE_S * nodes * PANELS / _scale(optics) + VALUE_S * far)


def drawn_s(blur: Blur, path: Path, pixels: int, near: float = 1.0) -> float:
    """About the CPU seconds of drawing a source in so many pixels.

    near : share of such sources whose path crosses them; the others' passes by
    """
    share = near * min(1.0, 2.0 * NEAR_PX / max(path.length_px, 2.0 * NEAR_PX))
    return pixels * points_along(blur, path) * (FAR_S + share * VALUE_S * nodes_of(blur) ** 2)


def draw_quadrature(
    blur: Blur,
    path: Path,
    shape: tuple[int, int],
    origin: tuple[int, int],
    y_px: float,
    x_px: float,
    reach_px: float = math.inf,
    finer: bool = False,
) -> Array:
    """Light of a source at (y, x) in each pixel, per unit light: (rows, columns) float64.

    origin : frame pixel (y, x) of the first; every pixel is its own, whatever the window is
    reach_px : of the light, which fades out over its last tenth as wings do (drawing/wings.py)
    finer : with half as many nodes more, and none of the pixels interpolated
    """
    n = nodes_of(blur) * 3 // 2 if finer else nodes_of(blur)
    points = _points(blur, path, n, finer)
    place = origin[0] - y_px, origin[1] - x_px
    corners = [(place[0] + i * shape[0], place[1] + j * shape[1]) for i in (0, 1) for j in (0, 1)]
    farthest = max(math.hypot(*c) for c in corners) + 1.5 * float(np.abs(points[:, :2]).max()) + 2.0
    radius = min(_at_least(farthest), max(reach_px, 16.0))
    out = np.zeros(shape)
    profile = profile_of(blur, radius + SPARE_PX)
    if finer or not np.array_equal(profile.rounded, np.eye(2)):
        far, near_px, width_px = np.zeros((0, NODES, 0)), math.inf, 1.0
    else:
        far, near_px = far_pixels(blur, radius), NEAR_PX
        width_px = _far_rule(blur)[1]
    ends = CUT_FROM * reach_px, reach_px
    table = far, width_px, near_px
    _integrate(out, *place, points, *_pixel(blur, n), *profile.numbers, *table, *ends)
    return out


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
    profile = profile_of(blur, _at_least(farthest) + SPARE_PX)
    out, rest = np.zeros((len(places), 1, 1)), np.array([[0.0, 0.0, 1.0]])
    nothing, ends = np.zeros((0, NODES, 0)), (1.0, math.inf, math.inf, math.inf)
    for one, (y, x) in zip(out, places, strict=True):
        _integrate(one, y, x, rest, *_pixel(blur, n), *profile.numbers, nothing, *ends)
    return out[:, 0, 0]


def _at_least(radius_px: float) -> float:
    """A radius rounded up, so that sources share their profiles."""
    return 16.0 * RADIUS_STEP ** math.ceil(math.log(max(radius_px, 16.0) / 16.0, RADIUS_STEP))


def _pixel(blur: Blur, n: int) -> tuple[Array, Array, Array]:
    """Nodes across the square that collects light, and weights along y and along x."""
    at, weight = _unit(n)
    return math.sqrt(blur.fill_factor) * at, blur.fill_factor * weight, weight


@lru_cache(maxsize=16)
def far_pixels(blur: Blur, radius_px: float) -> Array:
    """What a pixel far from a source at rest collects, over distance and angle from a row.

    (panels, NODES, harmonics): powers of a panel's coordinate, of each cosine of four times the
    angle; nothing is in panels nearer than NEAR_PX. Squares look alike at every quarter turn.
    """
    profile, (n, width_px) = profile_of(blur, radius_px + SPARE_PX), _far_rule(blur)
    radius_px = min(radius_px, profile.reach_px)
    count = math.ceil(radius_px / width_px) + 1
    harmonics = n // 2 + 2
    turn = np.pi * (np.arange(harmonics) + 0.5) / harmonics
    cosines = np.cos(np.outer(turn, np.arange(harmonics))) * 2.0 / harmonics
    cosines[:, 0] *= 0.5
    at, to_powers = _panel()
    r = ((np.arange(count)[:, None] + 0.5 * (at + 1.0)) * width_px).ravel()
    first = max(0, math.floor(NEAR_PX / width_px) - 1)
    values = np.zeros((len(r), harmonics))
    _around(values, r, turn / 4.0, first * NODES, *_pixel(blur, n), *profile.numbers)
    values = (values[:, :, None] * cosines).sum(axis=1)
    size = np.abs(values)
    shown = (size > 1e-14 * size[:, :1] + FAINTEST).any(axis=0)
    kept = int(np.flatnonzero(shown).max(initial=0)) + 1
    values = values[:, :kept].reshape(count, NODES, kept)
    return np.ascontiguousarray(np.einsum("pkm,ck->pcm", values, to_powers))


def _far_rule(blur: Blur) -> tuple[int, float]:
    """Nodes across a pixel far from a source, and width of the panels of such pixels [px].

    Light that falls as a power of the distance is as smooth there as the distance is long; rings
    are as narrow everywhere.
    """
    n, width_px = nodes_of(blur), _scale(_round(blur)[0]) / PANELS
    if isinstance(blur.optics, Moffat):
        return min(n, FAR_NODES), max(width_px, FAR_WIDTH_PX)
    return n, width_px


@lru_cache(maxsize=32)
def profile_of(blur: Blur, radius_px: float) -> Profile:
    """The profile of a response up to a radius; what it holds does not depend on the radius."""
    optics, rounded, spread = _round(blur)
    width = _scale(optics) / PANELS
    if isinstance(optics, Gaussian):
        radius_px = min(
            radius_px,
            FAR_SIGMA * float(np.abs(np.linalg.inv(rounded)).max()) * 1.5 * optics.sigma_px
            + SPARE_PX,
        )
    count = math.ceil(radius_px * float(np.linalg.norm(rounded, 2)) / width) + 1
    at, to_powers = _panel()
    r = (np.arange(count)[:, None] + 0.5 * (at + 1.0)) * width
    values = _blurred(optics, spread, r, width) if spread else _intensity(optics, r)
    values *= abs(float(np.linalg.det(rounded)))
    return Profile(np.einsum("pk,ck->pc", values, to_powers), width, rounded, radius_px - 2.0)


def _round(blur: Blur) -> tuple[Optics, Array, float]:
    """Round optics, the matrix (y, x) is multiplied by for them, and what blurs them yet."""
    spread, optics = math.hypot(blur.jitter_px, blur.diffusion_px), blur.optics
    if isinstance(optics, Gaussian):
        return Gaussian(math.hypot(optics.sigma_px, spread)), np.eye(2), 0.0
    if not isinstance(optics, EllipticalGaussian):
        return optics, np.eye(2), spread
    c, s = math.cos(optics.angle_rad), math.sin(optics.angle_rad)
    major, minor = (math.hypot(v, spread) for v in (optics.sigma_major_px, optics.sigma_minor_px))
    return Gaussian(1.0), np.array([[s / major, c / major], [c / minor, -s / minor]]), 0.0


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


def _panel() -> tuple[Array, Array]:
    """Chebyshev nodes (NODES,) of a panel, and the matrix from values there to powers."""
    at = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    return at, np.linalg.inv(np.vander(at, NODES))


def _unit(n: int) -> tuple[Array, Array]:
    """Gauss-Legendre nodes on -1/2 ... 1/2, and weights of sum one."""
    at, weight = np.polynomial.legendre.leggauss(n)
    return 0.5 * at, 0.5 * weight


def _counts(blur: Blur, lengths_px: Array) -> NDArray[np.intp]:
    """Gauss-Legendre nodes along so many px, each: of all waves of the response's band."""
    parts = np.ceil(lengths_px / LONGEST_PX)
    waves = blur.band_limit(BAND_FLOOR) * lengths_px / np.maximum(parts, 1.0)
    each = np.ceil(1.75 * waves + 16.0 * np.minimum(1.0, np.sqrt(waves)) + 2.0)
    return np.where(lengths_px > 0.0, parts * each, 1.0).astype(np.intp)


def _points(blur: Blur, path: Path, n: int, finer: bool) -> Array:
    """(points, 3) y, x and share of the light along a path, and of the steps of a charge."""
    out = []
    rows_px, columns_px = np.diff(path.y_px), np.diff(path.x_px)
    lengths_px = np.hypot(rows_px, columns_px)
    counts = _counts(blur, lengths_px)
    for k, (dy, dx) in enumerate(zip(rows_px, columns_px, strict=True)):
        parts = max(1, math.ceil(lengths_px[k] / LONGEST_PX))
        at, weight = _unit(int(counts[k]) // parts * (3 if finer else 2) // 2)
        along = ((np.arange(parts)[:, None] + 0.5 + at) / parts).ravel()
        share = np.tile(weight / parts, parts) * path.weight[k]
        out.append(np.stack([path.y_px[k] + along * dy, path.x_px[k] + along * dx, share], axis=1))
    points = np.concatenate(out)
    if not blur.clock_px:
        return points
    at, weight = _unit(n)
    stepped = np.repeat(points, n, axis=0)
    stepped[:, 0] += blur.clock_px * np.tile(at, len(points))
    stepped[:, 2] *= np.tile(weight, len(points))
    return stepped


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


@njit(cache=True, nogil=True)
def _around(out, radii, angles, first, at, down, along, coefficients, width, rounded, reach):
    """Pixels at radii (k,) from `first` on and angles (m,) from a source at rest: out (k, m)."""
    for k in range(first, radii.size):
        for m in range(angles.size):
            y, x = radii[k] * np.sin(angles[m]), radii[k] * np.cos(angles[m])
            out[k, m] = _pixel_at(y, x, at, down, along, coefficients, width, rounded, reach)


@njit(cache=True, nogil=True)
def _integrate(
    out,
    y0,
    x0,
    points,
    at,
    down,
    along,
    coefficients,
    width,
    rounded,
    reach,
    far,
    far_width,
    near_px,
    fades,
    ends,
):
    """Adds the light of each pixel: (y0, x0) is the first one's centre from the source."""
    terms, last = np.empty(far.shape[2]), min(reach, ends) ** 2
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            total = 0.0
            for p in range(points.shape[0]):
                y, x = y0 + r - points[p, 0], x0 + c - points[p, 1]
                square = y * y + x * x
                if square >= last:  # the tables may end there
                    continue
                if square < near_px * near_px:
                    value = _pixel_at(y, x, at, down, along, coefficients, width, rounded, reach)
                else:
                    value = _far_at(y, x, square, far, far_width, terms)
                if square > fades * fades:
                    t = min(1.0, max(0.0, (ends - np.sqrt(square)) / (ends - fades)))
                    value *= t * t * t * (10.0 + t * (6.0 * t - 15.0))
                total += points[p, 2] * value
            out[r, c] += total


@njit(cache=True, nogil=True, inline="always")
def _far_at(y, x, square, far, width, terms):
    """A far pixel from its harmonics: Horner's rule for each, Clenshaw's sum of them."""
    t = np.sqrt(square) / width
    k = int(t)
    t = 2.0 * (t - k) - 1.0
    for m in range(terms.size):
        terms[m] = far[k, 0, m]
    for power in range(1, NODES):
        for m in range(terms.size):
            terms[m] = terms[m] * t + far[k, power, m]
    # cos 4a from tan a: cos 2a = (x^2 - y^2) / r^2, doubled once more.
    twice = (x * x - y * y) / square
    cosine = 2.0 * twice * twice - 1.0
    one, two = 0.0, 0.0
    for m in range(terms.size - 1, 0, -1):
        one, two = terms[m] + 2.0 * cosine * one - two, one
    return terms[0] + cosine * one - two
