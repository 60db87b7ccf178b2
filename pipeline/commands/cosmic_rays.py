"""The command line's `nightglass cosmic-rays ...`: make and compare libraries of cosmic rays."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Json, Output, print_mapping
from pipeline.commands.pages import is_quiet
from pipeline.errors import BadInput
from pipeline.inputs.sensor.cosmic_ray_darks import extract_library, open_darks
from pipeline.inputs.sensor.cosmic_ray_library import read_library, write_library
from pipeline.store.result_files import check_ending
from pipeline.studies.cosmic_rays import compare_library, draw_comparison

cosmic_rays = typer.Typer(
    help="Make and compare libraries of cosmic rays.", no_args_is_help=True, add_completion=False
)


@cosmic_rays.command()
def extract(
    dark_frames: Annotated[list[Path], typer.Argument(help="FITS or NPY, of one frame or several")],
    output: Output,
    exposure_s: Annotated[float, typer.Option(help="integration time of one frame")],
    pixel_pitch_um: Annotated[float, typer.Option(help="side of a pixel")],
    gain_e_per_dn: Annotated[float, typer.Option(help="electrons a digital number")] = 1.0,
    threshold_sigma: Annotated[float, typer.Option(help="an event has a pixel above it")] = 6.0,
    grow_sigma: Annotated[float, typer.Option(help="its other pixels are above it")] = 2.5,
    as_json: Json = False,
) -> None:
    """Collect the events of a stack of dark frames of equal exposure into a library."""
    for name, value in (
        ("exposure-s", exposure_s),
        ("pixel-pitch-um", pixel_pitch_um),
        ("gain-e-per-dn", gain_e_per_dn),
    ):
        if not 0.0 < value < math.inf:
            raise BadInput(f"--{name}", value, "a number above 0")
    if not 3.0 <= threshold_sigma <= 1e6:
        raise BadInput("--threshold-sigma", threshold_sigma, "3 or more: noise is no event")
    if not 1.0 <= grow_sigma <= threshold_sigma:
        raise BadInput("--grow-sigma", grow_sigma, f"1 to the threshold, {threshold_sigma:g}")
    check_ending(output, [".fits"])
    darks = open_darks(dark_frames)
    show = None if is_quiet(as_json) else _show
    library, found = extract_library(
        darks, exposure_s, pixel_pitch_um, gain_e_per_dn, threshold_sigma, grow_sigma, show
    )
    if not len(library):
        allowed = "less: no pixel of these frames is so far above their median"
        raise BadInput("--threshold-sigma", threshold_sigma, allowed)
    write_library(output, library)
    print_mapping({"library": str(output)} | found, as_json)


@cosmic_rays.command()
def compare(
    library: Annotated[Path, typer.Argument(help="a library of recorded events")],
    output: Output,
    thickness_um: Annotated[
        float, typer.Option(min=0.5, max=2000, help="of the generator's sensitive layer")
    ] = 100.0,
    pixel_pitch_um: Annotated[float | None, typer.Option(help="where the library has none")] = None,
    diffusion_um: Annotated[
        float, typer.Option(min=0, max=100, help="sigma of the generator's charge clouds")
    ] = 4.0,
    threshold_e: Annotated[float, typer.Option(help="least charge of a pixel counted")] = 50.0,
    as_json: Json = False,
) -> None:
    """Draw a library beside the generator (PNG or SVG): size, charge, charge per length, rate."""
    check_ending(output, [".png", ".svg"])
    events = read_library(library, "LIBRARY")
    if not len(events):
        raise BadInput("LIBRARY", str(library), "a library with events; it has none")
    own = events.pixel_pitch_um
    pitch = pixel_pitch_um if own is None else own
    if pitch is None or not 0.05 <= pitch <= 1000:
        if own is not None:
            raise BadInput("LIBRARY", str(library), f"PITCH_UM of 0.05 to 1000, not {own:g}")
        raise BadInput("--pixel-pitch-um", pitch, "0.05 to 1000: the library does not say it")
    most = float(events.electrons.max())
    if not 0.0 < threshold_e <= most:
        raise BadInput("--threshold-e", threshold_e, f"above 0, to the library's most, {most:g}")
    study = compare_library(events, pitch, thickness_um, diffusion_um, threshold_e)
    draw_comparison(study, output)
    print_mapping(study["summary"], as_json)


def _show(done: int, total: int) -> None:
    print(f"\rframe {done} of {total}", end="\n" if done == total else "", file=sys.stderr)
