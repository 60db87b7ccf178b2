"""Mesh files: real ones load, bad ones are refused by name, what is mended is told."""

from __future__ import annotations

import hashlib
import json
import re
import struct
import zipfile

import numpy as np
import pytest
from pydantic import TypeAdapter

from pipeline.errors import BadInput
from pipeline.inputs.targets.mesh_surfaces import make_surface, read_brdf_table
from pipeline.physics.meshes.intensity import mesh_intensity, sun_points
from pipeline.physics.meshes.model import model_light, posed
from pipeline.physics.targets.sphere import sphere_area_function
from pipeline.physics.vectors import separation, unit
from pipeline.plan.pointing.geometry import plan_geometry
from pipeline.spec.load import parse_scene
from pipeline.spec.targets.mesh import MeshBody, Reflecting
from tests.plan.bodies.test_bodies import SKY, TARGET

trimesh = pytest.importorskip("trimesh")
from pipeline.inputs.targets import meshes  # noqa: E402
from pipeline.inputs.targets.meshes import gather_mesh, gather_meshes, read_mesh  # noqa: E402

MATT = {"kind": "lambert", "albedo": 0.5}

CUBE = """mtllib none.mtl
o Bus
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
usemtl gold
f 4 3 2 1
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
usemtl black
f 3 4 8 7
f 4 1 5 8
"""
SHEET = """o Panel
v 2 0 0
v 3 0 0
v 3 1 0
v 2 1 0
usemtl cell
f 9 10 11 12
"""


def write(folder, text, name="body.obj"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def body(path, **more):
    return MeshBody.model_validate(
        {"kind": "mesh", "path": str(path), "unit": "m", "surface": MATT} | more
    )


def test_all_real_models_load(shared_data):
    paths = sorted((shared_data / "cad_models").glob("*.obj"))
    assert len(paths) >= 20
    for path in paths:
        mesh = read_mesh(path, "m")
        assert len(mesh.corners_m) >= 12
        assert all(mesh.materials), path.name  # every facet's material by its name
        assert np.ptp(mesh.corners_m.reshape(-1, 3), axis=0).max() < 200.0


def test_real_sizes_and_objects(shared_data):
    hst = read_mesh(shared_data / "cad_models" / "HST.obj", "m")
    assert np.ptp(hst.corners_m.reshape(-1, 3), axis=0).max() == pytest.approx(13.3, abs=0.1)
    assert hst.closed.all()
    iss = read_mesh(shared_data / "cad_models" / "ISS_MainBody.obj", "m")
    assert {"ISS_ServiceModule", "ISS_UDC"} <= set(iss.things)
    assert any("not watertight: 32" in note for note in iss.notices)


def test_a_real_sphere_gives_the_closed_form(shared_data):
    model = gather_mesh(body(shared_data / "cad_models" / "Cannonball.obj"))
    facets = posed(model, (0, 0, 1))
    assert facets.convex
    diameter = 2.0 * facets.radius_m
    rng = np.random.default_rng(3)
    for _ in range(10):
        s, o = unit(rng.normal(size=3)), unit(rng.normal(size=3))
        true = 0.5 / np.pi * sphere_area_function(separation(s, o), diameter)
        found = mesh_intensity(facets, model.surfaces, s, o).intensity_m2_sr
        assert found == pytest.approx(true, abs=0.02 * diameter**2 / 6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["HST", "ISS_MainBody"])
def test_against_ray_casting_by_embree(shared_data, name):
    """An independent count of rays: first hits from the observer, then rays to the Sun."""
    pytest.importorskip("embreex")
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    model = gather_mesh(body(shared_data / "cad_models" / f"{name}.obj"))
    facets = posed(model, (0, 0, 1))
    corners = facets.corners_m
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3),
                           process=False)  # fmt: skip
    caster = RayMeshIntersector(mesh)
    s, o = unit(np.array([0.5, 0.6, 0.4])), unit(np.array([-0.2, 0.8, 0.6]))
    x = unit(np.cross(o, [0.0, 0.0, 1.0]))
    y = np.cross(o, x)
    points = corners.reshape(-1, 3)
    n = 500
    u, v = (np.linspace((points @ a).min(), (points @ a).max(), n + 1) for a in (x, y))
    cell = (u[1] - u[0]) * (v[1] - v[0])
    um, vm = np.meshgrid(0.5 * (u[1:] + u[:-1]), 0.5 * (v[1:] + v[:-1]))
    start = um.reshape(-1, 1) * x + vm.reshape(-1, 1) * y + 2 * facets.radius_m * o
    hits, _, hit = caster.intersects_location(start, np.tile(-o, (len(start), 1)), False)
    mu = facets.normal[hit] @ s
    mu = np.where(facets.normal[hit] @ o > 0, mu, 0.0)
    lit = mu > 0.0
    room = 1e-4 * facets.radius_m * facets.normal[hit][lit]
    dark = caster.intersects_any(hits[lit] + room, np.tile(s, (lit.sum(), 1)))
    true = 0.5 / np.pi * cell * np.sum(mu[lit] * ~dark)
    light = mesh_intensity(facets, model.surfaces, s, o)
    assert light.intensity_m2_sr == pytest.approx(true, rel=5e-3)


def test_objects_and_materials_of_an_obj(tmp_path):
    mesh = read_mesh(write(tmp_path, CUBE + SHEET), "cm")
    assert mesh.materials == ("black", "cell", "gold")
    assert mesh.things == ("Bus", "Panel")
    assert mesh.corners_m.max() == pytest.approx(0.03)
    assert mesh.closed.sum() == 12
    assert len(mesh.notices) == 1
    assert "2 of 14 facets" in mesh.notices[0]
    assert "two_sided" in mesh.notices[0]


