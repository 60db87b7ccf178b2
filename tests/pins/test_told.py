"""Words are compared to the letter, numbers but for rounding."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.pins import told
from tests.pins.told import check_told

LINE = "in <folder>/run: 12 stars,  bound 1.26e-05 sigma"


@pytest.fixture(autouse=True)
def pinned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(told, "TOLD", tmp_path / "told")
    monkeypatch.setenv(told.ANEW, "anew")
    check_told("one", f"in {tmp_path}/run: 12 stars,  bound 1.26e-05 sigma \n", folder=tmp_path)
    monkeypatch.delenv(told.ANEW)


def tells(text: str, **allowed: Any) -> bool:
    try:
        check_told("one", text, **allowed)
    except AssertionError:
        return False
    return True


def test_paths_and_white_space_at_the_end_do_not_count() -> None:
    assert tells(LINE)


@pytest.mark.parametrize(
    ("old", "new"),
    [("1.26", "1.28"), ("12", "13"), (",  ", ", "), (LINE, ""), ("sigma", "sigma\nmore")],
)
def test_other_words_and_numbers(old: str, new: str) -> None:
    assert not tells(LINE.replace(old, new))


def test_the_last_place_may_be_rounded_otherwise() -> None:
    assert tells(LINE.replace("1.26", "1.27"))


def test_numbers_that_a_fit_or_a_measurement_makes_may_differ_by_more() -> None:
    other = LINE.replace("1.26", "1.28")
    assert tells(other, relative=0.02)
    assert tells(other, noise=1e-4)
    assert not tells(other, noise=1.27e-5)


def test_a_pin_that_is_not_there_is_named() -> None:
    with pytest.raises(AssertionError, match=r"two\.txt: no such pin"):
        check_told("two", "words")
