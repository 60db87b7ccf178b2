"""Tiles, decisions, responses and the plan as data."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import erfa
import numpy as np
import pytest
import scipy.fft
from scipy.special import erf, j1

from pipeline.errors import BadInput
from pipeline.physics.constants import ARCSEC_RAD, SPEED_OF_LIGHT_M_S, SUN_RADIUS_M
from pipeline.physics.drawing.stamps import draw_stamps
from pipeline.physics.drawing.wings import (
    CUT_FROM,
    add_wings,
    convolve,
    spread,
    wing_grid,
    wing_kernel,
)
from pipeline.physics.positions.apparent import (
    aberrate,
    proper_to_astrometric,
    unaberrate,
    unaberrated_caps,
)
from pipeline.physics.positions.focal_plane import deproject
from pipeline.physics.positions.refraction import unrefract
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import (
    compact_core,
    core_spectrum,
    phase_table,
    stamp_at,
    window,
)
from pipeline.physics.radiometry import ResponseCurve, box
from pipeline.physics.vectors import separation, unit
from pipeline.plan import needs
from pipeline.plan.checks import choose_checks
from pipeline.plan.cones import catalogue_cones, field_cones
from pipeline.plan.cost import CHECK_S, check_count, least_cpu_s
from pipeline.plan.described import plan_dict
from pipeline.plan.facts import Facts, ends_m, gather_facts
from pipeline.plan.needs import (
    CORE_S_PER_SAMPLE,
    StarForecast,
    drawing_s,
    frame_seconds,
    predict,
)
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import camera_of, plan_geometry
from pipeline.plan.pointing.star_paths import field_points
from pipeline.plan.response.decisions import core_ends
from pipeline.plan.response.responses import ResponsePlan, cut_share, plan_responses
from pipeline.plan.stars.faint import peak_share
from pipeline.plan.stars.field_stars import OwnMotion
from pipeline.plan.stars.shared_frames import _apart_px
from pipeline.plan.tiles import distance_px, plan_tiles, tile_shape
from pipeline.spec.scene import Scene
from tests.plans import plan_from
from tests.slow import slow

Make = Callable[..., Scene]
GAUSS = {"kind": "gaussian", "sigma_px": 0.8}


def facts_of(s: Scene) -> Facts:
    sensor = s.sensor
    values = (sensor.dark_e_per_s, sensor.read_noise_e, sensor.gain_e_per_dn)
    return gather_facts(s, box(400e-9, 900e-9), *(float(v) for v in values))


def plan_of(s: Scene) -> Plan:
    ends = plan_geometry(s, np.unique([0, s.exposure.frames - 1]), 0.0)
    return plan_from(s, facts_of(s), ends, 1e21, ("a remark",))


def responses_of(s: Scene, blur: Blur | None = None) -> ResponsePlan:
    ends = plan_geometry(s, np.unique([0, s.exposure.frames - 1]), 0.0)
    facts = facts_of(s)
    return plan_responses(s, replace(facts, blur=blur or facts.blur), camera_of(s), ends)


@pytest.mark.parametrize("shape", [[256, 256], [512, 768], [512, 256], [256, 768]])
def test_tiles_cover_each_pixel_once(scene: Make, shape: list[int]) -> None:
    s = scene({"output": {"tile_shape": shape}})
    count = np.zeros((512, 768), int)
    for t in plan_tiles(s):
        count[t.y0 : t.y0 + t.rows, t.x0 : t.x0 + t.columns] += 1
        assert (t.y0 % shape[0], t.x0 % shape[1]) == (0, 0)
    assert (count == 1).all()


def test_distances_are_to_the_centres_of_a_tiles_outer_pixels() -> None:
    """Of columns 20 to 27 and rows 10 to 14: inside, a pixel off each side, beyond a corner."""
    x = [20.0, 27.0, 23.5, 19.0, 28.0, 23.0, 23.0, 30.0, 16.0, 27.5]
    y = [10.0, 14.0, 12.2, 12.0, 12.0, 9.0, 15.0, 18.0, 7.0, 14.0]
    found = distance_px(np.array(x), np.array(y), y0=10, x0=20, rows=5, columns=8)
    assert found.tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 5.0, 5.0, 0.5]


def test_default_tiles_of_odd_frames(scene: Make) -> None:
    for rows, columns in ((1, 1), (300, 5000), (1025, 1023), (60_000, 1)):
        s = scene({"sensor.shape": [rows, columns]})
        assert tile_shape(s) == (min(1024, rows), min(1024, columns))
        assert sum(t.rows * t.columns for t in plan_tiles(s)) == rows * columns


@pytest.mark.parametrize("shape", [[100, 768], [512, 300], [768, 768], [256, 1024]])
def test_refused_tile_shapes(scene: Make, shape: list[int]) -> None:
    with pytest.raises(BadInput, match=r"output\.tile_shape"):
        scene({"output": {"tile_shape": shape}})


def test_facts_against_hand_reckoning(scene: Make) -> None:
    s = scene({"background": {"uniform_e_per_s": 3.0}, "sensor.dark_e_per_s": 0.5,
               "sensor.gain_e_per_dn": 2.0})  # fmt: skip
    f = facts_of(s)
    assert f.area_m2 == pytest.approx(math.pi / 4 * 0.16 * (1 - 0.09), rel=1e-12)
    assert f.ifov_rad == pytest.approx(1e-5)
    assert f.mean_wavelength_m == pytest.approx(650e-9, rel=1e-6)
    assert isinstance(f.blur.optics, Airy)
    assert f.blur.optics.q_px == pytest.approx(650e-9 * 1.0 / 0.4 / 1e-5)
    sigma = math.sqrt(6.0 + 1.0 + 25.0 + 4.0 / 12)
    assert f.sigma_floor_e == pytest.approx(sigma)
    # phases, the wings' grid and end, streaks; a quarter for the sky's grid, and for shared frames
    assert 4.5 * f.budget_e == pytest.approx(0.05 * sigma)


@pytest.mark.parametrize(("values", "ends_nm"), [
    ([0.0, 0.0, 0.5, 1.0, 0.0, 0.0], (400, 900)), ([0.1, 0.0, 0.5, 1.0, 0.0, 0.2], (300, 950)),
    ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], (300, 950)), ([0.0, 0.0, 0.0, 1.0, 0.0, 0.0], (500, 900)),
])  # fmt: skip
def test_a_band_ends_where_its_response_comes_to_nothing(values: list, ends_nm: tuple) -> None:
    """Between a point of 0 and the next one that is above it some of the light is counted."""
    wavelengths = np.array([300.0, 400.0, 500.0, 800.0, 900.0, 950.0]) * 1e-9
    found = ends_m(ResponseCurve(wavelengths, np.array(values)))
    assert np.array(found) * 1e9 == pytest.approx(ends_nm)


def test_each_frame_costs_its_drawing(scene: Make) -> None:
    """Of frames that share their stars, each group once."""
    few, many = (plan_of(scene({"exposure.frames": n})) for n in (100, 300))
    stars = StarForecast(1, 1, 10**6, 10**8, 10**6)
    frame_s, drawn_s = frame_seconds(many, stars), drawing_s(many, 10**6)
    assert 0.1 < drawn_s < frame_s
    more_s = predict(many, stars)["cpu_s"] - predict(few, stars)["cpu_s"]
    assert more_s >= 200 * frame_s
    together = [replace(plan, shared_frames=100) for plan in (few, many)]
    less_s = predict(together[1], stars)["cpu_s"] - predict(together[0], stars)["cpu_s"]
    assert more_s - less_s >= 198 * drawn_s  # not 200 drawings but 2
    told = [predict(replace(few, shared_frames=n), stars)["cpu_s"] for n in (99, 100, 101)]
    assert told[1] == told[2] == pytest.approx(told[0] - drawn_s, rel=0.2)  # a group begun is drawn


@pytest.mark.parametrize("table_mb", [None, 193.0])
def test_cores_that_are_not_kept_are_made_for_every_frame(
    scene: Make, monkeypatch: pytest.MonkeyPatch, table_mb: float | None
) -> None:
    """Those of every class for the stars, a group of frames together, and its truth's once more:
    where none has room, or tables of light take it all."""
    moffat = {"sensor.psf": {"kind": "moffat", "fwhm_px": 2.5}, "accuracy": {"check_cells": 0}}
    few, many = (plan_of(scene(moffat | {"exposure.frames": n})) for n in (5, 15))
    once = predict(few, None)["cpu_s"], predict(many, None)["cpu_s"]
    if table_mb is None:
        monkeypatch.setattr(needs, "TABLE_BYTES", 0.0)
    else:
        few, many = (
            replace(p, responses=replace(p.responses, table_mb=table_mb)) for p in (few, many)
        )
    radii = [c.radius_px for c in few.responses.classes]
    sizes = [compact_core(few.facts.blur, radius).samples.size for radius in radii]
    for together in (1, 5):
        more = [
            predict(replace(plan, shared_frames=together), None)["cpu_s"] - s
            for plan, s in zip((few, many), once, strict=True)
        ]
        made = 10 * (sum(sizes) / together + sizes[0])
        assert more[1] - more[0] == pytest.approx(CORE_S_PER_SAMPLE * made, rel=0.05)


def test_noise_floor_without_photon_noise(scene: Make) -> None:
    """Only reading and rounding hide errors then, in frames of every length, under every sky."""
    quiet = {"sensor.photon_noise": False, "background": {"uniform_e_per_s": 3000.0},
             "sensor.dark_e_per_s": 500.0, "sensor.gain_e_per_dn": 2.0}  # fmt: skip
    sigma = math.sqrt(25.0 + 4.0 / 12)
    for more in ({}, {"sensor.read_noise_e": 0.0}):
        plan = plan_of(scene(quiet | more))
        expected = sigma if not more else 2.0 / math.sqrt(12.0)
        assert plan.facts.sigma_floor_e == pytest.approx(expected)
        assert plan.floor_e(0) == pytest.approx(expected)
        assert plan.snr_floor_e2(0, *np.zeros((2, 1))) == pytest.approx(expected**2)
        assert plan.responses.budget_e <= 0.05 * expected


def test_rays_of_elsewhere_are_told(scene: Make) -> None:
    site = {"kind": "ground", "latitude_deg": 20.0, "longitude_deg": 10.0}
    for observer, source, told in (
        (site, "space", "the observer is on the ground"), (site, "ground", ""),
        ({"kind": "fixed", "position_au": [1.2, 0.1, 0.05]}, "space", ""),
        ({"kind": "fixed", "position_au": [1.2, 0.1, 0.05]}, "ground", "the observer is in space"),
    ):  # fmt: skip
        rays = {"kind": "generated", "source": source}
        asked = {"observer": observer, "cosmic_rays": rays, "accept": ["sun", "moon", "daylight"]}
        asked |= {"pointing": {"mode": "local", "azimuth_deg": 0.0, "elevation_deg": 60.0}} if (
            observer is site
        ) else {}  # fmt: skip
        (said,) = [d for d in plan_of(scene(asked)).decisions if d.component == "cosmic_rays"]
        assert ("though" in said.reason) == bool(told)
        assert told in said.reason


def test_decisions_list_what_is_absent_with_reason_and_bound(scene: Make) -> None:
    s = scene({"stars": None, "sensor.read_noise_e": None, "sensor.psf": GAUSS})
    decisions = {d.component: d for d in plan_of(s).decisions}
    for name in ("stars", "targets", "background", "cosmic_rays", "flat", "dark", "full_well",
                 "read_noise", "bias"):  # fmt: skip
        assert not decisions[name].kept
        assert decisions[name].reason
        assert decisions[name].error_bound_e == 0.0
        assert decisions[name].error_bound_sigma == 0.0
    assert all(d.reason for d in decisions.values())


def test_decisions_list_effects_and_approximations(scene: Make) -> None:
    s = scene({"stars.parallax": False, "background": {"uniform_mag_arcsec2": 21.0},
               "sensor.full_well_e": 1e5})  # fmt: skip
    plan = plan_of(s)
    decisions = {d.component: d for d in plan.decisions}
    assert len(decisions) == len(plan.decisions)
    assert not decisions["stars.parallax"].kept
    assert "switched off" in decisions["stars.parallax"].reason
    for name in ("stars", "background", "full_well", "stars.aberration", "read_noise"):
        assert decisions[name].kept
    for name in ("phase_interpolation", "wings_on_a_coarse_grid", "wings_cut_off"):
        bound = decisions[name].error_bound_e
        assert bound is not None
        assert 0 < bound < plan.facts.sigma_floor_e
        assert decisions[name].error_bound_sigma == pytest.approx(bound / plan.facts.sigma_floor_e)


def test_parallax_is_stated_for_where_the_observer_is(scene: Make) -> None:
    """Proxima's 0.768 arcsec for each au from the barycentre."""
    far = {"kind": "fixed", "position_au": [24.0, 32.0, 0.0]}
    told = {d.component: d for d in plan_of(scene({"observer": far})).decisions}["stars.parallax"]
    assert (told.bound, told.unit) == (pytest.approx(0.768 * 40.0, rel=0.01), "arcsec")


