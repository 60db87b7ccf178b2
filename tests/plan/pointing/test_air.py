"""The weather of a site: what the scene gives, and the standard atmosphere for the rest."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from pipeline.physics.positions.focal_plane import Camera
from pipeline.physics.positions.refraction import standard_air
from pipeline.plan.pointing.air import frame_sines, weather_of, weather_remarks
from pipeline.plan.pointing.decisions import _lift_arcsec
from pipeline.spec.load import parse_scene
from pipeline.spec.pointing.observer import GroundObserver
from tests.spec.test_limits import BASE


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


@pytest.mark.parametrize(
    ("hpa", "told"),
    [(None, ""), (700.0, ""), (1013.25, "1.4[56] times"), (520.0, "0.7[45] times")],
)
def test_a_pressure_of_another_place_or_unit_is_told(hpa: float | None, told: str) -> None:
    """At 3055 m, where ISO 2533 has 696 hPa: one reduced to sea level, and one in mmHg."""
    site: Any = GroundObserver.model_validate(
        {"kind": "ground", "latitude_deg": 20.0, "longitude_deg": 0.0, "height_m": 3055.0,
         "atmosphere": {"refraction": {"pressure_hpa": hpa}}}
    )  # fmt: skip
    scene: Any = type("Scene", (), {"observer": site})()
    remarks = weather_remarks(scene)
    assert len(remarks) == bool(told)
    assert all(re.search(told, remark) for remark in remarks)


@pytest.mark.parametrize("shape", [(400, 100), (100, 400)])
@pytest.mark.parametrize("upright", [False, True])
def test_elevations_around_an_oblong_frame(shape: tuple[int, int], upright: bool) -> None:
    """Corners and middles of edges by plane trigonometry: up runs along the rows, or across."""
    rows, columns = shape
    x_axis, y_axis, z_axis = np.eye(3)
    camera = Camera(rows, columns, 1e-3, 1.0)
    tilt = np.array([0.0, np.sin(0.3), np.cos(0.3)] if upright else [np.sin(0.3), 0.0, np.cos(0.3)])
    (found,) = frame_sines(camera, np.stack([[x_axis, y_axis, z_axis]]), tilt[None])
    half = 0.5 * (rows if upright else columns) * 1e-3
    wide = 0.5 * (columns if upright else rows) * 1e-3
    expected = [
        (np.sin(0.3) * along * half + np.cos(0.3)) / np.sqrt(1 + (along * half) ** 2 + across)
        for along in (-1.0, 0.0, 1.0) for across in (0.0, wide**2, wide**2)
    ]  # fmt: skip
    np.testing.assert_allclose(np.sort(found), np.sort(expected), atol=1e-12)


def test_a_boresight_is_lifted_by_the_cotangent_of_its_elevation() -> None:
    """About 58 arcsec at 45 degrees at sea level, 10 at 80, none at the zenith."""
    site = {"kind": "ground", "latitude_deg": 20.0, "longitude_deg": 0.0,
            "atmosphere": {"refraction": {"humidity": 0.0}}}  # fmt: skip
    for elevation_deg, wanted in ((45.0, 58.0), (80.0, 10.2), (90.0, 0.0)):
        local = {"mode": "local", "azimuth_deg": 10.0, "elevation_deg": elevation_deg}
        scene = parse_scene(BASE | {"observer": site, "pointing": local})
        lift = _lift_arcsec(scene, scene.pointing)
        assert lift == pytest.approx(wanted, rel=0.06, abs=1e-3)
