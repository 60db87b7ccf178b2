"""One crowded, streaked, noisy 2048x2048 frame: seconds, memory, and where they go.

Run: python -m benchmarks.frame [--json FILE]. A random field of 100,000 stars (G 9 to 18), airy
PSF with Q = 1, 60 px streak, every noise term, full product on disk. "cold" is a first render in
a fresh process, "warm" the same again, "next frame" what one more frame of a dwell takes: CPU
seconds of both threads, and seconds. In the last case the telescope follows the sky and its frames
share one drawing of their stars.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from catalog_tools.engine.heap import few_collections, one_heap, peak_mb

STARS, SHAPE, STREAK_PX = 100_000, 2048, 60.0
RA_DEG, DEC_DEG, IFOV_ARCSEC = 80.0, 20.0, 2.0


def make_catalogue(folder: Path, stars: int) -> Path:
    """A catalogue with exactly `stars` stars over the frame, magnitudes as 10^(0.35 G)."""
    import pyarrow as pa
    import pyarrow.csv

    from catalog_tools.ingest.ingest import ingest

    rng = np.random.default_rng(1)
    half = 0.5 * SHAPE * IFOV_ARCSEC / 3600.0
    x, y = rng.uniform(-half, half, (2, stars))
    u = rng.uniform(size=stars)
    low, high = 10 ** (0.35 * 9.0), 10 ** (0.35 * 18.0)
    g = np.log10(low + u * (high - low)) / 0.35
    dec = DEC_DEG + y
    table = pa.table({
        "source_id": np.arange(1, stars + 1, dtype=np.int64),
        "ra": RA_DEG + x / np.cos(np.radians(dec)),
        "dec": dec,
        "parallax": rng.exponential(1.0, stars),
        "pmra": rng.normal(0, 5, stars),
        "pmdec": rng.normal(0, 5, stars),
        "radial_velocity": pa.nulls(stars, pa.float64()),
        "phot_g_mean_mag": g,
        "phot_bp_mean_mag": g + 0.4,
        "phot_rp_mean_mag": g - 0.6,
    })  # fmt: skip
    pyarrow.csv.write_csv(table, folder / "stars.csv")
    ingest([folder / "stars.csv"], folder / "catalogue", name="benchmark")
    return folder / "catalogue"


def scene(
    catalogue: Path, frames: int, psf: dict[str, Any], streak_px: float | None
) -> dict[str, Any]:
    """The benchmark scene as plain data; streak_px : None follows the stars."""
    focal = 9e-6 / np.radians(IFOV_ARCSEC / 3600.0)
    pointing: dict[str, Any] = {"boresight_ra_deg": RA_DEG, "boresight_dec_deg": DEC_DEG}
    if streak_px is None:
        pointing |= {"mode": "sidereal"}
    else:
        speed = streak_px * IFOV_ARCSEC / 2.0
        pointing |= {
            "mode": "rate",
            "rate_ra_arcsec_s": 0.8 * speed,
            "rate_dec_arcsec_s": 0.6 * speed,
        }
    return {
        "schema": "nightglass/scene/1", "name": "benchmark", "epoch": "2019-12-01T08:00:00Z",
        "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3},
        "sensor": {
            "shape": [SHAPE, SHAPE], "pixel_pitch_um": 9.0, "focal_length_m": focal,
            "aperture_m": focal * 650e-9 / 9e-6, "obscuration": 0.3,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "quantum_efficiency": 0.9, "psf": psf, "full_well_e": 90000, "gain_e_per_dn": 1.5,
            "bias_dn": 500, "dark_e_per_s": 0.5, "read_noise_e": 5.0,
        },
        "pointing": pointing,
        "exposure": {"integration_s": 2.0, "frames": frames, "cadence_s": 2.0},
        "stars": {"catalogue": str(catalogue)},
        "background": {"uniform_mag_arcsec2": 21.0},
    }  # fmt: skip


def timed(
    catalogue: Path, frames: int, psf: dict[str, Any], streak_px: float | None
) -> tuple[float, float]:
    """Seconds and CPU seconds of one whole render, on two threads."""
    from pipeline.route.run import Options, render
    from pipeline.spec.load import parse_scene

    with tempfile.TemporaryDirectory() as folder:
        made = parse_scene(scene(catalogue, frames, psf, streak_px))
        started, spent = time.perf_counter(), time.process_time()
        render(made, Path(folder) / "run", Options("threads", 2))
        return time.perf_counter() - started, time.process_time() - spent


def measure(
    catalogue: Path, name: str, psf: dict[str, Any], streak_px: float | None
) -> dict[str, Any]:
    """Cold, warm and per-frame seconds of one case; medians of three where warm."""

    def median_of(frames: int) -> np.ndarray:
        return np.median([timed(catalogue, frames, psf, streak_px) for _ in range(3)], axis=0)

    cold_s, _ = timed(catalogue, 1, psf, streak_px)
    warm, five = median_of(1), median_of(5)
    next_s, next_cpu_s = (five - warm) / 4.0
    return {
        "case": name, "cold_s": cold_s, "warm_s": float(warm[0]), "next_frame_s": float(next_s),
        "next_frame_cpu_s": float(next_cpu_s), "peak_mb": peak_mb(),
    }  # fmt: skip


def start_seconds() -> float:
    """Seconds of `nightglass --help`, median of five."""
    times = []
    for _ in range(5):
        started = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "pipeline", "--help"], capture_output=True, check=True
        )
        times.append(time.perf_counter() - started)
    return sorted(times)[2]


CASES = (
    ("airy Q=1, 60 px streak", {"kind": "airy"}, STREAK_PX),
    ("airy Q=1, no streak", {"kind": "airy"}, 0.0),
    ("gaussian 0.8 px, no streak", {"kind": "gaussian", "sigma_px": 0.8}, 0.0),
    ("airy Q=1, sidereal", {"kind": "airy"}, None),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--case", type=int, help="run one case in this process")
    parser.add_argument("--catalogue", type=Path)
    args = parser.parse_args()
    if args.case is not None:
        one_heap()  # as the command does
        few_collections()
        print(json.dumps(measure(args.catalogue, *CASES[args.case])))
        return
    with tempfile.TemporaryDirectory() as folder:
        catalogue = make_catalogue(Path(folder), STARS)
        rows = []
        for k in range(len(CASES)):
            command = [sys.executable, "-m", "benchmarks.frame", "--case", str(k),
                       "--catalogue", str(catalogue)]  # fmt: skip
            out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            rows.append(json.loads(out.splitlines()[-1]))
            r = rows[-1]
            print(
                f"{r['case']:>28}: cold {r['cold_s']:.2f} s, warm {r['warm_s']:.2f} s, next frame "
                f"{r['next_frame_cpu_s']:.2f} CPU s in {r['next_frame_s']:.2f} s, peak "
                f"{r['peak_mb']:.0f} MB"
            )
    help_s = start_seconds()
    print(f"nightglass --help: {help_s:.2f} s")
    if args.json:
        machine = f"{platform.machine()}, {platform.python_version()}"
        args.json.write_text(
            json.dumps({"machine": machine, "stars": STARS, "help_s": help_s, "cases": rows},
                       indent=2) + "\n"
        )  # fmt: skip


if __name__ == "__main__":
    main()
