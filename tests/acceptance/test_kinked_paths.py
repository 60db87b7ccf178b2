"""Tables of attitudes whose rows are kinks within an exposure."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from catalog_tools.ingest.ingest import ingest
from pipeline.route.prepare import prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene
from pipeline.store.cube import open_cube

ROWS = 5  # after the first, one every 2 s


def scene(catalogue: str, turn_deg: float, parts: int) -> Scene:
    """A camera that turns to and fro; exposed once, or as often as there are rows."""
    ahead = Rotation.from_euler("ZYX", [192.0, -5.0, 0.0], degrees=True).as_matrix()
    camera = ahead @ np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    turns = [Rotation.from_euler("y", k % 2 * turn_deg, degrees=True) for k in range(ROWS + 1)]
    rows = [[2.0 * k, *(Rotation.from_matrix(camera) * turn).as_quat().tolist()]
            for k, turn in enumerate(turns)]  # fmt: skip
    data: dict[str, Any] = {
        "schema": "nightglass/scene/1", "name": "kinks", "epoch": "2019-04-20T14:36:00Z",
        "observer": {"kind": "fixed", "position_au": [0.2, -0.9, 0.4]},
        "sensor": {
            "shape": [96, 128], "pixel_pitch_um": 9.7, "read_noise_e": 5.0, "bias_dn": 100,
            "focal_length_m": 0.1, "aperture_m": 0.03, "pupil_projection": False,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "psf": {"kind": "gaussian", "sigma_px": 0.8},
        },
        "pointing": {"mode": "table", "frame": "gcrs", "scalar": "last", "interpolation": "slerp",
                     "rotation": "camera_to_sky", "rows": rows},
        "exposure": {"integration_s": 2.0 * ROWS / parts, "frames": parts},
        "stars": {"catalogue": catalogue}, "output": {"layers": ["dn", "stars_e"]},
        "accept": ["moon", "sun", "coverage"],
    }  # fmt: skip
    return parse_scene(data)


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Forty stars around the field, of 3rd to 9th magnitude."""
    folder, dice = tmp_path_factory.mktemp("kinks"), np.random.default_rng(8)
    ra, dec = 192.0 + dice.uniform(-0.5, 0.5, 40), 5.0 + dice.uniform(-0.5, 0.5, 40)
    rows = "".join(
        f"{i + 1},2015.5,{a:.9f},{d:.9f},0,0,{m:.4f}\n"
        for i, (a, d, m) in enumerate(zip(ra, dec, dice.uniform(3.0, 9.0, 40), strict=True))
    )
    (folder / "stars.csv").write_text(
        "source_id,ref_epoch,ra,dec,pmra,pmdec,phot_g_mean_mag\n" + rows
    )
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def test_kinks_between_nodes_are_told_with_their_size(catalogue: str, tmp_path: Path) -> None:
    """Against one exposure from each row to the next, whose path is straight."""
    light = {}
    for parts in (1, ROWS):
        render(scene(catalogue, 0.3, parts), tmp_path / str(parts), Options("synchronous", 1))
        light[parts] = open_cube(tmp_path / str(parts)).stars_e.values.sum(axis=0, dtype=float)
    off = np.abs(light[1] - light[ROWS]) / np.sqrt(25.0 + light[ROWS])
    (told,) = (w for w in prepare(scene(catalogue, 0.3, 1)).plan.warnings if "paths bend" in w)
    sigma = float(re.search(r"there, ([\d.e+-]+) of its noise", told)[1])
    assert 0.05 < off.max() < sigma < 10.0 * off.max()
    for quiet in (scene(catalogue, 0.003, 1), scene(catalogue, 0.3, ROWS)):
        assert not [w for w in prepare(quiet).plan.warnings if "paths bend" in w]
