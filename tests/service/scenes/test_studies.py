"""Studies over REST: forecast, run and fetched like jobs; files in them are uploads alone."""

from __future__ import annotations

import copy
import io
import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from pipeline.capacity.run import StudyOptions, run_study
from pipeline.cli import app
from pipeline.errors import BadInput
from service.client import Client
from service.engine.orders import ORDERS
from service.problems import NotAllowed
from service.scenes import studies
from service.scenes.studies import accept_study
from service.settings import Settings
from tests.capacity.conftest import SMALL, without_pictures  # noqa: F401 - a fixture

ELEMENTS = Path(__file__).resolve().parents[3] / "examples" / "population.tle"
BODY = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}


def _study(**changes: Any) -> dict[str, Any]:
    return copy.deepcopy(SMALL) | {"duration_h": 1.0} | changes


def test_a_study_is_forecast_run_and_fetched(server: Any) -> None:
    """With the elements of an uploaded file."""
    post = server.client.post
    sent = post("/v1/files?name=population.tle", content=ELEMENTS.read_bytes())
    assert sent.status_code in (200, 201), sent.text
    population = {"name": "sent", "path": sent.json()["id"], "body": BODY}
    study = _study(catalogue={"populations": [population]})
    answer = post("/v1/studies?dry_run=1", json=study)
    assert answer.status_code == 200, answer.text
    told = answer.json()
    assert (told["objects"], told["steps"], told["sensors"]) == (600, 60, 3)
    key = {"Idempotency-Key": "study-1"}
    made = post("/v1/studies", json=study, headers=key)
    assert made.status_code == 202, made.text
    assert post("/v1/studies", json=study, headers=key).status_code == 200
    here = made.headers["location"]
    job = server.ended(here)
    assert (job["phase"], job["kind"]) == ("COMPLETED", "study"), job["error"]
    assert job["tiles_done"] == job["tiles_total"] >= 1
    report = server.client.get(f"{here}/report").json()
    assert report["figures"]["objects"] == 600
    table = pq.read_table(io.BytesIO(server.client.get(f"{here}/results/objects.parquet").content))
    assert table.num_rows == 600
    for frames in ("plan", "frames", "frames/0", "frames/0/fits", "frames/0/truth"):
        answer = server.client.get(f"{here}/{frames}")
        assert (answer.status_code, "neither frames" in answer.text) == (404, True), frames
    assert b"Gap time by orbit" in server.client.get(f"{here}/results/report.html").content
    assert str(server.home) not in server.client.get(f"{here}/results/study.json").text


def test_by_the_client_and_the_command(server: Any, tmp_path: Path) -> None:
    """What comes from a server is what the study makes here; a taken folder is refused first."""
    file = tmp_path / "study.json"
    file.write_text(json.dumps(_study()))
    own = run_study(_study(), tmp_path, tmp_path / "own", StudyOptions("synchronous"))
    with Client(server.url) as client:
        job = client.study(file, "study-2")
        assert client.study(_study(), "study-2").id == job.id  # the same body
        job.wait(60, progress=False).fetch_sweep(tmp_path / "fetched")
        with pytest.raises(BadInput, match="a scene's job"):
            job.open()
    assert (
        json.loads((tmp_path / "fetched" / "report.json").read_text())["figures"]
        == (own["figures"])
    )
    words = ["study", str(file), "--server", server.url, "-o", str(tmp_path / "there")]
    result = CliRunner().invoke(app, [*words, "--set", "seed=4"])
    assert result.exit_code == 0, result.output
    assert ", 1 h in" in result.output
    again = CliRunner().invoke(app, words)
    assert "a path that does not exist yet" in str(again.exception)
    with_more = CliRunner().invoke(app, [*words, "--resume"])
    assert "without --resume" in str(with_more.exception)
    assert pq.read_table(tmp_path / "there" / "objects.parquet").num_rows == 60


@pytest.mark.usefixtures("without_pictures")
def test_a_study_tells_how_far_it_is(tmp_path: Path) -> None:
    """By parts of six hours: by that a worker that dies is known to have come on, too."""
    seen: list[Any] = []
    order = {"scene": _study(duration_h=24.0), "product": str(tmp_path / "made"), "resume": False}
    order |= {"scheduler": "synchronous", "workers": 1, "most_cpu_s": 1000.0}
    assert studies.run_study(order, seen.append)["tiles"] == 4
    assert [(told.done, told.total) for told in seen] == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_what_a_study_may_not_hold(server: Any) -> None:
    post = server.client.post
    population = {"name": "file", "path": "/etc/passwd", "body": BODY}
    answer = post("/v1/studies", json=_study(catalogue={"populations": [population]}))
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/catalogue/populations/0/path"
    long = _study(duration_h=80_000, catalogue={"synthetic": {"objects": 1_000_000}})
    assert "CPU s" in post("/v1/studies", json=long).text
    axes = [{"field": "catalogue.populations.0.path", "values": ["a", "b"]}]
    answer = post("/v1/studies", json=_study(axes=axes))
    assert "over REST no axis goes through files" in answer.text
    assert post("/v1/studies", json={"schema": "nightglass/study/1"}).status_code == 422


