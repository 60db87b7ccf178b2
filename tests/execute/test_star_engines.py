"""Tables or star by star: chosen by how many stars there are; the light is the same either way."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.arrays import FrameStars
from pipeline.execute.blocks import POINTS_AT_ONCE, _as_fast
from pipeline.execute.light import _draw_points, draw_stars
from pipeline.execute.sources import streaks
from pipeline.execute.tables import swept_core
from pipeline.physics.drawing import quadrature
from pipeline.physics.motion.points import points_along
from pipeline.physics.motion.streak import POINT, Path
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import phase_table
from pipeline.physics.radiometry import box
from pipeline.plan.facts import gather_facts
from pipeline.plan.ledger import LEDGER
from pipeline.plan.needs import predict
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.responses import CoreClass
from pipeline.plan.response.streaks import POINTS, SHOWN
from pipeline.plan.rule import PlanBasis
from pipeline.plan.stars.engines import (
    POINT_ROUNDING,
    _beyond_s,
    _Costs,
    _one_by_one,
    _said_of_bright,
    _streaks,
    _together_to_e,
    choose_engines,
    cubic_bound,
)
from pipeline.plan.stars.field_stars import StarCounts
from pipeline.plan.tiles import Tile
from pipeline.spec.load import parse_scene
from tests.plans import plan_from

SIDE = 512
GAUSSIAN = {"kind": "gaussian", "sigma_px": 0.7}
NOTHING = StarCounts(np.zeros(0))


def plan_of(
    streak_px: float, tile: int = SIDE, side: int = SIDE, psf: dict[str, Any] = GAUSSIAN,
    focal_length_m: float = 0.02,
) -> Plan:
    """A plan of one frame; stars drift, and the camera rolls with them."""
    pixel_rad = 1e-5 / focal_length_m
    scene = parse_scene({
        "schema": "nightglass/scene/1", "name": "engines", "epoch": "2019-04-20T03:00:00Z",
        "observer": {"kind": "fixed", "position_au": [1.0, 0.0, 0.0]},
        "sensor": {
            "shape": [side, side], "pixel_pitch_um": 10.0,
            "focal_length_m": focal_length_m,
            "aperture_m": 0.015, "psf": psf, "pupil_projection": False,
            "read_noise_e": 5.0,
            "bandpass": {"kind": "box", "short_nm": 600.0, "long_nm": 700.0},
        },
        "pointing": {"mode": "rate", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0,
                     "rate_ra_arcsec_s": streak_px * np.degrees(pixel_rad) * 3600.0,
                     "rate_dec_arcsec_s": 0.0},
        "exposure": {"integration_s": 1.0}, "stars": {"catalogue": "none"},
        "output": {"tile_shape": [tile, tile]},
    })  # fmt: skip
    facts = gather_facts(scene, box(600e-9, 700e-9), 0.0, 5.0, 1.0)
    return plan_from(scene, facts, plan_geometry(scene, np.zeros(1, int), 0.0))


def chosen(plan: Plan, stars: float, g_mag: tuple[float, float]) -> Plan:
    """The plan for so many stars between two magnitudes, of 1e10 e- at G = 0."""
    share = np.linspace(0.0, 1.0, int(stars))
    g = g_mag[0] + np.log10(1.0 + share * (10.0 ** (0.3 * np.ptp(g_mag)) - 1.0)) / 0.3
    counts = StarCounts(np.sort(1e10 * 10.0 ** (-0.4 * g)))
    return with_engines(plan, counts)


def with_engines(plan: Plan, counts: StarCounts) -> Plan:
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    engines = choose_engines(plan, g, counts)
    basis = PlanBasis(plan, g, engines=engines)
    decisions = tuple(d for rule in LEDGER for d in rule.decide(basis))
    return replace(plan, responses=engines.responses, decisions=decisions)


@pytest.mark.parametrize("streak_px", [0.0, 40.0])
def test_a_cluster_costs_what_it_holds(streak_px: float) -> None:
    """Stars count where they stand: those far off the frame light it by their wings alone."""
    plan = plan_of(streak_px)
    light, far = np.full(3000, 3e5), np.full(2900, 900.0)
    spread_out = StarCounts(light, beyond_px=np.concatenate([np.zeros(100), far]))
    cluster = StarCounts(light, beyond_px=np.linspace(0.0, 3.0, 3000))
    few, all_ = (with_engines(plan, counts).responses for counts in (spread_out, cluster))
    hundred, many = (with_engines(plan, StarCounts(light[:n])).responses for n in (100, 3000))
    assert (few.stars_s, few.expected) == (hundred.stars_s, hundred.expected)
    assert (all_.stars_s, all_.expected) == (many.stars_s, many.expected)
    assert sum(few.expected) == 100.0


def test_stars_beside_the_frame_are_forecast_with_their_wings() -> None:
    """Their cores reach no pixel of it, their wings do: these are made as for stars in it."""
    plan = plan_of(0.0, psf={"kind": "airy", "wavelengths": 1}, focal_length_m=0.3)
    light = np.full(9, 0.5 * plan.responses.classes[0].brightest_e)
    inside, beside, beyond = (
        with_engines(plan, StarCounts(light, beyond_px=np.full(9, px)))
        for px in (0.0, 0.5 * plan.halo_px, 2.0 * plan.halo_px)
    )
    assert 0.5 * plan.halo_px > 2.0 * plan.responses.classes[0].radius_px
    assert (sum(beside.responses.expected[:-1]), sum(beyond.responses.around)) == (0.0, 0.0)
    assert beside.responses.around == inside.responses.around
    assert sum(inside.responses.around) == 9.0
    told = [predict(made, None) for made in (inside, beside, beyond)]
    for need in ("cpu_s", "worker_memory_mb"):
        assert told[0][need] >= told[1][need] > 1.01 * told[2][need]


def engines(plan: Plan) -> list[tuple[int, int]]:
    return [(c.phases, c.point_phases) for c in plan.responses.classes]


def test_few_stars_need_no_table_and_many_do():
    plan = plan_of(20.0)
    assert plan.responses.streaks.own_from_e_px < np.inf
    none = with_engines(plan, NOTHING)
    few, many = chosen(plan, 3.0, (8.0, 12.0)), chosen(plan, 3e5, (8.0, 21.0))
    assert all(phases == (0, 0) for phases in engines(none))
    assert all(phases == (0, 0) for phases in engines(few))
    assert engines(many)[0][0] > 0
    assert engines(many)[0][1] > 0
    assert any("own path" in d.reason for d in few.decisions if d.component == "star_engines")
    assert any("as points" in d.reason for d in many.decisions if d.component == "star_engines")


def test_of_long_streaks_what_comes_near_the_frame_is_paid_for():
    """One that goes on far beyond both ends of the frame costs more only as it bends more."""
    cost_s = [
        chosen(plan_of(streak_px, 64, 64), 20.0, (2.0, 4.0)).responses.stars_s
        for streak_px in (60.0, 600.0, 1200.0)
    ]
    assert 1.2 * cost_s[0] < cost_s[1]
    assert cost_s[2] < 1.5 * cost_s[1]


def test_stars_too_bright_for_all_classes_are_paid_for_one_by_one():
    """Each of their pixels sums its whole path; those that it crosses are dearer."""
    plan = plan_of(40.0, 64, 64, {"kind": "moffat", "fwhm_px": 1.0, "beta": 2.0})
    r = plan.responses
    assert np.isfinite(r.classes[-1].brightest_e)
    path = Path(np.array([-20.0, 20.0]), np.zeros(2), np.ones(1))
    pairs = 64**2 * len(quadrature.points_of(r.blur, path))

    def cost_s(stars: int, beyond_px: float) -> float:
        light = np.full(stars, 10.0 * r.classes[-1].brightest_e)
        counts = StarCounts(light, beyond_px=np.full(stars, beyond_px))
        return with_engines(plan, counts).responses.stars_s

    passing, crossing = cost_s(1, 0.9 * plan.halo_px), cost_s(1, 0.0)
    straight_s = pairs * 2.0 * quadrature.nodes_of(r.blur) * quadrature.SIDE_S
    assert straight_s <= passing < 3.0 * straight_s  # its own path is bent
    assert passing < crossing < 1.2 * passing
    assert cost_s(30, 0.0) == pytest.approx(30.0 * crossing)
    assert cost_s(30, 1e6) == 0.0


def test_same_choice_for_any_tiles():
    few, many = (plan_of(20.0, 256), 3.0), (plan_of(20.0, 256), 3e5)
    for cut, stars in (few, many):
        assert engines(chosen(cut, stars, (8.0, 21.0))) == engines(
            chosen(plan_of(20.0), stars, (8.0, 21.0))
        )


@pytest.mark.parametrize("psf", [GAUSSIAN, {"kind": "moffat", "fwhm_px": 2.0, "beta": 3.0}],
                         ids=["gaussian", "moffat"])  # fmt: skip
@pytest.mark.parametrize("light", [3e3, 3e4, 3e5, 3e6, 3e8])
def test_every_engine_gives_the_same_light(light, psf, monkeypatch):
    """Bright and faint streaks by tables, as points, and star by star: alike within their parts,
    and those as points that such a table serves."""
    side, streak_px = (192, 20.0) if light < 3e8 else (64, 4.0)
    plan = plan_of(streak_px, side, side, psf)
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    rng = np.random.default_rng(5)
    x, y = rng.uniform(10.0, side - 10.0, (2, 12 if light < 3e8 else 1))
    nothing = np.zeros(len(x))
    stars = FrameStars(
        np.arange(len(x)), x, y, nothing + light, nothing, nothing, nothing,
        np.zeros(len(x), np.uint8), np.zeros(len(x), np.uint8), np.ones(len(x)),
    )  # fmt: skip
    tile = Tile(0, 0, 0, 0, side, side)

    blur, served = plan.responses.blur, []
    error = cubic_bound(blur) / 64**4 + POINT_ROUNDING

    def points(path: Path, band: float) -> tuple[np.ndarray, ...]:
        served.append(path)
        return points_along(path, band)

    monkeypatch.setattr("pipeline.execute.light.points_along", points)

    def image(phases: int | None, points: int) -> Any:
        classes = tuple(
            replace(
                c,
                phases=c.phases if phases is None else phases,
                point_phases=points,
                point_error=error,
            )
            for c in plan.responses.classes
        )
        drawn = replace(plan, responses=replace(plan.responses, classes=classes))
        return draw_stars(drawn, g, tile, [stars], [])

    alone, tables = image(0, 0), image(None, 0)
    assert not served
    by_points = image(None, 64)
    noise = np.sqrt(plan.facts.sigma_floor_e**2 + np.maximum(alone, 0.0)) / plan.facts.sigma_floor_e
    assert (np.abs(tables - alone) / noise).max() <= 3.0 * plan.responses.budget_e
    part = POINTS + 2.0 * SHOWN if served else 3.0
    assert (np.abs(by_points - alone) / noise).max() <= part * plan.responses.budget_e
    assert bool(served) == (light < 3e8 or psf is GAUSSIAN)


def test_a_table_that_errs_too_much_for_a_star_draws_none_of_it():
    """A star of 3e5 electrons as points of a table at rest, or along its own path."""
    plan = plan_of(20.0, 64, 64, GAUSSIAN)
    g, one = plan_geometry(plan.scene, np.zeros(1, int), 0.0), np.ones(1)
    stars = FrameStars(
        np.zeros(1, int), 30.0 * one, 31.0 * one, 3e5 * one, 0.0 * one, 0.0 * one, 0.0 * one,
        np.zeros(1, np.uint8), np.zeros(1, np.uint8), one,
    )  # fmt: skip

    def image(points: int, error: float) -> Any:
        ways = {"phases": 0, "fine_phases": 0, "point_phases": points, "point_error": error}
        classes = tuple(replace(c, **ways) for c in plan.responses.classes)
        drawn = replace(plan, responses=replace(plan.responses, classes=classes))
        return draw_stars(drawn, g, Tile(0, 0, 0, 0, 64, 64), [stars], [])

    alone = image(0, 0.0)
    assert alone.sum() == pytest.approx(3e5, rel=1e-3)
    assert np.array_equal(image(64, 1e-2), alone)
    assert not np.array_equal(image(64, 1e-9), alone)


def test_crowds_of_a_wide_field_are_drawn_along_their_own_paths():
    """Where stars move differently over the field, many together are cheaper by half than by
    tables of each zone's shapes; not few, nor those of a narrow field, which move alike."""
    wide, narrow = plan_of(60.0), plan_of(60.0, focal_length_m=20.0)
    few, many, alike = (
        chosen(plan, stars, (8.0, 18.0)) for plan, stars in ((wide, 50), (wide, 3e4), (narrow, 3e4))
    )
    assert [c.together_from for c in few.responses.classes] == [0, 0]
    assert alike.responses.classes[0].together_from == 0
    core = many.responses.classes[0]
    assert 3000 < core.together_from < 4000
    assert core.together_e > 1e4
    g = plan_geometry(wide.scene, np.zeros(1, int), 0.0)
    [to_e] = _together_to_e(wide, core, 0.0, _streaks(wide, g))
    assert core.together_e == to_e  # a crowd of so few errs by less than one of them may
    words = {d.component: d.reason for d in many.decisions}
    assert "stars with cores of 4 px together, along their own paths" in words["star_engines"]
    assert f"where {core.together_from} stars or more with" in words["crowds_by_transforms"]
    bright = chosen(wide, 800, (8.0, 14.0))  # transforms err where no table does, too
    assert bright.responses.classes[0].phases == 0 < bright.responses.classes[0].together_from
    for plan, errs in ((few, False), (many, True), (bright, True)):
        [bound] = [d.error_bound_e for d in plan.decisions if d.component == "phase_interpolation"]
        assert bool(bound) == errs


