"""Leases of a product on an object store, by the store's clock: who holds one, and until when."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from catalog_tools.storage.objects import Listed
from catalog_tools.storage.stores import Unreachable
from pipeline.errors import BadInput, Incomplete, TryLater
from pipeline.store import lease
from pipeline.store.lease import only_writer_of

FIRST, SECOND = ".lock/000000000001", ".lock/000000000002"


class Store:
    """Objects in memory, with a clock that stands until it is moved."""

    url = "s3://bucket/product"

    def __init__(self, conditional: bool = True) -> None:
        self.now = datetime(2019, 4, 20, tzinfo=UTC)
        self.held: dict[str, tuple[bytes, datetime]] = {}
        self.conditional = conditional

    def later(self, seconds: float) -> None:
        self.now += timedelta(seconds=seconds)

    def put(self, name: str, content: bytes) -> None:
        self.held[name] = content, self.now

    def create(self, name: str, content: bytes) -> bool:
        if self.conditional and name in self.held:
            return False
        self.put(name, content)
        return True

    def get(self, name: str) -> bytes | None:
        return self.held.get(name, (None,))[0]

    def names(self, prefix: str = "") -> dict[str, Listed]:
        return {n: Listed(len(c), t) for n, (c, t) in self.held.items() if n.startswith(prefix)}

    def delete(self, names: Iterable[str]) -> None:
        for name in list(names):
            del self.held[name]


@pytest.fixture
def store() -> Any:
    return Store()


def busy(store: Any, shared: str | None = None) -> bool:
    try:
        with only_writer_of(store, shared):
            return False
    except TryLater:
        return True


def test_a_lease_that_is_renewed_never_runs_out(store: Any) -> None:
    with only_writer_of(store) as mine:
        for _ in range(12):
            store.later(59.0)
            assert busy(store)
            mine.renew()
        mine.check()
        assert set(store.held) == {FIRST}


def test_a_lease_runs_out_a_minute_after_it_was_last_renewed(store: Any) -> None:
    """Its owner learns of it, and leaves the lease of who came after it alone."""
    with only_writer_of(store) as mine:
        store.later(30.0)
        mine.renew()
        store.later(59.0)
        assert busy(store)
        store.later(1.0)
        with only_writer_of(store) as other:
            assert (mine.name, other.name) == (FIRST, SECOND)
            before = dict(store.held)
            mine.renew()
            with pytest.raises(Incomplete, match="taken this product over"):
                mine.check()
            assert store.held == before
            lease._give_up(mine)
            assert store.held == before
            other.renew()
            other.check()


def test_what_was_given_up_is_free_at_once_and_older_ones_are_removed(store: Any) -> None:
    for number in (1, 2, 3):
        with only_writer_of(store) as mine:
            assert mine.name == f".lock/{number:012d}"
        assert set(store.held) == {mine.name}
        assert not mine.lost


def test_the_newest_of_several_leases_counts(store: Any) -> None:
    """A writer that died as it tidied up leaves older ones beside the newest."""
    for name in (FIRST, SECOND):
        store.put(name, lease.FREE)
    with only_writer_of(store) as mine:
        assert mine.name == ".lock/000000000003"
    assert set(store.held) == {mine.name}
    store.put(SECOND, b'{"owner": "of old"}')
    assert not busy(store)
    store.put(".lock/000000000009", b'{"owner": "newest"}')
    assert busy(store)


def test_a_lease_that_goes_as_it_is_looked_at_keeps_nobody_out(
    store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.put(FIRST, b'{"owner": "tidied away"}')
    assert busy(store)
    monkeypatch.setattr(store, "get", lambda name: None)
    assert not busy(store)


def test_a_store_that_is_away_for_a_while_costs_no_lease(
    store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Later renewals are tried, and hold it."""
    ended, left = threading.Event(), [Unreachable("away"), OSError("away"), None]
    with only_writer_of(store) as mine:
        monkeypatch.setattr(lease, "RENEWED_S", 0.0)
        store.later(40.0)

        def renew() -> None:
            if not left:
                ended.set()
            elif (fault := left.pop(0)) is not None:
                raise fault
            else:
                type(mine).renew(mine)

        monkeypatch.setattr(mine, "renew", renew)
        lease._keep(mine, ended)
        assert store.held[FIRST][1] == store.now


def test_parts_go_beside_each_other_and_not_beside_the_whole(store: Any) -> None:
    with only_writer_of(store, "part-1-of-2"):
        assert not busy(store, "part-2-of-2")
        assert busy(store, "part-1-of-2")
        assert busy(store)
        store.later(60.0)
        assert not busy(store)
    with only_writer_of(store):
        assert busy(store, "part-1-of-2")


def test_a_store_without_conditional_puts_is_refused_and_left_empty() -> None:
    store: Any = Store(conditional=False)
    with pytest.raises(BadInput, match="If-None-Match") as told, only_writer_of(store):
        pass
    assert told.value.value == store.url
    assert store.held == {}


def test_of_two_that_take_it_at_once_one_is_told_to_wait(
    store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The store takes one of the two conditional PUTs; the other's leaves nothing."""
    create = store.create

    def another_first(name: str, content: bytes) -> bool:
        store.put(name, b'{"owner": "another"}')
        return create(name, content)

    monkeypatch.setattr(store, "create", another_first)
    with pytest.raises(TryLater, match="another render is writing"), only_writer_of(store):
        pass
    assert store.held == {FIRST: (b'{"owner": "another"}', store.now)}
