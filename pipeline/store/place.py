"""Where a product lies, and what its one writer may do there: a folder and an s3 URL look alike."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass

from catalog_tools.documents import JsonObject
from pipeline.plan.plan import Plan
from pipeline.spec.scene import Scene
from pipeline.store.product import Begun, Verdict


@dataclass(frozen=True)
class Claim:
    """Who asks to write a product, and how it may be taken up.

    part : name of the part of it that this writer draws; None for all of it
    mine : whether a tile (frame, row, column) is this writer's; None for all
    resume : go on with one that was begun; replace : remove what stands there first
    wait_s : how long another writer is waited for
    """

    plan: Plan
    catalogue_digest: str | None
    resume: bool = False
    replace: bool = False
    wait_s: float = 0.0
    part: str | None = None
    mine: Callable[[int, int, int], bool] | None = None


class Writing(ABC):
    """A product that is held for writing."""

    begun: Begun

    @abstractmethod
    def is_sealed(self, tiles: int) -> bool:
        """Whether it is complete already: sealed, and so many tiles whole."""

    @abstractmethod
    def report(self) -> JsonObject:
        """The report of a complete product; `drawn_before` says so, in no file."""

    @abstractmethod
    def unseal(self) -> None:
        """Remove its seal, which no longer holds once anything is drawn again."""

    @abstractmethod
    def put_plan(self, content: bytes) -> None:
        """Write its plan; that of the first of several parts stays."""

    @abstractmethod
    def check(self) -> None:
        """Raise Incomplete where it is held no longer."""

    @abstractmethod
    def discard(self) -> None:
        """Remove the product, of which nothing was finished."""

    @abstractmethod
    def locks(self) -> Iterable[str]:
        """Names of the locks of its parts."""

    @abstractmethod
    def finishing(self) -> AbstractContextManager[None]:
        """Within it the product is finished in the folder `begun.path`."""


class Place(ABC):
    """A place for one product."""

    name: str
    join_tries: int  # by the last part, while others are closing

    @abstractmethod
    def explained(self) -> AbstractContextManager[None]:
        """Faults of the place itself become DiskFull or Incomplete, and name the product."""

    @abstractmethod
    def check_free(self, resume: bool, replace: bool) -> None:
        """Raise BadInput where what is there, or is not, makes `written` refuse: before a plan."""

    @abstractmethod
    def written(self, claim: Claim) -> AbstractContextManager[Writing]:
        """Hold the product, made or taken up, as its only writer.

        Raises BadInput where what is there may not be taken up, TryLater where another writer goes
        on for longer than the claim waits.
        """

    @abstractmethod
    def tiles(self) -> int:
        """How many tiles are finished, whoever drew them; not verified."""

    @abstractmethod
    def check_begun(self) -> None:
        """Raise BadInput where no product was begun."""

    @abstractmethod
    def scene(self) -> Scene:
        """The scene of the product, which was begun."""

    @abstractmethod
    def verdict(self) -> Verdict:
        """What verifying every tile and table finds."""
