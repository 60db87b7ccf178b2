"""Ephemeris files: CCSDS OEM (KVN), SP3-a to d, and CSV with the units in its column names."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import erfa.ufunc as era
import numpy as np

from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.inputs.targets.omm_files import by_month, read_text
from pipeline.physics.positions.times import parse_utc

LARGEST_BYTES = 200_000_000
_TAI_MINUS_S = {  # seconds from a satellite system's time to TAI
    "GPS": 19.0,
    "GAL": 19.0,
    "QZS": 19.0,
    "IRN": 19.0,
    "BDT": 33.0,
    "BDS": 33.0,
    "TAI": 0.0,
    "TT": -32.184,
    "TDT": -32.184,
    "TDB": -32.184,
}
_FRAMES = {
    "EME2000": "eme2000",
    "J2000": "eme2000",
    "GCRF": "gcrs",
    "GCRS": "gcrs",
    "ICRF": "gcrs",
    "ICRS": "gcrs",
    "TEME": "teme",
    "TEMEOFDATE": "teme",
    "WGS84": "itrf",
    "WGS-84": "itrf",
}
_PARTS = {  # of an OEM, by the line before them
    "META_START": "META_START",
    "COVARIANCE_START": "COVARIANCE_START",
    "META_STOP": "data",
    "COVARIANCE_STOP": "data",
}
USED = re.compile(r"x_k?m|y_k?m|z_k?m|v[xyz]_k?m_s")  # columns of a CSV file, beside its time's
_TIME = re.compile(r"(\d{4})-(\d{2})-(\d{2})T(\d{2}):(\d{2})(?::(\d{2}(?:\.\d*)?))?Z?")


@dataclass(frozen=True)
class Ephemeris:
    """One object's rows without a break, by increasing time.

    utc1, utc2 : (n,) two-part UTC; place_m : (n, 3); speed_m_s : (n, 3) or None
    frame : gcrs, eme2000, itrf or teme, whose axes the rows are in (velocities too)
    useable : UTC (2,), (2,) from when to when the file serves, between its first and last row: rows
        beyond are there for the polynomials
    """

    name: str
    frame: str
    utc1: Array
    utc2: Array
    place_m: Array
    speed_m_s: Array | None
    useable: tuple[Array, Array]


def read_ephemeris(
    path: Path, frame: str | None, epoch: str, field: str
) -> dict[str, list[Ephemeris]]:
    """Stretches of rows by object, from a file of any known kind, told by its content.

    frame : what the scene says; a CSV file needs it, of others it must be the file's own
    epoch : zero of a CSV file's `time_s`

    Raises BadInput, naming the line or key that cannot be used.
    """
    text = read_text(path, field, LARGEST_BYTES).lstrip()
    wanted = None if frame is None else _FRAMES.get(frame.upper(), frame)
    if re.match(r"#[a-d][PV]", text):
        found = _sp3(text, path, field)
    elif re.search(r"^\s*CCSDS_OEM_VERS\s*=", text[:20_000], re.M):
        found = _oem(text, path, field)
    elif "," in text.split("\n", 1)[0]:
        if wanted is None:
            allowed = "gcrs, eme2000, itrf or teme: a CSV file does not say"
            raise BadInput(f"{field.removesuffix('.path')}.frame", None, allowed)
        found = {path.stem: [_csv(text, path, wanted, epoch, field)]}
    else:
        raise BadInput(field, path.name, "a CCSDS OEM (KVN), an SP3 file, or CSV with a header")
    for tables in found.values():
        for table in tables:
            if wanted is not None and table.frame != wanted:
                allowed = f"none, or what {path.name} says: {table.frame}"
                raise BadInput(f"{field.removesuffix('.path')}.frame", frame, allowed)
    return found


def _table(
    name: str, frame: str, times: tuple[Array, Array], rows: Array, where: tuple[Path, str]
) -> Ephemeris:
    """Rows (n, 3) or (n, 6) [m, m/s] as an Ephemeris; BadInput unless finite and in order.

    All of its span is useable.
    """
    path, field = where
    if len(rows) < 2:
        raise BadInput(field, f"{len(rows)} rows of {name} in {path.name}", "at least 2 rows")
    bad = ~np.isfinite(rows).all(axis=1) | (np.abs(rows) > 1e13).any(axis=1)
    if bad.any():
        i = int(np.argmax(bad))
        raise BadInput(field, f"row {i + 1} of {name} in {path.name}", "finite numbers")
    step = np.diff(times[0]) + np.diff(times[1])
    if not (step > 0).all():
        i = int(np.argmax(~(step > 0))) + 2
        raise BadInput(field, f"row {i} of {name} in {path.name}", "increasing times, each once")
    speed = rows[:, 3:] if rows.shape[1] == 6 else None
    span = (times[0][[0, -1]], times[1][[0, -1]])
    return Ephemeris(name, frame, *times, rows[:, :3], speed, span)


def _to_utc(calendar: Array, scale: str, path: Path, field: str) -> tuple[Array, Array]:
    """UTC (n,), (n,) of calendar rows (n, 6): year, month, day, hour, minute, second."""
    year, month, day, hour, minute = calendar[:, :5].astype(np.int64).T
    dtf2d = era.dtf2d(
        b"UTC" if scale == "UTC" else b"TAI", year, month, day, hour, minute, calendar[:, 5]
    )
    status = np.asarray(dtf2d[2])  # 60 s are the next minute, but for the day's last one
    late = (status > 1) & ~((calendar[:, 5] == 60.0) & (60 * hour + minute < 1439))
    if (status < 0).any() or late.any() or (year < 1900).any() or (year > 2100).any():
        raise BadInput(field, path.name, "dates that exist, years 1900 to 2100")
    if scale == "UTC":
        return np.asarray(dtf2d[0]), np.asarray(dtf2d[1])
    if scale not in _TAI_MINUS_S:
        allowed = f"a time scale of UTC, {', '.join(_TAI_MINUS_S)}"
        raise BadInput(field, f"time scale {scale} of {path.name}", allowed)
    shift = _TAI_MINUS_S[scale]
    if scale == "TDB":  # up to 1.7 ms from TT, a dozen metres of a low orbit
        shift = shift - era.dtdb(dtf2d[0], dtf2d[1], 0.0, 0.0, 0.0, 0.0)
    utc1, utc2, _ = era.taiutc(dtf2d[0], dtf2d[1] + shift / 86_400.0)
    return np.asarray(utc1), np.asarray(utc2)


def _calendar(texts: list[str], path: Path, field: str) -> Array:
    """Calendar rows (n, 6) of CCSDS times, 2019-04-20T03:00:00 or 2019-110T03:00:00."""
    out = np.empty((len(texts), 6))
    for i, text in enumerate(texts):
        m = _TIME.fullmatch(by_month(text.strip()))
        if m is None:
            raise BadInput(field, f"time {text[:40]} of {path.name}", "2019-04-20T03:00:00.000")
        out[i] = [float(part or 0.0) for part in m.groups()]
    return out


def _sp3(text: str, path: Path, field: str) -> dict[str, list[Ephemeris]]:
    """Positions [km] (and velocities [dm/s]) in the Earth-fixed frame (Hilla 2016, SP3-d)."""
    lines = text.splitlines()
    scale = next((t[9:12].strip() for t in lines if t.startswith("%c")), "GPS")
    scale = {"GLO": "UTC", "": "GPS", "ccc": "GPS"}.get(scale, scale)
    dates: list[list[float]] = []
    rows: dict[str, dict[int, list[float]]] = {}
    for line in takewhile(lambda line: not line.startswith("EOF"), lines):
        try:
            _sp3_line(line, dates, rows)
        except ValueError as error:
            raise BadInput(field, f"{line[:60]} in {path.name}", f"SP3 numbers; {error}") from None
    if not dates:
        raise BadInput(field, path.name, "an SP3 file with epochs")
    utc1, utc2 = _to_utc(np.array(dates), scale, path, field)
    out = {}
    for name, mine in rows.items():
        index = np.array(list(mine))
        width = 6 if all(len(r) == 6 for r in mine.values()) else 3
        values = np.array([r[:width] for r in mine.values()])
        if len(index) > 1:
            out[name] = [_table(name, "itrf", (utc1[index], utc2[index]), values, (path, field))]
    return out


def _sp3_date(line: str) -> list[float]:
    """Year, month, day, hour, minute and second of an epoch."""
    date = [float(x) for x in line[1:].split()[:6]]
    if len(date) < 6:
        raise ValueError("an epoch of six")
    return date


def _sp3_line(line: str, dates: list[list[float]], rows: dict[str, dict[int, list[float]]]) -> None:
    """Put what a line says to the dates, or to an object's rows by the number of their date."""
    if line.startswith("* "):
        dates.append(_sp3_date(line))
    elif not dates:
        return
    elif line[:1] == "P":
        place = [1e3 * float(line[c : c + 14]) for c in (4, 18, 32)]
        if any(place):  # zeros: not known
            rows.setdefault(line[1:4].strip(), {})[len(dates) - 1] = place
    elif line[:1] == "V":
        place = rows.get(line[1:4].strip(), {}).get(len(dates) - 1, [])
        speed = [0.1 * float(line[c : c + 14]) for c in (4, 18, 32)]
        place += speed if place and any(speed) else []


