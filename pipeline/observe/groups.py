"""Targets that are observed, with the sensor that observes them: those drawn, then all others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.errors import BadInput
from pipeline.inputs.targets.populations import screened
from pipeline.observe.times import Times
from pipeline.physics.vectors import to_angles
from pipeline.plan.pointing.geometry import moments_at
from pipeline.plan.pointing.site import axes_of
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.response.responses import plan_responses
from pipeline.plan.targets.populations import whole_sky
from pipeline.plan.timing import longest_s
from pipeline.resolve.files import read_files, with_numbers
from pipeline.resolve.resolve import Resolved, resolve
from pipeline.spec.accept import ACCEPTABLE
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.pointing.pointing import SiderealPointing
from pipeline.spec.scene import Scene, Target


@dataclass(frozen=True)
class Group:
    """Targets of a scene that are observed together: those from `first` on.

    as_drawn : at the scene's exposures, with the geometry that the renderer draws by
    """

    resolved: ResolvedScene
    first: int
    as_drawn: bool


def groups_of(asked: Scene, times: Times) -> tuple[list[Group], list[str]]:
    """The targets and all members of populations, in groups, and what is to be reported.

    What stops a render because it cannot be drawn (the Sun in the field, daylight, a camera that
    looks at the ground) stops nothing here. BadInput for everything else that does.
    """
    if not (asked.targets or asked.populations):
        raise BadInput("targets", "none", "a target or a population, to observe it")
    accepting = asked.model_copy(update={"accept": tuple(ACCEPTABLE)})
    found, refused = _resolved(accepting)
    sensor = _with_responses(found)
    own = sensor.scene.targets[: len(asked.targets)]
    notes = [*found.warnings, *found.remarks]
    if refused is not None:
        notes.insert(0, f"a render is refused ({refused}); noise: of a field at the zenith")
        read = read_files(accepting)
        there = {k: getattr(read, k) for k in ("pointing", "dwells", "exposure")}
        sensor = _of(sensor, sensor.scene.model_copy(update=there), own)
    as_drawn = times.as_exposed and refused is None
    if all(p.screened is not None for p in asked.populations):
        return [Group(sensor, 0, as_drawn)], notes
    bare = sensor.scene.model_copy(update={"targets": own, "populations": asked.populations})
    first, last = (float(v) for v in times.middle_s[[0, -1]])
    spare = longest_s(asked)
    whole = with_numbers(screened(bare, whole_sky(bare, first - spare, last + spare)))
    notes += _omitted(whole)
    if not as_drawn:
        return [Group(_of(sensor, whole, whole.targets), 0, False)], notes
    drawn = {t.name for t in sensor.scene.targets}
    others = (*own, *(t for t in whole.targets if t.name not in drawn))
    return [Group(sensor, 0, True), Group(_of(sensor, whole, others), len(own), False)], notes


def _resolved(scene: Scene) -> tuple[Resolved, BadInput | None]:
    """A scene resolved; or, of a camera that looks at the ground, one that looks away from it, and
    why it was refused."""
    try:
        return resolve(scene), None
    except BadInput as error:
        if error.field != "pointing":
            raise
        return resolve(_looking_up(scene)), error


def _looking_up(scene: Scene) -> Scene:
    """The scene with one exposure at the zenith of its site, or of its place in space."""
    at = moments_at(scene, 0.0, np.zeros(1))
    o = scene.observer
    up = axes_of(o, at.times)[:, 2] if isinstance(o, GroundObserver) else at.observer_m
    ra, dec = (float(np.degrees(v[0])) for v in to_angles(up))
    pointing = SiderealPointing(mode="sidereal", boresight_ra_deg=ra, boresight_dec_deg=dec)
    exposure = scene.exposure.model_copy(update={"frames": 1})
    update = {"pointing": pointing, "exposure": exposure, "dwells": None}
    return scene.model_copy(update=update)


def _with_responses(found: Resolved) -> ResolvedScene:
    """The resolved scene with the responses of targets, also where none is in the field."""
    r = found.scene
    if r.responses.classes:
        return r
    return replace(
        r, responses=plan_responses(r.scene, r.facts, r.camera, found.geometry, sources=True)
    )


def _of(sensor: ResolvedScene, scene: Scene, targets: tuple[Target, ...]) -> ResolvedScene:
    return replace(sensor, scene=scene.model_copy(update={"targets": targets}))


def _omitted(scene: Scene) -> list[str]:
    """What of populations cannot be observed."""
    found = [(p.name, p.screened) for p in scene.populations if p.screened is not None]
    return [
        f"populations.{name}: {failed} of {s.read} element sets omitted: {s.left_out[0]}"
        for name, s in found
        if (failed := s.unreadable + sum(count for _, count in s.failed))
    ]
