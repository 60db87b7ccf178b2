"""Orbit Mean-Elements Messages as JSON, KVN or XML: the elements of every object in a file."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.physics.positions.orbit_sgp4 import sgp4

LARGEST_BYTES = 64_000_000
_KEYS = {
    "epoch": "EPOCH",
    "mean_motion_rev_day": "MEAN_MOTION",
    "eccentricity": "ECCENTRICITY",
    "inclination_deg": "INCLINATION",
    "raan_deg": "RA_OF_ASC_NODE",
    "argument_of_perigee_deg": "ARG_OF_PERICENTER",
    "mean_anomaly_deg": "MEAN_ANOMALY",
    "bstar": "BSTAR",
}
_EXPECTED = {
    "CENTER_NAME": ("EARTH",),
    "REF_FRAME": ("TEME", "TEME OF DATE", "TEMEOFDATE"),
    "TIME_SYSTEM": ("UTC",),
    "MEAN_ELEMENT_THEORY": ("SGP4", "SGP/SGP4", "SGP"),
    "EPHEMERIS_TYPE": ("0", "2", "3", "0.0"),
}


def read_omm(path: Path, field: str) -> dict[str, JsonObject]:
    """Mean elements by `name | international id | catalogue number`, as `omm.elements` takes them.

    BadInput for files that are none, of another theory (SGP4-XP), frame or time scale.
    """
    out: dict[str, JsonObject] = {}
    for fields in read_messages(path, field):
        names = ("OBJECT_NAME", "OBJECT_ID", "NORAD_CAT_ID")
        key = " | ".join(str(fields.get(n) or "").strip() for n in names)
        if key in out:
            raise BadInput(field, f"{key} twice in {path.name}", "each object once")
        out[key] = mean_elements(fields, key, field)
    if not out:
        raise BadInput(field, path.name, "an OMM (JSON, KVN or XML) with EPOCH and MEAN_MOTION")
    return out


def read_messages(path: Path, field: str) -> list[JsonObject]:
    """The keys and values of each OMM of a file, not checked; BadInput where it holds none."""
    text = read_text(path, field, LARGEST_BYTES)
    start = text.lstrip("\ufeff \t\r\n")[:1]
    try:
        reader = {"{": _from_json, "[": _from_json}.get(start, _from_kvn)
        sets = [*(_from_xml(text, path, field) if start == "<" else reader(text))]
        if not all(isinstance(fields, Mapping) for fields in sets):
            raise TypeError("a list holds something else than messages")
    except (ValueError, TypeError, AttributeError, SyntaxError, RecursionError) as error:
        raise BadInput(field, path.name, f"an OMM as JSON, KVN or XML; {error}") from None
    return sets


def read_text(path: Path, field: str, largest: int) -> str:
    """A text file of limited size; BadInput where there is none."""
    if not path.is_file():
        raise BadInput(field, str(path), "an existing file")
    if path.stat().st_size > largest:
        raise BadInput(field, str(path), f"a file of at most {largest} bytes")
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput(field, str(path), "a text file (UTF-8)") from None


def mean_elements(fields: JsonObject, key: str, field: str) -> JsonObject:
    """The elements of one message, as `omm.elements` takes them; `key` names it in messages.

    Without BSTAR (SGP4-XP gives BTERM) a set would be carried on without drag. SGP4 gives places in
    TEME of date: axes held at another epoch than the elements' are not its own.
    """
    for name, allowed in _EXPECTED.items():
        value = fields.get(name)
        if value not in (None, "") and str(value).strip().upper() not in allowed:
            raise BadInput(field, f"{name} = {value} of {key}", f"{name} {allowed[0]}")
    held = fields.get("REF_FRAME_EPOCH")
    if held not in (None, "", fields.get("EPOCH")):
        raise BadInput(field, f"REF_FRAME_EPOCH = {held} of {key}", "TEME of date")
    out: JsonObject = {}
    for ours, theirs in _KEYS.items():
        value = fields.get(theirs)
        if value in (None, ""):
            raise BadInput(field, f"no {theirs} of {key}", f"an OMM with {theirs}")
        try:
            out[ours] = by_month(str(value).strip()) if ours == "epoch" else float(value)
        except (TypeError, ValueError, OverflowError):
            raise BadInput(field, f"{theirs} = {value} of {key}", "a number") from None
    return out


def by_month(epoch: str) -> str:
    """A CCSDS time with a day of the year (2019-110T03:00:00) as one with month and day."""
    found = re.fullmatch(r"(\d{4})-(\d{3})(T.*)", epoch, re.ASCII)
    if found is None:
        return epoch
    year, day, time = found.groups()
    date = str(np.datetime64(f"{year}-01-01") + (int(day) - 1))
    return f"{date}{time}" if date.startswith(f"{year}-") else epoch


def _from_json(text: str) -> Iterable[JsonObject]:
    data = json.loads(text)
    return data if isinstance(data, list) else [data]


def _from_xml(text: str, path: Path, field: str) -> Iterable[JsonObject]:
    """By sgp4's reader; documents that declare types or entities of their own are refused."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise BadInput(field, path.name, "XML without DOCTYPE and ENTITY")
    return list(sgp4().omm.parse_xml(io.StringIO(text)))


def _from_kvn(text: str) -> Iterable[JsonObject]:
    """KEY = value lines; a new message starts at CCSDS_OMM_VERS or at a repeated OBJECT_NAME."""
    sets: list[JsonObject] = []
    for line in text.splitlines():
        key, sign, value = line.partition("=")
        key = key.strip()
        if not sign or key.startswith("COMMENT"):
            continue
        if key == "CCSDS_OMM_VERS" or not sets or (key == "OBJECT_NAME" and key in sets[-1]):
            sets.append({})
        sets[-1][key] = _kvn_value(key, value)
    return [s for s in sets if "MEAN_MOTION" in s or "EPOCH" in s]


def _kvn_value(key: str, text: str) -> str:
    """A value without its unit, which stands in brackets; a name may hold some of its own."""
    return (text if key == "OBJECT_NAME" else text.partition("[")[0]).strip()
