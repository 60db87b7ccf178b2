"""SatNet annotations: a JSON file a frame beside its FITS image, laid out as SatSim does."""

from __future__ import annotations

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.export.labels import CLASS_NAMES, STAR, Labels
from pipeline.export.times import ExposureTimes


def annotation(
    labels: Labels,
    times: ExposureTimes,
    shape: tuple[int, int],
    ifov_deg: float,
    file: JsonObject,
    pad_px: float,
) -> JsonObject:
    """The annotation of one frame.

    Places are shares of the frame's sides counted from its outer edge, (pixel + 0.5) / side; y
    follows the rows of the FITS array from the first one. Boxes hold the path from start to end;
    `bbox_height` and `bbox_width` have `pad_px` and the body's radius more on each side. `x_mid`,
    `y_mid` is the place at mid-exposure; `x_light`, `y_light` (our addition) the centroid of the
    light.
    """
    rows, columns = shape
    return {
        "data": {
            "file": file,
            "sensor": {"height": rows, "width": columns, "iFOVy": ifov_deg, "iFOVx": ifov_deg},
            "metadata": {"time_system": "UTC", **times.iso(), "exposure_s": times.seconds},
            "stats": {"num_obs": int(np.sum(labels.kind != STAR))},
            "objects": [
                _object(labels, i, shape, times.seconds, pad_px) for i in range(len(labels))
            ],
        }
    }


def _object(
    labels: Labels, i: int, shape: tuple[int, int], seconds: float, pad_px: float
) -> JsonObject:
    rows, columns = shape
    at = {
        f"{axis}_{name}": (float(getattr(labels, f"{axis}{column}_px")[i]) + 0.5) / side
        for name, column in (("start", "_start"), ("mid", ""), ("end", "_end"), ("light", "_light"))
        for axis, side in (("y", rows), ("x", columns))
    }
    around_px = pad_px + float(labels.radius_px[i])
    box: dict[str, float] = {}
    path = np.transpose(labels.path_px(i))
    for axis, side, size, px in zip("yx", shape, ("height", "width"), path[::-1], strict=True):
        ends = [(float(place) + 0.5) / side for place in px]
        box |= {f"{axis}_min": min(ends), f"{axis}_max": max(ends)}
        box[f"{axis}_center"] = 0.5 * (min(ends) + max(ends))
        box[f"bbox_{size}"] = max(ends) - min(ends) + 2.0 * around_px / side
    kind = int(labels.kind[i])
    mag = float(labels.magnitude[i])
    name = str(labels.name[i])
    return {
        "class_name": CLASS_NAMES[kind],
        "class_id": kind,
        **box,
        **at,
        "source": "nightglass",
        "magnitude": mag if np.isfinite(mag) else None,
        "pe_per_sec": float(labels.electrons[i]) / seconds,
        "snr": float(labels.snr[i]),
        "ra": float(labels.ra_deg[i]),
        "dec": float(labels.dec_deg[i]),
        "seg_id": i + 1,
        "object_name": str(labels.object_name[i]) if kind != STAR else "",
        "object_id": name,
    }
