"""Objects asked for together: none is omitted, however many there are."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from catalog_tools.storage import objects
from catalog_tools.storage.objects import TOGETHER, Objects
from catalog_tools.storage.stores import Unreachable
from tests.object_store import needs_s3, s3_bucket


@pytest.mark.parametrize("count", [0, 1, TOGETHER, TOGETHER + 1, 3 * TOGETHER + 7])
def test_every_object_of_many(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read and deleted a question of at most TOGETHER at a time."""
    asked: list[int] = []
    gone: list[str] = []

    def cat(paths: list[str]) -> dict[str, bytes]:
        asked.append(len(paths))
        return {path: path.encode() for path in paths}

    store = SimpleNamespace(cat=cat, rm=lambda paths: gone.extend(paths))
    monkeypatch.setattr(objects, "_files", lambda: store)
    monkeypatch.setattr(objects, "_all_of", lambda paths, files: files.cat(paths))
    monkeypatch.setattr(objects, "_without", lambda paths, files: files.rm(paths))
    names = [f"markers/{k}" for k in range(count)]
    found = dict(Objects("s3://b/run").get_many(names))
    assert found == {name: f"b/run/{name}".encode() for name in names}
    assert max(asked, default=0) <= TOGETHER
    Objects("s3://b/run").delete(names)
    assert gone == [f"b/run/{name}" for name in names]


@needs_s3
def test_a_store_that_refuses_is_told_by_its_url(monkeypatch: pytest.MonkeyPatch) -> None:
    import s3fs

    def refuse(self: object, *args: object, **options: object) -> None:
        raise PermissionError(13, "Access Denied")

    monkeypatch.setattr(s3fs.S3FileSystem, "pipe_file", refuse)
    with s3_bucket("refusing") as url, pytest.raises(Unreachable) as caught:
        Objects(f"{url}/run").put("a", b"1")
    assert str(caught.value) == f"{url}/run: permission denied: [Errno 13] Access Denied"
