"""From bodies and where they stand to the light they send: intensity per solar irradiance."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.errors import BadInput
from pipeline.physics.constants import DEG_RAD
from pipeline.physics.positions.times import elapsed_s, parse_utc
from pipeline.physics.radiometry import ResponseCurve
from pipeline.physics.targets.eclipse import sunlit_fraction
from pipeline.physics.targets.lighting import (
    phase_angle,
    photon_rate_at_aperture,
    sun_distance,
)
from pipeline.physics.targets.sphere import (
    sphere_area_function,
    sphere_intensity_per_irradiance,
)
from pipeline.physics.vectors import separation
from pipeline.spec.body import (
    Attitude,
    Body,
    BoxBody,
    CompositeBody,
    ConeBody,
    CubeBody,
    CylinderBody,
    FrustumBody,
    InertialAttitude,
    LightCurveBody,
    Lighting,
    Part,
    PlateBody,
    SphereBody,
)
from pipeline.spec.mesh import MeshBody
from pipeline.spec.scene import Scene, Target

Array = NDArray[np.float64]

CHUNK = 8192  # samples worked on at a time: their arrays stay in the cache
UPRIGHT = InertialAttitude(kind="inertial")


@dataclass(frozen=True)
class View:
    """What T bodies are lit from and seen from at n moments each, GCRS axes.

    time_s : (T, n) seconds after the scene's epoch, when the light left the body
    place_m, velocity_m_s : (T, n, 3) geocentric, at that time
    sun_m, observer_m : (T, n, 3) geocentric; the Sun's apparent place
    """

    time_s: Array
    place_m: Array
    velocity_m_s: Array
    sun_m: Array
    observer_m: Array

    def of(self, index: NDArray[np.int64]) -> View:
        """Rows of it."""
        return View(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    @cached_property
    def sun(self) -> Array:
        """Directions (T, n, 3) to the Sun."""
        return _directions(self.sun_m - self.place_m)

    @cached_property
    def observer(self) -> Array:
        """Directions (T, n, 3) to the observer."""
        return _directions(self.observer_m - self.place_m)

    @property
    def phase_rad(self) -> Array:
        """Angles Sun - body - observer (T, n)."""
        return separation(self.sun_m - self.place_m, self.observer_m - self.place_m)


def _directions(vectors: Array) -> Array:
    """`unit` of vectors none of which is zero, quicker."""
    return np.asarray(vectors / np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None])


def target_light(
    target: Target,
    field: str,
    epoch: tuple[float, float],
    view: View,
    sun_from_earth_m: Array,
    tt: tuple[Array, Array],
    range_m: Array,
) -> tuple[Array, Array, Array]:
    """Irradiance at the observer over that of the Sun at 1 au, phase [rad], sunlit share: (n,).

    field : the target's place in the scene, for messages; epoch : the scene's, UTC
    view : T = 1; sun_from_earth_m : (n, 3) geometric, for the distance
    tt : two-part Julian dates (n,), for the Moon
    """
    place, apparent_sun = view.place_m[0], view.sun_m[0]
    lighting, body = target.lighting, target.body
    alpha = phase_angle(place, apparent_sun, view.observer_m[0])
    lit = np.ones(len(place))
    if target.eclipse:
        lit = _sunlit(lighting, place, apparent_sun, tt)
    if isinstance(body, SphereBody):
        reflected = sphere_intensity_per_irradiance(alpha, body.diameter_m, albedo_of(body, field))
    elif isinstance(body, MeshBody):
        from pipeline.plan.meshes import mesh_m2_sr  # only scenes with meshes need it

        reflected = mesh_m2_sr(body, epoch, view, field)
    else:
        reflected = reflected_m2_sr([body], epoch, view, [field])[0]
    distance = sun_distance(place, sun_from_earth_m)
    light = photon_rate_at_aperture(1.0, distance, lit, reflected, range_m)
    if lighting is not None and lighting.earthshine_albedo is not None:
        extra = earthshine_m2_sr(body, epoch, view, lighting.earthshine_albedo, field)
        at_earth = np.sqrt(np.sum(np.square(sun_from_earth_m), axis=-1))
        light = light + photon_rate_at_aperture(1.0, at_earth, 1.0, extra, range_m)
    return light, alpha, lit


def _sunlit(lighting: Lighting | None, place: Array, sun: Array, tt: tuple[Array, Array]) -> Array:
    """Share (n,) of sunlight that reaches a target past Earth and Moon."""
    wish = lighting or Lighting()
    if not (wish.oblate_earth or wish.limb_darkening or wish.moon):
        return sunlit_fraction(place, sun)
    from pipeline.physics.targets.shadow import moon_m, sunlit_past_earth, sunlit_past_moon

    if wish.oblate_earth or wish.limb_darkening:
        lit = sunlit_past_earth(place, sun, wish.limb_darkening, wish.oblate_earth)
    else:
        lit = sunlit_fraction(place, sun)
    if wish.moon:
        # where both stand before the Sun their shadows are taken one after the other
        lit = lit * sunlit_past_moon(place, sun, moon_m(*tt), wish.limb_darkening)
    return lit


def earthshine_m2_sr(
    body: Body | MeshBody,
    epoch: tuple[float, float],
    view: View,
    albedo: float,
    field: str = "body",
) -> Array:
    """Intensity (n,) of one body in earthshine over the solar irradiance at the Earth [m2/sr]."""
    from pipeline.physics.targets.earthshine import earth_lamps

    place = view.place_m[0]
    directions, light = earth_lamps(place, view.sun_m[0], albedo)
    if isinstance(body, LightCurveBody | MeshBody):
        raise BadInput(f"{field}.kind", body.kind, "earthshine on a body of simple shapes")
    n, k = light.shape
    towards = directions.reshape(1, -1, 3)

    def each(values: Array) -> Array:
        return np.repeat(values[0], k, axis=0)[None]

    lamps = View(
        each(view.time_s), each(view.place_m), each(view.velocity_m_s), each(view.sun_m),
        each(view.observer_m),
    )  # fmt: skip
    return np.sum(_shapes_m2_sr([body], epoch, lamps, [field], towards).reshape(n, k) * light, -1)


def reflected_m2_sr(
    bodies: Sequence[Body],
    epoch: tuple[float, float],
    view: View,
    fields: Sequence[str] | None = None,
) -> Array:
    """Radiant intensity over solar irradiance (T, n) [m2/sr] of T bodies; eclipses not counted.

    Parts that are alike in shape and law are worked out together, so that thousands of bodies cost
    little more than their arithmetic. Albedos are numbers by now (`with_band_albedos`).
    """
    names = fields or [f"targets.{i}.body" for i in range(len(bodies))]
    curves = [i for i, b in enumerate(bodies) if isinstance(b, LightCurveBody)]
    out = _shapes_m2_sr(bodies, epoch, view, names)
    for i in curves:
        row = view.of(np.array([i]))
        out[i] = light_curve_m2_sr(bodies[i], epoch, row.time_s[0], row.phase_rad[0], names[i])  # type: ignore[arg-type]
    return out


def _shapes_m2_sr(
    bodies: Sequence[Body],
    epoch: tuple[float, float],
    view: View,
    fields: Sequence[str],
    lamps: Array | None = None,
) -> Array:
    """The same of bodies with shapes (0 of others); `lamps` (T, n, 3) stand for the Sun's light.

    Attitudes follow the Sun itself.
    """
    groups: dict[tuple[str, str, str], list[_Piece]] = defaultdict(list)
    for i, body in enumerate(bodies):
        if not isinstance(body, LightCurveBody):
            for piece in _pieces(i, body, fields[i]):
                groups[piece.key].append(piece)
    out = np.zeros(view.time_s.shape)
    step = max(1, CHUNK // max(1, view.time_s.shape[1]))
    for (shape, _, _), pieces in groups.items():
        for first in range(0, len(pieces), step):
            some = pieces[first : first + step]
            index = np.array([p.body for p in some])
            rows = view.of(index)
            light = rows.sun if lamps is None else lamps[index]
            area = _area(shape, some, epoch, rows, light)
            albedo = np.array([p.albedo for p in some])[:, None]
            np.add.at(out, index, albedo / np.pi * area)
    return out


@dataclass(frozen=True)
class _Piece:
    """One part: the body it belongs to, its shape's numbers, its albedo and its law."""

    body: int
    shape: str
    sizes: tuple[float, ...]
    albedo: float
    law: Attitude
    field: str

    @property
    def key(self) -> tuple[str, str, str]:
        return self.shape, self.law.kind, getattr(self.law, "bus", "")


