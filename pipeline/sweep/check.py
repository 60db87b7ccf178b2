"""Whether a sweep can be run: every axis is tried, and three of its points are planned."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from pipeline.errors import BadInput, NightglassError
from pipeline.plan.needs import predict
from pipeline.route.prepare import Prepared, check_room, prepare
from pipeline.route.run import Options
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene
from pipeline.sweep.points import Course, check_axes, concerns, names_of_axes, scene_of

MOST_TARGETS = 64


@dataclass(frozen=True)
class Checked:
    """What the points that were planned tell of a sweep.

    names : of the targets measured
    digests : of the base scene's catalogues; none where an axis names others
    point_cpu_s : CPU seconds that the dearest of them is predicted to take by itself
    """

    names: tuple[str, ...]
    digests: list[str]
    warnings: list[str]
    point_cpu_s: float


def judge_course(course: Course) -> None:
    """BadInput for what `check` refuses and no point has to be planned for: values of axes that no
    scene takes, and names of targets that are not there."""
    _try_axes(course)
    if not (first := scene_of(course, course.design, 0)).populations:
        _measured(course, [first])


def check(course: Course, options: Options | None = None) -> Checked:
    """Refuse a sweep that can't be run.

    options : of the run, for what this machine must hold; None: of one that is told only
    Every axis is tried field by field, and the first, middle and last points are planned: a sweep
    is refused where none of them can be, a point that fails later is recorded.
    """
    design = course.design
    _try_axes(course)
    faults: list[NightglassError] = []
    found: list[Prepared] = []
    warnings: dict[str, int] = {}
    for point in dict.fromkeys((0, design.size // 2, design.size - 1)):
        try:
            one = _planned(course, point, options)
        except NightglassError as error:
            faults.append(error)
            continue
        found.append(one)
        for warning in one.plan.warnings:
            warnings.setdefault(warning, point)
    if not found:
        raise faults[0]
    return Checked(
        _measured(course, [one.plan.scene for one in found]),
        _digests(course, found[0]),
        [f"point {point}: {warning}" for warning, point in warnings.items()],
        max(predict(one.plan, one.forecast, one.spent)["cpu_s"] for one in found),
    )


def _try_axes(course: Course) -> None:
    parse = partial(parse_scene, base=Path(course.base_folder))
    check_axes(course.design, course.data, parse)


def _planned(course: Course, point: int, options: Options | None) -> Prepared:
    """The plan of a point, which this machine holds where its processes draw it."""
    one = prepare(scene_of(course, course.design, point))
    if options is not None and (options.processes or options.most_memory_mb):
        check_room(one, options.most_memory_mb, options.processes, options.threads)
    return one


def _digests(course: Course, point: Prepared) -> list[str]:
    """Catalogues that axes name count among the files: some of them may come later."""
    names = [name for axis in course.sweep.axes for name in axis.fields]
    if any(concerns(name, "stars.catalogue") for name in names):
        return []
    return [c.digest for c in point.catalogues]


def _measured(course: Course, scenes: list[Scene]) -> tuple[str, ...]:
    """Names of the targets measured, of whatever points have them. BadInput for one that is not
    there, and for too many."""
    named = (t.name for scene in scenes for t in scene.targets)
    known = tuple(dict.fromkeys((*named, *names_of_axes(course))))
    names = known if course.sweep.targets is None else course.sweep.targets
    for i, name in enumerate(names):
        if name not in known:
            raise BadInput(f"targets.{i}", name, f"the name of a target: {', '.join(known[:10])}")
    if len(names) > MOST_TARGETS and {"snr", "detection"} & set(course.sweep.metrics):
        allowed = f"targets: a list of up to {MOST_TARGETS} names to measure"
        raise BadInput("targets", f"{len(names)} targets", allowed)
    return names
