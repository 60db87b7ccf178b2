"""The planned sky: no light lost or counted twice, bounds that hold, the same bits in any tile."""

from __future__ import annotations

import copy
import pickle
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from catalog_tools.catalogue import open_catalogue
from catalog_tools.query.query import cone
from catalog_tools.query.starlight import make_starlight
from catalog_tools.synthetic.synthetic import make_demo
from pipeline.errors import BadInput
from pipeline.inputs.band.colour_fit import gather_colour_fit
from pipeline.inputs.band.response import gather_response
from pipeline.inputs.sky.air import gather_extinction
from pipeline.inputs.sky.sky import gather_sky
from pipeline.physics.colour import star_electron_rate
from pipeline.physics.constants import SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.apparent import aberrate
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.positions.focal_plane import project
from pipeline.physics.sky.grid import FrameGrid
from pipeline.physics.targets.shadow import moon_m
from pipeline.physics.vectors import from_angles, separation
from pipeline.plan.facts import gather_facts
from pipeline.plan.pointing.geometry import camera_of, plan_geometry, sampled_frames
from pipeline.plan.sky.light import LightOfSky, _check_elongation, off_plane_remarks
from pipeline.plan.sky.night import _moon_share, dimmed
from pipeline.plan.sky.sky import _grid_told, facts_with_sky, plan_sky, sky_grid, sky_tile
from pipeline.plan.stars.faint import faint_limit, limits_g_mag
from pipeline.plan.tiles import Tile, plan_tiles
from tests.slow import slow

FIELD_DEG = (200.0, 60.0)
WIDE = {
    "observer": {"kind": "fixed", "position_au": [1.0, 0.0, 0.0]},
    "sensor.shape": [256, 256], "sensor.focal_length_m": 10e-6 / np.radians(1.8 / 256),
    "sensor.aperture_m": 0.05, "sensor.obscuration": 0.0,
    "sensor.psf": {"kind": "gaussian", "sigma_px": 0.8},
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 200.0, "boresight_dec_deg": 60.0},
    "exposure": {"integration_s": 10.0, "frames": 1},
}  # fmt: skip


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory):
    path = tmp_path_factory.mktemp("sky") / "catalogue"
    make_demo(path, faintest_g_mag=5.0, deep_fields=[(*FIELD_DEG, 2.6, 18.5)], seed=5)
    return open_catalogue(path)


@pytest.fixture(scope="module")
def mapped(catalogue):
    make_starlight(catalogue)
    return catalogue


def planned(scene, changes, catalogues=(), from_noise=False):
    """A scene, its facts and its sky plan."""
    s = scene(copy.deepcopy(WIDE | changes))
    response, band, digest = gather_response(s)
    fit = gather_colour_fit(response, band, digest) if s.stars is not None else None
    facts = gather_facts(s, response, 0.0, 3.0, 1.0)
    inputs = gather_sky(s, response, band, digest, catalogues, fit, from_noise)
    geometry = plan_geometry(s, sampled_frames(s), 0.0)
    return s, facts, plan_sky(s, camera_of(s), geometry, facts, inputs, 0.0, from_noise), fit


def stars_in_frame(s, catalogue, fit, facts):
    rows, _ = cone(catalogue, *FIELD_DEG, 2.5)
    g, bp, rp = (
        rows[f"phot_{b}_mean_mag"].to_numpy(zero_copy_only=False).astype(float)
        for b in ("g", "bp", "rp")
    )
    rate, _ = star_electron_rate(g, bp, rp, fit)
    u = from_angles(*(np.radians(rows[k].to_numpy()) for k in ("ra", "dec")))
    geometry = plan_geometry(s, sampled_frames(s), 0.0)
    beta = geometry.observer_m_s[0, geometry.middle] / SPEED_OF_LIGHT_M_S
    x, y = project(camera_of(s), geometry.attitude[0, geometry.middle], aberrate(u, beta))
    inside = (x > -0.5) & (x < 255.5) & (y > -0.5) & (y < 255.5)
    return g[inside], rate[inside] * facts.area_m2


def whole(s, sky, frame=0):
    rows, columns = s.sensor.shape
    return sky_tile(sky, frame, Tile(0, 0, 0, 0, rows, columns))


