"""What sources of known light err by: bounds that follow from the stars and targets there are."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.arrays import Geometry
from pipeline.physics.psf.product import product_table
from pipeline.physics.psf.pupil import Blur, EllipticalGaussian, Gaussian
from pipeline.plan.accuracy import total_sigma
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.paths import near_frame
from pipeline.plan.response.responses import (
    FARTHEST_PX,
    CoreClass,
    ResponsePlan,
    cut_share,
    end_share,
    point_curvature,
)
from pipeline.plan.response.sources import (
    WINGS,
    KnownSources,
    SourceBounds,
    bounds_of,
    known_of_frames,
    of_stars,
    stars_known,
    targets_known,
)
from pipeline.plan.response.streaks import (
    POINTS,
    SHOWN,
    SLACK,
    STEP_PART,
    StreakPlan,
    light_from,
    over_field,
)
from pipeline.resolve.resolve import resolve
from pipeline.route.prepare import prepare
from pipeline.route.run import render
from pipeline.route.truths import Truths, _of_targets
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene
from pipeline.studies.scenes.scenes import MAKERS, with_accuracy

FLOOR_E, BUDGET_E = 5.0, 0.1


def streaks(off_px: float = 1e-3, longest_px: float = 30.0, **more: Any) -> StreakPlan:
    plan = StreakPlan(
        1, 1, off_px, longest_px, 1, 0.0, 0.0, floor_e=FLOOR_E, budget_e=BUDGET_E,
        shortest_px=longest_px, **more,
    )  # fmt: skip
    return replace(plan, own_from_e_px=light_from(off_px, plan))


def responses(**more: Any) -> ResponsePlan:
    """Two core classes, whose wings err by 1e-4 and 1e-6 of the light, on a grid of 4 px."""
    classes = (CoreClass(10.0, 1e3, 5e2, 1e-4, 2e-4, 8), CoreClass(20.0, 1e5, 1e4, 1e-6, 2e-6, 8))
    whole = {"spacing_px": 4, "reach_px": 100.0, "lost_light": 1e-3, "streaks": streaks()} | more
    return ResponsePlan(Blur(Gaussian(1.0)), classes, budget_e=BUDGET_E, **whole)


def stars(r: ResponsePlan, *light_e: float, apart_px: float = 0.0) -> KnownSources:
    """Stars of one frame, side by side."""
    light = np.array(light_e)
    x = 5.5 + apart_px * np.arange(len(light))
    return stars_known(r, np.zeros(len(light)), x, np.full(len(light), 5.5), light)


def test_faint_streaks_err_by_their_own_light_and_bright_ones_by_what_draws_them() -> None:
    s = streaks()
    limit_e = s.own_from_e_px * s.longest_px
    lights = np.array([1.0, 0.01 * limit_e, limit_e, 100.0 * limit_e])
    per_px = lights[1] * SLACK / s.longest_px
    expected = s.off_px * per_px / math.sqrt(1.0 + per_px / FLOOR_E**2)
    none = np.zeros(4)
    found, points = (s.errors_e(lights, points_e) for points_e in (none, none + 1e9))
    some = s.errors_e(lights, none + 0.1 * POINTS * BUDGET_E)
    assert found[1] == pytest.approx(expected)
    assert found[1] < s.error_e(lights[1])
    assert found[2] == pytest.approx(BUDGET_E)
    assert found[3] == pytest.approx(2.0 * SHOWN * BUDGET_E)
    assert points[3] == pytest.approx((2.0 * SHOWN + POINTS) * BUDGET_E)
    assert (points[:3] == found[:3]).all()
    assert some[3] == pytest.approx((2.0 * SHOWN + 0.1 * POINTS) * BUDGET_E)
    assert not s.errors_e(np.empty(0), np.empty(0)).size


def test_responses_that_change_over_the_field_count_along_streaks() -> None:
    """Of one shape by what the ends of its pieces err by, of a path of its own by its steps'."""
    s = streaks()
    asked: list[float] = []
    over = over_field(replace(s, pieces=4, finer=s), lambda px: asked.append(px) or 1e-4)
    assert asked == [7.5, 30.0]
    assert over.off_px == pytest.approx(s.off_px + 7.5e-4)
    assert over.own_from_e_px < s.own_from_e_px
    assert over.finer is not None
    assert over.finer.own_from_e_px < over.own_from_e_px
    bright = np.array([1e6 * s.own_from_e_px])
    plain, stepped = (v.errors_e(bright, np.zeros(1)) for v in (s, replace(over, finer=None)))
    assert stepped - plain == pytest.approx(STEP_PART * BUDGET_E)


