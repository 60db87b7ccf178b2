"""Ingest: every row accounted for, the same bits whatever the order, nothing half-visible."""

from __future__ import annotations

import csv
import ctypes
import hashlib
import os
import platform
import shutil
from dataclasses import replace
from itertools import pairwise, permutations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lsst_refcat import convert
from star_rows import random_stars, same_rows, write_csv

from catalog_tools.catalogue import REJECTS_NAME, SOURCES_NAME, open_catalogue
from catalog_tools.columns import HEALPIX_COLUMN, NAMES, STORED
from catalog_tools.coverage import all_sky
from catalog_tools.engine.schedulers import LocalScheduler
from catalog_tools.errors import BadInput, Damaged, DiskFull, Incomplete
from catalog_tools.fetch.fetched import note_coverage
from catalog_tools.forms import load_form
from catalog_tools.info import info
from catalog_tools.ingest import batches, build, duplicates, leaves, memory, publish
from catalog_tools.ingest import ingest as of_ingest
from catalog_tools.ingest.ingest import SYNTHETIC_MARK, FileSource, ingest
from catalog_tools.ingest.judging import PLACE_COLUMN
from catalog_tools.ingest.shards import band_slices
from catalog_tools.partition import choose_leaves, coarser, healpix_29
from catalog_tools.query.query import cone
from catalog_tools.verify.verify import verify

HEAD = "source_id,ra,dec,phot_g_mean_mag"


def shard_bits(catalogue):
    root = Path(catalogue.path)
    return {
        leaf.path: hashlib.sha256((root / leaf.path).read_bytes()).hexdigest()
        for leaf in catalogue.leaves
    }


def left_behind(folder):
    return sorted(p.name for p in folder.iterdir() if p.name.startswith("."))


@pytest.fixture
def parts(tmp_path):
    stars = random_stars(6000, 9)
    folder = tmp_path / "in"
    folder.mkdir()
    for i in range(3):
        write_csv(folder / f"part{i}.csv.gz", stars.slice(2000 * i, 2000))
    return stars, sorted(folder.iterdir())


def test_stars_that_are_partly_made_up_are_not_called_real(tmp_path, parts):
    """One of three files lies beside the mark that the synthetic sky leaves."""
    _, files = parts
    made = tmp_path / "made"
    made.mkdir()
    (made / SYNTHETIC_MARK).write_text("{}\n")
    shutil.move(files[1], made)
    sources = [files[0], made / files[1].name, files[2]]
    ingest(sources, tmp_path / "mixed", workers=1)
    assert open_catalogue(tmp_path / "mixed").synthetic
    ingest(sources[::2], tmp_path / "real", workers=1)
    assert not open_catalogue(tmp_path / "real").synthetic


def test_same_bits_for_any_order_and_workers(tmp_path, parts):
    stars, files = parts
    one = ingest(files, tmp_path / "one", rows_per_leaf=800, workers=1)
    two = ingest(files[::-1], tmp_path / "two", rows_per_leaf=800, workers=2)
    folder = ingest([files[0].parent], tmp_path / "three", rows_per_leaf=800, workers=3)
    assert shard_bits(one.catalogue) == shard_bits(two.catalogue) == shard_bits(folder.catalogue)
    assert one.catalogue.digest == two.catalogue.digest == folder.catalogue.digest
    assert one.rows_in == one.catalogue.rows == 6000
    assert same_rows(cone(two.catalogue, 0, 0, 180)[0], stars)
    assert left_behind(tmp_path) == []


def test_same_bits_for_any_batch_and_piece_size(tmp_path, parts, monkeypatch):
    _, files = parts
    whole = ingest(files, tmp_path / "whole", rows_per_leaf=800, workers=1)
    monkeypatch.setattr(memory, "MOST_PIECE_ROWS", 333)
    monkeypatch.setattr(build, "BATCH_SOURCES", 1)
    small = ingest(files, tmp_path / "small", rows_per_leaf=800, workers=1)
    assert shard_bits(whole.catalogue) == shard_bits(small.catalogue)


def test_rows_lie_in_their_leaf_and_band(catalogue):
    for leaf in catalogue.leaves:
        file = pq.ParquetFile(Path(catalogue.path) / leaf.path)
        assert file.schema_arrow.equals(STORED)
        for band in leaf.row_groups:
            rows = file.read_row_group(band.row_group)
            pixels, g_mag = rows["_healpix_29"].to_numpy(), rows["phot_g_mean_mag"].to_numpy()
            assert (coarser(pixels, leaf.order) == leaf.pixel).all()
            assert (np.diff(pixels) >= 0).all()
            assert (healpix_29(rows["ra"].to_numpy(), rows["dec"].to_numpy()) == pixels).all()
            assert (g_mag.min(), g_mag.max()) == (band.brightest_g_mag, band.faintest_g_mag)
        ends = [(b.brightest_g_mag, b.faintest_g_mag) for b in leaf.row_groups]
        # Bright bands first; the stretches of one band overlap in magnitude.
        assert all(a[1] <= b[0] or (a[0] <= b[1] and b[0] <= a[1]) for a, b in pairwise(ends))


@pytest.mark.parametrize(
    ("counts", "ends"),
    [
        ([0, 0, 0], [3]), ([1024, 1024, 1024], [1, 2, 3]), ([1023, 1, 1024], [2, 3]),
        ([1024, 1023], [2]), ([1023, 1023, 1023], [3]), ([5000, 0, 0, 1024, 3, 4], [1, 6]),
        ([0, 0, 2000], [3]),
    ],
)  # fmt: skip
def test_bands_of_too_few_rows_are_joined(counts, ends):
    """1,024 suffice; fewer join the next fainter band, the last ones their brighter neighbour."""
    assert band_slices(np.array(counts)) == list(map(slice, [0, *ends], ends))