@pytest.mark.parametrize("band", [("box", 0.01), slow(("bessell-B", 0.05))])
def test_total_light_stays_when_the_limit_moves(scene, mapped, band):
    """From 10 to 21: stars drawn and the sky together, within the stars' own scatter in the map's
    pixels and what the band's colour costs."""
    name, colour = band
    bandpass = {"kind": "box", "short_nm": 400.0, "long_nm": 900.0}
    if name != "box":
        bandpass = {"kind": "named", "name": name}
    totals, beyond = [], 0.0
    for limit in (21.0, 10.0, 12.0, 13.3, 17.0):
        changes = {"stars.faintest_g_mag": limit, "sensor.bandpass": bandpass,
                   "background": {"starlight": "all", "uniform_e_per_s": 0.0}}  # fmt: skip
        s, facts, sky, fit = planned(scene, changes, (mapped,))
        g, rate = stars_in_frame(s, mapped, fit, facts)
        light = whole(s, sky).sum()
        beyond = beyond or light  # the counts' light beyond the catalogue's end
        left = rate[g > limit]
        scatter = 3.0 * np.sqrt(np.sum(left**2)) + colour * left.sum()
        assert abs((light - beyond) - left.sum()) <= scatter + 1e-9
        totals.append((rate[g <= limit].sum() + light, scatter))
    for total, scatter in totals:
        assert abs(total - totals[0][0]) <= scatter + 1e-9 * total
    assert totals[-1][1] < 3e-3 * totals[0][0]


def test_limit_from_noise_keeps_its_bounds(scene, mapped):
    """No star that is omitted puts more than an approximation's share of the noise into a pixel;
    the peak share is that of a star in the middle of a pixel."""
    changes = {"background": {"uniform_e_per_s": 4000.0}, "sensor.read_noise_e": 20.0,
               "sensor.aperture_m": 0.02}  # fmt: skip
    s, facts, sky, fit = planned(scene, changes, (mapped,), from_noise=True)
    limit = sky.faintest_g_mag
    assert 10.0 < limit < 18.5
    g, rate = stars_in_frame(s, mapped, fit, facts)
    from scipy.special import erf

    peak = erf(0.5 / (0.8 * np.sqrt(2.0))) ** 2  # a Gaussian over its central pixel
    budget = facts_with_sky(facts, s, sky).budget_e
    faint = g > limit
    assert rate[faint].max() * 10.0 * peak <= budget
    told = {d.component: d for d in sky.decisions}
    assert rate[faint].max() * 10.0 * peak <= told["stars.faint"].error_bound_e <= budget
    # the crowd: squares of the stars' light, spread over all pixels
    grain = np.sqrt(np.sum((rate[faint] * 10.0) ** 2) * peak / 256**2)
    assert grain <= 1.1 * told["stars.faint"].error_bound_e
    # half a magnitude less would break the rule
    assert (rate * 10.0 * peak)[g > limit - 1.5].max() > 0.2 * budget
    left = rate[faint].sum()
    assert whole(s, sky).sum() - 4000.0 * 256**2 == pytest.approx(left, rel=0.1)
    assert "map of order 6" in told["background.starlight"].reason


def test_without_a_map_the_star_counts_stand_in(scene, catalogue):
    import shutil

    from catalog_tools.query.starlight import STARLIGHT_NAME

    bare = catalogue.path + "-bare"
    shutil.copytree(catalogue.path, bare, ignore=shutil.ignore_patterns("starlight.npz"))
    assert not (__import__("pathlib").Path(bare) / STARLIGHT_NAME).exists()
    changes = {"background": {"uniform_e_per_s": 4000.0}, "sensor.read_noise_e": 20.0,
               "sensor.aperture_m": 0.02}  # fmt: skip
    s, facts, sky, fit = planned(scene, changes, (open_catalogue(bare),), from_noise=True)
    g, rate = stars_in_frame(s, catalogue, fit, facts)
    left = rate[g > sky.faintest_g_mag].sum()
    assert whole(s, sky).sum() - 4000.0 * 256**2 == pytest.approx(left, rel=0.35)
    told = {d.component: d.reason for d in sky.decisions}
    assert "star counts" in told["background.starlight"]


