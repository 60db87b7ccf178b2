"""How sources are drawn: core radii by brightness, phases, the coarse grid of the wings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.kept import kept_number
from pipeline.physics.drawing.extended import point_error
from pipeline.physics.drawing.quadrature import FAINTEST, affordable
from pipeline.physics.drawing.wings import CUT_FROM, swept_apart, wing_error, wing_slope
from pipeline.physics.motion.streak import POINT, Path
from pipeline.physics.positions.focal_plane import Camera
from pipeline.physics.psf.product import is_product
from pipeline.physics.psf.pupil import Blur, EllipticalGaussian, Gaussian
from pipeline.physics.psf.response import band_of, compact_core, oversampling_for
from pipeline.physics.psf.sampled import READ_ERROR, Sampled
from pipeline.plan.accuracy import part_sigma
from pipeline.plan.facts import Facts
from pipeline.plan.optics.optics import (
    LARGEST_CORE_PX,
    LARGEST_CORE_SAMPLES,
    check_core,
    check_ringing,
    check_scale,
    missing_light,
)
from pipeline.plan.pointing.star_light import star_light
from pipeline.plan.response.streaks import (
    StreakPlan,
    over_field,
    plan_streaks,
    resting,
    zone_streak,
)
from pipeline.plan.response.wing_sweeps import WingSweeps, wing_sweeps
from pipeline.plan.tiles import BLOCK_PX
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from pipeline.physics.sky.extinction import BandExtinction
    from pipeline.plan.optics.psf_field import PsfField

Cores = tuple[tuple[float, float, float], ...]  # radius [px], brightest [e-], wing's error

TABLE_BYTES = 48e6
FIELD_BYTES = 80e6  # what the tables of one core class may take together, over a field
MOST_CLASSES = 5
FAINT_RADIUS, FAINT_PART = 0.5, 0.25  # of a usual core; of its budget, as faint stars are many
MEASURED = 3  # core classes whose wings are: faint stars', usual, bright
FARTHEST_PX = 4096.0  # that the wings of the brightest source are drawn to, if need be
SMALL_RADIUS_PX = 1e-2
RINGS = 4.7  # times its mean: the rings of both edges of an obscured aperture, at the near end
USUAL_FRACTION = 1e-3  # of each source's light that scenes leave out where they say nothing else
NOTHING_BEYOND = (1e-8, 1e-14)  # of the light, beyond the cores of a response without wings
STILL = StreakPlan(1, 1, 0.0, 0.0, 1, 0.0, 0.0)
NEGLIGIBLE = 0.1  # of the error of the wings' grid
EDGE_OVER = 1.5  # radii of a core within which the brightest place beyond it is looked for
FINER_EDGE, MOST_EDGE = 4, 1024  # times more samples a pixel there, up to so many across
NONE_BEYOND = 1e-16  # of the light: less is no more than the rounding of a transform
PASSING = 3.2  # radii of a streak's way
PLACES = 1.5  # for sub-pixel places at which the grid's error was not measured
MARGIN = 1.6  # for stars whose paths were not compared
HARDLY = 0.5  # of the middle's streak: stars that move less are at rest
# Seconds a star, a stamp's pixel, a star and a pixel of the spectral engine, a sample of a
# transform: one core of the 2-core reference machine (benchmarks/drawing.py prints them anew).
STAMP_S, STAMP_S_PER_PIXEL = 1e-7, 1.6e-9
PRODUCT_S, PRODUCT_S_PER_PIXEL = 5e-8, 6e-10
SPECTRAL_S, SPECTRAL_S_PER_PIXEL = 1.5e-7, 5.5e-8
FINEST_ERROR = 1e-5  # of the peak of a source, in any pixel: what transforms are asked for
TRANSFORM_S_PER_SAMPLE = 4e-8


@dataclass(frozen=True)
class CoreClass:
    """Stars up to `brightest_e` electrons, targets up to `target_e`, get cores of `radius_px`.

    wing_error : largest error of a pixel per electron of a star on its streak, target_error :
        of a target, which may stand still where stars do not; 0 where the limit says it all
    Sources above the last class's limits, where these are finite, are drawn by quadrature.
    phases : sub-pixel phases of its tables; 0 draws each source by its own transform
    fine_phases : those of tables of bright streaks in more pieces; 0: as those that are brighter
    point_phases : those of the table at rest by which bright streaks are drawn, as points along
        their own path, point_error : what it errs by per electron; 0 sweeps each by itself
    together_from : its stars around a block from which they are drawn together, as points along
        their own paths, by transforms that serve so much light (`together_e`); 0 never
    """

    radius_px: float
    brightest_e: float
    target_e: float
    wing_error: float
    target_error: float
    phases: int
    fine_phases: int = 0
    point_phases: int = 0
    point_error: float = 0.0
    together_from: int = 0
    together_e: float = 0.0


@dataclass(frozen=True)
class ResponsePlan:
    """Everything that drawing needs besides sources and their paths.

    spacing_px : of the wings' grid, 0 where the response has no wings
    reach_px : radius beyond which a source's light is omitted; lost_light : that fraction
    spectral_from : stars around a block from which they are drawn together by transforms; 0 never
    crowd_e : light up to which transforms serve, where they need not serve more
    streaks : how the stars' common streaks are drawn
    budget_e : error that one approximation may make in one pixel
    field : the responses over the field, `blur` being the sharpest; None where `blur` serves all
    table_mb : what a field's tables may take together [MB]
    stars_s : CPU seconds that its stars cost a frame, less those in crowds; None where not counted
    expected : how many stars of each class, and beyond the last, light a frame; around : how many
        of each class do by their wings, from beside it too
    """

    blur: Blur
    classes: tuple[CoreClass, ...]
    spacing_px: int
    reach_px: float
    lost_light: float
    streaks: StreakPlan
    budget_e: float
    spectral_from: int = 0
    crowd_e: float = math.inf
    field: PsfField | None = None
    table_mb: float = 0.0
    stars_s: float | None = None
    expected: tuple[float, ...] = ()
    around: tuple[float, ...] = ()

    @property
    def blurs(self) -> tuple[Blur, ...]:
        """Every response."""
        return (self.blur,) if self.field is None else self.field.blurs

    @property
    def band(self) -> float:
        """Highest frequency of any core [cycles/px]."""
        return max(map(band_of, self.blurs))

    @property
    def crowds_from(self) -> tuple[int, ...]:
        """Stars around a block from which some are drawn together, in any way; none where never."""
        ways = self.spectral_from, *(core.together_from for core in self.classes)
        return tuple(stars for stars in ways if stars)

    @property
    def crowd_band(self) -> float:
        """Highest frequency that the transforms of crowds look at, on a diagonal [cycles/px]."""
        ends = max(b.band_limit(FINEST_ERROR) for b in self.blurs)
        return min(self.band, math.sqrt(2.0) * ends)

    @property
    def fades_px(self) -> float:
        """Radius at which the light of pixels drawn by quadrature has faded out: that of wings,
        which are far smoother than pixels; light without wings ends by itself, within pixels."""
        return self.reach_px if self.spacing_px else math.inf

    @property
    def crowd_sides_px(self) -> tuple[float, float]:
        """Sides of the cells in which errors of wings add up, and of the boxes that they reach."""
        return 0.5 * self.spacing_px, 4.0 * self.classes[0].radius_px

    @property
    def usual_px(self) -> float:
        """Radius of a usual core, which holds what is seen of a source, 0 without sources."""
        if self.spacing_px:
            return self.classes[0].radius_px / FAINT_RADIUS
        return self.classes[0].radius_px if self.classes else 0.0

    @property
    def products(self) -> bool:
        """Whether stars are drawn as column times row."""
        streak_px = 0.0 if self.streaks.still else self.streaks.longest_px
        return all(is_product(b, streak_px) for b in self.blurs)

    @property
    def reach_core_px(self) -> float:
        """Radius of the largest core, 0 without sources."""
        return self.classes[-1].radius_px if self.classes else 0.0

    def parts(
        self, x_px: Array, y_px: Array, light_e: Array
    ) -> Iterator[tuple[Blur, slice | NDArray[np.intp], Array]]:
        """(response, which of the sources have a part in it, that part of their light [e-])."""
        if self.field is None:
            yield self.blur, slice(None), light_e
        else:
            yield from self.field.parts(x_px, y_px, light_e)

    def near(self, y0_px: float, y1_px: float, x0_px: float, x1_px: float) -> tuple[Blur, ...]:
        """The responses that sources in a rectangle of places may have a part in."""
        if self.field is None:
            return (self.blur,)
        return self.field.near(y0_px, y1_px, x0_px, x1_px)


def first_above(light_e: Array, limits: Sequence[float]) -> NDArray[np.intp]:
    """Core class (n,) of sources by their light: the first whose limit they do not exceed, one more
    than the last for those that exceed all."""
    return np.searchsorted(np.array(limits), light_e, side="left")


def plan_responses(
    scene: Scene,
    facts: Facts,
    camera: Camera,
    ends: Geometry,
    sources: bool = False,
    extinction: BandExtinction | None = None,
) -> ResponsePlan:
    """Choose radii, phases, grid and zones for a scene from some of its frames (`ends`).

    sources : there are some, even if the scene does not hold them yet; extinction : of a site's air

    A field's responses share radii, grid and reach: those that the worst of them asks for.
    """
    none = ResponsePlan(facts.blur, (), 0, 0.0, 0.0, STILL, facts.budget_e, field=facts.field)
    if not (scene.stars or scene.targets or sources):
        return none
    blurs = none.blurs
    path, streaks = _star_streaks(scene, facts, camera, ends, blurs, extinction)
    shape, length = scene.sensor.shape, 0.5 * streaks.longest_px
    longest = Path(np.array([-length, length]), np.zeros(2), np.ones(1))
    served, targets_served = (all(affordable(b, p, shape) for b in blurs) for p in (longest, POINT))
    if any(b.has_wings for b in blurs):
        found = _with_wings(scene, facts, camera, ends, blurs, path, streaks)
    else:
        found = _without_wings(scene, facts, blurs)
    cores, for_targets, spacing, reach, cut = found
    limited = zip(
        _limited(cores, facts.budget_e, served),
        _limited(for_targets, facts.budget_e, targets_served),
        _table_phases(scene, facts, blurs, cores, path, streaks),
        strict=True,
    )
    classes = tuple(
        CoreClass(radius, bright, target, error, still, phases)
        for (radius, bright, error), (_, target, still), phases in limited
    )
    planned = replace(
        none,
        classes=classes,
        spacing_px=spacing,
        reach_px=reach,
        lost_light=max(_lost(b, cut) for b in blurs),
        streaks=streaks,
    )
    mb = _tables_mb(planned, path)
    return replace(planned, spectral_from=_spectral_from(scene, planned), table_mb=mb)


def _with_wings(
    scene: Scene,
    facts: Facts,
    camera: Camera,
    ends: Geometry,
    blurs: tuple[Blur, ...],
    path: Path,
    streaks: StreakPlan,
) -> tuple[Cores, Cores, int, float, float]:
    """Cores for stars and for targets, the wings' grid, their reach, and where they are cut."""
    for b in blurs:
        check_scale(scene.sensor.psf.kind, b)
    first = max(b.core_px if b.has_wings else _radius_holding(b, 1e-8) for b in blurs)
    spacing = int(2 ** max(1, math.floor(math.log2(first / 5.0))))
    first *= FAINT_RADIUS
    reach = max(_reach(b, scene) for b in blurs)
    reach = _farther(blurs, max(reach / CUT_FROM, 2.0 * first), facts)
    swept, sweeps = path, None
    if not streaks.still:
        aberration = scene.star_effects["aberration"]
        sweeps = wing_sweeps(camera, ends, streaks.zones, aberration, streaks.light)
        if sweeps.slowest_px < HARDLY * streaks.pieces * path.length_px:
            swept = POINT  # somewhere, as where the field turns about, stars stand still
    light = facts.budget_e, facts.brightest_e
    cores = _cores(blurs, first, spacing, swept, *light, sweeps)
    # Errors at rest are the largest: a path takes their mean.
    at_rest = swept if not (scene.targets or scene.populations) else POINT
    for_targets = _cores(blurs, first, spacing, at_rest, *light)
    reach = max(reach, 2.0 * cores[-1][0])  # a wing is not cut off where its core still fades
    return cores, for_targets, spacing, reach, CUT_FROM * reach


