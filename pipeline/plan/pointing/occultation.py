"""What the Earth hides of stars and targets, each by itself, and of which part of an exposure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array, Geometry
from pipeline.physics.constants import DEG_RAD, SPEED_OF_LIGHT_M_S
from pipeline.physics.motion.rolling import later, row_delay_s
from pipeline.physics.motion.streak import Path, path_through
from pipeline.physics.positions.apparent import aberrate, unaberrate
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.positions.focal_plane import Camera, corner_radius, ifov_rad, stretch
from pipeline.physics.positions.limb import (
    FINER,
    crossings,
    finer,
    height_of_line_m,
    limb_angle,
    pole_at,
    visible_fraction,
    zenith_of,
)
from pipeline.physics.positions.refraction import refract
from pipeline.physics.positions.times import parse_utc
from pipeline.plan.decision import Decision
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene

LOOKED_AT = 9  # nodes of an exposure at which all stars are judged, before some are at every one
BESIDE_RAD = 0.02  # refraction at the horizon is 0.01, aberration and the path's bends far less


def hidden_by(scene: Scene) -> str:
    """What stands before the sources that an observer does not see."""
    return "horizon" if isinstance(scene.observer, GroundObserver) else "earth"


def limb_in_reach(scene: Scene, camera: Camera, g: Geometry, reach_px: float) -> bool:
    """Whether the limb or the horizon comes into a frame of `g`, or so near to one [px].

    reach_px : beyond the frame's edge; looked at are start, middle and end of each exposure, with
    as much to spare as the boresight turns between them
    """
    three = np.array([0, g.middle, g.nodes - 1])
    place = g.observer_m[:, three] - _earth_m(g, three)
    boresight = g.attitude[:, three, 2]
    pole = pole_at(parse_utc(scene.epoch))
    if isinstance(scene.observer, GroundObserver):
        up = zenith_of(place, pole, _latitude_rad(scene))
        off = np.arcsin(np.clip(np.sum(boresight * up, axis=-1), -1.0, 1.0))
    else:
        off = limb_angle(place, boresight, pole)
    radius = corner_radius(camera) + reach_px * stretch(camera) * ifov_rad(camera)
    spare = np.ptp(off, axis=-1) + BESIDE_RAD
    return bool(np.any(off.min(axis=-1) - spare < radius))


def stars_clear(scene: Scene, camera: Camera, g: Geometry, proper: Array, y_px: Array) -> Array:
    """How clear of the Earth stars are (n, K) at the nodes of the one frame of `g`: as
    `Geometry.target_clear`.

    proper : (n, 3) proper directions at mid-exposure, before refraction; the motion of the observer
    changes them by far less in an exposure than the air at the limb bends light
    y_px : (n,) their rows, which a rolling shutter exposes one after the other
    """
    return _clear_at(scene, camera, g, proper, y_px, np.arange(g.nodes))


def seen_fraction(
    scene: Scene, camera: Camera, g: Geometry, proper: Array, y_px: Array, reach_px: float
) -> Array:
    """Fraction (n,) of the one exposure of `g` in which stars are not hidden by the Earth.

    All are judged at few nodes, and those that rise or set between them, or may graze the limb,
    at FINER steps between all. Shapes as in `stars_clear`; reach_px : how far off the frame they
    may be
    """
    fraction = np.ones(len(proper))
    if not len(proper) or not limb_in_reach(scene, camera, g, reach_px):
        return fraction
    some = np.unique(np.linspace(0, g.nodes - 1, min(g.nodes, LOOKED_AT)).round().astype(int))
    clear = _clear_at(scene, camera, g, proper, y_px, some)
    slack = np.abs(np.diff(clear, 2, axis=-1)).max(axis=-1)
    low, high = clear.min(axis=-1) - slack, clear.max(axis=-1) + slack
    fraction[high < 0.0] = 0.0
    partly = np.flatnonzero((low < 0.0) & (high >= 0.0))
    if len(partly):
        every = stars_clear(scene, camera, g, proper[partly], y_px[partly])
        fraction[partly] = visible_fraction(finer(every))
    return fraction


def targets_seen(g: Geometry) -> Array:
    """Fraction (T,) of the one exposure of `g` in which targets are not hidden by the Earth."""
    return visible_fraction(finer(g.target_clear[:, 0]))


def visible_path(
    x_px: Array,
    y_px: Array,
    light: Array,
    clear: Array,
    front: NDArray[np.bool_],
    merge_px: float,
    parts: int = 1,
) -> tuple[Path, float]:
    """The part of a path in which its source is seen, and the mean light of the exposure.

    x_px, y_px, light : (K,) at nodes at equal steps, straight between them; clear : (K,) positive
    where it is seen; front : (K - 1,) between which nodes it is before the camera; parts : of each
    step, with even light in each. The path begins
    and ends where the source appears and disappears, and has no light where it is hidden between.
    One that sends none has the path of the whole exposure.
    """
    fine, nodes = finer(clear), np.arange(len(clear))
    steps = np.arange(nodes[-1] * parts + 1) / parts
    at = np.unique(np.concatenate([steps, crossings(fine) / FINER]))
    halfway = 0.5 * (at[1:] + at[:-1])
    seen = np.interp(halfway * FINER, np.arange(len(fine)), fine) >= 0.0
    x, y, bright = (np.interp(at, nodes, v) for v in (x_px, y_px, light))
    seen &= front[halfway.astype(np.int64)]
    share = np.where(seen, 0.5 * (bright[1:] + bright[:-1]) * np.diff(at) / nodes[-1], 0.0)
    lit = np.flatnonzero(share > 0.0)
    if not len(lit):
        return path_through(x_px, y_px, np.full(nodes[-1], 1.0 / nodes[-1]), merge_px), 0.0
    kept = slice(lit[0], lit[-1] + 1)
    total = float(share.sum())
    ends = slice(lit[0], lit[-1] + 2)
    return path_through(x[ends], y[ends], share[kept] / total, merge_px), total


def _occultation(basis: PlanBasis) -> list[Decision]:
    """What the Earth hides; nothing for a scene without sources."""
    scene, ends = basis.scene, basis.frames
    if not (scene.stars or scene.targets):
        return []
    near = limb_in_reach(scene, basis.resolved.camera, ends, basis.resolved.responses.reach_px)
    gone = bool((ends.target_clear < 0.0).any())
    if not near and not gone:
        beside = "the limb of the Earth, or the horizon, is beside the field: nothing is judged"
        return [Decision("earth_occultation", False, beside, bound=0.0, unit="of a source's light")]
    step = 1.0 / (FINER * (ends.nodes - 1))
    where = (
        "below the horizon, the plane through the site (a sea far below lies lower by its dip, 1.8 "
        "degrees at 3 km; hills are not known), by their apparent elevation"
        if isinstance(scene.observer, GroundObserver)
        else "where the line of sight crosses the WGS 84 ellipsoid before it reaches them"
    )
    return [
        Decision(
            "earth_occultation",
            True,
            f"stars and targets are hidden each by itself {where}. One that rises or sets in an "
            "exposure has the light and the path of the part in which it is seen, to the bound "
            "where it only grazes the limb, far better where it crosses it",
            bound=step,
            unit="of a source's light",
        ),
        _limb_air(scene),
    ]


def _limb_air(scene: Scene) -> Decision:
    """What the air at the limb does to sources beside it, which is not drawn."""
    o = scene.observer
    if not isinstance(o, GroundObserver):
        return Decision(
            "earth_occultation.air",
            False,
            "the limb is that of the ground: air neither bends, dims nor scatters the light that "
            "passes it. Seen from space it bends a line by 70 arcmin at the ground, 4 at 20 km, "
            "0.3 at 40 km, spreads and reddens its light, and clouds end it below some 10 km",
            bound=70.0,
            unit="arcmin",
        )
    refracted = o.atmosphere is not None and bool(o.atmosphere.refraction)
    if refracted:
        return Decision(
            "earth_occultation.air",
            True,
            "refraction lifts sources as observer.atmosphere says",
        )
    return Decision(
        "earth_occultation.air",
        False,
        "no refraction is asked for: with it (observer.atmosphere.refraction) sources down to 35 "
        "arcmin below the horizon would be seen",
        bound=35.0,
        unit="arcmin",
    )


def _clear_at(
    scene: Scene, camera: Camera, g: Geometry, proper: Array, y_px: Array, nodes: NDArray[np.int64]
) -> Array:
    """`stars_clear` at some nodes, the first and the last among them."""
    pole, earth = pole_at(parse_utc(scene.epoch)), _earth_m(g, nodes)[0]
    place = g.observer_m[0, nodes] - earth
    if isinstance(scene.observer, GroundObserver):
        up = zenith_of(place, pole, _latitude_rad(scene))
        clear = np.stack(
            [
                np.sum(refract(proper, g.air_at(0, int(k))) * z, axis=-1)
                for k, z in zip(nodes, up, strict=True)
            ],
            axis=-1,
        )
    else:
        u = _in_the_earths_frame(scene, g, proper)
        clear = np.stack([height_of_line_m(p, u, pole) for p in place], axis=-1)
    if camera.line_s:
        times = g.offset_s[0, nodes] - g.offset_s[0, 0]
        clear = later(clear, times, row_delay_s(y_px, camera.line_s, camera.rows)[:, None])
    return clear


def _in_the_earths_frame(scene: Scene, g: Geometry, proper: Array) -> Array:
    """Directions (n, 3) of stars as the moving Earth sees them, in which its limb is at rest."""
    if not scene.star_effects["aberration"]:
        return proper
    earth = earth_and_sun(g.tt1[0, g.middle], g.tt2[0, g.middle]).velocity_m_s[0]
    still = unaberrate(proper, g.observer_m_s[0, g.middle] / SPEED_OF_LIGHT_M_S)
    return aberrate(still, earth / SPEED_OF_LIGHT_M_S)


def _earth_m(g: Geometry, nodes: NDArray[np.int64]) -> Array:
    """Barycentric Earth (F, k, 3) at some nodes."""
    tt1, tt2 = g.tt1[:, nodes], g.tt2[:, nodes]
    return earth_and_sun(tt1.ravel(), tt2.ravel()).position_m.reshape(*tt1.shape, 3)


def _latitude_rad(scene: Scene) -> float:
    assert isinstance(scene.observer, GroundObserver)
    return scene.observer.latitude_deg * DEG_RAD


RULES = (
    Rule(
        ("earth_occultation", "earth_occultation.air"),
        "each source by itself where the limb or the horizon comes near the field; the air at a "
        "limb seen from space never, that of a site where its refraction is asked for",
        "tests/acceptance/test_behind_the_earth.py::test_stars_behind_the_limb_against_rays",
        _occultation,
    ),
)
