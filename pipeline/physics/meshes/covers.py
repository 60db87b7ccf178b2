"""What stands before a facet, towards the Sun or the observer, as polygons in the observer's plane.

An occluder is cut at the facet's own plane, and what lies above it is laid onto that plane along
the direction of the Sun or the observer: what it covers there is hidden or dark, exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

CORNERS = 4  # of a triangle cut by a plane, at most
STACK = 64  # pieces that wait: one for each level of halving, and some


class CoverBuffers(NamedTuple):
    """Room for a facet (row 0) and the convex polygons that cover it (rows 1 ...).

    x, y : (n, 4) corners; size : (n,) how many; low, high : (n,) range of y
    seen : (F,) the last look at which a facet was met; near : (n,) rows that a line may cross
    begin, end : (n + 1,) pieces of a line
    stack, levels : (STACK, 5), (STACK,) pieces of slabs that wait
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    size: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    seen: NDArray[np.int64]
    near: NDArray[np.int64]
    begin: NDArray[np.float64]
    end: NDArray[np.float64]
    stack: NDArray[np.float64]
    levels: NDArray[np.int64]


def room_for(facets):
    """Buffers for a mesh of so many facets: each may cover another one twice."""
    n = 2 * facets + 2
    return CoverBuffers(
        np.empty((n, CORNERS)),
        np.empty((n, CORNERS)),
        np.empty(n, np.int64),
        np.empty(n),
        np.empty(n),
        np.full(facets, -1, np.int64),
        np.empty(n, np.int64),
        np.empty(n + 1),
        np.empty(n + 1),
        np.empty((STACK, 5)),
        np.empty(STACK, np.int64),
    )


@njit(cache=True, nogil=True)
def _turn(work, a):
    """1 for a polygon that runs counterclockwise, else -1."""
    x, y, area = work.x, work.y, 0.0
    for i in range(1, work.size[a] - 1):
        area += (x[a, i] - x[a, 0]) * (y[a, i + 1] - y[a, 0])
        area -= (x[a, i + 1] - x[a, 0]) * (y[a, i] - y[a, 0])
    return 1.0 if area >= 0.0 else -1.0


@njit(cache=True, nogil=True)
def apart(work, a, b, room):
    """True where an edge of polygon a has all of polygon b outside, to `room`."""
    x, y, sign = work.x, work.y, _turn(work, a)
    for i in range(work.size[a]):
        j = i + 1 if i + 1 < work.size[a] else 0
        ex, ey = sign * (x[a, j] - x[a, i]), sign * (y[a, j] - y[a, i])
        slack = room * np.sqrt(ex * ex + ey * ey)
        if slack <= room * room:
            continue
        outside = True
        for k in range(work.size[b]):
            if ex * (y[b, k] - y[a, i]) - ey * (x[b, k] - x[a, i]) > slack:
                outside = False
                break
        if outside:
            return True
    return False


@njit(cache=True, nogil=True)
def holds(work, a, b, room):
    """True where polygon a holds all corners of polygon b, to `room`."""
    x, y, sign = work.x, work.y, _turn(work, a)
    for i in range(work.size[a]):
        j = i + 1 if i + 1 < work.size[a] else 0
        ex, ey = sign * (x[a, j] - x[a, i]), sign * (y[a, j] - y[a, i])
        slack = -room * np.sqrt(ex * ex + ey * ey)
        for k in range(work.size[b]):
            if ex * (y[b, k] - y[a, i]) - ey * (x[b, k] - x[a, i]) < slack:
                return False
    return True


@njit(cache=True, nogil=True)
def lay_down(flat_m, j, height, shift, floor, work, row):
    """Part of triangle j above a plane, laid onto it: into a row of work.

    height : (3,) of its corners above the plane; what is below `floor` is cut off
    shift : (2,) step in the observer's plane for each metre that a point is let down
    """
    count = 0
    for i in range(3):
        k = i + 1 if i < 2 else 0
        hi, hk = height[i] - floor, height[k] - floor
        if hi > 0.0:
            work.x[row, count] = flat_m[j, i, 0] - height[i] * shift[0]
            work.y[row, count] = flat_m[j, i, 1] - height[i] * shift[1]
            count += 1
        if (hi > 0.0) != (hk > 0.0):
            t = hi / (hi - hk)
            h = height[i] + t * (height[k] - height[i])
            x = flat_m[j, i, 0] + t * (flat_m[j, k, 0] - flat_m[j, i, 0])
            y = flat_m[j, i, 1] + t * (flat_m[j, k, 1] - flat_m[j, i, 1])
            work.x[row, count] = x - h * shift[0]
            work.y[row, count] = y - h * shift[1]
            count += 1
    work.size[row] = count


