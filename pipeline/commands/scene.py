"""The command line's `schema`, `color-fit` and `light-curve`: of a scene, without frames."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Json, Output, Overrides, SceneFile, print_json
from pipeline.inputs.band.colour_fit import describe, gather_colour_points
from pipeline.inputs.band.colour_fit_files import colour_fit_of, write_colour_fit
from pipeline.inputs.band.response import gather_response
from pipeline.light_curve import ENDINGS, light_curves, write_light_curves
from pipeline.lines import pair
from pipeline.resolve.files import read_files
from pipeline.spec.json_schemas import json_schema
from pipeline.spec.load import load_scene
from pipeline.store.result_files import check_ending


def schema(
    of: Annotated[str, typer.Argument(metavar="FORMAT", help="scene, sweep or study")] = "scene",
) -> None:
    """Print the JSON Schema of a scene, a sweep or a study."""
    print_json(json_schema(of))


def color_fit(
    scene: SceneFile,
    set_: Overrides = None,
    as_json: Json = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="also a file, for stars.colour_fit")
    ] = None,
) -> None:
    """Show the colour correction from Gaia G to the sensor's band, with its residuals."""
    loaded = load_scene(scene, set_ or [])
    response, band, digest = gather_response(loaded)
    fit = colour_fit_of(loaded, response, band, digest)
    if output is not None:
        write_colour_fit(output, fit, digest)
    described = describe(fit, gather_colour_points(response) if as_json else None)
    if as_json:
        print_json(described)
    else:
        for key, value in described.items():
            print(pair(key, str(value), 24))


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
    """Magnitude, phase angle, range and eclipse of targets against time, as Parquet or CSV."""
    check_ending(output, ENDINGS)
    loaded = read_files(load_scene(scene, set_ or []), (start, start if stop is None else stop))
    response = gather_response(loaded)[0]
    count = write_light_curves(
        light_curves(loaded, target or [], response, start, stop, points), output, plot
    )
    of = f" of {count} targets" if count > 1 else ""
    print(f"{output}{of}" if plot is None else f"{output} and {plot}")
