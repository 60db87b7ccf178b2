"""Bodies that were accepted, kept by their bytes: a team's same scene is parsed and judged once."""

from __future__ import annotations

import json
from collections import OrderedDict
from dataclasses import dataclass

from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool

from catalog_tools.documents import JsonObject
from pipeline.plan.cost import least_cpu_s
from service.http.bodies import JSON, digest_of, parse_text
from service.scenes.scenes import (
    HasFile,
    Named,
    check_named,
    judge_scene,
    named_in,
    pixel_frames_of,
)
from service.settings import Settings

LARGEST_KEPT = 1 << 14  # bytes of a body
KEPT_BYTES = 1 << 24
Key = tuple[str, bytes, str]  # team, body, its media type


@dataclass(frozen=True)
class Accepted:
    """A scene that passed every check, as the job table takes it.

    text : the scene as JSON, defaults filled in
    body_sha256 : of the body's data, whatever its spaces and the order of its keys
    least_cpu_s : CPU seconds that it is forecast to take, its stars not counted
    named : what it names outside of itself, which may come and go: looked at every time
    """

    name: str
    text: str
    body_sha256: str
    pixel_frames: int
    named: Named
    least_cpu_s: float = 0.0

    def scene(self) -> JsonObject:
        """The scene as plain data, the caller's own."""
        found: JsonObject = json.loads(self.text)
        return found


class Acceptance:
    """Reads bodies of scenes. Used in the event loop alone, and so without a lock.

    What is kept follows from the bytes and the settings alone, is bounded in bytes (the least
    recently used goes first), and is never shared between teams: nobody can tell by the time that
    an answer takes what others have asked for.
    """

    def __init__(self, settings: Settings, kept_bytes: int = KEPT_BYTES) -> None:
        self._settings, self._most, self.kept_bytes = settings, kept_bytes, 0
        self._kept: OrderedDict[Key, Accepted] = OrderedDict()
        self.reused = 0

    async def read(self, team: str, body: bytes, has_file: HasFile, kind: str = JSON) -> Accepted:
        """The scene in a body. Malformed, BadInput, InvalidScene, NotAllowed."""
        key = (team, body, kind)
        found = self._kept.get(key)
        if found is not None:
            self._kept.move_to_end(key)
            self.reused += 1
        else:
            found = await run_in_threadpool(self._judge, body, kind)
            if len(body) <= LARGEST_KEPT:
                self._keep(key, found)
        if found.named:
            await run_in_threadpool(check_named, found.named, self._settings, has_file)
        return found

    def _judge(self, body: bytes, kind: str) -> Accepted:
        data = parse_text(body, kind)
        scene = judge_scene(data, self._settings)
        plain = scene.as_dict()
        digest = digest_of(data)
        text = to_json(plain, inf_nan_mode="constants").decode()
        return Accepted(
            scene.name, text, digest, pixel_frames_of(scene), named_in(plain), least_cpu_s(scene)
        )

    def _keep(self, key: Key, found: Accepted) -> None:
        if key in self._kept:  # the same bytes came twice at once
            return
        self._kept[key] = found
        self.kept_bytes += _size(key, found)
        while self.kept_bytes > self._most:
            self.kept_bytes -= _size(*self._kept.popitem(last=False))


def _size(key: Key, found: Accepted) -> int:
    """About the bytes that it takes to keep a scene."""
    return len(key[1]) + len(found.text) + 1000
