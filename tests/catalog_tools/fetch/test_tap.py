"""Cone queries through pyvo's own client, against a local TAP service."""

from __future__ import annotations

import gzip
import hashlib
import operator
import os
import re

import astropy.units as u
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from astropy.coordinates import SkyCoord
from star_rows import random_stars, same_rows
from tap_server import TapServer, votable

from catalog_tools.coverage import coverage_of
from catalog_tools.errors import BadInput, Damaged, Incomplete
from catalog_tools.fetch import tap, tap_service
from catalog_tools.fetch.cones import FetchCone
from catalog_tools.fetch.fetch import fetch
from catalog_tools.fetch.layout import release_named
from catalog_tools.fetch.tap import file_name
from catalog_tools.ingest.ingest import ingest
from catalog_tools.readers import read_tables

CONE = FetchCone(359.8, -40.0, 1.5)


@pytest.fixture(scope="module")
def sky():
    """1,200 stars about RA 0, with every hard case."""
    return random_stars(1_200, seed=9, around=(359.9, -40.0, 2.0))


@pytest.fixture
def service(sky):
    with TapServer(sky) as server:
        yield server


def expected(stars: pa.Table, cone: FetchCone) -> pa.Table:
    places = SkyCoord(stars["ra"].to_numpy() * u.deg, stars["dec"].to_numpy() * u.deg)
    apart = places.separation(SkyCoord(cone.ra_deg * u.deg, cone.dec_deg * u.deg))
    inside = apart <= cone.radius_deg * u.deg
    if cone.faintest_g_mag is not None:
        inside &= stars["phot_g_mean_mag"].to_numpy().astype(float) <= cone.faintest_g_mag
    return stars.filter(pa.array(np.asarray(inside)))


def ask(service, folder, patience, *cones, **options):
    options = {"cones": cones or (CONE,), "tap_url": service.url} | options
    return fetch("gaia-dr2", folder, patience=patience, **options)


def read(folder, report, i: int = 0) -> pa.Table:
    return pa.concat_tables(read_tables(folder / report.files[i]))


def test_rows_of_a_cone_come_exactly(service, sky, tmp_path, hasty):
    seen = []
    report = ask(service, tmp_path, hasty, progress=lambda *tick: seen.append(tick))
    wanted = expected(sky, CONE)
    assert wanted.num_rows > 400
    assert same_rows(read(tmp_path, report), wanted)
    assert seen[-1] == ("query", wanted.num_rows, wanted.num_rows)
    assert report.files == ("gaia-dr2_cone_359.8_-40.0_1.5.csv.gz",)
    asked = len(service.queries)
    again = ask(service, tmp_path, hasty)
    assert (again.downloaded, again.present, len(service.queries)) == (0, 1, asked)
    (tmp_path / report.files[0]).write_bytes(b"changed")
    assert ask(service, tmp_path, hasty).downloaded == 1
    assert same_rows(read(tmp_path, report), wanted)


def test_large_results_come_by_jobs_that_are_removed(service, sky, tmp_path, hasty, monkeypatch):
    monkeypatch.setattr(tap_service, "SYNC_ROWS", 100)
    report = ask(service, tmp_path, hasty)
    assert same_rows(read(tmp_path, report), expected(sky, CONE))
    assert [how for how, _ in service.queries] == ["sync", "async"]
    assert service.deleted == len(service.jobs) == 1


def test_magnitude_limits(service, sky, tmp_path, hasty):
    own = FetchCone(0.3, -39.5, 1.0, 12.25)
    report = ask(service, tmp_path, hasty, CONE, own, faintest_g_mag=15.5)
    for i, cone in enumerate((FetchCone(359.8, -40.0, 1.5, 15.5), own)):
        assert same_rows(read(tmp_path, report, i), expected(sky, cone))


