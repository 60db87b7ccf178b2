"""Where and when a sensor may look: astropy's Sun, Moon and Galaxy, a satellite's limb, weather."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import astropy.coordinates as coord
import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from scipy.special import erf

from pipeline.physics.positions.times import parse_utc
from pipeline.physics.vectors import from_angles, separation, unit
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.study import FieldOfRegard
from pipeline.survey.sights import Sights, allowed
from pipeline.survey.watch import Watcher, WatchMoments, make_watcher
from tests.survey.conftest import CAMERA, EPOCH, sections, watcher

SITE = coord.EarthLocation.from_geodetic(-156.3, 20.7, 3055.0)
START = Time("2019-04-20T06:00:00")
NEAR = 0.02  # [deg] about a limit, where two ephemerides and aberration may differ
Array = np.ndarray


def vectors(body: Any) -> Array:
    """(n, 3) unit vectors of astropy's coordinates."""
    return from_angles(np.asarray(body.ra.rad), np.asarray(body.dec.rad))


def looks(watch: WatchMoments, about: Array, rng: Any, least: float, most: float) -> Sights:
    """500 directions at each moment, least to most degrees from the vectors `about` (n, 3) GCRS;
    elevations as they are."""
    k = np.repeat(np.arange(len(about)), 500)
    angle = np.radians(rng.uniform(least, most, len(k)))
    side = unit(np.cross(about[k], rng.normal(size=(len(k), 3))))
    away = np.cos(angle)[:, None] * about[k] + np.sin(angle)[:, None] * side
    at = np.einsum("nji,nj->ni", watch.to_gcrs[k], away)
    height = 0.5 * np.pi - separation(at, watch.up[k])
    one = np.ones(len(k))
    return Sights(k, k, k, at, at, one, height, *[one] * 8)


def agrees(w: Watcher, watch: WatchMoments, s: Sights, margin_deg: Array, least: int) -> None:
    """Rows are allowed where a margin is above 0, but for those next to the limit."""
    clear = np.abs(margin_deg) > NEAR
    good = allowed(w, watch, s.moment, s.geometric, s.elevation)
    np.testing.assert_array_equal(good[clear], margin_deg[clear] > 0.0)
    assert min(good.sum(), (~good).sum()) > least


def off(s: Sights, watch: WatchMoments, from_: Array) -> Array:
    """Angles [deg] of directions from vectors (n, 3), GCRS, of their moments."""
    there = np.einsum("nij,nj->ni", watch.to_gcrs[s.moment], s.geometric)
    return np.degrees(separation(there, from_[s.moment]))


AT = np.linspace(0.0, 30_000.0, 20)  # the night of a Moon one day past full
BARE = {"lowest_elevation_deg": 0.0, "sun_exclusion_deg": 0.0, "moon_exclusion_deg": 0.0}


def test_moon_exclusion_of_a_site() -> None:
    """The Moon stands up to a degree beside where the Earth's centre sees it."""
    w = watcher(**BARE | {"moon_exclusion_deg": 30.0, "twilight_deg": 0.0})
    watch = w.watch(AT)
    moon = vectors(coord.get_body("moon", START + AT * u.s, SITE, ephemeris="builtin"))
    s = looks(watch, moon, np.random.default_rng(1), 29.0, 31.0)
    s = s.take((s.elevation > 0.0) & watch.works[s.moment])
    agrees(w, watch, s, off(s, watch, moon) - 30.0, 1000)


def test_elevations_of_a_site() -> None:
    w = watcher(**BARE | {"lowest_elevation_deg": 25.0, "highest_elevation_deg": 70.0})
    watch = w.watch(AT)
    up = np.einsum("nij,nj->ni", watch.to_gcrs, watch.up)
    s = looks(watch, up, np.random.default_rng(2), 0.0, 90.0)
    s = s.take(watch.works[s.moment])
    away = off(s, watch, up)
    agrees(w, watch, s, np.minimum(away - 20.0, 65.0 - away), 1000)


