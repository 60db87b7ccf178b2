"""Engines agree with each other, with the reference path, and with quadrature at limiting cases."""

from __future__ import annotations

import pickle
import shutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.arrays import FrameStars, Geometry
from pipeline.execute import check, tables
from pipeline.execute.blocks import LightBlock, render_block
from pipeline.execute.check import _expected, _nearest, _points, reference, summary
from pipeline.execute.light import draw_along, draw_stars
from pipeline.execute.tables import ContentCache
from pipeline.physics.drawing.wings import wing_grid
from pipeline.physics.motion.streak import POINT, Path
from pipeline.physics.psf.pupil import Airy, Blur, Gaussian
from pipeline.physics.psf.response import Core, compact_core
from pipeline.physics.radiometry import box
from pipeline.plan.checks import CheckCell
from pipeline.plan.facts import gather_facts
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.responses import CoreClass
from pipeline.plan.response.streaks import exact_path
from pipeline.plan.tiles import Tile
from pipeline.spec.load import parse_scene
from pipeline.studies.accuracy.reference import GaussianStar, exact_pixels, straight
from tests.plans import plan_from

SIDE = 160
WHOLE = Tile(0, 0, 0, 0, SIDE, SIDE)


def plan_of(
    psf: dict[str, Any], dx_px: float, dy_px: float, side: int = SIDE, roll_deg: float = 0.0,
    fill: float = 1.0,
) -> Plan:
    """A plan of one frame whose stars streak by (dx, dy) px and turn about; nothing is read."""
    ifov_arcsec = np.degrees(1e-5) * 3600.0
    scene = parse_scene({
        "schema": "nightglass/scene/1", "name": "engines", "epoch": "2019-04-20T03:00:00Z",
        "observer": {"kind": "fixed", "position_au": [1.0, 0.0, 0.0]},
        "sensor": {
            "shape": [side, side], "pixel_pitch_um": 10.0, "focal_length_m": 1.0,
            "aperture_m": 0.065, "obscuration": 0.3, "psf": psf, "read_noise_e": 5.0,
            "fill_factor": fill,
            "bandpass": {"kind": "box", "short_nm": 600.0, "long_nm": 700.0},
        },
        "pointing": {"mode": "rate", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0,
                     "rate_ra_arcsec_s": dx_px * ifov_arcsec,
                     "rate_dec_arcsec_s": -dy_px * ifov_arcsec, "roll_rate_deg_s": roll_deg},
        "exposure": {"integration_s": 1.0}, "stars": {"catalogue": "none"},
    })  # fmt: skip
    facts = gather_facts(scene, box(600e-9, 700e-9), 0.0, 5.0, 1.0)
    return plan_from(scene, facts, plan_geometry(scene, np.zeros(1, int), 0.0))


def field(x: np.ndarray, y: np.ndarray, light: np.ndarray) -> FrameStars:
    n, nothing = len(x), np.zeros(len(x))
    return FrameStars(
        np.arange(n), x, y, light, nothing, nothing, nothing, np.zeros(n, np.uint8),
        np.zeros(n, np.uint8), np.ones(n),
    )  # fmt: skip


def geometry_of(plan: Plan) -> Geometry:
    return plan_geometry(plan.scene, np.zeros(1, int), 0.0)


def blocks_of(plan: Plan, stars: FrameStars) -> list[LightBlock]:
    if not plan.responses.spacing_px and not plan.responses.spectral_from:
        return []
    return [render_block(plan, geometry_of(plan), WHOLE, [stars])]


def drawn(plan: Plan, stars: FrameStars, together: bool) -> np.ndarray:
    """All stars by stamps, or as many as can be by transforms."""
    plan = replace(plan, responses=replace(plan.responses, spectral_from=1 if together else 0))
    return draw_stars(plan, geometry_of(plan), WHOLE, [stars], blocks_of(plan, stars))


def bounds_e(plan: Plan) -> float:
    return sum(d.error_bound_e or 0.0 for d in plan.decisions if d.error_bound_sigma)


