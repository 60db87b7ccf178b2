"""Sweeps over REST: taken, run and fetched like jobs; no axis names a file or grows a point."""

from __future__ import annotations

import copy
import io
import json
import tarfile
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from pipeline.errors import BadInput, Damaged
from pipeline.plan.cost import least_noise_s
from pipeline.spec.load import InvalidScene, load_scene
from pipeline.store.product import check
from pipeline.sweep.ledger import is_complete
from service.client import Client
from service.problems import NotAllowed, PlanRefused, mistake_dict, mistakes_of, within
from service.scenes.sweeps import accept_sweep
from service.settings import Settings


@pytest.fixture
def sweep(scene: dict[str, Any]) -> dict[str, Any]:
    """Four points of the small scene."""
    return {
        "schema": "nightglass/sweep/1",
        "name": "four",
        "scene": scene,
        "axes": [{"field": "sensor.read_noise_e", "values": [1.0, 2.0, 4.0, 8.0]}],
    }


def test_a_dry_run_answers_size_and_plan_and_makes_no_job(
    server: Any, sweep: dict[str, Any]
) -> None:
    def count() -> int:
        return sum(server.client.get("/v1/usage").json()["jobs"].values())

    before = count()
    answer = server.client.post("/v1/sweeps?dry_run=1", json=sweep)
    assert answer.status_code == 200, answer.text
    told = answer.json()
    assert (told["points"], told["pixel_frames"]) == (4, 4 * 2 * 64 * 64)
    assert told["base"] == server.client.post("/v1/jobs?dry_run=1", json=sweep["scene"]).json()
    assert count() == before


@pytest.mark.parametrize("dry_run", [False, True])
@pytest.mark.parametrize(
    ("wrong", "pointer", "said"),
    [
        ({"axes": [{"field": "sensor.nope", "values": [1.0]}]}, "/axes/0", "known keys: adc_bits"),
        ({"axes": [{"field": "sensor.gain_e_per_dn", "values": [1.0, -1.0]}]}, "/axes/0", "0"),
        ({"targets": ["nobody"]}, "/targets/0", "the name of a target"),
        ({"scene": {"sensor": {"shape": [0, 64]}}}, "/scene/sensor/shape/0", "1"),
    ],
)
def test_what_no_point_can_be_is_refused_at_once(
    wrong: dict[str, Any],
    pointer: str,
    said: str,
    dry_run: bool,
    server: Any,
    sweep: dict[str, Any],
) -> None:
    """By where it stands in the body, as the command line refuses it."""
    base = copy.deepcopy(sweep["scene"])
    base["sensor"] |= wrong.get("scene", {}).get("sensor", {})
    body = sweep | wrong | {"scene": base}
    answer = server.client.post(f"/v1/sweeps?dry_run={int(dry_run)}", json=body)
    assert answer.status_code == 422, answer.text
    first = answer.json()["errors"][0]
    assert first["pointer"] == pointer
    assert said in first["allowed"]


def test_mistakes_of_the_base_are_named_by_their_place_in_the_body() -> None:
    """Whoever finds them: the form, this service, a plan."""
    listed = [("sensor.shape", [0, 1], "allowed: 1 or more"), ("name", 7, "allowed: text")]
    planned = {"message": "no", "errors": [mistake_dict(("", 1, "less")), mistake_dict(listed[0])]}
    found = []
    for error in (
        InvalidScene(listed), BadInput("epoch", "x", "a date"),
        NotAllowed("no", (listed[0],)), PlanRefused(planned),
    ):  # fmt: skip
        with pytest.raises(type(error)) as refused, within("scene"):
            raise error
        told = refused.value
        errors = getattr(told, "errors", None) or [mistake_dict(m) for m in mistakes_of(told)]
        found.append([one["pointer"] for one in errors])
    assert found == [
        ["/scene/sensor/shape", "/scene/name"], ["/scene/epoch"],
        ["/scene/sensor/shape"], ["/scene", "/scene/sensor/shape"],
    ]  # fmt: skip


