"""A study at full size, and finding what is seen in a night: time, memory, and SGP4's share.

Run: python -m benchmarks.study [--objects N] [--sensors N] [--hours H] [--json FILE]. The study
runs in processes on all cores: wall seconds, and the memory of all processes together at most.
Propagation is timed in this process: states a second as the study follows them, over those of
sgp4's SatrecArray alone on the same satellites and times.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import psutil

CAMERA: dict[str, Any] = {
    "name": "camera",
    "tracking": "target",
    "exposure": {"integration_s": 1.0, "frames": 3, "cadence_s": 2.0},
    "background": {"uniform_mag_arcsec2": 21.0},
    "sensor": {
        "shape": [2048, 2048], "pixel_pitch_um": 13.5, "focal_length_m": 1.0, "aperture_m": 0.5,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900}, "quantum_efficiency": 0.8,
        "psf": {"kind": "gaussian", "sigma_px": 0.9}, "read_noise_e": 5.0,
    },
}  # fmt: skip


def study_data(objects: int, sensors: int, hours: float) -> dict[str, Any]:
    """Sites around the world, and made-up objects."""
    sites = [
        {
            "name": f"site-{i}",
            "observer": {
                "kind": "ground", "latitude_deg": -40.0 + 80.0 * i / max(1, sensors - 1),
                "longitude_deg": -180.0 + 360.0 * i / sensors, "height_m": 2000,
                "atmosphere": {"extinction": {"mag_per_airmass": 0.12}},
            },
        }
        for i in range(sensors)
    ]  # fmt: skip
    return {
        "schema": "nightglass/study/1", "name": "full-size", "start": "2019-04-20T00:00:00Z",
        "duration_h": hours, "cameras": [CAMERA], "sensors": sites,
        "catalogue": {"synthetic": {"objects": objects}}, "tasking": {"kind": "cued"},
    }  # fmt: skip


class Memory:
    """The most memory that this process and its children hold together [MB]: own pages alone."""

    def __enter__(self) -> Memory:
        self.most_mb, self._end = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def _look(self) -> None:
        own = psutil.Process()
        while not self._end.wait(0.5):
            total = 0
            for process in (own, *own.children(recursive=True)):
                try:
                    total += process.memory_full_info().uss
                except psutil.Error:
                    continue
            self.most_mb = max(self.most_mb, total / 1e6)


def run_whole(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The study as a user runs it."""
    from pipeline.capacity.run import run_study

    started = time.perf_counter()
    with Memory() as memory:
        report = run_study(data, folder, folder / "out")
    return {
        "study_s": time.perf_counter() - started,
        "memory_mb": memory.most_mb,
        "forecast_cpu_s": report["forecast"]["cpu_s"],
        "observations": report["figures"]["observations"],
    }


def propagation(objects: int) -> dict[str, float]:
    """States a second, ours and sgp4's own."""
    import numpy as np
    from sgp4.api import SatrecArray

    from pipeline.physics.positions.orbit_screen import states_together
    from pipeline.physics.positions.orbit_sgp4 import since_epochs_s
    from pipeline.physics.positions.times import parse_utc
    from pipeline.spec.study import Synthetic
    from pipeline.survey.elements import synthetic_elements

    epoch = parse_utc("2019-04-20T00:00:00Z")
    satellites = synthetic_elements(Synthetic(objects=min(objects, 1024)), epoch).satellites()
    at: Any = np.arange(361) * 60.0
    since = since_epochs_s(satellites, epoch)
    alone, ours = [], []
    for _ in range(5):
        started = time.process_time()
        array = SatrecArray(satellites)
        array.sgp4(np.full(361, epoch[0]), epoch[1] + at / 86400.0)
        alone.append(time.process_time() - started)
        started = time.process_time()
        states_together(satellites, since, at)
        ours.append(time.process_time() - started)
    states = len(satellites) * len(at)
    return {
        "sgp4_states_per_s": states / min(alone),
        "states_per_s": states / min(ours),
        "propagation_ratio": min(alone) / min(ours),
    }


def find_night(objects: int) -> dict[str, float]:
    """CPU seconds of a night at 10 s steps for one site."""
    import numpy as np

    from pipeline.physics.positions.times import parse_utc
    from pipeline.spec.study import FieldOfRegard, Synthetic
    from pipeline.survey.elements import synthetic_elements
    from pipeline.survey.find import BATCH
    from pipeline.survey.search import make_search
    from pipeline.survey.watch import make_watcher

    epoch = parse_utc("2019-04-20T05:35:00Z")
    observer = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055}
    sections = {k: CAMERA[k] for k in ("sensor", "exposure", "background")}
    elements = synthetic_elements(Synthetic(objects=objects), epoch)
    started, wall = time.process_time(), time.perf_counter()
    watcher = make_watcher(sections | {"observer": observer}, FieldOfRegard(), epoch, True)
    search = make_search(watcher, np.arange(0.0, 34_700.0, 10.0), 5.0)
    found = 0
    for first in range(0, objects, BATCH):
        sights, _ = search.of(elements.take(slice(first, first + BATCH)))
        found += len(np.unique(sights.object))
    return {
        "find_cpu_s": time.process_time() - started,
        "find_s": time.perf_counter() - wall,
        "found": found,
    }


def main() -> None:
    """Measure and print; also as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--objects", type=int, default=30_000)
    parser.add_argument("--sensors", type=int, default=10)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    found: dict[str, Any] = {
        "machine": f"{platform.machine()}, {platform.python_version()}, {os.cpu_count()} cores",
        "objects": a.objects, "sensors": a.sensors, "hours": a.hours,
    }  # fmt: skip
    found |= propagation(a.objects)
    found |= find_night(a.objects)
    with tempfile.TemporaryDirectory() as folder:
        found |= run_whole(study_data(a.objects, a.sensors, a.hours), Path(folder))
    for key, value in found.items():
        print(f"{key:>20}  {value:.4g}" if isinstance(value, float) else f"{key:>20}  {value}")
    if a.json is not None:
        a.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