SIGMAS_PX, FWHM_PX = (0.4, 0.73, 1.1, 1.9, 3.0), (1.5, 2.1, 2.9, 4.0)
PSFS = st.one_of(
    st.builds(lambda s: {"kind": "gaussian", "sigma_px": s}, st.sampled_from(SIGMAS_PX)),
    st.just({"kind": "airy", "wavelength_nm": 650.0}),
    st.builds(lambda f: {"kind": "moffat", "fwhm_px": f}, st.sampled_from(FWHM_PX)),
)


@settings(max_examples=25, deadline=None)
@given(
    psf=PSFS, dx=st.floats(-40, 40), dy=st.floats(-40, 40), count=st.integers(1, 60),
    brightest=st.floats(1.0, 5.0), seed=st.integers(0, 2**31),
)  # fmt: skip
def test_engines_agree_within_the_sum_of_their_bounds(psf, dx, dy, count, brightest, seed):
    plan = plan_of(psf, dx, dy)
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-20, SIDE + 20, (2, count))
    light = 10 ** rng.uniform(-3, brightest, count)
    stars = field(x, y, light)
    stamps, crowd = drawn(plan, stars, False), drawn(plan, stars, True)
    noise = np.sqrt(25.0 + np.maximum(stamps, 0.0))
    allowed = bounds_e(plan) * noise / 5.0
    assert (np.abs(stamps - crowd) <= 2.0 * allowed).all()
    window = Tile(0, 0, 64, 72, 24, 24)
    exact, _ = reference(plan, geometry_of(plan), window, stars)
    if exact is not None:
        part = np.s_[64:88, 72:96]
        for image in (stamps, crowd):
            assert (np.abs(image[part] - exact) <= allowed[part]).all()


def test_a_tile_of_a_crowd_and_of_few_stars_has_the_light_of_both():
    """Of two blocks only the first has enough stars to draw them together."""
    plan = plan_of({"kind": "gaussian", "sigma_px": 0.8}, 0.0, 0.0)
    plan = replace(plan, responses=replace(plan.responses, spectral_from=10))
    x, y = np.random.default_rng(8).uniform([[1.0], [1.0]], [[40.0], [159.0]], (2, 60))
    x[:3] += 110.0
    stars, g = field(x, y, np.full(60, 50.0)), geometry_of(plan)
    places = (Tile(0, k, 0, 80 * k, SIDE, 80) for k in (0, 1))
    blocks = [render_block(plan, g, place, [stars]) for place in places]
    assert [block.crowd_e is None for block in blocks] == [False, True]
    image, cells = draw_stars(plan, g, WHOLE, [stars], blocks), np.arange(SIDE, dtype=float)
    exact = sum(
        50.0 * exact_pixels(GaussianStar(0.8), straight(0.0, 0.0), *at, cells, cells)
        for at in zip(x, y, strict=True)
    )
    assert np.abs(image - exact).max() <= bounds_e(plan)
    assert image[:, 80:].sum() == pytest.approx(150.0, rel=1e-4)


@pytest.mark.parametrize("sigma", [0.05, 0.3, 5.0, 50.0])
@pytest.mark.parametrize("streak", [0.0, 1e-9, 0.1, 25.0])
def test_limits_of_size_and_streak(sigma, streak):
    """Sharp and broad stars, still and hardly moving ones: against quadrature, to 1e-3 of peak."""
    plan = plan_of({"kind": "gaussian", "sigma_px": sigma}, streak, 0.0)
    x, y = 80.3, 79.6
    at = np.arange(SIDE, dtype=float)
    exact = 1e4 * exact_pixels(GaussianStar(sigma), straight(streak, 0.0), x, y, at, at)
    for together in (False, True):
        image = drawn(plan, field(np.array([x]), np.array([y]), np.array([1e4])), together)
        assert np.abs(image - exact).max() <= max(1e-3 * exact.max(), bounds_e(plan))
        assert image.sum() == pytest.approx(exact.sum(), rel=1e-6, abs=1e-4)


