"""The Sun and 29 stars as means in boxes of wavelength: the tables beside this module."""

import csv
from pathlib import Path
from typing import NamedTuple


class Boxes(NamedTuple):
    """A table's (n + 1,) borders of boxes in nm, and its columns of n values by heading."""

    edges_nm: tuple[float, ...]
    columns: dict[str, tuple[float, ...]]


def sun() -> Boxes:
    """The Sun outside the atmosphere at 1 au: mean spectral irradiance in boxes of 5 to 100 nm.

    Means over each box of ASTM E490-00a (2014), table 3 (American Society for Testing and
    Materials, West Conshohocken, PA), worked out here from that standard, rounded to 0.1 mW/m2/nm.
    The standard integrates to 1366.1 W/m2, 0.4% above the nominal 1361 W/m2 (IAU 2015 B3); the
    figures keep its scale.
    """
    return _read("solar_boxes.csv")


def stars() -> Boxes:
    """Spectra of 29 unreddened stars, O5 to M6, as photon flux in 31 boxes from 290 to 2500 nm.

    Worked out here from the library of A. J. Pickles 1998, PASP 110, 863 (UVKLIB): the mean of
    lambda F_lambda over each box relative to the box from 550 to 575 nm, in thousandths of a
    magnitude (so that larger is fainter). Photon flux, not energy: the photon counts of any band
    that ends on box borders are kept exactly.
    """
    return _read("stellar_boxes.csv")


def _read(table: str) -> Boxes:
    with Path(__file__).with_name(table).open(encoding="utf-8") as lines:
        headings, *rows = csv.reader(lines)
    low, high, *values = zip(*(map(float, row) for row in rows), strict=True)
    return Boxes((*low, high[-1]), dict(zip(headings[2:], values, strict=True)))
