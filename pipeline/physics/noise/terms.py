"""The detector's terms for one tile, and where the tile stands in the random streams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.noise.transfer import Smear

Array = NDArray[np.float64]
Value = float | Array


@dataclass(frozen=True)
class Chain:
    """The detector's terms for one tile: each a number or a (ny, nx) image of that tile.

    flat : response to light, dimensionless; dark_e : electrons in the integration time;
    full_well_e : None for no limit; read_noise_e : standard deviation, electrons;
    gain_e_per_dn : electrons per digital number; bias_dn : added before digitising;
    adc_bits : 1 to 63; rounding : "half_even" or "floor"; photon_noise : draw Poisson or not
    linearity : charge collected and charge measured [e-], increasing tables, straight between;
    blooming : charge above the full well runs along its column; the tile must hold whole columns
    row_noise_e, column_noise_e : one draw for a row or column of a frame, electrons
    bad : rows, columns (in the tile) and the DN of pixels that read the same in every frame
    smear : how charge is moved out under light, None for not at all; the tile holds whole columns
    lag : fraction of a pixel's charge that stays for the next frame
    """

    flat: Value
    dark_e: Value
    full_well_e: Value | None
    read_noise_e: Value
    gain_e_per_dn: Value
    bias_dn: Value
    adc_bits: int
    rounding: str = "half_even"
    photon_noise: bool = True
    linearity: tuple[Array, Array] | None = None
    blooming: bool = False
    row_noise_e: float = 0.0
    column_noise_e: float = 0.0
    bad: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]] | None = None
    smear: Smear | None = None
    lag: float = 0.0

    @property
    def is_joint(self) -> bool:
        """Whether both photon and read noise are there, and nothing but the full well between."""
        plain = self.photon_noise and self.linearity is None and not self.blooming
        return plain and self.is_noisy

    @property
    def is_noisy(self) -> bool:
        """Whether any pixel has read noise."""
        return bool(np.any(np.asarray(self.read_noise_e) > 0))

    @property
    def well_e(self) -> Value:
        """The full well; infinite where there is none [e-]."""
        return np.inf if self.full_well_e is None else self.full_well_e

    def of_rows(self, rows: slice) -> Chain:
        """The terms of some rows of the tile."""
        bad = self.bad
        if bad is not None:
            inside = (bad[0] >= rows.start) & (bad[0] < rows.stop)
            bad = bad[0][inside] - rows.start, bad[1][inside], bad[2][inside]
        images: dict[str, Any] = {
            name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)
        }
        return replace(self, bad=bad, **images) if images or bad else self


@dataclass(frozen=True)
class StreamPlace:
    """Where in the random streams a tile stands: its first pixel, its frame, and the keys.

    row_key, column_key : of the row and the column noise; None where there is none
    """

    y0: int
    x0: int
    frame: int
    photon_key: tuple[int, int]
    read_key: tuple[int, int]
    joint_key: tuple[int, int]
    row_key: tuple[int, int] | None = None
    column_key: tuple[int, int] | None = None

    @property
    def first(self) -> tuple[int, int, int]:
        """Row and column of the first pixel, and the frame."""
        return self.y0, self.x0, self.frame


class Readout(NamedTuple):
    """Some rows of a tile on their way: their terms, and what is drawn for them.

    place : of their first pixel in the streams; drawn_e : (ny, nx) charge drawn already (cosmic
    rays), or None; column_e : (1, nx) noise of the tile's columns, or None; before_e : (ny, nx)
    charge that each frame before held, where some of it stays behind, the earliest first
    """

    chain: Chain
    place: StreamPlace | None = None
    drawn_e: Array | None = None
    column_e: Array | None = None
    before_e: Sequence[Array] = ()

    @property
    def at(self) -> StreamPlace:
        """The place; what is drawn needs one."""
        assert self.place is not None
        return self.place

    @property
    def read_e(self) -> Array | None:
        """Drawn charge less what stays for the next frame."""
        lag = self.chain.lag
        return (1.0 - lag) * self.drawn_e if lag and self.drawn_e is not None else self.drawn_e