def _without_wings(
    scene: Scene, facts: Facts, blurs: tuple[Blur, ...]
) -> tuple[Cores, Cores, int, float, float]:
    """As `_with_wings`, of responses whose light ends by itself; but what lies between the samples
    of a table has no end, and its cores are as large as the table."""
    usual, whole = (max(_radius_holding(b, e) for b in blurs) for e in NOTHING_BEYOND)
    for b in blurs:
        check_core(b, whole)
    tables = [b for b in blurs if isinstance(b.optics, Sampled)]
    for b in tables:
        check_ringing(ringing(b, whole).share, scene.accuracy.flux_fraction)
    at_usual, at_whole = (
        max([least, *(end_share(b, radius) for b in tables)])
        for least, radius in zip(NOTHING_BEYOND, (usual, whole), strict=True)
    )
    cores = ((usual, facts.budget_e / at_usual, 0.0), (whole, math.inf, at_whole))
    steep = [b for b in blurs if isinstance(b.optics, Gaussian | EllipticalGaussian)]
    reach = max([whole, *(_radius_holding(b, FAINTEST) / CUT_FROM for b in steep)])
    return cores, cores, 0, reach, usual


def _star_streaks(
    scene: Scene,
    facts: Facts,
    camera: Camera,
    ends: Geometry,
    blurs: tuple[Blur, ...],
    extinction: BandExtinction | None,
) -> tuple[Path, StreakPlan]:
    """The shortest piece of the stars' streaks, and how they are drawn; at rest without stars."""
    if scene.stars is None:
        return POINT, replace(STILL, photons=scene.sensor.photon_noise)
    asked, aberration = scene.accuracy.noise_fraction, scene.star_effects["aberration"]
    floor_e = facts.budget_e / part_sigma(scene)  # that the budget is made for
    noise = asked, floor_e, facts.budget_e, scene.sensor.photon_noise
    light = star_light(scene, camera, extinction)
    streaks = plan_streaks(camera, ends, aberration, *noise, facts.brightest_e, light)
    if streaks.still and streaks.longest_px:
        measures = ([measure(b) for b in blurs] for measure in (point_curvature, point_slope))
        streaks = resting(streaks, *map(max, measures))
    elif facts.field is not None and not streaks.still:
        streaks = over_field(streaks, facts.field.end_change)
    return _shortest_piece(camera, ends, streaks, aberration), streaks


