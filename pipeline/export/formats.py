"""Every format that a product is exported to: one door, what each needs, what it writes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from catalog_tools.storage.durable import full_disk_told, whole_file
from pipeline.errors import BadInput, check_new
from pipeline.export import coco, satnet
from pipeline.export.files import KINDS as FRAME_KINDS
from pipeline.export.files import export_frames, fits_bytes, frames_of, layers_of
from pipeline.export.header import fits_header, scene_of
from pipeline.export.labels import Labels, frame_labels
from pipeline.export.masks import RULE, classes_from_light, mask_fits, paint, source_masks
from pipeline.export.movie import encoder, gif_bytes, movie_frames, write_mp4
from pipeline.export.picture import png_bytes
from pipeline.export.response import source_light
from pipeline.export.times import exposure_of
from pipeline.store.cube import open_cube, read_layer
from pipeline.store.layout import REPORT, read_json, write_atomically

if TYPE_CHECKING:
    import xarray as xr

    from pipeline.export.response import SourceLight

PAD_FRACTION = 0.9  # of a point's light within the margin of a SatNet box
MOVIE_PX = 1024
START_AGAIN = "make room, remove what was written there, and start again"


@dataclass(frozen=True)
class ExportRequest:
    """What of a product is exported, and how.

    frame : one frame alone; layer : for frames and movies
    stars_snr : stars from this signal-to-noise on are labelled; None: targets alone
    threshold_sigma : of masks, in units of the noise of a pixel without a source
    light : `response` masks from each source's response and path alone, `layers` classes from
        the noise-free layers; fps : of movies
    """

    frame: int | None = None
    layer: str = "dn"
    stars_snr: float | None = None
    threshold_sigma: float = 1.0
    light: str = "response"
    fps: float = 5.0


def export_product(
    product: Path, kind: str, output: Path, request: ExportRequest
) -> Iterator[Path]:
    """Write a complete product in another format; yields each file as it is whole.

    Raises BadInput for a format, layer, frame or number that is not accepted, and for an output
    that exists already.
    """
    if kind not in FORMATS:
        raise BadInput("--to", kind, ", ".join(FORMATS))
    with full_disk_told(output, START_AGAIN):
        if kind in FRAME_KINDS:
            yield from export_frames(product, kind, output, request.frame, request.layer)
        else:
            yield from _export_all(product, kind, output, request)


def _export_all(product: Path, kind: str, output: Path, request: ExportRequest) -> Iterator[Path]:
    """Formats of more than frames."""
    named = kind not in ("gif", "mp4") or output.suffix == f".{kind}"
    fps, sigma, snr = request.fps, request.threshold_sigma, request.stars_snr
    for good, field, value, allowed in (
        (named, "-o", str(output), f"a path ending in .{kind}"),
        (0.01 <= fps <= 100, "--fps", fps, "0.01 to 100"),
        (0 < sigma < 1e6, "--threshold", sigma, "above 0 and below 1e6"),
        (request.light in ("response", "layers"), "--light", request.light, "response or layers"),
        (snr is None or snr >= 0, "--stars-snr", snr, "a number of at least 0"),
    ):
        if not good:
            raise BadInput(field, value, allowed)
    check_new(output)
    job = _Job(product, request)
    yield from WRITERS[kind](job, output)


class _Job:
    """A product that is being exported: its cube, frames, noise and labels."""

    def __init__(self, product: Path, request: ExportRequest) -> None:
        self.product, self.request = product, request
        self.cube: xr.Dataset = open_cube(product)
        self.layers = layers_of(self.cube)
        self.frames = frames_of(self.cube, self.layers, request.layer, request.frame)

    @property
    def name(self) -> str:
        return str(self.cube.attrs["title"])

    @property
    def shape(self) -> tuple[int, int]:
        return int(self.cube.sizes["y"]), int(self.cube.sizes["x"])

    @cached_property
    def light(self) -> SourceLight:
        return source_light(scene_of(self.cube))

    @cached_property
    def _noise_e(self) -> list[float]:
        """Noise of an empty pixel in the middle of each frame, or one number for all; of products
        of earlier versions that of the darkest place and the shortest exposure."""
        report = read_json(self.product / REPORT)
        return list(report.get("empty_noise_e", [report["errors"]["noise_floor_e"]]))

    def threshold_e(self, frame: int) -> float:
        """Least electrons of a mask's pixel in a frame."""
        noise_e = self._noise_e[frame if len(self._noise_e) > 1 else 0]
        return self.request.threshold_sigma * float(noise_e)

    def labels(self, frame: int) -> Labels:
        return frame_labels(self.product, frame, self.shape, self.request.stars_snr)


