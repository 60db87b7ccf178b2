"""What is never looked at is never seen: bounds of orbits against orbits followed densely."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics.positions.orbit_bounds import (
    latitude_bound_rad,
    never_rises,
    radius_bounds_m,
)
from pipeline.physics.positions.orbit_screen import WHOLE, states_together
from pipeline.physics.positions.orbit_sgp4 import since_epochs_s
from pipeline.spec.study import FieldOfRegard, Synthetic
from pipeline.survey.elements import Elements, synthetic_elements
from pipeline.survey.prune import _days, never_seen
from pipeline.survey.sights import sights_of
from pipeline.survey.watch import MOST_LIFT_RAD, Watcher, make_watcher
from tests.survey.conftest import EPOCH, sections, watcher

AT = np.arange(0.0, 86_400.0, 240.0)


def _orbit(
    perigee_km: float, ecc: float, tilt_deg: float, turns: tuple[float, ...], bstar: float = 0.0
) -> Elements:
    """One object with these elements at the epoch."""
    made = synthetic_elements(Synthetic(objects=1), EPOCH)
    motion = np.sqrt(398_600.8 / ((6378.135 + perigee_km) / (1.0 - ecc)) ** 3) * 60.0
    node, argument, anomaly = (2.0 * np.pi * t for t in turns)
    made.mean[0] = [bstar, ecc, argument, np.radians(tilt_deg), anomaly, motion, node]
    return made


orbits = st.builds(
    _orbit,
    st.floats(200.0, 36_000.0),
    st.floats(0.0, 0.7),
    st.floats(0.0, 180.0),
    st.tuples(*[st.floats(0.0, 1.0)] * 3),
    st.one_of(st.just(0.0), st.floats(-5.0, -1.3).map(lambda x: 10.0**x), st.floats(-1e-3, 0.0)),
)


@settings(max_examples=300, deadline=None)
@given(orbits, st.floats(-20.0, 20.0))
def test_limits_of_orbits(one: Elements, days: float) -> None:
    """Distance and latitude stay within their bounds, days from the elements and as they decay."""
    satellites = one.satellites()
    place, _, codes = states_together(
        satellites, since_epochs_s(satellites, EPOCH) + 86_400.0 * days, AT
    )
    place = place[codes == WHOLE]
    if not len(place):
        return
    radius = np.sqrt(np.sum(place**2, axis=-1))
    motion, ecc, tilt = one.mean[:, 5], one.mean[:, 1], one.mean[:, 3]
    within = np.array([max(abs(days), abs(days + 1.0))])
    low, high = radius_bounds_m(motion, ecc, tilt, one.mean[:, 0], within)
    assert low[0] <= radius.min()
    assert radius.max() <= high[0]
    latitude = np.abs(np.arcsin(place[:, 2] / radius)).max()
    assert latitude <= latitude_bound_rad(tilt, motion, within)[0]


def test_apogees_before_the_epoch_of_orbits_that_decay() -> None:
    """What SGP4's drag adds backwards grows at first, then falls: its ends alone bound nothing."""
    rng = np.random.default_rng(7)
    for _ in range(600):
        turns, bstar = tuple(rng.uniform(0.0, 1.0, 3)), 10.0 ** rng.uniform(-2.5, -1.2)
        tilt_deg, days = rng.uniform(0.0, 120.0), rng.uniform(1.0, 20.0)
        one = _orbit(rng.uniform(170.0, 280.0), rng.uniform(0.02, 0.25), tilt_deg, turns, bstar)
        satellites, (bstar_, ecc, _, tilt, _, motion, _) = one.satellites(), one.mean.T
        since = since_epochs_s(satellites, EPOCH) - 86_400.0 * days
        place, _, codes = states_together(satellites, since, AT)
        _, high = radius_bounds_m(motion, ecc, tilt, bstar_, np.array([days]))
        assert np.linalg.norm(place[codes == WHOLE], axis=-1).max(initial=0.0) <= high[0]