def _asked_phases(scene: Scene) -> int:
    """Sub-pixel phases that the scene asks for; of a field, the most."""
    return max(one.oversampling for one in scene.sensor.every_psf)


def _shortest_piece(camera: Camera, ends: Geometry, streaks: StreakPlan, aberration: bool) -> Path:
    """The shortest piece of a streak in the middle of the frames looked at: the sharpest."""
    found = []
    for f in range(len(ends.frame)):
        one = ends.frame_slice(f)
        at = streaks.zones // 2
        streak = zone_streak(camera, one, at, at, streaks, aberration)
        found += [p.path for p in streak.pieces]
    return min(found, key=lambda p: p.length_px)


def _spectral_from(scene: Scene, r: ResponsePlan) -> int:
    """Stars in and around a block from which transforms are quicker than stamps; 0 without stars.

    From measured unit costs (benchmarks/drawing.py); a star that no table serves costs a transform
    of its own. Over a field a star is drawn by up to four responses, and a block takes the
    transforms of all that are near.
    """
    if scene.stars is None:
        return 0
    core, streaks = r.classes[0], r.streaks
    piece_px = streaks.longest_px / streaks.pieces
    side = 2.0 * core.radius_px + piece_px
    block = math.prod(min(BLOCK_PX, n) + side for n in scene.sensor.shape)
    if core.phases:
        star_s = stamp_s(r)
    else:
        oversampling = max(oversampling_for(b) for b in r.blurs)
        star_s = TRANSFORM_S_PER_SAMPLE * (side * oversampling) ** 2
    if star_s <= 2.0 * SPECTRAL_S:
        return 0
    fixed_s = SPECTRAL_S_PER_PIXEL * block * streaks.shapes
    near = _most_near(r, scene.sensor.shape, side)
    return math.ceil(fixed_s * near / min(near, 4) / (streaks.pieces * (star_s - SPECTRAL_S)))


