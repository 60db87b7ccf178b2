"""What a real detector adds: pixels that fail, patterns, amplifiers, lag, and ways of reading out.

Everything here is off unless it is given.
"""

from __future__ import annotations

from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from pipeline.spec.strict import FilePath, Fraction, NotNegative, Positive, Strict

if TYPE_CHECKING:
    from pipeline.spec.sensor.sensor import Sensor

Index = Annotated[int, Field(ge=0, lt=60_000)]
Rms = Annotated[float, Field(ge=0, le=1e9)]
Indices = Annotated[tuple[Index, ...], Field(max_length=60_000)]
MOST_LISTED = 100_000


def _error(field: str, allowed: str) -> PydanticCustomError:
    return PydanticCustomError("detector", "{allowed}", {"field": field, "allowed": allowed})


class Failing(Strict):
    """Pixels that share a fault: listed, whole rows and columns, from an image, or by chance.

    All that are given count together.
    """

    pixels: tuple[tuple[Index, Index], ...] = Field(
        (), max_length=MOST_LISTED, description="[row, column] of each, from 0"
    )
    rows: Indices = ()
    columns: Indices = ()
    map: FilePath | None = Field(
        None, description="image (FITS, NPY, Zarr) of the focal plane; not 0 where the fault is"
    )
    fraction: Fraction = Field(0.0, description="each pixel fails with this chance, by the seed")


class BadPixels(Failing):
    """Pixels that read the same number in every frame, whatever falls on them."""

    reads_dn: int = Field(0, ge=0, lt=2**63, description="what they read")


class DeadPixels(Failing):
    """Pixels that take no light; bias, dark current and noise are as in the others."""


class HotPixels(Strict):
    """Pixels with more dark current than the others, listed or drawn from a log-normal law."""

    pixels: tuple[tuple[Index, Index, Annotated[float, Field(ge=0, le=1e12)]], ...] = Field(
        (), max_length=MOST_LISTED, description="[row, column, e-/s] of each, added to its dark"
    )
    fraction: Fraction = Field(0.0, description="each pixel is hot with this chance, by the seed")
    median_e_per_s: float = Field(
        100.0, gt=0, le=1e12, description="median of the pixels drawn by chance [e-/s]"
    )
    sigma_dex: float = Field(0.5, ge=0, le=3, description="scatter of those drawn, in log10")


class PolynomialResponse(Strict):
    """Charge q is measured as q (1 + c1 x + c2 x^2 + ...), x = q / full well."""

    kind: Literal["polynomial"]
    coefficients: tuple[Annotated[float, Field(ge=-10, le=10)], ...] = Field(
        min_length=1, max_length=8, description="c1, c2, ...: of the full well, dimensionless"
    )


class TableResponse(Strict):
    """Charge and what is measured of it, straight between; from 0 to the full well or beyond."""

    kind: Literal["table"]
    true_e: tuple[NotNegative, ...] = Field(min_length=2, max_length=10_000)
    read_e: tuple[NotNegative, ...] = Field(min_length=2, max_length=10_000)

    @model_validator(mode="after")
    def _increasing(self) -> TableResponse:
        if len(self.true_e) != len(self.read_e):
            raise _error("read_e", f"allowed: as many as true_e ({len(self.true_e)})")
        for name in ("true_e", "read_e"):
            values = getattr(self, name)
            if values[0] != 0.0 or any(b <= a for a, b in pairwise(values)):
                raise _error(name, "allowed: 0, then increasing values (a monotonic table)")
        return self


Response = Annotated[PolynomialResponse | TableResponse, Field(discriminator="kind")]


class BiasStructure(Strict):
    """A bias pattern that is the same in every frame, drawn by the seed, added to bias_dn."""

    row_rms_dn: Rms = Field(0.0, description="one offset for each row")
    column_rms_dn: Rms = Field(0.0, description="one offset for each column")
    pixel_rms_dn: Rms = Field(0.0, description="one offset for each pixel")
    row_slope_dn: float = Field(
        0.0,
        ge=-1e9,
        le=1e9,
        description="rise from the first to the last row; 0 in the middle [DN]",
    )
    column_slope_dn: float = Field(
        0.0, ge=-1e9, le=1e9, description="rise from the first to the last column [DN]"
    )


class Amplifier(Strict):
    """A rectangle of the focal plane with its own output; pixels in none keep the sensor's terms.

    rows, columns : first, and the one after the last
    """

    rows: tuple[Index, Annotated[int, Field(ge=1, le=60_000)]]
    columns: tuple[Index, Annotated[int, Field(ge=1, le=60_000)]]
    gain_e_per_dn: Annotated[float, Field(ge=1e-9, le=1e12)] | None = Field(
        None, description="instead of the sensor's"
    )
    offset_dn: float = Field(0.0, ge=-1e18, le=1e18, description="added to the sensor's bias")
    read_noise_e: Rms | None = Field(None, description="instead of the sensor's")

    @model_validator(mode="after")
    def _ordered(self) -> Amplifier:
        for name in ("rows", "columns"):
            first, stop = getattr(self, name)
            if stop <= first:
                raise _error(name, "allowed: first, and the one after the last")
        return self

    def meets(self, other: Amplifier) -> bool:
        """Whether two rectangles share a pixel."""
        pairs = (self.rows, other.rows), (self.columns, other.columns)
        return all(a[0] < b[1] and b[0] < a[1] for a, b in pairs)


class Lag(Strict):
    """Of the charge in a pixel a fraction stays behind when it is read, and comes with the next."""

    fraction: float = Field(
        gt=0, le=0.1, description="fraction of the charge that stays for the next frame"
    )


