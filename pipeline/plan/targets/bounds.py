"""How large what is omitted of a target may be: forces, earthshine, light between facets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.arrays import Geometry
from pipeline.physics.constants import (
    DAY_S,
    DEG_RAD,
    EARTH_EQUATORIAL_RADIUS_M,
    EARTH_GM_M3_S2,
    SPEED_OF_LIGHT_M_S,
)
from pipeline.physics.positions.apparent import aberrate, unaberrate
from pipeline.physics.positions.earth import earth_and_sun
from pipeline.physics.positions.orbit_table import best_nodes, table_error
from pipeline.physics.positions.refraction import unrefract
from pipeline.physics.positions.times import parse_utc
from pipeline.plan.decision import Decision
from pipeline.plan.timing import end_s
from pipeline.spec.scene import Scene, Target
from pipeline.spec.targets.mesh import LambertSurface, MeshBody
from pipeline.spec.targets.orbit import KeplerianOrbit, StateOrbit, TableOrbit

J2 = 1.0826267e-3
SMALLER = 1.05  # harmonics beyond the flattening, of its acceleration: 1.4e-2 of it, and sunlight
MOON_PER_S2, SUN_PER_S2 = 2.0 * 4.9028e12 / 3.56e8**3, 2.0 * 1.32712e20 / 1.47e11**3  # tides
USUAL_ALBEDO = 0.3


def geocentric_m(g: Geometry) -> np.ndarray:
    """Distances (T, F) of targets from the Earth's middle when the light of mid-exposure left.

    What is seen through air and by a moving observer is taken back to the Earth's frame, which
    goes on while light is on its way (`target_apparent`).
    """
    middle = g.middle
    earth = earth_and_sun(g.tt1[:, middle], g.tt2[:, middle])
    seen = [unrefract(g.target_direction[:, k], g.air_at(k, middle)) for k in range(len(g.frame))]
    in_space = unaberrate(np.stack(seen, axis=1), g.observer_m_s[:, middle] / SPEED_OF_LIGHT_M_S)
    towards = aberrate(in_space, earth.velocity_m_s / SPEED_OF_LIGHT_M_S)
    place = g.observer_m[:, middle] - earth.position_m
    target = place + g.target_range_m[:, :, middle, None] * towards
    return np.asarray(np.sqrt(np.sum(target**2, axis=-1)))


def earthshine_share(lamps: Sequence[Target], g: Geometry) -> float:
    """Irradiance by the Earth over the Sun's of the nearest target: albedo (R/r)^2, at most."""
    albedos = [t.lighting.earthshine_albedo or 0.0 for t in lamps if t.lighting is not None]
    nearest = max(float(geocentric_m(g).min()), EARTH_EQUATORIAL_RADIUS_M)
    albedo = max(albedos, default=USUAL_ALBEDO)
    return 1.01 * albedo * (EARTH_EQUATORIAL_RADIUS_M / nearest) ** 2


def two_body_m(targets: Sequence[Target], scene: Scene, g: Geometry) -> float:
    """How far two-body motion may be off in a scene, by all forces but drag [m]."""
    seen_m = geocentric_m(g).min(axis=1)
    span_s, names = (0.0, end_s(scene)), {t.name for t in targets}
    return max(
        (
            two_body_off_m(scene, t.orbit, *span_s, float(seen_m[i]))
            for i, t in enumerate(scene.targets)
            if t.name in names
        ),
        default=0.0,
    )


def two_body_off_m(
    scene: Scene, orbit: Any, first_s: float, last_s: float, seen_m: float = math.inf
) -> float:
    """How far two-body motion may be off between two times after a scene's epoch [m].

    seen_m : a distance from the Earth's middle at which the target was found

    In a coming and going orbit a steady force f moves a body by at most 2 f t^2 (Clohessy &
    Wiltshire 1960: 3/2 along the track, the rest across and with the period). f: the flattening's
    3 J2 mu R^2 / r^4 at the lowest height, with what is smaller, and the tides of Moon and Sun.
    """
    r = max(_lowest_m(orbit, seen_m), EARTH_EQUATORIAL_RADIUS_M)
    time_s = longest_from_elements_s(scene, orbit, first_s, last_s)
    flat = 3.0 * J2 * EARTH_GM_M3_S2 * EARTH_EQUATORIAL_RADIUS_M**2 / r**4
    force = SMALLER * flat + (MOON_PER_S2 + SUN_PER_S2) * 1.2 * r
    return 2.0 * force * time_s**2


def longest_from_elements_s(
    scene: Scene, orbit: Any, first_s: float = 0.0, last_s: float | None = None
) -> float:
    """Longest time [s] from when a state, or elements, were right, at their epoch, to any between
    two times after the scene's epoch; default: of the scene."""
    told = getattr(orbit, "time_of_perigee", None) or orbit.epoch
    start, right = parse_utc(scene.epoch), parse_utc(told or scene.epoch)
    since = DAY_S * ((start[0] - right[0]) + (start[1] - right[1]))
    last_s = end_s(scene) if last_s is None else last_s
    return max(abs(since + first_s), abs(since + last_s))


