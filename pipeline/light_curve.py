"""Light curves of targets: magnitude, phase, range and eclipse against time, table and plot."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from catalog_tools.storage.durable import MAKE_ROOM, full_disk_told, whole_file
from pipeline.errors import BadInput
from pipeline.inputs.band.curves import solar_spectrum
from pipeline.inputs.earth_orientation import gather_dut1_s, with_pole
from pipeline.inputs.targets.populations import screened
from pipeline.lazily import blank_figure, need_matplotlib
from pipeline.physics.constants import DEG_RAD
from pipeline.physics.positions.times import check_dates, format_utc, parse_utc
from pipeline.physics.radiometry import (
    ResponseCurve,
    ab_photon_rate,
    band_photon_irradiance_sun,
)
from pipeline.plan.bodies.albedos import with_band_albedos
from pipeline.plan.bodies.attitudes import View
from pipeline.plan.bodies.bodies import target_lights
from pipeline.plan.bodies.paths import TOGETHER, batches, clear_of_earth
from pipeline.plan.bodies.sights import Moments, sights
from pipeline.plan.pointing.geometry import moments_at
from pipeline.plan.targets.populations import whole_sky
from pipeline.plan.timing import end_s
from pipeline.spec.scene import Scene
from pipeline.spec.targets.mesh import MeshBody
from pipeline.store.result_files import check_ending, without_nan

Array = NDArray[np.float64]

MOST_POINTS = 1_000_000
ROWS = 1_000_000  # that are held before they are written
ENDINGS = (".parquet", ".csv")
PLOTS = (".png", ".svg", ".pdf", ".eps", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")


@dataclass(frozen=True)
class LightCurve:
    """A target's light at n moments, as the observer receives it.

    time_s : after the scene's epoch, of arrival; utc1, utc2 : two-part Julian dates
    mag_ab : AB magnitude in the sensor's own band, above the air; inf where no light comes
    irradiance_e_s_m2 : electrons per second and square metre of pupil
    phase_rad, range_m, sunlit : phase angle, distance, share of the Sun not eclipsed
    above_horizon : above the site's horizon (without refraction), or no Earth before the target
    """

    time_s: Array
    utc1: Array
    utc2: Array
    mag_ab: Array
    irradiance_e_s_m2: Array
    phase_rad: Array
    range_m: Array
    sunlit: Array
    above_horizon: NDArray[np.bool_]


def light_curve(
    scene: Scene,
    name: str,
    response: ResponseCurve,
    start_s: float = 0.0,
    stop_s: float | None = None,
    points: int = 1000,
) -> LightCurve:
    """The light curve of one target of a scene by its name; see `light_curves`."""
    return next(light_curves(scene, [name], response, start_s, stop_s, points))[1]


def light_curves(
    scene: Scene,
    names: Sequence[str],
    response: ResponseCurve,
    start_s: float = 0.0,
    stop_s: float | None = None,
    points: int = 1000,
) -> Iterator[tuple[str, LightCurve]]:
    """Light curves by the targets' names, at evenly spaced times of arrival; many worked out
    together, so that memory does not grow with their number.

    The pointing plays no part, and neither does the atmosphere. names : of targets and members of
    populations; none for all. response : the sensor's, whose band the AB magnitude is in. stop_s :
    default the end of the scene's last exposure.
    BadInput for a name that is not there, times that do not rise, and what the scene itself gets
    wrong (orbits inside the Earth, tables that do not cover the times).
    """
    if stop_s is None:
        stop_s = end_s(scene)
    check_dates(parse_utc(scene.epoch), start_s, "--start")
    if not (math.isfinite(stop_s) and stop_s > start_s):
        raise BadInput("--stop", stop_s, f"a time after the start, {start_s:g} s")
    check_dates(parse_utc(scene.epoch), stop_s, "--stop")
    if not 2 <= points <= MOST_POINTS:
        raise BadInput("--points", points, f"2 to {MOST_POINTS}")
    own = {t.name for t in scene.targets}
    if scene.populations and not (names and own.issuperset(names)):
        scene = screened(scene, whole_sky(scene, start_s, stop_s, 0.5 * (start_s + stop_s)))
    which = _which(scene, names)
    wavelength, irradiance, _, _ = solar_spectrum()
    scene = with_band_albedos(with_pole(scene), wavelength, irradiance, response)
    dut1_s, _ = gather_dut1_s(*parse_utc(scene.epoch))
    at = moments_at(scene, dut1_s, np.linspace(start_s, stop_s, points))
    full_rate = band_photon_irradiance_sun(wavelength, irradiance, response)
    zero_rate = ab_photon_rate(0.0, response)
    for part in batches(len(which), points):
        yield from _curves(scene, which[part.start : part.stop], at, full_rate, zero_rate)


def _curves(
    scene: Scene, which: list[int], at: Moments, full_rate: float, zero_rate: float
) -> Iterator[tuple[str, LightCurve]]:
    """Curves of some targets, worked out together; the rates of full sunlight and of AB 0."""
    times = at.times
    sight, view = sights(scene, which, at)
    light, phase, sunlit = target_lights(
        [scene.targets[i] for i in which],
        [f"targets.{i}.body" for i in which],
        at.epoch,
        view,
        at.earth.sun_from_earth_m,
        (times.tt1, times.tt2),
        sight.range_m,
        known=_worked_out(scene, which, at, view),
    )
    rate = light * full_rate
    with np.errstate(divide="ignore"):
        magnitude = -2.5 * np.log10(rate / zero_rate)
    seen = clear_of_earth(scene, at, sight, sight.direction_proper) > 0.0
    rows = zip(magnitude, rate, phase, sight.range_m, sunlit, seen, strict=True)
    for i, row in zip(which, rows, strict=True):
        yield scene.targets[i].name, LightCurve(at.offset_s, times.utc1, times.utc2, *row)


def _which(scene: Scene, names: Sequence[str]) -> list[int]:
    """Indices of targets by their names; of all for none. BadInput for one that is not there."""
    index = {t.name: i for i, t in enumerate(scene.targets)}
    if not index:
        raise BadInput("targets", "none", "a target or a population, to follow its light")
    for name in [n for n in names if n not in index]:
        raise BadInput("--target", name, f"the name of a target: {', '.join(list(index)[:10])}")
    return [index[name] for name in names] or list(index.values())


def _worked_out(scene: Scene, which: list[int], at: Moments, view: View) -> dict[int, Array]:
    """Meshes' light from tables, where that takes fewer moments than the curve has points."""
    found = {}
    for k, i in enumerate(which):
        if isinstance(scene.targets[i].body, MeshBody):
            from pipeline.plan.bodies.mesh_tables import table_between, table_phase

            start, stop = (float(t) for t in at.offset_s[[0, -1]])
            table = table_between(scene, i, at, start, stop, len(at.offset_s))
            if table is not None:
                phase = table_phase(scene, i, view.of(np.array([k])))
                found[k] = table.at(at.offset_s, phase)
    return found


