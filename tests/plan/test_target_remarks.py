"""Old elements, far orbits, shadows and places that cannot be: told or refused, by name."""

from __future__ import annotations

import copy
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sgp4.api import WGS72, Satrec

from pipeline.errors import BadInput
from pipeline.execute.truth import target_truth
from pipeline.physics.positions.orbit_two_body import two_body
from pipeline.physics.targets.sphere import sphere_intensity_per_irradiance
from pipeline.plan.bodies.sights import sights
from pipeline.plan.bodies.sizes import limb_px, radius_m
from pipeline.plan.pointing.geometry import moments_at, plan_geometry
from pipeline.plan.targets.bounds import (
    _lowest_m,
    between_facets,
    earthshine_share,
    longest_from_elements_s,
    two_body_m,
)
from pipeline.plan.targets.decisions import _largest_px
from pipeline.plan.targets.orbit_age import (
    _aged,
    elements_error_m,
    oldest_remarks,
    sensor_remarks,
    two_body_remarks,
)
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Target
from pipeline.spec.targets.orbit import TleOrbit

GEO_M = 4.2164e7
SCENE: dict[str, Any] = {
    "schema": "nightglass/scene/1", "name": "remarks", "epoch": "2019-03-21T09:00:00Z",
    "accept": ["sun", "moon"],
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 10.0, "focal_length_m": 1.0, "aperture_m": 0.2,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "target", "target": "t"},
    "exposure": {"integration_s": 0.1, "frames": 3, "cadence_s": 1.0},
}  # fmt: skip
TUBE = {"kind": "cylinder", "diameter_m": 1.0, "length_m": 4.0, "albedo": 0.4,
        "attitude": {"kind": "spin", "rate_deg_s": 2.0, "axis": [1, 0, 0]}}  # fmt: skip
TLE = {
    "kind": "tle",
    "line1": "1 25544U 98067A   19100.50000000  .00001500  00000-0  30000-4 0  9990",
    "line2": "2 25544  51.6400 200.0000 0002000  90.0000 270.0000 15.52000000    10",
}  # fmt: skip


def checksum(line: str) -> str:
    digits = sum(int(c) if c.isdigit() else c == "-" for c in line[:68])
    return line[:68] + str(digits % 10)


def state(place: list[float], speed: list[float]) -> dict[str, Any]:
    return {"kind": "state", "position_m": place, "velocity_m_s": speed}


def target(orbit: dict[str, Any], diameter_m: float = 1.0, name: str = "t") -> dict[str, Any]:
    body = {"kind": "sphere", "diameter_m": diameter_m, "albedo": 0.3}
    return {"name": name, "orbit": orbit, "body": body}


def planned(targets: list[dict[str, Any]], **changes: Any) -> Any:
    return prepare(parse_scene(copy.deepcopy(SCENE) | {"targets": targets} | changes)).plan


def table(times_s: tuple[float, ...], speeds: bool) -> dict[str, Any]:
    """Rows of a geostationary orbit around the scene's epoch."""
    place, speed = two_body(
        np.array([GEO_M, 0.0, 0.0]), np.array([0.0, 3074.66, 0.0]), np.array(times_s)
    )
    rows = np.hstack([np.array(times_s)[:, None], place.round(2), *([speed] if speeds else [])])
    return {"kind": "table", "epoch": SCENE["epoch"], "rows": rows.tolist()}


def test_tables_too_coarse_for_a_pixel_are_told() -> None:
    """A pixel is 10 urad, 400 m there; two rows are judged as those of a free orbit."""
    near = {"kind": "orbit", "orbit": state([7e6, 1e6, 0.0], [0.0, 0.0, 7.5e3])}
    minutes = tuple(60.0 * k for k in range(-20, 20))
    hole = tuple(t if t < 0.0 else t + 12.0 * 3600.0 for t in minutes)

    def told(times_s: tuple[float, ...], speeds: bool = False) -> tuple[Any, float]:
        plan = planned([target(table(times_s, speeds))], observer=near)
        (bound,) = [d.bound for d in plan.decisions if d.component == "targets.ephemeris"]
        return [w for w in plan.warnings if "rows of its table" in w], bound

    assert told(minutes)[0] == []
    (warning,), bound = told((-300.0, 300.0))
    assert bound == pytest.approx(0.5 * 0.2242 * 300.0**2, rel=1e-3)
    assert warning.startswith("t: the rows of its table are too few to judge by; if it is a free")
    assert "1e+04 m off between them, up to " in warning
    words, bound = told((-300.0, 300.0), speeds=True)
    assert (words, bound) == ([], pytest.approx(0.40, abs=0.01))
    (warning,), _ = told(hole)
    assert warning.startswith("t: the rows of its table may be ")
    watched = planned(
        [target(state([0.0, GEO_M, 0.0], [-3074.66, 0.0, 0.0]))],
        observer={"kind": "orbit", "orbit": table((-300.0, 300.0), False)},
    )
    assert [w for w in watched.warnings if w.startswith("the observer: the rows")]


