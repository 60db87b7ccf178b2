"""The air above a site in the plan: zenith, refraction, and what of the light comes down."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.errors import BadInput
from pipeline.physics.motion.pointing import proper_attitude
from pipeline.physics.positions.focal_plane import Camera, deproject
from pipeline.physics.positions.refraction import (
    refract,
    refraction_terms,
    squeeze,
    standard_air,
    unrefract,
)
from pipeline.physics.positions.times import Instants
from pipeline.plan.pointing.site import axes_of
from pipeline.plan.timing import simpson
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.sky.atmosphere import Refraction

if TYPE_CHECKING:
    from pipeline.physics.sky.extinction import BandExtinction

Array = NDArray[np.float64]

USUAL_WAVELENGTH_M = 550e-9  # where the scene's own is not worked out yet
MOST_WEATHER = 0.1  # by which pressure differs from the standard atmosphere's: extremes of records
SAME_MEAN = 1e-6  # of stars' light: two means over an exposure that are one
LOWEST_REFRACTED_DEG = 3.0  # below, the law of refraction is not known


def needs_air(scene: Scene) -> bool:
    """Whether anything in a scene depends on the zenith of its site."""
    o, b = scene.observer, scene.background
    return isinstance(o, GroundObserver) and (
        o.atmosphere is not None or (b is not None and b.of_the_air)
    )


def air_of(scene: Scene, times: Instants) -> Array | None:
    """Zenith and refraction's terms (n, 5) at instants; None where a scene needs neither.

    The zenith is the normal of the ellipsoid at the site: deflections of the vertical (up to an
    arcminute in mountains) are omitted.
    """
    o = scene.observer
    if not needs_air(scene):
        return None
    assert isinstance(o, GroundObserver)
    zenith = axes_of(o, times)[:, 2]
    terms = terms_of(scene)
    return np.concatenate([zenith, np.broadcast_to(terms, (len(zenith), 2))], axis=1)


def terms_of(scene: Scene) -> tuple[float, float]:
    """A and B [rad] of a scene's refraction; zeros without."""
    request = _refraction(scene)
    if request is None:
        return 0.0, 0.0
    wavelength = (
        USUAL_WAVELENGTH_M if request.wavelength_nm is None else request.wavelength_nm * 1e-9
    )
    return refraction_terms(*weather_of(scene), wavelength)


def weather_of(scene: Scene) -> tuple[float, float, float]:
    """Pressure [hPa], temperature [C] and humidity of a scene with refraction."""
    o, request = scene.observer, _refraction(scene)
    assert isinstance(o, GroundObserver)
    assert request is not None
    pressure, temperature = standard_air(o.height_m)
    return (
        pressure if request.pressure_hpa is None else request.pressure_hpa,
        temperature if request.temperature_c is None else request.temperature_c,
        request.humidity,
    )


def weather_remarks(scene: Scene) -> list[str]:
    """What is said of a pressure that is hardly that of the site."""
    o = scene.observer
    request = _refraction(scene) if isinstance(o, GroundObserver) else None
    if request is None or not isinstance(o, GroundObserver):
        return []
    usual = standard_air(o.height_m)[0]
    given = usual if request.pressure_hpa is None else request.pressure_hpa
    if abs(given - usual) <= MOST_WEATHER * usual:
        return []
    return [
        f"observer.atmosphere.refraction.pressure_hpa: {given:g} hPa is {given / usual:.2f} times "
        f"what the standard atmosphere has at {o.height_m:g} m, and so is refraction: it is the "
        "pressure at the site, not that reduced to sea level"
    ]


def _refraction(scene: Scene) -> Refraction | None:
    o = scene.observer
    assert isinstance(o, GroundObserver)
    request = o.atmosphere.refraction if o.atmosphere is not None else None
    return request if isinstance(request, Refraction) else None


def lifted(attitude: Array, air: Array) -> Array:
    """Attitudes (n, 3, 3) that look where refraction puts what a pointing names: before, alike."""
    if not air[:, 3].any():
        return attitude
    return proper_attitude(attitude, refract(attitude[:, 2], air))