def test_objects_of_the_bodys_file_may_move(tmp_path):
    path = write(tmp_path, CUBE + SHEET)
    half = {"kind": "fixed", "axis": [0, 1, 0], "pivot_m": [2.5, 0, 0], "angle_deg": 180}
    model = gather_mesh(body(path, parts=[{"name": "p", "objects": ["Panel"], "joint": half}]))
    assert [len(p.facets) for p in model.parts] == [12, 2]
    z = np.array([[0.0, 0.0, 1.0]])
    light, _ = model_light(model, z, z, np.zeros(1))
    assert light[0] == pytest.approx(0.5 / np.pi)  # the panel shows its black back
    with pytest.raises(BadInput, match="Dish"):
        gather_mesh(body(path, parts=[{"name": "p", "objects": ["Dish"]}]))


def test_a_sheet_on_a_closed_body_is_hidden_by_it(tmp_path):
    """A label on one face, bright on both sides: from behind the body only the body is seen."""
    path = write(tmp_path, CUBE + SHEET.replace("2 0 0", ".2 .2 1").replace("3 0 0", ".8 .2 1")
                 .replace("3 1 0", ".8 .8 1").replace("2 1 0", ".2 .8 1"))  # fmt: skip
    label = {"kind": "lambert", "albedo": 0.9, "two_sided": True}
    model = gather_mesh(body(path, materials={"cell": label}))
    below = np.array([[0.0, 0.0, -1.0]])
    light, _ = model_light(model, below, below, np.zeros(1))
    assert light[0] == pytest.approx(0.5 / np.pi)


@pytest.mark.parametrize("rate_deg_s", [6.0, -6.0])
def test_a_part_that_turns_either_way_turns_the_body(tmp_path, rate_deg_s):
    """12 degrees in two seconds, which a picture of the middle does not show."""
    joint = {"kind": "spin", "axis": [0, 0, 1], "pivot_m": [2, 0, 0], "rate_deg_s": rate_deg_s}
    part = {"name": "panel", "objects": ["Panel"], "joint": joint}
    wish = body(write(tmp_path, CUBE + SHEET), parts=[part]).model_dump(mode="json")
    scene = gather_meshes(parse_scene({**SKY, "targets": [{**TARGET, "body": wish}]}))
    turn = plan_geometry(scene, np.arange(1), 0.0).target_turn_rad
    assert turn == pytest.approx(np.radians(12.0), rel=0.02)


def test_surfaces_go_by_the_materials_names(tmp_path):
    path = write(tmp_path, CUBE)
    white = {"kind": "lambert", "albedo": 1.0}
    x, z = np.array([[1.0, 0.0, 0.0]]), np.array([[-1.0, 0.0, 0.0]])
    model = gather_mesh(body(path, materials={"gold": white}))
    assert len(model.surfaces) == 2
    for d, albedo in ((x, 1.0), (z, 0.5)):
        assert model_light(model, d, d, [0.0])[0][0] == pytest.approx(albedo / np.pi)
    with pytest.raises(BadInput, match="black"):
        gather_mesh(body(path, surface=None, materials={"gold": white}))
    with pytest.raises(BadInput, match="silver"):
        gather_mesh(body(path, materials={"silver": white}))
    other = gather_mesh(body(path, materials={"gold": MATT}))
    assert other.digest != model.digest


def test_a_material_that_no_file_of_its_owner_has_is_refused(tmp_path):
    """Of a part, of a body all of whose objects are parts; a body's may be in a part's file."""
    path, wing = write(tmp_path, CUBE + SHEET), write(tmp_path, SHEET.replace("cell", "foil")
        .replace("f 9 10 11 12", "f 1 2 3 4"), "wing.obj")  # fmt: skip
    panel, all_of_it = ({"name": "p", "objects": o} for o in (["Panel"], ["Bus", "Panel"]))
    for part, own, field in (
        (panel | {"materials": {"cels": MATT}}, {}, "body.parts.0.materials"),
        (all_of_it, {"cels": MATT}, "body.materials"),
    ):
        with pytest.raises(BadInput, match="black, cell, gold") as caught:
            gather_mesh(body(path, parts=[part], materials=own))
        assert (caught.value.field, caught.value.value) == (field, "cels")
    gather_mesh(body(path, parts=[{"name": "p", "path": str(wing)}], materials={"foil": MATT}))


@pytest.mark.parametrize("count", [7, 8, 9, 11])
def test_a_refusal_lists_eight_names_and_how_many_more_there_are(tmp_path, count):
    head = CUBE[: CUBE.index("usemtl")]
    path = write(tmp_path, head + "".join(f"usemtl m{k:02d}\nf 4 3 2 1\n" for k in range(count)))
    with pytest.raises(BadInput) as caught:
        gather_mesh(body(path, materials={"silver": MATT}))
    listed = ", ".join(f"m{k:02d}" for k in range(min(count, 8)))
    more = f" and {count - 8} more" if count > 8 else ""
    assert caught.value.allowed == f"a material of the file: {listed}{more}"


def test_a_digest_tells_all_that_shapes_the_light_but_no_folder(tmp_path):
    """A product goes on, and a table of light is taken, where the digest is the same."""

    def digest(folder, text=CUBE, brdf=0.1, name="body.obj", wing="", place=(3, 0, 0), **more):
        scale = more.pop("scale", 1.0)
        (tmp_path / folder).mkdir(exist_ok=True)
        surface = {"kind": "table", "path": str(tmp_path / folder / "brdf.npy"), "scale": scale}
        np.save(tmp_path / folder / "brdf.npy", _rows(brdf))
        wing = write(tmp_path / folder, CUBE + wing, "wing.obj")
        parts = [{"name": "wing", "path": str(wing), "place_m": place}]
        path = write(tmp_path / folder, text, name)
        half = {"black": surface | {"scale": 0.5}}
        wish = {"surface": surface, "materials": half, "parts": parts} | more
        return gather_mesh(body(path, **wish)).digest

    found = [
        digest("a"),
        digest("a", text=CUBE + SHEET),
        digest("a", brdf=0.2),
        digest("a", scale=1.5),
        digest("a", wing=SHEET),
        digest("a", name="other.obj"),
        digest("a", unit="mm"),
        digest("a", place=(4, 0, 0)),
        digest("a", materials={"gold": MATT}),
        digest("a", attitude={"kind": "spin", "rate_deg_s": 1.0, "axis": [0, 0, 1]}),
    ]
    assert len(set(found)) == len(found)
    assert digest("b") == digest("a") == found[0]


