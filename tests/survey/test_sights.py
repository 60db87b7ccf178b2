"""Places and light of objects row by row: skyfield's geometry, and the renderer's own light."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from skyfield.api import EarthSatellite, load, wgs84

from pipeline.execute.truth import matched_snr
from pipeline.physics.constants import SPEED_OF_LIGHT_M_S
from pipeline.physics.motion.streak import straight
from pipeline.physics.positions.orbit_screen import states_together
from pipeline.physics.positions.orbit_sgp4 import since_epochs_s
from pipeline.physics.vectors import separation
from pipeline.survey.elements import Elements
from pipeline.survey.sights import Sights, _observed, sights_of
from tests.survey.conftest import EPOCH, watcher

ARCSEC = np.radians(1.0 / 3600.0)


Thousand = tuple[Sights, np.ndarray, np.ndarray, float]


def _thousand(objects: Elements, refraction: bool) -> Thousand:
    """1,000 cases above 15 degrees of a day, no polar motion: skyfield knows none."""
    w = watcher(tracks=True, refraction=refraction, pole=(0.0, 0.0))
    at = np.sort(np.random.default_rng(3).uniform(0.0, 86_400.0, 400))
    satellites = objects.satellites()
    place, speed, _ = states_together(satellites, since_epochs_s(satellites, EPOCH), at)
    who, when = (i.ravel() for i in np.indices(place.shape[:2]))
    flat = place.reshape(-1, 3), speed.reshape(-1, 3)
    s = sights_of(w, w.watch(at), when, who, *flat, objects.reflecting_m2[who], objects.shaded[who])
    high = np.flatnonzero(s.elevation > np.radians(15.0))
    s = s.take(np.random.default_rng(4).permutation(high)[:1000])
    assert len(s) == 1000
    return (
        s,
        np.einsum("nij,nj->ni", w.watch(at).to_gcrs[s.moment], s.geometric),
        at,
        w.resolved.dut1_s,
    )


@pytest.mark.parametrize("refraction", [False, True])
def test_against_skyfield(objects: Elements, refraction: bool) -> None:
    """Directions to 0.02 arcsec and a metre, ranges to a metre; elevations to the diurnal
    aberration, and with air to what two laws of refraction differ by."""
    s, direction, at, dut1_s = _thousand(objects, refraction)
    ts = load.timescale(delta_t=69.184 - dut1_s)
    site = wgs84.latlon(20.7, -156.3, elevation_m=3055)
    satellites = objects.satellites()
    for row in range(len(s)):
        i, seconds = int(s.object[row]), at[s.moment[row]]
        t = ts.tt_jd(2458593.75 + (69.184 + seconds) / 86400.0)  # 2019-04-20 06:00 UTC
        left = ts.tt_jd(t.tt - s.range_m[row] / SPEED_OF_LIGHT_M_S / 86400.0)
        body = EarthSatellite.from_satrec(satellites[i], ts)
        path = body.at(left).position.m - site.at(t).position.m
        assert abs(np.linalg.norm(path) - s.range_m[row]) < 1.0
        apart = separation(path / np.linalg.norm(path), direction[row])
        assert apart < 0.02 * ARCSEC + 1.0 / s.range_m[row]
        air = {"temperature_C": -4.86, "pressure_mbar": 697.6} if refraction else {}
        altitude = (body - site).at(t).altaz(**air)[0].radians
        late = s.rate[row] * s.range_m[row] / SPEED_OF_LIGHT_M_S
        allowed = late + (6.0 if refraction else 0.4) * ARCSEC
        assert abs(altitude - s.elevation[row]) < allowed


def test_signal_is_the_renderers() -> None:
    """The table of SNR against the figure that truth tables hold, at odd lengths and lights."""
    w = watcher()
    light = np.geomspace(3.0, 3e6, 40)
    middle = np.full(40, 511.5)
    for length in (0.0, 0.37, 1.9, 14.3, 222.2, 1023.0):
        own = w.signal.snr(light, np.full(40, length))
        truth = matched_snr(w.resolved, straight(length, 0.3927), light, middle, middle)  # type: ignore[arg-type]
        np.testing.assert_allclose(own, truth, rtol=2e-3)
    half = w.signal.snr(light, np.full(40, 2048.0))
    np.testing.assert_allclose(half, w.signal.snr(light / 2, np.full(40, 1024.0)), rtol=1e-9)


def test_rates_against_skyfield(objects: Elements) -> None:
    """Of 100 cases, by places half a second before and after, the site's own motion in them."""
    s, _, at, dut1_s = _thousand(objects, False)
    ts = load.timescale(delta_t=69.184 - dut1_s)
    site, satellites = wgs84.latlon(20.7, -156.3, elevation_m=3055), objects.satellites()
    for row in range(0, len(s), 10):
        body = EarthSatellite.from_satrec(satellites[int(s.object[row])], ts)
        t = [ts.tt_jd(2458593.75, (69.184 + at[s.moment[row]] + off) / 86400.0)
             for off in (-0.5, 0.5)]  # fmt: skip
        paths = [(body - site).at(moment).position.m for moment in t]
        turn = separation(*(p / np.linalg.norm(p) for p in paths))
        assert s.rate[row] == pytest.approx(turn, rel=2e-3)
        assert s.rate_arcsec_s[row] == pytest.approx(turn / ARCSEC, rel=2e-3)


def test_light_is_dimmed_by_the_air_on_its_way(objects: Elements) -> None:
    """0.12 mag an airmass, which is 1 / sin(elevation) to 0.5 % above 25 degrees."""
    s, *_ = _thousand(objects, False)
    s = s.take((s.elevation > np.radians(25.0)) & (s.light > 0.0))
    assert len(s) > 200
    told = -2.5 * np.log10(s.light_e / (s.light * watcher().electrons_per_light))
    np.testing.assert_allclose(told, 0.12 / np.sin(s.elevation), rtol=1e-2)


def test_what_a_camera_sees_is_moved_towards_its_own_motion() -> None:
    """By 1e-4 rad at 1e-4 of light's speed; upwards here."""
    up, level = np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]])
    watch: Any = SimpleNamespace(up=up, beta=1e-4 * up)
    without_air: Any = SimpleNamespace(air_terms=())
    seen, elevation = _observed(without_air, watch, np.array([0]), level)
    np.testing.assert_allclose(seen, [[1.0, 0.0, 1e-4]], atol=1e-8)
    np.testing.assert_allclose(elevation, 1e-4, rtol=1e-6)
