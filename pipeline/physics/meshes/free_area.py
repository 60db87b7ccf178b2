"""How much of a facet no polygon covers: exact lengths along lines, adaptive steps across them."""

from __future__ import annotations

import numpy as np
from numba import int64, njit

DEPTH = 24  # how often a slab is halved at most
FLOOR = 0.02  # of the tolerance: what a single piece may be off, however low it is
SMALL = 0.25  # of the tolerance: polygons of less area have no lines of their own
MOST_PIECES = 1000.0
UNEVEN = 0.2928932188134524  # of a piece's height: where it is looked at once more


@njit(cache=True, nogil=True)
def _crossing(work, k, y):
    """Where a line of constant y enters and leaves polygon k; an empty interval if it does not."""
    low, high = np.inf, -np.inf
    last = work.size[k] - 1
    for i in range(last + 1):
        j = i + 1 if i < last else 0
        yi, yj = work.y[k, i], work.y[k, j]
        if (yi <= y) != (yj <= y):
            x = work.x[k, i] + (y - yi) / (yj - yi) * (work.x[k, j] - work.x[k, i])
            low, high = min(low, x), max(high, x)
    return low, high


@njit(cache=True, nogil=True)
def free_spans(work, near, y):
    """Pieces of a line across the facet that no polygon covers: into begin, end; their number.

    near : how many rows of work.near hold polygons that the line may cross; they are put in the
        order in which it enters them, so that the next line, which is close, finds them sorted
    """
    begin, end, rows = work.begin, work.end, work.near
    a, b = _crossing(work, int64(0), y)
    if not a < b:
        return 0
    count = 0
    for n in range(near):
        k = rows[n]
        if work.low[k] <= y < work.high[k]:
            p, q = _crossing(work, k, y)
            p, q = max(p, a), min(q, b)
            if p < q:
                if p == a and q == b:
                    rows[n], rows[0] = rows[0], k
                    return 0
                rows[n] = rows[count]
                i = count  # insertion by rising start
                while i > 0 and begin[i - 1] > p:
                    begin[i], end[i], rows[i] = begin[i - 1], end[i - 1], rows[i - 1]
                    i -= 1
                begin[i], end[i], rows[i] = p, q, k
                count += 1
    free, reach = 0, a
    for i in range(count):
        p, q = begin[i], end[i]
        if p > reach:
            begin[free], end[free] = reach, p  # free <= i: what is overwritten has been read
            free += 1
        reach = max(reach, q)
    if reach < b:
        begin[free], end[free] = reach, b
        free += 1
    return free


@njit(cache=True, nogil=True)
def _free_length(work, near, y):
    total = 0.0
    for i in range(free_spans(work, near, y)):
        total += work.end[i] - work.begin[i]
    return total


@njit(cache=True, nogil=True)
def _rectangle(work, k):
    """Area of the rectangle about polygon k, cut to that about the facet."""
    low, high, left, right = np.inf, -np.inf, np.inf, -np.inf
    for i in range(work.size[k]):
        low, high = min(low, work.x[k, i]), max(high, work.x[k, i])
    for i in range(3):
        left, right = min(left, work.x[0, i]), max(right, work.x[0, i])
    wide = min(high, right) - max(low, left)
    tall = min(work.high[k], work.high[0]) - max(work.low[k], work.low[0])
    return max(wide, 0.0) * max(tall, 0.0)


@njit(cache=True, nogil=True)
def _sort(values, carried, count):
    """Shell's sort of `count` values in place; what is carried goes along.

    It compiles in a tenth of the time of numba's quicksort, and is as quick for some hundred.
    """
    gap = 1
    while gap < count:
        gap = 3 * gap + 1
    while gap > 1:
        gap //= 3
        for i in range(gap, count):
            value, load, j = values[i], carried[i], i
            while j >= gap and values[j - gap] > value:
                values[j], carried[j] = values[j - gap], carried[j - gap]
                j -= gap
            values[j], carried[j] = value, load


@njit(cache=True, nogil=True)
def _steps(work, found, least, smallest):
    """Heights y at which the free length may jump or bend, at least `least` apart.

    Corners of polygons below an area `smallest` are left to the halving of pieces, which may
    overlook them: the second value returned is the area of all such polygons.
    """
    bottom, top = work.low[0], work.high[0]
    marks = np.empty(4 * found + 5)
    count, overlooked = 0, 0.0
    for k in range(found + 1):
        if k > 0:
            area = _rectangle(work, k)
            if area <= smallest:
                overlooked += area
                continue
        for i in range(work.size[k]):
            if bottom < work.y[k, i] < top:
                marks[count] = work.y[k, i]
                count += 1
    marks[count] = top
    _sort(marks, np.empty(count + 1, np.int64), count + 1)
    steps = np.empty(count + 2)
    steps[0], kept = bottom, 1
    for i in range(count):
        if marks[i] - steps[kept - 1] >= least and top - marks[i] >= least:
            steps[kept] = marks[i]
            kept += 1
    steps[kept] = top
    return steps[: kept + 1], overlooked


