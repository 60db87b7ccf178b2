"""One writer at a time on an object store: leases that are renewed, and run out with their owner.

A lease is a numbered object that only one can create (a conditional PUT). Whoever finds the newest
one given up, held by one that is known to have ended, or not renewed for long by the store's own
clock, may create the next number.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from uuid import uuid4

from catalog_tools.documents import JsonObject
from catalog_tools.storage.objects import Listed, Objects
from catalog_tools.storage.stores import Unreachable
from pipeline.errors import BadInput, Incomplete, TryLater
from pipeline.store.layout import LOCK, waited

RENEWED_S = 10.0
RUNS_OUT_S = 60.0
FREE = b"{}\n"


class Lease:
    """A lease that is held; `check` raises Incomplete once it was lost."""

    def __init__(self, objects: Objects, name: str) -> None:
        self.objects, self.name = objects, name
        self.content = json.dumps({"owner": uuid4().hex} | _this_process()).encode() + b"\n"
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
def only_writer_of(
    objects: Objects, shared: str | None = None, wait_s: float = 0.0
) -> Iterator[Lease]:
    """Hold the lease of a product; another living writer is waited for, then TryLater.

    shared : name of a part; writers of other parts are let in beside it
    """
    lease = waited(wait_s, lambda: _taken_alone(objects, shared))
    ended = threading.Event()
    keeper = threading.Thread(target=_keep, args=(lease, ended), daemon=True)
    keeper.start()
    try:
        yield lease
    finally:
        ended.set()
        keeper.join()
        with suppress(Unreachable):  # then it runs out by itself
            _give_up(lease)


def _taken_alone(objects: Objects, shared: str | None) -> Lease:
    """A lease beside which no other one is held that it does not go with. Raises TryLater."""
    kind = LOCK if shared is None else f"{LOCK}-{shared}"
    lease = _taken(objects, kind)
    others = objects.names(LOCK)
    against = {_kind(n) for n in others} - {kind} if shared is None else {LOCK}
    if any(_living(objects, _of(others, other)) for other in against):
        with suppress(Unreachable):
            _give_up(lease)
        raise _busy(objects)
    return lease


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
    content = objects.get(newest)
    if content in (FREE, None) or _has_ended(content):
        return False
    return (_now(objects) - found[newest].changed).total_seconds() < RUNS_OUT_S


def _this_process() -> JsonObject:
    """What tells others of this machine, and later starts of the same Slurm task, that it ended."""
    about: JsonObject = {"pid": os.getpid(), "started": _started(os.getpid())}
    with suppress(OSError):  # no Linux
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        about["host"] = f"{boot}:{Path('/proc/self/ns/pid').stat().st_ino}"
    if "SLURM_JOB_ID" in os.environ:
        about["job"] = f"{os.environ.get('SLURM_CLUSTER_NAME')}:{os.environ['SLURM_JOB_ID']}"
        about["restart"] = int(os.environ.get("SLURM_RESTART_COUNT", "0"))
    return about


def _started(pid: int) -> str | None:
    """When a process of this machine started, in its kernel's ticks; None where it is gone."""
    try:
        told = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if told[0] in "ZX" else told[19]  # killed, and not yet asked after


def _has_ended(content: bytes) -> bool:
    """Whether the holder of a lease is known to be dead, so that nobody need wait."""
    try:
        other, mine = json.loads(content), _this_process()
        if "host" in mine and other.get("host") == mine["host"]:
            return _started(other["pid"]) != other["started"]
        return (
            "job" in mine
            and other.get("job") == mine["job"]
            and (other["restart"] < mine["restart"])
        )
    except (ValueError, KeyError, TypeError, AttributeError):  # of another version
        return False


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


def _busy(objects: Objects) -> TryLater:
    return TryLater(
        f"{objects.url}: another render is writing this product now (--wait waits for it; the "
        f"lease of one that died elsewhere ends in {RUNS_OUT_S:.0f} s)"
    )
