"""Response tables of this process: computed once by content, shared by all its tiles."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import numpy as np

from catalog_tools.documents import Arguments
from pipeline.errors import BadInput
from pipeline.kept import kept, kept_array
from pipeline.physics.drawing.along import lit_columns, swept_spectrum
from pipeline.physics.drawing.spectral import transfer_table
from pipeline.physics.drawing.spectral_band import peak_light
from pipeline.physics.drawing.spectral_plan import SpectralPlan, plan_spectral
from pipeline.physics.drawing.wings import WingGrid, grid_frequencies, wing_kernel
from pipeline.physics.motion.streak import Path, in_few_runs, transfer
from pipeline.physics.psf.product import ProductResponse, is_product, product_table
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import (
    Core,
    CoreGrid,
    PixelResponse,
    compact_core,
    core_spectrum,
    oversampling_for,
    phase_table,
    window,
)
from pipeline.plan.needs import KERNEL_BYTES, TABLE_BYTES
from pipeline.plan.response.responses import FINEST_ERROR

Swept = tuple[CoreGrid, np.ndarray, tuple[int, int], tuple[int, int]]
Still = tuple[CoreGrid, np.ndarray, np.ndarray, tuple[int, int], tuple[int, int]]

ALIKE_PX = 8.0
BENT = 1e-3  # of the spacing of a grid of wings: how straight the runs are that sweep them


class ContentCache:
    """Values by the content that they are made from; the least recently used are dropped.

    Each value is made once, also when several threads ask for it at the same time.
    """

    def __init__(self, limit_bytes: float) -> None:
        self._limit = limit_bytes
        self._values: OrderedDict[Hashable, tuple[object, int]] = OrderedDict()
        self._making: dict[Hashable, Future[object]] = {}
        self._lock = threading.Lock()
        self._bytes = 0

    def get(self, key: Hashable, make: Callable[[], Any], size: Callable[[Any], int]) -> Any:
        """The value of a key; `make` gives one that is not kept, `size` its bytes."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key][0]
            others = self._making.get(key)
            if others is None:
                own = self._making[key] = Future[object]()
        if others is not None:
            return others.result()
        try:
            own.set_result(self._keep(key, make(), size))
        except BaseException as error:
            own.set_exception(error)
            raise
        finally:
            with self._lock:
                del self._making[key]
        return own.result()

    def _keep(self, key: Hashable, value: object, size: Callable[[object], int]) -> Any:
        with self._lock:
            self._values[key] = (value, size(value))
            self._bytes += self._values[key][1]
            while len(self._values) > 1 and self._bytes > self._limit:
                self._bytes -= self._values.popitem(last=False)[1][1]
        return value


_CACHE = ContentCache(TABLE_BYTES)
_KERNELS = ContentCache(KERNEL_BYTES)  # dear to make, and no larger than a block asks for


def core_of(blur: Blur, radius_px: float) -> Core:
    """The compact core of a response."""
    return _CACHE.get(
        ("core", blur, radius_px),
        lambda: compact_core(blur, radius_px),
        lambda core: core.samples.nbytes,
    )


def swept_core(blur: Blur, radius_px: float, piece: Path) -> Swept:
    """A core's grid with the spectrum of its streak: (grid, spectrum, half window, period).

    The core itself is read only to make a spectrum, so that what is kept is what is used.
    """
    grid, half, period = _window(blur, radius_px, piece)
    spectrum = _CACHE.get(
        ("spectrum", blur, radius_px, piece),
        lambda: swept_spectrum(core_of(blur, radius_px), piece, period),
        _bytes,
    )
    return grid, spectrum, half, period


def still_core(blur: Blur, radius_px: float, piece: Path) -> Still:
    """A core's grid with its spectrum at rest in the window that a path sweeps, and how much of
    each row of that holds light; else as `swept_core`."""
    grid, half, period = _window(blur, radius_px, piece)

    def make() -> tuple[np.ndarray, np.ndarray]:
        spectrum = core_spectrum(core_of(blur, radius_px), *period)
        return spectrum, lit_columns(spectrum)

    kept_as = "still", blur, radius_px, *period
    spectrum, columns = _CACHE.get(kept_as, make, lambda both: sum(map(_bytes, both)))
    return grid, spectrum, columns, half, period


def _window(
    blur: Blur, radius_px: float, piece: Path
) -> tuple[CoreGrid, tuple[int, int], tuple[int, int]]:
    """A core's grid, and the half window and the period [px] that hold it swept by a path."""
    grid = CoreGrid(oversampling_for(blur), radius_px)
    reach_y, reach_x = float(np.abs(piece.y_px).max()), float(np.abs(piece.x_px).max())
    half_y, half_x, period_y, period_x = window(grid, reach_y, reach_x)
    return grid, (half_y, half_x), (period_y, period_x)


