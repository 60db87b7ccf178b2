"""The Python client: submit a scene to a server, wait for it, open or fetch its product."""

from __future__ import annotations

import io
import math
import os
import re
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx

from catalog_tools.documents import JsonObject, JsonValue
from pipeline.errors import NOT_NOW, BadInput, Missing, NightglassError, why_broken
from service.answers import Refused, ServiceError, problem_of

if TYPE_CHECKING:
    import pyarrow as pa
    import xarray as xr

__all__ = ["Client", "JobFailed", "Refused", "RemoteJob", "ServiceError"]

KEY_VARIABLE = "NIGHTGLASS_KEY"
FINAL = ("COMPLETED", "ERROR", "ABORTED")
LONG_POLL_S, CONNECT_S = 20.0, 30.0
LOOK = httpx.Timeout(CONNECT_S, read=130.0)  # a plan waits for its place, then is worked out
FIRST_S = 5.0  # a server that is asked for the first time may just be starting
Scene = Mapping[str, object] | str | Path
Listener = Callable[[JsonObject], None]


class JobFailed(NightglassError):
    """A job ended as ERROR or ABORTED.

    Parameters
    ----------
    message : str
        What is shown.
    error : dict or None
        What the server says of it, kept as `error`; None for a job that was cancelled.
    """

    def __init__(self, message: str, error: JsonObject | None) -> None:
        self.error = error
        super().__init__(message)


