"""Tracks of cosmic rays through the silicon of a frame: how many, at which angles, where.

Directions follow the flux through a plane, cos^(n+1) of the angle to its normal: n = 0 for an
isotropic flux (mean path 2T in a slab of thickness T), 2 for muons on the ground under a detector
that faces the zenith. Paths end at the frame's diagonal (the second moment would diverge).
Only tracks whose bounding box meets the frame are drawn, and all of those, also such as enter
beside it: their number is Poisson with the mean area of places where a track may enter.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.noise.streams import normal_quantile, philox, poisson, uniform

Array = NDArray[np.float64]

COUNT_PLACE = 0xFFFFFFFF  # the stream's place of the number of events; no event has this index
SIGMAS = 5.0  # charge diffuses no farther than this
UM2_PER_CM2 = 1e8


@dataclass(frozen=True)
class Flux:
    """Cosmic rays on one frame of one detector.

    rows, columns, pixel_pitch_um : the frame; thickness_um : of the silicon that collects charge
    rate_per_cm2_s : crossings of a square centimetre of the detector; integration_s : exposure
    zenith_power : flux goes as this power of the cosine; helium_share : of all events
    diffusion_um : rms per axis of charge from the far side; at a distance z from the electrodes it
        is diffusion_um sqrt(z / T) (drift in a uniform field)
    delta_electrons : electrons above 30 keV make tracks; else their energy is cut off there
    """

    rows: int
    columns: int
    pixel_pitch_um: float
    thickness_um: float
    rate_per_cm2_s: float
    integration_s: float
    zenith_power: float = 0.0
    helium_share: float = 0.0
    diffusion_um: float = 3.0
    delta_electrons: bool = True

    @property
    def margin_px(self) -> float:
        """How far beside a track its own diffused charge reaches."""
        return SIGMAS * self.diffusion_um / self.pixel_pitch_um

    @property
    def longest_um(self) -> float:
        """The cap of paths: the frame's diagonal, at least 20 thicknesses."""
        diagonal = self.pixel_pitch_um * float(np.hypot(self.rows, self.columns))
        return max(diagonal, 20.0 * self.thickness_um)


@dataclass(frozen=True)
class Tracks:
    """Tracks of one frame, (n,) each, in the order of their index.

    event : index in the frame; x_back, y_back, x_front, y_front : where the line meets the faces
    far from and near to the electrodes [px]; path_um : between them; charge_number : 1 or 2
    enters_back : whether the particle came in there; spread : standard normal draw of its binding
    """

    event: NDArray[np.int64]
    x_back: Array
    y_back: Array
    x_front: Array
    y_front: Array
    path_um: Array
    charge_number: Array
    enters_back: NDArray[np.bool_]
    spread: Array

    def __len__(self) -> int:
        return len(self.event)

    def taken(self, which: NDArray) -> Tracks:
        """Some of them."""
        return Tracks(**{name: value[which] for name, value in vars(self).items()})


@lru_cache(maxsize=32)
def angle_table(flux: Flux) -> tuple[Array, Array, float]:
    """Distribution function over v = cos^(n+2), v itself (m,), and the mean entrance area [px2].

    A track of in-plane length t at azimuth phi can enter on (rows + t |sin phi|) times
    (columns + t |cos phi|) pixels, so long tracks are as much more frequent; v alone is uniform.
    """
    power = flux.zenith_power + 2.0
    least = (flux.thickness_um / flux.longest_um) ** power
    v = np.geomspace(least, 1.0, 20_001)
    t = _in_plane_px(flux, v)
    rows, columns = flux.rows + 2.0 * flux.margin_px, flux.columns + 2.0 * flux.margin_px
    area = rows * columns + (rows + columns) * (2.0 / np.pi) * t + t * t / np.pi
    steps = 0.5 * (area[1:] + area[:-1]) * np.diff(v)
    sums = np.concatenate([[0.0], np.cumsum(steps)])
    return sums / sums[-1], v, float(sums[-1] / (1.0 - least))


