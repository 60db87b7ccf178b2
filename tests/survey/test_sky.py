"""The sky behind what is watched, against the renderer's own in that direction at that time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import BadInput
from pipeline.physics.constants import DEG_RAD
from pipeline.physics.positions.times import format_utc, instants
from pipeline.physics.vectors import from_angles, separation, to_angles, unit
from pipeline.resolve.resolve import resolve
from pipeline.spec.load import parse_scene
from pipeline.spec.study import FieldOfRegard
from pipeline.survey.watch import Watcher, make_watcher
from tests.survey.conftest import CAMERA, EPOCH, sections

FULL = {"airglow": True, "moonlight": True, "zodiacal": True, "uniform_mag_arcsec2": 23.0}
SMALL = CAMERA | {"shape": [32, 32]}
ORBIT = {
    "kind": "keplerian", "semi_major_axis_m": 7.2e6, "eccentricity": 0.0,
    "inclination_deg": 98.0, "true_anomaly_deg": 10.0, "epoch": "2019-04-20T06:00:00Z",
}  # fmt: skip


def watcher_of(background: dict[str, Any] | None, **more: Any) -> Watcher:
    asked = sections(**{"background": background, "sensor": SMALL} | more)
    return make_watcher(asked, FieldOfRegard(), EPOCH, False)


def rendered_e_s(w: Watcher, background: dict[str, Any], offset_s: float, u: np.ndarray) -> float:
    """Sky of the middle of a frame that looks along a direction (3,), GCRS, about a moment."""
    at = instants(w.epoch, [offset_s - 0.5])
    ra, dec = (float(np.degrees(a)) for a in to_angles(u))
    plain = w.resolved.scene.as_dict()
    scene = {k: plain[k] for k in ("schema", "name", "observer", "sensor", "exposure")}
    scene |= {
        "epoch": format_utc(float(at.utc1[0]), float(at.utc2[0])), "background": background,
        "pointing": {"mode": "sidereal", "boresight_ra_deg": ra, "boresight_dec_deg": dec},
        "accept": ["moon", "daylight", "sun"], "accuracy": {"check_cells": 0},
    }  # fmt: skip
    return resolve(parse_scene(scene)).scene.facts.background_e_s


def asked(w: Watcher, offset_s: np.ndarray, u: np.ndarray) -> np.ndarray:
    """What the watcher has behind directions (n, 3), GCRS, one at each moment (n,)."""
    watch = w.watch(offset_s)
    teme = np.einsum("nji,nj->ni", watch.to_gcrs, u)
    return w.sky_e_s(watch, np.arange(len(u)), teme)


def above(w: Watcher, offset_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A direction (n, 3), GCRS, at each moment: from 12 degrees up, 12 or more from the Moon."""
    watch, out = w.watch(offset_s), []
    for k in range(len(offset_s)):
        up = watch.to_gcrs[k] @ watch.up[k]
        moon = unit(watch.to_gcrs[k] @ (watch.moon_m[k] - watch.observer_m[k]))
        while True:
            u = from_angles(*np.array([rng.uniform(0, 2 * np.pi), np.arcsin(rng.uniform(-1, 1))]))
            if u @ up > np.sin(12 * DEG_RAD) and separation(u, moon) > 12 * DEG_RAD:
                break
        out.append(u)
    return np.array(out)


def test_a_site_against_the_renderer() -> None:
    """A night two days after full Moon, which rises in it: a factor of 5 between directions."""
    w, rng = watcher_of(FULL), np.random.default_rng(3)
    offset_s = rng.uniform(0.0, 9 * 3600.0, 24)
    u = above(w, offset_s, rng)
    own = asked(w, offset_s, u)
    truth = [rendered_e_s(w, FULL, t, d) for t, d in zip(offset_s, u, strict=True)]
    assert max(truth) > 4.0 * min(truth)
    np.testing.assert_allclose(own, truth, rtol=0.015)


def test_dusk_against_the_renderer() -> None:
    """Twilight falls by a magnitude in some four minutes; between tables it is followed, also where
    an exposure lasts a minute: a moment is that of its middle."""
    sky = {"airglow": True, "twilight": True}
    long = watcher_of(sky, exposure={"integration_s": 60.0})
    w, rng = watcher_of(sky), np.random.default_rng(4)
    offset_s = -3600.0 + rng.uniform(0.0, 2400.0, 8)
    u = above(w, offset_s, rng)
    truth = [rendered_e_s(w, sky, t, d) for t, d in zip(offset_s, u, strict=True)]
    assert max(truth) > 10.0 * min(truth)
    np.testing.assert_allclose(asked(w, offset_s, u), truth, rtol=0.04)
    np.testing.assert_allclose(asked(long, offset_s, u), truth, rtol=0.04)
    assert asked(w, np.zeros(0), np.zeros((0, 3))).shape == (0,)


