"""Spectral curves: the sensor's response, named filters, the Sun, a library of stars."""

from __future__ import annotations

import csv
import difflib
import hashlib
import importlib.util
import itertools
import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pipeline.errors import BadInput, Damaged
from pipeline.inputs.reference import boxes
from pipeline.kept import kept
from pipeline.lazily import fits
from pipeline.physics.radiometry import (
    Array,
    ResponseCurve,
    box,
    combine,
    scale,
    spectrum_from_box_means,
)
from pipeline.user_data import PICKLES_FOLDER, SOLAR_TABLE, data_file

# Every spectrum here covers these wavelengths, so a response must lie between them.
SHORTEST_NM, LONGEST_NM = 290.0, 2500.0
LARGEST_TABLE_BYTES = 4_000_000

# Filters of speclite that are tabulated as responses to energy: Bessell 1990, PASP 102, 1181, as
# explained by Bessell & Murphy 2012, PASP 124, 140. All the others count photons.
ENERGY_GROUPS = frozenset({"bessell"})
# Those whose values have no scale of their own: scaled to a peak of one, as 2MASS publishes its own
# (Cohen et al. 2003, AJ 126, 1090; the table's peak is 8e-5).
RELATIVE_GROUPS = ENERGY_GROUPS | {"twomass"}

Spectrum = tuple[str, Array, Array]
NumberOrTable = float | str | Path


def resolve_response(
    bandpass: Mapping[str, object],
    transmission: NumberOrTable,
    quantum_efficiency: NumberOrTable,
    base: Path | None = None,
) -> tuple[ResponseCurve, str, str]:
    """The sensor's response, its band's name and its digest (hexadecimal SHA-256).

    bandpass : {kind: box, short_nm, long_nm}, {kind: named, name} with a name of speclite's
        filters, or {kind: table, path}
    transmission, quantum_efficiency : a number in (0, 1], or the path of a table
    base : folder that relative paths start from

    A table is CSV with the columns wavelength_nm and value (a heading and # comments may come
    first), ascending, 0 to 1. It must cover the bandpass or end in zero. The Gaia and most
    survey filters hold optics and detector already (`filter_facts`); Bessell's and 2MASS's are
    relative to their peak.
    BadInput names the field, e.g. sensor.bandpass.name.
    """
    band, name = _bandpass(bandpass, base)
    curves, factor = [band], 1.0
    for field, given in (
        ("sensor.transmission", transmission),
        ("sensor.quantum_efficiency", quantum_efficiency),
    ):
        if isinstance(given, str | Path):
            curves.append(_covering_table(field, given, base, band))
        else:
            factor *= _fraction(field, given)
    try:
        response = scale(combine(*curves), factor)
    except ValueError as error:
        raise BadInput("sensor", name, "curves with wavelengths in common") from error
    if not np.any(response.value > 0.0):
        raise BadInput("sensor", name, "a response above zero somewhere in the band")
    content = response.wavelength_m.tobytes() + response.value.tobytes()
    return response, name, hashlib.sha256(content).hexdigest()


def _bandpass(bandpass: Mapping[str, object], base: Path | None) -> tuple[ResponseCurve, str]:
    kind = bandpass.get("kind")
    if kind == "box":
        short, long = (
            _number(f"sensor.bandpass.{k}", bandpass.get(k)) for k in ("short_nm", "long_nm")
        )
        if not short < long:
            raise BadInput("sensor.bandpass.long_nm", long, f"more than short_nm ({short:g})")
        field, curve, name = (
            "short_nm",
            box(short * 1e-9, long * 1e-9),
            f"box {short:g}-{long:g} nm",
        )
    elif kind == "named":
        field, name = "name", str(bandpass.get("name"))
        curve = _trimmed(named_filter(name))
    elif kind == "table":
        field, path = "path", str(bandpass.get("path"))
        curve = _trimmed(read_table("sensor.bandpass.path", path, base))
        name = f"table {Path(path).name}"
    else:
        raise BadInput("sensor.bandpass.kind", kind, "box, named or table")
    ends_nm = curve.wavelength_m[[0, -1]] * 1e9
    if ends_nm[0] < SHORTEST_NM - 1e-6 or ends_nm[1] > LONGEST_NM + 1e-6:
        span = f"{ends_nm[0]:g} to {ends_nm[1]:g} nm"
        allowed = f"a band within {SHORTEST_NM:g} to {LONGEST_NM:g} nm"
        raise BadInput(f"sensor.bandpass.{field}", span, allowed)
    return curve, name


