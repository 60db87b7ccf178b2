"""A star catalogue as an object: what it holds, and the stars in a cone."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..catalogue import Catalogue, open_catalogue
from ..documents import JsonObject
from ..errors import BadInput
from ..info import info
from .query import cone

if TYPE_CHECKING:
    import pyarrow as pa


class StarCatalogue:
    """A star catalogue, opened by `nightglass.open_catalogue`; stars are read when asked for.

    Parameters
    ----------
    catalogue : Catalogue
        As `catalogue.open_catalogue` gives it.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue = catalogue

    def __repr__(self) -> str:
        return f"<StarCatalogue {self._catalogue.path!r}, {self._catalogue.rows} stars>"

    @property
    def facts(self) -> JsonObject:
        """What the catalogue holds, as `nightglass catalog info` says it.

        Returns
        -------
        dict
            Units stand in the keys.
        """
        return info(self._catalogue)

    def cone(
        self,
        ra_deg: float,
        dec_deg: float,
        radius_deg: float,
        faintest_g_mag: float | None = None,
        epoch_jyear: float | None = None,
        columns: Sequence[str] | None = None,
    ) -> pa.Table:
        """Stars within a cone, about bright first.

        Parameters
        ----------
        ra_deg, dec_deg : float
            Centre of the cone [deg], ICRS, barycentric.
        radius_deg : float
            Radius of the cone [deg], above 0, up to 180.
        faintest_g_mag : float, optional
            Faintest Gaia G magnitude, included; all stars by default.
        epoch_jyear : float, optional
            Julian year at which a star must lie in the cone, after its space motion; by default
            the catalogue's reference epoch.
        columns : sequence of str, optional
            Columns wanted; all by default.

        Returns
        -------
        pyarrow.Table
            A row a star, as the catalogue holds it at its reference epoch: `ra`, `dec` [deg],
            `parallax` [mas], `pmra`, `pmdec` [mas/yr], `radial_velocity` [km/s] and magnitudes,
            null where unknown.

        Raises
        ------
        BadInput
            For a value out of its range or a column that there is not.
        Damaged
            Where what is read does not match its checksum.
        """
        rows, _ = cone(
            self._catalogue, ra_deg, dec_deg, radius_deg, faintest_g_mag, epoch_jyear, columns
        )
        return rows


def open_star_catalogue(path: str | os.PathLike[str]) -> StarCatalogue:
    """Open a catalogue at a path or URL, as `nightglass.open_catalogue` says."""
    if not isinstance(path, str | os.PathLike):
        raise BadInput("catalogue", path, "a path or a URL")
    return StarCatalogue(open_catalogue(path))
