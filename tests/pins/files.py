"""The files that the pinned scenes read: catalogues, curves, images, orbits, a mesh."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.inputs.sensor.cosmic_ray_library import write_library
from pipeline.physics.cosmic_rays.library import Library

RA_DEG, DEC_DEG = 80.0, 20.0
SIDE = 32
HEAD = (
    "source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
    "phot_bp_mean_mag,phot_rp_mean_mag"
)
# A catalogue's stars lie in a square about the field: how many, its half side [deg], the brightest
# and the faintest [G], the first number of their names.
CATALOGUES = {
    "stars": (500, 0.12, 9.0, 16.0, 1),
    "crowd": (9000, 0.12, 14.0, 18.0, 1),
    "layer": (60, 0.12, 9.0, 13.0, 100_001),
}
CUBE = """o Bus
v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1
usemtl foil
f 1 4 3\nf 1 3 2\nf 5 6 7\nf 5 7 8
usemtl paint
f 1 2 6\nf 1 6 5\nf 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7\nf 4 1 5\nf 4 5 8
o Panel
v 1.2 0 0.5\nv 3.2 0 0.5\nv 3.2 1 0.5\nv 1.2 1 0.5
usemtl cells
f 9 10 11\nf 9 11 12
"""
SIP_HEADER = {
    "CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "CRVAL1": 210.0, "CRVAL2": -33.0,
    "CRPIX1": 20.5, "CRPIX2": -3.25, "CD1_1": -2e-3, "CD1_2": 1e-3, "CD2_1": 1e-3, "CD2_2": 2e-3,
    "CUNIT1": "deg", "CUNIT2": "deg", "A_ORDER": 3, "B_ORDER": 2, "A_2_0": 2e-4, "A_0_3": 1e-6,
    "B_1_1": -3e-4,
}  # fmt: skip
# A geostationary satellite above 150 degrees west at the scenes' epoch, and some beside it.
GEO_PHASE_DEG = 40.0
EPOCH_OF_ELEMENTS = "19335.33333333"


def write_files(folder: Path) -> Path:
    """Write every file that a scene names as `@name` into a folder, and return it."""
    for name, wish in CATALOGUES.items():
        _catalogue(folder, name, *wish)
    _curves(folder)
    _images(folder)
    _responses(folder)
    _orbits(folder)
    _pointings(folder)
    _mesh(folder)
    write_library(folder / "rays.fits", _library())
    return folder


def _text(path: Path, lines: Sequence[str]) -> None:
    path.write_text("\n".join(lines) + "\n")


def _catalogue(
    folder: Path, name: str, count: int, half_deg: float, low: float, high: float, first: int
) -> None:
    """Stars that move and differ in colour, by the product's own ingest; their summed light.

    Their numbers are made up: they hold no place.
    """
    from catalog_tools.catalogue import open_catalogue
    from catalog_tools.forms.load import FOLDER
    from catalog_tools.ingest.ingest import ingest
    from catalog_tools.query.starlight import make_starlight

    rng = np.random.default_rng(3)
    x, y = rng.uniform(-half_deg, half_deg, (2, count))
    dec = DEC_DEG + y
    ra = RA_DEG + x / np.cos(np.radians(dec))
    g, red = np.sort(rng.uniform(low, high, count)), rng.uniform(0.2, 1.6, count)
    motion, parallax = rng.normal(0.0, 60.0, (2, count)), rng.uniform(0.5, 40.0, count)
    motion[0, :3], parallax[:3] = (9e3, -5e3, 2e3), (500.0, 300.0, 100.0)
    rows = [
        f"{first + i},2015.5,{ra[i]:.12f},{dec[i]:.12f},{parallax[i]:.6f},"
        f"{motion[0, i]:.6f},{motion[1, i]:.6f},,{g[i]:.4f},{g[i] + 0.4 * red[i]:.4f},"
        f"{g[i] - 0.6 * red[i]:.4f}"
        for i in range(count)
    ]
    path = folder / f"{name}.csv"
    _text(path, [HEAD, *rows])
    form = (FOLDER / "gaia_dr2.toml").read_text(encoding="utf-8")
    _text(folder / "form.toml", [form.replace("holds_place = true", "holds_place = false")])
    ingest([path], folder / name, form=folder / "form.toml", workers=1)
    make_starlight(open_catalogue(folder / name))


def _curves(folder: Path) -> None:
    """A band, a transmission, a quantum efficiency, stray light, a map of the Earth, a BRDF."""
    _text(folder / "band.csv", ["wavelength_nm,value", "450,0", "500,0.8", "600,0.95", "700,0"])
    _text(folder / "qe.csv", ["wavelength_nm,value", "300,0.3", "550,0.9", "1000,0.2"])
    _text(folder / "mirrors.csv", ["wavelength_nm,value", "300,0.8", "1000,0.95"])
    _text(folder / "pst.csv", [
        "angle_deg,pst", "1,1e-4", "3,1e-5", "10,1e-6", "30,1e-8", "60,1e-10", "85,1e-12",
    ])  # fmt: skip
    latitude = np.linspace(-1.0, 1.0, 6)[:, None] ** 2
    np.save(folder / "earth.npy", 0.2 + 0.5 * latitude * np.ones(12))
    angles, rows = (0.0, 45.0, 90.0), ["theta_i_deg,theta_o_deg,phi_deg,brdf_per_sr"]
    for i in angles:
        for o in angles:
            rows += [f"{i},{o},{p},{0.1 + 0.05 * np.cos(np.radians(i - o)):.6f}" for p in (0, 180)]
    _text(folder / "brdf.csv", rows)


def _images(folder: Path) -> None:
    """Images of the sensor's terms, and maps of its faults."""
    rng = np.random.default_rng(8)
    for name, low, high in (
        ("flat", 0.7, 1.0), ("dark", 1.0, 20.0), ("bias", 90.0, 110.0), ("gain", 0.9, 1.2),
        ("read", 3.0, 6.0),
    ):  # fmt: skip
        np.save(folder / f"{name}.npy", rng.uniform(low, high, (SIDE, SIDE)))
    for name in ("bad", "dead"):
        np.save(folder / f"{name}.npy", (rng.random((SIDE, SIDE)) < 0.01).astype(float))


