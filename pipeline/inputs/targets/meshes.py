"""Meshes from files: OBJ, STL, GLB and PLY by trimesh, checked, mended where that is certain."""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from catalog_tools.documents import Arguments, JsonObject, JsonValue
from pipeline.errors import BadInput, Missing, why_broken
from pipeline.inputs.targets.mesh_surfaces import Palette
from pipeline.inputs.targets.polygons import CORNERS, HEADER_BYTES, filled, plain_faces, text_ply
from pipeline.physics.meshes.facets import Facets, is_convex
from pipeline.physics.meshes.model import Joint, MeshModel, RigidPart
from pipeline.physics.meshes.shells import closed_shells, shell_volumes
from pipeline.spec.scene import Scene
from pipeline.spec.targets.mesh import (
    METRES,
    MeshBody,
    Meshed,
    MeshPart,
    SpinJoint,
    SunTrackingJoint,
    Unit,
)

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

KINDS = ("obj", "stl", "glb", "ply")
LARGEST_BYTES = 500_000_000
MOST_FACETS = 2_000_000
LARGEST_M = 1e5
MANY_FACETS = 200_000
MERGE = 1e-9  # of the size: corners closer than that are one
FAN = 6  # TRIANGLE_FAN of glTF 2.0, 3.7.2.1
HARMLESS = (  # extensions of glTF by how they begin: of colours and lamps alone, or taken
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
    "KHR_mesh_quantization",
)
NAMED = 8  # names listed in a message, at most


@dataclass(frozen=True, eq=False)
class MeshFile:
    """Triangles as a file holds them, in metres.

    corners_m : (F, 3, 3); closed : (F,) of a shell without holes
    material, thing : (F,) places in `materials` and `things` (the file's objects)
    """

    corners_m: Array
    closed: NDArray[np.bool_]
    material: Ints
    thing: Ints
    materials: tuple[str, ...]
    things: tuple[str, ...]
    digest: str
    notices: tuple[str, ...] = ()


FileKey = tuple[str, Unit]  # path and unit


def gather_meshes(scene: Scene) -> Scene:
    """The scene with the meshes of its targets read; what the files have to say is in the models.

    BadInput where a file is not the one that the scene was made with.
    """
    targets, known = [], dict[FileKey, MeshFile]()
    for i, target in enumerate(scene.targets):
        body, field = target.body, f"targets.{i}.body"
        if isinstance(body, MeshBody):
            model = gather_mesh(body, field, known)
            if body.digest not in (None, model.digest):
                raise BadInput(f"{field}.digest", body.digest, f"{model.digest}, of these files")
            read = body.with_model(model, 0.5 * scene.accuracy.flux_fraction)
            target = target.model_copy(update={"body": read})
        targets.append(target)
    return scene.model_copy(update={"targets": tuple(targets)})


def gather_mesh(
    body: MeshBody, field: str = "body", known: dict[FileKey, MeshFile] | None = None
) -> MeshModel:
    """A body's files read and put together: parts, surfaces, joints; its notices are for the user.

    known : files that other bodies have read; those that this one reads are added

    BadInput names the field where a file cannot be used, an object is not in it, or a material
    has no surface.
    """
    known = {} if known is None else known
    whole = _read_once(known, (body.path, body.unit), field)
    files = {(body.path, body.unit): whole}
    palette = Palette()
    moved = (part.objects or () for part in body.parts if part.path is None)
    rest = _take(whole, None, set().union(*moved), f"{field}.parts")
    parts = []
    if rest.any():
        parts.append(RigidPart(_facets(whole, rest, palette, (body,), field)))
    numbers: dict[str, int] = {}
    for k, part in enumerate(body.parts):
        place = f"{field}.parts.{k}"
        key = (part.path or body.path, part.unit or body.unit)
        files[key] = _read_once(known, key, place)
        some = _take(files[key], part.objects, set(), f"{place}.objects")
        facets = _facets(files[key], some, palette, (part, body), place)
        on = None if part.on is None else numbers[part.on]
        numbers[part.name] = len(parts)
        parts.append(_placed(part, facets, on))
        _check_materials(part, [files[key]], place)
    _check_materials(body, files.values(), field)
    notices = chain(*(file.notices for file in files.values()), palette.notices)
    return MeshModel(tuple(parts), palette.surfaces, _digest(body, files, palette), tuple(notices))


