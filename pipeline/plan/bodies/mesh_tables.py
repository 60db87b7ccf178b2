"""Meshes that many frames need: their light worked out beforehand, along time and spin phase."""

from __future__ import annotations

import math
import threading
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.meshes.light_table import NO_TIMES, TURN, LightTable, tabulated
from pipeline.physics.meshes.model import MeshModel
from pipeline.physics.positions.times import parse_utc
from pipeline.physics.vectors import unit
from pipeline.plan.bodies.attitudes import View, since_s
from pipeline.plan.bodies.meshes import STEP_RAD, mesh_earthshine_m2_sr, mesh_m2_sr
from pipeline.plan.bodies.sights import Moments, sights
from pipeline.plan.decision import Decision
from pipeline.plan.timing import end_s, frame_count, frame_times, integration_range_s
from pipeline.spec.scene import Scene
from pipeline.spec.targets.body import SpinAttitude, TableAttitude
from pipeline.spec.targets.mesh import MeshBody

Array = NDArray[np.float64]

WORTH = 300  # moments to work out: below it a table is not tried
FINER = 0.1  # of the error asked for: that of single moments, or the table would follow it
SHARE = 3  # a table takes at most a third of the moments that it saves
MOST_NODES = 257  # of a frame
ROWS_RAD = 0.05  # of a tabulated attitude, between rows that are looked at
ROUNDING_S = 1e-6
KEPT: dict[str, LightTable | None] = {}  # of this process, by what they follow from
MOST_KEPT = 256
LOCK = threading.Lock()  # of what is put there, and dropped


def table_of(scene: Scene, index: int, at: Moments) -> LightTable | None:
    """The table of a mesh target of a scene, None where each frame works out its own light, and at
    moments before or after the scene's exposures.

    It follows from the scene alone: from the first exposure's start to the last one's end, whatever
    frames are asked for. Lights: in sunlight (eclipses not counted), and in earthshine where that
    is asked for, as `mesh_m2_sr` and `mesh_earthshine_m2_sr` tell them.
    """
    body = scene.targets[index].body
    assert isinstance(body, MeshBody)
    start, stop = _span(scene)
    if at.offset_s.min() < start - ROUNDING_S or at.offset_s.max() > stop + ROUNDING_S:
        return None
    return table_between(scene, index, at, start, stop, moments_wanted(scene, body))


