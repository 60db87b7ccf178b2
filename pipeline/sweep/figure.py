"""The figure of a sweep, as SVG text: a panel for each metric against each axis, points as dots."""

from __future__ import annotations

import html
import math

import numpy as np

from pipeline.arrays import Array

WIDTH_PX, HEIGHT_PX, LEFT_PX, UNDER_PX, GAP_PX = 250, 150, 90, 42, 14
MOST_DOTS = 4000
LOG_FROM = 30.0  # ratio of the largest to the least value from which an axis is logarithmic


def figure(columns: dict[str, Array], across: list[str], down: list[str]) -> str:
    """A row of panels for each of `down`, a column for each of `across`.

    columns : name -> (n,) values, NaN where there is none
    """
    width = LEFT_PX + len(across) * (WIDTH_PX + GAP_PX)
    height = len(down) * (HEIGHT_PX + GAP_PX) + UNDER_PX
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" font-family="sans-serif" font-size="11">'
        f'<rect width="{width}" height="{height}" fill="white"/>'
    ]
    for i, metric in enumerate(down):
        for j, axis in enumerate(across):
            x0, y0 = LEFT_PX + j * (WIDTH_PX + GAP_PX), i * (HEIGHT_PX + GAP_PX) + 6
            parts.append(_panel(columns[axis], columns[metric], x0, y0))
            if j == 0:
                parts.append(_scale_left(columns[metric], metric, y0))
            if i == len(down) - 1:
                parts.append(_scale_below(columns[axis], axis, x0, y0 + HEIGHT_PX))
    return "".join(parts) + "</svg>"


def _panel(x: Array, y: Array, x0: float, y0: float) -> str:
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    known = known[:: max(1, -(-known.size // MOST_DOTS))]
    at_x, at_y = x0 + _shares(x)[known] * WIDTH_PX, y0 + (1 - _shares(y)[known]) * HEIGHT_PX
    dots = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(at_x, at_y, strict=True))
    return (
        f'<rect x="{x0}" y="{y0}" width="{WIDTH_PX}" height="{HEIGHT_PX}" fill="none" '
        f'stroke="#888"/><path d="{dots}" stroke="#1f4e8c" stroke-opacity="0.6" stroke-width="4" '
        'stroke-linecap="round" fill="none"/>'
    )


def _scale_left(y: Array, name: str, y0: float) -> str:
    low, high = _ends(y)
    middle = y0 + HEIGHT_PX / 2
    return (
        f'<g text-anchor="end"><text x="{LEFT_PX - 5}" y="{y0 + HEIGHT_PX}">{low:.4g}</text>'
        f'<text x="{LEFT_PX - 5}" y="{y0 + 10}">{high:.4g}</text></g>'
        f'<text transform="translate(14 {middle}) rotate(-90)" text-anchor="middle">'
        f"{html.escape(name)}</text>"
    )


def _scale_below(x: Array, name: str, x0: float, y0: float) -> str:
    low, high = _ends(x)
    kind = " (log)" if _is_log(x) else ""
    return (
        f'<text x="{x0}" y="{y0 + 14}">{low:.4g}</text>'
        f'<text x="{x0 + WIDTH_PX}" y="{y0 + 14}" text-anchor="end">{high:.4g}</text>'
        f'<text x="{x0 + WIDTH_PX / 2}" y="{y0 + 30}" text-anchor="middle">'
        f"{html.escape(name)}{kind}</text>"
    )


def _ends(values: Array) -> tuple[float, float]:
    return float(np.nanmin(values)), float(np.nanmax(values))


def _is_log(values: Array) -> bool:
    low, high = _ends(values)
    return low > 0 and high > LOG_FROM * low


def _shares(values: Array) -> Array:
    """Places along an axis, 0.03 to 0.97; one value alone stands in the middle."""
    low, high = _ends(values)
    if high <= low:
        return np.full(len(values), 0.5)
    if _is_log(values):
        values, low, high = np.log(values), math.log(low), math.log(high)
    return 0.03 + 0.94 * (values - low) / (high - low)
