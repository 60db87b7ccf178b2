"""The user's home folder, where there is none: astropy cannot be imported without."""

from __future__ import annotations

import os
from pathlib import Path


def ensure_home() -> None:
    """HOME is / where none can be told (a user without a name), or it may not be looked into."""
    try:
        Path("~/.astropy/config").expanduser().exists()
    except (RuntimeError, OSError):
        os.environ["HOME"] = "/"
