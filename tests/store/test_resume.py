"""Going on with a product: what is kept, what is drawn again, and what is refused."""

from __future__ import annotations

import contextlib
import copy
import json
import shutil
import socket

import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr

from catalog_tools.ingest.ingest import ingest
from pipeline.errors import BadInput, Damaged, Incomplete, TryLater
from pipeline.route.run import Options, join, render
from pipeline.route.shares import Share
from pipeline.spec.load import PATH_FIELDS, parse_scene
from pipeline.store import layout
from pipeline.store.cube import open_cube
from pipeline.store.layout import only_writer
from pipeline.store.markers import read_marker
from pipeline.store.product import check, content_digest, files_digest
from pipeline.store.truth import part_is_whole, part_path

SCENE = {
    "schema": "nightglass/scene/1",
    "name": "resumed",
    "epoch": "2019-07-20T09:00:00Z",
    "observer": {"kind": "fixed", "position_au": [1.0, 0.1, 0.0]},
    "sensor": {
        "shape": [256, 512], "pixel_pitch_um": 9.0, "focal_length_m": 0.5, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900}, "read_noise_e": 3.0,
        "psf": {"kind": "gaussian", "sigma_px": 1.0},
    },
    "pointing": {"mode": "sidereal", "boresight_ra_deg": 60.0, "boresight_dec_deg": 5.0},
    "exposure": {"integration_s": 1.0, "frames": 2},
    "background": {"uniform_e_per_s": 20.0},
    "output": {"layers": ["dn"], "tile_shape": [256, 256]},
}  # fmt: skip
TILES = 2 * 2
HERE = Options("synchronous")
AGAIN = Options("synchronous", resume=True)


def make_catalogue(folder, g_mag):
    """Twenty stars of one magnitude about the boresight, in a catalogue at `folder`/stars."""
    rows = [f"{i + 1},{60.0 + 0.01 * (i - 10)},{5.0 + 0.003 * i},{g_mag}" for i in range(20)]
    csv = folder / "stars.csv"
    csv.write_text("\n".join(["source_id,ra,dec,phot_g_mean_mag", *rows]) + "\n")
    return ingest([csv], folder / "stars", form="gaia_dr2", workers=1, overwrite=True).catalogue


@pytest.fixture(scope="module")
def starry(tmp_path_factory):
    """A scene with a small catalogue, and its product: (scene, product, catalogue's folder)."""
    folder = tmp_path_factory.mktemp("starry")
    catalogue = make_catalogue(folder, 9.0)
    data = copy.deepcopy(SCENE) | {"stars": {"catalogue": str(catalogue.path)}}
    scene = parse_scene(data)
    render(scene, folder / "run", HERE)
    return scene, folder / "run", folder


@pytest.fixture
def product(starry, tmp_path):
    """A copy of the product that a test may damage."""
    shutil.copytree(starry[1], tmp_path / "run")
    return tmp_path / "run"


def unfinished(product):
    """The product as a kill left it: no seal, its last marker not there yet."""
    for name in ("_COMPLETE", "cube.zarr/zarr.json"):
        (product / name).unlink()
    max((product / "markers").glob("*.json")).unlink()
    (product / "truth" / ".parts").mkdir(exist_ok=True)


def test_another_table_of_the_users_data_is_refused(product, starry, tmp_path, monkeypatch):
    """A product begun with the Sun's whole spectrum does not go on without it, nor with another."""
    table = tmp_path / "solar_spectrum" / "e490-00a_2014_table3.txt"
    table.parent.mkdir()
    table.write_text("0.1195,0.0619\n1.0,748.0\n")
    monkeypatch.setenv("NIGHTGLASS_DATA", str(tmp_path))
    unfinished(product)
    with pytest.raises(BadInput, match="files_sha256"):
        render(starry[0], product, AGAIN)
    known = files_digest({})
    table.write_text("0.1195,0.0619\n1.0,749.0\n")
    assert None not in (known, files_digest({}))
    assert files_digest({}) != known
    known = files_digest({})
    spectra = tmp_path / "stellar_spectra" / "pickles_uvk"
    spectra.mkdir(parents=True)
    (spectra / "readme.txt").touch()
    assert files_digest({}) == known
    (spectra / "pickles_uk_1.fits").touch()
    assert files_digest({}) != known
    monkeypatch.delenv("NIGHTGLASS_DATA")
    assert files_digest({}) is None
    render(starry[0], product, AGAIN)


