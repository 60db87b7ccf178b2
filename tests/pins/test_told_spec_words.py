"""Options that commands share, exit codes, and text in lines that fit a terminal."""

from __future__ import annotations

import errno
import sys
from pathlib import Path
from typing import Any, get_args

import pytest
import typer

from pipeline import errors
from pipeline.commands import options
from pipeline.errors import BadInput, Damaged, DiskFull, Incomplete, Interrupted, TryLater
from pipeline.lines import fold, pair, table, width
from tests.pins.told import check_told

TEXT = "Frames of some-hyphenated words and one that_is_" + "long" * 12 + " in the middle of it"
HEADS = ["place", "of", "time of all [s]", "memory [MB]"]
ROWS = [["here", "stars and all", "1.25", "3"], ["far " * 9, "", "12", "4096"], ["x", "y", "", "1"]]
PLACES = ("a/b", "/a", "s3://a/b", "file:/a", "x+y-z.1://a", "C:/a", "1://a", "./s3://a", "s3:a")


def test_lines_of_each_width(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = []
    for columns in ("30", "60", "80", "300"):
        monkeypatch.setenv("COLUMNS", columns)
        lines += [
            f"-- {columns}: {width()}",
            fold(TEXT),
            fold(TEXT, "    ", "* "),
            fold(TEXT, "  "),
        ]
        lines += [pair("name", TEXT, 12), pair("name", "short words", 12), pair("name", "", 3)]
        lines += [table(HEADS, ROWS, 2), table(HEADS[2:], [["1", "2"]], 0)]
        lines += [table(HEADS[:3], [["a b", "c", "22"]] * 2, 1), table(HEADS, [], 2)]
    check_told("spec/lines", "\n".join(lines))


def test_errors_and_their_codes() -> None:
    lines = []
    every: list[BaseException] = [
        BadInput("a.b", 3, "a number"),
        BadInput("a", "x" * 200, "less"),
        Incomplete("half"),
        TryLater("not now"),
        Damaged("p", "short"),
        Interrupted("stopped"),
        KeyboardInterrupt(),
        DiskFull("store", errno.ENOSPC, "make room"),
        DiskFull("store", errno.EFBIG, "less"),
        ValueError("v"),
        OSError(errno.ENOSPC, "full"),
        errors.NightglassError("n"),
    ]
    for status in (0, 200, 399, 400, 404, 429, 499, 500, 503, None):
        error = RuntimeError(f"status {status}")
        error.status = status  # type: ignore[attr-defined]
        every.append(error)
    lines += [f"{type(e).__name__}: {e}: {errors.exit_code(e)}" for e in every]
    for value in ("a" * 78, "a" * 79, ["b" * 90], 10**5000, None, {"a": 1}):
        lines += [errors.shorten(value), errors.shorten(value, 9), errors.shorten(value, 10)]
    check_told("spec/errors", "\n".join(lines))


def test_options_that_commands_share(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines: list[str] = []
    for name, said in vars(options).items():
        for one in get_args(said)[1:] if hasattr(said, "__metadata__") else ():
            lines.append(f"{name}: {one.param_decls} {one.min} {one.metavar}: {one.help}")
    for place in PLACES:
        lines.append(f"{place}: {told(lambda p=place: options.local_path(p))}")
    for wish in ((None, None, False), (["a=1"], ["sun", "moon"], True), ([], [], True)):
        lines.append(f"{wish}: {options.overrides_of(*wish)}")
    assert "out: nothing was begun" in told(lambda: interrupted(True))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    for words in (["render", "a b.yaml", "--replace", "-o", "x"], ["sweep", "--resume", "s"]):
        for resumes in (True, False):
            monkeypatch.setattr(sys, "argv", ["nightglass", *words])
            lines.append(told(lambda r=resumes: interrupted(r)))
    for report in ({}, {"errors": {}}, *({"errors": {"as_stated": v}} for v in (True, False))):
        lines.append(f"{report}: {told(lambda r=report: options.as_stated(r))}")
    monkeypatch.setenv("COLUMNS", "60")
    mapping = {"frames": 3, "words": TEXT, "none": None, "list": [1, 2]}
    for as_json in (False, True):
        options.print_mapping(mapping, as_json)
    lines.append(told(lambda: options.print_json(float("nan"))))
    check_told("spec/options", "\n".join([*lines, capsys.readouterr().out]))


def interrupted(resumes: bool) -> None:
    with options.told_if_interrupted("out", lambda: "3 of 4", resumes):
        raise KeyboardInterrupt


def told(call: Any) -> str:
    try:
        found = call()
    except (errors.NightglassError, ValueError, typer.Exit) as error:
        code = getattr(error, "exit_code", "")
        return f"{type(error).__name__}: {error} {code}".rstrip()
    return found.as_posix() if isinstance(found, Path) else repr(found)
