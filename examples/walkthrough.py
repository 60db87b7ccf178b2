"""A mission team's day with the service: four ways in, a kill in the middle, nothing lost.

    python examples/walkthrough.py [FOLDER]

Serves on a free port from FOLDER (default: a new temporary one), makes an API key, submits small
scenes by curl, by Python, by pyvo and (where a Chromium and playwright are) by the web page, kills
the server and all its workers, starts it again, and fetches and verifies what every one made.
"""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
import requests
from pyvo.dal import AsyncTAPJob

from pipeline.store.product import check
from service.client import Client

COMMAND = [sys.executable, "-m", "pipeline"]
SCENE: dict[str, Any] = {
    "schema": "nightglass/scene/1",
    "name": "walkthrough",
    "epoch": "2019-07-20T09:00:00Z",
    "seed": 7,
    "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3},
    "sensor": {
        "shape": [128, 128],
        "pixel_pitch_um": 13.5,
        "focal_length_m": 1.0,
        "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
        "read_noise_e": 5.0,
    },
    "pointing": {"mode": "target", "target": "geo-1"},
    "exposure": {"integration_s": 2.0, "frames": 2, "cadence_s": 5.0},
    "targets": [
        {
            "name": "geo-1",
            "orbit": {
                "kind": "state",
                "position_m": [4407338.1, -41933005.2, -36593.5],
                "velocity_m_s": [3057.8229, 321.39, 0.2805],
            },
            "body": {"kind": "sphere", "diameter_m": 4.0, "albedo": 0.25},
        }
    ],
    "background": {"uniform_mag_arcsec2": 20.8},
}


def say(text: str) -> None:
    print(f"-- {text}", flush=True)


def named(name: str) -> dict[str, Any]:
    return SCENE | {"name": name}


class Server:
    """`nightglass serve` as its own process group, so that all of it can be killed at once."""

    def __init__(self, home: Path) -> None:
        self.home, self.port = home, 0
        self.start()

    def start(self) -> None:
        log = self.home.with_suffix(".log")
        known = log.stat().st_size if log.exists() else 0
        words = ["serve", "--port", str(self.port), "--home", str(self.home)]
        with log.open("ab") as file:
            self.process = subprocess.Popen(COMMAND + words, stderr=file, start_new_session=True)
        deadline = time.monotonic() + 60
        while not (found := re.search(r"serves (http://\S+:(\d+))", log.read_text()[known:])):
            if self.process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit(f"the server did not start:\n{log.read_text()[known:]}")
            time.sleep(0.1)
        self.url, self.port = found[1], int(found[2])
        say(f"serving {self.url} from {self.home}")

    def kill(self, how: int = signal.SIGKILL) -> None:
        """kill -9 of the server and of every worker that it started."""
        everybody = [psutil.Process(self.process.pid)]
        everybody += everybody[0].children(recursive=True)
        for one in everybody:
            if one.is_running():
                one.send_signal(how)
        psutil.wait_procs(everybody, timeout=30)
        self.process.wait(30)


def submit_by_curl(url: str, key: str, folder: Path) -> str:
    """One command, as anybody would type it."""
    scene = folder / "scene.json"
    scene.write_text(json.dumps(named("by-curl")))
    words = ["curl", "-sS", "-i", "-H", f"Authorization: Bearer {key}",
             "-H", "Content-Type: application/json", "-H", "Idempotency-Key: walkthrough-1",
             "--data", f"@{scene}", f"{url}/v1/jobs"]  # fmt: skip
    answer = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60).stdout
    found = re.search(r"(?im)^location: /v1/jobs/(\w+)", answer)
    if found is None:
        raise SystemExit(f"curl was refused:\n{answer}")
    return found[1]


def submit_by_pyvo(url: str, key: str) -> str:
    """IVOA UWS with pyvo's own job client."""
    session = requests.Session()
    session.headers["Authorization"] = f"Bearer {key}"
    job = AsyncTAPJob.create(f"{url}/uws", json.dumps(named("by-pyvo")), session=session)
    return job.run().job_id


def submit_by_page(url: str, key: str) -> str | None:
    """The web page in a headless browser; None where there is none here."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        browser = None
    if browser is None:
        return None
    with sync_playwright() as driver:
        window = driver.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        page = window.new_page()
        page.set_default_timeout(60_000)
        page.goto(url)
        page.wait_for_selector("#keyform[open]")  # the page asks for a key by itself
        page.fill("#keyvalue", key)
        page.click("#keyform button[value=set]")
        page.goto(f"{url}/#/new")
        page.fill("#json", json.dumps(named("by-page")))
        page.click("#submit")
        page.wait_for_url("**/#/job/*")
        found = page.url.rpartition("/")[2]
        window.close()
    return found


def main(folder: Path) -> None:
    """The whole way; ends with an error where anything is lost or differs."""
    home = folder / "home"
    server = Server(home)
    try:
        words = ["keys", "create", "--team", "mission", "--name", "walkthrough", "--home", home]
        made = subprocess.run([*COMMAND, *map(str, words)], capture_output=True, text=True,
                              check=True, timeout=60)  # fmt: skip
        key = made.stdout.strip()
        say("made a key for the team `mission`; from now on every request needs one")
        while requests.get(f"{server.url}/v1/jobs", timeout=30).status_code != 401:
            time.sleep(0.2)
        client = Client(server.url, key)
        jobs = {"curl": submit_by_curl(server.url, key, folder)}
        jobs["Python"] = client.submit(named("by-python")).id
        jobs["pyvo"] = submit_by_pyvo(server.url, key)
        page = submit_by_page(server.url, key)
        if page is None:
            say("no Chromium or playwright here: the page is omitted")
        else:
            jobs["page"] = page
        for way, job in jobs.items():
            say(f"submitted by {way}: {job}")
        server.kill()
        say("killed the server and its workers (kill -9)")
        server.start()
        again = submit_by_curl(server.url, key, folder)
        if again != jobs["curl"]:
            raise SystemExit("the same Idempotency-Key made a second job")
        digests = {}
        for way, job in jobs.items():
            done = client.job(job).wait(timeout_s=300, progress=False)
            product = done.fetch(folder / f"by-{way.lower()}", progress=False)
            digests[way] = done.facts["content_digest"]
            whole = check(product).whole
            say(f"{way}: {done.facts['tiles_done']} tiles, fetched to {product}, whole: {whole}")
            if not whole:
                raise SystemExit(f"{product} is not whole")
        if len(set(digests.values())) != 1:
            raise SystemExit(f"the same scene gave different pixels: {digests}")
        say(f"the same pixels by every way: content {digests['Python'][:16]}")
    finally:
        if server.process.poll() is None:
            server.kill(signal.SIGTERM)


if __name__ == "__main__":
    chosen = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="nightglass-"))
    chosen.mkdir(parents=True, exist_ok=True)
    main(chosen.resolve())
