"""Which objects of a scene's populations can be seen from its site, when, and where to point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from catalog_tools.engine.schedulers import open_scheduler
from pipeline.errors import BadInput
from pipeline.inputs.pointing_tables import gather_pointing
from pipeline.physics.constants import DAY_S, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.apparent import unaberrate
from pipeline.physics.positions.times import check_dates, elapsed_s, format_utc, instants, parse_utc
from pipeline.physics.vectors import to_angles
from pipeline.plan.pointing.attitude_motion import motion_plan
from pipeline.plan.targets.orbit_age import old_elements, sensor_remarks
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.study import FieldOfRegard
from pipeline.survey.elements import Census, Elements, gather_elements
from pipeline.survey.prune import itself
from pipeline.survey.search import Search, make_search
from pipeline.survey.sights import Sights
from pipeline.survey.watch import Watcher, make_watcher

Array = NDArray[np.float64]

BATCH = 2048
MOST_HOURS, MOST_MOMENTS = 72.0, 50_000
NIGHT_LOOK_S = 60.0
DEFAULT_REGARD = FieldOfRegard()
STREAKED = {  # by mode of pointing, as `survey.sights` has it
    "sidereal": "streaked by the object's own motion",
    "target": "tracked",
    "local": "streaked past a camera held as the scene's is, to the ground or to the orbit's frame",
    "rate": "streaked past a camera that moves at the scene's first rate, wherever it looks",
    "table": "streaked as if the camera followed the stars, NOT as the scene's table turns it",
}


@dataclass(frozen=True)
class FindOptions:
    """What is looked for: from `at` (default: the scene's epoch) for so many hours (0: that moment
    alone), or in the night about it; every step_s; objects of least_snr or more in one frame."""

    at: str | None = None
    hours: float = 0.0
    night: bool = False
    step_s: float = 10.0
    least_snr: float = 5.0
    regard: FieldOfRegard = DEFAULT_REGARD


@dataclass(frozen=True)
class FoundObjects:
    """What was found: objects, best first, each as plain values; and of how many, when, by what
    limits (`notes`)."""

    objects: list[JsonObject]
    looked_at: int
    start: str
    end: str
    notes: list[str]


def find(scene: Scene, request: FindOptions, workers: int | None = None) -> FoundObjects:
    """The objects of a scene's populations that its sensor can see, wherever it points.

    Populations are read from their files. BadInput for a scene without one, a time that is none, a
    site where it does not get dark.
    """
    if not scene.populations:
        raise BadInput("populations", "none", "at least one file of element sets to look through")
    _check(request)
    epoch = parse_utc(request.at, "--at") if request.at is not None else parse_utc(scene.epoch)
    end_s = min(request.hours, MOST_HOURS) * 3600.0  # more are refused by their name
    check_dates(epoch, [-DAY_S / 2, 1.5 * DAY_S] if request.night else [0.0, end_s], "--at")
    watcher = _watcher(scene, request, epoch)
    offsets = _offsets(watcher, request)
    middle = (epoch[0], epoch[1] + 0.5 * float(offsets[0] + offsets[-1]) / DAY_S)
    elements, census = gather_elements(scene.populations, middle)
    census["the sensor itself"] += int(itself(watcher, elements).sum())
    search = make_search(watcher, offsets, request.least_snr)
    starts = range(0, len(elements), BATCH)
    found: dict[int, list[JsonObject]] = {}
    with open_scheduler("threads", workers) as scheduler:
        for first, rows in scheduler.each(_batch, (search, elements), starts):
            if isinstance(rows, Exception):
                raise rows
            found[first] = rows[0]
            census["SGP4 cannot follow them"] += rows[1]
    objects = sorted((row for k in sorted(found) for row in found[k]), key=lambda o: -o["snr"])
    times = [_utc(watcher, t) for t in offsets[[0, -1]]]
    notes = _notes(watcher, search, census, request) + _aged(watcher, elements, offsets)
    notes += _not_held(scene)
    return FoundObjects(objects, len(elements), times[0], times[1], notes)


def _check(request: FindOptions) -> None:
    """BadInput for steps, hours or an SNR that are none."""
    for name, value in (("--step", request.step_s), ("--snr", request.least_snr)):
        if not isinstance(value, Real) or not 0.0 < value < math.inf:
            raise BadInput(name, value, "a number above 0")
    if not isinstance(request.hours, Real) or not 0.0 <= request.hours < math.inf:
        raise BadInput("--hours", request.hours, "a number from 0")


def _aged(watcher: Watcher, elements: Elements, offsets: Array) -> list[str]:
    """What is to be said of old elements, and of the sensor's own orbit."""
    days = -elapsed_s(watcher.epoch, elements.jd1, elements.jd2) / DAY_S
    span = float(offsets[0]), float(offsets[-1])
    rev_day = elements.mean[:, 5] * 1440.0 / (2.0 * np.pi)
    own = [f"the sensor: {told}" for told in sensor_remarks(watcher.resolved.scene, *span)]
    return own + old_elements(elements.name.tolist(), days, rev_day, span, "objects")


