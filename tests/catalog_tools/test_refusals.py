"""What cannot go on says so at once, in one message: on a cluster, and where a disk is full."""

from __future__ import annotations

import resource
import tempfile
from contextlib import suppress

import pytest

from catalog_tools.engine.ahead import cores
from catalog_tools.engine.cluster_scheduler import MOST_TRIES, ClusterScheduler
from catalog_tools.errors import BadInput, Incomplete
from catalog_tools.storage.durable import whole_file, write_atomically
from catalog_tools.verify.verify import verify


@pytest.fixture(scope="module")
def cluster():
    from distributed import Client, LocalCluster

    with (
        LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
        ) as running,
        Client(running, set_as_default=False) as client,
    ):
        yield ClusterScheduler(client, 2)


def failing(log, error, times):
    """A task that notes each call, and fails the first `times`."""
    with log.open("a") as file:
        file.write("x")
    if len(log.read_text()) <= times:
        raise error
    return "done"


def test_bad_input_on_a_cluster_is_told_after_one_try(tmp_path, cluster):
    log = tmp_path / "log"
    graph = {("read", 0): (failing, log, BadInput("source", "x.csv", "a table"), 9)}
    with pytest.raises(BadInput, match=r"x\.csv"):
        cluster.run(graph, list(graph), lambda _: None)
    assert log.read_text() == "x"


def test_other_failures_on_a_cluster_are_tried_again(tmp_path, cluster):
    done = []
    for times in (1, MOST_TRIES - 1):
        log = tmp_path / f"log{times}"
        graph = {
            ("read", 0): (failing, log, OSError(5, "Input/output error"), times),
            ("join", 0): (str.upper, ("read", 0)),
        }
        assert cluster.run(graph, [("join", 0)], done.append) == ["DONE"]
        assert len(log.read_text()) == times + 1
    assert done == ["join", "join"]
    graph = {("read", 0): (failing, tmp_path / "log", OSError(5, "Input/output error"), 99)}
    with pytest.raises(OSError, match="Input/output"):
        cluster.run(graph, list(graph), lambda _: None)
    assert len((tmp_path / "log").read_text()) == MOST_TRIES


def test_verify_without_room_for_its_notes_says_so(catalogue, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8 * 1000, hard))
    try:
        with pytest.raises(Incomplete, match=rf"{tmp_path}: .*File too large.*TMPDIR"):
            verify(catalogue)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "absent"))
    with pytest.raises(Incomplete, match="TMPDIR"):
        verify(catalogue)


def test_a_file_is_there_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.json"
    write_atomically(path, "one")
    with suppress(ZeroDivisionError), whole_file(path) as own:
        own.write_text("tw")
        raise ZeroDivisionError
    assert path.read_text() == "one"
    with whole_file(path) as first, whole_file(path) as second:
        first.write_text("first")
        second.write_bytes(b"second")
    assert path.read_text() == "first"
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]
    assert cores() >= 1
