"""What sweeps tell: their designs, forecasts, tables, pages and refusals, pinned."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.spec.load import parse_yaml
from pipeline.spec.sweep_load import parse_sweep
from pipeline.sweep.design import Design
from pipeline.sweep.figure import figure
from tests.pins.draw import _columns, _cube
from tests.pins.scenes import IN_ORBIT, LIGHTS, SPHERE
from tests.pins.test_told_cli import (
    ahead,
    arrays,
    files,  # noqa: F401
    here,  # noqa: F401
    leaves,
    masked,
    runs,
    write_scene,
)
from tests.pins.told import check_told

NOISE, GAIN = "sensor.read_noise_e", "sensor.gain_e_per_dn"
RA, DEC = "pointing.boresight_ra_deg", "pointing.boresight_dec_deg"
SWEEPS = parse_yaml("""
grid: {scene: seen.json, seeds: 2, cubes: [1], detection: {threshold_sigma: 4.0, search_px: 2.0},
  axes: [{field: sensor.read_noise_e, values: [9.0, 3.0]},
    {field: pointing.boresight_ra_deg, kind: range, start: 80.0, stop: 240.0, count: 2}]}
zip: {scene: seen.json, design: {kind: zip}, targets: [t],
  metrics: [snr, saturation, limiting_magnitude],
  axes: [{kind: table, fields: [sensor.dark_e_per_s, targets.0.body.albedo],
      rows: [[1.0, 0.2], [5.0, 0.3]]},
    {field: sensor.gain_e_per_dn, kind: log_range, start: 0.5, stop: 50.0, count: 2}]}
sobol: {scene: starry.json, design: {kind: sobol, points: 3, seed: 3}, cubes: [1],
  metrics: [background, limiting_magnitude],
  axes: [{field: sensor.adc_bits, kind: range, start: 8, stop: 16, integer: true},
    {field: background.uniform_e_per_s, values: [9, 90]},
    {field: sensor.dark_e_per_s, values: [even.npy, 2.0]},
    {field: stars.faintest_g_mag, kind: range, start: 11.0, stop: 12.0}]}
latin: {scene: extra.json, design: {kind: latin_hypercube, points: 2}, seeds: 2,
  metrics: [background, saturation, limiting_magnitude, snr, detection],
  axes: [{field: sensor.photon_noise, values: [true, false]},
    {field: sensor.flat, values: [even.npy, 0.7]},
    {field: exposure.integration_s, values: [0.5, 1]},
    {field: sensor.read_noise_e, values: [9.0, 3.0]}]}
""")
MORE = parse_yaml("""
many: {scene: seen.json, design: {kind: sobol, points: 4200}, seeds: 3,
  axes: [{kind: table, fields: [seed, targets.0.body.albedo], rows: [[1, 0.2], [5, 0.3]]},
    {field: sensor.gain_e_per_dn, kind: log_range, start: 0.5, stop: 50.0}]}
large: {scene: seen.json, axes: [
    {field: sensor.read_noise_e, kind: range, start: 1.0, stop: 9.0, count: 2000},
    {field: pointing.boresight_ra_deg, kind: range, start: 80.0, stop: 81.0, count: 500},
    {field: sensor.dark_e_per_s, values: [1.0, 5.0]}]}
""")
REFUSED = parse_yaml("""
no scene: {scene: none.json, axes: [{field: sensor.read_noise_e, values: [1]}]}
a list: {scene: list.json, axes: [{field: sensor.read_noise_e, values: [1]}]}
a field: {scene: seen.json, axes: [{field: sensor.nothing.x, values: [1]}]}
no such target: {scene: seen.json, axes: [{field: targets.7.body.albedo, values: [1]}]}
a value: {scene: seen.json, axes: [{field: sensor.read_noise_e, values: [1, -1]}]}
together: {scene: seen.json, axes: [{field: exposure.frames, values: [0]}]}
a target: {scene: seen.json, axes: [{field: seed, values: [1, 2]}], targets: [u]}
the sun: {scene: seen.json, axes: [{kind: table, rows: [[240.0, -20.0], [241.0, -20.0]],
  fields: [pointing.boresight_ra_deg, pointing.boresight_dec_deg]}]}
no axis: {scene: seen.json, axes: []}
zip: {scene: seen.json, design: {kind: zip}, axes: [{field: sensor.gain_e_per_dn, values: [1]},
  {field: sensor.read_noise_e, values: [1, 2]}]}
