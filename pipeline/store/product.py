"""The life of a product: begin, resume, finish, check. Nothing looks whole before it is."""

from __future__ import annotations

import copy
import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any
from uuid import uuid4

from catalog_tools.documents import JsonObject
from catalog_tools.engine.code import code_digest
from catalog_tools.storage.durable import file_digest, sync_all
from pipeline.errors import NO_ROOM, BadInput, Damaged
from pipeline.plan.plan import Plan
from pipeline.plan.tiles import tile_shape
from pipeline.spec.load import path_holders, scene_yaml
from pipeline.spec.scene import Scene
from pipeline.store import layout
from pipeline.store.cube import CubeWriter, create_arrays, create_layer, layers_of
from pipeline.store.markers import (
    Marker,
    chunk_fault,
    markers_present,
    place_of,
    read_marker,
)
from pipeline.store.seal import FORMAT, finished_faults
from pipeline.store.truth import drop_parts, part_is_whole
from pipeline.user_data import user_data_files

CATALOGUES = ("stars.catalogue",)  # fields of files that have digests of their own
CONTENT_KNOWN = (*CATALOGUES, "populations.", "catalogue.")  # or whose content is in the scene
IMAGES = tuple(  # fields of files that frames are calibrated with
    f"sensor.{name}"
    for name in ("flat", "dark_e_per_s", "read_noise_e", "gain_e_per_dn", "bias_dn", "detector.")
)
Cell = tuple[Any, ...]  # layer, frame, row, column, checksum


@dataclass(frozen=True)
class Begun:
    """A product being written: its writer, and what an earlier run has already finished."""

    path: Path
    writer: CubeWriter
    done: frozenset[tuple[int, int, int]]
    truth_done: frozenset[tuple[str, int]]
    redrawn: tuple[str, ...]


def begin(
    path: Path,
    plan: Plan,
    catalogue_digest: str | None,
    resume: bool,
    mine: Callable[[int, int, int], bool] | None = None,
) -> Begun:
    """Make a new product directory, or take up an unfinished one (`resume`).

    mine : whether a tile (frame, row, column) is this writer's; others' markers are left alone
    Raises BadInput where the path exists and is not to be resumed, or is to be and comes from
    another scene, catalogue or version of the format.
    """
    identity = identity_of(plan, catalogue_digest)
    check_free(path, resume)
    if not path.exists():
        _make_folders(path)
        create_arrays(path, plan)
        sync_all(path / layout.CUBE)  # the record of the beginning vouches for it
        layout.write_atomically(path / layout.SCENE, scene_yaml(plan.scene).encode())
        layout.write_atomically(path / layout.BEGUN, layout.to_json(identity))
        return Begun(path, _writer(path, plan), frozenset(), frozenset(), ())
    return _take_up(path, plan, identity, mine)


def check_free(path: Path, resume: bool) -> None:
    """BadInput where a new product's path exists, or that of one to be taken up does not."""
    if path.exists() and not resume:
        allowed = "a path that does not exist yet; or give --resume or --replace"
        raise BadInput("-o", str(path), allowed)
    if resume and not path.exists():
        raise BadInput("--resume", str(path), "a product that was begun before")


def is_begun(path: Path) -> bool:
    """Whether a product was begun at a path; its writer's lock may then be taken.

    Sweeps and studies have a record of that name too, which says what it is of; one that cannot be
    read is a product's.
    """
    try:
        return not _is_of_another(json.loads((path / layout.BEGUN).read_bytes()))
    except OSError:
        return False
    except (ValueError, TypeError):
        return True


def _is_of_another(record: JsonObject) -> bool:
    """Whether a record is that of a sweep or of a study."""
    return not {"axes", "study"}.isdisjoint(record)


def make_together(path: Path, plan: Plan, catalogue_digest: str | None) -> None:
    """Make a product that several writers share, unless one of them was first."""
    if path.exists():
        if not is_begun(path):
            begin(path, plan, catalogue_digest, resume=True)  # refused, or begun anew
        return
    own = path.with_name(f".{path.name[:50]}.{uuid4().hex}.tmp")  # names end at 255 bytes
    try:
        with layout.full_disk(own):  # not a file elsewhere, though it lies beside the product
            begin(own, plan, catalogue_digest, resume=False)
        own.rename(path)  # fails where another writer was first
    except BadInput as error:
        value = str(path) if error.value == str(own) else error.value
        raise BadInput(error.field, value, error.allowed) from None
    except OSError:
        if not path.exists():
            raise
    finally:
        shutil.rmtree(own, ignore_errors=True)


