"""UWS documents of every kind of job against the form that UWS 1.1 gives them (appendix A)."""

from __future__ import annotations

import asyncio
import os
import time
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree
from starlette.requests import Request

from service.jobs.jobs import Job, Phase
from service.problems import Malformed
from service.standards import uws
from service.standards.uws import _time
from service.standards.uws_xml import job_xml, jobs_xml, parameters_xml, result_names, results_xml

# The form in RELAX NG, in this project's own words, after the standard's XML Schema
# (1.1-REC-20161024); UWS_XSD names a copy of that one, where the documents are to be held
# against it too.
MAY_BE_NIL = """
  <define name="{0}"><element name="{0}">
    <choice><attribute name="xsi:nil"><value>true</value></attribute>{1}</choice>
  </element></define>"""
FORM = """
<grammar xmlns="http://relaxng.org/ns/structure/1.0" ns="http://www.ivoa.net/xml/UWS/v1.0"
    xmlns:xlink="http://www.w3.org/1999/xlink"
    xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
    datatypeLibrary="http://www.w3.org/2001/XMLSchema-datatypes">
  <start><choice>
    <element name="job"><ref name="version"/>
      <element name="jobId"><data type="string"/></element>
      <optional><element name="runId"><data type="string"/></element></optional>
      <ref name="ownerId"/><ref name="phase"/><optional><ref name="quote"/></optional>
      <ref name="creationTime"/><ref name="startTime"/><ref name="endTime"/>
      <element name="executionDuration"><data type="int"/></element>
      <ref name="destruction"/><optional><ref name="parameters"/></optional><ref name="results"/>
      <optional><element name="errorSummary">
        <attribute name="type" ns=""><choice><value>transient</value><value>fatal</value></choice>
        </attribute>
        <attribute name="hasDetail" ns=""><data type="boolean"/></attribute>
        <element name="message"><data type="string"/></element>
      </element></optional>
      <optional><element name="jobInfo"><zeroOrMore><element><anyName/><text/></element>
      </zeroOrMore></element></optional>
    </element>
    <element name="jobs"><ref name="version"/><zeroOrMore><element name="jobref">
      <attribute name="id" ns=""><data type="string"/></attribute><ref name="reference"/>
      <ref name="phase"/>
      <optional><element name="runId"><data type="string"/></element></optional>
      <optional><ref name="ownerId"/></optional><ref name="creationTime"/>
    </element></zeroOrMore></element>
    <ref name="parameters"/><ref name="results"/>
  </choice></start>
  <define name="version"><attribute name="version" ns=""><value>1.1</value></attribute></define>
  <define name="phase"><element name="phase"><choice>PHASES</choice></element></define>
  <define name="creationTime"><element name="creationTime"><data type="dateTime"/></element>
  </define>
  <define name="reference">
    <optional><attribute name="xlink:type"><value>simple</value></attribute></optional>
    <optional><attribute name="xlink:href"><data type="anyURI"/></attribute></optional>
  </define>
  <define name="results"><element name="results"><zeroOrMore><element name="result">
    <attribute name="id" ns=""><data type="string"/></attribute><ref name="reference"/>
    <optional><attribute name="size" ns=""><data type="long"/></attribute></optional>
    <optional><attribute name="mime-type" ns=""><data type="string"/></attribute></optional>
  </element></zeroOrMore></element></define>
  <define name="parameters"><element name="parameters"><zeroOrMore><element name="parameter">
    <attribute name="id" ns=""><data type="string"/></attribute>
    <optional><attribute name="byReference" ns=""><data type="boolean"/></attribute></optional>
    <text/>
  </element></zeroOrMore></element></define>
  NILS
</grammar>"""
PHASES = "".join(f"<value>{p}</value>" for p in (
    "PENDING", "QUEUED", "EXECUTING", "COMPLETED", "ERROR", "UNKNOWN", "HELD", "SUSPENDED",
    "ABORTED", "ARCHIVED",
))  # fmt: skip
TIME, TEXT = '<data type="dateTime"/>', '<data type="string"/>'
NILS = MAY_BE_NIL.format("ownerId", TEXT) + "".join(
    MAY_BE_NIL.format(name, TIME) for name in ("quote", "startTime", "endTime", "destruction")
)
times = st.none() | st.floats(-6e10, 2.5e11)
anything = st.text(max_size=20)
jobs = st.builds(
    Job, number=st.just(1), id=st.just("a" * 32), team=anything, owner=anything,
    kind=st.sampled_from(["scene", "sweep"]), name=anything, run_id=st.none() | anything,
    phase=st.sampled_from(Phase), pixel_frames=st.just(1), bytes_kept=st.just(0),
    submitted_s=st.floats(0, 2.5e11), started_s=times, ended_s=times, destruction_s=times,
    duration_s=st.none() | st.floats(0, 999_999_999), tiles_done=st.none() | st.integers(0, 9),
    tiles_total=st.none() | st.integers(0, 9), attempt=st.just(1), deaths=st.just(0),
    cancel_asked=st.booleans(), deleted=st.just(False), content_digest=st.none(),
    version=st.just(1), error=st.none() | st.fixed_dictionaries({
        "kind": st.sampled_from(["fault", "bad input", "disk full"]), "message": anything}),
)  # fmt: skip


@pytest.fixture(scope="module")
def forms() -> list[Any]:
    """What a document must fit: our form of it, and the standard's own where there is a copy."""
    text = FORM.replace("PHASES", PHASES).replace("NILS", NILS)
    found: list[Any] = [etree.RelaxNG(etree.fromstring(text))]
    if copy := os.environ.get("UWS_XSD"):
        found.append(etree.XMLSchema(etree.parse(copy)))
    return found


