"""What commands beside the render tell: calibration, curves, catalogues, rays, servers; pinned."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from catalog_tools.storage.objects import Listed
from pipeline.errors import NightglassError
from tests.pins.draw import _columns, _cube
from tests.pins.scenes import IN_ORBIT, SITE, SPHERE
from tests.pins.test_told_cli import (
    SMALL,
    ahead,
    array,
    arrays,
    files,  # noqa: F401
    headers,
    here,  # noqa: F401
    masked,
    runs,
    write_scene,
)
from tests.pins.told import check_told


def emptied(*names: str) -> None:
    """Remove files and folders of an earlier test."""
    for path in map(Path, names):
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def test_calibrated_and_curves() -> None:
    """A calibrated copy with masked pixels, and light curves of targets, as numbers."""
    import pyarrow.parquet as pq

    np.save("flat24.npy", np.linspace(0.5, 1.0, 384).reshape(16, 24))
    write_scene(
        "cal",
        SMALL
        | {
            "sensor.flat": "@flat24.npy",
            "sensor.dark_e_per_s": 20.0,
            "sensor.gain_e_per_dn": 2.0,
            "sensor.detector": {"bad": {"pixels": [[3, 4], [15, 23]]}},
            "observer": IN_ORBIT,
            "targets": [ahead(SPHERE, "t", 4e6), ahead(SPHERE, "dark", 4e6, 0.05, eclipse=True)],
            "accuracy.check_cells": 0,
        },
    )
    write_scene("bare", SMALL | {"observer": SITE})
    emptied("cal", "cal-e", "cal-f", "cal-g.partial", "curve.parquet")
    Path("cal-g.partial").mkdir()
    curve = "light-curve cal.json -o curve.parquet --target"
    told = runs(f"""
        render cal.json -o cal --scheduler synchronous
        calibrate cal -o cal-e
        check cal-e
        info cal-e
        calibrate cal -o cal-e
        calibrate cal-e -o cal-h
        calibrate cal -o cal-g
        calibrate none -o x
        export cal-e --to png -o cal-e/x
        {curve} x
        {curve} t --points 1
        {curve} t --start 5
        {curve} t --stop nan
        {curve} t --start 9 --stop 3
        light-curve bare.json -o curve.parquet --target t
        {curve} t --set seed=-1
        light-curve cal.json -o none/curve.parquet --target t
    """) + arrays(_cube(Path("cal-e")))
    for wish in (
        "t",
        "dark --start -900 --stop 900 --points 7",
        "t --stop 600 --points 5 --set observer.kind=ground",
    ):
        told += runs(f"{curve} {wish}")
        if Path("curve.parquet").exists():
            table = pq.read_table("curve.parquet")
            told += f"{table.schema.metadata}\n" + arrays(_columns(table))
            Path("curve.parquet").unlink()
    Path("flat24.npy").unlink()
    told += runs("calibrate cal -o cal-i")
    check_told("cli/calibrated", told, folder=Path.cwd())


def test_catalogues() -> None:
    """Catalogues made, looked at, searched, damaged; what is refused."""
    import pyarrow.parquet as pq

    emptied("made", "demo", "sample", "rows", "cone.csv", "cone.parquet", "hurt", "map", "grey")
    shutil.copytree("layer", "map")
    make = "catalog ingest layer.csv -o made --form form.toml --workers 1"
    told = runs(
        "catalog forms",
        "catalog forms --json",
        f"{make} --name mine --rows-per-leaf 40 --json",
        make,
        f"{make} --overwrite --memory 500MB",
        f"{make} --memory lots",
        f"{make} --memory 2XB",
        "catalog ingest none.csv -o x --form form.toml",
        "catalog ingest layer.csv -o x --form no",
        "catalog info made",
        "catalog info made --json",
        "catalog info none",
        "catalog verify made",
        "catalog verify made --json",
        "catalog starlight map --order 3 --workers 1",
        "catalog starlight map --order 2 --json --workers 1",
        "catalog starlight none",
        "catalog cone stars --ra 80 --dec 20 --radius 0.02 -o cone.csv --epoch 2020.0",
        "catalog cone stars --ra 80 --dec 20 --radius 0.05 --faintest 12 -o cone.parquet",
        "catalog cone stars --ra 80 --dec 20 --radius 0.05 -o cone.csv",
        "catalog cone stars --ra 80 --dec 20 --radius 0.05 -o cone.txt",
        "catalog cone stars --ra 80 --dec 20",
        "catalog cone stars",
        "catalog cone none --corner 1",
        "catalog cone stars --ra 80 --dec 20 --radius 1 --corner 1,2",
        "catalog cone --ra 400 stars",
        "catalog cone stars --corner 1,2 --corner 3,4 -o x.csv",
        "catalog cone stars --corner a,b",
        "catalog demo -o x --rows 5 --faintest 9",
        "catalog demo -o x --as-csv",
        "catalog demo -o x --field 1,2",
        "catalog demo -o x --rows 5 --as-csv --overwrite",
        "catalog fetch gaia-dr9 --dest x",
        "catalog fetch gaia-dr2 --dest x",
        "catalog fetch gaia-dr2 --dest x --cone 1,2",
        "catalog fetch gaia-dr2 --dest x --all --cone 1,2,3",
        "catalog nothing",
    )
    told += Path("cone.csv").read_text() + arrays(_columns(pq.read_table("cone.parquet")))
    emptied("corner.csv")
    told += (
        runs(
            "catalog cone stars --corner 79.98,19.98 --corner 80.02,19.98 --corner 80,20.02 "
            "-o corner.csv --faintest 14"
        )
        + Path("corner.csv").read_text()
    )
    head, *rows = Path("layer.csv").read_text().splitlines()
    grey = [head, *(f"{row.rsplit(',', 2)[0]},," for row in rows[:40]), *rows[40:]]
    Path("grey.csv").write_text("\n".join(grey))
    write_scene("grey", {"stars": {"catalogue": "@grey"}})
    told += runs("""
        catalog ingest grey.csv -o grey --form form.toml --workers 1 --json
        plan grey.json
    """)
    shutil.copytree("made", "hurt")
    shard = max(Path("hurt").rglob("*.parquet"), key=lambda p: p.stat().st_size)
    shard.write_bytes(shard.read_bytes()[:-9] + b"123456789")
    told += runs("""
        catalog verify hurt
        catalog verify hurt --json
    """)
    check_told("cli/catalogues", told, folder=Path.cwd())


def test_cosmic_rays() -> None:
    """A library from dark frames, compared; what is refused."""
    rng = np.random.default_rng(5)
    darks = rng.normal(100.0, 3.0, (3, 40, 60))
    darks[0, 5, 7:12], darks[1, 20:24, 30], darks[2, 33, 50] = 400.0, 250.0, 900.0
    np.save("darks.npy", darks)
    emptied("lib.fits", "lib.png")
    wish = "--exposure-s 100 --pixel-pitch-um 9 darks.npy"
    make = f"cosmic-rays extract {wish} -o"
    told = runs(f"""
        {make} lib.fits --gain-e-per-dn 2
        {make} lib.fits
        {make} none/x.fits
        {make} x.txt
        {make} x.fits --exposure-s 0
        {make} x.fits --pixel-pitch-um nan
        {make} x.fits --gain-e-per-dn -1
        {make} x.fits --threshold-sigma 2
        {make} x.fits --grow-sigma 0.5
        {make} x.fits --grow-sigma 7
        cosmic-rays extract none.npy --exposure-s 1 --pixel-pitch-um 9 -o x.fits
        cosmic-rays compare lib.fits -o x.txt
        cosmic-rays compare none.fits -o x.png
        cosmic-rays compare rays.fits -o none/x.png
    """)
    from pipeline.inputs.sensor.cosmic_ray_library import read_library

    told += array_fields(read_library(Path("lib.fits"), "LIBRARY"))
    check_told("cli/rays", told, folder=Path.cwd())


def array_fields(value: Any) -> str:
    return "".join(f"{k}: {array(v)}\n" for k, v in sorted(vars(value).items()) if v is not None)


FACTS: dict[str, Any] = {
    "id": "j1",
    "name": "pin",
    "kind": "render",
    "phase": "ERROR",
    "tiles_done": None,
    "tiles_total": 4,
    "submitted": "2019-12-01T08:00:00.123456Z",
    "links": ["x"],
    "started": None,
    "error": {
        "message": "no such scene",
        "errors": [{"pointer": "/seed", "value": -1, "allowed": "0 or more; " * 12}],
    },
}


class Job:
    """A job of a server that is not there; Ctrl-C while it is waited for where it is told to."""

    def __init__(self, kind: str, said: list[str], cut: bool) -> None:
        self.id, self.facts, self.said, self.cut = "j1", FACTS | {"kind": kind}, said, cut

    def wait(self, **more: Any) -> Job:
        self.said.append(f"wait {more}")
        if self.cut:
            raise KeyboardInterrupt
        return self

    def __getattr__(self, name: str) -> Any:
        def told(*values: Any, **more: Any) -> Any:
            self.said.append(f"{name} {[*map(str, values)]} {more}")
            if name != "report":
                return f"{name} done"
            return {
                "points": 2,
                "seconds": 1.0,
                "failed": 1,
                "messages": {"too bright": 1},
                "metrics": {"snr": {"known": 1, "least": 1.0, "largest": 2.0}},
            }

        return told


class Client:
    """What the commands ask of a server's client."""

    def __init__(self, said: list[str], kind: str, cut: bool) -> None:
        self.said, self.one = said, Job(kind, said, cut)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def jobs(self, phase: str | None) -> list[Job]:
        self.said.append(f"jobs {phase}")
        return [self.one]

    def job(self, name: str) -> Job:
        self.said.append(f"job {name}")
        return self.one

    def sweep(self, file: Path) -> Job:
        return self.job(f"sweep {file}")

    def submit(self, scene: Any) -> Job:
        return self.job(f"submit {scene['seed']} {scene.get('accept')}")

    def plan(self, scene: Any) -> Any:
        from pipeline.route.prepare import plan_scene
        from pipeline.spec.load import parse_scene

        self.job(f"plan {scene['seed']}")
        return plan_scene(parse_scene(scene))