def test_every_row_is_accounted_for(tmp_path):
    path = tmp_path / "hard.csv"
    rows = [
        "1,10,20,12", ",10,20,12", "3,,20,12", "4,10,NaN,12", "5,inf,20,12", "6,-0.1,20,12",
        "7,360.0001,20,12", "8,10,90.0001,12", "9,10,-90,12", "10,360,90,12", "11,10,20,",
        "12,10,20,nan", "13,10,20,inf", "1,10,20,12", "1,200,-20,13", "14,0,0,20", "14,0,0,20",
    ]  # fmt: skip
    path.write_text("\n".join([HEAD, *rows]) + "\n")
    report = ingest([path], tmp_path / "c")
    assert report.rows_in == 17 == report.catalogue.rows + sum(report.rejected.values())
    assert report.rejected == {
        "source_id absent": 1,
        "position absent or not finite": 3,
        "ra outside 0 to 360": 2,
        "dec outside -90 to 90": 1,
        "G magnitude absent or not finite": 3,
        "source_id occurs more than once": 2,
        "source_id occurs more than once, at another place": 1,
    }
    rejected = pq.read_table(tmp_path / "c" / REJECTS_NAME).to_pylist()
    assert len(rejected) == 13
    assert {(r["source"], r["row"]) for r in rejected} >= {("hard.csv", 1), ("hard.csv", 9 + 1)}
    kept = cone(report.catalogue, 0, 0, 180)[0]
    places = dict(zip(kept["source_id"].to_pylist(), kept["ra"].to_pylist(), strict=True))
    assert sorted(places) == [1, 9, 10, 14]
    assert places[10] == 0.0
    assert info(report.catalogue)["rejected"] == report.rejected


@pytest.mark.parametrize(("arcsec", "elsewhere"), [(0.9, 0), (1.1, 1)])
def test_a_repeated_id_is_at_another_place_from_an_arcsecond_on(arcsec, elsewhere, tmp_path):
    path = tmp_path / "twice.csv"
    path.write_text(f"{HEAD}\n1,10,60,12\n1,{10.0 + arcsec / 1800.0:.12f},60,12\n")
    rejected = ingest([path], tmp_path / "c").rejected
    kinds = [1 - elsewhere, elsewhere]
    told = ("source_id occurs more than once", "source_id occurs more than once, at another place")
    assert [rejected.get(reason, 0) for reason in told] == kinds


def test_rejected_rows_have_the_numbers_of_their_own_files(tmp_path):
    """Of rows below each head, however many there are in the files before."""
    for name, wrong in (("a", 1), ("b", 3), ("c", 0)):
        rows = [f"{ord(name)}{k},{30 * k},10,{12 if k != wrong else 'nan'}" for k in range(5)]
        (tmp_path / f"{name}.csv").write_text("\n".join([HEAD, *rows]) + "\n")
    ingest([tmp_path / f"{name}.csv" for name in "abc"], tmp_path / "out", workers=1)
    rejected = pq.read_table(tmp_path / "out" / REJECTS_NAME).to_pylist()
    first = min(r["row"] for r in rejected)
    told = sorted((r["source"], r["row"] - first) for r in rejected)
    assert told == [("a.csv", 1), ("b.csv", 3), ("c.csv", 0)]



def test_repeated_ids_are_told_of_the_rows_that_have_them(tmp_path):
    """In several small files, at other places, below rows that are rejected for themselves."""
    ids = {"a": [1, 2, 3, 4, 5], "b": [6, 2, 7, 5, 8], "c": [9, 10, 1, 11, 3]}
    for name, numbers in ids.items():
        rows = [f"{n},{10.0 + i},{ord(name) - 90},12" for i, n in enumerate(numbers)]
        head = [HEAD, "99,10,NaN,12", "98,400,10,12"]
        (tmp_path / f"{name}.csv").write_text("\n".join([*head, *rows]) + "\n")
    ingest([tmp_path / f"{name}.csv" for name in ids], tmp_path / "out", workers=1)
    rejected = pq.read_table(tmp_path / "out" / REJECTS_NAME).to_pylist()
    first = min(r["row"] for r in rejected)
    repeated = [r for r in rejected if r["reason"].startswith("source_id occurs")]
    assert sorted(r["source_id"] for r in repeated) == [1, 2, 3, 5]
    for r in repeated:
        assert ids[r["source"][0]][r["row"] - first - 2] == r["source_id"]


def test_same_duplicates_stay_for_any_order_of_files(tmp_path):
    stars = random_stars(500, 2)
    write_csv(tmp_path / "a.csv", stars)
    moved = stars.set_column(1, "ra", pa.array(stars["ra"].to_numpy()[::-1]))
    write_csv(tmp_path / "b.csv", moved)
    write_csv(tmp_path / "c.csv", stars.slice(100, 50))
    names = [tmp_path / f"{x}.csv" for x in "abc"]
    first = ingest(names, tmp_path / "one", rows_per_leaf=60, workers=1)
    second = ingest(names[::-1], tmp_path / "two", rows_per_leaf=60, workers=2)
    assert first.catalogue.rows == 500
    assert sum(first.rejected.values()) == 550
    assert first.rejected == second.rejected
    same = first.rejected["source_id occurs more than once"]
    # of the 50 stars given thrice those whose own place stays: the third one repeats it
    at = [dict(zip(t["source_id"].to_pylist(), t["ra"].to_pylist(), strict=True))
          for t in (cone(first.catalogue, 0, 0, 180)[0], stars.slice(100, 50))]  # fmt: skip
    assert same == sum(at[0][number] == ra for number, ra in at[1].items())
    assert 0 < same < 50
    assert shard_bits(first.catalogue) == shard_bits(second.catalogue)
    assert sorted(cone(first.catalogue, 0, 0, 180)[0]["source_id"].to_pylist()) == sorted(
        stars["source_id"].to_pylist()
    )


def test_same_row_of_one_place_stays_for_any_order_of_rows(tmp_path):
    """Rows of one star and pixel that differ in G: which one stays is a matter of content."""
    np.array([7]).tofile(tmp_path / duplicates.IDS_NAME)
    np.array([5]).tofile(tmp_path / duplicates.PIXELS_NAME)
    repeated, stays = duplicates.Repeated(tmp_path), set()
    for g_mag in permutations([9.0, 8.0, 10.0]):
        rows = dict.fromkeys(NAMES, np.zeros(3)) | {"source_id": np.full(3, 7)}
        rows |= {HEALPIX_COLUMN: np.full(3, 5), PLACE_COLUMN: np.arange(3)}
        rows["phot_g_mean_mag"] = np.array(g_mag)
        stays.add(tuple(np.delete(rows["phot_g_mean_mag"], repeated.surplus(rows))))
    assert len(stays) == 1 == len(stays.pop())


