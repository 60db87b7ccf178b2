"""A small field of stars with a target, as plain data, and sweeps over it as files."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from catalog_tools.ingest.ingest import ingest

IFOV_DEG, RA_DEG, DEC_DEG, SIDE = 2.0 / 3600.0, 160.0, 20.0, 256


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory) -> str:
    """300 stars over and around the frame, G 10 to 16."""
    folder = tmp_path_factory.mktemp("sweep-stars")
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-0.7, 0.7, (2, 300)) * SIDE * IFOV_DEG
    g = rng.uniform(10.0, 16.0, 300)
    ra = RA_DEG + x / np.cos(np.radians(DEC_DEG + y))
    rows = ["source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
            "phot_bp_mean_mag,phot_rp_mean_mag"]  # fmt: skip
    rows += [
        f"{i + 1},2015.5,{ra[i]:.12f},{DEC_DEG + y[i]:.12f},1,0,0,,{g[i]:.6f},"
        f"{g[i] + 0.4:.6f},{g[i] - 0.6:.6f}"
        for i in range(300)
    ]
    (folder / "stars.csv").write_text("\n".join(rows) + "\n")
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


@pytest.fixture(scope="session")
def scene_data(catalogue) -> dict[str, Any]:
    """Stars with wings, a lit sphere ahead of the observer, a uniform sky, every noise term."""
    direction = np.array([
        np.cos(np.radians(DEC_DEG)) * np.cos(np.radians(RA_DEG)),
        np.cos(np.radians(DEC_DEG)) * np.sin(np.radians(RA_DEG)), np.sin(np.radians(DEC_DEG)),
    ])  # fmt: skip
    place = direction * 7.0e6
    speed = np.cross([0.0, 0.0, 1.0], direction)
    velocity = 7500.0 * speed / np.linalg.norm(speed)
    ahead = place + 30_000.0 * direction
    return {
        "schema": "nightglass/scene/1",
        "name": "field",
        "epoch": "2019-12-01T08:00:00Z",
        "seed": 3,
        "observer": {"kind": "orbit", "orbit": {
            "kind": "state", "position_m": list(place), "velocity_m_s": list(velocity)}},
        "sensor": {
            "shape": [SIDE, SIDE], "pixel_pitch_um": 9.0,
            "focal_length_m": 9e-6 / np.radians(IFOV_DEG), "aperture_m": 0.1,
            "bandpass": {"kind": "box", "short_nm": 450, "long_nm": 850},
            "psf": {"kind": "airy"}, "full_well_e": 60000, "gain_e_per_dn": 2.0, "bias_dn": 300,
            "adc_bits": 14, "dark_e_per_s": 2.0, "read_noise_e": 5.0,
        },
        "pointing": {
            "mode": "sidereal", "boresight_ra_deg": RA_DEG, "boresight_dec_deg": DEC_DEG},
        "exposure": {"integration_s": 0.5, "frames": 2, "cadence_s": 1.0},
        "stars": {"catalogue": catalogue},
        "targets": [{
            "name": "ball",
            "orbit": {"kind": "state", "position_m": list(ahead), "velocity_m_s": list(velocity)},
            "body": {"kind": "sphere", "diameter_m": 0.004, "albedo": 0.2}}],
        "background": {"uniform_mag_arcsec2": 21.0},
        "output": {"tile_shape": [256, 256]},
    }  # fmt: skip


@pytest.fixture
def sweep_file(tmp_path, scene_data):
    """Writes a sweep over the scene: sweep_file(axes, scene changes, **rest of the sweep)."""

    def write(axes: list[dict[str, Any]], changes: dict[str, Any] | None = None, **rest) -> Path:
        data = copy.deepcopy(scene_data)
        for key, value in (changes or {}).items():
            *parents, last = key.split(".")
            holder = data
            for part in parents:
                holder = holder[part]
            if value is None:
                holder.pop(last, None)
            else:
                holder[last] = value
        sweep = {"schema": "nightglass/sweep/1", "name": "test", "scene": data, "axes": axes}
        path = tmp_path / f"sweep-{len(list(tmp_path.glob('sweep-*.json')))}.json"
        path.write_text(json.dumps(sweep | rest))
        return path

    return write