@pytest.mark.parametrize("kind", ["render", "sweep", "cut"])
def test_servers(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is asked of a server, and what is told of its answers."""
    said: list[str] = []
    write_scene("small", SMALL)
    emptied("x")
    client = Client(said, kind, kind == "cut")
    monkeypatch.setattr(
        "pipeline.commands.jobs.connect", lambda server: (said.append(server), client)[1]
    )
    monkeypatch.setattr(
        "pipeline.commands.render.print_report", lambda report, to: print(report, to)
    )
    there = "--server http://h"
    told = runs(f"""
        jobs fetch j1 {there} -o x
        render small.json -o x {there} --json
        sweep small.json -o x {there}
    """)
    told += (
        ""
        if kind != "render"
        else runs(f"""
        jobs list {there}
        jobs list {there} --phase error --json
        jobs show j1 {there} --json
        jobs show j1 {there}
        jobs cancel j1 {there}
        jobs retry j1 {there}
        jobs fetch j1 {there} -o x --no-wait
        jobs list
        render small.json -o x {there} --set seed=5 --accept sun
        plan small.json {there}
        render none.json -o x {there}
        sweep small.json -o x {there} --json
        sweep small.json -o x {there} --point 1
        sweep small.json {there} -o stars
        sweep small.json -o x {there} --resume
        render small.json -o stars {there}
    """)
    )
    check_told(f"cli/servers-{kind}", told + "\n".join(said), folder=Path.cwd())


STORE: dict[str, tuple[bytes, datetime]] = {}


class Kept:
    """An object store in memory, as `catalog_tools.storage.objects.Objects` is one."""

    def __init__(self, url: str) -> None:
        self.url = url

    def put(self, name: str, content: bytes) -> None:
        STORE[f"{self.url}/{name}"] = (content, datetime.now(UTC))

    def create(self, name: str, content: bytes) -> bool:
        if f"{self.url}/{name}" not in STORE:
            self.put(name, content)
        return self.get(name) == content

    def get(self, name: str) -> bytes | None:
        return STORE.get(f"{self.url}/{name}", (None,))[0]

    def get_many(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        return ((name, STORE[f"{self.url}/{name}"][0]) for name in list(names))

    def names(self, prefix: str = "") -> dict[str, Listed]:
        at, skip = f"{self.url}/{prefix}", len(self.url) + 1
        return {
            n[skip:]: Listed(len(c), t) for n, (c, t) in sorted(STORE.items()) if n.startswith(at)
        }

    def delete(self, names: Iterable[str]) -> None:
        for name in list(names):
            STORE.pop(f"{self.url}/{name}", None)


def test_object_store(monkeypatch: pytest.MonkeyPatch) -> None:
    """Products of an object store: whole, in parts, gone on with, damaged, held by another."""
    for place in ("pipeline.store.bucket.open_objects", "pipeline.store.remote.Objects"):
        monkeypatch.setattr(place, lambda url, *_: Kept(url))
    monkeypatch.setattr("pipeline.route.run.JOIN_AGAIN_S", 0.0)
    STORE.clear()
    write_scene("small", SMALL | {"exposure.frames": 2, "accuracy.check_cells": 0})
    at, one = "render small.json -o s3://b/n", "--scheduler synchronous"
    part = f"render small.json -o s3://b/p {one} --part"
    told = runs(f"""
        check s3://b/n
        join s3://b/n
        {at} {one} --resume
        {at} {one}
        {at}
        {at} --resume
        {at} --resume --set seed=8
        check s3://b/n
    """)
    Kept("s3://b/n").put("cube.zarr/dn/c/1/0/0", b"worse")
    Kept("s3://b/n").put("markers/f000000_r000_c000.json", b"{}")
    told += runs(f"""
        check s3://b/n --json
        {at} --resume {one}
        check s3://b/n
    """)
    Kept("s3://b/n").put("preview.png", b"worse")
    told += runs(f"""
        check s3://b/n
        {at} --replace {one}
        check s3://b/n
    """)
    Kept("s3://b/n").put("../x", b"")
    told += runs("check s3://b/n")
    Kept("s3://b/o").put("mine.txt", b"")
    told += runs(
        *(f"render small.json -o s3://b/o {w}" for w in ("", "--resume", "--replace", "--part 1/2"))
    )
    told += runs(f"""
        {part} 2/2
        join s3://b/p
        {part} 2/2 --json
        {part} 1/2
        check s3://b/p
        join s3://b/p
        join s3://b/p small.json --json
        {part} 1/2
    """)
    Kept("s3://b/q").put("scene.yaml", b"")
    Kept("s3://b/q").put("cube.zarr/dn/zarr.json", b"")
    told += runs(f"render small.json -o s3://b/q {one} --resume")
    for holder in ({"pid": 1, "host": "elsewhere"}, {"job": "c:7", "restart": 0}):
        Kept("s3://b/n").put(".lock/000000000009", json.dumps(holder).encode())
        told += runs(f"""
            {at} --resume
            join s3://b/p
        """)
        monkeypatch.setenv("SLURM_JOB_ID", "7")
        monkeypatch.setenv("SLURM_CLUSTER_NAME", "c")
        monkeypatch.setenv("SLURM_RESTART_COUNT", "1")
        told += runs(f"{at} --resume")
    Kept("s3://b/p").put(".lock-part-1-of-2/000000000003", b'{"pid": 1, "host": "elsewhere"}')
    told += runs(f"""
        join s3://b/p
        {part} 1/2
        {part} 2/2
    """)
    left = sorted(name for name in STORE if "/n/" in name)
    check_told("cli/store", told + "\n".join(left), folder=Path.cwd())


def test_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors of all kinds at the command line: one message, one exit code."""
    from catalog_tools.errors import Damaged, DiskFull, Incomplete, TryLater
    from pipeline.errors import Interrupted, exit_code

    class Answer(NightglassError):
        status = 0

    write_scene("small", SMALL)
    emptied("x")
    told = ""
    for error in (
        KeyboardInterrupt(),
        OSError(28, "full", "x/y"),
        OSError(5, "broken"),
        Damaged("p", "w"),
        Incomplete("i"),
        TryLater("t"),
        RuntimeError("odd"),
        Interrupted("z"),
        *(type("A", (Answer,), {"status": s})("s") for s in (0, 429, 503, 404, 500)),
    ):

        def fail(*_: Any, error: BaseException = error) -> None:
            raise error

        monkeypatch.setattr("pipeline.route.run.prepare", fail)
        told += f"{type(error).__name__} {exit_code(error)}\n"
        told += runs("""
            render small.json -o x --replace --set seed=2
            check none
        """)
        told += runs("render small.json -o x --part 1/2") if isinstance(error, OSError) else ""
    told += f"{exit_code(DiskFull('a', 'b', 'c'))}\n"
    check_told("cli/faults", told, folder=Path.cwd())


def test_judged() -> None:
    """What is said against scenes before they are planned."""
    from pipeline.route.judge import judge
    from pipeline.spec.load import load_scene

    told = ""
    np.save("odd.npy", np.ones((3, 3)))
    for name, changes in {
        "good": {},
        "sun": {"pointing.boresight_ra_deg": 240.0, "pointing.boresight_dec_deg": -20.0},
        "flat": {"sensor.flat": "@odd.npy"},
        "none": {"sensor.flat": "@none.npy"},
        "map": {"sensor.detector": {"bad": {"map": "@odd.npy"}}},
        "band": {"sensor.bandpass": {"kind": "table", "path": "@stars.csv"}},
        "psf": {"sensor.psf": {"kind": "table", "path": "@odd.npy", "samples_per_px": 0.1}},
        "early": {"epoch": "1900-01-01T00:00:00Z"},
        "fast": {
            "pointing": {
                "mode": "rate",
                "boresight_ra_deg": 1.0,
                "boresight_dec_deg": 2.0,
                "rate_ra_arcsec_s": 1e6,
                "rate_dec_arcsec_s": 0.0,
            }
        },
    }.items():
        try:
            judge(load_scene(Path(write_scene("judged", changes))))
            told += f"{name}: nothing\n"
        except NightglassError as error:
            told += f"{name}: {error}\n"
    check_told("cli/judged", masked(told), folder=Path.cwd())


SKIES = ["error", "sun", "moon", "daylight", "coverage"]


def test_other_products() -> None:
    """A site's product of images and a bent camera as FITS; one pixel as a film."""
    np.save("gain24.npy", np.linspace(0.9, 1.1, 384).reshape(16, 24))
    site = {
        "observer": SITE,
        "accept": SKIES,
        "stars": {"catalogue": "@stars", "faintest_g_mag": 11.0},
    }
    bent = {"kind": "radial", "k1": 4e4, "k2": -3e9, "k3": 1e14, "p1": 0.5, "p2": -0.3}
    image = {"sensor.gain_e_per_dn": "@gain24.npy", "sensor.full_well_e": 9e3}
    band = {"sensor.bandpass": {"kind": "named", "name": "bessell-V"}, "sensor.distortion": bent}
    write_scene("site", SMALL | site | image | band | {"exposure.frames": 1})
    write_scene(
        "dot",
        {"sensor.shape": [1, 1], "accept": SKIES, "sensor.full_well_e": 5e3, "sensor.bias_dn": 9.5},
    )
    emptied("site", "dot", "site-x", "dot-x", "dot.mp4", "dot.gif", "site-m")
    told = runs("""
        render site.json -o site --scheduler synchronous
        export site --to fits -o site-x
        export site --to masks --light layers -o site-m
        render dot.json -o dot --scheduler synchronous
        export dot --to fits -o dot-x
        export dot --to mp4 -o dot.mp4
        export dot --to gif -o dot.gif
        import satsim none.json -o x.yaml
        import simsit none.yaml -o x.yaml
        report scenes --scene none -o x
        report detection none -o x
        catalog cone stars --ra 80 --dec 20 --radius 2 -o wide.csv --faintest 9.2
        info stars
        serve --port -1
        worker
    """)
    seen: set[str] = set()
    told += headers(Path("site-x/frame-00000.fits"), seen)
    told += headers(Path("dot-x/frame-00000.fits"), seen)
    check_told("cli/others", told, folder=Path.cwd())


def test_pictures() -> None:
    """Grey levels, binned images, masks as text, paths across a frame, films, lines of text."""
    from pipeline.export import coco, labels, masks, picture
    from pipeline.lines import table
    from pipeline.route.shares import parse_part

    rng = np.random.default_rng(4)
    image = rng.normal(100.0, 5.0, (50, 70))
    image[20, 30], image[3, 4] = 5000.0, np.nan
    told = (
        f"{[f'{v:.9g}' for v in picture.limits_of(image)]} {picture.limits_of(np.ones((3, 3)))}\n"
    )
    told += arrays(
        {
            "own": picture.stretch(image),
            "set": picture.stretch(image, picture.GreyLimits(90, 4, 200)),
            "nan": picture.stretch(np.full((2, 2), np.nan)),
        }
    )
    for side in (100, 32, 1):
        small, factor = picture.shrink(image, side)
        told += f"{factor} {array(small)}\n"
    light = np.hypot(*np.mgrid[-4:5, -6:7]).max() - np.hypot(*np.mgrid[-4:5, -6:7])
    for place in ((0, 0), (-5, 30), (14, -8), (40, 2), (16, 19)):
        mask = masks._cut(*place, light, (20, 24), 4.0)
        counts = coco.run_lengths(mask, (20, 24))
        told += f"{place}: {mask.box} {mask.y0} {mask.x0} {counts} {coco.packed(counts)}\n"
    told += coco.packed([0, 5, 900, 31, 32, 2**20, 7])
    told += f"\n{array(masks._as_disc(3, 4, light, 2.5)[2])}\n"
    n = 8
    ends = {
        "x_start_px": [-9, -9, 5, 5, 23.4, 23.6, -3, 12],
        "x_end_px": [40, -2, 5, 5, 23.4, 30, 9, 12],
        "y_start_px": [-9, 3, 3, -8, 19.4, 9, 25, -0.5],
        "y_end_px": [30, 9, 3, -2, 19.4, 9, 5, -0.6],
    }
    whole = {k: np.zeros(n) for k in labels.Labels.__dataclass_fields__}
    whole |= {k: np.array(v, float) for k, v in ends.items()} | {"kind": np.array([1, 2] * 4)}
    whole |= {f"{a}_px": 0.5 * (whole[f"{a}_start_px"] + whole[f"{a}_end_px"]) for a in "xy"}
    found = labels.Labels(**whole)
    told += f"{labels._crosses(found, (20, 24))}\n"
    told += arrays({"length": found.length_px, "angle": found.angle_deg, "mag": found.magnitude})
    for part in ("1/1", "3/16", "2/1", "1000000/1000000", "1/1000001"):
        try:
            told += f"{parse_part(part).name}\n"
        except NightglassError as error:
            told += f"{error}\n"
    rows = [("a job of many words", "pin", "ERROR", "2019"), ("b", "", "RUN", "12345")]
    told += table(("job", "name", "phase of it", "at"), rows, 2) + "\n"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "24")
        told += table(("job", "name", "phase of it", "at"), rows, 2)
    check_told("cli/pictures", told)


