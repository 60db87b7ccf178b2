"""A complete product as an object: its cube, truth tables, plan, report, and WCS of each frame."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput, Damaged
from pipeline.export.files import layers_of
from pipeline.export.header import fits_header
from pipeline.lazily import fits
from pipeline.store import layout
from pipeline.store.cube import open_cube
from pipeline.store.seal import check_complete
from pipeline.store.truth import read_truth

if TYPE_CHECKING:
    import xarray as xr
    from astropy.wcs import WCS

TABLES = ("stars", "targets", "cosmic_rays", "pixels")


class TruthTables(Mapping[str, pa.Table]):
    """Truth tables by name, as pyarrow Tables; each is read when it is asked for.

    The names are those of `stars`, `targets`, `cosmic_rays`, `pixels` that the product has. A row
    is a source in a frame; of `pixels` a fault of a pixel of the detector, the same in all frames.
    Units stand in the names of the columns.

    Parameters
    ----------
    product : pathlib.Path
        Its folder.

    Raises
    ------
    BadInput
        From `truth[name]`, for a name that the product does not have.
    Damaged
        From `truth[name]`, where the table cannot be read.
    """

    def __init__(self, product: Path) -> None:
        self._product, folder = product, product / layout.TRUTH
        self._names = tuple(name for name in TABLES if (folder / f"{name}.parquet").is_file())

    def __getitem__(self, name: str) -> pa.Table:
        if name not in self:
            raise BadInput(
                "truth",
                name,
                ", ".join(self) or "nothing: the scene has no sources and no faulty pixels",
            )
        table = read_truth(self._product, name)
        if table is None:
            raise Damaged(f"{layout.TRUTH}/{name}.parquet", "gone")
        return table

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def get(self, name: str, default: object = None, /) -> pa.Table | object:
        """A table, or something else where the product has none.

        Parameters
        ----------
        name : str
            Of the table.
        default : object, optional
            What is returned where there is none.

        Returns
        -------
        pyarrow.Table or object
            The table, or `default`.

        Raises
        ------
        Damaged
            Where the table cannot be read.
        """
        if name in self:
            return self[name]
        return default

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"<TruthTables {', '.join(self)}>"


class Product:
    """A complete product, opened by `nightglass.open_product`.

    Parameters
    ----------
    path : pathlib.Path
        Its folder, kept as `path`; complete, which `open_product` checks.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __repr__(self) -> str:
        return f"<Product {str(self.path)!r}>"

    @cached_property
    def cube(self) -> xr.Dataset:
        """The frames as an xarray Dataset that reads pixels when they are used.

        `dn (frame, y, x)` in digital numbers; other layers, whose names end in `_e`, in electrons;
        start, middle and end of each exposure in UTC; attitude and WCS terms of each frame.

        Returns
        -------
        xarray.Dataset
            With dimensions frame, y (row) and x (column).

        Raises
        ------
        BadInput, Incomplete
            Where the product has gone meanwhile, or is being made anew.
        Damaged
            When pixels are read whose chunk is lost.
        """
        return open_cube(self.path)

    @cached_property
    def truth(self) -> TruthTables:
        """Every source in the frames and every faulty pixel, as tables by name.

        Returns
        -------
        TruthTables
            Those of `stars`, `targets`, `cosmic_rays`, `pixels` that the product has.
        """
        return TruthTables(self.path)

    @cached_property
    def plan(self) -> JsonObject:
        """What was decided before drawing, and why: `plan.json`.

        Returns
        -------
        dict
            Units stand in the keys.

        Raises
        ------
        Damaged
            Where the file cannot be read.
        """
        return layout.read_json(self.path / layout.PLAN)

    @cached_property
    def report(self) -> JsonObject:
        """What came out: time, memory, errors measured, warnings: `report.json`.

        Returns
        -------
        dict
            Units stand in the keys.

        Raises
        ------
        Damaged
            Where the file cannot be read.
        """
        return layout.read_json(self.path / layout.REPORT)

    def wcs(self, frame: int) -> WCS:
        """Astrometric ICRS of a frame, at the middle of its exposure, as an astropy WCS.

        Parameters
        ----------
        frame : int
            Frame number, from 0.

        Returns
        -------
        astropy.wcs.WCS
            From right ascension and declination [deg] to pixels (x, y), pixel (0, 0) being the
            centre of the first one, with SIP terms where they are needed. It is the primary WCS of
            the exported FITS files (Calabretta and Greisen 2002, doi:10.1051/0004-6361:20021327):
            a star's catalogue place, moved to the time of the frame, gives the pixel that it is
            drawn at, to the cube's `wcs_residual_px`.

        Raises
        ------
        BadInput
            For a frame that there is not.
        """
        from astropy.wcs import WCS

        cube = self.cube
        if frame not in range(cube.sizes["frame"]):
            raise BadInput("frame", frame, f"0 to {cube.sizes['frame'] - 1}")
        layer = layers_of(cube)[0]
        cards = fits_header(cube, int(frame), layer)
        wcs = WCS(fits().Header((key, value) for key, value, _ in cards))
        wcs.array_shape = cube[layer].shape[1:]
        return wcs


def open_product(path: str | os.PathLike[str]) -> Product:
    """Open a complete product, as `nightglass.open_product` says; nothing of it is read yet."""
    if not isinstance(path, str | os.PathLike):
        raise BadInput("product", path, "a path")
    check_complete(Path(path))
    return Product(Path(path))
