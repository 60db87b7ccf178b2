"""Bodies in orbit: laws and parts put together, periods, tables, lighting, and a render."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from scipy.spatial.transform import Rotation

from pipeline.errors import BadInput
from pipeline.inputs.band.curves import solar_spectrum
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.radiometry import box
from pipeline.physics.targets.frustum import cylinder_area_function
from pipeline.physics.targets.plate import box_area_function
from pipeline.physics.targets.shadow import moon_m, sunlit_past_earth, sunlit_past_moon
from pipeline.physics.targets.sphere import sphere_intensity_per_irradiance
from pipeline.physics.vectors import unit
from pipeline.plan.bodies.albedos import has_band_albedos, with_band_albedos
from pipeline.plan.bodies.attitudes import View, needs_velocity
from pipeline.plan.bodies.bodies import (
    _finer,
    _sunlit,
    earthshine_m2_sr,
    flicker_share,
    target_lights,
)
from pipeline.plan.bodies.orbits import Movers, orbit_states
from pipeline.plan.bodies.shapes import light_curve_m2_sr, reflected_m2_sr
from pipeline.plan.bodies.sights import sights
from pipeline.plan.pointing.geometry import moments_at, plan_geometry
from pipeline.spec.load import parse_scene
from pipeline.spec.targets.body import Body, Lighting
from pipeline.spec.targets.orbit import KeplerianOrbit, StateOrbit, TleOrbit
from tests.physics.positions.test_orbit_skyfield import tle

EPOCH = parse_utc("2019-07-20T09:00:00Z")
AU = 1.495978707e11


def body(**values: Any) -> Any:
    return TypeAdapter(Body).validate_python({"albedo": 0.3} | values)


def circular(times: np.ndarray, radius: float = 7e6, rows: int = 1) -> View:
    """An inclined circular orbit, seen from a site that stands still; the Sun off its plane."""
    rate = np.sqrt(3.986004418e14 / radius**3)
    a, b = np.array([1.0, 0, 0]), unit(np.array([0.0, 1, 1]))
    angle = rate * times[:, None]
    place = radius * (np.cos(angle) * a + np.sin(angle) * b)
    speed = radius * rate * (np.cos(angle) * b - np.sin(angle) * a)
    sun, site = AU * unit(np.array([1.0, 0.2, 0.4])), np.array([6.378e6, 1e5, 2e5])
    each = (times, place, speed, np.broadcast_to(sun, place.shape), 0 * place + site)
    return View(*(np.broadcast_to(v, (rows, *v.shape)) for v in each))


TIMES = np.linspace(0.0, 500.0, 401)
Z = np.array([0.0, 0.0, 1.0])
SKY = {
    "schema": "nightglass/scene/1",
    "name": "bodies",
    "epoch": "2019-07-20T09:00:00Z",
    "observer": {
        "kind": "orbit",
        "orbit": {"kind": "state", "position_m": [4.2e7, -4e5, 0], "velocity_m_s": [0, 3075, 0]},
    },
    "sensor": {
        "shape": [256, 256],
        "pixel_pitch_um": 9.0,
        "focal_length_m": 0.5,
        "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "target", "target": "t"},
    "exposure": {"integration_s": 2.0, "frames": 3, "cadence_s": 30.0},
    "background": {"uniform_e_per_s": 9.0},
}
TARGET = {
    "name": "t",
    "orbit": {"kind": "state", "position_m": [4.2e7, 0, 0], "velocity_m_s": [0, 3070, 0]},
}


def test_against_scipy_a_spinning_box() -> None:
    view = circular(TIMES)
    q, axis, rate, phase = [0.3, -0.2, 0.9, 0.1], [1.0, 2.0, -0.5], 7.3, 40.0
    law = {"kind": "spin", "rate_deg_s": rate, "axis": axis, "phase_deg": phase, "quaternion": q}
    ours = reflected_m2_sr([body(kind="box", size_m=[1, 2, 3], attitude=law)], EPOCH, view)[0]
    start = Rotation.from_quat(np.roll(q, -1))
    turn = Rotation.from_rotvec(np.radians(rate * TIMES + phase)[:, None] * unit(np.array(axis)))
    back = (start * turn).inv()
    s, o = back.apply(view.sun[0]), back.apply(view.observer[0])
    np.testing.assert_allclose(ours, 0.3 / np.pi * box_area_function(s, o, [1, 2, 3]), rtol=1e-9)


def test_same_after_a_turn_of_a_spinning_box() -> None:
    times = np.arange(0.0, 200.0, 0.25)
    fixed = circular(np.zeros(1))
    still = View(*(np.repeat(getattr(fixed, n), times.size, axis=1) for n in
                   ("time_s", "place_m", "velocity_m_s", "sun_m", "observer_m")))  # fmt: skip
    view = View(times[None], *(getattr(still, n) for n in
                               ("place_m", "velocity_m_s", "sun_m", "observer_m")))  # fmt: skip
    law = {"kind": "spin", "rate_deg_s": 9.0, "axis": [1, 1, 0]}
    light = reflected_m2_sr([body(kind="box", size_m=[1, 2, 3], attitude=law)], EPOCH, view)[0]
    np.testing.assert_allclose(light[160:], light[:-160], rtol=1e-9, atol=1e-12)  # 40 s
    assert np.ptp(light) > 0.1 * light.mean()
    a_quarter_on = law | {"epoch": "2019-07-20T08:59:50Z"}
    late = reflected_m2_sr(
        [body(kind="box", size_m=[1, 2, 3], attitude=a_quarter_on)], EPOCH, view
    )[0]
    np.testing.assert_allclose(late[:-40], light[40:], rtol=1e-9, atol=1e-12)
    assert np.abs(late[40:] - light[:-40]).max() > 0.1 * light.mean()


def test_same_parts_and_their_sum() -> None:
    """A composite of parts with their own laws is the sum of its parts as bodies of their own."""
    laws = [{"kind": "nadir"}, {"kind": "sun"}, {"kind": "velocity", "quaternion": [1, 0, 1, 0]},
            {"kind": "sun_tracking", "bus": "velocity", "axis": [1, 0, 0]},
            {"kind": "inertial", "quaternion": [1, 2, 3, 4]}]  # fmt: skip
    parts: list[dict[str, Any]] = [{"kind": "sphere", "diameter_m": 0.5, "albedo": 0.7}]
    shapes = [{"kind": "plate", "area_m2": 2.0}, {"kind": "cube", "edge_m": 1.0},
              {"kind": "cylinder", "diameter_m": 1.0, "length_m": 3.0, "closed": "top"},
              {"kind": "frustum", "base_diameter_m": 1, "top_diameter_m": 2,
               "length_m": 1}]  # fmt: skip
    parts += [s | {"albedo": 0.2, "attitude": law} for s in shapes for law in laws]
    whole = TypeAdapter(Body).validate_python({"kind": "composite", "parts": parts})
    single = [TypeAdapter(Body).validate_python(p) for p in parts]
    together = reflected_m2_sr([whole], EPOCH, circular(TIMES))[0]
    apart = reflected_m2_sr(single, EPOCH, circular(TIMES, rows=len(single)))
    np.testing.assert_allclose(together, apart.sum(axis=0), rtol=1e-12)
    one = np.stack([reflected_m2_sr([b], EPOCH, circular(TIMES))[0] for b in single])
    np.testing.assert_array_equal(apart, one)  # however many are worked out together
    assert np.count_nonzero(apart.sum(axis=1)) > 10


@pytest.mark.parametrize(
    ("law", "follows"),
    [({"kind": "nadir"}, True), ({"kind": "velocity"}, True), ({"kind": "inertial"}, False),
     ({"kind": "sun_tracking", "bus": "nadir", "axis": [1, 0, 0]}, True),
     ({"kind": "sun_tracking", "bus": "inertial", "axis": [1, 0, 0]}, False)],
)  # fmt: skip
def test_any_part_may_follow_the_orbit(law: dict[str, Any], follows: bool) -> None:
    parts = [{"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2},
             {"kind": "plate", "area_m2": 1.0, "albedo": 0.2},
             {"kind": "plate", "area_m2": 1.0, "albedo": 0.2, "attitude": law}]  # fmt: skip
    whole = {"kind": "composite", "parts": parts, "attitude": {"kind": "inertial"}}
    assert needs_velocity(TypeAdapter(Body).validate_python(whole)) is follows


def test_same_light_by_the_definitions_of_laws() -> None:
    view = circular(TIMES)
    s, o, place = view.sun[0], view.observer[0], unit(view.place_m[0])

    def lambert(normal: np.ndarray) -> np.ndarray:
        n = unit(normal)
        return 0.3 / np.pi * np.maximum(np.sum(n * s, -1), 0) * np.maximum(np.sum(n * o, -1), 0)

    for law, normal in (
        ({"kind": "nadir"}, -place),
        ({"kind": "nadir", "quaternion": [0, 1, 0, 0]}, place),
        ({"kind": "velocity"}, view.velocity_m_s[0]),
        ({"kind": "sun"}, s),
        ({"kind": "inertial"}, np.broadcast_to(Z, s.shape)),
        ({"kind": "sun_tracking", "bus": "inertial", "axis": [0, 0, 1]}, s * [1, 1, 0]),
    ):
        ours = reflected_m2_sr([body(kind="plate", area_m2=1.0, attitude=law)], EPOCH, view)[0]
        np.testing.assert_allclose(ours, lambert(normal), atol=1e-14)
    table = {"kind": "table", "times_s": [0, 500], "quaternions": [[1, 0, 0, 0], [0, 0, 0, 1]]}
    tube = body(kind="cylinder", diameter_m=2.0, length_m=4.0, attitude=table)
    plain = 0.3 / np.pi * cylinder_area_function(s, o, 1.0, 4.0)  # turning about its own axis
    np.testing.assert_allclose(reflected_m2_sr([tube], EPOCH, view)[0], plain, rtol=1e-9)
    with pytest.raises(BadInput, match=r"times_s.*covers the exposures"):
        reflected_m2_sr([tube], EPOCH, circular(TIMES + 1.0))


@pytest.mark.parametrize("anomaly", ["true_anomaly_deg", "mean_anomaly_deg"])
def test_an_anomaly_is_that_of_the_elements_own_epoch(anomaly: str) -> None:
    """Ten minutes before the scene's: where it is ten minutes after one of the scene's."""
    shape = {"kind": "keplerian", "semi_major_axis_m": 7.2e6, "eccentricity": 0.05,
             "inclination_deg": 50.0, anomaly: 70.0}  # fmt: skip
    early = TypeAdapter(KeplerianOrbit).validate_python(shape | {"epoch": "2019-07-20T08:50:00Z"})
    own = TypeAdapter(KeplerianOrbit).validate_python(shape)
    at, late = np.array([0.0, 30.0]), np.array([600.0, 630.0])
    found = orbit_states(early, "orbit", EPOCH, at, instants(EPOCH, at))
    wanted = orbit_states(own, "orbit", EPOCH, late, instants(EPOCH, late))
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-6)


def test_a_table_of_attitudes_counts_from_its_own_epoch() -> None:
    """One of 100 s before the scene's tells of each moment what the scene's does 100 s later."""
    fixed, times = circular(np.zeros(1)), np.arange(0.0, 400.0, 10.0)
    still = [np.repeat(getattr(fixed, name), times.size, axis=1) for name in
             ("place_m", "velocity_m_s", "sun_m", "observer_m")]  # fmt: skip
    view = View(times[None], *still)
    law = {"kind": "table", "times_s": [0, 600], "quaternions": [[1, 0, 0, 0], [0.6, 0.8, 0, 0]]}
    own, early = (
        reflected_m2_sr([body(kind="box", size_m=[1, 2, 3], attitude=law | more)], EPOCH, view)[0]
        for more in ({}, {"epoch": "2019-07-20T08:58:20Z"})
    )
    np.testing.assert_allclose(early[:-10], own[10:], rtol=1e-9)
    assert np.ptp(own) > 0.01 * own.mean()


def test_parts_without_a_law_have_that_of_the_whole() -> None:
    box, law = {"kind": "box", "size_m": [1, 2, 3], "albedo": 0.2}, {"kind": "nadir"}
    whole = {"kind": "composite", "attitude": law, "parts": [box]}
    made = TypeAdapter(Body).validate_python(whole), body(**box, attitude=law), body(**box)
    together, alone, upright = (reflected_m2_sr([one], EPOCH, circular(TIMES))[0] for one in made)
    np.testing.assert_allclose(together, alone, rtol=1e-12)
    assert np.abs(together - upright).max() > 0.01


def test_bodies_are_seen_as_they_stood_when_the_light_left() -> None:
    """From 1.2 au the light takes minutes."""
    far = {"observer": {"kind": "fixed", "position_au": [1.2, 0.1, 0.05]}}
    scene = parse_scene(SKY | far | {"targets": [TARGET | {"body": {
        "kind": "sphere", "diameter_m": 1.0, "albedo": 0.5}}]})  # fmt: skip
    seen, view = sights(scene, [0], moments_at(scene, 0.0, np.array([0.0, 30.0])))
    light_s = seen.range_m / 299_792_458.0
    assert light_s.min() > 100.0
    np.testing.assert_allclose(view.time_s, [0.0, 30.0] - light_s, atol=1e-6)


def test_the_moon_hides_a_darkened_sun() -> None:
    """Half of its radius before the disc's edge: less of the light than of the area."""
    tt, sun = EPOCH, AU * unit(np.array([[1.0, 0.2, 0.4]]))
    moon = moon_m(np.array([tt[0]]), np.array([tt[1]]))
    towards, across = unit(sun - moon), unit(np.cross(sun - moon, Z))
    place = moon - 3e8 * towards + 1.0e6 * across
    for darkening in (0.0, 0.6):
        light = Lighting(limb_darkening=darkening, moon=True)
        found = _sunlit(light, place, sun, (np.array([tt[0]]), np.array([tt[1]])))
        assert found == pytest.approx(sunlit_past_moon(place, sun, moon, darkening))
        assert 0.05 < found[0] < 0.95


