"""The command line's `nightglass study`: what sensors observe of a catalogue, with what gaps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from catalog_tools.documents import JsonObject
from pipeline.capacity.run import StudyOptions, forecast_of, run_study
from pipeline.commands.jobs import Server, run_there
from pipeline.commands.options import (
    Json,
    Output,
    Overrides,
    SchedulerName,
    Workers,
    print_json,
    print_mapping,
    told_if_interrupted,
)
from pipeline.commands.pages import is_quiet, progress_listener
from pipeline.errors import BadInput
from pipeline.lines import fold, pair
from pipeline.spec.study_load import read_study

LONG_S = 600.0  # of one core: what is known of such a study is told before it runs


def study(
    file: Annotated[Path, typer.Argument(help="study file, YAML or JSON", metavar="STUDY")],
    output: Output = Path("study"),
    set_: Overrides = None,
    scheduler: SchedulerName = "processes",
    workers: Workers = None,
    resume: Annotated[bool, typer.Option("--resume", help="go on with an unfinished one")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only say what it takes")] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="run it even where the forecast is days")
    ] = False,
    server: Server = None,
    as_json: Json = False,
) -> None:
    """Run a study of capacity: what sensors observe of a catalogue, how often, with what gaps."""
    data, folder = read_study(file, set_ or []), file.parent
    if server is not None:
        if resume or dry_run or yes or workers is not None or scheduler != "processes":
            allowed = "without --resume, --dry-run, --yes, --workers, --scheduler"
            raise BadInput("--server", "with them", allowed)
        _tell(run_there("study", data, output, server, as_json), output, as_json)
        return

    if dry_run:
        told = forecast_of(data, folder)
        remarks = [] if as_json else told.pop("remarks")
        print_mapping(told, as_json)
        _print_notes(remarks)
        return
    options = StudyOptions(scheduler, workers, resume, yes)
    kept = told_if_interrupted(str(output), lambda: "finished tasks are kept")
    with kept, progress_listener("tasks", is_quiet(as_json)) as listen:
        report = run_study(data, folder, output, options, listen, None if as_json else _foretell)
    _tell(report, output, as_json)


def _foretell(told: JsonObject) -> None:
    """What to know of a long study before it has run: it may not be worth its time."""
    if told["cpu_s"] > LONG_S:
        print(f"{told['cpu_s'] / 60.0:.0f} min of one core")
        _print_notes(told["remarks"])


def _tell(report: JsonObject, output: Path, as_json: bool) -> None:
    if as_json:
        print_json(report)
    else:
        _print_report(report, output)


def _print_report(report: JsonObject, output: Path) -> None:
    figures = report.get("figures")
    if figures is None:
        failed = report.get("failed", 0)  # a server may be older
        told = f"{len(report['points'])} points, {failed} failed"
        print(f"{output}: {told}; {output / 'points.parquet'}")
        _print_notes(report.get("notes", []))
        return
    print(f"{output}: {report['study']}, {report['hours']:g} h in {report['seconds']:.1f} s")
    for name, value in figures.items():
        print(pair(name, "none" if value is None else f"{value:.6g}", 24))
    _print_notes(report["notes"])
    print(f"  {output / 'report.html'}, {output / 'objects.parquet'}")


def _print_notes(notes: list[str]) -> None:
    for note in notes:
        print(fold(note, " " * 8, "  note: "))