""")


def write_sweep(name: str, wish: dict[str, Any]) -> str:
    Path(f"{name}.sweep").write_text(
        json.dumps({"schema": "nightglass/sweep/1", "name": name} | wish)
    )
    return f"{name}.sweep"


@pytest.fixture(autouse=True)
def scenes() -> None:
    """The base scenes: of a target, of stars, of a detector with extras."""
    small = {"sensor.shape": [16, 24], "accuracy.check_cells": 0}
    seen = {
        "observer": IN_ORBIT,
        "targets": [ahead(SPHERE, "t", 4e6), ahead(SPHERE, "o", 4e6, 30.0)],
        "background": {"uniform_e_per_s": 5.0},
    }
    write_scene("seen", small | seen)
    write_scene(
        "starry",
        small
        | {
            "stars": {"catalogue": "@stars"},
            "background": {"uniform_e_per_s": 5.0},
            "output.layers": LIGHTS,
            "exposure.integration_s": 0.5,
        },
    )
    write_scene(
        "extra",
        small
        | {
            "sensor.detector": {"row_noise_e": 2.0, "lag": {"fraction": 0.05}},
            "sensor.full_well_e": 9e4,
            "exposure.frames": 2,
        },
    )
    np.save("even.npy", np.linspace(0.5, 1.0, 384).reshape(16, 24))
    Path("list.json").write_text("[1]")


def test_designs() -> None:
    """Values, seeds, extremes and order of the points of each design; figures of a few columns."""
    told = ""
    for name, wish in (SWEEPS | MORE).items():
        design = Design(parse_sweep({"schema": "nightglass/sweep/1", "name": name} | wish))
        told += f"{name}: {design.size} points\n"
        for point in sorted({*range(min(design.size, 8)), design.size // 2, design.size - 1}):
            values = {
                k: f"{v:.12g}" if isinstance(v, float) else v
                for k, v in design.values(point).items()
            }
            told += f"  {point}: {values} seed + {design.seed_step(point)}\n"
        fields = [field for axis in design.axes for field in axis.fields]
        told += f"  {[design.extremes(field)[-2:] for field in (*fields, 'nothing')]}\n"
        for last in ((), (NOISE,), (RA, GAIN)):
            order = design.order(frozenset(last))
            told += f"  last {last}: {[next(order, None) for _ in range(12)]}\n"
    columns = {
        "a": np.array([1.0, 2.0, np.nan, 100.0]),
        "<b>": np.array([-1.0, 0.5, 3.0, 4.0]),
        "c": np.full(4, 7.0),
        "d": np.linspace(1.0, 2.0, 4),
    }
    told += figure(columns, ["a", "<b>", "c"], ["d", "a"]).replace("<", "\n<")
    long = {"x": np.arange(9000.0), "y": np.arange(9000.0) % 7}
    told += f"\n{figure(long, ['x'], ['y']).count('h0')} dots\n"
    check_told("cli/designs", told)


@pytest.mark.parametrize("name", SWEEPS)
def test_sweep(name: str) -> None:
    """A sweep forecast, run, gone on with: words, files, report, page, figure, table."""
    import pyarrow.parquet as pq

    out, file = Path("swept"), write_sweep(name, SWEEPS[name])
    shutil.rmtree(out, ignore_errors=True)
    run = f"sweep {file} -o swept --scheduler synchronous"
    told = runs(f"sweep {file} --dry-run --json", run)
    told += "".join(
        f"{p.relative_to(out)}\n" for p in sorted(out.glob("*")) + sorted(out.glob("cubes/*"))
    )
    table = pq.read_table(out / "points.parquet")
    told += "".join(f"{f.name}: {f.type}\n" for f in table.schema)
    kept = [n for n in table.column_names if n not in ("seconds", "light_s", "content_digest")]
    told += arrays(_columns(table.select(kept)))
    for one in ("report.json", "sweep.json")[: 2 if name == "latin" else 1]:
        told += f"{one}\n" + "\n".join(leaves(json.loads((out / one).read_text()))) + "\n"
    if name == "grid":
        told += "\n".join(runs(f"sweep {file} --point 5").splitlines()[:14]) + "\n"
    else:  # its metrics are not of time
        told += masked((out / "summary.html").read_text().replace("<", "\n<"))
    for point in sorted(out.glob("cubes/*"))[:1]:
        told += runs(f"check {point.as_posix()}") + (
            arrays({"dn": _cube(point)["dn"]}) if name == "grid" else ""
        )
    sealed = json.loads((out / "_COMPLETE").read_text())
    begun = json.loads((out / ".begun.json").read_text())
    told += f"{sealed['format']} {[*sealed['files']]} {sorted(begun)}"
    check_told(f"cli/sweep-{name}", told, folder=Path.cwd())


def test_going_on() -> None:
    """Sweeps that are there, cut off, damaged, others; what is refused."""
    shutil.rmtree("swept", ignore_errors=True)
    shutil.rmtree("empty", ignore_errors=True)
    file = write_sweep(
        "again",
        {
            "scene": "seen.json",
            "metrics": ["background", "snr"],
            "axes": [
                {
                    "kind": "table",
                    "fields": [RA, DEC],
                    "rows": [[80.0, 20.0], [240.0, -20.0], [80.1, 20]],
                },
            ],
        },
    )
    run = f"sweep {file} -o swept --scheduler synchronous"
    told = runs(
        f"{run} --resume",
        run,
        run,
        f"{run} --resume",
        f"{run} --retry-failed --json",
        f"sweep {file} --dry-run",
        f"sweep {file} --point 3",
        f"sweep {file} --point -1",
    )
    Path("swept/_COMPLETE").unlink()
    Path("swept/parts/part-0000007.parquet").write_bytes(b"worse")
    told += runs(f"{run} --resume --json")
    for name in MORE:
        told += runs(f"sweep {write_sweep(name, MORE[name])} --dry-run --json")
    told += runs(f"sweep {write_sweep('grid', SWEEPS['grid'])} -o swept --resume")
    Path("swept/.begun.json").write_text("[")
    told += runs(f"{run} --resume")
    Path("swept/.begun.json").unlink()
    told += runs(f"""
        {run} --resume
        sweep {file} -o seen.json/x
        sweep none.sweep
        sweep seen.json
        {run} --retry-failed --server x
        sweep {file} -o s3://b/n
    """)
    for name, wish in REFUSED.items():
        told += f"--- {name}\n" + runs(
            f"sweep {write_sweep('no', wish)} -o no --scheduler synchronous"
        )
    assert not Path("no").exists()
    check_told("cli/sweeps", told, folder=Path.cwd())