def test_decisions_own_up_to_what_is_left_out(scene: Make) -> None:
    """What could be done in another order or rounded otherwise, and what is left out, is told."""
    target = {
        "name": "t",
        "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]},
        "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.5},
    }
    s = scene({"targets": [target], "background": {"uniform_mag_arcsec2": 20.0},
               "sensor.full_well_e": 1e5, "sensor.adc_rounding": "floor",
               "sensor.focal_length_m": 0.02, "sensor.psf": GAUSS})  # fmt: skip
    plan = plan_of(s)
    decisions = {d.component: d for d in plan.decisions}
    assert "before read noise" in decisions["full_well"].reason
    assert "floor" in decisions["adc"].reason
    assert decisions["adc"].bound == 1.0
    halves = plan_of(scene({"sensor.adc_rounding": "half_even"})).decisions
    assert next(d for d in halves if d.component == "adc").bound == 0.5
    for name in ("targets.earthshine", "earth_occultation", "stars.doppler"):
        assert not decisions[name].kept
    assert "less than its middle" in decisions["pupil_projection"].reason


def test_wing_bound_says_up_to_which_light_it_holds(scene: Make) -> None:
    plan = plan_of(scene({"sensor.pixel_pitch_um": 20.0}))
    last = plan.responses.classes[-1]
    reason = {d.component: d.reason for d in plan.decisions}["wings_on_a_coarse_grid"]
    assert f"up to {plan.responses.budget_e / last.wing_error:.3g} e-" in reason


