"""Stray light in the plan: from the curve to electrons, refusals, what is hidden, the grid."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.inputs.band.response import gather_response
from pipeline.inputs.sky.air import gather_extinction
from pipeline.inputs.sky.sky import gather_sky
from pipeline.inputs.sky.stray_light import read_albedo, read_pst
from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.positions.focal_plane import deproject, ifov_rad
from pipeline.physics.sky.earth_disc import earth_stray
from pipeline.physics.sky.pst import PstTable
from pipeline.physics.targets.shadow import moon_m
from pipeline.plan.facts import gather_facts
from pipeline.plan.pointing.geometry import camera_of, plan_geometry, sampled_frames
from pipeline.plan.sky.light import LightOfSky
from pipeline.plan.sky.sky import plan_sky, sky_tile
from pipeline.plan.sky.stray_light import _Body, _check, _check_frame, stray_parts
from pipeline.plan.tiles import Tile
from pipeline.spec.sky.stray_light import StrayLight

PST = "angle_deg,pst\n1,1e-4\n3,1e-5\n10,1e-6\n30,1e-8\n60,1e-10\n90,1e-12\n"
HIGH = {"kind": "orbit", "orbit": {
    "kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]}}  # fmt: skip


@pytest.fixture
def curve(tmp_path):
    path = tmp_path / "pst.csv"
    path.write_text(PST)
    return str(path)


def planned(scene, stray, changes):
    s = scene({
        "stars": None, "sensor.shape": [256, 256], "sensor.focal_length_m": 0.3,
        "sensor.aperture_m": 0.1, "sensor.obscuration": 0.0, "sensor.transmission": 0.8,
        "sensor.quantum_efficiency": 0.5, "sensor.psf": {"kind": "gaussian", "sigma_px": 0.8},
        "observer": HIGH, "exposure": {"integration_s": 1.0, "frames": 1},
        "background": {"stray_light": stray, "starlight": "none"},
    } | changes)  # fmt: skip
    response, band, digest = gather_response(s)
    facts = gather_facts(s, response, 0.0, 5.0, 1.0)
    air = gather_extinction(s, response)
    inputs = gather_sky(s, response, band, digest, (), None, False, extinction=air)
    geometry = plan_geometry(s, sampled_frames(s), 0.0)
    sky = plan_sky(s, camera_of(s), geometry, facts, inputs, 0.0)
    return s, facts, inputs, geometry, sky


def at(ra, dec):
    return {"pointing": {"mode": "sidereal", "boresight_ra_deg": ra, "boresight_dec_deg": dec}}


def told(sky):
    return {d.component: d for d in sky.decisions}


def test_sun_by_hand(scene, curve):
    """Curve at the angle, irradiance at the distance, pixel, quantum efficiency; the transmission
    is in the curve."""
    wish = {"pst": {"kind": "table", "path": curve}, "moon": False, "earth": False}
    observer = {"observer": {"kind": "fixed", "position_au": [1.2, 0.0, 0.0]}}
    _, _, _, g, sky = planned(scene, wish, observer | at(225.0, 0.0))
    from pipeline.inputs.band.curves import solar_spectrum
    from pipeline.physics.radiometry import band_photon_irradiance_sun, box

    w, e, *_ = solar_spectrum()
    to_sun = g.sun_m[0, g.middle] - g.observer_m[0, g.middle]
    rate = 0.5 * band_photon_irradiance_sun(w, e, box(400e-9, 900e-9))
    rate *= ASTRONOMICAL_UNIT_M**2 / (to_sun @ to_sun) * (10e-6) ** 2
    boresight = g.attitude[0, g.middle, 2]
    angle = np.degrees(np.arccos(boresight @ to_sun / np.sqrt(to_sun @ to_sun)))
    pst = np.exp(np.interp(np.log(angle), np.log([30, 60]), np.log([1e-8, 1e-10])))
    image = sky_tile(sky, 0, Tile(0, 0, 0, 0, 256, 256))
    assert image[127:129, 127:129].mean() == pytest.approx(rate * pst, rel=2e-3)
    through = dict(wish, pst={"kind": "table", "path": curve, "holds_transmission": False})
    dimmer = planned(scene, through, observer | at(225.0, 0.0))[-1]
    assert dimmer.least_e_s == pytest.approx(0.8 * sky.least_e_s, rel=1e-6)


def test_grid_follows_a_steep_gradient(scene, curve):
    """Half a degree off the limb, extrapolated: every pixel against direct evaluation."""
    wish = {"pst": {"kind": "table", "path": curve}, "inside": "extrapolate", "sun": False}
    s, facts, inputs, g, sky = planned(scene, wish, at(190.0, 0.0))
    light = LightOfSky(s, camera_of(s), facts, inputs, None)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.5, 255.5, (2, 60)).round()
    x, y = np.clip(x, 0, 255), np.clip(y, 0, 255)
    exact = light.at(g)(x, y)[0]
    image = sky_tile(sky, 0, Tile(0, 0, 0, 0, 256, 256))
    assert np.abs(image[y.astype(int), x.astype(int)] - exact).max() <= 1.5 * sky.error_e
    assert image.max() > 1.1 * image.min()
    assert "bilinear" in told(sky)["background.grid"].reason
    assert told(sky)["background.grid"].error_bound_e == sky.error_e


def test_where_the_camera_turns_the_mean_is_of_three_moments(scene, curve):
    """Before any more are asked for: Simpson's rule over both ends and the middle."""
    wish = {"pst": {"kind": "table", "path": curve}, "inside": "extrapolate", "sun": False}
    turning = {"mode": "rate", "boresight_ra_deg": 192.0, "boresight_dec_deg": 0.0,
               "rate_ra_arcsec_s": 900.0, "rate_dec_arcsec_s": 0.0}  # fmt: skip
    s, facts, inputs, g, _ = planned(scene, wish, {"observer": HIGH, "pointing": turning})
    light, (x, y) = LightOfSky(s, camera_of(s), facts, inputs, None), np.array([[128.0], [9.0]])
    first, middle, last = (
        sum(light.per_pixel(g, 0, k, x, y).values()) for k in (0, g.middle, g.nodes - 1)
    )
    assert abs(first + last - 2.0 * middle) > 5e-4 * middle
    np.testing.assert_allclose(light.at(g)(x, y)[0], (first + 4.0 * middle + last) / 6.0, rtol=1e-9)


