"""The command line's `catalog ingest` and `starlight`: catalogues made and completed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from dask.utils import parse_bytes

from catalog_tools.catalogue import open_catalogue
from catalog_tools.engine.schedulers import open_scheduler
from catalog_tools.errors import BadInput
from catalog_tools.info import info
from catalog_tools.ingest.ingest import ingest as run
from catalog_tools.query.starlight import STARLIGHT_NAME, make_starlight
from pipeline.commands.catalog.shared import CataloguePlace, Overwrite, note
from pipeline.commands.options import Json, Output, SchedulerName, Workers, print_mapping
from pipeline.commands.pages import is_quiet, stage_progress


def ingest(
    sources: Annotated[list[Path], typer.Argument(help="files of stars, or folders of them")],
    output: Output,
    form: Annotated[
        str | None, typer.Option(help="what the columns mean: a form's name, or a column map .toml")
    ] = None,
    name: Annotated[str | None, typer.Option(help="name of the catalogue")] = None,
    rows_per_leaf: Annotated[int, typer.Option(min=1, help="largest shard")] = 1_000_000,
    memory: Annotated[str, typer.Option(help="the most one worker may take")] = "2GiB",
    scheduler: SchedulerName = "threads",
    workers: Workers = None,
    restart: Annotated[bool, typer.Option("--restart", help="discard unfinished work")] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Repartition files of stars into HEALPix Parquet shards (HATS); goes on where it stopped."""
    memory_bytes = _bytes(memory)
    with stage_progress(is_quiet(as_json)) as progress, open_scheduler(scheduler, workers) as where:
        report = run(
            list(sources),
            output,
            form=form,
            name=name,
            rows_per_leaf=rows_per_leaf,
            memory_bytes=memory_bytes,
            scheduler=where,
            progress=progress,
            overwrite=overwrite,
            restart=restart,
        )
    for text in report.notes:
        note(text)
    print_mapping({"continued_batches": report.continued, **info(report.catalogue)}, as_json)


def starlight(
    catalogue: CataloguePlace,
    order: Annotated[
        int | None, typer.Option(min=0, max=9, help="HEALPix order of the map (default 6 or 7)")
    ] = None,
    scheduler: SchedulerName = "threads",
    workers: Workers = None,
    as_json: Json = False,
) -> None:
    """Sum the light of all stars once, so that scenes can leave faint ones to a smooth sky."""
    opened = open_catalogue(catalogue)
    with stage_progress(is_quiet(as_json)) as progress, open_scheduler(scheduler, workers) as where:
        made = make_starlight(opened, order=order, scheduler=where, progress=progress)
    print_mapping(
        {"map": f"{opened.path}/{STARLIGHT_NAME}", "order": made.order, "stars": opened.rows},
        as_json,
    )


def _bytes(text: str) -> int:
    """A size such as 2GiB or 500MB."""
    try:
        if not text[:1].isdigit():
            raise ValueError(text)
        return int(parse_bytes(text))
    except (ValueError, OverflowError):
        raise BadInput("--memory", text, "a size such as 2GiB or 500MB") from None
