"""Peers that run as a process of their own: SatSim through its Python, SkyMaker's program `sky`."""

from __future__ import annotations

import resource
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from catalog_tools.documents import JsonObject
from pipeline.studies.accuracy.engines import EngineCase
from pipeline.studies.accuracy.reference import GaussianStar, exact_pixels

Array = NDArray[np.float64]

LIMIT_S = 240.0
PROBE_LIGHT = 1e6  # e- of a probe in programs that work in magnitudes
ZERO_POINT_MAG = 26.0
SKY_HALF_PX = 24  # of SkyMaker's table beside the streak


class External(NamedTuple):
    """The probes' image per unit light, CPU seconds of the stars and of what comes before."""

    image: Array
    cpu_s: float
    table_s: float


class PeerFailed(Exception):
    """A peer ended with an error or ran out of time; the message is its own."""


def run_satsim(
    case: EngineCase,
    probes: tuple[Array, Array],
    stars: tuple[Array, Array],
    python: str,
    oversampling: int,
    table: bool,
) -> External:
    """SatSim's FFT or table mode; streaks by its shared-streak mode, a step per sub-pixel."""
    shape, track = case.shape, case.track
    if isinstance(shape, GaussianStar):
        form = {"sigma": shape.sigma_px, "q": 0.0, "obscuration": 0.0}
    else:
        form = {"sigma": 0.0, "q": shape.q_px, "obscuration": shape.obscuration}
    (x0, x1), (y0, y1) = track.x_px[0], track.y_px[0]
    job: JsonObject = {
        "rows": case.frame[0],
        "columns": case.frame[1],
        "osf": oversampling,
        "table": table,
        "pad": int(np.ceil(0.5 * case.streak_px)) + 32,
        "sweep_x": x1 - x0,
        "sweep_y": y1 - y0,
        "steps": max(1, int(np.ceil(case.streak_px * oversampling))),
        **form,
        "probe_x": probes[0],
        "probe_y": probes[1],
        "x": stars[0],
        "y": stars[1],
    }
    worker = Path(__file__).with_name("satsim_worker.py")
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(source, **job)
        _run([python, str(worker), str(source), str(target)], folder)
        with np.load(target) as out:
            return External(out["probe"], float(out["cpu_s"]), float(out["table_s"]))


def run_skymaker(
    case: EngineCase, probes: tuple[Array, Array], stars: tuple[Array, Array], oversampling: int
) -> External:
    """SkyMaker with the exact streaked response as its table (PSF_TYPE FILE), without noise.

    Written from its documentation and sources (version 4): positions are FITS's, from 1; a table
    holds the pixel already and is renormalised to unit light; magnitudes carry the light.
    """
    with tempfile.TemporaryDirectory() as folder:
        _write_table(case, oversampling, Path(folder) / "psf.fits")
        _, empty_s = _sky(case, oversampling, folder, (np.zeros(0), np.zeros(0)))
        image, _ = _sky(case, oversampling, folder, probes)
        _, all_s = _sky(case, oversampling, folder, stars)
    return External(image / PROBE_LIGHT, all_s - empty_s, empty_s)


def _sky(
    case: EngineCase, oversampling: int, folder: str, stars: tuple[Array, Array]
) -> tuple[Array, float]:
    """One run of `sky`: the image, and its CPU seconds."""
    mag = ZERO_POINT_MAG - 2.5 * np.log10(PROBE_LIGHT)
    rows = (f"100 {x + 1.0:.9f} {y + 1.0:.9f} {mag:.6f}" for x, y in zip(*stars, strict=True))
    (Path(folder) / "stars.list").write_text("\n".join(rows) + "\n")
    settings = {
        "IMAGE_NAME": "sky.fits",
        "IMAGE_SIZE": f"{case.frame[1]},{case.frame[0]}",
        "IMAGE_TYPE": "SKY_NONOISE",
        "GAIN": 1,
        "WELL_CAPACITY": 0,
        "SATUR_LEVEL": 1e12,
        "READOUT_NOISE": 0,
        "EXPOSURE_TIME": 1,
        "MAG_ZEROPOINT": ZERO_POINT_MAG,
        "PIXEL_SIZE": 1,
        "PSF_TYPE": "FILE",
        "PSF_NAME": "psf.fits",
        "PSF_OVERSAMP": oversampling,
        "SEEING_TYPE": "NONE",
        "AUREOLE_RADIUS": 0,
        "BACK_MAG": 99,
        "STARCOUNT_ZP": 0,
        "VERBOSE_TYPE": "QUIET",
        "NTHREADS": 1,
    }
    options = [word for key, value in settings.items() for word in (f"-{key}", str(value))]
    (Path(folder) / "sky.conf").write_text("")
    seconds = _run(["sky", "stars.list", "-c", "sky.conf", *options], folder)
    with fits.open(Path(folder) / "sky.fits") as made:
        return np.asarray(made[0].data, float), seconds


def _write_table(case: EngineCase, oversampling: int, path: Path) -> None:
    half = SKY_HALF_PX + int(np.ceil(0.5 * case.streak_px))
    at = np.arange(-half * oversampling, half * oversampling + 1) / oversampling
    samples = exact_pixels(case.shape, case.track, 0.0, 0.0, at, at)
    fits.writeto(path, samples.astype(np.float32))


def _run(command: list[str], folder: str) -> float:
    """CPU seconds of a command; PeerFailed with the end of what it said."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=LIMIT_S, check=False
        )
    except subprocess.TimeoutExpired:
        raise PeerFailed(f"took more than {LIMIT_S:.0f} s") from None
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.strip()]
        raise PeerFailed(said[-1][:200] if said else f"exit code {done.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
