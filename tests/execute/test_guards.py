"""Guards: each trips on a fault of its kind, and names frame, tile, and the source or layer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.arrays import SensorMaps
from pipeline.errors import NightglassError
from pipeline.execute import light as light_module
from pipeline.execute.guards import guard_mean, guard_places
from pipeline.execute.sources import FrameTarget, place_stars
from pipeline.execute.tile import TileSources, render_tile
from pipeline.physics.drawing import stamps
from pipeline.physics.motion.streak import POINT
from pipeline.plan.tiles import Tile
from tests.execute.test_engines import SIDE, WHOLE, field, geometry_of, plan_of

MAPS = SensorMaps(1.0, 0.0, 5.0, 1.0, 100.0)
GAUSS = {"kind": "gaussian", "sigma_px": 0.8}


def render(plan, stars):
    return render_tile(plan, MAPS, geometry_of(plan), WHOLE, TileSources([stars], []))


def stars(light=1e4):
    return field(np.array([60.2, 90.7]), np.array([70.7, 70.1]), np.array([light, 2e4]))


@pytest.fixture(scope="module")
def plan():
    return plan_of(GAUSS, 0.0, 0.0)


def test_no_fault_no_word(plan):
    layers, _ = render(plan, stars())
    assert layers["dn"].shape == (SIDE, SIDE)


@pytest.mark.parametrize("light", [np.nan, np.inf])
def test_light_that_is_not_finite_names_the_star(plan, light):
    with pytest.raises(NightglassError, match="frame 0, tile at row 0, column 0: star 0 has"):
        render(plan, stars(light))


def test_a_layer_that_is_not_finite_is_named(plan):
    dark = np.zeros((SIDE, SIDE))
    dark[7, 9] = np.nan
    maps = replace(MAPS, dark_e_per_s=dark)
    with pytest.raises(NightglassError, match=r"frame 0.*dark_e_per_s\) is not .* row 7, col"):
        render_tile(plan, maps, geometry_of(plan), WHOLE, TileSources([stars()], []))


def test_a_negative_mean_names_the_layer(plan):
    maps = replace(MAPS, dark_e_per_s=np.full((SIDE, SIDE), -50.0))
    with pytest.raises(NightglassError, match=r"-50 e-, below zero.*lowest is dark_e"):
        render_tile(plan, maps, geometry_of(plan), WHOLE, TileSources([stars()], []))


def test_rounding_below_zero_is_clipped_and_no_more(plan):
    g, mean_e = geometry_of(plan), np.full((SIDE, SIDE), 3.0)
    mean_e[5, 7], layers = -1e-6, {"stars_e": mean_e}
    found = guard_mean(plan, g, WHOLE, mean_e, layers, 0.0)
    assert found[5, 7] == 0.0
    assert np.array_equal(found, np.maximum(mean_e, 0.0))
    mean_e[5, 7] = -1.0
    with pytest.raises(NightglassError, match="below zero by more than rounding"):
        guard_mean(plan, g, WHOLE, mean_e, layers, 0.0)
    assert guard_mean(plan, g, WHOLE, mean_e, layers, 0.5)[5, 7] == 0.0  # as much as wings err by


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_light_that_is_lost_or_made_is_seen(plan, factor, monkeypatch):
    def wrong(image, origin, table, x, y, light, cubic):
        stamps.draw_stamps(image, origin, table, x, y, factor * light, cubic)

    monkeypatch.setattr(light_module, "draw_stamps", wrong)
    with pytest.raises(NightglassError, match=r"frame 0.*stars_e holds .* e-, where its sources"):
        render(plan, stars())


def test_an_engine_that_makes_no_number_names_the_layer(plan, monkeypatch):
    """Whatever its sum, which is no number either."""

    def wrong(image, origin, table, x, y, light, cubic):
        stamps.draw_stamps(image, origin, table, x, y, light, cubic)
        image[40, 50] = np.nan

    monkeypatch.setattr(light_module, "draw_stamps", wrong)
    with pytest.raises(NightglassError, match=r"stars_e \(stars\) is not .* row 40, column 50"):
        render(plan, stars())


def test_layers_too_bright_together_are_named(plan):
    """Each of them is a number, their sum is none."""
    layers = {"stars_e": np.full((SIDE, SIDE), 1e308), "dark_e": np.full((SIDE, SIDE), 1e308)}
    with np.errstate(over="ignore"):
        mean_e = layers["stars_e"] + layers["dark_e"]
    with pytest.raises(NightglassError, match="too much light in stars_e and dark_e"):
        guard_mean(plan, geometry_of(plan), WHOLE, mean_e, layers, 0.0)


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_light_of_targets_that_is_lost_or_made_is_told_of_their_layer(plan, factor, monkeypatch):
    right, target = light_module._draw_path, FrameTarget(0, 60.2, 70.7, POINT, 1e4)

    def wrong(*given):
        right(*given[:-1], factor * given[-1])

    monkeypatch.setattr(light_module, "place_targets", lambda plan, g: [target])
    light_module.draw_targets(plan, geometry_of(plan), WHOLE, [])
    monkeypatch.setattr(light_module, "_draw_path", wrong)
    with pytest.raises(NightglassError, match=r"frame 0.*targets_e holds .* e-, where its sources"):
        light_module.draw_targets(plan, geometry_of(plan), WHOLE, [])


def test_a_part_of_the_frame_holds_a_part_of_the_light(plan):
    """Sources at and beyond the edge make no false alarm."""
    x, y = np.meshgrid(np.linspace(-3.0, SIDE + 2.0, 23), np.linspace(-3.0, SIDE + 2.0, 23))
    many = field(x.ravel(), y.ravel(), np.full(x.size, 1e5))
    part = Tile(0, 0, 16, 32, 40, 24)
    for tile in (WHOLE, part):
        layers, _ = render_tile(plan, MAPS, geometry_of(plan), tile, TileSources([many], []))
        assert layers["dn"].max() > 1000


def test_a_place_off_its_direction_is_named(plan):
    g = geometry_of(plan)
    x = y = np.array([20.0, 30.0])
    from pipeline.physics.positions.focal_plane import deproject

    direction = deproject(plan.camera, g.attitude[0, g.middle], x, y)
    guard_places(plan, g.attitude[0, g.middle], x, y, direction, ["star 1", "star 2"])
    off = x + np.array([0.0, 2e-3])
    with pytest.raises(NightglassError, match=r"star 2: its pixel \(30\.0020, 30\.0000\)"):
        guard_places(plan, g.attitude[0, g.middle], off, y, direction, ["star 1", "star 2"])


def test_placing_stars_looks_at_places(plan, monkeypatch):
    """A projection that does not agree with its inverse is refused when stars are placed."""
    from pipeline.arrays import StarTable
    from pipeline.execute import sources

    one = np.radians([[40.0], [25.0]])
    table = StarTable(
        np.array([77]), one[0], one[1], *(np.full(1, np.nan) for _ in range(4)), np.array([9.0]),
        np.array([1e4]), np.zeros(1, np.uint8),
    )  # fmt: skip
    g = geometry_of(plan)
    assert len(place_stars(plan, table, g, 2015.5)) == 1
    right = sources.project
    monkeypatch.setattr(sources, "project", lambda *a: tuple(v + 0.01 for v in right(*a)))
    with pytest.raises(NightglassError, match="star 77: its pixel"):
        place_stars(plan, table, g, 2015.5)
