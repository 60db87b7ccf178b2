"""Ephemeris tables: exact for polynomials, within the stated error on orbits, refused outside."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline, KroghInterpolator

from pipeline.errors import BadInput
from pipeline.physics.positions.orbit_table import (
    best_nodes,
    check_covered,
    hole_error,
    interpolate,
    left_out_error,
    table_error,
)
from pipeline.physics.positions.orbit_two_body import two_body


def orbit(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return two_body(np.array([7e6, 0, 0]), np.array([0.0, 6000.0, 5500.0]), t)


@settings(max_examples=60)
@given(st.integers(2, 8), st.booleans(), st.integers(0, 2**31))
def test_polynomials_are_met(nodes: int, hermite: bool, seed: int) -> None:
    """Degree nodes - 1, or 2 nodes - 1 with velocities, on uneven rows."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.5, 1.5, 14))
    degree = 2 * nodes - 1 if hermite else nodes - 1
    shapes = [np.polynomial.Polynomial(rng.normal(size=degree + 1), [0, 20]) for _ in range(3)]
    place = np.stack([p(time) for p in shapes], axis=1)
    speed = np.stack([p.deriv()(time) for p in shapes], axis=1)
    at = rng.uniform(time[0], time[-1], 30)
    found, slope = interpolate(time, place, speed if hermite else None, at, nodes)
    scale = np.abs(place).max()
    assert np.allclose(found, np.stack([p(at) for p in shapes], 1), atol=1e-8 * scale)
    assert np.allclose(slope, np.stack([p.deriv()(at) for p in shapes], 1), atol=1e-7 * scale)


def test_against_scipy() -> None:
    time = np.arange(0.0, 600.0, 60.0)
    place, speed = orbit(time)
    at = np.linspace(245.0, 295.0, 7)
    ours, _ = interpolate(time, place, speed, at, 2)
    assert np.allclose(ours, CubicHermiteSpline(time, place, speed)(at), rtol=1e-13)
    ours, _ = interpolate(time, place, None, at, 10)
    assert np.allclose(ours, KroghInterpolator(time, place)(at), rtol=1e-11)


@pytest.mark.parametrize("hermite", [False, True])
@pytest.mark.parametrize("step", [30.0, 120.0, 240.0])
def test_stated_error_holds(hermite: bool, step: float) -> None:
    """Between all rows, also at the ends, the error stays below that measured on left-out rows."""
    time = np.arange(0.0, 12_000.0, step)
    place, speed = orbit(time)
    given = speed if hermite else None
    nodes, error = best_nodes(time, place, given)
    at = np.linspace(0.0, time[-1], 3001)
    found, slope = interpolate(time, place, given, at, nodes)
    true, true_speed = orbit(at)
    assert np.linalg.norm(found - true, axis=1).max() <= error + 1e-6
    assert np.linalg.norm(slope - true_speed, axis=1).max() <= 20 * error / step + 1e-6
    assert error < 1e-3 * step**2


GEO = np.array([4.2164e7, 0.0, 0.0]), np.array([0.0, 3074.66, 0.0])


@pytest.mark.parametrize("hermite", [False, True])
@pytest.mark.parametrize("hole_h", [0.5, 3.0, 6.0, 12.0])
def test_stated_error_holds_in_a_hole(hole_h: float, hermite: bool) -> None:
    """Of rounded rows a minute apart with some missing, whose neighbours say little of it."""
    time = np.arange(-16.0, 16.0) * 60.0
    time[16:] += 3600.0 * hole_h
    place, speed = (np.round(v, 4) for v in two_body(*GEO, time))
    given = speed if hermite else None
    nodes, error = best_nodes(time, place, given)
    at = np.linspace(time[15], time[16], 101)
    off = interpolate(time, place, given, at, nodes)[0] - two_body(*GEO, at)[0]
    worst = np.linalg.norm(off, axis=1).max()
    assert worst <= error == table_error(time, place, given, nodes)
    assert error < 200.0 * worst
    assert left_out_error(time, place, given, nodes) < 0.1 * worst
    wanted = time < 0.0
    assert best_nodes(time, place, given, wanted)[1] < 0.02  # where no place is asked for in it
    assert hole_error(time[:16], place[:16], None, nodes) == 0.0


