"""Two-line elements and mean elements, checked and carried on by SGP4 in TEME and GCRS axes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.physics.constants import DAY_S
from pipeline.physics.positions.earth import teme_to_gcrs
from pipeline.physics.positions.orbit_bounds import DECAYED, have_decayed
from pipeline.physics.positions.times import Instants, elapsed_s, format_utc, parse_utc

if TYPE_CHECKING:
    from sgp4.api import Satrec

Array = NDArray[np.float64]

SGP4_KINDS = (" ", "0", "2", "3")  # ephemeris types, in column 63 of line 1
_NUMBER = r"(?=.*\d)[ \d.+-]+"
_SATELLITE = r" *[0-9A-HJ-NP-Z]?\d+"  # I and O stand for no digits
# name, first and last column (1-based), what may stand there
_COLUMNS = {
    1: (
        ("satellite number", 3, 7, _SATELLITE),
        ("epoch", 19, 32, r"[ \d]\d(?:  |[ \d]\d)\d\.\d+ *"),
        ("first derivative of the mean motion", 34, 43, _NUMBER),
        ("second derivative of the mean motion", 45, 52, _NUMBER),
        ("drag term", 54, 61, _NUMBER),
    ),
    2: (
        ("satellite number", 3, 7, _SATELLITE),
        ("inclination", 9, 16, r" *\d+\.\d+ *"),
        ("node", 18, 25, r" *\d+\.\d+ *"),
        ("eccentricity", 27, 33, r" *\d+ *"),
        ("argument of perigee", 35, 42, r" *\d+\.\d+ *"),
        ("mean anomaly", 44, 51, r" *\d+\.\d+ *"),
        ("mean motion", 53, 63, r" *\d+\.\d+ *"),
    ),
}


def sgp4() -> Any:
    """sgp4's `api` and `omm`: SGP4, and its reader of mean elements; only their scenes load it."""
    import sgp4.omm

    return sgp4


def tle_states(
    line1: str, line2: str, instants: Instants, field: str = "orbit"
) -> tuple[Array, Array]:
    """GCRS positions [m] and velocities [m/s] (n, 3) of a two-line element set.

    SGP4/SDP4 with WGS 72 (Vallado et al. 2006, AIAA 2006-6753), then `teme_to_gcrs`. The time since
    the elements' epoch is counted in SI seconds, so that a leap second in between does not move the
    satellite. Elements are good to about 1 km at their epoch and some km a day later.

    Raises BadInput for malformed lines and where SGP4 ends (decayed, eccentricity out of range...).
    """
    return satellite_states(tle_satellite(line1, line2, field), line1.rstrip(), instants, field)


def satellite_states(
    satellite: Satrec, label: str, instants: Instants, field: str = "orbit"
) -> tuple[Array, Array]:
    """GCRS positions [m] and velocities [m/s] (n, 3) of one SGP4 satellite; see `tle_states`."""
    epoch = (satellite.jdsatepoch, satellite.jdsatepochF)
    days = elapsed_s(epoch, instants.utc1, instants.utc2) / DAY_S
    errors, position_km, velocity_km_s = satellite.sgp4_array(
        np.full_like(days, epoch[0]), epoch[1] + days
    )
    errors[have_decayed([satellite], days[None] * 1440.0)[0]] = DECAYED
    bad = (errors != 0) | ~np.all(np.isfinite(position_km), axis=-1)
    if np.any(bad):
        i = int(np.argmax(bad))
        when = format_utc(instants.utc1[i], instants.utc2[i])
        raise _ended(field, label, when, days[i], int(errors[i]))
    matrices = teme_to_gcrs(instants)
    # TEME turns against GCRS by precession alone (7.7e-12 rad/s): nothing is added to velocities
    return (
        np.einsum("nij,nj->ni", matrices, position_km) * 1e3,
        np.einsum("nij,nj->ni", matrices, velocity_km_s) * 1e3,
    )


def many_states(
    satellites: list[Satrec],
    labels: list[str],
    fields: list[str],
    since_s: Array,
    offsets_s: Array,
    matrices: Array,
) -> tuple[Array, Array]:
    """GCRS positions [m] and velocities [m/s] (m, n, 3) of m SGP4 satellites, times of their own.

    Parameters
    ----------
    satellites, labels, fields : m of each; label and field name a satellite in messages.
    since_s : (m,) from `since_epochs_s`, of the instant from which `offsets_s` (m, n) count.
    matrices : (n, 3, 3) from `teme_to_gcrs` near these times: TEME turns by 7.7e-12 rad/s, so the
        instants at which the light arrives do for those at which it left.

    Raises BadInput as `tle_states` does.
    """
    out = np.empty((2, *offsets_s.shape, 3))
    codes = np.empty(offsets_s.shape, np.uint8)
    days = (since_s[:, None] + offsets_s) / DAY_S
    for i, satellite in enumerate(satellites):
        start = np.full(days.shape[1], satellite.jdsatepoch)
        found = satellite.sgp4_array(start, satellite.jdsatepochF + days[i])
        codes[i], out[0, i], out[1, i] = found
    codes[have_decayed(satellites, days * 1440.0)] = DECAYED
    bad = (codes != 0) | ~np.isfinite(out[0]).all(axis=-1)
    if bad.any():
        i, k = np.argwhere(bad)[0]
        when = f"{offsets_s[i, k]:.3f} s after the scene's epoch"
        raise _ended(fields[i], labels[i], when, days[i, k], int(codes[i, k]))
    place, speed = (np.einsum("nij,mnj->mni", matrices, v, optimize=True) * 1e3 for v in out)
    return place, speed


