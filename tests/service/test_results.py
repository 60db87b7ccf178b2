"""Files of a product over HTTP: ranges, tags, and no way out of the product's folder."""

from __future__ import annotations

import io
import os
import socket
import warnings
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zarr
from astropy.io import fits
from PIL import Image
from starlette.requests import Request

from pipeline.errors import BadInput, Damaged
from pipeline.export.formats import ExportRequest, export_product
from pipeline.route.shares import parse_part
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube
from service.engine.attempts import bytes_of
from service.problems import NotReady, NotThere
from service.products.files import list_files, open_inside, serve_file
from service.products.pixels import binned, frame_facts, tile_picture, tile_values, truth_of


def test_every_file_is_fetched_whole(server: Any, finished: str, tmp_path: Path) -> None:
    """What is listed and fetched is the product itself, and opens as one."""
    files = server.client.get(f"{finished}/results").json()["files"]
    for file in files:
        answer = server.client.get(file["href"])
        assert (answer.status_code, len(answer.content)) == (200, file["bytes"])
        target = tmp_path / file["path"]
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(answer.content)
    there = server.home / "products" / finished.rpartition("/")[2]
    with open_cube(tmp_path) as fetched, open_cube(there) as kept:
        assert fetched.dn.shape == (2, 64, 64)
        assert np.array_equal(fetched.dn, kept.dn)
    assert {"scene.yaml", "truth/targets.parquet", "_COMPLETE"} <= {f["path"] for f in files}
    assert not any(part.startswith(".") for f in files for part in f["path"].split("/"))


def test_a_lost_truth_is_no_frame_without_targets(server: Any, finished: str) -> None:
    """It is a fault, told to the server's log; there again, the targets are."""
    table = server.home / "products" / finished.rpartition("/")[2] / "truth" / "targets.parquet"
    content = table.read_bytes()
    table.unlink()
    try:
        answer = server.client.get(f"{finished}/frames/0/truth")
        assert answer.status_code == 500
    finally:
        table.write_bytes(content)
    assert server.client.get(f"{finished}/frames/0/truth").json()["targets"]


def test_listing_by_pages(server: Any, finished: str) -> None:
    whole = server.client.get(f"{finished}/results").json()["files"]
    found, path = [], f"{finished}/results?limit=7"
    while path:
        answer = server.client.get(path)
        found += answer.json()["files"]
        path = answer.links.get("next", {}).get("url")
    assert found == whole


@pytest.mark.parametrize(
    ("asked", "status", "part"),
    [
        ("bytes=0-9", 206, slice(0, 10)),
        ("bytes=10-", 206, slice(10, None)),
        ("bytes=-5", 206, slice(-5, None)),
        ("bytes=0-99999999", 206, slice(0, None)),
        ("bytes=-99999999", 206, slice(0, None)),
        ("bytes=99999999-", 416, None),
        ("bytes=9-2", 416, None),
        ("bytes=-0", 416, None),
        ("bytes=0-1,4-5", 200, slice(0, None)),
        ("bytes=-", 200, slice(0, None)),
        ("lines=1-2", 200, slice(0, None)),
    ],
)
def test_range(server: Any, finished: str, asked: str, status: int, part: slice | None) -> None:
    path = f"{finished}/results/plan.json"
    whole = server.client.get(path).content
    answer = server.client.get(path, headers={"range": asked})
    assert answer.status_code == status
    if part is not None:
        assert answer.content == whole[part]
    if status == 206:
        start = (part.start or 0) % len(whole) if part else 0
        stop = start + len(answer.content) - 1
        assert answer.headers["content-range"] == f"bytes {start}-{stop}/{len(whole)}"
    if status == 416:
        assert answer.headers["content-range"] == f"bytes */{len(whole)}"


def test_another_content_of_one_length_has_another_etag(tmp_path: Path) -> None:
    """A job that is tried again writes its report anew: what a client keeps is no longer it."""
    path, tags = tmp_path / "report.json", []
    request = Request({"type": "http", "headers": [], "method": "GET"})
    for date_ns, content in ((10, b"[1]"), (20, b"[2]"), (20, b"[22]")):
        path.write_bytes(content)
        os.utime(path, ns=(date_ns, date_ns))
        tags.append(serve_file(request, tmp_path, path.name).headers["etag"])
    assert len(set(tags)) == 3