def crowd_s(r: ResponsePlan, pixels: float, stars: float) -> float:
    """CPU seconds of stars that are drawn together with the streaks that they have in common."""
    many = len(r.blurs)
    fixed_s = SPECTRAL_S_PER_PIXEL * pixels * r.streaks.shapes * many
    return fixed_s + SPECTRAL_S * stars * min(4, many)


def stamp_s(r: ResponsePlan) -> float:
    """CPU seconds of a piece of a usual star's streak, from its table."""
    radius, piece_px = r.classes[0].radius_px, r.streaks.longest_px / r.streaks.pieces
    if r.products:
        return PRODUCT_S + PRODUCT_S_PER_PIXEL * (2.0 * radius + 2.0) ** 2
    return STAMP_S + STAMP_S_PER_PIXEL * (math.pi * radius**2 + 2.0 * radius * piece_px)


def _most_near(r: ResponsePlan, shape: tuple[int, int], margin_px: float) -> int:
    """The most responses that the stars of one block are drawn by."""
    before, after = -margin_px, BLOCK_PX + margin_px
    return max(
        len(r.near(y + before, y + after, x + before, x + after))
        for y in range(0, shape[0], BLOCK_PX)
        for x in range(0, shape[1], BLOCK_PX)
    )


def _cores(
    blurs: tuple[Blur, ...],
    first: float,
    spacing: int,
    path: Path,
    budget_e: float,
    brightest_e: float,
    sweeps: WingSweeps | None = None,
) -> Cores:
    """(radius [px], brightest [e-], wing's error) of cores of doubling radius.

    The wing's error is measured for the first of all responses, for the next (MEASURED in all, and
    as long as the brightest source asks for larger ones, up to LARGEST_CORE_PX) of the two that
    erred most then, and falls as told after. sweeps : adds what a block's one streak errs by.
    """
    largest = LARGEST_CORE_SAMPLES / max(map(oversampling_for, blurs))
    radii, errors, worst = [first], list[float](), list(blurs)
    while len(radii) < MOST_CLASSES and 2.0 * radii[-1] <= largest:
        radii.append(2.0 * radii[-1])
    for radius in radii:
        asked = len(errors) < MEASURED or brightest_e * errors[-1] > budget_e
        if not errors or (asked and radius <= LARGEST_CORE_PX):
            error, worst = _worst(worst, radius, spacing, path, sweeps)
        else:
            error = errors[-1] / min(b.optics.wing_fall(0.5 * radius) for b in blurs if b.has_wings)
        errors.append(error)
    limits = [*(budget_e / error for error in errors[:-1]), math.inf]
    limits[0] *= FAINT_PART
    return tuple(zip(radii, limits, errors, strict=True))