def _oem(text: str, path: Path, field: str) -> dict[str, list[Ephemeris]]:
    """Segments of a CCSDS Orbit Ephemeris Message (502.0-B-3, section 5), KVN: km and km/s."""
    out: dict[str, list[Ephemeris]] = {}
    meta: dict[str, str] = {}
    rows: list[list[str]] = []
    part = "head"

    def close() -> None:
        if rows:
            key = f"{meta.get('OBJECT_NAME', '?')} | {meta.get('OBJECT_ID', '?')}"
            out.setdefault(key, []).append(_oem_segment(meta, rows, key, path, field))

    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if line[:7] in ("", "COMMENT"):
            continue
        if line == "META_START":
            close()
            meta, rows = {}, []
        if line in _PARTS:
            part = _PARTS[line]
        elif part == "META_START":
            key, _, value = line.partition("=")
            meta[key.strip()] = value.strip()
        elif part == "data":
            words = line.split()
            if len(words) not in (4, 7, 10):
                allowed = "a time with x y z [km] and, where known, vx vy vz [km/s]"
                raise BadInput(field, f"line {number} of {path.name}", allowed)
            rows.append(words)
    close()
    return out


def _oem_segment(
    meta: dict[str, str], rows: list[list[str]], key: str, path: Path, field: str
) -> Ephemeris:
    ours, scale = _frame_of(meta, path, field), meta.get("TIME_SYSTEM", "").upper()
    utc = _to_utc(_calendar([r[0] for r in rows], path, field), scale, path, field)
    width = 6 if all(len(r) >= 7 for r in rows) else 3
    values = 1e3 * _numbers([r[1 : 1 + width] for r in rows], path, field)
    table = _table(key, ours, utc, values, (path, field))
    for i, name in enumerate(("USEABLE_START_TIME", "USEABLE_STOP_TIME")):
        if name in meta:
            edge = _calendar([meta[name]], path, field)
            _narrow(table, i, _to_utc(edge, scale, path, field))
    return table


