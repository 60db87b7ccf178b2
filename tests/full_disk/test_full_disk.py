"""Disk full at every tenth write of every store that the command line makes.

Each time: one message that names the store and says that its disk is full, exit code 3, nothing
that looks whole; and with room again the same command goes on to the same bits. The writes are
refused below Python, in a library loaded before all others (full_disk.c); a real file system of
too few bytes, where the test may mount one, judges what that library cannot see.
"""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import DiskFull
from pipeline.export.movie import write_mp4
from tests.full_disk.child import bits, stores
from tests.full_disk.disk import make_disk


def attempts(folder: Path, store: str, most: int) -> list[dict[str, Any]]:
    """What came of a store written on a disk that was full at write 10, 20, 30, ..."""
    _, environ = make_disk(folder)
    command = [sys.executable, "-m", "tests.full_disk.child", store, str(folder), "10", str(most)]
    ended = subprocess.run(command, env=environ, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    first, *found = (json.loads(line) for line in ended.stdout.splitlines())
    assert [f["at"] for f in found] == first["chosen"]
    assert first["chosen"]
    return found


def judge(told: dict[str, Any]) -> None:
    assert told["refused"] > 0, told
    assert told["code"] == 3, told
    assert told["said"].count("\n") == 1, told
    assert "the disk is full (No space left on device); " in told["said"], told
    assert "make room" in told["said"], told
    assert "/out" in told["said"], told
    assert not told["looks_whole"], told
    assert told["again"] == 0, told
    assert told["same"], told
    assert told["left"] == [], told


@pytest.mark.parametrize("store", ["product"])
def test_a_disk_that_fills_up(tmp_path: Path, store: str) -> None:
    for told in attempts(tmp_path, store, 2):
        judge(told)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("store", "most"), [("product", 100), ("part", 20), ("sweep", 60), ("catalogue", 100)]
)
def test_a_disk_that_fills_up_at_every_tenth_write(tmp_path: Path, store: str, most: int) -> None:
    for told in attempts(tmp_path, store, most):
        judge(told)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own that a test may make smaller and larger; skips without the right."""
    place = tmp_path / "disk"
    place.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(place)], capture_output=True
    )
    if made.returncode:
        pytest.skip("no right to mount a file system")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", ["product", "sweep", "catalogue"])
def test_a_real_file_system_without_room(tmp_path: Path, small_disk: Path, name: str) -> None:
    """Sizes from a page up to what the store needs: each but the last is too small."""
    store = stores(tmp_path)[name]
    out = small_disk / "out"
    run(*store.command(out, False))
    wanted = bits(out, store.files)
    used = os.statvfs(small_disk)
    need = (used.f_blocks - used.f_bfree) * used.f_frsize
    subprocess.run(["find", str(small_disk), "-mindepth", "1", "-delete"], check=True)
    for share in (0.02, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9):
        resize(small_disk, int(need * share))
        told = run(*store.command(out, False), wanted=3)
        assert "the disk is full (No space left on device); " in told, told
        assert not (out / store.seal).exists()
        resize(small_disk, 64 << 20)
        run(*store.command(out, out.exists()))
        assert bits(out, store.files) == wanted
        subprocess.run(["find", str(small_disk), "-mindepth", "1", "-delete"], check=True)


@pytest.mark.parametrize(
    ("command", "remedy"),
    [
        (("export", "--to", "fits"), "remove what was written there"),
        (("export", "--to", "coco"), "remove what was written there"),
        (("calibrate",), "run the same command again"),
    ],
    ids=["fits", "coco", "calibrate"],
)
def test_what_is_written_of_a_product_is_named(
    tmp_path: Path, small_disk: Path, command: tuple[str, ...], remedy: str
) -> None:
    """On a disk of its own, which is full; not the product that is read."""
    product, out = tmp_path / "product", small_disk / "out"
    run(*stores(tmp_path)["product"].command(product, False))
    resize(small_disk, 8192)
    told = run(command[0], str(product), *command[1:], "-o", str(out), wanted=3)
    assert told.count("\n") == 1
    assert told.startswith(f"nightglass: {out}")
    assert ": the disk is full (" in told
    assert remedy in told


def test_a_film_without_room_is_told(small_disk: Path) -> None:
    """ffmpeg ends as if all were well: cut in its middle, or without its index at the end."""
    pytest.importorskip("imageio_ffmpeg")
    pictures = np.random.default_rng(1).integers(0, 255, (12, 128, 128)).astype(np.uint8)
    film = small_disk / "film.mp4"
    write_mp4(iter(pictures), film, 5.0)
    whole = film.stat().st_size
    for size in (0, whole // 2, whole - 4096):
        film.unlink()
        resize(small_disk, size)
        with pytest.raises(OSError, match="No space left") as caught:
            write_mp4(iter(pictures), film, 5.0)
        assert caught.value.errno == errno.ENOSPC


def resize(place: Path, size: int) -> None:
    pages = max(1, size // 4096)
    command = ["mount", "-o", f"remount,size={pages * 4}k", str(place)]
    subprocess.run(command, check=True)


def run(*command: str, wanted: int = 0) -> str:
    from tests.command import nightglass

    ended = nightglass(*command)
    assert ended.returncode == wanted, ended.stderr
    return ended.stderr


def test_the_error_says_it_all_and_travels() -> None:
    import pickle

    error = DiskFull("run1", 28, "make room, then go on with --resume")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert str(error).startswith("run1: the disk is full (No space left on device); make room")
