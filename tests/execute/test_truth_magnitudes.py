"""Magnitudes of targets in the truth and labels, against closed forms; names of populations."""

from __future__ import annotations

import json

import erfa
import numpy as np
import pyarrow.parquet as pq
import pytest

from pipeline.export.formats import ExportRequest, export_product
from pipeline.route.run import Options, render
from pipeline.spec.load import parse_scene

DIAMETER_M, ALBEDO, SECONDS, APERTURE_M = 4.0, 0.25, 2.0, 0.4
LOW_NM, HIGH_NM = 400.0, 900.0
POSITION = {"position_m": [4407338.1, -41933005.2, -36593.5],
            "velocity_m_s": [3057.8229, 321.39, 0.2805]}  # fmt: skip


def scene(**changes):
    return parse_scene({
        "schema": "nightglass/scene/1", "name": "magnitudes", "epoch": "2019-07-20T09:00:00Z",
        "observer": {
            "kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055
        },
        "sensor": {
            "shape": [64, 64], "pixel_pitch_um": 9.0, "focal_length_m": 1.0,
            "aperture_m": APERTURE_M,
            "bandpass": {"kind": "box", "short_nm": LOW_NM, "long_nm": HIGH_NM},
            "psf": {"kind": "gaussian", "sigma_px": 0.9}, "read_noise_e": 5.0,
        },
        "pointing": {"mode": "target", "target": "ball"},
        "exposure": {"integration_s": SECONDS},
        "targets": [{
            "name": "ball", "object_name": "SPHERE 1 (R/B)",
            "orbit": {"kind": "state", **POSITION},
            "body": {"kind": "sphere", "diameter_m": DIAMETER_M, "albedo": ALBEDO},
        }],
    } | changes)  # fmt: skip


@pytest.fixture(scope="module")
def product(tmp_path_factory):
    path = tmp_path_factory.mktemp("magnitudes") / "run"
    render(scene(), path, Options("synchronous"))
    return path


def row_of(product):
    return {k: v[0] for k, v in
            pq.read_table(product / "truth" / "targets.parquet").to_pydict().items()}  # fmt: skip


def test_v_of_a_diffuse_sphere(product):
    """V = -26.76 - 2.5 log10(2/3 A (r/R)^2 phi(alpha) / d^2), phi Lambert's phase law."""
    row = row_of(product)
    a = np.radians(row["phase_deg"])
    phase = (np.sin(a) + (np.pi - a) * np.cos(a)) / np.pi
    date = erfa.dtf2d("TT", 2019, 7, 20, 9, 1, 10.0)
    sun_au = np.linalg.norm(erfa.epv00(*date)[0]["p"])  # of the Earth: the target's to 3e-4
    ratio = 2.0 / 3.0 * ALBEDO * (0.5 * DIAMETER_M / row["range_m"]) ** 2 * phase / sun_au**2
    assert row["v_mag"] == pytest.approx(-26.76 - 2.5 * np.log10(ratio), abs=1e-3)


def test_ab_of_the_band_is_of_the_electrons(product):
    """The rate of AB = 0 through a box is 5.4798e10 ln(l2 / l1) a second and square metre."""
    row = row_of(product)
    rate = row["electrons"] / SECONDS / (0.25 * np.pi * APERTURE_M**2)
    zero = 5.4798e10 * np.log(HIGH_NM / LOW_NM)
    assert row["mag_ab"] == pytest.approx(-2.5 * np.log10(rate / zero), abs=1e-4)


def test_magnitudes_hold_in_bias_frames_and_through_air(product, tmp_path):
    observer = {"kind": "ground", "latitude_deg": 20.7, "longitude_deg": -156.3, "height_m": 3055,
                "atmosphere": {"extinction": True}}  # fmt: skip
    for name, changes in (("bias", {"exposure": {"integration_s": 0}}),
                          ("air", {"observer": observer})):  # fmt: skip
        render(scene(**changes), tmp_path / name, Options("synchronous"))
        row, above = row_of(tmp_path / name), row_of(product)
        assert row["v_mag"] == pytest.approx(above["v_mag"], abs=1e-4)
        assert row["mag_ab"] == pytest.approx(above["mag_ab"], abs=1e-4)
        assert row["electrons"] < 0.95 * above["electrons"]


def test_truth_is_of_the_middle_of_the_exposure(tmp_path):
    """Of two seconds from nine o'clock, and of an instant a second after it: one target's row."""
    fast = {**POSITION, "velocity_m_s": [3800.0, -5000.0, 900.0], "epoch": "2019-07-20T09:00:00Z"}
    ball = {"name": "ball", "orbit": {"kind": "state", **fast},
            "body": {"kind": "sphere", "diameter_m": DIAMETER_M, "albedo": ALBEDO}}  # fmt: skip
    for name, second, seconds in (("long", 0, SECONDS), ("instant", 1, 0)):
        made = scene(targets=[ball], epoch=f"2019-07-20T09:00:0{second}Z",
                     exposure={"integration_s": seconds})  # fmt: skip
        render(made, tmp_path / name, Options("synchronous"))
    long, instant = row_of(tmp_path / "long"), row_of(tmp_path / "instant")
    for column, within in (("range_m", 1.0), ("phase_deg", 1e-6), ("apparent_ra_deg", 1e-7),
                           ("apparent_dec_deg", 1e-7), ("ra_deg", 1e-7)):  # fmt: skip
        assert long[column] == pytest.approx(instant[column], abs=within), column


def test_labels_have_them(product, tmp_path):
    row = row_of(product)
    assert row["object_name"] == "SPHERE 1 (R/B)"
    list(export_product(product, "satnet", tmp_path / "satnet", ExportRequest()))
    (path,) = (tmp_path / "satnet" / "Annotations").iterdir()
    (seen,) = json.loads(path.read_text())["data"]["objects"]
    assert seen["magnitude"] == pytest.approx(row["v_mag"])
    assert (seen["object_name"], seen["object_id"]) == ("SPHERE 1 (R/B)", "ball")
    list(export_product(product, "coco", tmp_path / "coco", ExportRequest()))
    found = json.loads((tmp_path / "coco" / "annotations.json").read_text())["annotations"][0]
    assert found["mag_ab"] == pytest.approx(row["mag_ab"])
    assert None not in found.values()
