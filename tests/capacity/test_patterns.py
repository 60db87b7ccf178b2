"""Where searches look and when: against astropy's horizon, ring and Sun."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import astropy.coordinates as coord
import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time

from pipeline.capacity.course import StudyCourse, make_course
from pipeline.capacity.patterns import Slots, _times, in_fields, slots_of
from pipeline.errors import BadInput
from pipeline.physics.vectors import from_angles, separation

pytestmark = pytest.mark.usefixtures("coarse_signal")
Data = dict[str, Any]
Array = np.ndarray
SITE = coord.EarthLocation.from_geodetic(-156.3, 20.7, 3055.0)
PIXEL_RAD = 13.5e-6 / 0.1
HIGH, WIDE = 2 * np.arctan(512 * PIXEL_RAD / 2), 2 * np.arctan(1024 * PIXEL_RAD / 2)
OVERLAP, RATE_DEG_S, SETTLE_S, DWELL_S = 0.25, 2.0, 4.0, 5.0


@pytest.fixture
def course(data: Data, tmp_path: Path) -> Any:
    """A maker of courses: three cameras of 512 rows and 1,024 columns at the site."""

    def make(**tasking: Any) -> StudyCourse:
        camera = data["cameras"][0]
        camera["sensor"] = camera["sensor"] | {"focal_length_m": 0.1, "shape": [512, 1024]}
        camera["tracking"] = "sidereal"
        data["sensors"][0]["count"] = 3
        data["sensors"][0]["slewing"] = {"rate_deg_s": RATE_DEG_S, "settle_s": SETTLE_S}
        data["tasking"] = {"kind": "serendipitous", "overlap": OVERLAP} | tasking
        return make_course(data, tmp_path)

    return make


def along(slots: Slots) -> Array:
    """Middles of fields (q, 3), GCRS."""
    return np.einsum("nij,nj->ni", slots.watch.to_gcrs, slots.axes[:, 2])


def when(slots: Slots) -> Any:
    return Time("2019-04-20T06:00:00") + slots.watch.offset_s * u.s


STRIDE = HIGH * (1.0 - OVERLAP)  # the shorter side, less what neighbours share


def places(span_deg: float) -> tuple[int, float]:
    """How many fields there are, and the seconds from one to the next."""
    count = int(np.ceil(np.radians(span_deg) / STRIDE))
    step_deg = span_deg / count if count > 1 else 0.0
    return count, step_deg / RATE_DEG_S + SETTLE_S + DWELL_S


def test_fields_follow_each_other(course: Any) -> None:
    """Evenly from one end to the other, back at the slew's rate, and again; sensors of one count a
    third of the way apart."""
    made = course(pattern="fence", from_deg=20.0, to_deg=80.0, azimuth_deg=110.0)
    count, each_s = places(60.0)
    back_s = 60.0 * (count - 1) / count / RATE_DEG_S + SETTLE_S + DWELL_S
    numbers = []
    for unit in range(3):
        slots = slots_of(made, 0, unit)
        at = slots.watch.offset_s
        assert at[0] == pytest.approx(0.5 * each_s)
        assert at[-1] < 360 * 60.0
        after = slots_of(made, 1, unit).watch.offset_s
        assert after[0] >= 360 * 60.0
        up = np.einsum("nij,nj->ni", slots.watch.to_gcrs, slots.watch.up)
        height = 90.0 - np.degrees(separation(along(slots), up))
        number = (height - 20.0) / 60.0 * count - 0.5
        np.testing.assert_allclose(number, np.round(number), atol=1e-6)
        numbers.append(np.round(number).astype(int))
        np.testing.assert_array_equal(np.diff(numbers[-1]) % count, 1)
        wanted_s = np.where(numbers[-1] == count - 1, back_s, each_s)
        np.testing.assert_allclose(np.diff([*at, after[0]]), wanted_s, rtol=1e-6)
    assert [n[0] for n in numbers] == [0, count // 3, 2 * count // 3]
    np.testing.assert_allclose(slots.frame_s, [-2.0, 0.0, 2.0])


def test_more_fields_than_are_held_are_refused(
    course: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of fields of an arcsecond along the sky."""
    count, _ = places(60.0)
    for most, ok in ((count, True), (count - 1, False), (0, False)):
        monkeypatch.setattr("pipeline.capacity.fields.MOST_FIELDS", most)
        made = course(pattern="fence", from_deg=20.0, to_deg=80.0, azimuth_deg=110.0)
        if ok:
            assert made.rounds[0].fields == count
            continue
        with pytest.raises(BadInput, match=r"^tasking: .* fields of .*at most"):
            _ = made.rounds