def test_a_satellite_against_the_renderer() -> None:
    sky = {"zodiacal": True, "galactic": True}
    w = watcher_of(sky, observer={"kind": "orbit", "orbit": ORBIT})
    rng, offset_s = np.random.default_rng(5), np.linspace(60.0, 5000.0, 12)
    watch = w.watch(offset_s)
    sun = unit(np.einsum("nij,nj->ni", watch.to_gcrs, watch.sun_m))
    u = above(w, offset_s, rng)
    far = separation(u, sun) > 25 * DEG_RAD
    truth = [rendered_e_s(w, sky, t, d) for t, d in zip(offset_s[far], u[far], strict=True)]
    np.testing.assert_allclose(asked(w, offset_s, u)[far], truth, rtol=0.08)


def test_starlight_alone_against_the_renderer() -> None:
    """The published counts, as no catalogue is named; the last but one is in the Milky Way."""
    sky = {"starlight": "all"}
    w, offset_s = watcher_of(sky), np.linspace(0.0, 9 * 3600.0, 8)
    u = above(w, offset_s, np.random.default_rng(8))
    truth = [rendered_e_s(w, sky, t, d) for t, d in zip(offset_s, u, strict=True)]
    assert max(truth) > 2.0 * min(truth) > 0.0
    np.testing.assert_allclose(asked(w, offset_s, u), truth, rtol=0.08)


@pytest.mark.parametrize("observer", [None, {"kind": "orbit", "orbit": ORBIT}])
def test_stray_light_against_the_renderer(observer: dict[str, Any] | None) -> None:
    """That of each line of sight at its own moment: of the Moon from a site, of all three bodies
    along an orbit, into and out of the Earth's shadow."""
    pst = {"kind": "harvey", "b0_per_sr": 0.06, "shoulder": 0.02, "slope": -1.9}
    sky = {"stray_light": {"pst": pst, "inside": "clip", "exclusion_deg": 1.0}}
    w = watcher_of(sky, **{} if observer is None else {"observer": observer})
    assert w.resolved.facts.background_e_s == 0.0
    offset_s = np.sort(np.random.default_rng(6).uniform(0.0, 6000.0, 16))
    u = above(w, offset_s, np.random.default_rng(7))
    truth = [rendered_e_s(w, sky, t, d) for t, d in zip(offset_s, u, strict=True)]
    assert max(truth) > 5.0 * min(truth)
    np.testing.assert_allclose(asked(w, offset_s, u), truth, rtol=1e-2, atol=1e-9)


def test_a_curve_that_ends_is_refused_where_a_sensor_may_look_anywhere(tmp_path: Path) -> None:
    (tmp_path / "pst.csv").write_text("angle_deg,pst\n1,1e-3\n90,1e-9\n")
    pst = {"kind": "table", "path": str(tmp_path / "pst.csv")}
    with pytest.raises(BadInput, match=r"ends at 90 deg.*180 degrees, as a sensor"):
        watcher_of({"stray_light": {"pst": pst | {"beyond": "refuse"}}})
    assert watcher_of({"stray_light": {"pst": pst | {"beyond": "zero"}}}).sky is not None


def test_near_the_sun_it_is_the_brightest_that_is_known() -> None:
    w = watcher_of({"zodiacal": True}, observer={"kind": "orbit", "orbit": ORBIT})
    watch = w.watch(np.zeros(1))
    assert w.sky is not None
    at_sun = w.sky_e_s(watch, np.zeros(1, np.int64), unit(watch.sun_m - watch.observer_m))
    table = np.exp(w.sky.at(0.0))
    assert at_sun == pytest.approx(table.max(), rel=1e-6)
    assert np.isfinite(table).all()


def test_a_sky_that_is_the_same_everywhere_has_no_table() -> None:
    w = watcher_of({"uniform_mag_arcsec2": 21.0})
    assert w.sky is None
    assert "the same everywhere" in w.sky_note
    sky = asked(w, np.zeros(2), above(w, np.zeros(2), np.random.default_rng(1)))
    np.testing.assert_array_equal(sky, w.resolved.facts.background_e_s)
    assert watcher_of(None).sky is None


def test_moon_and_twilight_are_in_the_sky_behind_alone() -> None:
    steady = {"airglow": True, "uniform_mag_arcsec2": 22.0}
    w = watcher_of(steady | {"moonlight": True, "twilight": True})
    assert w.resolved.facts.background_e_s == watcher_of(steady).resolved.facts.background_e_s
    assert "without what comes and goes" in w.sky_note
    only = watcher_of({"moonlight": True})
    assert only.resolved.facts.background_e_s == 0.0
    assert only.sky is not None