def _not_held(scene: Scene) -> list[str]:
    """That the pointing is not held, by how much, and that no SNR counts it."""
    model = scene.pointing.attitude
    if model is None:
        return []
    told, motion, drift = [], motion_plan(gather_pointing(scene)), model.drift
    if motion is not None:
        told.append(f"{motion.path_px:.2g} px rms at random, {motion.blur_px:.2g} px of blur")
    if drift is not None:
        told.append(f"a drift of {math.hypot(drift.x_arcsec_s, drift.y_arcsec_s):.3g} arcsec/s")
    size = f" ({', '.join(told)})" if told else ""
    return [f"SNR as if the camera were held: the scene's pointing.attitude{size} is not counted"]


def _batch(shared: tuple[Search, Elements], first: int) -> tuple[list[JsonObject], int]:
    search, elements = shared
    some = elements.take(slice(first, first + BATCH))
    sights, failed = search.of(some)
    return [_described(search, some, s) for s in _by_object(sights)], failed


def _by_object(s: Sights) -> list[Sights]:
    """The sights of each object, in order of time."""
    order = np.lexsort((s.moment, s.object))
    s = s.take(order)
    edges = np.flatnonzero(np.diff(s.object)) + 1
    return [s.take(part) for part in np.split(np.arange(len(s)), edges) if len(part)]


def _described(search: Search, elements: Elements, s: Sights) -> JsonObject:
    """One object: its best moment, and from when to when it is seen."""
    w, watcher = search.watch, search.watcher
    best, i = int(np.argmax(s.snr)), int(s.object[0])
    k = int(s.moment[best])
    natural = unaberrate(s.geometric[best], w.earth_m_s[k] / SPEED_OF_LIGHT_M_S)
    ra, dec = to_angles(w.to_gcrs[k] @ natural)
    km = float(s.range_m[best]) / 1e3
    return {
        "name": str(elements.name[i]),
        "number": int(elements.number[i]),
        "best": _utc(watcher, w.offset_s[k]),
        "first": _utc(watcher, w.offset_s[s.moment[0]]),
        "last": _utc(watcher, w.offset_s[s.moment[-1]]),
        "moments": len(s),
        "ra_deg": float(np.degrees(ra)),
        "dec_deg": float(np.degrees(dec)),
        "elevation_deg": float(np.degrees(s.elevation[best])),
        "range_km": km,
        "rate_arcsec_s": float(s.rate_arcsec_s[best]),
        "phase_deg": float(np.degrees(s.phase[best])),
        "sunlit_fraction": float(s.sunlit[best]),
        "v_mag": float(s.v_mag[best]),
        "electrons": float(s.light_e[best]),
        "streak_px": float(s.streak_px[best]),
        "snr": float(s.snr[best]),
    }


def _utc(watcher: Watcher, offset_s: float) -> str:
    at = instants(watcher.epoch, [offset_s])
    return format_utc(float(at.utc1[0]), float(at.utc2[0]))[:19] + "Z"


