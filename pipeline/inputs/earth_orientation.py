"""UT1 - UTC from the tables that astropy-iers-data carries; nothing is downloaded."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

MJD_ZERO = 2_400_000.5
DATA_ENDS_ERROR_S = 0.9  # UTC is kept within it of UT1, so leaving the difference out errs no more


def gather_dut1_s(utc1: float, utc2: float) -> tuple[float, str | None]:
    """UT1 - UTC [s] at a UTC date, and a remark where no table covers the date (then 0).

    Reads IERS finals2000A (measured values and predictions) and interpolates between its days
    without the jump of a leap second. Only two columns are needed, so the file is read as text:
    astropy's full table takes 3 s.
    """
    mjd = (utc1 - MJD_ZERO) + utc2
    before, after = _days_around(int(mjd))
    if before is None or after is None:
        return 0.0, (
            "no table of the Earth's rotation covers this date: UT1 = UTC, at most "
            f"{DATA_ENDS_ERROR_S} s = {DATA_ENDS_ERROR_S * 15.04:.1f} arcsec of hour angle off"
        )
    step = after - before
    step -= round(step)  # a leap second between the two days
    return before + (mjd - int(mjd)) * step, None


@lru_cache(maxsize=4096)
def _days_around(mjd: int) -> tuple[float | None, float | None]:
    """UT1 - UTC at the midnight of a day and the next, None where the table has none.

    Columns of finals2000A (IERS readme.finals2000A): 8-15 MJD, 155-165 UT1 - UTC of Bulletin B,
    59-68 that of Bulletin A, where B is not out yet.
    """
    from astropy_iers_data import IERS_A_FILE

    values: dict[int, float] = {}
    with Path(IERS_A_FILE).open() as table:
        for line in table:
            day = line[7:12]
            if day.isdigit() and int(day) in (mjd, mjd + 1):
                value = line[154:165].strip() or line[58:68].strip()
                if value:
                    values[int(day)] = float(value)
    return values.get(mjd), values.get(mjd + 1)
