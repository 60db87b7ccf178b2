"""Accuracy is asked for, and kept.

A scene carries one accuracy target: the error of all approximations together in a pixel, over that
pixel's noise (5% unless said), and of each source's flux (1e-3). The cheapest way is taken whose
bounds sum to no more than that. What cannot be kept stops the render, or is accepted by name and
stands first in the plan, the product and the page. A bound is tight: between 1 and 10 times the
largest error found. The product reports what was achieved.
"""

# Deeper, elsewhere: tests/plan/test_accuracy.py (the sum of bounds of every example),
# tests/ledger_report (the bound of each approximation against its error, measured anew),
# tests/scene_report (whole scenes against exact windows), tests/execute/test_engines.py,
# test_bright_sources.py, test_crowd.py, test_crowds_of_bright_stars.py, test_wings_of_targets.py,
# tests/physics/drawing (each way of drawing against quadrature), tests/cli/test_as_stated.py.

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.execute import check
from pipeline.plan.accuracy import total_sigma
from pipeline.plan.needs import NOTHING_SPENT
from pipeline.route import finish
from pipeline.route.prepare import plan_scene, prepare, summary_of
from pipeline.route.run import Options, render
from pipeline.spec.load import scene_yaml
from pipeline.store.cube import open_cube
from pipeline.studies.accuracy.reference import GaussianStar, Track, exact_pixels
from tests.command import nightglass
from tests.rules.conftest import SIDEREAL, layers, truth

ROOT = Path(__file__).resolve().parents[2]
SIGMA_PX = 1.1
BARE = {"cosmic_rays": None, "sensor.shape": [256, 256], "exposure": {"integration_s": 1.0}}


@pytest.fixture(scope="module")
def small(scene):
    """One frame of 256 x 256 px without cosmic rays."""
    return lambda more=None: scene(BARE | (more or {}))


def test_the_target_is_5_percent_and_a_thousandth_unless_said(scene):
    asked = scene().accuracy
    assert (asked.noise_fraction, asked.flux_fraction) == (0.05, 1e-3)


PSFS = st.sampled_from([
    {"kind": "gaussian", "sigma_px": 0.7}, {"kind": "gaussian", "sigma_px": SIGMA_PX},
    {"kind": "airy", "wavelength_nm": 650.0}, {"kind": "moffat", "fwhm_px": 2.1},
])  # fmt: skip


@given(
    psf=PSFS, asked=st.sampled_from([0.01, 0.03, 0.05, 0.2, 1.0]), moving=st.booleans(),
    seconds=st.sampled_from([0.5, 3.0]),
)  # fmt: skip
@example({"kind": "airy"}, 0.05, True, 3.0)
@settings(max_examples=8)
def test_bounds_sum_to_no_more_than_is_asked(small, psf, asked, moving, seconds):
    """Whatever draws the sources; and each approximation takes no more than its part."""
    pointing = {} if moving else {"pointing": SIDEREAL}
    wish = {"sensor.psf": psf, "accuracy": {"noise_fraction": asked},
            "exposure": {"integration_s": seconds}}  # fmt: skip
    plan = prepare(small(wish | pointing)).plan
    assert 0.0 < total_sigma(plan.decisions) <= asked * (1 + 1e-9)
    assert not plan.warnings


def exact_stars(product: Path, shape: tuple[int, int]) -> np.ndarray:
    """The light of all stars of the truth, each integrated over every pixel by quadrature."""
    stars, image = truth(product, "stars"), np.zeros(shape)
    rows, columns = (np.arange(float(n)) for n in shape)
    for i, light in enumerate(stars["electrons"]):
        x, y = stars["x_px"][i], stars["y_px"][i]
        ends = [
            np.array([[stars[f"{a}_start_px"][i], stars[f"{a}_end_px"][i]]]) - at
            for a, at in (("x", x), ("y", y))
        ]
        track = Track(*ends, np.ones(1))
        image += light * exact_pixels(GaussianStar(SIGMA_PX), track, x, y, columns, rows)
    return image


@pytest.mark.parametrize("asked", [0.005, 0.05, 0.3])
@pytest.mark.parametrize("moving", [False, True], ids=["at rest", "streaks"])
def test_what_is_drawn_keeps_it(small, tmp_path, asked, moving):
    """Every pixel against quadrature; the product's own account holds too."""
    more = {} if moving else {"pointing": SIDEREAL}
    kept = {"output": {"layers": ["dn", "stars_e", "mean_e"]}}
    wish = small(more | kept | {"accuracy": {"noise_fraction": asked}})
    report = render(wish, tmp_path / "run", Options("synchronous"))
    drawn = layers(tmp_path / "run")
    noise = np.sqrt(drawn["mean_e"][0].astype(float) + wish.sensor.read_noise_e**2)
    off = np.abs(drawn["stars_e"][0] - exact_stars(tmp_path / "run", noise.shape)) / noise
    rounding = float((2.0**-24 * drawn["stars_e"][0] / noise).max())
    errors = report["errors"]
    stated = errors["bound_of_all_approximations_sigma"]
    assert off.max() <= stated + rounding
    assert stated <= asked * (1 + 1e-9)
    assert errors["asked_sigma"] == asked
    assert errors["windows"] > 0
    assert 0.0 < errors["achieved_error_sigma"] <= stated
    assert errors["as_stated"]
    assert json.loads((tmp_path / "run" / "report.json").read_text())["errors"] == errors


