"""The documentation builds without a warning, offline, and describes every field and command."""

from __future__ import annotations

import logging
import re
import shutil
from html import unescape
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site's folder; a warning fails the build, as `mkdocs build --strict` has it."""
    pytest.importorskip("material")
    pytest.importorskip("mkdocstrings_handlers.python")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    warned = []

    class Listener(logging.Handler):
        def emit(self, record):
            warned.append(record.getMessage())

    listener = Listener(logging.WARNING)
    logging.getLogger("mkdocs").addHandler(listener)
    folder = tmp_path_factory.mktemp("site") / "site"
    try:
        build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder)))
    finally:
        logging.getLogger("mkdocs").removeHandler(listener)
    assert not warned
    return folder


@pytest.fixture
def reference(monkeypatch):
    """The module that makes the reference pages."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "tools"))
    import reference

    return reference


def _formats():
    """The page and the schemas of each file format."""
    from pipeline.spec.scene import Scene
    from pipeline.spec.study import Study
    from pipeline.spec.sweep import Sweep

    for page, model in (("scene", Scene), ("sweep", Sweep), ("study", Study)):
        schema = model.model_json_schema(by_alias=True)
        yield page, {model.__name__: schema} | schema["$defs"]


def test_every_field_is_described(site):
    """On the page of its format, or where a study has it from: the page of a scene or a sweep."""
    pages = {}
    for page, models in _formats():
        pages[page] = unescape((site / "reference" / f"{page}.html").read_text())
        for name, model in models.items():
            anchor = f'id="{name.lower()}"'
            text = next(t for t in [pages[page], *pages.values()] if anchor in t)
            section = text.split(anchor, 1)[1].split("<h2", 1)[0]
            for key in model.get("properties", {}):
                assert f"<code>{key}</code>" in section, f"{name}.{key}"


def test_reference_pages_are_not_garbled(reference):
    """What a docstring says of keys stands in tables, and code is as it is typed."""
    pages = (reference.scene_page, reference.sweep_page, reference.study_page)
    for make in (*pages, reference.command_page):
        for line in make().splitlines():
            assert not re.match(r"\S+ : ", line), line
            assert not [code for code in line.split("`")[1::2] if r"\_" in code], line
    accuracy = reference.scene_page().split("## Accuracy\n")[1].split("## ")[0]
    assert accuracy.count("noise_fraction") == 1
    assert reference._escaped("`a_b` c_d") == r"`a_b` c\_d"


def test_exit_codes_are_all_on_the_page(reference):
    from pipeline.errors import EXIT_CODES

    rows = re.findall(r"(?m)^\| (\d+) \|", reference.COMMAND_HEAD)
    assert {0, 1, 5} | {code for _, code in EXIT_CODES} == set(map(int, rows))


def test_every_key_is_described():
    """In the schema, and so in reference, page and editors; and nothing that is no key."""
    from pipeline.spec.keys import DESCRIPTIONS

    keys: set[str] = set()
    texts: set[str] = set()
    for name, model in [pair for _, models in _formats() for pair in models.items()]:
        for key, field in model.get("properties", {}).items():
            assert len(field.get("description", "")) > 1, f"{name}.{key}"
            keys |= {key, f"{name}.{key}"}
            texts.add(field["description"])
    assert set(DESCRIPTIONS) <= keys
    assert set(DESCRIPTIONS.values()) <= texts  # none that a field's own text hides


def test_every_command_is_described(site):
    page = unescape((site / "reference" / "commands.html").read_text())
    for name in ("render", "plan", "export", "import satsim", "report detection", "catalog ingest"):
        assert f"nightglass {name}" in page
    assert "--stars-snr" in page


def test_python_reference_has_signatures(site):
    page = (site / "reference" / "python.html").read_text()
    import nightglass

    functions = [name for name in nightglass.__all__ if name.islower()]
    names = [f"nightglass.{name}" for name in functions] + [
        "pipeline.route.run.render", "pipeline.store.cube.open_cube",
        "service.client.Client.submit", "service.client.RemoteJob.wait",
    ]  # fmt: skip
    for name in names:
        assert f'id="{name}"' in page, name


def test_site_needs_nothing_from_elsewhere(site):
    """No page loads a script, style, font or picture from another host."""
    pages = list(site.rglob("*.html"))
    assert len(pages) > 15
    loads = re.compile(r'(?:src|<link[^>]*href)="(?:https?:)?//([^"/]+)')
    for page in pages:
        text = re.sub(r'<link rel="canonical"[^>]*>', "", page.read_text())
        assert not loads.findall(text), page.name


def test_every_page_is_in_the_navigation(site):
    start = (site / "index.html").read_text()
    for page in site.rglob("*.html"):
        name = page.relative_to(site).as_posix()
        if name != "404.html":
            assert f'href="{name}"' in start or name == "index.html", name


@pytest.mark.parametrize("start", ["index.html", "howto/exports.html"])
def test_the_search_works_from_the_disk(site, start):
    """In Chromium, by file://, with every request to a network refused."""
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
    if path is None:
        pytest.skip("no Chromium here (Debian: apt-get install chromium)")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    asked = []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        page = browser.new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.goto((site / start).as_uri())
        page.locator(".md-search__input").click()
        page.locator(".md-search__input").press_sequentially("kolmogorov")
        found = page.locator(".md-search-result__link").first
        found.wait_for(timeout=20_000)
        target = page.evaluate("link => link.href", found.element_handle())
        page.goto(target)
        assert "kolmogorov" in page.content().lower()
        browser.close()
    assert all(url.startswith(("file:", "data:", "blob:")) for url in asked), asked


STALE = (
    r"\bthe paper\b", r"\bthis version\b", r"no users and no keys", r"dispatcher\.lock",
    r"uniform in this",
)  # fmt: skip


def test_nothing_stale_is_said():
    """Pages, and texts that the product prints, name nothing that is gone or that nobody has."""
    told = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "deploy").rglob("*.md")]
    told += [p for name in ("pipeline", "service", "catalog_tools", "examples")
             for kind in ("*.py", "*.yaml") for p in (ROOT / name).rglob(kind)]  # fmt: skip
    for path in told:
        text = path.read_text()
        for words in STALE:
            found = re.search(words, text)
            allowed = words == r"\bthis version\b" and re.search(r"(Not in|Limits of) this", text)
            assert path.name == "CHANGELOG.md" or not found or allowed, f"{path}: {found}"
