"""Light curve of one target: magnitude, phase, range and eclipse against time, table and plot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.inputs.band.curves import solar_spectrum
from pipeline.inputs.earth_orientation import gather_dut1_s, with_pole
from pipeline.physics.constants import DEG_RAD
from pipeline.physics.positions.times import format_utc, parse_utc
from pipeline.physics.radiometry import (
    ResponseCurve,
    ab_photon_rate,
    band_photon_irradiance_sun,
)
from pipeline.plan.bodies.albedos import with_band_albedos
from pipeline.plan.bodies.attitudes import View
from pipeline.plan.bodies.bodies import target_lights
from pipeline.plan.bodies.paths import clear_of_earth
from pipeline.plan.bodies.sights import Moments, sights
from pipeline.plan.pointing.geometry import moments_at
from pipeline.plan.timing import end_s
from pipeline.spec.scene import Scene
from pipeline.spec.targets.mesh import MeshBody

Array = NDArray[np.float64]

MOST_POINTS = 1_000_000


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
    """The light curve of a scene's target by its name, at evenly spaced times of arrival.

    The pointing plays no part, and neither does the atmosphere. response : the sensor's, whose
    band the AB magnitude is in. stop_s : default the end of the scene's last exposure.
    BadInput for a name that is not there, times that do not rise, and what the scene itself gets
    wrong (orbits inside the Earth, tables that do not cover the times).
    """
    names = [t.name for t in scene.targets]
    if name not in names:
        known = ", ".join(names[:10]) or "(the scene has no target)"
        raise BadInput("--target", name, f"the name of a target: {known}")
    if stop_s is None:
        stop_s = end_s(scene)
    if not (math.isfinite(start_s) and math.isfinite(stop_s) and stop_s > start_s):
        raise BadInput("--stop", stop_s, f"a time after the start, {start_s:g} s")
    if not 2 <= points <= MOST_POINTS:
        raise BadInput("--points", points, f"2 to {MOST_POINTS}")
    wavelength, irradiance, _, _ = solar_spectrum()
    index = names.index(name)
    scene = with_band_albedos(with_pole(scene), wavelength, irradiance, response)
    epoch = parse_utc(scene.epoch)
    dut1_s, _ = gather_dut1_s(*epoch)
    time_s = np.linspace(start_s, stop_s, points)
    at = moments_at(scene, dut1_s, time_s)
    times, earth = at.times, at.earth
    sight, view = sights(scene, [index], at)
    light, phase, sunlit = (
        value[0]
        for value in target_lights(
            [scene.targets[index]],
            [f"targets.{index}.body"],
            epoch,
            view,
            earth.sun_from_earth_m,
            (times.tt1, times.tt2),
            sight.range_m,
            known=_worked_out(scene, index, at, view),
        )
    )
    range_m = sight.range_m[0]
    rate = light * band_photon_irradiance_sun(wavelength, irradiance, response)
    with np.errstate(divide="ignore"):
        magnitude = -2.5 * np.log10(rate / ab_photon_rate(0.0, response))
    seen = clear_of_earth(scene, at, sight, sight.direction_proper)[0] > 0.0
    return LightCurve(time_s, times.utc1, times.utc2, magnitude, rate, phase, range_m, sunlit, seen)


def _worked_out(scene: Scene, index: int, at: Moments, view: View) -> dict[int, Array]:
    """A mesh's light from a table, where that takes fewer moments than the curve has points."""
    if not isinstance(scene.targets[index].body, MeshBody):
        return {}
    from pipeline.plan.bodies.mesh_tables import table_between, table_phase

    start, stop = (float(t) for t in at.offset_s[[0, -1]])
    table = table_between(scene, index, at, start, stop, len(at.offset_s))
    return {} if table is None else {0: table.at(at.offset_s, table_phase(scene, index, view))}


def write_light_curve(curve: LightCurve, name: str, table: Path, plot: Path | None) -> None:
    """Write a light curve as Parquet, and as a PNG where `plot` is given (needs matplotlib)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if plot is not None:
        _draw(curve, name, plot)
    columns = {
        "time_s": curve.time_s,
        "utc": [format_utc(a, b) for a, b in zip(curve.utc1, curve.utc2, strict=True)],
        "mag_ab": np.where(np.isfinite(curve.mag_ab), curve.mag_ab, np.nan),
        "irradiance_e_s_m2": curve.irradiance_e_s_m2,
        "phase_deg": curve.phase_rad / DEG_RAD,
        "range_m": curve.range_m,
        "sunlit_fraction": curve.sunlit,
        "above_horizon": curve.above_horizon,
    }
    made = pa.table(columns)
    notes = {"target": name, "mag_ab": "AB, in the sensor's band, above the air; NaN: no light"}
    try:
        pq.write_table(made.replace_schema_metadata(notes), table)
    except OSError as error:
        raise BadInput("-o", str(table), f"a file that can be written; {error}") from None


def _draw(curve: LightCurve, name: str, path: Path) -> None:
    """Four panels over time: magnitude (bright up), phase angle, range, sunlit share."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise BadInput("--plot", str(path), "a plot with matplotlib installed") from None
    figure = Figure(figsize=(8.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
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
        ("sunlit share", curve.sunlit),
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