class Client:
    """A connection to a Nightglass server; in a `with` block it is closed at the end.

    Parameters
    ----------
    url : str
        Address of the server: `http://127.0.0.1:8765`, `https://...`.
    key : str, optional
        The team's API key; default: the environment's NIGHTGLASS_KEY.
    patience_s : float
        Seconds for which a server that does not answer, or is overloaded, is asked again; one that
        never answered yet at most FIRST_S.

    Raises
    ------
    BadInput
        For what is no address.
    """

    def __init__(self, url: str, key: str | None = None, *, patience_s: float = 60.0) -> None:
        if not re.match(r"https?://(?:[\w.-]+|\[[0-9A-Fa-f:.]+\])(?::\d{1,5})?(?:/|$)", url):
            raise BadInput("--server", url, "an address like http://127.0.0.1:8765")
        key = key if key is not None else os.environ.get(KEY_VARIABLE)
        self.url, self.patience_s, self._met = url.rstrip("/"), patience_s, False
        self.headers = {"Authorization": f"Bearer {key}"} if key else {}
        timeout = httpx.Timeout(CONNECT_S, read=LONG_POLL_S + 40.0)
        try:
            self.http = httpx.Client(base_url=self.url, headers=self.headers, timeout=timeout)
        except (httpx.InvalidURL, ValueError) as error:
            raise BadInput("--server", url, f"an address; {error}") from None

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.http.close()

    def submit(self, scene: Scene, idempotency_key: str | None = None) -> RemoteJob:
        """Submit a scene to be rendered.

        Parameters
        ----------
        scene : mapping or path
            Plain data, or the path of its YAML or JSON file.
        idempotency_key : str, optional
            What is sent twice with one key becomes one job, however often the connection breaks;
            default: a new key.

        Returns
        -------
        RemoteJob
            The job, QUEUED or PENDING; `wait` for it.

        Raises
        ------
        BadInput
            For a file that is no scene's.
        Refused
            With every mistake of the scene (it is a BadInput).
        ServiceError
            Where the server does not answer, or has a fault.
        """
        return self._submit("/v1/jobs", _data(scene), idempotency_key)

    def sweep(self, sweep: Scene, idempotency_key: str | None = None) -> RemoteJob:
        """Submit a sweep of scenes.

        Parameters
        ----------
        sweep : mapping or path
            As `submit` takes a scene; its base scene may be a file beside it, which is sent along.
        idempotency_key : str, optional
            As in `submit`.

        Returns
        -------
        RemoteJob
            The job, QUEUED or PENDING; its table comes by `points`.

        Raises
        ------
        BadInput, Refused, ServiceError
            As `submit` does.
        """
        data = _data(sweep)
        base = data.get("scene") if isinstance(data, dict) else None
        if isinstance(base, str):
            folder = Path() if isinstance(sweep, Mapping) else Path(sweep).parent
            data = data | {"scene": _data(folder / base)}
        return self._submit("/v1/sweeps", data, idempotency_key)

    def study(self, study: Scene, idempotency_key: str | None = None) -> RemoteJob:
        """Submit a study of capacity.

        Parameters
        ----------
        study : mapping or path
            As `submit` takes a scene; files that it names are uploads of the server.
        idempotency_key : str, optional
            As in `submit`.

        Returns
        -------
        RemoteJob
            The job, QUEUED or PENDING; what it made comes by `fetch_sweep`.

        Raises
        ------
        BadInput, Refused, ServiceError
            As `submit` does.
        """
        return self._submit("/v1/studies", _data(study), idempotency_key)

    def _submit(self, path: str, data: JsonValue, idempotency_key: str | None) -> RemoteJob:
        headers = {"Idempotency-Key": idempotency_key or str(uuid.uuid4())}
        return RemoteJob(self, self.ask("POST", path, json=data, headers=headers).json())

    def plan(self, scene: Scene) -> JsonObject:
        """What a scene needs and why, planned by the server; nothing is rendered.

        Parameters
        ----------
        scene : mapping or path
            As `submit` takes it.

        Returns
        -------
        dict
            The plan, as `nightglass plan --json` prints it; units in the keys.

        Raises
        ------
        BadInput, Refused, ServiceError
            As `submit` does.
        """
        asked = {"dry_run": "1"}
        return self.ask("POST", "/v1/jobs", json=_data(scene), params=asked, timeout=LOOK).json()

    def observe(self, scene: Scene, **asked: Any) -> JsonObject:
        """What a scene's sensor sees, worked out by the server without drawing.

        Parameters
        ----------
        scene : mapping or path
            As `submit` takes it.
        **asked
            `times` ("START,STOP,STEP": UTC or seconds after the epoch, and a step in seconds) and
            `snr` (below which a target is too faint).

        Returns
        -------
        dict
            Rows and counts, as `nightglass observe --json` prints them; units in the keys.

        Raises
        ------
        BadInput, Refused, ServiceError
            As `submit` does; Refused also for times or `snr`.
        """
        data = _data(scene)
        return self.ask("POST", "/v1/observe", json=data, params=asked, timeout=LOOK).json()

    def job(self, job_id: str) -> RemoteJob:
        """A job by its id.

        Parameters
        ----------
        job_id : str
            As `nightglass jobs list` shows it.

        Returns
        -------
        RemoteJob
            The job as it is now.

        Raises
        ------
        BadInput
            For what is no id.
        ServiceError
            As `ask` does; also where the team has no such job.
        """
        return RemoteJob(self, self.ask("GET", f"/v1/jobs/{_word(job_id)}").json())

    def jobs(self, phase: str | None = None) -> Iterator[RemoteJob]:
        """The team's jobs in order of submission, asked for page by page.

        Parameters
        ----------
        phase : str, optional
            Only jobs of this phase, such as "EXECUTING".

        Yields
        ------
        RemoteJob
            Each as it is now.

        Raises
        ------
        Refused, ServiceError
            As `ask` does; Refused for a phase that is none.
        """
        path = "/v1/jobs"
        params = {"phase": phase} if phase else None
        while path:
            answer = self.ask("GET", path, params=params)
            yield from (RemoteJob(self, facts) for facts in answer.json()["jobs"])
            path, params = answer.links.get("next", {}).get("url", ""), None

    def catalogues(self) -> list[JsonObject]:
        """The catalogues that a scene may name.

        Returns
        -------
        list of dict
            Of each its name and what it holds; units in the keys.

        Raises
        ------
        ServiceError
            As `ask` does.
        """
        return self.ask("GET", "/v1/catalogues").json()["catalogues"]

    def ask(self, method: str, path: str, **request: Any) -> httpx.Response:
        """One request, asked again while the server does not answer or is overloaded.

        Parameters
        ----------
        method, path : str
            Such as "GET" and "/v1/jobs".
        **request
            What `httpx.Client.request` takes: `json`, `params`, `headers`, ...

        Returns
        -------
        httpx.Response
            An answer that is no error; also 404 for what an earlier DELETE, whose answer was lost,
            may have removed.

        Raises
        ------
        Refused
            With what the server says is wrong with the request.
        ServiceError
            Where no answer comes within `patience_s` (FIRST_S where none ever came), or a fault.
        """
        begun, pause_s, lost = time.monotonic(), 0.25, False
        while True:
            try:
                answer = self.http.request(method, path, **request)
                self._met = True
                problem = problem_of(answer, was_asked=lost and method == "DELETE")
                if problem is None:
                    return answer
                if answer.status_code not in NOT_NOW:
                    raise problem
            except httpx.TransportError as error:
                problem = ServiceError(f"{self.url} does not answer: {error}")
                lost |= not isinstance(error, httpx.ConnectError | httpx.ConnectTimeout)
            patience_s = self.patience_s if self._met else min(self.patience_s, FIRST_S)
            if time.monotonic() + pause_s > begun + patience_s:
                raise problem
            time.sleep(pause_s)
            pause_s = min(5.0, 2 * pause_s)


