"""Words are compared to the letter here, and but for rounding on another kind of processor."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pins import told
from tests.pins.told import check_told

LINE = "in <folder>/run: 12 stars,  bound 1.26e-05 sigma"


@pytest.fixture(params=[True, False], ids=["here", "elsewhere"])
def here(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    monkeypatch.setattr(told, "TOLD", tmp_path / "told")
    monkeypatch.setattr(told, "is_pinned_kind", lambda: request.param)
    monkeypatch.setenv(told.ANEW, "anew")
    check_told("one", f"in {tmp_path}/run: 12 stars,  bound 1.26e-05 sigma \n", folder=tmp_path)
    monkeypatch.delenv(told.ANEW)
    return request.param


def tells(text: str) -> bool:
    try:
        check_told("one", text)
    except AssertionError:
        return False
    return True


def test_paths_and_white_space_at_the_end_do_not_count(here: bool) -> None:
    assert tells(LINE)


@pytest.mark.parametrize(
    ("old", "new"),
    [("1.26", "1.28"), ("12", "13"), (",  ", ", "), (LINE, ""), ("sigma", "sigma\nmore")],
)
def test_other_words_and_numbers(old: str, new: str, here: bool) -> None:
    assert not tells(LINE.replace(old, new))


def test_rounding_counts_here_alone(here: bool) -> None:
    assert tells(LINE.replace("1.26", "1.27")) != here


def test_a_pin_that_is_not_there_is_named(here: bool) -> None:
    with pytest.raises(AssertionError, match=r"two\.txt: no such pin"):
        check_told("two", "words")
