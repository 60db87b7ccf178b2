"""Orbits from files: OMM mean elements; OEM, SP3 and CSV tables, turned to GCRS axes.

EME2000 (mean equator and equinox of J2000.0) is turned by the frame bias of GCRS, 0.02 arcsec (IERS
Conventions 2010, section 5.6.1); ICRF has the axes of GCRS. Earth-fixed tables (ITRF) are turned
with UT1 and the pole of the IERS tables, TEME tables as SGP4's frame.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import erfa.ufunc as era
import numpy as np

from catalog_tools.documents import JsonObject, JsonValue
from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.inputs.earth_orientation import gather_dut1_s, gather_pole_arcsec
from pipeline.inputs.targets.ephemeris_files import Ephemeris, read_ephemeris
from pipeline.inputs.targets.omm_files import read_omm
from pipeline.physics.constants import ARCSEC_RAD, EARTH_ROTATION_RAD_S
from pipeline.physics.positions.earth import teme_to_gcrs
from pipeline.physics.positions.orbit_table import best_nodes
from pipeline.physics.positions.times import elapsed_s, format_utc, instants, parse_utc
from pipeline.plan.timing import end_s
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene
from pipeline.spec.targets.orbit import MOST_ROWS, EphemerisOrbit, OmmOrbit, Orbit

Read = TypeVar("Read")

LIGHT_MARGIN_S = 1000.0  # rows are kept for light that left this long before (2 au)
SPARE_ROWS = 16  # on either side, for the polynomials
J2000_JD = 2451545.0


Span = tuple[float, float]  # seconds after the epoch


def gather_ephemerides(scene: Scene, also_s: Span | None = None) -> Scene:
    """The scene with orbits that it names as files written out: as elements, or as GCRS rows.

    Kept are the rows around the exposures, the number of rows that each polynomial passes, and the
    error measured on left-out rows. Each file is read once. A scene without such files comes back
    as it is. BadInput where a file cannot be used or does not cover the exposures.

    also_s : what rows are to cover beside the exposures
    """
    targets = [i for i, t in enumerate(scene.targets) if _is_file(t.orbit)]
    observer = getattr(scene.observer, "orbit", None)
    if not targets and not (observer is not None and _is_file(observer)):
        return scene
    data, read = scene.as_dict(), _Reader(scene, also_s)
    for i in targets:
        data["targets"][i]["orbit"] = read.orbit(scene.targets[i].orbit, f"targets.{i}.orbit")
    if observer is not None and _is_file(observer):
        data["observer"]["orbit"] = read.orbit(observer, "observer.orbit")
    return parse_scene(data)


def _is_file(orbit: Orbit) -> bool:
    return getattr(orbit, "path", None) is not None


class _Reader:
    """Reads each file once, and turns what it holds into plain data of an orbit."""

    def __init__(self, scene: Scene, also_s: Span | None) -> None:
        self._what = "exposures" if also_s is None else "times"
        first_s, last_s = also_s or (0.0, 0.0)
        self._epoch = parse_utc(scene.epoch)
        self._text = scene.epoch
        self._span_s = min(0.0, first_s), max(end_s(scene), last_s)
        self._files: dict[object, Any] = {}

    def orbit(self, orbit: Orbit, field: str) -> JsonObject:
        if isinstance(orbit, OmmOrbit):
            assert orbit.path is not None
            path = Path(orbit.path)
            sets = self._once((path, "omm"), lambda: read_omm(path, f"{field}.path"))
            elements = choose(sets, orbit.object, field, path)
            return {"kind": "omm", "elements": elements}
        assert isinstance(orbit, EphemerisOrbit)
        path, frame, epoch = Path(orbit.path), orbit.frame, orbit.epoch
        tables = self._once(
            (path, frame, epoch),
            lambda: read_ephemeris(path, frame, epoch or self._text, f"{field}.path"),
        )
        return self._rows(choose(tables, orbit.object, field, path), field, path)

    def _once(self, key: object, read: Callable[[], Read]) -> Read:
        if key not in self._files:
            self._files[key] = read()
        return self._files[key]

    def _covering(self, segments: list[Ephemeris], field: str, path: Path) -> Ephemeris:
        """The first segment that covers all times asked for."""
        begin_s, stop_s = self._span_s
        spans = [elapsed_s(self._epoch, *s.useable) for s in segments]
        fits = [k for k, (a, b) in enumerate(spans) if a <= begin_s and b >= stop_s]
        if fits:
            return segments[fits[0]]
        shown = "; ".join(f"{_utc(s, 0)} to {_utc(s, 1)}" for s in segments[:4])
        ends = instants(self._epoch, [begin_s, stop_s])
        since, until = (format_utc(*of) for of in zip(ends.utc1, ends.utc2, strict=True))
        raise BadInput(
            f"{field}.path",
            f"{path.name} covering {shown}",
            f"one stretch of rows over all {self._what}, {since} to {until}, and the light's way "
            "before",
        )

    def _rows(self, segments: list[Ephemeris], field: str, path: Path) -> JsonObject:
        """Rows of the segment that covers the exposures, in GCRS, after the scene's epoch."""
        begin_s, stop_s = self._span_s
        table = self._covering(segments, field, path)
        seconds = self._seconds(table)
        first = max(int(np.searchsorted(seconds, begin_s - LIGHT_MARGIN_S)) - SPARE_ROWS, 0)
        last = int(np.searchsorted(seconds, stop_s)) + SPARE_ROWS
        keep = slice(first, last)
        if len(seconds[keep]) > MOST_ROWS:
            allowed = f"at most {MOST_ROWS} rows around the exposures"
            raise BadInput(f"{field}.path", f"{len(seconds[keep])} rows of {path.name}", allowed)
        seconds = seconds[keep]
        place, speed = to_gcrs(table, keep)
        near = np.zeros(len(seconds), bool)  # and one row on either side
        before = int(np.searchsorted(seconds, begin_s - LIGHT_MARGIN_S)) - 1
        near[max(before, 0) : int(np.searchsorted(seconds, stop_s, side="right")) + 1] = True
        wanted = near if near[1:-1].any() else None
        nodes, error = best_nodes(seconds, place, speed, wanted)
        columns = [seconds[:, None], place] + ([] if speed is None else [speed])
        return {
            "kind": "table",
            "epoch": self._text,
            "rows": np.hstack(columns).tolist(),
            "nodes": nodes,
            "error_m": error if np.isfinite(error) else None,
            "source": f"{path.name}: {table.name}, {table.frame}"[:200],
        }

    def _seconds(self, table: Ephemeris) -> Array:
        return elapsed_s(self._epoch, table.utc1, table.utc2)


