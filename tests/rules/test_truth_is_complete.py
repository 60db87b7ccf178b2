"""Truth is complete: every source drawn is in the truth tables, as it was drawn.

With the position, path, flux and signal-to-noise that were used. The noise-free layers that a scene
asks for sum to the mean of the noisy frame.
"""

# Deeper, elsewhere: tests/export/test_agreement.py (labels, light and WCS), tests/acceptance
# (test_real_sky.py: stars found again by another program; test_cosmic_rays.py, test_wide_field.py,
# test_distortion.py, test_site_with_air.py, test_behind_the_earth.py), tests/execute
# (test_truth_magnitudes.py, test_detector_truth.py, test_detector.py, test_rolling_shutter.py),
# tests/physics/noise/test_chain.py (mean and variance of the noise).

from __future__ import annotations

import copy

import numpy as np
import pytest

from pipeline.route.run import Options, render
from pipeline.studies.accuracy.reference import GaussianStar, Track, exact_pixels
from tests.rules.conftest import SCENE, SIDEREAL, layers, truth

SIGMA_PX, FRAMES = 1.1, 6
BESIDE_IT = SIDEREAL | {"boresight_ra_deg": 0.7205, "boresight_dec_deg": -0.8039}  # in frame 2
SUMMED = ("stars_e", "targets_e", "background_e", "dark_e")


@pytest.fixture(scope="module", params=["followed", "sidereal"])
def product(request, scene, tmp_path_factory):
    """Stars, two targets in view and one that is not, sky, dark, rays: (scene, product)."""
    second = copy.deepcopy(SCENE["targets"][0]) | {"name": "behind"}
    line1, line2 = second["orbit"]["line1"], second["orbit"]["line2"]
    second["orbit"] |= {"line1": line1, "line2": line2.replace("318.0950", "138.0950")}
    second["orbit"]["line2"] = checksum(second["orbit"]["line2"])
    beside = copy.deepcopy(SCENE["targets"][0]) | {"name": "beside"}
    beside["orbit"]["line2"] = checksum(line2.replace("318.0950", "318.1150"))
    wish = scene({
        "sensor.shape": [256, 256], "sensor.dark_e_per_s": 4.0,
        "targets": [*SCENE["targets"], beside, second],
        "exposure": {"integration_s": 2.0, "frames": FRAMES, "cadence_s": 3.0},
        "pointing": SCENE["pointing"] if request.param == "followed" else BESIDE_IT,
        "output": {"layers": ["dn", "mean_e", "cosmic_rays_e", *SUMMED]},
    })  # fmt: skip
    path = tmp_path_factory.mktemp("truth") / "run"
    render(wish, path, Options("synchronous"))
    return wish, path


def checksum(line: str) -> str:
    digits = sum(int(c) if c.isdigit() else c == "-" for c in line[:68])
    return line[:68] + str(digits % 10)


def drawn_from(table: dict[str, np.ndarray], frame: int, side: int = 256) -> np.ndarray:
    """Light of a frame's rows of a truth table by quadrature: each swept along its path, with its
    middle where the table has that of the light."""
    image, at = np.zeros((side, side)), np.arange(float(side))
    for i in np.flatnonzero((table["frame"] == frame) & (table["electrons"] > 0.0)):
        x, y = table["x_light_px"][i], table["y_light_px"][i]
        swept = [table[f"{a}_end_px"][i] - table[f"{a}_start_px"][i] for a in "xy"]
        ends = [0.5 * length * np.array([[-1.0, 1.0]]) for length in swept]
        if np.hypot(x - 0.5 * side, y - 0.5 * side) < 2.0 * side:
            response = exact_pixels(GaussianStar(SIGMA_PX), Track(*ends, np.ones(1)), x, y, at, at)
            image += table["electrons"][i] * response
    return image


