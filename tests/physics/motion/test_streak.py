"""Streaks against brute-force time averages: transfer functions, merging, pieces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics.motion.streak import (
    HALVINGS,
    POINT,
    Path,
    add_rising,
    curve_through,
    cut_at,
    densest_share,
    in_few_runs,
    in_steps,
    part_within,
    path_through,
    piece_counts,
    pieces,
    transfer,
)

LENGTHS = [0.0, 1e-9, 0.1, 60.0, 300.0, 3000.0]


def nodes(kind: str, n: int = 65) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (x, y) at equal steps of time of a motion."""
    t = np.linspace(-0.5, 0.5, n)
    if kind == "straight":
        return 43.0 * t, -17.0 * t
    if kind == "curved":
        return 30.0 * np.sin(2 * t), 30.0 * (1.0 - np.cos(2 * t))
    if kind == "accelerating":
        return 20.0 * t + 30.0 * t**2, 5.0 * t + 7.5 * t**2
    assert kind == "retraced"
    return 12.0 * np.abs(t), 4.0 * np.abs(t)


KINDS = ["straight", "curved", "accelerating", "retraced"]


def plainly_merged(x, y, w, tolerance_px: float) -> list[int]:
    """Nodes kept: each run the first of ever halved rests that uniform motion describes."""
    keep = [0]
    while (start := keep[-1]) < len(w):
        stop = len(w)
        while stop > start + 1:
            light = np.concatenate([[0.0], np.cumsum(w[start:stop])])
            share = light / light[-1] if light[-1] > 0 else np.linspace(0, 1, stop - start + 1)
            off_x = x[start] + share * (x[stop] - x[start]) - x[start : stop + 1]
            off_y = y[start] + share * (y[stop] - y[start]) - y[start : stop + 1]
            if np.hypot(off_x, off_y).max() <= tolerance_px:
                break
            stop = start + max(1, (stop - start) // 2)
        keep.append(stop)
    return keep


@settings(max_examples=60)
@given(
    n=st.integers(1, 70), kind=st.sampled_from(KINDS), seed=st.integers(0, 999),
    shake_px=st.sampled_from([0.0, 1e-9, 0.02, 1.0]), dark=st.sampled_from([0.0, 0.3, 1.0]),
    tolerance_px=st.sampled_from([0.0, 1e-9, 1e-3, 0.1, 5.0]),
)  # fmt: skip
def test_runs_are_merged_as_the_rule_says(n, kind, seed, shake_px, dark, tolerance_px) -> None:
    rng = np.random.default_rng(seed)
    x, y = (v + rng.normal(0.0, shake_px, n + 1) for v in nodes(kind, n + 1))
    w = rng.random(n) * (rng.random(n) >= dark)
    keep = plainly_merged(x, y, w, tolerance_px)
    path = path_through(x, y, w, tolerance_px)
    assert np.array_equal(path.x_px, x[keep])
    assert np.array_equal(path.y_px, y[keep])
    assert np.array_equal(path.weight, np.add.reduceat(w, keep[:-1]))


def sampled(path: Path, per_segment: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of a path by brute force: (x, y, light), midpoints of equal parts of each segment."""
    u = (np.arange(per_segment) + 0.5) / per_segment
    x = path.x_px[:-1, None] + u * np.diff(path.x_px)[:, None]
    y = path.y_px[:-1, None] + u * np.diff(path.y_px)[:, None]
    w = np.repeat(path.weight[:, None] / per_segment, per_segment, axis=1)
    return x.ravel(), y.ravel(), w.ravel()


def test_paths_are_equal_by_all_their_numbers() -> None:
    """They are keys of caches: each of the three counts."""
    x, y, weight = np.array([0.0, 3.0, 4.0]), np.array([0.0, 1.0, 1.0]), np.array([0.7, 0.3])
    one, same = Path(x, y, weight), Path(x + 0.0, y + 0.0, weight + 0.0)
    assert one == same
    assert hash(one) == hash(same)
    others = [Path(x + 1.0, y, weight), Path(x, y + 1.0, weight), Path(x, y, weight[::-1])]
    assert len({one, *others}) == 4


@pytest.mark.parametrize("kind", KINDS)
def test_against_time_average_transfer(kind: str) -> None:
    x, y = nodes(kind)
    weight = np.linspace(1.0, 2.0, 64)
    weight /= weight.sum()
    path = path_through(x, y, weight, 1e-9)
    fy, fx = np.array([0.0, 0.011, -0.3, 0.5, 2.0]), np.array([0.0, 0.02, 0.25, 1.0])
    px, py, w = sampled(Path(x, y, weight), 400)
    phase = fy[:, None, None] * py + fx[None, :, None] * px
    brute = (w * np.exp(-2j * np.pi * phase)).sum(axis=-1)
    value = transfer(fy, fx, path.x_px, path.y_px, path.weight)
    assert np.abs(value - brute).max() < 1e-5
    assert value[0, 0] == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("length", LENGTHS)
def test_limits_straight_streak_is_a_sinc(length: float) -> None:
    path = Path(np.array([-0.6, 0.6]) * length, np.array([-0.4, 0.4]) * length, np.ones(1))
    fy, fx = np.linspace(-0.5, 0.5, 41), np.linspace(0.0, 0.5, 21)
    value = transfer(fy, fx, path.x_px, path.y_px, path.weight)
    exact = np.sinc(1.2 * length * fx[None, :] + 0.8 * length * fy[:, None])
    assert np.abs(value - exact).max() < 1e-12
    assert path.length_px == pytest.approx(length * np.hypot(1.2, 0.8), rel=1e-14)


def test_the_sinc_is_smooth_through_its_series() -> None:
    """Both sides of the switch to the series at half = 1e-4 agree to rounding."""
    fx = np.array([1e-4 / np.pi * (1 - 1e-9), 1e-4 / np.pi * (1 + 1e-9)])
    value = transfer(np.zeros(1), fx, np.array([-0.5, 0.5]), np.zeros(2), np.ones(1))
    assert abs(value[0, 0] - value[0, 1]) < 1e-15
    assert abs(value[0, 0] - np.sinc(fx[0])) < 1e-15


@pytest.mark.parametrize("scale", [1.0, 1e-3, 0.0])
def test_light_that_rises_along_segments_against_quadrature(scale: float) -> None:
    """Two segments of unlike rise, and one that stands still; added to what is there."""
    x, y = scale * np.array([-3.0, 2.0, 2.0, 6.5]) + 0.3, scale * np.array([1.0, 0.0, 0.0, 9.0])
    weight, rise = np.array([0.3, 0.2, 0.5]), np.array([0.25, 0.0, -0.4])
    fy, fx = np.linspace(-1.0, 0.9, 12), np.linspace(0.0, 1.0, 9)
    out = np.ones((12, 9), complex)
    add_rising(out, fy, fx, x, y, weight, rise)
    u, gauss = np.polynomial.legendre.leggauss(80)
    wanted = np.ones((12, 9), complex)
    for k in range(3):
        light = 0.5 * gauss * (weight[k] + rise[k] * u)
        at_x, at_y = (0.5 * (v[k] * (1.0 - u) + v[k + 1] * (1.0 + u)) for v in (x, y))
        turns = np.exp(-2j * np.pi * fy[:, None, None] * at_y)
        turns = turns * np.exp(-2j * np.pi * fx[None, :, None] * at_x)
        wanted += turns @ light
    assert np.abs(out - wanted).max() < 1e-13


def test_a_path_cut_at_places_is_the_same_path() -> None:
    path = Path(np.array([0.0, 4.0, 4.0]), np.array([0.0, 2.0, 9.0]), np.array([0.75, 0.25]))
    cut = cut_at(path, np.array([0.5, 1.0, 1.25]))
    assert cut.x_px.tolist() == [0.0, 2.0, 4.0, 4.0, 4.0]
    assert cut.y_px.tolist() == [0.0, 1.0, 2.0, 3.75, 9.0]
    assert cut.weight.tolist() == [0.375, 0.375, 0.0625, 0.1875]
    assert cut_at(path, np.zeros(0)).x_px.tolist() == path.x_px.tolist()


def timed_places(x: np.ndarray, y: np.ndarray, w: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Place (2, n) of a moving point after the share `at` of its light has come."""
    light = np.concatenate([[0.0], np.cumsum(w)])
    return np.stack([np.interp(at, light / light[-1], x), np.interp(at, light / light[-1], y)])


steps = st.floats(-30, 30, allow_nan=False)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(steps, steps, st.floats(0.01, 10.0)), min_size=1, max_size=24),
    st.sampled_from([1e-6, 2e-3, 0.5]),
)
def test_merging_stays_within_its_tolerance(
    moves: list[tuple[float, float, float]], tolerance: float
) -> None:
    dx, dy, w = (np.array(c) for c in zip(*moves, strict=True))
    x, y = np.concatenate([[0.0], np.cumsum(dx)]), np.concatenate([[0.0], np.cumsum(dy)])
    w = w / w.sum()
    path = path_through(x, y, w, tolerance)
    assert path.weight.sum() == pytest.approx(1.0, abs=1e-12)
    assert (path.x_px[0], path.y_px[0]) == (x[0], y[0])
    assert (path.x_px[-1], path.y_px[-1]) == (x[-1], y[-1])
    at = np.unique(np.concatenate([np.cumsum(w), np.cumsum(path.weight), np.linspace(0, 1, 99)]))
    at = at[(at > 1e-12) & (at < 1 - 1e-12)]
    off = timed_places(x, y, w, at) - timed_places(path.x_px, path.y_px, path.weight, at)
    assert np.hypot(*off).max(initial=0.0) <= tolerance + 1e-9