def test_elements_of_seven_years_ago_are_told_with_their_error():
    lines = {"kind": "tle", "line1": checksum(TLE["line1"]), "line2": checksum(TLE["line2"])}
    fresh = planned([target(lines)], epoch="2019-04-11T09:00:00Z")
    assert not [r for r in fresh.remarks if "elements of" in r]
    old = planned([target(lines)], epoch="2026-04-11T09:00:00Z")
    (told,) = [r for r in old.remarks if "elements of" in r]
    assert told.startswith("t: elements of 255")
    assert " km off" in told
    assert " px at " in told
    assert elements_error_m(2556.0, 15.52) == pytest.approx(7.669e6, rel=1e-3)
    assert elements_error_m(1e5, 15.52) == pytest.approx(2 * 6.79e6, rel=2e-3)  # the orbit itself


@pytest.mark.parametrize("order", [1, -1])
def test_the_oldest_elements_of_many_are_told(order: int) -> None:
    """Wherever they stand in the scene."""
    second = checksum(TLE["line2"])
    each = [
        target(
            {"kind": "tle", "line1": checksum(TLE["line1"].replace("19100", day)), "line2": second},
            name=f"of-day-{day}",
        )
        for day in ("19080", "19050", "19001", "19060")[::order]  # the first is fresh
    ]
    held = {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 20.0}
    scene = parse_scene(SCENE | {"targets": each, "pointing": held})
    (told,) = oldest_remarks(scene, 0.0, 2.1)
    assert told.startswith("3 of the targets have old elements, the worst of-day-19001: ")
    means = {
        "epoch": "2018-12-01T00:00:00Z", "mean_motion_rev_day": 15.0, "eccentricity": 0.001,
        "inclination_deg": 50, "raan_deg": 0, "argument_of_perigee_deg": 0, "mean_anomaly_deg": 0,
    }  # fmt: skip
    omm = target({"kind": "omm", "elements": means}, name="omm")
    scene = parse_scene(SCENE | {"targets": [*each, omm], "pointing": held})
    (told,) = oldest_remarks(scene, 0.0, 2.1)
    assert told.startswith("4 of the targets have old elements, the worst omm: ")


def test_an_orbit_beyond_the_earths_reach_is_told():
    """4.4 million km away for a day: the Sun pulls it off by half a t^2."""
    far = state([4.4e9, 0.0, 0.0], [0.0, 100.0, 0.0]) | {"epoch": "2019-03-20T09:00:00Z"}
    (told,) = [r for r in planned([target(far)]).remarks if "sphere of influence" in r]
    km = 0.5 * 2.0 * 1.327e20 * 4.4e9 / 1.496e11**3 * 86402.1**2 / 1e3
    assert f"{km:.3g} km after 1 days" in told
    near = state([4.2e7, 0.0, 0.0], [0.0, 3070.0, 0.0])
    assert not [r for r in planned([target(near)]).remarks if "influence" in r]


@pytest.mark.parametrize(("pulls", "told"), [([], 1), (["moon"], 1), (["sun", "moon"], 0)])
def test_beyond_the_earths_reach_the_suns_pull_counts(pulls: list[str], told: int) -> None:
    far = state([4.4e9, 0.0, 0.0], [0.0, 100.0, 0.0])
    orbit = far | {"kind": "numerical", "third_bodies": pulls}
    remarks = planned([target(orbit)]).remarks
    assert sum("neglects the Sun's pull" in remark for remark in remarks) == told


