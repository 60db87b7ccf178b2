"""Read a form from its TOML file; every mistake is named by key, value and remedy."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

from ..columns import REQUIRED
from ..documents import JsonObject, JsonValue
from ..errors import BadInput
from .form import (
    EPOCH_UNITS,
    ID_RULES,
    LAYOUTS,
    MU_ALPHA,
    MU_ALPHA_STAR,
    UNITS,
    ColumnSource,
    Epoch,
    Form,
    IdRule,
    Layout,
)

FOLDER = Path(__file__).parent
SCALES = ("TCB", "TDB", "TT")
MAX_BYTES = 1 << 20


def known_forms() -> tuple[str, ...]:
    """Names of the built-in forms."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def load_form(name_or_path: str | Path) -> Form:
    """A built-in form by its name, or a column map by the path of its file.

    Raises BadInput, naming the file, the key and what is allowed.
    """
    path = Path(name_or_path)
    if str(name_or_path) in known_forms():
        path = FOLDER / f"{name_or_path}.toml"
    elif not path.is_file():
        allowed = f"{', '.join(known_forms())}, or the path of a column map"
        raise BadInput("form", str(name_or_path), allowed)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise BadInput("form", str(path), "a column map of at most 1 MiB")
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput("form", str(path), f"a file that can be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise BadInput("form", str(path), f"a TOML file ({error})") from None
    return _form(_Table(data, str(path), ""))


class _Table:
    """A TOML table whose keys are taken one by one; those left over at the end are refused."""

    def __init__(self, data: JsonObject, path: str, place: str) -> None:
        self._data, self._path, self._place = dict(data), path, place
        self._asked: list[str] = []

    def refuse(self, key: str, value: object, allowed: str) -> BadInput:
        return BadInput(f"{self._path}: {self._place}{key}", value, allowed)

    def take(self, key: str, default: object = None) -> JsonValue:
        self._asked.append(key)
        return self._data.pop(key, default)

    def text(self, key: str, default: str | None = None) -> str:
        value = self.take(key, default)
        if not isinstance(value, str) or not value:
            raise self.refuse(key, value, "a text")
        return value

    def choice(self, key: str, allowed: tuple[str, ...], default: str | None = None) -> str:
        value = self.take(key, default)
        if value not in allowed:
            raise self.refuse(key, value, "one of " + ", ".join(allowed))
        return str(value)

    def number(self, key: str, default: float | None = None) -> float:
        value = self.take(key, default)
        if not _is_number(value):
            raise self.refuse(key, value, "a finite number")
        return float(value)

    def flag(self, key: str) -> bool:
        value = self.take(key, False)
        if not isinstance(value, bool):
            raise self.refuse(key, value, "true or false")
        return value

    def texts(self, key: str, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
        """One text or a list of texts."""
        value = self.take(key, default)
        items = [value] if isinstance(value, str) else value
        if not isinstance(items, list | tuple) or not all(isinstance(x, str) for x in items):
            raise self.refuse(key, value, "a text or a list of texts")
        if default is None and not (items and all(items)):
            raise self.refuse(key, value, "at least one name")
        return tuple(items)

    def numbers(self, key: str) -> tuple[float, ...]:
        value = self.take(key, [])
        if not isinstance(value, list) or not all(_is_number(x) for x in value):
            raise self.refuse(key, value, "a list of finite numbers")
        return tuple(float(x) for x in value)

    def inner(self, key: str) -> _Table:
        value = self.take(key, {})
        if not isinstance(value, dict):
            raise self.refuse(key, value, f"a table [{self._place}{key}]")
        return _Table(value, self._path, f"{self._place}{key}.")

    def several(self, key: str) -> list[_Table]:
        """A table, or a list of them to be tried in order; empty where the key is absent."""
        value = self.take(key, [])
        items = [value] if isinstance(value, dict) else value
        if not isinstance(items, list) or not all(isinstance(x, dict) for x in items):
            raise self.refuse(key, value, f"a table [{key}], or several [[{key}]]")
        return [_Table(x, self._path, f"{self._place}{key}.") for x in items]

    def has(self, key: str) -> bool:
        return key in self._data

    def done(self) -> None:
        if self._data:
            key = min(self._data)
            raise self.refuse(key, self._data[key], f"only the keys {', '.join(self._asked)}")


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max


def _form(table: _Table) -> Form:
    name, description, credit = (table.text(key) for key in ("name", "description", "credit"))
    jyear = table.number("ref_epoch_jyear")
    if not 1800.0 <= jyear <= 2200.0:
        raise table.refuse("ref_epoch_jyear", jyear, "a Julian year from 1800 to 2200")
    scale = table.choice("epoch_scale", SCALES)
    layout = _layout(table.inner("table"))
    epoch = _epoch(table.inner("epoch")) if table.has("epoch") else Form.epoch
    rule = _id_rule(table.inner("source_id"))
    sources = []
    for column in UNITS:
        ways = table.several(column)
        if not ways and column in REQUIRED:
            raise table.refuse(column, None, f"a table [{column}]")
        sources += [_source(way, column) for way in ways]
    foreign = table.texts("foreign", ())
    table.done()
    return Form(
        name, description, credit, jyear, scale, rule, tuple(sources), epoch, layout, foreign
    )


def _source(table: _Table, column: str) -> ColumnSource:
    names = table.texts("from")
    unit = table.choice("unit", tuple(UNITS[column]))
    given = _colour_term(table) if column.startswith("phot_") else {}
    if column == "pmra":
        given["is_"] = table.choice("is", (MU_ALPHA_STAR, MU_ALPHA))
    source = ColumnSource(
        column,
        names,
        unit,
        factor=table.number("factor", 1.0),
        add=table.number("add", 0.0),
        nulls=table.numbers("null"),
        positive=table.texts("positive", ()),
        optional=table.flag("optional"),
        fallback=table.flag("fallback"),
        **given,
    )
    table.done()
    return source


def _colour_term(table: _Table) -> JsonObject:
    """The fields of a `ColumnSource` that tell how a magnitude depends on a colour."""
    colour, coefficients = table.texts("colour", ()), table.numbers("coefficients")
    limits, clip = table.numbers("colour_range"), table.flag("clip")
    if len(colour) > 2 or bool(colour) != bool(coefficients):
        allowed = "one column, or two whose difference it is, together with `coefficients`"
        raise table.refuse("colour", list(colour), allowed)
    if limits and (len(limits) != 2 or limits[0] >= limits[1]):
        raise table.refuse("colour_range", list(limits), "two numbers, the lower one first")
    if clip and not limits:
        raise table.refuse("clip", True, "together with `colour_range`")
    return {
        "colour": colour,
        "coefficients": coefficients,
        "clip": clip,
        "colour_range": limits or None,
    }


def _id_rule(table: _Table) -> IdRule:
    rule = table.choice("rule", ID_RULES, "integer")
    names = () if rule == "position" else table.texts("from")
    factor = table.number("factor", 1.0) if rule.endswith("integer") else 1.0
    if factor not in (1.0, -1.0):
        raise table.refuse("factor", factor, "1 or -1")
    holds_place = table.flag("holds_place")
    table.done()
    return IdRule(rule, names, int(factor), holds_place)


def _epoch(table: _Table) -> Epoch:
    epoch = Epoch(table.texts("from"), table.choice("unit", EPOCH_UNITS, "jyear"))
    table.done()
    return epoch


def _layout(table: _Table) -> Layout:
    text = table.choice("layout", LAYOUTS, "delimited")
    delimiter = table.text("delimiter", ",") if text == "delimited" else ","
    if len(delimiter.encode()) != 1 or delimiter in '"\n\r':
        raise table.refuse("delimiter", delimiter, "one character, such as , | or a tab")
    fixed = text == "fixed"
    columns, ranges = _byte_ranges(table) if fixed else (table.texts("columns", ()), ())
    hdu = table.take("hdu")
    if hdu is not None and (not isinstance(hdu, int) or isinstance(hdu, bool) or hdu < 1):
        raise table.refuse("hdu", hdu, "the number of an extension, from 1")
    query = table.text("query") if table.has("query") else None
    attach = _attached(table)
    comments, nulls = table.texts("comments", ("#",)), table.texts("null", ())
    layout = Layout(text, delimiter, columns, ranges, comments, nulls, hdu, query, attach)
    table.done()
    return layout


def _attached(table: _Table) -> tuple[tuple[str, str], ...]:
    value = table.take("attach", {})
    if not isinstance(value, dict) or not all(
        isinstance(name, str) and alias.isidentifier() for alias, name in value.items()
    ):
        raise table.refuse("attach", value, "a table of alias = file name")
    return tuple(value.items())


def _byte_ranges(table: _Table) -> tuple[tuple[str, ...], tuple[tuple[int, int], ...]]:
    value = table.take("columns", {})
    if not isinstance(value, dict) or not value:
        raise table.refuse("columns", value, "a table of name = [first byte, last byte]")
    ranges = []
    for name, ends in value.items():
        whole = isinstance(ends, list) and len(ends) == 2 and all(type(x) is int for x in ends)
        if not whole or not 1 <= ends[0] <= ends[1]:
            raise table.refuse(f"columns.{name}", ends, "[first byte, last byte], from 1")
        ranges.append((ends[0], ends[1]))
    return tuple(value), tuple(ranges)
