"""A local S3 server for tests, with credentials that are secret."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

SECRET = "wJalrXUtnFEMI"
needs_s3 = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("s3fs", "moto", "flask")),
    reason="s3fs or moto's server is not installed",
)


@contextmanager
def s3_bucket(name: str) -> Iterator[str]:
    """The URL of a new bucket; while it lasts, the environment leads every s3 client to it."""
    import s3fs
    from moto.server import ThreadedMotoServer

    from catalog_tools.storage import objects

    def forget() -> None:
        s3fs.S3FileSystem.clear_instance_cache()
        objects._files.cache_clear()

    server = ThreadedMotoServer(port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        for key, value in {
            "AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_ACCESS_KEY_ID": "AKIDEXAMPLE",
            "AWS_SECRET_ACCESS_KEY": SECRET, "AWS_DEFAULT_REGION": "us-east-1",
        }.items():  # fmt: skip
            patch.setenv(key, value)
        forget()
        s3fs.S3FileSystem().mkdir(name)
        yield f"s3://{name}"
        forget()
    server.stop()
