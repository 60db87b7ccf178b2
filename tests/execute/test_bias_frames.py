"""Bias frames (integration_s: 0): bias and read noise alone, whatever stands in the scene."""

from __future__ import annotations

import copy
import warnings

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.calibrate import calibrate
from pipeline.errors import BadInput
from pipeline.export.files import export_frames
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube

BIAS_DN, READ_NOISE_E, GAIN = 500.0, 6.0, 1.5
READOUTS = {
    "global": None,
    "frame transfer": {"kind": "frame_transfer", "transfer_s": 0.1, "towards": "high_rows"},
    "TDI": {"kind": "tdi", "rows_per_s": 10, "edges": "partial"},
    "rolling": {"kind": "rolling", "line_s": 1e-4},
}
SCENE = {
    "schema": "nightglass/scene/1", "name": "bias", "epoch": "2019-07-20T09:00:00Z", "seed": 7,
    "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055},
    "sensor": {
        "shape": [128, 160], "pixel_pitch_um": 9.0, "focal_length_m": 1.0, "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 0.9}, "full_well_e": 90000,
        "gain_e_per_dn": GAIN, "bias_dn": BIAS_DN, "dark_e_per_s": 0.5,
        "read_noise_e": READ_NOISE_E,
    },
    "pointing": {"mode": "target", "target": "geo-1"},
    "exposure": {"integration_s": 0, "frames": 2, "cadence_s": 4.0},
    "targets": [{
        "name": "geo-1",
        "orbit": {"kind": "state", "position_m": [4407338.1, -41933005.2, -36593.5],
                  "velocity_m_s": [3057.8229, 321.39, 0.2805]},
        "body": {"kind": "sphere", "diameter_m": 4.0, "albedo": 0.25},
    }],
    "background": {"zodiacal": True, "uniform_mag_arcsec2": 20.0},
    "cosmic_rays": {"kind": "generated", "rate_per_cm2_s": 10.0},
    "output": {"layers": ["dn", "mean_e"]},
}  # fmt: skip


def scene(readout="global", **changes):
    data = copy.deepcopy(SCENE) | changes
    data["sensor"]["detector"] = {"readout": READOUTS[readout]} if READOUTS[readout] else None
    return parse_scene(data)


def rendered(wish, path):
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        render(wish, path, Options("synchronous"))
    return open_cube(path)


def is_bias(dn):
    """Mean and spread of the bias and the read noise, within five standard errors."""
    sigma = np.hypot(READ_NOISE_E / GAIN, 12**-0.5)
    assert abs(dn.mean() - BIAS_DN) < 5 * sigma / np.sqrt(dn.size)
    assert abs(dn.std() - sigma) < 5 * sigma / np.sqrt(2 * dn.size)


@pytest.mark.parametrize("readout", READOUTS)
def test_bias_and_read_noise_alone(readout, tmp_path):
    cube = rendered(scene(readout), tmp_path / "run")
    assert cube.attrs["integration_s"] == 0.0
    assert not cube["mean_e"].values.any()
    for frame in cube["dn"].values.astype(float):
        is_bias(frame)
    assert (cube["time_start"] == cube["time_end"]).all()
    truth = pq.read_table(tmp_path / "run" / "truth" / "targets.parquet").to_pydict()
    assert truth["electrons"] == [0.0, 0.0]
    assert truth["snr"] == [0.0, 0.0]
    assert truth["in_frame"] == [True, True]
    assert np.allclose(truth["x_px"], 79.5, atol=1e-6)


@pytest.mark.parametrize("readout", READOUTS)
def test_same_light_beside_bias_frames(readout, tmp_path):
    """A dwell that mixes times: its exposed frames are those of a dwell without bias frames."""
    exposure = {"integration_s": 1.0, "frames": 2, "cadence_s": 4.0}
    alone = rendered(scene(readout, exposure=exposure), tmp_path / "alone")
    mixed = rendered(
        scene(readout, exposure=exposure, dwells=[{"integration_s": [1.0, 0.0]}]),
        tmp_path / "mixed",
    )
    assert list(mixed["integration_s"].values) == [1.0, 0.0]
    assert np.array_equal(mixed["dn"][0], alone["dn"][0])
    assert alone["mean_e"].values.min() > 0.0
    is_bias(mixed["dn"].values[1].astype(float))


def test_exports_and_calibrated_copy(tmp_path):
    rendered(scene(), tmp_path / "run")
    from astropy.io import fits

    (path,) = export_frames(tmp_path / "run", "fits", tmp_path / "bias.fits", 0)
    header = fits.getheader(path)
    assert header["EXPTIME"] == 0.0
    assert header["DATE-BEG"] == header["DATE-END"]
    calibrate(tmp_path / "run", tmp_path / "calibrated")
    light = open_cube(tmp_path / "calibrated")["calibrated_e"].values
    assert abs(light.mean()) < 5 * READ_NOISE_E / np.sqrt(light.size)


def test_limits_frames_need_a_cadence():
    with pytest.raises(BadInput, match=r"exposure\.cadence_s"):
        scene(exposure={"integration_s": 0, "frames": 2})
    assert scene(exposure={"integration_s": 0}).exposure.integration_s == 0.0
    with pytest.raises(BadInput, match="equal to 0"):
        scene(exposure={"integration_s": -1e-300})
