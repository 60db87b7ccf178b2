"""A product drawn through seeing with an outer scale: its pixels, and what is refused."""

from __future__ import annotations

import json
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.interpolate import CubicSpline

from pipeline.errors import BadInput
from pipeline.physics.psf.von_karman import VonKarman
from pipeline.route.prepare import plan_scene
from pipeline.route.run import Options, render
from tests.execute.test_detector import BRIGHT, frames, scene

R0_M, OUTER_M, WAVE_M = 0.02, 2.0, 600e-9
SEEING = {"kind": "kolmogorov", "r0_m": R0_M, "reference_nm": 600.0, "wavelength_nm": 600.0,
          "diffraction": False, "outer_scale_m": OUTER_M}  # fmt: skip


def seen(more=None, **psf):
    sensor = {"sensor__shape": [64, 64], "sensor__psf": SEEING | psf} | (more or {})
    return scene(None, **sensor, **BRIGHT, background=None, output={"layers": ["dn", "targets_e"]})


def test_pixels_against_the_profile(tmp_path):
    """Each of 64 x 64 px of a source at rest: its profile, summed over 16 x 16 points a pixel."""
    render(seen(), tmp_path / "run", Options("synchronous"))
    light = frames(tmp_path / "run")["targets_e"][0].astype(float)
    truth = pq.read_table(tmp_path / "run" / "truth" / "targets.parquet").to_pylist()[0]
    seeing = VonKarman(WAVE_M / R0_M * 0.5 / 9e-6, outer_scale_r0=OUTER_M / R0_M)
    radii = np.concatenate([np.linspace(0.0, 8.0, 200), np.geomspace(8.1, 60.0, 200)])
    profile = CubicSpline(radii, seeing.intensity(radii))
    at = (np.arange(64 * 16) + 0.5) / 16 - 0.5
    fine = profile(np.hypot(at[:, None] - truth["y_light_px"], at - truth["x_light_px"]))
    wanted = truth["electrons"] * fine.reshape(64, 16, 64, 16).mean(axis=(1, 3))
    assert np.abs(light - wanted).max() < 1e-3 * wanted.max()
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["errors"]["achieved_error_sigma"] <= 0.5


@pytest.mark.parametrize(
    ("psf", "least"),
    [({}, 35.0 * R0_M), ({"diffraction": True}, 20.0 * R0_M),
     ({"wavelength_nm": 1200.0}, 35.0 * R0_M * 2.0**1.2)],
)  # fmt: skip
def test_an_outer_scale_near_r0_is_refused(psf, least):
    with pytest.raises(BadInput) as caught:
        plan_scene(seen(outer_scale_m=0.99 * least, **psf))
    assert caught.value.field == "sensor.psf.outer_scale_m"
    (told,) = re.findall(r"allowed: (\S+) or more", str(caught.value))
    assert least <= float(told) < 1.002 * least
    assert "\n" not in str(caught.value)
    plan_scene(seen(outer_scale_m=float(told), **psf))


def test_the_least_outer_scale_is_that_of_the_reddest_light():
    """What the message names is taken in the whole band."""
    band = {"sensor__bandpass": {"kind": "box", "short_nm": 400.0, "long_nm": 900.0}}
    with pytest.raises(BadInput) as caught:
        plan_scene(seen(band, wavelength_nm=None, outer_scale_m=0.3))
    (told,) = re.findall(r"allowed: (\S+) or more", str(caught.value))
    assert "900 nm" in str(caught.value)
    plan_scene(seen(band, wavelength_nm=None, outer_scale_m=float(told)))


def test_the_plan_tells_of_it():
    optics = plan_scene(seen())["response"]["optics"]
    assert optics["kind"] == "vonkarman"
    assert optics["outer_scale_r0"] == pytest.approx(OUTER_M / R0_M)