def test_plan_is_json_without_nan(scene: Make) -> None:
    for changes in ({}, {"sensor.psf": GAUSS}, {"stars": None}, {"exposure.frames": 1}):
        data = plan_dict(plan_of(scene(changes)), None)
        text = json.dumps(data, allow_nan=False)
        assert json.loads(text)["frames"] == (1 if "exposure.frames" in changes else 5)
        assert data["predicted"]["cpu_s"] > 0


def test_light_left_out_stays_within_the_flux_target(scene: Make) -> None:
    for fraction in (1e-3, 1e-2):
        r = responses_of(scene({"accuracy": {"flux_fraction": fraction}}))
        assert r.lost_light <= fraction
    for psf in (GAUSS, {**GAUSS, "jitter_px": 4.0}, {**GAUSS, "charge_diffusion_px": 3.0}):
        r = responses_of(scene({"sensor.psf": psf}))
        core = compact_core(r.blur, r.classes[0].radius_px)
        assert core.light == pytest.approx(1.0, abs=1e-6)


def test_field_cone_holds_the_frame(scene: Make) -> None:
    plan = plan_of(scene())
    g = plan_geometry(plan.scene, np.arange(5), 0.0)
    centres, radii = field_cones(plan, g)
    star = erfa.s2c(np.radians(40), np.radians(25))
    assert np.degrees(np.arccos(np.clip(centres @ star, -1, 1))).max() < 0.001
    assert (radii > np.arctan(np.hypot(256, 384) * 1e-5)).all()
    assert (radii < 0.02).all()


