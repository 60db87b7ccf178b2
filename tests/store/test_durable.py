"""What a power cut leaves: a record gets its name only after all that it vouches for is on disk.

Every fsync and every renaming is noted, with what the file was at that moment.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import pyarrow as arrow
import pytest
from pyarrow import parquet

from catalog_tools.errors import DiskFull
from catalog_tools.fetch.ledger import FileLedger, write_whole
from catalog_tools.ingest.ingest import ingest
from catalog_tools.storage.durable import (
    file_digest,
    full_disk_told,
    whole_file,
    write_atomically,
)
from pipeline.opened_product import TruthTables
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.markers import read_marker

SCENE = {
    "schema": "nightglass/scene/1",
    "name": "durable",
    "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "fixed", "position_au": [1.0, 0.1, 0.0]},
    "sensor": {
        "shape": [256, 512], "pixel_pitch_um": 9.0, "focal_length_m": 0.5, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 60.0, "boresight_dec_deg": 5.0},
    "exposure": {"integration_s": 1.0, "frames": 2},
    "cosmic_rays": {"kind": "generated", "rate_per_cm2_s": 5.0},
    "output": {"layers": ["dn", "mean_e"], "tile_shape": [256, 256]},
}  # fmt: skip


class Disk:
    """Notes of what was brought to the disk and what was named, in order."""

    def __init__(self, patch):
        self.synced, self.named = [], []
        real = {name: getattr(os, name) for name in ("fsync", "replace", "rename")}

        def fsync(number):
            real["fsync"](number)
            path = Path(f"/proc/self/fd/{number}").readlink()
            self.synced.append((len(self.synced) + len(self.named), path, state(path)))

        def named(name):
            def moved(source, target):
                before = state(source)
                real[name](source, target)
                at = len(self.synced) + len(self.named)
                self.named.append((at, Path(source), Path(target), before))

            return moved

        patch.setattr(os, "fsync", fsync)
        for name in ("replace", "rename"):
            patch.setattr(os, name, named(name))

    def name_of(self, path):
        """When a path got its name for the last time, and from which other one."""
        return next((at, source) for at, source, target, _ in self.named[::-1] if target == path)

    def had(self, path, before, after=-1):
        """Whether a file or folder was on disk as it is now, between two moments."""
        now = state(path)
        return any(after < at < before and p == path and was == now for at, p, was in self.synced)


def state(path):
    """Of a file its size and time of change; a folder is told from others by its path alone."""
    at = Path(path).stat()
    return (at.st_size, at.st_mtime_ns) if Path(path).is_file() else None


@pytest.fixture
def disk(monkeypatch):
    return Disk(monkeypatch)


def judge_atomic(disk, path):
    """Content first, then the name, then the folder."""
    at, source = disk.name_of(path)
    assert any(t < at and p == source and s == state(path) for t, p, s in disk.synced), path
    assert disk.had(path.parent, before=1 << 60, after=at), path


def test_small_files_are_on_disk_before_they_have_their_name(tmp_path, disk):
    write_atomically(tmp_path / "a.json", "{}")
    with whole_file(tmp_path / "b.bin") as own:
        own.write_bytes(bytes(5000))
    for name in ("a.json", "b.bin"):
        judge_atomic(disk, tmp_path / name)


def test_a_fetched_file_is_on_disk_before_it_has_its_name_and_is_noted(tmp_path, disk):
    """And the list of the archive's files before it has its own."""
    (tmp_path / ".fetch" / "parts").mkdir(parents=True)
    ledger = FileLedger(tmp_path)
    ledger.part("stars.gz").write_bytes(bytes(5000))
    ledger.publish("stars.gz", "0" * 32)
    judge_atomic(disk, tmp_path / "stars.gz")
    assert FileLedger(tmp_path).md5_of("stars.gz") == "0" * 32
    [record] = (tmp_path / ".fetch").glob("*.jsonl")
    record.write_bytes(record.read_bytes()[:-9])  # killed as it wrote that line
    for name in ("a.gz", "b.gz"):
        (tmp_path / name).write_bytes(b"x")
        FileLedger(tmp_path).add(name, "1" * 32)
    noted = [FileLedger(tmp_path).md5_of(name) for name in ("stars.gz", "a.gz", "b.gz")]
    assert noted == [None, "1" * 32, "1" * 32]
    write_whole(tmp_path, "MD5SUM.txt", b"list")
    at, source = disk.name_of(tmp_path / "MD5SUM.txt")
    now = state(tmp_path / "MD5SUM.txt")
    assert any(t < at and p == source and was == now for t, p, was in disk.synced)