@pytest.mark.parametrize(
    "asked", [{"moon": True}, {"limb_darkening": 0.6}, {"oblate_earth": True, "moon": True}]
)
def test_each_option_of_lighting_counts_by_itself_in_the_earths_penumbra(
    asked: dict[str, Any],
) -> None:
    """Behind the pole, 0.002 rad beside where the limb stands before the Sun's middle."""
    tt, sun = tuple(np.array([t]) for t in EPOCH), AU * unit(np.array([[1.0, 0.2, 0.0]]))
    off = np.arcsin(6.378137e6 / 4.2164e7) + 0.002
    place = 4.2164e7 * (np.sin(off) * Z - np.cos(off) * unit(sun))
    found, light = [], Lighting(**asked)
    assert _finer(light)
    for darkening in (0.0, 0.6):
        for oblate in (False, True):
            found.append(sunlit_past_earth(place, sun, darkening, oblate)[0])
    assert np.diff(np.sort(found)).min() > 0.01
    own = found[2 * bool(light.limb_darkening) + bool(light.oblate_earth)]
    assert _sunlit(light, place, sun, tt) == pytest.approx(own, abs=1e-3)


@pytest.mark.parametrize(("closed", "area_m2"), [("base", np.pi), ("none", 0.0)])
def test_a_cone_from_behind(closed: str, area_m2: float) -> None:
    """Lit and seen along its axis: the disc of its base, or nothing where that is open."""
    along = np.array([[[0.0, 0.0, -1.0]]])
    view = View(np.zeros((1, 1)), 0 * along, 0 * along, AU * along, 1e7 * along)
    cone = body(kind="cone", diameter_m=2.0, length_m=3.0, closed=closed)
    assert reflected_m2_sr([cone], EPOCH, view)[0] == pytest.approx(0.3 / np.pi * area_m2)