def since_epochs_s(satellites: Sequence[Satrec], epoch_utc: tuple[float, float]) -> Array:
    """Seconds (m,) from each satellite's own epoch to an instant (two-part UTC)."""
    jd1 = np.array([s.jdsatepoch for s in satellites])
    jd2 = np.array([s.jdsatepochF for s in satellites])
    return -elapsed_s(epoch_utc, jd1, jd2)


def _ended(field: str, label: str, when: str, days: float, code: int) -> BadInput:
    meaning = sgp4().api.SGP4_ERRORS.get(code, "the result is not finite")
    return BadInput(
        field,
        label,
        f"elements that SGP4 can carry to {when}, {days:.2f} days after their epoch "
        f"(SGP4 code {code}: {meaning})",
    )


def tle_states_teme(
    line1: str, line2: str, jd: ArrayLike, fr: ArrayLike
) -> tuple[Array, Array, NDArray[np.uint8]]:
    """TEME positions [km], velocities [km/s] (n, 3) and SGP4 codes (n,) at UTC days jd + fr.

    No check of the lines: for verification sets, which hold deliberately odd elements.
    """
    api = sgp4().api
    satellite = api.Satrec.twoline2rv(line1, line2, api.WGS72)
    days, fraction = np.broadcast_arrays(np.atleast_1d(jd), np.atleast_1d(fr))
    errors, position_km, velocity_km_s = satellite.sgp4_array(
        np.ascontiguousarray(days, float), np.ascontiguousarray(fraction, float)
    )
    return position_km, velocity_km_s, errors


def tle_satellite(line1: str, line2: str, field: str = "orbit") -> Satrec:
    """The SGP4 satellite (WGS 72) of two checked lines."""
    check_tle(line1, line2, field)
    line1, line2 = line1.rstrip(), line2.rstrip()
    api = sgp4().api
    try:
        return api.Satrec.twoline2rv(line1, line2, api.WGS72)
    except ValueError as error:
        raise BadInput(field, line1, f"two-line elements that can be read ({error})") from error


def mean_satellite(elements: JsonObject, field: str = "orbit") -> Satrec:
    """The SGP4 satellite (WGS 72) of mean elements, as sgp4's OMM reader makes it.

    elements : epoch (UTC text), mean_motion_rev_day, eccentricity, inclination_deg, raan_deg,
        argument_of_perigee_deg, mean_anomaly_deg, bstar. SGP4 uses no derivative of the mean motion
    """
    epoch = format_utc(*parse_utc(elements["epoch"], f"{field}.epoch"))
    satellite = sgp4().api.Satrec()
    keywords = {
        "CLASSIFICATION_TYPE": "U",
        "OBJECT_ID": "2000-000A",
        "EPHEMERIS_TYPE": 0,
        "ELEMENT_SET_NO": 0,
        "REV_AT_EPOCH": 0,
        "NORAD_CAT_ID": 0,
        "EPOCH": epoch.rstrip("Z"),
        "ARG_OF_PERICENTER": elements["argument_of_perigee_deg"],
        "BSTAR": elements["bstar"],
        "ECCENTRICITY": elements["eccentricity"],
        "INCLINATION": elements["inclination_deg"],
        "MEAN_ANOMALY": elements["mean_anomaly_deg"],
        "MEAN_MOTION_DOT": 0.0,
        "MEAN_MOTION_DDOT": 0.0,
        "MEAN_MOTION": elements["mean_motion_rev_day"],
        "RA_OF_ASC_NODE": elements["raan_deg"],
    }
    try:
        sgp4().omm.initialize(satellite, keywords)
    except (ValueError, OverflowError) as error:
        raise BadInput(field, epoch, f"mean elements that SGP4 can read ({error})") from error
    return satellite


@lru_cache(maxsize=100_000)  # the same lines are looked at in every window of frames
def check_tle(line1: str, line2: str, field: str = "orbit") -> None:
    """BadInput, naming the line and what was expected, unless both lines are well formed."""
    for number, line in ((1, line1), (2, line2)):
        _check_line(number, line, f"{field}.line{number}")
    if line1[2:7] != line2[2:7]:
        raise BadInput(
            f"{field}.line2", line2[2:7], f"the satellite number of line 1, {line1[2:7]!r}"
        )
    _check_kind_and_day(line1, f"{field}.line1")


def _check_kind_and_day(line1: str, field: str) -> None:
    """BadInput for elements of another theory than SGP4, and a day that their year has not."""
    kind, year, day = line1[62], int(line1[18:20]), float(line1[20:32])
    if kind not in SGP4_KINDS:
        raise BadInput(field, kind, "ephemeris type 0, that of SGP4, in column 63")
    days = 366 if year % 4 == 0 else 365  # 1957 to 2056
    if not 1.0 <= day < days + 1:
        raise BadInput(field, line1[18:32], f"an epoch within its year of {days} days")


def _check_line(number: int, line: str, field: str) -> None:
    text = line.rstrip() if isinstance(line, str) else ""
    if not text.isascii():
        at = next(i for i, c in enumerate(text) if not c.isascii())
        raise BadInput(field, text[at], f"ASCII characters only; see column {at + 1}")
    if text[:2] != f"{number} ":
        raise BadInput(field, line, f"line {number} of two-line elements, starting '{number} '")
    if len(text) != 69:
        raise BadInput(field, line, f"69 characters (this has {len(text)})")
    body = text[:68]
    expected = (sum(d * body.count(str(d)) for d in range(1, 10)) + body.count("-")) % 10
    if text[68] != str(expected):
        raise BadInput(field, text[68], f"{expected}, the line's checksum")
    for name, first, last, pattern in _COLUMNS[number]:
        part = text[first - 1 : last]
        if not re.fullmatch(pattern, part):
            raise BadInput(field, part, f"the {name} in columns {first} to {last}")
