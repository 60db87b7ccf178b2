"""The web page in headless Chromium: submit, watch, look, compare coordinates; and its files."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from catalog_tools.synthetic.synthetic import make_demo
from pipeline.spec.load import parse_scene, scene_yaml
from tests.capacity.conftest import SMALL

SHOWN = "canvas.sky[data-tiles]:not([data-tiles='0'])"  # at least one tile is on the canvas
PAGE = Path(__file__).parents[2] / "service" / "page"
KEEP = os.environ.get("NIGHTGLASS_SCREENSHOTS")  # a folder for the pictures of docs/


def _width_px(tab: Any, selector: str) -> int:
    """Width of the first such image, once it is loaded."""
    image = "async image => { await image.decode(); return image.naturalWidth; }"
    return int(tab.locator(selector).first.evaluate(image))


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
                None)  # fmt: skip
    if path is None:
        pytest.skip("no Chromium here (Debian: apt-get install chromium)")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


class Page:
    """A page that notes every fault: of scripts, of the policy, of answers."""

    def __init__(self, browser: Any, url: str, **options: Any) -> None:
        self.url, self.faults = url, []  # type: ignore[var-annotated]
        context = browser.new_context(viewport={"width": 1440, "height": 900}, **options)
        self.tab = context.new_page()
        self.tab.set_default_timeout(60_000)
        self.tab.on("pageerror", lambda e: self.faults.append(f"script: {e}"))
        self.tab.on("console", self._said)

    def _said(self, message: Any) -> None:
        if message.type == "error":
            self.faults.append(f"{message.text} {message.location.get('url', '')}")

    def open(self, where: str = "") -> Any:
        self.tab.goto(f"{self.url}/{where}")
        return self.tab

    def leave(self) -> None:
        """Nothing is asked for any more: what the page looked at may be deleted."""
        self.tab.goto("about:blank")

    def picture(self, name: str) -> None:
        if KEEP:
            self.tab.screenshot(path=Path(KEEP) / f"{name}.png")


@pytest.fixture
def page(chromium: Any, server: Any) -> Iterator[Page]:
    page = Page(chromium, server.url, color_scheme="dark")
    yield page
    page.tab.context.close()
    assert page.faults == []


@pytest.fixture(scope="module")
def field(server: Any) -> str:
    """The path of a completed job with stars and a target, of four tiles."""
    folder = server.home / "catalogues" / "field"
    make_demo(folder, faintest_g_mag=5.0, deep_fields=[(276.0, -3.4, 0.8, 14.5)])
    from tests.service.conftest import SCENE

    scene = json.loads(json.dumps(SCENE))
    scene |= {"name": "field", "epoch": "2019-07-20T09:00:00Z"}
    scene["sensor"] |= {"shape": [512, 512], "pixel_pitch_um": 27.0}
    scene["stars"] = {"catalogue": "field"}
    scene["pointing"] = {"mode": "sidereal", "boresight_ra_deg": 276.0, "boresight_dec_deg": -3.2,
                         "roll_deg": 20.0}  # fmt: skip
    scene["output"] = {"tile_shape": [256, 256], "layers": ["dn", "mean_e"]}
    job = server.submit(scene)
    done = server.ended(job)
    assert done["phase"] == "COMPLETED", done
    return job


def test_submit_by_the_form_and_see_it_drawn(page: Page, server: Any) -> None:
    tab = page.open("#/new")
    tab.wait_for_selector("#submit")
    tab.locator("select[aria-label='start from']").select_option(index=1)
    tab.fill("[data-path='/name'] input", "by-hand")
    for i in (0, 1):
        tab.locator("[data-path='/sensor/shape'] input").nth(i).fill("256")
    for section in ("/stars", "/background"):  # there is one of stars where a catalogue is
        if tab.locator(f"[data-path='{section}']").count():
            tab.locator(f"[data-path='{section}'] .remove").first.click()
    written = json.loads(tab.input_value("#json"))
    assert (written["name"], written["sensor"]["shape"]) == ("by-hand", [256, 256])
    assert "background" not in written
    tab.click("#plan")
    tab.wait_for_selector("#planned")
    assert "3 of 256 × 256 px" in tab.inner_text("#planned")
    page.picture("page-new")
    tab.click("#observe")
    tab.wait_for_selector("#observed")
    assert "geo-1" in tab.inner_text("#observed")
    assert tab.locator("#observed tbody tr").count() == 9  # three targets in three frames
    tab.click("#submit")
    tab.wait_for_selector(".phase.COMPLETED >> nth=0")
    tab.wait_for_selector("[data-target='geo-1']")
    assert "3 of 3 tiles" in tab.inner_text(".jobhead")
    assert "by-hand" in tab.inner_text("#queue")
    [job] = [j for j in server.client.get("/v1/queue").json()["jobs"] if j["name"] == "by-hand"]
    assert job["id"] in tab.url
    assert "by-hand" in tab.title() or tab.title() == "Nightglass"


def test_pasted_json_and_mistakes_beside_their_fields(
    page: Page, scene: dict[str, Any]
) -> None:
    tab = page.open("#/new")
    tab.wait_for_selector("#submit")
    tab.fill("#json", "{")
    assert "not JSON" in tab.inner_text("#main")
    scene["name"] = "pasted"
    scene["sensor"]["aperture_m"] = -1
    tab.fill("#json", json.dumps(scene))
    assert tab.input_value("[data-path='/name'] input") == "pasted"
    tab.click("#plan")
    tab.wait_for_selector("[data-path='/sensor/aperture_m'].wrong")
    assert "/sensor/aperture_m" in tab.inner_text("#answer")
    tab.fill("[data-path='/sensor/aperture_m'] input", "0.5")
    assert json.loads(tab.input_value("#json"))["sensor"]["aperture_m"] == 0.5
    page.faults[:] = [f for f in page.faults if "422" not in f]  # the refusal itself


def test_yaml_in_the_editor_fills_the_form(page: Page, server: Any, scene: dict[str, Any]) -> None:
    tab = page.open("#/new")
    tab.wait_for_selector("#submit")
    tab.fill("#json", scene_yaml(parse_scene(scene | {"name": "from-yaml"})))
    while tab.input_value("[data-path='/name'] input") != "from-yaml":
        tab.wait_for_timeout(50)
    tab.click("#plan")
    tab.wait_for_selector("#planned")
    tab.click("#submit")
    tab.wait_for_selector(".phase.COMPLETED >> nth=0")
    assert "from-yaml" in tab.inner_text(".jobhead")
    tab = page.open("#/new")
    tab.wait_for_selector("[data-path='/name'] input")
    assert tab.input_value("[data-path='/name'] input") == "from-yaml"  # kept as a draft
    tab.fill("#json", "name: x\nname: y")
    tab.wait_for_selector(".mistake:has-text('not YAML yet')")
    page.faults[:] = [f for f in page.faults if "400" not in f]  # the refusal itself


def test_coordinates_values_truth_and_stretch(page: Page, server: Any, field: str) -> None:
    from astropy.io import fits
    from astropy.wcs import WCS

    tab = page.open(f"#/job/{field.rpartition('/')[2]}")
    tab.wait_for_selector(".columns")
    tab.wait_for_selector(SHOWN)
    image = fits.open(BytesIO(server.client.get(f"{field}/frames/0/fits").content))
    wcs, values = WCS(image[0].header), image[0].data
    box = tab.locator("canvas.sky").bounding_box()
    side = min(box["width"], box["height"]) / 512
    for x, y in ((100.0, 400.0), (480.0, 20.0)):
        left = box["x"] + box["width"] / 2 + (x - 255.5) * side
        top = box["y"] + box["height"] / 2 - (y - 255.5) * side
        tab.mouse.move(left, top)
        told = tab.locator("#radec")
        at = [float(v) for v in tab.inner_text(".readout span >> nth=0").split()[1::2]]
        assert at == pytest.approx([x, y], abs=1.0)
        shown = [float(told.get_attribute(f"data-{n}")) for n in ("ra", "dec")]
        # the pixel is shown rounded to 0.01 px: 0.0003 arcsec more than that
        assert shown == pytest.approx([float(v) for v in wcs.all_pix2world(*at, 0)], abs=2e-5)
        value = float(tab.inner_text(".readout span >> nth=1").split()[0])
        assert value == values[round(at[1]), round(at[0])]
    before = tab.locator("canvas.sky").screenshot()
    tab.check("#show-stars")
    with_stars = tab.locator("canvas.sky").screenshot()
    assert with_stars != before
    tab.keyboard.press("Escape")
    tab.locator("canvas.sky").focus()
    for key in ("s", "i", "+", "t", "ArrowLeft", "0", ".", "l"):
        tab.keyboard.press(key)
    assert tab.input_value("select[aria-label='stretch']") == "linear"
    assert "2 of 2" in tab.inner_text(".panel")
    tab.wait_for_selector("canvas.sky[data-tiles='4']")
    tab.locator("select[aria-label='layer']").select_option("mean_e")
    tab.wait_for_selector(SHOWN)


def geo(name: str, position_m: list[float], velocity_m_s: list[float]) -> dict[str, Any]:
    orbit = {"kind": "state", "position_m": position_m, "velocity_m_s": velocity_m_s}
    return {"name": name, "orbit": orbit,
            "body": {"kind": "sphere", "diameter_m": 4.0, "albedo": 0.25}}  # fmt: skip


@pytest.mark.slow
def test_tiles_appear_while_it_is_drawn(
    page: Page, server: Any, field: str, scene: dict[str, Any]
) -> None:
    scene |= {
        "name": "geo-rate-track", "epoch": "2019-07-20T09:00:00Z", "stars": {"catalogue": "field"},
        "pointing": {"mode": "target", "target": "geo-1"},
        "output": {"tile_shape": [256, 256]},
        "exposure": {"integration_s": 3.0, "frames": 3, "cadence_s": 10.0},
        "targets": [
            geo("geo-1", [4407338.1, -41933005.2, -36593.5], [3057.8229, 321.39, 0.2805]),
            geo("geo-2", [4663629.8, -41907301.3, -14628.4], [3055.7302, 340.0551, 0.1187]),
            geo("geo-3", [4270157.1, -41957767.6, 140299.8], [3058.476, 311.27, 60.0]),
        ],
    }  # fmt: skip
    scene["sensor"] |= {"shape": [768, 768], "pixel_pitch_um": 20.0, "gain_e_per_dn": 1.5}
    job = server.submit(scene)
    tab = page.open(f"#/job/{job.rpartition('/')[2]}")
    tab.wait_for_selector("canvas.sky")  # from the first tile on
    tab.wait_for_selector(SHOWN)
    tab.wait_for_selector(".phase.COMPLETED >> nth=0")
    tab.wait_for_selector("[data-target='geo-3']")
    tab.wait_for_selector("canvas.sky[data-tiles='9']")
    assert "27 of 27 tiles" in tab.inner_text(".jobhead")
    tab.locator("[data-target='geo-1']").hover()
    box = tab.locator("canvas.sky").bounding_box()
    tab.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert "geo-1" in tab.inner_text(".readout .near")
    page.picture("page")
    tab.click("[data-target='geo-2']")
    tab.check("#show-stars")
    tab.wait_for_timeout(500)
    page.picture("page-zoom")


def test_a_sweep_shows_what_it_measured_and_is_asked_for_no_picture(
    page: Page, server: Any, scene: dict[str, Any]
) -> None:
    sweep = {
        "schema": "nightglass/sweep/1", "name": "two", "scene": scene,
        "axes": [{"field": "sensor.read_noise_e", "values": [1.0, 4.0]}],
    }  # fmt: skip
    made = server.client.post("/v1/sweeps", json=sweep)
    assert made.status_code == 202, made.text
    job = made.headers["location"]
    done = server.ended(job)
    assert set(done["links"]) == {"self", "events", "scene", "results", "report"}
    asked: list[str] = []
    page.tab.on("request", lambda request: asked.append(request.url))
    tab = page.open(f"#/job/{done['id']}")
    tab.wait_for_selector("#sweep [data-metric='snr.sat-1']")
    assert "2 of 2 points" in tab.inner_text(".jobhead")
    assert "2 points over sensor.read_noise_e: 0 failed" in tab.inner_text("#sweep")
    assert [url for url in asked if job in url and "preview" in url] == []
    assert [url for url in asked if f"{job}/frames" in url or f"{job}/plan" in url] == []
    with tab.expect_download() as begun:
        tab.click("summary.button")
        tab.get_by_text("table of points").click()
    assert Path(begun.value.path()).read_bytes().startswith(b"PAR1")


def test_a_study_is_opened_forecast_submitted_and_shown(
    page: Page, server: Any, tmp_path: Path
) -> None:
    """As YAML, which the service reads for the page."""
    file = tmp_path / "study.yaml"
    file.write_text(yaml.safe_dump(SMALL | {"name": "of-the-page", "duration_h": 1.0}))
    asked: list[str] = []
    page.tab.on("request", lambda request: asked.append(request.url))
    tab = page.open("#/new")
    tab.wait_for_selector(".form .field")
    tab.set_input_files("#file", file)
    tab.wait_for_selector("#text-alone")
    assert not tab.is_visible("#observe")
    tab.click("#plan")
    tab.wait_for_selector("#forecast")
    told = tab.inner_text("#forecast").split("\n")
    assert (told[told.index("objects") + 1], told[told.index("steps") + 1]) == ("60", "60")
    tab.click("#submit")
    tab.wait_for_selector("#study [data-group='LEO']")
    job = server.client.get("/v1/queue").json()["jobs"][0]
    assert (job["kind"], job["name"]) == ("study", "of-the-page")
    report = server.client.get(f"{job['links']['report']}").json()
    shown = tab.inner_text("#study")
    assert f"60 objects for 1 h from {report['start']}" in shown
    assert f"{report['figures']['observations']} observations" in shown
    assert report["notes"]
    assert all(note in shown for note in report["notes"])
    cells = tab.locator("#study [data-group='LEO'] td").all_inner_texts()
    assert cells[1] == str(report["by_regime"]["LEO"]["objects"])
    assert [url for url in asked if job["id"] in url and ("frames" in url or "plan" in url)] == []
    assert _width_px(tab, "#study img") > 500
    with tab.expect_download() as begun:
        tab.click("summary.button")
        tab.get_by_text("report with figures").click()
    assert b"Gap time by orbit" in Path(begun.value.path()).read_bytes()
    page.picture("page-study")


def test_a_study_with_axes_shows_the_figures_of_each_point(page: Page, server: Any) -> None:
    """Whatever kind of value an axis has."""
    axes = [{"field": "cameras.0.sensor.photon_noise", "values": [True, False]}]
    study = SMALL | {"name": "two", "duration_h": 0.5, "axes": axes}
    made = server.client.post("/v1/studies", json=study)
    assert made.status_code == 202, made.text
    done = server.ended(made.headers["location"])
    report = server.client.get(done["links"]["report"]).json()
    tab = page.open(f"#/job/{done['id']}")
    tab.wait_for_selector("#study [data-point='1']")
    cells = tab.locator("#study [data-point='1'] td").all_inner_texts()
    shown = dict(zip(report["points"][0], cells, strict=True))
    assert shown["detections"] == str(report["points"][1]["detections"])
    assert shown["cameras.0.sensor.photon_noise"] == "false"
    with tab.expect_download() as begun:
        tab.click("summary.button")
        tab.get_by_text("table of points").click()
    assert Path(begun.value.path()).read_bytes().startswith(b"PAR1")


def test_a_sweep_is_submitted_from_its_text(
    page: Page, server: Any, scene: dict[str, Any]
) -> None:
    axes = [{"field": "sensor.read_noise_e", "values": [1.0, 4.0]}]
    sweep = {"schema": "nightglass/sweep/1", "name": "typed", "scene": scene, "axes": axes}
    tab = page.open("#/new")
    tab.wait_for_selector(".form .field")
    tab.fill("#json", json.dumps(sweep))
    tab.wait_for_selector("#text-alone")
    tab.click("#plan")
    tab.wait_for_selector("#planned")
    assert "points" in tab.inner_text("#forecast")
    tab.click("#submit")
    tab.wait_for_selector("#sweep [data-metric='snr.sat-1']")
    assert _width_px(tab, "#sweep img") > 0
    page.picture("page-sweep")


@pytest.mark.slow
def test_unfinished_jobs_show_what_is_drawn(
    page: Page, server: Any, scene: dict[str, Any]
) -> None:
    scene["sensor"]["shape"], scene["exposure"]["frames"] = [1024, 1024], 40
    scene["output"] = {"tile_shape": [256, 256]}
    job = server.submit(scene)
    server.until(job, lambda found: (found["tiles_done"] or 0) > 2)
    server.client.post(f"{job}/cancel")
    assert server.ended(job)["phase"] == "ABORTED"
    about = server.client.get(f"{job}/frames").json()
    assert (about["frames"], about["complete"]) == (40, False)
    frames = [server.client.get(f"{job}/frames/{k}").json() for k in range(40)]
    drawn = {(k, *tile) for k, frame in enumerate(frames) for tile in frame["drawn"]}
    assert 2 < len(drawn) < 640
    assert frames[0]["wcs"] is None
    counts = [len(frame["drawn"]) if len(frame["drawn"]) < 16 else 0 for frame in frames]
    assert counts[about["watch"]] == max(counts)
    for k, row, column in [*sorted(drawn)[:2], (39, 3, 3)]:
        status = 200 if (k, row, column) in drawn else 409
        answer = server.client.get(f"{job}/frames/{k}/tiles/{row}/{column}?bin=4")
        assert answer.status_code == status
    assert server.client.get(f"{job}/frames/0/truth").status_code == 409
    tab = page.open(f"#/job/{job.rpartition('/')[2]}")
    tab.wait_for_selector(".phase.ABORTED >> nth=0")
    tab.wait_for_selector(SHOWN)
    page.picture("page-unfinished")
    page.leave()
    server.client.delete(job)


def test_curl_on_the_page_fetches_the_product(page: Page, server: Any, field: str) -> None:
    tab = page.open(f"#/job/{field.rpartition('/')[2]}")
    tab.wait_for_selector(".snippets pre")
    text = tab.inner_text(".snippets pre")
    assert f"{server.url}{field}/product.tar" in text
    with tab.expect_download() as begun:
        tab.click("summary.button")
        tab.get_by_text("this frame, FITS").click()
    assert Path(begun.value.path()).read_bytes().startswith(b"SIMPLE")


@pytest.fixture
def with_key(chromium: Any, make_server: Any, scene: dict[str, Any]) -> Iterator[tuple[Any, Any]]:
    """A server of keys with a finished job, and a tab that shows it with its team's key."""
    server = make_server()
    [key] = server.make_keys("red")
    server.client.headers["authorization"] = f"Bearer {key}"
    job = server.submit(scene | {"name": "night-17.GEO"})
    assert server.ended(job)["phase"] == "COMPLETED"
    page = Page(chromium, server.url)
    page.tab.add_init_script(f"sessionStorage.setItem('nightglass-key', '{key}')")
    page.open(f"#/job/{job.rpartition('/')[2]}")
    yield server, page.tab
    page.tab.context.close()
    assert page.faults == []


