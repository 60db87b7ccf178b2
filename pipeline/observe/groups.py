"""Targets that are observed, with the sensor that observes them: those drawn, then all others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.execute.outlook import full_warnings
from pipeline.inputs.earth_orientation import gather_turned, turn_off_rad
from pipeline.inputs.targets.ephemerides import gather_ephemerides
from pipeline.inputs.targets.populations import screened
from pipeline.observe.times import Times
from pipeline.physics.constants import ARCSEC_RAD, DAY_S, EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.positions.times import parse_utc
from pipeline.plan.pointing.geometry import zenith_pointing
from pipeline.plan.pointing.timescales import changing
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.response.responses import plan_responses
from pipeline.plan.targets.orbit_age import oldest_remarks, sensor_remarks, two_body_remarks
from pipeline.plan.targets.populations import whole_sky
from pipeline.plan.targets.shared import screens_of
from pipeline.plan.timing import longest_s
from pipeline.resolve.files import read_files, with_numbers
from pipeline.resolve.resolve import resolve
from pipeline.spec.accept import ACCEPTABLE
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene

SAID_RAD = 0.1 * ARCSEC_RAD  # from which a wrong turn of the Earth is told


@dataclass(frozen=True)
class Group:
    """Targets of a scene that are observed together: those from `first` on.

    as_drawn : at the scene's exposures, with the geometry that the renderer draws by
    """

    resolved: ResolvedScene
    first: int
    as_drawn: bool

    @cached_property
    def changing(self) -> NDArray[np.bool_]:
        """Targets (T,) whose light a table or a turn changes."""
        return changing(self.resolved.scene)


def groups_of(asked: Scene, times: Times) -> tuple[list[Group], list[str]]:
    """The targets and all members of populations, in groups, and what is to be reported.

    What stops a render because it cannot be drawn (the Sun in the field, daylight, a camera that
    looks at the ground) stops nothing here. BadInput for everything else that does.
    """
    if not (asked.targets or asked.populations):
        raise BadInput("targets", "none", "a target or a population, to observe it")
    first, last = (float(v) for v in times.middle_s[[0, -1]])
    if not times.as_exposed:  # orbits of files over these times, too
        spare_s = longest_s(asked)
        asked = gather_ephemerides(asked, (first - spare_s, last + spare_s))
    sensor, notes, drawable = _sensor_of(asked)
    if not times.as_exposed:
        notes = [f"of the scene's own exposures: {note}" for note in notes]
    own, as_drawn = len(asked.targets), drawable and times.as_exposed
    near_s = 0.0 if times.as_exposed else 0.5 * (first + last)
    whole = _whole(asked, sensor, first, last, near_s)
    notes += _omitted(whole.scene)
    if not times.as_exposed or whole is not sensor:
        notes += oldest_remarks(whole.scene, first, last)
    if not times.as_exposed:
        whole, told = _at_other_times(asked, whole, first, last)
        notes += told
    if not as_drawn or whole is sensor:
        return [Group(whole, 0, as_drawn)], notes
    drawn, everyone = {t.name for t in sensor.scene.targets}, whole.scene.targets
    others = (*everyone[:own], *(t for t in everyone[own:] if t.name not in drawn))
    rest = replace(whole, scene=whole.scene.model_copy(update={"targets": others}))
    return [Group(sensor, 0, True), Group(rest, own, False)], notes


def _sensor_of(asked: Scene) -> tuple[ResolvedScene, list[str], bool]:
    """The scene resolved, with what it draws; what is to be reported; whether it can be drawn.

    Of a camera that looks at the ground the noise and the response are those of one that looks
    away from it, and no member of a population is drawn.
    """
    accepting = asked.model_copy(update={"accept": tuple(ACCEPTABLE)})
    try:
        found, refused = resolve(accepting), None
    except BadInput as error:
        if error.field != "pointing":
            raise
        # orbits of files over all exposures, not over the one at the zenith
        found, refused = resolve(_looking_up(gather_ephemerides(accepting))), error
    r, notes = found.scene, [*found.warnings, *found.remarks]
    if not r.responses.classes:  # nothing is drawn: the responses of targets all the same
        g = found.geometry
        r = replace(r, responses=plan_responses(r.scene, r.facts, r.camera, g, sources=True))
    if refused is None:
        return r, [*full_warnings(r, found.geometry), *notes], True
    read = read_files(accepting)
    there = {name: getattr(read, name) for name in ("pointing", "dwells", "exposure")}
    scene = r.scene.model_copy(update=there | {"targets": r.scene.targets[: len(asked.targets)]})
    note = f"a render is refused ({refused}); noise: of a field at the zenith"
    return replace(r, scene=scene), [note, *notes], False


def _looking_up(scene: Scene) -> Scene:
    """The scene with one exposure at the zenith of its site, or of its place in space."""
    exposure = scene.exposure.model_copy(update={"frames": 1})
    update = {"pointing": zenith_pointing(scene), "exposure": exposure, "dwells": None}
    return scene.model_copy(update=update)


def _whole(
    asked: Scene, sensor: ResolvedScene, first_s: float, last_s: float, near_s: float
) -> ResolvedScene:
    """The sensor with all members of populations among its targets, after the scene's own, each
    by the elements that are nearest to a time."""
    if all(p.screened is not None for p in asked.populations):
        return sensor
    own, spare = sensor.scene.targets[: len(asked.targets)], longest_s(asked)
    bare = sensor.scene.model_copy(update={"targets": own, "populations": asked.populations})
    scene = with_numbers(screened(bare, whole_sky(bare, first_s - spare, last_s + spare, near_s)))
    return replace(sensor, scene=scene)


def _at_other_times(
    asked: Scene, r: ResolvedScene, first_s: float, last_s: float
) -> tuple[ResolvedScene, list[str]]:
    """The scene as it is at other times than its own, and what is to be said of orbits then."""
    notes = two_body_remarks(r.scene, first_s, last_s)
    notes += [f"the observer: {told}" for told in sensor_remarks(r.scene, first_s, last_s)]
    turned, told = _turned(asked, r, first_s, last_s)
    return turned, notes + told


def _turned(
    asked: Scene, r: ResolvedScene, first_s: float, last_s: float
) -> tuple[ResolvedScene, list[str]]:
    """The scene with UT1 and the pole of the middle of some times, where these are a day or more
    from its epoch, and what is left to say of them."""
    middle_s, epoch = 0.5 * (first_s + last_s), parse_utc(asked.epoch)
    if max(abs(first_s), abs(last_s)) < DAY_S or not isinstance(asked.observer, GroundObserver):
        return r, []
    pole, late_s = gather_turned(epoch, middle_s, r.dut1_s)
    scene = r.scene
    if asked.observer.polar_motion_arcsec is None and pole is not None:
        observer = scene.observer.model_copy(update={"polar_motion_arcsec": pole})
        scene = scene.model_copy(update={"observer": observer})
    dut1_s = r.dut1_s + late_s
    off_rad = turn_off_rad(epoch, middle_s, first_s, last_s, dut1_s)
    note = (
        "the Earth's turn (UT1) and pole are those of the middle of the times asked for: at others "
        f"a site is turned by up to {off_rad / ARCSEC_RAD:.2g} arcsec, "
        f"{off_rad * EARTH_EQUATORIAL_RADIUS_M:.2g} m, wrongly"
    )
    return replace(r, scene=scene, dut1_s=dut1_s), [note] * (off_rad > SAID_RAD)


def _omitted(scene: Scene) -> list[str]:
    """What of populations cannot be observed."""
    return [
        f"populations.{name}: {failed} of {s.read} element sets omitted: {s.left_out[0]}"
        for name, s in screens_of(scene)
        if (failed := s.unreadable + sum(count for _, count in s.failed))
    ]