def behind(at_rad: float) -> dict[str, Any]:
    """At GEO, at an angle in the equator from the direction away from the Sun at the equinox."""
    c, s = np.cos(np.pi + at_rad), np.sin(np.pi + at_rad)
    return state([GEO_M * c, GEO_M * s, 0.0], [-3074.7 * s, 3074.7 * c, 0.0])


def test_a_target_in_the_umbra_is_named_with_the_light_that_is_left_out():
    shown = target(state([GEO_M, 0.0, 0.0], [0.0, 3074.7, 0.0]), name="lit")
    plan = planned([target(behind(0.0)), shown], pointing={"mode": "target", "target": "lit"})
    (told,) = [r for r in plan.remarks if "Earth's shadow" in r]
    assert told.startswith("t: in the Earth's shadow during all frames looked at (3): no light")
    found = {d.component: d for d in plan.decisions}["targets.umbra_light"]
    assert not found.kept
    g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
    assert g.target_light[0].max() == 0.0
    phase, range_m = g.target_phase_rad[0, 0, 4], g.target_range_m[0, 0, 4]
    sphere = np.array(phase), np.array(1.0), np.array(0.3)
    intensity = float(sphere_intensity_per_irradiance(*sphere))
    full = intensity / range_m**2 * plan.sun_rate_e_s_m2 * plan.facts.area_m2 * 0.1
    assert found.bound == pytest.approx(1e-4 * full, rel=0.02)  # deep: what is scattered alone
    lit = planned([shown], pointing={"mode": "target", "target": "lit"})
    assert "targets.umbra_light" not in {d.component for d in lit.decisions}


def test_a_target_that_leaves_the_umbra_is_named_too():
    """At GEO the umbra ends 8.7 degrees from the middle: 35 minutes of an orbit."""
    shown = target(state([GEO_M, 0.0, 0.0], [0.0, 3074.7, 0.0]), name="lit")
    long = {"integration_s": 1.0, "frames": 2, "cadence_s": 5400.0}
    plan = planned(
        [target(behind(0.0)), shown], exposure=long, pointing={"mode": "target", "target": "lit"}
    )
    g = plan_geometry(plan.scene, np.arange(2), 0.0)
    assert (g.target_sunlit[0] == 0.0).all(axis=1).tolist() == [True, False]
    assert "targets.umbra_light" in {d.component for d in plan.decisions}
    assert not [r for r in plan.remarks if "during all frames" in r]


def test_light_in_the_umbra_is_that_of_the_longest_exposure():
    """Four times the exposure in one of two dwells: four times the light that is left out."""
    shown = target(state([GEO_M, 0.0, 0.0], [0.0, 3074.7, 0.0]), name="lit")
    bounds = []
    for longest_s in (0.1, 0.4):
        dwells = [{"integration_s": 0.1}, {"integration_s": longest_s, "start_s": 5.0}]
        plan = planned(
            [target(behind(0.0)), shown], dwells=dwells, exposure={"integration_s": 0.1},
            pointing={"mode": "target", "target": "lit"},
        )  # fmt: skip
        bounds.append({d.component: d for d in plan.decisions}["targets.umbra_light"].bound)
    assert bounds[1] == pytest.approx(4.0 * bounds[0], rel=1e-3)


OBSERVER = [7.0e6, 0.0, 0.0], [0.0, 7546.0, 0.0]


def test_an_observer_inside_a_target_is_refused_by_name():
    orbiting = {"kind": "orbit", "orbit": state(*OBSERVER)}
    place = state([7.0e6, 30.0, 0.0], OBSERVER[1])
    with pytest.raises(BadInput, match=r"targets\.0.*inside of t, 30 m.*own radius \(50 m\)"):
        planned([target(place, 100.0)], observer=orbiting)
    planned([target(place, 50.0)], observer=orbiting)


def test_an_observer_at_a_targets_place_is_refused():
    orbiting = {"kind": "orbit", "orbit": state(*OBSERVER)}
    with pytest.raises(BadInput, match=r"targets\.0.*at one place with t"):
        planned([target(state(*OBSERVER))], observer=orbiting, pointing={
            "mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": 20.0})  # fmt: skip


