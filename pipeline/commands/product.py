"""The command line's `nightglass check`, `info` and `calibrate`: of a product."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.calibrate import calibrate as run
from pipeline.commands.options import Json, Output, ProductOrUrl, print_json
from pipeline.commands.pages import print_info
from pipeline.route.run import check as verify
from pipeline.store.info import describe

Images = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="where flat, dark and other images are, by any names, that are gone from the places "
        "in the scene: of a product that was fetched from a server, or moved",
    ),
]
ProductPath = Annotated[Path, typer.Argument(help="product directory", metavar="PRODUCT")]


def check(product: ProductOrUrl, as_json: Json = False) -> None:
    """Verify a product: markers, chunk checksums, tables. Exit 3 if it is not whole."""
    verdict = verify(product)
    if as_json:
        print_json(verdict.__dict__ | {"whole": verdict.whole})
    else:
        state = "whole" if verdict.whole else "complete" if verdict.complete else "NOT complete"
        print(f"{product}: {state}, {verdict.tiles} of {verdict.tiles_expected} tiles verified")
        for fault in verdict.faults:
            print(f"  damaged: {fault}")
    raise typer.Exit(0 if verdict.whole else 3)


def info(product: ProductPath, as_json: Json = False) -> None:
    """Show what a product is: state, frames, layers, truth, origin. Reads no pixel."""
    found = describe(product)
    if as_json:
        print_json(found)
    else:
        print_info(product, found)


def calibrate(
    product: ProductPath, output: Output, images: Images = None, as_json: Json = False
) -> None:
    """Copy a product with its frames calibrated: less bias and dark, over the flat (electrons)."""
    report = run(product, output, images)
    if as_json:
        print_json(report)
    else:
        print(f"{output}: {report['frames']} frame(s), {report['masked_pixels']} pixels masked")