def _watcher(scene: Scene, request: FindOptions, epoch: tuple[float, float]) -> Watcher:
    data = scene.as_dict()
    sections = {k: data[k] for k in ("observer", "sensor", "exposure", "background", "seed")}
    orbit = sections["observer"].get("orbit", {})
    if "epoch" in orbit:  # whose default is that of the scene, wherever the look begins
        orbit["epoch"] = orbit["epoch"] or scene.epoch
    tracks = scene.pointing.mode == "target"
    watcher = make_watcher(
        sections, request.regard, epoch, tracks, "", scene.seed, request.hours * 3600.0
    )
    return replace(watcher, pointing=scene.pointing)


def _offsets(watcher: Watcher, request: FindOptions) -> Array:
    """Moments (n,) [s] after the watcher's epoch."""
    if not 0.0 <= request.hours <= MOST_HOURS:
        raise BadInput("--hours", request.hours, f"0 to {MOST_HOURS:g}")
    start, end = 0.0, request.hours * 3600.0
    if request.night and request.hours:
        raise BadInput("--hours", f"{request.hours:g} with --night", "one of the two")
    if request.night:
        start, end = _night(watcher, request)
    count = int(np.floor((end - start) / request.step_s + 1e-9)) + 1
    if count > MOST_MOMENTS:
        raise BadInput("--step", request.step_s, f"at most {MOST_MOMENTS} moments (these: {count})")
    return np.asarray(start + request.step_s * np.arange(count), float)


def _night(watcher: Watcher, request: FindOptions) -> tuple[float, float]:
    """The dark hours at or after the epoch: from within to the end of the night it is in, or the
    next one's."""
    if not isinstance(watcher.observer, GroundObserver):
        raise BadInput("--night", "an orbit", "a site; for a satellite give --hours")
    at = np.arange(-DAY_S / 2, 1.5 * DAY_S, NIGHT_LOOK_S)
    dark = watcher.watch(at).works
    edges = np.flatnonzero(np.diff(dark.astype(np.int8), prepend=0, append=0))
    nights = [(at[a], at[b - 1]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    for start, end in nights:
        if end >= 0.0:
            return float(start), float(end)
    limit = request.regard.twilight_deg
    raise BadInput("--night", "no darkness", f"a date on which the Sun sinks below {limit:g} deg")


def _from_lamps(watcher: Watcher) -> str:
    """How far from the Sun and the Moon it looks, and by which limit."""
    told = []
    for name in ("sun", "moon"):
        least_deg = getattr(watcher.regard, f"{name}_exclusion_deg")
        own_deg = float(np.degrees(watcher.refused_rad[name]))
        words = f"{max(least_deg, own_deg):g} deg or more from the {name.capitalize()}"
        if own_deg > least_deg:
            words += f" (the camera's own limit; {least_deg:g} deg while the Earth hides it)"
        told.append(words)
    return ", ".join(told)


def _notes(watcher: Watcher, search: Search, census: Census, request: FindOptions) -> list[str]:
    """What the finding rests on."""
    r, regard = watcher.resolved, request.regard
    streaked = STREAKED[watcher.pointing.mode if watcher.pointing else "sidereal"]
    notes = [f"SNR of one {r.integration_s(0):g} s frame, {streaked}; {watcher.sky_note}"]
    if isinstance(watcher.observer, GroundObserver):
        low, twilight = regard.lowest_elevation_deg, regard.twilight_deg
        limits = f"above {low:g} deg, the Sun below {twilight:g} deg"
    else:
        least_deg = np.degrees(watcher.refused_rad["earth"])
        limits = f"{max(regard.earth_exclusion_deg, least_deg):g} deg or more from the Earth's limb"
    notes += [f"{limits}, {_from_lamps(watcher)}", *watcher.direction_notes]
    if isinstance(watcher.observer, GroundObserver) and not search.watch.works.any():
        notes.append("it is never dark at these times: `--night` looks at the dark hours")
    return notes + census.lines()
