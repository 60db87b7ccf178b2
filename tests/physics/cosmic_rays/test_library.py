"""Recorded events in a frame: random places, whole frames cut or tiled, the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pipeline.physics.cosmic_rays.detect import (
    bad_pixels,
    find_events,
    residual,
    stack_levels,
    steady_sigma,
)
from pipeline.physics.cosmic_rays.frame import charge_e, events_a_frame, truth_columns
from pipeline.physics.cosmic_rays.library import Library, Recorded, mean_count, place_events
from pipeline.physics.noise.streams import stream_key

KEY = stream_key(1, "cosmic_rays")


def library(rows=20, columns=30, frames=10, events=6, exposure_s=100.0) -> Library:
    """Events of 1 to 4 pixels in a row, in the even frames."""
    rng = np.random.default_rng(2)
    sizes = rng.integers(1, 5, events)
    start = np.concatenate([[0], np.cumsum(sizes)])
    x = np.concatenate([rng.integers(0, columns - 4) + np.arange(n) for n in sizes])
    y = np.concatenate([np.full(n, rng.integers(0, rows)) for n in sizes])
    electrons = rng.uniform(100, 1000, start[-1])
    frame = np.sort(rng.integers(0, frames // 2, events)) * 2
    return Library(start, x, y, electrons, exposure_s, rows * columns, 10.0, (rows, columns),
                   frames, frame)  # fmt: skip


def image_of(lib: Library, frames) -> np.ndarray:
    """The recorded image of some frames of a library."""
    image = np.zeros(lib.shape)
    for f in frames:
        for n in np.flatnonzero(lib.frame == f):
            part = slice(lib.start[n], lib.start[n + 1])
            image[lib.y[part], lib.x[part]] += lib.electrons[part]
    return image


def test_counts_are_poisson_and_follow_rate_area_and_time():
    lib = library()
    r = Recorded(lib, 200, 300, 20.0, 50.0, rate_scale=3.0)
    mean = 3.0 * 6 / 600 / 100.0 * 4 * 200 * 300 * 50.0
    assert mean_count(r) == pytest.approx(mean)
    r = Recorded(lib, 40, 30, 10.0, 50.0)
    counts = np.array([len(truth_columns(r, 1, k)["event"]) for k in range(3000)])
    sizes = np.diff(lib.start)
    mean = mean_count(r) * np.mean((30 + sizes - 1) / 30)  # events that touch the frame
    assert counts.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / 3000))
    assert counts.var() / counts.mean() == pytest.approx(1.0, abs=5 * np.sqrt(2 / 3000))


def test_charge_is_even_over_the_frame():
    """Also at the edges, where events are cut: rate x time x mean charge in each pixel."""
    lib = library()
    r = Recorded(lib, 12, 9, 10.0, 2000.0)
    total = sum(charge_e(r, 1, k, 0, 0, 12, 9) for k in range(1500))
    expected = lib.rate_per_px_s * 2000.0 * 1500 * lib.electrons.sum() / len(lib)
    error = np.sqrt(expected * 1000.0)
    assert np.abs(total - expected).max() < 5 * error
    assert total.mean() == pytest.approx(expected, abs=5 * error / np.sqrt(12 * 9 / 4))


def test_whole_frames_centre_cut_out():
    """A smaller detector sees the centre of one recorded frame."""
    lib = library()
    r = Recorded(lib, 10, 14, 10.0, 10.0, arrival="frames")  # exactly one frame
    known = [image_of(lib, [f])[5:15, 8:22] for f in range(10)]
    seen = set()
    for k in range(200):
        image = charge_e(r, 1, k, 0, 0, 10, 14)
        same = [f for f, one in enumerate(known) if np.array_equal(one, image)]
        assert same
        seen.add(same[0])
    assert len(seen) >= 2


def test_whole_frames_tiled_over_a_larger_detector():
    lib = library()
    r = Recorded(lib, 33, 70, 10.0, 10.0, arrival="frames")
    for k in range(40):
        image = charge_e(r, 1, k, 0, 0, 33, 70)
        np.testing.assert_array_equal(image, np.tile(image[:20, :30], (2, 3))[:33, :70])


def test_frame_count_rule():
    """scale x exposure over a recorded frame's: whole frames, with or without events in them."""
    lib = library()
    r = Recorded(lib, 20, 30, 10.0, 10.0, rate_scale=2.5, arrival="frames")
    charges = [charge_e(r, 1, k, 0, 0, 20, 30).sum() for k in range(3000)]
    mean = 2.5 * lib.electrons.sum() / 10
    assert np.mean(charges) == pytest.approx(mean, abs=5 * np.std(charges) / np.sqrt(3000))
    pairs = {round(image_of(lib, [a, b]).sum(), 6) for a in range(10) for b in range(10)}
    exact = Recorded(lib, 20, 30, 10.0, 20.0, arrival="frames")
    got = {round(charge_e(exact, 1, k, 0, 0, 20, 30).sum(), 6) for k in range(300)}
    assert got <= pairs
    assert 0.0 in got  # two frames without events


