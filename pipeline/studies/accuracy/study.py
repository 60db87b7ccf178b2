"""The study: every level of every engine and peer on the same stars, errors and CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.studies.accuracy.engines import EngineCase, Setting, arc, our_settings
from pipeline.studies.accuracy.external import External, PeerFailed
from pipeline.studies.accuracy.peers import external_settings, installed_peers, peer_settings
from pipeline.studies.accuracy.probes import Probes, make_probes, probe_count
from pipeline.studies.accuracy.reference import AiryStar, GaussianStar, curved, straight
from pipeline.studies.worst import worst_of

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

ANGLE_RAD = 0.6435
SHAPES = (GaussianStar(0.8), AiryStar(1.0, 0.3))
STREAKS_PX = (0.0, 60.0, 300.0)
CURVE_PX = 60.0
CURVE_PANELS = 60
STAR_E, FLOOR_E = 1e5, 10.0  # the stated scene: a star of 1e5 e- over noise of 10 e- a pixel
FIRST_STARS = 10


@dataclass(frozen=True)
class Effort:
    """Of timing: the least of `repeats` where one takes less than long_s; peer_s of a peer in this
    process, from which its time for all stars is reckoned."""

    repeats: int = 3
    long_s: float = 1.0
    peer_s: float = 2.0


QUICK = Effort(1, 1.0, 0.2)


@dataclass(frozen=True)
class Record:
    """One engine at one setting on one case.

    stars : asked for; stars_timed : drawn under the clock, cpu_s is scaled from them
    cpu_s : of drawing all stars once, without table_s, which is spent once for many frames
    error_of_peak : largest error of a pixel over the brightest pixel of a centred star
    error_sigma : that, for a star of STAR_E over noise of FLOOR_E in a pixel
    flux_error : largest error of a star's light in a square about it, over its light; None where
    no such square lies in the frame
    pareto : no other of this case is both quicker and more exact
    """

    engine: str
    setting: str
    ours: bool
    psf: str
    streak_px: float
    curved: bool
    stars: int
    stars_timed: int
    cpu_s: float
    cpu_s_per_star: float
    table_s: float
    table_bytes: int | None
    error_of_peak: float
    error_sigma: float
    flux_error: float | None
    pareto: bool = False


def cases(frame: tuple[int, int], quick: bool) -> list[EngineCase]:
    """Both shapes with every streak, and a curved streak of the Gaussian."""
    streaks = (0.0, 60.0) if quick else STREAKS_PX
    out = [EngineCase(s, straight(n, ANGLE_RAD), n, frame) for s in SHAPES for n in streaks]
    if quick:
        out = [c for c in out if not (c.streak_px and isinstance(c.shape, AiryStar))]
    bent = curved(lambda t: arc(CURVE_PX, t), CURVE_PANELS)
    return [*out, EngineCase(SHAPES[0], bent, CURVE_PX, frame, curved=True)]


def run_study(
    stars: int,
    frame: tuple[int, int],
    quick: bool = False,
    peers: bool = True,
    satsim_python: str | None = None,
    progress: Progress | None = None,
) -> JsonObject:
    """Everything that was measured, as plain values (see `Record` for those of one row)."""
    records: list[Record] = []
    failed: list[dict[str, str]] = []
    everything = cases(frame, quick)
    for n, case in enumerate(everything):
        found: list[Record] = []
        for item in _measured(case, stars, quick, peers, satsim_python):
            if isinstance(item, Record):
                found.append(item)
            else:
                failed.append(item)
        records += with_pareto(found)
        if progress is not None:
            progress("cases", n + 1, len(everything))
    return {
        "schema": "nightglass/accuracy/1",
        "stars": stars,
        "frame": list(frame),
        "quick": quick,
        "noise": {"star_e": STAR_E, "floor_e": FLOOR_E},
        "peers": [p._asdict() for p in installed_peers(satsim_python)] if peers else [],
        "failed": failed,
        "notes": list(NOTES),
        "records": [asdict(r) for r in records],
    }


NOTES = (
    "CPU time of one thread; tables, made once for many frames, are counted apart as table_s (that "
    "of an engine's first level holds its imports and the loading of compiled code)",
    "peers in this process draw fewer stars, and their time is scaled by the number of stars",
    "stars alone are drawn here: what the grid of a smooth sky errs by, `nightglass report ledger` "
    "measures",
    "tiles change no bit of a pixel: their levels differ in time only",
)


def _measured(
    case: EngineCase, stars: int, quick: bool, peers: bool, satsim_python: str | None
) -> Iterator[Record | dict[str, str]]:
    """Records of one case, and what failed."""
    probes = make_probes(case, probe_count(case, quick))
    rng = np.random.default_rng(2)
    x = rng.uniform(-0.5, case.frame[1] - 0.5, stars)
    y = rng.uniform(-0.5, case.frame[0] - 0.5, stars)
    settings = our_settings(case, quick) + (peer_settings(case, quick) if peers else [])
    for setting in settings:
        yield _one(case, setting, probes, x, y, QUICK if quick else Effort())
    if not peers:
        return
    for engine, name, run in external_settings(case, quick, satsim_python):
        try:
            made = run(case, (probes.x_px, probes.y_px), (x, y))
        except PeerFailed as error:
            yield {"engine": engine, "setting": name, "case": case.name, "why": str(error)}
            continue
        yield _external(case, engine, name, probes, made, stars)


def _one(
    case: EngineCase, setting: Setting, probes: Probes, x: Array, y: Array, effort: Effort
) -> Record:
    """One level: made, looked at probe by probe, then timed."""
    started = time.process_time()
    drawn = setting.make(case)
    table_s = time.process_time() - started
    unit = np.ones(1)
    errors = [
        probes.errors(k, drawn.draw(probes.x_px[k : k + 1], probes.y_px[k : k + 1], unit))
        for k in range(probes.x_px.size)
    ]

    def spent(n: int) -> float:
        began = time.process_time()
        drawn.draw(x[:n], y[:n], np.ones(n))
        return time.process_time() - began

    n = x.size
    if not setting.ours:
        each = spent(min(n, FIRST_STARS)) / min(n, FIRST_STARS)
        n = int(np.clip(effort.peer_s / max(each, 1e-9), min(n, FIRST_STARS), n))
    times = [spent(n)]
    while len(times) < effort.repeats and times[0] < effort.long_s:
        times.append(spent(n))
    return _record(
        case,
        setting.engine,
        setting.setting,
        setting.ours,
        probes,
        errors,
        x.size,
        n,
        min(times),
        table_s,
        drawn.table_bytes,
    )


def _external(
    case: EngineCase, engine: str, setting: str, probes: Probes, made: External, stars: int
) -> Record:
    errors = [probes.errors(k, made.image) for k in range(probes.x_px.size)]
    return _record(
        case, engine, setting, False, probes, errors, stars, stars, made.cpu_s, made.table_s, None
    )


def _record(
    case: EngineCase,
    engine: str,
    setting: str,
    ours: bool,
    probes: Probes,
    errors: list[tuple[float, float | None]],
    stars: int,
    timed: int,
    cpu_s: float,
    table_s: float,
    table_bytes: int | None,
) -> Record:
    pixel = worst_of(*(one for one, _ in errors))
    lights = [light for _, light in errors if light is not None]
    return Record(
        engine,
        setting,
        ours,
        case.shape.name,
        case.streak_px,
        case.curved,
        stars,
        timed,
        cpu_s * stars / timed,
        cpu_s / timed,
        table_s,
        table_bytes,
        pixel,
        pixel * probes.peak * STAR_E / FLOOR_E,
        worst_of(*lights) if lights else None,
    )


def with_pareto(records: list[Record]) -> list[Record]:
    """The records of one case with the Pareto front marked; tiles are a setting of stamps."""
    compared = [r for r in records if r.engine != "tiles"]
    return [
        replace(r, pareto=r in compared and not any(_beats(other, r) for other in compared))
        for r in records
    ]


def _beats(a: Record, b: Record) -> bool:
    """Neither slower nor less exact, and not the same."""
    mine, yours = (a.cpu_s, a.error_of_peak), (b.cpu_s, b.error_of_peak)
    return mine[0] <= yours[0] and mine[1] <= yours[1] and mine != yours
