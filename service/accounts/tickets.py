"""Tickets: an address that a browser itself may fetch for a minute, without the key in it."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import re
import time
from pathlib import Path

from starlette.requests import Request

from service.accounts.auth import Caller
from service.problems import NotAllowed, Unauthenticated
from service.store.homes import made_once

LASTS_S = 60.0  # until a download must have begun
PLACE = re.compile(r"/v1/jobs/[\x21-\x7e]{1,2000}")
GIVEN = re.compile(r"[?&]ticket=([A-Za-z0-9_=-]+)\.([0-9a-f]{64})$")


class Tickets:
    """Made and checked by every process that serves a data folder, by a secret that lies there."""

    def __init__(self, home: Path) -> None:
        self._secret = made_once(home / "tickets.key")

    def make(self, caller: Caller, place: str) -> str:
        """The address of something of a job, good for its caller's GET of just that."""
        if not PLACE.fullmatch(place) or "ticket=" in place or "#" in place:
            allowed = "the path of something of a job, /v1/jobs/..."
            raise NotAllowed(f"path: allowed: {allowed}", (("path", place, allowed),))
        told = json.dumps([caller.team, caller.actor, place, time.time() + LASTS_S])
        text = base64.urlsafe_b64encode(told.encode()).decode()
        return f"{place}{'&' if '?' in place else '?'}ticket={text}.{self._seal(text)}"

    def caller(self, request: Request) -> Caller | None:
        """Whose ticket a request has; None where it has none. Unauthenticated for a bad one."""
        query = request.scope["query_string"].decode("latin-1")
        if "ticket=" not in query or request.method not in ("GET", "HEAD"):
            return None
        asked = f"{request.scope['raw_path'].decode('latin-1')}?{query}"
        if (found := GIVEN.search(asked)) and hmac.compare_digest(self._seal(found[1]), found[2]):
            team, actor, place, until_s = json.loads(base64.urlsafe_b64decode(found[1]))
            if place == asked[: found.start()] and time.time() < until_s:
                return Caller(team, actor)
        raise Unauthenticated("the ticket is not valid, or no longer: ask for another")

    def _seal(self, text: str) -> str:
        return hmac.new(self._secret, text.encode(), hashlib.sha256).hexdigest()