@pytest.mark.parametrize("kind", ["stars", "targets"])
def test_the_truth_alone_draws_the_layers(product, kind):
    """Every row drawn anew, nothing else: no source lacks, and each is where and as bright as it
    is said to be, to a twentieth of the noise and a thousandth of the light."""
    wish, path = product
    found, table = layers(path), truth(path, kind)
    for frame in (0, 2):
        anew, layer = drawn_from(table, frame), found[f"{kind}_e"][frame].astype(float)
        noise = np.sqrt(found["mean_e"][frame] + wish.sensor.read_noise_e**2)
        assert (np.abs(layer - anew) / noise).max() < wish.accuracy.noise_fraction
        assert layer.sum() == pytest.approx(anew.sum(), rel=wish.accuracy.flux_fraction)
    assert found[f"{kind}_e"][2].max() > 100.0


def test_every_target_has_a_row_in_every_frame(product):
    """Also one out of view; those in view are in the frame where the table says so."""
    wish, path = product
    table = truth(path, "targets")
    names = [t.name for t in wish.targets]
    assert len(names) == 3
    assert table["name"].tolist() == FRAMES * names
    assert table["frame"].tolist() == [f for f in range(FRAMES) for _ in names]
    assert not table["in_frame"][table["name"] == "behind"].any()
    assert table["in_frame"][table["name"] == "geo"].any()
    assert np.isfinite(table["electrons"]).all()


def test_snr_is_that_of_the_light_drawn(product):
    """Of isolated sources: sum of s^2 / (floor + s) over the pixels of each one's own light."""
    wish, path = product
    found = layers(path)
    floor = wish.sensor.read_noise_e**2 + wish.sensor.gain_e_per_dn**2 / 12.0
    for kind in ("stars", "targets"):
        table, seen = truth(path, kind), 0
        floor_e2 = floor + float((found["background_e"] + found["dark_e"])[0].mean())
        inside = table["in_frame"] & (table["frame"] == 2) & (np.abs(table["x_px"] - 127.5) < 80.0)
        inside &= np.abs(table["y_px"] - 127.5) < 80.0
        for i in np.flatnonzero(inside):
            one = {name: column[i : i + 1] for name, column in table.items()}
            signal = drawn_from(one, 2)
            snr = np.sqrt(np.sum(signal**2 / (floor_e2 + signal)))
            assert table["snr"][i] == pytest.approx(snr, rel=0.02)
            seen += 1
        assert seen


def test_cosmic_rays_of_the_truth_are_those_drawn(product):
    _, path = product
    table, layer = truth(path, "cosmic_rays"), layers(path)["cosmic_rays_e"]
    assert len(table["frame"]) > 0
    for frame in range(FRAMES):
        said = table["electrons"][table["frame"] == frame].sum()
        assert layer[frame].astype(float).sum() == pytest.approx(said, rel=1e-5)


def test_layers_sum_to_the_mean(product):
    """To the rounding of each stored layer, in every pixel of every frame."""
    _, path = product
    found = layers(path)
    parts = [found[name].astype(float) for name in SUMMED]
    for name, part in zip(SUMMED, parts, strict=True):
        assert part.max() > 1.0, name
    mean = found["mean_e"].astype(float)
    rounding = 2.0**-24 * (np.abs(mean) + sum(np.abs(part) for part in parts))
    assert np.all(np.abs(sum(parts) - mean) <= 1.01 * rounding)


def test_the_mean_is_that_of_the_noisy_frame(product):
    """What is left of the frames, over its own noise, is noise: of mean 0 and variance 1, also
    where there is much light and where there is little."""
    wish, path = product
    found, s = layers(path), wish.sensor
    mean = found["mean_e"].astype(float)
    charge = (found["dn"] - float(s.bias_dn)) * s.gain_e_per_dn - found["cosmic_rays_e"]
    left = (charge - mean) / np.sqrt(mean + s.read_noise_e**2 + s.gain_e_per_dn**2 / 12.0)
    bright = mean > np.quantile(mean, 0.9)
    for part in (bright, ~bright):
        n = int(part.sum())
        assert abs(left[part].mean()) < 5.0 / np.sqrt(n)
        assert left[part].var() == pytest.approx(1.0, abs=5.0 * np.sqrt(2.5 / n))
