"""The archive's lists, and the files of a cone: against brute force and real DR2 rows."""

from __future__ import annotations

import contextlib
import math

import astropy.units as u
import numpy as np
import pyarrow as pa
import pytest
from archive_server import FOLDER, ArchiveServer, md5sum_text, small_archive
from astropy.coordinates import SkyCoord
from hypothesis import given, settings
from hypothesis import strategies as st

from catalog_tools.errors import BadInput, Incomplete
from catalog_tools.fetch import layout
from catalog_tools.fetch.cones import FetchCone, parse_cone
from catalog_tools.fetch.fetch import _notes, fetch
from catalog_tools.fetch.layout import Entry, choose, cone_ranges, parse_index, parse_md5sum
from catalog_tools.readers import read_tables

DR2, DR3 = layout.RELEASES["gaia-dr2"], layout.RELEASES["gaia-dr3"]
# Two names of the real list, and the two that hold no rows.
REAL = """d5b9bacd1fbad8d731176e0d79cf3ae8  _citation.txt
614baf41facb6c07d0ec91e5fe8a9517  GaiaSource_1000172165251650944_1000424567594791808.csv.gz
0623700d067517f2cd20ddf306000bc8 *./GaiaSource_999922404314639104_1000172126596665472.csv.gz
"""
ANYWHERE = st.tuples(st.floats(0, 360), st.floats(-1, 1).map(lambda z: math.degrees(math.asin(z))))


def test_list_of_dr2():
    first, second = parse_md5sum(REAL, DR2, "there")
    assert second == Entry(
        "GaiaSource_1000172165251650944_1000424567594791808.csv.gz",
        "614baf41facb6c07d0ec91e5fe8a9517",
        1000172165251650944,
        1000424567594791808,
    )
    assert (first.last_id >> 35) + 1 == second.first_id >> 35  # files break between pixels


def test_list_of_dr3():
    text = "0123456789abcdef0123456789abcdef  GaiaSource_000000-003111.csv.gz\n"
    (entry,) = parse_md5sum(text, DR3, "there")
    assert (entry.first_id, entry.last_id) == (0, (3112 << 43) - 1)
    healpy = pytest.importorskip("healpy")
    ra, dec = healpy.pix2ang(256, 3111, nest=True, lonlat=True)
    assert choose([entry], [FetchCone(ra, dec, 0.01)]) == [entry]
    assert choose([entry], [FetchCone(ra, -dec, 0.01)]) == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (REAL + "<html>login</html>\n", "line 4.*MD5 digest and a file name"),
        (REAL.replace("614baf41", "614baf4"), "line 2"),
        (REAL + REAL.replace("614b", "aaaa"), "one digest for each file"),
        (REAL.replace("_1000424567594791808", "_1"), "ascending source_ids"),
        (REAL.replace("_1000424567594791808", "_9999999999999999999"), "ascending source_ids"),
        ("", "a list of Gaia DR2's GaiaSource files"),
        ("d5b9bacd1fbad8d731176e0d79cf3ae8  _citation.txt", "GaiaSource files"),
    ],
)
def test_malformed_lists_are_refused(text, said):
    with pytest.raises(BadInput, match=said):
        parse_md5sum(text, DR2, "there")


@settings(max_examples=50)
@given(st.text(max_size=300))
def test_any_text_is_a_list_or_refused(text):
    with contextlib.suppress(BadInput):
        assert parse_md5sum(text, DR2, "there")


def test_index_pages():
    with ArchiveServer(small_archive()) as archive:
        page = archive.index_page()
        assert parse_index(page) == {name: len(data) for name, data in archive.files.items()}
    apache = '<img src="/i.gif"> <a href="a%20b.csv.gz">a b.csv.gz</a>  2018-04-16 07:32  5.1M  \n'
    assert parse_index(apache) == {"a b.csv.gz": math.ceil(5.1 * 2**20)}
    assert parse_index(apache.replace("5.1M", "12K")) == {"a b.csv.gz": 12 * 1024}
    assert parse_index("<html><script>render()</script></html>") == {}


