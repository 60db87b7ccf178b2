"""A resolved scene: every file read, every default filled, and what follows before any choice."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.physics.colour import ColourFit
from pipeline.physics.motion.streak import LONGEST_PIECE_PX, Path, light_near
from pipeline.physics.positions.focal_plane import Camera
from pipeline.plan.accuracy import part_sigma
from pipeline.plan.facts import Facts
from pipeline.plan.pointing.geometry import camera_of
from pipeline.plan.response.responses import ResponsePlan, plan_responses
from pipeline.plan.response.streaks import STEP_PART, allowed_e, merged_px
from pipeline.plan.sensor.detector import collected_for, lag_depth
from pipeline.plan.timing import frame_count, frame_times, integration_range_s, integration_s
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from pipeline.physics.sky.extinction import BandExtinction
    from pipeline.plan.sky.sky import SkyPlan

SHORTEST_STEP_PX = 5e-3  # of a path, however bright its source


@dataclass(frozen=True)
class ResolvedScene:
    """What is drawn, and by which camera: all that placing and drawing sources needs.

    scene : with the content of its files in place of their names, the members of its populations
        among its targets, and the limit of its stars as a number
    responses : how sources may be drawn; colour : of the stars, None without any
    sun_rate_e_s_m2 : electrons of sunlight [e-/s/m^2], 0 without targets
    dut1_s : UT1 - UTC; sky : None where there is none; extinction : by the air above a site
    """

    scene: Scene
    camera: Camera
    facts: Facts
    responses: ResponsePlan
    colour: ColourFit | None
    sun_rate_e_s_m2: float
    dut1_s: float
    sky: SkyPlan | None
    extinction: BandExtinction | None

    @property
    def frames(self) -> int:
        return frame_count(self.scene)

    def integration_s(self, frame: int) -> float:
        """Integration time of a frame."""
        return integration_s(self.scene, frame)

    def floor_e(self, frame: int) -> float:
        """Noise of a typical pixel of a frame that holds no source [e-]; the facts' is that of a
        quiet one in the shortest exposure."""
        f, time_s = self.facts, self.integration_s(frame)
        least_s, more_e2 = integration_range_s(self.scene)[0], f.quieter_e2
        if time_s != least_s and self.scene.sensor.photon_noise:
            more_e2 += (time_s - least_s) * (f.background_e_s + f.dark_e / least_s)
        return math.sqrt(f.sigma_floor_e**2 + more_e2) if more_e2 else f.sigma_floor_e

    def sky_e_s(self, frame: int, x_px: Array, y_px: Array) -> Array:
        """Sky (n,) at places in a frame, or beside it as at its edge, before the flat [e-/s]."""
        if self.sky is None:
            return np.full(len(x_px), self.facts.background_e_s)
        return self.sky.e_s_at(frame, x_px, y_px)

    def snr_floor_e2(self, frame: int, x_px: Array, y_px: Array) -> Array:
        """Variance (n,) of pixels of a frame that hold no source, at places in it [e-^2].

        That of `floor_e` with the sky there, after the typical flat, for the darkest sky of all.
        """
        f, variance = self.facts, np.full(len(x_px), self.floor_e(frame) ** 2)
        if not self.scene.sensor.photon_noise:
            return variance
        more_e_s = f.flat * self.sky_e_s(frame, x_px, y_px) - f.background_e_s
        return variance + more_e_s * self.integration_s(frame)

    def empty_noise_e(self) -> Array:
        """Noise (frames,) of a pixel without a source in the middle of each frame [e-].

        The root of `snr_floor_e2` there, of all frames at once.
        """
        f, least_s = self.facts, integration_range_s(self.scene)[0]
        if not self.scene.sensor.photon_noise:
            return np.full(self.frames, self.floor_e(0))
        frames, sky_e_s = np.arange(self.frames), np.array([f.background_e_s])
        time_s = frame_times(self.scene, frames)[1]
        if self.sky is not None:
            x, y = np.array(self.camera.centre_px)[:, None]
            knots = self.sky.knots
            at_knots = [float(self.sky.e_s_at(k, x, y)[0]) for k in knots.tolist()]
            sky_e_s = np.interp(frames, knots, at_knots)
        more_e = f.flat * sky_e_s * time_s - f.background_e_s * least_s
        more_e += f.dark_e * (time_s / least_s - 1.0) + f.quieter_e2
        return np.asarray(np.sqrt(f.sigma_floor_e**2 + more_e))

    @property
    def full_e(self) -> float:
        """Charge of a typical pixel [e-] that its well or its converter ends at."""
        s = self.scene.sensor
        top_e = max(0.0, float(collected_for(s, self.facts.top_e)))  # a bias may leave no room
        return min(top_e, s.full_well_e or math.inf)

    def empty_e(self, sky_e_s: Array | float, frame: int = 0) -> Array:
        """Charge (...) of a pixel that holds no source, under skies (...) [e-/s], in a frame."""
        time_s, least_s = self.integration_s(frame), integration_range_s(self.scene)[0]
        dark_e = self.facts.dark_e * (time_s / least_s)
        return np.asarray(self.facts.flat * np.asarray(sky_e_s) * time_s + dark_e)

    def filled(self, frame: int, x_px: Array, y_px: Array) -> NDArray[np.bool_]:
        """Whether sky and dark alone fill typical pixels at places (n,) in a frame."""
        return np.asarray(self.empty_e(self.sky_e_s(frame, x_px, y_px), frame) >= self.full_e)

    def merged_px(self, light_e: Array, share_per_px: float) -> Array:
        """How far straight runs of the paths of sources (n,) of so much light may be off [px].

        share_per_px : part of the light that lies on one px of the path, where it is densest
        """
        return merged_px(light_e, share_per_px, *self._noise)

    def allowed_e(self, along_e: float) -> float:
        """What one approximation may err by in a pixel that holds so much light [e-]."""
        return float(allowed_e(np.array(along_e), *self._noise))

    def field_step_px(self, path: Path, radius_px: float, light_e: float) -> float:
        """Longest step of a source's path that is drawn with the responses of its middle, of those
        that change over the field; their core ends at a radius."""
        if self.responses.field is None or path.length_px == 0.0:
            return LONGEST_PIECE_PX
        near, densest = light_near(path, radius_px)
        changed_e = light_e * near * self.responses.field.steepest
        if changed_e <= 0.0:
            return LONGEST_PIECE_PX
        off = STEP_PART * self.allowed_e(light_e * densest) / changed_e
        return float(np.clip(math.sqrt(12.0 * off), SHORTEST_STEP_PX, LONGEST_PIECE_PX))

    @property
    def _noise(self) -> tuple[float, float, bool]:
        """Of a pixel without sources [e-], what may err there, and whether light has noise."""
        floor_e = self.facts.budget_e / part_sigma(self.scene)
        return floor_e, self.responses.budget_e, self.scene.sensor.photon_noise

    @property
    def lag_frames(self) -> int:
        """How many frames before leave charge in a frame."""
        return lag_depth(self.scene, self.facts.sigma_floor_e)

    @property
    def halo_px(self) -> float:
        """How far off the frame a source may be and still send light onto it."""
        return self.responses.reach_px + 2.0


def resolved_scene(
    scene: Scene,
    facts: Facts,
    g: Geometry,
    colour: ColourFit | None = None,
    sun_rate_e_s_m2: float = 0.0,
    dut1_s: float = 0.0,
    sky: SkyPlan | None = None,
    extinction: BandExtinction | None = None,
) -> ResolvedScene:
    """A scene with its camera and responses; g : geometry of some of its frames."""
    camera = camera_of(scene)
    responses = plan_responses(scene, facts, camera, g, extinction=extinction)
    return ResolvedScene(
        scene, camera, facts, responses, colour, sun_rate_e_s_m2, dut1_s, sky, extinction
    )
