"""Our catalogues as `hats` and LSDB see them: valid, and the same stars in the same cones."""

from __future__ import annotations

import importlib.util
import warnings
from pathlib import Path

import numpy as np
import pytest
from lsst_refcat import convert
from star_rows import random_stars, write_csv

from catalog_tools.catalogue import LEAVES_DTYPE
from catalog_tools.ingest.hats import write_hats_files
from catalog_tools.ingest.ingest import ingest
from catalog_tools.query.query import cone
from catalog_tools.synthetic.synthetic import make_demo
from catalog_tools.verify.verify import verify

pytestmark = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("hats", "lsdb")),
    reason="hats or LSDB is not installed",
)


@pytest.fixture(scope="module")
def real(shared_data, tmp_path_factory):
    """Real DR2 sources of complete HTM trixels and of random places, in leaves of many sizes."""
    folder = tmp_path_factory.mktemp("real")
    convert(shared_data / "gaia_dr2/lsst_refcat_htm7", folder / "refcat.csv.gz")
    sources = [folder / "refcat.csv.gz", shared_data / "gaia_dr2/full_schema_random/gdr2_sm.fits"]
    return ingest(sources, folder / "made", rows_per_leaf=1000).catalogue


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory):
    return make_demo(tmp_path_factory.mktemp("demo") / "made", faintest_g_mag=7.5).catalogue


@pytest.fixture(params=["real", "synthetic", "random"])
def made(request):
    return request.getfixturevalue({"random": "catalogue"}.get(request.param, request.param))


def ids_of_lsdb(found):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return sorted(found.compute(progress_bar=False)["source_id"].tolist())


def test_hats_finds_it_valid(made, caplog):
    from hats.io.validation import is_valid_catalog

    assert is_valid_catalog(made.path, strict=True)
    assert [r.message for r in caplog.records if r.levelname == "WARNING"] in (
        [], ["_metadata file does not exist."]
    )  # fmt: skip


def test_hats_reads_what_the_manifest_says(made):
    import hats

    held = hats.read_hats(made.path)
    assert held.catalog_info.total_rows == made.rows
    assert held.catalog_info.catalog_name == made.name
    leaves = {(leaf.order, leaf.pixel) for leaf in made.leaves}
    assert {(p.order, p.pixel) for p in held.get_healpix_pixels()} == leaves
    counts = hats.io.file_io.read_fits_image(Path(made.path) / "point_map.fits")
    assert np.sum(counts) == made.rows
    assert verify(made).whole


def test_same_stars_as_lsdb_in_cones(made):
    import lsdb

    some, _ = cone(made, 0, 0, 180)
    rng = np.random.default_rng(0)
    places = [some.slice(int(i), 1).to_pylist()[0] for i in rng.integers(0, some.num_rows, 1)]
    cones = [(row["ra"], row["dec"], radius) for row in places for radius in (0.3, 8.0)]
    for ra, dec, radius in [*cones, (0.5, -1.0, 1.0), (10.0, 88.0, 15.0)]:
        theirs = lsdb.open_catalog(made.path).cone_search(ra, dec, radius * 3600.0)
        ours, _ = cone(made, ra, dec, radius)
        assert ids_of_lsdb(theirs) == sorted(ours["source_id"].to_pylist())


def test_same_stars_as_lsdb_with_a_magnitude_limit(made):
    import lsdb

    limit = 14.0
    region = lsdb.ConeSearch(0.7, -1.0, 20 * 3600.0)
    theirs = lsdb.open_catalog(
        made.path, search_filter=region, filters=[("phot_g_mean_mag", "<=", limit)]
    )
    ours, _ = cone(made, 0.7, -1.0, 20.0, limit)
    assert ours.num_rows > 3
    assert ids_of_lsdb(theirs) == sorted(ours["source_id"].to_pylist())


def test_same_columns_in_lsdb(made):
    """Every column by name, with degrees, magnitudes and nulls as they are stored."""
    import lsdb

    ours, _ = cone(made, 0.7, -1.0, 20.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = lsdb.open_catalog(made.path, columns="all").cone_search(0.7, -1.0, 72_000.0)
        theirs = found.compute(progress_bar=False).sort_values("source_id")
    ours = ours.sort_by("source_id")
    for name in ours.column_names:
        left = ours[name].to_numpy(zero_copy_only=False).astype(float)
        right = theirs[name].to_numpy(dtype=float, na_value=np.nan)
        assert np.array_equal(left, right, equal_nan=True), name


@pytest.mark.parametrize(("deepest", "order"), [(0, 3), (2, 5), (7, 8)])
def test_maps_are_eight_times_as_fine_as_the_leaves(tmp_path, deepest, order):
    """On a side, up to the finest that a map has."""
    leaves = np.zeros(1, LEAVES_DTYPE)
    leaves["order"] = deepest
    counts = np.zeros(12 * 4**8, np.int64)
    assert write_hats_files(tmp_path, leaves, counts)["hats_skymap_order"] == order


def test_a_name_is_one_line(tmp_path):
    """Whatever ends a line: it would be a property of its own, or none of its file's."""
    write_csv(tmp_path / "a.csv", random_stars(20, 3))
    name = " a\nhats_nrows=5\u2028 b "
    made = ingest([tmp_path / "a.csv"], tmp_path / "c", name=name).catalogue
    assert made.name == "a hats_nrows=5 b"
    assert verify(made).whole