@pytest.mark.parametrize("x", [-0.5, 0.0, SIDE - 0.5, SIDE - 1.0, -3.0, SIDE + 4.0, -400.0, 1e7])
@pytest.mark.parametrize("together", [False, True])
def test_limits_of_the_frame(x, together):
    """Stars on edges, corners, and outside: their light never comes round."""
    plan = plan_of({"kind": "gaussian", "sigma_px": 1.2}, 0.0, 0.0)
    image = drawn(plan, field(np.array([x]), np.array([x]), np.array([1e6])), together)
    at = np.arange(SIDE, dtype=float)
    exact = 1e6 * exact_pixels(GaussianStar(1.2), straight(0.0, 0.0), x, x, at, at)
    assert np.abs(image - exact).max() <= 1.0


@pytest.mark.parametrize("light", [1e-12, 1e-3, 1e9, 1e15])
@pytest.mark.parametrize("together", [False, True])
def test_limits_of_light(light, together):
    """A star of any brightness, and a neighbour of one electron beside it."""
    plan = plan_of({"kind": "gaussian", "sigma_px": 0.8}, 0.0, 0.0)
    x, y, e = np.array([60.2, 100.0]), np.array([70.7, 70.7]), np.array([light, 1.0])
    image = drawn(plan, field(x, y, e), together)
    at = np.arange(SIDE, dtype=float)
    exact = sum(
        e[k] * exact_pixels(GaussianStar(0.8), straight(0.0, 0.0), x[k], y[k], at, at)
        for k in range(2)
    )
    assert np.abs(image - exact).max() <= 1e-9 * light + 0.1
    beside = np.s_[66:76, 95:106]  # 40 px from the bright one, which leaves nothing here
    assert np.abs(image[beside] - exact[beside]).max() < 1e-2


@pytest.mark.parametrize("together", [False, True])
def test_one_electron_close_to_a_billion(together):
    """Six pixels apart: what the fainter star adds is right to a hundredth of an electron."""
    plan = plan_of({"kind": "gaussian", "sigma_px": 0.8}, 0.0, 0.0)
    x, y, e = np.array([60.2, 66.3]), np.array([70.7, 70.4]), np.array([1e9, 1.0])
    both = drawn(plan, field(x, y, e), together)
    alone = drawn(plan, field(x[:1], y[:1], e[:1]), together)
    at = np.arange(SIDE, dtype=float)
    exact = exact_pixels(GaussianStar(0.8), straight(0.0, 0.0), x[1], y[1], at, at)
    assert np.abs(both - alone - exact).max() < 1e-2
    bright = 1e9 * exact_pixels(GaussianStar(0.8), straight(0.0, 0.0), x[0], y[0], at, at)
    assert np.abs(alone - bright)[66:76, 63:70].max() < 0.1