def test_a_body_is_read_again_from_its_own_files_alone(tmp_path):
    """As in the scene that a product keeps: with the digest and error that reading has added."""
    np.save(tmp_path / "brdf.npy", _rows())
    surface = {"kind": "table", "path": str(tmp_path / "brdf.npy")}
    wish = body(write(tmp_path, CUBE), materials={"gold": surface}).model_dump(mode="json")
    scene = gather_meshes(parse_scene({**SKY, "targets": [{**TARGET, "body": wish}]}))
    kept = scene.targets[0].body
    assert None not in (kept.digest, kept.error)
    again = parse_scene(scene.as_dict())
    assert gather_meshes(again).targets[0].body.model_dump() == kept.model_dump()
    np.save(tmp_path / "brdf.npy", _rows(0.2))
    with pytest.raises(BadInput, match=r"targets\.0\.body\.digest.*of these files"):
        gather_meshes(again)


@pytest.mark.parametrize("kind", ["stl", "ply", "glb"])
def test_other_formats_hold_the_same_cube(tmp_path, kind):
    path = tmp_path / f"cube.{kind}"
    trimesh.creation.box(extents=(1, 2, 3)).export(path)
    mesh = read_mesh(path, "m")
    assert len(mesh.corners_m) == 12
    assert mesh.closed.all()
    size = np.ptp(mesh.corners_m.reshape(-1, 3), axis=0)
    np.testing.assert_allclose(size, [1, 2, 3], rtol=1e-6)
    assert mesh.digest == hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_mirrored_part_keeps_its_front(tmp_path):
    """A sheet that faces +z, mirrored by its node from left to right, still faces +z."""
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    for sign in (1.0, -1.0):
        scene = trimesh.Scene()
        scene.add_geometry(sheet, transform=np.diag([sign, 1.0, 1.0, 1.0]))
        path = write(tmp_path, scene.export(file_type="glb"), f"sheet{sign:g}.glb")
        ((a, b, c),) = read_mesh(path, "m").corners_m
        np.testing.assert_allclose(np.cross(b - a, c - a), [0.0, 0.0, 1.0], atol=1e-12)
        assert max(a[0], b[0], c[0], key=abs) == pytest.approx(sign)


def test_a_glb_too_large_is_refused_before_it_is_read(tmp_path, monkeypatch):
    """Its JSON tells the facets of each mesh, as often as nodes hold it."""
    box = trimesh.creation.box()
    scene = trimesh.Scene(box)
    scene.add_geometry(box, geom_name="other")
    (tmp_path / "cubes.glb").write_bytes(scene.export(file_type="glb"))
    monkeypatch.setattr(meshes, "MOST_FACETS", 23)
    monkeypatch.setattr(trimesh, "load_scene", None)
    with pytest.raises(BadInput, match=r"cubes\.glb of 24 facets.*at most 23"):
        read_mesh(tmp_path / "cubes.glb", "m")


def glb(change=lambda told: None):
    """A cube of two primitives, each of a material; `change` is made to its JSON."""
    box = trimesh.creation.box()
    corners = box.vertices.astype("<f4").tobytes()
    faces = box.faces.astype("<u2").tobytes()
    views = [(0, 96), (96, 36), (132, 36)]
    told = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "Bus"}],
        "materials": [{"name": "gold"}, {"name": "black"}],
        "meshes": [
            {
                "primitives": [
                    {"attributes": {"POSITION": 0}, "indices": k, "material": k - 1} for k in (1, 2)
                ]
            }
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            *(
                {"bufferView": k, "componentType": 5123, "count": 18, "type": "SCALAR"}
                for k in (1, 2)
            ),
        ],
        "bufferViews": [{"buffer": 0, "byteOffset": a, "byteLength": n} for a, n in views],
        "buffers": [{"byteLength": 168}],
    }
    change(told)
    text = json.dumps(told).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + 168)
    return (
        head
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", 168, b"BIN\0")
        + corners
        + faces
    )


def test_an_object_of_a_glb_has_the_name_of_its_node(tmp_path):
    """Of two materials too, which trimesh gives names at random; one of another node is its own."""
    twice = {"mesh": 0, "name": "Bus_00000a", "translation": [3, 0, 0]}

    def nodes(told):
        told["nodes"] = [{"mesh": 0, "name": "Bus", "children": [1]}, twice]

    path = write(tmp_path, glb(nodes), "two.glb")
    for _ in range(2):
        mesh = read_mesh(path, "m")
        assert (mesh.things, mesh.materials) == (("Bus", "Bus_00000a"), ("black", "gold"))
    model = gather_mesh(body(path, parts=[{"name": "p", "objects": ["Bus"]}]))
    assert [len(p.facets) for p in model.parts] == [12, 12]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "KHR_draco_mesh_compression"),
        ({"mode": 6}, "fans"),
        ({"sparse": {"count": 1}, "of": 0}, "sparse"),
        ({"sparse": {"count": 1}, "of": 2}, "sparse"),
        ({"normalized": True, "of": 0}, "normalized"),
        ({"extensionsRequired": [7]}, "whole GLB"),
    ],
)
def test_what_a_glb_would_lose_is_refused(tmp_path, change, word):
    def made(told):
        if "of" in change:
            told["accessors"][change["of"]] |= {k: v for k, v in change.items() if k != "of"}
        elif "mode" in change:
            told["meshes"][0]["primitives"][1] |= change
        else:
            told |= change

    with pytest.raises(BadInput, match=word):
        read_mesh(write(tmp_path, glb(made), "a.glb"), "m")


