"""Geometry: pointing modes, windows of frames, and views that are refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import erfa
import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.physics.positions.focal_plane import project
from pipeline.plan.pointing.geometry import (
    FINE_PX,
    _geometry,
    _star_paths,
    bend_px,
    camera_of,
    check_view,
    moments_at,
    plan_geometry,
    star_paths,
    zenith_pointing,
)
from pipeline.plan.pointing.site import axes_of
from pipeline.spec.scene import Scene

Make = Callable[..., Scene]
MIDDLE = np.array([383.5]), np.array([255.5])
ARCSEC, C = np.pi / 648_000, 299_792_458.0
LEO = {
    "kind": "orbit",
    "orbit": {
        "kind": "state", "position_m": [6.9e6, 0.0, 0.0], "velocity_m_s": [0.0, 5374.0, 5374.0],
    },
}  # fmt: skip
GROUND = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055.0}
GEO_TARGET = {
    "name": "geo",
    "orbit": {
        "kind": "state", "position_m": [42164e3, 1e6, 0.0], "velocity_m_s": [-73.0, 3073.0, 50.0],
    },
    "body": {"kind": "sphere", "diameter_m": 3.0, "albedo": 0.2},
}  # fmt: skip


def every(scene: Scene) -> Any:
    return plan_geometry(scene, np.arange(scene.exposure.frames), 0.0)


def up(observer: dict[str, Any]) -> tuple[float, float]:
    """Right ascension and declination of the direction away from the Earth's centre [deg]."""
    if observer is LEO:
        return 0.0, 0.0
    jd = 2458593.5 + 3.0 / 24.0
    return float(np.degrees(erfa.gst06a(jd, 0.0, jd, 69.2 / 86400)) - 156.3) % 360.0, 20.7


@pytest.mark.parametrize("observer", [LEO, GROUND, {"kind": "fixed", "position_au": [1, 0.2, 0]}])
def test_a_star_at_the_boresight_stays_at_the_centre(scene: Make, observer: dict) -> None:
    """Against ERFA's aberration: the guided star does not move in any frame."""
    ra, dec = (40.0, 25.0) if observer["kind"] == "fixed" else up(observer)
    s = scene(
        {"observer": observer, "pointing.boresight_ra_deg": ra, "pointing.boresight_dec_deg": dec,
         "stars.deflection": False}
    )  # fmt: skip
    g, camera = every(s), camera_of(s)
    star = erfa.s2c(np.radians(ra), np.radians(dec))
    for f in range(5):
        for k in range(g.nodes):
            v = g.observer_m_s[f, k] / C
            away = np.linalg.norm(g.observer_m[f, k] - g.sun_m[f, k]) / 149_597_870_700.0
            seen = erfa.ab(star, v, away, np.sqrt(1 - v @ v))
            x, y = project(camera, g.attitude[f, k], seen[None])
            assert abs(x[0] - 383.5) < 1e-4
            assert abs(y[0] - 255.5) < 1e-4


@pytest.mark.parametrize("observer", [LEO, GROUND])
def test_the_sun_stands_where_it_does_whoever_looks(scene: Make, observer: dict) -> None:
    """Against ERFA's Earth, seen from the Sun and from the barycentre."""
    ra, dec = up(observer)
    g = every(scene({"observer": observer, "pointing.boresight_ra_deg": ra,
                     "pointing.boresight_dec_deg": dec}))  # fmt: skip
    of_sun, of_all = erfa.epv00(g.tt1, g.tt2)
    sun_m = (of_all["p"] - of_sun["p"]) * 149_597_870_700.0
    assert np.abs(g.sun_m - sun_m).max() < 1.0