def _pieces(index: int, body: Part | CompositeBody, field: str) -> list[_Piece]:
    parts: Sequence[Part]
    if isinstance(body, CompositeBody):
        parts, common = body.parts, body.attitude
        places = [f"{field}.parts.{k}" for k in range(len(parts))]
    else:
        parts, common, places = (body,), None, [field]
    out = []
    for part, place in zip(parts, places, strict=True):
        law: Attitude = UPRIGHT
        if not isinstance(part, SphereBody):
            law = part.attitude or common or UPRIGHT
        shape, sizes = _sizes(part)
        out.append(_Piece(index, shape, sizes, albedo_of(part, place), law, place))
    return out


def _sizes(part: Part) -> tuple[str, tuple[float, ...]]:
    """A part's shape by the name of its area function, and the numbers that it takes."""
    if isinstance(part, SphereBody):
        return "sphere", (part.diameter_m,)
    if isinstance(part, PlateBody):
        return "plate", (part.area_m2, float(part.two_sided))
    if isinstance(part, BoxBody):
        return "box", part.size_m
    if isinstance(part, CubeBody):
        return "box", (part.edge_m, part.edge_m, part.edge_m)
    base, top = float(part.closed in ("both", "base")), float(part.closed in ("both", "top"))
    if isinstance(part, CylinderBody):
        radius = 0.5 * part.diameter_m
        return "frustum", (radius, radius, part.length_m, base, top)
    if isinstance(part, ConeBody):
        return "frustum", (0.5 * part.diameter_m, 0.0, part.length_m, base, 0.0)
    assert isinstance(part, FrustumBody)
    radii = (0.5 * part.base_diameter_m, 0.5 * part.top_diameter_m)
    return "frustum", (*radii, part.length_m, base, top)


