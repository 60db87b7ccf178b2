"""One draw for photon and read noise: its distribution against exact sums and counts of draws."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from scipy import stats

from pipeline.physics.noise.joint import (
    ABOVE_E,
    ANY_READ_E,
    DISTANCE,
    READ_E,
    joint_quantile,
    measured_image,
    serves,
)
from pipeline.physics.noise.streams import poisson_image, standard_normals, stream_key
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from tests.spec.test_limits import BASE

KEYS = tuple(stream_key(3, name) for name in ("both", "photon_noise", "read_noise"))
FULL = np.full((1, 4096), np.inf)


def distribution(x: np.ndarray, mean: float, read: float) -> np.ndarray:
    """P(Poisson(mean) + Normal(0, read) < x): the sum over electrons, all that count."""
    n = np.arange(*stats.poisson.interval(1.0 - 1e-15, mean) + np.array([0.0, 2.0]))
    return np.sum(stats.poisson.pmf(n, mean) * stats.norm.cdf((x[:, None] - n) / read), axis=1)


MEANS = (0.0, 1e-3, 0.3, 2.0, 3.7, 5.0, 7.0, ABOVE_E, 11.3, 30.0, 1e3, 1e5)
READS = (READ_E, 2.0, ANY_READ_E, 3.0, 5.0, 40.0)


@pytest.mark.parametrize(
    ("mean", "read"), [(m, r) for m in MEANS for r in READS if serves.py_func(m, r)]
)
def test_against_exact_distribution(mean: float, read: float) -> None:
    """Within what is stated, largest at both limits at once; tails of 1e-6 to a fifth."""
    z = np.linspace(-5.5, 5.5, 441)
    x = np.array([joint_quantile(float(v), mean, read) for v in z])
    assert (np.diff(x) > 0).all()
    found, asked = distribution(x, mean, read), stats.norm.cdf(z)
    assert np.abs(found - asked).max() <= DISTANCE
    if mean == ABOVE_E and read == READ_E:
        assert np.abs(found - asked).max() > 0.9 * DISTANCE
    for z1 in (-4.75, 4.75):
        x1 = joint_quantile(z1, mean, read)
        tail = distribution(np.array([x1]), mean, read)[0]
        assert (tail if z1 < 0 else 1.0 - tail) == pytest.approx(stats.norm.cdf(-4.75), rel=0.25)


def draws(mean: float, read: float, frame: int, side: int = 1000) -> np.ndarray:
    means, reads = np.full((side, side), mean), np.full((1, side), read)
    none, well = np.zeros((1, side)), FULL[:, :side]
    return measured_image(means, none, well, reads, 0, 0, frame, *KEYS).ravel()


def too_far(counts: np.ndarray, edges: np.ndarray, mean: float, read: float) -> np.ndarray:
    """Bins whose counts are beyond 5 of their own deviations and what is stated."""
    share = np.diff(distribution(edges, mean, read))
    total = counts.sum()
    allowed = 5.0 * np.sqrt(np.maximum(share * total, 1.0)) + 2.0 * DISTANCE * total
    return np.flatnonzero(np.abs(counts - share * total) > allowed)


@pytest.mark.parametrize(("mean", "read"), [(10.0, 1.5), (1.0, 2.5), (57.0, 3.0), (4e4, 9.0)])
def test_counts_of_draws(mean: float, read: float) -> None:
    counted(mean, read, 2)


def counted(mean: float, read: float, frames: int) -> None:
    edges = mean + np.hypot(np.sqrt(mean), read) * np.linspace(-6.0, 6.5, 51)
    counts = sum(np.histogram(draws(mean, read, f), edges)[0] for f in range(frames))
    assert not too_far(counts, edges, mean, read).size


@pytest.mark.slow
@pytest.mark.parametrize(("mean", "read"), [(10.0, 1.5), (100.0, 5.0)])
def test_counts_of_a_thousand_million_draws(mean: float, read: float) -> None:
    counted(mean, read, 1000)


def test_neighbours_are_uncorrelated() -> None:
    """Two pixels side by side share a block of random words; every pair of them is independent."""
    image = draws(50.0, 4.0, 1).reshape(1000, 1000)
    image = (image - image.mean()) / image.std()
    pairs = {
        "within a block": (image[:, 0::2], image[:, 1::2]),
        "of two blocks": (image[:, 1:-1:2], image[:, 2::2]),
        "of two rows": (image[1:], image[:-1]),
        "of two frames": (image, draws(50.0, 4.0, 2).reshape(1000, 1000) / np.sqrt(66.0)),
    }
    for name, (a, b) in pairs.items():
        found = float(np.mean(a * (b - b.mean())))
        assert abs(found) < 4.5 / np.sqrt(a.size), name


def test_same_bits_wherever_a_tile_begins() -> None:
    """At even and odd columns and across runs of pixels."""
    rng = np.random.default_rng(2)
    mean = rng.uniform(0.0, 60.0, (8, 1300))
    read, well = rng.uniform(1.0, 3.0, (8, 1300)), rng.uniform(30.0, 400.0, (8, 1300))
    rays = 50.0 * (rng.uniform(size=(8, 1300)) > 0.9)
    whole = measured_image(mean, rays, well, read, 5, 11, 3, *KEYS)
    for y0, x0, y1, x1 in ((0, 1, 8, 700), (3, 512, 4, 1300), (2, 513, 8, 514)):
        cut = (np.ascontiguousarray(v[y0:y1, x0:x1]) for v in (mean, rays, well, read))
        part = measured_image(*cut, 5 + y0, 11 + x0, 3, *KEYS)
        assert np.array_equal(part, whole[y0:y1, x0:x1])


@pytest.mark.parametrize(
    ("mean_e", "rays_e"),
    [*((mean, 100.0) for mean in (800.0, 990.0, 1000.0, 1400.0, 1e6)), (200.0, 700.0), (20.0, 2e4)],
)
def test_what_reaches_its_full_well_is_drawn_term_by_term(mean_e: float, rays_e: float) -> None:
    """Below, about and far beyond it, with charge of rays, or by that alone: photons, full well,
    then read noise."""
    rng = np.random.default_rng(4)
    mean = mean_e * rng.uniform(0.98, 1.02, (6, 1100))
    mean[:, ::97] = 990.0  # few pixels of a run that are not full
    rays, well = rays_e * (rng.uniform(size=mean.shape) > 0.9), np.full((1, 1100), 1000.0)
    read = np.full((1, 1100), 2.0)
    found = measured_image(mean, rays, well, read, 2, 3, 1, *KEYS)
    photons = poisson_image(mean, 2, 3, 1, *KEYS[1])
    noise = 2.0 * standard_normals(*mean.shape, 2, 3, 1, *KEYS[2])
    apart = mean + rays + 12.0 * np.sqrt(mean + 4.0) >= well
    assert apart.any()
    assert np.array_equal(found[apart], (np.minimum(photons + rays, well) + noise)[apart])


@pytest.mark.parametrize(("read_noise_e", "is_told"), [(1.49, False), (1.5, True), (2.4, True)])
def test_the_plan_says_where_pixels_take_one_draw(read_noise_e: float, is_told: bool) -> None:
    """From the read noise on of which bright ones do, though dark ones do from 2.5 e- on."""
    scene = copy.deepcopy(BASE)
    scene["sensor"] |= {"read_noise_e": read_noise_e}
    decisions = prepare(parse_scene(scene)).plan.decisions
    told = [d for d in decisions if d.component == "one_noise_draw"]
    assert (len(told) == 1) is is_told
    assert bool(serves(1e4, read_noise_e)) is is_told