def test_extensions_of_colours_leave_a_glb_as_it_is(tmp_path):
    wanted = ["KHR_materials_unlit", "KHR_texture_transform"]
    path = write(tmp_path, glb(lambda told: told.update(extensionsRequired=wanted)), "a.glb")
    assert read_mesh(path, "m").closed.all()


L_SHAPE = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 4), (0, 4)]
DART = [(0, 0), (2, -1), (0.5, 0), (2, 1)]
COMB = [
    (0, 0),
    (7, 0),
    (7, 3),
    (6, 3),
    (6, 1),
    (4, 1),
    (4, 3),
    (3, 3),
    (3, 1),
    (1, 1),
    (1, 3),
    (0, 3),
]
HOLED = [(0, 0), (3, 0), (3, 3), (0, 3), (0, 0), (1, 1), (1, 2), (2, 2), (2, 1), (1, 1)]


def prism(outline, first, ending):
    """A prism 2 high over an outline, whose ends are one face each that begins at any corner."""
    n = len(outline)
    points = [(x, y, z) for z in (0, 2) for x, y in outline]
    turned = [*range(first, n), *range(first)]
    faces = [turned[::-1], [n + k for k in turned]]
    faces += [[k, (k + 1) % n, (k + 1) % n + n, k + n] for k in range(n)]
    if ending == "obj":
        lines = ["v {} {} {}".format(*p) for p in points]
        return "\n".join(lines + ["f " + " ".join(f"{k + 1}" for k in f) for f in faces]) + "\n"
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {2 * n}\nproperty double x\nproperty double y\n"
        f"property double z\nelement face {n + 2}\nproperty list uchar int vertex_index\nend_header"
    )
    lines = [head, *("{} {} {}".format(*p) for p in points)]
    return "\n".join(lines + [" ".join(map(str, (len(f), *f))) for f in faces]) + "\n"


@pytest.mark.parametrize("ending", ["obj", "ply"])
@pytest.mark.parametrize("outline", [L_SHAPE, DART, COMB, HOLED])
def test_polygons_that_are_not_convex_are_filled(tmp_path, outline, ending):
    """Whatever corner they begin at: ends and sides have the area that they enclose."""
    x, y = np.array(outline, float).T
    end = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    around = float(np.sum(np.hypot(np.roll(x, -1) - x, np.roll(y, -1) - y)))
    for first in range(len(outline)):
        file = read_mesh(write(tmp_path, prism(outline, first, ending), f"{first}.{ending}"), "m")
        a, b, c = np.moveaxis(file.corners_m, 1, 0)
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum()
        assert area == pytest.approx(2.0 * end + 2.0 * around, rel=1e-12)


@pytest.mark.parametrize("last", [3, 4])
def test_a_polygon_that_crosses_itself_is_refused(tmp_path, last):
    with pytest.raises(BadInput, match="a face that crosses itself"):
        read_mesh(write(tmp_path, prism([(0, 0), (2, 0), (0, 1), (2, last)], 0, "obj")), "m")


def test_a_polygon_whose_halves_turn_either_way_is_refused(tmp_path):
    with pytest.raises(BadInput, match="a face that crosses itself"):
        read_mesh(write(tmp_path, prism([(0, 0), (1, 1), (1, 0), (0, 1)], 0, "obj")), "m")


def test_a_file_is_read_once_for_all_targets(tmp_path, monkeypatch):
    read = []
    monkeypatch.setattr(
        "pipeline.inputs.targets.meshes.read_mesh",
        lambda path, *others: read.append(path) or read_mesh(path, *others),
    )
    one, two = (write(tmp_path, CUBE, name) for name in ("a.obj", "b.obj"))
    known = {}
    models = [gather_mesh(body(path), "body", known) for path in (one, two, one, one)]
    assert read == [one, two]
    assert models[0].digest == models[2].digest == models[3].digest
    assert models[0].parts is not models[2].parts


def test_a_face_of_two_corners_is_refused(tmp_path):
    content = b"v 0 0 0\nv 1 0 0\nv 0 1 0\no a\nf 1 2 3\no b\nf 1 2\n"
    with pytest.raises(BadInput, match=r"body\.path"):
        read_mesh(write(tmp_path, content, "a.obj"), "m")


def test_faces_that_fold_have_few_corners_together(tmp_path, monkeypatch):
    """Two ends of 12 corners: the time to cut them grows with the cube of how many."""
    path = write(tmp_path, prism(COMB, 0, "obj"))
    monkeypatch.setattr("pipeline.inputs.targets.polygons.MOST_CUTTING", 2 * 12**3)
    assert read_mesh(path, "m").closed.all()
    monkeypatch.setattr("pipeline.inputs.targets.polygons.MOST_CUTTING", 2 * 12**3 - 1)
    with pytest.raises(BadInput, match="2 faces that fold, of so many corners"):
        read_mesh(path, "m")


def test_a_mark_of_byte_order_moves_no_corner(tmp_path):
    """Of a file that begins with one and has a point that no face uses, faces are as they were."""
    points = [line for line in CUBE.splitlines() if line.startswith("v ")]
    faces = [line for line in CUBE.splitlines() if line.startswith("f ")]
    text = "\n".join([*points, "v 2 3 9", *faces]) + "\n"
    marked, plain = (
        read_mesh(write(tmp_path, text.encode(encoding), f"{encoding}.obj"), "m")
        for encoding in ("utf-8-sig", "utf-8")
    )
    assert np.array_equal(marked.corners_m, plain.corners_m)


