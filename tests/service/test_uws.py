"""The UWS face by pyvo's unmodified job client, and its XML against the order of the standard."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime, timedelta
from io import BytesIO
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from pyvo.dal import AsyncTAPJob, DALQueryError, DALServiceError
from pyvo.dal.tap import TAPService

from pipeline.spec.load import parse_scene, scene_yaml
from service.standards.uws import _amends

UWS = "{http://www.ivoa.net/xml/UWS/v1.0}"
XLINK = "{http://www.w3.org/1999/xlink}"
NIL = "{http://www.w3.org/2001/XMLSchema-instance}nil"
# UWS 1.1, appendix A.2: the sequence of a job's elements; nillable ones may be empty
ORDER = (
    "jobId", "runId", "ownerId", "phase", "quote", "creationTime", "startTime", "endTime",
    "executionDuration", "destruction", "parameters", "results", "errorSummary", "jobInfo",
)  # fmt: skip
OPTIONAL = {"runId", "quote", "creationTime", "parameters", "errorSummary", "jobInfo"}
NILLABLE = {"ownerId", "quote", "startTime", "endTime", "destruction"}


@pytest.fixture
def base(server: Any) -> str:
    return f"{server.url}/uws"


def test_pyvo_creates_runs_waits_fetches_deletes(
    server: Any, base: str, scene: dict[str, Any]
) -> None:
    job = AsyncTAPJob.create(base, "", SCENE=json.dumps(scene), RUNID="mine")
    assert (job.phase, job.uws_version) == ("PENDING", "1.1")
    assert job.job.runid == "mine"
    assert job.job.creationtime.to_datetime().year >= 2026
    later = datetime.now(UTC).replace(microsecond=0) + timedelta(days=2)
    job.destruction = later
    assert job.destruction.to_datetime(timezone=UTC) == later
    job.execution_duration = 600
    assert job.execution_duration.sec == 600
    scene["seed"] = 8
    job.query = scene_yaml(parse_scene(scene))
    job.run().wait(timeout=60)
    assert job.phase == "COMPLETED"
    told = job.job
    assert told.starttime <= told.endtime
    assert {r.id_ for r in told.results} >= {"result", "product", "cube", "report"}
    links = job.fetch_result().to_table()
    by = {str(row["description"]): str(row["access_url"]) for row in links}
    assert server.client.get(by["frame 1 as FITS, with WCS"]).content.startswith(b"SIMPLE")
    assert server.client.get(by["report.json"]).json()["complete"]
    v1 = f"/v1/jobs/{job.job_id}"
    assert server.client.get(f"{v1}/scene").json()["seed"] == 8
    places = {r.id_: r.href for r in told.results}
    assert server.client.get(places["product"]).status_code == 200
    assert server.client.get(f"/uws/async/{job.job_id}/results/report").status_code == 303
    job.delete()
    assert server.client.get(v1).status_code == 404


def test_pyvo_aborts_and_lists(server: Any, base: str, scene: dict[str, Any]) -> None:
    scene["sensor"]["shape"], scene["exposure"]["frames"] = [640, 640], 50
    scene["name"] = "to-abort"
    job = AsyncTAPJob.create(base, json.dumps(scene), PHASE="RUN")
    server.until(f"/v1/jobs/{job.job_id}", lambda found: found["phase"] == "EXECUTING")
    job.abort()
    server.ended(f"/v1/jobs/{job.job_id}")
    with pytest.raises(DALServiceError, match="not active"):  # so says pyvo of an aborted one
        job.wait(timeout=60)
    assert job.phase == "ABORTED"
    with pytest.raises(DALQueryError):
        job.raise_if_error()
    with pytest.raises(DALServiceError):
        job.run()
    service = TAPService(base)
    assert job.job_id in [j.jobid for j in service.get_job_list(phases=["ABORTED"])]
    assert [j.jobid for j in service.get_job_list(last=1)] == [job.job_id]
    assert service.get_job_list(after=datetime.now(UTC) + timedelta(hours=1)) == []
    with AsyncTAPJob(job.url):
        pass  # leaving it deletes
    assert job.job_id not in [j.jobid for j in service.get_job_list()]


def test_the_xml_is_in_the_order_of_the_schema(
    server: Any, finished: str, scene: dict[str, Any]
) -> None:
    scene["stars"] = {"catalogue": "damaged"}
    folder = server.home / "catalogues" / "damaged"
    folder.mkdir(exist_ok=True)
    (folder / "nightglass.json").write_text("{}")
    failed = server.submit(scene)
    assert server.ended(failed)["phase"] == "ERROR"
    for path in (finished, failed):
        job_id = path.rpartition("/")[2]
        root = ET.fromstring(server.client.get(f"/uws/async/{job_id}").content)
        assert (root.tag, root.get("version")) == (f"{UWS}job", "1.1")
        names = [child.tag.removeprefix(UWS) for child in root]
        assert names == [n for n in ORDER if n in names]
        assert set(ORDER) - set(names) <= OPTIONAL
        for child in root:
            name = child.tag.removeprefix(UWS)
            if child.get(NIL):
                assert name in NILLABLE
                assert not child.text
        limit = root.findtext(f"{UWS}executionDuration", "")
        assert int(server.client.get(f"/uws/async/{job_id}/executionduration").text) == int(limit)
        for result in root.iterfind(f"{UWS}results/{UWS}result"):
            assert result.get("id")
            assert result.get(f"{XLINK}href", "").startswith(server.url)
        for part in ("phase", "owner", "destruction", "executionduration", "quote", "error"):
            assert server.client.get(f"/uws/async/{job_id}/{part}").status_code == 200
    error = root.find(f"{UWS}errorSummary")
    assert error is not None
    assert (error.get("type"), error.get("hasDetail")) == ("fatal", "true")
    told = server.client.get(f"/uws/async/{job_id}/error").text
    assert told.startswith(error.findtext(f"{UWS}message", "-"))
    jobs = ET.fromstring(server.client.get("/uws/async").content)
    assert [c.tag.removeprefix(UWS) for c in jobs[0]] == ["phase", "ownerId", "creationTime"]


def test_results_are_a_datalink_table(server: Any, finished: str) -> None:
    from astropy.io.votable import parse, validate

    job_id = finished.rpartition("/")[2]
    answer = server.client.get(f"/uws/async/{job_id}/results/result")
    assert validate(BytesIO(answer.content), output=None, xmllint=False)
    table = parse(BytesIO(answer.content)).get_first_table().to_table()
    here = f"{server.url}/v1/jobs/{job_id}/"
    known = {
        "product.tar": ("#this", "application/x-tar"),
        "results/cube.zarr": ("#this", "application/vnd.zarr"),
        "preview.png": ("#preview", "image/png"),
        "results/plan.json": ("#auxiliary", "application/json"),
        "frames/0/fits": ("#derivation", "application/fits"),
        "frames/1/fits": ("#derivation", "application/fits"),
    }
    rows = {str(row["access_url"]).removeprefix(here): row for row in table}
    for place, told in known.items():
        found = rows.pop(place)
        assert (str(found["semantics"]), str(found["content_type"])) == told
        assert str(found["ID"]) == job_id
        if not place.endswith(".zarr"):  # a folder
            answer = server.client.get(here + place)
            assert (answer.status_code, answer.headers["content-type"]) == (200, told[1])
    assert {str(row["semantics"]) for row in rows.values()} == {"#auxiliary"}
    for place, row in rows.items():
        assert len(server.client.get(here + place).content) == row["content_length"]


@pytest.mark.parametrize(
    ("path", "form", "status", "said"),
    [
        ("", {}, 422, "SCENE"),
        ("", {"SCENE": "{"}, 400, "not JSON"),
        ("", {"SCENE": "{}"}, 422, "mistake"),
        ("", {"SCENE": "a: [1\nb: 2"}, 400, "line 2"),
        ("", {"SCENE": "SCENE", "PHASE": "FLY"}, 422, "RUN"),
        ("", {"SCENE": "SCENE", "COLOR": "red"}, 422, "COLOR"),
        ("", {"SCENE": "SCENE", "DESTRUCTION": "soon"}, 422, "UTC"),
        ("", {"SCENE": "SCENE", "EXECUTIONDURATION": "-5"}, 422, "whole number"),
        ("", {"SCENE": "SCENE", "RUNID": "x" * 200}, 422, "128"),
        ("/JOB/phase", {"PHASE": "HOLD"}, 422, "RUN or ABORT"),
        ("/JOB/phase", {"PHASE": "RUN"}, 409, "cannot be run again"),
        ("/JOB/parameters", {"SCENE": "SCENE"}, 409, "no longer"),
        ("/JOB/owner", {"OWNER": "me"}, 404, "can be changed"),
        ("/nojob/phase", {"PHASE": "RUN"}, 404, "no such job"),
    ],
    ids=lambda value: None,
)
def test_mistakes(
    server: Any, finished: str, scene: dict[str, Any], path: str, form: dict[str, str],
    status: int, said: str,
) -> None:  # fmt: skip
    form = {k: json.dumps(scene) if v == "SCENE" else v for k, v in form.items()}
    where = "/uws/async" + path.replace("JOB", finished.rpartition("/")[2])
    answer = server.client.post(where, data=form)
    assert (answer.status_code, said in answer.text) == (status, True), answer.text


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ("0001-01-01T00:00:00Z", "0001-01-01T00:00:00.000Z"),
        ("9999-12-31T23:59:59Z", "9999-12-31T23:59:59.000Z"),
        ("9999-12-31T23:59:59+14:00", "9999-12-31T09:59:59.000Z"),
        ("0001-01-01T00:00:00+14:00", None),
        ("9999-12-31T23:59:59-14:00", None),
        ("9999-12-31T23:59:59.999999", None),
    ],
)
def test_a_destruction_that_is_taken_is_told(
    server: Any, scene: dict[str, Any], asked: str, told: str | None
) -> None:
    """UTC of four-digit years; a time outside of them is refused, and the job is as it was."""
    made = server.client.post("/uws/async", data={"SCENE": json.dumps(scene)})
    here = made.headers["location"]
    before = ET.fromstring(server.client.get(here).content).findtext(f"{UWS}destruction")
    answer = server.client.post(f"{here}/destruction", data={"DESTRUCTION": asked})
    assert answer.status_code == (422 if told is None else 303), answer.text
    if told is None:
        assert answer.json()["errors"][0]["pointer"] == "?DESTRUCTION"
    elif told.startswith("0001"):  # it is removed at once
        return
    page = server.client.get(here)
    assert page.status_code == 200
    assert ET.fromstring(page.content).findtext(f"{UWS}destruction") == (told or before)


@pytest.mark.parametrize("query", ["WAIT=soon", "WAIT=-7", "PHASE=ODD&WAIT=1"])
def test_mistakes_in_queries(server: Any, finished: str, query: str) -> None:
    job_id = finished.rpartition("/")[2]
    assert server.client.get(f"/uws/async/{job_id}?{query}").status_code == 422
    assert server.client.get(f"/uws/async/{job_id}?WAIT=-1").status_code == 200
    assert server.client.get(f"/uws/async/{job_id}?WAIT=1{'0' * 400}").status_code == 200
    assert server.client.get("/uws/async?LAST=0").status_code == 422
    assert server.client.get("/uws/async?AFTER=x").status_code == 422
    answer = server.client.post("/uws/async", files={"SCENE": b"{}"})
    assert answer.status_code == 415


def test_listings_are_chosen_by_phase_time_and_count(server: Any, scene: dict[str, Any]) -> None:
    """UWS 1.1, section 2.2.2.1: AFTER is later than all of them, LAST are the newest, in order."""
    form, made = {"SCENE": json.dumps(scene)}, []
    for _ in range(3):
        made.append(server.client.post("/uws/async", data=form).headers["location"])
        time.sleep(0.02)

    def listed(query: str) -> list[int]:
        root = ET.fromstring(server.client.get(f"/uws/async?{query}").content)
        found = [child.get(f"{XLINK}href", "").rpartition("/")[2] for child in root]
        ids = [path.rpartition("/")[2] for path in made]
        return [ids.index(one) for one in found if one in ids]

    told = [ET.fromstring(server.client.get(path).content) for path in made]
    created = [root.findtext(f"{UWS}creationTime", "") for root in told]
    between = [
        (datetime.fromisoformat(t) + timedelta(seconds=0.01)).isoformat().replace("+00:00", "Z")
        for t in created
    ]
    assert listed("PHASE=PENDING") == [0, 1, 2]
    assert listed("PHASE=COMPLETED") == []
    assert listed("LAST=2") == listed("LAST=9&LAST=2") == listed("LAST=2&LAST=9") == [1, 2]
    assert set(listed("LAST=999999999")) == {0, 1, 2}
    assert listed(f"AFTER={between[0]}") == [1, 2]
    assert listed(f"AFTER={between[1]}&AFTER={between[0]}") == [2]
    for path in made:
        server.client.delete(path)


@pytest.mark.parametrize(("text", "seconds"), [("0", None), ("1", 1.0), ("86400", 86400.0)])
def test_no_duration_is_no_limit(text: str, seconds: float | None) -> None:
    """UWS: 0 leaves the duration open, it ends no job at once."""
    assert _amends({"EXECUTIONDURATION": text}) == {"duration_s": seconds}
