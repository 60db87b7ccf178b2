"""Fields that turn: stars in the middle stand still while others streak; wings hold their bound."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.execute.blocks import render_block
from pipeline.execute.check import reference
from pipeline.execute.light import draw_along, draw_stars
from pipeline.execute.sources import streaks, zone_of
from pipeline.physics.drawing.wings import swept_apart
from pipeline.physics.psf.response import compact_core
from pipeline.plan.plan import Plan
from pipeline.plan.response import wing_sweeps as of_sweeps
from pipeline.plan.response.responses import FAINT_PART, MARGIN, NOTHING_BEYOND
from pipeline.plan.response.streaks import exact_path
from pipeline.plan.response.wing_sweeps import wing_sweeps
from pipeline.plan.response.zones import zone_of_frame
from pipeline.plan.tiles import Tile
from tests.execute.test_engines import SIDE, drawn, field, geometry_of, plan_of
from tests.execute.test_star_engines import plan_of as wide_plan_of

PIXEL_ARCSEC = np.degrees(1e-5) * 3600.0


def turning(roll_deg: float, psf: dict, dec_arcsec: float = 0.0) -> Plan:
    """A plan of one frame that turns about its middle, or drifts too; nothing is read."""
    return plan_of(psf, 0.0, -dec_arcsec / PIXEL_ARCSEC, roll_deg=roll_deg)


@pytest.mark.parametrize("psf", [{"kind": "airy", "wavelength_nm": 650.0},
                                 {"kind": "moffat", "fwhm_px": 2.1}])  # fmt: skip
def test_limits_of_cores_know_of_the_turn(psf):
    still, turns = turning(0.0, psf), turning(20.0, psf)
    for one, other in zip(still.responses.classes, turns.responses.classes, strict=True):
        assert other.radius_px == one.radius_px
        assert other.wing_error > one.wing_error or one.wing_error in (0.0, NOTHING_BEYOND[1])
    sweeps = wing_sweeps(turns.camera, geometry_of(turns), turns.responses.streaks.zones, True)
    corner_px = np.radians(20.0) * np.hypot(SIDE, SIDE) / 2.0
    assert sweeps.slowest_px < 1.0
    assert 0.2 * corner_px < sweeps.off_px < 0.5 * corner_px


@pytest.mark.parametrize("at", [(79.6, 79.8), (30.2, 130.7)])
def test_wings_of_every_star_hold_their_bound(at):
    """Stars as bright as their class may hold, in its middle and in a corner."""
    plan = turning(20.0, {"kind": "airy", "wavelength_nm": 650.0})
    told = [d.error_bound_e for d in plan.decisions if d.error_bound_sigma and d.error_bound_e]
    for core in plan.responses.classes[:2]:
        stars = field(*(np.array([v]) for v in (*at, 0.95 * core.brightest_e)))
        image = drawn(plan, stars, together=False)
        for row, column in ((-26, -8), (10, 4), (-8, -26), (-8, 10)):
            window = Tile(0, 0, int(at[1]) + row, int(at[0]) + column, 16, 16)
            exact, _ = reference(plan, geometry_of(plan), window, stars)
            off = image[window.y0 : window.y0 + 16, window.x0 : window.x0 + 16] - exact
            assert np.abs(off).max() <= sum(told) * np.sqrt(1.0 + exact.max() / 25.0)


def test_by_the_limits_of_a_field_that_does_not_turn_they_err_more():
    """What the rule is for: ten times the light, as if only the grid erred."""
    plan = turning(20.0, {"kind": "airy", "wavelength_nm": 650.0})
    careless = tuple(
        replace(c, brightest_e=10.0 / FAINT_PART * c.brightest_e) for c in plan.responses.classes
    )
    plan = replace(plan, responses=replace(plan.responses, classes=careless))
    star = field(*(np.array([v]) for v in (79.6, 79.8, 0.95 * careless[0].brightest_e)))
    image, window = drawn(plan, star, together=False), Tile(0, 0, 71, 89, 16, 16)
    exact, _ = reference(plan, geometry_of(plan), window, star)
    assert np.abs(image[71:87, 89:105] - exact).max() > plan.responses.budget_e


@pytest.mark.parametrize(("roll_deg", "dec_arcsec"), [(20.0, 60.0), (10.0, 60.0), (20.0, 30.0)])
def test_a_turn_about_another_place_is_looked_at_where_it_stands_still(roll_deg, dec_arcsec):
    """What is measured for a few pairs of paths holds for stars all over the frame."""
    plan = turning(roll_deg, {"kind": "airy", "wavelength_nm": 650.0}, dec_arcsec)
    zones = plan.responses.streaks.zones
    sweeps = wing_sweeps(plan.camera, geometry_of(plan), zones, True)
    shortest = min(pair[0].length_px for pair in sweeps.pairs)
    assert shortest == pytest.approx(sweeps.slowest_px, abs=0.05)
    blur = plan.responses.blur
    core = compact_core(blur, plan.responses.classes[0].radius_px)
    measured = max(swept_apart(blur, core, *pair) for pair in sweeps.pairs)
    common = sweeps.pairs[0][1]
    for x, y in ((20.0, 20.0), (140.0, 20.0), (79.5, 140.0), (20.0, 120.0), (120.0, 79.5)):
        own = exact_path(plan.camera, geometry_of(plan), x, y, True)
        assert swept_apart(blur, core, own, common) <= MARGIN * measured


def test_paths_that_differ_most_are_found_however_many_blocks_are_looked_at_together(monkeypatch):
    camera = replace(turning(20.0, {"kind": "gaussian", "sigma_px": 0.8}).camera,
                     rows=2000, columns=1500)  # fmt: skip
    geometry = geometry_of(turning(20.0, {"kind": "gaussian", "sigma_px": 0.8}))
    found = []
    for together in (1, 1000):
        monkeypatch.setattr(of_sweeps, "AT_ONCE", together)
        sweeps = wing_sweeps(camera, geometry, 2, True)
        ends = [(p.x_px[-1], p.y_px[-1]) for pair in sweeps.pairs for p in pair]
        found.append((sweeps.slowest_px, sweeps.off_px, ends))
    assert found[0] == found[1]


@pytest.mark.parametrize("at", [(230.0, 90.0), (90.0, -60.0), (-40.0, 120.0)])
def test_the_reference_follows_a_star_where_stars_of_the_window_go_elsewhere(at):
    """A window at the beginning of a star's path: those of the window itself never come there."""
    plan = turning(70.0, {"kind": "gaussian", "sigma_px": 0.8}, 200.0)
    g = geometry_of(plan)
    path = exact_path(plan.camera, g, *at, True)
    x0, y0 = (int(v) - 8 for v in (at[0] + path.x_px[0], at[1] + path.y_px[0]))
    light_e = 1e9
    exact, _ = reference(plan, g, Tile(0, 0, y0, x0, 16, 16),
                         field(*(np.array([v]) for v in (*at, light_e))), most_s=2.0)  # fmt: skip
    lengths = np.hypot(np.diff(path.x_px), np.diff(path.y_px))
    inside = np.hypot(path.x_px - path.x_px[0], path.y_px - path.y_px[0]) < 5.0
    sure_e = light_e * float(path.weight[inside[1:]].sum())
    assert lengths.sum() > 50.0
    assert sure_e > 1e6
    assert exact.sum() > sure_e


