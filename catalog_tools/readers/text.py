"""Text tables: CSV, bar-separated and fixed width, reduced to the columns wanted, then parsed.

Most of a Gaia row is columns that nobody asked for: the wanted fields are taken out first, and
only these go through the CSV parser. A block that isn't regular (quoted separators, blank lines, a
row with too few fields) is taken apart line by line, which finds the row that is wrong.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
from numpy.typing import NDArray

from ..errors import BadInput
from ..forms import Layout
from .bytes_in import bytes_of
from .ecsv import is_ecsv, units_of
from .fields import FieldTaker
from .kinds import BOM, Choose, choose_once

Block = NDArray[np.uint8]

TABLE_BYTES = 4 << 20  # of wanted fields in one table: about 28,000 rows of Gaia DR2
TABLE_ROWS = 60_000
LONGEST_LINE = 1 << 20
BLANKS = " \t\r\v\f"  # of ASCII alone: bytes of other letters are no blanks
NO_BLANKS = re.compile(rf"[^{BLANKS}]+")
NULL_TEXTS = ("", "null", "NULL", "nan", "NaN", "NAN", *(" " * n for n in range(1, 33)))


def read_text(
    path: Path, where: str, layout: Layout, choose: Choose, *, zipped: bool, md5: object = None
) -> Iterator[pa.Table]:
    """Tables of the chosen columns: int64, float64 or string, in the file's order.

    where : the file, for messages. Raises BadInput naming row and column, and Damaged.
    """
    blocks = _whole_lines(bytes_of(path, zipped=zipped, md5=md5), where)
    names, declared, layout, blocks = _header(blocks, where, layout)
    chosen = choose_once(choose, names, declared, where, "header")
    take = _taker(names, chosen, where, layout)
    order = [name for name in names if name in chosen]
    parse = _parser(order, chosen, where, layout)
    waiting: list[Block] = []
    before = size = rows = 0
    for block in blocks:
        fields, count = take(block, before + rows)
        waiting.append(fields)
        size, rows = size + fields.size, rows + count
        if size >= TABLE_BYTES or rows >= TABLE_ROWS:
            yield parse(waiting, before)
            before, waiting, size, rows = before + rows, [], 0, 0
    if waiting:
        yield parse(waiting, before)


def _whole_lines(pieces: Iterable[bytes], where: str) -> Iterator[bytes]:
    """The same bytes in blocks that end with a line; the last line may lack its end."""
    rest = b""
    for piece in pieces:
        end = piece.rfind(b"\n") + 1
        if not end:
            rest += piece
            if len(rest) > LONGEST_LINE:
                allowed = f"lines of at most {LONGEST_LINE} bytes that end with LF or CR LF"
                raise BadInput(where, rest[:40], allowed)
            continue
        block = b"".join((rest, memoryview(piece)[:end]))
        _refuse_lone_returns(block, where)
        yield block
        rest = piece[end:]
    if rest:
        _refuse_lone_returns(rest + b"\n", where)
        yield rest + b"\n"


def _refuse_lone_returns(block: bytes, where: str) -> None:
    if b"\r" in block and block.count(b"\r") != block.count(b"\r\n"):
        at = re.search(rb"[^\r\n]{0,20}\r(?!\n)[^\r\n]{0,20}", block)
        raise BadInput(where, at.group() if at else b"\r", "lines that end with LF or CR LF")


def _header(
    blocks: Iterator[bytes], where: str, layout: Layout
) -> tuple[list[str], dict[str, str], Layout, Iterator[bytes]]:
    """Column names, the units and layout that the file itself states (ECSV), and the blocks from
    row 1 on."""
    comments = tuple(text.encode() for text in layout.comments)
    skipped: list[bytes] = []
    for block in blocks:
        start = len(BOM) if block.startswith(BOM) and not skipped else 0
        while start < len(block):
            end = block.index(b"\n", start) + 1
            line = block[start:end].strip(b"\r\n")
            if not line.strip() or (comments and line.startswith(comments)):
                skipped.append(line)
                start = end
                continue
            layout = _stated(skipped, layout)
            if layout.columns:
                names = list(layout.columns)
            else:
                names = _names(line, where, layout)
                start = end
            return names, units_of(skipped), layout, _chain(block[start:], blocks)
    raise BadInput(where, b"".join(skipped)[:40], "a table (this file has no line of one)")


def _chain(first: bytes, rest: Iterator[bytes]) -> Iterator[bytes]:
    if first:
        yield first
    yield from rest


def _stated(comments: list[bytes], layout: Layout) -> Layout:
    """An ECSV file says in its comments by what its fields are separated; by default a blank."""
    if not is_ecsv(comments):
        return layout
    for line in comments:
        if found := re.match(rb"# delimiter: (['\"]?)(.)\1\s*$", line):
            return replace(layout, delimiter=found.group(2).decode("latin-1"))
    return replace(layout, delimiter=" ")


def _names(line: bytes, where: str, layout: Layout) -> list[str]:
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        raise BadInput(where, line[:40], "a header line in UTF-8") from None
    if layout.text == "whitespace":
        return NO_BLANKS.findall(text)
    try:
        return [name.strip() for name in next(csv.reader([text], delimiter=layout.delimiter))]
    except csv.Error as error:
        raise BadInput(where, text[:40], f"a header line of names ({error})") from None


def _taker(
    names: list[str], chosen: dict[str, str], where: str, layout: Layout
) -> Callable[[bytes, int], tuple[Block, int]]:
    """A function from a block of lines, and the number of rows before it, to the wanted fields,
    one line a row, and the number of rows."""
    keep = [name in chosen for name in names]
    kept = [i for i, wanted in enumerate(keep) if wanted]
    quick = FieldTaker(keep, ord(layout.delimiter)) if layout.text == "delimited" else None

    def take(block: bytes, before: int) -> tuple[Block, int]:
        fields = quick.take(block) if quick is not None else None
        if fields is not None:
            return fields
        found = list(_by_line(block, names, kept, before, where, layout))
        text = io.StringIO()
        csv.writer(text, delimiter=layout.delimiter, lineterminator="\n").writerows(found)
        return np.frombuffer(text.getvalue().encode("latin-1"), np.uint8), len(found)

    return take


def _by_line(
    block: bytes, names: list[str], kept: list[int], before: int, where: str, layout: Layout
) -> Iterator[list[str]]:
    """The kept fields of each row. before : how many rows came before this block."""
    text = block.decode("latin-1")  # every byte stays itself
    if layout.text == "fixed":
        ranges = [layout.ranges[i] for i in kept]
        lines = (line for line in text.split("\n") if line.strip(BLANKS))
        for row, line in enumerate(lines, before + 1):
            yield _fixed(line.rstrip("\r"), ranges, row, where)
        return
    number = before
    for line in text.removesuffix("\n").split("\n"):
        fields = _fields(line, layout, f"{where} row {number + 1}")
        if not fields:
            continue
        number += 1
        if len(fields) != len(names):
            allowed = f"{len(names)} fields in a row"
            raise BadInput(f"{where} row {number}", f"{len(fields)} fields", allowed)
        yield [fields[i] for i in kept]


def _fields(line: str, layout: Layout, place: str) -> list[str]:
    if layout.text == "whitespace":
        return line.split() if line.isascii() else NO_BLANKS.findall(line)
    try:
        return next(csv.reader([line.rstrip("\r")], delimiter=layout.delimiter, strict=True), [])
    except csv.Error as error:
        allowed = f"quotes that end on their own line ({error})"
        raise BadInput(place, "quotes", allowed) from None


def _fixed(line: str, ranges: list[tuple[int, int]], row: int, where: str) -> list[str]:
    for first, last in ranges:
        if first <= len(line) < last:
            allowed = f"no line that ends within a column (bytes {first} to {last})"
            raise BadInput(f"{where} row {row}", f"{len(line)} bytes", allowed)
    return [line[first - 1 : last].strip(BLANKS) for first, last in ranges]


def _parser(
    order: list[str], chosen: dict[str, str], where: str, layout: Layout
) -> Callable[[list[Block], int], pa.Table]:
    """A function from blocks of fields, and the number of rows before them, to a table."""
    types = {"integer": pa.int64(), "number": pa.float64(), "text": pa.string()}
    parsing = pacsv.ParseOptions(delimiter=layout.delimiter, ignore_empty_lines=False)
    conversion = pacsv.ConvertOptions(
        column_types={name: types[chosen[name]] for name in order},
        null_values=[*NULL_TEXTS, *layout.nulls],
        strings_can_be_null=True,
        quoted_strings_can_be_null=True,
    )

    def parse(blocks: list[Block], before: int) -> pa.Table:
        data = np.concatenate(blocks)
        if not data.size:
            return pa.table({name: pa.array([], types[chosen[name]]) for name in order})
        reading = pacsv.ReadOptions(use_threads=False, block_size=data.size + 1, column_names=order)
        try:
            return pacsv.read_csv(pa.BufferReader(pa.py_buffer(data)), reading, parsing, conversion)
        except pa.ArrowInvalid as error:
            raise _refusal(str(error), order, chosen, before, where) from None

    return parse


def _refusal(
    text: str, order: list[str], chosen: dict[str, str], before: int, where: str
) -> BadInput:
    """Arrow's complaint as ours: its row and column counted in the file."""
    found = re.search(r"In CSV column #(\d+): (?:Row #(\d+): )?(.*)", text, re.DOTALL)
    if found is None:
        return BadInput(where, text[:200], "a well-formed table")
    column, row, why = found.groups()
    name = order[int(column)]
    value = re.search(r"invalid value '(.*)'", why, re.DOTALL)
    place = f"{where} {name}" + (f" row {before + int(row)}" if row else "")
    allowed = {
        "integer": "integers (ids that went through floating point are damaged: another column, "
        "such as designation, may hold them)",
        "number": "numbers",
        "text": "texts in UTF-8",
    }
    return BadInput(place, value.group(1) if value else why[:200], allowed[chosen[name]])
