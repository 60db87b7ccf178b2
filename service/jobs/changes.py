"""Wait for a job to change: one query in a while for all who wait, however many they are."""

from __future__ import annotations

import asyncio
import logging
from collections import defaultdict

from starlette.concurrency import run_in_threadpool

from service.jobs.jobs import JobStore
from service.jobs.shares import Shares

BETWEEN_LOOKS_S = 0.2
log = logging.getLogger("nightglass.service")


class Changes:
    """Watches the versions of the jobs that somebody waits for."""

    def __init__(self, store: JobStore, most: int) -> None:
        self._store = store
        self.places = Shares(most, "requests that wait for changes")
        self._waiting: dict[str, set[tuple[int, asyncio.Event]]] = defaultdict(set)
        self._looking: asyncio.Task[None] | None = None

    async def after(self, job_id: str, version: int, limit_s: float) -> bool:
        """True when a job's version is another than this one or it is gone, False when time is up.

        The caller holds one of the `places`.
        """
        event = asyncio.Event()
        place = (version, event)
        self._waiting[job_id].add(place)
        if self._looking is None or self._looking.done():
            self._looking = asyncio.create_task(self._look())
        try:
            async with asyncio.timeout(limit_s):
                await event.wait()
        except TimeoutError:
            pass
        finally:
            self._waiting[job_id].discard(place)
            if not self._waiting[job_id]:
                del self._waiting[job_id]
        return event.is_set()

    async def _look(self) -> None:
        while self._waiting:
            await asyncio.sleep(BETWEEN_LOOKS_S)
            asked = list(self._waiting)
            try:
                found = await run_in_threadpool(self._store.versions, asked)
            except Exception:
                log.exception("the job table cannot be read; those who wait wait on")
                continue
            for job_id in asked:
                for version, event in self._waiting.get(job_id, ()):
                    if found.get(job_id) != version:
                        event.set()