def test_uniform_motion_becomes_one_segment_and_changes_of_speed_do_not() -> None:
    t = np.linspace(0, 1, 1025)
    even = np.full(1024, 1 / 1024)
    assert path_through(300 * t, 20 * t, even, 2e-3).segments == 1
    assert path_through(300 * t**2, 20 * t**2, even, 2e-3).segments > 4
    back = path_through(np.abs(t - 0.5), 0 * t, even, 2e-3)
    assert back.length_px == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("tolerance_px", [1e-3, 1e-5, 1e-9])
def test_a_path_keeps_its_bends_between_the_nodes(tolerance_px: float) -> None:
    """A circle of 30 px at an even rate by 17 nodes: straight lines are 0.0146 px off, and as many
    as eight between two nodes a 64th of that."""
    t, dense = np.linspace(-0.5, 0.5, 17), np.linspace(0.0, 1.0, 4001)
    path = curve_through(30.0 * np.cos(t), 30.0 * np.sin(t), np.full(16, 1 / 16), tolerance_px)
    drawn = timed_places(path.x_px, path.y_px, path.weight, dense)
    right = 30.0 * np.array([np.cos(dense - 0.5), np.sin(dense - 0.5)])
    left_px = 30.0 * (1.0 / 16.0) ** 2 / 8.0 / 4.0**HALVINGS
    assert np.hypot(*(drawn - right)).max() <= 2.0 * tolerance_px + 1.1 * left_px
    assert path.segments <= 16 * 2**HALVINGS


