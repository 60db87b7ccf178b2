"""Stars and targets as bright as they come: every pixel against quadrature of the profile."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import erfc

from pipeline.errors import BadInput
from pipeline.execute import check
from pipeline.execute.blocks import render_block, target_class
from pipeline.execute.check import reference
from pipeline.execute.light import draw_stars
from pipeline.execute.sources import FrameTarget, place_targets, setting_stars
from pipeline.physics.motion.streak import HALVINGS, POINT, Path
from pipeline.physics.psf.pupil import Airy, Blur
from pipeline.physics.psf.sampled import sampled
from pipeline.physics.psf.seeing import Kolmogorov, Moffat
from pipeline.plan.plan import Plan
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.streaks import SHOWN, centroid
from pipeline.plan.tiles import Tile
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.studies.accuracy.reference import AiryStar, straight
from tests.execute.test_behind import SCENE as SLIPPING
from tests.execute.test_engines import field, geometry_of, plan_of
from tests.plans import plan_from
from tests.studies.accuracy.test_reference import by_intensity

SIDE, SIGMA, READ_E = 64, 1.1, 5.0
X, Y = np.array([30.3]), np.array([33.8])
MOFFAT = {"kind": "moffat", "fwhm_px": 2.1, "beta": 3.0}


def gaussian_pixels() -> np.ndarray:
    """The error function in square pixels."""

    def side(at: float) -> np.ndarray:
        x = np.abs(np.arange(SIDE) - at)
        return 0.5 * (erfc((x - 0.5) / SIGMA / 2**0.5) - erfc((x + 0.5) / SIGMA / 2**0.5))

    return np.outer(side(Y[0]), side(X[0]))


def round_pixels(intensity: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """A round profile in square pixels, by two panels of Gauss-Legendre each way."""
    at, weight = np.polynomial.legendre.leggauss(18)
    at, weight = np.r_[at - 1.0, at + 1.0] / 4.0, np.tile(weight, 2) / 4.0
    y = (np.arange(SIDE)[:, None] + at).ravel() - Y[0]
    x = (np.arange(SIDE)[:, None] + at).ravel() - X[0]
    light = intensity(np.hypot(y[:, None], x)).reshape(SIDE, 36, SIDE, 36)
    return np.einsum("iajb,a,b->ij", light, weight, weight)


def table_plan() -> Plan:
    """Of a plan with a gaussian, with samples of it instead, four a pixel."""
    plan = plan_of({"kind": "gaussian", "sigma_px": SIGMA}, 0.0, 0.0, SIDE)
    at = (np.arange(81) - 40) / 4.0
    image = np.exp(-0.5 * (at[:, None] ** 2 + at**2) / SIGMA**2)
    facts = replace(plan.facts, blur=Blur(sampled(image, 0.25, "middle")))
    return plan_from(plan.scene, facts, geometry_of(plan))


def case(name: str) -> tuple[Plan, np.ndarray]:
    """A plan, and the light in each pixel of a star of one electron."""
    if name == "table":
        return table_plan(), gaussian_pixels()
    psf: dict[str, Any] = {
        "gaussian": {"kind": "gaussian", "sigma_px": SIGMA},
        "airy": {"kind": "airy", "wavelength_nm": 650.0},
        "moffat": MOFFAT,
    }[name]
    plan = plan_of(psf, 0.0, 0.0, SIDE)
    if name == "gaussian":
        return plan, gaussian_pixels()
    optics = Airy(1.0, 0.3) if name == "airy" else Moffat(2.1, 3.0)
    assert plan.facts.blur.optics.scale_px == pytest.approx(optics.scale_px, rel=1e-12)
    return plan, round_pixels(plan.facts.blur.optics.intensity)


def drawn(plan: Plan, light_e: float, tile: Tile = Tile(0, 0, 0, 0, SIDE, SIDE)) -> np.ndarray:
    stars, g = field(X, Y, np.array([light_e])), geometry_of(plan)
    whole = Tile(0, 0, 0, 0, SIDE, SIDE)
    blocks = [render_block(plan, g, whole, [stars])] if plan.responses.spacing_px else []
    return draw_stars(plan, g, tile, [stars], blocks)


@pytest.mark.parametrize("light_e", [1e4, 1e6, 1e9, 1e12, 1e15, 1e18])
@pytest.mark.parametrize("name", ["gaussian", "airy", "moffat", "table"])
def test_every_pixel_is_within_the_accuracy(name: str, light_e: float) -> None:
    """Of its own noise, and never darker than none by more than the budget at the floor."""
    plan, exact = case(name)
    if name == "table" and light_e > 1e12:
        pytest.skip("read to 1e-13 of the light")
    image = drawn(plan, light_e)
    noise_e = np.sqrt(READ_E**2 + light_e * exact)
    sigma = np.abs(image - light_e * exact) / noise_e
    assert sigma.max() <= plan.scene.accuracy.noise_fraction
    assert image.min() >= -plan.responses.budget_e


@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("name", ["airy", "moffat"])
def test_wings_of_a_crowd_err_by_no_more_than_is_told(name: str, number: int) -> None:
    """Fifty stars in one place, just faint enough for their class: their errors add up."""
    plan, exact = case(name)
    light_e = 0.99 * plan.responses.classes[number].brightest_e
    stars = field(np.repeat(X, 50), np.repeat(Y, 50), np.full(50, light_e))
    g, whole = geometry_of(plan), Tile(0, 0, 0, 0, SIDE, SIDE)
    block = render_block(plan, g, whole, [stars])
    off_e = np.abs(draw_stars(plan, g, whole, [stars], [block]) - 50.0 * light_e * exact).max()
    assert plan.responses.budget_e < off_e < block.wing_error_e


@pytest.mark.parametrize("name", ["airy", "moffat", "gaussian"])
def test_the_check_agrees(name: str) -> None:
    """Windows drawn again do not go through what they check; nor without time for it."""
    plan, exact = case(name)
    for light_e in (1e5, 1e13):
        window, star = Tile(0, 0, 24, 40, 16, 16), field(X, Y, np.array([light_e]))
        found, count = reference(plan, geometry_of(plan), window, star)
        assert reference(plan, geometry_of(plan), window, star, most_s=0.0) == (None, 1)
        assert count == 1
        expected = light_e * exact[24:40, 40:56]
        assert np.abs(found - expected).max() <= 1e-11 * expected.max() + 1e-9


def test_the_check_follows_a_bright_target_past_where_wings_fade_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Pixels just within and far past it hold an Airy pattern's light by its closed form."""
    plan, _ = case("airy")
    target = FrameTarget(0, X[0], Y[0], POINT, 1e13)
    monkeypatch.setattr(check, "place_targets", lambda *_: [target])
    for at in (0.98, 1.5):
        x0, nobody = int(X[0] + at * plan.responses.fades_px), field(*np.zeros((3, 0)))
        found, _ = reference(plan, geometry_of(plan), Tile(0, 0, 26, x0, 4, 4), nobody)
        for row, column in ((0, 0), (2, 3)):
            place = float(x0 + column), float(26 + row)
            closed = by_intensity(AiryStar(1.0, 0.3), straight(0.0, 0.0), X[0], Y[0], *place)
            assert found[row, column] == pytest.approx(1e13 * closed, rel=1e-7)