@pytest.mark.parametrize("observer", [LEO, GROUND])
def test_target_tracking_keeps_the_target_at_the_centre(scene: Make, observer: dict) -> None:
    target = {**GEO_TARGET, "orbit": {**GEO_TARGET["orbit"]}}
    if observer is GROUND:
        ra, _ = up(observer)
        c, sn = np.cos(np.radians(ra)), np.sin(np.radians(ra))
        target["orbit"] |= {
            "position_m": [42164e3 * c, 42164e3 * sn, 0.0],
            "velocity_m_s": [-3074.7 * sn, 3074.7 * c, 0.0],
        }
    elsewhere = target | {"name": "other", "orbit": target["orbit"] | {
        "position_m": [1.01 * x for x in target["orbit"]["position_m"]][::-1]}}  # fmt: skip
    s = scene(
        {"observer": observer, "targets": [elsewhere, target],
         "pointing": {"mode": "target", "target": "geo"}}
    )  # fmt: skip
    g = every(s)
    assert np.abs(g.target_x_px[1] - 383.5).max() < 1e-6
    assert np.abs(g.target_y_px[1] - 255.5).max() < 1e-6
    px, py = star_paths(camera_of(s), g, *MIDDLE)[:, 0]
    assert np.hypot(np.ptp(px, axis=1), np.ptp(py, axis=1)).min() > 1.0  # the stars streak


@pytest.mark.parametrize(("east", "north"), [(15.0, 0.0), (0.0, -40.0), (30.0, 40.0), (0.01, 0.0)])
def test_rate_streak_is_rate_times_time(scene: Make, east: float, north: float) -> None:
    s = scene(
        {"pointing": {"mode": "rate", "boresight_ra_deg": 40.0, "boresight_dec_deg": 60.0,
                      "rate_ra_arcsec_s": east, "rate_dec_arcsec_s": north},
         "stars.aberration": False, "stars.deflection": False}
    )  # fmt: skip
    g, camera = every(s), camera_of(s)
    px, py = star_paths(camera, g, *MIDDLE, aberration=False)[:, 0]
    length = np.hypot(px[:, -1] - px[:, 0], py[:, -1] - py[:, 0])
    expected = np.hypot(east, north) * ARCSEC * 2.0 / 1e-5
    assert np.allclose(length, expected, rtol=1e-5)
    # roll 0: +x is west, +y north; the stars run against the boresight
    assert px[0, -1] - px[0, 0] == pytest.approx(east * ARCSEC * 2.0 / 1e-5, abs=1e-3 * expected)
    assert py[0, -1] - py[0, 0] == pytest.approx(-north * ARCSEC * 2.0 / 1e-5, abs=1e-3 * expected)


def test_rate_without_motion_is_sidereal(scene: Make) -> None:
    still = scene(
        {"pointing": {"mode": "rate", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0,
                      "rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": 0.0}}
    )  # fmt: skip
    assert np.allclose(every(still).attitude, every(scene()).attitude, atol=1e-15)


def test_same_bits_in_every_window_of_frames(scene: Make) -> None:
    s = scene({"observer": LEO, "targets": [GEO_TARGET], "pointing.boresight_ra_deg": 1.0,
               "pointing.boresight_dec_deg": 0.0})  # fmt: skip
    whole = every(s)
    for frames in ([0], [4], [0, 4], [2], [1, 2, 3], [3, 0]):
        part = plan_geometry(s, np.array(frames), 0.0)
        for f in fields(part):
            axis = 1 if f.name.startswith("target_") else 0
            expected = getattr(whole, f.name).take(frames, axis=axis)
            assert np.array_equal(getattr(part, f.name), expected, equal_nan=True), f.name