def test_beside_layers_the_source_of_undrawn_light_is_still_told(scene, mapped):
    """A layer adds to what is known of the light of stars that are not drawn, and takes nothing."""
    told = []
    for catalogue in ("main", ["main", "layer"]):
        changes = {"stars.faintest_g_mag": 14.0, "stars.catalogue": catalogue,
                   "background": {"starlight": "all"}}  # fmt: skip
        _, _, sky, _ = planned(scene, changes, (mapped,))
        told += [d.reason for d in sky.decisions if d.component == "background.starlight"]
    alone, layered = told
    assert "stars that are not drawn: the catalogue's own map of order 6" in alone
    assert layered.startswith(alone)
    assert "stars that only the layers hold" in layered.removeprefix(alone)


def test_a_limit_that_the_noise_sets_is_as_bright_as_it_may_be():
    none = np.zeros(limits_g_mag().size)
    falling = 10.0 ** (-0.4 * limits_g_mag())
    found = faint_limit(falling * 1e-9, 1e6, 0.4, 1e-10, 0.5)
    assert found.star_e <= 0.5 < 0.5 * 10**0.2 * 1.0000001
    assert 1e6 * 0.4 * 10 ** (-0.4 * (found.g_mag - 0.5)) > 0.5
    crowded = faint_limit(falling * 1e12, 1e6, 0.4, 1e-10, 0.5)
    assert crowded.g_mag > found.g_mag
    assert faint_limit(none, 1e6, 0.4, 1e-10, 0.5).star_e == 0.0


ZODIACAL = {"stars": None, "background": {"zodiacal": True, "uniform_e_per_s": 0.5}}
LONG = {"exposure": {"integration_s": 2.0, "frames": 400, "cadence_s": 60.0},
        "pointing": {"mode": "rate", "boresight_ra_deg": 200.0, "boresight_dec_deg": 40.0,
                     "rate_ra_arcsec_s": 6.0, "rate_dec_arcsec_s": -2.0}}  # fmt: skip


def test_grid_and_knots_against_direct_evaluation(scene):
    """A scan over 400 frames: any pixel of any frame, against the light worked out there."""
    s, facts, sky, _ = planned(scene, ZODIACAL | LONG)
    response, band, digest = gather_response(s)
    inputs = gather_sky(s, response, band, digest, (), None, False)
    from pipeline.plan.sky.sky import _Light

    light = _Light(s, camera_of(s), facts, inputs, -99.0)
    frames = np.array([0, 7, 55, 211, 398, 399])
    x, y = np.array([0.0, 130.0, 255.0, 90.0]), np.array([0.0, 40.0, 255.0, 201.0])
    exact = light.at(plan_geometry(s, frames, 0.0))(x, y)
    for i, f in enumerate(frames):
        got = whole(s, sky, int(f))[y.astype(int), x.astype(int)]
        assert np.abs(got - exact[i]).max() * 2.0 <= 1.5 * sky.error_e
    assert sky.error_e < 0.05 * facts_with_sky(facts, s, sky).sigma_floor_e
    assert sky.least_e_s <= exact.min() + sky.error_e
    assert len(sky.knots) < 400


def test_light_is_told_of_the_first_and_the_last_frame(scene):
    """Two frames 20 degrees apart: the plan's span is that of the pixels of both."""
    apart = {"exposure.frames": 2, "exposure.cadence_s": 12_000.0}
    s, _, sky, _ = planned(scene, ZODIACAL | LONG | apart | {"background.uniform_e_per_s": 0.0})
    first, last = (whole(s, sky, frame) for frame in (0, 1))
    assert first.max() < 0.95 * last.max() or last.max() < 0.95 * first.max()
    (told,) = (d.reason for d in sky.decisions if d.component == "background.zodiacal")
    low, high = re.match(r"(\S+) to (\S+) e-/s per pixel", told).groups()
    assert float(low) == pytest.approx(min(first.min(), last.min()), rel=1e-3)
    assert float(high) == pytest.approx(max(first.max(), last.max()), rel=1e-3)


