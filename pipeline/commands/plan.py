"""The command line's `nightglass plan`: what a scene gives and needs."""

from __future__ import annotations

from typing import Annotated

import typer

from pipeline.commands.jobs import Server, plan_there
from pipeline.commands.options import (
    Accepts,
    AcceptsError,
    Json,
    Overrides,
    SceneFile,
    overrides_of,
    print_json,
)
from pipeline.commands.pages import print_plan
from pipeline.route.prepare import plan_scene
from pipeline.spec.load import load_scene


def plan(
    scene: SceneFile,
    set_: Overrides = None,
    server: Server = None,
    everything: Annotated[
        bool, typer.Option("--all", help="also each decision with its bound, and the notes")
    ] = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="with the rule of each, and the test of its bound")
    ] = False,
    accept: Accepts = None,
    accept_error: AcceptsError = False,
    as_json: Json = False,
) -> None:
    """Show what a scene gives and needs: targets in view, limit, stars, time, memory."""
    overrides = overrides_of(set_, accept, accept_error)
    if server is not None:
        summary = plan_there(scene, overrides, server)
    else:
        summary = plan_scene(load_scene(scene, overrides))
    if as_json:
        print_json(summary)
    else:
        print_plan(summary, everything, explain)