def test_nodes_follow_the_cadence(scene: Make) -> None:
    g = every(scene())
    assert np.allclose(g.offset_s[:, 0], 10.0 * np.arange(5))
    assert np.allclose(g.offset_s[:, -1] - g.offset_s[:, 0], 2.0)
    assert np.allclose(g.offset_s[:, g.middle] - g.offset_s[:, 0], 1.0)
    elapsed = ((g.tt1 - g.tt1[0, 0]) + (g.tt2 - g.tt2[0, 0])) * 86400
    assert np.abs(elapsed - g.offset_s).max() < 1e-8


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"observer": LEO, "pointing.boresight_ra_deg": 180.0, "pointing.boresight_dec_deg": 0.0},
         "pointing"),
        ({"observer": GROUND, "pointing.boresight_dec_deg": -85.0}, "pointing"),
        ({"observer": {"kind": "orbit", "orbit": {
            "kind": "state", "position_m": [6e6, 0, 0], "velocity_m_s": [0, 7700, 0]}}},
         "observer.orbit.position_m"),
        ({"observer": {"kind": "orbit", "orbit": {
            "kind": "state", "position_m": [6.9e6, 0, 0], "velocity_m_s": [-7000, 0, 0]}},
          "exposure.frames": 50}, "observer.orbit"),
        ({"observer": {"kind": "fixed", "position_au": [1, 0, 0],
                       "velocity_m_s": [3e8, 0, 0]}}, "observer.velocity_m_s"),
        ({"observer": LEO, "targets": [{**GEO_TARGET, "orbit": {
            "kind": "state", "position_m": [1e3, 0, 0], "velocity_m_s": [0, 0, 0]}}]},
         "targets.0.orbit"),
        ({"epoch": "2019-13-45"}, "epoch"),
        ({"epoch": "yesterday"}, "epoch"),
        ({"observer": {"kind": "orbit", "orbit": {
            "kind": "tle",
            "line1": "1 20253U 89077A   19100.15292632 -.00000145  00000-0  00000+0 0  9995",
            "line2": "2 20253  13.0618   9.0432 0006304 343.1833 245.2641  1.00270126234281"}}},
         "observer.orbit.line1"),
        ({"targets": [{**GEO_TARGET, "orbit": {
            "kind": "ephemeris", "path": "unread.csv", "frame": "gcrs"}}]}, "targets.0.orbit.path"),
        ({"targets": [{**GEO_TARGET, "orbit": {"kind": "omm", "path": "unread.csv"}}]},
         "targets.0.orbit.path"),
    ],
)  # fmt: skip
def test_refused_views_and_orbits(scene: Make, changes: dict, field: str) -> None:
    s = scene(changes)
    with pytest.raises(BadInput) as caught:
        every(s)
    assert field in caught.value.field


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 180.0])
def test_a_horizon_is_that_of_the_ellipsoid(scene: Make, azimuth_deg: float) -> None:
    """North and south alike, where the Earth's middle is 0.19 degrees off the nadir."""
    site = {"kind": "ground", "latitude_deg": 45.0, "longitude_deg": 10.0}
    local = {"mode": "local", "azimuth_deg": azimuth_deg}
    every(scene({"observer": site, "pointing": local | {"elevation_deg": 0.1}}))
    with pytest.raises(BadInput, match=r"elevation -0\.1"):
        every(scene({"observer": site, "pointing": local | {"elevation_deg": -0.1}}))


def test_a_limb_is_that_of_the_ellipsoid(scene: Make) -> None:
    """Over a pole, from above the equator: 0.36 degrees below that of the equator's sphere."""
    speed = float(np.sqrt(3.986004418e14 / 7.2e6))
    orbit = {"kind": "state", "position_m": [7.2e6, 0, 0], "velocity_m_s": [0, speed, 0]}
    above = {"kind": "orbit", "orbit": orbit}
    limb_deg = float(np.degrees(np.arctan2(6356752.3, np.sqrt(7.2e6**2 - 6378137.0**2))))
    # of the ellipse x^2 / a^2 + z^2 / b^2 = 1, from (d, 0): tan = b / sqrt(d^2 - a^2)
    for off_deg in (0.02, -0.02):
        north = {"mode": "sidereal", "boresight_ra_deg": 180.0,
                 "boresight_dec_deg": limb_deg + off_deg}  # fmt: skip
        s = scene({"observer": above, "pointing": north, "exposure.integration_s": 0.1})
        if off_deg > 0.0:
            every(s)
        else:
            with pytest.raises(BadInput, match=r"0\.02 deg inside the Earth"):
                every(s)


