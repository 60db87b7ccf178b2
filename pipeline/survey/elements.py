"""Mean elements of very many objects as columns, with the light that each reflects."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.inputs.targets.population_files import ElementSet, element_sets, read_sizes
from pipeline.physics.constants import DAY_S, EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.positions.orbit_bounds import GM72_KM3_S2, semi_major_axis_m
from pipeline.physics.positions.orbit_sgp4 import sgp4
from pipeline.physics.positions.times import elapsed_s
from pipeline.physics.targets.sphere import sphere_area_function
from pipeline.plan.bodies.albedos import albedo_of
from pipeline.plan.targets.populations import Sizes, Unmet, member_body, nearest_sets
from pipeline.spec.study import PriorityRule, Synthetic
from pipeline.spec.targets.body import Body, LightCurveBody, SphereBody
from pipeline.spec.targets.population import Population

if TYPE_CHECKING:
    from sgp4.api import Satrec

Array = NDArray[np.float64]

_SGP4_ZERO_JD = 2_433_281.5  # 1949-12-31, from which sgp4init counts
_MEAN = ("bstar", "ecco", "argpo", "inclo", "mo", "no_kozai", "nodeo")  # as sgp4init takes them


@dataclass(frozen=True)
class Elements:
    """n objects, each column (n,).

    jd1, jd2 : two-part UTC of their elements; mean : (n, 7) SGP4's mean elements, in the order of
    sgp4init; reflecting_m2 : albedo times the square of the diameter of the sphere that reflects
    as much; shaded : whether the Earth's shadow dims it
    """

    number: NDArray[np.int64]
    name: NDArray[np.str_]
    jd1: Array
    jd2: Array
    mean: Array
    reflecting_m2: Array
    shaded: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.number)

    def take(self, which: slice | NDArray[np.int64] | NDArray[np.bool_]) -> Elements:
        """Some of them."""
        return Elements(*(getattr(self, f.name)[which] for f in fields(self)))

    def satellites(self) -> list[Satrec]:
        """SGP4's satellites (WGS 72): the same to 0.1 mm as from their lines."""
        return [_satellite(*row) for row in zip(self.jd1, self.jd2, self.mean, strict=True)]

    @property
    def mean_altitude_km(self) -> Array:
        """Semi-major axis less the Earth's equatorial radius (n,)."""
        return (semi_major_axis_m(self.mean[:, 5]) - EARTH_EQUATORIAL_RADIUS_M) / 1e3

    @property
    def kind(self) -> NDArray[np.str_]:
        """By name: `debris` (DEB), `rocket body` (R/B), else `payload` (n,)."""
        upper = np.char.upper(self.name.astype(str))
        debris, rocket = np.char.find(upper, "DEB") >= 0, np.char.find(upper, "R/B") >= 0
        return np.where(debris, "debris", np.where(rocket, "rocket body", "payload"))

    @property
    def regime(self) -> NDArray[np.str_]:
        """By orbit: `HEO` (eccentricity over 0.25), else by altitude `LEO` (2,000 km), `MEO`,
        `GEO` (within 2,000 km of the ring), `beyond` (n,)."""
        km = self.mean_altitude_km
        plain = np.select(
            [km < 2000.0, km < 33_786.0, km < 37_786.0], ["LEO", "MEO", "GEO"], "beyond"
        )
        return np.where(self.mean[:, 1] > 0.25, "HEO", plain)


class Census(Counter[str]):
    """How many element sets are not looked at, by reason; `read` of them in all.

    unmet : what was asked for and is of no object
    """

    read = 0
    unmet: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """One line for each reason, and what is unmet."""
        omitted = [
            f"{n} of {self.read} element sets omitted: {w}" for w, n in sorted(self.items()) if n
        ]
        return [*omitted, *self.unmet]