class RemoteJob:
    """A job on a server.

    Parameters
    ----------
    client : Client
        The connection it is asked for by.
    facts : dict
        What was last heard of it, kept as `facts`.
    """

    def __init__(self, client: Client, facts: JsonObject) -> None:
        self.client, self.facts = client, facts
        self.id: str = facts["id"]
        self.path = f"/v1/jobs/{self.id}"

    def __repr__(self) -> str:
        return f"<job {self.id} {self.name!r}: {self.phase}>"

    @property
    def name(self) -> str:
        """Of its scene, sweep or study."""
        return self.facts["name"]

    @property
    def phase(self) -> str:
        """PENDING, QUEUED, EXECUTING, COMPLETED, ERROR or ABORTED, as last heard."""
        return self.facts["phase"]

    def refresh(self) -> RemoteJob:
        """Ask the server how it is now.

        Returns
        -------
        RemoteJob
            Itself, its `facts` renewed.

        Raises
        ------
        ServiceError
            As `Client.ask` does; also where it was deleted.
        """
        self.facts = self.client.ask("GET", self.path).json()
        return self

    def wait(self, timeout_s: float | None = None, progress: bool | Listener = True) -> RemoteJob:
        """Wait until the job has ended; a server that restarts meanwhile is waited for.

        Parameters
        ----------
        timeout_s : float, optional
            The most seconds to wait; default: as long as it takes.
        progress : bool or callable
            A bar on stderr where that is a terminal; or a function called with the job's facts at
            every change.

        Returns
        -------
        RemoteJob
            Itself, COMPLETED.

        Raises
        ------
        JobFailed
            Where it ended as ERROR or ABORTED.
        TimeoutError
            After `timeout_s`.
        ServiceError
            Where the server does not answer.
        """
        deadline = time.monotonic() + (math.inf if timeout_s is None else timeout_s)
        shown = _bar(self.name) if progress is True else nullcontext(progress or None)
        headers: dict[str, str] = {}
        with shown as listen:
            while True:
                left = deadline - time.monotonic()
                params = {"wait": f"{max(0.0, min(LONG_POLL_S, left)):.3f}"}
                answer = self.client.ask("GET", self.path, params=params, headers=headers)
                if answer.status_code == 200:
                    self.facts = answer.json()
                    headers = {"If-None-Match": answer.headers.get("etag", "")}
                    if listen is not None:
                        listen(self.facts)
                if self.phase in FINAL:
                    break
                if left <= 0:
                    raise TimeoutError(f"job {self.id} is {self.phase} after {timeout_s:g} s")
        if self.phase != "COMPLETED":
            raise self._failure()
        return self

    def _failure(self) -> JobFailed:
        error = self.facts.get("error")
        told = error["message"] if error else "it was cancelled"
        return JobFailed(f"job {self.id} ({self.name}) ended as {self.phase}: {told}", error)

    def cancel(self) -> RemoteJob:
        """Stop it; what it has drawn stays until it is deleted.

        Returns
        -------
        RemoteJob
            Itself, its `facts` renewed.

        Raises
        ------
        ServiceError
            As `Client.ask` does; also where it is COMPLETED or ERROR.
        """
        self.facts = self.client.ask("POST", f"{self.path}/cancel").json()
        return self

    def retry(self) -> RemoteJob:
        """Queue it again, after it ended as ERROR through no fault of its scene.

        Returns
        -------
        RemoteJob
            Itself, its `facts` renewed.

        Raises
        ------
        ServiceError
            As `Client.ask` does; also for any other job.
        """
        self.facts = self.client.ask("POST", f"{self.path}/retry").json()
        return self

    def delete(self) -> None:
        """Stop it and remove it with all that it made.

        Raises
        ------
        ServiceError
            As `Client.ask` does; also where it was deleted.
        """
        self.client.ask("DELETE", self.path)

    def scene(self) -> JsonObject:
        """Its scene, defaults filled in.

        Returns
        -------
        dict
            Plain data of the scene format; units in the keys.

        Raises
        ------
        ServiceError
            As `Client.ask` does; also where it was deleted.
        """
        return self.client.ask("GET", f"{self.path}/scene").json()

    def report(self) -> JsonObject:
        """The report of its product.

        Returns
        -------
        dict
            `report.json`; units in the keys.

        Raises
        ------
        ServiceError
            As `Client.ask` does; also where there is none yet.
        """
        return self.client.ask("GET", f"{self.path}/report").json()

    def points(self) -> pa.Table:
        """The table of a sweep's points: their values and what was measured.

        Returns
        -------
        pyarrow.Table
            A row a point; units in the names of the columns.

        Raises
        ------
        BadInput
            For a job that is no sweep's, or not COMPLETED.
        JobFailed
            Where it ended as ERROR or ABORTED.
        ServiceError
            As `Client.ask` does.
        """
        import pyarrow.parquet as pq

        self._complete("sweep")
        answer = self.client.ask("GET", f"{self.path}/results/points.parquet")
        return pq.read_table(io.BytesIO(answer.content))

    def open(self, folder: Path | str | None = None) -> xr.Dataset:
        """Its cube: frames as layers, with their coordinates.

        Parameters
        ----------
        folder : path, optional
            Where the product is fetched to and verified first; without it chunks are read over
            HTTP when they are needed, each proved by its checksum.

        Returns
        -------
        xarray.Dataset
            `dn (frame, y, x)` in digital numbers; layers whose names end in `_e` in electrons.

        Raises
        ------
        BadInput
            For a job that is no scene's, or not COMPLETED; where reading over HTTP needs a package
            that is not installed.
        JobFailed
            Where it ended as ERROR or ABORTED.
        Damaged, Incomplete, ServiceError
            As `fetch` does, where there is a folder; without it, reading a lost chunk raises
            Damaged.
        """
        if folder is not None:
            from pipeline.store.cube import open_cube

            return open_cube(self.fetch(folder))
        from zarr.storage import FsspecStore

        from pipeline.store.whole_chunks import open_whole

        self._complete("scene")
        try:
            import aiohttp  # noqa: F401
        except ImportError as error:
            what, instead = "cubes read over HTTP", "give a folder to fetch the product into"
            broken = why_broken(error, "aiohttp")
            raise Missing(what, "aiohttp", "remote", instead, broken=broken) from None
        address = f"{self.client.url}{self.path}/results/cube.zarr"
        options = {"headers": self.client.headers} if self.client.headers else {}
        store = FsspecStore.from_url(address, storage_options=options, read_only=True)
        return open_whole(store)

    def fetch(
        self, folder: Path | str, parallel: int = 8, progress: bool | Listener = True
    ) -> Path:
        """Fetch its product; every file is verified, and what is there already is kept.

        Parameters
        ----------
        folder : path
            Where it goes; an interrupted fetch continues there.
        parallel : int
            Files at once.
        progress : bool or callable
            As in `wait`.

        Returns
        -------
        Path
            The product's folder.

        Raises
        ------
        Damaged
            Where a byte differs from what was rendered.
        Incomplete
            Where the connection broke too often; the same call goes on.
        BadInput
            For a job that is no scene's, or not COMPLETED; for a folder that holds something else.
        JobFailed
            Where it ended as ERROR or ABORTED.
        ServiceError
            As `Client.ask` does.
        """
        self._complete("scene")
        shown = (
            _bar(f"fetching {self.name}", "MB")
            if progress is True
            else nullcontext(progress or None)
        )
        from service.fetching import fetch_product

        with shown as listen:
            return fetch_product(self, Path(folder), parallel, listen)

    def fetch_sweep(self, folder: Path | str) -> Path:
        """Fetch what a sweep or a study made: its tables, report and page, each verified.

        Parameters
        ----------
        folder : path
            Where it goes; not there yet, or empty.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        Damaged
            Where a byte differs from what was made.
        BadInput
            For a job that is neither a sweep's nor a study's or has not COMPLETED, or a folder
            that holds something.
        JobFailed
            Where it ended as ERROR or ABORTED.
        ServiceError
            As `Client.ask` does.
        """
        from service.fetching import fetch_sweep

        self._complete("sweep", "study")
        return fetch_sweep(self, Path(folder))

    def _complete(self, *kinds: str) -> None:
        if self.facts["kind"] not in kinds:
            more = "; a sweep's table comes by points()" if "scene" in kinds else ""
            allowed = " or ".join(f"a {kind}'s job" for kind in kinds)
            raise BadInput("job", self.id, allowed + more)
        if self.phase != "COMPLETED":
            self.refresh()
        if self.phase in ("ERROR", "ABORTED"):
            raise self._failure()
        if self.phase != "COMPLETED":
            raise BadInput("job", self.id, f"a job that is COMPLETED; this one is {self.phase}")


def _data(scene: Scene) -> JsonValue:
    """The scene as plain data; files are read here, so that the server never sees their path."""
    if isinstance(scene, Mapping):
        return dict(scene)
    from pipeline.spec.load import MAX_BYTES, parse_text

    path = Path(scene)
    if not path.is_file() or path.stat().st_size > MAX_BYTES:
        allowed = f"an existing scene file (YAML or JSON) of at most {MAX_BYTES} bytes"
        raise BadInput("SCENE", str(path), allowed)
    return parse_text(path.read_bytes(), str(path))


def _word(job_id: str) -> str:
    if not job_id.isalnum():
        raise BadInput("JOB", job_id, "the id of a job, as `nightglass jobs list` shows it")
    return job_id


def _bar(name: str, unit: str = "") -> Any:
    from service.client_bar import bar

    return bar(name, unit)
