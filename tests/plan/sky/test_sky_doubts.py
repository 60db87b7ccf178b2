"""No wrong sky in silence: Sun, Moon and daylight against astropy's places, in all exposures."""

from __future__ import annotations

import copy
import math
import warnings
from types import SimpleNamespace
from typing import Any

import erfa
import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.inputs.band.response import gather_response
from pipeline.inputs.sky.night import gather_undrawn
from pipeline.physics.positions.planets import PLANETS, brightest_v_mag
from pipeline.plan.facts import gather_facts
from pipeline.plan.pointing import lamps
from pipeline.plan.pointing.geometry import aimed
from pipeline.plan.sky import doubts as of_sky
from pipeline.plan.sky.doubts import Doubts, lacks_night, sky_doubts
from pipeline.resolve.resolve import resolve
from pipeline.route.prepare import prepare
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene

AU_M = 149_597_870_700.0
EPOCH = "2019-04-20T11:00:00Z"
SITE = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055}
HIGH = {"kind": "orbit", "orbit": {"kind": "state", "position_m": [4.2164e7, 0, 0],
                                   "velocity_m_s": [0, 3074.66, 0]}}  # fmt: skip
SCENE: dict[str, Any] = {
    "schema": "nightglass/scene/1", "name": "doubts", "epoch": EPOCH,
    "observer": {"kind": "fixed", "position_au": [-0.3, -0.9, 0.1]},
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 10.0, "focal_length_m": 0.02, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.3}, "read_noise_e": 5.0, "bias_dn": 100,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 0.0, "boresight_dec_deg": 0.0},
    "exposure": {"integration_s": 10.0},
}  # fmt: skip
HALF_DEG = np.degrees(np.arctan(32 * 5e-4))  # of the frame's side


def scene_of(*changes: dict[str, Any], **sensor: Any) -> Scene:
    data = copy.deepcopy(SCENE)
    for change in changes:
        data |= change
    data["sensor"] |= sensor
    return parse_scene(data)


def doubts(scene: Scene) -> Doubts:
    response = gather_response(scene)[0]
    facts = gather_facts(scene, response, 0.0, 5.0, 1.0)
    if not lacks_night(scene):
        return sky_doubts(scene, facts, response, 0.0)
    night = gather_undrawn(scene, response, None, 0.0)
    return sky_doubts(scene, facts, response, 0.0, night)


def word(scene: Scene) -> str:
    """The word that would accept a scene; empty where none is asked for."""
    try:
        doubts(scene)
    except BadInput as error:
        return str(error).rsplit("--accept ", 1)[1].rstrip(")")
    return ""


def beside(towards: np.ndarray, angle_deg: float, turn: float = 0.3) -> dict[str, Any]:
    """A pointing so far from a direction."""
    u = towards / np.linalg.norm(towards)
    a = np.cross(u, [0.1, 0.2, 1.0])
    a = np.cos(turn) * (a / np.linalg.norm(a)) + np.sin(turn) * np.cross(u, a / np.linalg.norm(a))
    t = np.radians(angle_deg)
    v = np.cos(t) * u + np.sin(t) * a
    return {"pointing": {"mode": "sidereal", "roll_deg": 20.0,
                         "boresight_ra_deg": float(np.degrees(np.arctan2(v[1], v[0])) % 360.0),
                         "boresight_dec_deg": float(np.degrees(np.arcsin(v[2])))}}  # fmt: skip


def body(name: str, when: str = EPOCH) -> np.ndarray:
    """A body's place from the solar system's barycentre by astropy [m]."""
    from astropy.coordinates import get_body_barycentric
    from astropy.time import Time

    return get_body_barycentric(name, Time(when.rstrip("Z")), "builtin").xyz.to_value("m")


def sun_elevations(hours: np.ndarray) -> np.ndarray:
    """At the site, without refraction, by astropy."""
    import astropy.units as u
    from astropy.coordinates import AltAz, EarthLocation, get_sun
    from astropy.time import Time
    from astropy.utils import iers

    iers.conf.auto_download = False
    site = EarthLocation.from_geodetic(-156.3 * u.deg, 20.7 * u.deg, 3055 * u.m)
    times = Time(EPOCH.rstrip("Z")) + hours * u.hour
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return get_sun(times).transform_to(AltAz(obstime=times, location=site)).alt.deg


