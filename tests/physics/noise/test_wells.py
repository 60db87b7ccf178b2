"""Wells, patterns and moving charge, each against a slow and plain account of the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from pipeline.physics.noise.chain import calibrated_e, to_dn
from pipeline.physics.noise.patterns import bias_pattern_dn, chosen, hot_dark_e_s, prnu
from pipeline.physics.noise.streams import poisson_image, standard_normals, stream_key
from pipeline.physics.noise.terms import Chain, StreamPlace
from pipeline.physics.noise.transfer import lag_frames, lagged_e, passed_means, smear_e
from pipeline.physics.noise.wells import bloom, collected_e, measured_e


def bloomed(column: list[float], well: float) -> list[float]:
    """Blooming of one column, parcel by parcel: half of each excess runs each way."""
    charge = list(column)
    excess = [max(0.0, c - well) for c in charge]
    charge = [min(c, well) for c in charge]
    for step, order in ((1, range(len(charge))), (-1, range(len(charge) - 1, -1, -1))):
        for start in reversed(list(order)):  # the farthest along the way fills first
            left, at = 0.5 * excess[start], start + step
            while left > 0 and 0 <= at < len(charge):
                put = min(left, well - charge[at])
                charge[at] += put
                left -= put
                at += step
    return charge


@settings(max_examples=100)
@given(st.lists(st.floats(0, 1000), min_size=1, max_size=30))
def test_blooming_against_parcels(column: list[float]) -> None:
    charge = np.array(column)[:, None]
    bloom(charge, np.full_like(charge, 100.0))
    assert charge[:, 0] == pytest.approx(bloomed(column, 100.0), abs=1e-9)
    assert charge.max() <= 100.0 + 1e-9
    assert charge.sum() <= sum(column) + 1e-9


def test_blooming_conserves_charge_away_from_the_ends() -> None:
    charge = np.full((200, 3), 10.0)
    charge[100, 1] = 4000.0
    charge[60:63, 2] = 500.0
    before = charge.sum(axis=0)
    bloom(charge, np.full_like(charge, 100.0))
    assert charge.sum(axis=0) == pytest.approx(before, rel=1e-14)
    assert (charge[:, 0] == 10.0).all()
    assert charge[:, 1] == pytest.approx(charge[::-1, 1][np.arange(-1, 199)], abs=1e-9)  # about 100
    charge = np.full((5, 1), 0.0)
    charge[2] = 1e6
    bloom(charge, np.full_like(charge, 100.0))
    assert (charge == 100.0).all()


@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize("cleared", [True, False])
def test_smear_against_moving_charge(up: bool, cleared: bool) -> None:
    """Packets that are moved row by row, before the exposure (when not cleared) and after it."""
    rng = np.random.default_rng(1)
    rate, n, transfer, exposure = rng.uniform(0, 50, (23, 4)), 23, 0.3, 2.0
    packets = np.zeros((n, 4))
    for y in range(n):
        way = range(y) if up else range(n - 1, y, -1)
        for row in [] if cleared else way:  # moving in, from where the store is not
            packets[y] += rate[row] * transfer / n
        packets[y] += rate[y] * exposure
        for row in range(y + 1, n) if up else range(y - 1, -1, -1):  # and out
            packets[y] += rate[row] * transfer / n
    light = rate * exposure
    got = light + smear_e(light, exposure, transfer, up, cleared)
    assert got == pytest.approx(packets, rel=1e-12)


def test_lag_conserves_charge_and_forgets() -> None:
    rng = np.random.default_rng(2)
    frames = [rng.uniform(0, 100, (4, 5)) for _ in range(9)]
    kept, reads = np.zeros((4, 5)), []
    for k in range(9):
        total = frames[k] + kept
        kept = 0.07 * total
        reads.append(total - kept)
        assert lagged_e(frames[: k + 1], 0.07) == pytest.approx(reads[-1], rel=1e-12)
    assert sum(reads) + kept == pytest.approx(sum(frames), rel=1e-12)
    n = lag_frames(0.07, 1e5, 0.01)
    assert 0.07 ** (n + 1) * 1e5 <= 0.01 < 0.07**n * 1e5
    recent = lagged_e([np.full((1, 1), 1e5)] * (n + 1), 0.07)
    for_ever = lagged_e([np.full((1, 1), 1e5)] * 60, 0.07)
    assert for_ever - recent == pytest.approx(0.0, abs=0.01)


@settings(max_examples=100)
@given(st.lists(st.floats(0.1, 10), min_size=2, max_size=8), st.floats(0, 100))
def test_measured_charge_and_back(steps: list[float], charge: float) -> None:
    true = np.concatenate([[0.0], np.cumsum(steps)])
    read = np.concatenate([[0.0], np.cumsum(np.sqrt(steps))])
    q = np.array([charge])
    got = measured_e(q, true, read)
    inside = q[0] <= true[-1]
    slope = (read[-1] - read[-2]) / (true[-1] - true[-2])
    expected = np.interp(q, true, read) if inside else read[-1] + slope * (q - true[-1])
    assert got == pytest.approx(expected, rel=1e-12)
    assert collected_e(got, true, read) == pytest.approx(q, rel=1e-9, abs=1e-9)


def test_patterns_have_the_statistics_asked_for() -> None:
    shape = (400, 500)
    factors = prnu(shape, 1, 0.02)
    assert factors.std() == pytest.approx(0.02, rel=0.01)
    assert factors.mean() == pytest.approx(1.0, abs=4 * 0.02 / 447)
    assert prnu((50, 50), 1, 0.5).min() >= 0.0
    assert not np.array_equal(prnu(shape, 2, 0.02), factors)
    assert np.array_equal(prnu((100, 60), 1, 0.02), factors[:100, :60])
    hot = hot_dark_e_s(shape, 3, 0.05, 200.0, 0.4)
    levels = np.log10(hot[hot > 0])
    assert levels.size == pytest.approx(1e4, abs=4 * np.sqrt(9500))
    assert stats.kstest((levels - np.log10(200.0)) / 0.4, "norm").pvalue > 1e-3
    assert np.array_equal(hot > 0, chosen(shape, 3, "hot_pixels", 0.05))
    bias = bias_pattern_dn(shape, 4, 3.0, 5.0, 2.0, 0.0, 0.0)
    rows, columns = bias.mean(axis=1), bias.mean(axis=0)
    assert rows.std() == pytest.approx(3.0, rel=0.15)
    assert columns.std() == pytest.approx(5.0, rel=0.15)
    rest = bias - rows[:, None] - columns + bias.mean()
    assert rest.std() == pytest.approx(2.0, rel=0.01)
    plane = bias_pattern_dn(shape, 4, 0.0, 0.0, 0.0, 10.0, -4.0)
    assert (plane[-1, 0] - plane[0, 0], plane[0, -1] - plane[0, 0]) == pytest.approx((10.0, -4.0))
    assert plane.mean() == pytest.approx(0.0, abs=1e-12)


def test_row_and_column_noise_are_one_draw_a_line() -> None:
    names = ("photon_noise", "read_noise", "both", "row_noise", "column_noise")
    keys = [stream_key(8, n) for n in names]
    chain = Chain(
        1.0, 0.0, None, 0.0, 1e-3, 1e6, 32, photon_noise=False, row_noise_e=3.0, column_noise_e=7.0
    )
    dn = to_dn(np.full((300, 400), 50.0), chain, StreamPlace(0, 0, 2, *keys)).astype(float)
    signal = (dn - 1e6) * 1e-3 - 50.0
    rows, columns = signal.mean(axis=1), signal.mean(axis=0)
    assert signal == pytest.approx(rows[:, None] + columns - signal.mean(), abs=2e-3)
    assert rows.std() == pytest.approx(3.0, rel=0.15)
    assert columns.std() == pytest.approx(7.0, rel=0.15)
    part = to_dn(np.full((30, 40), 50.0), chain, StreamPlace(100, 200, 2, *keys))
    assert np.array_equal(part, dn[100:130, 200:240])
    later = to_dn(np.full((300, 400), 50.0), chain, StreamPlace(0, 0, 3, *keys))
    assert not np.array_equal(later, dn)


def test_bad_pixels_come_last() -> None:
    bad = np.array([1, 2]), np.array([0, 3]), np.array([255, 7])
    chain = Chain(1.0, 0.0, None, 0.0, 1.0, 10.0, 8, photon_noise=False, bad=bad)
    place = StreamPlace(0, 0, 0, (1, 2), (3, 4), (5, 6))
    dn = to_dn(np.full((4, 4), 50.0), chain, place)
    assert (dn[1, 0], dn[2, 3]) == (255, 7)
    assert (np.delete(dn.ravel(), [4, 11]) == 60).all()


@pytest.mark.parametrize("rounding", ["half_even", "floor"])
def test_calibration_gives_the_light_back(rounding: str) -> None:
    rng = np.random.default_rng(3)
    light, flat = rng.uniform(0, 5e4, (40, 50)), rng.uniform(0.7, 1.2, (40, 50))
    flat[3, 4] = 0.0
    table = np.array([0.0, 2e4, 8e4]), np.array([0.0, 1.9e4, 7e4])
    bad = np.array([5]), np.array([6]), np.array([0])
    chain = Chain(
        flat, rng.uniform(0, 90, (40, 50)), None, 0.0, rng.uniform(0.01, 0.02, (40, 50)),
        rng.uniform(90, 110, (40, 50)), 32, rounding, False, linearity=table, bad=bad,
    )  # fmt: skip
    dn = to_dn(light * flat + chain.dark_e, chain, StreamPlace(0, 0, 0, (1, 2), (3, 4), (5, 6)))
    got = calibrated_e(dn, chain)
    assert np.array_equal(np.argwhere(np.isnan(got)), [[3, 4], [5, 6]])
    good = np.isfinite(got)
    assert got[good] == pytest.approx(light[good], abs=0.03)


@pytest.mark.parametrize("way", [0.0, 0.3, 1.0, 2.7, 6.0, 11.0, 50.0])
def test_charge_meets_what_it_passes(way: float) -> None:
    """Followed in small steps of time; over all rows it is the mean of each column."""
    image = np.random.default_rng(3).uniform(0.5, 2.0, (12, 4))
    at = np.arange(12)[:, None] + way * ((np.arange(40_000) + 0.5) / 40_000 - 0.5)
    on, row = (at > -0.5) & (at < 11.5), np.clip(np.rint(at), 0, 11).astype(int)
    expected = np.stack([image[row[k][on[k]]].mean(axis=0) for k in range(12)])
    for rate in (way / 2.0, -way / 2.0):
        found = passed_means(image, rate, 2.0)
        assert found == pytest.approx(expected, rel=2e-3)
    if way >= 24.0:
        assert found == pytest.approx(np.tile(image.mean(axis=0), (12, 1)), rel=1e-12)


def test_order_of_the_extras() -> None:
    """Cosmic rays, full well, non-linearity, read noise, lines: by hand, over bands of rows."""
    rng = np.random.default_rng(9)
    names = ("photon_noise", "read_noise", "both", "row_noise", "column_noise")
    keys = [stream_key(3, n) for n in names]
    table = np.array([0.0, 500.0, 3000.0]), np.array([0.0, 450.0, 2000.0])
    mean, rays = rng.uniform(0, 900, (100, 700)), rng.uniform(0, 600, (100, 700))
    chain = Chain(1.0, 0.0, 1100.0, 5.0, 0.5, 200.0, 32, linearity=table, row_noise_e=3.0,
                  column_noise_e=2.0)  # fmt: skip
    made = to_dn(mean, chain, StreamPlace(7, 11, 4, *keys), rays)
    charge = np.minimum(poisson_image(mean, 7, 11, 4, *keys[0]) + rays, 1100.0)
    signal = np.interp(charge, *table) + 5.0 * standard_normals(100, 700, 7, 11, 4, *keys[1])
    signal += 3.0 * standard_normals(100, 1, 7, 0, 4, *keys[3])
    signal += 2.0 * standard_normals(1, 700, 0, 11, 4, *keys[4])
    assert np.array_equal(made, np.clip(np.rint(signal / 0.5 + 200.0), 0, None))


def test_noise_below_the_first_point_goes_on_with_its_line() -> None:
    true, read = np.array([10.0, 60.0, 100.0]), np.array([5.0, 45.0, 70.0])
    got = collected_e(np.array([-35.0, 5.0, 45.0, 95.0]), true, read)
    assert got == pytest.approx([10.0 - 50.0, 10.0, 60.0, 100.0 + 40.0])


@pytest.mark.parametrize("flat", [1.0, np.ones((9, 5))])
def test_bad_pixels_of_some_rows_are_counted_from_the_first_of_them(flat):
    """Whether anything else of the sensor is a map or not."""
    bad = np.array([1, 4, 6, 8]), np.array([0, 1, 2, 3]), np.array([10, 20, 30, 40])
    some = Chain(flat, 0.0, None, 0.0, 1.0, 10.0, 8, bad=bad).of_rows(slice(4, 8))
    assert [one.tolist() for one in some.bad] == [[0, 2], [1, 2], [20, 30]]
    assert np.ndim(flat) == 0 or some.flat.shape == (4, 5)