def test_same_duplicates_found_in_many_buckets(tmp_path, parts, monkeypatch):
    stars, files = parts
    write_csv(tmp_path / "again.csv", stars.slice(5, 1000))
    monkeypatch.setattr(memory, "BUCKET_ROW_BYTES", 1 << 22)
    report = ingest([*files, tmp_path / "again.csv"], tmp_path / "c", rows_per_leaf=500)
    assert report.rejected == {"source_id occurs more than once": 1000}
    assert same_rows(cone(report.catalogue, 0, 0, 180)[0], stars)


def test_real_lsst_refcat_rows(tmp_path, shared_data):
    source = tmp_path / "refcat.csv.gz"
    rows = convert(shared_data / "gaia_dr2" / "lsst_refcat_htm7", source)
    report = ingest([source], tmp_path / "c", rows_per_leaf=1000)
    assert rows == report.rows_in == report.catalogue.rows == 5834
    stars, _ = cone(report.catalogue, 0.7, -1.0, 5.0)
    assert stars.num_rows == 5834
    assert stars["parallax"].null_count == 1007 == stars["pmra"].null_count
    assert (stars["phot_bp_mean_mag"].null_count, stars["phot_rp_mean_mag"].null_count) == (
        481,
        480,
    )
    colour = stars["phot_bp_mean_mag"].to_numpy() - stars["phot_rp_mean_mag"].to_numpy()
    assert 0.7 < np.nanmedian(colour) < 2.0
    level_12 = np.mean(
        coarser(healpix_29(stars["ra"].to_numpy(), stars["dec"].to_numpy()), 12)
        == stars["source_id"].to_numpy() >> 35
    )
    assert level_12 > 0.98


@pytest.mark.parametrize(
    "name",
    ["full_schema_random/gdr2_sm.fits", "m67_field/M67_data.csv",
     "nearby_teff/gaia_dr2_result.csv", "ophiuchus/sample_oph_cone_r3.5-result.vot"],
)  # fmt: skip
def test_real_dr2_folders(tmp_path, shared_data, name):
    report = ingest([shared_data / "gaia_dr2" / name], tmp_path / "c", rows_per_leaf=2000)
    assert report.rows_in == report.catalogue.rows > 900
    stars, _ = cone(report.catalogue, 0, 0, 180)
    pixels = coarser(healpix_29(stars["ra"].to_numpy(), stars["dec"].to_numpy()), 12)
    assert np.mean(pixels == stars["source_id"].to_numpy() >> 35) > 0.98


def test_hats_files(catalogue):
    import healpy

    root = Path(catalogue.path)
    lines = (root / "hats.properties").read_text().splitlines()
    properties = dict(line.split("=", 1) for line in lines if not line.startswith("#"))
    assert properties["hats_nrows"] == str(catalogue.rows)
    assert properties["hats_col_healpix"] == "_healpix_29"
    assert properties["dataproduct_type"] == "object"
    assert (root / "properties").read_text() == (root / "hats.properties").read_text()
    with (root / "partition_info.csv").open() as file:
        listed = {(int(r["Norder"]), int(r["Npix"])) for r in csv.DictReader(file)}
    assert listed == {(leaf.order, leaf.pixel) for leaf in catalogue.leaves}
    for order, pixel in listed:
        folder = f"dataset/Norder={order}/Dir={pixel // 10000 * 10000}"
        assert (root / folder / f"Npix={pixel}.parquet").is_file()
    assert pq.read_schema(root / "dataset" / "_common_metadata").equals(STORED)
    for name in ("skymap.fits", "point_map.fits"):
        rows = healpy.read_map(root / name, nest=True, dtype=np.int64)
        assert rows.size == 12 * 4 ** int(properties["hats_skymap_order"])
        assert rows.sum() == catalogue.rows


def test_choose_leaves_splits_only_where_dense():
    counts = np.zeros(12 * 4**3, np.int64)
    counts[5 * 64 : 5 * 64 + 64] = 10
    counts[700] = 3
    cells = choose_leaves(counts, 200)
    assert [(c.order, c.rows) for c in cells] == [(1, 160)] * 4 + [(0, 3)]
    assert [c.rows for c in choose_leaves(counts, 5)] == [10] * 64 + [3]
    assert sorted(c.rows for c in choose_leaves(counts, 640)) == [3, 640]  # just as many as may be


def test_destination_that_exists_is_refused(tmp_path, parts):
    files = parts[1]
    (tmp_path / "taken").mkdir()
    with pytest.raises(BadInput, match="taken"):
        ingest(files, tmp_path / "taken")
    with pytest.raises(BadInput, match="to be overwritten"):
        ingest(files, tmp_path / "taken", overwrite=True)
    first = ingest(files[:1], tmp_path / "c")
    with pytest.raises(BadInput):
        ingest(files, tmp_path / "c")
    assert open_catalogue(tmp_path / "c").digest == first.catalogue.digest
    assert ingest(files, tmp_path / "c", overwrite=True).catalogue.rows == 6000
    assert left_behind(tmp_path) == []


def test_two_ingests_into_one_place_refuse_each_other(tmp_path, parts):
    files = parts[1]
    seen = []

    def meddle(stage, done, total):
        if stage == "write" and not seen:
            seen.append(stage)
            for _ in range(2):  # the lock is still that of the first
                with pytest.raises(BadInput, match="no other process"):
                    ingest(files, tmp_path / "c")

    ingest(files, tmp_path / "c", progress=meddle, workers=1)
    assert seen == ["write"]
    assert open_catalogue(tmp_path / "c").rows == 6000


def test_reading_and_writing_tell_how_far_they_are(tmp_path, parts):
    told = []
    ingest(parts[1], tmp_path / "c", progress=lambda *one: told.append(one), workers=1)
    for stage in ("read", "write"):
        done = [one[1:] for one in told if one[0] == stage]
        assert done == [(k, done[-1][1]) for k in range(done[-1][1] + 1)]


