"""Which objects of a population come into the field in any dwell, and what targets they are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from sgp4.api import SGP4_ERRORS

from pipeline.errors import BadInput
from pipeline.physics.positions import orbit_screen
from pipeline.physics.positions.focal_plane import corner_radius, ifov_rad, stretch
from pipeline.physics.positions.times import elapsed_s, instants, parse_utc
from pipeline.physics.vectors import separation
from pipeline.plan.decision import Decision
from pipeline.plan.pointing.air import air_of
from pipeline.plan.pointing.attitude_motion import farthest_rad
from pipeline.plan.pointing.geometry import camera_of, watch
from pipeline.plan.targets.shared import screens_of, shared_told
from pipeline.plan.timing import DwellPlan, dwell_plans
from pipeline.spec.scene import MOST_TARGETS, Scene, Target
from pipeline.spec.targets.body import Body, SphereBody
from pipeline.spec.targets.population import MOST_TOLD, Population, Screened

if TYPE_CHECKING:
    from sgp4.api import Satrec

Array = NDArray[np.float64]
Sizes = Mapping[int, tuple[float | None, float | None]]

STEP_S, MOST_STEPS = 1.0, 100_000  # between looks at the pointing, to tell how fast it turns
TURN_ROOM = 2.0  # times the change between looks
BEFORE_S = 10.0  # light that is seen left the farthest satellites before
LOOKED_AT = 257  # moments at which SGP4 is tried, where no cone is looked into
MOST_REFRACTION_RAD = 0.0125  # at the horizon, with room (0.6 degrees; Bennett 1982)


@dataclass(frozen=True)
class SearchView:
    """Where the observer looks during the dwells, as a screen takes it.

    half_angle_rad : the frame's corner and all beside the frame that may send light into it
    turns_rad_s : the boresight's largest rate in each dwell
    near_s : when [s after the epoch]: of several sets of an object the nearest one counts
    """

    scene: Scene
    dut1_s: float
    epoch: tuple[float, float]
    dwells: tuple[DwellPlan, ...]
    half_angle_rad: float
    turns_rad_s: tuple[float, ...]
    near_s: float = 0.0

    @property
    def length_s(self) -> float:
        """Of all dwells."""
        return sum(d.end_s - d.start_s for d in self.dwells)

    def screen(self, satellites: list[Satrec]) -> tuple[list[int], dict[int, int]]:
        """Which satellites may come into the cone of any dwell; SGP4's code of those that fail in
        any, which are not among them."""
        found = [self._screen(satellites, k) for k in range(len(self.dwells))]
        codes: dict[int, int] = {}
        for one in reversed(found):
            codes |= dict(zip(one.failed.tolist(), one.codes.tolist(), strict=True))
        inside = {i for one in found for i in one.inside.tolist()}
        return sorted(inside - set(codes)), dict(sorted(codes.items()))

    def _screen(self, satellites: list[Satrec], dwell: int) -> orbit_screen.ScreenResult:
        plan = self.dwells[dwell]
        start = instants(self.epoch, [plan.start_s])

        def seen(at_s: Array) -> tuple[Array, Array, Array]:
            return watch(self.scene, plan.start_s + at_s, self.dut1_s, dwell)

        return orbit_screen.screen_cone(
            satellites,
            (float(start.utc1[0]), float(start.utc2[0])),
            plan.end_s - plan.start_s,
            lambda at_s: seen(at_s)[:2],
            lambda at_s: seen(at_s)[2],
            self.half_angle_rad,
            self.turns_rad_s[dwell],
        )


def look_of(scene: Scene, halo_px: float, dut1_s: float) -> SearchView:
    """The look of a scene; halo_px : how far off the frame a source may be and still be drawn."""
    epoch, dwells, camera = parse_utc(scene.epoch), dwell_plans(scene), camera_of(scene)
    half = corner_radius(camera) + halo_px * stretch(camera) * ifov_rad(camera)
    if air_of(scene, instants(epoch, [0.0], dut1_s)) is not None:
        half += MOST_REFRACTION_RAD  # the screen knows no air
    half += farthest_rad(scene)  # nor the random motion of the pointing
    turns = tuple(_turn_rad_s(scene, d, dut1_s) for d in dwells)
    return SearchView(scene, dut1_s, epoch, dwells, min(half, np.pi), turns)


@dataclass(frozen=True)
class WholeSky(SearchView):
    """The look that finds every object, wherever it is, that SGP4 carries through `span_s`.

    span_s : first and last time [s after the epoch]; looked at are LOOKED_AT moments at most
    """

    span_s: tuple[float, float] = (0.0, 0.0)

    def screen(self, satellites: list[Satrec]) -> tuple[list[int], dict[int, int]]:
        count = int(np.clip(np.ptp(self.span_s) / orbit_screen.FIRST_STEP_S, 1, LOOKED_AT - 1)) + 1
        moments = np.linspace(*self.span_s, count)
        codes = orbit_screen.sgp4_codes(satellites, self.epoch, moments)
        return sorted(set(range(len(satellites))) - set(codes)), codes


def whole_sky(scene: Scene, start_s: float, stop_s: float, near_s: float) -> WholeSky:
    """The look of a scene at all of the sky between two times; near_s : as of a SearchView."""
    span = start_s - BEFORE_S, stop_s + BEFORE_S
    return WholeSky(scene, 0.0, parse_utc(scene.epoch), dwell_plans(scene), np.pi, (), near_s, span)


def _turn_rad_s(scene: Scene, dwell: DwellPlan, dut1_s: float) -> float:
    """The boresight's largest rate in a dwell: that between looks STEP_S apart, plus TURN_ROOM
    times what it changes by from one to the next."""
    length_s = dwell.end_s - dwell.start_s
    if length_s == 0.0:  # one bias frame
        return 0.0
    count = int(np.clip(np.ceil(length_s / STEP_S), 8, MOST_STEPS)) + 1
    axis = watch(scene, np.linspace(dwell.start_s, dwell.end_s, count), dut1_s, dwell.index)[2]
    rate = separation(axis[:-1], axis[1:]) * (count - 1) / length_s
    return float(rate.max() + TURN_ROOM * np.abs(np.diff(rate)).max(initial=0.0))


@dataclass
class Unmet:
    """What a population asks for that is of no object: rules and a table of sizes."""

    population: Population
    sizes: Sizes
    names: list[str] = field(default_factory=list)
    is_sized: bool = False

    def see(self, sets: Iterable[Any]) -> None:
        """Element sets of the population's file."""
        for one in sets:
            if self.population.rules:
                self.names.append((one.name or "").lower())
            self.is_sized |= one.number in self.sizes

    def told(self) -> Iterator[str]:
        """Rules that name none of them, and a table with none of their numbers."""
        words = [rule.name_contains for rule in self.population.rules]
        idle = [f"'{w}'" for w in words if not any(w.lower() in name for name in self.names)]
        if idle:
            yield f"rules: no object's name contains {', '.join(idle)}"
        if self.population.sizes is not None and not self.is_sized:
            yield f"sizes: none of its {len(self.sizes)} numbers is of an object of the file"