def test_the_check_sees_cores_that_end_too_early() -> None:
    """Stars together, in a plan whose cores end after 3 px: the check's own do not."""
    plan, exact = case("gaussian")
    short = tuple(replace(c, radius_px=3.0) for c in plan.responses.classes)
    plan = replace(plan, responses=replace(plan.responses, classes=short))
    window, pair = Tile(0, 0, 26, 22, 16, 16), field(np.r_[X, X], np.r_[Y, Y], np.full(2, 5e3))
    found, _ = reference(plan, geometry_of(plan), window, pair, own_paths=0)
    assert np.abs(found - 1e4 * exact[26:42, 22:38]).max() < 0.01


def test_tiles_change_no_bit_of_a_bright_star() -> None:
    plan, _ = case("airy")
    whole = drawn(plan, 1e10)
    part = drawn(plan, 1e10, Tile(0, 0, 20, 7, 30, 41))
    assert np.array_equal(part, whole[20:50, 7:48])


def test_more_light_than_rounding_allows_is_refused() -> None:
    plan, _ = case("gaussian")
    with pytest.raises(BadInput, match="noise_fraction"):
        drawn(plan, 1e22)


def test_which_class_a_target_is_drawn_in() -> None:
    """By its light; past the last class by quadrature, save for bodies and what that cannot pay."""
    classes = [SimpleNamespace(target_e=limit) for limit in (1e3, 1e6)]
    blurs = [Blur(Airy(1.3)), Blur(Moffat(2.1, 3.0))]
    plan: Any = SimpleNamespace(
        responses=SimpleNamespace(classes=classes, blurs=blurs),
        scene=SimpleNamespace(sensor=SimpleNamespace(shape=(2048, 2048))),
    )
    streak = Path(np.array([0.0, 900.0]), np.zeros(2), np.ones(1))
    body: Any = object()
    for light_e, path, shown, expected in (
        (10.0, POINT, None, 0), (1e3, POINT, None, 0), (1001.0, POINT, None, 1),
        (1e6, POINT, None, 1), (1.1e6, POINT, None, 2), (1.1e6, streak, None, 1),
        (10.0, streak, None, 0), (1.1e6, POINT, body, 1), (10.0, POINT, body, 0),
    ):  # fmt: skip
        target = FrameTarget(0, 5.0, 5.0, path, light_e, 3.0, shown)
        assert target_class(plan, target) == expected, (light_e, expected)
    blurs[:] = [Blur(Airy(1.3)), Blur(Kolmogorov(2.0))]  # one without a profile in closed form
    assert target_class(plan, FrameTarget(0, 5.0, 5.0, POINT, 1.1e6)) == 1


