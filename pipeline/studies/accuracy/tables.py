"""The study as tables: Markdown for a file, and a page for people."""

from __future__ import annotations

from collections.abc import Iterator

from catalog_tools.documents import JsonObject
from pipeline.lines import fold, markdown_table, table

Row = JsonObject

HEADS = (
    "engine",
    "setting",
    "CPU s",
    "us/star",
    "table s",
    "error/peak",
    "sigma",
    "light error",
)


def by_case(study: JsonObject) -> Iterator[tuple[str, list[Row]]]:
    """(title, rows) of each case, in the order that they were measured."""
    found: dict[str, list[Row]] = {}
    for r in study["records"]:
        moving = f"{r['streak_px']:g} px{' curved' if r['curved'] else ''} streak"
        title = f"{r['psf']}, {moving if r['streak_px'] else 'no streak'}"
        found.setdefault(title, []).append(r)
    yield from found.items()


def cells(row: Row) -> tuple[str, ...]:
    """A row as text; a star marks the Pareto front, ~ a time scaled up from fewer stars."""
    scaled = "~" if row["stars_timed"] < row["stars"] else ""
    return (
        row["engine"] + (" *" if row["pareto"] else ""),
        row["setting"],
        f"{scaled}{row['cpu_s']:.3g}",
        f"{1e6 * row['cpu_s_per_star']:.3g}",
        f"{row['table_s']:.2g}",
        f"{row['error_of_peak']:.1e}",
        f"{row['error_sigma']:.1e}",
        "-" if row["flux_error"] is None else f"{row['flux_error']:.1e}",
    )


def explained(study: JsonObject) -> list[str]:
    """What the columns mean, what was not measured, and which peers were there."""
    noise, (rows, columns) = study["noise"], study["frame"]
    lines = [
        f"{study['stars']:,} stars on {columns} x {rows} pixels. * is on the Pareto front; ~ is "
        f"scaled up from fewer stars. `sigma`: the error beside a star of {noise['star_e']:.0e} e- "
        f"over a noise of {noise['floor_e']:g} e- a pixel.",
        *study["notes"],
    ]
    for p in study["peers"]:
        state = p["version"] or "not installed: not measured"
        lines.append(f"{p['name']}: {state}. Cannot: {p['cannot']}.")
    lines += [f"{f['engine']}, {f['setting']}, {f['case']}: {f['why']}" for f in study["failed"]]
    return lines


def markdown(study: JsonObject) -> str:
    """The whole study as Markdown."""
    out = ["# Error against CPU time", "", *(f"- {line}" for line in explained(study))]
    for title, rows in by_case(study):
        out += ["", f"## {title}", "", markdown_table(HEADS, map(cells, rows), 2).rstrip()]
    return "\n".join(out) + "\n"


def print_study(study: JsonObject) -> None:
    """The study on the terminal."""
    for title, rows in by_case(study):
        print(title)
        print(table(HEADS, [cells(r) for r in rows], 2), end="\n\n")
    for line in explained(study):
        print(fold(line))
