"""Pixels that sky alone drives to an end of the converter: told before anything is drawn."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nightglass import open_product
from pipeline.arrays import SensorMaps
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.plan.sensor.detector import below_zero, cut_off
from pipeline.route.prepare import prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene

SCENE: dict[str, Any] = {
    "schema": "nightglass/scene/1", "name": "ends", "epoch": "2019-03-21T09:00:00Z",
    "accept": ["sun", "moon"],
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 10.0, "focal_length_m": 1.0, "aperture_m": 0.2,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 6.0, "bias_dn": 500,
        "gain_e_per_dn": 1.5, "full_well_e": 90000, "adc_bits": 12,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 90, "boresight_dec_deg": 20},
    "exposure": {"integration_s": 5.0},
    "background": {"uniform_e_per_s": 1500},
}  # fmt: skip


def warnings(sky_e_s: float = 1500.0, **sensor: Any) -> list[str]:
    scene = copy.deepcopy(SCENE)
    scene["sensor"] |= sensor
    scene["background"]["uniform_e_per_s"] = sky_e_s
    return [w for w in prepare(parse_scene(scene)).plan.warnings if "pixel" in w]


@pytest.mark.parametrize("name", ["gain_e_per_dn", "bias_dn"])
def test_a_full_converter_is_told_where_a_term_is_an_image(tmp_path: Path, name: str) -> None:
    value = SCENE["sensor"][name]
    np.save(tmp_path / "image.npy", np.full((64, 64), float(value)))
    told = warnings(**{name: str(tmp_path / "image.npy")})
    assert told == warnings()
    assert len(told) == 1
    assert "(5.39e+03 e- above the bias, its full well or the top of" in told[0]  # (4095 - 500) 1.5


def test_a_full_converter_is_told_of_amplifiers() -> None:
    part = {"rows": [0, 64], "columns": [0, 16], "gain_e_per_dn": 0.1}
    told = warnings(adc_bits=16, detector={"amplifiers": [part]})
    assert len(told) == 1
    assert "fill 25.0% of the pixels" in told[0]
    (whole,) = warnings(adc_bits=16, detector={"amplifiers": [part | {"columns": [0, 64]}]})
    assert "(6.5e+03 e- above the bias, its full well or the top of" in whole
    assert not warnings(adc_bits=16)


def test_pixels_are_full_by_the_time_of_a_frame_under_one_sky() -> None:
    """A quarter of the converter's range: 6.5e3 e- fill it in 5 s, but not in half a second."""
    scene = copy.deepcopy(SCENE)
    part = {"rows": [0, 64], "columns": [0, 16], "gain_e_per_dn": 0.1}
    scene["sensor"] |= {"adc_bits": 16, "detector": {"amplifiers": [part]}}
    for times_s in ([5.0, 0.5, 0.5], [0.5, 5.0, 0.5], [0.5, 0.5, 5.0]):
        dwell = {"integration_s": times_s, "frames": 3, "cadence_s": 10.0}
        told = prepare(parse_scene(scene | {"dwells": [dwell]})).plan.warnings
        (full,) = [w for w in told if "no source shows" in w]
        assert f"fill 25.0% of the pixels in frame {times_s.index(5.0)} " in full


def test_noise_below_zero_is_told_with_its_size() -> None:
    (told,) = warnings(0.5, bias_dn=0)
    assert "30.1% of the pixels without a source lie below 0 DN" in told
    assert "the mean is 1.41 e- too high" in told
    assert not warnings(0.5)
    assert not warnings(20.0, bias_dn=0)
    assert not warnings(0.0, bias_dn=0, read_noise_e=0.1)  # all within half a DN of 0
    assert not warnings(0.2, bias_dn=0, read_noise_e=0.0)  # photons alone are never below 0
    (all_of_them,) = warnings(100.0, bias_dn=-400)
    assert "100.0% of the pixels" in all_of_them
    assert "the mean is 100 e- too high" in all_of_them


def test_noise_below_zero_is_judged_by_the_shortest_exposure() -> None:
    """Sky lifts the long one above 0 DN."""
    scene = copy.deepcopy(SCENE) | {"background": {"uniform_e_per_s": 5.0}}
    scene["sensor"] |= {"bias_dn": 0}
    scene["dwells"] = [{"frames": 1, "integration_s": time_s} for time_s in (20.0, 0.5)]
    (told,) = (w for w in prepare(parse_scene(scene)).plan.warnings if "0 DN" in w)
    assert "of the pixels without a source lie below 0 DN in frame 1" in told