@pytest.mark.parametrize(("angle", "least", "refused"), [
    (0.0, 30.0, True), (29.9, 30.0, True), (30.1, 30.0, False), (110.0, 30.0, False),
    (44.9, 45.0, True), (12.0, 0.0, False), (HALF_DEG + 0.2, 0.0, True),
    (HALF_DEG + 1.0, 0.0, False),
])  # fmt: skip
def test_the_sun_in_the_field_or_near_it(angle: float, least: float, refused: bool) -> None:
    """An observer at 0.95 au: by the angle from the boresight, and by the disc on the frame."""
    place = np.array(SCENE["observer"]["position_au"]) * AU_M
    turn = 0.0 if least else np.pi / 2
    pointing = beside(body("sun") - place, angle, turn)
    pointing["pointing"]["roll_deg"] = 0.0 if not least else 20.0
    scene = scene_of(pointing, sun_exclusion_deg=least)
    assert word(scene) == ("sun" if refused else "")
    if refused:
        with pytest.raises(BadInput, match=rf"{angle:.1f}\d* deg from the boresight"):
            doubts(scene)
        (said,) = doubts(scene.model_copy(update={"accept": ("sun",)})).warnings
        assert f"{angle:.1f}" in said


@pytest.mark.parametrize("name", PLANETS)
def test_a_planet_in_the_field_is_told(name: str) -> None:
    towards = body(name.lower()) - np.array(SCENE["observer"]["position_au"]) * AU_M
    for angle, told in ((0.5, True), (HALF_DEG + 0.5, False)):
        scene = scene_of(beside(towards, angle), {"accept": ["sun", "moon"]})
        found = [w for w in doubts(scene).warnings if w.startswith(f"{name} is in the field")]
        assert bool(found) is told


def test_a_planet_behind_the_earth_is_not_told() -> None:
    """Jupiter from a geostationary place: the Earth's disc of 8.7 degrees before it, or beside."""
    towards = body("jupiter") - body("earth")
    low = np.cross(towards, [0.0, 0.0, 1.0])
    towards, low = towards / np.linalg.norm(towards), low / np.linalg.norm(low)
    for place, told in ((-4.2164e7 * towards, False), (4.2164e7 * low, True)):
        orbit = {"kind": "state", "position_m": place.tolist(),
                 "velocity_m_s": (3074.66 * np.cross(low, towards)).tolist()}  # fmt: skip
        scene = scene_of(
            beside(towards, 12.0), {"observer": {"kind": "orbit", "orbit": orbit}},
            {"accept": ["sun", "moon", "error"]},
        )  # fmt: skip
        seen = lamps.look(scene, 0.0, lambda at: at.sun.off_axis)[0].planets["Jupiter"][0]
        assert bool(seen.hidden[0] <= 0.0) is told


@pytest.mark.parametrize(
    ("name", "from_sun_au", "away_au", "v_mag"),
    [("Jupiter", 5.10, 5.93, -1.97), ("Venus", 0.725, 1.72, -3.9), ("Neptune", 29.93, 28.92, 7.7)],
)
def test_planets_fully_lit_against_almanacs(
    name: str, from_sun_au: float, away_au: float, v_mag: float
) -> None:
    """The conjunction of December 2020, Venus behind the Sun in 2021, Neptune's opposition."""
    far = np.array([from_sun_au]) * AU_M, np.array([away_au]) * AU_M
    assert brightest_v_mag(name, *far)[0] == pytest.approx(v_mag, abs=0.08)


def test_stray_light_of_the_sun_has_its_own_angle() -> None:
    place = np.array(SCENE["observer"]["position_au"]) * AU_M
    pst = {"kind": "harvey", "b0_per_sr": 0.06, "shoulder": 0.02, "slope": -3.5}
    sky = {"background": {"stray_light": {"pst": pst}}}
    towards = body("sun") - place
    assert word(scene_of(beside(towards, 20.0), sky)) == ""
    assert word(scene_of(beside(towards, 1.0), sky)) == "sun"
    moonlit = {"background": {"stray_light": {"pst": pst, "sun": False}}}
    assert word(scene_of(beside(towards, 20.0), moonlit)) == "sun"


def test_the_earth_hides_the_sun() -> None:
    """Geostationary height, 10 degrees beside the Earth's middle in its shadow, and just out of it
    (the limb is 8.7 degrees from the middle)."""
    sun = body("sun") - body("earth")
    sun /= np.linalg.norm(sun)
    east = np.cross([0.0, 0.0, 1.0], sun)
    east /= np.linalg.norm(east)
    for off_deg, refused in ((0.0, ""), (8.2, ""), (9.5, "sun")):
        t = np.radians(off_deg)
        place = 4.2164e7 * (-np.cos(t) * sun + np.sin(t) * east)
        orbit = {"kind": "state", "position_m": [float(v) for v in place],
                 "velocity_m_s": [float(v) for v in 3074.66 * east]}  # fmt: skip
        observer = {"observer": {"kind": "orbit", "orbit": orbit}}
        assert word(scene_of(observer, beside(sun, 12.0, np.pi / 2))) == refused


