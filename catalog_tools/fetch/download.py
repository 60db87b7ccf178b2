"""Many files of the archive into one folder: several at a time, only what is not there yet."""

from __future__ import annotations

import shutil
import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from ..errors import BadInput, Damaged, Incomplete
from .layout import Entry, parse_index
from .ledger import FileLedger, file_md5
from .patience import FinalFailure, Patience, Stopped, Unavailable
from .remote import Remote, read_whole
from .transfer import Transfer, discard, size_of

Progress = Callable[[str, int, int], None]  # stage, done, total
Work = Callable[[Entry], None]

INDEX_BYTES = 64 << 20  # DR2's index page is 8 MB
ASK_EACH = 64  # up to so many files their sizes are asked one by one
MOST_FAULTS = 20
TICK_S = 0.1
LEAVE_S = 5.0


@dataclass(frozen=True)
class Tally:
    """What a download did: files and bytes brought, files and bytes that were there already."""

    downloaded: int
    bytes_downloaded: int
    present: int
    bytes_present: int


def download(
    remote: Remote,
    entries: Sequence[Entry],
    ledger: FileLedger,
    *,
    connections: int,
    patience: Patience,
    progress: Progress,
    verify: bool = False,
) -> Tally:
    """Bring the files into the ledger's folder; those verified there before are left alone.

    verify : hash also what the ledger knows. progress : called from this thread with ("verify" or
    "download", bytes, bytes of all). Raises BadInput where the disk is too small, Damaged where a
    file's digest stays wrong, Incomplete for what another run may bring. One file's fault does not
    keep the others from being brought.
    """
    missing = _missing(entries, ledger, connections, progress, verify)
    lacking = {entry.name for entry in missing}
    present = [size_of(ledger.folder / e.name) for e in entries if e.name not in lacking]
    meter = Meter(sizes_of(remote, missing), ledger, missing)
    _check_space(meter, ledger)
    stop = threading.Event()
    transfer = Transfer(remote, ledger, patience, stop, meter.tell)
    try:
        faults = in_threads(
            missing, transfer.bring, connections, stop, lambda: progress("download", *meter.read())
        )
    finally:
        remote.close()
    _raise_faults(faults)
    return Tally(len(missing), meter.new_bytes, len(present), sum(present))


class Meter:
    """Counts bytes for many threads: what is on disk of the files, and how much there is to be."""

    def __init__(self, sizes: dict[str, int], ledger: FileLedger, missing: Iterable[Entry]) -> None:
        self._lock = threading.Lock()
        self._done = {entry.name: size_of(ledger.part(entry.name)) for entry in missing}
        self._whole = {name: max(sizes.get(name, 0), done) for name, done in self._done.items()}
        self._sums = (sum(self._done.values()), sum(self._whole.values()))
        self.new_bytes = 0

    def tell(self, name: str, on_disk: int, new: int, total: int | None) -> None:
        """Note `new` bytes of a file, of which `on_disk` are there now."""
        with self._lock:
            whole = max(on_disk, self._whole[name] if total is None else total)
            done_sum, whole_sum = self._sums
            self._sums = (
                done_sum + on_disk - self._done[name],
                whole_sum + whole - self._whole[name],
            )
            self._done[name], self._whole[name] = on_disk, whole
            self.new_bytes += new

    def read(self) -> tuple[int, int]:
        """Bytes on disk, and bytes of all files so far as their lengths are known."""
        return self._sums


def sizes_of(remote: Remote, missing: Sequence[Entry]) -> dict[str, int]:
    """Lengths of files by name, so far as the server tells them: each asked for, or its index."""
    if len(missing) <= ASK_EACH:
        sizes = {entry.name: remote.size(entry.name) for entry in missing}
        return {name: size for name, size in sizes.items() if size is not None}
    listed: dict[str, int] = {}
    with suppress(Unavailable, FinalFailure):
        listed = parse_index(read_whole(remote, "", INDEX_BYTES).decode("utf-8", "replace"))
    wanted = {entry.name for entry in missing}
    return {name: size for name, size in listed.items() if name in wanted}


def in_threads(
    items: Iterable[Entry],
    work: Work,
    threads: int,
    stop: threading.Event,
    tick: Callable[[], None],
) -> list[Exception]:
    """Do the work for every item; returns what failed.

    `tick` is called from here, again and again. The threads are daemons: an interrupt is answered
    at once, and what a thread leaves is resumed by the next run. Faults of single files (Damaged,
    FinalFailure) end the run only when they are many, any other at once.
    """
    waiting, faults = deque(items), list[Exception]()
    serve = partial(_serve, waiting, work, stop, faults)
    crew = [threading.Thread(target=serve, daemon=True) for _ in range(min(threads, len(waiting)))]
    tick()
    try:
        for thread in crew:
            thread.start()
        while not stop.is_set() and any(thread.is_alive() for thread in crew):
            crew[0].join(TICK_S) if crew[0].is_alive() else stop.wait(TICK_S)
            tick()
    finally:
        stop.set()
        for thread in crew:
            if thread.ident is not None:
                thread.join(LEAVE_S / len(crew))
    return faults


def _serve(
    waiting: deque[Entry], work: Work, stop: threading.Event, faults: list[Exception]
) -> None:
    """One thread's part of `in_threads`."""
    while waiting and not stop.is_set():
        try:
            item = waiting.popleft()
        except IndexError:
            return
        try:
            work(item)
        except Stopped:
            return
        except Exception as error:
            faults.append(error)
            if not isinstance(error, Damaged | FinalFailure) or len(faults) >= MOST_FAULTS:
                stop.set()


def _missing(
    entries: Sequence[Entry], ledger: FileLedger, threads: int, progress: Progress, verify: bool
) -> list[Entry]:
    """Files that are not there, or not as the archive's list says; found ones are noted."""
    there = [e for e in entries if (ledger.folder / e.name).is_file()]
    unsure = [e for e in there if verify or ledger.md5_of(e.name) != e.md5]
    wrong = {e.name for e in entries} - {e.name for e in there}
    sizes = {e.name: size_of(ledger.folder / e.name) for e in unsure}
    hashed: dict[str, int] = {}

    def check(entry: Entry) -> None:
        if file_md5(ledger.folder / entry.name) == entry.md5:
            ledger.add(entry.name, entry.md5)
            discard(ledger.part(entry.name))
        else:
            wrong.add(entry.name)
        hashed[entry.name] = sizes[entry.name]

    total = sum(sizes.values())
    faults = in_threads(
        unsure,
        check,
        threads,
        threading.Event(),
        lambda: progress("verify", sum(list(hashed.values())), total) if unsure else None,
    )
    _raise_faults(faults)
    return [e for e in entries if e.name in wrong]


def _check_space(meter: Meter, ledger: FileLedger) -> None:
    done, total = meter.read()
    free = shutil.disk_usage(ledger.folder).free
    if total - done > free:
        allowed = f"a disk with {total - done} bytes free for what is missing (it has {free})"
        raise BadInput("destination", str(ledger.folder), allowed)


def _raise_faults(faults: Sequence[Exception]) -> None:
    """The gravest fault as one message that also counts the others."""
    if not faults:
        return
    ranks = {Damaged: 1, Incomplete: 2, FinalFailure: 3}
    worst = min(faults, key=lambda fault: ranks.get(type(fault), 0))
    others = f" (and {len(faults) - 1} more files failed)" if len(faults) > 1 else ""
    if isinstance(worst, Damaged):
        raise Damaged(worst.path, worst.reason + others)
    if isinstance(worst, FinalFailure):
        raise Incomplete(f"{worst}{others}")
    raise worst
