"""How much memory this process may take: what the machine has free, and its own limits."""

from __future__ import annotations

from pathlib import Path

import psutil

GROUP = Path("/sys/fs/cgroup")  # Linux: the limit of a container or a job


def free_mb() -> float:
    """Memory that this process may hold, with what it holds already [MB]."""
    own = psutil.Process().memory_info().rss
    free = psutil.virtual_memory().available
    limit = _number(GROUP / "memory.max")
    if limit is not None:
        held = (_number(GROUP / "memory.current") or 0.0) - _files_cached()
        free = min(free, limit - max(held, 0.0))
    return (max(free, 0.0) + own) / 1e6


def _files_cached() -> float:
    """Bytes of files that the group's memory holds: given back as soon as others need them."""
    try:
        told = dict(line.split() for line in (GROUP / "memory.stat").read_text().splitlines())
        return float(told["inactive_file"]) + float(told["active_file"])
    except (OSError, ValueError, KeyError):
        return 0.0


def _number(path: Path) -> float | None:
    """The number in a file; None where there is none."""
    try:
        text = path.read_text().strip()
    except OSError:
        return None
    return float(text) if text.isdigit() else None