def test_a_lock_that_another_has_removed_is_not_held(tmp_path):
    """Between opening the lock's file and taking it the other writer ended and removed it."""
    path = tmp_path / ".c.lock"
    with path.open("a") as late:
        path.unlink()
        assert not publish._alone(late)
        with path.open("a") as third:
            assert publish._alone(third)
            assert not publish._alone(late)
            with path.open("a") as fourth:
                assert not publish._alone(fourth)


@pytest.mark.parametrize("broken", ["split", "write_leaf", "write_manifest"])
def test_an_interrupted_ingest_goes_on(tmp_path, parts, monkeypatch, broken):
    """Cut off in any pass: the work is kept, the next run takes it up, the bits are the same."""
    files = parts[1]
    monkeypatch.setattr(build, "BATCH_SOURCES", 1)
    whole = ingest(files, tmp_path / "whole", rows_per_leaf=800, workers=1).catalogue
    with monkeypatch.context() as patch:
        calls, real = [], getattr(build, broken)

        def fails(*arguments, **named):
            calls.append(1)
            if len(calls) > (1 if broken == "split" else 0):
                raise KeyboardInterrupt
            return real(*arguments, **named)

        patch.setattr(build, broken, fails)
        with pytest.raises(KeyboardInterrupt):
            ingest(files, tmp_path / "c", rows_per_leaf=800, workers=1)
    assert not (tmp_path / "c").exists()
    assert left_behind(tmp_path) == [".c.part"]
    report = ingest(files, tmp_path / "c", rows_per_leaf=800)
    assert report.continued == (1 if broken == "split" else 3)
    assert report.catalogue.digest == whole.digest
    assert left_behind(tmp_path) == []


