"""What the Earth hides: how much of the frame is behind its limb, where sources are still drawn."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import Geometry
from pipeline.physics.constants import EARTH_EQUATORIAL_RADIUS_M
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.positions.focal_plane import Camera, deproject, ifov_rad
from pipeline.physics.vectors import separation
from pipeline.plan.decision import Decision
from pipeline.plan.geometry import camera_of
from pipeline.plan.responses import ResponsePlan
from pipeline.spec.observer import GroundObserver
from pipeline.spec.scene import Scene

LINES = 33  # of places along each side of the frame


def decide_occultation(
    scene: Scene, responses: ResponsePlan, ends: Geometry
) -> list[Decision]:
    """What the Earth hides; nothing for a scene without sources."""
    if not (scene.stars or scene.targets):
        return []
    share = hidden_share(scene, ends, responses.reach_px)
    where = f"here in up to {share:.2g} of the pixels" if share else "here its disc is beside them"
    return [
        Decision(
            "earth_occultation", False,
            "the Earth's limb and the horizon bound the boresight only: stars and targets that "
            f"stand behind them elsewhere in the field are drawn; {where}",
            bound=share, unit="of the pixels",
        )
    ]  # fmt: skip


def hidden_share(scene: Scene, g: Geometry, reach_px: float = 0.0) -> float:
    """Most of the frame's pixels that the light of a source behind the Earth may reach.

    In the frames of a geometry at mid-exposure; the disc is taken as wider by the reach of a
    source's light and by what places between LINES x LINES might miss.
    """
    camera, worst = camera_of(scene), 0.0
    x, y = np.meshgrid(*(np.linspace(-0.5, n - 0.5, LINES) for n in (camera.columns, camera.rows)))
    step_px = 0.5 * np.hypot(camera.rows, camera.columns) / (LINES - 1)
    margin = (reach_px + step_px) * ifov_rad(camera)
    for f in range(len(g.frame)):
        down, disc = earth_disc(scene, g, f)
        inside = _inside(camera, g.attitude[f, g.middle], x, y, down, disc + margin)
        worst = max(worst, float(inside.mean()))
    return worst


def earth_disc(scene: Scene, g: Geometry, f: int) -> tuple[np.ndarray, float]:
    """Direction (3,) to the Earth's middle and its radius on the sky [rad] at mid-exposure."""
    earth = earth_and_sun(g.tt1[f, g.middle], g.tt2[f, g.middle]).position_m[0]
    place = g.observer_m[f, g.middle] - earth
    distance = float(np.sqrt(place @ place))
    if isinstance(scene.observer, GroundObserver):
        return -place / distance, 0.5 * np.pi
    return -place / distance, float(np.arcsin(min(1.0, EARTH_EQUATORIAL_RADIUS_M / distance)))


def _inside(
    camera: Camera, attitude: np.ndarray, x: np.ndarray, y: np.ndarray, down: np.ndarray,
    radius_rad: float,
) -> np.ndarray:  # fmt: skip
    """Which places of the frame look at a disc."""
    return separation(deproject(camera, attitude, x.ravel(), y.ravel()), down[None]) < radius_rad
