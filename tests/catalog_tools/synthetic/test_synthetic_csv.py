"""Synthetic files in the archive's layout: exact, well-formed, the same bits, and ingestible."""

from __future__ import annotations

import gzip
import hashlib
import re
import signal
import subprocess
import sys
import time
from itertools import pairwise, product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv
import pytest

from catalog_tools.errors import BadInput
from catalog_tools.geometry.sphere import directions, separation_rad
from catalog_tools.partition import coarser, healpix_29
from catalog_tools.query.query import cone
from catalog_tools.readers import read_tables
from catalog_tools.star_counts import EDGES_G_MAG, galactic_rad
from catalog_tools.synthetic import sample
from catalog_tools.synthetic.clusters import CROWDS, PIXEL_DEG, interval_shares, pixels_of
from catalog_tools.synthetic.columns import HEADER
from catalog_tools.synthetic.csv import write_csv_files
from catalog_tools.synthetic.plan import field_density, make_plan, places_in_file
from catalog_tools.synthetic.sample import make_sample, table_of_file

ROWS = 45_000
NAME = re.compile(r"GaiaSource_(\d+)_(\d+)\.csv\.gz")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("dr2") / "csv"
    report = write_csv_files(path, ROWS, workers=2)
    assert (report.files, report.rows) == (2, ROWS)
    assert report.bytes == sum(file.stat().st_size for file in path.glob("Gaia*"))
    return path


@pytest.fixture(scope="module")
def files(folder):
    """The files by name, each a dictionary of text columns."""
    as_text = pacsv.ConvertOptions(column_types=dict.fromkeys(HEADER, pa.string()))
    tables = {}
    for path in folder.glob("*.csv.gz"):
        table = pacsv.read_csv(path, convert_options=as_text)
        assert table.column_names == list(HEADER)
        tables[path.name] = {name: table[name].to_numpy() for name in HEADER}
    return tables


@pytest.fixture(scope="module")
def columns(files):
    return {name: np.concatenate([file[name] for file in files.values()]) for name in HEADER}


def numbers(column):
    """As a correct parser reads them: NaN for an empty field."""
    text = pa.array(column, pa.string())
    return pc.cast(pc.if_else(pc.equal(text, ""), None, text), pa.float64()).to_numpy(
        zero_copy_only=False
    )


def test_exactly_so_many_rows_in_files_of_their_ranges(files):
    ranges = []
    for name, file in files.items():
        ids = file["source_id"].astype(np.int64)
        first, last = (int(text) for text in NAME.fullmatch(name).groups())
        assert (ids.min(), ids.max()) == (first, last)
        assert (np.diff(ids) < 0).any()
        assert list(file["designation"]) == [f"Gaia DR2 {i}" for i in ids]
        ranges.append((first >> 35, last >> 35, ids.size))
    ranges.sort()
    assert sum(rows for *_, rows in ranges) == ROWS
    assert all(a[1] < b[0] for a, b in pairwise(ranges))


def test_against_the_schema_of_dr2(shared_data):
    from astropy.io import fits

    path = shared_data / "gaia_dr2" / "full_schema_random" / "gdr2_sm.fits"
    assert list(HEADER) == fits.getdata(path, 1).names[:94]


def test_md5sums_list_every_file(folder):
    lines = [line.split() for line in (folder / "MD5SUM.txt").read_text().splitlines()]
    sums = {name: digest for digest, name in lines}
    assert set(sums) == {p.name for p in folder.glob("Gaia*")} | {"_citation", "_disclaimer"}
    for name, digest in sums.items():
        assert hashlib.md5((folder / name).read_bytes()).hexdigest() == digest
    assert "SYNTHETIC" in (folder / "_disclaimer").read_text()


def test_ids_places_and_indexes(columns):
    ids = columns["source_id"].astype(np.int64)
    assert np.unique(ids).size == ROWS
    assert sorted(columns["random_index"].astype(int)) == list(range(ROWS))
    ra, dec = numbers(columns["ra"]), numbers(columns["dec"])
    moved = coarser(healpix_29(ra, dec), 12) != ids >> 35
    assert 0.005 < moved.mean() < 0.02
    lon, lat = galactic_rad(directions(ra, dec))
    assert np.abs(numbers(columns["b"]) - np.degrees(lat)).max() < 1e-9
    around = np.abs(numbers(columns["l"]) - np.degrees(lon) % 360.0)
    assert np.minimum(around, 360.0 - around).max() < 1e-8