def table_of(
    blur: Blur, radius_px: float, piece: Path, phases: int
) -> PixelResponse | ProductResponse:
    """The table of a core swept along a piece of a streak."""

    def make() -> PixelResponse | ProductResponse:
        if is_product(blur, piece.length_px):
            return product_table(blur, radius_px)
        if piece.length_px:  # moving stars have other shapes in each frame
            return phase_table(*swept_core(blur, radius_px, piece), phases)
        found = kept(key, lambda: vars(phase_table(*swept_core(blur, radius_px, piece), phases)))
        values: Arguments = {name: v if v.ndim else v.item() for name, v in found.items()}
        return PixelResponse(**values)

    key = ("table", blur, radius_px, piece, phases)
    return _CACHE.get(key, make, lambda t: t.nbytes)


def kernel_of(blur: Blur, radius_px: float, grid: WingGrid, reach_px: float) -> np.ndarray:
    """The wing's transfer function on a grid."""
    key = ("wing", blur, radius_px, grid.rows, grid.columns, grid.spacing_px, reach_px)

    def make() -> np.ndarray:
        return wing_kernel(blur, core_of(blur, radius_px), grid, reach_px)

    return _KERNELS.get(key, lambda: kept_array(key, make), _bytes)


def spectral_plan_of(
    blur: Blur, radius_px: float, path: Path, shape: tuple[int, int], stars: int, error: float
) -> SpectralPlan | None:
    """Plan of the spectral engine for a block of about so many stars; None where it cannot serve.

    error : largest of a pixel per unit light, but no smaller than FINEST_ERROR asks for.
    Streaks that are alike share it: a straight one is planned for lengths rounded down, which
    errs more, with the reach of lengths rounded up.
    """
    path, spare_px = _alike(path)

    def make() -> SpectralPlan | None:
        core = core_of(blur, radius_px)
        wider = replace(core, radius_px=radius_px + spare_px)
        try:
            asked = max(error, FINEST_ERROR * peak_light(core, path))
            return plan_spectral(shape, wider, path, asked, sources=_about(stars))
        except BadInput:
            return None

    key = ("spectral plan", blur, radius_px, path, shape, _about(stars), error)
    return _CACHE.get(key, make, lambda _: 0)


def spectral_of(
    blur: Blur, radius_px: float, path: Path, shape: tuple[int, int], stars: int, error: float
) -> tuple[SpectralPlan, np.ndarray]:
    """Plan and transfer table of the spectral engine for a block that it can serve."""
    plan = spectral_plan_of(blur, radius_px, path, shape, stars, error)
    assert plan is not None
    key = ("spectral", blur, radius_px, _alike(path)[0], shape, _about(stars), error)

    def make() -> np.ndarray:
        return transfer_table(core_of(blur, radius_px), plan)

    table = _CACHE.get(key, lambda: kept_array(("transfer", blur, radius_px, plan), make), _bytes)
    return plan, table


def _about(stars: int) -> float:
    """A number of stars as a power of ten, so that frames that are alike share their plans."""
    return float(10 ** round(math.log10(max(stars, 10_000))))


def _bytes(array: np.ndarray) -> int:
    return int(array.nbytes)


def _alike(path: Path) -> tuple[Path, float]:
    """A path that stands for those like it, and how much farther they reach [px]."""
    if path.segments > 1 or not path.length_px:
        return path, 0.0
    step = 1.0 if path.length_px < 8.0 * ALIKE_PX else ALIKE_PX
    dx, dy = (float(np.floor(abs(d[1] - d[0]) / step) * step) for d in (path.x_px, path.y_px))
    sides = np.array([-0.5, 0.5])
    return Path(sides * dx, sides * dy, np.ones(1)), step


def streak_of(grid: WingGrid, path: Path) -> np.ndarray:
    """The transfer function of a streak on a grid's frequencies, in runs as straight as it shows.

    Runs that are BENT of the grid's spacing off, this way and that, change a wing's light by less
    than BENT of what it changes from one of its samples to the next.
    """

    def make() -> np.ndarray:
        few = in_few_runs(path, BENT * grid.spacing_px)
        return transfer(*grid_frequencies(grid), few.x_px, few.y_px, few.weight)

    return _CACHE.get(
        ("streak", grid.rows, grid.columns, grid.spacing_px, path), make, lambda t: t.nbytes
    )
