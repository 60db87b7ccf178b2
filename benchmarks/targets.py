"""Targets: seconds to screen 30,000 mean-element sets for a dwell, and what the screen keeps.

Run: python -m benchmarks.targets [--count N] [--dwell SECONDS] [--json FILE]. The population is
made up (low, medium, geostationary and eccentric orbits about as frequent as in the public
catalogue); the observer is a site at 20.7 N, the field 1 degree from centre to corner. Seconds are
of the wall, medians of three; satellites are made once and told apart.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from sgp4.api import WGS72, Satrec

from pipeline.physics.positions.earth import site_state
from pipeline.physics.positions.orbit_screen import screen_cone
from pipeline.physics.positions.times import instants, parse_utc
from pipeline.physics.vectors import unit

Array = np.ndarray
EPOCH = "2019-04-20T03:00:00Z"
GOAL_S = 3.0
SITE_RAD = (np.radians(20.7), np.radians(-156.3))
FIELD_RAD = np.radians(1.0)
# share, mean motion [rev/day] from, to, largest eccentricity, inclinations [rad] from, to
REGIMES = (
    (0.80, 13.5, 15.8, 0.01, 0.5, 1.8),
    (0.08, 1.9, 2.1, 0.02, 0.9, 1.2),
    (0.07, 0.99, 1.01, 0.001, 0.0, 0.25),
    (0.05, 2.0, 11.0, 0.7, 0.1, 1.6),
)


def population(count: int, seed: int = 1) -> list[Satrec]:
    """Satellites with elements drawn at random from REGIMES, their epochs within two days."""
    rng = np.random.default_rng(seed)
    epoch = sum(parse_utc(EPOCH)) - 2_433_281.5
    shares = np.array([r[0] for r in REGIMES])
    out: list[Satrec] = []
    for regime in rng.choice(len(REGIMES), count, p=shares / shares.sum()):
        _, slow, fast, eccentricity, low, high = REGIMES[regime]
        motion = rng.uniform(slow, fast)
        axis = (3.986008e14 / (motion * 2 * np.pi / 86_400) ** 2) ** (1 / 3)
        most = min(eccentricity, 1.0 - 6.578e6 / axis)  # perigees above 200 km
        node, perigee, anomaly = rng.uniform(0, 2 * np.pi, 3)
        satellite = Satrec()
        satellite.sgp4init(
            WGS72, "i", len(out) % 99_999, epoch + rng.uniform(-2, 2), 1e-5, 0.0, 0.0,
            rng.uniform(0, max(most, 1e-6)), perigee, rng.uniform(low, high), anomaly,
            motion * 2 * np.pi / 1440, node,
        )  # fmt: skip
        out.append(satellite)
    return out


def site(epoch: tuple[float, float]) -> Callable[[Array], tuple[Array, Array]]:
    """Place and velocity of the site at seconds after an epoch."""
    return lambda at_s: site_state(*SITE_RAD, 3055.0, instants(epoch, at_s))


def fixed(axis: Array, at_s: Array) -> Array:
    """A boresight that stays."""
    return np.broadcast_to(axis, (len(at_s), 3))


def wall_seconds(work: Callable[[], Any], times: int = 3) -> tuple[float, Any]:
    """Median seconds of the wall, and the last result."""
    taken, result = [], None
    for _ in range(times):
        started = time.perf_counter()
        result = work()
        taken.append(time.perf_counter() - started)
    return sorted(taken)[times // 2], result


def screening(count: int, dwell_s: float) -> list[dict[str, Any]]:
    """Rows of the table: zenith and an arc near the geostationary belt, fixed and scanning."""
    epoch = parse_utc(EPOCH)
    started = time.perf_counter()
    satellites = population(count)
    made_s = time.perf_counter() - started
    observer = site(epoch)
    up = unit(observer(np.array([0.0]))[0])[0]
    belt = unit(np.array([up[0], up[1], 0.0]) * 6.6 - np.array([0.0, 0.0, up[2]]))
    rows = []
    for name, axis in (("zenith", up), ("belt", belt)):
        looks = partial(fixed, axis)
        seconds, found = wall_seconds(
            partial(screen_cone, satellites, epoch, dwell_s, observer, looks, FIELD_RAD)
        )
        rows.append({
            "boresight": name, "satellites": count, "dwell_s": dwell_s, "made_s": made_s,
            "screen_s": seconds, "goal_s": GOAL_S, "kept": len(found.inside),
            "failed": len(found.failed),
        })  # fmt: skip
    return rows


def main() -> None:
    """Print the table, and write it as JSON where asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=30_000)
    parser.add_argument("--dwell", type=float, default=600.0)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    rows = screening(asked.count, asked.dwell)
    for row in rows:
        print(
            f"{row['boresight']:7} {row['satellites']} satellites, {row['dwell_s']:.0f} s: "
            f"{row['screen_s']:.2f} s (goal {row['goal_s']:.0f} s), {row['kept']} kept, "
            f"{row['failed']} failed"
        )
    if asked.json:
        machine = {"cpu": platform.processor() or platform.machine(), "cores": os.cpu_count()}
        asked.json.write_text(json.dumps({"machine": machine, "screening": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
