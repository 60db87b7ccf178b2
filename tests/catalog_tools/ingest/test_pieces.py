"""Pieces: no changed byte is ever read, two writers never mix, and a resume mends what broke."""

from __future__ import annotations

import threading
import tracemalloc
from itertools import combinations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from star_rows import random_stars, same_rows, write_csv

from catalog_tools.columns import HEALPIX_COLUMN, INCOMING
from catalog_tools.errors import BadInput, Damaged
from catalog_tools.ingest import batches, build, duplicates, leaves
from catalog_tools.ingest.batches import Batch, finished, split, sweep
from catalog_tools.ingest.ingest import ingest
from catalog_tools.ingest.pieces import (
    BLOCK_ROWS,
    IDS,
    PIECE,
    Pieces,
    column,
    is_whole,
    search,
    write_piece,
)
from catalog_tools.query.query import cone
from catalog_tools.readers import read_tables


def rows_of(n, seed=1, ids=None):
    rng = np.random.default_rng(seed)
    rows = {name: rng.random(n).astype(kind) for name, kind in PIECE.items() if name != IDS}
    rows[HEALPIX_COLUMN] = np.sort(rng.integers(0, 12 << 58, n))[rng.permutation(n)]
    rows["source_id"] = rng.permutation(n) if ids is None else ids
    return rows


def flip(path, at):
    data = bytearray(path.read_bytes())
    data[at] ^= 0x10
    path.write_bytes(data)


def test_any_run_of_any_column_is_read_and_found(tmp_path):
    n = 3 * BLOCK_ROWS + 100
    rows = rows_of(n)
    expected = {name: values.copy() for name, values in rows.items()}
    piece = write_piece(tmp_path, 0, "a.rows", rows)
    order = np.argsort(expected[HEALPIX_COLUMN])
    edges = (0, 5, BLOCK_ROWS, BLOCK_ROWS + 1, n - 1, n)
    for name in expected:
        for start in edges:
            for stop in (e for e in edges if e >= start):
                got = column(tmp_path, piece, name, start, stop)
                assert np.array_equal(got, expected[name][order][start:stop])
    for name, values in ((HEALPIX_COLUMN, np.sort(expected[HEALPIX_COLUMN])), (IDS, np.arange(n))):
        wanted = [0, 7, int(values[0]), int(values[BLOCK_ROWS]), int(values[-1]), 1 << 62]
        found = search(tmp_path, piece, name, wanted)
        assert found == np.searchsorted(values, wanted).tolist()


def test_every_flipped_bit_is_noticed(tmp_path):
    n = BLOCK_ROWS + 50
    piece = write_piece(tmp_path, 0, "a.rows", rows_of(n))
    path = tmp_path / "a.rows"
    whole = path.read_bytes()
    assert is_whole(tmp_path, piece)
    for at in [*np.random.default_rng(2).integers(0, len(whole), 60).tolist(), len(whole) - 9]:
        flip(path, at)
        assert not is_whole(tmp_path, piece)
        path.write_bytes(whole)
    path.write_bytes(whole[:-1])
    assert not is_whole(tmp_path, piece)
    path.unlink()
    with pytest.raises(Damaged, match=r"a\.rows"):
        column(tmp_path, piece, IDS)


def test_a_range_takes_the_rows_of_each_piece_from_its_first_to_before_its_last(tmp_path):
    """Of pixels and of source_ids, at the ends of pieces and within them, against all rows."""
    held = [np.arange(10, 15), np.array([14, 14, 17]), np.array([17]), np.arange(17, 20)]
    made = [rows_of(len(values), ids=values.copy()) for values in held]
    for rows, values in zip(made, held, strict=True):
        rows[HEALPIX_COLUMN] = values.copy()
    runs = [write_piece(tmp_path, i, f"{i}.rows", rows) for i, rows in enumerate(made)]
    pieces = Pieces(tmp_path, runs)
    for first, end in combinations(range(9, 22), 2):
        expected = [x for values in held for x in values.tolist() if first <= x < end]
        found = pieces.gather(pieces.runs(first, end), HEALPIX_COLUMN)
        assert found.tolist() == expected
        assert pieces.rows_between(first, end) == len(expected)
        ids = [pieces.ids_between(k, first, end) for k in pieces.with_ids(first, end).tolist()]
        assert [x for values in ids for x in values.tolist()] == expected


@pytest.mark.parametrize("kept", [0, 5, 20 * 99 - 3, 20 * 99 + 3])
def test_a_piece_that_is_cut_within_a_value_is_damaged(tmp_path, kept):
    piece = write_piece(tmp_path, 0, "a.rows", rows_of(99))
    path = tmp_path / "a.rows"
    path.write_bytes(path.read_bytes()[:kept])
    assert not is_whole(tmp_path, piece)
    with pytest.raises(Damaged, match=r"a\.rows"):
        [column(tmp_path, piece, name) for name in PIECE]


