"""Stars as they come out of a catalogue: SI units and radians of what the archive's units say."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.inputs.stars.stars import brightest_g_mags, gather_leaf
from pipeline.physics.colour import ColourFit
from pipeline.resolve import stars as resolving

FIT = ColourFit("flat", np.zeros(1), (-1.0, 4.0), 0.0, 0.0, 0.0, 0.8, 0.4, 0.0, 1e10, "by hand", 1)


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory):
    """Barnard's star (Gaia DR2) and one without motion, of G = 10 and 15."""
    folder = tmp_path_factory.mktemp("two")
    head = "source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,"
    rows = [
        "1,2015.5,269.45,4.74,547.48,-802.8,10362.5,-110.25,10,10.5,9.2",
        "2,2015.5,269.46,4.75,,,,,15,,",
    ]
    (folder / "a.csv").write_text("\n".join([head + "phot_bp_mean_mag,phot_rp_mean_mag", *rows]))
    return ingest([folder / "a.csv"], folder / "c", workers=1).catalogue


def test_units_of_every_column(catalogue):
    """Degrees, mas, mas/yr and km/s by hand; absent values are NaN."""
    (leaf,) = catalogue.leaves
    t = gather_leaf(catalogue, leaf, None, FIT, 2.0)
    order = np.argsort(t.source_id)
    mas = np.pi / 180.0 / 3.6e6
    expected = {
        "ra_rad": [4.702790003, 4.702964536], "dec_rad": [0.082728607, 0.082903140],
        "pm_ra_cosdec_rad_yr": [-802.8 * mas, np.nan], "pm_dec_rad_yr": [10362.5 * mas, np.nan],
        "parallax_rad": [547.48 * mas, np.nan], "radial_velocity_m_s": [-110_250.0, np.nan],
        "g_mag": [10.0, 15.0], "rate_e_s": [2e6, 2e4],
    }  # fmt: skip
    for name, values in expected.items():
        found = getattr(t, name)[order]
        assert found == pytest.approx(values, rel=2e-5, nan_ok=True), name


def test_what_a_scene_leaves_out(catalogue):
    """Faint stars, stars of an earlier catalogue, and motion where the scene wants none."""
    (leaf,) = catalogue.leaves
    assert gather_leaf(catalogue, leaf, 12.0, FIT, 1.0).source_id.tolist() == [1]
    layer = gather_leaf(catalogue, leaf, None, FIT, 1.0, left_out=np.array([1]))
    assert layer.source_id.tolist() == [2]
    still = gather_leaf(catalogue, leaf, 12.0, FIT, 1.0, unmoving=True)
    motions = still.pm_ra_cosdec_rad_yr, still.pm_dec_rad_yr, still.radial_velocity_m_s
    assert np.isnan(motions).all()
    assert still.parallax_rad[0] > 0.0


def test_the_brightest_of_each_leaf_where_pixels_of_two_orders_share_a_number(tmp_path):
    """By the stars' own magnitudes; those of order 1 are the parts of a crowded base pixel."""
    rng = np.random.default_rng(3)
    ra, dec = rng.uniform(0.0, 360.0, 90), np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, 90)))
    ra[:60], dec[:60] = rng.uniform(20.0, 70.0, 60), rng.uniform(10.0, 60.0, 60)
    head = "source_id,ref_epoch,ra,dec,phot_g_mean_mag"
    rows = [f"{k},2015.5,{ra[k]},{dec[k]},{5 + k / 10}" for k in range(90)]
    (tmp_path / "a.csv").write_text("\n".join([head, *rows]))
    made = ingest([tmp_path / "a.csv"], tmp_path / "c", rows_per_leaf=30, workers=1).catalogue
    numbers = made.leaf_table["pixel"].tolist()
    assert len(set(numbers)) < len(numbers)
    for leaf in made.leaves:
        g_mag = gather_leaf(made, leaf, None, FIT, 1.0).g_mag
        assert brightest_g_mags(made, leaf, None).min() == pytest.approx(g_mag.min(), abs=1e-5)
        assert brightest_g_mags(made, leaf, g_mag.min() - 0.05).size == 0


def test_the_most_that_stars_move_is_that_of_all_their_leaves(monkeypatch):
    """By themselves, and by parallax."""
    leaves = [SimpleNamespace(max_proper_motion_mas_yr=m, max_parallax_mas=p)
              for m, p in ((9.0, 2.0), (4.0, 7.0))]  # fmt: skip
    monkeypatch.setattr(resolving, "_placed", lambda *_: ([], 2.0))
    monkeypatch.setattr(
        resolving, "shards_of", lambda *_: [SimpleNamespace(leaf=leaf) for leaf in leaves]
    )
    scene = SimpleNamespace(scene=SimpleNamespace(stars=True))
    found = resolving.gather_field_stars(scene, (), (), None, None)
    assert found.own_motion == (9.0, 7.0)
    assert found.sources is None