def _responses(folder: Path) -> None:
    """Images of the light: lopsided, with and without a middle; a listing that says its centre."""

    def light(side: int, row: float, column: float, sigma: float) -> np.ndarray:
        y, x = np.arange(side) - row, np.arange(side) - column
        return np.exp(-0.5 * (y[:, None] ** 2 + (x[None, :] + 0.3 * y[:, None]) ** 2) / sigma**2)

    np.save(folder / "psf.npy", light(33, 16.2, 15.7, 3.0))
    np.save(folder / "even.npy", light(32, 16.0, 16.0, 3.0))
    np.save(folder / "collected.npy", light(17, 8.0, 8.0, 1.7))
    ny = nx = 32
    rows = ["\t".join(f"{v:.10E}" for v in row) for row in light(32, 16.0, 15.0, 3.0)]
    _text(folder / "listing.txt", [
        "Listing of Huygens PSF Data", "", "File : triplet.zos", "Title: A TRIPLET",
        "Date : 1/2/2024", "", "", "Polychromatic Huygens PSF",
        "0.4861 to 0.6563 um at 0.0000, 0.0000 (deg)", "Data spacing is 3.0000 um.",
        "Data area is 96 by 96 um.", "Strehl ratio: 0.512", "Pupil grid size: 64 by 64",
        f"Image grid size: {nx} by {ny}", "Center point is: 17, 16",
        "Center coordinates   :  0.00000000E+00,  1.23000000E+00 Millimeters", "",
        "Values are normalized to unity.", "", *rows,
    ])  # fmt: skip
    _header(folder / "distorted.txt")


def _header(path: Path) -> None:
    from astropy.io import fits

    path.write_text(fits.Header(SIP_HEADER).tostring(sep="\n") + "\nEND     \n")


def elements(number: int, phase_deg: float) -> tuple[str, str]:
    """Two-line elements of a geostationary satellite at a phase, with their check sums."""
    first = f"1 {number:05d}U 19001A   {EPOCH_OF_ELEMENTS}  .00000000  00000-0  00000+0 0  999"
    second = f"2 {number:05d}   0.0500   0.0000 0001000   0.0000 {phase_deg:8.4f}  1.00270000    1"
    return _summed(first), _summed(second)


def _summed(line: str) -> str:
    return f"{line}{sum(int(c) if c.isdigit() else c == '-' for c in line) % 10}"