def _read_once(known: dict[FileKey, MeshFile], key: FileKey, field: str) -> MeshFile:
    """A file that is known, or that is read and known from then on."""
    if key not in known:
        known[key] = read_mesh(Path(key[0]), key[1], f"{field}.path")
    return known[key]


def _check_materials(owner: Meshed, files: Collection[MeshFile], field: str) -> None:
    """BadInput for a material of a body, or of a part, that is in none of its files."""
    known = sorted(set().union(*(file.materials for file in files)))
    for name in owner.materials:
        if name not in known:
            raise BadInput(f"{field}.materials", name, f"a material of the file: {_names(known)}")


def _digest(body: MeshBody, files: Mapping[FileKey, MeshFile], palette: Palette) -> str:
    """Of a body and its files: names, but not the folders that they lie in, nor what reading them
    has added to the body: a product's scene is read with the same files again.
    """
    bare = body.model_copy(update={"digest": None, "error": None})
    folders: Arguments = {"path": True, "surface": {"path"}, "materials": {"__all__": {"path"}}}
    content = hashlib.sha256(
        bare.model_dump_json(exclude=folders | {"parts": {"__all__": folders}}).encode()
    )
    for (path, unit), file in files.items():
        content.update(f"{Path(path).name} {unit} {file.digest}\n".encode())
    content.update(palette.digest.encode())
    return content.hexdigest()


def _placed(part: MeshPart, facets: Facets, on: int | None) -> RigidPart:

    rotation = scipy.spatial.transform.Rotation.from_quat(np.roll(part.quaternion, -1)).as_matrix()
    joint = None
    if part.joint is not None:
        j = part.joint
        axis = np.array(j.axis) / np.linalg.norm(j.axis)
        face, rate, law = np.array([0.0, 0.0, 1.0]), 0.0, "fixed"
        if isinstance(j, SunTrackingJoint):
            law, face = "sun", np.array(j.face) / np.linalg.norm(j.face)
        elif isinstance(j, SpinJoint):
            law, rate = "spin", float(np.deg2rad(j.rate_deg_s))
        angle = float(np.deg2rad(j.angle_deg))
        joint = Joint(law, axis, np.array(j.pivot_m), face, angle, rate)  # type: ignore[arg-type]
    return RigidPart(facets, on, rotation, np.array(part.place_m), joint)


def _take(
    file: MeshFile, wanted: tuple[str, ...] | None, without: set[str], field: str
) -> NDArray[np.bool_]:
    """Facets (F,) of the wanted objects (None: of all but some)."""
    for one in sorted(without | set(wanted or ())):
        if one not in file.things:
            raise BadInput(field, one, f"an object of the file: {_names(file.things)}")
    if wanted is None:
        keep = [k for k, thing in enumerate(file.things) if thing not in without]
    else:
        keep = [k for k, thing in enumerate(file.things) if thing in wanted]
    return np.isin(file.thing, keep)


def _facets(
    file: MeshFile,
    some: NDArray[np.bool_],
    palette: Palette,
    owners: tuple[Meshed, ...],
    field: str,
) -> Facets:
    """Facets of a part, each with the place of its surface."""
    used = np.unique(file.material[some])
    missing = []
    place = np.zeros(len(file.materials), np.int64)
    for k in used:
        number = palette.number(file.materials[k], owners, field)
        if number is None:
            missing.append(file.materials[k])
        else:
            place[k] = number
    if missing:
        raise BadInput(
            f"{field}.materials",
            _names(missing),
            "a surface for each of these materials of the file, or `surface` for all others",
        )
    corners = file.corners_m[some]
    closed = file.closed[some]
    convex = bool(closed.all() and is_convex(corners))
    return Facets(corners, place[file.material[some]], closed, convex)


