"""The screen over many satellites misses none that brute force finds, and keeps few others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sgp4.api import Satrec, SatrecArray

from benchmarks.targets import EPOCH, fixed, population, site
from pipeline.physics.positions.earth import teme_to_gcrs
from pipeline.physics.positions.orbit_screen import screen_cone
from pipeline.physics.positions.orbit_sgp4 import satellite_states, tle_satellite
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.vectors import separation, unit

COUNT, DWELL_S, STEP_S = 1500, 300.0, 0.5


@pytest.fixture(scope="module")
def sky() -> tuple[list, np.ndarray, np.ndarray]:
    """Satellites, their GCRS places (m, n, 3) at fine steps, and directions from the site."""
    satellites = population(COUNT, seed=3)
    at = instants(parse_utc(EPOCH), times())
    _, place, _ = SatrecArray(satellites).sgp4(at.utc1, at.utc2)
    place = np.einsum("nij,mnj->mni", teme_to_gcrs(at), place) * 1e3
    return satellites, place, unit(place - site(parse_utc(EPOCH))(times())[0])


def times() -> np.ndarray:
    return np.arange(0.0, DWELL_S + STEP_S, STEP_S)


@settings(max_examples=25)
@given(
    st.floats(0.0, 2 * np.pi), st.floats(-1.2, 1.5), st.floats(0.001, 0.5), st.floats(0.0, 2e-3)
)  # fmt: skip
def test_against_brute_force(
    sky: tuple, azimuth: float, height: float, half_angle: float, turn: float
) -> None:
    """Any direction, any cone, a boresight that stays or scans."""
    satellites, _, directions = sky
    epoch = parse_utc(EPOCH)
    axis = np.array([
        np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)
    ])  # fmt: skip
    side = unit(np.cross(axis, [0.3, 0.2, 0.9]))

    def boresight(at_s: np.ndarray) -> np.ndarray:
        angle = turn * np.asarray(at_s)[:, None]
        return np.cos(angle) * axis + np.sin(angle) * side

    observer = site(epoch)
    found = screen_cone(satellites, epoch, DWELL_S, observer, boresight, half_angle, turn)
    cosine = np.einsum("mni,ni->mn", directions, boresight(times())).max(axis=1)
    closest = np.arccos(np.minimum(cosine, 1.0))
    inside = set(found.inside)
    assert set(np.flatnonzero(closest <= half_angle)) <= inside
    extra = closest[list(inside)] - half_angle if inside else np.zeros(1)
    assert extra.max() < 0.05  # what 0.25 s of motion can hide, near and fast at the worst
    assert not len(found.failed)


def test_few_are_kept_in_vain(sky: tuple) -> None:
    satellites, place, _ = sky
    epoch = parse_utc(EPOCH)
    up = unit(site(epoch)(np.zeros(1))[0])[0]
    found = screen_cone(satellites, epoch, DWELL_S, site(epoch), lambda t: fixed(up, t), 0.3)
    at_s = np.arange(0.0, DWELL_S + STEP_S, STEP_S)
    closest = separation(place - site(epoch)(at_s)[0], up).min(axis=1)
    assert len(found.inside) <= 1.1 * np.sum(closest <= 0.3) + 2


def decaying(drag: str = "99999-1") -> Satrec:
    """An object in the upper air, whose elements end within minutes, or an hour."""
    line1 = f"1 25544U 98067A   19110.12345678  .00001000  00000-0  {drag} 0  999"
    line2 = "2 25544  51.6400 100.0000 0002000  80.0000 280.0000 16.7000000016600"

    def checked(line: str) -> str:
        return line + str(sum(int(c) if c.isdigit() else c == "-" for c in line) % 10)

    return tle_satellite(checked(line1), checked(line2))


def test_limits_decayed_elements_are_named() -> None:
    epoch = parse_utc("2019-05-20T00:00:00Z")
    found = screen_cone(
        [decaying(), *population(3)], epoch, 60.0, site(epoch),
        lambda t: fixed(np.array([1.0, 0, 0]), t), 0.01,
    )  # fmt: skip
    assert 0 in found.failed
    assert 0 not in found.inside


def test_one_that_ends_after_it_was_inside_is_named_as_ended_alone() -> None:
    """SGP4 serves it for the first half of the dwell, of all the sky around."""
    bad, dwell_s = decaying("50000-3"), 1800.0
    days = np.arange(0.0, 0.1, 1.0 / 86400.0)
    codes = SatrecArray([bad]).sgp4(np.full(days.size, bad.jdsatepoch), bad.jdsatepochF + days)[0]
    ends = days[np.argmax(codes[0] != 0)]
    assert 0.5 * dwell_s / 86400.0 < ends < 0.1
    epoch = bad.jdsatepoch, bad.jdsatepochF + ends - 0.5 * dwell_s / 86400.0
    found = screen_cone(
        [bad, *population(3)], epoch, dwell_s, site(epoch),
        lambda t: fixed(np.array([1.0, 0, 0]), t), 4.0,
    )  # fmt: skip
    assert found.inside.tolist() == [1, 2, 3]
    assert found.failed.tolist() == [0]


def test_what_aberration_may_bring_in_is_kept(sky: tuple) -> None:
    """20 arcsec beside a cone that ends just short of a satellite."""
    satellites, _, directions = sky
    epoch = parse_utc(EPOCH)
    for k in range(0, COUNT, 150):
        axis = unit(directions[k, 300] + [0.02, 0.01, -0.03])
        closest = np.arccos(directions[k] @ axis).min()
        found = screen_cone([satellites[k]], epoch, DWELL_S, site(epoch), lambda t, a=axis:
                            fixed(a, t), closest - 9.5e-5)  # fmt: skip
        assert list(found.inside) == [0]


def test_what_an_accelerated_observer_turns_to_is_kept() -> None:
    """It moves as the satellite does, but for 100 m/s2: seen in the cone at both ends alone."""
    satellite, epoch = population(1, seed=5)[0], parse_utc(EPOCH)
    ahead, aside = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])

    def observer(at_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place, speed = satellite_states(satellite, "one", instants(epoch, at_s))
        since = np.asarray(at_s)[:, None] - 30.0
        return place - 5e5 * ahead + 50.0 * since**2 * aside, speed + 100.0 * since * aside

    axis = unit(5e5 * ahead - 50.0 * 30.0**2 * aside)
    found = screen_cone([satellite], epoch, 60.0, observer, lambda t: fixed(axis, t), 0.01,
                        observer_pull_m_s2=110.0)  # fmt: skip
    assert list(found.inside) == [0]
