"""The plan: what a scene needs, with predicted time and memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import Geometry
from pipeline.physics.colour import ColourFit
from pipeline.physics.constants import ARCSEC_RAD, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.apparent import unaberrated_caps
from pipeline.physics.positions.focal_plane import Camera, corner_radius, stretch
from pipeline.plan.checks import CheckCell, choose_checks
from pipeline.plan.coverage import FieldCoverage
from pipeline.plan.decision import Decision
from pipeline.plan.decisions import decide
from pipeline.plan.facts import Facts
from pipeline.plan.ledger import rule_of
from pipeline.plan.needs import NOTHING_SPENT, Spent, predict
from pipeline.plan.optics.optics import describe
from pipeline.plan.optics.pupil import decide_pupil
from pipeline.plan.pointing.air import above_air
from pipeline.plan.pointing.attitude_motion import decide_motion
from pipeline.plan.pointing.decisions import decide_pointing
from pipeline.plan.pointing.geometry import camera_of
from pipeline.plan.pointing.occultation import decide_occultation
from pipeline.plan.pointing.star_paths import excursions_px
from pipeline.plan.response.responses import ResponsePlan, plan_responses
from pipeline.plan.sensor.detector import decide_detector, lag_depth
from pipeline.plan.sky.air import decide_air
from pipeline.plan.targets.decisions import decide_targets
from pipeline.plan.targets.umbra import decide_umbra
from pipeline.plan.tiles import Tile, plan_tiles, tile_shape
from pipeline.plan.timing import frame_count, integration_range_s, integration_s
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from pipeline.physics.sky.extinction import BandExtinction
    from pipeline.plan.sky.sky import SkyPlan

FIELD_MARGIN_RAD = 30.0 * ARCSEC_RAD  # deflection: 1.75 arcsec at the Sun's limb


@dataclass(frozen=True)
class Plan:
    """What is rendered and how; a value, made before anything is read or drawn.

    shared_frames : so many frames in a row share one drawing of their stars
    """

    scene: Scene
    camera: Camera
    facts: Facts
    responses: ResponsePlan
    colour: ColourFit | None
    sun_rate_e_s_m2: float
    tiles: tuple[Tile, ...]
    checks: tuple[CheckCell, ...]
    decisions: tuple[Decision, ...]
    remarks: tuple[str, ...]
    dut1_s: float
    sky: SkyPlan | None = None
    extinction: BandExtinction | None = None
    warnings: tuple[str, ...] = ()
    coverage: FieldCoverage | None = None
    stars_per_frame: int = 0  # that light the fullest, of a few
    shared_frames: int = 1

    @property
    def frames(self) -> int:
        return frame_count(self.scene)

    def integration_s(self, frame: int) -> float:
        """Integration time of a frame."""
        return integration_s(self.scene, frame)

    def floor_e(self, frame: int) -> float:
        """Noise of a pixel of a frame that holds no source [e-]; the facts' is that of the shortest
        exposure."""
        f, time_s = self.facts, self.integration_s(frame)
        least_s = integration_range_s(self.scene)[0]
        if time_s == least_s or not self.scene.sensor.photon_noise:
            return f.sigma_floor_e
        more = (time_s - least_s) * (f.background_e_s + f.dark_e / least_s)
        return math.sqrt(f.sigma_floor_e**2 + more)

    def snr_floor_e2(self, frame: int) -> float:
        """Square of `floor_e` with the sky after the typical flat [e-^2]."""
        f = self.facts
        if not self.scene.sensor.photon_noise:
            return self.floor_e(frame) ** 2
        sky_e = f.background_e_s * self.integration_s(frame)
        return self.floor_e(frame) ** 2 - (1.0 - f.flat) * sky_e

    def drawn_frame(self, frame: int) -> int:
        """The frame where the stars of a frame stand as they are drawn in it."""
        return frame - frame % self.shared_frames

    @property
    def lag_frames(self) -> int:
        """How many frames before leave charge in a frame."""
        return lag_depth(self.scene, self.facts.sigma_floor_e)

    @property
    def halo_px(self) -> float:
        """How far off the frame a source may be and still send light onto it."""
        return self.responses.reach_px + 2.0


@dataclass(frozen=True)
class StarForecast:
    """What is read of the catalogues, and how many of their stars light a frame."""

    shards: int
    row_groups: int
    rows_to_read: int
    bytes_to_read: int
    stars_per_frame: int


NOTHING_READ = StarForecast(0, 0, 0, 0, 0)


def make_plan(
    scene: Scene,
    facts: Facts,
    ends: Geometry,
    colour: ColourFit | None,
    sun_rate_e_s_m2: float,
    remarks: tuple[str, ...],
    dut1_s: float,
    sky: SkyPlan | None = None,
    extinction: BandExtinction | None = None,
    warnings: tuple[str, ...] = (),
) -> Plan:
    """Decide everything from facts and the geometry of some of its frames."""
    camera = camera_of(scene)
    responses = plan_responses(scene, facts, camera, ends)
    decisions = (
        *decide(scene, facts, responses),
        *decide_occultation(scene, camera, responses.reach_px, ends),
        *decide_targets(scene, facts, ends, responses.blur),
        *decide_umbra(scene, facts, ends, sun_rate_e_s_m2, dut1_s),
        *decide_pupil(scene, ends),
        *decide_air(scene, facts, ends, extinction),
        *(sky.decisions if sky else ()),
        *decide_detector(scene, facts, ends, dut1_s),
        *decide_pointing(scene),
        *decide_motion(scene, facts.sigma_floor_e),
    )
    return Plan(
        scene,
        camera,
        facts,
        responses,
        colour,
        sun_rate_e_s_m2,
        plan_tiles(scene),
        choose_checks(scene, ends),
        decisions,
        remarks,
        dut1_s,
        sky,
        extinction,
        warnings,
    )


def field_cones(plan: Plan, g: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Cones (centres (F, 3), radii (F,) [rad]) that hold every star of each frame.

    The radius holds the focal plane's corners, the halo, the way of the stars during the exposure,
    and what `catalogue_cones` adds.
    """
    # An angle off axis is at most halo radians beyond the corner: the projection only shrinks it.
    way = excursions_px(plan.camera, g, plan.scene.star_effects["aberration"])
    radius = (
        corner_radius(plan.camera)
        + (plan.halo_px + way) * stretch(plan.camera) * plan.facts.ifov_rad
    )
    return catalogue_cones(plan.scene, g, g.attitude[:, g.middle, 2], radius)