@pytest.mark.parametrize("diameter_m", [0.2, 60.0, 99.0])
def test_the_radius_of_a_near_body_is_that_of_its_limb(diameter_m):
    """asin(r/d) of a line that touches it, on a gnomonic focal plane; r/d is 70% off at 99 m."""
    orbiting = {"kind": "orbit", "orbit": state(*OBSERVER)}
    sensor = SCENE["sensor"] | {"focal_length_m": 0.001}
    place = state([7.0e6, 0.0, 60.0], OBSERVER[1])
    plan = planned([target(place, diameter_m)], observer=orbiting, sensor=sensor)
    truth = target_truth(plan, plan_geometry(plan.scene, np.zeros(1, int), 0.0))
    angle = np.arctan(truth["radius_px"][0] * plan.facts.ifov_rad)
    assert angle == pytest.approx(np.arcsin(0.5 * diameter_m / truth["range_m"][0]), rel=1e-9)


def test_the_radius_of_several_parts_is_that_of_the_largest() -> None:
    small, large = ({"kind": "sphere", "diameter_m": d, "albedo": 0.3} for d in (1.0, 4.0))
    for parts in ([small, large], [large, small]):
        one = target(state(*OBSERVER)) | {"body": {"kind": "composite", "parts": parts}}
        assert radius_m(Target.model_validate(one).body) == 2.0


@pytest.mark.parametrize(
    ("shape", "radius"),
    [({"kind": "plate", "area_m2": 2.0}, 1.0), ({"kind": "box", "size_m": [4.0, 6.0, 12.0]}, 7.0),
     ({"kind": "cube", "edge_m": 2.0}, 3.0**0.5)],
)  # fmt: skip
def test_the_radius_of_a_flat_body_is_that_of_its_farthest_corner(
    shape: dict[str, Any], radius: float
) -> None:
    """From its middle: half the diagonal, of a plate that of a square."""
    one = target(state(*OBSERVER)) | {"body": shape | {"albedo": 0.3}}
    assert radius_m(Target.model_validate(one).body) == pytest.approx(radius, rel=1e-12)


def test_limits_of_limbs():
    assert limb_px(1.0, 1e8, 1e-5) == pytest.approx(1e-3, rel=1e-12)
    assert np.isinf(limb_px(2.0, 1.0, 1e-5))
    assert limb_px(0.0, 0.0, 1e-5) == 0.0


@pytest.mark.parametrize(
    ("days", "rev_day", "km"),
    [(10.0, 1.0027, 6.0), (-10.0, 15.5, 31.0), (10.0, 6.5, 31.0), (-10.0, 6.3, 6.0)],
)  # fmt: skip
def test_low_orbits_age_faster(days: float, rev_day: float, km: float) -> None:
    """1 km at the epoch; 3 km a day below 225 minutes' period (6.4 a day), else 0.5."""
    assert elements_error_m(days, rev_day) == pytest.approx(1e3 * km, rel=1e-12)


@pytest.mark.parametrize(
    ("epoch", "told"),
    [("2019-04-13T11:59:50Z", None), ("2019-04-13T11:59:59Z", "before the scene's end"),
     ("2019-04-07T12:00:01Z", None), ("2019-04-07T11:59:59Z", "after the scene's end")],
)  # fmt: skip
def test_elements_are_old_from_three_days_on(epoch: str, told: str | None) -> None:
    """Elements of 10 April, 12:00; the scene lasts 2.1 s."""
    scene = parse_scene(SCENE | {"epoch": epoch, "targets": [target(TLE)]})
    found = _aged(scene, TleOrbit(**{k: v if k == "kind" else checksum(v) for k, v in TLE.items()}))
    assert (found is None) if told is None else (found is not None and told in found[1])


def test_elements_are_as_old_as_the_times_that_count() -> None:
    """Fresh in the scene, of 4 days at the end of what is asked for."""
    scene = parse_scene(SCENE | {"epoch": "2019-04-10T12:00:00Z", "targets": [target(TLE)]})
    orbit = TleOrbit(**{k: v if k == "kind" else checksum(v) for k, v in TLE.items()})
    assert _aged(scene, orbit) is None
    found = _aged(scene, orbit, 0.0, 4.0 * 86_400.0)
    assert found is not None
    assert found[1].startswith("elements of 4 days before ")