def test_sun_and_moon_behind_the_earth_give_none(scene, tmp_path):
    """In the Earth's shadow the Sun is off; the whole light of the night side's Earth is nil."""
    curve = tmp_path / "all-round.csv"  # some of the Sun's light comes from behind
    curve.write_text(PST + "180,1e-12\n")
    wish = {"pst": {"kind": "table", "path": str(curve)}, "moon": False, "inside": "clip"}
    g = planned(scene, wish, at(200.0, 0.0))[3]
    sun = g.sun_m[0, 0] - g.observer_m[0, 0]
    away = -sun / np.sqrt(sun @ sun) * (EARTH_EQUATORIAL_RADIUS_M + 400e3)
    side = np.cross(away, [0.0, 0.0, 1.0])
    speed = side / np.sqrt(side @ side) * 7670.0
    dark = {"kind": "orbit", "orbit": {
        "kind": "state", "position_m": away.tolist(), "velocity_m_s": speed.tolist()}}  # fmt: skip
    ra, dec = np.degrees([np.arctan2(away[1], away[0]), np.arcsin(away[2] / np.sqrt(away @ away))])
    _, _, _, _, sky = planned(scene, wish, {"observer": dark} | at(float(ra), float(dec)))
    assert sky.grids.max() == 0.0
    reason = told(sky)["stray_light.sun"].reason
    assert reason.startswith("0 to 0")


def test_sources_are_switched(scene, curve):
    table = {"kind": "table", "path": curve}
    both = planned(scene, {"pst": table, "moon": False}, at(190.0, 30.0))[-1]
    parts = [
        planned(scene, {"pst": table, "moon": False} | {name: False}, at(190.0, 30.0))[-1]
        for name in ("sun", "earth")
    ]
    assert both.grids.mean() == pytest.approx(sum(p.grids.mean() for p in parts), rel=1e-3)
    assert not told(parts[0])["stray_light.sun"].kept


