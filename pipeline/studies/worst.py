"""The worst of several errors: one that is no number is worse than any."""

from __future__ import annotations

import numpy as np


def worst_of(*errors: float) -> float:
    """The largest of some errors; NaN where one is, which Python's own `max` passes over."""
    return float(np.max(errors))
