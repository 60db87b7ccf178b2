"""A TAP service on a local web server: sync, async (UWS 1.1), VOTables; ADQL run by SQLite.

Enough of TAP 1.1 for pyvo's own client. Geometry is told by astropy, rows by SQLite, so that what
the client asks for is carried out by code that knows nothing of the client.
"""

from __future__ import annotations

import io
import re
import sqlite3
import threading
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler
from typing import Any
from urllib.parse import parse_qs, urlsplit

import astropy.units as u
import numpy as np
import pyarrow as pa
from archive_server import QuietServer
from astropy.coordinates import SkyCoord
from astropy.io.votable import from_table
from astropy.io.votable.tree import Info
from astropy.table import MaskedColumn, Table

from catalog_tools.columns import INCOMING

CONTAINS = re.compile(
    r"CONTAINS\(POINT\('ICRS', (\w+), (\w+)\), CIRCLE\('ICRS', ([^,]+), ([^,]+), ([^)]+)\)\)"
)
UWS = """<?xml version="1.0" encoding="UTF-8"?>
<uws:job xmlns:uws="http://www.ivoa.net/xml/UWS/v1.0" version="1.1"
 xmlns:xlink="http://www.w3.org/1999/xlink" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">
<uws:jobId>{job}</uws:jobId><uws:ownerId xsi:nil="true"/><uws:phase>{phase}</uws:phase>
<uws:quote xsi:nil="true"/><uws:executionDuration>7200</uws:executionDuration>
<uws:destruction xsi:nil="true"/><uws:parameters/><uws:results>{results}</uws:results>{error}
</uws:job>"""
RESULT = '<uws:result id="result" xlink:href="{url}/results/result"/>'
ERROR = '<uws:errorSummary type="fatal"><uws:message>{text}</uws:message></uws:errorSummary>'


@dataclass
class TapBehaviour:
    """What the service does wrong. most_rows : the hard limit of a result."""

    most_rows: int = 10**9
    tells_overflow: bool = True
    lost_rows: int = 0  # missing from each result but COUNT(*), silently
    sync_fails: int = 0
    job_fails: str = ""  # the message of every job's end
    cut_results: int = 0  # so many results end in the middle of the XML
    busy_looks: int = 0  # so many looks at a job that runs are answered with 503
    first: list[tuple[int, dict[str, str]]] = field(default_factory=list)


@dataclass
class Job:
    """An asynchronous job."""

    form: dict[str, str]
    phase: str = "PENDING"
    looks: int = 0


