"""A scene made ready to be drawn: its facts gathered, its plan made."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from catalog_tools.engine.schedulers import TASKS_PER_WINDOW
from pipeline.arrays import Geometry, SensorMaps
from pipeline.errors import BadInput
from pipeline.inputs.band.colour_fit_files import colour_fit_of
from pipeline.inputs.band.curves import resolve_response, solar_spectrum
from pipeline.inputs.earth_orientation import gather_dut1_s, with_pole
from pipeline.inputs.memory import free_mb
from pipeline.inputs.pointing_tables import gather_pointing
from pipeline.inputs.sensor.distortion import gather_distortion
from pipeline.inputs.sensor.psf_tables import gather_psf_table
from pipeline.inputs.sensor.sensor import gather_sensor_maps
from pipeline.inputs.stars.catalogues import (
    catalogue_facts,
    catalogue_remarks,
    colour_sentences,
    gather_left_out,
    layer_decisions,
    open_catalogues,
)
from pipeline.inputs.stars.coverage import coverage_sentences, gather_coverage
from pipeline.inputs.stars.stars import (
    Catalogue,
    Shard,
    brightest_g_mags,
    cones_of,
    gather_shards,
)
from pipeline.inputs.targets.ephemerides import gather_ephemerides
from pipeline.physics.colour import ColourFit
from pipeline.physics.positions.times import parse_utc
from pipeline.physics.radiometry import ResponseCurve, band_photon_irradiance_sun
from pipeline.plan.accuracy import judge
from pipeline.plan.bodies.albedos import has_band_albedos, with_band_albedos
from pipeline.plan.coverage import FieldCoverage
from pipeline.plan.facts import Facts, gather_facts
from pipeline.plan.needs import Spent, check_memory, drawing_s
from pipeline.plan.optics.optics import check_motion
from pipeline.plan.pointing.geometry import (
    camera_of,
    epochs_jyear,
    observer_distances_au,
    plan_geometry,
    sampled_frames,
)
from pipeline.plan.pointing.star_paths import excursions_px
from pipeline.plan.scene_plan import (
    Plan,
    StarForecast,
    catalogue_cones,
    field_cones,
    make_plan,
    plan_dict,
)
from pipeline.plan.sensor.detector import typical_read_noise_e
from pipeline.plan.sky.doubts import sky_doubts
from pipeline.plan.stars.brightest import (
    brightest_star_e,
    brightest_target_e,
    points_beyond,
    star_radius_rad,
)
from pipeline.plan.targets.decisions import mesh_notices
from pipeline.plan.targets.orbit_age import orbit_remarks
from pipeline.plan.targets.umbra import umbra_remarks
from pipeline.plan.timing import integration_range_s
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from pipeline.execute.graph import Inputs
    from pipeline.physics.cosmic_rays.frame import CosmicRays
    from pipeline.physics.sky.extinction import BandExtinction
    from pipeline.plan.sky.sky import SkyPlan
    from pipeline.store.cube import CubeWriter

SLOW_S = 0.2  # of CPU: less says nothing of how long a scene takes


@dataclass(frozen=True)
class Prepared:
    """A plan with what was read to make it.

    catalogues : the main one and the layers over it; left_out : of each, the sorted source_ids of
    stars that an earlier one holds; spent : what planning took
    """

    plan: Plan
    maps: SensorMaps
    catalogues: tuple[Catalogue, ...]
    left_out: tuple[np.ndarray, ...]
    spent: Spent
    rays: CosmicRays | None = None

    @property
    def catalogue_digest(self) -> str | None:
        """Of all catalogues that it looked into; None without any."""
        return "+".join(c.digest for c in self.catalogues) or None

    def inputs(self, writer: CubeWriter, plan: Plan | None = None) -> Inputs:
        """What tasks need; plan : in place of its own."""
        from pipeline.execute.graph import Inputs  # drawing: a plan alone does without

        used = plan or self.plan
        return Inputs(used, self.maps, self.catalogues, self.left_out, writer, self.rays)


def resolve(scene: Scene) -> Scene:
    """The scene with what its files of orbits and distortion say, and albedos over the band."""
    scene = with_pole(scene)
    scene = _banded(gather_pointing(gather_ephemerides(gather_distortion(scene))))
    if any(target.body.kind == "mesh" for target in scene.targets):
        from pipeline.inputs.targets.meshes import gather_meshes  # an optional extra: trimesh

        scene = gather_meshes(scene)
    if _site_with_air(scene):
        from pipeline.inputs.sky.air import with_wavelength

        scene = with_wavelength(scene, gather_response(scene)[0])
    return scene


def _site_with_air(scene: Scene) -> bool:
    o = scene.observer
    return isinstance(o, GroundObserver) and o.atmosphere is not None


def _banded(scene: Scene) -> Scene:
    """The scene with numbers for tables of reflectance."""
    if not has_band_albedos(scene):
        return scene
    wavelength, irradiance, *_ = solar_spectrum()
    return with_band_albedos(scene, wavelength, irradiance, gather_response(scene)[0])


def prepare(scene: Scene) -> Prepared:
    """Read curves, fit, sensor images and the catalogues' manifests; decide.

    Stars are read of a few frames, to count them; where there are layers, theirs of all the field,
    and the main catalogue's bright ones around them.
    """
    started = time.thread_time()
    scene = resolve(scene)
    catalogues = open_catalogues(scene.stars.catalogues) if scene.stars is not None else ()
    maps = gather_sensor_maps(scene)
    response, band, digest = gather_response(scene)
    dut1_s, remark = gather_dut1_s(*parse_utc(scene.epoch))
    remarks = [remark] if remark else []
    warnings: list[str] = []  # what the scene accepts though the product is wrong there
    colour, sun = _light(scene, response, band, digest, remarks)
    check_motion(scene)  # before paths are followed that it would bend beyond all measure
    before = time.thread_time()
    geometry = plan_geometry(scene, sampled_frames(scene), dut1_s)
    geometry_s = _geometry_s(scene, geometry, dut1_s, time.thread_time() - before)
    facts = gather_facts(
        scene,
        response,
        maps.typical("dark_e_per_s"),
        typical_read_noise_e(scene, maps),
        maps.typical("gain_e_per_dn"),
        gather_psf_table(scene),
        _brightest_e(scene, catalogues, geometry, colour, sun),
    )
    facts = replace(facts, flat=maps.typical("flat"))
    found = sky_doubts(scene, facts, response, dut1_s)
    warnings += found.warnings
    remarks += found.remarks
    extinction = _extinction(scene, response)
    scene, facts, sky = _sky(
        scene, (response, band, digest), catalogues, colour, facts, geometry, dut1_s, extinction
    )
    scene, geometry = _populated(scene, facts, geometry, dut1_s)
    if scene.stars is not None:
        remarks += catalogue_remarks(catalogues, scene.stars.faintest_g_mag)
    coverage = _judge_catalogues(scene, catalogues, geometry, colour, warnings, remarks)
    remarks += mesh_notices(scene)
    remarks += orbit_remarks(scene, geometry, facts.ifov_rad) + umbra_remarks(scene, geometry)
    plan = make_plan(
        scene,
        facts,
        geometry,
        colour,
        sun,
        tuple(remarks),
        dut1_s,
        sky,
        extinction,
        tuple(warnings),
    )
    left_out = _left_out(plan, catalogues)
    plan = _with_engines(plan, catalogues, left_out, geometry)
    decisions = (*plan.decisions, *layer_decisions(catalogues, left_out))
    doubts = (*judge(scene, decisions), *plan.warnings)
    plan = replace(plan, decisions=decisions, coverage=coverage, warnings=doubts)
    rays = _cosmic_rays(scene)
    moved = excursions_px(plan.camera, geometry, scene.star_effects["aberration"])
    far = float(moved.max()) if scene.stars is not None else 0.0
    bright = points_beyond(plan, geometry)
    spent = Spent(time.thread_time() - started, geometry_s, len(geometry.frame), far, bright)
    return Prepared(plan, maps, catalogues, left_out, spent, rays)


def _geometry_s(scene: Scene, g: Geometry, dut1_s: float, took_s: float) -> float:
    """CPU seconds of the frames of a geometry that took so much, once all is loaded and compiled.

    Where it took SLOW_S or more one frame is gone through again: the first time is no measure.
    """
    if took_s < SLOW_S:
        return took_s
    before = time.thread_time()
    plan_geometry(scene, g.frame[:1], dut1_s)
    return min(took_s, len(g.frame) * (time.thread_time() - before))


def _brightest_e(
    scene: Scene,
    catalogues: tuple[Catalogue, ...],
    g: Geometry,
    colour: ColourFit | None,
    sun_rate_e_s_m2: float,
) -> float:
    """Light of the brightest source in or beside the frames of a geometry [e-]."""
    stars_e = 0.0
    if scene.stars is not None and colour is not None:
        cones = _cones_around(scene, g, star_radius_rad(scene, g))
        limit = scene.stars.faintest_g_mag
        groups = [
            brightest_g_mags(catalogues[s.catalogue], s.leaf, limit)
            for s in gather_shards(catalogues, cones, limit)
        ]
        stars_e = brightest_star_e(scene, colour, (float(m) for g_mag in groups for m in g_mag))
    return max(stars_e, brightest_target_e(scene, g, sun_rate_e_s_m2) if scene.targets else 0.0)


def _judge_catalogues(
    scene: Scene,
    catalogues: tuple[Catalogue, ...],
    geometry: Geometry,
    colour: ColourFit | None,
    warnings: list[str],
    remarks: list[str],
) -> FieldCoverage | None:
    """How much of the frames the main catalogue covers; warnings and remarks on that, and on stars
    without a colour, are added."""
    if not catalogues or colour is None:
        return None
    coverage = gather_coverage(scene, catalogues[0], geometry)
    of_coverage = coverage_sentences(scene, catalogues[0], coverage)
    of_colours = colour_sentences(catalogues, colour)
    warnings += of_coverage[0] + of_colours[0]
    remarks += of_coverage[1] + of_colours[1]
    return coverage


def _with_engines(
    plan: Plan,
    catalogues: tuple[Catalogue, ...],
    left_out: tuple[np.ndarray, ...],
    geometry: Geometry,
) -> Plan:
    """The plan with the stars' engines chosen by those of its fullest frame."""
    if plan.scene.stars is None:
        return plan
    from pipeline.plan.stars.engines import StarCounts, choose_engines
    from pipeline.plan.stars.shared_frames import OwnMotion, share_frames
    from pipeline.route.star_counts import frame_lights

    found = frame_lights(
        plan, catalogues, left_out, geometry, lambda g: shards_of(plan, catalogues, g)
    )
    plan = choose_engines(plan, geometry, StarCounts(*found))
    leaves = [shard.leaf for shard in shards_of(plan, catalogues, geometry)]
    own = OwnMotion(
        max((leaf.max_proper_motion_mas_yr for leaf in leaves), default=0.0),
        max((leaf.max_parallax_mas for leaf in leaves), default=0.0),
    )
    seconds = drawing_s(plan, plan.stars_per_frame)
    return share_frames(plan, geometry.frame, own, seconds)


