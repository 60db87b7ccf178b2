"""The engine in a process of its own: one order on stdin, JSON lines of progress on stdout.

It works in the folder of catalogues (`service.engine.forks` begins it there), so that a
catalogue's registered name is its path and no path of the server enters a product. It ends at
once when its stdin closes: a worker never outlives the process that watches it.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import re
import sys
import threading
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from catalog_tools.catalogue import MANIFEST_NAME
from catalog_tools.documents import JsonObject
from pipeline.errors import NO_ROOM, BadInput, Damaged, DiskFull, NightglassError, TryLater
from service import logs
from service.problems import cut, mistake_dict, mistakes_of

log = logging.getLogger("nightglass.engine")


def main() -> None:
    """Read the order, do it, say how it went."""
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # whatever a library prints must not be taken for an answer
    line = sys.stdin.buffer.readline()
    if not line.endswith(b"\n"):  # the parent died before it had said all
        sys.exit(1)
    order = json.loads(line)
    logs.set_up()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    say = partial(_say, answers)
    try:  # what is loaded now may print, or fail
        say(import_module("service.engine.orders").ORDERS[order["do"]](order, say))
    except Exception as error:
        if not isinstance(error, NightglassError):
            log.exception("the engine failed", extra=logs.of_job(order))
        say({"outcome": "error", "error": describe(error, order)})


def _end_with_parent() -> None:
    while os.read(0, 4096):
        pass
    os._exit(1)


def _say(answers: BinaryIO, message: JsonObject) -> None:
    answers.write(json.dumps(message).encode() + b"\n")


def describe(error: Exception, order: JsonObject) -> JsonObject:
    """An error as the job shows it: one message, and the fields to mend; no path of the server,
    and uploaded files by the names that their user gave them."""
    errors: list[JsonObject] = []
    if gone := _catalogues_gone(order):
        kind, message = "try later", f"the catalogue {gone[0]} is not there now"
    elif mistakes := [_without_paths(m, order) for m in mistakes_of(error)[:20]]:
        errors = [mistake_dict(mistake) for mistake in mistakes]
        kind, message = "bad input", cut(str(BadInput(*mistakes[0])))
    elif isinstance(error, Damaged):
        place, reason = _clean(Path(error.path).name, order), _clean(error.reason, order)
        kind, message = "damaged", cut(str(Damaged(place, reason)))
    elif code := _full_disk(error):
        told = f"the server's disk is full ({os.strerror(code)}); submit again when there is room"
        kind, message = "disk full", told
    elif isinstance(error, NightglassError):
        kind = "try later" if isinstance(error, TryLater) else "incomplete"
        message = cut(_clean(str(error), order))
    else:
        kind, message = "fault", _fault(error)
    return {"kind": kind, "message": message, "errors": errors}


def _full_disk(error: Exception) -> int:
    """The system's number for it; 0 where an error is of something else."""
    if isinstance(error, DiskFull):
        return error.code or errno.ENOSPC
    return error.errno or 0 if isinstance(error, OSError) and error.errno in NO_ROOM else 0


def _fault(error: Exception) -> str:
    if isinstance(error, OSError):
        return f"the server could not read or write: {error.strerror or type(error).__name__}"
    if isinstance(error, MemoryError):
        return "the server has not enough memory"
    return "an internal fault; the server's log has the details"


def _catalogues_gone(order: JsonObject) -> list[str]:
    """Registered catalogues that an accepted scene names and whose folder or link is gone."""
    scene = order["scene"]
    scene = scene.get("scene", scene)  # of a sweep: its base
    named = (scene.get("stars") or {}).get("catalogue") or []
    names = [named] if isinstance(named, str) else named
    return [name for name in names if not (Path(name) / MANIFEST_NAME).is_file()]


def _without_paths(mistake: tuple[str, Any, str], order: JsonObject) -> tuple[str, Any, str]:
    field, value, allowed = mistake
    value = _clean(value, order) if isinstance(value, str) else value
    return field, value, _clean(allowed, order)


def _clean(text: str, order: JsonObject) -> str:
    """Text with the places of the server's folders cut out, and the user's names of files."""
    for file_id, name in order.get("files", {}).items():
        for place in set(re.findall(rf"[\w./-]*{re.escape(file_id)}", text)):
            text = text.replace(place, name)
    product = order.get("product")
    places = [(str(Path.cwd()), "catalogues")]
    if product is not None:
        places += [(str(Path(product).resolve()), "product"), (product, "product")]
    for place, name in places:
        text = text.replace(place, name)
    return text