@njit(cache=True, nogil=True)
def covers(f, view, bins, tilt, shift, room, stamp, work, found):
    """Polygons that cover facet f from one direction, put behind `found` others.

    view : FacetBins of the observer; bins : those of the direction (the observer's or the Sun's)
    tilt : (3,) normal, in the axes of view, of the side of f that is looked at
    shift : as in `lay_down`; stamp : a number of its own for each look
    Returns how many polygons there are now, or -1 where one of them covers all of the facet.
    Of facets in one plane that overlap, the first one counts.
    """
    flat, low, high = view.flat_m, bins.low, bins.high
    height = np.empty(3)
    me = int64(0)  # its row; typed, for a literal would compile the callees once more
    level_me = tilt[0] * flat[f, 0, 0] + tilt[1] * flat[f, 0, 1] + tilt[2] * flat[f, 0, 2]
    x_low, x_high = low[f, 0] + room, high[f, 0] - room
    y_low, y_high = low[f, 1] + room, high[f, 1] - room
    c0, c1 = int((low[f, 0] - bins.x0) / bins.side_m), int((high[f, 0] - bins.x0) / bins.side_m)
    r0, r1 = int((low[f, 1] - bins.y0) / bins.side_m), int((high[f, 1] - bins.y0) / bins.side_m)
    for r in range(r0, r1 + 1):
        for k in range(r * bins.columns + c0, r * bins.columns + c1 + 1):
            for e in range(bins.first[k], bins.first[k + 1]):
                j = bins.facet[e]
                if work.seen[j] == stamp or j == f:
                    continue
                work.seen[j] = stamp
                if high[j, 2] <= low[f, 2] - room or low[j, 0] >= x_high or high[j, 0] <= x_low:
                    continue
                if low[j, 1] >= y_high or high[j, 1] <= y_low:
                    continue
                for i in range(3):
                    height[i] = tilt[0] * flat[j, i, 0] + tilt[1] * flat[j, i, 1]
                    height[i] += tilt[2] * flat[j, i, 2] - level_me
                floor = room
                if max(height[0], height[1], height[2]) <= room:
                    if j > f or min(height[0], height[1], height[2]) < -room:
                        continue
                    floor = -2.0 * room
                row = found + 1
                lay_down(flat, j, height, shift, floor, work, row)
                if work.size[row] < 3 or apart(work, me, row, room) or apart(work, row, me, room):
                    continue
                if holds(work, row, me, room):
                    return -1
                found += 1
    return found


@njit(cache=True, nogil=True)
def covered(f, view, light, sign, normal, sun, axes, room, work):
    """Polygons over facet f from both directions; -1 where nothing of it is lit and seen.

    view, light : Bins of observer and Sun; sign, normal : (F,), (F, 3) the side looked at
    sun, axes : (3,) and (3, 3) directions in the mesh's frame; room : of heights, m
    """
    tilt, here = np.zeros(3), np.zeros(3)
    for a in range(3):
        for b in range(3):
            tilt[a] += sign[f] * axes[a, b] * normal[f, b]
            here[a] += axes[a, b] * sun[b]
    for i in range(3):
        work.x[0, i], work.y[0, i] = view.flat_m[f, i, 0], view.flat_m[f, i, 1]
    work.size[0] = 3
    shift = np.zeros(2)
    found = covers(f, view, view, tilt, shift, room, 2 * f, work, int64(0))
    if found >= 0:
        up = tilt[0] * here[0] + tilt[1] * here[1] + tilt[2] * here[2]
        shift[0], shift[1] = here[0] / up, here[1] / up
        found = covers(f, view, light, tilt, shift, room, 2 * f + 1, work, found)
    for k in range(found + 1):
        low, high = work.y[k, 0], work.y[k, 0]
        for i in range(1, work.size[k]):
            low, high = min(low, work.y[k, i]), max(high, work.y[k, i])
        work.low[k], work.high[k] = low, high
    return found