def test_another_catalogue_at_the_same_place_is_refused(starry, product):
    """The same scene to the letter, its catalogue made anew from other stars: not gone on with."""
    scene, _, folder = starry
    unfinished(product)
    kept = sorted(p.name for p in (product / "markers").iterdir())
    make_catalogue(folder, 9.5)
    try:
        for work in (
            lambda: render(scene, product, AGAIN),
            lambda: render(scene, product, HERE, share=Share(2, 2)),
            lambda: join(product),
        ):
            with pytest.raises(BadInput, match="same catalogue_digest"):
                work()
    finally:
        make_catalogue(folder, 9.0)
    assert sorted(p.name for p in (product / "markers").iterdir()) == kept
    assert render(scene, product, AGAIN)["tiles_resumed"] == TILES - 1
    assert check(product).whole


@pytest.mark.parametrize("record", [{"axes": "0123"}, {"study": {}}])
def test_a_sweep_or_study_is_never_taken_for_a_product(starry, tmp_path, record):
    """Not replaced, which would remove all of its points; not resumed, not joined, not checked."""
    place = tmp_path / "points"
    place.mkdir()
    (place / layout.BEGUN).write_text(json.dumps(record))
    (place / "points.parquet").write_text("dear")
    for work in (
        lambda: render(starry[0], place, Options("synchronous", replace=True)),
        lambda: render(starry[0], place, AGAIN),
        lambda: render(starry[0], place, HERE, share=Share(2, 2)),
        lambda: join(place),
        lambda: check(place),
    ):
        with pytest.raises(BadInput, match="a product"):
            work()
    assert (place / "points.parquet").read_text() == "dear"


@pytest.mark.parametrize(
    "options",
    [{"resume": True}, {"workers": 0}, {"workers": -1}, {"workers": "2"}, {"scheduler": "none"}],
)
def test_a_product_is_not_replaced_where_nothing_could_be_drawn(product, starry, options):
    with pytest.raises(BadInput, match=r"^--(replace|workers|scheduler): "):
        render(starry[0], product, Options(**{"replace": True} | options))
    assert check(product).whole


@pytest.fixture
def nobody():
    """The address of a scheduler that does not answer: bound, but not listening."""
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        yield f"tcp://127.0.0.1:{held.getsockname()[1]}"


def test_a_product_is_not_replaced_where_no_scheduler_answers(product, starry, nobody):
    with pytest.raises(TryLater, match="what is finished is kept"):
        render(starry[0], product, Options(nobody, replace=True))
    assert check(product).whole


def test_no_scheduler_is_asked_where_nothing_is_left_to_draw(product, starry, nobody):
    assert render(starry[0], product, Options(nobody, resume=True))["drawn_before"]


@pytest.mark.parametrize("content", ["5", "[]", "{}", "{"])
def test_a_record_that_holds_no_identity_is_damage(product, starry, content):
    (product / layout.BEGUN).write_text(content)
    with pytest.raises(Damaged, match="not what was written"):
        render(starry[0], product, AGAIN)


def test_what_other_code_began_is_refused(starry, product):
    """Its tiles may have other bits: a product of both would be no scene's."""
    unfinished(product)
    record = product / layout.BEGUN
    begun = json.loads(record.read_text())
    for other in ({"code": "0123456789abcdef"}, None):
        known = {k: v for k, v in begun.items() if k != "code"} | (other or {})
        record.write_text(json.dumps(known))
        for work in (
            lambda: render(starry[0], product, AGAIN),
            lambda: render(starry[0], product, HERE, share=Share(2, 2)),
            lambda: join(product),
        ):
            with pytest.raises(BadInput, match="same code"):
                work()
    record.write_text(json.dumps(begun))
    assert render(starry[0], product, AGAIN)["tiles_resumed"] == TILES - 1


