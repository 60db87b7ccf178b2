"""What a catalogue covers: stated by its sources, or derived from its rows; kept, proved, told."""

from __future__ import annotations

import hashlib
import json
import math
import re
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from star_rows import random_stars, write_csv

from catalog_tools.catalogue import MANIFEST_NAME, _digest, open_catalogue
from catalog_tools.coverage import (
    MOST_RANGES,
    Coverage,
    all_sky,
    coverage_of,
    from_json,
    of_pixels,
    of_rows,
    united,
)
from catalog_tools.errors import Damaged
from catalog_tools.fetch.fetched import note_coverage
from catalog_tools.fetch.layout import RELEASES, Entry, files_coverage
from catalog_tools.geometry.healpix import pixels_of
from catalog_tools.info import info
from catalog_tools.ingest.ingest import ingest
from catalog_tools.partition import COUNT_ORDER
from catalog_tools.synthetic.synthetic import make_demo
from catalog_tools.verify.verify import verify
from tests.command import nightglass


def cap_area(radius_deg: float) -> float:
    """Fraction of the sky within a cone."""
    return 0.5 * (1.0 - math.cos(math.radians(radius_deg)))


def in_cone(n: int, ra_deg: float, dec_deg: float, radius_deg: float, seed: int = 1):
    """n directions [deg] spread evenly over a small cone."""
    rng = np.random.default_rng(seed)
    r, turn = radius_deg * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    dec = dec_deg + r * np.sin(turn)
    return ra_deg + r * np.cos(turn) / np.cos(np.radians(dec)), dec


def over_sky(n: int, seed: int = 1):
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 360, n), np.degrees(np.arcsin(rng.uniform(-1, 1, n)))


def counts_of(ra, dec):
    return np.bincount(pixels_of(COUNT_ORDER, ra, dec), minlength=12 * 4**COUNT_ORDER)


def changed_manifest(catalogue, folder: Path, change) -> Path:
    """A copy of a catalogue whose manifest is changed, with a digest that agrees."""
    shutil.copytree(catalogue.path, folder)
    path = folder / MANIFEST_NAME
    document = json.loads(path.read_text())
    change(document)
    document["sha256"] = _digest(document["catalogue"])
    path.write_text(json.dumps(document))
    for name in ("properties", "hats.properties"):
        text = (folder / name).read_text()
        (folder / name).write_text(text.replace(catalogue.digest, document["sha256"]))
    return folder


def test_the_deepest_of_what_overlaps_counts() -> None:
    """A shallow cone over a deep one, and over a deep sky, whichever comes first."""
    deep, shallow = (40.0, 10.0, 3.0, 19.0), (41.0, 10.0, 3.0, 15.0)
    for cones in ((deep, shallow), (shallow, deep)):
        found = all_sky("x", 12.0, cones).limits_g_mag([38.0, 40.5, 43.5, 60.0], 10.0)
        assert found.tolist() == [19.0, 19.0, 15.0, 12.0]
    assert all_sky("x", 17.0, [shallow]).limits_g_mag(41.0, 10.0).tolist() == [17.0]


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """2,000 made-up stars within a degree about RA 130, Dec 12."""
    folder = tmp_path_factory.mktemp("field")
    stars = random_stars(2000, 4, around=(130.0, 12.0, 1.0))
    return ingest([write_csv(folder / "stars.csv", stars)], folder / "made").catalogue


@pytest.mark.parametrize("n", [100, 300, 3000, 60_000])
def test_rows_all_over_the_sky_leave_no_gap(n):
    coverage = of_rows(counts_of(*over_sky(n, n)))
    limits = coverage.limits_g_mag(*over_sky(20_000, 7))
    assert np.isposinf(limits).mean() > 0.9995
    assert coverage.sky_fraction > 0.9995