def test_same_bits_in_any_tile_and_after_pickling(scene):
    s, _, sky, _ = planned(scene, ZODIACAL | {"sensor.shape": [300, 520]})
    all_of_it = sky_tile(sky, 0, Tile(0, 0, 0, 0, 300, 520))
    again = pickle.loads(pickle.dumps(sky))
    for tile in plan_tiles(s):
        part = all_of_it[tile.y0 : tile.y0 + tile.rows, tile.x0 : tile.x0 + tile.columns]
        np.testing.assert_array_equal(sky_tile(again, 0, tile), part)
    np.testing.assert_array_equal(
        sky_tile(sky, 0, Tile(0, 0, 17, 33, 101, 202)), all_of_it[17:118, 33:235]
    )


def test_against_the_table_through_the_camera(scene):
    """A small field at the ecliptic pole: table value, solid angle, pupil and band by hand."""
    pole = {"pointing": {"mode": "sidereal", "boresight_ra_deg": 270.0,
                         "boresight_dec_deg": 66.5607},
            "stars": None, "background": {"zodiacal": True, "uniform_e_per_s": 0.0}}  # fmt: skip
    s, facts, sky, _ = planned(scene, pole)
    response, *_ = gather_response(s)
    from pipeline.inputs.band.curves import solar_spectrum
    from pipeline.physics.sky.zodiacal import band_rates

    w, e, _, _ = solar_spectrum()
    _, far = band_rates(w, e, response)
    distance = sky_distance_au(s)
    by_hand = 77e-8 * far * facts.area_m2 * facts.ifov_rad**2 * distance**-2.3
    assert whole(s, sky)[128, 128] == pytest.approx(by_hand, rel=5e-3)


@pytest.mark.parametrize("aberration", [True, False])
def test_the_light_of_a_pixel_is_of_where_its_star_is(scene, aberration):
    """In the middle the place that is looked at, wherever the camera must point to for it."""
    fast = {"observer": WIDE["observer"] | {"velocity_m_s": [0, 0, 3e4]},
            "stars": {"catalogue": "n", "aberration": aberration, "deflection": False}}  # fmt: skip
    s = scene(copy.deepcopy(WIDE | fast))
    g, camera = plan_geometry(s, np.zeros(1, int), 0.0), camera_of(s)
    there = from_angles(*np.radians(FIELD_DEG))
    light = LightOfSky(s, camera, None, None, None)
    x, y = np.array(camera.centre_px)[:, None]
    assert separation(light.directions(g, 0, g.middle, x, y), there[None])[0] < 1e-9
    turned_rad = 3e4 / SPEED_OF_LIGHT_M_S * np.cos(np.radians(FIELD_DEG[1])) if aberration else 0.0
    boresight = g.attitude[0, g.middle, 2]
    assert separation(boresight[None], there[None])[0] == pytest.approx(turned_rad, abs=1e-8)


def sky_distance_au(s):
    g = plan_geometry(s, sampled_frames(s), 0.0)
    v = g.sun_m[0, g.middle] - g.observer_m[0, g.middle]
    return np.sqrt(v @ v) / 149_597_870_700.0


def test_galactic_light_is_brighter_in_the_plane(scene):
    wish = {"stars": None, "background": {"galactic": True, "uniform_e_per_s": 0.0},
            "sensor.shape": [16, 16]}  # fmt: skip
    found = []
    for ra, dec in ((266.4, -28.9), (192.86, 27.13)):  # the galactic centre, the pole
        at = {"mode": "sidereal", "boresight_ra_deg": ra, "boresight_dec_deg": dec}
        s, _, sky, _ = planned(scene, wish | {"pointing": at})
        found.append(whole(s, sky).mean())
    assert 10.0 < found[0] / found[1] < 100.0


def test_solid_angle_of_a_wide_field(scene):
    """A uniform sky of stars' counts fades to the corners as cos^3 of the angle off axis."""
    wide = {"stars": None, "background": {"zodiacal": True, "uniform_e_per_s": 0.0},
            "sensor.focal_length_m": 10e-6 / np.radians(30.0 / 256),
            "pointing": {"mode": "sidereal", "boresight_ra_deg": 270.0,
                         "boresight_dec_deg": 66.5607}}  # fmt: skip
    s, _, sky, _ = planned(scene, wide)
    image = whole(s, sky)
    tangent = np.hypot(127.5, 127.5) * np.radians(30.0 / 256)
    corners = image[[0, 0, -1, -1], [0, -1, 0, -1]].mean() / image[127:129, 127:129].mean()
    assert corners == pytest.approx((1 + tangent**2) ** -1.5, rel=0.12)
    told = {d.component: d for d in sky.decisions}
    assert "bilinear" in told["background.grid"].reason


