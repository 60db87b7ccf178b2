"""Light of meshes worked out beforehand: the stated error, the same frames in any window."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.physics.meshes.light_table import TURN, LightTable, tabulated
from pipeline.plan.bodies import mesh_tables, paths
from pipeline.plan.bodies.mesh_tables import decide_tables, moments_wanted, table_between
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.spec.load import parse_scene
from pipeline.spec.pointing.observer import GroundObserver
from pipeline.spec.targets.mesh import MeshBody
from tests.plan.bodies.test_bodies import SKY, TARGET
from tests.slow import slow

trimesh = pytest.importorskip("trimesh")
WORK = {
    "spin": {"kind": "spin", "rate_deg_s": 4.0, "axis": [1, 0.2, 0.1]},
    "none": {"kind": "nadir", "quaternion": [-0.5, 0.5, 0.3, 0.8]},
}


@given(width=st.floats(0.3, 3.0), slope=st.floats(0.0, 2.0), seed=st.integers(0, 99))
def test_along_time_the_error_holds(width: float, slope: float, seed: int) -> None:
    """A kink, a trend and a hump, told by a few moments."""
    kink = 10.0 * np.random.default_rng(seed).uniform()

    def light(_: np.ndarray, t: np.ndarray) -> np.ndarray:
        hump = 2.0 + np.cos(t / width)
        return np.stack([hump, slope * np.maximum(t - kink, 0.0)], axis=-1)

    table = tabulated(light, 0.0, 10.0, 1e-3, 5000, False)
    assert table is not None
    assert table.error <= 1e-3
    t = np.linspace(0.0, 10.0, 7919)
    true, ours = (v.sum(-1) for v in (light(t, t), table.at(t, 0 * t)))
    assert np.max(np.abs(ours / true - 1)) < 1e-3
    assert tabulated(light, 0.0, 10.0, 1e-3, 20, False) is None


@pytest.mark.parametrize("spins", [False, True])
def test_a_short_flash_at_times_that_are_told_is_not_missed(spins: bool) -> None:
    flash_s = np.array([604.0, 605.0, 609.0, 610.0])

    def light(_: np.ndarray, t: np.ndarray) -> np.ndarray:
        return (1.0 + np.interp(t, flash_s, [0.0, 5.0, 5.0, 0.0]))[:, None]

    blind, table = (
        tabulated(light, 0.0, 900.0, 1e-2, 5000, spins, turns) for turns in (flash_s[:0], flash_s)
    )
    assert blind is not None
    assert table is not None
    t = np.linspace(600.0, 615.0, 151)
    assert np.max(np.abs(table.at(t, 0 * t) - light(t, t))) < 1e-9
    assert np.max(np.abs(blind.at(t, 0 * t) - light(t, t))) > 1.0
    assert tabulated(light, 0.0, 900.0, 1e-2, 12 * (32 if spins else 1), spins, flash_s) is None


@pytest.mark.parametrize(("spins", "first"), [(False, 9 + 4), (True, 32 * (3 + 4))])
def test_what_is_too_much_at_first_is_not_worked_out(spins: bool, first: int) -> None:
    """Times that are told count, for each of 32 phases."""
    asked: list[int] = []

    def light(_: np.ndarray, t: np.ndarray) -> np.ndarray:
        asked.append(len(t))
        return np.ones((len(t), 1))

    turns_s = np.array([604.0, 605.0, 609.0, 610.0])
    assert tabulated(light, 0.0, 900.0, 1e-2, first - 1, spins, turns_s) is None
    assert not asked
    assert tabulated(light, 0.0, 900.0, 1e-2, first, spins, turns_s) is None
    assert asked[0] == first


def test_over_phase_and_time_the_error_holds() -> None:
    def light(p: np.ndarray, t: np.ndarray) -> np.ndarray:
        return (1.0 + 0.3 * np.cos(p - 0.1 * t) + 0.05 * np.sin(2 * p) * t / 10)[:, None]

    table = tabulated(light, 5.0, 25.0, 2e-3, 20_000, True)
    assert table is not None
    p, t = np.meshgrid(np.linspace(-20.0, 20.0, 401), np.linspace(5.0, 25.0, 37))
    true, ours = light(p.ravel(), t.ravel())[:, 0], table.at(t.ravel(), p.ravel())[:, 0]
    assert np.mean(np.abs(ours - true)) < 1.5 * table.error * true.mean()
    assert np.max(np.abs(ours - true)) < 1.5 * table.worst * true.max()
    np.testing.assert_allclose(table.at(t[0], p[0]), table.at(t[0], p[0] + TURN), rtol=1e-9)


def test_no_more_moments_are_worked_out_than_may_be() -> None:
    def light(p: np.ndarray, t: np.ndarray) -> np.ndarray:
        return (1.0 + 0.3 * np.cos(p - 0.1 * t))[:, None]

    table = tabulated(light, 0.0, 20.0, 2e-3, 20_000, True)
    assert table is not None
    grid = table.values[..., 0].size
    for most in (grid // 4, grid // 2 + 1, grid - 1):
        assert tabulated(light, 0.0, 20.0, 2e-3, most, True) is None
    assert tabulated(light, 0.0, 20.0, 2e-3, 2 * grid, True) is not None


@pytest.mark.parametrize("turns", [4096, 0])
def test_a_flicker_that_every_halving_misses_is_found_at_places_by_chance(turns: int) -> None:
    """4,096 times from start to end, dark wherever even times look."""

    def light(_: np.ndarray, t: np.ndarray) -> np.ndarray:
        return (1.0 + np.sin(np.pi * turns * t) ** 2)[:, None]

    assert (tabulated(light, 0.0, 1.0, 1e-2, 20_000, True) is None) == bool(turns)


def scene_of(folder: Path, law: dict[str, Any] | None, frames: int, **more: Any) -> Any:
    from pipeline.inputs.targets.meshes import gather_meshes

    body = trimesh.creation.box((1.0, 2.0, 1.5))
    panel = trimesh.creation.box((0.05, 1.0, 3.0))
    panel.apply_translation((0.9, 0.0, 1.0))
    path = folder / "m.stl"
    path.write_bytes(trimesh.util.concatenate([body, panel]).export(file_type="stl"))
    mesh = {"kind": "mesh", "path": str(path), "unit": "m",
            "surface": {"kind": "lambert", "albedo": 0.3}}  # fmt: skip
    target = {**TARGET, "body": mesh | ({} if law is None else {"attitude": law}), **more}
    exposure = {"integration_s": 0.5, "frames": frames, "cadence_s": 1.0}
    return gather_meshes(parse_scene({**SKY, "targets": [target], "exposure": exposure}))


@pytest.mark.parametrize("law", [slow(w) if w == "spin" else w for w in WORK])
def test_the_stated_error_holds(law: str, tmp_path: Path, monkeypatch: Any) -> None:
    """Frames from the table against the same frames worked out one by one."""
    scene = scene_of(tmp_path, WORK[law], 900 if law == "none" else 2000)
    frames = np.array([0, 7, 211, 430])
    ours = plan_geometry(scene, frames, 0.0).target_light
    (decision,) = decide_tables(scene)
    assert decision.kept
    (table,) = (t for t in mesh_tables.KEPT.values() if t is not None)
    assert table.worked <= moments_wanted(scene, scene.targets[0].body) // 3
    monkeypatch.setattr(mesh_tables, "WORTH", 10**9)
    true = plan_geometry(scene, frames, 0.0).target_light
    assert true.shape == ours.shape
    room = 0.01 if law == "spin" else 1e-3  # both follow kinks of a spinning body in steps
    assert np.max(np.abs(ours - true)) < room * true.max()
    assert np.mean(np.abs(ours - true)) < 2e-3 * true.mean()
    assert not np.array_equal(ours, true)
    assert decide_tables(scene) == []


@pytest.fixture(autouse=True)
def _fresh() -> Any:
    mesh_tables.KEPT.clear()
    yield
    mesh_tables.KEPT.clear()


def test_a_table_is_kept_for_all_that_it_follows_from(tmp_path: Path, monkeypatch: Any) -> None:
    """Each part counts: another scene of this process must not be given its light."""
    monkeypatch.setattr(mesh_tables, "tabulated", lambda *_: object())
    scene = scene_of(tmp_path, WORK["none"], 900)
    bright = scene_of(tmp_path, WORK["none"], 900, lighting={"earthshine_albedo": 0.3})
    site = GroundObserver(kind="ground", latitude_deg=10.0, longitude_deg=20.0)
    cases = {
        "first": (scene, 0.0, 900.0, 9000),
        "epoch": (scene.model_copy(update={"epoch": "2019-07-20T09:00:01Z"}), 0.0, 900.0, 9000),
        "observer": (scene.model_copy(update={"observer": site}), 0.0, 900.0, 9000),
        "target": (bright, 0.0, 900.0, 9000),
        "start": (scene, 1.0, 900.0, 9000),
        "stop": (scene, 0.0, 901.0, 9000),
        "wanted": (scene, 0.0, 900.0, 9001),
    }
    at: Any = SimpleNamespace(elsewhere=len)

    def tables() -> dict[str, object]:
        return {k: table_between(one, 0, at, *rest) for k, (one, *rest) in cases.items()}

    found = tables()
    assert len(set(map(id, found.values()))) == len(cases)
    assert tables() == found


def test_the_oldest_table_makes_room_and_the_plan_does_not_say_that_there_is_none(
    tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr(mesh_tables, "MOST_KEPT", 1)
    monkeypatch.setattr(mesh_tables, "WORTH", 0)
    scene, first = scene_of(tmp_path, None, 3), np.arange(3)
    light = plan_geometry(scene, first, 0.0).target_light
    [told] = decide_tables(scene)
    assert "each frame works out its own light" in told.reason
    plan_geometry(scene_of(tmp_path, None, 4), first, 0.0)
    assert len(mesh_tables.KEPT) == 1
    [told] = decide_tables(scene)
    assert "not kept beside 1 others" in told.reason
    assert (told.kept, told.bound) == (True, 2.0 * scene.targets[0].body.error)
    np.testing.assert_array_equal(plan_geometry(scene, first, 0.0).target_light, light)


@pytest.mark.parametrize(("offset_s", "served"), [(-0.1, 0), (0.0, 1), (899.5, 1), (899.6, 0)])
def test_moments_outside_of_the_exposures_have_no_table(
    offset_s: float, served: int, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr(mesh_tables, "tabulated", lambda *_: "a table")
    monkeypatch.setattr(mesh_tables, "_turns_s", lambda *_: ())
    scene = scene_of(tmp_path, WORK["none"], 900)
    at: Any = SimpleNamespace(offset_s=np.array([5.0, offset_s]), elsewhere=len)
    assert (mesh_tables.table_of(scene, 0, at) is not None) == bool(served)


def test_few_frames_need_none(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, WORK["spin"], 10)
    plan_geometry(scene, np.arange(10), 0.0)
    assert not mesh_tables.KEPT
    assert decide_tables(scene) == []


@pytest.mark.parametrize("frames", [8, slow(900)])
def test_same_frame_in_any_window(frames: int, tmp_path: Path) -> None:
    """With and without a table, also in earthshine and where the body turns slowly."""
    turning = {"kind": "spin", "rate_deg_s": 0.1, "axis": [1, 0.2, 0.1]}
    law = turning if frames == 8 else WORK["none"]
    scene = scene_of(tmp_path, law, frames, lighting={"earthshine_albedo": 0.3})
    every = plan_geometry(scene, np.arange(8), 0.0).target_light
    assert bool(mesh_tables.KEPT) is (frames > 8)
    assert every.max() > 0.0
    for some in ([3], [2, 3, 5], [7, 1]):
        found = plan_geometry(scene, np.array(some), 0.0).target_light
        np.testing.assert_array_equal(found, every[:, some])


def test_the_light_of_the_earth_is_in_a_table_too(tmp_path: Path, monkeypatch: Any) -> None:
    """Of three times, between which it hardly changes: frames as they are without a table."""

    def of_three(light: Any, start_s: float, stop_s: float, *_: Any) -> LightTable:
        times = np.linspace(start_s, stop_s, 3)
        return LightTable(times, light(0.0 * times, times)[None], 0.0, 3)

    monkeypatch.setattr(mesh_tables, "tabulated", of_three)
    found = []
    for more in ({}, {"lighting": {"earthshine_albedo": 0.3}}):
        scene = scene_of(tmp_path, WORK["none"], 2, **more)
        for worth in (0, 10**9):
            monkeypatch.setattr(mesh_tables, "WORTH", worth)
            found.append(plan_geometry(scene, np.arange(2), 0.0).target_light)
    plain, plain_true, ours, true = found
    assert len(mesh_tables.KEPT) == 2
    assert (true - plain_true).min() > 5e-4 * true.max()
    np.testing.assert_allclose(ours - plain, true - plain_true, rtol=0.02)


def test_a_short_turn_of_a_tabulated_attitude_is_seen(tmp_path: Path, monkeypatch: Any) -> None:
    """Six of 900 seconds, between all times that a table of light looks at by itself."""
    still, turned = [-0.5, 0.5, 0.3, 0.8], [-0.6, 0.4, 0.3, 0.8]
    times_s = np.array([-100, *range(0, 600, 10), 604, 605, 609, 610, 1100])
    rows = [turned if 604 < t < 610 else still for t in times_s]
    law = {"kind": "table", "times_s": (40.0 + times_s).tolist(), "quaternions": rows,
           "epoch": "2019-07-20T08:59:20Z"}  # fmt: skip
    scene = scene_of(tmp_path, law, 900)
    frames = np.arange(600, 615, 3)
    ours = plan_geometry(scene, frames, 0.0).target_light
    (table,) = mesh_tables.KEPT.values()
    assert table is not None
    assert len(table.times_s) < 400
    assert np.min(np.abs(table.times_s - 605.0)) < 0.1
    monkeypatch.setattr(mesh_tables, "WORTH", 10**9)
    true = plan_geometry(scene, frames, 0.0).target_light
    assert true.min() < 0.5 * true.max()
    np.testing.assert_allclose(ours, true, atol=2e-3 * true.max())


def test_several_spins_are_not_put_into_a_table(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, WORK["spin"], 2000)
    body = scene.targets[0].body
    assert mesh_tables.spin_rad_s(body) == pytest.approx(np.radians(4.0))
    assert moments_wanted(scene, body) == 2000 * 5


def test_errors_of_a_flash_are_told_of_its_peak_and_of_the_mean() -> None:
    """A flash 20 times the rest: the largest difference over the brightest light, not the mean."""

    def light(p: np.ndarray, t: np.ndarray) -> np.ndarray:
        off = np.mod(p - 1.0 + np.pi, TURN) - np.pi
        return (1.0 + 20.0 * np.exp(-((off / 0.5) ** 2)) + 0.0 * t)[:, None]

    table = tabulated(light, 0.0, 10.0, 1e-3, 50_000, True)
    assert table is not None
    p = np.linspace(0.0, TURN, 20_001)
    true, ours = light(p, 0 * p)[:, 0], table.at(0 * p, p)[:, 0]
    off = np.abs(ours - true)
    assert 0.2 < table.worst / (off.max() / true.max()) <= 1.01
    assert 0.5 < table.error / (off.mean() / true.mean()) < 2.0


def test_a_spin_either_way_needs_as_many_moments(tmp_path: Path) -> None:
    """20 degrees in an exposure: 2 and one for each 0.01 rad, whichever way it turns."""
    for rate in (40.0, -40.0):
        scene = scene_of(tmp_path, {"kind": "spin", "rate_deg_s": rate, "axis": [1, 0, 0]}, 10)
        assert moments_wanted(scene, scene.targets[0].body) == 10 * (2 + 34)


def test_a_table_is_its_own_target_s_in_a_later_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of targets 2 to 4 only number 3 has one: it is the second of them."""

    def light_of(_: Any, i: int, __: Any) -> Any:
        return (lambda at, view: (i, at, view)) if i == 3 else None

    monkeypatch.setattr(paths, "_tabled_light", light_of)
    at, view = SimpleNamespace(offset_s=7.0), SimpleNamespace(of=lambda k: k.tolist())
    assert paths._tabled(None, range(2, 5), at, view) == {1: (3, 7.0, [1])}  # type: ignore