def _sky(
    scene: Scene,
    sensor: tuple[ResponseCurve, str, str],
    catalogues: tuple[Catalogue, ...],
    colour: ColourFit | None,
    facts: Facts,
    geometry: Geometry,
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

    inputs = gather_sky(scene, *sensor, catalogues, colour, from_noise, extinction)
    sky = plan_sky(scene, camera_of(scene), geometry, facts, inputs, dut1_s, from_noise)
    if stars is not None and from_noise:
        limit = {"faintest_g_mag": sky.faintest_g_mag, "limit_from_noise": False}
        scene = scene.model_copy(update={"stars": stars.model_copy(update=limit)})
    return scene, facts_with_sky(facts, scene, sky), sky


def _extinction(scene: Scene, response: ResponseCurve) -> BandExtinction | None:
    """Extinction by the air above a site; nothing is imported or read for a scene without."""
    if not _site_with_air(scene):
        return None
    from pipeline.inputs.sky.air import gather_extinction

    return gather_extinction(scene, response)


def _populated(
    scene: Scene, facts: Facts, geometry: Geometry, dut1_s: float
) -> tuple[Scene, Geometry]:
    """The scene with the objects of its populations that come into the field, and its geometry."""
    if all(p.screened is not None for p in scene.populations):
        return scene, geometry
    from pipeline.inputs.targets.populations import gather_populations
    from pipeline.plan.response.responses import plan_responses

    r = plan_responses(scene, facts, camera_of(scene), geometry, sources=True)
    full = _banded(gather_populations(scene, r.reach_px + r.reach_core_px + 2.0, dut1_s))
    return full, plan_geometry(full, sampled_frames(full), dut1_s)


def _cosmic_rays(scene: Scene) -> CosmicRays | None:
    """What draws the scene's cosmic rays; nothing is imported or read for a scene without."""
    if scene.cosmic_rays is None:
        return None
    from pipeline.inputs.sensor.cosmic_rays import gather_cosmic_rays

    return gather_cosmic_rays(scene.cosmic_rays, scene.sensor, integration_range_s(scene)[1])


def gather_response(scene: Scene) -> tuple[ResponseCurve, str, str]:
    """Bandpass x optics x quantum efficiency of a scene's sensor, its name and digest."""
    s = scene.sensor
    return resolve_response(s.bandpass.model_dump(), s.transmission, s.quantum_efficiency)


def _light(
    scene: Scene, response: ResponseCurve, band: str, digest: str, remarks: list[str]
) -> tuple[ColourFit | None, float]:
    """The colour fit if there are stars and the Sun's electron rate if there are targets."""
    colour, sun = None, 0.0
    if scene.stars is not None:
        colour = colour_fit_of(scene, response, band, digest)
        remarks.append(
            f"star colours: {colour.source}; fit residual {colour.residual_rms_mag:.3f} mag rms"
        )
    if scene.targets or scene.populations:
        wavelength, irradiance, source, error = solar_spectrum()
        sun = band_photon_irradiance_sun(wavelength, irradiance, response)
        remarks.append(f"solar spectrum: {source}; {error}")
    return colour, sun


def _left_out(plan: Plan, catalogues: tuple[Catalogue, ...]) -> tuple[np.ndarray, ...]:
    """Of each catalogue, the stars in the field of any frame that an earlier one holds."""
    if len(catalogues) < 2:
        return gather_left_out(catalogues, (), None)
    assert plan.scene.stars is not None
    frames = np.arange(plan.frames, dtype=np.int64)
    cones = [
        cone
        for start in range(0, plan.frames, TASKS_PER_WINDOW)
        for cone in _cones(
            plan, plan_geometry(plan.scene, frames[start:][:TASKS_PER_WINDOW], plan.dut1_s)
        )
    ]
    return gather_left_out(catalogues, cones, plan.scene.stars.faintest_g_mag)


def plan_scene(scene: Scene) -> dict[str, Any]:
    """The plan of a scene as plain data (`nightglass plan`), with what its frames will show; what
    it reads, `prepare` says."""
    from pipeline.execute.outlook import outlook

    prepared = prepare(scene)
    return summary_of(prepared) | {"outlook": outlook(prepared.plan)}


def check_cost(scene: Scene, summary: dict[str, Any], most_cpu_s: float | None) -> None:
    """BadInput where a plan predicts more CPU seconds than are allowed; None allows any."""
    asked = summary["predicted"]["cpu_s"]
    if most_cpu_s is not None and asked > most_cpu_s:
        field = "exposure.frames" if scene.dwells is None else "dwells"
        allowed = f"a scene of at most {most_cpu_s:g} CPU s (predicted: {asked:.0f})"
        raise BadInput(field, summary["frames"], allowed)


def summary_of(prepared: Prepared) -> dict[str, Any]:
    facts = catalogue_facts_of(prepared)
    return plan_dict(prepared.plan, forecast(prepared), facts, prepared.spent)


def check_room(prepared: Prepared, most_mb: float | None = None, processes: int = 1) -> None:
    """BadInput where a plan forecasts more memory than this machine has free for each of so many
    processes; most_mb : than so much, whatever is free."""
    if most_mb is None:
        most_mb = free_mb() / processes
    check_memory(prepared.plan, forecast(prepared), prepared.spent, most_mb)


def catalogue_facts_of(prepared: Prepared) -> list[dict[str, Any]]:
    return catalogue_facts(prepared.catalogues, prepared.left_out)


def forecast(prepared: Prepared) -> Any:
    plan, catalogues = prepared.plan, prepared.catalogues
    if plan.scene.stars is None:
        return None
    frames = np.unique(np.linspace(0, plan.frames - 1, min(plan.frames, 32)).astype(np.int64))
    g = plan_geometry(plan.scene, frames, plan.dut1_s)
    leaves = [shard.leaf for shard in shards_of(plan, catalogues, g)]
    groups = [group for leaf in leaves for group in leaf.row_groups]
    rows, size = sum(g.rows for g in groups), sum(g.bytes for g in groups)
    return StarForecast(len(leaves), len(groups), rows, size, plan.stars_per_frame)


def _cones(plan: Plan, g: Geometry) -> tuple[Any, ...]:
    """Cones of the catalogues' sky that hold all stars of the frames of a geometry."""
    centres, radii = field_cones(plan, g)
    return cones_of(centres, radii, epochs_jyear(g), observer_distances_au(g))


def _cones_around(scene: Scene, g: Geometry, radius_rad: np.ndarray) -> tuple[Any, ...]:
    """Cones of the catalogues' sky that hold all stars so near the boresight of each frame."""
    centres, radii = catalogue_cones(scene, g, g.attitude[:, g.middle, 2], radius_rad)
    return cones_of(centres, radii, epochs_jyear(g), observer_distances_au(g))


def shards_of(plan: Plan, catalogues: tuple[Catalogue, ...], g: Geometry) -> tuple[Shard, ...]:
    """Shards that the frames of a geometry need."""
    if plan.scene.stars is None:
        return ()
    return gather_shards(catalogues, _cones(plan, g), plan.scene.stars.faintest_g_mag)
