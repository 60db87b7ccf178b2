"""Tickets: a browser fetches what one names without a key, for a minute, and nothing else."""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.requests import Request

from service.accounts.auth import Caller
from service.accounts.tickets import LASTS_S, Tickets
from service.problems import NotAllowed, Unauthenticated
from tests.service.conftest import bearer

PLACE, RED = "/v1/jobs/x/product.tar", Caller("red", "key:1")


def asked(address: str, method: str = "GET") -> Request:
    path, _, query = address.partition("?")
    scope = {"type": "http", "method": method, "headers": []}
    return Request(scope | {"raw_path": path.encode(), "query_string": query.encode()})


def test_a_ticket_is_for_one_place_and_one_minute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tickets = Tickets(tmp_path)
    assert stat.S_IMODE((tmp_path / "tickets.key").stat().st_mode) == 0o600
    for place in (PLACE, f"{PLACE}?layer=dn", "/v1/jobs/x/results/truth/a%20b.parquet"):
        href = tickets.make(RED, place)
        assert Tickets(tmp_path).caller(asked(href)) == RED  # another process of the service
        assert tickets.caller(asked(href, "HEAD")) == RED
        assert tickets.caller(asked(href, "DELETE")) is None
        for other in (
            href.replace("/x/", "/y/"), f"{href}0", href[:-1], f"{href}&limit=1",
            href.replace("ticket=", "limit=1&ticket="), f"/v1/jobs?ticket={href[-70:]}",
        ):  # fmt: skip
            with pytest.raises(Unauthenticated):
                tickets.caller(asked(other))
    with pytest.raises(Unauthenticated):
        Tickets(tmp_path / "..").caller(asked(href))
    assert tickets.caller(asked(PLACE)) is None
    for wrong in ("/v1/jobs", "/v1/files", "https://x/v1/jobs/x", "/v1/jobs/a b", href):
        with pytest.raises(NotAllowed):
            tickets.make(RED, wrong)
    late = SimpleNamespace(time=lambda: time.time() + LASTS_S + 1)
    monkeypatch.setattr("service.accounts.tickets.time", late)
    with pytest.raises(Unauthenticated):
        tickets.caller(asked(href))


def test_over_http_a_ticket_shows_its_own_teams_job(
    make_server: Callable[..., Any], scene: dict[str, Any]
) -> None:
    server = make_server()
    red, blue = map(bearer, server.make_keys("red", "blue"))
    job = server.client.post("/v1/jobs", json=scene, headers=red).headers["location"]
    wanted = {"path": f"{job}/scene"}

    def fetched(headers: dict[str, str]) -> tuple[int, str]:
        made = server.client.post("/v1/tickets", json=wanted, headers=headers)
        assert made.status_code == 201, made.text
        answer = server.client.get(made.json()["href"])
        return answer.status_code, answer.text

    assert server.client.post("/v1/tickets", json=wanted).status_code == 401
    assert fetched(red)[0] == 200
    assert fetched(blue)[0] == 404
    for body in ({}, {"path": 5}, {"path": "/v1/usage"}, {"path": job, "more": 1}, []):
        assert server.client.post("/v1/tickets", json=body, headers=red).status_code == 422
    assert "ticket=" not in server.logged()


def test_of_two_that_start_at_once_one_secret_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever comes second takes the first one's, and leaves no file of its own."""
    key, drawn = tmp_path / "tickets.key", os.urandom

    def late(count: int) -> bytes:
        if count == 32:
            key.write_bytes(b"f" * 32)  # the other process is done just now
        return drawn(count)

    monkeypatch.setattr(os, "urandom", late)
    href = Tickets(tmp_path).make(RED, PLACE)
    monkeypatch.undo()
    assert Tickets(tmp_path).caller(asked(href)) == RED
    assert key.read_bytes() == b"f" * 32
    assert [path.name for path in tmp_path.iterdir()] == ["tickets.key"]