@pytest.mark.parametrize(("order", "form"), [("<", "little"), (">", "big")])
@pytest.mark.parametrize("more", [False, True])
@pytest.mark.parametrize("first", [0, 2])
def test_a_binary_ply_may_have_faces_of_any_number_of_corners(tmp_path, order, form, more, first):
    """As the same mesh in text; with other fields, and bytes after the last face."""
    text = prism(COMB, 0, "ply").splitlines()
    start = text.index("end_header") + 1
    points, faces = text[start : start + 24], text[start + 24 :]
    faces = faces[first:] + faces[:first]
    plain = "\n".join([*text[:start], *points, *faces]) + "\n"
    head = "\n".join(text[:start]).replace("ascii", f"binary_{form}_endian")
    if more:
        fields = "vertex_index\nproperty list uchar float uv\nproperty uchar red"
        head = head.replace("vertex_index", fields)
    raw = f"{head}\n".encode()
    raw += np.array([p.split() for p in points], float).astype(f"{order}f8").tobytes()
    for face in faces:
        many, *corners = map(int, face.split())
        raw += struct.pack(f"{order}B{many}i", many, *corners)
        raw += struct.pack(f"{order}B2fB", 2, 0.0, 1.0, 7) * more
    found = read_mesh(write(tmp_path, raw + b"\0" * more, "a.ply"), "m")
    wanted = read_mesh(write(tmp_path, plain, "b.ply"), "m")
    assert np.array_equal(found.corners_m, wanted.corners_m)
    with pytest.raises(BadInput, match="a whole PLY file"):
        read_mesh(write(tmp_path, raw[:-9], "c.ply"), "m")


def test_a_corner_below_the_first_of_a_ply_is_refused(tmp_path):
    head = prism(DART, 0, "ply").rstrip().rpartition(" ")[0]
    with pytest.raises(BadInput, match="corner below 0"):
        read_mesh(write(tmp_path, f"{head} -1\n", "a.ply"), "m")


def test_a_face_that_folds_has_few_corners(tmp_path):
    """Cut in a second, not in hours."""
    comb = [(x, y) for x in range(600) for y in ((0, 9) if x % 2 else (9, 0))]
    with pytest.raises(BadInput, match=r"a face that folds, of 1202 corners \(at most 1000\)"):
        read_mesh(write(tmp_path, prism([*comb, (600, -1), (0, -1)], 0, "obj")), "m")


def test_a_star_drawn_in_one_line_is_refused(tmp_path):
    """Which goes round twice, so that no corner of it can be cut off."""
    star = [(0, 3), (2, -2), (-3, 1), (3, 1), (-2, -2)]
    with pytest.raises(BadInput, match="a face that crosses itself"):
        read_mesh(write(tmp_path, prism(star, 0, "obj")), "m")


def test_more_facets_than_may_be_are_refused_once_they_are_read(tmp_path, monkeypatch):
    """Of polygons, which tell fewer facets than they become."""
    monkeypatch.setattr("pipeline.inputs.targets.meshes.MOST_FACETS", 9)
    path = write(tmp_path, prism(L_SHAPE, 0, "obj"), "prism.obj")
    with pytest.raises(BadInput) as refused:
        read_mesh(path, "m")
    assert "prism.obj of 20 facets' is not accepted" in str(refused.value)
    assert refused.value.allowed == "at most 9 facets"


def test_corners_may_be_counted_backwards(tmp_path):
    """From the last point before the face, as the format has it, not from the file's last one."""
    points = [line for line in CUBE.splitlines() if line.startswith("v ")]
    faces = [line.split()[1:] for line in CUBE.splitlines() if line.startswith("f ")]
    back = ["f " + " ".join(f"{int(k) - 9}//-1" for k in f) for f in faces]
    moved = ["v {} {} {}".format(float(p[1]) + 5, *p[2:]) for p in (v.split() for v in points)]
    text = "\n".join(["vn 0 0 1", "o one", *points, *back, "o two", *moved, *back]) + "\n"
    file = read_mesh(write(tmp_path, text), "m")
    ends = [np.ptp(file.corners_m[file.thing == k].reshape(-1, 3), axis=0) for k in (0, 1)]
    assert (len(file.corners_m), file.notices) == (24, ())
    assert np.array_equal(ends, np.ones((2, 3)))
    assert file.corners_m[..., 0].max() == 6.0


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_face_may_go_on_in_the_next_line(tmp_path, end):
    text = CUBE.replace("f 4 3 2 1", "f 4 3 \\\n2 1").replace("\n", end)
    assert len(read_mesh(write(tmp_path, text), "m").corners_m) == 12


@pytest.mark.parametrize(
    ("line", "other"),
    [
        (r"(?m)^(f|v) ", r"  \1 "),
        (r"(?m)^(f|v|o|usemtl) ", r"\1\t"),
        (r"(?m)^(f [45].*|v.*)$", r"\1 # as drawn"),
        (r"(?m)^(f [45]) ", r"\t\1\t"),
        (r"(?m)(?<=\d) (?=\d)", r"\t"),
    ],
)
def test_blanks_tabs_and_remarks_of_an_obj_change_nothing(tmp_path, line, other):
    found, plain = (
        read_mesh(write(tmp_path, text, name), "m")
        for text, name in ((re.sub(line, other, CUBE), "b.obj"), (CUBE, "a.obj"))
    )
    assert np.array_equal(found.corners_m, plain.corners_m)
    assert (found.materials, found.things) == (plain.materials, plain.things)
    assert found.notices == plain.notices == ()