def test_field_cone_holds_what_drifts_into_the_frame(scene: Make) -> None:
    """Directions of the frame's corners at the start and the end of a streak of 970 px."""
    drift = {"mode": "rate", "boresight_ra_deg": 40.0, "boresight_dec_deg": 0.0,
             "rate_ra_arcsec_s": 1000.0, "rate_dec_arcsec_s": 0.0}  # fmt: skip
    plan = plan_of(scene({"pointing": drift}))
    g = plan_geometry(plan.scene, np.arange(1), 0.0)
    centres, radii = field_cones(plan, g)
    for axes in (g.attitude[0, 0], g.attitude[0, -1]):
        for x, y in ((-384, -256), (-384, 256), (384, -256), (384, 256)):
            corner = unit(axes[2] + 1e-5 * (x * axes[0] + y * axes[1]))
            assert separation(centres, corner)[0] < radii[0]


def test_field_cone_holds_the_frame_behind_air(scene: Make) -> None:
    """Low in the sky, where refraction lifts stars by minutes of arc: places of the corners."""
    site = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3,
            "atmosphere": {"refraction": True}}  # fmt: skip
    at = {"mode": "local", "azimuth_deg": 70.0, "elevation_deg": 16.0}
    field = {"sensor.shape": [1024, 1024], "sensor.focal_length_m": 1e-5 / ARCSEC_RAD,
             "sensor.psf": GAUSS}  # fmt: skip
    plan = plan_of(scene({"observer": site, "pointing": at} | field))
    g = plan_geometry(plan.scene, np.arange(1), 0.0)
    centres, radii = field_cones(plan, g)
    seen = deproject(plan.camera, g.attitude[0, g.middle], *field_points(plan.camera))
    stars = unrefract(seen, g.air_at(0, g.middle))
    places = unaberrate(stars, g.observer_m_s[0, g.middle] / SPEED_OF_LIGHT_M_S)
    assert separation(seen, stars).min() > 100.0 * ARCSEC_RAD
    assert (separation(places, centres[0]) < radii[0]).all()


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_cones_hold_stars_that_the_sun_has_moved_into_them(scene: Make, side: float) -> None:
    """A degree and less from the Sun: catalogue places of all that is seen in a small cone.

    Light is bent by up to 1.75 arcsec, so that the stars of a cone of 0.4 arcsec at the limb are
    all of them outside of the same cone of the catalogue.
    """
    plan = plan_of(scene())
    g = plan_geometry(plan.scene, np.zeros(1, np.int64), 0.0)
    observer = g.observer_m[0, g.middle], g.observer_m_s[0, g.middle], g.sun_m[0, g.middle]
    to_sun = observer[2] - observer[0]
    distance, sunward = np.linalg.norm(to_sun), unit(to_sun)
    across = unit(np.cross(sunward, [0.0, 0.0, side]))
    outside = []
    beta, radius = observer[1] / SPEED_OF_LIGHT_M_S, 0.4 * ARCSEC_RAD
    for angle in (1.001 * SUN_RADIUS_M / distance, np.radians(0.5), np.radians(1.0)):
        centre = np.cos(angle) * sunward + np.sin(angle) * across
        centre = aberrate(centre, beta)
        centres, radii = catalogue_cones(plan.scene, g, centre[None], radius)
        turn = np.linspace(0.0, 2.0 * np.pi, 40)[:, None]
        one = unit(np.cross(centre, [0.3, 0.5, 0.8]))
        rim = np.cos(turn) * one + np.sin(turn) * np.cross(centre, one)
        seen = unit(np.cos(radius) * centre + np.sin(radius) * rim)
        places = proper_to_astrometric(seen, observer)
        assert (separation(places, centres[0]) <= radii[0]).all()
        bare = unaberrated_caps(centre[None], np.array([radius]), beta[None])
        outside.append((separation(places, bare[0][0]) > bare[1][0]).mean())
    assert outside[0] == 1.0  # without the margin for deflection not one star of it is found
    assert outside[1] > 0.0


