"""Names inside a product directory, and small files written whole or not at all."""

from __future__ import annotations

import fcntl
import json
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import TypeVar

from catalog_tools.documents import JsonObject
from catalog_tools.storage.durable import full_disk_told, write_atomically
from catalog_tools.storage.durable import sync as sync_folder
from catalog_tools.storage.urls import is_url
from pipeline.errors import NO_ROOM, BadInput, Damaged, TryLater

__all__ = [
    "full_disk",
    "no_product",
    "only_writer",
    "sync_folder",
    "to_json",
    "waited",
    "write_atomically",
]

CUBE = "cube.zarr"
MARKERS = "markers"
TRUTH = "truth"
PARTS = ".parts"
SCENE = "scene.yaml"
PLAN = "plan.json"
REPORT = "report.json"
PREVIEW = "preview.png"
BEGUN = ".begun.json"
COMPLETE = "_COMPLETE"
LOCK = ".lock"
BUSY = "another render is writing this product now (--wait waits for it)"
CUBES = "cubes"  # of a sweep: the products of its points
SEALS = (COMPLETE, f"{CUBE}/zarr.json")  # which say that all is there
AGAIN_S = 1.0  # between looks at a lock
Taken = TypeVar("Taken")
LONG_NAMES = {  # layers of the cube: what they are, and their unit
    "dn": ("raw sensor signal", "DN"),
    "mean_e": ("mean signal before photon noise", "electron"),
    "stars_e": ("light of the stars after the flat", "electron"),
    "targets_e": ("light of the targets after the flat", "electron"),
    "background_e": ("light of the sky after the flat", "electron"),
    "dark_e": ("dark signal", "electron"),
    "calibrated_e": ("(dn - bias - dark) / flat; NaN: bad pixel", "electron"),
    "lag_e": ("left by frames before, less what stays behind", "electron"),
    "cosmic_rays_e": ("charge of cosmic rays, drawn; not in mean_e", "electron"),
}


def cube_path(out: Path, point: int) -> Path:
    """Where a sweep keeps the product of a point."""
    return out / CUBES / f"{point:07d}"


def no_product(path: Path) -> BadInput:
    """What is told of a path that holds no product."""
    place, allowed = str(path), "a product directory made by `nightglass render`"
    if is_url(path):
        place = place.replace(":/", "://", 1)  # a path has one slash
        allowed += "; one in an object store is read by xarray (docs/cluster.md)"
    elif (path / "nightglass.json").is_file():
        allowed += "; of a catalogue `nightglass catalog info` tells"
    return BadInput("PRODUCT", place, allowed)


def layers_in(product: Path) -> list[str]:
    """The layers that a product's cube holds, finished or being drawn."""
    return [name for name in LONG_NAMES if (product / CUBE / name / "zarr.json").is_file()]


def to_json(value: object) -> bytes:
    """Readable JSON; NaN and infinity are refused rather than written."""
    return (json.dumps(value, indent=2, allow_nan=False) + "\n").encode()


def read_json(path: Path) -> JsonObject:
    """What a small file of a product says. Damaged where it cannot be read."""
    try:
        return dict(json.loads(path.read_bytes()))
    except (OSError, ValueError, TypeError) as error:
        raise Damaged(str(path), f"cannot be read ({error})") from None


def full_disk(product: Path) -> AbstractContextManager[None]:
    """Whatever writes a product writes it inside of this: DiskFull names the product."""
    told = "what is finished is kept: make room, then go on with --resume"
    return full_disk_told(product, told)


def waited(wait_s: float, take: Callable[[], Taken]) -> Taken:
    """What `take` gives; while it raises TryLater it is asked again, for so long."""
    end = time.monotonic() + wait_s
    while True:
        try:
            return take()
        except TryLater:
            if time.monotonic() >= end:
                raise
            time.sleep(min(AGAIN_S, max(0.0, end - time.monotonic())))


@contextmanager
def only_writer(
    product: Path, shared: str | None = None, wait_s: float = 0.0, busy: str = BUSY
) -> Iterator[None]:
    """Hold the product's lock; another running writer is waited for, a dead one is not.

    shared : name of a part; writers of other parts are let in beside it
    busy : what is told of another writer
    Raises TryLater where the other one goes on for longer, BadInput where there can be no lock.
    """
    with waited(wait_s, lambda: _locked(product, shared, busy)):
        yield


def _locked(product: Path, shared: str | None, busy: str) -> ExitStack:
    kind = fcntl.LOCK_EX if shared is None else fcntl.LOCK_SH
    with ExitStack() as open_files:
        try:
            if shared is not None:
                own = open_files.enter_context((product / f"{LOCK}-{shared}").open("w"))
                fcntl.flock(own, fcntl.LOCK_EX | fcntl.LOCK_NB)
            handle = open_files.enter_context((product / LOCK).open("w"))
            fcntl.flock(handle, kind | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in NO_ROOM:
                raise
            if not isinstance(error, BlockingIOError):  # waiting would not help
                allowed = f"a folder that can be written, with locks (flock); {error.strerror}"
                raise BadInput("PRODUCT", str(product), allowed) from None
            raise TryLater(f"{product}: {busy}") from None
        return open_files.pop_all()
