"""The command line's `nightglass find`: which objects can be seen, when, where to point."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from pipeline.commands.options import Json, Overrides, SceneFile, Workers, print_json
from pipeline.lines import fold
from pipeline.spec.load import load_scene
from pipeline.spec.study import FieldOfRegard
from pipeline.survey.find import FindOptions, FoundObjects
from pipeline.survey.find import find as look


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
