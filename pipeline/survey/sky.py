"""The sky behind what a sensor looks at: the renderer's own light, by direction and time."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache

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
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.sky.light import ALL_G_MAG, LightOfSky, background_of
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.scene import Scene
from pipeline.spec.sky.background import Zodiacal

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SITE_STEP_S, ORBIT_STEP_S = 300.0, 3600.0  # from one table to the next
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
    or more from the Moon (tests).

    light : what the tables are made from; pixel_m2_sr : of a pixel in the middle; every_e_s : what
    each pixel has of its own [e-/s], as given and of stray light at the epoch; key : of all that
    """

    light: LightOfSky
    pixel_m2_sr: float
    every_e_s: float
    key: str

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SkyBehind) and self.key == other.key

    @property
    def of_a_site(self) -> bool:
        return isinstance(self.light.scene.observer, GroundObserver)

    def e_s(self, offset_s: Array, up: Array, observed: Array) -> Array:
        """Electrons/s of a pixel (r,) that looks along `observed` (r, 3), the sensor's vertical
        being `up` (r, 3), both in TEME axes, at moments (r,) [s] after the epoch."""
        if not len(offset_s):
            return np.zeros(0)
        axes = _axes(up) if self.of_a_site else np.broadcast_to(np.eye(3), (len(up), 3, 3))
        x, y, h = np.moveaxis(np.einsum("nij,nj->ni", axes, observed), -1, 0)
        i, u = _place(AZIMUTHS, np.arctan2(y, x) % (2.0 * np.pi))
        j, v = _place(self.heights, np.arcsin(np.clip(h, -1.0, 1.0)))
        at = offset_s / self.step_s
        first = np.floor(at).astype(np.int64)
        numbers, of = np.unique(np.concatenate([first, first + 1]), return_inverse=True)
        tables = np.array([table_of(self, int(n)) for n in numbers])
        before, after = of[: len(at)], of[len(at) :]

        def value(k: Index) -> Array:
            low = (1.0 - v) * tables[k, i, j] + v * tables[k, i, j + 1]
            return (1.0 - u) * low + u * (
                (1.0 - v) * tables[k, i + 1, j] + v * tables[k, i + 1, j + 1]
            )

        w = at - first
        return np.exp((1.0 - w) * value(before) + w * value(after))

    @property
    def step_s(self) -> float:
        """From one table to the next."""
        return SITE_STEP_S if self.of_a_site else ORBIT_STEP_S

    @property
    def heights(self) -> Array:
        """The elevations of the tables [rad]."""
        return ABOVE if self.of_a_site else AROUND


@lru_cache(maxsize=2048)
def table_of(sky: SkyBehind, number: int) -> Array:
    """Logarithm of the electrons/s of a pixel (azimuths, elevations) at a moment (number x step_s).

    Where zodiacal light is not known so near to the Sun, that of the brightest direction is taken.
    """
    light, scene = sky.light, sky.light.scene
    at = np.array([number * sky.step_s])
    g = geometry_anywhere(scene, np.zeros(1, np.int64), light.dut1_s, at)
    azimuth, height = np.meshgrid(AZIMUTHS, sky.heights, indexing="ij")
    local = from_angles(azimuth.ravel(), height.ravel())
    turn = teme_to_gcrs(instants(parse_utc(scene.epoch), at, light.dut1_s))[0]
    if sky.of_a_site:
        turn = turn @ _axes(g.air[0, g.middle, None, :3] @ turn)[0].T
    observed = local @ turn.T
    known = np.ones(len(observed), bool)
    request = background_of(scene).zodiacal
    if request:
        sun = unit(g.sun_m[0, g.middle] - g.observer_m[0, g.middle])
        known = separation(light.natural(g, 0, g.middle, observed), sun[None]) > _least_rad(request)
    parts = light.towards(g, 0, g.middle, observed[known])
    e_s = np.full(len(observed), np.nan)
    e_s[known] = np.sum(list(parts.values()), axis=0) * sky.pixel_m2_sr + sky.every_e_s
    e_s[~known] = e_s[known].max()
    return np.log(np.maximum(e_s, LEAST_E_S)).reshape(azimuth.shape)


def sky_behind(scene: Scene, resolved: ResolvedScene) -> SkyBehind | None:
    """The sky of a scene over directions and time; None where it is the same everywhere.

    scene : with its files read; resolved : the same without the light that comes and goes
    """
    if not background_of(scene).varies:
        return None
    bare = scene.model_copy(update={"targets": ()})
    band = gather_response(scene)
    colour = gather_band_light(scene, *band).colour
    inputs = gather_sky(scene, *band, (), colour, False, resolved.extinction)
    camera = resolved.camera
    limit = ALL_G_MAG
    light = LightOfSky(bare, camera, resolved.facts, inputs, limit, resolved.dut1_s)
    middle = np.array([0.5 * (camera.columns - 1)]), np.array([0.5 * (camera.rows - 1)])
    g = geometry_anywhere(bare, np.zeros(1, np.int64), light.dut1_s, np.zeros(1))
    own = sum(light.per_pixel(g, 0, g.middle, *middle).values())
    key = json.dumps([bare.as_dict(), light.dut1_s], sort_keys=True)
    return SkyBehind(light, float(light.pixel_m2_sr(*middle)[0]), float(own[0]), key)  # type: ignore[index]


def _least_rad(request: Zodiacal | bool) -> float:
    """How near to the Sun zodiacal light is known."""
    extrapolate = isinstance(request, Zodiacal) and request.near_sun == "extrapolate"
    return z.NEAREST_RAD if extrapolate else z.TABLE_ENDS_RAD


def _axes(up: Array) -> Array:
    """North, east and up (n, 3, 3: rows) of verticals (n, 3); near a pole x stands for it."""
    pole = np.where(np.abs(up[:, 2:]) > POLAR_SINE, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    east = unit(np.cross(pole, up))
    return np.stack([np.cross(up, east), east, up], axis=1)


def _place(nodes: Array, value: Array) -> tuple[Index, Array]:
    """Index of the node below, and the share of the step beyond it."""
    index = np.clip(np.searchsorted(nodes, value, side="right") - 1, 0, len(nodes) - 2)
    share = (value - nodes[index]) / (nodes[index + 1] - nodes[index])
    return index, np.clip(share, 0.0, 1.0)
