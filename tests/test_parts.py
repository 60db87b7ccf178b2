"""Parts rendered by processes of their own, side by side and one of them killed: a whole's bits."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
import xarray as xr

from pipeline.errors import BadInput, DiskFull, Incomplete, NightglassError, TryLater
from pipeline.route import run
from pipeline.route.run import Options, join, render
from pipeline.route.shares import Share, parse_part
from pipeline.spec.load import parse_scene
from pipeline.store import layout
from pipeline.store.product import check, content_digest, is_begun
from tests.command import nightglass

SCENE = {
    "schema": "nightglass/scene/1",
    "name": "parts",
    "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
    "sensor": {
        "shape": [512, 768], "pixel_pitch_um": 9.0, "focal_length_m": 0.5, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900}, "read_noise_e": 4.0,
        "psf": {"kind": "gaussian", "sigma_px": 0.8},
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 10.0, "boresight_dec_deg": 5.0},
    "exposure": {"integration_s": 1.0, "frames": 3},
    "background": {"uniform_e_per_s": 900.0},
    "cosmic_rays": {"kind": "generated", "rate_per_cm2_s": 50.0},
    "output": {"tile_shape": [256, 256]},
}  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    product = tmp_path_factory.mktemp("whole") / "run"
    render(parse_scene(SCENE), product, Options("threads", 2))
    return content_digest(product)


@pytest.mark.parametrize("parts", [1, 2, 7, 18, 40])
def test_parts_hold_every_tile_once(parts):
    """Also where there are more parts than tiles."""
    from pipeline.route.prepare import prepare

    plan = prepare(parse_scene(SCENE)).plan
    spans = [Share(k + 1, parts).span(plan) for k in range(parts)]
    assert [a for a, _ in spans] == [0, *(b for _, b in spans[:-1])]
    assert spans[-1][1] == len(plan.tiles) * plan.frames == 18
    assert max(b - a for a, b in spans) - min(b - a for a, b in spans) <= 1


@pytest.mark.parametrize("parts", [2, 3, 4, 5, 7, 11, 18, 40])
def test_the_part_that_lacks_a_tile_is_named(parts):
    """By the same division that gave the tile to it, also where it is not an even one."""
    from pipeline.route.prepare import prepare
    from pipeline.route.shares import lacking

    plan = prepare(parse_scene(SCENE)).plan
    all_tiles = {(f, t.row, t.column) for f in range(plan.frames) for t in plan.tiles}
    for gone in all_tiles:
        mine = [k for k in range(1, parts + 1) if Share(k, parts).mine(plan)(*gone)]
        truth = {("cosmic_rays", f) for f in range(plan.frames)}
        found = lacking(plan, all_tiles - {gone}, truth)
        said = found.told("run", plan, [f"part-1-of-{parts}"], ())
        assert f"run part(s) {mine[0]}/{parts} again" in said


def test_parts_one_after_the_other(tmp_path, whole):
    """In any order; the last one finishes it; a part may be run again."""
    product, scene = tmp_path / "run", parse_scene(SCENE)
    for k, lacking in ((3, r"1/3, 2/3"), (1, "2/3"), (1, "2/3")):
        assert not render(scene, product, share=Share(k, 3))["complete"]
        with pytest.raises(Incomplete, match=rf"missing: run part\(s\) {lacking} again"):
            join(product)
    report = render(scene, product, share=Share(2, 3))
    assert report["complete"]
    assert report["content_digest"] == whole == content_digest(product)
    assert check(product).whole
    assert xr.open_zarr(product / "cube.zarr").chunks["frame"] == (1, 1, 1)
    again = report | {"drawn_before": True}
    assert join(product) == again == render(scene, product, share=Share(1, 3))
    with pytest.raises(BadInput, match="same scene"):
        render(parse_scene(SCENE | {"seed": 9}), tmp_path / "run", share=Share(1, 3))


def test_parts_side_by_side_and_one_killed(tmp_path, whole):
    """Three processes start at once into a folder that is not there; a killed one is run again."""
    (tmp_path / "scene.json").write_text(json.dumps(SCENE))

    def start(k: int) -> subprocess.Popen:
        command = [sys.executable, "-m", "pipeline", "render", str(tmp_path / "scene.json")]
        command += ["-o", str(tmp_path / "run"), "--part", f"{k}/3", "--scheduler", "synchronous"]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    running = [start(k) for k in (1, 2, 3)]
    end = time.monotonic() + 300
    while not list(tmp_path.glob("run/markers/f*.json")) and time.monotonic() < end:
        time.sleep(0.01)
    os.kill(running[2].pid, signal.SIGKILL)
    for k, one in enumerate(running):
        _, err = one.communicate(timeout=300)
        assert k == 2 or one.returncode == 0, err
    again = start(3)
    assert again.wait(timeout=300) == 0
    report = join(tmp_path / "run")
    assert report["content_digest"] == whole
    assert check(tmp_path / "run").whole
    assert not [p for p in tmp_path.iterdir() if p.name.endswith(".tmp")]


def test_a_part_killed_at_the_very_end_needs_no_other_part_again(tmp_path, whole, monkeypatch):
    """As at its walltime: while the parts of truth, in the tables by then, are removed."""
    scene, product = parse_scene(SCENE), tmp_path / "run"
    render(scene, product, share=Share(1, 2))

    def cut_off(path):
        next((path / layout.TRUTH / layout.PARTS).iterdir()).unlink()
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("pipeline.route.finish.drop_parts", cut_off)
        with pytest.raises(KeyboardInterrupt):
            render(scene, product, share=Share(2, 2))
    render(scene, product, share=Share(2, 2))
    assert check(product).complete
    assert content_digest(product) == whole


def test_a_part_that_cannot_begin_names_the_product_and_leaves_nothing(tmp_path, monkeypatch):
    """Not the folder of its own in which it begins; a long name is no trouble."""
    scene, one = parse_scene(SCENE), Share(1, 18)

    def part(product):
        return render(scene, product, Options("synchronous"), share=one)

    (tmp_path / "file").touch()
    with pytest.raises(BadInput, match=r"^-o: .* a path that can be written; Not a dir") as told:
        part(tmp_path / "file" / "run")
    assert told.value.value == str(tmp_path / "file" / "run")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "mkdir", Mock(side_effect=OSError(errno.ENOSPC, "no room")))
        with pytest.raises(DiskFull, match=f"^{tmp_path / 'run'}: the disk is full"):
            part(tmp_path / "run")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", Mock(side_effect=OSError(errno.EIO, "no disk")))
        with pytest.raises(OSError, match="no disk"):
            part(tmp_path / "run")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert not part(tmp_path / ("r" * 255))["complete"]


def test_a_part_that_fails_before_any_tile_leaves_what_others_may_be_drawing(tmp_path, monkeypatch):
    """The product stands, as another part may be at its first tile; a whole render's goes."""
    scene, drawing = parse_scene(SCENE), Options("synchronous")
    with monkeypatch.context() as patch:
        patch.setattr(run, "draw", Mock(side_effect=NightglassError("no light")))
        for name, share in (("parts", Share(1, 18)), ("whole", None)):
            with pytest.raises(NightglassError, match="no light"):
                render(scene, tmp_path / name, drawing, share=share)
    assert [path.name for path in tmp_path.iterdir()] == ["parts"]
    assert is_begun(tmp_path / "parts")
    assert not render(scene, tmp_path / "parts", drawing, share=Share(2, 18))["complete"]


