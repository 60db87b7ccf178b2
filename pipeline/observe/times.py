"""Times at which a scene is observed: its exposures, or exposures like them at other times."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.physics.positions.times import check_dates, elapsed_s, parse_utc
from pipeline.plan.timing import frame_count, frame_times
from pipeline.spec.scene import Scene

MOST_TIMES = 1_000_000
FORMS = "START,STOP,STEP, or a file with a time in each line: UTC, or seconds after the epoch"


@dataclass(frozen=True)
class Times:
    """n exposures: the frame of the scene (n,) that each is like, its middle [s after the epoch],
    and by how much it is later than that frame [s]; 0 where `as_exposed`."""

    frame: NDArray[np.int64]
    middle_s: Array
    late_s: Array
    as_exposed: bool


def times_of(scene: Scene, asked: str | PathLike[str] | Iterable[str | float] | None) -> Times:
    """The exposures of a scene; or others whose middles are the times asked for, each as the frame
    nearest in time is taken (its integration time, and the pointing of its dwell).

    asked : FORMS, or the times themselves. BadInput for text that is no time, times that do not
    rise, or more than MOST_TIMES.
    """
    frames = np.arange(frame_count(scene), dtype=np.int64)
    start, integration_s = frame_times(scene, frames)
    middle = start + 0.5 * integration_s
    if asked is None:
        return Times(frames, middle, np.zeros(len(frames)), True)
    if isinstance(asked, str) and asked.count(",") == 2:
        wanted = _range_s(scene, *asked.split(","))
    else:
        words = _lines(Path(asked)) if isinstance(asked, str | PathLike) else asked
        if not isinstance(words, Iterable):
            raise BadInput("times", asked, FORMS)
        wanted = np.array([_offset_s(scene, word) for word in words])
    if not 1 <= len(wanted) <= MOST_TIMES:
        raise BadInput("times", f"{len(wanted)} times", f"1 to {MOST_TIMES} times")
    if (np.diff(wanted) <= 0.0).any():
        late = wanted[int(np.argmax(np.diff(wanted) <= 0.0)) + 1]
        raise BadInput("times", f"{late:g} s", "times that rise from one to the next")
    check_dates(parse_utc(scene.epoch), wanted[[0, -1]], "times")
    like = np.searchsorted(0.5 * (middle[1:] + middle[:-1]), wanted).astype(np.int64)
    return Times(like, wanted, wanted - middle[like], False)


def _range_s(scene: Scene, first: str, last: str, step: str) -> Array:
    start, stop = _offset_s(scene, first), _offset_s(scene, last)
    try:
        step_s = float(step)
    except ValueError:
        step_s = np.nan
    count = (stop - start) / step_s if 0.0 < step_s < np.inf else np.nan
    if not 0.0 <= count < MOST_TIMES:
        allowed = f"a step above 0 s and a stop after the start, in at most {MOST_TIMES} times"
        raise BadInput("times", f"{first},{last},{step}", allowed)
    return np.asarray(start + step_s * np.arange(int(count + 1e-9) + 1))


def _lines(path: Path) -> list[str]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput("times", str(path), f"{FORMS} ({type(error).__name__})") from None
    return [words for line in text.splitlines() if (words := line.split("#")[0].strip())]


def _offset_s(scene: Scene, word: str | float) -> float:
    """A time [s after the epoch] from UTC or seconds."""
    try:
        seconds = float(word)
    except TypeError:
        raise BadInput("times", word, "UTC, or seconds after the epoch") from None
    except ValueError:
        utc1, utc2 = parse_utc(str(word).strip(), "times")
        return float(elapsed_s(parse_utc(scene.epoch), utc1, utc2))
    if not np.isfinite(seconds):
        raise BadInput("times", word, "a finite time")
    return seconds
