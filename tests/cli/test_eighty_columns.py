"""Every command's output fits a terminal of 80 columns, and so do its help pages."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer.main

from catalog_tools.synthetic.synthetic import make_demo
from pipeline.cli import app
from pipeline.spec.load import load_scene
from pipeline.spec.study_load import read_study
from tests.command import nightglass
from tests.service.conftest import Server

ROOT = Path(__file__).parents[2]
PEERS = ROOT / "tests" / "data" / "peers"
SWEEP = {
    "schema": "nightglass/sweep/1", "name": "few", "scene": "scene.json",
    "axes": [{"field": "sensor.read_noise_e", "values": [2, 40]},
             {"field": "targets.0.body.albedo", "values": [0.1, 0.2]}],
}  # fmt: skip
# In order: later commands take what earlier ones make. {job}: a finished one of the server.
COMMANDS = [
    "--version", "plan scene.json", "plan scene.json --all", "plan scene.json --explain",
    "render scene.json -o run", "render scene.json -o parted --part 1/1", "join parted",
    "check run", "info run", "calibrate run -o calibrated", "color-fit scene.json",
    "light-curve scene.json --target chaser -o curve.parquet", "observe scene.json -o seen.csv",
    "find {root}/examples/population.yaml --night --step 60",
    "study study.json --dry-run", "study study.json -o studied --scheduler synchronous",
    "export run --to png -o pictures", "sweep sweep.json --dry-run", "sweep sweep.json -o swept",
    "catalog demo -o small --faintest 5", "catalog info small", "catalog verify small",
    "catalog cone small --ra 10 --dec 10 --radius 5 -o cone.csv",
    "catalog forms", "catalog starlight small",
    "catalog ingest {root}/tests/data/gaia_dr2_field.csv -o field",
    "cosmic-rays extract dark.npy -o rays.fits --exposure-s 10 --pixel-pitch-um 9",
    "cosmic-rays compare rays.fits -o rays.png",
    "import satsim {peers}/satsim.json -o satsim.yaml",
    "import simsit {peers}/simsit.yaml -o simsit.yaml",
    "report detection run -o detection", "report ledger -o ledger --rule stars",
    "selftest --only penumbra",
    "keys create --team us --name the-first-one-of-them-all --home keys",
    "keys list --home keys", "jobs list --server {url}", "jobs show {job} --server {url}",
    "jobs fetch {job} --server {url} -o fetched",
    "plan plain.json --server {url}",
]  # fmt: skip
SLOW = ["report scenes -o scenes --quick --levels 0.5", "demo -o demo",
        "report accuracy -o accuracy --quick --stars 100 --no-peers"]  # fmt: skip
ELSEWHERE = {  # commands that are not run here, and why
    "serve": "prints a log, a JSON object a line",
    "jobs cancel": "prints one word, the job's phase",
    "jobs retry": "prints one word, the job's phase",
    "schema": "prints JSON, for machines",
    "keys revoke": "prints one short line",
    "worker": "waits for a scheduler, and logs as Dask's workers do",
    "catalog fetch": "needs an archive; prints a mapping, as `catalog info` does",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of few stars and a target, a sweep of it, a study, dark frames."""
    made = tmp_path_factory.mktemp("wide")
    data = load_scene(ROOT / "examples" / "space-based-rate.yaml").as_dict()
    data["name"] = "a-scene-with-quite-a-long-name-of-sixty-characters-or-even-more"
    data["sensor"] |= {"shape": [256, 256]}
    data["exposure"] |= {"frames": 2}
    (made / "plain.json").write_text(json.dumps(data))
    make_demo(made / "sky", faintest_g_mag=9.0)
    data["stars"] = {"catalogue": "sky"}
    (made / "scene.json").write_text(json.dumps(data))
    (made / "sweep.json").write_text(json.dumps(SWEEP))
    data = read_study(ROOT / "examples" / "studies" / "three-sites.yaml")
    data["sensors"] = data["sensors"][2:]  # two at a site, and one in orbit
    data["catalogue"]["synthetic"]["objects"] = 50
    (made / "study.json").write_text(json.dumps(data))
    rng = np.random.default_rng(1)
    dark = rng.normal(100.0, 3.0, (3, 64, 64))
    dark[0, 20, 10:20] += 400.0
    dark[1, 40:44, 30] += 900.0
    np.save(made / "dark.npy", dark)
    return made


@pytest.fixture(scope="module")
def words(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """What stands for the names in braces; the server and its finished job are made here."""
    server = Server(tmp_path_factory.mktemp("home"))
    job = server.submit(json.loads((folder / "plain.json").read_text()))
    assert server.ended(job)["phase"] == "COMPLETED"
    yield {"root": ROOT, "peers": PEERS, "url": server.url, "job": job.rpartition("/")[2]}
    server.stop()


def leaves(command: Any, name: str = "") -> Iterator[str]:
    """Names of all commands."""
    inner = getattr(command, "commands", None)
    for key in inner or ():
        yield from leaves(inner[key], f"{name} {key}".strip())
    if not inner:
        yield name


ALL = list(leaves(typer.main.get_command(app)))


def too_wide(text: str) -> list[str]:
    return [line for line in text.splitlines() if len(line) > 80]


def test_no_command_is_forgotten() -> None:
    for name in ALL:
        run = any(line.startswith((f"{name} ", f"{name}\n")) or line == name
                  for line in (*COMMANDS, *SLOW))  # fmt: skip
        assert run != (name in ELSEWHERE), name


@pytest.mark.parametrize("name", ["", *ALL])
def test_help_fits(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    told = nightglass(*name.split(), "--help")
    assert told.stdout
    assert not too_wide(told.stdout)


def test_every_option_says_what_it_is() -> None:
    command = typer.main.get_command(app)
    for name in ALL:
        found: Any = command
        for word in name.split():
            found = found.commands[word]
        mute = [p.name for p in found.params if not getattr(p, "help", None)]
        assert not mute, f"{name}: {mute}"


def test_a_group_alone_shows_its_commands() -> None:
    told = nightglass("catalog")
    assert told.returncode == 2
    assert "ingest" in told.stdout
    assert not told.stderr


@pytest.mark.parametrize("line", COMMANDS)
def test_output_fits(
    line: str, folder: Path, words: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each command does its work, and no line of what it prints is cut or broken."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("pipeline.survey.signal.LENGTHS", 24)  # most of what a sensor takes
    monkeypatch.chdir(folder)
    told = nightglass(*line.format(**words).split())
    assert told.returncode == 0, told.stderr
    assert told.stdout or told.stderr or line.startswith("keys")
    assert not too_wide(told.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("line", SLOW)
def test_output_of_long_ones_fits(line: str, tmp_path: Path, monkeypatch: Any) -> None:
    test_output_fits(line, tmp_path, {}, monkeypatch)
