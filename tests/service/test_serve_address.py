"""The address that the service says it listens at."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
import uvicorn

from pipeline.errors import BadInput
from service import main


@pytest.mark.parametrize(("host", "shown"), [("127.0.0.1", "127.0.0.1"), ("::1", "[::1]")])
def test_the_address_is_a_url(
    host: str,
    shown: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    """IPv6 addresses stand in brackets (RFC 3986, 3.2.2)."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family) as probe:
            probe.bind((host, 0))
    except OSError:
        pytest.skip(f"no {host} here")
    ports = []

    def run(self: uvicorn.Server, sockets: list[socket.socket]) -> None:
        ports.append(sockets[0].getsockname()[1])

    monkeypatch.setattr(uvicorn.Server, "run", run)
    for module, name in ((main.logs, "set_up"), (main.gc, "freeze"), (main.gc, "set_threshold")):
        monkeypatch.setattr(module, name, lambda *_: None)  # of this process, not of the tests'
    main.serve(host, 0, tmp_path)
    assert f"serves http://{shown}:{ports[0]} from {tmp_path}" in capsys.readouterr().err


def test_an_address_may_stand_in_brackets_and_ports_end_at_65535() -> None:
    main.bind("[127.0.0.1]", 0).close()
    with pytest.raises(BadInput, match="--port"):
        main.bind("127.0.0.1", 65536)


@pytest.mark.parametrize("content", [None, "no certificate"])
def test_a_certificate_that_is_none_is_refused_before_anything_is_served(
    content: str | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    place = tmp_path / "api.pem"
    if content is not None:
        place.write_text(content)
    for name in ("CERT", "KEY"):
        monkeypatch.setenv(f"NIGHTGLASS_TLS_{name}", str(place))
    with pytest.raises(BadInput, match="its key as NIGHTGLASS_TLS_KEY; ") as caught:
        main.serve("127.0.0.1", 0, tmp_path / "home")
    assert (caught.value.field, caught.value.value) == ("NIGHTGLASS_TLS_CERT", str(place))