@pytest.mark.parametrize("kind", ["corner", "random", "few"])
def test_what_is_no_bend_stays_as_its_nodes_have_it(kind: str) -> None:
    """A table's corner, random motion whose blur is known, and too few nodes to tell."""
    n = {"corner": 33, "random": 33, "few": 4}[kind]
    x, y = nodes("retraced" if kind == "corner" else "curved", n)
    if kind == "random":
        y = y + np.random.default_rng(1).normal(0.0, 0.1, n)
    even = np.full(n - 1, 1.0 / (n - 1))
    assert curve_through(x, y, even, 1e-9) == path_through(x, y, even, 1e-9)


def test_dark_steps_keep_their_shape() -> None:
    """A target in eclipse for part of the exposure: no light there, none lost elsewhere."""
    x = np.linspace(0, 64, 65)
    w = np.where(np.arange(64) < 20, 0.0, 1.0 / 44)
    path = path_through(x, 0 * x, w, 2e-3)
    kept = [(x0 + p.x_px.min(), x0 + p.x_px.max(), share) for x0, _, p, share in pieces(path)]
    assert sum(share for _, _, share in kept) == pytest.approx(1.0, abs=1e-12)
    lit = sampled(path, 50)
    assert (lit[0] * lit[2]).sum() == pytest.approx(42.0, abs=2e-2)
    assert pieces(path_through(x, 0 * x, np.zeros(64), 2e-3)) == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("longest", [5.0, 96.0])