def check_height(camera: Camera, attitude: Array, air: Array) -> None:
    """BadInput where a part of the frame looks below the horizon, or so low that refraction is not
    known; attitude : (n, 3, 3) observed."""
    lowest = float(np.min(frame_sines(camera, attitude, air[:, :3])))
    height_deg = float(np.degrees(np.arcsin(lowest)))
    least = LOWEST_REFRACTED_DEG if air[:, 3].any() else 0.0
    if height_deg < least:
        why = "where refraction is known" if least else "above the horizon"
        raise BadInput(
            "pointing",
            f"a frame that goes down to {height_deg:.2f} deg of elevation",
            f"{least:g} degrees or more in all of the frame and all exposures, {why}",
        )


def frame_sines(camera: Camera, attitude: Array, zenith: Array) -> Array:
    """Sines of the elevation (n, 9) of a frame's corners, middles of its edges, and middle."""
    places = frame_places(camera)
    u = np.stack([deproject(camera, a, *places) for a in attitude])
    return np.clip(np.einsum("nki,ni->nk", u, zenith), -1.0, 1.0)


def frame_places(camera: Camera) -> tuple[Array, Array]:
    """Pixels x, y (9,) of a frame's corners, middles of its edges, and middle."""
    x, y = np.meshgrid(
        np.array([-0.5, 0.5 * (camera.columns - 1), camera.columns - 0.5]),
        np.array([-0.5, 0.5 * (camera.rows - 1), camera.rows - 0.5]),
    )
    return x.ravel(), y.ravel()


def above_air(g: Geometry, centres: Array, radii_rad: Array) -> tuple[Array, Array]:
    """Cones (n, 3), (n,) of the true sky that hold what is seen in cones at mid-exposure."""
    if not g.has_air:
        return centres, radii_rad
    air = g.air[:, g.middle]
    sine = np.sum(centres * air[:, :3], axis=-1)
    low = np.arcsin(np.clip(sine, -1.0, 1.0)) - radii_rad
    radii = np.minimum(radii_rad * squeeze(np.sin(np.maximum(low, 0.0)), air), np.pi)
    return unrefract(centres, air), radii


def star_transmission(
    extinction: BandExtinction, camera: Camera, g: Geometry, observed: Array
) -> Array:
    """Share (n,) of stars' light that comes down in the one frame of `g`: mean of an exposure.

    observed : (n, 3) at mid-exposure. Simpson's rule over its start, middle and end, or over all
    nodes where that is another mean, to SAME_MEAN, anywhere around the frame.
    """
    zenith = g.air[0, :, :3]
    u = deproject(camera, g.attitude[0, g.middle], *frame_places(camera))
    few, all_nodes = (
        _mean(lambda k: extinction.transmission(u @ zenith[k]), g.nodes, moments)
        for moments in (3, g.nodes)
    )
    moments = 3 if (np.abs(few - all_nodes) <= SAME_MEAN * all_nodes).all() else g.nodes
    return _mean(lambda k: extinction.transmission(observed @ zenith[k]), g.nodes, moments)


def _mean(value: Callable[[int], Array], nodes: int, moments: int) -> Array:
    """The mean of what is known at the nodes of an exposure, by Simpson's rule over some."""
    weights, whole = simpson(moments, nodes)
    return np.asarray(sum(w * value(k) for k, w in weights.items()) / whole)


def path_transmission(
    extinction: BandExtinction, camera: Camera, g: Geometry, x_px: Array, y_px: Array
) -> Array:
    """Share (K,) of a target's light that comes down at each node of the one frame of `g`.

    Under TDI a place moves with the charge; the light falls through the air of where it comes from.
    """
    y_px = y_px + camera.charge_px_s * (g.offset_s[0] - g.offset_s[0, g.middle])
    u = np.concatenate(
        [deproject(camera, a, x_px[[k]], y_px[[k]]) for k, a in enumerate(g.attitude[0])]
    )
    return extinction.transmission(np.sum(u * g.air[0, :, :3], axis=-1))
