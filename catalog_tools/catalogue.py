"""A catalogue on disk: its manifest, the leaves it is made of, and their magnitude bands.

The manifest `nightglass.json` lies beside the HATS files. It holds what a planner needs (where the
leaves lie, how bright their rows are, how many) so that planning reads one small file and no star;
and what a reader needs to prove a shard whole (lengths and crc32c of file, row groups, footer).
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .errors import BadInput, Damaged

MANIFEST_NAME = "nightglass.json"
FORMAT = "nightglass/catalogue"
VERSION = 1
MAKE_ONE = (
    "a catalogue; make one with `nightglass catalog demo -o PATH` or `nightglass catalog ingest`"
)


@dataclass(frozen=True)
class Band:
    """One row group of a shard: a range of G magnitudes, both ends occurring, and its bytes."""

    row_group: int
    brightest_g_mag: float
    faintest_g_mag: float
    rows: int
    bytes: int
    offset: int
    crc32c: int


@dataclass(frozen=True)
class Leaf:
    """One shard: a nested HEALPix pixel with rows, and the cap (centre, radius) that bounds them.

    The cap and the largest motions are of the rows that are there, not of the pixel.
    """

    order: int
    pixel: int
    rows: int
    path: str
    bytes: int
    crc32c: int
    centre: tuple[float, float, float]
    radius_rad: float
    max_proper_motion_mas_yr: float
    max_parallax_mas: float
    footer_bytes: int
    footer_crc32c: int
    bands: tuple[Band, ...]


class Caps(NamedTuple):
    """The leaves' bounds as arrays: centres (n, 3), and (n,) radii [rad], motions, parallaxes."""

    centres: np.ndarray
    radii_rad: np.ndarray
    proper_motions_mas_yr: np.ndarray
    parallaxes_mas: np.ndarray


@dataclass(frozen=True)
class Catalogue:
    """What the manifest says. `digest` (sha256 of its content) names the catalogue's exact bits."""

    path: str
    name: str
    description: str
    ref_epoch_jyear: float
    synthetic: bool
    rows: int
    brightest_g_mag: float | None
    faintest_g_mag: float | None
    leaves: tuple[Leaf, ...]
    sources: tuple[dict[str, Any], ...]
    rejected: dict[str, int]
    facts: dict[str, Any]
    digest: str

    @cached_property
    def caps(self) -> Caps:
        """The leaves' bounds, gathered once."""
        return Caps(
            np.array([leaf.centre for leaf in self.leaves], float).reshape(-1, 3),
            np.array([leaf.radius_rad for leaf in self.leaves], float),
            np.array([leaf.max_proper_motion_mas_yr for leaf in self.leaves], float),
            np.array([leaf.max_parallax_mas for leaf in self.leaves], float),
        )

    def shard_path(self, leaf: Leaf) -> Path:
        """Where a leaf's Parquet file lies."""
        return Path(self.path) / leaf.path


def write_manifest(folder: Path, catalogue: Catalogue) -> str:
    """Write the manifest into `folder`; returns its digest (the one given is not looked at)."""
    content = {f.name: getattr(catalogue, f.name) for f in fields(Catalogue)}
    for key in ("path", "digest"):
        del content[key]
    content["leaves"] = [asdict(leaf) for leaf in catalogue.leaves]
    content = json.loads(json.dumps(content, allow_nan=False))
    digest = _digest(content)
    head = {"format": FORMAT, "version": VERSION, "sha256": digest}
    text = json.dumps({**head, "catalogue": content}, separators=(",", ":"), sort_keys=True)
    (folder / MANIFEST_NAME).write_text(text + "\n", encoding="utf-8")
    return digest


def open_catalogue(path: str | Path, *, field: str = "catalogue") -> Catalogue:
    """Read a catalogue's manifest: one JSON file, no star.

    Raises BadInput (naming `field`) where there is no catalogue, one of another format or of a
    newer version, and Damaged where the manifest's content does not match its own digest.
    """
    folder = Path(path)
    manifest = folder / MANIFEST_NAME
    try:
        text = manifest.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        raise BadInput(field, str(path), _what_is_there(folder)) from None
    except (UnicodeDecodeError, OSError) as error:
        raise Damaged(str(manifest), f"cannot be read ({error})") from None
    try:
        document = json.loads(text)
    except ValueError as error:
        raise Damaged(str(manifest), f"is not JSON ({error})") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise BadInput(field, str(path), f"a manifest of format {FORMAT!r}")
    if document.get("version") != VERSION:
        allowed = f"manifest version {VERSION} (this program is older or newer than the catalogue)"
        raise BadInput(field, document.get("version"), allowed)
    content = document.get("catalogue")
    if not isinstance(content, dict) or _digest(content) != document.get("sha256"):
        raise Damaged(str(manifest), "its content does not match its digest")
    return _parse(str(folder), content, document["sha256"])


def _digest(content: dict[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _parse(path: str, content: dict[str, Any], digest: str) -> Catalogue:
    leaves = tuple(
        Leaf(
            **{
                **leaf,
                "centre": tuple(leaf["centre"]),
                "bands": tuple(Band(**band) for band in leaf["bands"]),
            }
        )
        for leaf in content["leaves"]
    )
    rest = {**content, "leaves": leaves, "sources": tuple(content["sources"])}
    return Catalogue(path=path, digest=digest, **rest)


def _what_is_there(folder: Path) -> str:
    """Why a path without a manifest is no catalogue, in the words of the error."""
    if not folder.exists():
        return f"{MAKE_ONE} (there is nothing at that path)"
    if not folder.is_dir():
        return f"{MAKE_ONE} (that is a file, not a catalogue's folder)"
    if any((folder / name).exists() for name in ("hats.properties", "properties")):
        return (
            f"a catalogue with {MANIFEST_NAME}: this is a HATS catalogue of another program; "
            "ingest its source files with `nightglass catalog ingest`"
        )
    return f"{MAKE_ONE} (that folder holds no {MANIFEST_NAME})"