@njit(cache=True, nogil=True)
def _slab(work, near, low, step, share, floor):
    """Free area between two marks, and how far it may be off: at most share x height, or floor.

    The length is straight over a piece if the middle's is the mean of the ends', and that at one
    uneven place is what the ends say (two bends may hide from the middle). A bend or jump moves the
    area of the two halves by at most half of what it moves the middle, times the height.
    """
    stack, levels = work.stack, work.levels
    area, error = 0.0, 0.0
    inside = 1e-9 * step
    stack[0, 0], stack[0, 1] = low, step
    stack[0, 2] = _free_length(work, near, low + inside)
    stack[0, 3] = _free_length(work, near, low + step - inside)
    stack[0, 4] = _free_length(work, near, low + 0.5 * step)
    levels[0], many = 0, 1
    while many > 0:
        many -= 1
        y, h, level = stack[many, 0], stack[many, 1], levels[many]
        begin, end, middle = stack[many, 2], stack[many, 3], stack[many, 4]
        off = abs(begin + end - 2.0 * middle) * 0.25 * h
        enough = max(share * h, floor)
        if off <= enough:
            uneven = _free_length(work, near, y + UNEVEN * h)
            bent = abs(uneven - begin - UNEVEN * (end - begin)) * 0.5 * h
            off = max(off, bent)
        if off <= enough or level >= DEPTH:
            area += 0.25 * (begin + end + 2.0 * middle) * h
            error += off
            continue
        for i in range(2):
            at = y + 0.5 * h * i
            stack[many, 0], stack[many, 1] = at, 0.5 * h
            stack[many, 2] = begin if i == 0 else middle
            stack[many, 3] = middle if i == 0 else end
            stack[many, 4] = _free_length(work, near, at + 0.25 * h)
            levels[many] = level + 1
            many += 1
    return area, error


@njit(cache=True, nogil=True)
def free_area(work, found, tolerance):
    """Area of the facet in row 0 that none of `found` polygons covers, and a bound on its error.

    Between the corners' heights the free length is straight but where edges cross: slabs between
    them are halved until what they may be off is below `tolerance` (an area) in proportion to their
    height. No piece is taller than the square root of what the tolerance is of the area, so that
    no gap between covers is overlooked that matters. Corners closer than tolerance / (4 width), and
    those of polygons smaller than a quarter of the tolerance, share a slab.
    """
    bottom, top = work.low[0], work.high[0]
    width = max(work.x[0, 0], work.x[0, 1], work.x[0, 2])
    width -= min(work.x[0, 0], work.x[0, 1], work.x[0, 2])
    if not (top > bottom and width > 0.0):
        return 0.0, 0.0
    least = min(0.25 * tolerance / width, 0.51 * (top - bottom))
    steps, overlooked = _steps(work, found, least, SMALL * tolerance)
    order = np.arange(1, found + 1)
    _sort(work.low[1 : found + 1].copy(), order, found)
    area, error, near, waiting = 0.0, 0.0, 0, 0
    share = tolerance / (top - bottom)
    # a gap that opens and closes between the lines looked at is a triangle of less than tolerance
    whole = 0.5 * width * (top - bottom)
    tallest = (top - bottom) / min(max(np.sqrt(whole / tolerance), 1.0), MOST_PIECES)
    for m in range(steps.size - 1):
        kept = 0
        for n in range(near):
            if work.high[work.near[n]] > steps[m]:
                work.near[kept] = work.near[n]
                kept += 1
        near = kept
        while waiting < found and work.low[order[waiting]] < steps[m + 1]:
            work.near[near] = order[waiting]
            waiting += 1
            near += 1
        pieces = int(np.ceil((steps[m + 1] - steps[m]) / tallest))
        step = (steps[m + 1] - steps[m]) / pieces
        for p in range(pieces):
            low = steps[m] + p * step
            more, off = _slab(work, near, low, step, share, FLOOR * tolerance)
            area += more
            error += off
    return area, error + min(overlooked, tolerance)
