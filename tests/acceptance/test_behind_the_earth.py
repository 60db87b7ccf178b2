"""What the Earth hides is not drawn: every star and target judged by an account of its own."""

from __future__ import annotations

import copy
import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from catalog_tools.ingest import ingest
from pipeline.export.labels import frame_labels
from pipeline.physics.positions.limb import pole_at
from pipeline.physics.positions.times import parse_utc
from pipeline.plan.geometry import plan_geometry
from pipeline.prepare import prepare
from pipeline.run import render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube

A_M, B_M = 6_378_137.0, 6_378_137.0 * (1.0 - 1.0 / 298.257223563)
EPOCH = "2019-04-20T11:00:00Z"
SCENE = {
    "schema": "nightglass/scene/1", "name": "behind", "epoch": EPOCH, "seed": 4,
    "sensor": {
        "shape": [512, 512], "pixel_pitch_um": 10.0, "aperture_m": 0.02,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.0}, "read_noise_e": 5.0, "adc_bits": 24,
    },
    "output": {"layers": ["dn", "stars_e"]},
}  # fmt: skip
SITE = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055}
ORBIT_RADIUS_M = 6.9e6


def lattice(folder, ra_deg: float, dec_deg: float, half_deg: float, mag: float = 6.0) -> str:
    """A catalogue of 35 x 35 stars about a place of the sky."""
    n = np.linspace(-half_deg, half_deg, 35)
    dec = dec_deg + n
    ra, dec = (v.ravel() for v in np.meshgrid(ra_deg + n / np.cos(np.radians(dec_deg)), dec))
    lines = ["source_id,ref_epoch,ra,dec,pmra,pmdec,phot_g_mean_mag"]
    lines += [f"{i + 1},2015.5,{a:.9f},{d:.9f},0,0,{mag}"
              for i, (a, d) in enumerate(zip(ra, dec, strict=True))]  # fmt: skip
    (folder / "stars.csv").write_text("\n".join(lines) + "\n")
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def truth_of(product, kind="stars") -> dict[str, np.ndarray]:
    table = pq.read_table(product / "truth" / f"{kind}.parquet")
    return {n: np.array(table[n].to_pylist()) for n in table.column_names}


def hits(place, u, pole):
    """Whether rays from places (n, 3) along u (n, 3) meet the ellipsoid before them: quadratic."""
    z = np.array(pole)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z])
    shape = np.array([A_M, A_M, B_M])
    o, d = (np.atleast_2d(v) @ axes.T / shape for v in (place, u))
    a, b, c = (d * d).sum(-1), (o * d).sum(-1), (o * o).sum(-1) - 1.0
    root = b * b - a * c
    return (root > 0.0) & (-b + np.sqrt(np.maximum(root, 0.0)) > 0.0) & (c > 0.0) & (b < 0.0)


@pytest.fixture(scope="module")
def horizon(tmp_path_factory):
    """A site whose frame of 14 degrees has its middle 4 degrees above the horizon."""
    from astropy import units as u
    from astropy.coordinates import AltAz, EarthLocation, SkyCoord
    from astropy.time import Time

    folder = tmp_path_factory.mktemp("horizon")
    place = EarthLocation.from_geodetic(-156.3 * u.deg, 20.7 * u.deg, 3055 * u.m)
    frame = AltAz(obstime=Time(EPOCH, scale="utc"), location=place, pressure=0 * u.hPa)
    field = SkyCoord(100.0 * u.deg, 4.0 * u.deg, frame=frame).transform_to("icrs")
    data = copy.deepcopy(SCENE) | {
        "observer": SITE,
        "pointing": {"mode": "sidereal", "boresight_ra_deg": float(field.ra.deg),
                     "boresight_dec_deg": float(field.dec.deg)},
        "exposure": {"integration_s": 60.0},
        "stars": {"catalogue": lattice(folder, field.ra.deg, field.dec.deg, 6.8)},
    }  # fmt: skip
    data["sensor"]["focal_length_m"] = 0.02
    render(parse_scene(data), folder / "product")
    return data, folder / "product", place


def test_stars_below_the_horizon_against_astropy(horizon):
    from astropy import units as u
    from astropy.coordinates import AltAz, SkyCoord
    from astropy.time import Time

    _, product, place = horizon
    truth = truth_of(product)
    stars = SkyCoord(truth["ra_deg"] * u.deg, truth["dec_deg"] * u.deg)
    three = [stars.transform_to(AltAz(obstime=Time(EPOCH, scale="utc") + t * u.s, location=place,
                                      pressure=0 * u.hPa)).alt.deg for t in (0.0, 30.0, 60.0)]
    t = np.linspace(-1.0, 1.0, 2001)[:, None]  # a parabola in a minute: off by 1e-8 degrees
    up = three[1] + 0.5 * t * (three[2] - three[0])
    up = up + 0.5 * t * t * (three[2] - 2.0 * three[1] + three[0])
    seen = np.mean(up > 0.0, axis=0)
    clear = np.abs(up).min(axis=0) > 0.001
    assert (seen == 0.0).sum() > 100
    assert (seen == 1.0).sum() > 500
    np.testing.assert_allclose(truth["visible_fraction"], seen, atol=0.02)
    np.testing.assert_array_equal((truth["electrons"] > 0.0)[clear], (seen > 0.0)[clear])
    partly = (seen > 0.0) & (seen < 1.0)
    assert partly.sum() >= 10
    full = np.median(truth["electrons"][seen == 1.0])
    np.testing.assert_allclose(truth["electrons"][partly], full * seen[partly], atol=0.02 * full)
    words = set(truth["hidden_by"][seen < 0.99])
    assert words == {"horizon"}
    assert set(truth["hidden_by"][seen == 1.0][clear[seen == 1.0]]) == {None}


def test_no_light_where_nothing_is_seen_and_all_where_it_is(horizon):
    data, product, _ = horizon
    truth, image = truth_of(product), np.asarray(open_cube(product)["stars_e"][0])
    x, y = np.round(truth["x_px"]).astype(int), np.round(truth["y_px"]).astype(int)
    inside = (x > 8) & (x < 503) & (y > 8) & (y < 503)
    light = np.array([image[b - 1 : b + 2, a - 1 : a + 2].sum() if i else np.nan
                      for a, b, i in zip(x, y, inside, strict=True)])  # fmt: skip
    dark = inside & (truth["visible_fraction"] == 0.0)
    lit = inside & (truth["visible_fraction"] == 1.0)
    assert light[dark].max() < 0.02 * light[lit].min()
    errors = json.loads((product / "report.json").read_text())["errors"]
    assert errors["windows"] > 0
    assert errors["achieved_error_sigma"] < 0.1


def test_labels_mark_nothing_that_is_hidden(horizon):
    _, product, _ = horizon
    truth = truth_of(product)
    gone = set(truth["source_id"][truth["visible_fraction"] == 0.0].astype(str))
    named = set(frame_labels(product, 0, (512, 512), 0.0).name)
    assert gone
    assert not gone & named


def test_same_bits_for_any_tiles(horizon, tmp_path):
    data, product, _ = horizon
    other = copy.deepcopy(data)
    other["output"] = data["output"] | {"tile_shape": [256, 512]}
    render(parse_scene(other), tmp_path / "tiles")
    for name in ("dn", "stars_e"):
        np.testing.assert_array_equal(
            open_cube(product)[name], open_cube(tmp_path / "tiles")[name]
        )
    for one, two in zip(truth_of(product).values(), truth_of(tmp_path / "tiles").values(), strict=True):
        np.testing.assert_array_equal(one, two)