def choose(found: JsonObject, wanted: str | None, field: str, path: Path) -> JsonValue:
    """The one object of a file that is meant, by name or number; BadInput where none or several."""
    names = ", ".join(list(found)[:20]) or "(none)"
    if wanted is None:
        if len(found) == 1:
            return next(iter(found.values()))
        allowed = f"the name of one of the {len(found)} in {path.name}: {names}"
        raise BadInput(f"{field}.object", None, allowed)
    same = [k for k in found if wanted.upper() in [part.strip().upper() for part in k.split("|")]]
    if len(same) != 1:
        raise BadInput(f"{field}.object", wanted, f"one object of {path.name}: {names}")
    return found[same[0]]


def to_gcrs(table: Ephemeris, keep: slice) -> tuple[Array, Array | None]:
    """Rows of a table turned to GCRS: positions and, where known, velocities (k, 3)."""
    place = table.place_m[keep]
    speed = None if table.speed_m_s is None else table.speed_m_s[keep]
    if table.frame == "gcrs":
        return place, speed
    if table.frame == "eme2000":
        bias = era.bp06(J2000_JD, 0.0)[0]
        return place @ bias, None if speed is None else speed @ bias
    utc1, utc2 = table.utc1[keep], table.utc2[keep]
    start = (float(utc1[0]), float(utc2[0]))
    end = (float(utc1[-1]), float(utc2[-1]))
    offsets = elapsed_s(start, utc1, utc2)
    at = instants(start, offsets, gather_dut1_s(*start)[0])
    if table.frame == "teme":
        turn = teme_to_gcrs(at)
    else:  # UT1 and the pole run evenly between the first and the last row
        share = offsets / float(offsets[-1])
        drift_s = gather_dut1_s(*end)[0] - gather_dut1_s(*start)[0]
        drift_s -= round(drift_s)  # a leap second in between
        poles = ARCSEC_RAD * np.array([gather_pole_arcsec(*t) or (0.0, 0.0) for t in (start, end)])
        x_rad, y_rad = poles[0][:, None] + share * (poles[1] - poles[0])[:, None]
        ut12 = at.ut12 + drift_s * share / 86_400.0
        fixed = era.c2t06a(at.tt1, at.tt2, at.ut11, ut12, x_rad, y_rad)
        turn = np.swapaxes(fixed, -1, -2)
        if speed is not None:  # the crust's motion about the pole of ITRF (2e-6 rad off the CIP)
            spin = np.array([0.0, 0.0, EARTH_ROTATION_RAD_S])
            speed = speed + np.cross(spin, place)
    moved = np.einsum("nij,nj->ni", turn, place)
    return moved, None if speed is None else np.einsum("nij,nj->ni", turn, speed)


def _utc(table: Ephemeris, i: int) -> str:
    """The start (0) or the end (1) of what is useable of a table, as text."""
    return format_utc(float(table.useable[0][i]), float(table.useable[1][i]))