def test_every_download_works_with_a_key(with_key: tuple[Any, Any]) -> None:
    """Each is named after its job, and made by the browser itself, piece by piece."""
    server, tab = with_key
    job = tab.url.rpartition("/")[2]
    wanted = {
        "product, .tar": (".tar", b"night-17.GEO-"),
        "this frame, FITS": (".fits", b"SIMPLE"),
        "targets' truth, Parquet": ("-targets.parquet", b"PAR1"),
        "report, JSON": ("-report.json", b"{"),
    }

    def download(press: Any) -> tuple[str, bytes]:
        with tab.expect_download() as begun:
            press()
        assert begun.value.url.startswith(f"{server.url}/v1/jobs/{job}/")
        return begun.value.suggested_filename, Path(begun.value.path()).read_bytes()

    tab.click("summary.button")
    for text, (ending, content) in wanted.items():
        name, got = download(tab.get_by_text(text, exact=True).click)
        assert name.startswith(f"night-17.GEO-{job[:8]}"), name
        assert (name.endswith(ending), got.startswith(content)) == (True, True), name
    tab.get_by_text("all files").click()
    tab.wait_for_selector("[data-file='scene.yaml']")
    listed = tab.locator("[data-file]").evaluate_all("rows => rows.map(r => r.dataset.file)")
    files = server.client.get(f"/v1/jobs/{job}/results").json()["files"]
    assert listed == [f["path"] for f in files if not f["path"].startswith("cube.zarr/")]
    name, got = download(tab.locator("[data-file='scene.yaml'] button").click)
    assert name == f"night-17.GEO-{job[:8]}-scene.yaml"
    assert got == server.client.get(f"/v1/jobs/{job}/results/scene.yaml").content


