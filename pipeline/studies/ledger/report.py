"""`nightglass report ledger`: measure every rule of the plan, as JSON and a table."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput, Missing, make_folder
from pipeline.lines import markdown_table, table
from pipeline.studies.ledger.study import Progress, checked_rules, run_ledger
from pipeline.studies.written import write_study

Row = JsonObject
HEADS = ("component", "bound", "error caused", "CPU s saved", "holds", "measured")


def report_ledger(out: Path, rules: tuple[str, ...] = (), progress: Progress | None = None) -> Row:
    """Measure, and write ledger.json and ledger.md into a new folder; returns what is in the JSON.

    rules : names of components, all where there is none. Raises BadInput before anything is
    measured: for a name that is none, a folder that is not empty, a library that is missing.
    """
    checked_rules(rules)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise BadInput("-o", str(out), "a new or empty folder")
    if find_spec("trimesh") is None:
        raise Missing("the ledger's meshes", "trimesh", "mesh")
    make_folder(out)
    study = run_ledger(rules, progress)
    write_study(out / "ledger.json", study)
    (out / "ledger.md").write_text(text(study), encoding="utf-8")
    return study


def rows(study: Row) -> list[tuple[str, ...]]:
    """Every measurement as cells of a table, in the order of HEADS."""
    return [
        (
            one["component"],
            f"{one['bound']:.2g} {one['unit']}",
            "-" if one["error"] is None else f"{one['error']:.2g} {one['unit']}",
            f"{one['seconds_saved']:.1g}",
            "yes" if one["holds"] else "NO",
            one["how"],
        )
        for rule in study["rules"]
        for one in rule["all"]
    ]


def text(study: Row) -> str:
    """The study as Markdown."""
    head = f"{len(study['rules'])} rules, {study['cpu_s']:.0f} CPU s, {study['nightglass']}.\n\n"
    return head + markdown_table(HEADS, rows(study), len(HEADS))


def print_ledger(study: Row) -> None:
    """The study on the terminal."""
    heads, cells = (HEADS[0], *HEADS[:0:-1]), [(r[0], *r[:0:-1]) for r in rows(study)]
    print(table(heads, cells, 2))
