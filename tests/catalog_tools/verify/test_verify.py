"""`verify` finds every kind of damage, names all of it, and finds nothing where all is well."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import google_crc32c
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from star_rows import random_stars, same_rows, write_csv

from catalog_tools.catalogue import (
    LEAVES_NAME,
    MANIFEST_NAME,
    REJECTS_NAME,
    ROW_GROUPS_NAME,
    SOURCES_NAME,
    open_catalogue,
    write_manifest,
)
from catalog_tools.columns import STORED
from catalog_tools.errors import BadInput, Damaged
from catalog_tools.ingest.ingest import ingest
from catalog_tools.ingest.shards import write_shard
from catalog_tools.query.query import cone
from catalog_tools.query.starlight import make_starlight
from catalog_tools.verify import distinct
from catalog_tools.verify import shards as verify_shards
from catalog_tools.verify.distinct import Distinct
from catalog_tools.verify.verify import MOST_REPEATED, _repeated, verify


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A catalogue of a dozen shards with rejected rows."""
    folder = tmp_path_factory.mktemp("small")
    stars = random_stars(2000, 6)
    twice = pa.concat_tables([stars, stars.slice(0, 3)])
    write_csv(folder / "stars.csv", twice)
    return ingest([folder / "stars.csv"], folder / "made", rows_per_leaf=300).catalogue


@pytest.fixture
def copy(tmp_path, small):
    shutil.copytree(small.path, tmp_path / "copy")
    return open_catalogue(tmp_path / "copy")


def file_of(catalogue, name):
    return Path(catalogue.path) / name