def test_what_a_cancelled_job_keeps_is_told(
    page: Page, server: Any, scene: dict[str, Any]
) -> None:
    scene["sensor"]["shape"], scene["exposure"]["frames"] = [640, 640], 100
    job = server.submit(scene)
    server.until(job, lambda found: (found["tiles_done"] or 0) > 2)
    server.client.post(f"{job}/cancel")
    ended = server.ended(job)
    folder = server.home / "products" / ended["id"]
    assert ended["bytes_kept"] == sum(f.lstat().st_size for f in folder.rglob("*") if f.is_file())
    tab = page.open(f"#/job/{ended['id']}")
    tab.wait_for_selector(".phase.ABORTED >> nth=0")
    assert "MB kept" in tab.inner_text(".jobhead")
    page.leave()
    server.client.delete(job)


def test_a_slow_press_of_cancel_counts(page: Page, server: Any, scene: dict[str, Any]) -> None:
    """Its button keeps the click and the focus while tiles are drawn."""
    scene["sensor"]["shape"], scene["exposure"]["frames"] = [640, 640], 600
    job = server.submit(scene)
    tab = page.open(f"#/job/{job.rpartition('/')[2]}")
    tab.wait_for_selector("canvas.sky")
    button = tab.get_by_role("button", name="Cancel")
    button.focus()
    box, began = button.bounding_box(), tab.inner_text(".jobhead .num")
    tab.mouse.move(box["x"] + 5, box["y"] + 5)
    tab.mouse.down()
    while tab.inner_text(".jobhead .num").split(",")[0] == began.split(",")[0]:
        tab.wait_for_timeout(20)
    assert tab.evaluate("document.activeElement.textContent") == "Cancel"
    tab.mouse.up()
    tab.wait_for_selector(".phase.ABORTED >> nth=0")
    page.leave()
    server.client.delete(job)