@pytest.mark.parametrize(("n", "radius_deg", "most"), [
    (20_000, 10.0, 1.2), (5000, 1.0, 1.45), (1000, 0.5, 2.1), (150, 5.0, 3.5),
])  # fmt: skip
def test_rows_of_a_field_cover_it_and_little_more(n, radius_deg, most):
    """Also with a handful of stray rows far away, which do not spread it over the sky."""
    ra, dec = in_cone(n, 130.0, 11.8, radius_deg)
    stray_ra, stray_dec = over_sky(5, 3)
    coverage = of_rows(counts_of(np.append(ra, stray_ra), np.append(dec, stray_dec)))
    inside = coverage.limits_g_mag(*in_cone(5000, 130.0, 11.8, radius_deg, seed=2))
    assert np.isposinf(inside).mean() > 0.998
    assert coverage.sky_fraction < most * cap_area(radius_deg)
    assert np.isneginf(coverage.limits_g_mag([310.0, 130.0], [-11.8, 40.0])).all()


def test_a_sparse_sky_around_a_deep_field_stays_covered():
    sky, deep = over_sky(3000, 5), in_cone(50_000, 200.0, -40.0, 1.0)
    both = (np.concatenate(pair) for pair in zip(sky, deep, strict=True))
    coverage = of_rows(counts_of(*both))
    assert np.isposinf(coverage.limits_g_mag(*in_cone(5000, 200.0, -40.0, 20.0))).mean() > 0.999
    assert coverage.sky_fraction > 0.999


def test_each_sparse_pixel_covers_all_eight_around_it():
    """4 rows in each of 8 by 8 pixels: these and one more on every side, corners too."""
    counts = np.zeros(12 * 4**COUNT_ORDER, np.int64)
    counts[64 * 40_001 : 64 * 40_002] = 4
    assert of_rows(counts).sky_fraction == pytest.approx(100 / counts.size, rel=1e-12)


def test_more_fields_than_may_be_listed_are_told_in_coarser_pixels():
    """10,000 pixels far from each other, each with rows of its own: none is left out."""
    counts = np.zeros(12 * 4**COUNT_ORDER, np.int64)
    held = np.arange(10_000) * 300
    counts[held] = 100
    coverage = of_rows(counts)
    assert len(coverage.ranges) <= MOST_RANGES
    assert coverage.order < COUNT_ORDER
    pixels = held >> (2 * (COUNT_ORDER - coverage.order))
    first, end = coverage.ranges.T
    assert (pixels < end[np.searchsorted(first, pixels, side="right") - 1]).all()


def test_few_rows_tell_nothing():
    coverage = of_rows(counts_of(*in_cone(99, 10.0, 0.0, 1.0)))
    assert not coverage.known
    assert coverage.sky_fraction is None
    assert np.isposinf(coverage.limits_g_mag([10.0, 200.0], [0.0, 60.0])).all()


def test_overlapping_cones_count_once_and_keep_their_limits():
    cones = np.array([[10.0, 20.0, 2.0, 16.0], [11.0, 20.0, 2.0, math.inf], [200.0, 0, 1.0, 12.0]])
    coverage = Coverage("cones", cones=cones)
    far = 1.0 * math.cos(math.radians(20.0)) / 2.0  # half the way between the first two [deg]
    lens = 2 * (4 * math.acos(far / 2) - far * math.sqrt(4 - far**2))
    wanted = 2 * cap_area(2.0) + cap_area(1.0) - lens / (math.degrees(1) ** 2 * 4 * math.pi)
    assert coverage.sky_fraction == pytest.approx(wanted, rel=2e-3)
    assert coverage.limits_g_mag([8.5, 10.5, 12.5, 200.0, 90.0], [20, 20, 20, 0.5, 0]).tolist() == [
        16.0, math.inf, math.inf, 12.0, -math.inf,
    ]  # fmt: skip
    again = from_json(json.loads(json.dumps(coverage.to_json(), allow_nan=False)))
    assert again.to_json() == coverage.to_json()


def test_ranges_that_overlap_are_joined():
    coverage = of_pixels("files", 3, [5, 0, 20, 9, 2], [9, 3, 30, 12, 8])
    assert coverage.ranges.tolist() == [[0, 12], [20, 30]]
    assert coverage.sky_fraction == pytest.approx(22 / 768)


