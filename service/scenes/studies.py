"""Studies over REST: what one may hold, and how the worker runs it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from catalog_tools.documents import JsonObject, JsonValue
from pipeline.spec.study_load import parse_study
from service.problems import NotAllowed
from service.scenes.axes import check_no_file
from service.scenes.scenes import HasFile, check_named, named_in
from service.settings import Settings

if TYPE_CHECKING:
    from pipeline.sweep.run import Listener, SweepProgress

STATE_CPU_S = 1e-6  # of an object at a step, at least


def accept_study(
    data: JsonValue, settings: Settings, has_file: HasFile | None = None
) -> JsonObject:
    """A study as it is stored. Files in it are the caller's uploads; it has a size.

    Raises BadInput, InvalidScene, NotAllowed.
    """
    study = parse_study(data)
    plain = study.as_dict()
    check_named(named_in(plain), settings, has_file)
    for i, axis in enumerate(study.axes):
        check_no_file(f"axes.{i}", axis)
    made = study.catalogue.synthetic.objects if study.catalogue.synthetic else 1
    cpu_s = STATE_CPU_S * made * study.duration_h * 3600.0 / study.step_s * study.points
    if cpu_s > settings.job_cpu_s or study.points > settings.sweep_points:
        allowed = f"a study of at most {settings.job_cpu_s:g} CPU s, {settings.sweep_points} points"
        raise NotAllowed(f"duration_h: {allowed}", (("duration_h", study.duration_h, allowed),))
    return plain


def run_study(order: JsonObject, listen: Listener) -> JsonObject:
    """Run a stored study, in the worker's process."""
    from pipeline.capacity import run

    options = run.StudyOptions(
        order["scheduler"], order["workers"], order["resume"], most_cpu_s=order["most_cpu_s"]
    )
    tasks = 0

    def hear(progress: SweepProgress) -> None:
        nonlocal tasks
        tasks = progress.total
        listen(progress)

    run.run_study(order["scene"], Path.cwd(), Path(order["product"]), options, hear)
    return {"tiles": tasks, "content_digest": None}
