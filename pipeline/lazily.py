"""Libraries that take long to load and that many scenes do not need: loaded where first used."""

from __future__ import annotations

from typing import Any

from pipeline.errors import BadInput


def arrow() -> Any:
    """pyarrow, with Parquet."""
    import pyarrow.parquet

    return pyarrow


def fits() -> Any:
    """astropy.io.fits."""
    from astropy.io import fits

    return fits


def blank_figure(asked: str, size_in: tuple[float, float], dpi: float = 100, **given: Any) -> Any:
    """An empty figure of matplotlib that no window shows.

    asked : what wants it, for the message; BadInput where matplotlib is not installed
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        allowed = "pip install 'nightglass[report]'"
        raise BadInput(asked, "matplotlib is not installed", allowed) from None
    made = Figure(figsize=size_in, dpi=dpi, **given)
    FigureCanvasAgg(made)
    return made