def test_tags(server: Any, finished: str) -> None:
    for path in (finished, f"{finished}/preview.png", f"{finished}/results/scene.yaml"):
        first = server.client.get(path)
        etag = first.headers["etag"]
        again = server.client.get(path, headers={"if-none-match": etag})
        assert (again.status_code, again.content) == (304, b"")
        weak = {"if-none-match": f'"other", W/{etag}'}  # as a proxy that packs answers has made it
        assert server.client.get(path, headers=weak).status_code == 304
        assert server.client.get(path, headers={"if-none-match": "*"}).status_code == 304
        other = server.client.get(path, headers={"if-none-match": '"other"'})
        assert (other.status_code, other.content) == (200, first.content)
    stale = {"range": "bytes=0-3", "if-range": '"other"'}
    assert server.client.get(f"{finished}/preview.png", headers=stale).status_code == 200
    assert server.client.get(f"{finished}/preview.png").content.startswith(b"\x89PNG")
    head = server.client.head(f"{finished}/results/scene.yaml")
    assert (head.status_code, head.content) == (200, b"")
    size = int(head.headers["content-length"])
    assert size > 0
    part = server.client.head(f"{finished}/results/scene.yaml", headers={"range": "bytes=0-3"})
    assert (part.status_code, int(part.headers["content-length"])) == (200, size)


OUT = (
    "../jobs.sqlite", "..", "../../jobs.sqlite", "cube.zarr/",
    "%2e%2e/%2e%2e/jobs.sqlite", "..%2f..%2fjobs.sqlite",
    "cube.zarr/../../../jobs.sqlite", "/etc/passwd", "%2fetc%2fpasswd", "..%5c..%5cjobs.sqlite",
    ".begun.json", ".lock", "truth/.parts", "cube.zarr", "", "%00", "plan.json%00.png",
    "link.txt", "linked/jobs.sqlite", "fifo", "%ff", "a" * 4000, "plan.json/x",
)  # fmt: skip


@pytest.mark.parametrize("path", OUT)
def test_no_way_out(server: Any, finished: str, path: str) -> None:
    """Sent raw, so that no client tidies the path; links and a pipe lie in the product, too."""
    product = server.home / "products" / finished.rpartition("/")[2]
    made = [product / "link.txt", product / "linked", product / "fifo"]
    made[0].symlink_to(server.home / "jobs.sqlite")
    made[1].symlink_to(server.home)
    os.mkfifo(made[2])
    where = urlsplit(server.url)
    try:
        with socket.create_connection((where.hostname or "", where.port or 0), timeout=10) as wire:
            request = f"GET {finished}/results/{path} HTTP/1.1\r\nHost: {where.netloc}\r\n"
            wire.sendall(request.encode() + b"Connection: close\r\n\r\n")
            answer = b"".join(iter(lambda: wire.recv(65536), b""))
        assert answer.startswith(b"HTTP/1.1 404 "), answer[:300]
        assert b"SQLite format" not in answer
        assert str(server.home).encode() not in answer
        listed = server.client.get(f"{finished}/results").text
        assert "link" not in listed
    finally:
        for file in made:
            file.unlink()


def test_open_inside_refuses_a_linked_folder(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "file").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    open_inside(tmp_path / "real", "file").close()
    for folder, name in ((tmp_path / "link", "file"), (tmp_path, "link/file")):
        with pytest.raises(NotThere):
            open_inside(folder, name)


def test_tiles_are_told_and_shown_as_they_are_drawn(scene: dict[str, Any], tmp_path: Path) -> None:
    """Some tiles of 2 x 3 in a product that is not finished: just these can be seen."""
    scene["sensor"]["shape"], scene["output"] = [512, 768], {"tile_shape": [256, 256]}
    from pipeline.route.run import render

    render(parse_scene(scene), tmp_path / "run", share=parse_part("1/3"))
    drawn = frame_facts(tmp_path / "run", 0)["drawn"]
    assert drawn == [[0, 0], [0, 1], [0, 2], [1, 0]]
    for row, column in np.ndindex(2, 3):
        if [row, column] in drawn:
            assert tile_values(tmp_path / "run", 0, row, column).any()
        else:
            with pytest.raises(NotReady):
                tile_values(tmp_path / "run", 0, row, column)


