"""The catalogues that the service offers: folders of its registry, known by their names."""

from __future__ import annotations

import re
from pathlib import Path

from catalog_tools.catalogue import MANIFEST_NAME, open_catalogue
from catalog_tools.documents import JsonObject
from catalog_tools.info import info
from pipeline.errors import BadInput, Damaged
from service.problems import Mistake

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
SHOWN = (
    "description",
    "synthetic",
    "ref_epoch_jyear",
    "rows",
    "leaves",
    "bytes",
    "brightest_g_mag",
    "faintest_g_mag",
    "coverage",
    "without_colour",
    "digest",
)


def catalogue_names(registry: Path) -> list[str]:
    """Names of the registered catalogues, in order; no catalogue is opened."""
    return sorted(
        entry.name
        for entry in registry.iterdir()
        if NAME.fullmatch(entry.name) and (entry / MANIFEST_NAME).is_file()
    )


def catalogue_mistakes(field: str, value: str | list[str], registry: Path) -> list[Mistake]:
    """A name that is not registered, or each such one in a list of names."""
    names = catalogue_names(registry)
    allowed = (
        f"the name of a registered catalogue: {', '.join(names[:10]) or '(none is registered)'}"
    )
    named = (
        [(field, value)]
        if isinstance(value, str)
        else [(f"{field}[{i}]", name) for i, name in enumerate(value)]
    )
    return [(where, name, allowed) for where, name in named if name not in names]


def catalogue_facts(registry: Path, name: str) -> JsonObject:
    """What a catalogue holds, from its manifest, without any path of the server."""
    try:
        found = info(open_catalogue(registry / name))
    except (BadInput, Damaged):
        reason = "its manifest is damaged or of another version"
        return {"name": name, "usable": False, "reason": reason}
    return {"name": name, "usable": True} | {key: found[key] for key in SHOWN}