def test_light_curves() -> None:
    times = np.linspace(0, 10, 11)
    table = {"kind": "light_curve", "times_s": [0, 10], "magnitudes": [4, 5]}
    curve = TypeAdapter(Body).validate_python(table)
    value = light_curve_m2_sr(curve, EPOCH, times, np.full(11, 0.5))
    magnitude = -26.76 - 2.5 * np.log10(value / 1e6**2)
    np.testing.assert_allclose(magnitude, 4 + times / 10, atol=1e-12)
    with pytest.raises(BadInput, match="covers the exposures"):
        light_curve_m2_sr(curve, EPOCH, times + 1e-3, times)
    again = curve.model_copy(update={"period_s": 12.0})
    np.testing.assert_allclose(light_curve_m2_sr(again, EPOCH, times + 24, times), value, rtol=1e-9)
    assert light_curve_m2_sr(again, EPOCH, np.array([11.0]), times[:1])[0] == pytest.approx(
        float(np.sqrt(value[0] * value[-1]))
    )  # the gap is bridged to the next turn
    ball = curve.model_copy(update={"phase_law": "lambert", "magnitudes": (4.0, 4.0)})
    phases = np.linspace(0, np.pi, 11)
    np.testing.assert_allclose(
        light_curve_m2_sr(ball, EPOCH, times, phases) / value[0],
        sphere_intensity_per_irradiance(phases, 1, 1) / sphere_intensity_per_irradiance(0, 1, 1),
        rtol=1e-12,
    )
    line = ball.model_copy(update={"phase_law": "linear", "mag_per_deg": 0.02, "phase_deg": 90.0})
    fainter = light_curve_m2_sr(line, EPOCH, times[:1], np.radians([140.0]))[0]
    assert -2.5 * np.log10(fainter / value[0]) == pytest.approx(1.0)


