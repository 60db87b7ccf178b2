"""What kind of file this is, told from its first bytes."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

from ..errors import BadInput, Damaged

# From the columns of a table, and the units that it declares for some of them, to the columns to
# read, each as `integer`, `number` or `text`.
Choose = Callable[[list[str], Mapping[str, str]], dict[str, str]]

GZIP = b"\x1f\x8b"
BOM = b"\xef\xbb\xbf"
HEAD_BYTES = 4096
KINDS = "a CSV or other text table, FITS, VOTable, Parquet or SQLite file"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


def kind_of(path: str | Path, field: str = "source") -> str:
    """`csv` (any text table), `fits`, `votable`, each also with `.gz`; `parquet` or `sqlite`.

    Raises BadInput where the file cannot be read, is empty or of no known kind, and Damaged where
    its gzip stream breaks off at once.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise BadInput(field, str(path), f"a file that can be read ({error.strerror})") from None
    zipped = head.startswith(GZIP)
    if zipped:
        head = _unzipped(path, head)
    kind = _kind(head)
    if kind is None or (zipped and kind in ("parquet", "sqlite")):
        why = "is empty" if not head.removeprefix(BOM).strip() else "is of no known kind"
        if kind is not None:
            why = f"is a gzipped {kind} file: unpack it first"
        raise BadInput(field, str(path), f"{KINDS} (this one {why})")
    return f"{kind}.gz" if zipped else kind


def _unzipped(path: Path, head: bytes) -> bytes:
    try:
        return zlib.decompressobj(wbits=31).decompress(head, HEAD_BYTES)
    except zlib.error as error:
        raise Damaged(str(path), f"its gzip stream cannot be read ({error})") from None


def _kind(head: bytes) -> str | None:
    if head.startswith(b"SIMPLE  ="):
        return "fits"
    if head.startswith(b"PAR1"):
        return "parquet"
    if head.startswith(b"SQLite format 3\0"):
        return "sqlite"
    text = head.removeprefix(BOM).lstrip()
    if b"<VOTABLE" in head.upper() or text.startswith(b"<?xml"):
        return "votable"
    if not text or b"\0" in head or head.startswith(_UTF16):
        return None
    return "csv"


def choose_once(
    choose: Choose, names: list[str], declared: Mapping[str, str], where: str, what: str = "table"
) -> dict[str, str]:
    """The columns that are chosen of some. BadInput for one whose name stands twice."""
    chosen = choose(names, declared)
    if twice := [name for name in chosen if names.count(name) > 1]:
        raise BadInput(where, twice, f"a {what} that has each of these columns once")
    return chosen
