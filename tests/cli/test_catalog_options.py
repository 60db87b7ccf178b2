"""`catalog demo`, `fetch`, `ingest`, `cone`, `verify`: every option reaches what does the work."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from catalog_tools.fetch.fetch import FetchReport
from catalog_tools.verify.verify import VerifyReport
from pipeline.cli import app
from pipeline.commands.catalog import make
from pipeline.errors import BadInput

HERE = Path("x")
DEMO, FETCH, LOOK, MAKE = (
    f"pipeline.commands.catalog.{name}" for name in ("demo", "fetch", "look", "make")
)
CORNERS = [(1.0, 2.0), (3.0, 4.0), (5.0, 0.0)]
SAMPLE = {"seed": 2, "workers": 2, "overwrite": False}
SKY = SAMPLE | {"faintest_g_mag": 10.0, "deep_fields": []}
FILES = {"cones": [], "everything": True, "base_url": None, "tap_url": None, "verify": False,
         "faintest_g_mag": None, "connections": 4}  # fmt: skip
INGEST = {"form": None, "name": None, "rows_per_leaf": 1_000_000, "memory_bytes": 2 << 30,
          "scheduler": ("threads", None), "overwrite": False, "restart": False}  # fmt: skip
CASES = {
    "a sample": (f"{DEMO}.make_sample", "demo -o x --rows 100", (HERE, 100), SAMPLE),
    "options of a sample": (
        f"{DEMO}.make_sample", "demo -o x --rows 9 --seed 7 --workers 1 --overwrite",
        (HERE, 9), {"seed": 7, "workers": 1, "overwrite": True},
    ),
    "the sky": (f"{DEMO}.make_demo", "demo -o x", (HERE,), SKY),
    "options of the sky": (
        f"{DEMO}.make_demo",
        "demo -o x --faintest 6 --field 1,-2,0.5,17 --seed 7 --workers 3 --overwrite", (HERE,),
        {"seed": 7, "workers": 3, "overwrite": True, "faintest_g_mag": 6.0,
         "deep_fields": [(1.0, -2.0, 0.5, 17.0)]},
    ),
    "files of a sample": (
        f"{DEMO}.write_csv_files", "demo -o x --rows 9 --as-csv --seed 7 --workers 3",
        (HERE, 9), {"seed": 7, "workers": 3},
    ),
    "plain files": (f"{DEMO}.write_csv_files", "demo -o x --rows 9 --as-csv", (HERE, 9),
                    {"seed": 2, "workers": None}),
    "the archive": (f"{FETCH}.run", "fetch gaia-dr2 --dest x --all", ("gaia-dr2", HERE), FILES),
    "options of the archive": (
        f"{FETCH}.run",
        "fetch gaia-dr3 --dest x --cone 1,2,3 --cone 4,5,6,7 --base-url http://m --tap archive"
        " --faintest 9 --connections 3 --verify", ("gaia-dr3", HERE),
        {"cones": ["1,2,3", "4,5,6,7"], "everything": False, "base_url": "http://m",
         "tap_url": "archive", "verify": True, "faintest_g_mag": 9.0, "connections": 3},
    ),
    "ingest": (f"{MAKE}.run", "ingest a b -o x", ([Path("a"), Path("b")], HERE), INGEST),
    "options of ingest": (
        f"{MAKE}.run",
        "ingest a -o x --form f --name n --rows-per-leaf 5 --memory 500MB --scheduler processes"
        " --workers 3 --restart --overwrite", ([Path("a")], HERE),
        {"form": "f", "name": "n", "rows_per_leaf": 5, "memory_bytes": 500_000_000,
         "scheduler": ("processes", 3), "overwrite": True, "restart": True},
    ),
    "ingest anew": (f"{MAKE}.run", "ingest a -o x --restart", ([Path("a")], HERE),
                    INGEST | {"restart": True}),
    "ingest in its place": (f"{MAKE}.run", "ingest a -o x --overwrite", ([Path("a")], HERE),
                            INGEST | {"overwrite": True}),
    "a cone": (f"{LOOK}.query.cone", "cone y --ra 1 --dec=-2 --radius 3",
               ("opened y", 1.0, -2.0, 3.0, None, None), {}),
    "options of a cone": (
        f"{LOOK}.query.cone", "cone y --ra 1 --dec=-2 --radius 3 --faintest 9 --epoch 2031.5",
        ("opened y", 1.0, -2.0, 3.0, 9.0, 2031.5), {},
    ),
    "a polygon": (
        f"{LOOK}.query.polygon", "cone y --corner 1,2 --corner 3,4 --corner 5,0",
        ("opened y", CORNERS, None, None), {},
    ),
    "options of a polygon": (
        f"{LOOK}.query.polygon",
        "cone y --corner 1,2 --corner 3,4 --corner 5,0 --faintest 9 --epoch 2031.5",
        ("opened y", CORNERS, 9.0, 2031.5), {},
    ),
    "verify": ("pipeline.commands.catalog.prove.run", "verify y --workers 3", ("opened y",),
               {"workers": 3}),
    "starlight": (f"{MAKE}.make_starlight", "starlight y --order 5 --workers 3", ("opened y",),
                  {"order": 5, "scheduler": ("threads", 3)}),
}  # fmt: skip


class Called(Exception):
    """What the work was called with."""


class At:
    """A scheduler that is not opened."""

    def __init__(self, *asked):
        self.asked = asked

    def __enter__(self):
        return self.asked

    def __exit__(self, *_):
        pass


@pytest.mark.parametrize(("target", "words", "given", "named"), CASES.values(), ids=CASES.keys())
def test_options_reach_the_work(monkeypatch, target, words, given, named):
    def work(*args, progress=None, **options):
        raise Called(args, options)

    for module in ("look", "make", "prove"):
        name = f"pipeline.commands.catalog.{module}.open_catalogue"
        monkeypatch.setattr(name, lambda place: f"opened {place}")
    monkeypatch.setattr(f"{MAKE}.open_scheduler", At)
    monkeypatch.setattr(target, work)
    result = CliRunner().invoke(app, ["catalog", *words.split()])
    assert isinstance(result.exception, Called), result.output
    assert result.exception.args == (given, named)


@pytest.mark.parametrize("notes", [(), ("extra files were not looked for",)])
@pytest.mark.parametrize("as_json", [False, True])
def test_what_verify_could_not_look_at_is_told(monkeypatch, notes, as_json):
    """At a terminal only where there is something to tell."""
    prove = "pipeline.commands.catalog.prove"
    monkeypatch.setattr(f"{prove}.open_catalogue", Path)
    monkeypatch.setattr(f"{prove}.run", lambda *_, **__: VerifyReport("y", 1, 1, 9, 99, (), notes))
    words = ["catalog", "verify", "y", *(["--json"] if as_json else [])]
    told = CliRunner().invoke(app, words).stdout
    if as_json:
        assert json.loads(told)["notes"] == list(notes)
    else:
        assert [note in told for note in ("notes", *notes)] == [bool(notes)] * (1 + len(notes))


@pytest.mark.parametrize("as_json", [False, True])
def test_what_a_fetch_brought_is_told_as_a_count_and_its_notes(monkeypatch, as_json):
    report = FetchReport("gaia-dr2", "x", ("a", "b"), 1, 10, 1, 20, ("one cone is empty",))
    monkeypatch.setattr(f"{FETCH}.run", lambda *_, **__: report)
    words = ["catalog", "fetch", "gaia-dr2", "--dest", "x", "--all"]
    done = CliRunner().invoke(app, [*words, *(["--json"] if as_json else [])])
    assert done.exit_code == 0, done.output
    assert "one cone is empty" in done.stderr
    if as_json:
        told = json.loads(done.stdout)
        assert (told["files"], told["downloaded"], told["present"]) == (2, 1, 1)
    else:
        lines = {tuple(line.split()) for line in done.stdout.splitlines()}
        assert {("files", "2"), ("bytes_downloaded", "10"), ("bytes_present", "20")} <= lines


def test_a_sample_is_told_and_its_stars_come_to_the_screen_as_to_a_file(tmp_path):
    def run(*words):
        done = CliRunner().invoke(app, ["catalog", *map(str, words)])
        assert done.exit_code == 0, done.output
        return done

    made = ("--rows", "300", "--workers", "1", "--json", "-o")
    told = json.loads(run("demo", "--as-csv", *made, tmp_path / "files").stdout)
    assert (told["files"], told["rows"]) == (1, 300)
    assert told["bytes"] == sum(path.stat().st_size for path in tmp_path.glob("files/*.csv.gz"))
    assert json.loads(run("demo", *made, tmp_path / "sky").stdout)["rows_in"] == 300
    cone = ("cone", tmp_path / "sky", "--ra", 1, "--dec", 2, "--radius", 60)
    run(*cone, "-o", tmp_path / "stars.csv")
    shown = run(*cone)
    assert shown.stdout_bytes == (tmp_path / "stars.csv").read_bytes()
    rows = len(shown.stdout.splitlines()) - 1
    assert shown.stderr.startswith(f"{rows} stars of ")


@pytest.mark.parametrize("text", ["GiB", "", " ", "-1GiB", "much", "2 apples", "1e999GB", "nan"])
def test_sizes_that_are_none_are_refused(text):
    with pytest.raises(BadInput, match="--memory"):
        make._bytes(text)


@pytest.mark.parametrize(("text", "size"), [("2GiB", 2 << 30), ("500 MB", 500_000_000), ("7", 7)])
def test_sizes(text, size):
    assert make._bytes(text) == size
