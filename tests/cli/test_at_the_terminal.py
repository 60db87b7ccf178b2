"""What a person at a terminal asks for: version, what a product is, how to go on, completion."""

from __future__ import annotations

import json
import os
import pty
import re
import shlex
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from rich.console import Console

from pipeline import cli
from pipeline.commands import pages
from pipeline.route.draw import Progress
from pipeline.route.prepare import plan_scene
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.product import check
from tests.command import nightglass

SCENE = {
    "schema": "nightglass/scene/1", "name": "small", "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3},
    "sensor": {
        "shape": [512, 512], "pixel_pitch_um": 9.0, "focal_length_m": 1.0, "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0, "bias_dn": 100,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 276.0, "boresight_dec_deg": -3.2},
    "exposure": {"integration_s": 1.0, "frames": 120},
    "background": {"uniform_e_per_s": 20.0},
}  # fmt: skip
ENTRY = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); import pipeline.cli"
)


def interrupted(folder: Path, *arguments: str) -> tuple[int, str]:
    """A command that gets Ctrl-C once tiles are done: its exit code and what it says."""
    code = f"{ENTRY}; pipeline.cli.main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments], cwd=folder, stderr=subprocess.PIPE, text=True
    )
    began = time.monotonic()
    while process.poll() is None and time.monotonic() - began < 120:
        if len(list(folder.glob("my run/markers/f*.json"))) >= 3:
            process.send_signal(signal.SIGINT)
            break
        time.sleep(0.01)
    _, said = process.communicate(timeout=120)
    return process.returncode, said


GROUPS = ["", "catalog", "cosmic-rays", "import", "jobs", "keys", "report"]


@pytest.mark.parametrize("group", GROUPS)
def test_a_group_without_a_command_shows_its_help(group: str) -> None:
    """The page of `--help`, and no word of a mistake."""
    alone, asked = nightglass(*group.split()), nightglass(*group.split(), "--help")
    assert f"Usage: nightglass {group}".strip() in asked.stdout
    assert (alone.stdout.strip(), alone.stderr) == (asked.stdout.strip(), "")


def test_ctrl_c_says_what_is_kept_and_how_to_go_on(tmp_path: Path) -> None:
    """The command that it prints, word for word, ends with a whole product."""
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    arguments = ["render", "scene.json", "-o", "my run", "--workers", "1"]
    code, said = interrupted(tmp_path, *arguments, "--replace")
    assert code == 130, said
    assert "nightglass: interrupted; my run: " in said
    done = int(said.split("my run: ")[1].split()[0])
    assert 3 <= done < 120
    assert f"{done} of 120 tiles are kept; go on with:" in said
    again = shlex.split(said.strip().splitlines()[-1])
    assert again == ["nightglass", *arguments, "--resume"]
    code, said = unfinished(tmp_path / "my run")
    assert (code, said["state"], said["tiles"]) == (0, "not complete", done)
    went_on = subprocess.run(
        [sys.executable, "-m", "pipeline", *again[1:], "--json"], cwd=tmp_path,
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert went_on.returncode == 0, went_on.stderr
    assert json.loads(went_on.stdout)["tiles_resumed"] == done
    assert check(tmp_path / "my run").whole


def test_ctrl_c_of_a_render_into_a_store_asks_it_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    monkeypatch.setattr("pipeline.commands.render.run", Mock(side_effect=KeyboardInterrupt))
    done = nightglass("render", tmp_path / "scene.json", "-o", "s3://bucket/run")
    assert done.returncode == 130
    said = "interrupted; s3://bucket/run: finished tiles are kept; go on with:"
    assert said in done.stderr
    assert shlex.split(done.stderr.strip().splitlines()[-1])[-3:] == [
        "-o", "s3://bucket/run", "--resume"
    ]  # fmt: skip


def unfinished(product: Path) -> tuple[int, dict[str, Any]]:
    told = nightglass("info", product, "--json")
    assert "--resume` goes on" in nightglass("info", product).stdout
    return told.returncode, json.loads(told.stdout)


def test_info_of_a_product(tmp_path: Path) -> None:
    small = SCENE | {"exposure": {"integration_s": 1.0, "frames": 2}}
    (tmp_path / "scene.json").write_text(json.dumps(small))
    report = json.loads(
        nightglass("render", tmp_path / "scene.json", "-o", tmp_path / "run", "--json").stdout
    )
    told = json.loads(nightglass("info", tmp_path / "run", "--json").stdout)
    assert told["state"] == "complete"
    assert (told["tiles"], told["tiles_expected"], told["frames"]) == (2, 2, 2)
    assert (told["shape"], told["layers"]) == ([512, 512], ["dn"])
    assert told["content_digest"] == report["content_digest"]
    said = " ".join(nightglass("info", tmp_path / "run").stdout.split())
    for words in ("complete, 2 of 2 tiles", "2 of 512 x 512 px", "open with xarray.open_zarr",
                  f"nightglass {version('nightglass')}"):  # fmt: skip
        assert words in said
    wrong = nightglass("info", tmp_path)
    assert (wrong.returncode, "PRODUCT" in wrong.stderr) == (2, True)
    named = (tmp_path / "run").rename(tmp_path / "prüfung")
    ran = subprocess.run(
        [sys.executable, "-m", "pipeline", "info", named], capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}, timeout=100,
    )  # fmt: skip
    assert (ran.returncode, rb"pr\xfcfung" in ran.stdout) == (0, True), ran.stderr