@pytest.mark.parametrize(
    ("changes", "field", "said"),
    [
        ({"pointing.boresight_ra_deg": 180.0, "pointing.boresight_dec_deg": 3.0},
         "background.zodiacal", "15 degrees"),
        ({"pointing.boresight_ra_deg": 180.3, "pointing.boresight_dec_deg": 0.0,
          "background": {"zodiacal": {"near_sun": "extrapolate"}, "uniform_e_per_s": 0.0}},
         "background.zodiacal", "2 degrees"),
        ({"observer": {"kind": "fixed", "position_au": [5.2, 0.0, 0.0]}}, "observer", "0.3 to 3"),
        ({"observer": {"kind": "fixed", "position_au": [0.0, -0.4, 0.92]}}, "observer",
         "8[0-9.]+ deg off the ecliptic.*30 degrees"),
        ({"pointing.boresight_ra_deg": 180.0, "pointing.boresight_dec_deg": 12.0},
         "background.zodiacal", "15 degrees or more; near_sun: extrapolate goes to 2"),
    ],
)  # fmt: skip
def test_refusals(scene, changes, field, said):
    """The Sun stands at RA 180 for an observer at +x."""
    with pytest.raises(BadInput, match=said) as caught:
        planned(scene, ZODIACAL | changes)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("degrees", "found"),
    [(14.94, "14.9"), (14.98, "just below 15"), (14.99999, "just below 15"), (0.0399, "0.0399")],
)
def test_an_angle_that_is_refused_does_not_read_as_allowed(degrees, found):
    with pytest.raises(BadInput, match="15 degrees or more") as caught:
        _check_elongation(np.radians(degrees), None)
    assert caught.value.value == f"{found} deg from the Sun in the field"
    _check_elongation(np.radians(15.0), None)


def test_zodiacal_light_off_the_ecliptic_is_told_with_its_size(scene):
    """A fan of dust, exp(-2.1 |sin b|), is 1.2 times fainter at 5.3 degrees, where it is drawn."""
    told = {}
    for name, place in (("in", [0.0, 0.918, 0.398]), ("off", [0.0, 0.918, 0.3])):
        changes = ZODIACAL | {"observer": {"kind": "fixed", "position_au": place}}
        told[name] = planned(scene, changes)[2].remarks
    assert not told["in"]
    assert len(told["off"]) == 1
    assert re.search(r"5\.[2-5]\d? deg off the ecliptic.* 1\.2 times too bright", *told["off"])


def test_the_frame_farthest_off_the_ecliptic_is_told(scene):
    """One frame in the plane, one 5.3 degrees beside it, in either order."""
    s = planned(scene, ZODIACAL)[0]
    places = np.array([[0.0, 0.918, 0.398], [0.0, 0.918, 0.3]])[:, None]
    for observer in (places, places[::-1]):
        g = SimpleNamespace(sun_m=np.zeros((2, 1, 3)), observer_m=observer, middle=0)
        (told,) = off_plane_remarks(s, g)
        assert re.search(r"5\.[2-5]\d? deg off", told)


def test_extrapolated_near_the_sun(scene):
    s, _, sky, _ = planned(scene, {
        "stars": None, "pointing.boresight_ra_deg": 172.0, "pointing.boresight_dec_deg": 0.0,
        "background": {"zodiacal": {"near_sun": "extrapolate"}, "uniform_e_per_s": 0.0},
    })  # fmt: skip
    image = whole(s, sky)
    assert np.isfinite(image).all()
    assert image.max() > 1.5 * image.min()


