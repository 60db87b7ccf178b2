"""`nightglass report scenes`: run the study, write it as JSON, a page and figures."""

from __future__ import annotations

import tempfile
from pathlib import Path

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput, make_folder
from pipeline.inputs.stars.catalogues import open_catalogues
from pipeline.lazily import need_matplotlib
from pipeline.lines import markdown_table
from pipeline.studies.scenes.figure import ladder_figure, omission_figure
from pipeline.studies.scenes.page import page
from pipeline.studies.scenes.scenes import requests
from pipeline.studies.scenes.study import Progress, checked_levels, run_study
from pipeline.studies.scenes.tables import (
    explained,
    level_table,
    switch_table,
)
from pipeline.studies.written import write_study


def report_scenes(
    out: Path,
    scenes: tuple[str, ...] = (),
    levels: str | None = None,
    quick: bool = False,
    catalogue: Path | None = None,
    progress: Progress | None = None,
) -> JsonObject:
    """Measure, and write report.json, report.html, report.md and two figures into a new folder.

    scenes : names, all where there is none; levels : accuracy targets, "0.5,0.05"
    catalogue : of stars; default a synthetic one, made for it. progress : (stage, done, total)
    Returns what report.json holds. Raises BadInput before anything is measured: for a name or level
    that is none, a folder that is not empty, a catalogue that is none, a library that is missing.
    """
    chosen = checked_levels(levels, quick)
    requests(scenes, quick)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise BadInput("-o", str(out), "a new or empty folder")
    need_matplotlib()
    if catalogue is not None:
        open_catalogues((str(catalogue),))
    make_folder(out)
    with tempfile.TemporaryDirectory(prefix="nightglass-report-") as folder:
        study = run_study(scenes, chosen, quick, catalogue, Path(folder), progress)
    write(study, out)
    return study


def write(study: JsonObject, out: Path) -> None:
    """Write a study into a folder."""
    ladder, omissions = ladder_figure(study), omission_figure(study)
    write_study(out / "report.json", study)
    (out / "report.html").write_text(page(study, ladder, omissions), encoding="utf-8")
    (out / "report.md").write_text(text(study), encoding="utf-8")
    (out / "report.png").write_bytes(ladder)
    (out / "omissions.png").write_bytes(omissions)


def text(study: JsonObject) -> str:
    """The study as Markdown, without its figures."""
    notes = "\n".join(f"- {line}" for line in explained(study))
    levels, switches = (markdown_table(*t, 2) for t in (level_table(study), switch_table(study)))
    return (
        f"{notes}\n\n## Scenes, level by level\n\n{levels}\n"
        f"## Approximations, one at a time switched off\n\n{switches}"
    )
