"""Damage is named, never read; and what is no catalogue is told apart."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from catalog_tools.catalogue import MANIFEST_NAME, open_catalogue
from catalog_tools.errors import BadInput, Damaged
from catalog_tools.query import cone, read_leaf


@pytest.fixture
def copy(tmp_path, catalogue):
    shutil.copytree(catalogue.path, tmp_path / "copy")
    return open_catalogue(tmp_path / "copy")


def test_flipped_bits_anywhere_are_named(copy):
    leaf = copy.leaves[3]
    path = copy.shard_path(leaf)
    good = path.read_bytes()
    whole = read_leaf(copy, leaf)
    rng = np.random.default_rng(4)
    ends = [0, 3, 4, len(good) - 1, len(good) - 5, len(good) - 9, len(good) - leaf.footer_bytes]
    gaps = _gaps(leaf)
    for at in [*ends, *rng.integers(0, len(good), 150).tolist()]:
        data = bytearray(good)
        data[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        if at in gaps or at < 4:
            assert read_leaf(copy, leaf).equals(whole)
            continue
        with pytest.raises(Damaged) as caught:
            read_leaf(copy, leaf)
        assert leaf.path in str(caught.value)


def _gaps(leaf):
    """Bytes in no row group and not in the footer: the page indexes, which we never read."""
    used = {leaf.bytes - i - 1 for i in range(leaf.footer_bytes)}
    for band in leaf.bands:
        used.update(range(band.offset, band.offset + band.bytes))
    return set(range(leaf.bytes)) - used


def test_truncated_grown_missing_or_swapped_shards_are_named(copy):
    leaf, other = copy.leaves[0], copy.leaves[1]
    path = copy.shard_path(leaf)
    good = path.read_bytes()
    other_data = copy.shard_path(other).read_bytes()
    for data in (good[:-1], good[:100], b"", good + b"x", other_data, bytes(len(good))):
        path.write_bytes(data)
        with pytest.raises(Damaged) as caught:
            read_leaf(copy, leaf, None, ["ra"])
        assert leaf.path in str(caught.value)
    path.unlink()
    with pytest.raises(Damaged, match="missing"):
        cone(copy, 0, 0, 180)
    path.mkdir()
    with pytest.raises(Damaged):
        read_leaf(copy, leaf)


def test_only_the_bands_read_are_proved(copy):
    """Damage in a faint band doesn't stop a bright query; it stops the faint one."""
    leaf = max(copy.leaves, key=lambda leaf: len(leaf.bands))
    assert len(leaf.bands) >= 3
    path = copy.shard_path(leaf)
    data = bytearray(path.read_bytes())
    data[leaf.bands[-1].offset + 50] ^= 1
    path.write_bytes(data)
    assert read_leaf(copy, leaf, leaf.bands[0].faintest_g_mag - 1e-3).num_rows > 0
    with pytest.raises(Damaged, match="row group"):
        read_leaf(copy, leaf)


def test_manifest_round_trip(catalogue):
    again = open_catalogue(catalogue.path)
    assert again == catalogue
    assert asdict(again) == asdict(catalogue)


def test_changed_manifest_is_damage(copy):
    path = Path(copy.path) / MANIFEST_NAME
    document = json.loads(path.read_text())
    document["catalogue"]["leaves"][0]["rows"] += 1
    path.write_text(json.dumps(document))
    with pytest.raises(Damaged, match=MANIFEST_NAME):
        open_catalogue(copy.path)
    path.write_text(path.read_text()[:-20])
    with pytest.raises(Damaged, match="JSON"):
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
    for changed, message in (({"version": 99}, "version 1"), ({"format": "x"}, "format")):
        manifest.write_text(json.dumps({**document, **changed}))
        with pytest.raises(BadInput, match=message):
            open_catalogue(copy.path)
    manifest.unlink()
    with pytest.raises(BadInput, match="HATS catalogue of another program"):
        open_catalogue(copy.path)


def test_opening_imports_nothing_heavy():
    code = (
        "import sys, catalog_tools.catalogue, catalog_tools.query, catalog_tools.info\n"
        "heavy = {'healpy', 'astropy', 'pyarrow', 'dask'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