def test_stars_are_paid_for_as_they_are_drawn():
    """As points where a table of them serves, else each by a transform: far dearer where the
    response is sharper than pixels, as an airy image of a tenth of one."""
    plan = plan_of(20.0, 64, 64, {"kind": "airy", "wavelengths": 1})
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    made = with_engines(plan, StarCounts(np.geomspace(1e2, 1e6, 20_000)))
    streak = streaks(plan, g)[0]
    for k, core in enumerate(made.responses.classes):
        to_e = _Costs(plan, core, streak, streak.own_from_e).points_to_e
        given = made, np.zeros((64, 64)), Tile(0, 0, 0, 0, 64, 64), k, streak.path, 30.0, 31.0
        limits = 0.99 * to_e, 1.01 * to_e
        as_points = [_draw_points(*given, light_e, plan.responses.band) for light_e in limits]
        assert as_points == [k == 1, False]
    core = replace(plan.responses.classes[1], brightest_e=1e6)
    way = _Costs(plan, core, streak, streak.own_from_e)
    light = np.array([2.0, 0.9 * way.points_to_e, 1.1 * way.points_to_e, 9e5])
    cost_s, *_ = _one_by_one(core, [way], [1.0], StarCounts(light, each=1e4))
    assert cost_s == way.points(2e4) + way.along(2e4) < 0.7 * way.along(4e4)