@pytest.mark.parametrize("hermite", [False, True])
@pytest.mark.parametrize("rows", [(-1800, -1740, 1800), (-5000, -1800, 1800, 5000)])
def test_stated_error_of_few_rows_holds(rows: tuple[float, ...], hermite: bool) -> None:
    time = np.array(rows, float)
    place, speed = two_body(*GEO, time)
    given = speed if hermite else None
    nodes, error = best_nodes(time, place, given)
    off = interpolate(time, place, given, [0.0], nodes)[0] - two_body(*GEO, np.zeros(1))[0]
    assert np.linalg.norm(off) <= error
    assert nodes == (2 if len(time) == 3 else 4)


@pytest.mark.parametrize("step_s", [30.0, 120.0])
@pytest.mark.parametrize("fault", ["constant", "scale", "turn"])
def test_velocities_that_all_err_alike_are_seen(fault: str, step_s: float) -> None:
    """Of another source, unit or frame: midway between two rows no place is off, elsewhere all."""
    time = np.arange(0.0, 7200.0, step_s)
    start = np.array([2.66e7, 0, 0]), np.array([0, 3870.0, 0])
    place, speed = two_body(*start, time)
    wrong = {
        "constant": speed + [20.0, -15.0, 10.0],
        "scale": 1.01 * speed,
        "turn": speed - np.cross([0.0, 0.0, 7.292115e-5], place),
    }[fault]
    nodes, stated_m = best_nodes(time, place, wrong)
    at = np.linspace(0.0, time[-1], 4001)
    found, _ = interpolate(time, place, wrong, at, nodes)
    off_m = np.linalg.norm(found - two_body(*start, at)[0], axis=1).max()
    assert off_m > 0.05 * step_s
    assert off_m <= stated_m < 4.0 * off_m


def test_only_the_rows_asked_for_are_judged() -> None:
    """Even motion through two rows each, one row 10 m off: its neighbours are missed by half."""
    time = np.arange(7) * 60.0
    place = 7500.0 * time[:, None] * [1.0, 0.0, 0.0]
    place[3] += [0.0, 0.0, 10.0]
    for row, missed_m in enumerate((np.nan, 0.0, 5.0, 10.0, 5.0, 0.0, np.nan)):
        found = left_out_error(time, place, None, 2, np.arange(7) == row)
        assert found == pytest.approx(missed_m, abs=1e-6, nan_ok=True), row
    assert left_out_error(time, place, None, 2) == pytest.approx(10.0)


def test_rows_are_met() -> None:
    time = np.arange(0.0, 1200.0, 60.0)
    place, speed = orbit(time)
    for speeds in (None, speed):
        found, _ = interpolate(time, place, speeds, time, 6)
        assert np.allclose(found, place, rtol=1e-14)


def test_same_bits_whatever_is_asked_with_it() -> None:
    time = np.arange(0.0, 6000.0, 60.0)
    place, _ = orbit(time)
    at = np.linspace(100.0, 5000.0, 57)
    whole, _ = interpolate(time, place, None, at, 8)
    alone = np.concatenate([interpolate(time, place, None, [x], 8)[0] for x in at])
    assert np.array_equal(whole, alone)


def test_limits_short_tables_and_outside() -> None:
    time, place = np.array([0.0, 60.0]), np.array([[7e6, 0, 0], [7e6, 4e5, 0]])
    assert np.isnan(left_out_error(time, place, None, 2))
    assert best_nodes(time, place, None)[0] == 2
    with pytest.raises(BadInput, match=r"0\.000 to 60\.000 s") as told:
        check_covered(0.0, 60.0, np.array([10.0, 61.0]), "targets.0.orbit", "2019-04-20T00:00:00Z")
    assert "61.000" in str(told.value)
