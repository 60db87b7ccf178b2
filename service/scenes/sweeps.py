"""Sweeps over REST: what one may hold, and how the worker runs it."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from catalog_tools.documents import JsonObject, JsonValue
from pipeline.errors import BadInput
from pipeline.plan.cost import least_noise_s
from pipeline.plan.timing import frame_count
from pipeline.spec.scene import Scene
from pipeline.spec.sweep import Axis, Sweep
from pipeline.spec.sweep_load import parse_sweep
from pipeline.sweep.design import Design
from service.problems import NotAllowed, within
from service.scenes.axes import check_no_file
from service.scenes.scenes import HasFile, accept_scene, product_bytes_of
from service.scenes.uploads import engine_scene
from service.settings import Settings

if TYPE_CHECKING:
    from pipeline.route.run import Options
    from pipeline.sweep.run import Listener

MOST_ADC_BITS = 63  # of any point, where an axis changes them
# What would change how many pixels the points have, or what they read: all are as the base scene.
FIXED = (
    "sensor.shape",
    "exposure.frames",
    "dwells",
    "targets",
    "populations",
    "stars.catalogue",
    "output",
)


def accept_sweep(
    data: JsonValue, settings: Settings, has_file: HasFile | None = None
) -> tuple[JsonObject, int]:
    """A sweep as it is stored, and its pixels x frames. Its base scene is looked at like any other,
    and its axes may neither name files nor change how large a point is.

    Raises BadInput, InvalidScene, NotAllowed.
    """
    parsed = parse_sweep(data)
    if not isinstance(parsed.scene, dict):
        allowed = "the base scene itself: over REST no file is read"
        raise NotAllowed(f"scene: {allowed}", (("scene", parsed.scene, allowed),))
    with within("scene"):
        base = accept_scene(parsed.scene, settings, has_file)
    for i, axis in enumerate(parsed.axes):
        _check_axis(i, axis)
    rows, columns = base.sensor.shape
    each = rows * columns * frame_count(base)
    if parsed.points > settings.sweep_points:
        allowed = f"at most {settings.sweep_points} points"
        raise NotAllowed(f"axes: {allowed}", (("axes", parsed.points, allowed),))
    if (least := least_noise_s(parsed.points * each)) > settings.job_cpu_s:
        allowed = f"a sweep of at most {settings.job_cpu_s:g} CPU s (forecast: {least:.0f})"
        raise NotAllowed(f"axes: {allowed}", (("axes", parsed.points, allowed),))
    asked = _bytes_kept(parsed, base)
    if asked > settings.product_bytes:
        allowed = f"points of at most {settings.product_bytes} bytes in all (asked: {asked})"
        raise NotAllowed(f"cubes: {allowed}", (("cubes", parsed.cubes, allowed),))
    return parsed.as_dict() | {"scene": base.as_dict()}, parsed.points * each


def _bytes_kept(parsed: Sweep, base: Scene) -> int:
    """Most bytes of the products of points that a sweep keeps."""
    if parsed.cubes == "none":
        return 0
    kept = len(parsed.cubes) if isinstance(parsed.cubes, tuple) else parsed.points
    if given := Design(parsed).extremes("sensor.adc_bits"):
        bits = [v if isinstance(v, int) else MOST_ADC_BITS for v in given]
        sensor = base.sensor.model_copy(update={"adc_bits": min(max(bits), MOST_ADC_BITS)})
        base = base.model_copy(update={"sensor": sensor})
    return kept * product_bytes_of(base)


def _check_axis(number: int, axis: Axis) -> None:
    for field, fixed in product(axis.fields, FIXED):
        if _changes(field, fixed):
            allowed = f"an axis that leaves {fixed} as it is"
            raise NotAllowed(f"axes[{number}]: {allowed}", ((f"axes[{number}]", field, allowed),))
    check_no_file(f"axes[{number}]", axis)


def _changes(field: str, fixed: str) -> bool:
    """Whether a field is, holds or lies in a fixed one; a property of one target does not."""
    if fixed == "targets" and field.count(".") >= 2:
        return False
    return f"{fixed}.".startswith(f"{field}.") or field.startswith(f"{fixed}.")


def run_sweep(order: JsonObject, options: Options, listen: Listener) -> JsonObject:
    """Run a stored sweep, in the worker's process, from whose folder the files of its base are."""
    from pipeline.sweep.run import course_of, run_course

    product = Path(order["product"])
    course = course_of(parse_sweep(order["scene"]), Path.cwd(), product)
    report = run_course(course, product, options, False, listen)
    return {"tiles": report["points"], "content_digest": None}


def engine_sweep(sweep: JsonObject, settings: Settings) -> JsonObject:
    """A stored sweep as the worker gets it: its base scene as any scene."""
    if not isinstance(sweep.get("scene"), dict):
        raise BadInput("scene", None, "a base scene")
    engine_scene(sweep["scene"], settings)
    return sweep
