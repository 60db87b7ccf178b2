"""Build the FastAPI app: routers, lifespan, the one table from exception to HTTP status."""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from http import HTTPStatus
from importlib.metadata import version
from typing import Any

import anyio.to_thread
from fastapi import Depends, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from sqlalchemy.exc import DBAPIError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from starlette.exceptions import HTTPException
from starlette.routing import Match

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput, Damaged, NightglassError
from service import problems
from service.accounts.auth import Authenticator
from service.accounts.teams import limits_of
from service.accounts.tickets import Tickets
from service.context import Context
from service.engine.looks import Looks
from service.engine.runner import Dispatcher
from service.gauges import Gauges
from service.http.gate import Gate
from service.jobs.changes import Changes
from service.jobs.jobs import Queue
from service.jobs.submissions import Intake
from service.metrics import Numbers
from service.openapi import describe
from service.routes import (
    catalogues,
    files,
    frames,
    health,
    jobs,
    observe,
    pages,
    queue,
    results,
    schema,
    studies,
    sweeps,
    tickets,
    usage,
)
from service.routes.parameters import only_known
from service.scenes.accepted import Acceptance
from service.scenes.uploads import Uploads
from service.settings import Settings
from service.standards import ogc, uws

log = logging.getLogger("nightglass.service")

HTTP_STATUS: tuple[tuple[type[Exception], int], ...] = (
    (problems.Malformed, 400),
    (problems.Unauthenticated, 401),
    (problems.Forbidden, 403),
    (problems.NotThere, 404),
    (problems.TooSlow, 408),
    (problems.NotReady, 409),
    (problems.KeyReused, 409),
    (problems.TooLarge, 413),
    (problems.WrongMediaType, 415),
    (problems.UnknownHost, 421),
    (problems.NotAllowed, 422),
    (problems.PlanRefused, 422),
    (problems.QueueFull, 429),
    (problems.TooMany, 429),
    (problems.EngineFault, 500),
    (problems.NoProvider, 503),
    (problems.PlanTooSlow, 503),
    (problems.Overloaded, 503),
    (problems.TableFault, 503),
    (problems.StoreFull, 503),
    (BadInput, 422),
    (RequestValidationError, 422),
    (Damaged, 500),
)
HEADERS: dict[int, dict[str, str]] = {
    401: {"WWW-Authenticate": "Bearer"},
    408: {"Connection": "close"},
    413: {"Connection": "close"},  # the rest of the body is not read
    429: {"Retry-After": "10"},
    503: {"Retry-After": "10"},
}
ROOMS = (
    jobs,
    queue,
    studies,
    sweeps,
    observe,
    results,
    frames,
    files,
    catalogues,
    schema,
    usage,
    tickets,
    health,
    uws,
    ogc,
    pages,
)


def create_app(settings: Settings) -> FastAPI:
    """The service on one data folder. The job table opens and the dispatcher starts with it."""
    numbers = Numbers()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        settings.make_folders()
        anyio.to_thread.current_default_thread_limiter().total_tokens = settings.request_threads
        table = Queue(settings.database_url)
        dispatcher = Dispatcher(settings, table)
        limits = limits_of(settings)
        intake = Intake(table, limits)
        uploads = Uploads(settings, table.engine)
        uploads.remove_cut_off()
        context = Context(
            settings,
            table,
            dispatcher,
            Authenticator(settings, table.engine),
            intake,
            Changes(table, settings.watchers),
            uploads,
            Looks(settings, uploads, dispatcher.stopping),
            numbers,
            Acceptance(settings),
            limits,
            Tickets(settings.home),
        )
        app.state.context = context
        numbers.registry.register(Gauges(context))
        intake.start()
        dispatcher.start()
        try:
            yield
        finally:
            await anyio.to_thread.run_sync(intake.stop)
            await anyio.to_thread.run_sync(dispatcher.stop)
            table.close()

    app = FastAPI(
        title="Nightglass",
        version=version("nightglass"),
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
    )
    for room in ROOMS:
        of_rest = room.router.prefix.startswith("/v1")
        app.include_router(room.router, dependencies=[Depends(only_known)] if of_rest else None)
    for kind in (NightglassError, RequestValidationError, HTTPException):
        app.add_exception_handler(kind, answer_problem)
    app.add_middleware(Gate, settings=settings, numbers=numbers, problem=answer_problem)
    describe(app)
    return app


