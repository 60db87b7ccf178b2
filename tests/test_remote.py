"""Products on s3: the bits of a folder's, never half there, gone on with, proved, one writer."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from pipeline.errors import BadInput, Damaged, Incomplete, TryLater
from pipeline.route.run import Options, check, join, render
from pipeline.route.shares import Share
from pipeline.spec.load import parse_scene
from pipeline.store.markers import place_of
from tests.object_store import SECRET, needs_s3, s3_bucket
from tests.slow import slow

pytestmark = needs_s3
HERE = Options("synchronous")
SCENE = {
    "schema": "nightglass/scene/1", "name": "afar", "epoch": "2019-07-20T09:00:00Z", "seed": 5,
    "observer": {"kind": "orbit", "orbit": {
        "kind": "state", "position_m": [7.0e6, 0.0, 0.0], "velocity_m_s": [0.0, 7546.0, 0.0],
    }},
    "sensor": {
        "shape": [300, 256], "pixel_pitch_um": 9.0, "focal_length_m": 0.5, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900}, "read_noise_e": 4.0,
        "psf": {"kind": "gaussian", "sigma_px": 0.8},
    },
    "pointing": {"mode": "target", "target": "sat"},
    "targets": [{
        "name": "sat", "body": {"kind": "sphere", "diameter_m": 1.0, "albedo": 0.2},
        "orbit": {"kind": "state", "position_m": [4.2e7, 0.0, 0.0],
                  "velocity_m_s": [0.0, 3070.0, 0.0]},
    }],
    "exposure": {"integration_s": 0.1, "frames": 2},
    "background": {"uniform_e_per_s": 9.0},
    "output": {"tile_shape": [256, 256], "layers": ["dn", "mean_e"]},
}  # fmt: skip


@pytest.fixture(scope="module")
def bucket():
    with s3_bucket("runs") as url:
        yield url


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    path = tmp_path_factory.mktemp("local") / "run"
    return path, render(parse_scene(SCENE), path, HERE)


@pytest.fixture(scope="module")
def made(bucket):
    """A product that two parts made, the second of them finishing it."""
    url, scene = f"{bucket}/team/run", parse_scene(SCENE)
    first = render(scene, url, HERE, share=Share(1, 2))
    assert not first["complete"]
    return url, render(scene, url, HERE, share=Share(2, 2))


def test_same_product_as_in_a_folder(local, made):
    """Every chunk and marker has the bytes of the folder's; xarray opens it."""
    import xarray as xr

    from catalog_tools.storage.objects import Objects
    (path, report), (url, remote) = local, made
    assert remote["complete"]
    assert remote["content_digest"] == report["content_digest"]
    objects = Objects(url)
    for file in path.rglob("*"):
        name = file.relative_to(path).as_posix()
        if file.is_file() and not file.name.startswith(".lock"):
            content = objects.get(name)
            assert content is not None, name
            if "/c/" in name or "markers" in name or name.endswith("zarr.json"):
                assert content == file.read_bytes(), name
    assert not [n for n in objects.names() if ".parts" in n]
    verdict = check(url)
    assert verdict.whole, verdict.faults
    assert verdict.path == url
    assert (verdict.tiles, verdict.tiles_expected) == (4, 4)
    cube = xr.open_zarr(f"{url}/cube.zarr", chunks=None)
    here = xr.open_zarr(path / "cube.zarr", chunks=None)
    assert np.array_equal(cube["dn"], here["dn"])
    assert xr.open_zarr(f"{url}/cube.zarr").chunks["frame"] == (1,) * cube.sizes["frame"]
    assert SECRET not in json.dumps(remote) + "".join(
        str(objects.get(n)) for n in objects.names() if "/c/" not in n
    )


