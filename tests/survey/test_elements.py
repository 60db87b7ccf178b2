"""The catalogue of a search: which sets count, what objects are called, how much they reflect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from pipeline.errors import BadInput
from pipeline.physics.positions.orbit_bounds import semi_major_axis_m
from pipeline.physics.targets.sphere import sphere_intensity_per_irradiance
from pipeline.spec.study import Synthetic
from pipeline.spec.targets.population import Population
from pipeline.survey.elements import Elements, gather_elements, synthetic_elements
from tests.observe.test_against_others import tle
from tests.survey.conftest import EPOCH

BALL = {"kind": "sphere", "diameter_m": 2.0, "albedo": 0.2}


def lines_of(number: int, day: float, name: str, **orbit: float) -> str:
    """Three lines of an object whose elements are of a day of 2019; `orbit`: e, n [rev/day]."""
    one, two = tle(number, 51.6, 10.0, orbit.get("e", 0.001), 20.0, 30.0, orbit.get("n", 15.0))
    one = one[:18] + f"19{day:012.8f}" + one[32:68]
    return f"{name}\n{one}{sum(int(c) if c.isdigit() else c == '-' for c in one) % 10}\n{two}\n"


def gathered(folder: Path, text: str, **more: Any) -> tuple[Elements, list[str]]:
    (folder / "some.tle").write_text(text)
    asked = {"name": "some", "path": str(folder / "some.tle"), "body": BALL} | more
    found, census = gather_elements([Population.model_validate(asked)], EPOCH)
    return found, census.lines()


def test_the_set_nearest_to_the_period_counts(tmp_path: Path) -> None:
    """Of each number, before or after; the epoch is day 110.25. What cannot be read is told."""
    text = "".join(lines_of(number, day, "A") for number, day in (
        (5, 108.0), (5, 111.0), (5, 112.0), (7, 109.9), (7, 112.0), (8, 100.0)))  # fmt: skip
    broken = lines_of(9, 110.0, "BROKEN").replace("51.6000", "51.60x0")
    found, told = gathered(tmp_path, text + broken)
    assert found.number.tolist() == [5, 7, 8]
    days = found.jd1 + found.jd2 - 2_458_483.5
    np.testing.assert_allclose(days, [111.0, 109.9, 100.0], atol=1e-6)
    assert told == [
        "3 of 7 element sets omitted: another set of the same object is nearer to the period",
        "1 of 7 element sets omitted: not readable",
    ]


def test_a_file_of_which_nothing_can_be_read_is_refused(tmp_path: Path) -> None:
    """With what its first set is read as."""
    broken = lines_of(9, 110.0, "BROKEN").replace("51.6000", "51.60x0")
    with pytest.raises(BadInput, match=r"'BROKEN: .* is not accepted; allowed: element sets to be"):
        gathered(tmp_path, broken)


def test_sets_without_a_number_are_objects_of_their_own(tmp_path: Path) -> None:
    text = "".join(lines_of(n, day, f"A {day}") for n, day in (
        (0, 108.0), (0, 111.0), (4, 111.0), (0, 112.0), (4, 112.0)))  # fmt: skip
    found, told = gathered(tmp_path, text)
    assert sorted(found.name) == ["A 108.0", "A 111.0", "A 111.0", "A 112.0"]
    assert found.number.tolist().count(0) == 3
    assert [one.split(":")[0] for one in told] == ["1 of 5 element sets omitted"]


def test_kinds_and_orbits(tmp_path: Path) -> None:
    """Altitudes by Kepler's third law of the mean motion."""
    cases = [("SL-8 R/B", 0.001, 14.0, "rocket body", "LEO"), ("r/b x", 0.001, 11.0, "rocket body",
             "MEO"), ("FENGYUN DEB", 0.001, 1.0, "debris", "GEO"), ("SAT", 0.001, 0.8, "payload",
             "beyond"), ("DEB", 0.3, 12.0, "debris", "HEO"), ("OTHER", 0.2, 11.3, "payload", "MEO"),
             ("LOW", 0.001, 11.4, "payload", "LEO"),
             ("ATLAS R/B DEB", 0.001, 14.1, "debris", "LEO")]  # fmt: skip
    text = "".join(lines_of(k + 1, 110.0, c[0], e=c[1], n=c[2]) for k, c in enumerate(cases))
    found, _ = gathered(tmp_path, text)
    motion = np.array([c[2] for c in cases]) * 2.0 * np.pi / 86_400.0
    km = (3.986004418e14 / motion**2) ** (1.0 / 3.0) / 1e3 - 6378.137
    np.testing.assert_allclose(found.mean_altitude_km, km, rtol=2e-3, atol=2.0)
    assert found.kind.tolist() == [c[3] for c in cases]
    highest = {"LEO": 2000.0, "MEO": 33_786.0, "GEO": 37_786.0}
    for regime, height, case in zip(found.regime, km, cases, strict=True):
        assert regime == case[4]
        assert regime not in highest or height < highest[regime]


def test_sizes_are_those_of_rules_and_tables(tmp_path: Path) -> None:
    (tmp_path / "sizes.csv").write_text("norad_id,diameter_m,albedo\n3,5,0.1\n")
    text = "".join(lines_of(k, 110.0, n) for k, n in ((1, "A"), (2, "A DEB"), (3, "B DEB")))
    rules = [{"name_contains": "DEB", "diameter_m": 0.5}]
    found, _ = gathered(tmp_path, text, rules=rules, sizes=str(tmp_path / "sizes.csv"))
    np.testing.assert_allclose(found.reflecting_m2, [0.2 * 4.0, 0.2 * 0.25, 0.1 * 25.0])
    assert found.shaded.all()
    assert not gathered(tmp_path, text, eclipse=False)[0].shaded.any()