def _lowest_m(orbit: Any, seen_m: float) -> float:
    """Distance of perigee [m]; that which is seen where the orbit does not say."""
    low = ellipse_of(orbit)[0]
    if isinstance(orbit, KeplerianOrbit):
        return low
    place = np.array(orbit.position_m, float)
    return float(min(low, np.sqrt(place @ place), seen_m))


def ellipse_of(orbit: StateOrbit | KeplerianOrbit) -> tuple[float, float, float]:
    """Distance of perigee [m], eccentricity, and cosine of the inclination."""
    if isinstance(orbit, KeplerianOrbit):
        e, perigee = orbit.eccentricity, orbit.perigee_radius_m
        if perigee is None:
            assert orbit.semi_major_axis_m is not None
            perigee = orbit.semi_major_axis_m * (1.0 - e)
        return float(perigee), e, float(np.cos(orbit.inclination_deg * DEG_RAD))
    place, speed = (np.array(v, float) for v in (orbit.position_m, orbit.velocity_m_s))
    momentum = np.cross(place, speed)
    squared = float(momentum @ momentum)
    pull = np.cross(speed, momentum) / EARTH_GM_M3_S2 - place / np.sqrt(place @ place)
    e = float(np.sqrt(pull @ pull))
    tilt = float(momentum[2]) / max(math.sqrt(squared), 1e-9)
    return squared / EARTH_GM_M3_S2 / (1.0 + e), e, tilt


def table_error_m(o: TableOrbit) -> tuple[int, float, bool]:
    """Rows that polynomials of a table pass, their error [m], and whether the rows tell it.

    Of two rows that of a free orbit about the Earth, r (w t / 2)^d / d!, w^2 = GM / r^3: of a
    straight line d = 2, of a cubic, with velocities, d = 4; at most the orbit's diameter.
    """
    nodes, error = o.nodes, o.error_m
    if nodes is None or error is None:  # rows in the scene itself: nobody measured them yet
        rows = np.array(o.rows, float)
        table = rows[:, 0], rows[:, 1:4], rows[:, 4:] if rows.shape[1] == 7 else None
        if nodes is None:
            nodes, error = best_nodes(*table)
        else:
            error = table_error(*table, nodes)
        if not np.isfinite(error):
            r = float(np.sqrt(np.sum(table[1] ** 2, axis=-1)).min())
            degree = 2 if table[2] is None else 4
            turned = math.sqrt(EARTH_GM_M3_S2 / r**3) * float(table[0][-1] - table[0][0])
            error = r * (0.5 * turned) ** degree / math.factorial(degree)
            return nodes, min(error, 2.0 * r), False
    return nodes, error, True


def table_told(target: Target) -> Decision:
    """How well a table of places tells an orbit between its rows."""
    assert isinstance(target.orbit, TableOrbit)
    nodes, error, known = table_error_m(target.orbit)
    told = f"at most {error:.2g} m off on rows omitted"
    few = f"too few to leave one out: a free orbit bends by {error:.2g} m between them"
    return Decision(
        "targets.ephemeris",
        True,
        f"{target.name}: {target.orbit.source or 'rows in the scene'}, polynomials through {nodes} "
        f"rows, {told if known else few}",
        bound=error,
        unit="m",
    )


def between_facets(meshes: Sequence[Target]) -> Decision:
    """Light that goes from one facet to another and then on to the observer: never drawn.

    Of matt surfaces of albedo a under the irradiance E no facet is lit by others with more than
    a E / (1 - a), so that a body sends at most that over E more than a matt plate of its outline
    that faces the Sun. A closed convex body sends nothing of it.
    """
    found = [_albedo(t.body) for t in meshes if isinstance(t.body, MeshBody)]
    known = [a for a in found if a is not None]
    told = "in concave corners of bright diffuse surfaces a part of the light is missing"
    if len(known) < len(found):
        return Decision(
            "targets.light_between_facets",
            False,
            f"one reflection only: {told}; no bound is known of glossy surfaces",
        )
    a = max(known, default=0.0)
    return Decision(
        "targets.light_between_facets",
        False,
        f"one reflection only: {told}, at most albedo / (1 - albedo) of the light of a matt plate "
        "of the body's outline; none of a convex body's",
        bound=a / (1.0 - a) if a < 1.0 else None,
        unit="of a plate of its outline",
    )


def _albedo(body: MeshBody) -> float | None:
    """Largest albedo of a body's matt surfaces, 0 of a convex body; None where it has others."""
    model = body.model
    if model is not None and len(model.parts) == 1 and model.parts[0].facets.convex:
        return 0.0
    albedos = [0.0]
    for part in (body, *body.parts):
        for surface in (part.surface, *part.materials.values()):
            if isinstance(surface, LambertSurface):
                albedos.append(float(surface.albedo))
            elif surface is not None:
                return None
    return max(albedos)
