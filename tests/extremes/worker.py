"""A process that renders one scene after another: JSON lines in, one JSON line out for each."""

from __future__ import annotations

import ctypes
import gc
import json
import resource
import shutil
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numba.core import event

from pipeline.compile_time import EVENT, Compiling
from pipeline.errors import NightglassError, exit_code
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene

MOST_CPU_S, MOST_MEMORY_MB = 60.0, 2000.0  # a plan that predicts more is to be refused
ADDRESS_SPACE = 8 << 30  # what a process may map beyond what it maps when idle [bytes]


def main(folder: Path) -> None:
    """Answer scenes from the standard input until it ends; `folder` takes each one's product."""
    compiling = Compiling()
    event.register(EVENT, compiling)
    answers, sys.stdout = sys.stdout, sys.stderr
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + ADDRESS_SPACE, mapped + ADDRESS_SPACE))
    print(json.dumps({"ready": True}), file=answers, flush=True)
    for line in sys.stdin:
        shutil.rmtree(folder, ignore_errors=True)
        answer = rendered(json.loads(line), folder, compiling)
        print(json.dumps(answer), file=answers, flush=True)


def rendered(data: dict[str, Any], product: Path, compiling: Compiling) -> dict[str, Any]:
    """How a scene ended, what it took (CPU s, growth of the memory [MB]), and its report."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")  # the high-water mark starts anew
    before_mb, before_s, compiled_s = _status_mb("VmRSS"), time.process_time(), compiling.cpu_s
    try:
        report = render(parse_scene(data), product, _options())
        out: dict[str, Any] = {"end": "product", "errors": report["errors"]}
        out["sound"] = unsound(data, product)
    except NightglassError as refusal:
        named = exit_code(refusal) == 2 and getattr(refusal, "field", "")
        out = {"end": "refused" if named else "fault", "message": str(refusal)}
    except BaseException as fault:
        out = {"end": "fault", "message": repr(fault), "trace": traceback.format_exc()}
    spent = time.process_time() - before_s - (compiling.cpu_s - compiled_s)
    return out | {"cpu_s": spent, "growth_mb": _status_mb("VmHWM") - before_mb}


def _options() -> Options:
    known = Options.__dataclass_fields__
    most = {"most_cpu_s": MOST_CPU_S, "most_memory_mb": MOST_MEMORY_MB}
    return Options("synchronous", **{k: v for k, v in most.items() if k in known})  # type: ignore[arg-type]


def _status_mb(name: str) -> float:
    status = Path("/proc/self/status").read_text()
    return int(status.split(f"{name}:")[1].split()[0]) / 1024.0


def unsound(data: dict[str, Any], product: Path) -> str:
    """What is wrong with the layers of a product; nothing if they are finite and add up."""
    group = zarr.open_group(product / "cube.zarr", mode="r")
    layers = {name: np.asarray(group[name]).astype(float) for name in data["output"]["layers"]}
    dead = [name for name, v in layers.items() if not np.isfinite(v).all()
            and name != "calibrated_e"]  # fmt: skip
    if dead:
        return f"numbers that are not finite in {', '.join(dead)}"
    if layers["mean_e"].min() < 0.0:
        return f"a mean of {layers['mean_e'].min()} e-"
    if layers["dn"].max() > 2.0 ** data["sensor"]["adc_bits"]:
        return "more DN than the ADC has"
    if data["sensor"].get("detector") or data.get("cosmic_rays"):
        return ""
    parts = np.sum([v for k, v in layers.items() if k.endswith("_e") and k not in
                    ("mean_e", "calibrated_e")], axis=0)  # fmt: skip
    s = data["sensor"]
    noise_e = float(np.hypot(s["read_noise_e"], s["gain_e_per_dn"]))
    off = float(np.abs(parts - layers["mean_e"]).max())
    if off > 2e-6 * float(np.abs(parts).max()) + 0.1 * noise_e + 1e-6:
        return f"layers whose sum is {off:.3g} e- off the mean"
    return ""


if __name__ == "__main__":
    main(Path(sys.argv[1]))
