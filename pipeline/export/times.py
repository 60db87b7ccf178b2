"""Start, middle and end of each exposure: read from the cube, and told alike in every format."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.physics.positions.times import format_utc, instants, parse_utc
from pipeline.plan.timing import frame_times
from pipeline.spec.scene import Scene

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


def fits_dates(times: ExposureTimes, scene: Scene, frame: int) -> dict[str, str]:
    """The text of `times.iso()`, with second 60 within a leap second, as FITS writes it.

    The cube holds the last microsecond before it in their place, as do MJDs, labels and their JSON,
    whose readers know no second 60.
    """
    (start_s,), (length_s,) = frame_times(scene, np.array([frame]))
    at = instants(parse_utc(scene.epoch), start_s + length_s * np.array([0.0, 0.5, 1.0]))
    exact = [format_utc(*utc).removesuffix("Z") for utc in zip(at.utc1, at.utc2, strict=True)]
    return {
        name: there if ":60." in there else stored
        for (name, stored), there in zip(times.iso().items(), exact, strict=True)
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
