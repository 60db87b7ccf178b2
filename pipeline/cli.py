"""The command line: `nightglass render`, `plan`, `catalog` and the rest; imports lazily."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from catalog_tools.documents import JsonObject
from catalog_tools.engine.heap import one_heap
from pipeline.commands.capacity import find, study
from pipeline.commands.catalog import catalog
from pipeline.commands.cosmic_rays import cosmic_rays
from pipeline.commands.export import export, import_app
from pipeline.commands.jobs import Server, jobs
from pipeline.commands.observe import observe
from pipeline.commands.options import (
    Accepts,
    AcceptsError,
    Json,
    Output,
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
from pipeline.commands.parts import join
from pipeline.commands.report import report_ledger, report_scenes
from pipeline.commands.sweep import sweep
from pipeline.commands.worker import worker

app = typer.Typer(
    name="nightglass",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
report_app = typer.Typer(help="Studies of error against run time.", no_args_is_help=True)

ProductPath = Annotated[Path, typer.Argument(help="product directory", metavar="PRODUCT")]


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"nightglass {version('nightglass')}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option("--version", help="print the version", is_eager=True, callback=_print_version),
    ] = False,
) -> None:
    """Electro-optical scene simulator for Space Domain Awareness."""


def main() -> None:
    """Run the command line; every error is one message and an exit code."""
    one_heap()
    try:
        code = app(prog_name="nightglass", standalone_mode=False) or 0
        if code == 130:  # the library takes Ctrl-C for an exit
            raise KeyboardInterrupt
        sys.exit(code)
    except SystemExit:
        raise
    except BaseException as error:
        sys.exit(_explain(error))


def _explain(error: BaseException) -> int:
    """Print what went wrong on one line (or a few) and return the exit code."""
    from pipeline.errors import NO_ROOM, NightglassError, exit_code

    if isinstance(error, typer.Exit):
        return error.exit_code
    if hasattr(error, "format_message"):  # a usage error of the command line itself
        if said := error.format_message():  # none where a group of commands shows its help
            _say(f"{said} (see --help)")
        return 2
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        _say("interrupted; a catalogue or a download is gone on with by the same command")
        return 130
    if isinstance(error, OSError) and error.errno is not None:
        full = f"the disk is full ({os.strerror(error.errno)})"
        said, code = (full, 3) if error.errno in NO_ROOM else (error.strerror, 1)
        _say(f"{error.filename or 'a file'}: {said}")
        return code
    if isinstance(error, NightglassError):
        _say(str(error))
        return exit_code(error)
    if os.environ.get("NIGHTGLASS_DEBUG"):
        raise error
    name = type(error).__name__
    _say(f"internal fault: {name}: {error}\n(this is a bug; NIGHTGLASS_DEBUG=1 shows where)")
    return 1


def _say(message: str) -> None:
    """Print a message of one line, or a few; at a terminal no word of it is broken by its edge."""
    text = f"nightglass: {message}"
    if sys.stderr.isatty():
        from pipeline.lines import fold

        text = "\n".join(fold(line, "  ", "") for line in text.splitlines())
    print(text, file=sys.stderr)


@app.command()
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
        from pipeline.commands.jobs import render_there

        elsewhere = scheduler != "threads" or part is not None
        _only_here(resume, replace, workers is not None, elsewhere)
        to = local_path(output)
        _print_result(render_there(scene, to, overrides, server, as_json), output, as_json)
        return
    from pipeline.route.run import Options

    if part is not None:
        from pipeline.commands.parts import render_part

        options = Options(scheduler, workers, replace=replace, wait_s=wait)
        render_part(scene, output, overrides, part, options, as_json)
        return
    from pipeline.route.run import render as run
    from pipeline.spec.load import load_scene

    loaded = load_scene(scene, overrides)
    options = Options(scheduler, workers, resume, replace, wait)
    with told_if_interrupted(output, lambda: _kept(output)), _progress(quiet=as_json) as listen:
        report = run(loaded, output, options, listen)
    _print_result(report, output, as_json)


def _kept(output: str) -> str:
    """What of a product stays where its render is stopped."""
    from pipeline.store.info import tiles_done

    if "://" in output:
        return "finished tiles are kept"
    done, total = tiles_done(Path(output)) if Path(output).exists() else (0, 0)
    return f"{done} of {total} tiles are kept" if total else "nothing was begun"


@app.command()
def plan(
    scene: SceneFile,
    set_: Overrides = None,
    server: Server = None,
    everything: Annotated[
        bool, typer.Option("--all", help="also each decision with its bound, and the notes")
    ] = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="with the rule of each, and the test of its bound")
    ] = False,
    accept: Accepts = None,
    accept_error: AcceptsError = False,
    as_json: Json = False,
) -> None:
    """Show what a scene gives and needs: targets in view, limit, stars, time, memory."""
    overrides = overrides_of(set_, accept, accept_error)
    if server is not None:
        from pipeline.commands.jobs import plan_there

        summary = plan_there(scene, overrides, server)
    else:
        from pipeline.route.prepare import plan_scene
        from pipeline.spec.load import load_scene

        summary = plan_scene(load_scene(scene, overrides))
    if as_json:
        print_json(summary)
    else:
        from pipeline.commands.pages import print_plan

        print_plan(summary, everything, explain)


@app.command()
def check(product: ProductOrUrl, as_json: Json = False) -> None:
    """Verify a product whole: markers, chunk checksums, tables. Exit 3 if it is not complete."""
    from pipeline.route.run import check as verify

    verdict = verify(product)
    if as_json:
        print_json(verdict.__dict__ | {"whole": verdict.whole})
    else:
        state = "whole" if verdict.whole else "complete" if verdict.complete else "NOT complete"
        print(f"{product}: {state}, {verdict.tiles} of {verdict.tiles_expected} tiles verified")
        for fault in verdict.faults:
            print(f"  damaged: {fault}")
    raise typer.Exit(0 if verdict.whole else 3)


@app.command()
def info(product: ProductPath, as_json: Json = False) -> None:
    """Show what a product is: state, frames, layers, truth, origin. Reads no pixel."""
    from pipeline.commands.pages import print_info
    from pipeline.store.info import describe

    found = describe(product)
    if as_json:
        print_json(found)
    else:
        print_info(product, found)


@app.command()
def calibrate(product: ProductPath, output: Output, as_json: Json = False) -> None:
    """Copy a product with its frames calibrated: less bias and dark, over the flat (electrons)."""
    from pipeline.calibrate import calibrate as run

    report = run(product, output)
    if as_json:
        print_json(report)
    else:
        print(f"{output}: {report['frames']} frame(s), {report['masked_pixels']} pixels masked")


@app.command()
def schema() -> None:
    """Print the JSON Schema of a scene."""
    from pipeline.spec.scene import Scene

    print_json(Scene.model_json_schema(by_alias=True))


@app.command(name="color-fit")
def color_fit(
    scene: SceneFile,
    set_: Overrides = None,
    as_json: Json = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="also a file, for stars.colour_fit")
    ] = None,
) -> None:
    """Show the colour correction from Gaia G to the sensor's band, with its residuals."""
    from pipeline.inputs.band.colour_fit import describe, gather_colour_points
    from pipeline.inputs.band.colour_fit_files import colour_fit_of, write_colour_fit
    from pipeline.inputs.band.response import gather_response
    from pipeline.spec.load import load_scene

    loaded = load_scene(scene, set_ or [])
    response, band, digest = gather_response(loaded)
    fit = colour_fit_of(loaded, response, band, digest)
    if output is not None:
        write_colour_fit(output, fit, digest)
    from pipeline.lines import pair

    described = describe(fit, gather_colour_points(response) if as_json else None)
    if as_json:
        print_json(described)
    else:
        for key, value in described.items():
            print(pair(key, str(value), 24))


