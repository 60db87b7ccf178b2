"""Settings of the service, read once from the environment."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

from catalog_tools.documents import Arguments
from catalog_tools.engine.addresses import check_scheduler
from pipeline.errors import NO_ROOM, BadInput, DiskFull
from service.store.database import sqlite_url

PREFIX = "NIGHTGLASS_"
OTHERS = (  # variables that are no settings of the service: of commands, clusters, tests, deploy/
    "BIND", "CACHE", "CLUSTER_CA", "CLUSTER_CERT", "CLUSTER_KEY", "DATA", "DEBUG", "IMAGE", "KEY",
    "LOG", "PINS", "SATSIM_PYTHON", "SCREENSHOTS", "SERVER", "SLURM_FOLDER", "WORKERS_WAIT_S",
)  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """Where the service keeps things and how much it takes.

    Every field but `home` may be given as NIGHTGLASS_<FIELD> in the environment.

    home : data folder: jobs.sqlite, products/, uploads/, catalogues/ (each folder there is a
        registered catalogue, known by its name)
    database : URL of the job table; None for jobs.sqlite in the data folder
    hosts : names by which clients may call the service (the Host header), against DNS rebinding
    tls_cert, tls_key : PEM files, where the service itself speaks TLS
    oidc_issuer, oidc_audience, oidc_jwks, oidc_team_claim : bearer tokens of an identity provider:
        who issues them, for whom, its key set (https URL or file), the claim that names the team
    body_bytes, body_s : largest request body, and how long sending it may take
    head_s, send_s : how long a request's head may take, and a client to take a piece of the answer
    answer_s : how long an answer may be in the making, beside what ?wait= allows
    upload_bytes, upload_s : largest uploaded file, and how long sending it may take
    pixel_frames : most frames x pixels of one scene
    product_bytes : most bytes of one scene's product before compression, all its layers
    job_cpu_s : most CPU seconds that a scene may be forecast to take: by its frames and pixels
        when it is submitted, with its stars and responses when it is planned
    targets, observed_rows : most targets of a scene; most rows (times x targets) of an observation
    sweep_points : most points of a sweep
    queued_jobs, running_jobs, pixel_frames_day, bytes_kept : what one team may have waiting, may
        have running, may ask for a day, and may keep on disk (uploads count)
    wait_s : longest time that one GET may wait for a change; most proxies give up at 60 s
    heartbeat_s : pause after which an event stream shows that it lives
    watchers : how many requests may wait for changes at once; a team has at most as many as are
        left free
    plan_s, judge_s, plans : longest time of a dry run, and of a look at the files of a submission;
        how many of both may run at once
    request_threads : threads that answer requests
    slots : jobs that run at once; workers : threads of the engine for each, None for all cores
    scheduler : where jobs run: threads, processes, or the address of a Dask scheduler
    scheduler_s : how long a job that runs waits for a scheduler or catalogue that is gone, without
        a tile done
    dashboard : URL of that scheduler's dashboard, shown in jobs
    lease_s : after this silence of the dispatcher another process takes over
    free_bytes : with less disk than this the service says that it is not ready
    """

    home: Path
    database: str | None = None
    hosts: tuple[str, ...] = ("127.0.0.1", "localhost", "[::1]")
    tls_cert: str | None = None
    tls_key: str | None = None
    oidc_issuer: str | None = None
    oidc_audience: str | None = None
    oidc_jwks: str | None = None
    oidc_team_claim: str = "team"
    body_bytes: int = 1 << 20
    body_s: float = 30.0
    head_s: float = 10.0
    send_s: float = 60.0
    answer_s: float = 60.0
    upload_bytes: int = 1 << 26
    upload_s: float = 300.0
    pixel_frames: int = 1 << 32
    product_bytes: int = 1 << 36
    job_cpu_s: float = 200_000.0
    targets: int = 10_000
    observed_rows: int = 20_000
    sweep_points: int = 1_000_000
    queued_jobs: int = 1000
    running_jobs: int = 1000
    pixel_frames_day: int = 1 << 40
    bytes_kept: int = 1 << 40
    wait_s: float = 50.0
    heartbeat_s: float = 15.0
    watchers: int = 1000
    plan_s: float = 60.0
    judge_s: float = 20.0
    plans: int = 2
    request_threads: int = 16
    slots: int = 1
    workers: int | None = None
    scheduler: str = "threads"
    scheduler_s: float = 3600.0
    dashboard: str | None = None
    lease_s: float = 5.0
    free_bytes: int = 1 << 30

    @property
    def database_url(self) -> str:
        return self.database or sqlite_url(self.home / "jobs.sqlite")

    @property
    def products(self) -> Path:
        return self.home / "products"

    @property
    def catalogues(self) -> Path:
        return self.home / "catalogues"

    @property
    def uploads(self) -> Path:
        return self.home / "uploads"

    def product(self, job_id: str) -> Path:
        """The product directory of a job."""
        return self.products / job_id

    def make_folders(self) -> None:
        """Make the data folder, for its owner alone. BadInput where that is not possible."""
        try:
            self.home.mkdir(mode=0o700, parents=True, exist_ok=True)
            if self.home.stat().st_mode & 0o077:  # made beforehand, by a hand or a package
                self.home.chmod(0o700)
            for folder in (self.products, self.catalogues, self.uploads):
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            if error.errno in NO_ROOM:
                raise DiskFull(str(self.home), error.errno, "make room, then start again") from None
            raise BadInput(
                "--home", str(self.home), f"a folder that can be written; {error.strerror}"
            ) from None

    def check(self) -> None:
        """BadInput for settings that do not go together, or that would be unsafe."""
        check_scheduler(self.scheduler)  # beyond this machine only tls://
        if bool(self.tls_cert) != bool(self.tls_key):
            raise BadInput("NIGHTGLASS_TLS_CERT", self.tls_cert, "given with NIGHTGLASS_TLS_KEY")
        oidc = (self.oidc_issuer, self.oidc_audience, self.oidc_jwks)
        if any(oidc) and not all(oidc):
            allowed = "given with NIGHTGLASS_OIDC_AUDIENCE and NIGHTGLASS_OIDC_JWKS"
            raise BadInput("NIGHTGLASS_OIDC_ISSUER", self.oidc_issuer, allowed)


def read_settings(home: Path | None = None, environ: Mapping[str, str] = os.environ) -> Settings:
    """Settings from the environment; `home` (the command's --home) goes before NIGHTGLASS_HOME.

    Default home: $XDG_DATA_HOME/nightglass or ~/.local/share/nightglass. BadInput names the
    variable that cannot be read.
    """
    given: Arguments = {}
    for field in fields(Settings):
        text = environ.get(PREFIX + field.name.upper())
        if field.name != "home" and text:
            given[field.name] = _parse(PREFIX + field.name.upper(), text, str(field.type))
    if home is None:
        named = environ.get(PREFIX + "HOME")
        data = environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
        home = Path(named) if named else Path(data) / "nightglass"
    settings = Settings(home=home.expanduser().resolve(), **given)
    settings.check()
    return settings


def unknown_variables(environ: Mapping[str, str] = os.environ) -> list[str]:
    """Variables that begin as ours do and mean nothing: misspelt, or of another version."""
    known = {PREFIX + name for name in (*(f.name.upper() for f in fields(Settings)), *OTHERS)}
    return sorted(name for name in environ if name.startswith(PREFIX) and name not in known)


def _parse(name: str, text: str, kind: str) -> str | tuple[str, ...] | float:
    if kind.startswith("str"):
        return text
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