def gather_elements(
    populations: Sequence[Population], middle: tuple[float, float], field: str = "populations"
) -> tuple[Elements, Census]:
    """The objects of populations, of each number the set nearest to an instant (two-part UTC).

    BadInput where a file cannot be used, or nothing in the files can be read.
    """
    rows: list[tuple[ElementSet, float, bool]] = []
    census, first = Census(), ""
    for i, population in enumerate(populations):
        place = f"{field}.{i}"
        sizes: Sizes = {}
        if population.sizes is not None:
            sizes = read_sizes(Path(population.sizes), f"{place}.sizes")
        unmet = Unmet(population, sizes)
        for batch in element_sets(Path(population.path), f"{place}.path"):
            census.read += len(batch)
            unmet.see(one for one in batch if one.satellite is not None)
            for one in batch:
                if one.satellite is None:
                    census["not readable"] += 1
                    first = first or f"{one.name or 'no name'}: {one.fault}"
                else:
                    body = member_body(population, sizes, one.name, one.number)
                    rows.append((one, _reflecting_m2(body, place), population.eclipse))
        census.unmet += tuple(f"{place}.{told}" for told in unmet.told())
    if not rows:
        raise BadInput(f"{field}.0.path", first or "nothing", "element sets to be read")
    return _nearest(_columns(rows), middle, census)


def _columns(rows: list[tuple[ElementSet, float, bool]]) -> Elements:
    satellites = [one.satellite for one, *_ in rows]
    return Elements(
        np.array([one.number for one, *_ in rows], np.int64),
        np.array([(one.name or str(one.number))[:40] for one, *_ in rows]),
        np.array([s.jdsatepoch for s in satellites]),  # type: ignore[union-attr]
        np.array([s.jdsatepochF for s in satellites]),  # type: ignore[union-attr]
        np.array([mean_of(s) for s in satellites]),
        np.array([light for _, light, _ in rows]),
        np.array([shaded for *_, shaded in rows]),
    )


def mean_of(satellite: Satrec) -> list[float]:
    """Mean elements of a satellite, as `Elements.mean` has them."""
    return [getattr(satellite, name) for name in _MEAN]


def _nearest(
    found: Elements, middle: tuple[float, float], census: Census
) -> tuple[Elements, Census]:
    """Of each catalogue number the set nearest to an instant; sets without a number all stay."""
    age = np.abs(elapsed_s(middle, found.jd1, found.jd2))
    counts = nearest_sets(found.number, age)
    census["another set of the same object is nearer to the period"] += int((~counts).sum())
    return found.take(counts), census


def fresh(
    found: Elements, start: tuple[float, float], end_s: float, most_days: float, census: Census
) -> Elements:
    """Those whose elements' epoch is within some days of a period. BadInput where none is.

    start : two-part UTC; end_s : length of the period [s]
    """
    after = elapsed_s(start, found.jd1, found.jd2)
    days = np.maximum(np.maximum(after - end_s, -after), 0.0) / DAY_S
    good = days <= most_days
    if not good.any():
        nearest = f"epochs {days.min():.0f} to {days.max():.0f} days from the period"
        raise BadInput("catalogue", nearest, f"elements within {most_days:g} days (most_age_days)")
    census[f"their epoch is more than {most_days:g} days from the period"] += int((~good).sum())
    return found.take(good)


def _satellite(jd1: float, jd2: float, mean: Array) -> Satrec:
    api = sgp4().api
    one = api.Satrec()
    bstar, *orbit = (float(v) for v in mean)
    one.sgp4init(api.WGS72, "i", 0, (jd1 - _SGP4_ZERO_JD) + jd2, bstar, 0.0, 0.0, *orbit)
    one.jdsatepoch, one.jdsatepochF = float(jd1), float(jd2)
    return one


