"""Random scenes judged: `python -m tests.extremes.fuzz 0:300` renders and judges these seeds.

Each scene is rendered in a process that is ended where a scene takes too long or too much memory.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from ruamel.yaml import YAML

from pipeline.plan.cost import START_S
from tests.extremes.scenes import LARGE_PX, random_scene
from tests.extremes.stock import ROOT, Stock, make_stock

Data = dict[str, Any]

LONGEST_S, LONGEST_CPU_S, MOST_MB = 300.0, 150.0, 6000.0  # of one scene, then its process is ended
FACTOR = 3.0  # that a forecast may be off
BASE_MB = 180.0  # of a process that has imported everything and draws nothing
FLOOR_S, FLOOR_MB = 2.0, 400.0  # less than that counts as that
STARTED_S = 2.0  # of a process that starts: importing all, which a warm one has done before
POLL_S = 0.05


@dataclass(frozen=True)
class Verdict:
    """A scene, how it ended, and what is wrong with that (nothing: it is as it should be)."""

    seed: int
    scene: Data
    answer: Data
    wrong: tuple[str, ...]

    def __str__(self) -> str:
        a = self.answer
        said = f" ({a['message'].splitlines()[0][:160]})" if a.get("message") else ""
        forecast = a.get("predicted", {})
        return (
            f"seed {self.seed}: {a['end']}{said}; {a.get('cpu_s', float('nan')):.2f} CPU s of "
            f"{forecast.get('cpu_s', float('nan')):.2f}, {a.get('growth_mb', float('nan')):.0f} MB "
            f"of {forecast.get('worker_memory_mb', float('nan')):.0f}"
            + "".join(f"\n    {w}" for w in self.wrong)
        )


class Renderer:
    """A warm process that renders scenes; a new one where the last was ended."""

    def __init__(self, folder: Path) -> None:
        self.product, self.errors = folder / "product", folder / "stderr"
        self.process: subprocess.Popen[str] | None = None
        self.lines: queue.Queue[str] = queue.Queue()

    def _start(self) -> subprocess.Popen[str]:
        with self.errors.open("w") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "tests.extremes.worker", str(self.product)], cwd=ROOT,
                env=os.environ | {"NIGHTGLASS_CACHE": str(self.product.with_name("cache"))},
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True,
            )  # fmt: skip
        self.lines = queue.Queue()
        threading.Thread(target=_pump, args=(self.process, self.lines), daemon=True).start()
        self.lines.get(timeout=LONGEST_S)
        return self.process

    def answer(self, scene: Data) -> Data:
        """What the process says of a scene; `end` is "ended" where it had to be killed, "died"
        where it ended by itself."""
        process = self.process or self._start()
        assert process.stdin is not None
        process.stdin.write(json.dumps(scene) + "\n")
        process.stdin.flush()
        answer = self._watch(process)
        plan = self.product / "plan.json"
        if plan.is_file():
            answer["predicted"] = json.loads(plan.read_text())["predicted"]
        return answer

    def _watch(self, process: subprocess.Popen[str]) -> Data:
        seen, started = psutil.Process(process.pid), time.monotonic()
        cpu_s = sum(seen.cpu_times()[:2])
        while True:
            try:
                line = self.lines.get(timeout=POLL_S)
                if line:
                    return json.loads(line)
                died = f"exit code {process.wait()}: {self.errors.read_text()[-800:]}"
                self.process = None
                return {"end": "died", "message": died}
            except queue.Empty:
                pass
            used = sum(seen.cpu_times()[:2]) - cpu_s, seen.memory_info().rss / 1e6
            if used[0] > LONGEST_CPU_S or used[1] > MOST_MB or (
                time.monotonic() - started > LONGEST_S
            ):  # fmt: skip
                where = _stack(process.pid)
                self.close()
                return {"end": "ended", "message": f"after {used[0]:.0f} CPU s at {used[1]:.0f} MB",
                        "cpu_s": used[0], "growth_mb": used[1] - BASE_MB,
                        "trace": where}  # fmt: skip

    def close(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None


def _pump(process: subprocess.Popen[str], lines: queue.Queue[str]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.put(line)
    lines.put("")


def _stack(pid: int) -> str:
    """Where a process is, if py-spy is there to tell."""
    try:
        return subprocess.run(["py-spy", "dump", "--pid", str(pid)], capture_output=True, text=True,
                              timeout=20, check=False).stdout[:3000]  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return ""


def judge(answer: Data) -> tuple[str, ...]:
    """What is wrong with how a scene ended, in words."""
    if answer["end"] not in ("product", "refused"):
        return (f"{answer['end']}: {answer.get('message', '')}",)
    return (*_refusal(answer), *_error(answer), *_forecast(answer), *_sound(answer))


def _refusal(answer: Data) -> Iterator[str]:
    """A refusal is one line that can be printed."""
    said = answer.get("message", "")
    if answer["end"] == "refused" and ("\n" in said or len(said.encode()) > 1000):
        yield f"a refusal of {said.count(chr(10)) + 1} lines and {len(said)} characters"


def _sound(answer: Data) -> Iterator[str]:
    if answer.get("sound"):
        yield f"product: {answer['sound']}"


def _error(answer: Data) -> Iterator[str]:
    """The error that the reference finds is within what the report states."""
    e = answer.get("errors", {})
    found, stated = e.get("achieved_error_sigma"), e.get("bound_of_all_approximations_sigma", 0.0)
    if found is not None and not found <= max(stated, 1e-5):
        yield (
            f"error: {found:.3g} sigma ({e['achieved_error_e']:.3g} e-), stated {stated:.3g} "
            f"({e['bound_of_all_approximations_e']:.3g} e-), asked {e['asked_sigma']:.3g}; "
            f"brightest source {e['brightest_source_e']:.3g} e-"
        )


def _forecast(answer: Data) -> Iterator[str]:
    """CPU time and memory are within FACTOR of the forecast; of a refusal, of what planning may."""
    told = answer.get("predicted") or {"cpu_s": START_S, "worker_memory_mb": 0.0}
    if too_dear := re.search(r"CPU s \(predicted: (\d+)\)", answer.get("message", "")):
        told = told | {"cpu_s": float(too_dear[1])}
    pairs = (
        ("CPU s", answer["cpu_s"] + STARTED_S, told["cpu_s"], FLOOR_S),
        ("MB", answer["growth_mb"] + BASE_MB, told["worker_memory_mb"], FLOOR_MB),
    )
    for unit, used, forecast, floor in pairs:
        if used > FACTOR * max(forecast, floor):
            yield f"forecast: {used:.1f} {unit} used, {forecast:.1f} forecast"
        if answer["end"] == "product" and forecast > FACTOR * max(used, floor):
            yield f"forecast: {used:.1f} {unit} used, {forecast:.1f} forecast, which is too much"


def run(seeds: Iterable[int], stock: Stock, side_px: int, workers: int) -> Iterator[Verdict]:
    """Verdicts of seeds in their order, from `workers` processes."""
    renderers: queue.Queue[Renderer] = queue.Queue()
    with tempfile.TemporaryDirectory() as folder:
        for k in range(workers):
            place = Path(folder) / str(k)
            place.mkdir()
            renderers.put(Renderer(place))

        def one(seed: int) -> Verdict:
            scene, renderer = random_scene(seed, stock, side_px), renderers.get()
            try:
                answer = renderer.answer(scene)
            finally:
                renderers.put(renderer)
            return Verdict(seed, scene, answer, judge(answer))

        try:
            with ThreadPoolExecutor(workers) as pool:
                yield from pool.map(one, seeds)
        finally:
            while not renderers.empty():
                renderers.get().close()


def write_yaml(scene: Data, out: Any = sys.stdout) -> None:
    """The scene, so that `nightglass render` draws it again."""
    yaml = YAML()
    yaml.default_flow_style, yaml.width = None, 1 << 20  # folded lines are other strings
    yaml.dump(scene, out)


def main() -> int:
    """The command line; ends with 1 if anything is wrong with any scene."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("seeds", help="such as 0:300, or 17")
    ask.add_argument("--workers", type=int, default=2)
    ask.add_argument("--side", type=int, default=LARGE_PX, help="largest side of a frame [px]")
    ask.add_argument("--stock", type=Path, default=Path(tempfile.gettempdir()) / "fuzz-stock")
    ask.add_argument("--keep", type=Path, help="folder for the scenes and answers of failures")
    ask.add_argument("--yaml", action="store_true", help="print the scenes and draw nothing")
    asked = ask.parse_args()
    first, _, end = asked.seeds.partition(":")
    seeds = range(int(first), int(end or int(first) + 1))
    stock, ends, bad = make_stock(asked.stock), Counter[str](), 0
    if asked.yaml:
        for seed in seeds:
            write_yaml(random_scene(seed, stock, asked.side))
        return 0
    for verdict in run(seeds, stock, asked.side, asked.workers):
        ends[verdict.answer["end"]] += 1
        print(verdict, flush=True)
        if asked.keep:
            _keep(asked.keep, verdict)
        bad += bool(verdict.wrong)
    print(f"{bad} of {sum(ends.values())} scenes are wrong; ends: {dict(ends)}")
    return int(bad > 0)


def _keep(folder: Path, verdict: Verdict) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{verdict.seed}.json").write_text(
        json.dumps({"answer": verdict.answer, "wrong": verdict.wrong}, indent=1)
    )
    if verdict.wrong:
        with (folder / f"{verdict.seed}.yaml").open("w") as file:
            write_yaml(verdict.scene, file)


if __name__ == "__main__":
    sys.exit(main())
