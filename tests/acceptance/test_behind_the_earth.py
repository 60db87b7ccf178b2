"""What the Earth hides is not drawn: every star and target judged by an account of its own."""

from __future__ import annotations

import copy
import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from catalog_tools.ingest.ingest import ingest
from pipeline.export.labels import frame_labels
from pipeline.physics.positions.limb import pole_at
from pipeline.physics.positions.times import parse_utc
from pipeline.route.run import render
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
        "pointing": {"mode": "rate", "boresight_ra_deg": float(field.ra.deg),
                     "boresight_dec_deg": float(field.dec.deg), "rate_ra_arcsec_s": 8.0,
                     "rate_dec_arcsec_s": 4.0},
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
    _, product, _ = horizon
    truth, image = truth_of(product), np.asarray(open_cube(product)["stars_e"][0])
    x, y = np.round(truth["x_px"]).astype(int), np.round(truth["y_px"]).astype(int)
    inside = (x > 8) & (x < 503) & (y > 8) & (y < 503)
    light = np.array([image[b - 1 : b + 2, a - 1 : a + 2].sum() if i else np.nan
                      for a, b, i in zip(x, y, inside, strict=True)])  # fmt: skip
    dark = inside & (truth["visible_fraction"] == 0.0)
    lit = inside & (truth["visible_fraction"] == 1.0)
    assert light[dark].max() < 0.02 * light[lit].min()
    for name in ("x_light_px", "y_light_px"):  # where the light stands, if there is any
        np.testing.assert_array_equal(np.isnan(truth[name]), truth["visible_fraction"] == 0.0)
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
    one, two = truth_of(product), truth_of(tmp_path / "tiles")
    for name in one:
        np.testing.assert_array_equal(one[name], two[name])


def circular(radius_m: float, at_rad: float) -> dict:
    """An orbit in the equator, counter-clockwise, at an angle from the x axis at the epoch."""
    speed = np.sqrt(3.986004418e14 / radius_m)
    c, s = np.cos(at_rad), np.sin(at_rad)
    return {"kind": "state", "position_m": [radius_m * c, radius_m * s, 0.0],
            "velocity_m_s": [-speed * s, speed * c, 0.0]}  # fmt: skip


def place(radius_m: float, at_rad: float, seconds) -> np.ndarray:
    """Where such an orbit is (n, 3)."""
    angle = at_rad + np.sqrt(3.986004418e14 / radius_m**3) * np.asarray(seconds)
    return radius_m * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)


def towards(u: np.ndarray) -> dict:
    return {"mode": "sidereal", "boresight_ra_deg": float(np.degrees(np.arctan2(u[1], u[0])) % 360),
            "boresight_dec_deg": float(np.degrees(np.arcsin(u[2])))}  # fmt: skip


@pytest.fixture(scope="module")
def limb(tmp_path_factory):
    """A satellite that looks a degree beside the limb ahead of it, which comes nearer."""
    folder = tmp_path_factory.mktemp("limb")
    angle = np.pi - np.arcsin(A_M / ORBIT_RADIUS_M) - np.radians(1.0)  # from the zenith
    u = np.array([np.cos(angle), np.sin(angle), 0.0])
    pointing = towards(u)
    data = copy.deepcopy(SCENE) | {
        "observer": {"kind": "orbit", "orbit": circular(ORBIT_RADIUS_M, 0.0)},
        "pointing": pointing, "exposure": {"integration_s": 4.0},
        "stars": {"catalogue": lattice(folder, pointing["boresight_ra_deg"], 0.0, 6.8)},
    }  # fmt: skip
    data["sensor"]["focal_length_m"] = 0.02
    render(parse_scene(data), folder / "product")
    return data, folder / "product"


def test_stars_behind_the_limb_against_rays(limb):
    """Each star's ray, as the moving Earth sees it, against the ellipsoid at 401 moments."""
    import erfa

    _, product = limb
    truth, day = truth_of(product), np.array(parse_utc(EPOCH))
    ra, dec = np.radians(truth["ra_deg"]), np.radians(truth["dec_deg"])
    u = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)
    earth = erfa.epv00(*day)[1]["v"] * 149_597_870_700.0 / 86400.0 / 299_792_458.0
    u = u + earth
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    pole = pole_at(tuple(day))
    behind = [hits(p, u, pole) for p in place(ORBIT_RADIUS_M, 0.0, np.linspace(0.0, 4.0, 401))]
    seen = 1.0 - np.mean(behind, axis=0)
    assert (seen == 0.0).sum() > 300
    assert (seen == 1.0).sum() > 300
    partly = (seen > 0.0) & (seen < 1.0)
    assert partly.sum() >= 10
    np.testing.assert_allclose(truth["visible_fraction"], seen, atol=0.005)
    np.testing.assert_array_equal(truth["electrons"] > 0.0, truth["visible_fraction"] > 0.0)
    assert set(truth["hidden_by"][seen < 0.99]) == {"earth"}
    errors = json.loads((product / "report.json").read_text())["errors"]
    assert errors["achieved_error_sigma"] < 0.1


