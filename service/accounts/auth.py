"""Who is calling: the team of an API key or of a bearer token, or `local` on an open laptop."""

from __future__ import annotations

import asyncio
import hashlib
import time
from collections import OrderedDict
from dataclasses import dataclass

import sqlalchemy as sa
from starlette.concurrency import run_in_threadpool

from service.accounts.keys import TOKEN, any_key, find_key, matches, usable
from service.accounts.oidc import Verifier
from service.jobs.jobs import LOCAL
from service.problems import TooMany, Unauthenticated
from service.settings import Settings

FRESH_S = 1.0  # a revoked key works at most this long, what waits for changes twice as long
REMEMBERED = 10_000
AT_ONCE, IN_LINE = 2, 64  # hashes being computed (19 MiB each), and waiting for that
NEEDED = "an API key (`nightglass keys create`) is needed: Authorization: Bearer ..."
REFUSED = "the API key is not valid"


@dataclass(frozen=True)
class Caller:
    """Who asks: the team whose jobs are seen, and the name in the audit table."""

    team: str
    actor: str


OPEN = Caller(LOCAL, LOCAL)


class Authenticator:
    """Decides of each request whose it is.

    Without an identity provider, and as long as no key was ever made, the service is open and all
    is of team `local`; such a service listens on loopback only (service/main.py). From the first
    key on, for good, every request needs one: revoking the last key opens nothing.
    """

    def __init__(self, settings: Settings, engine: sa.Engine) -> None:
        self._engine = engine
        self._verifier = None
        if settings.oidc_issuer and settings.oidc_audience and settings.oidc_jwks:
            self._verifier = Verifier(
                settings.oidc_issuer,
                settings.oidc_audience,
                settings.oidc_jwks,
                settings.oidc_team_claim,
            )
        self._known: OrderedDict[bytes, tuple[Caller | None, float, str]] = OrderedDict()
        self._guarded, self._looked_s = self._verifier is not None, float("-inf")
        self._hashing = asyncio.Semaphore(AT_ONCE)
        # a provider that does not answer holds these threads, and leaves the others to all else
        self._verifying = asyncio.Semaphore(AT_ONCE)
        self._in_line = 0

    async def guarded(self) -> bool:
        """Whether requests need a key or token."""
        if not self._guarded and time.monotonic() - self._looked_s > FRESH_S:
            self._guarded = await run_in_threadpool(any_key, self._engine)
            self._looked_s = time.monotonic()
        return self._guarded

    async def caller(self, authorization: str | None) -> Caller:
        """The caller, from the Authorization header.

        Unauthenticated, Forbidden, TooMany, NoProvider."""
        if not await self.guarded():
            return OPEN
        kind, _, token = (authorization or "").partition(" ")
        token = token.strip()
        if kind.lower() != "bearer" or not token:
            raise Unauthenticated(NEEDED)
        if len(token) > 8192:
            raise Unauthenticated(REFUSED)
        if match := TOKEN.fullmatch(token):
            return await self._of_key(hashlib.sha256(token.encode()).digest(), match[1], match[2])
        if self._verifier is None:
            raise Unauthenticated(REFUSED)
        async with self._verifying:
            team, subject = await run_in_threadpool(self._verifier.verify, token)
        return Caller(team, subject)

    async def behind(self, ticket: Caller) -> Caller:
        """The caller of a ticket. Unauthenticated where its key no longer holds."""
        kind, _, key_id = ticket.actor.partition(":")
        if kind == "key":
            row = await run_in_threadpool(find_key, self._engine, key_id)
            if row is None or not usable(row):
                raise Unauthenticated(REFUSED)
        return ticket

    async def _of_key(self, digest: bytes, key_id: str, secret: str) -> Caller:
        """A key is hashed once and then remembered by its digest; its row is looked at again."""
        known = self._known.get(digest)
        now = time.monotonic()
        if known is None or now - known[1] > FRESH_S:
            row = await run_in_threadpool(find_key, self._engine, key_id)
            stored, caller = getattr(row, "hash", ""), None
            if known is not None and known[2] == stored:  # looked at before
                caller = known[0] if row is not None and usable(row) else None
            elif await self._matches(row, secret):
                caller = Caller(row.team, f"key:{key_id}")
            known = (caller, now, stored)
            self._known[digest] = known
            self._known.move_to_end(digest)
            while len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        if known[0] is None:
            raise Unauthenticated(REFUSED)
        return known[0]

    async def _matches(self, row: object, secret: str) -> bool:
        if self._in_line >= IN_LINE:
            raise TooMany("too many keys are being verified; try again")
        self._in_line += 1
        try:
            async with self._hashing:
                return await run_in_threadpool(matches, row, secret)
        finally:
            self._in_line -= 1
