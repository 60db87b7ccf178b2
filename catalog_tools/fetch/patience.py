"""How long to wait for a server, and how often to ask it again."""

from __future__ import annotations

import random
import threading
from dataclasses import dataclass

from ..errors import Incomplete


class Stopped(Exception):
    """The fetch is being stopped; what is on disk stays and can be resumed."""


class Unavailable(Exception):
    """A failure that may pass: no answer, a cut connection, a busy server.

    asked_s : how long the server asked to wait (Retry-After), None where it didn't.
    """

    def __init__(self, reason: str, asked_s: float | None = None) -> None:
        super().__init__(reason)
        self.asked_s = asked_s


class FinalFailure(Exception):
    """A failure that will not pass by asking again, such as 404 Not Found."""


@dataclass(frozen=True)
class Patience:
    """tries : in a row without one new byte. Delays double from `first_delay_s` up to
    `longest_delay_s`, each shortened at random by up to half; a server that asks for more than
    `longest_asked_s` ends the run. silence_s : the longest wait for the next byte.
    """

    tries: int = 8
    first_delay_s: float = 0.5
    longest_delay_s: float = 60.0
    longest_asked_s: float = 600.0
    connect_s: float = 15.0
    silence_s: float = 60.0

    def delay_s(self, failures: int) -> float:
        """How long to wait after so many failures in a row (1 or more) [s]."""
        whole = min(self.first_delay_s * 2.0 ** min(failures - 1, 60), self.longest_delay_s)
        return whole * random.uniform(0.5, 1.0)

    def wait(self, where: str, failure: Unavailable, failures: int, stop: threading.Event) -> None:
        """Wait before asking again; raises Incomplete where patience ends, Stopped if told to."""
        if failures >= self.tries:
            raise Incomplete(
                f"{where}: {failure} ({failures} tries in a row); "
                "the same command goes on from here"
            )
        asked_s = failure.asked_s or 0.0
        if asked_s > self.longest_asked_s:
            raise Incomplete(
                f"{where}: the server asks to come back in {asked_s:.0f} s ({failure}); "
                "the same command goes on from here"
            )
        if stop.wait(max(asked_s, self.delay_s(failures))):
            raise Stopped
