"""The light of a sky as a function of place and time: what its grids are made from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Geometry
from pipeline.errors import BadInput
from pipeline.physics.constants import ASTRONOMICAL_UNIT_M, DEG_RAD, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.apparent import unaberrate
from pipeline.physics.positions.focal_plane import Camera, deproject, solid_angle_sr
from pipeline.physics.positions.refraction import unrefract
from pipeline.physics.sky import zodiacal as z
from pipeline.physics.sky.galactic import diffuse_light
from pipeline.physics.sky.smooth import smooth
from pipeline.physics.sky.starlight import band_light
from pipeline.plan.facts import Facts
from pipeline.plan.optics.pupil import pupil_fraction
from pipeline.plan.sky.inputs import SkyInputs, StarlightLike
from pipeline.plan.timing import simpson
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.sky.background import Background, Galactic, Zodiacal

if TYPE_CHECKING:
    from pipeline.spec.sky.stray_light import StrayLight

Array = NDArray[np.float64]

ALL_G_MAG = -99.0  # brighter than any star
MOVED = 1e-5  # radians by which a boresight turns in an exposure before its ends are looked at too


@dataclass(frozen=True)
class LightOfSky:
    """The light of a sky as a function of place: what the grids are made from.

    Each part is light per solid angle in a direction, which `pixel_m2_sr` turns into a pixel's;
    light that comes as a rate of each pixel (`per_pixel`) is added to it.
    limit_g_mag : stars beyond it are left to the sky; None while that is not known: no star is
    moments : of an exposure, over which the mean is taken; 3 at least where the camera turns or
        the charge moves
    """

    scene: Scene
    camera: Camera
    facts: Facts
    inputs: SkyInputs
    limit_g_mag: float | None
    dut1_s: float = 0.0
    moments: int = 1

    def at(self, g: Geometry) -> Callable[[Array, Array], Array]:
        """Light (F, n) [e-/s and pixel] of the frames of a geometry, at x, y (n,) [px]."""
        return lambda x, y: np.stack([self._frame(g, f, x, y) for f in range(len(g.frame))])

    def _frame(self, g: Geometry, f: int, x: Array, y: Array) -> Array:
        """The mean over an exposure: its middle, or Simpson's rule over more moments."""
        turned = np.abs(g.attitude[f, 0, 2] - g.attitude[f, -1, 2]).max()
        moves = turned > MOVED or self.camera.charge_px_s != 0.0
        moments = max(3, self.moments) if moves else self.moments
        weights, whole = simpson(moments, g.nodes)
        nodes = {k: w / whole for k, w in weights.items()}
        at = {k: self._charge_y(g, f, k, y) for k in nodes}
        light = np.zeros(len(x))
        if self.camera.charge_px_s:
            for k, w in nodes.items():
                share = w * self.pixel_m2_sr(x, at[k])
                light = light + share * sum(self.parts(g, f, k, x, at[k]).values())
        else:  # one pupil and solid angle for all moments
            total = sum(w * sum(self.parts(g, f, k, x, y).values()) for k, w in nodes.items())
            light = total * self.pixel_m2_sr(x, y)
        for k, w in nodes.items():
            light = light + w * sum(self.per_pixel(g, f, k, x, at[k]).values())
        return light

    def _charge_y(self, g: Geometry, f: int, node: int, y: Array) -> Array:
        """Where the charge of pixels y (n,) stands at a node: under TDI it takes even steps along
        as much of its way as is on the array."""
        way = self.camera.charge_px_s * (g.offset_s[f] - g.offset_s[f, g.middle])
        first, last = (np.clip(y + w, -0.5, self.camera.rows - 0.5) for w in way[[0, -1]])
        return np.asarray(first + node / (g.nodes - 1) * (last - first))

    @property
    def even(self) -> bool:
        """Whether its middle is the mean of an exposure: a uniform sky on charge that stands."""
        return self.still and not self.camera.charge_px_s

    @property
    def still(self) -> bool:
        """Whether it is the same in all frames: a uniform sky alone."""
        return not background_of(self.scene).varies and self.inputs.undrawn is None

    def parts(self, g: Geometry, f: int, node: int, x: Array, y: Array) -> dict[str, Array]:
        """Each part's electrons/s per m2 of pupil and sr (n,) at x, y (n,) [px]."""
        return self.towards(g, f, node, deproject(self.camera, g.attitude[f, node], x, y))

    def towards(self, g: Geometry, f: int, node: int, observed: Array) -> dict[str, Array]:
        """Each part's electrons/s per m2 of pupil and sr (n,) from directions (n, 3), as the camera
        sees them."""
        out = {"none": np.zeros(len(observed))}
        if not self.still:
            out |= self._directed(g, f, node, observed)
        if self.inputs.uniform_m2_sr is not None:  # as it reaches the site: below the air
            out["uniform"] = np.full(len(observed), self.inputs.uniform_m2_sr)
        return out

    def _directed(self, g: Geometry, f: int, node: int, observed: Array) -> dict[str, Array]:
        """The parts that follow from where it comes from."""
        u = self.natural(g, f, node, observed)
        out: dict[str, Array] = {}
        if self.inputs.zodiacal is not None:
            out["zodiacal"] = self._zodiacal(u, g.sun_m[f, node] - g.observer_m[f, node])
        galactic = background_of(self.scene).galactic
        if self.inputs.every is not None and isinstance(galactic, Galactic):
            stars = self._stars(self.inputs.every, ALL_G_MAG, u)
            out["galactic"] = diffuse_light(stars, galactic.share)
        undrawn, limit = self.inputs.undrawn, self.limit_g_mag
        wanted = background_of(self.scene).starlight != "none"
        if wanted and undrawn is not None and limit is not None:
            out["starlight"] = self._stars(undrawn, limit, u)
        if not g.has_air:
            return out
        from pipeline.plan.sky.night import dimmed, night_parts

        out = dimmed(self.scene, self.inputs.extinction, g.air[f, node], observed, out)
        return out | night_parts(self.scene, self.inputs, g, f, node, observed)

    def per_pixel(self, g: Geometry, f: int, node: int, x: Array, y: Array) -> dict[str, Array]:
        """Each part that is a pixel's own rate (n,) [e-/s]: as given, and stray light."""
        out = {"none": np.zeros(len(x))}
        if self.inputs.uniform_e_s is not None:
            out["uniform"] = np.full(len(x), self.inputs.uniform_e_s)
        if self.inputs.stray is not None:
            out |= self.stray(g, f, node, x, y)
        return out

    def stray(self, g: Geometry, f: int, node: int, x: Array, y: Array) -> dict[str, Array]:
        """Each body's stray light (n,) [e-/s and pixel]."""
        request = background_of(self.scene).stray_light
        assert request is not None

        def parts(request: StrayLight, x: Array, y: Array) -> dict[str, Array]:
            return self.scattered(request, g, f, node, self.directions(g, f, node, x, y))

        lamps = request.model_copy(update={"earth": False})
        out = parts(lamps, x, y)
        if request.earth and not isinstance(self.scene.observer, GroundObserver):
            earth = request.model_copy(update={"sun": False, "moon": False})
            rows, columns = self.camera.rows, self.camera.columns
            out["earth"] = smooth(lambda x, y: parts(earth, x, y)["earth"], rows, columns, x, y)
        return out

    def scattered(
        self,
        request: StrayLight,
        g: Geometry,
        f: int,
        node: int,
        u: Array,
        checked: bool = True,
    ) -> dict[str, Array]:
        """The same along lines of sight (n, 3), as `stray_parts` has it."""
        from pipeline.plan.sky.stray_light import stray_parts

        assert self.inputs.stray is not None
        inputs, air = self.inputs.stray, self.inputs.extinction
        return stray_parts(self.scene, request, inputs, g, f, node, u, self.dut1_s, air, checked)

    def directions(self, g: Geometry, f: int, node: int, x: Array, y: Array) -> Array:
        """Unit vectors (n, 3) of the sky before refraction and aberration, of places x, y (n,)."""
        return self.natural(g, f, node, deproject(self.camera, g.attitude[f, node], x, y))

    def natural(self, g: Geometry, f: int, node: int, observed: Array) -> Array:
        """Directions (n, 3) before refraction and aberration of observed ones (n, 3)."""
        seen = unrefract(observed, g.air_at(f, node))
        if not self.scene.star_effects["aberration"]:
            return seen
        return unaberrate(seen, g.observer_m_s[f, node] / SPEED_OF_LIGHT_M_S)

    def _zodiacal(self, u: Array, sun_m: Array) -> Array:
        assert self.inputs.zodiacal is not None
        distance = float(np.sqrt(sun_m @ sun_m)) / ASTRONOMICAL_UNIT_M
        if not z.LEAST_AU <= distance <= z.MOST_AU:
            raise BadInput(
                "observer",
                f"{distance:.3g} au from the Sun",
                f"{z.LEAST_AU:g} to {z.MOST_AU:g} au for zodiacal light, whose fall with distance "
                "is known there (or leave background.zodiacal out)",
            )
        off_plane = z.off_plane_rad(sun_m)
        if off_plane > z.MOST_OFF_PLANE_RAD:
            raise BadInput(
                "observer",
                f"{off_plane / DEG_RAD:.3g} deg off the ecliptic, as seen from the Sun",
                f"up to {z.MOST_OFF_PLANE_RAD / DEG_RAD:g} degrees for zodiacal light, whose dust "
                "was measured from within its plane (or leave background.zodiacal out)",
            )
        lon, lat, elongation = z.sun_coordinates(u, sun_m)
        _check_elongation(float(elongation.min()), background_of(self.scene).zodiacal)
        radiance = z.radiance_500(self.inputs.zodiacal, lon, lat) * z.distance_factor(distance)
        return z.band_radiance(radiance, elongation, self.inputs.zodiacal_rates)

    def _stars(self, source: StarlightLike, limit_g_mag: float, u: Array) -> Array:
        assert self.inputs.fit is not None
        found = source.fainter(limit_g_mag, u)
        moments = (found.g, found.g_colour, found.g_colour_squared)
        return band_light(moments, found.g_without_colour, self.inputs.fit)

    def pixel_m2_sr(self, x: Array, y: Array) -> Array:
        """Area of the pupil as a pixel at x, y (n,) sees it, times the solid angle that it collects
        from."""
        pupil_m2 = self.facts.area_m2 * pupil_fraction(self.scene, self.camera, x, y)
        return pupil_m2 * self.scene.sensor.fill_factor * solid_angle_sr(self.camera, x, y)