def in_ranges(cone: FetchCone, pixels: np.ndarray) -> np.ndarray:
    starts, ends = cone_ranges(cone)
    assert (starts[1:] > ends[:-1]).all()
    assert (starts < ends).all()
    at = np.searchsorted(starts, pixels, side="right") - 1
    return (at >= 0) & (pixels < ends[at])


def test_choice_against_brute_force():
    """Files of random pixel ranges, with gaps: one is chosen if and only if a pixel is near."""
    import healpy

    rng = np.random.default_rng(2)
    everywhere = np.array(healpy.pix2vec(64, np.arange(12 * 64**2), nest=True)).T
    width = math.radians(0.92)  # of an order-6 pixel, widely
    for _ in range(30):
        breaks = np.unique(rng.integers(0, 12 * 64**2, 300)) << 12
        entries = [
            Entry(f"{a}", "", int(a) << 35, (int(b) << 35) - 1)
            for a, b in zip(breaks[:-1:2], breaks[1::2], strict=False)
        ]
        ra, dec = rng.uniform(0, 360), math.degrees(math.asin(rng.uniform(-1, 1)))
        cone = FetchCone(ra, dec, float(np.exp(rng.uniform(np.log(0.01), np.log(179)))))
        apart = np.arccos(np.clip(everywhere @ healpy.ang2vec(ra, dec, lonlat=True), -1, 1))
        chosen = {entry.name for entry in choose(entries, [cone])}
        for entry in entries:
            inside = apart[entry.first_id >> 47 : (entry.last_id >> 47) + 1]
            if inside.min() <= math.radians(cone.radius_deg):
                assert entry.name in chosen
            if inside.min() > math.radians(cone.radius_deg + layout.MOVED_DEG) + 3 * width:
                assert entry.name not in chosen


@settings(max_examples=60)
@given(ANYWHERE, st.floats(1e-4, 60), st.floats(0, 1), st.floats(0, 360), st.floats(0, 360))
def test_a_star_that_moved_is_found(centre, radius_deg, share, towards, drift):
    """A star anywhere in the cone got its identifier up to 180 arcsec away, in any direction."""
    import healpy

    middle = SkyCoord(*centre, unit="deg")
    star = middle.directional_offset_by(towards * u.deg, share * radius_deg * u.deg)
    first = star.directional_offset_by(drift * u.deg, 180.0 * u.arcsec)
    pixel = healpy.ang2pix(4096, first.ra.deg, first.dec.deg, nest=True, lonlat=True)
    assert in_ranges(FetchCone(*centre, radius_deg), np.array([pixel])).all()


def test_small_cones_bring_few_pixels():
    import healpy

    for radius_deg in (0.01, 0.3, 1.4):
        cone = FetchCone(83.0, -5.0, radius_deg)
        starts, ends = cone_ranges(cone)
        pixels = np.concatenate([np.arange(a, b) for a, b in zip(starts, ends, strict=True)])
        ra, dec = healpy.pix2ang(4096, pixels, nest=True, lonlat=True)
        apart = SkyCoord(83.0, -5.0, unit="deg").separation(SkyCoord(ra, dec, unit="deg")).deg
        assert apart.max() < radius_deg + layout.MOVED_DEG + 3 * math.degrees(
            healpy.nside2resol(4096)
        )


def test_files_up_to_the_last_number_cover_the_sky_and_no_more():
    """Those of an archive end beyond the last pixel of the sky."""
    entries = [Entry("a", "", 0, 2**61), Entry("b", "", 2**61 + 1, 2**63 - 1)]
    coverage = layout.files_coverage(layout.release_named("gaia-dr2"), entries)
    assert coverage.ranges.tolist() == [[0, 12 * 4**9]]
    assert coverage.sky_fraction == 1.0


def test_whole_sky_is_every_file():
    entries = parse_md5sum(md5sum_text(small_archive()), DR2, "there")
    assert choose(entries, [FetchCone(0.0, 0.0, 180.0)]) == entries


