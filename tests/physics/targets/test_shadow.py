"""Limb darkening, the oblate Earth and the Moon against the plain eclipse and bundles of rays."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.constants import (
    ASTRONOMICAL_UNIT_M,
    EARTH_EQUATORIAL_RADIUS_M,
    EARTH_FLATTENING,
    SUN_RADIUS_M,
)
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.targets.eclipse import sunlit_fraction
from pipeline.physics.targets.shadow import (
    MOON_RADIUS_M,
    moon_m,
    sunlit_past_earth,
    sunlit_past_moon,
    uncovered_fraction,
)
from pipeline.physics.vectors import separation, unit
from tests.slow import slow

SUN = np.array([ASTRONOMICAL_UNIT_M, 0.0, 0.0])


def crossing(radius_m: float, latitude: float = 0.0, count: int = 25) -> np.ndarray:
    """Targets through the penumbra, in the half plane of the x axis that rises at `latitude`."""
    b, a = np.arcsin(EARTH_EQUATORIAL_RADIUS_M / radius_m), SUN_RADIUS_M / ASTRONOMICAL_UNIT_M
    d = np.linspace(b - 2.0 * a, b + 1.2 * a, count)
    up = np.array([0.0, np.cos(latitude), np.sin(latitude)])
    return radius_m * (np.cos(d)[:, None] * [-1.0, 0, 0] + np.sin(d)[:, None] * up)


def by_rays(target, sun, u, flattening, rings=400, spokes=600):
    """Share of rays from the Sun's disc that miss the ellipsoid, each weighed by its light."""
    to_sun = sun - target
    a = np.arcsin(SUN_RADIUS_M / np.linalg.norm(to_sun))
    x = (np.arange(rings) + 0.5) / rings
    p = np.arange(spokes) / spokes * 2 * np.pi + 2.4 * np.arange(rings)[:, None]
    e1 = unit(np.cross(to_sun, [0.3, 0.2, 0.9]))
    e2 = np.cross(unit(to_sun), e1)
    rho = np.arcsin(x * np.sin(a))[:, None, None]
    aside = np.cos(p)[..., None] * e1 + np.sin(p)[..., None] * e2
    scale = np.array([1, 1, 1 / (1 - flattening)])
    d = (np.cos(rho) * unit(to_sun) + np.sin(rho) * aside) * scale
    r = target * scale
    rd, dd = d @ r, np.sum(d * d, -1)
    hit = (rd < 0) & (rd * rd > dd * (r @ r - EARTH_EQUATORIAL_RADIUS_M**2))
    light = (x * (1 - u * (1 - np.sqrt(1 - x * x))))[:, None] + 0 * p
    return 1 - np.sum(light * hit) / np.sum(light)


@pytest.mark.parametrize("radius", [6.6e6, 7.2e6, 4.2164e7, 3.8e8, 2e9])
def test_same_as_the_plain_eclipse_without_options(radius) -> None:
    targets = crossing(radius)
    plain = sunlit_fraction(targets, SUN)
    assert np.max(np.abs(sunlit_past_earth(targets, SUN) - plain)) < 5e-6
    dark, far = -crossing(radius), sunlit_past_earth(-crossing(radius), SUN, 0.6, True)
    assert np.all(far == 1.0)
    assert np.all(sunlit_fraction(dark, SUN) == 1.0)


@pytest.mark.parametrize("latitude", [0.0, 1.2, *(slow(a) for a in (0.6, np.pi / 2))])
@pytest.mark.parametrize("radius", [6.9e6, 4.2164e7])
def test_against_rays(radius, latitude) -> None:
    targets = crossing(radius, latitude, 9)
    for u, oblate, bound in ((0.6, False, 1.2e-4), (0.6, True, 1.5e-4), (0.0, True, 1.5e-4)):
        ours = sunlit_past_earth(targets, SUN, u, oblate)
        flattening = EARTH_FLATTENING if oblate else 0.0
        theirs = [by_rays(t, SUN, u, flattening) for t in targets]
        assert np.max(np.abs(ours - theirs)) < bound
    round_, flat = sunlit_past_earth(targets, SUN), sunlit_past_earth(targets, SUN, 0.0, True)
    if latitude > 1:  # the pole is 21 km nearer to the axis: longer in the light
        assert np.max(flat - round_) > 0.01
        assert np.all(flat >= round_ - 1e-9)


def test_against_a_tilted_sun() -> None:
    """The Sun 23 degrees from the equator, shadow edge oblique to the ellipsoid's axes."""
    sun = ASTRONOMICAL_UNIT_M * np.array([np.cos(0.4), 0.0, np.sin(0.4)])
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    targets = crossing(6.9e6, 0.8, 11) @ turn.T
    ours = sunlit_past_earth(targets, sun, 0.3, True)
    theirs = [by_rays(t, sun, 0.3, EARTH_FLATTENING) for t in targets]
    assert np.max(np.abs(ours - theirs)) < 2e-4