def test_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """What bars show, and what they are told."""
    from types import SimpleNamespace

    from pipeline.commands import pages
    from pipeline.route.draw import Progress
    from pipeline.sweep.run import SweepProgress

    told = ""
    for column in pages.progress_bar("tiles").columns:
        told += f"{type(column).__name__} {getattr(column, 'text_format', '')}\n"
        for speed in (None, 0.02, 0.5, 31.4159) if type(column).__name__ == "Rate" else ():
            task = SimpleNamespace(finished_speed=None, speed=speed)
            told += f"  {speed}: {column.render(task)}\n"  # type: ignore[arg-type]
    said: list[str] = []

    class Bar(Client):
        def add_task(self, *values: Any, **more: Any) -> int:
            said.append(f"task {values} {more}")
            return 3

        def update(self, *values: Any, **more: Any) -> None:
            said.append(f"update {values} {more}")

    def bar(unit: str = "") -> Bar:
        said.append(f"bar of {unit}")
        return Bar(said, "", False)

    monkeypatch.setattr(pages, "progress_bar", bar)
    for quiet in (True, False):
        with pages.tile_progress(quiet) as tiles, pages.stage_progress(quiet, "shards") as stages:
            if tiles is not None and stages is not None:
                tiles(Progress(0, 5, "wait"))
                tiles(Progress(2, 5, "tile"))
                stages("sorting", 1, None)
        with pages.progress_listener("points", quiet) as points:
            for failed in (0, 4) if points is not None else ():
                points(SweepProgress(6, 9, failed))
    check_told("cli/progress", told + "\n".join(said))