def test_a_light_curve_fades_by_the_phase_of_its_own_target() -> None:
    """Not by that of the target which the scene lists first."""
    times = np.linspace(0.0, 10.0, 3)
    low, high = circular(times), circular(times, 4.2e7)
    view = View(*(np.concatenate([getattr(v, f) for v in (low, high)]) for f in (
        "time_s", "place_m", "velocity_m_s", "sun_m", "observer_m")))  # fmt: skip
    table = {"kind": "light_curve", "times_s": [0, 10], "magnitudes": [4, 4],
             "phase_law": "linear", "mag_per_deg": 0.02, "phase_deg": 90.0}  # fmt: skip
    curve = TypeAdapter(Body).validate_python(table)
    value = reflected_m2_sr([body(kind="sphere", diameter_m=1.0), curve], EPOCH, view)[1]
    sun, site = (unit(getattr(high, f)[0] - high.place_m[0]) for f in ("sun_m", "observer_m"))
    phase_deg = np.degrees(np.arccos(np.sum(sun * site, axis=-1)))
    magnitude = -26.76 - 2.5 * np.log10(value / 1e6**2)
    np.testing.assert_allclose(magnitude, 4.0 + 0.02 * (phase_deg - 90.0), atol=1e-9)


@pytest.mark.parametrize("begins_s", [0.0, -3.0, 1000.3])
def test_a_light_curve_over_one_period_is_repeated_as_given(begins_s: float) -> None:
    """With the span as its period it jumps back from its last value to its first."""
    given = {"times_s": [begins_s + t for t in (0.0, 5.0, 10.0)], "magnitudes": [5.0, 6.0, 7.0]}
    span_s = given["times_s"][-1] - given["times_s"][0]
    table = {"kind": "light_curve", **given, "period_s": span_s}
    curve = TypeAdapter(Body).validate_python(table)
    since_s = np.array([0.5, 2.5, 4.9, 5.1, 9.9])
    for turn in (-3, 0, 1, 40):
        at = begins_s + since_s + turn * span_s
        value = light_curve_m2_sr(curve, EPOCH, at, 0 * at)
        magnitude = -26.76 - 2.5 * np.log10(value / 1e6**2)
        np.testing.assert_allclose(magnitude, 5.0 + since_s / 5.0, atol=1e-9)