def table_between(
    scene: Scene, index: int, at: Moments, start_s: float, stop_s: float, wanted: int
) -> LightTable | None:
    """The same between two times after the epoch, for about so many moments."""
    body = scene.targets[index].body
    assert isinstance(body, MeshBody)
    if wanted < WORTH or at.elsewhere is None:
        return None
    key = _key(scene, index, start_s, stop_s, wanted)
    with suppress(KeyError):  # of one that another thread drops meanwhile
        return KEPT[key]
    made, spin = None, spin_rad_s(body)
    if spin is not None:
        assert body.error is not None
        light, share = _Light(scene, index, at, spin), 2.0 * body.error
        turns = _turns_s(light, start_s, stop_s)
        made = tabulated(light, start_s, stop_s, share, wanted // SHARE, spin != 0.0, turns)
    with LOCK:
        while len(KEPT) >= MOST_KEPT:
            KEPT.pop(next(iter(KEPT)))
        KEPT[key] = made
    return made


def moments_wanted(scene: Scene, body: MeshBody) -> int:
    """About how many moments of a body's light the frames of a scene need by themselves."""
    spin = spin_rad_s(body)
    rate = max((abs(r) for r in _rates(body)), default=0.0) if spin is None else abs(spin)
    turned = rate * integration_range_s(scene)[1]
    return frame_count(scene) * min(2 + int(turned / STEP_RAD), MOST_NODES)


def table_phase(scene: Scene, index: int, view: View) -> Array:
    """Spin phases (n,) [rad] of a mesh target at the moments of a view (T = 1)."""
    body = scene.targets[index].body
    assert isinstance(body, MeshBody)
    return _phase(body, parse_utc(scene.epoch), view.time_s[0], f"targets.{index}.body")


def spin_rad_s(body: MeshBody) -> float | None:
    """Rate of the one even turn of a body or of a joint, 0 without; None where there are more, or
    where a phase does not tell how it stands: the body follows a table as a joint spins."""
    rates = _rates(body)
    tabled = bool(rates) and isinstance(body.attitude, TableAttitude)
    return None if len(rates) > 1 or tabled else sum(rates)


def decide_tables(scene: Scene) -> list[Decision]:
    """What the plan says of tables of light; nothing where no mesh needs many moments."""
    return [
        _decision(scene, index, target.name, target.body)
        for index, target in enumerate(scene.targets)
        if isinstance(target.body, MeshBody) and moments_wanted(scene, target.body) >= WORTH
    ]


def _decision(scene: Scene, index: int, name: str, body: MeshBody) -> Decision:
    wanted = moments_wanted(scene, body)
    key = _key(scene, index, *_span(scene), wanted)
    table, missed = KEPT.get(key), 2.0 * (body.error or 0.0)
    bound = None if table is None else table.worst if len(table.values) > 1 else table.error
    dropped = key not in KEPT and len(KEPT) >= MOST_KEPT
    if dropped:
        bound = missed
        why = (
            f"{name}: not kept beside {MOST_KEPT} others; where a table serves, it is worked out "
            "again for each window of frames"
        )
    elif table is None:
        why = (
            f"{name}: none within a third of the about {wanted} moments that the frames need and "
            f"{missed:.2g} of the light, or more than one part spins by itself, or one beside a "
            "tabulated attitude: each frame works out its own light"
        )
    else:
        why = _worked_out(name, table, wanted)
    used = dropped or table is not None
    return Decision("targets.light_table", used, why, bound=bound, unit="of the brightest light")


def _worked_out(name: str, table: LightTable, wanted: int) -> str:
    """What the plan says of a table that is there."""
    phases = len(table.values)
    grid = f"{phases} phases of its spin by " if phases > 1 else ""
    told = (
        f"{name}: worked out beforehand at {grid}{len(table.times_s)} times, "
        f"{table.worked} moments instead of about {wanted}; straight lines between. "
    )
    if phases > 1:
        return told + (
            f"Moments that were omitted differ by {table.error:.2g} of the mean light on "
            f"average, by up to {table.worst:.2g} of the brightest where a face or a shadow sets in"
        )
    return told + (
        f"Moments that were omitted differ by at most {table.error:.2g} of the "
        "light, or of a tenth of the brightest where it is fainter"
    )


class _Light:
    """Lights (m, C) of a target at phases and times (m,) of arrival."""

    def __init__(self, scene: Scene, index: int, at: Moments, spin: float) -> None:
        self.scene, self.index, self.at, self.spin = scene, index, at, spin

    def view(self, time_s: Array) -> View:
        """How the target stands at times (n,) of arrival."""
        assert self.at.elsewhere is not None
        return sights(self.scene, [self.index], self.at.elsewhere(time_s))[1]

    def __call__(self, phase: Array, time_s: Array) -> Array:
        target = self.scene.targets[self.index]
        epoch, field = parse_utc(self.scene.epoch), f"targets.{self.index}.body"
        body = target.body
        assert isinstance(body, MeshBody)
        assert body.error is not None
        body = body.model_copy(update={"error": FINER * body.error})
        each, back = np.unique(time_s, return_inverse=True)
        seen = self.view(each)
        view = View(*(getattr(seen, name)[:, back] for name in seen.__dataclass_fields__))
        if self.spin:
            # the phase alone tells how it stands: the moment at which the spin has that phase
            zero = _phase(body, epoch, np.zeros(1), field)[0]
            turned = np.mod(phase - zero, TURN) / self.spin
            view = View(turned[None], view.place_m, view.velocity_m_s, view.sun_m, view.observer_m)
        albedo = None if target.lighting is None else target.lighting.earthshine_albedo
        out = np.zeros((len(time_s), 1 if albedo is None else 2))
        for k in range(len(time_s)):
            one = View(*(getattr(view, name)[:, k : k + 1] for name in view.__dataclass_fields__))
            out[k, 0] = mesh_m2_sr(body, epoch, one, field)[0]
            if albedo is not None:
                out[k, 1] = mesh_earthshine_m2_sr(body, epoch, one, albedo, out[k, :1], field)[0]
        return out


def _turns_s(light: _Light, start_s: float, stop_s: float) -> Array:
    """Times of arrival at which a tabulated attitude begins or ends to turn, from row to row.

    Of rows between which it turns by less than ROWS_RAD only those where it has turned by that.
    """
    law = getattr(light.scene.targets[light.index].body, "attitude", None)
    if not isinstance(law, TableAttitude):
        return NO_TIMES
    q = unit(np.array(law.quaternions))
    turn = 2.0 * np.arccos(np.minimum(np.abs(np.sum(q[1:] * q[:-1], axis=-1)), 1.0))
    turned = np.diff(np.cumsum(turn) // ROWS_RAD, prepend=0.0) > 0.0
    rows = np.append(turned, False) | np.append(False, turned)
    since = since_s(law.epoch, parse_utc(light.scene.epoch), f"targets.{light.index}.body")
    left = np.array(law.times_s)[rows] - since
    at = left = left[(left >= start_s) & (left <= stop_s)]
    for _ in range(2 if len(left) else 0):  # light is under way for a while
        at = np.clip(at + left - light.view(at).time_s[0], start_s, stop_s)
    return at


def _phase(body: MeshBody, epoch: tuple[float, float], time_s: Array, field: str) -> Array:
    law = body.attitude
    if isinstance(law, SpinAttitude) and law.rate_deg_s:
        turned = np.fmod(law.rate_deg_s * (time_s + since_s(law.epoch, epoch, field)), 360.0)
        return np.asarray(np.radians(turned + law.phase_deg))
    return np.fmod((spin_rad_s(body) or 0.0) * time_s, TURN)


def _rates(body: MeshBody) -> list[float]:
    """Rates [rad/s] of everything that spins evenly: the body and its joints."""
    law = body.attitude
    rates = [math.radians(law.rate_deg_s)] if isinstance(law, SpinAttitude) else []
    model: MeshModel = body.model
    rates += [p.joint.rate_rad_s for p in model.parts if p.joint and p.joint.law == "spin"]
    return [r for r in rates if r != 0.0]


def _span(scene: Scene) -> tuple[float, float]:
    """Start of the first exposure and end of the last, after the epoch."""
    return float(frame_times(scene, np.zeros(1, np.int64))[0][0]), end_s(scene)


def _key(scene: Scene, index: int, start_s: float, stop_s: float, wanted: int) -> str:
    """All that a table follows from, as text."""
    told = [m.model_dump_json() for m in (scene.targets[index], scene.observer)]
    return "\n".join([scene.epoch, *told, repr((start_s, stop_s, wanted))])