@settings(max_examples=100, deadline=None)
@given(orbits, st.floats(-90.0, 90.0), st.floats(0.0, 80.0))
def test_what_never_rises_does_not(one: Elements, latitude_deg: float, lowest_deg: float) -> None:
    """From no longitude of a parallel does anything that is pruned stand above the elevation."""
    lat, lowest = np.radians(latitude_deg), np.radians(lowest_deg)
    days = np.array([1.0])
    bstar, ecc, _, tilt, _, motion, _ = one.mean.T
    _, high = radius_bounds_m(motion, ecc, tilt, bstar, days)
    reach = latitude_bound_rad(one.mean[:, 3], one.mean[:, 5], days)
    if not never_rises(lat, 0.0, lowest, high, reach)[0]:
        return
    satellites = one.satellites()
    place, _, codes = states_together(satellites, since_epochs_s(satellites, EPOCH), AT)
    place = place[codes == WHOLE]
    # the best longitude: that of the satellite itself
    across = np.hypot(place[:, 0], place[:, 1])
    n = 6_378_137.0 / np.sqrt(1.0 - 0.006_694_38 * np.sin(lat) ** 2)
    x = across - n * np.cos(lat)
    z = place[:, 2] - n * (1.0 - 0.006_694_38) * np.sin(lat)
    sine = (x * np.cos(lat) + z * np.sin(lat)) / np.hypot(x, z)
    assert (sine < np.sin(lowest)).all()


def pruned_and_seen(w: Watcher, objects: Elements) -> tuple[np.ndarray, np.ndarray]:
    """Which objects are pruned, and the numbers of those that are seen at SNR 20 without."""
    watch, satellites = w.watch(AT), objects.satellites()
    place, speed, codes = states_together(satellites, since_epochs_s(satellites, EPOCH), AT)
    who, when = np.nonzero(codes == WHOLE)
    s = sights_of(
        w, watch, when, who, place[who, when], speed[who, when], objects.reflecting_m2[who],
        objects.shaded[who],
    )  # fmt: skip
    seen = np.unique(s.object[s.snr >= 20.0])
    return never_seen(w, watch, objects, 20.0), seen


def test_pruned_objects_are_never_seen() -> None:
    """Of many objects those that are pruned have no sight at all, and some are pruned."""
    w = watcher(tracks=True, lowest_elevation_deg=10.0)
    objects = synthetic_elements(Synthetic(objects=150, seed=8, smallest_m=0.02), EPOCH)
    pruned, seen = pruned_and_seen(w, objects)
    assert 20 < pruned.sum() < 140
    assert len(seen)
    assert not pruned[seen].any()


def test_a_satellite_on_a_long_orbit_comes_near() -> None:
    """From a height of 1,000 to 20,000 km: what it sees at its nearest is not pruned."""
    orbit = {"kind": "keplerian", "semi_major_axis_m": 16.9e6, "eccentricity": 0.56,
             "inclination_deg": 70.0, "true_anomaly_deg": 100.0}  # fmt: skip
    asked = sections(observer={"kind": "orbit", "orbit": orbit})
    w = make_watcher(asked, FieldOfRegard(), EPOCH, True)
    objects = synthetic_elements(Synthetic(objects=400, seed=8, smallest_m=0.03), EPOCH)
    pruned, seen = pruned_and_seen(w, objects)
    assert 20 < pruned.sum() < 380
    assert len(seen) > 20
    assert not pruned[seen].any()


def test_bounds_hold_at_the_farther_end() -> None:
    """Of elements from before, from within and from after a watch of four days."""
    made = synthetic_elements(Synthetic(objects=3), EPOCH)
    made.jd2[:] += [-10.0, 1.5, 20.0]
    w = watcher()
    np.testing.assert_allclose(_days(w, w.watch(np.array([0.0, 345_600.0])), made), [14, 2.5, 20])


def test_what_the_air_lifts_into_view_is_not_pruned() -> None:
    """An object whose reach ends between what is seen with the air's lift and without."""
    w = watcher(lowest_elevation_deg=5.0)
    latitude, height_m = np.radians(w.observer.latitude_deg), w.observer.height_m
    made, watch = synthetic_elements(Synthetic(objects=60, seed=3), EPOCH), w.watch(AT)
    days = _days(w, watch, made)
    made.mean[:, 3] = np.linspace(0.0, 0.5 * latitude, 60)  # tilts
    made.mean[:, 5], made.mean[:, 1] = 16.1 * 2.0 * np.pi / 1440.0, 0.0005
    bstar, ecc, _, tilt, _, motion, _ = made.mean.T
    _, high = radius_bounds_m(motion, ecc, tilt, bstar, days)
    reach = latitude_bound_rad(made.mean[:, 3], made.mean[:, 5], days)
    bare, lifted = (
        never_rises(latitude, height_m, np.radians(5.0) - lift, high, reach)
        for lift in (0.0, MOST_LIFT_RAD)
    )
    assert (bare & ~lifted).any()
    assert not never_seen(w, watch, made, 0.0)[~lifted].any()