def scene_of(target_body: dict[str, Any], **changes: Any) -> Any:
    return parse_scene(SKY | {"targets": [TARGET | {"body": target_body} | changes]})


def test_a_target_faster_than_light_is_named_among_others() -> None:
    """By its own field, though it is the first of its kind and the second of all."""
    line1, line2 = tle(7, 51.6, 10.0, 0.001, 20.0, 30.0, 15.2)
    slow = TleOrbit(kind="tle", line1=line1, line2=line2)
    fast = KeplerianOrbit(kind="keplerian", perigee_radius_m=1e3, eccentricity=1e6,
                          inclination_deg=0.0, true_anomaly_deg=0.0)  # fmt: skip
    movers = Movers([slow, fast], ["targets.0.orbit", "targets.1.orbit"], EPOCH,
                    instants(EPOCH, np.zeros(1), 0.0))  # fmt: skip
    with pytest.raises(BadInput, match=r"targets\.1\.orbit\.eccentricity.*below that of light"):
        movers.states(np.zeros((2, 1)))


def test_a_state_that_cannot_be_carried_is_named_by_a_field_that_it_has() -> None:
    """Not by the eccentricity of another kind of orbit."""
    state = StateOrbit(kind="state", position_m=(4e7, 0.0, 0.0), velocity_m_s=(0.0, 2e8, 0.0))
    movers = Movers([state], ["targets.0.orbit"], EPOCH, instants(EPOCH, np.zeros(1), 0.0))
    with np.errstate(all="ignore"), pytest.raises(BadInput) as told:
        movers.states(np.full((1, 1), np.inf))
    assert str(told.value) == (
        "targets.0.orbit.velocity_m_s: (0.0, 200000000.0, 0.0) is not accepted; "
        "allowed: a speed that stays below that of light"
    )


