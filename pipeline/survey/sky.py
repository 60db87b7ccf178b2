"""The sky behind what a sensor looks at: the renderer's own light, by direction and time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.inputs.band.response import gather_band_light, gather_response
from pipeline.inputs.sky.sky import gather_sky
from pipeline.physics.constants import DEG_RAD
from pipeline.physics.positions.earth import teme_to_gcrs
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.sky import zodiacal as z
from pipeline.physics.vectors import from_angles, separation, unit
from pipeline.plan.pointing.geometry import geometry_anywhere
from pipeline.plan.pointing.site import axes_of
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.sky.light import ALL_G_MAG, LightOfSky, background_of, nearest_known_rad
from pipeline.plan.sky.stray_light import check_all_round
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene

if TYPE_CHECKING:
    from pipeline.spec.sky.stray_light import StrayLight
    from pipeline.survey.watch import WatchMoments

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SITE_STEP_S, ORBIT_STEP_S = 300.0, 3600.0  # from one table to the next
INSTANT_S = 1e-3  # of an exposure, so that its middle is its moment
AZIMUTHS = np.arange(0.0, 360.1, 5.0) * DEG_RAD
LOW = (0.0, 2.5, 5.0, 7.5)  # the air's light changes fast there
ABOVE = np.array([*LOW, *np.arange(10.0, 90.1, 5.0)]) * DEG_RAD
AROUND = np.arange(-90.0, 90.1, 5.0) * DEG_RAD
LEAST_E_S = 1e-12  # so that a logarithm is finite
POLAR_SINE = 0.9999  # of a latitude: nearer to a pole azimuths count from the x axis


@dataclass(frozen=True, eq=False)
class SkyBehind:
    """A sky that differs over directions and time, as a sensor's pixels see it.

    It is tabulated every step_s over azimuth and elevation (a satellite's: over the sphere, TEME
    axes) and linear between, in its logarithm: to 1 % in the night and 4 % in twilight, 12 degrees
    or more above the horizon and from the Moon, and to 5 % from orbit (tests).

    Stray light is worked out for each line of sight: near the Earth it changes faster than that.
    light : what the tables are made from; pixel_m2_sr : of a pixel in the middle
    """

    light: LightOfSky
    pixel_m2_sr: float

    @property
    def site(self) -> GroundObserver | None:
        """Where it stands; None in orbit."""
        o = self.light.scene.observer
        return o if isinstance(o, GroundObserver) else None

    @property
    def stray(self) -> StrayLight | None:
        """The stray light that it asks for."""
        return background_of(self.light.scene).stray_light

    @property
    def step_s(self) -> float:
        """From one table to the next."""
        return ORBIT_STEP_S if self.site is None else SITE_STEP_S

    @property
    def heights(self) -> Array:
        """The elevations of the tables [rad]."""
        return AROUND if self.site is None else ABOVE

    def e_s(self, watch: WatchMoments, moment: Index, observed: Array) -> Array:
        """Electrons/s of a pixel (r,) that looks along `observed` (r, 3), TEME axes, at moments
        (r,) of a watch, which keeps the tables."""
        if not len(moment):
            return np.zeros(0)
        up = watch.up[moment]
        axes = np.broadcast_to(np.eye(3), (len(up), 3, 3)) if self.site is None else _axes(up)
        x, y, h = np.moveaxis(np.einsum("nij,nj->ni", axes, observed), -1, 0)
        i, u = z.place_between(AZIMUTHS, np.arctan2(y, x) % (2.0 * np.pi))
        j, v = z.place_between(self.heights, np.arcsin(np.clip(h, -1.0, 1.0)))
        at = watch.offset_s[moment] / self.step_s
        first = np.floor(at).astype(np.int64)
        numbers, of = np.unique(np.concatenate([first, first + 1]), return_inverse=True)
        tables = np.array([self._table(watch, int(n)) for n in numbers])
        before, after = of[: len(at)], of[len(at) :]

        def value(k: Index) -> Array:
            low = (1.0 - v) * tables[k, i, j] + v * tables[k, i, j + 1]
            high = (1.0 - v) * tables[k, i + 1, j] + v * tables[k, i + 1, j + 1]
            return (1.0 - u) * low + u * high

        w = at - first
        e_s = np.exp((1.0 - w) * value(before) + w * value(after))
        return e_s + self._stray_e_s(watch, moment, observed)

    def _stray_e_s(self, watch: WatchMoments, moment: Index, observed: Array) -> Array:
        """Stray light (r,) [e-/s and pixel]."""
        light, out = self.light, np.zeros(len(moment))
        if self.stray is None:
            return out
        order = np.argsort(moment, kind="stable")
        numbers, first = np.unique(moment[order], return_index=True)
        frames, late_s = np.zeros(len(numbers), np.int64), watch.offset_s[numbers]
        g = geometry_anywhere(light.scene, frames, light.dut1_s, late_s)
        for f, rows in enumerate(np.split(order, first[1:])):
            seen = observed[rows] @ watch.to_gcrs[numbers[f]].T
            u = light.natural(g, f, g.middle, seen)
            parts = light.scattered(self.stray, g, f, g.middle, u, checked=False)
            out[rows] = np.sum(list(parts.values()), axis=0)
        return out

    def _table(self, watch: WatchMoments, number: int) -> Array:
        """The table of a number; a satellite's within the watch, beyond which its orbit may end."""
        if number not in watch.sky_tables:
            at_s = number * self.step_s
            if self.site is None:
                at_s = float(np.clip(at_s, watch.offset_s[0], watch.offset_s[-1]))
            watch.sky_tables[number] = self.at(at_s)
        return watch.sky_tables[number]

    def at(self, offset_s: float) -> Array:
        """Logarithm of the electrons/s of a pixel (azimuths, elevations) at a moment.

        Where zodiacal light is not known so near to the Sun, that of the brightest direction.
        """
        light, scene = self.light, self.light.scene
        g = geometry_anywhere(scene, np.zeros(1, np.int64), light.dut1_s, np.array([offset_s]))
        azimuth, height = np.meshgrid(AZIMUTHS, self.heights, indexing="ij")
        times = instants(parse_utc(scene.epoch), [offset_s], light.dut1_s)
        turn = teme_to_gcrs(times)[0]
        if self.site is not None:
            turn = turn @ _axes(axes_of(self.site, times)[:, 2] @ turn)[0].T
        observed = from_angles(azimuth.ravel(), height.ravel()) @ turn.T
        known = np.ones(len(observed), bool)
        request = background_of(scene).zodiacal
        if request:
            sun = unit(g.sun_m[0, g.middle] - g.observer_m[0, g.middle])
            apart = separation(light.natural(g, 0, g.middle, observed), sun[None])
            known = apart > nearest_known_rad(request)
        parts = light.towards(g, 0, g.middle, observed[known])
        e_s = np.full(len(observed), np.nan)
        e_s[known] = np.sum(list(parts.values()), axis=0) * self.pixel_m2_sr
        e_s[known] += light.inputs.uniform_e_s or 0.0
        e_s[~known] = e_s[known].max()
        return np.log(np.maximum(e_s, LEAST_E_S)).reshape(azimuth.shape)