def test_galactic_exclusion() -> None:
    w = watcher(**BARE | {"galactic_exclusion_deg": 20.0})
    watch = w.watch(AT)
    pole = coord.SkyCoord(l=0 * u.deg, b=90 * u.deg, frame="galactic").icrs
    s = looks(watch, np.tile(vectors(pole), (len(AT), 1)), np.random.default_rng(3), 0.0, 180.0)
    s = s.take((s.elevation > 0.0) & watch.works[s.moment])
    there = np.einsum("nij,nj->ni", watch.to_gcrs[s.moment], s.geometric)
    sky = coord.SkyCoord(*there.T, representation_type="cartesian")
    b = sky.galactic.b.to_value(u.deg)
    agrees(w, watch, s, np.abs(b) - 20.0, 500)
    assert (b > 20.0).any()
    assert (b < -20.0).any()


def test_sun_and_limb_from_a_satellite() -> None:
    """By its own limits: the Moon's is left alone, and the Earth is a disc of 6,378 km."""
    orbit = {"kind": "keplerian", "semi_major_axis_m": 9e6, "eccentricity": 0.0,
             "inclination_deg": 98.0, "true_anomaly_deg": 10.0}  # fmt: skip
    regard = FieldOfRegard(sun_exclusion_deg=40.0, moon_exclusion_deg=0.0, earth_exclusion_deg=7.0)
    observer = {"kind": "orbit", "orbit": orbit}
    w = make_watcher(sections(observer=observer), regard, EPOCH, False)
    watch = w.watch(AT)
    sun = vectors(coord.get_sun(START + AT * u.s))
    s = looks(watch, sun, np.random.default_rng(4), 30.0, 50.0)
    down = np.einsum("nij,nj->ni", watch.to_gcrs, -unit(watch.observer_m))
    limb = np.degrees(np.arcsin(6_378_137.0 / 9e6))
    margin = np.minimum(off(s, watch, sun) - 40.0, off(s, watch, down) - limb - 7.0)
    agrees(w, watch, s, margin, 1000)
    s = looks(watch, down, np.random.default_rng(5), limb, limb + 14.0)
    margin = np.minimum(off(s, watch, sun) - 40.0, off(s, watch, down) - limb - 7.0)
    agrees(w, watch, s, margin, 1000)


AROUND = {"kind": "orbit", "orbit": {"kind": "keplerian", "semi_major_axis_m": 9e6,
          "eccentricity": 0.0, "inclination_deg": 98.0, "true_anomaly_deg": 100.0}}  # fmt: skip
STRAY = {"pst": {"kind": "harvey", "b0_per_sr": 10.0, "shoulder": 0.01, "slope": -1.9},
         "exclusion_deg": 49.0}  # fmt: skip


@pytest.mark.parametrize("stray", [None, STRAY, STRAY | {"inside": "clip"}])
def test_the_cameras_own_limits_hold_too(stray: Any) -> None:
    """Those by which a render refuses: the angle from the Sun while it is in sight, or where stray
    light is drawn that from Sun, Moon and limb to the frame; else what would be in the field."""
    regard = FieldOfRegard(sun_exclusion_deg=40.0, moon_exclusion_deg=20.0, earth_exclusion_deg=7.0)
    asked = sections(observer=AROUND, sensor=CAMERA | {"sun_exclusion_deg": 50.0})
    asked["background"] |= {"stray_light": stray}
    w = make_watcher(asked, regard, EPOCH, False)
    watch = w.watch(AT)
    corner = np.degrees(np.arctan(np.hypot(512, 512) * 13.5e-6))
    here = np.einsum("nij,nj->ni", watch.to_gcrs, watch.observer_m)
    sun, moon = (coord.get_body(n, START + AT * u.s, ephemeris="builtin") for n in ("sun", "moon"))
    sun, moon = (unit(body.cartesian.xyz.to_value(u.m).T - here) for body in (sun, moon))
    down = np.einsum("nij,nj->ni", watch.to_gcrs, -unit(watch.observer_m))
    limb = np.degrees(np.arcsin(6_378_137.0 / 9e6))
    least = {None: (50.0, 20.0, 7.0), "refuse": (49.0 + corner,) * 3, "clip": (40.0, 20.0, 7.0)}[
        stray and stray.get("inside", "refuse")
    ]
    hidden = np.degrees(separation(sun, down)) < limb - 0.27
    assert hidden.any()
    near_sun = np.where(hidden, 40.0, least[0])
    for seed, about in ((6, sun), (7, moon), (8, down)):
        s = looks(watch, about, np.random.default_rng(seed), 5.0, 110.0)
        away = off(s, watch, moon)
        low = np.degrees(separation(moon, down)) < limb - 0.27
        margins = (off(s, watch, sun) - near_sun[s.moment], off(s, watch, down) - limb - least[2],
                   away - np.where(low, 20.0, least[1])[s.moment])  # fmt: skip
        agrees(w, watch, s, np.min(margins, axis=0), 300)


