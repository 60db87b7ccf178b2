"""The command line's `nightglass render --part k/n` and `nightglass join`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.errors import BadInput
from pipeline.options import Json, ProductOrUrl, Wait, as_stated, print_json, told_if_interrupted

if TYPE_CHECKING:
    from pipeline.run import Options


def render_part(
    scene: Path, product: str, overrides: list[str], part: str,
    options: Options, as_json: bool,
) -> None:  # fmt: skip
    """Render one part of a scene; the last one finishes the product."""
    from pipeline.pages import tile_progress
    from pipeline.parts import parse_part
    from pipeline.parts import render_part as run
    from pipeline.spec.load import load_scene

    if options.replace:
        raise BadInput("--replace", part, "no --part with it: parts share one product")
    share = parse_part(part)
    kept = told_if_interrupted(product, lambda: "finished tiles are kept", resumes=False)
    with kept, tile_progress(as_json or not sys.stderr.isatty()) as listen:
        loaded = load_scene(scene, overrides)
        if "://" in product:
            from pipeline.remote import render_to_url

            report = render_to_url(loaded, product, options, listen, share)
        else:
            report = run(loaded, Path(product), share, options, listen)
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
    if "://" in product:
        from pipeline.remote import join_url

        report = join_url(product, scene=scene, wait_s=wait)
    else:
        from pipeline.parts import join as run

        report = run(Path(product), scene, wait)
    if as_json:
        print_json(report)
    else:
        print(f"{product}: complete, {report['tiles']} tile(s)")
    as_stated(report)
