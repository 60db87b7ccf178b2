"""The time and bytes that a request's head may take, byte by byte on one connection."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import uvicorn
from uvicorn.server import ServerState

from service.http.wire import HEAD_BYTES, bounded

HEAD_S = 7.25  # no other timer's
GET = b"GET / HTTP/1.1\r\nhost: x\r\n\r\n"


class Talk:
    """A connection without a network, whose timers wait until they are told to ring."""

    def __init__(self) -> None:
        self.loop, self.timers = asyncio.get_running_loop(), list[Any]()
        config = uvicorn.Config(_early, log_config=None, ws="none")
        config.load()
        self.wire: Any = SimpleNamespace(sent=b"", closed=False)
        self.wire.write = lambda data: setattr(self.wire, "sent", self.wire.sent + data)
        self.wire.close = lambda: setattr(self.wire, "closed", True)
        self.wire.is_closing = lambda: self.wire.closed
        self.wire.get_extra_info = lambda *_: None
        for name in ("set_write_buffer_limits", "pause_reading", "resume_reading", "set_protocol"):
            setattr(self.wire, name, lambda *_: None)
        here = SimpleNamespace(call_later=self._call_later, create_task=self.loop.create_task)
        self._protocol: Any = bounded(HEAD_S)(config, ServerState(), {}, here)  # type: ignore[call-arg]
        self._protocol.connection_made(self.wire)

    def _call_later(self, after_s: float, call: Callable[..., Any], *given: Any) -> Any:
        timer: Any = SimpleNamespace(after_s=after_s, call=call, given=given, on=True)
        timer.cancel = lambda: setattr(timer, "on", False)
        self.timers.append(timer)
        return timer

    async def send(self, *pieces: bytes) -> int:
        """How many deadlines of a head run when the pieces are read and answered."""
        for piece in pieces:
            self._protocol.data_received(piece)
            for _ in range(9):
                await asyncio.sleep(0)
        return len(self.running())

    def running(self) -> list[Any]:
        return [t for t in self.timers if t.on and t.after_s == HEAD_S]


async def _early(scope: Any, _: Any, send: Any) -> None:
    """Answers without reading the body."""
    await send({"type": "http.response.start", "status": 204, "headers": []})
    await send({"type": "http.response.body", "body": b""})


def test_one_deadline_runs_for_each_head_and_each_unread_body() -> None:
    """From the opening to the head's end, from the next request's first byte on, and after an
    answer to the end of a body that nobody reads; when it comes, the connection is closed."""

    async def talk() -> None:
        post = b"POST / HTTP/1.1\r\nhost: x\r\ncontent-length: 6\r\n\r\nabc"
        one = Talk()
        assert await one.send() == 1
        assert await one.send(GET[:9], GET[9:-2]) == 1
        assert await one.send(GET[-2:]) == 0
        assert await one.send(GET[:1]) == 1
        assert await one.send(GET[1:]) == 0
        assert await one.send(post) == 1
        assert await one.send(b"de") == 1
        assert await one.send(b"f") == 0
        assert await one.send(GET) == 0
        assert (one.wire.closed, one.wire.sent.count(b"HTTP/1.1 204")) == (False, 4)
        await one.send(post)
        [deadline] = one.running()
        deadline.call(*deadline.given)
        assert one.wire.closed

    asyncio.run(talk())


def test_bytes_of_a_head_are_counted_anew_for_each_request() -> None:
    """Heads of three quarters of what is allowed, one after the other, and one byte too many."""

    async def talk() -> None:
        one, start = Talk(), GET[:-2] + b"x: "
        long = start + b"y" * (3 * HEAD_BYTES // 4)
        for _ in range(3):
            await one.send(long[:50], long[50:], b"\r\n\r\n")
        assert (one.wire.closed, one.wire.sent.count(b"HTTP/1.1 204")) == (False, 3)
        await one.send(start, b"y" * (HEAD_BYTES - len(start)))
        assert not one.wire.closed
        await one.send(b"y")
        assert one.wire.closed
        assert one.wire.sent.count(b"HTTP/1.1 431") == 1

    asyncio.run(talk())


def test_a_body_that_nobody_read_is_not_counted_as_the_next_head() -> None:
    async def talk() -> None:
        one, size = Talk(), 2 * HEAD_BYTES
        await one.send(b"POST / HTTP/1.1\r\nhost: x\r\ncontent-length: %d\r\n\r\n" % size)
        await one.send(b"a" * (size - 1), b"a", GET[:9], GET[9:])
        assert (one.wire.closed, one.wire.sent.count(b"HTTP/1.1 204")) == (False, 2)

    asyncio.run(talk())
