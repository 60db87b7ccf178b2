"""The task of a study: which objects a sensor could observe in a window, with what probability."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from catalog_tools.storage.durable import whole_file
from pipeline.capacity.course import BATCH, StudyCourse, moments
from pipeline.capacity.fields import field_rad
from pipeline.capacity.patterns import pattern_sights
from pipeline.physics.detection import detection_probability
from pipeline.physics.positions.orbit_screen import WHOLE, states_together
from pipeline.physics.positions.orbit_sgp4 import since_epochs_s
from pipeline.physics.positions.regard import may_be_seen
from pipeline.physics.vectors import unit
from pipeline.spec.study import CuedTasking
from pipeline.survey.elements import Elements
from pipeline.survey.prune import never_seen
from pipeline.survey.sights import Sights, sights_of
from pipeline.survey.watch import MOST_LIFT_RAD, Watcher, WatchMoments

SCHEMA = pa.schema(
    [("time_s", pa.float64()), ("step", pa.int32()), ("sensor", pa.int16()), ("unit", pa.int16())]
    + [("object", pa.int32()), ("frames", pa.int32())]
    + [(n, pa.float32()) for n in ("x", "y", "z", "elevation_deg", "range_km", "rate_arcsec_s")]
    + [(n, pa.float32()) for n in ("phase_deg", "v_mag", "streak_px", "sky_e_s_px", "snr")]
    + [("probability", pa.float32())]
)
ENDED = b"ended"
LEAST_RATE = 1e-12  # against the stars [rad/s]: none leaves a field so slowly
OPTIONS: dict[str, Any] = {
    "compression": "zstd",
    "compression_level": 1,
    "write_page_checksum": True,
}
Item = tuple[int, int]


def path_of(out: str | Path, item: Item) -> Path:
    """The file of a task."""
    return Path(out) / "parts" / f"window-{item[0]:06d}-batch-{item[1]:05d}.parquet"


def find_candidates(course: StudyCourse, item: Item) -> int:
    """Write the candidates of a window and a batch, with the numbers of objects whose SGP4 ends;
    how many there are."""
    window, batch = item
    elements = course.elements.take(slice(batch * BATCH, (batch + 1) * BATCH))
    watches = moments(course, window)
    wanted = np.stack(
        [
            ~never_seen(w, watch, elements, course.least_snr)
            for w, watch in zip(course.watchers, watches, strict=True)
        ]
    )
    some = np.flatnonzero(wanted.any(axis=0))
    tables: list[pa.Table] = []
    failed: list[int] = []
    if len(some):
        satellites = elements.take(some).satellites()
        since, at = since_epochs_s(satellites, course.watchers[0].epoch), watches[0].offset_s
        place, speed, codes = states_together(satellites, since, at)
        failed = (some[(codes != WHOLE).any(axis=1)] + batch * BATCH).tolist()
        tables = [
            _of_sensor(course, window, j, elements, some, (place, speed, codes), wanted[j, some])
            for j in range(len(course.watchers))
        ]
    table = pa.concat_tables([SCHEMA.empty_table(), *tables])
    base = pa.array(np.asarray(table["object"]) + batch * BATCH, pa.int32())
    table = table.set_column(SCHEMA.get_field_index("object"), SCHEMA.field("object"), base)
    table = table.replace_schema_metadata({ENDED: json.dumps(failed)})
    with whole_file(path_of(course.out, item)) as own:
        pq.write_table(table, own, **OPTIONS)
    return int(table.num_rows)


def _of_sensor(
    course: StudyCourse,
    window: int,
    sensor: int,
    elements: Elements,
    some: NDArray[np.int64],
    states: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]],
    wanted: NDArray[np.bool_],
) -> pa.Table:
    """The candidates of one sensor among objects `some`, whose states (TEME) are given."""
    watcher, watch = course.watchers[sensor], moments(course, window)[sensor]
    place, speed, codes = states
    cued = isinstance(course.study.tasking, CuedTasking)
    half_s = 0.0 if cued else 0.5 * course.study.step_s
    works = watch.works.copy()
    works[-1] &= not cued  # the moment after the window is the next one's
    near = may_be_seen(
        place, speed, watch.observer_m, watch.motion_m_s, watch.up, watch.lowest - MOST_LIFT_RAD,
        watch.turn_rad_s, works, unit(watch.sun_m), half_s, cued and bool(elements.shaded.all()),
    )  # fmt: skip
    near &= (codes == WHOLE) & wanted[:, None]
    if not cued:
        found = pattern_sights(course, window, sensor, elements, some, (place, speed), near)
        return pa.concat_tables(
            [SCHEMA.empty_table(), *(_table(course, sensor, *f) for f in found)]
        )
    i, k = np.nonzero(near)
    who = some[i]
    s = sights_of(
        watcher, watch, k, who, place[i, k], speed[i, k], elements.reflecting_m2[who],
        elements.shaded[who],
    )  # fmt: skip
    s = s.take(s.snr >= course.least_snr)
    return _table(course, sensor, watch, s, _frames(watcher, s), np.full(len(s), -1))


def _frames(watcher: Watcher, s: Sights) -> NDArray[np.int64]:
    """Frames (r,) of a dwell that have their object: without tracking those whose middle comes
    before it has gone from the field's middle by half the shorter side."""
    e = watcher.resolved.scene.exposure
    if watcher.tracks:
        return np.full(len(s), e.frames)
    stays_s = 0.5 * min(field_rad(watcher)) / np.maximum(s.rate, LEAST_RATE)
    inside = 1.0 + np.floor((stays_s - 0.5 * e.integration_s) / e.step_s)
    return np.clip(inside, 0, e.frames).astype(np.int64)


def _table(
    course: StudyCourse,
    sensor: int,
    watch: WatchMoments,
    s: Sights,
    frames: NDArray[np.int64],
    unit_: NDArray[np.int64],
) -> pa.Table:
    """Rows of sights whose chance of detection is not below the least."""
    needed = course.study.detection.frames_needed
    chance = detection_probability(s.snr, course.threshold, frames, needed)
    kept = (s.light > 0.0) & (chance >= course.study.detection.least_probability)
    s, chance = s.take(kept), chance[kept]
    direction = np.einsum("nij,nj->ni", watch.to_gcrs[s.moment], s.observed)
    time_s = watch.offset_s[s.moment]
    columns = {
        "time_s": time_s,
        "step": np.floor(time_s / course.study.step_s + 1e-9),
        "sensor": np.full(len(s), sensor),
        "unit": unit_[kept],
        "object": s.object,
        "frames": frames[kept],
        **dict(zip("xyz", direction.T, strict=True)),
        "elevation_deg": np.degrees(s.elevation),
        "range_km": s.range_m / 1e3,
        "rate_arcsec_s": s.rate_arcsec_s,
        "phase_deg": np.degrees(s.phase),
        "v_mag": s.v_mag,
        "streak_px": s.streak_px,
        "sky_e_s_px": s.sky_e_s,
        "snr": s.snr,
        "probability": chance,
    }
    arrays = [pa.array(columns[f.name].astype(f.type.to_pandas_dtype()), f.type) for f in SCHEMA]
    return pa.table(arrays, schema=SCHEMA)
