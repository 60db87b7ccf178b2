"""The bounds of all approximations sum to no more than is asked, or the scene is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.errors import BadInput
from pipeline.physics.psf.band import BandOptics, NoiseLimit, choose_wavelengths
from pipeline.physics.psf.pupil import Airy, Blur
from pipeline.plan.accuracy import (
    doubts_of,
    doubts_of_light,
    for_sources,
    judge,
    part_sigma,
    parts,
    total_e,
    total_sigma,
)
from pipeline.plan.decision import Decision
from pipeline.plan.facts import planned_floor_e
from pipeline.plan.response.streaks import StreakPlan
from pipeline.plan.sensor.detector import lag_depth
from pipeline.route.prepare import plan_scene
from pipeline.spec.load import load_scene, parse_scene, parse_yaml
from pipeline.studies.scenes.scenes import requests

ROOT = Path(__file__).resolve().parents[2]
SCENES = [*sorted((ROOT / "examples").glob("*.yaml")), ROOT / "pipeline" / "scenes" / "demo.yaml"]
ACCEPTED = {"accept": ["error"]}


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> str:
    """40,000 stars all over the sky, G 3 to 16, as bright ones as a leaf may hold."""
    folder = tmp_path_factory.mktemp("sky")
    rng = np.random.default_rng(3)
    ra, dec = rng.uniform(0, 360, 40_000), np.degrees(np.arcsin(rng.uniform(-1, 1, 40_000)))
    g = 16.0 - rng.exponential(1.3, 40_000).clip(max=13.0)
    rows = np.column_stack([np.arange(40_000) + 1, ra, dec, g])
    csv = folder / "stars.csv"
    names = "source_id,ra,dec,phot_g_mean_mag"
    np.savetxt(csv, rows, delimiter=",", header=names, comments="", fmt=["%d", *3 * ["%.9f"]])
    ingest([csv], folder / "catalogue", form="gaia_dr2", workers=1)
    return str(folder / "catalogue")


def planned(data: dict[str, Any]) -> dict[str, Any]:
    return plan_scene(parse_scene(data))


def sum_of_bounds(plan: dict[str, Any]) -> float:
    """Of all lines of a plan but the one that stands for another."""
    counted = [d for d in plan["decisions"] if d["component"] != "crowds_by_transforms"]
    return sum(d["error_bound_sigma"] or 0.0 for d in counted)


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_examples_keep_what_they_ask_for(path: Path, catalogue: str) -> None:
    scene = load_scene(path, [f"stars.catalogue={catalogue}"])
    plan = plan_scene(scene)
    assert sum_of_bounds(plan) <= scene.accuracy.noise_fraction * (1 + 1e-9)
    assert not any("err by" in warning for warning in plan["warnings"])


def test_scenes_of_the_report_keep_what_they_ask_for(catalogue: str) -> None:
    scenes = requests((), quick=True)
    assert len(scenes) == 7
    for one in scenes:
        data = one.data
        if data.get("stars"):
            data["stars"]["catalogue"] = catalogue
        plan = planned(data)
        assert sum_of_bounds(plan) <= 0.05 * (1 + 1e-9), one.name
        assert not any("err by" in warning for warning in plan["warnings"])


def test_more_than_asked_is_refused_or_stands_first(scene: Any) -> None:
    lines = (Decision("one", True, "", 1.0, 0.03), Decision("two", True, "", 1.0, 0.04))
    asked = scene({"accuracy": {"noise_fraction": 0.07}})
    assert judge(asked, lines) == []
    strict = {"accuracy": {"noise_fraction": 0.06}}
    with pytest.raises(BadInput, match=r"accuracy.noise_fraction: 0.06 .* at least 0.07.*two 0.04"):
        judge(scene(strict), lines)
    (warning,) = judge(scene(strict | ACCEPTED), lines)
    assert "0.07" in warning
    assert "0.06" in warning


@pytest.mark.parametrize("total", [0.0621, 0.0629, 0.062, 0.9991])
def test_what_a_refusal_names_as_enough_is_enough(scene: Any, total: float) -> None:
    """A scene that asks for what the message allows is drawn."""
    half = Decision("core_ends", True, "", error_bound_sigma=0.5 * total)
    both = half, replace(half, component="wings_cut_off")
    with pytest.raises(BadInput, match="at least") as refused:
        judge(scene(), both)
    least = float(str(refused.value).partition("at least ")[2].partition(",")[0])
    assert total <= least < total + 1e-3
    asked = {"accuracy": {"noise_fraction": least}}
    assert judge(scene(asked), both) == []


def test_an_approximation_that_stands_for_another_is_not_counted(scene: Any) -> None:
    lines = (Decision("phase_interpolation", True, "", 1.0, 0.03),
             Decision("crowds_by_transforms", True, "", 1.0, 0.03))  # fmt: skip
    assert total_sigma(lines) == 0.03
    assert total_e(lines) == 1.0


def test_every_part_is_counted(scene: Any) -> None:
    none = scene({"stars": None})
    assert parts(none) == 1.0
    gaussian = scene({"sensor.psf": {"kind": "gaussian", "sigma_px": 1.0}})
    assert parts(gaussian) == 2.25  # phases, streaks; a quarter for frames that share stars
    one = {"exposure": {"integration_s": 1.0}}
    assert parts(scene({"sensor.psf": {"kind": "gaussian", "sigma_px": 1.0}} | one)) == 2.0
    airy = scene({"sensor.psf": {"kind": "airy"}})
    assert parts(airy) == 5.25  # and the wings' grid and end, the wavelengths
    for given in ({"wavelengths": 4}, {"wavelength_nm": 650.0}):
        assert parts(scene({"sensor.psf": {"kind": "airy"} | given})) == 4.25  # as the scene says
    with_sky = scene({"sensor.psf": {"kind": "airy"}, "background": {"zodiacal": True}})
    assert parts(with_sky) == 5.5
    at = {"mode": "sidereal", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0}
    away = {"dwells": [{}, {"pointing": at, "slew": {"duration_s": 8.0}}]}  # no shared stars
    assert parts(scene({"sensor.psf": {"kind": "gaussian", "sigma_px": 1.0}} | away)) == 2.0
    lag = {"sensor.detector": {"lag": {"fraction": 0.05}}, "sensor.full_well_e": 9e4}
    assert parts(scene({"sensor.psf": {"kind": "airy"}} | lag)) == 5.5


def test_without_photon_noise_an_approximation_may_err_by_a_quarter(scene: Any) -> None:
    """Several bright sources of a pixel add their errors, and no noise of theirs hides them."""
    gaussian = {"sensor.psf": {"kind": "gaussian", "sigma_px": 1.0}}
    asked = {"accuracy": {"noise_fraction": 0.09}}
    assert part_sigma(scene(gaussian | asked)) == pytest.approx(0.09 / 2.25)
    quiet = scene(gaussian | asked | {"sensor.photon_noise": False})
    assert part_sigma(quiet) == pytest.approx(0.09 / 2.25 / 4.0)


@pytest.mark.parametrize("light_e", [1e4, 1e6, 1e8])
def test_wavelengths_follow_the_brightest_source(light_e: float) -> None:
    """Pixels along an axis beside it, against 2,000 wavelengths by quadrature."""
    nm, blur = np.linspace(400e-9, 900e-9, 64), Blur(Airy(1.0), jitter_px=0.3)
    limit = NoiseLimit(light_e, 6.0, 0.01)

    def chosen(most: NoiseLimit) -> BandOptics:
        make = lambda w: Airy(w / 600e-9, 0.3)  # noqa: E731
        return choose_wavelengths(make, blur, nm, np.ones(64), 1e-3, limit=most)

    found = chosen(limit)
    x = np.arange(0.0, 30.0, 3.1)
    even = 400e-9 + 500e-9 * (np.arange(2000) + 0.5) / 2000
    whole = _pixels(even, np.full(2000, 1.0 / 2000), x)
    error_e = light_e * np.abs(_pixels(found.wavelengths_m, found.weights, x) - whole)
    assert (error_e / np.sqrt(36.0 + light_e * whole)).max() <= limit.sigma
    assert found.error_sigma <= limit.sigma
    assert len(chosen(replace(limit, light_e=1e2)).wavelengths_m) < len(found.wavelengths_m)


def _pixels(wavelengths_m: Any, weights: Any, x_px: np.ndarray) -> np.ndarray:
    """Light of pixels at (x, 0) from a source at (0, 0), by polar quadrature of the transfer
    function of aperture (Q = 1 at 600 nm, obscured 0.3), jitter of 0.3 px and pixel."""
    f, angle = np.linspace(0.0, 1.5, 3001), (np.arange(90) + 0.5) * np.pi / 180.0
    radial = sum(w * Airy(m / 600e-9, 0.3).radial(f)
                 for m, w in zip(wavelengths_m, weights, strict=True))  # fmt: skip
    radial = radial * np.exp(-2.0 * (np.pi * 0.3 * f) ** 2) * f
    fx, fy = np.outer(f, np.cos(angle)), np.outer(f, np.sin(angle))
    pixel = np.sinc(fx) * np.sinc(fy)
    means = [(pixel * np.cos(2.0 * np.pi * fx * x)).mean(axis=1) for x in x_px]
    return np.array([2.0 * np.pi * np.trapezoid(radial * m, f) for m in means])


def test_doubts_of_a_finished_product() -> None:
    assert doubts_of(0.04, 0.039) == doubts_of(0.04, None) == []
    (found,) = doubts_of(0.04, 0.5)
    assert "0.5" in found
    assert "0.04" in found
    (brighter,) = doubts_of_light(0.05, 0.08)
    assert "0.08" in brighter
    assert doubts_of_light(0.05, 0.05) == doubts_of_light(0.05, 0.04) == []


def test_a_brighter_source_raises_what_goes_with_its_light() -> None:
    lines = (Decision("few_wavelengths", True, "", 2.0, 0.02),
             Decision("common_streak", True, "", 1.0, 0.01))  # fmt: skip
    drawn = for_sources(lines, {}, 100.0, 3.0)
    assert total_sigma(drawn) == pytest.approx(0.07)
    assert total_e(drawn) == pytest.approx(7.0)
    assert total_sigma(for_sources(lines, {}, 100.0, 0.5)) == pytest.approx(0.03)


def test_what_follows_from_the_light_of_all_sources_takes_the_place_of_a_part() -> None:
    lines = (Decision("wings_cut_off", True, "", 1.0, 0.01),
             Decision("common_streak", True, "", 1.0, 0.01),
             Decision("star_engines", True, ""))  # fmt: skip
    known = {"wings_cut_off": 0.5, "star_engines": 7.0, "of_another_scene": 9.0}
    drawn = for_sources(lines, known, 10.0, 3.0)
    assert [d.error_bound_e for d in drawn] == [0.5, 1.0, None]
    assert total_sigma(drawn) == pytest.approx(0.05 + 0.01)
    assert [d.component for d in drawn] == [d.component for d in lines]


@pytest.mark.parametrize(("noise_floor_e", "floor_e"), [(None, 5.0), (2.0, 2.0), (100.0, 5.0)])
def test_drawing_is_planned_for_no_more_noise_than_there_is(
    noise_floor_e: float | None, floor_e: float
) -> None:
    data = parse_yaml((ROOT / "pipeline" / "scenes" / "demo.yaml").read_text(), "demo.yaml")
    accuracy = {"noise_floor_e": noise_floor_e} if noise_floor_e else {}
    assert planned_floor_e(parse_scene(data | {"accuracy": accuracy}), 5.0) == floor_e


def test_charge_is_carried_over_from_as_many_frames_as_are_worth_drawing(scene: Any) -> None:
    """What is left of a full well after them is a quarter of a part of the noise, at most."""
    lag = {"sensor.detector": {"lag": {"fraction": 0.09}}, "sensor.full_well_e": 9e4}
    s = scene(lag)
    depth, left_e = lag_depth(s, 5.0), 0.25 * part_sigma(s) * 5.0
    assert 9e4 * 0.09 ** (depth + 1) <= left_e < 9e4 * 0.09**depth


def test_streaks_are_off_by_half_a_step_and_all_that_they_were_merged_by() -> None:
    assert StreakPlan(1, 1, 0.0, 0.0, 1, step_px=0.2, merge_px=0.3).rounding_px == 0.1 + 0.3
