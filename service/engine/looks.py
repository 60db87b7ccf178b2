"""Looks at a scene that is no job: its plan, and what its files are, by a process of the engine."""

from __future__ import annotations

import asyncio
import copy
import hashlib
import json
import logging
import threading
from collections import OrderedDict
from collections.abc import Coroutine
from typing import TypeVar

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from catalog_tools.documents import JsonObject
from service.engine.processes import look_at
from service.http.gate import allow_time
from service.jobs.shares import Shares
from service.problems import EngineFault, Malformed, PlanTooSlow
from service.scenes.uploads import Uploads, engine_scene
from service.settings import Settings
from service.store.named_files import files_in

T = TypeVar("T")
KEPT = 10_000
log = logging.getLogger("nightglass.service")


class Looks:
    """A few at once, shared between teams; each ends when its caller goes, or the service does."""

    def __init__(self, settings: Settings, files: Uploads, stopping: threading.Event) -> None:
        self._settings, self._files, self._stopping = settings, files, stopping
        self._places = Shares(settings.plans, "dry runs")
        self._judged: OrderedDict[tuple[str, bytes], None] = OrderedDict()

    @property
    def of_study(self) -> JsonObject:
        """The order of a study's forecast; it is refused where it is beyond a job's limit."""
        return {"do": "forecast", "most_cpu_s": self._settings.job_cpu_s}

    async def plan(self, request: Request, team: str, scene: JsonObject) -> JsonObject:
        """The plan of an accepted scene. PlanRefused, PlanTooSlow, EngineFault, TooMany."""
        asked = {"do": "plan", "most_cpu_s": self._settings.job_cpu_s}
        plan: JsonObject = (await self._answer(request, team, scene, asked))["plan"]
        return plan

    async def forecast(self, request: Request, team: str, study: JsonObject) -> JsonObject:
        """What an accepted study takes. Raises as `plan` does."""
        found = await self._answer(request, team, study, self.of_study)
        forecast: JsonObject = found["forecast"]
        return forecast

    async def observe(
        self, request: Request, team: str, scene: JsonObject, asked: JsonObject
    ) -> JsonObject:
        """What an accepted scene's sensor sees; asked : times and snr. Raises as `plan` does."""
        order = asked | {"do": "observe", "most_rows": self._settings.observed_rows}
        seen: JsonObject = (await self._answer(request, team, scene, order))["observed"]
        return seen

    async def judge(
        self, request: Request, team: str, scene: JsonObject, asked: JsonObject | None = None
    ) -> None:
        """PlanRefused for what its job would refuse at its start; TooMany.

        asked : the order that says so, of what is more than a scene; None: a scene, of which the
        uploaded files are to be what it says
        What cannot be judged in time is taken: the engine that runs it judges it again. What
        differs in name and seed alone is judged once.
        """
        if asked is None and not files_in(json.dumps(scene)):
            return
        asked = asked or {"do": "judge"}
        text = json.dumps({k: v for k, v in scene.items() if k not in ("name", "seed")})
        key = team, hashlib.sha256((text + json.dumps(asked)).encode()).digest()
        if key in self._judged:
            return
        limit_s = self._settings.judge_s
        try:
            async with asyncio.timeout(limit_s):
                await unless_gone(request, self._look(team, scene, asked, limit_s))
        except (TimeoutError, PlanTooSlow):
            log.info("a submission was not judged in %g s; it is taken", limit_s)
        except EngineFault as error:
            log.warning("a submission could not be judged (%s); it is taken", error)
        else:
            self._judged[key] = None
            while len(self._judged) > KEPT:
                self._judged.popitem(last=False)

    async def _answer(
        self, request: Request, team: str, scene: JsonObject, asked: JsonObject
    ) -> JsonObject:
        """What a look says within `plan_s`; the request may take that beside its answer's time."""
        allow_time(request, self._settings.plan_s + self._settings.answer_s)
        return await unless_gone(request, self._look(team, scene, asked, self._settings.plan_s))

    async def _look(
        self, team: str, scene: JsonObject, asked: JsonObject, limit_s: float
    ) -> JsonObject:
        gone = threading.Event()
        async with self._places.place(team):
            files = await run_in_threadpool(self._files.names, team, files_in(json.dumps(scene)))
            order = asked | {"scene": engine_scene(copy.deepcopy(scene), self._settings)}
            try:
                return await run_in_threadpool(
                    look_at,
                    self._settings,
                    order | {"files": files},
                    limit_s,
                    lambda: gone.is_set() or self._stopping.is_set(),
                )
            finally:
                gone.set()


async def unless_gone(request: Request, work: Coroutine[object, object, T]) -> T:
    """What work comes to; it is cancelled when its caller closes the connection.

    The request's body has been read.
    """
    doing, gone = asyncio.create_task(work), asyncio.create_task(_gone(request))
    try:
        await asyncio.wait((doing, gone), return_when=asyncio.FIRST_COMPLETED)
        if not doing.done():
            raise Malformed("the caller has gone")
        return doing.result()
    finally:
        doing.cancel()
        gone.cancel()


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
