"""Build the FastAPI app: routers, lifespan, the one table from exception to HTTP status."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from http import HTTPStatus
from importlib.metadata import version
from typing import Any

import anyio.to_thread
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from sqlalchemy.exc import OperationalError
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from pipeline.errors import BadInput, Damaged, NightglassError
from pipeline.spec.load import InvalidScene
from service import problems
from service.context import Context
from service.jobs import JobStore
from service.routes import catalogues, frames, health, jobs, pages, results, schema
from service.runner import Dispatcher
from service.settings import Settings

log = logging.getLogger("nightglass.service")

HTTP_STATUS: tuple[tuple[type[Exception], int], ...] = (
    (problems.Malformed, 400),
    (problems.NotThere, 404),
    (problems.TooSlow, 408),
    (problems.NotReady, 409),
    (problems.KeyReused, 409),
    (problems.TooLarge, 413),
    (problems.WrongMediaType, 415),
    (problems.UnknownHost, 421),
    (problems.NotAllowed, 422),
    (problems.Refused, 422),
    (problems.QueueFull, 429),
    (problems.EngineFault, 500),
    (problems.PlanTooSlow, 503),
    (BadInput, 422),
    (RequestValidationError, 422),
    (Damaged, 500),
    (OperationalError, 503),  # the job table is locked, or its disk is full
)
HEADERS: dict[int, dict[str, str]] = {
    408: {"Connection": "close"},
    413: {"Connection": "close"},  # the rest of the body is not read
    429: {"Retry-After": "10"},
    503: {"Retry-After": "10"},
}


def create_app(settings: Settings) -> FastAPI:
    """The service on one data folder. The job table opens and the dispatcher starts with it."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        settings.make_folders()
        anyio.to_thread.current_default_thread_limiter().total_tokens = settings.request_threads
        store = JobStore(settings.database)
        dispatcher = Dispatcher(settings, store)
        plans = asyncio.Semaphore(settings.plans)
        app.state.context = Context(settings, store, dispatcher, plans, answers)
        dispatcher.start()
        try:
            yield
        finally:
            await anyio.to_thread.run_sync(dispatcher.stop)
            store.close()

    answers: Counter[int] = Counter()
    app = FastAPI(
        title="Nightglass", version=version("nightglass"), lifespan=lifespan,
        docs_url=None, redoc_url=None, redirect_slashes=False,
    )  # fmt: skip
    for room in (jobs, results, frames, catalogues, schema, health, pages):
        app.include_router(room.router)
    app.include_router(frames.queue)
    for kind in (NightglassError, RequestValidationError, HTTPException, Exception):
        app.add_exception_handler(kind, answer_problem)
    app.add_middleware(Gate, hosts=settings.hosts, answers=answers)
    return app


async def answer_problem(_: Request, error: Exception) -> Response:
    """Any exception as problem+json (RFC 9457)."""
    headers: dict[str, str] = {}
    if isinstance(error, HTTPException):
        status, headers = error.status_code, dict(error.headers or {})
    else:
        status = next((code for kind, code in HTTP_STATUS if isinstance(error, kind)), 500)
    detail, errors = _explain(error, status)
    body = {
        "type": "about:blank", "title": HTTPStatus(status).phrase, "status": status,
        "detail": detail, "errors": errors,
    }  # fmt: skip
    headers |= HEADERS.get(status, {})
    return JSONResponse(body, status, headers, media_type="application/problem+json")


def _explain(error: Exception, status: int) -> tuple[str, list[dict[str, Any]]]:
    """What is said of an error, and the mistakes to mend; nothing of an internal fault."""
    if isinstance(error, problems.Refusal):
        return problems.cut(str(error)), error.errors
    if isinstance(error, HTTPException):
        return problems.cut(str(error.detail)), []
    if isinstance(error, RequestValidationError):
        mistakes = [_of_parameter(e) for e in error.errors()]
    elif isinstance(error, InvalidScene):
        mistakes = error.mistakes
    elif isinstance(error, BadInput):
        mistakes = [(error.field, error.value, error.allowed)]
    else:
        log.error("status %d", status, exc_info=error)
        return "an internal fault; the server's log tells more", []
    listed = [problems.mistake_dict(m) for m in mistakes[: problems.MAX_LISTED]]
    many = f"{len(mistakes)} mistakes" if len(mistakes) > 1 else "1 mistake"
    return f"{many}, the first at {listed[0]['pointer'] or 'the top'}", listed


def _of_parameter(error: Any) -> problems.Mistake:
    place, name = error["loc"][0], error["loc"][1] if len(error["loc"]) > 1 else ""
    return f"?{name}" if place != "path" else f"?{place}", error.get("input"), error["msg"]


class Gate:
    """Before every request: the Host must be ours (DNS rebinding); after it: count the answer."""

    def __init__(self, app: ASGIApp, hosts: tuple[str, ...], answers: Counter[int]) -> None:
        self.app, self.hosts, self.answers = app, hosts, answers

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        async def counted(message: Message) -> None:
            if message["type"] == "http.response.start":
                self.answers[message["status"]] += 1
            await send(message)

        if self._known(dict(scope["headers"]).get(b"host", b"")):
            await self.app(scope, receive, counted)
        else:
            error = problems.UnknownHost(f"this service is called {' or '.join(self.hosts)}")
            await (await answer_problem(Request(scope), error))(scope, receive, counted)

    def _known(self, host: bytes) -> bool:
        name = host.decode("latin-1").lower()
        bare = name if name.endswith("]") else name.rpartition(":")[0] or name
        return "*" in self.hosts or bare in self.hosts
