"""Parts of report pages: text stays text, whatever it holds."""

from __future__ import annotations

import base64
import re

from pipeline.report_page import document, picture, table


def test_text_is_never_markup() -> None:
    odd = '<b>a & "b"</b>'
    pages = [table([odd], [["1"]]), table(["x"], [["1", odd]]), picture(b"png", odd),
             document(odd, "<p>its own</p>")]  # fmt: skip
    for page in pages:
        assert "<b>" not in page
        assert "&lt;b&gt;a &amp; &quot;b&quot;&lt;/b&gt;" in page
    assert "<p>its own</p>" in pages[3]


def test_a_table_has_its_cells_in_order() -> None:
    page = table(["x", "y"], [["1", "2"], ["3", "4"]])
    assert re.findall(r"<th>(.*?)</th>", page) == ["x", "y"]
    assert re.findall(r"<td>(.*?)</td>", page) == ["1", "2", "3", "4"]
    assert page.count("<tr>") == 3


def test_a_picture_is_inside_the_page() -> None:
    page = picture(bytes(range(256)), "all bytes")
    (inside,) = re.findall(r'src="data:image/png;base64,([^"]*)"', page)
    assert base64.b64decode(inside) == bytes(range(256))
