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
        free = min(free, limit - (_number(GROUP / "memory.current") or 0.0))
    return (max(free, 0.0) + own) / 1e6


def _number(path: Path) -> float | None:
    """The number in a file; None where there is none."""
    try:
        text = path.read_text().strip()
    except OSError:
        return None
    return float(text) if text.isdigit() else None