def test_damage_is_named(made):
    from catalog_tools.storage.objects import Objects
    url, objects, scene = made[0], Objects(made[0]), parse_scene(SCENE)
    names = ("cube.zarr/dn/c/1/1/0", "cube.zarr/mean_e/c/0/1/0", "plan.json", ".begun.json")
    chunk, gone, plan, begun = names
    good = {name: objects.get(name) for name in names}
    objects.put(chunk, good[chunk][:-1] + bytes([good[chunk][-1] ^ 1]))
    objects.put(plan, b"{}")
    objects.delete([gone])
    assert sorted(check(url).faults) == [
        f"{chunk}: the checksum differs", f"{gone}: the chunk of layer mean_e is missing",
        "plan.json: the digest differs",
    ]  # fmt: skip
    with pytest.raises(BadInput, match="--resume"):
        render(scene, url, HERE)
    with pytest.raises(BadInput, match="same scene_sha256"):
        render(parse_scene(SCENE | {"seed": 6}), url, replace(HERE, resume=True))
    objects.put(begun, b"{")
    with pytest.raises(Damaged, match=r"\.begun\.json"):
        check(url)
    for name, content in good.items():
        objects.put(name, content)
    assert check(url).whole


@pytest.mark.parametrize("gone", ["preview.png", "report.json"])
def test_what_finishing_a_product_made_is_made_again(bucket, local, gone):
    """A table of truth that is damaged and a file that is lost are no whole product's."""
    from catalog_tools.storage.objects import Objects
    objects, table = Objects(f"{bucket}/mended-{gone}"), "truth/targets.parquet"
    render(parse_scene(SCENE), objects.url, HERE)
    objects.put(table, objects.get(table)[:-1] + b"x")
    objects.delete([gone])
    assert not check(objects.url).whole
    again = render(parse_scene(SCENE), objects.url, replace(HERE, resume=True))
    assert again["content_digest"] == local[1]["content_digest"]
    assert check(objects.url).whole
    again = render(parse_scene(SCENE), objects.url, replace(HERE, resume=True))
    assert again["drawn_before"]


def test_a_join_that_lacks_a_chunk_takes_the_seal_away(made):
    """A product that was whole and lost a chunk does not look whole after `join` refused it."""
    from catalog_tools.storage.objects import Objects
    url, objects, gone = made[0], Objects(made[0]), "cube.zarr/mean_e/c/0/1/0"
    objects.delete([gone])
    with pytest.raises(Incomplete):
        join(url)
    assert objects.get("_COMPLETE") is None
    render(parse_scene(SCENE), url, replace(HERE, resume=True))
    assert check(url).whole


@pytest.mark.parametrize("seal", [slow("cube.zarr/zarr.json"), "_COMPLETE"])
def test_a_product_cut_off_while_it_is_sealed_is_not_whole(bucket, seal, monkeypatch):
    """The mark of a whole product comes after the cube's group: one without the other opens."""
    from catalog_tools.storage.objects import Objects
    url, scene, put = f"{bucket}/seal-{seal[-4:]}", parse_scene(SCENE), Objects.put

    def killed(self, name, content, *args, **kwargs):
        if name == seal:
            raise KeyboardInterrupt
        return put(self, name, content, *args, **kwargs)

    with monkeypatch.context() as cut:
        cut.setattr(Objects, "put", killed)
        with pytest.raises(KeyboardInterrupt):
            render(scene, url, HERE)
    assert Objects(url).get("_COMPLETE") is None
    assert (Objects(url).get("cube.zarr/zarr.json") is not None) == (seal == "_COMPLETE")
    assert not check(url).complete
    assert render(scene, url, replace(HERE, resume=True))["tiles_resumed"] == 4
    assert check(url).whole


def test_an_interrupted_product_is_not_whole_and_goes_on(bucket, local):
    """What is cut off shows no cube; --resume draws what is missing or damaged, and only that."""
    from catalog_tools.storage.objects import Objects
    from pipeline.store.remote import remove_remote

    url, scene = f"{bucket}/cut", parse_scene(SCENE)

    def stop(progress):
        if progress.done >= 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render(scene, url, HERE, stop)
    objects = Objects(url)
    assert objects.get("cube.zarr/zarr.json") is None
    assert objects.get("_COMPLETE") is None
    assert not check(url).complete
    frame, row, column = place_of(Path(min(objects.names("markers/"))))
    objects.put(f"cube.zarr/dn/c/{frame}/{row}/{column}", b"?")
    with pytest.raises(Incomplete, match="3 tile"):
        join(url)
    done = []
    report = render(scene, url, replace(HERE, resume=True), done.append)
    assert (done[0].done, done[-1].done) == (1, 4)
    assert report["tiles_resumed"] == 1
    assert report["content_digest"] == local[1]["content_digest"]
    again = render(scene, url, replace(HERE, resume=True))
    assert again == report | {"drawn_before": True}
    begun = objects.get(".begun.json")
    objects.delete([".begun.json"])
    with pytest.raises(BadInput, match="--replace"):
        remove_remote(objects)
    objects.put(".begun.json", begun)
    remove_remote(objects)
    assert all(name.startswith(".lock") for name in objects.names())