def test_uniform_sky_keeps_its_value(scene):
    """Where the parts vary by less than the target, one value stands for the frame."""
    small = {"sensor.focal_length_m": 5.0, "sensor.shape": [64, 64], "sensor.read_noise_e": 30.0}
    s, facts, sky, _ = planned(scene, ZODIACAL | small)
    assert sky_grid(sky, 0).shape == (1, 1)
    facts = facts_with_sky(facts, s, sky)
    assert facts.background_e == pytest.approx(sky.grids.min() * 10.0)
    assert facts.sigma_floor_e**2 == pytest.approx(
        facts.background_e + facts.read_noise_e**2 + 1 / 12, rel=1e-9
    )
    assert replace(facts) == facts


PARTS = {
    "uniform": {"uniform_mag_arcsec2": 19.0, "starlight": "none"},
    "zodiacal": {"zodiacal": True, "starlight": "none"},
    "galactic": {"galactic": True, "starlight": "none"},
    "starlight": {"starlight": "all"},
}


@pytest.mark.parametrize("part", PARTS)
def test_fill_factor_takes_its_fraction_of_every_part(scene, mapped, part):
    """A pixel that collects on 55 per cent of its area gets that fraction of each sky light."""
    changes = {"stars.faintest_g_mag": 14.0, "background": PARTS[part]}
    images = {}
    for fill in (1.0, 0.55):
        s, _, sky, _ = planned(scene, changes | {"sensor.fill_factor": fill}, (mapped,))
        images[fill] = whole(s, sky)
    assert images[1.0].min() > 0.0
    np.testing.assert_allclose(images[0.55], 0.55 * images[1.0], rtol=1e-3)


@pytest.mark.parametrize("up_deg", [20.0, 65.0])
def test_the_air_dims_undrawn_stars_as_it_does_drawn_ones(scene, up_deg):
    """0.3 mag for each air mass (Kasten & Young 1989); of diffuse light the share asked for."""
    site = {"kind": "ground", "latitude_deg": 0.0, "longitude_deg": 0.0, "atmosphere": {
        "extinction": {"mag_per_airmass": 0.3, "diffuse_share": 0.25}}}  # fmt: skip
    s = scene({"observer": site, "pointing": {
        "mode": "local", "azimuth_deg": 0.0, "elevation_deg": 60.0}})  # fmt: skip
    air = np.array([0.0, 0.6, 0.8, 0.0, 0.0])
    across, up = np.array([0.0, 0.8, -0.6]), np.radians(up_deg)
    observed = np.cos(up) * across + np.sin(up) * air[:3]
    names = ("starlight", "zodiacal", "galactic")
    extinction = gather_extinction(s, gather_response(s)[0])
    found = dimmed(s, extinction, air, observed[None], {n: np.array([2.0]) for n in names})
    mass = 1.0 / (np.sin(up) + 0.50572 * (up_deg + 6.07995) ** -1.6364)
    for name, part in zip(names, (1.0, 0.25, 0.25), strict=True):
        passed = 2.0 * 10.0 ** (-0.4 * 0.3 * part * mass)
        assert found[name][0] == pytest.approx(passed, rel=1e-3), name


def test_an_eclipsed_moon_gives_no_moonlight():
    """Totality of 21 January 2019 (5:12 UTC), and the night after; full light to 30% by hand."""
    for day, low, high in ((21.2167, 0.0, 0.0), (22.2167, 1.5e-6, 3e-6)):
        tt = np.array([2458483.5 + day]), np.array([69.2 / 86400])
        earth = earth_and_sun(*tt)
        share = _moon_share(np.zeros(3), earth.sun_from_earth_m[0], moon_m(*tt)[0])
        assert low <= share <= high


@pytest.mark.parametrize("zodiacal", [False, True])
def test_darkest_place_is_told_of_the_shortest_exposure(scene, zodiacal):
    """Its electrons, and the noise of them: with 30 and 2 s, those of 2 s."""
    light = {"uniform_e_per_s": 3.0, "zodiacal": zodiacal, "starlight": "none"}
    dwells = {"dwells": [{"frames": 2, "integration_s": [30.0, 2.0]}]}
    s, facts, sky, _ = planned(scene, {"background": light} | dwells)
    assert (sky.least_e_s > 3.01) == zodiacal
    told, sky_e = facts_with_sky(facts, s, sky), 2.0 * sky.least_e_s
    assert told.background_e == pytest.approx(sky_e)
    assert told.sigma_floor_e**2 == pytest.approx(sky_e + facts.read_noise_e**2 + 1 / 12)