@pytest.mark.parametrize(("angle", "refused"), [
    (0.0, True), (HALF_DEG + 0.1, True), (HALF_DEG + 0.6, False), (10.0, False),
])  # fmt: skip
def test_the_moon_in_the_field(angle: float, refused: bool) -> None:
    """From geostationary height, along a side of the frame."""
    towards = body("moon") - body("earth") - np.array(HIGH["orbit"]["position_m"])
    pointing = beside(towards, angle, np.pi / 2)
    pointing["pointing"]["roll_deg"] = 0.0
    scene = scene_of({"observer": HIGH}, pointing)
    assert word(scene) == ("moon" if refused else "")
    if refused:
        (said,) = doubts(scene.model_copy(update={"accept": ("moon",)})).warnings
        assert "the Moon is in the field" in said


@pytest.mark.parametrize(("angle", "refused"), [(4.0, True), (6.8, False)])
def test_moonlight_near_the_moon(angle: float, refused: bool) -> None:
    """Scattered moonlight is known from 5 degrees of the frame's nearest side on."""
    from astropy.coordinates import EarthLocation
    from astropy.time import Time

    site = EarthLocation.from_geodetic(-156.3, 20.7, 3055)
    at = site.get_gcrs_posvel(Time(EPOCH.rstrip("Z")))[0].xyz.to_value("m")
    air = {"observer": SITE | {"atmosphere": {"extinction": {"mag_per_airmass": 0.3}}},
           "background": {"moonlight": True}}  # fmt: skip
    pointing = beside(body("moon") - body("earth") - at, angle, np.pi / 2)
    pointing["pointing"]["roll_deg"] = 0.0
    assert word(scene_of(air, pointing)) == ("moon" if refused else "")
    assert word(scene_of(air | {"background": {"airglow": True}}, pointing)) == ""


@pytest.mark.parametrize(("sky", "highest"), [
    (None, -12.0), ({"airglow": True}, -12.0), ({"zodiacal": True}, -12.0),
    ({"airglow": True, "uniform_e_per_s": 5.0}, -12.0), ({"twilight": True}, 0.0),
    ({"uniform_mag_arcsec2": 21.0}, 90.0), ({"uniform_e_per_s": 5.0, "zodiacal": True}, 90.0),
])  # fmt: skip
def test_daylight_hour_by_hour(sky: dict[str, Any] | None, highest: float) -> None:
    """Refused by the Sun's elevation, and silent only where twilight is below the accuracy."""
    hours = np.arange(0.0, 24.0, 0.9)
    air = {"observer": SITE | {"atmosphere": {"extinction": {"mag_per_airmass": 0.3}}}}
    up = {"pointing": {"mode": "local", "azimuth_deg": 90.0, "elevation_deg": 80.0},
          "accept": ["sun", "moon"], "exposure": {"integration_s": 0.1}}  # fmt: skip
    for h, elevation in zip(hours, sun_elevations(hours), strict=True):
        epoch = {"epoch": str(np.datetime64("2019-04-20T11:00:00") + int(h * 3600)) + "Z"}
        scene = scene_of(air, up, epoch, {"background": sky} if sky else {})
        refused = word(scene) == "daylight"
        assert refused == (elevation > highest), (h, elevation)
        if refused:
            with pytest.raises(BadInput) as error:
                doubts(scene)
            said = float(str(error.value).split("the Sun at ")[1].split(" deg")[0])
            assert said == pytest.approx(elevation, abs=0.03)
            scene = scene.model_copy(update={"accept": ("sun", "moon", "daylight")})
        found = doubts(scene)
        if elevation > -17.0 and sky != {"twilight": True}:
            assert any("deg of elevation" in s for s in (*found.warnings, *found.remarks)) or (
                elevation < -14.0  # where twilight is below the accuracy
            )
        if elevation < -30.0:
            assert not any("the Sun" in said for said in found.warnings)


