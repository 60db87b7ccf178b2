"""Bad input on the command line: one clear message, exit code 2, nothing half-written."""

from __future__ import annotations

import copy
import errno
import json
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from typer.main import get_command

from catalog_tools.catalogue import open_catalogue
from catalog_tools.engine import clusters
from catalog_tools.storage import durable
from catalog_tools.synthetic.synthetic import make_demo
from pipeline.cli import _explain as explain
from pipeline.cli import app
from pipeline.commands.jobs import read_scene
from pipeline.errors import NO_ROOM, BadInput
from pipeline.spec.load import load_scene
from pipeline.store.product import check
from tests.command import nightglass

SCENE = {
    "schema": "nightglass/scene/1",
    "name": "small",
    "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3},
    "sensor": {
        "shape": [256, 256],
        "pixel_pitch_um": 9.0,
        "focal_length_m": 1.0,
        "aperture_m": 0.4,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
        "read_noise_e": 5.0,
        "bias_dn": 100,
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 276.0, "boresight_dec_deg": -3.2},
    "exposure": {"integration_s": 1.0},
    "background": {"uniform_e_per_s": 20.0},
}
TLE = (
    "1 28238U 04011A   19100.50000000  .00000000  00000-0  00000+0 0  9991",
    "2 28238   0.0200  80.0000 0003000 100.0000 200.0000  1.00270000 54321",
)
ORBIT = {"kind": "state", "position_m": [7e6, 0, 0], "velocity_m_s": [0, 7546.0, 0]}


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("sky") / "catalogue"
    make_demo(path, faintest_g_mag=6.0, deep_fields=[(276.0, -3.2, 0.4, 14.0)])
    return path


def changed(changes: dict) -> dict:
    data = copy.deepcopy(SCENE)
    for key, value in changes.items():
        *parents, last = key.split(".")
        holder = data
        for part in parents:
            holder = holder.setdefault(part, {})
        holder[last] = value
    return data


def target(**orbit) -> list:
    return [{"name": "t", "orbit": orbit, "body": {"kind": "sphere", "diameter_m": 1, "albedo": 1}}]


