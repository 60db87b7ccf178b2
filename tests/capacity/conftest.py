"""A small study: two sites, some dozens of objects, ten hours."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from tests.survey.conftest import CAMERA, coarse_signal  # noqa: F401 - a fixture

SITE = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055}
SMALL: dict[str, Any] = {
    "schema": "nightglass/study/1",
    "name": "small",
    "seed": 3,
    "start": "2019-04-20T06:00:00Z",
    "duration_h": 8,
    "cameras": [
        {
            "name": "camera",
            "tracking": "target",
            "sensor": CAMERA,
            "exposure": {"integration_s": 1.0, "frames": 3, "cadence_s": 2.0},
            "background": {"uniform_mag_arcsec2": 21.0},
        }
    ],
    "sensors": [
        {"name": "one", "count": 2, "observer": SITE},
        {"name": "two", "observer": SITE | {"longitude_deg": -120.0}},
    ],
    "catalogue": {"synthetic": {"objects": 60, "seed": 4}},
    "tasking": {"kind": "cued", "revisit_h": 2.0},
}


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without their pictures, which take a second."""
    monkeypatch.setattr("pipeline.capacity.page._pictures", lambda *_: "")


@pytest.fixture
def data() -> dict[str, Any]:
    """A copy that a test may change."""
    return copy.deepcopy(SMALL)
