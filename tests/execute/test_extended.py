"""Large bodies in a scene: the lit disc is drawn, its light conserved, small ones stay points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.physics.radiometry import collecting_area_m2
from pipeline.plan.needs import _profiles_s
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.response.responses import point_curvature
from pipeline.plan.stars.brightest import MARGIN, points_beyond
from pipeline.route.prepare import prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube
from tests.slow import slow

SIDE = 400


def scene(diameter_m, psf, sun_side=1.0, roll_deg=0.0):
    """A sphere 1,000 km off, 10 m a pixel, beside an observer in high orbit; the Sun across."""
    observer = [42_164e3, 0.0, 0.0]
    return parse_scene({
        "schema": "nightglass/scene/1", "name": "disc", "epoch": "2019-03-20T21:58:00Z",
        "observer": {"kind": "orbit", "orbit": {
            "kind": "state", "position_m": observer, "velocity_m_s": [0, 3074.7, 0]}},
        "sensor": {
            "shape": [SIDE, SIDE], "pixel_pitch_um": 10.0, "focal_length_m": 1.0,
            "aperture_m": 0.065, "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "psf": psf, "adc_bits": 30, "read_noise_e": 5.0,
        },
        "pointing": {"mode": "target", "target": "ball", "roll_deg": roll_deg},
        "exposure": {"integration_s": 0.01},
        "targets": [{
            "name": "ball", "body": {"kind": "sphere", "diameter_m": diameter_m, "albedo": 0.2},
            "orbit": {"kind": "state", "position_m": [42_164e3, 0.0, sun_side * 1e6],
                      "velocity_m_s": [0, 3074.7, 0]},
        }],
        "output": {"layers": ["targets_e"]},
    })  # fmt: skip


def drawn(tmp_path, *args):
    report = render(scene(*args), tmp_path / "run", Options("synchronous"))
    truth = pq.read_table(tmp_path / "run" / "truth" / "targets.parquet").to_pylist()[0]
    return open_cube(tmp_path / "run")["targets_e"].values[0].astype(float), truth, report


PSFS = [{"kind": "gaussian", "sigma_px": 0.8}, {"kind": "airy", "wavelengths": 1}]


@pytest.mark.parametrize(
    "psf",
    [pytest.param(PSFS[0], id="gaussian"),
     slow(PSFS[1], id="airy")],
)  # fmt: skip
def test_disc_of_many_pixels(psf, tmp_path):
    image, truth, report = drawn(tmp_path, 400.0, psf)
    assert truth["extended"]
    assert truth["radius_px"] == pytest.approx(20.0, rel=1e-3)
    assert image.sum() == pytest.approx(truth["electrons"], rel=2e-3)
    lit = image > 0.02 * image.max()
    rows, columns = np.nonzero(lit)
    away = np.hypot(rows - truth["y_px"], columns - truth["x_px"])
    assert 18.0 < away.max() < 23.0
    # The Sun stands across the line of sight (phase near 90 degrees): half of the disc is lit.
    assert 60.0 < truth["phase_deg"] < 120.0
    assert 0.2 < lit.sum() / (np.pi * 20.0**2) < 0.8
    light = image / image.sum()
    assert truth["x_light_px"] == pytest.approx(float(light.sum(0) @ np.arange(SIDE)), abs=0.05)
    assert truth["y_light_px"] == pytest.approx(float(light.sum(1) @ np.arange(SIDE)), abs=0.05)
    off = np.array([truth["x_light_px"] - truth["x_px"], truth["y_light_px"] - truth["y_px"]])
    assert np.abs(off).max() > 3.0
    assert np.ptp(off) > 1.0
    # 1e10 electrons: the light beyond the reach (flux_fraction) is what is left of the error
    assert report["errors"]["achieved_error_e"] < 2e-5 * image.max()
    if psf["kind"] == "gaussian":
        assert report["errors"]["achieved_error_sigma"] < 0.05


def test_small_and_faint_bodies_are_points(tmp_path):
    image, truth, _ = drawn(tmp_path, 0.02, PSFS[0])
    assert not truth["extended"]
    assert image.sum() == pytest.approx(truth["electrons"], rel=1e-5)


def test_light_of_a_small_body_is_on_the_side_of_a_large_ones(tmp_path):
    """A point, as far from its middle in its radii as the light of a disc in its image; askew."""
    image, large, _ = drawn(tmp_path / "large", 400.0, PSFS[0], 1.0, 40.0)
    _, small, _ = drawn(tmp_path / "small", 0.6, PSFS[0], 1.0, 40.0)
    assert (large["extended"], small["extended"]) == (True, False)
    light = np.array([image.sum(0), image.sum(1)]) @ np.arange(SIDE) / image.sum()
    off = (light - [large["x_px"], large["y_px"]]) * 0.6 / 400.0
    assert np.abs(off).min() > 5e-3
    assert small["x_light_px"] - small["x_px"] == pytest.approx(off[0], abs=2e-4)
    assert small["y_light_px"] - small["y_px"] == pytest.approx(off[1], abs=2e-4)


@pytest.mark.slow
def test_same_bits_for_every_tile(tmp_path):
    whole, *_ = drawn(tmp_path, 400.0, PSFS[1])
    made = scene(400.0, PSFS[1]).as_dict()
    made["output"]["tile_shape"] = [256, 256]
    render(parse_scene(made), tmp_path / "tiles", Options("threads", 2))
    assert np.array_equal(open_cube(tmp_path / "tiles")["targets_e"].values[0], whole)


def test_small_bodies_light_the_far_field_as_points(tmp_path, monkeypatch):
    """A disc that the wings' grid hardly resolves: its own picture there gives the same light."""
    args = 8.0, PSFS[1]
    points, truth, _ = drawn(tmp_path / "points", *args)
    assert truth["extended"]
    monkeypatch.setattr("pipeline.execute.blocks.MOST_POINTS", -1)
    picture, _, _ = drawn(tmp_path / "picture", *args)
    sigma = np.hypot(5.0, np.sqrt(np.maximum(picture, 0.0)))
    assert np.abs(points - picture).max() > 0.0
    assert (np.abs(points - picture) / sigma).max() < 0.02