def read_mesh(path: Path, unit: str, field: str = "body.path") -> MeshFile:
    """Read a file of triangles (or polygons, which are cut into triangles) in a given unit.

    What is certain is mended and told in the notices: facets without area and exact repeats are
    omitted, closed shells that are inside out are turned. BadInput for anything else that is
    wrong: see `_bytes`, `_parse` and `_checked`.
    """
    raw, kind = _bytes(path, field)
    pieces = _parse(raw, kind, path.name, field)
    corners = np.concatenate([p[0] for p in pieces]) * METRES[unit]
    many = [len(p[0]) for p in pieces]
    materials, things = tuple(sorted({p[1] for p in pieces})), tuple(sorted({p[2] for p in pieces}))
    material = np.repeat([materials.index(p[1]) for p in pieces], many).astype(np.int64)
    thing = np.repeat([things.index(p[2]) for p in pieces], many).astype(np.int64)
    _check_size(corners, path.name, unit, field)
    keep, shell, shut, notices = _whole(corners, path.name, field)
    corners, material, thing = corners[keep], material[keep], thing[keep]
    inside_out = shut & (shell_volumes(corners, shell, shut.size) < 0.0)
    turned = inside_out[shell]
    corners[turned] = corners[turned][:, ::-1]
    if turned.any():
        notices.append(
            f"{path.name}: {int(inside_out.sum())} closed shells ({int(turned.sum())} facets) had "
            "their normals inwards; they are turned outwards"
        )
    if len(corners) > MANY_FACETS:
        notices.append(
            f"{path.name}: {len(corners)} facets: each moment takes seconds; a mesh of a tenth of "
            "them would give nearly the same light"
        )
    open_facets = int(np.sum(~shut[shell]))
    if open_facets:
        notices.append(
            f"{path.name}: not watertight: {open_facets} of {len(corners)} facets belong to shells "
            "with holes, edges shared by more than two facets or facets that face both ways; seen "
            "from behind they are black (two_sided: true makes sheets reflect on both sides)"
        )
    return MeshFile(
        corners,
        shut[shell],
        material,
        thing,
        materials,
        things,
        hashlib.sha256(raw).hexdigest(),
        tuple(notices),
    )


def _bytes(path: Path, field: str) -> tuple[bytes, str]:
    """A file's bytes and kind; BadInput where it is missing, packed, too large or of no kind."""
    kind = path.suffix.lower().lstrip(".")
    if not path.is_file():
        raise BadInput(field, str(path), "an existing file: .obj, .stl, .glb or .ply")
    if kind not in KINDS:
        raise BadInput(field, path.name, "a file of triangles: .obj, .stl, .glb or .ply")
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        raise BadInput(field, f"{path.name} of {size} bytes", f"at most {LARGEST_BYTES} bytes")
    raw = path.read_bytes()
    if raw[:4] in (b"PK\x03\x04", b"7z\xbc\xaf") or raw[:2] == b"\x1f\x8b":
        raise BadInput(field, path.name, "the unpacked file, not an archive")
    if not raw.strip():
        raise BadInput(field, path.name, "a file that is not empty")
    return raw, kind


def _parse(raw: bytes, kind: str, name: str, field: str) -> list[tuple[Array, str, str]]:
    """(corners (n, 3, 3), material, object) of each piece of a file; no other file is opened."""
    if (told := _told_facets(raw, kind)) > MOST_FACETS:  # before half a minute of reading
        raise BadInput(field, f"{name} of {told} facets", f"at most {MOST_FACETS} facets")
    try:
        import trimesh
    except ImportError as error:
        broken = why_broken(error, "trimesh")
        raise Missing("meshes", "trimesh", "mesh", field=field, broken=broken) from None
    options: Arguments = {}
    try:
        if kind == "obj":
            raw, options = _with_materials(plain_faces(raw))
        elif kind == "glb":
            _check_glb(_json_of(raw))
        pieces = _loaded(trimesh, raw, kind, options)
    except MemoryError:
        raise
    except Exception as error:  # trimesh raises whatever its readers stumble upon
        what = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise BadInput(field, name, f"a whole {kind.upper()} file of triangles; {what}") from None
    if not sum(len(p[0]) for p in pieces):
        raise BadInput(field, name, f"a whole {kind.upper()} file with triangles in it")
    return pieces


