"""A disk that is full from a given write on, for processes that are started with it."""

from __future__ import annotations

import mmap
import os
import shutil
import struct
import subprocess
from pathlib import Path

import pytest

SOURCE = Path(__file__).with_name("full_disk.c")
FORM = "qqq4072s"  # struct control of full_disk.c: writes, the first refused, how many were, folder


class Disk:
    """What all processes with `environ` share: `fill` says where and when, `make_room` ends it."""

    def __init__(self, control: Path) -> None:
        self.control = control
        if not control.exists():
            control.write_bytes(bytes(struct.calcsize(FORM)))
        with control.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), struct.calcsize(FORM))

    def fill(self, folder: Path, at: int) -> None:
        """Let write number `at` below a folder be the last, cut in half; 0: only count them."""
        self._map[:] = struct.pack(FORM, 0, at, 0, str(folder.resolve()).encode())

    def make_room(self) -> None:
        self._map[8:16] = struct.pack("q", 0)

    @property
    def writes(self) -> int:
        return int(struct.unpack_from("q", self._map, 0)[0])

    @property
    def refused(self) -> int:
        return int(struct.unpack_from("q", self._map, 16)[0])


def make_disk(folder: Path) -> tuple[Disk, dict[str, str]]:
    """A disk, and the environment of processes that are to have it; skips without a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler: the full disk is a library that is loaded before others")
    library = folder / "full_disk.so"
    if not library.exists():
        command = [compiler, "-O1", "-shared", "-fPIC", "-o", str(library), str(SOURCE), "-ldl"]
        subprocess.run(command, check=True)
    disk = Disk(folder / "full_disk.control")
    return disk, {"LD_PRELOAD": str(library), "FULL_DISK": str(disk.control)} | {
        name: value for name, value in os.environ.items() if name not in ("LD_PRELOAD", "FULL_DISK")
    }
