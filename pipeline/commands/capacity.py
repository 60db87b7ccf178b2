"""The command line's `nightglass find` and `nightglass study`: what sensors can see."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from catalog_tools.documents import JsonObject
from pipeline.commands.jobs import Server, run_there
from pipeline.commands.options import (
    Json,
    Output,
    Overrides,
    SceneFile,
    SchedulerName,
    Workers,
    print_json,
    print_mapping,
    told_if_interrupted,
)
from pipeline.commands.pages import progress_listener
from pipeline.errors import BadInput
from pipeline.lines import fold, pair

if TYPE_CHECKING:
    from pipeline.survey.find import FoundObjects


def find(
    scene: SceneFile,
    set_: Overrides = None,
    at: Annotated[str | None, typer.Option("--at", help="UTC; default: the epoch")] = None,
    hours: Annotated[float, typer.Option(help="look so long from there; 0: that moment")] = 0.0,
    night: Annotated[bool, typer.Option("--night", help="the dark hours then or next")] = False,
    step: Annotated[float, typer.Option(min=0.1, max=600, help="seconds between moments")] = 10.0,
    snr: Annotated[float, typer.Option(min=0.01, help="least SNR of one frame")] = 5.0,
    elevation: Annotated[float, typer.Option(min=0, max=89, help="lowest, in degrees")] = 20.0,
    twilight: Annotated[float, typer.Option(min=-18, max=0, help="Sun's highest, deg")] = -12.0,
    most: Annotated[int, typer.Option("--most", min=1, help="rows shown")] = 20,
    workers: Workers = None,
    as_json: Json = False,
) -> None:
    """Which objects of a scene's populations can be seen, when and where to point: best first."""
    from pipeline.spec.load import load_scene
    from pipeline.spec.study import FieldOfRegard
    from pipeline.survey.find import FindOptions
    from pipeline.survey.find import find as look

    regard = FieldOfRegard(lowest_elevation_deg=elevation, twilight_deg=twilight)
    request = FindOptions(at, hours, night, step, snr, regard)
    found = look(load_scene(scene, set_ or []), request, workers)
    if as_json:
        print_json(asdict(found))
    else:
        _print_finding(found, most)


def _print_finding(found: FoundObjects, most: int) -> None:
    span = found.start if found.start == found.end else f"{found.start} to {found.end}"
    print(f"{len(found.objects)} of {found.looked_at} objects can be seen, {span}")
    if found.objects:
        print(
            f"  {'object':<22} {'best UTC':<8} {'RA':>7} {'Dec':>6} {'elev':>4} {'km':>6}"
            f" {'V':>5} {'px':>5} {'SNR':>6}"
        )
    for o in found.objects[:most]:
        name = f"{o['name'][:15]} {o['number']}"[:22]
        print(
            f"  {name:<22} {o['best'][11:19]:<8} {o['ra_deg']:7.3f} {o['dec_deg']:6.2f}"
            f" {o['elevation_deg']:4.0f} {o['range_km']:6.0f} {o['v_mag']:5.1f}"
            f" {o['streak_px']:5.0f} {o['snr']:6.1f}"
        )
    if (left := len(found.objects) - most) > 0:
        print(f"  {left} more: --most {len(found.objects)}, or --json")
    for note in found.notes:
        print(fold(note, " " * 8, "  note: "))


def study(
    file: Annotated[Path, typer.Argument(help="study file, YAML or JSON", metavar="STUDY")],
    output: Output = Path("study"),
    set_: Overrides = None,
    scheduler: SchedulerName = "processes",
    workers: Workers = None,
    resume: Annotated[bool, typer.Option("--resume", help="go on with an unfinished one")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only say what it takes")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="even where that is days")] = False,
    server: Server = None,
    as_json: Json = False,
) -> None:
    """Run a study of capacity: what sensors observe of a catalogue, how often, with what gaps."""
    from pipeline.spec.study_load import read_study

    data, folder = read_study(file, set_ or []), file.parent
    if server is not None:
        if resume or dry_run or yes or workers is not None or scheduler != "processes":
            allowed = "without --resume, --dry-run, --yes, --workers, --scheduler"
            raise BadInput("--server", "with them", allowed)
        _tell(run_there("study", data, output, server, as_json), output, as_json)
        return
    from pipeline.capacity.run import StudyOptions, forecast_of, run_study

    if dry_run:
        print_mapping(forecast_of(data, folder), as_json)
        return
    options = StudyOptions(scheduler, workers, resume, yes)
    kept = told_if_interrupted(str(output), lambda: "finished tasks are kept")
    with kept, progress_listener("tasks", as_json or not sys.stderr.isatty()) as listen:
        report = run_study(data, folder, output, options, listen)
    _tell(report, output, as_json)


def _tell(report: JsonObject, output: Path, as_json: bool) -> None:
    if as_json:
        print_json(report)
    else:
        _print_report(report, output)


def _print_report(report: JsonObject, output: Path) -> None:
    figures = report.get("figures")
    if figures is None:
        print(f"{output}: {len(report['points'])} points; {output / 'points.parquet'}")
        return
    print(f"{output}: {report['study']}, {report['hours']:g} h in {report['seconds']:.1f} s")
    for name, value in figures.items():
        print(pair(name, "none" if value is None else f"{value:.6g}", 24))
    for note in report["notes"]:
        print(fold(note, " " * 8, "  note: "))
    print(f"  {output / 'report.html'}, {output / 'objects.parquet'}")
