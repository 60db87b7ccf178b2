"""The command line's `nightglass render`, whole or a part, here or there, and `join`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from catalog_tools.documents import JsonObject
from pipeline.commands.jobs import Server, render_there
from pipeline.commands.options import (
    Accepts,
    AcceptsError,
    Json,
    OutputOrUrl,
    Overrides,
    ProductOrUrl,
    SceneFile,
    SchedulerName,
    Slurm,
    Wait,
    Workers,
    as_stated,
    local_path,
    overrides_of,
    print_json,
    told_if_interrupted,
)
from pipeline.commands.pages import is_quiet, print_report, tile_progress
from pipeline.errors import BadInput
from pipeline.route.run import Options
from pipeline.route.run import join as run_join
from pipeline.route.run import render as run
from pipeline.route.shares import parse_part
from pipeline.spec.load import load_scene
from pipeline.store.info import tiles_done


def render(
    scene: SceneFile,
    output: OutputOrUrl,
    set_: Overrides = None,
    scheduler: SchedulerName = "threads",
    workers: Workers = None,
    slurm: Slurm = False,
    resume: Annotated[bool, typer.Option("--resume", help="go on with an unfinished one")] = False,
    replace: Annotated[bool, typer.Option("--replace", help="remove an old product first")] = False,
    part: Annotated[
        str | None, typer.Option("--part", help="only part k/n of the tiles, beside other parts")
    ] = None,
    wait: Wait = 0.0,
    server: Server = None,
    accept: Accepts = None,
    accept_error: AcceptsError = False,
    as_json: Json = False,
) -> None:
    """Render a scene into a product directory, here or on a server."""
    overrides = overrides_of(set_, accept, accept_error)
    scheduler = "slurm" if slurm else scheduler
    if server is not None:
        elsewhere = scheduler != "threads" or part is not None
        _only_here(resume, replace, workers is not None, elsewhere)
        to = local_path(output)
        _print_result(render_there(scene, to, overrides, server, as_json), output, as_json)
        return
    if part is not None:
        options = Options(scheduler, workers, replace=replace, wait_s=wait)
        render_part(scene, output, overrides, part, options, as_json)
        return
    loaded = load_scene(scene, overrides)
    options = Options(scheduler, workers, resume, replace, wait)
    kept = told_if_interrupted(output, lambda: _kept(output))
    with kept, tile_progress(is_quiet(as_json)) as listen:
        report = run(loaded, output, options, listen)
    _print_result(report, output, as_json)


def render_part(
    scene: Path,
    product: str,
    overrides: list[str],
    part: str,
    options: Options,
    as_json: bool,
) -> None:
    """Render one part of a scene; the last one finishes the product."""
    if options.replace:
        raise BadInput("--replace", part, "no --part with it: parts share one product")
    share = parse_part(part)
    kept = told_if_interrupted(product, lambda: "finished tiles are kept", resumes=False)
    with kept, tile_progress(is_quiet(as_json)) as listen:
        report = run(load_scene(scene, overrides), product, options, listen, share)
    if as_json:
        print_json(report)
    elif report["complete"]:
        print(f"{product}: part {part} done, and with it the product")
    else:
        print(f"{product}: part {part} done, {report['tiles']} tile(s); other parts are not yet")
    as_stated(report)


def _kept(output: str) -> str:
    """What of a product stays where its render is stopped."""
    if "://" in output:
        return "finished tiles are kept"
    done, total = tiles_done(Path(output)) if Path(output).exists() else (0, 0)
    return f"{done} of {total} tiles are kept" if total else "nothing was begun"


def join(
    product: ProductOrUrl,
    scene: Annotated[Path | None, typer.Argument(help="default: the product's own")] = None,
    wait: Wait = 0.0,
    as_json: Json = False,
) -> None:
    """Finish a product whose parts are all done. Exit 3 where tiles are missing."""
    report = run_join(product, scene, wait)
    if as_json:
        print_json(report)
    else:
        print(f"{product}: complete, {report['tiles']} tile(s)")
    as_stated(report)


def _only_here(*given: bool) -> None:
    """BadInput where options are given that a server decides."""
    if any(given):
        allowed = "without --resume, --replace, --workers, --scheduler: the server decides these"
        raise BadInput("--server", "with them", allowed)


def _print_result(report: JsonObject, output: Path | str, as_json: bool) -> None:
    """What came out; exit code 5 where a product errs by more than was stated."""
    if as_json:
        print_json(report)
    else:
        print_report(report, output)
    as_stated(report)
