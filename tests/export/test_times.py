"""Exposures as every format gives them: times to the microsecond, each frame's own length."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from astropy.time import Time

from pipeline.export.times import exposure_of
from pipeline.physics.positions.times import parse_utc
from pipeline.store.clock import utc_microseconds

STARTS = np.array(["2019-07-20T09:00:00.000001", "2019-07-20T23:59:59.900000"], "datetime64[ns]")
TIMES_S = np.array([0.5, 2.0])


def cube(**more):
    """A cube of two frames with its times alone."""
    steps = (TIMES_S * 1e9).astype("timedelta64[ns]")
    moments = {"start": STARTS, "mid": STARTS + steps // 2, "end": STARTS + steps}
    columns = {f"time_{k}": ("frame", v) for k, v in moments.items()} | more
    return xr.Dataset(columns, attrs={"integration_s": 9.0})


def test_a_frame_of_a_dwell_has_its_own_length():
    """Frames of several lengths carry a column; without one the cube's number holds for all."""
    made = cube(integration_s=("frame", TIMES_S))
    assert [exposure_of(made, k).seconds for k in (0, 1)] == [0.5, 2.0]
    assert exposure_of(cube(), 1).seconds == 9.0


@pytest.mark.parametrize("frame", [0, 1])
def test_dates_against_astropy(frame):
    one = exposure_of(cube(), frame)
    for name, mjd in one.mjd().items():
        known = Time(one.iso()[name], scale="utc")
        assert abs(mjd - known.mjd) * 86_400 < 2e-6
    assert one.iso()["start"] == str(STARTS[frame].astype("datetime64[us]"))


def test_a_leap_second_is_stored_as_its_minutes_last_microsecond():
    """No time of 2016 goes into 2017: what is stored rises, and stays in its own day."""
    texts = ("59.25Z", "60.5Z")
    utc = np.array([parse_utc(f"2016-12-31T23:59:{text}") for text in texts]).T
    found = utc_microseconds(*utc).astype("datetime64[us]")
    assert [str(t) for t in found] == ["2016-12-31T23:59:59.250000", "2016-12-31T23:59:59.999999"]