def _worst(
    blurs: list[Blur], radius: float, spacing: int, path: Path, sweeps: WingSweeps | None
) -> tuple[float, list[Blur]]:
    """The largest error of a core's wings, and the two responses that err most."""
    errors = [_measured_wing_error(b, radius, spacing, path) for b in blurs]
    if sweeps is not None:
        errors = [
            e + _sweep_error(b, radius, sweeps, NEGLIGIBLE * e)
            for e, b in zip(errors, blurs, strict=True)
        ]
    order = sorted(range(len(blurs)), key=lambda i: -errors[i])
    return max(errors), [blurs[i] for i in order[:2]]


def _limited(cores: Cores, budget_e: float, served: bool) -> Cores:
    """Cores of which the last has a limit too, where quadrature serves sources above it."""
    radius, _, error = cores[-1]
    limit = budget_e / error if served else math.inf
    return (*cores[:-1], (radius, limit, error))


@lru_cache(maxsize=256)
def _measured_wing_error(blur: Blur, radius_px: float, spacing_px: int, piece: Path) -> float:
    """The wing's error of a core of some radius, measured once for each response and streak."""

    def measure() -> float:
        return wing_error(blur, compact_core(blur, radius_px), spacing_px, piece)

    return PLACES * kept_number(("wing error", blur, radius_px, spacing_px, piece), measure)


