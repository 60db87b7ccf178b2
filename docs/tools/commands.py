"""The commands of tutorial and how-to pages, run in order: `python docs/tools/commands.py`."""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
PAGES = ("tutorial.md", "howto/own-catalogue.md", "howto/own-sensor.md", "howto/exports.md",
         "howto/imports.md", "howto/sweep-on-a-cluster.md", "howto/submit-jobs.md",
         "howto/targets.md", "howto/orbits.md", "howto/attitude.md", "howto/materials.md",
         "howto/space-sensor.md", "howto/stray-light.md", "howto/gap-time.md",
         "howto/what-is-seen.md")  # fmt: skip
FILE = re.compile(r"(?s)```\w+\n# (\S+\.\w+)\n(.*?)```")  # a block whose first line names a file
FIRST = re.compile(r"(nightglass|python|\.|\.venv\S*|for|make) ")
# What is not run here, by a part of the command, and why.
NOT_RUN = {
    "-m venv": "sets up an environment; the test command does it from nothing",
    ".venv/bin/pip": "sets up an environment; the test command does it from nothing",
    ".venv/bin/activate": "sets up an environment; the test command does it from nothing",
    "catalog fetch": "reads from the archive over the network",
    "PRODUCT --to KIND": "a form with places to fill in; the tutorial runs three of its kinds",
    "tls://": "needs a cluster; tests of TLS start their own",
    "serve": "a server that runs on; tests/docs/test_service_howto.py runs it",
    "jobs/catalogues": "the server's folder; tests/docs/test_service_howto.py makes it",
    "nightglass info fetched": "of the server; tests/docs/test_service_howto.py fetches it",
}
PEERS = {"satsim": ("config.json", "config_static.json"), "simsit": ("target.yaml",) * 2}
NO_PEERS = "needs a scene file of the peer (shared/data/peer_scenes)"


@dataclass(frozen=True)
class Command:
    """A command of a page: all lines that belong together, as bash reads them."""

    page: str
    text: str

    @property
    def why_not(self) -> str | None:
        """Why it is not run; None where it is."""
        return next((why for part, why in NOT_RUN.items() if part in self.text), None)


def commands() -> Iterator[Command]:
    """Every command of the pages, in order; a loop is one."""
    for page in PAGES:
        text = re.sub(r"```.*?```", "", (DOCS / page).read_text(), flags=re.DOTALL)
        for block in re.findall(r"(?:^    \S.*\n(?:^    .*\n|^\n(?=    ))*)", text, re.MULTILINE):
            lines = [line[4:] for line in block.splitlines() if line.strip()]
            if not FIRST.match(lines[0] + " "):
                continue
            if lines[0].startswith("for "):
                yield Command(page, "\n".join(lines))
            else:
                yield from (Command(page, line) for line in lines)


def files() -> dict[str, str]:
    """The files whose whole text a page gives, by name."""
    return {name: text for page in PAGES for name, text in FILE.findall((DOCS / page).read_text())}


def prepare(folder: Path) -> dict[str, str]:
    """The files that the pages speak of as the reader's own; why what lacks one is not run."""
    for name, text in files().items():
        (folder / name).write_text(text)
    shutil.copy(ROOT / "examples" / "space-based-rate.yaml", folder / "scene.yaml")
    shutil.copytree(ROOT / "examples", folder / "examples")
    (folder / "files").mkdir()
    head = "source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
    head += "phot_bp_mean_mag,phot_rp_mean_mag\n"
    rows = "".join(f"{(i + 1) << 35},2015.5,{276 + 0.01 * i},-3.2,1,0,0,,{10 + 0.1 * i},,\n"
                   for i in range(40))  # fmt: skip
    (folder / "files" / "gaia.csv").write_text(head + rows)
    (folder / "stars.csv").write_text("name,ra,dec,mag\n7,10.0,20.0,9.5\n8,10.1,20.1,9.7\n")
    (folder / "my_form.toml").write_text(FORM)
    missing = {}
    peers = ROOT.parent / "shared" / "data" / "peer_scenes"
    for kind, (name, theirs) in PEERS.items():
        if (peers / kind / theirs).is_file():
            shutil.copy(peers / kind / theirs, folder / name)
        else:
            missing[f"import {kind}"] = NO_PEERS
    return missing


FORM = """name = "mine"
description = "My stars."
credit = "me"
ref_epoch_jyear = 2016.0
epoch_scale = "TCB"

[source_id]
from = "name"

[ra]
from = "ra"
unit = "deg"

[dec]
from = "dec"
unit = "deg"

[phot_g_mean_mag]
from = "mag"
unit = "mag"
"""


def run_all(folder: Path) -> list[dict[str, object]]:
    """Run every command in an empty folder; a row for each: page, command, seconds or why not.

    Raises SystemExit with its last words for one that fails.
    """
    missing, rows = prepare(folder), []
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for c in commands():
        why = c.why_not or next((w for part, w in missing.items() if part in c.text), None)
        began = time.perf_counter()
        if why is None:
            done = subprocess.run(
                ["bash", "-ec", c.text], cwd=folder, env=os.environ | {"PATH": path},
                capture_output=True, text=True, check=False,
            )  # fmt: skip
            if done.returncode:
                last = (done.stderr.strip().splitlines() or ["no word"])[-1]
                raise SystemExit(f"{c.page}: {c.text}\nended with {done.returncode}: {last}")
        seconds = round(time.perf_counter() - began, 2)
        rows.append({"page": c.page, "command": c.text, "seconds": seconds, "not_run": why})
    return rows


def main() -> None:
    """Run them and print what was run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for row in run_all(Path(folder)):
            print(json.dumps(row))


if __name__ == "__main__":
    main()