def test_sizes_and_digits_of_the_archive(folder, columns):
    """About 0.9 kB a row, 350 B of it left by gzip; doubles with 15 to 17 digits."""
    packed = sum(path.stat().st_size for path in folder.glob("Gaia*"))
    plain = sum(len(gzip.decompress(path.read_bytes())) for path in folder.glob("Gaia*"))
    assert 320 < packed / ROWS < 390
    assert 780 < plain / ROWS < 950
    for path in folder.glob("Gaia*"):  # no time of writing, with which the MD5 would change
        assert path.read_bytes()[4:8] == b"\0\0\0\0"
    digits = [len(text.strip("-0.").replace(".", "")) for text in columns["ra_error"]]
    assert 15.0 < np.mean(digits) < 17.5


def test_values_agree_and_are_absent_together(columns):
    value = {name: numbers(columns[name]) for name in HEADER if name != "designation"
             and not name.endswith("_flag") and name != "duplicated_source"}  # fmt: skip
    two = value["astrometric_params_solved"] == 3
    assert 0.19 < two.mean() < 0.235
    for name in ("parallax", "pmra", "pmdec_error", "pmra_pmdec_corr", "astrometric_pseudo_colour"):
        assert (np.isnan(value[name]) == two).all()
    assert np.isfinite(value["ra_dec_corr"]).all()
    colourless = np.isnan(value["phot_bp_mean_mag"])
    assert 0.16 < colourless.mean() < 0.21
    assert (np.isnan(value["bp_rp"]) == colourless).all()
    assert 0.002 < np.isfinite(value["radial_velocity"]).mean() < 0.008
    g_mag = value["phot_g_mean_mag"]
    assert g_mag.min() >= 3.0
    assert g_mag.max() <= 21.0
    flux = 10 ** (-0.4 * (g_mag - 25.6883657251))
    assert np.abs(value["phot_g_mean_flux"] / flux - 1.0).max() < 1e-5
    ratio = value["parallax"] / value["parallax_error"]
    assert np.nanmax(np.abs(value["parallax_over_error"] - ratio)) < 1e-4
    assert set(columns["duplicated_source"]) == {"true", "false"}
    assert set(columns["phot_variable_flag"]) <= {"NOT_AVAILABLE", "VARIABLE"}


def test_errors_of_places_are_always_there(columns):
    """Also of stars whose motion is not known; those of motions are absent with these."""
    lacking = columns["pmra"] == ""
    assert 0 < lacking.sum() < lacking.size
    for name in ("ra_error", "dec_error"):
        assert (columns[name] != "").all()
    for name in ("parallax", "pmra", "pmdec"):
        assert ((columns[f"{name}_error"] == "") == lacking).all()


def test_against_star_counts_by_latitude(columns):
    """Shares of the stars in bands of latitude, and by magnitude, within 3 sigma of the model."""
    from catalog_tools.partition import positions_of

    n = 12 * 4**6
    centres = directions(*positions_of((np.arange(n) << 46) + (3 << 44)))
    crowds = [(crowd.ra_deg, crowd.dec_deg, crowd.edge_deg) for crowd in CROWDS]
    model = field_density()
    total = model.sum() + sum(crowd.stars for crowd in CROWDS)
    v = directions(numbers(columns["ra"]), numbers(columns["dec"]))

    def away(v):
        apart = (separation_rad(v, directions(ra, dec)) for ra, dec, _ in crowds)
        edges = np.radians([edge + 1.0 for *_, edge in crowds])
        return np.all([a > e for a, e in zip(apart, edges, strict=True)], axis=0)

    far, here = away(centres), away(v)
    lat, b = (np.abs(np.degrees(galactic_rad(x)[1])) for x in (centres, v))
    for low, high in ((0, 3), (3, 10), (10, 20), (20, 40), (40, 65), (65, 90)):
        expected = model[far & (lat >= low) & (lat < high)].sum() / total * ROWS
        found = (here & (b >= low) & (b < high)).sum()
        assert abs(found - expected) < 4 * np.sqrt(expected) + 0.06 * expected, (low, high)
    g_mag = numbers(columns["phot_g_mean_mag"])
    for limit in (14.0, 16.0, 18.0, 20.0):
        faint = EDGES_G_MAG[1:] <= limit
        stars = model[:, faint].sum()
        stars += sum(crowd.stars * interval_shares(crowd)[faint].sum() for crowd in CROWDS)
        expected = stars / total * ROWS
        assert abs((g_mag <= limit).sum() - expected) < 4 * np.sqrt(expected)


