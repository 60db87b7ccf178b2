"""Times as they are stored: microseconds of UTC, as CF conventions count them."""

from __future__ import annotations

import erfa
import numpy as np
from numpy.typing import NDArray

UNITS = "microseconds since 1970-01-01T00:00:00"


def utc_microseconds(utc1: NDArray[np.float64], utc2: NDArray[np.float64]) -> NDArray[np.int64]:
    """Calendar UTC (two-part quasi-Julian dates, (n,)) as microseconds since 1970 without leap
    seconds; the 60th second of a minute is stored as its last microsecond."""
    years, months, days, clock, _ = erfa.ufunc.d2dtf(b"UTC", 6, utc1, utc2)
    out = np.empty(len(utc1), np.int64)
    for i in range(len(utc1)):
        day = np.datetime64(f"{years[i]:04d}-{months[i]:02d}-{days[i]:02d}", "us").astype(np.int64)
        h, m, s, f = (int(clock[i][n]) for n in ("h", "m", "s", "f"))
        second = min(s * 1_000_000 + f, 59_999_999)
        out[i] = day + (h * 3600 + m * 60) * 1_000_000 + second
    return out