def _frame_of(meta: dict[str, str], path: Path, field: str) -> str:
    """Our name of a segment's axes; BadInput where they, or the centre, are not known here."""
    centre, frame = meta.get("CENTER_NAME", "EARTH").upper(), meta.get("REF_FRAME", "").upper()
    ours = "itrf" if frame.startswith("ITRF") else _FRAMES.get(frame)
    if centre != "EARTH" or ours is None:
        allowed = f"CENTER_NAME EARTH, REF_FRAME {', '.join(_FRAMES)} or ITRF..."
        raise BadInput(field, f"CENTER_NAME {centre}, REF_FRAME {frame} of {path.name}", allowed)
    if ours in ("teme", "itrf") and (held := meta.get("REF_FRAME_EPOCH")):
        allowed = f"{frame} of date; EME2000 or GCRF for axes that stand still"
        raise BadInput(field, f"REF_FRAME_EPOCH {held} of {path.name}", allowed)
    return ours


def _narrow(table: Ephemeris, i: int, edge: tuple[Array, Array]) -> None:
    """Let what is useable of a table begin (i = 0) or end (1) at an edge within its span."""
    (day,), (part,) = edge
    inwards = (day - table.useable[0][i]) + (part - table.useable[1][i])
    if (inwards if i == 0 else -inwards) > 0.0:
        table.useable[0][i], table.useable[1][i] = day, part