def test_what_has_no_noise_of_its_own_hides_nothing() -> None:
    light = np.array([10.0])
    still = replace(streaks(longest_px=1e-3), step_px=1.0)
    assert still.still
    for quiet in (streaks(photons=False), still):
        per_px = light[0] * SLACK / max(SLACK, quiet.longest_px)
        assert quiet.errors_e(light, np.zeros(1))[0] == pytest.approx(quiet.off_px * per_px)


def test_the_brightest_err_by_what_places_are_rounded_to() -> None:
    """1e-12 px of their light, which its noise hides; a star of 1e12 e- by 1 e-."""
    light, none = np.array([1e12]), np.zeros(1)
    quiet = replace(streaks(photons=False), budget_e=10.0, own_from_e_px=1e3)
    assert quiet.errors_e(light, none)[0] == pytest.approx(SHOWN * 10.0 + 1.0)
    noisy = replace(quiet, photons=True)
    assert noisy.errors_e(light, none)[0] == pytest.approx(2.0 * SHOWN * 10.0)
    r = responses(streaks=replace(quiet, budget_e=BUDGET_E))
    assert of_stars(r, stars(r, 1e12, 1e12)).errors_e["common_streak"] == pytest.approx(2.0)
    noisy_r = responses(streaks=replace(noisy, budget_e=BUDGET_E))
    assert of_stars(noisy_r, stars(r, 1e12)).errors_e["common_streak"] <= BUDGET_E


def test_wings_err_by_their_class_and_together() -> None:
    r = responses()
    for light_e, error in ((9e2, 1e-4), (2e3, 1e-6), (2e5, 0.0)):
        assert of_stars(r, stars(r, light_e)).errors_e[WINGS] == pytest.approx(error * light_e)
    assert of_stars(r, stars(r, 9e2, 8e2)).errors_e[WINGS] == pytest.approx(0.17)
    both = known_of_frames([stars(r, 9e2), replace(stars(r, 8e2), frame=np.ones(1))])
    assert of_stars(r, both).errors_e[WINGS] == pytest.approx(0.09)
    faint = of_stars(r, stars(r, *([1e-6] * 40))).errors_e[WINGS]
    assert faint == pytest.approx(4e-9)  # however little each errs by
    assert of_stars(r, stars(r)).errors_e[WINGS] == 0.0


def test_products_err_by_the_worst_of_their_tables() -> None:
    r = responses(streaks=replace(streaks(longest_px=1e-3), step_px=1.0))
    r = replace(r, classes=(replace(r.classes[0], radius_px=4.0), r.classes[1]))
    assert r.products
    shares = [product_table(r.blur, core.radius_px).cubic_error for core in r.classes]
    assert shares[0] > 1.5 * shares[1]
    found = of_stars(r, stars(r, 100.0)).errors_e["phase_interpolation"]
    assert found == pytest.approx(100.0 * max(shares))


def target(r: ResponsePlan, light_e: float, size_px: float, extended: bool, way_px: float) -> float:
    """What one target's wings err by."""
    ends = np.array([[1.0], [1.0], [1.0 + way_px], [1.0]])
    place = np.zeros(1), ends, np.array([light_e]), np.array([size_px]), np.array([extended])
    return float(targets_known(r, (1000, 1000), *place).wing_error[0])


