"""What every route works with: the settings, the caller, the job table as the caller sees it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from copy import copy
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated

from fastapi import Depends, Request
from fastapi.security import HTTPBearer

from service.accounts.auth import FRESH_S, OPEN, Authenticator, Caller
from service.accounts.teams import TeamStore
from service.accounts.tickets import Tickets
from service.engine.looks import Looks
from service.engine.runner import Dispatcher
from service.jobs.changes import Changes
from service.jobs.jobs import Job, Queue
from service.jobs.quotas import TeamLimits
from service.jobs.submissions import Intake
from service.metrics import Numbers
from service.scenes.accepted import Acceptance
from service.scenes.uploads import Uploads
from service.settings import Settings


@dataclass
class Context:
    """One per application, made by its lifespan; routes get a copy bound to their caller.

    store : the job table; in a route it shows the caller's team alone
    table : the whole job table, for health and metrics only
    looks : plans of scenes, and judgements of their files; numbers : what is counted
    scenes : reads the bodies of submissions; limits : what one team may have
    tickets : stand for a caller in the address of a download
    identify : who the caller is, again; refused once the key no longer holds
    """

    settings: Settings
    table: Queue
    dispatcher: Dispatcher
    auth: Authenticator
    intake: Intake
    changes: Changes
    files: Uploads
    looks: Looks
    numbers: Numbers
    scenes: Acceptance
    limits: TeamLimits
    tickets: Tickets
    caller: Caller = OPEN
    store: TeamStore = None  # type: ignore[assignment]
    identify: Callable[[], Awaitable[Caller]] = None  # type: ignore[assignment]
    started_s: float = field(default_factory=time.time)

    async def bound(self, identify: Callable[[], Awaitable[Caller]]) -> Context:
        """The same, as one caller sees it."""
        mine, caller = copy(self), await identify()
        mine.caller, mine.store = caller, TeamStore(self.table, caller, self.limits)
        mine.identify = identify
        return mine

    async def change(self, job: Job, limit_s: float) -> None:
        """Return when a job has changed, or time is up. Unauthenticated once the key is revoked."""
        clock, changed = asyncio.get_running_loop().time, False
        until_s = clock() + limit_s
        while not changed and (left_s := until_s - clock()) > 0.0:
            changed = await self.changes.after(job.id, job.version, min(left_s, FRESH_S))
            await self.identify()

    def has_file(self, file_id: str) -> bool:
        """Whether the caller's team has an uploaded file of this id."""
        return self.files.has(self.caller.team, file_id)


_bearer = HTTPBearer(auto_error=False, description="an API key, or a token of the provider")


def _everyone(request: Request) -> Context:
    return request.app.state.context


async def _context(request: Request, _: Annotated[object, Depends(_bearer)]) -> Context:
    """The context bound to who sent a request. Unauthenticated, Forbidden, TooMany."""
    context: Context = request.app.state.context
    ticket, auth = context.tickets.caller(request), context.auth
    if ticket is None:
        mine = await context.bound(partial(auth.caller, request.headers.get("authorization")))
    else:
        mine = await context.bound(partial(auth.behind, ticket))
    request.state.team = mine.caller.team
    return mine


Service = Annotated[Context, Depends(_context)]
Everyone = Annotated[Context, Depends(_everyone)]  # routes that need no key: health and metrics
