"""Files of very many element sets, a batch at a time: two-line elements, OMM in four spellings."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO, TYPE_CHECKING

from pydantic import ValidationError

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput, shorten
from pipeline.inputs.targets.omm_files import mean_elements, read_messages
from pipeline.physics.positions.orbit_sgp4 import mean_satellite, tle_satellite
from pipeline.spec.targets.orbit import MeanElements, OmmOrbit, Orbit, TleOrbit

if TYPE_CHECKING:
    from sgp4.api import Satrec

LARGEST_BYTES = 4_000_000_000
LARGEST_TABLE_BYTES, MOST_ROWS = 256_000_000, 2_000_000
LONGEST_LINE, LONGEST_OBJECT = 4096, 1 << 20
HIGHEST_NUMBER = 1e9  # of a catalogue
BATCH = 16_384
REMARK = r"\s*$|#"  # of lines that are passed over in files of two-line elements
SIZES = ("norad_id", "diameter_m", "albedo")  # columns of a table of them


@dataclass(frozen=True)
class ElementSet:
    """One object's elements; `fault` says why they cannot be used, and then there is no orbit."""

    name: str
    number: int
    orbit: Orbit | None
    satellite: Satrec | None
    fault: str = ""


def element_sets(path: Path, field: str) -> Iterator[list[ElementSet]]:
    """The element sets of a file in its order, in batches of BATCH: memory does not grow with it.

    KVN and XML are read whole (64 MB at most). BadInput for a file that is missing, too large,
    packed, no text, or of no known kind; a set that is malformed has its fault instead of an orbit.
    """
    kind = _kind(path, field)
    if kind == "tle":
        sets = _from_lines(path, field)
        allowed = "two-line elements, or OMM as JSON, CSV, KVN or XML"
    else:
        sets = (_from_omm(fields) for fields in _messages(path, kind, field))
        allowed = "an OMM (JSON, CSV, KVN or XML) with EPOCH, MEAN_MOTION"
    some = False
    while batch := list(islice(sets, BATCH)):
        some = True
        yield batch
    if not some:
        raise BadInput(field, path.name, allowed)


def _kind(path: Path, field: str) -> str:
    if not path.is_file():
        raise BadInput(field, str(path), "an existing file of two-line elements or OMM")
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        raise BadInput(field, f"{path.name} of {size} bytes", f"at most {LARGEST_BYTES} bytes")
    with path.open("rb") as stream:
        head = stream.read(LONGEST_LINE)
    if head.startswith((b"PK\x03\x04", b"\x1f\x8b")):
        raise BadInput(field, path.name, "the unpacked file, not an archive")
    text = head.decode("utf-8-sig", "replace").lstrip()
    if not text:
        raise BadInput(field, path.name, "a file that is not empty")
    lines = [line for line in text.splitlines() if not re.match(REMARK, line)]
    first = next(iter(lines), "")
    if re.match(r"\[\s*([{\]]|$)|\{\s*([\"}]|$)", text):
        return "json"
    if "," in first and "MEAN_MOTION" in first:
        return "csv"
    return "other" if re.match(r"\s*(<[?!A-Za-z]|[A-Z_]{3,}\s*=)", first) else "tle"


def _lines(path: Path, field: str) -> Iterator[tuple[int, str]]:
    """(number, text) of the lines of a file, none of them longer than LONGEST_LINE."""
    with path.open(encoding="utf-8-sig", newline=None) as stream:
        number = 0
        while line := _read(stream, field, path, LONGEST_LINE):
            number += 1
            if len(line) >= LONGEST_LINE:
                raise BadInput(field, f"{path.name}, line {number}", f"under {LONGEST_LINE} long")
            yield number, line.rstrip("\r\n")


def _read(stream: IO[str], field: str, path: Path, most: int, block: bool = False) -> str:
    try:
        return stream.read(most) if block else stream.readline(most)
    except UnicodeDecodeError:
        raise BadInput(field, path.name, "a text file (UTF-8)") from None


def _from_lines(path: Path, field: str) -> Iterator[ElementSet]:
    """Pairs of lines, each after the line of its name where there is one."""
    name, first, at = "", "", 0
    for number, line in _lines(path, field):
        if re.match(REMARK, line):
            continue
        kind = _kind_of(line, first)
        if kind == "pair":
            yield _from_pair(name, first, line, at)
            name, first = "", ""
            continue
        if first or kind == "2":
            yield ElementSet(name, 0, None, None, f"line {at or number} without its other line")
        first, at = (line, number) if kind == "1" else ("", 0)
        if kind == "name":
            name = line.removeprefix("0 ").strip()
    if first:
        yield ElementSet(name, 0, None, None, f"line {at} without its other line")


def _kind_of(line: str, first: str) -> str:
    """`pair` for a second line after its first, 1 or 2 for one without its other, else `name`."""
    if first and line.startswith("2 "):
        return "pair"
    return line[0] if line.startswith(("1 ", "2 ")) and len(line) > 40 else "name"


def _from_pair(name: str, line1: str, line2: str, at: int) -> ElementSet:
    try:
        satellite = tle_satellite(line1, line2, f"line {at}")
    except BadInput as error:
        return ElementSet(name, 0, None, None, shorten(str(error)))
    orbit = TleOrbit.model_construct(kind="tle", line1=line1.rstrip(), line2=line2.rstrip())
    return ElementSet(name, int(satellite.satnum), orbit, satellite)


