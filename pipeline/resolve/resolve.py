"""A scene resolved once: its files, its sky, its populations and its stars, before the plan."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry, SensorMaps
from pipeline.inputs.band.response import gather_band_light, gather_response
from pipeline.inputs.earth_orientation import gather_dut1_s, gather_turn_off_rad
from pipeline.inputs.sensor.psf_tables import gather_psf_table
from pipeline.inputs.sensor.sensor import flat_remarks, gather_sensor_maps, unit_warnings
from pipeline.inputs.stars.catalogues import (
    catalogue_remarks,
    colour_sentences,
    open_catalogues,
    undrawn_remarks,
)
from pipeline.inputs.stars.coverage import coverage_sentences, gather_coverage
from pipeline.inputs.stars.stars import Catalogue
from pipeline.physics.colour import ColourFit
from pipeline.physics.positions.times import parse_utc
from pipeline.physics.radiometry import ResponseCurve
from pipeline.plan.coverage import FieldCoverage
from pipeline.plan.facts import Facts, gather_facts
from pipeline.plan.optics.optics import check_motion, optics_remarks, seeing_remarks
from pipeline.plan.pointing.air import weather_remarks
from pipeline.plan.pointing.geometry import camera_of, plan_geometry, sampled_frames
from pipeline.plan.pointing.paths import near_frame
from pipeline.plan.pointing.site import turn_warnings
from pipeline.plan.pointing.timescales import hurried_remarks, light_warnings
from pipeline.plan.resolved import ResolvedScene, resolved_scene
from pipeline.plan.response.responses import plan_responses
from pipeline.plan.response.sources import KnownSources
from pipeline.plan.sensor.detector import (
    converter_top_e,
    cut_off,
    full_share,
    quiet_terms,
    typical_read_noise_e,
)
from pipeline.plan.sensor.rolling import check_rolling, shear_warnings
from pipeline.plan.sensor.time_delay import edge_warnings
from pipeline.plan.sky.doubts import lacks_night, sky_doubts
from pipeline.plan.stars.brightest import brightest_target_e
from pipeline.plan.stars.field_stars import FieldStars
from pipeline.plan.stars.kinked_paths import kink_warnings
from pipeline.plan.targets.decisions import mesh_notices
from pipeline.plan.targets.field_bodies import field_body_warnings
from pipeline.plan.targets.near import near_warnings
from pipeline.plan.targets.orbit_age import orbit_remarks, table_warnings
from pipeline.plan.targets.shared import shared_remarks
from pipeline.plan.targets.umbra import umbra_remarks
from pipeline.plan.timing import frame_times, integration_range_s
from pipeline.resolve.files import has_air, read_files, with_numbers
from pipeline.resolve.stars import (
    brightest_in_field_e,
    gather_field_stars,
    lit_frames,
    stars_left_out,
)
from pipeline.resolve.targets import gather_targets
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from pipeline.physics.cosmic_rays.frame import CosmicRays
    from pipeline.physics.sky.extinction import BandExtinction
    from pipeline.plan.sky.sky import SkyPlan
    from pipeline.plan.sky.undrawn import UndrawnNight

MANY_FULL = 0.05  # of the pixels, though a typical one is not full: an output of its own
MANY_CUT = 0.05  # of the pixels without a source, that would read below 0
SLOW_S = 0.2  # of CPU: less says nothing of how long a scene takes
Band = tuple[ResponseCurve, str, str]


@dataclass(frozen=True)
class Resolved:
    """A resolved scene with what was read on the way.

    geometry : of some of its frames, which took geometry_s of CPU
    catalogues : the main one and the layers over it; left_out : of each, the sorted source_ids of
        stars that an earlier one holds
    stars : those around the field, counted; None for a scene without
    targets : those of all frames; None where not all are known
    warnings : what the scene accepts though the product is wrong there; remarks : what else is
        reported
    """

    scene: ResolvedScene
    geometry: Geometry
    geometry_s: float
    maps: SensorMaps
    catalogues: tuple[Catalogue, ...]
    left_out: tuple[np.ndarray, ...]
    stars: FieldStars | None
    targets: KnownSources | None
    rays: CosmicRays | None
    warnings: tuple[str, ...]
    remarks: tuple[str, ...]


def resolve(asked: Scene) -> Resolved:
    """Read everything that a scene names, and find what its plan rests on.

    Stars are read of a few frames, to count them; where there are layers, theirs of all the field,
    and the main catalogue's bright ones around them.
    Raises BadInput for what the scene asks and cannot have, Damaged for a damaged catalogue.
    """
    scene = read_files(asked)
    catalogues = open_catalogues(scene.stars.catalogues) if scene.stars is not None else ()
    maps = gather_sensor_maps(scene)
    band = gather_response(scene)
    dut1_s, of_time = gather_dut1_s(*parse_utc(scene.epoch))
    light = gather_band_light(scene, *band)
    _check_course(scene)
    g, geometry_s = _timed_geometry(scene, dut1_s)
    facts = gather_facts(
        scene,
        band[0],
        maps.typical("dark_e_per_s"),
        typical_read_noise_e(scene, maps),
        maps.typical("gain_e_per_dn"),
        gather_psf_table(scene),
        max(
            brightest_in_field_e(scene, catalogues, g, light.colour),
            brightest_target_e(scene, g, light.sun_rate_e_s_m2) if scene.targets else 0.0,
        ),
        maps.typical("flat"),
        quiet_terms(scene, maps),
        converter_top_e(scene, maps),
    )
    extinction = _extinction(scene, band[0])
    doubts = sky_doubts(scene, facts, band[0], dut1_s, _night(scene, band[0], extinction, dut1_s))
    scene, facts, sky = _sky(scene, band, catalogues, light.colour, facts, g, dut1_s, extinction)
    scene, g = _populated(scene, facts, g, dut1_s)
    coverage, warnings, remarks = _judge_catalogues(scene, catalogues, g, light.colour)
    resolved = resolved_scene(
        scene, facts, g, light.colour, light.sun_rate_e_s_m2, dut1_s, sky, extinction
    )
    left_out = stars_left_out(resolved, catalogues)
    field_stars = gather_field_stars(resolved, catalogues, left_out, g, coverage)
    return Resolved(
        resolved,
        g,
        geometry_s,
        maps,
        catalogues,
        left_out,
        field_stars,
        gather_targets(resolved, g),
        _cosmic_rays(scene),
        (
            *doubts.warnings,
            *warnings,
            *_none_in_field(resolved, g, field_stars),
            *_of_sensor(resolved, maps, g),
            *_of_targets(scene, g, facts),
            *turn_warnings(scene, g, facts.ifov_rad, gather_turn_off_rad(scene)),
        ),
        (
            *([of_time] if of_time else ()),
            *light.remarks,
            *doubts.remarks,
            *remarks,
            *undrawn_remarks(asked, _limit_g_mag(scene), catalogues, facts, light.colour),
            *optics_remarks(scene),
            *seeing_remarks(scene, g),
            *flat_remarks(scene, maps),
            *weather_remarks(scene),
            *hurried_remarks(scene, g, near_frame(scene, g)),
            *mesh_notices(scene),
            *shared_remarks(scene),
            *orbit_remarks(scene, g, facts.ifov_rad),
            *umbra_remarks(scene, g),
            *(sky.remarks if sky is not None else ()),
        ),
    )


def _limit_g_mag(scene: Scene) -> float | None:
    """The limit of stars, the scene's own or the noise's; None where all are drawn."""
    return None if scene.stars is None else scene.stars.faintest_g_mag


def _of_targets(scene: Scene, g: Geometry, facts: Facts) -> list[str]:
    """The warnings on where targets are between rows of tables, and on how near they are."""
    return [
        *table_warnings(scene, g, facts.ifov_rad),
        *near_warnings(scene, g),
        *light_warnings(scene, g, near_frame(scene, g)),
    ]


def _of_sensor(resolved: ResolvedScene, maps: SensorMaps, g: Geometry) -> list[str]:
    """The warnings on the sensor's terms, and on the pixels that they drive to an end."""
    return [
        *_filled(resolved, maps, g.frame),
        *_cut_off(resolved, maps),
        *unit_warnings(resolved.scene),
        *field_body_warnings(resolved, g),
        *shear_warnings(resolved, g),
        *edge_warnings(resolved, g),
        *kink_warnings(resolved, g),
    ]


