"""The report as one page that needs nothing beside it: text, tables, figures inside."""

from __future__ import annotations

import html
import re

from catalog_tools.documents import JsonObject
from pipeline.report_page import document, picture, table
from pipeline.studies.scenes.tables import (
    explained,
    level_table,
    switch_table,
)


def page(study: JsonObject, ladder_png: bytes, omissions_png: bytes) -> str:
    """HTML of a study with its figures."""
    notes = "".join(f"<li>{_coded(line)}</li>" for line in explained(study))
    return document(
        "Error against run time",
        "<h1>Whole scenes: error against run time</h1>"
        f"<ul>{notes}</ul>"
        f"{picture(ladder_png, 'error of a pixel against CPU time, a panel a scene')}"
        f"<h2>Scenes, level by level</h2>{table(*level_table(study))}"
        "<h2>Approximations, one at a time switched off</h2>"
        f"{picture(omissions_png, 'bound and error of each approximation')}"
        f"{table(*switch_table(study))}",
    )


def _coded(line: str) -> str:
    """A line of text; what stands in back ticks is code."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(line))
