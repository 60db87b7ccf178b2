"""A TAP service that is asked with patience, through pyvo's client; answers as Arrow tables."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from threading import Event
from typing import Any
from xml.parsers.expat import ExpatError

import numpy as np
import pyarrow as pa
import pyvo
import requests
import urllib3

from ..errors import BadInput, Incomplete
from .patience import Patience, Unavailable
from .remote import MOST_REDIRECTS, PASSING, plain, retry_after_s, without_password

SYNC_ROWS = 2_000  # as many as the archive gives without a job
LONGEST_POLL_S = 10.0
LONGEST_JOB_S = 7_200.0
ENDS = ("COMPLETED", "ERROR", "ABORTED")


class Cut(Exception):
    """The service gave only `rows` rows of more (QUERY_STATUS OVERFLOW)."""

    def __init__(self, rows: int) -> None:
        super().__init__(rows)
        self.rows = rows


class TapService:
    """A service's ADQL door; BadInput for an address that is not one."""

    def __init__(self, url: str, patience: Patience) -> None:
        if not url.startswith(("http://", "https://")):
            raise BadInput("tap_url", url, "an http:// or https:// address of a TAP service")
        self.address = without_password(url)
        self._patience = patience
        session = _Session(patience.connect_s, patience.silence_s)
        self._tap = pyvo.dal.TAPService(url.rstrip("/"), session=session)

    def ask(self, adql: str, rows: int) -> pa.Table:
        """The result of a query that is to give at most `rows` rows.

        A small one is asked for at once, and as a job only if that fails. Floats come as float64,
        absent values and NaN as null. Raises Cut, Incomplete, BadInput for what is no TAP service.
        """
        if rows <= SYNC_ROWS:
            with suppress(Incomplete):
                hasty = replace(self._patience, tries=min(2, self._patience.tries))
                return self._trying(lambda: self._tap.run_sync(adql, maxrec=rows + 1), hasty)
        return self._trying(lambda: self._run_job(adql, rows + 1), self._patience)

    def _trying(self, query: Callable[[], object], patience: Patience) -> pa.Table:
        failures = 0
        while True:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter(
                        "ignore"
                    )  # of units and overflow: the latter is looked at
                    return _arrow(query())
            except pyvo.DALQueryError as error:
                text = f"{self.address}: the query was refused: {str(error)[:300]}"
                raise Incomplete(text) from None
            except pyvo.DALServiceError as error:
                failure = self._judge(error)
            except (
                pyvo.DALAccessError, requests.RequestException, urllib3.exceptions.HTTPError,
                OSError, ValueError, SyntaxError, ExpatError,
            ) as error:  # fmt: skip  # (a VOTable that ends too early has many ways to fail)
                failure = Unavailable(plain(error))
            failures += 1
            patience.wait(self.address, failure, failures, Event())

    def _judge(self, error: pyvo.DALServiceError) -> Unavailable:
        """A failure that may pass; any other status below 500 says that here is no such service."""
        code = error.code or 0
        if 400 <= code < 500 and code not in PASSING:
            raise BadInput("tap_url", self.address, f"a TAP service (it answers {code})") from None
        response = getattr(error.cause, "response", None)
        headers = {} if response is None else response.headers
        return Unavailable(plain(error), retry_after_s(headers.get("Retry-After")))

    def _run_job(self, adql: str, most_rows: int) -> object:
        """Run an asynchronous job to its end; it is removed from the service in any case."""
        job = self._tap.submit_job(adql, maxrec=most_rows)
        try:
            job.run()
            self._await(job)
            job.raise_if_error()
            return job.fetch_result()
        finally:
            with suppress(pyvo.DALAccessError, requests.RequestException):
                job.delete()

    def _await(self, job: pyvo.dal.AsyncTAPJob) -> None:
        pause_s, end, failures = self._patience.first_delay_s, time.monotonic() + LONGEST_JOB_S, 0
        while True:
            try:
                if job.phase in ENDS:
                    return
                failures = 0
            except pyvo.DALServiceError:
                failures += 1
                if failures >= self._patience.tries:
                    raise
            if time.monotonic() > end:
                raise Incomplete(f"{self.address}: a job did not end within {LONGEST_JOB_S:.0f} s")
            time.sleep(pause_s)
            pause_s = min(1.5 * pause_s, LONGEST_POLL_S)


class _Session(requests.Session):
    """A session in which no request waits for ever."""

    def __init__(self, connect_s: float, silence_s: float) -> None:
        super().__init__()
        self.max_redirects = MOST_REDIRECTS
        self.headers["User-Agent"] = "nightglass"
        self._timeout = (connect_s, silence_s)

    def request(self, *args: Any, **kwargs: Any) -> requests.Response:
        if kwargs.get("timeout") is None:
            kwargs["timeout"] = self._timeout
        return super().request(*args, **kwargs)


def _arrow(result: pyvo.dal.TAPResults) -> pa.Table:
    """A TAP result as an Arrow table, names in lower case."""
    table = result.to_table()
    if str(result.query_status).upper() == "OVERFLOW":
        raise Cut(len(table))
    columns = {}
    for name in table.colnames:
        data = np.ma.asarray(table[name])
        if data.dtype.kind in "iu":
            columns[name.lower()] = pa.array(data.data.astype(np.int64), mask=data.mask.copy())
        elif data.dtype.kind == "f":
            values = np.ma.filled(data.astype(np.float64), np.nan)
            columns[name.lower()] = pa.array(values, from_pandas=True)
        else:
            raise Incomplete(f"the TAP service gives column {name!r} as {data.dtype}, not numbers")
    return pa.table(columns)
