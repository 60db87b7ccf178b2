"""Which fields of a scene reach which stage of its light: what is left out of a stage is barred.

A stage is run on a plan whose other fields raise when they are read, and is known by the content
of what is left. So what it gives cannot depend on a field that is not in its key.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from pipeline.arrays import Geometry
from pipeline.execute.tile import LIGHTS
from pipeline.plan.facts import Facts
from pipeline.plan.plan import Plan
from pipeline.spec.scene import Scene

# Fields of the sensor that act on light already drawn. A new field of the detector that is not
# among them is taken to change the light: slower, and the same bits.
DETECTOR = (
    "flat",
    "dark_e_per_s",
    "dark_scale",
    "full_well_e",
    "read_noise_e",
    "gain_e_per_dn",
    "bias_dn",
    "adc_bits",
    "adc_rounding",
    "photon_noise",
)
AFTER_LIGHT = ("seed", *(f"sensor.{name}" for name in DETECTOR))
# Fields that the noise floor falls with, and so the error that drawing may make.
FLOOR = (
    "sensor.read_noise_e",
    "sensor.gain_e_per_dn",
    "sensor.dark_e_per_s",
    "sensor.dark_scale",
)
SKY_FLOOR = ("background.uniform_e_per_s", "background.uniform_mag_arcsec2")
NOISE_FACTS = ("sigma_floor_e", "dark_e", "read_noise_e", "flat")
SKY_FACTS = ("background_e", "background_e_s")
# What each kind of light does not take from the plan. A new part of the plan is taken to matter.
_TOLD = ("scene", "facts", "decisions", "remarks", "warnings", "checks", "tiles")
NOT_OF: dict[str, tuple[str, ...]] = {
    "stars": (*_TOLD, "sky", "sun_rate_e_s_m2"),
    "targets": (*_TOLD, "sky", "colour"),
    "sky": (*_TOLD, "responses", "colour", "sun_rate_e_s_m2"),
}


class ReadsBarredError(Exception):
    """A stage asked for a field that it was said not to depend on."""


class Barred:
    """Stands for a value that may not be read."""

    def __init__(self, name: str) -> None:
        object.__setattr__(self, "_name", name)

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise ReadsBarredError(object.__getattribute__(self, "_name"))

    __bool__ = __int__ = __index__ = __float__ = __len__ = __iter__ = __getattr__ = _refuse
    __eq__ = __hash__ = __str__ = __repr__ = __format__ = __array__ = _refuse
    __add__ = __radd__ = __mul__ = __rmul__ = __sub__ = __rsub__ = __truediv__ = _refuse
    __lt__ = __le__ = __gt__ = __ge__ = __neg__ = __pow__ = __rtruediv__ = __getitem__ = _refuse

    def __reduce__(self) -> Any:
        return Barred, (object.__getattribute__(self, "_name"),)


def barred(model: Any, names: tuple[str, ...]) -> Any:
    """A model whose named fields may not be read."""
    return model.model_copy(update={name: Barred(name) for name in names})


@dataclass(frozen=True)
class LightPlan:
    """What one kind of light is drawn from: its plan, and the content that it depends on."""

    kind: str
    plan: Plan
    content: tuple[Any, ...]

    def geometry(self, g: Geometry) -> Geometry:
        """What this light needs of a frame's geometry."""
        if self.kind == "targets" or not self.content:
            return g
        none = {
            name: getattr(g, name)[:0]
            for name in g.__dataclass_fields__
            if name.startswith("target_")
        }
        return replace(g, **none)


def parts_of(plan: Plan, whole: bool) -> dict[str, LightPlan]:
    """The parts of a plan's light; `whole` takes them from the whole plan, with nothing barred.

    The plan's own scene has barred detector fields and a barred seed where it is not `whole`.
    """
    if whole:
        return {kind: LightPlan(kind, plan, ()) for kind in LIGHTS}
    return {kind: _part(plan, kind) for kind in LIGHTS}


def _part(plan: Plan, kind: str) -> LightPlan:
    scene, facts = plan.scene, plan.facts
    drop: dict[str, Any] = {}
    if kind != "targets":
        drop["targets"] = ()
    if kind != "stars" and scene.stars is not None:  # their effects still turn the directions
        drop["stars"] = scene.stars.model_copy(
            update={"catalogue": "none", "faintest_g_mag": None, "limit_from_noise": False}
        )
    if kind != "sky" and scene.background is not None:
        drop["background"] = None
    kept = scene.model_copy(update=drop)
    hidden = NOISE_FACTS + SKY_FACTS  # the sky is drawn from its plan
    content = [kind, light_content(kept), *_values(facts, hidden), *_values(plan, NOT_OF[kind])]
    kept = barred(kept, ("cosmic_rays", *(drop.keys() & {"background"})))
    without: dict[str, Any] = {name: Barred(name) for name in hidden}
    reduced = replace(
        plan,
        scene=kept,
        facts=replace(facts, **without),
        sky=plan.sky if kind == "sky" else None,
        decisions=(),
        remarks=(),
        warnings=(),
        checks=(),
    )
    return LightPlan(kind, reduced, tuple(content))


def _values(of: Facts | Plan, but: tuple[str, ...]) -> list[Any]:
    return [getattr(of, f.name) for f in fields(of) if f.name not in but]


def light_content(scene: Scene) -> str:
    """A scene's own values, without those that act after the light, as text."""
    sensor = scene.sensor.model_copy(update=dict.fromkeys(DETECTOR))
    plain = scene.model_copy(update={"seed": 0, "name": "", "cosmic_rays": None, "sensor": sensor})
    return plain.model_dump_json(
        by_alias=True, warnings=False, exclude={"output": True, "sensor": set(DETECTOR)}
    )