def test_band_albedos() -> None:
    plate = {"kind": "plate", "area_m2": 1.0, "attitude": {"kind": "sun"}}
    table = plate | {"albedo": [[300, 0.1], [1000, 0.8]]}
    scene = scene_of({"kind": "composite", "parts": [plate | {"albedo": 0.2}, table]})
    wavelength, sun, _, _ = solar_spectrum()
    assert has_band_albedos(scene)
    grey = with_band_albedos(scene, wavelength, sun, box(400e-9, 900e-9))
    assert not has_band_albedos(grey)
    assert with_band_albedos(grey, wavelength, sun, box(400e-9, 900e-9)) is grey
    fine = np.linspace(400e-9, 900e-9, 200_001)
    photons = np.interp(fine, wavelength, sun) * fine
    mean = np.sum(photons * np.interp(fine * 1e9, [300, 1000], [0.1, 0.8])) / np.sum(photons)
    assert grey.targets[0].body.parts[1].albedo == pytest.approx(mean, rel=1e-5)
    assert grey.targets[0].body.parts[0].albedo == 0.2
    with pytest.raises(BadInput, match=r"targets\.0\.body\.parts\.1\.albedo.*whole band"):
        with_band_albedos(scene, wavelength, sun, box(400e-9, 1100e-9))
    with pytest.raises(BadInput, match="with_band_albedos"):
        plan_geometry(scene, np.arange(3), 0.0)


def test_lighting_options_in_a_scene() -> None:
    ball = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.5}
    plain, finer, lit = (
        plan_geometry(scene_of(ball, **more), np.arange(3), 0.0)
        for more in (
            {},
            {"lighting": {"oblate_earth": True, "limb_darkening": 0.6, "moon": True}},
            {"lighting": {"earthshine_albedo": 0.3}},
        )
    )
    np.testing.assert_array_equal(plain.target_light, finer.target_light)  # in full sunlight
    extra = lit.target_light / plain.target_light - 1
    assert np.all((extra > 1e-5) & (extra < 0.05))
    # full Earth on a sphere that the observer sees from the Earth's side: 0.5% of sunlight at GEO
    view = circular(np.zeros(1), 4.2164e7)
    towards = View(
        view.time_s, view.place_m, view.velocity_m_s, view.place_m * 3000, 0 * view.sun_m
    )
    sphere = body(**ball)
    glow = earthshine_m2_sr(sphere, EPOCH, towards, 0.3)[0]
    full = sphere_intensity_per_irradiance(0.0, 1.0, 0.5)
    assert glow / full == pytest.approx(0.3 * (6.378e6 / 4.2164e7) ** 2 * 2 / 3 * 1.114, rel=0.03)


