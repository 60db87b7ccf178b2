"""A study made ready: sensors resolved, elements read, impossible ones refused, cost foretold."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.capacity.fields import Round, axes_of_fields, round_of
from pipeline.errors import BadInput
from pipeline.physics.constants import DAY_S
from pipeline.physics.detection import snr_of, threshold_sigma
from pipeline.physics.positions.times import check_dates, parse_utc
from pipeline.physics.vectors import from_angles
from pipeline.plan.targets.orbit_age import sensor_remarks
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.study import CuedTasking, SearchPattern, Study
from pipeline.spec.study_load import parse_study
from pipeline.store.product import files_digest
from pipeline.survey.elements import (
    Census,
    Elements,
    fresh,
    gather_elements,
    joined,
    named_by,
    synthetic_elements,
)
from pipeline.survey.prune import itself
from pipeline.survey.sights import allowed
from pipeline.survey.watch import Watcher, WatchMoments, make_watcher

STEPS, BATCH = 360, 1024  # of a window; objects of a task
MOST_CPU_S = 24 * 3600.0
STATE_CPU_S, PAIR_CPU_S, TASK_CPU_S = 0.8e-6, 0.05e-6, 0.05  # of this machine, with room
SKY_CPU_S = 0.03  # of a table of the sky
DWELL_CPU_S, DWELL_BYTES, MOST_DWELLS = 0.2e-3, 350, 300_000  # of a search; in a window
KEPT_SENSORS = 16  # of which the dwells of a window are held
STRAY_CPU_S, STRAY_PAIR_CPU_S = 1.5e-3, 4e-6  # of stray light: a step of a batch, and of an object
CAMERA_KEYS = ("sensor", "exposure", "background")
LOOKS, LOOK_STEPS = 500, 200  # directions and moments at which a field of regard is tried
FEW_FIELDS = 16  # of a search that are tried first
MANY_STEPS = 20_000  # moments before a sensor is said to look at none
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # the step, of the period, that meets all hours of the day


@dataclass(frozen=True, eq=False)
class StudyCourse:
    """What every task of a study needs.

    watchers : one for each sensor; units : (u,) the sensor of each single one of them
    least_snr : of a frame, below which no dwell has the least probability; key : of all that the
    result follows from; idle : sensors that look nowhere in the period, and why; remarks : what is
    to be said of sensors in orbit
    """

    study: Study
    watchers: tuple[Watcher, ...]
    units: NDArray[np.int64]
    elements: Elements
    census: Census
    threshold: float
    key: str
    out: str = ""
    idle: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StudyCourse) and self.key == other.key

    @property
    def steps(self) -> int:
        return steps_of(self.study)

    @property
    def hours(self) -> float:
        return self.steps * self.study.step_s / 3600.0

    @property
    def windows(self) -> int:
        return math.ceil(self.steps / STEPS)

    @property
    def batches(self) -> int:
        return math.ceil(len(self.elements) / BATCH)

    @cached_property
    def least_snr(self) -> float:
        d = self.study.detection
        frames = max(camera.exposure.frames for camera in self.study.cameras)
        if d.least_probability == 0.0:
            return self.threshold - 8.0
        return snr_of(d.least_probability, self.threshold, frames, d.frames_needed)

    def offsets_s(self, window: int) -> NDArray[np.float64]:
        """The moments of a window [s], and the one after it."""
        last = min((window + 1) * STEPS, self.steps)
        return np.asarray(np.arange(window * STEPS, last + 1) * self.study.step_s, float)

    @property
    def forecast(self) -> JsonObject:
        """What the study takes: objects, steps, seconds of one core, MB of each worker; how many
        kinds of sensor look nowhere in the period."""
        states = len(self.elements) * self.steps
        cpu_s = states * (STATE_CPU_S + len(self.watchers) * PAIR_CPU_S)
        tasks = self.windows * self.batches
        rows = min(len(self.elements), BATCH) * STEPS
        skies = [w.sky for w in self.watchers if w.sky is not None]
        cpu_s += sum(SKY_CPU_S * self.hours * 3600.0 / sky.step_s for sky in skies)
        stray_s = self.steps * self.batches * STRAY_CPU_S + states * STRAY_PAIR_CPU_S
        cpu_s += stray_s * sum(sky.stray is not None for sky in skies)
        dwells_s = [one.dwells_s for one in self.rounds]
        cpu_s += DWELL_CPU_S * sum(dwells_s) * self.hours * 3600.0
        kept = sum(sorted(dwells_s)[-KEPT_SENSORS:]) * STEPS * self.study.step_s
        return {
            "objects": len(self.elements),
            "sensors": len(self.units),
            "idle_sensors": len(self.idle),
            "steps": self.steps,
            "tasks": tasks,
            "cpu_s": cpu_s + TASK_CPU_S * tasks * len(self.watchers),
            "worker_memory_mb": 250.0 + (rows * 250 + kept * DWELL_BYTES) / 1e6,
        }

    @cached_property
    def rounds(self) -> list[Round]:
        """How each single sensor goes through the fields of a search; none where it is cued.

        BadInput for more dwells in a window than may be held.
        """
        pattern, kinds = self.study.tasking, []
        if not isinstance(pattern, SearchPattern):
            return []
        for watcher, sensor in zip(self.watchers, self.study.sensors, strict=True):
            one = round_of(watcher, pattern, sensor.slewing)
            dwells = one.dwells_s * STEPS * self.study.step_s
            if dwells > MOST_DWELLS:
                told = f"{dwells:.2g} dwells of {watcher.name} in {STEPS} steps"
                allowed = f"at most {MOST_DWELLS}: a shorter step_s, or longer dwells"
                raise BadInput("step_s", told, allowed)
            kinds.append(one)
        return [kinds[j] for j in self.units]


@lru_cache(maxsize=2)
def moments(course: StudyCourse, window: int) -> tuple[WatchMoments, ...]:
    """All sensors at the moments of a window: kept in each process while its batches are done."""
    return tuple(w.watch(course.offsets_s(window)) for w in course.watchers)


def make_course(data: JsonObject, out: Path) -> StudyCourse:
    """The course of a study's plain data. BadInput for what it cannot have."""
    study = parse_study(data)
    epoch = parse_utc(study.start, "start")
    check_dates(epoch, study.duration_h * 3600.0, "start")
    watchers = tuple(_watcher(data, study, i, epoch) for i in range(len(study.sensors)))
    elements, census = _elements(study, epoch)
    census.unmet += (*_unnamed(study, elements), *_rounded(study))
    idle = [_idle(watcher, study.duration_h * 3600.0, study.tasking) for watcher in watchers]
    if all(idle) and idle[0] is not None:
        raise idle[0]
    text = json.dumps([study.as_dict(), files_digest(data)], sort_keys=True).encode()
    for column in fields(elements):
        values = np.ascontiguousarray(getattr(elements, column.name))
        text += hashlib.sha256(values.tobytes()).digest()
    return StudyCourse(
        study,
        watchers,
        np.repeat(np.arange(len(watchers)), [s.count for s in study.sensors]),
        elements,
        census,
        threshold_sigma(study.detection.false_alarm_rate),
        hashlib.sha256(text).hexdigest(),
        str(out.resolve()),
        tuple(
            f"{watcher.name} looks nowhere in the period: {why.field}: {why.value}"
            for watcher, why in zip(watchers, idle, strict=True)
            if why is not None
        ),
        tuple(
            f"{watcher.name}: {told}"
            for watcher in watchers
            for told in [
                *sensor_remarks(watcher.resolved.scene, 0.0, study.duration_h * 3600.0),
                *_not_itself(watcher, elements),
                *watcher.direction_notes,
            ]
        ),
    )


