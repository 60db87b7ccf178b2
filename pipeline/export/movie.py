"""Movies of a product: GIF by Pillow, MP4 by the ffmpeg that imageio-ffmpeg brings."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pipeline.errors import BadInput, Missing, why_broken
from pipeline.export.picture import GreyLimits, limits_of, shrink, stretch
from pipeline.store.cube import read_layer

MOST_GIF_BYTES = 1 << 29  # of grey pictures together, of which more than twice that is held
MOST_SAMPLES = 16  # frames that the common grey levels are taken from


def movie_frames(
    product: Path, frames: list[int], layer: str, side_px: int
) -> Iterator[NDArray[np.uint8]]:
    """Grey pictures (rows, columns) of frames, row 0 at the bottom, all by the same levels."""
    sample = frames[:: max(1, len(frames) // MOST_SAMPLES)]
    limits = [limits_of(shrink(read_layer(product, layer, k), side_px)[0]) for k in sample]
    common = GreyLimits(*(float(v) for v in np.median(np.array(limits), axis=0)))
    for k in frames:
        small, _ = shrink(read_layer(product, layer, k), side_px)
        yield stretch(small, common)[::-1]


def gif_bytes(pictures: Iterator[NDArray[np.uint8]], frames: int, fps: float) -> bytes:
    """An endless GIF of so many frames, which are held together until it is written.

    A frame lasts a whole number of 10 ms, and at least 20 ms. BadInput for too many frames.
    """
    first = next(pictures)
    if frames * first.nbytes > MOST_GIF_BYTES:
        allowed = f"gif of at most {MOST_GIF_BYTES // first.nbytes} frames of this size; or mp4"
        raise BadInput("--to", f"gif of {frames} frames", allowed)
    images = [Image.fromarray(p) for p in pictures]
    out = BytesIO()
    Image.fromarray(first).save(
        out,
        format="GIF",
        save_all=True,
        append_images=images,
        loop=0,
        duration=max(20, round(100.0 / fps) * 10),
    )
    return out.getvalue()


def write_mp4(pictures: Iterator[NDArray[np.uint8]], path: Path, fps: float) -> None:
    """An H.264 film; odd sides lose their last row or column, as the format asks."""
    writer = None
    try:
        for picture in pictures:
            even = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
            if not even.size:
                raise BadInput("--to", "mp4", "frames of at least 2 x 2 pixels; or --to gif")
            if writer is None:
                writer = encoder()(
                    str(path),
                    even.shape[::-1],
                    fps=fps,
                    pix_fmt_in="gray",
                    codec="libx264",
                    macro_block_size=2,
                    ffmpeg_log_level="error",
                )
                writer.send(None)
            writer.send(np.ascontiguousarray(even))
    finally:
        if writer is not None:
            writer.close()


def encoder() -> Callable[..., Generator[None, object, None]]:
    """imageio-ffmpeg's writer; Missing where there is none, BadInput where it finds no ffmpeg."""
    try:
        from imageio_ffmpeg import get_ffmpeg_exe, write_frames
    except ImportError as error:
        broken, instead = why_broken(error, "imageio_ffmpeg"), "use --to gif"
        raise Missing("MP4 movies", "imageio-ffmpeg", "movie", instead, "--to", broken) from None
    try:
        get_ffmpeg_exe()
    except RuntimeError:
        allowed = "gif; or mp4 with an ffmpeg that IMAGEIO_FFMPEG_EXE names"
        raise BadInput("--to", "mp4", allowed) from None
    return write_frames
