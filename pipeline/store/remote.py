"""A product on an object store: chunks, markers and truth put by the tasks that make them.

The small files are made in a folder of this machine by the same code as elsewhere, and copied. The
record of the beginning is put after the metadata, _COMPLETE after all else; nothing is renamed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from catalog_tools.storage.objects import Listed, Objects
from catalog_tools.storage.stores import Unreachable
from pipeline.errors import BadInput, Damaged
from pipeline.plan.plan import Plan
from pipeline.store import layout
from pipeline.store.cube import CubeWriter
from pipeline.store.markers import (
    Marker,
    fault_of,
    marker_content,
    marker_path,
    place_of,
    read_marker,
)
from pipeline.store.product import (
    Begun,
    Verdict,
    begin,
    check,
    check_same,
    identity_in,
    identity_of,
    truth_parts,
)
from pipeline.store.seal import has_marker
from pipeline.store.truth import is_whole, part_content, part_path

if TYPE_CHECKING:
    import pyarrow as pa

AT_ONCE = 8  # chunks that are read together, to be proved
HERE = Path()


@dataclass(frozen=True)
class RemoteWriter(CubeWriter):
    """Stores tiles as objects below the URL `product`."""

    def write_chunk(self, relative: str, content: bytes) -> None:
        Objects(self.product).put(f"{layout.CUBE}/{relative}", content)

    def write_marker(self, marker: Marker) -> None:
        place = _marker_name(marker.frame, marker.row, marker.column)
        Objects(self.product).put(place, marker_content(marker))

    def write_truth(self, kind: str, frame: int, table: pa.Table) -> None:
        Objects(self.product).put(_part_name(kind, frame), part_content(table))


def begin_remote(
    objects: Objects,
    stage: Path,
    plan: Plan,
    catalogue_digest: str | None,
    resume: bool | None,
    mine: Callable[[int, int, int], bool] | None = None,
) -> Begun:
    """Make a new product of objects, or take up an unfinished one.

    stage : a folder that is not there yet, for the product's small files
    resume : None where either is right (parts); mine : which tiles are this writer's
    Raises BadInput as `begin` does.
    """
    there = check_free_remote(objects, resume)
    staged = begin(stage, plan, catalogue_digest, resume=False).writer
    writer = RemoteWriter(objects.url, staged.layers, staged.chunk, staged.compression)
    if layout.BEGUN not in there:
        if there and resume is None:
            raise BadInput("-o", objects.url, "a place where nothing is yet")
        made = dict(_files_in(stage))
        left = [n for n in objects.names() if not n.startswith(layout.LOCK)]
        if _is_bare_beginning(left):  # it may be of another scene's layers
            objects.delete(set(left) - set(made))
        for name, content in made.items():
            if name != layout.BEGUN:
                objects.put(name, content)
        objects.create(layout.BEGUN, (stage / layout.BEGUN).read_bytes())
    found = identity_in(objects.get(layout.BEGUN) or b"", f"{objects.url}/{layout.BEGUN}")
    check_same(objects.url, found, identity_of(plan, catalogue_digest))
    done, faults = _done(objects, there, mine or (lambda *_: True))
    truth = _truth_done(objects, plan, there)
    return Begun(stage, writer, frozenset(done), frozenset(truth), tuple(faults))


def check_free_remote(objects: Objects, resume: bool | None) -> dict[str, Listed]:
    """What lies there of a product: nothing for a new one, and its beginning to take one up.

    What was cut off before it was begun counts as nothing. Raises BadInput as `begin` does.
    """
    there = {n: o for n, o in objects.names().items() if not n.startswith(layout.LOCK)}
    bare = layout.BEGUN not in there and _is_bare_beginning(there)
    if bare:
        there = {}
    if there and resume is False:
        allowed = "a place where nothing is yet; or give --resume or --replace"
        raise BadInput("-o", objects.url, allowed)
    if resume and layout.BEGUN not in there and not bare:
        raise BadInput("--resume", objects.url, "a product begun by `nightglass render`")
    return there


def _is_bare_beginning(names: Collection[str]) -> bool:
    """Whether something is there, and all of it is what a beginning puts before its record."""
    return bool(names) and all(n == layout.SCENE or n.endswith("/zarr.json") for n in names)


def _done(
    objects: Objects, there: dict[str, Listed], mine: Callable[[int, int, int], bool]
) -> tuple[set[tuple[int, int, int]], list[str]]:
    """Tiles that are whole, and what is wrong with the others; those markers are removed."""
    markers = [n for n in there if n.startswith(f"{layout.MARKERS}/")]
    markers = [n for n in markers if mine(*place_of(HERE / n))]
    done, faults = set(), []
    for name, fault in _judged(objects, dict(objects.get_many(markers))):
        if fault is None:
            done.add(place_of(HERE / name))
        else:
            faults.append(fault)
            objects.delete([name])
    return done, faults


def _judged(objects: Objects, markers: dict[str, bytes]) -> Iterator[tuple[str, str | None]]:
    """Names of markers, and what is wrong with each or its chunks; a few are read at a time."""

    def judge(content: tuple[str, bytes]) -> str | None:
        try:
            marker = read_marker(*content)
        except Damaged as damage:
            return str(damage)
        return fault_of(objects.get, marker)

    with ThreadPoolExecutor(AT_ONCE) as pool:
        yield from zip(markers, pool.map(judge, markers.items()), strict=True)


def _truth_done(objects: Objects, plan: Plan, there: dict[str, Listed]) -> set[tuple[str, int]]:
    names = {_part_name(*part): part for part in truth_parts(plan)}
    parts = objects.get_many(name for name in names if name in there)
    return {names[name] for name, content in parts if is_whole(content)}


def bring(objects: Objects, stage: Path, chunks_of: int | None = 0) -> None:
    """Copy a product's objects into a folder; of the chunks only those of one frame, or none.

    Raises Damaged for a name that would lie outside of the folder.
    """
    names = [n for n in objects.names() if not n.startswith(layout.LOCK)]
    for name in names:
        if {"", ".", ".."} & set(name.split("/")):
            raise Damaged(objects.url, f"an object has a name that no product has: {name!r}")
    wanted = [n for n in names if not has_marker(n) or n.split("/")[3] == str(chunks_of)]
    for name, content in objects.get_many(wanted):
        path = stage / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def publish(objects: Objects, stage: Path) -> None:
    """Put all that finishing a product made, its seal last; then remove the parts of truth."""
    last = layout.SEALS[::-1]
    for name, content in _files_in(stage):
        if name not in last and not has_marker(name) and not name.startswith(layout.MARKERS):
            objects.put(name, content)
    for name in last:
        objects.put(name, (stage / name).read_bytes())
    objects.delete(objects.names(f"{layout.TRUTH}/{layout.PARTS}/"))


def unseal_remote(objects: Objects) -> None:
    """An earlier seal no longer holds once anything is drawn again."""
    objects.delete(name for name in layout.SEALS if objects.names(name))


def remove_remote(objects: Objects) -> None:
    """Remove an old product (only a product), its seal and record last."""
    names = [n for n in objects.names() if not n.startswith(layout.LOCK)]
    if names and layout.BEGUN not in names and not _is_bare_beginning(names):
        raise BadInput("--replace", objects.url, "a product made by `nightglass render`")
    objects.delete(name for name in layout.SEALS if name in names)
    objects.delete(name for name in names if name not in (*layout.SEALS, layout.BEGUN))
    objects.delete(name for name in names if name == layout.BEGUN)


def check_remote(objects: Objects, stage: Path) -> Verdict:
    """Verify a product of objects, every chunk by its marker. stage : an empty folder."""
    if objects.get(layout.BEGUN) is None:
        raise BadInput("PRODUCT", objects.url, "a product made by `nightglass render`")
    bring(objects, stage, None)
    markers = {
        f"{layout.MARKERS}/{path.name}": path.read_bytes()
        for path in (stage / layout.MARKERS).glob("*.json")
    }
    found = dict(_judged(objects, markers))
    verdict = check(stage, lambda _, path: found[f"{layout.MARKERS}/{path.name}"])
    verdict.path = objects.url
    return verdict


def reached(objects: Objects, field_name: str) -> None:
    """Raise BadInput for a place that can't be asked."""
    try:
        objects.names(layout.BEGUN)
    except Unreachable as error:
        raise BadInput(field_name, objects.url, f"a place that can be reached ({error})") from None


def _files_in(stage: Path) -> Iterator[tuple[str, bytes]]:
    for path in sorted(stage.rglob("*")):
        if path.is_file() and not path.name.startswith(layout.LOCK):
            yield path.relative_to(stage).as_posix(), path.read_bytes()


def _marker_name(frame: int, row: int, column: int) -> str:
    return marker_path(HERE, frame, row, column).as_posix()


def _part_name(kind: str, frame: int) -> str:
    return part_path(HERE, kind, frame).as_posix()
