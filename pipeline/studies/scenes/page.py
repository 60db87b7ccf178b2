"""The report as one page that needs nothing beside it: text, tables, figures inside."""

from __future__ import annotations

import base64
import html
import re

from catalog_tools.documents import JsonObject
from pipeline.studies.scenes.tables import (
    Table,
    explained,
    rung_table,
    switch_table,
)

STYLE = (
    "body{font:15px/1.45 sans-serif;margin:2em auto;max-width:86em;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:1em 0;font-variant-numeric:tabular-nums}"
    "td,th{padding:.15em .7em;text-align:right;border-bottom:1px solid #ddd}"
    "td:first-child,th:first-child,td:nth-child(2),th:nth-child(2){text-align:left}"
    "th{border-bottom:2px solid #888}img{max-width:100%;height:auto}"
    ".wide{overflow-x:auto}h1{font-size:1.6em}h2{font-size:1.2em;margin-top:2em}"
)


def page(study: JsonObject, ladder_png: bytes, omissions_png: bytes) -> str:
    """HTML of a study with its figures."""
    notes = "".join(f"<li>{_coded(line)}</li>" for line in explained(study))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"/>'
        '<meta name="viewport" content="width=device-width"/>'
        f"<title>Error against run time</title><style>{STYLE}</style></head><body>"
        "<h1>Whole scenes: error against run time</h1>"
        f"<ul>{notes}</ul>"
        f"{_picture(ladder_png, 'error of a pixel against CPU time, a panel a scene')}"
        f"<h2>Scenes, rung by rung</h2>{_table(rung_table(study))}"
        "<h2>Approximations, one at a time switched off</h2>"
        f"{_picture(omissions_png, 'bound and error of each approximation')}"
        f"{_table(switch_table(study))}</body></html>\n"
    )


def _coded(line: str) -> str:
    """A line of text; what stands in back ticks is code."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(line))


def _picture(png: bytes, what: str) -> str:
    text = base64.b64encode(png).decode()
    return f'<p><img alt="{html.escape(what)}" src="data:image/png;base64,{text}"/></p>'


def _table(content: Table) -> str:
    heads, rows = content
    head = "".join(f"<th>{html.escape(h)}</th>" for h in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows
    )
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="wide">{table}</div>'