@pytest.mark.parametrize("change", [{}, {"photon_noise": False}, {"flat": 0.25}])
def test_snr_is_that_of_the_sky_behind(change: dict[str, Any]) -> None:
    """Under a sky 3 magnitudes brighter: the table of a sensor that has that sky everywhere."""
    camera = SMALL | change
    dark = sections(sensor=camera, background={"uniform_mag_arcsec2": 21.0, "airglow": True})
    w = make_watcher(dark, FieldOfRegard(), EPOCH, False)
    more = sections(sensor=camera, background={"uniform_mag_arcsec2": 18.0})
    bright = make_watcher(more, FieldOfRegard(), EPOCH, False)
    light, length = np.geomspace(30.0, 3e6, 40), np.linspace(0.0, 25.0, 40)
    own = w.snr(light, length, bright.resolved.facts.background_e_s)
    np.testing.assert_allclose(own, bright.signal.snr(light, length), rtol=3e-3)
    assert (w.snr(light, length, 0.0) >= w.snr(light, length, 50.0)).all()


def test_no_signal_stands_out_of_full_pixels() -> None:
    """16 bits of 2 e- above a bias of 500: full at 130,070 e-; a well of 50,000 e- before that."""
    light, still = np.full(3, 1e4), np.zeros(3)
    sky = np.array([40_000.0, 129_000.0, 131_000.0])
    for well, seen in ((None, [True, True, False]), (50_000.0, [True, False, False])):
        camera = SMALL | {"gain_e_per_dn": 2.0, "bias_dn": 500.0, "full_well_e": well}
        w = make_watcher(sections(sensor=camera), FieldOfRegard(), EPOCH, False)
        assert w.resolved.full_e == (well or 2.0 * (65_535 - 500))
        assert ((w.snr(light, still, sky) > 0.0) == seen).all()
        assert "FILLS" not in w.sky_note
    filled = make_watcher(
        sections(background={"uniform_e_per_s": 2e5}), FieldOfRegard(), EPOCH, False
    )
    assert "FILLS IT (6.55e+04 e-)" in filled.sky_note


def test_light_that_a_bright_sky_drowns_has_no_signal() -> None:
    """Under 6e4 e- of sky: as of a sensor that has it everywhere, to any faintness."""
    camera = SMALL | {"read_noise_e": 0.3, "gain_e_per_dn": 1.0, "adc_bits": 24}
    dark = sections(sensor=camera, background={"moonlight": True})
    w = make_watcher(dark, FieldOfRegard(), EPOCH, False)
    light = np.geomspace(1e-3, 1e5, 33)
    own = w.snr(light, np.zeros(33), 6e4)
    bright = sections(sensor=camera, background={"uniform_e_per_s": 6e4})
    other = make_watcher(bright, FieldOfRegard(), EPOCH, False)
    np.testing.assert_allclose(own, other.snr(light, np.zeros(33), 6e4), rtol=5e-3)
    assert own[0] < 1e-4
    assert (w.snr(np.array([0.0, -1.0]), np.zeros(2), 6e4) == 0.0).all()


def test_a_table_is_of_what_its_files_hold(tmp_path: Path) -> None:
    """One that was replaced under the same name counts."""
    curve = tmp_path / "qe.csv"
    found = []
    for value in (0.9, 0.3):
        curve.write_text(f"300,{value}\n1000,{value}\n")
        w = watcher_of({"zodiacal": True}, sensor=SMALL | {"quantum_efficiency": str(curve)})
        found.append(asked(w, np.array([60.0]), np.array([[0.0, 0.0, 1.0]]))[0])
    assert found[0] == pytest.approx(3.0 * found[1], rel=1e-3)


@pytest.mark.parametrize("part", ["zodiacal", "galactic"])
def test_a_site_without_air(part: str) -> None:
    site = {k: v for k, v in sections()["observer"].items() if k != "atmosphere"}
    w = watcher_of({part: True}, observer=site)
    rng, offset_s = np.random.default_rng(8), np.array([700.0, 9000.0, 20_000.0])
    u = above(w, offset_s, rng)
    truth = [rendered_e_s(w, {part: True}, t, d) for t, d in zip(offset_s, u, strict=True)]
    np.testing.assert_allclose(asked(w, offset_s, u), truth, rtol=0.05)


def test_an_orbit_is_asked_for_no_moment_beyond_the_period() -> None:
    """A table of states that ends with it."""
    at_s = np.linspace(-60.0, 5000.0, 102)
    turn = 2.0 * np.pi * at_s / 6000.0
    places = 7.2e6 * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    rows = np.column_stack([at_s, places]).tolist()
    orbit = {"kind": "table", "epoch": "2019-04-20T06:00:00Z", "rows": rows}
    w = watcher_of({"zodiacal": True}, observer={"kind": "orbit", "orbit": orbit})
    assert np.isfinite(asked(w, np.array([30.0, 4900.0]), np.eye(3)[:2])).all()


def test_a_site_at_the_pole() -> None:
    site = sections()["observer"] | {"latitude_deg": -90.0, "longitude_deg": 0.0}
    w = watcher_of(FULL, observer=site)
    rng, offset_s = np.random.default_rng(6), np.array([300.0, 5100.0])
    u = above(w, offset_s, rng)
    truth = [rendered_e_s(w, FULL, t, d) for t, d in zip(offset_s, u, strict=True)]
    np.testing.assert_allclose(asked(w, offset_s, u), truth, rtol=0.05)
