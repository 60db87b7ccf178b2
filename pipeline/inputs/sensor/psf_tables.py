"""Tables of point-spread functions: FITS and NPY images, listings of optical design programs.

Listings that are understood, by their own headings:
- OpticStudio (Zemax) "Listing of FFT PSF Data" and "Listing of Huygens PSF Data": `Data spacing
  is`, `Image grid size: nx by ny`, `Center point is: row r, column c` (or `r, c`; counted from 1),
  then rows of numbers after the line `Values are ...`; UTF-16, UTF-8 or Latin-1.
- CODE V interferogram grid (.int): `!` comments, a title, `GRD nx ny FIL WVL w [NNR] SSZ s [NDA n]
  [XSC x]`, then nx * ny whole numbers row by row. It holds no spacing: the scene gives it.
Rows go to the detector as they are listed: the first one is the row of the smallest y.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import Array
from pipeline.errors import BadInput
from pipeline.inputs.sensor.images import read_image
from pipeline.physics.psf.sampled import LARGEST_SIDE, Sampled, find_centre, sampled
from pipeline.spec.scene import Scene
from pipeline.spec.sensor.sensor import FieldPsf, TablePsf

FIELD = "sensor.psf.path"
LARGEST_BYTES = 200_000_000
IMAGES = (".npy", ".fits", ".fit", ".fits.gz")
UM = {
    "nm": 1e-3,
    "um": 1.0,
    "µm": 1.0,
    "μm": 1.0,
    "micron": 1.0,
    "microns": 1.0,
    "micrometers": 1.0,
    "mm": 1e3,
    "millimeters": 1e3,
    "cm": 1e4,
    "m": 1e6,
}
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[Ee][-+]?\d+)?"


@dataclass(frozen=True)
class PsfTable:
    """A table as a file holds it.

    samples : (ny, nx) light per area in any unit, rows by increasing y
    spacing_um : between samples, where the file says so
    centre : (row, column) of the reference point from 0, where the file says so
    """

    samples: Array
    spacing_um: float | None = None
    centre: tuple[float, float] | None = None


def gather_psf_table(scene: Scene) -> Sampled | tuple[Sampled | None, ...] | None:
    """The point-spread function of a scene that names a table; None where it names none.

    Of a field, one for each place, row by row; each file is read once. BadInput where a file cannot
    be read, or says or leaves open what the scene must not or must give: the spacing of the
    samples, and where in an even table the source stands.
    """
    psf, pitch_um = scene.sensor.psf, scene.sensor.pixel_pitch_um
    if isinstance(psf, TablePsf):
        return _gather(psf, pitch_um)
    if not isinstance(psf, FieldPsf):
        return None
    every = scene.sensor.every_psf
    read: dict[TablePsf, Sampled] = {}
    for node, one in enumerate(every):
        if isinstance(one, TablePsf) and one not in read:
            try:
                read[one] = _gather(one, pitch_um)
            except BadInput as error:
                name = psf.name_of(error.field, node)
                raise BadInput(name, error.value, error.allowed) from None
    return tuple(read[one] if isinstance(one, TablePsf) else None for one in every)


def _gather(psf: TablePsf, pitch_um: float) -> Sampled:
    """One table, ready for use."""
    table = read_psf_table(Path(psf.path))
    samples, (row, column) = table.samples, _centre(psf, table)
    if psf.flip_y:
        samples, row = samples[::-1], samples.shape[0] - 1 - row
    spacing_px = _spacing_px(psf, table, pitch_um)
    return sampled(samples, spacing_px, (row, column), psf.light_fraction)


def _spacing_px(psf: TablePsf, table: PsfTable, pitch_um: float) -> float:
    """Pixels between samples, from the file or the scene."""
    given = psf.sample_um if psf.samples_per_px is None else pitch_um / psf.samples_per_px
    if table.spacing_um is not None:
        if given is not None:
            name = "sample_um" if psf.samples_per_px is None else "samples_per_px"
            allowed = f"nothing: {Path(psf.path).name} says {table.spacing_um:g} um itself"
            raise BadInput(f"sensor.psf.{name}", f"{getattr(psf, name):g}", allowed)
        given = table.spacing_um
    if given is None:
        allowed = "sample_um or samples_per_px: the file does not say how far its samples are apart"
        raise BadInput("sensor.psf", Path(psf.path).name, allowed)
    if not 1.0 / 256.0 <= given / pitch_um <= 4.0:
        allowed = f"{pitch_um / 256.0:g} to {4.0 * pitch_um:g} um (1/256 to 4 pixels)"
        raise BadInput("sensor.psf", f"samples {given:g} um apart", allowed)
    return given / pitch_um


def _centre(psf: TablePsf, table: PsfTable) -> tuple[float, float]:
    """Where the source stands: as the scene says, else the file, else the one middle sample."""
    (ny, nx), known, asked = table.samples.shape, table.centre, psf.centre
    if asked is None:
        asked = "middle" if known is None else "file"
        if known is None and ny * nx % 2 == 0:
            allowed = (
                "centre: middle (between its two middle samples), sample (number n / 2 from 0, as "
                "FFTs put it), peak, centroid or [row, column]: half a sample lies between the "
                "first two"
            )
            raise BadInput("sensor.psf.centre", f"none for a table of {ny} x {nx} samples", allowed)
    if asked == "file":
        if known is None:
            allowed = "middle, sample, peak, centroid or [row, column]: the file names no centre"
            raise BadInput("sensor.psf.centre", "file", allowed)
        place = known
    else:
        place = find_centre(table.samples, asked) if isinstance(asked, str) else asked
    if not (0 <= place[0] <= ny - 1 and 0 <= place[1] <= nx - 1):
        allowed = f"a place in the table of {ny} x {nx} samples"
        raise BadInput("sensor.psf.centre", f"({place[0]:g}, {place[1]:g})", allowed)
    return place


def read_psf_table(path: Path) -> PsfTable:
    """Read a table of any known kind; BadInput names what is missing or wrong."""
    if path.name.lower().endswith(IMAGES):
        return PsfTable(read_image(path, FIELD))
    if not path.is_file():
        raise BadInput(FIELD, str(path), "an existing .npy, .fits, OpticStudio or CODE V file")
    if path.stat().st_size > LARGEST_BYTES:
        raise BadInput(FIELD, str(path), f"a file of at most {LARGEST_BYTES} bytes")
    text = _decoded(path.read_bytes())
    if "PSF" in text[:2000] and "Data spacing is" in text[:10_000]:
        return _zemax(path, text)
    if re.search(r"^\s*GRD\s+\d+\s+\d+", text[:20_000], re.M | re.I):
        return _codev(path, text)
    allowed = (
        "a .npy or .fits image, an OpticStudio listing of an FFT or Huygens PSF, or a CODE V grid"
    )
    raise BadInput(FIELD, str(path), allowed)


def _decoded(data: bytes) -> str:
    """Text of a listing: UTF-16 by its mark or its zero bytes, else UTF-8, else Latin-1."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    if data[1:400:2].count(0) > 150 or (len(data) < 400 and data[1::2].count(0) > len(data) // 3):
        return data.decode("utf-16-le", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _zemax(path: Path, text: str) -> PsfTable:
    """An OpticStudio listing of an FFT or Huygens PSF."""
    start = re.search(r"^\s*Values are[^\n]*\n", text, re.M | re.I)
    if start is None:
        raise BadInput(FIELD, str(path), "a listing with a line `Values are ...` before its values")
    head = text[: start.end()]
    if re.search(r"logarithm|\blog\b|phase|amplitude|\breal\b|imaginary", start[0], re.I):
        raise BadInput(FIELD, start[0].strip(), "linear intensity: set the analysis's Type so")
    spacing = re.search(rf"Data spacing is:?\s*({NUMBER})\s*([^\s,;]+)", head, re.I)
    grid = re.search(r"Image grid size:?\s*(\d+)\s*by\s*(\d+)", head, re.I)
    if spacing is None or grid is None:
        raise BadInput(FIELD, str(path), "a listing with `Data spacing is` and `Image grid size`")
    unit = spacing[2].rstrip(".").lower()
    if unit not in UM:
        raise BadInput(FIELD, f"samples in {unit!r}", f"a length: {', '.join(UM)}")
    columns, rows = int(grid[1]), int(grid[2])
    values = _numbers(path, text[start.end() :], rows, columns)
    place = re.search(r"Center point is:?\s*(?:row\s*)?(\d+)\s*,\s*(?:column\s*)?(\d+)", head, re.I)
    centre = None if place is None else (float(place[1]) - 1.0, float(place[2]) - 1.0)
    return PsfTable(values, float(spacing[1]) * UM[unit], centre)


def _codev(path: Path, text: str) -> PsfTable:
    """A CODE V grid of intensities."""
    lines = text.splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if re.match(r"\s*GRD\s", line, re.I))
    words = lines[at].upper().split()
    if len(words) < 3 or not (words[1].isdecimal() and words[2].isdecimal()):
        raise BadInput(FIELD, lines[at].strip()[:60], "GRD and two whole numbers")
    columns, rows = int(words[1]), int(words[2])
    if "FIL" not in words:
        raise BadInput(FIELD, lines[at].strip()[:60], "a grid of intensities (FIL)")
    options = dict(itertools.pairwise(words))
    try:
        stretch, empty = float(options.get("XSC", 1.0)), float(options.get("NDA", -32768.0))
    except ValueError:
        raise BadInput(FIELD, lines[at].strip()[:60], "numbers after NDA and XSC") from None
    if stretch != 1.0:
        raise BadInput(FIELD, f"XSC {stretch:g}", "samples equally far apart on both axes (XSC 1)")
    body = "".join(line for line in lines[at + 1 :] if not line.lstrip().startswith("!"))
    values = _numbers(path, body, rows, columns)
    return PsfTable(np.where(values == empty, 0.0, values))


def _numbers(path: Path, text: str, rows: int, columns: int) -> Array:
    """rows x columns numbers of a text; BadInput where it holds another count or other words."""
    if max(rows, columns) > LARGEST_SIDE:
        allowed = f"at most {LARGEST_SIDE} rows and columns"
        raise BadInput(FIELD, f"{path.name} of {rows} x {columns} samples", allowed)
    words = text.split()
    if len(words) != rows * columns:
        allowed = f"{rows} x {columns} = {rows * columns} values, as its heading says"
        raise BadInput(FIELD, f"{path.name} with {len(words)} values", allowed)
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError as error:
        raise BadInput(FIELD, path.name, f"numbers only; {error}") from None
    return values.reshape(rows, columns)
