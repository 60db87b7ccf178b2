"""UT1 - UTC and the pole against astropy's own reading of the same tables."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.inputs.earth_orientation import (
    gather_dut1_s,
    gather_pole_arcsec,
    gather_turn_off_rad,
    with_pole,
)
from pipeline.physics.positions.earth import gcrs_to_itrs
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.plan.pointing.geometry import moments_at
from pipeline.plan.pointing.site import axes_of
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene


@pytest.fixture(scope="module")
def table():
    from astropy.utils import iers

    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None):
        yield iers.IERS_Auto.open()


def test_against_astropy(table):
    """Within 1 ms (15 mas of hour angle: in 1973 the tables themselves differ by that)."""
    days = [2442000.2, 2450000.3, 2457753.5, 2457753.99, 2457754.5, 2458593.625, 2461365.2]
    for jd in days:
        value, remark = gather_dut1_s(jd, 0.0)
        assert remark is None
        assert value == pytest.approx(table.ut1_utc(jd, 0.0).to_value("s"), abs=1e-3)


def test_two_part_dates_agree():
    assert gather_dut1_s(2458593.5, 0.125) == gather_dut1_s(2458593.625, 0.0)


@pytest.mark.parametrize(
    ("jd", "off"), [(2415020.5, 35.0), (2433282.5, 35.0), (2440000.5, 0.9), (2488069.5, 0.9)]
)
def test_limits_dates_beyond_the_tables_are_said(jd, off):
    """Before 1960 UTC counts as TAI: TT - UT1 of 1900 and 1950 was -2.8 and 29.15 s, not 32.184."""
    value, remark = gather_dut1_s(jd, 0.0)
    assert value == 0.0
    assert f"UT1 = UTC, at most {off} s" in remark
    before = {2415020.5: -2.8, 2433282.5: 29.15}
    if jd in before:
        t = instants((jd, 0.0), [0.0])
        tt_minus_ut1_s = 86400.0 * ((t.tt1 - t.ut11) + (t.tt2 - t.ut12))
        assert abs(tt_minus_ut1_s[0] - before[jd]) < off


def test_limits_stay_within_a_second():
    values = [gather_dut1_s(jd, 0.0)[0] for jd in np.arange(2442000.5, 2461000.5, 977.3)]
    assert np.abs(values).max() < 0.9


def test_pole_against_astropy(table):
    for jd in [2450000.3, 2457753.5, 2458593.625, 2460665.2, 2461365.2]:  # the last: predicted
        x, y = (v.to_value("arcsec") for v in table.pm_xy(jd, 0.0))
        ours = gather_pole_arcsec(jd, 0.0)
        np.testing.assert_allclose(ours, (x, y), atol=2e-3)
    assert gather_pole_arcsec(2488069.5, 0.0) is None


SITE = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055.0}
SCENE = {
    "schema": "nightglass/scene/1", "name": "pole", "epoch": "2019-04-20T11:00:00Z",
    "observer": SITE,
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 10.0, "focal_length_m": 1.0, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "local", "azimuth_deg": 100.0, "elevation_deg": 50.0},
    "exposure": {"integration_s": 1.0},
}  # fmt: skip


def test_a_scenes_site_against_astropy(table):
    """A site in GCRS, and a low satellite's place over its horizon, with astropy's IERS table.

    Without the pole the site is 5 m off, and the satellite 1 arcsec.
    """
    from astropy import units as u
    from astropy.coordinates import ITRS, AltAz, CartesianRepresentation, EarthLocation
    from astropy.time import Time
    from astropy.utils import iers

    scene = with_pole(parse_scene(SCENE))
    dut1, _ = gather_dut1_s(*parse_utc(scene.epoch))
    with iers.earth_orientation_table.set(table):
        t = Time("2019-04-20T11:00:00", scale="utc")
        place = EarthLocation.from_geodetic(-156.3 * u.deg, 20.7 * u.deg, 3055 * u.m)
        theirs = place.get_gcrs_posvel(t)[0].xyz.to_value(u.m)
        at = moments_at(scene, dut1, np.zeros(1))
        assert np.linalg.norm(at.observer_m[0] - theirs) < 0.3
        bare = moments_at(parse_scene(SCENE), dut1, np.zeros(1)).observer_m[0]
        assert np.linalg.norm(bare - theirs) > 5.0
        fixed = place.get_itrs().cartesian.xyz.to_value(u.m) * 1.1 + np.array([0.0, 4e5, 2e5])
        way = CartesianRepresentation(fixed * u.m) - place.get_itrs().cartesian
        seen = ITRS(way, obstime=t, location=place)
        above = seen.transform_to(AltAz(obstime=t, location=place)).cartesian.xyz
        their_up = above.to_value(u.m) / np.linalg.norm(above.to_value(u.m))
        pole = np.radians(np.array(scene.observer.polar_motion_arcsec) / 3600.0)
        turn = gcrs_to_itrs(instants(parse_utc(scene.epoch), [0.0], dut1), *pole)[0]
    axes = axes_of(scene.observer, at.times)[0]
    way = axes @ (turn.T @ fixed - at.observer_m[0])
    assert np.linalg.norm(way / np.linalg.norm(way) - their_up) < 0.2 / 206265
    off = axes @ (turn.T @ fixed - bare)
    assert np.linalg.norm(off / np.linalg.norm(off) - their_up) > 0.7 / 206265


def test_the_plan_names_the_pole_or_its_error():
    known = {d.component: d for d in prepare(parse_scene(SCENE)).plan.decisions}["polar_motion"]
    assert known.kept
    assert known.bound < 3.0
    late = SCENE | {"epoch": "2080-04-20T11:00:00Z"}
    none = {d.component: d for d in prepare(parse_scene(late)).plan.decisions}["polar_motion"]
    assert not none.kept
    assert 15.0 < none.bound < 25.0


LONG = SCENE | {"epoch": "2016-01-10T09:00:00Z", "accept": ["daylight", "moon", "sun"]}


def long_scene(days: int, **changes):
    step = 10 if days >= 30 else 1
    exposure = {"integration_s": 1.0, "frames": days // step + 1, "cadence_s": 86_400.0 * step}
    return parse_scene(LONG | {"exposure": exposure} | changes)


@pytest.mark.parametrize("days", [30, 300, 500])  # 500: beyond the leap second of 2016's end
def test_what_the_epochs_earth_is_off_later_against_astropy(table, days):
    """UT1 - TAI drifts by 0.4 s in the first 300 days; the pole's way is added."""
    jd = 2457397.875 + days * np.linspace(0.0, 1.0, 16)
    ut1 = table.ut1_utc(jd, 0.0).to_value("s") - np.where(jd > 2457754.5, 1.0, 0.0)
    x, y = (v.to_value("arcsec") for v in table.pm_xy(jd, 0.0))
    theirs = 15.041 * np.abs(ut1 - ut1[0]) + np.hypot(x - x[0], y - y[0])
    assert gather_turn_off_rad(long_scene(days)) * 206265 == pytest.approx(theirs.max(), rel=0.03)