def _reflecting_m2(body: Body, field: str) -> float:
    """Albedo times squared diameter of the sphere that reflects like a body at every phase."""
    if isinstance(body, SphereBody):
        return albedo_of(body, f"{field}.body") * body.diameter_m**2
    steady = isinstance(body, LightCurveBody) and body.phase_law == "lambert"
    if not (steady and isinstance(body, LightCurveBody) and _of_one_value(body)):
        allowed = "sphere, or light_curve of one value with phase_law: lambert"
        raise BadInput(f"{field}.body.kind", body.kind, allowed)
    if body.magnitudes is not None:
        value = body.range_m**2 * 10.0 ** (-0.4 * (body.magnitudes[0] - body.sun_mag))
    else:
        assert body.intensities_m2_sr is not None
        value = body.intensities_m2_sr[0]
    at_phase = float(sphere_area_function(math.radians(body.phase_deg), 1.0))
    return float(math.pi * value / at_phase)


def _of_one_value(body: LightCurveBody) -> bool:
    return len(set(body.magnitudes or body.intensities_m2_sr or ())) == 1


def named_by(
    rules: Sequence[PriorityRule], elements: Elements
) -> Iterator[tuple[PriorityRule, NDArray[np.bool_]]]:
    """Rules, each with the objects (n,) that it names: by number, by part of the name, or all."""
    upper = np.char.upper(elements.name.astype(str))
    for rule in rules:
        named = np.isin(elements.number, rule.numbers)
        if rule.name_contains is not None:
            named |= np.char.find(upper, rule.name_contains.upper()) >= 0
        elif not rule.numbers:
            named[:] = True
        yield rule, named


def synthetic_elements(request: Synthetic, start: tuple[float, float]) -> Elements:
    """Made-up objects whose elements are of an instant (two-part UTC): see `Synthetic`."""
    rng, n = np.random.default_rng(request.seed), request.objects
    regime = rng.choice(4, n, p=[0.8, 0.05, 0.08, 0.07])
    low = 6378.0 + rng.choice([500.0, 550.0, 780.0, 850.0, 1200.0, 1400.0], n)
    shells = low + rng.normal(0.0, 40.0, n)
    half_day, day = rng.normal(26_560.0, 30.0, n), rng.normal(42_165.0, 15.0, n)
    regimes = [regime == 0, regime == 1, regime == 2]
    axis_km = np.select(regimes, [shells, half_day, day], rng.uniform(20_000.0, 27_000.0, n))
    ecc = np.where(regime == 3, rng.uniform(0.5, 0.7, n), rng.rayleigh(0.002, n))
    tilts = rng.choice([53.0, 65.0, 74.0, 82.0, 98.0], n) + rng.normal(0.0, 1.0, n)
    slight = [tilts, rng.normal(56.0, 1.0, n), np.abs(rng.normal(0.0, 5.0, n))]
    tilt = np.select(regimes, slight, rng.uniform(5.0, 64.0, n))
    motion = np.sqrt(GM72_KM3_S2 / axis_km**3) * 60.0
    turns = rng.uniform(0.0, 2.0 * np.pi, (3, n))
    bstar = np.where(regime == 0, 1e-5, 0.0)
    share = rng.uniform(size=n)
    small, large = request.smallest_m**-1.6, request.largest_m**-1.6
    diameter = (small + share * (large - small)) ** (-1.0 / 1.6)
    mean = np.stack([bstar, ecc, turns[0], np.radians(tilt), turns[1], motion, turns[2]], axis=1)
    kind = np.where(diameter < 1.0, "DEB", "SAT")
    return Elements(
        np.arange(1, n + 1) + 900_000_000,
        np.char.add(np.char.add("MADE ", np.arange(1, n + 1).astype(str)), np.char.add(" ", kind)),
        np.full(n, start[0]),
        np.full(n, start[1]),
        mean,
        request.albedo * diameter**2,
        np.ones(n, bool),
    )


def joined(parts: Sequence[Elements]) -> Elements:
    """Several catalogues as one."""
    return Elements(
        *(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Elements))
    )