def test_no_table_where_a_joint_spins_on_a_body_that_follows_a_table() -> None:
    """A phase of the joint does not tell how such a body stands."""
    law = {"kind": "table", "times_s": [0, 7200], "quaternions": [[1, 0, 0, 0], [0.9, 0.1, 0, 0]]}
    joint = SimpleNamespace(law="spin", rate_rad_s=0.1)
    for rate, attitude, spin in ((0.1, law, None), (0.0, law, 0.0), (0.1, WORK["none"], 0.1)):
        joint.rate_rad_s = rate
        mesh = {"kind": "mesh", "path": "a.obj", "unit": "m", "attitude": attitude,
                "surface": {"kind": "lambert", "albedo": 0.3}}  # fmt: skip
        body = MeshBody.model_validate(mesh)
        body._model = SimpleNamespace(parts=[SimpleNamespace(joint=joint)])
        assert mesh_tables.spin_rad_s(body) == spin


def test_tables_are_kept_by_many_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """More than are held, so that one drops what another has just looked for."""
    monkeypatch.setattr(mesh_tables, "_key", lambda _, index, *__: str(index))
    monkeypatch.setattr(mesh_tables, "spin_rad_s", lambda _: None)
    monkeypatch.setattr(mesh_tables, "MeshBody", type(None))
    monkeypatch.setattr(mesh_tables, "KEPT", {})
    scene: Any = SimpleNamespace(targets=[SimpleNamespace(body=None)] * 10_000)
    at: Any = SimpleNamespace(elsewhere=1)

    def look(first: int) -> int:
        for i in range(20_000):
            table_between(scene, (first + 7 * i) % 10_000, at, 0.0, 1.0, 10**9)
        return first

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            assert list(pool.map(look, range(4))) == [0, 1, 2, 3]
    finally:
        sys.setswitchinterval(before)
    assert len(mesh_tables.KEPT) == mesh_tables.MOST_KEPT