@app.command(name="light-curve")
def light_curve(
    scene: SceneFile,
    output: Output,
    target: Annotated[
        list[str] | None,
        typer.Option("--target", help="name of a target (may be repeated); default: all"),
    ] = None,
    set_: Overrides = None,
    start: Annotated[float, typer.Option(help="seconds after the epoch")] = 0.0,
    stop: Annotated[float | None, typer.Option(help="default: end of the last exposure")] = None,
    points: Annotated[int, typer.Option(min=2, max=1_000_000, help="times, evenly spaced")] = 1000,
    plot: Annotated[Path | None, typer.Option(help="also a plot, PNG")] = None,
) -> None:
    """Magnitude, phase angle, range and eclipse of targets against time, as Parquet."""
    from pipeline.inputs.band.response import gather_response
    from pipeline.light_curve import light_curves, write_light_curves
    from pipeline.resolve.files import read_files
    from pipeline.spec.load import load_scene

    loaded = read_files(load_scene(scene, set_ or []))
    response = gather_response(loaded)[0]
    count = write_light_curves(
        light_curves(loaded, target or [], response, start, stop, points), output, plot
    )
    of = f" of {count} targets" if count > 1 else ""
    print(f"{output}{of}" if plot is None else f"{output} and {plot}")


@report_app.command("accuracy")
def report_accuracy(
    output: Output = Path("accuracy"),
    stars: Annotated[int, typer.Option(min=1, max=10_000_000, help="stars to time")] = 20_000,
    quick: Annotated[bool, typer.Option("--quick", help="less work, fewer settings")] = False,
    peers: Annotated[bool, typer.Option(help="other simulators, where installed")] = True,
    satsim_python: Annotated[str | None, typer.Option(help="a Python that has SatSim")] = None,
    as_json: Json = False,
) -> None:
    """Error against CPU time of every engine and installed peer: JSON, table, figure."""
    from pipeline.commands.pages import stage_progress
    from pipeline.studies.accuracy.report import report_accuracy as study_all
    from pipeline.studies.accuracy.tables import print_study

    with stage_progress(as_json or not sys.stderr.isatty()) as listen:
        study = study_all(
            output, stars, quick=quick, peers=peers, satsim_python=satsim_python, progress=listen
        )
    if as_json:
        print_json(study)
    else:
        print_study(study)