def test_pieces_conserve_light_and_shape(kind: str, longest: float) -> None:
    x, y = nodes(kind)
    weight = np.linspace(1.0, 3.0, 64)
    path = path_through(x, y, weight / weight.sum(), 1e-3)
    cut = pieces(path, longest)
    assert sum(share for *_, share in cut) == pytest.approx(1.0, abs=1e-13)
    fy, fx = np.linspace(-0.4, 0.4, 7), np.linspace(0.0, 0.4, 5)
    total = np.zeros((7, 5), complex)
    for x0, y0, piece, share in cut:
        assert piece.length_px <= longest * (1 + 1e-12)
        assert piece.weight.sum() == pytest.approx(1.0, abs=1e-13)
        turn = np.exp(-2j * np.pi * (fy[:, None] * y0 + fx[None, :] * x0))
        total += share * turn * transfer(fy, fx, piece.x_px, piece.y_px, piece.weight)
    whole = transfer(fy, fx, path.x_px, path.y_px, path.weight)
    assert np.abs(total - whole).max() < 1e-12


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("longest", [0.05, 0.7, 1e3])
def test_steps_of_a_path_are_the_path(kind: str, longest: float) -> None:
    x, y = nodes(kind)
    weight = np.linspace(0.0, 3.0, 64)
    path = path_through(x, y, weight / weight.sum(), 1e-3)
    steps = in_steps(path, longest)
    lengths = np.hypot(np.diff(steps.x_px), np.diff(steps.y_px))
    assert lengths.max() <= longest * (1 + 1e-9)
    assert lengths.sum() == pytest.approx(path.length_px, rel=1e-12)
    own = np.hypot(np.diff(path.x_px), np.diff(path.y_px))
    assert steps.segments == np.maximum(1, np.ceil(own / longest)).sum()
    f = np.linspace(-0.4, 0.4, 7), np.linspace(0.0, 0.4, 5)
    made, whole = (transfer(*f, p.x_px, p.y_px, p.weight) for p in (steps, path))
    assert np.abs(made - whole).max() < 1e-12
    assert in_steps(POINT, longest) == POINT


@pytest.mark.parametrize("length", LENGTHS)
def test_limits_pieces_of_every_length(length: float) -> None:
    path = Path(np.array([-0.5, 0.5]) * length, np.zeros(2), np.ones(1))
    cut = pieces(path)
    assert len(cut) == max(1, int(np.ceil(length / 96.0)))
    assert len({p for *_, p, _ in cut}) == 1  # one table serves all
    assert sum(s for *_, s in cut) == pytest.approx(1.0, abs=1e-13)
    ends = [(x0 + p.x_px[0], x0 + p.x_px[-1]) for x0, _, p, _ in cut]
    assert ends[0][0] == pytest.approx(-length / 2, abs=1e-9)
    assert ends[-1][1] == pytest.approx(length / 2, abs=1e-9)