def _loaded(
    trimesh: Any, raw: bytes, kind: str, options: Arguments
) -> list[tuple[Array, str, str]]:
    """The pieces of a file by trimesh; of a PLY that it cannot read in binary, of its text."""
    try:
        scene = trimesh.load_scene(io.BytesIO(raw), file_type=kind, process=False, **options)
        return list(_pieces(trimesh, scene, kind))
    except ValueError:
        text = text_ply(raw)
        if text is None:
            raise
    return _loaded(trimesh, text, kind, options)


def _pieces(trimesh: Any, scene: Any, kind: str) -> Iterator[tuple[Array, str, str]]:
    """(corners, material, object) of each mesh of a scene of trimesh, as often as it is placed."""
    for node in scene.graph.nodes_geometry:
        turn, key = scene.graph[node]
        mesh = scene.geometry[key]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        points = trimesh.transform_points(np.asarray(mesh.vertices, float), turn)
        faces = np.asarray(mesh.faces)
        if kind == "ply" and (cut := filled(points, _polygons(mesh))) is not None:
            faces = cut
        _check_faces(faces)
        if np.linalg.det(turn[:3, :3]) < 0.0:
            faces = faces[:, ::-1]
        material = str(getattr(getattr(mesh.visual, "material", None), "name", None) or "")
        thing = _thing(str(key), material) if kind == "obj" else _node(scene, str(node), mesh)
        yield points[faces], material, thing


def _check_faces(faces: Ints) -> None:
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError("faces of fewer than three corners")
    if faces.min(initial=0) < 0:
        raise ValueError("a face's corner below 0")


def _polygons(mesh: Any) -> Any:
    """The faces of a PLY as the file has them."""
    read = mesh.metadata["_ply_raw"]["face"]["data"]
    names = list(read if isinstance(read, dict) else read.dtype.names)
    lists = read[next((n for n in names if n in CORNERS), names[0])]
    if isinstance(read, dict):
        return lists
    if np.ptp(lists["f0"]):
        raise ValueError("faces of different numbers of corners")
    return lists["f1"]


def _told_facets(raw: bytes, kind: str) -> int:
    """How many facets a file has at least, by its header or by its lines; 0 where that is unclear.

    A GLB file tells in its JSON: the indices, or corners, of each mesh as often as nodes hold it.
    """
    if kind == "obj":
        return raw.count(b"\nf ")
    if kind == "ply":
        found = re.search(rb"(?m)^element[ \t]+face[ \t]+(\d{1,18})", raw[:HEADER_BYTES])
        return int(found[1]) if found else 0
    if kind == "stl":
        told = int.from_bytes(raw[80:84], "little")
        return told if len(raw) == 84 + 50 * told else raw.count(b"endfacet")
    try:
        told = _json_of(raw)
        meshes, of = told["meshes"], told["accessors"]
        corners = [
            sum(of[p.get("indices", p["attributes"]["POSITION"])]["count"] for p in m["primitives"])
            for m in meshes
        ]
        return sum(corners[node["mesh"]] for node in told["nodes"] if "mesh" in node) // 3
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError):
        return 0  # no GLB as it should be: its reader says what is wrong


def _json_of(raw: bytes) -> JsonValue:
    """What a GLB file says of itself; ValueError where that is no JSON."""
    return json.loads(raw[20 : 20 + int.from_bytes(raw[12:16], "little")])


def _check_glb(told: JsonValue) -> None:
    """ValueError for what trimesh would pass over without a word: facets or places lost."""
    for name in told.get("extensionsRequired", ()):
        if not name.startswith(HARMLESS):
            raise ValueError(f"it requires the extension {name}: export it without")
    for mesh in told.get("meshes", ()):
        for primitive in mesh["primitives"]:
            _check_primitive(primitive, told["accessors"])


def _check_primitive(primitive: JsonObject, accessors: list[JsonObject]) -> None:
    points = accessors[primitive["attributes"]["POSITION"]]
    corners = accessors[primitive["indices"]] if "indices" in primitive else {}
    if primitive.get("mode") == FAN:
        raise ValueError("it has triangle fans: export it as triangles")
    if "sparse" in points or "sparse" in corners:
        raise ValueError("it has sparse accessors: export it without")
    if points.get("normalized"):
        raise ValueError("its corners are normalized whole numbers: export them as floats")


