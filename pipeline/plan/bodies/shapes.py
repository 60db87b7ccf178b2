"""Light that simple shapes and light curves send: thousands of bodies worked out together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.physics.constants import DEG_RAD
from pipeline.physics.targets.attitude import in_body_axes
from pipeline.physics.targets.frustum import frustum_area_function
from pipeline.physics.targets.plate import box_area_function, plate_area_function
from pipeline.physics.targets.sphere import sphere_area_function
from pipeline.physics.vectors import separation
from pipeline.plan.bodies.albedos import albedo_of
from pipeline.plan.bodies.attitudes import UPRIGHT, View, attitudes, since_s
from pipeline.spec.targets.body import (
    Attitude,
    Body,
    BoxBody,
    CompositeBody,
    ConeBody,
    CubeBody,
    CylinderBody,
    FrustumBody,
    LightCurveBody,
    Part,
    PlateBody,
    SphereBody,
)

Array = NDArray[np.float64]

CHUNK = 8192  # samples worked on at a time: their arrays stay in the cache


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
    out = shapes_m2_sr(bodies, epoch, view, names)
    for i in curves:
        row = view.of(np.array([i]))
        out[i] = light_curve_m2_sr(bodies[i], epoch, row.time_s[0], row.phase_rad[0], names[i])  # type: ignore[arg-type]
    return out


def shapes_m2_sr(
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
    attitude = attitudes([p.law for p in pieces], epoch, view, [p.field for p in pieces])
    sun, observer = in_body_axes(attitude, light), in_body_axes(attitude, view.observer)
    if shape == "plate":
        return plate_area_function(sun, observer, sizes[..., 0], sizes[..., 1] > 0.0)
    if shape == "box":
        return box_area_function(sun, observer, sizes)
    return frustum_area_function(sun, observer, *np.moveaxis(sizes, -1, 0))


def light_curve_m2_sr(
    body: LightCurveBody,
    epoch: tuple[float, float],
    time_s: Array,
    phase_rad: Array,
    field: str = "body",
) -> Array:
    """Intensity over solar irradiance (n,) [m2/sr] of a tabulated light curve.

    I/E = range^2 10^(-0.4 (m - m_sun)), the distance of the Sun's light taken to 1 au; linear
    between the table's values in the unit they are given in, and from its last one to the first of
    the next period: a jump where the period is its span. BadInput where it does not cover the times
    and has no period.
    """
    times = np.array(body.times_s)
    values = np.array(body.magnitudes if body.magnitudes is not None else body.intensities_m2_sr)
    at = time_s + since_s(body.epoch, epoch, field)
    if body.period_s is not None:
        at = times[0] + np.mod(at - times[0], body.period_s)
        times, values = np.append(times, times[0] + body.period_s), np.append(values, values[0])
    elif at.size and not (times[0] <= at.min() and at.max() <= times[-1]):
        raise BadInput(
            f"{field}.times_s",
            f"{times[0]:g} to {times[-1]:g}",
            f"a table that covers the exposures, {at.min():.6g} to {at.max():.6g} s, or a period_s",
        )
    value = np.interp(at, times, values)
    if body.magnitudes is not None:
        value = body.range_m**2 * 10.0 ** (-0.4 * (value - body.sun_mag))
    reference = body.phase_deg * DEG_RAD
    if body.phase_law == "lambert":
        value = value * sphere_area_function(phase_rad, 2.0) / sphere_area_function(reference, 2.0)
    elif body.phase_law == "linear":
        value = value * 10.0 ** (-0.4 * body.mag_per_deg / DEG_RAD * (phase_rad - reference))
    return np.asarray(value)
