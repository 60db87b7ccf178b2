"""Files that random scenes name: a catalogue and a small one of each other kind, made once."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from catalog_tools.ingest.ingest import ingest
from pipeline.inputs.sensor.cosmic_ray_darks import extract_library, open_darks
from pipeline.inputs.sensor.cosmic_ray_library import write_library
from pipeline.physics.cosmic_rays.frame import charge_e
from pipeline.physics.cosmic_rays.tracks import Flux

ROOT = Path(__file__).resolve().parents[2]
# Where the catalogue's stars crowd together and random pointings look: (ra, dec) in degrees.
PLACES = ((0.0, -90.0), (359.999999, -5.0), (123.4, 60.0), (276.0, -3.2), (0.0, 90.0), (40.0, 20.0))
CROWD, ALL_SKY = 150, 3000  # stars around each place (27 a decade of distance), over the whole sky
SIDE_PX = 64  # of the images that are made for a sensor of this many pixels a side
CUBE = """o Bus
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
f 4 3 2 1
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""


@dataclass(frozen=True)
class Stock:
    """Paths of the files that random scenes name."""

    catalogue: str
    psf: str
    pst: str
    image: str
    cosmic_rays: str
    pointing: str
    population: str
    ephemeris: str
    mesh: str
    albedo_map: str


def make_stock(folder: Path) -> Stock:
    """Make the files in a folder, or name those that an earlier call made there."""
    kept = folder / "stock.json"
    if kept.is_file():
        return Stock(**json.loads(kept.read_text()))
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1)
    stock = Stock(
        catalogue=_catalogue(folder, rng), psf=_psf(folder), pst=str(ROOT / "examples/pst.csv"),
        image=_image(folder, rng), cosmic_rays=_cosmic_rays(folder, rng),
        pointing=_pointing(folder), population=str(ROOT / "examples/population.tle"),
        ephemeris=_ephemeris(folder), mesh=_written(folder / "cube.obj", CUBE),
        albedo_map=_map(folder),
    )  # fmt: skip
    kept.write_text(json.dumps(asdict(stock)))
    return stock


def _written(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


def _catalogue(folder: Path, rng: np.random.Generator) -> str:
    """Stars all over the sky, and crowds around PLACES as dense at every scale as fields are."""
    ra = [rng.uniform(0, 360, ALL_SKY), [0.0, 0.0]]
    dec = [np.degrees(np.arcsin(rng.uniform(-1, 1, ALL_SKY))), [90.0, -90.0]]
    for ra0, dec0 in PLACES:
        apart = 10.0 ** rng.uniform(-5, 0.5, CROWD)
        turn = rng.uniform(0, 2 * np.pi, CROWD)
        at = np.clip(dec0 + apart * np.cos(turn), -90, 90)
        dec.append(at)
        ra.append(ra0 + apart * np.sin(turn) / np.maximum(np.cos(np.radians(at)), 1e-3))
    ra_deg, dec_deg = np.concatenate(ra) % 360.0, np.concatenate(dec)
    g = rng.uniform(2, 16, len(ra_deg))
    g[rng.integers(0, len(g), 3)] = -1.0
    rows = [f"{i + 1},{r},{d},{m}" for i, (r, d, m) in
            enumerate(zip(ra_deg, dec_deg, g, strict=True))]  # fmt: skip
    csv = folder / "stars.csv"
    csv.write_text("\n".join(["source_id,ra,dec,phot_g_mean_mag", *rows]) + "\n")
    ingest([csv], folder / "catalogue", form="gaia_dr2", workers=1)
    return str(folder / "catalogue")


def _psf(folder: Path) -> str:
    """A lopsided spot, 4 samples a pixel wide (sigma)."""
    y, x = (np.arange(63) - 31.0)[:, None], np.arange(63) - 31.0
    np.save(folder / "psf.npy", np.exp(-0.5 * (y**2 + (x + 0.3 * y) ** 2) / 16.0))
    return str(folder / "psf.npy")


def _image(folder: Path, rng: np.random.Generator) -> str:
    """A flat of SIDE_PX a side."""
    np.save(folder / "flat.npy", rng.uniform(0.8, 1.2, (SIDE_PX, SIDE_PX)))
    return str(folder / "flat.npy")


def _cosmic_rays(folder: Path, rng: np.random.Generator) -> str:
    flux = Flux(SIDE_PX, SIDE_PX, 10.0, 30.0, 40.0, 60.0, diffusion_um=3.0)
    dn = [
        np.rint(500 + charge_e(flux, 9, k, 0, 0, SIDE_PX, SIDE_PX)
                + rng.normal(0, 5, (SIDE_PX, SIDE_PX)))
        for k in range(8)
    ]  # fmt: skip
    np.save(folder / "darks.npy", np.array(dn).astype(np.uint16))
    library, _ = extract_library(open_darks([folder / "darks.npy"]), 60.0, 10.0, 1.0)
    write_library(folder / "rays.fits", library)
    return str(folder / "rays.fits")


def _pointing(folder: Path) -> str:
    """Camera to sky (+x on ra 0, boresight at the pole), slowly turning about the boresight."""
    rows = ["time_s,qx,qy,qz,qw"]
    for t in np.linspace(-100.0, 3000.0, 200):
        half = 1e-6 * t
        rows.append(f"{t},0,0,{np.sin(half)},{np.cos(half)}")
    return _written(folder / "pointing.csv", "\n".join(rows) + "\n")


def _ephemeris(folder: Path) -> str:
    """A circle of 42,164 km, ten hours on both sides of the epochs of 2019."""
    rows, radius, rate = ["time_s,x_m,y_m,z_m"], 4.2164e7, 7.2921e-5
    for t in np.arange(-36_000.0, 36_001.0, 300.0):
        rows.append(f"{t},{radius * np.cos(rate * t)},{radius * np.sin(rate * t)},0")
    return _written(folder / "orbit.csv", "\n".join(rows) + "\n")


def _map(folder: Path) -> str:
    """An albedo for every 30 degrees of latitude and longitude."""
    np.save(folder / "albedo.npy", np.full((6, 12), 0.3))
    return str(folder / "albedo.npy")
