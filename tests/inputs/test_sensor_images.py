"""Images of the sensor's terms: the dark image in any unit, by its scale."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.run import render
from pipeline.spec.load import InvalidScene, parse_scene
from pipeline.store.cube import open_cube

SCENE = {
    "schema": "nightglass/scene/1", "name": "dark", "epoch": "2015-07-02T12:00:00Z",
    "observer": {"kind": "fixed", "position_au": [0.9, 0.4, 0.1]},
    "sensor": {
        "shape": [32, 48], "pixel_pitch_um": 10.0, "focal_length_m": 0.4, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 101.0, "boresight_dec_deg": 30.0},
    "exposure": {"integration_s": 20.0}, "output": {"layers": ["dn", "dark_e"]},
}  # fmt: skip


def scene(**sensor):
    return parse_scene(SCENE | {"sensor": SCENE["sensor"] | sensor})


def test_a_dark_image_in_other_units(tmp_path):
    """A master dark of 300 s in DN at 1.5 e-/DN: scale 1.5 / 300 e-/s each."""
    dark_dn = np.random.default_rng(2).uniform(0, 900, (32, 48))
    np.save(tmp_path / "dark.npy", dark_dn)
    wish = {"dark_e_per_s": str(tmp_path / "dark.npy"), "dark_scale": 1.5 / 300.0}
    render(scene(**wish), tmp_path / "run")
    drawn = open_cube(tmp_path / "run")["dark_e"].values[0]
    assert np.allclose(drawn, dark_dn * 0.005 * 20.0, rtol=1e-6)


@pytest.mark.parametrize(
    "wish", [{"dark_scale": 2.0}, {"dark_scale": 0.0, "dark_e_per_s": "d.npy"}]
)
def test_limits_a_scale_is_of_an_image(wish):
    with pytest.raises(InvalidScene, match=r"sensor\.dark_scale"):
        scene(**wish)