@report_app.command("detection")
def report_detection(
    product: ProductPath,
    output: Output = Path("detection"),
    threshold: Annotated[float, typer.Option(help="least signal-to-noise, in sigma")] = 5.0,
    frames: Annotated[int | None, typer.Option(min=1, help="the first so many")] = None,
    as_json: Json = False,
) -> None:
    """Completeness and false alarms of public finders on a product: JSON, table, figure."""
    from pipeline.commands.pages import stage_progress
    from pipeline.studies.detection.study import report_detection as study_all
    from pipeline.studies.detection.tables import print_study

    with stage_progress(as_json or not sys.stderr.isatty()) as listen:
        study = study_all(product, output, threshold, frames, listen)
    if as_json:
        print_json(study)
    else:
        print_study(study)


@app.command()
def serve(
    host: Annotated[str, typer.Option(help="address to listen on")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: any free one")] = 8765,
    home: Annotated[
        Path | None,
        typer.Option(help="folder of jobs, products, catalogues; default: NIGHTGLASS_HOME"),
    ] = None,
) -> None:
    """Serve the REST interface."""
    from importlib import import_module

    import_module("service.main").serve(host, port, home)


@app.command(
    add_help_option=False,
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
)
def keys(context: typer.Context) -> None:
    """API keys of the service: create, revoke, list."""
    from importlib import import_module

    app = import_module("service.accounts.commands").app
    app(context.args, prog_name="nightglass keys", standalone_mode=False)


@app.command()
def demo(
    output: Output = Path("demo"),
    replace: Annotated[bool, typer.Option("--replace", help="remove an old demo first")] = False,
) -> None:
    """Make the demo catalogue, render the demo scene, and say what came out."""
    from pipeline.commands.pages import print_product
    from pipeline.demo import run_demo

    kept = told_if_interrupted(str(output), lambda: "what is finished is kept", resumes=False)
    with kept, _progress(quiet=False) as listen:
        product, report = run_demo(output, replace, listen, lambda text: print(text, flush=True))
    _print_report(report, product)
    print_product(product)


@app.command()
def selftest(
    only: Annotated[str | None, typer.Option(help="part of a case's name")] = None,
    page: Annotated[Path | None, typer.Option("--markdown", help="also write a page")] = None,
    as_json: Json = False,
) -> None:
    """Limiting cases against answers known from elsewhere. Exit 1 where one fails."""
    from pipeline.commands.pages import stage_progress
    from pipeline.studies.selftest.report import as_data, chosen, markdown, print_table, run_cases

    cases = chosen(only)
    with stage_progress(as_json or not sys.stderr.isatty()) as listen:
        outcomes = run_cases(cases, listen)
    if page is not None:
        page.write_text(markdown(outcomes), encoding="utf-8")
    if as_json:
        print_json(as_data(outcomes))
    else:
        print_table(outcomes)
    if not all(o.passed for o in outcomes):
        raise typer.Exit(1)


app.command()(observe)
app.command()(find)
app.command()(study)
app.command()(sweep)
app.command()(export)
app.command()(join)
app.command()(worker)
app.add_typer(catalog, name="catalog")
app.add_typer(jobs, name="jobs")
app.add_typer(import_app, name="import")
app.add_typer(cosmic_rays, name="cosmic-rays")
app.add_typer(report_app, name="report")
report_app.command("scenes")(report_scenes)
report_app.command("ledger")(report_ledger)


def _progress(quiet: bool) -> Any:
    """A bar of tiles on stderr; nothing when it is no terminal or not wanted."""
    from pipeline.commands.pages import tile_progress

    return tile_progress(quiet or not sys.stderr.isatty())


def _only_here(*given: bool) -> None:
    from pipeline.errors import BadInput

    if any(given):
        allowed = "without --resume, --replace, --workers, --scheduler: the server decides these"
        raise BadInput("--server", "with them", allowed)


def _print_result(report: JsonObject, output: Path | str, as_json: bool) -> None:
    """What came out; exit code 5 where a product errs by more than was stated."""
    if as_json:
        print_json(report)
    else:
        _print_report(report, output)
    as_stated(report)


def _print_report(report: JsonObject, product: Path | str) -> None:
    from pipeline.commands.pages import print_warnings
    from pipeline.lines import fold

    seconds = report["seconds"]
    errors = report["errors"]
    print_warnings(report["warnings"])
    taken_s = seconds["plan_s"] + seconds["draw_s"] + seconds["finish_s"]
    when = "whole before, nothing was drawn" if "drawn_before" in report else f"in {taken_s:.2f} s"
    print(f"{product}: {report['frames']} frame(s), {report['tiles']} tile(s) {when}")
    print(
        f"  error bound at the noise floor {errors['bound_of_all_approximations_sigma']:.3f} sigma "
        f"(asked {errors['asked_sigma']}), WCS to {errors['wcs_residual_px']:.1e} px"
    )
    if errors["achieved_error_sigma"] is not None:
        print(
            f"  error found by drawing {errors['windows']} windows again: "
            f"{errors['achieved_error_sigma']:.4f} sigma, {errors['achieved_error_e']:.2g} e-"
        )
    if errors["common_streak_px"] > 0:
        share = errors["common_streak_px"]
        print(f"  stars share streaks that differ by up to {share:.1e} px at their ends")
    for remark in report["remarks"]:
        print(fold(remark, " " * 8, "  note: "))
