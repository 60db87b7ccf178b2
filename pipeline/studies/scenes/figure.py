"""The report's figures: error against run time of each scene, and each approximation's bound."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from catalog_tools.documents import JsonObject
from pipeline.lazily import blank_figure

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = JsonObject

# Okabe & Ito's colours; shapes tell them apart too.
MOST, RMS, AGAIN, ASKED = "#0072B2", "#009E73", "#56B4E9", "#D55E00"
COLUMNS, PANEL_IN = 4, (3.1, 2.9)
LEAST = 1e-7  # sigma: what is smaller stands on the lower edge


def ladder_figure(study: JsonObject) -> bytes:
    """Error against CPU time, a panel a scene, as PNG."""
    scenes = study["scenes"]
    columns = min(COLUMNS, len(scenes))
    rows = -(-len(scenes) // columns)
    figure, axes = _figure(rows, columns)
    for ax, scene in zip(axes.ravel(), scenes, strict=False):
        _panel(ax, scene)
    for ax in axes.ravel()[len(scenes) :]:
        ax.set_axis_off()
    for ax in axes[:, 0]:
        ax.set_ylabel("error of a pixel / its noise")
    handles, labels = axes.ravel()[0].get_legend_handles_labels()
    across = 4 if columns > 2 else 2
    figure.legend(
        handles, labels, loc="outside lower center", ncols=across, fontsize=9, frameon=False
    )
    return _png(figure)


def _panel(ax: Axes, scene: Row) -> None:
    levels = scene["levels"]
    first = [r["cpu_s"] for r in levels]
    again = [r["again_cpu_s"] for r in levels]
    most, rms = ([max(r[k], LEAST) for r in levels] for k in ("max_sigma", "rms_sigma"))
    ax.set(xscale="log", yscale="log", xlabel="CPU s of a render")
    ax.set_title(scene["title"], fontsize=10)
    ax.grid(True, which="major", color="#DDDDDD", linewidth=0.6)
    ax.set_axisbelow(True)
    asked = [r["noise_fraction"] for r in levels]
    ax.plot(first, asked, color=ASKED, marker="_", ms=14, mew=2, ls=":", lw=1, label="asked for")
    ax.plot(first, most, color=MOST, marker="o", ms=6, label="largest error")
    ax.plot(first, rms, color=RMS, marker="s", ms=5, label="rms error")
    ax.plot(
        again,
        most,
        color=AGAIN,
        marker="o",
        ms=6,
        mfc="none",
        ls="--",
        lw=0.9,
        label="largest, second render of the process",
    )
    low, high = min(first + again), max(first + again)
    if high < 3.0 * low:
        ax.set_xlim(low / 1.8, high * 1.8)
    ax.xaxis.set_major_formatter(_plain)
    ax.xaxis.set_minor_formatter(_few)


def _plain(value: float, _: float) -> str:
    return f"{value:g}"


def _few(value: float, _: float) -> str:
    """A tick between the decades: 2 and 5 alone."""
    digit = f"{value:.0e}"[0]
    return f"{value:g}" if digit in "25" else ""


def omission_figure(study: JsonObject) -> bytes:
    """Each approximation's bound beside the error that it caused, as PNG."""
    rows = [
        (scene["title"], s)
        for scene in study["scenes"]
        for s in scene["switches"]
        if not s["of_light"] and s["bound_sigma"] > 0
    ]
    figure, axes = _figure(1, 1, (9.5, max(2.2, 0.27 * len(rows) + 1.3)))
    ax = axes[0][0]
    for i, (_, s) in enumerate(rows):
        error = max(s["error_sigma"], LEAST)
        ax.plot([error, s["bound_sigma"]], [i, i], color="#BBBBBB", lw=1.2, zorder=1)
        ax.plot(error, i, color=MOST, marker="o", ms=6, label="" if i else "error caused")
        ax.plot(
            s["bound_sigma"],
            i,
            color=ASKED,
            marker="|",
            ms=12,
            mew=2.5,
            ls="none",
            label="" if i else "bound stated",
        )
    ax.set_yticks(range(len(rows)), [f"{t}: {s['component']}" for t, s in rows], fontsize=8)
    ax.invert_yaxis()
    ax.set(xscale="log", xlabel="sigma of a pixel's noise")
    ax.grid(True, axis="x", which="major", color="#DDDDDD", linewidth=0.6)
    ax.set_axisbelow(True)
    if rows:
        ax.legend(fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    return _png(figure)


def _figure(
    rows: int, columns: int, size: tuple[float, float] | None = None
) -> tuple[Figure, np.ndarray]:
    size = size or (PANEL_IN[0] * columns + 0.4, PANEL_IN[1] * rows + 0.5)
    figure = blank_figure(size, dpi=110, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def _png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png")
    return out.getvalue()
