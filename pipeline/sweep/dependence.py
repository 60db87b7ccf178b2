"""Which fields of a scene reach which stage of its light; all others are neutral in its plan.

A stage is known by the content of the plan that it is run on. What it gives cannot differ between
points by a field that is not in its key: that field has the same value for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from catalog_tools.documents import Arguments
from pipeline.arrays import Geometry
from pipeline.execute.tile import LIGHTS
from pipeline.plan.facts import Facts
from pipeline.plan.plan import Plan
from pipeline.spec.scene import Scene

# Fields of the sensor that act on light already drawn, as light is drawn. A new field of the
# detector that is not among them is taken to change the light: slower, and the same bits.
NEUTRAL = {
    "flat": 1.0,
    "dark_e_per_s": 0.0,
    "dark_scale": 1.0,
    "full_well_e": None,
    "read_noise_e": 0.0,
    "gain_e_per_dn": 1.0,
    "bias_dn": 0.0,
    "adc_bits": 16,
    "adc_rounding": "half_even",
    "photon_noise": True,
}
DETECTOR = tuple(NEUTRAL)
AFTER_LIGHT = ("seed", *(f"sensor.{name}" for name in DETECTOR))
# Fields that the noise floor falls with, and so the error that drawing may make.
FLOOR = (
    "sensor.read_noise_e",
    "sensor.gain_e_per_dn",
    "sensor.dark_e_per_s",
    "sensor.dark_scale",
)
FLAT = "sensor.flat"  # that errors of the light grow with
SKY_FLOOR = ("background.uniform_e_per_s", "background.uniform_mag_arcsec2")
NOISE_FACTS = ("sigma_floor_e", "dark_e", "read_noise_e", "flat", "quieter_e2", "top_e")
SKY_FACTS = ("background_e", "background_e_s")
# What each kind of light does not take from the plan. A new part of the plan is taken to matter.
_TOLD = ("scene", "facts", "decisions", "remarks", "warnings", "checks", "tiles")
NOT_OF: dict[str, tuple[str, ...]] = {
    "stars": (*_TOLD, "sky", "sun_rate_e_s_m2"),
    "targets": (*_TOLD, "sky", "colour"),
    "sky": (*_TOLD, "responses", "colour", "sun_rate_e_s_m2"),
}


def is_plain(scene: Scene) -> bool:
    """Whether the detector is made of numbers and images alone, with no extras drawn from a seed.

    Extras are taken to change everything: points that have them share nothing.
    """
    return scene.sensor.detector is None


def light_is_shared(scene: Scene) -> bool:
    """Whether points that differ in their seed and detector have one light: nothing that is
    planned or drawn before the noise comes from the seed."""
    attitude = scene.pointing.attitude
    return is_plain(scene) and not (attitude is not None and attitude.random)


@dataclass(frozen=True)
class LightPlan:
    """What one kind of light is drawn from: its plan, and the content that it depends on."""

    kind: str
    plan: Plan
    content: tuple[object, ...]

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


def parts_of(plan: Plan) -> dict[str, LightPlan]:
    """The parts of a plan's light, each without what it does not depend on; of a plan whose light
    is not shared, from all of it."""
    if not light_is_shared(plan.scene):
        return {kind: LightPlan(kind, plan, ()) for kind in LIGHTS}
    sensor = plan.scene.sensor.model_copy(update=NEUTRAL)
    plan = replace(plan, scene=plan.scene.model_copy(update={"sensor": sensor}))
    return {kind: _part(plan, kind) for kind in LIGHTS}


def _part(plan: Plan, kind: str) -> LightPlan:
    scene, facts = plan.scene, plan.facts
    drop: dict[str, object] = {"cosmic_rays": None}
    if kind != "targets":
        drop["targets"] = ()
    if kind != "stars" and scene.stars is not None:  # their effects still turn the directions
        drop["stars"] = scene.stars.model_copy(
            update={"catalogue": "none", "faintest_g_mag": None, "limit_from_noise": False}
        )
    if kind != "sky":
        drop["background"] = None
    kept = scene.model_copy(update=drop)
    hidden = NOISE_FACTS + SKY_FACTS  # the sky is drawn from its plan
    content = [kind, light_content(kept), *_values(facts, hidden), *_values(plan, NOT_OF[kind])]
    without: Arguments = dict.fromkeys(hidden, 0.0)
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


def _values(of: Facts | Plan, but: tuple[str, ...]) -> list[object]:
    return [getattr(of, f.name) for f in fields(of) if f.name not in but]


def light_content(scene: Scene) -> str:
    """A scene's own values, without those that act after the light, as text."""
    after = {"seed": True, "name": True, "cosmic_rays": True, "output": True}
    parts = {"sensor": set(DETECTOR), "accuracy": {"check_cells"}}
    return scene.model_dump_json(by_alias=True, exclude={**after, **parts})