def _watcher(data: JsonObject, study: Study, i: int, epoch: tuple[float, float]) -> Watcher:
    """The watcher of a sensor."""
    sensor = study.sensors[i]
    camera = study.camera_of(sensor)
    plain = data["cameras"][study.cameras.index(camera)]
    sections = {k: plain.get(k) for k in CAMERA_KEYS}
    sections |= {"observer": data["sensors"][i]["observer"], "seed": study.seed}
    tracks = camera.tracking == "target"
    if tracks and not isinstance(study.tasking, CuedTasking):
        allowed_ = "sidereal, where fields are searched whatever is in them"
        raise BadInput(f"cameras.{study.cameras.index(camera)}.tracking", "target", allowed_)
    regard, field = sensor.field_of_regard, f"sensors.{i}."
    try:
        named = sections | {"name": sensor.name}
        until_s = study.duration_h * 3600.0
        return make_watcher(named, regard, epoch, tracks, field, study.seed, until_s)
    except BadInput as error:  # of a scene: its sections stand elsewhere in a study
        camera_at = f"cameras.{study.cameras.index(camera)}."
        known = error.field.split(".")[0]
        place = {"observer": field, **dict.fromkeys(CAMERA_KEYS, camera_at)}.get(known, "")
        allowed_ = error.allowed.removeprefix("allowed: ")  # of a scene's mistakes
        raise BadInput(place + error.field, error.value, allowed_) from None


