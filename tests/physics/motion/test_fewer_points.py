"""Bends in many short segments, as few points on them: the same transfer function up to a band."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.motion.points import in_fewer_points, points_along
from pipeline.physics.motion.streak import Path, curve_through, transfer

TIME = np.linspace(0.0, 1.0, 129)
SETTLING = 0.5 * np.exp(-3.0 * TIME) * np.exp(14.0j * TIME)  # x + iy [px]
ARC = 10.0 * np.exp(2.0j * TIME)
BENT = 40.0 * TIME + 1j * TIME**2
BACK = 3.0 * np.cos(6.0 * TIME) + 0j  # turns round, twice, on one line


def path_of(z: np.ndarray, merge_px: float) -> Path:
    return curve_through(z.real, z.imag, np.full(128, 1.0 / 128), merge_px)


def apart(one: Path, other: Path, band: float) -> float:
    """Largest difference of two transfer functions at frequencies up to the band."""
    f = np.linspace(-band, band, 41)
    both = [transfer(f, f, p.x_px, p.y_px, p.weight) for p in (one, other)]
    inside = np.hypot(f[:, None], f[None, :]) <= band
    return float(np.abs(both[0] - both[1])[inside].max())


@pytest.mark.parametrize("z", [SETTLING, ARC, BENT, BACK], ids=["settling", "arc", "bent", "back"])
@pytest.mark.parametrize("merge_px", [1e-3, 1e-5, 1e-8])
@pytest.mark.parametrize("band", [0.5, 2.0])
def test_as_the_segments_that_they_stand_for(z: np.ndarray, merge_px: float, band: float) -> None:
    path = path_of(z, merge_px)
    few = in_fewer_points(path, band)
    assert few.weight.sum() == pytest.approx(1.0, abs=1e-12)
    # asked for in four directions at the band: a little more may be found elsewhere
    assert apart(path, few, band) <= 2.0 * max(1e-9, 0.5 * np.pi * band * path.off_px)
    if few is not path:
        assert 2 * np.count_nonzero(few.weight) <= path.segments


def test_far_fewer_where_the_image_is_smooth() -> None:
    path = path_of(SETTLING, 1e-6)
    assert path.segments > 900
    assert np.count_nonzero(in_fewer_points(path, 1.0).weight) < 50


def test_a_smooth_curve_is_met_as_well_as_by_its_segments() -> None:
    """Against 65,536 segments of the curve itself, no worse than the path that was asked for."""
    fine = np.linspace(0.0, 1.0, 65_537)
    z = 0.5 * np.exp(-3.0 * fine) * np.exp(14.0j * fine)
    true = Path(z.real, z.imag, np.full(65_536, 1.0 / 65_536))
    path = path_of(SETTLING, 1e-6)
    for band in (0.5, 1.5):
        few = in_fewer_points(path, band)
        assert apart(true, few, band) <= 2.0 * apart(true, path, band) + 1e-9


def test_corners_and_few_segments_are_kept() -> None:
    rng = np.random.default_rng(3)
    walk = np.cumsum(rng.normal(0.0, 0.05, (2, 129)), axis=1)
    path = path_of(walk[0] + 1j * walk[1], 1e-5)
    assert path.off_px == 1e-5  # a random walk is no curve
    assert apart(path, in_fewer_points(path, 1.0), 1.0) <= 1e-5 * np.pi
    short = path_of(TIME + 0j, 1e-3)
    assert in_fewer_points(short, 1.0) is short


def test_points_of_points_are_the_same() -> None:
    few = in_fewer_points(path_of(SETTLING, 1e-6), 1.0)
    x, y, share = points_along(few, 1.0)
    np.testing.assert_array_equal(x, few.x_px[:-1][few.weight > 0.0])
    np.testing.assert_array_equal(y, few.y_px[:-1][few.weight > 0.0])
    np.testing.assert_array_equal(share, few.weight[few.weight > 0.0])


@pytest.mark.parametrize("band", [0.5, 1.5])
def test_few_long_segments_of_a_bend_share_their_points(band: float) -> None:
    """Some segments of 2 px: far fewer points than each of them by itself asks for."""
    path = path_of(BENT, 1e-3)
    assert 6 <= path.segments < 32
    x, y, share = points_along(path, band)
    weight = np.zeros(2 * len(share) - 1)
    weight[::2] = share
    few = Path(np.repeat(x, 2), np.repeat(y, 2), weight)
    assert apart(path, few, band) <= 2.0 * max(1e-9, 0.5 * np.pi * band * path.off_px)
    assert share.sum() == pytest.approx(1.0, abs=1e-12)
    x_px, y_px = path.x_px, path.y_px
    cut = [slice(i, i + 2) for i in range(path.segments)]
    alone = [Path(x_px[at], y_px[at], np.ones(1)) for at in cut]
    assert len(x) < 0.6 * sum(len(points_along(one, band)[0]) for one in alone)
