"""UTC text to two-part Julian dates, and the instants of a scene in UTC, TT and UT1."""

from __future__ import annotations

import re
from dataclasses import dataclass

import erfa.ufunc as era
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.errors import BadInput
from pipeline.physics.constants import DAY_S

Array = NDArray[np.float64]

FIRST_YEAR, LAST_YEAR = 1900, 2100  # the range of the Earth ephemeris (ERFA epv00)
_FIRST_JD, _LAST_JD = 2_415_020.5, 2_488_434.5  # 1900-01-01 and 2101-01-01
_ALLOWED = (
    "a UTC time such as 2019-04-20T03:00:00Z (fractions of a second are fine), "
    f"years {FIRST_YEAR} to {LAST_YEAR}"
)
_PATTERN = re.compile(
    r"(\d{4})-(\d{2})-(\d{2})[T ](\d{2}):(\d{2})(?::(\d{2}(?:\.\d+)?))?(?:Z|\+00:00)?", re.ASCII
)


@dataclass(frozen=True)
class Instants:
    """Instants in three time scales, each a two-part Julian date [days], arrays of shape (n,).

    UTC is ERFA's quasi-Julian date: a day with a leap second is 86 401 s long.
    """

    utc1: Array
    utc2: Array
    tt1: Array
    tt2: Array
    ut11: Array
    ut12: Array


def parse_utc(text: str, field: str = "epoch") -> tuple[float, float]:
    """ISO 8601 UTC text -> two-part quasi-Julian date (ERFA dtf2d).

    A missing suffix means UTC; other offsets are refused. 23:59:60 is accepted where a leap second
    was inserted. Before 1960 UTC is taken as TAI (ERFA), which leaves UT1 up to half a minute off.

    Raises BadInput for anything else and for years outside 1900 to 2100.
    """
    match = _PATTERN.fullmatch(text.strip()) if isinstance(text, str) else None
    if match is None:
        raise BadInput(field, text, _ALLOWED)
    year, month, day, hour, minute = (int(part) for part in match.groups()[:5])
    if not FIRST_YEAR <= year <= LAST_YEAR:
        raise BadInput(field, text, f"a year from {FIRST_YEAR} to {LAST_YEAR}")
    utc1, utc2, status = era.dtf2d(
        b"UTC", year, month, day, hour, minute, float(match.group(6) or 0.0)
    )
    if status < 0 or status >= 2:  # 2: after the end of the day
        reason = {-2: "month", -3: "day", -4: "hour", -5: "minute", -6: "second"}
        wrong = reason.get(int(status), "second (that day has no leap second)")
        raise BadInput(field, text, f"{_ALLOWED}; its {wrong} does not exist")
    return float(utc1), float(utc2)


def format_utc(utc1: float, utc2: float) -> str:
    """Two-part quasi-Julian UTC date -> text with microseconds, 2019-04-20T03:00:00.000000Z."""
    year, month, day, hmsf, _ = era.d2dtf(b"UTC", 6, utc1, utc2)
    hour, minute, second, fraction = (int(hmsf[name]) for name in ("h", "m", "s", "f"))
    return f"{year:04d}-{month:02d}-{day:02d}T{hour:02d}:{minute:02d}:{second:02d}.{fraction:06d}Z"


def instants(epoch_utc: tuple[float, float], offsets_s: ArrayLike, dut1_s: float = 0.0) -> Instants:
    """Instants `offsets_s` SI seconds after an epoch.

    Parameters
    ----------
    epoch_utc : two-part quasi-Julian UTC date, as `parse_utc` gives it.
    offsets_s : (n,) elapsed SI seconds; counted in TAI, so that leap seconds come out right.
    dut1_s : UT1 - UTC at the epoch [s]; UT1 runs on from there without the jump of a leap second.
        Zero where it is not known: the Earth then is turned wrongly by up to 0.9 s (13 arcsec).

    Raises BadInput for instants outside the Earth ephemeris or offsets that are not finite.
    """
    offsets = np.atleast_1d(np.asarray(offsets_s, float))
    if not np.all(np.isfinite(offsets)):
        raise BadInput("exposure", "offset that is not finite", "finite times")
    start1, start2, _ = era.utctai(*epoch_utc)
    tai2 = start2 + offsets / DAY_S
    tai1 = np.full_like(tai2, start1)
    julian = tai1 + tai2
    if np.any(julian < _FIRST_JD) or np.any(julian > _LAST_JD + 1e-3):
        worst = offsets[int(np.argmax(np.abs(julian - 0.5 * (_FIRST_JD + _LAST_JD))))]
        raise BadInput(
            "exposure", f"{worst:g} s after the epoch", f"times from {FIRST_YEAR} to {LAST_YEAR}"
        )
    utc1, utc2, _ = era.taiutc(tai1, tai2)
    tt1, tt2, _ = era.taitt(tai1, tai2)
    ut1_minus_tai_s = dut1_s + _utc_minus_tai_s(epoch_utc)
    ut11, ut12, _ = era.taiut1(tai1, tai2, ut1_minus_tai_s)
    return Instants(utc1, utc2, tt1, tt2, ut11, ut12)


def check_dates(epoch_utc: tuple[float, float], offsets_s: ArrayLike, field: str) -> None:
    """BadInput as of `instants`, by the name of the field that gives the times."""
    try:
        instants(epoch_utc, offsets_s)
    except BadInput as error:
        raise BadInput(field, error.value, error.allowed) from None


def elapsed_s(
    since_utc: tuple[float, float], until_utc1: ArrayLike, until_utc2: ArrayLike
) -> Array:
    """SI seconds (through TAI) from one UTC instant to others: (n,)."""
    since1, since2, _ = era.utctai(*since_utc)
    until1, until2, _ = era.utctai(until_utc1, until_utc2)
    return np.asarray(((until1 - since1) + (until2 - since2)) * DAY_S)


def _utc_minus_tai_s(utc: tuple[float, float]) -> float:
    """UTC - TAI [s] at an instant: calendar reading of UTC, so whole seconds since 1972.

    Taken from ERFA's table at the calendar day rather than as a difference of quasi-Julian dates,
    which would be stretched on a day with a leap second.
    """
    year, month, day, fraction, _ = era.jd2cal(*utc)
    return -float(era.dat(year, month, day, fraction)[0])
