"""One file from the archive to the disk: resumed, verified, then visible under its name."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import Damaged
from .layout import Entry
from .ledger import FileLedger, file_md5
from .patience import FinalFailure, Patience, Stopped, Unavailable
from .remote import PastEnd, Remote, Reply

Tell = Callable[[str, int, int, int | None], None]  # name, bytes on disk, new bytes, whole length


@dataclass(frozen=True)
class Origin:
    """What a part was begun from: the file's validator and length, as the server told them."""

    tag: str | None
    total: int | None

    def is_of(self, reply: Reply) -> bool:
        """Whether a reply continues the same file, so far as both tell."""
        pairs = ((self.tag, reply.tag), (self.total, reply.total))
        return all(ours is None or theirs is None or ours == theirs for ours, theirs in pairs)


@dataclass(frozen=True)
class Transfer:
    """How files are brought: from where, into which folder, with what patience."""

    remote: Remote
    ledger: FileLedger
    patience: Patience
    stop: threading.Event
    tell: Tell

    def bring(self, entry: Entry) -> None:
        """Download what is missing of a file, verify it, give it its name.

        A wrong digest is met with one download from scratch, then Damaged. Raises Incomplete where
        the server stays away, FinalFailure where it has no such file, Stopped, OSError of the disk.
        """
        part, where = self.ledger.part(entry.name), self.remote.address(entry.name)
        for _ in range(2):
            try:
                self._complete(entry.name, where, part)
            except FinalFailure as error:
                raise FinalFailure(f"{where}: {error}") from None
            digest = file_md5(part)
            if digest == entry.md5:
                self.ledger.publish(entry.name, digest)
                _origin_path(part).unlink(missing_ok=True)
                return
            discard(part)
        reason = f"its MD5 is {digest}, downloaded twice; the archive's list says {entry.md5}"
        raise Damaged(where, reason)

    def _complete(self, name: str, where: str, part: Path) -> None:
        """Go on until the part is as long as the file; failures count while no byte is new."""
        furthest, failures = size_of(part), 0
        while True:
            try:
                if self._ask(name, part):
                    return
                failure = Unavailable("the file changed while it was downloaded")
            except Unavailable as error:
                failure = error
            failures = 0 if size_of(part) > furthest else failures
            furthest = max(furthest, size_of(part))
            failures += 1
            self.patience.wait(where, failure, failures, self.stop)

    def _ask(self, name: str, part: Path) -> bool:
        """One request; whether the part is complete after it. A part of another file goes."""
        origin = read_origin(part)
        if origin is None:
            discard(part)
            origin = Origin(None, None)
        have = size_of(part)
        if 0 < have == origin.total:
            return True
        try:
            with self.remote.open(name, have, origin.tag) as reply:
                if self.stop.is_set():
                    raise Stopped
                if reply.start == 0:
                    begin(part, Origin(reply.tag, reply.total))
                    have = 0
                elif reply.start != have or not origin.is_of(reply):
                    discard(part)
                    return False
                return self._append(name, part, have, reply)
        except PastEnd as end:
            if 0 < have == end.total:
                return True
            discard(part)
            return False

    def _append(self, name: str, part: Path, have: int, reply: Reply) -> bool:
        """Write what arrives behind the first `have` bytes; whether it is all there is."""
        with part.open("ab") as file:
            for block in reply.blocks:
                if self.stop.is_set():
                    raise Stopped
                file.write(block)
                file.flush()
                have += len(block)
                self.tell(name, have, len(block), reply.total)
        if reply.total is None or have == reply.total:
            return True
        if have > reply.total:
            discard(part)
            return False
        raise Unavailable(f"the connection ended after {have} of {reply.total} bytes")


def begin(part: Path, origin: Origin) -> None:
    """An empty part; never is there a byte whose origin is not on record."""
    part.unlink(missing_ok=True)
    new = part.with_suffix(".origin")
    new.write_text(json.dumps({"tag": origin.tag, "total": origin.total}), encoding="utf-8")
    new.replace(_origin_path(part))
    part.touch()


def read_origin(part: Path) -> Origin | None:
    """What the part was begun from; None where there is no part or no sound record."""
    try:
        record = json.loads(_origin_path(part).read_text(encoding="utf-8"))
        return Origin(record["tag"], record["total"]) if part.exists() else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def discard(part: Path) -> None:
    """Remove a part and what is known of it."""
    part.unlink(missing_ok=True)
    _origin_path(part).unlink(missing_ok=True)


def size_of(path: Path) -> int:
    """Length in bytes; 0 where there is no such file."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _origin_path(part: Path) -> Path:
    return part.with_name(part.name + ".json")