@pytest.mark.parametrize("first", [0, 3, 6])
def test_no_dwell_is_lost_between_windows(first: int) -> None:
    """Wherever in a round a window begins and ends."""
    count, each_s, back_s = 7, 10.0, 4.5
    edges = np.arange(0.0, 2000.0, 33.0)
    windows = [_times(*ends, count, first, each_s, back_s) for ends in pairwise(edges)]
    number, at = (np.concatenate(column) for column in zip(*windows, strict=True))
    np.testing.assert_array_equal(np.diff(number), 1)
    wanted_s = np.where(number[1:] % count == 0, each_s + back_s, each_s)
    np.testing.assert_allclose(np.diff(at), wanted_s)
    assert number[0] == first
    assert at[0] == 0.5 * each_s
    assert at[-1] >= edges[-1] - each_s - back_s


def test_a_slew_is_as_long_as_the_fields_are_apart(course: Any) -> None:
    """Of one field it is none; of two nearer than a field is wide, by their angle."""
    for span_deg, apart_deg in ((1.0, 0.0), (4.0, 2.0)):
        made = course(pattern="fence", from_deg=30.0, to_deg=30.0 + span_deg, azimuth_deg=110.0)
        slots = slots_of(made, 0, 0)
        turned = separation(slots.axes[:-1, 2], slots.axes[1:, 2])
        wanted_s = apart_deg / RATE_DEG_S + SETTLE_S + DWELL_S
        np.testing.assert_allclose(np.diff(slots.watch.offset_s), wanted_s)
        assert np.degrees(turned).max() < apart_deg + 0.1  # the sky turns