@pytest.mark.parametrize("arrival", ["poisson", "frames"])
def test_same_bits_for_every_tiling(arrival):
    r = Recorded(library(), 50, 64, 10.0, 300.0, rate_scale=3.0, arrival=arrival)
    whole = charge_e(r, 5, 2, 0, 0, 50, 64)
    assert whole.any()
    for rows, columns in ((7, 64), (50, 5), (16, 16)):
        for y in range(0, 50, rows):
            for x in range(0, 64, columns):
                part = charge_e(r, 5, 2, y, x, min(rows, 50 - y), min(columns, 64 - x))
                np.testing.assert_array_equal(part, whole[y : y + rows, x : x + columns])
    truth = truth_columns(r, 5, 2)
    assert truth["electrons"].sum() == pytest.approx(whole.sum())
    assert set(truth["kind"]) == {"recorded"}


def test_truth_tells_the_box_of_each_event():
    """Where one event alone came down, its corners are those of the charge in the frame."""
    r, alone = Recorded(library(), 50, 64, 10.0, 3.0), 0
    for k in range(60):
        truth, image = truth_columns(r, 5, k), charge_e(r, 5, k, 0, 0, 50, 64)
        rows, columns = np.nonzero(image)
        if len(truth["event"]) == 1 and 0 < columns.min() <= columns.max() < 63:
            corners = [truth[n][0] for n in ("x_in_px", "x_out_px", "y_in_px", "y_out_px")]
            assert corners == [columns.min(), columns.max(), rows.min(), rows.max()]
            alone += 1
    assert alone > 5


def test_every_event_is_as_likely():
    r = Recorded(library(), 60, 60, 10.0, 5e4)
    placed = place_events(r, 0, KEY)
    counts = np.bincount(placed.number, minlength=6)
    assert stats.chisquare(counts).pvalue > 1e-4


def test_limits_an_empty_library():
    none = library(events=1)
    empty = Library(np.zeros(1, np.int64), none.x[:0], none.y[:0], none.electrons[:0], 10.0, 600,
                    10.0, (20, 30), 10, none.frame[:0])  # fmt: skip
    for arrival in ("poisson", "frames"):
        r = Recorded(empty, 20, 30, 10.0, 10.0, arrival=arrival)
        assert not charge_e(r, 1, 0, 0, 0, 20, 30).any()
        assert len(truth_columns(r, 1, 0)["event"]) == 0


@pytest.mark.parametrize(("rows", "columns"), [(33, 70), (12, 9)])
@pytest.mark.parametrize("arrival", ["poisson", "frames"])
def test_expected_events_are_those_placed(arrival, rows, columns):
    """On oblong frames, smaller and larger than the recorded ones: the mean of many frames."""
    r = Recorded(library(), rows, columns, 10.0, 25.0, rate_scale=1.5, arrival=arrival)
    counts = np.array([len(place_events(r, k, KEY)) for k in range(3000)])
    off = 5.0 * counts.std() / np.sqrt(3000)
    if arrival == "frames":
        assert counts.mean() == pytest.approx(events_a_frame(r), abs=off)
    else:  # of those drawn, some come down beside the frame
        assert counts.mean() - off <= events_a_frame(r) <= 1.6 * counts.mean()


def test_finding_events_in_a_frame():
    """Groups by eight neighbours, above a low level, that hold a pixel above the high one."""
    rest, sigma = np.zeros((8, 9), np.float32), np.full((8, 9), 2.0, np.float32)
    rest[1, 1], rest[2, 2], rest[3, 2] = 30.0, 9.0, 12.0  # one event, corner to corner
    rest[6, 6], rest[6, 7] = 12.0, 9.0  # no pixel of it is above the high level
    rest[5, 4], rest[0, 8] = 40.0, 50.0
    bad = np.zeros((8, 9), bool)
    bad[5, 4] = True
    sigma[0, 8] = 30.0
    event, y, x = find_events(rest, sigma, bad, 10.0, 4.0)
    assert (event.tolist(), y.tolist(), x.tolist()) == ([0, 0, 0], [1, 2, 3], [1, 2, 2])
    assert bad_pixels(np.array([2, 3, 9, 10, 11]), 100).tolist() == [False] * 4 + [True]
    assert bad_pixels(np.array([2, 3]), 5).tolist() == [False, True]


def test_levels_of_a_stack_of_three():
    """Median and sample deviation; what a frame has of its own, and no sigma below the usual."""
    stack = np.array([9.0, 11.0, 10.0], np.float32)[:, None, None] * np.ones((2, 2), np.float32)
    level, sigma = stack_levels(stack)
    assert (level.min(), sigma.min(), sigma.max()) == (10.0, 1.0, 1.0)
    assert steady_sigma(np.array([1.0, 2.0, 7.0]), 1.5).tolist() == [2.0, 2.0, 7.0]
    assert steady_sigma(np.array([1.0, 2.0, 7.0]), 3.0).tolist() == [3.0, 3.0, 7.0]
    frame = level + np.array([[4.0, 4.0], [4.0, 90.0]])
    assert residual(frame, level).tolist() == [[0.0, 0.0], [0.0, 86.0]]