@pytest.mark.parametrize(
    ("mean_e", "read_e", "zero_e"),
    [(0, 6, 0), (2.5, 6, 0), (1, 0, 0), (3, 0.5, 2), (500, 6, 470), (2e4, 6, 2e4), (2.5, 6, -750)],
)
def test_what_is_cut_off_agrees_with_draws(mean_e: float, read_e: float, zero_e: float) -> None:
    rng = np.random.default_rng(4)
    drawn = rng.poisson(mean_e, 400_000) + rng.normal(0.0, read_e, 400_000)
    share, more_e = below_zero(parse_scene(SCENE).sensor, mean_e, read_e, zero_e)
    assert share == pytest.approx(np.mean(drawn < zero_e), abs=0.004)
    cut = np.maximum(drawn, zero_e) - drawn
    assert more_e == pytest.approx(cut.mean(), abs=6.0 * cut.std() / 400_000**0.5 + 1e-9)


BELOW = {"rows": [0, 64], "columns": [0, 16], "offset_dn": -510}
TWO = [
    BELOW | {"columns": [0, 30]},
    {"rows": [0, 64], "columns": [30, 64], "gain_e_per_dn": 3.0, "read_noise_e": 600.0},
]


@pytest.mark.parametrize(
    ("sensor", "more_than"),
    [
        ({"detector": {"amplifiers": [BELOW]}}, 0.24),
        ({"detector": {"amplifiers": TWO}}, 0.44),
        ({"detector": {"bias_structure": {"pixel_rms_dn": 500.0}}}, 0.12),
        ({"detector": {"bias_structure": {"column_slope_dn": 2000.0}, "row_noise_e": 90.0}}, 0.2),
        ({"bias_dn": "an image"}, 0.45),
    ],
)
def test_pixels_cut_off_are_judged_one_by_one(
    tmp_path: Path, sensor: dict[str, Any], more_than: float
) -> None:
    """A typical one is not cut off in any of these."""
    if "bias_dn" in sensor:
        bias = np.full((64, 64), 500.0)
        bias[:30] = -20.0
        np.save(tmp_path / "bias.npy", bias)
        sensor = {"bias_dn": str(tmp_path / "bias.npy")}
    (told,) = warnings(0.5, **sensor)
    assert "of the pixels without a source lie below 0 DN" in told
    scene = copy.deepcopy(SCENE) | {"background": {"uniform_e_per_s": 0.5}}
    scene["sensor"] |= sensor
    render(parse_scene(scene), tmp_path / "out", Options("synchronous"))
    share = float((open_product(tmp_path / "out").cube["dn"].values == 0).mean())
    assert share > more_than
    assert float(told.split("% of")[0].split()[-1]) / 100.0 == pytest.approx(share, abs=0.02)


def test_pixels_of_all_terms_are_cut_off_as_draws_are() -> None:
    rng = np.random.default_rng(8)
    scene = copy.deepcopy(SCENE)
    scene["sensor"] |= {"shape": [400, 500], "detector": {"column_noise_e": 3.0}}
    shape, s = (400, 500), parse_scene(scene)
    flat, dark = rng.uniform(0.5, 1.5, shape), rng.lognormal(0.0, 2.0, shape)
    read, gain = rng.uniform(0.5, 9.0, shape), rng.choice([0.5, 2.0, 20.0], shape)
    bias = rng.normal(2.0, 20.0, shape)
    part, more_e = cut_off(s, SensorMaps(flat, dark, read, gain, bias), 2.0, 5.0)
    drawn = rng.poisson((flat * 2.0 + dark) * 5.0) + rng.normal(0.0, np.hypot(read, 3.0))
    below = drawn < -(bias + 0.5) * gain
    assert part == pytest.approx(below.mean(), abs=0.004)
    assert more_e == pytest.approx(np.mean(below * (-bias * gain - drawn)), rel=0.02)


@pytest.mark.parametrize(
    ("charges_e", "reads_e"), [((1e6, 1.0), (0.0, 0.0)), ((1e4, 0.0), (0.0, 600.0))]
)
@pytest.mark.parametrize("above", [1.0, 2.0])
def test_pixels_as_near_to_zero_need_not_be_as_noisy(
    charges_e: tuple[float, float], reads_e: tuple[float, float], above: float
) -> None:
    """Half of the pixels each, as many of their own standard deviations above 0 DN."""
    rng, shape = np.random.default_rng(9), (64, 6400)
    scene = copy.deepcopy(SCENE)
    scene["sensor"] |= {"shape": list(shape)}
    half = np.arange(shape[1]) % 2
    dark, read = (np.broadcast_to(np.array(v)[half], shape) for v in (charges_e, reads_e))
    bias = above * np.sqrt(dark + read**2) - dark - 0.5
    part, more_e = cut_off(parse_scene(scene), SensorMaps(1.0, dark, read, 1.0, bias), 0.0, 1.0)
    drawn = rng.poisson(dark) + rng.normal(0.0, read)
    below = drawn < -(bias + 0.5)
    cut_e = np.where(below, -bias - drawn, 0.0)
    assert part == pytest.approx(float(below.mean()), abs=0.01)
    assert more_e == pytest.approx(float(cut_e.mean()), rel=0.05, abs=0.3)


