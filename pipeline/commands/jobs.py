"""The command line's `nightglass jobs ...` and `--server`: scenes rendered by a server."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from catalog_tools.documents import JsonObject
from pipeline.commands.options import Json, Output, print_json
from pipeline.errors import BadInput, Interrupted, check_new
from pipeline.lines import fold, pair, table

jobs = typer.Typer(
    help="Jobs on a server (key: NIGHTGLASS_KEY).", no_args_is_help=True, add_completion=False
)
Server = Annotated[
    str | None, typer.Option(help="work there: http://host:port (key: NIGHTGLASS_KEY)")
]
Address = Annotated[
    str, typer.Option("--server", envvar="NIGHTGLASS_SERVER", help="http://host:port")
]
JobId = Annotated[str, typer.Argument(metavar="JOB", help="id of a job")]


def connect(server: str) -> Any:
    """A client of a server; service.client is loaded only now."""
    return import_module("service.client").Client(server)


def read_scene(scene: Path, overrides: list[str]) -> Any:
    """A scene file as plain data with its overrides; judged by the server."""
    from pipeline.spec.load import MAX_BYTES, apply_override, parse_text  # the scene's model

    if not scene.is_file() or scene.stat().st_size > MAX_BYTES:
        allowed = f"an existing scene file (YAML or JSON) of at most {MAX_BYTES} bytes"
        raise BadInput("SCENE", str(scene), allowed)
    data = parse_text(scene.read_bytes(), str(scene))
    for override in overrides:
        apply_override(data, override)
    return data


def render_there(
    scene: Path, output: Path, overrides: list[str], server: str, as_json: bool
) -> JsonObject:
    """Submit a scene, wait, fetch its product into `output`; returns the report.

    Interrupted, the job goes on; `nightglass jobs fetch` brings what it made.
    """
    check_new(output, empty=True)
    with connect(server) as client:
        job = client.submit(read_scene(scene, overrides))
        try:
            job.wait(progress=not as_json).fetch(output, progress=not as_json)
        except KeyboardInterrupt:
            again = f"nightglass jobs fetch {job.id} --server {server} -o {output}"
            raise Interrupted(f"interrupted; the job goes on: {again}") from None
        return job.report()


def run_there(
    kind: str, asked: Path | JsonObject, output: Path, server: str, as_json: bool
) -> JsonObject:
    """Submit a `sweep` or a `study`, wait, fetch what it made into `output`; returns the report.

    Interrupted, the job goes on; `nightglass jobs show` tells of it.
    """
    check_new(output, empty=True)
    with connect(server) as client:
        job = getattr(client, kind)(asked)
        try:
            job.wait(progress=not as_json).fetch_sweep(output)
        except KeyboardInterrupt:
            again = f"nightglass jobs show {job.id} --server {server}"
            raise Interrupted(f"interrupted; the job goes on: {again}") from None
        return job.report()


def plan_there(scene: Path, overrides: list[str], server: str) -> JsonObject:
    """The plan of a scene, made by a server."""
    with connect(server) as client:
        return client.plan(read_scene(scene, overrides))


@jobs.command("list")
def listing(
    server: Address,
    phase: Annotated[str | None, typer.Option(help="PENDING, QUEUED, EXECUTING, ...")] = None,
    as_json: Json = False,
) -> None:
    """The jobs of the team, in order of submission."""
    with connect(server) as client:
        found = [job.facts for job in client.jobs(phase.upper() if phase else None)]
    if as_json:
        print_json(found)
        return
    rows = [
        (
            f["id"],
            f["name"],
            f["phase"],
            f["submitted"][:19],
            f"{f['tiles_done'] or 0}/{f['tiles_total']}" if f["tiles_total"] else "",
        )
        for f in found
    ]
    print(table(("job", "name", "phase", "submitted", "tiles"), rows, 2))


@jobs.command()
def show(job: JobId, server: Address, as_json: Json = False) -> None:
    """One job: its phase, progress, times, error."""
    with connect(server) as client:
        facts = client.job(job).facts
    if as_json:
        print_json(facts)
        return
    error = facts.pop("error", None)
    for key, value in facts.items():
        if key != "links" and value is not None:
            print(pair(key, str(value), 16))
    if error:
        print(pair("error", error["message"], 16))
        for one in error["errors"]:
            print(fold(f"{one['pointer']}: {one['value']}; {one['allowed']}", " " * 18))


@jobs.command()
def cancel(job: JobId, server: Address) -> None:
    """Stop a job; what it has drawn stays until it is deleted."""
    with connect(server) as client:
        print(client.job(job).cancel())


@jobs.command()
def retry(job: JobId, server: Address) -> None:
    """Run a job again that ended as ERROR, not by its scene; it continues from its tiles."""
    with connect(server) as client:
        print(client.job(job).retry())


@jobs.command()
def fetch(
    job: JobId,
    server: Address,
    output: Output,
    wait: Annotated[bool, typer.Option(help="wait until the job has ended")] = True,
) -> None:
    """Fetch and verify what a job made; an interrupted fetch continues."""
    with connect(server) as client:
        found = client.job(job)
        found = found.wait() if wait else found
        tables = found.facts["kind"] in ("sweep", "study")
        print(found.fetch_sweep(output) if tables else found.fetch(output))
