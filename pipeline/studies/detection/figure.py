"""The detection study's figure: completeness by magnitude, and a piece of the first frame."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.export.labels import TARGET
from pipeline.export.picture import stretch
from pipeline.lazily import blank_figure
from pipeline.studies.detection.finders import TITLES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"sep": "#0072B2", "sep_cleaned": "#56B4E9", "drift": "#D55E00", "lines": "#F0E442"}
SIDE_PX = 360


def draw_figure(study: JsonObject, shown: JsonObject, path: Path) -> None:
    """Write the figure as PNG."""
    figure = blank_figure((11, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1.0))
    _completeness(left, study)
    _piece(right, shown)
    figure.savefig(path, dpi=110)


def _completeness(axes: Axes, study: JsonObject) -> None:
    for kind, told in study["finders"].items():
        bins = [b for b in told["stars"] if b["sought"]]
        if not bins:
            continue
        at = [0.5 * (b["bright_mag"] + b["faint_mag"]) for b in bins]
        share = np.array([b["completeness"] for b in bins])
        count = np.array([b["sought"] for b in bins])
        error = np.sqrt(np.maximum(share * (1 - share), 0.25 / count) / count)  # binomial
        axes.errorbar(
            at,
            share,
            error,
            color=COLOURS[kind],
            marker="o",
            ms=4,
            capsize=2,
            label=f"stars: {TITLES[kind]}",
        )
    found = [t for t in study["targets"] if t["found"]]
    told = "\n".join(
        f"{TITLES[k]} {v['false_alarms'] / study['frames']:.1f}"
        for k, v in study["finders"].items()
    )
    axes.set_title(
        f"found, each target by each finder: {len(found)} of {len(study['targets'])}\n"
        f"false alarms a frame: {told}",
        fontsize=9,
        loc="left",
    )
    axes.set(xlabel="Gaia G [mag]", ylabel="fraction found", ylim=(-0.03, 1.05))
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, loc="lower left")


def _piece(axes: Axes, shown: JsonObject) -> None:
    """Part of the first frame around a target: truth circled, detections marked."""
    labels, image = shown["labels"], shown["image"]
    rows, columns = image.shape
    targets = np.flatnonzero(labels.kind == TARGET)
    long = targets[np.argsort(-labels.length_px[targets])] if targets.size else targets
    x, y = (labels.x_px[long[0]], labels.y_px[long[0]]) if targets.size else (columns / 2, rows / 2)
    x0 = int(np.clip(x - SIDE_PX / 2, 0, max(0, columns - SIDE_PX)))
    y0 = int(np.clip(y - SIDE_PX / 2, 0, max(0, rows - SIDE_PX)))
    cut = image[y0 : y0 + SIDE_PX, x0 : x0 + SIDE_PX]
    extent = (x0 - 0.5, x0 + cut.shape[1] - 0.5, y0 - 0.5, y0 + cut.shape[0] - 0.5)
    axes.imshow(stretch(cut), cmap="gray", origin="lower", extent=extent)
    for kind, (found, verdict) in ((k, shown[k]) for k in COLOURS if k in shown):
        near = np.hypot(found.x_px - x0 - SIDE_PX / 2, found.y_px - y0 - SIDE_PX / 2) < SIDE_PX
        found = found.take(near)
        right, false = verdict.right[near], ~(verdict.explained | verdict.right)[near]
        half_x = 0.5 * found.length_px * np.cos(found.angle_rad)
        half_y = 0.5 * found.length_px * np.sin(found.angle_rad)
        for mark, which in (("+", right), ("x", false)):
            axes.plot(
                found.x_px[which], found.y_px[which], mark, color=COLOURS[kind], ms=5, mew=0.9
            )
        ends = (found.length_px > 0) & right
        steps = np.array([[-1.0], [1.0]])
        axes.plot(
            found.x_px[ends] + half_x[ends] * steps,
            found.y_px[ends] + half_y[ends] * steps,
            color=COLOURS[kind],
            lw=0.8,
        )
    axes.scatter(
        labels.x_light_px[targets],
        labels.y_light_px[targets],
        s=160,
        facecolors="none",
        edgecolors="#50FF78",
        linewidths=1.0,
    )
    for i in targets:
        if extent[0] < labels.x_px[i] < extent[1] and extent[2] < labels.y_px[i] < extent[3]:
            axes.annotate(
                str(labels.name[i]),
                (labels.x_px[i] + 9, labels.y_px[i] + 9),
                color="#50FF78",
                fontsize=8,
            )
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="x [px]", ylabel="y [px]")
    axes.set_title("+ right, x nothing there; green: targets", fontsize=9, loc="left")
