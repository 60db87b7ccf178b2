"""The weather of a site: what the scene gives, and the standard atmosphere for the rest."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.physics.positions.refraction import standard_air
from pipeline.plan.pointing.air import weather_of
from pipeline.spec.pointing.observer import GroundObserver


@pytest.mark.parametrize(
    "given",
    [{}, {"temperature_c": -11.0}, {"pressure_hpa": 700.0}, {"humidity": 0.7},
     {"temperature_c": 3.0, "pressure_hpa": 650.0, "humidity": 0.1}],
)  # fmt: skip
def test_each_number_by_itself(given: dict[str, float]) -> None:
    site: Any = GroundObserver.model_validate(
        {"kind": "ground", "latitude_deg": 20.0, "longitude_deg": 0.0, "height_m": 2500.0,
         "atmosphere": {"refraction": given}}
    )  # fmt: skip
    pressure, temperature = standard_air(2500.0)
    usual = site.atmosphere.refraction.humidity
    scene: Any = type("Scene", (), {"observer": site})()
    assert weather_of(scene) == (
        given.get("pressure_hpa", pressure), given.get("temperature_c", temperature),
        given.get("humidity", usual),
    )  # fmt: skip