def test_records_of_a_product_vouch_for_what_is_on_disk(tmp_path, disk):
    """The beginning for the cube's metadata, a marker for its chunks, the seal for all else."""
    product = tmp_path / "run"
    render(parse_scene(SCENE), product, Options("synchronous"))
    begun, sealed = product / ".begun.json", product / "_COMPLETE"
    markers = sorted((product / "markers").iterdir())
    assert len(markers) == 4
    for record in (begun, sealed, *markers):
        judge_atomic(disk, record)
    begun_at, sealed_at = (disk.name_of(record)[0] for record in (begun, sealed))
    assert disk.name_of(product / "scene.yaml")[0] < begun_at
    for layer in ("dn", "mean_e"):
        for name in (f"{layer}/zarr.json", layer, ""):
            assert disk.had(product / "cube.zarr" / name, before=begun_at), name
    for marker in markers:
        chunks = [f"cube.zarr/{place}" for place, *_ in read_marker(marker).chunks.values()]
        assert len(chunks) == 2
        for chunk in chunks:
            judge_atomic(disk, product / chunk)
            written = disk.name_of(product / chunk)[0]
            assert written < disk.name_of(marker)[0], chunk
            for folder in (product / chunk).relative_to(product).parents:
                assert disk.had(product / folder, before=sealed_at, after=written), folder
    for part in ("cosmic_rays-000000.arrow", "cosmic_rays-000001.arrow"):
        at, source = disk.name_of(product / "truth" / ".parts" / part)
        assert any(t < at and p == source for t, p, _ in disk.synced), part
    files = json.loads(sealed.read_text())["files"]
    assert {"cube.zarr/zarr.json", "truth/cosmic_rays.parquet", "report.json"} <= set(files)
    for name in files:
        path = product / name
        assert disk.had(path, before=sealed_at), name
        assert disk.had(path.parent, before=sealed_at), path.parent


def test_a_catalogue_is_on_disk_before_it_has_its_name(tmp_path, disk):
    """Every file and folder of it; and of the first pass what each marker vouches for."""
    rows = [f"{i + 1},{60.0 + 0.01 * i},{5.0 - 0.01 * i},12.0" for i in range(50)]
    (tmp_path / "stars.csv").write_text("\n".join(["source_id,ra,dec,phot_g_mean_mag", *rows]))
    ingest([tmp_path / "stars.csv"], tmp_path / "c", form="gaia_dr2", workers=1)
    at, source = disk.name_of(tmp_path / "c")
    for path in (tmp_path / "c").rglob("*"):
        was = source / path.relative_to(tmp_path / "c")
        assert any(t < at and p == was and s == state(path) for t, p, s in disk.synced), path
    assert disk.had(tmp_path, before=1 << 60, after=at)
    part = tmp_path / ".c.part" / "progress"
    read = next(t for t, _, target, _ in disk.named if target == part / "000000.json")
    before = [p.name for t, p, _ in disk.synced if t < read]
    assert {"counts.npy", "rejects.arrow", "0000.rows"} <= set(before)
    leaf = next(t for t, _, target, _ in disk.named if target.match("progress/leaf-*.json"))
    assert any(t < leaf and p.suffix == ".parquet" for t, p, _ in disk.synced)


def test_a_files_digest_is_the_published_one(tmp_path):
    """FIPS 180-4's example."""
    (tmp_path / "a").write_text("abc")
    known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert file_digest(tmp_path / "a") == known


def test_a_folder_may_have_a_colon_in_its_name(tmp_path, monkeypatch):
    """`-o run:1`: Arrow took the beginning of the path for that of a URL."""
    monkeypatch.chdir(tmp_path)
    folder = Path("run:1")
    (folder / "truth").mkdir(parents=True)
    with whole_file(folder / "truth" / "stars.parquet") as own:
        parquet.write_table(arrow.table({"a": [1]}), own)
    assert TruthTables(folder)["stars"]["a"].to_pylist() == [1]


def test_a_full_disk_within_another_store_is_told_of_the_whole(tmp_path: Path) -> None:
    """A table of a product: what to do is said of the product."""
    with (
        pytest.raises(DiskFull) as caught,
        full_disk_told(tmp_path, "make room and go on"),
        full_disk_told(tmp_path / "table", "make the table again"),
    ):
        raise OSError(28, "No space left on device")
    assert str(caught.value) == (
        f"{tmp_path}: the disk is full (No space left on device); make room and go on"
    )