@pytest.mark.parametrize("where", [0.01, 0.3, 0.5, 0.7])
def test_a_piece_that_changed_between_the_passes_is_told_and_mended(tmp_path, monkeypatch, where):
    stars = random_stars(9000, 4)
    source = write_csv(tmp_path / "stars.csv", stars)
    real = build._write_all

    def meddle(context, *rest):
        path = context.work.progress / context.pieces.pieces[0].name
        flip(path, int(path.stat().st_size * where))
        return real(context, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(build, "_write_all", meddle)
        with pytest.raises(Damaged, match=r"\.rows: damaged: .*run the same command again"):
            ingest([source], tmp_path / "c", rows_per_leaf=700, workers=1)
    assert not (tmp_path / "c").exists()
    report = ingest([source], tmp_path / "c", rows_per_leaf=700)
    assert same_rows(cone(report.catalogue, 0, 0, 180)[0], stars)
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_a_changed_count_is_told_and_mended(tmp_path, monkeypatch):
    stars = random_stars(3000, 4)
    source = write_csv(tmp_path / "stars.csv", stars)
    real = build._total_counts

    def meddle(splits, folder):
        flip(folder / splits[0].folder / batches.COUNTS_NAME, -3)
        return real(splits, folder)

    with monkeypatch.context() as patch:
        patch.setattr(build, "_total_counts", meddle)
        with pytest.raises(Damaged, match=r"counts\.npy"):
            ingest([source], tmp_path / "c", workers=1)
    assert ingest([source], tmp_path / "c").catalogue.rows == 3000


@pytest.mark.parametrize("name", ["rejects.arrow", "leaf-*.arrow"])
def test_changed_rows_to_be_rejected_are_told_and_mended(tmp_path, monkeypatch, name):
    """Those without a place, found while reading, and those that occur twice, while writing."""
    stars = random_stars(300, 4)
    source = write_csv(tmp_path / "stars.csv", pa.concat_tables([stars, stars.slice(0, 9)]))
    source.write_text(source.read_text() + "7,,20,,,,,12,,\n")
    real = build._write_rejects

    def meddle(context, *rest):
        path = min(context.work.progress.rglob(name))
        flip(path, path.stat().st_size // 2)
        return real(context, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(build, "_write_rejects", meddle)
        with pytest.raises(Damaged, match=r"\.arrow: damaged: .*run the same command again"):
            ingest([source], tmp_path / "c", workers=1)
    report = ingest([source], tmp_path / "c", workers=1)
    assert (report.catalogue.rows, sum(report.rejected.values())) == (300, 10)


class Slow:
    """A source that waits for the other reader before each table."""

    label = "slow"

    def __init__(self, path, barrier):
        self.path, self.barrier = path, barrier

    def identity(self):
        return [str(self.path)]

    def tables(self, record):
        record.update(bytes=1, md5="")
        for table in read_tables(self.path):
            for start in range(0, table.num_rows, 500):
                self.barrier.wait(30)
                yield table.slice(start, 500)


def test_two_writers_of_one_batch_never_mix(tmp_path):
    stars = random_stars(5000, 6)
    source = Slow(write_csv(tmp_path / "stars.csv", stars), threading.Barrier(2))
    folder = tmp_path / "progress"
    folder.mkdir()
    batch = Batch(0, (source,))
    writers = [threading.Thread(target=split, args=(batch, folder, 900)) for _ in range(2)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    done = finished(batch, folder, verify=True)
    assert done is not None
    assert len([p for p in folder.iterdir() if p.is_dir()]) == 2
    sweep(folder, [done])
    assert sorted(p.name for p in folder.iterdir()) == sorted(["000000.json", done.folder])
    assert finished(batch, folder, verify=True) == done
    ids = [column(folder, piece, IDS) for piece in done.pieces]
    assert np.array_equal(np.sort(np.concatenate(ids)), np.sort(stars["source_id"].to_numpy()))


def test_a_reader_that_fails_leaves_nothing(tmp_path):
    class Broken(Slow):
        def tables(self, record):
            yield next(read_tables(self.path))
            raise BadInput("source", "x", "y")

    source = Broken(write_csv(tmp_path / "stars.csv", random_stars(100, 6)), None)
    (tmp_path / "progress").mkdir()
    with pytest.raises(BadInput):
        split(Batch(0, (source,)), tmp_path / "progress", 900)
    assert list((tmp_path / "progress").iterdir()) == []


@pytest.mark.parametrize("kind", ["each twice", "one id", "all but one"])
def test_repeated_ids_are_found_in_bounded_memory(tmp_path, kind):
    pieces, n = [], 40_000
    for i in range(20):
        ids = {
            "each twice": np.arange(n) + n * (i // 2),
            "one id": np.full(n, 7),
            "all but one": np.r_[np.arange(n - 1) * 10, 10**12 + i],
        }[kind]
        rows = {name: np.zeros(n, dtype) for name, dtype in PIECE.items() if name != IDS}
        rows[HEALPIX_COLUMN] = np.arange(n) + (100 - i)
        pieces.append(write_piece(tmp_path, i, f"{i}.rows", {**rows, "source_id": ids}))
    tracemalloc.start()
    duplicates.find(Pieces(tmp_path, pieces), tmp_path, 50_000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * n * 8 * 0.75  # the ids alone
    found = duplicates.Repeated(tmp_path)
    if kind == "each twice":
        assert np.array_equal(found.ids, np.arange(10 * n))
        assert np.array_equal(found.pixels[:n], np.arange(n) + 99)
    elif kind == "one id":
        assert (found.ids.tolist(), found.pixels.tolist()) == ([7], [81])
    else:
        assert np.array_equal(found.ids, np.arange(n - 1) * 10)
        assert np.array_equal(found.pixels, np.arange(n - 1) + 81)


@pytest.mark.parametrize("bucket_rows", [1, 2, 5, 100])
def test_ids_that_are_far_apart_are_found_however_few_are_held(tmp_path, bucket_rows):
    """In the first and the last of the pieces, all of one bucket."""
    pieces = []
    for i, ids in enumerate(([4, 9], [5, 6], [7, 8], [2, 9], [3, 4])):
        rows = {name: np.zeros(2, dtype) for name, dtype in PIECE.items() if name != IDS}
        rows["source_id"] = np.array(ids)
        pieces.append(write_piece(tmp_path, i, f"{i}.rows", rows))
    found = duplicates._repeated_between(Pieces(tmp_path, pieces), None, None, bucket_rows)
    assert found.tolist() == [4, 9]


def test_surplus_rows_in_many_parts_are_all_accounted_for(tmp_path, monkeypatch):
    monkeypatch.setattr(leaves, "SURPLUS_ROWS", 7)
    stars = random_stars(400, 8)
    names = [write_csv(tmp_path / f"{x}.csv", stars.slice(i)) for i, x in enumerate("abc")]
    report = ingest(names, tmp_path / "c", rows_per_leaf=100)
    assert report.rejected == {"source_id occurs more than once": 797}
    rejected = pq.read_table(tmp_path / "c" / build.REJECTS_NAME)
    assert rejected.num_rows == 797
    assert same_rows(cone(report.catalogue, 0, 0, 180)[0], stars)


def large_pages(path, stars):
    pq.write_table(stars, path, use_dictionary=False, data_page_size=1 << 30, compression="none",
                   max_rows_per_page=10**8)  # fmt: skip


def test_files_that_do_not_fit_into_memory_are_refused_by_name(tmp_path):
    from astropy.table import Table

    stars = random_stars(3000, 3)
    large_pages(tmp_path / "pages.parquet", stars)
    pq.write_table(stars, tmp_path / "dictionaries.parquet", data_page_size=1024,
                   dictionary_pagesize_limit=1 << 30)  # fmt: skip
    pq.write_table(stars, tmp_path / "plain.parquet", use_dictionary=False, data_page_size=1024)
    table = Table({name: stars[name].to_numpy() for name in INCOMING.names})
    for name in ("tabledata", "binary2"):
        path = tmp_path / f"{name}.vot"
        table.write(path, format="votable", tabledata_format=name, overwrite=True)
    for name, what in (("pages.parquet", "pages"), ("tabledata.vot", "VOTable"),
                       ("binary2.vot", "VOTable"), ("dictionaries.parquet", "pages")):  # fmt: skip
        path = tmp_path / name
        assert sum(t.num_rows for t in read_tables(path, most_bytes=100 << 20)) == 3000
        with pytest.raises(BadInput, match=rf"{name}.*{what} of at most \d+ bytes.*--memory"):
            list(read_tables(path, most_bytes=256 << 10))
    rows = read_tables(tmp_path / "plain.parquet", most_bytes=256 << 10)
    assert sum(t.num_rows for t in rows) == 3000


def test_subfolders_are_told_of(tmp_path):
    stars = random_stars(200, 3)
    folder = tmp_path / "in"
    for name in ("", "a", "b", ".hidden", "_made"):
        (folder / name).mkdir(exist_ok=True)
    write_csv(folder / "stars.csv", stars.slice(0, 100))
    write_csv(folder / "a" / "more.csv", stars.slice(100))
    report = ingest([folder], tmp_path / "c")
    assert any("2 subfolders were not looked into" in note for note in report.notes)
    assert report.catalogue.facts["subfolders_left_out"] == 2
    both = ingest([folder, folder / "a"], tmp_path / "d")
    assert both.catalogue.rows == 200
    assert any("1 subfolders" in note for note in both.notes)
    (folder / "stars.csv").unlink()
    with pytest.raises(BadInput, match="2 subfolders"):
        ingest([folder], tmp_path / "e")


def test_a_pixel_of_several_pieces_is_counted_whole(tmp_path):
    """Rows of one place in four pieces: all pieces count."""
    (tmp_path / "batch").mkdir()
    held = batches._Held(tmp_path, "batch", 0, piece_rows=10)
    for k in range(4):
        rows = rows_of(10, seed=k)
        rows[HEALPIX_COLUMN][:6] = 7 << 56  # the others anywhere
        held.add(rows, 10)
    assert len(held.pieces) == 4
    pixels, counts = held.counts()
    assert counts.sum() == 40
    assert counts.max() >= 24
    assert (np.diff(pixels) > 0).all()