def _elements(study: Study, epoch: tuple[float, float]) -> tuple[Elements, Census]:
    """The catalogue. BadInput for one that is empty, or whose elements are of another time."""
    asked, length_s = study.catalogue, study.duration_h * 3600.0
    parts, census = [], Census()
    if asked.populations:
        middle = (epoch[0], epoch[1] + 0.5 * length_s / DAY_S)
        found, census = gather_elements(asked.populations, middle, "catalogue.populations")
        parts.append(fresh(found, epoch, length_s, asked.most_age_days, census))
    if asked.synthetic is not None:
        parts.append(synthetic_elements(asked.synthetic, epoch))
    return joined(parts), census


def _not_itself(watcher: Watcher, elements: Elements) -> list[str]:
    """That a satellite which is in the catalogue is not looked for by itself."""
    names = ", ".join(elements.name[itself(watcher, elements)].tolist())
    return [f"it is {names} of the catalogue, and does not look for itself"] if names else []


def steps_of(study: Study) -> int:
    """Whole steps that hold all of a study's period."""
    return max(1, math.ceil(study.duration_h * 3600.0 / study.step_s * (1.0 - 1e-12)))


def _rounded(study: Study) -> list[str]:
    """That the period is longer than asked for, where it is no whole number of steps."""
    asked_s, length_s = study.duration_h * 3600.0, steps_of(study) * study.step_s
    if math.isclose(asked_s, length_s, rel_tol=1e-9):
        return []
    told = f"{length_s / 3600.0:.4g} h are simulated: whole steps of {study.step_s:g} s"
    return [f"duration_h: {study.duration_h:g}; {told}"]


def _unnamed(study: Study, elements: Elements) -> list[str]:
    """Rules of the tasking that name no object of the catalogue."""
    rules = study.tasking.rules if isinstance(study.tasking, CuedTasking) else ()
    return [
        f"tasking.rules.{i} names no object of the catalogue"
        for i, (_, named) in enumerate(named_by(rules, elements))
        if not named.any()
    ]


def _may_look(
    watcher: Watcher, watch: WatchMoments, k: NDArray[np.int64], u: NDArray[np.float64]
) -> bool:
    """Whether any of the directions u (r, 3) is allowed at its moment k (r,)."""
    height = np.arcsin(np.clip(np.sum(u * watch.up[k], axis=-1), -1.0, 1.0))
    return bool(allowed(watcher, watch, k, u, height).any())


def _idle(
    watcher: Watcher, length_s: float, tasking: CuedTasking | SearchPattern
) -> BadInput | None:
    """Why a sensor never looks during the period: no dark or no clear hour, or no field of its
    search that it may look at; None where it does.

    Raises BadInput for exclusions that leave no direction at any time.
    """
    field, regard = f"{watcher.field}field_of_regard", watcher.regard
    for steps in (LOOK_STEPS, MANY_STEPS):
        watch = watcher.watch(length_s * np.sort(GOLDEN * np.arange(1, steps + 1) % 1.0))
        if watch.works.any():
            break
    else:
        if isinstance(watcher.observer, GroundObserver) and regard.clear_fraction == 1.0:
            told = f"{regard.twilight_deg:g} (never dark enough)"
            allowed_ = "a Sun that sinks below it in the period"
            return BadInput(f"{field}.twilight_deg", told, allowed_)
        told = "no clear dark hour in the period"
        return BadInput(field, told, "a longer period, more clear sky")
    working = np.flatnonzero(watch.works)[:LOOK_STEPS]
    if isinstance(tasking, SearchPattern):
        for places in (FEW_FIELDS, LOOKS):
            share = (np.arange(places) + 0.5) / places
            at_deg = tasking.from_deg + share * (tasking.to_deg - tasking.from_deg)
            looked = watcher.watch(np.repeat(watch.offset_s[working], places))
            along = axes_of_fields(watcher, looked, tasking, np.tile(at_deg, len(working)))[:, 2]
            if _may_look(watcher, looked, np.arange(len(along)), along):
                return None
        told = f"a {tasking.pattern} of which no field is ever within its field of regard"
        return BadInput("tasking", told, "fields that a sensor may look at")
    rng = np.random.default_rng(0)
    u = from_angles(rng.uniform(0, 2 * np.pi, LOOKS), np.arcsin(rng.uniform(-1, 1, LOOKS)))
    if not _may_look(watcher, watch, np.repeat(working, LOOKS), np.tile(u, (len(working), 1))):
        told = "exclusions that leave no direction at any time"
        raise BadInput(field, told, "smaller angles, or other elevations")
    return None
