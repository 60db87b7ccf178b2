"""What an extra brings and is not installed: every place names what needs it and the extra."""

from __future__ import annotations

import pickle
import sys
import tomllib
from collections.abc import Callable
from html import unescape
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from catalog_tools.catalogue import open_catalogue
from catalog_tools.engine.clusters import slurm
from catalog_tools.storage import objects, stores
from pipeline.capacity.page import _pictures
from pipeline.errors import BadInput, Missing, exit_code
from pipeline.export.movie import encoder
from pipeline.inputs.targets.meshes import read_mesh
from pipeline.lazily import blank_figure
from pipeline.light_curve import write_light_curves
from pipeline.studies.detection.points import find_points
from pipeline.studies.detection.study import report_detection
from pipeline.studies.ledger.report import report_ledger
from service.client import Client, RemoteJob
from service.problems import mistake_dict, mistakes_of
from service.store.database import connect

ROOT = Path(__file__).resolve().parents[1]


def extras() -> dict[str, list[str]]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return project["optional-dependencies"]


def mesh(tmp_path: Path) -> None:
    (tmp_path / "one.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    read_mesh(tmp_path / "one.obj", "m", "targets.0.body.path")


def remote_job(tmp_path: Path) -> None:
    facts = {"id": "a", "name": "a", "kind": "scene", "phase": "COMPLETED"}
    RemoteJob(Client("http://127.0.0.1:9"), facts).open()


def at_slurm(tmp_path: Path) -> None:
    with slurm(1):
        pass


# module hidden: what needs which package; extra; what else can be done; the call
PLACES: list[tuple[str, str, str, str, str, Callable[[Path], Any]]] = [
    ("imageio_ffmpeg", "--to: MP4 movies need imageio-ffmpeg", "imageio-ffmpeg", "movie",
     "use --to gif", lambda _: encoder()),
    ("trimesh", "the ledger's meshes need trimesh", "trimesh", "mesh",
     "", lambda p: report_ledger(p / "out")),
    ("trimesh", "targets.0.body.path: meshes need trimesh", "trimesh", "mesh", "", mesh),
    ("sep", "studies of detection need sep", "sep", "detection",
     "", lambda p: report_detection(p, p / "out")),
    ("matplotlib", "studies of detection need matplotlib", "matplotlib", "detection",
     "", lambda p: report_detection(p, p / "out")),
    ("sep", "finders of sources need sep", "sep", "detection",
     "", lambda _: find_points(None, 1.0, 5.0)),
    ("matplotlib", "figures need matplotlib", "matplotlib", "report",
     "", lambda _: blank_figure((1.0, 1.0))),
    ("matplotlib", "figures need matplotlib", "matplotlib", "report",
     "leave out --plot", lambda p: write_light_curves(iter(()), p / "a", p / "b")),
    ("dask_jobqueue", "--scheduler slurm: workers of Slurm need dask-jobqueue", "dask-jobqueue",
     "slurm", "", at_slurm),
    ("s3fs", "catalogue: s3:// URLs need s3fs", "s3fs", "remote",
     "", lambda _: open_catalogue("s3://b/c")),
    ("aiohttp", "catalogue: http:// URLs need aiohttp", "aiohttp", "remote",
     "", lambda _: open_catalogue("http://h/c")),
    ("s3fs", "-o: s3:// URLs need s3fs", "s3fs", "remote",
     "name a folder", lambda _: objects.open_objects("s3://b/c")),
    ("aiohttp", "cubes read over HTTP need aiohttp", "aiohttp", "remote",
     "give a folder to fetch the product into", remote_job),
    ("psycopg", "NIGHTGLASS_DATABASE: job tables in PostgreSQL need psycopg", "psycopg",
     "postgresql", "use SQLite", lambda _: connect("postgresql://one:hunter2@127.0.0.1:9/jobs")),
]  # fmt: skip


@pytest.fixture(autouse=True)
def _nothing_kept(monkeypatch):
    """As before any store was opened in this process."""
    from fsspec.registry import _registry

    monkeypatch.delitem(_registry, "s3", raising=False)
    objects._files.cache_clear()


def test_a_figure_has_the_pixels_asked_for(tmp_path):
    for given, size in (({}, (200, 100)), ({"dpi": 110}, (220, 110))):
        blank_figure((2.0, 1.0), **given).savefig(tmp_path / "one.png")
        head = (tmp_path / "one.png").read_bytes()[16:24]  # of a PNG: width and height
        assert (int.from_bytes(head[:4]), int.from_bytes(head[4:])) == size


@pytest.mark.parametrize(("hidden", "need", "package", "extra", "instead", "call"), PLACES)
def test_a_missing_package_reads_as_a_message(
    hidden, need, package, extra, instead, call, monkeypatch, tmp_path
):
    monkeypatch.setitem(sys.modules, hidden, None)
    monkeypatch.delitem(sys.modules, "catalog_tools.engine.slurm_jobs", raising=False)
    with pytest.raises(Missing) as caught:
        call(tmp_path)
    remedy = f"pip install 'nightglass[{extra}]'" + (f", or {instead}" if instead else "")
    assert str(caught.value) == f"{need}, which is not installed: {remedy}"
    assert exit_code(caught.value) == 2
    assert any(one.startswith(package) or f"{package}[" in one for one in extras()[extra])
    assert extra in extras()["all"][0]


def test_a_protocol_that_no_extra_brings(monkeypatch):
    monkeypatch.setattr(stores, "_filesystem", lambda root: (_ for _ in ()).throw(ImportError("x")))
    with pytest.raises(BadInput, match=r"packages are installed \(x\)") as caught:
        stores.open_store("gs://b/c")
    assert not isinstance(caught.value, Missing)


def test_a_package_that_is_there_but_broken_gives_its_reason(monkeypatch, tmp_path):
    """No package is called absent that the user has: what ails it is said."""
    folder = tmp_path / "imageio_ffmpeg"
    folder.mkdir()
    (folder / "__init__.py").write_text("raise ImportError('libx264.so.1 is gone')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "imageio_ffmpeg", raising=False)
    with pytest.raises(Missing, match=r"cannot be imported \(libx264.so.1 is gone\)") as caught:
        encoder()
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_a_page_of_a_study_without_pictures(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "pip install 'nightglass[report]'" in unescape(_pictures({}, {}))


def test_an_encoder_without_ffmpeg(monkeypatch):
    def none():
        raise RuntimeError("no ffmpeg exe could be found")

    made = SimpleNamespace(get_ffmpeg_exe=none, write_frames=None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", made)
    with pytest.raises(BadInput, match="IMAGEIO_FFMPEG_EXE"):
        encoder()


def test_the_error_travels_and_a_server_can_tell_it():
    error = Missing("meshes", "trimesh", "mesh", "use a sphere", "targets.0.body.path")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (Missing, str(error))
    told = mistake_dict(mistakes_of(error)[0])
    assert told["pointer"] == "/targets/0/body/path"
    assert told["value"] == "'meshes'"
    remedy = "pip install 'nightglass[mesh]', or use a sphere"
    assert told["allowed"] == f"an installation with trimesh: {remedy}"
