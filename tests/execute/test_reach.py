"""Every tile gets every star that can reach it: fast stars, fast and far observers."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.execute.check import _sweep
from pipeline.execute.light import LONGEST_PIECE_PX, _box, _reaches
from pipeline.physics.motion.streak import Path
from pipeline.plan.tiles import Tile
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube

ROWS = """source_id,ref_epoch,ra,dec,parallax,pmra,pmdec,radial_velocity,phot_g_mean_mag,\
phot_bp_mean_mag,phot_rp_mean_mag
4472832130942575872,2015.5,269.45402305,4.66828815,547.45,-802.8,10362.5,-110.5,9.5,9.5,9.5
"""
C = 299_792_458.0
SENSOR = {
    "pixel_pitch_um": 9.0, "focal_length_m": 1.0, "aperture_m": 0.2,
    "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
    "psf": {"kind": "gaussian", "sigma_px": 1.0},
}  # fmt: skip


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory):
    """Barnard's star alone: a leaf without extent, so that only the padding reaches it."""
    folder = tmp_path_factory.mktemp("barnard")
    (folder / "stars.csv").write_text(ROWS.replace("\\\n", ""))
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def star_at(position, velocity, epoch) -> tuple[float, float]:
    """Where a sidereal camera has to look: the star's place by its space motion and parallax."""
    import erfa

    year = float(epoch[:4]) - 2015.5
    ra, dec = np.radians([269.45402305, 4.66828815])
    mas = np.radians(1 / 3.6e6)
    u = erfa.pmpx(
        ra, dec, -802.8 * mas / np.cos(dec), 10362.5 * mas, 0.54745, -110.5, year, position
    )
    lon, lat = erfa.c2s(u)
    return float(np.degrees(lon) % 360), float(np.degrees(lat))


def in_tiles(scene, folder, *shapes) -> list[np.ndarray]:
    """The light of the stars drawn in tiles of each shape, each in a folder by its columns."""
    drawn = []
    for shape in shapes:
        scene["output"]["tile_shape"] = shape
        path = folder / str(shape[1])
        render(parse_scene(scene), path, Options("synchronous"))
        drawn.append(open_cube(path)["stars_e"].values)
    return drawn


@pytest.mark.parametrize(
    ("epoch", "position", "velocity"),
    [
        ("1950-07-02T00:00:00Z", (1.0, 0, 0), (0, 0, 0)),
        ("2100-07-02T00:00:00Z", (1.0, 0, 0), (0, 0, 0)),
        ("2015-07-02T00:00:00Z", (1.0, 0, 0), (0, 0.5 * C, 0)),
        ("2015-07-02T00:00:00Z", (1.0, 0, 0), (0, 0, -3e6)),
        ("2015-07-02T00:00:00Z", (0, 3e4, 0), (0, 0, 0)),
    ],
)
def test_same_star_in_every_tile_shape(epoch, position, velocity, catalogue, tmp_path):
    ra, dec = star_at(position, velocity, epoch)
    scene = {
        "schema": "nightglass/scene/1", "name": "reach", "epoch": epoch, "accept": ["sun"],
        "observer": {"kind": "fixed", "position_au": position, "velocity_m_s": velocity},
        "sensor": SENSOR | {"shape": [512, 512]},
        "pointing": {"mode": "sidereal", "boresight_ra_deg": ra, "boresight_dec_deg": dec + 0.02},
        "exposure": {"integration_s": 1.0}, "stars": {"catalogue": catalogue},
        "output": {"layers": ["stars_e"]},
    }  # fmt: skip
    drawn = in_tiles(scene, tmp_path, [512, 512], [256, 256])
    truth = pq.read_table(tmp_path / "256" / "truth" / "stars.parquet")
    assert truth["in_frame"].to_pylist() == [True]
    assert np.array_equal(*drawn)
    assert drawn[0].sum(dtype=float) == pytest.approx(truth["electrons"][0].as_py(), rel=1e-6)


