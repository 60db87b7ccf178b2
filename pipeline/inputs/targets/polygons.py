"""Faces of mesh files that readers take for others: that fold, are counted backwards, or differ."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Triangles = list[tuple[int, int, int]]
Span = tuple[int, int]

# A name, the type of how many values it has where it is a list, and that of its values.
PlyField = tuple[str, np.dtype[np.generic] | None, np.dtype[np.generic]]

HEADER_BYTES = 1 << 16
MOST_ROWS = 2_000_000  # of lists in a PLY, which are read one by one
PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
CORNERS = ("vertex_index", "vertex_indices")
CROSSED = "a face that crosses itself"
MOST_CORNERS = 1000  # of a face that folds: the time to cut it grows faster than their square
START = re.compile(rb"(?m)^[ \t]*(v[nt]?|f|o|g|usemtl)[ \t]+")
REMARK = re.compile(rb"(?m)^((?:v[nt]?|f) [^\r\n#]*)#[^\r\n]*")
BOM = b"\xef\xbb\xbf"  # before the text, as editors of some systems write it
LINE = re.compile(rb"(?m)^(v|f) ([^\r\n]*)")
MOST_CUTTING = 10**10  # sum of the cubes of corners of faces that fold: a minute or a few
TOUCHING = 1e-12  # of a polygon's size, squared: a corner on an ear's side, an ear without area
FOLDED = 1e-6  # of its largest triangle's area: what one of a fan may have on the wrong side


def plain_faces(raw: bytes) -> bytes:
    """An OBJ whose faces count corners from the file's first one and are filled by their fans.

    Readers take a fan from a polygon's first corner, which leaves a polygon that is not convex, and
    count corners that are given backwards from the end of the file; they pass over lines that begin
    with blanks or have a tab after their first word. ValueError for a corner 0.
    """
    raw = re.sub(rb"\\\r?\n", b" ", raw.removeprefix(BOM))
    raw = REMARK.sub(rb"\1", START.sub(rb"\1 ", raw))
    points, faces, backwards = [], [], []
    for line in LINE.finditer(raw):
        kind, text = line.groups()
        if kind == b"v":
            points.append(text.split()[:3])
            continue
        corners = _corners(text, len(points))
        if len(corners) > 3:
            faces.append((line.span(), corners))
        if b"-" in text:
            backwards.append((line.span(), corners))
    written = {span: [tuple(corners)] for span, corners in backwards}
    written |= _cut_faces(np.array(points, "S").astype(float), faces) if faces else {}
    out, last = [], 0
    for (start, stop), some in sorted(written.items()):
        text = b"\n".join(b"f " + b" ".join(b"%d" % (i + 1) for i in one) for one in some)
        out += [raw[last:start], text]
        last = stop
    return b"".join([*out, raw[last:]])


def text_ply(raw: bytes) -> bytes | None:
    """A PLY in binary as text, its points and faces alone; None for any other file.

    Readers take each list of corners to be as long as the first. ValueError where it ends early.
    """
    head = re.match(rb"ply\r?\n.*?\nend_header\r?\n", raw[:HEADER_BYTES], re.S)
    if head is None or b"format binary" not in head[0]:
        return None
    order = "<" if b"format binary_little" in head[0] else ">"
    at, read = head.end(), dict[str, np.ndarray]()
    for name, rows, fields in _ply_elements(head[0].decode("latin-1"), order):
        read[name], at = _ply_rows(raw, at, rows, fields)
    points = np.stack([read["vertex"][axis] for axis in "xyz"], axis=1)
    return _ply_text(points.astype(float), read["face"])


def _ply_text(points: Array, faces: np.ndarray) -> bytes:
    lines = [" ".join(map(repr, point)) for point in points.tolist()]
    lines += [" ".join(map(str, [len(face), *face.tolist()])) for face in faces]
    axes = "".join(f"property double {a}\n" for a in "xyz")
    return (
        f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{axes}element face {len(faces)}\n"
        "property list int int vertex_indices\nend_header\n" + "\n".join(lines) + "\n"
    ).encode()


def _ply_elements(head: str, order: str) -> list[tuple[str, int, list[PlyField]]]:
    """Elements by name, how many rows they have, and their fields."""
    out: list[tuple[str, int, list[PlyField]]] = []
    for words in map(str.split, head.splitlines()):
        if words[:1] == ["element"]:
            out.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            kinds = [np.dtype(order + PLY_TYPES[kind]) for kind in words[1:-1] if kind != "list"]
            out[-1][2].append((words[-1], kinds[0] if len(kinds) > 1 else None, kinds[-1]))
    return out


def _ply_rows(raw: bytes, at: int, rows: int, fields: list[PlyField]) -> tuple[np.ndarray, int]:
    """An element's rows (n,), by field or, of one with lists, their corners; where the next begins.

    ValueError for too many that have lists.
    """
    if all(count is None for _, count, _ in fields):
        plain = np.frombuffer(raw, [(name, kind) for name, _, kind in fields], rows, at)
        return plain, at + plain.nbytes
    if rows > MOST_ROWS:
        raise ValueError(f"{rows} rows of lists (at most {MOST_ROWS})")
    out = np.empty(rows, object)
    for k in range(rows):
        out[k], at = _ply_row(raw, at, fields)
    return out, at


def _ply_row(raw: bytes, at: int, fields: list[PlyField]) -> tuple[NDArray[np.int64], int]:
    """The corners that a row with lists holds (k,), and where the next begins."""
    corners = np.empty(0, np.int64)
    for name, count, kind in fields:
        many = 1
        if count is not None:
            many = max(int(np.frombuffer(raw, count, 1, at)[0]), 0)
            at += count.itemsize
        values = np.frombuffer(raw, kind, many, at)
        at += values.nbytes
        if name in CORNERS:
            corners = values.astype(np.int64)
    return corners, at


def _corners(text: bytes, so_far: int) -> list[int]:
    """Places of a face's corners from 0; those below 0 count back from the last point so far."""
    given = [int(corner.partition(b"/")[0]) for corner in text.split()]
    for i in given:
        if i == 0 or i < -so_far:
            raise ValueError(f"a face's corner {i}: they count from 1, or back from -1")
    return [i - 1 if i > 0 else so_far + i for i in given]