@pytest.mark.parametrize(
    ("body", "is_point"),
    [({"kind": "sphere", "diameter_m": 400.0, "albedo": 0.2}, False),
     ({"kind": "light_curve", "times_s": [-1e3, 1e3], "magnitudes": [-10.0, -10.0]}, True),
     ({"kind": "light_curve", "times_s": [-1e3, 1e3], "magnitudes": [5.0, 5.0]}, False)],
)  # fmt: skip
def test_forecasts_count_the_profiles_of_bright_points_alone(body, is_point):
    """A disc is drawn by its own picture, however bright: no profile of it is made."""
    asked = scene(400.0, {"kind": "airy", "wavelengths": 1})
    data = asked.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["targets"][0]["body"] = body
    prepared = prepare(parse_scene(data))
    assert (prepared.spent.beyond_s > 0.0) == is_point
    assert (_profiles_s(prepared.plan, prepared.spent) > 0.0) == is_point


def test_a_disc_shows_by_its_radius():
    """40 m at 1,000 km and 10 m a pixel: 2 px. As a point its light is off by its curvature over
    that radius squared; brighter than all classes, it is a point where the budget is above that."""
    asked = scene(40.0, PSFS[0])
    plan, g = prepare(asked).plan, plan_geometry(asked, np.zeros(1, np.int64), 0.0)
    light = g.target_light.max() * plan.sun_rate_e_s_m2 * 0.01 * collecting_area_m2(0.065, 0.0)
    off_e = MARGIN * light * point_curvature(plan.responses.blur) * 2.0**2
    *others, last = plan.responses.classes
    classes = (*others, replace(last, target_e=0.0))
    for share, is_point in ((0.9, False), (1.1, True)):
        r = replace(plan.responses, classes=classes, budget_e=share * off_e)
        assert points_beyond(replace(plan, responses=r), g) == is_point
