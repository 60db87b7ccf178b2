"""Round point-spread functions: looked up from a radial table; Hankel transforms of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import lru_cache
from typing import Protocol

import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mtf = Callable[[Array], Array]

NODES = 32768  # of a radial table: it then errs by less than 1e-6 (tests)
TABLE_FLOOR = 1e-13  # where a radial table ends
LIGHT_RADII = 120
NEAREST, FARTHEST = 0.02, 600.0  # radii of the table of light beyond, in scales
_X, _W = np.polynomial.legendre.leggauss(10)


class HasRadial(Protocol):
    """Optics whose round part is known along a radius."""

    def radial(self, f: Array) -> Array: ...

    def band_limit(self, floor: float) -> float: ...

    def __hash__(self) -> int: ...


class Radial(ABC):
    """A round blur given by `radial`, its transfer function along a radius (falling, 1 at 0).

    Subclasses are frozen dataclasses of plain numbers; what is computed from them is cached.
    """

    @abstractmethod
    def radial(self, f: Array) -> Array:
        """The transfer function at frequencies f (n,) >= 0 [cycles/px]."""

    @property
    @abstractmethod
    def scale_px(self) -> float:
        """Its full width at half maximum, roughly [px]."""

    def transfer(self, fy: Array, fx: Array) -> Array:
        """The transfer function at (fy, fx), any shapes that broadcast, from a table of radii."""
        fy, fx = np.broadcast_arrays(np.asarray(fy, float), np.asarray(fx, float))
        top, values = radial_table(self)
        return look_up(np.hypot(fy, fx).ravel(), top, values).reshape(fy.shape)

    def band_limit(self, floor: float) -> float:
        """Frequency [cycles/px] beyond which the transfer function is below `floor`."""
        return _band_limit(self, floor)

    def light_beyond(self, radius_px: float) -> float:
        """Fraction of all light farther than `radius_px`, from the transfer function.

        Within 1e-4 of itself up to 600 scales; beyond, its last power law goes on.
        """
        return _light_table(self)(radius_px)

    @property
    def has_wings(self) -> bool:
        return self.light_beyond(24.0 * self.scale_px) > 1e-8

    @property
    def core_px(self) -> float:
        """Four widths: the wings of smooth seeing are already far below the peak there."""
        return 4.0 * max(self.scale_px, 1.5)

    def wing_fall(self, radius_px: float) -> float:  # noqa: ARG002 - the same at all radii
        return 4.0


@lru_cache(maxsize=256)
def _band_limit(optics: Radial, floor: float) -> float:
    return falling_to(optics.radial, floor, 1.0 / optics.scale_px)


def falling_to(mtf: Mtf, floor: float, start: float) -> float:
    """Frequency where a falling transfer function reaches `floor`, by doubling and halving."""
    low, high = 0.0, start
    while float(mtf(np.array([high]))[0]) > floor:
        low, high = high, 2.0 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if float(mtf(np.array([middle]))[0]) > floor else (low, middle)
    return high


@lru_cache(maxsize=32)
def radial_table(optics: HasRadial) -> tuple[float, Array]:
    """(top, values): the transfer function at f = top (i / NODES)^2, i = 0 ... NODES."""
    top = optics.band_limit(TABLE_FLOOR)
    values = optics.radial(top * (np.arange(NODES + 1) / NODES) ** 2)
    values.setflags(write=False)
    return top, values


@njit(cache=True, nogil=True)
def look_up(f, top, values):
    """Cubic interpolation between the nodes of a radial table; 0 beyond `top`."""
    n = values.size - 1
    out = np.empty(f.size)
    for k in range(f.size):
        if f[k] >= top:
            out[k] = 0.0
            continue
        t = n * np.sqrt(f[k] / top)
        i = min(max(int(t), 1), n - 2)
        u = t - i
        a, b, c = u + 1.0, u - 1.0, u - 2.0
        out[k] = (
            -u * b * c / 6.0 * values[i - 1]
            + a * b * c / 2.0 * values[i]
            - a * u * c / 2.0 * values[i + 1]
            + a * u * b / 6.0 * values[i + 2]
        )
    return out


def light_beyond(mtf: Mtf, top: float, radius_px: float) -> float:
    """Light outside a radius of a round blur: J0(2 pi F r) + 2 pi r int (1 - M) J1(2 pi f r) df.

    mtf : transfer function along a radius (of an uneven blur: its mean over directions); top : F,
    where it ends. Gauss-Legendre in panels of a quarter wave: absolute error below 1e-9.
    """
    f, weight = _panels(top, radius_px)
    turn = 2.0 * np.pi * radius_px * f
    rings = weight * (1.0 - mtf(f)) * scipy.special.j1(turn)
    inner = float(np.sum(rings))  # a BLAS may reorder its sum
    return float(scipy.special.j0(2.0 * np.pi * top * radius_px)) + 2.0 * np.pi * radius_px * inner


def intensity(mtf: Mtf, top: float, r_px: Array) -> Array:
    """Light per px^2 at radii r_px (n,) of a round blur, per unit light: its Hankel transform."""
    out = np.empty(np.size(r_px))
    for i, r in enumerate(np.ravel(r_px)):
        f, weight = _panels(top, float(r))
        out[i] = np.sum(weight * 2.0 * np.pi * f * mtf(f) * scipy.special.j0(2.0 * np.pi * r * f))
    return out.reshape(np.shape(r_px))


def mean_over_directions(
    transfer: Callable[[Array, Array], NDArray[np.float64] | NDArray[np.complex128]],
    directions: int = 90,
) -> Mtf:
    """The mean over directions of a transfer function: what the light in rings depends on."""
    angle = np.pi * (np.arange(directions) + 0.5) / directions

    def mtf(f: Array) -> Array:
        fy, fx = np.outer(f, np.sin(angle)), np.outer(f, np.cos(angle))
        return np.asarray(transfer(fy, fx)).real.mean(axis=1)

    return mtf


def _panels(top: float, radius_px: float) -> tuple[Array, Array]:
    """Quadrature nodes and weights on 0 ... top, finer towards 0, a quarter wave at most."""
    width = min(top / 64.0, 0.25 / max(radius_px, 1e-9))
    near = width * 0.5 ** np.arange(12, 0, -1)
    edges = np.concatenate([[0.0], near, np.linspace(width, top, int(np.ceil(top / width)))])
    half = 0.5 * np.diff(edges)[:, None]
    f = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * _X
    return f.ravel(), (half * _W).ravel()


@lru_cache(maxsize=1024)  # small, and asked for in turn for all wavelengths of a field's bands
def _light_table(optics: Radial) -> Callable[[float], float]:
    top, values = radial_table(optics)
    return light_table(lambda f: look_up(f, top, values), top, optics.scale_px, FARTHEST)


def light_table(mtf: Mtf, top: float, scale_px: float, farthest: float) -> Callable[[float], float]:
    """Light beyond a radius as a function, monotone, from radii in equal ratios.

    farthest : last radius in units of `scale_px`; beyond, the last power law goes on.
    """
    radii = scale_px * np.geomspace(NEAREST, farthest, LIGHT_RADII)
    light = np.array([light_beyond(mtf, top, r) for r in radii])
    light = np.minimum.accumulate(np.clip(light, 1e-12, 1.0))
    curve = scipy.interpolate.PchipInterpolator(np.log(radii), np.log(light))
    ratio = np.log(light[-1] / light[-6]) / np.log(radii[-1] / radii[-6])
    slope = float(min(ratio, -1.0))  # no blur with a falling transfer function falls slower

    def beyond(radius_px: float) -> float:
        if radius_px <= radii[0]:
            return 1.0
        if radius_px >= radii[-1]:
            return float(light[-1] * (radius_px / radii[-1]) ** slope)
        return float(np.exp(curve(np.log(radius_px))))

    return beyond
