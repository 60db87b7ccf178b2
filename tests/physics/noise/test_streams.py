"""Random streams against published answers and exact distributions."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from scipy import special, stats

from pipeline.physics.noise.pixel_draws import inverted_poisson
from pipeline.physics.noise.runs import quantiles
from pipeline.physics.noise.streams import (
    normal_quantile,
    philox,
    poisson,
    poisson_image,
    standard_normals,
    stream_key,
    uniform,
)

ONES = 0xFFFFFFFF


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((ONES,) * 4, (ONES,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_against_random123_known_answers(
    counter: tuple[int, ...], key: tuple[int, ...], expected: tuple[int, ...]
) -> None:
    """Philox4x32-10 vectors of Random123 (Salmon et al. 2011, SC '11)."""
    assert tuple(int(w) for w in philox(*counter, *key)) == expected


def test_limits_uniform_never_reaches_its_ends() -> None:
    assert float(uniform(0, 0)) == 2.0**-53
    assert float(uniform(ONES, ONES)) == 1.0 - 2.0**-53
    assert np.isfinite(normal_quantile(float(uniform(0, 0))))
    assert np.isfinite(normal_quantile(float(uniform(ONES, ONES))))


@njit
def _quantiles(p):  # type: ignore[no-untyped-def]
    return np.array([normal_quantile(v) for v in p])


def test_against_scipy_normal_quantile() -> None:
    low = np.concatenate([np.logspace(-300, -1, 6000), np.linspace(1e-3, 0.5, 4001)])
    exact = special.ndtri(low)
    error = np.abs(_quantiles(low) - exact) / np.maximum(np.abs(exact), 1e-3)
    assert error.max() < 2e-14
    high = 1.0 - np.logspace(-16, -1, 2000)
    high = high[high < 1.0]
    error = np.abs(_quantiles(high) / special.ndtri(high) - 1.0)
    assert error.max() < 2e-14
    edges = np.array([0.075, 0.925, np.exp(-25.0)])  # where the three forms meet
    for e in edges:
        near = _quantiles(np.array([np.nextafter(e, 0), e, np.nextafter(e, 1)]))
        assert np.ptp(near) < 1e-14


def test_runs_of_quantiles_against_scipy() -> None:
    """A run works out the middle's form for all of its pixels; those beyond it come anew."""
    p = np.r_[np.linspace(1e-3, 0.999, 500), np.nextafter(0.075, [0, 1]), 1e-300, 1.0 - 2.0**-53]
    out = np.empty(len(p))
    quantiles(len(p), p, out)
    assert np.abs(out - special.ndtri(p)).max() < 1e-13


def test_standard_normals_are_normal() -> None:
    draws = standard_normals(700, 700, 0, 0, 3, *stream_key(5, "read_noise")).ravel()
    assert stats.kstest(draws, "norm").pvalue > 1e-3
    n = draws.size
    assert abs(draws.mean()) < 4 / np.sqrt(n)
    assert abs(draws.var() - 1) < 4 * np.sqrt(2 / n)
    assert abs((draws**4).mean() - 3) < 4 * np.sqrt(96 / n)


MEANS = [1e-12, 1e-3, 0.5, 5.0, 9.99, 10.0, 10.01, 50.0, 1e3, 1e6, 9.9e7, 1.1e8, 1e12]


@pytest.mark.parametrize("mean", MEANS)
def test_against_scipy_poisson(mean: float) -> None:
    """Chi-square over about 60 equally likely bins, and the first two moments."""
    n = 640_000
    draws = poisson_image(np.full((800, 800), mean), 0, 0, 1, *stream_key(11, "photon")).ravel()
    assert (draws >= 0).all()
    assert (draws == np.rint(draws)).all()
    kurtosis = 3.0 + 1.0 / mean
    assert abs(draws.mean() - mean) < 4.5 * np.sqrt(mean / n) + 1e-16 * mean
    assert abs(draws.var() - mean) < 4.5 * mean * np.sqrt((kurtosis - 1) / n) + 1e-9 * mean
    law = stats.poisson(mean) if mean < 1e9 else stats.norm(mean, np.sqrt(mean))
    edges = np.unique(np.rint(law.ppf(np.linspace(0, 1, 61)[1:-1])))
    share = np.diff(np.concatenate([[0.0], law.cdf(edges), [1.0]]))
    seen = np.bincount(np.searchsorted(edges, draws, side="left"), minlength=share.size)
    enough = share * n > 5
    if enough.sum() > 1:
        rest = share[~enough].sum() * n
        expected = np.append(share[enough] * n, rest) if rest > 0 else share[enough] * n
        found = np.append(seen[enough], seen[~enough].sum()) if rest > 0 else seen[enough]
        found = found * (expected.sum() / found.sum())
        assert stats.chisquare(found, expected).pvalue > 1e-3
    else:
        assert (draws > 1).sum() == 0


def test_against_scipy_poisson_tails() -> None:
    """Events of 1e-3 to 1e-5 on both sides of the mean come as often as they should."""
    n = 1_000_000
    for mean in (3.0, 12.0, 200.0, 1e5):
        draws = poisson_image(np.full((1000, 1000), mean), 0, 0, 2, *stream_key(1, "tails"))
        for p in (1e-3, 1e-4, 2e-5):
            low, high = stats.poisson.ppf(p, mean), stats.poisson.isf(p, mean)
            for seen, chance in (
                ((draws < low).sum(), stats.poisson.cdf(low - 1, mean)),
                ((draws > high).sum(), stats.poisson.sf(high, mean)),
            ):
                assert abs(seen - n * chance) <= 4.5 * np.sqrt(n * chance) + 1


def test_limits_poisson_of_nothing_and_at_the_switches() -> None:
    key = stream_key(0, "x")
    for mean in (0.0, 1e-300, 5e-324):
        assert (poisson_image(np.full((50, 50), mean), 0, 0, 0, *key) == 0).all()
    for mean in (np.nextafter(10.0, 0), 10.0, 1e8, np.nextafter(1e8, 1e9), 1e15, 9e18, 1e30):
        draws = poisson_image(np.full((60, 60), mean), 0, 0, 0, *key)
        assert np.isfinite(draws).all()
        assert abs(draws.mean() - mean) < 5 * np.sqrt(mean / 3600) + 1e-15 * mean


def test_neighbours_frames_and_components_are_uncorrelated() -> None:
    n = 300
    a = standard_normals(n, n, 0, 0, 0, *stream_key(7, "read_noise"))
    others = [
        standard_normals(n, n, 0, 0, 1, *stream_key(7, "read_noise")),
        standard_normals(n, n, 0, 0, 0, *stream_key(7, "photon_noise")),
        standard_normals(n, n, 0, 0, 0, *stream_key(8, "read_noise")),
        a.T,
    ]
    limit = 4.5 / n
    for b in others[:3]:
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < limit
    off = ~np.eye(n, dtype=bool)
    assert abs(np.corrcoef(a[off], others[3][off])[0, 1]) < 1.5 * limit
    for dy, dx in ((0, 1), (1, 0), (1, 1), (0, 64), (32, 0)):
        b = np.roll(a, (dy, dx), (0, 1))
        assert abs((a * b).mean()) < limit
    p = poisson_image(np.full((n, n), 40.0), 0, 0, 0, *stream_key(7, "photon_noise"))
    assert abs(np.corrcoef(a.ravel(), p.ravel())[0, 1]) < limit
    assert abs(np.corrcoef(p[:, 1:].ravel(), p[:, :-1].ravel())[0, 1]) < limit


def test_keys_of_components_and_seeds_differ() -> None:
    keys = {stream_key(s, c) for s in (0, 1, 2**63 - 1) for c in ("photon_noise", "read_noise", "")}
    assert len(keys) == 9
    assert all(0 <= w <= ONES for k in keys for w in k)


def test_same_draws_in_every_rectangle() -> None:
    """Also in those of a frame that is wider than the runs that are drawn together."""
    rng = np.random.default_rng(2)
    mean = 10 ** rng.uniform(-2, 9, (70, 1100))
    key = stream_key(3, "photon_noise")
    whole = poisson_image(mean, 100, 200, 5, *key)
    normals = standard_normals(70, 1100, 100, 200, 5, *key)
    for y0, y1, x0, x1 in ((0, 70, 0, 1100), (0, 1, 0, 1), (33, 50, 41, 90), (69, 70, 700, 1088)):
        part = np.ascontiguousarray(mean[y0:y1, x0:x1])
        assert (poisson_image(part, 100 + y0, 200 + x0, 5, *key) == whole[y0:y1, x0:x1]).all()
        rest = standard_normals(y1 - y0, x1 - x0, 100 + y0, 200 + x0, 5, *key)
        assert (rest == normals[y0:y1, x0:x1]).all()
    row = [poisson(m, 200 + x, 104, 5, *key) for x, m in enumerate(mean[4])]
    assert np.array_equal(whole[4], row)  # as a number by itself, which cosmic rays take


def test_same_draws_elsewhere_when_one_pixel_changes() -> None:
    mean = np.full((40, 40), 25.0)
    key = stream_key(3, "photon_noise")
    before = poisson_image(mean, 0, 0, 0, *key)
    mean[13, 17] = 4e6
    after = poisson_image(mean, 0, 0, 0, *key)
    assert np.argwhere(before != after).tolist() == [[13, 17]]


@pytest.mark.parametrize("mean", [1e-3, 0.4, 3.0, 9.99])
def test_few_counts_are_the_inverse_of_their_distribution_to_its_far_end(mean: float) -> None:
    for u in (1e-9, 0.3, 0.9, 1.0 - 1e-4, 1.0 - 1e-7, 1.0 - 1e-11):
        assert inverted_poisson(mean, u) == stats.poisson.ppf(u, mean)
