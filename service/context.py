"""What every route works with: the settings, the job table, the dispatcher."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Annotated

from fastapi import Depends, Request

from service.jobs import JobStore
from service.runner import Dispatcher
from service.settings import Settings


@dataclass
class Context:
    """One per application, made by its lifespan.

    plans : how many dry runs may still start; answers : count of answers by status
    """

    settings: Settings
    store: JobStore
    dispatcher: Dispatcher
    plans: asyncio.Semaphore
    answers: Counter[int]
    started_s: float = field(default_factory=time.time)


def _context(request: Request) -> Context:
    return request.app.state.context


Service = Annotated[Context, Depends(_context)]