def test_of_an_old_product_the_seal_is_removed_first_and_the_record_last():
    """What is left of it when that is cut off looks unfinished, and can still be replaced."""
    from pipeline.store.remote import remove_remote

    seals = {"_COMPLETE", "cube.zarr/zarr.json"}
    names = {".begun.json", "scene.yaml", "cube.zarr/dn/c/0/0/0", "truth/stars.parquet", *seals}
    gone: list[set[str]] = []
    store = SimpleNamespace(
        url="s3://a/b", names=lambda: dict.fromkeys([*sorted(names), ".lock/000000000001"]),
        delete=lambda some: gone.append(set(some)),
    )  # fmt: skip
    remove_remote(store)
    assert gone[0] == seals
    assert gone[-1] == {".begun.json"}
    assert sorted(name for some in gone for name in some) == sorted(names)


def test_one_writer_at_a_time(bucket, monkeypatch):
    from catalog_tools.storage.objects import Objects
    from pipeline.store import lease

    objects, scene = Objects(f"{bucket}/busy"), parse_scene(SCENE)
    with lease.only_writer_of(objects) as mine:
        for shared in (None, "part-1-of-2"):
            with pytest.raises(TryLater, match="another render"), lease.only_writer_of(
                objects, shared
            ):  # fmt: skip
                pass
        with pytest.raises(TryLater, match="another render"):
            render(scene, objects.url, HERE)
        monkeypatch.setattr(lease, "RUNS_OUT_S", 0.0)  # as if it had died long ago
        with lease.only_writer_of(objects) as other:
            mine.renew()
            with pytest.raises(Incomplete, match="taken this product over"):
                mine.check()
            other.renew()
            other.check()
    monkeypatch.undo()
    with lease.only_writer_of(objects, "part-1-of-2"):
        with lease.only_writer_of(objects, "part-2-of-2"):
            pass
        with pytest.raises(TryLater, match="another render"), lease.only_writer_of(objects):
            pass
    with lease.only_writer_of(objects):
        pass


def test_a_lease_that_was_left_days_ago_keeps_nobody_out(bucket, monkeypatch):
    from datetime import timedelta

    from catalog_tools.storage.objects import Objects
    from pipeline.store import lease

    objects, now = Objects(f"{bucket}/left"), lease._now
    objects.create(".lock/000000000001", b'{"owner": "gone"}')
    monkeypatch.setattr(lease, "_now", lambda o: now(o) + timedelta(days=2, seconds=5))
    with lease.only_writer_of(objects) as mine:
        assert mine.name == ".lock/000000000002"


def holding(url, **environment):
    """A process that renders into a URL and is killed with -9 after its first tile."""
    code = (
        "import json, os, signal, sys; "
        "from pipeline.route.run import Options, render; "
        "from pipeline.spec.load import parse_scene; "
        "render(parse_scene(json.loads(sys.argv[1])), sys.argv[2], Options('synchronous'), "
        "lambda p: p.done and os.kill(os.getpid(), signal.SIGKILL))"
    )
    command = [sys.executable, "-c", code, json.dumps(SCENE), url]
    assert subprocess.run(command, env=os.environ | environment).returncode == -9


def test_the_same_writer_goes_on_at_once(bucket, local, monkeypatch):
    """Killed, and started again on this machine; or by Slurm, on any machine."""
    from catalog_tools.storage.objects import Objects
    from pipeline.store import lease

    slurm = {"SLURM_CLUSTER_NAME": "c", "SLURM_JOB_ID": "77"}
    left = Objects(f"{bucket}/killed-here")
    holding(left.url, **slurm)
    for where in ("here", "there"):
        url, again = f"{bucket}/killed-{where}", replace(HERE, resume=True)
        if where == "here":
            kept = {name: left.get(name) for name in left.names()}
        else:  # as another machine sees it
            objects = Objects(url)
            for name, content in kept.items():
                objects.put(name, content)
            name = max(n for n in objects.names(".lock/"))
            held = json.loads(objects.get(name)) | {"host": "another"}
            objects.put(name, json.dumps(held).encode())
            with pytest.raises(TryLater, match="another render"):
                render(parse_scene(SCENE), url, again)
            for key, value in (slurm | {"SLURM_RESTART_COUNT": "1"}).items():
                monkeypatch.setenv(key, value)
        began = time.monotonic()
        report = render(parse_scene(SCENE), url, again)
        assert time.monotonic() - began < lease.RUNS_OUT_S / 4
        assert report["tiles_resumed"] >= 1
        assert report["content_digest"] == local[1]["content_digest"]


