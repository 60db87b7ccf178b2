"""One writer at a time on an object store: leases that are renewed, and run out with their owner.

A lease is a numbered object that only one can create (a conditional PUT). Whoever finds the newest
one given up, or not renewed for long by the store's own clock, may create the next number.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from uuid import uuid4

from catalog_tools.objects import Listed, Objects
from catalog_tools.stores import Unreachable
from pipeline.errors import BadInput, Incomplete
from pipeline.store.layout import LOCK

RENEWED_S = 10.0
RUNS_OUT_S = 60.0
FREE = b"{}\n"


class Lease:
    """A lease that is held; `check` raises Incomplete once it was lost."""

    def __init__(self, objects: Objects, name: str) -> None:
        self.objects, self.name = objects, name
        self.content = json.dumps({"owner": uuid4().hex}).encode() + b"\n"
        self.lost = False

    def check(self) -> None:
        if self.lost:
            raise Incomplete(
                f"{self.objects.url}: another render has taken this product over, because the "
                "store was not reached for too long; what is finished is kept"
            )

    def renew(self) -> None:
        """Show that the owner lives; learn whether another has taken over."""
        newest = max(_of(self.objects.names(LOCK), _kind(self.name)), default=None)
        self.lost |= newest != self.name
        if not self.lost:
            self.objects.put(self.name, self.content)


@contextmanager
def only_writer_of(objects: Objects, shared: str | None = None) -> Iterator[Lease]:
    """Hold the lease of a product; another living writer is refused with BadInput.

    shared : name of a part; writers of other parts are let in beside it
    """
    kind = LOCK if shared is None else f"{LOCK}-{shared}"
    lease = _taken(objects, kind)
    ended = threading.Event()
    keeper = threading.Thread(target=_keep, args=(lease, ended), daemon=True)
    try:
        others = objects.names(LOCK)
        against = {_kind(n) for n in others} - {kind} if shared is None else {LOCK}
        if any(_living(objects, _of(others, other)) for other in against):
            raise _busy(objects)
        keeper.start()
        yield lease
    finally:
        ended.set()
        if keeper.is_alive():
            keeper.join()
        with suppress(Unreachable):  # then it runs out by itself
            _give_up(lease)


def _taken(objects: Objects, kind: str) -> Lease:
    found = _of(objects.names(LOCK), kind)
    if _living(objects, found):
        raise _busy(objects)
    number = 1 + max((int(name.rpartition("/")[2]) for name in found), default=0)
    lease = Lease(objects, f"{kind}/{number:012d}")
    try:
        won = objects.create(lease.name, lease.content)
    except (Unreachable, FileNotFoundError) as error:
        raise BadInput(
            "-o", objects.url, f"a place that is there and can be written ({error})"
        ) from None
    if not won:
        raise _busy(objects)  # another was first
    if objects.create(lease.name, FREE):
        objects.delete([lease.name])
        raise BadInput(
            "-o", objects.url, "a store that keeps conditional PUTs (If-None-Match: *)"
        )  # else two writers might both believe to be the only one
    return lease


def _give_up(lease: Lease) -> None:
    if not lease.lost:
        lease.objects.put(lease.name, FREE)
        found = _of(lease.objects.names(LOCK), _kind(lease.name))
        lease.objects.delete(name for name in found if name < lease.name)


def _keep(lease: Lease, ended: threading.Event) -> None:
    while not ended.wait(RENEWED_S):
        try:
            lease.renew()
        except (Unreachable, OSError):
            continue  # the store may be back before the lease runs out


def _living(objects: Objects, found: dict[str, Listed]) -> bool:
    """Whether the newest lease of one kind is held by one who lives."""
    if not found:
        return False
    newest = max(found)
    if objects.get(newest) in (FREE, None):
        return False
    return (_now(objects) - found[newest].changed).total_seconds() < RUNS_OUT_S


def _now(objects: Objects) -> datetime:
    """The store's own time."""
    name = f"{LOCK}-clock/{uuid4().hex}"
    objects.put(name, FREE)
    now = objects.names(name)[name].changed
    objects.delete([name])
    return now


def _of(names: dict[str, Listed], kind: str) -> dict[str, Listed]:
    return {
        name: facts
        for name, facts in names.items()
        if _kind(name) == kind and name.rpartition("/")[2].isdigit()
    }


def _kind(name: str) -> str:
    return name.rpartition("/")[0]


def _busy(objects: Objects) -> BadInput:
    return BadInput(
        "-o", objects.url,
        f"a product that no other render is writing now (a dead one's lease ends in "
        f"{RUNS_OUT_S:.0f} s)",
    )  # fmt: skip
