"""Variables of the environment that mean nothing are told when the service starts."""

from __future__ import annotations

import errno
import json
import logging
import re
from pathlib import Path

import pytest
import uvicorn

from pipeline.errors import DiskFull
from service import logs, main
from service.settings import Settings, unknown_variables

ROOT = Path(__file__).parents[2]
NAMED = re.compile(r"NIGHTGLASS_[A-Z][A-Z_]*[A-Z]")


def test_every_variable_that_is_read_or_set_is_known() -> None:
    folders = [ROOT / name for name in ("pipeline", "service", "catalog_tools", "deploy", "docs")]
    sources = [p for f in folders for end in ("py", "md", "yaml") for p in f.rglob(f"*.{end}")]
    found = {n for p in (*sources, ROOT / "Dockerfile") for n in NAMED.findall(p.read_text())}
    assert len(found) > 25
    found -= {"NIGHTGLASS_OIDC", "NIGHTGLASS_TLS"}  # what names of settings begin with
    assert unknown_variables(dict.fromkeys(found, "1")) == []


def test_a_misspelt_variable_is_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    """NIGHTGLASS_JOB_CPU for NIGHTGLASS_JOB_CPU_S would leave jobs without their limit."""
    monkeypatch.setenv("NIGHTGLASS_JOB_CPU", "100")
    monkeypatch.setattr(uvicorn.Server, "run", lambda *_, **__: None)
    for module, name in ((main.logs, "set_up"), (main.gc, "freeze"), (main.gc, "set_threshold")):
        monkeypatch.setattr(module, name, lambda *_: None)  # of this process, not of the tests'
    with caplog.at_level(logging.WARNING):
        main.serve("127.0.0.1", 0, tmp_path)
    assert [r.getMessage() for r in caplog.records if "is no setting" in r.getMessage()] == [
        "NIGHTGLASS_JOB_CPU in the environment is no setting: it changes nothing"
    ]


@pytest.mark.parametrize(("wanted", "told"), [("verbose", 1), ("Warning", 0), ("debug", 0)])
def test_an_unknown_level_of_logs_is_told(
    wanted: str, told: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root, ours = logging.getLogger(), logging.getLogger("nightglass")
    before = root.handlers[:], root.level, ours.level
    monkeypatch.setenv("NIGHTGLASS_LOG", wanted)
    try:
        logs.set_up()
        lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
        assert len(lines) == told
        assert all("verbose is none of debug, info" in line["message"] for line in lines)
        assert ours.level == (logging.INFO if told else getattr(logging, wanted.upper()))
    finally:
        root.handlers[:], root.level, ours.level = before[0], before[1], before[2]
        logging.captureWarnings(False)


def test_no_room_for_the_data_folder_is_a_full_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "mkdir", full)
    with pytest.raises(DiskFull) as error:
        Settings(tmp_path / "home").make_folders()
    place = f"{tmp_path / 'home'}: the disk is full (No space left on device); "
    assert str(error.value) == place + "make room, then start again"