def test_files_that_go_while_they_are_counted_are_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A job that is being deleted: its files are listed, and weighed, as far as there are any."""
    for name in ("gone", "kept"):
        (tmp_path / name).write_bytes(b"12345")
    lstat = Path.lstat

    def late(self: Path) -> os.stat_result:
        if self.name == "gone":
            self.unlink(missing_ok=True)
        return lstat(self)

    monkeypatch.setattr(Path, "lstat", late)
    assert list_files(tmp_path) == [("kept", 5)]
    (tmp_path / "gone").write_bytes(b"12345")
    assert bytes_of(tmp_path) == 5


def test_oblong_tiles_are_those_of_their_row_and_column(tmp_path: Path) -> None:
    """Each tile of each frame by its own pixels; those at the far edges are what is left."""
    dn = np.arange(2 * 6 * 10, dtype=np.uint16).reshape(2, 6, 10)
    zarr.create_array(store=tmp_path / "cube.zarr" / "dn", data=dn, chunks=(1, 4, 3))
    (tmp_path / "_COMPLETE").write_text("{}")
    for frame, row, column in np.ndindex(2, 2, 4):
        own = dn[frame, 4 * row : 4 * row + 4, 3 * column : 3 * column + 3]
        assert np.array_equal(tile_values(tmp_path, frame, row, column), own)
    for outside in ((2, 0, 0), (0, 2, 0), (0, 0, 4), (0, -1, 0)):
        with pytest.raises(NotThere):
            tile_values(tmp_path, *outside)


def test_a_tile_is_shown_where_binning_leaves_few_enough_pixels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 8 x 8 pixels 16 at most: by a factor of 2 on both axes; and of 16 x 16 none is read."""
    monkeypatch.setattr("service.products.pixels.MAX_PIXELS", 16)
    monkeypatch.setattr("service.products.pixels.MAX_READ", 64)
    for name, side in (("a", 8), ("b", 16)):
        dn = np.ones((1, side, side), np.uint16)
        store = tmp_path / name / "cube.zarr" / "dn"
        zarr.create_array(store=store, data=dn, chunks=(1, side, side))
        (tmp_path / name / "_COMPLETE").write_text("{}")
    assert tile_values(tmp_path / "a", 0, 0, 0, bin_px=2).shape == (4, 4)
    for name, bin_px in (("a", 1), ("b", 4)):
        with pytest.raises(BadInput, match=r"\?bin: .*a factor that leaves at most 16 pixels"):
            tile_values(tmp_path / name, 0, 0, 0, bin_px=bin_px)


def test_a_tile_that_cannot_be_read_is_damage(tmp_path: Path) -> None:
    """Named by its layer and frame; the others are shown."""
    dn = np.arange(2 * 4 * 4, dtype=np.uint16).reshape(2, 4, 4)
    zarr.create_array(store=tmp_path / "cube.zarr" / "dn", data=dn, chunks=(1, 4, 4))
    (tmp_path / "_COMPLETE").write_text("{}")
    (tmp_path / "cube.zarr" / "dn" / "c" / "1" / "0" / "0").write_bytes(b"no chunk")
    with pytest.raises(Damaged, match="frame 1: ") as error:
        tile_values(tmp_path, 1, 0, 0)
    assert error.value.path == "cube.zarr/dn"
    assert np.array_equal(tile_values(tmp_path, 0, 0, 0), dn[0])


@pytest.mark.parametrize("stretch", ["asinh", "linear", "log"])
def test_pictures_are_black_at_low_and_white_at_high(stretch: str) -> None:
    """Whatever the stretch, in between they rise; what is beyond an end is as the end."""
    values = np.array([[-50.0, 0.0, 1.0, 10.0, 50.0, 100.0, 1e6]])
    png = tile_picture(values, stretch, 0.0, 100.0)
    grey = np.asarray(Image.open(io.BytesIO(png)))[0].astype(int)
    assert (grey[0], grey[1], grey[-2], grey[-1]) == (0, 0, 255, 255)
    assert (np.diff(grey[1:-1]) > 0).all()
    assert grey[-3] < 255
    upright = tile_picture(np.array([[0.0, 50.0], [100.0, 100.0]]), stretch, 0.0, 100.0)
    rows = np.asarray(Image.open(io.BytesIO(upright)))  # the first row at the bottom
    assert rows[0].tolist() == [255, 255]
    assert rows[1, 0] == 0 < rows[1, 1] < 255


@pytest.mark.parametrize("asked", [(None, None), (5.0, None)])
def test_a_tile_of_one_value_has_a_picture(asked: tuple[float | None, float | None]) -> None:
    """A bias frame, or a low end above all that is bright: black, not an error of the caller's."""
    png = tile_picture(np.full((3, 4), 2.0), "linear", *asked)
    assert (np.asarray(Image.open(io.BytesIO(png))) == 0).all()


@pytest.mark.parametrize("asked", [(None, None), (1.0, None), (None, 9.0), (1.0, 9.0)])
def test_masked_pixels_are_as_dark_as_the_darkest(asked: tuple[float | None, float | None]) -> None:
    values = np.linspace(0.0, 10.0, 4096, dtype=np.float32).reshape(64, 64)
    values[10, 20:40] = np.nan
    grey = np.asarray(Image.open(io.BytesIO(tile_picture(values, "linear", *asked))))[::-1]
    assert (grey[10, 20:40] == 0).all()
    assert (int(grey[0, 0]), int(grey[-1, -1])) == (0, 255)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        none = tile_picture(np.full((3, 4), np.nan), "asinh", None, None)
    assert (np.asarray(Image.open(io.BytesIO(none))) == 0).all()