def identity_of(plan: Plan, catalogue_digest: str | None) -> JsonObject:
    """What makes two products the same."""
    data, digest = plan.scene.as_dict(), cache(file_digest)  # each file is read once
    return {
        "format": FORMAT,
        "scene_sha256": scene_digest(plan),
        "catalogue_digest": catalogue_digest,
        "files_sha256": files_digest(data, digest),
        "images_sha256": {str(file): digest(file) for _, file in sensor_images(data)},
        "tile_shape": list(tile_shape(plan.scene)),
        "compression": plan.scene.output.compression,
        "tiles": len(plan.tiles) * plan.frames,
        "code": code_digest(),
    }


def _take_up(
    path: Path,
    plan: Plan,
    identity: JsonObject,
    mine: Callable[[int, int, int], bool] | None = None,
) -> Begun:
    if not is_begun(path):
        if not _is_bare_beginning(path):
            raise BadInput("--resume", str(path), "a product begun by `nightglass render`")
        shutil.rmtree(path)  # it stopped before its first task: begin anew
        return begin(path, plan, identity["catalogue_digest"], resume=False)
    (path / layout.TRUTH / layout.PARTS).mkdir(exist_ok=True)
    check_same(str(path), _identity(path), identity)
    done, faults = set(), []
    for marker in markers_present(path):
        if mine is not None and not mine(*place_of(marker)):
            continue
        fault = _marker_fault(path, marker)
        if fault is None:
            m = read_marker(marker)
            done.add((m.frame, m.row, m.column))
        else:
            faults.append(fault)
            marker.unlink()
    truth = {part for part in truth_parts(plan) if part_is_whole(path, *part)}
    return Begun(path, _writer(path, plan), frozenset(done), frozenset(truth), tuple(faults))


LATER = ("compression", "images_sha256")  # which records of earlier versions do not hold
CHANGED = {  # what may have changed since a product was begun, in the user's words
    "format": "it was made by another version",
    "scene_sha256": "the scene, its --set, or where its files are has changed",
    "catalogue_digest": "the catalogue has changed",
    "code": "it was begun by other code or libraries, whose bits may differ",
    "files_sha256": "a file that the scene names, or of NIGHTGLASS_DATA, has changed",
}


def check_same(place: str, found: JsonObject, identity: JsonObject) -> None:
    """Refuse to go on with a product that was begun as another one."""
    for key, wanted in identity.items():
        if found.get(key, wanted if key in LATER else None) != wanted:
            told = CHANGED.get(key, f"wanted {wanted}")
            allowed = f"a product of the same {key} ({told}; --replace begins anew)"
            raise BadInput("--resume", place, allowed)


def check_same_images(path: Path, data: JsonObject) -> None:
    """Refuse files of the sensor's images other than those that a product was begun with, by name.

    Records of earlier versions do not hold them.
    """
    known = _identity(path).get("images_sha256", {})
    for name, file in sensor_images(data):
        if known.get(str(file)) not in (None, file_digest(file)):
            raise BadInput(name, str(file), f"the file as it was when {path} was begun")


def with_images_of(path: Path, data: JsonObject, folder: Path | None) -> JsonObject:
    """Plain data of a product's scene with those of the sensor's images that are gone from their
    places (the product came from a server, or has moved) taken from a folder, by their content.

    Raises BadInput for one that is not there either, and a folder that is none.
    """
    if folder is not None and not folder.is_dir():
        raise BadInput("--images", str(folder), "a folder")
    known, data = _identity(path).get("images_sha256", {}), copy.deepcopy(data)
    there = cache(lambda: _by_digest(folder))  # once, where one is gone
    for name, holder, key in path_holders(data):
        file = holder.get(key)
        if name.startswith(IMAGES) and isinstance(file, str) and not Path(file).exists():
            if file not in known:
                raise BadInput(name, file, "the file itself: the product does not say what it held")
            if known[file] not in there():
                raise BadInput(name, file, "a file that exists, or --images DIR with its content")
            holder[key] = there()[known[file]]
    return data