@pytest.mark.parametrize(("limit", "told"), [(300, True), (300, False), (25, True)])
def test_cut_results_are_asked_for_in_parts(service, sky, tmp_path, hasty, limit, told):
    service.does.most_rows, service.does.tells_overflow = limit, told
    report = ask(service, tmp_path, hasty)
    assert same_rows(read(tmp_path, report), expected(sky, CONE))


def test_memory_is_bounded_by_parts(service, sky, tmp_path, hasty, monkeypatch):
    monkeypatch.setattr(tap, "ROWS_AT_ONCE", 150)
    seen = []
    report = ask(service, tmp_path, hasty, progress=lambda *tick: seen.append(tick))
    wanted = expected(sky, CONE)
    assert same_rows(read(tmp_path, report), wanted)
    done = [rows for _, rows, _ in seen]
    assert len(done) > 3
    assert done == sorted({0, *done, wanted.num_rows})
    assert {(stage, total) for stage, _, total in seen} == {("query", wanted.num_rows)}
    pole = FetchCone(10.0, -90.0, 51.0)  # the bands end at the pole
    report = ask(service, tmp_path, hasty, pole)
    assert same_rows(read(tmp_path, report), expected(sky, pole))


def test_a_service_that_loses_rows_is_not_believed(service, tmp_path, hasty):
    service.does.lost_rows = 1
    with pytest.raises(Incomplete, match=r"gives \d+ of \d+ rows, and not always"):
        ask(service, tmp_path, hasty, FetchCone(359.8, -40.0, 0.4))
    assert not list(tmp_path.glob("*.csv.gz"))


def test_rows_that_come_while_a_cone_is_fetched_are_not_taken(
    service, tmp_path, hasty, monkeypatch
):
    """The count of the whole cone is that before; its two halves have a row more."""
    count = tap.Question.count
    monkeypatch.setattr(tap, "ROWS_AT_ONCE", 150)
    monkeypatch.setattr(
        tap.Question, "count", lambda q, band: count(q, band) - (band == tap.DeclinationBand())
    )
    with pytest.raises(Incomplete, match=r"(\d+) rows came where COUNT\(\*\) says") as told:
        ask(service, tmp_path, hasty)
    came, counted = re.search(r"(\d+) rows came .* says (\d+)$", str(told.value)).groups()
    assert int(came) == int(counted) + 1
    assert not list(tmp_path.glob("*.csv.gz"))


def test_failures_that_pass(service, sky, tmp_path, hasty):
    service.does.first = [(503, {"Retry-After": "0"}), (429, {"Retry-After": "0"})]
    service.does.sync_fails = 1
    service.does.cut_results = 2
    report = ask(service, tmp_path, hasty)
    assert same_rows(read(tmp_path, report), expected(sky, CONE))


def test_refused_jobs_say_why(service, tmp_path, hasty):
    service.does.sync_fails = 2
    service.does.job_fails = "statement timeout"
    with pytest.raises(Incomplete, match=r"refused: .*statement timeout"):
        ask(service, tmp_path, hasty)
    assert service.deleted == len(service.jobs) == 1
    service.does.job_fails = ""
    with pytest.raises(Incomplete, match="no such table"):
        fetch("gaia-dr3", tmp_path / "3", cones=[CONE], tap_url=service.url, patience=hasty)


def test_a_job_is_looked_at_again_as_long_as_patience_lasts(
    service, sky, tmp_path, hasty, monkeypatch
):
    monkeypatch.setattr(tap_service, "SYNC_ROWS", 100)
    service.does.busy_looks = hasty.tries - 1
    report = ask(service, tmp_path / "few", hasty)
    assert same_rows(read(tmp_path / "few", report), expected(sky, CONE))
    assert len(service.jobs) == 1
    service.does.busy_looks = 10**6
    with pytest.raises(Incomplete, match="tries in a row"):
        ask(service, tmp_path / "many", hasty)
    assert service.deleted == len(service.jobs)


