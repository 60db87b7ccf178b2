"""The figure: error against CPU time, a panel a case, the Pareto front marked."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from catalog_tools.documents import JsonObject
from pipeline.lazily import blank_figure

Row = JsonObject

# Okabe & Ito's colours, told apart with every common colour blindness; shapes tell them apart too.
STYLES: dict[str, tuple[str, str]] = {
    "products": ("#E69F00", "p"),
    "stamps, linear": ("#0072B2", "o"),
    "stamps, cubic": ("#56B4E9", "s"),
    "core radius": ("#009E73", "D"),
    "wing grid": ("#009E73", "d"),
    "spectral": ("#D55E00", "^"),
    "tiles": ("#56B4E9", "_"),
    "streak as points": ("#7F7F7F", "v"),
    "GalSim": ("#000000", "x"),
    "photutils": ("#000000", "+"),
    "SatSim, FFT": ("#000000", "1"),
    "SatSim, table": ("#000000", "2"),
    "SkyMaker": ("#000000", "*"),
}
BELOW_IN = 1.75  # inches below the panels, for their axis and the legend
LEAST_ERROR = 1e-10  # points below stand on the lower edge, pointed at by their value


def draw_figure(study: JsonObject, path: Path) -> None:
    """Write the figure of a study (PNG or SVG, by the name's ending).

    Raises Missing where matplotlib is not installed.
    """
    rows = [r for r in study["records"] if not r["curved"] and r["engine"] != "tiles"]
    psfs = list(dict.fromkeys(r["psf"] for r in rows))
    streaks = sorted({r["streak_px"] for r in rows})
    width, height = 4.0 * len(streaks) + 0.9, 3.4 * len(psfs) + BELOW_IN
    figure = blank_figure((width, height), dpi=110)
    axes = figure.subplots(len(psfs), len(streaks), sharex=True, sharey=True, squeeze=False)
    for panel, (psf, streak) in zip(axes.flat, product(psfs, streaks), strict=True):
        mine = [r for r in rows if (r["psf"], r["streak_px"]) == (psf, streak)]
        _panel(panel, mine, psf, streak)
    figure.subplots_adjust(
        left=0.8 / width,
        right=1.0 - 0.15 / width,
        top=1.0 - 0.4 / height,
        bottom=BELOW_IN / height,
        wspace=0.09,
        hspace=0.2,
    )
    _legend(figure, axes, study, 5 if len(streaks) > 2 else 3)
    figure.savefig(path)


def _panel(ax: Any, rows: list[Row], psf: str, streak_px: float) -> None:
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.grid(True, which="major", color="#DDDDDD", linewidth=0.6)
    ax.set_axisbelow(True)
    moving = f"{streak_px:g} px streak" if streak_px else "no streak"
    ax.set_title(f"{psf}, {moving}", fontsize=11)
    if not rows:
        ax.text(0.5, 0.5, "not measured", ha="center", va="center", transform=ax.transAxes)
        return
    _front(ax, rows)
    for engine, (colour, marker) in STYLES.items():
        mine = [r for r in rows if r["engine"] == engine]
        if not mine:
            continue
        x, y = [r["cpu_s"] for r in mine], [_shown(r) for r in mine]
        hollow = {"markerfacecolor": "none"} if engine == "core radius" else {}
        ax.plot(
            x,
            y,
            color=colour,
            marker=marker,
            markersize=7,
            linewidth=0.8,
            alpha=0.95,
            label=engine,
            **hollow,
        )
    one_sigma = rows[0]["error_of_peak"] / rows[0]["error_sigma"]
    ax.axhline(one_sigma, color="#444444", linestyle=":", linewidth=1.2)


def _shown(row: Row) -> float:
    return float(max(row["error_of_peak"], LEAST_ERROR))


def _front(ax: Any, rows: list[Row]) -> None:
    """The Pareto front as a staircase under the points, its members ringed."""
    front = sorted((r["cpu_s"], _shown(r)) for r in rows if r["pareto"])
    if not front:
        return
    x, y = zip(*front, strict=True)
    ax.plot(
        x,
        y,
        color="#F0E442",
        linewidth=7,
        alpha=0.8,
        zorder=1,
        solid_capstyle="round",
        drawstyle="steps-post",
    )
    ax.plot(
        x,
        y,
        linestyle="none",
        marker="o",
        markersize=13,
        markerfacecolor="none",
        markeredgecolor="#B8A500",
        markeredgewidth=1.5,
        zorder=1.5,
    )


def _legend(figure: Any, axes: Any, study: JsonObject, columns_of_names: int) -> None:
    from matplotlib.lines import Line2D

    names: dict[str, object] = {}
    for ax in axes.ravel():
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            names.setdefault(label, handle)
    names["Pareto front"] = Line2D(
        [],
        [],
        color="#F0E442",
        linewidth=7,
        marker="o",
        markersize=12,
        markerfacecolor="none",
        markeredgecolor="#B8A500",
    )
    noise = study["noise"]
    names[f"noise under a star of {noise['star_e']:,.0f} e-"] = Line2D(
        [], [], color="#444444", linestyle=":"
    )
    for ax in axes[:, 0]:
        ax.set_ylabel("largest error of a pixel / peak of its star")
    rows, columns = study["frame"]
    for ax in axes[-1]:
        ax.set_xlabel(f"CPU seconds, {study['stars']:,} stars, {columns} x {rows}")
    figure.legend(
        list(names.values()),
        list(names),
        loc="lower center",
        ncol=columns_of_names,
        fontsize=10,
        frameon=False,
    )
