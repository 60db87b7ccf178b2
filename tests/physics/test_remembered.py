"""What is remembered of a function of time is, to the bit, what the function gives."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import erfa.ufunc as era
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics import remembered
from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, DAY_S
from pipeline.physics.positions.earth import earth_and_sun, gcrs_to_itrs, site_state
from pipeline.physics.positions.times import instants
from pipeline.physics.remembered import Remembered

JD = 2458000.5
CALLS = st.lists(st.lists(st.integers(0, 40), min_size=1, max_size=12), max_size=12)


@given(CALLS, st.sampled_from([3, 12, 1000]))
def test_same_values_whatever_was_asked_for_before(
    calls: Sequence[Sequence[int]], most: int
) -> None:
    """Known and new moments together, again and again, also where there is no room for all."""
    looked_at = []

    def function(part1: np.ndarray, part2: np.ndarray) -> np.ndarray:
        looked_at.append(len(part1))
        return np.stack([np.sin(part1 + part2), part1 * part2], axis=-1)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(remembered, "MOST", most)
        known = Remembered(function)
        for call in calls:
            part2 = np.array(call) / 7.0
            found = known(JD, part2)
            np.testing.assert_array_equal(found, function(np.full(len(call), JD), part2))
            found[:] = np.nan  # the caller's own
    if most == 1000:
        asked = sum(looked_at) - sum(len(call) for call in calls)  # less what this test asked for
        assert asked == len({moment for call in calls for moment in call})


def test_threads_that_learn_together_hear_the_truth() -> None:
    rng = np.random.default_rng(4)
    calls = [rng.integers(0, 20_000, 200) / 86_400.0 for _ in range(300)]
    known = Remembered(lambda part1, part2: np.stack([part1 + part2, part2], axis=-1))
    with ThreadPoolExecutor(8) as pool:
        for call, found in zip(calls, pool.map(lambda c: known(JD, c), calls), strict=True):
            np.testing.assert_array_equal(found, np.stack([JD + call, call], axis=-1))


def test_threads_that_ask_for_the_same_moments_at_once_hear_them_once() -> None:
    """Those that waited while another learnt them have nothing left to ask for."""
    asked: list[int] = []

    def slow(part1: np.ndarray, part2: np.ndarray) -> np.ndarray:
        asked.append(len(part1))
        time.sleep(0.2)
        return part1 + part2

    known, wanted = Remembered(slow), np.array([0.25, 0.5])
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: known(JD, wanted), range(4)):
            np.testing.assert_array_equal(found, JD + wanted)
    assert asked == [2]


def test_threads_hold_values_with_their_moments() -> None:
    """What was known before the first moments were learnt knows none of them."""
    known = Remembered(lambda part1, part2: part1 + part2)
    before, _ = known._known
    known(JD, [0.25])
    assert before == {}
    assert known(JD, [0.25]) == JD + 0.25


def test_no_moments_have_no_values() -> None:
    fresh = Remembered(era.c2i06a)
    assert fresh(JD, []).shape == (0, 3, 3)
    fresh(JD, [0.25])
    assert fresh(JD, []).shape == (0, 3, 3)


@pytest.mark.parametrize("again", [False, True])
def test_earth_and_its_axes_are_those_of_erfa(again: bool) -> None:
    """New moments; a third of them, and all of the axes, known."""
    at = instants((JD + again, 0.25), np.linspace(0.0, 4e4, 1000), 0.2)
    if again:
        earth_and_sun(at.tt1[::3], at.tt2[::3])
        gcrs_to_itrs(at)
    heliocentric, barycentric, _ = era.epv00(at.tt1, at.tt2)
    found = earth_and_sun(at.tt1, at.tt2)
    np.testing.assert_array_equal(found.position_m, barycentric["p"] * ASTRONOMICAL_UNIT_M)
    np.testing.assert_array_equal(
        found.velocity_m_s, barycentric["v"] * (ASTRONOMICAL_UNIT_M / DAY_S)
    )
    np.testing.assert_array_equal(found.sun_from_earth_m, -heliocentric["p"] * ASTRONOMICAL_UNIT_M)
    pole = 2e-6, -1e-6
    whole = era.c2t06a(at.tt1, at.tt2, at.ut11, at.ut12, *pole)
    np.testing.assert_array_equal(gcrs_to_itrs(at, *pole), whole)
    turn, fixed = era.era00(at.ut11, at.ut12), era.sp00(at.tt1, at.tt2)
    pv = era.pvtob(1.0, 0.5, 100.0, *pole, fixed, turn)
    to_gcrs = np.swapaxes(era.c2i06a(at.tt1, at.tt2), -1, -2)
    place, _ = site_state(0.5, 1.0, 100.0, at, *pole)
    np.testing.assert_array_equal(place, np.einsum("nij,nj->ni", to_gcrs, pv["p"]))


def test_of_more_moments_than_are_remembered_each_is_worked_out_once() -> None:
    """A hundred moments a thousand times, and more different ones than there is room for."""
    asked: list[int] = []

    def function(part1: np.ndarray, part2: np.ndarray) -> np.ndarray:
        asked.append(len(part1))
        return np.stack([part1 + part2, part1 * part2], axis=-1)

    known, rng = Remembered(function), np.random.default_rng(5)
    few = rng.permutation(np.tile(rng.uniform(-0.5, 0.5, 100), 1000))
    many = rng.uniform(-0.5, 0.5, remembered.MOST + 1)
    for part2, new in ((few, [100]), (few, []), (many, [len(many)])):
        asked.clear()
        found = known(JD, part2)
        assert asked == new
        np.testing.assert_array_equal(found, function(np.full(len(part2), JD), part2))