def test_limits_blinding_star_fails_no_tile(catalogue, tmp_path):
    """10^12 electrons and no noise floor: the wings' rounding far off is clipped, not refused."""
    scene = {
        "schema": "nightglass/scene/1", "name": "blinding", "epoch": "2015-07-02T00:00:00Z",
        "accept": ["error", "sun"],
        "observer": {"kind": "fixed", "position_au": [1, 0, 0]},
        "sensor": {
            "shape": [512, 512], "pixel_pitch_um": 13.5, "focal_length_m": 1.0, "aperture_m": 4.0,
            "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
            "psf": {"kind": "airy", "wavelength_nm": 26000.0},
        },
        "pointing": {
            "mode": "sidereal", "boresight_ra_deg": 269.454, "boresight_dec_deg": 4.66828,
        },
        "exposure": {"integration_s": 1e5}, "stars": {"catalogue": catalogue},
        "output": {"layers": ["mean_e"], "tile_shape": [256, 256]},
    }  # fmt: skip
    render(parse_scene(scene), tmp_path / "run", Options("synchronous"))
    mean = open_cube(tmp_path / "run")["mean_e"].values
    assert mean.sum(dtype=float) > 1e12
    assert mean.min() >= 0


def test_tiles_far_from_the_middle_of_a_long_streak_have_its_star(catalogue, tmp_path):
    """A streak of 900 px through four tiles: the outer ones are far from where it is halfway."""
    scene = {
        "schema": "nightglass/scene/1", "name": "streak", "epoch": "2015-07-02T00:00:00Z",
        "observer": {"kind": "fixed", "position_au": [1.0, 0, 0]}, "accept": ["sun"],
        "sensor": SENSOR | {"shape": [512, 1024]},
        "pointing": {
            "mode": "rate", "boresight_ra_deg": 269.454, "boresight_dec_deg": 4.66828,
            "rate_ra_arcsec_s": 170.0, "rate_dec_arcsec_s": 0.0,
        },
        "exposure": {"integration_s": 10.0}, "stars": {"catalogue": catalogue},
        "output": {"layers": ["stars_e"]},
    }  # fmt: skip
    assert np.array_equal(*in_tiles(scene, tmp_path, [512, 1024], [512, 256]))


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("far_px", [90.0, -90.0])
def test_a_tile_that_only_the_far_end_of_a_streak_lights(upright, far_px):
    """A star 70 px from a tile of 64 pixels whose straight streak ends in it; and one across."""
    still, along = np.zeros(2), np.array([0.0, far_px])
    x_px, y_px = (still, along) if upright else (along, still)
    streak = Path(x_px, y_px, np.ones(1))
    tile = Tile(0, 0, 0, 0, 64, 64)
    there, beside = (-70.0 if far_px > 0.0 else 134.0), 30.0
    x, y = (beside, there) if upright else (there, beside)
    assert _reaches(tile, 5.0, streak, x, y)
    assert not _reaches(tile, 5.0, streak, y, x)


@pytest.mark.parametrize(
    ("x", "y", "wanted"), [([-50.0, 0.0], [1.0, 0.0], 50.0), ([0.0, 3.0], [0.0, -70.0], 70.0)]
)
def test_a_path_sweeps_as_far_as_it_goes_whichever_way(x, y, wanted):
    assert _sweep(Path(np.array(x), np.array(y), np.array([1.0]))) == wanted


def test_the_box_of_a_tile_has_its_columns_across_and_its_rows_up():
    """From the place of a star, on each side by the core and the longest piece."""
    tile, margin = Tile(0, 0, 100, 7, 30, 200), 5.0 + LONGEST_PIECE_PX
    low_x, high_x, low_y, high_y = _box(tile, 5.0, 10.0, 20.0)
    assert (low_x, high_x) == (7 - 10.0 - margin, 7 + 200 - 10.0 + margin)
    assert (low_y, high_y) == (100 - 20.0 - margin, 100 + 30 - 20.0 + margin)
