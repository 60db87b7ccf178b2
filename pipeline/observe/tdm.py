"""What is seen, as a CCSDS Tracking Data Message: right ascension, declination and magnitude."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from pipeline.errors import BadInput
from pipeline.observe.observe import Observed

HEAD = """CCSDS_TDM_VERS = 2.0
COMMENT Angles are astrometric, as a plate solution against catalogue stars gives them.
COMMENT MAG is V (Vega) above the air.
CREATION_DATE = {date}
ORIGINATOR = NIGHTGLASS
"""
META = """META_START
COMMENT {target} is {object}
TIME_SYSTEM = UTC
START_TIME = {start}
STOP_TIME = {stop}
PARTICIPANT_1 = {sensor}
PARTICIPANT_2 = {target}
MODE = SEQUENTIAL
PATH = 2,1
ANGLE_TYPE = RADEC
REFERENCE_FRAME = ICRF
META_STOP
"""


def tdm_text(observed: Observed) -> str:
    """The rows that are seen, a segment for each target (CCSDS 503.0-B-2, 2020, KVN).

    With `ra_measured_deg` in the table its angles carry a centroid's noise, else none. The date of
    creation is that of the last row: the same scene gives the same file. BadInput where nothing is
    seen.
    """
    rows = [row for row in observed.table.to_pylist() if row["seen"] == "yes"]
    if not rows:
        raise BadInput("-o", "no target that is seen", f"a TDM of one; here {observed.counts()}")
    by_name: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_name.setdefault(row["name"], []).append(row)
    head = HEAD.format(date=_time(rows[-1]))
    return head + "".join(_segment(observed.scene, name, of) for name, of in by_name.items())


def _segment(sensor: str, name: str, rows: list[dict[str, Any]]) -> str:
    start, stop, known = _time(rows[0]), _time(rows[-1]), _plain(rows[0]["object_name"])
    meta = META.format(start=start, stop=stop, sensor=sensor, target=name, object=known)
    lines = [line for row in rows for line in _lines(row)]
    return "\n".join([meta + "DATA_START", *_noise(rows), *lines, "DATA_STOP", ""])


def _noise(rows: list[dict[str, Any]]) -> list[str]:
    """What noise the angles carry: comments stand before the data alone."""
    sigma = [row["centroid_sigma_arcsec"] for row in rows if "centroid_sigma_arcsec" in row]
    if not sigma:
        return ["COMMENT Angles without noise"]
    return [f"COMMENT Noise of centroids added, sigma {min(sigma):.4g} to {max(sigma):.4g} arcsec"]


def _lines(row: dict[str, Any]) -> Iterator[str]:
    at = _time(row)
    yield f"ANGLE_1 = {at} {row.get('ra_measured_deg', row['ra_deg']):.9f}"
    yield f"ANGLE_2 = {at} {row.get('dec_measured_deg', row['dec_deg']):.9f}"
    yield f"MAG = {at} {row['v_mag']:.4f}"


def _time(row: dict[str, Any]) -> str:
    return str(row["utc"]).rstrip("Z")


def _plain(name: str) -> str:
    """A name of the plain characters that a message may hold."""
    return re.sub(r"[^ -~]", "?", name)