@pytest.mark.parametrize("photons", [True, False])
@pytest.mark.parametrize("rate", [1e3, 1e8, 1e10, 1e12])
def test_the_brighter_a_target_the_closer_it_keeps_to_its_path(rate: float, photons: bool) -> None:
    """Its light is where it was sent, to SHOWN of the budget: of a path that bends by 2e-4 px.

    Between the nodes, too, as far as halving their steps leaves it.
    """
    sensor = SLIPPING["sensor"] | {"photon_noise": photons}
    plan = prepare(parse_scene(SLIPPING | {"sensor": sensor})).plan
    g = plan_geometry(plan.scene, np.array([0]), 0.0)
    time = np.linspace(-1.0, 1.0, g.nodes)
    g.target_x_px[0, 0], g.target_y_px[0, 0] = 127.5 + 3.0 * time, 127.5 + 1.9e-4 * time**2
    g.target_light[0, 0] = rate * g.target_light[0, 0].mean()
    [made] = place_targets(plan, g)
    left_px = 1.9e-4 / (g.nodes - 1) ** 2 / 4.0**HALVINGS
    off_px = abs(centroid(made.path)[1] + made.y_px - 127.5 - 1.9e-4 / 3.0) - left_px
    floor_e, budget_e = plan.facts.sigma_floor_e, plan.responses.budget_e
    rises = math.sqrt(1.0 + photons * made.light_e / 6.0 / floor_e**2)
    assert off_px * made.light_e / 6.0 <= 1.01 * SHOWN * budget_e * rises


@pytest.mark.parametrize("light_e", [1e3, 3e3])
def test_a_star_that_sets_follows_its_way_as_if_it_did_not(light_e: float) -> None:
    """A px of its way has the same light however much of it is seen, and may be off as little; that
    of a fainter star by more."""
    plan, paths = plan_of({"kind": "gaussian", "sigma_px": 1.0}, 0.0, 0.0, roll_deg=10.0), []
    for part, whole_e in ((0.1, light_e), (0.999, light_e), (0.999, 100.0)):
        stars = field(np.array([60.0]), np.array([60.0]), np.array([part * whole_e]))
        stars = replace(stars, visible_fraction=np.array([part]))
        paths += [star.path for star in setting_stars(plan, geometry_of(plan), stars)]
    assert paths[1].segments > paths[2].segments > 8
    np.testing.assert_array_equal(paths[0].x_px, paths[1].x_px)


@pytest.mark.parametrize("light_e", [1e8, 1e9])
def test_a_bright_streak_that_turns_is_right_between_the_nodes(light_e: float) -> None:
    """A camera that turns by 50 degrees: the error function along an arc of 18 px.

    Straight between the nodes it was 0.23 and 0.7 sigma off.
    """
    plan = plan_of({"kind": "gaussian", "sigma_px": 0.5}, 0.0, 0.0, SIDE, 50.0)
    stars = field(np.array([45.0]), np.array([47.0]), np.array([light_e]))
    g, whole = geometry_of(plan), Tile(0, 0, 0, 0, SIDE, SIDE)
    image = draw_stars(plan, g, whole, [stars], [render_block(plan, g, whole, [stars])])
    angle = np.radians(50.0) * ((np.arange(20_000) + 0.5) / 20_000 - 0.5)
    turned = complex(13.5, 15.5) * np.exp(1j * angle)
    edges = (np.arange(SIDE + 1) - 32.0) / 0.5 / 2**0.5
    x, y = (
        np.diff(-0.5 * erfc(edges - v[:, None] / 0.5 / 2**0.5)) for v in (turned.real, turned.imag)
    )
    right = light_e * (y.T @ x) / len(angle)
    assert (np.abs(image - right) / np.sqrt(READ_E**2 + right)).max() < 0.05