def test_a_view_that_was_left_does_not_come_back(page: Page, server: Any, field: str) -> None:
    """An answer that comes late is not shown in place of what was opened meanwhile."""
    held: list[Any] = []
    views = {f"#/job/{field.rpartition('/')[2]}": field, "#/new": "/v1/schema/scene"}
    for left, other in (tuple(views), tuple(views)[::-1]):
        tab = page.open()
        tab.wait_for_selector(".jobhead, #submit")
        tab.goto("about:blank")
        tab.route(f"**{views[left]}", lambda route: held.append(route))
        tab = page.open(left)
        while not held:
            tab.wait_for_timeout(20)
        tab.goto(f"{server.url}/{other}")
        shown = tab.wait_for_selector(".columns" if "job" in other else "#submit")
        held.pop().continue_()
        tab.unroute(f"**{views[left]}")
        tab.wait_for_timeout(500)
        assert shown.is_visible(), other
        assert tab.locator("h1").count() == 1


def test_that_there_are_no_jobs_stays_told(chromium: Any, make_server: Any) -> None:
    page = Page(chromium, make_server().url)
    tab = page.open("#/new")
    tab.wait_for_selector("#queue .none")
    with tab.expect_response("**/v1/usage"):  # the list is asked for again
        pass
    tab.wait_for_timeout(200)
    assert tab.inner_text("#queue") == "no jobs yet"
    tab.context.close()
    assert page.faults == []


