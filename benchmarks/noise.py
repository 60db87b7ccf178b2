"""The noise chain's speed: pixels a second of to_dn on all cores, beside numpy's generators.

Run: python -m benchmarks.noise [--json FILE]. 1024 x 1024 tiles with random means about a level:
the whole chain (photon noise, full well, read noise, gain, bias, 16-bit converter) against the same
made of Generator.poisson and Generator.normal, in turns in the same run. CPU time of one thread
(it holds on a busy machine, but for what shared cores and caches cost) and wall time of a pool.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.physics.noise.chain import to_dn
from pipeline.physics.noise.streams import poisson_image, standard_normals, stream_key
from pipeline.physics.noise.terms import Chain, StreamPlace

SIDE = 1024
LEVELS = (1e-12, 1e-3, 0.1, 1.0, 5.0, 12.0, 20.0, 100.0, 1e3, 1e5, 1e7, 1e9)
CHAIN = Chain(1.0, 0.0, 90_000.0, 5.0, 1.5, 500.0, 16)


def cpu_ns(work: Callable[[], Any], repeats: int) -> float:
    """Least CPU time of this thread [ns per pixel]."""
    work()
    times = []
    for _ in range(repeats):
        started = time.thread_time()
        work()
        times.append(time.thread_time() - started)
    return min(times) / SIDE**2 * 1e9


def place(frame: int) -> StreamPlace:
    keys = [stream_key(1, n) for n in ("photon_noise", "read_noise", "photon_and_read_noise")]
    return StreamPlace(0, 0, frame, *keys)


def level(mean_e: float, repeats: int, workers: int) -> dict[str, float]:
    """One level of light: this chain and numpy's draws, ns a pixel and millions a second."""
    rng = np.random.default_rng(7)
    mean = mean_e * rng.uniform(0.9, 1.1, (SIDE, SIDE))
    photon, read = place(0).photon_key, place(0).read_key

    def plain() -> None:
        signal = np.minimum(rng.poisson(mean), 90_000.0) + rng.normal(0.0, 5.0, mean.shape)
        np.clip(np.rint(signal / 1.5 + 500.0), 0, 65535).astype(np.uint16)

    row = {
        "mean_e": mean_e,
        "chain_ns": cpu_ns(lambda: to_dn(mean, CHAIN, place(0)), repeats),
        "poisson_ns": cpu_ns(lambda: poisson_image(mean, 0, 0, 0, *photon), repeats),
        "normal_ns": cpu_ns(lambda: standard_normals(SIDE, SIDE, 0, 0, 0, *read), repeats),
        "numpy_chain_ns": cpu_ns(plain, repeats),
        "numpy_poisson_ns": cpu_ns(lambda: rng.poisson(mean), repeats),
        "numpy_normal_ns": cpu_ns(lambda: rng.normal(0.0, 5.0, mean.shape), repeats),
    }
    with ThreadPoolExecutor(workers) as pool:
        started = time.perf_counter()
        list(pool.map(lambda k: to_dn(mean, CHAIN, place(k)), range(4 * workers)))
        wall = time.perf_counter() - started
    row["wall_mpx_s"] = 4 * workers * SIDE**2 / wall / 1e6
    row["cpu_mpx_s_core"] = 1e3 / row["chain_ns"]
    row["times_numpy"] = row["numpy_chain_ns"] / row["chain_ns"]
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    args = parser.parse_args()
    rows = []
    for mean_e in LEVELS:
        rows.append(level(mean_e, args.repeats, args.workers))
        r = rows[-1]
        print(
            f"{mean_e:>8g} e-: chain {r['chain_ns']:5.1f} ns ({r['cpu_mpx_s_core']:5.1f} Mpx/s a "
            f"core; {r['wall_mpx_s']:5.1f} on {args.workers}), numpy {r['numpy_chain_ns']:6.1f} "
            f"ns: {r['times_numpy']:.1f} times; Poisson {r['poisson_ns']:.1f} of "
            f"{r['numpy_poisson_ns']:.1f}, normal {r['normal_ns']:.1f} of "
            f"{r['numpy_normal_ns']:.1f}"
        )
    if args.json:
        busy = os.getloadavg()[0]
        machine = f"{platform.machine()}, {os.cpu_count()} cores, load {busy:.1f}"
        found = {"machine": machine, "side_px": SIDE, "workers": args.workers, "levels": rows}
        args.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