def test_the_magellanic_clouds_are_there(columns):
    v = directions(numbers(columns["ra"]), numbers(columns["dec"]))
    for crowd, least in zip(CROWDS[:2], (3.0, 2.0), strict=True):
        apart = np.degrees(separation_rad(v, directions(crowd.ra_deg, crowd.dec_deg)))
        inside = (apart < 2 * crowd.radius_deg).sum()
        ring = ((apart > 8.5) & (apart < 12.0)).sum()
        areas = (2 * crowd.radius_deg) ** 2 / (12.0**2 - 8.5**2)
        assert inside > least * ring * areas


def test_half_of_a_cluster_lies_within_its_radius():
    for crowd in CROWDS[2:]:
        order, pixels, shares = pixels_of(crowd)
        from catalog_tools.partition import positions_of

        below = 2 * (29 - order)
        v = directions(*positions_of((pixels << below) + (3 << (below - 2))))
        apart = np.degrees(separation_rad(v, directions(crowd.ra_deg, crowd.dec_deg)))
        within = shares[apart < crowd.radius_deg].sum()
        assert within == pytest.approx(0.5, abs=0.06), crowd.name
        assert PIXEL_DEG / 2**order < crowd.radius_deg
        assert interval_shares(crowd).sum() == pytest.approx(1.0)


@pytest.mark.parametrize("crowd", [CROWDS[1], CROWDS[12]], ids=["SMC", "Pleiades"])
def test_pixels_of_a_crowd_are_the_first_of_a_quarter_of_its_radius(crowd):
    order = pixels_of(crowd)[0]
    side_deg = np.degrees(np.sqrt(4.0 * np.pi / (12.0 * 4.0**order)))
    assert side_deg <= crowd.radius_deg / 4.0 < 2.0 * side_deg


@pytest.mark.parametrize("rows", [1, 2, 27_647, 27_648, 100_000])
def test_files_share_out_all_rows(rows):
    plan = make_plan(7, rows)
    parts = [places_in_file(plan, i) for i in range(plan.files)]
    assert [p.first_row for p in parts] == np.cumsum([0, *(p.pixels.size for p in parts)])[
        :-1
    ].tolist()
    assert sum(p.pixels.size for p in parts) == rows
    ends = [(p.pixels[0], p.pixels[-1]) for p in parts if p.pixels.size]
    assert all(a[1] < b[0] for a, b in pairwise(ends))


def test_limits_the_whole_of_dr2():
    """A plan of 1,692,919,135 rows: neighbouring files meet, wherever they are."""
    plan = make_plan(2, 1_692_919_135)
    assert plan.files == 61_234
    for number in (0, 20_000, 40_123, 61_233):
        here = places_in_file(plan, number)
        assert 20_000 < here.pixels.size < 35_000
        if number + 1 < plan.files:
            beyond = places_in_file(plan, number + 1)
            assert here.first_row + here.pixels.size == beyond.first_row
            assert here.pixels[-1] < beyond.pixels[0]
        else:
            assert here.first_row + here.pixels.size == plan.rows


@pytest.mark.slow
def test_same_bits_for_one_worker_and_after_a_kill(tmp_path, folder):
    other = tmp_path / "other"
    code = "from catalog_tools.synthetic.csv import *\n"
    code += f"write_csv_files({str(other)!r}, {ROWS}, workers=1)"
    process = subprocess.Popen([sys.executable, "-c", code], cwd=Path(__file__).parents[3])
    while process.poll() is None and not list(other.glob("Gaia*")):
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    (other / "_made.jsonl").open("a").write('{"number": 1, "na')
    kept = {path: path.stat().st_mtime_ns for path in other.glob("Gaia*")}
    assert kept
    assert not (other / "MD5SUM.txt").exists()
    write_csv_files(other, ROWS, workers=1)
    assert (other / "MD5SUM.txt").read_bytes() == (folder / "MD5SUM.txt").read_bytes()
    again = {path: path.stat().st_mtime_ns for path in other.glob("Gaia*")}
    write_csv_files(other, ROWS, workers=2)
    assert again == {path: path.stat().st_mtime_ns for path in other.glob("Gaia*")}
    assert {path.name for path in other.iterdir()} == {path.name for path in folder.iterdir()}
    cut, lost, *_ = sorted(other.glob("Gaia*"))
    whole = {path: path.read_bytes() for path in (cut, lost)}
    cut.write_bytes(whole[cut][:-20])
    lost.unlink()
    write_csv_files(other, ROWS, workers=1)
    assert whole == {path: path.read_bytes() for path in (cut, lost)}


