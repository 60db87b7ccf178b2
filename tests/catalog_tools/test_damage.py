"""Damage is named, never read; and what is no catalogue is told apart."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import google_crc32c
import numpy as np
import pytest

from catalog_tools.catalogue import (
    LEAVES_NAME,
    MANIFEST_NAME,
    ROW_GROUPS_NAME,
    _digest,
    open_catalogue,
)
from catalog_tools.columns import STORED
from catalog_tools.errors import BadInput, Damaged
from catalog_tools.query.query import cone, read_leaf


@pytest.fixture
def copy(tmp_path, catalogue):
    shutil.copytree(catalogue.path, tmp_path / "copy")
    return open_catalogue(tmp_path / "copy")


def path_of(catalogue, leaf):
    return Path(catalogue.path) / leaf.path


def test_flipped_bits_anywhere_are_named(copy):
    """A bit of a column that is read, or of the file's end; the others are `verify`'s."""
    leaf = copy.leaves[3]
    path = path_of(copy, leaf)
    good = path.read_bytes()
    whole = read_leaf(copy, leaf)
    rng = np.random.default_rng(4)
    ends = [0, 3, 4, len(good) - 1, len(good) - 5, len(good) - 9, len(good) - leaf.footer_bytes]
    gaps = _gaps(leaf)
    for at in [*ends, *rng.integers(0, len(good), 150).tolist()]:
        data = bytearray(good)
        data[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        if at in gaps:
            assert read_leaf(copy, leaf).equals(whole)
            continue
        with pytest.raises(Damaged) as caught:
            read_leaf(copy, leaf)
        assert leaf.path in str(caught.value)


def _gaps(leaf):
    """Bytes in no column but the HEALPix index, and not in the end, which aren't read here."""
    used = {leaf.bytes - i - 1 for i in range(8)}
    for group in leaf.row_groups:
        used.update(range(group.offset + group.column_bytes[0], group.offset + group.bytes))
    return set(range(leaf.bytes)) - used


def test_truncated_grown_missing_or_swapped_shards_are_named(copy):
    leaf, other = copy.leaves[0], copy.leaves[1]
    path = path_of(copy, leaf)
    good = path.read_bytes()
    other_data = path_of(copy, other).read_bytes()
    cases = {
        "bytes long": (good[:-1], good[:100], b"", good + b"x", other_data),
        "checksum": (bytes(len(good)),),
    }
    for reason, contents in cases.items():
        for data in contents:
            path.write_bytes(data)
            with pytest.raises(Damaged, match=reason) as caught:
                read_leaf(copy, leaf, None, ["ra"])
            assert leaf.path in str(caught.value)
    path.unlink()
    with pytest.raises(Damaged, match="missing"):
        cone(copy, 0, 0, 180)
    path.mkdir()
    with pytest.raises(Damaged):
        read_leaf(copy, leaf)


def test_only_the_row_groups_read_are_proved(copy):
    """Damage in a faint row group doesn't stop a bright query; it stops the faint one."""
    leaf = max(copy.leaves, key=lambda leaf: leaf.row_group_count)
    groups = leaf.row_groups
    path = path_of(copy, leaf)
    data = bytearray(path.read_bytes())
    data[groups[-1].offset + groups[-1].bytes - 50] ^= 1
    path.write_bytes(data)
    assert read_leaf(copy, leaf, groups[0].brightest_g_mag + 1e-3).num_rows > 0
    assert read_leaf(copy, leaf._replace(row_groups=groups[:-1])).num_rows > 0
    with pytest.raises(Damaged, match=f"row group {groups[-1].row_group} "):
        read_leaf(copy, leaf)


def test_rows_that_agree_with_their_checksums_but_not_with_parquet(copy):
    """As a disk or a program could have made them, before the checksums were taken."""
    leaf = max(copy.leaves, key=lambda leaf: leaf.rows)
    group, at = leaf.row_groups[0], STORED.names.index("ra")
    start = group.offset + sum(group.column_bytes[:at])
    data = bytearray(path_of(copy, leaf).read_bytes())
    data[start : start + 20] = bytes(20)
    path_of(copy, leaf).write_bytes(data)
    checksums = list(group.column_crc32c)
    checksums[at] = google_crc32c.value(bytes(data[start : start + group.column_bytes[at]]))
    agreeing = leaf._replace(row_groups=(group._replace(column_crc32c=tuple(checksums)),))
    with pytest.raises(Damaged, match="cannot be read") as caught:
        read_leaf(copy, agreeing, None, ["ra"])
    assert caught.value.path == f"{copy.path}/{leaf.path}"