def _number(field: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadInput(field, value, "a finite number")
    return float(value)


def _fraction(field: str, value: object) -> float:
    number = _number(field, value)
    if not 0.0 < number <= 1.0:
        raise BadInput(field, value, "above 0 and at most 1, or the path of a table")
    return number


def _trimmed(curve: ResponseCurve) -> ResponseCurve:
    """The curve without the zeros beyond the ones that end its band."""
    lit = np.flatnonzero(curve.value)
    if lit.size == 0:
        raise BadInput("sensor.bandpass", "zero everywhere", "a response above zero")
    keep = slice(max(lit[0] - 1, 0), lit[-1] + 2)
    return ResponseCurve(curve.wavelength_m[keep], curve.value[keep])


def _covering_table(
    field: str, path: str | Path, base: Path | None, band: ResponseCurve
) -> ResponseCurve:
    """A table that reaches over the band, or ends in zero where it does not."""
    curve = read_table(field, path, base)
    for end, beyond in (
        (0, band.wavelength_m[0] < curve.wavelength_m[0] * (1.0 - 1e-9)),
        (-1, band.wavelength_m[-1] > curve.wavelength_m[-1] * (1.0 + 1e-9)),
    ):
        if beyond and curve.value[end] > 0.0:
            ends = band.wavelength_m[[0, -1]] * 1e9
            raise BadInput(
                field,
                f"{path} ends at {curve.wavelength_m[end] * 1e9:g} nm with {curve.value[end]:g}",
                f"a table that covers the band ({ends[0]:g} to {ends[1]:g} nm) or ends in 0",
            )
    return curve


def read_table(field: str, path: str | Path, base: Path | None = None) -> ResponseCurve:
    """Read a CSV table (wavelength_nm, value): ascending, finite, 0 <= value <= 1."""
    table = _table(field, path, (base or Path()) / path)
    for before, row in itertools.pairwise(table):
        if row[0] <= before[0]:
            raise BadInput(field, f"{row[0]:g} after {before[0]:g}", "ascending wavelengths")
    if table[0, 0] < 10.0 or table[-1, 0] > 30_000.0:
        raise BadInput(field, f"{table[0, 0]:g} to {table[-1, 0]:g}", "wavelengths in nm")
    wrong = table[(table[:, 1] < 0.0) | (table[:, 1] > 1.0)]
    if len(wrong):
        raise BadInput(field, f"{wrong[0, 1]:g} at {wrong[0, 0]:g} nm", "values from 0 to 1")
    return ResponseCurve(table[:, 0] * 1e-9, table[:, 1])


def _table(field: str, path: str | Path, file: Path) -> Array:
    """The rows (n, 2) of finite numbers of a file; `path` : as the user wrote it."""
    try:
        if file.stat().st_size > LARGEST_TABLE_BYTES:
            raise BadInput(field, str(path), f"a table of at most {LARGEST_TABLE_BYTES} bytes")
        lines = file.read_text(encoding="utf-8-sig").splitlines()
        rows = list(csv.reader(line for line in lines if not re.match(r"\s*(#|$)", line)))
    except (OSError, ValueError, csv.Error) as error:
        raise BadInput(field, str(path), "a readable text file") from error
    if rows and not _is_number(rows[0][0]):
        rows = rows[1:]
    for row in rows:
        if len(row) != 2 or not all(map(_is_number, row)):
            raise BadInput(field, ",".join(row), "rows of two finite numbers: wavelength_nm, value")
    if len(rows) < 2:
        raise BadInput(field, str(path), "at least two rows: wavelength_nm, value")
    return np.array(rows, dtype=np.float64)


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def filter_folder() -> Path:
    """The folder of speclite's filter tables; speclite itself (and astropy) is not imported."""
    spec = importlib.util.find_spec("speclite")
    if spec is None or spec.origin is None:
        raise BadInput("sensor.bandpass.name", "speclite", "an installation with speclite")
    return Path(spec.origin).parent / "data" / "filters"


def named_filter(name: str) -> ResponseCurve:
    """A filter of speclite by name (gaiadr2-G, bessell-V, sdss2010-r...), per photon.

    Responses to energy are divided by the wavelength; relative ones are scaled to a peak of one.
    BadInput with the nearest names where there is none.
    """
    text = _filter_text(name)
    body = [line.split() for line in text.splitlines() if line and not line.startswith("#")][1:]
    unit = re.search(r"^#.*?unit: ['\"]?(Angstrom|nm|um|micron)\b", text, re.MULTILINE)
    sound = all(len(row) == 2 and all(map(_is_number, row)) for row in body)
    if unit is None or not body or not sound:
        raise Damaged(
            str(filter_folder() / f"{name}.ecsv"),
            "no wavelength unit, or not two columns of finite numbers",
        )
    table = np.array(body, dtype=np.float64)
    metres = {"Angstrom": 1e-10, "nm": 1e-9, "um": 1e-6, "micron": 1e-6}[unit[1]]
    wavelength, value = table[:, 0] * metres, np.maximum(table[:, 1], 0.0)
    group = name.split("-")[0]
    value = value / wavelength if group in ENERGY_GROUPS else value
    value = value / value.max() if group in RELATIVE_GROUPS else value
    return ResponseCurve(wavelength, value)


def filter_facts(name: str) -> tuple[float, float]:
    """What a filter of speclite holds: its largest value, which is that of a whole instrument where
    it is below one, and the air masses of its site's atmosphere (0: none)."""
    air = re.search(r"\bairmass: ?([\d.]+)", _filter_text(name))
    return float(named_filter(name).value.max()), float(air[1]) if air else 0.0


def _filter_text(name: str) -> str:
    folder = filter_folder()
    names = sorted(path.stem for path in folder.glob("*.ecsv"))
    if name not in names:
        near = difflib.get_close_matches(name[:60], names, n=3, cutoff=0.4)
        allowed = f"a filter of speclite, e.g. {', '.join(near or ['gaiadr2-G', 'bessell-V'])}"
        raise BadInput("sensor.bandpass.name", name, allowed)
    return (folder / f"{name}.ecsv").read_text(encoding="utf-8")


def solar_spectrum() -> tuple[Array, Array, str, str]:
    """The Sun at 1 au: wavelength (n,) m, irradiance (n,) W/m2/m, its source and its error.

    ASTM E490-00a from the user's data folder, else box means of it (`boxes.sun`)
    joined smoothly. The latter, against the whole table, over box bands between 300 and 1200 nm:
    0.005% for 400 to 900 nm; bands of 50 nm or more 0.13% rms and at most 1.0% (0.4% beyond
    400 nm); of 100 nm or more at most 0.4%.
    """
    path = data_file(SOLAR_TABLE)
    scale_text = "total 1366.1 W/m2, 0.4% above the nominal 1361 W/m2 (IAU 2015 B3)"
    if path is None:
        embedded = boxes.sun()
        edges = np.array(embedded.edges_nm) * 1e-9
        means = np.array(embedded.columns["irradiance_mw_m2_nm"]) * 1e6

        def joined() -> dict[str, Array]:
            made = spectrum_from_box_means(edges, means, 1e-9)
            return {"wavelength": made[0], "irradiance": made[1]}

        wavelength, irradiance = kept(("solar spectrum", edges, means), joined).values()
        error = f"within 1% of the full table for bands of 50 nm or more; {scale_text}"
        return wavelength, irradiance, "ASTM E490-00a in boxes of 5 to 100 nm", error
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines():
        cells = line.split(",")
        if len(cells) >= 2 and _is_number(cells[0]) and _is_number(cells[1]):
            rows.append((float(cells[0]) * 1e-6, float(cells[1]) * 1e6))
    table = np.array(sorted(rows), dtype=np.float64)
    if len(rows) < 2 or np.any(np.diff(table[:, 0]) <= 0.0) or np.any(table[:, 1] < 0.0):
        raise Damaged(str(path), "not a table of ascending wavelengths and irradiances")
    return table[:, 0], table[:, 1], "ASTM E490-00a (2014), table 3", scale_text


def stellar_library() -> tuple[list[Spectrum], str]:
    """Spectra of unreddened stars, A0V among them, and their source.

    Each is (spectral type, wavelength (n,) m, F_lambda (n,) in any unit). From the user's data
    folder (A. J. Pickles 1998, PASP 110, 863: UVKLIB), else 29 of its stars in 31 boxes
    (`boxes.stars`).
    """
    folder = data_file(PICKLES_FOLDER)
    if folder is not None:
        library = _pickles_library(folder)
        return library, f"{len(library)} spectra of Pickles 1998 (UVKLIB)"
    embedded = boxes.stars()
    edges = np.array(embedded.edges_nm) * 1e-9
    library = []
    for name, mmag in embedded.columns.items():
        photons = 10.0 ** (-0.4e-3 * np.array(mmag, dtype=np.float64))
        wavelength, smooth = spectrum_from_box_means(edges, photons, 2e-9)
        library.append((name, wavelength, smooth / (wavelength * 1e9)))
    return library, f"{len(library)} stars of Pickles 1998 in {len(edges) - 1} boxes (embedded)"


def stellar_library_digest() -> str:
    """SHA-256 of what `stellar_library` would read, without parsing it."""
    digest = hashlib.sha256()
    folder = data_file(PICKLES_FOLDER)
    if folder is None:
        digest.update(repr(boxes.stars()).encode())
        return digest.hexdigest()
    for path in sorted(folder.glob("*.fits")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _pickles_library(folder: Path) -> list[Spectrum]:
    library: list[Spectrum] = []
    path = folder / "pickles_uk.fits"
    try:
        index = fits().getdata(path, 1)
        for file, spectral_type in zip(index["FILENAME"], index["SPTYPE"], strict=True):
            path = folder / f"{str(file).strip()}.fits"
            if path.is_file():
                table = fits().getdata(path, 1)
                wavelength = np.array(table["WAVELENGTH"], dtype=np.float64) * 1e-10
                flux = np.array(table["FLUX"], dtype=np.float64)
                library.append((str(spectral_type).strip(), wavelength, flux))
    except (OSError, KeyError, ValueError, TypeError, IndexError) as error:
        raise Damaged(str(path), f"not a table of the Pickles library ({error})") from error
    if "A0V" not in {name for name, _, _ in library}:
        raise Damaged(str(folder), "the library's A0V spectrum is missing")
    return library