def test_what_quadrature_does_not_serve_errs_as_the_last_class() -> None:
    r = responses()
    assert target(r, 4e2, 0.0, False, 0.0) == 2e-4
    assert target(r, 9e3, 0.0, False, 0.0) == 2e-6
    assert target(r, 2e4, 0.0, False, 3.0) == 0.0  # by quadrature
    assert target(r, 2e4, 0.9, True, 0.0) == 2e-6
    cells = math.pi * (20.0 / 2.0) ** 2  # of a body, half the grid's spacing wide
    assert target(r, 2e4, 20.0, True, 0.0) == pytest.approx(2e-6 / 1.5 / math.sqrt(cells))
    assert target(r, 2e4, 20.0, False, 9e4) == 2e-6  # a point all the same
    assert target(r, 2e4, 0.0, False, 9e4) == 2e-6  # too long a path


def test_sources_of_one_place_err_together() -> None:
    r = responses(streaks=streaks(photons=False, longest_px=1.0))
    one, two = (of_stars(r, stars(r, *lights)).errors_e for lights in ([5.0], [5.0, 5.0]))
    apart = of_stars(r, stars(r, 5.0, 5.0, apart_px=3.0)).errors_e
    for component in ("common_streak", "wings_cut_off"):
        assert two[component] == pytest.approx(2.0 * one[component])
        assert apart[component] == pytest.approx(one[component])
    product = responses(streaks=streaks(longest_px=0.0), spacing_px=0, lost_light=1e-8)
    whole = tuple(replace(c, wing_error=0.0) for c in product.classes)
    product = replace(product, classes=whole)
    assert product.products
    few, more = (of_stars(product, stars(product, *n * [1e3])).errors_e for n in (1, 50))
    for component in ("phase_interpolation", "core_ends"):
        assert 0.0 < 50.0 * few[component] == pytest.approx(more[component])
    budget = of_stars(product, stars(product, 1e15)).errors_e["phase_interpolation"]
    assert budget == pytest.approx(BUDGET_E)  # brighter ones stand at their exact places


def test_noise_hides_more_than_a_part_of_bright_sources_if_light_has_any() -> None:
    lights = 100 * [1e6]  # each of which errs by 0.04 of a part
    for photons, expected in ((True, BUDGET_E), (False, 100 * 2.0 * SHOWN * BUDGET_E)):
        r = responses(streaks=streaks(photons=photons))
        assert of_stars(r, stars(r, *lights)).errors_e["common_streak"] == pytest.approx(expected)


def test_points_of_bright_paths_err_by_a_share_of_their_light() -> None:
    """0.1 millionths of 5e4 e- are 0.005; stars too bright for all classes need no table."""
    r = responses()
    r = replace(r, classes=tuple(replace(c, point_error=1e-7) for c in r.classes))
    merged = 2.0 * SHOWN * BUDGET_E
    for light_e, points_e in ((5e4, 0.005), (2e4, 0.002), (2e5, 0.0)):
        found = of_stars(r, stars(r, light_e)).errors_e["common_streak"]
        assert found == pytest.approx(merged + points_e)


def test_bounds_together() -> None:
    one, other = (
        SourceBounds(b, {WINGS: w, "common_streak": 0.3 * w}) for b, w in ((3.0, 0.2), (7.0, 0.1))
    )
    assert one.together(other).errors_e == pytest.approx({WINGS: 0.3, "common_streak": 0.06})
    assert one.worst(other).errors_e == pytest.approx({WINGS: 0.2, "common_streak": 0.06})
    assert one.together(other).brightest_e == 7.0
    assert SourceBounds().together(SourceBounds(1.0, {"core_ends": 0.1})).errors_e == {
        "core_ends": 0.1
    }


def test_wings_of_stars_and_of_targets_may_lie_in_one_pixel() -> None:
    """So their errors add up, however far apart they stand."""
    r = responses()
    found = bounds_of(r, stars(r, 9e2), stars(r, 8e2))
    assert found.errors_e[WINGS] == pytest.approx(0.17)
    assert found.brightest_e == 9e2


