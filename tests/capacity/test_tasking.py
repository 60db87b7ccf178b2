"""Who is looked at when, in cases small enough to be worked out by hand."""

from __future__ import annotations

from itertools import permutations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.capacity.tasking import (
    NEVER_S,
    Candidates,
    SensorState,
    Taken,
    detected,
    task_window,
    wanted,
)
from pipeline.spec.study_load import parse_study
from tests.capacity.conftest import SMALL

HOUR_S, STEP_S, DWELL_S, SETTLE_S = 3600.0, 60.0, 10.0, 5.0
SURE, HOPELESS = 1.0, 1e-12  # chances; draws lie between


def course(
    units: int, objects: int, seed: int = 0, rate_deg_s: float = 1.0, **tasking: Any
) -> Any:
    """Single sensors side by side, and objects A, B, ... wanted hourly; a hundred steps."""
    slewing = {"rate_deg_s": rate_deg_s, "settle_s": SETTLE_S}
    study = parse_study(SMALL | {
        "seed": seed, "tasking": {"kind": "cued", "revisit_h": 1.0} | tasking,
        "sensors": [SMALL["sensors"][0] | {"count": units, "slewing": slewing}],
    })  # fmt: skip
    names = np.array([chr(ord("A") + k) for k in range(objects)])
    return SimpleNamespace(
        study=study, units=np.zeros(units, np.int64), steps=100,
        watchers=[SimpleNamespace(dwell_s=DWELL_S)],
        elements=Objects(names, np.arange(objects) + 100),
    )  # fmt: skip


class Objects:
    """Names and numbers alone."""

    def __init__(self, name: Any, number: Any) -> None:
        self.name, self.number = name, number

    def __len__(self) -> int:
        return len(self.name)


def state(units: int, objects: int) -> SensorState:
    return SensorState(np.zeros(units), np.zeros((units, 3)), np.full(objects, NEVER_S))


def candidates(steps: Any, degrees: Any, chance: Any) -> Candidates:
    """All objects in each step, on one great circle."""
    many, n = len(steps), len(degrees)
    at = np.radians(np.tile(degrees, many))
    return Candidates(
        np.repeat(steps, n), np.zeros(many * n, np.int64), np.tile(np.arange(n), many),
        np.stack([np.cos(at), np.sin(at), 0.0 * at], axis=1),
        np.tile(chance * np.ones(n), many),
    )  # fmt: skip


def told(c: Candidates, t: Taken) -> list[tuple[int, str, int, float, float]]:
    """Observations: step, object, single sensor, start and length [s]."""
    return [
        (int(c.step[row]), chr(ord("A") + int(c.object[row])), int(unit), start, round(length, 6))
        for row, unit, start, length in zip(t.row, t.unit, t.start_s, t.length_s, strict=True)
    ]


def test_the_first_rule_that_names_an_object_counts() -> None:
    rules = [
        {"name_contains": "b", "priority": 5.0, "revisit_h": 3.0},
        {"numbers": [101, 102], "priority": 2.0, "revisit_h": 7.0},
        {"name_contains": "C", "priority": 9.0},
        {"name_contains": "D", "priority": 4.0},
        {"priority": 0.5, "revisit_h": 8.0},
    ]
    asked = course(1, 5, rules=rules)
    priority, revisit = wanted(asked.study.tasking, asked.elements)
    assert priority.tolist() == [0.5, 5.0, 2.0, 4.0, 0.5]
    assert (revisit / HOUR_S).tolist() == [8.0, 3.0, 7.0, 1.0, 8.0]


def test_a_sensor_by_hand() -> None:
    """B first, for its priority; then A, 30 degrees away; C takes its time into the next step.
    Half an hour after they were detected A and B are wanted again, B more."""
    rules = [{"name_contains": "B", "priority": 2.0}]
    asked, own = course(1, 3, rules=rules), state(1, 3)
    c = candidates([0, 1, 2, 30, 31, 62], [0.0, 30.0, 90.0], SURE)
    found = told(c, task_window(asked, c, own))
    assert found == [
        (0, "B", 0, 0.0, 15.0), (0, "A", 0, 15.0, 45.0), (1, "C", 0, 60.0, 105.0),
        (31, "B", 0, 1860.0, 75.0), (62, "A", 0, 3720.0, 45.0), (62, "B", 0, 3765.0, 45.0),
    ]  # fmt: skip
    assert own.last_s.tolist() == [3765.0, 3810.0, 165.0]
    assert own.free_s[0] == 3810.0


def test_the_state_is_handed_on_between_windows() -> None:
    """Two windows are as one."""
    once, twice, made = state(1, 3), state(1, 3), course(1, 3)
    c = candidates([0, 1, 40, 41], [0.0, 50.0, 90.0], SURE)
    whole = told(c, task_window(made, c, once))
    parts = []
    for steps in ([0, 1], [40, 41]):
        part = candidates(steps, [0.0, 50.0, 90.0], SURE)
        parts += told(part, task_window(made, part, twice))
    assert parts == whole
    np.testing.assert_array_equal(once.last_s, twice.last_s)


