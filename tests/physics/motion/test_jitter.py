"""Jitter: spectra against their integrals, runs against periodograms, bounds against sums."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from scipy.integrate import quad
from scipy.signal import welch

from pipeline.physics.motion import jitter
from pipeline.physics.motion.jitter import bend_variance, bins_of, fast_part, waves

SPECTRA = {
    "white": jitter.white(0.7, 0.1, 50.0),
    "flicker": jitter.power_law(0.7, 1.0, 0.01, 100.0),
    "resonance": jitter.resonance(0.7, 3.0, 0.01),
    "table": jitter.table(np.array([0.1, 1.0, 10.0]), np.array([0.3, 0.03, 3e-4])),
}


def drawn(name: str, split_hz: float = 8.0, seed: int = 1) -> jitter.Waves:
    bins = bins_of(SPECTRA[name], split_hz)
    rng = np.random.default_rng(seed)
    n = len(bins.variance)
    return waves(bins, split_hz, rng.standard_normal((n, 4)), rng.random(n))


@pytest.mark.parametrize("name", ["white", "flicker", "resonance"])
def test_all_variance_is_there(name: str) -> None:
    assert bins_of(SPECTRA[name], 8.0).variance.sum() == pytest.approx(0.49, rel=1e-4)


def test_against_quadrature_of_each_spectrum() -> None:
    for name, one in SPECTRA.items():
        bins = bins_of(one, 8.0)
        fast = bins.variance[bins.edge_hz[:-1] >= 8.0].sum()
        scale = 1.0
        points = [k for k in one.knots_hz if one.low_hz < k < one.high_hz] or None
        if one.rms_rad is not None:
            scale = one.rms_rad**2 / quad(one.density, one.low_hz, one.high_hz, limit=500)[0]

        def density(f: float, s: jitter.Spectrum = one) -> float:
            return float(s.density(np.array([f]))[0])

        top = min(one.high_hz, 1000.0)
        inside = [p for p in points or [] if 8.0 < p < top][:40] or None
        expected = scale * quad(density, 8.0, top, points=inside, limit=500)[0]
        assert fast == pytest.approx(expected, rel=1e-3), name


@pytest.mark.parametrize("name", SPECTRA)
def test_against_the_periodogram_of_a_run(name: str) -> None:
    """The density of a long run, averaged over octaves and three seeds, is the one asked for."""
    rate, t = 40.0, np.arange(4096) / 40.0
    x = np.concatenate([drawn(name, seed=s).at(t) for s in range(3)], axis=1)
    f, found = welch(x, rate, nperseg=1024, axis=0)
    found = found.mean(axis=1)
    one = SPECTRA[name]
    bins = bins_of(one, 8.0)
    for low in (0.5, 1.0, 2.0, 4.0):
        mine = (f >= low) & (f < 2.0 * low)
        power = found[mine].sum() * (f[1] - f[0])
        inside = (bins.middle_hz >= low) & (bins.middle_hz < 2.0 * low)
        assert power == pytest.approx(bins.variance[inside].sum(), rel=0.45, abs=2e-3), low


@pytest.mark.parametrize(("low_hz", "high_hz"), [(5.0, 5.1), (1.0, 10.0), (0.05, 20.0)])
def test_each_run_has_the_rms_asked_for(low_hz: float, high_hz: float) -> None:
    """Over a long time, on both axes; at one moment the runs are Gaussian among themselves."""
    bins = bins_of(jitter.white(0.7, low_hz, high_hz), 100.0)
    t, moment = np.arange(0.0, 4000.0, 0.0713), []
    for seed in range(600):
        rng, n = np.random.default_rng(seed), len(bins.variance)
        run = waves(bins, 100.0, rng.standard_normal((n, 4)), rng.random(n))
        moment.append(run.at(np.array([12.3]))[0])
        if seed < 3:
            assert run.at(t).std(axis=0) == pytest.approx(0.7, rel=0.02)
    assert np.std(moment, axis=0) == pytest.approx(0.7, rel=0.1)
    assert scipy.stats.kurtosis(moment, axis=0, fisher=False) == pytest.approx(3.0, abs=0.8)


@pytest.mark.parametrize("name", SPECTRA)
def test_blur_leaves_out_no_more_than_it_says(name: str) -> None:
    """Brute force: means and variances over exposures of many runs of the fast part alone."""
    one, split_hz, time = SPECTRA[name], 4.0, 1.0
    bins = bins_of(one, 1e-9)
    keep = (bins.edge_hz[:-1] >= split_hz) & (bins.middle_hz < 60.0)
    t = (np.arange(1024) + 0.5) / 1024
    means, spreads = [], []
    f, size = bins.middle_hz[keep], np.sqrt(bins.variance[keep])
    cosines, sines = np.cos(2 * np.pi * f[:, None] * t), np.sin(2 * np.pi * f[:, None] * t)
    rng = np.random.default_rng(3)
    for _ in range(200):
        x = (size * rng.standard_normal(len(f))) @ cosines
        x = x + (size * rng.standard_normal(len(f))) @ sines
        means.append(x.mean())
        spreads.append((x**2).mean())
    part = fast_part(bins_of(one, split_hz), split_hz, time)
    assert 0.2 * part.mean_variance < np.var(means) <= part.mean_variance * 1.05
    assert np.mean(spreads) == pytest.approx(np.sum(size**2), rel=0.1)
    assert np.std(spreads) / np.mean(spreads) == pytest.approx(part.scatter, rel=0.35)


@pytest.mark.parametrize("step", [1.0 / 64.0, 1.0 / 256.0])
def test_how_far_waves_are_from_straight_lines(step: float) -> None:
    """Against runs: the mean square of what is between a polyline through the nodes and them."""
    one, split_hz, fine = SPECTRA["white"], 8.0, 16
    share, off = np.arange(fine) / fine, []
    for seed in range(60):
        x = drawn("white", seed=seed).at(np.arange(256 * fine + 1) * step / fine)
        nodes, between = x[::fine], x[:-1].reshape(256, fine, 2)
        line = nodes[:-1, None] + share[:, None] * (nodes[1:] - nodes[:-1])[:, None]
        off.append(((between - line) ** 2).mean())
    expected = bend_variance(bins_of(one, split_hz), split_hz, step)
    assert np.mean(off) == pytest.approx(expected, rel=0.1)


def test_limits_of_tables() -> None:
    empty = jitter.table(np.array([1.0, 2.0]), np.zeros(2))
    assert fast_part(bins_of(empty, 1.5), 1.5, 1.0).variance == 0.0
    assert bins_of(SPECTRA["white"], 1e-6).edge_hz[0] == 0.1
    assert fast_part(bins_of(SPECTRA["white"], 1e-6), 1e-6, 1.0).variance == pytest.approx(0.49)