def test_who_has_ended_is_known(monkeypatch):
    """A number of a process that another one bears now; an earlier start of one Slurm task, but
    not this start; of another machine nothing is known."""
    from pipeline.store.lease import _has_ended, _this_process

    def ended(**other):
        return _has_ended(json.dumps(_this_process() | other).encode())

    assert not ended()
    assert ended(started="1")
    assert not ended(host="another", started="1")
    for key, value in (("JOB_ID", "77"), ("CLUSTER_NAME", "c"), ("RESTART_COUNT", "2")):
        monkeypatch.setenv(f"SLURM_{key}", value)
    there = {"host": "another"}
    assert [ended(**there, restart=n) for n in (1, 2, 3)] == [True, False, False]
    assert not ended(**there, job="c:78", restart=0)
    assert not _has_ended(b"{cut")


def test_others_wait_for_a_lease(bucket):
    from catalog_tools.storage.objects import Objects
    from pipeline.store import lease

    objects = Objects(f"{bucket}/waited")
    with ThreadPoolExecutor(1) as pool:
        with lease.only_writer_of(objects):
            refused = pytest.raises(TryLater, match="--wait")
            with refused, lease.only_writer_of(objects, wait_s=0.5):
                pass
            second = lease.only_writer_of(objects, "part-1-of-2", wait_s=60.0)
            taken = pool.submit(second.__enter__)
            time.sleep(1.0)
            assert not taken.done()
        taken.result(30)
        second.__exit__(None, None, None)


def test_a_conditional_put_has_one_winner(bucket):
    from catalog_tools.storage.objects import Objects

    objects = Objects(f"{bucket}/race")
    with ThreadPoolExecutor(8) as pool:
        won = list(pool.map(lambda i: objects.create("one", b"%d" % i), range(8)))
    assert sum(won) == 1
    assert objects.get("one") == b"%d" % won.index(True)


def test_who_asks_again_has_still_won(bucket):
    """The answer to a first try may be lost on its way."""
    from catalog_tools.storage.objects import Objects

    objects = Objects(f"{bucket}/again")
    assert [objects.create("one", mine) for mine in (b"a", b"a", b"b")] == [True, True, False]
    assert objects.get("one") == b"a"


@pytest.mark.parametrize(
    "url",
    [
        "s3://bucket", "s3:///x", "http://h/x", "memory://x", "s3://b/../x", "file:///x",
        "s3://AKID:hunter2@b/x", "s3://b/x?key=hunter2", "s3://b/run*", "s3://b/run[1]", "s3:/b/x",
    ],
)  # fmt: skip
def test_bad_urls(url):
    with pytest.raises(BadInput, match="s3://BUCKET/NAME") as caught:
        render(parse_scene(SCENE), url)
    assert "hunter2" not in str(caught.value)


def test_names_are_never_patterns_and_never_lead_outside(bucket, tmp_path):
    """What others put into a bucket deletes nothing and writes no file of this machine."""
    from catalog_tools.storage.objects import Objects
    from pipeline.store.remote import bring

    objects = Objects(f"{bucket}/odd")
    for name in ("a*", "ab", "ac"):
        objects.put(name, b"1")
    objects.delete(["a*"])
    assert set(objects.names()) == {"ab", "ac"}
    for name in ("../outside", f"/{tmp_path}/outside"):
        objects.put(name, b"1")
        with pytest.raises(Damaged, match="name that no product has"):
            bring(objects, tmp_path / "stage")
        assert not list(tmp_path.rglob("outside"))
        objects.delete(n for n in objects.names() if "outside" in n)