def test_few_runs_through_centroids_are_as_the_path_for_smooth_light() -> None:
    """An arc that bends by 0.3 px, its light falling: at up to half a cycle a px, where lines from
    node to node over the same steps err by several times more."""
    t = np.linspace(0.0, 1.0, 129)
    x, y = 20.0 * t, 1.2 * (t - 0.5) ** 2
    light = np.exp(-2.0 * 0.5 * (t[:-1] + t[1:]))
    path = Path(x, y, light / light.sum())
    few = in_few_runs(path, 0.02)
    assert few.segments < 32
    assert few.weight.sum() == pytest.approx(1.0)
    f = np.linspace(-0.5, 0.5, 41)
    whole, made = (transfer(f, f, p.x_px, p.y_px, p.weight) for p in (path, few))
    assert np.abs(made - whole).max() < 1e-3
    nodes = np.linspace(0, 128, (few.segments + 1) // 2 + 1).astype(int)
    lines = transfer(f, f, x[nodes], y[nodes], np.add.reduceat(path.weight, nodes[:-1]))
    assert np.abs(lines - whole).max() > 3 * np.abs(made - whole).max()
    assert in_few_runs(path, 0.0) is path
    dark = Path(x, y, np.where(t[1:] < 0.3, 0.0, path.weight))
    assert in_few_runs(dark, 1e-3) is dark


def test_a_point_is_a_path_without_length() -> None:
    assert POINT.length_px == 0.0
    assert len(pieces(POINT)) == 1
    f = np.linspace(-3, 3, 7)
    assert (transfer(f, f, POINT.x_px, POINT.y_px, POINT.weight) == 1.0).all()


def test_the_part_of_a_path_within_a_box() -> None:
    """From where it first enters to where it last leaves, with the light of that part."""
    x, y, w = np.array([0.0, 100.0, 220.0]), np.array([10.0, 10.0, 90.0]), np.array([0.3, 0.7])
    path = Path(x, y, w)
    made, share = part_within(path, (25.0, 160.0, -50.0, 80.0))  # type: ignore[misc]
    assert share == pytest.approx(0.3 * 0.75 + 0.7 * 0.5)
    assert made.weight == pytest.approx(np.array([0.3 * 0.75, 0.7 * 0.5]) / share)
    assert (made.x_px[0], made.y_px[0], made.x_px[-1]) == pytest.approx((25.0, 10.0, 160.0))
    one, share = part_within(path, (25.0, 70.0, -50.0, 80.0))  # type: ignore[misc]
    assert (share, one.x_px[0], one.x_px[-1]) == pytest.approx((0.3 * 0.45, 25.0, 70.0))
    last, share = part_within(path, (130.0, 400.0, 0.0, 70.0))  # type: ignore[misc]
    assert (share, last.y_px[0], last.y_px[-1]) == pytest.approx((0.7 * 0.5, 30.0, 70.0))
    assert part_within(path, (0.0, 90.0, 20.0, 80.0)) is None


@settings(max_examples=60, deadline=None)
@given(st.floats(-600, 600), st.floats(-600, 600), st.floats(1.0, 300.0), st.floats(-3, 3))
def test_pieces_near_a_box_are_all_that_touch_it(x: float, y: float, side: float, a: float) -> None:
    c, s = 900.0 * np.cos(a), 900.0 * np.sin(a)
    path = Path(np.array([-0.6 * c, 0.4 * c]), np.array([-0.6 * s, 0.4 * s]), np.ones(1))
    box = (x, x + side, y, y + side)
    kept = {(round(x0, 6), round(y0, 6)) for x0, y0, _, _ in pieces(path, 20.0, box)}
    for x0, y0, piece, _ in pieces(path, 20.0):
        t = np.linspace(0.0, 1.0, 50)
        px = x0 + piece.x_px[0] + t * np.diff(piece.x_px)
        py = y0 + piece.y_px[0] + t * np.diff(piece.y_px)
        if ((box[0] <= px) & (px <= box[1]) & (box[2] <= py) & (py <= box[3])).any():
            assert (round(x0, 6), round(y0, 6)) in kept
    assert len(kept) <= side * np.sqrt(2.0) / 20.0 + 6


def test_pieces_are_counted_as_they_are_cut() -> None:
    x, y = np.array([0.0, 500.0, 520.0, 531.0]), np.array([0.0, 10.0, 30.0, 25.0])
    path = Path(x, y, np.array([0.5, 0.3, 0.2]))
    cut = [(piece, share) for _, _, piece, share in pieces(path)]
    told = [(piece, share) for piece, share, count in piece_counts(path) for _ in range(count)]
    assert told == cut
    assert len(cut) == 7


def test_the_densest_share_of_a_path_is_where_it_rests_or_is_slowest() -> None:
    """Of a px of it, never more than all light; that of a straight even run is 1 / length."""
    even = np.linspace(0.0, 50.0, 9), np.zeros(9), np.full(8, 1.0 / 8.0)
    assert densest_share(*even) == pytest.approx(1.0 / 50.0)
    resting = np.array([0.0, 100.0, 100.0]), np.zeros(3), np.array([0.2, 0.8])
    assert densest_share(*resting) == 1.0
    slower = np.array([0.0, 30.0, 40.0]), np.zeros(3), np.array([0.5, 0.5])
    assert densest_share(*slower) == pytest.approx(0.05)
    point = np.zeros(3), np.zeros(3), np.array([0.0, 1.0])
    assert densest_share(*point) == 1.0