def airy_pixel(dx: float, dy: float, q: float, eps: float) -> float:
    """Light of an obscured Airy pattern in a pixel, by Gauss-Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    at = ((np.arange(8)[:, None] + 0.5 + nodes / 2) / 8).ravel() - 0.5
    w = np.tile(weights / 16, 8)
    x = np.pi * np.maximum(np.hypot(dx + at, dy + at[:, None]), 1e-9) / q
    amplitude = 2 * j1(x) / x - (eps * 2 * j1(eps * x) / x if eps else 0.0)
    return float(w @ (np.pi / (4 * q * q * (1 - eps * eps)) * amplitude**2) @ w)


@pytest.mark.parametrize(("q", "eps"), [(0.5, 0.3), (1.0, 0.3), (1.0, 0.6)])
def test_what_ends_with_the_wings_is_within_its_bound_in_every_class(
    scene: Make, q: float, eps: float
) -> None:
    """Light of pixels beyond where wings begin to end, against the plan's bound."""
    plan = plan_of(scene({"background": {"uniform_mag_arcsec2": 21.0}}))
    r = responses_of(scene(), Blur(Airy(q, eps)))
    radii = CUT_FROM * r.reach_px + np.arange(0.0, 5.0 * q, 0.37 * q)
    turned = 0.6 * radii, 0.8 * radii
    found = [airy_pixel(x, 0.0, q, eps) for x in radii]
    found += [airy_pixel(x, y, q, eps) for x, y in zip(*turned, strict=True)]
    share = cut_share(r.blurs, r.reach_px)
    assert max(found) <= share <= 12.0 * max(found)
    decision = next(d for d in plan.decisions if d.component == "wings_cut_off")
    limits = [c.brightest_e for c in plan.responses.classes[:-1]]
    drawn = plan.responses
    cut_e = cut_share(drawn.blurs, drawn.reach_px) * max(limits)
    assert decision.error_bound_e == pytest.approx(cut_e)


@pytest.mark.parametrize("light_e", [1e3, 1e7, 1e9, 1e12])
def test_a_core_ends_where_next_to_nothing_is_left(scene: Make, light_e: float) -> None:
    """A Gaussian's pixel just beyond its core, by the error function, against the bound."""
    plan = plan_of(scene({"sensor.psf": GAUSS}))
    usual, whole = plan.responses.classes
    core, sigma = usual if light_e <= usual.target_e else whole, math.sqrt(2.0) * 0.8
    left = math.erfc(core.radius_px / sigma) - math.erfc((core.radius_px + 1.0) / sigma)
    found = 0.5 * light_e * left * math.erf(0.5 / sigma)
    told = core_ends(plan.responses, light_e, plan.facts.sigma_floor_e).error_bound_e
    assert 0.0 < found <= told <= plan.responses.budget_e
    # where no brightest source is known, of the brightest that a usual core serves
    unknown, known = (
        core_ends(plan.responses, e, plan.facts.sigma_floor_e) for e in (0.0, usual.target_e)
    )
    assert unknown == known


