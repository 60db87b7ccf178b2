"""Curves of point-source transmittance and maps of the Earth's albedo, from files; checked."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import BadInput
from pipeline.inputs.band.curves import resolve_response, solar_spectrum
from pipeline.inputs.npy import read_npy
from pipeline.physics.constants import DEG_RAD
from pipeline.physics.radiometry import band_photon_irradiance_sun
from pipeline.physics.sky.moon import band_rate
from pipeline.physics.sky.pst import Pst, PstHarvey, PstTable
from pipeline.plan.sky.stray_light import StrayInputs
from pipeline.spec.scene import Scene
from pipeline.spec.sky.stray_light import StrayLight, TablePst

Array = NDArray[np.float64]

PST, ALBEDO = "background.stray_light.pst.path", "background.stray_light.earth_albedo"
LARGEST_BYTES = 16_000_000
REACHES_SIDE_DEG = 90.0  # a table that goes this far need say no more


def gather_stray_light(scene: Scene, request: StrayLight) -> StrayInputs:
    """Read the curve and the map that a scene names, and what the Sun and the Moon send in band.

    Raises BadInput for a table with a value that is not a number or out of range, with angles that
    do not ascend, or a map with holes.
    """
    s = scene.sensor
    pst: Pst
    through = True
    if isinstance(request.pst, TablePst):
        angle, value = read_pst(Path(request.pst.path))
        reaches = angle[-1] >= REACHES_SIDE_DEG
        beyond: Literal["refuse", "zero", "clip"] = request.pst.beyond or (
            "zero" if reaches else "refuse"
        )
        nearest = max(angle[0], request.exclusion_deg or 0.0)  # nearer, nothing was measured
        pst = PstTable(angle * DEG_RAD, value, nearest * DEG_RAD, request.inside, beyond)
        through = not request.pst.holds_transmission
    else:
        h = request.pst
        pst = PstHarvey(
            h.b0_per_sr,
            h.shoulder,
            h.slope,
            h.mirrors,
            s.focal_length_m / s.aperture_m,
            (request.exclusion_deg or 0.0) * DEG_RAD,
            request.inside,
        )
    transmission = s.transmission if through else 1.0
    response, _, _ = resolve_response(s.bandpass.model_dump(), transmission, s.quantum_efficiency)
    wavelength, irradiance, _, _ = solar_spectrum()
    albedo = (
        np.array([[request.earth_albedo]])
        if isinstance(request.earth_albedo, float)
        else (read_albedo(Path(request.earth_albedo)))
    )
    return StrayInputs(
        pst,
        band_photon_irradiance_sun(wavelength, irradiance, response),
        band_rate(wavelength, irradiance, response),
        albedo,
    )


def read_pst(path: Path) -> tuple[Array, Array]:
    """Angles [deg] and PST (n,) of a CSV table: angle_deg, pst; a heading and # comments may be."""
    rows = _rows(path, PST)
    numbers = [_numbers(row, PST) for row in rows]
    if len(numbers) < 2 or any(len(row) != 2 for row in numbers):
        raise BadInput(PST, str(path), "at least two rows of two numbers: angle_deg, pst")
    table = np.array(numbers)
    angle, value = table.T
    wrong = np.flatnonzero(~np.isfinite(table).all(axis=1) | (angle <= 0) | (angle > 180))
    if len(wrong):
        k = int(wrong[0])
        raise BadInput(PST, _told(k, angle, value), "angles above 0 and up to 180 degrees, no gaps")
    back = np.flatnonzero(np.diff(angle) <= 0.0)
    if len(back):
        k = int(back[0]) + 1
        allowed = f"ascending angles, each once; the row before has {angle[k - 1]:g}"
        raise BadInput(PST, _told(k, angle, value), allowed)
    wrong = np.flatnonzero((value <= 0.0) | (value > 1e6))
    if len(wrong):
        k = int(wrong[0])
        raise BadInput(
            PST,
            _told(k, angle, value),
            "values above 0: irradiance on the focal plane over that on the pupil",
        )
    return angle, value


def read_albedo(path: Path) -> Array:
    """A map (rows, columns) of the Earth's albedo from CSV or NPY, as `physics.sky.earth_disc`."""
    table = _npy(path) if path.suffix == ".npy" else _csv(path)
    if table.ndim != 2 or min(table.shape) < 2 or table.size > 4_000_000:
        raise BadInput(ALBEDO, str(path), "2 x 2 to 4 million cells: latitudes x longitudes")
    wrong = np.argwhere(~((table >= 0.0) & (table <= 1.0)))
    if len(wrong):
        row, column = wrong[0]
        raise BadInput(
            ALBEDO,
            f"{table[row, column]:g} in row {row + 1}, column {column + 1}",
            "a fraction from 0 to 1 in every cell",
        )
    return table


def _npy(path: Path) -> Array:
    try:
        table = read_npy(path)
    except (OSError, ValueError) as error:
        raise BadInput(ALBEDO, str(path), f"a readable NPY file; {error}") from None
    if table.ndim != 2 or table.dtype.kind not in "fiu":
        raise BadInput(ALBEDO, str(path), "a two-dimensional array of numbers")
    return np.asarray(table, np.float64)


def _csv(path: Path) -> Array:
    rows = [_numbers(row, ALBEDO) for row in _rows(path, ALBEDO, heading=False)]
    if len({len(row) for row in rows}) > 1:
        raise BadInput(ALBEDO, str(path), "rows of equal length")
    return np.array(rows, np.float64)


def _rows(path: Path, field: str, heading: bool = True) -> list[list[str]]:
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise BadInput(field, str(path), f"a table of at most {LARGEST_BYTES} bytes")
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        rows = [r for r in csv.reader(li for li in lines if li.strip()) if r[0].lstrip()[:1] != "#"]
    except (OSError, ValueError, csv.Error) as error:
        raise BadInput(field, str(path), "a readable text file") from error
    if heading and rows and not _is_number(rows[0][0]):
        rows = rows[1:]
    if not rows:
        raise BadInput(field, str(path), "a table with rows of numbers")
    return rows


def _numbers(row: list[str], field: str) -> list[float]:
    if not all(map(_is_number, row)):
        raise BadInput(field, ",".join(row), "a number in every place of a row: no gaps")
    return [float(cell) for cell in row]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _told(k: int, angle: Array, value: Array) -> str:
    return f"{angle[k]:g}, {value[k]:g} (row {k + 1})"
