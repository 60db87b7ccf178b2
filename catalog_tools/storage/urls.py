"""Which places are URLs; for whoever must not import an object store to know."""

from __future__ import annotations

import os
import re


def is_url(place: str | os.PathLike[str]) -> bool:
    """Whether a result is to go to a URL, and not to a file system."""
    return re.match("[A-Za-z][A-Za-z0-9+.-]+:/", os.fspath(place)) is not None