@pytest.mark.parametrize("dry_run", [False, True])
@pytest.mark.parametrize(
    ("wrong", "pointer", "said"),
    [
        ({"axes": [{"field": "sensors.0.nope", "values": [1.0]}]}, "/axes/0", "known keys: "),
        ({"axes": [{"field": "step_s", "values": [60.0, -1.0]}]}, "/axes/0", "equal to 1"),
        ({"sensors": [SMALL["sensors"][0] | {"cameras": ["no"]}]}, "/sensors/0/cameras", "known"),
        ({"catalogue": {"populations": [{"path": "sent"}]}}, "/catalogue/populations/0/path", ""),
    ],
)
def test_what_no_study_can_be_is_refused_at_once(
    wrong: dict[str, Any], pointer: str, said: str, dry_run: bool, server: Any
) -> None:
    """By where it stands in the body, as the command line refuses it."""
    wrong = copy.deepcopy(wrong)
    for population in wrong.get("catalogue", {}).get("populations", ()):
        sent = server.client.post("/v1/files?name=two.tle", content=b"1 no\n2 elements\n")
        population |= {"name": "sent", "path": sent.json()["id"], "body": BODY}
    answer = server.client.post(f"/v1/studies?dry_run={int(dry_run)}", json=_study(**wrong))
    assert answer.status_code == 422, answer.text
    first = answer.json()["errors"][0]
    assert first["pointer"] == pointer
    assert said in first["allowed"]


def test_limits_of_a_study(tmp_path: Path) -> None:
    """CPU by objects x steps x points, and points, against the settings; no axis goes through
    files or orbits."""
    settings = Settings(tmp_path, job_cpu_s=1000.0, sweep_points=7)
    day = _study(duration_h=24.0, catalogue={"synthetic": {"objects": 100_000}})  # 144 s a point

    def seeds(count: int, **changes: Any) -> dict[str, Any]:
        return accept_study(day | {"seeds": count} | changes, settings)

    assert seeds(6)["seeds"] == 6
    with pytest.raises(NotAllowed, match="at most 1000 CPU s, 7 points"):
        seeds(7)
    assert seeds(7, duration_h=12.0)["seeds"] == 7
    with pytest.raises(NotAllowed, match="7 points"):
        seeds(8, duration_h=1.0)
    file = "/etc/passwd"
    hidden: dict[str, object] = {
        "catalogue.populations.0.sizes": file,
        " catalogue.populations.0.path": file,
        "catalogue.populations": [{"path": file}],
        "sensors.0.observer.orbit": {"kind": "omm", "path": file},
        "sensors.0.observer": {"kind": "orbit", "orbit": {"kind": "omm", "path": file}},
        "cameras.0.sensor.quantum_efficiency": file,
        "cameras.0.sensor.flat": file,
        "cameras.0.sensor.psf": {"kind": "table", "path": file},
        "cameras.0.sensor": {"transmission": file},
        "cameras.0.background.stray_light": {"earth_albedo": file},
    }
    for field, value in hidden.items():
        with pytest.raises(NotAllowed, match="no axis goes through files"):
            accept_study(_study(axes=[{"field": field, "values": [0.5, value]}]), settings)
        together = {"kind": "table", "fields": ["step_s", field], "rows": [[60.0, value]]}
        with pytest.raises(NotAllowed, match=r"axes\.0: .* no axis goes through files"):
            accept_study(_study(axes=[together]), settings)
    free = {"field": "cameras.0.sensor.quantum_efficiency", "values": [0.5, 0.9]}
    assert accept_study(_study(axes=[free]), settings)["axes"]


def test_a_study_is_forecast_within_what_a_job_may_take() -> None:
    """The least that objects x steps take may be within the limit, and the forecast not."""
    order: dict[str, Any] = {"do": "forecast", "scene": _study(), "most_cpu_s": 100.0}
    told = ORDERS["forecast"](order, lambda _: None)["forecast"]
    assert 1e-4 < told["cpu_s"] < 100.0
    with pytest.raises(BadInput, match=r"of one core.*shorten it$"):
        ORDERS["forecast"](order | {"most_cpu_s": 0.9 * told["cpu_s"]}, lambda _: None)