def catalogue_cones(
    scene: Scene, g: Geometry, centres: np.ndarray, radius_rad: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cones of the catalogue's sky for cones seen at mid-exposure: (F, 3) and (F,) [rad].

    Refraction and aberration are taken out, the latter at any speed; the radius is widened by a
    margin for deflection. The stars' own motion and parallax are the caller's.
    """
    beta = g.observer_m_s[:, g.middle] / SPEED_OF_LIGHT_M_S
    if scene.stars is not None and not scene.stars.aberration:
        beta = np.zeros_like(beta)
    seen = np.minimum(radius_rad + FIELD_MARGIN_RAD + np.zeros(len(centres)), math.pi)
    centres, seen = above_air(g, centres, seen)
    return unaberrated_caps(centres, seen, beta)


def plan_dict(
    plan: Plan,
    forecast: StarForecast | None,
    catalogues: Sequence[dict[str, Any]] = (),
    spent: Spent = NOTHING_SPENT,
) -> dict[str, Any]:
    """The plan as plain data, for plan.json and `nightglass plan`.

    catalogues : name, digest and what else is told of each, the main one first
    spent : what planning took, and how far its stars move
    """
    f, r, read = plan.facts, plan.responses, forecast or NOTHING_READ
    needs = predict(plan, forecast, spent)
    return {
        "scene": plan.scene.name,
        "warnings": list(plan.warnings),
        "frames": plan.frames,
        "shape": list(plan.scene.sensor.shape),
        "tile_shape": list(tile_shape(plan.scene)),
        "tiles": len(plan.tiles) * plan.frames,
        "shards": read.shards,
        "row_groups": read.row_groups,
        "star_rows_to_read": read.rows_to_read,
        "bytes_to_read": read.bytes_to_read,
        "stars_per_frame": read.stars_per_frame,
        "catalogue": catalogues[0] if catalogues else None,
        "layers": list(catalogues[1:]),
        "coverage": plan.coverage.as_dict() if plan.coverage else None,
        "targets": len(plan.scene.targets),
        "engine": _engine(r),
        "predicted": needs,
        "checked_cells": [asdict(c) for c in plan.checks],
        "noise_floor_e": f.sigma_floor_e,
        "background_e": f.background_e,
        "field_deg": [n * math.degrees(f.ifov_rad) for n in plan.scene.sensor.shape],
        "ifov_arcsec": f.ifov_rad / ARCSEC_RAD,
        "response": {
            "optics": describe(r.blur.optics),
            "field": None if r.field is None else r.field.describe(),
            "core_classes": [_finite(asdict(c)) for c in r.classes],
            "wing_grid_px": r.spacing_px,
            "reach_px": r.reach_px,
            "light_left_out": r.lost_light,
            "streak_zones": r.streaks.zones,
            "streak_pieces": r.streaks.pieces,
            "streak_spread_px": r.streaks.spread_px,
            "spectral_from_stars": r.spectral_from,
        },
        "colour_fit": colour_facts(plan),
        "decisions": [_finite(asdict(d)) | _rule(d) for d in plan.decisions],
        "remarks": list(plan.remarks),
    }


def colour_facts(plan: Plan) -> dict[str, Any] | None:
    """Which colour fit the stars are drawn with; None for a scene without stars."""
    fit = plan.colour
    if fit is None:
        return None
    return {
        "band": fit.band_name,
        "source": fit.source,
        "digest": fit.digest,
        "residual_rms_mag": fit.residual_rms_mag,
        "residual_max_mag": fit.residual_max_mag,
    }


def _engine(r: ResponsePlan) -> str:
    if not r.classes:
        return "none: no sources"
    engine = "stamps + wings" if r.spacing_px else "stamps"
    if r.spectral_from:
        engine += f"; transforms where {r.spectral_from} stars or more light a block"
    return engine


def _rule(decision: Decision) -> dict[str, Any]:
    """What the ledger of omissions says of a decision."""
    rule = rule_of(decision.component)
    return {"rule": rule.rule, "measured_by": rule.test} if rule else {}


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    """Infinite numbers as None: plain JSON has none."""
    return {
        k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()
    }
