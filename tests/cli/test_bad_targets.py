"""Targets that cannot be used, or only with a word about them: messages, notes, exit codes."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.test_bad_input import ORBIT, SCENE
from tests.command import nightglass

trimesh = pytest.importorskip("trimesh")
BALL = {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2}
BOX = trimesh.creation.box((1, 1, 1))


def plan(folder: Path, target: dict[str, Any], **more: Any) -> Any:
    """`nightglass plan` of a scene with one target."""
    scene: dict[str, Any] = copy.deepcopy(SCENE) | more
    scene["targets"] = [{"name": "t", "orbit": ORBIT, "body": BALL} | target]
    (folder / "scene.json").write_text(json.dumps(scene).replace("Infinity", "1e999"))
    return nightglass("plan", folder / "scene.json", "--json")


def mesh(path: Path, **more: Any) -> dict[str, Any]:
    surface = {"kind": "lambert", "albedo": 0.2}
    return {"body": {"kind": "mesh", "path": str(path), "unit": "m", "surface": surface} | more}


def written(path: Path, vertices: Any, faces: Any) -> Path:
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


LINE = np.vstack([BOX.vertices, [[0, 0, 0], [0, 0, 0.1], [0, 0, 0.2]]])
NOTED: dict[str, tuple[Any, Any, str]] = {
    "a hole": (BOX.vertices, BOX.faces[:-1], "not watertight"),
    "inside out": (BOX.vertices, BOX.faces[:, ::-1], "had their normals inwards"),
    "no area": (LINE, np.vstack([BOX.faces, [[8, 9, 10]]]), "without area are omitted"),
}


@pytest.mark.parametrize("name", NOTED)
def test_meshes_that_are_told(name: str, tmp_path: Path) -> None:
    """What can be mended, or used as it is, is used and told in the plan."""
    vertices, faces, word = NOTED[name]
    result = plan(tmp_path, mesh(written(tmp_path / "m.stl", vertices, faces)))
    assert result.returncode == 0, result.stderr
    assert any(word in remark for remark in json.loads(result.stdout)["remarks"])


def nan_corner(folder: Path) -> dict[str, Any]:
    corners = BOX.vertices.copy()
    corners[0] = np.nan
    return mesh(written(folder / "m.stl", corners, BOX.faces))


def no_material(folder: Path) -> dict[str, Any]:
    (folder / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl gold\nf 1 2 3\n")
    silver = {"silver": {"kind": "lambert", "albedo": 0.1}}
    return mesh(folder / "m.obj", surface=None, materials=silver)


def content(raw: bytes) -> Callable[[Path], dict[str, Any]]:
    def make(folder: Path) -> dict[str, Any]:
        (folder / "m.stl").write_bytes(raw)
        return mesh(folder / "m.stl")

    return make


def huge(folder: Path) -> dict[str, Any]:
    with (folder / "m.stl").open("wb") as stream:
        stream.truncate(600_000_000)  # a hole: no disk is used
    return mesh(folder / "m.stl")


def orbit(**values: Any) -> Callable[[Path], dict[str, Any]]:
    return lambda _: {"orbit": values}


def decayed(_: Path) -> dict[str, Any]:
    lines = (
        "1 25544U 98067A   19110.12345678  .00001000  00000-0  99999-1 0  999",
        "2 25544  51.6400 100.0000 0002000  80.0000 280.0000 16.7000000016600",
    )
    one, two = (x + str(sum(int(c) if c.isdigit() else c == "-" for c in x) % 10) for x in lines)
    return {"orbit": {"kind": "tle", "line1": one, "line2": two}}


COUNT = np.uint32(4_000_000_000).tobytes()
REFUSED: dict[str, tuple[Callable[[Path], dict[str, Any]], str]] = {
    "missing material": (no_material, "a surface for each of these materials"),
    "zip": (content(b"PK\x03\x04" + b"0" * 100), "not an archive"),
    "600 MB": (huge, "at most 500000000 bytes"),
    "4e9 facets in its head": (content(b"\0" * 80 + COUNT + b"\0" * 100), "a whole STL file"),
    "NaN corner": (nan_corner, "finite coordinates"),
    "1e9 m": (
        lambda d: mesh(written(d / "m.stl", BOX.vertices * 1e9, BOX.faces)), "is the unit right?"
    ),
    "earthshine on a light curve": (
        lambda _: {
            "body": {"kind": "light_curve", "times_s": [-1e4, 1e4], "magnitudes": [5, 6]},
            "lighting": {"earthshine_albedo": 0.3},
        },
        "earthshine on a body of shapes or a mesh",
    ),
    "decayed": (decayed, "SGP4 code"),
    "inside the Earth": (
        orbit(kind="state", position_m=[6e6, 0, 0], velocity_m_s=[0, 7000, 0]), "above the Earth"
    ),
    "falls in": (
        orbit(kind="state", position_m=[6.4e6, 0, 0], velocity_m_s=[-90_000, 0, 0]),
        "above the Earth",
    ),
    "table too short": (
        orbit(kind="table", epoch=SCENE["epoch"], rows=[[10, 7e6, 0, 0], [20, 7e6, 1e3, 0]]),
        "times that the table covers",
    ),
    "light curve too short": (
        lambda _: {"body": {
            "kind": "light_curve", "times_s": [10, 20], "magnitudes": [5, 6], "range_m": 1e6}},
        "a table that covers the exposures",
    ),
    "NaN": (
        orbit(kind="state", position_m=[float("nan"), 0, 0], velocity_m_s=[0, 7000, 0]),
        "a finite number",
    ),
    "infinite": (lambda _: {"body": BALL | {"diameter_m": float("inf")}}, "a finite number"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_targets_that_are_refused(name: str, tmp_path: Path) -> None:
    make, word = REFUSED[name]
    result = plan(tmp_path, make(tmp_path))
    assert result.returncode == 2
    assert word in result.stderr
    assert "targets.0" in result.stderr
    assert "Traceback" not in result.stderr
    assert len(result.stderr) < 1000
