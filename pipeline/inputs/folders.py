"""Where the product keeps what it may compute again: caches under the user's folder."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """NIGHTGLASS_CACHE, else the platform's cache folder (XDG_CACHE_HOME or ~/.cache)."""
    named = os.environ.get("NIGHTGLASS_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "nightglass"