def test_a_service_that_refuses_is_not_told_to_be_silent(page: Page) -> None:
    told = {"detail": "the job table is locked", "status": 503}
    tab = page.open("#/new")
    tab.wait_for_selector("#ready.up")
    tab.route("**/v1/usage", lambda route: route.fulfill(status=503, json=told))
    tab.wait_for_selector("#ready.down:has-text('the job table is locked')")
    tab.route("**/v1/usage", lambda route: route.abort())
    tab.wait_for_selector("#ready.down:has-text('no answer from the service')")
    page.faults[:] = [f for f in page.faults if "/v1/usage" not in f]


def test_a_key_that_no_header_can_hold(chromium: Any, make_server: Any) -> None:
    server = make_server()
    server.make_keys("red")
    page = Page(chromium, server.url)
    tab = page.open()
    tab.fill("#keyvalue", "ng_\u201csmart\u201d\u2026")
    tab.keyboard.press("Enter")
    tab.wait_for_selector(".card.bad:has-text('the API key is not valid')")
    assert tab.inner_text("#ready") == "a key is needed"
    tab.context.close()
    assert [fault for fault in page.faults if "401" not in fault] == []


def test_text_that_no_form_or_draft_can_hold(page: Page, scene: dict[str, Any]) -> None:
    """It is planned and refused as any other."""
    tab = page.open("#/new")
    tab.wait_for_selector("#submit")
    for wrong, told in (
        ({"exposure": 5}, "/exposure"), ({"name": "x" * 6_000_000}, "a body of at most"),
    ):  # fmt: skip
        tab.fill("#json", json.dumps(scene | wrong))
        tab.click("#plan")
        tab.wait_for_selector(f"#answer .bad:has-text('{told}')")
        assert tab.inner_text("p.mistake[role=alert]") == ""
    page.faults[:] = [f for f in page.faults if "422" not in f and "413" not in f]


