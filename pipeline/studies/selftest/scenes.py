"""Small scenes for the self-test: one body before a still camera, or a few stars; their frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import zarr

from catalog_tools.documents import JsonObject
from pipeline.route.run import Options, render
from pipeline.spec.dotted import changed
from pipeline.spec.load import parse_scene

Array = np.ndarray

# The observer stands 7000 km from the Earth's centre, the body 100 km beyond it; the Sun in March
# stands near +x, so that the side towards the observer is lit.
OBSERVER_M = (-7.0e6, 0.0, 0.0)
BODY_M = (-7.1e6, 0.0, 0.0)
BODY: JsonObject = {
    "name": "body",
    "orbit": {"kind": "state", "position_m": BODY_M, "velocity_m_s": [0.0, 0.0, 0.0]},
    "body": {"kind": "sphere", "diameter_m": 0.1, "albedo": 0.5},
    "eclipse": False,
}
SCENE: JsonObject = {
    "schema": "nightglass/scene/1",
    "accept": ["sun", "moon", "daylight"],  # limiting cases look where no telescope would
    "name": "selftest",
    "epoch": "2019-03-20T12:00:00Z",
    "observer": {
        "kind": "orbit",
        "orbit": {"kind": "state", "position_m": OBSERVER_M, "velocity_m_s": [0.0, 0.0, 0.0]},
    },
    "sensor": {
        "shape": [64, 64],
        "pixel_pitch_um": 10.0,
        "focal_length_m": 0.01,
        "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 500, "long_nm": 600},
        "psf": {"kind": "gaussian", "sigma_px": 0.8},
        "photon_noise": False,
        "adc_bits": 32,
        "read_noise_e": 1.0,
    },
    "pointing": {"mode": "target", "target": "body"},
    "exposure": {"integration_s": 0.01},
    "targets": [BODY],
    "output": {"layers": ["dn", "mean_e"]},
}


@dataclass(frozen=True)
class Frames:
    """What came out: each layer (frames, rows, columns), and the truth as columns."""

    layers: dict[str, Array]
    truth: dict[str, Array]
    report: JsonObject


def scene(changes: JsonObject) -> JsonObject:
    """The small scene with dotted changes, such as {"sensor.shape": [8, 8]}; None removes a key."""
    data: JsonObject = changed(SCENE, changes)
    return data


def sky_only(changes: JsonObject) -> JsonObject:
    """A scene without stars and targets: a uniform sky."""
    still = {"mode": "sidereal", "boresight_ra_deg": 180.0, "boresight_dec_deg": 0.0}
    observer = {"kind": "fixed", "position_au": [1.0, 0.0, 0.0]}
    return scene({"targets": None, "pointing": still, "observer": observer, **changes})


def frames(data: JsonObject, folder: Path, kind: str = "targets") -> Frames:
    """Render a scene; `kind` names the truth table to read."""
    product = folder / "product"
    report = render(parse_scene(data), product, Options("synchronous", replace=True))
    group = zarr.open_group(product / "cube.zarr", mode="r")
    layers = {name: np.asarray(group[name]) for name in data["output"]["layers"]}
    truth = {}
    table = product / "truth" / f"{kind}.parquet"
    if table.is_file():
        read = pq.read_table(table)
        truth = {name: read[name].to_numpy() for name in read.column_names}
    return Frames(layers, truth, report)