def _movie(job: _Job, output: Path) -> Iterator[Path]:
    pictures = movie_frames(job.product, job.frames, job.request.layer, MOVIE_PX)
    if output.suffix == ".mp4":
        encoder()
    output.parent.mkdir(parents=True, exist_ok=True)
    if output.suffix == ".gif":
        write_atomically(output, gif_bytes(pictures, len(job.frames), job.request.fps))
    else:
        with whole_file(output) as own:
            own.touch()  # says why a place is none for a file, which ffmpeg does not
            write_mp4(pictures, own, job.request.fps)
    yield output


def _satnet(job: _Job, output: Path) -> Iterator[Path]:
    """ImageFiles/NAME.0000.fits and Annotations/NAME.0000.json."""
    pad = job.light.enclosing_px(PAD_FRACTION)
    ifov_deg = float(np.degrees(job.cube.attrs["ifov_rad"]))
    for folder in ("ImageFiles", "Annotations"):
        (output / folder).mkdir(parents=True)
    for k in job.frames:
        stem = f"{job.name}.{k:04d}"
        image = output / "ImageFiles" / f"{stem}.fits"
        write_atomically(image, fits_bytes(job.product, job.cube, k, job.request.layer))
        yield image
        file = {"dirname": output.name, "sequence": 0, "filename": image.name, "sequence_id": k}
        told = satnet.annotation(
            job.labels(k), exposure_of(job.cube, k), job.shape, ifov_deg, file, pad
        )
        path = output / "Annotations" / f"{stem}.json"
        write_atomically(path, _compact(told))
        yield path


def _coco(job: _Job, output: Path) -> Iterator[Path]:
    """images/frame-00000.png (16 bits; FITS where these do not hold the numbers), annotations."""
    (output / "images").mkdir(parents=True)
    data = coco.dataset(job.name)
    for number, k in enumerate(job.frames, start=1):
        image = _write_image(job, k, output / "images" / f"frame-{k:05d}")
        yield image
        labels, least_e = job.labels(k), job.threshold_e(k)
        entry = coco.image_entry(number, image.name, job.shape, exposure_of(job.cube, k))
        data["images"].append(entry | {"threshold_e": least_e})
        for i, mask in enumerate(source_masks(labels, job.light, job.shape, least_e)):
            one = coco.annotation(len(data["annotations"]) + 1, number, labels, i, mask, job.shape)
            if one is not None:
                data["annotations"].append(one)
    path = output / "annotations.json"
    write_atomically(path, _compact(data))
    yield path


def _compact(value: object) -> bytes:
    """JSON on one line; NaN is refused rather than written."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()


def _write_image(job: _Job, frame: int, stem: Path) -> Path:
    """A frame in the order of the array: row 0 is the picture's first row."""
    image = read_layer(job.product, job.request.layer, frame)
    if image.dtype.kind == "u" and int(image.max(initial=0)) < 1 << 16:
        path = stem.with_suffix(".png")
        write_atomically(path, png_bytes(Image.fromarray(image.astype(np.uint16))))
        return path
    path = stem.with_suffix(".fits")
    write_atomically(path, fits_bytes(job.product, job.cube, frame, job.request.layer))
    return path


def _masks(job: _Job, output: Path) -> Iterator[Path]:
    """frame-00000.fits: classes, source numbers, and the table of the sources."""
    output.mkdir(parents=True)
    for k in job.frames:
        labels, least_e = job.labels(k), job.threshold_e(k)
        masks = source_masks(labels, job.light, job.shape, least_e)
        owner = paint(labels, masks, job.shape)
        classes = np.concatenate([[0], labels.kind]).astype(np.uint8)[owner]
        if job.request.light == "layers":
            classes = classes_from_light(job.product, k, job.layers, least_e)
        cards = fits_header(job.cube, k, job.request.layer)
        cards = [c for c in cards if c[0] not in ("BUNIT", "SATURATE")] + [
            ("THRESH", least_e, "[e-] least light of a mask's pixel"),
            ("CLASSBY", job.request.light, "what CLASS is made from"),
            ("COMMENT", "CLASS: 1 target, 2 star, 0 none; SOURCE: number in the table SOURCES", ""),
            ("COMMENT", RULE, ""),
        ]
        path = output / f"frame-{k:05d}.fits"
        write_atomically(path, mask_fits(labels, owner, classes, cards))
        yield path


WRITERS: dict[str, Callable[[_Job, Path], Iterator[Path]]] = {
    "gif": _movie,
    "mp4": _movie,
    "satnet": _satnet,
    "coco": _coco,
    "masks": _masks,
}
FORMATS = (*FRAME_KINDS, *WRITERS)