@pytest.mark.parametrize("sigma_px", [0.3, 0.8, 3.0, 10.0])
def test_a_pixel_lacks_no_more_than_the_brightest_place_beyond_its_core(sigma_px: float) -> None:
    radius_px = 6.07 * sigma_px
    brightest = math.exp(-0.5 * (radius_px / sigma_px) ** 2) / (2.0 * math.pi * sigma_px**2)
    found = end_share(Blur(Gaussian(sigma_px)), radius_px)
    assert brightest <= found < 2.0 * brightest
    wide = end_share(Blur(EllipticalGaussian(sigma_px, 0.5 * sigma_px, 0.4)), radius_px)
    assert wide > 1.5 * brightest  # as bright along its axis, of half the area


def many(frames: int = 1, **more: Any) -> dict[str, Any]:
    """Some of the report's satellites, before no stars."""
    data = with_accuracy(MAKERS["many-targets"](True), 0.05, 1e-3, "none")
    data.pop("stars", None)
    data["accuracy"].pop("check_cells")
    some = data["targets"][:5] + data["targets"][-2:]
    data |= {"sensor": data["sensor"] | {"shape": [256, 256]}, "background": None}
    return data | {"targets": some, "exposure": data["exposure"] | {"frames": frames}} | more


def bound(plan: Plan, component: str) -> float:
    [found] = [d.error_bound_e for d in plan.decisions if d.component == component]
    assert found is not None
    return found


def test_a_plan_that_knows_all_sources_states_what_the_product_does(tmp_path: Path) -> None:
    """Satellites of one frame: in plan and product the same bounds, from their truth."""
    scene = parse_scene(many())
    plan = prepare(scene).plan
    errors = render(scene, tmp_path / "one")["errors"]
    stated = errors["bound_of_all_approximations_sigma"]
    assert stated == pytest.approx(total_sigma(plan.decisions), rel=1e-6)
    assert errors["brightest_source_e"] < plan.facts.brightest_e  # planned with a margin
    truth = pq.read_table(tmp_path / "one" / "truth" / "targets.parquet")
    light = truth["electrons"].to_numpy()
    cut = cut_share(plan.responses.blurs, plan.responses.reach_px)
    assert bound(plan, "wings_cut_off") == pytest.approx(cut * light.max())
    points = ~truth["extended"].to_numpy()
    size_px2 = np.where(points, truth["radius_px"].to_numpy(), 0.0) ** 2
    worst_e = float((light * size_px2).max()) * point_curvature(plan.facts.blur)
    assert bound(plan, "targets.point_sources") == pytest.approx(worst_e, rel=1e-6)
    assert 0.0 < worst_e < plan.facts.budget_e
    assert not points.all()


def test_of_more_frames_than_are_looked_at_parts_are_stated(tmp_path: Path) -> None:
    scene = parse_scene(many(10))
    plan = prepare(scene).plan
    for component in ("targets.point_sources", "wings_on_a_coarse_grid"):
        assert bound(plan, component) == plan.facts.budget_e
    errors = render(scene, tmp_path / "more")["errors"]
    stated = errors["bound_of_all_approximations_sigma"]
    assert 0.0 < errors["achieved_error_sigma"] < stated < 0.9 * total_sigma(plan.decisions)
    few = prepare(parse_scene(many(2))).plan
    assert bound(few, "targets.point_sources") < few.facts.budget_e


def test_targets_whose_light_does_not_reach_the_frame_do_not_count() -> None:
    """One far off it, one behind the camera at mid-exposure, and one that is dark."""
    plan = prepare(parse_scene(many())).plan
    x = np.array([100.0, 1e6, np.nan, 200.0])
    columns = {
        "frame": np.zeros(4, int), "x_px": x, "y_px": x,
        "electrons": np.array([10.0, 1e9, 1e9, 0.0]),
        "radius_px": np.array([0.1, np.nan, 1.0, 1.0]), "extended": np.zeros(4, bool),
    } | {f"{axis}_{end}_px": x for axis in "xy" for end in ("start", "end")}  # fmt: skip
    found = _of_targets(plan, columns)
    assert found.brightest_e == 10.0
    curvature = point_curvature(plan.facts.blur)
    assert found.errors_e["targets.point_sources"] == pytest.approx(curvature * 10.0 * 0.01)