def test_sizes_that_are_of_no_object_are_told(tmp_path: Path) -> None:
    text = "".join(lines_of(k, 110.0, n) for k, n in ((1, "A"), (2, "A DEB")))
    table = tmp_path / "sizes.csv"
    words = ("deb", "zzz", "A D", "R/B")
    rules = [{"name_contains": word, "diameter_m": 0.5} for word in words]
    table.write_text("norad_id,diameter_m\n99999,5\n3,5\n")
    assert gathered(tmp_path, text, rules=rules, sizes=str(table))[1] == [
        "populations.0.rules: no object's name contains 'zzz', 'R/B'",
        "populations.0.sizes: none of its 2 numbers is of an object of the file",
    ]
    table.write_text("norad_id,diameter_m\n99999,5\n2,5\n")
    assert gathered(tmp_path, text, rules=rules[:1], sizes=str(table))[1] == []


@pytest.mark.parametrize("by", ["magnitudes", "intensities_m2_sr"])
def test_a_light_curve_is_a_sphere(tmp_path: Path, by: str) -> None:
    """The body whose value at 70 degrees of phase is that of a sphere reflects as that one does."""
    intensity = float(sphere_intensity_per_irradiance(np.radians(70.0), 3.0, 0.25))
    value = -26.76 - 2.5 * np.log10(intensity / 1e6**2) if by == "magnitudes" else intensity
    body: dict[str, Any] = {"kind": "light_curve", by: [value] * 2, "times_s": [0.0, 1.0],
                            "phase_deg": 70.0, "phase_law": "lambert"}  # fmt: skip
    found, _ = gathered(tmp_path, lines_of(1, 110.0, "A"), body=body)
    assert found.reflecting_m2[0] == pytest.approx(0.25 * 9.0, rel=1e-9)
    as_given = {"phase_law": "as_given", "phase_deg": 0.0}
    for wrong in ({by: [value, value + 1.0]}, as_given):
        with pytest.raises(BadInput, match=r"body.kind.*light_curve of one value with phase_law"):
            gathered(tmp_path, lines_of(1, 110.0, "A"), body=body | wrong)


def test_made_up_objects() -> None:
    """Sizes follow N(>d) ~ d^-1.6; four fifths are low; another seed makes others."""
    wish = Synthetic(objects=20_000, seed=1, smallest_m=0.1, largest_m=10.0, albedo=0.3)
    made = synthetic_elements(wish, EPOCH)
    size = np.sqrt(made.reflecting_m2 / 0.3)
    assert (size.min(), size.max()) == (pytest.approx(0.1, rel=1e-3), pytest.approx(10.0, rel=0.4))
    for d in (0.2, 0.5, 1.0):
        wanted = (d**-1.6 - 10.0**-1.6) / (0.1**-1.6 - 10.0**-1.6)
        assert (size > d).mean() == pytest.approx(wanted, abs=4 * np.sqrt(wanted / 20_000))
    assert (made.kind == "debris").tolist() == (size < 1.0).tolist()
    assert (made.regime == "LEO").mean() == pytest.approx(0.8, abs=0.02)
    assert (made.regime == "GEO").mean() == pytest.approx(0.08, abs=0.01)
    assert (made.regime == "HEO").mean() == pytest.approx(0.07, abs=0.01)
    other = synthetic_elements(wish.model_copy(update={"seed": 2}), EPOCH)
    assert (other.mean[:, 0:6] != made.mean[:, 0:6]).any(axis=1).all()


def test_made_up_objects_are_where_real_ones_are() -> None:
    """Low ones about six heights and five inclinations, the others by their periods."""
    made = synthetic_elements(Synthetic(objects=20_000), EPOCH)
    bstar, ecc, _, tilt, _, motion, _ = made.mean.T
    low, high, long = bstar > 0.0, (bstar == 0.0) & (ecc < 0.1), ecc > 0.1
    assert ((made.regime == "LEO") == low).all()
    assert [low.mean(), long.mean()] == pytest.approx([0.8, 0.07], abs=0.01)
    axis_km = semi_major_axis_m(motion) / 1e3
    heights, edges = [500, 550, 780, 850, 1200, 1400], [300, 525, 665, 815, 1025, 1300, 1600]
    of_each = np.histogram(axis_km[low] - 6378.0, edges)[0] / np.count_nonzero(low)
    within = norm.cdf((np.array(edges) - np.array(heights)[:, None]) / 40.0)
    assert of_each == pytest.approx(np.diff(within, axis=1).mean(axis=0), abs=0.015)
    for middle in (53.0, 65.0, 74.0, 82.0, 98.0):
        near = np.abs(np.degrees(tilt[low]) - middle) < 4.0
        assert near.mean() == pytest.approx(0.2, abs=0.015)
    turns_a_day = motion[high] * 1440.0 / (2.0 * np.pi)
    for turns, share in ((2.0056, 5.0 / 13.0), (1.0027, 8.0 / 13.0)):
        assert (np.abs(turns_a_day - turns) < 0.02).mean() == pytest.approx(share, abs=0.03)
    assert 20_000.0 < axis_km[long].min() < 20_100.0
    assert 26_900.0 < axis_km[long].max() < 27_000.0
    assert [ecc[long].min(), ecc[long].max()] == pytest.approx([0.5, 0.7], rel=0.01)
    assert ecc[~long].mean() == pytest.approx(0.002 * np.sqrt(np.pi / 2.0), rel=0.03)
