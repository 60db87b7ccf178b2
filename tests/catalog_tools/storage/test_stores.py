"""Catalogues read from URLs: the same stars as from the folder, in few requests, clear errors."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from catalog_tools.catalogue import MANIFEST_NAME, open_catalogue
from catalog_tools.errors import BadInput, Damaged, Incomplete
from catalog_tools.info import info
from catalog_tools.query.query import cone, read_leaf
from catalog_tools.query.starlight import read_starlight
from catalog_tools.storage import stores
from catalog_tools.storage.stores import joined, open_store, without_secrets
from catalog_tools.verify.shards import check_shard
from catalog_tools.verify.verify import verify
from tests.object_store import needs_s3, s3_bucket

needs_http = pytest.mark.skipif(
    importlib.util.find_spec("aiohttp") is None, reason="aiohttp is not installed"
)


class Server:
    """A web server of one folder that knows ranges, or not, and fails when it is told to."""

    def __init__(self, folder: Path, *, ranges: bool = True) -> None:
        self.asked: list[tuple[str, str | None]] = []
        self.failures: list[int] = []  # statuses of the next answers; 0 drops the connection
        outer = self

        class Handler(SimpleHTTPRequestHandler):
            def __init__(self, *args):
                super().__init__(*args, directory=str(folder))

            def log_message(self, *args):
                pass

            def do_GET(self):
                wanted = self.headers.get("Range")
                outer.asked.append((self.path, wanted))
                if outer.failures and (status := outer.failures.pop(0)) != 200:
                    if status == 0:
                        self.close_connection = True
                        return self.connection.close()
                    return self.send_error(status)
                path = Path(self.translate_path(self.path))
                if not (ranges and wanted and path.is_file()):
                    return super().do_GET()
                data = path.read_bytes()
                first, last = (int(part) for part in wanted.removeprefix("bytes=").split("-"))
                if first >= len(data):
                    return self.send_error(416)
                part = data[first : last + 1]
                self.send_response(206)
                self.send_header("Content-Length", str(len(part)))
                self.end_headers()
                return self.wfile.write(part)

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def server(catalogue):
    made = Server(Path(catalogue.path))
    yield made
    made.stop()


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(stores, "RETRY_DELAYS_S", (0.01, 0.01, 0.01))


@pytest.fixture
def in_memory(catalogue):
    import fsspec

    files = fsspec.filesystem("memory")
    files.put(catalogue.path, "/somewhere/made", recursive=True)
    yield "memory://somewhere/made"
    files.rm("/somewhere", recursive=True)


def same_everywhere(catalogue, url):
    other = open_catalogue(url)
    assert other.digest == catalogue.digest
    assert {**info(other), "path": ""} == {**info(catalogue), "path": ""}
    for where in ((10.0, 5.0, 8.0, 12.0), (0.0, -80.0, 20.0, None, 2050.0)):
        ours, report = cone(catalogue, *where)
        theirs, their_report = cone(other, *where)
        assert ours.equals(theirs)
        assert report == their_report
    leaf = catalogue.leaves[5]
    assert read_leaf(other, leaf, 14.0, ["ra"]).equals(read_leaf(catalogue, leaf, 14.0, ["ra"]))
    return other


def test_same_stars_from_a_file_url(catalogue):
    same_everywhere(catalogue, f"file://{catalogue.path}")
    assert open_catalogue(Path(catalogue.path)).path == catalogue.path


def test_same_stars_from_memory(catalogue, in_memory):
    other = same_everywhere(catalogue, in_memory)
    report = verify(other)
    assert (report.findings, report.notes) == ((), ())


@needs_http
def test_same_stars_over_http(catalogue, server):
    other = same_everywhere(catalogue, server.url)
    report = verify(other)
    assert report.whole
    assert "gives no list" in report.notes[0]


@needs_http
def test_same_stars_from_a_server_without_ranges(catalogue):
    plain = Server(Path(catalogue.path), ranges=False)
    try:
        same_everywhere(catalogue, plain.url)
    finally:
        plain.stop()


@needs_http
def test_few_requests_over_http(catalogue, server):
    other = open_catalogue(server.url)
    assert len(server.asked) == 3
    server.asked.clear()
    _, report = cone(other, 10.0, 5.0, 8.0)
    assert len(server.asked) <= 2 * report.leaves
    assert all(wanted for _, wanted in server.asked)


@needs_http
def test_transient_failures_are_tried_again(catalogue, server, quick):
    server.failures = [503, 0, 500]
    other = open_catalogue(server.url)
    for failures in ([429, 0], [408, 425, 504]):
        server.failures = failures
        assert cone(other, 10.0, 5.0, 3.0)[0].equals(cone(catalogue, 10.0, 5.0, 3.0)[0])
    server.failures = [503] * 50
    with pytest.raises(Incomplete, match="503"):
        cone(other, 10.0, 5.0, 3.0)
    assert len(server.failures) > 20


@needs_http
def test_refusals_are_told_at_once(server, quick):
    server.failures = [403]
    with pytest.raises(BadInput, match="403") as caught:
        open_catalogue(server.url, field="stars.catalogue")
    assert caught.value.field == "stars.catalogue"
    assert len(server.asked) == 1
    with pytest.raises(BadInput, match="holds no"):
        open_catalogue(server.url + "/nothing")


@needs_http
def test_refusals_after_the_manifest_are_told_alike(server, quick):
    server.failures = [200, 403]
    with pytest.raises(BadInput, match=r"can be read \(the server answers 403") as caught:
        open_catalogue(server.url, field="stars.catalogue")
    assert (caught.value.field, caught.value.value) == ("stars.catalogue", server.url)
    other = open_catalogue(server.url)
    server.failures = [403]
    with pytest.raises(BadInput, match=r"can be read \(the server answers 403"):
        read_starlight(other)


def test_a_store_that_lists_nothing_cannot_be_verified(in_memory, monkeypatch):
    other = open_catalogue(in_memory)

    def refuse(self, path):
        raise PermissionError(13, "no listing")

    monkeypatch.setattr("fsspec.implementations.memory.MemoryFileSystem.find", refuse)
    with pytest.raises(Incomplete, match=r"could not be listed \(permission denied: .*no listing"):
        verify(other)


def test_a_place_that_takes_no_connection():
    with pytest.raises(BadInput, match=r"a place that can be read \(ConnectionRefusedError"):
        open_catalogue("ftp://127.0.0.1:1/made")


@needs_http
def test_a_server_that_went_away(catalogue, quick):
    gone = Server(Path(catalogue.path))
    other = open_catalogue(gone.url)
    gone.stop()
    with pytest.raises(Incomplete, match="could not be read"):
        cone(other, 0, 0, 10)
    with pytest.raises(Incomplete):
        verify(other)
    with pytest.raises(Incomplete, match="could not be read"):
        check_shard(other, 0)  # a server that goes away halfway has no damaged shards
    with pytest.raises(BadInput, match="can be read"):
        open_catalogue(gone.url)


@needs_http
def test_damage_over_http_is_named(tmp_path, catalogue, quick):
    shutil.copytree(catalogue.path, tmp_path / "copy")
    served = Server(tmp_path / "copy")
    try:
        other = open_catalogue(served.url)
        leaf = other.leaves[2]
        path = tmp_path / "copy" / leaf.path
        good = path.read_bytes()
        changed = bytearray(good)
        changed[leaf.row_groups[0].offset + leaf.row_groups[0].bytes - 3] ^= 1
        for data in (bytes(changed), good[:-1], good[:20], good + b"x"):
            path.write_bytes(data)
            with pytest.raises(Damaged) as caught:
                read_leaf(other, leaf)
            assert caught.value.path == f"{served.url}/{leaf.path}"
        path.unlink()
        with pytest.raises(Damaged, match="missing"):
            read_leaf(other, leaf)
    finally:
        served.stop()


@pytest.fixture(scope="module")
def bucket(catalogue):
    """A bucket with the catalogue in it."""
    import s3fs

    with s3_bucket("sky") as url:
        s3fs.S3FileSystem().put(catalogue.path, "sky/made", recursive=True)
        yield f"{url}/made"


@needs_s3
def test_same_stars_from_s3(catalogue, bucket):
    other = same_everywhere(catalogue, bucket)
    report = verify(other)
    assert (report.findings, report.notes) == ((), ())


@needs_s3
def test_names_of_a_bucket_are_those_of_now(bucket):
    """Another client adds an object between two looks."""
    import boto3

    store = open_store(bucket)
    before = store.names()
    url = os.environ["AWS_ENDPOINT_URL"]
    boto3.client("s3", endpoint_url=url).put_object(Bucket="sky", Key="made/new", Body=b"1")
    try:
        assert store.names() == before | {"new"}
    finally:
        boto3.client("s3", endpoint_url=url).delete_object(Bucket="sky", Key="made/new")


@needs_s3
def test_errors_from_s3(catalogue, bucket):
    import s3fs

    for url in ("s3://sky/absent", "s3://no-such-bucket/made"):
        with pytest.raises(BadInput, match="holds no"):
            open_catalogue(url)
    files = s3fs.S3FileSystem()
    other = open_catalogue(bucket)
    leaf = other.leaves[4]
    good = files.cat_file(f"sky/made/{leaf.path}")
    try:
        for data in (good[:-1], good[:20], good + b"x"):
            files.pipe_file(f"sky/made/{leaf.path}", data)
            with pytest.raises(Damaged, match="bytes long"):
                read_leaf(other, leaf)
        files.pipe_file(f"sky/made/{leaf.path}", good)
        files.pipe_file("sky/made/mine.txt", b"?")
        (finding,) = verify(other).findings
        assert str(finding) == "mine.txt: is no part of the catalogue"
    finally:
        files.pipe_file(f"sky/made/{leaf.path}", good)
        files.rm("sky/made/mine.txt")


@pytest.mark.parametrize(
    "url",
    [
        "https://observer:hunter2@sky.example/made", "s3://AKIDEXAMPLE:hunter2@bucket/made",
        "https://sky.example/made?X-Amz-Signature=hunter2", "https://sky.example/made?key=hunter2",
    ],
)  # fmt: skip
def test_credentials_are_refused_and_never_shown(url):
    with pytest.raises(BadInput, match="credentials come from") as caught:
        open_catalogue(url)
    assert "hunter2" not in str(caught.value)
    assert "hunter2" not in without_secrets(f"cannot read url='{url}', message='no'")


@pytest.mark.parametrize(("url", "package"), [("s3://b/c", "s3fs"), ("http://h/c", "aiohttp")])
def test_missing_packages_name_the_extra(url, package):
    code = (
        f"import sys; sys.modules[{package!r}] = None\n"
        "from catalog_tools.catalogue import open_catalogue\n"
        f"open_catalogue({url!r})"
    )
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True)
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("catalog_tools.errors.Missing: catalogue: ")
    assert f"need {package}, " in last
    assert "pip install 'nightglass[remote]'" in last


def test_unknown_protocols_and_odd_urls():
    for url in ("foo://bar/baz", "http://[::1/made"):
        with pytest.raises(BadInput):
            open_catalogue(url)


def test_folders_that_cannot_be_read(tmp_path, catalogue, monkeypatch):
    def refuse(self, name):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(stores.LocalStore, "read", refuse)
    with pytest.raises(BadInput, match="can be read"):
        open_catalogue(catalogue.path)


def test_joined_ranges():
    assert joined([(100, 10), (0, 50), (60, 5)], 10) == [(0, 65), (100, 10)]
    assert joined([(100, 10), (0, 50), (60, 5)], 100) == [(0, 110)]
    assert joined([(0, 50), (10, 5)], 0) == [(0, 50)]
    assert joined([], 5) == []


def test_stores_fill_the_same(catalogue, in_memory):
    """Ranges in any order, overlapping, past the end: as slices of the file."""
    name = catalogue.leaves[0].path
    data = (Path(catalogue.path) / name).read_bytes()
    assert len(data) > 3000
    spans = [(2000, 100), (0, 10), (5, 20), (len(data) - 5, 20), (len(data) + 9, 4), (1999, 2)]
    for store in (open_store(catalogue.path), open_store(in_memory)):
        parts = [(offset, np.zeros(length, np.uint8)) for offset, length in spans]
        found = store.fill(name, parts)
        for (offset, part), length in zip(parts, found, strict=True):
            assert part[:length].tobytes() == data[offset : offset + part.size]
        assert store.size(name) == len(data)
        assert MANIFEST_NAME in store.names()
        with pytest.raises(FileNotFoundError):
            store.read("absent")
