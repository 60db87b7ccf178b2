"""The command line's `nightglass report detection`: public finders on a product."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Json, Output, print_json
from pipeline.commands.pages import is_quiet, stage_progress
from pipeline.commands.product import ProductPath
from pipeline.studies.detection import study as detection
from pipeline.studies.detection import tables as detection_tables
from pipeline.studies.written import with_nulls


def report_detection(
    product: ProductPath,
    output: Output = Path("detection"),
    threshold: Annotated[float, typer.Option(help="least signal-to-noise, in sigma")] = 5.0,
    frames: Annotated[int | None, typer.Option(min=1, help="the first so many")] = None,
    as_json: Json = False,
) -> None:
    """Completeness and false alarms of public finders on a product: JSON, table, figure."""
    with stage_progress(is_quiet(as_json)) as listen:
        study = detection.report_detection(product, output, threshold, frames, listen)
    if as_json:
        print_json(with_nulls(study))
    else:
        detection_tables.print_study(study)
