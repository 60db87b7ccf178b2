"""The command line's `nightglass observe` and `find`: what is seen, how bright, why not, when."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import pyarrow.compute as pc
import typer

from catalog_tools.documents import JsonObject
from pipeline.commands.options import Json, Overrides, SceneFile, Workers, print_json
from pipeline.commands.pages import is_quiet, stage_progress
from pipeline.lines import fold, table
from pipeline.observe.files import ENDINGS, as_data, write
from pipeline.observe.observe import Observed
from pipeline.observe.observe import observe as look
from pipeline.spec.load import load_scene
from pipeline.spec.study import FieldOfRegard
from pipeline.store.result_files import check_ending
from pipeline.survey.find import FindOptions, FoundObjects
from pipeline.survey.find import find as look_for

MOST_LINES, MOST_NOTES = 20, 6
HEADS = ("target", "seen", "UTC", "az/RA", "el/dec", "km", "V", "SNR")


def observe(
    scene: SceneFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="all rows: a .parquet, .csv, .json or .tdm file"),
    ] = None,
    times: Annotated[
        str | None,
        typer.Option(
            help="middles of exposures: START,STOP,STEP or a file of times (UTC, or seconds after "
            "the epoch); default: the scene's exposures"
        ),
    ] = None,
    snr: Annotated[
        float, typer.Option(help="signal-to-noise ratio below which a target is too faint")
    ] = 5.0,
    centroid_noise: Annotated[
        int | None,
        typer.Option(
            "--centroid-noise", min=0, help="also measured places, with noise of this seed"
        ),
    ] = None,
    set_: Overrides = None,
    as_json: Json = False,
) -> None:
    """Where every target is, how bright, at what SNR, and whether it is seen, without drawing."""
    if output is not None:
        check_ending(output, ENDINGS)
    loaded = load_scene(scene, set_ or [])
    with stage_progress(is_quiet(as_json), "rows") as listen:
        observed = look(loaded, times, snr, listen, centroid_noise)
    if output is not None:
        write(observed, output)
    if as_json:
        print_json(as_data(observed))
        return
    _print(observed)
    if output is not None:
        print(f"{output}: {'what is seen' if output.suffix.lower() == '.tdm' else 'all rows'}")


def _print(observed: Observed) -> None:
    """How many rows are seen and why others are not; rows, or the best one of each target."""
    counts, total = observed.counts(), observed.table.num_rows
    said = ", ".join(f"{n} {'seen' if why == 'yes' else why}" for why, n in counts.items())
    print(fold(f"{total} rows (times x targets): {said or 'no target to observe'}", "  ", ""))
    lines = observed.table.to_pylist() if total <= MOST_LINES else _best(observed)
    if total > MOST_LINES:
        print(fold("of each target its best time, the best seen first; -o FILE has all rows"))
    days = len({row["utc"][:10] for row in lines}) > 1
    parts = any(row["utc"][19:].strip(".0Z") for row in lines)
    shown = slice(5 if days else 11, 21 if parts and not days else 19)
    print(table(HEADS, [_cells(row, shown) for row in lines[:MOST_LINES]], 3))
    if len(lines) > MOST_LINES:
        print(f"and {len(lines) - MOST_LINES} more targets")
    for note in observed.notes[-MOST_NOTES:]:
        print(fold(note, " " * 8, "  note: "))
    if len(observed.notes) > MOST_NOTES:
        print(f"  and {len(observed.notes) - MOST_NOTES} more notes (--json)")


def _best(observed: Observed) -> list[JsonObject]:
    """The row of each target in which it is seen best, by SNR; of one never seen, its highest."""
    seen = observed.table.append_column("no", pc.not_equal(observed.table["seen"], "yes"))
    order = [("no", "ascending"), ("snr", "descending"), ("elevation_deg", "descending")]
    seen = seen.sort_by(order)
    names = seen["name"].to_pylist()
    first = dict(zip(reversed(names), reversed(range(len(names))), strict=True))
    return list(seen.take(sorted(first.values())).to_pylist())


def _cells(row: JsonObject, shown: slice) -> list[str]:
    """A row of the table: azimuth and elevation at a site, RA and Dec in space.

    shown : which part of the time: days or tenths of seconds where rows differ by them
    """
    up, mag, snr = row["elevation_deg"], row["v_mag"], row["snr"]
    here = (row["azimuth_deg"], up) if up == up else (row["ra_deg"], row["dec_deg"])
    return [
        row["object_name"][: 12 if shown.start == 5 else 14],
        row["seen"],
        row["utc"][shown].replace("T", " "),
        *(f"{v:.1f}" for v in here),
        f"{row['range_m'] / 1e3:.0f}",
        f"{mag:.1f}" if mag == mag else "-",
        f"{snr:.3g}" if snr < 100.0 else f"{snr:.0f}",
    ]


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
    found = look_for(load_scene(scene, set_ or []), request, workers)
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
