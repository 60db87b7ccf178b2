"""Places for what may go on at once, shared between teams so that none shuts the others out."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

from service.problems import TooMany

IN_LINE = 64  # of one team


class Shares:
    """`most` places. A team takes another one only while it holds fewer than are free: one alone
    gets half of them, a second half of the rest, and there is a place for who comes last.

    Used in the event loop alone, and so without a lock.
    """

    def __init__(self, most: int, what: str) -> None:
        self._most, self._what = most, what
        self._held: Counter[str] = Counter()
        self._lines: dict[str, deque[asyncio.Future[None]]] = {}  # the team to be next first

    @property
    def held(self) -> int:
        """How many places are taken."""
        return self._held.total()

    def take(self, team: str) -> None:
        """Take a place, to be given back. TooMany where the team may have no more."""
        if not self._may(team):
            raise TooMany(f"{self._held[team]} {self._what} of this team already; try again later")
        self._held[team] += 1

    def give(self, team: str) -> None:
        """Give a place back; who waits is served, teams in turn."""
        self._held[team] -= 1
        if not self._held[team]:
            del self._held[team]
        for other in list(self._lines):
            line, before = self._lines[other], self.held
            while line and self._may(other):
                turn = line.popleft()
                if not turn.done():  # who waits may be going at this moment
                    self._held[other] += 1
                    turn.set_result(None)
            if not line or self.held > before:
                del self._lines[other]
            if line and self.held > before:  # served: its next turn comes after the others'
                self._lines[other] = line

    @contextmanager
    def taken(self, team: str) -> Iterator[None]:
        """Hold a place, or raise TooMany at once."""
        self.take(team)
        try:
            yield
        finally:
            self.give(team)

    @asynccontextmanager
    async def place(self, team: str) -> AsyncIterator[None]:
        """Hold a place, waiting for it. TooMany where too many of the team wait already."""
        if self._may(team) and not self._lines.get(team):
            self._held[team] += 1
        else:
            await self._wait(team)
        try:
            yield
        finally:
            self.give(team)

    def _may(self, team: str) -> bool:
        return self._held[team] < self._most - self.held

    async def _wait(self, team: str) -> None:
        line = self._lines.setdefault(team, deque())
        for gone in [turn for turn in line if turn.done()]:
            line.remove(gone)
        if len(line) >= IN_LINE:
            raise TooMany(f"{IN_LINE} {self._what} of this team wait already; try again later")
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        line.append(turn)
        try:
            await turn
        except asyncio.CancelledError:
            if not turn.cancelled():
                self.give(team)  # it was handed over just now
            raise
