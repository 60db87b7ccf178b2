"""Time scales against astropy, leap seconds, and text that is no time."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import BadInput
from pipeline.physics.positions.times import elapsed_s, format_utc, instants, parse_utc


@pytest.mark.filterwarnings("ignore:ERFA function")  # dubious years
@pytest.mark.parametrize(
    "text",
    ["2019-04-20T03:00:00Z", "1999-12-31T23:59:59.123456Z", "1975-06-01T12:00:00Z", "2100-12-31T01"
     ":00:00Z", "2016-12-31T23:59:60.25Z"],
)  # fmt: skip
def test_against_astropy_scales(text: str) -> None:
    ours = instants(parse_utc(text), np.array([0.0]))
    t = Time(text.rstrip("Z"), scale="utc")
    t.delta_ut1_utc = 0.0
    for (a, b), scale in (((ours.tt1, ours.tt2), t.tt), ((ours.ut11, ours.ut12), t.ut1)):
        assert abs(((a[0] - scale.jd1) + (b[0] - scale.jd2)) * 86400) < 1e-9


def test_other_spellings() -> None:
    a = parse_utc("2019-04-20T03:00:00Z")
    for text in ("2019-04-20 03:00:00Z", "2019-04-20T03:00:00+00:00", "2019-04-20T03:00",
                 " 2019-04-20T03:00:00.0 "):  # fmt: skip
        assert parse_utc(text) == a


@pytest.mark.parametrize(
    "text",
    ["", "today", "2019-13-01T00:00:00Z", "2019-02-29T00:00:00Z", "2019-04-20T24:00:00Z",
     "2019-04-20T03:61:00Z", "2019-04-20T03:00:61Z", "2019-04-20T03:00:00+01:00", "1899-01-01T00:00"
     ":00Z", "2101-01-01T00:00:00Z", "2019-04-20", "2019-12-31T23:59:60Z", "٢٠١٩-04-20T03:00:00Z",
     "2019-04-20T03:00:00Z\x00", 45000, None],
)  # fmt: skip
def test_limits_bad_text_names_its_field(text: object) -> None:
    with pytest.raises(BadInput) as error:
        parse_utc(text, "observer.epoch")  # type: ignore[arg-type]
    assert error.value.field == "observer.epoch"


def test_limits_across_a_leap_second() -> None:
    epoch = parse_utc("2016-12-31T23:59:59Z")
    at = instants(epoch, np.array([0.0, 1.0, 1.5, 2.0]), dut1_s=-0.4)
    texts = [format_utc(a, b) for a, b in zip(at.utc1, at.utc2, strict=True)]
    assert texts == [
        "2016-12-31T23:59:59.000000Z",
        "2016-12-31T23:59:60.000000Z",
        "2016-12-31T23:59:60.500000Z",
        "2017-01-01T00:00:00.000000Z",
    ]
    for one, two in ((at.tt1, at.tt2), (at.ut11, at.ut12)):  # both run on without a jump
        seconds = ((one - one[0]) + (two - two[0])) * 86400
        assert np.allclose(seconds, [0, 1, 1.5, 2], atol=1e-9)
    assert np.allclose(elapsed_s(epoch, at.utc1, at.utc2), [0, 1, 1.5, 2], atol=1e-9)


@given(st.integers(0, 200 * 365 * 86400 - 1), st.integers(0, 999_999))
def test_same_text_there_and_back(seconds: int, micro: int) -> None:
    day, rest = divmod(seconds, 86400)
    date = np.datetime64("1900-01-01") + day
    text = f"{date}T{rest // 3600:02d}:{rest // 60 % 60:02d}:{rest % 60:02d}.{micro:06d}Z"
    assert format_utc(*parse_utc(text)) == text


def test_limits_outside_the_ephemeris() -> None:
    with pytest.raises(BadInput, match="1900 to 2100"):
        instants(parse_utc("2100-12-31T23:59:00Z"), np.array([0.0, 3600.0]))
    with pytest.raises(BadInput, match="finite"):
        instants(parse_utc("2019-04-20T03:00:00Z"), np.array([np.nan]))
