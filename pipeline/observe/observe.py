"""What a scene's sensor sees of every target: places, rates, light, signal-to-noise, or why not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from numbers import Integral, Real
from os import PathLike

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array, Geometry
from pipeline.errors import BadInput
from pipeline.execute.sources import comes_by, reaching
from pipeline.execute.truth import collected_e, target_truth
from pipeline.observe.angles import Angles, angles_of
from pipeline.observe.centroid import measured
from pipeline.observe.groups import Group, groups_of
from pipeline.observe.on_axis import on_axis_light_e, on_axis_snr, on_axis_streaks_px
from pipeline.observe.reasons import REASONS, seen_of
from pipeline.observe.times import Times, times_of
from pipeline.physics.positions.times import format_utc
from pipeline.plan.pointing.attitude_motion import motion_plan
from pipeline.plan.pointing.geometry import (
    FEWEST_NODES,
    geometry_anywhere,
    light_nodes,
    plan_geometry,
)
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.timing import frame_times
from pipeline.spec.scene import Scene

MOST_ROWS = 2_000_000
SAMPLES = 25_000  # rows that are worked out in one go
LEAST_SNR = 5.0
OF_TRUTH = (
    "x_px", "y_px", "ra_deg", "dec_deg", "apparent_ra_deg", "apparent_dec_deg", "range_m",
    "phase_deg", "sunlit_fraction", "electrons", "v_mag", "mag_ab", "snr", "in_frame",
    "visible_fraction",
)  # fmt: skip
ORDER = (
    "frame", "utc", "name", "object_name", "seen", "ra_deg", "dec_deg", "apparent_ra_deg",
    "apparent_dec_deg", "azimuth_deg", "elevation_deg", "range_m", "range_rate_m_s",
    "rate_arcsec_s", "position_angle_deg", "phase_deg", "sunlit_fraction",
    "solar_elongation_deg", "moon_separation_deg", "v_mag", "mag_ab", "electrons",
    "electrons_per_s", "streak_px", "snr", "snr_at", "x_px", "y_px", "in_frame",
    "visible_fraction",
)  # fmt: skip
NOT_MOVED = (
    "places and streaks are those of a pointing without its random motion ({rms_px:.2g} px rms), "
    "which is of the scene's own exposures"
)
MEASURED = ("ra_measured_deg", "dec_measured_deg", "centroid_sigma_arcsec")
OTHER_TIMES = (
    "the noise of the sky and the response are those of the scene's own exposures, {epoch}: "
    "moonlight, twilight and other pointings change them at other times"
)

Mask = NDArray[np.bool_]
Listener = Callable[[str, int, int | None], None]


@dataclass(frozen=True)
class Observed:
    """What is seen: a row for each exposure and target, by time, then in the scene's order,
    of populations the members that are drawn first.

    table : columns of ORDER; notes : what else is to be reported; scene : its name
    """

    table: pa.Table
    notes: tuple[str, ...]
    scene: str

    def counts(self) -> dict[str, int]:
        """How many rows are seen, and how many not for each reason."""
        found = self.table["seen"].value_counts().to_pylist()
        by_reason = {one["values"]: one["counts"] for one in found}
        return {reason: by_reason[reason] for reason in REASONS if reason in by_reason}


def observe(
    scene: Scene,
    times: str | PathLike[str] | Iterable[str | float] | None = None,
    least_snr: float = LEAST_SNR,
    listen: Listener | None = None,
    centroid_seed: int | None = None,
    most_rows: int = MOST_ROWS,
) -> Observed:
    """Every target and member of a population as the scene's sensor sees it, without drawing.

    At the scene's exposures the rows of targets whose light reaches the frame (`snr_at`: frame)
    are those of truth/targets.parquet, to the last digit. Of others electrons, streak and SNR are
    those in the middle of the frame (`snr_at`: boresight), the pointing turned onto them.

    Parameters
    ----------
    times : middles of exposures in place of the scene's own; see `times_of`. The sky's noise stays
        that of the scene's exposures
    least_snr : below which a target is too faint
    listen : told what is done, how many rows of how many
    centroid_seed : of noise; with it what is seen has places as measured (`observe.centroid`)

    Raises BadInput for scenes that cannot be resolved, times that are none, more than `most_rows`.
    """
    if not isinstance(least_snr, Real) or not 0.0 < least_snr < np.inf:
        raise BadInput("snr", least_snr, "a signal-to-noise ratio above 0")
    if centroid_seed is not None and not (
        isinstance(centroid_seed, Integral) and centroid_seed >= 0
    ):
        raise BadInput("centroid_seed", centroid_seed, "a whole number, 0 or more")
    at = times_of(scene, times)
    groups, notes = groups_of(scene, at)
    rows = sum(len(g.resolved.scene.targets) - g.first for g in groups) * len(at.frame)
    if rows > most_rows:
        field = "exposure.frames" if at.as_exposed else "times"
        allowed = f"at most {most_rows} rows (times x targets); here {rows}"
        raise BadInput(field, len(at.frame), allowed)
    if not at.as_exposed:
        notes += _of_other_times(scene, groups)
    made, done = [], 0
    for group, part in _windows(groups, at):
        made.append(_rows(group, at, part, least_snr, centroid_seed))
        done += made[-1].num_rows
        if listen is not None:
            listen("observing", done, rows)
    table = pa.concat_tables(made).sort_by([("moment", "ascending"), ("index", "ascending")])
    columns = ORDER if centroid_seed is None else (*ORDER, *MEASURED)
    return Observed(table.select(columns), tuple(notes), scene.name)


def _of_other_times(scene: Scene, groups: list[Group]) -> list[str]:
    """What is not as it is at the scene's own exposures."""
    motions = [motion_plan(group.resolved.scene) for group in groups[:1]]
    moved = [NOT_MOVED.format(rms_px=m.path_px) for m in motions if m is not None]
    return [OTHER_TIMES.format(epoch=scene.epoch), *moved]