def test_a_sun_that_has_half_set_is_in_sight() -> None:
    """While a satellite sees some of its disc beside the limb the camera's own angle holds."""
    asked = sections(observer=AROUND, sensor=CAMERA | {"sun_exclusion_deg": 50.0})
    w = make_watcher(asked, FieldOfRegard(sun_exclusion_deg=40.0), EPOCH, False)
    at = np.arange(0.0, 8497.0, 1.5)  # once around
    watch = w.watch(at)
    here = np.einsum("nij,nj->ni", watch.to_gcrs, watch.observer_m)
    sun = coord.get_sun(START + at * u.s).cartesian.xyz.to_value(u.m).T - here
    round_ = np.array([1.0, 1.0, 1.0 / (1.0 - 1.0 / 298.257_223_563)])  # the ellipsoid is a sphere
    limb = np.degrees(np.arcsin(6_378_137.0 / np.linalg.norm(here * round_, axis=-1)))
    above = np.degrees(separation(sun * round_, -here * round_)) - limb  # of its middle
    clear = np.abs(above + 0.266) > 0.02
    half = clear & (above > -0.266) & (above < 0.0)
    assert half.sum() > 3
    np.testing.assert_allclose(np.degrees(watch.sun_least[half]), 50.0)
    hidden = clear & (above < -0.266)
    np.testing.assert_allclose(np.degrees(watch.sun_least[hidden]), 40.0)


@pytest.mark.parametrize("twilight_deg", [-6.0, -15.0])
def test_dark_by_the_suns_elevation(twilight_deg: float) -> None:
    at = np.arange(0.0, 86_400.0, 30.0)
    found = watcher(twilight_deg=twilight_deg).watch(at).works
    when = START + at * u.s
    up = coord.get_sun(when).transform_to(coord.AltAz(obstime=when, location=SITE)).alt.deg
    clear = np.abs(up - twilight_deg) > NEAR
    np.testing.assert_array_equal(found[clear], (up <= twilight_deg)[clear])


def clear_of(seed: int = 0, name: str = "here", longitude_deg: float = -156.3) -> Array:
    """Whether the sky is clear at each hour of 400 days, by night and day."""
    asked = sections(name=name)
    asked["observer"]["longitude_deg"] = longitude_deg
    regard = FieldOfRegard(clear_fraction=0.8, weather_h=4.0)
    w = make_watcher(asked, regard, EPOCH, False, "", seed)
    assert isinstance(w.observer, GroundObserver)
    return w._clear(3600.0 * np.arange(9600.0) + 1.0, w.observer)


def test_weather_is_clear_as_often_as_asked() -> None:
    """In whole stretches of `weather_h`; of another seed, or another place, another weather."""
    clear = clear_of().reshape(-1, 4)
    assert (clear == clear[:, :1]).all()
    assert clear[:, 0].mean() == pytest.approx(0.8, abs=4 * np.sqrt(0.16 / 2400))
    change = np.diff(clear[:, 0].astype(int)) != 0
    assert change.mean() == pytest.approx(0.32, abs=0.05)  # one stretch tells nothing of the next
    for other in (clear_of(1), clear_of(longitude_deg=-156.2)):
        assert (other.reshape(-1, 4)[:, 0] != clear[:, 0]).mean() == pytest.approx(0.32, abs=0.05)
    for same in (clear_of(name="beside"), clear_of(longitude_deg=203.7)):
        np.testing.assert_array_equal(same.reshape(-1, 4), clear)


