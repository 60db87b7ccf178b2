"""The report page of a study: its figures as tables and pictures, in one file."""

from __future__ import annotations

import html
import io
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from catalog_tools.geometry.healpix import pixels_of
from pipeline.capacity.course import StudyCourse
from pipeline.capacity.results import COVERAGE, GAP_BINS_H, HOURS, ORDER, REACH, SENSORS
from pipeline.errors import Missing
from pipeline.lazily import blank_figure
from pipeline.report_page import document, picture, table

GAP_HEADS = {
    "objects": "objects",
    "gap_median_h": "median gap [h]",
    "gap_p95_h": "95 % [h]",
    "gap_longest_h": "longest [h]",
    "first_detection_h": "first detection [h]",
    "custody_fraction": "in custody",
}


def page(
    course: StudyCourse,
    report: JsonObject,
    tables: dict[str, pa.Table],
    gaps: dict[str, NDArray[np.int64]],
) -> str:
    """HTML of a study; without pictures, and a line that says so, where matplotlib is absent."""
    f = report["figures"]
    notes = [
        f"{f['objects']} objects, {len(course.units)} sensors, {report['hours']:g} h from "
        f"{report['start']}: {f['observations']} observations ({f['observations_per_hour']:.4g} an "
        f"hour), {f['detections']} detections of {f['objects_detected']} objects.",
        f"Detected at {report['threshold_sigma']:.2f} sigma: a false alarm rate of "
        f"{report['false_alarm_rate']:g} a frame and object, on Gaussian noise.",
        "Gaps run from the start to the first detection, between detections, and from the last one "
        "to the end; each object counts once in medians. The first detection is the time by which "
        "half of all objects were detected; – where it is less than half.",
        *report["notes"],
    ]
    keys = {"by_regime": "orbit", "by_kind": "kind of object", "by_altitude_km": "altitude [km]"}
    groups = (f"<h2>Gap time by {word}</h2>{_gap_table(report[k])}" for k, word in keys.items())
    sensors = [[_cell(v) for v in row.values()] for row in tables[SENSORS].to_pylist()]
    told = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    return document(
        course.study.name,
        f"<h1>{course.study.name}</h1><ul>{told}</ul>{''.join(groups)}"
        f"<h2>Sensors</h2>{table(tables[SENSORS].column_names, sensors)}{_pictures(tables, gaps)}",
    )


def _gap_table(groups: JsonObject) -> str:
    rows = [[name, *(_cell(g[key]) for key in GAP_HEADS)] for name, g in groups.items()]
    return table(["", *GAP_HEADS.values()], rows)


def _cell(value: Any) -> str:
    return "–" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def _pictures(tables: dict[str, pa.Table], gaps: dict[str, NDArray[np.int64]]) -> str:
    """Sky coverage, gap times, time line and smallest size, as one PNG inside the page."""
    try:
        figure = blank_figure((12.0, 9.0), layout="constrained")
    except Missing as missing:
        return f"<p>No pictures: {html.escape(str(missing))}</p>"
    _draw_sky(figure.add_subplot(2, 2, 1, projection="mollweide"), tables[COVERAGE])
    _draw_gaps(figure.add_subplot(2, 2, 2), gaps, float(len(tables[HOURS])))
    _draw_hours(figure.add_subplot(2, 2, 3), tables[HOURS])
    _draw_reach(figure.add_subplot(2, 2, 4), tables[REACH])
    held = io.BytesIO()
    figure.savefig(held, dpi=90, metadata={"Software": None})
    told = "sky coverage; gap times; observations an hour; smallest size against range"
    return picture(held.getvalue(), told)


def _draw_sky(axes: Any, coverage: pa.Table) -> None:
    """Observations by HEALPix pixel over right ascension (0 in the middle, east to the left)."""
    ra, dec = np.linspace(-179.5, 179.5, 360), np.linspace(-89.5, 89.5, 180)
    grid = np.meshgrid(-ra % 360.0, dec)
    counts = coverage["observations"].to_numpy()[pixels_of(ORDER, *(g.ravel() for g in grid))]
    shown = np.log10(1.0 + counts.reshape(grid[0].shape))
    mesh = axes.pcolormesh(
        np.radians(ra), np.radians(dec), shown, shading="nearest", rasterized=True
    )
    axes.figure.colorbar(mesh, ax=axes, shrink=0.6, label="log10(1 + observations)")
    axes.grid(alpha=0.3)
    axes.set_xticklabels([])
    axes.set_title("where was looked (RA 0 in the middle, HEALPix pixels)")


def _draw_gaps(axes: Any, gaps: dict[str, NDArray[np.int64]], longest_h: float) -> None:
    for name, counts in gaps.items():
        if counts.sum():
            share = np.cumsum(counts) / counts.sum()
            axes.step(GAP_BINS_H[1:], share, where="pre", label=name)
    axes.set(xscale="log", xlabel="gap [h]", ylabel="fraction of gaps up to it", title="gap times")
    axes.set_xlim(GAP_BINS_H[1], longest_h)
    axes.grid(alpha=0.3)
    axes.legend()


def _draw_hours(axes: Any, hours: pa.Table) -> None:
    for name in ("observations", "detections"):
        axes.step(hours["hour"].to_numpy(), hours[name].to_numpy(), where="post", label=name)
    axes.set(xlabel="hours from the start", ylabel="an hour", title="time line")
    axes.grid(alpha=0.3)
    axes.legend()


def _draw_reach(axes: Any, reach: pa.Table) -> None:
    for name in reach.column_names[1:][:12]:
        axes.plot(reach["range_km"].to_numpy(), reach[name].to_numpy(), label=name)
    axes.set(xscale="log", yscale="log", xlabel="range [km]", ylabel="diameter [m]")
    axes.set_title("smallest sphere detected in half of the frames")
    axes.grid(alpha=0.3, which="both")
    axes.legend()
