"""Logs as JSON lines: time, level, message, and the job, attempt, tile, request they belong to."""

from __future__ import annotations

import json
import logging
import os
import re
import sys
from datetime import UTC, datetime

from catalog_tools.documents import JsonObject

NAMES = ("job", "attempt", "tile", "team", "request", "method", "path", "status", "ms")
LEVELS = ("DEBUG", "INFO", "WARNING", "ERROR")
SECRETS = re.compile(
    r"ng_([0-9a-f]{12})_[A-Za-z0-9_-]+"  # an API key: its id may be told
    r"|(?i:bearer)\s+\S+"
    r"|eyJ[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]*"  # a signed token
    r"|(?<=://)[^/\s:@]+:[^/\s@]+(?=@)"  # user and password of a URL
)


def redact(text: str) -> str:
    """Text without keys, tokens and passwords."""
    return SECRETS.sub(lambda m: f"ng_{m[1]}_***" if m[1] else "***", text)


class JsonLines(logging.Formatter):
    """One JSON object a line; what a record carries as `extra` stands beside the message."""

    def format(self, record: logging.LogRecord) -> str:
        line: JsonObject = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "message": redact(record.getMessage()),
        }
        for name in NAMES:
            value = record.__dict__.get(name)
            if value is not None:
                line[name] = redact(value) if isinstance(value, str) else value
        if record.exc_info:
            line["traceback"] = redact(self.formatException(record.exc_info))
        return json.dumps(line)


def set_up() -> None:
    """All logs of this process to stderr, as JSON lines; NIGHTGLASS_LOG: how much of our own."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines())
    wanted = os.environ.get("NIGHTGLASS_LOG", "info")
    known = wanted.upper() in LEVELS
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    ours = logging.getLogger("nightglass")
    ours.setLevel(wanted.upper() if known else logging.INFO)
    if not known:
        ours.warning("NIGHTGLASS_LOG: %s is none of %s: info", wanted, ", ".join(LEVELS).lower())
    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.captureWarnings(True)


def of_job(order: JsonObject) -> JsonObject:
    """What every line of a worker's log carries."""
    return {name: order.get(name) for name in ("job", "attempt")}
