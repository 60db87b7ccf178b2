"""Pointing: local directions, accelerated rates, tables, drift, random motion, frame by frame."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.arrays import Refined
from pipeline.errors import BadInput
from pipeline.physics.positions.apparent import unaberrate
from pipeline.physics.positions.focal_plane import deproject, project
from pipeline.plan.accuracy import part_sigma
from pipeline.plan.pointing.attitude_motion import motion_plan, random_motion_rad
from pipeline.plan.pointing.geometry import (
    bend_px,
    camera_of,
    plan_geometry,
    sampled_frames,
    star_paths,
)
from pipeline.plan.pointing.motion_runs import jitter_waves, mode_states
from pipeline.plan.pointing.pointing import rows_s, swept_rad
from pipeline.plan.pointing.star_paths import excursions_px
from pipeline.plan.timing import dwell_plans, frame_count, frame_times
from pipeline.spec.scene import Scene

Make = Callable[..., Scene]
C = 299_792_458.0
ARCSEC = math.pi / 648_000
MIDDLE = np.array([383.5]), np.array([255.5])
GROUND = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055.0}
LOCAL = {"mode": "local", "azimuth_deg": 100.0, "elevation_deg": 35.0, "roll_deg": 0.0}
SIDEREAL = {"mode": "sidereal", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0}
LEO = {"kind": "orbit", "orbit": {
    "kind": "state", "position_m": [6.9e6, 0.0, 0.0], "velocity_m_s": [100.0, 5374.0, 5374.0]}}


def every(scene: Scene) -> Any:
    return plan_geometry(scene, np.arange(scene.exposure.frames), 0.0)


def path(scene: Scene, g: Any, frame: int = 0) -> np.ndarray:
    """(2, K) way of the star in the middle, from its place at mid-exposure."""
    one = g.frame_slice(frame)
    way = star_paths(camera_of(scene), one, *MIDDLE)[:, 0, 0]
    return way - way[:, [one.middle]]


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 20), (100, 35), (250, 80), (180, 90)])
def test_against_skyfield_local_directions(
    scene: Make, azimuth: float, elevation: float
) -> None:
    """Azimuth and elevation of a site, for another account of the Earth's turn."""
    api = pytest.importorskip("skyfield.api")
    s = scene({"observer": GROUND, "pointing": LOCAL | {
        "azimuth_deg": azimuth, "elevation_deg": elevation}, "exposure.frames": 2})  # fmt: skip
    times = api.load.timescale(builtin=True)
    t = times.utc(2019, 4, 20, 3, 0, 1.0)
    g = plan_geometry(s, np.array([0]), float(t.dut1))
    site = api.wgs84.latlon(20.7, -156.3, 3055.0)
    theirs = site.at(t).from_altaz(alt_degrees=elevation, az_degrees=azimuth)
    ra, dec, _ = theirs.radec()
    u = np.array([
        math.cos(dec.radians) * math.cos(ra.radians),
        math.cos(dec.radians) * math.sin(ra.radians), math.sin(dec.radians),
    ])  # fmt: skip
    off = np.linalg.norm(np.cross(g.attitude[0, g.middle, 2], u))
    assert off < 1.0 * ARCSEC


def test_a_drift_scan_lets_the_sky_pass_at_its_own_rate(scene: Make) -> None:
    s = scene({"observer": GROUND, "pointing": LOCAL})
    g = every(s)
    u = unaberrate(g.attitude[0, g.middle, 2][None], g.observer_m_s[0, g.middle] / C)[0]
    length = np.hypot(*np.ptp(path(s, g), axis=1))
    expected = 7.2921159e-5 * math.sqrt(1 - u[2] ** 2) * 2.0 / 1e-5
    assert length == pytest.approx(expected, rel=2e-4)
    assert (g.attitude[:, :, 1] @ g.attitude[0, 0, 1]).min() > 0.99  # +y stays on the zenith's side


@pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, 10.0), (90.0, 5.0), (200.0, 60.0)])
def test_directions_in_an_orbits_own_frame(scene: Make, azimuth: float, elevation: float) -> None:
    s = scene({"observer": LEO, "pointing": LOCAL | {
        "azimuth_deg": azimuth, "elevation_deg": elevation}})  # fmt: skip
    g = every(s)
    r, v = np.array([6.9e6, 0, 0]), np.array([100.0, 5374.0, 5374.0])
    up = r / np.linalg.norm(r)
    forward = np.array([0, 1, 1]) / math.sqrt(2)
    right = np.cross(forward, up)
    a, e = math.radians(azimuth), math.radians(elevation)
    wanted = math.cos(e) * (math.cos(a) * forward + math.sin(a) * right) + math.sin(e) * up
    assert np.allclose(g.attitude[0, 0, 2], wanted, atol=1e-12)
    assert g.attitude[0, 0, 1] @ up > 0
    assert v @ forward > 0


def test_acceleration_and_roll_rate(scene: Make) -> None:
    """Against the second difference of the path, and the turn of a star at the frame's edge."""
    rates = {"mode": "rate", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0,
             "rate_ra_arcsec_s": 20.0, "rate_dec_arcsec_s": 0.0}  # fmt: skip
    still = {"stars.aberration": False, "stars.deflection": False}
    s = scene({"pointing": rates | {"acceleration_dec_arcsec_s2": 30.0}} | still)
    x, y = path(s, every(s))
    t = np.linspace(0.0, 2.0, len(x))
    assert np.allclose(x - x[0], 20.0 * t * ARCSEC / 1e-5, atol=2e-2)
    assert np.allclose(y - y[0], -15.0 * t**2 * ARCSEC / 1e-5, atol=2e-2)
    s = scene({"pointing": rates | {"rate_ra_arcsec_s": 0.0, "roll_rate_deg_s": 0.5}} | still)
    g = every(s)
    way = star_paths(camera_of(s), g, np.array([483.5]), np.array([255.5]), False)[:, 0, 0]
    angle = np.degrees(np.unwrap(np.arctan2(way[1] - 255.5, way[0] - 383.5)))
    assert angle[-1] - angle[0] == pytest.approx(-1.0, abs=1e-6)
    assert np.allclose(np.hypot(way[0] - 383.5, way[1] - 255.5), 100.0, atol=1e-6)


def rows_of(g: Any, frames: range, scalar: str = "last") -> tuple[np.ndarray, np.ndarray]:
    """Times and quaternions camera to sky of attitudes at a geometry's nodes."""
    axes = g.attitude[list(frames)].reshape(-1, 3, 3) * np.array([-1.0, 1.0, 1.0])[:, None]
    q = Rotation.from_matrix(np.swapaxes(axes, -1, -2)).as_quat()
    return g.offset_s[list(frames)].ravel(), q[:, [3, 0, 1, 2]] if scalar == "first" else q


@pytest.mark.parametrize("scalar", ["first", "last"])
@pytest.mark.parametrize("rotation", ["camera_to_sky", "sky_to_camera"])
def test_a_table_stands_for_what_it_was_made_from(
    scene: Make, scalar: str, rotation: str
) -> None:
    """A drift scan as a table of its own quaternions (proper: gcrs) streaks the same way."""
    plain = scene({"observer": GROUND, "pointing": LOCAL, "exposure.cadence_s": 2.0})
    g = every(plain)
    time, q = rows_of(g, range(5), scalar)
    time, index = np.unique(np.round(time, 9), return_index=True)
    q = q[index]
    if rotation == "sky_to_camera":
        q = q * (np.array([1, -1, -1, -1]) if scalar == "first" else np.array([-1, -1, -1, 1]))
    table = {"mode": "table", "frame": "gcrs", "scalar": scalar, "rotation": rotation,
             "rows": np.column_stack([time, q]).tolist()}  # fmt: skip
    s = scene({"observer": GROUND, "pointing": table, "exposure.cadence_s": 2.0})
    again = every(s)
    assert np.allclose(again.attitude, g.attitude, atol=1e-9)
    mounted = Rotation.from_euler("xyz", [0.3, -1.0, 2.0])
    body = Rotation.from_quat(q if scalar == "last" else q[:, [1, 2, 3, 0]])
    body = body * mounted.inv() if rotation == "camera_to_sky" else mounted * body
    order = [0, 1, 2, 3] if scalar == "last" else [3, 0, 1, 2]
    table |= {"mounting": mounted.as_quat()[order].tolist(),
              "rows": np.column_stack([time, body.as_quat()[:, order]]).tolist()}  # fmt: skip
    s = scene({"observer": GROUND, "pointing": table, "exposure.cadence_s": 2.0})
    assert np.allclose(every(s).attitude, g.attitude, atol=1e-9)


