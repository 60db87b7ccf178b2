"""Writes a store again and again on a disk that fills up later each time, then goes on with it.

`python -m tests.full_disk.child STORE FOLDER STEP MOST` prints a JSON line for each attempt: what
the command line said, whether anything looked whole, and whether going on gave the same bits.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from catalog_tools.catalogue import MANIFEST_NAME
from pipeline.sweep import ledger
from tests.command import nightglass
from tests.full_disk.disk import Disk

SCENE: dict[str, Any] = {
    "schema": "nightglass/scene/1", "name": "full", "epoch": "2019-04-20T03:00:00Z", "seed": 7,
    "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3},
    "sensor": {
        "shape": [64, 64], "pixel_pitch_um": 13.5, "focal_length_m": 1.0, "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0},
    "pointing": {"mode": "target", "target": "sat-1"},
    "exposure": {"integration_s": 2.0, "frames": 3, "cadence_s": 5.0},
    "targets": [{
        "name": "sat-1",
        "orbit": {"kind": "state", "position_m": [-39e6, 14e6, 1e4],
                  "velocity_m_s": [-1000.0, -2900.0, 0.0]},
        "body": {"kind": "sphere", "diameter_m": 3.0, "albedo": 0.2}}],
    "cosmic_rays": {"kind": "generated", "rate_per_cm2_s": 20.0},
    "background": {"uniform_mag_arcsec2": 21.5},
}  # fmt: skip
SWEEP: dict[str, Any] = {
    "schema": "nightglass/sweep/1", "name": "full", "scene": "scene.json", "cubes": [1, 3],
    "axes": [{"field": "exposure.integration_s", "values": [1.0, 2.0]},
             {"field": "sensor.read_noise_e", "values": [3.0, 5.0]}],
}  # fmt: skip


@dataclass(frozen=True)
class Store:
    """How a store is begun and gone on with, what says that it is whole, which files are it."""

    command: Callable[[Path, bool], tuple[str, ...]]
    seal: str
    files: tuple[str, ...]


def stores(inputs: Path) -> dict[str, Store]:
    """The stores of the command line; their inputs are made below a folder."""
    (inputs / "scene.json").write_text(json.dumps(SCENE))
    (inputs / "sweep.json").write_text(json.dumps(SWEEP))
    _write_stars(inputs / "stars.csv")
    threads = ("--scheduler", "synchronous")

    def again(resume: bool) -> tuple[str, ...]:
        return ("--resume",) if resume else ()

    return {
        "product": Store(
            lambda out, r: ("render", f"{inputs}/scene.json", "-o", str(out), *threads, *again(r)),
            "_COMPLETE", ("cube.zarr/dn/**/*", "markers/*", "truth/*.parquet"),
        ),
        "part": Store(
            lambda out, _: ("render", f"{inputs}/scene.json", "-o", str(out), "--part", "1/1"),
            "_COMPLETE", ("cube.zarr/dn/**/*", "markers/*", "truth/*.parquet"),
        ),
        "sweep": Store(
            lambda out, r: ("sweep", f"{inputs}/sweep.json", "-o", str(out), *threads, *again(r)),
            "_COMPLETE", ("cubes/*/cube.zarr/dn/**/*", "cubes/*/truth/*.parquet"),
        ),
        "catalogue": Store(
            lambda out, _: ("catalog", "ingest", f"{inputs}/stars.csv", "-o", str(out),
                            "--rows-per-leaf", "1000"),
            MANIFEST_NAME, ("dataset/**/*", "partition_info.csv", "*map.fits"),
        ),
    }  # fmt: skip


def _write_stars(path: Path) -> None:
    """3000 stars over the sky, one of them twice."""
    rng = np.random.default_rng(4)
    ra, dec = rng.uniform(0, 360, 3000), np.degrees(np.arcsin(rng.uniform(-1, 1, 3000)))
    rows = ["source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
            "phot_bp_mean_mag,phot_rp_mean_mag"]  # fmt: skip
    rows += [
        f"{max(i, 1)},2015.5,{ra[i]:.9f},{dec[i]:.9f},1,0,0,,{9 + i / 300:.4f},10,9"
        for i in range(3000)
    ]
    path.write_text("\n".join(rows) + "\n")


def bits(out: Path, files: tuple[str, ...]) -> str:
    """Digest of a store's files, names and bytes; of a sweep's table without its times."""
    found = sorted({p for pattern in files for p in out.glob(pattern) if p.is_file()})
    digest = hashlib.sha256()
    for path in found:
        digest.update(f"{path.relative_to(out)}\0".encode() + path.read_bytes())
    if (out / ledger.TABLE).is_file():
        import pyarrow.parquet as pq

        table = pq.read_table(out / ledger.TABLE)
        digest.update(repr(table.drop_columns(["seconds", "light_s"]).to_pydict()).encode())
    return f"{len(found)} {digest.hexdigest()}"


def main() -> None:
    """Attempts at STORE below FOLDER, full at every STEP-th write, at most MOST spread over all."""
    name, folder = sys.argv[1], Path(sys.argv[2])
    step, most = int(sys.argv[3]), int(sys.argv[4])
    store, disk = stores(folder)[name], Disk(Path(os.environ["FULL_DISK"]))
    ledger.PART_S = 0.0  # rows become durable group by group
    whole = folder / f"{name}-whole" / "out"
    whole.parent.mkdir()
    disk.fill(whole.parent, 0)
    first = nightglass(*store.command(whole, False))
    assert first.returncode == 0, first.stderr
    wanted = bits(whole, store.files)
    chosen = list(range(step, disk.writes + 1, step))
    if len(chosen) > most:
        chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, most).astype(int)]
    print(json.dumps({"writes": disk.writes, "chosen": chosen, "bits": wanted}))
    for at in chosen:
        place = folder / f"{name}-{at:04d}"
        place.mkdir()
        out = place / "out"
        disk.fill(place, at)
        stopped = nightglass(*store.command(out, False))
        refused = disk.refused
        disk.make_room()
        looks_whole = (out / store.seal).exists()
        resume = out.exists()
        gone_on = nightglass(*store.command(out, resume))
        left = [p.name for p in out.rglob("*") if p.suffix in (".tmp", ".partial", ".part")]
        told = {
            "at": at, "refused": refused, "code": stopped.returncode, "said": stopped.stderr,
            "printed": stopped.stdout, "looks_whole": looks_whole, "again": gone_on.returncode,
            "again_said": gone_on.stderr, "same": bits(out, store.files) == wanted, "left": left,
        }  # fmt: skip
        print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