def _windows(groups: list[Group], at: Times) -> Iterator[tuple[Group, slice]]:
    """Times that are worked out together: so many that their arrays stay small."""
    for group in groups:
        each = max(1, SAMPLES // max(1, len(group.resolved.scene.targets)))
        for first in range(0, len(at.frame), each):
            yield group, slice(first, min(first + each, len(at.frame)))


def _rows(
    group: Group, at: Times, part: slice, least_snr: float, centroid_seed: int | None
) -> pa.Table:
    """The rows of some of the times."""
    return pa.concat_tables(
        _rows_of(group, *one, least_snr, centroid_seed)
        for one in _geometries(group, at, np.arange(part.start, part.stop))
    )


def _geometries(
    group: Group, at: Times, every: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], Geometry, Geometry]]:
    """Some of the times, their geometry, and that of targets beside the frame.

    At the scene's exposures the drawing has as many nodes as the targets near the frame ask for:
    of these the rows are as drawn, of all others as the nodes have it that their light asks for.
    """
    scene, changing = group.resolved.scene, group.changing
    g, asked = _geometry(group, at, every, FEWEST_NODES), np.full(len(every), FEWEST_NODES)
    if changing.any():
        asked = light_nodes(scene, g, changing)
    if (asked == FEWEST_NODES).all():
        yield every, g, g
        return
    for nodes in np.unique(asked):
        which = every[asked == nodes]
        finer = _geometry(group, at, which, int(nodes))
        as_it_is = nodes == FEWEST_NODES or not group.as_drawn
        yield which, finer if as_it_is else _geometry(group, at, which, FEWEST_NODES), finer


def _geometry(group: Group, at: Times, which: NDArray[np.int64], nodes: int) -> Geometry:
    """The geometry of some of the times, at so many nodes or, as drawn, at more."""
    plan, frames = group.resolved, at.frame[which]
    if group.as_drawn:
        return plan_geometry(plan.scene, frames, plan.dut1_s, nodes)
    return geometry_anywhere(plan.scene, frames, plan.dut1_s, at.late_s[which], nodes)


def _rows_of(
    group: Group,
    which: NDArray[np.int64],
    g: Geometry,
    finer: Geometry,
    least_snr: float,
    centroid_seed: int | None,
) -> pa.Table:
    """The rows of some of the times, as of `_geometries`."""
    plan = group.resolved
    angles = angles_of(plan, g)
    columns, near, in_field = _truth(plan, g)
    if finer is not g:
        others = _truth(plan, finer)[0]
        columns = {name: np.where(near, own, others[name]) for name, own in columns.items()}
    _fill_others(plan, finer, angles, columns, ~near)
    exposed_s = frame_times(plan.scene, g.frame)[1][:, None]
    exposed_s = np.where(exposed_s > 0.0, exposed_s, np.nan)  # bias frames have no rate
    columns |= angles.columns | {"electrons_per_s": columns["electrons"] / exposed_s}
    seen = seen_of(plan, g, angles, columns, in_field, least_snr)
    if centroid_seed is not None:
        columns |= _measured(plan, g, seen == "yes", centroid_seed, which)
    words = {"seen": seen, "snr_at": np.where(near, "frame", "boresight")}
    return _table(plan, g, {**columns, **words}, which, group)