def test_a_part_that_ends_last_and_a_join_tell_programs_the_report(tmp_path):
    (tmp_path / "scene.json").write_text(json.dumps(SCENE | {"exposure": {"integration_s": 1.0}}))
    render_part = ("render", tmp_path / "scene.json", "-o", tmp_path / "run", "--json", "--part")
    first, last = (json.loads(nightglass(*render_part, f"{k}/2").stdout) for k in (1, 2))
    joined = nightglass("join", tmp_path / "run", "--json")
    assert joined.returncode == 0
    told = json.loads(joined.stdout)
    assert (first["complete"], last["frames"], told["frames"]) == (False, 1, 1)
    assert told["content_digest"] == last["content_digest"] == content_digest(tmp_path / "run")


@pytest.mark.parametrize(
    ("busy", "tiles", "joined", "pauses_s"),
    [(0, 8, True, []), (2, 8, True, [1.0, 1.0]), (3, 8, False, [1.0, 1.0, 0.0]), (0, 7, False, [])],
)
def test_of_parts_that_end_together_one_joins(busy, tiles, joined, pauses_s, monkeypatch):
    """It is tried again while another closes, a second later; a part before the last joins not."""
    slept, left = [], [TryLater("another is closing")] * busy

    def joining(*_):
        if left:
            raise left.pop()
        return {"joined": True}

    monkeypatch.setattr(run, "_joined", joining)
    monkeypatch.setattr(run.time, "sleep", slept.append)
    place = Mock(join_tries=3, tiles=lambda: tiles)
    prepared = SimpleNamespace(plan=SimpleNamespace(tiles=range(4), frames=2))
    told = run._joined_by_the_last(place, prepared, Share(2, 4), {"drawing": 1.0})
    alone = {"part": "2/4", "tiles": 2, "complete": False, "seconds": {"drawing": 1.0}}
    assert told == ({"joined": True} if joined else alone)
    assert slept == pauses_s