def test_below_the_first_angle_of_a_curve_nothing_is_looked_at(tmp_path: Path) -> None:
    """As a scene refuses: nearer to a lamp nothing was measured."""
    (tmp_path / "pst.csv").write_text("angle_deg,pst\n30,1e-5\n180,1e-9\n")
    stray = {"pst": {"kind": "table", "path": str(tmp_path / "pst.csv")}, "exclusion_deg": 10.0}
    asked = sections(observer=AROUND, sensor=CAMERA)
    asked["background"] |= {"stray_light": stray}
    corner = np.degrees(np.arctan(np.hypot(512, 512) * 13.5e-6))
    w = make_watcher(asked, FieldOfRegard(), EPOCH, False)
    assert {k: np.degrees(v) for k, v in w.refused_rad.items()} == pytest.approx(
        dict.fromkeys(("sun", "moon", "earth"), 30.0 + corner), rel=1e-6
    )


def share_in_pixels(sigma_px: float, length_px: float, angle_rad: float) -> Array:
    """A Gaussian swept along a straight line, centred on a pixel's middle, pixel by pixel."""
    along = np.linspace(-0.5, 0.5, 2001) * length_px
    edges = np.arange(-12.5, 13.0)
    x, y = (
        0.5 * np.diff(erf((edges - at[:, None]) / (np.sqrt(2.0) * sigma_px)))
        for at in (along * np.cos(angle_rad), along * np.sin(angle_rad))
    )
    return np.einsum("ki,kj->ij", y, x) / len(along)


@pytest.mark.parametrize("sigma_px", [0.9, 0.3])
@pytest.mark.usefixtures("coarse_signal")
def test_how_much_the_way_that_streaks_lie_changes_is_told(sigma_px: float) -> None:
    """Faint light: its SNR goes as the root of the sum of squares of what its pixels get of it."""
    asked = sections()
    asked["sensor"] = CAMERA | {"psf": {"kind": "gaussian", "sigma_px": sigma_px}}
    slant, *others = (
        np.sqrt(np.sum(share_in_pixels(sigma_px, 5.0, np.radians(angle)) ** 2))
        for angle in (22.5, 0.0, 45.0)
    )
    spread = max(abs(other / slant - 1.0) for other in others)
    w = make_watcher(asked, FieldOfRegard(), EPOCH, False)
    assert w.signal.direction_spread == pytest.approx(spread, abs=3e-3)
    assert (spread > 0.1) == (sigma_px == 0.3)
    told = [f"up to {100.0 * spread:.0f}% more or less"] if sigma_px == 0.3 else []
    assert [note.split("have ")[1].split(" (")[0] for note in w.direction_notes] == told
    assert make_watcher(asked, FieldOfRegard(), EPOCH, True).direction_notes == []


@pytest.mark.usefixtures("coarse_signal")
def test_cameras_that_differ_in_photon_noise_alone_have_each_their_own_signal() -> None:
    """Without sky and dark an empty pixel of both is as noisy; the light's own noise is not."""
    light = np.array([1e3, 1e5, 1e7])[:, None]
    got, floor = light * share_in_pixels(0.9, 0.0, 0.0).ravel(), 5.0**2 + 1.0 / 12.0
    for photon_noise in (True, False):
        asked = sections(sensor=CAMERA | {"photon_noise": photon_noise}, background=None)
        w = make_watcher(asked, FieldOfRegard(), EPOCH, True)
        noise = floor + got if photon_noise else np.full_like(got, floor)
        snr = np.sqrt(np.sum(got**2 / noise, axis=-1))
        np.testing.assert_allclose(w.signal.snr(light[:, 0], np.zeros(3)), snr, rtol=0.03)


@pytest.mark.parametrize("epoch", ["2019-05-24T22:20:00Z", "2019-05-25T08:20:00Z"])
def test_the_sun_at_the_zenith_of_the_epoch_is_no_matter(epoch: str) -> None:
    """Zodiacal light is told where a sensor looks: near the Sun it need not be known."""
    site = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3}
    made = {"observer": site, "sensor": CAMERA, "exposure": {"integration_s": 1.0},
            "background": {"zodiacal": True}}  # fmt: skip
    assert make_watcher(made, FieldOfRegard(), parse_utc(epoch), True).sky is not None