@pytest.mark.parametrize(
    ("output", "key"),
    [({"layers": ["dn", "mean_e"]}, "scene_sha256"), ({"tile_shape": [256, 512]}, "tile_shape"),
     ({"compression": "none"}, "compression")],
)  # fmt: skip
def test_other_layers_tiles_or_compression_are_refused(starry, product, output, key):
    """What was begun with some layers, tiles and compression is gone on with as that alone."""
    data = starry[0].as_dict()
    data["output"] |= output
    unfinished(product)
    with pytest.raises(BadInput, match=f"same {key}"):
        render(parse_scene(data), product, AGAIN)


@pytest.mark.parametrize(
    "field", ["seed", "epoch", "sensor.read_noise_e", "background.uniform_e_per_s"]
)
def test_another_scene_is_refused(starry, product, field):
    """Whatever decides the pixels."""
    *section, name = field.split(".")
    data = starry[0].as_dict()
    holder = data[section[0]] if section else data
    holder[name] = "2019-07-20T09:00:01Z" if field == "epoch" else holder[name] + 1
    unfinished(product)
    with pytest.raises(BadInput, match="same scene_sha256"):
        render(parse_scene(data), product, AGAIN)


def test_parts_have_one_compression(starry, tmp_path):
    """A part with another one wrote chunks that nobody could read, and was called whole."""
    data = starry[0].as_dict()
    render(starry[0], tmp_path / "run", HERE, share=Share(1, 2))
    data["output"]["compression"] = "none"
    with pytest.raises(BadInput, match="same compression"):
        render(parse_scene(data), tmp_path / "run", HERE, share=Share(2, 2))
    render(starry[0], tmp_path / "run", HERE, share=Share(2, 2))
    assert check(tmp_path / "run").whole
    assert open_cube(tmp_path / "run")["dn"].values.mean() > 15.0


@pytest.mark.parametrize("kind", ["npy", "zarr"])
def test_a_file_that_changed_since_is_refused(tmp_path, kind):
    """A flat of half the level at the same path: not the other half of the frames with it."""
    path, data = tmp_path / f"flat.{kind}", copy.deepcopy(SCENE)
    data["sensor"]["flat"] = str(path)

    def write(level):
        image = np.full((256, 512), level)
        if kind == "zarr":
            shutil.rmtree(path, ignore_errors=True)
            zarr.save_array(path, image)
        else:
            np.save(path, image)

    write(1.0)
    product = tmp_path / "run"
    render(parse_scene(data), product, HERE)
    unfinished(product)
    write(0.5)
    with pytest.raises(BadInput, match="a file that the scene names"):
        render(parse_scene(data), product, AGAIN)
    write(1.0)
    assert render(parse_scene(data), product, AGAIN)["tiles_resumed"] == TILES - 1


def test_every_file_that_a_scene_names_counts(tmp_path):
    """In each field that may name one, but catalogues, and populations that were read."""
    path, counts = tmp_path / "file", {}
    for names in PATH_FIELDS:
        data = str(path)
        for name in reversed(names):
            data = {"k" if name == "*" else name: data}
        path.write_text("first")
        first = files_digest(data)
        path.write_text("other")
        counts[names] = None not in (first, files_digest(data)) and files_digest(data) != first
    known = {names for names, changed in counts.items() if not changed}
    others = [n for n in PATH_FIELDS if n[0] == "populations"]
    assert known == {("stars", "catalogue"), *others}


def test_what_a_killed_writer_left_is_no_part_of_the_product(starry, product):
    """Files that had no name yet, anywhere in it: gone with the seal, and in no list."""
    unfinished(product)
    left = [product / ".plan.json.0f.tmp", product / "markers" / ".f000000_r000_c000.json.1e.tmp"]
    for path in left:
        path.write_bytes(b"{")
    render(starry[0], product, AGAIN)
    assert not any(path.exists() for path in left)
    assert not [n for n in json.loads((product / "_COMPLETE").read_text())["files"] if "tmp" in n]
    assert check(product).whole


