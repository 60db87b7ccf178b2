"""What all commands share: the options they have in common, and how results are printed."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.errors import BadInput


def _no_url(path: Path) -> Path:
    """BadInput for a URL: results need a file system's rename and locks."""
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:/", str(path)):
        allowed = "a path of a file system (copy the complete result to a store like s3, "
        raise BadInput("-o", str(path), f"{allowed}its _COMPLETE last; docs/cluster.md)")
    return path


Output = Annotated[
    Path, typer.Option("-o", "--output", help="where the result goes", callback=_no_url)
]
Json = Annotated[bool, typer.Option("--json", help="machine-readable result on stdout")]
SchedulerName = Annotated[
    str,
    typer.Option(help="threads, synchronous, processes, slurm, or a scheduler's tcp:// or tls://"),
]
Slurm = Annotated[bool, typer.Option("--slurm", help="the same as --scheduler slurm")]
Workers = Annotated[int | None, typer.Option(min=1, help="threads or processes; default: all")]


def print_json(value: Any) -> None:
    """A value as indented JSON on stdout."""
    print(json.dumps(value, indent=2, allow_nan=False))


def print_mapping(value: dict[str, Any], as_json: bool) -> None:
    """A mapping for people, a line for each key; or as JSON."""
    if as_json:
        print_json(value)
        return
    for key, item in value.items():
        print(f"{key:>28}  {item}")