def test_join_names_what_is_damaged(tmp_path, whole):
    """A chunk that was cut short is not taken; its part draws it again."""
    product, scene = tmp_path / "run", parse_scene(SCENE)
    render(scene, product, share=Share(1, 2))
    chunk = product / "cube.zarr" / "dn" / "c" / "0" / "0" / "0"
    chunk.write_bytes(chunk.read_bytes()[:-5])
    with pytest.raises(Incomplete, match=r"run part\(s\) 1/2 again.*dn/c/0/0/0"):
        render(scene, product, share=Share(2, 2))
    assert not render(scene, product, share=Share(2, 2))["complete"]
    assert render(scene, product, share=Share(1, 2))["content_digest"] == whole


def test_join_leaves_a_seal_that_may_hold(tmp_path):
    """A file system that caches shows a marker of another machine late: nothing is undone."""
    product, scene = tmp_path / "run", parse_scene(SCENE)
    for part in (1, 2):
        render(scene, product, share=Share(part, 2))
    marker = next((product / "markers").iterdir())
    unseen = marker.rename(tmp_path / marker.name)
    with pytest.raises(Incomplete, match="missing"):
        join(product)
    unseen.rename(marker)
    assert check(product).whole


def test_a_part_waits_for_who_writes_it(tmp_path, whole):
    """The same part is being written elsewhere: refused at once, or waited for."""
    product, scene, part = tmp_path / "run", parse_scene(SCENE), Share(1, 2)
    render(scene, product, share=part)
    (product / "markers").rename(tmp_path / "none")
    (product / "markers").mkdir()
    held, free = threading.Event(), threading.Event()

    def write() -> None:
        with layout.only_writer(product, part.name):
            held.set()
            free.wait(timeout=60)

    writer = threading.Thread(target=write)
    writer.start()
    assert held.wait(timeout=60)
    with pytest.raises(TryLater, match="another render"):
        render(scene, product, share=part)
    threading.Timer(0.5, free.set).start()
    assert not render(scene, product, Options(wait_s=60.0), share=part)["complete"]
    writer.join()
    assert render(scene, product, share=Share(2, 2))["content_digest"] == whole


def test_a_product_is_not_replaced_while_parts_are_drawn(tmp_path):
    product = tmp_path / "run"
    render(parse_scene(SCENE), product, Options("synchronous"))
    kept = set(product.rglob("*"))
    with layout.only_writer(product, Share(1, 2).name):
        with pytest.raises(TryLater, match="another render"):
            render(parse_scene(SCENE), product, Options("synchronous", replace=True))
        assert kept <= set(product.rglob("*"))
    assert render(parse_scene(SCENE), product, Options("synchronous", replace=True))["complete"]


@pytest.mark.parametrize("text", ["0/4", "5/4", "x", "1", "1/0", "1/2/3", "-1/3", "1/9999999", ""])
def test_bad_parts_are_refused(text):
    with pytest.raises(BadInput, match="--part"):
        parse_part(text)


def test_join_wants_a_product(tmp_path):
    with pytest.raises(BadInput, match="PRODUCT"):
        join(tmp_path)
