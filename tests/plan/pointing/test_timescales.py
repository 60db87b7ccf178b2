"""What is short against an exposure, or comes back as often as its nodes, is seen all the same."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.integrate import quad

from pipeline.inputs.targets.mesh_surfaces import make_surface
from pipeline.inputs.targets.meshes import gather_meshes
from pipeline.plan.bodies import changes
from pipeline.plan.bodies.changes import apart_s, has_means, looks_asked, most_looks
from pipeline.plan.bodies.changes import mean_light as mean_light_around
from pipeline.plan.pointing import timescales
from pipeline.plan.pointing.geometry import _geometry, plan_geometry
from pipeline.plan.pointing.timescales import hurried_remarks, light_off, light_warnings, looks
from pipeline.plan.sensor.rolling import _of_every_dwell
from pipeline.route.prepare import plan_scene
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import Scene
from pipeline.spec.targets.mesh import MeshBody

PX_ARCSEC = np.degrees(9e-6 / 0.4) * 3600.0
SCENE: dict[str, Any] = {
    "schema": "nightglass/scene/1", "name": "short", "epoch": "2019-05-12T09:00:00Z", "seed": 7,
    "observer": {
        "kind": "orbit",
        "orbit": {
            "kind": "state", "position_m": [7131858.8, -812572.7, 0.0],
            "velocity_m_s": [-117.404, -1030.438, 7379.381],
        },
    },
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 9, "focal_length_m": 0.4, "aperture_m": 0.2,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 0.8}, "read_noise_e": 6,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 266.2093, "boresight_dec_deg": 0.0},
    "exposure": {"integration_s": 1.0},
    "targets": [{
        "name": "ball",
        "orbit": {
            "kind": "state", "position_m": [4407338.1, -41933021.2, 0.0],
            "velocity_m_s": [3057.8229, 321.3901, 0.0],
        },
        "body": {"kind": "sphere", "diameter_m": 4, "albedo": 0.25},
    }],
}  # fmt: skip

TRACKED = {"mode": "target", "target": "ball"}
SPIN = {"kind": "spin", "axis": [1.0, 0.0, 0.0], "rate_deg_s": 0.0}
PLATE = {"kind": "plate", "area_m2": 3.0, "albedo": 0.2, "two_sided": True}


def scene(body: dict[str, Any] | None = None, **more: Any) -> Scene:
    data = copy.deepcopy(SCENE) | more
    if body is not None:
        data["targets"][0]["body"] = body
    return parse_scene(data)


def light(made: Scene, frame: int = 0) -> np.ndarray:
    return plan_geometry(made, np.array([frame]), 0.0).frame_slice(0).target_light[0, 0]


def mean_light(made: Scene) -> float:
    return mean_over_nodes(light(made))


def mean_over_nodes(values: np.ndarray) -> float:
    return float(np.trapezoid(values, dx=1.0 / (len(values) - 1)))


@pytest.mark.parametrize("period_s", [0.125, 0.0625, 0.124, 0.25])
def test_light_that_repeats_as_often_as_the_nodes(period_s: float) -> None:
    """A period of an eighth of the exposure meets nine nodes at one phase."""
    times, magnitudes = [0.0, period_s / 2, period_s], [5.0, 9.0, 5.0]
    curve = {"kind": "light_curve", "times_s": times, "magnitudes": magnitudes}
    steady = scene(curve | {"times_s": [-99.0, 0.0, 99.0], "magnitudes": 3 * [5.0]})
    mean, _ = quad(lambda u: 10.0 ** (-1.6 * u), 0.0, 1.0)
    found = mean_light(scene(curve | {"period_s": period_s})) / mean_light(steady)
    partly = abs(1.0 / period_s - round(1.0 / period_s)) * period_s  # of a period beyond whole ones
    assert found == pytest.approx(mean, rel=2e-3 + 1.5 * partly)


def test_a_flash_between_two_nodes() -> None:
    """Twenty milliseconds in a second, a thousand times the light."""
    curve = {"kind": "light_curve", "times_s": [-10.0, 0.39, 0.4, 0.41, 10.0]}
    flash = scene(curve | {"intensities_m2_sr": [0.01, 0.01, 10.0, 0.01, 0.01]})
    steady = scene(curve | {"intensities_m2_sr": 5 * [0.01]})
    assert mean_light(flash) / mean_light(steady) == pytest.approx(1.0 + 999.0 * 0.01, rel=0.05)


def test_a_flash_far_away_and_one_in_later_rows() -> None:
    """What left its target minutes ago, and what only rows see that are exposed afterwards."""
    times = np.array([-1e4, 0.39, 0.4, 0.41, 1e4])
    curve = {"kind": "light_curve", "intensities_m2_sr": [0.01, 0.01, 10.0, 0.01, 0.01]}
    far = copy.deepcopy(SCENE)
    far |= {"observer": {"kind": "fixed", "position_au": [0.6, 0.7, 0.3]}, "pointing": TRACKED}
    away_s = float(plan_geometry(parse_scene(far), np.array([0]), 0.0).target_range_m[0, 0, 4])
    away_s /= 299_792_458.0
    assert away_s > 100.0
    far["targets"][0]["body"] = curve | {"times_s": list(np.r_[-1e4, times[1:4] - away_s, 1e4])}
    assert np.ptp(light(parse_scene(far))) > 100.0 * light(parse_scene(far)).min()

    rolling = {"detector": {"readout": {"kind": "rolling", "line_s": 1.0 / 64.0}}}
    sensor = SCENE["sensor"] | rolling
    short = {"integration_s": 0.1}
    for flash_s, seen in ((0.53, True), (0.25, False)):  # row 32 is exposed from 0.5 to 0.6 s
        body = curve | {"times_s": list(np.r_[-9.0, times[1:4] - 0.4 + flash_s - 0.13, 9.0])}
        found = light(scene(body, sensor=sensor, exposure=short))
        assert (found.max() > 10.0 * np.median(found)) == seen


@cache
def plate_over_a_turn() -> float:
    """The mean of its light over attitudes of a whole turn, looked at every half degree."""
    once = scene(PLATE | {"attitude": SPIN | {"rate_deg_s": 360.0}})
    return mean_over_nodes(_geometry(once, np.array([0]), 721, 0.0).target_light[0, 0])


def test_a_plate_that_spins_at_a_round_rate() -> None:
    """Whole turns between nodes: the mean of its light over a turn, not that of one attitude."""
    turning = scene(PLATE | {"attitude": SPIN | {"rate_deg_s": 1440.0}})
    assert mean_light(turning) == pytest.approx(plate_over_a_turn(), rel=2e-3)


@pytest.mark.parametrize("frequency_hz", [8.0, 16.0])
def test_settling_as_fast_as_the_nodes(frequency_hz: float) -> None:
    settle = {"amplitude_arcsec": PX_ARCSEC, "frequency_hz": frequency_hz, "damping": 0.0}
    dwells = [{"frames": 1}, {"frames": 1, "slew": {"duration_s": 1}, "settle": settle}]
    made = scene(dwells=dwells, pointing=TRACKED)
    g = plan_geometry(made, np.array([1]), 0.0).frame_slice(0)
    x = g.target_x_px[0, 0]
    assert np.ptp(x) == pytest.approx(2.0, abs=0.02)
    assert np.std(x - x.mean()) == pytest.approx(1.0 / np.sqrt(2.0), abs=0.02)
    assert np.ptp(plan_geometry(made, np.array([0]), 0.0).target_x_px) < 0.1


@pytest.mark.parametrize("slew_s", [1.0, 600.0])
def test_settling_begins_at_the_end_of_a_slew_however_long(slew_s: float) -> None:
    """In a second after it two thirds of the amplitude are left; half a minute later, nothing."""
    settle = {"amplitude_arcsec": PX_ARCSEC, "frequency_hz": 8.0, "damping": 0.01}
    second = {"frames": 2, "cadence_s": 30.0, "slew": {"duration_s": slew_s}, "settle": settle}
    made = scene(dwells=[{"frames": 1}, second], pointing=TRACKED)
    assert asked(made, np.array([1, 2])).tolist() == [257, 9]  # 32 a turn


def test_a_bump_in_a_table_of_attitudes() -> None:
    """Three rows of a table, in a thirtieth of the exposure, of 3 px."""
    still = scene(pointing=TRACKED)
    quiet = plan_geometry(still, np.array([0]), 0.0)
    z = quiet.attitude[0, quiet.middle, 2]
    east = np.cross([0.0, 0.0, 1.0], z) / np.hypot(*z[:2])
    north = np.cross(z, east)
    times = np.concatenate([[-1.0, 0.0], 0.53 + 0.01 * np.arange(-2, 3), [1.0, 2.0]])
    bump_px = np.where(np.abs(times - 0.53) < 5e-3, 3.0, 0.0)
    rows = []
    for t, off in zip(times, bump_px, strict=True):
        turn = off * np.radians(PX_ARCSEC / 3600.0)
        up, side = np.cos(turn) * z + np.sin(turn) * north, east
        axes = np.stack([side, np.cross(up, side), up], axis=1)  # camera to sky, right-handed
        rows.append([t, *_quaternion(axes)])
    table = {"mode": "table", "rows": rows, "scalar": "first", "frame": "gcrs"}
    g = plan_geometry(scene(pointing=table), np.array([0]), 0.0).frame_slice(0)
    path = np.stack([g.target_x_px[0, 0], g.target_y_px[0, 0]])
    apart = np.hypot(*(path - np.linspace(path[:, 0], path[:, -1], g.nodes).T))
    assert apart.max() == pytest.approx(3.0, abs=0.3)


def _quaternion(m: np.ndarray) -> list[float]:
    """Of a rotation matrix, scalar first (Shepperd 1978)."""
    trace = np.trace(m)
    four = np.array([trace, *np.diag(m)])
    k = int(np.argmax(four))
    sums = [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]
    if k == 0:
        q = np.array([1.0 + trace, *sums])
    else:
        i = k - 1
        j, n = (i + 1) % 3, (i + 2) % 3
        q = np.zeros(4)
        q[0], q[1 + i] = sums[i], 1.0 + 2.0 * m[i, i] - trace
        q[1 + j], q[1 + n] = m[i, j] + m[j, i], m[i, n] + m[n, i]
    return list((q / np.sqrt(q @ q)).tolist())


def asked(made: Scene, frames: np.ndarray, near: bool = True) -> np.ndarray:
    g = _geometry(made, frames, 9, 0.0)
    return looks(made, g, np.full((1, len(frames)), near))


def test_a_row_in_an_exposure_counts_on_both_sides() -> None:
    """What changes before it and after it; exposures between two rows see neither of them."""
    times = np.array([0.0, 10.0, 10.1, 20.0, 20.3, 40.0])
    start, end = np.array([10.05, 19.0, 1.0, 25.0]), np.array([15.0, 21.0, 9.0, 39.0])
    assert apart_s(times, None, start, end) == pytest.approx([0.1, 0.3, np.inf, np.inf])
    assert apart_s(times, 40.0, start, end) == pytest.approx(4 * [0.1])


def test_rows_and_turns_are_looked_at_where_they_are() -> None:
    frames, exposure = np.arange(60), {"integration_s": 1.0, "frames": 60, "cadence_s": 1.0}
    curve = {"kind": "light_curve", "times_s": [-99.0, 50.0, 50.01, 999.0]}
    made = scene(curve | {"magnitudes": [5.0, 5.0, 9.0, 9.0]}, exposure=exposure)
    many = asked(made, frames)
    assert (many[:49] == 9).all()
    assert many[50] == 513  # 4 looks from row to row: 401 or more
    spin = {"kind": "box", "albedo": 0.2, "size_m": [1.0, 2.0, 3.0]}
    for rate, expected in ((0.0, 9), (-20.0, 9), (360.0, 33), (3.6e4, 1025)):
        law = {"kind": "spin", "axis": [0.0, 0.0, 1.0], "rate_deg_s": rate}
        turning = scene(spin | {"attitude": law}, exposure=exposure)
        assert (asked(turning, frames[::20]) == expected).all()
        assert (asked(turning, frames[::20], near=False) == 9).all()


@pytest.mark.parametrize(("at_s", "many"), [(-0.9, 9), (0.6, 513), (0.9, 513), (1.5, 9)])
def test_rows_of_a_table_count_until_the_last_row_is_exposed(at_s: float, many: int) -> None:
    """The first row is exposed for a tenth of a second, the last almost a second later."""
    readout = {"detector": {"readout": {"kind": "rolling", "line_s": 1.0 / 64.0}}}
    curve = {"kind": "light_curve", "times_s": [-99.0, at_s, at_s + 0.01, 99.0]}
    body = curve | {"magnitudes": [5.0, 5.0, 9.0, 9.0]}
    sensor = SCENE["sensor"] | readout
    made = scene(body, sensor=sensor, exposure={"integration_s": 0.1})
    assert asked(made, np.zeros(1, int)).tolist() == [many]


def test_what_is_too_fast_to_be_looked_at_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(changes, "MOST_FINE", 2**13)  # a sixteenth: looked at 2,048 times at most
    spin = {"kind": "spin", "axis": [0.0, 0.0, 1.0]}
    box = {"kind": "box", "albedo": 0.2, "size_m": [1.0, 2.0, 3.0]}
    for rate, exposed_s, told in ((360.0, 1.0, False), (6e3, 1.0, False), (6e3, 4.0, True)):
        spinning = box | {"attitude": spin | {"rate_deg_s": rate}}
        made = scene(spinning, exposure={"integration_s": exposed_s}, accept=["error"])
        g = plan_geometry(made, np.array([0]), 0.0)
        near = np.ones((1, 1), bool)
        said = hurried_remarks(made, g, near)
        assert bool(said) == told
        assert (light_off(made, g, near) == 1.0) == told
    assert "every 0.0075 s in an exposure of 4 s (frame 0), which is looked at every" in said[0]
    many = scene(spinning, exposure={"integration_s": 4.0, "frames": 8}, accept=["error"])
    (later,) = hurried_remarks(many, replace(g, frame=np.array([7])), near)
    assert "(frame 7)" in later
    plan = plan_scene(made)
    assert plan["remarks"].count(said[0]) == 1
    rules = {d["component"]: d for d in plan["decisions"]}
    assert rules["targets.light_between_nodes"]["bound"] == 1.0


PHONG = {"kind": "phong", "diffuse": 0.0, "specular": 0.5, "exponent": 400.0}
CELLS = {"kind": "ashikhmin_shirley", "specular": 0.3, "exponent_u": 25.0, "exponent_v": 100.0}
FOIL = {"kind": "cook_torrance", "roughness": 0.02, "normal_reflectance": 0.9}
MATT = {"kind": "lambert", "albedo": 0.5}


@pytest.mark.parametrize(
    ("surface", "wide_rad"),
    [(MATT, np.inf), (PHONG, 0.025), (PHONG | {"specular": 0}, np.inf), (CELLS, 0.1), (FOIL, 0.01)],
)
def test_highlights_of_a_mesh_that_spins_are_looked_at(surface: dict, wide_rad: float) -> None:
    """Once at least while one brightens by e^(1/2), seen from the Sun; many: by means."""
    law = {"kind": "spin", "axis": [1.0, 0.0, 0.0], "rate_deg_s": -360.0}
    mesh = {"kind": "mesh", "path": "a.obj", "unit": "m", "surface": MATT, "attitude": law}
    body = MeshBody.model_validate(mesh | {"materials": {"foil": surface}})
    asked = looks_asked(body, (2458000.5, 0.0), np.zeros(1), np.ones(1), np.ones(1))
    assert asked == pytest.approx(max(32.0, 2.0 * np.pi / wide_rad))
    assert has_means(body, asked)[0] == (surface is FOIL)
    assert (10.0 * asked[0] > most_looks(body)) == (surface in (PHONG, FOIL))
    assert not has_means(body, 10.0 * asked[asked > 257]).any()  # too dear: told
    if np.isfinite(wide_rad):
        brdf = make_surface(body.materials["foil"])[0].brdf
        normal = np.array([[0.0, 0, 1], [0, np.sin(wide_rad), np.cos(wide_rad)]])
        turned = brdf(normal, normal[0], normal[0])
        assert turned[0] / turned[1] == pytest.approx(np.exp(0.5), rel=0.06)


def test_glints_of_a_mesh_that_turns_once_in_an_exposure(tmp_path: Path) -> None:
    """They take 3 ms of it, and give as much light whenever the turn begins."""
    lines = []
    for north in np.arange(-0.2, 0.4, 0.02):  # facets of a ball along one meridian
        out = np.array([np.cos(north), 0.0, np.sin(north)])
        up = np.array([-np.sin(north), 0.0, np.cos(north)])
        for corner in (-0.005 * up, np.array([0.0, 0.01, 0.0]), 0.005 * up):
            lines.append("v {:.9f} {:.9f} {:.9f}".format(*(out + corner)))
        lines.append("f -3 -2 -1")
    (tmp_path / "a.obj").write_text("\n".join(lines))
    mesh = {"kind": "mesh", "path": str(tmp_path / "a.obj"), "unit": "m", "surface": FOIL}
    found: list[float] = []
    nodes, first = 0, np.array([0])
    for phase in (0.0, 100.3, 301.7):
        law = {"kind": "spin", "axis": [0.0, 0.0, 1.0], "rate_deg_s": 360.0, "phase_deg": phase}
        made = gather_meshes(scene(mesh | {"attitude": law}, pointing=TRACKED))
        g = _geometry(made, first, nodes, 0.0) if nodes else plan_geometry(made, first, 0.0)
        nodes = g.frame_slice(0).nodes
        found.append(mean_over_nodes(g.frame_slice(0).target_light[0, 0]))
        assert light_off(made, g, np.ones((1, 1), bool)) < 1e-3
    assert np.ptp(found) < 1e-3 * found[0]


def test_flashes_between_the_most_nodes_there_are() -> None:
    """Four of a thousandth of the exposure, all between nodes; their light, and the steady one."""
    at = (np.array([30.5, 70.3, 120.7, 200.5]) / 256.0)[:, None] + [-1e-3, 0.0, 1e-3]
    times = [-10.0, *at.ravel(), 10.0]
    curve = {"kind": "light_curve", "times_s": times}
    flash = scene(curve | {"intensities_m2_sr": [0.01, *4 * [0.01, 10.0, 0.01], 0.01]})
    steady = scene(curve | {"intensities_m2_sr": 14 * [0.01]})
    whole = 1.0 + 4.0 * 999.0 * 1e-3
    assert mean_light(flash) / mean_light(steady) == pytest.approx(whole, rel=2e-3)
    found, g = light(flash), plan_geometry(flash, np.array([0]), 0.0)
    share = (found - found.min()) / (found - found.min()).sum()
    late = float(g.target_range_m[0, 0, 4]) / 299_792_458.0  # of the light on its way
    places = [at[:, 1].mean() + late, at[:, 1].mean()]
    where = share @ np.linspace(0.0, 1.0, len(found))
    assert min(abs(where - place) for place in places) < 2e-3
    told = light_off(flash, g, np.ones((1, 1), bool))
    assert 1.2e-4 <= told < 1.0


def test_of_several_flashes_the_one_that_moves_most_is_told() -> None:
    """One is tracked and stands still, one goes the other way round the Earth."""
    times = [-10.0, 0.4951, 0.4961, 0.4971, 10.0]
    curve = {"kind": "light_curve", "times_s": times, "intensities_m2_sr": [1, 1, 30, 1, 1]}
    two = [copy.deepcopy(SCENE["targets"][0]) for _ in range(2)]
    two[1]["name"] = "other"
    two[1]["orbit"]["velocity_m_s"] = [-3057.8229, -321.3901, 0.0]
    made = scene(targets=[target | {"body": curve} for target in two], pointing=TRACKED)
    g = plan_geometry(made, np.array([0]), 0.0)
    steps_px = np.hypot(np.diff(g.target_x_px), np.diff(g.target_y_px)).max(axis=(1, 2))
    assert steps_px[0] < 1e-5 < 0.02 < steps_px[1]
    near = ([True, True], [True, False], [False, True])
    both, still, moving = (light_off(made, g, np.array(which)[:, None]) for which in near)
    assert 5.0 * still < moving
    assert both == pytest.approx(moving, rel=0.01)
    (said,) = (w for w in plan_scene(made)["warnings"] if w.startswith("targets: light"))
    assert f"up to {both:.2g} of a target's light in the exposure (asked: 0.001" in said
    asked = made.accuracy.model_copy(update={"flux_fraction": 1.1 * both})
    kept = made.model_copy(update={"accuracy": asked})
    assert not light_warnings(kept, g, np.ones((2, 1), bool))


@pytest.mark.parametrize("turns", [128, 256, 277.3])
def test_a_plate_that_turns_as_often_as_there_are_nodes(turns: float) -> None:
    """All the nodes meet one attitude; the light is the mean over a turn."""
    turning = scene(PLATE | {"attitude": SPIN | {"rate_deg_s": 360.0 * turns}})
    assert mean_light(turning) == pytest.approx(plate_over_a_turn(), rel=2e-3)
    inner = light(turning)[1:-1]
    assert np.ptp(inner) < 0.05 * inner.mean()


def test_means_around_nodes_hold_the_whole_light() -> None:
    for nodes, least in ((9, 1200.0), (257, 1024.1), (130, 4000.0)):
        rng = np.random.default_rng(nodes)
        phase, turns = rng.uniform(0, 6.28, 5), rng.uniform(1, least / 160, 5)

        def bright(u: np.ndarray, phase: Any = phase, turns: Any = turns) -> np.ndarray:
            return np.square(np.sin(6.28 * turns * u[:, None] + phase)).sum(axis=-1)

        means = mean_light_around(bright, nodes, least, 2**17, 1e-5)
        true, _ = quad(lambda u, f=bright: f(np.array([u]))[0], 0.0, 1.0, limit=5000)
        assert np.trapezoid(means) / (nodes - 1) == pytest.approx(true, rel=1e-4)
        steady = mean_light_around(lambda u: 2.0 + u, nodes, least, 2**17, 1e-5)
        between = np.linspace(2.0, 3.0, nodes)[1:-1]
        np.testing.assert_allclose(steady[1:-1], between, rtol=1e-9)


def test_a_rolling_shutter_is_judged_by_both_ends_of_every_dwell() -> None:
    """A turn that grows in a dwell of seven frames is refused by its last frame."""
    shutter = {"detector": {"readout": {"kind": "rolling", "line_s": 0.01}}}
    growing = {"mode": "rate", "boresight_ra_deg": 266.2093, "boresight_dec_deg": 0.0,
               "rate_ra_arcsec_s": 0.0, "rate_dec_arcsec_s": 0.0,
               "acceleration_ra_arcsec_s2": 60.0}  # fmt: skip
    still = SCENE["pointing"]
    dwells = [{"pointing": growing, "frames": 7}, {"pointing": still, "frames": 2}]
    made = scene(sensor=SCENE["sensor"] | shutter, dwells=dwells, targets=[])
    g = plan_geometry(made, np.array([0]), 0.0)
    assert _of_every_dwell(made, g, 0.0).frame.tolist() == [0, 6, 7, 8]


def test_exposures_are_looked_at_no_less_often_than_is_asked(monkeypatch: Any) -> None:
    """8, 16, 32 ... intervals, the next that is enough; 1024 at most."""
    asked, nothing = np.array([0.0, 8.0, 8.1, 10.0, 16.0, 17.0, 700.0, 1e9]), Mock()
    monkeypatch.setattr(timescales, "asked_of_pointing", lambda *_: asked)
    monkeypatch.setattr(timescales, "asked_of_bodies", lambda *_: np.zeros((0, asked.size)))
    found = looks(nothing, nothing, np.zeros((0, asked.size), bool))
    assert found.tolist() == [9, 9, 17, 17, 17, 33, 1025, 1025]


@pytest.mark.parametrize(("span_s", "jumps"), [(2.3, True), (2.2, False), (2.3, False)])
def test_from_a_periods_last_row_to_the_first_of_the_next(span_s: float, jumps: bool) -> None:
    """As the same curve written out, row by row: at one time a jump, else a straight line."""
    period_s, magnitudes = 2.3, [2.0, 12.0 if jumps or span_s < 2.3 else 2.0]
    body = {"kind": "light_curve", "times_s": [0.0, span_s], "magnitudes": magnitudes}
    starts = period_s * np.arange(-3, 6)
    written = np.stack([starts, starts + (span_s if span_s < period_s else period_s - 1e-4)], -1)
    whole = body | {"times_s": written.ravel().tolist(), "magnitudes": 9 * magnitudes}
    for took_s in (1.0, 3.0, 8.0):
        exposed = {"exposure": {"integration_s": took_s}}
        found = mean_light(scene(body | {"period_s": period_s}, **exposed))
        assert found / mean_light(scene(whole, **exposed)) == pytest.approx(1.0, abs=3e-4)
