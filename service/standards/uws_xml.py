"""Jobs as XML of IVOA UWS 1.1, and the files of a product as a DataLink table."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from datetime import UTC, datetime
from xml.etree import ElementTree as ET

from catalog_tools.documents import JsonObject
from service.jobs.jobs import Job, Phase

UWS, XLINK = "http://www.ivoa.net/xml/UWS/v1.0", "http://www.w3.org/1999/xlink"
XSI, VOTABLE = "http://www.w3.org/2001/XMLSchema-instance", "http://www.ivoa.net/xml/VOTable/v1.3"
for _prefix, _space in (("uws", UWS), ("xlink", XLINK), ("xsi", XSI)):
    ET.register_namespace(_prefix, _space)
LINK_FIELDS = (
    ("ID", "char", "meta.id;meta.main"),
    ("access_url", "char", "meta.ref.url"),
    ("service_def", "char", "meta.ref"),
    ("error_message", "char", "meta.code.error"),
    ("semantics", "char", "meta.code"),
    ("description", "char", "meta.note"),
    ("content_type", "char", "meta.code.mime"),
    ("content_length", "long", "phys.size;meta.file"),
)
# What XML 1.0 has no way to write: a document with one of them is none.
NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
Result = tuple[str, str, str]  # id, address, media type


def job_xml(job: Job, scene: JsonObject, results: Iterable[Result]) -> bytes:
    """A job with everything that UWS tells of one."""
    root = _element("job", version="1.1")
    _child(root, "jobId", job.id)
    if job.run_id is not None:
        _child(root, "runId", job.run_id)
    _child(root, "ownerId", job.owner)
    _child(root, "phase", job.phase.value)
    _child(root, "quote", None)
    _child(root, "creationTime", stamp(job.submitted_s))
    _child(root, "startTime", stamp(job.started_s))
    _child(root, "endTime", stamp(job.ended_s))
    _child(root, "executionDuration", str(round(job.duration_s or 0)))
    _child(root, "destruction", stamp(job.destruction_s))
    root.append(_parameters(scene))
    root.append(_results(results))
    if job.error is not None:
        kind = "transient" if job.error.get("kind") == "fault" else "fatal"
        error = _child(root, "errorSummary", "")
        error.attrib |= {"type": kind, "hasDetail": "true"}
        _child(error, "message", job.error["message"])
    if job.tiles_total is not None:
        info = _child(root, "jobInfo", "")
        _child(info, "tilesDone", str(job.tiles_done or 0))
        _child(info, "tilesTotal", str(job.tiles_total))
    return _bytes(root)


def jobs_xml(jobs: Iterable[Job], base: str) -> bytes:
    """A list of jobs; `base` is the address of /uws/async."""
    root = _element("jobs", version="1.1")
    for job in jobs:
        ref = _child(root, "jobref", "")
        ref.attrib |= {
            "id": job.id,
            f"{{{XLINK}}}type": "simple",
            f"{{{XLINK}}}href": f"{base}/{job.id}",
        }
        _child(ref, "phase", job.phase.value)
        if job.run_id is not None:
            _child(ref, "runId", job.run_id)
        _child(ref, "ownerId", job.owner)
        _child(ref, "creationTime", stamp(job.submitted_s))
    return _bytes(root)


def parameters_xml(scene: JsonObject) -> bytes:
    """The parameters of a job alone."""
    return _bytes(_parameters(scene))


def results_xml(results: Iterable[Result]) -> bytes:
    """The results of a job alone."""
    return _bytes(_results(results))


def stamp(seconds: float | None) -> str | None:
    """Unix seconds as UWS writes a time: ISO 8601 in UTC, with Z."""
    if seconds is None:
        return None
    text = datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
    return text.replace("+00:00", "Z")


def links_votable(links: Iterable[JsonObject]) -> bytes:
    """A DataLink 1.1 table: one row a file, with address, meaning, type and length in bytes."""
    root = ET.Element("VOTABLE", {"version": "1.4", "xmlns": VOTABLE})
    resource = ET.SubElement(root, "RESOURCE", {"type": "results"})
    ET.SubElement(resource, "INFO", {"name": "QUERY_STATUS", "value": "OK"})
    standard = {"name": "standardID", "value": "ivo://ivoa.net/std/DataLink#links-1.1"}
    ET.SubElement(resource, "INFO", standard)
    table = ET.SubElement(resource, "TABLE")
    for name, kind, ucd in LINK_FIELDS:
        field = {"name": name, "datatype": kind, "ucd": ucd}
        field |= {"arraysize": "*"} if kind == "char" else {"unit": "byte"}
        ET.SubElement(table, "FIELD", field)
    rows = ET.SubElement(ET.SubElement(table, "DATA"), "TABLEDATA")
    for link in links:
        row = ET.SubElement(rows, "TR")
        for name, _, _ in LINK_FIELDS:
            ET.SubElement(row, "TD").text = str(link.get(name, ""))
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)


def _parameters(scene: JsonObject) -> ET.Element:
    root = _element("parameters")
    _child(root, "parameter", json.dumps(scene)).set("id", "SCENE")
    return root


def _results(results: Iterable[Result]) -> ET.Element:
    root = _element("results")
    for name, address, kind in results:
        result = _child(root, "result", "")
        result.attrib |= {
            "id": name,
            "mime-type": kind,
            f"{{{XLINK}}}type": "simple",
            f"{{{XLINK}}}href": address,
        }
    return root


def _element(name: str, **attributes: str) -> ET.Element:
    return ET.Element(f"{{{UWS}}}{name}", attributes)


def _child(parent: ET.Element, name: str, text: str | None) -> ET.Element:
    """A child with text; None is absence as the schema has it: an empty element, xsi:nil."""
    child = ET.SubElement(parent, f"{{{UWS}}}{name}")
    if text is None:
        child.set(f"{{{XSI}}}nil", "true")
    elif text:
        child.text = NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)
    return child


def _bytes(root: ET.Element) -> bytes:
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)


def result_names(job: Job, here: str, base: str) -> list[Result]:
    """What a complete job offers; `here` is its own address in UWS, `base` the server's."""
    if job.phase != Phase.COMPLETED or job.kind != "scene":
        return []
    v1 = f"{base}/v1/jobs/{job.id}"
    return [
        ("result", f"{here}/results/result", "application/x-votable+xml;content=datalink"),
        ("product", f"{v1}/product.tar", "application/x-tar"),
        ("cube", f"{v1}/results/cube.zarr", "application/vnd.zarr"),
        ("preview", f"{v1}/preview.png", "image/png"),
        ("report", f"{v1}/report", "application/json"),
        ("plan", f"{v1}/plan", "application/json"),
    ]