@pytest.mark.parametrize("streak_px", [30.0, 150.0])
def test_bright_streaks_in_more_pieces_have_the_light_of_their_own_paths(streak_px):
    """Up to the light from which their own path would show, and cheaper where they are many."""
    plan = plan_of(streak_px, focal_length_m=0.2)
    usual, finer = plan.responses.streaks, plan.responses.streaks.finer
    assert finer is not None
    assert finer.pieces >= 2 * usual.pieces
    assert finer.off_px < 0.5 * usual.off_px
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    most_e, least_e = (s.own_from_e_px * s.longest_px for s in (finer, usual))
    assert most_e > 2.0 * least_e
    x, y = np.random.default_rng(6).uniform(10.0, SIDE - 10.0, (2, 8))
    none = np.zeros(len(x))
    stars = FrameStars(
        np.arange(len(x)), x, y, np.geomspace(1.1 * least_e, 0.95 * most_e, 8), none, none, none,
        np.zeros(8, np.uint8), np.zeros(8, np.uint8), np.ones(8),
    )  # fmt: skip

    def image(fine_phases: int) -> Any:
        ways = {"fine_phases": fine_phases, "point_phases": 0}
        classes = tuple(replace(c, **ways) for c in plan.responses.classes)
        drawn = replace(plan, responses=replace(plan.responses, classes=classes))
        return draw_stars(drawn, g, Tile(0, 0, 0, 0, SIDE, SIDE), [stars], [])

    alone, in_more = image(0), image(32)
    noise = np.sqrt(plan.facts.sigma_floor_e**2 + np.maximum(alone, 0.0)) / plan.facts.sigma_floor_e
    off_e = np.abs(in_more - alone) / noise
    assert 0.0 < off_e.max() <= 1.3 * plan.responses.budget_e  # with what own paths may
    many = chosen(plan, 3e5, (8.0, 21.0)).responses.classes
    assert any(c.fine_phases for c in many)
    none = with_engines(plan, NOTHING).responses.classes
    assert not any(c.fine_phases for c in none)


