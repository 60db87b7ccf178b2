"""Libraries that take long to load and that many scenes do not need: loaded where first used."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pipeline.errors import Missing


def arrow() -> Any:
    """pyarrow, with Parquet."""
    import pyarrow.parquet

    return pyarrow


def fits() -> Any:
    """astropy.io.fits."""
    from astropy.io import fits

    return fits


@contextmanager
def open_fits(path: Path) -> Iterator[Any]:
    """The units of a FITS file; OSError where one that is packed is not what was packed: astropy
    itself stops before the checksum. So are errors of astropy over what it finds in the file."""
    if path.suffix == ".gz":
        try:
            with gzip.open(path) as packed:
                while packed.read(1 << 20):
                    pass
        except (EOFError, zlib.error) as error:
            raise OSError(str(error)) from None
    try:
        with fits().open(path) as units:
            yield units
    except (KeyError, IndexError, AttributeError, zlib.error) as error:
        raise OSError(f"{type(error).__name__}: {error}") from None


def need_matplotlib(instead: str = "") -> None:
    """Missing where matplotlib is not installed; `instead` is what does without, for its text."""
    if find_spec("matplotlib") is None:
        raise Missing("figures", "matplotlib", "report", instead)


def blank_figure(size_in: tuple[float, float], dpi: float = 100, **given: Any) -> Any:
    """An empty figure of matplotlib that no window shows; Missing where it is not installed."""
    need_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=size_in, dpi=dpi, **given)
    FigureCanvasAgg(made)
    return made
