"""Meshes larger than a point: their picture is drawn, like a sphere's where they are one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.execute.mesh_bodies import Pose, picture_of, spread_of
from pipeline.execute.sources import place_targets
from pipeline.inputs.targets.meshes import gather_mesh
from pipeline.physics.drawing.pictures import cell_error
from pipeline.physics.psf.pupil import Blur, Gaussian
from pipeline.physics.targets.disc import Picture
from pipeline.plan.accuracy import total_sigma
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.route.prepare import plan_scene, prepare
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.spec.targets.mesh import MeshBody
from pipeline.store.cube import open_cube
from pipeline.sweep.metrics import target_windows
from tests.execute.test_extended import scene

trimesh = pytest.importorskip("trimesh")
PSF = {"kind": "gaussian", "sigma_px": 0.8}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sphere of radius 0.5 of 5,120 facets, and a flag: a triangle in the plane x = 0."""
    folder = tmp_path_factory.mktemp("meshes")
    trimesh.creation.icosphere(subdivisions=4, radius=0.5).export(folder / "ball.stl")
    corners = np.array([[0.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    trimesh.Trimesh(corners, [[0, 1, 2]]).export(folder / "flag.stl")
    return folder


def mesh(path: Path, scale: str = "m", **more: Any) -> dict[str, Any]:
    surface = {"kind": "lambert", "albedo": 0.2, "two_sided": True}
    return {"kind": "mesh", "path": str(path), "unit": scale, "surface": surface} | more


def large(body: dict[str, Any]) -> dict[str, Any]:
    """A scene of a body of which 0.04 m are a pixel."""
    data = scene(400.0, PSF).as_dict()
    data["sensor"]["shape"] = [64, 64]
    data["sensor"] |= {"pixel_pitch_um": 4.0, "focal_length_m": 100.0, "aperture_m": 2.0}
    data["targets"][0]["orbit"]["position_m"] = [42_164e3, 1e6, 0.0]  # 0.04 m a pixel
    data["targets"][0]["body"] = body
    data["accuracy"]["check_cells"] = 1
    return data


def drawn(tmp_path: Path, body: dict[str, Any], **more: Any) -> tuple[np.ndarray, dict[str, Any]]:
    data = large(body) | more
    render(parse_scene(data), tmp_path, Options("synchronous"))
    truth = pq.read_table(tmp_path / "truth" / "targets.parquet").to_pylist()[0]
    return open_cube(tmp_path)["targets_e"].values[0].astype(float), truth


def test_a_mesh_of_a_sphere_is_drawn_as_the_sphere(files: Path, tmp_path: Path) -> None:
    ball = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}
    wanted, told = drawn(tmp_path / "a", ball)
    found, truth = drawn(tmp_path / "b", mesh(files / "ball.stl"))
    assert told["extended"]
    assert truth["extended"]
    assert truth["radius_px"] == pytest.approx(told["radius_px"], rel=1e-3)
    assert truth["radius_px"] == pytest.approx(12.5, rel=1e-3)
    assert found.sum() == pytest.approx(truth["electrons"], rel=2e-3)
    assert found.sum() == pytest.approx(wanted.sum(), rel=2e-3)
    assert np.abs(found - wanted).max() < 0.01 * wanted.max()


def test_a_picture_is_as_fine_as_the_light_of_its_body_asks(files: Path) -> None:
    """A pixel errs by no more electrons than the plan allows, where 512 cells across do for it."""
    turned = {"kind": "inertial", "quaternion": [0.9, 0.1, 0.05, -0.4]}
    for body in (mesh(files / "flag.stl", attitude=turned), mesh(files / "ball.stl")):
        data = large(body)
        data["sensor"]["aperture_m"] = 0.1  # some 2,000 electrons
        plan = prepare(parse_scene(data)).plan
        g = plan_geometry(plan.scene, np.zeros(1, np.int64), plan.dut1_s)
        (target,) = place_targets(plan, g)
        assert isinstance(target.body, Picture)
        errs_e = cell_error(plan.responses.blur, target.body) * target.light_e
        assert errs_e <= plan.responses.budget_e < 0.2


def test_the_picture_is_not_mirrored(files: Path, tmp_path: Path) -> None:
    """A triangle stands where its corners are projected."""
    found, truth = drawn(tmp_path / "a", mesh(files / "flag.stl", attitude={
        "kind": "inertial", "quaternion": [0.9, 0.1, 0.05, -0.4]}))  # fmt: skip
    assert truth["extended"]
    from scipy.spatial.transform import Rotation

    corners = np.array([[0.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    turned = Rotation.from_quat([0.1, 0.05, -0.4, 0.9]).apply(corners)
    # the observer looks along +y of the sky: +y of the picture is north (z), +x is west (x)
    middle = turned.mean(axis=0) / 0.04
    rows, columns = np.indices(found.shape)
    y, x = ((found * grid).sum() / found.sum() for grid in (rows, columns))
    assert y - truth["y_px"] == pytest.approx(middle[2], abs=0.1)
    assert abs(x - truth["x_px"]) == pytest.approx(abs(middle[0]), abs=0.1)
    assert np.sign(x - truth["x_px"]) == np.sign(middle[0])


def test_same_bits_and_small_ones_are_points(files: Path, tmp_path: Path) -> None:
    small, truth = drawn(tmp_path / "a", mesh(files / "ball.stl", "mm"))
    assert not truth["extended"]
    assert small.sum() == pytest.approx(truth["electrons"], rel=1e-4)


def test_what_only_the_earth_lights_is_a_point_and_the_plan_says_so(
    files: Path, tmp_path: Path
) -> None:
    """A flag of 25 px that turns its front to the Earth and the observer, its back to the Sun."""
    flag = mesh(files / "flag.stl", surface={"kind": "lambert", "albedo": 0.2}, attitude={
        "kind": "inertial", "quaternion": [-0.38268343, 0.0, 0.0, 0.92387953]})  # fmt: skip
    data = large(flag)
    data["targets"][0]["lighting"] = {"earthshine_albedo": 0.3}
    render(parse_scene(data), tmp_path / "run", Options("synchronous"))
    [truth] = pq.read_table(tmp_path / "run" / "truth" / "targets.parquet").to_pylist()
    found = open_cube(tmp_path / "run")["targets_e"].values[0].astype(float)
    assert truth["radius_px"] > 20.0
    assert truth["electrons"] > 10.0
    assert found.sum() == pytest.approx(truth["electrons"], rel=2e-3)
    rows, columns = np.nonzero(found > 0.01 * found.max())
    assert np.hypot(rows - truth["y_px"], columns - truth["x_px"]).max() < 3.0
    reasons = {d["component"]: d["reason"] for d in plan_scene(parse_scene(data))["decisions"]}
    assert "where there is none, as a point" in reasons["targets.earthshine_on_meshes"]


def test_plan_says_how_meshes_are_drawn(files: Path) -> None:
    data = scene(400.0, PSF).as_dict()
    data["targets"][0]["body"] = mesh(files / "flag.stl", attitude={
        "kind": "spin", "rate_deg_s": 30.0})  # fmt: skip
    plan = plan_scene(parse_scene(data))
    reasons = {d["component"]: d["reason"] for d in plan["decisions"]}
    assert "edge moves by up to 0.0005" in reasons["targets.resolved_meshes"]


def test_the_cells_of_a_picture_are_halved_until_they_serve(files: Path) -> None:
    """The first that a pixel errs by no more with than is asked; 512 across the body at most."""
    body = MeshBody.model_validate(mesh(files / "flag.stl"))  # a metre from the body's origin
    model = gather_mesh(body)
    directions = np.array([[1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    pose = Pose(model.digest, directions.tobytes(), 0.0, 1e-3, model)
    blur, px_per_m = Blur(Gaussian(0.8)), 10.0
    coarse = picture_of(pose, px_per_m, blur, 1.0)
    assert coarse.side_px == 0.25
    error = cell_error(blur, coarse)
    assert picture_of(pose, px_per_m, blur, error).side_px == 0.25
    for share in (0.99, 0.2):
        finer = picture_of(pose, px_per_m, blur, share * error)
        assert cell_error(blur, finer) <= share * error < cell_error(blur, coarse)
        assert np.log2(0.25 / finer.side_px) in (1, 2)
    finest = picture_of(pose, px_per_m, blur, 0.0)
    assert 256 < 2.0 * px_per_m / finest.side_px <= 512
    assert picture_of(pose, 1.0, blur, 1.0).side_px == pytest.approx(1.0 / 16, rel=1e-6)


def test_a_sphere_a_mesh_and_another_share_the_accuracy_and_have_their_own_windows(
    tmp_path: Path,
) -> None:
    """Within what is asked, by default (each kind has a part of its own), and with the pose of each
    mesh where a sweep looks for it: it was that of another, or a fault beside a sphere."""
    trimesh.creation.box((1.5, 0.3, 0.2)).export(tmp_path / "box.stl")
    ball = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}
    still = {"attitude": {"kind": "inertial", "quaternion": [0.0, 0.5, 0.0, 0.866]}}
    turned = {"attitude": {"kind": "inertial", "quaternion": [0.0, 0.0, 0.7071, 0.7071]}}
    data = large(mesh(tmp_path / "box.stl"))
    one = data["targets"][0]
    data["sensor"]["shape"] = [256, 256]
    data["accuracy"] = {}
    boxes = [mesh(tmp_path / "box.stl", **way) for way in (still, turned)]
    bodies = {"b": ball, "f": boxes[0], "t": boxes[1]}

    def windows(names: str) -> dict[str, np.ndarray]:
        targets = []
        for k, name in enumerate(names):
            place = [one["orbit"]["position_m"][0], 1e6, 2.0 * k]
            orbit = one["orbit"] | {"position_m": place}
            targets.append(one | {"name": name, "body": bodies[name], "orbit": orbit})
        aim = data["pointing"] | {"target": names[0]}
        plan = prepare(parse_scene(data | {"targets": targets, "pointing": aim})).plan
        assert total_sigma(plan.decisions) <= plan.scene.accuracy.noise_fraction * (1.0 + 1e-9)
        g = plan_geometry(plan.scene, np.zeros(1, int), 0.0)
        return {n: w.response for n, w in target_windows(plan, g, tuple(names), 3.0)}

    together = windows("bft")
    assert set(together) == set("bft")

    def widths(response: np.ndarray) -> list[float]:
        share = response / response.sum()
        return [float(np.sqrt(np.sum(share * (k - np.sum(share * k)) ** 2)))
                for k in np.indices(share.shape)]  # fmt: skip

    for name in "ft":
        assert widths(together[name]) == pytest.approx(widths(windows(name)[name]), rel=0.02)
    assert widths(together["f"]) != pytest.approx(widths(together["t"]), rel=0.2)


def test_the_light_of_a_facet_that_is_lit_at_its_tip_is_no_farther_than_is_told(
    tmp_path: Path,
) -> None:
    """A shelf shades nine tenths of a long triangle from a Sun below it; the observer sees the
    shelf from its edge, and the tip, 0.6 m from the triangle's middle, shine alone."""
    corners = [[0.0, -0.05, 0.0], [0.0, 0.05, 0.0], [0.0, 0.0, 1.0]]
    shelf = [[0.0, -1, -0.01], [0.0, 1, -0.01], [0.9, 1, -0.01], [0.9, -1, -0.01]]
    faces = [[0, 1, 2], [3, 4, 5], [3, 5, 6]]
    trimesh.Trimesh(corners + shelf, faces, process=False).export(tmp_path / "shelf.stl")
    model = gather_mesh(MeshBody.model_validate(mesh(tmp_path / "shelf.stl")))
    half = np.sqrt(0.5)
    directions = np.array([[half, 0.0, -half], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    found = spread_of(Pose(model.digest, directions.tobytes(), 0.0, 1e-4, model))
    lit_m = 0.89 + 0.11 / 3.0  # the middle of what stands above the shadow
    assert found.y_m == pytest.approx(1.0 / 3.0, abs=1e-3)
    assert 0.59 < lit_m - found.y_m <= found.off_m < 1.0