CASES = {
    "unknown key": ({"sensor.read_nois_e": 3}, ["sensor.read_nois_e", "read_noise_e"]),
    "unknown section": ({"star": {}}, ["star", "stars"]),
    "wrong range": ({"sensor.quantum_efficiency": 1.5}, ["sensor.quantum_efficiency", "1.5", "1"]),
    "wrong type": ({"sensor.aperture_m": "big"}, ["sensor.aperture_m", "big"]),
    "nan": ({"sensor.read_noise_e": float("nan")}, ["sensor.read_noise_e", "nan"]),
    "infinite": ({"exposure.integration_s": float("inf")}, ["exposure.integration_s", "inf"]),
    "negative": ({"sensor.dark_e_per_s": -1}, ["sensor.dark_e_per_s", "-1"]),
    "no focal plane": ({"sensor.shape": [0, 256]}, ["sensor.shape", "0"]),
    "adc 0": ({"sensor.adc_bits": 0}, ["sensor.adc_bits", "0", "1"]),
    "adc 64": ({"sensor.adc_bits": 64}, ["sensor.adc_bits", "64", "63"]),
    "no catalogue": ({"stars": {"catalogue": "nowhere"}}, ["stars.catalogue", "nowhere"]),
    "bad checksum": (
        {"targets": target(kind="tle", line1=TLE[0][:-1] + "7", line2=TLE[1])},
        ["targets.0.orbit.line1", "the line's checksum"],
    ),
    "a unit in a number": ({"sensor.aperture_m": "1000 mm"}, ["'1000 mm'", "number in m (the"]),
    "one of several units": (
        {"observer": {"kind": "orbit", "orbit": {**ORBIT, "position_m": ["7e3 km", 0, 0]}}},
        ["observer.orbit.position_m.0", "'7e3 km'", "a number in m"],
    ),
    "a number or a file": ({"sensor.flat": [1]}, ["allowed: a number, or the path of a file\n"]),
    "a union by kind": (
        {"sensor.psf": "airy"}, ["sensor.psf: 'airy'", "a mapping with `kind`: airy, field, gaus"]
    ),
    "none as text": ({"sensor.psf": "None"}, ["sensor.psf: 'None'", "a mapping with `kind`: airy"]),
    "true for a mapping": ({"cosmic_rays": True}, ["cosmic_rays: True", "`kind`: generated, lib"]),
    "a fraction of one": ({"seed": 1.5}, ["seed: 1.5", "allowed: a whole number\n"]),
    "in the Earth": (
        {"observer": {"kind": "orbit", "orbit": {**ORBIT, "position_m": [1e6, 0, 0]}}},
        ["observer.orbit", "Earth"],
    ),
    "at the Earth": (
        {"observer": {"kind": "orbit", "orbit": ORBIT},
         "pointing.boresight_ra_deg": 180.0, "pointing.boresight_dec_deg": 0.0},
        ["pointing", "Earth"],
    ),
    "below the horizon": ({"pointing.boresight_dec_deg": -89.0}, ["pointing", "horizon"]),
    "tile": ({"output": {"tile_shape": [100, 256]}}, ["output.tile_shape", "256"]),
    "no such epoch": ({"epoch": "2019-02-30T00:00:00Z"}, ["epoch", "2019-02-30"]),
    "no such filter": ({"sensor.bandpass": {"kind": "named", "name": "bessell-Q"}}, ["bessell-Q"]),
    "no such image": ({"sensor.flat": "flat.npy"}, ["sensor.flat", "flat.npy"]),
    "absurd rate": (
        {"pointing": {"mode": "rate", "boresight_ra_deg": 276.0, "boresight_dec_deg": -3.2,
                      "rate_ra_arcsec_s": 3e5, "rate_dec_arcsec_s": 0}},
        ["pointing.rate_ra_arcsec_s", "300000"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_bad_scene(name, tmp_path):
    changes, words = CASES[name]
    (tmp_path / "scene.json").write_text(json.dumps(changed(changes)))
    result = nightglass("render", tmp_path / "scene.json", "-o", tmp_path / "run")
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    for word in words:
        assert word in result.stderr
    assert not (tmp_path / "run").exists()


def test_elements_given_as_the_scene(tmp_path):
    """A file of two-line elements, with names or without, is told as what it is."""
    for name in ("", "SATELLITE\n", "# of today\nSATELLITE\n"):
        (tmp_path / "sat.tle").write_text(f"{name}{TLE[0]}\n{TLE[1]}\n")
        result = nightglass("plan", tmp_path / "sat.tle")
        assert result.returncode == 2
        assert "two-line elements stand in one, as `orbit: {kind: tle" in result.stderr


@pytest.mark.parametrize("text", [b"seed: 1\nseed: 2\n", b"name: \xff\n", b"{"])
def test_text_that_is_no_scene_is_told_by_its_file_for_a_server_too(text, tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_bytes(text)
    said = []
    for read in (load_scene, read_scene):
        with pytest.raises(BadInput) as refused:
            read(path, [])
        said.append(str(refused.value))
    assert said[0] == said[1]
    assert str(path) in said[0]


def test_bad_images(tmp_path):
    """Wrong shape, NaN and negative maps are named."""
    for name, image, word in (
        ("shape", np.ones((4, 4)), "(4, 4)"),
        ("nan", np.full((256, 256), np.nan), "NaN"),
        ("negative", np.full((256, 256), -1.0), "-1"),
    ):
        np.save(tmp_path / "map.npy", image)
        (tmp_path / "scene.json").write_text(json.dumps(changed({"sensor.flat": "map.npy"})))
        result = nightglass("render", tmp_path / "scene.json", "-o", tmp_path / name)
        assert result.returncode == 2
        assert "sensor.flat" in result.stderr
        assert word in result.stderr
        assert not (tmp_path / name).exists()


def test_output_that_exists(tmp_path):
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine.txt").write_text("kept")
    for more in ([], ["--replace"], ["--resume"]):
        result = nightglass("render", tmp_path / "scene.json", "-o", tmp_path / "run", *more)
        assert result.returncode == 2
        assert str(tmp_path / "run") in result.stderr
        assert [p.name for p in (tmp_path / "run").iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("more", [[], ["--replace"]])
def test_output_that_exists_is_told_before_anything_is_planned(tmp_path, more):
    """A catalogue that is not there would be told first by a plan."""
    data = changed({"stars": {"catalogue": str(tmp_path / "nowhere")}})
    (tmp_path / "scene.json").write_text(json.dumps(data))
    (tmp_path / "run").mkdir()
    result = nightglass("render", tmp_path / "scene.json", "-o", tmp_path / "run", *more)
    assert result.returncode == 2
    assert f"{more[0] if more else '-o'}: '{tmp_path / 'run'}'" in result.stderr


def test_damaged_shard(catalogue, tmp_path):
    """A flipped bit in a shard is an error that names it, and leaves nothing behind."""
    opened = open_catalogue(catalogue)
    data = changed({"stars": {"catalogue": str(catalogue)}})
    (tmp_path / "scene.json").write_text(json.dumps(data))
    good = nightglass("render", tmp_path / "scene.json", "-o", tmp_path / "good", "--json")
    assert good.returncode == 0, good.stderr
    assert json.loads(good.stdout)["catalogue"]["synthetic"] is True
    for leaf in opened.leaves:
        path = catalogue / leaf.path
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 4
        path.write_bytes(content)
    result = nightglass("render", tmp_path / "scene.json", "-o", tmp_path / "run")
    assert result.returncode == 2, result.stderr
    assert "damaged" in result.stderr
    assert "Npix" in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "run").exists()


def test_other_catalogue_formats(tmp_path):
    (tmp_path / "hats").mkdir()
    (tmp_path / "hats" / "properties").write_text("obs_collection=gaia\n")
    data = changed({"stars": {"catalogue": str(tmp_path / "hats")}})
    (tmp_path / "scene.json").write_text(json.dumps(data))
    result = nightglass("render", tmp_path / "scene.json", "-o", tmp_path / "run")
    assert result.returncode == 2
    assert "stars.catalogue" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["render", "no.yaml", "-o", "x"], ["no.yaml"]),
        (["render"], ["SCENE"]),
        (["frobnicate"], ["frobnicate"]),
        (["check", "nowhere"], ["nowhere"]),
        (["export", "nowhere", "--to", "gif", "-o", "x"], ["gif"]),
        (["catalog", "info", "nowhere"], ["nowhere"]),
        (["catalog", "demo", "-o", "x", "--field", "1,2"], ["--field"]),
        (["serve", "--host", "0.0.0.0", "--home", "NEW"], ["0.0.0.0"]),
        (["sweep", "no.yaml", "-o", "s3://bucket/run"], ["s3://bucket/run", "a file system"]),
        (["render", "no.yaml", "-o", "s3://b/x", "--server", "http://h"], ["-o", "a file system"]),
        (["check", "memory://run"], ["memory://run", "s3://BUCKET/NAME"]),
        (["join", "s3://bucket"], ["PRODUCT", "s3://BUCKET/NAME"]),
    ],
)
def test_bad_commands(arguments, words, tmp_path):
    result = nightglass(*(tmp_path / "new" if a == "NEW" else a for a in arguments))
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    for word in words:
        assert word in result.stderr


@pytest.mark.parametrize(
    "option",
    ["--resume", "--retry-failed", "--workers=2", "--scheduler=quick", "--slurm", "--point=0",
     "--dry-run"],
)  # fmt: skip
def test_sweeps_of_a_server_take_no_option_of_runs_here(option):
    result = nightglass("sweep", "no.yaml", "--server", "http://127.0.0.1:9", option)
    assert result.returncode == 2
    assert result.stderr.startswith("nightglass: --server: 'with them' is not accepted; allowed: ")
    assert option.partition("=")[0] in result.stderr


def test_scheduler_names(tmp_path, monkeypatch):
    monkeypatch.setattr(clusters, "ANSWER_S", 1.0)
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    refused, away = (2, "--scheduler"), (4, "no scheduler answers")
    told = {"tcp://10.0.0.1:8786": refused, "quick": refused, "tcp://127.0.0.1:9": away}
    for name, (code, message) in told.items():
        result = nightglass(
            "render", tmp_path / "scene.json", "-o", tmp_path / "run", "--scheduler", name
        )
        assert result.returncode == code
        assert message in result.stderr
        assert not (tmp_path / "run").exists()


def test_a_process_of_its_own(tmp_path):
    """The installed command ends with the same message and code."""
    command = [sys.executable, "-m", "pipeline", "render", "no.yaml", "-o", str(tmp_path / "x")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("nightglass: SCENE: 'no.yaml'")


def test_the_table_of_commands_says_what_their_help_says():
    """A group's help shows the table's captions; each is the first paragraph of its command's."""

    def captions(group, said):
        for name, (_, caption) in group.table.items():
            command = group.commands[name]
            first = " ".join((command.help or "").split("\n\n")[0].split())
            assert (name, caption) == (command.name, first)
            said.append(name)
            if hasattr(command, "table"):
                captions(command, said)
        return said

    assert len(captions(get_command(app), [])) > 30


def test_help_imports_nothing_heavy():
    code = (
        "import sys, pipeline.cli;"
        "print([m for m in ('numba','astropy','dask','numpy','zarr') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "[]"


def test_the_environment_of_its_children_is_the_users():
    """Settings of malloc, for one, made every process that it starts three times as slow."""
    code = (
        "import os; before = dict(os.environ); import pipeline.cli, service.main;"
        "print({k: v for k, v in os.environ.items() if before.get(k) != v})"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "{}"


@pytest.mark.parametrize("text", ["1", "1,2,3", "1,x"])
def test_a_corner_is_two_numbers(catalogue: Path, text: str) -> None:
    others = ("--corner", "3,4", "--corner", "5,0")
    said = nightglass("catalog", "cone", str(catalogue), "--corner", text, *others)
    assert said.returncode == 2
    assert "--corner" in said.stderr
    assert text in said.stderr
    assert said.stderr.count("\n") == 1


def test_a_fault_is_one_message_or_on_request_its_trace(monkeypatch, capsys):
    """NIGHTGLASS_DEBUG lets a fault of the program through; mistakes of the user stay messages."""
    monkeypatch.delenv("NIGHTGLASS_DEBUG", raising=False)
    assert explain(ValueError("odd")) == 1
    said = capsys.readouterr().err
    assert said.startswith("nightglass: internal fault: ValueError: odd\n")
    assert "NIGHTGLASS_DEBUG=1" in said
    assert explain(RuntimeError("odd")) == 1  # as a thread that cannot be started, but it is none
    assert capsys.readouterr().err.startswith("nightglass: internal fault: RuntimeError: odd\n")
    monkeypatch.setenv("NIGHTGLASS_DEBUG", "1")
    with pytest.raises(ValueError, match="odd"):
        explain(ValueError("odd"))
    assert explain(BadInput("field", 1, "2")) == 2


@pytest.mark.parametrize("number", NO_ROOM)
def test_a_full_disk_ends_with_its_own_exit_code(number, capsys):
    """Whatever there is no room for: the disk, a quota, a file of that size."""
    assert explain(OSError(number, "no room", "out.zarr")) == 3
    assert capsys.readouterr().err.startswith("nightglass: out.zarr: the disk is full (")


@pytest.mark.parametrize(
    ("asked", "told"), [("32 MiB", "no memory is left (32 MiB): "), ("", "no memory is left: ")]
)
def test_where_memory_ends_it_says_what_needs_less(asked, told, capsys):
    """As where `ulimit -v` of a cluster holds: no fault of the program."""
    assert explain(MemoryError(asked)) == 3
    said = capsys.readouterr().err
    assert said.startswith(f"nightglass: {told}")
    assert "--workers" in said
    assert said.count("\n") == 1


def test_where_threads_end_it_says_what_needs_less(capsys):
    """As where `ulimit -u` or `-v` holds: no fault of the program, as where memory ends."""
    assert explain(RuntimeError("can't start new thread")) == 3
    said = capsys.readouterr().err
    assert said.startswith("nightglass: no thread can be started (ulimit -u")
    assert "--workers" in said


@pytest.fixture(scope="module")
def bright(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("bright") / "catalogue"
    make_demo(path, faintest_g_mag=4.0)
    return path


@pytest.mark.parametrize(
    ("below", "said"),
    [("file/x", "a path in a folder; "), ("no/such/x", "No such file"),
     ("x" * 300, "name too long")],
)  # fmt: skip
def test_a_path_where_no_file_can_be_is_bad_input(below, said, bright, tmp_path):
    (tmp_path / "file").touch()
    out = tmp_path / f"{below}.csv"
    ran = nightglass("catalog", "cone", bright, "--ra=0", "--dec=0", "--radius=30", "-o", out)
    assert ran.returncode == 2
    assert said in ran.stderr
    assert ran.stderr.count("\n") == 1


@pytest.mark.parametrize("radius", ["0", "-1", "180.5", "nan"])
def test_a_cone_has_a_size(radius, bright):
    ran = nightglass("catalog", "cone", bright, "--ra=0", "--dec=0", f"--radius={radius}")
    assert ran.returncode == 2
    assert ran.stderr.count("\n") == 1
    assert "radius_deg" in ran.stderr
    assert "above 0, up to 180" in ran.stderr


@pytest.mark.parametrize("command", ["cone", "observe", "light-curve"])
def test_a_table_without_room_is_there_whole_or_not_at_all(command, bright, tmp_path, monkeypatch):
    """The disk fills up as the last of it is written."""
    scene, out = tmp_path / "scene.json", tmp_path / "table.csv"
    ball = {"name": "a", "orbit": ORBIT, "body": {"kind": "sphere", "diameter_m": 1, "albedo": 0.2}}
    scene.write_text(json.dumps(SCENE | {"targets": [ball]}))
    monkeypatch.setattr(durable, "sync", Mock(side_effect=OSError(errno.ENOSPC, "no room")))
    where = ("--ra=0", "--dec=0", "--radius=30")
    given = ("catalog", "cone", bright, *where) if command == "cone" else (command, scene)
    ran = nightglass(*given, "-o", out)
    assert ran.returncode == 3, ran.stderr
    assert ran.stderr.startswith(f"nightglass: {out}: the disk is full (")
    assert not list(tmp_path.glob("*table*"))


@pytest.mark.parametrize("closed", ["2>&-", "0<&- 1>&- 2>&-"])
def test_a_closed_stream_changes_no_exit_code(closed, tmp_path):
    """As a daemon or a scheduler may start it; what is said goes nowhere."""
    line = f"{sys.executable} -m pipeline plan {tmp_path}/none {closed}"
    assert subprocess.run(["sh", "-c", line], capture_output=True).returncode == 2


@pytest.mark.parametrize("more", [[], ["--replace"]])
def test_a_demo_leaves_a_scene_that_is_not_its_own(more, tmp_path):
    (tmp_path / "scene.yaml").write_text("name: mine\n")
    result = nightglass("demo", "-o", tmp_path, *more)
    assert (result.returncode, "Traceback" in result.stderr) == (2, False)
    assert "that of an earlier demo with its scene.yaml as it was" in result.stderr
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("scene.yaml", "name: mine\n")]


def test_a_link_to_a_product_is_not_replaced(tmp_path):
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))
    assert nightglass("render", tmp_path / "scene.json", "-o", tmp_path / "run").returncode == 0
    (tmp_path / "link").symlink_to(tmp_path / "run")
    told = nightglass("render", tmp_path / "scene.json", "-o", tmp_path / "link", "--replace")
    assert (told.returncode, "a product, not a link to one" in told.stderr) == (2, True)
    assert check(tmp_path / "run").whole