def _filled(resolved: ResolvedScene, maps: SensorMaps, sampled: NDArray[np.int64]) -> list[str]:
    """The warning that no source shows in the middle of frames, as pixels are full without any.

    Looked at are the frames sampled, those between which the sky is linear, and one of each
    integration time.
    """
    times_s = frame_times(resolved.scene, np.arange(resolved.frames))[1]
    looked_at = np.union1d(sampled, np.unique(times_s, return_index=True)[1])
    if resolved.sky is not None:
        looked_at = np.union1d(looked_at, resolved.sky.knots)
    x, y = np.array(resolved.camera.centre_px)[:, None]
    full = [k for k in looked_at.tolist() if resolved.filled(k, x, y)[0]]
    if not full:
        return _partly_filled(resolved, maps, looked_at)
    empty_e = float(resolved.empty_e(resolved.sky_e_s(full[0], x, y), full[0])[0])
    more = f" there, and in {len(full) - 1} more of {len(looked_at)} frames looked at"
    return [
        f"sky and dark current alone give a typical pixel {empty_e:.3g} e- in frame {full[0]}, "
        f"which fills it ({resolved.full_e:.3g} e- above the bias, its full well or the top of the "
        f"converter): no source shows{more if len(full) > 1 else ''}"
    ]


def _partly_filled(
    resolved: ResolvedScene, maps: SensorMaps, frames: NDArray[np.int64]
) -> list[str]:
    """The warning that many pixels are full without a source, though a typical one is not."""
    worst = max(frames.tolist(), key=lambda k: float(resolved.empty_e(_sky_e_s(resolved, k), k)))
    sky_e_s, time_s = _sky_e_s(resolved, worst), resolved.integration_s(worst)
    share = full_share(resolved.scene, maps, sky_e_s, time_s)
    if share < MANY_FULL:
        return []
    return [
        f"sky and dark current alone fill {share:.1%} of the pixels in frame {worst} (full well, "
        "or the converter's top with their own gain and bias): no source shows in them"
    ]


