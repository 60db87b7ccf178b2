"""Charge of tracks in pixels: exact chords, straggling in each, diffusion, delta electrons.

Everything is computed in the frame's own coordinates and drawn by event and chord, so a pixel gets
the same bits whichever rectangle is asked for.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pipeline.physics.cosmic_rays.straggling import (
    BINDING_EV,
    DELTA_LEAST_EV,
    DELTA_MOST_EV,
    ELECTRON_EV,
    PAIR_EV,
    electron_range_um,
    landau,
    loss_ev,
    scale_ev,
)
from pipeline.physics.cosmic_rays.tracks import SIGMAS, Flux, Tracks
from pipeline.physics.noise.streams import philox, uniform

Array = NDArray[np.float64]

LEAST_SIGMA_PX = 1e-3  # less diffusion than this is none
DEPTH_STEPS = 8.0  # a diffusing track is cut into at least so many pieces over the depth
MOST_PROBABLE = -0.22278  # lambda at the peak of Landau's law


def reach_px(flux: Flux) -> float:
    """How far beside its line a track may leave charge."""
    far = electron_range_um(DELTA_MOST_EV) if flux.delta_electrons else 0.0
    return float(far / flux.pixel_pitch_um + flux.margin_px + 1.0)


def touching(
    tracks: Tracks, flux: Flux, y0: int, x0: int, rows: int, columns: int
) -> NDArray[np.bool_]:
    """Which tracks (n,) may leave charge in a rectangle of the frame (never wrongly no)."""
    pad = reach_px(flux)
    meets = np.minimum(tracks.x_back, tracks.x_front) < x0 + columns + pad
    meets &= np.maximum(tracks.x_back, tracks.x_front) > x0 - pad
    meets &= np.minimum(tracks.y_back, tracks.y_front) < y0 + rows + pad
    return meets & (np.maximum(tracks.y_back, tracks.y_front) > y0 - pad)


def add_tracks(
    image_e: Array | None,
    tracks: Tracks,
    flux: Flux,
    frame: int,
    key: tuple[int, int],
    place: tuple[int, int, int, int],
) -> Array:
    """Add the tracks' charge to an image in place; electrons (n,) of each track in the rectangle.

    place : (y0, x0, rows, columns) of the rectangle in the frame; image_e : (rows, columns), or
    None where only the sums are wanted.
    """
    around = np.flatnonzero(touching(tracks, flux, *place))
    t = tracks.taken(around)
    sums = np.zeros(len(t))
    shape = np.array([flux.pixel_pitch_um, flux.thickness_um, flux.diffusion_um, reach_px(flux)])
    _add(
        np.empty((0, 0)) if image_e is None else image_e,
        np.array(place),
        sums,
        frame,
        *key,
        t.event,
        np.stack([t.x_back, t.y_back, t.x_front, t.y_front], axis=1),
        t.path_um,
        t.charge_number,
        t.spread,
        shape,
        flux.delta_electrons,
    )
    found = np.zeros(len(tracks))
    found[around] = sums
    return found


@njit(cache=True, nogil=True)
def _add(
    image, place, sums, frame, k0, k1, event, ends, path_um, charge_number, spread, shape, deltas
):
    """All chords of all tracks, in their order."""
    pitch, thickness, diffusion, reach = shape
    shares = np.empty(int(2.0 * SIGMAS * diffusion / pitch) + 4)
    for n in range(event.size):
        x, y = ends[n, 0], ends[n, 1]
        dx, dy = ends[n, 2] - x, ends[n, 3] - y
        sx, sy = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        i, j = math.floor(x + 0.5), math.floor(y + 0.5)
        t, chord = 0.0, 0
        binding = spread[n] * math.sqrt(BINDING_EV * scale_ev(path_um[n], charge_number[n]))
        line = (x, y, dx, dy, thickness, pitch, diffusion / pitch)
        while t < 1.0:
            chord += 1
            tx = (i + 0.5 * sx - x) / dx if dx != 0.0 else 2.0
            ty = (j + 0.5 * sy - y) / dy if dy != 0.0 else 2.0
            stop = max(t, min(1.0, tx, ty))
            if _near(place, i, j, reach) and stop > t:
                xi = scale_ev((stop - t) * path_um[n], charge_number[n])
                a, b, c, d = philox(event[n], chord, frame, 0, k0, k1)
                loss = loss_ev(xi, landau(uniform(a, b), uniform(c, d)))
                hard = loss - loss_ev(xi, MOST_PROBABLE)
                if hard > DELTA_LEAST_EV:
                    loss -= hard if deltas else hard - DELTA_LEAST_EV
                loss = max(loss + binding * (stop - t), 0.0)
                sums[n] += _chord(image, place, shares, line, t, stop, i, j, loss / PAIR_EV)
                if hard > DELTA_LEAST_EV and deltas:
                    a, b, _, _ = philox(event[n], chord, frame, 1, k0, k1)
                    middle = 0.5 * (t + stop)
                    sums[n] += _delta(
                        image, place, shares, line, middle, min(hard, DELTA_MOST_EV), uniform(a, b)
                    )
            i += sx if tx <= stop else 0
            j += sy if ty <= stop else 0
            t = stop


@njit(cache=True, nogil=True)
def _near(place, i, j, reach):
    y0, x0, rows, columns = place
    return x0 - reach <= i <= x0 + columns + reach and y0 - reach <= j <= y0 + rows + reach


@njit(cache=True, nogil=True)
def _chord(image, place, shares, line, start, stop, i, j, charge):
    """Charge spread evenly over a chord of one pixel (i, j); electrons inside the rectangle."""
    x, y, dx, dy, _, _, diffusion = line
    if diffusion < LEAST_SIGMA_PX:
        return spread_point(image, place, shares, float(i), float(j), 0.0, charge)
    sigma = diffusion * math.sqrt(1.0 - 0.5 * (start + stop))
    flat = (stop - start) * math.hypot(dx, dy) / (0.5 * max(sigma, 0.1))
    steps = math.ceil(max((stop - start) * DEPTH_STEPS, flat))
    inside = 0.0
    for s in range(steps):
        t = start + (stop - start) * (s + 0.5) / steps
        sigma = diffusion * math.sqrt(1.0 - t)
        inside += spread_point(image, place, shares, x + t * dx, y + t * dy, sigma, charge / steps)
    return inside


@njit(cache=True, nogil=True)
def _delta(image, place, shares, line, t, energy_ev, turn):
    """A knocked-on electron: straight, losing energy evenly over its range; what leaves is lost.

    Its angle to the track: cos^2 = T / (T + 2 m c^2), for a heavy fast particle.
    """
    x, y, dx, dy, thickness, pitch, diffusion = line
    length = math.sqrt(dx * dx + dy * dy + (thickness / pitch) ** 2)
    ax, ay, az = dx / length, dy / length, thickness / pitch / length
    cosine = math.sqrt(energy_ev / (energy_ev + 2.0 * ELECTRON_EV))
    sine = math.sqrt(1.0 - cosine * cosine)
    c, s = sine * math.cos(2.0 * math.pi * turn), sine * math.sin(2.0 * math.pi * turn)
    flat = math.hypot(ax, ay)
    ux, uy = (ax / flat, ay / flat) if flat > 1e-9 else (1.0, 0.0)
    ex = cosine * ax + c * ux * az - s * uy  # axes: (ux az, uy az, -flat) and (-uy, ux, 0)
    ey = cosine * ay + c * uy * az + s * ux
    ez = cosine * az - c * flat
    depth = t * thickness / pitch
    whole = electron_range_um(energy_ev) / pitch
    room = thickness / pitch - depth if ez > 0.0 else depth
    path = min(whole, room / max(abs(ez), 1e-12))
    steps = math.ceil(4.0 * path) + 1
    inside, charge = 0.0, energy_ev / PAIR_EV * path / whole / steps
    for k in range(steps):
        r = path * (k + 0.5) / steps
        down = min(max((depth + r * ez) * pitch / thickness, 0.0), 1.0)
        sigma = diffusion * math.sqrt(1.0 - down)
        inside += spread_point(
            image, place, shares, x + t * dx + r * ex, y + t * dy + r * ey, sigma, charge
        )
    return inside


@njit(cache=True, nogil=True)
def spread_point(image, place, shares, x, y, sigma, charge):
    """Charge at a point, spread by a Gaussian over pixels; electrons inside the rectangle.

    The shares add up to one: what lies beyond 5 sigma goes to the outermost pixels.
    """
    y0, x0, rows, columns = place
    low_x, high_x = math.floor(x - SIGMAS * sigma + 0.5), math.floor(x + SIGMAS * sigma + 0.5)
    low_y, high_y = math.floor(y - SIGMAS * sigma + 0.5), math.floor(y + SIGMAS * sigma + 0.5)
    if low_x >= x0 + columns or high_x < x0 or low_y >= y0 + rows or high_y < y0:
        return 0.0
    _gaussian_shares(shares, x, sigma, low_x, high_x)
    inside, below = 0.0, 0.0
    for j in range(low_y, high_y + 1):
        above = 1.0 if j == high_y else _below(j + 0.5 - y, sigma)
        if y0 <= j < y0 + rows:
            for i in range(max(low_x, x0), min(high_x, x0 + columns - 1) + 1):
                part = charge * (above - below) * shares[i - low_x]
                inside += part
                if image.size:
                    image[j - y0, i - x0] += part
        below = above
    return inside


@njit(cache=True, nogil=True)
def _gaussian_shares(shares, x, sigma, low, high):
    """Share of a Gaussian in each pixel from low to high."""
    below = 0.0
    for i in range(low, high + 1):
        above = 1.0 if i == high else _below(i + 0.5 - x, sigma)
        shares[i - low] = above - below
        below = above


@njit(cache=True, nogil=True, inline="always")
def _below(distance, sigma):
    return 0.5 * math.erfc(-distance / (sigma * 1.4142135623730951))