def test_known_lights_are_taken_and_the_mesh_is_not_asked() -> None:
    """A table's intensities in sunlight and in earthshine; the mesh has not even been read."""
    unread = {"kind": "mesh", "path": "none.obj", "unit": "m"}
    (target,) = scene_of(unread, lighting={"earthshine_albedo": 0.3}, eclipse=False).targets
    at = circular(np.linspace(0.0, 30.0, 3))
    sun, reach = at.sun_m[0], np.array([[1e6, 2e6, 3e6]])
    known = np.array([[2.0, 0.5], [3.0, 0.0], [0.0, 0.25]])
    tt = np.full(3, 2458684.5), np.full(3, 0.375)
    asked = [target], ["targets.0"], EPOCH, at, sun, tt, reach
    light, _, _ = target_lights(*asked, known={0: known})
    from_sun = np.linalg.norm(sun - at.place_m[0], axis=-1)
    of_earth = np.linalg.norm(sun, axis=-1)
    expected = AU**2 * (known[:, 0] / from_sun**2 + known[:, 1] / of_earth**2) / reach**2
    np.testing.assert_allclose(light, expected, rtol=1e-9)
    with pytest.raises(BadInput, match="a mesh that has been read"):
        target_lights(*asked)


def test_what_a_body_sends_besides_earthshine_is_its_sunlight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nothing in the shadow: a mesh's earthshine there errs by a share of itself alone."""
    asked: list[np.ndarray] = []

    def ask(*given: Any) -> np.ndarray:
        asked.append(given[5])
        return np.zeros(len(given[5]))

    monkeypatch.setattr("pipeline.plan.bodies.bodies.earthshine_m2_sr", ask)
    ball = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.5}
    (target,) = scene_of(ball, lighting={"earthshine_albedo": 0.3}).targets
    at = circular(np.linspace(0.0, 5800.0, 40))
    sun, reach = at.sun_m[0], np.full((1, 40), 2e6)
    tt = np.full(40, 2458684.5), np.full(40, 0.375)
    light, _, lit = target_lights([target], ["targets.0"], EPOCH, at, sun, tt, reach)
    assert (lit.min(), lit.max()) == (0.0, 1.0)
    from_sun = np.linalg.norm(sun - at.place_m[0], axis=-1)
    np.testing.assert_allclose(asked[0], light[0] * reach[0] ** 2 * (from_sun / AU) ** 2, rtol=1e-9)
    assert (asked[0][lit[0] == 0.0] == 0.0).all()


def test_flicker_says_whether_the_nodes_suffice() -> None:
    """The light of an exposure from its nodes, against very many of them."""
    for rate, few in ((0.5, True), (170.0, False)):
        law = {"kind": "spin", "rate_deg_s": rate, "axis": [1, 0.3, 0], "phase_deg": 17}
        scene = scene_of({"kind": "box", "size_m": [1, 2, 3], "albedo": 0.5, "attitude": law})
        g = plan_geometry(scene, np.arange(3), 0.0)
        share = flicker_share(g)
        assert (share < 1e-3) is few
        light = g.target_light[0] * g.target_range_m[0] ** 2
        ours = (0.5 * (light[:, 1:] + light[:, :-1])).mean(axis=1)
        fine = []
        for start in (0.0, 30.0, 60.0):
            at = np.linspace(start, start + 2.0, g.nodes)
            dense = np.linspace(start, start + 2.0, 20_001)
            columns = [
                np.stack([np.interp(dense, at, v[:, k]) for k in range(3)], -1)[None]
                for v in _vectors(scene, start, g.nodes)
            ]
            emitted = dense - np.interp(dense, at, g.target_range_m[0, len(fine)]) / 299_792_458.0
            smooth = View(emitted[None], *columns)
            fine.append(reflected_m2_sr([scene.targets[0].body], EPOCH, smooth)[0].mean())
        ratio = ours / np.array(fine)
        assert np.ptp(ratio) / ratio.mean() < 2 * share + 1e-4