@pytest.mark.parametrize(("sky", "silent"), [
    (None, False), ({"airglow": True}, False), ({"zodiacal": True}, False),
    ({"moonlight": True}, True), ({"uniform_mag_arcsec2": 19.0}, True),
])  # fmt: skip
def test_a_moon_whose_light_is_not_asked_for(sky: dict[str, Any] | None, silent: bool) -> None:
    """Said with its elevation by astropy, near full, and not with the Moon below the horizon."""
    import astropy.units as u
    from astropy.coordinates import AltAz, EarthLocation, get_body
    from astropy.time import Time

    site = EarthLocation.from_geodetic(-156.3 * u.deg, 20.7 * u.deg, 3055 * u.m)
    air = {"observer": SITE | {"atmosphere": {"extinction": {"mag_per_airmass": 0.2}}},
           "pointing": {"mode": "local", "azimuth_deg": 0.0, "elevation_deg": 80.0}}  # fmt: skip
    for epoch, up in (("2019-04-20T11:00:00Z", True), ("2019-04-27T09:00:00Z", False)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            frame = AltAz(obstime=Time(epoch.rstrip("Z")), location=site)
            elevation = get_body("moon", frame.obstime, site).transform_to(frame).alt.deg
        assert (elevation > 0.0) == up
        found = doubts(scene_of(air, {"epoch": epoch}, {"background": sky} if sky else {}))
        said = [one for one in found.warnings if "moonlight" in one]
        assert bool(said) == (up and not silent)
        if said:
            assert float(said[0].split("at ")[1].split(" deg")[0]) == pytest.approx(
                elevation, abs=0.05
            )


def test_moonlight_is_told_of_the_frame_that_holds_most() -> None:
    """Below the horizon in the first of three frames, five hours apart at most, up in the last."""
    air = {"observer": SITE | {"atmosphere": {"extinction": {"mag_per_airmass": 0.2}}},
           "pointing": {"mode": "local", "azimuth_deg": 0.0, "elevation_deg": 80.0},
           "exposure": {"integration_s": 1.0, "frames": 3, "cadence_s": 9000.0}}  # fmt: skip
    found = doubts(scene_of(air, {"epoch": "2019-04-27T09:00:00Z"}))
    (said,) = [one for one in found.warnings if "moonlight" in one]
    assert "(frame 2)" in said


def test_the_sunlit_earth_in_the_field_or_beside_it() -> None:
    """From 42,164 km the limb is asin(6378.137 / 42164) from the middle; a frame half a degree
    and more beside it has a note, and one far away none."""
    disc = np.degrees(np.arcsin(6378.137 / 42164.0))
    for beside_deg, warned, noted in (
        (0.5, True, True), (HALF_DEG - 0.05, True, True), (HALF_DEG + 0.05, False, True),
        (19.5, False, True), (20.5, False, False),
    ):  # fmt: skip
        pointing = {"mode": "sidereal", "boresight_dec_deg": 0.0, "roll_deg": 0.0,
                    "boresight_ra_deg": 180.0 - disc - beside_deg}  # fmt: skip
        found = doubts(scene_of({"observer": HIGH, "pointing": pointing}))
        inside = [said for said in found.warnings if said.startswith("the Earth is in the field")]
        assert bool(inside) == warned
        if inside:
            deep = float(inside[0].split("limb ")[1].split(" deg")[0])
            assert deep == pytest.approx(HALF_DEG - beside_deg, abs=0.012)
        notes = [said for said in found.remarks if "Earth's limb" in said]
        assert bool(notes) == noted


def test_a_horizon_in_the_field() -> None:
    """Of a level camera: the lower corners stand lower than the middle of its lower side."""
    sky = {"background": {"uniform_mag_arcsec2": 21.0}}
    t = np.tan(np.radians(HALF_DEG))
    for up, warned in ((0.1, True), (HALF_DEG - 0.1, True), (HALF_DEG + 0.1, False)):
        pointing = {"pointing": {"mode": "local", "azimuth_deg": 77.0, "elevation_deg": up}}
        found = doubts(scene_of({"observer": SITE}, pointing, sky))
        said = [one for one in found.warnings if one.startswith("the horizon is in the field")]
        assert bool(said) == warned
        if said:
            tilt = np.radians(up)
            low = np.arcsin((np.sin(tilt) - t * np.cos(tilt)) / np.sqrt(1.0 + 2.0 * t * t))
            below = float(said[0].split("field, ")[1].split(" deg")[0])
            assert below == pytest.approx(-np.degrees(low), abs=0.012)


def test_search_for_a_frame_that_is_missed() -> None:
    """Turning boresights over many frames: what every moment of every exposure shows is found.

    The angles found are those of a brute search within what turns in a step of it.
    """
    rng = np.random.default_rng(3)
    place = np.array(SCENE["observer"]["position_au"]) * AU_M
    towards, silent, found = body("sun") - place, 0, 0
    frames, cadence = 75, 40.0
    for _ in range(12):
        start = beside(towards, rng.uniform(5.0, 25.0), rng.uniform(0, 6.28))["pointing"]
        start |= {"mode": "rate", "rate_ra_arcsec_s": float(rng.uniform(-40.0, 40.0)),
                  "rate_dec_arcsec_s": float(rng.uniform(-40.0, 40.0))}  # fmt: skip
        scene = scene_of(
            {"pointing": start, "exposure": {"integration_s": 10.0, "frames": frames,
                                             "cadence_s": cadence}},
            sun_exclusion_deg=float(rng.choice([0.0, 8.0, 15.0])),
        )  # fmt: skip
        every = lamps._look(scene, 0.0, np.arange(0, frames * lamps.TICKS, 8))
        limit = np.radians(scene.sensor.sun_exclusion_deg)
        least = np.minimum(every.sun.off_frame - every.sun.radius, every.sun.off_axis - limit).min()
        refused = word(scene) == "sun"
        found += refused
        silent += bool(least <= 0.0 and not refused)
        assert refused == (least <= 0.0) or abs(least) < every.turn.max()
    assert not silent
    assert 2 <= found <= 11


@pytest.mark.parametrize("day", [3, 10, 17, 24])
def test_the_moon_is_where_astropy_sees_it_from_a_site(day: int) -> None:
    """Its apparent place: it goes round the Sun with the Earth, so its own way during the light's
    takes back the 20 arcsec by which the Earth's motion moves the stars."""
    import astropy.units as u
    from astropy.coordinates import EarthLocation, get_body
    from astropy.time import Time
    from astropy.utils import iers

    epoch = f"2019-04-{day:02d}T21:00:00Z"
    up = {"epoch": epoch, "pointing": {"mode": "local", "azimuth_deg": 70.0, "elevation_deg": 60.0}}
    scene = scene_of({"observer": SITE}, up)
    ((axis,),) = lamps.aimed(scene, np.array([0.0]), 0.0)[1][:, 2:]
    place = EarthLocation.from_geodetic(-156.3 * u.deg, 20.7 * u.deg, 3055 * u.m)
    with iers.conf.set_temp("auto_download", False):
        moon = get_body("moon", Time(epoch.rstrip("Z")), place, "builtin").cartesian.xyz.value
    apart = np.arccos(axis @ moon / np.linalg.norm(moon))
    found = lamps._look(scene, 0.0, np.array([0])).moon.off_axis[0]
    assert np.degrees(abs(found - apart)) * 3600.0 < 3.0


@pytest.mark.parametrize("height_m", [0.0, 1000.0, 4000.0])
def test_from_a_mountain_more_is_seen(height_m: float) -> None:
    """A body is hidden below the line that touches the sea, lifted by 34 arcmin of air there."""
    up = {"pointing": {"mode": "local", "azimuth_deg": 70.0, "elevation_deg": 60.0}}
    scene = scene_of({"observer": SITE | {"height_m": height_m}}, up)
    seen = lamps._look(scene, 0.0, np.array([5]))
    touch_m = math.sqrt((6378137.0 + height_m) ** 2 - 6378137.0**2)
    horizon_deg = -math.degrees(math.atan(touch_m / 6378137.0)) - 34.0 / 60.0
    for lamp in (seen.sun, seen.moon, *(one for one, _ in seen.planets.values())):
        disc = 0.0 if lamp.radius[0] < 1e-3 else lamp.radius[0]  # planets are points
        below_deg = np.degrees(lamp.hidden[0] + disc)
        assert below_deg + np.degrees(lamp.elevation[0]) == pytest.approx(horizon_deg, abs=0.01)


def test_a_frame_between_those_sampled_is_found() -> None:
    """One dwell of many looks at the Sun for one short frame."""
    place = np.array(SCENE["observer"]["position_au"]) * AU_M
    away, at = (beside(body("sun") - place, angle)["pointing"] for angle in (90.0, 1.0))
    dwells = [{"pointing": away, "frames": 40}, {"pointing": at, "frames": 1},
              {"pointing": away, "frames": 300}]  # fmt: skip
    with pytest.raises(BadInput, match=r"the Sun in the field.*\(frame 40\)"):
        doubts(scene_of({"dwells": dwells, "pointing": away}))


def test_the_earth_is_looked_for_when_it_is_nearest_itself() -> None:
    """From geostationary height, first beside the Moon, then across the Earth's limb."""
    moon = body("moon") - body("earth") - np.array(HIGH["orbit"]["position_m"])
    disc = np.degrees(np.arcsin(6378.137 / 42164.0))
    limb = {"mode": "sidereal", "boresight_dec_deg": 0.0, "boresight_ra_deg": 179.5 - disc}
    away = beside(moon, 3.0)["pointing"]
    dwells = [{"pointing": away, "frames": 2}, {"pointing": limb, "frames": 1}]
    found = doubts(scene_of({"observer": HIGH, "dwells": dwells, "pointing": away}))
    (said,) = [one for one in found.warnings if one.startswith("the Earth is in the field")]
    assert "(frame 2)" in said


def test_accepted_doubts_stand_first_in_the_plan() -> None:
    place = np.array(SCENE["observer"]["position_au"]) * AU_M
    scene = scene_of(beside(body("sun") - place, 20.0), {"accept": ["sun"]})
    plan = prepare(scene).plan
    assert "within 30 degrees" in plan.warnings[0]


@pytest.mark.parametrize("shape", [[40, 200], [200, 40]])
@pytest.mark.parametrize("turn", [0.3, 2.0])
def test_how_far_lamps_are_from_an_oblong_frame(shape: list[int], turn: float) -> None:
    """Against all places along the edges of its pixels; of a site the Earth is below it."""
    sun = beside(body("sun") - np.array(SCENE["observer"]["position_au"]) * AU_M, 6.0, turn)
    low = {"mode": "local", "azimuth_deg": 70.0, "elevation_deg": 30.0}
    sites = [({"observer": SITE}, {"pointing": low | {"roll_deg": 50.0 * turn + more}})
             for more in (0.0, 90.0, 180.0)]  # fmt: skip
    for observer, pointing in (({}, sun), *sites):
        scene = scene_of(pointing, observer, shape=shape)
        found = lamps._look(scene, 0.0, np.array([5]))
        at, attitude = lamps.aimed(scene, np.array([10.0 * 5 / 64]), 0.0)
        rows, columns = (np.linspace(-0.5, n - 0.5, 401) for n in shape)
        x, y = (v.ravel() for v in np.meshgrid(columns, rows))
        seen = lamps.deproject(lamps.camera_of(scene), attitude[0], x, y)
        if observer:
            up = np.array([1.0, 1.0, 1.0 / (1.0 - 1.0 / 298.257223563) ** 2]) * at.observer_m[0]
            lamp, to = found.earth, -up
        else:
            lamp, to = found.sun, at.earth.sun_from_earth_m[0] - at.observer_m[0]
        apart = np.arccos(seen @ to / np.linalg.norm(to))
        assert lamp.off_frame[0] == pytest.approx(apart.min(), abs=5e-6)
        middle = np.arccos(attitude[0, 2] @ to / np.linalg.norm(to))
        assert lamp.off_axis[0] == pytest.approx(middle, abs=5e-6)


@pytest.mark.parametrize(
    ("times", "fill"), [([10.0], 1.0), ([10.0], 0.25), ([10.0, 40.0, 2.0], 1.0)]
)
def test_light_that_is_not_drawn_is_told_of_the_longest_exposure(times: Any, fill: float) -> None:
    """V = 2.4 as an AB magnitude: 3631 Jy over 400 to 900 nm, a pupil of 0.1 m, open pixels."""
    disc = np.degrees(np.arcsin(6378.137 / 42164.0))
    pointing = {"mode": "sidereal", "boresight_dec_deg": 0.0, "boresight_ra_deg": 179.5 - disc}
    dwells = {"dwells": [{"integration_s": times, "frames": len(times)}]}
    found = doubts(scene_of({"observer": HIGH, "pointing": pointing}, dwells, fill_factor=fill))
    (said,) = [one for one in found.warnings if one.startswith("the Earth is in the field")]
    per_m2 = 3631e-26 / 6.62607015e-34 * np.log(900.0 / 400.0) * 10.0 ** (-0.4 * 2.4)
    arcsec2 = (np.degrees(10e-6 / 0.02) * 3600.0) ** 2
    wanted = per_m2 * np.pi / 4.0 * 0.1**2 * arcsec2 * fill * max(times)
    assert float(said.split("or ")[1].split(" e-")[0]) == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize(("elevation", "refused"), [(2.0, True), (-3.5, False)])
def test_a_moon_that_has_set_is_not_near(elevation: float, refused: bool) -> None:
    """A level frame above it: from 3055 m the line that touches the sea lies 2.3 degrees down."""
    import astropy.units as u
    from astropy.coordinates import AltAz, EarthLocation, get_body
    from astropy.time import Time

    site = EarthLocation.from_geodetic(-156.3 * u.deg, 20.7 * u.deg, 3055 * u.m)
    times = Time("2019-04-12T08:00:00") + np.linspace(0.0, 6.0, 721) * u.hour
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        at = get_body("moon", times, site).transform_to(AltAz(obstime=times, location=site))
    k = int(np.argmin(np.abs(at.alt.deg - elevation)))
    pointing = {"pointing": {"mode": "local", "azimuth_deg": float(at.az.deg[k]),
                             "elevation_deg": 0.5}, "epoch": times[k].isot + "Z"}  # fmt: skip
    air = {"observer": SITE | {"atmosphere": {"extinction": {"mag_per_airmass": 0.3}}},
           "background": {"moonlight": True}}  # fmt: skip
    assert abs(at.alt.deg[k] - elevation) < 0.2
    assert word(scene_of(air, pointing)) == ("moon" if refused else "")


@pytest.mark.parametrize("drawn", ["earth", "moon", "neither", "both"])
def test_stray_light_that_is_drawn_has_no_note(drawn: str) -> None:
    """Of a limb 15 degrees beside the boresight, of the Earth; a full Moon 5 degrees beside it."""
    pst = {"kind": "harvey", "b0_per_sr": 0.06, "shoulder": 0.02, "slope": -3.5}
    parts = {name: drawn in (name, "both") for name in ("earth", "moon")}
    sky = {"background": {"stray_light": {"pst": pst} | parts}}
    disc = np.degrees(np.arcsin(6378.137 / 42164.0))
    earth = {"pointing": {"mode": "sidereal", "boresight_dec_deg": 0.0,
                          "boresight_ra_deg": 180.0 - disc - 15.0}}  # fmt: skip
    towards = body("moon") - body("earth") - np.array(HIGH["orbit"]["position_m"])
    for name, pointing in (("Earth", earth), ("Moon", beside(towards, 5.0))):
        found = doubts(scene_of({"observer": HIGH}, pointing, sky))
        noted = any(f"the {name}'s limb" in said for said in found.remarks)
        assert noted != parts[name.lower()]


def test_what_stands_before_the_earth_is_not_hidden_by_it() -> None:
    """Seen from a million kilometres: the Moon on this side of the Earth, beside it and behind."""
    far: Any = SimpleNamespace(observer=None, epoch="2019-07-20T09:00:00Z")
    place = np.tile([1e9, 0.0, 0.0], (3, 1))
    body = np.array([[3.8e8, 1e5, 0.0], [0.0, 3.8e8, 0.0], [-3.8e8, 1e5, 0.0]]) - place
    hidden = lamps.hidden_rad(far, place, body, np.zeros(3))
    assert (hidden > 0.0).tolist() == [False, False, True]


def test_lamps_stand_where_the_moving_observer_sees_them() -> None:
    """Against ERFA's aberration, half a degree at a hundredth of the speed of light; the Moon goes
    along with the Earth."""
    fast = copy.deepcopy(SCENE)
    fast["observer"] |= {"velocity_m_s": [0.0, 0.0, 3e6]}
    scene = parse_scene(fast)
    at, attitude = aimed(scene, np.zeros(1), 0.0)
    sun_m_s, moon_m_s = np.zeros(3), at.earth.velocity_m_s[0]
    both = lamps.sun_and_moon(scene, at, attitude)
    for lamp, body_m, own_m_s in zip(both, lamps.bodies_m(at), (sun_m_s, moon_m_s), strict=True):
        beta = (np.array([0.0, 0.0, 3e6]) - own_m_s) / 299_792_458.0
        true = body_m[0] / np.linalg.norm(body_m[0])
        seen = erfa.ab(true, beta, 1.0, np.sqrt(1.0 - beta @ beta))
        assert np.linalg.norm(seen - true) > 5e-3
        off = np.arctan2(np.linalg.norm(np.cross(seen, attitude[0, 2])), seen @ attitude[0, 2])
        assert lamp.off_axis[0] == pytest.approx(off, abs=1e-6)


def test_a_planet_is_told_of_its_frame() -> None:
    """Of one dwell of many, for one frame."""
    place = np.array(SCENE["observer"]["position_au"]) * AU_M
    away, at = (beside(body("jupiter") - place, angle)["pointing"] for angle in (60.0, 0.5))
    dwells = [{"pointing": away, "frames": 40}, {"pointing": at, "frames": 30},
              {"pointing": away, "frames": 300}]  # fmt: skip
    scene = scene_of({"dwells": dwells, "pointing": away, "accept": ["sun", "moon"]})
    [told] = [w for w in doubts(scene).warnings if w.startswith("Jupiter is in the field")]
    assert 40 <= int(told.split(" frame ")[1].split(":")[0]) < 70


@pytest.mark.parametrize(("first", "sure"), [(lamps.TICKS - 2, False), (lamps.TICKS - 1, True)])
def test_what_may_be_missed_between_two_exposures_is_no_doubt(
    first: int, sure: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between neighbouring moments of one exposure it is: all turns farther than what is near."""
    found = SimpleNamespace(turn=np.array([0.2]))
    monkeypatch.setattr(lamps, "_first", lambda *_: np.array([first, first + 1]))
    monkeypatch.setattr(lamps, "_look", lambda *_: found)
    nothing: Any = None
    assert lamps.look(nothing, 0.0, lambda _: np.array([0.1, 0.3])) == (found, sure)


@pytest.mark.parametrize(("light_e", "said"), [(0.4, 0), (0.6, 1)])
def test_light_of_the_night_is_told_from_the_accuracy_on(
    light_e: float, said: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tenth of a noise of 5 e-: of twilight, and of the Moon."""
    monkeypatch.setattr(of_sky, "highest_sun_rad", lambda _: -0.2)
    scene: Any = SimpleNamespace(background=None, accuracy=SimpleNamespace(noise_fraction=0.1),
                                 sensor=SimpleNamespace(fill_factor=0.5))  # fmt: skip
    facts: Any = SimpleNamespace(light_floor_e=5.0, area_m2=2.0, ifov_rad=1e-3)
    lamp = SimpleNamespace(elevation=np.array([-0.3]))
    seen: Any = SimpleNamespace(moon=lamp, sun=lamp, frame=lambda _: 3)
    night: Any = SimpleNamespace(most=lambda *_: (0, light_e * 1e6))
    assert len(of_sky._little_twilight(scene, facts, seen, night)) == said
    assert len(of_sky._no_moonlight(scene, facts, seen, night)) == said


@pytest.mark.parametrize(("part", "epoch", "pointing", "exposure", "air"), [
    ("twilight", "2019-05-01T06:10:00Z", (285.0, 12.0), {"integration_s": 10.0}, {}),
    ("twilight", "2019-05-01T06:17:00Z", (285.0, 12.0), {"integration_s": 10.0},
     {"extinction": {"mag_per_airmass": 0.3}}),
    ("twilight", "2019-05-01T05:42:00Z", (285.0, 40.0),
     {"integration_s": 1800.0, "frames": 3}, {"extinction": True, "refraction": True}),
    ("moonlight", "2019-05-07T06:05:00Z", (290.0, 25.0), {"integration_s": 1.0}, {}),
    ("moonlight", "2019-04-20T11:00:00Z", (90.0, 30.0),
     {"integration_s": 5.0, "frames": 3, "cadence_s": 7200.0}, {"refraction": True}),
])  # fmt: skip
def test_light_of_the_night_is_told_as_it_would_be_drawn(
    part: str, epoch: str, pointing: tuple[float, float], exposure: dict[str, Any],
    air: dict[str, Any],
) -> None:  # fmt: skip
    """The mean of the exposure that holds most of it, in the middle of the frame: low beside a
    Sun more than 18 degrees down, through half an hour of dusk, of a thin Moon and of a full one;
    air that the scene does not have is a standard atmosphere's."""
    at = {"mode": "local", "azimuth_deg": pointing[0], "elevation_deg": pointing[1]}
    changes = {"epoch": epoch, "pointing": at, "exposure": exposure, "accept": ["moon"]}
    bare = {"observer": SITE | ({"atmosphere": air} if air else {})}
    silent = scene_of(changes, bare, focal_length_m=0.3)
    whole = {"observer": SITE | {"atmosphere": {"extinction": True} | air}}
    asked = scene_of(changes, whole, {"background": {part: True, "starlight": "none"}},
                     focal_length_m=0.3)  # fmt: skip
    (said,) = [one for one in resolve(silent).warnings if f": {part}, " in one]
    drawn = resolve(asked).scene
    assert drawn.sky is not None
    x, y = np.array(drawn.camera.centre_px)[:, None]
    light_e = [float(drawn.sky.e_s_at(k, x, y)[0]) * drawn.integration_s(k)
               for k in range(drawn.frames)]  # fmt: skip
    assert float(said.split(f"{part}, ")[1].split(" e-")[0]) == pytest.approx(
        max(light_e), rel=0.01
    )
    assert f"(frame {int(np.argmax(light_e))})" in said