ONE_COLOUR = {"kind": "airy", "wavelength_nm": 650.0, "jitter_px": 0.4}


def test_each_sources_flux_is_kept(small):
    """Wings end where less than the fraction asked for is left of a source's light."""
    reaches = []
    for fraction in (1e-3, 3e-4):
        wish = {"sensor.psf": ONE_COLOUR, "accuracy": {"flux_fraction": fraction}, "stars": None}
        responses = prepare(small(wish)).plan.responses
        assert 0.0 < responses.lost_light <= fraction
        reaches.append(responses.reach_px)
    assert reaches[0] < 0.9 * reaches[1]


def test_the_cheapest_way_that_keeps_it_is_taken(small):
    """The less is asked for, the more sources do with small cores, and the less work is a frame."""
    limits_e, costs = [], []
    for asked in (0.002, 0.05, 1.0):
        wish = small({"sensor.psf": ONE_COLOUR, "accuracy": {"noise_fraction": asked}})
        prepared = replace(prepare(wish), spent=NOTHING_SPENT)  # whatever planning took here
        limits_e.append(prepared.plan.responses.classes[0].brightest_e)
        costs.append(summary_of(prepared)["predicted"]["cpu_s"])
    assert 0.0 < 10.0 * limits_e[0] < limits_e[1] < 0.1 * limits_e[2]
    assert costs[0] > costs[1] > costs[2]


# Straight lines between the points of a bent response err by more than so little.
TOO_MUCH = {
    "accuracy": {"noise_fraction": 1e-7}, "sensor.full_well_e": 1e6, "stars": None,
    "sensor.detector": {"nonlinearity": {"kind": "polynomial", "coefficients": [-0.3]}},
}  # fmt: skip


def test_what_cannot_be_kept_stops_the_render(small, tmp_path):
    with pytest.raises(BadInput, match=r"accuracy.noise_fraction: 1e-07 .*--accept error") as told:
        render(small(TOO_MUCH), tmp_path / "run")
    assert "nonlinearity" in str(told.value)
    assert not (tmp_path / "run").exists()


def test_or_is_accepted_by_name_and_stands_first(small, tmp_path):
    """In the plan, the page, the report and the cube."""
    (tmp_path / "scene.yaml").write_text(scene_yaml(small(TOO_MUCH)))
    page = nightglass("plan", tmp_path / "scene.yaml", "--accept-error")
    assert page.returncode == 0
    assert page.stdout.startswith("WARNING: pixels may err by")
    wish = small(TOO_MUCH | {"accept": ["error"]})
    assert plan_scene(wish)["warnings"][0].startswith("pixels may err by")
    report = render(wish, tmp_path / "run", Options("synchronous"))
    assert report["warnings"][0].startswith("pixels may err by")
    assert open_cube(tmp_path / "run").attrs["warnings"] == report["warnings"]


def test_more_error_than_stated_is_told(small, tmp_path, monkeypatch):
    """Where the reference finds a tenth less light than was drawn, the product says so first."""
    exact = check.reference

    def dimmer(*args, **more):
        image, sources = exact(*args, **more)
        return 0.9 * image, sources

    monkeypatch.setattr(check, "reference", dimmer)
    report = render(small(), tmp_path / "run", Options("synchronous"))
    assert not report["errors"]["as_stated"]
    assert report["errors"]["achieved_error_sigma"] > 0.05
    assert "pixels were found to err by" in report["warnings"][0]


@pytest.mark.parametrize("accept", [(), ("error",)])
def test_stars_brighter_than_the_plan_knew_are_told_also_where_errors_are_accepted(
    small, tmp_path, monkeypatch, accept
):
    """As if the bounds for the sources drawn were a thousand times those of the plan."""
    real = finish.for_sources

    def brighter(*given):
        return [
            replace(d, error_bound_sigma=d.error_bound_sigma and 1e3 * d.error_bound_sigma)
            for d in real(*given)
        ]

    monkeypatch.setattr(finish, "for_sources", brighter)
    report = render(small({"accept": list(accept)}), tmp_path / "run", Options("synchronous"))
    assert report["errors"]["as_stated"] is bool(accept)
    assert "the brightest source or the densest crowd drawn" in report["warnings"][0]
    assert open_cube(tmp_path / "run").attrs["warnings"] == report["warnings"]


# Where a bound is of a pixel's charge and is more than ten times what was found, and how much.
WIDE = {"phase_interpolation": 40.0, "crowds_by_transforms": 20.0, "wings_cut_off": 35.0}


def test_bounds_are_tight():
    """Of approximations of a pixel's charge, as docs/measured.json has them of small scenes."""
    rows = json.loads((ROOT / "docs" / "measured.json").read_text())["rules"]
    found = {
        one["component"]: one["bound"] / one["error"]
        for row in rows for one in row["all"]
        if one["unit"] in ("e-", "sigma") and one["error"] > 0.0
    }  # fmt: skip
    assert len(found) >= 8
    for name, ratio in found.items():
        assert 1.0 <= ratio <= WIDE.get(name, 10.0), (name, ratio)