def sky_behind(scene: Scene, resolved: ResolvedScene) -> SkyBehind | None:
    """The sky of a scene over directions and time; None where it is the same everywhere.

    scene : with its files read; resolved : the same without the light that comes and goes
    """
    if not background_of(scene).varies:
        return None
    instant = scene.exposure.model_copy(update={"integration_s": INSTANT_S})
    bare = scene.model_copy(update={"targets": (), "exposure": instant})
    band = gather_response(scene)
    colour = gather_band_light(scene, *band).colour
    inputs = gather_sky(scene, *band, (), colour, False, resolved.extinction)
    camera = resolved.camera
    if inputs.stray is not None:
        check_all_round(inputs.stray.pst)
    light = LightOfSky(bare, camera, resolved.facts, inputs, ALL_G_MAG, resolved.dut1_s)
    middle = np.array([0.5 * (camera.columns - 1)]), np.array([0.5 * (camera.rows - 1)])
    return SkyBehind(light, float(light.pixel_m2_sr(*middle)[0]))


def _axes(up: Array) -> Array:
    """North, east and up (n, 3, 3: rows) of verticals (n, 3); near a pole x stands for it."""
    pole = np.where(np.abs(up[:, 2:]) > POLAR_SINE, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    east = unit(np.cross(pole, up))
    return np.stack([np.cross(up, east), east, up], axis=1)