@pytest.mark.parametrize("psf", [{"kind": "moffat", "beta": 3.0, "fwhm_px": 2.5}, {"kind": "airy"}])
@pytest.mark.parametrize("light", [60.0, 300.0, 1500.0])
@pytest.mark.parametrize("count", [60, 500])
def test_stars_of_one_pixel_keep_to_the_part_of_one_approximation(psf, light, count):
    """What tables err by at the worst place between their phases adds up; one part linear, one
    cubic. Far from it without the rule: up to 250 parts."""
    plan = plan_of(psf, 0.0, 0.0)
    phases = max(c.phases for c in plan.responses.classes)
    at = np.array([[SIDE // 2], [SIDE // 3]]) + 0.5 / phases
    stars = field(*at.repeat(count, 1), np.linspace(0.5, 1.5, count) * light)
    exact = tuple(replace(c, phases=0) for c in plan.responses.classes)

    def drawn_by(classes: tuple[CoreClass, ...], some: FrameStars) -> np.ndarray:
        r = replace(plan.responses, classes=classes, spectral_from=0)
        return draw_stars(replace(plan, responses=r), geometry_of(plan), WHOLE, [some], [])

    off = drawn_by(plan.responses.classes, stars) - drawn_by(exact, stars)
    assert np.abs(off).max() <= 2.0 * plan.responses.budget_e


def test_no_stars_at_all():
    plan = plan_of({"kind": "airy"}, 10.0, 0.0)
    empty = field(*(np.zeros(0),) * 3)
    assert not drawn(plan, empty, True).any()
    assert not drawn(plan, empty, False).any()


@pytest.mark.parametrize("light", [1e5, 1e6, 1e7])
def test_bright_streaks_of_changing_speed(light):
    """A camera that turns faster and faster: a bright star has the light of its own path."""
    plan = plan_of({"kind": "gaussian", "sigma_px": 0.7}, 250.0, 0.0, 400)
    g = geometry_of(plan)
    t = np.linspace(-0.5, 0.5, g.nodes)
    turned = g.attitude.copy()
    slow = 1e-5 * 3.0 * t**2  # 0.75 px at the ends: the speed changes by 1.2 percent
    for k, angle in enumerate(slow):
        c, s = np.cos(angle), np.sin(angle)
        turned[0, k] = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) @ g.attitude[0, k]
    g = replace(g, attitude=turned)
    plan = plan_from(plan.scene, plan.facts, g)
    assert plan.responses.streaks.pieces > 1
    whole = Tile(0, 0, 0, 0, 400, 400)
    stars = field(
        np.array([200.3, 140.6]), np.array([199.7, 260.2]), np.array([light, 0.3 * light])
    )
    image = draw_stars(plan, g, whole, [stars], [])
    own = np.zeros(image.shape)
    draw_along(plan, g, own, whole, stars)
    noise = np.sqrt(25.0 + np.maximum(own, 0.0))
    assert image.sum() == pytest.approx(1.3 * light, rel=1e-4)
    assert (np.abs(image - own) / noise).max() <= bounds_e(plan) / 5.0


def test_each_star_along_its_own_path_has_the_core_of_its_own_light():
    """Of several zones and classes in one call: the sum of each star by itself."""
    plan, whole = plan_of({"kind": "airy"}, 8.0, 3.0, 600, 2.0), Tile(0, 0, 0, 0, 600, 600)
    g = geometry_of(plan)
    assert plan.responses.streaks.zones > 1
    assert len(plan.responses.classes) > 2
    x, y = np.array([550.2, 40.6, 540.9, 45.3]), np.array([50.4, 42.1, 541.7, 539.8])
    light = np.array([30.0, *(0.9 * core.brightest_e for core in plan.responses.classes[:3])])
    image, singly = np.zeros((600, 600)), np.zeros((600, 600))
    draw_along(plan, g, image, whole, field(x, y, light))
    for k in range(len(x)):
        one = slice(k, k + 1)
        draw_along(plan, g, singly, whole, field(x[one], y[one], light[one]))
    np.testing.assert_allclose(image, singly, rtol=1e-12, atol=1e-12 * light.max())


NARROW, WIDER, RINGS = Blur(Gaussian(0.9)), Blur(Gaussian(1.1)), Blur(Airy(1.0, 0.3))
ALONG, DOWN, ACROSS = (
    Path(np.array([-x, x]), np.array([-y, y]), np.ones(1))
    for x, y in ((4.0, 1.0), (1.0, 4.0), (4.0, -1.0))
)
GRIDS = [wing_grid(*at, 4, 40.0) for at in (((64, 96), (0, 0)), ((96, 64), (0, 0)))]
GRIDS += [replace(GRIDS[0], spacing_px=2)]
KEPT_BY: dict[str, list[tuple[Any, ...]]] = {
    "core_of": [(NARROW, 8.0), (WIDER, 8.0), (NARROW, 10.0)],
    "swept_core": [(NARROW, 8.0, ALONG), (NARROW, 8.0, ACROSS), (NARROW, 10.0, ALONG),
                   (WIDER, 8.0, ALONG)],
    "still_core": [(NARROW, 8.0, ALONG), (NARROW, 8.0, DOWN), (NARROW, 10.0, ALONG),
                   (WIDER, 8.0, ALONG)],
    "table_of": [(NARROW, 8.0, ALONG, 8), (NARROW, 8.0, ALONG, 16), (NARROW, 8.0, ACROSS, 8),
                 (NARROW, 10.0, ALONG, 8), (WIDER, 8.0, ALONG, 8), (NARROW, 8.0, POINT, 8)],
    "kernel_of": [(RINGS, 8.0, GRIDS[0], 40.0), (RINGS, 8.0, GRIDS[1], 40.0),
                  (RINGS, 8.0, GRIDS[2], 40.0), (RINGS, 9.0, GRIDS[0], 40.0),
                  (RINGS, 8.0, GRIDS[0], 30.0), (Blur(Airy(1.2, 0.3)), 8.0, GRIDS[0], 40.0)],
    "streak_of": [*((grid, ALONG) for grid in GRIDS), (GRIDS[0], ACROSS)],
    "spectral_of": [
        (NARROW, 6.0, POINT, (64, 96), 10**4, 1e-6), (NARROW, 6.0, POINT, (96, 64), 10**4, 1e-6),
        (NARROW, 7.0, POINT, (64, 96), 10**4, 1e-6), (WIDER, 6.0, POINT, (64, 96), 10**4, 1e-6),
        (NARROW, 6.0, ALONG, (64, 96), 10**4, 1e-6), (NARROW, 6.0, DOWN, (64, 96), 10**4, 1e-6),
        (NARROW, 6.0, POINT, (64, 96), 10**4, 1e-3),
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", KEPT_BY)
def test_tables_are_kept_by_all_that_they_follow_from(name, monkeypatch, tmp_path):
    """One of the same but for one argument gets its own: what is made where nothing is kept.

    In the process, and on disk for the next one.
    """
    monkeypatch.setattr("pipeline.kept.WORTH_S", 0.0)
    monkeypatch.setenv("NIGHTGLASS_CACHE", str(tmp_path / "one"))

    def empty():
        for cache in ("_CACHE", "_KERNELS"):
            monkeypatch.setattr(tables, cache, ContentCache(1e9))

    empty()
    kept = [pickle.dumps(getattr(tables, name)(*wish)) for wish in KEPT_BY[name]]
    assert len(set(kept)) == len(kept)
    for folder in ("one", "none"):
        for wish, found in zip(KEPT_BY[name], kept, strict=True):
            empty()
            monkeypatch.setenv("NIGHTGLASS_CACHE", str(tmp_path / folder))
            assert pickle.dumps(getattr(tables, name)(*wish)) == found
            if folder == "none":
                shutil.rmtree(tmp_path / folder, ignore_errors=True)


@pytest.mark.parametrize("swept", ["swept_core", "still_core"])
def test_a_large_core_is_made_once_for_all_that_its_spectrum_draws(swept, monkeypatch):
    """Core and spectrum did not both fit into what is kept, and were made anew for every star."""
    made: list[float] = []

    def compact(blur: Blur, radius_px: float) -> Core:
        made.append(radius_px)
        return compact_core(blur, radius_px)

    monkeypatch.setattr(tables, "compact_core", compact)
    monkeypatch.setattr(tables, "_CACHE", ContentCache(1.0))
    for _ in range(3):
        getattr(tables, swept)(NARROW, 8.0, ALONG)
    assert made == [8.0]


def test_the_least_recently_used_is_dropped():
    made: list[str] = []
    cache = ContentCache(10.0)
    for key in ("a", "b", "a", "c", "a", "b"):
        assert cache.get(key, lambda key=key: made.append(key) or key, lambda _: 4) == key
    assert made == ["a", "b", "c", "b"]  # b gave way to c, as a was used since
    cache.get("large", lambda: made.append("large"), lambda _: 99)
    cache.get("large", lambda: made.append("again"), lambda _: 99)
    assert made[-1] == "large"


def test_a_value_that_many_ask_for_is_made_once():
    """One thread makes it, whatever the others do meanwhile; a fault reaches all of them, and
    nothing is left behind of what was asked for."""
    cache, made, asked = ContentCache(1e9), [], threading.Barrier(4)

    def make() -> str:
        made.append(1)
        time.sleep(0.05)
        return "value"

    def fail() -> str:
        time.sleep(0.05)
        raise ValueError("no")

    def ask(how) -> object:
        asked.wait()
        try:
            return cache.get(how.__name__, how, len)
        except ValueError as error:
            return str(error)

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(ask, [make] * 4)) == ["value"] * 4
        assert list(pool.map(ask, [fail] * 4)) == ["no"] * 4
    assert made == [1]
    for _ in range(9):
        cache.get("make", make, len)
    assert (len(cache._values), len(cache._making)) == (1, 0)


def test_points_and_distances_along_a_path():
    """Even points stand for a path: its light, its middle; distances against very many of them."""
    path = Path(np.array([0.0, 9.0, 9.0]), np.array([1.0, 1.0, 4.0]), np.array([0.7, 0.3]))
    x, y, share = _points(path, 0.8)
    assert share.sum() == pytest.approx(1.0)
    assert (share @ x, share @ y) == pytest.approx((0.7 * 4.5 + 0.3 * 9.0, 0.7 + 0.3 * 2.5))
    assert np.hypot(np.diff(x), np.diff(y)).max() <= 0.8 * np.sqrt(2.0)
    assert len(x) == 12 + 4
    offsets = np.stack([path.x_px, path.y_px])[:, None]
    for place in ((4.0, 3.0), (-2.0, 0.0), (11.0, 6.0), (9.5, 2.0)):
        many = np.hypot(*(np.stack(_points(path, 1e-3)[:2]).T - place).T)
        found = _nearest(offsets, np.array(place)[:, None, None])
        assert found[0] == pytest.approx(many.min(), abs=2e-3)


@pytest.mark.parametrize("most", [-1, 10**6])
def test_the_wings_of_the_reference_are_those_of_many_points_at_rest(most, monkeypatch):
    """Two stars that share a streak, from beside their cores: point by point, or swept together."""
    monkeypatch.setattr(check, "MOST_POINTS", most)
    plan, still = (plan_of({"kind": "airy", "wavelength_nm": 650.0}, d, 0.0) for d in (60.0, 0.0))
    window, g = Tile(0, 0, 70, 30, 16, 16), geometry_of(plan)
    x, y, light = np.array([90.0, 93.3]), np.array([78.3, 80.9]), np.array([1e5, 6e4])
    swept, _ = reference(plan, g, window, field(x, y, light), own_paths=0)
    dx, dy, share = _points(exact_path(plan.camera, g, 90.0, 78.3, True), 0.25)
    many = (np.add.outer(v, d).ravel() for v, d in ((x, dx), (y, dy)))
    stars = field(*many, np.outer(light, share).ravel())
    exact, _ = reference(still, geometry_of(still), window, stars, own_paths=0, most_s=9.0)
    np.testing.assert_allclose(swept, exact, rtol=0.02)


def test_the_most_is_expected_around_the_brightest_source():
    """Of a star far from the diagonal of a cell beside the first, in the cell's own pixels."""
    plan = plan_of({"kind": "gaussian", "sigma_px": 0.8}, 0.0, 0.0, side=400)
    stars = field(np.array([356.0, 300.0]), np.array([30.0, 90.0]), np.array([1e5, 1e3]))
    cell, noise_e = CheckCell(0, 0, 1), np.ones((256, 144))
    found = _expected(plan, geometry_of(plan), cell, [stars], noise_e)
    most = np.argwhere(found == found.max())  # alike all over its core
    assert most.mean(axis=0) == pytest.approx([30.0, 100.0])
    assert np.abs(most - [30, 100]).max() < 20


def test_summary_of_the_windows():
    one = {"error_e": 2.0, "error_sigma": 0.1, "sources": 3}
    two = {"error_e": 1.0, "error_sigma": 0.4, "sources": 5}
    told = summary([one, {"skipped": "too many", "sources": 9}, two])
    assert told == {
        "windows": 2, "windows_skipped": 1, "achieved_error_e": 2.0, "achieved_error_sigma": 0.4,
        "sources_drawn_again": 8,
    }  # fmt: skip
    assert summary([])["achieved_error_sigma"] is None
