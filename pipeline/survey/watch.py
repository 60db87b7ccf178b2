"""A sensor that watches: its camera resolved once, and where it stands and may look at moments."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.inputs.targets.ephemerides import gather_ephemerides
from pipeline.physics.constants import (
    DEG_RAD,
    EARTH_EQUATORIAL_RADIUS_M,
    SPEED_OF_LIGHT_M_S,
    SUN_RADIUS_M,
)
from pipeline.physics.noise.streams import stream_key, uniforms
from pipeline.physics.positions.apparent import apparent_sun_m
from pipeline.physics.positions.earth import earth_and_sun, teme_to_gcrs
from pipeline.physics.positions.focal_plane import corner_radius
from pipeline.physics.positions.times import Instants, format_utc, instants
from pipeline.physics.targets.shadow import MOON_RADIUS_M, moon_m
from pipeline.physics.vectors import angular_radius, from_angles, separation, unit
from pipeline.plan.bodies.orbits import orbit_states
from pipeline.plan.pointing.air import terms_of
from pipeline.plan.pointing.geometry import camera_of, moments_at, zenith_pointing
from pipeline.plan.pointing.lamps import hidden_rad
from pipeline.plan.pointing.site import axes_of, place_of
from pipeline.plan.resolved import ResolvedScene
from pipeline.plan.sky.doubts import sun_exclusion_rad
from pipeline.plan.sky.light import background_of, nearest_known_rad
from pipeline.resolve.files import read_files
from pipeline.resolve.resolve import resolve
from pipeline.spec.load import parse_scene
from pipeline.spec.pointing.observer import GroundObserver, OrbitObserver
from pipeline.spec.pointing.pointing import Pointing, SiderealPointing
from pipeline.spec.scene import Background, Scene
from pipeline.spec.sensor.detector import TimeDelay
from pipeline.spec.study import FieldOfRegard
from pipeline.survey.signal import SignalTable, signal_table
from pipeline.survey.sky import SkyBehind, sky_behind

Array = NDArray[np.float64]
Index = NDArray[np.int64]

GALACTIC_POLE = from_angles(*np.array([192.859_48, 27.128_25]) * DEG_RAD)  # J2000
CHANGING = ("moonlight", "twilight", "stray_light")  # parts of the sky that come and go
DISCS_RAD = {"sun": 0.0048, "moon": 0.005, "earth": 0.0}  # radii on the sky, at most; of the limb
LEAST_NOISE = 1e-3  # of the table's, squared: no sky is darker than its thousandth
OF_DIRECTION = 0.02  # of SNR, that is not told
MOST_LIFT_RAD = 0.0125  # by the air, at the horizon, with room
PROBE = {  # a target, so that the Sun's light in the band is worked out
    "name": "probe",
    "orbit": {
        "kind": "keplerian",
        "semi_major_axis_m": 1e8,
        "eccentricity": 0,
        "inclination_deg": 0,
        "mean_anomaly_deg": 0,
    },
    "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2},
}
STILL_CHARGE = (
    "frame_transfer, rolling, or no readout: how moving charge lies to an object's path is known "
    "where a scene points, which `nightglass observe` counts, not wherever a sensor may look"
)
Epoch = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Watcher:
    """A sensor that looks for objects.

    resolved : its camera as a scene that looks up at `epoch`; integration_s, frames, cadence_s :
    of a dwell; tracks : whether dwells follow their object; field : what its keys begin with in the
    file; sky : over directions and time; None where it is the same everywhere; pointing : that
    leads the camera on while it exposes, wherever it looks; None: it follows the stars
    """

    name: str
    field: str
    resolved: ResolvedScene
    regard: FieldOfRegard
    signal: SignalTable
    epoch: Epoch
    seed: int
    tracks: bool
    sky: SkyBehind | None = None
    pointing: Pointing | None = None

    @property
    def observer(self) -> GroundObserver | OrbitObserver:
        o = self.resolved.scene.observer
        assert isinstance(o, GroundObserver | OrbitObserver)
        return o

    @cached_property
    def electrons_per_light(self) -> float:
        """Electrons of an exposure [e-], of light equal to the Sun's at 1 au."""
        r = self.resolved
        return r.sun_rate_e_s_m2 * r.facts.area_m2 * r.integration_s(0)

    def light_e(self, light: Array, sine: Array) -> Array:
        """Electrons of an exposure (n,) [e-] of light (n,) [of the Sun's at 1 au], through the air
        at elevations of this sine (n,)."""
        extinction = self.resolved.extinction
        through = 1.0 if extinction is None else extinction.transmission(sine)
        return light * self.electrons_per_light * through

    def sky_e_s(self, watch: WatchMoments, moment: Index, observed: Array) -> Array:
        """Electrons/s of a pixel (r,) behind directions (r, 3: TEME, as the camera sees them)."""
        if self.sky is None:
            return np.full(len(moment), self.resolved.facts.background_e_s)
        return self.sky.e_s(watch, moment, observed)

    def snr(self, light_e: Array, streak_px: Array, sky_e_s: Array | float) -> Array:
        """SNR (r,) of a frame, of light (r,) [e-] in streaks (r,) [px] before a sky (r,) [e-/s];
        0 where the sky alone fills the pixels.

        With s the square of a pixel's noise over that of the table, it is sqrt(s) times the SNR of
        light / s in the table: exact for the matched filter, whose terms are
        (F p)^2 / (noise^2 + F p).
        """
        share = self._noise_share(sky_e_s)
        snr = np.sqrt(share) * self.signal.snr(light_e / share, streak_px)
        return np.where(self.resolved.empty_e(sky_e_s) < self.resolved.full_e, snr, 0.0)

    def _noise_share(self, sky_e_s: Array | float) -> Array:
        """Square of a pixel's noise under a sky (r,) [e-/s] over that of the table's."""
        r = self.resolved
        if self.sky is None or not r.scene.sensor.photon_noise:
            return np.ones_like(np.asarray(sky_e_s, float))
        x, y = np.array(r.camera.centre_px)[:, None]  # where the table holds
        more = r.facts.flat * (np.asarray(sky_e_s) - r.sky_e_s(0, x, y)) * r.integration_s(0)
        return np.maximum(1.0 + more / r.snr_floor_e2(0, x, y), LEAST_NOISE)

    def streak_px(self, rate: Array) -> Array:
        """Streaks (n,) [px] of objects that pass the camera at a rate (n,) [rad/s]; none where it
        tracks."""
        r = self.resolved
        return np.zeros_like(rate) if self.tracks else rate * r.integration_s(0) / r.facts.ifov_rad

    @cached_property
    def air_terms(self) -> tuple[float, float]:
        """Refraction's A and B [rad]; zeros without."""
        ground = isinstance(self.observer, GroundObserver)
        return terms_of(self.resolved.scene) if ground and self.observer.atmosphere else (0.0, 0.0)  # type: ignore[union-attr]

    @cached_property
    def refused_rad(self) -> dict[str, float]:
        """Angles [rad] from the middle of the field within which the camera's own scene would be
        refused, of what is in sight: Sun, Moon, Earth's limb; 0 or less: none."""
        scene = self.resolved.scene if self.sky is None else self.sky.light.scene
        angles = {"sun": sun_exclusion_rad(scene), "moon": 0.0, "earth": 0.0}
        stray = None if self.sky is None else self.sky.stray
        curve = None if self.sky is None else self.sky.light.inputs.stray
        if stray is None or curve is None:
            return angles
        nearest_rad = curve.pst.exclusion_rad * (stray.inside == "refuse")
        for name, radius_rad in DISCS_RAD.items():  # in the field they are refused in any case
            if getattr(stray, name):
                least_rad = max(nearest_rad, radius_rad)
                angles[name] = least_rad + corner_radius(self.resolved.camera)
        return angles

    @property
    def sky_note(self) -> str:
        """What its sky is, for people."""
        sky_e_s = self.resolved.facts.background_e_s
        told = f"sky {sky_e_s:.3g} e-/s a pixel"
        if self.resolved.empty_e(sky_e_s) >= self.resolved.full_e:
            told += (
                f", which FILLS IT ({self.resolved.full_e:.3g} e-): nothing is detected before it"
            )
        if self.sky is None:
            return told + ", the same everywhere and always"
        return told + " above it at the start without what comes and goes; each object its own"

    @property
    def direction_notes(self) -> list[str]:
        """That SNR depends on how a streak lies, where it does by more than OF_DIRECTION."""
        spread = self.signal.direction_spread
        if self.tracks or spread <= OF_DIRECTION:
            return []
        return [
            "SNR is that of streaks at 22.5 degrees to the rows: faint ones along rows, columns or "
            f"diagonals have up to {100.0 * spread:.0f}% more or less (narrow or uneven images)"
        ]

    @property
    def dwell_s(self) -> float:
        """From the start of a dwell's first exposure to the end of its last."""
        e = self.resolved.scene.exposure
        return (e.frames - 1) * e.step_s + e.integration_s

    def watch(self, offsets_s: Array) -> WatchMoments:
        """Where it stands and may look at moments (n,) [s] after its epoch."""
        times = instants(self.epoch, offsets_s, self.resolved.dut1_s)
        to_gcrs, earth = (
            teme_to_gcrs(times),
            earth_and_sun(*(np.ascontiguousarray(t) for t in (times.tt1, times.tt2))),
        )

        def teme(v: Array) -> Array:
            return np.ascontiguousarray(np.einsum("nji,nj->ni", to_gcrs, v))

        place, motion, up = self._state(offsets_s, times)
        sun = apparent_sun_m(earth)
        moon = moon_m(times.tt1, times.tt2)
        lowest, works = self._limits(offsets_s, place, up, sun)
        return WatchMoments(
            offsets_s,
            to_gcrs,
            teme(place),
            teme(motion),
            teme(up),
            lowest,
            works,
            teme(sun),
            teme(moon),
            teme(np.broadcast_to(GALACTIC_POLE, place.shape)),
            teme(earth.velocity_m_s),
            self._least(place, up, sun, "sun", SUN_RADIUS_M),
            self._least(place, up, moon, "moon", MOON_RADIUS_M),
        )

    def _state(self, offsets_s: Array, times: Instants) -> tuple[Array, Array, Array]:
        """Place [m], velocity [m/s] and vertical (n, 3), GCRS."""
        o = self.observer
        if isinstance(o, GroundObserver):
            return *place_of(o, times), axes_of(o, times)[:, 2]
        place, motion = orbit_states(
            o.orbit, f"{self.field}observer.orbit", self.epoch, offsets_s, times
        )
        return place, motion, unit(place)

    def _least(self, place: Array, up: Array, body: Array, name: str, radius_m: float) -> Array:
        """Least angle (n,) [rad] from Sun or Moon: that of the field of regard, and the camera's
        own while some of the body is in sight."""
        path = body - place
        elevation = 0.5 * np.pi - separation(path, up)
        radius = angular_radius(radius_m, path)
        hidden = hidden_rad(self.resolved.scene, place, path, elevation) > radius
        regard = getattr(self.regard, f"{name}_exclusion_deg") * DEG_RAD
        return np.where(hidden, regard, max(regard, self.refused_rad[name]))

    def _limits(
        self, offsets_s: Array, place: Array, up: Array, sun: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Least elevation (n,) [rad] that may be looked at, as the air shows it, and whether
        anything is."""
        r, n = self.regard, len(offsets_s)
        if not isinstance(self.observer, GroundObserver):
            limb = angular_radius(EARTH_EQUATORIAL_RADIUS_M, place)
            least = max(r.earth_exclusion_deg * DEG_RAD, self.refused_rad["earth"])
            return limb + least - 0.5 * np.pi, np.ones(n, bool)
        sun_elevation = 0.5 * np.pi - separation(sun - place, up)
        works = sun_elevation <= r.twilight_deg * DEG_RAD
        if r.clear_fraction < 1.0:
            works &= self._clear(offsets_s, self.observer)
        return np.full(n, r.lowest_elevation_deg * DEG_RAD), works

    def _clear(self, offsets_s: Array, site: GroundObserver) -> NDArray[np.bool_]:
        """Whether the sky is clear (n,): each stretch of weather draws by seed, place, number."""
        stretch = np.floor(offsets_s / (self.regard.weather_h * 3600.0)).astype(np.int64)
        place = f"{site.latitude_deg:.6f} {site.longitude_deg % 360.0:.6f}"
        key = stream_key(self.seed, f"weather at {place}")
        numbers, of = np.unique(stretch, return_inverse=True)
        draws = np.array([uniforms(1, 1, 0, 0, int(k) & 0xFFFFFFFF, *key)[0, 0] for k in numbers])
        return np.asarray(draws < self.regard.clear_fraction)[of]


@dataclass(frozen=True, eq=False)
class WatchMoments:
    """A sensor at n moments, in TEME axes; angles [rad], vectors (n, 3).

    to_gcrs : (n, 3, 3); observer_m, motion_m_s : geocentric; up : its vertical; lowest : (n,) least
    elevation; works : (n,) whether it looks at all; sun_m : apparent; moon_m : geocentric; pole :
    of the Galaxy; earth_m_s : the Earth's velocity; sun_least, moon_least : (n,) least angles from
    them; sky_tables : of `SkyBehind`, as they are made
    """

    offset_s: Array
    to_gcrs: Array
    observer_m: Array
    motion_m_s: Array
    up: Array
    lowest: Array
    works: NDArray[np.bool_]
    sun_m: Array
    moon_m: Array
    pole: Array
    earth_m_s: Array
    sun_least: Array
    moon_least: Array
    sky_tables: dict[int, Array] = field(default_factory=dict)

    @property
    def turn_rad_s(self) -> Array:
        """Rate of the vertical (n,), at most."""
        speed, radius = (np.sqrt(np.sum(v**2, -1)) for v in (self.motion_m_s, self.observer_m))
        return 1.01 * speed / radius + 1e-6

    @property
    def beta(self) -> Array:
        """Velocity over that of light (n, 3), against the Earth's centre."""
        return self.motion_m_s / SPEED_OF_LIGHT_M_S


def _without(background: Background, names: tuple[str, ...]) -> Background | None:
    """A background without some of its parts; None where nothing is left of it."""
    kept = background.model_copy(update=dict.fromkeys(names))
    uniform = (kept.uniform_mag_arcsec2, kept.uniform_e_per_s)
    return kept if kept.varies or any(v is not None for v in uniform) else None


def _is_near_sun(scene: Scene, pointing: SiderealPointing) -> bool:
    """Whether the field of a pointing is so near to the Sun, at the epoch, that zodiacal light is
    not known there: it is told direction by direction where a sensor looks."""
    at = moments_at(scene, 0.0, np.zeros(1))
    look = DEG_RAD * np.array([pointing.boresight_ra_deg, pointing.boresight_dec_deg])
    apart = separation(from_angles(*look), at.earth.sun_from_earth_m - at.observer_m)
    known = nearest_known_rad(background_of(scene).zodiacal)
    return bool(apart.min() < known + corner_radius(camera_of(scene)) + DEG_RAD)


def make_watcher(
    sections: JsonObject,
    regard: FieldOfRegard,
    epoch: Epoch,
    tracks: bool,
    field: str = "",
    seed: int = 0,
    until_s: float = 0.0,
) -> Watcher:
    """A watcher of a scene's sections: `observer`, `sensor`, `exposure`, `background`.

    epoch : two-part UTC, from which moments count; until_s : the last one, which an orbit's file
        must cover
    """
    stub = {
        **{k: v for k, v in sections.items() if v is not None},
        "schema": "nightglass/scene/1",
        "name": "watch",
        "epoch": format_utc(*epoch),
        "accept": ["sun", "moon", "daylight", "coverage", "error"],
        "accuracy": {"check_cells": 0},
        "targets": [PROBE],
        "pointing": {"mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": 0.0},
    }
    scene = gather_ephemerides(parse_scene(stub), (0.0, until_s))
    if not isinstance(scene.observer, GroundObserver | OrbitObserver):
        raise BadInput(f"{field}observer.kind", scene.observer.kind, "ground or orbit")
    detector = scene.sensor.detector
    if detector is not None and isinstance(detector.readout, TimeDelay):
        raise BadInput("sensor.detector.readout.kind", detector.readout.kind, STILL_CHARGE)
    read = read_files(scene)
    up = {"pointing": zenith_pointing(read)}
    steady = None
    if scene.background is not None:
        near_sun = ("zodiacal",) if _is_near_sun(read, up["pointing"]) else ()
        steady = _without(scene.background, (*CHANGING, *near_sun))
    resolved = resolve(scene.model_copy(update=up | {"background": steady})).scene
    sky = sky_behind(read.model_copy(update=up), resolved) if scene.background else None
    name = str(sections.get("name", field))
    signal = signal_table(resolved)
    return Watcher(name, field, resolved, regard, signal, epoch, seed, tracks, sky)