@pytest.mark.parametrize("corner", ["0", "-9"])
def test_a_corner_that_no_point_has_is_refused(tmp_path, corner):
    with pytest.raises(BadInput, match=f"corner {corner}: they count from 1, or back from -1"):
        read_mesh(write(tmp_path, CUBE.replace("f 4 3 2 1", f"f {corner} 3 2 1")), "m")


def test_shells_that_are_inside_out_are_turned(tmp_path):
    flipped = "\n".join(
        "f " + " ".join(reversed(line.split()[1:])) if line.startswith("f ") else line
        for line in CUBE.splitlines()
    )
    mesh, right = (
        read_mesh(write(tmp_path, flipped), "m"),
        read_mesh(write(tmp_path, CUBE, "b.obj"), "m"),
    )
    assert "inwards" in mesh.notices[0]
    z = np.array([0.0, 0.0, 1.0])
    for m in (mesh, right):
        a, b, c = np.moveaxis(m.corners_m, 1, 0)
        assert np.sum(np.maximum(np.cross(b - a, c - a) @ z, 0)) == pytest.approx(2.0)


def test_facets_without_area_and_repeats_are_left_out(tmp_path):
    """A facet without area that is repeated is told of as such alone."""
    more = CUBE + "f 1 1 2\nf 1 1 2\nf 1 2 6 5\n"
    mesh = read_mesh(write(tmp_path, more), "m")
    assert len(mesh.corners_m) == 12
    assert mesh.closed.all()
    assert any("2 facets without area" in n for n in mesh.notices)
    assert any("2 repeated facets" in n for n in mesh.notices)


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("a.obj", "", "empty"),
        ("a.obj", "hello\n", "triangles"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "finite|triangles"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "with an area"),
        ("a.obj", "v 0 0 0\nv 1e9 0 0\nv 0 1 0\nf 1 2 3\n", "unit right"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", "triangles"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2\n", "triangles"),
        ("a.stl", b"\x00" * 84, "triangles"),
        ("a.stl", b"solid x\nfacet normal 0 0", "triangles"),
        ("a.stl", b"\x00" * 80 + b"\xff\xff\xff\x7f" + b"\x00" * 50, "triangles"),
        ("a.glb", b"glTF\x02\x00\x00\x00\xff\xff\xff\xff", "triangles"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 99999999\nend_header\n", "triangles"),
        ("a.zip", b"PK\x03\x04", "obj"),
        ("a.obj", b"PK\x03\x04 and more", "archive"),
        ("a.fbx", b"Kaydara", "obj"),
        ("a.glb", b"glTF" + bytes(8) + b"\xa0\x86\x01\x00JSON" + b"[" * 100_000, "triangles"),
        (
            "a.ply",
            b"ply\nformat binary_little_endian 1.0\nelement strip 9999999\n"
            b"property list uchar int rows\nend_header\n\1",
            "at most 2000000",
        ),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path, name, content, word):
    with pytest.raises(BadInput, match=word) as error:
        read_mesh(write(tmp_path, content, name), "m", "targets.0.body.path")
    assert "targets.0.body.path" in str(error.value)
    assert name in str(error.value)


def test_missing_and_packed_files_are_refused(tmp_path):
    with pytest.raises(BadInput, match="existing"):
        read_mesh(tmp_path / "none.obj", "m")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as z:
        z.writestr("a.obj", CUBE)
    (tmp_path / "a.zip").rename(tmp_path / "b.obj")
    with pytest.raises(BadInput, match="archive"):
        read_mesh(tmp_path / "b.obj", "m")


def test_no_other_file_is_opened(tmp_path):
    secret = write(tmp_path, "newmtl gold\nmap_Kd /etc/hostname\n", "none.mtl")
    secret.chmod(0o000)
    assert "gold" in read_mesh(write(tmp_path, CUBE), "m").materials


def _rows(value=0.1):
    grid = np.meshgrid([0.0, 45.0, 90.0], [0.0, 45.0, 90.0], [0.0, 180.0], indexing="ij")
    return np.stack([*(g.ravel() for g in grid), np.full(18, value)], axis=1)


HUGE = b"{'descr': '<f8', 'fortran_order': False, 'shape': (9999999999999,)}\n"


def test_measured_tables_from_csv_and_npy(tmp_path):
    np.save(tmp_path / "t.npy", _rows())
    head = "theta_i_deg, theta_o_deg, phi_deg, brdf_per_sr"
    np.savetxt(tmp_path / "t.csv", _rows()[::-1], delimiter=",", header=head, comments="")
    for name in ("t.npy", "t.csv"):
        table, _ = read_brdf_table(tmp_path / name, 2.0)
        z = np.array([0.0, 0.0, 1.0])
        assert table(z, z, unit(np.array([1.0, 0.0, 1.0]))) == pytest.approx(0.2)
    surface = {"kind": "table", "path": str(tmp_path / "t.npy")}
    model = gather_mesh(body(write(tmp_path, CUBE), surface=surface))
    d = np.array([[0.0, 0.0, 1.0]])
    assert model_light(model, d, d, [0.0])[0][0] == pytest.approx(0.1)


def test_a_table_that_ends_early_is_told(tmp_path):
    """As one whose angles are radians does; of one that reaches all directions nothing is said."""
    whole = _rows()
    for axis, top in ((0, 90.0), (1, 90.0), (2, 180.0)):
        whole[:, axis] *= top / whole[:, axis].max()
    for name, rows, told in (
        ("whole.npy", whole, ()),
        (
            "third.npy",
            whole * [1.0, 1.0, 2.0 / 3.0, 1.0],
            ("third.npy: its BRDF ends at phi 120 deg: beyond, the value there holds",),
        ),
        (
            "turns.npy",
            whole * [*np.radians([1.0, 1.0, 1.0]), 1.0],
            ("turns.npy: its BRDF ends at theta_i 1.571, theta_o 1.571, phi 3.142 deg: beyond, the "
             "value there holds",),
        ),
    ):  # fmt: skip
        np.save(tmp_path / name, rows)
        surface = {"kind": "table", "path": str(tmp_path / name)}
        assert gather_mesh(body(write(tmp_path, CUBE), surface=surface)).notices == told


