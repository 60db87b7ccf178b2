"""Before a request: is it for us, from our own page; around it: deadlines, numbers, a log line."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from urllib.parse import urlsplit

from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import problems
from service.metrics import Numbers
from service.settings import Settings

log = logging.getLogger("nightglass.requests")
SAFE = ("GET", "HEAD", "OPTIONS")
DEADLINE = "nightglass.deadline"
Answer = Callable[[Request, Exception], Awaitable[Response]]


def _place_of(origin: bytes) -> str | None:
    """Host and port of an origin; None of what is no address."""
    try:
        return urlsplit(origin.decode("latin-1")).netloc.lower()
    except ValueError:
        return None


class Gate:
    """The outermost layer of the application."""

    def __init__(self, app: ASGIApp, settings: Settings, numbers: Numbers, problem: Answer) -> None:
        self.app, self.settings, self.numbers, self.problem = app, settings, numbers, problem

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        began, status, inside = time.perf_counter(), 0, True
        headers = dict(scope["headers"])

        async def told(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                if inside:
                    deadline.reschedule(None)
                self._count(scope, status, time.perf_counter() - began)
            async with asyncio.timeout(self.settings.send_s):
                await send(message)

        problem: Exception | None = None
        try:
            async with asyncio.timeout(self.settings.answer_s) as deadline:
                scope[DEADLINE] = deadline
                self._check(scope["method"], headers)
                await self.app(scope, receive, told)
        except TimeoutError:
            if status:  # the client does not take its answer: the connection ends with this
                return
            problem = problems.Overloaded("the answer could not be made in time")
        except Exception as error:
            if status:
                raise
            problem = error
        inside = False
        if problem is not None:
            answer = await self.problem(Request(scope), problem)
            await answer(scope, receive, told)

    def _check(self, method: str, headers: dict[bytes, bytes]) -> None:
        """UnknownHost against DNS rebinding, Forbidden for what other people's pages send."""
        host = headers.get(b"host", b"").decode("latin-1").lower()
        bare = host if host.endswith("]") else host.rpartition(":")[0] or host
        if "*" not in self.settings.hosts and bare not in self.settings.hosts:
            raise problems.UnknownHost(f"this service is called {' or '.join(self.settings.hosts)}")
        if method in SAFE:
            return
        site = headers.get(b"sec-fetch-site", b"none")
        origin = headers.get(b"origin")
        foreign = origin is not None and _place_of(origin) != host
        if site not in (b"none", b"same-origin") or foreign:
            raise problems.Forbidden("another site's page may not change anything here")

    def _count(self, scope: Scope, status: int, seconds: float) -> None:
        method = scope["method"] if scope["method"] in KNOWN else "OTHER"
        self.numbers.answers.labels(method, str(status)).inc()
        route = getattr(scope.get("route"), "path", "none")
        self.numbers.seconds.labels(route).observe(seconds)
        level = logging.INFO if status >= 400 else logging.DEBUG
        if log.isEnabledFor(level):
            log.log(
                level,
                "answered",
                extra={
                    "method": method,
                    "path": route,
                    "status": status,
                    "ms": round(seconds * 1000, 1),
                    "team": scope.get("state", {}).get("team"),
                    "job": (scope.get("path_params") or {}).get("job_id", "")[:64] or None,
                },
            )


KNOWN = ("GET", "HEAD", "OPTIONS", "POST", "PUT", "PATCH", "DELETE")


def allow_time(request: Request, seconds: float) -> None:
    """Move the deadline of a request: it may take this much longer from now on."""
    deadline = request.scope.get(DEADLINE)
    if deadline is not None:
        deadline.reschedule(asyncio.get_running_loop().time() + seconds)
