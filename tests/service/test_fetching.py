"""Files of a product that are fetched: what came stays, and only the rest is asked for."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import httpx
import pytest

from pipeline.errors import Incomplete
from pipeline.store.layout import COMPLETE
from service import fetching


class Cut(httpx.SyncByteStream):
    """Bytes of a connection that breaks behind them."""

    def __init__(self, content: bytes) -> None:
        self.content = content

    def __iter__(self) -> Iterator[bytes]:
        yield self.content
        raise httpx.ReadError("broken")


@pytest.mark.parametrize("had", [0, 2, 10])
def test_a_connection_that_breaks_within_a_file_is_gone_on_with(tmp_path: Path, had: int) -> None:
    """From the byte where it broke, again and again; what had come whole is not asked for."""
    whole, asked = bytes(range(10)), []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.headers.get("range"))
        first = int(asked[-1][6:-1]) if asked[-1] else 0
        rest = whole[first:]
        stream = httpx.ByteStream(rest) if len(rest) <= 3 else Cut(rest[:3])
        return httpx.Response(206 if first else 200, stream=stream)

    http = httpx.Client(transport=httpx.MockTransport(answer), base_url="http://h")
    client = SimpleNamespace(http=http, ask=lambda *_: None)
    if had:
        (tmp_path / f"a.bin{fetching.PART}").write_bytes(whole[:had])
    counted: list[int] = []
    job = SimpleNamespace(client=client, path="/v1/jobs/x", facts={})
    fetching._fetch(job, tmp_path, "a.bin", len(whole), counted.append)
    assert (tmp_path / "a.bin").read_bytes() == whole
    assert [path.name for path in tmp_path.iterdir()] == ["a.bin"]
    assert asked == [f"bytes={k}-" if k else None for k in range(had, 10, 3)]
    assert sum(counted) == len(whole)


def test_a_file_that_did_not_come_is_not_called_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same command goes on from there: what one file's download says is what is told."""

    def broken(*_: object) -> None:
        raise Incomplete("a.bin: 3 of 10 bytes came")

    monkeypatch.setattr(fetching, "_listing", lambda _: [("a.bin", 10)])
    monkeypatch.setattr(fetching, "_fetch", broken)
    client = SimpleNamespace(ask=lambda *_: SimpleNamespace(content=b"{}"))
    job = SimpleNamespace(client=client, path="/v1/jobs/x", facts={})
    with pytest.raises(Incomplete, match="3 of 10 bytes came"):
        fetching.fetch_product(job, tmp_path / "run", 2, None)


def test_a_product_that_is_half_there_has_no_seal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The seal is among the files that the server lists, and may be the first."""

    def fetch(_: object, folder: Path, path: str, *__: object) -> None:
        if path == "a.bin":
            raise Incomplete("a.bin: 3 of 10 bytes came")
        (folder / path).write_bytes(b"{}")

    monkeypatch.setattr(fetching, "_listing", lambda _: [(COMPLETE, 2), ("a.bin", 10)])
    monkeypatch.setattr(fetching, "_fetch", fetch)
    client = SimpleNamespace(ask=lambda *_: SimpleNamespace(content=b"{}"))
    job = SimpleNamespace(client=client, path="/v1/jobs/x", facts={})
    with pytest.raises(Incomplete):
        fetching.fetch_product(job, tmp_path / "run", 1, None)
    assert not (tmp_path / "run" / COMPLETE).exists()


def test_a_folder_beside_a_sweep_that_is_fetched_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = tmp_path / "swept.part" / "mine.txt"
    kept.parent.mkdir()
    kept.write_text("keep me")
    monkeypatch.setattr(fetching, "_listing", lambda _: [])
    client = SimpleNamespace(ask=lambda *_: SimpleNamespace(content=b'{"files": {}}'))
    job = SimpleNamespace(client=client, path="/v1/jobs/x", facts={})
    fetching.fetch_sweep(job, tmp_path / "swept")
    assert kept.read_text() == "keep me"
    assert {path.name for path in tmp_path.iterdir()} == {"swept", "swept.part"}
