"""Observing without drawing: CPU ms of a light curve of a target, and of a row of what is seen.

Run: python -m benchmarks.observe [--targets N] [--json FILE]. Spheres and spinning boxes in low
orbits, 1,000 times over two hours; the same one by one, in the same run, for the ratio.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import nightglass
from pipeline.light_curve import light_curve, light_curves
from pipeline.physics.radiometry import box

GOAL_MS, POINTS, SPAN_S, ALONE = 20.0, 1000, 7200.0, 8
BODIES: tuple[dict[str, Any], ...] = (
    {"kind": "sphere", "diameter_m": 2.0, "albedo": 0.2},
    {"kind": "box", "size_m": [1.0, 2.0, 3.0], "albedo": 0.3,
     "attitude": {"kind": "spin", "rate_deg_s": 3.0, "axis": [0, 0, 1]}},
)  # fmt: skip


def scene(targets: int, seed: int = 1) -> Any:
    """So many targets in random low orbits, half of them boxes, seen from a mountain."""
    rng = np.random.default_rng(seed)
    orbit = ("inclination_deg", "raan_deg", "argument_of_perigee_deg", "true_anomaly_deg")
    made = [
        {
            "name": f"t{k}",
            "body": BODIES[k % 2],
            "orbit": {"kind": "keplerian", "semi_major_axis_m": rng.uniform(6.9e6, 8e6),
                      "eccentricity": 0.001}
            | dict(zip(orbit, rng.uniform(0, [100, 360, 360, 360]).tolist(), strict=True)),
        }
        for k in range(targets)
    ]  # fmt: skip
    return nightglass.load_scene({
        "schema": "nightglass/scene/1", "name": "many", "epoch": "2019-04-20T06:00:00Z",
        "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3,
                     "height_m": 3055},
        "sensor": {"shape": [512, 512], "pixel_pitch_um": 9, "focal_length_m": 0.2,
                   "aperture_m": 0.1, "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
                   "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5},
        "pointing": {"mode": "sidereal", "boresight_ra_deg": 150, "boresight_dec_deg": 20},
        "exposure": {"integration_s": 1.0, "frames": 10, "cadence_s": 60},
        "targets": made, "background": {"uniform_mag_arcsec2": 21},
    })  # fmt: skip


def cpu_ms(work: Callable[[], Any], times: int = 3) -> float:
    """Least CPU milliseconds of a few runs."""
    taken = []
    for _ in range(times):
        started = time.process_time()
        work()
        taken.append(time.process_time() - started)
    return 1e3 * min(taken)


def measure(targets: int) -> dict[str, Any]:
    many, band = scene(targets), box(400e-9, 900e-9)
    asked = (band, 0.0, SPAN_S, POINTS)
    together = cpu_ms(lambda: list(light_curves(many, [], *asked))) / targets
    few = [f"t{k}" for k in range(ALONE)]
    alone = cpu_ms(lambda: [light_curve(many, name, *asked) for name in few]) / ALONE
    rows = targets * 10
    return {
        "targets": targets,
        "times": POINTS,
        "light_curve_ms": together,
        "goal_ms": GOAL_MS,
        "one_by_one_ms": alone,
        "ratio": alone / together,
        "observed_row_ms": cpu_ms(lambda: nightglass.observe(many), 1) / rows,
        "observed_rows": rows,
    }


def main() -> None:
    """Print the figures, and write them as JSON where asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--targets", type=int, default=200)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    found = measure(asked.targets)
    print(
        f"light curves of {found['targets']} targets at {POINTS} times: "
        f"{found['light_curve_ms']:.1f} CPU ms a target (goal {GOAL_MS:.0f}), "
        f"{found['ratio']:.1f} times less than one by one ({found['one_by_one_ms']:.0f})"
    )
    print(f"observe: {found['observed_row_ms']:.2f} CPU ms a row of {found['observed_rows']}")
    if asked.json:
        machine = {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()}
        asked.json.write_text(json.dumps(found | machine, indent=1) + "\n")


if __name__ == "__main__":
    main()
