"""What all commands share: the options they have in common, and how results are printed."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from catalog_tools.documents import JsonObject
from catalog_tools.storage.urls import is_url
from pipeline.errors import BadInput, Interrupted
from pipeline.lines import pair


def _no_url(path: Path) -> Path:
    """BadInput for a URL: only products of a scene are written to an object store."""
    if is_url(path):
        allowed = "a path of a file system (only `nightglass render` writes to s3://BUCKET/NAME; "
        raise BadInput("-o", str(path).replace(":/", "://", 1), f"{allowed}docs/cluster.md)")
    return path


Output = Annotated[
    Path, typer.Option("-o", "--output", help="where the result goes", callback=_no_url)
]


def local_path(place: str) -> Path:
    """A path of a file system. BadInput for a URL."""
    return _no_url(Path(place))


OutputOrUrl = Annotated[
    str,
    typer.Option("-o", "--output", help="where the product goes: a folder, or s3://BUCKET/NAME"),
]
ProductOrUrl = Annotated[
    str, typer.Argument(help="product directory, or s3://BUCKET/NAME", metavar="PRODUCT")
]
SceneFile = Annotated[Path, typer.Argument(help="scene file, YAML or JSON", metavar="SCENE")]
Json = Annotated[bool, typer.Option("--json", help="machine-readable result on stdout")]
SchedulerName = Annotated[
    str,
    typer.Option(help="threads, synchronous, processes, slurm, or a scheduler's tcp:// or tls://"),
]
Slurm = Annotated[bool, typer.Option("--slurm", help="the same as --scheduler slurm")]
Workers = Annotated[int | None, typer.Option(min=1, help="threads or processes; default: all")]


Wait = Annotated[
    float, typer.Option("--wait", min=0, help="seconds to wait for another render of the product")
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", help="override a key: --set sensor.read_noise_e=3"),
]
Accepts = Annotated[
    list[str] | None,
    typer.Option(
        "--accept", help="draw what would be refused: error, sun, moon, daylight, coverage"
    ),
]
AcceptsError = Annotated[bool, typer.Option("--accept-error", help="the same as --accept error")]


def overrides_of(set_: list[str] | None, accept: list[str] | None, error: bool) -> list[str]:
    """The overrides of a scene that its command asks for: `--set`, then `--accept`."""
    words = [*(accept or []), *(["error"] if error else [])]
    return [*(set_ or []), *(f"accept+={word}" for word in words)]


@contextmanager
def told_if_interrupted(
    place: str, kept: Callable[[], str], resumes: bool = True
) -> Iterator[None]:
    """Ctrl-C inside says what is kept below a place, and the command that goes on.

    kept : tells what is, when it is called; resumes : with --resume, else with the same command
    """
    try:
        yield
    except KeyboardInterrupt:
        if "://" not in place and not Path(place).exists():
            raise Interrupted(f"interrupted; {place}: nothing was begun") from None
        words = [word for word in sys.argv[1:] if word not in ("--replace", "--resume")]
        again = shlex.join(["nightglass", *words, *(["--resume"] if resumes else [])])
        raise Interrupted(f"interrupted; {place}: {kept()}; go on with:\n  {again}") from None


def as_stated(report: JsonObject) -> None:
    """Exit code 5 for a finished product whose error is more than its plan stated."""
    if report.get("errors", {}).get("as_stated") is False:  # None: nothing could be looked at
        raise typer.Exit(5)


def print_json(value: Any) -> None:
    """A value as indented JSON on stdout."""
    print(json.dumps(value, indent=2, allow_nan=False))


def print_mapping(value: JsonObject, as_json: bool) -> None:
    """A mapping for people, a line for each key; or as JSON."""
    if as_json:
        print_json(value)
        return
    for key, item in value.items():
        print(pair(key, str(item), 28))
