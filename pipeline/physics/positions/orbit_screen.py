"""Which of very many satellites come into a cone of the sky during a dwell: none is missed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from sgp4.api import SatrecArray

from pipeline.physics.constants import DAY_S, EARTH_GM_M3_S2, SPEED_OF_LIGHT_M_S
from pipeline.physics.positions.earth import teme_to_gcrs
from pipeline.physics.positions.orbit_bounds import DECAYED, have_decayed
from pipeline.physics.positions.orbit_sgp4 import since_epochs_s
from pipeline.physics.positions.times import instants
from pipeline.physics.vectors import separation

if TYPE_CHECKING:
    from sgp4.api import Satrec

Array = NDArray[np.float64]
Place = Callable[[Array], tuple[Array, Array]]

FIRST_STEP_S, SPLIT, LAST_STEP_S = 60.0, 4, 0.25
BATCH, SAMPLES = 4096, 262_144  # satellites, and their moments, looked at in one go
WHOLE = -1  # where SGP4 found no error
_TEME_TURN_RAD_S = 1e-11  # of TEME against GCRS, with room (7.7e-12)
_EARTH_M_S = 30.5e3  # the Earth's speed about the Sun, with room: annual aberration
_LOWEST_M = 6.3e6  # nothing above the ground is pulled more strongly than here
_OBLATE = 1.01  # room for the zonals, the Moon and the Sun in the largest acceleration
_PLACE_ROOM_M = 10.0  # a leap second put right by the speed alone, rounding
_SPEED_ROOM = 1.01  # SGP4's velocity is the derivative of its place to 1e-3


@dataclass(frozen=True)
class ScreenResult:
    """inside : indices of satellites that may come into the cone; failed : SGP4 ended for them,
    at any moment looked at: those are not among `inside`.

    codes : SGP4's error code of each that failed, at the first moment looked at where it did; 0
        where what it gave was not finite
    """

    inside: NDArray[np.int64]
    failed: NDArray[np.int64]
    codes: NDArray[np.int64]


def screen_cone(
    satellites: Sequence[Satrec],
    epoch_utc: tuple[float, float],
    duration_s: float,
    observer: Place,
    boresight: Callable[[Array], Array],
    half_angle_rad: float,
    boresight_turn_rad_s: float = 0.0,
    observer_pull_m_s2: float = 9.9,
) -> ScreenResult:
    """Satellites whose apparent direction comes within a cone about the boresight.

    A satellite may move from its place at an interval's middle by at most
    h |v - v_o| + h^2/2 (a + a_o) in half an interval h, and so be seen to turn by at most the
    arcsine of that over its range. Intervals in which it cannot reach the cone are dropped, others
    are split, down to 0.25 s, where what is left counts as inside: too many may be named, none is
    missed. Aberration and light time are in the margin.

    Parameters
    ----------
    satellites : sgp4's, any number. duration_s : of the dwell, from `epoch_utc` on.
    observer : seconds (n,) -> geocentric GCRS place [m] and velocity [m/s] (n, 3).
    boresight : seconds (n,) -> unit vectors (n, 3), ICRS, aberrated or not.
    half_angle_rad : of the cone (the field's corner, plus half a streak).
    boresight_turn_rad_s : largest rate of the boresight.
    observer_pull_m_s2 : largest acceleration of the observer.
    """
    count = max(1, int(np.ceil(duration_s / FIRST_STEP_S)))
    half = 0.5 * duration_s / count
    middles = (2.0 * np.arange(count, dtype=np.float64) + 1.0) * half
    turn = teme_to_gcrs(instants(epoch_utc, [0.5 * duration_s]))[0]
    sky = _Sky(
        turn,
        observer,
        boresight,
        half_angle_rad,
        boresight_turn_rad_s,
        observer_pull_m_s2,
        _TEME_TURN_RAD_S * 0.5 * duration_s,
    )
    since_s = since_epochs_s(satellites, epoch_utc)
    inside = np.zeros(len(satellites), bool)
    codes = np.full(len(satellites), WHOLE)
    who, when = [np.zeros(0, np.int64)], [np.zeros(0)]
    step = max(64, min(BATCH, SAMPLES // count))
    for start in range(0, len(satellites), step):
        part = slice(start, start + step)
        place, speed, errors = states_together(satellites[part], since_s[part], middles)
        bad = errors != WHOLE
        first = errors[np.arange(len(bad)), np.argmax(bad, axis=1)]
        codes[part] = np.where(bad.any(axis=1), first, WHOLE)
        hit, near = sky.judge(place, speed, np.broadcast_to(middles, bad.shape), half)
        inside[part] |= (hit & ~bad).any(axis=1)
        i, k = np.nonzero(near & ~bad & ~inside[part, None])
        who.append(i + start)
        when.append(middles[k])
    _refine(
        satellites, since_s, sky, (np.concatenate(who), np.concatenate(when), half), inside, codes
    )
    failed = np.flatnonzero(codes != WHOLE)
    return ScreenResult(np.flatnonzero(inside & (codes == WHOLE)), failed, codes[failed])


def sgp4_codes(
    satellites: Sequence[Satrec], epoch_utc: tuple[float, float], offsets_s: Array
) -> dict[int, int]:
    """SGP4's code of each satellite that it ends for at any of some times (n,) after an epoch: the
    first, by the satellite's index; 0 where what it gave was not finite."""
    since_s = since_epochs_s(satellites, epoch_utc)
    found: dict[int, int] = {}
    step = max(64, min(BATCH, SAMPLES // len(offsets_s)))
    for start in range(0, len(satellites), step):
        part = slice(start, start + step)
        codes = states_together(satellites[part], since_s[part], offsets_s)[2]
        bad = codes != WHOLE
        for i in np.flatnonzero(bad.any(axis=1)):
            found[start + int(i)] = int(codes[i, np.argmax(bad[i])])
    return found


@dataclass(frozen=True)
class _Sky:
    """Observer and boresight in TEME, and how far apart seen and computed directions may be."""

    to_gcrs: Array
    observer: Place
    boresight: Callable[[Array], Array]
    half_angle_rad: float
    turn_rad_s: float
    pull_m_s2: float
    frame_rad: float

    def judge(
        self, place: Array, speed: Array, at_s: Array, half_s: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which intervals (...) have the satellite surely in the cone; which may have it so.

        place [m], speed [m/s] (..., 3) in TEME at the middles `at_s` (...).
        """
        times, of = np.unique(at_s, return_inverse=True)
        of = of.reshape(at_s.shape)
        site, motion = (np.asarray(x) @ self.to_gcrs for x in self.observer(times))
        axis = np.asarray(self.boresight(times)) @ self.to_gcrs
        path = place - site[of]
        distance = np.sqrt(np.sum(path * path, axis=-1))
        angle = separation(path, axis[of])
        own = _SPEED_ROOM * np.sqrt(np.sum(speed * speed, axis=-1))
        fast = _SPEED_ROOM * np.sqrt(np.sum((speed - motion[of]) ** 2, axis=-1))
        radius = np.sqrt(np.sum(place * place, axis=-1))
        lowest = np.maximum(radius - own * half_s - 4.9 * half_s**2, _LOWEST_M)
        pull = _OBLATE * EARTH_GM_M3_S2 / lowest**2 + self.pull_m_s2
        moved = half_s * fast + 0.5 * half_s**2 * pull + _PLACE_ROOM_M
        seen = np.arcsin(np.minimum(1.0, moved / distance))
        seen = np.where(moved >= distance, np.pi, seen)
        still = np.sqrt(np.sum(motion * motion, axis=-1))[of]
        light = 1.01 * (own + still + _EARTH_M_S) / SPEED_OF_LIGHT_M_S + self.frame_rad
        margin = seen + half_s * self.turn_rad_s + light
        return angle <= self.half_angle_rad, angle <= self.half_angle_rad + margin


def states_together(
    satellites: Sequence[Satrec], since_s: Array, middles: Array
) -> tuple[Array, Array, NDArray[np.int64]]:
    """TEME places [m], velocities [m/s] (m, k, 3) and error codes (m, k) at common times.

    since_s : (m,) from `since_epochs_s`, of the instant from which `middles` (k,) [s] count
    """
    # SGP4 counts from each epoch: one common scale of dates serves all where no leap second lies
    # between; elsewhere that second is put right by the satellite's own speed
    reference = (satellites[0].jdsatepoch, satellites[0].jdsatepochF)
    days = (since_s[0] + middles) / DAY_S
    errors, place, speed = SatrecArray(list(satellites)).sgp4(
        np.full_like(days, reference[0]), reference[1] + days
    )
    dates = np.array(
        [(s.jdsatepoch - reference[0]) + (s.jdsatepochF - reference[1]) for s in satellites]
    )
    late = since_s - (since_s[0] - dates * DAY_S)
    if late.any():
        place += late[:, None, None] * speed
    ends = since_s[:, None] + (middles.min(), middles.max())
    down = np.flatnonzero(have_decayed(satellites, ends / 60.0).any(axis=1))
    if len(down):  # few: nobody rises again between the ends
        minutes = (since_s[down, None] + middles) / 60.0
        errors[down] = np.where(have_decayed(satellites, minutes, down), DECAYED, errors[down])
    codes = _codes(errors, place, speed)
    place *= 1e3
    speed *= 1e3
    bad = codes != WHOLE
    if bad.any():
        place[bad], speed[bad] = 1e7, 0.0
    return place, speed, codes


def _codes(errors: NDArray[np.uint8], place: Array, speed: Array) -> NDArray[np.int64]:
    """SGP4's codes (...), 0 where the result is not finite, WHOLE where all is well."""
    bad = (errors != 0) | ~np.isfinite(place).all(axis=-1) | ~np.isfinite(speed).all(axis=-1)
    return np.where(bad, errors.astype(np.int64), WHOLE)


def _refine(
    satellites: Sequence[Satrec],
    since_s: Array,
    sky: _Sky,
    intervals: tuple[NDArray[np.int64], Array, float],
    inside: NDArray[np.bool_],
    codes: NDArray[np.int64],
) -> None:
    """Split intervals (satellite, middle, half width) until settled; marks what is found."""
    who, when, half = intervals
    offsets = (2.0 * np.arange(SPLIT) + 1.0) / SPLIT - 1.0
    while len(who):
        open_ = ~inside[who]
        who, when = who[open_], when[open_]
        if not len(who):
            return
        if 2.0 * half <= LAST_STEP_S:
            inside[who] = True
            return
        when = (when[:, None] + offsets * half).ravel()
        who, half = np.repeat(who, SPLIT), half / SPLIT
        place, speed, errors = states_apart(satellites, since_s, who, when)
        bad = errors != WHOLE
        codes[who[bad]] = errors[bad]
        hit, near = sky.judge(place, speed, when, half)
        inside[who[hit & ~bad]] = True
        who, when = who[near & ~bad], when[near & ~bad]


def states_apart(
    satellites: Sequence[Satrec], since_s: Array, who: NDArray[np.int64], when: Array
) -> tuple[Array, Array, NDArray[np.int64]]:
    """TEME places, velocities (p, 3) and error codes (p,) of pairs of satellite and time.

    who : (p,) indices; when : (p,) seconds from the instant of `since_s`
    """
    order = np.argsort(who, kind="stable")
    place, speed = np.zeros((2, len(who), 3))
    codes = np.full(len(who), WHOLE)
    edges = np.flatnonzero(np.diff(who[order])) + 1
    for pairs in np.split(order, edges):
        if not len(pairs):
            continue
        i = int(who[pairs[0]])
        satellite = satellites[i]
        days = (since_s[i] + when[pairs]) / DAY_S
        errors, r, v = satellite.sgp4_array(
            np.full_like(days, satellite.jdsatepoch), satellite.jdsatepochF + days
        )
        place[pairs], speed[pairs] = r * 1e3, v * 1e3
        codes[pairs] = _codes(errors, r, v)
    those, of = np.unique(who, return_inverse=True)
    codes[have_decayed([satellites[i] for i in those], (since_s[who] + when) / 60.0, of)] = DECAYED
    bad = codes != WHOLE
    place[bad], speed[bad] = 1e7, 0.0
    return place, speed, codes