def _in_plane_px(flux: Flux, v: Array) -> Array:
    """Length of a track's shadow on the frame, from v = cos^(n+2)."""
    cosine = np.minimum(v ** (1.0 / (flux.zenith_power + 2.0)), 1.0)
    return flux.thickness_um / flux.pixel_pitch_um * np.sqrt(1.0 - cosine**2) / cosine


def mean_count(flux: Flux) -> float:
    """Expected number of tracks whose bounding box meets the frame."""
    area_cm2 = angle_table(flux)[2] * flux.pixel_pitch_um**2 / UM2_PER_CM2
    return flux.rate_per_cm2_s * area_cm2 * flux.integration_s


@lru_cache(maxsize=2)
def draw_tracks(flux: Flux, frame: int, key: tuple[int, int]) -> Tracks:
    """The tracks of a frame, from its stream alone: the same for every tile (and kept for it)."""
    k0, k1 = key
    count = int(poisson(mean_count(flux), COUNT_PLACE, COUNT_PLACE, frame, k0, k1))
    u = _uniforms(count, frame, k0, k1)
    share, v, _ = angle_table(flux)
    v_drawn = np.interp(u[0], share, v)
    t = _in_plane_px(flux, v_drawn)
    rows, columns = flux.rows + 2.0 * flux.margin_px, flux.columns + 2.0 * flux.margin_px
    dx, dy = _azimuths(t, rows, columns, u[1], u[2])
    x = -0.5 - flux.margin_px - np.maximum(dx, 0.0) + u[4] * (columns + np.abs(dx))
    y = -0.5 - flux.margin_px - np.maximum(dy, 0.0) + u[5] * (rows + np.abs(dy))
    path = flux.pixel_pitch_um * np.hypot(t, flux.thickness_um / flux.pixel_pitch_um)
    helium = u[3] < flux.helium_share
    both_sides = flux.zenith_power == 0.0
    return Tracks(
        np.arange(count),
        x,
        y,
        x + dx,
        y + dy,
        path,
        np.where(helium, 2.0, 1.0),
        (u[7] < 0.5) | (not both_sides),
        _normals(u[6]),
    )


def _azimuths(
    t: Array, rows: float, columns: float, u: Array, choice: Array
) -> tuple[Array, Array]:
    """In-plane vectors of length t whose azimuth has the density of the entrance area.

    The area is a sum of four terms in |cos| and |sin|; one is chosen by its weight, and each has an
    inverse in closed form. `choice` first chooses the term, then what is left of it the quadrant.
    """
    weights = np.array(
        [
            np.full_like(t, rows * columns),
            rows * t * 2 / np.pi,
            columns * t * 2 / np.pi,
            t * t / np.pi,
        ]
    )
    sums = np.cumsum(weights, axis=0) / weights.sum(axis=0)
    term = (choice > sums[:3]).sum(axis=0)
    low = np.where(term > 0, np.take_along_axis(sums, np.maximum(term - 1, 0)[None], 0)[0], 0.0)
    high = np.take_along_axis(sums, term[None], 0)[0]
    left = np.clip((choice - low) / (high - low), 0.0, np.nextafter(1.0, 0.0))
    sine = np.choose(term, [np.sin(0.5 * np.pi * u), u, np.sqrt(1.0 - u * u), np.sqrt(u)])
    cosine = np.sqrt(np.maximum(1.0 - sine * sine, 0.0))
    quadrant = np.floor(4.0 * left).astype(np.int64)
    dx = t * cosine * np.where(quadrant & 1, -1.0, 1.0)
    return dx, t * sine * np.where(quadrant & 2, -1.0, 1.0)


@njit(cache=True, nogil=True)
def _uniforms(count, frame, k0, k1):
    """(8, count) uniforms of the events of a frame."""
    out = np.empty((8, count))
    for event in range(count):
        for draw in range(4):
            a, b, c, d = philox(event, 0, frame, draw, k0, k1)
            out[2 * draw, event] = uniform(a, b)
            out[2 * draw + 1, event] = uniform(c, d)
    return out


@njit(cache=True, nogil=True)
def _normals(u):
    """Standard normals (n,) of uniforms (n,)."""
    out = np.empty_like(u)
    for i in range(u.size):
        out[i] = normal_quantile(u[i])
    return out