def table_error(blur: Blur) -> float:
    """What a pixel errs by because a table's band is cut, and by reading it, per unit light."""
    if not isinstance(blur.optics, Sampled):
        return 0.0
    band = blur.optics.band
    alone = blur.pixel_in_optics or blur.fill_factor < 1.0
    return (band.left_out_bare if alone else band.left_out) + READ_ERROR


@lru_cache(maxsize=256)
def _measured_wing_slope(blur: Blur, radius_px: float) -> float:
    def measure() -> float:
        return wing_slope(blur, compact_core(blur, radius_px))

    return kept_number(("wing slope", blur, radius_px), measure)


def _sweep_error(blur: Blur, radius_px: float, sweeps: WingSweeps, enough: float) -> float:
    """What a star's wing errs by that is swept as its block's, per unit light.

    At most its slope times how far the paths are apart, while the streak passes by (a slope that
    falls as r^-4 is felt for 1.6 radii of the way, and the paths may be twice as far apart then);
    where that is more than `enough`, measured for the paths that differ most.
    """
    near = min(1.0, PASSING * radius_px / max(sweeps.slowest_px, 1e-9))
    slope = _measured_wing_slope(blur, radius_px) if sweeps.off_px else 0.0
    bound = sweeps.off_px * slope * near
    if bound <= enough:
        return bound
    core = compact_core(blur, radius_px)
    found = [
        error for pair in sweeps.pairs if (error := swept_apart(blur, core, *pair)) is not None
    ]
    return min(bound, MARGIN * max(found)) if len(found) == len(sweeps.pairs) else bound


def _phases(asked: int, blur: Blur) -> int:
    """Phases per pixel: as asked, more where the response is too sharp for them."""
    needed = 2 ** math.ceil(math.log2(max(1.0, 16.0 * blur.band_limit(1e-3))))
    return int(min(256, max(asked, needed)))


def _table_phases(
    scene: Scene,
    facts: Facts,
    blurs: tuple[Blur, ...],
    cores: Cores,
    path: Path,
    streaks: StreakPlan,
) -> list[int]:
    """Phases that tables of these cores may have within their bytes; 0 if fewer than needed.

    A response that is broad against a pixel needs few phases, so halving them costs nothing until
    the interpolation's own bound (checked for each source when it is drawn) says otherwise.
    """
    most_bytes = TABLE_BYTES
    if facts.field is not None:
        most_bytes = min(most_bytes, FIELD_BYTES / (len(blurs) * streaks.shapes))
    needed, out = max(_phases(_asked_phases(scene), b) for b in blurs), []
    for radius_px, _, _ in cores:
        phases = needed
        while phases >= 16 and table_bytes(phases, radius_px, path) > most_bytes:
            phases //= 2
        out.append(phases if table_bytes(phases, radius_px, path) <= most_bytes else 0)
    return out