def test_without_stars_no_tables_are_told(scene: Make) -> None:
    one = {
        "name": "one",
        "eclipse": False,
        "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3075, 0]},
        "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2},
    }
    plan = plan_of(scene({"stars": None, "targets": [one], "sensor.psf": GAUSS}))
    names = [d.component for d in plan.decisions]
    assert "phase_interpolation" not in names
    assert names.count("core_ends") == 1


@pytest.mark.parametrize(("q", "eps"), [(0.5, 0.3), (2.0, 0.0), slow(1.0, 0.3)])
def test_brightest_source_of_each_class_stays_within_the_budget(
    scene: Make, q: float, eps: float
) -> None:
    """Drawn with its class's core, table and wing: two of the four shares of the noise budget.

    In units of each pixel's own noise, its source's photons included, as Accuracy asks.
    """
    s = scene()
    r, floor_e = responses_of(s, Blur(Airy(q, eps))), facts_of(s).sigma_floor_e
    rng = np.random.default_rng(2)
    limited = [c for c in r.classes if math.isfinite(c.brightest_e)]
    assert limited
    assert [c.brightest_e for c in limited] == sorted(c.brightest_e for c in limited)
    for c in limited:
        if c.radius_px > 100 or not c.phases:
            continue
        core = compact_core(r.blur, c.radius_px)
        half_y, half_x, *period = window(core, 0.0, 0.0)
        spectrum = core_spectrum(core, *period)
        table = phase_table(core, spectrum, (half_y, half_x), tuple(period), c.phases)
        size = int(3 * c.radius_px) + 21
        grid = wing_grid((size, size), (0, 0), r.spacing_px, r.reach_px)
        kernel = wing_kernel(r.blur, core, grid, r.reach_px)
        worst = 0.0
        for _ in range(4):
            place = rng.uniform(size / 2 - 2, size / 2 + 2, (2, 1))
            light = np.array([c.brightest_e])
            cubic = light * table.linear_error > r.budget_e
            image = np.zeros((size, size))
            if light[0] * table.cubic_error <= r.budget_e:
                draw_stamps(image, (0, 0), table, *place, light, cubic)
            else:  # as it is drawn then: without the table
                at = stamp_at(core, spectrum, (half_y, half_x), tuple(period), *place[::-1, 0])
                rows, columns = (slice(k, k + n) for k, n in zip(at[:2], at[2].shape, strict=True))
                image[rows, columns] += light[0] * at[2]
            field = convolve(scipy.fft.rfft2(spread(grid, *place, light)) * kernel, grid)
            add_wings(image, (0, 0), grid, field)
            x, y = (float(p[0]) for p in place)
            for _ in range(40):
                rho, angle = rng.uniform(0, 1.4 * c.radius_px), rng.uniform(0, 2 * np.pi)
                i, j = round(y + rho * np.sin(angle)), round(x + rho * np.cos(angle))
                exact = c.brightest_e * airy_pixel(j - x, i - y, q, eps)
                share = abs(image[i, j] - exact) / math.sqrt(floor_e**2 + exact)
                worst = max(worst, share / (s.accuracy.noise_fraction / 4.0))
        assert worst <= 2.0, (c, worst)


@pytest.mark.parametrize("optics", [Gaussian(0.3), Gaussian(0.5), Airy(0.12), Airy(0.5, 0.3)])
def test_interpolation_of_a_full_pixel_stays_within_the_budget(
    scene: Make, optics: Gaussian | Airy
) -> None:
    """A star that fills a well of 1e5 e-, cubically between the plan's phases."""
    r = responses_of(scene(), Blur(optics))
    c = r.classes[0]
    core = compact_core(r.blur, c.radius_px)
    half_y, half_x, *period = window(core, 0.0, 0.0)
    spectrum = core_spectrum(core, *period)
    table = phase_table(core, spectrum, (half_y, half_x), tuple(period), c.phases)
    light = 1e5 / table.peak
    assert light * table.cubic_error <= 0.05 / 4.0 * math.sqrt(1e5)


def test_gaussian_has_two_classes_without_wings(scene: Make) -> None:
    r = responses_of(scene({"sensor.psf": GAUSS}))
    assert isinstance(r.blur.optics, Gaussian)
    assert (len(r.classes), r.spacing_px) == (2, 0)
    assert r.classes[1].brightest_e == pytest.approx(r.budget_e / 1e-14)  # then by quadrature
    for core in r.classes:  # what lies beyond a core does not show
        beyond = r.blur.light_beyond(core.radius_px)
        assert min(core.brightest_e, 1e12) * beyond <= 1.001 * r.budget_e