@pytest.mark.parametrize("rate", [2e5, 1e7, 1e9, 1e300])
def test_absurd_rates_are_refused(scene: Make, rate: float) -> None:
    changes = {"pointing": {"mode": "rate", "boresight_ra_deg": 0.0, "boresight_dec_deg": 0.0,
                            "rate_ra_arcsec_s": rate, "rate_dec_arcsec_s": 0.0}}  # fmt: skip
    with pytest.raises(BadInput):
        every(scene(changes))


def test_stars_that_come_behind_the_camera_are_refused(scene: Make) -> None:
    """A drift of 400 degrees in an exposure, which no rate of the boresight tells of."""
    drift = {"drift": {"x_arcsec_s": 7.2e5}}
    turning = {"mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": 0.0}
    with pytest.raises(BadInput) as caught:
        every(scene({"pointing": turning | {"attitude": drift}}))
    assert caught.value.field == "pointing"
    assert "'stars that come behind the camera in exposure 0'" in str(caught.value)
    assert "streaks of at most 100000 px" in str(caught.value)


@pytest.mark.parametrize("frame", [0, 3])
def test_a_target_that_flies_past_the_observer_is_refused(scene: Make, frame: int) -> None:
    """Over the frame at first, 88 degrees off at the next moment looked at, then behind."""
    at = f"2019-04-20T03:00:{10 * frame:02d}Z"
    here, ahead_s = {"kind": "state", "position_m": [7e6, 0, 0], "epoch": at}, 7.8165e-3
    past = {"position_m": [7e6 + 38.0, 1e4, 0], "velocity_m_s": [0, 7.5e3 - 1e4 / ahead_s, 0]}
    target = GEO_TARGET | {"orbit": here | past}
    s = scene({
        "observer": {"kind": "orbit", "orbit": here | {"velocity_m_s": [0, 7.5e3, 0]}},
        "pointing": {"mode": "sidereal", "boresight_ra_deg": 90.0, "boresight_dec_deg": 0.0},
        "stars": None, "targets": [target]})  # fmt: skip
    with pytest.raises(BadInput) as caught:
        plan_geometry(s, np.array([frame]), 0.0)
    assert caught.value.field == "targets.0.orbit"
    told = rf"'7\.\d+e\+05 px over the frame in exposure {frame}'.*100000 px"
    assert re.search(told, str(caught.value))


def test_limits_boresight_at_the_pole(scene: Make) -> None:
    g = every(scene({"pointing.boresight_dec_deg": 90.0}))
    assert np.isfinite(g.attitude).all()
    assert np.allclose(g.attitude[0, 0] @ g.attitude[0, 0].T, np.eye(3), atol=1e-14)


def test_target_as_fast_as_light_is_refused(scene: Make) -> None:
    orbit = {**GEO_TARGET["orbit"], "velocity_m_s": [0.0, C, 0.0]}
    with pytest.raises(BadInput, match="speed below that of light"):
        every(scene({"targets": [{**GEO_TARGET, "orbit": orbit}]}))


@pytest.mark.parametrize("inside", [[True, False], [False, True], [True, True]])
def test_a_view_that_ends_in_the_earth_in_one_moment_alone_is_refused(
    scene: Make, inside: list[bool]
) -> None:
    """A tenth of a degree beside and inside the disc, from low orbit: the worst is reported."""
    place = np.array([[6.9e6, 0.0, 0.0], [0.0, 6.9e6, 0.0]])
    limb = np.pi - np.arcsin(6378.137e3 / 6.9e6)  # from straight up
    away = limb + np.radians(np.where(inside, [0.2, 0.1], -0.1))
    up = np.eye(3)[:2]
    boresight = np.cos(away)[:, None] * up + np.sin(away)[:, None] * np.roll(up, 1, axis=0)
    s = scene({"observer": LEO})
    check_view(s, place[:1], up[:1])
    check_view(s, place, np.where(np.array(inside)[:, None], up, boresight))
    with pytest.raises(BadInput, match=f"0.{'2' if inside[0] else '1'}0 deg inside the Earth"):
        check_view(s, place, boresight)