def _tables_mb(r: ResponsePlan, path: Path) -> float:
    """What the tables of a field take together [MB]; 0 without one."""
    if r.field is None:
        return 0.0
    each = sum(table_bytes(c.phases, c.radius_px, path) for c in r.classes if c.phases)
    return each * len(r.blurs) * r.streaks.shapes / 1e6


def table_bytes(phases: int, radius_px: float, path: Path) -> float:
    """Bytes of a table of a core swept along a path."""
    pixels = math.pi * radius_px**2 + 2.0 * radius_px * path.length_px
    return 4.0 * pixels * (phases + 3) ** 2


@lru_cache(maxsize=128)
def point_curvature(blur: Blur) -> float:
    """Error of a pixel per unit light and squared radius [px] of a body that is drawn as a point.

    An upper bound for every radius: the bound itself grows at most with the square.
    """
    what = "point error", blur, SMALL_RADIUS_PX
    return kept_number(what, lambda: point_error(blur, SMALL_RADIUS_PX)) / SMALL_RADIUS_PX**2


@lru_cache(maxsize=128)
def point_slope(blur: Blur) -> float:
    """Error of a pixel per unit light and pixel that a point stands off the centre of its light."""
    what = "point error", blur, 0.0, SMALL_RADIUS_PX
    return kept_number(what, lambda: point_error(blur, 0.0, SMALL_RADIUS_PX)) / SMALL_RADIUS_PX


def _lost(blur: Blur, radius_px: float) -> float:
    """Share of a source's light beyond a radius, or outside of its optics' table altogether."""
    return min(1.0, blur.light_beyond(radius_px) + missing_light(blur.optics))


def _farther(blurs: tuple[Blur, ...], reach_px: float, facts: Facts) -> float:
    """A reach of at least so many px where the brightest source's wings end within the budget.

    At most FARTHEST_PX: what is cut off then shows in the plan.
    """
    while facts.brightest_e * cut_share(blurs, reach_px) > facts.budget_e:
        if reach_px >= FARTHEST_PX:
            break
        reach_px = min(1.25 * reach_px, FARTHEST_PX)
    return reach_px


def cut_share(blurs: tuple[Blur, ...], reach_px: float) -> float:
    """Most that a pixel lacks where the wings of a source end, per unit light of the source.

    RINGS times the mean surface brightness of a ring from there on, a tenth of its radius wide:
    where the rings of an aperture and of its obscuration meet they peak at up to four times their
    mean, and a wing of index -3 is a sixth brighter at the near end of such a ring than on its
    mean. A mean over all directions: the spikes of vanes are brighter.
    """
    near, far = CUT_FROM * reach_px, 1.1 * CUT_FROM * reach_px
    if not near:
        return 0.0
    area = math.pi * (far**2 - near**2)
    return RINGS * max(b.light_beyond(near) - b.light_beyond(far) for b in blurs) / area


@lru_cache(maxsize=128)
def end_share(blur: Blur, radius_px: float) -> float:
    """Most that a pixel lacks where a core without wings ends, per unit light of the source.

    The light of a square pixel as bright as the brightest place beyond the core (of the light
    before pixels collect it), up to which it is smooth; no more than all the light beyond.
    """
    if isinstance(blur.optics, Sampled):
        return ringing(blur, radius_px).lacking
    if (beyond := blur.light_beyond(radius_px)) < NONE_BEYOND:
        return beyond
    image, distance_px, os = _around_edge(blur, radius_px)
    return float(np.abs(image[distance_px >= radius_px - 0.71 / os]).max() * os**2)