def _from_omm(fields: JsonObject) -> ElementSet:
    name, number = str(fields.get("OBJECT_NAME") or ""), str(fields.get("NORAD_CAT_ID") or "0")
    try:
        given = mean_elements(fields, name or number, "elements")
        elements = MeanElements.model_validate(given)
        satellite = mean_satellite(elements.model_dump(), "elements")
        number_ = _catalogue_number(number)
    except ValidationError as error:
        told = error.errors()[0]
        where = ".".join(str(part) for part in told["loc"])
        return ElementSet(name, 0, None, None, shorten(f"{where}: {told['msg']}"))
    except (BadInput, ValueError) as error:
        return ElementSet(name, 0, None, None, shorten(str(error)))
    orbit = OmmOrbit.model_construct(kind="omm", path=None, object=None, elements=elements)
    return ElementSet(name, number_, orbit, satellite)


def _catalogue_number(text: str) -> int:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (0.0 <= value <= HIGHEST_NUMBER and value == int(value)):
        raise BadInput("NORAD_CAT_ID", text, "a whole number from 0 to 1e9")
    return int(value)


def _messages(path: Path, kind: str, field: str) -> Iterator[JsonObject]:
    """The keys and values of each OMM of a file."""
    if kind == "other":
        yield from read_messages(path, field)
        return
    with path.open(encoding="utf-8-sig", newline="") as stream:
        try:
            yield from _csv(stream) if kind == "csv" else _json(stream, path, field)
        except (csv.Error, UnicodeDecodeError) as error:
            raise BadInput(field, path.name, f"OMM as CSV or JSON (UTF-8); {error}") from None


def _csv(stream: IO[str]) -> Iterable[JsonObject]:
    return csv.DictReader(line for line in stream if not re.match(REMARK, line))


def _json(stream: IO[str], path: Path, field: str) -> Iterator[JsonObject]:
    """Objects of a list (or one alone), decoded one after the other as the text comes in."""
    decoder, text, at = json.JSONDecoder(), stream.read(LONGEST_OBJECT), 0
    while True:
        while at < len(text) and text[at] in " \t\r\n,[]":
            at += 1
        if at < len(text):
            try:
                value, at = decoder.raw_decode(text, at)
            except (ValueError, RecursionError):  # a number of too many digits, too
                value = None
            if isinstance(value, dict):
                yield value
                continue
        rest = text[at:]
        more = stream.read(LONGEST_OBJECT) if len(rest) < LONGEST_OBJECT else ""
        if not more:
            if rest:
                raise BadInput(field, f"{path.name}: {rest[:40]!r}", "whole OMMs as JSON objects")
            return
        text, at = rest + more, 0


def read_sizes(path: Path, field: str) -> dict[int, tuple[float | None, float | None]]:
    """Diameter [m] and albedo by catalogue number; None where the table has none.

    BadInput names the line that cannot be used.
    """
    if not path.is_file():
        raise BadInput(field, str(path), "an existing CSV file: norad_id, diameter_m, albedo")
    if path.stat().st_size > LARGEST_TABLE_BYTES:
        raise BadInput(field, path.name, f"at most {LARGEST_TABLE_BYTES} bytes")
    out: dict[int, tuple[float | None, float | None]] = {}
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            rows = csv.DictReader(stream)
            _check_names(rows.fieldnames or (), field)
            for row in rows:
                number, sizes = _size(row, f"{path.name}, line {rows.line_num}", field)
                if number in out:
                    raise BadInput(field, f"norad_id {number} twice", "each number once")
                out[number] = sizes
                if len(out) > MOST_ROWS:
                    raise BadInput(field, path.name, f"at most {MOST_ROWS} rows")
    except (csv.Error, UnicodeDecodeError) as error:
        raise BadInput(field, path.name, f"a CSV file (UTF-8); {error}") from None
    return out


def _check_names(names: Sequence[str], field: str) -> None:
    once = [name in names for name in SIZES]
    if not once[0] or not any(once[1:]) or any(names.count(name) > 1 for name in SIZES):
        shown = ", ".join(names) or "nothing"
        allowed = "columns norad_id and diameter_m, albedo or both, each once"
        raise BadInput(field, shown, allowed)


def _size(row: JsonObject, where: str, field: str) -> tuple[int, tuple[float | None, float | None]]:
    def number(key: str, lowest: float, highest: float, allowed: str) -> float | None:
        text = (row.get(key) or "").strip()
        if not text:
            return None
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not lowest <= value <= highest:
            raise BadInput(field, f"{where}: {key} = {text}", allowed)
        return value

    which = number("norad_id", 0.0, HIGHEST_NUMBER, "a whole number from 0 to 1e9")
    if which is None or which != int(which):
        raise BadInput(field, f"{where}: norad_id = {row.get('norad_id')}", "a whole number")
    diameter_m = number("diameter_m", 5e-324, 1e6, "above 0, up to 1e6 [m]")
    return int(which), (diameter_m, number("albedo", 0.0, 1.0, "from 0 to 1"))