def _area(
    shape: str, pieces: list[_Piece], epoch: tuple[float, float], view: View, light: Array
) -> Array:
    """Area functions (P, n) [m2] of parts of one shape under one law, each with its row of view."""
    sizes = np.array([p.sizes for p in pieces])[:, None, :]
    if shape == "sphere":
        return sphere_area_function(separation(light, view.observer), sizes[..., 0])
    from pipeline.physics.targets.attitude import in_body_axes

    attitude = attitudes([p.law for p in pieces], epoch, view, [p.field for p in pieces])
    sun, observer = in_body_axes(attitude, light), in_body_axes(attitude, view.observer)
    if shape == "plate":
        from pipeline.physics.targets.plate import plate_area_function

        return plate_area_function(sun, observer, sizes[..., 0], sizes[..., 1] > 0.0)
    if shape == "box":
        from pipeline.physics.targets.plate import box_area_function

        return box_area_function(sun, observer, sizes)
    from pipeline.physics.targets.frustum import frustum_area_function

    return frustum_area_function(sun, observer, *np.moveaxis(sizes, -1, 0))


def attitudes(
    laws: Sequence[Any], epoch: tuple[float, float], view: View, fields: Sequence[str]
) -> Array:
    """Attitudes (P, n, 3, 3) or (P, 1, 3, 3) of P parts under laws of one kind (and one bus)."""
    from pipeline.physics.targets import attitude as at

    kind = laws[0].kind
    mount = at.quaternion_matrices(np.array([law.quaternion for law in laws]))[:, None]
    if kind == "inertial":
        return mount
    if kind == "spin":
        axis, rate, phase, after = (
            np.array(v)
            for v in (
                [law.axis for law in laws],
                [[law.rate_deg_s] for law in laws],
                [[law.phase_deg] for law in laws],
                [[_since(law.epoch, epoch, f)] for law, f in zip(laws, fields, strict=True)],
            )
        )
        turned = np.fmod(rate * (view.time_s + after), 360.0) + phase
        return at.spin_attitude(mount, axis[:, None], turned * DEG_RAD)
    if kind == "table":
        each = []
        for law, times, field in zip(laws, view.time_s, fields, strict=True):
            moments = times + _since(law.epoch, epoch, field)
            name = f"{field}.attitude"
            each.append(at.table_attitude(law.times_s, law.quaternions, moments, name))
        return np.stack(each) @ mount
    frame = {
        "sun": lambda: at.sun_attitude(view.sun, view.place_m, view.velocity_m_s),
        "nadir": lambda: at.nadir_attitude(view.place_m, view.velocity_m_s),
        "velocity": lambda: at.velocity_attitude(view.place_m, view.velocity_m_s),
        "inertial": lambda: np.eye(3),
    }
    if kind != "sun_tracking":
        return frame[kind]() @ mount
    bus = frame[laws[0].bus]() @ mount
    return at.tracking_attitude(bus, np.array([law.axis for law in laws])[:, None], view.sun)


def _since(own: str | None, epoch: tuple[float, float], field: str) -> float:
    """Seconds from a law's own epoch to the scene's; 0 where it has none."""
    if own is None:
        return 0.0
    return float(elapsed_s(parse_utc(own, f"{field}.epoch"), *epoch))