def _vectors(scene: Any, start: float, nodes: int) -> Any:
    """Place, velocity, Sun and observer (nodes, 3) as the geometry has them."""
    from pipeline.physics.positions.apparent import apparent_sun_m
    from pipeline.physics.positions.earth import earth_and_sun
    from pipeline.physics.positions.orbit import two_body
    from pipeline.physics.positions.times import instants

    at = start + np.linspace(0, 2, nodes)
    t = instants(EPOCH, at)
    orbit, seen = scene.targets[0].orbit, scene.observer.orbit
    place, speed = two_body(np.array(orbit.position_m), np.array(orbit.velocity_m_s), at)
    observer, _ = two_body(np.array(seen.position_m), np.array(seen.velocity_m_s), at)
    return place, speed, apparent_sun_m(earth_and_sun(t.tt1, t.tt2)), observer


def test_a_spinning_cylinder_renders(tmp_path) -> None:
    """The whole route: its light in the truth table changes as it spins, and so does the image."""
    import pyarrow.parquet as pq
    import zarr

    from pipeline.route.run import render

    tube = {"kind": "cylinder", "diameter_m": 0.5, "length_m": 4.0, "albedo": 0.5}
    law = {"kind": "spin", "rate_deg_s": 1.0, "axis": [1, 0, 0]}
    scene = scene_of(tube | {"attitude": law})
    render(scene, tmp_path / "run")

    truth = pq.read_table(tmp_path / "run" / "truth" / "targets.parquet").to_pydict()
    g = plan_geometry(scene, np.arange(3), 0.0)
    light = (0.5 * (g.target_light[0, :, 1:] + g.target_light[0, :, :-1])).mean(axis=1)
    electrons = np.array(truth["electrons"])
    np.testing.assert_allclose(electrons / electrons[0], light / light[0], rtol=1e-12)
    assert np.ptp(electrons) > 0.05 * electrons.mean()
    dn = zarr.open(tmp_path / "run" / "cube.zarr", mode="r")["dn"][:].astype(float)
    assert np.all(dn.max(axis=(1, 2)) > np.median(dn))


def test_flicker_bounds_the_error_at_the_edge_of_the_shadow() -> None:
    """A low satellite enters the shadow within an exposure, told from ever more nodes."""
    from pipeline.plan.pointing import geometry

    far = {"kind": "fixed", "position_au": [-0.2, 0.5, 0.1]}
    orbit = {"kind": "state", "position_m": [6.9e6, 1e5, 0], "velocity_m_s": [0, 5374.0, 5374.0]}
    ball = {"kind": "sphere", "diameter_m": 2.0, "albedo": 0.2}
    scene = parse_scene(
        SKY | {
            "observer": far,
            "pointing": {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 5.0},
            "exposure": {"integration_s": 10.0, "frames": 120, "cadence_s": 40.0},
            "targets": [{"name": "t", "orbit": orbit, "body": ball}],
        }
    )  # fmt: skip
    lit = geometry._geometry(scene, np.arange(120), 2, 0.0).target_sunlit[0]
    frames = np.flatnonzero((lit > 0).any(axis=1) & (lit < 1).any(axis=1))
    assert frames.size
    for frame in frames:
        exact = geometry._geometry(scene, np.array([frame]), 1025, 0.0).target_light[0, 0]
        for nodes in (9, 33, 129):
            g = geometry._geometry(scene, np.array([frame]), nodes, 0.0)
            error = np.trapezoid(g.target_light[0, 0], dx=1 / (nodes - 1)) / np.trapezoid(
                exact, dx=1 / 1024
            )
            assert abs(error - 1) <= flicker_share(g) + 1e-9


def test_of_several_orbits_the_one_that_comes_into_the_earth_is_named() -> None:
    """It starts farther out than the other, and falls while that goes round."""
    round_ = StateOrbit(kind="state", position_m=(7e6, 0.0, 0.0), velocity_m_s=(0.0, 7546.0, 0.0))
    falls = StateOrbit(kind="state", position_m=(0.0, 9e6, 0.0), velocity_m_s=(0.0, -8e3, 0.0))
    for orbits, field in (([round_, falls], "b"), ([falls, round_], "a")):
        movers = Movers(orbits, ["a", "b"], EPOCH, instants(EPOCH, np.zeros(2), 0.0))
        movers.states(np.tile([0.0, 60.0], (2, 1)))
        with pytest.raises(BadInput) as told:
            movers.states(np.tile([0.0, 400.0], (2, 1)))
        assert told.value.field == field