def test_a_table_among_the_stars_is_aberrated_as_sidereal_is(scene: Make) -> None:
    from pipeline.physics.motion.pointing import boresight_frame
    from pipeline.physics.vectors import from_angles

    held = boresight_frame(from_angles(np.radians(40.0), np.radians(25.0)), 0.0)
    q = Rotation.from_matrix((held * np.array([-1.0, 1.0, 1.0])[:, None]).T).as_quat()
    rows = [[t, *q] for t in (0.0, 100.0)]
    table = {"mode": "table", "frame": "icrs", "scalar": "last", "rows": rows}
    s = scene({"observer": LEO, "pointing": table})
    plain = scene({"observer": LEO, "pointing": SIDEREAL})
    assert np.allclose(every(s).attitude, every(plain).attitude, atol=1e-14)


BAD_TABLES: dict[str, tuple[dict[str, Any], str, str]] = {
    "too short": ({"rows": [[0, 0, 0, 0, 1], [5, 0, 0, 0, 1]]}, "pointing.rows", "covers"),
    "falling": ({"rows": [[0, 0, 0, 0, 1], [0, 0, 0, 0, 1]]}, "pointing.rows", "increase"),
    "norm": ({"rows": [[0, 0, 0, 0, 1], [99, 0, 0, 0, 1.1]]}, "pointing.rows", "norm"),
    "mounting": ({"rows": [[0, 0, 0, 0, 1], [99, 0, 0, 0, 1]], "mounting": [0, 0, 0, 2]},
                 "pointing.mounting", "norm"),
    "epoch": ({"rows": [[0, 0, 0, 0, 1], [99, 0, 0, 0, 1]], "epoch": "soon"},
              "pointing.epoch", "UTC"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_TABLES)
def test_tables_that_cannot_be_used(scene: Make, name: str) -> None:
    change, field, word = BAD_TABLES[name]
    table = {"mode": "table", "frame": "icrs", "scalar": "last"} | change
    with pytest.raises(BadInput) as caught:
        every(scene({"pointing": table}))
    assert caught.value.field == field
    assert word in str(caught.value)


def test_local_pointing_needs_a_place(scene: Make) -> None:
    with pytest.raises(BadInput, match="ground site or an orbit"):
        every(scene({"pointing": LOCAL}))


@pytest.mark.parametrize(
    ("pointing", "field", "told"),
    [({"mode": "table", "path": "a.csv", "frame": "icrs", "scalar": "last"}, "pointing.path",
      "a table that was read"),
     (SIDEREAL | {"attitude": {"jitter": [{"kind": "table", "path": "a.csv"}]}},
      "pointing.attitude.jitter", "a spectrum that was read")],
    ids=["attitudes", "spectrum"],
)  # fmt: skip
def test_files_that_nobody_has_read_are_refused(
    scene: Make, pointing: dict[str, Any], field: str, told: str
) -> None:
    with pytest.raises(BadInput) as caught:
        every(scene({"pointing": pointing}))
    assert str(caught.value) == f"{field}: 'a.csv' is not accepted; allowed: {told}"


def test_an_orbit_straight_up_has_no_way_forward(scene: Make) -> None:
    up = {"kind": "state", "position_m": [7e6, 0, 0], "velocity_m_s": [3e3, 0, 0]}
    for dwells in (None, [{}, {"pointing": LOCAL}]):
        plain = {"pointing": SIDEREAL, "dwells": dwells} if dwells else {"pointing": LOCAL}
        with pytest.raises(BadInput, match="that does not move straight up") as c:
            every(scene({"observer": {"kind": "orbit", "orbit": up}} | plain))
        assert c.value.field == ("dwells.1.pointing.mode" if dwells else "pointing.mode")


def test_drift_moves_the_stars_against_it(scene: Make) -> None:
    drift = {"drift": {"x_arcsec_s": 8.0, "y_arcsec_s": -6.0}}
    s = scene({"pointing": SIDEREAL | {"attitude": drift}})
    x, y = path(s, every(s))
    scale = ARCSEC * 2.0 / 1e-5
    assert x[-1] - x[0] == pytest.approx(-8.0 * scale, rel=1e-4)
    assert y[-1] - y[0] == pytest.approx(6.0 * scale, rel=1e-4)


def test_drift_in_roll_turns_the_camera_about_its_boresight(scene: Make) -> None:
    drift = {"drift": {"roll_arcsec_s": 300.0}}
    s = scene({"pointing": SIDEREAL | {"attitude": drift}, "exposure.frames": 1,
               "stars.aberration": False, "stars.deflection": False})  # fmt: skip
    start, *_, end = every(s).attitude[0]
    np.testing.assert_allclose(end[2], start[2], atol=1e-12)
    turned = [math.atan2(end[0] @ start[1], end[0] @ start[0]),
              math.atan2(-(end[1] @ start[0]), end[1] @ start[1])]  # fmt: skip
    assert np.abs(turned) == pytest.approx([600.0 * ARCSEC] * 2, rel=1e-6)
    assert turned[0] == pytest.approx(turned[1], rel=1e-9)


RANDOM: dict[str, Any] = {
    "jitter": [
        {"kind": "white", "rms_arcsec": 1.0, "low_hz": 0.2, "high_hz": 100.0},
        {"kind": "power_law", "rms_arcsec": 2.0, "exponent": 2.0, "low_hz": 0.01, "high_hz": 10.0},
    ],
    "modes": [
        {"kind": "oscillator", "axis": "x", "frequency_hz": 1.7, "damping": 0.01,
         "rms_arcsec": 3.0},
        {"kind": "markov", "axis": "roll", "time_constant_s": 300.0, "rms_arcsec": 50.0},
        {"kind": "random_walk", "axis": "y", "arcsec_rts": 0.2},
    ],
}  # fmt: skip


def test_same_random_motion_in_every_window(scene: Make) -> None:
    s = scene({"pointing": SIDEREAL | {"attitude": RANDOM}, "seed": 5})
    whole = every(s)
    for frames in ([4], [2, 3, 0]):
        part = plan_geometry(s, np.array(frames), 0.0)
        for i, frame in enumerate(frames):
            one, other = part.frame_slice(i), whole.frame_slice(frame)
            assert np.array_equal(one.attitude, other.attitude)
    seeded = scene({"pointing": SIDEREAL | {"attitude": RANDOM}, "seed": 6})
    other = plan_geometry(seeded, np.array([0]), 0.0).frame_slice(0)
    assert not np.array_equal(other.attitude, whole.frame_slice(0).attitude)


def test_modes_that_are_alike_move_each_by_itself(
    scene: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also between the ends of an exposure, here at rest."""
    mode = RANDOM["modes"][0]
    s = scene({"pointing": SIDEREAL | {"attitude": {"modes": [mode, mode]}}, "stars": None})
    at_rest = np.zeros((frame_count(s), 2, 2))
    monkeypatch.setattr("pipeline.plan.pointing.motion_runs._ends", lambda *_: at_rest)
    frames = np.arange(2)
    modes = s.pointing.attitude.modes
    one, other = (
        mode_states(s, modes[i], i, frames, frame_times(s, frames)[1], 65)[..., 0] for i in (0, 1)
    )
    assert one.std() > 0.0
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.9


def test_random_motion_has_the_size_asked_for(scene: Make) -> None:
    """Path and blur together, over 300 frames: white 1, flicker 2, mode 3 arcsec rms in x."""
    s = scene({"pointing": SIDEREAL | {"attitude": {**RANDOM, "modes": RANDOM["modes"][:1]}},
               "exposure.frames": 300, "stars": None})  # fmt: skip
    plan = motion_plan(s)
    assert plan is not None
    moved = random_motion_rad(s, np.arange(300), plan.nodes) / ARCSEC
    uneven = 2.0 * (plan.uneven_px * 1e-5 / ARCSEC) ** 2 / 2.0
    blur = (plan.blur_px * 1e-5 / ARCSEC) ** 2
    assert moved[..., 0].var() + blur + uneven == pytest.approx(14.0, rel=0.2)
    assert moved[..., 1].var() + blur - uneven == pytest.approx(5.0, rel=0.2)
    assert np.abs(moved[..., :2].mean(axis=(0, 1))).max() < 0.5


def test_between_its_nodes_random_motion_is_straight(scene: Make) -> None:
    """Where a path that bends more, or light that flickers, asks for more nodes than it."""
    s = scene({"pointing": SIDEREAL | {"attitude": RANDOM}})
    plan, frames = motion_plan(s), np.arange(2)
    assert plan is not None
    coarse = random_motion_rad(s, frames, plan.nodes)
    fine = random_motion_rad(s, frames, 4 * (plan.nodes - 1) + 1)
    at, of = (np.linspace(0.0, 1.0, moved.shape[1]) for moved in (fine, coarse))
    assert np.abs(coarse).max(axis=(0, 1)).min() > 0.01 * ARCSEC
    for k in np.ndindex(2, 3):
        straight = np.interp(at, of, coarse[k[0], :, k[1]])
        np.testing.assert_allclose(fine[k[0], :, k[1]], straight, rtol=0.0, atol=1e-18)


def test_random_motion_goes_on_from_one_exposure_to_the_next(scene: Make) -> None:
    """Where each begins as the one before it ends, 0.5 s and 2 s long in turn."""
    s = scene({"pointing": SIDEREAL | {"attitude": RANDOM}, "exposure.cadence_s": None,
               "dwells": [{"frames": 4, "integration_s": [2.0, 0.5]}]})  # fmt: skip
    plan = motion_plan(s)
    assert plan is not None
    moved = random_motion_rad(s, np.arange(4), plan.nodes)
    assert np.abs(np.ptp(moved, axis=1)).min() > 0.01 * ARCSEC
    np.testing.assert_allclose(moved[1:, 0], moved[:-1, -1], rtol=0.0, atol=1e-6 * ARCSEC)


@pytest.mark.parametrize("noise_fraction", [0.5, 0.05])
def test_blur_leaves_out_no_more_than_is_asked(scene: Make, noise_fraction: float) -> None:
    """Both of what it leaves out of an exposure's mean, and of the error that comes of it."""
    flicker = {"kind": "power_law", "rms_arcsec": 0.5, "exponent": 1.0, "low_hz": 0.01,
               "high_hz": 100.0}  # fmt: skip
    s = scene({"pointing": SIDEREAL | {"attitude": {"jitter": [flicker]}},
               "accuracy": {"noise_fraction": noise_fraction}})  # fmt: skip
    plan = motion_plan(s)
    assert plan is not None
    assert plan.left_px <= 5e-3
    assert 4.0 * plan.left_px < plan.error_sigma <= part_sigma(s)


@pytest.mark.parametrize("times_s", [[4.0], [0.5, 20.0]], ids=["one", "short and long"])
def test_slow_motion_is_a_path_and_no_blur(scene: Make, times_s: list[float]) -> None:
    """In short exposures beside long ones, too: each is within what the plan says of its waves."""
    noise = {"kind": "white", "rms_arcsec": 8.0, "low_hz": 0.02, "high_hz": 0.04}
    s = scene({"pointing": SIDEREAL | {"attitude": {"jitter": [noise]}}, "stars": None,
               "exposure.cadence_s": None, "dwells": [{"integration_s": times_s}]})  # fmt: skip
    plan, frames = motion_plan(s), np.arange(frame_count(s))
    assert plan is not None
    assert (plan.blur_px, plan.scatter) == (0.0, 0.0)
    assert plan.path_px == pytest.approx(8.0 * ARCSEC / 1e-5, rel=1e-3)
    run = jitter_waves(s.pointing.attitude.jitter[0], 0, s.seed, plan.split_hz)
    moved, (start, time) = random_motion_rad(s, frames, plan.nodes), frame_times(s, frames)
    share, nodes = np.linspace(0.0, 1.0, 2001), np.linspace(0.0, 1.0, plan.nodes)
    for k in frames:
        own = run.at(start[k] + share * time[k])
        for axis in (0, 1):
            off_px = (own[:, axis] - np.interp(share, nodes, moved[k, :, axis])) / 1e-5
            assert np.sqrt(np.mean(off_px**2)) <= 2.0 * plan.left_px


@pytest.mark.parametrize("time_s", [0.94, 0.3, 7.1, 1.0 / 3.0])
def test_a_mode_is_path_or_blur_for_plan_and_drawing_alike(scene: Make, time_s: float) -> None:
    """An oscillation of an eighth of a turn between nodes, to the last digit."""
    mode = {"kind": "oscillator", "axis": "x", "frequency_hz": 1.0 / time_s, "damping": 1e-6,
            "rms_arcsec": 3.0}  # fmt: skip
    s = scene({"pointing": SIDEREAL | {"attitude": {"modes": [mode]}}, "stars": None,
               "exposure.integration_s": time_s})  # fmt: skip
    plan = motion_plan(s)
    assert plan is not None
    drawn = random_motion_rad(s, np.arange(2), plan.nodes).any()
    assert drawn == (plan.path_px > 0.0)
    assert drawn != (plan.blur_px > 0.1)


def test_a_steady_rate_leaves_no_blur(scene: Make) -> None:
    """Of both axes alike: a streak that is straight loses nothing between its nodes."""
    modes = [{"kind": "rate_markov", "axis": axis, "time_constant_s": 1e6, "rms_arcsec_s": 8.0}
             for axis in "xy"]  # fmt: skip
    plan = motion_plan(scene({"pointing": SIDEREAL | {"attitude": {"modes": modes}}}))
    assert plan is not None
    assert max(plan.blur_px, plan.left_px, plan.uneven_px) < 1e-3


def test_a_blur_of_one_axis_is_uneven_whichever_it_is(scene: Make) -> None:
    found = []
    for axis in ("x", "y"):
        mode = {"kind": "oscillator", "axis": axis, "frequency_hz": 900.0, "damping": 0.01,
                "rms_arcsec": 0.5}  # fmt: skip
        plan = motion_plan(scene({"pointing": SIDEREAL | {"attitude": {"modes": [mode]}}}))
        assert plan is not None
        found.append((plan.uneven_px, plan.error_sigma))
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert found[0][0] == pytest.approx(0.5 * ARCSEC / 1e-5 / math.sqrt(2.0), rel=0.05)


def test_frames_and_windows_meet_where_they_touch(scene: Make) -> None:
    """A frame that starts when the one before ends starts where it ended."""
    s = scene({"pointing": SIDEREAL | {"attitude": RANDOM}, "exposure.cadence_s": 2.0})
    g = every(s)
    assert np.abs(g.attitude[:-1, -1] - g.attitude[1:, 0]).max() < 1e-9


def test_a_frame_that_bends_more_is_found_and_gets_more_nodes(scene: Make) -> None:
    """A kick in one frame of 40, which is none of those that the plan looks at."""
    time = np.linspace(0.0, 400.0, 4001)
    angle = 4e-5 * np.sin(0.5 * np.pi * (time - 130.0)) ** 2 * ((time > 130.0) & (time < 132.0))
    turn = Rotation.from_rotvec(np.outer(angle, [1.0, 0.0, 0.0]))
    rows = np.column_stack([time, turn.as_quat()])
    table = {"mode": "table", "frame": "gcrs", "scalar": "last", "interpolation": "spline",
             "rows": rows.tolist()}  # fmt: skip
    s = scene({"pointing": table, "exposure.frames": 40, "stars.aberration": False,
               "stars.deflection": False})  # fmt: skip
    assert 13 not in sampled_frames(s)
    window = plan_geometry(s, np.arange(10, 20), 0.0)
    assert isinstance(window, Refined)
    assert list(window.finer) == [3]
    one, alone = window.frame_slice(3), plan_geometry(s, np.array([13]), 0.0).frame_slice(0)
    assert one.nodes > window.nodes == window.frame_slice(2).nodes
    more = (one.nodes - 1) // (window.nodes - 1)  # steps where there was one: 2, 4, 8 ...
    assert more.bit_count() == 1
    assert np.allclose(one.offset_s[0, ::more], window.offset_s[3], rtol=0.0, atol=1e-9)
    assert np.array_equal(one.attitude, alone.attitude)
    assert np.array_equal(one.attitude[0, one.middle], window.attitude[3, window.middle])
    x, y = path(s, window, 3)
    fine = 4e-5 * np.sin(0.5 * np.pi * np.linspace(0.0, 2.0, one.nodes)) ** 2
    assert np.ptp(np.hypot(x, y)) > 1.0
    assert np.allclose(np.abs(y - y[0]), fine / 1e-5, atol=5e-3)


def test_how_far_stars_come_is_told_from_the_nodes_of_each_frame(scene: Make) -> None:
    """A jerk of 20 px, that is 6 px at the nodes next to it of frames that stand still."""
    time = np.union1d(np.linspace(0.0, 400.0, 4001), np.linspace(130.0, 132.0, 201))
    angle = 2e-4 * np.exp(-0.5 * ((time - 130.375) / 0.08) ** 2)
    turn = Rotation.from_rotvec(np.outer(angle, [1.0, 0.0, 0.0]))
    table = {"mode": "table", "frame": "gcrs", "scalar": "last", "interpolation": "spline",
             "rows": np.column_stack([time, turn.as_quat()]).tolist()}  # fmt: skip
    s = scene({"pointing": table, "exposure.frames": 40, "stars.aberration": False})
    g = plan_geometry(s, np.arange(12, 15), 0.0)
    assert isinstance(g, Refined)
    assert list(g.finer) == [1]
    before, far, after = excursions_px(camera_of(s), g, False)
    assert before == after == 0.0
    assert 20.0 <= far <= 32.0


def test_stars_that_enter_a_wide_field_are_counted_from_where_they_come(scene: Make) -> None:
    """60 degrees of sky that turn by 51 and roll by 40: beside it a turn moves places farther."""
    s = scene({
        "pointing": {"mode": "rate", "boresight_ra_deg": 100.0, "boresight_dec_deg": 10.0,
                     "rate_ra_arcsec_s": 12_000.0, "rate_dec_arcsec_s": 14_000.0,
                     "roll_deg": 20.0, "roll_rate_deg_s": 4.0},
        "exposure": {"integration_s": 10.0}, "stars.aberration": False, "stars.deflection": False,
        "sensor.shape": [256, 256], "sensor.pixel_pitch_um": 20.0,
        "sensor.focal_length_m": 4.43e-3, "sensor.aperture_m": 2e-3,
    })  # fmt: skip
    g, camera = plan_geometry(s, np.arange(1), 0.0), camera_of(s)
    edge = np.linspace(0.0, 255.0, 64)
    x = np.concatenate([edge, edge, 0.0 * edge, 0.0 * edge + 255.0])
    y = np.concatenate([0.0 * edge, 0.0 * edge + 255.0, edge, edge])
    moved = [0.0]
    for k in range(g.nodes):  # along the edges at each node
        u = deproject(camera, g.attitude[0, k], x, y)
        at = np.stack(project(camera, g.attitude[0, g.middle], u))
        moved.append(float(np.nanmax(np.hypot(at[0] - x, at[1] - y))))
    (told,) = excursions_px(camera, g, False)
    assert 0.5 * told < max(moved) < told


def test_absurd_accelerations_are_refused(scene: Make) -> None:
    rates = {"mode": "rate", "boresight_ra_deg": 40.0, "boresight_dec_deg": 25.0,
             "rate_ra_arcsec_s": 20.0, "rate_dec_arcsec_s": 0.0,
             "acceleration_ra_arcsec_s2": 9e6}  # fmt: skip
    with pytest.raises(BadInput, match="rates of at most"):
        every(scene({"pointing": rates}))


@pytest.mark.parametrize("a", [[[1.0]], [[-1.0, 0.0], [0.0, 0.5]], [[0.5, 0.0], [0.0, -1.0]]])
def test_a_mode_that_grows_is_refused(scene: Make, a: list[list[float]]) -> None:
    n = len(a)
    system = {"kind": "system", "a": a, "b": [[1.0]] * n, "c": [[1.0] * n, [0.0] * n, [0.0] * n]}
    growing = scene({"pointing": SIDEREAL | {"attitude": {"modes": [system]}}})
    with pytest.raises(BadInput, match="positive real part") as caught:
        every(growing)
    assert caught.value.field == "pointing.attitude.modes.0.a"
    assert f"grows by {max(a[k][k] for k in range(n)):g} per s" in str(caught.value)


def test_random_motion_does_not_count_as_a_bend(scene: Make) -> None:
    """What is lost of it between nodes is blur."""
    shaken, still = (
        scene({"pointing": SIDEREAL | more}) for more in ({"attitude": RANDOM}, {})
    )
    found = [bend_px(s, plan_geometry(s, np.arange(1), 0.0), 0.0) for s in (shaken, still)]
    assert found[0] <= max(found[1], 1e-6)


def test_what_an_exposure_sweeps_is_bounded_by_its_last_rate(scene: Make) -> None:
    """5 arcsec/s and 1 arcsec/s^2 more: 28 arcsec in the 2 s up to 10 s after the start."""
    rates = {"rate_ra_arcsec_s": 3.0, "rate_dec_arcsec_s": 4.0,
             "acceleration_ra_arcsec_s2": 0.6, "acceleration_dec_arcsec_s2": 0.8}  # fmt: skip
    pointing = scene({"pointing": SIDEREAL | {"mode": "rate"} | rates}).pointing
    assert 28.0 <= swept_rad(pointing, 10.0, 2.0) / ARCSEC <= 30.0 + 1e-9


def test_rows_of_a_table_of_another_epoch_are_timed_by_the_scenes(scene: Make) -> None:
    """Whose epoch is ten seconds after the table's."""
    rows = [[t, 0.0, 0.0, 0.0, 1.0] for t in (0.0, 10.0, 12.5, 60.0)]
    table = {"mode": "table", "frame": "icrs", "scalar": "last", "rows": rows,
             "epoch": "2019-04-20T02:59:50Z"}  # fmt: skip
    s = scene({"pointing": table})
    [plan] = dwell_plans(s)
    assert rows_s(s, plan, s.pointing) == pytest.approx([-10.0, 0.0, 2.5, 50.0], abs=1e-9)


@pytest.mark.parametrize("shortest_s", [0.1, 0.4])
def test_blur_leaves_out_what_the_shortest_exposure_sees(scene: Make, shortest_s: float) -> None:
    """Of waves faster than the blur's edge the mean over T is as 1 / (f T), as their sinc."""
    noise = {"kind": "white", "rms_arcsec": 4.0, "low_hz": 1e-3, "high_hz": 1e4}
    pointing = SIDEREAL | {"attitude": {"jitter": [noise]}}
    several, some, longest = (
        motion_plan(scene({"pointing": pointing, "dwells": [{"integration_s": times}]}))
        for times in ([6.4, shortest_s], [6.4, 0.8], [6.4])
    )
    assert several.nodes == some.nodes == longest.nodes
    more, less = (plan.left_px**2 - longest.left_px**2 for plan in (several, some))
    expected = (shortest_s**-2 - 6.4**-2) / (0.8**-2 - 6.4**-2)
    assert more / less == pytest.approx(expected, rel=0.2)
