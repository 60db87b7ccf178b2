"""What a plan needs: CPU seconds and memory, from unit costs, and what is too much."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pipeline.errors import BadInput
from pipeline.physics.drawing.quadrature import has_profile, profile_s
from pipeline.physics.noise.converter import dn_type
from pipeline.physics.psf.aperture import Pupil
from pipeline.physics.psf.band import Mixture
from pipeline.physics.psf.pupil import Blur
from pipeline.physics.psf.response import oversampling_for
from pipeline.plan.checks import FINE_KERNELS, fine_ends
from pipeline.plan.cost import NOISE_S_PER_PIXEL, START_S, check_count, least_cpu_s
from pipeline.plan.optics.optics import LARGEST_CORE_SAMPLES
from pipeline.plan.plan import Plan
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.response.responses import crowd_s, stamp_s
from pipeline.plan.tiles import BLOCK_PX, blocks_of, tile_shape

# Measured on one core of the 2-core reference machine (benchmarks/frame.py prints them anew).
PLACE_S_PER_STAR = 0.6e-6
WING_S_PER_PIXEL = 25e-9
CROWD_BYTES_PER_PIXEL = 50.0
OWN_POINTS_MB = 30.0  # of points along stars' own paths that are spread together
STAR_BYTES = 150.0
BASE_MB = 180.0  # of a process that has imported all and draws nothing
GRID_S_PER_POINT = 1e-7  # of a block's grid of wings, for each core class
SWEEP_S_PER_POINT = 2e-8  # of that grid, for each segment of its streak
KERNEL_S_PER_POINT = 7e-8  # of the grid that a wing is made on, with its core; of a band the same
CORE_S_PER_SAMPLE = 1.3e-7  # of a response's core, with its spectrum
PUPIL_S_PER_POINT = 1.2e-8  # and more of it for each wavelength of an aperture with a wavefront
THREAD_SHARE = 0.5  # of a tile's arrays, that each further thread holds at once with the first
LIBRARY_MB = 150.0  # more, of one that draws sources: compiled loops, tables of responses
KERNEL_BYTES = 128e6  # of the wings of blocks, that a process keeps
TABLE_BYTES = 192e6  # of the cores, spectra and tables that a process keeps
KERNEL_BYTES_PER_POINT = 18.0  # while a wing is made
TEST_BYTES_PER_POINT = 60.0  # while a wing's error is measured
CORE_BYTES = 50.0  # of a sample of a core, while it is made
SLOW_S = 0.05  # a frame's geometry: where planning took more, its measured time counts
CLASSES_USED = 3  # of the core classes, by the sources of a usual scene


@dataclass(frozen=True)
class Spent:
    """What planning took, which drawing takes again for every frame, and how far stars move.

    cpu_s : CPU seconds of planning; geometry_s : of them for the geometry of `frames` frames
    excursion_px : farthest that a star moves from its place at mid-exposure
    beyond_s : CPU seconds a frame of targets drawn by quadrature: points too bright for all classes
    near : whether a target may light a frame, from beside it too
    """

    cpu_s: float = 0.0
    geometry_s: float = 0.0
    frames: int = 1
    excursion_px: float = 0.0
    beyond_s: float = 0.0
    near: bool = True


NOTHING_SPENT = Spent()


@dataclass(frozen=True)
class StarForecast:
    """What is read of the catalogues, and how many of their stars light a frame."""

    shards: int
    row_groups: int
    rows_to_read: int
    bytes_to_read: int
    stars_per_frame: int


NOTHING_READ = StarForecast(0, 0, 0, 0, 0)


def frame_seconds(plan: Plan, forecast: StarForecast | None) -> float:
    """Predicted CPU seconds of one frame, from measured unit costs."""
    pixels = math.prod(plan.scene.sensor.shape)
    stars = forecast.stars_per_frame if forecast else 0
    light_s = pixels * WING_S_PER_PIXEL if plan.responses.spacing_px else 0.0
    return pixels * NOISE_S_PER_PIXEL + stars * PLACE_S_PER_STAR + drawing_s(plan, stars) + light_s


def predict(
    plan: Plan, forecast: StarForecast | None, spent: Spent = NOTHING_SPENT
) -> dict[str, float]:
    """Predicted CPU seconds, and memory of a process with one thread that draws.

    cpu_s : of one core, for planning, drawing and finishing, with START_S for a process that
        starts; what compiling takes, once on a machine, is not in it. Slow geometry (meshes,
        light of the Earth on bodies, forces) and slow planning count as they were measured: two
        plans of such a scene differ a little
    worker_memory_mb : all that such a process holds at its most, with the BASE_MB that it holds
        before it draws anything
    Of scenes that take less than some 2 s and 400 MB neither says more than that.
    """
    pixels = math.prod(plan.scene.sensor.shape)
    layers = {*plan.scene.output.layers} - {"dn"}  # numbers of 4 bytes; `dn` is always kept
    pixel_bytes = dn_type(plan.scene.sensor.adc_bits).itemsize + 4.0 * len(layers)
    geometry_s = spent.geometry_s / spent.frames
    stars = forecast.stars_per_frame if forecast else 0
    placed_s = stars * PLACE_S_PER_STAR + (2.0 * geometry_s if geometry_s > SLOW_S else 0.0)
    drawn_s = frame_seconds(plan, forecast) - pixels * NOISE_S_PER_PIXEL + _wings_s(plan, spent)
    drawn_s -= stars * PLACE_S_PER_STAR
    light_s = plan.frames * (placed_s + spent.beyond_s)
    light_s += math.ceil(plan.frames / plan.shared_frames) * drawn_s
    once_s = max(0.0, spent.cpu_s - START_S) + _kernels_s(plan, spent) + _profiles_s(plan, spent)
    once_s += _cores_s(plan, spent)
    return {
        "cpu_s": least_cpu_s(plan.scene) + once_s + light_s,
        "worker_memory_mb": sum(_memory_mb(plan, forecast, spent).values()),
        "product_mb": pixels * plan.frames * pixel_bytes / 1e6,
    }


def check_memory(
    plan: Plan, forecast: StarForecast | None, spent: Spent, most_mb: float, threads: int = 1
) -> None:
    """BadInput, naming what takes most, where the memory of a process with so many threads that
    draw is more than there is."""
    parts = _memory_mb(plan, forecast, spent)
    at_once = min(threads, plan.frames * len(plan.tiles))
    parts["threads"] = (at_once - 1) * THREAD_SHARE * parts["tile"]
    needed = sum(parts.values())
    if needed <= most_mb:
        return
    r, scene = plan.responses, plan.scene
    what = max(parts, key=parts.__getitem__)
    field, value, remedy = {
        "tile": ("output.tile_shape", list(tile_shape(scene)), "smaller tiles, or fewer layers"),
        "stars": (
            "stars.faintest_g_mag",
            scene.stars and scene.stars.faintest_g_mag,
            "a brighter limit",
        ),
        "tables": ("sensor.psf", scene.sensor.psf.kind, "fewer places, or less oversampling"),
        "threads": ("--workers", threads, "fewer threads, or smaller tiles"),
        "wings": (
            "accuracy.flux_fraction",
            scene.accuracy.flux_fraction,
            f"a larger fraction (light is drawn up to {r.reach_px:.0f} px from its source)",
        ),
        "sweeps": (
            "exposure.integration_s",
            scene.exposure.integration_s,
            f"a shorter exposure (stars move by {spent.excursion_px:.0f} px in it)",
        ),
    }.get(what, ("sensor.shape", list(scene.sensor.shape), "a smaller frame"))
    raise BadInput(
        field,
        value,
        f"what needs at most the {most_mb:.0f} MB of memory that there are, not {needed:.0f} MB: "
        f"{remedy}, or more memory",
    )


def _memory_mb(plan: Plan, forecast: StarForecast | None, spent: Spent) -> dict[str, float]:
    """Memory by what takes it [MB]."""
    stars = forecast.stars_per_frame if forecast else 0
    rows, columns = tile_shape(plan.scene)
    r = plan.responses
    out = {
        "base": BASE_MB + (LIBRARY_MB if r.classes else 0.0),
        "tile": rows * columns * 8.0 * (8 + len(plan.scene.output.layers)) / 1e6,
        "stars": stars * STAR_BYTES / 1e6,
        "tables": r.table_mb + max(0.0, _core_mb(plan) - LIBRARY_MB),
    }
    own = any(core.together_from for core in r.classes)
    if _in_crowds(plan, stars) or own:
        pixels = min(math.prod(plan.scene.sensor.shape), BLOCK_PX**2)
        out["crowds"] = CROWD_BYTES_PER_PIXEL * pixels / 1e6
        out["crowds"] += own * (out["crowds"] + OWN_POINTS_MB)  # most in float64
    if r.spacing_px and _classes_used(plan, spent, r.around):
        classes = 4.0 + min(CLASSES_USED, len(r.classes))
        still = _grid_points(plan, 0.0) * 8.0 * classes
        making = KERNEL_BYTES_PER_POINT * _kernel_points(plan)
        out["wings"] = (still + max(making, TEST_BYTES_PER_POINT * _test_points(plan))) / 1e6
        out["sweeps"] = _grid_points(plan, spent.excursion_px) * 8.0 * classes / 1e6 - still / 1e6
    return out


def _core_mb(plan: Plan) -> float:
    """Memory of making the largest core [MB]; usual ones are in LIBRARY_MB."""
    radius_px, finest = plan.responses.reach_core_px, map(oversampling_for, plan.responses.blurs)
    return CORE_BYTES * (2.0 * radius_px * max(finest)) ** 2 / 1e6 if radius_px else 0.0


def _grid_points(plan: Plan, excursion_px: float) -> float:
    """Points of a block's grid of wings."""
    around = 2.0 * (plan.halo_px + excursion_px)
    sides = (min(n, BLOCK_PX) + around for n in plan.scene.sensor.shape)
    return math.prod(side / plan.responses.spacing_px + 8.0 for side in sides)