def write_light_curves(
    curves: Iterator[tuple[str, LightCurve]], table: Path, plot: Path | None = None
) -> int:
    """Write light curves as Parquet or CSV, by the file's ending, a few hundred at a time, and the
    only one as a PNG where `plot` is given (needs matplotlib); how many there were."""
    if plot is not None:
        need_matplotlib("leave out --plot")
        if plot.suffix.lower() not in PLOTS:
            raise BadInput("--plot", plot.name, f"a name that ends in {', '.join(PLOTS)}")
    check_ending(table, ENDINGS)
    ending = table.suffix.lower()

    def plain(rows: pa.Table) -> pa.Table:
        return without_nan(rows) if ending == ".csv" else rows

    name, curve = next(curves)
    count, first = 1, _table(name, curve, utc := _utc(curve))
    if plot is not None:
        if next(curves, None) is not None:
            raise BadInput("--plot", str(plot), "one --target with it")
        _draw(curve, name, plot)
    try:
        with (
            full_disk_told(table, MAKE_ROOM),
            whole_file(table) as own,
            _writer(own, first.schema, ending) as writer,
        ):
            writer.write_table(plain(first))
            at_once = max(1, min(TOGETHER, ROWS // len(utc)))
            while some := list(islice(curves, at_once)):
                writer.write_table(plain(pa.concat_tables([_table(n, c, utc) for n, c in some])))
                count += len(some)
    except OSError as error:
        why = error.strerror or str(error)
        raise BadInput("-o", str(table), f"a file that can be written; {why}") from None
    return count


def _writer(path: Path, schema: pa.Schema, ending: str) -> pq.ParquetWriter | pyarrow.csv.CSVWriter:
    if ending == ".csv":
        return pyarrow.csv.CSVWriter(path, schema)
    notes = {"mag_ab": "AB, in the sensor's band, above the air; NaN: no light"}
    return pq.ParquetWriter(path, schema.with_metadata(notes))


def _utc(curve: LightCurve) -> pa.Array:
    return pa.array([format_utc(a, b) for a, b in zip(curve.utc1, curve.utc2, strict=True)])


def _table(name: str, curve: LightCurve, utc: pa.Array) -> pa.Table:
    columns = {
        "target": pa.repeat(name, len(utc)),
        "time_s": curve.time_s,
        "utc": utc,
        "mag_ab": np.where(np.isfinite(curve.mag_ab), curve.mag_ab, np.nan),
        "irradiance_e_s_m2": curve.irradiance_e_s_m2,
        "phase_deg": curve.phase_rad / DEG_RAD,
        "range_m": curve.range_m,
        "sunlit_fraction": curve.sunlit,
        "above_horizon": curve.above_horizon,
    }
    return pa.table(columns)


def _draw(curve: LightCurve, name: str, path: Path) -> None:
    """Four panels over time: magnitude (bright up), phase angle, range, sunlit share."""
    figure = blank_figure((8.0, 8.0), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[3, 1, 1, 1])
    bright = np.where(np.isfinite(curve.mag_ab), curve.mag_ab, np.nan)
    hidden = np.where(curve.above_horizon, np.nan, bright)
    axes[0].plot(curve.time_s, np.where(curve.above_horizon, bright, np.nan), lw=1.2, label="seen")
    if not curve.above_horizon.all():
        axes[0].plot(curve.time_s, hidden, lw=0.8, color="0.7", label="behind the Earth")
        axes[0].legend(loc="best")
    if np.isfinite(bright).any():  # deep dips may leave the panel
        top, bottom = np.nanmin(bright), np.nanpercentile(bright, 98)
        axes[0].set_ylim(bottom + 0.5, top - 0.5)
    rows = (
        ("AB magnitude, sensor's band", None),
        ("phase [deg]", curve.phase_rad / DEG_RAD),
        ("range [km]", curve.range_m / 1e3),
        ("sunlit fraction", curve.sunlit),
    )
    for ax, (label, values) in zip(axes, rows, strict=True):
        if values is not None:
            ax.plot(curve.time_s, values, lw=1.2)
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
    axes[3].set_ylim(-0.05, 1.05)
    start = format_utc(float(curve.utc1[0]), float(curve.utc2[0]))[:19]
    axes[3].set_xlabel(f"seconds after the epoch (first point {start} UTC)")
    axes[0].set_title(name)
    figure.savefig(path, dpi=110)