def test_version() -> None:
    told = nightglass("--version")
    assert (told.returncode, told.stdout) == (0, f"nightglass {version('nightglass')}\n")


def test_messages_are_folded_at_a_terminal_and_one_line_elsewhere(tmp_path: Path) -> None:
    """A terminal of 80 columns breaks no word; a log gets the same words in one line."""
    (tmp_path / "scene.json").write_text(json.dumps(SCENE | {"epoch": "on a day long ago"}))
    line = [sys.executable, "-m", "pipeline", "plan", "scene.json"]
    logged = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, check=False)
    master, slave = pty.openpty()
    shown = subprocess.Popen(
        line, cwd=tmp_path, stderr=slave, stdout=subprocess.DEVNULL,
        env=os.environ | {"COLUMNS": "80"},
    )  # fmt: skip
    assert shown.wait(60) == logged.returncode == 2
    os.close(slave)
    told = os.read(master, 1 << 16).decode().splitlines()
    os.close(master)
    assert len(logged.stderr.splitlines()) == 1
    assert len(logged.stderr) > 80
    assert len(told) > 1
    assert max(map(len, told)) <= 80
    assert " ".join(part.strip() for part in told) == logged.stderr.strip()


def test_completion_script(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))  # not make's sh
    told = nightglass("--show-completion")
    assert told.returncode == 0
    assert "_NIGHTGLASS_COMPLETE" in told.stdout


@pytest.mark.parametrize(
    ("words", "found"), [("nightglass ren", "render"), ("nightglass plan --exp", "--explain")]
)
def test_completion_in_bash(words: str, found: str) -> None:
    asked = os.environ | {
        "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1),
        "_NIGHTGLASS_COMPLETE": "complete_bash",
    }  # fmt: skip
    code = "import sys, pipeline.cli; sys.argv = ['nightglass']; pipeline.cli.main()"
    told = subprocess.run(
        [sys.executable, "-c", code], env=asked, capture_output=True, text=True, timeout=60
    )
    assert found in told.stdout.split(), told.stderr


def test_progress_has_words_a_rate_and_the_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    bar = pages.progress_bar("tiles")
    bar.live.console = Console(width=80, force_terminal=False)
    now = [0.0]
    monkeypatch.setattr(bar, "get_time", lambda: now[0])
    task = bar.add_task("rendering", total=40)
    for done in range(1, 13):
        now[0] += 0.5
        bar.update(task, completed=done)
    with bar.console.capture() as shown:
        bar.console.print(bar.get_renderable())
    line = shown.get().rstrip()
    for words in ("rendering", "12/40 tiles", "2/s", "0:00:14 left"):
        assert words in line, line
    assert len(line) <= 80


@pytest.mark.parametrize(("frames", "said"), [(2, "rendering"), (9000, r"rendering, \d+ CPU min")])
def test_long_work_is_told_with_its_size(tmp_path: Path, frames: int, said: str) -> None:
    """As the plan forecasts it, until the first tile is done; then the time left shows."""
    scene = parse_scene(SCENE | {"exposure": {"integration_s": 1.0, "frames": frames}})
    heard: list[Progress] = []

    def listen(progress: Progress) -> None:
        heard.append(progress)
        if progress.done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render(scene, tmp_path / "run", Options("synchronous"), listen)
    *before, first = heard
    assert before[0].doing == "start"
    assert all(re.fullmatch(said, progress.stage) for progress in before)
    assert first.stage == "rendering"
    forecast_s = plan_scene(scene)["predicted"]["cpu_s"]
    assert before[0].left_s == pytest.approx(forecast_s, rel=0.3, abs=4.0)


@pytest.mark.parametrize(("code", "said"), [(130, "nightglass: interrupted"), (1, ""), (0, "")])
def test_ctrl_c_is_told_where_the_library_took_it_for_an_exit(
    code: int, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And no other exit is told as Ctrl-C."""
    monkeypatch.setattr(cli, "app", lambda **_: code)
    for name in ("_open_streams", "one_heap", "few_collections"):  # of this process
        monkeypatch.setattr(cli, name, lambda: None)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == code
    told = capsys.readouterr().err
    assert told.startswith(said)
    assert bool(told) == bool(said)