def test_the_dwells_of_a_search_are_forecast_and_few_enough(
    course: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = course(pattern="fence", from_deg=30.0, to_deg=31.0, azimuth_deg=110.0)
    dwells = sum(len(slots_of(made, window, unit).watch.offset_s)
                 for window in range(made.windows) for unit in range(3))  # fmt: skip
    seconds = sum(one.dwells_s for one in made.rounds[:3]) * made.hours * 3600.0
    assert dwells == pytest.approx(seconds, rel=0.01)
    monkeypatch.setattr("pipeline.capacity.course.DWELL_CPU_S", 1.0)
    assert made.forecast["cpu_s"] > dwells
    monkeypatch.setattr("pipeline.capacity.course.MOST_DWELLS", 100)
    again = course(pattern="fence", from_deg=30.0, to_deg=31.0, azimuth_deg=110.0)
    with pytest.raises(BadInput, match=r"step_s: .*dwells of one in 360 steps.* at most 100"):
        _ = again.forecast


@pytest.mark.parametrize(
    "search", [{"pattern": "fence", "from_deg": 5.0, "to_deg": 15.0, "azimuth_deg": 90.0},
               {"pattern": "belt", "from_deg": 0.0, "to_deg": 30.0}],
)  # fmt: skip
def test_a_search_that_can_see_nothing_is_refused(course: Any, search: Data) -> None:
    """Below what the sensor may look at, or below its horizon."""
    with pytest.raises(BadInput, match=r"tasking: .* of which no field is ever within its field"):
        course(**search)


def test_a_fence_stands_in_its_azimuth(course: Any) -> None:
    slots = slots_of(course(pattern="fence", from_deg=20.0, to_deg=80.0, azimuth_deg=110.0), 0, 0)
    place, _ = SITE.get_gcrs_posvel(when(slots))
    far = 1e12 * u.m * along(slots).T + place.xyz  # so that no parallax is added
    seen = coord.GCRS(*far, representation_type="cartesian", obstime=when(slots))
    told = seen.transform_to(coord.AltAz(obstime=when(slots), location=SITE))
    off = (told.az.deg - 110.0) * np.cos(told.alt.rad)
    assert np.abs(off).max() < 0.02
    across = np.einsum("ni,ni->n", slots.axes[:, 0], slots.watch.up)
    assert np.abs(across).max() < 1e-9  # rows lie level


@pytest.mark.parametrize("latitude_deg", [-90.0, -89.9999, 20.7])
def test_a_fence_stands_in_its_azimuth_at_a_pole(
    course: Any, data: Data, latitude_deg: float
) -> None:
    """Where polar motion turns what counts as north: from the site's own axes in astropy's Earth,
    at a pole by its longitude."""
    longitude_deg = 40.0
    data["sensors"][0]["field_of_regard"] = {"twilight_deg": 0.0}
    site = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "height_m": 0.0}
    data["sensors"][0]["observer"] = {"kind": "ground", **site}
    slots = slots_of(course(pattern="fence", from_deg=20.0, to_deg=80.0, azimuth_deg=110.0), 0, 0)
    far = coord.GCRS(*1e12 * u.m * along(slots).T, representation_type="cartesian",
                     obstime=when(slots))  # fmt: skip
    fixed = far.transform_to(coord.ITRS(obstime=when(slots)))
    x, y, z = fixed.cartesian.xyz.to_value(u.m) / 1e12
    sl, cl, sp, cp = (f(np.radians(a)) for a in (longitude_deg, latitude_deg)
                      for f in (np.sin, np.cos))  # fmt: skip
    north, east = -sp * cl * x - sp * sl * y + cp * z, cl * y - sl * x
    height = np.arcsin(cp * cl * x + cp * sl * y + sp * z)
    off = (np.degrees(np.arctan2(east, north)) - 110.0) * np.cos(height)
    assert np.abs(off).max() < 1e-4


@pytest.mark.parametrize(
    ("azimuth_deg", "north", "east"), [(0.0, 1, 0), (90.0, 0, 1), (180.0, -1, 0)]
)
def test_a_fence_of_a_satellite_is_by_the_equators_pole(
    course: Any, data: Data, azimuth_deg: float, north: int, east: int
) -> None:
    """On an orbit in the equator: north is the pole, east is where the satellite goes."""
    orbit = {"kind": "keplerian", "semi_major_axis_m": 7.5e6, "eccentricity": 0.0,
             "inclination_deg": 0.0, "true_anomaly_deg": 0.0}  # fmt: skip
    data["sensors"][0]["observer"] = {"kind": "orbit", "orbit": orbit}
    made = course(pattern="fence", from_deg=20.0, to_deg=80.0, azimuth_deg=azimuth_deg)
    slots = slots_of(made, 0, 0)
    look, up = slots.axes[:, 2], slots.watch.up
    level = np.cos(np.arcsin(np.einsum("ni,ni->n", look, up)))
    forward = np.stack([-up[:, 1], up[:, 0]], axis=1) / np.hypot(up[:, 0], up[:, 1])[:, None]
    np.testing.assert_allclose(look[:, 2], north * level, atol=3e-3)  # the pole has moved since
    along = np.einsum("ni,ni->n", look[:, :2], forward)
    np.testing.assert_allclose(along, east * level, atol=3e-3)


