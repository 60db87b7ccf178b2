"""Random scenes told in two ways: what is observed is the truth, a sweep's points those alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.errors import NightglassError
from pipeline.observe.observe import OF_TRUTH, observe
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.product import content_digest
from pipeline.sweep.run import point_scene, sweep
from tests.extremes.scenes import random_scene
from tests.extremes.stock import Stock
from tests.slow import slow

FEW = Options("synchronous", most_cpu_s=15.0, most_memory_mb=2000.0)
CHEAP = Options("synchronous", most_cpu_s=5.0, most_memory_mb=1000.0)
Data = dict[str, Any]


@pytest.mark.parametrize(("seeds", "least"), [slow(range(90), 30)])
def test_what_is_observed_is_the_truth(
    seeds: range, least: int, stock: Stock, tmp_path: Path
) -> None:
    """Every digit, of targets whose light reaches the frame; places, of all others."""
    compared = 0
    for seed in seeds:
        scene, out = parse_scene(random_scene(seed, stock, 128)), tmp_path / str(seed)
        try:
            render(scene, out, FEW)
        except NightglassError:
            continue
        file = out / "truth" / "targets.parquet"
        if not file.exists():  # a scene without any
            continue
        truth = pq.read_table(file).to_pylist()
        seen = {(r["frame"], r["name"]): r for r in observe(scene).table.to_pylist()}
        for row in truth:
            own = seen[row["frame"], row["name"]]
            drawn = own["snr_at"] == "frame"
            for name in OF_TRUTH if drawn else ("x_px", "y_px", "ra_deg", "dec_deg", "range_m"):
                same = np.array_equal(own[name], row[name], equal_nan=True)
                assert same, (seed, row["name"], name, own[name], row[name])
            compared += 1
    assert compared >= least


def numbers(data: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a scene, with its dotted name."""
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in items:
        inner = f"{name}.{key}" if name else str(key)
        if isinstance(value, dict | list):
            yield from numbers(value, inner)
        elif isinstance(value, float) and np.isfinite(value):
            yield inner, value


def axes_of(rng: np.random.Generator, scene: Data) -> list[Data]:
    """Two values of a number of each of two parts of a scene, the scene's own first or last."""
    parts = [k for k in scene if k not in ("accuracy", "output") and [*numbers({k: scene[k]})]]
    axes = []
    for part in rng.permutation(parts)[:2]:
        of_part = [*numbers({str(part): scene[str(part)]})]
        field, value = of_part[rng.integers(len(of_part))]
        values = [value, 1.25 * value if value else 0.01]
        axes.append({"field": field, "values": values[:: rng.choice([1, -1])]})
    return axes


@pytest.mark.parametrize(("seeds", "least"), [slow(range(2000, 2040), 8)])
def test_points_of_random_sweeps_are_those_of_each_alone(
    seeds: range, least: int, stock: Stock, tmp_path: Path
) -> None:
    """The last point of four, which shares what it can with those before, bit by bit."""
    compared = 0
    for seed in seeds:
        rng, data, out = np.random.default_rng(seed), random_scene(seed, stock, 64), tmp_path
        data["output"]["layers"], data["exposure"]["frames"] = ["dn"], 1
        file, swept = out / f"{seed}.json", out / f"swept-{seed}"
        asked = {"schema": "nightglass/sweep/1", "name": "any", "scene": data}
        file.write_text(json.dumps(asked | {"axes": axes_of(rng, data)}))
        try:
            render(parse_scene(data), out / f"own-{seed}", CHEAP)  # of what a sweep may draw
            sweep(file, swept, FEW)
        except NightglassError:
            continue
        row = pq.read_table(swept / "points.parquet").to_pylist()[-1]
        if row["message"] is None:
            render(point_scene(file, row["point"]), out / str(seed), FEW)
            assert content_digest(out / str(seed)) == row["content_digest"], seed
            compared += 1
    assert compared >= least