def test_the_zenith_of_a_site_is_upright_on_its_ellipsoid(scene: Make) -> None:
    """Not away from the Earth's centre, 0.13 degrees beside it."""
    s = scene({"observer": GROUND})
    p = zenith_pointing(s)
    found = erfa.s2c(np.radians(p.boresight_ra_deg), np.radians(p.boresight_dec_deg))
    up_there = axes_of(s.observer, moments_at(s, 0.0, np.zeros(1)).times)[0, 2]  # type: ignore[arg-type]
    np.testing.assert_allclose(found, up_there, atol=1e-9)


@pytest.mark.parametrize("asked", [0.2, 0.05, 0.0125])
def test_paths_are_as_straight_between_nodes_as_is_asked(scene: Make, asked: float) -> None:
    """And as is told: of a field that turns, against sixteen times as many nodes."""
    turning = {"mode": "rate", "boresight_ra_deg": 0.0, "boresight_dec_deg": 0.0,
               "rate_ra_arcsec_s": 100.0, "rate_dec_arcsec_s": 0.0,
               "roll_rate_deg_s": 0.3}  # fmt: skip
    s = scene({"pointing": turning, "accuracy": {"noise_fraction": asked}})
    g = plan_geometry(s, np.zeros(1, int), 0.0).frame_slice(0)
    dense = _geometry(s, np.zeros(1, int), 16 * (g.nodes - 1) + 1, 0.0)
    few, many = (_star_paths(s, one)[:, :, 0] for one in (g, dense))
    share = np.arange(16) / 16.0
    between = few[..., :-1, None] * (1.0 - share) + few[..., 1:, None] * share
    off = np.hypot(*(between - many[..., :-1].reshape(between.shape)))
    told = bend_px(s, g, 0.0)
    assert 0.3 * told < np.nanmax(off) <= 1.05 * told
    assert told <= FINE_PX * min(1.0, asked / 0.05)


def test_under_moving_charge_a_place_is_that_of_mid_exposure(scene: Make) -> None:
    """The charge takes the light along by 60 rows/s; at mid-exposure nothing is moved."""
    changes = {"observer": LEO, "targets": [GEO_TARGET],
               "pointing": {"mode": "target", "target": "geo"}}  # fmt: skip
    tdi = {"sensor.detector": {"readout": {"kind": "tdi", "rows_per_s": 60.0}}}
    still, moved = (
        plan_geometry(scene(changes | more), np.zeros(1, int), 0.0) for more in ({}, tdi)
    )
    since_s = still.offset_s[0] - still.offset_s[0].mean()
    off = moved.target_y_px[0, 0] - still.target_y_px[0, 0]
    np.testing.assert_allclose(off, -60.0 * since_s, atol=1e-6)


def test_a_frame_of_a_geometry_is_that_frames_own(scene: Make) -> None:
    """Every array, of targets too, bit by bit."""
    s = scene({"observer": LEO, "targets": [GEO_TARGET], "accept": ["sun", "moon", "daylight"],
               "pointing": {"mode": "target", "target": "geo"}})  # fmt: skip
    whole = every(s)
    for k in (1, 3):
        part, own = whole.frame_slice(k), plan_geometry(s, np.array([k]), 0.0)
        for f in fields(own):
            np.testing.assert_array_equal(getattr(part, f.name), getattr(own, f.name), f.name)