def test_a_finished_job_fits_a_phone(page: Page, field: str) -> None:
    tab = page.open()
    tab.set_viewport_size({"width": 390, "height": 844})
    tab.goto(f"{page.url}/#/job/{field.rpartition('/')[2]}")
    tab.wait_for_selector(".columns")
    tab.click("summary.button")
    tab.click(".columns summary")
    for box in (".menu > div", ".columns > div >> nth=0", ".columns > div >> nth=1"):
        at = tab.locator(box).bounding_box()
        assert at["x"] >= 0, box
        assert at["x"] + at["width"] <= 390, box
    for summary in ("summary.button", ".columns summary"):
        mark = "e => getComputedStyle(e, '::before').content"
        assert tab.locator(summary).evaluate(mark) == "none"


WORDS = [
    ("seconds", [9.96], "10 s"), ("seconds", [0.04], "0.0 s"), ("seconds", [59.4], "59 s"),
    ("seconds", [59.6], "1 min 0 s"), ("seconds", [119.7], "2 min 0 s"),
    ("seconds", [3599.8], "1 h 0 min"), ("seconds", [7199.9], "2 h 0 min"),
    ("amount", [999], "999 B"), ("amount", [999_499], "999 kB"), ("amount", [999_999], "1 MB"),
    ("dms", [-1e-7], "+00°00′00.00″"), ("dms", [-0.5], "−00°30′00.00″"),
    ("countsOf", [{"EXECUTING": 2, "QUEUED": 300, "PENDING": 1}], "2 running, 301 waiting"),
    ("moreOf", [{"COMPLETED": 198, "EXECUTING": 2}, 200], ""),
    ("moreOf", [{"COMPLETED": 249, "EXECUTING": 2}, 200],
     "the newest 200 of 251 are shown, and all that run"),
    ("hiddenBy", [{"hidden_by": "earth", "visible_fraction": 0}], "earth"),
    ("hiddenBy", [{"hidden_by": "earth", "visible_fraction": 0.2}], None),
    ("hiddenBy", [{"hidden_by": None, "visible_fraction": 1}], None),
]  # fmt: skip