def fits(forms: list[Any], document: bytes) -> None:
    root = etree.fromstring(document)
    for form in forms:
        form.assertValid(root)


@settings(max_examples=60)
@given(found=st.lists(jobs, max_size=3), name=anything)
def test_every_document_fits(forms: list[Any], found: list[Job], name: str) -> None:
    base = "https://nightglass.example.org:8765"
    fits(forms, jobs_xml(found, f"{base}/uws/async"))
    for job in found:
        results = result_names(job, f"{base}/uws/async/{job.id}", base)
        fits(forms, job_xml(job, {"name": name}, results))
        fits(forms, results_xml(results))
        fits(forms, parameters_xml({"name": name}))


@pytest.mark.parametrize(
    ("was", "becomes"),
    [
        (b"<uws:phase>COMPLETED", b"<uws:phase>DONE"),
        (b"<uws:endTime>1970-01-01T00:00:02.000Z", b"<uws:endTime>soon"),
        (b"<uws:executionDuration>0</uws:executionDuration>", b""),
        (b'mime-type="application/json"', b'kind="application/json"'),
        (b'<uws:quote xsi:nil="true" />', b""),
    ],
    ids=["phase", "time", "missing", "attribute", "optional"],
)
def test_the_form_tells_wrong_from_right(forms: list[Any], was: bytes, becomes: bytes) -> None:
    plain: dict[str, Any] = dict.fromkeys(Job.__dataclass_fields__)
    job = Job(**plain | {
        "id": "b" * 32, "kind": "scene", "owner": "me", "phase": Phase.COMPLETED,
        "submitted_s": 0.0, "started_s": 1.0, "ended_s": 2.0,
    })  # fmt: skip
    document = job_xml(job, {}, result_names(job, "http://x/uws/async/b", "http://x"))
    fits(forms, document)
    assert was in document
    changed = document.replace(was, becomes)
    if was.startswith(b"<uws:quote"):
        fits(forms, changed)
        return
    with pytest.raises(etree.DocumentInvalid):
        fits(forms, changed)


def test_errors_and_tiles_are_told() -> None:
    """A fault may pass, a mistake in the scene does not; tiles that are drawn, and all."""
    plain: dict[str, Any] = dict.fromkeys(Job.__dataclass_fields__)
    for kind, passes in (("fault", "transient"), ("bad input", "fatal")):
        error = {"kind": kind, "message": "why", "errors": []}
        tiles = {"tiles_done": 3, "tiles_total": 8, "submitted_s": 1.0}
        job = Job(**plain | tiles | {"id": "b", "owner": "", "phase": Phase.ERROR, "error": error})
        root = etree.fromstring(job_xml(job, {}, []))
        assert root.find("{*}errorSummary").get("type") == passes
        assert [e.text for e in root.find("{*}jobInfo")] == ["3", "8"]


@pytest.mark.parametrize("frames", [3, 7, 8, 1000])
def test_no_more_frames_are_linked_than_a_table_should_hold(
    monkeypatch: pytest.MonkeyPatch, frames: int
) -> None:
    """The first ones of a long scene; each is there at its number."""
    plain: dict[str, Any] = dict.fromkeys(Job.__dataclass_fields__)
    job = Job(**plain | {"id": "b", "kind": "scene", "phase": Phase.COMPLETED})
    monkeypatch.setattr(uws, "MOST_LINKS", 7)
    monkeypatch.setattr(uws, "complete_product", lambda *_: Path("product"))
    monkeypatch.setattr(uws, "list_files", lambda _: [("plan.json", 9)])
    monkeypatch.setattr(uws.frames, "describe", lambda _: {"frames": frames})
    service = SimpleNamespace(store=SimpleNamespace(get=lambda _: job))
    here = {"server": ("here", 80), "scheme": "http", "path": "/", "query_string": b""}
    request = Request({"type": "http", "method": "GET", "headers": []} | here)
    answer = uws.result(request, service, "b", "result")  # type: ignore[arg-type]
    cells = [cell.text for cell in etree.fromstring(answer.body).iter("{*}TD")]
    linked = [text for text in cells if text and text.startswith("http://here/v1/jobs/b/frames/")]
    assert linked == [f"http://here/v1/jobs/b/frames/{k}/fits" for k in range(min(frames, 7))]


def test_a_time_without_a_zone_is_in_utc(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever the server stands."""
    monkeypatch.setenv("TZ", "XYZ-9")
    time.tzset()
    try:
        noon = datetime(2026, 1, 31, 12, tzinfo=UTC).timestamp()
        for text in ("2026-01-31T12:00:00", "2026-01-31T12:00:00Z", "2026-01-31T13:00:00+01:00"):
            assert _time(text, "AFTER") == noon
    finally:
        monkeypatch.undo()
        time.tzset()


def fields_of(body: bytes) -> dict[str, str]:
    """What a form with this body says."""

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": body}

    kind = [(b"content-type", b"application/x-www-form-urlencoded")]
    request = Request({"type": "http", "method": "POST", "headers": kind}, receive)
    limits = SimpleNamespace(settings=SimpleNamespace(body_bytes=1000, body_s=1.0))
    return asyncio.run(uws._fields(request, limits))  # type: ignore[arg-type]


def test_fields_of_a_form_have_names_in_capitals_and_may_be_empty() -> None:
    assert fields_of(b"") == {}
    assert fields_of(b"RunId=a%20b&phase=") == {"RUNID": "a b", "PHASE": ""}


@pytest.mark.parametrize("body", [b"RUNID=a&runid=b", b"RUNID", b"RUNID=%ff", b"RUNID=\xff"])
def test_a_body_that_is_no_form_is_refused_whole(body: bytes) -> None:
    """A field given twice, without a value, or not in UTF-8."""
    with pytest.raises(Malformed):
        fields_of(body)
