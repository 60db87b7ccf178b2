"""What came out of a sweep: a report, and a page with each metric drawn against each axis."""

from __future__ import annotations

import html
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from catalog_tools.documents import JsonObject
from catalog_tools.engine.code import own_version
from catalog_tools.storage.durable import write_atomically
from pipeline.spec.sweep import Sweep
from pipeline.sweep.figure import figure
from pipeline.sweep.ledger import FIGURE, PAGE, REPORT, TABLE

MOST_DRAWN, MOST_AXES, MOST_METRICS = 20_000, 5, 8
MOST_MESSAGES = 20
FOUND = "achieved_error_sigma"  # there where time is measured: what it is spent for
NOT_METRICS = ("point", "seed", "status", "message", "content_digest", "frames_in_view")


def summarise(sweep: Sweep, out: Path, names: tuple[str, ...], told: JsonObject) -> JsonObject:
    """Write report.json, summary.html and summary.svg; returns the report."""
    axes = [name for axis in sweep.axes for name in axis.fields if name != "seed"]
    file = pq.ParquetFile(out.absolute() / TABLE)
    metrics = [
        f.name
        for f in file.schema_arrow
        if f.name not in axes and f.name.split(".")[0] not in NOT_METRICS
    ]
    report: JsonObject = (
        {
            "sweep": sweep.name,
            "points": file.metadata.num_rows,
            "axes": axes,
            "targets": list(names),
            "metrics": {name: _spread(file, name) for name in metrics},
        }
        | _messages(file)
        | told
    )
    report["versions"] = {"nightglass": own_version()}
    write_atomically(out / REPORT, json.dumps(report, indent=2, allow_nan=False) + "\n")
    drawn = _draw(file, axes, metrics)
    if drawn is not None:
        write_atomically(out / FIGURE, drawn)
    write_atomically(out / PAGE, _page(report, drawn or ""))
    return report


def _messages(file: pq.ParquetFile) -> JsonObject:
    """How many points failed, or err by more than was stated; the commonest messages of each.

    Where no point's error was measured, whether they are as stated is not known (None).
    """
    counts: dict[str, Counter[str]] = {"failed": Counter(), "done": Counter()}
    for batch in file.iter_batches(columns=["message", "status"]):
        for text, status in zip(*(column.to_pylist() for column in batch.columns), strict=True):
            if text is not None:
                counts[status][text[:300]] += 1
    failed, doubts = counts["failed"], counts["done"]
    asked = FOUND in file.schema_arrow.names
    measured = _spread(file, FOUND)["known"] if asked else 0
    return {
        "failed": failed.total(),
        "messages": dict(failed.most_common(MOST_MESSAGES)),
        "errors": {
            "as_stated": not doubts if measured else None,
            "measured": measured,
            "doubted": doubts.total(),
        },
        "doubts": dict(doubts.most_common(MOST_MESSAGES)),
    }


def _spread(file: pq.ParquetFile, name: str) -> dict[str, float | int | None]:
    """Least, mean and largest of a metric, and at how many points it is known."""
    count, total, low, high = 0, 0.0, np.inf, -np.inf
    for batch in file.iter_batches(columns=[name]):
        values = batch.column(0).drop_null().to_numpy(zero_copy_only=False).astype(float)
        if values.size:
            count, total = count + values.size, total + float(values.sum())
            low, high = min(low, float(values.min())), max(high, float(values.max()))
    if not count:
        return {"known": 0, "least": None, "mean": None, "largest": None}
    return {"known": count, "least": low, "mean": total / count, "largest": high}


def _draw(file: pq.ParquetFile, axes: list[str], metrics: list[str]) -> str | None:
    """The figure: a row for each metric, a column for each numeric axis; None without any."""
    step = max(1, file.metadata.num_rows // MOST_DRAWN)
    rows = [b.take(_every(b.num_rows, step)) for b in file.iter_batches(columns=axes + metrics)]
    columns = {
        n: np.concatenate([_numbers(b.column(b.schema.get_field_index(n))) for b in rows])
        for n in axes + metrics
    }
    across = [n for n in axes if np.isfinite(columns[n]).any()][:MOST_AXES]
    down = [
        n
        for n in metrics
        if np.isfinite(columns[n]).any() and n.split(".")[0] not in ("seconds", "light_s")
    ][:MOST_METRICS]
    return figure(columns, across, down) if across and down else None


def _every(count: int, step: int) -> object:
    return pa.array(np.arange(0, count, step))


def _numbers(column: pa.ChunkedArray) -> np.ndarray:
    """A column as float64; what is no number is NaN."""
    if column.type in ("string", "large_string"):
        return np.full(len(column), np.nan)
    return np.array([np.nan if v is None else float(v) for v in column.to_pylist()])


def _page(report: JsonObject, picture: str) -> str:
    """The page: what was swept, each metric's spread, failures, the figure; needs no network."""
    cells = "".join(
        f"<tr><td>{html.escape(n)}</td><td>{s['known']}</td>"
        + "".join(f"<td>{_short(s[k])}</td>" for k in ("least", "mean", "largest"))
        + "</tr>"
        for n, s in report["metrics"].items()
    )
    faults = "".join(
        f"<li>{n} x <code>{html.escape(text)}</code></li>" for text, n in report["messages"].items()
    )
    name = html.escape(report["sweep"])
    doubts = [f"{n} x {text}" for text, n in report["doubts"].items()] + report["warnings"]
    told = "".join(f"<p><b>Warning</b>: {html.escape(text)}</p>" for text in doubts)
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{name}</title><style>"
        "body{font:15px/1.4 sans-serif;margin:2em;max-width:80em}table{border-collapse:collapse}"
        "td,th{padding:.15em .8em;text-align:right;border-bottom:1px solid #ddd}"
        "td:first-child,th:first-child{text-align:left}svg{max-width:100%;height:auto}</style>"
        f"<h1>{name}</h1><p>{report['points']} points, {report['failed']} failed, "
        f"{report['seconds']:.1f} s. Axes: {html.escape(', '.join(report['axes']))}.</p>"
        f"{told}<table><tr><th>metric<th>known<th>least<th>mean<th>largest</tr>"
        f"{cells}</table>{'<h2>Failures</h2><ul>' + faults + '</ul>' if faults else ''}{picture}\n"
    )


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
