"""A web server with the archive's layout, whose every misbehaviour a test can choose."""

from __future__ import annotations

import hashlib
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import unquote

import numpy as np

FOLDER = "/Gaia/gdr2/gaia_source/csv/"
BLOCK = 4096
# Names as the archive has them: files break between order-12 pixels.
PIXELS = [(0, 700), (701, 1500), (1501, 29_108_840), (29_108_841, 29_116_187), (29_116_188, 10**8)]


def small_archive(seed: int = 1) -> dict[str, bytes]:
    """Files by name, without their list."""
    rng = np.random.default_rng(seed)
    files = {}
    for first, last in PIXELS:
        name = f"GaiaSource_{(first << 35) + 4_294_967_296}_{(last << 35) + 1024}.csv.gz"
        files[name] = rng.bytes(int(rng.integers(30_000, 70_000)))
    return files


def md5sum_text(files: dict[str, bytes]) -> str:
    """The list that lies beside the files, with the two names that hold no rows."""
    extra = {"_citation.txt": b"cite", "_disclaimer.txt": b"none"}
    lines = [f"{hashlib.md5(data).hexdigest()}  {n}" for n, data in {**extra, **files}.items()]
    return "\n".join(lines) + "\n"


@dataclass
class Request:
    """One request as it came, and the bytes of the body that went out."""

    method: str
    name: str
    range: str | None
    if_range: str | None
    sent: int = 0


@dataclass
class Behaviour:
    """What the server does. cut(name, start) : bytes of the body after which it hangs up."""

    ranges: bool = True
    etags: dict[str, str | None] = field(default_factory=dict)
    cut: Callable[[str, int], int | None] = lambda name, start: None
    # Answers given first, by name: (status, headers), each once.
    first: dict[str, list[tuple[int, dict[str, str]]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    slow_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    block_s: float = 0.0
    index: bool = True
    lengths: bool = True
    content_encoding: str | None = None


class QuietServer(ThreadingHTTPServer):
    """A server to which a connection that its client closes is nothing to report."""

    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Quiet."""


class ArchiveServer:
    """Serves `files` and their MD5SUM.txt at `base_url` from a thread."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self.files, self.md5sum = dict(files), md5sum_text(files)
        self.does = Behaviour()
        self.requests: list[Request] = []

    def __enter__(self) -> ArchiveServer:
        handler = type("Handler", (_Handler,), {"archive": self})
        self._http = QuietServer(("127.0.0.1", 0), handler)
        self.origin = f"http://127.0.0.1:{self._http.server_port}"
        self.base_url = self.origin + FOLDER
        threading.Thread(target=self._http.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._http.shutdown()
        self._http.server_close()

    def content(self, name: str) -> bytes | None:
        if name == "MD5SUM.txt":
            return self.md5sum.encode()
        if name == "" and self.does.index:
            return self.index_page().encode()
        return self.files.get(name)

    def index_page(self) -> str:
        """As nginx writes it: long names are cut where they are shown."""
        rows = [
            f'<a href="{n}">{n[:47]}..&gt;</a> 16-Apr-2018 07:32  {len(data):>18}\r\n'
            for n, data in self.files.items()
        ]
        head = '<html><body><h1>Index of</h1><hr><pre><a href="../">../</a>\r\n'
        return head + "".join(rows) + "</pre><hr></body></html>\r\n"

    def gets(self, name: str) -> list[Request]:
        return [r for r in self.requests if r.method == "GET" and r.name == name]

    def sent(self) -> int:
        """Bytes of rows' files that went out."""
        return sum(r.sent for r in self.requests if r.name in self.files)


class _Handler(BaseHTTPRequestHandler):
    archive: ArchiveServer
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # else 40 ms an answer

    def log_message(self, *_: Any) -> None:
        """Quiet."""

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def do_GET(self) -> None:
        self._answer(body=True)

    def _answer(self, body: bool) -> None:
        does, name = self.archive.does, unquote(self.path).removeprefix(FOLDER)
        request = Request(
            self.command, name, self.headers.get("Range"), self.headers.get("If-Range")
        )
        self.archive.requests.append(request)
        if self.headers.get("Accept-Encoding") != "identity":  # other forms have other ranges
            self._head(406, {"Content-Length": "0"})
            return
        if body and does.first[name]:
            status, headers = does.first[name].pop(0)
            self._head(status, headers | {"Content-Length": "0"})
            return
        if body and does.slow_s[name]:
            time.sleep(does.slow_s[name].pop(0))
        data = self.archive.content(name)
        if data is None:
            self._head(404, {"Content-Length": "0"})
            return
        etag = does.etags.get(name, f'"{hashlib.sha1(data).hexdigest()[:12]}"')
        start = self._start(request, etag) if does.ranges else 0
        if start and start >= len(data):
            self._head(416, {"Content-Range": f"bytes */{len(data)}", "Content-Length": "0"})
            return
        headers = {"Content-Length": str(len(data) - start)} if does.lengths else {}
        headers |= {"ETag": etag} if etag else {}
        headers |= {"Content-Encoding": does.content_encoding} if does.content_encoding else {}
        headers |= {} if does.lengths else {"Connection": "close"}
        if start:
            headers["Content-Range"] = f"bytes {start}-{len(data) - 1}/{len(data)}"
        self._head(206 if start else 200, headers)
        if body:
            self._send(request, data[start:], does.cut(name, start))

    def _start(self, request: Request, etag: str | None) -> int:
        if request.range is None or (request.if_range and request.if_range != etag):
            return 0
        return int(request.range.removeprefix("bytes=").split("-")[0])

    def _head(self, status: int, headers: dict[str, str]) -> None:
        self.send_response(status)
        for key, value in headers.items():
            self.send_header(key, value)
        self.end_headers()

    def _send(self, request: Request, data: bytes, cut: int | None) -> None:
        whole = data if cut is None else data[:cut]
        try:
            for at in range(0, len(whole), BLOCK):
                request.sent += len(whole[at : at + BLOCK])
                self.wfile.write(whole[at : at + BLOCK])
                time.sleep(self.archive.does.block_s)
        except OSError:
            self.close_connection = True
        if cut is not None and cut < len(data):
            self.close_connection = True