def test_a_place_has_the_number_of_the_zone_that_it_lies_in():
    """Row by row, on a frame that is not square, up to its borders; off the frame the nearest."""
    camera = SimpleNamespace(rows=9, columns=60)
    responses = SimpleNamespace(streaks=SimpleNamespace(zones=3))
    plan = SimpleNamespace(camera=camera, responses=responses)
    u, v = (a.ravel() for a in np.meshgrid([-0.99, 0.0, 0.99], [-0.99, 0.0, 0.99]))
    for number in range(9):
        x, y = zone_of_frame(camera, *divmod(number, 3), 3).places(u, v)
        assert (zone_of(plan, x, y) == number).all()
    beside = zone_of(plan, np.array([-9.0, 99.0, 30.0, 30.0]), np.array([4.0, 4.0, -9.0, 99.0]))
    assert beside.tolist() == [3, 5, 1, 7]


def stands_still(plan: Plan) -> list[float]:
    """x and y [px] of the star whose streak is the shortest, followed one by one."""
    g, middle = geometry_of(plan), 0.5 * plan.camera.columns - 0.5
    place = np.array([middle, middle])
    for step in (24.0, 6.0, 1.5, 0.4):
        tries = place + step * np.stack(np.meshgrid(*2 * [np.arange(-4, 5)]), -1).reshape(-1, 2)
        lengths = [exact_path(plan.camera, g, x, y, True).length_px for x, y in tries.tolist()]
        place = tries[int(np.argmin(lengths))]
    return [float(v) for v in place]