def _cut_off(resolved: ResolvedScene, maps: SensorMaps) -> list[str]:
    """The warning that the converter cuts off the noise of pixels that hold no source, at 0 DN."""
    frame = int(np.argmin(frame_times(resolved.scene, np.arange(resolved.frames))[1]))
    sky_e_s, time_s = _sky_e_s(resolved, frame), resolved.integration_s(frame)
    share, more_e = cut_off(resolved.scene, maps, sky_e_s, time_s)
    if share < MANY_CUT:
        return []
    return [
        f"sensor.bias_dn: {share:.1%} of the pixels without a source lie below 0 DN in frame "
        f"{frame} and read 0: the mean is {more_e:.3g} e- too high, the noise too low; a bias of "
        "several times the noise avoids it"
    ]


def _sky_e_s(resolved: ResolvedScene, frame: int) -> float:
    """Sky in the middle of a frame [e-/s]."""
    return float(resolved.sky_e_s(frame, *np.array(resolved.camera.centre_px)[:, None])[0])


def _check_course(scene: Scene) -> None:
    """Refuse random motion that bends paths beyond all measure, or whose course a rolling shutter
    would need, before any path is followed."""
    check_motion(scene)
    check_rolling(scene)


def _timed_geometry(scene: Scene, dut1_s: float) -> tuple[Geometry, float]:
    """Geometry of some frames, and the CPU seconds that it takes once all is loaded and compiled.

    Where it took SLOW_S or more one frame is gone through again: the first time is no measure.
    """
    started = time.thread_time()
    g = plan_geometry(scene, sampled_frames(scene), dut1_s)
    took_s = time.thread_time() - started
    if took_s < SLOW_S:
        return g, took_s
    before = time.thread_time()
    plan_geometry(scene, g.frame[:1], dut1_s)
    return g, min(took_s, len(g.frame) * (time.thread_time() - before))


