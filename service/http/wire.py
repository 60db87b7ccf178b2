"""Connections that say nothing, or never stop saying who they are, are closed."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEAD_BYTES = 1 << 16
TOO_LARGE = (
    b"HTTP/1.1 431 Request Header Fields Too Large\r\nconnection: close\r\n"
    b"content-type: application/problem+json\r\ncontent-length: 61\r\n\r\n"
    b'{"title":"Request Header Fields Too Large","status":431}     '
)


class BoundedHttp(HttpToolsProtocol):
    """uvicorn's HTTP with a limit on the time and bytes of a request's head.

    It holds from the moment a connection opens, and again from the first byte after an answer; a
    body that nobody reads must also come to its end in that time.
    """

    head_s = 10.0
    _timer: asyncio.TimerHandle | None = None
    _head_bytes = 0
    _in_head = True

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._start()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if self._in_head or self.cycle.response_complete:
            if self._timer is None:
                self._start()
            self._head_bytes += len(data)
        super().data_received(data)
        if self._in_head and self._head_bytes > HEAD_BYTES and self.parser is not None:
            self.transport.write(TOO_LARGE)
            self.transport.close()

    def on_message_begin(self) -> None:
        self._in_head = True
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        self._in_head, self._head_bytes = False, 0
        self._stop()
        super().on_headers_complete()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if self.cycle is not None and self.cycle.more_body and not self.transport.is_closing():
            self._start()

    def on_message_complete(self) -> None:
        super().on_message_complete()
        self._head_bytes = 0  # what came after an early answer was a body
        self._stop()

    def _start(self) -> None:
        self._stop()
        self._timer = self.loop.call_later(self.head_s, self._give_up)

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _give_up(self) -> None:
        self._timer = None
        if not self.transport.is_closing():
            self.transport.close()


def bounded(head_s: float) -> type[asyncio.Protocol]:
    """The protocol class with a limit of its own."""
    return type("BoundedProtocol", (BoundedHttp,), {"head_s": head_s})