def test_a_note_that_a_kill_cut_off_counts_for_nothing(tmp_path):
    """And the next one begins on a line of its own."""
    first = write_csv_files(tmp_path / "a", 300, workers=1)
    notes, (file,) = tmp_path / "a" / "_made.jsonl", (tmp_path / "a").glob("*.csv.gz")
    whole, content = notes.read_text(), file.read_bytes()
    notes.write_text(whole[:-40])
    file.unlink()
    assert write_csv_files(tmp_path / "a", 300, workers=1) == first
    assert (notes.read_text(), file.read_bytes()) == (whole, content)


def test_other_seed_other_stars(tmp_path, folder):
    write_csv_files(tmp_path / "a", 500, seed=3)
    write_csv_files(tmp_path / "b", 500, seed=4)
    a, b = ((tmp_path / x / "MD5SUM.txt").read_text() for x in "ab")
    assert a != b


def test_tables_without_the_text_are_what_a_reader_gets(tmp_path):
    """Bit for bit, null where the file has no value; so they need no file."""
    write_csv_files(tmp_path / "csv", 3_000, seed=5, workers=1)
    (path,) = (tmp_path / "csv").glob("*.csv.gz")
    direct = table_of_file(make_plan(5, 3_000), 0)
    assert direct["radial_velocity"].null_count > 2_000
    assert pa.concat_tables(read_tables(path)).equals(direct)


def test_ingest_keeps_every_row_and_equals_the_direct_catalogue(tmp_path, folder, columns):
    from catalog_tools.ingest.ingest import ingest

    report = ingest([folder], tmp_path / "made", rows_per_leaf=20_000, workers=1)
    assert report.rows_in == report.catalogue.rows == ROWS
    assert not report.rejected
    direct = make_sample(tmp_path / "direct", ROWS, rows_per_leaf=20_000)
    assert direct.catalogue.synthetic
    ours, theirs = (cone(r.catalogue, 0, 0, 180)[0] for r in (direct, report))
    assert ours.equals(theirs)
    assert sorted(columns["source_id"].astype(int)) == sorted(ours["source_id"].to_pylist())


@pytest.mark.parametrize(
    ("arguments", "field"),
    [({"rows": 0}, "rows"), ({"rows": 2_000_000_001}, "rows"), ({"seed": -1}, "seed"),
     ({"workers": 0}, "workers")],
)  # fmt: skip
def test_bad_input_names_its_field(tmp_path, arguments, field):
    with pytest.raises(BadInput) as caught:
        write_csv_files(tmp_path / "x", **{"rows": 10, **arguments})
    assert caught.value.field == field
    assert not list(tmp_path.iterdir())


def test_other_folders_are_left_alone(tmp_path, folder):
    for rows, seed in ((ROWS + 1, 2), (ROWS, 3)):
        with pytest.raises(BadInput, match="output"):
            write_csv_files(folder, rows, seed=seed)
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(BadInput, match="output"):
        write_csv_files(tmp_path, 10)
    with pytest.raises(BadInput, match="output"):
        write_csv_files(tmp_path / "mine.txt", 10)
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "_made.jsonl").write_text("{\n")
    with pytest.raises(BadInput, match="output"):
        write_csv_files(tmp_path / "bad", 10)


def test_every_file_of_every_sample_has_a_random_stream_of_its_own(monkeypatch):
    """Told before the first number is drawn from it."""
    starts = []

    def begun(*_):
        raise LookupError("what stands in a file")

    def noted(bits):
        starts.append(tuple(bits.seed_seq.generate_state(4)))

    monkeypatch.setattr(sample, "places_in_file", begun)
    monkeypatch.setattr(np.random, "Generator", noted)
    for seed, rows, number in product((2, 3), (900, 901), (0, 1)):
        with pytest.raises(LookupError):
            sample.stars_of_file(SimpleNamespace(seed=seed, rows=rows), number)
    assert len(set(starts)) == 8
