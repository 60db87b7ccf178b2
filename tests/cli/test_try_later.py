"""Exit code 4: what is needed is not there now, and the user made no mistake."""

from __future__ import annotations

import json
import socket

import pytest

from pipeline.errors import BadInput, TryLater
from pipeline.route.run import _how_to_go_on
from pipeline.store.layout import only_writer
from tests.command import nightglass
from tests.service.conftest import SCENE


@pytest.fixture
def closed_port():
    """A port of this machine that nobody listens on."""
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        yield held.getsockname()[1]


@pytest.fixture
def scene_file(tmp_path):
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    return tmp_path / "scene.json"


def test_a_scheduler_that_does_not_answer(scene_file, tmp_path, closed_port):
    address = f"tcp://127.0.0.1:{closed_port}"
    for more in ([], ["--part", "1/2"]):
        ran = nightglass(
            "render", scene_file, "-o", tmp_path / "run", "--scheduler", address, *more
        )
        assert ran.returncode == 4
        assert ran.stderr.startswith(f"nightglass: no scheduler answers at {address} ")
        assert ran.stderr.count("\n") == 1
        left = "is kept: run the part again" if more else "nothing was finished yet"
        assert ran.stderr.endswith(f"{left}\n")
    ran = nightglass("worker", address, "--patience", "1")
    assert (ran.returncode, address in ran.stderr) == (4, True)
    ran = nightglass("worker", "tcp://10.1.2.3:8786")
    assert ran.returncode == 2
    for option, value in (("--memory", "'foo'"), ("--memory", "'1e400GiB'"), ("--patience", "nan"),
                          ("--patience", "inf"), ("--patience", "-1.0"),
                          ("--memory", "'-1GiB'")):  # fmt: skip
        ran = nightglass("worker", address, option, value.strip("'"))
        said = f"{option}: {value} is not accepted" in ran.stderr
        assert (ran.returncode, said) == (2, True), ran.stderr


@pytest.mark.parametrize(
    ("kept", "whole", "left"),
    [(True, True, "what is finished is kept: go on with --resume"),
     (True, False, "what is finished is kept: run the part again"),
     (False, True, "nothing was finished yet")],
)  # fmt: skip
def test_what_is_left_and_how_to_go_on(kept, whole, left):
    told = _how_to_go_on(TryLater("the scheduler left"), kept, whole)
    assert isinstance(told, TryLater)
    assert str(told) == f"the scheduler left; {left}"
    wrong = BadInput("seed", -1, "0 or more")  # trying again does not help there
    assert _how_to_go_on(wrong, kept, whole) is wrong


def test_a_product_that_another_render_writes(scene_file, tmp_path):
    assert nightglass("render", scene_file, "-o", tmp_path / "run").returncode == 0
    with only_writer(tmp_path / "run"):
        ran = nightglass("render", scene_file, "-o", tmp_path / "run", "--resume")
    assert (ran.returncode, "another render" in ran.stderr) == (4, True)


def test_a_database_that_does_not_answer(tmp_path, closed_port, monkeypatch):
    pytest.importorskip("psycopg", reason="psycopg is not installed")
    url = f"postgresql://nightglass@127.0.0.1:{closed_port}/jobs"
    monkeypatch.setenv("NIGHTGLASS_DATABASE", url)
    ran = nightglass("serve", "--home", tmp_path, "--port", "0")
    assert (ran.returncode, "does not answer" in ran.stderr) == (4, True)
    for mistake in ("oracle://x/y", "postgresql://ann@host:port/jobs"):
        monkeypatch.setenv("NIGHTGLASS_DATABASE", mistake)
        assert nightglass("serve", "--home", tmp_path, "--port", "0").returncode == 2
