"""A site with air, a tracked sphere, others beside it, and a file of objects around the sky."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.physics.positions.orbit_two_body import two_body

ROOT = Path(__file__).parents[2]
HIGH = {"kind": "keplerian", "semi_major_axis_m": 4.2164e7, "eccentricity": 0.001,
        "inclination_deg": 2.0, "raan_deg": 40.0, "argument_of_perigee_deg": 0.0}  # fmt: skip
SITE = {
    "kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055,
    "atmosphere": {"extinction": True, "refraction": True},
}  # fmt: skip
SENSOR: dict[str, Any] = {
    "shape": [128, 128], "pixel_pitch_um": 20.0, "focal_length_m": 0.1, "aperture_m": 0.1,
    "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
    "psf": {"kind": "gaussian", "sigma_px": 0.9}, "read_noise_e": 5.0, "bias_dn": 300,
}  # fmt: skip
BALL = {"kind": "sphere", "diameter_m": 3.0, "albedo": 0.2}


def in_high_orbit(anomaly_deg: float) -> dict[str, Any]:
    return HIGH | {"true_anomaly_deg": anomaly_deg}


def night(**changes: Any) -> dict[str, Any]:
    """A scene of a night in Hawaii: a tracked sphere, a box and a sphere out of the field."""
    return {
        "schema": "nightglass/scene/1", "name": "night", "epoch": "2019-04-20T10:00:00Z",
        "seed": 3, "observer": SITE, "sensor": SENSOR,
        "pointing": {"mode": "target", "target": "ball"},
        "exposure": {"integration_s": 2.0, "frames": 3, "cadence_s": 20.0},
        "targets": [
            {"name": "ball", "object_name": "A BALL", "orbit": in_high_orbit(150.0), "body": BALL},
            {"name": "box", "orbit": in_high_orbit(150.3),
             "body": {"kind": "cube", "edge_m": 1.5, "albedo": 0.3,
                      "attitude": {"kind": "spin", "rate_deg_s": 3.0, "axis": [0, 0, 1]}}},
            {"name": "far", "orbit": in_high_orbit(170.0), "body": BALL},
        ],
        "background": {"airglow": True, "zodiacal": True},
    } | changes  # fmt: skip


@pytest.fixture
def population() -> dict[str, Any]:
    path = ROOT / "examples" / "population.tle"
    return {"name": "crowd", "path": str(path), "body": BALL}


def from_file_and_state(
    folder: Path, name: str, radius_m: float, times: np.ndarray
) -> tuple[dict[str, Any], dict[str, Any]]:
    """A circular orbit as a file of rows at some times, and as a state."""
    start = np.array([radius_m, 0, 0]), np.array([0, np.sqrt(3.986004418e14 / radius_m), 0])
    rows = np.column_stack([times, *two_body(*start, times)])
    lines = [",".join(repr(float(v)) for v in row) for row in rows]
    head = "time_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s"
    (folder / f"{name}.csv").write_text("\n".join([head, *lines]))
    of_file = {"kind": "ephemeris", "path": str(folder / f"{name}.csv"), "frame": "gcrs"}
    place, speed = (v.tolist() for v in start)
    return of_file, {"kind": "state", "position_m": place, "velocity_m_s": speed}