def test_the_noise_floor_stands_beside_a_pixel_however_noisy() -> None:
    """More than half of the pixels at the coarsest gain: the others are as quiet as alone."""
    part = {"rows": [0, 64], "columns": [0, 40]}
    alone = prepare(parse_scene(SCENE)).plan.facts
    for loud in ({"gain_e_per_dn": 1e12}, {"read_noise_e": 1e9}):
        scene = copy.deepcopy(SCENE)
        scene["sensor"] |= {"detector": {"amplifiers": [part | loud]}}
        facts = prepare(parse_scene(scene)).plan.facts
        assert facts.sigma_floor_e == pytest.approx(alone.sigma_floor_e, rel=1e-12)


BALL = {
    "name": "ball",
    "orbit": {
        "kind": "state", "position_m": [4407338.1, -41933021.2, 0.0],
        "velocity_m_s": [3057.8229, 321.3901, 0.0],
    },
}  # fmt: skip
FROM_ORBIT = {
    "kind": "orbit",
    "orbit": {
        "kind": "state", "position_m": [7131858.8, -812572.7, 0.0],
        "velocity_m_s": [-117.404, -1030.438, 7379.381],
    },
}  # fmt: skip


def ball(full_well_e: float, diameter_m: float, followed: bool) -> Scene:
    """A sphere before a camera that follows it, or that looks where it is at mid-exposure."""
    scene = copy.deepcopy(SCENE) | {"epoch": "2019-05-12T09:00:00Z", "observer": FROM_ORBIT}
    scene["sensor"] |= {"adc_bits": 32, "full_well_e": full_well_e}
    scene["targets"] = [
        BALL | {"body": {"kind": "sphere", "albedo": 0.2, "diameter_m": diameter_m}}
    ]
    scene["pointing"] = {"mode": "target", "target": "ball"}
    scene["exposure"], scene["background"] = {"integration_s": 1.0}, {"uniform_e_per_s": 10.0}
    scene["output"] = {"layers": ["dn", "targets_e"]}
    if not followed:
        g = plan_geometry(parse_scene(scene), np.array([0]), 0.0)
        x, y, z = g.attitude[0, g.middle, 2]
        at = np.degrees([np.arctan2(y, x), np.arcsin(z)])
        scene["pointing"] = {
            "mode": "sidereal", "boresight_ra_deg": at[0], "boresight_dec_deg": at[1]
        }  # fmt: skip
    return parse_scene(scene)


@pytest.mark.parametrize(("diameter_m", "followed"), [(4.0, True), (800.0, True), (4.0, False)])
def test_a_target_that_fills_pixels_is_told_as_it_is_drawn(
    tmp_path: Path, diameter_m: float, followed: bool
) -> None:
    """A point, a disc, a streak: the factor told, and the brightest pixel where pixels hold all."""

    def told(full_well_e: float) -> list[str]:
        plan = prepare(ball(full_well_e, diameter_m, followed)).plan
        return [w for w in plan.warnings if "fills pixels" in w]

    assert told(1e12) == []
    product = tmp_path / "out"
    render(ball(1e12, diameter_m, followed), product, Options("synchronous"))
    peak_e = 10.0 + float(open_product(product).cube["targets_e"].values.max())
    (warning,) = told(peak_e / 7.0)
    times = float(warning.split("would hold ")[1].split(" times")[0])
    assert times == pytest.approx(7.0, rel=0.4)  # of one phase of the response, of an even disc
    assert told(peak_e * 1.7) == []


def test_full_pixels_are_told_beside_other_warnings() -> None:
    scene = ball(1e3, 4.0, True)
    sensor = scene.sensor.model_copy(update={"bias_dn": 0.0})
    dark = scene.background.model_copy(update={"uniform_e_per_s": 0.1})
    told = prepare(scene.model_copy(update={"sensor": sensor, "background": dark})).plan.warnings
    assert [w for w in told if "fills pixels" in w]
    assert [w for w in told if "below 0 DN" in w]


@pytest.mark.parametrize("bias_dn", [65535.0, 66000.0])
def test_limits_a_bias_that_leaves_no_room(bias_dn: float) -> None:
    scene = ball(1e5, 4.0, True)
    sensor = scene.sensor.model_copy(update={"adc_bits": 16, "bias_dn": bias_dn})
    told = prepare(scene.model_copy(update={"sensor": sensor})).plan.warnings
    assert [w for w in told if "(0 e- above the bias, its full well or the top of" in w]
    assert not [w for w in told if "fills pixels" in w]