@pytest.mark.parametrize(
    ("place", "cell"),
    [((700.2, 30.9), (0, 2)), ((30.9, 300.2), (1, 0)), ((255.4, 255.5), (1, 0)),
     ((255.5, 255.4), (0, 1)), ((767.4, 511.4), (1, 2)), ((-0.5, -0.5), (0, 0)),
     ((767.5, 5.0), None), ((5.0, 511.5), None)],
)  # fmt: skip
def test_cells_that_are_checked(scene: Make, place: Any, cell: tuple[int, int] | None) -> None:
    """First the target's, in the first frame; then the middle, corners, and others: each once."""
    orbit = {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]}
    ball = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.3}
    s = scene({"targets": [{"name": "t", "orbit": orbit, "body": ball}], "accuracy": {
        "check_cells": 9}})  # fmt: skip
    g = plan_geometry(s, np.array([0, 3, 4]), 0.0)
    x, y = (np.full(g.target_x_px.shape, v) for v in place)
    found = choose_checks(s, replace(g, target_x_px=x, target_y_px=y))
    fixed = [(0, 1, 1), (3, 0, 0), (4, 1, 2)]  # of 2 x 3 cells
    wanted = ([] if cell is None else [(0, *cell)]) + fixed
    cells = [(c.frame, c.row, c.column) for c in found]
    assert cells[: len(wanted)] == list(dict.fromkeys(wanted))
    assert len(cells) == len(set(cells)) == 9
    assert all(f in (0, 3, 4) and r in (0, 1) and c in (0, 1, 2) for f, r, c in cells)


@pytest.mark.parametrize(("bits", "width"), [(8, 1), (16, 2), (17, 4), (33, 8)])
def test_bytes_of_a_product(scene: Make, bits: int, width: int) -> None:
    """Digital numbers are always kept, in the type that holds them; other layers take 4 bytes."""
    for layers, more in ((["dn"], 0), (["mean_e"], 4), (["stars_e", "dn", "mean_e"], 8)):
        plan = plan_of(scene({"sensor.adc_bits": bits, "output": {"layers": layers}}))
        told = predict(plan, None)["product_mb"]
        assert told == pytest.approx(5 * 512 * 768 * (width + more) / 1e6, rel=1e-12)


@pytest.mark.parametrize(
    ("shape", "tile"),
    [([4096, 3000], (4096, 256)), ([512, 3000], (512, 2048)), ([512, 700], (512, 700)),
     ([700, 2000], (700, 1280)), ([60_000, 300], (60_000, 256))],
)  # fmt: skip
def test_tiles_of_whole_columns(scene: Make, shape: list[int], tile: tuple[int, int]) -> None:
    """About a million pixels of whole cells where charge runs along columns."""
    s = scene({"sensor.shape": shape, "sensor.full_well_e": 1e5,
               "sensor.detector": {"blooming": True}})  # fmt: skip
    assert tile_shape(s) == tile


@pytest.mark.parametrize(("roll", "px"), [(0.0, 40.0), (45.0, 40.0), (45.0, 1.2), (20.0, 0.0)])
def test_no_pixel_takes_more_of_a_star_than_is_told(scene: Make, roll: float, px: float) -> None:
    """A sharp Gaussian on a streak, along an axis and across pixels' diagonals, by brute force."""
    arcsec = np.degrees(1e-5) * 3600.0 * px / 2.0
    s = scene({"sensor.psf": {"kind": "gaussian", "sigma_px": 0.1}, "pointing": {
        "mode": "rate", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0, "roll_deg": roll,
        "rate_ra_arcsec_s": arcsec, "rate_dec_arcsec_s": 0.0}})  # fmt: skip
    told = peak_share(facts_of(s).blur, camera_of(s), plan_geometry(s, np.arange(2), 0.0), True)
    way = px * np.linspace(-0.5, 0.5, 20_001)
    x, y = way * np.cos(np.radians(roll)), way * np.sin(np.radians(roll))
    edge = np.array([-0.5, 0.5])[:, None] / (0.1 * np.sqrt(2.0))
    along, down = (0.5 * np.diff(erf(edge + v / (0.1 * np.sqrt(2.0))), axis=0) for v in (x, y))
    drawn = float(np.mean(along * down))
    assert drawn <= told <= 1.8 * drawn
    assert px > 1.0 or told <= 1.0


@pytest.mark.parametrize(("sigma", "fill"), [(0.1, 0.5), (0.3, 0.25), (0.15, 0.9), (1.0, 0.5)])
def test_a_pixel_with_gaps_may_take_all_of_a_sharp_star(
    scene: Make, sigma: float, fill: float
) -> None:
    """A star in the middle of the collecting square, whose mean over places is the fill factor."""
    s = scene({"sensor.psf": {"kind": "gaussian", "sigma_px": sigma}, "sensor.fill_factor": fill})
    told = peak_share(facts_of(s).blur, camera_of(s), plan_geometry(s, np.arange(2), 0.0), True)
    most = erf(0.5 * math.sqrt(fill) / (sigma * math.sqrt(2.0))) ** 2
    assert most <= told * (1.0 + 1e-3)
    assert told <= min(1.0, 1.8 * most)