@pytest.mark.parametrize(
    ("side", "roll_deg", "drift_px", "together"),
    [(300, 20.0, 0.0, False), (500, 40.0, 0.0, False), (300, 20.0, 0.0, True),
     (250, 20.0, 24.0, False), (300, 20.0, 24.0, False)],
)  # fmt: skip
def test_stars_near_the_centre_of_a_turn_hold_the_bound(side, roll_deg, drift_px, together):
    """In a corner of four zones, whose middles streak by 37 and 123 px, or between a zone's nodes:
    stars as bright as may be drawn by the zone's, which had all of their light in one pixel."""
    psf = {"kind": "gaussian", "sigma_px": 0.5}
    plan = plan_of(psf, drift_px, 0.86 * drift_px, roll_deg=roll_deg, side=side)
    g = geometry_of(plan)
    centre = stands_still(plan)
    limit = min(path.own_from_e for path in streaks(plan, g))
    told = next(d for d in plan.decisions if d.component == "common_streak").error_bound_e
    tile = Tile(0, 0, 0, 0, side, side)
    window = Tile(0, 0, int(centre[1]) - 12, int(centre[0]) - 12, 25, 25)
    for off in (0.3, 4.0):
        stars = field(*(np.array([v + off]) for v in centre), np.array([0.99 * limit]))
        drawing = replace(plan, responses=replace(plan.responses, spectral_from=int(together)))
        blocks = [render_block(drawing, g, tile, [stars])] if together else []
        assert not together or blocks[0].crowd_e is not None
        image = draw_stars(drawing, g, tile, [stars], blocks)
        exact, _ = reference(plan, g, window, stars)
        part = image[window.y0 : window.y0 + 25, window.x0 : window.x0 + 25]
        assert np.abs(part - exact).max() <= told


@pytest.mark.parametrize("psf", [{"kind": "gaussian", "sigma_px": 0.8},
                                 {"kind": "airy", "wavelength_nm": 650.0}])  # fmt: skip
def test_stars_together_along_their_own_paths_have_their_light(psf):
    """On the frame and around it, of a field that turns and drifts: as one by one, to what the
    transforms may err by; each star once; and whatever the tiles are, the same bits."""
    plan = plan_of(psf, 24.0, 20.0, roll_deg=15.0, side=200)
    g, rng = geometry_of(plan), np.random.default_rng(6)
    x, y = rng.uniform(-60.0, 260.0, (2, 240))
    stars = field(x, y, 10.0 ** rng.uniform(1.0, 4.5, 240))
    r, whole = plan.responses, Tile(0, 0, 0, 0, 200, 200)

    def image(tiles: list[Tile], **ways: float) -> np.ndarray:
        classes = tuple(replace(c, phases=0, **ways) for c in r.classes)
        drawing = replace(plan, responses=replace(r, classes=classes, spectral_from=0))
        blocks = [render_block(drawing, g, whole, [stars])] if ways or r.spacing_px else []
        for block in blocks:
            together = block.in_crowd(drawing, stars, streaks(drawing, g))
            assert not ways or together.sum() > 200
        out = np.zeros((200, 200))
        for t in tiles:
            part = draw_stars(drawing, g, t, [stars], blocks)
            out[t.y0 : t.y0 + t.rows, t.x0 : t.x0 + t.columns] = part
        return out

    own = {"together_from": 1, "together_e": 3e5}
    apart, together = image([whole]), image([whole], **own)
    strips = [Tile(0, k, 0, 50 * k, 200, 50) for k in range(4)]
    assert np.array_equal(image(strips, **own), together)
    noise = np.sqrt(1.0 + np.maximum(apart, 0.0) / 25.0)  # of a pixel, over that of an empty one
    assert (np.abs(together - apart) <= 2.0 * r.budget_e * noise).all()
    assert together.sum() == pytest.approx(apart.sum(), rel=1e-5)


def test_stars_far_beside_a_wide_field_are_drawn_in_every_way():
    """They move farther than those in the middle of its zones: 119 degrees across."""
    plan = wide_plan_of(40.0, focal_length_m=1.5e-3)
    g, rng = geometry_of(plan), np.random.default_rng(2)
    x = np.concatenate([rng.uniform(-100.0, -60.0, 30), rng.uniform(571.0, 611.0, 30)])
    stars = field(x, rng.uniform(0.0, 511.0, 60), np.full(60, 500.0))
    whole = Tile(0, 0, 0, 0, 512, 512)
    image = draw_stars(plan, g, whole, [stars], [])
    alone = np.zeros((512, 512))
    draw_along(plan, g, alone, whole, stars)
    assert alone.sum() > 1000.0
    assert np.abs(image - alone).max() <= plan.responses.budget_e


@pytest.mark.parametrize("roll_deg", [20.0, 180.0, 270.0, 340.0])
def test_zones_around_the_centre_of_a_turn_are_uneven(roll_deg):
    """Also where all streaks end near where they began; zones of one common drift are even."""
    turns = plan_of({"kind": "gaussian", "sigma_px": 1.0}, 0.0, 0.0, roll_deg=roll_deg, side=300)
    assert all(path.uneven for path in streaks(turns, geometry_of(turns)))
    drifts = plan_of({"kind": "gaussian", "sigma_px": 1.0}, 40.0, 30.0, side=300)
    assert not any(path.uneven for path in streaks(drifts, geometry_of(drifts)))