class TapServer:
    """Serves `rows` (schema INCOMING) as SCHEMA.gaia_source at `url`, from a thread."""

    def __init__(self, rows: pa.Table, ref_epoch: float = 2015.5, schema: str = "gaiadr2") -> None:
        self.does, self.jobs = TapBehaviour(), dict[str, Job]()
        self.queries: list[tuple[str, str]] = []
        self.deleted = 0
        self._lock = threading.Lock()
        self._base = sqlite3.connect(":memory:", check_same_thread=False)
        self._base.execute(f"ATTACH ':memory:' AS {schema}")
        columns = [*INCOMING.names, "ref_epoch"]
        self._base.execute(f"CREATE TABLE {schema}.gaia_source ({', '.join(columns)})")
        records = [(*row.values(), ref_epoch) for row in rows.to_pylist()]
        marks = ", ".join("?" * len(columns))
        self._base.executemany(f"INSERT INTO {schema}.gaia_source VALUES ({marks})", records)
        self._sky = SkyCoord(rows["ra"].to_numpy() * u.deg, rows["dec"].to_numpy() * u.deg)
        self._ids = rows["source_id"].to_pylist()
        self._circles: list[str] = []

    def __enter__(self) -> TapServer:
        handler = type("Handler", (_Handler,), {"tap": self})
        self._http = QuietServer(("127.0.0.1", 0), handler)
        self.url = f"http://127.0.0.1:{self._http.server_port}/tap"
        threading.Thread(target=self._http.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._http.shutdown()
        self._http.server_close()

    def run(self, form: dict[str, str]) -> bytes:
        """The VOTable of a query; ValueError for one that can't be run."""
        with self._lock:
            try:
                cursor = self._base.execute(CONTAINS.sub(self._inside, form["QUERY"]))
                names = [column[0] for column in cursor.description]
                rows = cursor.fetchall()
            except sqlite3.Error as error:
                raise ValueError(str(error)) from error
        if names != ["n"]:
            rows = rows[: len(rows) - self.does.lost_rows]
        limit = min(int(form.get("MAXREC", 2_000)), self.does.most_rows)
        status = "OVERFLOW" if len(rows) > limit and self.does.tells_overflow else "OK"
        return votable(names, rows[:limit], status)

    def _inside(self, match: re.Match[str]) -> str:
        """1 or 0 for a row, as CONTAINS gives it; the geometry is done once for a circle."""
        if match[0] not in self._circles:
            self._make_circle(match)
            self._circles.append(match[0])
        return f"(source_id IN (SELECT id FROM circle{self._circles.index(match[0])}))"

    def _make_circle(self, match: re.Match[str]) -> None:
        ra, dec, radius = (float(match[i]) for i in (3, 4, 5))
        apart = self._sky.separation(SkyCoord(ra * u.deg, dec * u.deg))
        ids = [i for i, near in zip(self._ids, apart <= radius * u.deg, strict=True) if near]
        self._base.execute(f"CREATE TEMP TABLE circle{len(self._circles)} (id INTEGER PRIMARY KEY)")
        insert = f"INSERT INTO circle{len(self._circles)} VALUES (?)"
        self._base.executemany(insert, [(i,) for i in ids])


def votable(names: list[str], rows: list[tuple], status: str) -> bytes:
    table = Table()
    for i, name in enumerate(names):
        kind = INCOMING.field(name).type if name in INCOMING.names else None
        dtype = "f4" if kind == pa.float32() else "f8" if kind == pa.float64() else "i8"
        dtype = "f8" if name == "ref_epoch" else "U8" if name == "name" else dtype
        absent = [row[i] is None for row in rows]
        values = np.array([0 if row[i] is None else row[i] for row in rows], dtype)
        table[name] = MaskedColumn(values, mask=absent)
    document = from_table(table)
    document.resources[0].type = "results"
    document.resources[0].infos.append(Info(name="QUERY_STATUS", value=status))
    document.set_all_tables_format("binary2")
    out = io.BytesIO()
    document.to_xml(out)
    return out.getvalue()


class _Handler(BaseHTTPRequestHandler):
    tap: TapServer
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # else 40 ms an answer

    def log_message(self, *_: Any) -> None:
        """Quiet."""

    def do_GET(self) -> None:
        parts = urlsplit(self.path)
        if self._is_told_otherwise():
            return
        if parts.path == "/tap/sync":
            self._sync({k: v[0] for k, v in parse_qs(parts.query).items()})
        elif match := re.fullmatch(r"/tap/async/(\w+)(/results/result)?", parts.path):
            self._job(match[1], result=bool(match[2]))
        else:
            self._send(404, b"", "text/plain")

    def do_POST(self) -> None:
        length = int(self.headers.get("Content-Length", 0))
        form = {k: v[0] for k, v in parse_qs(self.rfile.read(length).decode()).items()}
        tap, path = self.tap, urlsplit(self.path).path
        if self._is_told_otherwise():
            return
        if path == "/tap/sync":
            self._sync(form)
        elif path == "/tap/async":
            name = f"job{len(tap.jobs)}"
            tap.jobs[name] = Job(form)
            tap.queries.append(("async", form["QUERY"]))
            self._send(303, b"", "text/plain", {"Location": f"{tap.url}/async/{name}"})
        elif match := re.fullmatch(r"/tap/async/(\w+)/phase", path):
            tap.jobs[match[1]].phase = "QUEUED"
            self._send(303, b"", "text/plain", {"Location": f"{tap.url}/async/{match[1]}"})
        else:
            self._send(404, b"", "text/plain")

    def do_DELETE(self) -> None:
        self.tap.deleted += 1
        self._send(303, b"", "text/plain", {"Location": f"{self.tap.url}/async"})

    def _is_told_otherwise(self) -> bool:
        if not self.tap.does.first:
            return False
        status, headers = self.tap.does.first.pop(0)
        self._send(status, b"busy", "text/plain", headers)
        return True

    def _sync(self, form: dict[str, str]) -> None:
        self.tap.queries.append(("sync", form["QUERY"]))
        if self.tap.does.sync_fails:
            self.tap.does.sync_fails -= 1
            self._send(500, b"too long a query", "text/plain")
            return
        try:
            self._send_result(self.tap.run(form))
        except ValueError as error:
            info = f'<INFO name="QUERY_STATUS" value="ERROR">{error}</INFO>'
            text = f'<VOTABLE version="1.3"><RESOURCE type="results">{info}</RESOURCE></VOTABLE>'
            self._send(400, text.encode(), "application/x-votable+xml")

    def _job(self, name: str, *, result: bool) -> None:
        job = self.tap.jobs[name]
        if result:
            self._send_result(self.tap.run(job.form))
            return
        if job.looks and self.tap.does.busy_looks:
            self.tap.does.busy_looks -= 1
            self._send(503, b"busy", "text/plain")
            return
        fault = self.tap.does.job_fails
        if job.phase != "PENDING":
            job.looks += 1
            try:
                self.tap.run(job.form)
            except ValueError as error:
                fault = str(error)
            job.phase = ("EXECUTING", "ERROR" if fault else "COMPLETED")[job.looks > 2]
        url = f"{self.tap.url}/async/{name}"
        text = UWS.format(
            job=name, phase=job.phase,
            results=RESULT.format(url=url) if job.phase == "COMPLETED" else "",
            error=ERROR.format(text=fault) if job.phase == "ERROR" else "",
        )  # fmt: skip
        self._send(200, text.encode(), "text/xml")

    def _send_result(self, content: bytes) -> None:
        if self.tap.does.cut_results:
            self.tap.does.cut_results -= 1
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content[: len(content) // 2])
            self.close_connection = True
            return
        self._send(200, content, "application/x-votable+xml")

    def _send(
        self, status: int, content: bytes, kind: str, headers: dict[str, str] | None = None
    ) -> None:
        self.send_response(status)
        for key, value in {"Content-Type": kind, **(headers or {})}.items():
            self.send_header(key, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)
