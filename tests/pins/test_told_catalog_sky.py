"""What catalogues answer, what `verify` finds, pure functions of the sky, synthetic stars, fetch.

Cases are lines of text, as in test_told_catalog.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import requests
import urllib3

from catalog_tools.catalogue import Catalogue, open_catalogue
from catalog_tools.columns import INCOMING, NAMES
from catalog_tools.geometry.regions import Cone, cone_of, polygon_of
from catalog_tools.ingest import shards
from catalog_tools.ingest.ingest import ingest
from catalog_tools.query import query, starlight
from catalog_tools.verify.verify import verify
from tests.pins.test_told_catalog import here, show, stars, tell, write_csv

__all__ = ["here"]
EDGE = [0.0, 90.0, -90.0, 41.81, -41.82, 89.9999999, 45.0, -12.3, 12.3]  # declinations
TURN = [0.0, 359.9999999, 90.0, 180.0, -1e-17, 720.5, 45.0, 270.0, 1.5]
SKY = """
sphere.directions(TURN, EDGE)
sphere.angles_deg(V * 3.0)
sphere.angles_deg(np.array([-1.0, -1e-20, 0.0]))
sphere.separation_rad(V, V[::-1])
sphere.cap_of(V), sphere.cap_of(V[6:8]), sphere.cap_of(np.array([[1.0, 0, 0], [-1.0, 0, 0]]))
sphere.cap_of_caps(V[6:], np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
for x in [None, 50.0]: sphere.moved(V[:, 0] * 9, V[:, 1], MAS, -MAS, 25.0, MAS, x and V[:, 2] * x)
for x in [0, 1, 2, 3, 9, 12, 29]: healpix.pixels_of(x, TURN, EDGE)
for x in [0, 1, 3, 29]: healpix.centres_of(x, np.unique(healpix.pixels_of(x, TURN, EDGE)))
for x in [0, 1, 2]: healpix.neighbours_of(x, np.arange(12 * 4**x))
healpix.neighbours_of(29, healpix.pixels_of(29, TURN, EDGE))
for x in [0, 1, 3]: healpix_interpolation.neighbours(x, W)
healpix.centres_of(2, np.arange(192))
regions.cone_of(10, 20, 180), regions.cone_of(0, -90, 0.5)
for x in [(np.nan, 0, 1), (0, 91, 1), (0, 0, 0), (0, 0, 181)]: regions.cone_of(*x)
for x in SHAPES: about(regions.polygon_of(SHAPES[x]))
for x in [[1, 2], [(0, 0), (1, 1)], [(0, 0), (1, 91), (2, 0)]]: regions.polygon_of(x)
for x in [[(0, 0), (0, 0), (5, 5)], [(0, 0), (120, 0), (240, 0)]]: regions.polygon_of(x)
regions.polygon_of([(0, 0), (9, 9), (9, 0), (0, 9)])
regions.Polygon(((np.nan, 0, 0), (1, 0, 0), (0, 1, 0)))
regions.Polygon(((1, 0, 0), (0, 1, 0)))
about(Cone((0.6, 0.8, 0.0), 0.3)), Cone((0.6, 0.8, 0.0), 0.3).inner_radius_rad
selection.motion_pad_rad(MAS, 40 * MAS, -30.0, 1.1)
selection.motion_pad_rad([0, 1e5, 1], [1e9, 1e4, 0], 0.0, 0.5)
for x in [(5, 0, 1), (1e6, 1e5, 1)]: selection.motion_pad_rad(*x, 0.0), selection.years_to(A, 2000)
coverage.all_sky("a", 12, [(10, 20, 5, 15)]).limits_g_mag([10, 100], [20, 0])
for x in PARTS: x.describe(), x.to_json(), x.fraction_of_cone(10, 20, 9), x.limits_g_mag(TURN, EDGE)
for x in PARTS: coverage.from_json(x.to_json())
coverage.united([coverage.of_pixels("a", 1, [4, 9], [6, 12]), PARTS[1]])
coverage.united(PARTS[2:4])
for x in [{}, dict(ranges=[[5, 4]]), dict(ranges=[[0, 193]]), dict(order=30)]: said(x)
for x in [dict(cones=[[0, 91, 1, None]]), dict(cones=[[0, 0, 0, 3]]), dict(cones=[[1]])]: said(x)
said(None)
for x in [1, 12, 90, 400, 5000]: coverage.of_rows(counts(x)).to_json()
for x in [9, 17, 36]: coverage.of_rows(counts(5000, x)).sky_fraction
[(c.order, c.pixel, c.rows, c.first_29, c.end_29) for c in partition.choose_leaves(counts(400), 50)]
partition.choose_leaves(counts(90, 9), 2, lambda a, b: int(a in (0, 4**26)))
partition.coarser_counts(partition.healpix_29(np.array(TURN), np.array(EDGE)))
star_counts.all_sky_count([2, 3, 9.3, 15, 21, 25])
for x in [0, 5, 20, 35]: star_counts.interval_density(x, V), star_counts._plane_strength(x)
star_counts.galactic_rad(V)
star_counts.bahcall_soneira(14.5, np.array([0.0, 2, 4]), np.array([1.5, -0.4, 0.7]))
for x in [5.0, 15.2]: starlight.CountedLight().fainter(x, V)
starlight.CountedLight(20.0, 30.0, True).fainter(4.0, V), starlight.CountedLight(5.5).source
starlight.AddedLight((starlight.CountedLight(faintest_g_mag=9.0),) * 2).fainter(3.0, V)
starlight.AddedLight((starlight.CountedLight(faintest_g_mag=9.0),) * 2).source
for x in [1.0, 3.0, 3.1, 9.75, 21.9, 22.0, 23.0]: starlight._shares(x)
starlight._typical_light()
gaia_ids.misplaced(IDS, np.array(TURN), np.array(EDGE))
gaia_ids.misplaced(IDS + (np.arange(9) ** 5 << 35), np.array(TURN), np.array(EDGE))
gaia_ids.refuse_most("w", 10, 5, IDS, V[:, 0], V[:, 1])
gaia_ids.refuse_most("w", 10, 6, IDS, V[:, 0], V[:, 1])
"""


SHAPES = {
    "triangle": [(350, -5), (20, 0), (5, 20)],
    "clockwise": [(5, 20), (20, 0), (350, -5)],
    "pole": [(0, 80), (90, 70), (180, 85), (270, 75)],
    "hollow": [(0, 0), (30, 0), (30, 20), (15, 3), (0, 20)],
}


def counts(rows: int, modulus: int = 0, order: int = 3) -> np.ndarray:
    """Rows by pixel: all over the sky, or a few pixels only."""
    found = np.zeros(12 * 4**order, np.int64)
    steps = np.arange(rows) ** 2 * 7
    np.add.at(found, steps % (modulus or found.size), 1)
    return found


def about(region: Any) -> Any:
    """What a region says of itself and of places around."""
    angles = np.arange(24)
    at = query.directions((15 * angles + 355) % 360, 80 * np.sin(angles))
    held = (region.centre, region.radius_rad, region.inner_radius_rad)
    return *held, region.outside_rad(at), region.holds(at).astype(int)


def test_functions_of_the_sky(here: Path) -> None:
    from catalog_tools import coverage
    from catalog_tools.geometry import healpix, sphere

    parts = [
        coverage.all_sky("s", 15.5, [(10, 20, 5, 18.0), (12, 20, 5, 17)]),
        coverage.of_pixels("p", 2, [7, 3, 100, 5], [9, 6, 120, 8]),
        coverage.Coverage("c", cones=np.array([[10.0, 20, 5, np.inf], [350, -88, 3, 9]])),
        coverage.Coverage("d", cones=np.array([[10.0, 20, 5, np.inf], [40, 50, 6, 7]])),
        coverage.Coverage("none", known=False),
        coverage.Coverage("caps", True, 1, np.array([[0, 9]]), caps=np.array([[1.0, 0, 0, 0.4]])),
    ]
    base = parts[1].to_json()

    def said(change: Any) -> Any:
        return coverage.from_json(change if change is None else base | change)

    v, mas = query.directions(TURN, EDGE), np.linspace(-300.0, 1200.0, 9)
    ids = (healpix.pixels_of(12, TURN, EDGE) << 35) + np.arange(9)
    own = {
        "V": v,
        "W": sphere.directions(np.add(TURN, 0.37), np.multiply(EDGE, 0.99)),
        "MAS": mas,
        "PARTS": parts,
        "IDS": ids,
        "A": cone_of(1, 2, 3),
    }
    tell("sky", SKY, globals() | own | {"said": said})


ASKED = """
C.first_row_groups, C.leaf(1, [0]), catalogue.shard_name(3, 123456)
for x in [1e-4, 5, 40]: query.cone(C, 0, 0, x)
for x in [(359.9, 89, 9), (10, -89.5, 30), (0, 0, 180)]: query.cone(C, *x, 14.5, columns=SOME)
for x in [2.0, 11.0, 99.0, np.nan]: query.cone(C, 10, 10, 30, x, columns=["_healpix_29", "ra"])
for x in [1900.0, 2015.5, 2500.0, 4001.0]: query.cone(C, 10, 10, 12, 18.0, x, ["source_id"])
for x in [[], ["x"], ["dec", "ra", "dec"]]: query.cone(C, 100, -40, 20, columns=x)
for x in SHAPES: query.polygon(C, SHAPES[x], 19.0, columns=SOME)
for x in SHAPES: query.polygon(C, SHAPES[x], epoch_jyear=1000.0, columns=["source_id"])
for x in [None, 9.0, 15.0]: [query.read_leaf(C, l, x, ["phot_g_mean_mag"]) for l in C.leaves[:3]]
[b.num_rows for b in query.record_batches(C, cone_of(0, 0, 90), 18.0)]
for x in [None, 12.0]: [(l.path, l.row_groups[0].row_group) for l in selection.select(C, AREAS, x)]
for x in [None, 15.0]: layers.already_in(C, LAYER, [cone_of(0, 0, 180)], x)
for x in [1991.25, 2040.0]: layers.already_in(C, at(x), AREAS), layers.tolerance_arcsec(at(x), C)
layers.already_in(C, LAYER, [cone_of(1, 89.99, 0.0001)])
layers._around(layers._read(LAYER, LAYER.leaves[:1], None), C, at(1991.25))
np.array([x.radius_rad for x in layers._around(layers._read(C, C.leaves, None), C, at(1991.25))])
coverage.coverage_of(replace(C, coverage=None)).describe()
coverage.coverage_of(replace(C, coverage=None)).limits_g_mag(TURN, EDGE)
coverage.coverage_of(replace(C, coverage=None, rows=5)).describe()
coverage.coverage_of(replace(C, coverage={}))
info.info(replace(C, without_colour=None, coverage=None, leaf_table=C.leaf_table[:0], rows=0))
starlight.read_starlight(C)
for x in [0, 3]: starlight.make_starlight(C, order=x, progress=heard)
for x in [2.0, 9.75, 14.5, 30.0]: starlight.read_starlight(C).fainter(x, V)
starlight.read_starlight(C).source
for x in [-1, 10]: starlight.make_starlight(C, order=x)
heard(0, 0, 0)
reading.read_row_groups(C.store, C.leaves[:2], ["pmra", "dec"])
verify.verify(C)
verify.verify(C, workers=0)
verify.verify(C).bytes == C.leaf_table["bytes"].sum()
for x in STEPS: damaged(*x)
for x in CHANGES: changed(**CHANGES[x])
for x in WRONG: rewritten(x)
for x in ["format", "version", "sha256", "light"]: spoilt_map(x)
far()
"""
# What is done to the files of a catalogue: a name, and what is done to it.
STEPS = [
    [("dataset/x.parquet", b"?"), ("skymap.fits", 100), ("properties", None), ("LEAF", -7)],
    [("LEAF", None), ("partition_info.csv", -9), ("point_map.fits", None)],
    [("LEAF", b"?"), ("dataset/_common_metadata", 30), ("hats.properties", (b"=ra", b"=dec"))],
    [("LEAF", ("flip", 30)), ("partition_info.csv", (b"0,1,", b"0,99,")), ("skymap.fits", None)],
    [("LEAF", ("flip", -20)), ("partition_info.csv", (b"Npix", b"pix"))],
    [("LEAF", ("flip", 1)), ("nightglass/sources.parquet", ("flip", 100))],
    [("nightglass/rejects.parquet", None), ("nightglass/starlight.npz", 300)],
    [("nightglass/leaves.npy", ("flip", 900)), ("partition_info.csv", (b"\n0,2,", b"\n0,2,1"))],
    [("nightglass.json", -3), ("partition_info.csv", (b"\n", b"\n0,3,5\n"))],
    [("nightglass.json", (b'"version": 4', b'"version": 9'))],
    [("nightglass.json", (b"nightglass/cat", b"another/cat"))],
    [("nightglass/starlight.npz", b"?"), ("skymap.fits", (b"NESTED", b"RING  "))],
]
CHANGES: dict[str, dict[str, Any]] = {
    "rows": {"rows": 5, "rejected": {}, "files": {"a": "b"}},
    "colour": {"without_colour": 1, "coverage": {"x": 1}},
    "names": {"name": "x", "description": "y", "digest": "z"},
    "epoch": {"ref_epoch_jyear": 2016.0, "synthetic": True, "sources": 7},
}
WRONG = ["_healpix_29", "ra", "source_id", "centre"]


def test_answers_of_a_catalogue(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shards, "MIN_BAND_ROWS", 40)
    monkeypatch.setattr(shards, "MAX_ROW_GROUP_ROWS", 30)
    rows = stars(700, 9)
    made = ingest([write_csv("a.csv", pa.concat_tables([rows, rows[:2]]))], "c", rows_per_leaf=100)
    same = rows[100:160].to_pydict()
    for i in range(60):  # a layer: the same stars, ever farther off and fainter
        same["dec"][i] += i / 3e4
        same["phot_g_mean_mag"][i] += 0.02 * i
        same["pmra"][i] = None if i % 3 else same["pmra"][i]
    layer = ingest([write_csv("l.csv", pa.table(same, schema=INCOMING))], "l").catalogue
    c, told = made.catalogue, list[Any]()

    def copy() -> Catalogue:
        shutil.rmtree("copy", ignore_errors=True)
        shutil.copytree("c", "copy")
        return open_catalogue("copy")

    def damaged(*steps: Any) -> list[str]:
        found = copy()
        for name, what in steps:
            path = Path("copy", found.leaves[1].path if name == "LEAF" else name)
            data = path.read_bytes() if path.exists() else b""
            if what is None:
                path.unlink()
                continue
            if isinstance(what, tuple) and what[0] == "flip":
                data = data[: what[1]] + bytes([data[what[1]] ^ 4]) + data[what[1] :][1:]
            elif isinstance(what, tuple):
                data = data.replace(*what, 1)
            path.write_bytes(data + what if isinstance(what, bytes) else data)
            if isinstance(what, int):
                path.write_bytes(data[:what])
        report = verify(found, workers=1)
        told = [*map(str, report.findings), show([report.rows, report.notes])]
        try:
            told.append(show(query.cone(found, 0, 0, 180, columns=["ra"])[1].rows))
        except Exception as error:
            told.append(f"{type(error).__name__}: {error}")
        return [re.sub(r"\b\d{4,}\b", "#", line) for line in told]  # bytes: of the libraries

    def changed(**what: Any) -> list[str]:
        return [*map(str, verify(replace(c, **what)).findings)]

    def rewritten(name: str) -> list[str]:
        """One row of one shard is wrong, or what the manifest says of it."""
        found = copy()
        leaf = found.leaves[2]
        table = query.read_leaf(found, leaf, columns=["_healpix_29", *NAMES])
        columns = {n: table[n].to_numpy(zero_copy_only=False).copy() for n in table.column_names}
        if name in columns:
            columns[name][3] = {"ra": 400.0, "source_id": columns[name][4]}.get(name, 70)
        record, groups = shards.write_shard(Path("copy"), leaf.order, leaf.pixel, columns)
        first = found.first_row_groups
        if name == "centre":
            for key in ("centre", "faintest_g_mag", "max_proper_motion_mas_yr", "max_parallax_mas"):
                groups[key][:1] *= 0.5
        leaves = np.concatenate([found.leaf_table[:2], [record], found.leaf_table[3:]])
        tables = [found.row_group_table[: first[2]], groups, found.row_group_table[first[3] :]]
        changed = replace(found, leaf_table=leaves, row_group_table=np.concatenate(tables))
        return [*map(str, verify(changed).findings)]

    def spoilt_map(key: str) -> Any:
        """A map of starlight that says something else."""
        copy()
        path = Path("copy/nightglass/starlight.npz")
        with np.load(path) as held:
            told, light = json.loads(held["about"].tobytes()), held["light"]
        text = np.frombuffer(json.dumps(told | {key: 7}).encode(), np.uint8)
        np.savez(path, about=text, light=light * 2 if key == "light" else light)
        return starlight.read_starlight(open_catalogue("copy"))

    def far() -> Any:
        import fsspec

        for path in Path("c").rglob("*.*"):
            fsspec.filesystem("memory").pipe_file(
                f"/far/{path.relative_to('c')}", path.read_bytes()
            )
        there = open_catalogue("memory://far")
        return (
            query.cone(there, 0, 0, 40, 15.0, columns=["ra"]),
            verify(there).findings,
            there.store.names() == c.store.names(),
        )

    def at(year: float) -> Catalogue:
        return replace(layer, ref_epoch_jyear=year)

    def heard(*call: Any) -> Any:
        told.append(call)
        return told[-3:]

    areas = [cone_of(10, 20, 60), polygon_of(SHAPES["pole"]), Cone((0.0, 0.0, -1.0), 0.1, 1950.0)]
    names = {k: v for k, v in (globals() | locals()).items() if k not in ("verify", "starlight")}
    own = {
        "C": c,
        "LAYER": layer,
        "AREAS": areas,
        "SOME": ["source_id", "dec"],
        "V": query.directions(TURN, EDGE),
    }
    tell("asked", ASKED, names | own, folder=here, digest=c.digest)


MADE = """
for x in [0, 11, 30, 35]: synthetic_stars.draw_stars(rng(x), x, np.arange(40) << 50)
synthetic_stars.bp_rp_mags(np.array([3.0, 15.0]), np.array([-0.3, 2.0]))
synthetic_stars.share_absent(np.array([12.0, 20.8]), 20.772, 0.4)
for x in [0, 12, 25]: synthetic.cell_order(x), synthetic.stars_in_cell(SKY_7, x, 3)
for x in [9, 17]: synthetic.stars_of_crowd(SKY_7, x, CROWD_CELL, 12)
[(p.label, len(p.cells), p.cells[-1:], p.crowds[:1]) for p in synthetic._parts(SKY_7)]
for x in [3.0, 17.0]: synthetic.make_demo("m", faintest_g_mag=x)
for x in [(-1, 0, 1, 9), (0, 91, 1, 9), (0, 0, 31, 9), (0, 0, 1, 22)]: synthetic.make_demo("m",
  deep_fields=[x])
synthetic.make_demo("m", seed=-1)
whole(synthetic.make_demo("m", faintest_g_mag=4.0, deep_fields=[(56.7, 24.1, 0.3, 13)], seed=3,
  workers=1).catalogue)[:4]
for x in [(0, 2, 1), (3 * 10**9, 2, 1), (5, -1, 1), (5, 2, 0)]: synthetic_sample.check_sample(*x)
info.info(synthetic_sample.make_sample("s", 300, workers=1).catalogue)
synthetic_plan.make_plan(2, 300)
synthetic_plan.places_in_file(synthetic_plan.make_plan(2, 60000), 1)
for x in [1, 10**5, 10**7, 10**9]: synthetic_plan._cell_order(x)
synthetic_plan.magnitude_steps(), synthetic_plan.field_density()
synthetic_sample.table_of_file(synthetic_plan.make_plan(2, 300), 0)
for x in [0, 24, 33]: published(x)
for x in [(0, 0, 1), (1, 1, 2), (5, 6, 6)]: synthetic_sample._source_ids(rng(x[0]),
  synthetic_plan.Places(np.array(x), np.array(x), 0))
for x in synthetic_clusters.CROWDS[::3]: x, synthetic_clusters.pixels_of(x),
  synthetic_clusters.interval_shares(x)
csv_files("d", 40)
csv_files("d", 40)[:2]
for x in ["d", "a.csv"]: synthetic_csv.write_csv_files(x, 41)
for x in [7, 1000, 61]: synthetic_csv._random_index(x, np.arange(7))
synthetic_text.as_printed(NUMBERS, 0), synthetic_text.as_printed(NUMBERS, 1)
bytes(synthetic_text.rows_of_text([0, 1, 2, 3, 4], [NUMBERS, NUMBERS, WHOLES, WHOLES % 3, WHOLES],
  "ab c def".split()))
for x in ["56.75,24.1,1.0,16", "1,2", "x,1,2", "400,0,1", "0,91,1", "0,0,0", "0,0,1,nan"]:
  cones.parse_cone(x)
layout.release_named("gaia-dr4")
for x in ["gaia-dr2", "gaia-dr3"]: layout.release_named(x).title,
  layout.release_named(x).number_shift
for x in LISTS: layout.parse_md5sum(x, DR2, "w")
layout.parse_md5sum("a" * 32 + " *GaiaSource_000000-003111.csv.gz",
  layout.release_named("gaia-dr3"), "w")
layout.parse_index('<a href="a%20b.gz">a..</a> 1-Jan 07:32  1.5M\\n<a href="c.gz">c</a> - 700\\n<a
  href="d">d</a> 2K\\n')
for x in ["56.75,24.1,1.0", "0,90,0.001", "10,-30,40", "0,0,180"]:
  layout.cone_ranges(cones.parse_cone(x))
for x in ["0,41.8,0.01", "100,-80,1", "45,0.01,0.01"]: [e.name for e in layout.choose(ENTRIES,
  [cones.parse_cone(x)])]
layout.files_coverage(DR2, ENTRIES)
for x in ["56.75,24.1,1.0,16", "-10,2,3"]: tap.file_name(DR2, cones.parse_cone(x)),
  tap.cone_coverage(DR2, cones.parse_cone(x))
for x in [(None, None), (None, 3.0), (1.5, 2.0), (1.0, 1.0)]: banded(*x)
for x in [10, 100, 3, 0]: asked_by_tap(x)
for x in [dict(cut=2), dict(more=1), dict(lost="ra"), dict(count=10**9)]: asked_by_tap(6, **x)
for x in ["gaia-dr2", "gaia-dr9"]: brought(release=x)
for x in [dict(everything=True), dict(cones=[]), dict(connections=0), dict(cones=["0,0,1"])]:
  brought(**x)
for x in ["ftp://x", "file:///nowhere", "http://["]: brought(base_url=x)
brought(base_url="file://" + str(Path().absolute()))
brought(), brought(verify=True, faintest_g_mag=9.0)
brought(verify=True, release="gaia-dr3")
for x in ["spoilt", "missing", "lost", "part", "stale", "both"]: brought(x)
brought(cones=["0,0,1"], everything=True, tap_url="x")
brought(everything=True, tap_url="x")
brought(tap_url="x")
fetched.note_coverage(Path("got"), ["b", "a"], coverage.of_pixels("p", 2, [3], [9]))
for x in ["ab", "a", "abc", ""]: fetched.stated_coverage([Path("got", name) for name in x])
for x in [200, 206, 404, 416, 429, 503, "cut", "late"]: web(x)
for x in [None, "", "12", "Wed, 21 Oct 2015 07:28:00 GMT", "soon"]: remote.retry_after_s(x)
for x in ["http://u:p@h/x", "http://h/x"]: remote.without_password(x), stores.without_secrets(x +
  "?key=1")
remote.plain(OSError("HTTPConnection(host='h', port=1): <object at 0x1>: broken"))
for x in [1, 3, 9, 99]: 0.5 <= patience.Patience().delay_s(x) / min(0.5 * 2.0 ** (x - 1), 60.0) <=
  1.0
patience.Patience(tries=2).wait("w", patience.Unavailable("busy"), 2, EVENT)
patience.Patience().wait("w", patience.Unavailable("busy", 700.0), 1, EVENT)
memory.Budget(), [getattr(memory.Budget(x << 20), n) for x in (256, 900, 9000) for n in ROOMS]
memory.Budget(256 << 20).check_leaves([partition.Cell(3, 5, 0, 9, 10**8)])
for x in ["x", "tcp://1.2.3.4:5", "tcp://127.0.0.1:5", "tls://h:5", "tcp://h:x"]:
  addresses.check_address(x)
clusters.security_of("tcp://127.0.0.1:5"), addresses.LOCAL_KINDS
for x in ["tcp://9.9.9.9:1", "thread"]: schedulers.open_scheduler(x, 2).__enter__()
for x in ["threads", "synchronous"]: graphs(schedulers.open_scheduler(x, 2))
for x in [1, 2, 3]: tried(x)
cluster_scheduler._renamed((max, ("a", 1), ["b", {}], ("c",)), {("a", 1): "A", "b": "B"})
cluster_scheduler._try(cluster_scheduler.code_digest(), max, 1, 2)
cluster_scheduler._unique(("a", 1), "t"), cluster_scheduler._unique("a", "t")
heap.ALLOCATION, errors.shorten("x" * 99), errors.shorten(10**5000), errors.shorten("y" * 80)
str(errors.BadInput("f", 1, "2")), str(errors.Damaged("p", "r")), str(errors.DiskFull("s", 28,
  "make room"))
for x in [(28, "/a/b"), (28, "/z"), (5, "/a/b")]: full(*x)
errors.NO_ROOM
distinct_of(3, 10**8), distinct_of(5, 0)
for x in [0, 2, 9]: stores.joined([(50, 5), (0, 10), (12, 3), (19, 1), (4, 2)], x)
for x in ["file:///a%20b", "s3://k:s@b/x", "http://h/x?y=1", "nope://x", "http://[", "a/b"]:
  stores.open_store(x)
for x in [TimeoutError(), PermissionError("no"), ConnectionError("c"), KeyError()]:
  stores.reason_of(x), stores._is_transient(x)
for x in ["s3://b/a/", "s3://b", "s3://u@b/a", "s3://b/a?x", "http://b/a", "s3://b/../a",
  "s3://b/a*", "s3://["]: objects.open_objects(x)
[urls.is_url(x) for x in ("s3://b/a", "a/b", "c:/x", "s3:/x")]
for x in [["ra"], ["source_id", "pmra", "phot_g_mean_mag"]]:
  parquet_footer.footer([columns.STORED.field(n) for n in x], 300, [4, *range(200, 9999, 4000)][:
  len(x) + 1]).hex()
columns.ENCODINGS, columns.STEPS, columns.LIMITS, columns.REQUIRED
[t.num_rows for t in build.even([pa.table({"a": [1] * n}) for n in (3, 1, 7, 2)], 4)]
list(ahead.ahead(None, str, range(3), 2))
"""
LISTS = ["", "x", f"{'a' * 32}  GaiaSource_9_3.csv.gz", f"{'a' * 32}  _citation.txt"]
LISTS += ["\n".join(f"{c * 32}  GaiaSource_3_9.csv.gz" for c in "ab"), "# no\n\n" + LISTS[-1]]
FIRST = [0, 1501, 29_108_841, 100_000_000]


def asked_by_tap(most: int, cut: int = 0, more: int = 0, lost: str = "", count: int = 0) -> Any:
    """A cone by TAP of a service that gives `most` rows at once, and does something wrong."""
    from catalog_tools.fetch import cones, layout, ledger, tap, tap_service

    rows, asked = stars(9).append_column("ref_epoch", pa.array([2015.5] * 9)), list[str]()

    def ask(adql: str, rows_wanted: int = 0, **_: Any) -> pa.Table:
        asked.append(adql.partition("WHERE ")[2].partition(" AND ")[2])
        found = rows
        for sign, limit in re.findall(r"dec (>=|<) (\S+)", adql):
            dec = found["dec"].to_numpy()
            found = found.filter(
                pa.array(dec >= float(limit) if sign == ">=" else dec < float(limit))
            )
        if "COUNT" in adql:
            return pa.table({"n": [count or found.num_rows]})
        if found.num_rows > most:
            raise tap_service.Cut(most - (cut if len(asked) > 4 else 0))
        found = found.drop_columns([lost]) if lost else found
        return pa.concat_tables([found, found[:more]])

    release = layout.RELEASES["gaia-dr2"]
    service: Any = type("Service", (), {"address": "http://t", "ask": staticmethod(ask)})()
    cone = cones.FetchCone(10.0, 20.0, 30.0, 18.5)
    with ledger.folder_for(Path("tap"), release) as held:
        tap.fetch_cone(service, release, cone, held, lambda *_: None)
        text = gzip.decompress(Path("tap", tap.file_name(release, cone)).read_bytes()).decode()
    return asked, text.splitlines()[:4], text.count("\n")


def web(kind: Any) -> Any:
    """What a web server's answer is taken for."""
    from catalog_tools.fetch import patience, remote

    sent = list[Any]()

    class Adapter(requests.adapters.HTTPAdapter):
        def send(self, request: Any, **options: Any) -> Any:
            held = {k: v for k, v in request.headers.items() if k in ("Range", "If-Range")}
            sent.append([request.method, request.url, held, options["timeout"]])
            if kind == "late":
                raise requests.ConnectTimeout("too late")
            status = 200 if kind == "cut" else kind
            headers = {"Content-Length": "6", "ETag": '"e"', "Content-Range": "bytes 4-9/10"}
            headers |= {"Content-Range": "bytes */10"} if status == 416 else {"Retry-After": "7"}
            body = io.BytesIO(b"abc" if kind == "cut" else b"abcdef")
            found = urllib3.HTTPResponse(body, headers, status, preload_content=False)
            return self.build_response(request, found)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(requests.Session, "get_adapter", lambda *_, **__: Adapter())
        far = remote.open_remote("http://u:p@h/a b", patience.Patience())
        told: list[Any] = [far.size("n m"), far.address("n")]
        try:
            with far.open("n", 4, '"e"') as reply:
                told += [reply.start, reply.total, reply.tag, b"".join(reply.blocks)]
        except Exception as error:
            told += [type(error).__name__, str(error), getattr(error, "asked_s", None)]
    return told, sent


def test_what_is_made_and_fetched(here: Path) -> None:
    from threading import Event

    from catalog_tools.engine import cluster_scheduler
    from catalog_tools.fetch import cones, fetch, layout, tap
    from catalog_tools.storage import durable
    from catalog_tools.synthetic import columns as synthetic_columns
    from catalog_tools.synthetic import csv as synthetic_csv
    from catalog_tools.synthetic import stars as synthetic_stars
    from catalog_tools.synthetic import synthetic
    from catalog_tools.verify import distinct

    data = {
        f"GaiaSource_{a << 35}_{(b << 35) - 1}.csv.gz": str(a).encode() * 9
        for a, b in zip(FIRST, [*FIRST[1:], 201_326_592], strict=True)
    }
    sums = "".join(f"{hashlib.md5(held).hexdigest()}  {name}\n" for name, held in data.items())
    dr2 = layout.RELEASES["gaia-dr2"]
    entries = layout.parse_md5sum(sums, dr2, "w")
    some = {"cones": ["45,0.01,1", "0,41.8,2,9"]}

    def brought(fault: str = "", **options: Any) -> Any:
        shutil.rmtree("mirror", ignore_errors=True)
        Path("mirror").mkdir()
        for i, (name, held) in enumerate([*data.items(), ("MD5SUM.txt", sums.encode())]):
            if (fault, i) not in (("missing", 0), ("lost", 4), ("both", 2)):
                Path("mirror", name).write_bytes(
                    b"x" if fault in ("spoilt", "both") and i == 0 else held
                )
        if not options.get("verify"):
            shutil.rmtree("got", ignore_errors=True)
        if fault in ("part", "stale"):
            name, stat = next(iter(data)), Path("mirror", next(iter(data))).stat()
            part = Path("got/.fetch/parts", f"{name}.part")
            part.parent.mkdir(parents=True)
            part.write_bytes(data[name][:4])
            tag = "x" if fault == "stale" else f"{stat.st_size}-{stat.st_mtime_ns}"
            origin = {"tag": tag, "total": stat.st_size}
            part.with_name(f"{part.name}.json").write_text(json.dumps(origin))
        mirror = {"release": "gaia-dr2", "base_url": f"file://{Path('mirror').absolute()}"}
        heard = list[Any]()
        plain = {"destination": "got", "progress": lambda *call: heard.append(call)} | mirror
        asked = {} if {"everything", "cones"} & {*options} else some
        report = replace(fetch.fetch(**(plain | asked | options)), files=(), release="")
        told = json.loads(Path("got/.fetch/coverage.json").read_text())["records"][-1]
        names = sorted(p.name for p in Path("got").iterdir())
        return report, heard[0], told["coverage"]["source"], told["coverage"]["ranges"], names

    def graphs(opened: Any) -> Any:
        heard = list[str]()
        with opened as scheduler:
            graph = {("a", i): (pow, 2, i) for i in range(4)} | {"b": (sum, [("a", 1), ("a", 3)])}
            found = scheduler.run(graph, ["b", ("a", 2)], heard.append)
            each = sorted(map(str, scheduler.each(pow, 3, [2, "x"])))
            scheduler.stream([(graph, ["b"])], heard.append)
            return found, each, sorted(heard), scheduler.keep({"k": (max, 1, 2)}), scheduler.workers

    def tried(failures: int) -> int:
        left = iter(range(failures))

        def work() -> int:
            for number in left:
                raise ValueError(f"failure {number}")
            return failures

        return cluster_scheduler._try(cluster_scheduler.code_digest(), work)

    def full(code: int, name: str) -> None:
        with durable.full_disk_told("/a", "make room"):
            raise OSError(code, "no room", name)

    def distinct_of(repeats: int, expected: int) -> Any:
        with distinct.temporary_distinct(expected) as held:
            for i in range(repeats):
                held.add(np.arange(20, dtype=np.int64) * (i + 2))
            return sorted(held.repeated())

    def csv_files(folder: str, rows: int) -> Any:
        report = synthetic_csv.write_csv_files(folder, rows, workers=1)
        names = sorted(p.name for p in Path(folder).iterdir())
        text = gzip.decompress(next(Path(folder).glob("*.gz")).read_bytes()).decode().splitlines()
        return report.files, report.rows, names, text[0][:50], text[1]

    def published(interval: int) -> Any:
        """Every column of 200 stars of one interval of magnitudes."""
        rng, v = np.random.default_rng(4), np.random.default_rng(5).normal(size=(200, 3))
        v /= np.linalg.norm(v, axis=1)[:, None]
        stars = dict(synthetic_stars.draw_stars(rng, interval, np.arange(200) << 50))
        stars |= {"ra": np.arange(200.0), "dec": np.arange(200.0) - 90.0}
        columns = synthetic_columns.all_columns(rng, stars, v, np.arange(200))
        return dict(zip(synthetic_columns.HEADER, columns, strict=True))

    def banded(low: float | None, high: float | None) -> Any:
        cone, band = cones.FetchCone(-10.0, 2, 3, 9), tap.DeclinationBand(low, high)
        return tap.condition(cone, band), band.halves(cone)

    from tests.pins.test_told_catalog import whole

    own = {
        "rng": lambda seed: np.random.Generator(np.random.PCG64(seed)),
        "DR2": dr2,
        "ENTRIES": entries,
        "EVENT": Event(),
        "SKY_7": synthetic.Sky(7, 5.0, (synthetic.DeepField(56.75, 24.12, 0.8, 12.0),)),
        "CROWD_CELL": synthetic.pixels_of(synthetic.CROWDS[12])[1][750] >> 8,
        "NUMBERS": np.array([0.0, -1.5, 1e-9, 123456.789, 9.1e7, 1 / 3, np.nan, 1e-3, 12.0]),
        "WHOLES": np.array([0, 5, 10**18, 4, 12345, 7, 1, 99999, 10000]),
        "ROOMS": ("piece_rows", "file_bytes", "bucket_rows", "leaf_rows"),
        **{f.__name__: f for f in (asked_by_tap, banded, csv_files, published)},
        **{f.__name__: f for f in (brought, distinct_of, full)},
        **{f.__name__: f for f in (graphs, tried, web, whole)},
        "LISTS": LISTS,
    }
    tell("made", MADE, own, folder=here)