def test_a_marker_that_was_changed_is_not_believed(starry, product):
    """Whole JSON with one checksum of a cell altered: only the marker's own checksum tells."""
    path = min((product / "markers").glob("*.json"))
    whole = path.read_text()
    outer = json.loads(whole)
    marker = json.loads(outer["marker"])
    marker["cells"]["dn"][0][2] ^= 1
    path.write_text(json.dumps(outer | {"marker": json.dumps(marker, sort_keys=True)}))
    with pytest.raises(Damaged, match=path.name):
        read_marker(path)
    assert any(path.name in fault for fault in check(product).faults)
    report = render(starry[0], product, AGAIN)
    assert len(report["redrawn"]) == 1
    assert path.read_text() == whole
    assert report["content_digest"] == content_digest(starry[1])


def test_every_flipped_bit_of_a_marker_is_noticed(starry):
    """Each byte of a marker with one bit flipped: refused, or the same marker as before."""
    path = min((starry[1] / "markers").glob("*.json"))
    whole, good = path.read_bytes(), read_marker(path)
    for at in range(len(whole)):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << (at % 8)
        with contextlib.suppress(Damaged):
            assert read_marker(path, bytes(damaged)) == good


def stopped_before_the_end(scene, product, monkeypatch, end="run.finish"):
    """Render until all tiles and truth are stored and nothing is joined, or until another end."""

    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(f"pipeline.route.{end}", stop)
        with pytest.raises(KeyboardInterrupt):
            render(scene, product, HERE)


def test_truth_stays_as_it_was_drawn_until_the_seal(starry, tmp_path, monkeypatch):
    scene, _, _ = starry
    stopped_before_the_end(scene, tmp_path / "run", monkeypatch, "finish.seal")
    assert part_is_whole(tmp_path / "run", "stars", 0)
    assert part_is_whole(tmp_path / "run", "stars", 1)
    render(scene, tmp_path / "run", AGAIN)
    assert check(tmp_path / "run").whole


@pytest.mark.parametrize("damage", ["cut", "empty", "bit"])
def test_truth_that_cannot_be_read_is_made_again(starry, tmp_path, monkeypatch, damage):
    """A part of the truth cut short, emptied, or with a bit flipped in its data: drawn again."""
    scene, made, _ = starry
    product = tmp_path / "run"
    stopped_before_the_end(scene, product, monkeypatch)
    path = part_path(product, "stars", 1)
    whole = bytearray(path.read_bytes())
    flipped = bytearray(whole)
    flipped[len(flipped) // 2] ^= 1
    path.write_bytes({"cut": whole[:-9], "empty": b"", "bit": flipped}[damage])
    assert part_is_whole(product, "stars", 0)
    assert not part_is_whole(product, "stars", 1)
    render(scene, product, AGAIN)
    tables = [pq.read_table(p / "truth" / "stars.parquet") for p in (product, made)]
    assert tables[0].equals(tables[1])
    assert check(product).whole


@pytest.mark.parametrize("damage", ["cut", "bit"])
def test_parts_name_truth_that_cannot_be_read(starry, tmp_path, damage):
    """Of a product in parts: the last part and `join` say what is missing; its part mends it."""
    scene, made, _ = starry
    product = tmp_path / "run"
    render(scene, product, HERE, share=Share(1, 2))
    path = part_path(product, "stars", 0)
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole if damage == "bit" else whole[:-9])
    for finish in (lambda: render(scene, product, HERE, share=Share(2, 2)), lambda: join(product)):
        with pytest.raises(Incomplete, match=r"1 truth part"):
            finish()
    report = render(scene, product, HERE, share=Share(1, 2))
    assert report["complete"]
    assert report["content_digest"] == content_digest(made)
    assert check(product).whole


def test_no_seal_while_tiles_are_drawn_again(starry, product):
    """A finished product with a damaged chunk shows no cube from the first task on."""
    scene = starry[0]
    (product / "cube.zarr" / "dn" / "c" / "1" / "0" / "1").write_bytes(b"")
    seen = []

    def stop(progress):
        seen.append([(product / n).exists() for n in ("_COMPLETE", "cube.zarr/zarr.json")])
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render(scene, product, AGAIN, stop)
    assert seen == [[False, False]]
    with pytest.raises(Incomplete):
        open_cube(product)
    assert not check(product).complete
    assert render(scene, product, AGAIN)["content_digest"] == content_digest(starry[1])
    assert check(product).whole