def _by_digest(folder: Path | None) -> dict[str, str]:
    """The files in a folder, by their SHA-256."""
    files = sorted(folder.iterdir()) if folder is not None else []
    return {file_digest(file): str(file) for file in files if file.is_file()}


def _is_bare_beginning(path: Path) -> bool:
    """Whether a folder without a record holds only what `begin` makes before it: safe to remove.

    Anything else in it (a file of the user's, a cube that opens, a marker) is not ours to delete.
    """
    known = {layout.CUBE, layout.MARKERS, layout.TRUTH, layout.SCENE, layout.LOCK}
    names = {p.name for p in path.iterdir() if not p.name.endswith(".tmp")} if path.is_dir() else {}
    cube = path / layout.CUBE
    ours = cube.is_dir() and not (cube / "zarr.json").exists() and not any(markers_present(path))
    return ours and set(names) <= known


def _identity(path: Path) -> JsonObject:
    """What the product was begun as. Raises Damaged where the record is not what was written."""
    return identity_in((path / layout.BEGUN).read_bytes(), str(path / layout.BEGUN))


def identity_in(content: bytes, place: str) -> JsonObject:
    """What the record of a beginning says. Raises Damaged naming `place`.

    BadInput where it is that of a sweep or a study.
    """
    try:
        found = json.loads(content)
        if _is_of_another(found):
            raise BadInput("PRODUCT", place, "a product of `nightglass render`, no sweep or study")
        return found | {"tiles": int(found["tiles"])}
    except (ValueError, KeyError, TypeError) as error:
        raise Damaged(place, f"not what was written ({error})") from None


def _marker_fault(path: Path, marker: Path) -> str | None:
    try:
        return chunk_fault(path, read_marker(marker))
    except Damaged as damage:
        return str(damage)


def tiles_of(path: Path) -> tuple[int, int]:
    """Rows and columns of a product's tiles, as it was begun."""
    rows, columns = _identity(path)["tile_shape"]
    return int(rows), int(columns)


def begun_tiles(path: Path) -> int:
    """How many tiles a product has, as it was begun."""
    return int(_identity(path)["tiles"])


def begin_copy(path: Path, source: Path, layers: tuple[str, ...], scene: Scene) -> CubeWriter:
    """Make of an empty folder a product of other layers of the same scene and tiles as `source`."""
    _make_folders(path, exist_ok=True)
    for name in layers:
        create_layer(path, name, scene, tiles_of(source))
    for name in (layout.SCENE, layout.PLAN, layout.BEGUN):
        shutil.copyfile(source / name, path / name)
    for table in (source / layout.TRUTH).glob("*.parquet"):
        shutil.copyfile(table, path / layout.TRUTH / table.name)
    drop_parts(path)
    return CubeWriter(str(path.resolve()), layers, tiles_of(source), scene.output.compression)


def _make_folders(path: Path, exist_ok: bool = False) -> None:
    try:
        path.mkdir(parents=True, exist_ok=exist_ok)
        for name in (layout.CUBE, layout.MARKERS, f"{layout.TRUTH}/{layout.PARTS}"):
            (path / name).mkdir(parents=True)
    except OSError as error:
        if error.errno in NO_ROOM:
            raise
        raise BadInput("-o", str(path), f"a path that can be written; {error.strerror}") from None


def _writer(path: Path, plan: Plan) -> CubeWriter:
    scene = plan.scene
    return CubeWriter(
        str(path.resolve()), layers_of(plan), tile_shape(scene), scene.output.compression
    )


def truth_kinds(plan: Plan) -> tuple[str, ...]:
    """The truth tables that a scene has."""
    kinds = (
        ("stars", plan.scene.stars is not None),
        ("targets", bool(plan.scene.targets)),
        ("cosmic_rays", plan.scene.cosmic_rays is not None),
    )
    return tuple(name for name, present in kinds if present)