def test_words_of_the_page() -> None:
    """Its formatting alone, without a browser."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node here")
    sources = "".join((PAGE / name).read_text() for name in ("dom.js", "wcs.js"))
    calls = ",".join(f"{name}(...{json.dumps(given)})" for name, given, _ in WORDS)
    code = f"{sources}\nconsole.log(JSON.stringify([{calls}]))"
    command = [node, "--input-type=module", "-e", code]
    told = subprocess.run(command, capture_output=True, check=True)
    assert json.loads(told.stdout) == [wanted for *_, wanted in WORDS]


def test_cuts_of_a_tile_with_masked_pixels() -> None:
    """Pixels that are no number have no part in them; where all are masked they are still cuts."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node here")
    code = (PAGE / "stretch.js").read_text() + """
      const told = [0.02, 1].map((share) => {
        const tile = Float32Array.from({ length: 4000 }, (_, i) => i < 4000 * share ? NaN : i);
        const s = new Stretch();
        s.measure([tile]);
        return [s.low, s.high, s.soft, ...s.range, s.counts.reduce((a, b) => a + b)];
      });
      console.log(JSON.stringify(told));"""
    command = [node, "--input-type=module", "-e", code]
    told = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    for low, high, soft, least, most, count in told:
        assert least <= low < high <= most or (low, count) == (0, 1)
        assert 0 < soft <= 1
    assert told[0][-1] == 0.98 * 4000