async def answer_problem(request: Request, error: Exception) -> Response:
    """Any exception as problem+json (RFC 9457)."""
    headers: dict[str, str] = {}
    if isinstance(error, DBAPIError | PoolTimeout):
        error = _of_table(error)
    if isinstance(error, HTTPException):
        status, headers = error.status_code, dict(error.headers or {})
    else:
        status = next((code for kind, code in HTTP_STATUS if isinstance(error, kind)), 500)
    if status == HTTPStatus.METHOD_NOT_ALLOWED:
        headers["Allow"] = ", ".join(_methods_at(request))
    detail, errors = _explain(error, status)
    body = {
        "type": getattr(error, "type_uri", "about:blank"),
        "title": HTTPStatus(status).phrase,
        "status": status,
        "detail": detail,
        "errors": errors,
    }
    headers |= HEADERS.get(status, {})
    return JSONResponse(body, status, headers, media_type="application/problem+json")


def _methods_at(request: Request) -> list[str]:
    """Methods of all routes of a request's path: the router names those of the first alone."""
    routes = (route for room in ROOMS for route in room.router.routes)
    found = [r for r in routes if r.matches(request.scope)[0] is not Match.NONE]
    return sorted({method for r in found for method in getattr(r, "methods", None) or ()})


def _of_table(error: DBAPIError | PoolTimeout) -> Exception:
    """What is wrong with the job table, named; nothing of a statement or its values."""
    told = str(getattr(error, "orig", "")).lower()
    log.error("the job table: %s", type(error).__name__, exc_info=error)
    if "disk is full" in told or "no space" in told or "disk i/o error" in told:
        return problems.TableFault("the disk of the job table is full: nothing was stored")
    if "malformed" in told or "not a database" in told:
        return Damaged("the job table", "it is not what was written; restore it from a backup")
    if isinstance(error, OperationalError | PoolTimeout):
        return problems.TableFault("the job table is locked or cannot be reached")
    if "read-only transaction" in told:  # of PostgreSQL: a standby, or a server that is full
        return problems.TableFault("the job table can be read only: nothing was stored")
    return error


def _explain(error: Exception, status: int) -> tuple[str, list[JsonObject]]:
    """What is said of an error, and the mistakes to mend; nothing of an internal fault."""
    if isinstance(error, problems.Refusal):
        return problems.cut(str(error)), error.errors
    if isinstance(error, HTTPException):
        return problems.cut(str(error.detail)), []
    if isinstance(error, Damaged) and error.path == "the job table":
        return str(error), []
    mistakes = _mistakes_of(error)
    if not mistakes:
        log.error("status %d", status, exc_info=error)
        return "an internal fault; the server's log has the details", []
    listed = [problems.mistake_dict(m) for m in mistakes[: problems.MAX_LISTED]]
    many = f"{len(mistakes)} mistakes" if len(mistakes) > 1 else "1 mistake"
    return f"{many}, the first at {listed[0]['pointer'] or 'the top'}", listed


def _mistakes_of(error: Exception) -> list[problems.Mistake]:
    if isinstance(error, RequestValidationError):
        return [_of_parameter(e) for e in error.errors()]
    return problems.mistakes_of(error)


def _of_parameter(error: Any) -> problems.Mistake:
    place, name = error["loc"][0], error["loc"][1] if len(error["loc"]) > 1 else ""
    return f"?{name}" if place != "path" else f"?{place}", error.get("input"), error["msg"]