def _extinction(scene: Scene, response: ResponseCurve) -> BandExtinction | None:
    """Extinction by the air above a site; nothing is imported or read for a scene without."""
    if not has_air(scene):
        return None
    from pipeline.inputs.sky.air import gather_extinction

    return gather_extinction(scene, response)


def _night(
    scene: Scene, response: ResponseCurve, extinction: BandExtinction | None, dut1_s: float
) -> UndrawnNight | None:
    """Moonlight and twilight that a site's scene does not draw; nothing is read for others."""
    if not lacks_night(scene):
        return None
    from pipeline.inputs.sky.night import gather_undrawn

    return gather_undrawn(scene, response, extinction, dut1_s)


def _sky(
    scene: Scene,
    band: Band,
    catalogues: tuple[Catalogue, ...],
    colour: ColourFit | None,
    facts: Facts,
    g: Geometry,
    dut1_s: float,
    extinction: BandExtinction | None,
) -> tuple[Scene, Facts, SkyPlan | None]:
    """The sky, the facts with it, and the scene with the limit that the noise set."""
    b, stars = scene.background, scene.stars
    from_noise = stars is not None and stars.limit_from_noise
    if not from_noise and b is None:
        return scene, facts, None
    from pipeline.inputs.sky.sky import gather_sky
    from pipeline.plan.sky.sky import facts_with_sky, plan_sky

    inputs = gather_sky(scene, *band, catalogues, colour, from_noise, extinction)
    sky = plan_sky(scene, camera_of(scene), g, facts, inputs, dut1_s, from_noise)
    if stars is not None and from_noise:
        limit = {"faintest_g_mag": sky.faintest_g_mag, "limit_from_noise": False}
        scene = scene.model_copy(update={"stars": stars.model_copy(update=limit)})
    return scene, facts_with_sky(facts, scene, sky), sky


def _populated(scene: Scene, facts: Facts, g: Geometry, dut1_s: float) -> tuple[Scene, Geometry]:
    """The scene with the objects of its populations that come into the field, and its geometry."""
    if all(p.screened is not None for p in scene.populations):
        return scene, g
    from pipeline.inputs.targets.populations import gather_populations

    r = plan_responses(scene, facts, camera_of(scene), g, sources=True)
    full = with_numbers(gather_populations(scene, r.reach_px + r.reach_core_px + 2.0, dut1_s))
    return full, plan_geometry(full, sampled_frames(full), dut1_s)


def _judge_catalogues(
    scene: Scene, catalogues: tuple[Catalogue, ...], g: Geometry, colour: ColourFit | None
) -> tuple[FieldCoverage | None, tuple[str, ...], tuple[str, ...]]:
    """How much of the frames the main catalogue covers; warnings and remarks on that, and on stars
    without a colour."""
    if scene.stars is None or colour is None:
        return None, (), ()
    coverage = gather_coverage(scene, catalogues[0], g)
    of_coverage = coverage_sentences(scene, catalogues[0], coverage)
    of_colours = colour_sentences(catalogues, colour)
    of_limits = catalogue_remarks(catalogues, scene.stars.faintest_g_mag)
    return (
        coverage,
        (*of_coverage[0], *of_colours[0]),
        (*of_limits, *of_coverage[1], *of_colours[1]),
    )


def _none_in_field(
    resolved: ResolvedScene, g: Geometry, field_stars: FieldStars | None
) -> tuple[str, ...]:
    """The warning that no star lies in the field, where only the rows say that it is covered."""
    if field_stars is None or field_stars.coverage is None or not lit_frames(resolved, g):
        return ()
    warning = field_stars.coverage.warning_of_no_star(field_stars.counts.total)
    return (warning,) if warning else ()


def _cosmic_rays(scene: Scene) -> CosmicRays | None:
    """What draws the scene's cosmic rays; nothing is imported or read for a scene without."""
    if scene.cosmic_rays is None:
        return None
    from pipeline.inputs.sensor.cosmic_rays import gather_cosmic_rays

    return gather_cosmic_rays(scene.cosmic_rays, scene.sensor, integration_range_s(scene)[1])