def _kernel_points(plan: Plan) -> float:
    """Points of the grid that a wing is made on."""
    return (4.0 * plan.responses.reach_px / plan.responses.spacing_px) ** 2


def _test_points(plan: Plan) -> float:
    """Points that the measuring of a wing's error takes at most."""
    return min(6.0 * 2.0 * plan.responses.usual_px * 4.0, 2048.0) ** 2


def _wings_s(plan: Plan, spent: Spent) -> float:
    """CPU seconds of the grids of wings of a frame."""
    r = plan.responses
    if not (r.spacing_px and _classes_used(plan, spent, r.around)):
        return 0.0
    blocks = blocks_of(plan.scene.sensor.shape)
    each = GRID_S_PER_POINT * min(CLASSES_USED, len(r.classes))
    if spent.excursion_px:
        each += SWEEP_S_PER_POINT * 8.0
    return blocks * each * _grid_points(plan, spent.excursion_px)


def _kernels_s(plan: Plan, spent: Spent) -> float:
    """CPU seconds of making the wings: of a block's grid and of each grid of the check.

    Once in a process, or for every frame where they are more than are kept.
    """
    r = plan.responses
    if not r.spacing_px:
        return 0.0
    kernels = len(r.blurs) * _classes_used(plan, spent, r.around)
    of_frames = plan.frames if kernels * 8.0 * _grid_points(plan, 0.0) > KERNEL_BYTES else 1
    windows = 2 * check_count(plan.scene)
    fine = fine_ends(r.spacing_px, r.reach_px)
    of_windows = windows if len(fine) * kernels > FINE_KERNELS else min(1, windows)
    each = KERNEL_S_PER_POINT + PUPIL_S_PER_POINT * max(map(_wavefronts, r.blurs))
    points = of_frames * _kernel_points(plan)
    points += of_windows * sum((4.0 * last / spacing) ** 2 for spacing, _, last in fine)
    return kernels * each * points


