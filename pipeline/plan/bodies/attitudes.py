"""What bodies are lit and seen from at each moment, and how their parts stand in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.constants import DEG_RAD
from pipeline.physics.positions.times import elapsed_s, parse_utc
from pipeline.physics.targets import attitude as at
from pipeline.physics.vectors import separation
from pipeline.spec.targets.body import (
    Body,
    CompositeBody,
    InertialAttitude,
    LightCurveBody,
    SphereBody,
)
from pipeline.spec.targets.mesh import MeshBody

Array = NDArray[np.float64]

UPRIGHT = InertialAttitude(kind="inertial")


@dataclass(frozen=True)
class View:
    """What T bodies are lit from and seen from at n moments each, GCRS axes.

    time_s : (T, n) seconds after the scene's epoch, when the light left the body
    place_m, velocity_m_s : (T, n, 3) geocentric, at that time
    sun_m, observer_m : (T, n, 3) geocentric; the Sun's apparent place
    """

    time_s: Array
    place_m: Array
    velocity_m_s: Array
    sun_m: Array
    observer_m: Array

    def of(self, index: NDArray[np.int64]) -> View:
        """Rows of it."""
        return View(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    @cached_property
    def sun(self) -> Array:
        """Directions (T, n, 3) to the Sun."""
        return _directions(self.sun_m - self.place_m)

    @cached_property
    def observer(self) -> Array:
        """Directions (T, n, 3) to the observer."""
        return _directions(self.observer_m - self.place_m)

    @property
    def phase_rad(self) -> Array:
        """Angles Sun - body - observer (T, n)."""
        return separation(self.sun_m - self.place_m, self.observer_m - self.place_m)


def _directions(vectors: Array) -> Array:
    """`unit` of vectors none of which is zero, quicker."""
    return np.asarray(vectors / np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None])


def attitudes(
    laws: Sequence[Any], epoch: tuple[float, float], view: View, fields: Sequence[str]
) -> Array:
    """Attitudes (P, n, 3, 3) or (P, 1, 3, 3) of P parts under laws of one kind (and one bus)."""
    kind = laws[0].kind
    mount = at.quaternion_matrices(np.array([law.quaternion for law in laws]))[:, None]
    if kind == "inertial":
        return mount
    if kind == "spin":
        return _spinning(mount, laws, epoch, view, fields)
    frame = {
        "sun": lambda: at.sun_attitude(view.sun, view.place_m, view.velocity_m_s),
        "nadir": lambda: at.nadir_attitude(view.place_m, view.velocity_m_s),
        "velocity": lambda: at.velocity_attitude(view.place_m, view.velocity_m_s),
        "inertial": lambda: np.eye(3),
        "table": lambda: _of_tables(laws, epoch, view, fields),
    }
    if kind != "sun_tracking":
        return frame[kind]() @ mount
    bus = frame[laws[0].bus]() @ mount
    return at.tracking_attitude(bus, np.array([law.axis for law in laws])[:, None], view.sun)


def _spinning(
    mount: Array, laws: Sequence[Any], epoch: tuple[float, float], view: View, fields: Sequence[str]
) -> Array:
    axis, rate, phase, after = (
        np.array(v)
        for v in (
            [law.axis for law in laws],
            [[law.rate_deg_s] for law in laws],
            [[law.phase_deg] for law in laws],
            [[since_s(law.epoch, epoch, f)] for law, f in zip(laws, fields, strict=True)],
        )
    )
    turned = np.fmod(rate * (view.time_s + after), 360.0) + phase
    return at.spin_attitude(mount, axis[:, None], turned * DEG_RAD)


def _of_tables(
    laws: Sequence[Any], epoch: tuple[float, float], view: View, fields: Sequence[str]
) -> Array:
    each = []
    for law, times, field in zip(laws, view.time_s, fields, strict=True):
        moments = times + since_s(law.epoch, epoch, field)
        each.append(at.table_attitude(law.times_s, law.quaternions, moments, f"{field}.attitude"))
    return np.stack(each)


def since_s(own: str | None, epoch: tuple[float, float], field: str) -> float:
    """Seconds from a law's own epoch to the scene's; 0 where it has none."""
    if own is None:
        return 0.0
    return float(elapsed_s(parse_utc(own, f"{field}.epoch"), *epoch))


def needs_velocity(body: Body | MeshBody) -> bool:
    """True where a law of the body follows the orbit's motion."""
    if isinstance(body, LightCurveBody | SphereBody):
        return False
    parts: Sequence[object] = (body,)
    laws = [body.attitude]
    if isinstance(body, CompositeBody):
        parts = body.parts
    laws += [getattr(part, "attitude", None) for part in parts]
    wanted = {law.kind if law.kind != "sun_tracking" else law.bus for law in laws if law}
    return bool(wanted & {"sun", "nadir", "velocity"})