def flip(path, at=None, bit=2):
    data = bytearray(path.read_bytes())
    data[len(data) // 2 if at is None else at] ^= bit
    path.write_bytes(data)


def texts(catalogue, **options):
    return [str(finding) for finding in verify(catalogue, **options).findings]


def test_same_catalogue_is_whole(copy, stars, catalogue):
    heard = []
    for made in (copy, catalogue):
        report = verify(made, progress=lambda *call: heard.append(call))
        assert report.whole
        assert (report.findings, report.notes) == ((), ())
        assert (report.rows, report.shards) == (made.rows, made.leaf_table.size)
        assert report.bytes == made.leaf_table["bytes"].sum()
        assert heard[-1] == ("verify", report.shards, report.shards)
    assert verify(copy, workers=1) == verify(copy, workers=3)
    with pytest.raises(BadInput, match="workers"):
        verify(copy, workers=0)


def test_another_catalogue_in_its_place_is_named(copy, tmp_path):
    """Whole, and of the same name: what was opened is no more what is there."""
    write_csv(tmp_path / "stars.csv", random_stars(500, 7))
    other = ingest([tmp_path / "stars.csv"], tmp_path / "other", rows_per_leaf=300, name=copy.name)
    shutil.rmtree(copy.path)
    shutil.move(other.catalogue.path, copy.path)
    now = open_catalogue(copy.path)
    assert now.name == copy.name
    assert verify(now).whole
    assert f"{MANIFEST_NAME}: was changed since the catalogue was opened" in texts(copy)


EVERY_FILE = [
    MANIFEST_NAME, LEAVES_NAME, ROW_GROUPS_NAME, SOURCES_NAME, REJECTS_NAME, "partition_info.csv",
    "dataset/_common_metadata", "skymap.fits", "point_map.fits", "properties", "hats.properties",
]  # fmt: skip


@pytest.mark.parametrize("name", EVERY_FILE)
def test_every_file_missing_or_cut_is_named(copy, name):
    path = file_of(copy, name)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert any(text.startswith(f"{name}: ") for text in texts(copy))
    path.unlink()
    assert any(text.startswith(f"{name}: ") for text in texts(copy))


@pytest.mark.parametrize("name", EVERY_FILE)
def test_flipped_bits_in_every_kind_of_file_are_named(copy, name):
    """Where the bit says something: in maps among the counts, else anywhere."""
    path = file_of(copy, name)
    data = path.read_bytes()
    if name.endswith(".fits"):
        places = [len(data) - 2880 * 2, 2880 * 2 + 3000 - len(data) % 2]
    elif name == "dataset/_common_metadata":
        places = [data.index(b"pmra"), len(data) - 2]
    else:
        places = np.random.default_rng(1).integers(0, len(data), 3).tolist()
    for at in places:
        path.write_bytes(data)
        flip(path, at)
        assert any(name in text for text in texts(copy)), at


def test_flipped_bits_in_shards_are_named_by_part(copy):
    leaf = max(copy.leaves, key=lambda leaf: leaf.rows)
    path = file_of(copy, leaf.path)
    good = path.read_bytes()
    places = {
        leaf.row_groups[0].offset + 9: "row group 0 does not match its checksum",
        leaf.bytes - 20: "the footer does not match its checksum",
        1: "bytes outside its row groups and its footer",
    }
    for at, what in places.items():
        path.write_bytes(good)
        flip(path, at)
        found = texts(copy)
        assert found[0].startswith(f"{leaf.path}: {what}")
        assert len(found) == 1


def test_removed_truncated_grown_and_swapped_shards_are_all_listed(copy):
    gone, cut, grown, left, right, damaged = (leaf.path for leaf in copy.leaves[:6])
    file_of(copy, gone).unlink()
    file_of(copy, cut).write_bytes(file_of(copy, cut).read_bytes()[:-7])
    file_of(copy, grown).write_bytes(file_of(copy, grown).read_bytes() + b"1")
    one, other = file_of(copy, left).read_bytes(), file_of(copy, right).read_bytes()
    file_of(copy, left).write_bytes(other)
    file_of(copy, right).write_bytes(one)
    flip(file_of(copy, damaged), copy.leaves[5].row_groups[0].offset + 5)
    file_of(copy, "dataset/extra.parquet").write_bytes(b"?")
    file_of(copy, "note.txt").write_text("mine")
    report = verify(copy)
    named = {finding.path: finding.what for finding in report.findings}
    assert set(named) == {
        gone, cut, grown, left, right, damaged, "dataset/extra.parquet", "note.txt"
    }  # fmt: skip
    assert "missing" in named[gone]
    assert "bytes long" in named[cut]
    assert "bytes long" in named[grown]
    assert "no part" in named["note.txt"]
    assert not report.whole


def test_edited_partition_info_is_named(copy):
    path = file_of(copy, "partition_info.csv")
    lines = path.read_text().splitlines()
    order, pixel, rows = lines[2].split(",")
    edits = {
        "says": [*lines[:2], f"{order},{pixel},{int(rows) + 1}", *lines[3:]],
        "has no leaf": [*lines[:2], *lines[3:]],
        "not there": [*lines, "9,12345,17"],
        "twice": [*lines, lines[2]],
        "understood": ["Norder,pixel", *lines[1:]],
    }
    for what, edited in edits.items():
        path.write_text("\n".join(edited) + "\n")
        found = texts(copy)
        assert all(text.startswith("partition_info.csv: ") for text in found)
        assert any(what in text for text in found)


def test_edited_properties_are_named(copy):
    path = file_of(copy, "hats.properties")
    path.write_text(re.sub(r"hats_nrows=\d+", "hats_nrows=5", path.read_text()))
    found = texts(copy)
    assert any("hats_nrows=5" in text for text in found)
    assert any("differs from properties" in text for text in found)


def test_properties_without_a_line_are_named(copy):
    """In both files alike, so that neither differs from the other."""
    for name in ("properties", "hats.properties"):
        path = file_of(copy, name)
        path.write_text(re.sub(r"hats_nrows=\d+\n", "", path.read_text()))
    found = texts(copy)
    assert len(found) == 2
    assert all("hats_nrows=;" in text for text in found)


def rewritten(made, folder, change):
    """A catalogue that is consistent in every checksum but whose rows or tables were changed.

    change : called with the rows of all leaves and both tables; returns the columns of one shard.
    """
    leaves, groups = made.leaf_table.copy(), made.row_group_table.copy()
    shutil.copytree(made.path, folder)
    change(folder, leaves, groups)
    content = {
        key: getattr(made, key)
        for key in ("name", "description", "ref_epoch_jyear", "synthetic", "rows", "sources",
                    "brightest_g_mag", "faintest_g_mag", "rows_in", "rejected", "facts")
    }  # fmt: skip
    digest = write_manifest(folder, content, leaves, groups)
    for name in ("properties", "hats.properties"):
        text = (folder / name).read_text().replace(made.digest, digest)
        (folder / name).write_text(text)
    return open_catalogue(folder)


def put_shard(folder, leaves, groups, index, rows):
    """Replace a shard, and make the manifest's checksums agree."""
    record, records = write_shard(folder, int(leaves["order"][index]),
                                  int(leaves["pixel"][index]), rows)  # fmt: skip
    first = int(leaves["row_groups"][:index].sum())
    own = slice(first, first + int(leaves["row_groups"][index]))
    assert len(records) == own.stop - own.start
    for key in ("bytes", "crc32c", "footer_bytes", "footer_crc32c"):
        leaves[key][index] = record[key]
    for key in ("offset", "bytes", "crc32c", "column_bytes", "column_crc32c"):
        groups[key][own] = records[key]


def columns_of(made, index):
    table = pq.read_table(file_of(made, made.leaf(index).path))
    return {name: table[name].to_numpy().copy() for name in STORED.names}


CHANGES = {
    "outside ra 0 to 360 or dec": ("ra", lambda x: np.full_like(x, 360.0)),
    "is not that of their ra and dec": ("ra", lambda x: x + 2.0**-20),
    "outside the magnitude range": ("phot_g_mean_mag", lambda x: x + np.float32(30)),
    "that move faster": ("pmdec", lambda x: x + np.float32(1e6)),
    "with a parallax above": ("parallax", lambda x: x + np.float32(1e4)),
    "outside the HEALPix pixel": ("_healpix_29", lambda x: x + (1 << 58)),
}


@pytest.mark.parametrize("what", CHANGES)
def test_rows_that_break_what_the_manifest_says(tmp_path, small, what):
    """Rows changed, and all checksums made to agree: the rows themselves are looked at."""
    column, function = CHANGES[what]

    def change(folder, leaves, groups):
        rows = columns_of(small, 2)
        rows[column][5:7] = function(rows[column][5:7])
        put_shard(folder, leaves, groups, 2, rows)

    made = rewritten(small, tmp_path / "changed", change)
    found = [text for text in texts(made) if text.startswith(small.leaf(2).path)]
    assert any(what in text for text in found), texts(made)


def test_caps_that_leave_rows_out_are_named(tmp_path, small):
    def change(folder, leaves, groups):
        groups["radius_rad"][3] *= 0.9

    (text,) = texts(rewritten(small, tmp_path / "changed", change))
    assert "outside the cap" in text


def test_leaves_that_overlap_and_bounds_that_are_not_kept_are_named(tmp_path, small):
    """A leaf that is a child of the one before it; a row group fainter than its leaf."""

    def overlap(folder, leaves, groups):
        leaves["order"][1], leaves["pixel"][1] = leaves["order"][0] + 1, 4 * leaves["pixel"][0] + 1

    def fainter(folder, leaves, groups):
        groups["faintest_g_mag"][3] += 40.0

    for change, what in ((overlap, "leaves overlap"), (fainter, "a row group moves faster")):
        found = texts(rewritten(small, tmp_path / change.__name__, change))
        assert any(text.startswith(f"{MANIFEST_NAME}: {what}") for text in found), found


def test_tables_that_disagree_are_named(tmp_path, small):
    def change(folder, leaves, groups):
        leaves["rows"][1] += 1

    found = texts(rewritten(small, tmp_path / "changed", change))
    assert any(text.startswith(f"{MANIFEST_NAME}: rows of the row groups") for text in found)
    assert any("its row groups are not those" in text for text in found)
    assert any(text.startswith("partition_info.csv: says") for text in found)


def test_repeated_source_ids_are_named_with_their_shards(tmp_path, small, monkeypatch):
    """One id in two shards, one twice in a shard; with many small buckets too."""

    def change(folder, leaves, groups):
        rows = columns_of(small, 4)
        rows["source_id"][0] = columns_of(small, 1)["source_id"][7]
        rows["source_id"][1] = rows["source_id"][2]
        put_shard(folder, leaves, groups, 4, rows)

    made = rewritten(small, tmp_path / "changed", change)
    for bucket in (distinct.BUCKET_ROWS, 30):
        monkeypatch.setattr(distinct, "BUCKET_ROWS", bucket)
        found = texts(made)
        assert len(found) == 2
        both = next(text for text in found if text.startswith(small.leaf(1).path))
        assert f"in {small.leaf(1).path}, {small.leaf(4).path}" in both
        assert any(f"in {small.leaf(4).path}, {small.leaf(4).path}" in text for text in found)


def test_same_repeated_numbers_as_counting(tmp_path, monkeypatch):
    monkeypatch.setattr(distinct, "BUCKET_ROWS", 100)
    rng = np.random.default_rng(0)
    numbers = np.concatenate([rng.integers(-(2**62), 2**62, 5000), rng.integers(0, 900, 300)])
    ids = Distinct(tmp_path, numbers.size)
    for part in np.array_split(numbers, 7):
        ids.add(part)
    values, counts = np.unique(numbers, return_counts=True)
    assert sorted(ids.repeated()) == values[counts > 1].tolist()
    assert len(list(tmp_path.iterdir())) > 32


def test_page_checksums_are_looked_at(small):
    """A page that changed together with its row group's crc32c is caught by Parquet's own."""
    leaf = small.leaf(0)
    data = np.frombuffer(file_of(small, leaf.path).read_bytes(), np.uint8).copy()
    group = leaf.row_groups[0]
    metadata = pq.read_metadata(file_of(small, leaf.path))
    data[group.offset + group.bytes - 3] ^= 1  # inside the last page
    with pytest.raises(verify_shards.Damaged, match="row group 0 cannot be read"):
        verify_shards._decode(data, metadata, leaf, group)
    assert google_crc32c.value(data[group.offset : group.offset + group.bytes]) != group.crc32c


def test_columns_of_another_type_are_not_a_catalogues(small):
    """Magnitudes in double precision, under checksums that agree."""
    leaf = small.leaf(2)
    table = pq.read_table(file_of(small, leaf.path))
    at = table.schema.get_field_index("phot_g_mean_mag")
    wider = table.set_column(at, "phot_g_mean_mag", table.column(at).cast(pa.float64()))
    for rows, refused in ((table, False), (wider, True)):
        out = pa.BufferOutputStream()
        pq.write_table(rows, out, write_page_checksum=True)
        data = out.getvalue()
        group = SimpleNamespace(row_group=0, rows=rows.num_rows)
        args = (data, pq.read_metadata(pa.BufferReader(data)), leaf, group)
        if refused:
            with pytest.raises(Damaged, match="columns are not those of a catalogue"):
                verify_shards._decode(*args)
        else:
            assert verify_shards._decode(*args).equals(rows)


def test_findings_are_plain(copy):
    file_of(copy, "note.txt").write_text("mine")
    (finding,) = verify(copy).findings
    assert str(finding) == "note.txt: is no part of the catalogue"
    assert json.dumps(finding._asdict())


def test_same_rows_after_verifying(copy, small):
    verify(copy)
    assert same_rows(cone(copy, 0, 0, 180)[0], cone(small, 0, 0, 180)[0])


def test_caps_of_leaves_that_leave_rows_out_are_named(tmp_path, small):
    """The cap of a whole shard, by which a query passes it over, and not those of its parts."""

    def change(folder, leaves, groups):
        leaves["radius_rad"][1] *= 0.7

    found = texts(rewritten(small, tmp_path / "changed", change))
    assert found
    for text in found:
        assert text.startswith(small.leaf(1).path)
        assert "outside the cap" in text


@pytest.mark.parametrize(("column", "said"), [
    ("max_proper_motion_mas_yr", "that move faster"), ("max_parallax_mas", "with a parallax above"),
])  # fmt: skip
def test_motions_beyond_those_of_a_row_group_are_named(tmp_path, small, column, said):
    """Its own, though all of them are within those of its leaf."""

    def change(folder, leaves, groups):
        groups[column][0] *= 0.5

    (text,) = texts(rewritten(small, tmp_path / "changed", change))
    assert text.startswith(small.leaf(0).path)
    assert said in text


@pytest.mark.parametrize("more", [0, 1])
def test_as_many_repeated_ids_are_named_as_may_be_and_more_are_told(more):
    found = _repeated(SimpleNamespace(leaves=[]), list(range(MOST_REPEATED + more)))
    named = [f for f in found if f.what.startswith("source_id ")]
    assert (len(named), len(found) - len(named)) == (MOST_REPEATED, more)


@pytest.mark.parametrize("more", [-3, 3])
def test_rows_of_a_row_group_are_told_beside_those_of_the_manifest(small, more):
    leaf = small.leaf(0)
    data = file_of(small, leaf.path).read_bytes()
    rows = pq.read_metadata(pa.BufferReader(data)).row_group(0).num_rows
    group = SimpleNamespace(row_group=0, rows=rows + more)
    with pytest.raises(Damaged, match=f"group 0 has {rows} rows; the manifest: {rows + more}$"):
        verify_shards._decode(data, pq.read_metadata(pa.BufferReader(data)), leaf, group)


def test_rejected_rows_that_are_not_counted_so_are_named(tmp_path, small):
    def change(folder, leaves, groups):
        path = folder / REJECTS_NAME
        pq.write_table(pq.read_table(path).slice(1), path)

    (text,) = texts(rewritten(small, tmp_path / "changed", change))
    assert text == f"{REJECTS_NAME}: its rows are not those that the manifest counts"


def test_a_folder_in_the_place_of_a_shard_is_named(copy):
    path = file_of(copy, copy.leaf(1).path)
    path.unlink()
    path.mkdir()
    (text,) = texts(copy)
    assert text.startswith(f"{copy.leaf(1).path}: cannot be read (")
    assert "Is a directory" in text


def agreeing(made, folder, leaf, at):
    """A catalogue with a byte of a shard changed, and the checksums of the manifest with it."""

    def change(folder, leaves, groups):
        flip(folder / leaf.path, at)
        data = (folder / leaf.path).read_bytes()
        leaves["crc32c"][0] = google_crc32c.value(data)
        leaves["footer_crc32c"][0] = google_crc32c.value(data[-leaf.footer_bytes :])
        first = leaf.row_groups[0]
        part = data[first.offset : first.offset + first.bytes]
        groups["crc32c"][0] = google_crc32c.value(part)

    return rewritten(made, folder, change)


def test_pages_that_agree_with_the_manifest_alone_are_named(tmp_path, small):
    leaf = small.leaf(0)
    last = leaf.row_groups[0].offset + leaf.row_groups[0].bytes - 3
    (text,) = texts(agreeing(small, tmp_path / "changed", leaf, last))
    assert text.startswith(f"{leaf.path}: row group 0 cannot be read (")


def test_a_footer_that_agrees_with_the_manifest_alone_is_named(tmp_path, small):
    leaf = small.leaf(0)
    (text,) = texts(agreeing(small, tmp_path / "changed", leaf, leaf.bytes - leaf.footer_bytes))
    assert text.startswith(f"{leaf.path}: its footer cannot be read (")


def test_repeated_source_ids_are_named_beside_damage(tmp_path, small):
    """The shard that cannot be read is named once, and holds up no other."""

    def change(folder, leaves, groups):
        rows = columns_of(small, 4)
        rows["source_id"][1] = rows["source_id"][2]
        put_shard(folder, leaves, groups, 4, rows)

    made = rewritten(small, tmp_path / "changed", change)
    file_of(made, made.leaf(1).path).unlink()
    missing, repeated = texts(made)
    assert missing == f"{made.leaf(1).path}: the shard is missing"
    assert repeated.startswith(f"{made.leaf(4).path}: source_id ")


def test_a_star_without_a_magnitude_is_named_wherever_it_is_read(tmp_path, small):
    def change(folder, leaves, groups):
        rows = columns_of(small, 2)
        rows["phot_g_mean_mag"][5] = np.inf
        put_shard(folder, leaves, groups, 2, rows)

    made = rewritten(small, tmp_path / "changed", change)
    (text,) = texts(made)
    assert text.endswith("1 rows outside the magnitude range that the manifest says")
    with pytest.raises(Damaged, match="holds a star without a G magnitude") as caught:
        make_starlight(made)
    assert caught.value.path == str(file_of(made, small.leaf(2).path))
