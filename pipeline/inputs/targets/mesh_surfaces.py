"""The surfaces that a mesh's materials stand for: BRDFs with their numbers, tables read."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.inputs.npy import read_npy
from pipeline.physics.constants import SUN_RADIUS_RAD
from pipeline.physics.meshes import brdf
from pipeline.physics.meshes.brdf_table import BrdfTable, brdf_table, sun_rings
from pipeline.physics.meshes.intensity import Brdf, FacetSurface
from pipeline.spec.targets.mesh import (
    AshikhminShirleySurface,
    CookTorranceSurface,
    LambertSurface,
    Meshed,
    PhongSurface,
    Reflecting,
    TableSurface,
)

Array = NDArray[np.float64]

COLUMNS = ("theta_i_deg", "theta_o_deg", "phi_deg", "brdf_per_sr")
LARGEST_TABLE_BYTES = 100_000_000
# Sharper highlights than these are drawn with the Sun as a disc of 0.53 degrees: below, it changes
# their peak by less than 1%
SHARP_EXPONENT, SHARP_ROUGHNESS, SUN_RINGS = 400.0, 0.05, 3
MOST_RINGS = 64  # for a table, whose peaks are tried
RINGS_A_HIGHLIGHT = 2.0 * SUN_RADIUS_RAD  # two of the disc within each highlight's width [rad]
ASYMMETRY = 0.05  # more than measured tables have by their error


class Palette:
    """The surfaces of one body, each once; grows while its parts are put together.

    notices : what their tables have to say
    """

    def __init__(self) -> None:
        self.notices: list[str] = []
        self._made: dict[str, int] = {}
        self._surfaces: list[FacetSurface] = []
        self._digest = hashlib.sha256()

    @property
    def surfaces(self) -> tuple[FacetSurface, ...]:
        return tuple(self._surfaces)

    @property
    def digest(self) -> str:
        return self._digest.hexdigest()

    def number(self, material: str, owners: tuple[Meshed, ...], field: str) -> int | None:
        """The surface of a material: the first owner's that has one, by name, then for all."""
        for owner in owners:
            request = owner.materials.get(material, owner.surface)
            if request is not None:
                break
        else:
            return None
        key = request.model_dump_json()
        if key not in self._made:
            where = f"{field}.materials.{material}" if material else f"{field}.surface"
            surface, content = make_surface(request, where)
            self._made[key] = len(self._surfaces)
            self._surfaces.append(surface)
            if isinstance(request, TableSurface) and isinstance(surface.brdf, BrdfTable):
                self.notices += _doubts(surface.brdf, surface.sun_rings, Path(request.path).name)
            self._digest.update(_told(request).encode() + content)
        return self._made[key]


def _doubts(table: BrdfTable, rings: int, name: str) -> list[str]:
    """What is said of a table that ends early, is not reciprocal, or as fine as the Sun's rings."""
    axes = {"theta_i": table.theta_i_rad, "theta_o": table.theta_o_rad, "phi": table.phi_rad}
    ends = {key: float(np.rad2deg(axis[-1])) for key, axis in axes.items()}
    short = [
        f"{k} {end:.4g}" for k, end in ends.items() if end < (180 if k == "phi" else 90) - 1e-6
    ]
    told = []
    if short:
        told += [f"{name}: its BRDF ends at {', '.join(short)} deg: beyond, the value there holds"]
    if table.asymmetry > ASYMMETRY:
        told += [
            f"{name}: its BRDF differs by up to {table.asymmetry:.2g} of its largest value where "
            "Sun and observer change places; no surface does so, and the mean of both is drawn"
        ]
    if rings == MOST_RINGS:
        told += [
            f"{name}: its BRDF has highlights as fine as the {rings} rings that stand for the "
            "Sun's disc: their light may be off by more than 1%"
        ]
    return told


def _told(request: Reflecting) -> str:
    """All that is said of a surface, but not the folder that its table lies in."""
    if isinstance(request, TableSurface):
        request = request.model_copy(update={"path": Path(request.path).name})
    return request.model_dump_json()


def make_surface(request: Reflecting, field: str = "surface") -> tuple[FacetSurface, bytes]:
    """The surface that a scene describes, and the bytes of the file it was read from, if any."""
    if isinstance(request, TableSurface):
        table, raw = read_brdf_table(Path(request.path), request.scale, field)
        rings = sun_rings(table, SUN_RADIUS_RAD, SUN_RINGS, MOST_RINGS)
        return FacetSurface(table, request.two_sided, rings), raw
    given, sharp = FORMULAS[type(request)](request)
    rings = max(SUN_RINGS, math.ceil(RINGS_A_HIGHLIGHT / request.highlight_rad)) if sharp else 0
    return FacetSurface(given, request.two_sided, rings), b""


def _lambert(request: LambertSurface) -> tuple[Brdf, bool]:
    return partial(brdf.lambert, albedo=request.albedo), False