def _csv(text: str, path: Path, frame: str, epoch: str, field: str) -> Ephemeris:
    names, *lines = _csv_rows(text, path, field)
    if twice := [n for n, many in Counter(names).items() if many > 1 and USED.fullmatch(n)]:
        raise BadInput(field, f"{twice[0]} twice in {path.name}", "each column once")
    column = {name: values for name, *values in zip(names, *lines, strict=True)}
    parts = [_triple(column, "{}_m", "{}_km", "xyz", path, field)]
    if any(map(re.compile("v[xyz]_").match, names)):
        parts.append(_triple(column, "{}_m_s", "{}_km_s", ("vx", "vy", "vz"), path, field))
    times = [n for n in names if n.startswith("time_")]
    if len(times) != 1:
        raise BadInput(field, f"{len(times)} time columns in {path.name}", "one: time_utc, time_s")
    utc = _csv_times(times[0], column[times[0]], path, epoch, field)
    return _table(path.stem, frame, utc, np.hstack(parts), (path, field))


def _csv_rows(text: str, path: Path, field: str) -> list[list[str]]:
    """The names of a table's columns, and its rows, one at least and each as long."""
    try:
        head, *rows = list(csv.reader(io.StringIO(text))) or [[]]
    except csv.Error as error:
        raise BadInput(field, path.name, f"a readable table; {error}") from None
    names = [name.strip().lower() for name in head]
    lines = [row for row in rows if row and not row[0].lstrip().startswith("#")]
    if not lines:
        raise BadInput(field, path.name, "at least one row below its columns' names")
    for i, row in enumerate(lines, 1):
        if len(row) != len(names):
            raise BadInput(field, f"row {i} of {path.name}", f"{len(names)} values")
    return [names, *lines]


def _csv_times(
    name: str, texts: list[str], path: Path, epoch: str, field: str
) -> tuple[Array, Array]:
    """UTC (n,), (n,) of a column of times, by its name."""
    if name != "time_s":
        texts = [t.strip().replace(" ", "T", 1) for t in texts]
        scale = name.removeprefix("time_").upper()
        return _to_utc(_calendar(texts, path, field), scale, path, field)
    start1, start2, _ = era.utctai(*parse_utc(epoch, f"{field.removesuffix('.path')}.epoch"))
    seconds = _numbers([[t] for t in texts], path, field)[:, 0]
    if not np.isfinite(seconds).all():
        raise BadInput(field, f"time_s of {path.name}", "finite numbers")
    utc1, utc2, _ = era.taiutc(np.full(len(seconds), start1), start2 + seconds / 86_400.0)
    return np.asarray(utc1), np.asarray(utc2)


def _triple(
    column: dict[str, list[str]], plain: str, kilo: str, axes: Iterable[str], path: Path, field: str
) -> Array:
    """Three columns in metres (or per second) from the ones that are there."""
    for pattern, scale in ((plain, 1.0), (kilo, 1e3)):
        names = [pattern.format(a) for a in axes]
        if all(n in column for n in names):
            rows = [list(r) for r in zip(*(column[n] for n in names), strict=True)]
            return scale * _numbers(rows, path, field)
    wanted = ", ".join(plain.format(a) for a in axes)
    allowed = f"columns {wanted} (or with km for m)"
    raise BadInput(field, f"columns {', '.join(column)} of {path.name}", allowed)


def _numbers(rows: list[list[str]], path: Path, field: str) -> Array:
    try:
        return np.array(rows, dtype=np.float64)
    except ValueError as error:
        raise BadInput(field, path.name, f"numbers in every column; {error}") from None
