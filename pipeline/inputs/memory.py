"""How much memory this process may take: what the machine has free, and its own limits."""

from __future__ import annotations

from pathlib import Path

import psutil

GROUP = Path("/sys/fs/cgroup")  # Linux: the limits of containers and jobs
OWN_GROUP = Path("/proc/self/cgroup")


def free_mb() -> float:
    """Memory that this process may hold, with what it holds already [MB]."""
    own = psutil.Process().memory_info().rss
    free = psutil.virtual_memory().available
    for group in _groups():
        limit = _number(group / "memory.max")
        if limit is not None:
            held = (_number(group / "memory.current") or 0.0) - _files_cached(group)
            free = min(free, limit - max(held, 0.0))
    return (max(free, 0.0) + own) / 1e6


def _groups() -> list[Path]:
    """This process's group, and those that hold it, whose limits are its own too."""
    try:
        lines = OWN_GROUP.read_text().splitlines()
    except OSError:
        lines = []
    own = next((line[3:].strip("/") for line in lines if line.startswith("0::")), "")
    parts = Path(own).parts
    return [GROUP.joinpath(*parts[:n]) for n in range(len(parts) + 1)]


def _files_cached(group: Path) -> float:
    """Bytes of files that a group's memory holds: given back as soon as others need them."""
    try:
        told = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
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