def test_what_a_killed_writer_left_is_no_part_of_the_catalogue(tmp_path, parts, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(build, "write_manifest", interrupted)
        with pytest.raises(KeyboardInterrupt):
            ingest(parts[1], tmp_path / "c", rows_per_leaf=800, workers=1)
    shard = next(p for p in (tmp_path / ".c.part").rglob("Npix=*") if p.is_file())
    left = shard.with_name(f".{shard.name}.1.tmp"), shard.with_name("Npix=99999.parquet")
    for path in left:
        shutil.copy(shard, path)
    whole = ingest(parts[1], tmp_path / "c", rows_per_leaf=800).catalogue
    names = {path.name for path in (tmp_path / "c").rglob("*")}
    assert shard.name in names
    assert not names & {path.name for path in left}
    assert same_rows(cone(whole, 0, 0, 180)[0], parts[0])


def interrupted(*_, **__):
    raise KeyboardInterrupt


@pytest.mark.parametrize("damage", ["bit", "cut", "gone"])
def test_a_shard_that_was_damaged_meanwhile_is_written_again(tmp_path, parts, monkeypatch, damage):
    """All leaves stood when the ingest was cut off; one has changed before it goes on."""
    files = parts[1]
    whole = ingest(files, tmp_path / "whole", rows_per_leaf=800, workers=1).catalogue
    with monkeypatch.context() as patch:
        patch.setattr(build, "write_manifest", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            ingest(files, tmp_path / "c", rows_per_leaf=800, workers=1)
    shard = min((tmp_path / ".c.part" / "catalogue").rglob("Npix*.parquet"))
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.unlink() if damage == "gone" else shard.write_bytes(
        content if damage == "bit" else content[:-3]
    )
    found = ingest(files, tmp_path / "c", rows_per_leaf=800, workers=1).catalogue
    assert found.digest == whole.digest
    assert shard_bits(found) == shard_bits(whole)
    assert verify(found).findings == ()


@pytest.mark.parametrize("damage", ["bit", "gone"])
def test_surplus_rows_that_were_damaged_meanwhile_are_gathered_again(tmp_path, monkeypatch, damage):
    """Rows omitted as repeated wait in a file of their own until the end: it is proved, too."""
    stars = random_stars(300, 4)
    files = [write_csv(tmp_path / f"{name}.csv", stars) for name in "ab"]
    write_csv(files[1], pa.concat_tables([stars.slice(0, 40), random_stars(9, 5)]))
    with monkeypatch.context() as patch:
        patch.setattr(build, "_write_rejects", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            ingest(files, tmp_path / "c", workers=1)
    surplus = min((tmp_path / ".c.part" / "progress").glob("leaf-*.arrow"))
    content = bytearray(surplus.read_bytes())
    content[content.index(b"source_id occurs")] ^= 1
    surplus.unlink() if damage == "gone" else surplus.write_bytes(content)
    report = ingest(files, tmp_path / "c", workers=1)
    whole = ingest(files, tmp_path / "whole", workers=1)
    rejects = [pq.read_table(tmp_path / name / REJECTS_NAME) for name in ("c", "whole")]
    assert report.catalogue.digest == whole.catalogue.digest
    assert rejects[0].equals(rejects[1])


def test_an_unfinished_ingest_of_other_arguments_is_refused(tmp_path, parts, monkeypatch):
    files = parts[1]
    with monkeypatch.context() as patch:
        patch.setattr(build, "write_leaf", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            ingest(files, tmp_path / "c", workers=1)
    other = Path(shutil.copy(files[2], tmp_path / "other.csv.gz"))
    for sources, rows in ((files[:2], 1_000_000), (files, 900), ([*files[:2], other], 1_000_000)):
        with pytest.raises(BadInput, match="--restart"):
            ingest(sources, tmp_path / "c", rows_per_leaf=rows)
    report = ingest(files[:2], tmp_path / "c", restart=True)
    assert (report.rows_in, report.continued) == (4000, 0)


def test_a_source_that_changed_since_is_read_again(tmp_path, parts, monkeypatch):
    """It repeats stars of another one now, which no source did before."""
    stars, files = parts
    monkeypatch.setattr(build, "BATCH_SOURCES", 1)
    with monkeypatch.context() as patch:
        patch.setattr(build, "write_manifest", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            ingest(files, tmp_path / "c", rows_per_leaf=800, workers=1)
    write_csv(files[1], stars.slice(1900, 1600))
    report = ingest(files, tmp_path / "c", rows_per_leaf=800)
    assert (report.rows_in, report.continued) == (5600, 2)
    assert report.rejected == {"source_id occurs more than once": 100}
    kept = pa.concat_tables([stars.slice(0, 3500), stars.slice(4000)])
    assert same_rows(cone(report.catalogue, 0, 0, 180)[0], kept)
    assert verify(report.catalogue).findings == ()  # no shard of the first run is left


@pytest.mark.parametrize("change", ["size", "date", "md5"])
def test_each_mark_of_a_changed_source_counts(tmp_path, parts, monkeypatch, change):
    """Another length of the same date, another date of the same length, another digest told."""
    stars, files = parts
    monkeypatch.setattr(build, "BATCH_SOURCES", 1)
    with monkeypatch.context() as patch:
        patch.setattr(build, "write_manifest", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            ingest(files, tmp_path / "c", workers=1)
    before = files[1].stat()
    if change == "size":
        write_csv(files[1], stars.slice(2000, 1500))
        os.utime(files[1], ns=(before.st_atime_ns, before.st_mtime_ns))
    elif change == "date":
        os.utime(files[1], ns=(before.st_atime_ns, before.st_mtime_ns + 1))
    else:
        (files[1].parent / "MD5SUM.txt").write_text(f"{'0' * 32}  {files[1].name}\n")
        with pytest.raises(Damaged, match="MD5"):
            ingest(files, tmp_path / "c", workers=1)
        return
    report = ingest(files, tmp_path / "c", workers=1)
    assert (report.rows_in, report.continued) == (5500 if change == "size" else 6000, 2)


def test_a_source_of_another_date_at_its_end_was_changed_meanwhile(parts):
    file = parts[1][0]
    about = file.stat()
    source = FileSource(str(file), file.name, about.st_size, about.st_mtime_ns,
                        load_form("gaia_dr2"), None, 1 << 30)  # fmt: skip
    record = {}
    assert sum(t.num_rows for t in source.tables(record)) == 2000
    assert record["bytes"] == about.st_size
    for other in ({"mtime_ns": about.st_mtime_ns - 1}, {"size": about.st_size + 1}):
        with pytest.raises(Damaged, match="changed while it was read"):
            list(replace(source, **other).tables({}))


def test_full_disk_is_told_as_incomplete(tmp_path, parts, monkeypatch):
    def full(*arguments, **named):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(leaves, "write_shard", full)
        with pytest.raises(Incomplete, match=r"No space left.*run the same command again"):
            ingest(parts[1], tmp_path / "c", workers=1)
    assert not (tmp_path / "c").exists()
    assert ingest(parts[1], tmp_path / "c").continued == 1


def test_a_disk_that_fails_is_told_with_what_is_kept(tmp_path, parts, monkeypatch):
    def fails(*arguments, **named):
        raise OSError(5, "Input/output error")

    kept = "; what is finished is kept: run the same command again to go on"
    for at, name, told in ((leaves, "write_shard", kept), (build, "_begin", "")):
        with monkeypatch.context() as patch:
            patch.setattr(at, name, fails)
            with pytest.raises(Incomplete) as caught:
                ingest(parts[1], tmp_path / "c", workers=1)
        start = f"{tmp_path / 'c'}: could not be written ([Errno 5] Input/output error)"
        assert str(caught.value) == start + told
        assert left_behind(tmp_path) == ([".c.part"] if told else [])
        shutil.rmtree(tmp_path / ".c.part", ignore_errors=True)


def test_no_room_for_the_lock_of_a_catalogue_is_a_full_disk(tmp_path, parts, monkeypatch):
    whole = Path.open

    def full(self, *arguments, **named):
        if self.name == ".c.lock":
            raise OSError(28, "No space left on device")
        return whole(self, *arguments, **named)

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(DiskFull, match="make room and run the same command again") as caught:
        ingest(parts[1], tmp_path / "c", workers=1)
    assert caught.value.store == str(tmp_path / "c")


@pytest.mark.parametrize(("stage", "marker", "told"), [
    ("read", "0*.json", "1 batches are not there; run it again"),
    ("write", "leaf-*.json", "1 leaves are not there; run it again"),
])  # fmt: skip
def test_records_that_are_deleted_meanwhile_are_made_again(tmp_path, parts, stage, marker, told):
    def meddle(now, done, total):
        if now == stage and done == total:
            min((tmp_path / ".c.part" / "progress").glob(marker)).unlink()

    with pytest.raises(Incomplete, match=told):
        ingest(parts[1], tmp_path / "c", progress=meddle, workers=1)
    assert ingest(parts[1], tmp_path / "c", workers=1).catalogue.rows == 6000


def test_files_without_rows_are_named_as_far_as_there_is_room(tmp_path):
    for i in range(build.MOST_NAMED + 2):
        (tmp_path / f"none{i:02d}.csv").write_text(HEAD + "\n" * (i + 1))
    (tmp_path / "one.csv").write_text(f"{HEAD}\n1,10,20,12\n")
    notes = ingest(sorted(tmp_path.iterdir()), tmp_path / "c", workers=1).notes
    assert notes[0] == "none00.csv holds no row"
    assert [note for note in notes if "more files" in note] == ["2 more files hold no row"]
    assert sum(note.endswith(".csv holds no row") for note in notes) == build.MOST_NAMED


@pytest.mark.parametrize("libc", [{}, {"renameat2": lambda *_: ctypes.set_errno(22) or -1}])
def test_a_catalogue_that_cannot_be_exchanged_stays(tmp_path, parts, monkeypatch, libc):
    """On a system, or a file system, that does not swap two folders."""
    old = ingest(parts[1][:1], tmp_path / "c", workers=1).catalogue
    with monkeypatch.context() as patch:
        patch.setattr(publish.ctypes, "CDLL", lambda *_, **__: SimpleNamespace(**libc))
        told = "Invalid argument" if libc else "this system can't swap folders; remove the old one"
        with pytest.raises(Incomplete, match=f"could not be written .*{told}"):
            ingest(parts[1], tmp_path / "c", overwrite=True, workers=1)
    assert open_catalogue(tmp_path / "c").digest == old.digest
    assert ingest(parts[1], tmp_path / "c", overwrite=True, workers=1).continued == 1


def test_bad_sources(tmp_path, parts):
    files = parts[1]
    cases = [
        ([], "at least one"),
        ([tmp_path / "absent"], "exists"),
        ([tmp_path / "loop"], "exists"),
        ([files[0], files[0]], "once"),
    ]
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "hollow").mkdir()
    cases.append(([tmp_path / "hollow"], "a folder with"))
    (tmp_path / "twin.csv.gz").write_bytes(files[1].read_bytes())
    cases.append(([*files, tmp_path / "twin.csv.gz"], "same content"))
    for sources, message in cases:
        with pytest.raises(BadInput, match=message):
            ingest(sources, tmp_path / "c")
    with pytest.raises(BadInput, match="workers"):
        ingest(files, tmp_path / "c", workers=-1)
    with pytest.raises(BadInput, match="rows_per_leaf"):
        ingest(files, tmp_path / "c", rows_per_leaf=0)
    assert not (tmp_path / "c").exists()
    assert left_behind(tmp_path) == []


def test_wrong_schema_among_good_files_leaves_nothing(tmp_path, parts):
    bad = tmp_path / "in" / "other.csv"
    bad.write_text("name,flux\nx,1\n")
    with pytest.raises(BadInput) as caught:
        ingest([tmp_path / "in"], tmp_path / "c")
    assert "other.csv" in caught.value.field
    cut = tmp_path / "in" / "part0.csv.gz"
    bad.unlink()
    cut.write_bytes(cut.read_bytes()[:-50])
    with pytest.raises(Damaged, match=r"part0\.csv\.gz"):
        ingest([tmp_path / "in"], tmp_path / "c")
    assert [p.name for p in tmp_path.iterdir()] == ["in"]


def test_md5sum_beside_the_inputs_is_verified(tmp_path, parts):
    folder = parts[1][0].parent
    sums = [f"{hashlib.md5(p.read_bytes()).hexdigest()}  {p.name}" for p in parts[1]]
    (folder / "_citation.txt").write_text("cite")
    listing = folder / "MD5SUM.txt"
    listing.write_text("\n".join([*sums, "0123 _citation.txt"]) + "\n")
    report = ingest([folder], tmp_path / "good")
    sources = pq.read_table(tmp_path / "good" / SOURCES_NAME)
    assert sources["name"].to_pylist() == [p.name for p in parts[1]]
    assert sources["md5"].to_pylist() == [line.split()[0] for line in sums]
    assert sources["rows"].to_pylist() == [2000] * 3
    assert (report.catalogue.sources, report.catalogue.rows_in) == (3, 6000)
    listing.write_text("\n".join([sums[0], "0" * 32 + "  part1.csv.gz"]) + "\n")
    with pytest.raises(Damaged, match=r"part1\.csv\.gz"):
        ingest([folder], tmp_path / "bad")


def test_files_that_md5sum_lists_and_that_are_not_there_are_counted(tmp_path):
    """Of files that hold rows: a list also names what says whom to cite, and itself."""
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "one.csv").write_text(f"{HEAD}\n1,10,20,9\n")
    digest = hashlib.md5((folder / "one.csv").read_bytes()).hexdigest()
    others = ["_citation.txt", ".note", "MD5SUM.txt"]
    for absent in ([], ["part8.csv.gz", "part9.csv.gz"]):
        lines = [f"{digest}  one.csv", *(f"{'a' * 32}  {name}" for name in others + absent)]
        (folder / "MD5SUM.txt").write_text("\n".join(lines) + "\n")
        notes = ingest([folder], tmp_path / f"out{len(absent)}").notes
        told = [note for note in notes if "MD5SUM" in note]
        assert told == ["2 files that MD5SUM.txt lists are not among the sources"] * bool(absent)


def test_a_fetched_cone_without_rows_makes_an_empty_catalogue(tmp_path):
    (tmp_path / "none.csv").write_text(HEAD + "\n")
    (tmp_path / ".fetch").mkdir()
    note_coverage(tmp_path, ["none.csv"], all_sky("a test"))
    report = ingest([tmp_path / "none.csv"], tmp_path / "c")
    assert (report.rows_in, report.catalogue.rows, report.catalogue.leaves) == (0, 0, ())
    assert cone(report.catalogue, 0, 0, 180)[0].num_rows == 0
    assert info(report.catalogue)["bytes_per_row"] is None


def test_rows_crowded_beyond_the_counting_order_are_cut_further(tmp_path):
    """A cluster within half an arcminute: leaves of order 10 and more, each small enough."""
    rng = np.random.default_rng(5)
    lines = [
        f"{i + 1},{80 + x / 3600:.12f},{-70 + y / 3600:.12f},{12 + i % 8}"
        for i, (x, y) in enumerate(rng.uniform(-30, 30, (5000, 2)))
    ]
    (tmp_path / "cluster.csv").write_text("\n".join([HEAD, *lines]) + "\n")
    catalogue = ingest([tmp_path / "cluster.csv"], tmp_path / "c", rows_per_leaf=600).catalogue
    assert catalogue.leaf_table["order"].min() > 9
    assert catalogue.leaf_table["rows"].max() <= 600
    assert cone(catalogue, 80, -70, 0.1)[0].num_rows == 5000


def test_leaves_that_would_not_fit_into_memory_are_refused(tmp_path, parts, monkeypatch):
    with pytest.raises(BadInput, match=r"rows_per_leaf.*--memory"):
        ingest(parts[1], tmp_path / "c", rows_per_leaf=10_000_000, memory_bytes=300 << 20)
    with pytest.raises(BadInput, match="memory"):
        ingest(parts[1], tmp_path / "c", memory_bytes=1 << 20)
    lines = [f"{i},10.0,20.0,{10 + i % 9}" for i in range(1, 400)]
    (tmp_path / "one.csv").write_text("\n".join([HEAD, *lines]) + "\n")
    monkeypatch.setattr(memory, "LEAF_ROW_BYTES", (2 << 30) // 300)
    with pytest.raises(BadInput, match="399 rows in one pixel of order 18"):
        ingest([tmp_path / "one.csv"], tmp_path / "d", rows_per_leaf=100)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc keeps what is freed")
def test_memory_that_was_freed_is_given_back():
    """64 MB in blocks below one that is kept: the system has at least half of them again."""
    libc, size = ctypes.CDLL(None), 1 << 16
    libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
    libc.free.argtypes = [ctypes.c_void_p]
    *below, top = (ctypes.memset(libc.malloc(size), 1, size) for _ in range(1024))
    for block in below:
        libc.free(block)
    held = resident_bytes()
    memory.give_back()
    assert held - resident_bytes() > 32 << 20
    libc.free(top)


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_values_that_no_star_has_count_as_absent(tmp_path):
    """One row with a motion of 3e38 must not hide its neighbours; a magnitude of 3e38 is none."""
    head = HEAD + ",pmra,parallax"
    rows = ["1,10,20,12,3.4e38,1", "2,10.1,20,12,1,3.4e38", "3,10,20.1,13,1,1", "4,10,20,3e38,1,1"]
    (tmp_path / "odd.csv").write_text("\n".join([head, *rows]) + "\n")
    report = ingest([tmp_path / "odd.csv"], tmp_path / "c")
    assert report.rejected == {"G magnitude absent or not finite": 1}
    stars = cone(report.catalogue, 10, 20, 1, epoch_jyear=2050.0)[0]
    assert sorted(stars["source_id"].to_pylist()) == [1, 2, 3]
    assert stars["pmra"].null_count == stars["parallax"].null_count == 1
    assert np.isfinite(report.catalogue.leaf_table["max_proper_motion_mas_yr"]).all()


@pytest.mark.parametrize(
    ("column", "most"),
    [("pmra", 1e5), ("pmdec", 1e5), ("parallax", 1e4), ("radial_velocity", 1e5)],
)
def test_the_largest_values_that_are_measurements(tmp_path, column, most):
    """In mas/yr, mas and km/s; what is beyond counts as absent, and is told with the limit."""
    values = [most, -most, most + 1.0, -1.001 * most]
    rows = [f"{k + 1},{10.0 + 0.1 * k},20,12,{value}" for k, value in enumerate(values)]
    (tmp_path / "a.csv").write_text("\n".join([f"{HEAD},{column}", *rows]) + "\n")
    report = ingest([tmp_path / "a.csv"], tmp_path / "c")
    stars = cone(report.catalogue, 10, 20, 1)[0].sort_by("source_id")
    assert stars[column].to_pylist() == [most, -most, None, None]
    assert any(f"2 value(s) of {column} beyond {most:g}" in said for said in report.notes)


def test_another_meaning_of_the_columns_is_another_ingest(tmp_path, parts, monkeypatch):
    """A column map that was edited after a kill is not mixed with the old one."""
    text = "\n".join(
        ['name = "mine"', 'description = "d"', 'credit = "c"', "ref_epoch_jyear = 2015.5",
         'epoch_scale = "TCB"', '[source_id]\nfrom = "source_id"',
         '[ra]\nfrom = "ra"\nunit = "deg"', '[dec]\nfrom = "dec"\nunit = "deg"',
         '[phot_g_mean_mag]\nfrom = "phot_g_mean_mag"\nunit = "mag"']
    )  # fmt: skip
    form = tmp_path / "mine.toml"
    form.write_text(text)
    with monkeypatch.context() as patch:
        patch.setattr(build, "write_leaf", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            ingest(parts[1], tmp_path / "c", form=form, workers=1)
    form.write_text(text + "\nadd = 5.0\n")
    with pytest.raises(BadInput, match="--restart"):
        ingest(parts[1], tmp_path / "c", form=form)
    form.write_text(text)
    assert ingest(parts[1], tmp_path / "c", form=form).continued == 1


def test_what_a_kill_after_publishing_left_is_cleaned_up(tmp_path, parts):
    ingest(parts[1], tmp_path / "c")
    (tmp_path / ".c.part" / "progress").mkdir(parents=True)
    (tmp_path / ".c.part" / "progress" / "request.json").write_text("{}")
    with pytest.raises(BadInput, match="nothing is yet"):
        ingest(parts[1], tmp_path / "c")
    assert left_behind(tmp_path) == []


def test_two_runs_on_one_cluster_keep_their_tasks_apart(tmp_path, parts):
    """A scheduler shares results by name: two ingests, at once, of other files."""
    from threading import Thread

    from distributed import Client, LocalCluster

    from catalog_tools.engine.cluster_scheduler import ClusterScheduler

    stars, files = parts
    found = {}
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:

        def run(number):
            with Client(cluster, set_as_default=False) as client:
                found[number] = ingest(
                    [files[number]], tmp_path / f"c{number}", rows_per_leaf=300,
                    scheduler=ClusterScheduler(client, 1),
                )  # fmt: skip

        threads = [Thread(target=run, args=(number,)) for number in (0, 1)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    for number in (0, 1):
        kept = cone(found[number].catalogue, 0, 0, 180)[0]
        assert same_rows(kept, stars.slice(2000 * number, 2000))


def test_rows_are_counted_also_where_none_is_kept(tmp_path):
    """The number of a row is its place among all that were read, rejected ones too."""
    held = batches._Held(tmp_path, "x", 0, 100)
    held.add({PLACE_COLUMN: np.empty(0, np.int64)}, 5)
    held.add({PLACE_COLUMN: np.array([held.rows_in + 1])}, 3)
    assert (held.rows_in, held.parts[0][PLACE_COLUMN].tolist()) == (8, [6])


def test_a_row_left_out_is_told_with_the_source_it_came_from():
    """Also the first of a run of rows, which lies just after the last of another file's."""
    pieces = SimpleNamespace(pieces=[SimpleNamespace(batch=0), SimpleNamespace(batch=1)])
    context = SimpleNamespace(
        pieces=pieces, labels=[["a"], ["b", "c"]], starts=[np.array([0]), np.array([0, 10])]
    )
    rows = {PLACE_COLUMN: np.array([4, 5, 6, 11, 3]), "source_id": np.arange(5)}
    rows |= {name: np.zeros(5) for name in ("ra", "dec")} | {"phot_g_mean_mag": np.zeros(5, "f4")}
    told = leaves._surplus_table(
        context, [(0, 0, 3), (1, 0, 2)], rows, np.array([2, 3, 4]), ["twice"] * 3
    )
    assert told["source"].to_pylist() == ["a", "c", "b"]
    assert told["row"].to_pylist() == [6, 1, 3]


@pytest.mark.parametrize(
    ("more", "form", "is_noted"),
    [
        (("pmra", "1"), None, True),
        (("ref_epoch", ""), None, True),
        (("ref_epoch", "2015.5"), None, False),
        (("designation", "Gaia DR3 1"), None, False),
        (("teff_val", ""), None, False),
        (("pmra", "1"), "gaia_dr3", False),
    ],
)
def test_a_release_that_no_file_names_is_told(tmp_path, more, form, is_noted):
    """DR3 is half a year later: Barnard's star would be 5 arcsec off."""
    (tmp_path / "a.csv").write_text(f"{HEAD},{more[0]}\n1,2,3,4,{more[1]}\n")
    report = ingest([tmp_path / "a.csv"], tmp_path / "cat", form=form)
    told = "not named by the files, taken to be Gaia DR2, epoch 2015.5 (--form gaia_dr3 if"
    assert any(told in note for note in report.notes) == is_noted
    assert told in info(report.catalogue)["facts"].get("release", "") or not is_noted
    assert ("release" in info(report.catalogue)["facts"]) == is_noted


PLACES_ALONE = """
name = "places"
description = "Places."
credit = "nobody"
epoch_scale = "TCB"
ref_epoch_jyear = 2015.5
source_id = { rule = "position" }
ra = { from = "ra", unit = "deg" }
dec = { from = "dec", unit = "deg" }
phot_g_mean_mag = { from = "g", unit = "mag" }
"""


@pytest.mark.parametrize(
    ("turn", "kind", "said"),
    [
        (360.0, "float32", "single precision: right ascensions are off by up to 55 mas"),
        (24.0, "float64", "between 0 and 24: are they hours?"),
        (2.0 * np.pi, "float64", "between 0 and 6.28: are they radians?"),
        (360.0, "float64", None),
    ],
)
def test_places_that_look_wrong_are_told(tmp_path, turn, kind, said):
    """Some hundred stars all over the sky as another unit or precision would write them."""
    rng = np.random.default_rng(7)
    ra = np.linspace(0.001, 0.999, 300) * turn
    dec = rng.uniform(-80.0, 80.0, 300) * turn / 360.0
    table = {"ra": ra.astype(kind), "dec": dec.astype(kind), "g": rng.uniform(5.0, 15.0, 300)}
    pq.write_table(pa.table(table), tmp_path / "stars.parquet")
    (tmp_path / "map.toml").write_text(PLACES_ALONE)
    made = ingest([tmp_path / "stars.parquet"], tmp_path / "out", form=tmp_path / "map.toml")
    told = [note for note in made.notes if "are off by" in note or "are they" in note]
    assert [said in note for note in told] == [True] * (said is not None)
    assert all(note.startswith("stars.parquet: ") for note in told)
    if kind == "float32":  # what is told is the rounding of single precision near 360 degrees
        off_mas = 3.6e6 * np.abs(ra.astype(kind).astype(float) - ra).max()
        assert 40.0 < off_mas <= 55.0


def test_stars_at_one_place_stand_by_their_ids_whatever_the_order_of_the_files(tmp_path):
    """Five in one pixel of order 29, and one beside: the shard has the same bits."""
    stars = ["7,10.0,20.0,12.0", "3,10.0,20.0,15.0", "9,10.0,20.0,11.0", "5,10.0,20.0,13.0",
             "2,10.0,20.0,14.0", "1,10.1,20.0,14.0"]  # fmt: skip
    found = []
    for k, order in enumerate((stars, stars[::-1], sorted(stars))):
        files = [tmp_path / f"{k}-{i}.csv" for i in range(2)]
        for i, file in enumerate(files):
            file.write_text("\n".join([HEAD, *order[3 * i : 3 * i + 3], ""]))
        ingest(files, tmp_path / f"catalogue{k}", workers=1)
        found.append(shard_bits(open_catalogue(tmp_path / f"catalogue{k}")))
    assert found[0] == found[1] == found[2]
    rows, _ = cone(open_catalogue(tmp_path / "catalogue0"), 10.0, 20.0, 0.01)
    assert rows["source_id"].to_pylist() == [2, 3, 5, 7, 9]


def test_a_catalogue_that_came_while_the_lock_was_waited_for_is_not_replaced(tmp_path, monkeypatch):
    """Two ingests of one name: the second looks for the name again once it is alone."""
    for name in ("first", "second"):
        (tmp_path / f"{name}.csv").write_text(f"{HEAD}\n1,10.0,20.0,12.0\n")
    alone, bits = publish._alone, []

    def first_comes_in_between(lock):
        with monkeypatch.context() as patch:
            patch.setattr(publish, "_alone", alone)
            report = ingest([tmp_path / "first.csv"], tmp_path / "other", workers=1)
        shutil.copytree(report.catalogue.path, tmp_path / "catalogue")
        bits.append((tmp_path / "catalogue" / "nightglass.json").read_bytes())
        return alone(lock)

    monkeypatch.setattr(publish, "_alone", first_comes_in_between)
    with pytest.raises(BadInput, match="output"):
        ingest([tmp_path / "second.csv"], tmp_path / "catalogue", workers=1)
    assert [(tmp_path / "catalogue" / "nightglass.json").read_bytes()] == bits


def test_tasks_run_where_they_are_asked_to(tmp_path, parts, monkeypatch):
    """By the scheduler that is given, else by so many threads."""
    made, ran = [], []

    class Watched(LocalScheduler):
        def __init__(self, kind, workers):
            super().__init__(kind, workers)
            made.append((kind, workers))

        def run(self, graph, keys, done):
            ran.append(self)
            return super().run(graph, keys, done)

    mine = Watched("synchronous", 1)
    ingest(parts[1], tmp_path / "given", scheduler=mine)
    assert set(ran) == {mine}
    monkeypatch.setattr(of_ingest, "LocalScheduler", Watched)
    ingest(parts[1], tmp_path / "threads", workers=3)
    assert made == [("synchronous", 1), ("threads", 3)]
    assert ran[-1].kind == "threads"
