"""Kept kernels: one whose callee in another file has changed is compiled again."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import pytest

from catalog_tools.engine.home import ensure_home
from pipeline.compiled import FOLDER, forget_stale, keep_apart, keep_somewhere

CALLEE = """from numba import njit
@njit(cache=True)
def callee(x):
    return x + {}
"""
CALLER = """from numba import njit
from kernels.inner.callee import callee
@njit(cache=True)
def caller(x):
    return 10.0 * callee(x)
"""
CODE = """import sys
from pathlib import Path
from pipeline.compiled import forget_stale
forget_stale(Path("kernels"))
from kernels.caller import caller
print(caller(1.0), len(caller.stats.cache_hits))
"""


def told(folder: Path) -> str:
    """What the kernel gives in a process of its own, and how many it took from the disk."""
    path = os.pathsep.join([str(folder), str(Path(__file__).parents[1])])
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", CODE], cwd=folder, env=environment | {"PYTHONPATH": path},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.strip()


def test_a_changed_callee_is_compiled_into_its_callers(tmp_path: Path) -> None:
    inner = tmp_path / "kernels" / "inner"
    inner.mkdir(parents=True)
    (inner / "callee.py").write_text(CALLEE.format("1.0"))
    (inner.parent / "caller.py").write_text(CALLER)
    assert told(tmp_path) == "20.0 0"
    assert told(tmp_path) == "20.0 1"  # kept
    time.sleep(0.05)
    (inner / "callee.py").write_text(CALLEE.format("2.0"))
    assert told(tmp_path) == "30.0 0"
    assert told(tmp_path) == "30.0 1"


def test_sources_of_the_future_do_not_count(tmp_path: Path) -> None:
    """Else every process would compile everything."""
    (tmp_path / "__pycache__").mkdir()
    kept, source = tmp_path / "__pycache__" / "a.nbi", tmp_path / "a.py"
    source.touch()
    time.sleep(0.05)
    kept.touch()
    os.utime(source, (time.time() + 3600.0,) * 2)
    forget_stale(tmp_path)
    assert kept.exists()
    os.utime(kept, (1.0, 1.0))
    (tmp_path / "b.py").touch()
    forget_stale(tmp_path)
    assert not kept.exists()


def test_a_folder_of_kept_kernels_is_parted_by_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dates and sizes of two installations may be the same: their kernels lie apart."""
    source = tmp_path / "a.py"
    found = []
    for content in ("x = 1", "x = 2", "x = 1"):
        source.write_text(content)
        os.utime(source, (1.0, 1.0))
        monkeypatch.setenv(FOLDER, str(tmp_path / "kept"))
        keep_apart(tmp_path)
        found.append(os.environ[FOLDER])
        keep_apart(tmp_path)  # in a process that the first one starts
        assert os.environ[FOLDER] == found[-1]
    assert found[0] == found[2] != found[1]
    assert {Path(f).parent for f in found} == {tmp_path / "kept"}
    (tmp_path / "inner").mkdir()
    source.rename(tmp_path / "inner" / "a.py")  # the same content elsewhere, then another there
    for content in ("x = 1", "x = 2"):
        (tmp_path / "inner" / "a.py").write_text(content)
        monkeypatch.setenv(FOLDER, str(tmp_path / "kept"))
        keep_apart(tmp_path)
        assert os.environ[FOLDER] not in found
        found.append(os.environ[FOLDER])
    monkeypatch.delenv(FOLDER)
    keep_apart(tmp_path)
    assert FOLDER not in os.environ


def test_kernels_lie_in_a_folder_of_the_process_where_nothing_else_takes_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else numba imports none; nor is a place of its own passed over where one can be written."""
    monkeypatch.setattr("pipeline.compiled._tell_numba", lambda: None)
    (tmp_path / "file").touch()
    refused = tmp_path / "file" / "below"
    monkeypatch.setenv("XDG_CACHE_HOME", str(refused))
    monkeypatch.setenv(FOLDER, str(refused))
    keep_somewhere(tmp_path)  # beside the sources
    assert os.environ[FOLDER] == str(refused)
    keep_somewhere(refused)
    own = Path(os.environ[FOLDER])
    assert own.is_dir()
    assert own != refused
    keep_somewhere(refused)  # in a process that the first one starts
    assert Path(os.environ[FOLDER]) == own
    own.rmdir()


def test_no_home_that_can_be_told_is_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user whose number has no name, or whose HOME is closed: astropy was not imported."""
    for error in (RuntimeError("Could not determine home directory."), PermissionError(13, "no")):
        monkeypatch.setenv("HOME", "/closed")
        with monkeypatch.context() as patch:
            patch.setattr(Path, "exists", Mock(side_effect=error))
            ensure_home()
        assert os.environ["HOME"] == "/"
    monkeypatch.setenv("HOME", "/nowhere/at/all")
    ensure_home()
    assert os.environ["HOME"] == "/nowhere/at/all"
