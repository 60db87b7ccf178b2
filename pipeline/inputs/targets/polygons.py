"""Faces of mesh files that a fan of triangles does not fill, and corners counted backwards."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Triangles = list[tuple[int, int, int]]
Span = tuple[int, int]

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