def test_only_sites_and_long_scenes_are_off():
    assert gather_turn_off_rad(long_scene(0)) == 0.0
    assert gather_turn_off_rad(long_scene(300, epoch="2080-01-10T09:00:00Z")) == 0.0
    away = {"kind": "fixed", "position_au": [1, 0, 0]}
    stars = {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 20.0}
    assert gather_turn_off_rad(long_scene(300, observer=away, pointing=stars)) == 0.0


def test_a_long_scene_is_told_to_be_split():
    """300 days: 6 arcsec of 2 arcsec a pixel; stars that are pointed at do not move, targets do."""

    def told(scene):
        return [w for w in prepare(scene).plan.warnings if "UT1" in w]

    (warning,) = told(long_scene(300))
    assert "300 days the site is turned up to 6.1 arcsec, 188 m, wrongly" in warning
    assert "2.9 px; split the scene into parts of 5.1 days" in warning
    assert told(long_scene(3)) == []
    stars = {"mode": "sidereal", "boresight_ra_deg": 150.0, "boresight_dec_deg": 70.0}
    assert told(long_scene(300, pointing=stars)) == []
    body = {"kind": "sphere", "diameter_m": 4.0, "albedo": 0.25}
    orbit = {"kind": "state", "position_m": [-3.0e7, 2.9e7, 0.0], "velocity_m_s": [-2130, -2200, 0]}
    high = {"name": "high", "orbit": orbit, "body": body}
    (warning,) = told(long_scene(300, pointing=stars, targets=[high]))
    assert " m, wrongly, which is 0." in warning
