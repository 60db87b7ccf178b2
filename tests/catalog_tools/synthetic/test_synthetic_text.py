"""Numbers with the archive's digits: what is printed is what every parser reads."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from catalog_tools.synthetic.text import (
    DOUBLE,
    NAME,
    NO_WHOLE,
    SINGLE,
    TEXT,
    WHOLE,
    as_printed,
    rows_of_text,
)


def fields(kind, values, texts=("",)):
    columns = [values, np.arange(values.size)]
    lines = bytes(rows_of_text([kind, WHOLE], columns, texts)).decode().splitlines()
    assert [line.split(",")[1] for line in lines] == [str(i) for i in range(values.size)]
    return [line.split(",")[0] for line in lines]


def test_digits_of_the_archive():
    values = np.array(
        [0.0, -0.0, 0.5, -12.25, 2015.5, 947.8486560009569, 18.24652, 100.0, 1e-3, 9.1e-4, -1.5e-7,
         9999999.0, 1e7, 1.25e8, 0.9999999999999999, np.nan]
    )  # fmt: skip
    assert fields(DOUBLE, values) == [
        "0", "-0", "0.5", "-12.25", "2015.5", "947.848656000957", "18.24652", "100", "0.001",
        "0.00091", "-1.5e-7", "9999999", "10000000", "125000000", "1", "",
    ]  # fmt: skip
    singles = np.array([0.84502834, 0.047001234567, 393.0714123, 4.9999999999, 123456.789])
    assert fields(SINGLE, singles) == ["0.84502834", "0.047001235", "393.07141", "5", "123456.79"]


def test_integers_names_and_texts():
    wholes = np.array([0, 7, 10, 1635721458409799680, NO_WHOLE])
    assert fields(WHOLE, wholes) == ["0", "7", "10", "1635721458409799680", ""]
    assert fields(NAME, wholes[:4], ["Gaia "])[3] == "Gaia 1635721458409799680"
    assert fields(TEXT, np.array([0, 2, 1]), ["", "false", "NOT_AVAILABLE"]) == [
        "", "NOT_AVAILABLE", "false",
    ]  # fmt: skip


@given(arrays(np.float64, 40, elements=st.floats(-1e12, 1e12)), st.sampled_from([DOUBLE, SINGLE]))
def test_what_is_printed_is_what_is_read(values, kind):
    read = np.array([float(text) for text in fields(kind, values)])
    assert (read == as_printed(values, kind)).all()
    wide = np.abs(values) > 1e-5
    error = 6e-16 if kind == DOUBLE else 6e-8
    big = np.maximum(np.abs(values), 9e7 if kind == SINGLE else 0.0)
    assert (np.abs(read - values)[wide] <= error * big[wide]).all() or (
        np.abs(read - values)[wide] <= error * np.abs(values)[wide]
    ).all()