@pytest.mark.parametrize("anomaly_deg", [0.0, 70.0, 180.0, 250.0])
@pytest.mark.parametrize(("perigee_m", "e"), [(6.9e6, 0.001), (6.9e6, 0.5)])
def test_what_two_body_motion_leaves_out_is_bounded(
    perigee_m: float, e: float, anomaly_deg: float
) -> None:
    """An hour after the state, against integration of zonal harmonics, Sun and Moon."""
    mu, nu, tilt = 3.986004418e14, np.radians(anomaly_deg), np.radians(63.0)
    p = perigee_m * (1.0 + e)
    turn = np.array([[1.0, 0.0], [0.0, np.cos(tilt)], [0.0, np.sin(tilt)]])
    place = turn @ (p / (1.0 + e * np.cos(nu)) * np.array([np.cos(nu), np.sin(nu)]))
    speed = turn @ (np.sqrt(mu / p) * np.array([-np.sin(nu), e + np.cos(nu)]))
    start = state(place.tolist(), speed.tolist()) | {"epoch": "2019-03-21T08:00:00Z"}
    forced = start | {"kind": "numerical", "third_bodies": ["sun", "moon"]}
    there = [target(start, name="plain"), target(forced, name="forced")]
    scene = parse_scene(SCENE | {"targets": there, "pointing": {
        "mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": 60.0}})  # fmt: skip
    assert _lowest_m(scene.targets[0].orbit, 1e9) == pytest.approx(perigee_m, rel=1e-9)
    at = moments_at(scene, 0.0, np.array([2.1]))
    places = sights(scene, [0, 1], at)[1].place_m
    off_m = float(np.linalg.norm(places[0] - places[1]))
    bound = two_body_m(scene.targets[:1], scene, plan_geometry(scene, np.arange(3), 0.0))
    assert off_m <= bound <= 2e3 * off_m


def test_elements_are_right_at_their_perigee() -> None:
    """A day before, given either way: the same bound; it grows with the square of time."""
    shape = {
        "kind": "keplerian", "perigee_radius_m": 7e6, "eccentricity": 0.1, "inclination_deg": 9.0,
    }  # fmt: skip
    bounds = []
    for days, phase in (
        (1, {"epoch": "2019-03-20T09:00:00Z", "true_anomaly_deg": 0.0}),
        (1, {"time_of_perigee": "2019-03-20T09:00:00Z"}),
        (2, {"time_of_perigee": "2019-03-19T09:00:00Z"}),
    ):
        one = target(shape | phase)
        scene = parse_scene(SCENE | {"epoch": "2019-03-21T09:00:00Z", "targets": [one]})
        g = plan_geometry(scene, np.arange(3), 0.0)
        bounds.append(two_body_m(scene.targets, scene, g) / days**2)
    assert bounds == pytest.approx([bounds[0]] * 3, rel=1e-3)


@pytest.mark.parametrize("kind", ["keplerian", "perigee", "state"])
@pytest.mark.parametrize(
    ("axis_m", "e", "tilt_deg"), [(7.158e6, 0.001, 98.6), (2.66e7, 0.5, 30.0), (7e6, 0.0, 90.0)]
)
def test_a_sensor_without_oblateness_is_doubted(
    kind: str, axis_m: float, e: float, tilt_deg: float
) -> None:
    """By the secular rates that SGP4 itself works out for such elements, to second order; 5 days
    with the day from the epoch of the elements on."""
    mu, tilt, days = 3.986004418e14, np.radians(tilt_deg), 5.0
    if kind == "state":  # at perigee, on the x axis
        speed = np.sqrt(mu / axis_m * (1.0 + e) / (1.0 - e))
        orbit = state([axis_m * (1.0 - e), 0.0, 0.0],
                      [0.0, speed * np.cos(tilt), speed * np.sin(tilt)])  # fmt: skip
    else:
        size = {"semi_major_axis_m": axis_m} if kind == "keplerian" else (
            {"perigee_radius_m": axis_m * (1.0 - e)})  # fmt: skip
        orbit = size | {"kind": "keplerian", "eccentricity": e, "inclination_deg": tilt_deg,
                        "true_anomaly_deg": 0.0}  # fmt: skip
    observer = {"kind": "orbit", "orbit": orbit | {"epoch": "2019-03-20T09:00:00Z"}}
    scene = parse_scene(SCENE | {"observer": observer, "targets": [target(TLE)]})
    (told,) = sensor_remarks(scene, 0.0, (days - 1.0) * 86_400.0)
    numbers = [float(n) for n in re.findall(r"in ([\d.]+) days|by (-?[\d.e+-]+) deg|"
               r"to ([\d.e+-]+) km|about ([\d.e+-]+) km", told) for n in n if n]  # fmt: skip
    one = Satrec()
    motion = np.sqrt(mu / axis_m**3) * 60.0
    one.sgp4init(WGS72, "i", 0, 25000.0, 0.0, 0.0, 0.0, e, 0.0, tilt, 0.0, motion, 0.0)
    minutes = days * 1440.0
    plain = one.a**-1.5 / one.tumin  # of two-body motion on its mean axis
    node, along = one.nodedot * minutes, (one.argpdot + one.mdot - plain) * minutes
    chords = [2e-3 * axis_m * np.sin(0.5 * min(abs(v), np.pi)) for v in (node, along)]
    expected = [days, np.degrees(node), *chords]
    assert numbers == pytest.approx(expected, rel=0.02, abs=1e-3)


