"""Parts of a report page that needs nothing beside it: its frame, tables, pictures inside."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence

STYLE = (
    "body{font:15px/1.45 sans-serif;margin:2em auto;max-width:86em;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:1em 0;font-variant-numeric:tabular-nums}"
    "td,th{padding:.15em .7em;text-align:right;border-bottom:1px solid #ddd}"
    "td:first-child,th:first-child,td:nth-child(2),th:nth-child(2){text-align:left}"
    "th{border-bottom:2px solid #888}img{max-width:100%;height:auto}"
    ".wide{overflow-x:auto}h1{font-size:1.6em}h2{font-size:1.2em;margin-top:2em}"
)


def document(title: str, body: str) -> str:
    """A whole page; `title` is text, `body` HTML."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"/>'
        '<meta name="viewport" content="width=device-width"/>'
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head><body>"
        f"{body}</body></html>\n"
    )


def picture(png: bytes, what: str) -> str:
    """A picture inside the page; `what` is said of it where it is not seen."""
    text = base64.b64encode(png).decode()
    return f'<p><img alt="{html.escape(what)}" src="data:image/png;base64,{text}"/></p>'


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of text."""
    head = "".join(f"<th>{html.escape(h)}</th>" for h in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows
    )
    content = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="wide">{content}</div>'
