"""The detection study: finders on a product's frames, what they find and what is not there."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from catalog_tools.documents import JsonObject
from catalog_tools.engine.ahead import ahead, cores, threads
from pipeline.errors import BadInput, Missing, make_folder
from pipeline.export.labels import TARGET, Labels, frame_labels
from pipeline.store.cube import open_raw_cube, read_layer
from pipeline.studies.detection.finders import tasks
from pipeline.studies.detection.judge import POINT_PX, DetectionVerdict, by_magnitude, judge
from pipeline.studies.detection.points import Detections, flattened
from pipeline.studies.detection.tables import markdown
from pipeline.studies.written import write_study

Progress = Callable[[str, int, int], None]


def report_detection(
    product: Path,
    out: Path,
    threshold_sigma: float = 5.0,
    frames: int | None = None,
    progress: Progress | None = None,
) -> JsonObject:
    """Run the finders on a product's frames and write detection.json, .md and .png into `out`.

    frames : the first so many; default: all. progress : called with (stage, done, total)
    Returns what detection.json holds. Raises BadInput for numbers out of range, and before any
    work where a library is missing.
    """
    if not 1.0 <= threshold_sigma <= 1e4:
        raise BadInput("--threshold", threshold_sigma, "1 to 10000")
    for library in ("sep", "matplotlib"):
        if find_spec(library) is None:
            raise Missing("studies of detection", library, "detection")
    cube = open_raw_cube(product)
    count = int(cube.sizes["frame"]) if frames is None else min(frames, int(cube.sizes["frame"]))
    if count < 1:
        raise BadInput("--frames", frames, "1 or more")
    make_folder(out)
    shape = int(cube.sizes["y"]), int(cube.sizes["x"])
    told: list[JsonObject] = []
    shown: dict[str, object] = {}
    search = partial(_frame, product, shape, threshold_sigma)
    with threads(cores()) as pool:
        for k, (mine, seen) in enumerate(ahead(pool, search, range(count), cores())):
            told += mine
            shown |= seen
            if progress is not None:
                progress("frames searched", k + 1, count)
    study = {
        "product": product.name,
        "frames": count,
        "threshold_sigma": threshold_sigma,
        "point_px": POINT_PX,
        "finders": _summed(told),
        "targets": _targets(told),
    }
    _write(study, shown, out)
    return study


def _frame(
    product: Path, shape: tuple[int, int], threshold_sigma: float, frame: int
) -> tuple[list[JsonObject], JsonObject]:
    """Each finder on one frame; of the first frame also what the figure shows."""
    labels = frame_labels(product, frame, shape, 0.0)
    image, noise = flattened(read_layer(product, "dn", frame))
    told: list[JsonObject] = []
    shown: dict[str, object] = {"image": image, "labels": labels}
    for task in tasks(labels, image):
        found = task.find(task.image, noise, threshold_sigma)
        verdict = judge(labels, task.sought, found)
        told.append(_one(frame, task.kind, labels, task.sought, found, verdict))
        shown[task.kind] = (found, verdict)
    return told, shown if frame == 0 else {}


def _one(
    frame: int,
    kind: str,
    labels: Labels,
    sought: np.ndarray,
    found: Detections,
    verdict: DetectionVerdict,
) -> JsonObject:
    """One finder on one frame."""
    mags = labels.g_mag[np.isfinite(labels.g_mag)]
    low, high = (np.floor(mags.min()), np.floor(mags.max()) + 1.0) if mags.size else (0.0, 1.0)
    targets = np.flatnonzero(labels.kind == TARGET)
    return {
        "frame": frame,
        "finder": kind,
        "detections": len(found),
        "right": int(verdict.right.sum()),
        "fragments": verdict.fragments,
        "false_alarms": verdict.false,
        "stars": by_magnitude(labels, sought, verdict.found, np.arange(low, high + 0.5, 0.5)),
        "targets": [
            {
                "name": str(labels.name[i]),
                "snr": float(labels.snr[i]),
                "length_px": float(labels.length_px[i]),
                "found": bool(verdict.found[i]),
            }
            for i in targets
            if sought[i]
        ],
    }


def _summed(told: list[JsonObject]) -> JsonObject:
    """All frames of each finder together."""
    out: JsonObject = {}
    for kind in dict.fromkeys(t["finder"] for t in told):
        mine = [t for t in told if t["finder"] == kind]
        bins: dict[tuple[float, float], list[int]] = {}
        for t in mine:
            for b in t["stars"]:
                both = bins.setdefault((b["bright_mag"], b["faint_mag"]), [0, 0])
                both[0] += b["sought"]
                both[1] += b["found"]
        out[kind] = {
            name: sum(t[name] for t in mine)
            for name in ("detections", "right", "fragments", "false_alarms")
        } | {
            "stars": [
                {
                    "bright_mag": low,
                    "faint_mag": high,
                    "sought": n,
                    "found": m,
                    "completeness": m / n if n else None,
                }
                for (low, high), (n, m) in sorted(bins.items())
            ]
        }
    return out


def _targets(told: list[JsonObject]) -> list[JsonObject]:
    return [
        {"frame": t["frame"], "finder": t["finder"]} | one for t in told for one in t["targets"]
    ]


def _write(study: JsonObject, shown: JsonObject, out: Path) -> None:
    from pipeline.studies.detection.figure import draw_figure

    write_study(out / "detection.json", study)
    (out / "detection.md").write_text(markdown(study))
    draw_figure(study, shown, out / "detection.png")