def background_of(scene: Scene) -> Background:
    return scene.background or Background(starlight="auto")


def off_plane_remarks(scene: Scene, g: Geometry) -> list[str]:
    """What is said of zodiacal light that is seen from beside the plane of its dust."""
    if not background_of(scene).zodiacal:
        return []
    most = max(map(z.off_plane_rad, g.sun_m[:, g.middle] - g.observer_m[:, g.middle]))
    if most <= z.IN_PLANE_RAD:
        return []
    times = float(np.exp(z.OFF_PLANE_FALL * np.sin(most)))
    return [
        f"observer: {most / DEG_RAD:.3g} deg off the ecliptic, as seen from the Sun: zodiacal "
        f"light is drawn as from within it, some {times:.2g} times too bright"
    ]


def nearest_known_rad(request: Zodiacal | bool | None) -> float:
    """How near to the Sun zodiacal light is known, as a scene asks for it."""
    extrapolate = isinstance(request, Zodiacal) and request.near_sun == "extrapolate"
    return z.NEAREST_RAD if extrapolate else z.TABLE_ENDS_RAD


def _check_elongation(least_rad: float, request: Zodiacal | bool | None) -> None:
    end = nearest_known_rad(request)
    if least_rad < end:
        hint = "" if end == z.NEAREST_RAD else "; near_sun: extrapolate goes to 2"
        found = f"{least_rad / DEG_RAD:.3g}"
        if float(found) >= end / DEG_RAD:  # as it would read when rounded
            found = f"just below {end / DEG_RAD:.0f}"
        raise BadInput(
            "background.zodiacal",
            f"{found} deg from the Sun in the field",
            f"{end / DEG_RAD:.0f} degrees or more{hint}",
        )
