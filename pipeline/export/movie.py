"""Movies of a product: GIF by Pillow, MP4 by the ffmpeg that imageio-ffmpeg brings."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from io import BytesIO
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pipeline.errors import BadInput, Incomplete, Missing, why_broken
from pipeline.export.picture import GreyLimits, limits_of, shrink, stretch
from pipeline.store.cube import read_layer

MOST_GIF_BYTES = 1 << 29  # of grey pictures together, of which more than twice that is held
ROOM_BYTES = 1 << 20  # for which a disk has no room that was full for a film
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
    """An H.264 film; odd sides lose their last row or column, as the format asks.

    OSError where the disk is full, Incomplete where ffmpeg ended before the film was whole.
    """
    ffmpeg, writer, frames = encoder(), None, 0
    try:
        for picture in pictures:
            even = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
            if not even.size:
                raise BadInput("--to", "mp4", "frames of at least 2 x 2 pixels; or --to gif")
            if writer is None:
                writer = ffmpeg.write_frames(
                    str(path),
                    even.shape[::-1],
                    fps=fps,
                    pix_fmt_in="gray",
                    codec="libx264",
                    macro_block_size=2,
                    ffmpeg_log_level="error",
                    output_params=["-f", "mp4"],
                )
                writer.send(None)
            frames += 1
            if not _took(writer, np.ascontiguousarray(even)):
                break
    finally:
        if writer is not None:
            writer.close()
    _prove(ffmpeg, path, frames)


def _took(writer: Generator[None, object, None], picture: NDArray[np.uint8]) -> bool:
    """Whether ffmpeg took a picture: one that has ended takes none."""
    try:
        writer.send(picture)
    except OSError:
        return False
    return True


def _prove(ffmpeg: ModuleType, path: Path, frames: int) -> None:
    """Count the frames of a film: how ffmpeg ended is not told."""
    try:
        found, _ = ffmpeg.count_frames_and_secs(str(path))
    except RuntimeError:
        found = 0
    if found == frames:
        return
    with path.open("ab") as film:  # a disk that is full says so
        film.write(bytes(ROOM_BYTES))
    again = "run the same command again, or --to gif"
    raise Incomplete(f"mp4: ffmpeg ended before the film was whole; {again}")


def encoder() -> ModuleType:
    """imageio-ffmpeg; Missing where there is none, BadInput where it finds no ffmpeg."""
    try:
        import imageio_ffmpeg
    except ImportError as error:
        broken, instead = why_broken(error, "imageio_ffmpeg"), "use --to gif"
        raise Missing("MP4 movies", "imageio-ffmpeg", "movie", instead, "--to", broken) from None
    try:
        imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError:
        allowed = "gif; or mp4 with an ffmpeg that IMAGEIO_FFMPEG_EXE names"
        raise BadInput("--to", "mp4", allowed) from None
    return imageio_ffmpeg
