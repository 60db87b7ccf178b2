"""Gap times and custody from the times of detections: pure functions of arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GapTimes:
    """Of each of n objects [s]: median, 95th percentile and longest gap; first detection (NaN:
    none); mean time between detections (NaN: fewer than two); share of the period in custody.

    all_s : every gap of all objects, in their order; of : (g,) the object of each
    """

    median_s: Array
    p95_s: Array
    longest_s: Array
    first_s: Array
    revisit_s: Array
    custody: Array
    all_s: Array
    of: NDArray[np.int64]


def gap_times(
    object_: NDArray[np.int64], time_s: Array, count: int, period_s: float, custody_s: float
) -> GapTimes:
    """Gap times of `count` objects from the times (d,) at which they were detected.

    Gaps run from the start of the period to the first detection, between detections, and from the
    last one to the end: an object that is never detected has one, of the whole period. It is in
    custody for custody_s after each detection. Percentiles are those of numpy (linear). What a
    dwell detects that ends after the period counts at its end.
    """
    time_s = np.minimum(time_s, period_s)
    order = np.lexsort((time_s, object_))
    who = np.concatenate([np.arange(count), object_[order], np.arange(count)])
    when = np.concatenate([np.zeros(count), time_s[order], np.full(count, period_s)])
    kind = np.repeat([0, 1, 2], [count, len(order), count])
    by_object = np.lexsort((when, kind, who))
    who, when = who[by_object], when[by_object]
    same = who[1:] == who[:-1]
    gap, of = np.diff(when)[same], who[1:][same]
    counts = np.bincount(of, minlength=count)
    sorted_ = gap[np.lexsort((gap, of))]
    starts = np.cumsum(counts) - counts
    detections = counts - 1
    first = np.where(detections > 0, gap[starts], np.nan)
    held = np.bincount(of, np.minimum(gap, custody_s), count)
    held -= np.minimum(gap[starts], custody_s)  # before the first there is none
    last = gap[starts + counts - 1]
    several = detections > 1
    between = np.full(count, np.nan)
    between[several] = ((period_s - last - gap[starts]) / np.maximum(detections - 1, 1))[several]
    return GapTimes(
        _quantile(sorted_, starts, counts, 0.5),
        _quantile(sorted_, starts, counts, 0.95),
        sorted_[starts + counts - 1],
        first,
        between,
        np.where(detections > 0, held / period_s, 0.0),
        gap,
        of,
    )


def _quantile(
    sorted_: Array, starts: NDArray[np.int64], counts: NDArray[np.int64], share: float
) -> Array:
    """A quantile of each run of sorted values."""
    at = share * (counts - 1)
    low = np.floor(at).astype(np.int64)
    high = np.minimum(low + 1, counts - 1)
    return sorted_[starts + low] * (1.0 - (at - low)) + sorted_[starts + high] * (at - low)