@pytest.mark.parametrize(
    "name",
    [
        "full_schema_random/gdr2_sm.fits",
        "ophiuchus/sample_oph_cone_r3.5-result.vot",
        "nearby_teff/gaia_dr2_result.csv",
        "m67_field/M67_data.csv",
    ],
)
def test_real_rows_lie_in_chosen_files(shared_data, name):
    """Files as small as they can be, one order-12 pixel each, and the row at the cone's edge.

    All rows that moved out of their pixel are tried, and some that did not.
    """
    import healpy

    rows = pa.concat_tables(read_tables(shared_data / "gaia_dr2" / name))
    ids, ra, dec = (rows[column].to_numpy() for column in ("source_id", "ra", "dec"))
    pixels = ids >> 35
    moved = np.flatnonzero(healpy.ang2pix(4096, ra, dec, nest=True, lonlat=True) != pixels)
    assert 0 < moved.size < 0.02 * ids.size
    rng = np.random.default_rng(4)
    tried = np.concatenate([moved, rng.choice(ids.size, 40)])
    radii_deg = rng.choice([0.001, 0.1, 1.0], tried.size)
    edges = SkyCoord(ra[tried], dec[tried], unit="deg").directional_offset_by(
        rng.uniform(0, 360, tried.size) * u.deg, 0.9999 * radii_deg * u.deg
    )
    places = zip(pixels[tried].tolist(), edges.ra.deg, edges.dec.deg, radii_deg, strict=True)
    for pixel, edge_ra, edge_dec, radius_deg in places:
        entry = Entry("", "", pixel << 35, ((pixel + 1) << 35) - 1)
        assert choose([entry], [FetchCone(edge_ra, edge_dec, radius_deg)]) == [entry]


def test_barnards_star_is_found():
    """The fastest star has the identifier of its place of J2000, 151 arcsec from that of 2015.5.

    Gaia DR2 4472832130942575872 at its DR2 position.
    """
    pixel = np.array([4472832130942575872 >> 35])
    assert in_ranges(FetchCone(269.44850252543836, 4.739420051112412, 0.001), pixel).all()


def test_a_cone_brings_its_files(archive, tmp_path, hasty):
    import healpy

    ra, dec = healpy.pix2ang(4096, 29_110_000, nest=True, lonlat=True)
    cone = f"{ra},{dec},0.05,12"
    report = fetch("gaia-dr2", tmp_path, cones=[cone], base_url=archive.base_url, patience=hasty)
    assert any(name.startswith("GaiaSource_1000172165") for name in report.files)
    assert len(report.files) < 4
    assert {r.name for r in archive.requests if r.method == "GET"} == {"MD5SUM.txt", *report.files}
    assert "the limit had no effect" in report.notes[1]


def test_a_cone_of_which_the_archive_lists_nothing_is_refused(archive, tmp_path, hasty):
    """The files of the test's archive end with pixel 10**8, of 201 million."""
    import healpy

    ra, dec = healpy.pix2ang(4096, 150_000_000, nest=True, lonlat=True)
    cone = f"{ra},{dec},0.05"
    with pytest.raises(BadInput, match=r"a part of the sky of which http.* lists files") as caught:
        fetch("gaia-dr2", tmp_path, cones=[cone], base_url=archive.base_url, patience=hasty)
    assert (caught.value.field, len(caught.value.value)) == ("cone", 1)