def test_a_part_that_finds_damage_takes_the_seal_away(starry, product):
    """A part of a finished product is run again: a chunk of its own that is damaged is redrawn."""
    scene = starry[0]
    (product / "cube.zarr" / "dn" / "c" / "1" / "0" / "1").write_bytes(b"")
    assert render(scene, product, HERE, share=Share(1, 2))["complete"]  # not one of its tiles
    with pytest.raises(Incomplete, match="1 truth part"):  # of the other part's frame
        render(scene, product, HERE, share=Share(2, 2))
    assert not check(product).complete
    report = render(scene, product, HERE, share=Share(1, 2))
    assert report["complete"]
    assert report["content_digest"] == content_digest(starry[1])
    assert check(product).whole


@pytest.mark.parametrize("name", ["truth/stars.parquet", "preview.png", "plan.json"])
def test_files_that_were_sealed_are_made_again(starry, product, name):
    """Of a finished product a table of truth or another file is damaged: --resume mends it."""
    content = bytearray((product / name).read_bytes())
    content[len(content) // 2] ^= 1
    (product / name).write_bytes(content)
    report = render(starry[0], product, AGAIN)
    assert report["tiles_resumed"] == TILES
    assert check(product).whole
    tables = [pq.read_table(p / "truth" / "stars.parquet") for p in (product, starry[1])]
    assert tables[0].equals(tables[1])


def test_join_does_not_call_a_damaged_product_complete(starry, product):
    """Joining a finished product reads all chunks: one that is damaged is named."""
    chunk = product / "cube.zarr" / "dn" / "c" / "1" / "0" / "1"
    chunk.write_bytes(chunk.read_bytes()[:-1])
    with pytest.raises(Incomplete, match="dn/c/1/0/1"):
        join(product)
    with pytest.raises(Incomplete):
        open_cube(product)


def lets_in(product, shared):
    """Whether another writer, whole or a part, is let in now."""
    try:
        with only_writer(product, shared):
            return True
    except TryLater:
        return False


def test_one_whole_writer_or_parts_of_different_names(tmp_path):
    """The lock of each pair of writers: whole or part inside of another one that writes."""
    inside = {None: {None: False, "part-1": False}, "part-1": {
        None: False, "part-1": False, "part-2": True}}  # fmt: skip
    for holder, others in inside.items():
        with only_writer(tmp_path, holder):
            assert {other: lets_in(tmp_path, other) for other in others} == others, holder
        assert lets_in(tmp_path, holder)  # it has ended


def test_what_another_writer_ends_while_one_waits_is_seen(starry, product, monkeypatch):
    """Another --resume finishes the product just before this one gets its lock: nothing to do."""
    scene = starry[0]
    unfinished(product)
    rivals = []

    def waits(path, shared=None, wait_s=0.0):
        if not rivals:
            rivals.append("at work")
            rivals.append(render(scene, product, AGAIN))
        return only_writer(path, shared)

    monkeypatch.setattr("pipeline.store.layout.only_writer", waits)
    assert render(scene, product, AGAIN) == rivals[1] | {"drawn_before": True}
    assert check(product).whole


@pytest.mark.parametrize("most", [0, 2])
def test_what_is_finished_stays_when_drawing_fails(starry, tmp_path, most):
    """A damaged shard, a store that is gone: tiles that stand are kept; without any, nothing is."""
    product = tmp_path / "run"

    def fail(progress):
        if progress.done >= most:
            raise Damaged("a shard", "its checksum differs")

    with pytest.raises(Damaged):
        render(starry[0], product, HERE, fail)
    assert product.exists() == (most > 0)
    if most:
        report = render(starry[0], product, AGAIN)
        assert report["tiles_resumed"] >= most
        assert report["content_digest"] == content_digest(starry[1])