def test_a_site_on_the_ground_sees_no_disc(scene, curve):
    site = {"observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3}}
    wish = {"pst": {"kind": "table", "path": curve, "beyond": "zero"}}
    sky = planned(scene, wish, site | at(180.0, 20.0) | {"epoch": "2019-04-20T08:00:00Z"})[-1]
    earth = told(sky)["stray_light.earth"]
    assert "no disc" in earth.reason
    assert not earth.kept
    assert (earth.error_bound_e, earth.error_bound_sigma) == (0.0, 0.0)
    assert "0 to 0" in told(sky)["stray_light.sun"].reason


@pytest.mark.parametrize(
    ("wish", "pointing", "said"),
    [
        ({"exclusion_deg": 10.0, "sun": False, "moon": False}, at(190.0, 0.0), "Earth's limb"),
        ({"sun": False, "moon": False, "exclusion_deg": 10.0}, at(170.0, 1.0), "in the field"),
        ({"exclusion_deg": 50.0, "moon": False, "earth": False}, at(60.0, 20.0), "to the Sun"),
        ({"moon": False, "earth": False}, at(26.6, 11.0), "the Sun in the field"),
        ({"exclusion_deg": 0.5, "sun": False, "moon": False}, at(193.0, 0.0), "1 degrees or more"),
    ],
    ids=["limb", "disc", "exclusion", "sun", "nearer than the table"],
)
def test_refusals_of_directions(scene, curve, wish, pointing, said):
    table = {"pst": {"kind": "table", "path": curve}}
    with pytest.raises(BadInput, match=said):
        planned(scene, table | wish, pointing | {"sensor.focal_length_m": 0.02})


def test_a_curve_that_ends_early_is_refused_where_it_is_needed(scene, tmp_path):
    path = tmp_path / "short.csv"
    path.write_text("5,1e-5\n40,1e-8\n")
    wish = {"pst": {"kind": "table", "path": str(path)}, "moon": False, "earth": False}
    with pytest.raises(BadInput, match="ends at 40 deg"):
        planned(scene, wish, at(100.0, 20.0))
    wish["pst"]["beyond"] = "zero"
    assert planned(scene, wish, at(100.0, 20.0))[-1].grids.max() == 0.0


@pytest.mark.parametrize(("end_deg", "refused"), [(36.0, True), (40.0, False)])
def test_a_curve_reaches_to_the_far_side_of_the_earth(scene, tmp_path, end_deg, refused):
    """Seen from 4.2e7 m the Earth's disc goes from 21.3 to 38.7 degrees (and half a field)."""
    path = tmp_path / "pst.csv"
    path.write_text(f"angle_deg,pst\n1,1e-4\n10,1e-6\n{end_deg},1e-8\n")
    wish = {"pst": {"kind": "table", "path": str(path)}, "sun": False, "moon": False}
    with pytest.raises(BadInput, match="angles up to 38") if refused else nullcontext():
        planned(scene, wish, at(150.0, 0.0))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("angle_deg,pst\n1,1e-4\n3,\n10,1e-6\n", "no gaps"),
        ("angle_deg,pst\n1,1e-4\n3,1e-5,5\n10,1e-6\n", "two numbers"),
        ("1,1e-4\n3,nan\n", "no gaps"),
        ("1,1e-4\n10,1e-5\n5,1e-6\n", "ascending"),
        ("1,1e-4\n1,1e-5\n", "ascending"),
        ("1,1e-4\n3,0\n", "above 0"),
        ("1,1e-4\n3,-1e-5\n", "above 0"),
        ("0,1e-4\n3,1e-5\n", "above 0"),
        ("1,1e-4\n", "two rows"),
        ("", "rows of numbers"),
        ("1,2,3\n4,5,6\n", "two numbers"),
        ('1,1e-4\n"' + 140_000 * "1,", "a readable text file"),
    ],
)
def test_bad_curves(tmp_path, text, said):
    path = tmp_path / "pst.csv"
    path.write_text(text)
    with pytest.raises(BadInput, match=said) as caught:
        read_pst(path)
    assert caught.value.field == "background.stray_light.pst.path"


def test_a_remark_may_be_indented(tmp_path):
    path = tmp_path / "pst.csv"
    found = []
    for remark in ("", " # as measured\n"):
        path.write_text(f"{remark}angle_deg,pst\n1,1e-4\n3,1e-5\n")
        found.append(repr(read_pst(path)))
    assert found[0] == found[1]


