"""`nightglass report accuracy`: run the study and write it as JSON, a table and a figure."""

from __future__ import annotations

from pathlib import Path

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput, make_folder
from pipeline.lazily import need_matplotlib
from pipeline.studies.accuracy.figure import draw_figure
from pipeline.studies.accuracy.study import Progress, run_study
from pipeline.studies.accuracy.tables import markdown
from pipeline.studies.written import write_study

MOST_STARS = 10_000_000
SMALLEST_PX, LARGEST_PX = 256, 4096
QUICK_STARS, QUICK_PX = 1_000, 256


def report_accuracy(
    out: Path,
    stars: int = 20_000,
    frame: tuple[int, int] = (1024, 1024),
    quick: bool = False,
    peers: bool = True,
    satsim_python: str | None = None,
    progress: Progress | None = None,
) -> JsonObject:
    """Measure, and write accuracy.json, accuracy.md and accuracy.png into a folder.

    stars, frame : the work (rows, columns); `quick` takes less of both and fewer levels
    peers : also those simulators that are installed; satsim_python : a Python that has SatSim
    progress : called with (stage, done, total)
    Returns what accuracy.json holds. Raises BadInput for work out of range, and before anything is
    measured where the figure cannot be drawn.
    """
    if not 1 <= stars <= MOST_STARS:
        raise BadInput("stars", stars, f"1 to {MOST_STARS}")
    for n in frame:
        if not SMALLEST_PX <= n <= LARGEST_PX:
            raise BadInput("frame", frame, f"{SMALLEST_PX} to {LARGEST_PX} pixels a side")
    need_matplotlib()
    if quick:
        stars, frame = min(stars, QUICK_STARS), (QUICK_PX, QUICK_PX)
    make_folder(out)
    study = run_study(stars, frame, quick, peers, satsim_python, progress)
    write_study(out / "accuracy.json", study)
    (out / "accuracy.md").write_text(markdown(study))
    draw_figure(study, out / "accuracy.png")
    return study
