"""The command line's `nightglass sweep`: run a sweep file, go on with one, show a point's scene."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from catalog_tools.documents import JsonObject
from pipeline.commands.jobs import Server, run_there
from pipeline.commands.options import (
    Json,
    Output,
    Overrides,
    SchedulerName,
    Slurm,
    Workers,
    as_stated,
    print_json,
    told_if_interrupted,
)
from pipeline.commands.pages import is_quiet, print_warnings, progress_listener
from pipeline.errors import BadInput
from pipeline.lines import fold, pair
from pipeline.spec.load import scene_yaml
from pipeline.spec.sweep_load import parse_sweep, read_sweep
from pipeline.sweep.forecast import forecast_course
from pipeline.sweep.run import Options, gather_course, point_scene
from pipeline.sweep.run import sweep as run

SweepFile = Annotated[Path, typer.Argument(help="sweep file, YAML or JSON", metavar="SWEEP")]


def sweep(
    file: SweepFile,
    output: Output = Path("sweep"),
    set_: Overrides = None,
    scheduler: SchedulerName = "threads",
    workers: Workers = None,
    slurm: Slurm = False,
    resume: Annotated[bool, typer.Option("--resume", help="go on with an unfinished one")] = False,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="with --resume: failed points once more")
    ] = False,
    point: Annotated[
        int | None, typer.Option("--point", help="only print the scene of this point")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="only say what the whole sweep would take")
    ] = False,
    server: Server = None,
    as_json: Json = False,
) -> None:
    """Run a sweep: many scenes that differ in some fields, measured into one table of points.

    With --server it runs there, and its results are fetched.
    """
    overrides = set_ or []
    if server is not None:
        placed = scheduler != "threads", workers is not None, slurm
        here = any((*placed, resume, retry_failed, dry_run))
        _there(file, output, overrides, server, as_json, here or point is not None)
        return
    if dry_run:
        _print_forecast(forecast_course(gather_course(file, Path(), overrides)), as_json)
        return
    if point is not None:
        print(scene_yaml(point_scene(file, point, overrides)), end="")
        return
    options = Options("slurm" if slurm else scheduler, workers, resume or retry_failed)
    kept = told_if_interrupted(str(output), lambda: "finished points are kept")
    with kept, progress_listener("points", is_quiet(as_json)) as listen:
        warn = None if as_json else print_warnings
        report = run(file, output, options, retry_failed, listen, warn, overrides)
    _tell(report, output, as_json)


def _print_forecast(told: JsonObject, as_json: bool) -> None:
    if as_json:
        print_json(told)
        return
    print_warnings(told["warnings"])
    rows, columns = told["shape"]
    counts, each = told["different"], told["seconds_each"]
    drawn = ", ".join(f"{counts[kind]} of {kind}" for kind in ("stars", "targets", "sky"))
    for name, text in (
        ("points", f"{told['points']}, each {told['frames']} frame(s) of {rows} x {columns} px"),
        ("shared", f"{counts['plans']} plans; different light: {drawn}"),
        (
            "time",
            f"{told['cpu_s']:.3g} s of one core; {told['alone_cpu_s']:.3g} s if nothing were "
            f"shared",
        ),
        (
            "each",
            f"plan {each['plan']:.2g} s, light {each['light']:.2g} s, point {each['point']:.2g} s",
        ),
        ("memory", f"{told['worker_memory_mb']:.0f} MB a worker, and what it keeps of the light"),
        ("metrics", ", ".join(told["metrics"])),
    ):
        print(pair(name, text, 8))


def _there(
    file: Path, output: Path, overrides: list[str], server: str, as_json: bool, decided: bool
) -> None:
    if decided:
        allowed = (
            "without --resume, --retry-failed, --workers, --scheduler, --slurm, --point, --dry-run"
        )
        raise BadInput("--server", "with them", allowed)
    asked: Path | JsonObject = file
    if overrides:
        asked = read_sweep(file, overrides, placed=False)
        parse_sweep(asked, overrides)
    report = run_there("sweep", asked, output, server, as_json)
    if not as_json:
        print_warnings(report.get("warnings", []))  # a server may be older
    _tell(report, output, as_json)


def _tell(report: JsonObject, output: Path, as_json: bool) -> None:
    """What came out; exit code 5 where points err by more than was stated."""
    if as_json:
        print_json(report)
    else:
        _print(report, output)
    as_stated(report)


def _print(report: JsonObject, output: Path) -> None:
    print(
        f"{output}: {report['points']} points in {report['seconds']:.2f} s, "
        f"{report['failed']} failed"
    )
    for text, count in report.get("doubts", {}).items():
        print(fold(f"{count} x {text}", " " * 6, "  warning: "))
    for name, spread in report["metrics"].items():
        if spread["known"]:
            print(f"  {name:>28}  {spread['least']:.5g} .. {spread['largest']:.5g}")
    for text, count in report["messages"].items():
        print(fold(text, " " * 6, f"  failed, {count} x: "))
    print(f"  {output / 'points.parquet'}, {output / 'summary.html'}")