def test_by_the_client(
    server: Any, sweep: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file whose base scene is another one beside it; the table of its points; no frames."""
    empty = tmp_path / "empty"
    empty.mkdir()
    (tmp_path / "base.json").write_text(json.dumps(sweep["scene"]))
    (tmp_path / "sweep.json").write_text(json.dumps(sweep | {"scene": "base.json"}))
    with Client(server.url) as client:
        job = client.sweep(tmp_path / "sweep.json", "by-client")
        assert client.sweep(sweep, "by-client").id == job.id  # the same body
        table = job.wait(progress=False).points()
        assert table["sensor.read_noise_e"].to_pylist() == [1.0, 2.0, 4.0, 8.0]
        for ask in (job.open, lambda: job.fetch(tmp_path / "out")):
            with pytest.raises(BadInput, match=r"points\(\)"):
                ask()
        job.fetch_sweep(tmp_path / "out")
        fetched = pq.read_table(tmp_path / "out" / "points.parquet")
        assert fetched.equals(table)
        assert is_complete(tmp_path / "out")
        with pytest.raises(BadInput, match="does not exist yet"):
            job.fetch_sweep(tmp_path / "out")
        monkeypatch.chdir(empty)
        with pytest.raises(BadInput, match=r"-o: .* a folder below this one"):
            job.fetch_sweep(Path())
        job.delete()
        (tmp_path / "base.json").unlink()
        with pytest.raises(BadInput, match=r"base\.json"):
            client.sweep(tmp_path / "sweep.json")


def test_the_cubes_that_a_sweep_keeps_are_fetched_with_their_records(
    server: Any, sweep: dict[str, Any], tmp_path: Path
) -> None:
    """Each is a product that `check` finds whole; one that was damaged on its way is refused."""
    with Client(server.url) as client:
        made = client.sweep(sweep | {"cubes": [1, 2]}).wait(progress=False)
        made.fetch_sweep(tmp_path / "out")
        cubes = sorted((tmp_path / "out" / "cubes").iterdir())
        assert [cube.name for cube in cubes] == ["0000001", "0000002"]
        for cube in cubes:
            assert (check(cube).whole, list(check(cube).faults)) == (True, [])
            scene = load_scene(cube / "scene.yaml")
            assert scene.sensor.read_noise_e == 2.0 ** int(cube.name)
        for point, status in ((2, 200), (3, 404), (-1, 422), (10**300, 422)):
            answer = server.client.get(f"/v1/jobs/{made.id}/record", params={"point": point})
            assert answer.status_code == status
        answer = server.client.get(f"/v1/jobs/{made.id}/product.tar")
        with tarfile.open(fileobj=io.BytesIO(answer.content)) as tar:
            tar.extractall(tmp_path / "tar", filter="data")
        assert [check(p).whole for p in sorted(tmp_path.glob("tar/*/cubes/*"))] == [True, True]
        chunks = server.home.rglob(f"{made.id}/cubes/0000001/cube.zarr/dn/c/*/*/*")
        chunk = next(path for path in chunks if path.is_file())
        chunk.write_bytes(bytes(chunk.stat().st_size))
        with pytest.raises(Damaged, match=r"cubes/0000001: .*; fetch it again"):
            made.fetch_sweep(tmp_path / "again")
        assert not (tmp_path / "again").exists()


def test_by_the_command_line(
    server: Any, sweep: dict[str, Any], tmp_path: Path, capsys: Any
) -> None:
    """`nightglass sweep FILE --server URL`: its results come into the folder."""
    from pipeline.commands.sweep import sweep as command

    file, out = tmp_path / "sweep.json", tmp_path / "run"
    file.write_text(json.dumps(sweep))
    command(file, out, server=server.url, as_json=True)
    assert json.loads(capsys.readouterr().out)["points"] == 4
    assert pq.read_table(out / "points.parquet").num_rows == 4
    two = tmp_path / "two"
    base = tmp_path / "scene.json"
    base.write_text(json.dumps(sweep["scene"]))
    file.write_text(json.dumps(sweep | {"scene": "scene.json"}))
    set_ = ["axes.0.values=[3, 5]", "scene.seed=41"]
    command(file, two, set_, server=server.url, as_json=True)
    assert json.loads(capsys.readouterr().out)["points"] == 2
    assert json.loads((two / "sweep.json").read_text())["scene"]["seed"] == 41
    with pytest.raises(BadInput, match="no axis"):
        command(file, two, ["scene.sensor.read_noise_e=3"], server=server.url)
    for options in ({"workers": 2}, {"point": 1}, {"resume": True}):
        with pytest.raises(BadInput, match="--server"):
            command(file, tmp_path / "other", server=server.url, **options)
    with pytest.raises(BadInput, match="-o"):
        command(file, out, server=server.url)
    with pytest.raises(BadInput, match=r"no\.yaml"):
        command(tmp_path / "no.yaml", tmp_path / "other", server=server.url)


def test_a_sweep_is_a_job(server: Any, sweep: dict[str, Any]) -> None:
    """Its base scene reads a file that was sent."""
    content = b"wavelength_nm,transmission\n400,0.5\n900,0.5\n"
    sent = server.client.post("/v1/files?name=band.csv", content=content).json()["id"]
    sweep["scene"]["sensor"]["bandpass"] = {"kind": "table", "path": sent}
    key = {"idempotency-key": "sweep"}
    made = server.client.post("/v1/sweeps", json=sweep, headers=key)
    assert made.status_code == 202, made.text
    assert server.client.post("/v1/sweeps", json=sweep, headers=key).status_code == 200
    job = made.headers["location"]
    done = server.ended(job)
    assert (done["phase"], done["kind"], done["tiles_done"]) == ("COMPLETED", "sweep", 4), done
    files = {f["path"]: f["href"] for f in server.client.get(f"{job}/results").json()["files"]}
    table = pq.read_table(io.BytesIO(server.client.get(files["points.parquet"]).content))
    assert table.num_rows == 4
    assert server.client.get(f"{job}/report").json()["points"] == 4
    assert server.client.get(f"{job}/preview.png").status_code == 404
    outputs = server.client.get(f"/ogc/jobs/{job.rpartition('/')[2]}/results").json()
    assert list(outputs) == ["report"]
    assert server.client.get(outputs["report"]["href"]).status_code == 200
    for href in files.values():
        assert str(server.home).encode() not in server.client.get(href).content, href


BAD: dict[str, list[dict[str, Any]]] = {
    "a file": [{"field": "sensor.flat", "values": ["/etc/passwd", "x.npy"]}],
    "a file inside": [{"field": "sensor.bandpass", "values": [{"kind": "table", "path": "/x"}]}],
    "a URL": [{"field": "sensor.quantum_efficiency", "values": ["http://127.0.0.1/x"]}],
    "in a table": [{"kind": "table", "fields": ["sensor.flat", "seed"], "rows": [["/etc/x", 1]]}],
    "size": [{"field": "sensor.shape", "values": [[9999, 9999]]}],
    "size inside": [{"field": "sensor", "values": [{}]}],
    "frames": [{"field": "exposure.frames", "values": [10**6]}],
    "dwells": [{"field": "dwells", "values": [[{"integration_s": 0.1, "frames": 10**6}]]}],
    "populations": [{"field": "populations", "values": [[], []]}],
    "catalogue": [{"field": "stars", "values": [{"catalogue": "/etc"}]}],
    "targets": [{"field": "targets", "values": [[]]}],
    "target": [{"field": "targets.0.body.path", "values": ["/etc/passwd"]}],
    "a whole target": [{"field": "targets.0", "values": [{}]}],
    "points": [{"kind": "range", "field": f"x{i}", "start": 0, "stop": 1, "count": 9999}
               for i in range(3)],
    "a blank before": [{"field": " sensor.quantum_efficiency", "values": [0.5, "/etc/passwd"]}],
    "a blank after": [{"field": "sensor.shape ", "values": [[9999, 9999]]}],
}  # fmt: skip


@pytest.mark.parametrize("axes", BAD.values(), ids=BAD.keys())
def test_axes_that_are_refused(server: Any, sweep: dict[str, Any], axes: Any) -> None:
    answer = server.client.post("/v1/sweeps", json=sweep | {"axes": axes})
    assert answer.status_code == 422, answer.text
    assert json.loads(answer.text)["errors"]


def test_base_scenes_that_are_refused(server: Any, sweep: dict[str, Any]) -> None:
    for base in ("scene.yaml", "/etc/passwd", {}, None):
        assert server.client.post("/v1/sweeps", json=sweep | {"scene": base}).status_code == 422
    wrong = copy.deepcopy(sweep)
    wrong["scene"]["sensor"]["flat"] = "/etc/passwd"
    assert server.client.post("/v1/sweeps", json=wrong).status_code == 422
    assert server.client.post("/v1/sweeps", json=sweep["scene"]).status_code == 422


def test_a_sweep_may_not_take_too_long(
    make_server: Any, sweep: dict[str, Any], tmp_path: Path
) -> None:
    """As a scene: by the noise of its points when it is sent, by its plan before it is drawn."""
    pixels = 4 * 2 * 64 * 64
    asked = least_noise_s(1000 * pixels)
    many = sweep | {"seeds": 1000}
    assert accept_sweep(many, Settings(tmp_path, job_cpu_s=asked + 0.1))[1] == 1000 * pixels
    with pytest.raises(NotAllowed, match=r"axes: a sweep of at most .* CPU s \(forecast: 5\)"):
        accept_sweep(many, Settings(tmp_path, job_cpu_s=asked - 0.1))
    server = make_server(NIGHTGLASS_JOB_CPU_S="3.55")
    less = copy.deepcopy(sweep)
    less["scene"]["accuracy"] = {"check_cells": 0}
    job = server.client.post("/v1/sweeps", json=less)
    assert job.status_code == 202, job.text
    ended = server.ended(job.headers["location"])
    assert ended["phase"] == "ERROR"
    assert "a sweep of at most 3.55 CPU s" in str(ended["error"]), ended


@pytest.mark.parametrize(("cubes", "kept"), [("all", 4), ([1, 3], 2), ("none", 0)])
def test_products_of_points_count_together(
    sweep: dict[str, Any], tmp_path: Path, cubes: Any, kept: int
) -> None:
    """Each has two frames of 64 x 64 pixels, 2 bytes of `dn` and 4 of the mean."""
    sweep["scene"]["output"] = {"layers": ["dn", "mean_e"]}
    one = 2 * 64 * 64 * (2 + 4)
    wanted = sweep | {"cubes": cubes}
    accept_sweep(wanted, Settings(tmp_path, product_bytes=max(kept, 1) * one))
    if kept > 1:
        with pytest.raises(NotAllowed, match=f"cubes: points .* \\(asked: {kept * one}\\)"):
            accept_sweep(wanted, Settings(tmp_path, product_bytes=kept * one - 1))


@pytest.mark.parametrize(("bits", "each"), [([16, 63], 8), ([10, 14], 2), ([8, 20], 4)])
def test_points_of_other_bits_count_as_the_widest(
    sweep: dict[str, Any], tmp_path: Path, bits: list[int], each: int
) -> None:
    """An axis of bits may take `dn` from 2 bytes a pixel to 8."""
    sweep["axes"] = [{"kind": "list", "field": "sensor.adc_bits", "values": bits}]
    wanted, most = sweep | {"cubes": "all"}, 2 * 2 * 64 * 64 * each
    accept_sweep(wanted, Settings(tmp_path, product_bytes=most))
    with pytest.raises(NotAllowed, match=f"asked: {most}"):
        accept_sweep(wanted, Settings(tmp_path, product_bytes=most - 1))