def _cores_s(plan: Plan, spent: Spent) -> float:
    """CPU seconds of making the check's cores, twice as wide as those that draw.

    Once in a process, or, where all cores are more than are kept, for every window; then those
    that draw stars, and their truth's, are made again for every frame.
    """
    r = plan.responses
    used = math.ceil(_classes_used(plan, spent, r.expected[:-1]))
    if not (r.classes and used):
        return 0.0
    finest = [oversampling_for(blur) for blur in r.blurs]

    def samples(radius_px: float, most: float = math.inf) -> float:
        return sum((2.0 * min(radius_px * os, most)) ** 2 for os in finest)

    windows = 2 * check_count(plan.scene)
    of_check = samples(2.0 * r.classes[used - 1].radius_px, LARGEST_CORE_SAMPLES) * bool(windows)
    drawn, of_truth = sum(samples(c.radius_px) for c in r.classes[:used]), samples(r.usual_px)
    # With a spectrum each, beside the drawing's tables.
    if 16.0 * max(of_check, of_truth) + 1e6 * r.table_mb <= TABLE_BYTES:
        return CORE_S_PER_SAMPLE * of_check * min(1, windows)
    of_frames = plan.frames * (drawn / plan.shared_frames + of_truth) * bool(plan.scene.stars)
    return CORE_S_PER_SAMPLE * (of_check * windows + of_frames)