def _truth(plan: ResolvedScene, g: Geometry) -> tuple[dict[str, Array], Mask, Mask]:
    """Columns (F, T) of truth and the streaks; whose light reaches the frame; who crosses it."""
    found: list[JsonObject] = []
    near, crosses = np.zeros((2, len(g.frame), len(plan.scene.targets)), np.bool_)
    for k in range(len(g.frame)):
        one = g.frame_slice(k)
        truth = target_truth(plan, one, everywhere=False)
        ends = np.hypot(
            truth["x_end_px"] - truth["x_start_px"], truth["y_end_px"] - truth["y_start_px"]
        )
        found.append({name: truth[name] for name in OF_TRUTH} | {"streak_px": ends})
        near[k, reaching(plan, one)] = True
        crosses[k] = truth["in_frame"]
        for i in np.flatnonzero(near[k] & ~crosses[k]):
            crosses[k, i] = comes_by(plan, one.target_x_px[i, 0], one.target_y_px[i, 0], 0.0)
    stacked = {name: np.stack([one[name] for one in found]) for name in found[0]}
    return stacked, near, crosses


def _measured(
    plan: ResolvedScene, g: Geometry, seen: Mask, seed: int, moments: NDArray[np.int64]
) -> dict[str, Array]:
    """Columns (F, T) of MEASURED; NaN where a target is not seen. moments : (F,) their numbers"""
    columns = {name: np.full(seen.shape, np.nan) for name in MEASURED}
    for k in np.flatnonzero(seen.any(axis=1)):
        which = np.flatnonzero(seen[k])
        found = measured(plan, g.frame_slice(int(k)), which, seed, int(moments[k]))
        for name, value in found.items():
            columns[name][k, which] = value
    return columns


def _fill_others(
    plan: ResolvedScene, g: Geometry, angles: Angles, columns: dict[str, Array], others: Mask
) -> None:
    """Electrons, streak and SNR of targets whose light does not reach the frame (F, T)."""
    light = on_axis_light_e(plan, g, columns["visible_fraction"].astype(float))
    streak = on_axis_streaks_px(plan, g, angles.direction, angles.velocity)
    lengths = np.hypot(streak[..., 0], streak[..., 1])
    for name, there in (("electrons", collected_e(plan, light)), ("streak_px", lengths)):
        columns[name] = np.where(others, there, columns[name])
    for k in range(len(g.frame)):
        mine, one = np.flatnonzero(others[k]), g.frame_slice(k)
        columns["snr"][k, mine] = on_axis_snr(plan, one, mine, light[k, mine], streak[k, mine])


def _table(
    plan: ResolvedScene,
    g: Geometry,
    columns: dict[str, Array],
    moments: NDArray[np.int64],
    group: Group,
) -> pa.Table:
    """Rows of a group's targets, frame by frame. moments : (F,) their numbers"""
    targets, first = plan.scene.targets, group.first
    shape = (len(g.frame), len(targets) - first)
    moment, index = (np.ravel(v) for v in np.indices(shape))
    utc = [format_utc(a, b) for a, b in zip(g.utc1[:, g.middle], g.utc2[:, g.middle], strict=True)]
    names = [t.name for t in targets[first:]]
    objects = [t.object_name or t.name for t in targets[first:]]
    words = {
        "frame": pa.array(g.frame[moment].astype(np.int32)),
        "utc": pa.array(utc).take(pa.array(moment)),
        "name": pa.array(names, pa.string()).take(pa.array(index)),
        "object_name": pa.array(objects, pa.string()).take(pa.array(index)),
        "moment": pa.array(moments[moment]),
        "index": pa.array(index + (0 if group.as_drawn else MOST_ROWS)),  # those drawn first
    }
    return pa.table(words | {k: pa.array(v[:, first:].ravel()) for k, v in columns.items()})