@pytest.mark.parametrize("options", [HERE, replace(HERE, resume=True), replace(HERE, replace=True)])
def test_cut_off_before_it_was_begun(bucket, local, options):
    """Only what is put before the record of the beginning: begun anew, whatever is asked."""
    from catalog_tools.storage.objects import Objects
    objects = Objects(f"{bucket}/bare-{options.resume}-{options.replace}")
    objects.put("cube.zarr/dn/zarr.json", b"{}")
    objects.put("cube.zarr/sky_e/zarr.json", b"{}")  # a layer that is not asked for any more
    objects.put("scene.yaml", b"{}")
    made = render(parse_scene(SCENE), objects.url, options)
    assert made["content_digest"] == local[1]["content_digest"]
    assert "cube.zarr/sky_e/zarr.json" not in objects.names()


def test_places_that_do_not_answer(bucket, monkeypatch):
    with pytest.raises(BadInput, match="no-such-bucket"):
        render(parse_scene(SCENE), "s3://no-such-bucket/x", HERE)
    with pytest.raises(BadInput, match=f"PRODUCT: '{bucket}/nothing'"):
        check(f"{bucket}/nothing")


def test_a_store_that_goes_away_keeps_what_is_finished(bucket, monkeypatch):
    """Out of reach, or deleted: told, with the way to go on; one away from the start is refused."""
    from catalog_tools.storage.objects import Objects
    from catalog_tools.storage.stores import Unreachable

    url, scene, put = f"{bucket}/away", parse_scene(SCENE), Objects.put

    def away(fault):
        def broken(self, name, content, *args, **kwargs):
            if name.startswith("markers/") and self.names("markers/"):
                raise fault
            return put(self, name, content, *args, **kwargs)

        return broken

    faults = (
        (Unreachable("no route"), r"^no route; what is finished is kept \(--resume\)$"),
        (FileNotFoundError("gone"), f"^{url}: not found: gone; what is finished is kept$"),
    )
    for fault, told in faults:
        options = replace(HERE, resume=bool(Objects(url).names()))
        with monkeypatch.context() as patch:
            patch.setattr(Objects, "put", away(fault))
            with pytest.raises(Incomplete, match=told):
                render(scene, url, options)
    assert render(scene, url, replace(HERE, resume=True))["tiles_resumed"] == 1
    monkeypatch.setattr(Objects, "names", Mock(side_effect=Unreachable("no route")))
    with pytest.raises(BadInput) as caught:
        render(scene, url, HERE)
    assert str(caught.value) == (
        f"-o: '{url}' is not accepted; allowed: a place that can be reached (no route)"
    )


def test_nothing_stays_in_a_store_where_memory_ends_before_a_tile(bucket, monkeypatch):
    """Unless another writer has taken the lease over, whose objects they then are."""
    from catalog_tools.storage.objects import Objects
    from pipeline.store.lease import Lease

    objects, scene = Objects(f"{bucket}/bare"), parse_scene(SCENE)
    for lost in (False, True):
        with monkeypatch.context() as patch:
            patch.setattr("pipeline.execute.graph.render_tile", Mock(side_effect=MemoryError("9")))
            if lost:
                patch.setattr(Lease, "check", lambda self: setattr(self, "lost", True))
            with pytest.raises(MemoryError):
                render(scene, objects.url, HERE)
        left = [name for name in objects.names() if not name.startswith(".lock")]
        assert (".begun.json" in left) == bool(left) == lost


def test_a_writer_that_is_taken_over_as_it_finishes_seals_nothing(bucket, monkeypatch):
    from catalog_tools.storage.objects import Objects
    from pipeline.store import bucket as writing
    from pipeline.store.lease import Lease

    objects, bring, check_, away = Objects(f"{bucket}/over"), writing.remote.bring, Lease.check, []

    def brought(*given):
        bring(*given)
        away.append(True)

    def lost(lease):
        if away:
            raise Incomplete("another render has taken this product over")
        check_(lease)

    with monkeypatch.context() as patch:
        patch.setattr(writing.remote, "bring", brought)
        patch.setattr(Lease, "check", lost)
        with pytest.raises(Incomplete, match="taken this product over"):
            render(parse_scene(SCENE), objects.url, HERE)
    assert away
    assert not {"_COMPLETE", "report.json"} & set(objects.names())
    assert render(parse_scene(SCENE), objects.url, replace(HERE, resume=True))["tiles"] > 0
    assert check(objects.url).whole
