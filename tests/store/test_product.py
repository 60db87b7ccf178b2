"""The product: whole chunks always there, damage named, unfinished ones never opened."""

from __future__ import annotations

import contextlib
import copy
import errno
import json
import os
import pickle
import shutil
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import google_crc32c
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr
import zarr
from zarr.storage import LocalStore

from pipeline.calibrate import calibrate
from pipeline.errors import BadInput, Damaged, DiskFull, Incomplete, TryLater
from pipeline.export.files import export_frames
from pipeline.export.formats import ExportRequest, export_product
from pipeline.opened_product import open_product
from pipeline.plan.tiles import cut_up
from pipeline.route.run import Options, render
from pipeline.route.shares import Share
from pipeline.spec.load import parse_scene
from pipeline.spec.scene import CELL_PX
from pipeline.store.cube import open_cube, read_layer
from pipeline.store.info import describe
from pipeline.store.markers import cell_checksums, markers_present, read_marker
from pipeline.store.product import cells_digest, cells_of, check, content_digest
from pipeline.store.truth import TruthTable, part_path, write_part
from pipeline.store.whole_chunks import open_whole

SCENE = {
    "schema": "nightglass/scene/1",
    "name": "product",
    "epoch": "2019-07-20T09:00:00Z",
    "observer": {
        "kind": "orbit",
        "orbit": {
            "kind": "state",
            "position_m": [3500000, 6062178, 0],
            "velocity_m_s": [-6535.0, 3773.0, 0],
        },
    },
    "sensor": {
        "shape": [300, 520],
        "pixel_pitch_um": 9.0,
        "focal_length_m": 0.5,
        "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 60.0, "boresight_dec_deg": 5.0},
    "exposure": {"integration_s": 1.0, "frames": 2},
    "targets": [
        {
            "name": "far-off",
            "orbit": {
                "kind": "state",
                "position_m": [7000000, 0, 0],
                "velocity_m_s": [0, 7546.0, 0],
            },
            "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.5},
        }
    ],
    "output": {"layers": ["dn", "targets_e", "dark_e"], "tile_shape": [256, 256]},
}
TILES = 2 * 2 * 3


def scene(**changes):
    data = copy.deepcopy(SCENE)
    for section, values in changes.items():
        data[section] = {**data[section], **values}
    return parse_scene(data)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("made") / "run"
    render(scene(), path)
    return path


@pytest.fixture
def product(made, tmp_path):
    shutil.copytree(made, tmp_path / "run")
    return tmp_path / "run"


def test_empty_tiles_are_written(made):
    """A frame of nothing is stored as zeros, not as missing chunks."""
    for layer in ("dn", "targets_e", "dark_e"):
        chunks = [p for p in (made / "cube.zarr" / layer / "c").rglob("*") if p.is_file()]
        assert len(chunks) == TILES, layer
        assert not read_layer(made, layer, 0).any()
    assert check(made).whole


def test_reads_with_xarray(made):
    cube = xr.open_zarr(made / "cube.zarr")
    assert cube["dn"].dims == ("frame", "y", "x")
    assert cube["dn"].attrs["units"] == "DN"
    assert cube["time_mid"].dtype.kind == "M"
    middle = cube["time_mid"].values - np.datetime64("2019-07-20T09:00:00")
    assert middle.astype("timedelta64[us]").astype(int).tolist() == [500_000, 1_500_000]
    assert cube.attrs["complete"]


def test_unfinished_cube_is_no_group(product):
    """Without the seal neither our reader nor xarray opens it."""
    (product / "_COMPLETE").unlink()
    with pytest.raises(Incomplete, match="not complete"):
        open_cube(product)
    (product / "cube.zarr" / "zarr.json").unlink()
    with pytest.raises(Exception):  # noqa: B017 - whatever xarray and zarr raise for no group
        xr.open_zarr(product / "cube.zarr")
    assert not check(product).whole


@pytest.mark.parametrize("layer", ["dn", "targets_e"])
def test_every_flipped_bit_is_named(product, layer):
    """Sixty flips over a chunk: check names it each time, and reading raises or is unchanged."""
    chunk = product / "cube.zarr" / layer / "c" / "1" / "0" / "1"
    whole, good = chunk.read_bytes(), read_layer(product, layer, 1)
    for at in np.linspace(0, 8 * len(whole) - 1, 60).astype(int):
        damaged = bytearray(whole)
        damaged[at // 8] ^= 1 << (at % 8)
        chunk.write_bytes(damaged)
        verdict = check(product)
        assert not verdict.whole
        assert any(f"{layer}/c/1/0/1" in fault for fault in verdict.faults)
        with contextlib.suppress(Damaged):
            assert np.array_equal(read_layer(product, layer, 1), good)


@pytest.mark.parametrize("lost", ["dn/c/1/0/1", "dn/c/1/0", "dn/zarr.json", "dn"])
def test_what_is_lost_of_a_layer_is_never_read_as_zeros(product, tmp_path, lost):
    """Nor by xarray, nor exported or calibrated; the other frame of such a layer is read."""
    path = product / "cube.zarr" / lost
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(Damaged, match=r"cube\.zarr/dn.*: damaged: ") as told:
        read_layer(product, "dn", 1)
    with pytest.raises(Damaged):
        list(export_frames(product, "fits", tmp_path / "out"))
    with pytest.raises(Damaged):
        calibrate(product, tmp_path / "copy")
    if "/c/" in lost:
        assert f"{path}" in str(told.value)
        assert read_layer(product, "dn", 0).shape == (300, 520)
        cube = pickle.loads(pickle.dumps(open_cube(product)))  # as it is sent to workers
        assert cube["dn"][0].values.shape == (300, 520)
        with pytest.raises(Damaged, match="this chunk is lost"):
            cube["dn"][1, 10:20, 300:310].load()


@pytest.mark.parametrize("name", ["time_mid", "wcs_cd_deg", "x"])
def test_a_lost_coordinate_is_not_read_as_zeros(product, tmp_path, name):
    """Be it stored as one shard of all frames or whole."""
    shutil.rmtree(product / "cube.zarr" / name / "c")
    with pytest.raises(Damaged, match=f"cube.zarr/{name}/c/.*: missing"):
        open_cube(product)
    with pytest.raises(Damaged, match=f"cube.zarr/{name}/c/.*: this chunk is lost"):
        open_whole(LocalStore(product / "cube.zarr", read_only=True)).load()


@pytest.mark.parametrize(
    "name",
    ["truth/targets.parquet", "scene.yaml", "plan.json", "report.json", "cube.zarr/dn/zarr.json",
     "cube.zarr/zarr.json", "preview.png", "cube.zarr/time_mid/c/0", "cube.zarr/x/zarr.json",
     "cube.zarr/wcs_cd_deg/c/0/0/0"],
)  # fmt: skip
def test_other_files_are_watched(product, name):
    path = product / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert any(name in fault for fault in check(product).faults)
    path.unlink()
    assert any(name in fault for fault in check(product).faults)


@pytest.mark.parametrize("cut", [False, True], ids=["gone", "cut"])
@pytest.mark.parametrize(
    "name", ["truth/targets.parquet", "plan.json", "report.json", "cube.zarr/zarr.json"]
)
def test_what_is_damaged_is_neither_told_nor_exported(product, tmp_path, name, cut):
    """A table of truth that is gone is no scene without targets. The damaged file is named."""
    path = product / name
    content = path.read_bytes()[:7]
    path.unlink()
    if cut:
        path.write_bytes(content)
    for doors in (
        lambda: describe(product),
        lambda: next(export_product(product, "coco", tmp_path / "out", ExportRequest())),
        lambda: next(export_product(product, "fits", tmp_path / "out", ExportRequest())),
        lambda: open_product(product),
    ):
        with pytest.raises(Damaged, match=name):
            doors()
    assert not (tmp_path / "out").exists()


def test_a_large_table_is_judged_when_it_is_read(product, tmp_path, monkeypatch):
    """Not each time that a product is opened; of one that is gone the next reader is told."""
    monkeypatch.setattr("pipeline.store.seal.SMALL_BYTES", 100)
    truth, path = open_product(product).truth, product / "truth" / "targets.parquet"
    content = bytearray(path.read_bytes())
    content[4:500] = bytes(496)
    path.write_bytes(content)
    with pytest.raises(Damaged, match=r"targets\.parquet"):
        list(export_product(product, "coco", tmp_path / "out", ExportRequest()))
    path.unlink()
    with pytest.raises(Damaged, match=r"targets\.parquet: damaged: gone"):
        truth["targets"]


def test_locks_are_no_part_of_what_is_sealed(product):
    """They come and go with whoever writes: a product is whole without them."""
    files = json.loads((product / "_COMPLETE").read_text())["files"]
    assert not [name for name in files if ".lock" in name]
    for lock in product.glob(".lock*"):
        lock.unlink()
    assert check(product).whole


def test_a_seal_with_another_digest_is_named(product):
    seal = json.loads((product / "_COMPLETE").read_text())
    digest = seal["content_digest"]
    other = ("1" if digest[0] == "0" else "0") + digest[1:]
    (product / "_COMPLETE").write_text(json.dumps(seal | {"content_digest": other}))
    assert any("content_digest" in fault for fault in check(product).faults)


def test_lost_and_tampered_markers(product):
    marker = sorted((product / "markers").glob("*.json"))[3]
    text = marker.read_text()
    marker.write_text(text.replace('"frame', '"frane', 1).replace("frame", "frane", 1))
    assert any(marker.name in fault for fault in check(product).faults)
    marker.unlink()
    assert any("missing" in fault for fault in check(product).faults)


def test_damage_is_mended_by_resume(product, made):
    """A damaged chunk of a finished product is drawn again, and the product is whole again."""
    (product / "cube.zarr" / "dn" / "c" / "0" / "1" / "2").write_bytes(b"")
    assert not check(product).whole
    report = render(scene(), product, Options(resume=True))
    assert check(product).whole
    assert len(report["redrawn"]) == 1
    before = json.loads((made / "_COMPLETE").read_text())["content_digest"]
    assert json.loads((product / "_COMPLETE").read_text())["content_digest"] == before


@pytest.mark.parametrize("name", ["package.json", "notes.txt", "cube.zarr/zarr.json"])
def test_resume_deletes_nothing_of_the_users(name, tmp_path):
    """A folder that was not begun here is refused and left as it is."""
    (tmp_path / "mine" / "cube.zarr").mkdir(parents=True)
    (tmp_path / "mine" / name).write_text("{}")
    with pytest.raises(BadInput, match="begun by"):
        render(scene(), tmp_path / "mine", Options(resume=True))
    assert (tmp_path / "mine" / name).read_text() == "{}"


def test_writers_that_share_take_up_what_stopped_at_its_beginning(tmp_path):
    """A folder without its record is theirs to make; one with a file of the user's is not."""
    ours, mine = tmp_path / "ours", tmp_path / "mine"
    for folder in (ours, mine):
        (folder / "cube.zarr").mkdir(parents=True)
    (mine / "notes.txt").write_text("mine")
    render(scene(), ours, Options("synchronous"), share=Share(1, 1))
    assert check(ours).whole
    with pytest.raises(BadInput, match="begun by"):
        render(scene(), mine, Options("synchronous"), share=Share(1, 1))
    assert (mine / "notes.txt").read_text() == "mine"


def test_one_writer_at_a_time(product):
    import fcntl

    with (product / ".lock").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        with pytest.raises(TryLater, match="another render"):
            render(scene(), product, Options(resume=True))


@pytest.mark.parametrize("code", [errno.EROFS, errno.EACCES, errno.ENOLCK, errno.ENOSYS])
def test_a_place_without_locks_is_not_that_of_another_writer(product, monkeypatch, code):
    """Read only, another user's, or a file system without locks: to wait would not help."""

    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("pipeline.store.layout.fcntl.flock", refuse)
    with pytest.raises(BadInput, match=os.strerror(code)):
        render(scene(), product, Options(resume=True, wait_s=60.0))


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_codecs(compression, tmp_path, made):
    output = {"compression": compression}
    render(scene(output=output), tmp_path / "run")
    other, one = (
        zarr.open_group(tmp_path / "run" / "cube.zarr"),
        zarr.open_group(made / "cube.zarr"),
    )
    assert np.array_equal(other["dn"][...], one["dn"][...])
    assert "crc32c" in (tmp_path / "run" / "cube.zarr" / "dn" / "zarr.json").read_text()


def test_cells_know_their_frame(made):
    """Two products are not told alike because one has the frames of the other in another order."""
    markers = [read_marker(path) for path in markers_present(made)]
    assert {m.frame for m in markers} == {0, 1}
    assert all({cell[1] for cell in cells_of(m)} <= {m.frame} for m in markers)


def test_cells_know_their_layer(made):
    """Nor because one has the content of the other under another layer's name."""

    def digest(markers):
        return cells_digest(cell for m in markers for cell in cells_of(m))

    markers = [read_marker(path) for path in markers_present(made)]
    other = [replace(m, cells={f"{name}_e": c for name, c in m.cells.items()}) for m in markers]
    assert digest(markers) == content_digest(made) != digest(other)


def test_info_tells_the_bytes_of_all_files_at_any_depth(product):
    """What a product takes on disk: chunks lie five folders down, and count as what lies on top."""
    before = describe(product)["bytes"]
    assert before == sum(
        (Path(folder) / name).stat().st_size
        for folder, _, names in os.walk(product)
        for name in names
    )
    for place, size in (("notes.txt", 7), ("cube.zarr/dn/c/0/0/more", 1000)):
        (product / place).write_bytes(size * b"x")
    assert describe(product)["bytes"] == before + 1007


def test_cells_know_their_place_whatever_the_tile():
    """A cell counts in the content digest by its row and column of the frame, not of its tile."""
    shape = (2 * CELL_PX, 3 * CELL_PX)
    values = np.arange(shape[0] * shape[1], dtype=np.float32).reshape(shape)
    for sides in (shape, (CELL_PX, 2 * CELL_PX), (CELL_PX, CELL_PX)):
        found = {
            (row, column): crc
            for t in cut_up(shape, sides)
            for row, column, crc in cell_checksums(
                t, values[t.y0 : t.y0 + t.rows, t.x0 : t.x0 + t.columns]
            )
        }
        assert found == {
            (i, j): google_crc32c.value(
                values[i * CELL_PX : (i + 1) * CELL_PX, j * CELL_PX : (j + 1) * CELL_PX].tobytes()
            )
            for i in range(2)
            for j in range(3)
        }


def test_one_chunking_along_frames(made, tmp_path):
    """Dask sees one chunking of all variables, in a product and in its calibrated copy."""
    calibrate(made, tmp_path / "calibrated")
    for path in (made, tmp_path / "calibrated"):
        cube = xr.open_zarr(path / "cube.zarr")
        assert cube.chunks["frame"] == (1, 1)
        assert cube.chunks["y"] == (256, 44)
        same = cube.map_blocks(lambda block: block).compute()
        assert same.identical(xr.open_zarr(path / "cube.zarr", chunks=None).compute())
        for name in set(cube.variables) - {"dn", "targets_e", "dark_e", "calibrated_e"}:
            chunks = [p for p in (path / "cube.zarr" / name / "c").rglob("*") if p.is_file()]
            assert len(chunks) == 1, "one file whatever the number of frames"


def test_truth_of_frames_is_joined_row_by_row(tmp_path, monkeypatch):
    """In order, each row once, in row groups of as many as may be, whatever comes when; a part cut
    off is named, and of what ends with an error nothing stays."""
    monkeypatch.setattr("pipeline.store.truth.ROWS", 5)
    monkeypatch.setattr("pipeline.store.truth.TOGETHER", 2)
    counts = [0, 3, 2, 4, 1, 0, 7, 1, 1, 1, 0, 1, 2]  # the seventh alone is more than a group takes
    folder = tmp_path / "truth"
    (folder / ".parts").mkdir(parents=True)
    (folder / ".stars.parquet.0123.tmp").touch()  # of a writer that was killed
    ends = np.cumsum(counts)
    tables = [
        pa.table({"row": np.arange(end - count, end), "frame": np.full(count, frame)})
        for frame, (end, count) in enumerate(zip(ends, counts, strict=True))
    ]
    heard: list[int] = []
    with ExitStack() as files:
        joined = TruthTable(tmp_path, "stars", len(counts), tables[0].slice(0, 0), files)
        for frame in (1, 3, 0, 2, 12, 5, 4, 6, 7, 8, 9, 11, 10):
            write_part(tmp_path, "stars", frame, tables[frame])
            joined.take(lambda group: heard.append(group.num_rows))
        joined.end(lambda group: heard.append(group.num_rows))
    assert joined.rows == ends[-1]
    file = pq.ParquetFile(folder / "stars.parquet")
    found = file.read()
    assert found["row"].to_pylist() == list(range(ends[-1]))
    assert found["frame"].to_pylist() == np.repeat(np.arange(len(counts)), counts).tolist()
    groups = [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)]
    assert heard == groups == [5, 5, 7, 4, 2]
    part = part_path(tmp_path, "stars", 3)
    part.write_bytes(part.read_bytes()[:-1])
    files = ExitStack()
    again = TruthTable(tmp_path, "stars", len(counts), tables[0].slice(0, 0), files)
    with pytest.raises(Damaged, match="stars-000003"), files:
        again.end(lambda _: None)
    assert [path.name for path in folder.glob("*.parquet")] == ["stars.parquet"]
    assert not list(folder.glob(".*.tmp")), "nothing of what was given up"


def test_truth_is_joined_while_frames_are_drawn(tmp_path, monkeypatch, made):
    """Of three frames some are in the table by the time that the last is drawn; a disk that is full
    for the table ends in one line, and a render that goes on then makes the same product."""
    monkeypatch.setattr("pipeline.store.truth.ROWS", 0)
    rows, end, take = [], TruthTable.end, TruthTable.take

    def ended(self, hear):
        rows.append(self.rows)
        end(self, hear)

    with monkeypatch.context() as patch:
        patch.setattr(TruthTable, "end", ended)
        render(scene(exposure={"frames": 3}), tmp_path / "three")
    assert rows[0] > 0

    def full(self, hear):
        take(self, hear)
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(TruthTable, "take", full)
        with pytest.raises(DiskFull):
            render(scene(), tmp_path / "two")
    assert not list((tmp_path / "two" / "truth").glob("*.parquet"))
    assert not list((tmp_path / "two" / "truth").glob(".*.tmp"))
    render(scene(), tmp_path / "two", Options(resume=True))
    assert content_digest(tmp_path / "two") == content_digest(made)


@pytest.mark.parametrize("ended", [MemoryError("32 MiB"), RuntimeError("can't start new thread")])
def test_nothing_stays_where_memory_or_threads_end_before_a_tile(ended, tmp_path, monkeypatch):
    """As after any other error before the first tile: the same command can be tried again."""
    with monkeypatch.context() as patch:
        patch.setattr("pipeline.execute.graph.render_tile", Mock(side_effect=ended))
        with pytest.raises(type(ended), match=str(ended)):
            render(scene(), tmp_path / "run", Options("synchronous"))
    assert not (tmp_path / "run").exists()
    render(scene(), tmp_path / "run")


@pytest.mark.parametrize("share", [None, Share(1, 2)])
def test_a_disk_without_room_for_the_lock_is_told_as_full(share, tmp_path, monkeypatch):
    opened = Path.open

    def full(self, mode="r", *args, **kwargs):
        if self.name.startswith(".lock"):
            raise OSError(errno.ENOSPC, "No space left on device", str(self))
        return opened(self, mode, *args, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", full)
        with pytest.raises(DiskFull, match=f"^{tmp_path / 'run'}: the disk is full"):
            render(scene(), tmp_path / "run", share=share)
    render(scene(), tmp_path / "run", Options(resume=share is None), share=share)


def test_a_product_may_have_a_colon_in_its_name(tmp_path, monkeypatch):
    """Arrow takes `run:1/truth` for a kind of URL, also where the picture is made of its tables."""
    monkeypatch.chdir(tmp_path)
    data = {**SCENE, "cosmic_rays": {"kind": "generated", "rate_per_cm2_s": 5.0}}
    render(parse_scene(data), "run:1")
    assert check(Path("run:1")).complete
