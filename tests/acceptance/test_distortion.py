"""A distorted sensor, seen from outside: truth, pixels and the exported WCS tell one story."""

from __future__ import annotations

import copy

import erfa
import numpy as np
import pyarrow.parquet as pq
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from catalog_tools.ingest.ingest import ingest
from pipeline.errors import BadInput
from pipeline.export.files import export_frames
from pipeline.route.prepare import plan_scene
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene
from pipeline.store.cube import open_cube

STEP_DEG = 0.05
SCENE = {
    "schema": "nightglass/scene/1", "name": "distorted", "epoch": "2015-07-02T12:00:00Z", "seed": 4,
    "observer": {"kind": "fixed", "position_au": [0.9, 0.4, 0.1], "velocity_m_s": [0, 2.9e4, 0]},
    "sensor": {
        "shape": [512, 640], "pixel_pitch_um": 10.0, "focal_length_m": 0.4, "aperture_m": 0.1,
        "bandpass": {"kind": "box", "short_nm": 400, "long_nm": 900},
        "psf": {"kind": "gaussian", "sigma_px": 1.3}, "read_noise_e": 5.0, "adc_bits": 24,
    },
    "pointing": {
        "mode": "sidereal", "boresight_ra_deg": 101.0, "boresight_dec_deg": 30.0, "roll_deg": 25.0,
    },
    "exposure": {"integration_s": 10.0},
    "output": {"layers": ["dn", "stars_e"]},
}  # fmt: skip
KINDS = {
    "sip": {"kind": "sip", "a": {"2_0": 3e-5, "1_2": -6e-8, "5_0": 1e-14},
            "b": {"1_1": 2e-5, "0_3": -5e-8}},
    "tpv": {"kind": "tpv", "pv1": {1: 1.002, 5: -8e-3, 7: 0.02, 9: 0.02},
            "pv2": {2: 1e-3, 7: 0.02, 9: 0.02}},
    "radial": {"kind": "radial", "k1": 12.0, "k2": -5e3, "p1": 0.02, "p2": -0.01},
}  # fmt: skip


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory) -> str:
    """Stars on a lattice, so that none disturbs another's centroid."""
    folder = tmp_path_factory.mktemp("lattice")
    n = np.arange(-16, 17) * STEP_DEG
    ra, dec = (g.ravel() for g in np.meshgrid(101.0 + n / np.cos(np.radians(30.0)), 30.0 + n))
    lines = ["source_id,ref_epoch,ra,dec,pmra,pmdec,phot_g_mean_mag"]
    lines += [
        f"{i + 1},2015.5,{a:.9f},{d:.9f},0,0,9.0"
        for i, (a, d) in enumerate(zip(ra, dec, strict=True))
    ]
    (folder / "stars.csv").write_text("\n".join(lines) + "\n")
    return str(ingest([folder / "stars.csv"], folder / "catalogue").catalogue.path)


def scene_of(catalogue: str, distortion: dict | None, **output):
    data = copy.deepcopy(SCENE)
    data["stars"] = {"catalogue": catalogue}
    data["sensor"]["distortion"] = distortion
    data["output"] |= output
    return parse_scene(data)


def truth_of(product) -> dict[str, np.ndarray]:
    table = pq.read_table(product / "truth" / "stars.parquet")
    return {name: np.asarray(table[name]) for name in table.column_names}


def centroid(image: np.ndarray, x: float, y: float) -> tuple[float, float]:
    x0, y0 = round(x), round(y)
    part = image[y0 - 10 : y0 + 11, x0 - 10 : x0 + 11].astype(float)
    rows, columns = np.mgrid[y0 - 10 : y0 + 11, x0 - 10 : x0 + 11]
    return (part * columns).sum() / part.sum(), (part * rows).sum() / part.sum()


def aberrated_deg(ra_deg: np.ndarray, dec_deg: np.ndarray) -> np.ndarray:
    """Directions as the scene's observer sees them, by ERFA with the observer's velocity."""
    beta = np.array([0.0, 2.9e4, 0.0]) / 299_792_458.0
    u = erfa.s2c(np.radians(ra_deg), np.radians(dec_deg))
    return np.degrees(erfa.c2s(erfa.ab(u, beta, 1.0, np.sqrt(1.0 - beta @ beta))))


@pytest.mark.parametrize("kind", KINDS)
def test_truth_pixels_and_wcs_agree(kind, catalogue, tmp_path):
    report = render(scene_of(catalogue, KINDS[kind]), tmp_path / "run", Options("synchronous"))
    truth = truth_of(tmp_path / "run")
    (path,) = export_frames(tmp_path / "run", "fits", tmp_path / "frame.fits", frame=0)
    header = fits.getheader(path)
    wcs = WCS(header)
    assert header["CTYPE1"] == "RA---TAN-SIP"
    assert report["errors"]["wcs_residual_px"] < 1e-5
    assert header["CTYPE1A"] == "RA---TPV"
    inside = truth["in_frame"]
    assert inside.sum() > 250
    x, y = truth["x_px"][inside], truth["y_px"][inside]
    seen = wcs.all_world2pix(truth["ra_deg"][inside], truth["dec_deg"][inside], 0, tolerance=1e-8)
    assert np.hypot(seen[0] - x, seen[1] - y).max() < 1e-4
    sky = aberrated_deg(truth["ra_deg"][inside], truth["dec_deg"][inside])
    apparent = WCS(header, key="A").all_world2pix(*sky, 0)
    assert np.hypot(apparent[0] - x, apparent[1] - y).max() < 5e-3  # the Sun's bending: 0.01 arcsec
    straight = wcs.wcs_world2pix(truth["ra_deg"][inside], truth["dec_deg"][inside], 0)
    assert np.hypot(straight[0] - x, straight[1] - y).max() > 0.5
    light = open_cube(tmp_path / "run")["stars_e"].values[0]
    whole = (x > 12) & (x < 627) & (y > 12) & (y < 499)
    found = np.array([centroid(light, *place) for place in zip(x[whole], y[whole], strict=True)])
    assert np.abs(found - np.stack([x[whole], y[whole]], -1)).max() < 1e-3


def test_same_bits_for_every_tile_shape(catalogue, tmp_path):
    digests = set()
    for side, workers in ((512, "synchronous"), (256, "threads")):
        scene = scene_of(catalogue, KINDS["sip"], tile_shape=[side, side])
        path = tmp_path / f"{side}-{workers}"
        digests.add(render(scene, path, Options(workers, 2))["content_digest"])
    assert len(digests) == 1


def test_absent_changes_nothing(catalogue, tmp_path):
    """None and no key are one scene; the product has the small SIP tables and both WCS."""
    scene = scene_of(catalogue, None)
    render(scene, tmp_path / "run", Options("synchronous"))
    cube = open_cube(tmp_path / "run")
    assert cube["wcs_sip_a"].shape == (1, 5, 5)
    assert "distorted" not in cube.attrs
    (path,) = export_frames(tmp_path / "run", "fits", tmp_path / "frame.fits", frame=0)
    assert fits.getheader(path)["CTYPE1A"] == "RA---TPV"  # the primary one has SIP terms


def test_limits_a_fold_is_refused_before_any_drawing(catalogue, tmp_path):
    scene = scene_of(catalogue, {"kind": "sip", "a": {"3_0": -1e-5}})
    with pytest.raises(BadInput) as caught:
        render(scene, tmp_path / "run")
    assert caught.value.field == "sensor.distortion"
    assert not (tmp_path / "run").exists()
    with pytest.raises(BadInput):
        plan_scene(scene)