def test_fewer_rows_in_a_shard_than_the_manifest_says(copy):
    leaf = copy.leaves[0]
    more = leaf.row_groups[0]._replace(rows=leaf.row_groups[0].rows + 3)
    with pytest.raises(Damaged, match="another number of rows than the manifest") as caught:
        read_leaf(copy, leaf._replace(row_groups=(more,)), None, ["ra"])
    assert caught.value.path == f"{copy.path}/{leaf.path}"


def test_manifest_round_trip(catalogue):
    again = open_catalogue(catalogue.path)
    assert (again.digest, again.rows, again.leaves) == (
        catalogue.digest, catalogue.rows, catalogue.leaves
    )  # fmt: skip
    assert np.array_equal(again.row_group_table, catalogue.row_group_table)


def test_changed_manifest_is_damage(copy):
    path = Path(copy.path) / MANIFEST_NAME
    document = json.loads(path.read_text())
    document["catalogue"]["rows"] += 1
    path.write_text(json.dumps(document))
    with pytest.raises(Damaged, match=MANIFEST_NAME):
        open_catalogue(copy.path)
    path.write_text(path.read_text()[:-20])
    with pytest.raises(Damaged, match="JSON"):
        open_catalogue(copy.path)


def test_a_folder_in_the_place_of_a_manifest_is_damage(copy):
    path = Path(copy.path) / MANIFEST_NAME
    path.unlink()
    path.mkdir()
    with pytest.raises(Damaged, match=r"cannot be read \(.*Is a directory") as caught:
        open_catalogue(copy.path)
    assert caught.value.path == str(path)


def test_a_table_of_other_columns_is_damage(copy):
    """Its digest agrees: a program of another version could have written it so."""
    np.save(Path(copy.path) / LEAVES_NAME, copy.leaf_table[["order", "pixel"]])
    digest = hashlib.sha256((Path(copy.path) / LEAVES_NAME).read_bytes()).hexdigest()
    path = Path(copy.path) / MANIFEST_NAME
    document = json.loads(path.read_text())
    document["catalogue"]["files"][LEAVES_NAME] = digest
    path.write_text(json.dumps({**document, "sha256": _digest(document["catalogue"])}))
    with pytest.raises(Damaged, match="holds other columns than this program's") as caught:
        open_catalogue(copy.path)
    assert caught.value.path == str(Path(copy.path) / LEAVES_NAME)


@pytest.mark.parametrize("name", [LEAVES_NAME, ROW_GROUPS_NAME])
def test_changed_tables_are_damage(copy, name):
    path = Path(copy.path) / name
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)
    with pytest.raises(Damaged, match=name):
        open_catalogue(copy.path)
    path.unlink()
    with pytest.raises(Damaged, match=name):
        open_catalogue(copy.path)


def test_what_is_no_catalogue_is_told_apart(tmp_path, copy):
    manifest = Path(copy.path) / MANIFEST_NAME
    document = json.loads(manifest.read_text())
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("x")
    cases = {"absent": "nightglass catalog demo", "empty": "holds no", "file": "is a file"}
    for name, message in cases.items():
        with pytest.raises(BadInput, match=message) as caught:
            open_catalogue(tmp_path / name, field="stars.catalogue")
        assert caught.value.field == "stars.catalogue"
    for changed, message in (({"version": 99}, "version 3"), ({"format": "x"}, "format")):
        manifest.write_text(json.dumps({**document, **changed}))
        with pytest.raises(BadInput, match=message):
            open_catalogue(copy.path)
    manifest.unlink()
    with pytest.raises(BadInput, match="HATS catalogue of another program"):
        open_catalogue(copy.path)


def test_opening_imports_nothing_heavy():
    code = (
        "import sys, catalog_tools.catalogue, catalog_tools.query.selection, catalog_tools.info\n"
        "heavy = {'healpy', 'astropy', 'pyarrow', 'dask', 'scipy', 'fsspec'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
