"""From bodies and where they stand to the light they send: intensity per solar irradiance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.errors import BadInput
from pipeline.physics.targets.earthshine import earth_lamps
from pipeline.physics.targets.eclipse import sunlit_fraction
from pipeline.physics.targets.lighting import (
    phase_angle,
    photon_rate_at_aperture,
    sun_distance,
)
from pipeline.physics.targets.shadow import moon_m, sunlit_past_earth, sunlit_past_moon
from pipeline.physics.targets.sphere import sphere_intensity_per_irradiance
from pipeline.plan.bodies.albedos import albedo_of
from pipeline.plan.bodies.attitudes import View
from pipeline.plan.bodies.shapes import reflected_m2_sr, shapes_m2_sr
from pipeline.spec.scene import Target
from pipeline.spec.targets.body import Body, LightCurveBody, Lighting, SphereBody
from pipeline.spec.targets.mesh import MeshBody

Array = NDArray[np.float64]

TOGETHER = 1000  # moments that are lit by all of the Earth's lamps at once: 110 MB


def target_lights(
    targets: Sequence[Target],
    fields: Sequence[str],
    epoch: tuple[float, float],
    view: View,
    sun_from_earth_m: Array,
    tt: tuple[Array, Array],
    range_m: Array,
    frames: int = 1,
    known: Mapping[int, Array] | None = None,
) -> tuple[Array, Array, Array]:
    """Irradiance at the observer over that of the Sun at 1 au, phase [rad], sunlit share: (T, n).

    fields : the targets' places in the scene, for messages; epoch : the scene's, UTC
    sun_from_earth_m : (n, 3) geometric, for the distance; range_m : (T, n)
    tt : two-part Julian dates (n,), for the Moon
    frames : of which the moments are the nodes, one after another: each stands on its own
    known : of some targets, intensities (n, 1 or 2) [m2/sr] in sunlight and in earthshine
    """
    known = known or {}
    alpha = phase_angle(view.place_m, view.sun_m, view.observer_m)
    reflected = _reflected(targets, fields, epoch, view, alpha, frames, known)
    lit = _sunlit_shares(targets, view, tt)
    distance = sun_distance(view.place_m, sun_from_earth_m)
    light = photon_rate_at_aperture(1.0, distance, lit, reflected, range_m)
    at_earth = np.sqrt(np.sum(np.square(sun_from_earth_m), axis=-1))
    for i, target in enumerate(targets):
        lighting = target.lighting
        if lighting is not None and lighting.earthshine_albedo is not None:
            if i in known:
                extra = known[i][:, 1]
            else:
                one, albedo = view.of(np.array([i])), lighting.earthshine_albedo
                besides = reflected[i] * lit[i]
                extra = earthshine_m2_sr(
                    target.body, epoch, one, albedo, fields[i], besides, frames
                )
            light[i] += photon_rate_at_aperture(1.0, at_earth, 1.0, extra, range_m[i])
    return light, alpha, lit


def _reflected(
    targets: Sequence[Target],
    fields: Sequence[str],
    epoch: tuple[float, float],
    view: View,
    alpha: Array,
    frames: int,
    known: Mapping[int, Array],
) -> Array:
    """Intensities (T, n) [m2/sr] of bodies of every kind."""
    out, bodies = np.zeros(alpha.shape), list[Any](map(attrgetter("body"), targets))
    spheres = [i for i, b in enumerate(bodies) if isinstance(b, SphereBody)]
    meshes = [i for i, b in enumerate(bodies) if isinstance(b, MeshBody)]
    others = sorted(set(range(len(targets))) - {*spheres, *meshes})
    if spheres:
        diameter = np.array([[bodies[i].diameter_m] for i in spheres])
        albedo = np.array([[albedo_of(bodies[i], fields[i])] for i in spheres])
        out[spheres] = sphere_intensity_per_irradiance(alpha[spheres], diameter, albedo)
    for i in meshes:
        from pipeline.plan.bodies.meshes import mesh_m2_sr  # only scenes with meshes need it

        if i in known:
            out[i] = known[i][:, 0]
        else:
            out[i] = mesh_m2_sr(bodies[i], epoch, view.of(np.array([i])), fields[i], frames)
    if others:
        asked, names = zip(*((bodies[i], fields[i]) for i in others), strict=True)
        out[others] = reflected_m2_sr(asked, epoch, view.of(np.array(others)), names)
    return out


def _sunlit_shares(targets: Sequence[Target], view: View, tt: tuple[Array, Array]) -> Array:
    """Shares (T, n) of sunlight that reach the targets past Earth and Moon."""
    lit = np.ones(view.time_s.shape)
    shaded = [i for i, t in enumerate(targets) if t.eclipse]
    plain = [i for i in shaded if not _finer(targets[i].lighting)]
    if plain:
        lit[plain] = sunlit_fraction(view.place_m[plain], view.sun_m[plain])
    for i in shaded:
        if _finer(targets[i].lighting):
            lit[i] = _sunlit(targets[i].lighting, view.place_m[i], view.sun_m[i], tt)
    return lit


def _finer(request: Lighting | None) -> bool:
    """True where more than a round Earth and an even Sun is asked for."""
    return request is not None and bool(
        request.oblate_earth or request.limb_darkening or request.moon
    )


def _sunlit(lighting: Lighting | None, place: Array, sun: Array, tt: tuple[Array, Array]) -> Array:
    """Share (n,) of sunlight that reaches a target past Earth and Moon."""
    request = lighting or Lighting()
    if request.oblate_earth or request.limb_darkening:
        lit = sunlit_past_earth(place, sun, request.limb_darkening, request.oblate_earth)
    else:
        lit = sunlit_fraction(place, sun)
    if request.moon:
        # where both stand before the Sun their shadows are taken one after the other
        lit = lit * sunlit_past_moon(place, sun, moon_m(*tt), request.limb_darkening)
    return lit


def earthshine_m2_sr(
    body: Body | MeshBody,
    epoch: tuple[float, float],
    view: View,
    albedo: float,
    field: str = "body",
    besides_m2_sr: Array | None = None,
    frames: int = 1,
) -> Array:
    """Intensity (n,) of one body in earthshine over the solar irradiance at the Earth [m2/sr].

    besides_m2_sr : (n,) what it sends besides; a mesh's shadows err by a share of both together
    """
    if isinstance(body, LightCurveBody):
        raise BadInput(f"{field}.kind", body.kind, "earthshine on a body of shapes or a mesh")
    if isinstance(body, MeshBody):
        from pipeline.plan.bodies.meshes import mesh_earthshine_m2_sr

        rest = np.zeros(view.time_s.shape[1]) if besides_m2_sr is None else besides_m2_sr
        return mesh_earthshine_m2_sr(body, epoch, view, albedo, rest, field, frames)
    out = np.zeros(view.time_s.shape[1])
    for first in range(0, len(out), TOGETHER):
        part = slice(first, first + TOGETHER)
        some = View(*(getattr(view, name)[:, part] for name in view.__dataclass_fields__))
        out[part] = _shapes_by_earth_m2_sr(body, epoch, some, albedo, field)
    return out


def _shapes_by_earth_m2_sr(
    body: Body, epoch: tuple[float, float], view: View, albedo: float, field: str
) -> Array:
    """The same of shapes, at moments that fit into memory together with all lamps."""
    directions, light = earth_lamps(view.place_m[0], view.sun_m[0], albedo)
    n, k = light.shape
    towards = directions.reshape(1, -1, 3)

    def each(values: Array) -> Array:
        return np.repeat(values[0], k, axis=0)[None]

    lamps = View(
        each(view.time_s),
        each(view.place_m),
        each(view.velocity_m_s),
        each(view.sun_m),
        each(view.observer_m),
    )
    return np.sum(shapes_m2_sr([body], epoch, lamps, [field], towards).reshape(n, k) * light, -1)


def flicker_share(g: Geometry, which: NDArray[np.bool_] | None = None) -> float:
    """The worst of `flicker_shares`."""
    return float(flicker_shares(g, which).max(initial=0.0))


def flicker_shares(g: Geometry, which: NDArray[np.bool_] | None = None) -> Array:
    """How far the light between nodes may be off (F,), as a share of a target's in its exposure.

    The light of an exposure is the trapezium rule over the nodes, the light of an interval the mean
    of its ends. Rules of K and K/2 intervals are compared: for smooth light the finer one errs
    by a third of what they differ, for kinks and steps (a face that turns to the Sun, the edge of
    the shadow) by at most about as much as they differ, which is returned: the worst of a
    frame's targets, or of those that are true in `which` (T, F).
    """
    light = g.target_light
    if not light.size:
        return np.zeros(len(g.frame))
    fine = 0.5 * (light[..., :-1] + light[..., 1:])
    pairs = fine[..., 0::2] + fine[..., 1::2]
    coarse = light[..., :-2:2] + light[..., 2::2]
    total = fine.sum(axis=-1)
    off = np.abs(pairs - coarse).sum(axis=-1)
    counts = total > 0.0 if which is None else (total > 0.0) & which
    return np.max(np.divide(off, total, out=np.zeros_like(off), where=counts), axis=0)


def missed_shares(g: Geometry, which: NDArray[np.bool_], step: int) -> Array:
    """How much light straight lines between every `step`-th node put wrongly in time (F,).

    As a share of a target's in its exposure; the worst of the targets that are true in `which`
    (T, F).
    """
    light, part = g.target_light, np.arange(step) / step
    if not light.size:
        return np.zeros(len(g.frame))
    begin, end = light[..., :-step:step, None], light[..., step::step, None]
    lines = ((1.0 - part) * begin + part * end).reshape(*light.shape[:-1], -1)
    off, total = (np.abs(v).sum(axis=-1) for v in (light[..., :-1] - lines, light[..., :-1]))
    counts = (total > 0.0) & which
    return np.max(np.divide(off, total, out=np.zeros_like(off), where=counts), axis=0)