@pytest.mark.parametrize(
    ("shape", "frames", "asked", "count"),
    [([64, 64], 1, 3, 1), ([64, 64], 2, 3, 2), ([300, 600], 1, 9, 6), ([512, 512], 4, 3, 3)],
)
def test_no_more_cells_are_checked_than_there_are(
    scene: Make, shape: list[int], frames: int, asked: int, count: int
) -> None:
    """What a scene is forecast to take holds the checks that it gets; none without sources."""
    wish = {"sensor.shape": shape, "exposure.frames": frames, "accuracy": {"check_cells": asked}}
    assert check_count(scene(wish)) == count
    assert check_count(scene(wish | {"stars": None})) == 0
    ball, orbit = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.5}, {
        "kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]
    }  # fmt: skip
    others = [{"targets": [{"name": "t", "orbit": orbit, "body": ball}]},
              {"populations": [{"name": "all", "path": "all.tle", "body": ball}]}]  # fmt: skip
    assert [check_count(scene(wish | {"stars": None} | one)) for one in others] == [count] * 2
    more = least_cpu_s(scene(wish)) - least_cpu_s(scene(wish | {"stars": None}))
    assert more == pytest.approx(count * CHECK_S)


def test_layers_cost_the_same_in_whatever_order_and_with_dn_or_without(scene: Make) -> None:
    """The raw frame is always kept; each other layer costs its packing."""
    costs = [
        least_cpu_s(scene({"output": {"layers": layers}}))
        for layers in (["dn"], ["mean_e"], ["dn", "mean_e"], ["mean_e", "stars_e"])
    ]
    assert costs[1] == costs[2]
    assert costs[1] - costs[0] == pytest.approx(costs[3] - costs[2], rel=1e-9)


def test_the_field_told_is_in_degrees(scene: Make) -> None:
    """Rows and columns of pixels of pitch over focal length."""
    cut = scene({"sensor.shape": [300, 500], "sensor.focal_length_m": 0.9})
    pixel_deg = np.degrees(cut.sensor.pixel_pitch_um * 1e-6 / 0.9)
    told = plan_dict(plan_of(cut), None)["field_deg"]
    assert told == pytest.approx([300 * pixel_deg, 500 * pixel_deg], rel=1e-6)


def test_what_moving_charge_leaves_of_a_star_is_told_in_pixels(scene: Make) -> None:
    """At rest in the sky, for 3 s, while charge moves 5 rows/s: 15 px along the columns."""
    readout = {"readout": {"kind": "tdi", "rows_per_s": 5.0}}
    cut = scene({"sensor.detector": readout, "exposure.integration_s": 3.0})
    [told] = [d.reason for d in plan_of(cut).decisions if "charge moves 5 rows/s" in d.reason]
    assert "so that it streaks 15 px along" in told


@pytest.mark.parametrize("edges", ["full", "partial"])
def test_the_rows_that_charge_leaves_are_those_of_the_longest_exposure(
    scene: Make, edges: str
) -> None:
    """5 rows/s through 512 rows: 10 of them in 2 s, 300 in 60 s, more than all in 200 s."""
    readout = {"readout": {"kind": "tdi", "rows_per_s": -5.0, "edges": edges}}
    for longest_s, part in ((2.0, "0.0195"), (60.0, "0.586"), (200.0, "1")):
        dwells = [{"integration_s": [1.0, longest_s, 0.5], "frames": 3, "cadence_s": 300.0}]
        cut = scene({"sensor.detector": readout, "exposure.cadence_s": None, "dwells": dwells})
        assert any(f"the outer {part} of the rows" in d.reason for d in plan_of(cut).decisions)


def test_stars_of_frames_apart_are_as_far_off_as_their_own_motion_takes_them(scene: Make) -> None:
    """40 s of 1e9 mas a year, on a still camera of 10 um at 1 m; by parallax none: it stands."""
    s = scene({"sensor.psf": GAUSS})
    plan, g = plan_of(s), plan_geometry(s, np.array([0, 4]), 0.0)
    still, fast, near = (
        _apart_px(plan, g, OwnMotion(*own), 0, 1) for own in ((0.0, 0.0), (1e9, 0.0), (0.0, 1e9))
    )
    wanted = np.radians(1e6 * 40.0 / (365.25 * 86_400.0) / 3600.0) / 1e-5
    assert fast - still == pytest.approx(wanted, rel=1e-6)
    assert near == pytest.approx(still, abs=1e-9)
