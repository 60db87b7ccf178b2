"""A small scene with every kind of light and noise, for the tests of the product's rules."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene
from pipeline.store.cube import open_cube

Make = Callable[..., Scene]
FIELD_DEG, HALF_DEG, STARS = (0.70, -0.45), 0.5, 1500
GEO_TLE = (
    "1 00001U 19001A   19099.72314174  .00000000  00000-0  00000-0 0  9999",
    "2 00001   0.0300 100.0000 0002500 265.0000 318.0950  1.00272800    14",
)
# A made-up geostationary satellite before the field, followed, so that the stars are streaks.
SCENE: dict[str, Any] = {
    "schema": "nightglass/scene/1", "name": "rules", "epoch": "2019-10-20T05:42:30Z", "seed": 11,
    "observer": {"kind": "ground", "latitude_deg": 1.0, "longitude_deg": -113.16, "height_m": 10},
    "sensor": {
        "shape": [512, 768], "pixel_pitch_um": 9.0, "focal_length_m": 2.0, "aperture_m": 0.8,
        "obscuration": 0.3, "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "transmission": 0.8, "quantum_efficiency": 0.9,
        "psf": {"kind": "gaussian", "sigma_px": 1.1}, "gain_e_per_dn": 1.5,
        "adc_bits": 24, "bias_dn": 500, "dark_e_per_s": 0.1, "read_noise_e": 5.0,
    },
    "pointing": {"mode": "target", "target": "geo"},
    "exposure": {"integration_s": 2.0, "frames": 2, "cadence_s": 4.0},
    "targets": [{
        "name": "geo", "orbit": {"kind": "tle", "line1": GEO_TLE[0], "line2": GEO_TLE[1]},
        "body": {"kind": "sphere", "diameter_m": 5.0, "albedo": 0.2},
    }],
    "background": {"uniform_mag_arcsec2": 21.5},
    "cosmic_rays": {"kind": "generated", "rate_per_cm2_s": 5.0},
}  # fmt: skip
SIDEREAL = {"mode": "sidereal", "boresight_ra_deg": FIELD_DEG[0],
            "boresight_dec_deg": FIELD_DEG[1], "roll_deg": 20.0}  # fmt: skip


@pytest.fixture(scope="session")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """1,500 stars of G 9 to 17 over a square degree about the field, in small shards."""
    folder, rng = tmp_path_factory.mktemp("rules"), np.random.default_rng(1)
    ra, dec = (at + rng.uniform(-HALF_DEG, HALF_DEG, STARS) for at in FIELD_DEG)
    g, half = np.linspace(9.0, 17.0, STARS), rng.normal(0.6, 0.15, STARS)
    names = "source_id,ra,dec,phot_g_mean_mag,phot_bp_mean_mag,phot_rp_mean_mag"
    rows = np.column_stack([np.arange(STARS) + 1, ra, dec, g, g + half, g - half])
    csv = folder / "stars.csv"
    np.savetxt(csv, rows, ["%d", *5 * ["%.9f"]], ",", header=names, comments="")
    ingest([csv], folder / "catalogue", form="gaia_dr2", workers=1, rows_per_leaf=300)
    return folder / "catalogue"


@pytest.fixture(scope="session")
def scene(catalogue: Path) -> Make:
    """Makes the scene with dotted keys set: scene({"sensor.adc_bits": 12}); None removes one."""

    def make(changes: dict[str, Any] | None = None) -> Scene:
        data: Any = copy.deepcopy(SCENE) | {"stars": {"catalogue": str(catalogue)}}
        for key, value in (changes or {}).items():
            *parents, last = key.split(".")
            holder = data
            for part in parents:
                holder = holder.setdefault(part, {})
            if value is None:
                holder.pop(last, None)
            else:
                holder[last] = value
        return parse_scene(data)

    return make


def layers(product: Path) -> dict[str, np.ndarray]:
    """The layers (frame, y, x) of a product, by name."""
    cube = open_cube(product)
    return {n: cube[n].values for n in cube.data_vars if cube[n].dims == ("frame", "y", "x")}


def truth(product: Path, kind: str) -> dict[str, np.ndarray]:
    """A truth table of a product, by column."""
    table = pq.read_table(product / "truth" / f"{kind}.parquet")
    return {name: np.array(table[name].to_pylist()) for name in table.column_names}