@pytest.mark.parametrize(("radius_px", "counts"), [(60.0, True), (40.0, False)])
def test_a_body_whose_edge_alone_comes_near_the_frame_counts(
    radius_px: float, counts: bool
) -> None:
    """Its middle is 50 px farther off than where a point's light would still reach it."""
    plan = prepare(parse_scene(many())).plan
    off_px = plan.scene.sensor.shape[1] + plan.halo_px + plan.responses.reach_core_px + 50.0
    columns = {f"x_{end}px": np.array([off_px]) for end in ("start_", "", "end_")}
    columns |= {f"y_{end}px": np.array([10.0]) for end in ("start_", "", "end_")}
    columns |= {
        "frame": np.zeros(1, int), "electrons": np.array([1e6]),
        "radius_px": np.array([radius_px]), "extended": np.ones(1, bool),
    }  # fmt: skip
    assert _of_targets(plan, columns).brightest_e == (1e6 if counts else 0.0)


@pytest.mark.parametrize("lost", [("start",), ("end",), ("start", ""), ("end", "")])
def test_a_target_that_is_behind_the_camera_for_a_part_counts(lost: tuple[str, ...]) -> None:
    """By where it is in the middle of its exposure, or at the end that is seen."""
    plan = prepare(parse_scene(many())).plan
    names = [f"{axis}_{part}px" for axis in "xy" for part in ("start_", "end_", "")]
    columns = dict.fromkeys(names, np.array([100.0])) | {
        "frame": np.zeros(1, int), "electrons": np.array([1e6]),
        "radius_px": np.zeros(1), "extended": np.zeros(1, bool),
    }  # fmt: skip
    whole = _of_targets(plan, columns)
    for name in names:
        if name[2:].removesuffix("px").removesuffix("_") in lost:
            columns[name] = np.array([np.nan])
    found = _of_targets(plan, columns)
    assert found.brightest_e == whole.brightest_e == 1e6
    assert found.errors_e == whole.errors_e


def test_streaking_targets_stand_in_the_middle_of_their_paths() -> None:
    """Half way between their first and last places, the fastest 3 px and more from either."""
    found = resolve(parse_scene(many()))
    g, known = found.geometry, found.targets
    assert known is not None
    for place, at in ((known.x_px, g.target_x_px[:, 0]), (known.y_px, g.target_y_px[:, 0])):
        assert place == pytest.approx(0.5 * (at[:, 0] + at[:, -1]), abs=0.01)
        assert np.abs(place - at[:, 0]).max() > 3.0


def test_wings_of_bright_targets_come_from_far_beside_the_frame() -> None:
    x = np.array([[[500.0, 510.0]], [[5000.0, 5000.0]]])
    g = cast(Geometry, SimpleNamespace(target_x_px=x, target_y_px=np.full_like(x, 10.0)))
    scene = cast(Scene, SimpleNamespace(sensor=SimpleNamespace(shape=(32, 32))))
    assert not near_frame(scene, g).any()
    assert near_frame(scene, g, FARTHEST_PX).ravel().tolist() == [True, False]


def test_a_product_errs_by_its_stars_and_its_targets_together() -> None:
    """Wings of a bright star and of a bright target reach the same pixels."""
    truths = Truths(None, Path(), ExitStack())  # type: ignore[arg-type]
    truths.__dict__["_tables"] = {}  # of frames without a table
    truths._found["stars"] = SourceBounds(5.0, {WINGS: 0.1})
    truths._found["targets"] = SourceBounds(7.0, {WINGS: 0.2})
    _, drawn = truths.end()
    assert drawn.errors_e == pytest.approx({WINGS: 0.3})
    assert drawn.brightest_e == 7.0