class FrameTransfer(Strict):
    """Charge is moved under the light to a covered store: every source streaks along its column."""

    kind: Literal["frame_transfer"]
    transfer_s: Positive = Field(le=100, description="time in which all rows are moved out [s]")
    towards: Literal["high_rows", "low_rows"] = "high_rows"
    cleared: bool = Field(
        False, description="charge is dumped before the exposure: no streak from moving in"
    )


class TimeDelay(Strict):
    """Time delay and integration: charge moves along the columns during the exposure.

    rows_per_s : towards higher rows if positive; an image that moves as fast stands still in the
    frame. clock_phases : steps in which a row is moved. edges : rows that come in or leave during
    the exposure are as full as any (of a long strip), or `partial`: exposed while on the array.
    """

    kind: Literal["tdi"]
    rows_per_s: float = Field(ge=-1e7, le=1e7)
    clock_phases: int = Field(3, ge=1, le=8)
    edges: Literal["full", "partial"] = "full"


class RollingShutter(Strict):
    """Rows are exposed one after the other, each for the same time: row k starts k line_s later.

    The frame's own times are those of the first row.
    """

    kind: Literal["rolling"]
    line_s: Positive = Field(
        le=1.0, description="time from the start of a row to that of the next [s]"
    )
    first: Literal["low_rows", "high_rows"] = "low_rows"


Readout = Annotated[FrameTransfer | TimeDelay | RollingShutter, Field(discriminator="kind")]


class Detector(Strict):
    """Faults, patterns and other effects of a detector, each off unless given."""

    bad: BadPixels | None = None
    dead: DeadPixels | None = None
    hot: HotPixels | None = None
    prnu: float = Field(0.0, ge=0, le=0.5, description="rms of a random flat, by the seed")
    nonlinearity: Response | None = None
    blooming: bool = Field(False, description="charge above the full well runs along its column")
    row_noise_e: Rms = Field(0.0, description="one draw for each row of each frame")
    column_noise_e: Rms = Field(0.0, description="one draw for each column of each frame")
    bias_structure: BiasStructure | None = None
    amplifiers: tuple[Amplifier, ...] = Field((), max_length=256)
    lag: Lag | None = None
    readout: Readout | None = None

    @property
    def whole_columns(self) -> bool:
        """Whether charge runs along columns, so that a tile must hold whole ones."""
        return self.blooming or isinstance(self.readout, FrameTransfer)


def check_detector(sensor: Sensor) -> None:
    """What must fit between a sensor and its detector. Raises PydanticCustomError."""
    if sensor.detector is not None:
        _check_pixels(sensor, sensor.detector)
        _check_charge(sensor, sensor.detector)


def _check_pixels(sensor: Sensor, d: Detector) -> None:
    """Pixels that fail, and the amplifiers' rectangles."""
    ny, nx = sensor.shape
    for name in ("bad", "dead", "hot"):
        found = getattr(d, name)
        if found is not None:
            _check_places(found, f"detector.{name}", ny, nx)
    if d.bad is not None and d.bad.reads_dn >= 1 << sensor.adc_bits:
        top = (1 << sensor.adc_bits) - 1
        raise _error("detector.bad.reads_dn", f"allowed: at most {top}, the largest DN")
    for i, a in enumerate(d.amplifiers):
        if a.rows[1] > ny or a.columns[1] > nx:
            raise _error("detector.amplifiers", f"allowed: inside of {ny} x {nx} px (number {i})")
    for (i, a), (j, b) in combinations(enumerate(d.amplifiers), 2):
        if a.meets(b):
            allowed = f"allowed: rectangles that share no pixel (numbers {i} and {j} do)"
            raise _error("detector.amplifiers", allowed)


def _check_charge(sensor: Sensor, d: Detector) -> None:
    """What goes by the full well, and what time delay and integration cannot have."""
    used = {
        "blooming": d.blooming,
        "nonlinearity": d.nonlinearity is not None,
        "lag": d.lag is not None,
    }
    for name, is_used in used.items():
        if is_used and sensor.full_well_e is None:
            raise _error(f"detector.{name}", "allowed: with sensor.full_well_e")
    if d.nonlinearity is not None:
        _check_response(d.nonlinearity, float(sensor.full_well_e or 0.0))
    for name in ("blooming", "lag") if isinstance(d.readout, TimeDelay) else ():
        if used[name]:
            raise _error(f"detector.{name}", "allowed: without a readout of kind tdi")


def _check_places(found: Failing | HotPixels, name: str, ny: int, nx: int) -> None:
    places = np.array([p[:2] for p in found.pixels], float).reshape(-1, 2)
    if (places >= (ny, nx)).any():
        raise _error(f"{name}.pixels", f"allowed: rows below {ny}, columns below {nx}")
    for axis, size in (("rows", ny), ("columns", nx)):
        if any(i >= size for i in getattr(found, axis, ())):
            raise _error(f"{name}.{axis}", f"allowed: below {size}")


def _check_response(response: PolynomialResponse | TableResponse, full_well_e: float) -> None:
    if isinstance(response, TableResponse):
        if response.true_e[-1] < full_well_e:
            allowed = f"allowed: up to sensor.full_well_e = {full_well_e:g} or beyond"
            raise _error("detector.nonlinearity.true_e", allowed)
        return
    slope = np.polynomial.Polynomial([0.0, 1.0, *response.coefficients]).deriv()
    turns = slope.deriv().roots() if slope.degree() > 1 else np.empty(0)
    real = turns[np.abs(turns.imag) < 1e-9].real if turns.size else np.empty(0)
    at = np.concatenate([[0.0, 1.0], real[(real > 0) & (real < 1)]])
    if slope(at).min() <= 0.0:
        raise _error(
            "detector.nonlinearity.coefficients",
            "allowed: a response that increases from 0 to the full well",
        )
