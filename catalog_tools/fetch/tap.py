"""A cone by TAP as a file that ingest reads: never silently cut, its rows counted twice."""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from ..columns import NAMES
from ..coverage import Coverage
from ..errors import BadInput, Damaged, Incomplete
from .cones import FetchCone
from .layout import Release
from .ledger import FileLedger, file_md5
from .tap_service import Cut, TapService

COLUMNS = (*NAMES, "ref_epoch")
ROWS_AT_ONCE = 500_000  # a result is held in memory; the archive cuts at 3 million
MOST_ROWS = 20_000_000
NARROWEST_DEG = 1e-7
Tell = Callable[[int, int], None]  # rows done, rows of the cone


@dataclass(frozen=True)
class DeclinationBand:
    """Declinations from `low_deg` up to, but without, `high_deg`; None: no limit on that side."""

    low_deg: float | None = None
    high_deg: float | None = None

    def halves(self, cone: FetchCone) -> tuple[DeclinationBand, DeclinationBand]:
        """Two bands that hold every row of this one once; Incomplete where it is too narrow."""
        low = max(cone.dec_deg - cone.radius_deg, -90.0) if self.low_deg is None else self.low_deg
        high = min(cone.dec_deg + cone.radius_deg, 90.0) if self.high_deg is None else self.high_deg
        if high - low < NARROWEST_DEG:
            raise Incomplete(f"too many rows for one answer at declinations {low} to {high}")
        middle = 0.5 * (low + high)
        return replace(self, high_deg=middle), replace(self, low_deg=middle)


@dataclass(frozen=True)
class Question:
    """The rows of a release in a cone, asked of a service band by band."""

    service: TapService
    release: Release
    cone: FetchCone

    def count(self, band: DeclinationBand) -> int:
        """How many rows a band has."""
        table = self.service.ask(self._adql("COUNT(*) AS n", band), rows=1)
        if table.shape != (1, 1):
            raise Incomplete(f"{self.service.address}: COUNT(*) gave a table of {table.shape}")
        return int(table[0][0].as_py())

    def tables(
        self, band: DeclinationBand, rows: int, at_once: int, told: bool = False
    ) -> Iterator[pa.Table]:
        """The `rows` rows of a band, in parts of at most `at_once`.

        told : whether `at_once` is what the service gave when it cut a result. One that cuts even
        less is not believed: Incomplete.
        """
        if rows == 0:
            return
        if rows <= at_once:
            try:
                yield self._rows(band, rows)
                return
            except Cut as cut:
                if told or cut.rows == 0:
                    text = f"{self.service.address} gives {cut.rows} of {rows} rows"
                    raise Incomplete(f"{text}, and not always the same number") from None
                at_once, told = cut.rows, True
        for half in band.halves(self.cone):
            yield from self.tables(half, self.count(half), at_once, told)

    def _rows(self, band: DeclinationBand, rows: int) -> pa.Table:
        table = self.service.ask(self._adql(", ".join(COLUMNS), band), rows)
        if table.num_rows < rows:
            raise Cut(table.num_rows)
        if table.num_rows > rows:
            text = f"{table.num_rows} rows came where COUNT(*) says {rows}"
            raise Incomplete(f"{self.service.address}: {text}")
        if absent := [name for name in COLUMNS if name not in table.column_names]:
            raise Incomplete(f"{self.service.address}: the result has no column {absent[0]!r}")
        return table.select(COLUMNS)

    def _adql(self, what: str, band: DeclinationBand) -> str:
        return f"SELECT {what} FROM {self.release.table} WHERE {condition(self.cone, band)}"


def condition(cone: FetchCone, band: DeclinationBand) -> str:
    """What ADQL says of the rows of a cone within a band of declinations."""
    circle = f"CIRCLE('ICRS', {cone.ra_deg % 360.0!r}, {cone.dec_deg!r}, {cone.radius_deg!r})"
    terms = [f"1 = CONTAINS(POINT('ICRS', ra, dec), {circle})"]
    if cone.faintest_g_mag is not None:
        terms.append(f"phot_g_mean_mag <= {cone.faintest_g_mag!r}")
    if band.low_deg is not None:
        terms.append(f"dec >= {band.low_deg!r}")
    if band.high_deg is not None:
        terms.append(f"dec < {band.high_deg!r}")
    return " AND ".join(terms)


def file_name(release: Release, cone: FetchCone) -> str:
    """The name of a cone's file, which tells the release and the cone."""
    limit = "" if cone.faintest_g_mag is None else f"_g{cone.faintest_g_mag!r}"
    place = f"{cone.ra_deg % 360.0!r}_{cone.dec_deg!r}_{cone.radius_deg!r}"
    return f"{release.name}_cone_{place}{limit}.csv.gz"


def cone_coverage(release: Release, cone: FetchCone) -> Coverage:
    """What a cone's file covers: the cone, to its limit."""
    limit = math.inf if cone.faintest_g_mag is None else cone.faintest_g_mag
    cones = np.array([[cone.ra_deg, cone.dec_deg, cone.radius_deg, limit]])
    return Coverage(f"fetched cones of {release.title}", cones=cones)


def fetch_cone(
    service: TapService, release: Release, cone: FetchCone, ledger: FileLedger, tell: Tell
) -> None:
    """Ask for a cone and publish its file in the ledger's folder, a gzipped CSV.

    The service's COUNT(*) must equal the rows received, and these the lines of the file. Raises
    Incomplete, BadInput (a cone too large, no such service), Damaged (the file on disk).
    """
    question, name = Question(service, release, cone), file_name(release, cone)
    total = question.count(DeclinationBand())
    if total > MOST_ROWS:
        allowed = f"at most {MOST_ROWS} rows by TAP (here are {total}): fetch the archive's files"
        raise BadInput("cone", str(cone), allowed)
    part, done = ledger.part(name), 0
    tell(done, total)
    with part.open("wb") as raw, gzip.GzipFile("", "wb", 6, raw, mtime=0) as file:
        file.write(_head(question, total).encode())
        for table in question.tables(DeclinationBand(), total, ROWS_AT_ONCE):
            _write_rows(table, file)
            done += table.num_rows
            tell(done, total)
    if done != total:
        raise Incomplete(f"{service.address}: {done} rows came where COUNT(*) says {total}")
    if (lines := _data_lines(part)) != total:
        raise Damaged(str(part), f"it has {lines} rows, {total} were written")
    ledger.publish(name, file_md5(part))


def _head(question: Question, rows: int) -> str:
    """Comment lines that say what the file is, and the names of the columns."""
    release, adql = question.release, question._adql("...", DeclinationBand())
    return (
        f"# {release.title} (ESA/Gaia/DPAC), positions at J{release.ref_epoch_jyear}; {rows} rows\n"
        f"# {question.service.address}: {adql}\n" + ",".join(COLUMNS) + "\n"
    )


def _write_rows(table: pa.Table, file: gzip.GzipFile) -> None:
    """Doubles in the shortest form that gives them back; float32 values thus exactly, too."""
    options = pacsv.WriteOptions(include_header=False, quoting_style="none")
    pacsv.write_csv(table, pa.PythonFile(file, mode="w"), options)


def _data_lines(path: Path) -> int:
    with gzip.open(path, "rb") as file:
        return sum(not line.startswith(b"#") for line in file) - 1
