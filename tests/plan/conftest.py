"""Small scenes for the planner, as plain data."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import pytest

from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene

BASE: dict[str, Any] = {
    "schema": "nightglass/scene/1",
    "name": "plan",
    "epoch": "2019-04-20T03:00:00Z",
    "observer": {"kind": "fixed", "position_au": [1.2, 0.1, 0.05]},
    "sensor": {
        "shape": [512, 768], "pixel_pitch_um": 10.0, "focal_length_m": 1.0, "aperture_m": 0.4,
        "obscuration": 0.3, "bandpass": {"kind": "box", "short_nm": 400.0, "long_nm": 900.0},
        "psf": {"kind": "airy", "wavelength_nm": 650.0}, "read_noise_e": 5.0,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0},
    "exposure": {"integration_s": 2.0, "frames": 5, "cadence_s": 10.0},
    "stars": {"catalogue": "none"},
}  # fmt: skip


@pytest.fixture
def scene() -> Callable[..., Scene]:
    """Makes a Scene from BASE with dotted keys set: scene(**{"exposure.frames": 3})."""

    def make(changes: dict[str, Any] | None = None) -> Scene:
        data: Any = copy.deepcopy(BASE)
        for key, value in (changes or {}).items():
            *parents, last = key.split(".")
            holder = data
            for part in parents:
                holder = holder[part]
            if value is None:
                holder.pop(last, None)
            else:
                holder[last] = value
        return parse_scene(data)

    return make
