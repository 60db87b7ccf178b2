"""The command line's `nightglass render --part k/n` and `nightglass join`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.options import (
    Json,
    ProductOrUrl,
    Wait,
    as_stated,
    print_json,
    told_if_interrupted,
)
from pipeline.errors import BadInput

if TYPE_CHECKING:
    from pipeline.route.run import Options


def render_part(
    scene: Path,
    product: str,
    overrides: list[str],
    part: str,
    options: Options,
    as_json: bool,
) -> None:
    """Render one part of a scene; the last one finishes the product."""
    from pipeline.commands.pages import tile_progress
    from pipeline.route.run import render as run
    from pipeline.route.shares import parse_part
    from pipeline.spec.load import load_scene

    if options.replace:
        raise BadInput("--replace", part, "no --part with it: parts share one product")
    share = parse_part(part)
    kept = told_if_interrupted(product, lambda: "finished tiles are kept", resumes=False)
    with kept, tile_progress(as_json or not sys.stderr.isatty()) as listen:
        report = run(load_scene(scene, overrides), product, options, listen, share)
    if as_json:
        print_json(report)
    elif report["complete"]:
        print(f"{product}: part {part} done, and with it the product")
    else:
        print(f"{product}: part {part} done, {report['tiles']} tile(s); other parts are not yet")
    as_stated(report)


def join(
    product: ProductOrUrl,
    scene: Annotated[Path | None, typer.Argument(help="default: the product's own")] = None,
    wait: Wait = 0.0,
    as_json: Json = False,
) -> None:
    """Finish a product whose parts are all done. Exit 3 where tiles are missing."""
    from pipeline.route.run import join as run

    report = run(product, scene, wait)
    if as_json:
        print_json(report)
    else:
        print(f"{product}: complete, {report['tiles']} tile(s)")
    as_stated(report)