def test_a_star_that_sets_is_drawn_where_it_is_seen(horizon):
    """Its light stands around the middle of the part of its path that is left."""
    _, product, _ = horizon
    truth, image = truth_of(product), np.asarray(open_cube(product)["stars_e"][0], float)
    part = truth["visible_fraction"]
    inside = (np.abs(truth["x_px"] - 255.5) < 240) & (np.abs(truth["y_px"] - 255.5) < 240)
    found = np.flatnonzero((part > 0.2) & (part < 0.8) & inside)
    assert len(found)
    for i in found:
        x0, y0 = round(truth["x_light_px"][i]), round(truth["y_light_px"][i])
        cut = image[y0 - 6 : y0 + 7, x0 - 6 : x0 + 7]
        rows, columns = np.mgrid[y0 - 6 : y0 + 7, x0 - 6 : x0 + 7]
        assert cut.sum() == pytest.approx(truth["electrons"][i], rel=2e-3)
        assert (cut * columns).sum() / cut.sum() == pytest.approx(truth["x_light_px"][i], abs=0.02)
        assert (cut * rows).sum() / cut.sum() == pytest.approx(truth["y_light_px"][i], abs=0.02)
        ends = np.hypot(truth["x_end_px"][i] - truth["x_start_px"][i],
                        truth["y_end_px"][i] - truth["y_start_px"][i])  # fmt: skip
        whole = part == 1.0
        full = np.hypot((truth["x_end_px"] - truth["x_start_px"])[whole],
                        (truth["y_end_px"] - truth["y_start_px"])[whole])  # fmt: skip
        assert ends == pytest.approx(part[i] * np.median(full), rel=0.1)


GEO_M, LOW_M = 4.2164e7, 7.2e6


def target_scene(folder, at_rad: float, **more) -> dict:
    """A high satellite that looks beside the limb, where a low one is, and its truth and plan."""
    data = copy.deepcopy(SCENE) | {
        "observer": {"kind": "orbit", "orbit": circular(GEO_M, 0.0)},
        "exposure": {"integration_s": 2.0},
        "targets": [{"name": "low", "orbit": circular(LOW_M, at_rad),
                     "body": {"kind": "sphere", "diameter_m": 2.0, "albedo": 0.3}}],
    }  # fmt: skip
    away = place(LOW_M, at_rad, 0.0) - place(GEO_M, 0.0, 0.0)
    away = away / np.linalg.norm(away)
    turn = np.radians(-0.3) if away[1] > 0 else np.radians(0.3)
    c, s = np.cos(turn), np.sin(turn)
    data["pointing"] = towards(np.array([c * away[0] - s * away[1], s * away[0] + c * away[1], 0]))
    data["sensor"]["focal_length_m"] = 0.25
    render(parse_scene(data | more), folder)
    return truth_of(folder, "targets")


def line_height_m(at_rad: float, seconds) -> np.ndarray:
    """How far above the equator's circle the line from the high to the low satellite passes."""
    here = place(GEO_M, 0.0, seconds)
    delay = np.linalg.norm(place(LOW_M, at_rad, seconds) - here, axis=-1) / 299_792_458.0
    there = place(LOW_M, at_rad, np.asarray(seconds) - delay)
    way = (there - here) / np.linalg.norm(there - here, axis=-1, keepdims=True)
    return np.linalg.norm(np.cross(here, way), axis=-1) - A_M


@pytest.mark.parametrize("share", [0.3, 0.75])
def test_a_target_goes_behind_the_limb_in_an_exposure(share, tmp_path):
    from scipy.optimize import brentq

    at = brentq(lambda a: float(line_height_m(a, 2.0 * share)), np.pi / 2, np.pi / 2 + 0.6)
    truth = target_scene(tmp_path / "sets", at)
    before = target_scene(tmp_path / "before", at - 0.02)
    after = target_scene(tmp_path / "after", at + 0.02)
    assert truth["visible_fraction"][0] == pytest.approx(share, abs=1e-4)
    assert truth["hidden_by"][0] == "earth"
    assert before["hidden_by"][0] is None
    assert before["visible_fraction"][0] == 1.0
    assert truth["electrons"][0] == pytest.approx(share * before["electrons"][0], rel=0.03)
    assert after["electrons"][0] == 0.0
    assert after["visible_fraction"][0] == 0.0
    assert len(frame_labels(tmp_path / "after", 0, (512, 512))) == 0
    middle = truth["x_start_px"][0] + 0.5 * (truth["x_end_px"][0] - truth["x_start_px"][0])
    assert truth["x_light_px"][0] == pytest.approx(middle, abs=0.02)
    image = np.asarray(open_cube(tmp_path / "sets")["dn"][0], float)
    assert image.max() > 0


def test_a_target_before_the_earth_is_not_hidden(tmp_path):
    """As near to the observer's side of the Earth as it stood behind it: drawn."""
    from scipy.optimize import brentq

    at = brentq(lambda a: float(line_height_m(a, 1.0)), 0.3, np.pi / 2)
    truth = target_scene(tmp_path / "front", at - 0.01)
    assert truth["hidden_by"][0] is None
    assert truth["electrons"][0] > 0.0
