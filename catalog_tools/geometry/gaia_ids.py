"""Gaia's source_ids hold a place: which rows stand where theirs says, and what is wrong if few do.

`source_id >> 35` is the nested HEALPix pixel of order 12 (51 arcsec) of the place that the source
had when it got its identifier (Gaia DR2 documentation, section 10.2.1; DR3 likewise).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from .healpix import centres_of, pixels_of
from .sphere import directions, separation_rad

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

ID_ORDER = 12
ID_SHIFT = 35
LEAST_CHECKED = 1 << 45  # made-up numbers lie below, and 1024 of Gaia's 201 million pixels

# How far a source may stand from the place that its identifier tells. Identifiers come from the
# Initial Gaia Source List (positions at J2000.0) or from the first detection (2014 or later); the
# catalogue's positions are of 2015.5 (DR3: 2016.0). No known star moves faster than Barnard's,
# 10.4 arcsec/yr: 161 arcsec in 15.5 years, 166 in 16; its identifier is indeed that of its place
# of J2000. What is left of 180 arcsec, and a ring of neighbouring pixels, is for errors of the
# first position: of 22,000 real DR2 rows none stands more than 15 arcsec outside its pixel. DR2's
# documentation counts 1,972 sources more than 54 arcsec from their pixel's centre, "largely" by
# proper motion, and gives no upper limit: one whose first position was wrong by more than what
# is left here would be missed.
MOVED_DEG = 0.05
CORNER_DEG = 0.015  # the farthest corner of a pixel of ID_ORDER from its centre
MOST_LOOKED_AT = 1000  # rows by which a cause is guessed


def misplaced(source_id: Ints, ra_deg: Floats, dec_deg: Floats) -> Bools:
    """Which rows (n,) stand farther from the pixel of their source_id than any star has moved.

    Rows below LEAST_CHECKED, whose numbers are hardly Gaia's, are not looked at.
    """
    said = source_id >> ID_SHIFT
    wrong = (said != pixels_of(ID_ORDER, ra_deg, dec_deg)) & (source_id >= LEAST_CHECKED)
    doubtful = np.flatnonzero(wrong & (said < 12 << (2 * ID_ORDER)))
    if doubtful.size:
        centres = directions(*centres_of(ID_ORDER, said[doubtful]))
        apart = separation_rad(centres, directions(ra_deg[doubtful], dec_deg[doubtful]))
        wrong[doubtful] = apart > np.radians(MOVED_DEG + CORNER_DEG)
    return wrong


def refuse_most(where: str, rows: int, wrong: int, ids: Ints, ra: Floats, dec: Floats) -> None:
    """BadInput where most of a source's rows are misplaced, with a guess at the cause.

    rows, wrong : how many were compared, and misplaced; ids, ra, dec : (n,) of some of these.
    """
    if 2 * wrong <= rows:
        return
    guess = "the form's columns and units may not be those of the file"
    if _fit(ids, np.degrees(ra), np.degrees(dec)):
        guess = 'ra and dec are in radians: convert them, or say unit = "rad" in a column map'
    elif _fit(ids, dec, ra):
        guess = "ra and dec are exchanged"
    allowed = f"places in degrees that are those of Gaia's source_ids; {guess}"
    raise BadInput(where, f"{wrong} of {rows} rows elsewhere", allowed)


def _fit(source_id: Ints, ra_deg: Floats, dec_deg: Floats) -> bool:
    """Whether most places, where they are any, are those of their source_ids."""
    good = (np.abs(dec_deg) <= 90.0) & np.isfinite(ra_deg)
    wrong = misplaced(source_id[good], ra_deg[good], dec_deg[good])
    return bool(2 * np.count_nonzero(~wrong) > source_id.size)
