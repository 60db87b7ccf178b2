"""What the Earth hides of an exposure whose rows are read one after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pipeline.physics.positions.focal_plane import deproject
from pipeline.plan.pointing.geometry import camera_of, plan_geometry
from pipeline.plan.pointing.occultation import BESIDE_RAD, limb_in_reach, seen_fraction
from pipeline.spec.scene import Scene

Make = Callable[..., Scene]
ROWS, LINE_S = 512, 0.004
PLACE, SPEED = np.array([6.9e6, 0.0, 0.0]), np.array([0.0, 5374.0, 5374.0])


def low_orbit(
    scene: Make, since_s: float, readout: dict[str, Any] | None, above_rad: float = 0.005
) -> Scene:
    """Just above the limb ahead, where stars rise or set by some 0.1 degrees in an exposure."""
    down = np.arcsin(6.378e6 / 6.9e6) + above_rad
    u = -np.cos(down) * PLACE / 6.9e6 + np.sin(down) * SPEED / 7600.0
    ra, dec = np.degrees([np.arctan2(u[1], u[0]), np.arcsin(u[2])])
    detector = None if readout is None else {"readout": {"kind": "rolling"} | readout}
    return scene({
        "epoch": f"2019-04-20T03:00:{since_s:09.6f}Z", "accept": ["sun", "moon", "daylight"],
        "observer": {"kind": "orbit", "orbit": {
            "kind": "state", "position_m": PLACE.tolist(), "velocity_m_s": SPEED.tolist(),
            "epoch": "2019-04-20T03:00:00Z"}},
        "pointing.boresight_ra_deg": float(ra) % 360.0, "pointing.boresight_dec_deg": float(dec),
        "sensor.shape": [ROWS, 640], "sensor.focal_length_m": 0.1, "sensor.detector": detector,
        "exposure.frames": 1,
    })  # fmt: skip


def fractions(s: Scene, proper: np.ndarray, y: np.ndarray) -> np.ndarray:
    return seen_fraction(s, camera_of(s), plan_geometry(s, np.array([0]), 0.0), proper, y, 5.0)


@pytest.mark.parametrize("first", ["low_rows", "high_rows"])
def test_a_star_rises_or_sets_by_the_time_of_its_own_row(scene: Make, first: str) -> None:
    """As in a frame of all rows at once, that begins when the row does."""
    rolling = low_orbit(scene, 10.0, {"line_s": LINE_S, "first": first})
    camera, g = camera_of(rolling), plan_geometry(rolling, np.array([0]), 0.0)
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(0, 639, 60), [0.0, 255.0, 511.0]))
    proper = deproject(camera, g.attitude[0, g.middle], x, y)
    found = fractions(rolling, proper, y)
    for row in (0.0, 255.0, 511.0):
        late_s = LINE_S * (row if first == "low_rows" else ROWS - 1 - row)
        alone = fractions(low_orbit(scene, 10.0 + late_s, None), proper[y == row], y[y == row])
        np.testing.assert_allclose(found[y == row], alone, rtol=0, atol=2e-3)
    assert ((found > 0.02) & (found < 0.98)).sum() >= 3


@pytest.mark.parametrize("reach_px", [0.0, 200.0])
@pytest.mark.parametrize("seconds", [1.0, 30.0])
def test_the_limb_is_in_reach_of_a_corner(scene: Make, reach_px: float, seconds: float) -> None:
    """Of one beside the field, with room for air and for what it turns in the exposure."""
    turned = 7600.0 / 6.9e6 * seconds
    nearest = 1e-4 * (np.hypot(256, 320) + reach_px) + BESIDE_RAD + turned
    for room, near in ((-0.003, True), (0.003, False)):
        s = low_orbit(scene, 0.0, None, float(nearest) + room)
        exposure = s.exposure.model_copy(update={"integration_s": seconds})
        s = s.model_copy(update={"exposure": exposure})
        g = plan_geometry(s, np.array([0]), 0.0)
        assert limb_in_reach(s, camera_of(s), g, reach_px) == near


def test_the_horizon_is_not_in_reach_of_the_zenith(scene: Make) -> None:
    """But of a line of sight a degree above it."""
    site = {"kind": "ground", "latitude_deg": 20.0, "longitude_deg": 0.0}
    for elevation, near in ((89.0, False), (1.0, True)):
        s = scene({
            "observer": site, "accept": ["sun", "moon", "daylight"], "exposure.frames": 1,
            "pointing": {"mode": "local", "azimuth_deg": 9.0, "elevation_deg": elevation},
        })  # fmt: skip
        g = plan_geometry(s, np.array([0]), 0.0)
        assert limb_in_reach(s, camera_of(s), g, 0.0) == near
