"""Diffuse galactic light: starlight scattered by the dust between the stars."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RELATIVE_ERROR = 0.5  # of the law below, outside of single clouds


def diffuse_light(all_starlight: Array, share: float) -> Array:
    """Scattered light (n,) from the light of all stars (n,), drawn or not, in any unit.

    It is `share` of the sum of both: 0.2 to 0.3 in the visible (Leinert et al. 1998, A&AS 127, 1,
    section 11), with 0.25 about 7 S10 at the galactic poles and 100 at the equator. It is given the
    stars' own colour; it is really bluer, its clouds are sharper than the stars' map, and the
    law is good to 50% at best.
    """
    return all_starlight * (share / (1.0 - share))
