"""UT1 - UTC from the tables that astropy-iers-data carries; nothing is downloaded."""

from __future__ import annotations

DATA_ENDS_ERROR_S = 0.9  # UTC is kept within it of UT1, so leaving the difference out errs no more


def gather_dut1_s(utc1: float, utc2: float) -> tuple[float, str | None]:
    """UT1 - UTC [s] at a UTC date, and a remark where no table covers the date (then 0)."""
    from astropy.utils import iers

    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None):
        table = iers.IERS_Auto.open()
        value, status = table.ut1_utc(utc1, utc2, return_status=True)
    if int(status) in (iers.FROM_IERS_B, iers.FROM_IERS_A, iers.FROM_IERS_A_PREDICTION):
        return float(value.to_value("s")), None
    return 0.0, (
        f"no table of the Earth's rotation covers this date: UT1 = UTC, at most "
        f"{DATA_ENDS_ERROR_S} s = {DATA_ENDS_ERROR_S * 15.04:.1f} arcsec of hour angle off"
    )
