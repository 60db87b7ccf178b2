"""Draws stars with SatSim: run by a Python that has it, apart from ours, on one npz file.

python satsim_worker.py IN.npz OUT.npz: `jobs` many lists of stars in, images and CPU seconds out.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("CUDA_VISIBLE_DEVICES", "-1")
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
os.environ.setdefault("TF_NUM_INTRAOP_THREADS", "1")
os.environ.setdefault("TF_NUM_INTEROP_THREADS", "1")

import numpy as np

KERNEL_PX = 33  # of the table mode's stamps


def main(source: str, target: str) -> None:
    import tensorflow as tf

    tf.config.threading.set_intra_op_parallelism_threads(1)
    tf.config.threading.set_inter_op_parallelism_threads(1)
    job = dict(np.load(source))
    started = time.process_time()
    draw = prepare(job)
    out: dict[str, Any] = {"table_s": time.process_time() - started}
    out["probe"] = draw(job["probe_x"], job["probe_y"], np.ones(job["probe_x"].size))
    started = time.process_time()
    draw(job["x"], job["y"], np.ones(job["x"].size))
    out["cpu_s"] = time.process_time() - started
    np.savez(target, **out)


def prepare(job: dict[str, Any]) -> Callable[..., np.ndarray]:
    """A function from stars to an image, in SatSim's FFT or table ("epsf") mode."""
    from satsim.image.epsf import build_epsf_lut
    from satsim.image.render import render_epsf, render_full

    rows, columns, osf, pad = (int(job[k]) for k in ("rows", "columns", "osf", "pad"))
    whole = (rows + 2 * pad) * osf, (columns + 2 * pad) * osf
    sweep = np.array([job["sweep_y"], job["sweep_x"]], float) * osf
    steps = int(job["steps"])
    table_mode = bool(job["table"])
    side = 2 * KERNEL_PX * osf
    psf = point_spread(job, osf, (side, side) if table_mode else whole)
    lut = build_epsf_lut(psf, osf, KERNEL_PX, phase_oversample=1) if table_mode else None

    def draw(x: np.ndarray, y: np.ndarray, light: np.ndarray) -> np.ndarray:
        # Sub-pixel i stands at (i + 0.5) / osf - 0.5 pixels; the sweep starts at time 0.
        c = (x + pad + 0.5) * osf - 0.5 - 0.5 * sweep[1]
        r = (y + pad + 0.5) * osf - 0.5 - 0.5 * sweep[0]
        none = np.zeros(0, np.float32)
        common = (none, none, none, *(a.astype(np.float32) for a in (r, c, light)))
        motion = (0.0, 1.0, steps, 0.0, [float(sweep[0]), float(sweep[1])])
        size = (rows * osf, columns * osf, *whole, pad * osf, pad * osf, osf)
        if lut is not None:  # its stamps are too small for a table of the streak: step by step
            image = render_epsf(
                *size,
                lut,
                *common,
                *motion,
                psf_os=psf,
                render_separate=False,
                star_render_mode="transform",
            )[0]
        else:
            mode = "streak" if steps > 1 else "transform"
            image = render_full(
                *size, psf, *common, *motion, render_separate=False, star_render_mode=mode
            )[0]
        return np.asarray(image, float)

    return draw


def point_spread(job: dict[str, Any], osf: int, shape: tuple[int, int]) -> Any:
    """The point-spread function on SatSim's oversampled grid, its own Gaussian where it is one."""
    from satsim.image.psf import gen_gaussian

    if float(job["sigma"]) > 0:
        return gen_gaussian(*shape, float(job["sigma"]) * osf)
    from scipy.special import j1

    q, e = float(job["q"]), float(job["obscuration"])
    at = [(np.arange(n) - 0.5 * n + 0.5) / osf for n in shape]
    v = np.pi / q * np.hypot(at[0][:, None], at[1][None, :])
    field = 2.0 * (j1(v) - e * j1(e * v)) / v
    light = np.pi / (4.0 * q**2 * (1.0 - e * e)) * field**2 / osf**2
    return light.astype(np.float32)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