def test_a_list_longer_than_any_archives_is_refused(archive, tmp_path, hasty, monkeypatch):
    monkeypatch.setattr("catalog_tools.fetch.fetch.MD5SUM_BYTES", 100)
    with pytest.raises(BadInput, match=r"holds MD5SUM.txt \(more than 100 bytes\)") as caught:
        fetch(
            "gaia-dr2", tmp_path, everything=True, base_url=archive.base_url, patience=hasty
        )  # fmt: skip
    assert caught.value.field == "base_url"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"release": "gaia-dr1"}, "release: 'gaia-dr1'.*gaia-dr2 or gaia-dr3"),
        ({"cones": []}, "at least one cone"),
        ({"everything": True}, "not both"),
        ({"cones": [], "everything": True, "tap_url": "http://x"}, "tap_url.*cones"),
        ({"cones": ["1,2"]}, "cone: '1,2'.*RA,DEC,RADIUS"),
        ({"cones": ["a,b,c"]}, "cone: 'a,b,c'"),
        ({"cones": ["400,0,1"]}, "cone ra_deg: 400.0.*-360 to 360"),
        ({"cones": ["0,91,1"]}, "cone dec_deg: 91.0"),
        ({"cones": ["nan,0,1"]}, "cone ra_deg: nan"),
        ({"cones": ["0,0,0"]}, "cone radius_deg: 0.0"),
        ({"cones": ["0,0,1,inf"]}, "cone faintest_g_mag: inf"),
        ({"connections": 0}, "connections: 0.*1 to 32"),
        ({"base_url": "ftp://there/"}, "base_url: 'ftp://there/'"),
        ({"base_url": "http:///x"}, "base_url"),
        ({"base_url": "file:///no/such/folder"}, "a folder that exists"),
    ],
)
def test_bad_input_is_one_clear_message(tmp_path, hasty, options, said):
    options = {
        "release": "gaia-dr2",
        "cones": ["10,20,1"],
        "base_url": "http://127.0.0.1:9",
    } | options
    with pytest.raises(BadInput, match=said):
        fetch(options.pop("release"), tmp_path / "to", patience=hasty, **options)
    assert not (tmp_path / "to" / "MD5SUM.txt").exists()


def test_bad_mirrors_are_one_clear_message(archive, tmp_path, hasty):
    def bring(base_url: str) -> None:
        fetch("gaia-dr2", tmp_path, everything=True, base_url=base_url, patience=hasty)

    with pytest.raises(BadInput, match=r"holds MD5SUM.txt \(404 Not Found\)"):
        bring(archive.origin + "/elsewhere/")
    with pytest.raises(Incomplete, match="3 tries in a row"):
        bring("http://127.0.0.1:9" + FOLDER)
    archive.md5sum = "<html>Please log in</html>"
    with pytest.raises(BadInput, match=r"MD5SUM\.txt line 1"):
        bring(archive.base_url)
    archive.md5sum = REAL
    archive.does.cut = lambda name, start: 100
    with pytest.raises(Incomplete, match="tries in a row"):
        bring(archive.base_url)  # half a list is no list


def test_folder_that_cannot_be_written(archive, tmp_path, hasty):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="a folder that can be written"):
        fetch(
            "gaia-dr2", tmp_path / "file" / "to", everything=True,
            base_url=archive.base_url, patience=hasty,
        )  # fmt: skip


def test_cones_are_read_as_written():
    assert parse_cone("56.75, 24.1,1,16.5") == FetchCone(56.75, 24.1, 1.0, 16.5)
    assert parse_cone("-10,0,180") == FetchCone(-10.0, 0.0, 180.0)


def test_files_of_every_cone_are_chosen():
    """In the order of the list, of cones in any order; those between them are not."""
    entries = [Entry(f"{k}", "", k << 55, ((k + 1) << 55) - 1) for k in range(192)]
    far = [FetchCone(10.0, 45.0, 0.1), FetchCone(100.0, -45.0, 0.1), FetchCone(250.0, 0.0, 0.1)]
    own = [{entry.name for entry in choose(entries, [cone])} for cone in far]
    assert all(own)
    assert not own[0] & own[1]
    for cones in (far, far[::-1]):
        assert {entry.name for entry in choose(entries, cones)} == set().union(*own)


@pytest.mark.parametrize("limits", [(None, None), (None, 16.0), (16.0, None), (16.0, 17.0)])
def test_a_limit_without_effect_is_noted_of_any_cone(limits):
    cones = [FetchCone(10.0 * k, 5.0, 0.1, g_mag) for k, g_mag in enumerate(limits)]
    noted = any("the limit had no effect" in note for note in _notes(DR2, [], cones))
    assert noted == any(g_mag is not None for g_mag in limits)