def test_a_sensor_that_went_round_is_off_by_the_diameter() -> None:
    """In a year a sun-synchronous node comes back to where it was; in between it was opposite."""
    orbit = {"kind": "keplerian", "semi_major_axis_m": 7.158e6, "eccentricity": 0.001,
             "inclination_deg": 98.6, "true_anomaly_deg": 0.0,
             "epoch": "2019-03-20T09:00:00Z"}  # fmt: skip
    observer = {"kind": "orbit", "orbit": orbit}
    scene = parse_scene(SCENE | {"observer": observer, "targets": [target(TLE)]})
    (told,) = sensor_remarks(scene, 0.0, 365.25 * 86_400.0)
    assert re.findall(r"(\S+) km", told) == ["1.43e+04", "1.43e+04"]


def test_sensors_that_need_no_doubt() -> None:
    """A site; a state for some seconds; fresh elements, but not those that are 7 days old."""
    site = {"kind": "ground", "latitude_deg": 0.0, "longitude_deg": 0.0}
    orbit = {k: v if k == "kind" else checksum(v) for k, v in TLE.items()}
    for observer, epoch, told in (
        (site, "2019-04-10T12:00:00Z", []),
        ({"kind": "orbit", "orbit": state(*OBSERVER)}, "2019-04-10T12:00:00Z", []),
        ({"kind": "orbit", "orbit": orbit}, "2019-04-10T12:00:00Z", []),
        ({"kind": "orbit", "orbit": orbit}, "2019-04-17T12:00:00Z", [
            "its own orbit: elements of 7 days before the times asked for: SGP4 is expected to be "
            "22 km off"]),
    ):  # fmt: skip
        asked = {"observer": observer, "epoch": epoch, "targets": [target(TLE)]}
        scene = parse_scene(SCENE | asked)
        assert sensor_remarks(scene, 0.0, 8.0) == told


def test_old_elements_of_a_sensor_without_targets_are_told_alone() -> None:
    """No range tells how large their error looks."""
    orbit = {k: v if k == "kind" else checksum(v) for k, v in TLE.items()}
    held = {"mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": -90.0}
    asked = {"observer": {"kind": "orbit", "orbit": orbit}, "pointing": held}
    (told,) = planned([], **asked, epoch="2019-04-17T12:00:00Z").remarks
    assert told == (
        "the observer: elements of 7 days before the scene's end: SGP4 is expected to be 22 km off"
    )


def test_old_elements_of_a_sensor_are_told_as_the_nearest_target_shows_them() -> None:
    orbit = {k: v if k == "kind" else checksum(v) for k, v in TLE.items()}
    held = {"mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": -90.0}
    both = [
        target(state([0.0, 0.0, -far], [1500.0, 0.0, 0.0]), name=name)
        for name, far in (("u", 9e7), ("t", 5e7))
    ]
    asked = {"observer": {"kind": "orbit", "orbit": orbit}, "pointing": held}
    plan = planned(both, **asked, epoch="2019-04-17T12:00:00Z")
    (told,) = [r for r in plan.remarks if r.startswith("the observer: elements of 7 days")]
    ranges = plan_geometry(plan.scene, np.arange(3), plan.dut1_s).target_range_m.min(axis=(1, 2))
    assert ranges[1] < 0.7 * ranges[0]
    assert told.endswith(f" px at {ranges[1]:.3g} m")


