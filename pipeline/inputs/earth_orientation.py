"""UT1 - UTC and the pole from the tables that astropy-iers-data carries; nothing is downloaded."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.physics.constants import ARCSEC_RAD, DAY_S, EARTH_ROTATION_RAD_S
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.plan.timing import end_s
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene

MJD_ZERO = 2_400_000.5
MOST_LOOKS = 16  # of a long scene: each reads the table
DATA_ENDS_ERROR_S = 0.9  # UTC is kept within it of UT1, so leaving the difference out errs no more
UTC_MJD = 36934  # 1960-01-01: before it UTC is taken for TAI, 32.184 s from TT, and TT - UT1
BEFORE_UTC_ERROR_S = 35.0  # was -2.8 s in 1900 and 33.2 s in 1960 (Morrison & Stephenson 2004)


def gather_dut1_s(utc1: float, utc2: float) -> tuple[float, str | None]:
    """UT1 - UTC [s] at a UTC date, and a remark where no table covers the date (then 0).

    Reads IERS finals2000A (measured values and predictions) and interpolates between its days
    without the jump of a leap second. Only a few columns are needed, so the file is read as text:
    astropy's full table takes 3 s.
    """
    mjd = (utc1 - MJD_ZERO) + utc2
    before, after = (day.dut1_s for day in _days_around(int(mjd)))
    if before is None or after is None:
        off_s = DATA_ENDS_ERROR_S if mjd >= UTC_MJD else BEFORE_UTC_ERROR_S
        return 0.0, (
            "no table of the Earth's rotation covers this date: UT1 = UTC, at most "
            f"{off_s} s = {off_s * 15.04:.1f} arcsec of hour angle off"
        )
    step = after - before
    step -= round(step)  # a leap second between the two days
    return before + (mjd - int(mjd)) * step, None


def gather_pole_arcsec(utc1: float, utc2: float) -> tuple[float, float] | None:
    """x and y of the celestial intermediate pole in the Earth's crust [arcsec] at a UTC date.

    From the same table, straight between its days (off by under 0.1 mas). Predictions t days ahead
    err by 0.00068 t^0.8 arcsec (IERS Bulletin A): 0.08 arcsec, 2.4 m, in a year. None where it does
    not cover the date.
    """
    mjd = (utc1 - MJD_ZERO) + utc2
    before, after = (day.pole_arcsec for day in _days_around(int(mjd)))
    if before is None or after is None:
        return None
    part = mjd - int(mjd)
    x, y = (a + part * (b - a) for a, b in zip(before, after, strict=True))
    return x, y


def with_pole(scene: Scene) -> Scene:
    """The scene whose site knows where the pole is at the epoch, where a table covers that."""
    o = scene.observer
    if not isinstance(o, GroundObserver) or o.polar_motion_arcsec is not None:
        return scene
    pole = gather_pole_arcsec(*parse_utc(scene.epoch))
    known = o.model_copy(update={"polar_motion_arcsec": pole})
    return scene.model_copy(update={"observer": known})


def gather_turn_off_rad(scene: Scene) -> float:
    """How far [rad] the Earth under a site is, in frames, from where UT1 and the pole of the epoch
    have it: day by day, in long scenes at MOST_LOOKS moments.

    0 where no table tells, and within a day: 0.03 arcsec, as predictions of some weeks err by.
    """
    epoch, last_s = parse_utc(scene.epoch), end_s(scene)
    dut1_s, unknown = gather_dut1_s(*epoch)
    if not isinstance(scene.observer, GroundObserver) or unknown or last_s < DAY_S:
        return 0.0
    return turn_off_rad(epoch, 0.0, 0.0, last_s, dut1_s)


def turn_off_rad(
    epoch: tuple[float, float], known_s: float, first_s: float, last_s: float, dut1_s: float
) -> float:
    """How far [rad] the Earth is between two times after an epoch from where a UT1 and the pole of
    another time, `known_s`, have it: day by day, in long spans at MOST_LOOKS moments."""
    looks = min(2 + int((last_s - first_s) / DAY_S), MOST_LOOKS)
    [pole, *poles], late_s = zip(
        *(gather_turned(epoch, t, dut1_s) for t in [known_s, *np.linspace(first_s, last_s, looks)]),
        strict=True,
    )
    start = pole or (0.0, 0.0)
    moved = [np.hypot(*np.subtract(start if p is None else p, start)) for p in poles]
    turned = EARTH_ROTATION_RAD_S * np.abs(late_s[1:])
    return float((turned + ARCSEC_RAD * np.array(moved)).max())


def gather_turned(
    epoch: tuple[float, float], offset_s: float, dut1_s: float
) -> tuple[tuple[float, float] | None, float]:
    """The pole [arcsec] at a time after an epoch, and by how much UT1 is then more than as a
    UT1 - UTC of the epoch has it [s]; None and 0 where no table tells."""
    left = instants(epoch, [offset_s], dut1_s)
    utc = float(left.utc1[0]), float(left.utc2[0])
    then_s, unknown = gather_dut1_s(*utc)
    if unknown:
        return None, 0.0
    own = instants(utc, [0.0], then_s)
    late_s = DAY_S * ((own.ut11[0] - left.ut11[0]) + (own.ut12[0] - left.ut12[0]))
    return gather_pole_arcsec(*utc), float(late_s)


class Day(NamedTuple):
    """What the table has of a midnight; None where it has nothing."""

    dut1_s: float | None = None
    pole_arcsec: tuple[float, float] | None = None


@lru_cache(maxsize=4096)
def _days_around(mjd: int) -> tuple[Day, Day]:
    """The midnight of a day and the next.

    Columns of finals2000A (IERS readme.finals2000A): 8-15 MJD; 135-144, 145-154 and 155-165 x, y
    and UT1 - UTC of Bulletin B; 19-27, 38-46 and 59-68 those of Bulletin A, where B is not out yet.
    """
    from astropy_iers_data import IERS_A_FILE

    days: dict[int, Day] = {}
    with Path(IERS_A_FILE).open() as table:
        for line in table:
            day = line[7:12]
            if day.isdigit() and int(day) in (mjd, mjd + 1):
                dut1 = _number(line[154:165], line[58:68])
                x, y = _number(line[134:144], line[18:27]), _number(line[144:154], line[37:46])
                pole = None if x is None or y is None else (x, y)
                days[int(day)] = Day(dut1, pole)
    return days.get(mjd, Day()), days.get(mjd + 1, Day())


def _number(final: str, rapid: str) -> float | None:
    """The first of two fields of the table that is not blank."""
    text = final.strip() or rapid.strip()
    return float(text) if text else None
