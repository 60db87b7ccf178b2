"""A scene with every section, as plain data."""

from __future__ import annotations

from typing import Any

import pytest


@pytest.fixture
def full() -> dict[str, Any]:
    """Plain data of a valid scene that uses every section and kind of number."""
    return {
        "schema": "nightglass/scene/1",
        "name": "everything",
        "epoch": "2019-04-20T03:00:00Z",
        "seed": 7,
        "accuracy": {"noise_fraction": 0.05, "flux_fraction": 1e-3},
        "observer": {
            "kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055.0,
        },
        "sensor": {
            "shape": [512, 768], "pixel_pitch_um": 13.5, "focal_length_m": 1.0,
            "aperture_m": 0.4, "obscuration": 0.3, "fill_factor": 0.9,
            "bandpass": {"kind": "box", "short_nm": 400.0, "long_nm": 900.0},
            "transmission": 0.8, "quantum_efficiency": 0.9,
            "psf": {
                "kind": "gaussian", "sigma_px": 0.8, "jitter_px": 0.1,
                "charge_diffusion_px": 0.2,
            },
            "full_well_e": 9e4, "gain_e_per_dn": 1.5, "adc_bits": 16, "bias_dn": 500.0,
            "flat": 1.0, "dark_e_per_s": 0.1, "read_noise_e": 5.0,
        },
        "pointing": {
            "mode": "rate", "boresight_ra_deg": 10.0, "boresight_dec_deg": 20.0,
            "rate_ra_arcsec_s": 15.0, "rate_dec_arcsec_s": 0.1, "roll_deg": 3.0,
        },
        "exposure": {"integration_s": 2.0, "frames": 4, "cadence_s": 5.0},
        "stars": {"catalogue": "gaia_dr2/", "faintest_g_mag": 21.0},
        "targets": [
            {
                "name": "sat-1",
                "orbit": {
                    "kind": "state", "position_m": [42164e3, 0.0, 0.0],
                    "velocity_m_s": [0.0, 3074.7, 0.0],
                },
                "body": {"kind": "sphere", "diameter_m": 3.0, "albedo": 0.2},
            }
        ],
        "background": {"uniform_mag_arcsec2": 21.5},
        "output": {"layers": ["dn", "mean_e"], "tile_shape": [256, 768]},
    }  # fmt: skip