def test_limits_of_the_discs() -> None:
    a = 4.65e-3
    assert uncovered_fraction(a, 1.1 * a, 0.0, 0.5)[0] == 0.0
    assert uncovered_fraction(a, 0.3, 0.3 + 1.0001 * a, 0.5)[0] == 1.0
    ring = uncovered_fraction(a, 0.95 * a, 0.0)[0]
    assert ring == pytest.approx(1 - 0.95**2, abs=1e-6)
    limb = uncovered_fraction(a, 0.95 * a, 0.0, 0.6)[0]
    assert 0.5 * ring < limb < 0.8 * ring  # the limb is darker than the disc's mean
    for u in (0.0, 0.6):
        half = uncovered_fraction(a, 1.5, 1.5, u)[0]  # a straight limb through the centre
        assert half == pytest.approx(0.5, abs=1e-4)


def test_the_moon_behind_the_sun_takes_nothing() -> None:
    """Seen from a body near the Sun the Moon stands beyond it; before it, it would hide a part."""
    target = np.array([[-0.999 * ASTRONOMICAL_UNIT_M + 4e9, 0.0, 0.0]])
    to_sun = np.array([-ASTRONOMICAL_UNIT_M, 0.0, 0.0])
    near, beyond = target[0] - [1e9, 0.0, 0.0], to_sun - [1e9, 0.0, 0.0]
    assert sunlit_past_moon(target, to_sun, beyond)[0] == 1.0
    assert sunlit_past_moon(target, to_sun, near)[0] < 1.0


def test_against_the_eclipse_of_2017() -> None:
    """2017-08-21, greatest eclipse 18:25:32 UTC at 36.97 N, 87.67 W (NASA): total there."""
    from pipeline.physics.positions.apparent import apparent_sun_m
    from pipeline.physics.positions.earth import earth_and_sun, site_state

    t = instants(parse_utc("2017-08-21T18:25:32Z"), np.array([-7200.0, -60.0, 0, 60, 7200.0]))
    site, _ = site_state(np.radians(36.97), np.radians(-87.67), 0.0, t)
    sun = apparent_sun_m(earth_and_sun(t.tt1, t.tt2))
    lit = sunlit_past_moon(site, sun, moon_m(t.tt1, t.tt2))
    np.testing.assert_array_equal(lit, [1.0, 0.0, 0.0, 0.0, 1.0])
    moon = moon_m(t.tt1, t.tt2)[2]
    assert np.linalg.norm(moon) == pytest.approx(372_000e3, rel=0.01)
    ratio = MOON_RADIUS_M / np.linalg.norm(moon - site[2])
    assert ratio > SUN_RADIUS_M / ASTRONOMICAL_UNIT_M
    assert separation(moon - site[2], sun[2] - site[2]) < 1e-3
    assert sunlit_past_moon(site[2:3], -sun[2], moon)[0] == 1.0  # Moon opposite to the Sun


@pytest.mark.parametrize("u", [0.0, 0.6])
def test_a_partial_eclipse_by_the_moon_against_points_of_the_sun(u) -> None:
    """Even points of a flat disc, each as bright as a darkened limb has it."""
    target = np.array([[-2e6, 5e6, 3e6]])
    apart, moon_m_away = 4e-3, 3.7e8
    to_sun = SUN - target[0]
    side = unit(np.cross(to_sun, [0.1, 0.2, 1.0]))
    moon = target[0] + moon_m_away * (np.cos(apart) * unit(to_sun) + np.sin(apart) * side)
    a = np.arcsin(SUN_RADIUS_M / np.linalg.norm(to_sun))
    at = (np.arange(2000) + 0.5) / 1000 - 1.0
    r2 = at[:, None] ** 2 + at**2
    light = np.where(r2 < 1.0, 1.0 - u * (1.0 - np.sqrt(np.maximum(1.0 - r2, 0.0))), 0.0)
    free = np.hypot(a * at[:, None] - apart, a * at) > np.arcsin(MOON_RADIUS_M / moon_m_away)
    found = sunlit_past_moon(target, SUN, moon[None], u)[0]
    assert found == pytest.approx((light * free).sum() / light.sum(), abs=2e-4)
    assert 0.2 < found < 0.8


@pytest.mark.parametrize("oblate", [False, True])
def test_limits_no_sunlight_inside_the_earth(oblate: bool) -> None:
    """On the night side, near the centre and near the ground."""
    places = [[-3e6, 0.0, 0.0], [-1e6, 5e6, 0.0], [-1e6, 0.0, 6.2e6]]
    assert np.all(sunlit_past_earth(np.array(places), SUN, 0.0, oblate) == 0.0)
