"""`catalog demo`: every option reaches what makes the stars."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from pipeline.cli import app


class Taken(Exception):
    """What a maker was called with."""


@pytest.mark.parametrize(
    ("words", "maker", "given", "named"),
    [
        (["--rows", "100"], "make_sample", (Path("x"), 100),
         {"seed": 2, "workers": 2, "overwrite": False}),
        (["--rows", "100", "--seed", "7", "--workers", "1", "--overwrite"], "make_sample",
         (Path("x"), 100), {"seed": 7, "workers": 1, "overwrite": True}),
        (["--field", "1,-2,0.5,17", "--workers", "3"], "make_demo", (Path("x"),),
         {"seed": 2, "workers": 3, "overwrite": False, "faintest_g_mag": 10.0,
          "deep_fields": [(1.0, -2.0, 0.5, 17.0)]}),
        (["--faintest", "6", "--seed", "7", "--overwrite"], "make_demo", (Path("x"),),
         {"seed": 7, "workers": 2, "overwrite": True, "faintest_g_mag": 6.0, "deep_fields": []}),
        (["--rows", "100", "--as-csv", "--seed", "7", "--workers", "3"], "write_csv_files",
         (Path("x"), 100), {"seed": 7, "workers": 3}),
    ],
    ids=("a sample", "its options", "a field", "the sky", "files"),
)  # fmt: skip
def test_options_reach_the_stars(monkeypatch, words, maker, given, named):
    def made(*args, progress, **options):
        raise Taken(args, options)

    monkeypatch.setattr(f"pipeline.commands.catalog.demo.{maker}", made)
    result = CliRunner().invoke(app, ["catalog", "demo", "-o", "x", *words])
    assert isinstance(result.exception, Taken), result.output
    args, options = result.exception.args
    options = {k: [tuple(f) for f in v] if k == "deep_fields" else v for k, v in options.items()}
    assert (args, options) == (given, named)
