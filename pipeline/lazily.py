"""Libraries that take long to load and that many scenes do not need: loaded where first used."""

from __future__ import annotations

from importlib.util import find_spec
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


def need_matplotlib(asked: str) -> None:
    """BadInput that names what asks for a figure, where matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise BadInput(asked, "without matplotlib", "pip install 'nightglass[report]', then again")


def blank_figure(asked: str, size_in: tuple[float, float], dpi: float = 100, **given: Any) -> Any:
    """An empty figure of matplotlib that no window shows.

    asked : what wants it, for the message; BadInput where matplotlib is not installed
    """
    need_matplotlib(asked)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=size_in, dpi=dpi, **given)
    FigureCanvasAgg(made)
    return made