def truth_parts(plan: Plan) -> Iterator[tuple[str, int]]:
    """Kind and frame of every part that its truth tables are joined from."""
    return ((kind, frame) for kind in truth_kinds(plan) for frame in range(plan.frames))


def scene_digest(plan: Plan) -> str:
    """SHA-256 of what decides the pixels: the scene, but for its tiles and what is kept of them."""
    scene = plan.scene.as_dict()
    scene["output"] = {"layers": scene["output"]["layers"]}
    return hashlib.sha256(json.dumps(scene, sort_keys=True).encode()).hexdigest()


def files_digest(data: JsonObject, digest: Callable[[Path], str] | None = None) -> str | None:
    """SHA-256 over the content of all files that plain data of a scene, or a study, still names;
    None without any. Its paths are absolute.

    Catalogues have digests of their own; of populations what was found in them counts. Tables of
    the user's data folder count, too, where there are any. digest : of a file; `file_digest`
    """
    digest = digest or file_digest
    files = (*named_files(data), *user_data_files())
    found = [(name, digest(file)) for name, file in files]
    return hashlib.sha256(json.dumps(found).encode()).hexdigest() if found else None


def named_files(
    data: JsonObject, known: tuple[str, ...] = CONTENT_KNOWN
) -> Iterator[tuple[str, Path]]:
    """Dotted field and file of all that plain data names, of a folder all its files; but for fields
    whose content is known."""
    for field_name, holder, key in path_holders(data):
        name = holder.get(key)
        if isinstance(name, str) and not field_name.startswith(known):
            path = Path(name)
            files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
            yield from ((field_name, file) for file in files if file.is_file())


def sensor_images(data: JsonObject) -> Iterator[tuple[str, Path]]:
    """Dotted field and file of the sensor's images in plain data of a scene."""
    return ((name, file) for name, file in named_files(data) if name.startswith(IMAGES))


def content_digest(path: Path) -> str:
    """SHA-256 over the checksums of all cells of all layers: the same for every tile shape."""
    return cells_digest(
        cell for m in map(read_marker, markers_present(path)) for cell in cells_of(m)
    )


def cells_of(marker: Marker) -> Iterator[Cell]:
    """Layer, frame, row, column and checksum of each cell of a tile."""
    for name, found in marker.cells.items():
        yield from ((name, marker.frame, *cell) for cell in found)


def cells_digest(cells: Iterable[Cell]) -> str:
    """SHA-256 over the checksums of cells."""
    return hashlib.sha256(json.dumps(sorted(cells)).encode()).hexdigest()


@dataclass
class Verdict:
    """What `check` found: `faults` name each damaged or missing thing."""

    path: str
    complete: bool
    tiles: int
    tiles_expected: int
    faults: list[str] = field(default_factory=list)

    @property
    def whole(self) -> bool:
        return self.complete and not self.faults


def check(path: Path, fault_of_tile: Callable[[Path, Path], str | None] | None = None) -> Verdict:
    """Verify a product: every tile has its marker, every chunk its checksum, every table reads.

    fault_of_tile : (product, marker's path) -> what is wrong, for chunks that lie elsewhere
    """
    fault_of_tile = fault_of_tile or _marker_fault
    if not (path / layout.BEGUN).is_file():
        raise layout.no_product(path)
    complete = (path / layout.COMPLETE).is_file()
    verdict = Verdict(str(path), complete, 0, int(_identity(path)["tiles"]))
    for marker in markers_present(path):
        fault = fault_of_tile(path, marker)
        verdict.tiles += fault is None
        if fault:
            verdict.faults.append(fault)
    if not complete:
        return verdict
    missing = verdict.tiles_expected - verdict.tiles - len(verdict.faults)
    if missing > 0:
        verdict.faults.append(f"{layout.MARKERS}: {missing} markers are missing")
    verdict.faults += finished_faults(path)
    return verdict


def is_sealed(begun: Begun, tiles: int) -> bool:
    """Whether a product taken up is complete: sealed, its `tiles` whole, and all sealed files."""
    sealed = (begun.path / layout.COMPLETE).is_file()
    return sealed and len(begun.done) == tiles and not finished_faults(begun.path)