@pytest.mark.parametrize("broken", [
    {"order": 30}, {"ranges": [[5, 3]]}, {"ranges": [[0, 13]]}, {"cones": [[0, 91, 1, None]]},
    {"cones": [[0]]}, {"ranges": "x"}, {"source": None, "cones": None},
    {"cones": [[0, 0, 180.1, None]]}, {"cones": [[0, 0, 0, None]]},
])  # fmt: skip
def test_what_is_no_coverage_is_refused(broken):
    with pytest.raises(ValueError):
        from_json(all_sky("x").to_json() | broken)


def test_cones_of_half_the_sky_and_more_are_read_back():
    cones = [[10.0, -20.0, 120.0, 16.0], [200.0, 90.0, 180.0, 12.5]]
    again = from_json(all_sky("x", 5.0, cones).to_json())
    assert again.cones.tolist() == cones
    assert again.faintest_g_mag == 5.0


def test_the_files_of_a_whole_release_leave_no_gap():
    ids = 12 << 59  # of nested pixels of order 12, above 35 bits
    edges = [ids * i // 1000 for i in range(1001)]
    entries = [Entry(str(a), "", a + 5, b - 7) for a, b in pairwise(edges)]
    coverage = files_coverage(RELEASES["gaia-dr2"], entries)
    assert coverage.ranges.tolist() == [[0, 12 * 4**9]]
    assert files_coverage(RELEASES["gaia-dr2"], entries[:10]).sky_fraction == pytest.approx(
        0.01, rel=1e-4
    )


def test_a_fetched_cone_is_what_the_catalogue_covers(tmp_path):
    stars = random_stars(300, 2, around=(130.0, 12.0, 0.5))
    (tmp_path / ".fetch").mkdir()
    for name, rows in (("a.csv", stars.slice(0, 100)), ("b.csv", stars.slice(100))):
        write_csv(tmp_path / name, rows)
    for name, ra in (("a.csv", 130.0), ("b.csv", 140.0)):
        cone = Coverage("fetched cones", cones=np.array([[ra, 12.0, 3.0, 16.5]]))
        note_coverage(tmp_path, [name], cone)
    made = ingest([tmp_path], tmp_path / "out" / "both")
    assert made.catalogue.coverage["source"] == "fetched cones"
    told = info(made.catalogue)["coverage"]
    assert told["sky_fraction"] == pytest.approx(2 * cap_area(3.0), rel=1e-5)
    assert coverage_of(made.catalogue).limits_g_mag([142.0, 135.0], [12, 12]).tolist() == [
        16.5, -math.inf,
    ]  # fmt: skip
    assert verify(made.catalogue).whole
    one = ingest([tmp_path / "b.csv"], tmp_path / "out" / "one").catalogue
    assert coverage_of(one).cones.tolist() == [[140.0, 12.0, 3.0, 16.5]]
    write_csv(tmp_path / "c.csv", random_stars(200, 8, around=(130.0, 12.0, 0.4)))
    other = ingest([tmp_path / "b.csv", tmp_path / "c.csv"], tmp_path / "out" / "other")
    assert other.catalogue.coverage["source"] == "its rows"
    assert any("derived from its rows" in note for note in other.notes)


def test_the_archives_complete_list_is_the_whole_sky(tmp_path, monkeypatch):
    names = ["GaiaSource_0_99.csv", "GaiaSource_100_199.csv"]
    short = replace(RELEASES["gaia-dr2"], files=2, file_name=re.compile(r"GaiaSource_\d+_\d+\.csv"))
    monkeypatch.setitem(RELEASES, "gaia-dr2", short)
    stars = random_stars(400, 3, around=(50.0, 0.0, 1.0))
    lines = []
    for i, name in enumerate(names):
        path = write_csv(tmp_path / name, stars.slice(200 * i, 200))
        lines.append(f"{hashlib.md5(path.read_bytes()).hexdigest()}  {name}")
    (tmp_path / "MD5SUM.txt").write_text("\n".join(lines) + "\n")
    made = ingest([tmp_path], tmp_path / "out" / "whole").catalogue
    assert info(made)["coverage"] == {"source": "all files of Gaia DR2", "sky_fraction": 1.0}
    part = ingest([tmp_path / names[0]], tmp_path / "out" / "part").catalogue
    assert info(part)["coverage"]["sky_fraction"] < 0.001


def test_a_synthetic_sky_says_how_deep_it_is_where(tmp_path):
    made = make_demo(tmp_path / "demo", faintest_g_mag=5.0, deep_fields=[(200.0, 60.0, 1.0, 12.0)])
    limits = coverage_of(made.catalogue).limits_g_mag([200.0, 200.0], [60.5, 62.0])
    assert limits.tolist() == [12.0, 5.0]
    assert info(made.catalogue)["coverage"]["sky_fraction"] == 1.0


def test_a_cone_outside_is_noted(field, tmp_path):
    for ra, words in (("130", ""), ("150", "covers 0% of this cone (by its rows)")):
        place = ("--ra", ra, "--dec", "12", "--radius", "0.3", "-o", tmp_path / f"{ra}.csv")
        done = nightglass("catalog", "cone", field.path, *place)
        assert done.returncode == 0
        assert words in done.stderr
        assert ("note:" in done.stderr) == bool(words)


def test_verify_proves_the_coverage(field, tmp_path):
    assert verify(field).whole
    held = field.coverage["ranges"]

    def fewer(document):
        document["catalogue"]["coverage"]["ranges"] = held[1:]

    def broken(document):
        document["catalogue"]["coverage"]["order"] = 77

    for name, change, words in (("a", fewer, "not that of its rows"), ("b", broken, "understood")):
        copy = open_catalogue(changed_manifest(field, tmp_path / name, change))
        (finding,) = verify(copy).findings
        assert words in finding.what, finding
    with pytest.raises(Damaged, match="coverage"):
        info(copy)


def test_older_catalogues_open_and_are_covered_by_their_leaves(field, tmp_path):
    def older(document):
        document["version"] = 3
        for key in ("coverage", "without_colour"):
            document["catalogue"].pop(key, None)

    old = open_catalogue(changed_manifest(field, tmp_path / "old", older))
    coverage = coverage_of(old)
    assert "before coverage was kept" in info(old)["coverage"]["source"]
    ra, dec = in_cone(500, 130.0, 12.0, 0.9)
    assert np.isposinf(coverage.limits_g_mag(ra, dec)).all()
    assert np.isneginf(coverage.limits_g_mag([134.0, 310.0], [12.0, -12.0])).all()
    assert cap_area(1.0) < coverage.sky_fraction < 3.5 * cap_area(1.0)
    assert verify(old).whole


def test_an_older_catalogue_of_the_whole_sky_has_no_gap(tmp_path):
    made = make_demo(tmp_path / "demo", faintest_g_mag=6.0, rows_per_leaf=300).catalogue
    coverage = coverage_of(replace(made, coverage=None))
    assert np.isposinf(coverage.limits_g_mag(*over_sky(20_000))).mean() > 0.9995
    assert coverage.sky_fraction > 0.9995


def test_a_real_field_is_what_its_rows_cover(shared_data, tmp_path):
    """M67, a cone of 0.667 deg: 1.4 deg2 of 41,253."""
    source = shared_data / "gaia_dr2" / "m67_field" / "M67_data.csv"
    made = ingest([source], tmp_path / "m67").catalogue
    coverage = coverage_of(made)
    assert 1.0 < coverage.sky_fraction / cap_area(0.667) < 1.7
    inside = coverage.limits_g_mag(*in_cone(2000, 132.847, 11.814, 0.66))
    assert np.isposinf(inside).mean() > 0.999
    assert np.isneginf(coverage.limits_g_mag([134.2, 56.75], [11.8, 24.1])).all()
    assert len(made.coverage["ranges"]) < 200
    assert verify(made).whole


def test_ranges_within_others_end_none_of_them():
    coverage = of_pixels("files", 3, [0, 2, 6, 12, 12], [10, 4, 8, 13, 15])
    assert coverage.ranges.tolist() == [[0, 10], [12, 15]]


def test_ranges_keep_their_limit_beside_cones_that_have_their_own():
    """Together they are complete to it at most, whichever comes first."""
    ranges = replace(of_pixels("ranges", 0, np.array([3]), np.array([4])), faintest_g_mag=17.0)
    cones = Coverage("cones", cones=np.array([[10.0, 12.0, 3.0, 18.5]]))
    for parts in ([ranges, cones], [cones, ranges]):
        assert united(parts).faintest_g_mag == 17.0