def test_a_belt_is_the_geostationary_ring(course: Any) -> None:
    slots = slots_of(course(pattern="belt", from_deg=-200.0, to_deg=-110.0), 0, 1)
    grid = np.radians(np.linspace(-200.0, -110.0, 9001))
    site = np.array([c.to_value(u.m) for c in SITE.geocentric])
    path = 42_164_172.0 * from_angles(grid, np.zeros_like(grid)) - site
    share = separation(path[1:], path[:-1]).max() / (grid[1] - grid[0])
    assert 1.12 < share < 1.18  # the ring is nearer to the site than to the Earth's middle
    count, _ = places(90.0 * share)
    number = (np.arange(len(slots.watch.offset_s)) + count // 3) % count
    longitude = np.radians(-200.0 + (number + 0.5) * 90.0 / count)
    ring = 42_164_172.0 * from_angles(longitude, np.zeros_like(longitude))
    itrs = coord.ITRS(*(ring.T * u.m), obstime=when(slots))
    there = itrs.transform_to(coord.GCRS(obstime=when(slots))).cartesian.xyz.to_value(u.m)
    here = SITE.get_gcrs_posvel(when(slots))[0].xyz.to_value(u.m)
    assert np.degrees(separation(along(slots), (there - here).T)).max() < 0.005
    fields = 42_164_172.0 * from_angles(np.unique(longitude), np.zeros(count)) - site
    apart = separation(fields[1:], fields[:-1])
    assert 0.96 * STRIDE < apart.max() < STRIDE + 1e-6


def test_a_strip_is_opposite_the_sun(course: Any) -> None:
    slots = slots_of(course(pattern="strip", from_deg=-40.0, to_deg=20.0, declination_deg=12.0),
                     0, 0)  # fmt: skip
    count, _ = places(60.0 * np.cos(np.radians(12.0) - 0.5 * HIGH))
    number = np.arange(len(slots.watch.offset_s)) % count
    offset = -40.0 + (number + 0.5) * 60.0 / count
    sun = coord.get_sun(when(slots)).ra.deg
    wanted = from_angles(np.radians(sun + 180.0 + offset), np.full(len(sun), np.radians(12.0)))
    assert np.degrees(separation(along(slots), wanted)).max() < 0.02


@pytest.mark.parametrize("declination", [-45.0, 70.0])
def test_fields_of_a_strip_overlap_as_asked(course: Any, declination: float) -> None:
    """On the side next to the equator, where their circle is widest: no less, hardly more."""
    tasking = {"from_deg": -60.0, "to_deg": 60.0, "declination_deg": declination}
    fields = along(slots_of(course(pattern="strip", **tasking), 0, 0))[:2]
    step = separation(fields[0], fields[1]) / np.cos(np.radians(declination))
    widest = step * np.cos(np.radians(abs(declination)) - 0.5 * HIGH)
    assert 0.94 * STRIDE < widest < 1.001 * STRIDE


def test_frames_in_a_field_that_moves() -> None:
    """Objects that stand still before a camera whose site moves by half a field between frames:
    what lies in the field of each frame, by hand."""
    axes = np.eye(3)[None]  # across x, up y, along z
    away = 1e7
    x = np.array([-0.019, 0.0, 0.019, 0.0, 0.0]) * away
    y = np.array([0.0, 0.0, 0.0, 0.009, 0.011]) * away
    place = np.stack([x, y, np.full(5, away)], axis=1)[:, None].repeat(3, axis=1)
    near = np.zeros((5, 3), bool)
    near[:, 1] = True  # either side of a step is enough
    motion = np.array([[0.01 * away, 0.0, 0.0]])
    for middle in (30.0, 90.0):
        rows, _ = in_fields(
            place, np.zeros_like(place), near, 0.0, 60.0, np.array([middle]), axes,
            np.zeros((1, 3)), motion, np.array([-1.0, 0.0, 1.0]), np.array([0.02, 0.01]),
        )  # fmt: skip
        frames = dict(zip(rows[:, 0].tolist(), rows[:, 2].tolist(), strict=True))
        assert frames == {0: 2, 1: 3, 2: 2, 3: 3}
