"""The command line's `nightglass demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import Output, told_if_interrupted
from pipeline.commands.pages import is_quiet, print_product, print_report, tile_progress
from pipeline.demo import run_demo


def demo(
    output: Output = Path("demo"),
    replace: Annotated[bool, typer.Option("--replace", help="remove an old demo first")] = False,
) -> None:
    """Make the demo catalogue, render the demo scene, and say what came out."""
    kept = told_if_interrupted(str(output), lambda: "what is finished is kept", resumes=False)
    with kept, tile_progress(is_quiet()) as listen:
        product, report = run_demo(output, replace, listen, lambda text: print(text, flush=True))
    print_report(report, product)
    print_product(product)