@pytest.mark.parametrize("optics", [Gaussian(0.6), Gaussian(2.0), Airy(1.0, 0.3)], ids=repr)
def test_bound_of_cubic_interpolation(optics):
    blur = Blur(optics)
    for phases in (8, 16):
        rounding = 2.0**-22
        measured = phase_table(*swept_core(blur, 12.0, POINT), phases).cubic_error
        assert measured <= cubic_bound(blur) / phases**4 + rounding


@given(
    lights=st.lists(st.floats(1e-3, 1e12), max_size=9), each=st.sampled_from([1.0, 7.0]),
    edges=st.lists(st.floats(1e-3, 1e12), min_size=2, max_size=6),
)
def test_counts_add_up(lights, each, edges):
    counts = StarCounts(np.sort(np.array(lights, float)), each)
    edges = [0.0, *sorted(edges), np.inf]
    parts = [counts.between(a, b) for a, b in pairwise(edges)]
    assert parts == [each * sum(a < e <= b for e in lights) for a, b in pairwise(edges)]


def test_bright_streaks_are_told_by_how_they_are_drawn():
    """So many in more pieces, so many by themselves, and none of what there is not."""
    core = CoreClass(12.0, 1e5, 1e5, 0.0, 0.0, 8)
    pieces = "about 3 bright streaks with cores of 12 px in more segments"
    own = "about 7 bright streaks with cores of 12 px each along its own path"
    points = f"{own}, as points of a table of 64 phases"
    assert _said_of_bright(core, 3.2, 7.4, 64) == [pieces, points]
    assert _said_of_bright(core, 0.4, 7.4, 0) == [own]
    assert _said_of_bright(core, 2.6, 0.4, 64) == [pieces]


