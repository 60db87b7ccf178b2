"""A sweep of detector settings against what it must cost: its noise chains and one sky.

Run: python -m benchmarks.sweep [--points N] [--side PX] [--stars N] [--json FILE]. All in one
process, in CPU seconds, so that other load on the machine does not matter. "sky" is everything of
one render before the noise (plan, stars read and placed, light drawn); "chain" what a render does
with the light of its tiles: flat, dark, photon noise, read noise, digital numbers. The sweep also
measures every point (SNR, background, limit, saturation, digest) and writes its table and page.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")


def cpu_s(work: Callable[[], Any]) -> tuple[Any, float]:
    """What a call gives, and the CPU seconds that it took."""
    started = time.process_time()
    return work(), time.process_time() - started


def sweep_data(catalogue: Path, side: int, points: int) -> dict[str, Any]:
    """A sweep over read noise, gain, bias, full well and dark, zipped."""
    from benchmarks.frame import scene

    base = scene(catalogue, 1, {"kind": "airy"}, 0.0)
    base["sensor"]["shape"] = [side, side]
    spans = {
        "sensor.read_noise_e": (1.0, 20.0), "sensor.gain_e_per_dn": (0.5, 4.0),
        "sensor.bias_dn": (100.0, 1000.0), "sensor.full_well_e": (2e4, 2e5),
        "sensor.dark_e_per_s": (0.1, 5.0),
    }  # fmt: skip
    axes = [
        {"field": name, "kind": "range", "start": low, "stop": high, "count": points}
        for name, (low, high) in spans.items()
    ]
    return {
        "schema": "nightglass/sweep/1", "name": "detector", "scene": base, "axes": axes,
        "design": {"kind": "zip"},
    }  # fmt: skip


def measure(folder: Path, catalogue: Path, side: int, points: int) -> dict[str, Any]:
    """CPU seconds of one sky, of all chains, and of the sweep; their ratio."""
    from pipeline.execute.tile import TileSources, render_tile
    from pipeline.route.run import Options
    from pipeline.sweep.points import scene_of, with_floor
    from pipeline.sweep.run import gather_course, sweep
    from pipeline.sweep.stages import Stages, maps_of, point_plan

    path = folder / "sweep.json"
    path.write_text(json.dumps(sweep_data(catalogue, side, points)))
    course = gather_course(path, folder / "out")
    design = course.design

    def sky(kept: Stages) -> Any:
        _, base = with_floor(course, kept, scene_of(course, design, 0))
        g = kept.geometry(base, 0)
        return base, g, [(tile, kept.light(base, g, tile)) for tile in base.plan.tiles]

    sky(Stages(1e9))  # compiled code, colour fit: as in a process that has rendered before
    kept = Stages(1e9)
    (base, g, tiles), sky_s = cpu_s(lambda: sky(kept))
    plans = []
    for k in range(points):
        scene, _ = with_floor(course, kept, scene_of(course, design, k))
        maps = maps_of(kept, base, scene)
        plans.append((point_plan(base, scene, maps), maps))

    def chains() -> None:
        for plan, maps in plans:
            for tile, light in tiles:
                render_tile(plan, maps, g, tile, TileSources([], [], None, light))

    render_tile(*plans[0], g, tiles[0][0], TileSources([], [], None, tiles[0][1]))
    _, chains_s = cpu_s(chains)
    report, sweep_s = cpu_s(lambda: sweep(path, folder / "out", Options("synchronous")))
    assert report["failed"] == 0
    return {
        "points": points, "side_px": side, "sky_cpu_s": sky_s, "chains_cpu_s": chains_s,
        "chain_cpu_s": chains_s / points, "sweep_cpu_s": sweep_s,
        "ratio": sweep_s / (chains_s + sky_s),
        "ratio_to_single_renders": sweep_s / (chains_s + points * sky_s),
    }  # fmt: skip


def main() -> None:
    from benchmarks.frame import make_catalogue

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--side", type=int, default=1024)
    parser.add_argument("--stars", type=int, default=20_000)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = measure(folder, make_catalogue(folder, args.stars), args.side, args.points)
    print(
        f"{found['points']} detector settings of {found['side_px']} px: sky "
        f"{found['sky_cpu_s']:.2f} s, chain {found['chain_cpu_s']:.3f} s, "
        f"sweep {found['sweep_cpu_s']:.2f} s (CPU): "
        f"{found['ratio']:.2f} x (chains + one sky), "
        f"{found['ratio_to_single_renders']:.2f} x as many skies"
    )
    if args.json:
        machine = f"{platform.machine()}, {platform.python_version()}"
        told = {"machine": machine, "stars": args.stars} | found
        args.json.write_text(json.dumps(told, indent=2) + "\n")


if __name__ == "__main__":
    main()
