"""A product below an s3 URL; its small files are made in a folder of this machine."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from catalog_tools.documents import JsonObject
from catalog_tools.storage.objects import Objects, open_objects
from catalog_tools.storage.stores import Unreachable
from pipeline.errors import BadInput, Incomplete
from pipeline.spec.load import parse_scene, parse_text
from pipeline.spec.scene import Scene
from pipeline.store import layout, remote
from pipeline.store.lease import Lease, only_writer_of
from pipeline.store.place import Claim, Place, Writing
from pipeline.store.product import Begun, Verdict
from pipeline.store.seal import finished_faults


class Bucket(Place):
    """The objects below an s3 URL."""

    join_tries = 10  # of two leases that end together each may have seen the other

    def __init__(self, url: str, field_name: str) -> None:
        """Raises BadInput naming the field where the store can't be asked."""
        self.name = url
        self._objects = open_objects(url, field_name)
        remote.reached(self._objects, field_name)

    @contextmanager
    def explained(self) -> Iterator[None]:
        try:
            yield
        except Unreachable as error:
            raise Incomplete(f"{error}; what is finished is kept (--resume)") from None
        except FileNotFoundError as error:  # an object or the bucket went while we worked
            told = f"{self.name}: not found: {error}; what is finished is kept"
            raise Incomplete(told) from None

    def check_free(self, resume: bool, replace: bool) -> None:
        if not (resume or replace):  # what is taken up is listed once, when it is held
            remote.check_free_remote(self._objects, resume)

    @contextmanager
    def written(self, claim: Claim) -> Iterator[BucketWriting]:
        objects = self._objects
        with (
            TemporaryDirectory(prefix="nightglass-") as folder,
            only_writer_of(objects, claim.part, claim.wait_s) as lease,
        ):
            if claim.replace:
                remote.remove_remote(objects)
            resume = claim.resume and not claim.replace if claim.part is None else None
            begun = remote.begin_remote(
                objects,
                Path(folder) / "product",
                claim.plan,
                claim.catalogue_digest,
                resume,
                claim.mine,
            )
            yield BucketWriting(objects, begun, lease, claim.part is not None)

    def tiles(self) -> int:
        return len(self._objects.names(f"{layout.MARKERS}/"))

    def check_begun(self) -> None:
        if layout.SCENE not in self._objects.names(layout.SCENE):
            raise BadInput("PRODUCT", self.name, "a product begun by `nightglass render`")

    def scene(self) -> Scene:
        content = self._objects.get(layout.SCENE) or b""
        return parse_scene(parse_text(content, f"{self.name}/{layout.SCENE}"))

    def verdict(self) -> Verdict:
        with TemporaryDirectory(prefix="nightglass-") as folder:
            return remote.check_remote(self._objects, Path(folder) / "product")


class BucketWriting(Writing):
    """Objects whose lease is held; together : beside the writers of other parts."""

    def __init__(self, objects: Objects, begun: Begun, lease: Lease, together: bool) -> None:
        self.begun, self._objects, self._lease = begun, objects, lease
        self._together = together

    def is_sealed(self, tiles: int) -> bool:
        if self._objects.get(layout.COMPLETE) is None or len(self.begun.done) != tiles:
            return False
        sealed = self.begun.path.with_name("sealed")
        remote.bring(self._objects, sealed)
        return not finished_faults(sealed)

    def report(self) -> JsonObject:
        found: JsonObject = json.loads(self._objects.get(layout.REPORT) or b"{}")
        return found | {"drawn_before": True}

    def unseal(self) -> None:
        remote.unseal_remote(self._objects)

    def put_plan(self, content: bytes) -> None:
        if not (self._together and self._objects.names(layout.PLAN)):
            self._objects.put(layout.PLAN, content)

    def check(self) -> None:
        self._lease.check()

    def discard(self) -> None:
        if not self._lease.lost:
            remote.remove_remote(self._objects)

    def locks(self) -> Iterable[str]:
        return self._objects.names(f"{layout.LOCK}-")

    @contextmanager
    def finishing(self) -> Iterator[None]:
        self._lease.check()
        remote.bring(self._objects, self.begun.path)
        yield
        self._lease.check()
        remote.publish(self._objects, self.begun.path)