def test_the_page_answers_head(server: Any) -> None:
    for path in ("/", "/page/app.js"):
        head, whole = server.client.head(path), server.client.get(path)
        assert (head.status_code, head.content) == (200, b"")
        assert head.headers["content-length"] == str(len(whole.content))


def test_the_policy_lets_nothing_else_in(server: Any) -> None:
    front = server.client.get("/")
    policy = front.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "script-src 'self'" in policy
    assert "img-src 'self' blob:" in policy  # pictures that are fetched with a key
    assert "http" not in policy
    for name in ("app.js", "style.css", "icon.svg"):
        answer = server.client.get(f"/page/{name}")
        assert answer.status_code == 200
        assert answer.headers["x-content-type-options"] == "nosniff"
        tag = {"if-none-match": answer.headers["etag"]}
        assert server.client.get(f"/page/{name}", headers=tag).status_code == 304
    for name in ("../app.py", "..%2fapp.py", "none.js", "%2e%2e%2fmain.py"):
        assert server.client.get(f"/page/{name}").status_code == 404
    for text in ("<script>", "onclick=", "style=", "https://"):
        assert text not in front.text


def test_tiles_pictures_truth(server: Any, field: str) -> None:
    about = server.client.get(f"{field}/frames").json()
    assert (about["frames"], about["shape"], about["tile_shape"]) == (2, [512, 512], [256, 256])
    frame = server.client.get(f"{field}/frames/1").json()
    assert frame["drawn"] == [[0, 0], [0, 1], [1, 0], [1, 1]]
    assert frame["times"]["start"] < frame["times"]["end"]
    whole, size = server.client.get(f"{field}/frames/1/tiles/1/0"), (256, 256)
    assert (whole.headers["x-shape"], whole.headers["x-type"]) == ("256,256", "<u2")
    values = np.frombuffer(whole.content, "<u2").reshape(size)
    binned = server.client.get(f"{field}/frames/1/tiles/1/0?bin=5")
    got = np.frombuffer(binned.content, "<f4").reshape(52, 52)
    block = values[5:10, 250:255].astype(float)
    assert got[1, 50] == pytest.approx(0.5 * (block.mean() + block.max()), rel=1e-6)
    assert got[51, 51] == values[255, 255]
    from PIL import Image

    png = server.client.get(f"{field}/frames/1/tiles/1/0/picture.png?low=0&high=65535"
                            "&stretch=linear")  # fmt: skip
    grey = np.asarray(Image.open(BytesIO(png.content)))[::-1]
    assert np.array_equal(grey, (255.0 * (values / 65535.0) + 0.5).astype(np.uint8))
    truth = server.client.get(f"{field}/frames/1/truth?limit=3").json()
    light = [star["electrons"] for star in truth["stars"]]
    assert len(light) == 3 < truth["stars_in_frame"]
    assert light == sorted(light, reverse=True)
    for path, status in (
        ("frames/2", 404), ("frames/0/tiles/2/0", 404), ("frames/0/tiles/0/0?layer=odd", 404),
        ("frames/0/tiles/0/0?bin=0", 422), ("frames/x", 422),
        ("frames/0/tiles/0/0/picture.png?low=5&high=1", 422),
        ("frames/0/tiles/0/0/picture.png?low=nan&high=1", 422), ("frames/9/truth", 404),
        ("frames/0/fits?layer=odd", 404),
    ):  # fmt: skip
        answer = server.client.get(f"{field}/{path}")
        assert answer.status_code == status, (path, answer.text)
    assert server.client.get("/v1/jobs/none/frames").status_code == 404