@pytest.mark.parametrize(
    ("chance", "ages_h", "first"),
    [
        ([0.3, 0.9, 0.5], [2.0, 2.0, 2.0], "B"),  # the likelier
        ([0.5, 0.5, 0.5], [2.0, 3.0, 4.0], "C"),  # the more overdue
        ([0.9, 0.5, 0.3], [1.0, 1.9, 2.9], "B"),  # chance x overdue
    ],
)
def test_score(chance: list[float], ages_h: list[float], first: str) -> None:
    own = state(1, 3)
    own.last_s[:] = -np.array(ages_h) * HOUR_S
    c = candidates([0], [0.0, 0.0, 0.0], chance)
    assert told(c, task_window(course(1, 3), c, own))[0][1] == first


@pytest.mark.parametrize(("rate_deg_s", "taken"), [(1.0, "BA"), (0.2, "B"), (1e-300, "B")])
def test_what_would_end_after_the_period_is_not_taken(rate_deg_s: float, taken: str) -> None:
    """In the last step of a study: a turn by 30 degrees takes 30 s, 150 s, or an age."""
    rules = [{"name_contains": "B", "priority": 2.0}]
    asked, own = course(1, 2, rate_deg_s=rate_deg_s, rules=rules), state(1, 2)
    c = candidates([asked.steps - 1], [0.0, 30.0], SURE)
    found = told(c, task_window(asked, c, own))
    assert "".join(one[1] for one in found) == taken
    assert own.free_s[0] <= asked.steps * asked.study.step_s


def test_what_is_not_detected_stays_overdue() -> None:
    """It is taken once in a step, and in the next step again."""
    c = candidates([0, 1], [0.0], HOPELESS)
    own = state(1, 1)
    found = told(c, task_window(course(1, 1), c, own))
    assert found == [(0, "A", 0, 0.0, 15.0), (1, "A", 0, 60.0, 15.0)]
    assert own.last_s[0] == NEVER_S


def test_the_sensor_that_is_free_first_chooses_first() -> None:
    """And none begins before its step."""
    own = state(2, 2)
    own.free_s[:] = [630.0, 0.0]
    c = candidates([10], [0.0, 0.0], [0.5, 0.9])
    assert told(c, task_window(course(2, 2), c, own)) == [
        (10, "B", 1, 600.0, 15.0), (10, "A", 1, 615.0, 15.0)
    ]  # fmt: skip


@pytest.mark.parametrize("seed", range(6))
def test_assignment_is_the_largest_sum_of_scores(seed: int) -> None:
    """Against all ways to share four objects among three sensors."""
    rng = np.random.default_rng(seed)
    degrees, chance = rng.uniform(0.0, 360.0, 4), rng.uniform(0.1, 1.0, 4)
    own, looks = state(3, 4), np.radians(rng.uniform(0.0, 360.0, 3))
    own.direction[:] = np.stack([np.cos(looks), np.sin(looks), 0.0 * looks], axis=1)
    off = np.degrees(looks)[:, None] - degrees
    turn = np.abs((off + 180.0) % 360.0 - 180.0)
    score = chance / (turn + SETTLE_S + DWELL_S)
    best = max(permutations(range(4), 3), key=lambda p: sum(score[np.arange(3), p]))
    c = candidates([0], degrees, chance)
    found = told(c, task_window(course(3, 4, scheduler="assignment"), c, own))[:3]
    assert {(unit, name) for _, name, unit, _, _ in found} == {
        (k, chr(ord("A") + i)) for k, i in enumerate(best)
    }


def test_draws_are_of_seed_step_sensor_and_object() -> None:
    """Each of them alone changes half of the draws of a chance of a half; all have its mean."""
    n, k = 20_000, np.arange(20_000)
    zero, half = np.zeros(n, np.int64), np.full(n, 0.5)
    one = detected(course(1, 1), k, zero, zero, half)
    assert one.mean() == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(n))
    assert detected(course(1, 1), k, zero, zero, np.full(n, 0.1)).mean() == pytest.approx(
        0.1, abs=4 * 0.3 / np.sqrt(n)
    )
    for other in (detected(course(1, 1, seed=1), k, zero, zero, half),
                  detected(course(1, 1), k, zero + 1, zero, half),
                  detected(course(1, 1), k, zero, zero + 1, half),
                  detected(course(1, 1), zero, k, zero, half),
                  detected(course(1, 1), zero, zero, k, half)):  # fmt: skip
        assert (other != one).mean() == pytest.approx(0.5, abs=0.03)