def test_bad_albedo_maps(tmp_path):
    path = tmp_path / "map.csv"
    path.write_text("0.1,0.2,0.3\n0.4,0.5,0.6\n")
    assert read_albedo(path).shape == (2, 3)
    for text, said in (("0.1,nan\n0.2,0.3\n", "row 1, column 2"), ("30,20\n10,10\n", "0 to 1"),
                       ("0.1,0.2\n0.3\n", "equal length"), ("a,b\n", "no gaps")):  # fmt: skip
        path.write_text(text)
        with pytest.raises(BadInput, match=said):
            read_albedo(path)
    with pytest.raises(BadInput, match="readable"):
        read_albedo(tmp_path / "none.csv")
    bad = tmp_path / "map.npy"
    np.save(bad, np.array([[0.1, np.nan], [0.2, 0.3]]))
    with pytest.raises(BadInput, match="column 2"):
        read_albedo(bad)
    np.save(bad, np.full((2, 2), 0.1 + 0.2j))
    with pytest.raises(BadInput, match="array of numbers"):
        read_albedo(bad)


def test_a_map_of_the_earth(scene, curve, shared_data):
    """The clouds of a year against their mean: another light, within what the map spans."""
    path = shared_data / "earth_albedo" / "Earth_ALB_2018_CERES_All_5x5.csv"
    assert read_albedo(path).shape == (36, 72)
    table = {"kind": "table", "path": curve}
    mapped = planned(scene, {"pst": table, "sun": False, "moon": False,
                             "earth_albedo": str(path)}, at(200.0, 0.0))[-1]  # fmt: skip
    one = planned(scene, {"pst": table, "sun": False, "moon": False, "earth_albedo": 0.317},
                  at(200.0, 0.0))[-1]  # fmt: skip
    assert 0.118 / 0.317 < mapped.least_e_s / one.least_e_s < 0.712 / 0.317
    assert mapped.least_e_s != pytest.approx(one.least_e_s, rel=1e-3)


def test_the_moon_behind_the_earth_gives_none(scene, curve):
    """The observer on the line from the Moon through the Earth, then a little beside it."""
    from pipeline.plan.sky.stray_light import _seen_past_earth

    moon = np.array([3.8e8, 0.0, 0.0])
    behind = np.array([-4.2e7, 0.0, 0.0])
    assert _seen_past_earth(behind, moon - behind, 1.74e6) == 0.0
    beside = np.array([-4.2e7, 9.0e6, 0.0])
    assert _seen_past_earth(beside, moon - beside, 1.74e6) == 1.0
    half = np.array([-4.2e7, EARTH_EQUATORIAL_RADIUS_M * 1.111, 0.0])
    assert 0.0 <= _seen_past_earth(half, moon - half, 1.74e6) <= 1.0
    for before in (4.2e7, 4.2e8):  # the Moon away from the Earth, and in transit of it
        place = np.array([before, 0.0, 0.0])
        assert _seen_past_earth(place, moon - place, 1.74e6) == 1.0


@pytest.mark.parametrize("radii", [-2.0, -1.0, -0.5, 0.0, 0.3, 1.0, 1.5])
def test_the_moon_at_the_limb_is_cut_in_proportion(radii):
    """So many of its own radii above the limb: the fraction of its height that is free."""
    from pipeline.plan.sky.stray_light import _seen_past_earth

    place, moon_radius_m, range_m = np.array([4.2e7, 0.0, 0.0]), 1.74e6, 4e8
    limb = np.arcsin(EARTH_EQUATORIAL_RADIUS_M / 4.2e7)
    angle = limb + radii * moon_radius_m / range_m
    to_moon = range_m * np.array([-np.cos(angle), np.sin(angle), 0.0])
    free = np.clip(0.5 * (1.0 + radii), 0.0, 1.0)
    assert _seen_past_earth(place, to_moon, moon_radius_m) == pytest.approx(free, abs=5e-6)