def test_a_job_that_does_not_end_is_given_up_and_removed(service, tmp_path, hasty, monkeypatch):
    monkeypatch.setattr(tap_service, "SYNC_ROWS", 100)
    monkeypatch.setattr(tap_service, "LONGEST_JOB_S", -1.0)
    with pytest.raises(Incomplete, match="a job did not end within"):
        ask(service, tmp_path, hasty)
    assert service.deleted == len(service.jobs) == 1


@pytest.mark.parametrize(("names", "row", "said"), [
    (["n", "m"], (1, 2), r"COUNT\(\*\) gave a table of \(1, 2\)"),
    (["name"], ("many",), r"column 'name' as <U8, not numbers"),
])  # fmt: skip
def test_answers_that_are_no_count_are_not_believed(
    service, tmp_path, hasty, monkeypatch, names, row, said
):
    monkeypatch.setattr(service, "run", lambda form: votable(names, [row], "OK"))
    with pytest.raises(Incomplete, match=said):
        ask(service, tmp_path, hasty)


def test_a_cone_that_was_deleted_is_asked_for_again(service, sky, tmp_path, hasty):
    (name,) = ask(service, tmp_path, hasty).files
    (tmp_path / name).unlink()
    report = ask(service, tmp_path, hasty)
    assert (report.downloaded, report.present) == (1, 0)
    assert same_rows(read(tmp_path, report), expected(sky, CONE))


def test_a_file_that_lost_rows_on_its_way_to_the_disk_is_damage(
    service, tmp_path, hasty, monkeypatch
):
    write = tap._write_rows
    monkeypatch.setattr(tap, "_write_rows", lambda table, file: write(table.slice(1), file))
    with pytest.raises(Damaged, match=r"it has (\d+) rows, (\d+) were written") as told:
        ask(service, tmp_path, hasty)
    held, written = map(int, re.findall(r"\d+ ?(?=rows|were)", told.value.reason))
    assert held == written - 1
    assert not list(tmp_path.glob("*.csv.gz"))


def test_addresses_that_are_no_service(service, tmp_path, hasty):
    for url, said in (
        (service.url + "/nothing", "it answers 404"),
        ("file:///tmp", "http:// or https://"),
    ):
        with pytest.raises(BadInput, match=said):
            ask(service, tmp_path, hasty, tap_url=url)
    with pytest.raises(Incomplete, match="tries in a row"):
        ask(service, tmp_path, hasty, tap_url="http://127.0.0.1:9/tap")


def test_empty_cone_is_an_empty_file(service, tmp_path, hasty):
    report = ask(service, tmp_path, hasty, FetchCone(180.0, 60.0, 0.1))
    assert sum(table.num_rows for table in read_tables(tmp_path / report.files[0])) == 0


def test_other_release(sky, tmp_path, hasty):
    with TapServer(sky, ref_epoch=2016.0, schema="gaiadr3") as service:
        report = fetch("gaia-dr3", tmp_path, cones=[CONE], tap_url=service.url, patience=hasty)
    lines = gzip.decompress((tmp_path / report.files[0]).read_bytes()).decode().splitlines()
    assert lines[0].startswith("# Gaia DR3 (ESA/Gaia/DPAC), positions at J2016.0;")
    assert {line.rpartition(",")[2] for line in lines[3:]} == {"2016"}
    assert len(lines) == 3 + expected(sky, CONE).num_rows


def test_same_bytes_every_time(service, tmp_path, hasty):
    digests = set()
    for folder in (tmp_path / "a", tmp_path / "b"):
        report = ask(service, folder, hasty)
        digests.add(hashlib.sha256((folder / report.files[0]).read_bytes()).hexdigest())
    assert len(digests) == 1


