"""COCO annotations: images, boxes, masks as run lengths, and the streak of every source."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.export.labels import CLASS_NAMES, STAR, TARGET, Labels
from pipeline.export.masks import RULE, Mask
from pipeline.export.times import ExposureTimes

KEYPOINTS = ["start", "middle", "end"]


def dataset(title: str) -> JsonObject:
    """A data set without images yet, with its categories and what its numbers mean."""
    return {
        "info": {
            "description": title,
            "masks": RULE.replace("THRESH", "its image's threshold_e"),
            "pixels": "row 0 is the image's first row; keypoints and streaks count from the centre "
            "of the first pixel, boxes from its outer corner",
            "time_system": "UTC",
        },
        "licenses": [],
        "categories": [
            {
                "id": kind,
                "name": CLASS_NAMES[kind].lower(),
                "supercategory": "source",
                "keypoints": KEYPOINTS,
                "skeleton": [[1, 2], [2, 3]],
            }
            for kind in (TARGET, STAR)
        ],
        "images": [],
        "annotations": [],
    }


def image_entry(number: int, name: str, shape: tuple[int, int], times: ExposureTimes) -> JsonObject:
    """One image; `date_captured` is the middle of the exposure."""
    iso = times.iso()
    return {
        "id": number,
        "file_name": name,
        "height": shape[0],
        "width": shape[1],
        "date_captured": iso["middle"],
        "exposure_start": iso["start"],
        "exposure_end": iso["end"],
        "exposure_s": times.seconds,
    }


def _flag(place: list[float], shape: tuple[int, int]) -> int:
    """Flag of a keypoint (x, y): 2, labelled and visible, or 1, labelled but off the frame."""
    x, y = place
    return 2 if -0.5 <= x < shape[1] - 0.5 and -0.5 <= y < shape[0] - 0.5 else 1


def annotation(
    number: int, image: int, labels: Labels, i: int, mask: Mask, shape: tuple[int, int]
) -> JsonObject | None:
    """One source of one image; None where none of its pixels lies in the frame."""
    box = mask.box
    if box is None:
        return None
    row, column, height, width = box
    at = {
        name: [float(getattr(labels, f"{axis}{which}_px")[i]) for axis in "xy"]
        for name, which in (
            ("start", "_start"),
            ("middle", ""),
            ("end", "_end"),
            ("light", "_light"),
        )
    }
    mags = {name: float(getattr(labels, name)[i]) for name in ("g_mag", "v_mag", "mag_ab")}
    return {
        "id": number,
        "image_id": image,
        "category_id": int(labels.kind[i]),
        "bbox": [column, row, width, height],
        "area": int(mask.pixels.sum()),
        "iscrowd": 0,
        "segmentation": {"size": list(shape), "counts": packed(run_lengths(mask, shape))},
        "keypoints": [v for name in KEYPOINTS for v in (*at[name], _flag(at[name], shape))],
        "num_keypoints": len(KEYPOINTS),
        "streak": {
            **at,
            "length_px": float(labels.length_px[i]),
            "angle_deg": float(labels.angle_deg[i]),
        },
        "name": str(labels.name[i]),
        "object_name": str(labels.object_name[i]),
        "electrons": float(labels.electrons[i]),
        "snr": float(labels.snr[i]),
        **{name: mag for name, mag in mags.items() if np.isfinite(mag)},
        "ra_deg": float(labels.ra_deg[i]),
        "dec_deg": float(labels.dec_deg[i]),
    }


def run_lengths(mask: Mask, shape: tuple[int, int]) -> list[int]:
    """Run lengths of a mask in its frame: down the columns, zeros first."""
    columns, rows = np.nonzero(mask.pixels.T)
    flat: NDArray[np.int64] = (columns + mask.x0).astype(np.int64) * shape[0] + rows + mask.y0
    total = shape[0] * shape[1]
    if not flat.size:
        return [total]
    breaks = np.flatnonzero(np.diff(flat) > 1)
    first = flat[np.concatenate([[0], breaks + 1])]
    last = flat[np.concatenate([breaks, [flat.size - 1]])] + 1
    edges = np.stack([first, last], axis=1).ravel()
    counts = np.diff(np.concatenate([[0], edges, [total]]))
    return [int(c) for c in (counts if counts[-1] else counts[:-1])]


def packed(counts: list[int]) -> str:
    """Run lengths as COCO's text: differences to the run before last, five bits a letter.

    The sixth bit of a letter says that more follow; the number's sign is that of its last one.
    """
    out = []
    for i, count in enumerate(counts):
        value = count - counts[i - 2] if i > 2 else count
        more = True
        while more:
            bits = value & 31
            value >>= 5
            more = value != (-1 if bits & 16 else 0)
            out.append(chr((bits | 32 if more else bits) + 48))
    return "".join(out)