def test_the_moon_in_the_shadow_of_the_earth_gives_none(scene, curve):
    """The total eclipse of 2019-01-21: totality from 04:41 to 05:43 UTC, no penumbra before
    02:36 (Espenak, NASA)."""
    wish = {"pst": {"kind": "table", "path": curve}, "sun": False, "earth": False}
    light = {
        time: planned(scene, wish, at(160.0, 20.0) | {"epoch": f"2019-01-21T{time}:00Z"})[-1]
        for time in ("02:00", "04:55", "05:12", "05:30")
    }
    assert light["02:00"].grids.min() > 0.0
    assert [light[time].grids.max() for time in ("04:55", "05:12", "05:30")] == [0.0] * 3


def test_the_rule_of_four_corners_is_told(scene, curve):
    wish = {"pst": {"kind": "table", "path": curve}, "sun": False}
    sky = planned(scene, wish, at(191.0, 0.0))[-1]
    reason = told(sky)["background.grid"].reason
    assert "four corners differ by up to 0." in reason
    assert "that mean taken for the frame would err by" in reason


def test_fill_factor_takes_its_fraction(scene, curve):
    """Stray light, too, is collected only where the pixel collects."""
    wish = {"pst": {"kind": "table", "path": curve}, "inside": "extrapolate"}
    images = [
        sky_tile(planned(scene, wish, at(190.0, 0.0) | {"sensor.fill_factor": fill})[-1], 0,
                 Tile(0, 0, 0, 0, 256, 256))
        for fill in (1.0, 0.55)
    ]  # fmt: skip
    assert images[0].min() > 0.0
    assert images[1] == pytest.approx(0.55 * images[0], rel=1e-3)


@pytest.mark.parametrize("hours", [8, 10])
def test_the_air_dims_the_lamps_of_a_site(scene, curve, hours):
    """By 0.4 mag for each air mass of Kasten & Young (1989) at the Moon's own elevation."""
    site = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 0.0,
            "atmosphere": {"extinction": {"mag_per_airmass": 0.4}}}  # fmt: skip
    wish = {"pst": {"kind": "table", "path": curve}, "sun": False, "earth": False}
    when = {"epoch": f"2019-04-20T{hours:02d}:00:00Z"}
    s, _, inputs, g, sky = planned(scene, wish, {"observer": site} | at(180.0, 20.0) | when)
    u, air = g.attitude[0, g.middle, 2][None], gather_extinction(s, gather_response(s)[0])
    args = s, s.background.stray_light, inputs.stray, g, 0, g.middle, u, 0.0
    assert g.middle > 0
    g.air[:, 0] = -g.air[:, 0]  # of another moment: it is of no account
    share = stray_parts(*args, air)["moon"] / stray_parts(*args)["moon"]
    earth = earth_and_sun(g.tt1[:1, g.middle], g.tt2[:1, g.middle]).position_m
    to_moon = moon_m(g.tt1[0, [g.middle]], g.tt2[0, [g.middle]]) - g.observer_m[0, g.middle] + earth
    up = np.degrees(np.arcsin(to_moon[0] @ g.air[0, g.middle, :3] / np.linalg.norm(to_moon)))
    mass = 1.0 / (np.sin(np.radians(up)) + 0.50572 * (up + 6.07995) ** -1.6364)
    assert mass > 1.05
    assert share[0] == pytest.approx(10.0 ** (-0.4 * 0.4 * mass), rel=1e-3)
    airless = {"observer": {name: site[name] for name in site if name != "atmosphere"}}
    skies = sky, planned(scene, wish, airless | at(180.0, 20.0) | when)[-1]
    dimmed, whole = (sky_tile(one, 0, Tile(0, 0, 0, 0, 256, 256)) for one in skies)
    assert dimmed == pytest.approx(share[0] * whole, rel=1e-3)


@pytest.mark.parametrize(
    ("angle", "inside", "refused"),
    [((2.0, 50.0), "refuse", False), ((1.99, 50.0), "refuse", True), ((1.99, 50.0), "clip", False),
     ((2.0, 90.0), "refuse", False), ((2.0, 90.1), "refuse", True), ((0.0, 50.0), "clip", True)],
)  # fmt: skip
def test_edges_of_a_curve(angle, inside, refused):
    """2 degrees is the exclusion angle, 90 the curve's last: both are within."""
    wish = StrayLight.model_validate({"pst": {"kind": "table", "path": "a"}, "inside": inside})
    ends = np.radians([2.0, 90.0])
    pst = PstTable(ends, np.ones(2), float(ends[0]), inside, "refuse")
    with pytest.raises(BadInput) if refused else nullcontext():
        _check(wish, pst, "Sun", np.radians(angle))