def light_curve_m2_sr(
    body: LightCurveBody,
    epoch: tuple[float, float],
    time_s: Array,
    phase_rad: Array,
    field: str = "body",
) -> Array:
    """Intensity over solar irradiance (n,) [m2/sr] of a tabulated light curve.

    I/E = range^2 10^(-0.4 (m - m_sun)), the distance of the Sun's light taken to 1 au; linear
    between the table's values in the unit they are given in. BadInput where it does not cover the
    times and has no period.
    """
    times = np.array(body.times_s)
    at = time_s + _since(body.epoch, epoch, field)
    if body.period_s is not None:
        at = times[0] + np.mod(at - times[0], body.period_s)
    elif at.size and not (times[0] <= at.min() and at.max() <= times[-1]):
        raise BadInput(
            f"{field}.times_s", f"{times[0]:g} to {times[-1]:g}",
            f"a table that covers the exposures, {at.min():.6g} to {at.max():.6g} s, or a period_s",
        )  # fmt: skip
    values = np.array(body.magnitudes if body.magnitudes is not None else body.intensities_m2_sr)
    value = np.interp(at, times, values, period=body.period_s)
    if body.magnitudes is not None:
        value = body.range_m**2 * 10.0 ** (-0.4 * (value - body.sun_mag))
    reference = body.phase_deg * DEG_RAD
    if body.phase_law == "lambert":
        value = value * sphere_area_function(phase_rad, 2.0) / sphere_area_function(reference, 2.0)
    elif body.phase_law == "linear":
        value = value * 10.0 ** (-0.4 * body.mag_per_deg / DEG_RAD * (phase_rad - reference))
    return np.asarray(value)


def needs_velocity(body: Body | MeshBody) -> bool:
    """True where a law of the body follows the orbit's motion."""
    if isinstance(body, LightCurveBody | SphereBody):
        return False
    parts: Sequence[Any] = (body,)
    laws = [body.attitude]
    if isinstance(body, CompositeBody):
        parts = body.parts
    laws += [getattr(part, "attitude", None) for part in parts]
    wanted = {law.kind if law.kind != "sun_tracking" else law.bus for law in laws if law}
    return bool(wanted & {"sun", "nadir", "velocity"})


def albedo_of(part: Part, field: str) -> float:
    """A part's albedo as a number. BadInput where a table has not met its band yet."""
    if isinstance(part.albedo, tuple):
        raise BadInput(f"{field}.albedo", "a table", "a number here: see with_band_albedos")
    return part.albedo


def with_band_albedos(
    scene: Scene, sun_wavelength_m: Array, sun_irradiance_w_m3: Array, response: ResponseCurve
) -> Scene:
    """The scene with each table of reflectance replaced by its mean over the sensor's band.

    The same scene where there is none. BadInput where a table does not cover the band.
    """
    from pipeline.physics.targets.reflectance import band_reflectance

    sun = (sun_wavelength_m, sun_irradiance_w_m3, response)

    def grey(part: Any, field: str) -> Any:
        if not isinstance(getattr(part, "albedo", None), tuple):
            return part
        mean = band_reflectance(part.albedo, *sun, f"{field}.albedo")
        return part.model_copy(update={"albedo": mean})

    targets = []
    for i, target in enumerate(scene.targets):
        body, field = target.body, f"targets.{i}.body"
        if isinstance(body, CompositeBody):
            parts = tuple(grey(p, f"{field}.parts.{k}") for k, p in enumerate(body.parts))
            same = all(a is b for a, b in zip(parts, body.parts, strict=True))
            made: Any = body if same else body.model_copy(update={"parts": parts})
        else:
            made = grey(body, field)
        targets.append(target if made is body else target.model_copy(update={"body": made}))
    if all(a is b for a, b in zip(targets, scene.targets, strict=True)):
        return scene
    return scene.model_copy(update={"targets": tuple(targets)})


def has_band_albedos(scene: Scene) -> bool:
    """True where a body of the scene has a table of reflectance."""
    return any(
        isinstance(getattr(part, "albedo", None), tuple)
        for target in scene.targets
        for part in getattr(target.body, "parts", (target.body,))
    )


def flicker_share(g: Geometry) -> float:
    """The worst of `flicker_shares`."""
    return float(flicker_shares(g).max(initial=0.0))


def flicker_shares(g: Geometry) -> Array:
    """How far the light between nodes may be off (F,), as a share of a target's in its exposure.

    The light of an exposure is the trapezium rule over the nodes, the light of an interval the mean
    of its ends. Rules of K and K/2 intervals are compared: for smooth light the finer one errs
    by a third of what they differ, for kinks and steps (a face that turns to the Sun, the edge of
    the shadow) by at most about as much as they differ, which is returned: the worst target's.
    """
    light = g.target_light
    if not light.size:
        return np.zeros(len(g.frame))
    fine = 0.5 * (light[..., :-1] + light[..., 1:])
    pairs = fine[..., 0::2] + fine[..., 1::2]
    coarse = light[..., :-2:2] + light[..., 2::2]
    total = fine.sum(axis=-1)
    off = np.abs(pairs - coarse).sum(axis=-1)
    return np.max(np.divide(off, total, out=np.zeros_like(off), where=total > 0.0), axis=0)