@dataclass(frozen=True)
class Ringing:
    """What lies between the samples of a table has no end, and is of both signs.

    lacking : most that a pixel lacks, or has too much, where a core ends, per unit light
    share : how much more or less than all the light is within the core, net
    below : how far pixels are below 0
    """

    lacking: float
    share: float
    below: float


@lru_cache(maxsize=256)
def ringing(blur: Blur, radius_px: float) -> Ringing:
    """Of a table whose core has such a radius, from the image itself, as pixels collect it."""
    image, distance_px, os = _around_edge(blur, radius_px)
    beyond = np.where(distance_px > radius_px, image, 0.0)
    f = scipy.fft.fftfreq(len(image), 1.0 / os), scipy.fft.rfftfreq(len(image), 1.0 / os)
    pixel = blur.pixel(f[0][:, None], f[1][None, :]) * os**2
    lost, seen = (scipy.fft.irfft2(scipy.fft.rfft2(v) * pixel, s=v.shape) for v in (beyond, image))
    lacking, below = float(np.abs(lost).max()), float(-seen.min(initial=0.0))
    return Ringing(lacking, float(abs(beyond.sum())), below)


def _around_edge(blur: Blur, radius_px: float) -> tuple[Array, Array, int]:
    """Light before pixels collect it, around and beyond a radius, distances, samples a pixel."""
    period = 2 * math.ceil(EDGE_OVER * radius_px) + 4
    os = oversampling_for(blur)
    os *= FINER_EDGE if FINER_EDGE * os * period <= MOST_EDGE else 1
    n = period * os
    at = scipy.fft.fftfreq(n, 1.0 / n) / os
    fy, fx = scipy.fft.fftfreq(n, 1.0 / os), scipy.fft.rfftfreq(n, 1.0 / os)
    image = scipy.fft.irfft2(blur.image(fy[:, None], fx[None, :]), s=(n, n))
    return image, np.hypot(at[:, None], at[None, :]), os


def rings_below(r: ResponsePlan) -> float:
    """How far pixels of a source of unit light are below 0, by a table's ringing."""
    if r.spacing_px or not r.classes:
        return 0.0
    tables = (b for b in r.blurs if isinstance(b.optics, Sampled))
    return max((ringing(b, r.classes[-1].radius_px).below for b in tables), default=0.0)


def core_end_e(r: ResponsePlan, light_e: Array) -> Array:
    """What a pixel lacks where the core of each source (n,) ends, without wings [e-].

    r : of two classes, the usual and the whole core; sources above both limits are by quadrature
    """
    whole = r.classes[-1]
    beyond = np.minimum(end_share_of(r) * light_e, r.budget_e)
    return np.maximum(beyond, whole.wing_error * np.minimum(light_e, whole.target_e))


def end_share_of(r: ResponsePlan) -> float:
    """Most that a pixel lacks where usual cores without wings end, per unit light."""
    share = max(end_share(b, r.classes[0].radius_px) for b in r.blurs)
    tables = any(isinstance(b.optics, Sampled) for b in r.blurs)
    return share if tables else min(r.lost_light, share)


def _reach(blur: Blur, scene: Scene) -> float:
    """Radius [px] up to which a source's light is drawn: what the accuracy asks for.

    Light that falls off the frame needs no drawing: no radius is larger than the frame's diagonal
    and the radius that the usual accuracy asks for, up to which sources off the frame are drawn.
    """
    asked = scene.accuracy.flux_fraction
    radius = _radius_holding(blur, asked)
    if asked >= USUAL_FRACTION:
        return radius
    return min(radius, math.hypot(*scene.sensor.shape) + _radius_holding(blur, USUAL_FRACTION))


def _radius_holding(blur: Blur, beyond: float) -> float:
    """Radius outside which no more than `beyond` of the light falls [px]."""
    low, high = 0.1, 4.0
    while blur.light_beyond(high) > beyond and high < 1e6:
        high *= 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if blur.light_beyond(middle) > beyond else (low, middle)
    return high