@pytest.mark.parametrize("odd", [7.0, 13.0])
def test_what_the_mean_of_four_corners_would_err_is_told(odd):
    """The corner farthest from their mean, whether darker or brighter than the others."""
    grid = FrameGrid(10, 10, np.ones((1, 1, 1)), 0.0, True)
    corners = np.array([[10.0, 10.0, 10.0, 10.0], [10.0, odd, 10.0, 10.0]])
    told = _grid_told(grid, 0.0, 0.1, 2.0, 1.0, corners)
    assert "would err by 2.25 e- there" in told.reason
    assert told.error_bound_sigma == pytest.approx(0.05)


def test_the_background_of_the_facts_is_that_of_the_shortest_exposure(scene):
    """The least noise that a pixel has in any frame."""
    dwells = {"dwells": [{"integration_s": [8.0, 0.5], "frames": 2}], "exposure.integration_s": 2.0}
    glow = {"stars": None, "background": {"uniform_e_per_s": 3.0}}
    s, facts, sky, _ = planned(scene, glow | dwells)
    found = facts_with_sky(facts, s, sky)
    assert found.background_e == pytest.approx(0.5 * sky.least_e_s)
    assert found.background_e_s == sky.least_e_s > 0.0


@pytest.mark.parametrize("times_s", [(10.0,), (2.0, 10.0)])
@pytest.mark.parametrize("rows_per_s", [20.0, 40.0, -40.0])
def test_under_tdi_a_pixel_collects_the_sky_of_its_charges_way(scene, rows_per_s, times_s):
    """A uniform sky that fades to the edges as cos^4, over 60 degrees: its mean along as much of
    the way as is on the array, by quadrature. Each dwell has its own way."""
    pitch = np.radians(60.0 / 512)
    still = {"stars": None, "background": {"uniform_mag_arcsec2": 17.0},
             "sensor.focal_length_m": 10e-6 / pitch, "sensor.shape": [512, 64]}  # fmt: skip
    stares, _, even, _ = planned(scene, still)
    rows, image = np.arange(512.0), whole(stares, even)[:, 5]

    def light(y):
        return (1.0 + pitch**2 * ((5.0 - 31.5) ** 2 + (y - 255.5) ** 2)) ** -2

    bright = image[100] / light(100.0)
    np.testing.assert_allclose(image, bright * light(rows), rtol=1e-5)
    moving = still | {"sensor.detector": {"readout": {"kind": "tdi", "rows_per_s": rows_per_s}}}
    if len(times_s) > 1:
        moving |= {"dwells": [{"frames": 1, "integration_s": t} for t in times_s]}
    s, facts, sky, _ = planned(scene, moving)
    for k, time_s in enumerate(times_s):
        half = 0.5 * abs(rows_per_s) * time_s
        first, last = np.maximum(rows - half, -0.5), np.minimum(rows + half, 511.5)
        along = first[:, None] + (last - first)[:, None] * (np.arange(2000) + 0.5) / 2000.0
        wanted = bright * light(along).mean(axis=1)
        off_e = np.abs(whole(s, sky, k)[:, 5] - wanted).max() * time_s
        assert off_e <= 0.02 * facts.sigma_floor_e + 1e-5 * image.max() * time_s
        assert np.abs(wanted - image).max() * time_s > 10.0 * off_e


@pytest.mark.parametrize("asked", [{"uniform_e_per_s": 1.0, "starlight": "none"},
                                   {"zodiacal": True, "starlight": "none"}])  # fmt: skip
def test_light_that_is_not_asked_for_has_no_bound(scene, asked):
    """It is there all the same: how much is not looked up."""
    told = planned(scene, {"background": asked})[2].decisions
    parts = ("zodiacal", "galactic", "starlight")
    names = {f"background.{n}" for n in parts if asked.get(n) in (None, "none")}
    left_out = {d.component: d for d in told if not d.kept}
    assert names <= set(left_out)
    for d in left_out.values():
        assert d.reason == "not asked for"
        assert d.error_bound_e is None
        assert d.error_bound_sigma is None
