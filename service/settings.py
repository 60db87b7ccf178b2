"""Settings of the service, read once from the environment."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from pipeline.errors import BadInput

PREFIX = "NIGHTGLASS_"


@dataclass(frozen=True)
class Settings:
    """Where the service keeps things and how much it takes.

    Every field but `home` may be given as NIGHTGLASS_<FIELD> in the environment.

    home : data folder: jobs.sqlite, products/, catalogues/ (each folder there is a registered
        catalogue, known by its name)
    hosts : names by which clients may call the service (the Host header), against DNS rebinding
    body_bytes, body_s : largest request body, and how long sending it may take
    pixel_frames : most frames x pixels of one scene
    targets, queued_jobs : most targets of a scene, most jobs waiting
    wait_s : longest time that one GET may wait for a change
    heartbeat_s : pause after which an event stream shows that it lives
    plan_s, plans : longest time of a dry run, and how many may run at once
    request_threads : threads that answer requests
    workers : threads of the engine; None for all cores
    free_bytes : with less disk than this the service says that it is not ready
    """

    home: Path
    hosts: tuple[str, ...] = ("127.0.0.1", "localhost", "[::1]")
    body_bytes: int = 1 << 20
    body_s: float = 30.0
    pixel_frames: int = 1 << 32
    targets: int = 10_000
    queued_jobs: int = 1000
    wait_s: float = 60.0
    heartbeat_s: float = 15.0
    plan_s: float = 60.0
    plans: int = 2
    request_threads: int = 16
    workers: int | None = None
    free_bytes: int = 1 << 30

    @property
    def database(self) -> Path:
        return self.home / "jobs.sqlite"

    @property
    def products(self) -> Path:
        return self.home / "products"

    @property
    def catalogues(self) -> Path:
        return self.home / "catalogues"

    @property
    def dispatcher_lock(self) -> Path:
        return self.home / "dispatcher.lock"

    def product(self, job_id: str) -> Path:
        """The product directory of a job."""
        return self.products / job_id

    def make_folders(self) -> None:
        """Make the data folder. BadInput where that is not possible."""
        try:
            for folder in (self.home, self.products, self.catalogues):
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(
                "--home", str(self.home), f"a folder that can be written; {error.strerror}"
            ) from None


def read_settings(home: Path | None = None, environ: Mapping[str, str] = os.environ) -> Settings:
    """Settings from the environment; `home` (the command's --home) goes before NIGHTGLASS_HOME.

    Default home: $XDG_DATA_HOME/nightglass or ~/.local/share/nightglass. BadInput names the
    variable that cannot be read.
    """
    given: dict[str, Any] = {}
    for field in fields(Settings):
        text = environ.get(PREFIX + field.name.upper())
        if field.name != "home" and text:
            given[field.name] = _parse(PREFIX + field.name.upper(), text, str(field.type))
    if home is None:
        named = environ.get(PREFIX + "HOME")
        data = environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
        home = Path(named) if named else Path(data) / "nightglass"
    return Settings(home=home.expanduser().resolve(), **given)


def _parse(name: str, text: str, kind: str) -> Any:
    if kind.startswith("tuple"):
        return tuple(part.strip().lower() for part in text.split(",") if part.strip())
    whole = kind.startswith("int")
    try:
        value = int(text) if whole else float(text)
    except ValueError:
        value = 0
    if not 0 < value < 1e18:
        raise BadInput(name, text, f"a positive {'whole ' if whole else ''}number")
    return value