def test_of_two_stars_too_bright_for_all_classes_one_crosses_the_frame() -> None:
    """The forecast lies halfway between none and both; a faint star near it counts for nothing."""
    plan = plan_of(40.0)
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    bright_e = plan.responses.classes[-1].brightest_e
    light = np.array([1.0, 2.0 * bright_e, 2.0 * bright_e])
    none, one, both = (
        _beyond_s(plan, bright_e, streaks(plan, g), StarCounts(light), StarCounts(light[:n]))
        for n in (0, 2, 3)
    )
    assert 0.0 < none < one < both
    assert one == pytest.approx(0.5 * (none + both))


def test_stars_far_faster_than_others_are_followed_apart():
    """Else each of a thousand would be as many points as the fastest: 20 GB beside a wide field."""
    length_px = np.random.default_rng(4).permutation(np.geomspace(10.0, 3e6, 1000))
    offsets = np.linspace(-0.5, 0.5, 9) * length_px[:, None] * np.array([0.6, 0.8])[:, None, None]
    parts = [np.arange(1000)[some] for some in _as_fast(offsets, 1.3)]
    assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(1000))
    for some in parts:
        assert len(some) == 1 or len(some) * 1.3 * length_px[some].max() <= POINTS_AT_ONCE
    assert len(parts) < 400  # a third of them are as many points by themselves
    [alike] = _as_fast(offsets[:, length_px < 200.0], 1.3)
    assert alike == slice(None)