@pytest.mark.parametrize("epoch", ["2020-01-05T06:00:00Z", "2020-07-04T06:00:00Z"])
def test_the_earth_is_lit_by_the_sun_of_its_distance(scene, curve, epoch):
    """Its disc through the curve, with sunlight that changes by 7% over the year."""
    wish = {"pst": {"kind": "table", "path": curve}, "sun": False, "moon": False}
    small = {"epoch": epoch, "sensor.shape": [8, 8]}
    _, _, inputs, g, sky = planned(scene, wish, small | at(160.0, 10.0))
    earth = earth_and_sun(g.tt1[0, g.middle], g.tt2[0, g.middle])
    place, sun = g.observer_m[0, g.middle] - earth.position_m[0], earth.sun_from_earth_m[0]
    boresight, stray = g.attitude[0, g.middle, 2], inputs.stray
    light = earth_stray(boresight[None], place, sun, stray.pst, stray.albedo, np.eye(3))[0]
    rate = stray.sun_rate * ASTRONOMICAL_UNIT_M**2 / (sun @ sun) * (10e-6) ** 2
    assert light > 0.0
    assert sky_tile(sky, 0, Tile(0, 0, 0, 0, 8, 8)).mean() == pytest.approx(light * rate, rel=2e-3)


def test_the_bound_is_of_the_brightest_place(scene, curve):
    """Half a degree off the limb, where a frame's corners differ many times over."""
    wish = {"pst": {"kind": "table", "path": curve}, "inside": "extrapolate", "sun": False}
    sky = planned(scene, wish, at(190.0, 0.0))[-1]
    d = told(sky)["stray_light.earth"]
    low, high = map(float, d.reason.split(" e-/s")[0].split(" to "))
    assert high > 1.1 * low
    assert d.bound == pytest.approx(1.02 * high, rel=1e-3)
    assert d.bound >= sky.grids.max()


@pytest.mark.parametrize("shape", [(40, 200), (200, 40)])
def test_a_body_beside_an_oblong_frame_is_not_in_it(scene, shape):
    """Places inside and just outside of each side, by more than the disc's radius or less."""
    s = scene({"sensor.shape": list(shape)} | at(30.0, 10.0))
    attitude = plan_geometry(s, np.zeros(1, np.int64), 0.0).attitude[0, 0]
    camera, rows, columns = camera_of(s), *shape
    middle, end = np.array([columns / 2, rows / 2]), np.array([columns, rows])
    for axis in (0, 1):
        for off_px, inside in ((-20.0, True), (1.5, True), (6.0, False)):
            for place in (end[axis] - 0.5 + off_px, -0.5 - off_px):
                x, y = np.where(np.arange(2) == axis, place, middle)
                towards = deproject(camera, attitude, np.array([x]), np.array([y]))[0]
                lamp = _Body(towards, 3.0 * ifov_rad(camera), 1.0)
                with pytest.raises(BadInput) if inside else nullcontext():
                    _check_frame(s, attitude, "Moon", lamp)


def test_each_frame_is_lit_as_its_own_camera_turns(scene, curve):
    """The first dwell rests, the second turns: its frame, alone or after the other, is the same."""
    wish = {"pst": {"kind": "table", "path": curve}, "inside": "extrapolate", "sun": False}
    turning = {"mode": "rate", "boresight_ra_deg": 192.0, "boresight_dec_deg": 0.0,
               "rate_ra_arcsec_s": 900.0, "rate_dec_arcsec_s": 0.0}  # fmt: skip
    dwells = [at(192.0, 0.0) | {"frames": 1}, {"pointing": turning, "frames": 1}]
    s, facts, inputs, g, _ = planned(scene, wish, {"observer": HIGH, "dwells": dwells})
    light, (x, y) = LightOfSky(s, camera_of(s), facts, inputs, None), np.array([[128.0], [9.0]])
    assert len(g.frame) == 2
    both = light.at(g)(x, y)
    for f in range(2):
        assert np.array_equal(both[f], light.at(g.frame_slice(f))(x, y)[0])