def test_a_table_that_no_surface_has_is_told(tmp_path):
    """Light goes from a to b as from b to a (Helmholtz); 5% is a measurement's error."""
    angles, turns = np.array([0.0, 45.0, 90.0]), np.array([0.0, 90.0, 180.0])
    i, o, phi = (v.ravel() for v in np.meshgrid(angles, angles, turns, indexing="ij"))
    for uneven, share in ((0.0, None), (0.02, None), (0.3, "0.3")):
        value = 0.1 * (1.0 - uneven * ((i == 45.0) & (o == 0.0)))
        np.save(tmp_path / "t.npy", np.stack([i, o, phi, value], axis=1))
        surface = {"kind": "table", "path": str(tmp_path / "t.npy")}
        told = gather_mesh(body(write(tmp_path, CUBE), surface=surface)).notices
        assert len(told) == (share is not None)
        assert all(f"t.npy: its BRDF differs by up to {share} of its largest" in t for t in told)


def test_a_measured_table_as_spreadsheets_write_it(tmp_path):
    """With a mark of byte order, and names and numbers in quotes."""
    names = ("theta_i_deg", "theta_o_deg", "phi_deg", "brdf_per_sr")
    lines = [names, *(map(repr, map(float, row)) for row in _rows())]
    text = "".join(",".join(f'"{cell}"' for cell in line) + "\r\n" for line in lines)
    path = write(tmp_path, text.encode("utf-8-sig"), "t.csv")
    z = np.array([0.0, 0.0, 1.0])
    assert read_brdf_table(path)[0](z, z, z) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("t.csv", b"theta,phi\n1,2\n", "columns"),
        ("t.csv", b"theta_i_deg,theta_o_deg,phi_deg,brdf_per_sr\n0,0,0,x\n", "numbers"),
        ("t.csv", b"theta_i_deg,theta_o_deg,phi_deg,brdf_per_sr\n0,0,0,nan\n", "finite"),
        ("t.csv", b"theta_i_deg,theta_o_deg,phi_deg,brdf_per_sr\n0,0,0,1\n0,5,9,1\n", "grid"),
        ("t.csv", b"theta_i_deg,theta_o_deg,phi_deg,brdf_per_sr\n0,0,0,1\n0,0,0,2\n", "grid"),
        ("t.csv", b"", "columns"),
        ("t.npy", b"not numpy", "NPY"),
        ("t.txt", b"", "csv"),
        ("t.npy", b"PK\x03\x04 no zip", "NPY"),
        ("t.csv", b"theta_i_deg,theta_o_deg,phi_deg,brdf_per_sr,phi_deg\n0,0,0,1,0\n", "columns"),
        ("t.csv", b"x" * 200_000 + b"\n", "a readable table"),
        ("t.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(HUGE)) + HUGE, "NPY"),
    ],
)
def test_bad_tables_are_refused(tmp_path, name, content, word):
    with pytest.raises(BadInput, match=word):
        read_brdf_table(write(tmp_path, content, name))


def test_a_table_whose_angles_scatter_is_refused_before_its_grid_is_made(tmp_path):
    """Of 3,000 rows a grid of 216 GB."""
    rows = np.random.default_rng(1).uniform(0.0, 80.0, (3000, 4))
    np.save(tmp_path / "t.npy", rows)
    with pytest.raises(BadInput, match="one row for each point of the grid of 3000 x 3000 x 3000"):
        read_brdf_table(tmp_path / "t.npy")


@pytest.mark.parametrize(("wish", "sharp"), [
    ({"kind": "lambert", "albedo": 0.3}, False),
    ({"kind": "phong", "diffuse": 0.1, "specular": 0.2, "exponent": 400.0}, False),
    ({"kind": "phong", "diffuse": 0.1, "specular": 0.2, "exponent": 401.0}, True),
    ({"kind": "phong", "diffuse": 0.1, "specular": 0.0, "exponent": 401.0}, False),
    ({"kind": "cook_torrance", "normal_reflectance": 0.5, "roughness": 0.05}, False),
    ({"kind": "cook_torrance", "normal_reflectance": 0.5, "roughness": 0.049}, True),
    ({"kind": "ashikhmin_shirley", "specular": 0.2, "exponent_u": 100.0, "exponent_v": 1.0}, False),
    ({"kind": "ashikhmin_shirley", "specular": 0.2, "exponent_u": 1.0, "exponent_v": 101.0}, True),
    ({"kind": "ashikhmin_shirley", "specular": 0.2, "exponent_u": 101.0}, True),
    ({"kind": "ashikhmin_shirley", "specular": 0.0, "exponent_u": 101.0}, False),
])  # fmt: skip
def test_sharp_highlights_see_the_sun_as_a_disc(wish, sharp):
    """By the documented limits: an exponent of 400 (a quarter of it for half vectors), 0.05."""
    for two_sided in (False, True):
        made, raw = make_surface(TypeAdapter(Reflecting).validate_python(
            wish | {"two_sided": two_sided}))  # fmt: skip
        assert (made.sun_rings > 0, made.two_sided, raw) == (sharp, two_sided, b"")


@pytest.mark.parametrize("exponent", [401.0, 1e5, 1e6])
def test_the_suns_disc_in_the_sharpest_highlights(exponent):
    """Against the integral over a disc of even brightness; where three rings were off by 16%."""
    wish = {"kind": "phong", "diffuse": 0.0, "specular": 0.5, "exponent": exponent}
    made, _ = make_surface(TypeAdapter(Reflecting).validate_python(wish))
    radius, z = 4.652e-3, np.array([0.0, 0.0, 1.0])
    lit = [float(made.brdf(z[None], p, z)[0]) for p in sun_points(z, radius, made.sun_rings)]
    x = 0.5 * exponent * radius**2
    assert np.mean(lit) / made.brdf(z[None], z, z)[0] == pytest.approx(-np.expm1(-x) / x, rel=6e-3)