def _classes_used(plan: Plan, spent: Spent, expected: tuple[float, ...]) -> float:
    """How many of the core classes have sources near a frame; expected : stars of each."""
    r, scene = plan.responses, plan.scene
    unknown = float(CLASSES_USED) if scene.stars is not None else 0.0
    used = sum(min(1.0, n) for n in expected) if expected else unknown
    others = 1.0 if spent.near and (scene.targets or scene.populations) else 0.0
    return min(float(CLASSES_USED), float(len(r.classes)), used + others)


def _wavefronts(blur: Blur) -> int:
    """How many wavelengths of an aperture with vanes or a wavefront a response holds."""
    optics = blur.optics
    parts = optics.parts if isinstance(optics, Mixture) else (optics,)
    return sum(isinstance(part, Pupil) for part in parts)


def _profiles_s(plan: Plan, spent: Spent) -> float:
    """CPU seconds of the profiles of sources that are drawn by quadrature, if any may be so bright.

    Those of sources nearer are made too, at radii that halve: as much again.
    """
    r, bright_e = plan.responses, plan.facts.brightest_e
    if not r.classes or bright_e <= min(r.classes[-1].brightest_e, r.classes[-1].target_e):
        return 0.0
    stars = plan.scene.stars is not None and (min(1.0, r.expected[-1]) if r.expected else 1.0)
    likely = max(float(spent.beyond_s > 0.0), stars)
    return 2.0 * likely * sum(profile_s(b, r.reach_px) for b in r.blurs if has_profile(b))


def _in_crowds(plan: ResolvedScene, stars: int) -> bool:
    """Whether the frame's stars, spread evenly, are enough for transforms."""
    blocks = blocks_of(plan.scene.sensor.shape)
    own = plan.responses.classes[0].together_from if plan.responses.classes else 0
    return not own and 0 < plan.responses.spectral_from <= stars / blocks


def drawing_s(plan: ResolvedScene, stars: int) -> float:
    """CPU seconds of drawing the stars of a frame, with stamps or in crowds."""
    r = plan.responses
    if not r.classes or not stars:
        return 0.0
    if _in_crowds(plan, stars):
        return crowd_s(r, math.prod(plan.scene.sensor.shape), stars) + (r.stars_s or 0.0)
    if r.stars_s is not None:
        return r.stars_s
    drawn = stars * min(4, len(r.blurs))  # by the responses around each
    return drawn * r.streaks.pieces * stamp_s(r)