def test_blocks_are_of_the_pixels_that_are_numbers() -> None:
    nan = np.nan
    values = np.array([[1.0, 2.0, nan, nan], [nan, 6.0, nan, nan]], np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = binned(values, 2)
    assert made.dtype == np.float32
    assert np.array_equal(made, [[0.5 * (3.0 + 6.0), nan]], equal_nan=True)


def test_the_wcs_of_a_frame_is_the_first_one_alone(scene: dict[str, Any], tmp_path: Path) -> None:
    """What places need, with all of its distortion, and no card of the alternate WCS."""
    from pipeline.route.run import Options, render

    terms = {"2_0": 1e-4, "0_3": 1e-6}
    scene["sensor"]["distortion"] = {"kind": "sip", "a": terms, "b": {"1_1": -1e-4}}
    render(parse_scene(scene), tmp_path / "run", Options("synchronous"))
    wcs = frame_facts(tmp_path / "run", 0)["wcs"]
    assert {"CTYPE1", "CTYPE2", "CRVAL1", "CRPIX2", "CD1_1", "CD2_2", "RADESYS"} <= set(wcs)
    (written,) = export_product(tmp_path / "run", "fits", tmp_path / "a.fits", ExportRequest(0))
    sip = {k: v for k, v in fits.getheader(written).items() if k.startswith(("A_", "B_"))}
    assert {"A_ORDER", "A_2_0", "A_0_3", "B_ORDER", "B_1_1"} <= set(sip)
    assert {k: v for k, v in wcs.items() if k.startswith(("A_", "B_"))} == pytest.approx(sip)
    assert not [k for k in wcs if k.endswith("A") and not k.startswith(("A_", "B_"))]


def test_truth_is_that_of_the_frame_and_its_brightest_stars(tmp_path: Path) -> None:
    """Ids as text, which holds them whole; NaN as null; nothing that is outside of the frame."""
    zarr.create_array(store=tmp_path / "cube.zarr" / "dn", data=np.zeros((2, 4, 4), np.uint16))
    (tmp_path / "truth").mkdir()
    rows = {"frame": [0, 1, 1, 1, 1], "in_frame": [True, True, False, True, True],
            "electrons": [9.0, 6.0, 99.0, 7.0, 6.0], "g_mag": [1.0, 2, 3, float("nan"), 5],
            "source_id": [(1 << 60) + k for k in range(5)]}  # fmt: skip
    pq.write_table(pa.table(rows), tmp_path / "truth" / "stars.parquet")
    found = truth_of(tmp_path, 1, 2)
    assert (found["stars_in_frame"], found["targets"]) == (3, [])
    first = [str((1 << 60) + k) for k in (3, 1)]  # of two alike that of the lower number
    assert [s["source_id"] for s in found["stars"]] == first
    assert [s["g_mag"] for s in found["stars"]] == [None, 2.0]
    rows |= {"hidden_by": ["earth"] * 4 + [None], "visible_fraction": [0.0, 0.0, 0.0, 0.5, 1.0]}
    pq.write_table(pa.table(rows), tmp_path / "truth" / "stars.parquet")
    found = truth_of(tmp_path, 1, 2)
    assert (found["stars_in_frame"], found["stars_hidden"]) == (2, 1)


def test_truth_says_what_hides_a_source(scene: dict[str, Any], tmp_path: Path) -> None:
    """Of two objects beyond the Earth, one behind it and one beside."""
    from pipeline.route.run import Options, render

    orbit = {"kind": "state", "position_m": [4.2164e7, 0, 0], "velocity_m_s": [0, 3075.0, 0]}
    scene["observer"] = {"kind": "orbit", "orbit": orbit}
    scene["sensor"] |= {"focal_length_m": 0.01, "aperture_m": 0.005}
    scene["pointing"] = {"mode": "sidereal", "boresight_ra_deg": 189.0, "boresight_dec_deg": 0.0}
    [target] = scene["targets"]
    ways = {"behind": [-4.2e7, -1.25e7, 0], "beside": [-4.2e7, -1.42e7, 0]}
    state = {"kind": "state", "velocity_m_s": [0, 0, 3000.0]}
    scene["targets"] = [target | {"name": name, "orbit": state | {"position_m": where}}
                        for name, where in ways.items()]  # fmt: skip
    render(parse_scene(scene), tmp_path / "run", Options("synchronous"))
    found = {t["name"]: t for t in truth_of(tmp_path / "run", 0, 2)["targets"]}
    assert (found["behind"]["hidden_by"], found["behind"]["visible_fraction"]) == ("earth", 0.0)
    assert (found["beside"]["hidden_by"], found["beside"]["visible_fraction"]) == (None, 1.0)
