"""Start, middle and end of each exposure: read from the cube, and told alike in every format."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class ExposureTimes:
    """One exposure in UTC, to the microsecond that the cube stores.

    The middle is the moment of the WCS, of `x_px`, `y_px` in the truth and of all labels; start
    and end are those of the streaks' ends. A leap second lies between, not in, the stamps' days.
    """

    start: np.datetime64
    middle: np.datetime64
    end: np.datetime64
    seconds: float

    def iso(self) -> dict[str, str]:
        """ISO 8601 text of the three moments, without a time zone: UTC."""
        moments = {"start": self.start, "middle": self.middle, "end": self.end}
        return {name: str(np.datetime_as_string(t)) for name, t in moments.items()}

    def mjd(self) -> dict[str, float]:
        """Modified Julian dates (UTC) of the three moments, to 1 us."""
        since = np.datetime64("1858-11-17T00:00:00", "us")
        moments = {"start": self.start, "middle": self.middle, "end": self.end}
        return {
            k: float((t - since) / np.timedelta64(1, "us")) / 86_400e6 for k, t in moments.items()
        }


def exposure_of(cube: xr.Dataset, frame: int) -> ExposureTimes:
    """The exposure of a frame of a complete cube."""
    one = cube.isel(frame=frame)
    start, middle, end = (
        np.datetime64(str(one[f"time_{k}"].values.astype("datetime64[us]")), "us")
        for k in ("start", "mid", "end")
    )
    seconds = one.get("integration_s", cube.attrs["integration_s"])  # its own, or of all
    return ExposureTimes(start, middle, end, float(seconds))