def _cut_faces(
    points: Array, faces: Sequence[tuple[Span, list[int]]]
) -> dict[Span, list[tuple[int, ...]]]:
    """Triangles of the faces (by where they stand) that their fans do not fill."""
    out = {}
    for k in _folding(points, [corners for _, corners in faces]):
        span, places = faces[k]
        out[span] = [tuple(places[i] for i in each) for each in cut(points[places])]
    return out


def filled(points: Array, polygons: Sequence[Sequence[int]]) -> NDArray[np.int64] | None:
    """Triangles (n, 3) of polygons, by places in `points`; None where fans fill them all."""
    if not _folding(points, polygons):
        return None
    many = [np.asarray(p, np.int64) for p in polygons if len(p) > 2]
    return np.concatenate([p[np.array(cut(points[p]))] for p in many])


def _folding(points: Array, polygons: Sequence[Sequence[int]]) -> list[int]:
    """Which polygons, by places in `points`, their fans do not fill; ValueError for too many."""
    alike = defaultdict(list)
    for k, polygon in enumerate(polygons):
        alike[len(polygon)].append(k)
    out: list[int] = []
    for corners, some in alike.items():
        if corners > 3:
            each = points[np.array([polygons[k] for k in some])]
            out += [some[i] for i in np.flatnonzero(folds(each))]
    if sum(len(polygons[k]) ** 3 for k in out) > MOST_CUTTING:
        raise ValueError(f"{len(out)} faces that fold, of so many corners: cut them first")
    return out


def folds(corners: Array) -> NDArray[np.bool_]:
    """Whether fans from the first corner of polygons (n, k, 3) leave them."""
    legs = corners[:, 1:] - corners[:, :1]
    each = np.cross(legs[:, :-1], legs[:, 1:])
    size = np.sum(each * each, axis=-1)
    most = np.take_along_axis(each, np.argmax(size, axis=1)[:, None, None], axis=1)
    return np.asarray(np.sum(each * most, axis=-1).min(axis=-1) < -FOLDED * size.max(axis=-1))


def cut(corners: Array) -> Triangles:
    """Triangles that fill a flat polygon (k, 3), by places: its fan, or ears cut off one by one
    (Meisters 1975, Amer. Math. Monthly 82, 648). ValueError where it crosses itself."""
    fan = [(0, i, i + 1) for i in range(1, len(corners) - 1)]
    if not folds(corners[None])[0]:
        return fan
    if len(corners) > MOST_CORNERS:
        raise ValueError(f"a face that folds, of {len(corners)} corners (at most {MOST_CORNERS})")
    legs = corners[1:] - corners[0]
    normal = np.cross(legs[:-1], legs[1:]).sum(axis=0)
    if not normal.any():
        raise ValueError(CROSSED)
    x = corners[int(np.argmax(np.sum(legs * legs, axis=-1))) + 1] - corners[0]
    x = x - (x @ normal) / (normal @ normal) * normal
    flat = legs @ x + 1j * (legs @ np.cross(normal, x)) / np.sqrt(normal @ normal)
    flat = np.concatenate([[0.0], flat / (x @ x)])
    left = list(range(len(flat)))
    out: Triangles = []
    while len(left) > 2:
        for j in range(len(left)):
            ear = (left[j - 1], left[j], left[(j + 1) % len(left)])
            if _is_ear(flat[list(ear)], flat[left]):
                break
        else:
            raise ValueError(CROSSED)
        out.append(ear)
        del left[j]
    return out


def _is_ear(ear: NDArray[np.complex128], others: NDArray[np.complex128]) -> bool:
    """Whether a triangle of neighbours turns the polygon's way and holds no other corner."""

    def turn(k: int, to: NDArray[np.complex128]) -> Array:
        return np.asarray(np.imag(np.conj(ear[(k + 1) % 3] - ear[k]) * (to - ear[k])))

    area = float(turn(0, ear[2:])[0])
    if abs(area) <= TOUCHING:
        return True  # no area: the polygon is the same without it
    held = np.all([turn(k, others) >= -TOUCHING for k in range(3)], axis=0)
    return area > 0.0 and not bool(np.any(held & ~np.isin(others, ear)))
