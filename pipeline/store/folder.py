"""A product in a folder of this machine."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

from catalog_tools.documents import JsonObject
from pipeline.errors import BadInput
from pipeline.spec.load import load_scene
from pipeline.spec.scene import Scene
from pipeline.store import layout
from pipeline.store.markers import markers_present
from pipeline.store.place import Claim, Place, Writing
from pipeline.store.product import (
    Begun,
    Verdict,
    begin,
    check,
    check_free,
    is_begun,
    is_sealed,
    make_together,
)


class Folder(Place):
    """The folder `path`."""

    join_tries = 1  # a lock of this machine is free at once when its holder is done

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, str(path)

    def explained(self) -> AbstractContextManager[None]:
        return layout.full_disk(self.path)

    def check_free(self, resume: bool, replace: bool) -> None:
        if not replace:
            check_free(self.path, resume)
        elif self.path.exists() and not is_begun(self.path):
            raise BadInput("--replace", self.name, "a product made by `nightglass render`")
        elif self.path.is_symlink():
            raise BadInput("--replace", self.name, "a product, not a link to one")

    @contextmanager
    def written(self, claim: Claim) -> Iterator[FolderWriting]:
        plan, digest = claim.plan, claim.catalogue_digest
        if claim.replace and self.path.exists():
            self._remove(claim.wait_s)
        if claim.part is not None:
            make_together(self.path, plan, digest)
        elif not (claim.resume and is_begun(self.path)):
            begin(self.path, plan, digest, claim.resume)
        with layout.only_writer(self.path, claim.part, claim.wait_s):
            # Taken up inside: another writer may just have ended.
            begun = begin(self.path, plan, digest, True, claim.mine)
            yield FolderWriting(begun, claim.part is not None)

    def tiles(self) -> int:
        return sum(1 for _ in markers_present(self.path))

    def check_begun(self) -> None:
        if not is_begun(self.path):
            raise BadInput("PRODUCT", self.name, "a product that parts were rendered into")

    def scene(self) -> Scene:
        return load_scene(self.path / layout.SCENE)

    def verdict(self) -> Verdict:
        return check(self.path)

    def _remove(self, wait_s: float) -> None:
        """Remove an old product (only a product, never any other folder)."""
        self.check_free(resume=False, replace=True)
        with layout.only_writer(self.path, wait_s=wait_s):
            shutil.rmtree(self.path)


class FolderWriting(Writing):
    """A folder whose lock is held; together : beside the writers of other parts."""

    def __init__(self, begun: Begun, together: bool) -> None:
        self.begun, self._together = begun, together

    def is_sealed(self, tiles: int) -> bool:
        return is_sealed(self.begun, tiles)

    def report(self) -> JsonObject:
        found: JsonObject = json.loads((self.begun.path / layout.REPORT).read_text())
        return found | {"drawn_before": True}

    def unseal(self) -> None:
        for name in layout.SEALS:
            (self.begun.path / name).unlink(missing_ok=True)

    def put_plan(self, content: bytes) -> None:
        path = self.begun.path / layout.PLAN
        if not (self._together and path.is_file()):
            layout.write_atomically(path, content)

    def check(self) -> None:
        """A lock of the machine is not lost."""

    def discard(self) -> None:
        shutil.rmtree(self.begun.path)

    def locks(self) -> Iterable[str]:
        return (path.name for path in self.begun.path.glob(f"{layout.LOCK}-*"))

    def finishing(self) -> AbstractContextManager[None]:
        return nullcontext()
