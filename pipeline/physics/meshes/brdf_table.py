"""Measured reflection: an isotropic BRDF as a table over both zenith angles and the azimuth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import BadInput
from pipeline.physics.meshes.intensity import sun_points

Array = NDArray[np.float64]

FIELD = "brdf"
MOST_LIGHT = 1.02  # a measured albedo may lie above 1 by its error
STEPS = 64
UNSEEN = 0.01  # share of a peak that the Sun's disc may change
RINGS_A_STEP = 4.0  # of the disc within each step of a table: it has nothing finer
PEAKS = 16  # of each theta_o, those that the disc changes most, for which rings are counted


@dataclass(frozen=True, eq=False)
class BrdfTable:
    """An isotropic BRDF on a grid of angles; linear between them. Made by `brdf_table`.

    theta_i_rad, theta_o_rad : ascending zenith angles of Sun and observer, from 0; beyond the last
        one the value at it holds
    phi_rad : ascending azimuth between them, 0 (observer on the Sun's side, backscatter) to pi
        (forward, where a mirror shines)
    value : (theta_i, theta_o, phi) 1/sr
    asymmetry : how far the values were from their mirror image before both were averaged, as
        `reciprocity_error` has it
    """

    theta_i_rad: Array
    theta_o_rad: Array
    phi_rad: Array
    value: Array
    asymmetry: float = 0.0

    @cached_property
    def highlight_rad(self) -> float:
        """How far a body turns while a highlight brightens by e^(1/2): the least of all that are
        seen, half of the way of the Sun in which it falls so far again; inf where none does."""
        least, mu = np.inf, np.cos(self.theta_o_rad)
        lit = self.value * np.cos(self.theta_i_rad)[:, None, None] * mu[:, None]
        shown = np.where(lit >= UNSEEN * lit.max(), self.value, 0.0)
        for k in range(len(mu)):
            i, j = np.unravel_index(int(shown[:, k].argmax()), shown[:, k].shape)
            value = self.value[:, k]
            if value[i, j] < value[max(i - 1, 0) : i + 2, j].max():
                continue  # its peak is not seen
            low = value[i, j] * np.exp(-0.5)
            off = np.abs(self.theta_i_rad - self.theta_i_rad[i])[value[:, j] < low]
            turned = np.abs(self.phi_rad - self.phi_rad[j])[value[i] < low]
            least = min([least, *off, *(np.sin(self.theta_i_rad[i]) * turned if i else ())])
        return 0.5 * float(least)

    def __call__(self, normal: ArrayLike, sun: ArrayLike, observer: ArrayLike) -> Array:
        """BRDF (...,) [1/sr] for unit vectors (..., 3); 0 from behind."""
        n, s, o = (np.asarray(v, float) for v in (normal, sun, observer))
        mu_i, mu_o = np.sum(n * s, -1), np.sum(n * o, -1)
        across_s, across_o = s - mu_i[..., None] * n, o - mu_o[..., None] * n
        sine_i, sine_o = (np.sqrt(np.sum(v * v, -1)) for v in (across_s, across_o))
        along = np.sum(across_s * across_o, -1)
        side = np.sqrt(np.sum(np.square(np.cross(across_s, across_o)), -1))
        value = self.at(np.arctan2(sine_i, mu_i), np.arctan2(sine_o, mu_o), np.arctan2(side, along))
        return np.where((mu_i > 0.0) & (mu_o > 0.0), value, 0.0)

    def at(self, theta_i_rad: ArrayLike, theta_o_rad: ArrayLike, phi_rad: ArrayLike) -> Array:
        """BRDF [1/sr] at angles, broadcast together; trilinear."""
        grids = (self.theta_i_rad, self.theta_o_rad, self.phi_rad)
        cells = [
            _cell(g, a) for g, a in zip(grids, (theta_i_rad, theta_o_rad, phi_rad), strict=True)
        ]
        total: Array = np.zeros(np.broadcast(*(share for _, share in cells)).shape)
        for corner in np.ndindex(2, 2, 2):
            weight: Array = np.ones(())
            index = []
            for (low, share), k, grid in zip(cells, corner, grids, strict=True):
                weight = weight * (share if k else 1.0 - share)
                index.append(np.minimum(low + k, grid.size - 1))
            total = total + weight * self.value[tuple(index)]
        return total

    def reflected_share(self, theta_i_rad: ArrayLike) -> Array:
        """Share (n,) of the light from some zenith angles that is reflected anywhere."""
        nodes, weights = np.polynomial.legendre.leggauss(STEPS)
        theta, dt = np.pi / 4 * (nodes + 1.0), np.pi / 4 * weights
        phi, dp = np.pi / 2 * (nodes + 1.0), np.pi * weights
        angle = np.asarray(theta_i_rad, float)[:, None, None]
        f = self.at(angle, theta[:, None], phi)
        return np.asarray(np.sum(f * (np.sin(theta) * np.cos(theta) * dt)[:, None] * dp, (1, 2)))


def brdf_table(
    theta_i_rad: ArrayLike,
    theta_o_rad: ArrayLike,
    phi_rad: ArrayLike,
    value: ArrayLike,
    field: str = FIELD,
) -> BrdfTable:
    """A checked table, averaged with its mirror image where both angle grids are one.

    Nature's BRDFs stay the same when Sun and observer change places; measured ones do so to their
    error. BadInput, naming `field`, where an axis does not rise or leaves its range, a value is
    negative or not finite, or more than 1.02 of the light would be reflected.
    """
    axes = [np.asarray(a, float) for a in (theta_i_rad, theta_o_rad, phi_rad)]
    table = np.array(value, float)
    for name, axis, top in zip(("theta_i", "theta_o", "phi"), axes, (90, 90, 180), strict=True):
        if not _rises(axis, np.deg2rad(top)):
            raise BadInput(f"{field}.{name}", "its angles", f"angles that rise from 0 to <= {top}")
    shape = tuple(a.size for a in axes)
    if table.shape != shape:
        raise BadInput(field, f"{table.shape} values", f"one for each direction: {shape}")
    if not (np.all(np.isfinite(table)) and table.min() >= 0.0):
        raise BadInput(field, "a negative or missing value", "BRDF values >= 0 [1/sr]")
    asymmetry = 0.0
    if np.array_equal(axes[0], axes[1]):
        asymmetry = reciprocity_error(table)
        table = 0.5 * (table + table.transpose(1, 0, 2))
    made = BrdfTable(axes[0], axes[1], axes[2], table, asymmetry)
    share = made.reflected_share(np.linspace(0.0, 1.5, 16)).max()
    if share > MOST_LIGHT:
        raise BadInput(field, f"a surface that reflects {share:.3g} of the light", "at most all")
    return made


def sun_rings(table: BrdfTable, radius_rad: float, fewest: int, most: int) -> int:
    """Rings of `sun_points`, `fewest` to `most`, that hold a table's peaks to 1%.

    None where the Sun's disc changes no peak by more. Peaks are the brightest Sun for each theta_o
    and phi; they count as shares of the brightest at that theta_o. As compared with as many rings
    as the table's steps ask for.
    """
    axes = (table.theta_i_rad, table.phi_rad)
    step = min(float(np.diff(axis).min(initial=np.pi)) for axis in axes)
    finest = min(max(fewest, math.ceil(RINGS_A_STEP * radius_rad / step)), most)
    rings = 0
    for k, theta_o in enumerate(table.theta_o_rad):
        lit = table.value[:, k] * np.cos(table.theta_i_rad)[:, None]
        peak = table.theta_i_rad[lit.argmax(axis=0)]
        unseen = UNSEEN * float(lit.max())
        light = partial(_light, table, theta_o, radius_rad)
        lost = np.abs(light(peak, table.phi_rad, fewest) - lit.max(axis=0))
        if lost.max() <= unseen:
            continue
        changed = np.argsort(lost)[-PEAKS:]
        some = peak[changed], table.phi_rad[changed]
        best = light(*some, finest)
        near = UNSEEN * float(best.max())
        while rings < finest and np.abs(light(*some, rings) - best).max() > near:
            rings = min(max(fewest, 2 * rings), finest)
        if rings == finest:
            break
    return rings


def _light(
    table: BrdfTable, theta_o_rad: float, radius_rad: float, theta_i: Array, phi: Array, rings: int
) -> Array:
    """BRDF (n.s) (n,) at angles theta_i and phi (n,) of the Sun's middle, mean over its disc."""
    across, up = np.sin(theta_i), np.cos(theta_i)
    normal = np.stack([across, 0.0 * across, up], axis=-1)
    along = np.stack([-up, 0.0 * across, across], axis=-1)
    side = np.cos(phi)[:, None] * along + np.sin(phi)[:, None] * np.array([0.0, 1.0, 0.0])
    observer = np.cos(theta_o_rad) * normal + np.sin(theta_o_rad) * side
    points = sun_points(np.array([0.0, 0.0, 1.0]), radius_rad, rings)[:, None]
    lit = np.maximum(np.sum(normal * points, axis=-1), 0.0)
    return np.asarray(np.mean(table(normal, points, observer) * lit, axis=0))


def _rises(axis: Array, top_rad: float) -> bool:
    """Whether angles are finite and rise from 0 to `top_rad` at most."""
    if axis.ndim != 1 or not axis.size or not np.all(np.isfinite(axis)):
        return False
    rising = np.all(np.diff(axis) > 0.0) and axis[0] == 0.0
    return bool(rising and axis[-1] <= top_rad + 1e-9)


def reciprocity_error(value: ArrayLike) -> float:
    """Greatest difference of a table (n, n, phi) from its mirror image, over its largest value."""
    table = np.asarray(value, float)
    return float(np.abs(table - table.transpose(1, 0, 2)).max() / max(table.max(), 1e-300))


def _cell(grid: Array, at: ArrayLike) -> tuple[NDArray[np.int64], Array]:
    """Which step of a grid a value lies in, and how far along it, 0 to 1."""
    x = np.clip(np.asarray(at, float), grid[0], grid[-1])
    low = np.clip(np.searchsorted(grid, x, side="right") - 1, 0, max(grid.size - 2, 0))
    high = np.minimum(low + 1, grid.size - 1)
    step = grid[high] - grid[low]
    return low, np.where(step > 0.0, (x - grid[low]) / np.where(step > 0.0, step, 1.0), 0.0)