@pytest.mark.parametrize(
    ("place_m", "speed_m_s", "days"), [(7e6, 12e3, 30.0), (5e8, 892.0, 42.0)],
    ids=["it escapes", "so far out that it drifts by less than a kilometre"],
)  # fmt: skip
def test_orbits_that_no_oblateness_turns(place_m: float, speed_m_s: float, days: float) -> None:
    """As a sensor's they need no doubt; as a target's their bound is told."""
    orbit = state([place_m, 0.0, 0.0], [0.0, 0.0, speed_m_s])
    both = {"observer": {"kind": "orbit", "orbit": orbit}, "targets": [target(orbit)]}
    scene = parse_scene(SCENE | both)
    assert sensor_remarks(scene, 0.0, days * 86_400.0) == []
    (told,) = two_body_remarks(scene, 0.0, days * 86_400.0)
    assert "worst t: two-body motion, without the Earth's oblateness, Moon and Sun, is up" in told


@pytest.mark.parametrize(("day", "longest_s"), [("20", 86_402.1), ("22", 86_400.0)])
def test_a_state_is_right_at_its_epoch_alone(day: str, longest_s: float) -> None:
    """Before it as after it, whichever end of the scene is farther from it."""
    orbit = state(*OBSERVER) | {"epoch": f"2019-03-{day}T09:00:00Z"}
    scene = parse_scene(SCENE | {"targets": [target(orbit)]})
    found = longest_from_elements_s(scene, scene.targets[0].orbit)
    assert found == pytest.approx(longest_s, abs=1e-3)


def test_earthshine_is_bounded_by_the_brightest_earth_asked_for() -> None:
    """Of two targets, in any order: albedo (R/r)^2, and a hundredth of it to spare; the same seen
    from near the Earth and from two astronomical units off, while the Earth goes on."""
    asked = [
        target(behind(0.0), name=f"a{albedo}") | {"lighting": {"earthshine_albedo": albedo}}
        for albedo in (0.1, 0.6)
    ]
    for order in (1, -1):
        held = {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 20.0}
        near = {"observer": {"kind": "orbit", "orbit": state(*OBSERVER)}, "pointing": held}
        for observer in (near, {"pointing": held}):
            scene = parse_scene(SCENE | observer | {"targets": asked[::order]})
            share = earthshine_share(scene.targets, plan_geometry(scene, np.arange(3), 0.0))
            assert share == pytest.approx(1.01 * 0.6 * (6.378e6 / GEO_M) ** 2, rel=1e-3)


def test_a_shape_drawn_as_a_point_is_as_large_as_it_comes_near() -> None:
    """The radius told is that of the nearest moment of any frame, of a range that changes."""
    scene = parse_scene(SCENE | {"targets": [target(behind(0.0)) | {"body": TUBE}]})
    g = plan_geometry(scene, np.arange(3), 0.0)
    g.target_range_m[:] *= np.linspace(1.0, 5.0, g.target_range_m.size).reshape(
        g.target_range_m.shape
    )
    nearest_m, radius_m = float(g.target_range_m.min()), 0.5 * float(np.hypot(1.0, 4.0))
    facts: Any = SimpleNamespace(ifov_rad=1e-9)
    assert _largest_px(scene, facts, g) == pytest.approx(radius_m / nearest_m / 1e-9, rel=1e-6)


def test_light_between_matt_facets() -> None:
    """The largest albedo of bodies and parts, a / (1 - a); no bound of one that has a gloss."""
    gloss = {"kind": "phong", "diffuse": 0.1, "specular": 0.1, "exponent": 10}

    def made(surface: dict[str, Any]) -> Target:
        part = {"name": "p", "objects": ["P"], "materials": {"a": surface}}
        body = {"kind": "mesh", "path": "a.obj", "unit": "m", "parts": [part],
                "surface": {"kind": "lambert", "albedo": 0.2}}  # fmt: skip
        return Target.model_validate(target(state(*OBSERVER)) | {"body": body})

    def bound(**surface: Any) -> float | None:
        return between_facets([made(surface)]).bound

    assert bound(kind="lambert", albedo=0.6) == pytest.approx(1.5)
    assert bound(kind="lambert", albedo=0.1) == pytest.approx(0.25)
    assert bound(kind="lambert", albedo=1.0) is None
    assert bound(**gloss) is None
    many = [made({"kind": "lambert", "albedo": a}) for a in (0.1, 0.8, 0.5)]
    assert between_facets(many).bound == pytest.approx(4.0)
