"""Which code runs: what bits follow from beside what is asked for."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("catalog_tools", "pipeline")
LIBRARIES = ("numpy", "scipy", "numba")


def own_version() -> str:
    """The version that is installed; of source that is not, its digest."""
    try:
        return version("nightglass")
    except PackageNotFoundError:
        return f"source {code_digest()}"


def sources(folder: Path) -> Iterator[bytes]:
    """Name and content of each Python file below a folder, in order."""
    for path in sorted(folder.rglob("*.py")):
        yield path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes()


@cache
def code_digest() -> str:
    """Digest of this installation's Python files that draw, and of its numerical libraries.

    Two processes with the same one give the same bits on one kind of processor; a version's number
    does not tell, as code changes between releases.
    """
    told = hashlib.sha256()
    for package in PACKAGES:
        spec = find_spec(package)
        assert spec is not None
        for source in sources(Path(str(spec.origin)).parent):
            told.update(package.encode() + b"/" + source + b"\0")
    for library in LIBRARIES:
        told.update(version(library).encode() + b"\0")
    return told.hexdigest()[:16]