def _with_materials(raw: bytes) -> tuple[bytes, JsonObject]:
    """An OBJ with a material library of its own, in memory: names alone, all that are used."""
    names = {n.strip() for n in re.findall(rb"(?m)^[ \t]*usemtl[ \t]+([^\r\n]+)", raw)}
    library = b"".join(b"newmtl %s\nKd 1 1 1\n" % n for n in sorted(names | {b"(a)", b"(b)"}))
    text = re.sub(rb"(?m)^[ \t]*mtllib[^\r\n]*", b"", raw)
    options = {
        "resolver": {"names.mtl": library},
        "split_objects": True,
        "group_material": True,
    }
    return b"mtllib names.mtl\n" + text, options


def _thing(key: str, material: str) -> str:
    """The object's own name: trimesh calls the pieces of an OBJ object_material."""
    if material and key.endswith(f"_{material}"):
        return key[: -len(material) - 1]
    return "" if key == material else key


def _node(scene: Any, node: str, mesh: Any) -> str:
    """The file's own name of a node: to a mesh of several primitives (of several materials)
    trimesh gives a node each below it, name_hexadecimals, others in each run.
    """
    above = scene.graph.transforms.parents.get(node)
    several = mesh.metadata.get("from_gltf_primitive")
    return above if several and re.fullmatch(rf"{re.escape(above)}_[0-9a-f]{{6}}", node) else node


def _check_size(corners: Array, name: str, unit: str, field: str) -> None:
    if len(corners) > MOST_FACETS:
        raise BadInput(field, f"{name} of {len(corners)} facets", f"at most {MOST_FACETS} facets")
    if not np.all(np.isfinite(corners)):
        bad = int(np.sum(~np.isfinite(corners).all(axis=(1, 2))))
        raise BadInput(field, f"{name}: {bad} facets at NaN or infinity", "finite coordinates")
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    far = float(np.abs(corners).max())
    if not 0.0 < size <= LARGEST_M or far > LARGEST_M:
        raise BadInput(
            field,
            f"{name}: {size:g} m across, {far:g} m from its origin in unit: {unit}",
            f"a body of more than 0 and at most {LARGEST_M:g} m; is the unit right?",
        )


def _whole(
    corners: Array, name: str, field: str
) -> tuple[NDArray[np.bool_], Ints, NDArray[np.bool_], list[str]]:
    """Facets to keep (F,); of those their shells (n,), whether each is closed (S,); and notices.

    Facets without area close the cracks between others, and count for that before they go.
    """
    size = float(np.abs(corners).max())
    grid = np.round(corners.reshape(-1, 3) / (MERGE * size)).astype(np.int64)
    _, number = np.unique(grid, axis=0, return_inverse=True)
    faces = np.asarray(number, np.int64).reshape(-1, 3)
    a, b, c = np.moveaxis(corners, 1, 0)
    area = 0.5 * np.sqrt(np.sum(np.square(np.cross(b - a, c - a)), axis=-1))
    line = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    flat = line | (area <= 1e-14 * size * size)
    start = np.argmin(faces, axis=1)[:, None]
    cyclic = np.take_along_axis(faces, (start + np.arange(3)) % 3, axis=1)
    _, first = np.unique(cyclic, axis=0, return_index=True)
    again = np.ones(len(faces), bool)
    again[first] = False
    notices = []
    if flat.any():
        notices.append(f"{name}: {int(flat.sum())} facets without area are omitted")
    if np.any(again & ~flat):
        notices.append(f"{name}: {int(np.sum(again & ~flat))} repeated facets are omitted")
    if np.all(flat | again):
        raise BadInput(field, name, "facets with an area")
    whole = ~(line | again)
    shell, shut = closed_shells(faces[whole])
    return ~(flat | again), shell[~flat[whole]], shut, notices


def _names(names: Collection[str]) -> str:
    some = [n or "(no name)" for n in list(names)[:NAMED]]
    return ", ".join(some) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