def test_a_cone_that_is_there_is_asked_for_again_only_where_it_changed(service, tmp_path, hasty):
    """A decay that no date tells is found with `verify`; the others stay as they are."""
    cones = CONE, FetchCone(359.9, -40.5, 0.4)
    path, other = (tmp_path / name for name in ask(service, tmp_path, hasty, *cones).files)
    whole, kept = path.read_bytes(), other.stat().st_ino
    for bad, options, counts in (
        (False, {}, (0, 2)), (False, {"verify": True}, (0, 2)), (True, {}, (0, 2)),
        (True, {"verify": True}, (1, 1)),
    ):  # fmt: skip
        state = path.stat()
        path.write_bytes(whole[:-9] + bytes([whole[-9] ^ 1]) + whole[-8:] if bad else whole)
        os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
        report = ask(service, tmp_path, hasty, *cones, **options)
        assert (report.downloaded, report.present) == counts
    assert path.read_bytes() == whole
    assert other.stat().st_ino == kept


def test_fetched_cones_are_ingested(service, sky, tmp_path, hasty):
    """Overlapping cones give rows twice; ingest keeps one of each and says so."""
    from catalog_tools.ingest.ingest import ingest
    from catalog_tools.query.query import cone as rows_in_cone

    other = FetchCone(0.5, -40.0, 1.0)
    ask(service, tmp_path / "rows", hasty, CONE, other, FetchCone(180.0, 60.0, 0.1))
    made = ingest([tmp_path / "rows"], tmp_path / "made", workers=1)
    rows = [expected(sky, cone) for cone in (CONE, other)]
    distinct = len(pc.unique(pa.concat_tables(rows)["source_id"]))
    assert made.catalogue.rows == distinct
    assert sum(made.rejected.values()) == rows[0].num_rows + rows[1].num_rows - distinct > 0
    stars, _ = rows_in_cone(made.catalogue, CONE.ra_deg, CONE.dec_deg, CONE.radius_deg)
    assert same_rows(stars, rows[0])


def test_what_was_asked_for_is_what_the_catalogue_covers(service, sky, tmp_path, hasty):
    """A cone that is cut at G = 15, and one without a star: both are covered, nothing else is."""
    bright, void = FetchCone(359.8, -40.0, 1.5, 15.0), FetchCone(100.0, 10.0, 1.0)
    ask(service, tmp_path / "fetched", hasty, bright, void)
    report = ingest([tmp_path / "fetched"], tmp_path / "made")
    assert report.catalogue.rows == expected(sky, bright).num_rows
    assert "gaia-dr2_cone_100.0_10.0_1.0.csv.gz holds no row" in report.notes
    limits = coverage_of(report.catalogue).limits_g_mag([0.2, 100.5, 4.0], [-40.0, 10.5, -40.0])
    assert limits.tolist() == [15.0, np.inf, -np.inf]


def test_every_cone_has_a_file_of_its_own():
    """One that were taken for another's would be called fetched, and cover what it does not."""
    cones = [FetchCone(10.0, 20.0, 1.0), FetchCone(10.0, 20.0, 1.0, 15.0)]
    cones += [FetchCone(10.0, 20.0, 1.0, 15.5), FetchCone(10.0, 20.0, 1.5)]
    cones += [FetchCone(10.0, -20.0, 1.0), FetchCone(10.000001, 20.0, 1.0)]
    names = {file_name(release_named(r), c) for c in cones for r in ("gaia-dr2", "gaia-dr3")}
    assert len(names) == 2 * len(cones)


def test_a_row_on_the_border_of_two_bands_is_in_one_of_them():
    """Bands that are halved twice: each declination, also of a border, is asked for once."""
    cone = FetchCone(10.0, 20.0, 1.0, 15.0)
    bands = [b for half in tap.DeclinationBand().halves(cone) for b in half.halves(cone)]
    asked = [re.findall(r"dec ([<>]=?) ([\d.]+)", tap.condition(cone, band)) for band in bands]
    borders = {band.low_deg for band in bands} - {None}
    assert borders == {19.5, 20.0, 20.5}
    compare = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
    for dec in (19.1, *borders, 20.9):
        held = [all(compare[how](dec, float(border)) for how, border in each) for each in asked]
        assert sum(held) == 1
