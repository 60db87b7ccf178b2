"""What is kept on disk for other processes: the same bits, by all content, never in the way."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline import kept as store
from pipeline.kept import kept, kept_array, kept_number


@dataclass(frozen=True)
class One:
    a: float
    b: tuple


@dataclass(frozen=True)
class Other:
    a: float
    b: tuple


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("NIGHTGLASS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(store, "WORTH_S", 0.0)
    return tmp_path / "cache" / "responses"


def test_values_come_back_as_they_were_made(folder):
    values = {
        "wide": np.asfortranarray(np.random.default_rng(1).normal(size=(3, 5))),
        "few": np.arange(4, dtype=np.float32), "count": 7, "share": 0.1, "waves": (1.0, 2.0),
        "spectrum": np.array([1 + 2j, -0.0]),
    }  # fmt: skip
    first = kept(("x", 1.5), lambda: values)
    again = kept(("x", 1.5), lambda: pytest.fail("made again"))
    assert list(first) == list(again) == list(values)
    for name, value in values.items():
        assert np.array_equal(first[name], value)
        assert first[name].tobytes() == again[name].tobytes()
        assert first[name].dtype == again[name].dtype
        assert first[name].shape == again[name].shape
        assert first[name].flags.c_contiguous
        assert again[name].flags.c_contiguous
    assert again["count"].item() == 7
    assert kept_number(("n",), lambda: 0.1) == kept_number(("n",), lambda: 0.2) == 0.1


CONTENT = [
    ("a",), ("b",), ("a", "b"), (1, 23), (12, 3), (("a",), "b"), (("a", "b"),), ("ab",), (1,),
    (1.0,), (True,),
    (None,), (1.0 + 1e-15,), (-0.0,), (0.0,), ("1",), (np.zeros(2),), (np.zeros((1, 2)),),
    (np.zeros(2, np.float32),), (np.zeros(2, np.int64),), (np.arange(4.0).reshape(2, 2),),
    (np.arange(4.0).reshape(2, 2).T,), (np.array([0.0, 5e-324]),), (One(1.0, (2.0,)),),
    (Other(1.0, (2.0,)),), (One(2.0, (1.0,)),), (One(1.0, (np.ones(1),)),),
]  # fmt: skip


def test_the_folder_is_named_or_that_of_the_platform(tmp_path, monkeypatch):
    monkeypatch.setenv("NIGHTGLASS_CACHE", str(tmp_path / "named"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "platform"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert store.cache_folder() == tmp_path / "named"
    monkeypatch.setenv("NIGHTGLASS_CACHE", "")
    assert store.cache_folder() == tmp_path / "platform" / "nightglass"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert store.cache_folder() == tmp_path / "home" / ".cache" / "nightglass"


def test_everything_in_the_content_counts(folder):
    found = [kept_array(one, lambda k=k: np.array(k)) for k, one in enumerate(CONTENT)]
    assert [int(a) for a in found] == list(range(len(CONTENT)))
    assert len(list(folder.iterdir())) == len(CONTENT)


def test_another_version_of_the_physics_has_its_own(folder, monkeypatch):
    assert kept_number(("n",), lambda: 1.0) == 1.0
    monkeypatch.setattr(store, "_code", lambda: b"another")
    assert kept_number(("n",), lambda: 2.0) == 2.0


def test_the_code_its_libraries_and_the_processor_count(tmp_path, monkeypatch):
    """Rounding differs between versions and processors; a file far below is physics, too."""
    inner = tmp_path / "physics" / "sky" / "one.py"
    inner.parent.mkdir(parents=True)
    inner.write_text("x = 1")
    monkeypatch.setattr(store, "__file__", str(tmp_path / "kept.py"))
    versions = dict.fromkeys(("numpy", "scipy", "numba"), "1.0")
    monkeypatch.setattr(store, "version", versions.__getitem__)
    told = [store._code.__wrapped__()]

    def now():
        told.append(store._code.__wrapped__())
        assert told[-1] not in told[:-1]

    inner.write_text("x = 2")
    now()
    inner.rename(inner.with_name("two.py"))
    now()
    for name in versions:
        versions[name] = "2.0"
        now()
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_name", lambda: "another")
    now()
    monkeypatch.setattr(store.platform, "machine", lambda: "another")
    now()


def test_content_without_content_is_refused(folder):
    with pytest.raises(TypeError, match="no content of its own: object"):
        kept_number((object(),), lambda: 1.0)


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 no archive", None])
def test_a_damaged_file_is_made_again(folder, damage):
    kept_array(("d",), lambda: np.arange(1000.0))
    [path] = folder.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if damage is None else damage)
    assert kept_array(("d",), lambda: np.arange(1000.0))[-1] == 999.0
    assert path.read_bytes() == whole


def test_a_changed_byte_is_seen(folder):
    kept_array(("d",), lambda: np.arange(1000.0))
    [path] = folder.iterdir()
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)
    assert np.array_equal(kept_array(("d",), lambda: np.arange(1000.0)), np.arange(1000.0))


def test_a_folder_that_cannot_be_written_keeps_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "WORTH_S", 0.0)
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("NIGHTGLASS_CACHE", str(tmp_path / "file"))
    assert kept_number(("n",), lambda: 1.0) == 1.0
    assert kept_number(("n",), lambda: 2.0) == 2.0


def test_what_is_quickly_made_is_not_kept(folder, monkeypatch):
    monkeypatch.setattr(store, "WORTH_S", 60.0)
    assert kept_number(("n",), lambda: 1.0) == 1.0
    assert not folder.exists()


def test_what_takes_longer_than_it_is_worth_is_kept(folder, monkeypatch):
    """A second and a half, where a second is worth it."""
    monkeypatch.setattr(store, "WORTH_S", 1.0)
    clock = iter([0.0, 1.5])
    monkeypatch.setattr(store, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    assert kept(("slow",), lambda: {"n": 1})["n"] == 1
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize(("bound", "most"), [("MOST_FILES", 8), ("MOST_BYTES", 8 * 1100.0)])
def test_the_least_recently_used_go(folder, monkeypatch, bound, most):
    monkeypatch.setattr(store, bound, most)
    monkeypatch.setattr(store, "LOOKED_AFTER", 1)
    for k in range(8):
        kept_array((k,), lambda k=k: np.full(100, k))
        [new] = [p for p in folder.iterdir() if p.stat().st_mtime > 1e6]
        os.utime(new, (k + 1, k + 1))  # made long ago, one after the other
    kept_array((0,), lambda: pytest.fail("made again"))  # used now
    kept_array((8,), lambda: np.full(100, 8))
    assert len(list(folder.iterdir())) == 6
    for k in (0, 4, 5, 6, 7, 8):
        assert kept_array((k,), lambda: pytest.fail("made again"))[0] == k
    assert kept_number((1,), lambda: -1.0) == -1.0


WRITER = """
import sys, numpy as np
from pipeline import kept as store
store.WORTH_S, store.LOOKED_AFTER, store.MOST_FILES = 0.0, 1, 4
for turn in range(40):
    k = (turn + int(sys.argv[1])) % 9
    found = store.kept_array((k,), lambda: np.full(20_000, k))
    assert found.shape == (20_000,) and (found == k).all()
"""


def test_many_processes_write_read_and_remove_at_once(folder):
    def one(k):
        command = [sys.executable, "-c", WRITER, str(k)]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    with ThreadPoolExecutor(4) as pool:
        for ended in pool.map(one, range(4)):
            assert ended.returncode == 0, ended.stderr
    assert not [p for p in folder.iterdir() if p.suffix != ".npz"]