def _phong(request: PhongSurface) -> tuple[Brdf, bool]:
    given = partial(
        brdf.phong, diffuse=request.diffuse, specular=request.specular, exponent=request.exponent
    )
    return given, bool(request.specular) and request.exponent > SHARP_EXPONENT


def _cook_torrance(request: CookTorranceSurface) -> tuple[Brdf, bool]:
    index = None if request.refractive_index is None else complex(*request.refractive_index)
    given = partial(
        brdf.cook_torrance,
        diffuse=request.diffuse,
        roughness=request.roughness,
        index=index,
        normal_reflectance=request.normal_reflectance or 0.0,
    )
    return given, request.roughness < SHARP_ROUGHNESS


def _ashikhmin_shirley(request: AshikhminShirleySurface) -> tuple[Brdf, bool]:
    across = request.exponent_u if request.exponent_v is None else request.exponent_v
    given = partial(
        brdf.ashikhmin_shirley,
        diffuse=request.diffuse,
        specular=request.specular,
        exponent_u=request.exponent_u,
        exponent_v=across,
        grain=np.array(request.grain),
    )
    sharp = max(request.exponent_u, across) > 0.25 * SHARP_EXPONENT
    return given, sharp and bool(request.specular)


# By kind of surface: its reflectance, and whether its highlight is as sharp as the Sun's disc.
FORMULAS: dict[type, Callable[..., tuple[Brdf, bool]]] = {
    LambertSurface: _lambert,
    PhongSurface: _phong,
    CookTorranceSurface: _cook_torrance,
    AshikhminShirleySurface: _ashikhmin_shirley,
}


def read_brdf_table(
    path: Path, scale: float = 1.0, field: str = "surface"
) -> tuple[BrdfTable, bytes]:
    """A measured BRDF from CSV or NPY: rows of theta_i, theta_o, phi [deg] and BRDF [1/sr].

    BadInput where the file is missing or too large, a column is missing, a value is no number, or
    the rows are not one for each point of a grid.
    """
    name = f"{field}.path"
    raw, rows = _brdf_rows(path, name)
    axes, places = zip(*(np.unique(c, return_inverse=True) for c in rows.T[:3]), strict=True)
    shape = tuple(a.size for a in axes)
    whole = 0 < math.prod(shape) == len(rows)  # before the grid is made
    if not whole or np.unique(np.ravel_multi_index(places, shape)).size < len(rows):
        allowed = f"one row for each point of the grid of {shape[0]} x {shape[1]} x {shape[2]}"
        raise BadInput(name, f"{path.name} of {len(rows)} rows", allowed)
    values = np.empty(shape)
    values[places] = rows[:, 3] * scale
    theta_i, theta_o, phi = (np.deg2rad(a) for a in axes)
    return brdf_table(theta_i, theta_o, phi, values, field), raw


def _brdf_rows(path: Path, name: str) -> tuple[bytes, Array]:
    """The bytes of a table's file, and its rows (n, 4) of finite numbers."""
    if not path.is_file() or path.suffix.lower() not in (".csv", ".npy"):
        raise BadInput(name, str(path), "an existing .csv or .npy file")
    if path.stat().st_size > LARGEST_TABLE_BYTES:
        raise BadInput(name, path.name, f"a file of at most {LARGEST_TABLE_BYTES} bytes")
    raw = path.read_bytes()
    rows = _npy(path, name) if path.suffix.lower() == ".npy" else _csv(raw, path.name, name)
    if rows.ndim != 2 or rows.shape[1] != 4 or not np.all(np.isfinite(rows)):
        raise BadInput(name, path.name, f"rows of 4 finite numbers: {', '.join(COLUMNS)}")
    return raw, rows


def _npy(path: Path, field: str) -> Array:
    try:
        return np.asarray(read_npy(path), float)
    except (ValueError, OSError, TypeError):
        raise BadInput(field, path.name, "an NPY file of numbers") from None


def _cells(text: str) -> list[list[str]]:
    """The rows of a table, without remarks and blank lines."""
    lines = (line for line in text.splitlines() if line.strip())
    return list(csv.reader(line for line in lines if not line.lstrip().startswith("#")))


def _csv(raw: bytes, name: str, field: str) -> Array:
    try:
        heads, *rows = _cells(raw.decode("utf-8-sig", "replace")) or [[]]
    except csv.Error as error:
        raise BadInput(field, name, f"a readable table; {error}") from None
    heads = [head.strip() for head in heads]
    if any(heads.count(c) != 1 for c in COLUMNS):
        raise BadInput(field, name, f"a first line with the columns {', '.join(COLUMNS)}")
    try:
        table = np.array(rows, float)
        return table[:, [heads.index(c) for c in COLUMNS]]
    except (ValueError, IndexError):
        raise BadInput(field, name, "rows of numbers under each column") from None
