"""The command line's `catalog fetch`: the archive's files, or a cone's rows."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from catalog_tools.fetch.fetch import fetch as run
from pipeline.commands.catalog.shared import note
from pipeline.commands.options import Json, print_mapping
from pipeline.commands.pages import is_quiet, stage_progress


def fetch(
    release: Annotated[str, typer.Argument(help="gaia-dr2 or gaia-dr3")],
    destination: Annotated[Path, typer.Option("--dest", help="folder; ingest takes it as it is")],
    cone: Annotated[
        list[str] | None, typer.Option(help="RA,DEC,RADIUS, also with ,G; repeatable")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="every file (DR2: 588 GB)")] = False,
    base_url: Annotated[str | None, typer.Option(help="a mirror: http, https, file")] = None,
    tap: Annotated[str | None, typer.Option(help="'archive' or a TAP URL: the rows only")] = None,
    faintest_g_mag: Annotated[float | None, typer.Option("--faintest", help="with --tap")] = None,
    connections: Annotated[int, typer.Option(min=1, max=32, help="at once")] = 4,
    verify: Annotated[bool, typer.Option("--verify", help="hash present files again")] = False,
    as_json: Json = False,
) -> None:
    """Download the archive's files, or a cone's rows; the same command goes on where it stopped."""
    with stage_progress(is_quiet(as_json)) as progress:
        report = run(
            release,
            destination,
            cones=cone or [],
            everything=everything,
            base_url=base_url,
            tap_url=tap,
            faintest_g_mag=faintest_g_mag,
            connections=connections,
            progress=progress,
            verify=verify,
        )
    for text in report.notes:
        note(text)
    print_mapping({**asdict(report), "files": len(report.files)}, as_json)
