"""Published tables that a user has whole: in the folder that NIGHTGLASS_DATA names, if any."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

SOLAR_TABLE = "solar_spectrum/e490-00a_2014_table3.txt"  # ASTM E490-00a, table 3
PICKLES_FOLDER = "stellar_spectra/pickles_uvk"  # A. J. Pickles 1998, PASP 110, 863


def data_file(relative: str) -> Path | None:
    """A file or folder of the user's data folder, or None where it is absent."""
    folder = os.environ.get("NIGHTGLASS_DATA")
    path = Path(folder, relative) if folder else None
    return path if path is not None and path.exists() else None


def user_data_files() -> Iterator[tuple[str, Path]]:
    """Names and paths of all files that are taken from it, in order."""
    table, folder = data_file(SOLAR_TABLE), data_file(PICKLES_FOLDER)
    if table is not None:
        yield SOLAR_TABLE, table
    for path in sorted(folder.glob("*.fits")) if folder is not None else ():
        yield f"{PICKLES_FOLDER}/{path.name}", path