def _orbits(folder: Path) -> None:
    """Two populations at the same places, sizes, mean elements as JSON, a circle as CSV."""
    near = {"A DEB": 0.004, "B": -0.006, "C": 0.009, "D": 3.0}
    rows: list[str]
    for file, first in (("population", 101), ("beside", 201)):
        rows = []
        for i, (name, off_deg) in enumerate(near.items()):
            rows += [f"OBJECT {name}", *elements(first + i, GEO_PHASE_DEG + off_deg)]
        _text(folder / f"{file}.tle", rows)
    _text(folder / "sizes.csv", ["norad_id,diameter_m,albedo", "102,5.0,0.4", "103,,0.3"])
    told: dict[str, Any] = {
        "OBJECT_NAME": "ONE", "OBJECT_ID": "2019-001A", "NORAD_CAT_ID": 1,
        "EPOCH": "2019-12-01T07:59:00.000", "MEAN_MOTION": 14.3, "ECCENTRICITY": 0.001,
        "INCLINATION": 60.0, "RA_OF_ASC_NODE": 70.0, "ARG_OF_PERICENTER": 0.0,
        "MEAN_ANOMALY": 12.0, "BSTAR": 1e-5, "CENTER_NAME": "EARTH", "REF_FRAME": "TEME",
        "TIME_SYSTEM": "UTC", "MEAN_ELEMENT_THEORY": "SGP4",
    }  # fmt: skip
    other = told | {"OBJECT_NAME": "TWO", "OBJECT_ID": "2019-001B", "NORAD_CAT_ID": 2}
    (folder / "elements.json").write_text(json.dumps([told, other | {"MEAN_ANOMALY": 14.0}]))
    for name, phase_rad in (("circle", 0.0), ("ahead", 0.03)):
        rows = ["time_s,x_m,y_m,z_m"]
        rows += [",".join(f"{v!r}" for v in row) for row in circle_rows(phase_rad)]
        _text(folder / f"{name}.csv", rows)


def circle_rows(phase_rad: float) -> list[list[float]]:
    """Time [s] and places [m] on a circle of 7178 km over both poles, every 20 s for 10 minutes."""
    time_s = np.arange(-300.0, 301.0, 20.0)
    angle = np.sqrt(3.986004418e14 / 7.178e6**3) * time_s + phase_rad
    x, z = 7.178e6 * np.cos(angle), 7.178e6 * np.sin(angle)
    rows = zip(time_s, np.round(x, 3), np.zeros(len(x)), np.round(z, 3), strict=True)
    return [[float(v) for v in row] for row in rows]


def _pointings(folder: Path) -> None:
    """A table of attitudes about the field, and a spectrum of jitter."""
    rows = ["time_s,qx,qy,qz,qw"]
    rows += [f"{t!r},{x!r},{y!r},{z!r},{w!r}" for t, x, y, z, w in attitude_rows()]
    _text(folder / "attitude.csv", rows)
    _text(folder / "jitter.csv", ["frequency_hz,arcsec2_per_hz", "0.1,20", "1,10", "10,0.1"])


def attitude_rows() -> list[list[float]]:
    """Seconds and quaternions (scalar last) of a camera that sways about the field's middle."""
    from scipy.spatial.transform import Rotation

    ra, dec = np.radians([RA_DEG, DEC_DEG])
    z = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    y = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    held = Rotation.from_matrix(np.column_stack([np.cross(y, z), y, z]))
    time_s = np.arange(-5.0, 15.0, 0.5)
    sway = Rotation.from_rotvec(np.outer(1e-4 * np.sin(0.8 * time_s), [0.5, 1.0, 0.2]))
    found = (held * sway).as_quat()
    return [[float(t), *map(float, q)] for t, q in zip(time_s, found, strict=True)]


def _mesh(folder: Path) -> None:
    (folder / "bus.obj").write_text(CUBE)


def _library() -> Library:
    """Six straight events in three recorded frames."""
    lengths = np.array([1, 4, 7, 2, 5, 3])
    start = np.concatenate([[0], np.cumsum(lengths)])
    along = np.concatenate([np.arange(n) for n in lengths])
    event = np.repeat(np.arange(6), lengths)
    x, y = 3 + 4 * event + along, 2 + 5 * event + along // 2
    electrons = 200.0 + 150.0 * event + 40.0 * along
    return Library(
        start, np.minimum(x, 31), np.minimum(y, 31), electrons, 3.0, SIDE * SIDE, 9.0, (SIDE, SIDE),
        3, np.array([0, 0, 1, 1, 2, 2]),
    )  # fmt: skip
