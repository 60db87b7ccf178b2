"""The weather of a site: what the scene gives, and the standard atmosphere for the rest."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from pipeline.physics.positions.focal_plane import Camera, deproject
from pipeline.physics.positions.refraction import standard_air
from pipeline.physics.vectors import to_angles
from pipeline.plan.pointing.air import (
    frame_sines,
    path_transmission,
    star_transmission,
    weather_of,
    weather_remarks,
)
from pipeline.plan.pointing.decisions import _lift_arcsec
from pipeline.plan.pointing.geometry import moments_at, plan_geometry
from pipeline.plan.pointing.site import axes_of
from pipeline.route.prepare import prepare
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


@pytest.mark.parametrize("rows_per_s", [0.0, 40.0])
def test_light_comes_through_the_air_of_where_it_is_seen(rows_per_s: float) -> None:
    """Also under TDI, where the charge that a target is drawn in moves on: its place is that of
    the charge, the air is that of the target's own elevation (against its direction)."""
    base = BASE | {
        "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3,
                     "height_m": 0.0, "atmosphere": {"extinction": {"mag_per_airmass": 0.5}}},
        "accept": ["daylight", "moon", "sun", "error"],
        "pointing": {"mode": "local", "azimuth_deg": 180.0, "elevation_deg": 30.0},
        "exposure": {"integration_s": 10.0},
    }  # fmt: skip
    base["sensor"] = base["sensor"] | {"shape": [512, 64], "focal_length_m": 0.05}
    base["sensor"]["detector"] = {"readout": {"kind": "tdi", "rows_per_s": rows_per_s}}
    if not rows_per_s:
        del base["sensor"]["detector"]
    plan = prepare(parse_scene(base)).plan
    g = plan_geometry(plan.scene, np.array([0]), plan.dut1_s)
    assert plan.extinction is not None
    nodes = g.offset_s.shape[-1]
    sky_y = np.linspace(100.0, 400.0, nodes)  # where it is seen
    drawn_y = sky_y - rows_per_s * (g.offset_s[0] - g.offset_s[0, nodes // 2])
    x = np.full(nodes, 30.0)
    found = path_transmission(plan.extinction, plan.camera, g, x, drawn_y)
    ends = [deproject(plan.camera, g.attitude[0, k], x[[k]], sky_y[[k]])[0] for k in range(nodes)]
    sine = np.sum(np.array(ends) * g.air[0, :, :3], axis=-1)
    assert found == pytest.approx(plan.extinction.transmission(sine), rel=1e-12)
    assert np.ptp(found) > 1e-3


@pytest.mark.parametrize(
    ("up_deg", "time_s"), [(4.0, 1800.0), (4.0, 3600.0), (10.0, 7200.0), (40.0, 60.0)]
)
def test_a_long_exposure_has_the_mean_of_the_air_on_its_way(up_deg: float, time_s: float) -> None:
    """Of a star that rises from the horizon of the equator: against 2,001 moments."""
    base = BASE | {
        "observer": {"kind": "ground", "latitude_deg": 0.0, "longitude_deg": -156.3,
                     "height_m": 0.0, "atmosphere": {"extinction": {"mag_per_airmass": 0.25}}},
        "accept": ["daylight", "moon", "sun", "error"], "epoch": "2019-04-20T08:00:00Z",
        "exposure": {"integration_s": time_s},
    }  # fmt: skip
    aim = {"mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": 0.0}
    at = moments_at(parse_scene(base | {"pointing": aim}), 0.0, np.zeros(1))
    north_east_up = axes_of(parse_scene(base | {"pointing": aim}).observer, at.times)[0]
    up = np.radians(up_deg)
    ra, dec = np.degrees(to_angles(np.cos(up) * north_east_up[1] + np.sin(up) * north_east_up[2]))
    aim |= {"boresight_ra_deg": float(ra), "boresight_dec_deg": float(dec)}
    plan = prepare(parse_scene(base | {"pointing": aim})).plan
    g = plan_geometry(plan.scene, np.array([0]), plan.dut1_s)
    assert plan.extinction is not None
    star = g.attitude[0, [g.middle], 2]
    found = star_transmission(plan.extinction, plan.camera, g, star)[0]
    moments = moments_at(plan.scene, plan.dut1_s, np.linspace(0.0, time_s, 2001))
    zenith = axes_of(plan.scene.observer, moments.times)[:, 2]
    wanted = np.mean(plan.extinction.transmission(zenith @ star[0]))
    assert found == pytest.approx(wanted, rel=3e-4)