@dataclass
class Sieve:
    """What has been found in a population so far: a few numbers for each set, targets kept.

    place : the population's in the scene, for messages; kept : each with its index among `numbers`
    """

    population: Population
    look: SearchView
    sizes: Sizes
    place: str
    read: int = 0
    unreadable: int = 0
    failed: Counter[int] = field(default_factory=Counter)
    told: list[str] = field(default_factory=list)
    numbers: list[NDArray[np.int64]] = field(default_factory=list)
    ages_s: list[Array] = field(default_factory=list)
    kept: list[tuple[int, Target]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.unmet = Unmet(self.population, self.sizes)

    def take(self, sets: Iterable[Any]) -> None:
        """Look at a batch of element sets
        (`pipeline.inputs.targets.population_files.ElementSet`).
        """
        rows = [(row, one) for row, one in enumerate(sets, self.read + 1) if self._is_readable(one)]
        if not rows:
            return
        good = [one for _, one in rows]
        self.unmet.see(good)
        satellites = [one.satellite for one in good]
        days = np.array([(s.jdsatepoch, s.jdsatepochF) for s in satellites])
        age = np.abs(elapsed_s(self.look.epoch, days[:, 0], days[:, 1]) - self.look.near_s)
        number = np.array([one.number for one in good], np.int64)
        inside, codes = self.look.screen(satellites)
        for i, code in codes.items():
            self.failed[code] += 1
            self._tell(f"{_label(good[i])}: {_meaning(code)}")
        usable = np.ones(len(good), bool)
        usable[list(codes)] = False
        index = sum(map(len, self.numbers)) + np.cumsum(usable) - 1
        self.numbers.append(number[usable])
        self.ages_s.append(age[usable])
        for i in inside:
            self.kept.append((int(index[i]), self._target(*rows[i])))
        if len(self.kept) > MOST_TARGETS:
            self._drop_superseded()

    def _drop_superseded(self) -> None:
        """Hold what counts so far; BadInput for more objects than may be."""
        counts = nearest_sets(*self.sets)  # what does not count now never will
        self.kept = [(k, target) for k, target in self.kept if counts[k]]
        if len(self.kept) > MOST_TARGETS:
            raise BadInput(
                f"{self.place}.path",
                f"{len(self.kept)} objects that cross the field",
                f"at most {MOST_TARGETS}: a smaller field, a shorter dwell, or a smaller file",
            )

    def _is_readable(self, one: Any) -> bool:
        self.read += 1
        if one.orbit is None:
            self.unreadable += 1
            self._tell(f"{one.name or 'no name'}: {one.fault}")
        return one.orbit is not None

    def _tell(self, text: str) -> None:
        if len(self.told) < MOST_TOLD:
            self.told.append(text[:400])

    def _target(self, row: int, one: Any) -> Target:
        """A set as a target; without a catalogue number its row in the file tells it apart."""
        number = str(one.number) if one.number else f"0-{row}"
        return Target.model_construct(
            name=f"{self.population.name}-{number}",
            object_name=(one.name or "").strip()[:80] or None,
            orbit=one.orbit,
            body=member_body(self.population, self.sizes, one.name, one.number),
            lighting=None,
            eclipse=self.population.eclipse,
        )

    @property
    def sets(self) -> tuple[NDArray[np.int64], Array]:
        """Catalogue numbers and ages [s] (n,) of the sets that can be used."""
        numbers = np.concatenate([np.zeros(0, np.int64), *self.numbers])
        return numbers, np.concatenate([np.zeros(0), *self.ages_s])

    def check_read(self) -> None:
        """BadInput where no set of the file can be read."""
        if self.read == self.unreadable:
            shown = self.told[0] if self.told else "nothing"
            raise BadInput(f"{self.place}.path", shown, "element sets that can be read")

    def close(
        self, digest: str, counts: NDArray[np.bool_] | None = None
    ) -> tuple[list[Target], Population]:
        """The targets, and the population with what the screen found.

        Of an object with several sets the one nearest to the look's time counts, whether it comes
        into the field or not. counts : which of `sets` do among those of all populations
        """
        nearest = nearest_sets(*self.sets)
        counts = nearest if counts is None else counts
        chosen = [target for k, target in self.kept if counts[k]]
        look = self.look
        told = Screened(
            digest=digest,
            read=self.read,
            kept=len(chosen),
            unreadable=self.unreadable,
            superseded=int((~nearest).sum()),
            elsewhere=int((nearest & ~counts).sum()),
            failed=tuple(sorted(self.failed.items())),
            left_out=tuple(self.told),
            unmet=tuple(text[:400] for text in self.unmet.told()),
            half_angle_deg=float(np.degrees(look.half_angle_rad)),
            dwell_s=look.length_s,
        )
        return chosen, self.population.model_copy(update={"screened": told})


def nearest_of_all(sieves: Sequence[Sieve]) -> list[NDArray[np.bool_]]:
    """Which sets of each population count where all of them are looked at as one."""
    sets = [sieve.sets for sieve in sieves]
    numbers, ages = (np.concatenate([one[k] for one in sets]) for k in (0, 1))
    edges = np.cumsum([len(one[0]) for one in sets])[:-1]
    return np.split(nearest_sets(numbers, ages), edges)


def nearest_sets(number: NDArray[np.int64], age_s: Array) -> NDArray[np.bool_]:
    """Which sets (n,) count: of each catalogue number the one of least age, of several such the
    first; without a number (0) all."""
    order = np.lexsort((age_s, number))
    counts = number == 0
    counts[order[np.flatnonzero(np.diff(number[order], prepend=np.nan) != 0)]] = True
    return counts


def member_body(population: Population, sizes: Sizes, name: str, number: int) -> Body:
    """The default body, with the size that the table or else the first rule gives."""
    body = population.body
    if not isinstance(body, SphereBody):
        return body
    given: dict[str, object] = {}
    for rule in population.rules:
        if rule.name_contains.lower() in name.lower():
            given = {"diameter_m": rule.diameter_m, "albedo": rule.albedo}
            break
    diameter, albedo = sizes.get(number, (None, None))
    given |= {} if diameter is None else {"diameter_m": diameter}
    given |= {} if albedo is None else {"albedo": albedo}
    return body.model_copy(update={k: v for k, v in given.items() if v is not None})


def _label(one: Any) -> str:
    return f"{one.name} ({one.number})" if one.name else str(one.number)


def _meaning(code: int) -> str:
    told = SGP4_ERRORS.get(code, "the result is not finite")
    return f"SGP4 code {code}: {told}"


def with_members(scene: Scene, found: list[tuple[list[Target], Population]]) -> Scene:
    """The scene with the populations' kept objects after its own targets. BadInput for names that
    are taken, or too many targets."""
    targets = [*scene.targets, *(t for members, _ in found for t in members)]
    for names in (Counter(t.name for t in targets), Counter(p.name for _, p in found)):
        for twice, count in names.most_common(1):
            if count > 1:
                allowed = "names of targets and populations that do not clash"
                raise BadInput("populations", twice, allowed)
    if len(targets) > MOST_TARGETS:
        raise BadInput("populations", f"{len(targets)} targets", f"at most {MOST_TARGETS} in all")
    populations = tuple(population for _, population in found)
    return scene.model_copy(update={"targets": tuple(targets), "populations": populations})


def population_decisions(scene: Scene) -> list[Decision]:
    """How many objects of each population are drawn, and why the others are not."""
    dwells = "the dwell" if scene.dwells is None else "all dwells"
    return [
        Decision(f"populations.{name}", s.kept > 0, "; ".join(_told(s, dwells)), 0.0, 0.0)
        for name, s in screens_of(scene)
    ]


def _told(s: Screened, dwells: str) -> Iterator[str]:
    """What the screen found of a population's element sets."""
    own = s.read - s.elsewhere
    if own:
        yield (
            f"{s.kept} of {own} element sets come within {s.half_angle_deg:.4g} deg of the "
            f"boresight (the frame's corner and all that sends light into it) during the "
            f"{s.dwell_s:g} s of {dwells}; for the others the screen proves that they do not"
        )
    if own and not s.kept:
        yield "`nightglass find SCENE` lists those that can be seen, and where"
    if s.superseded:
        have = "set has" if s.superseded == 1 else "sets have"
        yield f"{s.superseded} {have} a younger one of the same object"
    if s.elsewhere:
        yield shared_told(s)
    yield from (f"{n} omitted: {_meaning(code)}" for code, n in s.failed)
    if s.unreadable:
        yield f"{s.unreadable} omitted: not readable ({s.left_out[0]})"
    yield from s.unmet