def _lobe(angle_rad, sigma_deg):
    """BRDF of a round highlight of so many radians from the mirror's direction."""
    sigma = np.radians(sigma_deg)
    return 0.2 * np.exp(-0.5 * (angle_rad / sigma) ** 2) / (2.0 * np.pi * sigma**2)


def _glossy_table(path, sigma_deg, step_deg, most_deg):
    """A table of `_lobe` for Sun and observer about the normal, matt farther off."""
    angles = np.unique([*np.arange(0.0, most_deg, step_deg), most_deg, 90.0])
    turns = np.arange(0.0, 181.0, 4.0)
    i, o, phi = (v.ravel() for v in np.meshgrid(angles, angles, turns, indexing="ij"))
    s, n, p = np.radians(i), np.radians(o), np.radians(phi)
    x, y = np.sin(s) + np.sin(n) * np.cos(p), np.sin(n) * np.sin(p)
    off = 2.0 * np.arcsin(np.minimum(np.sqrt(x**2 + y**2 + (np.cos(s) - np.cos(n)) ** 2) / 2, 1.0))
    glossy = np.where(np.maximum(i, o) < most_deg, _lobe(off, sigma_deg), 0.0)
    np.save(path, np.stack([i, o, phi, 0.02 + glossy], axis=1))
    return {"kind": "table", "path": str(path)}


@pytest.mark.parametrize(("sigma_deg", "step_deg"), [(0.15, 0.05), (0.5, 0.1), (1.0, 0.2)])
def test_a_sharp_table_sees_the_sun_as_a_disc(tmp_path, sigma_deg, step_deg):
    """By a sum over the disc; by its middle alone that of 0.15 deg was 1.8 times too bright."""
    surface = _glossy_table(tmp_path / "t.npy", sigma_deg, step_deg, 5.0 * sigma_deg + 1.0)
    model = gather_mesh(body(write(tmp_path, CUBE), surface=surface))
    assert model.notices == ()
    radius, (r, turn) = 4.652e-3, np.meshgrid((np.arange(100) + 0.5) / 100, np.arange(360) + 0.5)
    across, along = (radius * r * f(np.radians(turn)) for f in (np.cos, np.sin))

    def seen(sun_deg, observer_deg):
        s, o = ([np.sin(a), 0.0, np.cos(a)] for a in np.radians([sun_deg, -observer_deg]))
        return model_light(model, [s], [o], [0.0], 1e-3, radius)[0][0]

    for sun_deg in (0.0, 1.0):
        peak = None
        for off_deg in (0.0, 0.3, 0.5):
            value = 0.02 + _lobe(np.hypot(across + np.radians(off_deg), along), sigma_deg)
            wanted = float(np.average(value, weights=r))
            peak = peak or wanted
            found = seen(sun_deg, sun_deg + off_deg)
            assert found == pytest.approx(wanted, abs=0.03 * peak)


@pytest.mark.parametrize(("sigma_deg", "step_deg", "rings"), [(0.5, 0.1, True), (8.0, 1.0, False)])
def test_only_sharp_tables_ask_for_rings(tmp_path, sigma_deg, step_deg, rings):
    surface = _glossy_table(tmp_path / "t.npy", sigma_deg, step_deg, 4.0 if rings else 90.0)
    made, _ = make_surface(TypeAdapter(Reflecting).validate_python(surface))
    assert (made.sun_rings > 0) == rings
    np.save(tmp_path / "matt.npy", _rows())
    matt = {"kind": "table", "path": str(tmp_path / "matt.npy")}
    assert make_surface(TypeAdapter(Reflecting).validate_python(matt))[0].sun_rings == 0


def test_a_table_finer_than_the_rings_of_the_suns_disc_is_told(tmp_path):
    surface = _glossy_table(tmp_path / "t.npy", 0.005, 0.002, 0.04)
    rows = np.load(tmp_path / "t.npy")
    rows[:, 3] *= 0.02 / rows[:, 3].max()  # as bright as a surface can be between so few angles
    np.save(tmp_path / "t.npy", rows)
    told = gather_mesh(body(write(tmp_path, CUBE), surface=surface)).notices
    assert any("t.npy: its BRDF has highlights as fine as the 64 rings" in t for t in told)


@pytest.mark.parametrize("sigma_deg", [5.0, 3.0])
def test_a_read_table_says_how_narrow_its_highlights_are(tmp_path, sigma_deg):
    """As a formula as sharp does: what turns fast is looked at as often."""
    surface = _glossy_table(tmp_path / "t.npy", sigma_deg, 1.0, 90.0)
    rows = np.load(tmp_path / "t.npy")
    rows[rows[:, 0] == 90.0, 3] = 2.0 * rows[:, 3].max()  # where nothing is lit
    np.save(tmp_path / "t.npy", rows)
    made = body(write(tmp_path, CUBE), surface=surface)
    assert made.highlight_rad == np.inf
    wanted = 0.5 * np.radians(sigma_deg)
    read = made.with_model(gather_mesh(made), 1e-3)
    assert 0.999 * wanted <= read.highlight_rad <= wanted + np.radians(0.5)
    np.save(tmp_path / "matt.npy", _rows())
    matt = {"kind": "table", "path": str(tmp_path / "matt.npy")}
    matt = body(write(tmp_path, CUBE), surface=matt)
    assert matt.with_model(gather_mesh(matt), 1e-3).highlight_rad == np.inf
