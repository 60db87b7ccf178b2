"""What is seen, as a file: Parquet, CSV, JSON, or CCSDS TDM, by the file's ending."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from catalog_tools.documents import JsonObject
from catalog_tools.storage.durable import MAKE_ROOM, full_disk_told, whole_file
from pipeline.errors import BadInput
from pipeline.observe.observe import Observed
from pipeline.store.result_files import check_ending, without_nan

ENDINGS = (".parquet", ".csv", ".json", ".tdm")
HEAD = """CCSDS_TDM_VERS = 2.0
COMMENT Angles are astrometric, as a plate solution against catalogue stars gives them.
COMMENT MAG is V (Vega) above the air.
CREATION_DATE = {date}
ORIGINATOR = NIGHTGLASS
"""
META = """META_START
COMMENT {name} is {object}
TIME_SYSTEM = UTC
START_TIME = {start}
STOP_TIME = {stop}
PARTICIPANT_1 = {sensor}
PARTICIPANT_2 = {name}
MODE = SEQUENTIAL
PATH = 2,1
ANGLE_TYPE = RADEC
REFERENCE_FRAME = ICRF
META_STOP
DATA_START
COMMENT Angles {noise}
"""


def write(observed: Observed, path: Path) -> None:
    """Write all rows, as TDM those that are seen; whole or not at all."""
    check_ending(path, ENDINGS)
    ending = path.suffix.lower()
    try:
        with full_disk_told(path, MAKE_ROOM), whole_file(path) as own:
            if ending == ".parquet":
                notes = {"scene": observed.scene, "notes": json.dumps(observed.notes)}
                pq.write_table(observed.table.replace_schema_metadata(notes), own)
            elif ending == ".csv":
                pyarrow.csv.write_csv(without_nan(observed.table), own)
            elif ending == ".json":
                own.write_text(json.dumps(as_data(observed), allow_nan=False), encoding="utf-8")
            else:
                own.write_text(tdm_text(observed), encoding="utf-8")
    except OSError as error:
        why = error.strerror or str(error)
        raise BadInput("-o", str(path), f"a file that can be written; {why}") from None


def as_data(observed: Observed) -> JsonObject:
    """Plain data: scene, counts by reason, notes, rows (null where there is no value)."""
    rows = without_nan(observed.table).to_pylist()
    notes = list(observed.notes)
    return {"scene": observed.scene, "counts": observed.counts(), "notes": notes, "rows": rows}


def tdm_text(observed: Observed) -> str:
    """The rows that are seen, a segment for each target (CCSDS 503.0-B-2, 2020, KVN).

    With `ra_measured_deg` in the table its angles carry a centroid's noise, else none. The date of
    creation is that of the last row: the same scene gives the same file. BadInput where nothing is
    seen.
    """
    table = observed.table.filter(pc.equal(observed.table["seen"], "yes"))
    rows = sorted(table.to_pylist(), key=lambda row: str(row["name"]))  # each by time
    if not rows:
        raise BadInput("-o", "no target that is seen", f"a TDM of one; here {observed.counts()}")
    segments = (list(of) for _, of in groupby(rows, key=lambda row: row["name"]))
    head = HEAD.format(date=max(map(_time, rows)))
    return head + "".join("\n".join(_segment(observed.scene, of)) for of in segments)


def _segment(sensor: str, rows: list[JsonObject]) -> Iterator[str]:
    first, noise = rows[0], "without noise"
    if "ra_measured_deg" in first:
        sigma = [row["centroid_sigma_arcsec"] for row in rows]
        noise = f"with the noise of centroids, sigma {min(sigma):.4g} to {max(sigma):.4g} arcsec"
    known = re.sub(r"[^ -~]", "?", first["object_name"])  # plain characters alone
    names = {"name": first["name"], "object": known, "sensor": sensor, "noise": noise}
    yield META.format(start=_time(first), stop=_time(rows[-1]), **names).rstrip()
    for row in rows:
        ra, dec = (row.get(f"{n}_measured_deg", row[f"{n}_deg"]) for n in ("ra", "dec"))
        for key, value in (("ANGLE_1", f"{ra:.9f}"), ("ANGLE_2", f"{dec:.9f}")):
            yield f"{key} = {_time(row)} {value}"
        if math.isfinite(row["v_mag"]):
            yield f"MAG = {_time(row)} {row['v_mag']:.4f}"
    yield "DATA_STOP\n"


def _time(row: JsonObject) -> str:
    return str(row["utc"]).rstrip("Z")
